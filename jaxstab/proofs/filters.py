"""The responses of velocity estimator and position filter on the unit circle, cell by cell.

Proofs over boxes evaluate P and V in thousands of intervals of theta, with their first derivatives
and bounds of the second. So they are expanded once: a filter is a chain of short factors, and
Taylor series of all factors over cells of theta give series of the whole, with bounds of their
remainders and of the derivatives (``Series``, ``cells_of``; lemma B10 of docs/proofs.md). Factors
of first and second order are written in powers of 1 - 1/z next to z = 1, and of 1 + 1/z next to -1,
where poles and zeros are and a sum of powers of 1/z would cancel. Cells are halved until the
series are good to rounding; an interval then takes the series of the cell that holds its middle,
and the largest bounds of all cells that it meets, from a table by powers of two
(``largest_within``).

Two forms of the result follow: linear models of any functions in cells (``OverCells``), and the
real parts of P and V that the closed form of the curve takes (``filter_models``, lemma B12).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, reduce
from math import comb, factorial, perm
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from jaxstab.arrays import PI_REST, joined, take
from jaxstab.boxes.enclosures import LinearModel, Moving
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filters, Polynomial, size_of
from jaxstab.region.on_circle import Factor, factors_of
from jaxstab.rounding import EPS, OVERLAP, RAISED_SERIES, SERIES, SHIFTED

# Taylor series of functions of one angle over many cells, each coefficient with its error.
#
# In each cell, a series states |f^(k)(x)/k! - value_k| <= error_k for a function f. If x is the
# middle of the cell alone, the errors are those of rounding; if x is any point of the cell, they
# include the change of the derivatives, so |value_k| + error_k bounds these (Moore 1966). Products
# and quotients of series are series again.

Cells = Float64[np.ndarray, " cell"]

Numbers = Float64[np.ndarray, "order cell"] | Complex128[np.ndarray, "order cell"]

ORDERS = 9  # coefficients that a series has
_BEYOND = 16  # further derivatives of a cosine sum, which bound its change in a cell


@dataclass(frozen=True)
class Series:
    """Coefficients, shape (order, cell), and bounds of their errors."""

    value: Numbers
    error: Float64[np.ndarray, "order cell"]

    def __add__(self, other: "Series") -> "Series":
        value = self.value + other.value
        return Series(value, RAISED_SERIES * (self.error + other.error + EPS * abs(value)))

    def __mul__(self, other: "Series") -> "Series":
        size = abs(other.value)
        error = _convolved(self.error, size + other.error)
        error += _convolved(abs(self.value), other.error + SERIES * size)
        return Series(_convolved(self.value, other.value), RAISED_SERIES * error)

    def mirrored(self) -> "Series":
        """Return the conjugate of f as a function of pi less its variable."""
        signs = np.where(np.arange(ORDERS) % 2, -1.0, 1.0)[:, None]
        return Series(self.value.conj() * signs, self.error)

    def or_better(self, other: "Series") -> "Series":
        """Return, in each cell, the one of two series of f whose value is known better."""
        is_better = other.error[0] < self.error[0]
        value, error = np.where(is_better, other.value, self.value), self.error
        return Series(value, np.where(is_better, other.error, error))

    def reciprocal(self) -> "Series":
        """Return 1/f; its errors are infinite where f may vanish."""
        size = abs(self.value[0])
        clear = size - self.error[0]
        is_known = clear > 0.0
        leading = 1.0 / np.where(is_known, self.value[0], 1.0)
        value, error = np.zeros_like(self.value), np.zeros_like(self.error)
        value[0] = leading
        relative = self.error[0] / np.where(is_known, clear, 1.0) + SERIES
        error[0] = np.where(is_known, abs(leading) * relative, np.inf)
        for k in range(1, len(value)):  # the sum of self_i over_(k - i), i from 1 on, is 0
            after, after_error = self.value[1 : k + 1], self.error[1 : k + 1]
            before, before_error = value[:k][::-1], error[:k][::-1]
            total = np.sum(after * before, axis=0)
            errors = after_error * (abs(before) + before_error)
            errors = errors + abs(after) * (before_error + SERIES * abs(before))
            total_error = np.sum(errors, axis=0)
            value[k] = -leading * total
            error[k] = error[0] * (abs(total) + total_error) + abs(leading) * total_error
            error[k] = RAISED_SERIES * (error[k] + SERIES * abs(value[k]))
        return Series(value, np.where(is_known, error, np.inf))


def constant(value: float, cells: int) -> Series:
    """Return the series of a number."""
    coefficients = np.zeros((ORDERS, cells))
    coefficients[0] = value
    return Series(coefficients, np.zeros((ORDERS, cells)))


def power_sum(weights: Sequence[float], middle: Cells, half: Cells) -> tuple[Series, Series]:
    """Return sum_k weights_k e^(-i k theta): in the middle of each cell, and in all of it.

    The weights may have been rounded.
    """
    order = np.arange(len(weights), dtype=float)
    derivatives = ORDERS + _BEYOND
    powers = np.array([order**m / factorial(m) for m in range(derivatives)])
    terms = powers * np.asarray(weights)
    turns = np.array([(-1j) ** m for m in range(derivatives)])[:, None]
    value = turns * (terms @ np.exp(-1j * np.multiply.outer(order, middle)))
    rounding = EPS * (abs(terms) @ (len(weights) + 8.0 + 8.0 * order))
    error = np.broadcast_to(rounding[:, None], value.shape)
    sizes = abs(value) + error
    wide = np.zeros((ORDERS, len(middle)))
    for m in range(ORDERS):
        for k in range(m + 1, derivatives):
            wide[m] += comb(k, m) * sizes[k] * half ** (k - m)
        beyond = float(abs(terms[-1]) @ order) * comb(derivatives, m) / derivatives
        wide[m] += beyond * half ** (derivatives - m)
    value, error = value[:ORDERS], error[:ORDERS]
    return Series(value, error), Series(value, RAISED_SERIES * (error + wide))


def difference(middle: Cells, half: Cells) -> tuple[Series, Series]:
    """Return s = 1 - e^(-i theta): in the middle, and in all of a cell."""
    turned = np.exp(-1j * middle)
    value = np.stack([-((-1j) ** m) / factorial(m) * turned for m in range(ORDERS)])
    value[0] = 2.0 * np.sin(0.5 * middle) ** 2 + 1j * np.sin(middle)
    sizes = np.array([1.0 / factorial(m) for m in range(ORDERS)])[:, None]
    error = np.broadcast_to(4.0 * EPS * sizes, value.shape)
    return Series(value, error), Series(value, RAISED_SERIES * (error + sizes * half))


def _convolved(a: Numbers, b: Numbers) -> Numbers:
    total = a[0] * b
    for k in range(1, len(a)):
        total[k:] += a[k] * b[: len(a) - k]
    return total


_MARGIN = 0.125  # cells extend by this beyond 0 and pi
_FIRST_CELLS = 128
_MOST_HALVINGS = 24
_MOST_CELLS = 1 << 14
_REMAINDER = 2.0**-52  # of the values of a cell: largest error of the series
_SMALL = 2.0**-20  # of the largest value: smaller values of a filter are right relative to this
_ZERO, _ONE = DoubleDouble(0.0, 0.0), DoubleDouble(1.0, 0.0)


class FilterCells(NamedTuple):
    """Cells of theta from below 0 to beyond pi, ascending: middles, half widths and lower ends.

    ``series`` are the Taylor coefficients of P and V, lowest order first, ``error`` bounds of the
    errors of their sums, then of their derivatives; ``steepness`` bounds |P'|, |V'|, |P''| and
    |V''| in 2^k cells from each one on.
    """

    middle: Cells
    half: Cells
    low: Cells
    series: Complex128[np.ndarray, "cell function order"]
    error: Float64[np.ndarray, "cell bound"]
    steepness: Float64[np.ndarray, "k cell bound"]


Functions = Callable[[Cells, Cells, bool], list[Series]]

"""Series of functions over cells of some middles and halves: in the middles, or in all of them."""


@lru_cache(maxsize=32)
def filter_cells(filters: Filters) -> FilterCells:
    """Return the responses on the circle of filters in units of one sample."""
    chains = factors_of(filters)

    def series(middle: Cells, half: Cells, is_wide: bool) -> list[Series]:
        return [over_halves(chain, middle, half, is_wide) for chain in chains]

    return cells_of(series)


def cells_of(functions: Functions) -> FilterCells:
    """Return functions on the circle over cells, halved until the series are good to rounding."""
    edges = np.linspace(-_MARGIN, np.pi + _MARGIN, _FIRST_CELLS + 1)
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    largest: np.ndarray | float = 0.0
    done: list[_CellSeries] = []
    for halving in range(_MOST_HALVINGS + 1):
        with np.errstate(invalid="ignore"):  # 0 times what has no bound
            batch = _cell_series(functions, middle, half)
        largest = np.fmax(largest, np.nanmax(abs(batch.series[:, :, 0]), axis=0))
        enough = np.all(batch.remainder <= _REMAINDER * (batch.size + _SMALL * largest), axis=1)
        enough |= (halving == _MOST_HALVINGS) or (len(middle) > _MOST_CELLS)
        done.append(take(batch, enough))
        if enough.all():
            break
        middle, half = batch.middle[~enough], 0.5 * batch.half[~enough]
        middle, half = np.concatenate([middle - half, middle + half]), np.tile(half, 2)
    whole = joined(done)
    whole = take(whole, np.argsort(whole.middle))
    ends = whole.middle + whole.half
    return FilterCells(
        middle=whole.middle,
        half=whole.half,
        low=np.append(-_MARGIN, 0.5 * (ends[:-1] + (whole.middle - whole.half)[1:])),
        series=whole.series,
        error=whole.error,
        steepness=largest_from(whole.steepness),
    )


# --------------------------------------------------------------------------------------- series
class _CellSeries(NamedTuple):
    """Series and bounds of cells: the cell on the first axis, P and V on the next."""

    middle: Cells
    half: Cells
    remainder: np.ndarray  # what the series leave
    size: np.ndarray  # of the functions
    series: np.ndarray
    error: np.ndarray
    steepness: np.ndarray


class Circle(NamedTuple):
    """Cells of an angle, and 1 - e^(-i theta) in them: in their middles, or in all of them."""

    middle: Cells
    half: Cells
    is_wide: bool
    step: Series

    @classmethod
    def over(cls, middle: Cells, half: Cells, is_wide: bool) -> "Circle":
        """Return cells with the step in them."""
        return cls(middle, half, is_wide, difference(middle, half)[is_wide])

    def product(self, chain: list[Factor]) -> Series:
        """Return the product of all factors."""
        series = []
        for above, below in chain:
            series.append(self.polynomial(above))
            if len(below) > 1:
                series.append(self.polynomial(below).reciprocal())
        return reduce(Series.__mul__, series) if series else constant(1.0, len(self.middle))

    def polynomial(self, ascending: Polynomial) -> Series:
        """Return a polynomial in e^(-i theta), lowest power first."""
        if len(ascending) > 3:
            weights = [float(c.rounded()) for c in ascending]
            return power_sum(weights, self.middle, self.half)[self.is_wide]
        c0, c1, c2 = (*ascending, _ZERO, _ZERO)[:3]
        constant_, linear, square = (
            self.coefficient(value, ascending)
            for value in (c0 + c1 + c2, -(c1 + c2.scaled(2.0)), c2)
        )
        return constant_ + self.step * (linear + self.step * square)

    def coefficient(self, value: DoubleDouble, polynomial: Polynomial) -> Series:
        """Return the series of a number formed, in pairs, from coefficients of a polynomial."""
        exact = constant(float(value.rounded()), len(self.middle))
        exact.error[0] = SHIFTED * float(size_of(polynomial)) + EPS * abs(exact.value[0])
        return exact


def _cell_series(functions: Functions, middle: Cells, size: Cells) -> _CellSeries:
    half = size * (1.0 + OVERLAP)
    narrow, wide = (functions(middle, half, is_wide) for is_wide in (False, True))
    errors = [error_of(*both, half, k) for k in range(2) for both in zip(narrow, wide, strict=True)]
    return _CellSeries(
        middle=middle,
        half=size,
        remainder=np.stack([bound_of(of_cell, ORDERS - 1) for of_cell in wide], axis=-1)
        * half[:, None] ** (ORDERS - 1),
        size=np.stack([abs(f.value[0]) + abs(f.value[1]) * half for f in wide], axis=-1),
        series=np.stack([f.value[:-1].T for f in narrow], axis=1).astype(np.complex128),
        error=np.stack(errors, axis=-1),
        steepness=np.stack([factorial(k) * bound_of(f, k) for k in (1, 2) for f in wide], axis=-1),
    )


def over_halves(chain: list[Factor], middle: Cells, half: Cells, is_wide: bool) -> Series:
    """Return a function of theta; next to pi it is that of -z and of pi - theta, conjugated."""
    is_near = middle < 0.5 * np.pi
    near = Circle.over(middle[is_near], half[is_near], is_wide).product(chain)
    folded = (np.pi - middle[~is_near]) + PI_REST
    mirrored = [(turned(above), turned(below)) for above, below in chain]
    far = Circle.over(folded, half[~is_near], is_wide).product(mirrored)
    value = np.empty((ORDERS, len(middle)), complex)
    error = np.empty((ORDERS, len(middle)))
    value[:, is_near], value[:, ~is_near] = near.value, far.mirrored().value
    error[:, is_near], error[:, ~is_near] = near.error, far.error
    return Series(value, error)


def turned(ascending: Polynomial) -> Polynomial:
    """Return the polynomial of -z."""
    return tuple(-c if power % 2 else c for power, c in enumerate(ascending))


def bound_of(wide: Series, order: int) -> Cells:
    """Bound a coefficient in all of each cell."""
    bound = abs(wide.value[order]) + wide.error[order]
    return np.where(bound >= 0.0, bound, np.inf)


def error_of(narrow: Series, wide: Series, half: Cells, derivative: int) -> Cells:
    """Bound the error of the sum of a series, or of its derivative."""
    total = 4.0 * EPS * factorial(derivative + 1) * bound_of(wide, derivative + 1)  # of theta
    for k in range(derivative, ORDERS - 1):
        error = narrow.error[k] + 2 * ORDERS * EPS * abs(narrow.value[k])
        total += perm(k, derivative) * error * half ** (k - derivative)
    last = ORDERS - 1
    total += perm(last, derivative) * bound_of(wide, last) * half ** (last - derivative)
    return np.where(total >= 0.0, total, np.inf)


def largest_from(
    cells: Float64[np.ndarray, "cell bound"],
) -> Float64[np.ndarray, "k cell bound"]:
    """Return the largest of 2^k rows from each one on, for each k."""
    rows, span = [cells], 1
    while 2 * span <= len(cells):
        longer = rows[-1].copy()
        longer[:-span] = np.maximum(rows[-1][:-span], rows[-1][span:])
        rows.append(longer)
        span *= 2
    return np.stack(rows)


# Functions in cells over boxes of the angle.

Reals = Float64[np.ndarray, " boxes"]


def cell_index(cells: FilterCells, theta: Reals) -> np.ndarray:
    """Return the numbers of the cells in which angles lie."""
    return np.maximum(np.searchsorted(cells.low, theta, "right") - 1, 0)


def responses(cells: FilterCells, theta: Reals) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return P and V at angles, (2, box), their derivatives, and bounds of the errors of both."""
    index = cell_index(cells, theta)
    offset = theta - cells.middle[index]
    series = cells.series[index].T  # (order, 2, box)
    value, slope = series[-1], np.zeros_like(series[0])
    for coefficient in series[-2::-1]:
        slope = slope * offset + value
        value = value * offset + coefficient
    is_inside = np.abs(offset) <= cells.half[index] * (1.0 + OVERLAP)
    return value, slope, np.where(is_inside, cells.error[index].T, np.inf)


