"""The closed form of the boundary: where a pair of roots, or a real root, lies at a given radius.

p(z) is affine in (alpha, beta), so p(z) = 0 reads alpha + beta (1 - 1/z) = w(z) with
w = -z^m D(z)/N(z), m = floor(delay) + 1 (the D-decomposition of Gryazina, Polyak, Tremba 2008).
With h = 1 - cos th, at z = r e^(i th),

    D/z = d + i eps sin th,     d  = D(r)/r - kappa h = kappa (2 - h) - D(-r)/r
    N/z = q + i nu  sin th,     q  = N(r)/r - sigma h = sigma (2 - h) - N(-r)/r

    kappa = r + d0/r,  eps = r - d0/r,  sigma = n2 r + n0/r,  nu = n2 r - n0/r,

so everything is real arithmetic, and each half of the circle has a basis without cancellation:
z = r for th < pi/2 and z = -r for th > pi/2. For th < pi/2 alpha is the line z = r plus terms that
all carry the factor h, divided out by hand.
"""

from math import factorial, pi
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from jaxtyping import Float64

from jaxstab.arrays import PI_REST
from jaxstab.model import checked_delay, checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.plant import PlantPairs, plant_pairs

_TERMS = 10  # of sine and cosine up to pi/4: the next one is below 2^-60, of derivatives too
# A quarter turn in parts of 27 bits: multiples of the first two are exact.
_QUARTER_TURN = (1.570796325802803, 9.920935739593517e-10, 5.721188726109832e-18)
_CLOSE, _FAR = 1e-9, 4.0  # of the distance of a pole from the circle: closer is as close
_VANISHING = 1e-3  # N(r) this small beside its terms: the line z = r is no anchor any more


class SliceCoefficients(NamedTuple):
    """What the boundary in one (alpha, beta) plane is made of; arrays of the slice's shape.

    ``radius`` is r, ``turns`` is m, ``gain`` is r^m; ``ratio`` is D(r)/N(r), which is gamma for
    r = 1; ``den_plus`` is D(r)/r and ``den_minus`` is D(-r)/r, likewise for the numerator N.
    """

    radius: Array
    turns: Array
    gain: Array
    ratio: Array
    kappa: Array
    eps: Array
    sigma: Array
    nu: Array
    den_plus: Array
    den_minus: Array
    num_plus: Array
    num_minus: Array


def boundary_curve(
    theta: ArrayLike,
    gamma: ArrayLike,
    delta: ArrayLike,
    delay: ArrayLike,
    radius: ArrayLike = 1.0,
) -> tuple[Float64[Array, "*grid"], Float64[Array, "*grid"]]:
    """Return the wall gains (alpha, beta) that put a pair of roots at radius exp(+-i theta).

    In the direction of growing theta, the side on the left has the pair inside of the circle.

    Args:
        theta: angle of the roots in [0, pi]; like all arguments it broadcasts. At 0 and pi the
            result is the limit of the curve, a point of the line of a real root there; it is
            infinite at pi where N(-radius) = 0 (delta = 0 and a whole delay).
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.
        radius: modulus of the roots in (0, 1]; 1 is the limit of stability, a smaller one the limit
            of a decay rate.

    Returns:
        alpha = K T^2/m and beta = B T/m, of the broadcast shape. Differentiable in every argument
        but the whole part of the delay.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) solved for (alpha, beta).
    """
    require_x64()
    angle = jnp.asarray(_checked_interval("theta", theta, 0.0, pi), jnp.float64)
    alpha, beta = curve_point(slice_coefficients(gamma, delta, delay, radius), angle)
    return alpha, beta


def plus_line(
    beta: ArrayLike,
    gamma: ArrayLike,
    delta: ArrayLike,
    delay: ArrayLike,
    radius: ArrayLike = 1.0,
) -> Float64[Array, "*grid"]:
    """Return the alpha that puts a real root at z = +radius; for radius 1 it is -gamma.

    Args:
        beta: wall damping B T/m, any shape; like all arguments it broadcasts.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.
        radius: modulus of the root in (0, 1].

    Returns:
        alpha of the broadcast shape; infinite where N(radius) = 0.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) at z = radius.
    """
    require_x64()
    coefficients = slice_coefficients(gamma, delta, delay, radius)
    damping = jnp.asarray(checked_gain("beta", beta), jnp.float64)
    return plus_offset(coefficients) - damping * plus_slope(coefficients)


def minus_line(
    beta: ArrayLike,
    gamma: ArrayLike,
    delta: ArrayLike,
    delay: ArrayLike,
    radius: ArrayLike = 1.0,
) -> Float64[Array, "*grid"]:
    """Return the alpha that puts a real root at z = -radius.

    Args:
        beta: wall damping B T/m, any shape; like all arguments it broadcasts.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.
        radius: modulus of the root in (0, 1].

    Returns:
        alpha of the broadcast shape; infinite where N(-radius) = 0 (delta = 0 and a whole delay).

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) at z = -radius.
    """
    require_x64()
    coefficients = slice_coefficients(gamma, delta, delay, radius)
    damping = jnp.asarray(checked_gain("beta", beta), jnp.float64)
    return minus_offset(coefficients) - damping * minus_slope(coefficients)


