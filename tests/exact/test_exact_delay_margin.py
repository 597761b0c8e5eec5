"""The delay margin: stable up to it and unstable beyond it, as mpmath has it on both sides."""

from functools import partial

import flint
import numpy as np
import pytest
import scipy.linalg

from jaxstab import Device, Filter, HapticLoop, Mode, Velocity
from jaxstab.exact.line import stable_line
from jaxstab.exact.margins import (
    DelayMargin,
    DelayStatus,
    _DelayedWall,
    _least_whole,
    _window,
    delay_margin,
)
from jaxstab.model.balls import ball_loop, ball_triple
from jaxstab.model.device.sampling import one_sample
from tests.truth import filtered
from tests.truth.plain import Loop
from tests.truth.random_loops import DeviceLoop, Filters, MassLoop


def margin_of(loop: HapticLoop, wall: tuple[float, float]) -> DelayMargin:
    delay = float(loop.delay_samples)
    sample = partial(one_sample, loop.held_device, loop.sample_time)
    return delay_margin(partial(ball_loop, loop), sample, delay, wall)


def delayed(drawn: MassLoop | DeviceLoop, delay: float) -> Loop:
    if isinstance(drawn, MassLoop):
        return Loop.of(MassLoop((*drawn.plant[:2], delay), drawn.filters))
    return Loop.of(DeviceLoop(drawn.device._replace(delay=delay), drawn.filters))


def assert_is_the_margin(drawn: MassLoop | DeviceLoop, delay: float) -> None:
    loop = delayed(drawn, delay).loop
    row = stable_line(partial(ball_triple, loop), (0.0, 0.125), (1.0, 0.0))
    interval = next(one for one in row.intervals if one.high.value > 0.0)
    wall = 0.5 * (max(interval.low.value, 0.0) + interval.high.value), 0.125
    samples, angle, status = margin_of(loop, wall)
    assert status == DelayStatus.PROVED
    assert 0.0 < samples < 1000.0
    for share in (0.3, 0.7, 1.0 - 1e-7):
        assert delayed(drawn, delay + share * samples).is_stable(*wall)
    assert delayed(drawn, delay + (1.0 + 1e-7) * samples).is_stable(*wall) is False
    falling = delayed(drawn, delay + samples).polynomial(*wall)
    roots = np.roots([float(c / falling[0]) for c in falling])
    assert np.abs(roots - np.exp(1j * angle)).min() < 1e-4


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


def test_a_whole_delay_is_least_among_those_that_have_the_angle() -> None:
    """By trying each: n below it have no theta with (n + 1) theta = angle + 2 pi l."""
    rng = np.random.default_rng(17)
    is_exact = 0
    for _ in range(400):
        low = float(rng.choice([0.0, rng.uniform(0.01, 3.0)]))
        theta = low, low + float(10.0 ** rng.uniform(-3.0, -0.5))
        middle, radius = float(rng.uniform(-np.pi, np.pi)), float(10.0 ** rng.uniform(-6.0, -1.0))
        least = float(rng.uniform(-2.0, 30.0))
        found = _least_whole(flint.arb(middle, radius), theta, least)
        n = np.arange(max(np.ceil(least), 0.0), 4000.0)
        # An l with (n + 1) theta_0 - angle <= 2 pi l <= (n + 1) theta_1 - angle, by both ends.
        first = np.ceil(((n + 1.0) * theta[0] - middle - radius) / (2.0 * np.pi))
        last = np.floor(((n + 1.0) * theta[1] - middle + radius) / (2.0 * np.pi))
        has_angle = n[first <= last]
        if has_angle.size:
            assert found <= has_angle[0]
            is_exact += found == has_angle[0]
    assert is_exact > 300


@pytest.mark.parametrize("samples", [1, 7])
def test_forms_over_an_interval_hold_the_values_in_it(samples: int) -> None:
    """Of the polynomials on the circle: all values, and the mean-value form about the middle."""
    velocity = Velocity.difference(samples=samples) * Filter.butterworth(90.0, order=2)
    loop = HapticLoop(device_mass=0.1, device_damping=0.3, sample_time=1e-3, velocity=velocity)
    with flint.ctx.workprec(192):
        own, wall = ball_loop(loop), (100.0, 3.0)
        search = _DelayedWall(own, one_sample(loop.held_device, loop.sample_time), 0.0, wall)
        parts = own.wall(*wall), own.denominator.times(own.position[1]).times(own.velocity[1])
        for theta in [(0.0, 0.3), (0.4, 0.41), (1.0, 1.6), (2.9, 3.1)]:
            middle = flint.arb(theta[0]) + (flint.arb(theta[1]) - theta[0]) / 2
            forms = search._over_theta(theta)
            for share in np.linspace(0.0, 1.0, 9).tolist():
                angle = flint.arb(theta[0]) + (flint.arb(theta[1]) - theta[0]) * share
                z = flint.acb(0, angle).exp()
                values = z - 1, *(flint.acb(1) * part.polynomial()(z) for part in parts)
                for form, value in zip(forms, values, strict=True):
                    assert form.all.overlaps(value)
                    assert (form.middle + form.slope * (angle - middle)).overlaps(value)


