"""What each product holds in a tile of the plan: functions of the plan and the tile alone."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64
from numpy.typing import NDArray

from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.compute.verdicts import cell_verdicts, node_verdicts
from jaxstab.atlas.format import schema
from jaxstab.atlas.format.schema import (
    ALPHA_LIMITS,
    CELL_VERDICT,
    RADIUS_CELL,
    RADIUS_FUNCTIONS,
    RADIUS_KIND,
    RADIUS_TERMS,
    SPECTRAL_RADIUS,
    TERMS_OF_RADIUS,
    VERDICT,
)
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.proofs.columns import stable_columns
from jaxstab.proofs.curve_patches import Domain
from jaxstab.proofs.plant import HandBoxes
from jaxstab.proofs.radius_cells import (
    WIDEST_CLUSTER,
    RadiusSurfaces,
    SurfaceKind,
    WallBoxes,
    radius_surfaces,
)
from jaxstab.region import StableRegion, stable_region
from jaxstab.tuning import minimize_radius

# Limits of alpha in single precision, which claim no more than those in double. No JAX.

_EVALUATION = 1e-14  # of the terms of a limit, for those who add them up


def in_float32(
    terms: Float64[np.ndarray, "*cells 10"], largest: tuple[float, float, float, float]
) -> Float32[np.ndarray, "*cells 10"]:
    """Round the terms of limits to float32, and their errors up by what that changes.

    Args:
        terms: of one limit, as ``jaxstab.proofs.columns.TERMS`` has them.
        largest: the largest |beta|, gamma, delta and delay for which they are asked.
    """
    exact, error = terms[..., :-1], terms[..., -1]
    *others, delay = largest
    sizes = np.array([1.0, *largest, *(delay * size for size in (delay, *others))])
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        rounded = exact.astype(np.float32).astype(np.float64)
        moved = np.where(rounded == exact, 0.0, np.abs(rounded - exact)) * sizes
        lost = _EVALUATION * np.where(np.isfinite(exact), np.abs(exact), 0.0) * sizes
        raised = (error + moved.sum(axis=-1) + lost.sum(axis=-1)) * (1.0 + 1e-12)
        above = raised.astype(np.float32)
        above = np.where(above < raised, np.nextafter(above, np.float32(np.inf)), above)
    is_known = np.all(np.isfinite(rounded) | (rounded == exact), axis=-1) & ~np.isnan(above)
    limits = np.concatenate([rounded, above[..., None]], axis=-1).astype(np.float32)
    unknown = np.append(np.zeros(sizes.size), np.inf).astype(np.float32)
    chosen: np.ndarray = np.where(is_known[..., None], limits, unknown)
    return chosen


# Limits of alpha in a tile, cell of delays by cell of delays, in float32 that claims no more.


def alpha_limits(plan: Plan, tile: Tile, hands: HandBoxes) -> Float32[np.ndarray, "*shape"]:
    """Return the limits of alpha in a tile, of the shape ``plan.shape``.

    Args:
        plan: of the atlas.
        tile: of the plan.
        hands: the boxes of hands that begin in the tile.
    """
    shape = plan.shape(ALPHA_LIMITS, tile)
    limits = np.zeros((shape[0], hands.gamma.size, *shape[3:]), np.float32)
    for number, cell in enumerate(plan.numbers("delay_cell", tile) if limits.size else ()):
        early, late, *walls = plan.grid.limit_range[cell].tolist()
        domain = Domain((walls[0], walls[1]), (walls[2], walls[3]))
        edges = np.linspace(*domain.beta, plan.grid.limit_cells + 1)
        middle = 0.5 * (early + late)
        half = np.nextafter(max(middle - early, late - middle), np.inf) if late > early else 0.0
        columns = stable_columns(edges, hands, middle, domain, plan.spec.filters, float(half))
        beta = max(map(abs, domain.beta))
        hand = plan.grid.gamma[-1], plan.grid.delta[-1]
        limits[:, :, number] = np.concatenate(
            [in_float32(terms, (beta, *hand, late)) for terms in columns], axis=-1
        ).swapaxes(0, 1)
    return limits.reshape(shape)


# Spectral radii at all points: functions of cells, in float32 that claims no more.

_BEYOND = 1e-9  # of a cell: cells overlap, so that rounding finds no gap between them

_STEP = 1 / 64  # of an error: terms are multiples of less than this, which take little room

_LEAST_ERROR = 1e-9

_DIGITS = 5  # of an error that are kept, upwards

_LARGEST = 1e6  # of terms


def radii(plan: Plan, tile: Tile) -> dict[str, NDArray[Any]]:
    """Return the functions of the cells that are in a tile, one cell of delays after the other."""
    grid = plan.grid
    counts = grid.radius_cells
    kinds = np.zeros(plan.shape(RADIUS_KIND, tile), np.int32)
    rows = [np.zeros((TERMS_OF_RADIUS, 0), np.float32)]
    for number, cell in enumerate(plan.numbers(RADIUS_CELL[-1], tile) if kinds.size else ()):
        early, late, *walls = grid.radius_range[cell].tolist()
        ends = (*np.reshape(walls, (2, 2)), grid.gamma[[0, -1]], grid.delta[[0, -1]])
        boxes = [_parts(pair, count) for pair, count in zip(ends, counts, strict=True)]
        middles = np.meshgrid(*(middle for middle, _ in boxes), indexing="ij")
        halves = [np.full(middles[0].size, half) for _, half in boxes]
        alpha, beta, gamma, delta = (middle.ravel() for middle in middles)
        middle = 0.5 * (early + late)
        half = (1.0 + _BEYOND) * max(middle - early, late - middle)
        known = radius_surfaces(
            WallBoxes(alpha, beta, *halves[:2]),
            HandBoxes(gamma, delta, *halves[2:]),
            middle,
            half,
            plan.spec.filters,
        )
        kind, of_cells = _in_float32(known)
        kinds[..., number] = kind.reshape(counts)
        rows.append(of_cells)
    return {RADIUS_KIND: kinds, RADIUS_TERMS: np.concatenate(rows, axis=1)}


def _parts(
    ends: Float64[np.ndarray, "2"], count: int
) -> tuple[Float64[np.ndarray, " count"], float]:
    """Return the middles of equal parts of a range, and half of their width."""
    low, high = ends.tolist()
    half = 0.5 * (high - low) / count
    return low + half * (2.0 * np.arange(count) + 1.0), half * (1.0 + _BEYOND)


def _in_float32(known: RadiusSurfaces) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the kinds of cells and the terms of their functions, with what rounding loses."""
    kind, terms = known.kind.astype(np.int32), known.terms.copy()
    errors = np.concatenate([known.error, np.zeros((1, kind.size))])
    is_known = (kind != SurfaceKind.NONE) & np.all(np.abs(terms) < _LARGEST, axis=(0, 1))
    is_known &= np.all(np.isfinite(errors), axis=0)
    terms[..., ~is_known], errors[:, ~is_known], kind[~is_known] = 0.0, np.inf, SurfaceKind.ONE
    meets = np.isin(kind, (SurfaceKind.PAIR, SurfaceKind.CLUSTER))
    scale = np.where(meets, errors[0], errors)
    step = np.exp2(np.floor(np.log2(_STEP * np.clip(scale, _LEAST_ERROR, 1.0))))
    rounded = (np.round(terms / step[:, None]) * step[:, None]).astype(np.float32)
    lost = np.abs(rounded - terms).sum(axis=1) + _BEYOND * np.abs(terms[:, 1:]).sum(axis=1)
    # A mean that is moved moves the roots; the others change the polynomial in w.
    of_polynomial = np.where(kind == SurfaceKind.PAIR, lost[1], WIDEST_CLUSTER * lost[1] + lost[2])
    lost = np.where(meets, np.stack([of_polynomial, lost[0], 0.0 * lost[0]]), lost)
    of_cells = np.concatenate([rounded, _raised(errors + lost + _LEAST_ERROR)[:, None]], axis=1)
    is_used = np.arange(len(terms))[:, None] < np.array(RADIUS_FUNCTIONS)[kind]
    return kind, _strung(of_cells, is_used)