def slice_coefficients(
    gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike, radius: ArrayLike = 1.0
) -> SliceCoefficients:
    """Return the coefficients of the boundary for slices of any shape; the delay may be traced.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008); each value is formed in double-double.
    """
    if not isinstance(delay, jax.core.Tracer):
        delay = checked_delay(delay)
    whole = jnp.floor(delay) if isinstance(delay, jax.core.Tracer) else np.floor(delay)
    plant_values = plant_pairs(checked_gamma(gamma), checked_delta(delta), delay - whole)
    coefficients: SliceCoefficients = _slice_coefficients(
        jnp.asarray(gamma, jnp.float64),
        jnp.asarray(_checked_interval("radius", radius, np.nextafter(0.0, 1.0), 1.0), jnp.float64),
        jnp.asarray(whole + 1.0),
        plant_values,
    )
    return coefficients


@jax.jit
def _slice_coefficients(
    gamma: Array, radius: Array, turns: Array, plant: PlantPairs
) -> SliceCoefficients:
    r = DoubleDouble.of(radius)
    inner = r - 1.0
    # Around z = 1 and z = -1, where the plant coefficients have digits of their own.
    den_plus = inner * inner + inner * (plant.d1 + 2.0) + plant.den_at_one
    num_plus = inner * inner * plant.n2 + inner * (plant.n2.scaled(2.0) + plant.n1) + plant.sum
    den_minus = r * r - r * plant.d1 + plant.d0
    num_minus = (
        inner * inner * plant.n2 + inner * (plant.n2.scaled(2.0) - plant.n1) + plant.difference
    )
    vanishing = jnp.abs(num_plus.hi) < np.finfo(np.float64).tiny
    return SliceCoefficients(
        radius=radius,
        turns=turns,
        gain=radius**turns,
        ratio=jnp.where(
            radius == 1.0,
            gamma,
            den_plus.rounded() / jnp.where(vanishing, jnp.inf, num_plus.rounded()),
        ),
        kappa=(r + plant.d0 / r).rounded(),
        eps=(r - plant.d0 / r).rounded(),
        sigma=(r * plant.n2 + plant.n0 / r).rounded(),
        nu=(r * plant.n2 - plant.n0 / r).rounded(),
        den_plus=(den_plus / r).rounded(),
        den_minus=(den_minus / r).rounded(),
        num_plus=(num_plus / r).rounded(),
        num_minus=(num_minus / r).rounded(),
    )


def plus_offset(c: SliceCoefficients) -> Array:
    """Return w(r): the line z = r is alpha + plus_slope beta = w(r)."""
    return -c.gain * c.ratio


def plus_slope(c: SliceCoefficients) -> Array:
    """Return 1 - 1/r."""
    return (c.radius - 1.0) / c.radius


def minus_offset(c: SliceCoefficients) -> Array:
    """Return w(-r): the line z = -r is alpha + minus_slope beta = w(-r)."""
    return -_sign(c.turns) * c.gain * c.den_minus / c.num_minus


def minus_slope(c: SliceCoefficients) -> Array:
    """Return 1 + 1/r."""
    return (c.radius + 1.0) / c.radius


def poles(c: SliceCoefficients) -> tuple[Array, Array]:
    """Return the angles of the two zeros of N, in [0, pi], and how far they are from the circle.

    There the curve flies off: close to a zero it changes in steps as short as the distance, which
    is the modulus of the logarithm of |z| / r.
    """
    first, last = 0.5 * (c.sigma + c.nu), 0.5 * (c.sigma - c.nu)
    middle = c.num_plus - c.sigma
    square = middle**2 - 4.0 * first * last
    root = jnp.sqrt(jnp.abs(square))
    larger = -0.5 * (middle + jnp.where(middle < 0.0, -root, root))
    real = jnp.stack([larger / first, last / larger])
    turned = jnp.arctan2(root, -middle * jnp.sign(first))
    angles = jnp.where(square < 0.0, turned, jnp.where(real < 0.0, pi, 0.0))
    modulus = jnp.where(square < 0.0, jnp.sqrt(jnp.abs(last / first)), jnp.abs(real))
    apart = jnp.abs(jnp.log(modulus))
    return angles, jnp.clip(jnp.nan_to_num(apart, nan=_FAR), _CLOSE, _FAR)


def curve_point(c: SliceCoefficients, theta: Array, low: ArrayLike = 0.0) -> tuple[Array, Array]:
    """Return (alpha, beta) of the curve at angles in [0, pi] that broadcast with the slices.

    ``low`` is what rounding took from theta: close to pi it holds digits of pi - theta.
    """
    alpha, beta, _ = curve_and_lift(c, theta, low)
    return alpha, beta


