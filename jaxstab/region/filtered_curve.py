"""The closed form of the boundary for loops with an estimator and a position filter. NumPy only.

Divided by the position filter, p = 0 reads alpha + beta V(z) = W(z), V = X/Y, W = -z^w D/N (the
position filter's numerator counts to N and Y, its denominator to D and X). On each half of the
circle, z = +-zeta with |arg zeta| <= pi/2, everything is divided by s = zeta - 1 first:

    V = V1 + s V',     W = W1 + s W',     a = alpha + beta V1 - W1,     a/s + beta V' = W'

with V1, W1 the values at z = +-1. As 1/s = -1/2 - i/(2 tan(u/2)), u = arg zeta, both gains follow
without cancellation, and a is how far the wall is from the line of a real root at +-1.

Where Im V < 0 the stable side of the curve is its right one: such angles count as negative ones,
which run the other way, so the stable set lies to the left everywhere. V is real at its *poles*,
where the curve goes to infinity.
"""

from collections.abc import Sequence
from functools import lru_cache, reduce
from itertools import accumulate
from math import comb
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import PI_REST, Array, tree_map
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filters
from jaxstab.model.linear_loop import SampledPlant, linear_loop, sampled_mass
from jaxstab.model.transfer import Polynomial, product
from jaxstab.point.radius.dominant_root import Complex

_ZERO = DoubleDouble(0.0, 0.0)
_DIFFERENCE = (DoubleDouble(1.0, 0.0), DoubleDouble(-1.0, 0.0))  # z - 1
_NOTHING = 1e-25  # of the size of N: pairs that are rounding
_CLOSEST, _FARTHEST = 1e-9, 4.0  # of the distances of poles that are told apart
_ON_CIRCLE = 1e-6  # a root of Im V this close to the circle is on it

Angles = Float64[np.ndarray, " _"]  # of any length


class Half(NamedTuple):
    """One half of the circle: polynomials in powers of zeta and of s, the lowest power first.

    The rows are D, D', N, N', Y, Y', X', where a dash is the quotient (Q - Q(1)) / s.
    """

    straight: Float64[np.ndarray, "7 power"]
    shifted: Float64[np.ndarray, "7 power"]
    at_one: Float64[np.ndarray, "4"]  # D, N, Y, X at zeta = 1
    sign: float  # of z^w at zeta = 1


class FilteredCurve(NamedTuple):
    """What the boundary of a loop with filters is made of."""

    plus: Half
    minus: Half
    lag: float  # w
    parts: Float64[np.ndarray, "3 coefficient"]  # base, stiffness, damping, highest power first
    poles: Float64[np.ndarray, "2 pole"]  # angles in [0, pi], and how far they are from the circle


@lru_cache(maxsize=64)
def filtered_curve(
    gamma: float, delta: float, whole_delay: int, fraction: float, filters: Filters
) -> FilteredCurve:
    """Return the curve of one slice with filters in units of one sample."""
    plant = _in_floats(sampled_mass(np.float64(gamma), np.float64(delta), whole_delay, fraction))
    velocity, position = filters[0].filter.transfer(), filters[1].transfer()
    lag = velocity.lag + 1 - position.lag
    above = product(_DIFFERENCE, product(velocity.numerator, position.denominator))
    below = product(velocity.denominator, position.numerator)
    above, below = above + (_ZERO,) * max(-lag, 0), below + (_ZERO,) * max(lag, 0)
    denominator = product(plant.denominator, position.denominator)
    numerator = product(plant.numerator, position.numerator)
    every = denominator, numerator, below, above
    whole = plant.lag + position.lag
    turned = [_turned(polynomial) for polynomial in every]
    plus = [_at_one(polynomial) for polynomial in every]
    minus = [_at_one(polynomial) for polynomial in turned]
    # These the plant knows to more digits than the sums of its coefficients.
    at_one, at_minus_one = position.at(1.0), position.at(-1.0)
    plus[0] = plus[1] * gamma * (at_one[1] / at_one[0])
    minus[:2] = (
        value.value * factor
        for value, factor in zip(plant.at_minus_one[::-1], at_minus_one[::-1], strict=True)
    )
    return FilteredCurve(
        plus=_half(every, plus, 1.0),
        minus=_half(turned, minus, (-1.0) ** whole),
        lag=float(whole),
        parts=np.array([_rounded(part) for part in linear_loop(plant, velocity, position)[:3]]),
        poles=_poles(_rounded(above), _rounded(below), _rounded(numerator)),
    )


