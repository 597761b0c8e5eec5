"""The responses of velocity estimator and position filter on the unit circle, cell by cell.

A filter is a chain of short factors. Taylor series of all factors over cells of theta give series
of the whole, with bounds of their remainders and of the derivatives (lemma B10 of docs/proofs.md).
To lose no digits, factors of first and second order are written in powers of 1 - 1/z next to z = 1,
and of 1 + 1/z next to z = -1, where poles and zeros are. Cells are halved until the series are good
to rounding.
"""

from collections.abc import Callable
from functools import lru_cache, reduce
from math import factorial, perm
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from jaxstab.arrays import PI_REST, Array
from jaxstab.boxes.series import ORDERS, Cells, Series, constant, difference, power_sum
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filters
from jaxstab.model.transfer import ONE, Polynomial, Transfer, size_of

_BEYOND = 0.125  # cells reach so far beyond 0 and pi
_FIRST_CELLS = 128
_MOST_HALVINGS = 24
_MOST_CELLS = 1 << 14
_REMAINDER = 2.0**-52  # of the values of a cell, by which the series may miss them
_SMALL = 2.0**-20  # of the largest value: a filter's smaller ones need no digits of their own
_OVERLAP = 1.0 + 1e-9  # what is known of a cell holds a little beyond, for rounded ends
_EPS = np.finfo(np.float64).eps
_PAIRS_LOST = 2.0**-94  # of the size of a polynomial, by its coefficients in pairs
_ZERO, _ONE = DoubleDouble(0.0, 0.0), DoubleDouble(1.0, 0.0)

Factor = tuple[Polynomial, Polynomial]  # numerator and denominator in 1/z, lowest power first


class FilterCells(NamedTuple):
    """Cells of theta from below 0 to beyond pi, ascending; the position filter is before V.

    Attributes:
        middle: of the cells.
        half: half their widths.
        first: their lower ends.
        series: Taylor coefficients of P and V in each cell, lowest order first.
        lost: bounds of the errors of these series' sums, then of their derivatives.
        steepness: bounds of |P'|, |V'|, |P''| and |V''| in 2^k cells from each one on.
    """

    middle: Cells
    half: Cells
    first: Cells
    series: Complex128[np.ndarray, "cell function order"]
    lost: Float64[np.ndarray, "cell bound"]
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
    """Return functions on the circle."""
    edges = np.linspace(-_BEYOND, np.pi + _BEYOND, _FIRST_CELLS + 1)
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    largest: np.ndarray | float = 0.0
    done: list[_Known] = []
    for halving in range(_MOST_HALVINGS + 1):
        with np.errstate(invalid="ignore"):  # 0 times what has no bound
            known = _known_of(functions, middle, half)
        largest = np.fmax(largest, np.nanmax(abs(known.series[:, :, 0]), axis=0))
        enough = np.all(known.remainder <= _REMAINDER * (known.size + _SMALL * largest), axis=1)
        enough |= (halving == _MOST_HALVINGS) or (len(middle) > _MOST_CELLS)
        done.append(known.some(enough))
        if enough.all():
            break
        middle, half = known.middle[~enough], 0.5 * known.half[~enough]
        middle, half = np.concatenate([middle - half, middle + half]), np.tile(half, 2)
    whole = _Known(*(np.concatenate(parts) for parts in zip(*done, strict=True)))
    whole = whole.some(np.argsort(whole.middle))
    ends = whole.middle + whole.half
    return FilterCells(
        middle=whole.middle,
        half=whole.half,
        first=np.append(-_BEYOND, 0.5 * (ends[:-1] + (whole.middle - whole.half)[1:])),
        series=whole.series,
        lost=whole.lost,
        steepness=largest_from(whole.steepness),
    )


def responses_at(filters: Filters, z: Array) -> tuple[Array, Array]:
    """Return P and V at points on the circle, of NumPy or JAX, without a bound."""
    values = []
    for chain in factors_of(filters):
        value = 1.0 + 0.0 * z
        for above, below in chain:
            one, other = (_at(part, 1.0 / z) for part in (above, below))
            value = value * one / other
        values.append(value)
    return values[0], values[1]


def _at(ascending: Polynomial, back: Array) -> Array:
    return reduce(lambda value, c: value * back + float(c.rounded()), ascending[::-1], 0.0 * back)


def factors_of(filters: Filters, sample_time: float = 1.0) -> tuple[list[Factor], list[Factor]]:
    """Return short factors of P and of T V, whose first one is (1 - z^-n) / n."""
    velocity, position = filters
    samples, stages = velocity.stages(sample_time)
    part = DoubleDouble.of(1.0) / float(samples)
    over_window = (part, *(_ZERO,) * (samples - 1), -part)
    of_velocity = [(over_window, ONE), *map(_in_lags, stages)]
    return [_in_lags(stage) for stage in position.stages(sample_time)], of_velocity


