"""Backwards: the values of one quantity with which a wall is stable.

Truth is the criterion of Schur and Cohn in numbers of 60 digits, on coefficients that mpmath makes
of exponentials, and closed forms. Nothing of it is jaxstab's.
"""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from math import isnan
from typing import Any

import mpmath
import numpy as np
import pytest
import scipy.signal
from campaign import first, many
from commands import run

import jaxstab
from jaxstab.app.scene import Scene, design_loop
from jaxstab.conventions import Verdict
from jaxstab.loop import backwards
from jaxstab.results import StableEnd, StableValues, WorstHand
from tests.truth.problems import LEAST_INERTIAS

JOINT = jaxstab.HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=2e-3, delay=2e-3)
OMEGA = jaxstab.HapticLoop(
    device_mass=0.25,
    device_damping=0.1,
    sample_time=1e-3,
    delay=1e-3,
    velocity=jaxstab.Velocity.difference(window=0.02),
)


def is_stable(
    *, wall: tuple[float, float], window: int = 1, pole: Any = 0, **numbers: float
) -> bool:
    """True if p(z) of a mass on a damper has all roots inside: 60 digits, any whole delay.

    z^w D (z - q) z^n + N (K (z - q) z^n + B (1 - q)/(n T) z (z^n - 1)), w the delay, n the window
    and q the pole of a low pass.
    """
    with mpmath.workdps(60):
        m, b, k, T, d = map(mpmath.mpf, (numbers[name] for name in ("m", "b", "k", "T", "d")))
        rate = mpmath.matrix([[0, 1, 0], [-k / m, -b / m, 1 / m], [0, 0, 0]])
        late = d / T
        whole = int(mpmath.floor(late + mpmath.mpf(10) ** -9))
        rest = late - whole if late - whole > mpmath.mpf(10) ** -9 else mpmath.mpf(0)
        early, after = mpmath.expm(rate * (T * rest)), mpmath.expm(rate * (T * (1 - rest)))
        move = (after * early)[:2, :2]
        newest = after[:2, 2]
        older = after[:2, :2] * early[:2, 2]
        trace, det = move[0, 0] + move[1, 1], mpmath.det(move)
        D = [mpmath.mpf(1), -trace, det]

        def numerator(push: Any) -> list[Any]:  # [1, 0] adj(z - F) G
            return [push[0], -move[1, 1] * push[0] + move[0, 1] * push[1]]

        N = [*numerator(newest), mpmath.mpf(0)]
        N = [a + c for a, c in zip(N, [mpmath.mpf(0), *numerator(older)], strict=True)]
        low = [mpmath.mpf(1), -mpmath.mpf(pole)]
        spring = times(low, [mpmath.mpf(1)] + [mpmath.mpf(0)] * window)
        slope = wall[1] * (1 - mpmath.mpf(pole)) / (window * T)
        damper = times(
            [slope, mpmath.mpf(0)], [mpmath.mpf(1)] + [mpmath.mpf(0)] * (window - 1) + [-1]
        )
        wanted = [wall[0] * a + c for a, c in zip(spring, damper, strict=True)]
        free = times(times(D, spring), [mpmath.mpf(1)] + [mpmath.mpf(0)] * (whole + 1))
        closed = times(N, wanted)
        closed = [mpmath.mpf(0)] * (len(free) - len(closed)) + closed
        p = [a + c for a, c in zip(free, closed, strict=True)]
        while len(p) > 1:  # Schur and Cohn
            ratio = p[-1] / p[0]
            if abs(ratio) >= 1:
                return False
            p = [a - ratio * c for a, c in zip(p[:-1], p[:0:-1], strict=True)]
    return True


def times(p: list[Any], q: list[Any]) -> list[Any]:
    product = [mpmath.mpf(0)] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, c in enumerate(q):
            product[i + j] += a * c
    return product


@pytest.mark.parametrize(("delay", "gains", "least"), LEAST_INERTIAS)
def test_the_least_inertia_of_a_joint_of_500_hz(
    delay: float, gains: tuple[float, float], least: float
) -> None:
    found = replace(JOINT, delay=delay).range_of("device_mass", *gains)
    assert found.least == pytest.approx(least, rel=2e-8)
    assert len(found.intervals) == 1
    assert "no other end found by a scan of 5,000 values" in found.scan


def test_the_least_mass_without_a_delay_is_the_closed_form() -> None:
    """K T^2/m < 2 beta (2 - beta)/(2 + beta), beta = B T/m: a quadratic in the mass."""
    spring, damper, period = 3000.0, 12.0, 1e-3
    loop = jaxstab.HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=period)
    x, y = spring * period**2, damper * period  # 2 y (2 m - y) = x (2 m + y)
    least = (2.0 * y * y + x * y) / (4.0 * y - 2.0 * x)
    assert loop.range_of("device_mass", spring, damper).least == pytest.approx(least, rel=1e-9)


