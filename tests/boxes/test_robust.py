"""Robust regions against certified root counts and against the passive region."""

from dataclasses import replace
from itertools import product
from math import pi

import numpy as np
import pytest
from campaign import first

import jaxstab
from jaxstab.boxes import HandRange, RobustStatus, polygons, robust_region
from jaxstab.boxes.polygons import failures
from jaxstab.boxes.search import unproved_members
from jaxstab.conventions import Verdict
from jaxstab.model import by_name
from jaxstab.paper import passive_region
from jaxstab.point import verdict
from jaxstab.region import stable_region
from tests.truth import filtered
from tests.truth import loop as truth

NYQUIST = pi**2 + 0.25  # for delta = 1

RANGES = {
    "figure 9": ((0.0, NYQUIST), (1.0, 1.0), 0.0),
    "figure 10": ((0.0, NYQUIST), (1.0, 1.0), 1.0),
    "haptic hands": ((0.0, 1e-3), (0.0, 0.015), 1.0),
    "fraction": ((0.0, 1.0), (0.1, 0.4), 0.5),
}


@pytest.fixture(
    scope="module",
    params=first(["figure 9", *[*RANGES][1:]], 1),
)
def robust(request):
    return robust_region(**by_name(*RANGES[request.param]))


def random_hands(region, rng, count):
    return rng.uniform(*region.gamma, count), rng.uniform(*region.delta, count)


def test_walls_of_a_proved_outline_are_stable_for_every_hand(robust, rng):
    assert robust.status == RobustStatus.PROVED
    walls = robust.outline[rng.integers(0, len(robust.outline), 60)]
    middle = robust.outline.mean(axis=0)
    walls = middle + rng.uniform(0, 1, (60, 1)) ** 0.2 * (walls - middle)
    for (alpha, beta), gamma, delta in zip(walls, *random_hands(robust, rng, 60), strict=True):
        assert truth.unstable_count(alpha, beta, gamma, delta, robust.delay) == 0


def test_outline_is_tight(robust):
    middle = robust.outline.mean(axis=0)
    beyond = middle + (robust.outline - middle) * (1 + 3 * robust.tolerance)
    codes = robust.verdict(*beyond[::16].T)
    assert np.mean(codes == Verdict.UNSTABLE) > 0.9
    assert not np.any(codes == Verdict.STABLE)
    inside = robust.verdict(*robust.outline[::43].T)
    assert np.all(inside == Verdict.STABLE)