def _half(polynomials: Sequence[Polynomial], at_one: list[DoubleDouble], sign: float) -> Half:
    quotients = [_quotient(polynomial) for polynomial in polynomials]
    rows = [row for pair in zip(polynomials, quotients, strict=True) for row in pair]
    del rows[-2]  # X itself is not needed
    length = max(map(len, rows))
    size = sum(abs(coefficient) for coefficient in _rounded(polynomials[1]))
    values = np.array([value.rounded() for value in at_one])
    values[1] = 0.0 if abs(values[1]) < _NOTHING * size else values[1]
    return Half(
        straight=np.array([_padded(_rounded(row), length) for row in rows]),
        shifted=np.array([_padded(_rounded(_shifted(row)), length) for row in rows]),
        at_one=values,
        sign=sign,
    )


def _padded(falling: Angles, length: int) -> Angles:
    """Return coefficients, lowest power first, with zeros up to a length."""
    return np.append(falling[::-1], np.zeros(length - len(falling)))


def _turned(polynomial: Polynomial) -> Polynomial:
    """Return the polynomial of -z."""
    degree = len(polynomial) - 1
    return tuple(-c if (degree - k) % 2 else c for k, c in enumerate(polynomial))


def _at_one(polynomial: Polynomial) -> DoubleDouble:
    return reduce(DoubleDouble.__add__, polynomial)


def _quotient(polynomial: Polynomial) -> Polynomial:
    """Return (Q(z) - Q(1)) / (z - 1)."""
    return tuple(accumulate(polynomial[:-1], DoubleDouble.__add__)) or (_ZERO,)


def _shifted(polynomial: Polynomial) -> Polynomial:
    """Return the coefficients in powers of z - 1, by one division after the other."""
    rest, coefficients = polynomial, []
    while len(rest) > 1:
        *sums, value = accumulate(rest, DoubleDouble.__add__)
        coefficients.append(value)
        rest = tuple(sums)
    return (*rest, *coefficients[::-1])


def _rounded(polynomial: Polynomial) -> Angles:
    return np.array([float(coefficient.rounded()) for coefficient in polynomial])


def _in_floats(plant: SampledPlant) -> SampledPlant:
    """Return a plant of Python floats, with which double-double is several times faster."""
    return tree_map(float, plant)._replace(lag=plant.lag)


def _poles(above: Angles, below: Angles, numerator: Angles) -> Float64[np.ndarray, "2 pole"]:
    """Return the angles in [0, pi] where Im V = 0 or N is small, and how far their roots are.

    |Y|^2 Im V is a series of sines: the odd part of X(z) Y(1/z).
    """
    series = np.convolve(np.append(np.zeros(max(len(below) - len(above), 0)), above), below[::-1])
    odd = series - series[::-1] if len(series) % 2 else series
    roots = np.concatenate([np.roots(odd), np.roots(numerator)])
    distance = np.abs(np.log(np.maximum(np.abs(roots), 1e-300)))
    is_of_estimator = np.arange(len(roots)) < len(roots) - len(numerator) + 1
    angles = np.abs(np.angle(roots))
    is_kept = (~is_of_estimator | (distance < _ON_CIRCLE)) & (roots.imag >= 0.0)
    is_kept &= ~is_of_estimator | ((angles > _ON_CIRCLE) & (angles < np.pi - _ON_CIRCLE))
    distance = np.where(is_of_estimator, 0.0, distance)
    return np.stack([angles, np.clip(distance, _CLOSEST, _FARTHEST)])[:, is_kept]


