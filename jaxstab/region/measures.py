"""Limits, membership, distance and area of a region, measured on the exact boundary.

Between two vertices of an outline alpha and beta are monotone. So a line of constant alpha or beta
meets an edge, once, where it passes between its ends, and a part of an edge lies in the box of its
ends. The polygon only brackets; the numbers are those of the closed form:

- limits are roots of the curve's coordinate on the edges that a row passes;
- a point is inside if an odd number of these crossings lies beyond it;
- distances are to the nearest point of the edges, taken in the order of the distances of their
  boxes, up to where a box is farther than the nearest point so far;
- the area is the integral of alpha d(beta), by Gauss' rule on each edge.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, constant, first_indices, namespace, repeat, repeat_while
from jaxstab.batches import compiled
from jaxstab.region.curve import Curve, curve_and_lift
from jaxstab.region.outline import Outline
from jaxstab.region.pieces import Branch
from jaxstab.region.roots import bracketed_root, nonzero, root_between, with_slope

_CROSSINGS = 8  # of a row with the boundary in JAX; rows with more give NaN
_AT_ONCE = 1 << 20  # pairs of a point and an edge that are held in memory
_LAST_STEP = 1e-10  # radians
_STILL = 1e-13  # of the range: steps that are rounding
_EDGES = 4  # looked at in one step of the search for the nearest
_SUBDIVISIONS = 8  # of an edge, and then of its nearest parts
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(16)


@compiled(static=["axis", "outermost"])
def limits(
    c: Curve, outline: Outline, values: Array, *, axis: int, outermost: bool = True
) -> Array:
    """Return where lines of constant alpha (axis 0) or beta (axis 1) enter and leave the region.

    That is the first entry and the last exit or, if not ``outermost``, the last entry and exit.
    """

    def ends(values: Array) -> Array:
        xp = namespace(c, outline, values)
        coordinates, exist = _crossings(c, outline, values, axis, _met(outline, values, axis))
        most = xp.max(xp.where(exist, coordinates, -xp.inf), axis=-1)
        if outermost:
            least = xp.min(xp.where(exist, coordinates, xp.inf), axis=-1)
        else:
            last = xp.argmax(xp.where(exist, coordinates, -xp.inf), axis=-1)
            others = exist & (xp.arange(exist.shape[-1]) != last[..., None])
            least = xp.max(xp.where(others, coordinates, -xp.inf), axis=-1)
        return xp.where(xp.any(exist, axis=-1)[:, None], xp.stack([least, most], axis=-1), xp.nan)

    return _in_batches(ends, outline, values).reshape(*values.shape, 2)


def quadrant_extremes(c: Curve, outline: Outline) -> tuple[Array, Array]:
    """Return the points of the largest alpha and of the largest beta where the other is >= 0.

    Each is a vertex, or the last crossing with the axis of that gain; NaN if no gain is positive.
    """
    return _extreme(c, outline, 0), _extreme(c, outline, 1)


def _extreme(c: Curve, outline: Outline, axis: int) -> Array:
    xp = namespace(c, outline)
    other = xp.nan_to_num(outline.vertices[:, 1 - axis], nan=-xp.inf)
    is_allowed = other >= -_STILL * xp.max(other)  # a corner on the axis may be beside it
    values = xp.where(is_allowed, outline.vertices[:, axis], -xp.inf)
    largest, crossing = xp.max(values), limits(c, outline, xp.zeros(1), axis=1 - axis)[0, 1]
    on_axis = xp.stack([crossing, xp.zeros_like(crossing)][:: 1 - 2 * axis])
    is_crossing = crossing - largest > _STILL * abs(crossing)
    point = xp.where(is_crossing, on_axis, outline.vertices[xp.argmax(values)])
    size = xp.max(abs(xp.nan_to_num(outline.vertices[:, axis])))
    is_there = xp.where(is_crossing, crossing, largest) > _STILL * size
    return xp.where(is_there, point, xp.nan) + 0.0  # no -0


def crossings(
    c: Curve, outline: Outline, values: Float64[np.ndarray, " row"], *, axis: int
) -> Float64[np.ndarray, "row crossing"]:
    """Return the ends of all intervals on lines as in ``limits``, ascending, then NaN."""
    with np.errstate(all="ignore"):  # as where it is compiled
        coordinates, exist = _crossings(c, outline, values, axis, _met(outline, values, axis))
    return np.sort(np.where(exist, coordinates, np.nan), axis=-1)


@compiled()
def contains(c: Curve, outline: Outline, alpha: Array, beta: Array) -> Array:
    """Return whether an odd number of crossings of the row lies beyond alpha."""

    def is_inside(alpha: Array, beta: Array) -> Array:
        xp = namespace(c, outline, alpha, beta)
        met, beyond = _met(outline, beta, 1), outline.vertices[:, 0] > alpha[:, None]
        here, there = beyond[:, :-1], beyond[:, 1:]
        count = xp.sum(met & here & there, axis=-1)
        unsure = met & (here != there)  # alpha is between the ends of the edge
        if xp is not np or unsure.any():
            coordinates, exist = _crossings(c, outline, beta, 1, unsure)
            count = count + xp.sum(exist & (coordinates > alpha[:, None]), axis=-1)
        return count % 2 == 1

    return _in_batches(is_inside, outline, alpha, beta).reshape(alpha.shape)


@compiled()
def distance(c: Curve, outline: Outline, alpha: Array, beta: Array) -> Array:
    """Return the distance to the exact boundary, positive inside."""

    def to_boundary(alpha: Array, beta: Array) -> Array:
        points = namespace(alpha, beta).stack([alpha, beta], axis=-1)
        away = points - _nearest(c, outline, points)
        return namespace(away).hypot(away[:, 0], away[:, 1])

    xp = namespace(c, outline, alpha, beta)
    nothing = xp.where(outline.resolved, xp.inf, xp.nan)
    away = _in_batches(to_boundary, outline, alpha, beta).reshape(alpha.shape)
    away = xp.where(outline.size > 0, away, nothing)
    return xp.where(contains(c, outline, alpha, beta), away, -away)


@compiled()
def area(c: Curve, outline: Outline) -> Array:
    """Return the integral of alpha d(beta) around the boundary, by Gauss' rule on each piece."""
    xp = namespace(c, outline)
    begin, end = outline.angles[:, :1], outline.angles[:, 1:]
    half = 0.5 * (end - begin)
    theta = begin + half * (1.0 + _GAUSS_NODES)
    (alpha, _), (_, slope) = with_slope(lambda angle: _point(c, angle), theta)
    on_curve = xp.sum(half * alpha * slope * _GAUSS_WEIGHTS, axis=1)
    here, there = outline.vertices[:-1], outline.vertices[1:]
    on_line = 0.5 * (here[:, 0] + there[:, 0]) * (there[:, 1] - here[:, 1])
    pieces = xp.where(outline.branches == Branch.CURVE, on_curve, on_line)
    enclosed = xp.sum(xp.where(outline.branches < 0, 0.0, pieces))
    return xp.where(outline.resolved, enclosed, xp.nan)


