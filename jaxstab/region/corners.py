"""Corners of the boundary, where the curve meets a line or itself, by Newton's method.

A piece ends where the curve meets the line z = r (the lift is 0), the line z = -r (the margin is 0)
or itself (two angles have one point). Newton's steps of all three kinds follow from the values and
slopes of the curve at one or two angles; the nearest corner tells which kind it is
(``nearest_branch``), and its steps are then repeated, all lanes at once, until they are below
rounding (``solved_corners``). One more step, of which only the derivative counts, makes the result
differentiable in the slice. What rounding takes from an angle is returned beside it: next to pi it
holds digits of the corner.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from jaxstab.arrays import Array, constant, kept, namespace, repeat_while
from jaxstab.region.curve import Curve, curve_and_lift, minus_margin, plus_offset
from jaxstab.region.filtered_curve import FilteredCurve
from jaxstab.region.roots import nonzero, with_slope
from jaxstab.rounding import UNIT

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
    cosine = namespace(theta).cos(theta)
    size = abs(alpha) + abs(beta) + abs(plus_offset(c))
    base, slope, damping = map(abs, c.at_minus_one)
    if isinstance(c, FilteredCurve):  # undamped modes put corners at 0
        size = size + _SMALLEST * np.max(size, initial=0.0, where=np.isfinite(size))
        slope = slope + damping
    margin = base + slope * size
    return Scales(1.0 / size, (1.0 - cosine) / size, (1.0 + cosine) / margin)


def nearest_branch(c: Curve, angles: Array, scale: Scales) -> Array:
    """Return for ends at angles[0] which Branch the curve meets there, next to angles[1] or not.

    For each kind of corner Newton's method says how far off it is; the nearest one is taken.
    """
    xp = namespace(c, angles)
    steps = xp.stack(_newton_steps(c, angles, scale).steps)
    return xp.argmin(xp.nan_to_num(abs(steps), nan=xp.inf), axis=0)


def solved_corners(
    c: Curve, branch: Array, angles: Array, scale: Scales, half_width: Array
) -> tuple[Array, Array, Array]:
    """Return the angles near ``angles[0]`` where the curve meets a branch, and which are solved.

    The second of the three results is what rounding took from the angles. Where the curve meets
    itself, ``angles[1]`` is near the other angle. A search that strays farther than ``half_width``
    is given up, because all searches wait for the slowest. In JAX the result is differentiable in
    the slice, by the implicit function theorem.
    """
    xp = namespace(c, angles)

    def newton(slice_: Curve, angles: Array) -> tuple[Array, Array]:
        """Return the steps of pairs of angles to a corner, and how far they are from it."""
        every = _newton_steps(slice_, angles, scale)
        step, gap, partner = 0.0, 0.0, xp.where(is_of[0], every.partner, 0.0)
        for is_it, its_step, its_gap in zip(is_of, every.steps, every.mismatches, strict=True):
            step, gap = xp.where(is_it, its_step, step), xp.where(is_it, its_gap, gap)
        return xp.stack([step, partner]), gap

    def is_open(state: tuple[Array, ...]) -> Array:
        count, *_, moved = state
        return (count < _STEPS) & xp.any(moved)

    def step(state: tuple[Array, ...]) -> tuple[Array, ...]:
        count, _, here, *_ = state
        near = abs(here[0] - angles[0]) <= half_width
        steps, gap = newton(fixed, here)
        taken = xp.where(near, steps, 0.0)
        moved = abs(taken) > _TOLERANCE * (1.0 + abs(here))
        return count + 1, here, here - taken, steps, gap, moved

    fixed = constant(c)
    is_of = [branch == each for each in Branch]
    nothing = xp.zeros_like(angles)
    start = (xp.asarray(0), angles, angles, nothing, nothing[0], xp.ones(angles.shape, bool))
    _, last, here, steps, mismatch, _ = constant(repeat_while(is_open, step, start))
    if xp is np and np.all(mismatch < _TOLERANCE):
        here = last  # the last step has all that one more would tell
    else:
        steps, mismatch = newton(c, here)  # one more has the derivative in the slice
    solved = here - steps
    low = constant((here - kept(solved)) - steps)
    if not isinstance(c, FilteredCurve):
        return solved[0], low[0], mismatch < _TOLERANCE
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
    xp = namespace(c, angles)

    def values(angles: Array) -> tuple[Array, ...]:
        alpha, beta, lift = curve_and_lift(c, angles)
        margin = minus_margin(c, alpha[0], beta[0]) / (1.0 + xp.cos(angles[0]))
        return (
            alpha * scale.points,
            beta * scale.points,
            lift[0] * scale.lift,
            margin * scale.margin,
        )

    (alpha, beta, lift, margin), slopes = with_slope(values, angles)
    alpha_slope, beta_slope, lift_slope, margin_slope = constant(slopes)
    step, partner = steps_to_meeting(alpha, beta, alpha_slope, beta_slope)
    gap = xp.maximum(abs(alpha[0] - alpha[1]), abs(beta[0] - beta[1]))
    if c.lines:  # straight: a line never meets itself
        lengths = np.hypot(alpha_slope, beta_slope)
        turn = beta_slope[0] * alpha_slope[1] - alpha_slope[0] * beta_slope[1]
        step = np.where(abs(turn) < _PARALLEL * lengths[0] * lengths[1], np.inf, step)
    return _Steps(  # in the order of Branch
        steps=(step, lift / nonzero(lift_slope, np.inf), margin / nonzero(margin_slope, np.inf)),
        partner=partner,
        mismatches=(gap, abs(lift), abs(margin)),
    )
