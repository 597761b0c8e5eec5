"""Limits, margins and ranges of hands, against closed forms and roots in 50 digits."""

from typing import Any

import numpy as np
import pytest
import truth

import jaxstab
from jaxstab import HandRange, HapticLoop, Verdict

FREE = HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=1.0)  # K = alpha, B = beta
PHANTOM = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=1.5e-3)


def most_stiffness(beta: Any) -> Any:
    """The stable set of the free device without delay, in closed form."""
    return 2.0 * beta * (2.0 - beta) / (beta + 2.0)


def true_radius(loop: HapticLoop, stiffness: float, damping: float, delay: float) -> float:
    """From the 50-digit polynomial of the loop at another delay in samples."""
    point = (loop.alpha(stiffness), loop.beta(damping), loop.gamma, loop.delta, delay)
    return float(abs(truth.root_balls(*point)[0]))


def test_the_largest_stiffness_without_delay_is_the_known_one() -> None:
    found = jaxstab.wall_limits(FREE)
    assert found.stiffness == pytest.approx(12.0 - 8.0 * np.sqrt(2.0), rel=1e-12)
    assert found.at_damping == pytest.approx(2.0 * np.sqrt(2.0) - 2.0, rel=1e-6)
    assert found.damping == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize(("delay", "stiffness"), [(1.0, 0.14447), (2.0, 0.06243), (3.0, 0.03478)])
def test_the_largest_stiffness_with_whole_delays_is_the_known_one(
    delay: float, stiffness: float
) -> None:
    loop = HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=1.0, delay=delay)
    assert jaxstab.wall_limits(loop).stiffness == pytest.approx(stiffness, abs=5e-6)


def test_limits_on_lines_are_those_of_the_closed_form() -> None:
    dampings = np.array([0.1, 0.5, 1.9])
    limits = jaxstab.stiffness_limits(FREE, dampings)
    np.testing.assert_allclose(limits[:, 0], 0.0, atol=1e-15)
    np.testing.assert_allclose(limits[:, 1], most_stiffness(dampings), rtol=1e-12)
    assert np.isnan(jaxstab.stiffness_limits(FREE, 2.5)).all()
    np.testing.assert_allclose(
        most_stiffness(jaxstab.damping_limits(FREE, np.array([0.3, 0.6]))), [[0.3, 0.3], [0.6, 0.6]]
    )


def test_margins_reach_to_the_closed_form() -> None:
    found = jaxstab.margins(FREE, 0.2, 0.8)
    assert found.verdict == Verdict.STABLE
    assert found.stiffness[0] == pytest.approx(0.0, abs=1e-8)
    assert found.stiffness[1] == pytest.approx(most_stiffness(0.8), rel=1e-8)
    assert found.stiffness_gain == pytest.approx(most_stiffness(0.8) / 0.2, rel=1e-8)
    np.testing.assert_allclose(most_stiffness(np.array(found.damping)), 0.2, rtol=1e-7)
    assert found.damping_gain == pytest.approx(found.damping[1] / 0.8)


def test_margins_never_promise_more_than_there_is() -> None:
    found = jaxstab.margins(FREE, 0.2, 0.8)
    assert found.stiffness[1] <= most_stiffness(0.8)
    assert found.damping[1] <= max(np.roots([2.0, 0.2 - 4.0, 0.4]))


@pytest.mark.parametrize("wall", [(300.0, 2.0), (3000.0, 20.0)])
def test_the_delay_may_grow_to_the_first_crossing_of_a_root_fractions_included(
    wall: tuple[float, float],
) -> None:
    found = jaxstab.margins(PHANTOM, *wall)
    least = PHANTOM.delay_samples + found.extra_delay / PHANTOM.sample_time
    assert true_radius(PHANTOM, *wall, least * (1.0 - 1e-7)) < 1.0
    assert true_radius(PHANTOM, *wall, least * (1.0 + 1e-7)) > 1.0
    for delay in np.linspace(PHANTOM.delay_samples, least, 24, endpoint=False):
        assert true_radius(PHANTOM, *wall, float(delay)) < 1.0


