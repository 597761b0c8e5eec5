"""Devices in z: against truths of 40 digits, recursions, and devices in s that scipy samples."""

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import control
import numpy as np
import pytest
import scipy.signal
from campaign import first, many

import jaxstab
from jaxstab import Device, Filter, HandRange, HapticLoop, Velocity, Verdict
from jaxstab.model.device.discrete import sampled_steps
from tests.truth import recursions

HELD = Device.mass_spring_damper(mass=0.25, damping=0.1)
JOINT = Device.simulated(0.1, step=2e-3)
MEASURED = Velocity.measured()


def tool(mass: float, damping: float = 0.0, window: int = 1) -> jaxstab.Loop:
    simulated = Device.simulated(mass, damping=damping, step=1e-3)
    velocity = Velocity.difference(samples=window)
    return jaxstab.coupling(HELD, simulated, sample_time=1e-3, velocity=velocity)


def late(stiffness: float, damping: float) -> jaxstab.Loop:
    loop = HapticLoop(device=HELD, sample_time=1e-3, delay=stiffness * 1e-3)
    return jaxstab.pid(loop, ki=0.0, kd_delay=damping * 1e-3)


# Flint and Newton's method in mpmath on the determinants of recursions, 40 digits.
TRUTHS: dict[str, tuple[jaxstab.Loop, dict[str, float], list[tuple[float, float]]]] = {
    "light tool": (tool(0.05), {"damping": 30.0}, [(0.0, 140002.666702)]),
    "tool": (tool(0.5), {"damping": 30.0}, [(0.0, 24946.4156898)]),
    "heavy tool": (tool(5.0), {"damping": 30.0}, [(0.0, 18140.4790395)]),
    "fixed tool": (tool(1e6), {"damping": 30.0}, [(0.0, 17368.1280271)]),
    "damped tool": (tool(0.5, 2.0), {"damping": 60.0}, [(0.0, 40977.2058723)]),
    "stiffness given": (tool(1e6), {"stiffness": 3e4}, [(62.8358738804, 148.604125686)]),
    "two intervals": (
        tool(0.05),
        {"damping": 8.0},
        [(0.0, 34312.0657102), (130060.299351, 184002.666702)],
    ),
    "window": (
        tool(0.05, window=4),
        {"damping": 20.0},
        [(0.0, 8810.81685934), (146916.986487, 199995.686161)],
    ),
    "late stiffness": (late(20, 1), {"kd": 84.0}, [(0.0, 6095.77421728)]),
    "less damping": (late(20, 1), {"kd": 40.0}, [(0.0, 2623.50329708)]),
    "both late": (late(20, 20), {"kd": 4.0}, [(0.0, 174.903128308)]),
    "3 and 1": (late(3, 1), {"kd": 40.0}, [(0.0, 11446.1631734)]),
    "late damping": (late(1, 3), {"kd": 40.0}, [(0.0, 11288.7744715)]),
    "fractions": (late(2.5, 0.25), {"kd": 30.0}, [(0.0, 10313.3303135)]),
}


@pytest.mark.parametrize("name", TRUTHS)
def test_intervals_of_tools_and_of_two_delays_are_those_of_40_digits(name: str) -> None:
    loop, given, expected = TRUTHS[name]
    line = loop.intervals(**given)
    assert line.status.name == "PROVED"
    found = [(low.value, high.value) for low, high in line.intervals]
    assert np.allclose(found, expected, rtol=2e-11, atol=0.0)


LIMITS = {
    "tool": (tool(0.5), 50543.5992, 112.362),
    "heavy tool": (tool(5.0), 37525.4748, 106.312),
    "fixed tool": (tool(1e6), 36168.3486, 106.164),
    "late stiffness": (late(21, 1), 15844.823, 210.6504),
    "both late": (late(21, 21), 288.4113518, 10.6442),
}


@pytest.mark.parametrize("name", LIMITS)
def test_limits_of_tools_and_of_two_delays(name: str) -> None:
    loop, stiffness, damping = LIMITS[name]
    assert loop.limits()[:2] == pytest.approx((stiffness, damping), rel=2e-6)


