"""Functions over whole cells as polynomials of second order, with proved bounds of what they leave.

A quadratic stands for every function f of x_1 ... x_5 in [-1, 1] with

    |f(x) - constant - sum_i a_i x_i - sum_(i <= j) b_ij x_i x_j| <= rest,

and sums and products of quadratics are quadratics of the results (Taylor models of second order;
Makino, Berz 1996). Rounding is counted with the rest. The variables are alpha, beta, gamma, delta
and delay, each as its distance from the middle of the cell over half its width.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

VARIABLES = 5

FIRST, SECOND = np.triu_indices(VARIABLES)

"""The two variables of each term of second order."""

TERMS = 1 + VARIABLES + FIRST.size

PLACES = {
    (int(i), int(j)): 1 + VARIABLES + n for n, (i, j) in enumerate(zip(FIRST, SECOND, strict=True))
}

"""Where the term of two variables, the first not after the second, is among all terms."""

_LINES = slice(1, 1 + VARIABLES)

_CURVES = slice(1 + VARIABLES, TERMS)

_MIXED = (FIRST != SECOND)[:, None]

_ROUNDING = 16 * np.finfo(np.float64).eps  # of the sum of all terms: more than one operation loses


@dataclass(frozen=True)
class Quadratic:
    """A function over cells.

    Attributes:
        terms: constant, linear and quadratic terms, (TERMS, cell).
        rest: bound of what these leave, (cell).
    """

    terms: Array
    rest: Array

    @classmethod
    def constant(cls, value: Array) -> "Quadratic":
        """Return numbers, one for each cell, as functions."""
        terms = np.zeros((TERMS, value.size))
        terms[0] = value
        return cls(terms, np.zeros(value.size))

    @property
    def middle(self) -> Array:
        """The value in the middle, up to the rest."""
        middle: Array = self.terms[0]
        return middle

    @property
    def swing(self) -> Array:
        """How far the function can be from its constant."""
        swing: Array = np.abs(self.terms[1:]).sum(axis=0) + self.rest
        return swing

    @property
    def size(self) -> Array:
        """A bound of its absolute value."""
        return np.abs(self.middle) + self.swing

    @property
    def low(self) -> Array:
        """A lower bound."""
        return self.middle - self.swing

    def __add__(self, other: "Quadratic") -> "Quadratic":
        return _rounded(self.terms + other.terms, self.rest + other.rest)

    def __neg__(self) -> "Quadratic":
        return Quadratic(-self.terms, self.rest)

    def __sub__(self, other: "Quadratic") -> "Quadratic":
        return self + -other

    def plus(self, numbers: Array) -> "Quadratic":
        """Return the sum with one number for each cell."""
        terms = self.terms.copy()
        terms[0] += numbers
        return _rounded(terms, self.rest)

    def times(self, numbers: Array) -> "Quadratic":
        """Return the product with one number for each cell."""
        return _rounded(self.terms * numbers, self.rest * np.abs(numbers))

    def __mul__(self, other: "Quadratic") -> "Quadratic":
        one, two = self.terms, other.terms
        terms = one[0] * two + two[0] * one
        terms[0] -= one[0] * two[0]
        a, b = one[_LINES], two[_LINES]
        terms[_CURVES] += a[FIRST] * b[SECOND] + _MIXED * (a[SECOND] * b[FIRST])
        constant, lines, curves = _sizes(one)
        constant_2, lines_2, curves_2 = _sizes(two)
        rest = lines * curves_2 + curves * (lines_2 + curves_2)
        rest += (constant + lines + curves) * other.rest
        rest += (constant_2 + lines_2 + curves_2 + other.rest) * self.rest
        return _rounded(
            terms, rest, (constant + lines + curves) * (constant_2 + lines_2 + curves_2)
        )

    def root(self) -> "Quadratic":
        """Return the square root; of infinite rest where the function may vanish."""
        middle = np.where(self.middle > 0.0, self.middle, 1.0)
        part = self.times(1.0 / middle).plus(-np.ones_like(middle))  # f = middle (1 + part)
        swing = part.size
        is_known = (self.middle > 0.0) & (swing < 0.5)
        # The third derivative of the root of 1 + u, over 6, is (1 + u)^(-5/2) / 16.
        left = np.where(is_known, swing**3 / 16.0 * (1.0 - np.minimum(swing, 0.5)) ** -2.5, np.inf)
        half, eighth = np.full_like(middle, 0.5), np.full_like(middle, -0.125)
        series = part.times(half) + (part * part).times(eighth)
        series = Quadratic(series.terms, series.rest + left).plus(np.ones_like(middle))
        return series.times(np.sqrt(middle))


def _sizes(terms: Array) -> tuple[Array, Array, Array]:
    sizes = np.abs(terms)
    return sizes[0], sizes[_LINES].sum(axis=0), sizes[_CURVES].sum(axis=0)


def _rounded(terms: Array, rest: Array, size: Array | None = None) -> Quadratic:
    """Return a result of arithmetic with what is lost by rounding: a share of ``size``."""
    lost = np.abs(terms).sum(axis=0) if size is None else size
    return Quadratic(terms, rest * (1.0 + _ROUNDING) + _ROUNDING * lost)