def test_an_engine_has_its_closed_form() -> None:
    """PD by semi-implicit Euler: kp h^2/J < 4 - 2 kd h/J."""
    loop = jaxstab.simulated_pd(0.1, step=2e-3)
    least = 1000.0 * 4e-6 / 4.0 + 10.0 * 2e-3 / 2.0
    found = loop.range_of("inertia", kp=1000.0, kd=10.0)
    assert found.least == pytest.approx(least, rel=1e-9)
    assert found.scan.endswith(" kg m^2")
    step = loop.range_of("step", kp=1000.0, kd=10.0).largest
    assert 1000.0 * step**2 / 0.1 == pytest.approx(4.0 - 20.0 * step / 0.1, rel=1e-8)


def test_an_admittance_allows_environments_and_whole_delays() -> None:
    """Without a delay M > T D/2 + Ke T^2/4."""
    loop = jaxstab.admittance(1e3, sample_time=2e-3)
    stiffest = loop.range_of("environment", mass=0.05, damping=10.0).largest
    assert stiffest == pytest.approx((0.05 - 2e-3 * 10.0 / 2.0) * 4.0 / 4e-6, rel=1e-9)
    late = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4)
    found = late.range_of("delay_samples", mass=2.0, damping=50.0)
    assert found.is_complete
    ((low, high),) = found.intervals
    assert (low.stable, high.unstable) == (0.0, high.stable + 1.0)
    for samples, verdict in ((high.stable, "STABLE"), (high.unstable, "UNSTABLE")):
        other = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=int(samples))
        assert other.verdict(mass=2.0, damping=50.0) == jaxstab.Verdict[verdict]


def test_pid_keeps_the_delay_that_its_derivative_has_of_its_own() -> None:
    loop = jaxstab.pid(replace(OMEGA, velocity=None), ki=0.0, kd_delay=0.0)
    longest = loop.range_of("delay", kp=5000.0, kd=60.0).largest
    for delay, verdict in ((0.999 * longest, "STABLE"), (1.001 * longest, "UNSTABLE")):
        late = jaxstab.pid(replace(OMEGA, velocity=None, delay=delay), ki=0.0, kd_delay=0.0)
        assert late.verdict(kp=5000.0, kd=60.0) == jaxstab.Verdict[verdict]


HOST = jaxstab.HapticLoop(device_mass=0.5, device_damping=0.2, sample_time=1e-3, delay=1e-3)
LATE = {"kd_delay": HOST.delay}  # it happens to equal the delay
FRONT = jaxstab.Filter.low_pass(100.0)
LEFT = jaxstab.Device.mass_spring_damper(mass=0.25, damping=0.1)
RIGHT = jaxstab.Device.mass_spring_damper(mass=0.5, damping=0.2)
DOORS: list[tuple[Callable[..., jaxstab.Loop], tuple[float, float]]] = [
    (partial(jaxstab.pid, loop=HOST, ki=0.0, **LATE), (3e3, 30.0)),
    *[
        (partial(jaxstab.simulated_pd, inertia=0.1, step=2e-3, damping=0.05, **options), gains)
        for options, gains in [
            ({"integrator": "implicit"}, (3e4, 30.0)),
            ({"integrator": "implicit-damping"}, (3e3, 30.0)),
            ({"integrator": "implicit", "substeps": 2}, (1e3, 5.0)),
            ({"outside": True}, (3e3, 10.0)),
            ({"integrator": "rk4", "delay_steps": 1}, (1e3, 5.0)),
        ]
    ],
    (partial(jaxstab.admittance, environment=1e4, sample_time=1e-3, delay_samples=4), (2.0, 50.0)),
    (
        partial(jaxstab.admittance, environment=1e3, sample_time=1e-3, force_filter=FRONT),
        (2.0, 50.0),
    ),
    (partial(jaxstab.pid, loop=HOST, kd=30.0), (3e3, 1e4)),
    (partial(jaxstab.coupling, first=LEFT, second=RIGHT, sample_time=1e-3), (3e3, 30.0)),
]


@pytest.mark.parametrize(("door", "gains"), first(DOORS, 3))
def test_values_are_stable_where_the_loop_made_of_them_is(
    door: Callable[..., jaxstab.Loop], gains: tuple[float, float]
) -> None:
    """Whatever can be asked for: the function that made the loop is called with the value."""
    loop = door()
    pair = dict(zip((gain.name for gain in loop.gains), gains, strict=True))
    with pytest.raises(ValueError, match="quantity is") as refused:
        loop.range_of("colour", **pair)
    names = re.findall('"([a-z_]+)"', str(refused.value))
    assert names
    is_held = "loop" in door.keywords  # whose names share one way
    between = (1e-4, 5e-3) if is_held else None
    for name in ("delay", "sample_time") if is_held else names:
        try:
            found = loop.range_of(name, between=between, count=6, **pair)
        except ValueError:
            continue
        values = [float(n) for n in range(8)] if found.is_complete else []
        values += [end for ends in found.intervals for end in (ends[0].stable, ends[1].stable)]
        values += [1.0001 * found.largest, 0.9999 * found.least] if not found.is_complete else []
        for value in (value for value in values if found.between[0] <= value <= found.between[1]):
            own = int(value) if found.is_complete else value
            try:
                held = {"loop": replace(HOST, **{name: own})} if is_held else {}
                made = door(**(held or {name: own}))
            except ValueError:
                verdict = jaxstab.Verdict.NOT_COMPUTED
            else:
                verdict = made.verdict(**pair)
            inside = any(low.stable <= value <= high.stable for low, high in found.intervals)
            assert inside == bool(verdict), (name, value, found)


