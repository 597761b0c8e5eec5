"""Scenes whose delay is a range: one that moves, or one that is constant and not known."""

import csv
import io
import json
import re
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import assert_one_sentence, assert_refuses, run
from scipy.signal import butter, cont2discrete

from jaxstab import HapticLoop
from jaxstab.answers import GainAnswer
from jaxstab.app.pictures.scene import scene_figure
from jaxstab.app.scene import Scene, check_walls, loop_of, scene_limits, tune_walls
from jaxstab.app.scene.loops import corner_loops, with_tolerances
from jaxstab.conventions import Verdict
from tests.truth.loop import spectral_radius
from tests.truth.moving import LOST, Moving, growth

T = 1e-3
LIGHT = ["--mass", "0.1", "--damping", "0.05", "--sample-time", "0.001"]
SOFT = ["--wall", "soft", "6669.1", "71.6"]  # stable for each constant delay from 0 to 1 ms
MOVING = [*LIGHT, "--delay", "0:0.001"]
CAMPAIGN = pytest.mark.campaign
TRUTH = Moving((1.0,), (0.1, 0.05, 0.0), T)
DEVICE: dict[str, Any] = {"mass": 0.1, "damping": 0.05}


def scene(device: dict[str, Any] = DEVICE, **controller: Any) -> dict[str, Any]:
    return {"device": device, "controller": {"sample_time": T, **controller}}


def written(folder: Path, delay: str) -> Path:
    """Return the file of a scene of the light device, with lines for its delay."""
    file = folder / "scene.toml"
    text = "[device]\nmass = 0.1\ndamping = 0.05\n[controller]\nsample_time = 0.001\n"
    file.write_text(f"{text}{delay}\n", encoding="utf-8")
    return file


def answered(*arguments: str | Path, code: int = 0) -> Any:
    result = run(*arguments, "--json")
    assert result.exit_code == code, result.stderr
    return json.loads(result.stdout)


def limits_of(table: dict[str, Any]) -> GainAnswer:
    answer = scene_limits(Scene.from_table(table))
    assert isinstance(answer, GainAnswer)
    return answer


def true_radius(stiffness: float, damping: float, samples: float) -> float:
    """Return the certified spectral radius of the light device at a constant delay."""
    alpha, beta, delta = stiffness * T**2 / 0.1, damping * T / 0.1, 0.05 * T / 0.1
    return float(spectral_radius(alpha, beta, 0.0, delta, samples)[1])


# ---------------------------------------------------------------------------- what is refused
CONSTANT = {"delay": 1e-3}, {"delay": [0.0, 1e-3], "delay_is": "constant"}, {}


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        ({"delay": [1e-3, 0.0]}, ("delay is [0.001, 0.0]", "swapped", "[0, 0.001]")),
        ({"delay": []}, ("delay is []", ">= 0 in s", "[lowest, highest]")),
        ({"delay": [0.0, 1e-3, 2e-3]}, ("delay is [0.0, 0.001, 0.002]", "[lowest, highest]")),
        ({"delay_samples": [-1.0, 1.0]}, ("delay_samples is [-1.0, 1.0]", ">= 0 in samples")),
        (
            {"delay": [0.0, 1e-3], "delay_samples": 1.0},
            ("delay is 0 to 0.001", "beside delay_samples"),
        ),
        (
            {"delay": [0.0, 1e-3], "delay_is": "fixed"},
            ("delay_is is 'fixed'", "moving", "constant"),
        ),
        ({"delay": [0.0, 1e-3], "lost_samples": 0.5}, ("lost_samples is 0.5", "0 to 500")),
        ({"delay": [0.0, 1e-3], "lost_samples": -1}, ("lost_samples is -1", "0 to 500")),
        *(
            (delay | {"lost_samples": 1}, ("lost_samples is 1", "constant", 'delay_is = "moving"'))
            for delay in CONSTANT
        ),
        (
            {"delay_samples": [0.0, 499.5], "lost_samples": 1},
            ("delay is 499.5 samples of 0.001 s", "1 are lost", "500 samples", "delay_samples"),
        ),
    ],
)
def test_bad_ranges_of_delays_are_refused(
    controller: dict[str, Any], words: tuple[str, ...]
) -> None:
    assert_refuses(partial(Scene.from_table, scene(**controller)), *words)