def _in_lags(transfer: Transfer) -> Factor:
    """Return numerator and denominator in powers of 1/z."""
    above, below, lag = transfer[:3]
    return (_ZERO,) * (lag + len(below) - len(above)) + above, below


# --------------------------------------------------------------------------------------- series


class _Known(NamedTuple):
    """What is known of some cells, the cell on the first axis, P and V on the next."""

    middle: Cells
    half: Cells
    remainder: np.ndarray  # what the series leave
    size: np.ndarray  # of the functions
    series: np.ndarray
    lost: np.ndarray
    steepness: np.ndarray

    def some(self, which: np.ndarray) -> "_Known":
        """Return chosen cells, in any order."""
        return _Known(*(part[which] for part in self))


class Circle(NamedTuple):
    """Cells of an angle, and 1 - e^(-i theta) in them: in their middles, or in all of them."""

    middle: Cells
    half: Cells
    is_wide: bool
    step: Series

    @classmethod
    def of(cls, middle: Cells, half: Cells, is_wide: bool) -> "Circle":
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
            weights = [float(one.rounded()) for one in ascending]
            return power_sum(weights, self.middle, self.half)[self.is_wide]
        one, first, second = (*ascending, _ZERO, _ZERO)[:3]
        constant_, linear, square = (
            self.known(number, ascending)
            for number in (one + first + second, -(first + second.scaled(2.0)), second)
        )
        return constant_ + self.step * (linear + self.step * square)

    def known(self, number: DoubleDouble, of: Polynomial) -> Series:
        """Return the series of a number that was formed from some coefficients in pairs."""
        exact = constant(float(number.rounded()), len(self.middle))
        exact.error[0] = _PAIRS_LOST * float(size_of(of)) + _EPS * abs(exact.value[0])
        return exact


def _known_of(functions: Functions, middle: Cells, size: Cells) -> _Known:
    half = size * _OVERLAP
    narrow, wide = (functions(middle, half, is_wide) for is_wide in (False, True))
    lost = [lost_of(*both, half, k) for k in range(2) for both in zip(narrow, wide, strict=True)]
    return _Known(
        middle=middle,
        half=size,
        remainder=np.stack([bound_of(of_cell, ORDERS - 1) for of_cell in wide], axis=-1)
        * half[:, None] ** (ORDERS - 1),
        size=np.stack([abs(f.value[0]) + abs(f.value[1]) * half for f in wide], axis=-1),
        series=np.stack([f.value[:-1].T for f in narrow], axis=1).astype(np.complex128),
        lost=np.stack(lost, axis=-1),
        steepness=np.stack([factorial(k) * bound_of(f, k) for k in (1, 2) for f in wide], axis=-1),
    )


def over_halves(chain: list[Factor], middle: Cells, half: Cells, is_wide: bool) -> Series:
    """Return a function of theta; next to pi it is that of -z and of pi - theta, conjugated."""
    is_near = middle < 0.5 * np.pi
    near = Circle.of(middle[is_near], half[is_near], is_wide).product(chain)
    folded = (np.pi - middle[~is_near]) + PI_REST
    mirrored = [(turned(above), turned(below)) for above, below in chain]
    far = Circle.of(folded, half[~is_near], is_wide).product(mirrored)
    value = np.empty((ORDERS, len(middle)), complex)
    error = np.empty((ORDERS, len(middle)))
    signs = np.where(np.arange(ORDERS) % 2, -1.0, 1.0)[:, None]
    value[:, is_near], value[:, ~is_near] = near.value, far.value.conj() * signs
    error[:, is_near], error[:, ~is_near] = near.error, far.error
    return Series(value, error)


def turned(ascending: Polynomial) -> Polynomial:
    """Return the polynomial of -z."""
    return tuple(-one if power % 2 else one for power, one in enumerate(ascending))


def bound_of(wide: Series, order: int) -> Cells:
    """Bound a coefficient in all of each cell."""
    bound = abs(wide.value[order]) + wide.error[order]
    return np.where(bound >= 0.0, bound, np.inf)


def lost_of(narrow: Series, wide: Series, half: Cells, derivative: int) -> Cells:
    """Bound the error of the sum of a series, or of its derivative."""
    total = 4.0 * _EPS * factorial(derivative + 1) * bound_of(wide, derivative + 1)  # of theta
    for k in range(derivative, ORDERS - 1):
        error = narrow.error[k] + 2 * ORDERS * _EPS * abs(narrow.value[k])
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
