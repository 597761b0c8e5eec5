"""What a velocity estimator and a position filter do on the unit circle, cell by cell.

With s = 1 - 1/z and h = 1 - cos(theta), s^2 = 2 h s - 2 h, so on the circle every rational function
of z with real coefficients is p0 + p1 s with real p0, p1 that are functions of h alone. Written as

    one + h rise + slope s,        one = its value at z = 1,

products and quotients lose no digits near z = 1. A filter is a chain of short factors; Taylor
series of all factors over cells of theta give series of the whole, with bounds of the remainder and
of the derivatives (lemma B10 of docs/proofs.md). Cells are halved until the series are good to
rounding.
"""

from fractions import Fraction
from functools import lru_cache, reduce
from math import factorial, perm
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.boxes.series import ORDERS, Cells, Series, constant, cosine_sum, difference, versine
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filters
from jaxstab.model.transfer import ONE, Polynomial, Transfer, size_of

BEYOND = 0.125  # cells reach so far beyond 0 and pi
_FIRST_CELLS = 128
_MOST_HALVINGS = 24
_MOST_CELLS = 1 << 15
_REMAINDER = 2.0**-52  # of the values of a cell, by which the series may miss them
_EPS = np.finfo(np.float64).eps
_OVERLAP = 1.0 + 1e-9  # what is known of a cell holds a little beyond, for rounded ends
_PAIRS_LOST = 2.0**-94  # of the size of a polynomial, by its coefficients in pairs
_ZERO, _ONE = DoubleDouble(0.0, 0.0), DoubleDouble(1.0, 0.0)


class FilterCells(NamedTuple):
    """Cells of theta over [-BEYOND, pi + BEYOND], ascending; position filter first, then velocity.

    middle, half, first: of the cells; ``first`` is the lower end.
    series: Taylor coefficients of P and V in each cell, complex, lowest order first.
    lost: bounds of what the sums of these series have lost, and their derivatives.
    steepness: bounds of |P'|, |V'|, |P''| and |V''| in 2^k cells from each one on, for k from 0 on.
    at_one: P(1).
    real: Taylor coefficients of rise and slope of P and V, in this order.
    real_lost: bounds of what the sums of these have lost, and their first two derivatives.
    real_steepness: bounds of their second and third derivatives, as in ``steepness``.
    """

    middle: Cells
    half: Cells
    first: Cells
    series: np.ndarray  # (cell, 2, order)
    lost: Float64[np.ndarray, "cell 4"]
    steepness: Float64[np.ndarray, "level cell 4"]
    at_one: float
    real: Float64[np.ndarray, "cell 4 order"]
    real_lost: Float64[np.ndarray, "cell 4 3"]
    real_steepness: Float64[np.ndarray, "level cell 8"]


class _Pair(NamedTuple):
    """A function one + h rise + slope s over cells; ``one`` has lost less than 2^-50 of itself."""

    one: DoubleDouble
    rise: Series
    slope: Series


class _Circle(NamedTuple):
    """Cells, with h and s in them: in their middles, or in all of them."""

    middle: Cells
    half: Cells
    is_wide: bool
    h: Series
    s: Series

    @classmethod
    def of(cls, middle: Cells, half: Cells, is_wide: bool) -> "_Circle":
        h, s = (function(middle, half)[is_wide] for function in (versine, difference))
        return cls(middle, half, is_wide, h, s)

    def polynomial(self, ascending: Polynomial) -> _Pair:
        """Return a polynomial in 1/z, lowest power first."""
        one = reduce(DoubleDouble.__add__, ascending)
        lost = _PAIRS_LOST * size_of(ascending)
        if len(ascending) <= 3:
            _, q1, q2 = (*ascending, _ZERO, _ZERO)[:3]
            fixed = self._known(-(q1 + q2.scaled(2.0)), lost)
            pair = self._known(-q2.scaled(2.0), lost), fixed + self.h * self._known(q2.scaled(2.0), lost)
        else:
            sums = (cosine_sum(weights, self.middle, self.half) for weights in _cosines(ascending))
            pair = tuple(both[self.is_wide] for both in sums)
        if lost > 2.0**-53 * abs(one.hi) and one.hi != 0.0:  # nothing is known
            pair = tuple(part._replace(error=np.full_like(part.error, np.inf)) for part in pair)
        return _Pair(one, *pair)

    def _known(self, number: DoubleDouble, lost: float) -> Series:
        exact = constant(float(number.rounded()), len(self.middle))
        exact.error[0] = lost + _EPS * abs(exact.value[0])
        return exact

    def times(self, one: _Pair, other: _Pair) -> _Pair:
        """Return the product."""
        a, b = float(one.one.rounded()), float(other.one.rounded())
        one_zero, other_zero = self.h * one.rise + a, self.h * other.rise + b
        both = one.slope * other.slope
        rise = one.rise * b + other.rise * a + self.h * one.rise * other.rise + both * -2.0
        slope = one_zero * other.slope + other_zero * one.slope + self.h * both * 2.0
        return _Pair(one.one * other.one, rise, slope)

    def inverse(self, below: _Pair) -> _Pair:
        """Return the reciprocal."""
        b = float(below.one.rounded())
        zero = self.h * below.rise + b
        mixed = zero * below.slope * 2.0 + below.slope * below.slope * 2.0
        bent = below.rise * b * 2.0 + self.h * below.rise * below.rise
        norm = self.h * (bent + mixed) + b * b
        over_norm = norm.reciprocal()
        fall = below.rise * (zero + self.h * below.slope * 2.0) + below.slope * below.slope * 2.0
        rise = fall * over_norm * (-1.0 / b)
        return _Pair(DoubleDouble.of(1.0) / below.one, rise, -(below.slope * over_norm))

    def whole(self, pair: _Pair) -> Series:
        """Return the function itself."""
        return self.h * pair.rise + float(pair.one.rounded()) + self.s * pair.slope


