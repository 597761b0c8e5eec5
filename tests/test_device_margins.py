"""Margins of any linear device against certified roots, and against those of one mass."""

import numpy as np
import pytest
from campaign import many

import jaxstab
from benchmarks import filtered_ranges, truth
from benchmarks.truth import devices, filtered
from benchmarks.truth.random_loops import device_of
from jaxstab import Filter, HapticLoop, Velocity, Verdict
from jaxstab.model.device import Device, Hand, Mode, sampled_device
from jaxstab.model.device.family import LoopFamily
from jaxstab.proofs.linear_circle import family_cells
from jaxstab.ranges import device_margins, is_stable_along
from jaxstab.ranges.device_margins import _critical_angles

PERIOD = 1e-3


@pytest.mark.parametrize("velocity", [None, Velocity.difference(samples=20)])
@pytest.mark.parametrize("delay", [1.0, 1.5])
def test_a_device_of_one_mass_has_the_margins_of_the_five_numbers(
    velocity: Velocity | None, delay: float
) -> None:
    device = sampled_device(Device.mass_spring_damper(0.1, damping=1.5), PERIOD, delay)
    loop = jaxstab.HapticLoop(
        device_mass=0.1,
        device_damping=1.5,
        sample_time=PERIOD,
        delay=delay * PERIOD,
        velocity=velocity,
    )
    walls = np.array([300.0, 5e4]), np.array([2.0, 2.0])
    found, expected = device_margins(device, *walls, velocity=velocity), loop.margins(*walls)
    np.testing.assert_array_equal(found.verdict, [Verdict.STABLE, Verdict.UNSTABLE])
    np.testing.assert_allclose(found.stiffness, expected.stiffness, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(found.damping, expected.damping, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(found.stiffness_gain, expected.stiffness_gain, rtol=1e-9)
    np.testing.assert_allclose(found.damping_gain, expected.damping_gain, rtol=1e-9)
    np.testing.assert_allclose(found.extra_delay, expected.extra_delay, rtol=1e-9)


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


def test_no_extra_delay_is_claimed_of_a_device_that_is_too_fast() -> None:
    arm = Hand.mass_spring_damper(1.0, damping=5.0, stiffness=300.0).with_grip(
        stiffness=1e11, damping=20.0
    )
    device = Device.mass_spring_damper(0.25, damping=0.1).held_by(arm)
    found = HapticLoop(device=device, sample_time=PERIOD).margins(300.0, 3.0)
    assert found.verdict == Verdict.STABLE
    assert found.stiffness_gain > 1.0
    assert np.isnan(found.extra_delay)


@pytest.mark.campaign
def test_margins_of_random_devices_end_where_certified_roots_cross() -> None:
    tally, _ = filtered_ranges.device_margins(np.random.default_rng(4), 3)
    assert tally.judged > 30
    assert tally.wrong == tally.short == 0


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["margins", "device_margins", "gaps"])
def test_no_claim_about_random_loops_with_filters_is_wrong(kind: str) -> None:
    tally, _ = getattr(filtered_ranges, kind)(np.random.default_rng(20), many(100))
    assert tally.judged > 8 * many(100)
    assert tally.wrong == 0


@pytest.mark.campaign
def test_a_polygon_is_proved_for_each_device_of_a_list() -> None:
    plain = Device.mass_spring_damper(0.25, damping=0.5)
    arm = plain.held_by(
        Hand.mass_spring_damper(0.5, damping=5.0, stiffness=200.0).with_grip(
            stiffness=2000.0, damping=5.0
        )
    )
    shaky = Device.modes([Mode(frequency=60.0, damping_ratio=0.02, modal_mass=2.0)], mass=0.25)
    devices = [sampled_device(device, PERIOD, 1.0) for device in (plain, arm, shaky)]
    window = Velocity.difference(samples=10)
    outline = np.array([[50.0, 4.0], [600.0, 6.0], [600.0, 12.0], [50.0, 12.0]])
    proved = is_stable_along(devices, outline, velocity=window)
    for device, is_proved in zip(devices, proved, strict=True):
        codes = [
            device_margins(device, *wall, velocity=window).verdict.item()
            for wall in [*outline, outline.mean(axis=0)]
        ]
        assert is_proved == all(code == Verdict.STABLE for code in codes)
    assert proved[:2].all()
    assert not is_stable_along(devices, 100.0 * outline, velocity=window).any()


def test_margins_of_devices_refuse_what_is_no_filter() -> None:
    device = sampled_device(Device.mass_spring_damper(0.1, damping=1.5), PERIOD, 1.0)
    with pytest.raises(TypeError, match="velocity"):
        device_margins(device, 1.0, 1.0, velocity=Filter())
    with pytest.raises(ValueError, match="stiffness"):
        device_margins(device, np.nan, 1.0)


@pytest.mark.parametrize("theta", [0.004, 0.3, 2.0, np.pi - 0.004])
def test_angles_at_which_a_delay_can_bring_a_root_to_the_circle_are_found(theta: float) -> None:
    """Next to 0 and pi, too: those of walls with |D| = |N H| there, at a fraction of 0.3."""
    device = sampled_device(Device.mass_spring_damper(1.0, damping=0.1), 1.0, 0.0)
    plant, z = truth.plant(0.0, 0.1, 0.3), np.exp(1j * theta)
    force = abs(np.polyval([float(plant.n2), float(plant.n1), float(plant.n0)], z))
    free = abs(np.polyval([1.0, float(plant.d1), float(plant.d0)], z))
    damping = free / (force * abs(0.3 + 1.0 - 1.0 / z))
    walls = np.array([[0.3 * damping * device.stiffness_unit, damping * device.damping_unit]])
    cells = family_cells(LoopFamily.over_delays(device, None))
    assert cells is not None
    angles = _critical_angles(cells, walls, np.array([0]), np.array([2.0**-7, 2.0**-13]))
    assert np.any((angles.low[1] <= theta) & (theta <= angles.high[1]))
    assert np.sum(angles.high[1] - angles.low[1]) < 1.0