def test_pid_offers_the_numbers_of_its_loop_alone() -> None:
    with pytest.raises(ValueError, match=r'"hand_stiffness", "delay"\.$'):
        jaxstab.pid(OMEGA, kd=5.0).range_of("colour", kp=1.0, ki=1.0)


def changed(quantity: str, value: float, numbers: dict[str, Any]) -> dict[str, Any]:
    """The numbers of the truth with another value of a quantity of the loop."""
    names = {"device_damping": "b", "hand_stiffness": "k", "delay": "d"}
    if quantity == "device_mass":
        return numbers | {"m": value}
    if quantity == "window":
        return numbers | {"window": int(value)}
    if quantity == "cutoff":
        return numbers | {"pole": float(np.exp(-2.0 * np.pi * (value * numbers["T"])))}
    return numbers | {names[quantity]: value}


def both_sides_are_what_they_are_said_to_be(
    found: StableValues, wall: tuple[float, float], numbers: dict[str, Any]
) -> int:
    """Judge both sides of each end by the truth; how many ends were judged from both."""
    ends = 0
    for pair in found.intervals:
        for end in pair:
            assert is_stable(wall=wall, **changed(found.quantity, end.stable, numbers))
            if not isnan(end.unstable):
                assert not is_stable(wall=wall, **changed(found.quantity, end.unstable, numbers))
                apart = abs(end.unstable - end.stable)
                assert apart <= (1.0 if found.is_complete else 1e-9 * end.stable)
                ends += 1
    return ends


def random_case(seed: int) -> tuple[jaxstab.HapticLoop, tuple[float, float], dict[str, Any]]:
    rng = np.random.default_rng(seed)
    m, T = float(10 ** rng.uniform(-3, 0)), float(10 ** rng.uniform(-4, -2))
    damping = float(rng.choice([0.0, 0.01])) * m / T
    spring = float(rng.choice([0.0, 1e-4, 0.01])) * m / T**2
    window, low = int(rng.choice([1, 1, 4, 11])), bool(rng.integers(2))
    cutoff = float(10 ** rng.uniform(-2, -0.5)) / T
    velocity = jaxstab.Velocity.difference(window)
    velocity = velocity * jaxstab.Filter.low_pass(cutoff) if low else velocity
    delay = float(rng.choice([0.0, 1.0, 2.0, rng.uniform(0, 3)])) * T
    loop = jaxstab.HapticLoop(
        device_mass=m,
        device_damping=damping,
        hand_stiffness=spring,
        sample_time=T,
        delay=delay,
        velocity=velocity,
    )
    beta = 10 ** rng.uniform(-2, -0.5)
    wall = float(beta * rng.uniform(0.02, 0.4) * m / T**2), float(beta * m / T)
    pole = float(np.exp(-2.0 * np.pi * (cutoff * T))) if low else 0.0
    return loop, wall, {
        "m": m, "b": damping, "k": spring, "T": T, "d": delay, "window": window, "pole": pole,
    }  # fmt: skip


QUANTITIES = "device_mass", "device_damping", "hand_stiffness", "delay", "window", "cutoff"


def judged(seeds: range, count: int) -> int:
    ends = 0
    for seed in seeds:
        loop, wall, numbers = random_case(seed)
        for quantity in QUANTITIES:
            if quantity == "cutoff" and not numbers["pole"]:
                continue
            found = loop.range_of(quantity, *wall, count=count)
            ends += both_sides_are_what_they_are_said_to_be(found, wall, numbers)
    return ends


def test_ends_are_ends_by_numbers_of_60_digits() -> None:
    assert judged(range(2), 60) >= 3


@pytest.mark.campaign
def test_ends_of_random_loops_are_ends() -> None:
    count = many(40, small=4)
    assert judged(range(100, 100 + count), 150) > 2 * count


@pytest.mark.campaign
def test_no_interval_that_a_finer_scan_finds_is_missed() -> None:
    for seed in range(many(12, small=4)):
        loop, wall, _ = random_case(seed)
        for quantity in ("device_mass", "device_damping", "hand_stiffness"):
            found, fine = (loop.range_of(quantity, *wall, count=n) for n in (None, 20_000))
            assert len(found.intervals) == len(fine.intervals), (seed, quantity)
            for own, other in zip(found.intervals, fine.intervals, strict=True):
                assert np.allclose([e.stable for e in own], [e.stable for e in other], rtol=1e-9)


