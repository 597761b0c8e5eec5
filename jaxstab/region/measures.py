"""Closed polygons on the exact boundary, and what is measured on it: limits, distance, area.

Arcs and straight parts are in order, with points where the boundary bends. Vertices are spread over
the arcs by how much these bend; straight parts get few. Between two vertices alpha and beta are
monotone, because turning points of either are vertices as well. Every vertex is a point of the
curve, exact to rounding.

So a line of constant alpha or beta meets an edge, once, where it passes between its ends, and a
part of an edge lies in the box of its ends. The polygon only brackets; the numbers are those of the
curve:

- limits are roots of the curve's coordinate on the edges that a row passes;
- a point is inside if an odd number of these crossings lies beyond it, and next to the boundary if
  balls prove the wall stable;
- distances are to the nearest point of the edges, taken in the order of the distances of their
  boxes, up to where a box is farther than the nearest point so far;
- the area is that of the polygon and of what lies between it and the curve, by Gauss' rule.

All is computed by NumPy. Gains of JAX are answered on the host, with slopes: limits move along the
boundary, distances along the way to it.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int

from jaxstab.arrays import Array, constant, joined, namespace, tree_map
from jaxstab.batches import on_host
from jaxstab.region.curve import (
    Angles,
    Curve,
    bracketed_root,
    curve_errors,
    curve_gains,
    gains_and_slopes,
    nonzero,
    true_angles,
)
from jaxstab.region.pieces import NO_BRANCH, Branch, Pieces


class Outline(NamedTuple):
    """A polygon with its corners on the exact boundary, counter-clockwise, in arrays of one length.

    ``vertices`` (n, 2) are points (alpha, beta); each loop ends with its first point. ``branches``
    (n - 1,) are Branch codes of the edges, and ``angles`` (n - 1, 2) those of the root on the
    circle at their ends: two that are equal on an edge that is straight. Between two vertices alpha
    and beta are monotone. ``size`` is n, or 0 for an outline without points, which has two vertices
    that are NaN; they form ``loops`` loops. ``corners`` are points where two branches meet.
    Rounding may have moved the curve by ``errors`` in alpha and in beta.
    """

    vertices: Array
    branches: Array
    angles: Array
    size: int
    loops: int
    corners: Array
    resolved: bool
    errors: Array

    @property
    def is_curved(self) -> Bool[np.ndarray, " edge"]:
        """True for edges that are parts of the curve."""
        return (self.branches == Branch.CURVE) & (self.angles[:, 0] != self.angles[:, 1])


def empty_outline(*, resolved: bool) -> Outline:
    """Return the outline of no region: one edge that is none."""
    vertices, corners = np.full((2, 2), np.nan), np.empty((0, 2))
    one_edge = np.array([NO_BRANCH]), np.zeros((1, 2))
    return Outline(vertices, *one_edge, 0, 0, corners, resolved, np.zeros(2))


Survey = tuple[Array, Array, tuple[Array, Angles]]
"""Angles (piece, node), the tangents there (2, piece, node), and where alpha or beta turns."""


def polygon(c: Curve, pieces: Pieces, seen: Survey, points: int) -> Outline:
    """Return an outline of about ``points`` vertices, spread so that all edges bend alike.

    It has corners and turning points besides. The pieces are closed.
    """
    nodes, tangents, turns = seen
    marks = [turns, _spread(nodes, tangents, points)]
    piece, theta = (np.concatenate(column) for column in zip(*marks, strict=True))
    is_within = (theta > pieces.begin[piece]) & (theta < pieces.end[piece])
    piece, theta = piece[is_within], theta[is_within]
    order = np.lexsort([theta, piece])
    piece, theta = piece[order], theta[order]
    is_new = np.append(True, (np.diff(theta) > 0.0) | (np.diff(piece) > 0))[: len(theta)]
    piece, theta = piece[is_new], theta[is_new]
    walls = curve_gains(c, theta).T
    own = [slice(*np.searchsorted(piece, [k, k + 1]).tolist()) for k in range(len(pieces.begin))]

    vertices: list[Array] = []
    branches: list[Array] = []
    angles: list[Array] = []
    corners: list[Array] = []
    waiting, loops = dict.fromkeys(range(len(pieces.begin))), 0
    while waiting:
        first = arc = next(iter(waiting))
        if loops:
            branches.append(np.array([NO_BRANCH]))
            angles.append(np.zeros((1, 2)))
        while arc in waiting:
            del waiting[arc]
            along = np.concatenate([pieces.begin[[arc]], theta[own[arc]], pieces.end[[arc]]])
            vertices += [pieces.begin_wall[[arc]], walls[own[arc]]]
            branches.append(np.full(len(along) - 1, Branch.CURVE))
            angles.append(np.stack([along[:-1], along[1:]], axis=1))
            corners.append(pieces.begin_wall[arc])
            here = pieces.end_wall[arc]
            for edge in pieces.edges[arc]:
                vertices.append(here[None])
                branches.append(np.array([edge.branch]))
                angles.append(np.full((1, 2), edge.angle))
                corners.append(here)
                here = edge.wall
            arc = pieces.successor[arc]
        vertices.append(pieces.begin_wall[[first]])
        loops += 1
    points_of = np.concatenate(vertices)
    is_arc = pieces.begin < pieces.end
    ends = pieces.begin[is_arc], pieces.end[is_arc]
    errors = curve_errors(c, np.concatenate([ends[0], theta[::4], ends[1]]))
    return Outline(
        vertices=points_of,
        branches=np.concatenate(branches),
        angles=np.concatenate(angles),
        size=len(points_of),
        loops=loops,
        corners=np.array(corners),
        resolved=True,
        errors=np.max(np.nan_to_num(errors, nan=np.inf), axis=1, initial=0.0),
    )


def survey(c: Curve, pieces: Pieces) -> Survey:
    """Look where pieces bend and turn."""
    count = 81  # per piece, to see where it bends and turns
    first = np.geomspace(1e-6, 1e-2, 5)  # of a piece: where a curve with zero speed starts
    aside, few = 1e-8, 24  # of the same; places that are looked at in any case
    # At th = 0 and pi the curve has zero speed: look beside.
    beside = aside * (pieces.end - pieces.begin)[:, None]
    begin, end = pieces.begin[:, None] + beside, pieces.end[:, None] - beside
    even = np.linspace(0.0, 1.0, count - 2 * (count // 4))
    nodes = [begin + (end - begin) * np.concatenate([first, even, 1.0 - first])]
    # Half of them close in on the angles at which the curve flies off.
    shares = (np.arange(count // 4) + 0.5) / (count // 4)
    poles = np.stack([c.poles, np.full(len(c.poles), aside)])
    angle, apart = np.concatenate([poles, c.resonances], axis=1)
    places, widths = np.append(angle, -angle), np.tile(apart, 2)
    away = np.maximum(np.maximum(begin - places, places - end), 0.0)
    close = max(few, int(np.max(np.sum(away < end - begin, axis=1))))  # others leave a piece even
    nearest = np.argsort(away, axis=1, kind="stable")[:, :close, None]
    place, width, *ends = places[nearest], widths[nearest], begin[:, None], end[:, None]
    low, high = (np.arcsinh((limit - place) / width) for limit in ends)
    closing = np.clip(place + width * np.sinh(low + (high - low) * shares), *ends)
    nodes.append(closing.reshape(len(begin), -1))
    ordered = np.sort(np.concatenate(nodes, axis=1), axis=1)
    tangents = gains_and_slopes(c, ordered)[1]
    return ordered, tangents, _turning_points(c, ordered, tangents)


def _turning_points(c: Curve, nodes: Array, tangents: Array) -> tuple[Array, Angles]:
    rounding = 1e-10  # a coordinate that moves less than that is constant
    moves = abs(tangents) > rounding * np.hypot(*tangents)
    turns = (tangents[..., 1:] * tangents[..., :-1] < 0.0) & (moves[..., 1:] | moves[..., :-1])
    is_beta, piece, node = np.nonzero(turns)

    def slope(theta: Array) -> Array:
        along_alpha, along_beta = gains_and_slopes(c, theta)[1]
        return np.where(is_beta == 1, along_beta, along_alpha)

    ends = tangents[is_beta, piece, node], tangents[is_beta, piece, node + 1]
    return piece, bracketed_root(slope, nodes[piece, node], nodes[piece, node + 1], ends)


def _spread(nodes: Array, tangents: Array, count: int) -> tuple[Array, Angles]:
    """Return points between which the boundary leaves its chord alike: pieces and angles."""
    evenness = 0.1  # the share of points that straight parts get
    alpha, beta = tangents
    turned = abs(alpha[:, 1:] * beta[:, :-1] - alpha[:, :-1] * beta[:, 1:])
    speed = np.hypot(alpha, beta)
    steps = np.diff(nodes, axis=1)
    bend = np.nan_to_num(np.sqrt(turned * steps / (speed[:, 1:] + speed[:, :-1])))
    bend = bend + evenness * np.sum(bend) / bend.size
    total = np.cumsum(bend.ravel())
    goal = total[-1] * (np.arange(count) + 0.5) / count
    step = np.minimum(np.searchsorted(total, goal), total.size - 1)
    width = bend.ravel()[step]
    share = np.where(width > 0.0, (goal - total[step]) / np.where(width > 0.0, width, 1.0), 0.0)
    piece, node = np.unravel_index(step, bend.shape)
    return piece, nodes[piece, node + 1] + steps[piece, node] * share


# The loops of an outline, and which roots are on the circle at its vertices.


def loop_ends(outline: Outline) -> list[tuple[int, int]]:
    """Return the first and the last vertex of each loop, which are the same point."""
    last = outline.size - 1
    breaks = np.flatnonzero(outline.branches == NO_BRANCH).tolist()
    return list(zip([0, *(end + 1 for end in breaks)], [*breaks, last], strict=True))


def polygon_area(outline: Outline) -> float:
    """Return the area that the polygon encloses; holes count as less, a hole alone is negative."""
    alpha, beta = (outline.vertices - outline.vertices[0]).T
    swept = alpha[:-1] * beta[1:] - alpha[1:] * beta[:-1]
    return 0.5 * float(np.sum(np.where(outline.branches >= 0, swept, 0.0)))


def vertex_roots(
    c: Curve, outline: Outline
) -> tuple[Float64[np.ndarray, "vertex 2"], Bool[np.ndarray, " vertex"]]:
    """Return the angles of the root on the circle before and after each vertex; which are corners.

    On a line they are 0 or pi, or that of a pole.
    """
    begins, ends = np.abs(outline.angles.T)
    before, after = [], []
    for first, last in loop_ends(outline):
        edges = np.arange(first, last)
        before += [edges[-1:], edges]
        after += [edges, edges[:1]]
    sides = np.stack([np.concatenate(before), np.concatenate(after)], axis=1)
    angles = np.stack([ends[sides[:, 0]], begins[sides[:, 1]]], axis=1)
    branches = outline.branches[sides]
    is_corner = (angles[:, 0] != angles[:, 1]) | (branches[:, 0] != branches[:, 1])
    true = np.add(*true_angles(c, angles.ravel())).reshape(angles.shape)
    return true, is_corner


# ----------------------------------------------------------------------------------------- measures
_STILL = 1e-13  # of the range: steps that are rounding

Columns = tuple[Array, ...]
Axis = int | Int[np.ndarray, " row"]
Extreme = tuple[Array, int | None]  # a point, and which vertex it is; None where it is not one


def limits(
    c: Curve, outline: Outline, values: Array, *, axis: int, outermost: bool = True
) -> Array:
    """Return where lines of constant alpha (axis 0) or beta (axis 1) enter and leave the region.

    That is the first entry and the last exit or, if not ``outermost``, the last entry and exit.
    """

    def ends(values: Array) -> Columns:
        coordinates, slopes, exist = _crossings(c, outline, values, axis)
        order, last = np.argsort(coordinates, axis=-1), np.sum(exist, axis=-1) - 1  # NaN is last
        rows, first = np.arange(len(values)), np.maximum(0 if outermost else last - 1, 0 * last)
        chosen = order[rows, first], order[rows, last]
        return *(coordinates[rows, k] for k in chosen), *(slopes[rows, k] for k in chosen)

    columns, xp = _columns(ends, outline, 4, values), namespace(values)
    both, slopes = (xp.stack(pair, axis=-1) for pair in (columns[:2], columns[2:]))
    return _moved(both, (slopes, values[..., None]))


@np.errstate(all="ignore")  # NaN and infinity are answers
def quadrant_extremes(c: Curve, outline: Outline) -> tuple[Extreme, Extreme]:
    """Return the points of the largest alpha and of the largest beta where the other is >= 0.

    Each is a vertex, or the last crossing with the axis of that gain; NaN if no gain is positive.
    """
    return _extreme(c, outline, 0), _extreme(c, outline, 1)


def _extreme(c: Curve, outline: Outline, axis: int) -> Extreme:
    vertices = outline.vertices
    other = np.nan_to_num(vertices[:, 1 - axis], nan=-np.inf)
    is_allowed = other >= -_STILL * np.max(other)  # a corner on the axis may be beside it
    values = np.where(is_allowed, vertices[:, axis], -np.inf)
    vertex: int | None = int(np.argmax(values))
    largest, point = np.max(values), vertices[vertex]
    crossing = _last_crossing(c, outline, axis, largest)
    if crossing > largest and crossing - largest > _STILL * abs(crossing):
        vertex, largest, point = None, crossing, np.array([crossing, 0.0][:: 1 - 2 * axis])
    sizes = _STILL * np.max(abs(np.nan_to_num(vertices)), axis=0)
    is_there = largest > sizes[axis] and np.max(other) > sizes[1 - axis]  # beyond rounding
    return np.where(is_there, point, np.nan) + 0.0, vertex  # no -0


def _last_crossing(c: Curve, outline: Outline, axis: int, least: float) -> float:
    """Return the last crossing of the boundary with the axis of a gain, -inf if none is beyond."""
    row, gain = np.zeros(1), outline.vertices[:, axis]
    reaches = np.maximum(gain[:-1], gain[1:]) > least  # edges are monotone
    beyond = _met(outline, row, 1 - axis) & reaches
    ends = _crossings(c, outline, row, 1 - axis, beyond)[0] if np.any(beyond) else row - np.inf
    return float(np.max(ends, initial=-np.inf, where=np.isfinite(ends)))


def interval_ends(
    c: Curve, outline: Outline, values: Float64[np.ndarray, " row"], *, axis: Axis
) -> Float64[np.ndarray, "row crossing"]:
    """Return the ends of all intervals on lines as in ``limits``, ascending, then NaN.

    Each line may have an axis of its own.
    """
    with np.errstate(all="ignore"):  # NaN and infinity are answers
        return np.sort(_crossings(c, outline, values, axis)[0], axis=-1)


def contains(
    c: Curve, outline: Outline, alpha: Array, beta: Array, *, is_proved: bool = False
) -> Array:
    """True where an odd number of crossings of the row lies beyond alpha.

    ``is_proved``: next to the boundary balls decide whether the wall is stable.
    """

    def are_inside(alpha: Array, beta: Array) -> Array:
        inside, doubted = _is_inside(c, outline, alpha, beta)
        for k in np.flatnonzero(doubted) if is_proved else ():
            inside[k] = c.is_stable((alpha[k], beta[k]))
        return inside

    return _columns(are_inside, outline, 0, alpha, beta)


def holds(c: Curve, outline: Outline, wall: Iterable[float]) -> bool:
    """True for a wall inside; see ``contains``."""
    return bool(contains(c, outline, *(np.array([gain]) for gain in wall))[0])


def _is_inside(c: Curve, outline: Outline, alpha: Array, beta: Array) -> tuple[Array, Array]:
    """True for points that are inside; then True for those too close to the boundary to tell."""
    # Of the region's size, beside what rounding may have moved the curve by at most: how close to
    # the boundary balls decide.
    doubted_share = 1e-8
    about = 1e-3  # of the same: a vertex at which the boundary runs level
    between = 4.0  # by how much errors may be larger between vertices
    vertices = outline.vertices
    sizes = np.ptp(vertices, axis=0)
    doubt = doubted_share * sizes + between * outline.errors
    met, ahead = _met(outline, beta, 1), vertices[:, 0] - alpha[:, None]
    beyond, behind = ahead > doubt[0], ahead <= -doubt[0]
    is_beyond = beyond[:, :-1] & beyond[:, 1:]
    count = np.sum(met & is_beyond, axis=-1)
    turns_here = (abs(ahead) <= about * sizes[0]) & (
        abs(vertices[:, 1] - beta[:, None]) <= doubt[1]
    )
    doubted = np.any(turns_here, axis=-1)
    unsure = met & ~is_beyond & ~(behind[:, :-1] & behind[:, 1:])
    if unsure.any():
        coordinates, slopes, exist = _crossings(c, outline, beta, 1, unsure)
        gap = coordinates - alpha[:, None]
        count = count + np.sum(exist & (gap > 0.0), axis=-1)
        doubted |= np.any(exist & (abs(gap) <= np.hypot(doubt[0], slopes * doubt[1])), axis=-1)
    return count % 2 == 1, doubted


def distance(c: Curve, outline: Outline, alpha: Array, beta: Array) -> Array:
    """Return the distance to the exact boundary, positive inside."""

    def to_boundary(alpha: Array, beta: Array) -> Columns:
        points = np.stack([alpha, beta], axis=-1)
        away = points - _nearest(c, outline, points)
        length = np.hypot(away[:, 0], away[:, 1])
        direction = away.T / nonzero(length, np.inf)
        length = np.where(outline.size > 0, length, np.inf if outline.resolved else np.nan)
        is_inside, _ = _is_inside(c, outline, alpha, beta)
        return tuple(np.where(is_inside, x, -x) for x in (length, *direction))

    signed, by_alpha, by_beta = _columns(to_boundary, outline, 3, alpha, beta)
    return _moved(signed, (by_alpha, alpha), (by_beta, beta))


@np.errstate(all="ignore")  # NaN and infinity are answers
def area(c: Curve, outline: Outline) -> Array:
    """Return the area of the polygon and of what lies between it and the curve.

    That is half the integral of (w - w0) x dw on each edge from w0, by Gauss' rule. It is small, so
    that it needs few digits where angles are drawn out.
    """
    places, weights = np.polynomial.legendre.leggauss(16)
    begin, end = outline.angles[outline.is_curved].T[..., None]
    half = 0.5 * (end - begin)
    (alpha, beta), slopes = gains_and_slopes(c, begin + half * (1.0 + places))
    first = outline.vertices[:-1][outline.is_curved].T[..., None]
    turned = (alpha - first[0]) * slopes[1] - (beta - first[1]) * slopes[0]
    bulges = np.sum(half * turned * weights)
    return np.where(outline.resolved, polygon_area(outline) + 0.5 * bulges, np.nan)


def deviation(c: Curve, outline: Outline) -> Array:
    """The distance of the boundary from the polygon, as a share of the region's diameter."""
    middle = curve_gains(c, np.mean(outline.angles, axis=1)).T
    here, there = outline.vertices[:-1], outline.vertices[1:]
    away = middle - _foot_on_chord(here, there, middle)
    bulges = np.hypot(away[:, 0], away[:, 1])
    size = np.hypot(*np.ptp(outline.vertices, axis=0))
    return np.max(np.where(outline.is_curved, bulges, 0.0)) / size


