"""Boxes of a range, their budgets, and the search that proofs confirm, on closed-form curves."""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import pytest

from jaxstab import HandRange, HapticLoop
from jaxstab.boxes.enclosures import ParameterBoxes
from jaxstab.boxes.polygons import RobustRegion
from jaxstab.boxes.search import PULLS, Guess, Paving, RobustStatus, paved, search
from jaxstab.conventions import Verdict
from jaxstab.loop.hands import HandFamily, WorstHand

RADIUS = 0.75


class Circle:
    """Boxes that hold no point of x^2 + theta^2 = RADIUS^2, larger for each index, are free."""

    def __init__(self, first: int = 0) -> None:
        self.first, self.axes = first, ()

    def judged(self, boxes: ParameterBoxes) -> tuple[np.ndarray, np.ndarray]:
        self.axes = boxes.axes
        sizes, shares = -((RADIUS + 0.1 * (boxes.index + self.first)) ** 2), []
        for name in boxes.axes:
            x, by_x = boxes.ends(name)
            sizes = sizes + x**2
            shares.append((2.0 * abs(x) + by_x) * by_x)
        if "x" not in boxes.axes:
            sizes = sizes + 0.36
        share = np.stack(shares)
        return np.abs(sizes) > share.sum(axis=0), share


def pave(count: int, smallest: float, first: int = 0, **limits: float) -> Paving:
    return paved(Circle(first).judged, count, smallest, x=(-1.0, 1.0), **limits)


def on_half_circle(radius: float, count: int) -> np.ndarray:
    angle = np.linspace(0.0, np.pi, count)
    return radius * np.stack([np.cos(angle), np.sin(angle)])


def test_what_paving_leaves_covers_a_curve_and_is_next_to_it() -> None:
    left = pave(2, 2.0**-7)
    for index in range(2):
        boxes = left.boxes.select(left.boxes.index == index)
        radius = RADIUS + 0.1 * index
        points = on_half_circle(radius, 3000)
        away = np.abs(points[:, :, None] - boxes.center[:, None])
        assert np.all(np.any(np.all(away <= boxes.half[:, None], axis=0), axis=1))
        assert np.all(boxes.half[0] <= 2.0**-7)
        distance = np.abs(np.hypot(*boxes.center) - radius)
        assert np.all(distance <= np.hypot(*boxes.half))


def test_what_does_not_vary_is_no_axis() -> None:
    circle = Circle()
    left = paved(circle.judged, 1, 2.0**-20, x=(0.6, 0.6)).boxes
    assert circle.axes == left.axes == ("theta",)
    theta = left.ends("theta")[0]
    assert np.allclose(theta, np.sqrt(RADIUS**2 - 0.36), rtol=0.0, atol=2.0**-19)
    assert left.middles("x", 0.6, 0.6).tolist() == [0.6] * theta.size
    assert {*vars(HandRange()).values()} == {(0.0, 0.0)}


def test_what_becomes_of_an_index_does_not_depend_on_the_others() -> None:
    needed = [pave(1, 2.0**-5, first=i).judged[0] for i in range(3)]
    for most in (1, 20, 60, min(needed), max(needed)):
        together = pave(3, 2.0**-5, effort=int(most))
        for index in range(3):
            part = pave(1, 2.0**-5, first=index, effort=int(most))
            own = together.boxes.select(together.boxes.index == index)
            assert np.array_equal(np.sort(own.center, axis=1), np.sort(part.boxes.center, axis=1))
            assert together.judged[index] == part.judged[0] <= most


def test_boxes_of_a_proof_that_is_given_up_are_left() -> None:
    left = pave(1, 2.0**-30, most=100).boxes
    assert left.index.size > 100
    away = np.abs(on_half_circle(RADIUS, 1000)[:, :, None] - left.center[:, None])
    assert np.all(np.any(np.all(away <= left.half[:, None], axis=0), axis=1))


def test_halves_cover_the_box_along_one_axis() -> None:
    box = ParameterBoxes.between(np.array([7]), x=(0.0, 1.0), y=(2.0, 2.0), theta=(1.0, 3.0))
    assert box.axes == ("x", "theta")
    halves = box.halved(np.array([1]))
    assert halves.index.tolist() == [7, 7]
    low, high = halves.center - halves.half, halves.center + halves.half
    assert low.tolist() == [[0.0, 0.0], [1.0, 2.0]]
    assert high.tolist() == [[1.0, 1.0], [2.0, 3.0]]
    assert halves.middles("theta", 1.0, 2.25).tolist() == [1.5, 2.25]


def test_a_quantity_in_other_units_is_held_to_its_ends(rng: np.random.Generator) -> None:
    """By exact fractions: (center +- half) unit, products that float64 rounds."""
    center, half = rng.uniform(0.0, 1.0, (2, 40)) * [[0.0], [1.0]] + [[0.0], [0.1]]
    boxes = ParameterBoxes(("x",), center[None], half[None], np.zeros(40, int))
    for unit in rng.uniform(0.5, 2.0, 20).tolist():
        made = boxes.along("x", unit)
        for k in range(40):
            reached = Fraction(float(made.slope[0, k])) + Fraction(float(made.rest[k]))
            assert reached >= Fraction(float(half[k])) * Fraction(unit)
            assert reached <= Fraction(float(half[k])) * Fraction(unit) * Fraction(1.0 + 1e-8)


