"""Functions over whole boxes, with proved bounds: a value, slopes, and a remainder.

A linear model stands for every function f with

    |f(x) - centre - sum_k slope_k dx_k| <= rest        for all |dx_k| <= half_k,

and arithmetic with models gives models of the results (Taylor models of first order; Makino, Berz
1996). Rounding is counted with the rest. In batches, real or complex. NumPy only.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

Floats = Any  # real or complex arrays
Number = Any  # the same, or one number

_ROUNDING = 32 * np.finfo(np.float64).eps  # of the largest term: no operation below has 32


@dataclass(frozen=True)
class LinearModel:
    """A function over boxes of half-widths ``half``; where no bound is known, ``rest`` is infinite.

    Attributes:
        centre: value in the middle of each box, shape (*box).
        slope: derivatives there, (variable, *box).
        rest: bound of what these leave, (*box).
        half: half-widths of the boxes, (variable, *box).
        has_products: whether the variables are x_1 ... x_n, t, the square of t less half of its
            largest value, and t x_1 ... t x_n. If so, arithmetic keeps these products; otherwise
            they count as remainder.
    """

    centre: Floats
    slope: Floats
    rest: Floats
    half: Floats
    has_products: bool = False

    @property
    def swing(self) -> Floats:
        """How far the function can be from its centre."""
        return self._sloped + self.rest

    @property
    def size(self) -> Floats:
        """A bound of its absolute value."""
        return abs(self.centre) + self.swing

    @property
    def low(self) -> Floats:
        """A lower bound of a real function."""
        return self.centre - self.swing

    @property
    def high(self) -> Floats:
        """An upper bound of a real function."""
        return self.centre + self.swing

    def some(self, boxes: Any) -> "LinearModel":
        """Return the models of chosen boxes: an index of numbers, of truth values, or a slice."""
        parts = self.centre[boxes], self.slope[:, boxes], self.rest[boxes], self.half[:, boxes]
        return LinearModel(*parts, self.has_products)

    @staticmethod
    def joined(models: "list[LinearModel]") -> "LinearModel":
        """Return the models of the boxes of one, then of the next, all in the same variables."""
        centre, slope, rest, half = (
            np.concatenate([getattr(model, name) for model in models], axis=-1)
            for name in ("centre", "slope", "rest", "half")
        )
        return LinearModel(centre, slope, rest, half, models[0].has_products)

    def __add__(self, other: "LinearModel | Number") -> "LinearModel":
        if not isinstance(other, LinearModel):
            return self._with(self.centre + other, self.slope, self.rest)
        rest = self.rest + other.rest
        return self._like(other)._with(self.centre + other.centre, self.slope + other.slope, rest)

    def __neg__(self) -> "LinearModel":
        return self._of(-self.centre, -self.slope, self.rest)

    def __sub__(self, other: "LinearModel | Number") -> "LinearModel":
        return self.__add__(-other)

    def __rsub__(self, other: Number) -> "LinearModel":
        return (-self).__add__(other)

    def __mul__(self, other: "LinearModel | Number") -> "LinearModel":
        if not isinstance(other, LinearModel):
            return self._with(self.centre * other, self.slope * other, self.rest * abs(other))
        slope = self.centre * other.slope + other.centre * self.slope
        with np.errstate(invalid="ignore"):  # what has no bound has none when it is taken 0 times
            rest = abs(self.centre) * other.rest + self.rest * other.size
            rest = rest + self._sloped * other.swing
            product, like = self.centre * other.centre, self._like(other)
            if like.has_products:
                products = _products(self.slope, other.slope)
                product, slope, rest = like._with_products(products, product, slope, rest)
        rest = np.where(rest >= 0.0, rest, np.inf)
        return like._with(product, slope, rest)

    __radd__ = __add__
    __rmul__ = __mul__

    def reciprocal(self) -> "LinearModel":
        """Return 1/f; unbounded where f may vanish."""
        clear = abs(self.centre) - self.swing
        is_known = clear > 0.0
        clear, centre = np.where(is_known, clear, 1.0), np.where(is_known, self.centre, 1.0)
        square, size = centre**2, abs(centre) ** 2
        inverse, slope = 1.0 / centre, -self.slope / square
        if self.has_products:
            products = (part * inverse**3 for part in _products(self.slope, self.slope))
            rest = self.swing**2 / (size * abs(centre))
            inverse, slope, rest = self._with_products(tuple(products), inverse, slope, rest)
            rest = rest + self.swing**3 / (size * abs(centre) * clear)
        else:
            rest = self.swing**2 / (size * clear)
        known = self._with(inverse, slope, rest + self.rest / size)
        return self._of(known.centre, known.slope, np.where(is_known, known.rest, np.inf))

    def is_off(self, low: Number, high: Number) -> Floats:
        """Return where a real function is proved to be outside an interval."""
        return (self.high < low) | (self.low > high)

    @cached_property
    def _sloped(self) -> Floats:
        return (abs(self.slope) * self.half).sum(axis=0)

    def _with(self, centre: Floats, slope: Floats, rest: Floats) -> "LinearModel":
        """Return a result of arithmetic on the same boxes, with its rounding."""
        exact = self._of(centre, slope, rest)
        rounded = self._of(centre, slope, rest + _ROUNDING * exact.size)
        vars(rounded)["_sloped"] = exact._sloped  # the slopes are the same
        return rounded

    def _of(self, centre: Floats, slope: Floats, rest: Floats) -> "LinearModel":
        return LinearModel(centre, slope, rest, self.half, self.has_products)

    def _like(self, other: "LinearModel") -> "LinearModel":
        """Return one of two models of the same boxes, if possible one that keeps products."""
        return other if other.has_products else self

    def _with_products(
        self, products: tuple[Floats, Floats, Floats], centre: Floats, slope: Floats, rest: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Put products of t with the variables from what is left into their own variables.

        The slope is changed in place.
        """
        square, *parts = products
        t = len(self.half) // 2 - 1
        half, halves = self.half[t + 1], self.half[t + 2 :]
        slope[t + 1] += square
        for part in parts:
            slope[t + 2 :] += part
        taken = 2.0 * abs(square) * half + ((abs(parts[0]) + abs(parts[1])) * halves).sum(axis=0)
        rest = rest * (1.0 + _ROUNDING) - taken
        return centre + square * half, slope, rest


