"""Closed polygons on the exact boundary: pieces joined to loops, points where the curve bends.

Pieces are followed from end to end: a piece ends where its partner begins, so each component is
bounded by closed loops. Vertices are spread over a piece by how much it bends; straight parts get
few. Between two vertices alpha and beta are monotone, because turning points of either are vertices
as well. Every vertex is a point of the closed form, exact to rounding.

All arrays have fixed sizes, so the steps are those of a program without branches: the order of the
pieces along the boundary (``_sequence``), a survey of slopes on each (``_survey``), its turning
points, vertices between which the boundary leaves its chord alike (``_spread``), and all of these
sorted along the boundary by one key (``_keys``). Derivatives in the slice follow: a vertex between
corners keeps its share of the piece.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from jaxstab.arrays import (
    Array,
    constant,
    first_indices,
    joined,
    kept,
    namespace,
    repeat_and_keep,
    stored,
    take,
    tree_map,
)
from jaxstab.region.curve import (
    Curve,
    curve_and_lift,
    lines_crossing,
    plus_offset,
    plus_slope,
    poles,
)
from jaxstab.region.pieces import NO_BRANCH, Branch, Pieces, others_inside
from jaxstab.region.roots import bracketed_root, with_slope

_FEWEST_NODES, _MOST_NODES = 33, 129  # per piece, to see where it bends and turns
_TURNS = 8  # vertical and horizontal tangents, for each eight slots of pieces
_BESIDE = 1e-8
_FIRST = np.geomspace(1e-6, 1e-2, 5)  # of a piece: where a curve with zero speed starts
_ROUNDING = 1e-10  # a coordinate that moves less than that is constant: a straight edge
_TESTED = slice(1, None, 4)
_ROUNDED = 1e-7  # a root so close to the circle may be on it, next to a corner
_HERE, _THERE = slice(None, -1), slice(1, None)
_EVENNESS = 0.1  # the share of points that straight parts get


class Outline(NamedTuple):
    """A polygon with its corners on the exact boundary, counter-clockwise, in arrays of one length.

    ``vertices`` (n, 2) are points (alpha, beta); each loop ends with its first point, and the last
    point is repeated to the end. ``branches`` (n - 1,) are Branch codes of the edges, and
    ``angles`` (n - 1, 2) the angles of the curve at their ends. Between two vertices alpha and beta
    are monotone. The first ``size`` vertices are not repetitions; they form ``loops`` loops.
    ``corners`` (m, 2) are padded with NaN. Unless the pieces are ``resolved``, nothing is stored.
    """

    vertices: Array
    branches: Array
    angles: Array
    size: Array
    loops: Array
    corners: Array
    resolved: Array


class _Marks(NamedTuple):
    """Points of the boundary: on which piece of the sequence, at which angle, and what they are.

    ``low`` is what rounding took from the angle ``theta``; ``branch`` is a line on which the point
    lies, or Branch.CURVE.
    """

    piece: Array
    theta: Array
    low: Array
    exists: Array
    branch: Array
    stage: Array


_ON_PIECE, _VIA, _CLOSING = 0, 1, 2  # in the order in which a piece and what follows pass them


def polygon(c: Curve, pieces: Pieces, points: int, length: int | None = None) -> Outline:
    """Return an outline of ``points`` vertices, spread so that all edges bend alike.

    It is differentiable in the slice: vertices between corners keep their share of the piece. If
    ``length`` is given, the length of the other roots' polynomials, these roots are tested at every
    fourth vertex: a cut that the scan stepped over is noticed where a vertex falls on it.
    """
    xp = namespace(c, pieces)
    slots = len(pieces.exists)
    order, loop = _sequence(pieces)
    pieces = tree_map(lambda x: x[order] if x.ndim else x, pieces)
    nodes, tangents = stored(
        _survey(c, pieces, min(max(points // 8 + 1, _FEWEST_NODES), _MOST_NODES))
    )
    extremes, fits = _turning_points(c, pieces, nodes, tangents, slots)
    ends, closes = _ends(pieces, loop)
    extra = joined([*ends, extremes])
    room = points - len(extra.theta)
    if xp is np and room < points // 2:  # NumPy makes more room
        room = points // 2
        points = room + len(extra.theta)
    spread = _spread(pieces, nodes, tangents, room)
    chosen = _merged(_keys(pieces, spread), _keys(pieces, extra))
    marks = joined([spread, extra])
    resolved = pieces.resolved & fits
    if length is not None:
        fixed, tested = constant((c, spread.theta[_TESTED]))
        sound = others_inside(fixed, tested, length, within=1.0 + _ROUNDED)
        resolved = resolved & xp.all(sound | ~spread.exists[_TESTED])
    count = xp.where(resolved, xp.sum(marks.exists), 0)
    chosen = chosen[xp.clip(xp.arange(points), 0, xp.maximum(count - 1, 0))]
    at_marks = _points(c, marks)
    marks = take(marks, chosen)
    branches, angles = _edges(pieces, marks)
    corners = at_marks[room:][: 3 * slots]
    return Outline(
        vertices=xp.where(count > 0, at_marks[chosen], xp.nan),
        branches=xp.where(xp.arange(points - 1) < count - 1, branches, NO_BRANCH),
        angles=angles,
        size=count,
        loops=xp.where(resolved, xp.sum(closes), 0),
        corners=xp.where(resolved, _corners(pieces, corners), xp.nan),
        resolved=resolved,
    )


def _ends(pieces: Pieces, loop: Array) -> tuple[list[_Marks], Array]:
    """Return marks of begins, ends, vias and ends of loops, and which pieces end a loop."""
    xp = namespace(pieces, loop)
    index = xp.arange(len(loop))
    starts = xp.sum(loop[:, None] > loop, axis=1)
    closes = pieces.exists & (xp.append(loop[1:], -1) != loop)
    begin = partial(
        _marks, theta=pieces.begin, low=pieces.begin_low, branch=pieces.begin_branch, piece=index
    )
    end = partial(
        _marks, theta=pieces.end, low=pieces.end_low, branch=pieces.end_branch, piece=index
    )
    closing = take(begin(_ON_PIECE, exists=pieces.exists), starts)
    return [
        begin(_ON_PIECE, exists=pieces.exists),
        end(_ON_PIECE, exists=pieces.exists),
        end(_VIA, exists=pieces.via),
        closing._replace(piece=index, exists=closes, stage=xp.full(len(loop), _CLOSING)),
    ], closes


def _marks(
    stage: int, *, piece: Array, theta: Array, low: Array, exists: Array, branch: Array
) -> _Marks:
    stages = namespace(theta).full(piece.shape, stage)
    return _Marks(piece, theta, low, exists, branch, stages)


def _on_curve(pieces: Pieces, piece: Array, theta: Array, exists: Array) -> _Marks:
    """Return marks on the curve; in a short piece some round to an end, and are that corner."""
    xp = namespace(pieces, theta)
    begins, ends = theta == pieces.begin[piece], theta == pieces.end[piece]
    branch = xp.where(begins, pieces.begin_branch[piece], Branch.CURVE)
    branch = xp.where(ends, pieces.end_branch[piece], branch)
    low = xp.where(begins, pieces.begin_low[piece], 0.0)
    low = xp.where(ends, pieces.end_low[piece], low)
    return _marks(_ON_PIECE, piece=piece, theta=theta, low=low, exists=exists, branch=branch)


def _keys(pieces: Pieces, marks: _Marks) -> Array:
    """Return numbers that grow along the boundary."""
    xp = namespace(marks)
    widths = pieces.end - pieces.begin
    along = (marks.theta - pieces.begin[marks.piece]) / widths[marks.piece]
    along = xp.where(marks.stage == _ON_PIECE, along, 1.0 + marks.stage)
    return constant(xp.where(marks.exists, 4.0 * marks.piece + along, xp.inf))


def _merged(many: Array, few: Array) -> Array:
    """Return the order of keys, most of which are in order already, by counting."""
    xp = namespace(many, few)
    order = xp.argsort(few, stable=True)
    rank = xp.arange(len(few)) + xp.searchsorted(many, few[order])
    index = xp.arange(len(many) + len(few))
    passed = xp.sum(rank[:, None] <= index, axis=0)
    latest = xp.maximum(passed - 1, 0)
    return xp.where(rank[latest] == index, len(many) + order[latest], index - passed)


def extra_vertices(slots: int) -> int:
    """Return how many vertices corners and turning points may take."""
    return 4 * slots + _TURNS * max(1, slots // 8)


def _sequence(pieces: Pieces) -> tuple[Array, Array]:
    """Return the pieces in the order of the boundary, loop by loop, and the number of the loop."""
    xp = namespace(pieces)
    index = xp.arange(len(pieces.exists))

    def step(state: tuple[Array, Array]) -> tuple[tuple[Array, Array], Array]:
        visited, current = state
        visited = visited | (index == current)
        following = pieces.successor[current]
        closed = visited[following] | ~pieces.exists[current]
        fresh = xp.argmin(2 * visited + ~pieces.exists)
        return (visited, xp.where(closed, fresh, following)), xp.stack([current, closed])

    start = (xp.zeros(len(index), bool), xp.argmin(~pieces.exists))
    order, closed = repeat_and_keep(len(index), step, start)[1].T
    return order, xp.cumsum(closed) - closed


def _survey(c: Curve, pieces: Pieces, count: int) -> tuple[Array, Array]:
    """Return angles (piece, node) and the tangents (alpha', beta') there (2, piece, node)."""
    # At th = 0 and pi the curve has zero speed: look beside.
    xp = namespace(c, pieces)
    beside = _BESIDE * (pieces.end - pieces.begin)[:, None]
    begin, end = pieces.begin[:, None] + beside, pieces.end[:, None] - beside
    even = np.linspace(0.0, 1.0, count - 2 * (count // 4))
    nodes = [begin + (end - begin) * np.concatenate([_FIRST, even, 1.0 - _FIRST])]
    # Half of them close in on the angles at which the curve flies off.
    shares = (np.arange(count // 4) + 0.5) / (count // 4)
    for pole, apart in zip(*poles(constant(c)), strict=True):
        low, high = (xp.arcsinh((limit - pole) / apart) for limit in (begin, end))
        nodes.append(xp.clip(pole + apart * xp.sinh(low + (high - low) * shares), begin, end))
    ordered = xp.sort(xp.concatenate(nodes, axis=1), axis=1)
    return ordered, _tangent(c, ordered)


def _tangent(c: Curve, theta: Array) -> Array:
    xp = namespace(c, theta)
    return with_slope(lambda angle: xp.stack(curve_and_lift(c, angle)[:2]), theta)[1]


def _turning_points(
    c: Curve, pieces: Pieces, nodes: Array, tangents: Array, slots: int
) -> tuple[_Marks, Array]:
    """Return where alpha or beta turns, and whether there is room for all of these points."""
    xp = namespace(c, pieces)
    moves = abs(tangents) > _ROUNDING * xp.hypot(*tangents)
    turns = (tangents[..., 1:] * tangents[..., :-1] < 0.0) & (moves[..., 1:] | moves[..., :-1])
    turns = turns & pieces.exists[:, None]
    count = xp.sum(turns)
    slots = max(int(count), 1) if xp is np else extra_vertices(slots) - 4 * slots
    flat = first_indices(turns.ravel(), slots)
    exists = flat < turns.size
    is_beta, piece, node = xp.unravel_index(xp.where(exists, flat, 0), turns.shape)

    def slope(parameters: tuple[Curve, Array], theta: Array) -> Array:
        slice_, is_beta = parameters
        along_alpha, along_beta = _tangent(slice_, theta)
        return xp.where(is_beta == 1, along_beta, along_alpha)

    last = xp.where(exists, nodes[piece, node + 1], nodes[piece, node])
    ends = tangents[is_beta, piece, node], tangents[is_beta, piece, node + 1]
    theta = bracketed_root(slope, (c, is_beta), nodes[piece, node], last, ends)
    return _on_curve(pieces, piece, theta, exists), count <= slots


def _spread(pieces: Pieces, nodes: Array, tangents: Array, count: int) -> _Marks:
    """Return points between which the boundary leaves its chord alike."""
    xp = namespace(pieces, nodes)
    alpha, beta = tangents
    turned = abs(alpha[:, 1:] * beta[:, :-1] - alpha[:, :-1] * beta[:, 1:])
    speed = xp.hypot(alpha, beta)
    steps = xp.diff(nodes, axis=1)
    bend = xp.sqrt(turned * steps / (speed[:, 1:] + speed[:, :-1]))
    bend = xp.where(pieces.exists[:, None], bend, 0.0)
    steps_in_all = xp.maximum(xp.sum(pieces.exists), 1) * steps.shape[1]
    even = _EVENNESS * xp.sum(bend) / steps_in_all
    bend = constant(xp.where(pieces.exists[:, None], bend + even, 0.0))
    total = xp.cumsum(bend.ravel())
    goal = total[-1] * (np.arange(count) + 0.5) / count
    step = xp.minimum(xp.searchsorted(total, goal), total.size - 1)
    width = bend.ravel()[step]
    share = xp.where(width > 0.0, (goal - total[step]) / xp.where(width > 0.0, width, 1.0), 0.0)
    piece, node = xp.unravel_index(step, bend.shape)
    theta = nodes[piece, node + 1] + steps[piece, node] * share
    exists = xp.broadcast_to(xp.any(pieces.exists), piece.shape)
    return _on_curve(pieces, piece, theta, exists)


def _points(c: Curve, marks: _Marks) -> Array:
    """Return the points of marks; corners with a line are on that line to the last digit."""
    xp = namespace(c, marks)
    alpha, beta = curve_and_lift(c, marks.theta, marks.low)[:2]
    alpha = xp.where(
        marks.branch == Branch.Z_PLUS_ONE, plus_offset(c) - plus_slope(c) * beta, alpha
    )
    crossing = xp.stack(lines_crossing(c))
    return xp.where((marks.stage == _VIA)[:, None], crossing, kept(xp.stack([alpha, beta], -1)))


def _edges(pieces: Pieces, marks: _Marks) -> tuple[Array, Array]:
    """Return for the edge after each vertex its branch and the angles at its ends."""
    xp = namespace(pieces, marks)
    here, there = (take(marks, rows) for rows in (_HERE, _THERE))
    same_piece = (here.piece == there.piece) & (there.stage == _ON_PIECE)
    end_branch = pieces.end_branch[here.piece]
    other_line = Branch.Z_PLUS_ONE + Branch.Z_MINUS_ONE - end_branch
    branches = xp.where(here.stage == _VIA, other_line, end_branch)
    branches = xp.where(here.stage == _CLOSING, NO_BRANCH, branches)
    branches = xp.where(same_piece, Branch.CURVE, branches)
    end = xp.where(same_piece, there.theta, here.theta)
    return branches, xp.stack([here.theta, end], axis=-1)


def _corners(pieces: Pieces, points: Array) -> Array:
    """Return the corners in the order of the boundary, of the points at begins, ends and vias."""
    xp = namespace(pieces, points)
    # Where a piece ends on the curve, the next one begins: count that corner once.
    ends_on_line = pieces.exists & (pieces.end_branch != Branch.CURVE)
    exists = xp.stack([pieces.exists, ends_on_line, pieces.via], axis=1).ravel()
    corners = points.reshape(3, -1, 2).swapaxes(0, 1).reshape(-1, 2)
    index = first_indices(exists, len(exists))
    is_corner = index < len(exists)
    return xp.where(is_corner[:, None], corners[xp.where(is_corner, index, 0)], xp.nan)
