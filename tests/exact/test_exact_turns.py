"""V10: the matrices of delays in turn, against a mass whose forces arrive one by one."""

from dataclasses import replace
from itertools import pairwise
from math import inf

import numpy as np
import pytest
from scipy.linalg import expm

from jaxstab import HapticLoop, Velocity
from jaxstab.exact.turns import TransitionMatrices, is_growing

T, MASS, DAMPING, STIFFNESS = 1e-3, 0.25, 0.1, 40.0
LOOP = HapticLoop(device_mass=MASS, device_damping=DAMPING, hand_stiffness=STIFFNESS, sample_time=T)
TURNS = [[0.0], [0.3], [1.0], [2.6], [0.3, 2.6], [0.2, 0.0, 3.1], [1.5, inf, 0.5], [2.2, 1.9, 0.1]]


def multipliers(wall: tuple[float, float], delays: list[float]) -> np.ndarray:
    """The eigenvalues of a turn; states: x, v, the position before, and the last forces."""
    stiffness, damping = wall
    rates = np.array([[0.0, 1.0, 0.0], [-STIFFNESS / MASS, -DAMPING / MASS, 1.0 / MASS], [0.0] * 3])
    kept = len(delays) + 5
    turn = np.eye(3 + kept)
    for sample in range(len(delays)):
        step = []
        for unit in np.eye(3 + kept):
            x, v, before, *past = unit
            forces = [-(stiffness * x + damping * (x - before) / T), *past]  # the newest first
            changes = [delays[(sample - age) % len(delays)] - age for age in range(kept + 1)]
            times = sorted({0.0, 1.0, *(t for t in changes if 0.0 < t < 1.0)})
            moving = np.array([x, v])
            for start, end in pairwise(times):
                newest = next(age for age, t in enumerate(changes) if t <= start)
                moving = (expm(rates * (end - start) * T) @ [*moving, forces[newest]])[:2]
            step.append([*moving, x, *forces[:kept]])
        turn = np.array(step).T @ turn
    return np.linalg.eigvals(turn)


@pytest.mark.parametrize("delays", TURNS, ids=str)
@pytest.mark.parametrize("wall", [(300.0, 1.0), (900.0, 4.0)])
def test_a_turn_moves_a_mass_as_its_forces_arrive(
    wall: tuple[float, float], delays: list[float]
) -> None:
    loop = TransitionMatrices.from_loop(LOOP, *wall)
    turn = np.eye(len(loop.rounded().steps(delays)[0]))
    for step in loop.rounded().steps(delays):
        turn = step @ turn
    found, truth = np.linalg.eigvals(turn), multipliers(wall, delays)
    for value in truth[np.abs(truth) > 1e-3]:
        assert np.min(np.abs(found - value)) < 1e-8 * abs(value), value
    largest = np.abs(truth).max()
    assert np.abs(found).max() == pytest.approx(largest, rel=1e-9)
    assert is_growing(loop, delays) == (largest > 1.0)


@pytest.mark.parametrize("samples", [1, 2, 5])
def test_without_a_delay_a_turn_of_a_window_has_the_roots_of_the_loop(samples: int) -> None:
    """(z^2 - tr z + det) z^n + N (K z^n + B (z^n - 1)/(n T)), the plant by SciPy."""
    loop = replace(LOOP, velocity=Velocity.difference(samples=samples))
    rates = np.array([[0.0, 1.0, 0.0], [-STIFFNESS / MASS, -DAMPING / MASS, 1.0 / MASS], [0.0] * 3])
    held = expm(rates * T)
    push = held[:2, 2]
    above = [push[0], held[0, 1] * push[1] - held[1, 1] * push[0]]
    wall = np.zeros(samples + 1)
    wall[[0, -1]] = 300.0 + 2.0 / (samples * T), -2.0 / (samples * T)
    below = [1.0, -np.trace(held[:2, :2]), np.linalg.det(held[:2, :2])]
    known = np.polyadd(np.polymul(below, [1.0, *[0.0] * samples]), np.polymul(above, wall))
    (step,) = TransitionMatrices.from_loop(loop, 300.0, 2.0).rounded().steps([0.0])
    found = np.linalg.eigvals(step)
    for root in np.roots(known):
        assert np.abs(found - root).min() < 1e-8


def test_turns_in_balls_are_those_in_floats() -> None:
    loop = TransitionMatrices.from_loop(LOOP, 300.0, 1.0)
    for delays in TURNS:
        for ball, number in zip(loop.steps(delays), loop.rounded().steps(delays), strict=True):
            assert np.all(np.abs(ball.astype(float) - number) <= 1e-12 * np.abs(number).max())