def _products(one: Floats, other: Floats) -> tuple[Floats, Floats, Floats]:
    """Return coefficients of the square of t in a product, and twice those of t and the others."""
    t = len(one) // 2 - 1
    return one[t] * other[t], one[t] * other[:t], one[:t] * other[t]


@dataclass(frozen=True)
class Moving:
    """A function of boxes, and its derivative by one of the variables."""

    value: LinearModel
    rate: LinearModel

    def __add__(self, other: "Moving | LinearModel | Number") -> "Moving":
        if isinstance(other, Moving):
            return Moving(self.value + other.value, self.rate + other.rate)
        return Moving(self.value + other, self.rate)

    def __neg__(self) -> "Moving":
        return Moving(-self.value, -self.rate)

    def __sub__(self, other: "Moving | LinearModel | Number") -> "Moving":
        return self + -other

    def __rsub__(self, other: LinearModel | Number) -> "Moving":
        return -self + other

    def __mul__(self, other: "Moving | LinearModel") -> "Moving":
        if isinstance(other, Moving):
            rate = self.value * other.rate + other.value * self.rate
            return Moving(self.value * other.value, rate)
        return Moving(self.value * other, self.rate * other)

    def reciprocal(self) -> "Moving":
        """Return 1/f; unbounded where f may vanish."""
        inverse = self.value.reciprocal()
        return Moving(inverse, -(self.rate * inverse * inverse))