def test_a_picture_of_several_scenes_is_of_one_delay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for file in ("a.toml", "b.toml"):
        Path(file).write_text("[device]\ndamping = 0.05\n", encoding="utf-8")
    arguments = ["check", "a.toml", "b.toml", *SOFT, "--plot", "picture.png"]
    for options in ([], ["--constant-delay"], ["--lost-samples", "2"]):
        refused = run(*arguments, *MOVING, *options)
        assert refused.exit_code == 2
        assert refused.stdout == ""
        assert_one_sentence(refused.stderr)
        what = "but a picture is for one constant delay; give one, such as --delay"
        assert what in refused.stderr
    remedy = refused.stderr.split("such as ")[1].strip().strip(".").split()
    assert remedy == ["--delay", "0.001", "--lost-samples", "0"]
    answer = run(*arguments, *LIGHT, *remedy)
    assert answer.exit_code in (0, 1)


@pytest.mark.campaign
def test_pictures_are_of_one_delay_or_of_one_that_moves(tmp_path: Path) -> None:
    file = tmp_path / "picture.png"
    refused = run("check", *MOVING, *SOFT, "--constant-delay", "--plot", file)
    assert refused.exit_code == 2
    assert "but a picture is for one constant delay; give one" in refused.stderr
    assert not file.exists()
    assert run("limits", *MOVING, *SOFT, "--plot", file).exit_code == 1  # a wall is unstable
    assert file.stat().st_size > 10_000


@pytest.mark.campaign
def test_the_picture_of_a_moving_delay_has_its_walls_in_its_units() -> None:
    turning = scene({"inertia": 0.1, "damping": 0.05}, delay=[0.0, T])
    turning["walls"] = {"soft": {"stiffness": 500.0, "damping": 5.0}}
    figure = scene_figure(Scene.from_table(turning))
    (panel,) = figure.axes
    assert panel.get_xlabel() == "stiffness K (N m/rad)"
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [
        "stable for every sequence of delays, sampled",
        "stiffest proved for every sequence, at some dampings",
        "unstable for some sequence, proved",
        "wall, stable",
    ]
    proved = np.asarray(panel.lines[0].get_xydata())
    assert len(proved) > 12
    motions = [
        TRUTH.positions(*wall, np.tile([[0, 8, 8, 8], [0, 0, 0, 8], [8, 8, 8, 8]], 500))
        for wall in proved[::3]
    ]
    assert all(np.all(growth(motion, 4) < 1.0) for motion in motions)
    assert "delay varies between 0 and 1 ms" in figure.get_suptitle()


def test_an_atlas_refuses_a_delay_that_moves(tmp_path: Path) -> None:
    for more in ("delay = [0.0, 0.001]", "delay = 0.001\ndelay_is = 'moving'\nlost_samples = 1"):
        refused = run("atlas", "spec", "--scene", written(tmp_path, more))
        assert refused.exit_code == 2
        assert_one_sentence(refused.stderr)
        assert "and moves, but this answer is for constant delays; give delay_is" in refused.stderr
    constant = written(tmp_path, "delay = [0.0, 0.001]\ndelay_is = 'constant'")
    assert run("atlas", "spec", "--scene", constant).exit_code == 0


def test_limits_at_given_gains_are_refused_for_a_range_of_delays() -> None:
    for name in ("at-damping", "at-stiffness"):
        refused = run("limits", *MOVING, f"--{name}", "10")
        assert refused.exit_code == 2
        key = name.replace("-", "_")
        assert f"wanted.{key} is 10 beside a range of delays; leave it out" in refused.stderr


# ------------------------------------------------------------------------------ what is read
def test_a_delay_is_one_number_or_two_and_says_what_it_is() -> None:
    def controller(**keys: Any) -> Any:
        return Scene.from_table(scene(**keys)).controller

    one = controller(delay=2e-3)
    assert (one.has_one_delay, one.moves, one.time_delay, one.samples) == (True, False, 2e-3, 2.0)
    assert controller(delay=2e-3, delay_is="constant").has_one_delay
    for moving in (controller(delay=[1e-3, 2e-3]), controller(delay_samples=[1.0, 2.0])):
        assert (moving.moves, moving.delays, moving.samples) == (True, (1e-3, 2e-3), 2.0)
    unknown = controller(delay=[1e-3, 2e-3], delay_is="constant")
    assert (unknown.moves, unknown.has_one_delay) == (False, False)
    lossy = controller(delay=1e-3, delay_is="moving", lost_samples=2)
    assert (lossy.moves, lossy.delays, lossy.lost_samples) == (True, (1e-3, 1e-3), 2)


def test_options_replace_the_delay_of_a_file(tmp_path: Path) -> None:
    file = written(tmp_path, "delay = [0.0, 0.001]\ndelay_is = 'constant'")
    inputs = answered("limits", file)["inputs"]
    assert inputs["delay_is"].startswith("is constant, somewhere between 0 and 1 ms; ")
    moving = answered("limits", file, "--delay", "0:0.0005", "--lost-samples", "1")["inputs"]
    assert moving["delay"] == [0.0, 0.0005]
    assert moving["lost_samples"] == 1
    assert moving["delay_is"] == (
        "varies between 0 and 500 us; the most recent sample that has arrived is used, up to 1 in "
        "a row are lost; verdicts cover every sequence"
    )
    assert "delay_is" not in answered("limits", file, "--delay", "0.001")["inputs"]


