"""Taylor series of functions of one angle over many cells, each coefficient with its error.

A series says of a function f, in each cell, |f^(k)(x)/k! - value_k| <= error_k. At the middle of the
cell alone the errors are those of rounding; for all x of the cell they hold the change of the
derivatives, too, so that value_k + error_k bounds them (Moore 1966). Products and quotients keep
what is said.
"""

from collections.abc import Sequence
from math import comb, factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

Cells = Float64[np.ndarray, " cell"]
Numbers = Float64[np.ndarray, "order cell"] | Complex128[np.ndarray, "order cell"]

ORDERS = 9  # coefficients that a series has
_BEYOND = 16  # orders by which the change of those of a cosine sum is known
_EPS = np.finfo(np.float64).eps
_ROUNDING = (ORDERS + 4) * _EPS  # of a sum of so many products, complex ones too
_OF_NUMBER = 4 * _EPS  # a number has up to six roundings of its own
_OF_ERRORS = 1.0 + 1e-13


class Series(NamedTuple):
    """Coefficients, shape (order, cell), and bounds of their errors."""

    value: Numbers
    error: Float64[np.ndarray, "order cell"]

    def __add__(self, other: "Series | float") -> "Series":  # type: ignore[override]
        if not isinstance(other, Series):
            value, error = self.value.copy(), self.error.copy()
            value[0] += other
            error[0] = _OF_ERRORS * (error[0] + _OF_NUMBER * (abs(value[0]) + abs(other)))
            return Series(value, error)
        value = self.value + other.value
        return Series(value, _OF_ERRORS * (self.error + other.error + _EPS * abs(value)))

    def __mul__(self, other: "Series | float") -> "Series":  # type: ignore[override]
        if not isinstance(other, Series):
            value = self.value * other
            return Series(value, _OF_ERRORS * (self.error * abs(other) + _OF_NUMBER * abs(value)))
        mine, others = abs(self.value), abs(other.value)
        value = _convolved(self.value, other.value)
        error = _convolved(self.error, others + other.error)
        error += _convolved(mine, other.error + _ROUNDING * others)
        return Series(value, _OF_ERRORS * error)

    __radd__ = __add__
    __rmul__ = __mul__

    def __neg__(self) -> "Series":
        return Series(-self.value, self.error)

    def reciprocal(self) -> "Series":
        """Return 1/f; its errors are infinite where f may vanish."""
        size = abs(self.value[0])
        clear = size - self.error[0]
        is_known = clear > 0.0
        first = 1.0 / np.where(is_known, self.value[0], 1.0)
        value, error = np.zeros_like(self.value), np.zeros_like(self.error)
        value[0] = first
        lost = self.error[0] / np.where(is_known, clear, 1.0) + _ROUNDING
        error[0] = np.where(is_known, abs(first) * lost, np.inf)
        lead = Series(value[:1], error[:1])
        for k in range(1, len(value)):
            rest = Series(self.value[1 : k + 1], self.error[1 : k + 1])
            before = Series(value[k - 1 :: -1] if k > 1 else value[:1], error[:k][::-1])
            total = Series(
                np.sum(rest.value * before.value, axis=0, keepdims=True),
                np.sum(
                    rest.error * (abs(before.value) + before.error)
                    + abs(rest.value) * (before.error + _ROUNDING * abs(before.value)),
                    axis=0,
                    keepdims=True,
                ),
            )
            term = lead * -total
            value[k], error[k] = term.value[0], term.error[0]
        return Series(value, np.where(is_known, error, np.inf))


def constant(number: float, cells: int) -> Series:
    """Return the series of a number."""
    value = np.zeros((ORDERS, cells))
    value[0] = number
    return Series(value, np.zeros((ORDERS, cells)))


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
    lost = _EPS * (abs(terms) @ (len(weights) + 8.0 + 8.0 * order))
    error = np.broadcast_to(lost[:, None], value.shape)
    sizes = abs(value) + error
    wide = np.zeros((ORDERS, len(middle)))
    for m in range(ORDERS):
        for k in range(m + 1, derivatives):
            wide[m] += comb(k, m) * sizes[k] * half ** (k - m)
        beyond = float(abs(terms[-1]) @ order) * comb(derivatives, m) / derivatives
        wide[m] += beyond * half ** (derivatives - m)
    value, error = value[:ORDERS], error[:ORDERS]
    return Series(value, error), Series(value, _OF_ERRORS * (error + wide))


def difference(middle: Cells, half: Cells) -> tuple[Series, Series]:
    """Return s = 1 - e^(-i theta): in the middle, and in all of a cell."""
    turned = np.exp(-1j * middle)
    value = np.stack([-((-1j) ** m) / factorial(m) * turned for m in range(ORDERS)])
    value[0] = 2.0 * np.sin(0.5 * middle) ** 2 + 1j * np.sin(middle)
    sizes = np.array([1.0 / factorial(m) for m in range(ORDERS)])[:, None]
    error = np.broadcast_to(4.0 * _EPS * sizes, value.shape)
    return Series(value, error), Series(value, _OF_ERRORS * (error + sizes * half))


def _convolved(one: Numbers, other: Numbers) -> Numbers:
    total = one[0] * other
    for k in range(1, len(one)):
        total[k:] += one[k] * other[: len(one) - k]
    return total