def _strung(of_cells: NDArray[np.float32], is_used: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the functions that are used, those of one cell after those of another: (term, row)."""
    rows = np.moveaxis(of_cells, (0, 1, 2), (1, 2, 0))  # (cell, function, term)
    return np.ascontiguousarray(rows[is_used.T].T)


def _raised(errors: Float64[np.ndarray, "function cell"]) -> NDArray[np.float32]:
    """Round errors up to a few digits, which float32 has and which take little room."""
    fraction, exponent = np.frexp(errors)
    raised = np.ldexp(np.ceil(np.ldexp(fraction, _DIGITS)), exponent - _DIGITS)
    return np.where(np.isfinite(errors), raised, np.inf).astype(np.float32)


# Products of slices (gamma, delta, delay), from the closed form: without a grid.

Arrays = dict[str, NDArray[Any]]


def outlines(plan: Plan, tile: Tile) -> Arrays:
    """Return the outlines of the stable regions of a tile, one after the other."""
    regions = _regions(plan.hands(tile), *_loop(plan, tile))
    points = [_ended(region.points) for region in regions]
    corners = [_ended(region.corners) for region in regions]
    # A piece begins at every point but the last one and the end mark.
    branches = [
        np.append(region.branch, np.full(len(part) - len(region.branch), -1))
        for region, part in zip(regions, points, strict=True)
    ]
    counts = {
        schema.OUTLINE_STATUS: [int(region.status) for region in regions],
        schema.OUTLINE_SIZE: [len(part) for part in points],
        schema.CORNER_COUNT: [len(part) for part in corners],
    }
    shape = plan.shape(schema.OUTLINE_SIZE, tile)
    arrays: Arrays = {name: np.array(n, np.int32).reshape(shape) for name, n in counts.items()}
    outline, corner = np.concatenate(points), np.concatenate(corners)
    return arrays | {
        schema.OUTLINE_ALPHA: outline[:, 0].copy(),
        schema.OUTLINE_BETA: outline[:, 1].copy(),
        schema.OUTLINE_BRANCH: np.concatenate(branches).astype(np.int32),
        schema.CORNER_ALPHA: corner[:, 0].copy(),
        schema.CORNER_BETA: corner[:, 1].copy(),
    }


def summaries(plan: Plan, tile: Tile) -> Arrays:
    """Return the extremes of the stable regions of a tile, and the fastest loops."""
    values = slice_summaries(plan.hands(tile), *_loop(plan, tile))
    return {name: value.reshape(plan.shape(name, tile)) for name, value in values.items()}


def slice_summaries(
    hands: Float64[np.ndarray, "slice 2"], delay: float, filters: Filters | None = None
) -> dict[str, Float64[np.ndarray, " slice"]]:
    """Return the variables of the product ``summary``.

    Args:
        hands: gamma and delta of each slice.
        delay: time delay t_d/T of all of them.
        filters: velocity estimator and position filter of all of them.
    """
    regions = _regions(hands, delay, filters)
    best = minimize_radius(
        gamma=hands[:, 0], delta=hands[:, 1], delay=delay, **as_keywords(filters)
    )
    values = (
        [float(region.max_alpha[0]) for region in regions],
        [float(region.max_alpha[1]) for region in regions],
        [float(region.max_beta[1]) for region in regions],
        [float(region.area) for region in regions],
        best.value,
        best.alpha,
        best.beta,
    )
    return {
        name: np.array(value, np.float64)
        for name, value in zip(schema.SUMMARY, values, strict=True)
    }


def _loop(plan: Plan, tile: Tile) -> tuple[float, Filters | None]:
    return float(plan.grid.delay[tile.delay]), plan.spec.filters


def _regions(
    hands: Float64[np.ndarray, "slice 2"], delay: float, filters: Filters | None
) -> list[StableRegion]:
    keywords = as_keywords(filters)
    return [
        stable_region(gamma=gamma, delta=delta, delay=delay, **keywords)
        for gamma, delta in hands.tolist()
    ]


def _ended(points: Float64[np.ndarray, "point 2"]) -> Float64[np.ndarray, "point_and_end 2"]:
    """Return points and, so that a plot of many breaks off here, one that is not a number."""
    return np.append(points, [[np.nan, np.nan]], axis=0)


def compute_tile(plan: Plan, tile: Tile) -> Arrays:
    """Return what the chosen products hold in a tile, each array of the shape ``plan.shape``.

    Raises:
        ValueError: a parameter is too large for the model.
    """
    arrays: Arrays = {}
    for chosen in plan.spec.products:
        arrays |= _COMPUTED_BY[chosen](plan, tile)
    return arrays


def _verdicts(plan: Plan, tile: Tile) -> Arrays:
    alpha, beta, delay = plan.grid.walls(tile.delay)
    hands = plan.hands(tile)
    nodes = node_verdicts(alpha, beta, hands[:, 0], hands[:, 1], delay, plan.spec.filters)
    cells = np.zeros((0, alpha.size - 1, beta.size - 1), np.int8)
    sides = _sides(plan, tile)
    if sides.size:
        cells = cell_verdicts(alpha, beta, _boxes(sides), delay, plan.spec.filters)
    return {
        VERDICT: np.moveaxis(nodes, 0, -1).reshape(plan.shape(VERDICT, tile)),
        CELL_VERDICT: np.moveaxis(cells, 0, -1).reshape(plan.shape(CELL_VERDICT, tile)),
    }


def _alpha_limits(plan: Plan, tile: Tile) -> Arrays:
    return {ALPHA_LIMITS: alpha_limits(plan, tile, _boxes(_sides(plan, tile)))}


def _sides(plan: Plan, tile: Tile) -> Float64[np.ndarray, "cell hand side"]:
    """Return the ends of the cells of hands in a tile, along gamma and delta."""
    sides = [
        (plan.grid.sides("gamma")[gamma], plan.grid.sides("delta")[delta])
        for gamma in plan.numbers("gamma_cell", tile)
        for delta in plan.numbers("delta_cell", tile)
    ]
    return np.array(sides).reshape(-1, 2, 2)


def _boxes(sides: Float64[np.ndarray, "cell hand side"]) -> HandBoxes:
    half = 0.5 * np.diff(sides, axis=-1)[..., 0] * (1.0 + _BEYOND)
    return HandBoxes(*sides.mean(axis=-1).T, *half.T)


_COMPUTED_BY: Mapping[str, Callable[[Plan, Tile], Arrays]] = {
    VERDICT: _verdicts,
    ALPHA_LIMITS: _alpha_limits,
    SPECTRAL_RADIUS: radii,
    "outline": outlines,
    "summary": summaries,
}

"""For each product the function that computes all of its variables in a tile."""
