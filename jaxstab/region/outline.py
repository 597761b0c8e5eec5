"""Closed polygons on the exact boundary: pieces joined to loops, points where the curve bends.

Pieces are followed from end to end: a piece ends where its partner begins, so each component is
bounded by closed loops. Vertices are spread over a piece by how much it bends; straight parts get
few. Between two vertices alpha and beta are monotone, because turning points of either are vertices
as well. Every vertex is a point of the curve, exact to rounding.

The steps are the order of the pieces along the boundary (``_in_sequence``), a survey of slopes on
each (``_survey``), its turning points, vertices between which the boundary leaves its chord alike
(``_spread``), and all of these sorted along the boundary by one key (``_keys``). NumPy only.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array, joined, take, tree_map
from jaxstab.region.curve import Curve, true_angles
from jaxstab.region.pieces import NO_BRANCH, Branch, Pieces
from jaxstab.region.points import curve_gains, root_angles
from jaxstab.region.roots import bracketed_root, with_slope

_FEWEST_NODES, _MOST_NODES = 33, 129  # per piece, to see where it bends and turns
_TURNS = 8  # vertical and horizontal tangents, for each eight pieces
_BESIDE = 1e-8
_FIRST = np.geomspace(1e-6, 1e-2, 5)  # of a piece: where a curve with zero speed starts
_ROUNDING = 1e-10  # a coordinate that moves less than that is constant: a straight edge
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
    branch: Array
    stage: Array
    exists: Array


_ON_PIECE, _VIA, _CLOSING = 0, 1, 2  # in the order in which a piece and what follows pass them


def polygon(c: Curve, pieces: Pieces, points: int) -> Outline:
    """Return an outline of ``points`` vertices, spread so that all edges bend alike.

    It has more of them where corners and turning points alone are more than half.
    """
    if not (pieces.resolved and pieces.begin.size):
        return _without_points(pieces.resolved)
    pieces, loop = _in_sequence(pieces)
    nodes, tangents = _survey(c, pieces, min(max(points // 8 + 1, _FEWEST_NODES), _MOST_NODES))
    extra = joined([*_ends(pieces, loop), _turning_points(c, pieces, nodes, tangents)])
    taken = max(len(extra.theta), 4 * len(loop) + 1)
    room = max(points - taken, points // 2)
    marks = joined([_spread(pieces, nodes, tangents, room), extra])
    at_marks, size = _points(c, marks), np.sum(marks.exists)
    order = np.argsort(_keys(pieces, marks), kind="stable")
    order = order[np.minimum(np.arange(room + taken), size - 1)]
    branches, angles = _edges(pieces, take(marks, order))
    return Outline(
        vertices=at_marks[order],
        branches=np.where(np.arange(1, len(order)) < size, branches, NO_BRANCH),
        angles=angles,
        size=size,
        loops=np.asarray(loop[-1] + 1),
        corners=_corners(c, pieces, at_marks[room:]),
        resolved=pieces.resolved,
    )


def _without_points(resolved: Array) -> Outline:
    """Return the outline of no region: one edge that is none."""
    return Outline(
        vertices=np.full((2, 2), np.nan),
        branches=np.array([NO_BRANCH]),
        angles=np.zeros((1, 2)),
        size=np.asarray(0),
        loops=np.asarray(0),
        corners=np.empty((0, 2)),
        resolved=resolved,
    )


def _ends(pieces: Pieces, loop: Array) -> list[_Marks]:
    """Return marks of begins, ends, vias and ends of loops: one of each for each piece."""
    index = np.arange(len(loop))
    starts = np.sum(loop[:, None] > loop, axis=1)
    begin = partial(
        _marks, theta=pieces.begin, low=pieces.begin_low, branch=pieces.begin_branch, piece=index
    )
    end = partial(
        _marks, theta=pieces.end, low=pieces.end_low, branch=pieces.end_branch, piece=index
    )
    closing = take(begin(_CLOSING), starts)
    closing = closing._replace(piece=index, exists=np.append(loop[1:], -1) != loop)
    return [begin(_ON_PIECE), end(_ON_PIECE), end(_VIA)._replace(exists=pieces.via), closing]


def _marks(stage: int, *, piece: Array, theta: Array, low: Array, branch: Array) -> _Marks:
    return _Marks(
        piece, theta, low, branch, np.full(piece.shape, stage), np.full(piece.shape, True)
    )


def _on_curve(pieces: Pieces, piece: Array, theta: Array) -> _Marks:
    """Return marks on the curve; in a short piece some round to an end, and are that corner."""
    begins, ends = theta == pieces.begin[piece], theta == pieces.end[piece]
    branch = np.where(begins, pieces.begin_branch[piece], Branch.CURVE)
    branch = np.where(ends, pieces.end_branch[piece], branch)
    low = np.where(begins, pieces.begin_low[piece], 0.0)
    low = np.where(ends, pieces.end_low[piece], low)
    return _marks(_ON_PIECE, piece=piece, theta=theta, low=low, branch=branch)


def _keys(pieces: Pieces, marks: _Marks) -> Array:
    """Return numbers that grow along the boundary."""
    widths = pieces.end - pieces.begin
    along = (marks.theta - pieces.begin[marks.piece]) / widths[marks.piece]
    along = np.where(marks.stage == _ON_PIECE, along, 1.0 + marks.stage)
    return np.where(marks.exists, 4.0 * marks.piece + along, np.inf)


def extra_vertices(count: int) -> int:
    """Return how many vertices the corners and turning points of a number of pieces may take."""
    return 4 * count + _TURNS * max(1, count // 8)


def _in_sequence(pieces: Pieces) -> tuple[Pieces, Array]:
    """Return the pieces in the order of the boundary, loop by loop, and the number of the loop."""
    order: list[int] = []
    loop: list[int] = []
    waiting, current, number = dict.fromkeys(range(len(pieces.begin))), 0, 0
    while waiting:
        del waiting[current]
        order.append(current)
        loop.append(number)
        current = int(pieces.successor[current])
        if current not in waiting and waiting:
            current, number = next(iter(waiting)), number + 1
    ordered = tree_map(lambda x: x[order] if x.ndim else x, pieces)
    return ordered, np.array(loop)


def _survey(c: Curve, pieces: Pieces, count: int) -> tuple[Array, Array]:
    """Return angles (piece, node) and the tangents (alpha', beta') there (2, piece, node)."""
    # At th = 0 and pi the curve has zero speed: look beside.
    beside = _BESIDE * (pieces.end - pieces.begin)[:, None]
    begin, end = pieces.begin[:, None] + beside, pieces.end[:, None] - beside
    even = np.linspace(0.0, 1.0, count - 2 * (count // 4))
    nodes = [begin + (end - begin) * np.concatenate([_FIRST, even, 1.0 - _FIRST])]
    # Half of them close in on the angles at which the curve flies off.
    shares = (np.arange(count // 4) + 0.5) / (count // 4)
    for pole, apart in zip(np.append(c.poles[0], -c.poles[0]), np.tile(c.poles[1], 2), strict=True):
        low, high = (np.arcsinh((limit - pole) / apart) for limit in (begin, end))
        nodes.append(np.clip(pole + apart * np.sinh(low + (high - low) * shares), begin, end))
    ordered = np.sort(np.concatenate(nodes, axis=1), axis=1)
    return ordered, _tangent(c, ordered)


def _tangent(c: Curve, theta: Array) -> Array:
    return with_slope(partial(curve_gains, c), theta)[1]


def _turning_points(c: Curve, pieces: Pieces, nodes: Array, tangents: Array) -> _Marks:
    """Return where alpha or beta turns."""
    moves = abs(tangents) > _ROUNDING * np.hypot(*tangents)
    turns = (tangents[..., 1:] * tangents[..., :-1] < 0.0) & (moves[..., 1:] | moves[..., :-1])
    is_beta, piece, node = np.nonzero(turns)

    def slope(theta: Array) -> Array:
        along_alpha, along_beta = _tangent(c, theta)
        return np.where(is_beta == 1, along_beta, along_alpha)

    ends = tangents[is_beta, piece, node], tangents[is_beta, piece, node + 1]
    theta = bracketed_root(slope, nodes[piece, node], nodes[piece, node + 1], ends)
    return _on_curve(pieces, piece, theta)


def _spread(pieces: Pieces, nodes: Array, tangents: Array, count: int) -> _Marks:
    """Return points between which the boundary leaves its chord alike."""
    alpha, beta = tangents
    turned = abs(alpha[:, 1:] * beta[:, :-1] - alpha[:, :-1] * beta[:, 1:])
    speed = np.hypot(alpha, beta)
    steps = np.diff(nodes, axis=1)
    bend = np.sqrt(turned * steps / (speed[:, 1:] + speed[:, :-1]))
    bend = bend + _EVENNESS * np.sum(bend) / bend.size
    total = np.cumsum(bend.ravel())
    goal = total[-1] * (np.arange(count) + 0.5) / count
    step = np.minimum(np.searchsorted(total, goal), total.size - 1)
    width = bend.ravel()[step]
    share = np.where(width > 0.0, (goal - total[step]) / np.where(width > 0.0, width, 1.0), 0.0)
    piece, node = np.unravel_index(step, bend.shape)
    return _on_curve(pieces, piece, nodes[piece, node + 1] + steps[piece, node] * share)


def _points(c: Curve, marks: _Marks) -> Array:
    """Return the points of marks; corners with a line are on that line to the last digit."""
    alpha, beta = curve_gains(c, marks.theta, marks.low)
    on_plus = c.plus_offset - c.plus_slope * beta
    alpha = np.where(marks.branch == Branch.Z_PLUS_ONE, on_plus, alpha)
    crossing = np.stack(c.lines_crossing)
    return np.where((marks.stage == _VIA)[:, None], crossing, np.stack([alpha, beta], -1))


def _edges(pieces: Pieces, marks: _Marks) -> tuple[Array, Array]:
    """Return for the edge after each vertex its branch and the angles at its ends."""
    here, there = (take(marks, rows) for rows in (_HERE, _THERE))
    same_piece = (here.piece == there.piece) & (there.stage == _ON_PIECE)
    end_branch = pieces.end_branch[here.piece]
    other_line = Branch.Z_PLUS_ONE + Branch.Z_MINUS_ONE - end_branch
    branches = np.where(here.stage == _VIA, other_line, end_branch)
    branches = np.where(here.stage == _CLOSING, NO_BRANCH, branches)
    branches = np.where(same_piece, Branch.CURVE, branches)
    end = np.where(same_piece, there.theta, here.theta)
    return branches, np.stack([here.theta, end], axis=-1)


def _corners(c: Curve, pieces: Pieces, points: Array) -> Array:
    """Return the corners in the order of the boundary; the points are those of begins, then ends.

    They are filled up with NaN.
    """
    # Where a piece ends on the curve, the next one begins: count that corner once.
    count = len(pieces.begin)
    ends_on_line = pieces.end_branch != Branch.CURVE
    exists = np.stack([np.ones(count, bool), ends_on_line, pieces.via], axis=1)
    crossing = np.broadcast_to(np.stack(c.lines_crossing), (count, 2))
    corners = np.stack([points[:count], points[count : 2 * count], crossing], axis=1)[exists]
    return np.concatenate([corners, np.full((3 * count - len(corners), 2), np.nan)])


# The loops of an outline, and which roots are on the circle at its vertices.


def loop_ends(outline: Outline) -> list[tuple[int, int]]:
    """Return the first and the last vertex of each loop, which are the same point."""
    last = int(outline.size) - 1
    breaks = np.flatnonzero(outline.branches[:last] == NO_BRANCH).tolist()
    return list(zip([0, *(end + 1 for end in breaks)], [*breaks, last], strict=True))


def vertex_roots(
    c: Curve, outline: Outline
) -> tuple[Float64[np.ndarray, "vertex 2"], Bool[np.ndarray, " vertex"]]:
    """Return the angles of the root on the circle before and after each vertex; which are corners.

    Corners are told by their edges: where the curve meets itself, the end of one piece and the
    begin of the next are two vertices, whose coordinates may round differently.
    """
    branches, (begins, ends) = outline.branches, outline.angles.T
    has_length = (branches != NO_BRANCH) & ((branches != Branch.CURVE) | (begins != ends))
    before, after = [], []
    for first, last in loop_ends(outline):
        edges = first + np.flatnonzero(has_length[first:last])
        following = np.searchsorted(edges, np.arange(first, last + 1))
        before.append(edges[following - 1])
        after.append(edges[following % len(edges)])
    sides = np.stack([np.concatenate(before), np.concatenate(after)], axis=1)
    angles = np.stack([ends[sides[:, 0]], begins[sides[:, 1]]], axis=1)
    is_corner = (angles[:, 0] != angles[:, 1]) | (branches[sides[:, 0]] != branches[sides[:, 1]])
    size = root_angles(c.lines, angles).ravel()
    true, _ = true_angles(c.stretches, size, np.zeros_like(size))
    on_line = np.pi * (branches[sides] == Branch.Z_MINUS_ONE)
    roots = np.where(branches[sides] == Branch.CURVE, true.rounded().reshape(angles.shape), on_line)
    return roots, is_corner


# Which points lie inside an outline's polygon; the same answer as the curve, except next to it.


def edges_of(points: np.ndarray, branch: np.ndarray) -> Float64[np.ndarray, "edge 4"]:
    """Return the edges of an outline, without those between its loops."""
    return np.concatenate([points[:-1], points[1:]], axis=1)[branch != NO_BRANCH]


def are_inside(edges: np.ndarray, points: np.ndarray) -> Bool[np.ndarray, " point"]:
    """Count the edges to the right of each point: an odd number of them encloses it."""
    alpha, beta = points[:, None]
    first_alpha, first_beta, last_alpha, last_beta = edges.T[..., None]
    crosses = (first_beta > beta) != (last_beta > beta)
    with np.errstate(all="ignore"):  # edges that run level are not crossed
        share = (beta - first_beta) / (last_beta - first_beta)
        is_right = first_alpha + share * (last_alpha - first_alpha) > alpha
    inside: np.ndarray = np.sum(crosses & is_right, axis=0) % 2 == 1
    return inside