def largest_within(
    steepness: np.ndarray, cells: FilterCells, theta: Reals, by_theta: Reals
) -> np.ndarray:
    """Return the largest of bounds of cells in theta +- by_theta; infinite beyond the cells."""
    low, high = theta - by_theta, theta + by_theta
    start, end = cell_index(cells, low), cell_index(cells, high)
    level = np.frexp(end - start + 1)[1] - 1
    largest = np.maximum(steepness[level, start], steepness[level, end + 1 - (1 << level)])
    is_inside = (low >= cells.low[0]) & (high <= cells.middle[-1] + cells.half[-1])
    bounds: np.ndarray = np.where(is_inside, largest.T, np.inf)
    return bounds


class OverCells(NamedTuple):
    """Functions of cells over boxes of the angle: in the middle with derivatives, and bounds."""

    values: np.ndarray
    slopes: np.ndarray
    bends: np.ndarray  # of the second derivatives in the boxes
    error: np.ndarray  # of the values, then of the derivatives
    by_theta: Reals

    @classmethod
    def from_cells(cls, cells: FilterCells, theta: Reals, by_theta: Reals) -> "OverCells":
        """Return the functions of cells over boxes."""
        values, slopes, errors = responses(cells, theta)
        steep = largest_within(cells.steepness, cells, theta, by_theta)
        return cls(values, slopes, steep[len(values) :], errors, by_theta)

    def values_along(self, axes: int) -> list[LinearModel]:
        """Return models of the functions; the angle is the last of some axes."""
        errors, slope_errors = np.split(self.error, 2)
        rests = 0.5 * self.bends * self.by_theta**2 + errors + self.by_theta * slope_errors
        return [
            LinearModel(value, self._along(axes, slope * self.by_theta), rest, np.ones((axes, 1)))
            for value, slope, rest in zip(self.values, self.slopes, rests, strict=True)
        ]

    def rates_along(self, axes: int) -> list[LinearModel]:
        """Return models of the derivatives by the angle, without slopes."""
        rests = self.bends * self.by_theta + np.split(self.error, 2)[1]
        return [
            LinearModel(slope, self._along(axes, 0.0 * slope), rest, np.ones((axes, 1)))
            for slope, rest in zip(self.slopes, rests, strict=True)
        ]

    @staticmethod
    def _along(axes: int, moves: np.ndarray) -> np.ndarray:
        slope = np.zeros((axes, moves.size), complex)
        slope[-1] = moves
        return slope