def test_passive_walls_lie_in_the_robust_region(robust):
    # At alpha = 0 the wall has no stiffness, and a hand of gamma = 0 none either: marginal.
    passive = passive_region(delta=robust.delta[0], delay=robust.delay)
    if robust.delta[0] == 0.0:
        assert not len(passive.outline)
        return
    alpha, beta = passive.outline[:: max(1, len(passive.outline) // 12)].T * 0.97
    codes = robust.verdict(alpha + 1e-3 * robust.delta[0], beta * 0.99)
    assert np.all(codes == Verdict.STABLE)


def test_the_passive_triangle_lies_in_the_robust_region_and_is_smaller():
    robust = robust_region(**by_name(*RANGES["figure 9"]))
    assert robust.max_alpha[0] > passive_region(delta=1.0).stiffest[0] * 1.1


def test_without_damping_only_the_origin_is_robust():
    region = robust_region(gamma=(0.0, 9.0), delta=(0.0, 0.0), delay=0.0, tolerance=1e-3)
    assert region.status == RobustStatus.EMPTY
    assert len({status.words for status in RobustStatus}) == 4
    assert region.outline.shape == (0, 2)
    assert np.all(np.isnan(region.max_alpha))


def test_of_one_hand_it_is_the_stable_region():
    gamma, delta = 0.2, 0.3
    robust = robust_region(gamma=(gamma, gamma), delta=(delta, delta), delay=1.0, tolerance=0.005)
    stable = stable_region(gamma=gamma, delta=delta, delay=1.0)
    assert robust.status == RobustStatus.PROVED
    assert np.all(np.asarray(stable.contains(*robust.outline.T)))
    assert robust.max_alpha[0] == pytest.approx(float(stable.max_alpha[0]), rel=0.02)


def test_walls_that_are_unstable_for_all_hands_alike_are_not_proved():
    """No root crosses the circle among them: one loop has to be proved stable, too."""
    sample = polygons._Sample((0.2, 0.2), (0.3, 0.3), 0.0, None)
    square = np.array([[-1.0, 0.1], [-0.9, 0.1], [-0.9, 0.2], [-1.0, 0.2]])
    assert not len(failures(square, *sample.range, filters=None))
    assert truth.unstable_count(-1.0, 0.1, 0.2, 0.3, 0.0) == 1
    assert sample.unproved(square).tolist() == sample.hands[:1].tolist()


def test_of_hands_that_are_not_proved_those_at_the_ends_join_the_sample(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The hands of the least and the largest gamma, and of the least and the largest delta."""
    hands = np.array([[0.3, 0.2], [0.1, 0.3], [0.4, 0.6], [0.7, 0.5], [0.5, 0.1], [0.6, 0.9]])
    members = np.column_stack([np.zeros(6), hands, np.ones(6), np.zeros(6)])
    monkeypatch.setattr(polygons, "unproved_members", lambda *_, **__: members)
    found = failures(np.array([[0.1, 0.1]]), (0.0, 1.0), (0.0, 1.0), 0.0, filters=None)
    assert found.tolist() == [[0.1, 0.3], [0.5, 0.1], [0.6, 0.9], [0.7, 0.5]]


@pytest.mark.campaign
def test_a_verdict_on_a_wall_is_for_all_hands():
    region = robust_region(**by_name(*RANGES["haptic hands"]))
    alpha = np.array([0.05, 0.2, -1e-3, 0.0])
    codes = region.verdict(alpha, 0.3)
    assert codes.tolist()[:3] == [Verdict.STABLE, Verdict.UNSTABLE, Verdict.UNSTABLE]
    assert codes[3] == Verdict.UNSTABLE  # without stiffness of wall and hand a root is at z = 1
    inside = region.contains(alpha, 0.3)
    assert inside.dtype == bool
    assert inside.tolist() == [True, False, False, False]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gamma": (1.0, 0.0)}, "gamma is"),
        ({"delta": (0.0, -1.0)}, "delta is -1"),
        ({"gamma": (0.0, float("nan"))}, "gamma is nan"),
        ({"delay": -1.0}, "delay is -1"),
        ({"tolerance": 0.0}, "tolerance is 0"),
        ({"tolerance": 0.9e-3}, "tolerance is 0.0009"),
    ],
)
def test_robust_region_refuses_bad_input(arguments, message):
    with pytest.raises(ValueError, match=message):
        robust_region(**{"gamma": (0.0, 1.0), "delta": (0.0, 1.0)} | arguments)


@pytest.mark.campaign
@pytest.mark.parametrize("samples", [2, 20])
def test_a_robust_region_with_a_window_holds_for_hands_that_certified_roots_judge(
    rng: np.random.Generator, samples: int
) -> None:
    gamma, delta, delay = (0.0, 1e-3), (0.002, 0.01), 1.0
    window = jaxstab.Velocity.difference(samples=samples)
    region = robust_region(gamma=gamma, delta=delta, delay=delay, velocity=window)
    assert region.status == RobustStatus.PROVED
    low, high = np.array([gamma, delta]).T
    assert np.all((low <= region.hands) & (region.hands <= high))
    assert np.ptp(region.hands, axis=0) == pytest.approx(high - low)
    hands = [(g, d) for g in gamma for d in delta] + list(
        zip(rng.uniform(*gamma, 2), rng.uniform(*delta, 2), strict=True)
    )
    one = filtered.average(1)
    loops = [
        filtered.FilteredLoop(g, d, delay, filtered.difference(samples), one) for g, d in hands
    ]
    for wall in region.outline[:: len(region.outline) // 4]:
        assert all(loop.code(*wall) == Verdict.STABLE for loop in loops)
    # No more is given away than the tolerance: some hand forbids what lies a little farther out.
    beyond = region.outline.mean(axis=0) + 1.06 * (region.max_alpha - region.outline.mean(axis=0))
    assert any(loop.code(*beyond) == Verdict.UNSTABLE for loop in loops)
    assert region.contains(*region.outline.mean(axis=0))
    assert region.verdict(*(3.0 * region.max_alpha)) == Verdict.UNSTABLE


def test_the_worst_hand_of_a_loop_with_a_window() -> None:
    loop = jaxstab.HapticLoop(
        device_mass=0.25,
        device_damping=0.5,
        sample_time=1e-3,
        delay=1e-3,
        velocity=jaxstab.Velocity.difference(window=0.02),
    )
    hands = HandRange(mass=(0.0, 1.0), stiffness=(0.0, 500.0), damping=(0.0, 5.0))
    assert loop.worst_hand(hands, 800.0, 10.0).verdict == Verdict.STABLE
    worst = loop.worst_hand(hands, 8000.0, 10.0)
    assert worst.verdict == Verdict.UNSTABLE
    one = filtered.FilteredLoop(
        worst.loop.gamma, worst.loop.delta, 1.0, filtered.difference(20), filtered.average(1)
    )
    gains = worst.loop.alpha(8000.0), worst.loop.beta(10.0)
    assert one.code(*gains) == Verdict.UNSTABLE
    assert abs(float(one.radius(*gains).mid()) - worst.radius) < 1e-12


@pytest.mark.campaign
def test_the_robust_limit_of_a_loop_with_a_window_is_bounded_from_both_sides() -> None:
    loop = jaxstab.HapticLoop(
        device_mass=0.25,
        device_damping=0.1,
        sample_time=1e-3,
        delay=1e-3,
        velocity=jaxstab.Velocity.difference(samples=20),
    )
    hands = HandRange(stiffness=(0.0, 500.0), damping=(0.0, 5.0))
    found = loop.robust_limit(hands)
    assert found.is_proved
    assert found.stiffness < found.limit < 1.03 * found.stiffness
    judges = []
    for spring, damper in product(hands.stiffness, hands.damping):
        one = replace(loop, hand_stiffness=spring, hand_damping=damper)
        judges.append(
            filtered.FilteredLoop(
                one.gamma, one.delta, 1.0, filtered.difference(20), filtered.average(1)
            )
        )
    wall = loop.alpha(found.stiffness), loop.beta(found.damping)
    assert all(judge.code(*wall) == Verdict.STABLE for judge in judges)
    for beta in loop.beta(np.linspace(0.4, 2.0, 5) * found.damping):
        codes = [judge.code(loop.alpha(1.001 * found.limit), float(beta)) for judge in judges]
        assert Verdict.UNSTABLE in codes


@pytest.mark.parametrize(
    ("axis", "end"),
    [
        ("gamma", "high"),
        *(
            pytest.param(*x, marks=pytest.mark.campaign)
            for x in [("gamma", "low"), ("delta", "low")]
        ),
    ],
)
def test_a_root_near_an_end_of_a_range_is_not_missed(axis: str, end: str) -> None:
    """A small square of walls that only the outer twentieth of a range of hands makes unstable."""
    rng = np.random.default_rng(2012)
    tried = 0
    while tried < 2:
        wall = by_name(rng.uniform(-0.1, 0.2), rng.uniform(-0.2, 1.2), 0.02, 0.02, 1.0)
        inner, outer = rng.uniform(0.01, 0.2, 2)
        if (inner < outer) != (end == "high"):
            inner, outer = outer, inner
        codes = verdict(**wall | {axis: np.array([inner, outer])})
        if codes.tolist() != [Verdict.STABLE, Verdict.UNSTABLE]:
            continue
        for _ in range(40):  # the hand where the wall is on the boundary
            middle = 0.5 * (inner + outer)
            is_stable = verdict(**wall | {axis: middle}) == Verdict.STABLE
            inner, outer = (middle, outer) if is_stable else (inner, middle)
        width = 0.5 * inner if end == "low" else 0.05
        far = inner - width if end == "high" else inner + width
        near = inner + (inner - far) / 19.0
        ranges = {"gamma": (0.02, 0.02), "delta": (0.02, 0.02)}
        ranges[axis] = (min(near, far), max(near, far))
        center = np.array([wall["alpha"], wall["beta"]])
        square = center + 1e-7 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        left = failures(square, ranges["gamma"], ranges["delta"], 1.0, filters=None)
        assert len(left)
        tried += 1


@pytest.mark.parametrize(
    ("axis", "end"),
    first(
        [("mass", "low"), ("stiffness", "high"), ("mass", "high"), ("stiffness", "low"),
         ("damping", "low")], 2
    ),
)  # fmt: skip
def test_a_wall_that_few_hands_make_unstable_is_not_proved(axis: str, end: str) -> None:
    """Those of the outer twentieth of a range, at one of its ends; without them it is proved."""
    rng = np.random.default_rng(2012)
    names = ["mass", "stiffness", "damping"]
    low, high = np.array([[-0.1, -0.2, 0.0, 0.2, 0.0], [0.3, 1.2, 2.0, 0.2, 0.3]])
    drawn = rng.uniform(low, high, (8000, 5)).T  # K, B; mass, stiffness and damping of a hand
    delay = rng.integers(0, 2, 8000).astype(float)
    inner, outer = np.sort(rng.uniform(0.01, 2.0, (2, 8000)), axis=0)[:: -1 if end == "low" else 1]

    def is_stable(value: np.ndarray, k: np.ndarray) -> np.ndarray:  # a device of 1 kg, T = 1
        stiffness, damping, *hand = drawn[:, k]
        hand[names.index(axis)] = value
        terms = stiffness, damping, hand[1], 0.02 + hand[2]
        point = by_name(*(term / (1.0 + hand[0]) for term in terms), delay[k])
        return np.asarray(verdict(**point)) == Verdict.STABLE

    k = np.arange(8000)
    k = np.flatnonzero(is_stable(inner, k) & ~is_stable(outer, k))[:40]
    inner, outer = inner[k], outer[k]
    for _ in range(40):  # the hand of which the wall is on the boundary
        middle = 0.5 * (inner + outer)
        is_inner = is_stable(middle, k)
        inner, outer = np.where(is_inner, middle, inner), np.where(is_inner, outer, middle)
    far = inner * (0.8 if end == "high" else 1.25)
    shares = np.linspace(0.0, 0.99, 9)
    usable = np.all([is_stable(far + share * (inner - far), k) for share in shares], axis=0)
    assert usable.sum() >= 2
    for n in np.flatnonzero(usable)[:2]:
        loop = jaxstab.HapticLoop(
            device_mass=1.0, device_damping=0.02, sample_time=1.0, delay=float(delay[k[n]])
        )
        for beyond, is_proved in ((1.0 / 19.0, False), (-1.0 / 19.0, True)):
            ranges = {name: (x, x) for name, x in zip(names, drawn[2:, k[n]], strict=True)}
            ranges[axis] = tuple(sorted([far[n], inner[n] + beyond * (inner[n] - far[n])]))
            fixed = (1.0, 1.0), (float(delay[k[n]]),) * 2
            hands, wall = HandRange(**ranges), drawn[None, :2, k[n]]
            left = unproved_members(loop.held_device, loop, hands, *fixed, wall)
            assert (not len(left)) == is_proved
            values = left[:, names.index(axis)]  # within the range
            assert np.all((values >= ranges[axis][0]) & (values <= ranges[axis][1]))
