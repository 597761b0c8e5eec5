"""What is printed as stable is so as it is printed: parsed, and given an exact verdict."""

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from campaign import many
from explorer import NODE, asked_of_node, loop_of, random_setup

from jaxstab import HapticLoop, Verdict
from jaxstab.answers import GainAnswer
from jaxstab.app.scene import Scene, design_loop, scene_limits, tune_walls
from jaxstab.app.scene import loop_of as scene_loop
from jaxstab.app.scene.loops import range_of_hands, with_delay
from jaxstab.app.scene.tune import delayed_loop, sampled_loop
from jaxstab.shown import Printed, exact_text, stable_pair
from tests.truth.random_scenes import NUMBER, SOFT, random_table

needs_node = pytest.mark.skipif(NODE is None, reason="there is no node here")
BESIDE = 1e-9  # of an interval: how far inside of its printed ends walls are asked
K, B = "(?:N/m|N m/rad)", "(?:N s/m|N m s/rad)"


def said_walls(text: str) -> list[tuple[float, float]]:
    """The walls (K, B) that a text calls stable, but for limits that are 0: these are no walls."""
    kinds = {
        rf"largest stiffness +{NUMBER} {K}(?:\n +at damping +| at ){NUMBER} {B}": 1,
        rf"largest damping +{NUMBER} {B}\n +at stiffness +{NUMBER} {K}": -1,
        rf"^ +stiffness +{NUMBER} {K}\n +damping +{NUMBER} {B}\n +spectral": 1,
        rf"K = {NUMBER} N/m at B = {NUMBER} N s/m": 1,
        rf"B = {NUMBER} N s/m at K = {NUMBER} N/m": -1,
    }
    return [
        tuple(map(float, pair))[::way]
        for kind, way in kinds.items()
        for pair in re.findall(kind, text, re.MULTILINE)
        if float(pair[0])
    ]


def ends_of(text: str, name: str) -> list[tuple[float, float]]:
    """The ends of the intervals of stable gains in a text, a little inside."""
    pairs = re.findall(rf"{name} limits +{NUMBER} to {NUMBER}", text)
    ends = [tuple(map(float, pair)) for pair in pairs]
    assert all(low == 0.0 or abs(low) > 1e-9 * high for low, high in ends)  # on an axis it is 0
    return [(low + BESIDE * (high - low), high - BESIDE * (high - low)) for low, high in ends]


def walls_of_limits(table: dict[str, Any], rng: np.random.Generator) -> tuple[HapticLoop, Any]:
    """The loop of a scene, and the walls that ``limits``, loops and regions call stable."""
    scene = Scene.from_table(table)
    loop, answer = scene_loop(scene), scene_limits(scene)
    stiffness, damping = (
        float(most) * rng.uniform()
        for most in (answer.best.largest_stiffness, answer.most_damped.largest_damping)
    )
    if not stiffness > 0.0:
        return loop, []
    wanted = {"at_damping": damping, "at_stiffness": stiffness}
    answer = scene_limits(Scene.from_table({**table, "wanted": wanted}))
    # Of other loops, of an approximation.
    others = GainAnswer({**answer.values, "windows": {}, "linear_rule": None})
    text = "\n".join([str(others), answer.in_short(), repr(loop.limits()), repr(loop.region())])
    walls = said_walls(text)
    assert len(walls) >= 7
    walls += [(k, damping) for ends in ends_of(text, "stiffness") for k in ends]
    walls += [(stiffness, b) for ends in ends_of(text, "damping") for b in ends]
    return loop, walls


def assert_stable(loop: HapticLoop, walls: list[tuple[float, float]]) -> None:
    most = max((stiffness for stiffness, _ in walls), default=0.0)
    for stiffness, damping in walls:
        # Without a spring a free device drifts: such a wall is a limit of ever softer ones.
        softer = (SOFT * 10.0**-k * most for k in range(0, 5, 2)) if stiffness == 0.0 else ()
        codes = (loop.verdict(own, damping) for own in (stiffness, *softer))
        assert Verdict.STABLE in codes, (loop, stiffness, damping)


def assert_limits_are_stable(seeds: Iterable[int]) -> None:
    for seed in seeds:
        rng = np.random.default_rng([51, 4, seed])
        assert_stable(*walls_of_limits(random_table(rng), rng))


def test_limits_are_stable_as_they_are_printed() -> None:
    """Of seed 11 the corner is a needle, of 15 an island has one."""
    assert_limits_are_stable((11, 15, 16))


@pytest.mark.campaign
def test_limits_of_many_scenes_are_stable_as_they_are_printed() -> None:
    assert_limits_are_stable(range(17, 17 + many(1000, 25)))


