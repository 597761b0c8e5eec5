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
from jax.typing import ArrayLike

from jaxstab.region.curve import (
    SliceCoefficients,
    curve_and_lift,
    curve_point,
    minus_offset,
    minus_slope,
    plus_offset,
    plus_slope,
)

_REAL_MARGIN = 1e-13  # of the polynomial at z = r and -r, beside its coefficients
_MARGIN = 1e-12  # reflection coefficients closer to 1 are taken for roots on the circle
_SLACK = 1e-6  # of angles: with more roots close to the circle, the margin shifts the ends
_NARROWINGS = 9
_NEWTON_STEPS = 16
_STRAY = 16.0  # of a bracket: Newton's method does not come back from there
_NEWTON_TOLERANCE = 1e-10  # of the last step: its square is below rounding
NO_BRANCH = -1


class Branch(IntEnum):
    """Which root lies on the circle along a piece of the boundary."""

    CURVE = 0
    Z_PLUS_ONE = 1
    Z_MINUS_ONE = 2


class Arcs(NamedTuple):
    """Intervals of th that bound the stable set; arrays of one fixed length, padded.

    ``begin`` and ``end`` are angles, ``begin_low`` and ``end_low`` what rounding took from them,
    and ``begin_branch``, ``end_branch`` say what the arc meets there (a Branch). After its end the
    boundary goes on to the arc ``successor``: at once, or along a line, or ``via`` the crossing of
    both lines. ``resolved`` is False where the pieces do not close to loops.
    """

    exists: Array
    begin: Array
    end: Array
    begin_low: Array
    end_low: Array
    begin_branch: Array
    end_branch: Array
    successor: Array
    via: Array
    resolved: Array


