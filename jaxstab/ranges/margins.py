"""How far a wall can be changed before it loses stability: in stiffness, in damping, in delay.

From a wall that is proved stable, one quantity is changed. Boxes of that quantity and of the angle
theta on the unit circle are halved until each is proved free of roots (``circle.exclude``). Up to
the first box that is left, no root can have crossed the circle, so the loop is proved stable that
far; there lies the first crossing, bracketed to a billionth. The delay is changed continuously,
through all fractions of a sample. How the crossing moves with the loop follows from the equations
that hold there, by the implicit function theorem.
"""

from functools import partial
from math import inf, isfinite, nan, pi
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float64, Int8

from jaxstab.boxes.bisection import Boxes, Extent, pave
from jaxstab.boxes.exclusion import Loops, circle_equations, exclude_any_delay, quick_slice
from jaxstab.conventions import AXES, Verdict
from jaxstab.host_search import found_on_host
from jaxstab.model import (
    HapticLoop,
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    require_x64,
)
from jaxstab.point import verdict

Point = Float64[np.ndarray, " axis"]

_ALPHA, _BETA, _DELAY = (AXES.index(name) for name in ("alpha", "beta", "delay"))
_WAYS = ((_ALPHA, -1.0), (_ALPHA, 1.0), (_BETA, -1.0), (_BETA, 1.0), (_DELAY, 1.0))
_ALL_ANGLES = Boxes(np.full((1, 1), 0.5), np.full((1, 1), 0.5))  # in units of pi
_ANGLE_SIZE = 2.0**-16  # of pi, and of a sample: half the size of the smallest boxes of angles
_MOST_ANGLES = 2000  # such boxes at once
_FINEST = 2.0**-32  # of a stretch and of pi: half the size of the smallest boxes
_REAL = 8 * _FINEST  # of pi: a root this near to the real axis is taken for real
_DOUBLINGS = 48
_LEAST_STEP = 2.0**-10  # of a gain, in units of the dimensionless parameters
MOST_DELAY = 1024.0  # samples: further delay is not looked at


class Margins(NamedTuple):
    """What a wall has left; NaN throughout for a wall that is not proved stable.

    ``stiffness`` and ``damping`` are the intervals (least, largest) of K, at this B, and of B, at
    this K, in which the wall stays stable; ``stiffness_gain`` and ``damping_gain`` the factors by
    which K and B may be multiplied, infinite for a gain that is not above 0. ``extra_delay`` is the
    time by which the delay may grow; infinite where no delay is too much, or none up to 1024
    samples (MOST_DELAY). All of them are proved, and fall short of the first root on the circle by
    about 1e-9 of the way there. ``verdict`` holds certified codes of ``Verdict``.
    """

    verdict: Int8[Array, "*grid"]
    stiffness: Float64[Array, "*grid 2"]
    damping: Float64[Array, "*grid 2"]
    stiffness_gain: Float64[Array, "*grid"]
    damping_gain: Float64[Array, "*grid"]
    extra_delay: Float64[Array, "*grid"]


def margins(loop: HapticLoop, stiffness: ArrayLike, damping: ArrayLike) -> Margins:
    """Return how far stiffness, damping and delay of a loop at a wall may change, each alone.

    It is ``dimensionless_margins`` in SI units; see there for vmap and derivatives.

    Args:
        loop: device, hand, sample time and delay.
        stiffness: K of the wall in N/m, any shape; broadcasts with the damping.
        damping: B of the wall in N s/m.

    Returns:
        Margins in N/m, N s/m and s.

    Raises:
        ValueError: a gain is infinite or NaN.
        TypeError: a gain is traced by jit.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle.
    """
    require_x64()
    alpha = loop.alpha(jnp.asarray(checked_gain("stiffness", stiffness), jnp.float64))
    beta = loop.beta(jnp.asarray(checked_gain("damping", damping), jnp.float64))
    found = dimensionless_margins(alpha, beta, loop.gamma, loop.delta, loop.delay_samples)
    return found._replace(
        stiffness=loop.stiffness(found.stiffness),
        damping=loop.damping(found.damping),
        extra_delay=loop.sample_time * found.extra_delay,
    )


