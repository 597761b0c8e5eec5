"""The closed form of the boundary for loops with any plant, estimator and filter. NumPy only.

Divided by the position filter, p = 0 reads alpha + beta V(z) = W(z), V = X/Y, W = -z^w D/N (the
position filter's numerator counts to N and Y, its denominator to D and X). On each half of the
circle, z = +-zeta with |arg zeta| <= pi/2, everything is divided by s = zeta - 1 first:

    V = V1 + s V',     W = W1 + s W',     a = alpha + beta V1 - W1,     a/s + beta V' = W'

with V1, W1 the values at z = +-1. As 1/s = -1/2 - i/(2 tan(u/2)), u = arg zeta, both gains follow
without cancellation, and a is how far the wall is from the line of a real root at +-1. Where V1 or
W1 is large at z = -1 the same is done with 1/V or 1/W (``Form``).

Where Im V < 0 the stable side of the curve is its right one: such angles count as negative ones,
which run the other way, so the stable set lies to the left everywhere. V is real at its *poles*,
where the curve goes to infinity.
"""

from collections.abc import Sequence
from enum import IntEnum
from functools import lru_cache, reduce
from itertools import accumulate
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, tree_map
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.linear_loop import SampledPlant, linear_loop, loop_factors
from jaxstab.model.transfer import Polynomial, Transfer, product, size_of
from jaxstab.region.pole_lines import PoleLine, pole_lines
from jaxstab.region.stretches import Stretch

_ZERO = DoubleDouble(0.0, 0.0)
_DIFFERENCE = (DoubleDouble(1.0, 0.0), DoubleDouble(-1.0, 0.0))  # z - 1
_NOTHING = 1e-25  # of the size of N: pairs that are rounding
_MOST_LOST = 1e5  # the sum of a denominator's coefficients beside its least size on the circle
_SOME_LOST = 30.0  # the same, for loops of which the digits are looked at
_CLOSEST, _FARTHEST = 1e-9, 4.0  # of the distances of poles that are told apart
_ON_CIRCLE = 1e-6  # a root of Im V this close to the circle is on it
_SLOW = 0.5  # of the distance from 1
_STEPS = np.linspace(0.0, 1.5, 151)[1:]  # of zeta - 1: on a half of the circle at most sqrt(2)

Angles = Float64[np.ndarray, " _"]  # of any length
System = tuple[SampledPlant, Transfer, Transfer]  # with T V(z) less its factor (1 - 1/z), P(z)
Part = TypeVar("Part", SampledPlant, Transfer)


_NO_PAIRS = np.empty((2, 2, 2, 3, 0))


class Form(IntEnum):
    """How the imaginary part of V or of W is had near zeta = 1 without a loss of digits.

    DIRECT is the form above. Where the value at zeta = 1 is large it takes the digits, and the same
    is done with 1/V, or with -z^w/W = N/D: INVERSE. WHOLE divides nothing by s: 0/0 at zeta = 1.
    """

    DIRECT = 0
    INVERSE = 1
    WHOLE = 2


class Half(NamedTuple):
    """One half of the circle: polynomials in powers of zeta and of s, the lowest power first.

    With a dash for the quotient (Q - Q(1)) / s the rows are D, N, Y, X, X' Y(1) - Y' X(1), which is
    V' Y Y(1), and D' N(1) - N' D(1). The powers of s have the smaller terms where |s| < ``close``.
    """

    straight: Float64[np.ndarray, "6 power"]
    shifted: Float64[np.ndarray, "6 power"]
    close: Float64[np.ndarray, "6"]
    at_one: Float64[np.ndarray, "4"]  # D, N, Y, X at zeta = 1
    sign: float  # of z^w at zeta = 1
    forms: tuple[Form, Form]  # of W and of V

    @property
    def constants(self) -> list[float]:
        """D, N, Y and X at zeta = 1, W and V there if their form is DIRECT, and ``sign``."""
        d, n, y, x = self.at_one
        plant, estimate = (form == Form.DIRECT for form in self.forms)
        return [d, n, y, x, -self.sign * d / n if plant else 0.0, x / y if estimate else 0.0]


