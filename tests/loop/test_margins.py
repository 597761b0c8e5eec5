"""Limits, margins and ranges of hands, against closed forms and roots in 50 digits."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest
from mpmath import mp, mpf

import jaxstab
from jaxstab import Filter, HandRange, HapticLoop, Velocity, Verdict
from jaxstab.boxes.search import checked_range
from jaxstab.model import by_name
from tests.truth import filtered
from tests.truth import loop as truth

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
    found = FREE.limits()
    assert found.stiffness == pytest.approx(12.0 - 8.0 * np.sqrt(2.0), rel=1e-12)
    assert found.at_damping == pytest.approx(2.0 * np.sqrt(2.0) - 2.0, rel=1e-6)
    assert found.damping == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize(("delay", "stiffness"), [(1.0, 0.14447), (2.0, 0.06243), (3.0, 0.03478)])
def test_the_largest_stiffness_with_whole_delays_is_the_known_one(
    delay: float, stiffness: float
) -> None:
    loop = HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=1.0, delay=delay)
    assert loop.limits().stiffness == pytest.approx(stiffness, abs=5e-6)


def test_limits_on_lines_are_those_of_the_closed_form() -> None:
    dampings = np.array([0.1, 0.5, 1.9])
    limits = FREE.stiffness_limits(dampings)
    np.testing.assert_allclose(limits[:, 0], 0.0, atol=1e-15)
    np.testing.assert_allclose(limits[:, 1], most_stiffness(dampings), rtol=1e-12)
    assert np.isnan(FREE.stiffness_limits(2.5)).all()
    np.testing.assert_allclose(
        most_stiffness(FREE.damping_limits(np.array([0.3, 0.6]))), [[0.3, 0.3], [0.6, 0.6]]
    )


def test_margins_reach_to_the_closed_form() -> None:
    found = FREE.margins(0.2, 0.8)
    assert found.verdict == Verdict.STABLE
    assert found.stiffness[0] == pytest.approx(0.0, abs=1e-8)
    assert found.stiffness[1] == pytest.approx(most_stiffness(0.8), rel=1e-8)
    assert found.stiffness_gain == pytest.approx(most_stiffness(0.8) / 0.2, rel=1e-8)
    np.testing.assert_allclose(most_stiffness(np.array(found.damping)), 0.2, rtol=1e-7)
    assert found.damping_gain == pytest.approx(found.damping[1] / 0.8)


def test_margins_never_promise_more_than_there_is() -> None:
    found = FREE.margins(0.2, 0.8)
    assert found.stiffness[1] <= most_stiffness(0.8)
    assert found.damping[1] <= max(np.roots([2.0, 0.2 - 4.0, 0.4]))


@pytest.mark.parametrize("wall", [(300.0, 2.0), (3000.0, 20.0)])
def test_the_delay_may_grow_to_the_first_crossing_of_a_root_fractions_included(
    wall: tuple[float, float],
) -> None:
    found = PHANTOM.margins(*wall)
    least = PHANTOM.delay_samples + float(found.extra_delay) / PHANTOM.sample_time
    assert true_radius(PHANTOM, *wall, least * (1.0 - 1e-7)) < 1.0
    assert true_radius(PHANTOM, *wall, least * (1.0 + 1e-7)) > 1.0
    for delay in np.linspace(PHANTOM.delay_samples, least, 24, endpoint=False):
        assert true_radius(PHANTOM, *wall, float(delay)) < 1.0


def test_a_loop_that_no_delay_upsets_has_all_of_it_to_spare() -> None:
    assert PHANTOM.margins(0.0, 0.0).verdict == Verdict.UNSTABLE  # a root at 1: it may drift
    held = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, hand_stiffness=500.0)
    assert held.margins(1.0, 0.1).extra_delay == np.inf
    stiff = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, hand_stiffness=987e3)
    assert stiff.margins(2000.0, 0.2).extra_delay == np.inf
    for delay in np.random.default_rng(3).uniform(0.0, 60.0, 12):
        assert true_radius(stiff, 2000.0, 0.2, float(delay)) < 1.0


def test_a_long_delay_may_grow_by_more_than_a_hundred_samples_to_its_crossing() -> None:
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=0.1005)
    extra = float(loop.margins(10.0, 0.5).extra_delay)
    least = (loop.delay + extra) / loop.sample_time
    assert least > 200.0
    for delay, side in ((least - 1e-5, 1), (least + 1e-5, -1)):
        coefficients = truth.polynomial(loop.alpha(10.0), loop.beta(0.5), 0.0, loop.delta, delay)
        radius = abs(np.roots([float(c) for c in coefficients])).max()
        assert side * (1.0 - radius) > 0.0


def test_an_unstable_wall_has_no_margins() -> None:
    found = FREE.margins(np.array([0.9, -0.1]), 0.8)
    assert (found.verdict == Verdict.UNSTABLE).all()
    assert all(np.isnan(field).all() for field in found[1:7])


@pytest.mark.parametrize(("wall", "most"), [((-100.0, 10.0), 5.0), ((100.0, -0.5), 2.91)])
def test_a_negative_gain_may_be_multiplied_up_to_the_end_below_it(
    wall: tuple[float, float], most: float
) -> None:
    """K ends at -k of the hand; B at about -b - 0.045, by verdicts on both sides."""
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, hand_stiffness=500.0, sample_time=1e-3)
    margins, axis = loop.margins(*wall), int(wall[1] < 0.0)
    factor = float((margins.damping_gain, margins.stiffness_gain)[1 - axis])
    assert factor == pytest.approx(most, rel=1e-3)
    for share, code in ((1.0 - 1e-9, Verdict.STABLE), (1.0 + 1e-9, Verdict.UNSTABLE)):
        moved = list(wall)
        moved[axis] *= factor * share
        lower, upper = truth.spectral_radius(
            loop.alpha(moved[0]), loop.beta(moved[1]), loop.gamma, loop.delta, loop.delay_samples
        )
        assert upper < 1.0 if code == Verdict.STABLE else lower > 1.0
        assert loop.verdict(*moved) == code


@pytest.mark.parametrize("wall", [(300.0, 2.0), (50.0, 6.0)])
def test_both_gains_of_a_wall_may_grow_by_the_gain_margin(wall: tuple[float, float]) -> None:
    """Just below the factor all roots are inside the circle, just above one is outside."""
    least, most = PHANTOM.margins(*wall).both_factors.tolist()
    assert least == 0.0
    assert most == pytest.approx(PHANTOM.frequency_margins(*wall).largest_gain.value, rel=1e-9)
    for share, is_inside in ((1.0 - 1e-6, True), (1.0 + 1e-6, False)):
        stiffness, damping = (share * most * gain for gain in wall)
        assert (true_radius(PHANTOM, stiffness, damping, PHANTOM.delay_samples) < 1.0) is is_inside


def test_a_gain_of_zero_may_be_multiplied_by_anything() -> None:
    found = PHANTOM.margins(300.0, 0.0)
    assert found.verdict == Verdict.STABLE
    assert found.damping_gain == np.inf


LOOPS = {  # alpha, beta, gamma, delta, delay
    "haptic": (0.003, 0.02, 0.0, 0.015, 1.5),
    "held": (0.02, 0.2, 1e-3, 0.015, 1.5),
    "a stiff hand, a whole delay": (0.1, 0.3, 0.2, 0.1, 1.0),
    "a pole at -1 comes first": (0.05, 1.0, 0.5, 0.3, 0.25),
}
AXES_OF_STEPS = (0, 0, 1, 1, 4)


def steps(*point: Any, **filters: Any) -> list[Any]:
    """The five ways from a wall to instability: in alpha and beta down and up, in delay."""
    found = jaxstab.margins(**by_name(*point), **filters)
    alphas, betas = found.stiffness - point[0], found.damping - point[1]
    return [alphas[0], alphas[1], betas[0], betas[1], found.extra_delay]


def true_step(point: list[mpf], axis: int, near: float) -> mpf:
    """The step to the crossing that is near, from the 50-digit polynomial: p(e^(i angle)) = 0."""

    def moved(step: mpf) -> list[mpf]:
        return [value + step * (place == axis) for place, value in enumerate(point)]

    root = truth.roots(*moved(mpf(near)))[0]
    assert abs(abs(root) - 1) < 1e-7

    def at(step: mpf, angle: mpf) -> Any:
        return truth.evaluate(truth.polynomial(*moved(step)), mp.exp(mp.mpc(0, angle)))

    if root.imag == 0:
        end = mp.pi * (root.real < 0)
        return mp.findroot(lambda step: at(step, end).real, mpf(near), tol=1e-80)

    def both(step: mpf, angle: mpf) -> list[mpf]:
        value = at(step, angle)
        return [value.real, value.imag]

    return mp.findroot(both, (near, mp.arg(root)), tol=1e-80)[0]


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["a pole at -1 comes first", "haptic", *list(LOOPS)[1:3]])
def test_margins_move_with_the_loop_as_50_digit_differences_say(
    name: str, rng: np.random.Generator
) -> None:
    way = rng.uniform(-1.0, 1.0, 5)
    found, slopes = jax.jvp(lambda *loop: steps(*loop), LOOPS[name], tuple(way))
    size = mpf(10) ** -12
    for axis, step, slope in zip(AXES_OF_STEPS, map(float, found), slopes, strict=True):
        ahead, here, behind = (
            true_step([mpf(x) for x in LOOPS[name] + sign * size * way], axis, step)
            for sign in (1, 0, -1)
        )
        assert abs(step) <= abs(here) * (1 + 1e-15)
        assert abs(step - here) <= 1e-8 * max(1, abs(here))
        assert float(slope) == pytest.approx(float((ahead - behind) / (2 * size)), rel=1e-8)


def delay_and_gains(wall: Any) -> list[Any]:
    found = PHANTOM.margins(wall, 2.0)
    return [found.extra_delay, found.damping[1], found.stiffness_gain]


def test_margins_of_walls_together_are_those_one_by_one() -> None:
    walls = np.array([300.0, 500.0])
    alone = [PHANTOM.margins(wall, 2.0) for wall in walls]
    extra = PHANTOM.margins(walls, 2.0).extra_delay
    together = [float(one.extra_delay) for one in alone]
    np.testing.assert_allclose(extra, together, rtol=1e-13)


@pytest.mark.campaign
def test_margins_map_and_are_differentiated_as_one_by_one() -> None:
    walls = np.array([300.0, 500.0])
    forwards = np.asarray(jax.vmap(jax.jacfwd(delay_and_gains))(walls))
    gain = float(PHANTOM.margins(walls[0], 2.0).stiffness_gain)
    np.testing.assert_allclose(forwards[2, 0], -gain / walls[0], rtol=1e-12)


@pytest.mark.campaign
def test_margins_have_the_same_derivatives_backwards() -> None:
    forwards, backwards = (way(delay_and_gains)(500.0) for way in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forwards, backwards, rtol=1e-12)


@pytest.mark.campaign
def test_the_derivative_of_no_margin_is_no_number() -> None:
    held = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, hand_stiffness=500.0)
    for loop, wall in ((held, 1.0), (FREE, 0.9)):
        extra = jax.grad(lambda wall, loop=loop: loop.margins(wall, 0.1).extra_delay)
        assert np.isnan(extra(wall))


def test_margins_go_through_jit_and_do_not_need_jax() -> None:
    alone = PHANTOM.margins(300.0, 2.0)
    assert all(isinstance(part, np.ndarray | np.number | Verdict) for part in alone[:7])
    compiled = jax.jit(lambda wall: PHANTOM.margins(wall, 2.0))(300.0)
    for one, other in zip(alone[:5], compiled, strict=False):
        assert isinstance(other, jax.Array)
        np.testing.assert_allclose(one, other, rtol=1e-15)


def test_the_distance_is_the_way_to_the_nearest_point_of_the_closed_form() -> None:
    beta = np.linspace(1e-6, 2.0, 200_001)
    for alpha, own in ((0.3, 0.8), (0.2, 0.3), (0.001, 0.8)):
        edge = np.hypot(most_stiffness(beta) - alpha, beta - own).min()
        distance = float(FREE.boundary_distance(alpha, own))
        assert distance == pytest.approx(min(edge, alpha), rel=1e-7)
    assert FREE.boundary_distance(0.9, 0.8) < 0.0


def slopes_by_jax(walls: np.ndarray) -> np.ndarray:
    slope = jax.grad(lambda wall: FREE.boundary_distance(*wall))
    return np.asarray(jax.jit(jax.vmap(slope))(walls))


def slopes_by_differences(walls: np.ndarray) -> np.ndarray:
    steps = 1e-5 * np.eye(2)
    ahead, behind = (FREE.boundary_distance(*(walls[:, None] + s * steps).T) for s in (1, -1))
    return np.asarray((ahead - behind) / 2e-5).T


@pytest.mark.parametrize(
    ("slopes_at", "error"),
    [
        (slopes_by_differences, 1e-8),
        pytest.param(slopes_by_jax, 1e-14, marks=pytest.mark.campaign),  # XLA compiles for long
    ],
)
def test_the_distance_shrinks_towards_the_nearest_point(
    slopes_at: Callable[[np.ndarray], np.ndarray], error: float
) -> None:
    walls = np.array([[0.6, 0.8], [0.2, 0.3], [0.001, 0.8]])
    slopes = slopes_at(walls)
    np.testing.assert_allclose(np.hypot(*slopes.T), 1.0, rtol=error)
    distance = FREE.boundary_distance(*walls.T)
    alpha, beta = (walls - np.asarray(distance)[:, None] * slopes).T
    np.testing.assert_allclose((alpha - most_stiffness(beta))[:2], 0.0, atol=max(error, 1e-9))
    np.testing.assert_allclose(alpha[2], 0.0, atol=0.1 * error)


def test_a_wall_is_proved_for_every_hand_of_a_range() -> None:
    hands = HandRange(mass=(0.0, 0.3), stiffness=(0.0, 200.0), damping=(1.0, 1.0))
    assert PHANTOM.worst_hand(hands, 300.0, 2.0).verdict == Verdict.STABLE
    unstable = PHANTOM.worst_hand(hands, 20000.0, 34.0)
    assert unstable.verdict == Verdict.UNSTABLE
    radius = true_radius(unstable.loop, 20000.0, 34.0, PHANTOM.delay_samples)
    assert radius == pytest.approx(unstable.radius, rel=1e-12)
    assert radius > 1.0


@pytest.mark.campaign
def test_the_stiffest_wall_for_all_hands_is_proved_and_lies_beyond_the_passive_limit() -> None:
    # Sec. VIII: the device collides with anything from nothing to Nyquist frequency.
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    found = loop.robust_limit(HandRange(stiffness=(0.0, 987e3)))
    assert found.is_proved
    assert found.stiffness > 2.0 * loop.device_damping / loop.sample_time
    rng = np.random.default_rng(8)
    for stiffness in rng.uniform(0.0, 987e3, 20):
        held = HapticLoop(
            device_mass=0.1, device_damping=1.5, sample_time=1e-3, hand_stiffness=stiffness
        )
        assert true_radius(held, found.stiffness, found.damping, 0.0) < 1.0


@pytest.mark.campaign
def test_the_limit_for_all_hands_is_not_below_a_wall_proved_for_all_of_them() -> None:
    loop = HapticLoop(
        device_mass=1.0, device_damping=0.5432825400259356, sample_time=1.0, delay=0.5
    )
    hands = HandRange(
        mass=(0.0, 2.683572731924306),
        stiffness=(0.0, 11.00056392632787),
        damping=(0.0, 0.5129250179766981),
    )
    wall = (0.6579517982867333, 0.17279470191737856)  # some hands have islands, and two peaks
    assert loop.worst_hand(hands, *wall).verdict == Verdict.STABLE
    found = loop.robust_limit(hands)
    assert found.is_proved
    assert wall[0] <= found.limit <= 0.7
    assert 0.6 < found.stiffness < found.limit
    assert loop.worst_hand(hands, found.stiffness, found.damping).verdict == Verdict.STABLE


@pytest.mark.parametrize(
    ("loop", "spring", "wall"),
    [
        (
            HapticLoop(
                device_mass=0.030364035290746688,
                device_damping=3.0514857921904532,
                sample_time=0.00017712578997005138,
                delay=0.00017712578997005138,
            ),
            0.0,
            (148641.76670992252, 71.7777221714964),
        ),
        (
            HapticLoop(
                device_mass=1.8561733167747139,
                device_damping=0.26895573616378077,
                sample_time=0.002489147942872546,
            ),
            15.69017551691799,
            (205584.00813838898, 617.5286882969465),
        ),
    ],
    ids=["one hand", "a range of springs"],
)
def test_the_limit_is_not_below_a_wall_near_the_top_of_all_stable_sets(
    loop: HapticLoop, spring: float, wall: tuple[float, float]
) -> None:
    """Where a strip of roots reaches beyond the stable sets, nothing is known above it."""
    for stiffness in (0.0, spring):
        held = replace(loop, hand_stiffness=stiffness)
        assert true_radius(held, *wall, loop.delay_samples) < 1.0
    found = loop.robust_limit(HandRange(stiffness=(0.0, spring)))
    assert wall[0] <= found.limit <= 1.001 * wall[0]


def test_what_is_no_range_of_hands_is_refused() -> None:
    with pytest.raises(TypeError, match=r"hands is 1.0; give a jaxstab.HandRange"):
        checked_range(1.0)
    for ends in (1.0, (0.0,), (0.0, 1.0, 2.0)):
        hands: Any = HandRange.__new__(HandRange)  # past the annotations, which users have not
        vars(hands).update(mass=ends, stiffness=(0.0, 0.0), damping=(0.0, 0.0))
        with pytest.raises(TypeError, match=r"hands.mass is .*; give its lowest and its highest"):
            checked_range(hands)


def test_a_short_way_is_bracketed_as_tightly_as_rounding_allows() -> None:
    loop = (2223.0694688099143, -18916.483602106142, 157.9368063545867, 0.012970797092212027, 5.0)
    point = [mpf(value) for value in loop]
    found = steps(*loop)
    for axis, step in zip(AXES_OF_STEPS[:4], map(float, found[:4]), strict=True):
        here = true_step(point, axis, step)
        assert abs(step) <= abs(here)
        assert abs(step - here) <= 0.01 * abs(here)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: FREE.margins(np.nan, 1.0), "stiffness is nan"),
        (lambda: FREE.stiffness_limits(np.inf), "damping is inf"),
        (
            lambda: FREE.worst_hand(HandRange(mass=(2.0, 1.0)), 1.0, 1.0),
            r"hands.mass is \(2.0, 1.0\)",
        ),
    ],
)
def test_bad_input_is_refused_by_name(call: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()


def test_a_delay_that_only_comes_near_the_circle_is_told_from_one_that_meets_it() -> None:
    """Critical angles look possible here until they are paved finely."""
    found = jaxstab.margins(
        1.7227216180065996,
        -0.877380055459924,
        gamma=9.809468907757546,
        delta=0.008939127392511253,
        delay=3.196294952593754,
    )
    assert found.verdict == Verdict.STABLE
    assert found.extra_delay == np.inf


@pytest.mark.parametrize(
    "wall",
    [
        (-3.6599263379287876, 1.8194673457277168, 3.7019235432174624, 1.4440244882234141, 3.0),
        (9.707536145731787, -4.91944322742736, 9.840570312421415, 0.0037304467172956696, 0.0),
        (369.7211138622218, -7.56240229292237, 159.28013528001637, 0.729674728754703, 2.0),
    ],
)
def test_the_delay_of_walls_with_critical_angles_down_to_zero_may_grow(
    wall: tuple[float, ...],
) -> None:
    """A first stretch of 1024 samples had too many boxes, and none of the delay was proved."""
    extra = float(jaxstab.margins(**by_name(*wall)).extra_delay)
    assert extra > 0.01
    assert truth.unstable_count(*wall[:4], wall[4] + extra * (1.0 - 1e-6)) == 0
    assert truth.unstable_count(*wall[:4], wall[4] + extra * (1.0 + 1e-6)) != 0


FILTERED = {  # alpha, beta, gamma, delta, delay; the filters here and, exactly, those of the truth
    "a window of 20": (
        (0.003, 0.04, 0.0, 0.001, 1.0),
        (Velocity.difference(samples=20), None),
        (filtered.difference(20), filtered.average(1)),
    ),
    "an island": (
        (0.0678, -0.316, 0.0, 0.0, 0.0),
        (Velocity.difference(samples=20), None),
        (filtered.difference(20), filtered.average(1)),
    ),
    "low passes, a fraction": (
        (0.02, 0.1, 0.01, 0.02, 1.3),
        (Velocity.difference(samples=6) * Filter.low_pass(0.2), Filter.exponential(0.6)),
        (
            filtered.times(filtered.difference(6), filtered.low_pass(0.2, order=1)),
            filtered.exponential(0.6),
        ),
    ),
    "Butterworth, poles next to -1": (
        (0.002, 0.02, 0.0, 0.1, 2.0),
        (Velocity.butterworth(0.1, order=5), Filter.butterworth(0.45, order=4)),
        (
            filtered.times(filtered.difference(1), filtered.butterworth(0.1, order=5)),
            filtered.butterworth(0.45, order=4),
        ),
    ),
}


@pytest.mark.parametrize("name", FILTERED)
def test_margins_with_filters_end_where_a_certified_root_crosses(name: str) -> None:
    wall, (velocity, position), (true_velocity, true_position) = FILTERED[name]

    def true_code(axis: int, changed: float) -> int:
        alpha, beta, gamma, delta, delay = (
            changed if number == axis else value for number, value in enumerate(wall)
        )
        loop = filtered.FilteredLoop(gamma, delta, delay, true_velocity, true_position)
        return loop.code(alpha, beta)

    found = jaxstab.margins(**by_name(*wall), velocity=velocity, position=position)
    ends = *found.stiffness, *found.damping, wall[-1] + found.extra_delay
    for axis, end in zip(AXES_OF_STEPS, map(float, ends), strict=True):
        assert true_code(axis, end - 1e-13 * (end - wall[axis])) == Verdict.STABLE
        assert true_code(axis, end + 2e-9 * (end - wall[axis])) == Verdict.UNSTABLE


@pytest.mark.campaign
def test_margins_with_filters_are_differentiable_and_refuse_traced_filters() -> None:
    wall, (velocity, position), _ = FILTERED["low passes, a fraction"]
    size = 1e-5
    way = np.array([0.3, -0.2, 0.5, 0.4, -0.6])
    chosen = {"velocity": velocity, "position": position}
    found, slopes = jax.jvp(lambda *loop: steps(*loop, **chosen), wall, tuple(way))
    ahead, behind = (np.array(steps(*(wall + sign * size * way), **chosen)) for sign in (1, -1))
    np.testing.assert_allclose(found, steps(*wall, **chosen), rtol=1e-12)
    np.testing.assert_allclose(slopes, (ahead - behind) / (2.0 * size), rtol=2e-5)
    with pytest.raises(TypeError, match="JAX traces; give numbers"):
        jax.grad(lambda f: steps(*wall, velocity=Velocity.low_pass(f))[1])(0.1)


def test_a_window_of_one_sample_has_the_margins_of_the_paper() -> None:
    wall = LOOPS["held"]
    plain = steps(*wall)
    assert steps(*wall, velocity=Velocity.difference(samples=1)) == plain
    like = steps(*wall, velocity=Velocity.exponential(1.0), position=Filter.average(samples=1))
    np.testing.assert_allclose(like, plain, rtol=1e-9)
