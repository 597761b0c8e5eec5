"""The proof that a cell has one verdict: its bounds, and whole cells against certified roots."""

import itertools

import numpy as np
import pytest

from benchmarks import truth
from jaxstab.atlas.compute.certificate import Intervals, cells_without_crossing, plant_motion

# Corners of the parameter space: no spring or damper, haptic, resonant, strongly damped.
CELLS = [
    ((0.0, 0.0005), (0.0, 0.002)),
    ((0.0005, 0.001), (0.01, 0.015)),
    ((2.4, 2.5), (0.0, 0.01)),
    ((9.8, 9.81), (0.9, 0.91)),
    ((0.0, 0.3), (0.0, 0.4)),
    ((30.0, 40.0), (0.0, 10.0)),
]
DELAYS = [0.0, 1.0, 3.0, 0.25, 2.5]


def random_between(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(rng.choice([*ends, rng.uniform(*ends)]))


@pytest.mark.parametrize(("gamma", "delta"), CELLS)
@pytest.mark.parametrize("fraction", [0.0, 0.3])
def test_the_plant_moves_less_than_its_bound_within_a_cell(
    gamma: tuple[float, float],
    delta: tuple[float, float],
    fraction: float,
    rng: np.random.Generator,
) -> None:
    stiffness, damping = Intervals.between(np.array(gamma)), Intervals.between(np.array(delta))
    motion = plant_motion(stiffness, damping)
    centre = truth.sampled_plant(float(stiffness.centre), float(damping.centre), fraction)
    for _ in range(12):
        other = truth.sampled_plant(
            random_between(rng, gamma), random_between(rng, delta), fraction
        )
        assert abs(other.d1 - centre.d1) <= float(motion.d1)
        at_one = (other.d1 + other.d0) - (centre.d1 + centre.d0)
        assert abs(at_one) <= float(motion.den_at_one)
        numerator = sum(
            abs(a - b)
            for a, b in ((other.n2, centre.n2), (other.n1, centre.n1), (other.n0, centre.n0))
        )
        assert numerator <= float(motion.numerator)


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize(("gamma", "delta"), CELLS[:4])
def test_a_proved_cell_has_one_number_of_unstable_roots(
    gamma: tuple[float, float],
    delta: tuple[float, float],
    delay: float,
    rng: np.random.Generator,
) -> None:
    """Cells of random size around the closed-form boundary, where a false proof would be."""
    proved = 0
    for _ in range(40):
        alpha, beta = (
            float(gain)
            for gain in truth.boundary_point(
                rng.uniform(0.01, 3.1), np.mean(gamma), np.mean(delta), delay
            )
        )
        width = 10.0 ** rng.uniform(-2.5, 0.3) * np.array([1 + abs(alpha), 1 + abs(beta)])
        start = np.array([alpha, beta]) - width * rng.uniform(-2.0, 3.0, 2)
        ends = np.stack([start, start + width])
        cells = cells_without_crossing(
            ends[None, :, 0], ends[None, :, 1], np.array(gamma), np.array(delta), delay
        )
        if cells[0]:
            proved += 1
            assert len(set(numbers_of_unstable_roots(ends, gamma, delta, delay, rng))) == 1
    assert proved >= 3


def numbers_of_unstable_roots(
    ends: np.ndarray,
    gamma: tuple[float, float],
    delta: tuple[float, float],
    delay: float,
    rng: np.random.Generator,
) -> list[int | None]:
    box = [tuple(ends[:, 0]), tuple(ends[:, 1]), gamma, delta]
    corners = list(itertools.product(*box))
    chosen = [corners[i] for i in rng.choice(len(corners), 4, replace=False)]
    chosen.append(tuple(float(rng.uniform(*side)) for side in box))
    return [truth.unstable_count(*map(float, point), delay) for point in chosen]


@pytest.mark.parametrize("delay", DELAYS)
def test_a_cell_that_holds_a_point_of_the_boundary_is_never_proved(
    delay: float, rng: np.random.Generator
) -> None:
    for theta in rng.uniform(1e-4, 3.14, 40):
        gamma, delta = rng.uniform(0, 0.001), rng.uniform(0, 0.015)
        gains = [float(gain) for gain in truth.boundary_point(theta, gamma, delta, delay)]
        width = 10.0 ** rng.uniform(-9, -1, 4)
        sides = [
            np.array([value - part * size, value + (1 - part) * size])
            for value, part, size in zip(
                [*gains, gamma, delta], rng.uniform(0.01, 0.99, 4), width, strict=True
            )
        ]
        sides[2:] = [np.maximum(side, 0.0) for side in sides[2:]]
        alpha, beta, *hands = sides
        assert not cells_without_crossing(alpha[None], beta[None], *hands, delay)[0]


def test_cells_on_both_sides_of_the_line_of_a_real_root_at_one_are_proved_and_those_on_it_not() -> (
    None
):
    alpha = np.array([-0.002, -0.00101, -0.00099, 0.00001, 0.002])
    gamma, delta = np.array([0.0, 0.001]), np.array([0.005, 0.0051])
    cells = np.stack([alpha[:-1], alpha[1:]], axis=-1)
    beta = np.broadcast_to([0.4, 0.41], cells.shape)
    proved = cells_without_crossing(cells, beta, gamma, delta, 0.0)
    assert proved.tolist() == [True, False, False, True]