def find_arcs(c: SliceCoefficients, angles: Array, *, length: int, slots: int) -> Arcs:
    """Return the arcs of one slice that a scan over these angles finds, ``slots`` at most.

    ``length`` is that of the polynomials with the other roots: floor(delay) + 3, or more.

    Source: the D-decomposition of Gryazina, Polyak, Tremba (2008), with the criterion of Schur and
    Cohn for the other roots. Differentiable in the slice by the theorem of the implicit function.
    """
    known = lax.stop_gradient(c)

    def inside(theta: Array) -> Array:
        return others_inside(known, theta, length)

    padded = jnp.concatenate([jnp.zeros(1), angles, jnp.full(1, jnp.pi)])
    scanned = lax.optimization_barrier(inside(angles))
    passes = jnp.concatenate([jnp.zeros(1, bool), scanned, jnp.zeros(1, bool)])
    begins = first_places(passes[1:-1] & ~passes[:-2], slots)
    ends = first_places(passes[1:-1] & ~passes[2:], slots)
    exists = begins < len(angles)
    # Both ends of all arcs are solved in one batch: first the begins, then the ends.
    outer, inner = _narrowed(
        inside,
        padded[jnp.concatenate([begins, ends + 2])],
        padded[jnp.concatenate([begins, ends]) + 1],
    )
    both = jnp.tile(exists, 2)
    pinned = jnp.concatenate([begins == 0, ends == len(angles) - 1])
    rough = jnp.where(both, 0.5 * (outer + inner), 1.0)
    near = lax.optimization_barrier(jnp.stack(curve_point(known, rough), axis=-1))
    sizes = _sizes(known, near[:, 0], near[:, 1], rough)
    gaps = jnp.sum((near[slots:, None] - near[None, :slots]) ** 2, axis=-1)

    def angles_to_join(open_ends: Array) -> tuple[Array, Array, Array]:
        """Return for these ends their angles and those next to them, and who is next to whom."""
        among = jnp.where(open_ends[slots:, None] & open_ends[None, :slots], gaps, jnp.inf)
        next_arc, previous_arc = jnp.argmin(among, axis=1), jnp.argmin(among, axis=0)
        others = rough[jnp.concatenate([slots + previous_arc, next_arc])]
        return jnp.stack([rough, others]), next_arc, previous_arc

    # An end is where it is nearest to by Newton's method, were it a corner of this kind.
    steps = _newton_steps(known, angles_to_join(both & ~pinned)[0], sizes).steps
    met = jnp.argmin(jnp.nan_to_num(jnp.abs(steps), nan=jnp.inf), axis=0)
    lines = jnp.repeat(jnp.asarray([Branch.Z_PLUS_ONE, Branch.Z_MINUS_ONE]), slots)
    branch = jnp.where(both, jnp.where(pinned, lines, met), NO_BRANCH)
    begin_branch, end_branch = branch[:slots], branch[slots:]
    joins, joined = end_branch == Branch.CURVE, begin_branch == Branch.CURVE
    angles, next_arc, previous_arc = angles_to_join(branch == Branch.CURVE)
    reach = _STRAY * (jnp.abs(outer - inner) + _SLACK)
    unpinned = jnp.where(pinned, NO_BRANCH, branch)
    solved, low, found = _corners(c, unpinned, angles, sizes, reach)
    found = pinned | (found & _between(solved, outer, inner))
    solved, low = jnp.where(found, solved, rough), jnp.where(found & ~pinned, low, 0.0)
    begin = jnp.where(pinned[:slots], 0.0, solved[:slots])
    end = jnp.where(pinned[slots:], jnp.pi, solved[slots:])
    begin, end = jnp.where(exists, begin, 1.0), jnp.where(exists, end, 2.0)
    height = lax.optimization_barrier(curve_point(known, jnp.stack([begin, end]))[1])
    successor, via, linked = _links(known, exists, height, begin_branch, end_branch, next_arc)
    mutual = ~joins | (joined[next_arc] & (previous_arc[next_arc] == jnp.arange(slots)))
    follows = exists[:, None] & (successor[:, None] == jnp.arange(slots))
    finite = jnp.all(jnp.isfinite(height), axis=0)
    closed = finite & mutual & linked & (jnp.sum(follows, axis=0) == 1)
    closed = closed & found[:slots] & found[slots:]
    via = via & exists
    both_lines = _quotient(known, lines_crossing(known), jnp.zeros(()), -1.0, length)
    closed = closed & (~via | _all_inside(both_lines))
    fits = jnp.sum(passes[1:-1] & ~passes[:-2]) <= slots
    return Arcs(
        exists=exists,
        begin=begin,
        end=end,
        begin_low=low[:slots],
        end_low=low[slots:],
        begin_branch=begin_branch,
        end_branch=end_branch,
        successor=successor,
        via=via,
        resolved=fits & jnp.all(~exists | (closed & (begin < end))),
    )


def others_inside(
    c: SliceCoefficients, theta: Array, length: int, within: ArrayLike = 1.0
) -> Array:
    """Return where all roots of p but those at r e^(+-i theta) lie inside of the circle.

    ``within`` is the size of another circle, as a multiple of that.

    Source: the criterion of Schur and Cohn, as a pair of recursions for the polynomial and its
    reverse.
    """
    shrunk = jnp.asarray(within) ** -jnp.arange(length).reshape(-1, *(1 for _ in theta.shape))
    return _all_inside(other_roots(c, theta, length) * shrunk)


