"""Loops of any two gains: truths of 40 digits, and what engines and controllers compute."""

import itertools
import math
import re
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import flint
import numpy as np
import pytest
from campaign import many

import jaxstab
from jaxstab import Verdict
from jaxstab.exact import LineStatus
from jaxstab.results import RegionStatus
from tests.truth import recursions

DEVICE = jaxstab.Device.mass_spring_damper(mass=0.25, damping=0.1)
OTHER = jaxstab.Device.mass_spring_damper(mass=0.5, damping=0.2)
ON_SPRING = jaxstab.Device.mass_spring_damper(mass=0.1, damping=0.5, stiffness=20.0)
SLOW, READ = jaxstab.Filter.exponential(0.1), jaxstab.Filter.exponential(0.2)


def held(window: int = 1) -> jaxstab.HapticLoop:
    velocity = jaxstab.Velocity.difference(samples=window)
    return jaxstab.HapticLoop(device=DEVICE, sample_time=1e-3, delay=1e-3, velocity=velocity)


def joint(**options: Any) -> jaxstab.Loop:
    return jaxstab.simulated_pd(0.1, step=2e-3, **options)


def sprung(integrator: str) -> jaxstab.Loop:
    return joint(damping=0.5, stiffness=20.0, integrator=integrator)


def robot(wall: float, period: float, late: int, **options: Any) -> jaxstab.Loop:
    return jaxstab.admittance(wall, sample_time=period, delay_samples=late, **options)


def couple(second: jaxstab.Device, *delays: float) -> jaxstab.Loop:
    return jaxstab.coupling(DEVICE, second, sample_time=1e-3, delays_samples=delays)  # type: ignore[arg-type]


# Flint and Newton's method in mpmath on the determinants of recursions, 40 digits.
INF = np.inf
TRUTHS = {
    "simulator": (joint(outside=True), {"kd": 10.0}, (0.0, 90000.0)),
    "a step late": (joint(delay_steps=1), {"kd": 10.0}, (0.0, 4000.0)),
    "every 4 steps": (joint(substeps=4), {"kd": 10.0}, (0.0, 3333.33333333)),
    "2 of 4 late": (joint(substeps=4, delay_steps=2), {"kd": 5.0}, (0.0, 573.306746431)),
    "every 10": (joint(substeps=10), {"kd": 3.0}, (0.0, 333.333333333)),
    "7 late": (joint(substeps=5, delay_steps=7), {"kd": 2.0}, (0.0, 93.7822657774)),
    "kd": (joint(substeps=4), {"kp": 100.0}, (0.3, 24.9)),
    "damped joint": (
        joint(substeps=4, damping=0.5, integrator="implicit-joint"),
        {"kd": 10.0},
        (0.0, 3529.26362974),
    ),
    "explicit": (sprung("explicit"), {"kd": 10.0}, (-20.0, 5230.0)),
    "semi-implicit": (sprung("semi-implicit"), {"kd": 10.0}, (-20.0, 89480.0)),
    "implicit-joint": (sprung("implicit-joint"), {"kd": 10.0}, (-20.0, 90480.0)),
    "implicit-damping": (sprung("implicit-damping"), {"kd": 10.0}, (-20.0, 110480.0)),
    "implicit": (sprung("implicit"), {"kd": 10.0}, (-20.0, INF)),
    "admittance": (robot(1e3, 2e-3, 10), {"mass": 10.0}, (19.8705717619, 9999.0)),
    "light": (robot(1e4, 1e-3, 4), {"mass": 2.0}, (39.515919035, 3995.0)),
    "heavy": (robot(1e5, 8e-3, 3), {"mass": 20.0}, (1885.37212481, 5400.0)),
    "slow robot": (
        robot(1e4, 1e-3, 5, robot=SLOW),
        {"mass": 2.0},
        (105.305296453, 4000.26315789),
    ),
    "read slowly": (
        robot(1e4, 1e-3, 5, robot=SLOW, force_filter=READ),
        {"mass": 2.0},
        (130.346545413, 4000.02923977),
    ),
    "backward": (robot(1e4, 1e-3, 4, rule="backward"), {"mass": 2.0}, (39.5250081919, INF)),
    "explicit rule": (robot(1e4, 1e-3, 4, rule="explicit"), {"mass": 2.0}, (49.0520521062, 4005.0)),
    "trapezoid": (robot(1e4, 1e-3, 4, rule="trapezoid"), {"mass": 2.0}, (39.4736011392, INF)),
    "spring": (robot(1e4, 1e-3, 4, stiffness=1e3), {"mass": 2.0}, (39.4676599975, 3994.5)),
    "least mass": (robot(1e4, 1e-3, 4), {"damping": 100.0}, (0.0525, INF)),
    "largest mass": (robot(1e4, 1e-3, 4), {"damping": 39.5}, (0.02225, 1.934237439)),
    "kp": (jaxstab.pid(held(), kd=50.0), {"ki": 1e5}, (405.297223468, 25486.3735143)),
    "ki": (jaxstab.pid(held(), kd=50.0), {"kp": 5e3}, (0.0, 1024414.8031)),
    "ki forward": (
        jaxstab.pid(held(), kd=50.0, rule="forward"),
        {"kp": 5e3},
        (0.0, 877851.0471),
    ),
    "ki trapezoid": (
        jaxstab.pid(held(), kd=50.0, rule="trapezoid"),
        {"kp": 5e3},
        (0.0, 947132.805048),
    ),
    "kd by ki": (jaxstab.pid(held(), ki=1e5), {"kp": 5e3}, (12.549777558, 200.179086276)),
    "kp by a window": (jaxstab.pid(held(20), kd=10.0), {"ki": 1e4}, (166.449488818, 1735.72184324)),
    "ki by a window": (jaxstab.pid(held(20), kd=10.0), {"kp": 1e3}, (0.0, 25790.8393688)),
    "two devices": (couple(OTHER, 1.0, 1.0), {"damping": 30.0}, (0.0, 15979.5226371)),
    "one later": (couple(OTHER, 1.0, 2.0), {"damping": 30.0}, (0.0, 12779.0591429)),
    "fractions": (couple(OTHER, 1.5, 2.25), {"damping": 20.0}, (0.0, 7452.67931977)),
    "one at once": (couple(OTHER, 0.0, 3.0), {"damping": 20.0}, (0.0, 11945.8674067)),
    "equal devices": (couple(DEVICE, 1.0, 1.0), {"damping": 30.0}, (0.0, 14587.3519408)),
    "one is held": (couple(ON_SPRING, 1.0, 1.0), {"damping": 20.0}, (0.0, 9227.15324243)),
    "and late": (couple(ON_SPRING, 2.0, 1.4), {"damping": 10.0}, (0.0, 4050.9052908)),
}