def test_a_delay_that_is_given_beside_a_file_stays_constant(tmp_path: Path) -> None:
    file = written(tmp_path, "delay = [0.0, 0.001]\ndelay_is = 'constant'")
    for delay in (["--delay", "0.0:0.0005"], ["--delay-samples", "0:2"], ["--delay", "0.0005"]):
        assert "varies" not in run("limits", file, *delay).stdout
    text = run("limits", file, "--delay", "0.0:0.0005").stdout
    assert "verdicts cover every constant delay" in text


def test_samples_may_be_lost_of_a_delay_that_is_otherwise_constant() -> None:
    lossy = limits_of(scene(delay=T, delay_is="moving", lost_samples=1))
    assert lossy.inputs is not None
    assert lossy.inputs.delay == T
    assert lossy.inputs.delay_is == (
        "is 1 ms; the most recent sample that has arrived is used, up to 1 in a row are lost; "
        "verdicts cover every sequence"
    )
    wall = lossy.best.largest_stiffness, lossy.best.at_damping
    random = np.random.default_rng(5)
    turns = np.full((60, 12), TRUTH.parts)
    turns[:, ::2] = np.where(random.random((60, 6)) < 0.5, LOST, TRUTH.parts)
    assert np.all(growth(TRUTH.positions(*wall, np.tile(turns, (1, 120))), 12) < 1.0)


# -------------------------------------------------------------------------------- the answers
@pytest.mark.parametrize("command", ["limits", "check"])
def test_the_range_of_delays_stands_first_with_what_is_proved(command: str) -> None:
    wall = ["--wall", "soft", "500", "5"]
    for options, words in (
        (
            [],
            " the delay varies between 0 and 1 ms; the most recent sample that has arrived is "
            "used; verdicts cover every sequence",
        ),
        (
            ["--constant-delay"],
            " the delay is constant, somewhere between 0 and 1 ms; verdicts cover every constant "
            "delay",
        ),
    ):
        first, second, third, *_ = run(command, *MOVING, *wall, *options).stdout.splitlines()
        assert first.startswith("velocity ")
        assert re.fullmatch(r"delay +0 to 1 ms \(0 to 1 samples\)", second)
        assert third.startswith("range of delays ")
        assert third.endswith(words)


def test_an_unstable_wall_names_delays_that_make_it_grow() -> None:
    for command in ("limits", "check"):
        wall = answered(command, *MOVING, *SOFT, code=1)["walls"]["soft"]
        assert wall["verdict"] == "unstable"
        said = re.fullmatch(
            r"delays of ([\d., ]+) ms in turn: the motion grows by a factor of ([\d.]+) per sample",
            wall["worst_delays"],
        )
        assert said, wall["worst_delays"]
        turn = np.array([float(delay) for delay in said[1].split(",")])
        parts = np.rint(turn * TRUTH.parts).astype(int)
        assert np.array_equal(parts, turn * TRUTH.parts)
        motion = TRUTH.positions(6669.1, 71.6, np.resize(parts, (1, 4000)))
        assert growth(motion, len(turn))[0] == pytest.approx(float(said[2]), abs=1e-5)
        assert growth(motion, len(turn))[0] > 1.0


def test_the_same_wall_is_proved_for_every_constant_delay() -> None:
    for command in ("limits", "check"):
        answer = answered(command, *MOVING, *SOFT, "--constant-delay")
        assert answer["walls"]["soft"]["verdict"] == "stable"
        assert "worst_delays" not in answer["walls"]["soft"]
    assert all(true_radius(6669.1, 71.6, delay) < 1.0 for delay in np.linspace(0.0, 1.0, 21))


def test_an_unstable_wall_names_the_constant_delay() -> None:
    walls = [*SOFT, "--wall", "hard", "16000", "40"]
    answer = answered("limits", *MOVING, *walls, "--constant-delay", code=1)["walls"]["hard"]
    assert answer["verdict"] == "unstable"
    assert answer["worst_delays"].startswith("a constant delay of 1 ms: the motion grows by a ")
    radius = float(re.search(r"factor of ([\d.]+)", answer["worst_delays"])[1])  # type: ignore[index]
    assert radius == pytest.approx(true_radius(16000.0, 40.0, 1.0), rel=1e-5)
    assert true_radius(16000.0, 40.0, 0.0) < 1.0


