"""The commands around a scene, as a user meets them."""

import itertools
import json
import re
from dataclasses import dataclass, replace
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign import first
from click.testing import CliRunner, Result
from commands import EXAMPLE
from mpmath import mp

from jaxstab import HapticLoop
from jaxstab.answers import Answer, GainAnswer, Quantity, Template, Units
from jaxstab.app.cli.main import main
from jaxstab.app.pictures.scene import scene_figure
from jaxstab.app.scene import Scene, check_walls, design_loop, scene_limits
from jaxstab.conventions import Verdict
from jaxstab.model import Velocity, by_name
from jaxstab.model.loop import as_one
from jaxstab.point import spectral_radius, verdict
from tests.truth import devices, filtered
from tests.truth import loop as truth
from tests.truth.march import FINE, march_on_a_fine_grid

FREE = ["--mass", "1", "--damping", "0", "--sample-time", "0.05", "--delay", "0"]
PHANTOM = ["--device", "phantom", "--sample-time", "0.001"]
JOINT = "data/scenes/joint.toml"
GRID = 0.05  # s: of FREE, K = alpha m / T^2 and B = beta m / T


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def answered(*arguments: str | Path, exit_code: int = 0) -> Any:
    result = run(*arguments, "--json")
    assert result.exit_code == exit_code, result.stderr
    return json.loads(result.stdout)


def test_limits_of_a_free_device_are_those_of_the_closed_form_in_si_units() -> None:
    limits = answered("limits", *FREE, "--at-damping", 10)
    assert limits["best"]["largest_stiffness"] == pytest.approx(
        (12 - 8 * np.sqrt(2)) / GRID**2, rel=1e-3
    )
    assert limits["most_damped"]["largest_damping"] == pytest.approx(2 / GRID, rel=1e-3)
    assert limits["passive"]["largest_stiffness"] is None  # without damping there is none
    given = limits["at_given_damping"]
    assert given["stiffness_limits"][1] == pytest.approx(2 * 0.5 * 1.5 / 2.5 / GRID**2, rel=1e-9)
    assert given["linear_rule_stiffness"] == pytest.approx(10 / (GRID / 2))  # eq. (22)


@pytest.mark.campaign
def test_a_scene_without_any_stable_wall_is_answered_with_none() -> None:
    # Sec. VIII: at gamma = pi^2 without damping a root stays at z = -1 whatever the wall.
    scene = ["--mass", "0.1", "--damping", "0", "--sample-time", "0.001"]
    limits = answered("limits", *scene, "--hand-stiffness", 0.1e6 * np.pi**2, exit_code=1)
    assert limits["best"] == {"largest_stiffness": None, "at_damping": None}


def test_the_passive_limit_is_colgates() -> None:
    limits = answered("limits", *PHANTOM)
    assert limits["passive"]["largest_stiffness"] == 2999.0  # 2 * 1.5/1e-3 itself is the limit


def test_check_ends_with_zero_only_if_every_wall_is_stable() -> None:
    stable, unstable = ["--wall", "a", "100", "10"], ["--wall", "b", "1000", "10"]
    only = ["check", *FREE]
    assert answered(*only, *stable)["walls"]["a"]["verdict"] == "stable"
    both = answered(*only, *stable, *unstable, exit_code=1)["walls"]
    assert [both[name]["verdict"] for name in "ab"] == ["stable", "unstable"]
    assert "extra_delay" not in both["b"]


def test_check_measures_the_dominant_pole_and_the_settling() -> None:
    wall = answered("check", *PHANTOM, "--wall", "a", "800", "5")["walls"]["a"]
    point = (800e-5, 5e-2, 0.0, 0.015, 0.0)
    pole = complex(truth.root_balls(*point)[0])
    assert wall["spectral_radius"] == pytest.approx(abs(pole), rel=1e-12)
    logarithm = np.log(pole)
    assert wall["frequency"] == pytest.approx(abs(logarithm.imag) / (2 * np.pi * 1e-3), rel=1e-9)
    assert wall["damping_ratio"] == pytest.approx(-logarithm.real / abs(logarithm), rel=1e-9)
    slowest = -1e-3 / np.log(abs(pole))  # s, the time constant
    assert wall["settling_time_5_percent"] / slowest > 2
    assert wall["settling_time_5_percent"] < wall["settling_time_2_percent"] < 6 * slowest