def test_a_scan_ends_where_its_loops_can_be_computed() -> None:
    damped = jaxstab.HapticLoop(device_mass=0.1, device_damping=10.0, sample_time=1e-3)
    found = damped.range_of("device_mass", 5.0, 0.1)
    assert found.between == (found.least, found.largest)  # no end, and not called one
    assert found.least * 1000.0 == pytest.approx(10.0 * 1e-3, rel=0.01)
    numbers = {"T": 1e-3, "k": 0.0, "d": 0}
    for mass in (found.least, 1e-4, 0.01, found.largest):
        assert is_stable(wall=(5.0, 0.1), m=mass, b=10.0, **numbers)

    found = damped.range_of("device_damping", 50.0, 1e4)
    ((low, high),) = found.intervals
    assert high.stable == found.between[1] == pytest.approx(1000.0 * 0.1 / 1e-3, rel=0.01)
    for damping, stable in zip(low, (True, False), strict=True):
        assert is_stable(wall=(50.0, 1e4), m=0.1, b=damping, **numbers) == stable


@pytest.mark.campaign
def test_sample_times_are_those_with_whole_windows() -> None:
    found = OMEGA.range_of("sample_time", 1000.0, 10.0)
    assert found.is_complete
    (_, high), *_ = found.intervals
    for period, code in zip(high, (1, 2), strict=True):
        assert 0.02 / period == pytest.approx(round(0.02 / period))
        assert replace(OMEGA, sample_time=period).verdict(1000.0, 10.0) == code


def test_sample_times_divide_the_windows_of_both_filters() -> None:
    filters = jaxstab.Velocity.difference(window=0.004), jaxstab.Filter.average(window=0.006)
    position: dict[str, Any] = {"velocity": filters[0], "position": filters[1]}
    loop = jaxstab.HapticLoop(
        device_mass=0.3, device_damping=0.5, sample_time=1e-3, delay=1e-3, **position
    )
    found = loop.range_of("sample_time", 300.0, 10.0, between=(2e-4, 1e-2))
    ((low, high),) = found.intervals  # those between two of them make no loop, and are no gap
    assert found.between == (low.stable, high.stable) == (pytest.approx(2e-4), 0.002)

    def radius(period: float, stiffness: float, damping: float) -> float:
        plant = scipy.signal.cont2discrete(([1.0], [0.3, 0.5, 0.0]), period)
        above, below = np.atleast_1d(np.squeeze(plant[0])), plant[1]
        long, short = round(0.006 / period), round(0.004 / period)
        wall = np.pad(np.full(long, stiffness / long), 1)  # behind a delay, times z^(long + 1)
        wall[1] += damping / (short * period)
        wall[1 + short] -= damping / (short * period)
        loop = np.polyadd(np.polymul(below, np.eye(long + 2)[0]), np.polymul(above, wall))
        return float(np.abs(np.roots(loop)).max())

    table = {
        "device": {"mass": 0.3, "damping": 0.5},
        "controller": {
            "sample_time": 1e-3, "delay_samples": 1.0,
            "velocity": {"window": 0.004}, "position": {"window": 0.006},
        },
        "wanted": {"stiffness": 8000.0},
    }  # fmt: skip
    best = design_loop(Scene.from_table(table)).sample_time
    assert radius(best.largest_sample_time, 8000.0, best.at_damping) < 1.0
    longer = 0.002 / (round(0.002 / best.largest_sample_time) - 1)
    assert all(radius(longer, 8000.0, damping) > 1.0 for damping in np.linspace(0.0, 300.0, 60))


def test_a_device_in_z_has_whole_delays() -> None:
    device = jaxstab.Device.simulated(0.1, step=1e-3)
    loop = jaxstab.HapticLoop(device=device, sample_time=2e-3, delay=1e-3)
    found = loop.range_of("delay", 1000.0, 10.0)
    assert found.is_complete
    assert found.intervals[0][1].unstable - found.largest == pytest.approx(1e-3)


def test_a_cutoff_ends_without_a_proof_where_there_is_no_filter_beyond() -> None:
    loop = replace(OMEGA, velocity=jaxstab.Velocity.butterworth(100.0, order=2))
    ((low, high),) = loop.range_of("cutoff", 1000.0, 10.0).intervals
    assert high.stable == pytest.approx(500.0)
    assert isnan(high.unstable)
    for cutoff, code in zip(low, (1, 2), strict=True):
        velocity = jaxstab.Velocity.butterworth(cutoff, order=2)
        assert replace(loop, velocity=velocity).verdict(1000.0, 10.0) == code


def test_a_device_with_modes_needs_a_mass() -> None:
    mode = jaxstab.Mode(frequency=40.0, damping_ratio=0.05, modal_mass=0.5)
    device = jaxstab.Device.modes([mode], mass=0.3, damping=0.2)
    loop = jaxstab.HapticLoop(device=device, sample_time=1e-3, delay=1e-3)
    found = loop.range_of("device_mass", 2000.0, 5.0)
    assert found.intervals
    for low, high in found.intervals:
        for end in (low, high):
            for mass, code in zip(end, (1, 2), strict=True):
                if not isnan(mass):
                    other = jaxstab.Device.modes([mode], mass=mass, damping=0.2)
                    assert replace(loop, device=other).verdict(2000.0, 5.0) == code