def dimensionless_margins(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> Margins:
    """Return how far alpha, beta and delay of a loop may change, each alone, before it is unstable.

    Each loop is searched by itself, outside of JAX: vmap goes through, jit does not. Differentiable
    once in every argument, the delay too; where two crossings come first at once, the derivative is
    that of one of them, and NaN where the margin is infinite or the loop not stable.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.

    Returns:
        Margins: intervals of alpha and beta, and samples.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN.
        TypeError: an argument is traced by jit.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle.
    """
    require_x64()
    checked_gain("alpha", alpha)
    checked_gain("beta", beta)
    checked_gamma(gamma)
    checked_delta(delta)
    if not isinstance(delay, jax.core.Tracer):
        checked_delay(delay)
    point = jnp.stack(
        jnp.broadcast_arrays(
            *(jnp.asarray(value, jnp.float64) for value in (alpha, beta, gamma, delta, delay))
        ),
        axis=-1,
    )
    found = found_on_host(_first_crossings, 1 + 2 * len(_WAYS), *jnp.moveaxis(point, -1, 0))
    steps, angles = found[..., 1::2], found[..., 2::2]
    low_alpha, high_alpha, low_beta, high_beta, extra_delay = (
        _moving(point, steps[..., number], angles[..., number], axis)
        for number, (axis, _) in enumerate(_WAYS)
    )
    alphas = point[..., _ALPHA, None] + jnp.stack([low_alpha, high_alpha], axis=-1)
    betas = point[..., _BETA, None] + jnp.stack([low_beta, high_beta], axis=-1)
    return Margins(
        found[..., 0].astype(jnp.int8),
        alphas,
        betas,
        _factor(alphas[..., 1], point[..., _ALPHA]),
        _factor(betas[..., 1], point[..., _BETA]),
        extra_delay,
    )


def _factor(most: Array, gain: Array) -> Array:
    without = jnp.where(jnp.isnan(most), most, inf)
    return jnp.where(gain > 0.0, most / jnp.where(gain > 0.0, gain, 1.0), without)


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def _moving(point: Array, step: Array, angle: Array, axis: int) -> Array:
    """Return the steps along an axis to the crossings, and how they move when the points do."""
    del point, angle, axis
    return step


@_moving.defjvp
def _moving_jvp(
    axis: int, primals: tuple[Array, Array, Array], tangents: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    return primals[1], jnp.sum(_slopes(*primals, axis) * tangents[0], axis=-1)


@jax.jit
@partial(jnp.vectorize, signature="(n),(),(),()->(n)")
def _slopes(point: Array, step: Array, angle: Array, axis: Array) -> Array:
    """Return the derivatives of a step by the point, from p(z) = 0 at both ends of the step."""
    end = jnp.round(angle)
    is_real = jnp.abs(angle - end) < _REAL
    start = pi * jnp.where(is_real, end, angle)

    def equations(crossing: Array, point: Array) -> Array:
        alpha, beta, gamma, delta, delay = point.at[axis].add(crossing[0])
        plant = quick_slice(gamma, delta, delay)
        real, imaginary = circle_equations(plant, alpha, beta, crossing[1])
        return jnp.stack([real, jnp.where(is_real, crossing[1] - start, imaginary)])

    bracketed = jnp.stack([step, start])
    by_crossing = jax.jacfwd(equations)(bracketed, point)
    crossing = bracketed - jnp.linalg.solve(by_crossing, equations(bracketed, point))
    by_crossing, by_point = jax.jacfwd(equations, (0, 1))(crossing, point)
    slopes: Array = -jnp.linalg.solve(by_crossing, by_point)[0]
    return slopes


# ---------------------------------------------------------------------------------- on the host


class _Crossing(NamedTuple):
    """How far away a root may first be on the circle, and the part of pi that its angle is."""

    away: float
    angle: float


_NONE = _Crossing(inf, nan)


def _first_crossings(point: Point) -> Float64[np.ndarray, " found"]:
    """Return the verdict on a wall and, each way of ``_WAYS``, the step to the crossing."""
    code = _verdict(point)
    if code != Verdict.STABLE:
        return np.array([float(code), *[nan] * (2 * len(_WAYS))])
    found = [float(code)]
    for axis, way in _WAYS[:-1]:
        crossing = _to_crossing(point, axis, way * _reach(point, axis, way))
        found += [way * crossing.away, crossing.angle]
    return np.array([*found, *_extra_delay(point)])


def _verdict(point: Point) -> Verdict:
    return Verdict(int(verdict(*(float(value) for value in point))))


def _reach(point: Point, axis: int, way: float) -> float:
    """Return how far away a wall is proved unstable."""
    reach = max(_LEAST_STEP, 0.5 * abs(float(point[axis])))
    for _ in range(_DOUBLINGS):
        if _verdict(_moved(point, axis, way * reach)) == Verdict.UNSTABLE:
            return reach
        reach *= 2.0
    return inf


def _extra_delay(point: Point) -> _Crossing:
    """Return by how many samples the delay may grow."""
    turns = _critical_angles(point)
    start, stretch = 0.0, 1.0
    while start < MOST_DELAY and len(turns.center):
        crossing = _to_crossing(_moved(point, _DELAY, start), _DELAY, stretch, turns)
        if isfinite(crossing.away):
            return crossing._replace(away=start + crossing.away)
        start, stretch = start + stretch, 2.0 * stretch
    return _NONE


def _critical_angles(point: Point) -> Boxes:
    """Return the angles, in units of pi, at which some delay may put a root on the circle."""
    whole = _moved(point, _DELAY, -float(point[_DELAY]))
    left, _ = pave(
        Boxes(np.full((1, 2), 0.5), np.full((1, 2), 0.5)),
        _ANGLE_SIZE,
        partial(_along, whole, _DELAY, 1.0),
        _MOST_ANGLES,
        exclude_any_delay,
    )
    begin, end = left.center[:, 1] - left.half[:, 1], left.center[:, 1] + left.half[:, 1]
    order = np.argsort(begin)
    begin, end = begin[order], np.maximum.accumulate(end[order])
    gaps = begin[1:] > end[:-1]
    begin = begin[np.append(True, gaps)[: len(begin)]]
    end = end[np.append(gaps, True)[: len(end)]]
    return Boxes(0.5 * (begin + end)[:, None], 0.5 * (end - begin)[:, None])


def _to_crossing(point: Point, axis: int, stretch: float, turns: Boxes = _ALL_ANGLES) -> _Crossing:
    """Return how far along an axis no root reaches the circle."""
    if not isfinite(stretch):
        return _NONE
    middle = np.full_like(turns.center, 0.5)
    whole = Boxes(np.hstack([middle, turns.center]), np.hstack([middle, turns.half]))
    left, is_finished = pave(whole, _FINEST, partial(_along, point, axis, stretch))
    if not is_finished:  # too many boxes at once
        half = 0.5 * stretch
        near = _to_crossing(point, axis, half, turns)
        if isfinite(near.away):
            return near
        beyond = _to_crossing(_moved(point, axis, half), axis, half, turns)
        return beyond._replace(away=abs(half) + beyond.away)
    if not len(left.center):
        return _NONE
    first = int(np.argmin(left.center[:, 0] - left.half[:, 0]))
    part = float(left.center[first, 0] - left.half[first, 0])
    return _Crossing(abs(stretch) * part, float(left.center[first, 1]))


def _along(point: Point, axis: int, stretch: float, boxes: Boxes) -> Extent:
    """Return the loops of boxes of (part of the stretch, theta / pi)."""
    middle = np.tile(point[:, None], len(boxes.center))
    middle[axis] += stretch * boxes.center[:, 0]
    still = np.zeros_like(middle)
    along = still.copy()
    along[axis] = abs(stretch) * boxes.half[:, 0]
    flat, turn = np.zeros(len(boxes.half)), pi * boxes.half[:, 1]
    return Extent(
        _loops(middle, pi * boxes.center[:, 1]),
        _loops(along, turn),
        [_loops(along, flat), _loops(still, turn)],
    )


def _loops(
    parameters: Float64[np.ndarray, "5 boxes"], theta: Float64[np.ndarray, " boxes"]
) -> Loops:
    alpha, beta, gamma, delta, delay = parameters
    return Loops(alpha, beta, gamma, delta, delay, theta)


def _moved(point: Point, axis: int, step: float) -> Point:
    moved = point.copy()
    moved[axis] += step
    return moved
