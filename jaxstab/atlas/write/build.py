"""Build an atlas: compute the tiles of the plan, keep each when it is done, publish one file."""

from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor
from contextlib import closing
from os import PathLike
from pathlib import Path

import jaxstab
from jaxstab.atlas.compute.plan import plan_atlas
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.read.atlas import Atlas, open_atlas
from jaxstab.atlas.write.merge import merge
from jaxstab.atlas.write.tiles import build_key, shards_of
from jaxstab.atlas.write.workers import tile_images

Progress = Callable[[int, int], object]


def build_atlas(
    spec: AtlasSpec,
    path: str | PathLike[str],
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Atlas:
    """Build an atlas as ``write_atlas`` does, and open it.

    Raises:
        ValueError: as ``write_atlas``; or the atlas is larger than can be opened in memory.
        OSError, RuntimeError: as ``write_atlas``.

    Source: the verdicts, the radii and the proofs for cells name theirs.

    Example:
        >>> spec = jaxstab.AtlasSpec(delay=(1.0,), gamma=(0.0,), delta=(0.0, 0.015))
        >>> atlas = jaxstab.build_atlas(spec, "atlas.h5")  # doctest: +SKIP
    """
    write_atlas(spec, path, progress, executor)
    return open_atlas(path)


def write_atlas(
    spec: AtlasSpec,
    path: str | PathLike[str],
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> None:
    """Compute an atlas and publish it as one file, with a few tiles of it in memory at a time.

    The file appears whole and durably, or not at all; a former one of this name is replaced. Until
    then each tile that is done is kept in a hidden folder beside it, and when a build was ended,
    in whatever way, the next one of an equal specification goes on from there. One machine makes
    equal bytes of equal specifications, however the work was done.

    Args:
        spec: the specification of the atlas.
        path: of the file.
        progress: called with the number of tiles done and of all tiles, first with those that are
            there already.
        executor: computes the tiles; without one, this process does.
            A tile may be computed twice. An executor of processes must not fork them.

    Raises:
        OSError: the folder is missing, read-only or full, or another process builds this atlas; a
            former file is still there.
        ValueError: a parameter is too large for the model, or an axis cannot be fitted.
        RuntimeError: a worker computed what the schema does not allow, or workers died.

    Source: the verdicts, the radii and the proofs for cells name theirs.

    Example:
        >>> jaxstab.write_atlas(jaxstab.AtlasSpec(), "atlas.h5")  # doctest: +SKIP
    """
    path = Path(path)
    created_by = f"jaxstab {jaxstab.__version__}"
    with shards_of(path, build_key(spec)) as shards:
        plan = plan_atlas(spec)
        tiles = plan.tiles
        missing = [tile for tile in tiles if not shards.has(plan, tile)]
        done = len(tiles) - len(missing)
        tell = progress or (lambda done, total: None)
        tell(done, len(tiles))
        try:
            with closing(tile_images(plan, missing, shards.key, executor)) as images:
                for tile, image in images:
                    shards.put(tile, image)
                    done += 1
                    tell(done, len(tiles))
        except BrokenExecutor as error:
            raise RuntimeError(
                f"a worker died; {done} of {len(tiles)} tiles are done and kept, so build the same "
                "atlas again to go on."
            ) from error
        merge(plan, shards, path, created_by)
        shards.remove()