def test_a_damper_alone_leaves_the_position_where_it_is() -> None:
    """K = 0: beta < 2 without a delay and a damper of its own, so that m > B T/2."""
    loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=0.0, sample_time=1e-3)
    assert loop.range_of("device_mass", 0.0, 10.0).least == pytest.approx(5e-3, rel=1e-9)


@pytest.mark.campaign
def test_hands_that_join_leave_the_verdicts_on_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hands between the corners refute ends; nothing is asked twice, and the ends are theirs."""
    asked, verdict = [], backwards.wall_verdict

    def spied(triple: Any, *wall: float, may_drift: bool) -> Any:
        asked.append(triple.args[0])
        return verdict(triple, *wall, may_drift=may_drift)

    monkeypatch.setattr(backwards, "wall_verdict", spied)
    mode = jaxstab.Mode(frequency=80.0, damping_ratio=0.02, modal_mass=0.1)
    device = jaxstab.Device.modes([mode], mass=0.2, damping=0.5)
    loop = jaxstab.HapticLoop(device=device, sample_time=1e-3, delay=1e-3, velocity=OMEGA.velocity)
    hands = jaxstab.HandRange(mass=(0.0, 0.5), damping=(0.0, 5.0), stiffness=(0.0, 300.0))
    wall = 600.0, 8.0
    found = loop.range_of("delay", *wall, hands=hands, between=(1e-4, 4.2e-3), count=6)
    tried = {each.device for each in asked}
    assert len(tried) > 8  # corners
    assert len(asked) == len(set(asked))
    end = found.intervals[0][1]
    codes = [
        {replace(loop, device=own, delay=delay).verdict(*wall) for own in tried} for delay in end
    ]
    assert codes == [{Verdict.STABLE}, {Verdict.STABLE, Verdict.UNSTABLE}]


@pytest.mark.campaign
def test_hands_that_refute_many_ends_join_until_the_others_are_proved() -> None:
    """Each window from 120 to 136 samples is refuted by some mass between those at the ends."""
    loop = jaxstab.HapticLoop(
        device_mass=0.78, device_damping=20.0, sample_time=1.75e-3, delay=1.75e-3
    )
    wall, hands = (7000.0, 28.0), jaxstab.HandRange(mass=(0.0, 0.5))
    found = loop.range_of("window", *wall, hands=hands, between=(120.0, 160.0))
    assert found.is_proved
    assert [(low.stable, high.stable) for low, high in found.intervals] == [(137.0, 160.0)]
    masses = replace(loop, device_mass=0.78 + np.linspace(0.0, 0.5, 401))
    for samples in range(120, 161):
        codes = replace(masses, velocity=jaxstab.Velocity.difference(samples)).verdict(*wall)
        assert np.any(codes == Verdict.UNSTABLE) == (samples < 137)


@pytest.mark.campaign
def test_ends_that_hand_after_hand_refutes_move_inwards() -> None:
    """Of a device with a mode the worst hand at an end lies between all that were tried."""
    mode = jaxstab.Mode(frequency=80.0, damping_ratio=0.02, modal_mass=0.1)
    device = jaxstab.Device.modes([mode], mass=0.2, damping=0.5)
    loop = jaxstab.HapticLoop(device=device, sample_time=1e-3, velocity=OMEGA.velocity)
    hands = jaxstab.HandRange(mass=(0.0, 0.5), damping=(0.0, 5.0), stiffness=(0.0, 300.0))
    found = loop.range_of("delay", 300.0, 8.0, hands=hands, between=(3e-3, 12e-3), count=6)
    ((low, high),) = found.intervals
    assert found.is_proved
    assert 1.005 < low.stable / low.unstable < 1.02
    for delay in (low.stable, high.stable):
        for mass, damping, stiffness in product((0.0, 0.1, 0.5), (0.0, 5.0), (0.0, 300.0)):
            hand = jaxstab.Hand.mass_spring_damper(mass=mass, damping=damping, stiffness=stiffness)
            held = replace(loop, device=device.held_by(hand), delay=delay)
            assert held.verdict(300.0, 8.0) == Verdict.STABLE


@pytest.mark.parametrize("proved", [(1.0, 1.03), (1.005, 1.015), (1.1, 1.2)])
def test_ends_that_are_looked_for_inwards_stay_in_order(proved: tuple[float, float]) -> None:
    """An interval of 3 %, of which all hands have all, a part, or nothing that is proved."""
    low, high = StableEnd(1.0, 0.999), StableEnd(1.03, 1.031)
    found = StableValues("delay", "s", ((low, high),), (0.5, 2.0), 500, is_complete=False)

    def worst(value: float) -> WorstHand:
        is_known = proved[0] <= value <= proved[1]
        return WorstHand(Verdict.STABLE if is_known else Verdict.UNDECIDED, OMEGA, 0.9)

    answer, refuting = backwards._for_all(found, worst)
    ((begin, end),) = answer.intervals
    assert low.stable <= begin.stable <= end.stable <= high.stable
    known = all(proved[0] <= value.stable <= proved[1] for value in (begin, end))
    assert (answer.is_proved, refuting) == (known, [])
    assert answer.is_proved == (proved[0] < 1.03)


def test_ends_are_proved_for_all_hands_and_unstable_with_one() -> None:
    hands = jaxstab.HandRange(mass=(0.0, 0.5), stiffness=(0.0, 300.0))
    found = OMEGA.range_of("device_mass", 1000.0, 15.0, hands=hands)
    assert found.is_proved
    ((low, _),) = found.intervals
    assert 0.0 < low.stable - low.unstable < 1e-3 * low.stable
    proved, not_so = (
        replace(OMEGA, device_mass=mass).worst_hand(hands, 1000.0, 15.0) for mass in low
    )
    assert (proved.verdict.name, not_so.verdict.name) == ("STABLE", "UNSTABLE")
    assert found.least > OMEGA.range_of("device_mass", 1000.0, 15.0).least


def test_limits_of_a_scan_are_what_is_given() -> None:
    found = OMEGA.range_of("device_mass", 1000.0, 10.0, between=(0.2, 0.4), count=7)
    assert (found.between, found.tried) == (pytest.approx((0.2, 0.4)), 7)
    assert found.least == pytest.approx(0.2)
    window = OMEGA.range_of("window", 1000.0, 10.0, between=(20.0, 40.0))
    assert (window.least, window.tried) == (20.0, 21)


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda: OMEGA.range_of("colour", 1.0, 1.0), "give one of"),
        (lambda: OMEGA.range_of("cutoff", 1.0, 1.0), "has 0 of it"),
        (
            lambda: OMEGA.range_of("delay", 1.0, 1.0, between=(2.0, 1.0)),
            "lowest value, and a higher",
        ),
        (lambda: OMEGA.range_of("delay", 1.0, 1.0, count=1), "count"),
        (lambda: OMEGA.range_of("delay", 1.0, float("nan")), "damping"),
        (lambda: OMEGA.range_of("delay", 1.0, 1.0, mass=(0.1, 0.2)), "mass without hands"),
        (
            lambda: OMEGA.range_of("hand_mass", 1.0, 1.0, hands=jaxstab.HandRange()),
            "beside a range of it",
        ),
        (
            lambda: jaxstab.Loop.from_coefficients(
                base=[1, -2, 1], first=[1, 0], second=[1, -1], sample_time=1.0
            ).range_of("mass", a=1.0, b=1.0),
            "no number that varies",
        ),
        (
            lambda: jaxstab.HapticLoop(
                device=jaxstab.Device.transfer_function([1.0], [1.0, 0.5, 0.0]), sample_time=1e-3
            ).range_of("device_mass", 1.0, 1.0),
            "does not have as one number",
        ),
    ],
)
def test_what_cannot_be_asked_is_refused_in_a_sentence(ask: Callable[[], Any], words: str) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        ask()
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------------------------------- commands
def test_limits_of_gains_without_an_inertia_answer_the_least_one() -> None:
    shown = run("limits", "--gains", "40", "2", "--rate", "500", "--delay", "0.002")
    assert (shown.exit_code, shown.stderr) == (0, "")
    lines = [" ".join(line.split()) for line in shown.stdout.splitlines()]
    assert "least inertia 0.005106930198 kg m^2" in lines
    assert "device damping 0 (assumed: the scene names none)" in lines
    given = run("limits", "--gains", "40", "2", "--rate", "500", "--damping", "0.1")
    assert "assumed: the scene names none" not in given.stdout.partition("device damping")[2]


def test_gains_with_an_inertia_are_a_wall() -> None:
    shown = run(
        "limits", "--gains", "40", "2", "--rate", "500", "--inertia", "0.1", "--damping", "0"
    )
    assert "wall gains" in shown.stdout
    assert "least inertia" not in shown.stdout


SCENE = ["data/scenes/omega.toml", "--gains", "1000", "15"]
SIMULATOR = "data/scenes/gains/simulator.toml"


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("asked", "held"), [("mass", "the longest"), ("delay", "each value that is tried")]
)
def test_design_says_which_constant_delay_stands_for_one_that_moves(asked: str, held: str) -> None:
    moving = ["--delay", "0:0.001", "--lost-samples", "1"]
    shown, one = (
        run("design", *SCENE, "--for", asked, *delay) for delay in (moving, ["--delay", "0.001"])
    )
    assert shown.exit_code == 0
    assert shown.stdout.splitlines()[2].endswith(
        "the delay varies between 0 and 1 ms; the most recent sample that has arrived is used, "
        f"up to 1 in a row are lost; here constant, {held}, no sample lost"
    )
    assert "each end is proved for every hand at a constant delay\n" in shown.stdout
    assert "each end is proved for every hand\n" in one.stdout


def test_the_least_inertia_is_for_a_constant_delay_and_says_so() -> None:
    gains = ["--gains", "6669.1", "71.6", "--rate", "1000", "--damping", "0.05", "--json"]
    moving = run("limits", *gains, "--delay", "0:0.001")
    one = run("limits", *gains, "--delay", "0.001")
    assert (moving.exit_code, one.exit_code) == (1, 0)
    inputs, wall = (json.loads(moving.stdout)[key] for key in ("inputs", "walls"))
    assert inputs["delay_is"].endswith("here constant, the longest")
    assert wall["gains"].pop("certainty") == "each end is proved at a constant delay"
    assert wall == json.loads(one.stdout)["walls"]


@pytest.mark.parametrize(
    ("asked", "needed"),
    [
        ("mass", r"least mass +0\.1575864047 kg\n"),
        ("damping", r"status +every value tried is stable\n"),
        pytest.param("window", r"largest window +28 samples\n", marks=pytest.mark.campaign),
    ],
)
def test_design_says_what_a_wall_needs_for_every_hand(asked: str, needed: str) -> None:
    shown = run("design", *SCENE, "--for", asked)
    assert shown.exit_code == 0
    assert "wall gains" in shown.stdout
    assert "chai3d" not in shown.stdout
    assert "each end is proved for every hand" in shown.stdout
    assert re.search(needed, shown.stdout)


def test_further_intervals_of_an_inertia_are_called_so() -> None:
    device = ["--inertia", "1", "--damping", "0.02", "--hand-stiffness", "5", "--delay", "0"]
    timing = ["--sample-time", "0.001", "--set", "controller.velocity.cutoff=20"]
    asked = ["design", *device, *timing, "--gains", "20", "0.3", "--for", "inertia"]
    answer = json.loads(run(*asked, "--json").stdout)
    wall = answer["walls"]["gains"]
    assert "  other inertia 1    " in run(*asked).stdout
    assert wall["other_inertia"]["1"] == pytest.approx([3.504839e-6, 1.33081405e-5])
    assert wall["least_inertia"] == pytest.approx(1.025884791e-4)
    assert {answer["units"][f"{end}_inertia"] for end in ("least", "other")} == {"kg m^2"}


def test_design_of_no_value_exits_with_1_and_json_has_all_digits() -> None:
    shown = run(
        "design",
        "data/scenes/joint.toml",
        "--set",
        "device.inertia=0.00486",
        "--for",
        "cutoff",
        "--json",
    )
    walls = json.loads(shown.stdout)["walls"]
    assert shown.exit_code == 1
    assert walls["full_scale"]["status"] == "no value tried is stable"
    assert walls["full_scale"]["scan"].startswith("none found by a scan of 500 values")
    assert walls["soft"]["least_cutoff"] == pytest.approx(2.548, rel=1e-3)


def test_what_is_0_now_is_scanned_from_0_on() -> None:
    """The damping c of a joint beside kd: kd + c + kp h/2 < 2 J/h."""
    joint = jaxstab.simulated_pd(1e-8, step=1e-3)
    found = joint.range_of("damping", kp=1e-3, kd=5e-6)
    assert found.least == 0.0
    assert found.largest == pytest.approx(2e-5 - 5e-6 - 0.5e-6, rel=1e-9)


def test_an_end_next_to_0_ends_the_search() -> None:
    """Without a damper a free mass has two roots at 1; with any it has one, which drifts."""
    free = jaxstab.HapticLoop(device_mass=0.1, device_damping=0.0, sample_time=1e-3)
    found = free.range_of("device_damping", 0.0, 0.0, count=5)
    assert 0.0 < found.least < 1e-15
    assert found.largest == found.between[1]


def test_no_mass_makes_no_loop() -> None:
    free = jaxstab.HapticLoop(device_mass=0.1, device_damping=0.0, sample_time=1e-3)
    found, above = (
        free.range_of("device_mass", 1000.0, 10.0, between=(low, 1.0)) for low in (0.0, 1e-4)
    )
    assert found.least == pytest.approx(above.least, rel=1e-9)


def test_what_is_not_proved_for_all_hands_holds_for_those_that_were_tried(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A search that is refuted to its end, by one hand after the other."""
    held, light = (
        jaxstab.HapticLoop(device_mass=0.1, device_damping=b, sample_time=1e-3) for b in (5.0, 0.0)
    )

    def refuted(found: StableValues, *_: Any, **__: Any) -> tuple[StableValues, list[Any]]:
        return found._replace(is_proved=False), [light]

    monkeypatch.setattr(jaxstab.loop.backwards, "_for_all", refuted)
    found = held.range_of("device_mass", 1000.0, 5.0, hands=jaxstab.HandRange())
    assert not found.is_proved
    assert "\n  not proved for every hand\n" in repr(found)
    assert found.least == pytest.approx(light.range_of("device_mass", 1000.0, 5.0).least)
    assert found.least > 1.001 * held.range_of("device_mass", 1000.0, 5.0).least