def test_equal_delays_of_both_gains_are_those_of_the_wall() -> None:
    wall = HapticLoop(device=HELD, sample_time=1e-3, delay=1.3e-3)
    both = jaxstab.pid(wall, ki=0.0)
    assert both.limits().first == pytest.approx(wall.limits().stiffness, rel=1e-9)
    ends = both.intervals(kd=30.0).intervals, wall.stiffness_intervals(30.0).intervals
    assert ends[0] == ends[1]


@pytest.mark.parametrize("delay_steps", first([1, 5, 0, 2, 9], 2))
def test_a_simulated_device_with_its_own_velocity_is_pd_outside_of_the_engine(
    delay_steps: int,
) -> None:
    pd = jaxstab.simulated_pd(0.1, step=2e-3, substeps=4, delay_steps=delay_steps)
    loop = HapticLoop(device=JOINT, sample_time=8e-3, delay=delay_steps * 2e-3, velocity=MEASURED)
    assert loop.stiffness_intervals(5.0) == pd.intervals(kd=5.0)
    assert loop.damping_intervals(100.0) == pd.intervals(kp=100.0)
    assert loop.spectral_radius(100.0, 5.0) == pd.spectral_radius(kp=100.0, kd=5.0)
    assert loop.limits().stiffness == pytest.approx(pd.limits().first, rel=1e-9)
    if not delay_steps:
        assert loop.limits().stiffness == pytest.approx(6250.0, rel=1e-9)
        assert loop.limits().damping == pytest.approx(25.0, rel=1e-9)


# ----------------------------------------------------------------------- against step by step
Plant = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def a_plant(rng: np.random.Generator, outputs: int, *, is_direct: bool) -> Plant:
    """A plant in z of order 1 to 4; one of three has an exact root at 1."""
    order = int(rng.integers(1, 5))
    a = rng.standard_normal((order, order))
    a *= rng.uniform(0.5, 0.999) / np.abs(np.linalg.eigvals(a)).max()
    if rng.random() < 0.3:
        a[0], a[0, 0] = 0.0, 1.0
    b, c = rng.standard_normal((order, 1)), rng.standard_normal((outputs, order))
    c[0] *= np.sign(c[0] @ b[:, 0])
    return a, b, c, 0.3 * is_direct * rng.standard_normal((outputs, 1))


def disagreements(rng: np.random.Generator) -> tuple[int, list[str]]:
    """Compare a row and a column of a random loop with recursions, 1 % beside each end."""
    count, late, step = int(rng.integers(1, 5)), int(rng.integers(0, 8)), 10 ** rng.uniform(-4, -2)
    window = rng.choice([None, 1, 3])
    plant = a_plant(rng, 2 if window is None else 1, is_direct=late > 0 and rng.random() < 0.3)
    smoothing = float(rng.choice([1.0, 0.4]))
    velocity = MEASURED if window is None else Velocity.difference(samples=int(window))
    loop = HapticLoop(
        device=Device.discrete(*plant, step=step),
        sample_time=count * step,
        delay=late * step,
        velocity=velocity * Filter.exponential(smoothing) if smoothing < 1.0 else velocity,
    )
    timing = {"period": count * step, "count": count, "late": late, "window": window}
    units = 1.0 / loop.alpha(1.0), 1.0 if window is None else 1.0 / loop.beta(1.0)
    compared, wrong = 0, []
    for axis in (0, 1):
        other = float(rng.choice([-0.1, 0.03, 0.3])) * units[1 - axis]
        line = loop.damping_intervals(other) if axis else loop.stiffness_intervals(other)
        assert line.status.name == "PROVED"
        ends = [end.value for ends in line.intervals for end in ends if np.isfinite(end.value)]
        tried = [1e-3 * units[axis], units[axis]] + [
            e * side for e in ends for side in (0.99, 1.01)
        ]
        for value in tried:
            wall = (other, value) if axis else (value, other)
            truth = recursions.in_steps(*wall, plant, smoothing=smoothing, **timing)  # type: ignore[arg-type]
            radius = recursions.radius(truth)
            if abs(radius - 1.0) < 1e-6 or (axis and line.drift):
                continue
            compared += 1
            verdict = loop.verdict(*wall)
            if (verdict == Verdict.STABLE) != (radius < 1.0) or verdict == Verdict.UNDECIDED:
                wrong.append(f"{loop} {wall}: {radius}")
            if (line.holding(value) is not None) != (radius < 1.0):
                wrong.append(f"line of {loop} {wall}: {radius}")
    return compared, wrong


