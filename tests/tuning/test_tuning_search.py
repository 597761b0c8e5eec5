"""The minimiser of radii and settling times, against minima in closed form."""

import numpy as np
import pytest

from jaxstab.tuning import minimised

GRID = np.linspace(-1.0, 1.0, 21), np.linspace(-2.0, 2.0, 41)


def valley(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The larger of two planes and a cone: a kink that is no point of the grid."""
    return np.maximum(np.hypot(x - 0.123, y + 0.4567), 0.3 * np.abs(x - 0.123) + (y + 0.4567))


def test_a_kink_is_found_to_eight_digits() -> None:
    point, value = minimised(valley, GRID, zooms=14)
    assert point == pytest.approx((0.123, -0.4567), abs=1e-8)
    assert value == pytest.approx(0.0, abs=1e-8)


def test_the_narrower_of_two_minima_is_found_if_both_are_followed() -> None:
    """The grid sees 0.01 at a point of it, and 0.07 beside the minimum of 0."""

    def values(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        wide = 0.01 + np.abs(x - 0.5) + np.abs(y - 0.5)
        return np.minimum(wide, 5.0 * np.hypot(x + 0.513, y + 0.507))

    assert minimised(values, GRID) == ((0.5, 0.5), 0.01)
    point, value = minimised(values, GRID, starts=2)
    assert point == pytest.approx((-0.513, -0.507), abs=1e-6)
    assert value == pytest.approx(0.0, abs=1e-6)


def test_an_axis_of_one_value_stays_fixed_and_no_coordinate_is_below_the_lowest() -> None:
    fixed = np.array([0.25]), np.linspace(0.0, 1.0, 11)
    point, value = minimised(lambda x, y: x + y, fixed, lowest=0.0)
    assert (point, value) == ((0.25, 0.0), 0.25)


def test_a_value_that_is_enough_ends_the_search() -> None:
    asked: list[int] = []

    def values(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        asked.append(x.size)
        return np.hypot(x - 0.123, y)

    _, value = minimised(values, GRID, enough=0.05)
    assert value <= 0.05
    assert len(asked) == 1
    del asked[:]
    assert minimised(values, GRID, enough=-1.0)[1] > 0.0
    assert len(asked) < 12  # it cannot be reached


def test_where_nothing_counts_there_is_no_point() -> None:
    point, value = minimised(lambda x, _: np.full(x.shape, np.inf), GRID)
    assert np.isnan(point).all()
    assert value == np.inf
