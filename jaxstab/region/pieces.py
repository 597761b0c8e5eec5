"""The pieces of the boundary curve that bound the stable set, and how they join.

A point of the curve bounds the stable set exactly where the other roots of p lie inside of the
circle. So the search is one-dimensional: a *piece* is an interval of th that
passes that test. The stable set lies to the left of a piece in the direction of growing th, because
z -> (alpha, beta) preserves orientation. A piece ends where another root reaches the circle: a real
one (a corner with one of the two lines) or a pair (a corner with another piece, which begins
there). The stable set is bounded and two lines bound nothing, so each component has a piece (lemma
G1): a scan of th can miss components none of whose pieces it meets (docs/proofs.md, G3).

``find_pieces`` tests the angles of a scan, by the Schur-Cohn recursion of p without its pair
(``others_inside``), narrows each change of the answer to a short interval, and solves for the
corner in it by Newton's method. A piece that ends on the curve goes on at the begin of the piece
that is nearest; one that ends on a line goes along it, to the next begin on it or via the crossing
of both lines (``_linked``). If every piece follows exactly one, the boundary is closed: it is
``resolved``. NumPy only.
"""

from collections.abc import Callable
from enum import IntEnum
from functools import cache, partial, reduce
from math import comb
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array
from jaxstab.model import companion_matrix
from jaxstab.model.double_double import DoubleDouble
from jaxstab.region.curve import Angles, Curve, PoleLine, out_of_rounding, to_rescaled
from jaxstab.region.exact import all_inside, angles_on_circle, lines_crossing_of
from jaxstab.region.points import (
    curve_and_lift,
    curve_gains,
    exact_walls,
    is_oriented,
    root_angles,
)
from jaxstab.region.roots import nonzero, with_slope
from jaxstab.rounding import UNIT

# Corners of the boundary, where the curve meets a line or itself, by Newton's method.
#
# A piece ends where the curve meets the line z = r (the lift is 0), the line z = -r (the margin is
# 0) or itself (two angles have one point). Newton's steps of all three kinds follow from the values
# and slopes of the curve at one or two angles; the nearest corner tells which kind it is
# (``nearest_branch``), and its steps are then repeated, all lanes at once, until they are below
# rounding (``solved_corners``). What rounding takes from an angle is returned beside it: next to pi
# it holds digits of the corner.

_STEPS = 16
_SMALLEST = 0.1  # of the largest corner: the size of those at 0
_ROUGH = 1e-8  # the same mismatch next to a zero of N, where float64 coefficients resolve less
_TOLERANCE = 1e-10  # of the last step: its square is below rounding
_PARALLEL = 1e-12  # the sine of the angle between two tangents that are
_ROUNDING = 4.0 * UNIT  # of angles


class Branch(IntEnum):
    """Which root lies on the circle along a piece of the boundary.

    Example:
        >>> [branch.name for branch in jaxstab.results.Branch]
        ['CURVE', 'Z_PLUS_ONE', 'Z_MINUS_ONE']
    """

    CURVE = 0
    Z_PLUS_ONE = 1
    Z_MINUS_ONE = 2


class Scales(NamedTuple):
    """Factors that bring the mismatches of points, lifts and margins to the order of 1."""

    points: Array
    lift: Array
    margin: Array


class _Steps(NamedTuple):
    """Newton's steps of angles to corners, and the mismatches there, one array for each Branch.

    ``partner`` is the step of the second angle, at which the curve meets itself.
    """

    steps: tuple[Array, ...]
    partner: Array
    mismatches: tuple[Array, ...]


def scales(c: Curve, alpha: Array, beta: Array, theta: Array) -> Scales:
    """Return the scales of the mismatches at points of the curve."""
    cosine = np.cos(theta)
    size = abs(alpha) + abs(beta) + abs(c.plus_offset)
    # Undamped modes put corners at 0.
    size = size + _SMALLEST * np.max(size, initial=0.0, where=np.isfinite(size))
    base, stiffness, damping = map(abs, c.at_minus_one)
    margin = base + (stiffness + damping) * size
    return Scales(1.0 / size, (1.0 - cosine) / size, (1.0 + cosine) / margin)


