"""All sign changes of cosine series on [0, pi], each in a cell of its own.

A cell is decided at its middle, by bounds of the second derivative of f in theta or in
h = 1 - cos(theta): a polynomial in h is regular at theta = 0 and pi, where df/dtheta vanishes.
Cells that neither decides are halved. A computed sign counts only beyond a bound of its error,
which shrinks with theta^2 towards 0 as the changes of f do. Proofs: lemmas C2 and C3 of
docs/proofs.md.
"""

from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.criteria.cosine_series import Coefficients, Values

Column = Float64[np.ndarray, " cells"]

_EPS = np.finfo(np.float64).eps
_HALVINGS = 48
_MOST_CELLS = 64  # of a series that are open at once, times its terms: beyond, it is given up
_SHIFT = 0.382  # of the inner ends of cells, so that they miss the roots at rational parts of pi


class Series(NamedTuple):
    """Cosine series with bounds of their coefficients' errors; f(0) is known more accurately."""

    coefficients: Coefficients
    errors: Coefficients
    start: Values  # f(0)
    start_error: Values


class SignChanges(NamedTuple):
    """Cells of angles that hold the sign changes, in the order of the series and of the angles.

    Where ``is_proved``, the cell holds exactly one change, with its ``direction`` (1 for a rise, -1
    for a fall). Elsewhere it may hold none or, if the direction is 0, several.
    """

    owner: Int64[np.ndarray, " cells"]
    low: Column
    high: Column
    direction: Column
    is_proved: Bool[np.ndarray, " cells"]


class _Bounds(NamedTuple):
    """What bounds a series: its second derivatives in theta and in h, and the errors of values."""

    in_theta: Values
    in_h: Values
    error: Values  # over theta
    slope_error: Values  # over theta; half of it over theta^2 bounds the error of a value, too


class _Sample(NamedTuple):
    value: Column
    value_error: Column
    slope: Column
    slope_error: Column


def sign_changes(series: Series) -> SignChanges:
    """Return where each series changes its sign in (0, pi)."""
    batch, terms = series.coefficients.shape
    bounds = _bounds(series)
    inner = (np.arange(1, 2 * terms + 1) - _SHIFT) * (pi / (2 * terms + 0.5))
    ends = np.concatenate([[0.0], inner, [pi]])
    owner = np.repeat(np.arange(batch), len(ends) - 1)
    low, high = np.tile(ends[:-1], batch), np.tile(ends[1:], batch)
    kept: list[SignChanges] = []
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        sample = _sample(series, bounds, owner, middle)
        is_clear, is_monotone = _decided(sample, bounds, owner, middle, 0.5 * (high - low))
        is_lost = (np.abs(sample.value) <= sample.value_error) & (
            np.abs(sample.slope) <= sample.slope_error
        )
        is_open = ~(is_clear | is_monotone | is_lost)
        many = np.bincount(owner[is_open], minlength=batch) > _MOST_CELLS * terms
        is_lost = ~(is_clear | is_monotone) & (is_lost | many[owner])
        is_open &= ~is_lost
        direction = np.sign(sample.slope)
        one = is_monotone & ~is_clear
        kept.append(_changes(series, bounds, owner[one], low[one], high[one], direction[one]))
        kept.append(_unproved(owner[is_lost], low[is_lost], high[is_lost]))
        owner = np.repeat(owner[is_open], 2)
        low, middle, high = low[is_open], middle[is_open], high[is_open]
        low, high = np.stack([low, middle], -1).ravel(), np.stack([middle, high], -1).ravel()
        if not owner.size:
            break
    kept.append(_unproved(owner, low, high))
    together = [np.concatenate(column) for column in zip(*kept, strict=True)]
    order = np.lexsort((together[1], together[0]))
    return SignChanges(*(column[order] for column in together))


def _bounds(series: Series) -> _Bounds:
    order = np.arange(series.coefficients.shape[-1])
    size = np.abs(series.coefficients) + series.errors
    # Each term is right to a few units: its angle, its sine, the product and the sum.
    errors = series.errors + (len(order) + 8) * _EPS * np.abs(series.coefficients)
    return _Bounds(
        in_theta=np.sum(order**2 * size, axis=-1),
        in_h=np.sum(order**2 * (order**2 - 1) * size, axis=-1) / 3,
        error=np.sum(order * errors, axis=-1),
        slope_error=np.sum(order**2 * errors, axis=-1),
    )


def _sample(
    series: Series, bounds: _Bounds, owner: Int64[np.ndarray, " cells"], theta: Column
) -> _Sample:
    """Return f, df/dtheta and bounds of their errors, one angle for each cell."""
    order = np.arange(series.coefficients.shape[-1])
    half = 0.5 * theta[:, None] * order
    sine, terms = np.sin(half), 2.0 * series.coefficients[owner]
    value = series.start[owner] - np.sum(terms * sine**2, axis=-1)
    slope = -np.sum(terms * order * sine * np.cos(half), axis=-1)
    slope_error = theta * bounds.slope_error[owner]
    error = np.minimum(theta * bounds.error[owner], 0.5 * theta * slope_error)
    error = error + series.start_error[owner] + 4 * _EPS * np.abs(value)
    return _Sample(value, error, slope, slope_error)


def _decided(
    sample: _Sample,
    bounds: _Bounds,
    owner: Int64[np.ndarray, " cells"],
    middle: Column,
    half: Column,
) -> tuple[Bool[np.ndarray, " cells"], Bool[np.ndarray, " cells"]]:
    """Return which cells are proved to hold no root, and which to be monotone."""
    away = np.abs(sample.value) - sample.value_error
    slope = np.abs(sample.slope)
    clear, monotone = np.zeros(len(owner), bool), np.zeros(len(owner), bool)
    widest = np.maximum(np.sin(middle - 0.5 * half), np.sin(middle + 0.5 * half))
    in_h = 2.0 * np.sin(0.5 * half) * widest
    for change, bend, width in (
        (1.0, bounds.in_theta[owner], half * (1 + 8 * _EPS)),
        (1.0 / np.sin(middle), bounds.in_h[owner], in_h * (1 + 8 * _EPS)),
    ):
        steepest = (slope + sample.slope_error) * change
        clear |= away > (steepest * width + 0.5 * bend * width**2) * (1 + 8 * _EPS)
        monotone |= (slope - sample.slope_error) * change > bend * width * (1 + 8 * _EPS)
    return clear, monotone


def _changes(
    series: Series,
    bounds: _Bounds,
    owner: Int64[np.ndarray, " cells"],
    low: Column,
    high: Column,
    direction: Column,
) -> SignChanges:
    """Return the monotone cells whose ends differ in sign, or may do so."""
    first, last = (_sample(series, bounds, owner, theta) for theta in (low, high))
    starts, ends = direction * first.value, direction * last.value
    is_known = (starts < -first.value_error) & (ends > last.value_error)
    from_zero = (low == 0.0) & (series.start[owner] == 0.0) & (series.start_error[owner] == 0.0)
    kept = (starts <= first.value_error) & (ends >= -last.value_error) & ~from_zero
    return SignChanges(owner[kept], low[kept], high[kept], direction[kept], is_known[kept])


def _unproved(owner: Int64[np.ndarray, " cells"], low: Column, high: Column) -> SignChanges:
    return SignChanges(owner, low, high, np.zeros(len(owner)), np.zeros(len(owner), bool))
