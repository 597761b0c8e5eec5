"""The delay margin: stable up to it and unstable beyond it, as mpmath has it on both sides."""

from functools import partial

import numpy as np
import pytest

from benchmarks.truth import filtered
from benchmarks.truth.plain import Loop
from benchmarks.truth.random_loops import DeviceLoop, Filters, MassLoop
from jaxstab import Filter, HapticLoop, Velocity
from jaxstab.exact.delay_margin import DelayMargin, DelayStatus, delay_margin
from jaxstab.exact.line import stable_line
from jaxstab.model.balls import ball_loop, ball_triple, one_sample


def margin_of(loop: HapticLoop, wall: tuple[float, float]) -> DelayMargin:
    delay = float(loop.delay_samples)
    return delay_margin(partial(ball_loop, loop), partial(one_sample, loop), delay, wall)


def delayed(drawn: MassLoop | DeviceLoop, delay: float) -> Loop:
    if isinstance(drawn, MassLoop):
        return Loop.of(MassLoop((*drawn.plant[:2], delay), drawn.filters))
    return Loop.of(DeviceLoop(drawn.device._replace(delay=delay), drawn.filters))


def assert_is_the_margin(drawn: MassLoop | DeviceLoop, delay: float) -> None:
    loop = delayed(drawn, delay).loop
    row = stable_line(partial(ball_triple, loop), (0.0, 0.125), (1.0, 0.0))
    interval = next(one for one in row.intervals if one.high.value > 0.0)
    wall = 0.5 * (max(interval.low.value, 0.0) + interval.high.value), 0.125
    samples, _, status = margin_of(loop, wall)
    assert status == DelayStatus.PROVED
    assert 0.0 < samples < 1000.0
    for share in (0.3, 0.7, 1.0 - 1e-7):
        assert delayed(drawn, delay + share * samples).is_stable(*wall)
    assert delayed(drawn, delay + (1.0 + 1e-7) * samples).is_stable(*wall) is False


@pytest.mark.parametrize("samples", [1, 4, 20])
@pytest.mark.parametrize("delay", [0.0, 1.0, 1.4])
def test_the_margin_of_one_mass(samples: int, delay: float) -> None:
    truths = filtered.difference(samples), filtered.average(1)
    filters = Filters(Velocity.difference(samples=samples), Filter(), truths)
    assert_is_the_margin(MassLoop((0.0, 0.001, delay), filters), delay)


@pytest.mark.parametrize("hand", [(0.01, 0.05), (1e-4, 0.0)])
def test_the_margin_of_a_mass_that_is_held(hand: tuple[float, float]) -> None:
    truth = filtered.times(filtered.difference(1), filtered.low_pass(0.1, 2))
    velocity = Velocity.low_pass(0.1, order=2)
    filters = Filters(velocity, Filter(), (truth, filtered.average(1)))
    assert_is_the_margin(MassLoop((*hand, 0.5), filters), 0.5)


@pytest.mark.parametrize("frequency", [60.0, 120.0])
def test_the_margin_of_a_device_with_a_mode(frequency: float) -> None:
    drawn = DeviceLoop.drawn(np.random.default_rng(528))
    modes = [(frequency, 0.05, 0.5)]
    numbers = {"mass": 0.25, "damping": 0.2, "hand": None, "bandwidth": 200.0, "delay": 1.5}
    device = drawn.device._replace(modes=modes, **numbers)
    truths = filtered.difference(1), filtered.average(1)
    assert_is_the_margin(DeviceLoop(device, Filters(Velocity(), Filter(), truths)), 1.5)


def test_no_delay_is_too_long_for_a_weak_wall_on_a_strong_hand() -> None:
    loop = HapticLoop(
        device_mass=0.1, device_damping=2.0, hand_stiffness=500.0, hand_damping=10.0,
        sample_time=1e-3,
    )  # fmt: skip
    samples, angle, status = margin_of(loop, (50.0, 0.1))
    assert (samples, status) == (np.inf, DelayStatus.UNLIMITED)
    assert np.isnan(angle)
