"""Estimator and position filter on the circle in real parts, as models over patches.

With s = 1 - 1/z and h = 1 - cos(theta), s^2 = 2 h s - 2 h, so that on the circle every rational
function of z with real coefficients is

    one + h rise + slope s,        one = its value at z = 1,

with real functions rise and slope of h. Products and quotients of these parts lose no digits next
to z = 1; next to z = -1 the parts of the function of -z take their place, and in between the parts
follow from the function itself (lemma B12 of docs/proofs.md).
"""

from fractions import Fraction
from functools import lru_cache, reduce
from math import factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import PI_REST
from jaxstab.boxes.filter_cells import (
    Circle,
    Factor,
    bound_of,
    factors_of,
    filter_cells,
    largest_from,
    lost_of,
    turned,
)
from jaxstab.boxes.models import LinearModel, Moving
from jaxstab.boxes.series import ORDERS, Cells, Series, constant, power_sum
from jaxstab.boxes.wall import cell_numbers, largest_within
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filters
from jaxstab.model.transfer import Polynomial, size_of

_NEAR = 0.25  # of 0 or pi: there products of parts lose no digits
_ONE = DoubleDouble(1.0, 0.0)
_OVERLAP = 1.0 + 1e-9


class Ends(NamedTuple):
    """P and V at z = 1 and -1; ``lost`` bounds the relative error of the values at -1."""

    position_at_one: float
    at_minus_one: tuple[float, float]
    lost: float


class FilterModels(NamedTuple):
    """Rise and slope of P and V over patches."""

    position_rise: Moving
    position_slope: Moving
    velocity_rise: Moving
    velocity_slope: Moving


class _PartCells(NamedTuple):
    """Taylor coefficients of the four in the cells of ``filter_cells``, and bounds."""

    series: Float64[np.ndarray, "cell 4 order"]
    lost: Float64[np.ndarray, "cell 12"]  # of the sums, then of two derivatives
    steepness: Float64[np.ndarray, "k cell 8"]  # second, then third derivatives


class _Parts(NamedTuple):
    """A function one + h rise + slope s in cells."""

    one: DoubleDouble
    rise: Series
    slope: Series


@lru_cache(maxsize=32)
def filter_ends(filters: Filters) -> Ends:
    """Return the values of filters at z = 1 and -1."""
    position, velocity = factors_of(filters)
    at_minus_one = [
        _value([(turned(above), turned(below)) for above, below in chain])
        for chain in (position, velocity)
    ]
    lost = 2.0**-49
    for above, below in (*position, *velocity):
        for part in (above, below, turned(above), turned(below)):
            value = float(abs(reduce(DoubleDouble.__add__, part).hi))
            # A value of exactly 0 is one of coefficients that cancel exactly.
            lost += 2.0**-50 + (2.0**-94 * float(size_of(part)) / value if value else 0.0)
    return Ends(_value(position), (at_minus_one[0], at_minus_one[1]), lost)


def filter_models(
    filters: Filters, theta: Cells, half: Float64[np.ndarray, "variable patch"]
) -> FilterModels:
    """Return models over patches of theta, which is the first of their variables."""
    cells, parts = filter_cells(filters), _part_cells(filters)
    number = cell_numbers(cells, theta)
    offset = theta - cells.middle[number]
    series = parts.series[number].T  # (order, 4, patch)
    derivatives = []
    for k in range(3):
        total = np.zeros_like(series[0])
        for order in range(len(series) - 1, k - 1, -1):
            total = total * offset + factorial(order) / factorial(order - k) * series[order]
        derivatives.append(total)
    lost = parts.lost[number].T.reshape(3, 4, -1)
    steep = largest_within(parts.steepness, cells, theta, half[0]).reshape(2, 4, -1)
    still = np.zeros((len(half) - 1, len(theta)))

    def model(part: int, k: int) -> LinearModel:
        rest = 0.5 * steep[k, part] * half[0] ** 2 + lost[k, part] + half[0] * lost[k + 1, part]
        slope = np.concatenate([derivatives[k + 1][None, part], still])
        return LinearModel(derivatives[k][part], slope, rest, half)

    return FilterModels(*(Moving(model(part, 0), model(part, 1)) for part in range(4)))


