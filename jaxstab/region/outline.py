"""Closed polygons on the exact boundary: arcs joined to loops, points where the curve bends."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxstab.region.curve import SliceCoefficients, curve_point, poles
from jaxstab.region.pieces import (
    NO_BRANCH,
    Arcs,
    Branch,
    first_places,
    lines_crossing,
    others_inside,
)
from jaxstab.region.roots import bracketed_root

_FEWEST_NODES, _MOST_NODES = 33, 129  # per arc, to see where it bends and turns
_TURNS = 8  # vertical and horizontal tangents, for each eight slots of arcs
_BESIDE = 1e-8
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
    are monotone. ``size`` vertices are not such repetitions, and they form ``loops`` loops.
    ``corners`` (m, 2) are followed by NaN. Where the arcs are not ``resolved`` there is nothing.
    """

    vertices: Array
    branches: Array
    angles: Array
    size: Array
    loops: Array
    corners: Array
    resolved: Array


class _Marks(NamedTuple):
    """Points of the boundary: on which arc of the sequence, at which angle, and what they are.

    ``low`` is what rounding took from the angle ``theta``.
    """

    place: Array
    theta: Array
    low: Array
    exists: Array
    stage: Array


_ON_ARC, _VIA, _CLOSING = 0, 1, 2  # in the order in which an arc and what follows it pass them


def polygon(c: SliceCoefficients, arcs: Arcs, points: int, length: int | None = None) -> Outline:
    """Return an outline of exactly ``points`` vertices, spread so that all edges bend alike.

    Differentiable in the slice: vertices between corners stay at their share of the arc. With
    ``length``, that of the polynomials of the other roots, every fourth vertex is put to the test
    of these roots: a cut that the scan stepped over is noticed where a vertex falls on it.
    """
    slots = len(arcs.exists)
    turns = extra_vertices(slots) - 4 * slots
    order, loop = _sequence(arcs)
    arcs = jax.tree.map(lambda x: x[order] if x.ndim else x, arcs)
    # Barriers keep XLA from computing the curve again in every place that reads it.
    nodes, tangents = lax.optimization_barrier(_survey(c, arcs, _nodes(points)))
    extremes, fits = _turning_points(c, arcs, nodes, tangents, turns)
    place, theta = _spread(arcs, nodes, tangents, points - 4 * slots - turns)
    exist = jnp.broadcast_to(jnp.any(arcs.exists), place.shape)
    spread = _marks(_ON_ARC, place, theta, jnp.zeros_like(theta), exist)
    places = jnp.arange(slots)
    first = jnp.sum(loop[:, None] > loop, axis=1)
    closes = arcs.exists & (jnp.append(loop[1:], -1) != loop)
    begins, ends = (arcs.begin, arcs.begin_low), (arcs.end, arcs.end_low)
    others = [
        _marks(_ON_ARC, places, *begins, arcs.exists),
        _marks(_ON_ARC, places, *ends, arcs.exists),
        _marks(_VIA, places, *ends, arcs.via),
        _marks(_CLOSING, places, arcs.begin[first], arcs.begin_low[first], closes),
        extremes,
    ]
    extra = jax.tree.map(lambda *parts: jnp.concatenate(parts), *others)
    chosen = _merged(_keys(arcs, spread), _keys(arcs, extra))
    marks = jax.tree.map(lambda *parts: jnp.concatenate(parts), spread, extra)
    resolved = arcs.resolved & fits
    if length is not None:
        known, angles = lax.stop_gradient((c, theta[_TESTED]))
        sound = others_inside(known, angles, length, within=1.0 + _ROUNDED)
        resolved = resolved & jnp.all(sound | ~exist[_TESTED])
    count = jnp.where(resolved, jnp.sum(marks.exists), 0)
    chosen = chosen[jnp.clip(jnp.arange(points), max=jnp.maximum(count - 1, 0))]
    at_marks = _points(c, marks)
    marks = jax.tree.map(lambda x: x[chosen], marks)
    branches, angles = _edges(arcs, marks)
    corners = at_marks[len(place) : len(place) + 3 * slots]
    return Outline(
        vertices=jnp.where(count > 0, at_marks[chosen], jnp.nan),
        branches=jnp.where(jnp.arange(points - 1) < count - 1, branches, NO_BRANCH),
        angles=angles,
        size=count,
        loops=jnp.where(resolved, jnp.sum(closes), 0),
        corners=jnp.where(resolved, _corners(arcs, corners), jnp.nan),
        resolved=resolved,
    )


def _marks(stage: int, place: Array, theta: Array, low: Array, exists: Array) -> _Marks:
    return _Marks(place, theta, low, exists, jnp.full(place.shape, stage))


def _keys(arcs: Arcs, marks: _Marks) -> Array:
    """Return numbers that grow along the boundary."""
    along = (marks.theta - arcs.begin[marks.place]) / (arcs.end - arcs.begin)[marks.place]
    along = jnp.where(marks.stage == _ON_ARC, along, 1.0 + marks.stage)
    return lax.stop_gradient(jnp.where(marks.exists, 4.0 * marks.place + along, jnp.inf))


def _merged(many: Array, few: Array) -> Array:
    """Return the order of keys of which the many are in order already; by counting, not sorting."""
    order = jnp.argsort(few, stable=True)
    rank = jnp.arange(len(few)) + jnp.searchsorted(many, few[order])
    places = jnp.arange(len(many) + len(few))
    passed = jnp.sum(rank[:, None] <= places, axis=0)
    latest = jnp.maximum(passed - 1, 0)
    return jnp.where(rank[latest] == places, len(many) + order[latest], places - passed)