# Estimator and position filter on the circle in real parts, as models over patches.
#
# With s = 1 - 1/z and h = 1 - cos(theta), s^2 = 2 h s - 2 h, so that on the circle every rational
# function of z with real coefficients is
#
#     at_one + h rise + slope s,
#
# at_one the value at z = 1, rise and slope real functions of h. Products and quotients of these
# parts lose no digits next to z = 1; next to z = -1 the parts of the function of -z take their
# place, and in between the parts follow from the function itself (lemma B12 of docs/proofs.md).

_NEAR = 0.25  # of 0 or pi: there products of parts lose no digits


class Ends(NamedTuple):
    """P and V at z = 1 and -1; ``error`` bounds the relative error of the values at -1."""

    position_at_one: float
    at_minus_one: tuple[float, float]
    error: float


class FilterModels(NamedTuple):
    """Rise and slope of P and V over patches."""

    position_rise: Moving
    position_slope: Moving
    velocity_rise: Moving
    velocity_slope: Moving


class _PartCells(NamedTuple):
    """Taylor coefficients of the four in the cells of ``filter_cells``, and bounds."""

    series: Float64[np.ndarray, "cell 4 order"]
    error: Float64[np.ndarray, "cell 12"]  # of the sums, then of two derivatives
    steepness: Float64[np.ndarray, "k cell 8"]  # second, then third derivatives