@jax.jit
def curve_and_lift(
    c: SliceCoefficients, theta: Array, low: ArrayLike = 0.0
) -> tuple[Array, Array, Array]:
    """Return alpha, beta and (alpha + plus_slope beta - w(r)) / (1 - cos th).

    The third value vanishes where the curve crosses the line z = r, but not where it starts on it.
    """
    upper = theta > pi / 2
    # Without the barrier XLA would add the two parts of pi first.
    from_pi = lax.optimization_barrier(pi - theta) + (PI_REST - low)
    folded = jnp.where(upper, from_pi, theta + low)
    half = 0.5 * folded
    half_sine, half_cosine = half * _sinc(half**2), _cosine(half**2)
    near, far = 2.0 * half_sine**2, 2.0 * half_cosine**2
    cos_turns, sine_ratio, lag_ratio = _turning(c.turns, upper, half, half_cosine)

    h, rest = jnp.where(upper, far, near), jnp.where(upper, near, far)  # 1 -+ cos(theta)
    sine_square = near * far
    d = jnp.where(upper, c.kappa * rest - c.den_minus, c.den_plus - c.kappa * h)
    q = jnp.where(upper, c.sigma * rest - c.num_minus, c.num_plus - c.sigma * h)
    # (d + i eps sin)(q - i nu sin) / |q + i nu sin|^2 = real + i slope sin
    scale = c.gain / (q**2 + c.nu**2 * sine_square)
    real = d * q + c.eps * c.nu * sine_square
    slope = c.eps * q - c.nu * d
    beta = -scale * c.radius * (sine_ratio * real + cos_turns * slope)

    line = plus_offset(c) - plus_slope(c) * beta
    lift = -beta / c.radius + scale * (
        q * (c.kappa - c.ratio * c.sigma)
        + rest * (c.nu * (c.ratio * c.nu - c.eps) + sine_ratio * slope)
        + lag_ratio * real
    )
    direct = -beta * (plus_slope(c) + h / c.radius) - scale * (
        cos_turns * real - sine_ratio * sine_square * slope
    )
    lost = jnp.abs(c.num_plus) < _VANISHING * (jnp.abs(c.sigma) + jnp.abs(c.nu))
    away = upper | lost
    alpha = jnp.where(away, direct, line + h * lift)
    return alpha, beta, jnp.where(away, (direct - line) / jnp.where(away, h, 1.0), lift)


def _turning(
    turns: Array, upper: Array, half: Array, half_cosine: Array
) -> tuple[Array, Array, Array]:
    """Return cos(m th), sin(m th) / sin(th) and (1 - cos(m th)) / (1 - cos th)."""
    phase = turns * half
    s, c, sinc = _sine_cosine_sinc(phase)
    half_ratio = turns * sinc / _sinc(half**2)
    lag = jnp.where(turns % 2.0 == 1.0, c, s)
    lag_ratio = jnp.where(upper, lag / half_cosine, half_ratio) ** 2
    sign = jnp.where(upper, _sign(turns), 1.0)
    sine_ratio = jnp.where(upper, -sign, 1.0) * half_ratio * c / half_cosine
    return sign * (c - s) * (c + s), sine_ratio, lag_ratio


def _sine_cosine_sinc(x: Array) -> tuple[Array, Array, Array]:
    """Return sin(x), cos(x) and sin(x) / x for x >= 0, also at 0.

    The compiler makes vectors of this, and not of calls of sin and cos: most of the run time.
    """
    quarters = lax.stop_gradient(jnp.round(x * (2.0 / pi)))
    rest = x
    for part in _QUARTER_TURN:
        rest = rest - quarters * part
    square = rest**2
    sinc = _sinc(square)
    sine, cosine = rest * sinc, _cosine(square)
    odd = quarters % 2.0 == 1.0
    sine, cosine = jnp.where(odd, cosine, sine), jnp.where(odd, -sine, cosine)
    sign = jnp.where(quarters % 4.0 >= 2.0, -1.0, 1.0)
    sine, cosine = sign * sine, sign * cosine
    first = quarters == 0.0
    return sine, cosine, jnp.where(first, sinc, sine / jnp.where(first, 1.0, x))


def _sinc(square: Array) -> Array:
    """Return sin(x) / x for x^2 up to (pi/4)^2, with derivatives that do not cancel."""
    return _alternating(square, 1)


def _cosine(square: Array) -> Array:
    """Return cos(x) for x^2 up to (pi/4)^2."""
    return _alternating(square, 0)


def _alternating(square: Array, shift: int) -> Array:
    series = jnp.zeros_like(square)
    for k in reversed(range(_TERMS)):
        series = (-1.0) ** k / factorial(2 * k + shift) + square * series
    return series


def _sign(turns: Array) -> Array:
    return 1.0 - 2.0 * (turns % 2.0)


def _checked_interval(name: str, value: ArrayLike, lower: float, upper: float) -> ArrayLike:
    if isinstance(value, jax.core.Tracer):
        return value
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "iuf":
        raise TypeError(f"{name} is {value!r}; give real numbers.")
    wrong = ~((numbers >= lower) & (numbers <= upper))
    if np.any(wrong):
        culprit = float(numbers[wrong].flat[0])
        allowed = "in (0, 1]" if name == "radius" else f"from {lower:g} to {upper!r}"
        raise ValueError(f"{name} is {culprit}; give numbers {allowed}.")
    return value