def _all_inside(falling: Array) -> Array:
    """Return where all roots of polynomials (coefficient, ...) lie inside of the unit circle."""

    def step(_: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        falling, rising, inside = state
        reflection = rising[0] / falling[0]
        lower = rising - reflection * falling
        return (
            falling - reflection * rising,
            jnp.concatenate([lower[1:], jnp.zeros_like(lower[:1])]),
            inside & (jnp.abs(reflection) < 1.0 - _MARGIN),
        )

    # Where all walls leave a root at z = r or -r, rounding must not decide.
    flipped = falling.at[1::2].multiply(-1.0)
    real = jnp.minimum(jnp.sum(falling, axis=0), jnp.sum(flipped, axis=0))
    start = real > _REAL_MARGIN * jnp.sum(jnp.abs(falling), axis=0)
    state = (falling, falling[::-1], start)
    inside: Array = lax.fori_loop(0, len(falling) - 1, step, state)[2]
    return inside


def other_roots(c: SliceCoefficients, theta: Array, length: int) -> Array:
    """Return the coefficients of p(r zeta) / (zeta^2 - 2 cos(theta) zeta + 1), highest first.

    There are ``length`` of them, the last ones zeros: roots at 0 are inside of any circle.
    """
    return _quotient(c, curve_point(c, theta), 2.0 * jnp.cos(theta), 1.0, length)


def _quotient(
    c: SliceCoefficients, wall: tuple[Array, Array], total: Array, product: float, length: int
) -> Array:
    """Divide p(r zeta) by zeta^2 - total zeta + product, of two roots that the wall has."""
    alpha, beta = wall
    unit = c.gain * c.radius
    gain, lagged = (alpha + beta) / unit, beta / (c.radius * unit)
    leading, middle = 0.5 * (c.sigma + c.nu), c.num_plus - c.sigma
    first, second = (c.den_plus - c.kappa) / c.radius, 0.5 * (c.kappa - c.eps) / c.radius
    third, fourth = leading * gain, middle * gain - leading * lagged  # of powers m and m + 1
    series = _series_of_inverse(total, product, length)
    once, twice = (jnp.pad(series[:-k], [(k, 0)] + [(0, 0)] * total.ndim) for k in (1, 2))
    power = jnp.arange(length).reshape(-1, *(1 for _ in total.shape))
    of_wall = jnp.where(power == c.turns, third, third * total + fourth)
    quotient = series + first * once + second * twice + jnp.where(power < c.turns, 0.0, of_wall)
    return jnp.where(power <= c.turns + 1, quotient, 0.0)


def _series_of_inverse(total: Array, product: float, length: int) -> Array:
    """Return the series of 1 / (1 - total x + product x^2): Chebyshev's polynomials for 1."""

    def step(before: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        last, last_but_one = before
        return (total * last - product * last_but_one, last), last

    start = (jnp.ones_like(total), jnp.zeros_like(total))
    series: Array = lax.scan(step, start, None, length=length)[1]
    return series


def minus_margin(c: SliceCoefficients, alpha: Array, beta: Array) -> Array:
    """Return p(-r) / r^2 up to the sign that it has inside of the stable set, which is plus."""
    return c.gain * c.den_minus + _alternation(c) * c.num_minus * (alpha + minus_slope(c) * beta)


def _alternation(c: SliceCoefficients) -> Array:
    return 1.0 - 2.0 * (c.turns % 2.0)


class _Steps(NamedTuple):
    """Newton's steps of angles to corners of each Branch, and the mismatch there; (branch, end).

    ``partner`` is the step of the second angle, at which the curve meets itself.
    """

    steps: Array
    partner: Array
    mismatch: Array


def _newton_steps(c: SliceCoefficients, angles: Array, sizes: tuple[Array, ...]) -> _Steps:
    """Return the steps from angles (2, end) to corners: the second row is for curve with curve."""
    of_points, of_lift, of_margin = sizes

    def points(angles: Array) -> tuple[Array, Array, Array, Array]:
        alpha, beta, lift = curve_and_lift(c, angles)
        margin = minus_margin(c, alpha[0], beta[0]) / (1.0 + jnp.cos(angles[0]))
        return alpha * of_points, beta * of_points, lift[0] * of_lift, margin * of_margin

    values, slopes = jax.jvp(points, (angles,), (jnp.ones_like(angles),))
    alpha, beta, lift, margin = values
    alpha_slope, beta_slope, lift_slope, margin_slope = lax.stop_gradient(slopes)
    first, second = steps_to_meeting(alpha, beta, alpha_slope, beta_slope)
    gap = jnp.maximum(jnp.abs(alpha[0] - alpha[1]), jnp.abs(beta[0] - beta[1]))
    return _Steps(  # in the order of Branch
        steps=jnp.stack([first, lift / _nonzero(lift_slope), margin / _nonzero(margin_slope)]),
        partner=second,
        mismatch=jnp.stack([gap, jnp.abs(lift), jnp.abs(margin)]),
    )


def steps_to_meeting(
    alpha: Array, beta: Array, alpha_slope: Array, beta_slope: Array
) -> tuple[Array, Array]:
    """Return Newton's steps, to be taken off two angles, to where the curve meets itself.

    The first row of each argument is of the first angle, the second row of the second angle.
    """
    across, along = alpha[0] - alpha[1], beta[0] - beta[1]
    determinant = _nonzero(beta_slope[0] * alpha_slope[1] - alpha_slope[0] * beta_slope[1])
    first = (alpha_slope[1] * along - beta_slope[1] * across) / determinant
    second = (alpha_slope[0] * along - beta_slope[0] * across) / determinant
    return first, second


def _corners(
    c: SliceCoefficients, branch: Array, angles: Array, sizes: tuple[Array, ...], reach: Array
) -> tuple[Array, Array, Array]:
    """Return the angles near ``angles[0]`` where the curve meets a branch, and which were found.

    Between the two, what rounding took from the angles. The curve meets itself at angles near
    ``angles[1]``. A search that strays farther than ``reach`` ends: all lanes wait for the last
    one. Differentiable in the slice.
    """

    def newton(slice_: SliceCoefficients, angles: Array) -> tuple[Array, Array]:
        """Return the steps of pairs of angles to a corner, and how far they are from it."""
        steps, partner, mismatch = _newton_steps(slice_, angles, sizes)
        of_branch = branch == jnp.arange(len(Branch))[:, None]
        step, gap = (jnp.sum(jnp.where(of_branch, x, 0.0), axis=0) for x in (steps, mismatch))
        partner = jnp.where(branch == Branch.CURVE, partner, 0.0)
        return jnp.stack([step, partner]), gap

    def moved(angles: Array, start: Array) -> Array:
        near = jnp.abs(angles[0] - start) <= reach
        return angles - jnp.where(near, newton(known, angles)[0], 0.0)

    known = lax.stop_gradient(c)
    solver: optx.FixedPointIteration[Array, Array] = optx.FixedPointIteration(
        rtol=_NEWTON_TOLERANCE, atol=_NEWTON_TOLERANCE
    )
    angles = optx.fixed_point(
        moved, solver, angles, args=angles[0], max_steps=_NEWTON_STEPS, throw=False
    ).value
    # One more step has the derivative of the angle by the theorem of the implicit function.
    angles = lax.stop_gradient(angles)
    steps, mismatch = newton(c, angles)
    solved = angles - steps
    low = lax.stop_gradient((angles - lax.optimization_barrier(solved)) - steps)
    # The solver's own verdict asks for more than rounding leaves where the curve hardly moves.
    return solved[0], low[0], mismatch < _NEWTON_TOLERANCE


def _sizes(c: SliceCoefficients, alpha: Array, beta: Array, theta: Array) -> tuple[Array, ...]:
    """Return factors that bring the three kinds of mismatch to the order of 1."""
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
    height: Array,
    begin_branch: Array,
    end_branch: Array,
    next_arc: Array,
) -> tuple[Array, Array, Array]:
    """Return for each arc the next one, whether the way is via both lines, and whether it exists.

    ``height`` is the beta of the begins and of the ends. With the stable set on the left, beta
    falls along z = r where N(r) > 0, and likewise z = -r.
    """
    exits, entries = height
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


def _between(x: Array, one: Array, two: Array) -> Array:
    slack = 2.0 * jnp.abs(one - two) + _SLACK
    return (x >= jnp.minimum(one, two) - slack) & (x <= jnp.maximum(one, two) + slack)


def first_places(mask: Array, count: int) -> Array:
    """Return the indices of the first ``count`` true entries, then the length of the mask."""
    return jnp.sum(jnp.cumsum(mask) <= jnp.arange(count)[:, None], axis=1)


def _nonzero(x: Array) -> Array:
    return jnp.where(x == 0.0, jnp.inf, x)