def _columns(function: Callable[..., Any], outline: Outline, count: int, *gains: Array) -> Any:
    """Return columns of answers to gains of any shape, or the one column of truths (``count`` 0).

    As many gains as fit into memory are answered at a time; those of JAX on the host.
    """
    at_once = 1 << 20  # pairs of a point and an edge that are held in memory
    size = max(1, at_once // len(outline.angles))

    @np.errstate(all="ignore")  # NaN and infinity are answers
    def answered(*gains: Array) -> Any:
        flat = [column.ravel() for column in gains]
        starts = range(0, max(flat[0].size, 1), size)
        parts = [function(*(x[start : start + size] for x in flat)) for start in starts]
        return tree_map(lambda column: column.reshape(gains[0].shape), joined(parts))

    like = (np.float64,) * count if count else np.bool_
    return on_host(answered, *gains, shape=gains[0].shape, like=like)


def _moved(values: Array, *pairs: tuple[Array, Array]) -> Array:
    """Return values that move by slopes as gains of JAX do, for pairs of slopes and gains."""
    if namespace(values) is np:
        return values
    return values + sum(slopes * (gains - constant(gains)) for slopes, gains in pairs)


# ------------------------------------------------------------------------ crossings of a row


def _crossings(
    c: Curve, outline: Outline, values: Array, axis: Axis, met: Array | None = None
) -> tuple[Array, Array, Array]:
    """Return where rows meet edges (those that are ``met``), in the other coordinate.

    Arrays (row, crossing) of that, of its slope by the value of the row, and of which exist.
    """
    met = _met(outline, values, axis) if met is None else met
    count = np.sum(met, axis=-1)
    exist = np.arange(np.max(count, initial=1)) < count[:, None]
    edges = np.argsort(~met, axis=-1, kind="stable")[:, : exist.shape[1]]
    edges = np.where(exist, edges, 0)
    goals = np.broadcast_to(values[:, None], edges.shape)
    begin, end = np.moveaxis(outline.angles[edges], -1, 0)
    here, there = (_turned(outline.vertices.T[:, edges + k], axis) for k in (0, 1))
    theta = bracketed_root(
        lambda angle: _turned(curve_gains(c, angle), axis)[0] - goals,
        begin,
        end,
        (here[0] - goals, there[0] - goals),
    )
    low, slope = _last_steps(c, theta, goals, axis)
    on_curve = _turned(curve_gains(c, theta, low), axis)[1]
    run = there - here
    divisor = nonzero(run[0], 1.0)
    on_line = here[1] + (goals - here[0]) / divisor * run[1]
    is_curve = outline.is_curved[edges]
    coordinates = np.where(exist, np.where(is_curve, on_curve, on_line), np.nan)
    return coordinates, np.where(is_curve, slope, run[1] / divisor), exist


def _turned(gains: Array, axis: Axis) -> Array:
    """Return gains (2, row, crossing) with that of each row's line first."""
    return np.where(np.reshape(axis, (-1, 1)) == 0, gains, gains[::-1])


def _met(outline: Outline, values: Array, axis: Axis) -> Array:
    above = outline.vertices.T[np.reshape(axis, -1)] > values[:, None]
    return (above[:, :-1] != above[:, 1:]) & (outline.branches >= 0)


def _last_steps(c: Curve, theta: Array, goals: Array, axis: Axis) -> tuple[Array, Array]:
    """Return Newton's steps from crossings' angles, and the slopes of the other coordinate there.

    Close to pi the steps are what rounding took from an angle.
    """
    last_step = 1e-10  # radians
    low = np.zeros_like(theta)
    for _ in range(2):  # where the curve flies off, one is not enough
        here, tangent = (_turned(pair, axis) for pair in gains_and_slopes(c, theta, low))
        step = (goals - here[0]) / nonzero(tangent[0], 1.0)
        low = np.clip(low + step, -last_step, last_step)
    return low, tangent[1] / nonzero(tangent[0], np.inf)


# ------------------------------------------------------------------------ the nearest point


def _nearest(c: Curve, outline: Outline, points: Array) -> Array:
    """Return the nearest points (point, 2) of the boundary."""
    at_once = 4  # edges
    here, there = outline.vertices[:-1], outline.vertices[1:]
    low, high, near = np.minimum(here, there), np.maximum(here, there), points[:, None]
    beside = np.maximum(np.maximum(low - near, near - high), 0.0)  # of the boxes of edges
    far = np.where(outline.branches >= 0, np.hypot(beside[..., 0], beside[..., 1]), np.inf)
    order = np.argsort(far, axis=-1)
    bounds = np.take_along_axis(far, order, axis=-1)
    rows, best = np.arange(len(points)), np.full(len(points), np.inf)
    edge, theta = np.zeros(len(points), int), np.ones(len(points))
    for start in range(0, len(here), at_once):
        if not np.any(bounds[:, start] < best):
            break
        columns = np.minimum(start + np.arange(at_once), len(here) - 1)
        edges = order[:, columns]
        away, feet = _feet(c, outline, edges, points)
        away = np.where(bounds[:, columns] < np.inf, away, np.inf)
        nearest = np.argmin(away, axis=-1)
        least = away[rows, nearest]
        closer = least < best
        best = np.where(closer, least, best)
        edge = np.where(closer, edges[rows, nearest], edge)
        theta = np.where(closer, feet[rows, nearest], theta)
    on_curve = curve_gains(c, theta).T
    on_line = _foot_on_chord(here[edge], there[edge], points)
    return np.where(outline.is_curved[edge][:, None], on_curve, on_line)


def _feet(c: Curve, outline: Outline, edges: Array, points: Array) -> tuple[Array, Array]:
    """Return the distances (point, edge) of points to some edges each, and the angles there.

    An edge of the curve is divided, and so is its part with the nearest box, with its neighbours;
    around the nearest of all ends the root of (curve - point) . tangent is the foot.
    """
    subdivisions = 8  # of an edge, and then of its nearest parts
    angles = outline.angles[edges]
    here, there = outline.vertices[edges], outline.vertices[edges + 1]
    begin, end = angles[..., 0], angles[..., 1]
    target = np.moveaxis(points, -1, 0)[..., None]

    def gap(theta: Array) -> Array:
        alpha, beta = curve_gains(c, theta)
        return np.hypot(alpha - target[0][..., None], beta - target[1][..., None])

    shares = np.arange(subdivisions + 1) / subdivisions

    def along(theta: Array) -> Array:
        point, tangent = gains_and_slopes(c, theta)
        return np.sum((point - target) * tangent, axis=0)

    for _ in range(2):
        parts = begin[..., None] + (end - begin)[..., None] * shares
        nearest = np.argmin(gap(parts), axis=-1)[..., None]
        sides = np.maximum(nearest - 1, 0), np.minimum(nearest + 1, subdivisions)
        begin, end = (np.take_along_axis(parts, side, axis=-1)[..., 0] for side in sides)
    candidates = np.stack([begin, bracketed_root(along, begin, end), end], axis=-1)
    gaps = gap(candidates)
    best = np.argmin(gaps, axis=-1)[..., None]
    theta = np.take_along_axis(candidates, best, axis=-1)[..., 0]
    to_curve = np.take_along_axis(gaps, best, axis=-1)[..., 0]
    away = _foot_on_chord(here, there, points[:, None]) - points[:, None]
    to_line = np.hypot(away[..., 0], away[..., 1])
    is_curve = outline.is_curved[edges]
    return np.where(is_curve, to_curve, to_line), theta


def _foot_on_chord(here: Array, there: Array, points: Array) -> Array:
    chord = there - here
    square = nonzero(np.sum(chord**2, axis=-1), 1.0)
    share = np.sum((points - here) * chord, axis=-1) / square
    return here + np.clip(share, 0.0, 1.0)[..., None] * chord


def turns(coordinate: Array) -> int:
    """The number of changes of a closed sequence between rising and falling."""
    if not coordinate.size:
        return 0
    steps = np.diff(coordinate)
    ways = np.sign(np.where(np.abs(steps) > _STILL * np.ptp(coordinate), steps, 0.0))
    ways = ways[ways != 0]
    return int(np.sum(ways != np.roll(ways, 1)))