def test_single_values_are_printed_once() -> None:
    loop = jaxstab.HapticLoop(
        device_mass=0.1, device_damping=0.0, sample_time=1e-3, delay=1e-3,
        velocity=jaxstab.Velocity.difference(5),
    )  # fmt: skip
    assert "\n  1 samples\n" in repr(loop.range_of("window", 10_000.0, 30.0))


@pytest.mark.campaign
def test_a_table_of_scenes_has_the_ends() -> None:
    files = ["data/scenes/omega.toml", "data/scenes/joint.toml"]
    head, omega, joint = run("design", *files, "--for", "mass").stdout.splitlines()
    assert "soft: least mass" in head
    assert "soft: least inertia" in head
    assert "0.1575864047 kg" in omega
    assert "0.0007353363612 kg m^2" in joint  # 0.00073533636110495


@pytest.mark.campaign
def test_a_wall_has_a_name_in_design_as_in_check() -> None:
    asked = ["design", "data/scenes/omega.toml", "--for", "mass"]
    named, plain = (
        json.loads(run(*asked, *wall, "--json").stdout)["walls"]
        for wall in (["--wall", "new", "1000", "15"], ["--gains", "1000", "15"])
    )
    assert named["new"] == plain["gains"]
    assert set(named) > {"new"}
    answer = run("design", "data/scenes/omega.toml", "--wall", "new", "1000", "15")
    assert answer.exit_code == 2
    assert answer.stderr.endswith("--wall is given without --for; give what it needs.\n")


