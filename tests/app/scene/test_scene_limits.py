"""What a scene's answers say of its estimator, of islands, of safety, and of devices that turn."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from commands import run

from jaxstab.app.pictures.scene import scene_figure
from jaxstab.app.scene import Scene, check_walls, loop_of, scene_limits
from jaxstab.app.scene.limits import inwards
from jaxstab.conventions import Verdict
from jaxstab.loop import HapticLoop
from jaxstab.model import Velocity

ROOT = Path(__file__).parents[3]
OMEGA = ["--device", "omega", "--sample-time", "0.001", "--delay-samples", "1"]
SDK = [*OMEGA, "--estimator", "force-dimension-sdk"]
LARGEST = {1: 36167.0, 2: 24520.0, 5: 11290.0, 10: 5155.0, 15: 3036.0, 20: 2032.0}
# N/m, from grids of certified roots, before this program took estimators


def answered(*arguments: str | Path, code: int = 0) -> Any:
    result = run(*arguments, "--json")
    assert result.exit_code == code, result.stderr
    return json.loads(result.stdout)


def test_a_scene_without_an_estimator_says_first_which_one_was_assumed() -> None:
    for command in (["limits"], ["check", "--wall", "a", "100", "5"]):
        first = run(*command, *OMEGA).stdout.splitlines()[0]
        assert re.match(r"velocity estimator +the difference over one sample \(assumed: ", first)
    named = run("limits", *SDK).stdout.splitlines()[0]
    assert "a window of 0.02 s (preset force-dimension-sdk, assumed in part)" in named
    other = run("limits", *SDK, "--window", "0.01").stdout.splitlines()[0]
    assert "0.01 s (preset force-dimension-sdk, with another window)" in other
    assert run("limits", *OMEGA, "--window-samples", "1").stdout.count("assumed") == 0


def test_the_numbers_of_the_readme_are_those_of_its_scene() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    omega = ROOT / "data" / "scenes" / "omega.toml"
    for options, stated, code in (  # the wall of CHAI3D is outside of the first one
        ((), "2,034 N/m", 1),
        (("--window-samples", "1"), "36,168 N/m", 0),
    ):
        best = answered("limits", omega, *options, code=code)["best"]["largest_stiffness"]
        assert stated in text
        number = float(stated.removesuffix(" N/m").replace(",", ""))
        assert best <= number < 1.001 * best


def test_a_file_is_answered_with_its_estimator_once_and_first(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    text = '[device]\npreset = "omega"\n[controller]\nsample_time = 0.001\n'
    file.write_text(
        text + "velocity.cutoff = 100.0\nposition.window_samples = 2\n"
        "[walls.a]\nstiffness = 100.0\ndamping = 5.0\n"
    )
    lines = run("check", file).stdout.splitlines()
    assert re.match(
        r"velocity estimator +the difference over one sample, a low pass at 100 Hz", lines[0]
    )
    assert re.match(r"position filter +a window of 2 samples", lines[1])
    assert sum(line.startswith("velocity") for line in lines) == 1


@pytest.mark.parametrize("samples", LARGEST)
def test_limits_are_those_of_the_estimator(samples: int) -> None:
    best = answered("limits", *OMEGA, "--window-samples", str(samples))["best"]
    assert best["largest_stiffness"] == pytest.approx(LARGEST[samples], rel=2e-3)


def test_beside_the_limits_without_an_estimator_stands_what_windows_would_leave() -> None:
    limits = answered("limits", *OMEGA)
    for samples in (10, 20):
        other = answered("limits", *OMEGA, "--window-samples", str(samples))
        assert limits["windows"][str(samples)] == other["best"]
        assert "windows" not in other


def test_simple_rules_of_the_one_sample_difference_are_left_out_for_others() -> None:
    without = answered("limits", *OMEGA)
    limits = answered("limits", *SDK, "--at-damping", "10")
    assert "linear_rule" in without
    assert "linear_rule" not in limits
    wall = limits["passive"]
    device = {"device_mass": 0.25, "device_damping": 0.1, "sample_time": 1e-3, "delay": 1e-3}
    loop = HapticLoop(**device, velocity=Velocity.difference(window=0.02))
    assert loop.is_passive(wall["largest_stiffness"], wall["at_damping"])
    assert loop.is_passive(1.002 * wall["largest_stiffness"], wall["at_damping"]) is False
    assert "linear_rule_stiffness" not in limits["at_given_damping"]


@pytest.mark.campaign
def test_islands_are_named_as_not_reachable_and_drawn() -> None:
    free = ["--mass", "1", "--damping", "0", "--sample-time", "1", "--window-samples", "10"]
    island = answered("limits", *free)["islands"]["1"]
    # (0.2734, -0.704) is stable, by a recursion in 60 digits, and no neighbour of 0.
    assert island["largest_stiffness"] > 0.2734
    assert island["largest_damping"] > -0.704
    assert "island 1 " not in run("limits", *free).stdout
    (line,) = (
        one for one in run("limits", *free, "--islands").stdout.splitlines() if "island" in one
    )
    assert line.endswith("isolated: not connected to zero gains")
    scene = Scene.from_table(
        {
            "device": {"mass": 0.25, "damping": 0.1},
            "controller": {"sample_time": 1e-3, "velocity": {"window_samples": 10}},
        }
    )
    assert all(island.at_damping < 0.0 for island in scene_limits(scene).islands.values())
    assert len(scene_figure(scene).axes) == 1  # no wall of an engineer's is on an island
    held = {"device": {"mass": 0.08, "damping": 0.1}, "hand": {"stiffness": 185.0, "damping": 2.9}}
    held |= {"controller": {"sample_time": 1e-3, "velocity": {"window_samples": 20}}}
    scene = Scene.from_table(held)
    assert scene_limits(scene).in_short().splitlines()[-1].endswith("see --islands")
    figure = scene_figure(scene)
    assert [panel.get_title() for panel in figure.axes] == ["Stable walls", "with islands"]
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert "stable, not connected to zero gains" in labels
    assert not any("linear" in label or "passive" in label for label in labels)


@pytest.mark.campaign
def test_what_is_tuned_is_compared_with_what_gains_reach_when_they_are_turned_up() -> None:
    best = answered("tune", *SDK)["least_radius"]
    largest = answered("limits", *SDK)["best"]["largest_stiffness"]
    assert best["share_of_largest"] == pytest.approx(best["stiffness"] / largest)


def test_a_scene_is_explained_with_a_diagram_and_its_numbers() -> None:
    explained = run("scene", "explain", ROOT / "data" / "scenes" / "teleoperation.toml").stdout
    assert explained.startswith("  push of the hand")
    assert re.search(r"(?m)^delay +12.35 ms \(12.35 samples\)$", explained)
    assert re.search(r"(?m)^hand +0.5 kg, 200 N/m, 3 N s/m$", explained)
    assert re.search(r"(?m)^ +excludes: the zero-order hold", explained)
    assert re.search(r"(?m)^outside ", explained)


def test_safety_moves_all_limits_inwards() -> None:
    plain = answered("limits", *OMEGA, "--at-damping", "100", "--at-stiffness", "1000")
    safe = answered(
        "limits", *OMEGA, "--at-damping", "100", "--at-stiffness", "1000", "--safety", "0.8"
    )
    assert safe["safety"] == 0.8
    for whole, part in ((plain, safe), (plain["windows"], safe["windows"])):
        for name in {"best", "passive", "linear_rule", "20"} & {*whole}:
            scaled = 0.8 * whole[name]["largest_stiffness"]
            assert part[name]["largest_stiffness"] == pytest.approx(scaled, rel=2e-3)
    # Reached without a spring, where a gain of exactly 0 is at the edge of the region.
    scaled = 0.8 * plain["most_damped"]["largest_damping"]
    assert safe["most_damped"]["largest_damping"] == pytest.approx(scaled, rel=2e-3)
    for name, key in (("at_given_damping", "stiffness"), ("at_given_stiffness", "damping")):
        low, high = plain[name][f"{key}_limits"]
        scaled = [low / 0.8 if low > 0.0 else low * 0.8, 0.8 * high]
        assert safe[name][f"{key}_limits"] == pytest.approx(scaled, rel=1e-12)


def test_intervals_of_any_sign_move_inwards_or_vanish() -> None:
    assert inwards(-1.0, 2.0, 0.5) == (-0.5, 1.0)
    assert inwards(1.0, 8.0, 0.5) == (2.0, 4.0)
    assert inwards(-8.0, -1.0, 0.5) == (-4.0, -2.0)
    assert np.all(np.isnan(inwards(1.0, 2.0, 0.5)))


def test_the_safe_wall_for_all_hands_is_proved_anew() -> None:
    scene: dict[str, Any] = {
        "device": {"preset": "omega"},
        "controller": {"sample_time": 1e-3, "delay_samples": 1.0},
        "hand": {"mass": [0.0, 0.2], "stiffness": [0.0, 100.0]},
    }
    plain, safe = (
        scene_limits(Scene.from_table(scene | {"wanted": wanted})).all_hands
        for wanted in ({}, {"safety": 0.8})
    )
    assert plain is not None
    assert safe is not None
    assert safe.certainty == "proved for every hand"
    assert safe.largest_stiffness == pytest.approx(0.8 * plain.largest_stiffness, rel=2e-3)


@pytest.mark.campaign
def test_a_design_with_safety_is_one_for_a_stiffer_wall() -> None:
    safe = answered("design", *OMEGA, "--stiffness", "1000", "--safety", "0.5")
    plain = answered("design", *OMEGA, "--stiffness", "2000")
    assert safe["now_allowed_stiffness"] == pytest.approx(
        0.5 * plain["now_allowed_stiffness"], rel=2e-3
    )
    assert {name: safe[name] for name in ("sample_time", "delay")} == {
        name: plain[name] for name in ("sample_time", "delay")
    }


@pytest.mark.campaign
def test_a_design_keeps_whole_windows() -> None:
    def allowed(samples: int) -> float:
        period = 0.02 / samples
        loop = HapticLoop(
            device_mass=0.25,
            device_damping=0.1,
            sample_time=period,
            delay=period,
            velocity=Velocity.difference(samples),
        )
        return loop.limits().stiffness

    design = answered("design", *SDK, "--stiffness", "2000")
    period = design["sample_time"]["largest_sample_time"]
    samples = round(0.02 / period)
    assert period == 0.02 / samples
    assert allowed(samples - 1) < 2000.0 <= allowed(samples)


TURNING = {
    "device": {"inertia": 0.01, "damping": 0.05},
    "hand": {"inertia": [0.0, 0.02]},
    "controller": {"sample_time": 1e-3, "delay_samples": 1.0},
    "walls": {"a": {"stiffness": 100.0, "damping": 1.0}},
    "wanted": {"measures": ["radius"]},
}


def test_a_device_that_turns_has_the_numbers_of_one_that_moves_along_a_line() -> None:
    along = TURNING | {"device": {"mass": 0.01, "damping": 0.05}, "hand": {"mass": [0.0, 0.02]}}
    turning, line = Scene.from_table(TURNING), Scene.from_table(along)
    limits, same = scene_limits(turning), scene_limits(line)
    assert limits.best == same.best
    assert limits.all_hands == same.all_hands
    assert check_walls(turning).walls == check_walls(line).walls


@pytest.mark.campaign
def test_a_device_that_turns_is_answered_and_drawn_in_units_of_rotation() -> None:
    scene = Scene.from_table(TURNING)
    checked = check_walls(scene)
    for answer in (scene_limits(scene), checked):
        words = str(answer)
        assert "motion                            rotation" in words
        assert "N m/rad" in words
        assert "inertia" in words
        assert not re.search(r"N/m|N s/m|\bkg$|\bmass\b", words, re.MULTILINE)
    assert check_walls(scene).as_json()["walls"]["a"]["worst_hand"].keys() >= {
        "inertia",
        "stiffness",
    }
    turned = TURNING | {
        "device": {"inertia": 0.01, "damping": 0.05, "encoder": {"resolution": 1e-4}}
    }
    chatter = str(check_walls(Scene.from_table(turned | {"wanted": {"measures": ["chatter"]}})))
    assert re.search(r"chatter at most +[-.e\d]+ [um]?rad\n.* N m\n.* N m", chatter)
    axes = scene_figure(scene, checked).axes
    assert axes[0].get_xlabel() == "stiffness K (N m/rad)"
    assert axes[0].get_ylabel() == "damping B (N m s/rad)"


def test_limits_around_a_wall_are_those_of_the_interval_that_it_is_in() -> None:
    """At a damping of 2 N s/m walls of 0 to 900 N/m and, far above them, others are stable."""
    table: dict[str, Any] = {
        "device": {
            "mass": 0.25,
            "damping": 0.1,
            "actuator": {"bandwidth": 200.0},
            "modes": [{"frequency": 80.0, "damping_ratio": 0.02, "modal_mass": 1.5}],
        },
        "hand": {"mass": 0.2, "damping": 0.5, "grip": {"stiffness": 2000.0, "damping": 4.0}},
        "controller": {
            "sample_time": 1e-3,
            "delay_samples": 1.0,
            "velocity": {"window_samples": 20},
        },
        "walls": {"low": {"stiffness": 100.0, "damping": 2.0}},
    }
    scene = Scene.from_table(table)
    low, high = scene_limits(scene).walls["low"].stiffness_limits
    loop = loop_of(scene)
    assert low <= 100.0 <= high < 3000.0
    assert loop.verdict(0.999 * high, 2.0) == Verdict.STABLE
    assert loop.verdict(1.001 * high, 2.0) == Verdict.UNSTABLE
    farthest = float(loop.stiffness_limits(2.0)[1])
    assert farthest > 1.2 * high
    assert loop.verdict(0.999 * farthest, 2.0) == Verdict.STABLE


def test_the_hand_that_limits_are_of_stands_before_them_and_the_linear_rule_is_no_limit() -> None:
    arguments = ["limits", *OMEGA, "--hand-mass", "0:0.2"]
    lines = run(*arguments, "--all").stdout.splitlines()
    assert re.match(r"hand +at its lowest values \(all hands: see below\)$", lines[2])
    assert lines[3] == "stiffest wall"
    *_, largest, every, _passive = run(*arguments).stdout.splitlines()
    assert re.match(r"largest stiffness +\d+ N/m at .* N s/m, hand at its lowest values$", largest)
    assert re.match(r"for all hands +\d+ N/m at .*, proved for every hand$", every)
    rule = answered("limits", *OMEGA)["linear_rule"]
    best = answered("limits", *OMEGA)["best"]
    share = rule["largest_stiffness"] / best["largest_stiffness"]
    assert rule["linear_rule_is"].endswith(f"here {share:.2g} times the exact limit")


# ------------------------------------------------------------------------ rows of several intervals

TWO_INTERVALS = {
    "device": {
        "mass": 0.075,
        "damping": 0.3,
        "modes": [{"frequency": 190.0, "damping_ratio": 0.05, "modal_mass": 0.2}],
    },
    "controller": {"sample_time": 25e-6, "delay_samples": 1.0},
    "walls": {"firm": {"stiffness": 1e5, "damping": 0.0}},
}


def radius_without_damping(stiffness: float) -> float:
    """The radius of the loop of ``TWO_INTERVALS`` at B = 0, from matrices of this test."""
    w, (m, b, moved, period) = 2.0 * np.pi * 190.0, (0.075, 0.3, 0.2, 25e-6)
    rates = np.zeros((5, 5))  # both shares of the position, their speeds, and the force
    rates[0:2, 2:4] = np.eye(2)
    rates[2, 2], rates[3, 1], rates[3, 3] = -b / m, -(w**2), -0.1 * w
    rates[2:4, 4] = 1.0 / m, 1.0 / moved
    step = scipy.linalg.expm(rates * period)
    step[4] = [-stiffness, -stiffness, 0.0, 0.0, 0.0]  # the next force, a sample late
    return float(np.abs(np.linalg.eigvals(step)).max())


def test_all_intervals_of_stable_stiffness_are_named_small_gains_first() -> None:
    """Unstable walls lie before the far one, so it is not printed alone."""
    scene = Scene.from_table(TWO_INTERVALS | {"wanted": {"at_damping": 0.0}})
    answer = scene_limits(scene)
    said = answer.in_short()
    assert "stable stiffness    0 to 9416 N/m at 0 N s/m, also 42190 to 120600 N/m" in said
    # The wall is in the other one, which comes first for it.
    assert "within the stable range of 42190 to 120600 N/m, also 0 to 9416 N/m" in said
    at = answer.as_json()["at_given_damping"]
    first, second = at["stiffness_limits"], at["other_stiffness"]["1"]
    assert first[0] == 0.0
    for end, outwards in ((first[1], 1), (second[0], -1), (second[1], 1)):
        assert radius_without_damping(end * (1.0 + 1e-6 * outwards)) > 1.0
        assert radius_without_damping(end * (1.0 - 1e-6 * outwards)) < 1.0
    for stiffness in np.linspace(10.0, 2e5, 400).tolist():
        is_inside = any(low < stiffness < high for low, high in (first, second))
        assert (radius_without_damping(stiffness) < 1.0) == is_inside


def test_a_wall_within_the_range_of_the_lowest_hand_says_where_another_hand_makes_it_unstable() -> (
    None
):
    scene = ROOT / "data" / "scenes" / "collision.toml"
    done = run("limits", str(scene))
    assert done.exit_code == 1
    within, free_only = done.stdout.splitlines()[-2:]
    assert within.endswith("within the stable range of 0 to 3401 N/m")
    assert free_only.endswith("to 62220 N/m; unstable for some hand: see jaxstab check")
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, hand_stiffness=987e3, sample_time=1e-3)
    assert max(np.abs(loop.poles(20000.0, 50.0))) > 1.0  # of eigenvalues
    assert "exception" in answered("limits", scene, code=1)["walls"]["free_only"]


def test_a_designed_sample_time_is_printed_so_that_a_window_in_seconds_divides_it() -> None:
    said = run("design", str(ROOT / "data" / "scenes" / "omega.toml"), "--stiffness", "3000").stdout
    (text,) = re.findall(r"largest sample time +(\S+) us", said)
    period = float(text) * 1e-6
    assert 0.02 / period == pytest.approx(50.0, rel=1e-12)
    limits = answered("limits", *SDK, "--sample-time", f"{period!r}")  # which refuses others
    assert limits["best"]["largest_stiffness"] > 3000.0


@pytest.mark.parametrize("safety", [0.5, 0.8])
def test_a_limit_with_a_safety_is_a_stable_wall(safety: float) -> None:
    """Below the narrow tip of a region the damping of the tip is not stable."""
    mass, period, cutoff = 0.1, 1e-3, 50.0
    own = ["--mass", str(mass), "--damping", "0", "--sample-time", str(period)]
    own += ["--delay-samples", "1", "--window-samples", "1"]
    filter_ = f'controller.position={{ cutoff = {cutoff}, order = 2, kind = "butterworth" }}'
    whole, part = (
        answered("limits", *own, "--set", filter_, *more)["best"]
        for more in ((), ("--safety", str(safety)))
    )
    above, below = scipy.signal.butter(2, 2.0 * cutoff * period)
    base = np.polymul([1, -2, 1, 0, 0], below)  # (z - 1)^2 z z, the last one of the velocity

    def radius(stiffness: float, damping: float) -> float:
        wall = np.polyadd(
            stiffness * np.r_[above, 0.0], damping / period * np.polymul([1, -1], below)
        )
        moved = period**2 / (2.0 * mass) * np.polymul([1, 1], wall)
        return float(np.max(np.abs(np.roots(np.polyadd(base, moved)))))

    limit, damping = whole["largest_stiffness"], whole["at_damping"]
    assert radius(1.0001 * limit, damping) > 1.0
    assert radius(safety * limit, damping) > 1.0
    assert part["largest_stiffness"] == pytest.approx(safety * limit, rel=1e-3)
    assert radius(part["largest_stiffness"], part["at_damping"]) < 1.0
    text = run("limits", *own, "--set", filter_, "--safety", str(safety)).stdout
    printed = re.search(r"largest stiffness +(\S+) N/m at (\S+) N s/m", text)
    assert printed is not None
    stiffness, beside = map(float, printed.groups())
    assert [stiffness, beside] == [part["largest_stiffness"], part["at_damping"]]
