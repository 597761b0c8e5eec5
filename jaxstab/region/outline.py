"""Closed polygons on the exact boundary: arcs and straight parts in order, points where it bends.

Vertices are spread over the arcs by how much these bend; straight parts get few. Between two
vertices alpha and beta are monotone, because turning points of either are vertices as well. Every
vertex is a point of the curve, exact to rounding. NumPy only.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array
from jaxstab.region.curve import (
    Angles,
    Curve,
    bracketed_root,
    curve_errors,
    curve_gains,
    gains_and_slopes,
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
    errors = curve_errors(c, np.concatenate([pieces.begin, theta[::4], pieces.end]))
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
    for nearest in np.argsort(away, axis=1, kind="stable")[:, :close].T:
        place, width = places[nearest, None], widths[nearest, None]
        low, high = (np.arcsinh((limit - place) / width) for limit in (begin, end))
        nodes.append(np.clip(place + width * np.sinh(low + (high - low) * shares), begin, end))
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
