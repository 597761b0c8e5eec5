"""Loops with any linear device: one mass bit for bit as ever, limits of grips and actuators."""

from dataclasses import replace
from typing import Any

import control
import jax
import numpy as np
import pytest
import scipy.linalg

from jaxstab import Device, Filter, Hand, HapticLoop, Mode, Velocity, Verdict

ARM = Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
MASS = Device.mass_spring_damper(mass=0.25, damping=0.1)
HELD = HapticLoop(
    device_mass=0.25, device_damping=0.1, hand_mass=1.0, hand_damping=5.0, hand_stiffness=300.0,
    sample_time=1e-3, delay=1e-3,
)  # fmt: skip
WINDOW = Velocity.difference(window=5e-3)
MODES = Device.modes([Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)], mass=0.25)
GRIPPED = MASS.held_by(ARM.with_grip(stiffness=2000.0, damping=4.0))


def loop_of(device: Device, **fields: Any) -> HapticLoop:
    return HapticLoop(device=device, sample_time=1e-3, delay=1e-3, **fields)


@pytest.mark.parametrize("filters", [{}, {"velocity": WINDOW, "position": Filter.low_pass(200.0)}])
def test_one_mass_with_a_glued_hand_is_answered_bit_for_bit(filters: dict[str, Any]) -> None:
    own, plain = loop_of(MASS.held_by(ARM), **filters), replace(HELD, **filters)
    rng = np.random.default_rng(1)
    most = plain.limits()
    stiffness = most.stiffness * rng.uniform(-0.1, 1.3, 200)
    damping = most.damping * rng.uniform(-0.1, 1.3, 200)
    assert np.array_equal(own.verdict(stiffness, damping), plain.verdict(stiffness, damping))
    assert np.array_equal(own.poles(stiffness, damping), plain.poles(stiffness, damping))
    assert own.limits() == most
    margins = own.margins(2000.0, 20.0), plain.margins(2000.0, 20.0)
    for mine, theirs in zip(*(each[:7] for each in margins), strict=True):
        assert np.array_equal(mine, theirs, equal_nan=True)
    assert own.tune("radius") == plain.tune("radius")


def test_a_grip_of_growing_stiffness_becomes_a_glued_hand() -> None:
    glued = replace(HELD, velocity=WINDOW).limits()
    away = []
    for stiffness in (1e5, 1e6, 1e7, 1e8):
        hand = ARM.with_grip(stiffness=stiffness, damping=0.02 * stiffness)
        limits = loop_of(MASS.held_by(hand), velocity=WINDOW).limits()
        away.append(abs(limits.stiffness / glued.stiffness - 1.0))
    assert away == sorted(away, reverse=True)
    assert away[-1] < 1e-3


def test_an_actuator_of_growing_bandwidth_becomes_none() -> None:
    free = loop_of(MASS, velocity=WINDOW).limits()
    away = []
    for bandwidth in (1e2, 1e3, 1e4, 1e5):
        limits = loop_of(MASS.with_actuator(bandwidth), velocity=WINDOW).limits()
        assert limits.stiffness < free.stiffness
        away.append(1.0 - limits.stiffness / free.stiffness)
    assert away == sorted(away, reverse=True)
    assert away[-1] < 1e-2


@pytest.mark.parametrize("device", [MODES, GRIPPED, MASS.with_actuator(200.0)])
def test_region_verdicts_and_radii_agree_at_the_edge(device: Device) -> None:
    loop = loop_of(device, velocity=WINDOW)
    limits, region = loop.limits(), loop.region()
    assert limits.is_reachable
    for share, code in ((1 - 1e-7, Verdict.STABLE), (1 + 1e-7, Verdict.UNSTABLE)):
        wall = limits.stiffness * share, limits.at_damping
        assert loop.verdict(*wall) == code
        assert region.contains(*wall) == (code == Verdict.STABLE)
        assert (float(loop.spectral_radius(*wall).value) < 1.0) == (code == Verdict.STABLE)
    low, high = loop.stiffness_limits(0.5 * limits.at_damping)
    assert loop.verdict(0.5 * (low + high), 0.5 * limits.at_damping) == Verdict.STABLE
    mode = loop.oscillation(0.999 * limits.stiffness, limits.at_damping)
    assert 0.0 < float(mode.damping_ratio) < 0.05


