"""The boundary of one mass: where a pair of roots, or a real root, lies at a given radius.

p(z) is affine in (alpha, beta), so p(z) = 0 reads alpha + beta (1 - 1/z) = w(z) with
w = -z^m D(z)/N(z), m = floor(delay) + 1 (the D-decomposition of Gryazina, Polyak, Tremba 2008).
With h = 1 - cos th, at z = r e^(i th),

    D/z = d + i eps sin th,     d  = D(r)/r - kappa h = kappa (2 - h) - D(-r)/r
    N/z = q + i nu  sin th,     q  = N(r)/r - sigma h = sigma (2 - h) - N(-r)/r

    kappa = r + d0/r,  eps = r - d0/r,  sigma = n2 r + n0/r,  nu = n2 r - n0/r,

so everything is real arithmetic, and each half of the circle has a basis without cancellation:
z = r for th < pi/2 and z = -r for th > pi/2.

It is for the wall of the paper, of any number of slices at once, and under JAX; equations for a
root on the unit circle follow, with estimators and filters. Regions are found by the curve of any
loop (``region.curve``).
"""

from collections.abc import Iterable
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
    repeat,
)
from jaxstab.batches import MANY_ANGLES, compiled
from jaxstab.model import checked_delta, checked_gamma
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filters
from jaxstab.model.plant import PlantCoefficients, plant_pairs, whole_and_fraction
from jaxstab.numbers import checked, require_together

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
    require_together(theta=theta, gamma=gamma, delta=delta, delay=delay, radius=radius)
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
    xp = namespace(c, theta)
    upper = theta > pi / 2
    # XLA would otherwise add the two parts of pi first.
    half = 0.5 * xp.where(upper, kept(pi - theta) + PI_REST, theta)
    sine, cosine, sinc = zip(_sines_of_small(half), sines(c.turns * half), strict=True)
    near, far = 2.0 * sine[0] ** 2, 2.0 * cosine[0] ** 2
    square = near * far
    sign = xp.where(upper, parity(c), 1.0)
    ratio = (c.turns * sinc[1] * cosine[1]) / (sinc[0] * cosine[0])
    turn = (
        sign * (cosine[1] - sine[1]) * (cosine[1] + sine[1]),
        xp.where(upper, -sign, sign) * ratio,
    )
    d = _real_part(upper, near, c.den_plus, c.den_minus, c.kappa)
    q = _real_part(upper, near, c.num_plus, c.num_minus, c.sigma)
    real, slope = _product(turn, _product((d, c.eps), (q, -c.nu), square), square)
    scale = -c.gain / (q**2 + c.nu**2 * square)
    beta = scale * slope * c.radius
    return scale * real - beta * (c.plus_line[1] + xp.where(upper, far, near) / c.radius), beta


def _real_part(upper: Array, near: Array, at_plus: Array, at_minus: Array, slope: Array) -> Array:
    """Return d or q by 1 - cos of the angle from the nearer end, from the values at both ends."""
    return namespace(near).where(upper, slope * near - at_minus, at_plus - slope * near)


# The two equations of a root on the unit circle, with any estimator and filter:
#
#     g = D/z + z^-m (N/z) H,      H = alpha P + beta V,
#
# P = 1 and V = 1 - 1/z without filters; then g = p(z) / z^(m + 2). ``quick_plant`` computes D and N
# by a Taylor series of the step response and doublings of its time, ``Responses`` has P and V as
# numbers that a compiled program takes. Nothing here is a bound: searches and derivatives start
# from it.

OverSine = tuple[Array, Array]  # Re f and Im f / sin(theta) of a real function f at e^(i theta)


class Responses(NamedTuple):
    """P and V as numbers that a compiled program takes: V is (1 - z^-n) / n times its chain.

    They are JAX's where JAX traces the filters.

    chains: of P and of V, its stages, each a numerator and a denominator in powers of 1/z, lowest
        power first. Stages and coefficients are filled up to powers of two: few shapes.
    """

    samples: Float64[Array, ""]
    chains: Float64[Array, "2 stage 2 power"]

    @classmethod
    def from_filters(cls, filters: Filters | None) -> "Responses":
        """Return the responses of filters in units of one sample; None has no stages."""
        if filters is None:
            return cls(np.array(1.0), np.zeros((2, 0, 2, 1)))
        velocity, position = filters
        samples, stages = velocity.stages()
        both = position.stages(), stages
        longest = max([4, *(len(side) for chain in both for stage in chain for side in stage)])
        count = _power_of_two(max(2, *map(len, both))) if any(both) else 0
        power = _power_of_two(longest)

        def filled(side: tuple[Array, ...]) -> list[Array]:
            return [*side, *[0.0] * (power - len(side))]

        unit = (1.0,), (1.0,)
        rows = [
            [[filled(side) for side in stage] for stage in (*chain, *[unit] * (count - len(chain)))]
            for chain in both
        ]
        chains = namespace(filters).asarray(rows).reshape(2, count, 2, power)
        return cls(np.array(float(samples)), chains)

    def over_sine(self, theta: Array) -> tuple[OverSine, OverSine]:
        """Return P and V at z = e^(i theta), smooth in theta at 0 and pi."""
        xp = namespace(self, theta)
        versine = 2.0 * xp.sin(0.5 * self.samples * theta) ** 2
        ratio = turns_over_sine(self.samples, theta)[1]
        position = xp.ones_like(theta), xp.zeros_like(theta)
        velocity = versine / self.samples, ratio / self.samples
        if not self.chains.shape[1]:
            return position, velocity
        square = xp.sin(theta) ** 2
        cosines, ratios = turns_over_sine(xp.arange(self.chains.shape[-1]), theta[..., None])

        def through(value: OverSine, chain: Array) -> OverSine:
            for above, below in chain:
                numerator, denominator = ((cosines @ p, -(ratios @ p)) for p in (above, below))
                size = denominator[0] ** 2 + square * denominator[1] ** 2
                conjugate = denominator[0], -denominator[1]
                value = _product(_product(value, numerator, square), conjugate, square)
                value = value[0] / size, value[1] / size
            return value

        return through(position, self.chains[0]), through(velocity, self.chains[1])