def _value(chain: list[Factor]) -> float:
    """Return a function at z = 1."""
    quotients = (
        reduce(DoubleDouble.__add__, above) / reduce(DoubleDouble.__add__, below)
        for above, below in chain
    )
    return float(reduce(DoubleDouble.__mul__, quotients, _ONE).rounded())


@lru_cache(maxsize=32)
def _part_cells(filters: Filters) -> _PartCells:
    cells = filter_cells(filters)
    half = cells.half * _OVERLAP
    narrow, wide = (
        [part for chain in factors_of(filters) for part in _parts(chain, cells.middle, half, whole)]
        for whole in (False, True)
    )
    lost = [lost_of(*both, half, k) for k in range(3) for both in zip(narrow, wide, strict=True)]
    return _PartCells(
        series=np.stack([part.value[:-1].T for part in narrow], axis=1),
        lost=np.stack(lost, axis=-1),
        steepness=largest_from(
            np.stack([factorial(k) * bound_of(f, k) for k in (2, 3) for f in wide], axis=-1)
        ),
    )


def _parts(chain: list[Factor], middle: Cells, half: Cells, is_wide: bool) -> tuple[Series, Series]:
    """Return rise and slope of a function."""
    rows = np.zeros((2, 2, ORDERS, len(middle)))
    is_first, is_last = middle < _NEAR, middle > np.pi - _NEAR
    for function, which in (
        (_next_to_one, is_first),
        (_between, ~is_first & ~is_last),
        (_next_to_minus_one, is_last),
    ):
        with np.errstate(invalid="ignore"):
            some = function(chain, middle[which], half[which], is_wide)
        for part, series in zip(rows, some, strict=True):
            part[0][:, which], part[1][:, which] = series.value, series.error
    return Series(*rows[0]), Series(*rows[1])


def _next_to_one(
    chain: list[Factor], middle: Cells, half: Cells, is_wide: bool
) -> tuple[Series, Series]:
    parts = _Algebra.over(middle, half, is_wide).product(chain)
    return parts.rise, parts.slope


def _between(
    chain: list[Factor], middle: Cells, half: Cells, is_wide: bool
) -> tuple[Series, Series]:
    h, sine, function = _real_and_imaginary(chain, middle, half, is_wide)
    slope = function[1] * sine.reciprocal()
    zero = function[0] + _negative(h * slope + constant(_value(chain), len(middle)))
    return zero * h.reciprocal(), slope


def _real_and_imaginary(
    chain: list[Factor], middle: Cells, half: Cells, is_wide: bool
) -> tuple[Series, Series, tuple[Series, Series]]:
    """Return h, the sine, and both parts of the function."""
    circle = Circle.of(middle, half, is_wide)
    step, whole = circle.step, circle.product(chain)
    value = whole.value.astype(np.complex128)
    parts = Series(value.real, whole.error), Series(value.imag, whole.error)
    return Series(step.value.real, step.error), Series(step.value.imag, step.error), parts


def _next_to_minus_one(
    chain: list[Factor], middle: Cells, half: Cells, is_wide: bool
) -> tuple[Series, Series]:
    """Return the parts from those of the function of -z, of theta' = pi - theta.

    With s' = 1 + 1/z a function zero' + slope' s' is zero' + 2 slope' - slope' s.
    """
    mirror = _Algebra.over((np.pi - middle) + PI_REST, half, is_wide)
    parts = mirror.product([(turned(above), turned(below)) for above, below in chain])
    count = len(middle)
    zero = _backwards(mirror.zero(parts) + parts.slope * constant(2.0, count))
    step = Circle.of(middle, half, is_wide).step
    h = Series(step.value.real, step.error)
    rise = (zero + constant(-_value(chain), count)) * h.reciprocal()
    return rise, _backwards(_negative(parts.slope))


