"""Taylor series of functions of one angle over many cells, each coefficient with its error.

In each cell, a series states |f^(k)(x)/k! - value_k| <= error_k for a function f. If x is the
middle of the cell alone, the errors are those of rounding; if x is any point of the cell, they
include the change of the derivatives, so |value_k| + error_k bounds these (Moore 1966). Products
and quotients of series are series again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, factorial

import numpy as np
from jaxtyping import Complex128, Float64

Cells = Float64[np.ndarray, " cell"]
Numbers = Float64[np.ndarray, "order cell"] | Complex128[np.ndarray, "order cell"]

ORDERS = 9  # coefficients that a series has
_BEYOND = 16  # orders by which the change of those of a cosine sum is known
_EPS = np.finfo(np.float64).eps
_ROUNDING = (ORDERS + 4) * _EPS  # of a sum of so many products, complex ones too
_OF_ERRORS = 1.0 + 1e-13


@dataclass(frozen=True)
class Series:
    """Coefficients, shape (order, cell), and bounds of their errors."""

    value: Numbers
    error: Float64[np.ndarray, "order cell"]

    def __add__(self, other: "Series") -> "Series":
        value = self.value + other.value
        return Series(value, _OF_ERRORS * (self.error + other.error + _EPS * abs(value)))

    def __mul__(self, other: "Series") -> "Series":
        size = abs(other.value)
        error = _convolved(self.error, size + other.error)
        error += _convolved(abs(self.value), other.error + _ROUNDING * size)
        return Series(_convolved(self.value, other.value), _OF_ERRORS * error)

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
        for k in range(1, len(value)):  # the sum of self_i over_(k - i), i from 1 on, is 0
            after, after_error = self.value[1 : k + 1], self.error[1 : k + 1]
            before, before_error = value[:k][::-1], error[:k][::-1]
            total = np.sum(after * before, axis=0)
            lost = after_error * (abs(before) + before_error)
            lost = lost + abs(after) * (before_error + _ROUNDING * abs(before))
            total_error = np.sum(lost, axis=0)
            value[k] = -first * total
            error[k] = error[0] * (abs(total) + total_error) + abs(first) * total_error
            error[k] = _OF_ERRORS * (error[k] + _ROUNDING * abs(value[k]))
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
