"""Resolutions of one range beside each other: what each gives and what it takes, as a table."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isnan, prod
from time import process_time
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from jaxstab.atlas.compute.layout import Grid, Reach
from jaxstab.atlas.compute.plan import Plan
from jaxstab.atlas.compute.products import compute_tile
from jaxstab.atlas.format.schema import (
    ALPHA_LIMITS,
    LIMIT_RANGE,
    LIMIT_TERMS,
    LIMIT_WHOLE,
    LIMITS,
    RADIUS_RANGE,
    SPEC,
    SPECTRAL_RADIUS,
    VARIABLES,
    VERDICT,
)
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.read.atlas import Atlas
from jaxstab.atlas.read.file import Contents
from jaxstab.atlas.read.limits import AlphaLimits, RadiusTable, limits_at, undecided_share
from jaxstab.atlas.read.points import QueryStatus
from jaxstab.conventions import Verdict
from jaxstab.model import by_name

# Parts of an atlas that is not built yet: some of its cells, computed and asked.
#
# Cells are spread evenly over the range of hands and delays, by one sequence for all resolutions.

Floats = Float64[np.ndarray, "..."]

_COLUMNS, _BOXES = 256, 2  # of limits that are computed at once, at most

_OF_EACH = 10  # places to a part that is computed, at most

_PLACES = 2  # in a column at which limits are asked

_POINTS = 2**13  # that a part of an atlas is asked about

_BETAS = 16  # cells along beta of a part that is computed for its radii

_PLASTIC = 1.1673039782614187  # the root of x^5 = x + 1: its powers spread four numbers evenly

_STEPS = _PLASTIC**-1, _PLASTIC**-2, _PLASTIC**-3, _PLASTIC**-4


class LimitPart(NamedTuple):
    """Limits of alpha in some columns of a few boxes of hands and one cell of delays.

    Attributes:
        undecided: the share of the alphas at random places that is undecided.
        error: of the upper limit, at those of them where some alpha is stable; infinite: unknown.
        terms: of the columns, as a file has them.
        seconds: of CPU time that these took, 0 if they were known.
    """

    undecided: Floats
    error: Floats
    terms: Float32[np.ndarray, "column term"]
    seconds: float


class CellPart(NamedTuple):
    """What cells of verdicts say between nodes, at one of the delays of an atlas.

    Attributes:
        undecided: the share of random points without a verdict.
        query_seconds: of CPU time that a point took.
    """

    undecided: float
    query_seconds: float


def limit_parts(plan: Plan, reach: Reach, count: int) -> Iterator[LimitPart]:
    """Yield limits of alpha at places of the range; those of one part of it are computed once.

    Args:
        plan: of an atlas with limits of alpha.
        reach: of its regions; errors are relative to the largest alpha at their delay.
        count: how many parts are computed, at most.
    """
    rng = np.random.default_rng(count)
    known: dict[tuple[float, ...], Float32[np.ndarray, "column term"]] = {}
    for number in itertools.count():
        grid = _limit_grid(plan.grid, *_place(number))
        seconds = 0.0
        part = *grid.limit_range[0].tolist(), float(grid.gamma[0]), float(grid.delta[0])
        if part not in known:
            if len(known) == count:
                return
            alone = Plan(replace(plan.spec, products=(ALPHA_LIMITS,)), grid)
            begin = process_time()
            terms = compute_tile(alone, alone.tiles[0])[ALPHA_LIMITS]
            seconds = process_time() - begin
            known[part] = terms.reshape(-1, 2 * LIMIT_TERMS)
        answers = _asked_limits(grid, reach, known[part], rng)
        yield LimitPart(*answers, known[part], seconds)
        if number + 1 >= _OF_EACH * len(known):
            return


def _place(number: int) -> tuple[float, ...]:
    """Return where delay, gamma, delta and beta of a place are in their ranges, from 0 to 1."""
    return tuple((0.5 + number * step) % 1.0 for step in _STEPS)


def _limit_grid(grid: Grid, delay: float, gamma: float, delta: float, beta: float) -> Grid:
    """Return cells of hands and delays at a place, with some of their columns along beta."""
    row = grid.limit_range[_along(np.diff(grid.limit_range[:, :2])[:, 0], delay)]
    runs = -(-grid.limit_cells // _COLUMNS)
    run = int(beta * runs)
    cells = (np.array([run, run + 1]) * grid.limit_cells) // runs
    low, high = row[4] + (row[5] - row[4]) * cells / grid.limit_cells
    ends = np.array([[*row[:4], low, high]])
    return replace(
        _hands_at(grid, gamma, delta, _BOXES),
        alpha=grid.alpha[:1, :1],
        beta=grid.beta[:1, :1],
        delay=ends[0, :1],
        limit_cells=int(np.diff(cells)[0]),
        limit_range=ends,
    )


def _hands_at(grid: Grid, gamma: float, delta: float, boxes: int) -> Grid:
    """Return the cell of hands at a place; up to so many of them along delta."""
    of_gamma = _along(np.diff(grid.gamma), gamma)
    of_delta = _along(np.diff(grid.delta), delta) // boxes * boxes
    return replace(
        grid,
        gamma=grid.gamma[of_gamma : of_gamma + 2],
        delta=grid.delta[of_delta : of_delta + boxes + 1],
    )


def _along(widths: Floats, share: float) -> int:
    """Return the number of the cell at a share of the way through all of them."""
    if not widths.any():
        return min(int(share * widths.size), max(widths.size - 1, 0))
    ends = np.cumsum(widths)
    return min(int(np.searchsorted(ends, share * ends[-1], "right")), widths.size - 1)


def _asked_limits(
    grid: Grid, reach: Reach, terms: Float32[np.ndarray, "column term"], rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return the undecided shares and the errors of limits at random places of columns."""
    early, late, least, most, low, high = grid.limit_range[0].tolist()
    shape = (_PLACES * _BOXES, grid.limit_cells)
    cell = np.broadcast_to(np.arange(shape[1]), shape)
    beta = low + (cell + rng.random(shape)) / shape[1] * (high - low)
    ends = (*((nodes[0], nodes[-1]) for nodes in (grid.gamma, grid.delta)), (early, late))
    others = [np.broadcast_to(rng.uniform(*pair, shape), shape).ravel() for pair in ends]
    inner = grid.delta[1:-1]
    column = cell.ravel() * (inner.size + 1) + np.searchsorted(inner, others[1])
    limits = limits_at(terms[column].T, beta.ravel(), *others)
    undecided = undecided_share(limits, least, most)
    return undecided, _relative_errors(limits, reach, others[-1])


