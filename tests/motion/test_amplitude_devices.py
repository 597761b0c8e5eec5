"""Proved amplitudes of general devices, against worst signals and runs by scipy's exponential."""

from typing import Any

import numpy as np
import pytest

from jaxstab import Filter, HapticLoop, Velocity
from jaxstab.results import AmplitudeStatus
from tests.truth import devices
from tests.truth.disturbed import Disturbance, Disturbed, largest, worst_signals
from tests.truth.march import Plant, Taps, difference_taps, low_pass_taps
from tests.truth.random_loops import device_of

PERIOD = 1e-3
ARM = (1.0, 5.0, 300.0, (4.0, 2000.0))  # mass, damping, stiffness, grip
NONE: tuple[dict[str, Any], list[Taps], list[Taps]] = {}, [difference_taps(1)], []
FILTERS: tuple[dict[str, Any], list[Taps], list[Taps]] = (
    {"velocity": Velocity.difference(window=0.003), "position": Filter.low_pass(300.0)},
    [difference_taps(3)],
    [low_pass_taps(0.3)],
)
CASES = {
    "motor": (devices.Drawn(0.25, 2.0, [], None, 200.0, PERIOD, 1.0), NONE, (800.0, 20.0)),
    "grip": (devices.Drawn(0.25, 1.0, [], ARM, None, PERIOD, 0.0), NONE, (900.0, 30.0)),
    "mode": (
        devices.Drawn(0.25, 1.0, [(80.0, 0.05, 0.5)], None, 400.0, PERIOD, 1.5),
        FILTERS,
        (600.0, 8.0),
    ),
}
LONG = 1500  # samples


def plant_of(drawn: devices.Drawn) -> Plant:
    a, wall, c = (np.array(one.tolist(), float) for one in drawn.mechanism.system())
    handle = drawn._replace(bandwidth=None).mechanism.system()
    hand = np.zeros(len(a))
    hand[: handle.b.rows] = np.array(handle.b.tolist(), float).ravel()
    return Plant(a * PERIOD, wall.ravel() * PERIOD, hand * PERIOD, c.ravel())


def loops_of(case: str) -> tuple[HapticLoop, Disturbed, tuple[float, float]]:
    drawn, (fields, velocity, position), wall = CASES[case]
    delay = drawn.delay * PERIOD
    loop = HapticLoop(device=device_of(drawn), sample_time=PERIOD, delay=delay, **fields)
    rates = wall[0], wall[1] / PERIOD
    disturbed = Disturbed(rates, (0.0, 0.0, drawn.delay), velocity, position, plant_of(drawn))
    return loop, disturbed, wall


@pytest.mark.campaign
@pytest.mark.parametrize("cause", ["encoder", "force_step", "friction"])
@pytest.mark.parametrize("case", CASES)
def test_the_worst_signals_come_close_to_the_bound_and_not_beyond(case: str, cause: str) -> None:
    loop, disturbed, wall = loops_of(case)
    size = {"encoder": 1e-5, "force_step": 0.01, "friction": 0.2}[cause]
    found = loop.amplitude(*wall, **{cause: size})
    assert found.status == AmplitudeStatus.PROVED
    sizes = (
        0.5 * size if cause == "encoder" else 0.0,
        0.5 * size if cause == "force_step" else 0.0,
        size if cause == "friction" else 0.0,
    )
    worst = worst_signals(disturbed, LONG, sizes).max(axis=0) / [1.0, PERIOD, 1.0]
    bounds = np.array([float(one) for one in found[:3]])
    assert (worst <= bounds * (1.0 + 1e-9)).all()
    # A friction that is constant over a quarter of a sample does a little less.
    np.testing.assert_array_less(bounds, worst * [1.05, 1.25, 1.05])


@pytest.mark.parametrize("case", CASES)
def test_runs_with_all_disturbances_stay_within_the_bound(
    case: str, rng: np.random.Generator
) -> None:
    loop, disturbed, wall = loops_of(case)
    unit = 1e-5  # m: the resolution, which the simulation has as 1
    found = loop.amplitude(*wall, encoder=unit, force_step=0.01, friction=0.05)
    runs = 40
    start = rng.normal(size=(len(disturbed.motion.c), runs)) * 20.0
    disturbance = Disturbance(rng.uniform(size=runs), force_step=0.01 / unit, friction=0.05 / unit)
    worst = largest(disturbed, disturbance, start, 400).max(axis=1) * unit
    bounds = np.array([float(one) for one in found[:3]])
    assert (worst / [1.0, PERIOD, 1.0] <= bounds).all()


def test_nothing_is_proved_of_an_unstable_wall() -> None:
    loop, _, _ = loops_of("mode")
    found = loop.amplitude([600.0, 1e6], 8.0, encoder=1e-5)
    assert np.isfinite(found.position[0])
    assert np.isinf(found.position[1])
    assert found.status.tolist() == [AmplitudeStatus.PROVED, AmplitudeStatus.NOT_PROVED]


def test_walls_come_to_rest_calmly_where_an_encoder_is_given() -> None:
    loop, _, _ = loops_of("motor")
    free = loop.tune("settling", encoder=1e-5)
    calm = loop.tune("settling", encoder=1e-5, chatter=0.8 * free.chatter)
    assert calm.chatter <= 0.8 * free.chatter
    assert calm.settling_time >= free.settling_time
    proved = loop.amplitude(calm.stiffness, calm.damping, encoder=1e-5)
    assert calm.chatter == pytest.approx(float(proved.position), rel=1e-12)


def test_a_fast_motor_costs_nothing_but_pieces() -> None:
    """An actuator of 20 kHz at 1 kHz: a bound still, close to that of none."""
    free = {"device_mass": 0.25, "device_damping": 2.0, "sample_time": PERIOD}
    device = device_of(devices.Drawn(0.25, 2.0, [], None, 2e4, PERIOD, 0.0))
    plain = HapticLoop(**free).amplitude(800.0, 20.0, encoder=1e-5)
    found = HapticLoop(device=device, sample_time=PERIOD).amplitude(800.0, 20.0, encoder=1e-5)
    assert float(found.position) == pytest.approx(float(plain.position), rel=0.1)
    assert float(found.force) == pytest.approx(float(plain.force), rel=0.1)
