"""Scenes in TOML: what is read, what is refused and in which words, what is planned."""

import math
import tomllib
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from commands import EXAMPLE, assert_refuses

from jaxstab.app.scene import Scene
from jaxstab.app.scene.scene import presets

SCENES = sorted((Path(__file__).parents[3] / "data" / "scenes").glob("*.toml"))
GOOD: dict[str, Any] = {
    "device": {"mass": 0.1, "damping": 1.5},
    "controller": {"sample_time": 1e-3},
}


def with_value(path: str, value: Any) -> dict[str, Any]:
    table: dict[str, Any] = {name: dict(section) for name, section in GOOD.items()}
    place = table
    *sections, key = path.split(".")
    for section in sections:
        place = place.setdefault(section, {})
    place[key] = value
    return table


def test_the_base_joint_of_an_arm_is_usual() -> None:
    device, controller = {"inertia": 2.0, "damping": 5.0}, {"sample_time": 1e-3}
    assert Scene.from_table({"device": device, "controller": controller}).unusual() == []


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_the_scenes_that_come_along_are_good_and_usual_but_for_what_they_say(path: Path) -> None:
    scene = Scene.from_file(path)
    assert scene.walls
    assert scene.unusual() == []


def test_there_is_a_scene_for_each_use() -> None:
    assert {path.stem for path in SCENES} >= {
        "phantom",
        "omega",
        "falcon",
        "teleoperation",
        "collision",
    }


def test_the_example_is_a_scene_with_ranges_walls_and_a_fractional_delay() -> None:
    scene = Scene.from_table(tomllib.loads(EXAMPLE))
    assert scene.hand is not None
    assert scene.hand.varies
    assert scene.hand.mass == (0.0, 0.3)
    assert scene.hand.damping == (1.0, 1.0)
    assert list(scene.walls) == ["soft", "hard"]
    assert scene.controller.time_delay == pytest.approx(1.5e-3)


def test_every_value_that_is_commented_out_in_the_example_is_good_too() -> None:
    lines = [line.removeprefix("# ") if " = " in line else line for line in EXAMPLE.splitlines()]
    scene = Scene.from_table(tomllib.loads("\n".join(lines)))
    assert scene.device.preset == "phantom"
    assert scene.wanted.stiffness == 3000.0


def test_a_preset_gives_what_the_table_does_not() -> None:
    table = with_value("device", {"preset": "phantom", "mass": 0.2})
    device = Scene.from_table(table).device
    assert (device.mass, device.damping) == ((0.2, 0.2), 1.5)


def test_a_device_of_which_no_mass_is_known_asks_for_one() -> None:
    assert "mass" not in presets("devices")["sigma.7"]
    with pytest.raises(ValueError, match=r"^device.mass is missing; no source has that of"):
        Scene.from_table(with_value("device", {"preset": "sigma.7"}))
    table = with_value("device", {"preset": "sigma.7", "mass": 0.4, "damping": 0.5})
    assert Scene.from_table(table).device.effective_mass == (0.4, 0.4)


