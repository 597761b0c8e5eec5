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
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import tree_map
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filters
from jaxstab.model.linear_loop import SampledPlant, linear_loop, sampled_mass
from jaxstab.model.transfer import Polynomial, product

_ZERO = DoubleDouble(0.0, 0.0)
_DIFFERENCE = (DoubleDouble(1.0, 0.0), DoubleDouble(-1.0, 0.0))  # z - 1
_NOTHING = 1e-25  # of the size of N: pairs that are rounding
_CLOSEST, _FARTHEST = 1e-9, 4.0  # of the distances of poles that are told apart
_ON_CIRCLE = 1e-6  # a root of Im V this close to the circle is on it
_STEPS = np.linspace(0.0, 1.5, 151)[1:]  # of zeta - 1: on a half of the circle at most sqrt(2)

Angles = Float64[np.ndarray, " _"]  # of any length


class Half(NamedTuple):
    """One half of the circle: polynomials in powers of zeta and of s, the lowest power first.

    With a dash for the quotient (Q - Q(1)) / s the rows are D, N, Y, X' Y(1) - Y' X(1), which is
    V' Y Y(1), and D' N(1) - N' D(1); but where W is infinite at zeta = 1 the fourth one is X. The
    powers of s have the smaller terms where |s| < ``close``.
    """

    straight: Float64[np.ndarray, "5 power"]
    shifted: Float64[np.ndarray, "5 power"]
    close: Float64[np.ndarray, "5"]
    at_one: Float64[np.ndarray, "4"]  # D, N, Y, X at zeta = 1
    sign: float  # of z^w at zeta = 1

    @property
    def is_far(self) -> bool:
        """Whether W is infinite at zeta = 1."""
        return bool(self.at_one[1] == 0.0)

    @property
    def plant(self) -> float:
        """W at zeta = 1, where it is finite."""
        return float(-self.sign * self.at_one[0] / self.at_one[1])

    @property
    def estimate(self) -> float:
        """V at zeta = 1, where W is finite."""
        return float(self.at_one[3] / self.at_one[2])


class FilteredCurve(NamedTuple):
    """What the boundary of a loop with filters is made of."""

    plus: Half
    minus: Half
    lag: float  # w
    parts: Float64[np.ndarray, "3 coefficient"]  # base, stiffness, damping, highest power first
    at_minus_one: Float64[np.ndarray, "3"]  # the same of p(-1), its sign plus in the stable set
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
    loop = linear_loop(plant, velocity, position)
    return FilteredCurve(
        plus=_half(every, plus, 1.0),
        minus=_half(turned, minus, (-1.0) ** whole),
        lag=float(whole),
        parts=np.array([_rounded(part) for part in loop[:3]]),
        at_minus_one=_rounded(tuple(part.value for part in loop.at_minus_one)),
        poles=_poles(_rounded(above), _rounded(below), _rounded(numerator)),
    )


def _half(polynomials: Sequence[Polynomial], at_one: list[DoubleDouble], sign: float) -> Half:
    values = np.array([value.rounded() for value in at_one])
    sizes = np.array([np.sum(np.abs(_rounded(polynomial))) for polynomial in polynomials])
    values[np.abs(values) < _NOTHING * sizes] = 0.0
    d, n, y, x = zip(polynomials, map(_quotient, polynomials), at_one, strict=True)
    fourth = polynomials[3] if values[1] == 0.0 else _minor(x, y)
    rows = [*polynomials[:3], fourth, _minor(d, n)]
    length = max(map(len, rows))
    straight = np.array([_padded(_rounded(row), length) for row in rows])
    shifted = np.array([_padded(_rounded(_shifted(row)), length) for row in rows])
    size = np.sum(np.abs(straight), axis=1)[:, None]
    shifted[np.abs(shifted) < _NOTHING * size] = 0.0  # zeros at zeta = 1
    grown = np.abs(shifted) @ _STEPS ** np.arange(length)[:, None]
    return Half(
        straight=straight,
        shifted=shifted,
        close=np.max(np.where(grown < size, _STEPS, 0.0), axis=1),
        at_one=values,
        sign=sign,
    )


def _minor(one: tuple[Any, ...], other: tuple[Any, ...]) -> Polynomial:
    """Return (Q(1) P - P(1) Q) / (zeta - 1) of two polynomials with their quotients and values."""
    above = [coefficient * other[2] for coefficient in one[1]]
    below = [coefficient * -one[2] for coefficient in other[1]]
    short, long = sorted((above, below), key=len)
    short = [_ZERO] * (len(long) - len(short)) + short
    return tuple(a + b for a, b in zip(short, long, strict=True))


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
