"""Walls that are fastest at worst over several loops: settling times simulated by scipy."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from commands import run
from numpy.typing import NDArray
from scipy.linalg import expm

from jaxstab import Device, HapticLoop, Velocity, tune_for_all
from jaxstab.app.scene import Scene, tune_walls
from jaxstab.app.scene.tune import tune_over_ranges
from jaxstab.tuning import TuningStatus

Floats = NDArray[np.float64]

OMEGA = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
TABLE: dict[str, Any] = {
    "device": {"mass": 0.25, "damping": 0.1},
    "hand": {"mass": [0.0, 0.1], "damping": 1.0},
    "controller": {"sample_time": 1e-3, "delay_samples": 1.0, "velocity": {"window_samples": 3}},
    "wanted": {"mass_tolerance": 0.1, "delay_tolerance": 2e-4},
}


def simulated_settling(loop: HapticLoop, stiffness: float, damping: float) -> float:
    """The time in s from which on the sampled positions stay within 2 % under a constant push.

    The difference over a window of the velocity, any delay: forces switch within a sample.
    """
    mass = loop.device_mass + loop.hand_mass
    drag = loop.device_damping + loop.hand_damping
    motion = [[0.0, 1.0, 0.0], [-loop.hand_stiffness / mass, -drag / mass, 1.0 / mass], [0.0] * 3]
    period = loop.sample_time
    whole, part = divmod(round(loop.delay / period, 9), 1.0)
    early: Any = expm(np.array(motion) * part * period)
    late: Any = expm(np.array(motion) * (1.0 - part) * period)
    window = 1 if loop.velocity is None else loop.velocity.filter.sections[0].length
    forces, places = [0.0] * (int(whole) + 2), [0.0] * 42
    state, found = np.zeros(2), []
    for _ in range(3000):
        places.append(float(state[0]))
        found.append(places[-1])
        speed = (places[-1] - places[-1 - window]) / (window * period)
        forces.append(-stiffness * places[-1] - damping * speed)
        for step, force in ((early, forces[-2 - int(whole)]), (late, forces[-1 - int(whole)])):
            state = step[:2, :2] @ state + step[:2, 2] * (force + 1.0)
    aside = np.abs(np.array(found) * (stiffness + loop.hand_stiffness) - 1.0)
    return (1 + int(np.flatnonzero(aside > 0.02)[-1])) * period


def family(loop: HapticLoop, *shares: float) -> list[HapticLoop]:
    return [replace(loop, device_mass=loop.device_mass * (1.0 + share)) for share in shares]


def test_the_fastest_wall_of_a_loop_is_slower_for_a_mass_of_ten_percent_more_or_less() -> None:
    loops = family(OMEGA, 0.0, -0.1, 0.1)
    fastest = OMEGA.tune()
    assert fastest.settling_time == 0.006
    times = [simulated_settling(loop, *fastest[:2]) for loop in loops]
    assert times[0] == 0.006
    assert max(times) > 0.009
    common = tune_for_all(loops)
    found = [simulated_settling(loop, *common[:2]) for loop in loops]
    assert max(found) == common.settling_time < max(times)
    assert loops[int(np.argmax(found))] == common.slowest


def test_no_wall_of_a_grid_is_faster_at_worst() -> None:
    loops = family(OMEGA, -0.1, 0.1)
    common = tune_for_all(loops)
    stiffness, damping = np.meshgrid(np.linspace(5e3, 6e4, 20), np.linspace(50.0, 220.0, 20))
    worst = np.max([loop.settling_time(stiffness, damping).value for loop in loops], axis=0)
    assert common.settling_time <= np.nanmin(worst)


@pytest.mark.campaign
def test_of_one_loop_it_is_as_fast_as_the_fastest_wall() -> None:
    for loop in (OMEGA, replace(OMEGA, velocity=Velocity.difference(samples=5), delay=1e-3)):
        common = tune_for_all([loop])
        assert common.settling_time <= loop.tune().settling_time + loop.sample_time
        assert simulated_settling(loop, *common[:2]) == common.settling_time
    given = tune_for_all([OMEGA], stiffness=20000.0)
    assert given.stiffness == 20000.0
    assert given.settling_time <= OMEGA.tune(stiffness=20000.0).settling_time + OMEGA.sample_time


def test_loops_of_any_device_have_a_common_wall() -> None:
    loops = [
        HapticLoop(
            device=Device.mass_spring_damper(mass, damping=0.1).with_actuator(300.0),
            sample_time=1e-3,
        )
        for mass in (0.2, 0.25)
    ]
    common = tune_for_all(loops)
    times = [float(loop.settling_time(*common[:2]).value) for loop in loops]
    assert max(times) == common.settling_time
    assert common.settling_time < 0.06


def test_where_no_wall_settles_in_all_loops_there_is_none() -> None:
    slow = replace(OMEGA, delay=0.1)
    common = tune_for_all([OMEGA, slow], stiffness=30000.0)
    assert common.status == TuningStatus.NO_STABLE_GAINS
    assert common.settling_time == np.inf


def test_bad_loops_are_refused_in_a_sentence() -> None:
    with pytest.raises(ValueError, match=r"^loops is empty; give at least one loop\.$"):
        tune_for_all(iter([]))
    with pytest.raises(TypeError, match=r"^loops has 3; give a HapticLoop for each\.$"):
        tune_for_all([3])  # type: ignore[list-item]
    with pytest.raises(ValueError, match=r"^level is 1\.0; give a number below 1"):
        tune_for_all([OMEGA], level=1.0)


# ------------------------------------------------------------------------------------------ scenes


def members(scene: Scene, count: int, rng: np.random.Generator) -> list[HapticLoop]:
    """Random members of the ranges of a scene, made here from its numbers."""
    device, hand, controller = scene.device, scene.hand, scene.controller
    assert hand is not None
    share, aside = scene.wanted.mass_tolerance or 0.0, scene.wanted.delay_tolerance or 0.0
    return [
        HapticLoop(
            device_mass=device.effective_mass[0] * rng.uniform(1.0 - share, 1.0 + share),
            device_damping=device.damping,
            hand_mass=rng.uniform(*hand.mass),
            hand_stiffness=rng.uniform(*hand.stiffness),
            hand_damping=rng.uniform(*hand.damping),
            sample_time=controller.sample_time,
            delay=controller.time_delay + rng.uniform(-aside, aside),
            velocity=controller.estimator,
        )
        for _ in range(count)
    ]


@pytest.mark.campaign
def test_a_scene_with_ranges_has_a_wall_for_them_and_says_what_was_tried() -> None:
    scene = Scene.from_table(TABLE)
    tuned = tune_walls(scene)
    wall = tuned.over_ranges
    assert wall is not None
    assert wall.stiffness is not None
    assert wall.damping is not None
    assert wall.settling_time_at_worst is not None
    assert wall.certainty == (
        "the slowest of 109 loops that were tried, 8 of them at corners of the ranges; the "
        "settling of others is not proved"
    )
    assert wall.fastest_wall_at_worst is not None
    assert wall.settling_time_at_worst < wall.fastest_wall_at_worst
    rng = np.random.default_rng(5)
    times = [
        simulated_settling(one, wall.stiffness, wall.damping) for one in members(scene, 8, rng)
    ]
    assert max(times) <= wall.settling_time_at_worst
    plain = Scene.from_table({name: TABLE[name] for name in ("device", "controller")})
    assert tune_over_ranges(plain, None) is None


@pytest.mark.campaign
def test_few_members_of_the_ranges_are_slower_than_those_that_were_tried() -> None:
    scene = Scene.from_table(TABLE)
    wall = tune_over_ranges(scene, None)
    assert wall is not None
    rng = np.random.default_rng(6)
    gains = wall.stiffness, wall.damping
    times = np.array([simulated_settling(one, *gains) for one in members(scene, 400, rng)])
    assert np.mean(times > wall.settling_time_at_worst) <= 0.02
    assert times.max() <= wall.settling_time_at_worst + 0.003


def test_tolerances_turn_with_the_device() -> None:
    table = {
        "device": {"inertia": 0.0025, "damping": 0.001},
        "controller": {"sample_time": 1e-3, "velocity": {"window_samples": 1}},
        "wanted": {"mass_tolerance": 0.1},
    }
    wall = tune_over_ranges(Scene.from_table(table), None)
    assert wall is not None
    assert wall.settling_time_at_worst == tune_for_all(family(OMEGA, -0.1, 0.1)).settling_time
    assert wall.slowest is not None
    assert wall.slowest.mass == pytest.approx(0.00275)


def test_tolerances_are_options_too() -> None:
    omega = ["--mass", "0.25", "--damping", "0.1", "--sample-time", "0.001", "--json"]
    tuned = json.loads(run("tune", *omega, "--mass-tolerance", "0.1").stdout)
    assert tuned["over_ranges"]["settling_time_at_worst"] == 0.01
    assert tuned["over_ranges"]["fastest_wall_at_worst"] == 0.011
    for option, words in (
        (["--mass-tolerance", "1.0"], "wanted.mass_tolerance is 1.0; give a number >= 0 and below"),
        (["--delay-tolerance", "-1"], "wanted.delay_tolerance is -1.0; give a finite number >= 0"),
    ):
        refused = run("tune", *omega, *option)
        assert refused.exit_code == 2
        assert words in refused.stderr
