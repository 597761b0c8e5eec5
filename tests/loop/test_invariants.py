"""What holds for every loop: scaling, symmetry, and verdicts that no way of asking changes."""

from importlib import import_module
from pkgutil import walk_packages
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxstab
from jaxstab import HapticLoop, Verdict
from jaxstab.conventions import Status
from jaxstab.model import by_name

DELAYS = (0.0, 0.5, 2.0)  # few, for each is compiled
WALLS = 64  # at once: one size, compiled once
few = settings(max_examples=15)

plants = st.tuples(
    st.one_of(st.just(0.0), st.floats(-8, 1.3).map(lambda power: 10.0**power)),
    st.one_of(st.just(0.0), st.floats(-8, 0.3).map(lambda power: 10.0**power)),
    st.sampled_from(DELAYS),
)
seeds = st.integers(0, 2**32 - 1)


def walls(seed: int, delay: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.3, 1.2, WALLS) / (1 + delay) ** 2, rng.uniform(-0.3, 2, WALLS) / (
        1 + delay
    )


def codes_of(*point: Any, **options: Any) -> np.ndarray:
    return np.asarray(jaxstab.verdict(**by_name(*point), **options))


@few
@given(plants, seeds)
def test_resolving_or_refining_never_flips_a_verdict(
    plant: tuple[float, float, float], seed: int
) -> None:
    alpha, beta = walls(seed, plant[2])
    quick, exact = codes_of(alpha, beta, *plant), codes_of(alpha, beta, *plant, resolve="exact")
    decided = quick != Verdict.UNDECIDED
    np.testing.assert_array_equal(exact[decided], quick[decided])


@few
@given(plants, seeds)
def test_the_two_ways_to_a_radius_agree_within_their_bounds_and_with_the_verdict(
    plant: tuple[float, float, float], seed: int
) -> None:
    alpha, beta = walls(seed, plant[2])
    fast = jaxstab.spectral_radius(alpha, beta, **by_name(*plant))
    companion = jaxstab.spectral_radius(alpha, beta, **by_name(*plant), method="companion")
    both = np.asarray(fast.error) + np.asarray(companion.error)
    assert np.all(np.abs(np.asarray(fast.value) - np.asarray(companion.value)) <= both)
    codes = codes_of(alpha, beta, *plant)
    low, high = np.asarray(fast.value - fast.error), np.asarray(fast.value + fast.error)
    assert not np.any((codes == Verdict.STABLE) & (low >= 1.0))
    assert not np.any((codes == Verdict.UNSTABLE) & (high < 1.0))


@few
@given(plants, seeds, st.integers(1, WALLS - 1))
def test_an_answer_does_not_depend_on_the_shape_of_the_question(
    plant: tuple[float, float, float], seed: int, cut: int
) -> None:
    alpha, beta = walls(seed, plant[2])
    whole = jaxstab.spectral_radius(alpha, beta, **by_name(*plant))
    codes = codes_of(alpha, beta, *plant)
    order = np.roll(np.arange(WALLS), cut)
    for form in (order, order.reshape(8, -1)):
        turned = jaxstab.spectral_radius(alpha[form], beta[form], **by_name(*plant))
        np.testing.assert_array_equal(turned.value, np.asarray(whole.value)[form])
        np.testing.assert_array_equal(codes_of(alpha[form], beta[form], *plant), codes[form])
    pieces = jaxstab.evaluate_grid(
        jaxstab.verdict, alpha, beta, **by_name(*plant), chunk=WALLS // 2
    )
    for place, part in pieces:
        np.testing.assert_array_equal(part, codes[place])


