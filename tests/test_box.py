"""Boxes of a range, their budgets, and the search that proofs confirm, on closed-form curves."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest

from jaxstab.conventions import Verdict
from jaxstab.ranges.box import (
    Guess,
    ParameterBox,
    Proof,
    RobustStatus,
    search,
    verdicts_of_range,
    worst_of_range,
)

RADIUS = 0.75


def circle(boxes: ParameterBox) -> Proof:
    """Prove that boxes hold no point of the circle x^2 + y^2 = RADIUS^2, larger for each index."""
    (x, by_x), (y, by_y) = boxes["x"], boxes["y"]
    middle = x**2 + y**2 - (RADIUS + 0.1 * boxes.index) ** 2
    share = np.stack([(2.0 * abs(x) + by_x) * by_x, (2.0 * abs(y) + by_y) * by_y], axis=-1)
    return Proof(np.abs(middle) > share.sum(axis=1), share)


def squares(count: int) -> ParameterBox:
    return ParameterBox.from_axes(np.arange(count), x=(0.0, 1.0), y=(0.0, 1.0))


def test_what_paving_leaves_covers_a_curve_and_is_next_to_it() -> None:
    smallest = np.array([2.0**-6, 2.0**-7])
    left = squares(2).paved(circle, smallest)
    assert left.finished
    angle = np.linspace(0.0, 2.0 * np.pi, 5000)
    for index in range(2):
        boxes = left.boxes.select(left.boxes.index == index)
        radius = RADIUS + 0.1 * index
        points = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        away = np.abs(points[:, None] - boxes.center)
        assert np.all(np.any(np.all(away <= boxes.half, axis=2), axis=1))
        assert np.all(boxes.half <= smallest)
        distance = np.abs(np.hypot(*boxes.center.T) - radius)
        assert np.all(distance <= np.hypot(*boxes.half.T))


def test_axes_without_a_width_are_not_halved() -> None:
    boxes = ParameterBox.from_axes(np.zeros(1, int), x=(0.6, 0.0), y=(0.0, 1.0))
    left = boxes.paved(circle, 2.0**-20).boxes
    assert np.all(left["x"][0] == 0.6)
    assert np.all(left["x"][1] == 0.0)
    assert np.allclose(np.abs(left["y"][0]), np.sqrt(RADIUS**2 - 0.36), rtol=0.0, atol=2.0**-19)


@pytest.mark.parametrize("limit", ["most_each", "effort"])
def test_what_becomes_of_an_index_does_not_depend_on_the_others(limit: str) -> None:
    alone = [ParameterBox.from_axes(np.array([i]), x=(0.0, 1.0), y=(0.0, 1.0)) for i in range(3)]
    needed = [box.paved(circle, 2.0**-5).judged[i] for i, box in enumerate(alone)]
    for most in (1, 20, 60, min(needed), max(needed)):
        together = squares(3).paved(circle, 2.0**-5, **{limit: int(most)})
        parts = [box.paved(circle, 2.0**-5, **{limit: int(most)}) for box in alone]
        assert together.finished == all(part.finished for part in parts)
        for index, part in enumerate(parts):
            own = together.boxes.select(together.boxes.index == index)
            assert np.array_equal(np.sort(own.center, axis=0), np.sort(part.boxes.center, axis=0))
            assert together.judged[index] == part.judged[index]
            if limit == "effort":
                assert part.judged[index] <= most
                assert part.finished == (needed[index] <= most)


def test_boxes_of_a_proof_that_is_given_up_are_left() -> None:
    left = squares(1).paved(circle, 2.0**-30, most=100)
    assert not left.finished
    assert left.boxes.count > 100
    angle = np.linspace(0.0, 2.0 * np.pi, 1000)
    points = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    away = np.abs(points[:, None] - left.boxes.center)
    assert np.all(np.any(np.all(away <= left.boxes.half, axis=2), axis=1))


def test_one_stable_loop_is_needed_and_one_unstable_loop_is_enough() -> None:
    stable, unstable, unknown = Verdict.STABLE, Verdict.UNSTABLE, Verdict.UNDECIDED
    sampled = np.array(
        [[stable, stable], [stable, unstable], [stable, unknown], [unknown, unknown]], np.int8
    )
    tried = []

    def prove(likely: np.ndarray) -> np.ndarray:
        tried.extend(likely.tolist())
        return np.array([stable, unknown], np.int8)

    codes = verdicts_of_range(sampled, prove)
    assert codes.tolist() == [stable, unstable, unknown, unknown]
    assert tried == [0, 2]  # no proof for a wall that no sampled loop shows to be stable


class Worst(NamedTuple):
    verdict: Verdict
    radius: float


def test_the_worst_loop_is_refuted_only_by_one_that_is_proved_unstable() -> None:
    stable, unstable, unknown = Verdict.STABLE, Verdict.UNSTABLE, Verdict.UNDECIDED
    sampled = [Worst(code, 0.9) for code in (stable, stable, stable, stable, unstable, unknown)]
    failed = {1: np.arange(10.0), 2: np.arange(10.0), 3: np.zeros(0)}
    judged = {}

    def judge(number: int, loops: np.ndarray) -> Worst:
        judged[number] = loops.tolist()
        return Worst(unstable, 1.1) if number == 1 else Worst(stable, 0.95)

    def unproved(numbers: list[int]) -> dict[int, np.ndarray]:
        assert numbers == [0, 1, 2, 3]
        return failed

    found = worst_of_range(sampled, unproved, judge, 5)
    assert [one.verdict for one in found] == [stable, unstable, unknown, unknown, unstable, unknown]
    assert [one.radius for one in found] == [0.9, 1.1, 0.95, 0.9, 0.9, 0.9]
    assert judged == {1: [0.0, 2.0, 4.0, 6.0, 8.0], 2: [0.0, 2.0, 4.0, 6.0, 8.0]}


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
    disc = Disc(proved_below=0.995)
    found = search(disc.guess, disc.unproved, disc.add, [0.01, 0.02])
    assert found.is_proved
    assert found.pull == 0.01
    assert found.guess is not None
    assert found.guess.limit == 1.0
    assert found.guess.walls.tolist() == [[0.99, 0.0]]
    assert disc.tried == 2
    disc = Disc(proved_below=0.97)
    assert search(disc.guess, disc.unproved, disc.add, [0.01, 0.02, 0.04]).pull == 0.04
    disc = Disc(proved_below=0.5)
    found = search(disc.guess, disc.unproved, disc.add, [0.01, 0.02, 0.04])
    assert not found.is_proved
    assert found.status == RobustStatus.UNPROVED
    assert disc.tried == 4
    assert search(disc.guess, lambda _: None, disc.add, [0.01]).status == RobustStatus.UNPROVED
    assert search(lambda _: Guess(np.zeros((0, 2))), disc.unproved, disc.add, [0.01]).status == (
        RobustStatus.EMPTY
    )
    assert search(lambda _: None, disc.unproved, disc.add, [0.01]).status == RobustStatus.UNPROVED