def test_a_range_of_hands_is_proved_and_its_worst_hand_named() -> None:
    hands = ["--hand-mass", "0:0.3", "--hand-stiffness", "0:200"]
    wall = answered("check", *PHANTOM, *hands, "--wall", "a", "3000", "20")["walls"]["a"]
    assert wall["verdict"] == "stable"
    assert wall["worst_hand"]["mass"] == 0.3  # the slowest one; the margins are the least of all
    alone = answered("check", *PHANTOM, "--wall", "a", "3000", "20")["walls"]["a"]
    assert 0.9 * alone["extra_delay"] < wall["extra_delay"] <= alone["extra_delay"]
    limits = answered("limits", *PHANTOM, *hands)
    assert limits["all_hands"]["certainty"] == "proved for every hand"
    assert limits["all_hands"]["worst_hand"]["mass"] == 0.0


def test_walls_that_are_asked_together_are_answered_as_each_alone() -> None:
    table = {
        "device": {"mass": 0.1, "damping": 1.5},
        "hand": {"mass": [0.0, 0.3], "stiffness": [0.0, 200.0]},
        "controller": {"sample_time": 0.001, "delay_samples": 1.5},
    }
    walls = {
        "soft": {"stiffness": 300.0, "damping": 2.0},
        "unstable": {"stiffness": 9000.0, "damping": 2.0},
    }
    together = check_walls(Scene.from_table({**table, "walls": walls})).walls
    assert list(together) == list(walls)
    for name, wall in walls.items():
        alone = check_walls(Scene.from_table({**table, "walls": {name: wall}})).walls[name]
        assert repr(together[name]) == repr(alone)


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("verdict", {}),
        ("spectral_radius", {}),
        ("margins", {}),
        ("oscillation", {}),
        ("settling_time", {"level": 0.05}),
        ("amplitude", {"encoder": 1e-5}),
    ],
)
def test_loops_of_one_mass_as_one_answer_as_each_does(method: str, options: Any) -> None:
    hands = [(0.0, 0.0, 0.0), (0.3, 200.0, 4.0), (0.1, 500.0, 0.0)]
    window = Velocity.difference(window=0.005)
    loops = [
        HapticLoop(
            device_mass=0.1,
            device_damping=1.5,
            hand_mass=mass,
            hand_stiffness=stiffness,
            hand_damping=damping,
            sample_time=1e-3,
            delay=delay,
            velocity=window,
        )
        for (mass, stiffness, damping), delay in zip(hands, (0.0, 1e-3, 1.4e-3), strict=True)
    ]
    walls = np.array([(500.0, 2.0), (900.0, 7.0), (9000.0, 2.0)])
    many = getattr(as_one(loops), method)(*walls.T, **options)
    for index, (loop, wall) in enumerate(zip(loops, walls, strict=True)):
        own = getattr(loop, method)(*wall, **options)
        pairs = [(many, own)] if method == "verdict" else zip(many[:5], own[:5], strict=True)
        for column, value in pairs:
            np.testing.assert_allclose(column[index], value, rtol=1e-11, atol=1e-14)


def test_tune_finds_the_triple_pole_and_the_best_damping_for_a_wall() -> None:
    tuned = answered("tune", *FREE, "--wall", "a", "60", "0")
    best = tuned["least_radius"]
    radius = 4 ** (1 / 3) - 1
    assert best["spectral_radius"] == pytest.approx(radius, rel=1e-5)
    assert best["stiffness"] == pytest.approx((6 * radius**2 - 2) / GRID**2, rel=1e-9)
    assert tuned["least_settling"]["share_of_largest"] < 0.5
    assert tuned["walls"]["a"]["stiffness"] == pytest.approx(60.0)
    fastest = tuned["least_settling"]["settling_time_2_percent"]
    assert fastest <= min(
        best["settling_time_2_percent"], tuned["walls"]["a"]["settling_time_2_percent"]
    )