@pytest.mark.parametrize("lost", [0, 1])
def test_no_sequence_that_is_tried_makes_the_stiffest_proved_wall_grow(lost: int) -> None:
    best = limits_of(scene(delay=[0.0, T], lost_samples=lost)).best
    assert best.certainty == "proved for every sequence of delays"
    wall = best.largest_stiffness, best.at_damping
    random, length = np.random.default_rng(3), 12
    turns = random.integers(0, TRUTH.parts + 1, (200, length))
    turns[:100] = np.where(turns[:100] > TRUTH.parts // 2, TRUTH.parts, 0)
    if lost:  # never two in a row
        turns[:, ::3] = np.where(random.random((200, length // 3)) < 0.5, LOST, turns[:, ::3])
    motions = TRUTH.positions(*wall, np.tile(turns, (1, 100)))
    assert np.all(growth(motions, length) < 1.0)
    assert best.proved_unstable_at is not None
    above = scene(delay=[0.0, T], lost_samples=lost)
    above["walls"] = {"a": {"stiffness": best.proved_unstable_at, "damping": best.at_damping}}
    assert limits_of(above).walls["a"].verdict == Verdict.UNSTABLE


def test_the_stiffest_wall_for_constant_delays_is_stable_at_each_of_them() -> None:
    moving, constant = (
        limits_of(scene(delay=[0.0, T], delay_is=kind)).best for kind in ("moving", "constant")
    )
    assert constant.certainty == "proved for every constant delay"
    assert constant.largest_stiffness > moving.largest_stiffness
    wall = constant.largest_stiffness, constant.at_damping
    radii = [true_radius(*wall, delay) for delay in np.linspace(0.0, 1.0, 21)]
    assert max(radii) < 1.0
    assert true_radius(1.05 * wall[0], wall[1], 1.0) > 1.0  # it is nearly the stiffest


def test_a_safety_is_proved_anew() -> None:
    for kind in ("moving", "constant"):
        whole = limits_of(scene(delay=[0.0, T], delay_is=kind)).best
        table = scene(delay=[0.0, T], delay_is=kind) | {"wanted": {"safety": 0.8}}
        part = limits_of(table).best
        assert part.largest_stiffness == pytest.approx(0.8 * whole.largest_stiffness, rel=1e-3)
        assert part.certainty == whole.certainty


def test_measures_are_those_of_the_worst_constant_delay() -> None:
    wall = answered("check", *MOVING, "--wall", "a", "5000", "20")["walls"]["a"]
    assert wall["measures_are"] == "the worst of 2 constant delays, no sample lost"
    radii = [true_radius(5000.0, 20.0, delay) for delay in (0.0, 1.0)]
    assert wall["spectral_radius"] == pytest.approx(max(radii), abs=1e-12)


def test_the_extra_delay_of_a_moving_one_is_beyond_its_range() -> None:
    table = scene(delay=[0.0, 0.5e-3], lost_samples=1)
    table["walls"] = {"a": {"stiffness": 2000.0, "damping": 15.0}}
    (wall,) = check_walls(Scene.from_table(table)).walls.values()
    assert wall.moving_is == "beyond the range"
    extra, loop = wall.extra_delay_moving, loop_of(Scene.from_table(scene()))
    alone = loop.jitter_margin(2000.0, 15.0)
    assert extra == pytest.approx(float(alone) - 0.5e-3 - T, rel=1e-9)
    assert 0.0 < extra < float(alone) - 0.5e-3 - T  # rounded down
    longest = {"delays": (0.0, 0.5e-3 + 0.999 * extra), "lost": 1}
    assert loop.verdict(2000.0, 15.0, **longest) == Verdict.STABLE  # type: ignore[arg-type]


def test_walls_are_proved_for_every_hand_and_constant_delay() -> None:
    hands = ["--hand-mass", "0:0.2", "--wall", "soft", "500", "5", "--constant-delay"]
    limits = answered("limits", *MOVING, *hands)
    assert limits["best"]["certainty"] == "proved for every hand and constant delay"
    soft = answered("check", *MOVING, *hands)["walls"]["soft"]
    assert soft["verdict"] == limits["walls"]["soft"]["verdict"] == "stable"
    best = limits["best"]["largest_stiffness"], limits["best"]["at_damping"]
    wall = [float(number.split()[0]) if isinstance(number, str) else number for number in best]
    for mass, delay in product(np.linspace(0.1, 0.3, 5), np.linspace(0.0, 1.0, 5)):
        units, delta = (T**2 / mass, T / mass), 0.05 * T / mass
        point = (wall[0] * units[0], wall[1] * units[1], 0.0, delta, delay)
        assert spectral_radius(*point)[0] < 1.0
    hard = ["--wall", "hard", str(1.1 * wall[0]), str(wall[1])]
    worst = answered("check", *MOVING, *hands, *hard, code=1)["walls"]["hard"]
    assert worst["verdict"] == "unstable"
    assert worst["worst_delays"].startswith("a constant delay of 1 ms")


@pytest.mark.parametrize(
    ("parts", "window", "spring"),
    [(2, 1, 0.0), *(pytest.param(*x, 300.0, marks=CAMPAIGN) for x in [(2, 5), (8, 1)])],
)
def test_walls_are_proved_for_every_hand_and_every_sequence(
    parts: int, window: int, spring: float
) -> None:
    delays = [0.0, T * parts / TRUTH.parts]
    table = scene(delay=delays, velocity={"window_samples": window})
    table["hand"] = {"mass": [0.0, 0.1], "stiffness": [0.0, spring], "damping": [0.5, 2.0]}
    limits = limits_of(table)
    assert limits.hand == "at its lowest values (all hands: see below)"
    assert limits.all_hands is not None
    assert limits.all_hands.certainty == "proved for every hand and every sequence of delays"
    wall = limits.all_hands.largest_stiffness, limits.all_hands.at_damping
    table["walls"] = {
        "all": {"stiffness": wall[0], "damping": wall[1]},
        "hard": {"stiffness": 2.0 * wall[0], "damping": wall[1]},
    }
    table["wanted"] = {"measures": ["jitter", "radius"]}
    checked = check_walls(Scene.from_table(table)).walls
    assert checked["all"].verdict == Verdict.STABLE
    assert checked["hard"].verdict == Verdict.UNSTABLE
    turns = np.random.default_rng(4).integers(0, parts + 1, (40, 12))
    for mass, stiffness, damping in product((0.0, 0.1), {0.0, spring}, (0.5, 2.0)):
        held = Moving((1.0,), (0.1 + mass, 0.05 + damping, stiffness), T, window)
        motions = held.positions(*wall, np.tile(turns, (1, 120)))
        assert np.all(growth(motions, 12) < 1.0)
    hand, worst = checked["hard"].worst_hand, checked["hard"].worst_delays
    assert hand is not None
    assert worst is not None
    held = Moving((1.0,), (0.1 + hand.mass, 0.05 + hand.damping, hand.stiffness), T, window)
    said = re.fullmatch(r"(?:a delay|delays) of ([\d., ]+) ms.*factor of ([\d.]+) per.*", worst)
    assert said
    turn = np.array([float(delay) for delay in said[1].split(",")]) * TRUTH.parts
    motion = held.positions(2.0 * wall[0], wall[1], np.resize(np.rint(turn).astype(int), (1, 1200)))
    assert growth(motion, len(turn))[0] == pytest.approx(float(said[2]), rel=1e-3)
    assert float(said[2]) > 1.0


# The scenes of a report: 16 and 8 hands at the corners, the light one of which is the worst.
BUTTERWORTH = {
    "device": {"mass": [0.08, 0.24], "damping": 0.05},
    "hand": {"mass": [0.0, 0.2], "stiffness": [0.0, 300.0], "damping": [0.0, 5.0]},
    "controller": {
        "sample_time": 0.25e-3,
        "delay_samples": 2.0,
        "velocity": {"cutoff": 100.0, "order": 2, "kind": "butterworth"},
    },
    "walls": {"a": {"stiffness": 4000.0, "damping": 12.0}},
}
TURNING = {
    "device": {"inertia": 0.02, "damping": 0.02},
    "hand": {"inertia": [0.0, 0.05], "stiffness": [0.0, 20.0], "damping": [0.0, 0.8]},
    "controller": {"sample_time": T, "delay_samples": 2.0, "velocity": {"window": 5e-3}},
    "walls": {"a": {"stiffness": 300.0, "damping": 2.0}},
}


def light_radius(table: dict[str, Any], estimator: tuple[Any, Any], samples: int) -> float:
    """Return the radius with the lightest hand and a whole delay, of a polynomial of scipy's."""
    period, (wall,) = table["controller"]["sample_time"], table["walls"].values()
    mass = float(np.min(table["device"].get("mass", table["device"].get("inertia"))))
    stiffness = table["hand"]["stiffness"][1]
    plant = [1.0], [mass, table["device"]["damping"], stiffness]
    numerator, denominator, _ = cont2discrete(plant, period, "zoh")
    above, below = (np.atleast_1d(side) for side in estimator)
    velocity = np.polymul(above, [wall["damping"] / period, -wall["damping"] / period])
    force = np.polyadd(velocity, np.polymul(below, [wall["stiffness"], 0.0]))
    free = np.polymul(np.polymul(denominator, below), [1.0] + [0.0] * (1 + samples))
    return float(np.abs(np.roots(np.polyadd(free, np.polymul(np.ravel(numerator), force)))).max())


@pytest.mark.parametrize(
    ("table", "estimator", "constant", "unstable"),
    [
        pytest.param(BUTTERWORTH, butter(2, 100.0, fs=4000.0), 0.6491e-3, 5, marks=CAMPAIGN),
        (TURNING, ([0.2] * 5, [1.0] + [0.0] * 4), 1.203e-3, 4),
    ],
)
def test_the_extra_delay_of_a_moving_one_is_proved_for_every_hand(
    table: dict[str, Any], estimator: tuple[Any, Any], constant: float, unstable: int
) -> None:
    scene_ = Scene.from_table(table)
    (wall,) = check_walls(scene_).walls.values()
    assert wall.moving_is == "proved for every hand"
    extra, period = wall.extra_delay_moving, scene_.controller.sample_time
    assert wall.extra_delay == pytest.approx(constant, rel=1e-3)
    assert light_radius(table, estimator, 2) < 1.0 < light_radius(table, estimator, unstable)
    assert extra <= wall.extra_delay < (unstable - 2) * period
    gains = tuple(table["walls"]["a"].values())
    each = [float(loop.jitter_margin(*gains)) for loop in corner_loops(scene_)]
    assert 0.95 * min(each) < extra <= min(each)


@pytest.mark.campaign
def test_no_sequence_within_the_margin_of_every_hand_makes_one_grow() -> None:
    (wall,) = check_walls(Scene.from_table(TURNING)).walls.values()
    parts, rng = int(8e3 * wall.extra_delay_moving), np.random.default_rng(8)
    assert parts == 9  # eighths of a sample
    turns = np.where(rng.random((20, 12)) < 0.5, 16, 16 + parts)
    turns[10:] = rng.integers(16, 17 + parts, (10, 12))
    for inertia, stiffness, damping in product((0.0, 0.05), (0.0, 20.0), (0.0, 0.8)):
        held = Moving((1.0,), (0.02 + inertia, 0.02 + damping, stiffness), T, 5)
        assert np.all(growth(held.positions(300.0, 2.0, np.tile(turns, (1, 150))), 12) < 1.0)


def test_of_a_wall_that_is_not_stable_for_moving_delays_no_constant_one_is_measured() -> None:
    """The wall is stable at each constant delay, which would be printed below "unstable"."""
    text = run("check", "--all", *MOVING, *SOFT).stdout
    assert re.search(r"(?m)^  verdict +unstable$", text)
    assert re.search(r"(?m)^  measures +left out: they are of constant delays", text)
    for words in ("settled", "spectral radius", "margins", "stiffness gain", "stable at"):
        assert words not in text
    push = ["--push", "1"]
    last = run("check", *MOVING, *SOFT, *push).stdout.splitlines()[-1]
    assert re.match(r"wall soft .*: unstable; delays of .* in turn: the motion grows by", last)
    constant = run("check", *MOVING, *SOFT, *push, "--constant-delay")
    assert constant.exit_code == 0
    for words in ("gain margins", "extra delay", "phase margin", "settling time", "contact"):
        assert f"\n  {words}" in constant.stdout


def test_a_constant_delay_that_is_not_known_may_begin_to_move() -> None:
    table = scene(delay=[0.0, 0.5e-3], delay_is="constant")
    table["walls"] = {"a": {"stiffness": 2000.0, "damping": 15.0}}
    (wall,) = check_walls(Scene.from_table(table)).walls.values()
    assert wall.moving_is == "beyond the range"
    loop = loop_of(Scene.from_table(scene()))
    longest = 0.5e-3 + wall.extra_delay_moving
    assert loop.verdict(2000.0, 15.0, delays=(0.0, longest)) == Verdict.STABLE


# ------------------------------------------------------- answers for the longest, constant delay
LONGEST = (
    "the delay varies between 0 and 1 ms; the most recent sample that has arrived is used; here "
    "constant, the longest"
)


def test_tune_and_design_take_the_longest_delay_and_say_so_first() -> None:
    for command in (["tune"], ["design", "--stiffness", "1000"]):
        ranged, one = run(*command, *MOVING), run(*command, *LIGHT, "--delay", "0.001")
        *first, third = ranged.stdout.splitlines()[:3]
        assert third.endswith(LONGEST)
        assert first == one.stdout.splitlines()[:2]
        assert set(one.stdout.splitlines()) <= set(ranged.stdout.splitlines())


def test_tuned_walls_are_judged_for_every_delay_of_the_range() -> None:
    ends = {"[0, 1]": [0.0, T], "[0.9, 1]": [0.9 * T, T]}
    verdicts = set()
    for delays in ends.values():
        tuned = tune_walls(Scene.from_table(scene(delay=delays)))
        wall = tuned.least_settling
        assert wall.rounded is not None
        gains = wall.rounded.stiffness, wall.rounded.damping
        loop = loop_of(Scene.from_table(scene(delay=T)))
        assert wall.for_all_delays == loop.verdict(*gains, delays=(delays[0], delays[1]))
        assert wall.for_all_hands is None
        assert wall.is_stable == (wall.for_all_delays == Verdict.STABLE)
        verdicts.add(wall.for_all_delays)
    assert Verdict.STABLE in verdicts


@pytest.mark.campaign
def test_tune_ends_with_0_where_all_that_it_names_is_proved() -> None:
    hands = ["--hand-mass", "0:0.1", "--hand-damping", "0.5:2"]
    tuned = answered("tune", *LIGHT, "--delay", "0.001", *hands)
    assert tuned["over_ranges"]["verdict"] == "stable"
    assert {tuned[name]["for_all_hands"] for name in ("least_radius", "least_settling")} == {
        "stable"
    }
    wall = tuned["over_ranges"]["stiffness"], tuned["over_ranges"]["damping"]
    for mass, damping in product((0.0, 0.1), (0.5, 2.0)):
        units = T**2 / (0.1 + mass), T / (0.1 + mass)
        delta = (0.05 + damping) * units[1]
        assert spectral_radius(wall[0] * units[0], wall[1] * units[1], 0.0, delta, 1.0)[1] < 1.0
    both = answered("tune", *MOVING, "--constant-delay", *hands)
    assert both["over_ranges"]["verdict"] == "stable"


def test_tolerances_widen_the_ranges_for_which_a_wall_is_proved() -> None:
    table = scene(delay=[0.0, T], lost_samples=1) | {
        "wanted": {"mass_tolerance": 0.1, "delay_tolerance": 2e-4}
    }
    wide = with_tolerances(Scene.from_table(table))
    assert wide.device.mass == (0.1 * (1.0 - 0.1), 0.1 * (1.0 + 0.1))
    assert (wide.controller.delays, wide.controller.lost_samples) == ((0.0, T + 2e-4), 1)
    assert wide.controller.moves
    one = with_tolerances(Scene.from_table(scene(delay_samples=1.0)))
    assert (one.controller.has_one_delay, one.controller.delays) == (True, (T, T))


def test_studies_and_pages_take_the_longest_delay_and_say_so_first(tmp_path: Path) -> None:
    for more in ("delay = [0.0, 0.001]", "delay_samples = [0, 1]\nlost_samples = 2"):
        file, page = written(tmp_path, more), tmp_path / "page.html"
        made = run("explore", file, "-o", page)
        assert made.exit_code == 0
        assert_one_sentence(made.stderr)
        for words in (made.stderr, page.read_text(encoding="utf-8")):
            assert re.search(r"elay varies between 0 and 1 ms.*; here constant, the longest", words)
        table = run("study", file, "--over", "device.mass=0.1,0.2", "--csv", "-")
        first, *_ = table.stderr.splitlines()
        assert first.startswith("jaxstab: the delay varies between 0 and 1 ms; the most recent")
        lost = ", no sample lost" * ("lost" in more)
        assert first.endswith(f"here constant, the longest{lost}.")
        single = answered("limits", *LIGHT, "--delay", "0.001")["best"]["largest_stiffness"]
        rows = list(csv.DictReader(io.StringIO(table.stdout)))
        assert 0.0 <= float(rows[0]["largest_stiffness"]) - single < 1e-3 * single
        over = run("study", file, "--over", "controller.delay=0,0.001", "--csv", "-")
        assert over.exit_code == 0, over.stderr
        assert "longest" not in over.stderr


def test_limits_around_a_wall_are_for_all_hands_of_a_delay_that_is_constant() -> None:
    """They were those of the lowest hand at both delays, and of the worst one."""
    table = scene(delay=[0.0, T], delay_is="constant")
    table["hand"] = {"mass": [0.0, 0.1], "stiffness": [0.0, 500.0]}
    table["walls"] = {"a": {"stiffness": 2000.0, "damping": 15.0}}
    table["wanted"] = {"measures": ["margins"]}
    (wall,) = check_walls(Scene.from_table(table)).walls.values()
    assert wall.measures_are == "the worst of 8 hands and constant delays"
    least, _ = wall.stiffness_limits
    assert least == pytest.approx(0.0, abs=1e-9)  # of no hand; any other allows a negative one
    _, most = wall.damping_limits
    each = [
        HapticLoop(
            device_mass=0.1,
            device_damping=0.05,
            hand_mass=mass,
            hand_stiffness=stiffness,
            sample_time=T,
            delay=delay,
        ).spectral_radius(2000.0, np.array([0.999, 1.001]) * most)
        for mass, stiffness, delay in product((0.0, 0.1), (0.0, 500.0), (0.0, T))
    ]
    inside, outside = np.max([radius.value for radius in each], axis=0)
    assert inside < 1.0 < outside


@pytest.mark.campaign
def test_pictures_of_tune_and_design_are_of_the_longest_delay(tmp_path: Path) -> None:
    given = Scene.from_table(
        scene(delay=[0.0, T], delay_is="constant") | {"wanted": {"stiffness": 1e3}}
    )
    figure = scene_figure(given, tune_walls(given))
    assert "here constant, the longest" in figure.get_suptitle().replace("\n", " ")


def test_measures_with_hands_are_the_worst_of_hands_and_delays() -> None:
    table = scene(delay=[0.0, T])
    table["hand"] = {"mass": [0.0, 0.1]}
    table["walls"] = {"a": {"stiffness": 2000.0, "damping": 15.0}}
    (wall,) = check_walls(Scene.from_table(table)).walls.values()
    assert wall.measures_are == "the worst of 4 hands and constant delays, no sample lost"
    assert wall.moving_is == "beyond the range, proved for every hand"
    each = [
        HapticLoop(
            device_mass=0.1, device_damping=0.05, hand_mass=hand, sample_time=T, delay=delay
        ).margins(2000.0, 15.0)
        for hand, delay in product((0.0, 0.1), (0.0, T))
    ]
    least = min(float(margins.stiffness_gain) for margins in each)
    assert wall.stiffness_gain == pytest.approx(least, rel=1e-9)


@pytest.mark.campaign
def test_measures_with_hands_are_the_worst_at_all_corners_of_constant_delays() -> None:
    """They were those of the lightest hand at either delay, and of the hand that decays slowest."""
    table = scene(delay=[T, 2.0 * T], delay_is="constant")
    table["hand"] = {"mass": [0.0, 0.4], "stiffness": [0.0, 300.0]}
    table["walls"] = {"a": {"stiffness": 500.0, "damping": 5.0}}
    (wall,) = check_walls(Scene.from_table(table)).walls.values()
    assert wall.measures_are == "the worst of 8 hands and constant delays"
    names = "device_mass", "device_damping", "hand_mass", "hand_stiffness", "delay"
    corners = product((0.1,), (0.05,), (0.0, 0.4), (0.0, 300.0), (T, 2.0 * T))
    loops = [HapticLoop(sample_time=T, **dict(zip(names, own, strict=True))) for own in corners]
    least = min(float(loop.margins(500.0, 5.0).stiffness_gain) for loop in loops)
    phase = min(float(loop.frequency_margins(500.0, 5.0).phase.value) for loop in loops)
    assert wall.stiffness_gain == pytest.approx(least, rel=1e-9)
    assert wall.margins_over_frequency.phase_margin == pytest.approx(phase, rel=1e-9)


def test_ranges_of_delays_are_rows_of_a_table(tmp_path: Path) -> None:
    file = tmp_path / "rows.csv"
    result = run("check", *MOVING, *SOFT, "--csv", file)
    assert result.exit_code == 1
    rows = list(csv.DictReader(io.StringIO(file.read_text(encoding="utf-8"))))
    assert [row["inputs.delay_high"] for row in rows] == ["0.001"]
    assert rows[0]["walls.soft.verdict"] == "unstable"
    assert rows[0]["refusal"] == ""


def test_a_constant_range_gives_an_atlas_its_corners() -> None:
    from jaxstab.app.scene.exports import atlas_spec

    spec = atlas_spec(Scene.from_table(scene(delay=[0.8e-3, 1.2e-3], delay_is="constant")))
    assert (spec.delay[0], spec.delay[-1]) == pytest.approx((0.8, 1.2))
    assert 1.0 in spec.delay


def test_a_model_with_a_moving_delay_is_explained(tmp_path: Path) -> None:
    file = written(tmp_path, "delay_samples = [0.0, 1.0]")
    text = run("scene", "explain", file).stdout
    assert re.search(r"(?m)^delay +0 to 1 ms \(0 to 1 samples\); varies between 0 and 1 ms", text)
    assert "a mass, hand or gain that changes while the wall is touched" in text


def test_the_page_on_the_model_shows_what_the_commands_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[3] / "docs" / "model.md").read_text(encoding="utf-8")
    part = page.split("### A scene whose delay is a range")[1].split("\n## ")[0]
    (text,) = re.findall(r"(?ms)^```toml\n(.*?)^```", part)
    monkeypatch.chdir(tmp_path)
    Path("moving.toml").write_text(text, encoding="utf-8")
    shown = re.findall(r"(?ms)^```console\n\$ jaxstab (.*?)\n(.*?)^```", part)
    assert len(shown) == 2
    for command, output in shown:
        assert run(*command.split()).stdout == output
