"""Bounds of an interpolated spectral radius that hold at every point of a cell."""

from itertools import product

import numpy as np
import pytest

from benchmarks import truth
from jaxstab import spectral_radius
from jaxstab.boxes.plant import HandBoxes
from jaxstab.boxes.root_discs import interpolation_errors


@pytest.mark.parametrize(
    ("delay", "gamma", "delta", "alpha", "beta"),
    [
        (0.0, (0.0, 5e-4), (0.0, 2e-3), (-0.1, 0.75), (-0.1, 2.1)),
        (2.3, (0.5, 0.51), (0.1, 0.12), (-0.5, 0.2), (-0.3, 0.6)),
    ],
)
def test_the_bound_holds_in_every_cell(
    delay: float,
    gamma: tuple[float, float],
    delta: tuple[float, float],
    alpha: tuple[float, float],
    beta: tuple[float, float],
    rng: np.random.Generator,
) -> None:
    nodes = np.linspace(*alpha, 65), np.linspace(*beta, 57)
    hands = np.array([gamma, delta])
    half = 0.5 * np.diff(hands, axis=1) * (1 + 1e-9)
    boxes = HandBoxes(*hands.mean(axis=1)[:, None], *half)
    corners = np.moveaxis(
        np.asarray(
            spectral_radius(
                nodes[0][:, None, None, None],
                nodes[1][:, None, None],
                np.array(gamma)[:, None],
                np.array(delta),
                delay,
            ).value
        ),
        (2, 3),
        (0, 1),
    )
    bounds = interpolation_errors(*nodes, boxes, delay, corners)
    assert np.mean(bounds < 0.02) > 0.8

    count = 16_000  # few enough for NumPy
    cell = [rng.integers(0, axis.size - 1, count) for axis in nodes]
    part = rng.choice([0.0, 1.0, 0.5, 0.31], (4, count))
    gains = [
        axis[i] + p * (axis[i + 1] - axis[i])
        for axis, i, p in zip(nodes, cell, part[:2], strict=True)
    ]
    hand = [low + p * (high - low) for (low, high), p in zip(hands, part[2:], strict=True)]
    interpolated = np.zeros(count)
    for corner in product((0, 1), repeat=4):
        weight = np.prod([p if c else 1 - p for c, p in zip(corner, part, strict=True)], axis=0)
        i, j, *sides = corner
        interpolated += weight * corners[*sides, cell[0] + i, cell[1] + j]
    bound = bounds[cell[0], cell[1]]
    computed = np.asarray(spectral_radius(*gains, *hand, delay).value)
    assert np.all(np.abs(interpolated - computed) <= bound + 1e-12)
    for k in range(30):
        point = (float(value[k]) for value in (*gains, *hand))
        low, high = truth.spectral_radius(*point, delay)
        assert low - bound[k] <= interpolated[k] <= high + bound[k]


def test_where_roots_meet_there_is_no_bound() -> None:
    middle = 4 ** (1 / 3) - 1, 6 * (4 ** (1 / 3) - 1) ** 2 - 2  # a triple root at delay 0
    alpha = middle[1] + np.array([-1e-3, 1e-3])
    beta = 2 * middle[0] ** 3 + np.array([-1e-3, 1e-3])
    boxes = HandBoxes(*(np.zeros(1) for _ in range(4)))
    bound = interpolation_errors(alpha, beta, boxes, 0.0, np.full((2, 2, 2, 2), middle[0]))
    assert bound.shape == (1, 1)
    assert bound[0, 0] > 0.05


def test_parts_of_a_large_slice_give_what_the_whole_gives(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    nodes = np.linspace(-0.1, 0.7, 8), np.linspace(0.0, 2.0, 6)
    boxes = HandBoxes(*(np.full(1, v) for v in (5e-4, 4e-3, 2e-4, 1e-3)))
    corners = rng.random((2, 2, 8, 6))
    whole = interpolation_errors(*nodes, boxes, 0.0, corners)
    monkeypatch.setattr("jaxstab.boxes.root_discs._PAIRS_OF_ROOTS", 135)
    np.testing.assert_array_equal(interpolation_errors(*nodes, boxes, 0.0, corners), whole)
