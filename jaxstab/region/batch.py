"""Limits of many loops at once, in one program of JAX: any plant, estimator, filter and delay.

A loop is its triple: p(z) = base + alpha stiffness + beta damping. All triples of a batch have one
degree: p(z) times a power of z has more roots at 0, and the same stable set. On the unit circle
p = 0 gives the curve, by Cramer's rule,

    alpha = Im(conj(R) base) / det,     beta = -Im(conj(S) base) / det,     det = Im(conj(S) R).

Where det = 0 the curve goes to infinity: these *poles* follow from the estimator alone, so that all
branches are known before the scan. The program, for each loop:

1. *Scan.* At each angle p is divided by the pair on the circle, z^2 - 2 cos(th) z + 1, and the
   recursion of Schur and Cohn tells whether all other roots are inside: there the curve bounds the
   stable set (lemma G1 of docs/proofs.md). Neighbouring angles that pass are one piece.
2. *Ends.* A piece ends where another root reaches the circle: z = 1 or z = -1, where the margin
   p(1) or p(-1) changes its sign, or else another pair, at a corner with another piece. Bisection
   brackets the end, Newton's method solves for the corner. If no piece ends at the angle of that
   pair, the scan missed one there: a second scan is finer next to it (``missed``).
3. *Loops.* Seen in the direction in which the stable set is on the left, each piece is followed by
   the one that begins where it ends, or by the next one along the line of a real root, or around
   the crossing of both lines. Each piece must follow exactly one.
4. *Component.* A wall with small gains is enclosed by one of the loops: that is the component of
   walls that are connected to zero gains. One loop far from 0 is an island.
5. *Extremes.* The largest alpha where beta >= 0, and the largest beta where alpha >= 0, are at
   corners, where the curve turns, or where the boundary crosses the axis of that gain: the best
   angles of the scan are refined by Newton's method.

Each step has a test, and a loop that fails one of them is UNRESOLVED: pieces that do not join, more
of them than there is room for, no or several loops around small gains, extremes that do not
converge, whose rounding errors are large, or beside which stable and unstable walls are not where
they should be. What no test notices is a component that is cut in two, or dented, between two
angles of the scan. Small angles are evaluated in powers of z - 1, as elsewhere (``exact``).
"""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array, repeat, repeat_while
from jaxstab.batches import LEAN, compiler_options
from jaxstab.region.pieces import MARGIN, Branch
from jaxstab.rounding import UNIT

SLOTS = 6  # pieces of one loop
ISLAND = 1 << 10  # in place of failures: resolved, but small gains are not stable
_VERTICES, _FINE = 48, 192  # of a piece, and angles between which they are spread
_TILE = 64  # angles of a scan at once
_TOLERANCE = 1e-10  # of Newton's steps, in radians
_SLACK = 1e-6  # of angles beside their brackets
_ON_AXIS = 1e-10  # of the component's size: a corner that far beyond an axis is on it


class Triples(NamedTuple):
    """Loops of one degree, by their coefficients; the first axis is that of the loops.

    Attributes:
        straight: base, stiffness and damping in powers of z, the highest one first.
        shifted: the same in powers of z - 1.
        close: where abs(z - 1) is less, powers of z - 1 have the smaller terms; for each part.
        ends: the same three parts of p(1) and of (-1)^n p(-1), up to positive factors.
        angles: of the scan, ascending in (0, pi); the poles are among them.
    """

    straight: Float64[Array, "*loop 3 coefficient"]
    shifted: Float64[Array, "*loop 3 coefficient"]
    close: Float64[Array, "*loop 3"]
    ends: Float64[Array, "*loop 2 3"]
    angles: Float64[Array, "*loop angle"]


class Extremes(NamedTuple):
    """The walls (alpha, beta) of the largest alpha and of the largest beta, and what is known.

    Both gains are >= 0. ``angles`` are those of the roots on the circle there: the second one is
    that of the other root at a corner, and NaN where the boundary turns or crosses an axis, which
    makes the other gain 0. ``failures`` has a bit for each test of the
    module's text that failed; 0 is resolved. ``missed`` are the two angles next to which the scan
    most likely missed a piece, should it have done so.
    """

    walls: Float64[Array, "*loop 2 2"]
    angles: Float64[Array, "*loop 2 2"]
    failures: Array
    missed: Float64[Array, "*loop 2"]


class _Scan(NamedTuple):
    passes: Bool[Array, " angle"]
    walls: Float64[Array, "2 angle"]
    sense: Float64[Array, " angle"]


class _PieceEnds(NamedTuple):
    """The ends of pieces: row 0 at the smaller angle, row 1 at the larger one."""

    exists: Array  # (piece,)
    next_to: Array  # (2, piece) number of the scan's angle next to it
    theta: Array  # (2, piece)
    branch: Array  # (2, piece)
    width: Array  # (2, piece) of the bracket
    pinned: Array  # (2, piece)


class MainOutline(NamedTuple):
    """The closed outline of the component that holds small gains, counter-clockwise.

    Attributes:
        vertices: walls (alpha, beta) on the exact boundary; the last ones repeat the first.
        roots: the angles of the root on the circle at each vertex, on the edge before and on the
            one after it; on a line 0 or pi.
        area: of the exact region.
    """

    vertices: Float64[Array, "*loop vertex 2"]
    roots: Float64[Array, "*loop vertex 2"]
    area: Float64[Array, "*loop"]


Answers = tuple[Extremes, MainOutline | None]


@lru_cache(maxsize=8)  # each takes 40 to 90 MB
def program(degree: int, *, outlines: bool = False) -> Callable[[Triples], Answers]:
    """Return the compiled program for triples of one degree; the oldest of many are dropped."""
    solve = partial(components, outlines=outlines)
    return jax.jit(solve, compiler_options=compiler_options(LEAN))


