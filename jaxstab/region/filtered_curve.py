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
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, tree_map
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filters
from jaxstab.model.linear_loop import (
    LinearLoop,
    LoopFilters,
    SampledPlant,
    loop_factors,
    loop_filters,
    loop_of,
    sampled_mass,
)
from jaxstab.model.transfer import Polynomial, Transfer, product, size_of
from jaxstab.region.around import Around, Rows, around, minor, power, rounded, turned
from jaxstab.region.pole_lines import PoleLine, pole_lines
from jaxstab.region.stretches import Stretch

_DIFFERENCE = (DoubleDouble(1.0, 0.0), DoubleDouble(-1.0, 0.0))  # z - 1
_MOST_LOST = 1e5  # the sum of a denominator's coefficients beside its least size on the circle
_SOME_LOST = 30.0  # the same, for loops of which the digits are looked at
_CLOSEST, _FARTHEST = 1e-9, 4.0  # of the distances of poles that are told apart
_ON_CIRCLE = 1e-6  # a root of Im V this close to the circle is on it
_REMEMBERED = 64  # pairs of filters, and curves
_SLOW = 0.5  # of the distance from 1

Angles = Float64[np.ndarray, " _"]  # of any length
System = tuple[SampledPlant, Transfer, Transfer]  # with T V(z) less its factor (1 - 1/z), P(z)


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
    """One half of the circle.

    With a dash for the quotient (Q - Q(1)) / s the rows are N, D and D' N(1) - N' D(1); Y, X and
    X' Y(1) - Y' X(1), which is V' Y Y(1).
    """

    of_plant: Rows
    of_estimate: Rows
    at_one: tuple[float, float, float, float]  # N, D, Y, X at zeta = 1
    sign: float  # of z^w at zeta = 1
    forms: tuple[Form, Form]  # of W and of V

    @property
    def values(self) -> tuple[float, float]:
        """W and V at zeta = 1, each if its form is DIRECT."""
        n, d, y, x = self.at_one
        of_plant, of_estimate = self.forms
        return (
            -self.sign * d / n if of_plant == Form.DIRECT else 0.0,
            x / y if of_estimate == Form.DIRECT else 0.0,
        )


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


def mass_system(gamma: float, delta: float, delay: float, filters: Filters) -> System:
    """Return the plant of one mass, with T V(z) less its factor (1 - 1/z), and with P(z)."""
    whole, fraction = divmod(delay, 1.0)
    plant = sampled_mass(np.float64(gamma), np.float64(delta), int(whole), fraction)
    # Double-double is many times faster with Python floats.
    return tree_map(float, plant)._replace(lag=plant.lag), *_transfers(filters)


@lru_cache(_REMEMBERED)
def _transfers(filters: Filters) -> tuple[Transfer, Transfer]:
    velocity, position = filters
    return velocity.filter.transfer(), position.transfer()


class _HalfOfFilters(NamedTuple):
    """What estimator and position filter make of one half of the circle, whatever the plant is."""

    of_d: Around  # the factors of D and N
    of_n: Around
    at_one: tuple[float, float]  # Y, X at zeta = 1
    rows: Rows
    form: Form


class _OfFilters(NamedTuple):
    """What estimator and position filter make of the curve, whatever the plant is."""

    plus: _HalfOfFilters
    minus: _HalfOfFilters
    of_loop: LoopFilters
    real_angles: Angles  # of V
    lost: float


@lru_cache(_REMEMBERED)
def filtered_curve(plant: SampledPlant, velocity: Transfer, position: Transfer) -> FilteredCurve:
    """Return the curve of a plant, with T V(z) less its factor (1 - 1/z), and with P(z)."""
    whole = plant.lag + position.lag
    of_filters = _of_filters(velocity, position)
    above, below = _plants_around(plant)
    loop = loop_of(plant, of_filters.of_loop)
    real_angles, lost = of_filters.real_angles, of_filters.lost
    loses_digits = lost > _MOST_LOST
    lines = () if loses_digits else pole_lines(loop[:3], real_angles)
    zeros = rounded(product(plant.numerator, position.numerator))
    poles = plant.denominator, position.denominator
    return FilteredCurve(
        plus=_half(*above, of_filters.plus, sign=1.0, is_plus=True),
        minus=_half(*below, of_filters.minus, sign=float((-1) ** whole), is_plus=False),
        lag=float(whole),
        parts=np.array([rounded(part) for part in loop[:3]]),
        at_minus_one=rounded(tuple(part.value for part in loop.at_minus_one)),
        poles=_poles(real_angles, zeros, lines),
        resonances=_resonances(plant),
        steep=_real_angles(rounded(product(reduce(product, poles), power(whole))), zeros),
        lines=lines,
        loses_digits=loses_digits,
        may_lose_some=lost > _SOME_LOST or plant.shifted is not None,
    )


