"""The closed loop's poles and spectral radius, by companion eigenvalues or without them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Complex128, Float64, Int8

from jaxstab.conventions import RadiusStatus, Verdict
from jaxstab.model import (
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    companion_matrix,
    require_x64,
)
from jaxstab.point.grid import looked_up, over_grid
from jaxstab.point.radius.fast_radius import TOLERANCE, fast_radius
from jaxstab.point.verdict.door import radius_error, verdict
from jaxstab.point.verdict.loop import is_plant_lost

_HUGE = 2.0**400
# Strongly damped plants have coefficients of N far below its size, which do not have all their
# digits; what is lost beside 1, divided by powers of a small radius, is more than a rounding.
_DAMPED, _SMALL_RADIUS = 10.0, 0.5


class SpectralRadius(NamedTuple):
    """The largest modulus of a root of p(z), how wrong it may be, and how that is known."""

    value: Float64[Array, "*grid"]
    error: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]


def closed_loop_poles(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> Complex128[Array, "*grid degree"]:
    """Return the poles of the closed loop, the eigenvalues of the companion matrix of p(z).

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, concrete.

    Returns:
        Array of shape (*grid, degree), the largest modulus first. For an array of delays, a loop of
        a lower degree has zeros at the end.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        TypeError: the delay is traced.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9); each pole is an exact root of a polynomial within a few ulp of p(z) (backward
    error), so a root of multiplicity k is only good to about ulp^(1/k).
    """
    require_x64()
    poles: Array = over_grid(_poles, alpha, beta, gamma, delta, delay)
    return poles


def spectral_radius(
    alpha: ArrayLike,
    beta: ArrayLike,
    gamma: ArrayLike,
    delta: ArrayLike,
    delay: ArrayLike,
    *,
    method: str = "fast",
) -> SpectralRadius:
    """Return the largest modulus of a closed-loop pole with a proved error bound.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, concrete.
        method: "fast" finds and proves the dominant root without eigenvalues and leaves only the
            points where that fails, and delays above 64, to the companion matrix; "companion" takes
            it for all. Inside jit, vmap and grad it is always the companion matrix.

    Returns:
        SpectralRadius of arrays of the broadcast shape: ``value``; ``error``, proved: all roots are
        inside value + error, not all inside value - error; ``status``, a RadiusStatus: NO_BOUND
        also next to gamma = (2 pi k)^2 with next to no damping, where N(z) nearly vanishes, and for
        radii below 0.5 at delta above 10, where not all digits of N(z) are known. The derivative of
        ``value`` is that of the dominant root by the implicit function theorem; it is infinite or
        NaN where that root is multiple.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN, or the method is
            unknown.
        TypeError: the delay is traced.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9); sec. V of the paper for its use.
    """
    require_x64()
    if method not in ("fast", "companion"):
        raise ValueError(f'method is {method!r}; give "fast" or "companion".')
    arguments = alpha, beta, gamma, delta, delay
    is_traced = any(isinstance(value, jax.core.Tracer) for value in arguments)
    if method == "fast" and not is_traced:
        radius = _fast_radius(*arguments)
    else:
        radius = over_grid(_radius, *arguments)
    believed: SpectralRadius = _believed(radius, jnp.asarray(gamma), jnp.asarray(delta))
    return believed


def is_stable(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> Bool[Array, "*grid"]:
    """Return True where all poles are proved to lie inside the unit circle.

    False where the loop is unstable, marginal, or closer to the boundary than float64 can decide:
    ``verdict`` tells these apart.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, concrete.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        TypeError: the delay is traced.
        RuntimeError: JAX's x64 mode is off.

    Source: sec. V of the paper.
    """
    stable: Array = verdict(alpha, beta, gamma, delta, delay) == Verdict.STABLE
    return stable


@jax.jit
def _poles(coefficients: Float64[Array, "*grid coefficient"]) -> Complex128[Array, "*grid degree"]:
    order_of = jnp.arange(coefficients.shape[-1])
    unit = _unit(coefficients)[..., None]
    scaled = companion_matrix(coefficients / unit**order_of)
    poles = unit * jnp.linalg.eigvals(scaled)
    order = jnp.argsort(-jnp.abs(poles), axis=-1)
    return jnp.take_along_axis(poles, order, axis=-1)


def _unit(coefficients: Float64[Array, "*grid coefficient"]) -> Float64[Array, "*grid"]:
    """Return what to measure roots in: 1, but of huge coefficients about the largest root.

    Some builds of LAPACK lose the scale of matrices above 1e138.
    """
    sizes = jnp.abs(coefficients[..., 1:])
    exponents = jnp.log2(sizes) / jnp.arange(1, coefficients.shape[-1])
    largest = jnp.exp2(jnp.floor(jnp.max(exponents, axis=-1)))
    return jnp.where(jnp.max(sizes, axis=-1) > _HUGE, largest, 1.0)


def _fast_radius(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> SpectralRadius:
    arguments = [
        np.asarray(value, np.float64)
        for value in (
            checked_gain("alpha", alpha),
            checked_gain("beta", beta),
            checked_gamma(gamma),
            checked_delta(delta),
            checked_delay(delay),
        )
    ]
    value, error = fast_radius(arguments[:4], arguments[4])
    left = np.flatnonzero(~(error <= TOLERANCE))
    if left.size:
        exact = over_grid(_radius, *looked_up(arguments, value.shape, left))
        # In NumPy: as many points as are left would have JAX compile for each such number.
        exact_value, exact_error = np.asarray(exact.value), np.asarray(exact.error)
        closer = ~(exact_error >= error.flat[left])
        value.flat[left[closer]] = exact_value[closer]
        error.flat[left[closer]] = exact_error[closer]
    status = np.where(
        np.isfinite(error), np.int8(RadiusStatus.PROVED), np.int8(RadiusStatus.NO_BOUND)
    )
    return SpectralRadius(*map(jnp.asarray, (value, error, status)))


@jax.jit
def _believed(radius: SpectralRadius, gamma: Array, delta: Array) -> SpectralRadius:
    """Take back the bounds where the plant is not known to an ulp."""
    is_lost = is_plant_lost(gamma, delta) | ((delta > _DAMPED) & (radius.value < _SMALL_RADIUS))
    error = jnp.where(is_lost, jnp.inf, radius.error)
    return SpectralRadius(
        radius.value,
        error,
        jnp.where(is_lost, np.int8(RadiusStatus.NO_BOUND), radius.status),
    )


@jax.jit
def _radius(coefficients: Float64[Array, "*grid coefficient"]) -> SpectralRadius:
    value = _largest_modulus(coefficients)
    error = radius_error(*jax.lax.stop_gradient((coefficients, value)))
    status = jnp.where(jnp.isfinite(error), RadiusStatus.PROVED, RadiusStatus.NO_BOUND)
    return SpectralRadius(value, error, status.astype(jnp.int8))


@jax.custom_jvp
def _largest_modulus(
    coefficients: Float64[Array, "*grid coefficient"],
) -> Float64[Array, "*grid"]:
    return jnp.abs(_poles(coefficients)[..., 0])


@_largest_modulus.defjvp
def _largest_modulus_jvp(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[Float64[Array, "*grid"], Float64[Array, "*grid"]]:
    """Differentiate p(z) = 0 at the dominant root: eigvals has no derivative at double roots."""
    (coefficients,), (change,) = primals, tangents
    degree = coefficients.shape[-1] - 1
    root = _poles(coefficients)[..., 0]
    slope = _evaluated(coefficients[..., :-1] * jnp.arange(degree, 0, -1), root)
    motion = -_evaluated(change, root) / slope
    modulus = jnp.abs(root)
    return modulus, (root.conj() * motion).real / modulus


def _evaluated(
    coefficients: Float64[Array, "*grid coefficient"], z: Complex128[Array, "*grid"]
) -> Complex128[Array, "*grid"]:
    value = jnp.zeros_like(z)
    for power in range(coefficients.shape[-1]):
        value = value * z + coefficients[..., power]
    return value
