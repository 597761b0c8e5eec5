"""Estimator and filter on the unit circle as models over boxes of the angle.

A filter is a quotient of polynomials in 1/z. Its numerator is multiplied out in exact numbers; the
denominators of its sections stay apart, because next to z = 1, where poles are, their product would
cancel. A polynomial with real coefficients is on the circle

    f(theta) = sum_k c_k e^(-i k theta),     |f^(m)| <= sum_k k^m |c_k|,

so that around theta_0, |theta - theta_0| <= h, with f, f' and f" evaluated there,

    f = f(theta_0) + f'(theta_0) (theta - theta_0) + r,
    |r| <= h^2/2 (|f"(theta_0)| + h sum k^3 |c_k|),

or h^2/2 times the bound of f" itself, where that is less. Its derivative has the bounds of one
order more. No tables, and nothing that depends on the degree but the sums.
"""

from fractions import Fraction
from functools import lru_cache, reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.boxes.enclosures import LinearModel, Moving
from jaxstab.model.filters import Filters, Section
from jaxstab.rounding import EPS, RAISED_MANY

_TURNS = np.array([1.0, -1j, -1.0, 1j])  # powers of -i

Coefficients = Float64[np.ndarray, " power"]  # of powers of 1/z, lowest first


class Quotient(NamedTuple):
    """A filter: a numerator over a product of short denominators."""

    above: Coefficients
    below: tuple[Coefficients, ...]

    def over(self, theta: LinearModel) -> Moving:
        """The filter over boxes of the angle."""
        value = _over(self.above, theta)
        for side in self.below:
            value = value * _over(side, theta).reciprocal()
        return value


@lru_cache(maxsize=32)
def quotients(filters: Filters) -> tuple[Quotient, Quotient]:
    """Return P and T V of filters in units of one sample."""
    velocity, position = filters
    one = [Fraction(1)]
    return (
        _quotient(position.sections, one),
        _quotient(velocity.filter.sections, [*one, Fraction(-1)]),
    )


def _quotient(sections: tuple[Section, ...], above: list[Fraction]) -> Quotient:
    """The product of sections, and of a polynomial."""
    below = []
    for section in sections:
        for *sides, count in section.per_sample(1.0).rational_factors():
            rising = [list(map(Fraction, side)) for side in sides]
            late = [Fraction(0)] * (len(rising[1]) - len(rising[0]))
            numerator, denominator = [*late, *rising[0][::-1]], rising[1][::-1]
            above = reduce(_product, [numerator] * count, above)
            if any(denominator[1:]):
                below += [_rounded(denominator)] * count
            else:
                above = [value / denominator[0] ** count for value in above]
    return Quotient(_rounded(above), tuple(below))


def _product(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    product = [Fraction(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b) if x else ():
            product[i + j] += x * y
    return product


def _rounded(exact: list[Fraction]) -> Coefficients:
    return np.array(list(map(float, exact)))


def _over(c: Coefficients, theta: LinearModel) -> Moving:
    """A polynomial in 1/z over boxes of the angle."""
    order = np.arange(c.size, dtype=float)
    powers = c * order ** np.arange(5.0)[:, None]
    derivatives = powers[:4] * _TURNS[:, None]
    value, slope, bend, third = derivatives @ np.exp(-1j * np.multiply.outer(order, theta.centre))
    sizes = np.abs(powers)
    # Of coefficients, angles, exponentials and the sum, for the value and each derivative.
    rounding = EPS * (sizes @ (c.size + 8.0 + 8.0 * order)) * RAISED_MANY
    bounds = sizes.sum(axis=1) * RAISED_MANY

    def model(k: int, own: np.ndarray, first: np.ndarray, second: np.ndarray) -> LinearModel:
        swing, rest = theta.swing, theta.rest
        bent = np.minimum(np.abs(second) + rounding[k + 2] + swing * bounds[k + 3], bounds[k + 2])
        left = 0.5 * bent * swing**2 + np.abs(first) * rest + rounding[k] + swing * rounding[k + 1]
        return LinearModel(own, first * theta.slope, left * RAISED_MANY, theta.half)

    return Moving(model(0, value, slope, bend), model(1, slope, bend, third))