def deviation(c: Curve, outline: Outline) -> Array:
    """Return how far the boundary leaves the polygon, as a share of the region's diameter."""
    xp = namespace(c, outline)
    middle = xp.stack(_point(c, xp.mean(outline.angles, axis=1)), axis=-1)
    here, there = outline.vertices[:-1], outline.vertices[1:]
    away = middle - _foot_on_chord(here, there, middle)
    bulges = xp.hypot(away[:, 0], away[:, 1])
    size = xp.hypot(*(xp.max(outline.vertices, axis=0) - xp.min(outline.vertices, axis=0)))
    return xp.max(xp.where(outline.branches == Branch.CURVE, bulges, 0.0)) / size


def _point(c: Curve, theta: Array, low: Array | float = 0.0) -> Array:
    return namespace(c, theta).stack(curve_and_lift(c, theta, low)[:2])


def _in_batches(function: Callable[..., Array], outline: Outline, *columns: Array) -> Array:
    """Apply a function of points to columns of any shape, in parts that fit into memory."""
    size = max(1, _AT_ONCE // len(outline.angles))
    flat = [column.ravel() for column in columns]
    if flat[0].size <= size:
        return function(*flat)
    if namespace(outline, columns) is np:
        parts = range(0, flat[0].size, size)
        return np.concatenate([function(*(x[i : i + size] for x in flat)) for i in parts])
    import jax

    def single(point: tuple[Array, ...]) -> Array:
        return function(*(value[None] for value in point))[0]

    return jax.lax.map(single, tuple(flat), batch_size=size)


# ------------------------------------------------------------------------ crossings of a row


def _crossings(
    c: Curve, outline: Outline, values: Array, axis: int, met: Array
) -> tuple[Array, Array]:
    """Return the other coordinate (row, crossing) where rows meet edges, and which exist."""
    xp = namespace(c, outline, values)
    fixed = constant(outline)
    count = xp.sum(met, axis=-1)
    edges = first_indices(met, int(np.max(count, initial=1)) if xp is np else _CROSSINGS)
    exist = edges < len(fixed.branches)
    edges = xp.where(exist, edges, 0)
    values = xp.broadcast_to(values[:, None], edges.shape)

    def excess(parameters: tuple[Curve, Array], theta: Array) -> Array:
        slice_, goal = parameters
        return _point(slice_, theta)[axis] - goal

    angles = fixed.angles[edges]
    theta = bracketed_root(excess, (c, values), angles[..., 0], angles[..., 1])
    here, there = outline.vertices[edges], outline.vertices[edges + 1]
    run = nonzero(there[..., axis] - here[..., axis], 1.0)
    share = (values - here[..., axis]) / run
    on_line = here[..., 1 - axis] + share * (there[..., 1 - axis] - here[..., 1 - axis])
    low = _last_steps(c, theta, values, axis)
    on_curve = curve_and_lift(c, theta, low)[1 - axis]
    coordinates = xp.where(fixed.branches[edges] == Branch.CURVE, on_curve, on_line)
    return xp.where((count <= edges.shape[-1])[:, None], coordinates, xp.nan), exist


def _met(outline: Outline, values: Array, axis: int) -> Array:
    """Return which edges (row, edge) rows meet."""
    above = constant(outline).vertices[:, axis] > values[:, None]
    return (above[:, :-1] != above[:, 1:]) & (outline.branches >= 0)


def _last_steps(c: Curve, theta: Array, values: Array, axis: int) -> Array:
    """Return Newton's steps from a crossing's angle: close to pi, what rounding took from it."""
    fixed, theta, values = constant((c, theta, values))
    xp = namespace(fixed, theta)

    def stepped(low: Array) -> Array:
        here, tangent = with_slope(partial(_point, fixed, low=low), theta)
        step = (values - here[axis]) / nonzero(tangent[axis], 1.0)
        return xp.clip(low + step, -_LAST_STEP, _LAST_STEP)

    # Where the curve flies off, one is not enough.
    return constant(repeat(2, stepped, xp.zeros_like(theta)))


# ------------------------------------------------------------------------ the nearest point


def _nearest(c: Curve, outline: Outline, points: Array) -> Array:
    """Return the nearest points (point, 2) of the boundary.

    Edges are looked at in the order of the distances of their boxes, up to where a box is farther
    than the nearest point so far. In JAX the nearest point moves with the slice, but not with the
    point: to first order the distance is the same.
    """
    xp = namespace(c, outline, points)
    polygon, slice_, fixed = constant((outline, c, points))
    here, there = polygon.vertices[:-1], polygon.vertices[1:]
    far = _box_distances(here, there, fixed[:, None])
    far = xp.where(polygon.branches >= 0, far, xp.inf)
    order = xp.argsort(far, axis=-1)[:, : len(here)]
    bounds = xp.take_along_axis(far, order, axis=-1)
    rows = xp.arange(len(points))

    def is_open(state: tuple[Array, ...]) -> Array:
        count, best = state[:2]
        following = xp.minimum(count, len(here) - 1)
        return (count < len(here)) & xp.any(bounds[:, following] < best)

    def step(state: tuple[Array, ...]) -> tuple[Array, ...]:
        count, best, edge, theta = state
        columns = xp.minimum(count + xp.arange(_EDGES), len(here) - 1)
        edges = order[:, columns]
        away, feet = _feet(slice_, polygon, edges, fixed)
        away = xp.where(bounds[:, columns] < xp.inf, away, xp.inf)
        nearest = xp.argmin(away, axis=-1)
        least = away[rows, nearest]
        closer = least < best
        return (
            count + _EDGES,
            xp.where(closer, least, best),
            xp.where(closer, edges[rows, nearest], edge),
            xp.where(closer, feet[rows, nearest], theta),
        )

    start = (
        xp.asarray(0),
        xp.full(len(points), xp.inf),
        xp.zeros(len(points), int),
        xp.ones(len(points)),
    )
    _, _, edge, theta = constant(repeat_while(is_open, step, start))
    on_curve = xp.stack(curve_and_lift(c, theta)[:2], axis=-1)
    on_line = _foot_on_chord(outline.vertices[edge], outline.vertices[edge + 1], fixed)
    return xp.where((polygon.branches[edge] == Branch.CURVE)[:, None], on_curve, on_line)


def _box_distances(here: Array, there: Array, points: Array) -> Array:
    """Return the distances of points to boxes, given by two opposite corners."""
    xp = namespace(here, there, points)
    low, high = xp.minimum(here, there), xp.maximum(here, there)
    beside = xp.maximum(xp.maximum(low - points, points - high), 0.0)
    return xp.hypot(beside[..., 0], beside[..., 1])


def _feet(c: Curve, outline: Outline, edges: Array, points: Array) -> tuple[Array, Array]:
    """Return the distances (point, edge) of points to some edges each, and the angles there.

    An edge of the curve is divided, and so is its part with the nearest box, with its neighbours;
    around the nearest of all ends the root of (curve - point) . tangent is the foot.
    """
    xp = namespace(c, outline, points)
    angles = outline.angles[edges]
    here, there = outline.vertices[edges], outline.vertices[edges + 1]
    begin, end = angles[..., 0], angles[..., 1]
    target = xp.moveaxis(points, -1, 0)[..., None]

    def gap(theta: Array) -> Array:
        alpha, beta = _point(c, theta)
        return xp.hypot(alpha - target[0][..., None], beta - target[1][..., None])

    shares = np.arange(_SUBDIVISIONS + 1) / _SUBDIVISIONS

    def narrowed(ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        parts = low[..., None] + (high - low)[..., None] * shares
        nearest = xp.argmin(gap(parts), axis=-1)[..., None]
        before, after = xp.maximum(nearest - 1, 0), xp.minimum(nearest + 1, _SUBDIVISIONS)
        low, high = (xp.take_along_axis(parts, index, axis=-1)[..., 0] for index in (before, after))
        return low, high

    def along(theta: Array) -> Array:
        point, tangent = with_slope(lambda angle: _point(c, angle), theta)
        return xp.sum((point - target) * tangent, axis=0)

    begin, end = repeat(2, narrowed, (begin, end))
    candidates = xp.stack([begin, root_between(along, begin, end), end], axis=-1)
    gaps = gap(candidates)
    best = xp.argmin(gaps, axis=-1)[..., None]
    theta = xp.take_along_axis(candidates, best, axis=-1)[..., 0]
    to_curve = xp.take_along_axis(gaps, best, axis=-1)[..., 0]
    away = _foot_on_chord(here, there, points[:, None]) - points[:, None]
    to_line = xp.hypot(away[..., 0], away[..., 1])
    is_curve = outline.branches[edges] == Branch.CURVE
    return xp.where(is_curve, to_curve, to_line), theta


def _foot_on_chord(here: Array, there: Array, points: Array) -> Array:
    """Return the nearest points of chords between two points each."""
    xp = namespace(here, there, points)
    chord = there - here
    square = nonzero(xp.sum(chord**2, axis=-1), 1.0)
    share = xp.sum((points - here) * chord, axis=-1) / square
    return here + xp.clip(share, 0.0, 1.0)[..., None] * chord


def turns(coordinate: Array) -> int:
    """Return how often a closed sequence changes between rising and falling."""
    if not coordinate.size:
        return 0
    steps = np.diff(coordinate)
    ways = np.sign(np.where(np.abs(steps) > _STILL * np.ptp(coordinate), steps, 0.0))
    ways = ways[ways != 0]
    return int(np.sum(ways != np.roll(ways, 1)))