def _relative_errors(limits: AlphaLimits, reach: Reach, delay: Floats) -> Floats:
    """Return the errors of upper limits, where some alpha is stable, over the largest alphas.

    Args:
        limits: at some places.
        reach: of the regions, by which the largest alpha at a delay is known.
        delay: of the places.
    """
    stable = (limits.lower < np.inf) & ((limits.upper < np.inf) | (limits.upper_error == np.inf))
    largest = reach.along(delay[stable])[:, 0]
    return np.asarray(limits.upper_error[stable] / largest)


def cell_parts(plan: Plan, count: int) -> Iterator[CellPart]:
    """Yield what parts of an atlas answer by nodes and cells; each part is computed once.

    Args:
        plan: of an atlas with verdicts and without limits of alpha.
        count: how many places.
    """
    rng = np.random.default_rng(count)
    known: dict[tuple[float, ...], Atlas] = {}
    for number in range(count):
        share, gamma, delta, _ = _place(number)
        delay = int(share * plan.grid.delay.size)
        one = slice(delay, delay + 1)
        grid = replace(
            _hands_at(plan.grid, gamma, delta, 1),
            alpha=plan.grid.alpha[:, one],
            beta=plan.grid.beta[:, one],
            delay=plan.grid.delay[one],
            limit_range=plan.grid.limit_range[:0],
        )
        part = delay, float(grid.gamma[0]), float(grid.delta[0])
        if part not in known:
            known[part] = _atlas_of(Plan(replace(plan.spec, products=[VERDICT]), grid))
        yield _asked_cells(known[part], rng)


def radius_errors(plan: Plan, count: int) -> Iterator[Floats]:
    """Yield the bounds of the radii of stable points in some cells, at some places of the range.

    Args:
        plan: of an atlas with spectral radii.
        count: how many places.
    """
    rng = np.random.default_rng(count)
    for number in range(count):
        grid = _radius_grid(plan.grid, *_place(number))
        part = Plan(replace(plan.spec, products=[SPECTRAL_RADIUS]), grid)
        arrays = compute_tile(part, part.tiles[0])
        hands = {"gamma": grid.gamma, "delta": grid.delta}
        table = RadiusTable(arrays | hands | {RADIUS_RANGE: grid.radius_range})
        early, late, *walls = grid.radius_range[0].tolist()
        ends = *np.reshape(walls, (2, 2)), *hands.values(), (early, late)
        low, high = table.bounds([rng.uniform(side[0], side[-1], _POINTS) for side in ends])
        stable = low + high < 2.0
        yield 0.5 * (np.minimum(high, 1.0) - low)[stable]


