"""Build an atlas, and verify one."""

from collections.abc import Iterator
from concurrent.futures import Executor
from os import PathLike
from pathlib import Path

import numpy as np

from jaxstab.atlas.atlas import Atlas, open_atlas
from jaxstab.atlas.file import TooLargeError, table_of
from jaxstab.atlas.product import SPEC, Check, Inspection
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.products.verdicts import wrong_codes
from jaxstab.atlas.schema import content_digest, stored_of
from jaxstab.atlas.spec import AtlasSpec, filters_of
from jaxstab.atlas.write.tiles import Build, build_key
from jaxstab.atlas.write.variables import checked_datasets, opened, text_of
from jaxstab.conventions import AXES, Verdict
from jaxstab.model import by_name
from jaxstab.model.filters import as_keywords
from jaxstab.tiles import Progress, complete


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
            former file is still there. FileExistsError: another process wrote the file meanwhile.
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
    complete(Build(spec, build_key(spec), path), progress, executor)


# Verification of a file: that it is whole, as the schema says, and right at a sample of points.
#
# One slice is in memory at a time, however large the atlas is. Each product compares a sample of
# its contents with a new computation (``Product.checks``); half of the sample of verdicts is next
# to where the verdict changes, where a wrong one would be. At the end the atlas is opened and
# queried at random points, as its users do.


def verify_atlas(path: str | PathLike[str], sample: int = 1000, seed: int = 0) -> Iterator[Check]:
    """Yield one check after the other; the first that fails may be the last.

    About ``sample`` nodes, and as many points in cells, are computed again, by ``jaxstab.verdict``
    with resolve="exact" and ``jaxstab.spectral_radius``; of outlines and summaries those of at most
    16 slices. OSError: the file is missing or unreadable.
    """
    chance = np.random.default_rng(seed)
    path = Path(path)
    try:
        table = table_of(path)
        yield Check("file", True, "whole by its SHA-256, of this version of the schema")
        with opened(path) as file:
            datasets = checked_datasets(file, table)
            yield Check("schema", True, f"{len(datasets)} variables as it says")
            digest = content_digest(stored_of(*pair).line for pair in datasets.items())
            said = text_of(file, "content_sha256")
            is_right = said == table.content_digest == digest
            yield Check("content", is_right, f"its digest is {digest}")
            filters = as_keywords(filters_of(b"\n".join(datasets[SPEC][()]).decode()))
            axes = {name: datasets[name][()] for name in AXES}
            stored = Inspection({**datasets, **axes}, filters, sample, chance)
            for product in PRODUCTS.values():
                if product.names[0] in datasets:
                    yield from product.checks(stored)
        atlas = open_atlas(path)
        yield _answers(atlas, sample, chance)
    except TooLargeError:
        return
    except ValueError as error:
        yield Check("file", False, str(error))


def _answers(atlas: Atlas, sample: int, chance: np.random.Generator) -> Check:
    """Ask the atlas about random points of each delay, as its users do."""
    each, wrong = -(-sample // atlas.delays.size), 0
    filters = as_keywords(atlas.filters)
    for index, delay in enumerate(atlas.delays):
        ends = [(nodes[0], nodes[-1]) for nodes in atlas.nodes(index).values()]
        point = (*(chance.uniform(*side, each) for side in ends), delay)
        answer = atlas.query(**by_name(*point))
        codes = np.where(
            answer.verdict == Verdict.NOT_COMPUTED, np.int8(Verdict.UNDECIDED), answer.verdict
        )
        wrong += wrong_codes(codes, point, filters)
    points = each * atlas.delays.size
    return Check("answers", wrong == 0, f"{wrong} of {points} points are wrong")