BEYOND = "beyond it the wanted gain is not allowed; much larger values were not tried"


def test_design_returns_the_sample_time_at_which_the_wanted_stiffness_is_the_largest() -> None:
    wanted = 500.0
    found = answered("design", *FREE, "--stiffness", wanted, exit_code=1)
    period = np.sqrt((12 - 8 * np.sqrt(2)) / wanted)
    assert found["sample_time"]["largest_sample_time"] == pytest.approx(period, rel=1e-3)
    assert found["sample_time"]["status"] == BEYOND
    assert found["delay"]["largest_delay"] is None  # not even without any
    assert (
        found["delay"]["status"]
        == "no value tried allows the wanted gain; shorten the delay or the filter"
    )


def test_design_does_not_call_a_delay_the_largest_that_a_longer_one_exceeds() -> None:
    """A mode of 25 ms: half of a period late the wall damps what it makes grow a quarter late."""
    mode = {"frequency": 40.0, "damping_ratio": 0.003, "modal_mass": 2.0}
    hand = {"mass": 0.2, "stiffness": 1500.0, "damping": 20.0}
    table = {
        "device": {"mass": 0.25, "damping": 0.1, "modes": [mode]},
        "hand": {**hand, "grip": {"stiffness": 3000.0, "damping": 0.2}},
        "controller": {"sample_time": 1e-3, "delay": 1e-3, "velocity": {"window_samples": 5}},
        "wanted": {"stiffness": 1200.0},
    }
    found = design_loop(Scene.from_table(table)).delay
    bodies = [(0.25, 0.1, 0.0), devices.mode(*mode.values())]
    system = devices.Mechanism(bodies, [(0.2, 20.0, 1500.0, (0.2, 3000.0))]).system()

    def code(delay: float, damping: float) -> Verdict:
        filters = filtered.difference(5), filtered.average(1)
        return devices.DeviceLoop(system, 1e-3, 1e3 * delay, *filters).code(1200.0, damping)

    assert code(found.largest_delay, found.at_damping) == Verdict.STABLE
    assert found.largest_delay < 4e-3
    assert code(0.01, 1.5) == Verdict.STABLE
    assert found.status.words == BEYOND


@pytest.mark.campaign
def test_design_says_up_to_where_it_looked() -> None:
    found = answered("design", *PHANTOM, "--stiffness", 1e-3)["delay"]
    assert found["largest_delay"] == pytest.approx(0.256)
    assert found["status"] == "the longest value tried still allows the wanted gain"