class FilteredCurve(NamedTuple):
    """What the boundary of a loop with filters is made of."""

    plus: Half
    minus: Half
    lag: float  # w
    parts: Float64[np.ndarray, "3 coefficient"]  # base, stiffness, damping, highest power first
    at_minus_one: Float64[np.ndarray, "3"]  # the same of p(-1), its sign plus in the stable set
    poles: Float64[np.ndarray, "2 pole"]  # angles in [0, pi], and how far they are from the circle
    resonances: Float64[np.ndarray, "2 root"]  # the same of zeros and poles of a general device
    steep: Angles  # those at which beta is 0: where V is small the curve is there for an instant
    lines: tuple[PoleLine, ...]  # whole lines at poles
    loses_digits: bool  # in float64
    may_lose_some: bool
    stretches: tuple[Stretch, ...] = ()  # parts of the angles that are drawn out
    pairs: Float64[np.ndarray, "half form pair part coefficient"] = _NO_PAIRS  # if it is exact
    is_exact: bool = False  # whether all of it is evaluated in double-double


class _Around(NamedTuple):
    """A polynomial in powers of zeta and of s = zeta - 1, highest power first."""

    straight: Polynomial
    shifted: Polynomial

    @classmethod
    def of(cls, polynomial: Polynomial) -> "_Around":
        """Return a polynomial with its powers of s, of which rounding is taken for 0."""
        nothing = _NOTHING * size_of(polynomial)
        shifted = (c if abs(c.hi) >= nothing else _ZERO for c in _shifted(polynomial))
        return cls(polynomial, tuple(shifted))

    def times(self, other: "_Around") -> "_Around":
        """Return the product."""
        both = zip(self, other, strict=True)
        return _Around(*(product(one, two) for one, two in both))

    @property
    def value(self) -> DoubleDouble:
        """Q(1)."""
        return self.shifted[-1]

    def with_value(self, value: DoubleDouble) -> "_Around":
        """Return the polynomial with a better value at 1."""
        return self._replace(shifted=(*self.shifted[:-1], value))

    @property
    def quotient(self) -> "_Around":
        """(Q - Q(1)) / s."""
        sums = tuple(accumulate(self.straight[:-1], DoubleDouble.__add__))
        return _Around(sums or (_ZERO,), self.shifted[:-1] or (_ZERO,))


def filtered_curve(plant: SampledPlant, velocity: Transfer, position: Transfer) -> FilteredCurve:
    """Return the curve of a plant, with T V(z) less its factor (1 - 1/z), and with P(z)."""
    return _curve(_in_floats(plant), _in_floats(velocity), _in_floats(position))


@lru_cache(maxsize=64)
def _curve(plant: SampledPlant, velocity: Transfer, position: Transfer) -> FilteredCurve:
    lag = velocity.lag + 1 - position.lag
    above = _power(max(-lag, 0)), _DIFFERENCE, velocity.numerator, position.denominator
    below = _power(max(lag, 0)), velocity.denominator, position.numerator
    whole = plant.lag + position.lag
    halves = [
        _half(
            d.times(_around(position.denominator, sign)),
            n.times(_around(position.numerator, sign)),
            reduce(_Around.times, (_around(factor, sign) for factor in below)),
            reduce(_Around.times, (_around(factor, sign) for factor in above)),
            sign=float(sign**whole),
            is_plus=sign > 0,
        )
        for (d, n), sign in zip(_plants_around(plant), (1, -1), strict=True)
    ]
    loop = linear_loop(plant, velocity, position)
    real_angles = _real_angles(*(_rounded(reduce(product, factors)) for factors in (above, below)))
    lost = _lost_digits((velocity.denominator, position.denominator))
    loses_digits = lost > _MOST_LOST
    lines = () if loses_digits else pole_lines(loop[:3], real_angles)
    zeros = _rounded(product(plant.numerator, position.numerator))
    poles = plant.denominator, position.denominator
    return FilteredCurve(
        plus=halves[0],
        minus=halves[1],
        lag=float(whole),
        parts=np.array([_rounded(part) for part in loop[:3]]),
        at_minus_one=_rounded(tuple(part.value for part in loop.at_minus_one)),
        poles=_poles(real_angles, zeros, lines),
        resonances=_resonances(plant),
        steep=_real_angles(_rounded(product(reduce(product, poles), _power(whole))), zeros),
        lines=lines,
        loses_digits=loses_digits,
        may_lose_some=lost > _SOME_LOST or plant.shifted is not None,
    )


