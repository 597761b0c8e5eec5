"""Proved facts about cosine series f(theta) = sum_k c_k cos(k theta) on [0, pi].

Criteria that hold "for all frequencies" are such series. They are bounded between samples by

    |f(theta) - f(t) - f'(t) (theta - t)| <= M (theta - t)^2 / 2,      M = sum_k k^2 |c_k|,

so a sample decides for its neighbourhood, and where it cannot decide more samples are taken. Series
that are sums of the same few series are evaluated as such: ``weights @ basis``.
NumPy alone: the number of samples depends on the values.
"""

from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

Coefficients = Float64[np.ndarray, "batch term"]
Values = Float64[np.ndarray, " batch"]

_LARGEST_GAP = 1e-13  # of the sizes: how far the bound of a largest value may lie above it
_AT_ONCE = 1 << 18  # cells, and terms at angles, that are held in memory


class LargestValue(NamedTuple):
    """A value that each series takes, its angle, and a proved upper bound of all values."""

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


def largest_value(
    weights: Float64[np.ndarray, "batch part"], basis: Float64[np.ndarray, "part term"]
) -> LargestValue:
    """Return the largest values of series ``weights @ basis`` over [0, pi], by branch and bound.

    The bound is above the value by at most 1e-13 of the sizes |weights| @ |basis|, summed, and the
    rounding of the series.
    """
    cells = 4 * basis.shape[1]
    rows = max(1, _AT_ONCE // cells)
    parts = range(0, len(weights), rows)
    answers = [_largest_value(weights[start : start + rows], basis, cells) for start in parts]
    return LargestValue(*map(np.concatenate, zip(*answers, strict=True)))


def _largest_value(weights: np.ndarray, basis: np.ndarray, cells: int) -> LargestValue:
    batch = len(weights)
    order = np.arange(basis.shape[1])
    curvature = np.abs(weights @ basis) @ order**2
    sizes = np.abs(weights) @ np.abs(basis)
    gap = _LARGEST_GAP * np.sum(sizes, axis=-1)
    half = pi / (2 * cells)
    owner = np.repeat(np.arange(batch), cells)
    center = np.tile((2 * np.arange(cells) + 1) * half, batch)
    best, angle = np.full(batch, -np.inf), np.zeros(batch)
    while owner.size:
        value, slope = _combined(weights, basis, owner, center)
        climb = np.argsort(value)  # of equal owners the last one written stays
        better = climb[value[climb] > best[owner[climb]]]
        best[owner[better]], angle[owner[better]] = value[better], center[better]
        above = value + np.abs(slope) * half + 0.5 * curvature[owner] * half**2
        is_open = above > best[owner] + gap[owner]
        half /= 2
        owner = np.repeat(owner[is_open], 2)
        center = (center[is_open, None] + np.array([-half, half])).ravel()
    return LargestValue(best, angle, best + gap + _rounding(sizes, len(basis)))


def _combined(
    weights: np.ndarray, basis: np.ndarray, owner: np.ndarray, center: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return values and slopes of series at their centers, of which many have the same."""
    angles, number = np.unique(center, return_inverse=True)
    rows = max(1, _AT_ONCE // basis.shape[1])
    order = np.arange(basis.shape[1])
    table = np.empty((2, len(angles), len(basis)))
    for start in range(0, len(angles), rows):
        part = slice(start, start + rows)
        phase = angles[part, None] * order
        table[0, part] = np.cos(phase) @ basis.T
        table[1, part] = np.sin(phase) @ (-order * basis).T
    value, slope = np.einsum("kij,ij->ki", table[:, number], weights[owner])
    return value, slope


def _rounding(sizes: Coefficients, parts: int) -> Values:
    """Bound the rounding error of a computed value: of the phases and of the sums."""
    order = np.arange(sizes.shape[-1])
    units = order * pi + len(order) + parts + 5
    rounding: Values = np.finfo(np.float64).eps * (sizes @ units)
    return rounding