@pytest.mark.parametrize("name", TRUTHS)
def test_intervals_are_those_of_40_digits(name: str) -> None:
    loop, given, expected = TRUTHS[name]
    line = loop.intervals(**given)
    assert line.status.name == "PROVED"
    low, high = line.intervals[-1]
    assert (low.value, high.value) == pytest.approx(expected, rel=2e-11)


def test_stable_pd_has_a_second_interval_through_infinity() -> None:
    beyond, here = sprung("implicit").intervals(kd=10.0).intervals
    assert (beyond.low.value, beyond.high.value) == (-INF, pytest.approx(-110480.0))
    assert here.high.value == INF


@pytest.mark.parametrize("rule", ["semi-implicit", "implicit"])
def test_pd_without_damping_is_unstable_exactly(rule: str) -> None:
    loop = joint(integrator=rule)
    line = loop.intervals(kd=0.0)
    if rule == "semi-implicit":  # the two roots have the product 1: no ball tells
        assert loop.verdict(kp=1000.0, kd=0.0) == Verdict.UNSTABLE
        assert (line.status.name, line.intervals) == ("PROVED", ())
    else:
        assert loop.verdict(kp=1000.0, kd=0.0) == Verdict.STABLE


# ----------------------------------------------------------------------- against step by step
def a_simulator(rng: np.random.Generator) -> tuple[jaxstab.Loop, Callable[..., np.ndarray]]:
    engine: dict[str, Any] = {
        "inertia": 10 ** rng.uniform(-5, 1),
        "step": 10 ** rng.uniform(-4, -2),
        "integrator": str(rng.choice(["explicit", "semi-implicit", "implicit-joint", "rk4"])),
    }
    size = engine["inertia"] / engine["step"]
    engine["damping"] = float(rng.choice([0.0, 0.1])) * size
    engine["stiffness"] = float(rng.choice([0.0, 0.1])) * size / engine["step"]
    timing = {"substeps": int(rng.integers(1, 9)), "delay_steps": int(rng.integers(0, 10))}
    loop = jaxstab.simulated_pd(**engine, outside=True, **timing)
    return loop, lambda kp, kd: recursions.simulated(kp, kd, inside=False, **timing, **engine)


def inside_an_engine(rng: np.random.Generator) -> tuple[jaxstab.Loop, Callable[..., np.ndarray]]:
    rules = ["explicit", "semi-implicit", "implicit-joint", "implicit-damping", "implicit"]
    engine: dict[str, Any] = {
        "inertia": 10 ** rng.uniform(-5, 1),
        "step": 10 ** rng.uniform(-4, -2),
        "integrator": str(rng.choice(rules)),
    }
    size = engine["inertia"] / engine["step"]
    engine["damping"] = float(rng.choice([0.0, 0.1])) * size
    engine["stiffness"] = float(rng.choice([0.0, 0.1])) * size / engine["step"]
    loop = jaxstab.simulated_pd(**engine)
    return loop, lambda kp, kd: recursions.simulated(kp, kd, inside=True, **engine)


def an_admittance(rng: np.random.Generator) -> tuple[jaxstab.Loop, Callable[..., np.ndarray]]:
    given: dict[str, Any] = {
        "environment": 10 ** rng.uniform(2, 5),
        "sample_time": 10 ** rng.uniform(-4, -2),
        "delay_samples": int(rng.integers(1, 12)),
        "rule": str(rng.choice(["forward", "backward", "explicit", "trapezoid"])),
    }
    given["stiffness"] = float(rng.choice([0.0, 0.1])) * given["environment"]
    return jaxstab.admittance(**given), lambda mass, damping: recursions.admittance(
        mass, damping, **given
    )