# ------------------------------------------------------------------------------------ evaluation


def filtered_point(
    curve: FilteredCurve, theta: Array, low: Array | float
) -> tuple[Array, Array, Array]:
    """Return alpha, beta and (alpha - W(1)) / (1 - cos th) at angles, which may be negative.

    ``low`` is what rounding took from the angles. Analytic in theta, as ``with_slope`` needs it.
    """
    theta, low = np.broadcast_arrays(np.asarray(theta), low)
    flat, rest = theta.ravel(), low.ravel()
    turned = np.where(flat.real < 0.0, -1.0, 1.0)
    flat, rest = flat * turned, rest * turned
    upper = flat.real > np.pi / 2
    results = np.empty((3, flat.size), flat.dtype)
    results[:, ~upper] = _lower_point(curve, flat[~upper] + rest[~upper])
    folded = (np.pi - flat[upper]) + (PI_REST - rest[upper])
    results[:, upper] = _upper_point(curve, folded)
    alpha, beta, lift = results.reshape(3, *theta.shape)
    return alpha, beta, lift


def _lower_point(curve: FilteredCurve, u: Array) -> Array:
    beta, away, lift = _gains(curve.plus, curve.lag, u)
    return np.stack([away + _plant_at_one(curve.plus), beta, lift])


def _upper_point(curve: FilteredCurve, u: Array) -> Array:
    half = curve.minus
    if half.at_one[1] == 0.0:
        alpha, beta = _far_gains(half, curve.lag, u)
    else:
        beta, away, _ = _gains(half, curve.lag, u)
        alpha = away + _plant_at_one(half) - beta * estimate_at_one(half)
    return np.stack([alpha, beta, (alpha - _plant_at_one(curve.plus)) / (1.0 + np.cos(u))])


def _plant_at_one(half: Half) -> float:
    """Return W at zeta = 1."""
    with np.errstate(divide="ignore"):
        return float(-half.sign * half.at_one[0] / half.at_one[1])


def estimate_at_one(half: Half) -> float:
    """Return V at zeta = 1."""
    return float(half.at_one[3] / half.at_one[2])


def _gains(half: Half, lag: float, u: Array) -> tuple[Array, Array, Array]:
    """Return beta, a, and a / (1 - cos u)."""
    d, d_rise, n, n_rise, y, y_rise, x_rise = _evaluated(half, u)
    d_one, n_one, y_one, x_one = half.at_one
    turns_rise = _geometric(lag, u)
    fall = turns_rise.times(d).scaled(n_one).plus(d_rise.scaled(n_one)).plus(n_rise.scaled(-d_one))
    plant = _ratio(fall, n).scaled(-half.sign / n_one)
    estimate = _ratio(x_rise.scaled(y_one).plus(y_rise.scaled(-x_one)), y).scaled(1.0 / y_one)
    tangent = np.tan(0.5 * u)
    beta = (plant.re - tangent * plant.im) / (estimate.re - tangent * estimate.im)
    swing = beta * estimate.im - plant.im
    sine = np.sin(u)
    return beta, 2.0 * tangent * swing, 2.0 * swing / np.where(sine == 0.0, 1.0, sine)


def _far_gains(half: Half, lag: float, u: Array) -> tuple[Array, Array]:
    """Return alpha and beta where W is infinite at zeta = 1."""
    d, _, n, _, y, _, x_rise = _evaluated(half, u)
    turns = Complex(np.cos(lag * u), np.sin(lag * u))
    plant = _ratio(turns.times(d), n).scaled(-half.sign)
    step = Complex(-2.0 * np.sin(0.5 * u) ** 2, np.sin(u))
    estimate = _ratio(step.times(x_rise).shifted(half.at_one[3]), y)
    beta = plant.im / estimate.im
    return plant.re - beta * estimate.re, beta


