"""Where the curve crosses itself or one of the lines: any corner of the stable set is there.

Between two angles of a scan the curve is taken for a cubic with its ends and the tangents there. A
cubic stays in the hull of its control points, so pieces of which the hulls are apart do not meet.
Few are left to try; and crossings that come in pairs between two angles, and leave no change of
side at them, are not stepped over.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float64, Int

from jaxstab.region.curve import SliceCoefficients, curve_and_lift, curve_point
from jaxstab.region.pieces import minus_margin, steps_to_meeting
from jaxstab.region.roots import bracketed_root, with_slope

_BATCH = 16
_NEWTON_STEPS = 24  # where two pieces all but touch each step halves what is left
_BEYOND = 0.5  # how far Newton's method may leave a piece, as a share of it
_ARRIVED = 1e-3  # the last step, and the least distance of two angles that meet; likewise
_CLOSE = 1e-6  # crossings closer to each other are one
_STARTS = np.array([[0, 0, 1, 1], [0, 1, 0, 1]])  # of two pieces: one end of each

Angles = Float64[np.ndarray, " _"]  # of any length
Pieces = Int[np.ndarray, " _"]


def crossings(c: SliceCoefficients, angles: Angles) -> Angles:
    """Return the angles, in order, at which the curve of a scan meets itself or a line."""
    controls, slopes, near = map(np.asarray, _sampled(c, jnp.asarray(angles)))
    of_curve = _self_crossings(c, angles, controls[:, :2], slopes[:2], near)
    of_lines = _line_crossings(c, angles, controls[:, 2:], slopes[2:])
    found = np.sort(np.concatenate([of_curve, of_lines]))
    return found[np.diff(found, prepend=-1.0) > _CLOSE]


def in_batches(compiled: Callable[..., Array], *columns: np.ndarray) -> np.ndarray:
    """Apply a function to columns of any length in batches of one size, compiled once."""
    if not len(columns[0]):
        return np.empty(0)
    batches = np.stack([np.pad(one, (0, -len(one) % _BATCH)) for one in columns])
    batches = batches.reshape(len(columns), -1, _BATCH).swapaxes(0, 1)
    answers = [np.asarray(compiled(*batch)) for batch in batches]
    return np.concatenate(answers)[: len(columns[0])]


@jax.jit
def _sampled(c: SliceCoefficients, angles: Array) -> tuple[Array, Array, Array]:
    """Return the control points of the pieces, slopes at the angles, and which boxes overlap.

    The first (4, value, piece) and the second (value, angle) are those of alpha, beta and the
    margins to the lines z = r and z = -r; the third (piece, piece) is for hulls in (alpha, beta).
    """

    def values(theta: Array) -> Array:
        alpha, beta, lift = curve_and_lift(c, theta)
        return jnp.stack([alpha, beta, lift, minus_margin(c, alpha, beta)])

    at_angles, slopes = with_slope(values, angles)
    here, there = at_angles[:, :-1], at_angles[:, 1:]
    third = jnp.diff(angles) / 3.0
    inner = here + third * slopes[:, :-1], there - third * slopes[:, 1:]
    controls = jnp.stack([here, *inner, there])
    low, high = jnp.min(controls[:, :2], axis=0), jnp.max(controls[:, :2], axis=0)
    overlap = (low[:, :, None] <= high[:, None]) & (low[:, None] <= high[:, :, None])
    return controls, slopes, overlap[0] & overlap[1]


# ---------------------------------------------------------------------------- of two pieces


def _self_crossings(
    c: SliceCoefficients,
    angles: Angles,
    controls: Float64[np.ndarray, "4 2 piece"],
    slopes: Float64[np.ndarray, "2 angle"],
    near: Bool[np.ndarray, "piece piece"],
) -> Angles:
    turning = _turning_pieces(slopes)
    loops = np.stack([np.tile(turning, 2), np.append(turning, turning + 1)])
    pairs = np.concatenate([_touching_pieces(controls, near), loops], axis=1)
    pieces = np.repeat(pairs, _STARTS.shape[1], axis=1)
    start = angles[pieces + np.tile(_STARTS, pairs.shape[1])]
    both = in_batches(partial(_meeting, c), *start, *angles[pieces], *angles[pieces + 1])
    found: Angles = both[np.isfinite(both)]
    return found


def _touching_pieces(controls: np.ndarray, near: np.ndarray) -> Int[np.ndarray, "2 pair"]:
    """Return the pairs of pieces, but for neighbours, of which the hulls may touch."""
    first, second = np.nonzero(near)
    apart = second > first + 1
    first, second = first[apart], second[apart]
    touch = _hulls_overlap(controls, first, second) & _hulls_overlap(controls, second, first)
    return np.stack([first[touch], second[touch]])


def _hulls_overlap(controls: np.ndarray, one: Pieces, other: Pieces) -> np.ndarray:
    """Return where the hulls of two pieces overlap, seen along the chord of the first."""
    start = controls[0][:, one]
    along = controls[3][:, one] - start
    low, high = np.empty((2, 2, len(one)))
    for row, piece in enumerate((one, other)):
        away = controls[:, :, piece] - start
        height = along[0] * away[:, 1] - along[1] * away[:, 0]
        low[row], high[row] = height.min(axis=0), height.max(axis=0)
    overlap: np.ndarray = (low[0] <= high[1]) & (low[1] <= high[0])
    return overlap


def _turning_pieces(slopes: Float64[np.ndarray, "2 angle"]) -> Pieces:
    """Return the pieces that turn, alone or with the next one, by more than a right angle.

    There may be a loop about what was a cusp.
    """
    alone, both = (np.sum(slopes[:, :-k] * slopes[:, k:], axis=0) < 0.0 for k in (1, 2))
    return np.flatnonzero(alone[:-1] | alone[1:] | both)


@jax.jit
def _meeting(c: SliceCoefficients, *columns: Array) -> Array:
    """Return pairs of angles (pair, 2) at which the curve meets itself; NaN where it does not.

    The columns are two angles to start from, then the begins and the ends of two pieces.
    """
    start, begin, end = jnp.stack(columns).reshape(3, 2, -1)
    width = end - begin

    def newton(_: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        angles, _ = state
        points, slopes = with_slope(lambda theta: jnp.stack(curve_point(c, theta)), angles)
        steps = jnp.stack(steps_to_meeting(*points, *slopes))
        return jnp.clip(angles - steps, lowest, highest), steps

    lowest, highest = begin - _BEYOND * width, end + _BEYOND * width
    angles, steps = lax.fori_loop(0, _NEWTON_STEPS, newton, (start, width))
    apart = jnp.abs(angles[0] - angles[1]) > _ARRIVED * jnp.max(width, axis=0)
    arrived = jnp.all(jnp.abs(steps) < _ARRIVED * width, axis=0) & apart
    return jnp.where(arrived, angles, jnp.nan).T


# ------------------------------------------------------------------------ of pieces and lines


def _line_crossings(
    c: SliceCoefficients,
    angles: Angles,
    controls: Float64[np.ndarray, "4 2 piece"],
    slopes: Float64[np.ndarray, "2 angle"],
) -> Angles:
    crosses = _unlike(controls[0], controls[3])
    line, step = np.nonzero(crosses)
    may_touch = (controls.min(axis=0) < 0.0) & (controls.max(axis=0) > 0.0)
    returns = may_touch & ~crosses & _unlike(slopes[:, :-1], slopes[:, 1:])
    near_line, near_step = np.nonzero(returns)
    lower, upper = angles[near_step], angles[near_step + 1]
    nearest = in_batches(partial(_nearest_place, c), lower, upper, near_line)
    return in_batches(
        partial(_line_crossing, c),
        np.concatenate([angles[step], lower, nearest]),
        np.concatenate([angles[step + 1], nearest, upper]),
        np.concatenate([line, near_line, near_line]),
    )


def _unlike(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    unlike: np.ndarray = (one > 0.0) != (other > 0.0)
    return unlike


@jax.jit
def _line_crossing(c: SliceCoefficients, lower: Array, upper: Array, line: Array) -> Array:
    """Return angles at which the curve crosses a line, between angles on unlike sides of it."""

    def margin(slice_: SliceCoefficients, theta: Array) -> Array:
        return _margin(slice_, theta, line)

    return bracketed_root(margin, c, lower, upper)


@jax.jit
def _nearest_place(c: SliceCoefficients, lower: Array, upper: Array, line: Array) -> Array:
    """Return angles at which the curve is nearest to a line, or farthest beyond it."""

    def slope(slice_: SliceCoefficients, theta: Array) -> Array:
        return with_slope(lambda angle: _margin(slice_, angle, line), theta)[1]

    return bracketed_root(slope, c, lower, upper)


def _margin(c: SliceCoefficients, theta: Array, line: Array) -> Array:
    """Return how far the curve is from the line z = r, number 0, or z = -r, number 1."""
    alpha, beta, lift = curve_and_lift(c, theta)
    return jnp.where(line == 0, lift, minus_margin(c, alpha, beta))