def a_mass(rng: np.random.Generator) -> dict[str, float]:
    mass = 10 ** rng.uniform(-2, 1)
    damping = float(rng.choice([0.0, 0.1, 10.0])) * mass
    return {"mass": mass, "damping": damping, "stiffness": float(rng.choice([0.0, 100.0])) * mass}


def a_pid(rng: np.random.Generator) -> tuple[jaxstab.Loop, Callable[..., np.ndarray]]:
    body, period = a_mass(rng), 10 ** rng.uniform(-4, -2)
    delay, window = float(rng.choice([0.0, 0.5, 1.0, 2.25])), int(rng.integers(1, 6))
    loop = jaxstab.HapticLoop(
        device=jaxstab.Device.mass_spring_damper(**body),
        sample_time=period,
        delay=delay * period,
        velocity=jaxstab.Velocity.difference(samples=window),
    )
    name = str(rng.choice(["kp", "ki", "kd"]))
    size = body["mass"] / period
    given = {name: 0.1 * size * {"kp": 1 / period, "ki": 0.01 / period**2, "kd": 1.0}[name]}
    rule = str(rng.choice(["backward", "forward", "trapezoid"]))
    plant = recursions.HeldMass(*body.values(), period, loop.delay_samples)

    def truth(**gains: float) -> np.ndarray:
        return recursions.pid(
            **gains, **given, plant=plant, period=period, rule=rule, window=window
        )

    return jaxstab.pid(loop, **given, rule=rule), truth  # type: ignore[arg-type]


def a_coupling(rng: np.random.Generator) -> tuple[jaxstab.Loop, Callable[..., np.ndarray]]:
    bodies, period = [a_mass(rng), a_mass(rng)], 10 ** rng.uniform(-4, -2)
    bodies[1]["stiffness"] = 100.0 * bodies[1]["mass"]  # held: without drift
    delays = rng.choice([0.0, 0.5, 1.0, 2.25], 2).tolist()
    devices = [jaxstab.Device.mass_spring_damper(**body) for body in bodies]
    plants = [
        recursions.HeldMass(*body.values(), period, delay)
        for body, delay in zip(bodies, delays, strict=True)
    ]
    loop = jaxstab.coupling(*devices, sample_time=period, delays_samples=tuple(delays))
    return loop, lambda stiffness, damping: recursions.coupling(
        stiffness, damping, *plants, period=period
    )


KINDS = {
    "outside": a_simulator,
    "inside": inside_an_engine,
    "admittance": an_admittance,
    "pid": a_pid,
    "coupling": a_coupling,
}


def disagreements(kind: str, count: int) -> tuple[int, list[str]]:
    """Compare rows of random loops with recursions, 1 % on either side of each end."""
    rng, compared, wrong = np.random.default_rng(54), 0, []
    for index in range(count):
        loop, truth = KINDS[kind](rng)
        first, second = (gain.name for gain in loop.gains)
        scale = _scale(loop)
        for axis, (own, other) in enumerate(((first, second), (second, first))):
            at = scale[1 - axis] * float(rng.choice([0.03, 0.3, 1.0]))
            line = loop.intervals(**{other: at})
            assert line.status.name == "PROVED", (kind, index)
            ends = [end.value for ends in line.intervals for end in ends if np.isfinite(end.value)]
            tried = [1e-3 * scale[axis], scale[axis]]
            tried += [end * side for end in ends for side in (0.99, 1.01)]
            for value in tried:
                radius = recursions.radius(truth(**{own: value, other: at}))
                if abs(radius - 1.0) < 1e-6:
                    continue
                compared += 1
                if (line.holding(value) is not None) != (radius < 1.0):
                    wrong.append(f"{kind} {index} {own}={value} {other}={at}: {radius}")
    return compared, wrong


def _scale(loop: jaxstab.Loop) -> tuple[float, float]:
    """Gains of a size that matters."""
    from jaxstab.loop.affine import _units

    return _units(loop.parts)


@pytest.mark.parametrize("kind", KINDS)
def test_rows_agree_with_recursions(kind: str) -> None:
    compared, wrong = disagreements(kind, 25)
    assert not wrong
    assert compared > 60


@pytest.mark.campaign
@pytest.mark.parametrize("kind", KINDS)
def test_rows_of_many_loops_agree_with_recursions(kind: str) -> None:
    compared, wrong = disagreements(kind, count := many(2000, 60))
    assert not wrong
    assert compared > 2 * count


MANY = [sprung("implicit-joint"), joint(substeps=4, delay_steps=2), jaxstab.pid(held(), kd=50.0)]