def _nodes(points: int) -> int:
    return min(max(points // 8 + 1, _FEWEST_NODES), _MOST_NODES)


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


def _survey(c: SliceCoefficients, arcs: Arcs, count: int) -> tuple[Array, Array]:
    """Return angles (arc, node) and the tangents (alpha', beta') there (2, arc, node)."""
    # At th = 0 and pi the curve stands still: look beside.
    begin = arcs.begin[:, None] + _BESIDE * (arcs.end - arcs.begin)[:, None]
    end = arcs.end[:, None] - _BESIDE * (arcs.end - arcs.begin)[:, None]
    shares = jnp.linspace(0.0, 1.0, count - 2 * (count // 4))
    nodes = [begin + (end - begin) * shares]
    # Half of them close in on the places where the curve flies off.
    shares = (jnp.arange(count // 4) + 0.5) / (count // 4)
    for pole, apart in zip(*poles(lax.stop_gradient(c)), strict=True):
        first, last = jnp.arcsinh((begin - pole) / apart), jnp.arcsinh((end - pole) / apart)
        nodes.append(jnp.clip(pole + apart * jnp.sinh(first + (last - first) * shares), begin, end))
    ordered = jnp.sort(jnp.concatenate(nodes, axis=1), axis=1)
    return ordered, jnp.stack(_tangent(c, ordered))


def _tangent(c: SliceCoefficients, theta: Array) -> tuple[Array, Array]:
    tangent: tuple[Array, Array] = jax.jvp(
        lambda angle: curve_point(c, angle), (theta,), (jnp.ones_like(theta),)
    )[1]
    return tangent


def _turning_points(
    c: SliceCoefficients, arcs: Arcs, nodes: Array, tangents: Array, slots: int
) -> tuple[_Marks, Array]:
    """Return where alpha or beta turns, and whether there is room for all of these places."""
    moves = jnp.abs(tangents) > _ROUNDING * jnp.hypot(*tangents)
    turns = (tangents[..., 1:] * tangents[..., :-1] < 0.0) & (moves[..., 1:] | moves[..., :-1])
    turns = turns & arcs.exists[:, None]
    flat = first_places(turns.ravel(), slots)
    exist = flat < turns.size
    is_beta, place, node = jnp.unravel_index(jnp.where(exist, flat, 0), turns.shape)

    def slope(slice_: SliceCoefficients, theta: Array) -> Array:
        along_alpha, along_beta = _tangent(slice_, theta)
        return jnp.where(is_beta == 1, along_beta, along_alpha)

    last = jnp.where(exist, nodes[place, node + 1], nodes[place, node])
    theta = bracketed_root(slope, c, nodes[place, node], last)
    marks = _marks(_ON_ARC, place, theta, jnp.zeros_like(theta), exist)
    return marks, jnp.sum(turns) <= slots


def _spread(arcs: Arcs, nodes: Array, tangents: Array, count: int) -> tuple[Array, Array]:
    """Return places and angles of points between which the boundary leaves its chord alike."""
    alpha, beta = tangents
    turned = jnp.abs(alpha[:, 1:] * beta[:, :-1] - alpha[:, :-1] * beta[:, 1:])
    speed = jnp.hypot(alpha, beta)
    steps = jnp.diff(nodes, axis=1)
    bend = jnp.sqrt(turned * steps / (speed[:, 1:] + speed[:, :-1]))
    bend = jnp.where(arcs.exists[:, None], bend, 0.0)
    pieces = jnp.maximum(jnp.sum(arcs.exists), 1) * steps.shape[1]
    bend = jnp.where(arcs.exists[:, None], bend + _EVENNESS * jnp.sum(bend) / pieces, 0.0)
    total = jnp.cumsum(lax.stop_gradient(bend).ravel())
    goal = total[-1] * (jnp.arange(count) + 0.5) / count
    piece = jnp.minimum(jnp.searchsorted(total, goal), total.size - 1)
    width = lax.stop_gradient(bend).ravel()[piece]
    rest = jnp.where(width > 0.0, (goal - total[piece]) / jnp.where(width > 0.0, width, 1.0), 0.0)
    place, node = jnp.unravel_index(piece, bend.shape)
    return place, nodes[place, node + 1] + steps[place, node] * rest


def _points(c: SliceCoefficients, marks: _Marks) -> Array:
    on_curve = jnp.stack(curve_point(c, marks.theta, marks.low), axis=-1)
    on_curve = lax.optimization_barrier(on_curve)
    crossing = jnp.stack(lines_crossing(c))
    return jnp.where((marks.stage == _VIA)[:, None], crossing, on_curve)


def _edges(arcs: Arcs, marks: _Marks) -> tuple[Array, Array]:
    """Return for the edge after each vertex its branch and the angles at its ends."""
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
    return branches, jnp.stack([here.theta, jnp.where(same_arc, there.theta, here.theta)], axis=-1)


def _corners(arcs: Arcs, points: Array) -> Array:
    """Return the corners in the order of the boundary, of the points at begins, ends and vias."""
    # Where an arc ends on the curve, the next one begins: count that corner once.
    ends_on_line = arcs.exists & (arcs.end_branch != Branch.CURVE)
    exist = jnp.stack([arcs.exists, ends_on_line, arcs.via], axis=1).ravel()
    corners = points.reshape(3, -1, 2).swapaxes(0, 1).reshape(-1, 2)
    place = first_places(exist, len(exist))
    found = place < len(exist)
    return jnp.where(found[:, None], corners[jnp.where(found, place, 0)], jnp.nan)
