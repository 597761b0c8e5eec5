"""Which axes of an atlas hold the whole stable set, so that walls beyond them are unstable.

Lemma B22 of docs/proofs.md bounds the gains of all stable walls, crudely; between an end of an axis
and its bound, columns (``proofs.columns``) prove that nothing is stable. One box holds all hands of
the atlas and one cell of its delays. Where that proves too little, the delays are halved; at one
delay alone, the atlas's own cells of hands are tried.
"""

from itertools import product
from math import exp, floor
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int32

from jaxstab.atlas.compute.layout import Grid
from jaxstab.atlas.products.limits import WHOLE_ALPHA, WHOLE_BOTH, surface
from jaxstab.model.filters import Filters
from jaxstab.proofs.columns import StableColumns, stable_columns
from jaxstab.proofs.curve_patches import Domain
from jaxstab.proofs.plant import NUMERATOR_SLOPES, HandBoxes
from jaxstab.rounding import RAISED_MUCH

_COLUMNS = 24  # along beta
_NEAREST = 0.02  # of the way to a bound of beta: how wide the first column is
_HALVINGS = 1  # of a cell of delays
_LEAST_NUMERATOR = 0.25  # |N| below which no bound is tried
_LARGEST_BOUND = 1e6
Ends = tuple[float, float]
Floats = Float64[np.ndarray, " edge"]


class Bounds(NamedTuple):
    """Gains beyond which no wall is stable: the largest alpha, and the largest |beta|."""

    alpha: float
    beta: float


def whole_axes(grid: Grid, filters: Filters | None) -> Int32[np.ndarray, " delay_cell"]:
    """Which axes hold the whole stable set, by ``LIMIT_WHOLE``, per cell of delays (lemma B22)."""
    return np.array([_whole(grid, row, filters) for row in grid.limit_range.tolist()], np.int32)


def _whole(grid: Grid, row: list[float], filters: Filters | None) -> int:
    early, late, least, most, low, high = row
    samples = _window(filters)
    if samples is None or least > -grid.gamma[-1]:
        return 0
    bounds = _bounds(grid, floor(early), samples)
    edges = np.linspace(low, high, _COLUMNS + 1)
    if not _proved(grid, (early, late), edges, (most, bounds.alpha), filters):
        return 0
    if samples > 1:  # there are islands beyond
        return WHOLE_ALPHA
    alphas = -float(grid.gamma[-1]), bounds.alpha
    away = np.geomspace(_NEAREST, 1.0 + _NEAREST, _COLUMNS + 1) - _NEAREST
    above = high + (bounds.beta - high) * away
    below = (low - (bounds.beta + low) * away)[::-1]
    is_whole = all(
        edges[0] >= edges[-1] or _proved(grid, (early, late), edges, alphas, filters)
        for edges in (above, below)
    )
    return WHOLE_BOTH if is_whole else WHOLE_ALPHA


def _window(filters: Filters | None) -> int | None:
    """Return the samples of the difference that is the velocity; None for other loops."""
    if filters is None:
        return 1
    velocity, position = filters
    samples, stages = velocity.stages()
    return None if stages or position.stages() else samples


def _bounds(grid: Grid, samples_late: int, window: int) -> Bounds:
    """Return the bounds of lemma B22, for all hands and a delay within one sample."""
    gamma, delta = float(grid.gamma[-1]), float(grid.delta[-1])
    per_gamma, per_delta, _ = NUMERATOR_SLOPES
    change = per_gamma * gamma + per_delta * delta
    at_one, at_i = 1.0 - change, 0.5 - change
    if at_i < _LEAST_NUMERATOR:
        return Bounds(np.inf, np.inf)
    degree = 3 + samples_late + window
    alpha = 2.0**degree / at_one
    if samples_late >= 1:
        roots = 1.0 + exp(-delta) - gamma * (1.0 + change)
        alpha = min(alpha, max(2.0 - 2.0 * roots / degree, 0.0) ** (0.5 * degree) / at_one)
    return Bounds(alpha * RAISED_MUCH, (2.0 ** (0.5 * degree) + 4.0) / at_i * RAISED_MUCH)


def _proved(
    grid: Grid,
    delays: Ends,
    edges: Floats,
    alpha: Ends,
    filters: Filters | None,
    halvings: int = _HALVINGS,
) -> bool:
    """Whether no wall is stable between two alphas in columns along beta, for all hands."""
    if alpha[0] >= alpha[1]:
        return True
    if not max(alpha[1], *np.abs(edges)) <= _LARGEST_BOUND:
        return False
    early, late = delays
    middle = 0.5 * (early + late)
    half = float(np.nextafter(max(middle - early, late - middle), np.inf)) if late > early else 0.0
    domain = Domain(alpha, (float(edges[0]), float(edges[-1])))
    for cells in (False,) if half else (False, True):
        hands = _boxes(grid, cells=cells)
        columns = stable_columns(edges, hands, middle, domain, filters, half)
        if np.all(_is_empty(columns, edges, hands, (middle, half), alpha[0])):
            return True
    if not halvings or not half:
        return False
    parts = (early, middle), (middle, late)
    return all(_proved(grid, part, edges, alpha, filters, halvings - 1) for part in parts)


def _boxes(grid: Grid, *, cells: bool) -> HandBoxes:
    sides = [grid.sides(name) for name in ("gamma", "delta")]
    if not cells:
        sides = [np.array([[along[0, 0], along[-1, 1]]]) for along in sides]
    pairs = np.array([(one, other) for one in sides[0] for other in sides[1]])
    gamma, delta = pairs[:, 0], pairs[:, 1]
    halves = (0.5 * (along[:, 1] - along[:, 0]) * RAISED_MUCH for along in (gamma, delta))
    return HandBoxes(gamma.mean(axis=1), delta.mean(axis=1), *halves)


@np.errstate(over="ignore", invalid="ignore")
def _is_empty(
    columns: StableColumns, edges: Floats, hands: HandBoxes, delays: Ends, least: float
) -> Bool[np.ndarray, "box column"]:
    """Say of which columns no alpha from the least one of their domain on is stable."""
    lower, upper = columns.lower, np.moveaxis(columns.upper, -1, 0)
    middle, half = delays
    sides: list[list[Any]] = [
        [edges[:-1], edges[1:]],
        [(hands.gamma + side * hands.half_gamma)[:, None] for side in (-1.0, 1.0)],
        [(hands.delta + side * hands.half_delta)[:, None] for side in (-1.0, 1.0)],
        [middle - half, middle + half],
    ]
    tops = [surface(upper, *corner) for corner in product(*sides)]
    bend = np.abs(upper[5]) * half**2  # between the corners, of the square of the delay
    ends_below = np.max(tops, axis=0) + upper[-1] + bend <= least
    is_empty: np.ndarray = (np.isposinf(lower[..., 0]) & np.isfinite(lower[..., -1])) | ends_below
    return is_empty