@pytest.mark.parametrize("loop", [*MANY, couple(OTHER, 1.5, 2.25)])
def test_grids_of_gains_are_answered_as_pairs_are(loop: jaxstab.Loop) -> None:
    rng = np.random.default_rng(5)
    gains = {
        gain.name: scale * rng.choice([0.0, 0.01, 0.1, 1.0], 200) * rng.uniform(-0.3, 1.5, 200)
        for gain, scale in zip(loop.gains, _scale(loop), strict=True)
    }
    codes, radii = loop.verdict(**gains), loop.spectral_radius(**gains)
    for k in range(0, 200, 3):
        pair = {name: values[k] for name, values in gains.items()}
        assert loop.verdict(**pair) == codes[k]
        radius = loop.spectral_radius(**pair)
        assert abs(radius.value - radii.value[k]) <= radius.error + radii.error[k]


@pytest.mark.campaign
def test_grids_of_gains_go_through_jit_and_vmap() -> None:
    jax = pytest.importorskip("jax")
    loop = joint(substeps=4)
    kp = np.linspace(100.0, 7000.0, 7)
    plain = loop.verdict(kp=kp, kd=10.0)
    with jax.enable_x64():
        ours = jax.jit(jax.vmap(lambda kp: loop.verdict(kp=kp, kd=10.0)))(jax.numpy.asarray(kp))
        slope = jax.grad(lambda kp: loop.spectral_radius(kp=kp, kd=10.0).value)(2000.0)
    assert np.array_equal(ours, plain)
    sides = [loop.spectral_radius(kp=2000.0 + step, kd=10.0).value for step in (-1e-3, 1e-3)]
    assert slope == pytest.approx((sides[1] - sides[0]) / 2e-3, rel=1e-4)


MOVING = [robot(1e4, 1e-3, 4), robot(1e4, 1e-3, 4, rule="trapezoid"), sprung("implicit")]


@pytest.mark.parametrize("loop", MOVING)
def test_jit_and_vmap_take_gains_that_move_the_leading_coefficient(loop: jaxstab.Loop) -> None:
    jax = pytest.importorskip("jax")
    rng, names = np.random.default_rng(7), [gain.name for gain in loop.gains]
    sizes = (0.1, 100.0) if names[0] == "mass" else (1e5, 50.0)
    gains = [size * rng.uniform(-0.2, 2.0, 120) for size in sizes]
    plain = loop.verdict(**dict(zip(names, gains, strict=True)))
    assert set(np.unique(plain)) == {Verdict.STABLE, Verdict.UNSTABLE}
    with jax.enable_x64():
        one = jax.vmap(lambda a, b: loop.verdict(**{names[0]: a, names[1]: b}))
        assert np.array_equal(jax.jit(one)(*map(jax.numpy.asarray, gains)), plain)
        nothing = loop.verdict(**{names[0]: jax.numpy.zeros(1), names[1]: 0.0})
    assert names[0] != "mass" or nothing[0] == Verdict.UNDECIDED  # algebraic


# --------------------------------------------------------------------------------------- regions
LIMITS = {  # the largest of both gains, and the other one there, in closed form
    "semi-implicit": (joint(), (1e5, 0.0), (100.0, 0.0)),  # 0 < a < 4 - 2 b
    "a step late": (joint(delay_steps=1), (6250.0, 25.0), (50.0, 0.0)),  # 0 < a < b (1 - b)
    "every 4 steps": (joint(substeps=4), (6250.0, 18.75), (25.0, 0.0)),  # two lines
    "explicit": (joint(integrator="explicit"), (1e5, 200.0), (200.0, 1e5)),  # a corner
}


@pytest.mark.parametrize("name", LIMITS)
def test_limits_of_simulators_are_those_in_closed_form(name: str) -> None:
    loop, *expected = LIMITS[name]
    limits = loop.limits()
    assert limits.status == RegionStatus.COMPLETE
    for limit, pair in zip((limits[:2], limits[2:4]), expected, strict=True):
        assert limit == pytest.approx(pair, rel=1e-9, abs=1e-6)


def test_an_admittance_has_its_region_by_the_inverse_of_its_mass() -> None:
    loop = robot(1e4, 1e-3, 4)
    region = loop.region()
    panel = region.plot()
    assert panel.get_xlabel() == "1/mass (1/kg)"
    assert panel.get_ylabel() == "damping/mass (1/s)"
    masses = np.array([0.01, 0.1, 2.0, 50.0])
    dampings = np.array([20.0, 39.5, 45.0, 3000.0])
    grid = np.meshgrid(masses, dampings)
    inside = region.contains(mass=grid[0], damping=grid[1])
    verdicts = loop.verdict(mass=grid[0], damping=grid[1])
    assert np.array_equal(inside, verdicts == Verdict.STABLE)
    least = loop.limits().first
    assert loop.intervals(mass=1.001 * least).intervals
    assert not loop.intervals(mass=0.999 * least).intervals


def test_gains_that_take_the_highest_power_are_outside() -> None:
    region = jaxstab.admittance(1e3, sample_time=2e-3, delay_samples=3).region()
    masses = [0.0, 20.0]
    assert region.contains(mass=masses, damping=100.0).tolist() == [False, True]
    assert region.distance(mass=masses, damping=100.0)[0] == -np.inf