def test_random_devices_in_z_agree_with_recursions() -> None:
    rng = np.random.default_rng(54)
    found = [disagreements(rng) for _ in range(60)]
    assert not [text for _, texts in found for text in texts]
    assert sum(compared for compared, _ in found) > 200


@pytest.mark.campaign
def test_many_random_devices_in_z_agree_with_recursions() -> None:
    rng = np.random.default_rng(541)
    found = [disagreements(rng) for _ in range(many(4000, 150))]
    assert not [text for _, texts in found for text in texts]


# ---------------------------------------------------------------------- against devices in s
def sampled_by_scipy(step: float) -> Plant:
    matrices = np.array([[0.0, 1.0], [-80.0, -0.4]]), np.array([[0.0], [4.0]]), np.eye(2)
    sampled = scipy.signal.cont2discrete((*matrices, np.zeros((2, 1))), step)
    return sampled[0], sampled[1], sampled[2], sampled[3]


@pytest.mark.parametrize("late", [0, 1, 4, 7])
@pytest.mark.parametrize(
    "velocity", [None, Velocity.difference(samples=4), Velocity.low_pass(50.0)]
)
def test_a_sampled_device_has_the_limits_of_the_device_in_s(
    late: int, velocity: Velocity | None
) -> None:
    given: dict[str, Any] = {"sample_time": 1e-3, "delay": late / 4e3, "velocity": velocity}
    a, b, c, d = sampled_by_scipy(0.25e-3)
    sampled = HapticLoop(device=Device.discrete(a, b, c[:1], d[:1], step=0.25e-3), **given)
    spring = Device.mass_spring_damper(mass=0.25, damping=0.1, stiffness=20.0)
    exact = HapticLoop(device=spring, **given)
    for ours, truth in zip(sampled.limits()[:4], exact.limits()[:4], strict=True):
        assert ours == pytest.approx(truth, rel=1e-7, abs=1e-6)
    assert sampled.verdict([-25.0, 1000.0], 3.0).tolist() == [2, 1]
    margins = sampled.margins(1000.0, 5.0), exact.margins(1000.0, 5.0)
    assert margins[0].stiffness == pytest.approx(margins[1].stiffness, rel=1e-6)
    assert np.isnan(margins[0].extra_delay)


@pytest.mark.parametrize("late", [0, 1, 7])
def test_an_impact_on_a_device_in_z_is_a_push_for_one_of_its_steps(late: int) -> None:
    stiffness, damping, period, count = 1000.0, 5.0, 1e-3, 4000
    a, b, c, d = sampled_by_scipy(period / 4)
    state, last, forces, positions = b[:, 0], 0.0, np.zeros(4 * count + late), np.zeros(count)
    for k in range(count):
        positions[k] = position = state[0]
        begin = 4 * k + late
        speed = (position - last) / period
        forces[begin : begin + 4] = -stiffness * position - damping * speed
        last = position
        for force in forces[4 * k : 4 * k + 4]:
            state = a @ state + b[:, 0] * force
    sampled = Device.discrete(a, b, c[:1], d[:1], step=period / 4)
    loop = HapticLoop(device=sampled, sample_time=period, delay=late * period / 4)
    for level in (0.02, 0.5, 0.9):
        settled = np.flatnonzero(abs(positions) > level * abs(positions).max())[-1] + 1
        found = loop.settling_time(stiffness, damping, excitation="impact", level=level)
        assert float(found.value) == pytest.approx(settled * period, rel=1e-12)