@lru_cache(maxsize=32)
def filter_cells(filters: Filters) -> FilterCells:
    """Return what filters do on the circle; they are in units of one sample."""
    chains = _factors(filters)
    low, high = -BEYOND, np.pi + BEYOND
    edges = np.linspace(low, high, _FIRST_CELLS + 1)
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    done: list[_Known] = []
    for halving in range(_MOST_HALVINGS + 1):
        with np.errstate(invalid="ignore"):  # 0 times what has no bound
            known = _known_of(chains, middle, half)
        enough = known.is_good | (halving == _MOST_HALVINGS) | (len(middle) > _MOST_CELLS)
        done.append(known.some(enough))
        if enough.all():
            break
        middle, half = middle[~enough], 0.5 * half[~enough]
        middle, half = np.concatenate([middle - half, middle + half]), np.tile(half, 2)
    whole = _Known(*(np.concatenate(parts) for parts in zip(*done, strict=True)))
    whole = whole.some(np.argsort(whole.middle))
    at_one = reduce(DoubleDouble.__mul__, (_at_one(*factor) for factor in chains[0]), _ONE)
    return FilterCells(
        middle=whole.middle,
        first=np.append(low, 0.5 * (whole.middle[1:] - whole.half[1:] + whole.middle[:-1] + whole.half[:-1])),
        half=whole.half,
        series=whole.series,
        lost=whole.lost,
        steepness=_largest_from(whole.steepness),
        at_one=float(at_one.rounded()),
        real=whole.real,
        real_lost=whole.real_lost,
        real_steepness=_largest_from(whole.real_steepness),
    )


class _Known(NamedTuple):
    """What is known of some cells, as in ``FilterCells``, the cell on the first axis."""

    middle: Cells
    half: Cells
    is_good: np.ndarray
    series: np.ndarray
    lost: np.ndarray
    steepness: np.ndarray
    real: np.ndarray
    real_lost: np.ndarray
    real_steepness: np.ndarray

    def some(self, which: np.ndarray) -> "_Known":
        """Return some cells, or all in another order."""
        return _Known(*(part[which] for part in self))


Factor = tuple[Polynomial, Polynomial]  # numerator and denominator in 1/z, lowest power first


def _known_of(chains: tuple[list[Factor], list[Factor]], middle: Cells, size: Cells) -> _Known:
    half = size * _OVERLAP
    pairs = []
    for is_wide in (False, True):
        circle = _Circle.of(middle, half, is_wide)
        both = [_chained(circle, chain) for chain in chains]
        parts = [part for pair in both for part in (pair.rise, pair.slope)]
        pairs.append([*map(circle.whole, both), *parts])
    narrow, wide = pairs
    lost = [[_lost(one, all_, half, k) for k in range(3)] for one, all_ in zip(narrow, wide, strict=True)]
    steep = [[_steepness(all_, k) for k in range(4)] for all_ in wide]
    remainders = np.stack([_remainder(all_, half) for all_ in wide])
    sizes = np.stack([abs(all_.value[0]) + all_.error[0] for all_ in wide])
    rows = np.stack([part.value[:-1] for part in narrow[2:]]).astype(float)
    return _Known(
        middle=middle,
        half=size,
        is_good=np.all(remainders <= _REMAINDER * sizes, axis=0),
        series=np.moveaxis(np.stack([part.value[:-1] for part in narrow[:2]]), 2, 0),
        lost=np.stack([lost[0][0], lost[1][0], lost[0][1], lost[1][1]], axis=-1),
        steepness=np.stack([steep[0][1], steep[1][1], steep[0][2], steep[1][2]], axis=-1),
        real=np.moveaxis(rows, 2, 0),
        real_lost=np.moveaxis(np.array(lost[2:]), 2, 0),
        real_steepness=np.stack([steep[f][k] for k in (2, 3) for f in range(2, 6)], axis=-1),
    )