@pytest.mark.parametrize("rule", ["forward", "backward", "explicit", "trapezoid"])
def test_regions_of_admittances_agree_with_verdicts(rule: str) -> None:
    loop = robot(1e4, 1e-3, 3, rule=rule)
    region, rng = loop.region(), np.random.default_rng(3)
    gains = {"mass": 10 ** rng.uniform(-3, 2, 200), "damping": 10 ** rng.uniform(0, 4, 200)}
    verdicts = loop.verdict(**gains)
    assert np.array_equal(region.contains(**gains), verdicts == Verdict.STABLE)
    assert set(np.unique(verdicts)) == {Verdict.STABLE, Verdict.UNSTABLE}


@pytest.mark.parametrize("loop", [jaxstab.pid(held(), kd=50.0), jaxstab.pid(held(), ki=1e5)])
def test_regions_of_pid_agree_with_verdicts(loop: jaxstab.Loop) -> None:
    region, rng = loop.region(), np.random.default_rng(4)
    low, high = region.outline.min(axis=0), region.outline.max(axis=0)
    points = low + (high - low) * rng.uniform(-0.2, 1.2, (200, 2))
    gains = dict(zip((gain.name for gain in loop.gains), points.T, strict=True))
    verdicts = loop.verdict(**gains)
    assert np.array_equal(region.contains(**gains), verdicts == Verdict.STABLE)
    assert set(np.unique(verdicts)) == {Verdict.STABLE, Verdict.UNSTABLE}
    assert loop.limits().is_reachable == (loop.gains[1].name == "ki")


@pytest.mark.parametrize("rule", ["backward", "trapezoid"])
def test_the_least_damping_of_an_admittance_may_be_that_of_no_mass(rule: str) -> None:
    loop = robot(1e4, 1e-3, 4, rule=rule)
    limits = loop.limits()
    assert (limits.mass, limits.at_mass) == (0.0, 0.0)
    light = 10.0 ** np.linspace(-9.0, -1.0, 30)
    assert np.all(loop.verdict(mass=light, damping=0.9999 * limits.damping) == Verdict.UNSTABLE)


@pytest.mark.parametrize(("environment", "period"), [(1e4, 1e-3), (109.719, 5e-4), (21342.3, 2e-3)])
def test_the_least_mass_is_0_where_no_mass_is_needed(environment: float, period: float) -> None:
    """Without a mass D (z - 1) + Ke T is left of p(z), stable for D > Ke T/2."""
    limits = robot(environment, period, 0, rule="backward").limits()
    assert limits.mass == 0.0
    assert limits.at_damping == pytest.approx(environment * period / 2.0)


def test_an_admittance_without_delay_needs_a_mass_and_no_damping() -> None:
    """M > T D/2 + Ke T^2/4 in closed form."""
    limits = jaxstab.admittance(1e4, sample_time=1e-3).limits()
    assert limits.first == pytest.approx(1e4 * 1e-6 / 4.0, rel=1e-9)
    assert limits.second == 0.0


@pytest.mark.parametrize("rule", ["forward", "backward", "trapezoid", "explicit"])
@pytest.mark.parametrize("filtered", [False, True])
def test_an_admittance_without_a_damper_is_not_stable(rule: str, filtered: bool) -> None:
    """Without delay its roots keep the product 1: on the circle, or one of them outside."""
    options: dict[str, Any] = {"force_filter": jaxstab.Filter.low_pass(50.0)} if filtered else {}
    loop = robot(1e4, 1e-3, 0, rule=rule, **options)
    assert loop.verdict(mass=10.0, damping=0.0) == Verdict.UNSTABLE
    assert loop.verdict(mass=1e-3, damping=0.0) == Verdict.UNSTABLE
    assert loop.verdict(mass=10.0, damping=300.0) == Verdict.STABLE


def test_a_row_of_gains_may_keep_the_product_of_the_roots_at_1() -> None:
    """Common powers of z do not count, and a gain that moves no root leaves all as they are."""
    for common in (0, 3):
        more = [0] * common
        loop = jaxstab.Loop.from_coefficients(
            base=[1, -2, 1, *more],
            first=[1, 0, *more],
            second=[1, 0, -1, *more],
            sample_time=1e-3,
        )
        assert loop.parts.is_reciprocal((0.5, 0.0), (1.0, 0.0))
        assert not loop.parts.is_reciprocal((0.5, 0.1), (1.0, 0.0))
        assert not loop.parts.is_reciprocal((0.5, 0.0), (0.0, 1.0))


def test_printed_limits_are_rounded_to_the_stable_side() -> None:
    limits = jaxstab.pid(held(), kd=50.0).limits()
    assert limits.first == pytest.approx(25860.6638, abs=1e-4)
    assert "largest  kp = 25860 N/m at ki = " in repr(limits)
    limits = robot(1e4, 1e-3, 4).limits()
    assert 0.0158504 < limits.first < 0.0158505
    assert "least    mass = 0.015851 kg" in repr(limits)