def _lost_digits(denominators: Sequence[Polynomial]) -> float:
    """Return what poles of filters that are close to each other take from float64."""
    coefficients = _rounded(reduce(product, denominators))
    circle = np.exp(1j * np.geomspace(1e-3, np.pi, 64))
    least = np.min(np.abs(np.prod(circle[:, None] - np.roots(coefficients), axis=1)))
    return float(np.sum(np.abs(coefficients)) / least)


def parts_in_pairs(system: System) -> Float64[np.ndarray, "2 2 2 3 coefficient"]:
    """Return base, stiffness and damping, lowest power first, with what rounding took from them.

    They are in powers of zeta and of zeta - 1, on the halves of z = zeta and of z = -zeta.
    """
    plant, velocity, position = system
    plant, velocity, position = _in_floats(plant), _in_floats(velocity), _in_floats(position)
    loop = linear_loop(plant, velocity, position)[:3]
    powers, factors = loop_factors(plant.lag, velocity, position)
    halves = []
    for (d, n), sign in zip(_plants_around(plant), (1, -1), strict=True):
        shifted = []
        for one, power, others in zip((d, n, n), powers, factors, strict=True):
            parts = [_around(factor, sign).shifted for factor in (_power(power), *others)]
            shifted.append(reduce(product, parts, one.shifted))
        straight = loop if sign > 0 else [_turned(part) for part in loop]
        halves.append([_as_array(each, len(loop[0])) for each in (straight, shifted)])
    return np.array(halves)


def _as_array(
    parts: Sequence[Polynomial], length: int
) -> Float64[np.ndarray, "2 part coefficient"]:
    """Return coefficients, lowest power first, with zeros up to a length."""
    rows = [
        [(c.hi, c.lo) for c in part[::-1]] + [(0.0, 0.0)] * (length - len(part)) for part in parts
    ]
    return np.array(rows, float).transpose(2, 0, 1)


def _around(polynomial: Polynomial, sign: int) -> _Around:
    """Return a polynomial of sign zeta."""
    return _Around.of(polynomial if sign > 0 else _turned(polynomial))


def _plants_around(plant: SampledPlant) -> list[tuple[_Around, _Around]]:
    """Return D and N on both halves of the circle."""
    n, d = plant.numerator, plant.denominator
    if plant.shifted is not None:
        n_shifted, d_shifted, n_turned, d_turned = plant.shifted
        return [
            (_Around(d, d_shifted), _Around(n, n_shifted)),
            (_Around(_turned(d), d_turned), _Around(_turned(n), n_turned)),
        ]
    # The values at the ends are known to more digits than sums of coefficients.
    numerator = _around(n, 1)
    ratio = plant.at_one[1].value / plant.at_one[0].value
    above, below = (end.value for end in plant.at_minus_one)
    return [
        (_around(d, 1).with_value(numerator.value * ratio), numerator),
        (_around(d, -1).with_value(below), _around(n, -1).with_value(above)),
    ]


def _half(d: _Around, n: _Around, y: _Around, x: _Around, *, sign: float, is_plus: bool) -> Half:
    values = _rounded((d.value, n.value, y.value, x.value))
    rows = [d, n, y, x, _minor(x, y), _minor(d, n)]
    direct = Form.DIRECT, Form.DIRECT
    length = max(len(row.straight) for row in rows)
    straight, shifted = (
        np.array([_padded(_rounded(row[form]), length) for row in rows]) for form in range(2)
    )
    size = np.sum(np.abs(straight), axis=1)[:, None]
    grown = np.abs(shifted) @ _STEPS ** np.arange(length)[:, None]
    return Half(
        straight=straight,
        shifted=shifted,
        close=np.max(np.where(grown < size, _STEPS, 0.0), axis=1),
        at_one=values,
        sign=sign,
        forms=direct if is_plus else (_form(d, n), _form(x, y)),
    )


def _form(above: _Around, below: _Around) -> Form:
    """Return the form for the quotient of two polynomials."""
    sizes = (abs(one.value.hi) / size_of(one.straight) for one in (above, below))
    of_above, of_below = sizes
    if of_above == of_below == 0.0:
        return Form.WHOLE
    return Form.DIRECT if of_below >= of_above else Form.INVERSE