def _radius_grid(grid: Grid, delay: float, gamma: float, delta: float, beta: float) -> Grid:
    """Return one cell of radii along gamma, delta and delay at a place, and some along beta."""
    row = grid.radius_range[_along(np.diff(grid.radius_range[:, :2])[:, 0], delay)]
    alphas, betas, *hands = grid.radius_cells
    runs = -(-betas // _BETAS)
    count = -(-betas // runs)
    start = row[4] + (row[5] - row[4]) * int(beta * runs) / runs
    ends = np.array([[*row[:4], start, start + (row[5] - row[4]) / runs]])
    gamma_ends, delta_ends = (
        _part_of(nodes, cells, share)
        for nodes, cells, share in zip((grid.gamma, grid.delta), hands, (gamma, delta), strict=True)
    )
    return replace(
        grid,
        alpha=grid.alpha[:, :1],
        beta=grid.beta[:, :1],
        gamma=gamma_ends,
        delta=delta_ends,
        delay=ends[0, :1],
        radius_cells=(alphas, count, 1, 1),
        radius_range=ends,
    )


def _part_of(nodes: Floats, cells: int, share: float) -> Floats:
    """Return the ends of that of equal cells which is at a share of the way; of one node, it."""
    cell = int(share * cells) + np.array([0.0, 1.0])
    return np.unique(nodes[0] + (nodes[-1] - nodes[0]) * cell / cells)


def _atlas_of(plan: Plan) -> Atlas:
    """Compute a small atlas without limits of alpha, in memory alone."""
    grid = plan.grid
    arrays = {name: getattr(grid, name) for name in ("alpha", "beta", "gamma", "delta", "delay")}
    arrays |= {LIMIT_RANGE: grid.limit_range}
    arrays[SPEC] = np.array(plan.spec.to_toml().encode().splitlines())
    for tile in plan.tiles:
        for name, values in compute_tile(plan, tile).items():
            dimensions = VARIABLES[name].dimensions
            whole = [grid.lengths[dimension] for dimension in dimensions]
            part = [plan.numbers(dimension, tile) for dimension in dimensions]
            arrays.setdefault(name, np.zeros(whole, values.dtype))[np.ix_(*part)] = values
    return Atlas(Contents(arrays, "", ""))


def _asked_cells(atlas: Atlas, rng: np.random.Generator) -> CellPart:
    nodes = atlas.nodes(0).values()
    points = [rng.uniform(along[0], along[-1], _POINTS) for along in nodes]
    begin = process_time()
    alpha, beta, gamma, delta = points
    answer = atlas.query(alpha, beta, gamma=gamma, delta=delta, delay=float(atlas.delays[0]))
    seconds = (process_time() - begin) / _POINTS
    between = answer.status != QueryStatus.NODE
    undecided = np.mean(answer.verdict[between] == Verdict.UNDECIDED)
    return CellPart(float(undecided), seconds)


# What an atlas is like that is not built yet, by a sample of its parts.
#
# No more of them are looked at than show what is asked.

_MOST = 0.95  # of the limits keep the error that is said

_DRAWS = 50  # of samples of a sample, for its spread

_TABLE = 2**24  # numbers of limits at most, among which queries are timed: 64 MB

_QUERIES, _REPEATS = 2**16, 4

_ENOUGH = 0.05  # of a value: a spread that needs no more places

_AT_ONCE = 6  # places between looks at the spread


class Measured(NamedTuple):
    """A value from a sample, and its standard error."""

    value: float
    spread: float


class Timed(NamedTuple):
    """How many tiles of limits of alpha were computed, with how many columns, in which CPU time."""

    calls: int = 0
    columns: int = 0
    seconds: float = 0.0


class Sample(NamedTuple):
    """What an atlas is like, by a sample of its cells; NaN for what was not asked, or is not held.

    Attributes:
        limit_error: that 95 % of the places with a stable alpha keep.
        undecided: share of random points.
        radius_error: that half of the stable points keep.
        query_seconds: of CPU time of a verdict, of many.
        timed: what computing its limits of alpha took.
    """

    limit_error: Measured = Measured(np.nan, np.nan)
    undecided: Measured = Measured(np.nan, np.nan)
    radius_error: Measured = Measured(np.nan, np.nan)
    query_seconds: float = np.nan
    timed: Timed = Timed()


Enough = Callable[[Sample], bool]

"""Says whether a sample shows what is asked."""


def has_small_spreads(sample: Sample) -> bool:
    """Whether the shares and errors of limits of alpha are known well."""
    known = sample.limit_error, sample.undecided
    return all(spread <= _ENOUGH * value or not value < np.inf for value, spread in known)


def sample_of_limits(
    plan: Plan, reach: Reach, count: int, enough: Enough = has_small_spreads
) -> Sample:
    """Compute some limits of alpha of an atlas and ask them.

    Args:
        plan: of an atlas with limits of alpha.
        reach: of its regions.
        count: how many parts of the range are computed, at most.
        enough: says of fewer whether they will do.
    """
    drawn = limit_parts(plan, reach, count)
    parts: list[LimitPart] = []
    sample = Sample()
    while some := list(itertools.islice(drawn, _AT_ONCE)):
        parts += some
        sample = Sample(
            limit_error=_quantile([part.error for part in parts], _MOST),
            undecided=_mean([float(part.undecided.mean()) for part in parts]),
        )
        if enough(sample):
            break
    computed = [part for part in parts if part.seconds]
    columns, seconds = sum(len(part.terms) for part in computed), sum(p.seconds for p in computed)
    return sample._replace(
        query_seconds=_query_seconds(plan.grid, parts),
        timed=Timed(len(computed), columns, seconds),
    )


def sample_of_cells(plan: Plan, count: int) -> Sample:
    """Compute some cells of the verdicts of an atlas and ask them between nodes.

    Args:
        plan: of an atlas with verdicts and without limits of alpha.
        count: how many places of the range.
    """
    parts = list(cell_parts(plan, count))
    return Sample(
        undecided=_mean([part.undecided for part in parts]),
        query_seconds=float(np.median([part.query_seconds for part in parts])),
    )


def sample_of_radii(plan: Plan, count: int) -> Sample:
    """Compute some cells of radii of an atlas and ask them.

    Args:
        plan: of an atlas with spectral radii.
        count: how many places of the range.
    """
    return Sample(radius_error=_quantile(list(radius_errors(plan, count)), 0.5))


def _query_seconds(grid: Grid, parts: Sequence[LimitPart]) -> float:
    """Return the time of a verdict: in a table as large as the atlas's, of the columns of parts."""
    shape = [*(grid.lengths[name] for name in LIMITS)]
    shape[0] = max(1, min(shape[0], _TABLE // prod(shape[1:])))
    terms = np.resize(np.concatenate([part.terms for part in parts]), shape)
    arrays = {"gamma": grid.gamma, "delta": grid.delta, "delay": grid.delay, SPEC: np.array([b""])}
    arrays |= {ALPHA_LIMITS: terms, LIMIT_RANGE: grid.limit_range}
    arrays |= {LIMIT_WHOLE: np.zeros(len(grid.limit_range), np.int32)}
    atlas = Atlas(Contents(arrays, "", ""))
    rng = np.random.default_rng(shape[0])
    row = grid.limit_range[rng.integers(len(grid.limit_range), size=_QUERIES)].T
    hands = (rng.uniform(nodes[0], nodes[-1], _QUERIES) for nodes in (grid.gamma, grid.delta))
    walls = (rng.uniform(row[2], row[3]), rng.uniform(row[4], row[5]))
    points = *walls, *hands, rng.uniform(row[0], row[1])
    taken = []
    for _ in range(_REPEATS):
        begin = process_time()
        atlas.verdict(**by_name(*points))
        taken.append(process_time() - begin)
    return min(taken) / _QUERIES


def _quantile(parts: Sequence[Floats], share: float) -> Measured:
    """Return a quantile of all values, and its spread by drawing the parts again."""
    kept = [part for part in parts if part.size]
    if not kept:
        return Measured(np.nan, np.nan)
    rng = np.random.default_rng(len(kept))
    drawn = rng.integers(len(kept), size=(_DRAWS, len(kept)))
    values = [_at_share(np.concatenate([kept[i] for i in some]), share) for some in drawn]
    known = np.isfinite(values)
    spread = float(np.std(np.array(values)[known])) if known.all() else np.inf
    return Measured(_at_share(np.concatenate(kept), share), spread)


def _at_share(values: Floats, share: float) -> float:
    """Return the value that a share of all is not above; it may be infinite."""
    return float(np.quantile(values, share, method="higher"))


def _mean(values: Sequence[float]) -> Measured:
    spread = np.std(values, ddof=1) / len(values) ** 0.5 if len(values) > 1 else np.nan
    return Measured(float(np.mean(values)), float(spread))


_COUNTS = {
    "alpha": "alpha",
    "beta": "beta",
    "gamma": "gamma",
    "delta": "delta",
    "limit_cells": "limits",
    "delay_cells": "delays",
}

_WORDS = (
    "limits: 95 % of the proved errors of the upper limit of alpha are below this, over the "
    "largest stable alpha at their delay",
    "undecided: share of the range without a proved verdict",
    "radius: half of the proved errors of stable loops are below this",
    "Counts are nodes along alpha and beta, cells along gamma and delta, limit_cells and "
    "delay_cells of the limits. +- is the standard error of a sample.",
)


@dataclass(frozen=True)
class Resolution:
    """What one resolution of a range gives and takes, by a sample of its cells.

    Attributes:
        spec: the specification.
        counts: nodes along alpha and beta, cells along gamma and delta, and the ``limit_cells``
            and ``delay_cells`` of the limits of alpha.
        limit_error: bound that 95 % of the upper limits of alpha keep, over the largest stable
            alpha at their delay; infinite where less than 95 % have one, NaN without limits.
        undecided: share of the range that is undecided; NaN without verdicts.
        radius_error: bound that half of the spectral radii of stable loops keep, NaN without radii.
        query_seconds: of CPU time of a verdict, asked for many at once.
        seconds: of CPU time of the build on this machine.
        size: of the file in bytes.

    Each of the three errors is a pair: the value and its standard error.

    Example:
        >>> hand = {"gamma": (0.0,), "delta": (0.01,), "delay": (1.0,)}
        >>> spec = jaxstab.AtlasSpec(**hand, products=("alpha_limits",))
        >>> given = jaxstab.plan_resolution(spec, size=50_000).given
        >>> given.counts["limit_cells"]
        256
    """

    spec: AtlasSpec
    counts: Mapping[str, int]
    limit_error: Measured
    undecided: Measured
    radius_error: Measured
    query_seconds: float
    seconds: float
    size: float


@dataclass(frozen=True)
class ResolutionPlan:
    """Resolutions of one range, and the one that a wish needs; ``plan_resolution`` makes it.

    Attributes:
        wish: what was asked for, such as "accuracy 0.01".
        rows: from the smallest file to the largest.
        given: which of them is the specification that was given.
        chosen: which of them meets the wish.

    Example:
        >>> hand = {"gamma": (0.0,), "delta": (0.01,), "delay": (1.0,)}
        >>> spec = jaxstab.AtlasSpec(**hand, products=("alpha_limits",))
        >>> plan = jaxstab.plan_resolution(spec, accuracy=0.01)
        >>> plan.chosen.limit_error.value < 0.01
        True
        >>> plan.spec.limit_cells < spec.limit_cells
        True
    """

    wish: str
    rows: tuple[Resolution, ...]
    given: Resolution
    chosen: Resolution

    @property
    def spec(self) -> AtlasSpec:
        """The specification that meets the wish."""
        return self.chosen.spec

    def __str__(self) -> str:
        heading = [*_COUNTS.values(), "limits", "undecided", "radius", "MB", "CPU s", "ns a query"]
        table = [[*heading, ""], *(self._cells(row) for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = [
            "  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in table
        ]
        return "\n".join([*lines, "", *_WORDS])

    def _cells(self, row: Resolution) -> list[str]:
        notes = {id(self.given): "as given", id(self.chosen): f"meets {self.wish}"}
        return [
            *(str(row.counts[name] or "-") for name in _COUNTS),
            *map(_words, (row.limit_error, row.undecided, row.radius_error)),
            f"{row.size / 1e6:.3g}",
            f"{row.seconds:.3g}",
            "-" if isnan(row.query_seconds) else f"{row.query_seconds * 1e9:.0f}",
            notes.get(id(row), ""),
        ]


def _words(measured: Measured) -> str:
    value, spread = measured
    if isnan(value):
        return "-"
    return f"{value:.2g} +- {spread:.1g}" if value < float("inf") else "no bound"
