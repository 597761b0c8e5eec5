"""Crossings of the curve with itself and the lines, against roots of p along the curve."""

from itertools import product

import numpy as np
import pytest

from jaxstab.model import by_name, characteristic_polynomial
from jaxstab.model.filters import NO_FILTERS
from jaxstab.region import crossings as module
from jaxstab.region.closed_form import boundary_curve
from jaxstab.region.crossings import _NEARLY_STABLE, _overlapping_boxes, _starts, crossings
from jaxstab.region.curve import curve_of_system, mass_system
from jaxstab.region.pieces import scan_angles

FARTHEST = 1e-6  # from the circle: what is still on it

PLACES = [
    (1e-3, 0.015, 0.0),
    (1e-3, 0.015, 1.0),
    (11.523438187710303, 0.40536209838398013, 1.0),  # a line is crossed twice in a step
    (0.5, 0.2, 3.4),
    (3.4221236931311325, 9.11095313928446, 6.351107263508205),  # and here the curve
    (1.3488207792095845, 0.5590127914668694, 7.0),
    (39.799975315059754, 0.4533140420022334, 4.0),
    (0.1, 0.05, 12.0),
]


Place = tuple[float, float, float]


def found(place: Place) -> np.ndarray:
    c = curve_of_system(mass_system(*place, NO_FILTERS))
    return crossings(c, scan_angles(c, 1))


def sizes_of_roots(theta: np.ndarray, place: Place) -> np.ndarray:
    """Return |z| of all roots for the walls of the curve at these angles."""
    p = np.asarray(
        characteristic_polynomial(*boundary_curve(theta, **by_name(*place)), **by_name(*place))
    )
    return np.abs([np.roots(one) for one in p])


@pytest.mark.parametrize("place", PLACES)
def test_the_number_of_unstable_roots_changes_at_crossings(place: Place) -> None:
    """But for parts of the curve along which another root is farther out, which are left out."""
    theta = np.linspace(0.01, np.pi - 0.01, 4001)
    sizes = sizes_of_roots(theta, place)
    unstable = np.sum(sizes > 1.0 + FARTHEST, axis=1)
    is_near = np.max(sizes, axis=1) < _NEARLY_STABLE
    changes = theta[1:][(np.diff(unstable) != 0) & is_near[1:] & is_near[:-1]]
    away = np.min(np.abs(changes[:, None] - found(place)), axis=1)
    assert len(changes)
    assert np.max(away) < 2.0 * (theta[1] - theta[0])


@pytest.mark.parametrize("place", PLACES)
def test_at_a_crossing_there_are_three_roots_on_the_circle(place: Place) -> None:
    away = np.sort(np.abs(sizes_of_roots(found(place), place) - 1.0), axis=1)
    assert np.max(away[:, 2]) < FARTHEST


def test_no_pair_of_parts_whose_boxes_overlap_is_missed_in_blocks(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    monkeypatch.setattr(module, "_AT_ONCE", 100)
    interval = np.flatnonzero(rng.random(60) < 0.6)  # neighbours of a part do not count
    low = rng.uniform(size=(2, len(interval)))
    high = low + rng.uniform(0.0, 0.4, low.shape)
    pairs = {
        (i, j)
        for i, j in product(range(len(interval)), repeat=2)
        if interval[i] + 1 < interval[j]
        and np.all((low[:, i] <= high[:, j]) & (low[:, j] <= high[:, i]))
    }
    blocks = list(_overlapping_boxes(interval, low, high))
    here, there = np.concatenate(blocks, axis=1)
    assert len(blocks) > 10
    assert sorted(zip(here.tolist(), there.tolist(), strict=True)) == sorted(pairs)


def test_cubics_that_cross_at_given_shares_are_found_to_cross_there(
    rng: np.random.Generator,
) -> None:
    """By de Casteljau's algorithm; each of the cubics is slightly bent."""
    count = 50
    shares = rng.uniform(0.1, 0.9, (2, count))
    ends = rng.normal(size=(2, 2, 2, count))  # of cubic, end, coordinate
    controls = np.linspace(ends[:, 0], ends[:, 1], 4, axis=1)
    controls += 0.03 * rng.normal(size=controls.shape)
    points = controls
    for _ in range(3):
        points = points[:, :-1] + shares[:, None, None] * np.diff(points, axis=1)
    controls[1] += (points[0] - points[1])[0]
    pairs = np.arange(2 * count).reshape(2, count)
    parts, found_shares = _starts(np.concatenate(list(controls), axis=-1), pairs)
    assert np.all(parts[1] - parts[0] == count)
    for k in range(count):
        away = np.abs(found_shares[:, parts[0] == k] - shares[:, [k]]).max(axis=0)
        assert np.min(away, initial=np.inf) < 1e-9