@pytest.mark.campaign
def test_tuned_and_designed_walls_are_stable_as_they_are_printed() -> None:
    for seed in range(many(100, small=2)):
        rng = np.random.default_rng([51, 5, seed])
        table = random_table(rng)
        scene = Scene.from_table(table)
        loop, largest = scene_loop(scene), scene_limits(scene).best.largest_stiffness
        wanted = float(largest) * rng.uniform(0.3, 0.9)
        table["wanted"] = {"stiffness": wanted, "at_stiffness": wanted}
        scene = Scene.from_table(table)
        walls = said_walls(str(tune_walls(scene)))
        assert len(walls) >= 2
        assert_stable(loop, walls)
        said = str(design_loop(scene))
        for name, loop_at in (("sample time", sampled_loop), ("delay", delayed_loop)):
            number = rf"largest {name} +{NUMBER} ms\n +at damping +{NUMBER} {B}"
            for milliseconds, damping in re.findall(number, said):
                designed = loop_at(scene, float(milliseconds) * 1e-3)
                assert designed.verdict(wanted, float(damping)) == Verdict.STABLE


@pytest.mark.campaign
def test_walls_for_all_hands_and_delays_are_proved_as_they_are_printed() -> None:
    for seed in range(many(20, small=2)):
        rng, moves = np.random.default_rng([51, 6, seed]), seed % 2 == 1
        mass, period = 10.0 ** rng.uniform(-2.0, 0.0), 1e-3
        scene = Scene.from_table(
            {
                "device": {"mass": mass, "damping": 0.01 * mass / period},
                "hand": {"mass": [0.0, mass], "damping": [0.0, 0.02 * mass / period]},
                "controller": {"sample_time": period, "delay": [0.0, 2e-4] if moves else period},
            }
        )
        said = scene_limits(scene).in_short()
        moving: dict[str, Any] = {"delays": (0.0, 2e-4)} if moves else {}
        loop = scene_loop(with_delay(scene, 0.0 if moves else period))
        (found,) = re.findall(rf"for all hands +{NUMBER} {K} at {NUMBER} {B}, proved", said)
        wall = loop.worst_hand(range_of_hands(scene), *map(float, found), **moving)
        assert wall.verdict == Verdict.STABLE
        limits = loop.limits(delays=(0.0, 2e-4))
        (said_wall, *_) = said_walls(repr(limits))
        assert said_wall == (limits.stiffness, limits.damping)  # which is proved, and no other


def test_a_narrow_corner_takes_as_many_digits_as_it_needs() -> None:
    """A needle along K = 1000 B, below B = 0.1234567."""

    def is_stable(stiffness: float, damping: float) -> bool:
        return abs(stiffness - 1000.0 * damping) < 1e-4 and damping < 0.1234567

    def row(damping: float) -> list[tuple[float, float]]:
        return [(1000.0 * damping - 1e-4, 1000.0 * damping + 1e-4)] if damping < 0.1234567 else []

    printed = stable_pair(123.4567, 0.1234567, (4, 4), is_stable, row)
    assert printed == (123.4567, 0.1234567)  # the numbers are as they were
    texts = [number.text for number in printed if isinstance(number, Printed)]
    assert texts == ["123.4", "0.1234"]
    assert exact_text(0.1) == "0.1"
    assert exact_text(6669.123456789012) == "6669.123456789012"


def assert_headlines_are_stable(count: int) -> None:
    rng = np.random.default_rng(4)
    setups, walls = [random_setup(rng) for _ in range(count)], 0
    for scale, setup in zip(10.0 ** rng.uniform(-5.0, 0.0, count), setups, strict=True):
        for name in ("mass", "damping", "handMass", "handStiffness", "handDamping"):
            setup[name] *= float(scale)
    for setup, headline in zip(setups, asked_of_node("headlines", setups), strict=True):
        said = re.match(r".*stable wall: (\S+) N/m, at a damping of (\S+) N s/m", headline)
        if said:
            wall = [float(number.replace(",", "")) for number in said.groups()]
            assert loop_of(setup).verdict(*wall) == Verdict.STABLE, (setup, headline)
            walls += 1
    assert walls > 0.8 * count


@needs_node
def test_headlines_of_the_explorer_are_stable_as_they_are_printed() -> None:
    """ "3.745 N m/rad, at a damping of 0.008" is not, nor 0.6078 at 0.006."""
    assert_headlines_are_stable(100)


@needs_node
@pytest.mark.campaign
def test_many_headlines_of_the_explorer_are_stable_as_they_are_printed() -> None:
    assert_headlines_are_stable(many(10_000))