def test_systems_of_scipy_and_of_control_are_taken_with_their_steps() -> None:
    a, b, c, d = sampled_by_scipy(1e-3)
    one = a, b, c[:1], d[:1]
    above, below = scipy.signal.ss2tf(*one)
    above = above[0, 1:]
    systems = [
        scipy.signal.dlti(*one, dt=1e-3),
        scipy.signal.dlti(above, below, dt=1e-3),
        control.ss(*one, 1e-3),
        control.tf(above, below, 1e-3),
    ]
    limits = [
        HapticLoop(device=Device.from_control(system), sample_time=1e-3).limits().stiffness
        for system in systems
    ]
    assert limits == pytest.approx([limits[0]] * 4, rel=1e-6)
    both = Device.from_control(scipy.signal.dlti(a, b, c, d, dt=1e-3))
    loop = HapticLoop(device=both, sample_time=1e-3, velocity=MEASURED)
    assert loop.limits().stiffness > 1.5 * limits[0]
    assert eval(repr(both), {"Device": Device}) == both


def test_a_wall_that_takes_away_the_spring_of_a_joint_is_unstable_by_structure() -> None:
    sprung = Device.simulated(0.1, stiffness=20.0, damping=0.5, step=2e-3)
    loop = HapticLoop(device=sprung, sample_time=4e-3, velocity=MEASURED)
    assert loop.verdict(-20.0, 1.0) == Verdict.UNSTABLE
    assert loop.verdict([-19.999, 0.0], 1.0).tolist() == [1, 1]
    assert loop.stiffness_intervals(1.0).intervals[0].low.value == -20.0


@pytest.mark.parametrize("velocity", [None, MEASURED, MEASURED * Filter.exponential(0.5)])
def test_regions_and_grids_agree_with_verdicts(velocity: Velocity | None) -> None:
    position = Filter.exponential(0.7) if velocity else None
    loop = HapticLoop(
        device=JOINT, sample_time=4e-3, delay=2e-3, velocity=velocity, position=position
    )
    region, rng = loop.region(), np.random.default_rng(7)
    assert region.status.name == "COMPLETE"
    limits = region.limits()
    walls = rng.uniform(-0.1, 1.2, (150, 2)) * (limits.stiffness, limits.damping)
    codes = loop.verdict(*walls.T)
    assert np.array_equal(region.contains(*walls.T), codes == Verdict.STABLE)
    assert [loop.verdict(*wall) for wall in walls[::10].tolist()] == codes[::10].tolist()
    many_limits = jaxstab.limits_of(loop, delay=[0.0, 2e-3])
    assert many_limits.stiffness[1] == pytest.approx(limits.stiffness, rel=1e-8)


def test_a_part_that_no_output_shows_counts() -> None:
    for hidden, code in ((0.5, Verdict.STABLE), (1.0, Verdict.UNSTABLE), (2.0, Verdict.UNSTABLE)):
        above, below = np.poly([hidden]), np.poly([hidden, 0.25])
        device = Device.discrete(above.tolist(), below.tolist(), step=1e-3)
        assert HapticLoop(device=device, sample_time=1e-3).verdict(0.1, 0.0) == code


