"""Closed polygons on the exact boundary: arcs joined to loops, points where the curve bends."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxstab.boundary.arcs import NO_BRANCH, Arcs, Branch, lines_crossing
from jaxstab.boundary.curve import SliceCoefficients, curve_point
from jaxstab.boundary.roots import bracketed_root

_NODES = 33  # per arc, to see where it bends and turns
_TURNS = 8  # vertical and horizontal tangents, for each eight slots of arcs
_BESIDE = 1e-4
_ROUNDING = 1e-10  # a coordinate that moves less than that is constant: a straight edge
_HERE, _THERE = slice(None, -1), slice(1, None)
_EVENNESS = 0.05  # the share of points that straight parts get


class Outline(NamedTuple):
    """A polygon with its corners on the exact boundary, counter-clockwise, in arrays of one length.

    ``vertices`` (n, 2) are points (alpha, beta); each loop ends with its first point, and the last
    point is repeated to the end. ``branches`` (n - 1,) are Branch codes of the edges, and
    ``angles`` (n - 1, 2) the angles of the curve at their ends. Between two vertices alpha and beta
    are monotone. ``size`` vertices are not such repetitions, and they form ``loops`` loops.
    ``corners`` (m, 2) are followed by NaN.
    """

    vertices: Array
    branches: Array
    angles: Array
    size: Array
    loops: Array
    corners: Array
    fits: Array


class _Marks(NamedTuple):
    """Points of the boundary: on which arc of the sequence, at which angle, and what they are."""

    place: Array
    theta: Array
    exists: Array
    stage: Array


_ON_ARC, _VIA, _CLOSING = 0, 1, 2  # in the order in which an arc and what follows it pass them


def polygon(c: SliceCoefficients, arcs: Arcs, points: int) -> Outline:
    """Return an outline of exactly ``points`` vertices, spread so that all edges bend alike.

    Differentiable in the slice: vertices between corners stay at their share of the arc.
    """
    slots = len(arcs.exists)
    turns = extra_vertices(slots) - 4 * slots
    order, loop = _sequence(arcs)
    arcs = jax.tree.map(lambda x: x[order] if x.ndim else x, arcs)
    # Barriers keep XLA from computing the curve again in every place that reads it.
    nodes, tangents = lax.optimization_barrier(_survey(c, arcs))
    extremes, fits = _turning_points(c, arcs, nodes, tangents, turns)
    spread = _spread(arcs, nodes, tangents, points - 4 * slots - turns)
    places = jnp.arange(slots)
    first = jnp.searchsorted(loop, loop)
    closes = arcs.exists & (jnp.append(loop[1:], -1) != loop)
    begins, ends = arcs.begin, arcs.end
    marks = [
        _marks(_ON_ARC, *spread, jnp.broadcast_to(jnp.any(arcs.exists), spread[0].shape)),
        _marks(_ON_ARC, *extremes),
        _marks(_ON_ARC, places, begins, arcs.exists),
        _marks(_ON_ARC, places, ends, arcs.exists),
        _marks(_VIA, places, ends, arcs.via),
        _marks(_CLOSING, places, begins[first], closes),
    ]
    everything: _Marks = lax.optimization_barrier(
        jax.tree.map(lambda *parts: jnp.concatenate(parts), *marks)
    )
    along = everything.theta - begins[everything.place]
    along = along / (ends - begins)[everything.place]
    along = jnp.where(everything.stage == _ON_ARC, along, 1.0 + everything.stage)
    key = jnp.where(everything.exists, 4.0 * everything.place + along, jnp.inf)
    count = jnp.sum(everything.exists)
    chosen = jnp.argsort(key)[jnp.clip(jnp.arange(points), max=jnp.maximum(count - 1, 0))]
    vertices, branches, angles = _edges(c, arcs, jax.tree.map(lambda x: x[chosen], everything))
    return Outline(
        vertices=jnp.where(count > 0, vertices, jnp.nan),
        branches=jnp.where(jnp.arange(points - 1) < count - 1, branches, NO_BRANCH),
        angles=angles,
        size=count,
        loops=jnp.sum(closes),
        corners=_corners(c, arcs),
        fits=fits,
    )


def _marks(stage: int, place: Array, theta: Array, exists: Array) -> _Marks:
    return _Marks(place, theta, exists, jnp.full(place.shape, stage))


def extra_vertices(slots: int) -> int:
    """Return how many vertices are kept for corners and turning points."""
    return 4 * slots + _TURNS * max(1, slots // 8)


def _sequence(arcs: Arcs) -> tuple[Array, Array]:
    """Return the arcs in the order of the boundary, loop by loop, and the number of the loop."""

    def step(state: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        visited, current = state
        visited = visited.at[current].set(True)
        following = arcs.successor[current]
        closed = visited[following] | ~arcs.exists[current]
        fresh = jnp.argmin(2 * visited + ~arcs.exists)
        return (visited, jnp.where(closed, fresh, following)), jnp.stack([current, closed])

    slots = len(arcs.exists)
    start = (jnp.zeros(slots, bool), jnp.argmin(~arcs.exists))
    order, closed = lax.scan(step, start, None, length=slots)[1].T
    return order, jnp.cumsum(closed) - closed


def _survey(c: SliceCoefficients, arcs: Arcs) -> tuple[Array, Array]:
    """Return angles (arc, node) and the tangents (alpha', beta') there (2, arc, node)."""
    # At th = 0 and pi the curve stands still: look beside.
    shares = jnp.clip(jnp.linspace(0.0, 1.0, _NODES), _BESIDE, 1.0 - _BESIDE)
    nodes = arcs.begin[:, None] + (arcs.end - arcs.begin)[:, None] * shares
    return nodes, jnp.stack(_tangent(c, nodes))


def _tangent(c: SliceCoefficients, theta: Array) -> tuple[Array, Array]:
    tangent: tuple[Array, Array] = jax.jvp(
        lambda angle: curve_point(c, angle), (theta,), (jnp.ones_like(theta),)
    )[1]
    return tangent


def _turning_points(
    c: SliceCoefficients, arcs: Arcs, nodes: Array, tangents: Array, slots: int
) -> tuple[tuple[Array, Array, Array], Array]:
    """Return places and angles where alpha or beta turns, which of them exist, if all were kept."""
    moves = jnp.abs(tangents) > _ROUNDING * jnp.hypot(*tangents)
    turns = (tangents[..., 1:] * tangents[..., :-1] < 0.0) & (moves[..., 1:] | moves[..., :-1])
    turns = turns & arcs.exists[:, None]
    flat = jnp.nonzero(turns.ravel(), size=slots, fill_value=-1)[0]
    is_beta, place, node = jnp.unravel_index(jnp.maximum(flat, 0), turns.shape)

    def slope(slice_: SliceCoefficients, theta: Array) -> Array:
        along_alpha, along_beta = _tangent(slice_, theta)
        return jnp.where(is_beta == 1, along_beta, along_alpha)

    last = jnp.where(flat >= 0, nodes[place, node + 1], nodes[place, node])
    theta = bracketed_root(slope, c, nodes[place, node], last)
    return (place, theta, flat >= 0), jnp.sum(turns) <= slots


def _spread(arcs: Arcs, nodes: Array, tangents: Array, count: int) -> tuple[Array, Array]:
    """Return places and angles of points between which the boundary leaves its chord alike."""
    alpha, beta = tangents
    turned = jnp.abs(alpha[:, 1:] * beta[:, :-1] - alpha[:, :-1] * beta[:, 1:])
    speed = jnp.hypot(alpha, beta)
    steps = jnp.diff(nodes, axis=1)
    bend = jnp.sqrt(turned * steps / (speed[:, 1:] + speed[:, :-1]))
    bend = jnp.where(arcs.exists[:, None], bend, 0.0)
    pieces = jnp.maximum(jnp.sum(arcs.exists), 1) * (_NODES - 1)
    bend = jnp.where(arcs.exists[:, None], bend + _EVENNESS * jnp.sum(bend) / pieces, 0.0)
    total = jnp.cumsum(lax.stop_gradient(bend).ravel())
    goal = total[-1] * (jnp.arange(count) + 0.5) / count
    piece = jnp.minimum(jnp.searchsorted(total, goal), total.size - 1)
    width = lax.stop_gradient(bend).ravel()[piece]
    rest = jnp.where(width > 0.0, (goal - total[piece]) / jnp.where(width > 0.0, width, 1.0), 0.0)
    place, node = jnp.unravel_index(piece, bend.shape)
    share = (node + 1.0 + rest) / (_NODES - 1)
    return place, arcs.begin[place] + (arcs.end - arcs.begin)[place] * share


def _edges(c: SliceCoefficients, arcs: Arcs, marks: _Marks) -> tuple[Array, Array, Array]:
    """Return the vertices, and for the edge after each the branch and the angles at its ends."""
    on_curve = lax.optimization_barrier(jnp.stack(curve_point(c, marks.theta), axis=-1))
    crossing = jnp.stack(lines_crossing(c))
    vertices = jnp.where((marks.stage == _VIA)[:, None], crossing, on_curve)
    here, there = (jax.tree.map(lambda x, part=part: x[part], marks) for part in (_HERE, _THERE))
    same_arc = (here.place == there.place) & (there.stage == _ON_ARC)
    left = arcs.end_branch[here.place]
    other_line = Branch.Z_PLUS_ONE + Branch.Z_MINUS_ONE - left
    branches = jnp.where(
        same_arc,
        Branch.CURVE,
        jnp.select(
            [here.stage == _CLOSING, here.stage == _VIA], [NO_BRANCH, other_line], default=left
        ),
    )
    angles = jnp.stack([here.theta, jnp.where(same_arc, there.theta, here.theta)], axis=-1)
    return vertices, branches, angles


def _corners(c: SliceCoefficients, arcs: Arcs) -> Array:
    begin, end = (jnp.stack(curve_point(c, x), axis=-1) for x in (arcs.begin, arcs.end))
    crossing = jnp.broadcast_to(jnp.stack(lines_crossing(c)), begin.shape)
    corners = jnp.stack([begin, end, crossing], axis=1).reshape(-1, 2)
    # Where an arc ends on the curve, the next one begins: count that corner once.
    ends_on_line = arcs.exists & (arcs.end_branch != Branch.CURVE)
    exist = jnp.stack([arcs.exists, ends_on_line, arcs.via], axis=1).ravel()
    order = jnp.argsort(~exist, stable=True)
    return jnp.where(exist[order][:, None], corners[order], jnp.nan)
