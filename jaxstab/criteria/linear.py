"""Simple criteria beside the exact boundary: the linear condition, Routh-Hurwitz, and their error.

They replace sampling and hold by a delay of half a sample, so the loop has the effective delay
t_r = t_d + T/2, in samples 1/2 + delay.
"""

from enum import IntEnum
from functools import partial
from math import floor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Float64, Int8
from numpy.polynomial import chebyshev

from jaxstab.conventions import Verdict
from jaxstab.criteria.cosine_series import first_rise
from jaxstab.model import (
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    plant_coefficients,
    require_x64,
)
from jaxstab.point import verdict
from jaxstab.region.curve import SliceCoefficients, curve_point, slice_coefficients

_FIRST_ANGLE = 1e-3  # rad, over 1 + delay: nearer to the corner (24) is rounding over rounding
_STEP_BACK = 1e-6  # of alpha + gamma: how far inside of a boundary point its side is tested


def linear_alpha_limit(
    beta: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> Float64[Array, "*grid"]:
    """Return the alpha below which the linear condition promises stability.

    Args:
        beta: wall damping B T/m, any shape; like all arguments it broadcasts.
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eqs. (22) and (23) of Hulin, Preusche, Hirzinger (2008).
    """
    require_x64()
    _, beta, _, delta, lag = _loop(0.0, beta, 0.0, delta, delay)
    return (beta + delta) / lag


def linear_condition(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> Bool[Array, "*grid"]:
    """Return True where the linear condition holds: alpha > -gamma and beta + delta > alpha t_r.

    t_r = 1/2 + delay. It neither implies stability nor follows from it: ``linear_validity`` says
    up to which stiffness it is near the exact boundary.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eqs. (19), (22) and (23) of Hulin, Preusche, Hirzinger (2008).
    """
    require_x64()
    alpha, beta, gamma, delta, lag = _loop(alpha, beta, gamma, delta, delay)
    holds: Array = (alpha > -gamma) & (beta + delta > alpha * lag)
    return holds


def routh_hurwitz_condition(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> Bool[Array, "*grid"]:
    """Return True where the third-order model of the loop is stable.

    The model is continuous in time, with the effective delay t_r = 1/2 + delay as a first-order
    lag. The linear condition is this one without the term delta t_r (beta + delta + gamma t_r).

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eqs. (17)-(21) of Hulin, Preusche, Hirzinger (2008).
    """
    require_x64()
    alpha, beta, gamma, delta, lag = _loop(alpha, beta, gamma, delta, delay)
    damped = beta + delta + gamma * lag > 0
    stiff = alpha + gamma > 0
    fast = delta * lag * (beta + delta + gamma * lag) + (beta + delta - alpha * lag) > 0
    return damped & stiff & fast


def linear_error(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> Float64[Array, "*grid"]:
    """Return (alpha_lin - alpha) / (alpha + gamma) for a point of the exact boundary.

    Eq. (24) is the absolute value of it. It is positive where the linear condition promises more
    stiffness than is stable, negative where it promises less. Infinite or NaN at alpha = -gamma.

    Args:
        alpha: wall stiffness K T^2/m on the exact boundary, any shape; all arguments broadcast.
        beta: wall damping B T/m of the same point.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (24) of Hulin, Preusche, Hirzinger (2008).
    """
    require_x64()
    alpha, beta, gamma, delta, lag = _loop(alpha, beta, gamma, delta, delay)
    return ((beta + delta) / lag - alpha) / (alpha + gamma)


class ValidityStatus(IntEnum):
    """What is known about the point where the linear condition loses its validity."""

    NOT_COMPUTED = 0
    FOUND = 1
    NEVER = 2
    OFF_THE_EDGE = 3

    @property
    def words(self) -> str:
        """The status in words."""
        return {
            ValidityStatus.NOT_COMPUTED: "not computed",
            ValidityStatus.FOUND: "a point of the stable region's boundary",
            ValidityStatus.NEVER: "the error never rises through this level: NaN",
            ValidityStatus.OFF_THE_EDGE: (
                "on the boundary curve, but the stable region does not reach this point"
            ),
        }[self]


class LinearValidity(NamedTuple):
    """A point (alpha, beta) of the boundary, its angle on the curve, and a ValidityStatus."""

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    theta: Float64[Array, "*grid"]
    status: Int8[np.ndarray, "*grid"]


def linear_validity(
    level: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> LinearValidity:
    """Return the boundary point up to which the linear condition errs by at most ``level``.

    It is the first one, along the boundary curve from its corner at alpha = -gamma, where the
    signed error (alpha_lin - alpha)/(alpha + gamma) rises through ``level``: the circles (2 %) and
    squares (5 %) of Fig. 7. The absolute value of eq. (24) can reach the level once more, before:
    with damping the linear condition is too careful at small stiffness (by 2.2 % for d = 1,
    delta = 0.015). Those crossings are not returned.

    That it is the first is proved by bounds on the curvature between samples, from
    theta = 1e-3/(1 + delay) on; the point itself is then solved to full precision.

    Args:
        level: relative error in (0, 1e3], any shape; like all arguments it broadcasts.
        gamma: physical stiffness k T^2/m in [0, 1e4], concrete.
        delta: physical damping b T/m in [0, 1e3], concrete.
        delay: time delay t_d/T >= 0 in samples, whole or fractional.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: sec. VII, eq. (24) and Fig. 7 of Hulin, Preusche, Hirzinger (2008).
    """
    require_x64()
    level = np.asarray(level, np.float64)
    if not np.all((level > 0) & (level <= 1e3)):
        raise ValueError(f"level is {level}; give relative errors above 0 and up to 1000.")
    delay = checked_delay(delay)
    gamma, delta = np.asarray(checked_gamma(gamma), float), np.asarray(checked_delta(delta), float)
    scenes = np.broadcast_arrays(level, gamma, delta, delay)
    level, gamma, delta, delay = (np.ravel(values) for values in scenes)
    rise = first_rise(_excess_series(level, gamma, delta, delay), _FIRST_ANGLE / (1 + delay))
    found = np.isfinite(rise.after)
    start = np.where(found, 0.5 * (rise.before + rise.after), 1.0)
    coefficients = slice_coefficients(gamma, delta, delay, np.ones_like(delay))
    theta, solved = _solve(jnp.asarray(start), coefficients, delta, delay, level)
    alpha, beta = curve_point(coefficients, theta)
    # The solved angle must lie in the bracket of the proof.
    found &= np.asarray(solved & (theta >= rise.before - 1e-12) & (theta <= rise.after + 1e-12))
    inside = verdict(alpha - _STEP_BACK * (alpha + gamma), beta, gamma, delta, delay)
    edge = np.where(inside == Verdict.STABLE, ValidityStatus.FOUND, ValidityStatus.OFF_THE_EDGE)
    status = np.where(found, edge, ValidityStatus.NEVER).astype(np.int8)
    shape = scenes[0].shape
    alpha, beta, theta = (
        jnp.where(found, value, jnp.nan).reshape(shape) for value in (alpha, beta, theta)
    )
    return LinearValidity(alpha, beta, theta, status.reshape(shape))


@jax.jit
@partial(jax.vmap, in_axes=(0, 0, 0, 0, 0))
def _solve(
    start: Array, coefficients: SliceCoefficients, delta: Array, delay: Array, level: Array
) -> tuple[Array, Array]:
    """Solve (24) = level for theta by Newton's method; also say whether it converged."""
    import optimistix  # here: it takes as long as all other imports, and few calls solve

    def excess(theta: Array, _: None) -> Array:
        alpha, beta = curve_point(coefficients, theta)
        lag = 0.5 + delay
        error: Array = ((beta + delta) / lag - alpha) / (alpha + coefficients.ratio)
        return error - level

    solver: optimistix.Newton[Array, Array, None] = optimistix.Newton(rtol=1e-13, atol=1e-13)
    solution: optimistix.Solution[Array, None]
    solution = optimistix.root_find(excess, solver, start, max_steps=16, throw=False)
    return solution.value, jnp.asarray(solution.result == optimistix.RESULTS.successful)


def _excess_series(
    level: np.ndarray, gamma: np.ndarray, delta: np.ndarray, delay: np.ndarray
) -> Float64[np.ndarray, "batch term"]:
    """Return |N|^2 t_r (alpha_lin - alpha - level (alpha + gamma)) as cosine series in theta."""
    plant = plant_coefficients(gamma, delta, delay)
    rows = [
        _one_excess_series(*scene)
        for scene in zip(
            level,
            gamma,
            delta,
            delay,
            *(np.asarray(c) for c in (plant.d1, plant.d0, plant.n2, plant.n1, plant.n0)),
            strict=True,
        )
    ]
    series = np.zeros((len(rows), max(map(len, rows), default=1)))
    for number, row in enumerate(rows):
        series[number, : len(row)] = row
    return series


def _one_excess_series(
    level: float, gamma: float, delta: float, delay: float, *plant: float
) -> Float64[np.ndarray, " term"]:
    d1, d0, n2, n1, n0 = plant
    lag = 0.5 + delay
    numerator, denominator = np.array([n2, n1, n0]), np.array([1.0, d1, d0])
    # W = |N|^2 w: powers floor(delay) + 3 down to floor(delay) - 1 of z.
    powers = range(floor(delay) + 3, floor(delay) - 2, -1)
    real = np.zeros(powers[0] + 1)
    damping = np.zeros(powers[0] + 1)  # Im W / sin(theta)
    for power, q in zip(powers, -np.convolve(denominator, numerator[::-1]), strict=True):
        real[abs(power)] += q
        damping[: powers[0]] += q * np.sign(power) * _sine_ratio(abs(power), powers[0])
    square = np.convolve(numerator, numerator[::-1])[2:] * np.array([1.0, 2.0, 2.0])
    slope = [1 + (1 + level) * lag, -(1 + level) * lag]
    series = chebyshev.chebadd(chebyshev.chebmul(damping, slope), -(1 + level) * lag * real)
    excess: Float64[np.ndarray, " term"]
    excess = chebyshev.chebadd(series, (delta - level * lag * gamma) * square)
    return excess


def _sine_ratio(power: int, terms: int) -> Float64[np.ndarray, " terms"]:
    """Return sin(power theta) / sin(theta) as a cosine series."""
    ratio = np.zeros(terms)
    ratio[power - 1 :: -2] = 2.0 if power else 0.0
    ratio[0] /= 2.0
    return ratio


def _loop(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> tuple[Array, Array, Array, Array, Array]:
    """Return the checked parameters as float64 arrays, with the effective delay for the delay."""
    checked = (
        checked_gain("alpha", alpha),
        checked_gain("beta", beta),
        checked_gamma(gamma),
        checked_delta(delta),
        checked_delay(delay) + 0.5,
    )
    alpha, beta, gamma, delta, lag = (jnp.asarray(value, jnp.float64) for value in checked)
    return alpha, beta, gamma, delta, lag