VELOCITY, POSITION = "controller.velocity", "controller.position"
MASS = "> 0 in kg", "[lowest, highest]"


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("device.mas", 1.0, ("device.mas is unknown", "'mass'")),
        ("contoller", {}, ("contoller is unknown", "'controller'")),
        ("walls.a.stiffness", 1.0, ("walls.a.damping is missing", "N s/m")),
        ("walls.a.stifness", 1.0, ("walls.a.stifness is unknown", "'stiffness'")),
        (
            "walls.a",
            {"stiffness": 1.0, "damping": 1.0, "stifness": 2.0},
            ("walls.a.stifness is unknown", "'stiffness'"),
        ),
        ("device.mass", -1.0, ("device.mass is -1.0", *MASS)),
        ("device.mass", 0, ("device.mass is 0;", *MASS)),
        ("device.damping", math.nan, ("device.damping is nan", ">= 0 in N s/m")),
        ("device.mass", "heavy", ("device.mass is 'heavy'", *MASS)),
        ("device.mass", True, ("device.mass is True", *MASS)),
        ("device.preset", "phantm", ("device.preset is 'phantm'", "'phantom'")),
        ("device", 3, ("device is 3;", "{ mass = 3 }")),
        ("device", "omega", ("device is 'omega'", "{ preset = 'omega' }")),
        ("hand", "soft", ("hand is 'soft'", "{ mass = ... }")),
        ("device.inertia", 0.1, ("device.mass is 0.1", "inertia", "a line", "turns")),
        (
            "device",
            {"inertia": 0.1, "damping": -1.0},
            ("device.damping is -1.0", ">= 0 in N m s/rad"),
        ),
        (
            "hand.inertia",
            0.1,
            ("hand.inertia is [0.1, 0.1]", "device.mass", "hand.mass", "device.inertia"),
        ),
        (VELOCITY, 3, (f"{VELOCITY} is 3;", "{ window_samples = 3 }")),
        (f"{VELOCITY}.windw", 0.02, (f"{VELOCITY}.windw is unknown", "'window'")),
        (f"{VELOCITY}.window_samples", 2.5, (f"{VELOCITY}.window_samples is 2.5", "1 to 200")),
        (
            f"{VELOCITY}.window",
            0.0155,
            (f"{VELOCITY}.window is 0.0155 s", "15.5 sampling", "0.015 s", "0.016 s"),
        ),
        (f"{POSITION}.window", 1e308, (f"{POSITION}.window is 1e+308 s", "200")),
        (
            VELOCITY,
            {"window": 0.02, "window_samples": 20},
            (f"{VELOCITY}.window is 0.02", "window_samples", "give one"),
        ),
        (
            VELOCITY,
            {},
            (f"{VELOCITY}.window_samples is missing", "cutoff", "factor", "numerator"),
        ),
        (VELOCITY, {"order": 2}, (f"{VELOCITY}.order is 2", "cutoff")),
        (
            VELOCITY,
            {"cutoff": 600.0, "kind": "butterworth"},
            (f"{VELOCITY}.cutoff is 600", "500 Hz"),
        ),
        (f"{VELOCITY}.preset", "chai", (f"{VELOCITY}.preset is 'chai'", "'chai3d'")),
        (
            f"{VELOCITY}.preset",
            "openhaptics",
            (f"{VELOCITY}.preset is 'openhaptics'", "does not document", "window", "cutoff"),
        ),
        (
            f"{VELOCITY}.numerator",
            [1.0, -1.0],
            (f"{VELOCITY}.numerator is (1.0, -1.0)", "denominator"),
        ),
        (POSITION, {"factor": 1.5}, (f"{POSITION}.factor is 1.5", "above 0 and at most 1")),
        ("wanted.safety", 1.5, ("wanted.safety is 1.5", "above 0 and at most 1")),
        ("walls", 3, ("walls is 3;", "[walls.NAME]")),
        ("walls.stiffness", 3.0, ("walls.stiffness is 3.0", "[walls.NAME]")),
        ("hand.stiffness", [200.0, 100.0], ("hand.stiffness is [200.0, 100.0]", "[100, 200]")),
        ("hand.mass", [0.0, math.inf], ("hand.mass is [0.0, inf]", ">= 0 in kg")),
        ("hand.mass", [1.0], ("hand.mass is [1.0]", "[lowest, highest]")),
        (
            "controller",
            {"sample_time": 1e-3, "delay": 1e-3, "delay_samples": 1.0},
            ("controller.delay is 0.001", "delay_samples", "give one"),
        ),
        (
            "controller",
            {"sample_time": 1e-3, "delay": 60.0},
            ("controller.delay is 60000 samples of 0.001 s", "500 samples", "delay_samples"),
        ),
        ("controller", {}, ("controller.sample_time is missing", "in s", "--sample-time")),
        ("device", {"damping": 0.1}, ("device.mass is missing", "in kg", "--mass", "--inertia")),
        ("wanted.measures", ["margin"], ("wanted.measures.0 is 'margin'", "'margins'")),
        ("wanted.measures", "margins", ("wanted.measures is 'margins'", "a list")),
    ],
)
def test_bad_input_is_named_with_its_value_and_what_is_allowed(
    path: str, value: Any, words: tuple[str, ...]
) -> None:
    assert_refuses(partial(Scene.from_table, with_value(path, value)), *words)


def test_a_whole_number_beyond_float64_is_refused_and_not_written_out() -> None:
    with pytest.raises(ValueError, match=r"^device.mass is 1\d*\.{3}\d*; give a finite number > 0"):
        Scene.from_table(with_value("device.mass", 10**400))


def test_a_file_that_is_no_toml_is_refused_by_name(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text("[device", encoding="utf-8")
    with pytest.raises(ValueError, match=r"scene.toml: this is not TOML"):
        Scene.from_file(file)


def test_a_file_may_begin_with_a_mark_of_utf_8_but_not_be_in_another_code(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(EXAMPLE, encoding="utf-8-sig")
    assert Scene.from_file(file).device.mass == (0.1, 0.1)
    file.write_text("# Prüfstand", encoding="latin-1")
    with pytest.raises(ValueError, match=r"scene.toml: line 1 is not UTF-8 text"):
        Scene.from_file(file)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("device.mass", 500.0, "device.mass is 500 kg"),
        ("controller.sample_time", 1.0, "controller.sample_time is 1 s"),
        ("walls.a", {"stiffness": 1e8, "damping": 1.0}, "walls.a.stiffness is 1e+08 N/m"),
        ("controller.delay", 0.4, "the delay is 400 samples; one in samples is given as"),
        ("controller.velocity", {"preset": "hapkit"}, "the preset 'hapkit' is meant for a sample"),
    ],
)
def test_a_scale_that_looks_like_a_slip_is_remarked_on(path: str, value: Any, words: str) -> None:
    unusual = Scene.from_table(with_value(path, value)).unusual()
    assert len(unusual) == 1
    assert unusual[0].startswith(words)


@pytest.mark.parametrize(("scale", "words"), [(1000.0, ""), (1.0, "has 0.001 of a velocity")])
def test_an_estimator_in_units_of_a_sample_is_called_unusual(scale: float, words: str) -> None:
    estimator = {"numerator": [0.1 * scale, -0.1 * scale], "denominator": [1.0, -0.9]}
    controller = {"sample_time": 1e-3, "velocity": estimator}
    table = {"device": {"mass": 0.25, "damping": 0.1}, "controller": controller}
    said = Scene.from_table(table).unusual()
    assert len(said) == bool(words)
    assert all(words in sentence for sentence in said)