def nearest_branch(c: Curve, angles: Array, scale: Scales) -> Array:
    """Return for ends at angles[0] which Branch the curve meets there, next to angles[1] or not.

    For each kind of corner Newton's method says how far off it is; the nearest one is taken.
    """
    steps = np.stack(_newton_steps(c, angles, scale).steps)
    return np.argmin(np.nan_to_num(abs(steps), nan=np.inf), axis=0)


def solved_corners(
    c: Curve, branch: Array, angles: Array, scale: Scales, half_width: Array
) -> tuple[Array, Array, Array]:
    """Return the angles near ``angles[0]`` where the curve meets a branch, and which are solved.

    The second of the three results is what rounding took from the angles. Where the curve meets
    itself, ``angles[1]`` is near the other angle. A search that strays farther than ``half_width``
    is given up, because all searches wait for the slowest.
    """
    is_of = [branch == each for each in Branch]

    def newton(angles: Array) -> tuple[Array, Array]:
        """Return the steps of pairs of angles to a corner, and how far they are from it."""
        every = _newton_steps(c, angles, scale)
        partner: Array = np.where(is_of[0], every.partner, 0.0)
        step = gap = np.zeros_like(partner)
        for is_it, its_step, its_gap in zip(is_of, every.steps, every.mismatches, strict=True):
            step, gap = np.where(is_it, its_step, step), np.where(is_it, its_gap, gap)
        return np.stack([step, partner]), gap

    here = angles
    for _ in range(_STEPS):
        last = here
        steps, mismatch = newton(last)
        taken = np.where(abs(last[0] - angles[0]) <= half_width, steps, 0.0)
        here = last - taken
        if not np.any(abs(taken) > _TOLERANCE * (1.0 + abs(last))):
            break
    if np.all(mismatch < _TOLERANCE):
        here = last  # the last step has all that one more would tell
    else:
        steps, mismatch = newton(here)
    solved = here - steps
    low = (here - solved) - steps
    # Where the curve flies from one point to another, angles round to points that are apart.
    is_last = np.max(np.abs(steps) - _ROUNDING * (1.0 + np.abs(here)), axis=0) < 0.0
    tolerance = _ROUGH if c.is_exact else _TOLERANCE
    return solved[0], low[0], (mismatch < tolerance) | is_last


def steps_to_meeting(
    alpha: Array, beta: Array, alpha_slope: Array, beta_slope: Array
) -> tuple[Array, Array]:
    """Return Newton's steps, to be taken off two angles, to where the curve meets itself.

    The first row of each argument is of the first angle, the second row of the second angle.
    """
    across, along = alpha[0] - alpha[1], beta[0] - beta[1]
    determinant = beta_slope[0] * alpha_slope[1] - alpha_slope[0] * beta_slope[1]
    determinant = nonzero(determinant, np.inf)
    step = (alpha_slope[1] * along - beta_slope[1] * across) / determinant
    other = (alpha_slope[0] * along - beta_slope[0] * across) / determinant
    return step, other


def _newton_steps(c: Curve, angles: Array, scale: Scales) -> _Steps:
    """Return the steps from angles (2, end) to corners: the second row is for curve with curve."""

    def values(angles: Array) -> tuple[Array, ...]:
        alpha, beta, lift = curve_and_lift(c, angles)
        margin = c.minus_margin(alpha[0], beta[0]) / (1.0 + np.cos(angles[0]))
        return (
            alpha * scale.points,
            beta * scale.points,
            lift[0] * scale.lift,
            margin * scale.margin,
        )

    (alpha, beta, lift, margin), slopes = with_slope(values, angles)
    alpha_slope, beta_slope, lift_slope, margin_slope = slopes
    step, partner = steps_to_meeting(alpha, beta, alpha_slope, beta_slope)
    gap = np.maximum(abs(alpha[0] - alpha[1]), abs(beta[0] - beta[1]))
    if c.lines:  # straight: a line never meets itself
        lengths = np.hypot(alpha_slope, beta_slope)
        turn = beta_slope[0] * alpha_slope[1] - alpha_slope[0] * beta_slope[1]
        step = np.where(abs(turn) < _PARALLEL * lengths[0] * lengths[1], np.inf, step)
    return _Steps(  # in the order of Branch
        steps=(step, lift / nonzero(lift_slope, np.inf), margin / nonzero(margin_slope, np.inf)),
        partner=partner,
        mismatches=(gap, abs(lift), abs(margin)),
    )