def test_rows_of_a_region_end_where_a_root_is_on_the_circle() -> None:
    loop = joint(substeps=4)
    rows = loop.region().intervals_at(kd=np.array([5.0, 18.75, 30.0]))
    assert np.isnan(rows[2]).all()
    for kd, (low, high) in zip((5.0, 18.75), rows[:2, 0], strict=True):
        assert low == 0.0
        for kp, is_inside in ((high * (1.0 - 1e-6), True), (high * (1.0 + 1e-6), False)):
            p = loop.parts.polynomial(kp, kd)
            with flint.ctx.workdps(60):
                assert all(abs(root) < 1 for root, _ in p.complex_roots()) is is_inside


def printed_pairs(limits: jaxstab.results.Limits) -> list[dict[str, float]]:
    """The pairs of gains that a person reads, in their order, but for limits that have none."""
    lines = [re.findall(r"(\w+) = ([-+.e\d]+)", line) for line in repr(limits).splitlines()[1:]]
    return [{name: float(text) for name, text in line} for line in lines if len(line) == 2]


@pytest.mark.parametrize(
    "loop",
    [joint(), joint(substeps=4), joint(delay_steps=1), robot(1e4, 1e-3, 4)],
    ids=["inside", "every 4 steps", "a step late", "admittance"],
)
def test_a_pair_that_is_printed_is_stable(loop: jaxstab.Loop) -> None:
    """At a corner the limit itself has roots on the circle: of 60 digits they are inside."""
    pairs = printed_pairs(loop.limits())
    assert len(pairs) == 2
    for pair, limit in zip(pairs, loop.limits()[:3:2], strict=True):
        assert next(iter(pair.values())) == pytest.approx(limit, rel=1e-4)
        assert loop.verdict(**pair) == Verdict.STABLE
        p = loop.parts.polynomial(*(pair[gain.name] for gain in loop.gains))
        with flint.ctx.workdps(60):
            assert all(abs(root) < 1 for root, _ in p.complex_roots())


def test_gains_that_touch_an_axis_from_outside_are_not_0_or_more() -> None:
    """p is (z + 1)^2 - a (z + 1) (z + 2) - b: b < 0 is what p(-1) = -b asks of it."""
    loop = jaxstab.Loop.from_coefficients(
        base=[1, 2, 1], first=[-1, -3, -2], second=[-1], sample_time=1.0
    )
    limits = loop.limits()
    assert np.isnan([limits.a, limits.b]).all()
    assert "no gains with a >= 0 and b >= 0 are stable" in repr(limits)
    assert loop.verdict(a=0.5, b=-1e-3) == Verdict.STABLE
    a, b = np.meshgrid(np.linspace(0.0, 3.0, 61), np.linspace(0.0, 3.0, 61))
    assert not np.any(loop.verdict(a=a, b=b) == Verdict.STABLE)


def given(base: list[int], first: list[int], second: list[int]) -> jaxstab.Loop:
    return jaxstab.Loop.from_coefficients(base=base, first=first, second=second, sample_time=1.0)


def test_lines_know_the_roots_that_whole_numbers_have() -> None:
    """p is (z - 1)((1 + b) z^2 - (1 + b) z + b): all but z = 1 are inside for b > 0 alone."""
    line = given([1, -3, 2, -1], [1, -1, 1], [1, -2, 2, -1]).intervals(a=1.0)
    assert line.status == LineStatus.PROVED
    assert line.drift == 1
    assert line.bits <= 768
    assert [(low.value, high.value) for low, high in line.intervals] == [(0.0, math.inf)]


@pytest.mark.parametrize(
    ("shared", "stable"), [([2, 1, 1], True), ([1, -1, 1], False), ([3, 1, -7], False)]
)
def test_roots_that_no_gain_moves_are_judged_once(shared: list[int], *, stable: bool) -> None:
    """Of (shared)(z + b): b is between -1 and 1 if the shared roots are inside."""
    base, second = np.polymul(shared, [1, 0]).tolist(), shared
    line = given(base, [1, 0], second).intervals(a=0.0)
    assert line.status == LineStatus.PROVED
    ends = [(low.value, high.value) for low, high in line.intervals]
    assert ends == ([(-1.0, 1.0)] if stable else [])


def test_a_region_of_whole_numbers_without_stable_gains_is_empty() -> None:
    """With p(1) = -6 + 4 a and p(-1) = 4 for all b; a grid of numpy's roots has none inside."""
    sides = [1, -2, -3, -3, 1], [1, 2, 1], [1, 0, -2, 0, 1]
    limits = given(*sides).limits()
    assert limits.status == RegionStatus.EMPTY
    base, first, second = (np.pad(side, (5 - len(side), 0)) for side in sides)
    for a, b in itertools.product(np.linspace(-8.0, 8.0, 33), repeat=2):
        roots = np.roots(base + a * first + b * second)
        assert np.abs(roots).max(initial=np.inf if len(roots) < 4 else 0.0) > 1.0 - 1e-6


@pytest.mark.parametrize("status", [RegionStatus.EMPTY, RegionStatus.UNRESOLVED])
def test_limits_that_are_not_known_say_nothing_of_small_gains(status: RegionStatus) -> None:
    limits = jaxstab.simulated_pd(0.1, step=2e-3).limits()
    text = str(limits._replace(first=math.nan, status=status, is_reachable=False))
    assert text.splitlines()[0] == f"Limits: {status.words}"
    assert "alpha" not in text