def components(triples: Triples, *, outlines: bool) -> Answers:
    """Return extreme walls of the components that hold small gains, and their outlines."""
    count = len(triples.angles)
    refined = min(64, count)  # loops at once: what they need stays in the cache
    scans = lax.map(_scan, triples)
    # The first ones again fill up the last batch: a smaller one would be compiled on its own.
    pairs = jax.tree.map(lambda x: jnp.append(x, x[: -count % refined], axis=0), (triples, scans))
    solved = lax.map(lambda pair: _extremes(*pair), pairs, batch_size=refined)
    solved = jax.tree.map(lambda x: x[:count], solved)
    pieces: _Component = solved[0]
    extremes: Extremes = solved[1]
    if not outlines:
        return extremes, None
    return extremes, lax.map(lambda pair: _outline(*pair), (triples, pieces))


# ------------------------------------------------------------------------ the curve and its roots
def _curve(loop: Triples, theta: Array) -> tuple[Array, Array]:
    (base, stiffness, damping) = _values(loop, theta)
    det = cross(stiffness, damping)
    walls = jnp.stack([cross(damping, base), -cross(stiffness, base)]) / det
    return walls, det


def _wall(loop: Triples, theta: Array) -> Array:
    return _curve(loop, theta)[0]


def _with_slopes(loop: Triples, theta: Array) -> tuple[Array, Array]:
    return jax.jvp(partial(_wall, loop), (theta,), (jnp.ones_like(theta),))


def cross(one: Any, other: Any) -> Array:
    """Return the cross product of vectors (2, ...), or Im of other times the conjugate of one."""
    return one[0] * other[1] - one[1] * other[0]


def _values(loop: Triples, theta: Array) -> list[tuple[Array, Array]]:
    """Return the three parts at exp(i theta), as real and imaginary parts."""
    sine, half = jnp.sin(theta), jnp.sin(0.5 * theta)
    step = -2.0 * half * half
    axes = tuple(range(1, theta.ndim + 1))
    is_close = 2.0 * half < jnp.expand_dims(loop.close, axes)
    cosine = jnp.where(is_close, step, 1.0 + step)  # of z or z - 1

    def next_power(
        value: tuple[Array, Array], power: tuple[Array, Array]
    ) -> tuple[tuple[Array, Array], None]:
        x, y = value
        near, far = (jnp.expand_dims(row, axes) for row in power)
        moved = x * cosine - y * sine + jnp.where(is_close, near, far)
        return (moved, x * sine + y * cosine), None

    zeros = jnp.zeros((3, *theta.shape))
    falling = loop.shifted.T, loop.straight.T
    real, imag = lax.scan(next_power, (zeros, zeros), falling)[0]
    return list(zip(real, imag, strict=True))


def _margins(loop: Triples, walls: Array) -> Array:
    """Return p(1) and (-1)^n p(-1) of walls (2, ...), up to positive factors."""
    base, stiffness, damping = (
        loop.ends[:, k].reshape(2, *(1 for _ in walls.shape[1:])) for k in range(3)
    )
    return base + (stiffness * walls[0] + damping * walls[1])


def _reduced(
    loop: Triples, walls: Array, total: Array, product: float, removed: int, least: int = 1
) -> tuple[Array, Array]:
    """Divide p by two of its roots, and lower its degree by the recursion of Schur and Cohn.

    Args:
        loop: one loop.
        walls: alpha and beta (2, wall).
        total: sum of these two.
        product: of them; the divisor is z^2 - total z + product.
        removed: 2, or 0 if p is not divided at all.
        least: how many coefficients to end with.

    Returns:
        These coefficients, and where no step met a root on the circle or outside.
    """
    lowered = 8  # steps of the recursion between which its arrays get shorter

    def divided(last: tuple[Array, Array], part: Array) -> tuple[tuple[Array, Array], Array]:
        value = part[0] + (part[1] * walls[0] + part[2] * walls[1])
        value = value + total * last[1] - product * last[0]
        return (last[1], value), value

    nothing = jnp.zeros_like(walls[0])
    count = loop.straight.shape[1] - removed
    _, falling = lax.scan(divided, (nothing, nothing), loop.straight.T[:count])

    state = falling, falling[::-1], jnp.ones(nothing.shape, bool)
    while count > least:
        steps = min(lowered, count - least)
        falling, rising, inside = repeat(steps, _reflected, state)
        count -= steps
        state = falling[:count], rising[:count], inside
    return state[0], state[2]


