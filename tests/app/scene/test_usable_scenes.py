"""Margins in scenes: what limits, check and design say of usable gains, and what they refuse."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from commands import run

import jaxstab

SCENES = Path(__file__).parents[3] / "data" / "scenes"
SIMULATOR = str(SCENES / "gains" / "simulator.toml")


def asked(*words: str, code: int = 0) -> Any:
    done = run(*words, "--json")
    assert done.exit_code == code, done.output
    return json.loads(done.stdout)


def said(*words: str, code: int = 0) -> str:
    done = run(*words)
    assert done.exit_code == code, done.output
    return done.output


WALL = ("--mass", "0.25", "--damping", "0.1", "--rate", "1000", "--delay", "0.001")
LOOP = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3)


def test_limits_print_usable_pairs_beside_stable_ones() -> None:
    words = *WALL, "--sensitivity", "2", "--at-damping", "12"
    answer = asked("limits", *words)
    usable = answer["usable"]
    for gain, other in (("stiffness", "damping"), ("damping", "stiffness")):
        found = usable[gain]
        pair = {gain: found[f"largest_{gain}"], other: found[f"at_{other}"]}
        assert LOOP.is_usable(**pair, sensitivity=2)
        assert LOOP.is_usable(**pair | {gain: 1.01 * pair[gain]}, sensitivity=2) is False
        assert found["certainty"] == "with a peak of |S| of 2 at most"
    low, high = answer["usable_at_given_damping"]["stiffness_limits"]
    assert low == 0.0
    assert LOOP.is_usable(0.9999 * high, 12.0, sensitivity=2)
    assert LOOP.is_usable(1.0001 * high, 12.0, sensitivity=2) is False
    assert high < answer["at_given_damping"]["stiffness_limits"][1]
    text = said("limits", *words)
    row = re.search(r"largest usable stiffness +(.*) N/m at (.*) N s/m, with a peak", text)
    assert row, text
    assert LOOP.is_usable(float(row[1]), float(row[2]), sensitivity=2)


def test_a_check_says_which_margins_a_wall_misses() -> None:
    gains = "--gains", "1500", "20"
    phase = LOOP.frequency_margins(1500.0, 20.0).phase.value
    has = f"{phase - 0.01:.4f}"
    lacks = f"{phase + 0.01:.4f}"
    assert f"has a phase margin of {float(has):g} degrees" in said(
        "check", *WALL, *gains, "--phase-margin", has
    )
    words = said("check", *WALL, *gains, "--phase-margin", lacks, "--gain-margin", "1.2", code=1)
    assert f"misses a phase margin of {float(lacks):g} degrees\n" in words
    assert (
        asked("check", *WALL, *gains, "--phase-margin", lacks, code=1)["walls"]["gains"]["verdict"]
        == "stable"
    )


def test_pairs_of_other_gains_have_margins_too() -> None:
    joint = jaxstab.simulated_pd(
        0.1, step=2e-3, damping=0.5, substeps=4, integrator="implicit-joint"
    )
    words = "check", SIMULATOR, "--sensitivity"
    peak = joint.frequency_margins(kp=300.0, kd=10.0).sensitivity.value
    assert "has a peak of |S|" in said(*words, f"{1.001 * peak:.6f}", code=1)  # stiff is unstable
    assert "misses a peak of |S|" in said(*words, f"{0.999 * peak:.6f}", code=1)


@pytest.mark.campaign
def test_limits_and_designs_of_other_gains_have_margins_too() -> None:
    joint = jaxstab.simulated_pd(
        0.1, step=2e-3, damping=0.5, substeps=4, integrator="implicit-joint"
    )
    found = asked("limits", SIMULATOR, "--phase-margin", "45", code=1)["usable"]["kp"]
    assert joint.is_usable(kp=found["largest_kp"], kd=found["at_kd"], phase_margin=45)
    assert (
        joint.is_usable(kp=1.01 * found["largest_kp"], kd=found["at_kd"], phase_margin=45) is False
    )
    wanted = "--phase-margin", "45", "--set", "wanted.kp=300"
    step = asked("design", SIMULATOR, *wanted)["step"]
    slower = jaxstab.simulated_pd(
        0.1, step=step["largest_step"], damping=0.5, substeps=4, integrator="implicit-joint"
    )
    assert slower.is_usable(kp=300.0, kd=step["at_kd"], phase_margin=45)
    slowest = jaxstab.simulated_pd(
        0.1, step=1.02 * step["largest_step"], damping=0.5, substeps=4, integrator="implicit-joint"
    )
    assert slowest.limits(phase_margin=45).first < 300.0


@pytest.mark.campaign
def test_the_fastest_walls_are_those_with_the_margins_as_printed() -> None:
    answer = asked("tune", *WALL, "--phase-margin", "45", "--at-stiffness", "500")
    for own in (answer["least_settling"], answer["least_radius"], answer["at_given_stiffness"]):
        for wall in (own, own["rounded"]):
            assert LOOP.is_usable(wall["stiffness"], wall["damping"], phase_margin=45)
    text = said("tune", *WALL, "--phase-margin", "45")
    assert re.search(r"margins wanted +a phase margin of 45 degrees", text)
    assert f"{answer['least_settling']['rounded']['stiffness']:g} N/m" in text


@pytest.mark.campaign
def test_a_sample_time_is_designed_for_a_usable_stiffness() -> None:
    answer = asked("design", *WALL, "--stiffness", "400", "--sensitivity", "2")
    delay = answer["delay"]
    later = jaxstab.HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=delay["largest_delay"]
    )
    assert later.is_usable(400.0, delay["at_damping"], sensitivity=2)
    assert answer["certainty"] == "with a peak of |S| of 2 at most"


def test_a_picture_fills_the_usable_walls(tmp_path: Path) -> None:
    from jaxstab.app.pictures.scene import scene_figure
    from jaxstab.app.scene import Scene

    tables = {
        "device": {"mass": 0.25, "damping": 0.1},
        "controller": {"sample_time": 1e-3, "delay": 1e-3},
        "wanted": {"sensitivity": 2.0},
    }
    panel = scene_figure(Scene.from_table(tables)).axes[0]
    (filled,) = (c for c in panel.collections if "peak of |S|" in str(c.get_label()))
    corners = [tuple(corner) for path in filled.get_paths() for corner in path.vertices[:4]]
    assert len(corners) > 100
    for stiffness, damping in corners[:: len(corners) // 12]:
        if stiffness > 0.0 and damping > 0.0:
            assert LOOP.is_usable(0.999 * stiffness + 1e-6, damping, sensitivity=2)
    stiffest = max(stiffness for stiffness, _ in corners)
    assert stiffest > 0.98 * LOOP.limits(sensitivity=2).first


@pytest.mark.parametrize(
    ("command", "words", "sentence"),
    [
        ("limits", ["--phase-margin", "200"], "wanted.phase_margin is 200.0"),
        ("limits", ["--phase-margin", "0"], "wanted.phase_margin is 0.0"),
        ("limits", ["--gain-margin", "1"], "give a factor > 1, such as 2"),
        ("limits", ["--gain-margin", "2:1"], "wanted.gain_margin is [2.0, 1.0]"),
        ("limits", ["--sensitivity", "1"], "wanted.sensitivity is 1.0"),
        ("check", ["--delay-margin", "0"], "wanted.delay_margin is 0.0"),
        ("limits", ["--phase-margin", "30", "--safety", "0.5"], "beside phase_margin"),
        ("limits", ["--phase-margin", "30", "--delay", "0:0.001"], "beside a range of delays"),
        ("check", ["--phase-margin", "30", "--delay", "0:0.001"], "a check of phase_margin"),
        (
            "design",
            ["--phase-margin", "30", "--stiffness", "500", "--hand-mass", "0:0.2"],
            "beside a range of hands",
        ),
        ("tune", ["--phase-margin", "30", "--hand-mass", "0:0.2"], "beside a range of hands"),
        ("tune", ["--phase-margin", "30", "--delay", "0:0.001"], "a search for phase_margin"),
    ],
)
def test_margins_that_have_no_answer_are_refused(
    command: str, words: list[str], sentence: str
) -> None:
    given = [*WALL, *words]
    if "--delay" in words:
        given = [*WALL[:-2], *words]
    if command == "check":
        given += ["--gains", "500", "5"]
    text = said(command, *given, code=2)
    assert sentence in " ".join(text.split())


def test_gains_of_a_loop_are_tuned_without_margins() -> None:
    assert "are tuned without margins" in said("tune", SIMULATOR, "--phase-margin", "30", code=2)