def test_a_delay_in_samples_goes_with_the_sample_time() -> None:
    device = ["--mass", "0.1", "--damping", "0", "--sample-time", "0.001", "--gains", "1000", "10"]
    answers = [
        json.loads(run("design", *device, *delay, "--for", "sample-time", "--json").stdout)
        for delay in (["--delay-samples", "1"], ["--delay", "0.001"])
    ]
    in_samples, in_s = (each["walls"]["gains"]["largest_sample_time"] for each in answers)
    loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=0.0, sample_time=in_s, delay=1e-3)
    assert loop.verdict(1000.0, 10.0) == jaxstab.Verdict.STABLE
    loop = replace(loop, sample_time=in_samples, delay=in_samples)
    assert loop.verdict(1000.0, 10.0) == jaxstab.Verdict.STABLE
    loop = replace(loop, sample_time=1.000001 * in_samples, delay=1.000001 * in_samples)
    assert loop.verdict(1000.0, 10.0) == jaxstab.Verdict.UNSTABLE


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["design", *SCENE], "without --for"),
        (
            ["design", SIMULATOR, "--gains", "80", "2", "--for", "inertia"],
            "--for, and --gains without a mass, are for walls of a held device; jaxstab study",
        ),
        (["limits", SIMULATOR, "--gains", "80", "2"], "asks for other loops"),
        (["design", *SCENE, "--for", "mass", "--plot", "a.png"], "--plot is given"),
        (["design", *SCENE, "--for", "mass", "--safety", "0.8"], "--safety is given"),
        (["design", *SCENE, "--for", "cutoff"], "low_pass(100.0) (--cutoff 100)."),
        (["design", "--for", "inertia", "--rate", "500", "--damping", "0"], "walls is empty"),
        (["limits", "--gains", "1", "1", "--rate", "0"], "--rate"),
        (["limits", "--gains", "1", "1", "--rate", "5", "--sample-time", "1"], "--rate"),
        (["limits", "--gains", "1", "1"], "sample_time is missing"),
        (["limits", "--gains", "1", "nan", "--rate", "500"], "damping"),
    ],
)
def test_a_command_refuses_in_a_sentence(arguments: list[str], words: str) -> None:
    refused = run(*arguments)
    assert (refused.exit_code, refused.stdout) == (2, "")
    assert words in refused.stderr


