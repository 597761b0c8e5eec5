"""Build an atlas: the tiles of the plan as a job, whose file is the atlas."""

from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path

import jaxstab
from jaxstab.atlas.atlas import Atlas, open_atlas
from jaxstab.atlas.plan import Plan, Tile, compute_tile, plan_atlas
from jaxstab.atlas.spec import AtlasSpec
from jaxstab.atlas.write.tiles import (
    build_key,
    encode_tile,
    is_whole,
    merge,
    name_of,
    opened_tile,
)
from jaxstab.tiles import Job, Progress, Shards, complete

_NODES_IN_FLIGHT = 2**26


@dataclass(frozen=True)
class Build(Job[Tile]):
    """The job of building an atlas: its specification, its key and where the file goes."""

    spec: AtlasSpec
    key: str
    path: Path

    @cached_property
    def plan(self) -> Plan:
        """The plan, made when the place of the file is known to be good."""
        return plan_atlas(self.spec)

    @property
    def items(self) -> list[Tile]:
        return self.plan.tiles

    @property
    def at_once(self) -> int:
        alphas, betas, *_ = self.plan.grid.shape
        return max(2, _NODES_IN_FLIGHT // (self.plan.deltas_of_a_tile * alphas * betas))

    def name(self, item: Tile) -> str:
        return name_of(item)

    def image(self, item: Tile) -> bytes:
        return encode_tile(self.plan, item, self.key, compute_tile(self.plan, item))

    def check(self, item: Tile, image: bytes) -> None:
        with opened_tile(self.plan, item, self.key, image):
            pass

    def is_done(self, item: Tile, image: bytes) -> bool:
        return is_whole(self.plan, item, self.key, image)

    def publish(self, shards: Shards) -> None:
        merge(self.plan, shards, self.path, f"jaxstab {jaxstab.__version__}")


def build_atlas(
    spec: AtlasSpec,
    path: str | PathLike[str],
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Atlas:
    """Compute an atlas, publish it as one file, and open it.

    The file appears whole and durably, or not at all; a former one of this name is replaced. Until
    then finished tiles are in a hidden folder beside it, and after an interruption the next build
    of an equal specification continues from them. On one machine, equal specifications give equal
    bytes, however the work was done. A few tiles are in memory at a time.

    Args:
        spec: the specification of the atlas.
        path: of the file.
        progress: called with the number of finished tiles and of all tiles.
        executor: computes the tiles; without one, the dask ``Client`` of this process does, or this
            process. A tile may be computed twice. An executor of processes must not fork them.

    Raises:
        OSError: the folder is missing, read-only or full, or another process builds this atlas; a
            former file is still there.
        ValueError: a parameter is too large for the model, or an axis cannot be fitted; or the
            atlas is larger than can be opened in memory.
        RuntimeError: a worker computed what the schema does not allow, or workers died.

    Source: the verdicts, the fields and the proofs for cells name theirs.

    Example:
        >>> spec = jaxstab.AtlasSpec(delay=(1.0,), gamma=(0.0,), delta=(0.0, 0.015))
        >>> atlas = jaxstab.build_atlas(spec, "atlas.h5")  # doctest: +SKIP
    """
    write_atlas(spec, Path(path), progress, executor)
    return open_atlas(path)


def write_atlas(
    spec: AtlasSpec, path: Path, progress: Progress | None, executor: Executor | None
) -> None:
    """Build an atlas of any size; see ``build_atlas``, which opens it."""
    complete(Build(spec, build_key(spec), path), path, progress, executor)