def turns_over_sine(count: Array, theta: Array) -> OverSine:
    """Return cos(count theta) and sin(count theta) / sin(theta) for whole counts."""
    xp = namespace(count, theta)
    upper = theta > 0.5 * np.pi
    folded = xp.where(upper, (np.pi - theta) + PI_REST, theta)
    sine, is_end = xp.sin(folded), folded == 0.0
    ratio = xp.where(is_end, count, xp.sin(count * folded) / xp.where(is_end, 1.0, sine))
    sign = xp.where(upper, 1.0 - 2.0 * (count % 2.0), 1.0)
    return sign * xp.cos(count * folded), xp.where(upper, -sign, 1.0) * ratio


def _product(a: OverSine, b: OverSine, square: Array) -> OverSine:
    real = a[0] * b[0] - square * a[1] * b[1]
    return real, a[0] * b[1] + a[1] * b[0]


def _power_of_two(count: int) -> int:
    return 1 << max(count - 1, 0).bit_length()


def responses_at(filters: Filters, theta: Array) -> tuple[Array, Array]:
    """Return P and V at e^(i theta), of NumPy or JAX, without a bound."""
    turn = 1j * namespace(theta).sin(theta)
    position, velocity = Responses.from_filters(filters).over_sine(theta)
    return position[0] + turn * position[1], velocity[0] + turn * velocity[1]


# g is continuous in all six variables, in the delay too. Re g and Im g / sin(theta) are even and 2
# pi-periodic in theta, so the equations Re g = 0, Im g / sin(theta) = 0 of a pair of roots go on
# smoothly to theta = 0 and pi, where the pair meets a real root.

_DOUBLINGS = 12  # enough for the stiffest and most damped hands
_TERMS = 13  # the last power of a time in which the plant moves by 1/4


def _motion(gamma: Array, delta: Array, time: Array) -> tuple[Array, Array]:
    """Return position and velocity after a unit step of force on the plant at rest.

    A Taylor series for a small time is summed, its smallest terms first, and that time is doubled.
    """
    xp = namespace(gamma, delta, time)
    short = time * 2.0**-_DOUBLINGS
    terms = [xp.zeros_like(short), 0.5 * short**2]  # of the position, from the first power on
    for k in range(2, _TERMS):
        following = delta * short * terms[-1] + gamma * short**2 * terms[-2] / k
        terms.append(-following / (k + 1))
    position = moment = terms[0]
    for power in range(_TERMS, 1, -1):
        term = terms[power - 1]
        position, moment = position + term, moment + power * term

    def doubled(half: tuple[Array, Array]) -> tuple[Array, Array]:
        p, v = half
        return 2 * p - gamma * p**2 + v**2, 2 * v - delta * v**2 - 2 * gamma * p * v

    start = position, moment / xp.where(short == 0.0, 1.0, short)
    return repeat(_DOUBLINGS, doubled, start)


def quick_plant(gamma: Array, delta: Array, delay: Array) -> PlantCoefficients:
    """Return the sampled plant in plain float64, good to about 1e-14 of one."""
    xp = namespace(gamma, delta, delay)
    rest_of_sample = xp.floor(delay) + 1.0 - delay
    times = xp.stack(xp.broadcast_arrays(xp.ones_like(gamma + delta), rest_of_sample))
    (position, n2), (velocity, early) = _motion(gamma, delta, times)
    impulse_rate = 1.0 - delta * velocity - gamma * position
    total = position + velocity**2 - impulse_rate * position
    later = position - n2
    n1 = later + velocity * early - impulse_rate * n2
    n0 = velocity * (velocity - early) - impulse_rate * later
    d1, d0 = gamma * position - 1.0 - impulse_rate, xp.exp(-delta)
    return PlantCoefficients(d1, d0, n2, n1, n0, total, n2 - n1 + n0, gamma * total)


def circle_equations(
    hand: Iterable[Array],
    alpha: Numbers,
    beta: Numbers,
    theta: Array,
    responses: Responses,
) -> tuple[Array, Array]:
    """Return Re g and Im g / sin(theta); differentiable, and smooth in theta at 0 and pi.

    ``hand`` is gamma, delta and the delay.
    """
    gamma, delta, delay = hand
    c = quick_plant(gamma, delta, delay)
    xp = namespace(c, alpha, beta, theta)
    upper = theta > pi / 2
    folded = xp.where(upper, (pi - theta) + PI_REST, theta)
    square = xp.sin(folded) ** 2
    cosine_m, ratio_m = turns_over_sine(xp.floor(delay) + 1.0, theta)
    near = 2.0 * xp.sin(0.5 * folded) ** 2
    kappa, eps, sigma, nu = 1.0 + c.d0, -xp.expm1(-delta), c.n2 + c.n0, c.n2 - c.n0
    d = _real_part(upper, near, c.den_at_one, 1.0 - c.d1 + c.d0, kappa)
    q = _real_part(upper, near, c.sum, c.difference, sigma)
    position, velocity = responses.over_sine(theta)
    wall = tuple(alpha * p + beta * v for p, v in zip(position, velocity, strict=True))
    turned = _product((cosine_m, -ratio_m), _product((q, nu), wall, square), square)
    return d + turned[0], eps + turned[1]