# Whether the other roots of p lie inside the circle, where a pair of roots is known.
#
# A point of the curve bounds the stable set exactly where all roots but the pair at r e^(+-i th)
# lie inside of the circle: p is divided by that pair, and the Schur-Cohn test decides.

_REAL_MARGIN = 1e-13  # of the polynomial at z = r and -r, beside its coefficients
MARGIN = 1e-12  # reflection coefficients closer to 1 are taken for roots on the circle
_AT_ONCE = 1 << 18  # coefficients of polynomials that are held in memory
_ROUND = 32  # steps of the test after which the polynomials that failed are dropped


def others_inside(c: Curve, theta: Array, within: float = 1.0) -> Array:
    """Return where all roots of p but those at r e^(+-i theta) lie inside of the circle.

    ``within`` is the size of another circle, as a multiple of that.

    Source: the criterion of Schur and Cohn, as a recursion for the polynomial and its reverse.
    """
    if c.is_exact:
        return all_inside(c, *exact_walls(c, theta), within)
    if theta.size * c.length > _AT_ONCE and theta.size > 1:
        chunks = np.array_split(theta.ravel(), -(-theta.size * c.length // _AT_ONCE))
        each = [others_inside(c, chunk, within) for chunk in chunks]
        return np.concatenate(each).reshape(theta.shape)
    alpha, beta, lift = curve_and_lift(c, theta)
    falling = c.polynomial(alpha, beta)
    inside = _may_be_stable(falling, within)
    if within == 1.0:  # so close to r and -r the recursion does not see a root cross the circle
        inside &= (lift * c.num_plus > 0.0) & (c.minus_margin(alpha, beta) > 0.0)
    inside[inside] = _all_inside(_shrunk(_others(c, falling[:, inside], theta[inside]), within))
    return inside


def _others(c: Curve, falling: Array, theta: Array) -> Array:
    """Divide polynomials by the pairs at r e^(+-i theta), roots of them."""
    return _quotient(falling, 2.0 * np.cos(root_angles(c.lines, theta)), 1.0)


def _quotient(falling: Array, total: Array, product: float) -> Array:
    """Divide polynomials by z^2 - total z + product, two roots of each; both highest power first.

    The last two coefficients of a polynomial do not count, and are not given.
    """
    quotient = np.empty_like(falling)
    before = last = np.zeros_like(falling[0])
    for power, coefficient in enumerate(falling):
        before, last = last, coefficient + total * last - product * before
        quotient[power] = last
    return quotient


def _may_be_stable(falling: Array, within: float) -> Bool[np.ndarray, "*walls"]:
    """Return False where not all roots of p are inside of a circle, by the coefficients alone.

    They are at most those of (z + within)^n then.
    """
    length = len(falling)
    largest = _binomials(length + 1)[:length] * within ** np.arange(float(length))
    largest = largest.reshape(-1, *(1 for _ in falling.shape[1:]))
    fits: np.ndarray = np.all(np.abs(falling) <= largest, axis=0)
    return fits


@cache
def _binomials(degree: int) -> Float64[np.ndarray, " coefficient"]:
    return np.array([comb(degree, k) for k in range(degree + 1)], float)


def _shrunk(falling: Array, within: float) -> Array:
    """Return the polynomials whose roots are divided by a number."""
    powers = np.arange(float(len(falling)))
    return falling * (within**-powers).reshape(-1, *(1 for _ in falling.shape[1:]))


def lines_crossing_is_stable(c: Curve) -> Array:
    """Return whether all roots lie inside where the lines z = r and z = -r cross, but for those."""
    if c.is_exact:
        return all_inside(c, *lines_crossing_of(c.pairs), 1.0)
    falling = c.polynomial(*c.lines_crossing)
    return _all_inside(_quotient(falling, np.zeros(()), -1.0))


def _all_inside(falling: Array) -> Array:
    """Return where all roots of polynomials (coefficient, ...) lie inside of the unit circle.

    The recursion runs on fewer and fewer polynomials, which are shorter and shorter.
    """
    # Where all walls leave a root at z = r or -r, rounding must not decide.
    even, odd = np.sum(falling[::2], axis=0), np.sum(falling[1::2], axis=0)
    real = np.minimum(even + odd, even - odd)
    is_clear = real > _REAL_MARGIN * np.sum(abs(falling), axis=0)
    passes = is_clear.ravel()
    falling, index = falling.reshape(len(falling), -1), np.arange(passes.size)
    while len(falling) > 1 and index.size:
        open_ones = passes[index]
        falling, index = falling[:, open_ones], index[open_ones]
        inside = np.ones(index.size, bool)
        for _ in range(min(_ROUND, len(falling) - 1)):
            reflection = falling[-1] / falling[0]
            inside &= abs(reflection) < 1.0 - MARGIN
            falling = falling[:-1] - reflection * falling[:0:-1]
        passes[index] = inside
    return passes.reshape(is_clear.shape)


_SLACK = 1e-6  # of angles: with more roots close to the circle, the margin shifts the ends
_NARROWING, _EXACT_NARROWING = (2, 23, _SLACK), (16, 8, 1e-14)  # rounds, parts, width enough
_STRAY = 16.0  # brackets: an iterate of Newton's method this far outside is given up
NO_BRANCH = -1
_BLURRED = 1e-8  # of angles: so close to a corner rounding decides the test of the other roots


class Pieces(NamedTuple):
    """Intervals of th that bound the stable set; arrays of one length.

    ``begin`` and ``end`` are angles, ``begin_low`` and ``end_low`` what rounding took from them,
    and ``begin_branch``, ``end_branch`` say what the piece meets there (a Branch). After its end
    the boundary goes on to the piece ``successor``: at once, or along a line, or ``via`` the
    crossing of both lines. ``resolved`` is False where the pieces do not join up to loops.
    """

    begin: Array
    end: Array
    begin_low: Array
    end_low: Array
    begin_branch: Array
    end_branch: Array
    successor: Array
    via: Array
    resolved: Array


class _Ends(NamedTuple):
    """The ends of all pieces, first the begins, then the ends.

    ``pinned`` ones are at a ``limit`` of the angles: 0 or +-pi, on a ``line``, or a knot, where a
    line at a pole meets the curve and the next piece begins. ``outer`` and
    ``inner`` fail and pass the test of the other roots; ``rough`` lies between them and ``points``
    (2, end) are the curve's there.
    """

    pinned: Array
    limit: Array
    line: Array
    outer: Array
    inner: Array
    rough: Array
    points: Array
    scale: Scales


class _Links(NamedTuple):
    """What follows each piece, whether via the crossing of both lines, and whether it exists."""

    successor: Array
    via: Array
    exists: Array


def find_pieces(c: Curve, angles: Array) -> Pieces:
    """Return the pieces of a curve that a scan over these angles, in (0, pi) in order, finds.

    Source: the D-decomposition of Gryazina, Polyak, Tremba (2008), with the criterion of Schur and
    Cohn for the other roots.
    """
    ends = _piece_ends(c, angles)
    if ends is None:
        return _NO_PIECES
    to_join, _, _ = _joined(ends, ~ends.pinned)
    met = nearest_branch(c, to_join, ends.scale)
    branch: Array = np.where(ends.pinned, ends.line, met)
    to_join, following, preceding = _joined(ends, branch == Branch.CURVE)
    if c.lines:
        following, preceding = _across_knots(ends, following, preceding)
    theta, low, is_solved = _solved(c, ends, branch, to_join)

    (begin, end), (begin_branch, end_branch) = theta, branch.reshape(2, -1)
    walls = curve_gains(c, theta)
    links = _linked(c, walls, begin_branch, end_branch, following)
    index = np.arange(len(begin))
    is_mutual = (begin_branch[following] == Branch.CURVE) & (preceding[following] == index)
    may_turn = np.any(links.via) and lines_crossing_is_stable(c)
    follows = links.successor[:, None] == index
    is_closed = (
        np.all(np.isfinite(walls[1]), axis=0)
        & ((end_branch != Branch.CURVE) | is_mutual)
        & links.exists
        & (np.sum(follows, axis=0) == 1)
        & np.all(is_solved, axis=0)
        & (~links.via | may_turn)
        & (begin < end)
    )
    return Pieces(
        begin=begin,
        end=end,
        begin_low=low[0],
        end_low=low[1],
        begin_branch=begin_branch,
        end_branch=end_branch,
        successor=links.successor,
        via=links.via,
        resolved=np.all(is_closed),
    )


_NONE, _NO_INDEX = np.empty(0), np.empty(0, int)
_NO_PIECES = Pieces(
    begin=_NONE,
    end=_NONE,
    begin_low=_NONE,
    end_low=_NONE,
    begin_branch=_NO_INDEX,
    end_branch=_NO_INDEX,
    successor=_NO_INDEX,
    via=np.empty(0, bool),
    resolved=np.bool_(True),
)


# ---------------------------------------------------------------------------- where pieces end
def _piece_ends(c: Curve, angles: Array) -> _Ends | None:
    """Return the ends of the pieces between two angles each; None where there are no pieces."""
    inside = partial(others_inside, c)
    passes = np.concatenate([np.zeros(1, bool), inside(angles), np.zeros(1, bool)])
    before, after = passes[:-2], passes[2:]
    is_knot = _are_knots(c, angles)
    if is_knot is not None:
        before, after = before & ~is_knot[0], after & ~is_knot[1]
    begins, ends = (np.flatnonzero(passes[1:-1] & ~beside) for beside in (before, after))
    if not begins.size:
        return None
    if not c.is_exact and is_knot is None:
        is_gap = angles[begins[1:]] - angles[ends[:-1]] > _BLURRED
        begins, ends = begins[np.append(True, is_gap)], ends[np.append(is_gap, True)]
    zero = np.sum(angles < 0.0)  # negative angles begin at -pi
    at_zero = begins == zero
    pinned = np.concatenate([at_zero | (begins == 0), ends == len(angles) - 1])
    limit = np.concatenate([np.where(at_zero, 0.0, -np.pi), np.full(len(ends), np.pi)])
    line = np.where(limit == 0.0, Branch.Z_PLUS_ONE, Branch.Z_MINUS_ONE)
    if is_knot is not None:
        at_knot = np.concatenate([is_knot[0][begins], is_knot[1][ends]])
        pinned = pinned | at_knot
        limit = np.where(at_knot, angles[np.concatenate([begins, ends])], limit)
        line = np.where(at_knot, Branch.CURVE, line)
    # Both ends of all pieces are solved in one batch.
    padded = np.concatenate([np.zeros(1), angles, np.full(1, np.pi)])
    neighbours = padded[np.concatenate([begins, ends + 2])]
    passing = padded[np.concatenate([begins, ends]) + 1]
    outer, inner = _narrowed(
        inside,
        _EXACT_NARROWING if c.is_exact else _NARROWING,
        np.where(pinned, limit, neighbours),
        passing,
    )
    rough = 0.5 * (outer + inner)
    rough = out_of_rounding(c.stretches, rough, passing)
    points = curve_gains(c, rough)
    scale = scales(c, points[0], points[1], rough)
    return _Ends(pinned, limit, line, outer, inner, rough, points, scale)


def _are_knots(c: Curve, angles: Array) -> tuple[Array, Array] | None:
    """Return which angles are knots at which pieces begin, and which are those where they end.

    A scan has them twice; without lines at poles there are none.
    """
    if not c.lines:
        return None
    knots = np.concatenate([line.knots for line in c.lines])
    twice = (np.diff(angles) == 0.0) & np.isin(np.abs(angles[1:]), knots)
    return np.append(False, twice), np.append(twice, False)


def _across_knots(ends: _Ends, following: Array, preceding: Array) -> tuple[Array, Array]:
    """Join the pieces that end at a knot and the next ones, which begin there."""
    count = len(following)
    at_knot = ends.pinned & (ends.line == Branch.CURVE)
    index = np.arange(count)
    following = np.where(at_knot[count:], index + 1, following)
    return following, np.where(at_knot[:count], index - 1, preceding)


def _narrowed(
    inside: Callable[[Array], Array],
    narrowing: tuple[int, int, float],
    outer: Array,
    inner: Array,
) -> tuple[Array, Array]:
    """Divide the intervals between angles that fail the test and angles that pass it."""
    rounds, parts, enough = narrowing
    if np.max(abs(outer - inner)) <= enough:
        return outer, inner
    steps = np.arange(1.0, parts)[:, None]
    for _ in range(rounds):
        width = inner - outer
        failed = np.cumprod(~inside(outer + width * (steps / parts)), axis=0)
        last = np.sum(failed, axis=0)  # up to the first that passes
        inner = np.where(last == parts - 1, inner, outer + width * ((last + 1.0) / parts))
        outer = outer + width * (last / parts)
    return outer, inner


def _joined(ends: _Ends, is_open: Array) -> tuple[Array, Array, Array]:
    """Return the angles of open ends with those of the nearest ones, and which these are."""
    slots = len(is_open) // 2
    begins, lasts = ends.points[:, None, :slots], ends.points[:, slots:, None]
    gaps = np.sum((lasts - begins) ** 2, axis=0)
    gaps = np.where(is_open[slots:, None] & is_open[None, :slots], gaps, np.inf)
    following, preceding = np.argmin(gaps, axis=1), np.argmin(gaps, axis=0)
    others = ends.rough[np.concatenate([slots + preceding, following])]
    return np.stack([ends.rough, others]), following, preceding


def _solved(c: Curve, ends: _Ends, branch: Array, angles: Array) -> tuple[Array, Array, Array]:
    """Return angles, what rounding took from them, and whether they are right; (2, piece) each."""
    half_width = _STRAY * (abs(ends.outer - ends.inner) + _SLACK)
    unpinned = np.where(ends.pinned, NO_BRANCH, branch)
    theta, low, is_solved = solved_corners(c, unpinned, angles, ends.scale, half_width)
    slack = 2.0 * abs(ends.outer - ends.inner) + _SLACK
    is_between = (theta >= np.minimum(ends.outer, ends.inner) - slack) & (
        theta <= np.maximum(ends.outer, ends.inner) + slack
    )
    is_solved = ends.pinned | (is_solved & is_between)
    theta, low = np.where(is_solved, theta, ends.rough), np.where(is_solved, low, 0.0)
    theta, low = np.where(ends.pinned, ends.limit, theta), np.where(ends.pinned, 0.0, low)
    return theta.reshape(2, -1), low.reshape(2, -1), is_solved.reshape(2, -1)


# ------------------------------------------------------------------------ what follows a piece
def _linked(
    c: Curve,
    walls: Array,
    begin_branch: Array,
    end_branch: Array,
    following: Array,
) -> _Links:
    """Return what follows each piece.

    ``walls`` are alpha and beta of the begins and of the ends.
    """
    plus, minus = c.along_lines(*walls)
    plus_start, minus_start = c.along_lines(*c.lines_crossing)
    from_plus = end_branch == Branch.Z_PLUS_ONE
    exits = np.where(from_plus[:, None], plus[0], minus[0])
    ahead = exits - np.where(from_plus, plus[1], minus[1])[:, None]
    here = (begin_branch == end_branch[:, None]) & (ahead > 0.0)
    # Along this line the boundary may run into the other one, and not come from there.
    runs_in = c.lines_turn * np.where(from_plus, 1.0, -1.0) > 0.0
    other_line = np.where(from_plus, Branch.Z_MINUS_ONE, Branch.Z_PLUS_ONE)
    around = np.where(from_plus[:, None], minus[0] - minus_start, plus[0] - plus_start)
    there = (begin_branch == other_line[:, None]) & (around > 0.0) & runs_in[:, None]
    straight = np.any(here, axis=1)
    distance = np.where(
        straight[:, None], np.where(here, ahead, np.inf), np.where(there, around, np.inf)
    )
    crosses = end_branch == Branch.CURVE
    return _Links(
        successor=np.where(crosses, following, np.argmin(distance, axis=1)),
        via=~crosses & ~straight,
        exists=crosses | straight | np.any(there, axis=1),
    )


# The angles at which a scan looks for pieces of the boundary of the stable set.

_FIRST = 1e-7  # and the last one beside pi
_CLOSEST = 1e-11  # to an angle that a scan looks closer at
_OFFSETS = 24  # to each side of an angle to look closer at
_NEAR_CIRCLE = 1e-2  # roots whose angles a scan looks closer at
_SAME = 1e-10  # angles closer than that to one that was searched are not searched again
_ON_CIRCLE, _APART, _MOST_CENTERS = 1e-9, 1e-7, 8  # of lone partners
_WIDTHS, _STEPS_AROUND = 8.0, 16  # of a resonance
_STEPS_OF_LINE = 48  # on each side of a line at a pole


@cache
def _even_angles(length: int, fineness: int) -> Angles:
    """Return the angles of a scan: even steps, a part of a turn of z^m, and finer to both ends.

    ``length`` is that of a curve.
    """
    count = fineness * (24 + 8 * length)
    even = (np.arange(count) + 0.5) * (np.pi / count)
    start = np.geomspace(_FIRST, even[0], 12 * fineness, endpoint=False)
    angles = np.concatenate([start, even, np.pi - start[::-1]])
    angles.flags.writeable = False
    return angles


def scan_angles(c: Curve, fineness: int) -> Angles:
    """Return the angles of a scan, more of them at the poles and where beta is 0.

    They have the sign of Im V: see ``region.curve``.
    """
    angles = _even_angles(c.length, fineness)
    offsets = np.geomspace(_CLOSEST, np.pi / len(angles), 8 * fineness)
    centers = np.concatenate([c.poles[0], c.steep])
    around = centers[:, None] + np.concatenate([-offsets, offsets])
    lines = [_around_line(line, fineness) for line in c.lines]
    drawn = [stretch.scan for stretch in c.stretches]
    around = np.concatenate([around.ravel(), _around_resonances(c, fineness), *lines, *drawn])
    inner = around[(around > angles[0]) & (around < angles[-1])]
    angles = np.concatenate([angles, inner])
    angles = angles[_are_resolved(c, angles)]
    return np.sort(np.where(is_oriented(c, angles), angles, -angles))


def _are_resolved(curve: Curve, angles: Angles) -> Bool[np.ndarray, " _"]:
    """Return which angles are not so close to the middle of a stretch that gains are rounding."""
    every = (stretch.is_rounding(np.abs(angles)) for stretch in curve.stretches)
    resolved: np.ndarray = ~reduce(np.logical_or, every, np.zeros(len(angles), bool))
    return resolved


def _around_resonances(curve: Curve, fineness: int) -> Angles:
    """Return angles around zeros and poles of a device, in steps that grow with the distance."""
    angle, width = curve.resonances[:, :, None]
    extent = np.maximum(angle, _WIDTHS * width)
    growth = np.linspace(0.0, 1.0, _STEPS_AROUND * fineness)
    offsets = width / _WIDTHS * (extent / (width / _WIDTHS)) ** growth
    around: Angles = (angle + np.concatenate([-offsets, offsets], axis=1)).ravel()
    return around


def _around_line(line: PoleLine, fineness: int) -> Angles:
    """Return angles of a line at a pole: the knots twice, as pieces end there."""
    count = _STEPS_OF_LINE * fineness
    even = line.half_width * (np.arange(count) + 0.5) / count
    close = np.geomspace(_CLOSEST, even[0], 8 * fineness)
    offsets = np.concatenate([-even, even, -close, close])
    knots = np.array(line.knots)
    beside = knots[:, None] + np.concatenate([-close, close, [0.0, 0.0]])
    return np.concatenate([line.angle + offsets, beside.ravel()])


def closer_angles(c: Curve, angles: Angles, centers: Angles) -> Angles:
    """Return the angles of a scan with more angles around some centres."""
    offsets = np.geomspace(_CLOSEST, np.max(np.diff(angles)), _OFFSETS)
    around = centers[:, None] + np.concatenate([-offsets, offsets])
    closer: Angles = np.clip(around.ravel(), angles[0], angles[-1])
    closer = closer[is_oriented(c, closer) & _are_resolved(c, closer)]
    return np.sort(np.concatenate([angles, closer]))


def suspects(c: Curve, pieces: Pieces, searched: Angles, outside: float) -> Angles:
    """Return further angles around which a piece may hide between two angles of the scan.

    They are the corners that the pieces have and the angles of the roots that are on the circle
    there, or close.
    """
    ends = np.concatenate([pieces.begin, pieces.end])
    size = np.abs(ends)
    corners = ends[(size > 0.0) & (size < np.pi)]
    if c.is_exact:
        partners = to_rescaled(c.stretches, angles_on_circle(c, *exact_walls(c, corners)))
    else:
        others = _others(c, c.polynomial(*curve_gains(c, corners)), corners)
        partners = _angles_near_circle(others[:, np.all(np.isfinite(others), axis=0)].T)
    partners = np.where(is_oriented(c, partners), partners, -partners)
    every = np.concatenate([corners, partners])
    away = np.min(np.abs(every[:, None] - searched), axis=1, initial=np.inf)
    return nearly_stable(c, every[away >= _SAME], outside)


def lone_partners(curve: Curve, pieces: Pieces) -> DoubleDouble:
    """Return the angles of roots on the circle at ends of pieces, where no piece begins or ends.

    The curve is evaluated in double-double.
    """
    ends = np.concatenate([pieces.begin, pieces.end])
    open_ends = ends[(ends != 0.0) & (np.abs(ends) < np.pi)]
    angles = angles_on_circle(curve, *exact_walls(curve, open_ends), within=_ON_CIRCLE)
    size = to_rescaled(curve.stretches, angles)
    away = np.min(np.abs(size[:, None] - np.abs(ends)), axis=1, initial=np.inf)
    centers = [stretch.angle for stretch in curve.stretches]
    near = np.min(np.abs(angles.hi[:, None] - centers), axis=1, initial=np.inf)
    _, unique = np.unique(np.round(angles.hi / _APART), return_index=True)
    chosen = unique[(away[unique] > _APART) & (near[unique] > _APART)][:_MOST_CENTERS]
    return angles[chosen]


def nearly_stable(c: Curve, angles: Angles, outside: float) -> Angles:
    """Return the angles, in order, at which no other root is farther outside than a limit."""
    if not angles.size:
        return angles
    angles = np.sort(angles)
    angles = angles[np.diff(angles, prepend=-np.inf) > _CLOSEST]
    chosen: Angles = angles[others_inside(c, angles, within=1.0 + outside)]
    return chosen


def _angles_near_circle(polynomials: Float64[np.ndarray, "polynomial coefficient"]) -> Angles:
    """Return the angles between 0 and pi of the roots close to the circle."""
    if polynomials.shape[1] < 2:
        return np.empty(0)
    roots = np.linalg.eigvals(companion_matrix(polynomials)).ravel()
    near = roots[(np.abs(np.abs(roots) - 1.0) < _NEAR_CIRCLE) & (roots.imag > 0.0)]
    angles: Angles = np.angle(near)
    return angles