def test_one_stable_loop_is_needed_and_one_unstable_loop_is_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stable, unstable, unknown = Verdict.STABLE, Verdict.UNSTABLE, Verdict.UNDECIDED
    sampled = np.array(
        [[stable, stable], [stable, unstable], [stable, unknown], [unknown, unknown]], np.int8
    )
    tried = []

    def failures(walls: np.ndarray, *_: object, **__: object) -> np.ndarray:
        tried.extend(walls[:, 0].tolist())
        return np.zeros((0 if walls[0, 0] == 0.0 else 1, 2))

    monkeypatch.setattr("jaxstab.boxes.polygons._verdicts", lambda *_: sampled)
    monkeypatch.setattr("jaxstab.boxes.polygons.failures", failures)
    outline, hands = np.zeros((0, 2)), np.zeros((2, 2))
    region = RobustRegion((0.0, 1.0), (0.0, 1.0), 0.0, 0.1, RobustStatus.EMPTY, outline, hands)
    codes = region.verdict([0.0, 1.0, 2.0, 3.0], 0.5)
    assert codes.tolist() == [stable, unstable, unknown, unknown]
    assert tried == [0.0, 2.0]  # no proof for a wall that no sampled loop shows to be stable


def test_the_worst_loop_is_refuted_only_by_one_that_is_proved_unstable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stable, unstable, unknown = Verdict.STABLE, Verdict.UNSTABLE, Verdict.UNDECIDED
    judged, asked = [], []
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)

    def found(code: Verdict, failed: np.ndarray | None, other: WorstHand) -> tuple[Verdict, float]:
        answers = iter([WorstHand(code, loop, 0.9), other])

        def worst_of(loops: list[float], *_: object) -> WorstHand:
            judged.append(loops)
            return next(answers)

        def unproved(*_: object) -> np.ndarray | None:
            asked.append(code)
            return failed

        monkeypatch.setattr("jaxstab.loop.hands._worst_of", worst_of)
        monkeypatch.setattr(HandFamily, "unproved", unproved)
        monkeypatch.setattr(HandFamily, "_held", lambda _, member: member.tolist()[0])
        worst = HandFamily(loop, HandRange(mass=(0.0, 1.0))).worst(1.0, 1.0)
        return worst.verdict, worst.radius

    many = np.tile(np.arange(130.0)[:, None], 5)
    refuting, worse = WorstHand(unstable, loop, 1.1), WorstHand(stable, loop, 0.95)
    assert found(stable, np.zeros((0, 5)), refuting) == (stable, 0.9)
    assert found(stable, None, refuting) == (unknown, 0.9)  # no proof is known
    assert judged == [[0.0, 0.5, 1.0]] * 2
    assert found(stable, many, refuting) == (unstable, 1.1)
    assert found(stable, many, worse) == (unknown, 0.95)
    tried = judged[-1]
    assert (len(tried), tried[0], max(np.diff(tried))) == (64, 0.0, 3.0)  # spread over all
    assert found(unstable, many, worse) == (unstable, 0.9)
    assert found(unknown, many, worse) == (unknown, 0.9)
    assert asked == [stable] * 4


class Disc:
    """Walls below 1 + (t - 0.3)^2 for all t in [0, 1], of which some are sampled."""

    def __init__(self, proved_below: float) -> None:
        self.sample, self.proved_below, self.tried = [0.0, 1.0], proved_below, 0

    def guess(self, pull: float) -> Guess:
        limit = min(1.0 + (t - 0.3) ** 2 for t in self.sample)
        return Guess(np.array([[limit * (1.0 - pull), 0.0]]), limit)

    def unproved(self, walls: np.ndarray) -> Sequence[float]:
        self.tried += 1
        return [] if walls[0, 0] < self.proved_below else [0.3]

    def add(self, new: Sequence[float]) -> bool:
        known = new[0] in self.sample
        self.sample += [] if known else list(new)
        return not known


def test_a_search_samples_where_a_proof_fails_before_it_pulls_further() -> None:
    def tried(disc: Disc, *pulls: float) -> tuple[list[list[float]], bool]:
        guess, is_proved = search(disc.guess, disc.unproved, disc.add, pulls)
        assert guess is not None
        return guess.walls.tolist(), is_proved

    disc = Disc(proved_below=0.995)
    assert tried(disc, 0.01, 0.02) == ([[0.99, 0.0]], True)
    assert disc.tried == 2
    assert tried(Disc(proved_below=0.97), 0.01, 0.02, 0.04) == ([[0.96, 0.0]], True)
    disc = Disc(proved_below=0.5)
    assert tried(disc, 0.01, 0.02, 0.04) == ([[0.96, 0.0]], False)
    assert disc.tried == 4
    nothing = Guess(np.zeros((0, 2)))
    for known in (nothing, None):  # no walls are allowed, or it is not known which
        assert search(lambda _, it=known: it, disc.unproved, disc.add, [0.01]) == (known, False)


def test_a_limit_is_proved_1_percent_below_or_2_or_4_or_8() -> None:
    assert tuple(2.0**k / 100.0 for k in range(4)) == PULLS


def test_a_search_shares_its_proofs_among_the_pulls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of 24 proofs may find a new loop that only just refutes the wall."""
    monkeypatch.setattr(Disc, "add", lambda *_: True)
    for proved_below, tried in ((0.97, 17), (0.5, 24)):
        disc = Disc(proved_below)
        disc.sample.append(0.3)
        guess, is_proved = search(disc.guess, disc.unproved, disc.add, [0.01, 0.02, 0.04])
        assert guess is not None
        assert guess.walls.tolist() == [[0.96, 0.0]]
        assert (disc.tried, is_proved) == (tried, proved_below > 0.96)
