"""Estimator and filter on the unit circle as models over boxes of the angle.

A filter is a quotient of polynomials in 1/z. Its numerator is multiplied out in exact numbers; the
denominators of its sections stay apart, because next to z = 1, where poles are, their product would
cancel. A polynomial with real coefficients is on the circle

    f(theta) = sum_k c_k e^(-i k theta),     |f^(m)| <= sum_k k^m |c_k|,

so that around theta_0, |theta - theta_0| <= h, with f, f' and f" evaluated there,

    f = f(theta_0) + f'(theta_0) (theta - theta_0) + r,
    |r| <= h^2/2 (|f"(theta_0)| + h sum k^3 |c_k|),

or h^2/2 times the bound of f" itself, where that is less. Its derivative has the bounds of one
order more (lemma B14 of docs/proofs.md). No tables, and nothing that depends on the degree but the
sums.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.boxes.enclosures import LinearModel, Moving
from jaxstab.model.filters import Filter, Filters, exact_chain, rounded
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
    return _quotient(position, is_velocity=False), _quotient(velocity.filter, is_velocity=True)


def _quotient(chain: Filter, *, is_velocity: bool) -> Quotient:
    """A chain of filters, that of a velocity behind 1 - 1/z."""
    above, _ = exact_chain(chain.per_sample(1.0).sections)
    if is_velocity:
        above -= above.left_shift(1)
    below = [np.array(side) for _, side in chain.stages() if len(side) > 1]
    return Quotient(rounded(above), tuple(below))


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
