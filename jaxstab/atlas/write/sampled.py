"""The answers of an atlas that is not built yet: some of its cells are computed and asked.

Cells are spread evenly over the range of hands and delays, by one sequence for all resolutions.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import prod
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
    LIMITS,
    RADIUS_RANGE,
    SPEC,
    SPECTRAL_RADIUS,
    VARIABLES,
    VERDICT,
)
from jaxstab.atlas.read.answer import QueryStatus
from jaxstab.atlas.read.atlas import Atlas
from jaxstab.atlas.read.file import Contents
from jaxstab.atlas.read.limits import AlphaLimits, limits_at, undecided_share
from jaxstab.atlas.read.radii import RadiusTable
from jaxstab.conventions import UNDECIDED

Floats = Float64[np.ndarray, "..."]

_COLUMNS = 512  # of limits that are computed at once, at most
_OF_EACH = 3  # places to a cell, at most
_PLACES = 2  # in a column at which limits are asked
_POINTS = 2**13  # that a part of an atlas is asked about
_BETAS = 16  # cells along beta of a part that is computed for its radii
_MOST = 0.95  # of the limits keep the error that is said
_DRAWS = 50  # of samples of a sample, for its spread
_TABLE = 2**24  # numbers of limits at most, among which queries are timed: 64 MB
_QUERIES, _REPEATS = 2**16, 4
_STEPS = 0.5698402909980532, 0.7548776662466927, 0.6180339887498949


class LimitPart(NamedTuple):
    """Limits of alpha in some columns of one box of hands and one cell of delays.

    Attributes:
        undecided: the share of the alphas at random places that is undecided.
        error: of the upper limit, at those of them where some alpha is stable; infinite: unknown.
        columns: how many were computed.
        seconds: of CPU time that this took.
        terms: of the columns, as a file has them.
    """

    undecided: Floats
    error: Floats
    columns: int
    seconds: float
    terms: Float32[np.ndarray, "column term"]


class CellPart(NamedTuple):
    """What cells of verdicts say between nodes, at one of the delays of an atlas.

    Attributes:
        undecided: the share of random points without a verdict.
        query_seconds: of CPU time that a point took.
    """

    undecided: float
    query_seconds: float


def _limit_parts(plan: Plan, reach: Reach, count: int) -> Iterator[LimitPart]:
    """Yield limits of alpha at some places of the range.

    Args:
        plan: of an atlas with limits of alpha.
        reach: of its regions; errors are relative to the largest alpha at their delay.
        count: how many places.
    """
    rng = np.random.default_rng(count)
    gammas, deltas, delays = (plan.grid.lengths[name] for name in LIMITS[1:4])
    count = min(count, _OF_EACH * gammas * deltas * delays)
    for number in range(count):
        delay, (gamma, delta, beta) = _place(number, count)
        grid = _limit_grid(plan.grid, delay, gamma, delta, beta)
        part = Plan(replace(plan.spec, products=(ALPHA_LIMITS,)), grid)
        begin = process_time()
        terms = compute_tile(part, part.tiles[0])[ALPHA_LIMITS].reshape(-1, 2 * LIMIT_TERMS)
        seconds = process_time() - begin
        undecided, error = _asked_limits(grid, reach, terms, rng)
        yield LimitPart(undecided, error, len(terms), seconds, terms)


def _place(number: int, count: int) -> tuple[float, tuple[float, ...]]:
    """Return where the delay, gamma, delta and beta of a place are in their ranges, from 0 to 1."""
    return (number + 0.5) / count, tuple((0.5 + number * step) % 1.0 for step in _STEPS)


def _limit_grid(grid: Grid, delay: float, gamma: float, delta: float, beta: float) -> Grid:
    """Return the cell of hands and delays at a place, with some of its columns along beta."""
    row = grid.limit_range[_along(np.diff(grid.limit_range[:, :2])[:, 0], delay)]
    runs = -(-grid.limit_cells // _COLUMNS)
    run = int(beta * runs)
    cells = (np.array([run, run + 1]) * grid.limit_cells) // runs
    low, high = row[4] + (row[5] - row[4]) * cells / grid.limit_cells
    ends = np.array([[*row[:4], low, high]])
    part = _one_cell(grid, 0, gamma, delta)
    return replace(part, delay=ends[0, :1], limit_cells=int(np.diff(cells)[0]), limit_range=ends)


def _one_cell(grid: Grid, delay: int, gamma: float, delta: float) -> Grid:
    """Return the cell of hands at a place, at the delay of an index."""
    hands = {}
    for name, share in (("gamma", gamma), ("delta", delta)):
        cell = _along(np.diff(getattr(grid, name)), share)
        hands[name] = getattr(grid, name)[cell : cell + 2]
    one = slice(delay, delay + 1)
    return replace(
        grid, alpha=grid.alpha[:, one], beta=grid.beta[:, one], delay=grid.delay[one], **hands
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
    shape = (_PLACES, len(terms))
    beta = low + (np.arange(shape[1]) + rng.random(shape)) / shape[1] * (high - low)
    ends = (*((nodes[0], nodes[-1]) for nodes in (grid.gamma, grid.delta)), (early, late))
    others = [np.broadcast_to(rng.uniform(*pair, shape), shape).ravel() for pair in ends]
    limits = limits_at(np.tile(terms.T, _PLACES), beta.ravel(), *others)
    return undecided_share(limits, least, most), relative_errors(limits, reach, others[-1])


def relative_errors(limits: AlphaLimits, reach: Reach, delay: Floats) -> Floats:
    """Return the errors of upper limits, where some alpha is stable, over the largest alphas.

    Args:
        limits: at some places.
        reach: of the regions, by which the largest alpha at a delay is known.
        delay: of the places.
    """
    stable = (limits.lower < np.inf) & ((limits.upper < np.inf) | (limits.upper_error == np.inf))
    largest = reach.along(delay[stable])[:, 0]
    errors: Floats = limits.upper_error[stable] / largest
    return errors


def _cell_parts(plan: Plan, count: int) -> Iterator[CellPart]:
    """Yield what parts of an atlas answer by nodes and cells, at some places of the range.

    Args:
        plan: of an atlas with verdicts and without limits of alpha.
        count: how many places.
    """
    rng = np.random.default_rng(count)
    for number in range(count):
        share, (gamma, delta, _) = _place(number, count)
        delay = min(int(share * plan.grid.delay.size), plan.grid.delay.size - 1)
        grid = _one_cell(plan.grid, delay, gamma, delta)
        grid = replace(grid, limit_range=grid.limit_range[:0])
        atlas = _atlas_of(Plan(replace(plan.spec, products=[VERDICT]), grid))
        yield _asked_cells(atlas, rng)


def _radius_errors(plan: Plan, count: int) -> Iterator[Floats]:
    """Yield the bounds of the radii of stable points in some cells, at some places of the range.

    Args:
        plan: of an atlas with spectral radii.
        count: how many places.
    """
    rng = np.random.default_rng(count)
    for number in range(count):
        grid = _radius_grid(plan.grid, *_place(number, count))
        part = Plan(replace(plan.spec, products=[SPECTRAL_RADIUS]), grid)
        arrays = compute_tile(part, part.tiles[0])
        hands = {"gamma": grid.gamma, "delta": grid.delta}
        table = RadiusTable(arrays | hands | {RADIUS_RANGE: grid.radius_range})
        early, late, *walls = grid.radius_range[0].tolist()
        ends = *np.reshape(walls, (2, 2)), *hands.values(), (early, late)
        low, high = table.bounds([rng.uniform(side[0], side[-1], _POINTS) for side in ends])
        stable = low + high < 2.0
        yield 0.5 * (np.minimum(high, 1.0) - low)[stable]


def _radius_grid(grid: Grid, delay: float, others: tuple[float, ...]) -> Grid:
    """Return one cell of radii along gamma, delta and delay at a place, and some along beta."""
    gamma, delta, beta = others
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
    answer = atlas.query(alpha, beta, gamma, delta, float(atlas.delays[0]))
    seconds = (process_time() - begin) / _POINTS
    between = answer.status != QueryStatus.NODE
    undecided = np.mean(answer.verdict[between] == UNDECIDED)
    return CellPart(float(undecided), seconds)


class Measured(NamedTuple):
    """A value from a sample, and its standard error."""

    value: float
    spread: float


class Sample(NamedTuple):
    """What an atlas is like, by a sample of its cells; NaN for what was not asked, or is not held.

    Attributes:
        limit_error: that 95 % of the places with a stable alpha keep; see ``relative_errors``.
        undecided: share of random points.
        radius_error: that half of the stable points keep.
        query_seconds: of CPU time of a verdict, of many.
    """

    limit_error: Measured = Measured(np.nan, np.nan)
    undecided: Measured = Measured(np.nan, np.nan)
    radius_error: Measured = Measured(np.nan, np.nan)
    query_seconds: float = np.nan


def sample_of_limits(plan: Plan, reach: Reach, count: int) -> Sample:
    """Compute some limits of alpha of an atlas and ask them.

    Args:
        plan: of an atlas with limits of alpha.
        reach: of its regions.
        count: how many places of the range.
    """
    parts = list(_limit_parts(plan, reach, count))
    return Sample(
        limit_error=_quantile([part.error for part in parts], _MOST),
        undecided=_mean([float(part.undecided.mean()) for part in parts]),
        query_seconds=_query_seconds(plan.grid, parts),
    )


def sample_of_cells(plan: Plan, count: int) -> Sample:
    """Compute some cells of the verdicts of an atlas and ask them between nodes.

    Args:
        plan: of an atlas with verdicts and without limits of alpha.
        count: how many places of the range.
    """
    parts = list(_cell_parts(plan, count))
    return Sample(
        undecided=_mean([part.undecided for part in parts]),
        query_seconds=float(np.median([part.query_seconds for part in parts])),
    )


def sampled_radius_error(plan: Plan, count: int) -> Measured:
    """Return the bound that half of the radii of stable points keep, by some cells of radii.

    Args:
        plan: of an atlas with spectral radii.
        count: how many places of the range.
    """
    return _quantile(list(_radius_errors(plan, count)), 0.5)


def _query_seconds(grid: Grid, parts: Sequence[LimitPart]) -> float:
    """Return the time of a verdict: in a table as large as the atlas's, of the columns of parts."""
    shape = [*(grid.lengths[name] for name in LIMITS)]
    shape[0] = max(1, min(shape[0], _TABLE // prod(shape[1:])))
    terms = np.resize(np.concatenate([part.terms for part in parts]), shape)
    arrays = {"gamma": grid.gamma, "delta": grid.delta, "delay": grid.delay, SPEC: np.array([b""])}
    atlas = Atlas(Contents(arrays | {ALPHA_LIMITS: terms, LIMIT_RANGE: grid.limit_range}, "", ""))
    rng = np.random.default_rng(shape[0])
    row = grid.limit_range[rng.integers(len(grid.limit_range), size=_QUERIES)].T
    hands = (rng.uniform(nodes[0], nodes[-1], _QUERIES) for nodes in (grid.gamma, grid.delta))
    walls = (rng.uniform(row[2], row[3]), rng.uniform(row[4], row[5]))
    points = *walls, *hands, rng.uniform(row[0], row[1])
    taken = []
    for _ in range(_REPEATS):
        begin = process_time()
        atlas.verdict(*points)
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
