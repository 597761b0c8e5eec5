"""Guards of random scenes: nearly all are built, grant what is proved, and nothing unstable."""

import re
from typing import NamedTuple

import numpy as np
import pytest
from campaign import many

import jaxstab
from jaxstab import HandRange, HapticLoop, Velocity, Verdict, build_guard
from jaxstab.lab.guard.build import CONSTANT_CELLS, plan_guard
from jaxstab.results import Guard
from tests.truth import filtered
from tests.truth.filtered import FilteredLoop, Rational

Range = tuple[float, float]
SCENES = many(100, small=2)
NAMES = "mass", "stiffness", "damping"


class Scene(NamedTuple):
    """A loop, its ranges, and its estimator as a quotient of polynomials."""

    loop: HapticLoop
    hands: HandRange
    mass: Range
    delay: Range
    velocity: Rational


WHEEL = Scene(
    HapticLoop(
        device_mass=0.02,
        device_damping=0.02,
        sample_time=1e-3,
        delay=2e-3,
        velocity=Velocity.difference(samples=5),
    ),
    HandRange(mass=(0.0, 0.05), stiffness=(0.0, 20.0), damping=(0.0, 0.8)),
    (0.016, 0.025),
    (1e-3, 3e-3),
    filtered.difference(5),
)


def slope(smoothed: Rational) -> Rational:
    return filtered.times(filtered.difference(1), smoothed)


def drawn(seed: int) -> Scene:
    """A device of one mass, often without damping, for all hands from none on."""
    rng = np.random.default_rng(seed)
    period, mass = float(rng.choice([2.5e-4, 1e-3, 1e-3, 2e-3])), 10 ** rng.uniform(-2.0, 0.5)
    damping = float(rng.choice([0.0, 2.0 * mass * 10 ** rng.uniform(-2.0, 0.5)]))
    exponents = rng.uniform([-1.0, 1.0, 0.0], [0.7, 3.5, 1.8])
    ends = (float(mass * 10**exponent) for exponent in exponents)
    hands = HandRange(**{name: (0.0, end) for name, end in zip(NAMES, ends, strict=True)})
    delay, samples = rng.uniform(0.0, 3.0) * period, int(rng.integers(1, 20))
    cutoff = 10 ** rng.uniform(1.3, 2.2)
    velocity, truth = [
        (Velocity.difference(samples=samples), filtered.difference(samples)),
        (Velocity.low_pass(cutoff), slope(filtered.low_pass(cutoff * period, 1))),
        (Velocity.butterworth(cutoff, order=2), slope(filtered.butterworth(cutoff * period, 2))),
    ][rng.integers(3)]
    loop = HapticLoop(
        device_mass=mass,
        device_damping=damping,
        sample_time=period,
        delay=delay,
        velocity=velocity,
    )
    spread, lag = rng.uniform(1.02, 1.3), rng.uniform(0.1, 1.0) * period
    delays = max(delay - lag, 0.0), delay + lag
    return Scene(loop, hands, (mass / spread, mass * spread), delays, truth)


def guard_of(scene: Scene) -> Guard:
    return build_guard(
        scene.loop, scene.hands, mass=scene.mass, delay=scene.delay, constant_delay=True
    )


def share_of_proved(scene: Scene, guard: Guard) -> float:
    """The stiffest granted wall over the one proved for all hands, at the loop's own numbers."""
    damping = np.linspace(0.0, float(guard.grid.top.max()), 2_000)
    place = {"mass": scene.loop.device_mass, "delay": scene.loop.delay}
    limit = scene.loop.robust_limit(scene.hands)
    assert limit.is_proved
    return float(guard.largest_stiffness(damping, **place).max()) / limit.stiffness


