"""Ordinary loops, as people build them: how often an answer says nothing, and whether it is right.

Masses, hands, modes and actuators with the estimators that haptics software has, at 0.5 to 10 kHz,
each with a wall inside of its stable region.
"""

from typing import Any, NamedTuple

import numpy as np
import pytest
from campaign import many

from jaxstab import Filter, HandRange, HapticLoop, Velocity
from jaxstab.conventions import Verdict
from jaxstab.results import SettlingStatus
from tests.truth import devices
from tests.truth.march import (
    Plant,
    Taps,
    arriving,
    butterworth_taps,
    difference_taps,
    low_pass_taps,
    march_of_plant,
)
from tests.truth.random_loops import device_of

pytestmark = pytest.mark.campaign

COUNT = many(1000, small=60)
MOST = 0.005  # the share of settling times that are not proved
MOST_OTHERS = 0.02  # the share of margins, and of ranges of hands, without an answer
LEVEL = 0.02
EACH = 10  # loop is simulated
LONGEST = 20_000  # samples of a simulation
NEAR = 1e-9  # of the tolerance: positions that may be counted as inside or outside


class Ordinary(NamedTuple):
    """A loop, its filters as difference equations, and a wall that is stable."""

    drawn: devices.Drawn
    loop: HapticLoop
    velocity: list[Taps]
    position: list[Taps]
    wall: tuple[float, float]


def drawn_device(rng: np.random.Generator) -> devices.Drawn:
    """A device of 50 g to 2 kg, usually held by a hand, sometimes with a mode or an actuator."""
    period = float(1.0 / 10 ** rng.uniform(np.log10(500.0), 4.0))
    delay = float(rng.choice([0.0, 1.0, rng.uniform(0.0, 3.0)]))
    hand, modes, bandwidth = None, [], None
    if rng.random() < 0.7:
        arm = 10 ** rng.uniform(-2, 0), 10 ** rng.uniform(-0.5, 1.3), 10 ** rng.uniform(0.5, 3)
        grip = (10 ** rng.uniform(-1, 1), 10 ** rng.uniform(3, 4)) if rng.random() < 0.2 else None
        hand = (*map(float, arm), grip)
    if rng.random() < 0.2:
        modes = [tuple(map(float, (rng.uniform(20, 200), rng.uniform(0.005, 0.1), 1.0)))]
    if rng.random() < 0.2:
        bandwidth = float(10 ** rng.uniform(2, 3.3))
    mass, damping = float(10 ** rng.uniform(-1.3, 0.3)), float(10 ** rng.uniform(-2, 0.5))
    return devices.Drawn(mass, damping, modes, hand, bandwidth, period, delay)


def drawn_filters(
    rng: np.random.Generator, period: float
) -> tuple[Velocity, list[Taps], Filter, list[Taps]]:
    """A window of up to 20 samples, a low pass or a Butterworth filter, of 20 Hz or more."""
    cutoff = float(10 ** rng.uniform(np.log10(20.0), np.log10(min(300.0, 0.2 / period))))
    order, samples = int(rng.integers(1, 4)), int(rng.integers(2, 21))
    sections = butterworth_taps(cutoff * period, order)
    kinds = [
        (Velocity(), [difference_taps(1)]),
        (Velocity.difference(samples=samples), [difference_taps(samples)]),
        (Velocity.low_pass(cutoff), [difference_taps(1), low_pass_taps(cutoff * period)]),
        (Velocity.butterworth(cutoff, order=order), [difference_taps(1), *sections]),
    ]
    velocity, taps = kinds[int(rng.integers(len(kinds)))]
    if rng.random() < 0.85:
        return velocity, taps, Filter(), []
    return velocity, taps, Filter.low_pass(3.0 * cutoff), [low_pass_taps(3.0 * cutoff * period)]


def drawn_wall(rng: np.random.Generator, loop: HapticLoop) -> tuple[float, float] | None:
    """A wall with a positive stiffness inside of the component of small gains."""
    region = loop.region().main
    if region is None:
        return None
    for _ in range(20):
        damping = rng.uniform(0.0, region.most_damped.damping)
        low, high = region.stiffness_limits(damping)
        if high > max(low, 0.0):
            low = max(low, 0.0)
            return float(low + rng.uniform(0.02, 0.95) * (high - low)), float(damping)
    return None


