"""The wall's part of g over boxes of loops and angles: H = alpha P(z) + beta V(z).

P is the position filter and V the velocity estimator. Without filters P = 1 and V = 1 - 1/z, in
closed form; else both come from ``jaxstab.boxes.filter_cells``.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from jaxstab.boxes.filter_cells import FilterCells, filter_cells
from jaxstab.model.filters import Filters

Reals = Float64[np.ndarray, " boxes"]
Complexes = Complex128[np.ndarray, " boxes"]


class Gains(NamedTuple):
    """alpha and beta of boxes, their half-widths, and the angle with its half-width."""

    alpha: Reals
    beta: Reals
    by_alpha: Reals
    by_beta: Reals
    theta: Reals
    by_theta: Reals


class Wall(NamedTuple):
    """H over boxes.

    value: H in the middle of each box.
    per_alpha: dH/dalpha there, P.
    per_beta: dH/dbeta there, V.
    per_theta: dH/dtheta there; None for i beta/z.
    size: a bound of |H| in the box.
    change: a bound of how far alpha and beta move H at the middle angle.
    slope: a bound of |dH/dtheta| in the box.
    bend: a bound of |d^2H/dtheta^2| in the box; None where ``slope`` is one.
    turned_change: a bound of how far alpha and beta move dH/dtheta in the box.
    terms: a bound of the terms whose sum is H.
    lost: a bound of the error of H beyond roundings of its terms.
    """

    value: Complexes
    per_alpha: Complexes | float
    per_beta: Complexes
    per_theta: Complexes | None
    size: Reals
    change: Reals
    slope: Reals
    bend: Reals | None
    turned_change: Reals
    terms: Reals
    lost: Reals | float


def wall_over(gains: Gains, back: Complexes, filters: Filters | None) -> Wall:
    """Return the wall over boxes; ``back`` is 1/z in their middles."""
    if filters is None:
        return _plain_wall(gains, back)
    return _filtered_wall(gains, filter_cells(filters))


def _plain_wall(gains: Gains, back: Complexes) -> Wall:
    lag = 1.0 - back
    value = gains.alpha + gains.beta * lag
    most_beta = np.abs(gains.beta) + gains.by_beta
    change = gains.by_alpha + np.abs(lag) * gains.by_beta
    size = np.abs(value) + change + np.minimum(gains.by_theta, 2.0) * most_beta
    return Wall(
        value=value,
        per_alpha=1.0,
        per_beta=lag,
        per_theta=None,
        size=size,
        change=change,
        slope=most_beta,
        bend=None,
        turned_change=gains.by_beta,
        terms=size + np.abs(gains.alpha) + np.abs(gains.beta),
        lost=0.0,
    )


def _filtered_wall(gains: Gains, cells: FilterCells) -> Wall:
    alpha, beta, by_alpha, by_beta, theta, by_theta = gains
    (position, velocity), (position_theta, velocity_theta), lost = responses(cells, theta)
    steep = largest_within(cells.steepness, cells, theta, by_theta)
    most_alpha, most_beta = np.abs(alpha) + by_alpha, np.abs(beta) + by_beta
    value = alpha * position + beta * velocity
    change = by_alpha * np.abs(position) + by_beta * np.abs(velocity)
    slope = most_alpha * steep[0] + most_beta * steep[1]
    size = np.abs(value) + change + by_theta * slope
    return Wall(
        value=value,
        per_alpha=position,
        per_beta=velocity,
        per_theta=alpha * position_theta + beta * velocity_theta,
        size=size,
        change=change,
        slope=slope,
        bend=most_alpha * steep[2] + most_beta * steep[3],
        turned_change=by_alpha * steep[0] + by_beta * steep[1],
        terms=size + np.abs(alpha * position) + np.abs(beta * velocity),
        lost=most_alpha * (lost[0] + by_theta * lost[2])
        + most_beta * (lost[1] + by_theta * lost[3]),
    )


def cell_numbers(cells: FilterCells, theta: Reals) -> np.ndarray:
    """Return the cells in which angles lie."""
    return np.maximum(np.searchsorted(cells.first, theta, "right") - 1, 0)


def responses(cells: FilterCells, theta: Reals) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return P and V at angles, (2, box), their derivatives, and bounds of what these lost."""
    number = cell_numbers(cells, theta)
    offset = theta - cells.middle[number]
    series = cells.series[number].T  # (order, 2, box)
    value, slope = series[-1], np.zeros_like(series[0])
    for coefficient in series[-2::-1]:
        slope = slope * offset + value
        value = value * offset + coefficient
    is_inside = np.abs(offset) <= cells.half[number] * (1.0 + 1e-9)
    return value, slope, np.where(is_inside, cells.lost[number].T, np.inf)


def largest_within(
    steepness: np.ndarray, cells: FilterCells, theta: Reals, by_theta: Reals
) -> np.ndarray:
    """Return the largest of bounds of cells in theta +- by_theta; infinite beyond the cells."""
    low, high = theta - by_theta, theta + by_theta
    first, last = cell_numbers(cells, low), cell_numbers(cells, high)
    level = np.frexp(last - first + 1)[1] - 1
    largest = np.maximum(steepness[level, first], steepness[level, last + 1 - (1 << level)])
    is_inside = (low >= cells.first[0]) & (high <= cells.middle[-1] + cells.half[-1])
    bounds: np.ndarray = np.where(is_inside, largest.T, np.inf)
    return bounds
