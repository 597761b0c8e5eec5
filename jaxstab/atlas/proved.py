"""Verdicts of nodes and cells, and axes that hold all stable walls, proved column by column.

A column is a cell along beta over a box of hands. Between the pieces of the boundary that pass
through it lie gaps, each with one proved verdict (``jaxstab.proofs.columns``). A node in a gap of a
column beside it has the verdict of the gap, and so has a cell that lies in one gap of its column.
The few nodes in no gap are computed one by one.
"""

from itertools import product
from math import exp, floor
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int32, Int64

from jaxstab.atlas.lookup import WHOLE_ALPHA, WHOLE_BOTH, surface
from jaxstab.conventions import Verdict
from jaxstab.model import by_name
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.point import verdict
from jaxstab.proofs.columns import StableColumns, column_gaps, stable_columns
from jaxstab.proofs.curve_patches import Domain
from jaxstab.proofs.plant import NUMERATOR_SLOPES, HandBoxes
from jaxstab.rounding import RAISED_MUCH

if TYPE_CHECKING:
    from jaxstab.atlas.plan import Grid

AlphaNodes = Float64[np.ndarray, " alpha_node"]
BetaNodes = Float64[np.ndarray, " beta_node"]
Hands = Float64[np.ndarray, " hand"]


def node_verdicts(
    alpha: AlphaNodes,
    beta: BetaNodes,
    gamma: Hands,
    delta: Hands,
    delay: float,
    filters: Filters | None = None,
) -> Int8[np.ndarray, "hand alpha_node beta_node"]:
    """The verdicts of all (alpha, beta) for each pair (gamma, delta); two or more nodes of beta."""
    codes = proved_nodes(alpha, beta, gamma, delta, delay, filters)
    hand, j, i = np.nonzero(codes == Verdict.UNDECIDED)
    if hand.size:
        point = alpha[i], beta[j], gamma[hand], delta[hand]
        codes[hand, j, i] = verdict(
            **by_name(*point, delay), resolve="exact", **as_keywords(filters)
        )
    return codes.swapaxes(1, 2)


def cell_verdicts(
    alpha: AlphaNodes,
    beta: BetaNodes,
    hands: HandBoxes,
    delay: float,
    filters: Filters | None = None,
) -> Int8[np.ndarray, "box alpha_cell beta_cell"]:
    """The verdicts proved for whole cells, else UNDECIDED, for each box of (gamma, delta)."""
    codes = _codes(alpha, beta, hands, delay, filters, nodes=2)
    return codes.swapaxes(1, 2)


def proved_nodes(
    alpha: AlphaNodes,
    beta: BetaNodes,
    gamma: Hands,
    delta: Hands,
    delay: float,
    filters: Filters | None = None,
) -> Int8[np.ndarray, "hand beta_node alpha_node"]:
    """The verdicts of the nodes that are in a gap, the others UNDECIDED, for each pair."""
    still = np.zeros_like(gamma)
    hands = HandBoxes(gamma, delta, still, still)
    beside = _codes(alpha, beta, hands, delay, filters, nodes=1)
    codes = np.concatenate([beside, beside[:, -1:]], axis=1)
    np.minimum(codes[:, 1:], beside, out=codes[:, 1:])  # UNDECIDED is the largest code
    return codes


def _codes(
    alpha: AlphaNodes,
    beta: BetaNodes,
    hands: HandBoxes,
    delay: float,
    filters: Filters | None,
    nodes: int,
) -> Int8[np.ndarray, "box beta_cell along_alpha"]:
    """Return a code for each run of ``nodes`` neighbours along alpha that is in one gap."""
    domain = Domain((float(alpha[0]), float(alpha[-1])), (float(beta[0]), float(beta[-1])))
    gaps = column_gaps(beta, hands, delay, domain, filters)
    start = np.searchsorted(alpha, gaps.low, "right")
    stop = np.searchsorted(alpha, gaps.high, "left") + 1 - nodes
    is_decided = (start < stop) & np.isin(gaps.verdict, (Verdict.STABLE, Verdict.UNSTABLE))
    ends = np.stack([start, stop], axis=-1) * is_decided[..., None]
    shape = hands.gamma.size, beta.size - 1, alpha.size + 1 - nodes
    return _filled(ends.reshape(*shape[:2], -1), gaps.verdict, shape[-1])


def _filled(
    ends: Int64[np.ndarray, "box column end"], codes: Int8[np.ndarray, "box column gap"], count: int
) -> Int8[np.ndarray, "box column count"]:
    """Return the code of each gap from its first index to its last; between gaps UNDECIDED."""
    ends = np.maximum.accumulate(ends, axis=-1)  # a gap that holds nothing begins where it ends
    lengths = np.diff(ends, axis=-1, prepend=0, append=count)
    runs = np.full(lengths.shape, Verdict.UNDECIDED, np.int8)
    runs[..., 1::2] = codes
    return np.repeat(runs.ravel(), lengths.ravel()).reshape(*ends.shape[:-1], count)


# Which axes of an atlas hold the whole stable set, so that walls beyond them are unstable.
#
# Lemma B22 of docs/proofs.md bounds the gains of all stable walls, crudely; between an end of an
# axis and its bound, columns prove that nothing is stable. One box holds all hands of the atlas and
# one cell of its delays. Where that proves too little, the delays are halved; at one delay alone,
# the atlas's own cells of hands are tried.

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


def whole_axes(grid: "Grid", filters: Filters | None) -> Int32[np.ndarray, " delay_cell"]:
    """Which axes hold the whole stable set, by ``LIMIT_WHOLE``, per cell of delays (lemma B22)."""
    return np.array([_whole(grid, row, filters) for row in grid.limit_range.tolist()], np.int32)


def _whole(grid: "Grid", row: list[float], filters: Filters | None) -> int:
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


def _bounds(grid: "Grid", samples_late: int, window: int) -> Bounds:
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
    grid: "Grid",
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
    halves = (early, middle), (middle, late)
    return all(_proved(grid, ends, edges, alpha, filters, halvings - 1) for ends in halves)


def _boxes(grid: "Grid", *, cells: bool) -> HandBoxes:
    sides = [grid.sides(name) for name in ("gamma", "delta")]
    if not cells:
        sides = [np.array([[along[0, 0], along[-1, 1]]]) for along in sides]
    pairs = np.array(list(product(*sides)))
    gamma, delta = pairs[:, 0], pairs[:, 1]
    halves = (0.5 * (along[:, 1] - along[:, 0]) * RAISED_MUCH for along in (gamma, delta))
    return HandBoxes(gamma.mean(axis=1), delta.mean(axis=1), *halves)


@np.errstate(over="ignore", invalid="ignore")
def _is_empty(
    columns: StableColumns, edges: Floats, hands: HandBoxes, delays: Ends, least: float
) -> Bool[np.ndarray, "box column"]:
    """Whether no alpha from the least one of the domain on is stable, for each column."""
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
