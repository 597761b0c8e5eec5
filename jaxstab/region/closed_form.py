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

It is for the wall of the paper, of any number of slices at once, and under JAX. Regions are found
by the curve of any loop (``region.curve``).
"""

from math import factorial, pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import (
    PI_REST,
    Array,
    Numbers,
    constant,
    float_arrays,
    is_traced,
    kept,
    namespace,
)
from jaxstab.batches import MANY_ANGLES, compiled
from jaxstab.model import checked_delta, checked_gamma, require_x64
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.parameters import whole_and_fraction
from jaxstab.model.plant import PlantCoefficients, plant_pairs
from jaxstab.numbers import checked

# sin(x) / x and cos(x) as series in x^2, for all x up to pi/4 and derivatives, too.
_SINC = tuple((-1.0) ** k / factorial(2 * k + 1) for k in range(10))
_COSINE = tuple((-1.0) ** k / factorial(2 * k) for k in range(10))


def sines(x: Array) -> tuple[Array, Array, Array]:
    """Return sin(x), cos(x) and sin(x) / x for x >= 0, with derivatives to full precision.

    A quotient would lose digits of the derivative of sin(x) / x next to 0; a series is used there.
    XLA makes vectors of this, and not of calls of sin and cos; most of the run time is here.
    """
    # A quarter turn in parts of 27 bits: multiples of the first two are exact.
    quarter_turn = (1.570796325802803, 9.920935739593517e-10, 5.721188726109832e-18)
    xp = namespace(x)
    quarters = constant(xp.round(x * (2.0 / pi)))
    reduced = x
    for digits in quarter_turn:
        reduced = reduced - quarters * digits
    sine, cosine, sinc = _sines_of_small(reduced)
    odd = quarters % 2.0 == 1.0
    sine, cosine = xp.where(odd, cosine, sine), xp.where(odd, -sine, cosine)
    sign = xp.where(quarters % 4.0 >= 2.0, -1.0, 1.0)
    sine, cosine = sign * sine, sign * cosine
    is_small = quarters == 0.0
    return sine, cosine, xp.where(is_small, sinc, sine / xp.where(is_small, 1.0, x))


def _sines_of_small(x: Array) -> tuple[Array, Array, Array]:
    """Return the same for x up to pi/4."""
    square = x**2
    sinc = _series(_SINC, square)
    return x * sinc, _series(_COSINE, square), sinc


def _series(coefficients: tuple[float, ...], x: Array) -> Array:
    total: Array = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = coefficient + x * total
    return total


class SliceCoefficients(NamedTuple):
    """The coefficients of the boundary in one (alpha, beta) plane; arrays of the slice's shape.

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

    @property
    def plus_line(self) -> tuple[Array, Array]:
        """Offset and slope: walls with a root at z = r have alpha = offset - slope beta."""
        return 0.0 - self.gain * self.ratio, (self.radius - 1.0) / self.radius  # not the number -0

    @property
    def minus_line(self) -> tuple[Array, Array]:
        """The same of a root at z = -r; infinite where N(-r) = 0."""
        offset = -self.gain * self.den_minus / (parity(self) * self.num_minus)
        return offset, (self.radius + 1.0) / self.radius


def boundary_curve(
    theta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers, radius: Numbers = 1.0
) -> tuple[Float64[Array, "*grid"], Float64[Array, "*grid"]]:
    """Return the wall gains (alpha, beta) that put a pair of roots at radius exp(+-i theta).

    Seen in the direction of growing theta, the pair is inside the circle on the left side.

    Args:
        theta: angle of the roots in [0, pi]; like all arguments it broadcasts. At 0 and pi the
            result is the limit of the curve, a point of the line of a real root there; it is
            infinite at pi where N(-radius) = 0 (delta = 0 and a whole delay).
        gamma, delta, delay: see ``jaxstab.conventions``.
        radius: modulus of the roots in (0, 1]; 1 is the limit of stability, a smaller one the limit
            of a decay rate.

    Returns:
        alpha = K T^2/m and beta = B T/m, of the broadcast shape. Differentiable in every argument
        but the whole part of the delay.

    Raises: see ``jaxstab.conventions``.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) solved for (alpha, beta).

    Example:
        >>> alpha, beta = jaxstab.boundary_curve(1.0, gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(alpha), 6), round(float(beta), 6)
        (0.645005, 0.596893)
    """
    require_x64(theta, gamma, delta, radius)
    angle = float_arrays(checked("theta", theta, 0.0, pi))[0]
    return curve_point(slice_coefficients(gamma, delta, delay, radius), angle)


def slice_coefficients(
    gamma: Numbers, delta: Numbers, delay: Numbers, radius: Numbers = 1.0
) -> SliceCoefficients:
    """Return the coefficients of the boundary for slices of any shape; the delay may be traced.

    Each value is formed in double-double. Raises: see ``jaxstab.conventions``. Source: eq. (9).
    """
    if is_traced(delay):
        whole = namespace(delay).floor(delay)
        fraction = delay - whole
    else:
        whole, fraction = whole_and_fraction(delay)
    plant = plant_pairs(checked_gamma(gamma), checked_delta(delta), fraction)
    size = checked("radius", radius, 0.0, 1.0, is_open=True)
    gamma, size, turns = float_arrays(gamma, size, whole + 1.0)
    return _slice_coefficients(gamma, size, turns, plant)