def _reflected(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """One step of Schur and Cohn: a polynomial, its reverse, and whether all so far are inside.

    The degree falls by one; the first axis keeps its length, with noise and zeros behind.
    """
    falling, rising, inside = state
    reflection = rising[0] / falling[0]
    lower = rising - reflection * falling
    return (
        falling - reflection * rising,
        jnp.concatenate([lower[1:], jnp.zeros_like(lower[:1])]),
        inside & (abs(reflection) < 1.0 - MARGIN),
    )


def _bounds(loop: Triples, theta: Array) -> tuple[Array, Array, Array]:
    """Return the curve, det, and where it bounds the stable set: all other roots are inside."""
    walls, det = _curve(loop, theta)
    inside = _reduced(loop, walls, 2.0 * jnp.cos(theta), 1.0, 2)[1]
    return walls, det, inside & jnp.all(_margins(loop, walls) > 0.0, axis=0)


def _are_stable(loop: Triples, walls: Array) -> Array:
    inside = _reduced(loop, walls, jnp.zeros_like(walls[0]), 0.0, 0)[1]
    return inside & jnp.all(_margins(loop, walls) > 0.0, axis=0)


def _scan(loop: Triples) -> _Scan:
    """Return where the curve bounds the stable set; the recursion runs where p(1), p(-1) let it."""
    walls, det = _curve(loop, loop.angles)
    is_candidate = jnp.all(_margins(loop, walls) > 0.0, axis=0)
    count, total = len(loop.angles), jnp.sum(is_candidate)
    room = -(-count // _TILE) * _TILE
    index = jnp.searchsorted(jnp.cumsum(is_candidate), jnp.arange(1, room + 1))

    def next_tile(tile: Array, passes: Array) -> Array:
        own = lax.dynamic_slice(index, (tile * _TILE,), (_TILE,))
        chosen = jnp.minimum(own, count - 1)
        pair = 2.0 * jnp.cos(loop.angles[chosen])
        inside = _reduced(loop, walls[:, chosen], pair, 1.0, 2)[1]
        return passes.at[own].set(inside, mode="drop")

    passes = lax.fori_loop(0, -(-total // _TILE), next_tile, jnp.zeros(count, bool))
    return _Scan(passes, walls, jnp.sign(det))


# ------------------------------------------------------------------------ pieces and loops
def _ends_of(loop: Triples, scan: _Scan) -> tuple[_PieceEnds, Array]:
    """Return the ends of the pieces, bracketed, and whether there is room for all."""
    halvings = 8  # of the brackets of ends
    passes, angles = scan.passes, loop.angles
    last = len(angles) - 1
    is_first = passes & ~jnp.append(False, passes[:-1])
    is_last = passes & ~jnp.append(passes[1:], False)
    counts = jnp.arange(1, SLOTS + 1)
    index = jnp.stack([jnp.searchsorted(jnp.cumsum(at), counts) for at in (is_first, is_last)])
    exists = index[0] <= last
    index = jnp.minimum(index, last)
    beyond = index + jnp.array([[-1], [1]])
    pinned = (beyond < 0) | (beyond > last)
    inner = angles[index]
    outer = jnp.where(pinned, inner, angles[jnp.clip(beyond, 0, last)])

    def halved(both: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = 0.5 * (both[0] + both[1])
        inside = _bounds(loop, middle.ravel())[2].reshape(middle.shape)
        return jnp.where(inside, middle, both[0]), jnp.where(inside, both[1], middle)

    inner, outer = repeat(halvings, halved, (inner, outer))
    margins = _margins(loop, _wall(loop, outer))
    met = jnp.where(margins[1] <= 0.0, Branch.Z_MINUS_ONE, Branch.CURVE)
    met = jnp.where(margins[0] <= 0.0, Branch.Z_PLUS_ONE, met)
    at_limit = jnp.array([[Branch.Z_PLUS_ONE], [Branch.Z_MINUS_ONE]])
    return _PieceEnds(
        exists=exists,
        next_to=index,
        theta=0.5 * (inner + outer),
        branch=jnp.where(pinned, at_limit, met),
        width=abs(outer - inner),
        pinned=pinned,
    ), jnp.sum(is_first) <= SLOTS


class _Corners(NamedTuple):
    """The ends in the direction of travel: row 0 where pieces begin, row 1 where they end."""

    exists: Array
    theta: Array
    branch: Array
    walls: Array  # (2, row, piece)
    slopes: Array  # in the direction of travel
    following: Array  # piece that begins nearest to the end of each
    preceding: Array  # piece that ends nearest to the beginning of each
    is_solved: Array  # (piece,)
    is_lower: Array  # (2, piece) whether the end is the piece's smallest angle
    next_to: Array


def _corners_of(loop: Triples, ends: _PieceEnds, sense: Array, size: Array) -> _Corners:
    forward = sense > 0.0

    def turned(rows: Array) -> Array:
        return jnp.where(forward, rows, rows[::-1])

    theta, branch, width, pinned, index = map(
        turned, (ends.theta, ends.branch, ends.width, ends.pinned, ends.next_to)
    )
    rough = _wall(loop, theta) / size[:, None, None]
    is_open = ends.exists & (branch == Branch.CURVE)
    gaps = jnp.sum((rough[:, 1, :, None] - rough[:, 0, None, :]) ** 2, axis=0)
    gaps = jnp.where(is_open[1][:, None] & is_open[0] & jnp.isfinite(gaps), gaps, jnp.inf)
    following, preceding = jnp.argmin(gaps, axis=1), jnp.argmin(gaps, axis=0)
    partner = jnp.stack([theta[1][preceding], theta[0][following]])
    is_mutual = preceding[following] == jnp.arange(SLOTS)

    def newton(kind: Array, is_fixed: Array, angles: Array) -> Array:
        """Return the next angles of a corner, or of an end on a line and unchanged its partner."""
        walls, slopes = _with_slopes(loop, angles)
        to_line, rises = _margins(loop, walls[:, 0]), loop.ends[:, 1:] @ slopes[:, 0]
        line = jnp.where(kind == Branch.Z_PLUS_ONE, 0, 1)
        gap = (walls[:, 0] - walls[:, 1]) / size
        own, other = slopes.T / size
        on_curve = jnp.stack([cross(gap, other), cross(gap, own)]) / cross(own, other)
        on_line = jnp.stack([to_line[line] / rises[line], 0.0])
        step = jnp.where(kind == Branch.CURVE, on_curve, on_line)
        return angles - jnp.where(is_fixed, 0.0, step)

    start = jnp.stack([theta, partner], axis=-1)
    fixed = pinned | ~ends.exists

    def solve(kind: Array, is_fixed: Array, start: Array) -> tuple[Array, Array]:
        return _root(partial(newton, kind, is_fixed), start)

    solution, is_solved = jax.vmap(jax.vmap(solve))(branch, fixed, start)
    moved = abs(solution[..., 0] - theta) <= width + _SLACK
    is_solved = pinned | (is_solved & moved)
    theta = jnp.where(pinned, theta, solution[..., 0])
    walls, slopes = _with_slopes(loop, theta)
    base, stiffness, damping = loop.ends[0]
    at_one = 0.0 - (base + damping * walls[1]) / stiffness  # 0 without a hand's stiffness
    walls = walls.at[0].set(jnp.where(branch == Branch.Z_PLUS_ONE, at_one, walls[0]))
    closes = (branch[1] != Branch.CURVE) | is_mutual
    return _Corners(
        exists=ends.exists,
        theta=theta,
        branch=branch,
        walls=walls,
        slopes=slopes * jnp.where(forward, 1.0, -1.0),
        following=following,
        preceding=preceding,
        is_solved=jnp.all(is_solved, axis=0) & closes,
        is_lower=turned(jnp.array([[True], [False]]) & ends.exists),
        next_to=index,
    )


def _missed(loop: Triples, ends: _PieceEnds) -> Array:
    """Return where a second root is on the circle at an end of a piece and no end is: two angles.

    The recursion of Schur and Cohn keeps a pair on the circle: its last z^2 - 2 cos(th) z + 1 is
    that of the second root. There another piece begins or ends.
    """
    apart = 1e-3  # of angles that are those of two ends
    total = 2.0 * jnp.cos(ends.theta.ravel())
    walls = _wall(loop, ends.theta.ravel())
    quadratic, _ = _reduced(loop, walls, total, 1.0, 2, least=3)
    other = jnp.arccos(-0.5 * quadratic[1] / quadratic[0])
    distance = abs(other[:, None] - ends.theta.ravel())
    distance = jnp.min(jnp.where(jnp.tile(ends.exists, 2), distance, jnp.inf), axis=1)
    is_open = (ends.exists & (ends.branch == Branch.CURVE)).ravel() & jnp.isfinite(other)
    distance, farthest = lax.top_k(jnp.where(is_open, distance, -jnp.inf), 2)
    angles = jnp.where(distance > apart, other[farthest], other[farthest[0]])
    return jnp.where(distance[0] > apart, angles, jnp.nan)


def _root(newton: Callable[[Array], Array], start: Array) -> tuple[Array, Array]:
    """Return the fixed point of Newton's step, and whether it was reached.

    By no library: an import while a user's function is traced would have it compiled again.
    """
    most = 24  # steps

    def step(state: tuple[Array, ...]) -> tuple[Array, ...]:
        place, _, count = state
        moved = newton(place)
        away = abs(moved - place) / (_TOLERANCE * (1.0 + abs(moved)))
        return moved, jnp.max(away), count + 1

    def is_open(state: tuple[Array, ...]) -> Array:
        return (state[1] >= 1.0) & (state[2] < most)  # not where a step led to NaN

    place, away, _ = repeat_while(is_open, step, (start, jnp.array(jnp.inf), jnp.array(0)))
    return place, away < 1.0


def _fall(values: Any, start: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return where a function falls through 0, and whether it was reached.

    ``values`` gives it and its slope. It is > 0 at ``low`` and < 0 at ``high``: steps of Newton's
    method that lead out of what is between them are halvings instead.
    """

    def step(place: Array) -> Array:
        theta, low, high = place
        value, slope = values(theta)
        low, high = jnp.where(value > 0.0, theta, low), jnp.where(value > 0.0, high, theta)
        newton = theta - value / slope
        theta = jnp.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
        return jnp.stack([theta, low, high])

    place, is_reached = _root(step, jnp.stack([start, low, high]))
    return place[0], is_reached


class _Links(NamedTuple):
    successor: Array
    via: Array
    is_linked: Array  # whether it has one, and is one's
    crossing: Array  # the wall of both lines


def _linked(loop: Triples, corners: _Corners) -> _Links:
    """The piece that follows each, and True where by way of the crossing of both lines."""
    base, stiffness, damping = loop.ends.T
    along = jnp.stack([damping, -stiffness], axis=1)  # the stable side is on the left
    crossing = jnp.stack([cross(damping, base), cross(base, stiffness)]) / cross(stiffness, damping)
    line = jnp.where(corners.branch[1] == Branch.Z_MINUS_ONE, 1, 0)
    begins, ends = (jnp.einsum("lw,wp->lp", along, corners.walls[:, row]) for row in range(2))
    corner = along @ crossing
    pieces = jnp.arange(SLOTS)
    own = corners.exists & (corners.branch[0] == line[:, None] + Branch.Z_PLUS_ONE)
    other = corners.exists & (corners.branch[0] == Branch.Z_MINUS_ONE - line[:, None])
    here = ends[line, pieces]
    ahead = jnp.where(own, begins[line] - here[:, None], -jnp.inf)
    around = jnp.where(other, begins[1 - line] - corner[1 - line][:, None], -jnp.inf)
    to_corner = corner[line] - here
    turns = jnp.sum(along[line] * loop.ends[1 - line, 1:], axis=1) < 0.0  # into the other line
    turns = turns & jnp.isfinite(to_corner) & (to_corner >= 0.0)
    ahead = jnp.where(ahead > 0.0, ahead, jnp.inf)
    around = jnp.where(around > 0.0, around, jnp.inf)
    nearest = jnp.min(ahead, axis=1)
    via = turns & (to_corner < nearest)
    successor = jnp.argmin(jnp.where(via[:, None], around, ahead), axis=1)
    is_linked = jnp.isfinite(jnp.where(via, jnp.min(around, axis=1), nearest))
    on_curve = corners.branch[1] == Branch.CURVE
    successor = jnp.where(on_curve, corners.following, successor)
    predecessors = jnp.sum(corners.exists[:, None] & (successor[:, None] == pieces), axis=0)
    # Where the lines cross all other roots are inside.
    zero = jnp.zeros(1)
    is_stable = _reduced(loop, crossing[:, None], zero, -1.0, 2)[1][0]
    via = via & ~on_curve & corners.exists
    is_linked = (on_curve | is_linked) & (predecessors == 1) & (~via | is_stable)
    return _Links(successor, via, is_linked, crossing)


def _loops(successor: Array) -> Array:
    """Return for each piece the least number of its loop's pieces."""
    label = jnp.arange(SLOTS)
    for _ in range(SLOTS.bit_length()):
        label, successor = jnp.minimum(label, label[successor]), successor[successor]
    return label


def _are_around(
    scan: _Scan, corners: _Corners, links: _Links, labels: tuple[Array, Array], points: Array
) -> Array:
    """True where loops (point, label) enclose points (2, point), by the rule of odd crossings.

    ``labels``: of the pieces, and of the angles of the scan.
    """
    of_pieces, of_angles = labels
    is_edge = scan.passes[:-1] & scan.passes[1:]
    beside = scan.walls[:, corners.next_to]  # (2, row, piece)
    first = corners.walls[:, 0][:, links.successor]
    last = corners.walls[:, 1]
    middle = jnp.where(links.via, links.crossing[:, None], first)
    here = [scan.walls[:, :-1], corners.walls[:, 0], beside[:, 1], last, middle]
    there = [scan.walls[:, 1:], beside[:, 0], last, middle, first]
    exist = jnp.concatenate([is_edge, *[corners.exists] * 4])
    of_loop = jnp.concatenate([of_angles[:-1], *[of_pieces] * 4])
    (x0, y0), (x1, y1) = jnp.concatenate(here, axis=1), jnp.concatenate(there, axis=1)
    x, y = points[..., None]
    meets = exist & ((y0 > y) != (y1 > y))
    share = (y - y0) / jnp.where(y1 == y0, 1.0, y1 - y0)
    meets = meets & (x0 + share * (x1 - x0) > x)
    members = of_loop[:, None] == jnp.arange(SLOTS)
    return (meets.astype(jnp.float64) @ members.astype(jnp.float64)) % 2.0 == 1.0


# ------------------------------------------------------------------------ components and extremes
class _Component(NamedTuple):
    """The pieces of a loop, and which of them are of the component that holds small gains."""

    size: Array  # of alpha and beta on all pieces
    corners: _Corners
    links: _Links
    main: Array  # its first piece
    in_main: Array  # (angle,)
    of_main: Array  # (piece,)
    is_island: Array
    tests: Array
    missed: Array


def _component(loop: Triples, scan: _Scan) -> _Component:
    far_away = 1e-3  # of the set's size: no small gains are this far from 0
    size = jnp.max(jnp.where(scan.passes, abs(scan.walls), 0.0), axis=1)
    size = jnp.where(size > 0.0, size, 1.0)
    ends, has_room = _ends_of(loop, scan)
    sense = scan.sense[ends.next_to]
    corners = _corners_of(loop, ends, sense[0], size)
    links = _linked(loop, corners)
    label = _loops(links.successor)
    is_joined = jnp.all(~corners.exists | (corners.is_solved & links.is_linked))

    piece = jnp.cumsum(scan.passes & ~jnp.append(False, scan.passes[:-1])) - 1
    of_angles = label[jnp.clip(piece, 0, SLOTS - 1)]
    small, count = _small_walls(loop, size)
    around = _are_around(scan, corners, links, (label, of_angles), small)
    around = around & (jnp.arange(SLOTS) == label)
    firsts = corners.exists & (label == jnp.arange(SLOTS))
    nearest = jnp.min(jnp.where(scan.passes, jnp.hypot(*scan.walls / size[:, None]), jnp.inf))
    is_island = (count == 0) & (nearest > far_away) & (jnp.sum(firsts) == 1)
    main = jnp.argmax(jnp.where(is_island, firsts, around[0]))
    is_around = (count >= 3) & jnp.all(jnp.sum(around, axis=1) == 1) & jnp.all(around[:, main])
    in_main = scan.passes & (of_angles == main)
    of_main = corners.exists & (label == main)
    tests = jnp.stack([has_room, corners.exists[0], is_joined, is_around | is_island])
    missed = _missed(loop, ends)
    return _Component(size, corners, links, main, in_main, of_main, is_island, tests, missed)


def _extremes(loop: Triples, scan: _Scan) -> tuple[_Component, Extremes]:
    component = _component(loop, scan)
    largest = partial(_largest, loop, scan, component)
    walls, angles, are_sound = jax.vmap(largest)(jnp.arange(2))
    tests = jnp.append(component.tests, are_sound)
    failures = jnp.sum((~tests).astype(jnp.int32) << jnp.arange(len(tests)))
    failures = failures + jnp.where(component.is_island, ISLAND, 0)
    return component, Extremes(walls, angles, failures, component.missed)


# ------------------------------------------------------------------------ outlines
def _outline(loop: Triples, component: _Component) -> MainOutline:
    """Return the component's outline from piece to piece, and its area.

    Vertices lie at about equal distances on each piece, in units of the component's size. The area
    is the integral of (alpha dbeta - beta dalpha) / 2, by Gauss's rule between the vertices of a
    piece, and exact on straight edges.
    """
    nodes, weights = np.polynomial.legendre.leggauss(4)
    size, corners, links, main, *_ = component

    def followed(piece: Array, _: None) -> tuple[Array, Array]:
        return links.successor[piece], piece

    _, order = lax.scan(followed, main, length=SLOTS)
    exists = jnp.arange(SLOTS) < jnp.sum(component.of_main)
    begin, end = corners.theta[:, order]

    def spread(ends: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        """Return angles and walls of the vertices of a piece, and twice the area that it sweeps."""
        begin, end = ends
        share = jnp.linspace(0.0, 1.0, _FINE)
        fine = begin + (end - begin) * share * share * (3.0 - 2.0 * share)  # finer at both ends
        steps = jnp.diff(_wall(loop, fine) / size[:, None], axis=1)
        length = jnp.append(0.0, jnp.cumsum(jnp.hypot(*steps)))
        theta = jnp.interp(jnp.linspace(0.0, length[-1], _VERTICES), length, fine).at[-1].set(end)
        middle, half = 0.5 * (theta[1:] + theta[:-1]), 0.5 * jnp.diff(theta)
        at_nodes, slopes = _with_slopes(loop, middle + half * nodes[:, None])
        return theta, _wall(loop, theta), jnp.sum(half * (weights @ cross(at_nodes, slopes)))

    def nothing(_: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        return jnp.zeros(_VERTICES), jnp.zeros((2, _VERTICES)), jnp.zeros(())

    # Most loops have one piece: the others are not computed.
    theta, walls, swept = lax.map(
        lambda piece: lax.cond(piece[0], spread, nothing, piece[1:]), (exists, begin, end)
    )
    theta, walls = theta.T, walls.transpose(1, 2, 0)
    walls = walls.at[:, 0].set(corners.walls[:, 0][:, order])
    walls = walls.at[:, -1].set(corners.walls[:, 1][:, order])
    first = jnp.roll(walls[:, 0], -1, axis=1)
    first = jnp.where(jnp.roll(exists, -1), first, walls[:, :1, 0])  # closes the loop
    corner = jnp.where(links.via[order], links.crossing[:, None], walls[:, -1])

    swept = swept + cross(walls[:, -1], corner) + cross(corner, first)
    area = 0.5 * jnp.sum(jnp.where(exists, swept, 0.0))

    def beyond(row: int, partner: Array) -> Array:
        """Return the angle of the root on the other edge at an end of each piece."""
        branch = corners.branch[row]
        on_line = jnp.where(branch == Branch.Z_MINUS_ONE, jnp.pi, 0.0)
        return jnp.where(branch == Branch.CURVE, corners.theta[1 - row, partner], on_line)[order]

    before, after = beyond(0, corners.preceding), beyond(1, corners.following)
    around = jnp.where(
        links.via[order], jnp.stack([after, jnp.pi - after]), jnp.stack([end, after])
    )
    entering = jnp.concatenate([before[None], theta[1:], around[:1]])
    leaving = jnp.concatenate([theta[:-1], after[None], around[1:]])
    vertices = jnp.concatenate([walls, corner[:, None]], axis=1)
    rows = jnp.concatenate([vertices, jnp.stack([entering, leaving])])
    rows = jnp.where(exists, rows, rows[:, :1, :1])
    closed = jnp.append(rows.transpose(2, 1, 0).reshape(-1, 4), rows[:, 0, :1].T, axis=0)
    return MainOutline(closed[:, :2], closed[:, 2:], area)


def _small_walls(loop: Triples, size: Array) -> tuple[Array, Array]:
    """Return two walls (2, point) that are stable with all smaller ones, and how many there are.

    Float64 hardly tells whether the smallest are: they are as larger ones, as to first order in the
    gains roots move in proportion to these, unless a root of base is outside.
    """
    hardly = 3  # the smallest walls, which float64 may not tell
    small = np.array([1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 3e-2])  # beside the size of the stable set
    ratios = np.array([1e-2, 1e-1, 0.3, 1.0])  # of alpha to beta, in that measure
    alpha = small * ratios[:, None] * size[0]
    beta = jnp.broadcast_to(small * size[1], alpha.shape)
    walls = jnp.stack([alpha, beta])
    stable = _are_stable(loop, walls.reshape(2, -1)).reshape(alpha.shape)
    likely = stable[:, hardly : hardly + 2].all(axis=1, keepdims=True)
    likely = likely & jnp.all(_margins(loop, walls) > 0.0, axis=0)
    stable = stable | (likely & (jnp.arange(len(small)) < hardly))
    counts = jnp.sum(jnp.cumprod(stable, axis=1), axis=1)
    best = jnp.argmax(counts)
    count = counts[best]
    two = jnp.clip(jnp.stack([count - 1, count - 2]), 0)
    return jnp.stack([alpha[best, two], beta[best, two]]), count


def _largest(
    loop: Triples, scan: _Scan, component: _Component, axis: Array
) -> tuple[Array, Array, Array]:
    aside = 1e-6  # of the component's size: where walls beside the extremes are tested
    lower = 5e-3  # beside the largest value: how much less the others have to be
    rounded = 1e-10  # of an extreme: the most that rounding may move it by
    size, unit = component.size, component.size[axis]
    turns = _turns(loop, scan, component, axis)
    corner = _highest_corner(component, axis)
    crossing = _on_axis(loop, scan, component, axis)
    turn = jnp.argmax(turns.values)
    others = jnp.maximum(turns.values[turn], corner.value)
    is_crossing = crossing.wall[axis] > others + _ON_AXIS * unit
    is_smooth = is_crossing | (turns.values[turn] > corner.value)
    smooth_wall = jnp.where(is_crossing, crossing.wall, turns.walls[:, turn])
    smooth_angle = jnp.where(is_crossing, crossing.theta, turns.theta[turn])

    walls = jnp.where(is_smooth, smooth_wall[:, None], corner.walls)
    theta = jnp.where(is_smooth, smooth_angle, corner.theta)
    errors = jax.vmap(partial(_rounding, loop), (0, 1, None))(theta, walls, axis) / unit
    errors = jnp.where(is_crossing & crossing.is_on_line, UNIT, errors)
    wall, error = walls[:, jnp.argmin(errors)], jnp.min(errors)
    value = wall[axis]
    enough, for_turns = (most - lower * abs(most) for most in (value, others))
    # A turn next to the axis may be much higher than the scan's angles and the crossing beside it.
    is_refined = jnp.all(turns.is_solved | (turns.best <= for_turns)) & (turns.rest <= enough)
    is_refined = is_refined & (crossing.rest <= enough)

    # Stable walls on one side, unstable ones on the other.
    straight = jnp.where(jnp.arange(2) == axis, -1.0, 0.0)
    into = _bisector(loop, component.corners, corner.index, size)
    away = aside * size * jnp.where(is_smooth, straight, into)
    beside = _are_stable(loop, jnp.stack([wall + away, wall - away], axis=1))
    # A component far beyond the quadrant may leave a limit that is small beside its size.
    is_exact = (error * unit < rounded * jnp.minimum(unit, abs(value))) & jnp.isfinite(value)
    roots = jnp.where(is_smooth, jnp.stack([smooth_angle, jnp.nan]), corner.roots)
    return wall, roots, jnp.stack([is_refined, beside[0] & ~beside[1], is_exact])


def _are_in_quadrant(walls: Array, size: Array, axis: Array) -> Array:
    return walls[1 - axis] >= -_ON_AXIS * size[1 - axis]


class _Turns(NamedTuple):
    """The highest places where the curve turns, refined.

    ``values``: of the gain, -inf where it is not solved for or outside of the quadrant. ``best``:
    before it was refined. ``rest``: no other place was higher.
    """

    walls: Array  # (2, turn)
    theta: Array
    values: Array
    is_solved: Array
    best: Array
    rest: Array


def _turns(loop: Triples, scan: _Scan, component: _Component, axis: Array) -> _Turns:
    """Return where the curve turns: next to values of the scan larger than both neighbours.

    Between a corner and the nearest angle of the scan it may turn, too: a bulge.
    """
    size, corners, of_main = component.size, component.corners, component.of_main
    values, at_corners, angles = scan.walls[axis], corners.walls[axis], loop.angles
    count = len(values)
    are_in = _are_in_quadrant(scan.walls, size, axis)
    are_near = are_in | jnp.append(False, are_in[:-1]) | jnp.append(are_in[1:], False)
    next_angle = angles[corners.next_to]
    on_pieces = jnp.where(component.in_main, values, -jnp.inf)
    before, after = jnp.append(-jnp.inf, on_pieces[:-1]), jnp.append(on_pieces[1:], -jnp.inf)
    is_beside = of_main & (at_corners >= values[corners.next_to])
    is_less = jnp.any(
        (corners.next_to[..., None] == jnp.arange(count)) & is_beside[..., None], axis=(0, 1)
    )
    tops = (on_pieces >= before) & (on_pieces >= after) & ~is_less & are_near
    rises = corners.slopes[axis] * jnp.array([[1.0], [-1.0]]) > 0.0
    bulges = is_beside & rises & (corners.theta != next_angle)
    bulges = bulges & (_are_in_quadrant(corners.walls, size, axis) | are_near[corners.next_to])
    best, index, rest = _highest(
        jnp.concatenate(
            [jnp.where(tops, on_pieces, -jnp.inf), jnp.where(bulges, at_corners, -jnp.inf).ravel()]
        )
    )
    exists, is_top = jnp.isfinite(best), index < count

    bulge = jnp.clip(index - count, 0, 2 * SLOTS - 1)
    at = jnp.where(is_top, index, corners.next_to.ravel()[bulge])
    lower, upper = _around(angles, component, at)
    between = jnp.stack([corners.theta.ravel()[bulge], next_angle.ravel()[bulge]])
    lower = jnp.where(is_top, lower, jnp.min(between, axis=0))
    upper = jnp.where(is_top, upper, jnp.max(between, axis=0))
    ends = _wall(loop, jnp.stack([lower, upper]))[axis]
    start = _vertex(jnp.stack([lower, angles[at], upper]), values[at], ends)
    start = jnp.where(is_top, start, 0.5 * (lower + upper))
    places = jnp.stack([start, lower - _SLACK, upper + _SLACK])
    start, *limits = jnp.where(exists, places, places[:, :1])  # all wait for the slowest

    def rise(theta: Array) -> tuple[Array, Array]:
        slopes = partial(_with_slopes, loop)
        (_, slope), (_, bend) = jax.jvp(slopes, (theta,), (jnp.ones_like(theta),))
        return slope[axis], bend[axis]

    theta, is_solved = jax.vmap(partial(_fall, rise))(start, *limits)
    is_solved = exists & is_solved
    walls = _wall(loop, jnp.where(is_solved, theta, angles[at]))
    is_solved = is_solved & (walls[axis] >= best - _TOLERANCE * size[axis])
    is_in = is_solved & _are_in_quadrant(walls, size, axis)
    return _Turns(walls, theta, jnp.where(is_in, walls[axis], -jnp.inf), is_solved, best, rest)


def _around(angles: Array, component: _Component, at: Array) -> tuple[Array, Array]:
    """Return the neighbours of angles of the scan: other ones of it, or corners between."""
    corners = component.corners
    is_near = component.of_main & (corners.next_to == at[:, None, None])
    low = jnp.where(is_near & corners.is_lower, corners.theta, -jnp.inf)
    high = jnp.where(is_near & ~corners.is_lower, corners.theta, jnp.inf)
    lower = jnp.maximum(jnp.max(low, axis=(1, 2)), angles[jnp.maximum(at - 1, 0)])
    upper = jnp.minimum(jnp.min(high, axis=(1, 2)), angles[jnp.minimum(at + 1, len(angles) - 1)])
    return lower, upper


def _highest(scores: Array) -> tuple[Array, Array, Array]:
    """Return the ``candidates`` highest scores, their indices, and the next score.

    ``lax.top_k`` sorts them all, which makes the whole search slower by a tenth.
    """
    candidates = 3  # places where the curve turns that are refined
    chosen = []
    for _ in range(candidates + 1):
        index = jnp.argmax(scores)
        chosen.append((scores[index], index))
        scores = scores.at[index].set(-jnp.inf)
    best, indices = map(jnp.stack, zip(*chosen[:-1], strict=True))
    return best, indices, chosen[-1][0]


class _Corner(NamedTuple):
    """A corner of the component, computed on both pieces that it is on; they may round differently.

    ``index``: of an end of a piece, in the order of ``_Corners``; crossings of the lines follow.
    """

    index: Array
    value: Array
    walls: Array  # (2, piece)
    theta: Array  # (piece,)
    roots: Array  # both angles


def _highest_corner(component: _Component, axis: Array) -> _Corner:
    corners, links, of_main = component.corners, component.links, component.of_main
    crossing = jnp.broadcast_to(links.crossing[:, None], (2, SLOTS))
    every = jnp.concatenate([corners.walls[:, 0], corners.walls[:, 1], crossing], axis=1)
    may = jnp.concatenate([of_main[None], of_main[None], (of_main & links.via)[None]]).ravel()
    values = jnp.where(may & _are_in_quadrant(every, component.size, axis), every[axis], -jnp.inf)
    index = jnp.argmax(values)
    row, own = index // SLOTS, index % SLOTS
    twin = jnp.where(row == 0, corners.preceding[own], corners.following[own])
    branch, theta = corners.branch[jnp.minimum(row, 1), own], corners.theta.ravel()
    is_twice = (row < 2) & (branch == Branch.CURVE)
    twin = jnp.where(is_twice, (1 - row) * SLOTS + twin, index)
    both = jnp.stack([index, twin])
    on_line = jnp.where(branch == Branch.Z_MINUS_ONE, jnp.pi, 0.0)
    other = jnp.where(branch == Branch.CURVE, theta[twin % (2 * SLOTS)], on_line)
    ends = jnp.stack([theta[index % (2 * SLOTS)], other])
    roots = jnp.where(row < 2, ends, jnp.array([0.0, jnp.pi]))
    return _Corner(index, values[index], every[:, both], theta[both % (2 * SLOTS)], roots)


class _AxisCrossing(NamedTuple):
    """The last crossing of a component's boundary with the axis of a gain; -inf if there is none.

    ``rest``: no other crossing, nor this one where it is not solved for, has a larger gain.
    """

    wall: Array
    theta: Array
    is_on_line: Array
    rest: Array


def _on_axis(loop: Triples, scan: _Scan, component: _Component, axis: Array) -> _AxisCrossing:
    """Return where the boundary crosses the axis: by Newton's method, on lines in closed form."""
    corners, of_main = component.corners, component.of_main
    may_be = partial(_are_in_quadrant, size=component.size, axis=axis)
    on_line, line_angle = _line_on_axis(loop, component, axis)
    beside = corners.next_to
    starts = jnp.concatenate([loop.angles[:-1], corners.theta.ravel()])
    stops = jnp.concatenate([loop.angles[1:], loop.angles[beside].ravel()])
    here = jnp.concatenate([scan.walls[:, :-1], corners.walls.reshape(2, -1)], axis=1)
    there = jnp.concatenate([scan.walls[:, 1:], scan.walls[:, beside].reshape(2, -1)], axis=1)
    in_main = component.in_main[:-1] & component.in_main[1:]
    exist = jnp.concatenate([in_main, of_main, of_main])
    crosses = exist & (may_be(here) != may_be(there))
    run = there[1 - axis] - here[1 - axis]
    share = -here[1 - axis] / jnp.where(crosses, run, 1.0)
    gains = jnp.where(crosses, here[axis] + share * (there[axis] - here[axis]), -jnp.inf)
    most = jnp.where(crosses, jnp.maximum(here[axis], there[axis]), -jnp.inf)
    best = jnp.argmax(gains)
    low, high = jnp.minimum(starts, stops)[best], jnp.maximum(starts, stops)[best]
    falls = jnp.sign(run[best]) * jnp.sign(starts[best] - stops[best])

    def height(theta: Array) -> tuple[Array, Array]:
        walls, slopes = _with_slopes(loop, theta)
        return falls * walls[1 - axis], falls * slopes[1 - axis]

    start = starts[best] + share[best] * (stops[best] - starts[best])
    start = jnp.where(crosses[best], start, starts[best])
    theta, is_solved = _fall(height, start, low - _SLACK, high + _SLACK)
    is_solved = crosses[best] & is_solved
    on_curve = jnp.where(is_solved, _wall(loop, theta)[axis], -jnp.inf)
    rest = jnp.max(jnp.where(is_solved & (jnp.arange(len(most)) == best), -jnp.inf, most))
    is_on_line = on_line > on_curve
    gain = jnp.where(is_on_line, on_line, on_curve)
    wall = jnp.where(jnp.arange(2) == axis, gain, 0.0)
    return _AxisCrossing(wall, jnp.where(is_on_line, line_angle, theta), is_on_line, rest)


def _line_on_axis(loop: Triples, component: _Component, axis: Array) -> tuple[Array, Array]:
    """Return the largest gain at which a straight part crosses the axis, and its root's angle."""
    corners, links = component.corners, component.links
    may_be = partial(_are_in_quadrant, size=component.size, axis=axis)
    first, last = corners.walls[:, 0][:, links.successor], corners.walls[:, 1]
    middle = jnp.where(links.via, links.crossing[:, None], first)
    line = jnp.where(corners.branch[1] == Branch.Z_MINUS_ONE, 1, 0)
    on_lines = -loop.ends[:, 0] / loop.ends[:, 1 + axis]
    is_line = component.of_main & (corners.branch[1] != Branch.CURVE)
    meets = is_line & jnp.stack([may_be(last) != may_be(middle), may_be(middle) != may_be(first)])
    lines = jnp.stack([line, 1 - line])
    on_line = jnp.where(meets, on_lines[lines], -jnp.inf).ravel()
    best = jnp.argmax(on_line)
    return on_line[best], jnp.pi * lines.ravel()[best]


def _vertex(angles: Array, middle: Array, beside: Array) -> Array:
    """Return where the parabola through three points has its top."""
    before, after = angles[1] - angles[0], angles[2] - angles[1]
    rise, fall = (middle - beside[0]) / before, (beside[1] - middle) / after
    bend = (fall - rise) / (before + after)
    top = angles[1] - 0.5 * (rise / jnp.where(bend < 0.0, bend, -jnp.inf) + before)
    return jnp.clip(top, angles[0], angles[2])


def _bisector(loop: Triples, corners: _Corners, corner: Array, size: Array) -> Array:
    """Return the direction into the stable set at a corner, in units of the set's size."""
    along = jnp.stack([loop.ends[:, 2], -loop.ends[:, 1]], axis=1)  # of both lines
    slopes, lines = corners.slopes / size[:, None, None], along / size
    slopes = slopes / jnp.linalg.norm(slopes, axis=0)
    lines = lines / jnp.linalg.norm(lines, axis=1)[:, None]
    row, piece = corner // SLOTS, corner % SLOTS
    branch = corners.branch[jnp.minimum(row, 1), piece]
    line = lines[jnp.where(branch == Branch.Z_MINUS_ONE, 1, 0)]
    is_curve = branch == Branch.CURVE
    begins, ends = slopes[:, 0], slopes[:, 1]
    into = jnp.where(is_curve, ends[:, corners.preceding[piece]], line)
    out_of = jnp.where(is_curve, begins[:, corners.following[piece]], line)
    other = lines[jnp.where(branch == Branch.Z_MINUS_ONE, 0, 1)]
    at_begin, at_end, at_crossing = begins[:, piece] - into, out_of - ends[:, piece], other - line
    return jnp.where(row == 0, at_begin, jnp.where(row == 1, at_end, at_crossing))


def _rounding(loop: Triples, theta: Array, wall: Array, axis: Array) -> Array:
    """Bound what rounding moves a wall by, roughly."""
    half = abs(2.0 * jnp.sin(0.5 * theta))
    degree = loop.straight.shape[1] - 1
    powers = half ** jnp.arange(degree, -1, -1)
    sizes = jnp.where(
        half < loop.close, abs(loop.shifted) @ powers, jnp.sum(abs(loop.straight), axis=1)
    )
    values = _values(loop, theta)
    det = abs(cross(values[1], values[2]))
    moduli = jnp.stack([jnp.hypot(*value) for value in values])
    total = sizes[0] + abs(wall[0]) * sizes[1] + abs(wall[1]) * sizes[2]
    return 8.0 * UNIT * total * moduli[2 - axis] / det