@few
@given(
    st.floats(0.05, 2.0), st.floats(0.0, 5.0), st.floats(0.0, 500.0),
    st.sampled_from([2.0**-3, 4.0, 1000.0]), st.sampled_from([0.5, 8.0]), seeds,
)  # fmt: skip
def test_a_loop_in_other_units_is_the_same_loop(
    mass: float, damping: float, spring: float, of_mass: float, of_time: float, seed: int
) -> None:
    """Table I: masses times m, times times t; then K times m/t^2 and B times m/t."""
    own = HapticLoop(
        device_mass=mass, device_damping=damping, hand_stiffness=spring, sample_time=1e-3
    )
    other = HapticLoop(
        device_mass=mass * of_mass,
        device_damping=damping * of_mass / of_time,
        hand_stiffness=spring * of_mass / of_time**2,
        sample_time=1e-3 * of_time,
    )
    alpha, beta = walls(seed, 0.0)
    radii = [
        jaxstab.spectral_radius(
            loop.alpha(own.stiffness(alpha) * by_stiffness),
            loop.beta(own.damping(beta) * by_damping),
            gamma=loop.gamma,
            delta=loop.delta,
            delay=0.0,
        )
        for loop, by_stiffness, by_damping in (
            (own, 1.0, 1.0),
            (other, of_mass / of_time**2, of_mass / of_time),
        )
    ]
    np.testing.assert_allclose(radii[0].value, radii[1].value, rtol=1e-6)


@few
@given(plants, seeds)
def test_a_verdict_is_constant_along_a_segment_that_the_boundary_does_not_cross(
    plant: tuple[float, float, float], seed: int
) -> None:
    """From a wall on, no root reaches the circle nearer than the nearest of curve and lines."""
    gamma, _, delay = plant
    alpha, beta = walls(seed, delay)
    codes = codes_of(alpha, beta, *plant)
    theta = np.linspace(1e-4, np.pi - 1e-4, 4001)
    curve = np.stack(jaxstab.boundary_curve(theta, **by_name(*plant)))
    gaps = np.hypot(*np.diff(curve))
    gap = np.maximum(np.append(gaps, 0.0), np.append(0.0, gaps))  # to the neighbours
    point = np.stack([alpha, beta])
    to_curve = (np.hypot(*(point[:, :, None] - curve[:, None, :])) - gap).min(axis=1)
    room = np.minimum(to_curve, np.abs(alpha + gamma))
    offset = float(jaxstab.paper.minus_line(0.0, **by_name(*plant)))
    if np.isfinite(offset):
        room = np.minimum(room, np.abs(alpha + 2.0 * beta - offset) / np.sqrt(5.0))
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, WALLS)
    usable = (room > 0.0) & (codes != Verdict.UNDECIDED)
    moved = point + 0.99 * np.maximum(room, 0.0) * np.stack([np.cos(angle), np.sin(angle)])
    there = codes_of(*moved, *plant)
    assert not np.any(usable & (there != codes) & (there != Verdict.UNDECIDED))


@few
@given(st.floats(-6, 0).map(lambda power: 10.0**power), st.integers(0, 3), seeds)
def test_the_region_of_a_free_device_shrinks_with_a_longer_delay(
    damping: float, delay: int, seed: int
) -> None:
    """gamma = 0: a loop of positive gains that is stable with one more sample of delay, is with
    one less (|D| > |N H| past the first crossing alone)."""
    alpha, beta = np.abs(walls(seed, float(delay)))
    shorter = codes_of(alpha, beta, 0.0, damping, float(delay))
    longer = codes_of(alpha, beta, 0.0, damping, float(delay + 1))
    assert not np.any((longer == Verdict.STABLE) & (shorter == Verdict.UNSTABLE))


def kinds_of(code: type[Status]) -> list[type[Status]]:
    below = [kind for one in code.__subclasses__() for kind in kinds_of(one)]
    return [*code.__subclasses__(), *below]


def test_statuses_are_numbered_without_gaps_and_each_has_words_of_its_own() -> None:
    for module in walk_packages(jaxstab.__path__, "jaxstab."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
    kinds = kinds_of(Status)
    assert len(kinds) > 10
    for kind in kinds:
        codes = [int(status) for status in kind]
        assert codes == list(range(min(codes), len(codes) + min(codes)))
        assert min(codes) in (0, 1)
        assert len({status.words for status in kind}) == len(kind)