@compiled(many=MANY_ANGLES)
def _slice_coefficients(
    gamma: Array, radius: Array, turns: Array, plant: PlantCoefficients
) -> SliceCoefficients:
    xp = namespace(gamma, radius, turns, plant)
    r = DoubleDouble.from_value(radius)
    inner = r - 1.0
    # Around z = 1 and z = -1, where the plant's values are known to all digits.
    den_plus = inner * inner + inner * (plant.d1 + 2.0) + plant.den_at_one
    num_plus = inner * inner * plant.n2 + inner * (plant.n2.scaled(2.0) + plant.n1) + plant.sum
    den_minus = r * r - r * plant.d1 + plant.d0
    num_minus = (
        inner * inner * plant.n2 + inner * (plant.n2.scaled(2.0) - plant.n1) + plant.difference
    )
    vanishing = abs(num_plus.hi) < np.finfo(np.float64).tiny
    ratio = den_plus.rounded() / xp.where(vanishing, xp.inf, num_plus.rounded())
    return SliceCoefficients(
        radius=radius,
        turns=turns,
        gain=radius**turns,
        ratio=xp.where(radius == 1.0, gamma, ratio),
        kappa=(r + plant.d0 / r).rounded(),
        eps=(r - plant.d0 / r).rounded(),
        sigma=(r * plant.n2 + plant.n0 / r).rounded(),
        nu=(r * plant.n2 - plant.n0 / r).rounded(),
        den_plus=(den_plus / r).rounded(),
        den_minus=(den_minus / r).rounded(),
        num_plus=(num_plus / r).rounded(),
        num_minus=(num_minus / r).rounded(),
    )


def parity(c: SliceCoefficients) -> Array:
    """Return (-1)^m."""
    return 1.0 - 2.0 * (c.turns % 2.0)


@compiled(many=MANY_ANGLES)
def curve_point(c: SliceCoefficients, theta: Array) -> tuple[Array, Array]:
    """Return (alpha, beta) of the curve at angles in [0, pi] that broadcast with the slices."""
    vanishing = 1e-3  # of the terms of N(r): below, alpha is not computed from the line z = r
    xp = namespace(c, theta)
    upper = theta > pi / 2
    # XLA would otherwise add the two parts of pi first.
    folded = xp.where(upper, kept(pi - theta) + PI_REST, theta)
    circle = _circle(c.turns, 0.5 * folded)
    real, slope, scale = _quotient(c, upper, circle)

    sign = xp.where(upper, parity(c), 1.0)
    swing = circle.sine_ratio * real - circle.cosine * slope
    beta = xp.where(upper, sign, -1.0) * (scale * c.radius * swing)
    h = xp.where(upper, circle.far, circle.near)  # 1 - cos(theta)
    turned = circle.cosine * real + circle.sine_ratio * circle.sine_square * slope
    offset, plus_slope = c.plus_line
    direct = -beta * (plus_slope + h / c.radius) - sign * (scale * turned)
    lift = -beta / c.radius + scale * (
        circle.lag_ratio * real
        - circle.far * (c.nu * (c.eps - c.ratio * c.nu) + circle.sine_ratio * slope)
        - (c.num_plus - c.sigma * circle.near) * (c.ratio * c.sigma - c.kappa)
    )
    vanishes = abs(c.num_plus) < vanishing * (abs(c.sigma) + abs(c.nu))
    return xp.where(upper | vanishes, direct, offset - plus_slope * beta + h * lift), beta


class _Circle(NamedTuple):
    """Functions of an angle u = 2 half in [0, pi/2].

    ``near`` and ``far`` are 1 - cos u and 1 + cos u, ``cosine`` is cos(m u), ``sine_ratio`` is
    sin(m u) / sin(u) and ``lag_ratio`` (1 - cos(m u)) / (1 - cos u).
    """

    near: Array
    far: Array
    sine_square: Array
    cosine: Array
    sine_ratio: Array
    lag_ratio: Array


def _circle(turns: Array, half: Array) -> _Circle:
    sine, cosine, sinc = zip(_sines_of_small(half), sines(turns * half), strict=True)
    near, far = 2.0 * sine[0] ** 2, 2.0 * cosine[0] ** 2
    half_ratio = turns * sinc[1] / sinc[0]
    return _Circle(
        near=near,
        far=far,
        sine_square=near * far,
        cosine=(cosine[1] - sine[1]) * (cosine[1] + sine[1]),
        sine_ratio=half_ratio * cosine[1] / cosine[0],
        lag_ratio=half_ratio**2,
    )


def _quotient(c: SliceCoefficients, upper: Array, circle: _Circle) -> tuple[Array, Array, Array]:
    """Return D/N times (-z)^(m - 1) r^m as scale (real + i slope sin u), by the folded angle u.

    Where the angle is folded, d and q have the other sign; their products have not.
    """
    xp = namespace(c, circle)
    d = c.kappa * circle.near - xp.where(upper, c.den_minus, c.den_plus)
    q = c.sigma * circle.near - xp.where(upper, c.num_minus, c.num_plus)
    real = d * q + c.eps * c.nu * circle.sine_square
    scale = c.gain / (q**2 + c.nu**2 * circle.sine_square)
    return real, c.eps * q - c.nu * d, scale
