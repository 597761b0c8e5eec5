"""Limits of presets against walls that scipy simulates on both sides of them, hands at random."""

from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pytest
from campaign import many
from numpy.typing import NDArray
from scipy.linalg import expm

from jaxstab.app.scene import Scene, loop_of
from jaxstab.app.scene.scene import numbers_in, presets, values_in
from jaxstab.conventions import Verdict
from jaxstab.loop import HapticLoop

Floats = NDArray[np.float64]

DEVICES = [name for name, preset in presets("devices").items() if "mass" in preset]
SOFTWARE = [name for name, preset in presets("software").items() if numbers_in(preset)]
HANDS = many(56, small=3)  # at full size 1,008 walls of each preset
NEXT_TO_IT = 0.02  # of the largest stiffness: how far from it walls are simulated


class Walls(NamedTuple):
    """Loops of one sample time, each with a wall."""

    loops: list[HapticLoop]
    stiffness: Floats
    damping: Floats


def preset_loop(device: str, software: str, delay: int) -> HapticLoop:
    meant = values_in(presets("software")[software], ["sample_time"]).get("sample_time", 1e-3)
    velocity = {"preset": software}
    controller = {"sample_time": meant, "delay_samples": float(delay), "velocity": velocity}
    return loop_of(Scene.from_table({"device": {"preset": device}, "controller": controller}))


def velocity_of(software: str, period: float, past: list[Floats], before: list[Floats]) -> Floats:
    """The velocities as the sources compute them, from what was before, the newest last."""
    if software == "hapkit":
        raw = (past[-1] - past[-2]) / 0.0001
        return 1.9 * before[-1] - 0.9025 * before[-2] + 0.0025 * raw
    window = {"chai3d": 0.015, "chai3d-rotation": 0.030}.get(software, 0.020)
    raw = (past[-1] - past[-1 - round(window / period)]) / window
    return before[-1] + 0.15 * (raw - before[-1]) if software == "ros-force-dimension" else raw


def grow(walls: Walls, software: str, samples: int) -> NDArray[np.bool_]:
    """True if positions grow: the largest of the last quarter against that before it."""
    period, count = walls.loops[0].sample_time, len(walls.loops)
    delays = np.array([round(loop.delay / period) for loop in walls.loops])
    moves = np.array([transition(loop)[:2] for loop in walls.loops]).transpose(1, 2, 0)
    position, speed = (np.random.default_rng(1).normal(size=(count, 2)) * [1.0, 100.0]).T
    past = [position] * 41
    velocities = [np.zeros(count)] * 2
    forces = np.zeros((max(delays) + 1, count))
    largest = np.zeros((4, count))
    for k in range(samples):
        past = [*past[1:], position]
        velocity = velocity_of(software, period, past, velocities)
        velocities = [velocities[1], velocity]
        forces[k % len(forces)] = -walls.stiffness * position - walls.damping * velocity
        force = forces[(k - delays) % len(forces), np.arange(count)]
        position, speed = (a * position + b * speed + c * force for a, b, c in moves)
        quarter = largest[4 * k // samples]
        np.maximum(quarter, np.abs(position), out=quarter)
    return ~np.isfinite(largest[3]) | (largest[3] > largest[2])


def transition(loop: HapticLoop) -> Floats:
    mass = loop.device_mass + loop.hand_mass
    damping = loop.device_damping + loop.hand_damping
    motion = [
        [0.0, 1.0, 0.0],
        [-loop.hand_stiffness / mass, -damping / mass, 1.0 / mass],
        [0.0] * 3,
    ]
    found: Any = expm(np.array(motion) * loop.sample_time)
    return found


def at_the_limit(loop: HapticLoop, count: int, rng: np.random.Generator) -> Walls:
    """Random hands, and for each the largest stiffness at a random damping."""
    held = [
        replace(
            loop,
            hand_mass=rng.uniform(0.0, 0.5),
            hand_stiffness=rng.uniform(0.0, 500.0),
            hand_damping=rng.uniform(0.0, 5.0),
        )
        for _ in range(count)
    ]
    most = [float(one.damping_limits(0.0)[1]) for one in held]  # where no spring is rendered
    damping = rng.uniform(0.05, 0.95, count) * most
    limits = [float(one.stiffness_limits(b)[1]) for one, b in zip(held, damping, strict=True)]
    return Walls(held, np.array(limits), damping)


def judge(software: str, devices: list[str], delays: list[int], hands: int, samples: int) -> None:
    """Simulate two walls of each hand, one on either side of the limit."""
    limits = []
    for device, delay in product(devices, delays):
        rng = np.random.default_rng(list(f"{device}/{software}/{delay}".encode()))
        limits.append(at_the_limit(preset_loop(device, software, delay), hands, rng))
    loops = [loop for limit in limits for loop in limit.loops]
    stiffness = np.concatenate([limit.stiffness for limit in limits])
    damping = np.concatenate([limit.damping for limit in limits])
    assert np.all(stiffness > 0.0)
    gains = np.append((1.0 - NEXT_TO_IT) * stiffness, (1.0 + NEXT_TO_IT) * stiffness)
    walls = Walls(loops * 2, gains, np.tile(damping, 2))
    verdicts = [int(loop.verdict(k, b)) for loop, k, b in zip(*walls, strict=True)]
    assert verdicts == [Verdict.STABLE] * len(loops) + [Verdict.UNSTABLE] * len(loops)
    assert np.array_equal(grow(walls, software, samples), np.equal(verdicts, Verdict.UNSTABLE))


@pytest.mark.parametrize("software", SOFTWARE)
def test_walls_next_to_a_presets_limits_come_to_rest_or_grow(software: str) -> None:
    judge(software, ["omega"], [1], 1, 6_000)


@pytest.mark.campaign
@pytest.mark.parametrize("software", SOFTWARE)
def test_many_walls_next_to_the_limits_come_to_rest_or_grow(software: str) -> None:
    """Random hands of devices with a mass, delays of 0 to 2 samples."""
    judge(software, DEVICES, [0, 1, 2], HANDS, 60_000)