@lru_cache(_REMEMBERED)
def _of_filters(velocity: Transfer, position: Transfer) -> _OfFilters:
    """Return what two filters make of the curve.

    Raises:
        ValueError: P(1) = 0, or a filter is so slow that pairs of float64 take its pole for 1.
    """
    for name, transfer in (("velocity estimator", velocity), ("position filter", position)):
        if around(transfer.denominator, 1).value.hi == 0.0 or size_of(transfer.numerator) == 0.0:
            raise ValueError(
                f"the {name} is so slow that its gain or 1 - pole is lost in float64: it has no "
                "region and no limits; give a higher cut-off, a larger factor or a lower order."
            )
    if around(position.numerator, 1).value.hi == 0.0:
        raise ValueError(
            "the position filter has P(1) = 0: the wall does not push back at rest. It has no "
            "region and no limits; give a filter of gain 1 at z = 1, or ask for verdicts and radii."
        )
    lag = velocity.lag + 1 - position.lag
    above = power(max(-lag, 0)), _DIFFERENCE, velocity.numerator, position.denominator
    below = power(max(lag, 0)), velocity.denominator, position.numerator
    plus, minus = (_half_of_filters(above, below, position, sign) for sign in (1, -1))
    return _OfFilters(
        plus,
        minus,
        of_loop=loop_filters(velocity, position),
        real_angles=_real_angles(*(rounded(reduce(product, each)) for each in (above, below))),
        lost=_lost_digits((velocity.denominator, position.denominator)),
    )


def _half_of_filters(
    above: Sequence[Polynomial], below: Sequence[Polynomial], position: Transfer, sign: int
) -> _HalfOfFilters:
    """Return it by the factors of X and Y."""
    x, y = (
        reduce(Around.times, (around(factor, sign) for factor in factors))
        for factors in (above, below)
    )
    return _HalfOfFilters(
        of_d=around(position.denominator, sign),
        of_n=around(position.numerator, sign),
        at_one=(y.value.rounded(), x.value.rounded()),
        rows=Rows.of([y, x, minor(x, y)]),
        form=Form.DIRECT if sign > 0 else _form(x, y),
    )


def _half(d: Around, n: Around, filters: _HalfOfFilters, *, sign: float, is_plus: bool) -> Half:
    d, n = d.times(filters.of_d), n.times(filters.of_n)
    return Half(
        of_plant=Rows.of([n, d, minor(d, n)]),
        of_estimate=filters.rows,
        at_one=(n.value.rounded(), d.value.rounded(), *filters.at_one),
        sign=sign,
        forms=(Form.DIRECT if is_plus else _form(d, n), filters.form),
    )


def loop_of_system(system: System) -> LinearLoop:
    """Return the same loop as three polynomials."""
    plant, velocity, position = system
    return loop_of(plant, _of_filters(velocity, position).of_loop)


def _lost_digits(denominators: Sequence[Polynomial]) -> float:
    """Return what poles of filters that are close to each other take from float64."""
    coefficients = rounded(reduce(product, denominators))
    circle = np.exp(1j * np.geomspace(1e-3, np.pi, 64))
    least = np.min(np.abs(np.prod(circle[:, None] - np.roots(coefficients), axis=1)))
    return float(np.sum(np.abs(coefficients)) / least)


def parts_in_pairs(system: System) -> Float64[np.ndarray, "2 2 2 3 coefficient"]:
    """Return base, stiffness and damping, lowest power first, with what rounding took from them.

    They are in powers of zeta and of zeta - 1, on the halves of z = zeta and of z = -zeta.
    """
    plant, velocity, position = system
    loop = loop_of_system(system)[:3]
    powers, factors = loop_factors(plant.lag, velocity, position)
    halves = []
    for (d, n), sign in zip(_plants_around(plant), (1, -1), strict=True):
        shifted = []
        for one, count, others in zip((d, n, n), powers, factors, strict=True):
            parts = [around(factor, sign).shifted for factor in (power(count), *others)]
            shifted.append(reduce(product, parts, one.shifted))
        straight = loop if sign > 0 else [turned(part) for part in loop]
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


def _plants_around(plant: SampledPlant) -> list[tuple[Around, Around]]:
    """Return D and N on both halves of the circle."""
    n, d = plant.numerator, plant.denominator
    if plant.shifted is not None:
        n_shifted, d_shifted, n_turned, d_turned = plant.shifted
        return [
            (Around(d, d_shifted), Around(n, n_shifted)),
            (Around(turned(d), d_turned), Around(turned(n), n_turned)),
        ]
    # The values at the ends are known to more digits than sums of coefficients.
    numerator = around(n, 1)
    ratio = plant.at_one[1].value / plant.at_one[0].value
    above, below = (end.value for end in plant.at_minus_one)
    return [
        (around(d, 1).with_value(numerator.value * ratio), numerator),
        (around(d, -1).with_value(below), around(n, -1).with_value(above)),
    ]


def _form(above: Around, below: Around) -> Form:
    """Return the form for the quotient of two polynomials."""
    sizes = (abs(one.value.hi) / size_of(one.straight) for one in (above, below))
    of_above, of_below = sizes
    if of_above == of_below == 0.0:
        return Form.WHOLE
    return Form.DIRECT if of_below >= of_above else Form.INVERSE


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
    pairs = zip(map(rounded, both), map(rounded, plant.shifted[:2]), strict=True)
    every = np.concatenate([_roots(*pair) for pair in pairs])
    every = every[every.imag >= 0.0]
    distance = np.abs(np.log(np.maximum(np.abs(every), 1e-300)))
    return np.stack([np.abs(np.angle(every)), np.clip(distance, _CLOSEST, _FARTHEST)])


def _roots(straight: Angles, shifted: Angles) -> Array:
    far, near = np.roots(straight), 1.0 + np.roots(shifted)
    return np.concatenate([far[abs(far - 1.0) > _SLOW], near[abs(near - 1.0) <= _SLOW]])