def test_an_example_of_a_scene_is_written_and_explained(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    written = run("scene", "init", "-o", file)
    assert written.exit_code == 0
    assert file.read_text(encoding="utf-8") == EXAMPLE == run("scene", "init").stdout
    assert run("scene", "init", "-o", file).exit_code != 0  # never over an existing file
    explained = run("scene", "explain", file)
    assert explained.exit_code == 0
    assert "excludes: the zero-order hold" in explained.stdout


def test_options_go_before_the_values_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(EXAMPLE, encoding="utf-8")
    table = answered("check", file, "--delay", "0", "--wall", "soft", "500", "3", exit_code=0)
    assert table["walls"]["soft"]["stiffness"] == 500.0
    assert list(table) == ["inputs", "units", "walls"]
    assert list(table["walls"]) == ["soft", "hard"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["check", *PHANTOM], "walls is empty; give at least one wall"),
        (["check", *PHANTOM, "--wall", "a", "nan", "1"], "walls.a.stiffness is nan"),
        (["limits", "--mass", "-1", "--damping", "0", "--sample-time", "1"], "device.mass is -1.0"),
        (["limits", *PHANTOM, "--hand-mass", "2:1"], "its ends are swapped"),
        (["limits", *PHANTOM, "--hand-mass", "2:x"], "neither a number nor LOW:HIGH"),
        (["limits", "nowhere.toml"], "cannot read nowhere.toml"),
        (["limits", "--damping", "1"], "device.mass is missing"),
        (["limits", "--rate", "0", *PHANTOM], "--rate is 0; give a finite number > 0 in Hz."),
        (["limits", "--rate", "inf", *PHANTOM], "--rate is inf; give a finite number > 0 in Hz."),
        (
            ["limits", "--mass", "1", "--rate", "1000", "--sample-time", "1e-3"],
            "--rate is 1000 beside --sample-time; give one of them.",
        ),
        (
            ["limits", "--mass", "1", "--rate", "1000", "--set", "controller.sample_time=2e-3"],
            "--set controller.sample_time is given beside --rate; give one of them.",
        ),
        (
            ["limits", "--window", "5e-3", "--set", "controller.velocity.window=6e-3"],
            "--set controller.velocity.window is given beside --window; give one of them.",
        ),
        (["design", *PHANTOM], "wanted.stiffness is missing"),
        (["design", JOINT], "give the stiffness to design for in N m/rad."),
        (["contact", JOINT], "give contact.push in N m, or contact.speed in rad/s (on"),
        (["scene", "explain", "nowhere.toml"], "cannot read nowhere.toml"),
        (["limits", *PHANTOM, "--plot", "picture.pdf"], "ends in neither .png nor .svg"),
        (["check", *PHANTOM, "--plot", "no/folder.png"], "no does not exist"),
        (["limits", *PHANTOM, "--hand-stiffness", "1e12"], "hand.stiffness T^2/mass is 1e+07"),
        (["limits", *PHANTOM, "--sample-time", "1e300"], "damping T/mass of device and hand is"),
        (["limits", *PHANTOM, "--delay", "1", "--delay-samples", "1"], "give one"),
        (["limits", *PHANTOM, "--delay-samples", "1e6"], "give at most 500 samples"),
        (["limits", *PHANTOM, "--delay", "1"], "controller.delay is 1000 samples of 0.001 s"),
        (["check", *PHANTOM, *["--wall", "a", "1", "1"] * 2], "wall a is given twice"),
        (["limits", *PHANTOM, "--hand-damping", "1e9"], "damping T/mass"),  # without a warning
        (["scene", "init", "-o", "no/folder.toml"], "no does not exist"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_two(arguments: list[str], words: str) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("jaxstab: ")
    assert words in result.stderr


def test_the_picture_shows_the_exact_edge_and_tells_the_walls_apart_without_colour() -> None:
    walls = {
        "soft": {"stiffness": 0.2, "damping": 0.8},
        "hard": {"stiffness": 0.9, "damping": 0.8},
    }
    scene = Scene.from_table(
        {
            "device": {"mass": 1.0, "damping": 0.0},
            "controller": {"sample_time": 1.0},
            "walls": walls,
            "wanted": {"measures": ["settling"]},
        }
    )
    plane, response = scene_figure(scene, check_walls(scene)).axes
    edge, *_ = plane.get_lines()
    stiffness, damping = np.asarray(edge.get_data())
    closed = 2 * damping * (2 - damping) / (damping + 2)
    np.testing.assert_allclose(np.minimum(abs(stiffness - closed), abs(stiffness)), 0, atol=1e-9)
    drawn = {line.get_label(): line.get_marker() for line in plane.get_lines()}
    assert drawn["wall, stable"] != drawn["wall, unstable"]
    texts = {text.get_text() for text in plane.texts}
    assert texts >= {"soft", "hard"}
    assert not any(text.endswith(" ms") for text in texts)  # settling times are tune's
    styles = [line.get_linestyle() for line in response.get_lines()]
    assert len(styles) == len(set(styles)) == 2


@pytest.mark.campaign
def test_what_is_too_small_to_be_seen_beside_the_region_is_enlarged() -> None:
    scene = Scene.from_file(Path(__file__).parents[3] / "data" / "scenes" / "collision.toml")
    whole, enlarged = scene_figure(scene).axes
    parts = {str(patch.get_label()): patch.get_path().vertices for patch in enlarged.patches}
    assert "passive: up to 3000 N/m" in parts  # 2 b/T, Colgate
    common = next(name for name in parts if name.startswith("stable for the hands at all corners"))
    proved = scene_limits(scene).all_hands
    stiffest = parts[common][:, 0].max()
    assert 0.9 * stiffest < proved.largest_stiffness < stiffest
    for panel, is_seen in ((whole, False), (enlarged, True)):
        window = np.ptp([panel.get_xlim(), panel.get_ylim()], axis=1)
        shares = np.ptp(parts[common], axis=0) / window
        assert (shares > 0.5).all() == is_seen


@pytest.mark.campaign
def test_a_picture_comes_with_the_answer(tmp_path: Path) -> None:
    file = tmp_path / "scene.svg"
    limits = answered("limits", *FREE, "--hand-mass", "0:1", "--plot", file)
    assert limits["best"]["largest_stiffness"] > 0
    text = file.read_text(encoding="utf-8")
    assert text.startswith("<?xml")
    assert "</svg>" in text


def test_an_unusual_scale_is_a_warning_of_one_line() -> None:
    result = run("limits", "--mass", "500", "--damping", "0", "--sample-time", "1", "--json")
    assert result.exit_code == 0
    assert result.stderr.count("\n") == 1
    assert "device.mass is 500 kg" in result.stderr
    assert "controller.sample_time is 1 s" in result.stderr


@pytest.mark.campaign
def test_design_says_when_no_sample_time_makes_up_for_a_delay() -> None:
    answer = answered("design", *PHANTOM, "--delay", "0.02", "--stiffness", 6e4, exit_code=1)
    assert answer["sample_time"]["largest_sample_time"] is None
    assert 0.0 < answer["delay"]["largest_delay"] < 1e-3  # the most is 70.6 kN/m, without any


def test_options_for_a_table_that_is_none_are_refused_with_the_table(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text('hand = "none"\n' + EXAMPLE.replace("[hand]", "[other]"), encoding="utf-8")
    result = run("limits", file, "--hand-mass", 1)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.count("\n") == 1


# ----------------------------------------------------------------------------- what is printed


def printed(*arguments: str | Path, exit_code: int = 0) -> list[tuple[str, str]]:
    """The lines of an answer, as name and value."""
    result = run(*arguments)
    assert result.exit_code == exit_code, result.stderr
    lines = (line.strip().partition("  ") for line in result.stdout.splitlines())
    return [(name, value.strip()) for name, _, value in lines]


def number(words: str) -> float:
    return float(words.split()[0])


def test_the_radius_that_tune_prints_is_that_of_the_gains_that_it_prints() -> None:
    lines = dict(printed("tune", *PHANTOM)[:6])  # of the smallest radius
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    gains = loop.alpha(number(lines["stiffness"])), loop.beta(number(lines["damping"]))
    radius = spectral_radius(*gains, gamma=loop.gamma, delta=loop.delta, delay=loop.delay_samples)
    assert number(lines["spectral radius"]) == pytest.approx(float(radius.value), abs=1e-6)
    exact = answered("tune", *PHANTOM)["least_radius"]
    assert exact["rounded"]["stiffness"] == number(lines["stiffness"])
    rounded = exact["rounded"]["spectral_radius"]
    assert exact["spectral_radius"] + 1e-3 < rounded  # where three poles meet, digits matter


@pytest.mark.parametrize("delay", first(["0", "0.0013", "0.004"], 1))
def test_printed_limits_are_rounded_inwards(delay: str) -> None:
    scene = [*PHANTOM, "--hand-stiffness", "123", "--delay", delay, "--at-damping", "7"]
    exact = answered("limits", *scene)
    lines = dict(printed("limits", "--all", *scene))
    low, high = (float(end) for end in lines["stiffness limits"].split(" N")[0].split(" to "))
    given = exact["at_given_damping"]["stiffness_limits"]
    assert given[0] <= low < high <= given[1]
    inwards = 1e-9 * (high - low)  # off the line alpha = -gamma itself
    for end in (low + inwards, high):
        point = (end * 1e-5, 7e-2, 123e-5, 1.5e-2, float(delay) * 1e3)
        assert verdict(**by_name(*point)) in (Verdict.STABLE, Verdict.UNDECIDED)
    design = [*scene[:-2], "--stiffness", "1000"]
    shown, found = dict(printed("design", *design)), answered("design", *design)
    for quantity in ("sample time", "delay"):
        least = shown[f"largest {quantity}"]
        key = quantity.replace(" ", "_")
        most = found[key][f"largest_{key}"]
        assert 0.999 * most < number(least) / 1e3 <= most * (1 + 1e-10)


@pytest.mark.campaign
def test_what_is_zero_by_the_geometry_is_printed_as_zero() -> None:
    for arguments in (
        ["limits", "--all", *PHANTOM, "--at-damping", "0"],
        ["limits", "--all", *FREE, "--at-stiffness", "100"],
        ["check", "--all", *PHANTOM, "--wall", "a", "800", "5"],
        ["region", "--gamma", "0", "--delta", "0.015", "--delay", "1"],
        ["region", "--gamma", "0", "--delta", "0", "--delay", "0"],
    ):
        text = run(*arguments).stdout
        assert not re.search(r"e-\d", text.replace("radius error", "#").split("#")[0]), text
        assert not re.search(r"-0(?![.\d])", text), text
    assert ("at stiffness", "0 N/m") in printed("limits", "--all", *PHANTOM)
    lines = dict(printed("check", "--all", *PHANTOM, "--wall", "a", "800", "5"))
    assert lines["stiffness limits"][:5] == "0 to "


def test_what_is_not_proved_is_said_so_and_an_unstable_wall_never_settles() -> None:
    lines = dict(printed("check", "--all", *FREE, "--wall", "b", "1000", "10", exit_code=1))
    assert lines["stiffness limits"] == "0 to 240 N/m"  # 2 beta (2 - beta)/(2 + beta) m/T^2
    assert lines["damping limits"] == "none"
    assert lines["settling time (2 %)"] == "never"
    assert lines["settling status"] == "the loop is unstable and never settles"
    slow = dict(printed("check", "--all", *FREE, "--wall", "c", "1e-9", "1e-3"))
    assert slow["settling time (2 %)"] == slow["settling time (5 %)"] == "not proved"
    text = run("check", *FREE, "--wall", "b", "1000", "10", "--wall", "c", "1e-9", "1e-3").stdout
    assert not re.search(r"\b(nan|inf)\b", text)


HELD = ["--hand-mass", "0:0.3", "--hand-stiffness", "0:200"]


def test_check_prints_at_most_eight_lines_a_wall_of_the_numbers_that_all_prints() -> None:
    walls = ["--wall", "a", "3000", "20", "--wall", "b", "90000", "90"]
    given = ["check", *PHANTOM, *HELD, "--set", "device.encoder.resolution=1e-5", "--push", "1"]
    result = run(*given, *walls)
    assert result.exit_code == 1
    head, first, second = re.split(r"(?m)^wall \w ", result.stdout)
    assert "\nranges " in head
    lines, exact = first.splitlines(), answered(*given, *walls, exit_code=1)["walls"]
    assert lines[0].strip() == "3000 N/m at 20 N s/m: stable for every hand"
    assert len(lines) <= 8
    said = dict(re.split(r"  +", line.strip(), maxsplit=1) for line in lines[1:])
    assert [*said] == [
        "gain margins",
        "extra delay",
        "phase margin",
        "passive",
        "settling time (2 %)",
        "encoder chatter",
        "contact",
    ]
    stiffer, damper = re.findall(r"factor of ([\d.]+)", said["gain margins"])
    assert float(stiffer) == pytest.approx(exact["a"]["stiffness_gain"], rel=1e-3)
    assert float(damper) == pytest.approx(exact["a"]["damping_gain"], rel=1e-3)
    extra = float(said["extra delay"].removesuffix(" ms (constant)"))
    assert extra == pytest.approx(1e3 * exact["a"]["extra_delay"], rel=1e-3)
    assert "(simulated, at 0.1 m/s, pushed with 1 N" in said["contact"]
    others = second.splitlines()
    assert others[0].strip().startswith("90000 N/m at 90 N s/m: unstable with ")
    assert re.fullmatch(r"  stable walls +K from 0 to \d+ N/m at 90 N s/m; no B at .*", others[1])
    assert [line.split()[0] for line in others[2:]] == ["contact"]


def test_what_check_does_not_print_is_not_computed() -> None:
    table = {
        "device": {"mass": 0.1, "damping": 1.5},
        "hand": {"mass": [0.0, 0.3]},
        "controller": {"sample_time": 0.001, "delay_samples": 1.0},
        "walls": {"a": {"stiffness": 300.0, "damping": 2.0}},
    }
    short = check_walls(Scene.from_table(table), in_full=False)
    whole = check_walls(Scene.from_table(table))
    assert short.in_short() == whole.in_short()
    (wall,) = short.walls.values()
    for name in ("distance_to_boundary", "spectral_radius", "damping_ratio", "extra_delay_moving"):
        assert wall.values.get(name) is None
        assert whole.walls["a"].values[name] is not None


def test_a_row_of_a_short_text_is_its_first_way_of_which_all_values_are_there() -> None:
    inner = GainAnswer(
        {"stiffness": inf, "damping": nan, "frequency": 2.0, "stiffness_limits": (nan, nan)}
    )
    rows = (
        Template("first", ("{safety} and {unknown}", "{safety}[ of {unknown}| alone]")),
        Template("left out", ("{unknown}",)),
        Template("not there", ("words",), when="unknown"),
        Template("beside another", ("words",), unless="safety"),
        Template(
            "entry {}",
            ("{stiffness}[ at {damping}], [a {stiffness!}|no] limit; {safety}",),
            "walls",
        ),
    )
    own = Template("inside", ("{frequency!}[ within {stiffness_limits}]",))
    walls = {"{[x|y]}": replace(inner, short=[own])}
    answer = GainAnswer({"inputs": GainAnswer({}), "safety": 0.5, "walls": walls}, short=rows)
    assert answer.in_short().splitlines() == [
        "first          0.5 alone",
        "entry {[x|y]}  unlimited, no limit; 0.5",
        "  inside       2 Hz",
    ]


def test_stable_gains_that_are_not_resolved_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def unresolved(*_: Any) -> None:
        raise ValueError

    monkeypatch.setattr("jaxstab.app.scene.limits.stable_intervals", unresolved)
    unstable = [*FREE, "--wall", "b", "1000", "10"]
    lines = printed("check", *unstable, exit_code=1)
    words = "K is not resolved at 10 N s/m; B is not resolved at 1000 N/m"
    assert ("stable walls", words) in lines
    lines = printed("check", "--all", *unstable, exit_code=1)
    assert ("stiffness limits", "not resolved") in lines
    wall = answered("check", *unstable, exit_code=1)["walls"]["b"]
    assert wall["damping_limits"] == "not resolved"


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.167, "0.167 rad"),
        (0.0991, "99.1 mrad"),
        (2.5e-5, "25 urad"),
        (3e-8, "30 nrad"),
        (0.0, "0 rad"),
        (inf, "unlimited"),
    ],
)
def test_an_amount_has_the_prefix_of_its_size(value: float, words: str) -> None:
    assert Quantity("m", 3).words(value, Units.ROTATION) == words


