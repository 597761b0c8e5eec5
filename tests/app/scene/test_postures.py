"""Scenes whose device has a range of masses, over its postures."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxstab.app.scene.exports
import jaxstab.lab.guard
from jaxstab import Verdict
from jaxstab.app.scene import Scene
from jaxstab.app.scene.check import check_walls
from jaxstab.app.scene.exports import atlas_spec
from jaxstab.app.scene.limits import scene_limits
from jaxstab.app.scene.loops import corner_loops, ranges_of
from jaxstab.app.scene.tune import design_loop, tune_walls
from tests.commands import run
from tests.truth import filtered

MASSES = 0.15, 0.25
PERIOD = 1e-3


def table(**device: Any) -> dict[str, Any]:
    return {
        "device": {"mass": list(MASSES), "damping": 0.1, **device},
        "hand": {"mass": [0.0, 0.5], "stiffness": [0.0, 300.0], "damping": [0.0, 5.0]},
        "controller": {"sample_time": PERIOD, "delay": 1e-3, "velocity": {"window": 0.02}},
        "walls": {"soft": {"stiffness": 700.0, "damping": 8.0}},
        "wanted": {"stiffness": 600.0},
    }


def code_of(wall: tuple[float, float], mass: float, hand: tuple[float, float, float]) -> int:
    """The verdict by certified roots."""
    moved, spring, damper = mass + hand[0], hand[1], 0.1 + hand[2]
    gamma, delta = spring * PERIOD**2 / moved, damper * PERIOD / moved
    loop = filtered.FilteredLoop(gamma, delta, 1.0, filtered.difference(20), filtered.average(1))
    return loop.code(wall[0] * PERIOD**2 / moved, wall[1] * PERIOD / moved)


@pytest.mark.campaign
def test_the_limit_for_all_holds_for_all_masses_and_hands(rng: np.random.Generator) -> None:
    limits = scene_limits(Scene.from_table(table()))
    found = limits.all_hands
    assert found is not None
    assert found.certainty == "proved for every hand and mass"
    assert found.worst_hand.device_mass == 0.15
    wall = found.largest_stiffness, found.at_damping
    low, high = np.array([MASSES, (0.0, 0.5), (0.0, 300.0), (0.0, 5.0)]).T
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * 4)).reshape(4, -1).T
    for share in [*corners, *rng.random((20, 4))]:
        mass, *hand = (low + (high - low) * share).tolist()
        assert code_of(wall, mass, tuple(hand)) == Verdict.STABLE
    setter = found.worst_hand
    above = 1.03 * found.largest_stiffness, found.at_damping
    held = setter.mass, setter.stiffness, setter.damping
    assert code_of(above, 0.15, held) == Verdict.UNSTABLE


def test_a_wall_that_one_mass_alone_does_not_bear_is_unstable() -> None:
    scene = Scene.from_table(table() | {"walls": {"a": {"stiffness": 1500.0, "damping": 10.0}}})
    alone = Scene.from_table(
        {**table(mass=0.25), "walls": {"a": {"stiffness": 1500.0, "damping": 10.0}}}
    )
    assert check_walls(alone).walls["a"].verdict == Verdict.STABLE
    wall = check_walls(scene).walls["a"]
    assert wall.verdict == Verdict.UNSTABLE
    assert wall.worst_hand is not None
    own = wall.worst_hand.device_mass
    assert own is not None
    held = wall.worst_hand.mass, wall.worst_hand.stiffness, wall.worst_hand.damping
    assert code_of((1500.0, 10.0), own, held) == Verdict.UNSTABLE


@pytest.mark.campaign
def test_a_device_behind_a_grip_is_proved_for_its_masses_too() -> None:
    text = table()
    text["hand"]["grip"] = {"stiffness": 2000.0, "damping": 4.0}
    scene = Scene.from_table(text)
    assert check_walls(scene).walls["soft"].verdict == Verdict.STABLE
    found = scene_limits(scene).all_hands
    assert found is not None
    assert found.certainty == "proved for every hand and mass"
    assert found.worst_hand.device_mass == 0.15


def test_masses_without_a_hand_are_proved() -> None:
    text = table()
    del text["hand"]
    scene = Scene.from_table(text)
    wall = check_walls(scene).walls["soft"]
    assert wall.verdict == Verdict.STABLE
    assert wall.worst_hand is not None
    found = scene_limits(scene).all_hands
    assert found is not None
    assert found.worst_hand.device_mass == 0.15
    wall_found = found.largest_stiffness, found.at_damping
    for mass in np.linspace(*MASSES, 9).tolist():
        assert code_of(wall_found, mass, (0.0, 0.0, 0.0)) == Verdict.STABLE


@pytest.mark.campaign
def test_every_answer_says_for_which_masses_it_is() -> None:
    scene = Scene.from_table(table())
    words = "a device of 0.15 to 0.25 kg, constant while a wall is touched"
    lowest = "at its lowest values, the device at its lowest mass"
    for answer in (scene_limits(scene), design_loop(scene)):
        assert answer.inputs is not None
        assert answer.inputs.postures == words
    assert scene_limits(scene).hand.startswith(lowest)
    assert design_loop(scene).certainty == "proved for every hand and mass"
    assert {loop.device_mass for loop in corner_loops(scene)} == {*MASSES}
    plain = scene_limits(Scene.from_table(table(mass=0.15)))
    assert plain.inputs is not None
    assert plain.inputs.postures is None


@pytest.mark.campaign
def test_tune_looks_over_the_masses() -> None:
    found = tune_walls(Scene.from_table(table())).over_ranges
    assert found is not None
    assert found.slowest is not None
    assert found.slowest.mass in MASSES


def test_a_guard_and_an_atlas_are_of_the_masses(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}

    def build(*_: Any, **asked: Any) -> None:
        given.update(asked)
        raise NotImplementedError

    monkeypatch.setattr(jaxstab.lab.guard, "build_guard", build)
    scene = Scene.from_table(table())
    with pytest.raises(NotImplementedError):
        jaxstab.app.scene.exports.scene_guard(scene, lost=0, progress=print, cells=(1, 1, 1))
    assert given["mass"] == MASSES
    assert ranges_of(scene)[0] == MASSES
    nodes = atlas_spec(scene).gamma
    assert (min(nodes), max(nodes)) == (0.0, pytest.approx(300.0 * PERIOD**2 / 0.15))


@pytest.mark.campaign
def test_the_command_line_takes_a_range_of_masses(tmp_path: Path) -> None:
    options = "--damping", "0.1", "--sample-time", "1e-3", "--window", "0.02", "--json"
    found = json.loads(run("limits", "--mass", "0.15:0.25", *options).stdout)
    assert found["all_hands"]["worst_hand"]["device_mass"] == 0.15
    options = "--damping", "1e-3", "--sample-time", "1e-3", "--json"
    found = json.loads(run("limits", "--inertia", "0.01:0.02", *options).stdout)
    assert found["all_hands"]["worst_hand"]["device_inertia"] == 0.01
    assert "kg m^2" in found["inputs"]["postures"]
    picture = tmp_path / "a.png"
    assert run("limits", "--mass", "0.2:0.3", *options[:-1], "--plot", picture).exit_code == 0
    assert picture.stat().st_size > 0


@pytest.mark.parametrize(
    ("mass", "words"),
    [
        ([0.25, 0.15], "device.mass is [0.25, 0.15]; its ends are swapped, so give [0.15, 0.25]."),
        ([0.0, 0.15], "give a finite number > 0 in kg, or [lowest, highest]."),
        ([0.1, 0.2, 0.3], "give a finite number > 0 in kg, or [lowest, highest]."),
    ],
)
def test_what_is_no_range_of_masses_is_refused(mass: list[float], words: str) -> None:
    with pytest.raises(ValueError, match="mass") as error:
        Scene.from_table(table(mass=mass))
    assert str(error.value).endswith(words)