class _Algebra(NamedTuple):
    """Arithmetic with parts over cells next to z = 1."""

    circle: Circle
    h: Series

    @classmethod
    def over(cls, middle: Cells, half: Cells, is_wide: bool) -> "_Algebra":
        circle = Circle.of(middle, half, is_wide)
        return cls(circle, Series(circle.step.value.real, circle.step.error))

    def product(self, chain: list[Factor]) -> _Parts:
        """Return the parts of a product of factors."""
        nothing = self.number(0.0)
        parts = _Parts(_ONE, nothing, nothing)
        for above, below in chain:
            parts = self.times(parts, self.polynomial(above))
            if len(below) > 1:
                parts = self.times(parts, self.inverse(below))
        return parts

    def polynomial(self, ascending: Polynomial) -> _Parts:
        """Return the parts of a polynomial in 1/z, lowest power first."""
        one = reduce(DoubleDouble.__add__, ascending)
        if len(ascending) > 3:
            middle, half = self.circle.middle, self.circle.half
            sums = (
                power_sum(weights, middle, half)[self.circle.is_wide]
                for weights in _cosines(ascending)
            )
            return _Parts(one, *(Series(each.value.real, each.error) for each in sums))
        zero = DoubleDouble(0.0, 0.0)
        _, first, second = (*ascending, zero, zero)[:3]
        bend = self.circle.known(second.scaled(2.0), ascending)
        straight = self.circle.known(-(first + second.scaled(2.0)), ascending)
        return _Parts(one, _negative(bend), straight + bend * self.h)

    def inverse(self, below: Polynomial) -> _Parts:
        """Return the parts of the reciprocal of a polynomial."""
        one, rise, slope = self.polynomial(below)
        whole = self.circle.polynomial(below)
        conjugate = Series(whole.value.conj(), whole.error)
        norm = whole * conjugate
        over_norm = Series(norm.value.real, norm.error).reciprocal()
        double = self.number(2.0)
        fall = rise * (self.zero(_Parts(one, rise, slope)) + double * self.h * slope)
        fall = fall + double * slope * slope
        inverse = _ONE / one
        over_one = self.circle.known(-inverse, (inverse,))
        return _Parts(inverse, fall * over_norm * over_one, _negative(slope * over_norm))

    def times(self, one: _Parts, other: _Parts) -> _Parts:
        """Return the parts of a product."""
        a, b = (self.circle.known(each.one, (each.one,)) for each in (one, other))
        both = one.slope * other.slope
        rise = one.rise * b + other.rise * a + self.h * one.rise * other.rise
        rise = rise + both * self.number(-2.0)
        slope = self.zero(one) * other.slope + self.zero(other) * one.slope
        slope = slope + self.number(2.0) * self.h * both
        return _Parts(one.one * other.one, rise, slope)

    def zero(self, parts: _Parts) -> Series:
        """Return one + h rise."""
        return self.circle.known(parts.one, (parts.one,)) + self.h * parts.rise

    def number(self, value: float) -> Series:
        """Return the series of an exact number."""
        return constant(value, len(self.circle.middle))


def _cosines(ascending: Polynomial) -> tuple[list[float], list[float]]:
    """Return weights of cosines of the rise and the slope of a polynomial in 1/z.

    With U_k = sin((k + 1) theta)/sin(theta), 1/z^k is U_(k-1) - U_(k-2) - U_(k-1) s, and a U is a
    sum of cosines; (cos(k theta) - 1)/h is minus k and twice those below k, weighted (Fejer).
    """
    count = len(ascending)
    weights = [Fraction(float(pair.hi)) + Fraction(float(pair.lo)) for pair in ascending]
    zero, slope, rise = ([Fraction(0)] * count for _ in range(3))
    zero[0] = weights[0]
    for power, weight in enumerate(weights):
        for k in range(power - 1, -power, -2):
            zero[abs(k)] += weight
            slope[abs(k)] -= weight
        for k in range(power - 2, 1 - power, -2):
            zero[abs(k)] -= weight
    for k in range(1, count):
        rise[0] -= k * zero[k]
        for order in range(1, k):
            rise[order] -= 2 * (k - order) * zero[k]
    return list(map(float, rise)), list(map(float, slope))


def _negative(series: Series) -> Series:
    return Series(-series.value, series.error)


def _backwards(series: Series) -> Series:
    """Return the series of f(-x)."""
    signs = np.where(np.arange(ORDERS) % 2, -1.0, 1.0)[:, None]
    return Series(series.value * signs, series.error)