@dataclass(frozen=True)
class Sample(Answer):
    """An answer of each kind of number."""

    largest_stiffness: float
    stiffness_limits: tuple[float, float]
    sample_time: float
    radius_error: float


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            (2.99969e3, (0.12341, 5.67899), 0.0012345678, 1.2341e-9),
            ["2999 N/m", "0.1235 to 5.678 N/m", "1.23457 ms", "1.24e-09"],
        ),
        (
            (3e3 - 1e-12, (-0.12349, -0.0), 2.0, inf),
            ["3000 N/m", "-0.1234 to 0 N/m", "2 s", "not proved"],
        ),
        (
            (-1.23456, (2.50001, 2.50002), 1e-9, 0.0),
            ["-1.235 N/m", "2.50001 to 2.50002 N/m", "1 ns", "0"],
        ),
        (
            (nan, (nan, nan), inf, nan),
            ["none", "none", "unlimited", "none"],
        ),
    ],
)
def test_numbers_in_words(values: Any, words: list[str]) -> None:
    sample = Sample(*values)
    assert [line[34:] for line in sample.lines()] == words
    table = json.loads(json.dumps(sample.as_json(), allow_nan=False))
    most, limits, *others = table.values()
    exact = [most, *limits, *others]
    flat = [values[0], *values[1], *values[2:]]
    assert exact == [value if isfinite(value) else None for value in flat]