def loops_at_limits(
    scene: Scene, guard: Guard, places: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Numbers of loops of granted walls at the limit, and which of these have a stiffness.

    Places are shares of the ranges of mass, delay, damping and the hand, shape (6, place).
    """
    ranges = np.array([scene.mass, scene.delay, *vars(scene.hands).values()])[:, :, None]
    shares = places[[0, 1, 3, 4, 5]]
    mass, delay, hand, spring, damper = ranges[:, 0] * (1.0 - shares) + ranges[:, 1] * shares
    mass, delay = np.clip(mass, *scene.mass), np.clip(delay, *scene.delay)
    damping = places[2] * guard.grid.top.max()
    stiffness = guard.largest_stiffness(damping, mass=mass, delay=delay)
    period, moved = scene.loop.sample_time, mass + hand
    numbers = {
        "alpha": stiffness * period**2 / moved,
        "beta": damping * period / moved,
        "gamma": spring * period**2 / moved,
        "delta": (scene.loop.device_damping + damper) * period / moved,
        "delay": delay / period,
    }
    return numbers, stiffness > 0.0


def climbed(scene: Scene, guard: Guard, rng: np.random.Generator, count: int) -> np.ndarray:
    """Places whose granted walls have large spectral radii, by steps at random."""
    shape = 6, count
    places = np.where(rng.random(shape) < 0.4, rng.integers(0, 2, shape), rng.random(shape))
    best = np.full(count, -np.inf)
    kept = places
    for turn in range(12):
        numbers, granted = loops_at_limits(scene, guard, places)
        radius = jaxstab.spectral_radius(**numbers, **scene.loop.filters).value
        radius = np.where(granted, radius, 0.0)
        kept, best = np.where(radius > best, places, kept), np.maximum(radius, best)
        places = np.clip(kept + rng.normal(0.0, 0.3 * 0.7**turn, kept.shape), 0.0, 1.0)
    return kept


def assert_nothing_unstable(scene: Scene, guard: Guard, seed: int, count: int) -> None:
    """Granted walls at their limits: certified verdicts, and roots in balls of the worst ones."""
    rng = np.random.default_rng(seed)
    places = climbed(scene, guard, rng, count)
    numbers, granted = loops_at_limits(scene, guard, places)
    assert granted.any()
    codes = np.asarray(jaxstab.verdict(**numbers, **scene.loop.filters))[granted]
    assert np.all(codes == Verdict.STABLE)
    radius = np.asarray(jaxstab.spectral_radius(**numbers, **scene.loop.filters).value)
    for worst in np.argsort(np.where(granted, radius, 0.0))[-3:]:
        alpha, beta, gamma, delta, delay = (float(part[worst]) for part in numbers.values())
        truth = FilteredLoop(gamma, delta, delay, scene.velocity, filtered.average(1))
        assert truth.code(alpha, beta) == Verdict.STABLE


@pytest.mark.campaign
def test_a_steering_wheel_has_a_guard() -> None:
    guard = guard_of(WHEEL)
    assert np.all(guard.rows == [0, 16])  # all of the table
    assert 0.9 < guard.granted < 1.0
    assert 0.9 < share_of_proved(WHEEL, guard) < 1.02
    assert_nothing_unstable(WHEEL, guard, 1, 400)
    least = guard.costliest
    assert (least.mass, least.delay) == (0.016, 3e-3)
    assert 0.9 * least.exact < least.granted < least.exact


def test_what_nothing_damps_has_a_guard() -> None:
    """Without damping the hand's spring is on the circle where the wall has no gains."""
    loop = HapticLoop(device_mass=0.25, device_damping=0.0, sample_time=1e-3, delay=1e-3)
    hands = HandRange(stiffness=(0.0, 300.0))
    scene = Scene(loop, hands, (0.24, 0.26), (0.9e-3, 1.1e-3), filtered.difference(1))
    guard = build_guard(
        loop, hands, mass=scene.mass, delay=scene.delay, cells=(1, 1, 16), constant_delay=True
    )
    assert np.all(guard.rows == [0, 16])
    assert_nothing_unstable(scene, guard, 2, 400)
    weak = guard.largest_stiffness(1e-3, mass=0.25, delay=1e-3)
    assert weak > 0.0


def planned(loop: HapticLoop, *cells: tuple[int, int, int]) -> list[int]:
    """The cells of a plan, and the seconds that it takes, usually and at most."""
    return list(map(int, re.findall(r"(\d+) (?:cells|s) ", plan_guard(loop, *cells))))


def test_the_plan_of_a_guard_is_within_its_time() -> None:
    assert planned(WHEEL.loop)[0] == 4 * 16  # of a delay that moves
    cells, usual, most = planned(WHEEL.loop, CONSTANT_CELLS)
    assert cells == 4 * 8 * 16
    assert usual <= most <= 30
    arm = jaxstab.Hand.mass_spring_damper(0.1, damping=1.0).with_grip(stiffness=2000.0, damping=4.0)
    device = jaxstab.Device.mass_spring_damper(0.25, damping=0.5).held_by(arm)
    assert planned(HapticLoop(device=device, sample_time=1e-3))[2] <= 60


@pytest.mark.campaign
def test_guards_of_random_scenes() -> None:
    """At least 95 of 100 are built; each grants nine tenths of what is proved for all hands."""
    shares: dict[int, float] = {}
    for seed in range(SCENES):
        scene = drawn(seed)
        try:
            guard = guard_of(scene)
        except RuntimeError:
            continue
        shares[seed] = share_of_proved(scene, guard)
        assert_nothing_unstable(scene, guard, seed, 400)
    assert len(shares) >= 0.95 * SCENES
    assert {seed: share for seed, share in shares.items() if share < 0.9} == {}
