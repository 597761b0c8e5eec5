"""The pieces of the closed-form boundary that bound the stable set, and how they join.

A point of the curve bounds the stable set exactly where the other roots of p, all but the pair at
r e^(+-i th), lie inside of the circle: p divided by that pair is put to the Schur-Cohn test. So the
search is one-dimensional: an *arc* is an interval of th that passes it. The stable set lies to the
left of an arc in the direction of growing th, because z -> (alpha, beta) preserves orientation. An
arc ends where another root reaches the circle: a real one (a corner with one of the two lines) or a
pair (a corner with another arc, which begins there). The stable set is bounded and two lines bound
nothing, so each loop of its boundary holds an arc: what a scan of th can miss are loops of which
every arc is shorter than a step of the scan.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jax import Array, lax

from jaxstab.boundary.curve import (
    SliceCoefficients,
    curve_and_lift,
    curve_point,
    minus_offset,
    minus_slope,
    plus_offset,
    plus_slope,
)

# Reflection coefficients closer to 1 are taken for roots on the circle. Close to th = pi a root at
# z = -r is known worse: the division of p by the pair beside it costs digits.
_MARGIN = 1e-12
_MARGIN_AT_MINUS_ONE = 4e-14  # over 1 + cos(th)
_PROBE = 1e-7  # beyond the end of an arc, to see what it has crossed
_SLACK = 1e-9
_NARROWINGS = 9
_NEWTON_STEPS = 16
_NEWTON_TOLERANCE = 1e-10  # of the last step: its square is below rounding
NO_BRANCH = -1


class Branch(IntEnum):
    """Which root lies on the circle along a piece of the boundary."""

    CURVE = 0
    Z_PLUS_ONE = 1
    Z_MINUS_ONE = 2


class Arcs(NamedTuple):
    """Intervals of th that bound the stable set; arrays of one fixed length, padded.

    ``begin`` and ``end`` are angles and ``begin_branch``, ``end_branch`` say what the arc meets
    there (a Branch). After its end the boundary goes on to the arc ``successor``: at once, or along
    a line, or ``via`` the crossing of both lines. ``resolved`` is False where the pieces do not
    close to loops.
    """

    exists: Array
    begin: Array
    end: Array
    begin_branch: Array
    end_branch: Array
    successor: Array
    via: Array
    resolved: Array


def find_arcs(c: SliceCoefficients, angles: Array, *, whole_delay: int, slots: int) -> Arcs:
    """Return the arcs of one slice that a scan over these angles finds, ``slots`` at most.

    Source: the D-decomposition of Gryazina, Polyak, Tremba (2008), with the criterion of Schur and
    Cohn for the other roots. Differentiable in the slice by the theorem of the implicit function.
    """
    known = lax.stop_gradient(c)

    def inside(theta: Array) -> Array:
        return others_inside(known, theta, whole_delay)

    padded = jnp.concatenate([jnp.zeros(1), angles, jnp.full(1, jnp.pi)])
    scanned = lax.optimization_barrier(inside(angles))
    passes = jnp.concatenate([jnp.zeros(1, bool), scanned, jnp.zeros(1, bool)])
    begins = _places(passes[1:-1] & ~passes[:-2], slots)
    ends = _places(passes[1:-1] & ~passes[2:], slots)
    exists = begins >= 0
    # Both ends of all arcs are solved in one batch: first the begins, then the ends.
    outer, inner = _narrowed(
        inside,
        padded[jnp.concatenate([begins, ends + 2])],
        padded[jnp.concatenate([begins, ends]) + 1],
    )
    beyond = outer - inner
    beyond = jnp.sign(beyond) * jnp.maximum(jnp.abs(beyond), _PROBE)
    met = branch_met(known, jnp.clip(outer + beyond, 0.0, jnp.pi))
    at_start, at_stop = begins == 0, ends == len(angles) - 1
    pinned = jnp.concatenate([at_start, at_stop])
    begin_branch = jnp.where(at_start, Branch.Z_PLUS_ONE, met[:slots])
    end_branch = jnp.where(at_stop, Branch.Z_MINUS_ONE, met[slots:])
    begin_branch = jnp.where(exists, begin_branch, NO_BRANCH)
    end_branch = jnp.where(exists, end_branch, NO_BRANCH)

    rough = jnp.where(jnp.tile(exists, 2), 0.5 * (outer + inner), 1.0)
    first, last = rough[:slots], rough[slots:]
    joins, joined = end_branch == Branch.CURVE, begin_branch == Branch.CURVE
    gaps = jnp.where(
        joins[:, None] & joined[None, :], _squared_distances(known, last, first), jnp.inf
    )
    next_arc, previous_arc = jnp.argmin(gaps, axis=1), jnp.argmin(gaps, axis=0)
    solved, found = jax.vmap(_corner, in_axes=(None, 0, 0, 0))(
        c,
        jnp.where(pinned, NO_BRANCH, jnp.concatenate([begin_branch, end_branch])),
        rough,
        jnp.concatenate([last[previous_arc], first[next_arc]]),
    )
    found = pinned | (found & _between(solved, outer, inner))
    begin = jnp.where(at_start, 0.0, solved[:slots])
    end = jnp.where(at_stop, jnp.pi, solved[slots:])
    begin, end = jnp.where(exists, begin, 1.0), jnp.where(exists, end, 2.0)
    successor, via, linked = _links(known, exists, begin, end, begin_branch, end_branch, next_arc)
    mutual = ~joins | (joined[next_arc] & (previous_arc[next_arc] == jnp.arange(slots)))
    follows = exists[:, None] & (successor[:, None] == jnp.arange(slots))
    closed = found[:slots] & found[slots:] & mutual & linked & (jnp.sum(follows, axis=0) == 1)
    fits = jnp.sum(passes[1:-1] & ~passes[:-2]) <= slots
    return Arcs(
        exists=exists,
        begin=begin,
        end=end,
        begin_branch=begin_branch,
        end_branch=end_branch,
        successor=successor,
        via=via & exists,
        resolved=fits & jnp.all(~exists | (closed & (begin < end))),
    )


def others_inside(c: SliceCoefficients, theta: Array, whole_delay: int) -> Array:
    """Return where all roots of p but those at r e^(+-i theta) lie inside of the circle.

    Source: the Schur-Cohn criterion, as a pair of recursions for the polynomial and its reverse.
    """
    falling = other_roots(c, theta, whole_delay)
    rising = falling[::-1]
    limit = 1.0 - _MARGIN - _MARGIN_AT_MINUS_ONE / (1.0 + jnp.cos(theta))

    def step(_: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        falling, rising, inside = state
        reflection = rising[0] / falling[0]
        lower = rising - reflection * falling
        return (
            falling - reflection * rising,
            jnp.concatenate([lower[1:], jnp.zeros_like(lower[:1])]),
            inside & (jnp.abs(reflection) < limit),
        )

    state = (falling, rising, jnp.full(theta.shape, True))
    inside: Array = lax.fori_loop(0, len(falling) - 1, step, state)[2]
    return inside


def other_roots(c: SliceCoefficients, theta: Array, whole_delay: int) -> Array:
    """Return the coefficients of p(r zeta) / (zeta^2 - 2 cos(theta) zeta + 1), highest first."""
    alpha, beta = curve_point(c, theta)
    unit = c.gain * c.radius
    gain, lagged = (alpha + beta) / unit, beta / (c.radius * unit)
    leading, middle = 0.5 * (c.sigma + c.nu), c.num_plus - c.sigma
    p = jnp.zeros((whole_delay + 3, *theta.shape))  # the rest of the division is not asked for
    p = p.at[0].set(1.0)
    p = p.at[1].set((c.den_plus - c.kappa) / c.radius)
    p = p.at[2].set(0.5 * (c.kappa - c.eps) / c.radius)
    p = p.at[whole_delay + 1].add(leading * gain)
    p = p.at[whole_delay + 2].add(middle * gain - leading * lagged)
    twice = 2.0 * jnp.cos(theta)

    def divided(before: tuple[Array, Array], power: Array) -> tuple[tuple[Array, Array], Array]:
        following = power + twice * before[0] - before[1]
        return (following, before[0]), following

    zero = jnp.zeros_like(theta)
    quotient: Array = lax.scan(divided, (zero, zero), p)[1]
    return quotient


def branch_met(c: SliceCoefficients, theta: Array) -> Array:
    """Return what the curve has just crossed: the line whose real root is outside, else itself."""
    alpha, beta, lift = curve_and_lift(c, theta)
    met_minus = jnp.where(minus_margin(c, alpha, beta) <= 0.0, Branch.Z_MINUS_ONE, Branch.CURVE)
    return jnp.where(c.num_plus * lift <= 0.0, Branch.Z_PLUS_ONE, met_minus)


def minus_margin(c: SliceCoefficients, alpha: Array, beta: Array) -> Array:
    """Return p(-r) / r^2 up to the sign that it has inside of the stable set, which is plus."""
    return c.gain * c.den_minus + _alternation(c) * c.num_minus * (alpha + minus_slope(c) * beta)


def _alternation(c: SliceCoefficients) -> Array:
    return 1.0 - 2.0 * (c.turns % 2.0)


def _corner(c: SliceCoefficients, branch: Array, theta: Array, other: Array) -> tuple[Array, Array]:
    """Return the angle near ``theta`` where the curve meets a branch, and whether it was found.

    The curve meets itself at an angle near ``other``. Differentiable in the slice.
    """
    known = lax.stop_gradient(c)
    sizes = _sizes(known, theta)

    def mismatch(angles: Array, slice_: SliceCoefficients) -> Array:
        alpha, beta, lift = curve_and_lift(slice_, angles)
        margin = minus_margin(slice_, alpha[0], beta[0]) / (1.0 + jnp.cos(angles[0]))
        on_line = jnp.where(branch == Branch.Z_PLUS_ONE, lift[0] * sizes[1], margin * sizes[2])
        meets_itself = branch == Branch.CURVE
        first = jnp.where(meets_itself, (alpha[0] - alpha[1]) * sizes[0], on_line)
        second = jnp.where(meets_itself, (beta[0] - beta[1]) * sizes[0], angles[1] - other)
        return jnp.stack([jnp.where(branch == NO_BRANCH, angles[0] - theta, first), second])

    newton: optx.Newton[Array, Array, None] = optx.Newton(
        rtol=_NEWTON_TOLERANCE, atol=_NEWTON_TOLERANCE
    )
    start = jnp.stack([theta, other])
    angles: Array = lax.stop_gradient(
        optx.root_find(
            mismatch, newton, start, args=known, max_steps=_NEWTON_STEPS, throw=False
        ).value
    )
    value, jacobian = mismatch(angles, c), jax.jacfwd(mismatch)(angles, known)
    # Zero, with the derivative of the angle by the theorem of the implicit function.
    change = value - lax.stop_gradient(value)
    determinant = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    regular = jnp.isfinite(determinant) & (determinant != 0.0)
    step = (jacobian[1, 1] * change[0] - jacobian[0, 1] * change[1]) / determinant
    angle = jnp.where(regular, angles[0] - step, angles[0])
    # Newton's own verdict asks for more than rounding leaves where the curve hardly moves with th.
    return angle, jnp.all(jnp.abs(value) < _NEWTON_TOLERANCE)


def _sizes(c: SliceCoefficients, theta: Array) -> tuple[Array, Array, Array]:
    """Return factors that bring the three kinds of mismatch to the order of 1."""
    alpha, beta = curve_point(c, theta)
    size = jnp.abs(alpha) + jnp.abs(beta) + jnp.abs(plus_offset(c))
    margin = jnp.abs(c.gain * c.den_minus) + jnp.abs(c.num_minus) * size
    return 1.0 / size, (1.0 - jnp.cos(theta)) / size, (1.0 + jnp.cos(theta)) / margin


def _narrowed(inside: Callable[[Array], Array], outer: Array, inner: Array) -> tuple[Array, Array]:
    """Bisect from angles that fail the test and angles that pass it."""

    def halved(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        outer, inner = ends
        middle = 0.5 * (outer + inner)
        passes = inside(middle)
        return jnp.where(passes, outer, middle), jnp.where(passes, middle, inner)

    start = lax.optimization_barrier((outer, inner))
    ends: tuple[Array, Array] = lax.fori_loop(0, _NARROWINGS, halved, start)
    return ends


def _links(
    c: SliceCoefficients,
    exists: Array,
    begin: Array,
    end: Array,
    begin_branch: Array,
    end_branch: Array,
    next_arc: Array,
) -> tuple[Array, Array, Array]:
    """Return for each arc the next one, whether the way is via both lines, and whether it exists.

    With the stable set on the left, beta falls along z = r where N(r) > 0, and likewise z = -r.
    """
    entries, exits = curve_point(c, end)[1], curve_point(c, begin)[1]
    plus_way = -jnp.sign(c.num_plus)
    minus_way = -jnp.sign(_alternation(c) * c.num_minus)
    crossing = lines_crossing(c)[1]
    from_plus = end_branch == Branch.Z_PLUS_ONE
    way = jnp.where(from_plus, plus_way, minus_way)
    other_way = jnp.where(from_plus, minus_way, plus_way)
    # Along this line the boundary may run into the other one, and not come from there.
    runs_in = (plus_way * minus_way > 0.0) == from_plus
    leaves = jnp.where(from_plus, Branch.Z_MINUS_ONE, Branch.Z_PLUS_ONE)
    ahead = way[:, None] * (exits[None, :] - entries[:, None])
    here = exists & (begin_branch == end_branch[:, None]) & (ahead > 0.0)
    around = other_way[:, None] * (exits[None, :] - crossing)
    there = exists & (begin_branch == leaves[:, None]) & (around > 0.0) & runs_in[:, None]
    straight = jnp.any(here, axis=1)
    along_lines = jnp.argmin(
        jnp.where(
            straight[:, None], jnp.where(here, ahead, jnp.inf), jnp.where(there, around, jnp.inf)
        ),
        1,
    )
    crosses = end_branch == Branch.CURVE
    linked = crosses | straight | jnp.any(there, axis=1)
    return jnp.where(crosses, next_arc, along_lines), ~crosses & ~straight, linked


def lines_crossing(c: SliceCoefficients) -> tuple[Array, Array]:
    """Return (alpha, beta) where the lines of a real root at r and at -r cross."""
    beta = (minus_offset(c) - plus_offset(c)) * c.radius / 2.0
    return plus_offset(c) - plus_slope(c) * beta, beta


def _squared_distances(c: SliceCoefficients, theta: Array, other: Array) -> Array:
    one, two = (jnp.stack(curve_point(c, angles), axis=-1) for angles in (theta, other))
    return jnp.sum((one[:, None] - two[None, :]) ** 2, axis=-1)


def _between(x: Array, one: Array, two: Array) -> Array:
    slack = 2.0 * jnp.abs(one - two) + _SLACK
    return (x >= jnp.minimum(one, two) - slack) & (x <= jnp.maximum(one, two) + slack)


def _places(mask: Array, slots: int) -> Array:
    """Return the indices of the first ``slots`` true entries, then -1."""
    return jnp.nonzero(mask, size=slots, fill_value=-1)[0]
