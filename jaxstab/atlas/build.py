"""Build an atlas, and verify one.

The limits come first, in runs of cells of delays; then the table of limits is asked about random
walls, and a build whose table contradicts a computed verdict is given up. Then come the fields,
tile by tile, each written as soon as it is there. Runs and tiles are computed here, or by any
executor.

The file takes its place by one rename when it is whole. A build that fails, or is interrupted,
leaves nothing.
"""

import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jaxstab
from jaxstab.atlas import file
from jaxstab.atlas.nodes import LimitPlan, joined, lay_out, packed_fields, wrong_nodes
from jaxstab.atlas.query import Atlas, open_atlas
from jaxstab.atlas.spec import AtlasSpec, words_of
from jaxstab.atlas.table import LimitTable
from jaxstab.conventions import AXES, Verdict
from jaxstab.durable import replacing
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.numbers import require_kind
from jaxstab.point import verdict

Progress = Callable[[int, int], object]

_CLOSE = 1e-8  # of the largest alpha of a plant: how close to a limit it is verified


def build_atlas(
    spec: AtlasSpec,
    path: str | PathLike[str],
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Atlas:
    """Compute an atlas, publish it as one file, and open it.

    The file appears whole and durably, or not at all; a former one of this name is replaced. On one
    machine, equal specifications give equal bytes, however the work was done. A few tiles are in
    memory at a time.

    Args:
        spec: the specification of the atlas.
        path: of the file.
        progress: called with the number of finished tiles and of all tiles.
        executor: computes the tiles; without one, the dask ``Client`` of this process does, or this
            process. An executor of processes must not fork them.

    Raises:
        OSError: the folder is missing, read-only or full; a former file is still there.
        ValueError: a parameter is too large for the model, or an axis cannot be fitted.
        RuntimeError: workers died, or the table contradicts computed verdicts: give more nodes.

    Source: ``jaxstab.atlas.nodes``, ``jaxstab.evaluate_grid``.

    Example:
        >>> spec = jaxstab.AtlasSpec(delay=(1.0,), gamma=(0.0,), delta=(0.0, 0.015))
        >>> atlas = jaxstab.build_atlas(spec, "atlas.h5")  # doctest: +SKIP
    """
    write_atlas(spec, Path(path), progress, executor)
    return open_atlas(path)


def write_atlas(
    spec: AtlasSpec,
    path: Path,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> None:
    """Build an atlas of any size; see ``build_atlas``, which opens it."""
    require_kind("spec", spec, AtlasSpec)
    with replacing(path) as descriptor, ThreadPoolExecutor(1) as here:
        # A thread of its own for what is computed here: this one hears of signals at once.
        where = executor or _own_client() or here
        plan = LimitPlan.of(spec)
        grid = lay_out(spec) if spec.fields is not None else None
        runs, tiles = plan.runs, grid.tiles if grid is not None else []
        total, done = len(runs) + len(tiles), 0

        def results(tasks: list[Any]) -> Iterator[Any]:
            nonlocal done
            for result in _computed(tasks, where):
                done += 1
                yield result
                if progress is not None:
                    progress(done, total)

        parts = list(results([partial(plan.computed, run) for run in runs]))
        table = joined(spec, parts)
        tested = here.submit(asked_at_random, table, spec.filters).result()
        if tested["tested_wrong"]:
            raise RuntimeError(
                f"{tested['tested_wrong']} of {tested['tested_points']} random walls would be "
                "answered wrongly between the nodes; give more rows, or more nodes of delay."
            )
        with file.written(descriptor) as (stream, image):
            file.write_head(
                image,
                f"jaxstab {jaxstab.__version__}",
                words_of(spec.filters),
                tested,
                has_filters=spec.filters is not None,
            )
            file.write_limits(image, spec.to_toml(), table.arrays)
            if grid is not None:
                group = file.create_fields(image, vars(grid), grid.chunk)
                work = [partial(packed_fields, spec, grid, tile) for tile in tiles]
                for tile, chunks in zip(tiles, results(work), strict=True):
                    corner = 0, 0, tile.gamma, tile.delta.start, tile.delay
                    for name, data in chunks.items():
                        group[name].id.write_direct_chunk(corner, data)
                    stream.check()


def asked_at_random(table: LimitTable, filters: Filters | None, seed: int = 0) -> dict[str, int]:
    """Ask a table about random walls, beyond its limits too, and compare with computed verdicts.

    Returns the numbers of walls, of wrong answers, of those that the table leaves to be computed,
    and of those that stay undecided then; as the attributes of a file.
    """
    tested = 1000, 100  # random plants, and walls of each
    chance = np.random.default_rng(seed)
    gamma, delta, delay = (
        chance.uniform(nodes[0], nodes[-1], (tested[0], 1)) for nodes in table.axes
    )
    plant = (gamma, delta, delay)
    ends = table.ends(*(values.ravel() for values in plant))
    row = chance.uniform(0.0, 1.0, tested)
    beta = _beyond(ends[:, :1], ends[:, 1:], chance.uniform(0.0, 1.0, tested))
    inner = ends[:, :1] + row * (ends[:, 1:] - ends[:, :1])
    limits = table.limits(*(v.ravel() for v in np.broadcast_arrays(inner, *plant)))
    lower = np.nanmin(limits.lower.reshape(tested), axis=1, keepdims=True, initial=np.inf)
    upper = np.nanmax(limits.upper.reshape(tested), axis=1, keepdims=True, initial=-np.inf)
    alpha = _beyond(lower, upper, chance.uniform(0.0, 1.0, tested))
    known = np.flatnonzero(np.isfinite(alpha).all(axis=1) & np.isfinite(beta).all(axis=1))
    point = [v[known] for v in (alpha, beta, *plant)]
    codes = table.verdicts(*(v.ravel() for v in np.broadcast_arrays(*point))).reshape(-1, tested[1])
    named: dict[str, Any] = dict(zip(AXES, point, strict=True))
    exact = np.asarray(verdict(**named, **as_keywords(filters)))
    is_open = codes == Verdict.UNDECIDED
    is_wrong = ~is_open & (codes != exact) & (exact != Verdict.UNDECIDED)
    counts = (
        codes.size,
        np.sum(is_wrong),
        np.sum(is_open),
        np.sum(is_open & (exact == Verdict.UNDECIDED)),
    )
    return {name: int(count) for name, count in zip(file.TESTED, counts, strict=True)}


def _beyond(low: Any, high: Any, share: Any) -> Any:
    """Numbers between two ends, and a little beyond them."""
    beside = 0.1  # of the stable intervals: so far beyond them walls are tested
    with np.errstate(invalid="ignore"):
        return low + (high - low) * ((1.0 + 2.0 * beside) * share - beside)


# ------------------------------------------------------------------------------- where is computed


def _computed(tasks: Iterable[Callable[[], Any]], executor: Executor) -> Iterator[Any]:
    """Yield the results of tasks in order, a few ahead of who takes them."""
    in_flight = 8  # results that are computed ahead of what is written
    waiting = iter(tasks)
    running = deque(executor.submit(task) for task in islice(waiting, in_flight))
    try:
        while running:
            yield running[0].result()
            running.popleft()
            running.extend(executor.submit(task) for task in islice(waiting, 1))
    finally:
        for future in running:
            future.cancel()


def _own_client() -> Executor | None:
    """Return the workers of the dask client of this process, if it has opened one."""
    if "distributed" not in sys.modules:
        return None
    from distributed import default_client

    with suppress(ValueError):
        return workers_of(default_client())
    return None


def workers_of(client: Any) -> Executor:
    """Return the workers of a dask client; a tile whose worker dies is computed by another."""
    retries = 3  # by other workers of dask
    made: Executor = client.get_executor(pure=False, retries=retries)
    return made


# ------------------------------------------------------------------------------------ verification


class Check(NamedTuple):
    """One check: its name, whether it passed, and its finding."""

    name: str
    passed: bool
    words: str

    def __str__(self) -> str:
        return f"{self.name}: {'ok' if self.passed else 'WRONG'}, {self.words}"


def verify_atlas(path: str | PathLike[str], sample: int = 1000) -> Iterator[Check]:
    """Yield one check after the other; the first that fails may be the last.

    About ``sample`` limits, answers and nodes of fields are computed again: a wall just inside of a
    limit must be stable, and one just outside not. OSError: the file is missing or unreadable.
    """
    walls = 16  # of a slice whose fields are verified
    chance, name = np.random.default_rng(0), "file"
    try:
        atlas = open_atlas(path)
        yield Check(name, True, f"of version {file.SCHEMA_VERSION} of the format, limits whole")
        wrong, count = _wrong_limits(atlas.table, atlas.filters, sample, chance)
        yield Check("limits", wrong == 0, f"{wrong} of {count} are off by more than {_CLOSE:g}")
        found = asked_at_random(atlas.table, atlas.filters, seed=1)
        words = f"{found['tested_wrong']} of {found['tested_points']} random walls are wrong"
        yield Check("answers", found["tested_wrong"] == 0, words)
        if atlas.has_fields:
            name = "fields"
            with file.opened(Path(path)) as image:
                group = image[file.FIELDS]
                datasets = {v.name: file.checked_dataset(group, v) for v in file.FIELD_VARIABLES}
                slices = -(-sample // walls)
                off = sum(
                    wrong_nodes(datasets, atlas.filters, walls, chance) for _ in range(slices)
                )
            yield Check(name, off == 0, f"{off} of {slices * walls} nodes are wrong")
    except ValueError as error:
        yield Check(name, False, str(error))


def _wrong_limits(
    table: LimitTable, filters: Filters | None, sample: int, chance: np.random.Generator
) -> tuple[int, int]:
    """Count limits at random nodes that do not part stable walls from unstable ones."""
    limits = table.alpha_limits
    known = np.argwhere(np.isfinite(limits[..., 1:-1, :]).all(axis=-1))
    if not len(known):
        return 0, 0
    gamma, delta, delay, row = known[chance.integers(0, len(known), sample)].T
    low, high = table.beta_limits[gamma, delta, delay].T
    beta = low + table.row[row + 1] * (high - low)
    size = np.nanmax(np.abs(limits), axis=(-1, -2))[gamma, delta, delay]
    lower, upper = limits[gamma, delta, delay, row + 1].T
    aside = _CLOSE * size
    plant = {"gamma": table.gamma[gamma], "delta": table.delta[delta], "delay": table.delay[delay]}
    wrong = np.zeros(sample, bool)
    for alpha, right in (
        (np.minimum(lower + aside, 0.5 * (lower + upper)), Verdict.STABLE),
        (np.maximum(upper - aside, 0.5 * (lower + upper)), Verdict.STABLE),
        (lower - aside, Verdict.UNSTABLE),
        (upper + aside, Verdict.UNSTABLE),
    ):
        keywords = {"resolve": "exact", **as_keywords(filters)}
        codes = np.asarray(verdict(alpha, beta, **plant, **keywords))
        wrong |= (codes != right) & (codes != Verdict.UNDECIDED)
    return int(wrong.sum()), sample