@pytest.mark.parametrize("damping", [0.3, 6000.0])  # the fast pole has 0.003 and 60 per sample
@pytest.mark.parametrize("fraction", [(0.0, 1.0), (0.0, 0.5), (0.6, 0.7), (0.9, 1.0)])
def test_the_response_to_late_forces_over_an_interval_has_its_values_and_slopes(
    damping: float, fraction: tuple[float, float]
) -> None:
    """N[v(f)] = c adj(z - F) v(f), v(f) what a force held for 1 - f adds, by SciPy."""
    period = 1e-3
    rates = np.array([[0.0, 1.0, 0.0], [-200.0, -damping, 1.0], [0.0, 0.0, 0.0]]) / 0.1
    rates[0, 1], rates[1, 2] = 1.0, 10.0
    loop = HapticLoop(
        device_mass=0.1, device_damping=damping, hand_stiffness=200.0, sample_time=period
    )
    held = scipy.linalg.expm(rates * period)[:2, :2]

    def response(f: float, w: float, *, is_slope: bool) -> float:
        late = scipy.linalg.expm(rates * period * (1.0 - f))
        states = -(rates @ late)[:2, 2] * period if is_slope else late[:2, 2]
        inverse = (1.0 + w) * np.eye(2) - held
        return float(np.linalg.solve(inverse, states)[0] * np.linalg.det(inverse))

    with flint.ctx.workprec(192):
        sample = one_sample(loop.held_device, period)
        search = _DelayedWall(ball_loop(loop), sample, 0.0, (100.0, 3.0))
        (middle, everywhere), slopes = search._over_fraction(fraction)
        for f in np.linspace(*fraction, 9).tolist():
            for w in (-2.0, -0.3, 0.7):
                truth = [response(f, w, is_slope=order) for order in (False, True)]
                for ball, value in zip((everywhere(w), slopes(w)), truth, strict=True):
                    assert abs(ball - value).lower() < 1e-12 * abs(value)
        here = response(0.5 * sum(fraction), 0.7, is_slope=False)
        assert float(middle(0.7)) == pytest.approx(here, rel=1e-9)


@pytest.mark.parametrize("samples", [1, 7])
@pytest.mark.parametrize("frequencies", [[], [400.0]])
def test_boxes_that_hold_a_root_on_the_circle_are_kept(
    samples: int, frequencies: list[float]
) -> None:
    """The crossings of a row with a delay of 3.3 samples have one there: boxes of all sizes."""
    modes = [Mode(frequency=own, damping_ratio=0.05, modal_mass=0.5) for own in frequencies]
    loop = HapticLoop(
        device=Device.modes(modes, mass=0.25, damping=0.2), sample_time=1e-3, delay=3.3e-3,
        velocity=Velocity.difference(samples=samples),
    )  # fmt: skip
    row = stable_line(partial(ball_triple, loop), (0.0, 3.0), (1.0, 0.0))
    crossings = [one for one in row.crossings if 0.0 < one.angle < 3.0]
    assert len(crossings) > 1
    rng = np.random.default_rng(19)
    with flint.ctx.workprec(192):
        sample = one_sample(loop.held_device, loop.sample_time)
        for value, _, angle, *_ in crossings:
            search = _DelayedWall(ball_loop(loop), sample, 1.1, (value, 3.0))
            for size in 10.0 ** rng.uniform(-6.0, -0.5, 40):
                low, high = rng.uniform(0.01, 1.0, (2, 2)) * size
                theta = max(angle - low[0], 0.0), min(angle + high[0], np.pi)
                fraction = max(0.3 - low[1], 0.0), min(0.3 + high[1], 1.0)
                ((key, *_),) = search.boxes(theta, fraction)
                assert key <= 3.3 + 1e-12
            ((key, *_),) = search.boxes((0.0, np.pi), (0.0, 1.0))
            assert 1.1 <= key <= 3.3


@pytest.mark.parametrize("samples", [2, 7, 30])
@pytest.mark.parametrize("theta", [(0.0, 0.2), (1.0, 1.4), (3.0, 3.1)])
def test_a_window_over_an_interval_has_its_values_and_slopes(
    samples: int, theta: tuple[float, float]
) -> None:
    k = np.arange(samples)
    around = flint.arb(sum(theta) / 2.0, (theta[1] - theta[0]) / 2.0)
    form = _window(samples, (around.mid(), around))
    narrowed = form.middle + form.slope * flint.acb(flint.arb(0, around.rad()))
    for angle in np.linspace(*theta, 9).tolist():
        turns = np.exp(1j * k * angle)
        for ball, value in (
            (form.all, np.sum(turns)),
            (narrowed, np.sum(turns)),
            (form.slope, np.sum(1j * k * turns)),
        ):
            assert abs(ball - complex(value)).lower() < 1e-9
