"""Margins of any linear device against certified roots, and against those of one mass."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from campaign import many

from benchmarks import ranges
from jaxstab import HapticLoop, Velocity, Verdict
from jaxstab.model.device import Device, Hand
from tests.truth import devices, filtered
from tests.truth.random_loops import DeviceLoop, device_of

PERIOD = 1e-3


@pytest.mark.parametrize("velocity", [None, Velocity.difference(samples=20)])
@pytest.mark.parametrize("delay", [1.0, 1.5])
def test_a_device_of_one_mass_has_the_margins_of_the_five_numbers(
    velocity: Velocity | None, delay: float
) -> None:
    times = {"sample_time": PERIOD, "delay": delay * PERIOD, "velocity": velocity}
    device = Device.mass_spring_damper(0.1, damping=1.5)
    plain = HapticLoop(device_mass=0.1, device_damping=1.5, **times)
    walls = np.array([300.0, 5e4]), np.array([2.0, 2.0])
    found, expected = (loop.margins(*walls) for loop in (HapticLoop(device=device, **times), plain))
    np.testing.assert_array_equal(found.verdict, [Verdict.STABLE, Verdict.UNSTABLE])
    for one, other in zip(found[:7], expected[:7], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-14)


@pytest.mark.campaign
@pytest.mark.parametrize("delay", [0.0, 1.5])
def test_an_extra_delay_ends_where_the_equations_of_motion_do(delay: float) -> None:
    """A mode, a grip and a motor; judged by certified roots for delays up to it and beyond."""
    arm = (1.0, 5.0, 300.0, (4.0, 2000.0))
    drawn = devices.Drawn(0.25, 0.1, [(80.0, 0.02, 0.5)], arm, 200.0, PERIOD, delay)
    loop = HapticLoop(device=device_of(drawn), sample_time=PERIOD, delay=delay * PERIOD)
    wall = 300.0, 3.0
    extra = float(loop.margins(*wall).extra_delay) / PERIOD
    rest = filtered.difference(1), filtered.average(1)
    for part, code in (
        (0.3, Verdict.STABLE),
        (0.8, Verdict.STABLE),
        (1 - 1e-8, Verdict.STABLE),
        (1 + 1e-8, Verdict.UNSTABLE),
    ):
        later = delay + part * extra
        balls = devices.DeviceLoop(drawn.mechanism.system(), PERIOD, later, *rest)
        assert balls.code(*wall) == code


def test_a_device_that_is_far_too_fast_for_its_sampling_has_margins() -> None:
    """A grip of 1e11 N/m, poles of hundreds of rad per sample: nearly as with a rigid grip."""
    arm = Hand.mass_spring_damper(1.0, damping=5.0, stiffness=300.0)
    mass = Device.mass_spring_damper(0.25, damping=0.1)
    gripped, rigid = (
        HapticLoop(device=mass.held_by(hand), sample_time=PERIOD).margins(300.0, 3.0)
        for hand in (arm.with_grip(stiffness=1e11, damping=20.0), arm)
    )
    np.testing.assert_allclose(gripped.stiffness, rigid.stiffness, rtol=1e-4)
    np.testing.assert_allclose(gripped.damping, rigid.damping, rtol=1e-4)
    assert 0.0 < gripped.extra_delay < 1.001 * rigid.extra_delay  # the search was ended


@pytest.mark.campaign
def test_margins_of_random_devices_end_where_certified_roots_cross() -> None:
    tally, _ = ranges.margins(np.random.default_rng(4), 3, DeviceLoop.drawn)
    assert tally.judged > 30
    assert tally.wrong == tally.short == 0


@pytest.mark.campaign
@pytest.mark.parametrize("draw", [ranges.mass_loop, DeviceLoop.drawn])
def test_no_claim_about_random_loops_with_filters_is_wrong(draw: Callable[..., Any]) -> None:
    tally, _ = ranges.margins(np.random.default_rng(20), many(100, 5), draw)
    assert tally.judged > 8 * many(100, 5)
    assert tally.wrong == 0