def test_check_says_where_an_unstable_wall_would_be_stable() -> None:
    """Of every hand at the corners: K from 0 on at its B, proved beside a K that is not."""
    shown = run("check", "data/scenes/omega.toml", "--json")
    wall = json.loads(shown.stdout)["walls"]["chai3d"]
    low, high = wall["stiffness_limits"]
    hands = jaxstab.HandRange(mass=(0.0, 0.2), stiffness=(0.0, 100.0), damping=(0.0, 2.0))
    verdicts = [OMEGA.worst_hand(hands, k, 30.0).verdict.name for k in (0.999 * high, 1.001 * high)]
    assert low == 0.0
    assert verdicts == ["STABLE", "UNSTABLE"]
    assert wall["damping_limits"] == [None, None]


def test_the_longest_delay_is_that_of_the_delay_margin() -> None:
    """The margin is the first crossing in a box search over angle and fraction, without a scan."""
    for loop in (OMEGA, JOINT):
        wall = (1000.0, 10.0) if loop is OMEGA else (10.0, 1.0)
        loop = replace(loop, device_mass=0.25)
        longest = loop.delay + float(loop.margins(*wall).extra_delay)
        (_, high) = loop.range_of("delay", *wall).intervals[0]
        assert high.stable == pytest.approx(longest, rel=1e-8)