def test_an_equal_device_on_a_wall_that_moves_is_the_wall_of_an_endless_mass() -> None:
    heavy = jaxstab.Device.mass_spring_damper(mass=1e9)
    limits = jaxstab.coupling(DEVICE, heavy, sample_time=1e-3).limits()
    wall = jaxstab.HapticLoop(device=DEVICE, sample_time=1e-3, delay=1e-3).limits()
    assert limits.first == pytest.approx(wall.stiffness, rel=1e-6)
    assert limits.second == pytest.approx(wall.damping, rel=1e-6)


# ------------------------------------------------------------------------------------ coefficients
def test_coefficients_may_be_fractions_or_intervals() -> None:
    half = jaxstab.Loop.from_coefficients(
        base=[1, -2, 1], first=[Fraction(1, 2), 0], second=[1, -1], sample_time=1.0
    )
    line = half.intervals(b=1.0)
    assert [(low.value, high.value) for low, high in line.intervals] == [(0.0, 4.0)]
    wide = jaxstab.Loop.from_coefficients(
        base=[1, -2, 1], first=[(0.5, 1.0), 0], second=[1, -1], sample_time=1.0, gains=("kp", "kd")
    )
    codes = wide.verdict(kp=[1.0, 3.0, 5.0, -1.0], kd=1.0)
    assert codes.tolist() == [
        Verdict.STABLE,
        Verdict.UNDECIDED,  # stable for some of the interval
        Verdict.UNSTABLE,
        Verdict.UNSTABLE,
    ]


def test_intervals_that_hold_0_are_no_powers_of_z() -> None:
    """z^2 + 0.5 z + c with c from -3 to 3 has roots outside; the answers had said stable."""
    sides: dict[str, Any] = {"first": [1, 0], "second": [1, 0], "sample_time": 1.0}
    loop = jaxstab.Loop.from_coefficients(base=[1, 0.5, (-3.0, 3.0)], **sides)
    assert loop.verdict(a=0.0, b=0.0) == Verdict.UNDECIDED
    assert not loop.intervals(b=0.0).intervals
    assert loop.spectral_radius(a=0.1, b=0.0).error == np.inf


def test_margins_of_an_interval_that_is_not_proved_are_the_place_itself() -> None:
    """z + c + a d + b with c to 0.1 and d to 0.5: |b| < 0.75 at a = 0.3; the ends of a are wide."""
    loop = jaxstab.Loop.from_coefficients(
        base=[1, (-0.1, 0.1)], first=[(-0.5, 0.5)], second=[1], sample_time=1.0
    )
    margins = loop.margins(a=0.3, b=0.1)
    assert margins.second == pytest.approx([-0.75, 0.75], abs=1e-6)
    assert np.all(np.abs(margins.second) <= 0.75)
    assert margins.first.tolist() == [0.3, 0.3]  # they had been swapped
    assert margins.first_factors.tolist() == margins.both_factors.tolist() == [1.0, 1.0]


def test_intervals_say_no_more_than_their_corners_do() -> None:
    """Quadratics z^2 + c z + d are stable for |d| < 1 and |c| < 1 + d, a condition on corners."""
    rng, seen = np.random.default_rng(7), set()
    for _ in range(200):
        middle, width = rng.uniform(-1.2, 1.2, 2), rng.uniform(0.0, 1.0, 2)
        low, high = (middle - width).tolist(), (middle + width).tolist()
        loop = jaxstab.Loop.from_coefficients(
            base=[1, *zip(low, high, strict=True)], first=[1, 0], second=[1], sample_time=1.0
        )
        corners = [(c, d) for c in (low[0], high[0]) for d in (low[1], high[1])]
        are_stable = [abs(d) < 1.0 and abs(c) < 1.0 + d for c, d in corners]
        code = loop.verdict(a=0.0, b=0.0)
        seen.add(int(code))
        assert (code == Verdict.STABLE) <= all(are_stable)
        assert (code == Verdict.UNSTABLE) <= (not any(are_stable))
    assert seen == {1, 2, 3}


def test_whole_numbers_beyond_float64_are_exact() -> None:
    """(2^53 + 1) z - 2^53 is stable, and float64 has a root at 1 in place of it."""
    n = 2**53
    for base in ([n + 1, -n], [np.int64(n + 1), -n]):
        loop = jaxstab.Loop.from_coefficients(base=base, first=[n], second=[n], sample_time=1.0)
        assert loop.verdict(a=0.0, b=0.0) == Verdict.STABLE
    wide = jaxstab.Loop.from_coefficients(
        base=[(n + 1, n + 2), -n], first=[n], second=[Fraction(1, 3)], sample_time=1.0
    )
    assert wide.verdict(a=0.0, b=0.0) == Verdict.STABLE
    large = jaxstab.Loop.from_coefficients(
        base=[2**80, -(2**81), 2**80], first=[2**80, 0], second=[2**80, -(2**80)], sample_time=1.0
    )
    assert large.limits().first == pytest.approx(4.0)