# ---------------------------------------------------------------------------------------- motions
def stepped(n: int, late: int, window: int, gains: tuple[float, float], count: int) -> np.ndarray:
    """Positions of a joint at its steps, semi-implicit Euler under a unit force, n a sample."""
    inertia, damping, stiffness, step = 0.2, 0.1, 3.0, 1e-3
    x, v, forces, moved = 0.0, 0.0, dict[int, float](), list[float]()
    for k in range(n * count):
        moved.append(x)
        if k % n == 0:
            earlier = moved[k - window * n] if k >= window * n else 0.0
            forces[k // n] = -gains[0] * x - gains[1] * (x - earlier) / (window * n * step)
        acting = 1.0 + forces.get((k - late) // n, 0.0)
        v += step / inertia * (acting - damping * v - stiffness * x)
        x += step * v
    return np.array(moved)


@pytest.mark.parametrize(("n", "late", "window"), [(1, 0, 1), (2, 3, 3), (4, 5, 2), (3, 6, 4)])
def test_a_device_in_z_moves_and_settles_as_its_engine_steps_it(
    n: int, late: int, window: int
) -> None:
    joint = Device.simulated(0.2, step=1e-3, damping=0.1, stiffness=3.0)
    velocity, period = Velocity.difference(samples=window), n * 1e-3
    loop = HapticLoop(device=joint, sample_time=period, delay=late * 1e-3, velocity=velocity)
    limits = loop.limits()
    gains = 0.05 * limits.stiffness, 0.3 * limits.damping
    between = {} if n == 1 else {"between": n - 1}
    found = loop.simulate(*gains, samples=50, force=1.0, **between)
    truth = stepped(n, late, window, gains, 2000)
    assert np.allclose(found.position, truth[: 50 * n], rtol=0.0, atol=1e-13 * truth.max())
    final = 1.0 / (gains[0] + 3.0)
    outside = np.flatnonzero(np.abs(truth[::n] - final) > 0.02 * final)
    settling = loop.settling_time(*gains)
    assert round(float(settling.value) / period) == outside[-1] + 1
    assert loop.simulate(*gains, samples=3, initial_position=1.0).position[0] == 1.0
    best = loop.tune()
    truth = stepped(n, late, window, best[:2], 2000)[::n]
    final = 1.0 / (best.stiffness + 3.0)
    outside = np.flatnonzero(np.abs(truth - final) > 0.02 * final)
    assert round(best.settling_time / period) == outside[-1] + 1
    assert best.settling_time <= settling.value


def test_a_device_in_z_with_its_own_velocity_is_tuned_to_the_smallest_radius() -> None:
    loop = HapticLoop(device=JOINT, sample_time=2e-3, velocity=MEASURED)
    best, same = loop.tune("radius"), jaxstab.simulated_pd(0.1, step=2e-3).tune()
    assert best.radius == pytest.approx(same.radius, abs=1e-3)  # a triple root, deadbeat
    assert np.isnan(best.settling_time)


# -------------------------------------------------------------------------------------- refusals
LOOP = HapticLoop(device=JOINT, sample_time=2e-3)
WITH_ITS_OWN = HapticLoop(device=JOINT, sample_time=2e-3, velocity=MEASURED)
ONE = Device.discrete([1.0], [1.0, -0.5], step=1e-3)
ONE_STATE = Device.discrete([[0.5]], [1.0], [[1.0], [2.0]], step=1e-3)
DIRECT = Device.discrete([1.0, 0.0], [1.0, -0.5], step=1e-3)
HAND = jaxstab.Hand.mass_spring_damper(1.0)

REFUSALS: list[tuple[Callable[[], object], str]] = [
    (lambda: HapticLoop(device=JOINT, sample_time=3e-3), "1.5 steps of 0.002 s"),
    (lambda: HapticLoop(device=JOINT, sample_time=1e-3), "0.5 steps"),
    (lambda: HapticLoop(device=JOINT, sample_time=2e-3, delay=1e-3), "whole number"),
    (lambda: HapticLoop(device=DIRECT, sample_time=1e-3), "algebraic"),
    (lambda: HapticLoop(device=ONE, sample_time=1e-3, velocity=MEASURED), "no velocity output"),
    (lambda: HapticLoop(device=HELD, sample_time=1e-3, velocity=MEASURED), "no velocity output"),
    (
        lambda: jaxstab.verdict(0.1, 0.1, gamma=0.0, delta=0.0, delay=0.0, velocity=MEASURED),
        "velocity is measured",
    ),
    (lambda: jaxstab.coupling(HELD, JOINT, sample_time=1e-3), "0.5 steps"),
    (
        lambda: jaxstab.coupling(HELD, JOINT, sample_time=2e-3, velocity=MEASURED),
        "no velocity output",
    ),
    (lambda: JOINT.held_by(HAND), "at its steps alone"),
    (lambda: JOINT.with_actuator(100.0), "at its steps alone"),
    (lambda: JOINT.poles(), "at its steps alone"),
    (lambda: LOOP.simulate(100.0, 1.0, force=1.0, between=1), "at its steps alone, 1 a sample"),
    (
        lambda: HapticLoop(device=DIRECT, sample_time=1e-3, delay=1e-3).simulate(
            0.1, 0.0, force=1.0
        ),
        "same step",
    ),
    (lambda: WITH_ITS_OWN.settling_time(100.0, 1.0), "an estimator from positions"),
    (lambda: LOOP.amplitude(100.0, 1.0, encoder=1e-4), "at its steps alone"),
    (lambda: LOOP.jitter_margin(100.0, 1.0), "at its steps alone"),
    (lambda: LOOP.verdict(100.0, 1.0, delays=(0.0, 2e-3)), "at its steps alone"),
    (lambda: LOOP.worst_delays(100.0, 1.0, delays=(0.0, 2e-3)), "at its steps alone"),
    (lambda: LOOP.worst_hand(HandRange(mass=(0.0, 1.0)), 100.0, 1.0), "at its steps alone"),
    (lambda: LOOP.robust_limit(HandRange()), "at its steps alone"),
    (lambda: WITH_ITS_OWN.simulate(100.0, 1.0, initial_velocity=1.0), "a device in s"),
    (lambda: WITH_ITS_OWN.worst_hand(HandRange(), 100.0, 1.0), "at its steps alone"),
    (lambda: Device.discrete([1.0, 0.0, 0.0], [1.0, 2.0], step=1e-3), "of no lower degree"),
    (lambda: Device.discrete([1.0], [1.0], step=1e-3), "n from 1 to 40"),
    (lambda: Device.discrete([0.0], [1.0, 2.0], step=1e-3), "does not move"),
    (
        lambda: Device.discrete(np.eye(2), [1.0], [1.0, 0.0], step=1e-3),
        r"shapes \(2, 2\), \(1,\), \(2,\)",
    ),
    (lambda: Device.discrete([1.0], step=1e-3), "of no lower degree"),
    (lambda: Device.discrete(*np.eye(5), step=1e-3), "of no lower degree"),
    (lambda: Device.discrete([np.nan], [1.0, 0.5], step=1e-3), "numerator is nan"),
    (lambda: Device.discrete([1.0], [1.0, 0.5], step=0.0), "step is 0.0"),
    (lambda: Device.simulated(0.0, step=1e-3), "inertia is 0.0"),
    (lambda: Device.simulated(1.0, step=1e-3, integrator="euler"), "integrator is"),
    (lambda: Device.from_control(control.tf([1.0], [1.0, 0.5], True)), "dt = True"),
    (lambda: late(1, -1), "delay is"),
    (lambda: HapticLoop(device=ONE_STATE, sample_time=1e-3, velocity=MEASURED).region(), "alike"),
]


@pytest.mark.parametrize(("call", "words"), REFUSALS)
def test_bad_input_is_refused_in_a_sentence(call: Callable[[], object], words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=words):
        call()


@pytest.mark.parametrize(("count", "late"), [(1, 0), (7, 0), (50, 13), (4, 22)])
def test_many_steps_a_sample_are_those_of_fractions(count: int, late: int) -> None:
    """D(z) and N(z) of two states, from the steps one after the other, without rounding."""
    joint = Device.simulated(0.1, step=2e-3, damping=0.03, stiffness=0.7, integrator="rk4")
    move, push, _ = joint.mechanism.one_step()
    f, g = ([Fraction(int(x.p), int(x.q)) for x in side.entries()] for side in (move, push))

    def held(steps: int, state: tuple[Fraction, ...], force: int) -> tuple[Fraction, ...]:
        for _ in range(steps):
            x, v = state
            state = (f[0] * x + f[1] * v + g[0] * force, f[2] * x + f[3] * v + g[1] * force)
        return state

    rest, one = (Fraction(0), Fraction(0)), Fraction(1)
    (a, c), (b, d) = (held(count, own, 0) for own in ((one, rest[1]), (rest[0], one)))
    samples, part = divmod(late, count)
    newer = held(count - part, rest, 1)
    older = held(count - part, held(part, rest, 1), 0)
    position = [(x, b * v - d * x) for x, v in (newer, older)]  # of adj(z - F^n)
    numerator = [position[0][1], position[0][0]]  # rising powers of z
    if part:
        numerator = [position[1][1], position[0][1] + position[1][0], position[0][0]]
    below, above, lag = sampled_steps(joint.mechanism, count, late)
    assert lag == samples + (part > 0)
    for found, true in ((below, [a * d - b * c, -a - d, Fraction(1)]), (above[0], numerator)):
        assert [Fraction(int(x.p), int(x.q)) for x in found.coeffs()] == true