class _Parts(NamedTuple):
    """A function at_one + h rise + slope s in cells."""

    at_one: DoubleDouble
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
    error = 2.0**-49
    for above, below in (*position, *velocity):
        for polynomial in (above, below, turned(above), turned(below)):
            value = float(abs(reduce(DoubleDouble.__add__, polynomial).hi))
            # A value of exactly 0 is one of coefficients that cancel exactly.
            error += 2.0**-50 + (SHIFTED * float(size_of(polynomial)) / value if value else 0.0)
    return Ends(_value(position), (at_minus_one[0], at_minus_one[1]), error)


def filter_models(
    filters: Filters, theta: Cells, half: Float64[np.ndarray, "variable patch"]
) -> FilterModels:
    """Return models over patches of theta, which is the first of their variables."""
    cells, parts = filter_cells(filters), _part_cells(filters)
    index = cell_index(cells, theta)
    offset = theta - cells.middle[index]
    series = parts.series[index].T  # (order, 4, patch)
    derivatives = []
    for k in range(3):
        total = np.zeros_like(series[0])
        for order in range(len(series) - 1, k - 1, -1):
            total = total * offset + factorial(order) / factorial(order - k) * series[order]
        derivatives.append(total)
    errors = parts.error[index].T.reshape(3, 4, -1)
    steep = largest_within(parts.steepness, cells, theta, half[0]).reshape(2, 4, -1)
    still = np.zeros((len(half) - 1, len(theta)))

    def model(row: int, k: int) -> LinearModel:
        rest = 0.5 * steep[k, row] * half[0] ** 2 + errors[k, row] + half[0] * errors[k + 1, row]
        slope = np.concatenate([derivatives[k + 1][None, row], still])
        return LinearModel(derivatives[k][row], slope, rest, half)

    return FilterModels(*(Moving(model(row, 0), model(row, 1)) for row in range(4)))


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
    half = cells.half * (1.0 + OVERLAP)
    narrow, wide = (
        [f for chain in factors_of(filters) for f in _parts(chain, cells.middle, half, whole)]
        for whole in (False, True)
    )
    errors = [error_of(*both, half, k) for k in range(3) for both in zip(narrow, wide, strict=True)]
    return _PartCells(
        series=np.stack([f.value[:-1].T for f in narrow], axis=1),
        error=np.stack(errors, axis=-1),
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
            both = function(chain, middle[which], half[which], is_wide)
        for row, series in zip(rows, both, strict=True):
            row[0][:, which], row[1][:, which] = series.value, series.error
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
    circle = Circle.over(middle, half, is_wide)
    step, whole = circle.step, circle.product(chain)
    value = whole.value.astype(np.complex128)
    parts = Series(value.real, whole.error), Series(value.imag, whole.error)
    return Series(step.value.real, step.error), Series(step.value.imag, step.error), parts


def _next_to_minus_one(
    chain: list[Factor], middle: Cells, half: Cells, is_wide: bool
) -> tuple[Series, Series]:
    """The parts from those of the function of -z, of theta' = pi - theta."""
    # With s' = 1 + 1/z a function zero' + slope' s' is zero' + 2 slope' - slope' s.
    mirror = _Algebra.over((np.pi - middle) + PI_REST, half, is_wide)
    parts = mirror.product([(turned(above), turned(below)) for above, below in chain])
    count = len(middle)
    zero = _backwards(mirror.zero(parts) + parts.slope * constant(2.0, count))
    step = Circle.over(middle, half, is_wide).step
    h = Series(step.value.real, step.error)
    rise = (zero + constant(-_value(chain), count)) * h.reciprocal()
    return rise, _backwards(_negative(parts.slope))


class _Algebra(NamedTuple):
    """Arithmetic with parts over cells next to z = 1."""

    circle: Circle
    h: Series

    @classmethod
    def over(cls, middle: Cells, half: Cells, is_wide: bool) -> "_Algebra":
        circle = Circle.over(middle, half, is_wide)
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
        at_one = reduce(DoubleDouble.__add__, ascending)
        if len(ascending) > 3:
            middle, half = self.circle.middle, self.circle.half
            sums = (
                power_sum(weights, middle, half)[self.circle.is_wide]
                for weights in _cosines(ascending)
            )
            return _Parts(at_one, *(Series(each.value.real, each.error) for each in sums))
        zero = DoubleDouble(0.0, 0.0)
        _, c1, c2 = (*ascending, zero, zero)[:3]
        bend = self.circle.coefficient(c2.scaled(2.0), ascending)
        straight = self.circle.coefficient(-(c1 + c2.scaled(2.0)), ascending)
        return _Parts(at_one, _negative(bend), straight + bend * self.h)

    def inverse(self, below: Polynomial) -> _Parts:
        """Return the parts of the reciprocal of a polynomial."""
        at_one, rise, slope = self.polynomial(below)
        whole = self.circle.polynomial(below)
        conjugate = Series(whole.value.conj(), whole.error)
        norm = whole * conjugate
        over_norm = Series(norm.value.real, norm.error).reciprocal()
        double = self.number(2.0)
        fall = rise * (self.zero(_Parts(at_one, rise, slope)) + double * self.h * slope)
        fall = fall + double * slope * slope
        inverse = _ONE / at_one
        over_one = self.circle.coefficient(-inverse, (inverse,))
        return _Parts(inverse, fall * over_norm * over_one, _negative(slope * over_norm))

    def times(self, parts: _Parts, other: _Parts) -> _Parts:
        """Return the parts of a product."""
        a, b = (self.circle.coefficient(each.at_one, (each.at_one,)) for each in (parts, other))
        both = parts.slope * other.slope
        rise = parts.rise * b + other.rise * a + self.h * parts.rise * other.rise
        rise = rise + both * self.number(-2.0)
        slope = self.zero(parts) * other.slope + self.zero(other) * parts.slope
        slope = slope + self.number(2.0) * self.h * both
        return _Parts(parts.at_one * other.at_one, rise, slope)

    def zero(self, parts: _Parts) -> Series:
        """Return at_one + h rise."""
        return self.circle.coefficient(parts.at_one, (parts.at_one,)) + self.h * parts.rise

    def number(self, value: float) -> Series:
        """Return the series of an exact number."""
        return constant(value, len(self.circle.middle))


def _cosines(ascending: Polynomial) -> tuple[list[float], list[float]]:
    """Weights of cosines of the rise and the slope of a polynomial in 1/z."""
    # With U_k = sin((k + 1) theta)/sin(theta), 1/z^k is U_(k-1) - U_(k-2) - U_(k-1) s, and a U is a
    # sum of cosines; (cos(k theta) - 1)/h is minus k and twice those below k, weighted (Fejer).
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