def test_an_algebraic_loop_has_no_verdict() -> None:
    loop = jaxstab.Loop.from_coefficients(
        base=[1, 0], first=[1, 0.5], second=[0, 1], sample_time=1.0
    )
    assert loop.verdict(a=-1.0, b=0.1) == Verdict.UNDECIDED
    with pytest.raises(ValueError, match="not bounded"):
        loop.region()


THIRDS = {"base": [Fraction(1, 3), 1, 0], "first": [Fraction(-2, 3), 0, 0], "second": [1]}


@pytest.mark.parametrize(
    ("loop", "gains"),
    [
        (jaxstab.Loop.from_coefficients(**THIRDS, sample_time=1.0), {"a": 0.5, "b": 0.1}),
        (robot(1e4, 1e-3, 4), {"mass": 0.0, "damping": 50.0}),
    ],
)
def test_a_root_at_infinity_is_no_stable_loop(loop: jaxstab.Loop, gains: dict[str, float]) -> None:
    """p = z + 0.1 where the gain takes z^2/3 from it: next to there a root is far outside."""
    name, value = next(iter(gains.items()))
    assert loop.verdict(**gains) == Verdict.UNDECIDED
    radius = loop.spectral_radius(**gains)
    assert np.isnan(radius.value)
    assert radius.error == np.inf
    assert np.all(np.isnan(loop.poles(**gains)))
    assert not loop.intervals(**{name: value}).intervals
    beside = [gains | {name: value + side} for side in (-1e-9, 1e-9)]
    assert all(loop.verdict(**pair) == Verdict.UNSTABLE for pair in beside)
    assert all(loop.spectral_radius(**pair).value > 100.0 for pair in beside)


def test_gains_along_which_no_root_moves_are_answered() -> None:
    """p = z - 1/2 + a - b and p = a z + (1 + b)(z - 1/2)."""
    alike = jaxstab.Loop.from_coefficients(base=[1, -0.5], first=[1], second=[-1], sample_time=1.0)
    margins = alike.margins(a=0.25, b=0.25)
    assert margins.both_factors.tolist() == [0.0, np.inf]
    assert margins.first.tolist() == pytest.approx([-0.25, 1.75])
    same = jaxstab.Loop.from_coefficients(
        base=[1, -0.5], first=[1, 0], second=[1, -0.5], sample_time=1.0
    )
    ends = [(low.value, high.value) for low, high in same.intervals(b=-1.0).intervals]
    assert ends == [(-np.inf, 0.0), (0.0, np.inf)]  # p = a z
    with pytest.raises(ValueError, match="one of them does not act"):
        same.limits()


REFUSALS = [
    (lambda: joint(integrator="rk4"), "not affine in the gains"),
    (lambda: joint(integrator="euler"), "integrator is"),
    (lambda: joint(substeps=0), "substeps is 0"),
    (lambda: robot(-1.0, 1e-3, 4), "environment is -1"),
    (lambda: robot(1e3, 1e-3, 4, rule="exact"), "rule is"),
    (lambda: jaxstab.pid(held()), "give one of kp, ki and kd"),
    (lambda: jaxstab.pid(held(), kp=1.0, ki=2.0), "kp, ki; give one"),
    (lambda: jaxstab.pid(held(), ki=0.0, kd_delay=-1.0), "kd_delay is -1.0; allowed are"),
    (lambda: couple(OTHER, 1.0), "one delay for each"),
    (lambda: joint().verdict(kp=1.0), "give both kp and kd"),
    (lambda: joint().verdict(K=1.0, B=2.0), "give both kp and kd"),
    (lambda: joint().intervals(kp=1.0, kd=2.0), "give one of kp and kd"),
    (lambda: joint().intervals(kd=np.nan), "kd is nan"),
    (
        lambda: jaxstab.Loop.from_coefficients(
            base=[1, -0.5, 0, 0], first=[1, 0.3], second=[2, 0.6], sample_time=1.0
        ).region(),
        "both gains act alike",
    ),
    (
        lambda: jaxstab.Loop.from_coefficients(base=[1], first=[0], second=[1], sample_time=1.0),
        "first is 0",
    ),
    (
        lambda: jaxstab.Loop.from_coefficients(
            base=[1], first=[np.inf], second=[1], sample_time=1.0
        ),
        "first.0. is inf",
    ),
    (
        lambda: jaxstab.Loop.from_coefficients(
            base=[1, 1], first=[1], second=[1], sample_time=1.0, gains=("a", "a")
        ),
        "two different names",
    ),
    (
        lambda: jaxstab.Loop.from_coefficients(
            base=[1, -2, 1], first=[5e-324, 0], second=[1, -1], sample_time=1.0
        ).limits(),
        "another unit",
    ),
    (
        lambda: jaxstab.Loop.from_coefficients(
            base=[1, -2, 1], first=[Fraction(10) ** 400, 0], second=[1, -1], sample_time=1.0
        ).limits(),
        "another unit",
    ),
]


@pytest.mark.parametrize(("call", "words"), REFUSALS)
def test_bad_input_is_refused_in_a_sentence(call: Callable[[], object], words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=words):
        call()