def ordinary(seed: int) -> Ordinary | None:
    rng = np.random.default_rng([2031, seed])
    drawn = drawn_device(rng)
    velocity, taps, position, more = drawn_filters(rng, drawn.sample_time)
    arm = drawn.hand or (0.0, 0.0, 0.0, None)
    mechanics: dict[str, Any] = {"device": device_of(drawn)}
    if not drawn.modes and arm[3] is None and drawn.bandwidth is None:
        mechanics = {
            "device_mass": drawn.mass,
            "device_damping": drawn.damping,
            "hand_mass": arm[0],
            "hand_damping": arm[1],
            "hand_stiffness": arm[2],
        }
    loop = HapticLoop(
        **mechanics,
        sample_time=drawn.sample_time,
        delay=drawn.delay * drawn.sample_time,
        velocity=velocity,
        position=position,
    )
    wall = drawn_wall(rng, loop)
    return None if wall is None else Ordinary(drawn, loop, taps, more, wall)


@pytest.fixture(scope="module")
def loops() -> list[Ordinary]:
    found = [ordinary(seed) for seed in range(COUNT)]
    stable = [one for one in found if one is not None]
    assert len(stable) > 0.9 * COUNT
    return stable


def settled_in_simulation(one: Ordinary, excitation: str, samples: int) -> tuple[int, float]:
    """The count by scipy's exponential and lfilter, and how close a position is to the level."""
    drawn = one.drawn
    a, wall, c = (np.array(part.tolist(), float) for part in drawn.mechanism.system())
    handle = drawn._replace(bandwidth=None).mechanism.system()
    hand = np.zeros(len(a))
    hand[: handle.b.rows] = np.array(handle.b.tolist(), float).ravel()
    period = drawn.sample_time
    plant = Plant(a * period, wall.ravel() * period, hand * period, c.ravel())
    gains = one.wall[0], one.wall[1] / period
    states, _ = march_of_plant(
        plant,
        drawn.delay,
        gains,
        one.velocity,
        one.position,
        samples,
        push=1.0 if excitation == "force" else 0.0,
        start=np.zeros(len(a)) if excitation == "force" else arriving(drawn),
    )
    positions = states @ plant.c
    if excitation == "force":
        held = np.linalg.solve(plant.a - gains[0] * np.outer(plant.wall, plant.c), -plant.hand)
        positions = positions / (plant.c @ held) - 1.0
    size = np.abs(positions)
    size = size / (1.0 if excitation == "force" else size.max())
    return int(np.flatnonzero(size > LEVEL)[-1]) + 1, float(np.abs(size / LEVEL - 1.0).min())


def test_settling_is_proved_of_nearly_all_and_is_that_of_simulations(
    loops: list[Ordinary],
) -> None:
    unknown, simulated = 0, 0
    for number, one in enumerate(loops):
        for excitation in ("force", "impact"):
            found = one.loop.settling_time(*one.wall, excitation=excitation, level=LEVEL)
            if int(found.status) != SettlingStatus.SETTLED:
                unknown += 1
                continue
            count = round(float(found.value) / one.drawn.sample_time)
            if number % EACH or 2 * count > LONGEST:
                continue
            expected, distance = settled_in_simulation(one, excitation, 2 * count + 100)
            assert count == expected or distance < NEAR, (number, excitation)
            simulated += 1
    assert unknown <= MOST * 2 * len(loops)
    assert simulated > len(loops) / EACH


def test_margins_are_given_for_nearly_all(loops: list[Ordinary]) -> None:
    unknown = 0
    for one in loops:
        found = one.loop.margins(*one.wall)
        spare = found.stiffness_gain, found.damping_gain, found.extra_delay
        unknown += bool(np.isnan(spare).any())
    assert unknown <= MOST_OTHERS * len(loops)


def test_hands_of_a_range_are_decided_for_nearly_all(loops: list[Ordinary]) -> None:
    """Hands down to half of the one that was drawn, wherever device and hand are one mass."""
    unknown, asked = 0, 0
    for one in loops:
        arm = one.drawn.hand
        if arm is None or one.loop.device is not None:
            continue
        ends = ((0.5 * value, value) for value in arm[:3])
        hands = HandRange(**dict(zip(("mass", "damping", "stiffness"), ends, strict=True)))
        found = one.loop.worst_hand(hands, *one.wall)
        unknown += found.verdict == Verdict.UNDECIDED
        asked += 1
    assert asked > 0.2 * len(loops)
    assert unknown <= MOST_OTHERS * asked
