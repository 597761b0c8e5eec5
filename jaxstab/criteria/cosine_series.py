"""Proved facts about cosine series f(theta) = sum_k c_k cos(k theta) on [0, pi].

Criteria that hold "for all frequencies" are such series. They are bounded between samples by

    |f(theta) - f(t) - f'(t) (theta - t)| <= M (theta - t)^2 / 2,      M = sum_k k^2 |c_k|,

so a sample speaks for its neighbourhood, and what it cannot decide is looked at more closely.
NumPy, because the number of samples depends on the values.
"""

from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

Series = Float64[np.ndarray, "batch term"]
Values = Float64[np.ndarray, " batch"]

_LARGEST_GAP = 1e-13  # of sum |c_k|: how far the bound of a largest value may lie above it
_SMALLEST_STEP = 1e-9  # rad: a root this near is called reached
_MOST_STEPS = 4000


class LargestValue(NamedTuple):
    """Of each series: a value that it takes, where, and a proved upper bound of all values."""

    value: Values
    theta: Values
    bound: Values


class Rise(NamedTuple):
    """Where each series first goes from negative to positive: between these angles, or NaN."""

    before: Values
    after: Values


def series_values(series: Series, theta: Values) -> tuple[Values, Values]:
    """Return f and f' of each series at one angle each."""
    order = np.arange(series.shape[-1])
    phase = theta[:, None] * order
    value = np.sum(series * np.cos(phase), axis=-1)
    slope = -np.sum(series * order * np.sin(phase), axis=-1)
    return value, slope


def largest_value(series: Series) -> LargestValue:
    """Return the largest value of each series over [0, pi], bounded by branch and bound.

    The bound is above the value by at most 1e-13 sum |c_k| and the rounding of the series.
    """
    batch, terms = series.shape
    order = np.arange(terms)
    curvature = np.sum(order**2 * np.abs(series), axis=-1)
    size = np.sum(np.abs(series), axis=-1)
    cells = 4 * terms
    half = pi / (2 * cells)
    owner = np.repeat(np.arange(batch), cells)
    center = np.tile((2 * np.arange(cells) + 1) * half, batch)
    best, place = np.full(batch, -np.inf), np.zeros(batch)
    while owner.size:
        value, slope = series_values(series[owner], center)
        climb = np.argsort(value)  # of equal owners the last one written stays
        better = climb[value[climb] > best[owner[climb]]]
        best[owner[better]], place[owner[better]] = value[better], center[better]
        above = value + np.abs(slope) * half + 0.5 * curvature[owner] * half**2
        open_ = above > best[owner] + _LARGEST_GAP * size[owner]
        half /= 2
        owner = np.repeat(owner[open_], 2)
        center = (center[open_, None] + np.array([-half, half])).ravel()
    bound = best + _LARGEST_GAP * size + _rounding(series)
    return LargestValue(best, place, bound)


def first_rise(series: Series, start: Values) -> Rise:
    """Return a bracket of the first angle in [start, pi] where each series rises through zero.

    Each series is followed from ``start`` by steps so short that the bound on its curvature proves
    them free of roots; a root is passed when it is nearer than 1e-9. What can be overlooked is a
    pair of roots closer together than that, or values below the rounding of the series.
    """
    order = np.arange(series.shape[-1])
    curvature = np.maximum(np.sum(order**2 * np.abs(series), axis=-1), np.finfo(float).tiny)
    noise = _rounding(series)
    theta = start.astype(np.float64)
    before, after = np.full_like(theta, np.nan), np.full_like(theta, np.nan)
    value, slope = series_values(series, theta)
    for _ in range(_MOST_STEPS):
        going = np.isnan(after) & (theta < pi)
        if not going.any():
            break
        away, away_slope = np.abs(value), np.copysign(1.0, value) * slope
        step = (away_slope + np.sqrt(away_slope**2 + 2 * curvature * away)) / curvature
        passing = (step < _SMALLEST_STEP) | (away < noise)
        following = np.where(passing, theta + 2 * np.maximum(step, _SMALLEST_STEP), theta + step)
        following = np.where(going, np.minimum(following, pi), theta)
        new_value, slope = series_values(series, following)
        rises = going & (value < 0) & (new_value > 0)
        before, after = np.where(rises, theta, before), np.where(rises, following, after)
        theta, value = following, new_value
    return Rise(before, after)


def _rounding(series: Series) -> Values:
    """Bound the rounding error of a computed value: of the phases and of the sum."""
    order = np.arange(series.shape[-1])
    units = order * pi + series.shape[-1] + 4
    rounding: Values = np.finfo(np.float64).eps * np.sum(np.abs(series) * units, axis=-1)
    return rounding
