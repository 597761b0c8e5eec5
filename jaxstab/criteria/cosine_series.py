"""Proved facts about cosine series f(theta) = sum_k c_k cos(k theta) on [0, pi].

Criteria that hold "for all frequencies" are such series. They are bounded between samples by

    |f(theta) - f(t) - f'(t) (theta - t)| <= M (theta - t)^2 / 2,      M = sum_k k^2 |c_k|,

so a sample speaks for its neighbourhood, and what it cannot decide is looked at more closely.
NumPy alone: the number of samples depends on the values.
"""

from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

Coefficients = Float64[np.ndarray, "batch term"]
Values = Float64[np.ndarray, " batch"]

_LARGEST_GAP = 1e-13  # of sum |c_k|: how far the bound of a largest value may lie above it


class LargestValue(NamedTuple):
    """A value that each series takes, the angle of it, and a proved upper bound of all values."""

    value: Values
    theta: Values
    bound: Values


def series_values(coefficients: Coefficients, theta: Values) -> tuple[Values, Values]:
    """Return f and f' of each series at one angle each."""
    order = np.arange(coefficients.shape[-1])
    phase = theta[:, None] * order
    value = np.sum(coefficients * np.cos(phase), axis=-1)
    slope = -np.sum(coefficients * order * np.sin(phase), axis=-1)
    return value, slope


def largest_value(coefficients: Coefficients) -> LargestValue:
    """Return the largest value of each series over [0, pi], bounded by branch and bound.

    The bound is above the value by at most 1e-13 sum |c_k| and the rounding of the series.
    """
    batch, terms = coefficients.shape
    order = np.arange(terms)
    curvature = np.sum(order**2 * np.abs(coefficients), axis=-1)
    size = np.sum(np.abs(coefficients), axis=-1)
    cells = 4 * terms
    half = pi / (2 * cells)
    owner = np.repeat(np.arange(batch), cells)
    center = np.tile((2 * np.arange(cells) + 1) * half, batch)
    best, angle = np.full(batch, -np.inf), np.zeros(batch)
    while owner.size:
        value, slope = series_values(coefficients[owner], center)
        climb = np.argsort(value)  # of equal owners the last one written stays
        better = climb[value[climb] > best[owner[climb]]]
        best[owner[better]], angle[owner[better]] = value[better], center[better]
        above = value + np.abs(slope) * half + 0.5 * curvature[owner] * half**2
        is_open = above > best[owner] + _LARGEST_GAP * size[owner]
        half /= 2
        owner = np.repeat(owner[is_open], 2)
        center = (center[is_open, None] + np.array([-half, half])).ravel()
    bound = best + _LARGEST_GAP * size + _rounding(coefficients)
    return LargestValue(best, angle, bound)


def _rounding(coefficients: Coefficients) -> Values:
    """Bound the rounding error of a computed value: of the phases and of the sum."""
    order = np.arange(coefficients.shape[-1])
    units = order * pi + coefficients.shape[-1] + 4
    rounding: Values = np.finfo(np.float64).eps * np.sum(np.abs(coefficients) * units, axis=-1)
    return rounding