def _minor(one: _Around, other: _Around) -> _Around:
    """Return (Q(1) P - P(1) Q) / (zeta - 1) of two polynomials."""
    pairs = zip(one.quotient, other.quotient, strict=True)
    return _Around(*(_crossed(above, below, one.value, other.value) for above, below in pairs))


def _crossed(
    above: Polynomial, below: Polynomial, value: DoubleDouble, other: DoubleDouble
) -> Polynomial:
    """Return other above - value below, with 0 for what is rounding of the two."""
    length = max(len(above), len(below))
    above, below = ((_ZERO,) * (length - len(one)) + one for one in (above, below))
    terms = [(a * other, b * -value) for a, b in zip(above, below, strict=True)]
    sums = ((a + b, _NOTHING * (abs(a.hi) + abs(b.hi))) for a, b in terms)
    return tuple(total if abs(total.hi) >= nothing else _ZERO for total, nothing in sums)


def _padded(falling: Angles, length: int) -> Angles:
    """Return coefficients, lowest power first, with zeros up to a length."""
    return np.append(falling[::-1], np.zeros(length - len(falling)))


def _turned(polynomial: Polynomial) -> Polynomial:
    """Return the polynomial of -z."""
    degree = len(polynomial) - 1
    return tuple(-c if (degree - k) % 2 else c for k, c in enumerate(polynomial))


def _power(degree: int) -> Polynomial:
    return (DoubleDouble(1.0, 0.0), *(_ZERO,) * degree)


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


def _in_floats(system: Part) -> Part:
    """Return a system of Python floats, with which double-double is several times faster."""
    return tree_map(float, system)._replace(lag=system.lag)


def _poles(
    estimator: Angles, numerator: Angles, lines: Sequence[PoleLine]
) -> Float64[np.ndarray, "2 pole"]:
    """Return the angles in [0, pi] where Im V = 0 or N is small, and how far their roots are."""
    roots = np.roots(numerator)
    roots = roots[roots.imag >= 0.0]
    distance = np.abs(np.log(np.maximum(np.abs(roots), 1e-300)))
    distances = np.concatenate([np.zeros(len(estimator)), distance])
    angles = np.concatenate([estimator, np.abs(np.angle(roots))])
    for line in lines:
        others = ~line.holds(angles)
        angles = np.concatenate([angles[others], line.poles])
        distances = np.concatenate([distances[others], np.zeros(len(line.poles))])
    return np.stack([angles, np.clip(distances, _CLOSEST, _FARTHEST)])


def _real_angles(above: Angles, below: Angles) -> Angles:
    """Return the angles in (0, pi) where the quotient of two polynomials is real.

    Its imaginary part, times |below|^2, is a series of sines: the odd part of above(z) below(1/z).
    """
    length = max(len(above), len(below))
    above, below = (np.append(np.zeros(length - len(one)), one) for one in (above, below))
    series = np.convolve(above, below[::-1])
    roots = np.roots(series - series[::-1])
    roots = roots[np.abs(np.log(np.maximum(np.abs(roots), 1e-300))) < _ON_CIRCLE]
    angles = np.angle(roots)
    return angles[(angles > _ON_CIRCLE) & (angles < np.pi - _ON_CIRCLE)]


def _resonances(plant: SampledPlant) -> Float64[np.ndarray, "2 root"]:
    """Return the angles in [0, pi] of zeros and poles of a general device, and how far they are.

    Next to 1 they are found in powers of z - 1: those of slow modes differ by less than the
    coefficients in powers of z tell. One mass needs none of them.
    """
    if plant.shifted is None:
        return np.empty((2, 0))
    both = plant.numerator, plant.denominator
    pairs = zip(map(_rounded, both), map(_rounded, plant.shifted[:2]), strict=True)
    every = np.concatenate([_roots(*pair) for pair in pairs])
    every = every[every.imag >= 0.0]
    distance = np.abs(np.log(np.maximum(np.abs(every), 1e-300)))
    return np.stack([np.abs(np.angle(every)), np.clip(distance, _CLOSEST, _FARTHEST)])


def _roots(straight: Angles, shifted: Angles) -> Array:
    far, near = np.roots(straight), 1.0 + np.roots(shifted)
    return np.concatenate([far[abs(far - 1.0) > _SLOW], near[abs(near - 1.0) <= _SLOW]])