def test_poles_are_those_of_the_sampled_equations_of_motion() -> None:
    """A rigid body beside a mode, the force two samples late, in the states of the two."""
    mode, mass, period, wall = MODES.mechanism.modes[0], 0.25, 1e-3, (300.0, 2.0)
    w = 2.0 * np.pi * mode.frequency
    motion = np.zeros((5, 5))
    motion[0, 1] = motion[2, 3] = 1.0
    motion[3, 2:4] = -(w**2), -2.0 * mode.damping_ratio * w
    motion[1, 4], motion[3, 4] = 1.0 / mass, 1.0 / mode.modal_mass
    moved = scipy.linalg.expm(motion * period)
    # Four states, the position a sample ago, the force that acts and the one that comes next.
    step = np.zeros((7, 7))
    step[:4, :4], step[:4, 5] = moved[:4, :4], moved[:4, 4]
    step[4, [0, 2]] = 1.0
    step[5, 6] = 1.0
    step[6, [0, 2]] = -(wall[0] + wall[1] / period)
    step[6, 4] = wall[1] / period
    own = HapticLoop(device=MODES, sample_time=period, delay=2.0 * period).poles(*wall)
    truth = np.linalg.eigvals(step)
    np.testing.assert_allclose(
        np.sort(np.abs(own)), np.sort(np.abs(truth))[-len(own) :], rtol=1e-7, atol=1e-9
    )


@pytest.mark.parametrize("loop", [loop_of(GRIPPED, velocity=WINDOW), replace(HELD, delay=1.3e-3)])
def test_python_control_gets_the_open_loop(loop: HapticLoop) -> None:
    open_loop = loop.to_control(2000.0, 20.0)
    assert open_loop.dt == 1e-3
    closed = control.feedback(open_loop, 1)
    radius = float(loop.spectral_radius(2000.0, 20.0).value)
    assert np.abs(closed.poles()).max() == pytest.approx(radius, rel=1e-9)


def test_walls_of_a_general_device_go_through_jit() -> None:
    loop = loop_of(GRIPPED)
    walls = jax.numpy.linspace(100.0, 60000.0, 40), jax.numpy.full(40, 50.0)
    codes = np.asarray(jax.jit(loop.verdict)(*walls))
    plain = np.asarray(loop.verdict(*map(np.asarray, walls)))
    decided = codes != Verdict.UNDECIDED
    assert decided.any()
    np.testing.assert_array_equal(codes[decided], plain[decided])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"device": MASS, "device_mass": 1.0}, "device_mass is given beside device"),
        ({"device": MASS, "hand_stiffness": 10.0}, "hand_stiffness is given beside device"),
        ({}, "device_mass is missing"),
        ({"device_mass": 1.0}, "device_damping is missing"),
        ({"device": "omega"}, "device"),
    ],
)
def test_fields_of_both_kinds_are_not_mixed(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(TypeError, match=message) as caught:
        HapticLoop(sample_time=1e-3, **fields)
    assert "\n" not in str(caught.value)


def test_margins_of_a_general_device_end_at_its_region() -> None:
    loop = loop_of(GRIPPED, velocity=WINDOW)
    found = loop.margins(1000.0, 10.0)
    np.testing.assert_allclose(found.stiffness, loop.stiffness_limits(10.0), rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(found.damping, loop.damping_limits(1000.0), rtol=1e-6, atol=1e-6)
    assert found.stiffness_gain == pytest.approx(found.stiffness[1] / 1000.0)
    late = loop.delay + found.extra_delay
    assert replace(loop, delay=float(late * (1.0 - 1e-8))).verdict(1000.0, 10.0) == Verdict.STABLE
    assert replace(loop, delay=float(late * (1.0 + 1e-8))).verdict(1000.0, 10.0) != Verdict.STABLE
    with pytest.raises(TypeError, match="outside of jit"):
        jax.jit(lambda gain: loop.margins(gain, 10.0).damping)(1000.0)


def test_a_general_device_has_no_mass_of_the_paper() -> None:
    with pytest.raises(TypeError, match="not one mass"):
        _ = loop_of(GRIPPED).gamma
    assert loop_of(MASS.held_by(ARM)).mass == 1.25