def test_a_loop_that_no_delay_upsets_has_all_of_it_to_spare() -> None:
    assert jaxstab.margins(PHANTOM, 0.0, 0.0).verdict == Verdict.UNDECIDED
    held = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, hand_stiffness=500.0)
    assert jaxstab.margins(held, 1.0, 0.1).extra_delay == np.inf
    stiff = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, hand_stiffness=987e3)
    assert jaxstab.margins(stiff, 2000.0, 0.2).extra_delay == np.inf
    for delay in np.random.default_rng(3).uniform(0.0, 60.0, 12):
        assert true_radius(stiff, 2000.0, 0.2, float(delay)) < 1.0


def test_a_long_delay_may_grow_by_more_than_a_hundred_samples_to_its_crossing() -> None:
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=0.1005)
    least = (loop.delay + jaxstab.margins(loop, 10.0, 0.5).extra_delay) / loop.sample_time
    assert least > 200.0
    for delay, side in ((least - 1e-5, 1), (least + 1e-5, -1)):
        coefficients = truth.polynomial(loop.alpha(10.0), loop.beta(0.5), 0.0, loop.delta, delay)
        radius = abs(np.roots([float(c) for c in coefficients])).max()
        assert side * (1.0 - radius) > 0.0


def test_an_unstable_wall_has_no_margins() -> None:
    found = jaxstab.margins(FREE, 0.9, 0.8)
    assert found.verdict == Verdict.UNSTABLE
    assert np.isnan([*found.stiffness, *found.damping, found.extra_delay]).all()


def test_the_distance_is_the_way_to_the_nearest_point_of_the_closed_form() -> None:
    beta = np.linspace(1e-6, 2.0, 200_001)
    for alpha, own in ((0.3, 0.8), (0.2, 0.3), (0.001, 0.8)):
        edge = np.hypot(most_stiffness(beta) - alpha, beta - own).min()
        distance = jaxstab.boundary_distance(FREE, alpha, own)
        assert distance == pytest.approx(min(edge, alpha), rel=1e-7)
    assert jaxstab.boundary_distance(FREE, 0.9, 0.8) < 0.0


def test_a_wall_is_proved_for_every_hand_of_a_range() -> None:
    hands = HandRange(mass=(0.0, 0.3), stiffness=(0.0, 200.0), damping=(1.0, 1.0))
    assert jaxstab.worst_hand(PHANTOM, hands, 300.0, 2.0).verdict == Verdict.STABLE
    unstable = jaxstab.worst_hand(PHANTOM, hands, 20000.0, 34.0)
    assert unstable.verdict == Verdict.UNSTABLE
    radius = true_radius(unstable.loop, 20000.0, 34.0, PHANTOM.delay_samples)
    assert radius == pytest.approx(unstable.radius, rel=1e-12)
    assert radius > 1.0


def test_the_stiffest_wall_for_all_hands_is_proved_and_lies_beyond_the_passive_limit() -> None:
    # Sec. VIII: the device collides with anything from nothing to Nyquist frequency.
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    found = jaxstab.robust_limit(loop, HandRange(stiffness=(0.0, 987e3)))
    assert found.is_proved
    assert found.stiffness > 2.0 * loop.device_damping / loop.sample_time
    rng = np.random.default_rng(8)
    for stiffness in rng.uniform(0.0, 987e3, 20):
        held = HapticLoop(
            device_mass=0.1, device_damping=1.5, sample_time=1e-3, hand_stiffness=stiffness
        )
        assert true_radius(held, found.stiffness, found.damping, 0.0) < 1.0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: jaxstab.margins(FREE, np.nan, 1.0), "stiffness is nan"),
        (lambda: jaxstab.stiffness_limits(FREE, np.inf), "damping is inf"),
        (
            lambda: jaxstab.worst_hand(FREE, HandRange(mass=(2.0, 1.0)), 1.0, 1.0),
            r"hands.mass is \(2.0, 1.0\)",
        ),
    ],
)
def test_bad_input_is_refused_by_name(call: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()