def test_without_anything_to_do_the_help_is_shown() -> None:
    result = run("scene")
    assert result.exit_code == 2
    assert result.stderr.startswith("Usage:")


@pytest.mark.parametrize(
    ("wall", "slowest", "least_damped"),
    [
        ((530.0, 1.8), (0.16, 0.0, 0.2), (0.16, 280.0, 0.2)),
        pytest.param(
            (530.0, 26.0), (0.0, 0.0, 12.0), (0.16, 280.0, 0.2), marks=pytest.mark.campaign
        ),
    ],
)
def test_check_prints_the_worst_of_all_hands_and_whose_it_is(
    wall: tuple[float, float],
    slowest: tuple[float, float, float],
    least_damped: tuple[float, float, float],
) -> None:
    """Of the first wall, the hand of the largest radius settles earlier than another one."""
    hands = {"mass": [0.0, 0.16], "stiffness": [0.0, 280.0], "damping": [0.2, 12.0]}
    table = {
        "device": {"mass": 0.46, "damping": 2.5},
        "hand": hands,
        "controller": {"sample_time": 0.001, "delay_samples": 1.0},
        "walls": {"a": {"stiffness": wall[0], "damping": wall[1]}},
    }
    found = check_walls(Scene.from_table(table)).as_json()["walls"]["a"]
    times, modes, distances = {}, {}, []
    for hand in itertools.product(*hands.values()):
        mass, stiffness, damping = hand
        loop = HapticLoop(
            device_mass=0.46,
            device_damping=2.5,
            hand_mass=mass,
            hand_stiffness=stiffness,
            hand_damping=damping,
            sample_time=1e-3,
            delay=1e-3,
        )
        distances.append(float(loop.boundary_distance(*wall)))
        states, _ = march_on_a_fine_grid(loop, *wall, 4000, wall[0] + stiffness, np.zeros(2))
        outside = np.abs(states[::FINE, 0] - 1.0)
        times[hand] = [1e-3 * (np.flatnonzero(outside > band)[-1] + 1) for band in (0.02, 0.05)]
        total = 0.46 + mass
        units = 1e-6 / total, 1e-3 / total, 1e-6 / total, 1e-3 / total
        point = (wall[0], wall[1], stiffness, 2.5 + damping)
        logarithm = mp.log(truth.roots(*(q * u for q, u in zip(point, units, strict=True)), 1.0)[0])
        modes[hand] = float(-logarithm.real / abs(logarithm)), float(abs(logarithm.imag))
    assert max(times, key=lambda hand: times[hand][0]) == slowest
    assert min(modes, key=lambda hand: modes[hand][0]) == least_damped
    assert tuple(found["slowest_hand"].values()) == slowest
    assert tuple(found["least_damped_hand"].values()) == least_damped
    for number, level in enumerate((2, 5)):
        longest = max(time[number] for time in times.values())
        assert found[f"settling_time_{level}_percent"] == pytest.approx(longest, rel=1e-12)
    ratio, angle = modes[least_damped]
    assert found["damping_ratio"] == pytest.approx(ratio, rel=1e-9)
    assert found["frequency"] == pytest.approx(angle / (2e-3 * np.pi), rel=1e-9)
    assert found["distance_to_boundary"] == pytest.approx(min(distances), rel=1e-12)
    assert found["measures_are"] == "the worst of 8 hands"