def _remainder(wide: Series, half: Cells) -> Cells:
    return (abs(wide.value[-1]) + wide.error[-1]) * half ** (ORDERS - 1)


def _lost(narrow: Series, wide: Series, half: Cells, derivative: int) -> Cells:
    """Bound what the sum of a series, or of its derivative, has lost."""
    total = np.zeros_like(half)
    for k in range(derivative, ORDERS):
        rounding = narrow.error[k] + 2 * ORDERS * _EPS * abs(narrow.value[k])
        error = rounding if k < ORDERS - 1 else abs(wide.value[k]) + wide.error[k]
        total += perm(k, derivative) * error * half ** (k - derivative)
    return np.where(total >= 0.0, total, np.inf)


def _steepness(wide: Series, derivative: int) -> Cells:
    bound = factorial(derivative) * (abs(wide.value[derivative]) + wide.error[derivative])
    return np.where(bound >= 0.0, bound, np.inf)


def _largest_from(cells: np.ndarray) -> np.ndarray:
    """Return the largest of 2^k rows from each one on, for each k."""
    levels, span = [cells], 1
    while 2 * span <= len(cells):
        before = levels[-1]
        longer = before.copy()
        longer[:-span] = np.maximum(before[:-span], before[span:])
        levels.append(longer)
        span *= 2
    return np.stack(levels)


def _chained(circle: _Circle, chain: list[Factor]) -> _Pair:
    pairs = []
    for above, below in chain:
        pairs.append(circle.polynomial(above))
        if len(below) > 1:
            pairs.append(circle.inverse(circle.polynomial(below)))
    nothing = constant(0.0, len(circle.middle))
    return reduce(circle.times, pairs) if pairs else _Pair(_ONE, nothing, nothing)


def _factors(filters: Filters) -> tuple[list[Factor], list[Factor]]:
    """Return short factors of P and of V, whose first one is (1 - z^-n) / n."""
    velocity, position = filters
    samples, stages = velocity.stages()
    part = DoubleDouble.of(1.0) / float(samples)
    difference_over = (part, *(_ZERO,) * (samples - 1), -part)
    of_velocity = [(difference_over, ONE), *map(_in_lags, stages)]
    return [_in_lags(stage) for stage in position.stages()], of_velocity


def _in_lags(transfer: Transfer) -> Factor:
    """Return numerator and denominator in powers of 1/z."""
    above, below, lag = transfer[:3]
    return (_ZERO,) * (lag + len(below) - len(above)) + above, below


def _at_one(above: Polynomial, below: Polynomial) -> DoubleDouble:
    one, other = (reduce(DoubleDouble.__add__, part) for part in (above, below))
    return one / other


def _cosines(ascending: Polynomial) -> tuple[list[float], list[float]]:
    """Return weights of cosines of the rise and the slope of a polynomial in 1/z.

    With U_k = sin((k + 1) theta)/sin(theta), 1/z^k is U_(k-1) - U_(k-2) - U_(k-1) s.
    """
    count = len(ascending)
    zero, slope = [Fraction(0)] * count, [Fraction(0)] * count
    for power, pair in enumerate(ascending):
        weight = Fraction(float(pair.hi)) + Fraction(float(pair.lo))
        for k in range(power - 1, -power, -2):
            zero[abs(k)] += weight
            slope[abs(k)] -= weight
        for k in range(power - 2, 1 - power, -2):
            zero[abs(k)] -= weight
    zero[0] += Fraction(float(ascending[0].hi)) + Fraction(float(ascending[0].lo))
    rise = [Fraction(0)] * count
    for k in range(1, count):  # (cos(k theta) - 1) / h
        rise[0] -= k * zero[k]
        for order in range(1, k):
            rise[order] -= 2 * (k - order) * zero[k]
    return list(map(float, rise)), list(map(float, slope))
