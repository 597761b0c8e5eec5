"""Motion of loops with estimators and filters, against the same filters run by scipy's lfilter."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab
from jaxstab import Filter, Velocity
from jaxstab.model import by_name
from jaxstab.results import SettlingStatus
from tests.truth.march import (
    Taps,
    butterworth_taps,
    difference_taps,
    low_pass_taps,
    march_through_filters,
)

WALL = (0.004, 0.04)
PLANTS = [(1e-3, 0.015, delay) for delay in (0.0, 1.0, 2.5)]
LONG = 1500  # samples, enough for every loop below to come to rest

Case = tuple[dict[str, Any], list[Taps], list[Taps]]

# Estimator and filter, beside the difference equations of both.
CASES: dict[str, Case] = {
    "window": ({"velocity": Velocity.difference(samples=20)}, [difference_taps(20)], []),
    "low pass": (
        {"velocity": Velocity.low_pass(0.05, order=2)},
        [difference_taps(1), low_pass_taps(0.05), low_pass_taps(0.05)],
        [],
    ),
    "Butterworth": (
        {"velocity": Velocity.butterworth(0.1, order=5)},
        [difference_taps(1), *butterworth_taps(0.1, 5)],
        [],
    ),
    "exponential and average": (
        {"velocity": Velocity.exponential(0.25), "position": Filter.average(samples=3)},
        [difference_taps(1), ([0.25, 0.0], [1.0, -0.75])],
        [([1 / 3] * 3, [1.0, 0.0, 0.0])],
    ),
    "chain": (
        {
            "velocity": Velocity.difference(samples=3)
            * Filter.exponential(0.25)
            * Filter.average(samples=2),
            "position": Filter.low_pass(0.2),
        },
        [difference_taps(3), ([0.25, 0.0], [1.0, -0.75]), ([0.5, 0.5], [1.0, 0.0])],
        [low_pass_taps(0.2)],
    ),
    "transfer functions": (  # the position filter has a gain of 2 at rest
        {
            "velocity": Velocity.transfer_function([0.75, -0.5, -0.25], [1.0, -0.5, 0.0]),
            "position": Filter.transfer_function([2.0, 0.0, 1.0], [1.0, 0.5, 0.0]),
        },
        [([0.75, -0.5, -0.25], [1.0, -0.5, 0.0])],
        [([2.0, 0.0, 1.0], [1.0, 0.5, 0.0])],
    ),
    "position alone": (
        {"position": Filter.butterworth(0.2, order=3)},
        [difference_taps(1)],
        butterworth_taps(0.2, 3),
    ),
}


def settled_since(position: np.ndarray, final: float, band: float) -> int:
    return int(np.flatnonzero(np.abs(position - final) > band)[-1]) + 1


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("case", CASES)
def test_settling_is_that_of_a_loop_that_lfilter_runs(
    case: str, plant: tuple[float, float, float]
) -> None:
    filters, velocity, position = CASES[case]
    gain = np.prod([sum(above) / sum(below) for above, below in position])
    push = WALL[0] * float(gain) + plant[0]
    chains = velocity, position
    pushed, _ = march_through_filters(plant, WALL, *chains, LONG, push=push)
    hit, _ = march_through_filters(plant, WALL, *chains, LONG, start=(0.0, 1.0))
    assert abs(pushed[-1, 0] - 1.0) < 1e-6
    expected = {
        "force": settled_since(pushed[:, 0], 1.0, 0.02),
        "impact": settled_since(hit[:, 0], 0.0, 0.02 * np.abs(hit[:, 0]).max()),
    }
    for excitation, samples in expected.items():
        found = jaxstab.settling_samples(*WALL, **by_name(*plant), excitation=excitation, **filters)
        assert int(found.status) == SettlingStatus.SETTLED
        assert float(found.value) == samples


@pytest.mark.parametrize(
    ("wall", "plant", "filters", "taps", "samples"),
    [
        (
            (0.00028755, 0.02079427),
            (2.5534058505351448e-08, 0.0, 27.0),
            {
                "velocity": Velocity.difference(samples=21),
                "position": Filter.exponential(0.14953526478681176),
            },
            ([difference_taps(21)], [([0.14953526478681176, 0.0], [1.0, -0.8504647352131882])]),
            1256,
        ),
        (
            (1.24353991, -16.02902543),
            (0.45176724853725625, 0.1661347224272225, 1.9699254132161326),
            {"velocity": Velocity.exponential(0.08110258756687809)},
            ([difference_taps(1), ([0.08110258756687809, 0.0], [1.0, -0.9188974124331219])], []),
            455,
        ),
    ],
)
def test_settling_is_proved_in_units_in_which_powers_are_small(
    wall: tuple[float, float],
    plant: tuple[float, float, float],
    filters: dict[str, Any],
    taps: tuple[list[Taps], list[Taps]],
    samples: int,
) -> None:
    """In those of one mass the bounds of rounding grew faster than the loop decayed."""
    pushed, _ = march_through_filters(plant, wall, *taps, 3 * samples, push=wall[0] + plant[0])
    assert settled_since(pushed[:, 0], 1.0, 0.02) == samples
    found = jaxstab.settling_samples(*wall, **by_name(*plant), **filters)
    assert int(found.status) == SettlingStatus.SETTLED
    assert float(found.value) == samples


def test_settling_of_a_grid_is_that_of_each_loop() -> None:
    velocity = Velocity.difference(samples=5) * Filter.low_pass(0.1)
    betas, delays = np.array([[0.04], [0.06]]), np.array([0.0, 1.5, 3.0])
    together = jaxstab.settling_samples(
        0.003, betas, gamma=1e-3, delta=0.015, delay=delays, velocity=velocity
    )
    for index in np.ndindex(together.value.shape):
        point = 0.003, betas[index[0], 0], 1e-3, 0.015, delays[index[1]]
        alone = jaxstab.settling_samples(**by_name(*point), velocity=velocity)
        assert float(together.value[index]) == float(alone.value)
    assert (together.status == SettlingStatus.SETTLED).all()


def test_an_unstable_loop_never_settles_and_one_that_rings_for_long_is_not_proved() -> None:
    """A wall of 5000 N/m and 30 N s/m on 0.25 kg at 1 kHz, one sample of delay, windows of 20."""
    velocity = Velocity.difference(samples=20)
    found = jaxstab.settling_samples(
        0.02, 0.12, gamma=0.0, delta=4e-4, delay=1.0, velocity=velocity
    )
    assert float(found.value) == np.inf
    assert int(found.status) == SettlingStatus.UNSTABLE
    slow = jaxstab.settling_samples(
        1e-6, 1e-6, gamma=0.0, delta=0.0, delay=0.0, horizon=64, velocity=velocity
    )
    assert np.isnan(slow.value)
    assert int(slow.status) == SettlingStatus.NOT_SETTLED


def test_settling_refuses_traced_filters_in_one_sentence() -> None:
    def settled(cutoff: Any) -> Any:
        return jaxstab.settling_samples(
            *WALL, **by_name(*PLANTS[0]), velocity=Velocity.low_pass(cutoff)
        )

    with pytest.raises(TypeError, match="JAX traces; give numbers"):
        jax.jit(settled)(0.1)


@pytest.mark.parametrize("unilateral", [False, True])
@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("case", CASES)
def test_a_simulated_loop_is_that_of_lfilter(
    case: str, plant: tuple[float, float, float], unilateral: bool
) -> None:
    """A mass of 1 kg at 1 Hz: pushed, thrown and displaced, so that it leaves the wall."""
    filters, velocity, position = CASES[case]
    gamma, delta, delay = plant
    loop = jaxstab.HapticLoop(
        device_mass=1.0, device_damping=delta, hand_stiffness=gamma, sample_time=1.0, delay=delay,
        **filters,
    )  # fmt: skip
    options = {"force": 0.003, "initial_position": 0.1, "initial_velocity": -0.3}
    found = loop.simulate(*WALL, samples=200, unilateral=unilateral, **options)
    states, forces = march_through_filters(
        plant, WALL, velocity, position, 200, push=0.003, start=(0.1, -0.3), unilateral=unilateral
    )
    expected = (found.position, states[:, 0]), (found.velocity, states[:, 1]), (found.force, forces)
    for mine, theirs in expected:
        np.testing.assert_allclose(mine, theirs, atol=1e-13 * np.abs(theirs).max())
    assert (states[:, 0] < 0.0).any()


def test_simulated_walls_broadcast_and_jax_arrays_agree() -> None:
    loop = jaxstab.HapticLoop(
        device_mass=1.0, device_damping=0.015, sample_time=1.0, delay=1.5,
        velocity=Velocity.difference(samples=4) * Filter.low_pass(0.2),
        position=Filter.low_pass(0.2),
    )  # fmt: skip
    stiffness, damping = np.array([[0.002], [0.004]]), np.array([0.03, 0.04, 0.05])
    options = {"samples": 40, "initial_position": 0.1, "between": 1, "unilateral": True}
    many = loop.simulate(stiffness, damping, **options)
    assert many.position.shape == (2, 3, 80)
    one = loop.simulate(0.004, 0.03, **options)
    np.testing.assert_allclose(many.position[1, 0], one.position, rtol=1e-13)
    compiled = loop.simulate(jnp.asarray(stiffness), damping, **options)
    assert isinstance(compiled.position, jax.Array)
    np.testing.assert_allclose(compiled.position, many.position, atol=1e-14)
    np.testing.assert_allclose(compiled.force, many.force, atol=1e-14)


@pytest.mark.parametrize("case", CASES)
def test_the_dominant_mode_is_what_is_left_of_a_motion(case: str) -> None:
    """Three samples of a lone pair, and a fourth, tell its decay and its frequency."""
    filters, velocity, position = CASES[case]
    states, _ = march_through_filters(PLANTS[1], WALL, velocity, position, 400, start=(0.0, 1.0))
    mode = jaxstab.dominant_mode(*WALL, **by_name(*PLANTS[1]), **filters)
    last = states[-160:, 0]
    square = (last[1:-2] * last[3:] - last[2:-1] ** 2) / (last[:-3] * last[2:-1] - last[1:-2] ** 2)
    decay = -0.5 * np.log(np.median(square))
    ratio = decay / np.hypot(decay, float(mode.frequency))
    assert float(mode.damping_ratio) == pytest.approx(ratio, rel=1e-4)
    crossings = np.flatnonzero(np.sign(last[1:]) != np.sign(last[:-1]))
    assert len(crossings) > 1