def _evaluated(half: Half, u: Array) -> list[Complex]:
    """Return the rows at zeta = e^(iu): in the powers in which the terms are smaller.

    The imaginary part of u is a complex step: what it adds is formed from the derivative.
    """
    angle = u.real
    zeta = np.exp(1j * angle)
    step = 2j * np.sin(0.5 * angle) * np.exp(0.5j * angle)  # zeta - 1
    count = half.straight.shape[1]
    straight, shifted = _powers(zeta, count), _powers(step, count)
    size = np.abs(half.straight).sum(axis=1)[:, None]
    is_closer = np.abs(half.shifted) @ np.abs(shifted) < size
    rows = np.where(is_closer, half.shifted @ shifted, half.straight @ straight)
    if not np.iscomplexobj(u):
        return [Complex(row.real, row.imag) for row in rows]
    order = np.arange(1.0, count)
    below = (
        (half.shifted[:, 1:] * order) @ shifted[:-1],
        (half.straight[:, 1:] * order) @ straight[:-1],
    )
    slopes = np.where(is_closer, *below) * (1j * zeta * u.imag)
    return [
        Complex(row.real + 1j * slope.real, row.imag + 1j * slope.imag)
        for row, slope in zip(rows, slopes, strict=True)
    ]


def _powers(number: Array, count: int) -> Array:
    """Return the powers 0 ... count - 1, on the first axis."""
    powers = np.empty((count, len(number)), complex)
    powers[0], powers[1:] = 1.0, number
    return np.cumprod(powers, axis=0, out=powers)


def _geometric(count: float, u: Array) -> Complex:
    """Return 1 + zeta + ... + zeta^(count - 1)."""
    sine = np.sin(0.5 * u)
    size = np.where(sine == 0.0, count, np.sin(0.5 * count * u) / np.where(sine == 0.0, 1.0, sine))
    turn = 0.5 * (count - 1.0) * u
    return Complex(size * np.cos(turn), size * np.sin(turn))


def _ratio(one: Complex, other: Complex) -> Complex:
    conjugate = Complex(other.re, -other.im)
    return one.times(conjugate).scaled(1.0 / other.squared_modulus())


def is_oriented(curve: FilteredCurve, theta: Angles) -> Bool[np.ndarray, " angle"]:
    """Return where the sign of angles is that of Im V: the stable side is the left one."""
    size = np.abs(theta)
    upper = size > np.pi / 2
    folded = np.where(upper, np.pi - size, size)
    is_left = np.empty(len(theta), bool)
    for half, chosen in ((curve.plus, ~upper), (curve.minus, upper)):
        _, _, _, _, y, _, x_rise = _evaluated(half, folded[chosen])
        step = Complex(-2.0 * np.sin(0.5 * folded[chosen]) ** 2, np.sin(folded[chosen]))
        estimate = _ratio(step.times(x_rise).shifted(half.at_one[3]), y)
        is_left[chosen] = (estimate.im > 0.0) == (half is curve.plus)
    return is_left == (theta > 0.0)


def may_be_stable(curve: FilteredCurve, alpha: Array, beta: Array) -> Bool[np.ndarray, " wall"]:
    """Return False where a coefficient of p is above that of any stable polynomial: binomial."""
    base, stiffness, damping = curve.parts[:, :, None]
    degree = len(base) - 1
    largest = np.array([comb(degree, k) for k in range(degree + 1)], float)[:, None]
    fits: np.ndarray = np.all(abs(base + stiffness * alpha + damping * beta) <= largest, axis=0)
    return fits


def filtered_quotient(
    curve: FilteredCurve, wall: tuple[Array, Array], total: Array, product: float, length: int
) -> Array:
    """Divide p(zeta) of a wall by zeta^2 - total zeta + product, of two roots that the wall has."""
    alpha, beta = wall
    base, stiffness, damping = curve.parts
    before, last = np.zeros_like(total), np.zeros_like(total)
    quotient = []
    for k in range(length):
        coefficient = base[k] + (stiffness[k] * alpha + damping[k] * beta)
        before, last = last, coefficient + total * last - product * before
        quotient.append(last)
    return np.stack(quotient)
