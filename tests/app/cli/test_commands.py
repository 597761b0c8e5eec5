"""What all commands have in common: exit codes, outputs, warnings, and what is refused."""

import csv
import json
import subprocess
import sys
import warnings
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from atlases import SMALL_TOML, write_small
from commands import EXAMPLE, POINT, START, assert_one_sentence, run, run_process

from jaxstab import HapticLoop, Velocity, durable
from jaxstab.app.cli.main import main
from jaxstab.app.scene import Scene, design_loop
from jaxstab.app.scene.loops import loop_of
from jaxstab.region.pieces import others_inside

OMEGA = ["--device", "omega", "--sample-time", "0.001", "--delay", "0.001"]
HANDS = ["--hand-mass", "0:0.2"]
GOOD, BAD = ["--wall", "good", "1000", "10"], ["--wall", "bad", "90000", "10"]
SLOW = ["--mass", "0.1", "--damping", "0", "--sample-time", "0.001", "--delay", "0"]
JOINT = str(Path(__file__).parents[3] / "data" / "scenes" / "gains" / "simulator.toml")
ARM = str(Path(__file__).parents[3] / "data" / "robots" / "arm.xml")
LATE = [*SLOW[:-1], "0.001", "--hand-stiffness", "80000"]  # spring and damper feed the hand's mode


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder, the current one, with an atlas, its specification, a scene and a damaged atlas."""
    write_small(tmp_path)
    (tmp_path / "spec.toml").write_text(SMALL_TOML, encoding="utf-8")
    (tmp_path / "scene.toml").write_text(EXAMPLE, encoding="utf-8")
    (tmp_path / "damaged.h5").write_bytes((tmp_path / "small.h5").read_bytes()[:-1])
    monkeypatch.chdir(tmp_path)
    return tmp_path


COMMANDS: list[tuple[str, list[str], int]] = [
    ("limits", OMEGA, 0),
    ("limits", [*OMEGA, *HANDS], 0),
    ("limits", [*OMEGA, *GOOD], 0),
    ("limits", [*OMEGA, *GOOD, *BAD], 1),
    ("limits", [*OMEGA[:4], "--delay", "0:0.001", *GOOD], 0),
    ("limits", [*OMEGA[:4], "--delay", "0:0.001", *GOOD, *BAD], 1),
    ("limits", LATE, 1),
    ("limits", [*LATE, *GOOD, "--at-damping", "10"], 1),
    ("limits", [*OMEGA, "--mass", "-1"], 2),
    ("limits", [*OMEGA, "--json", "--csv", "-"], 2),
    ("limits", [JOINT, "--set", "gains.soft.kp=10"], 1),  # the other pair is not stable
    ("check", [JOINT, "--set", "gains.stiff.kp=3500"], 0),
    ("check", [JOINT], 1),
    ("tune", [JOINT, "--set", "loop.integrator=implicit", "--set", "loop.substeps=1"], 1),
    ("design", [JOINT], 0),
    ("design", [JOINT, "--set", "wanted.kp=1e12", "--set", "loop.substeps=1000"], 1),
    ("explore", [JOINT], 2),
    ("check", [*OMEGA, *GOOD], 0),
    ("check", [*OMEGA, *GOOD, *BAD], 1),
    ("check", ["scene.toml", "scene.toml", *GOOD, *BAD], 1),
    ("check", OMEGA, 2),
    ("contact", [*OMEGA, *GOOD, "--push", "1", "--friction", "0.1"], 0),
    ("contact", [*OMEGA, *BAD, "--speed", "0.1", "--push", "1"], 1),
    ("contact", [*OMEGA, *GOOD], 2),
    ("study", [*OMEGA, *GOOD, "--over", "device.mass=0.2,0.3", "-o", "study.h5"], 0),
    ("study", [*OMEGA, *GOOD, "--over", "device.mass=0.2,x", "-o", "study.h5"], 2),
    ("tune", [*OMEGA, *GOOD], 0),
    ("tune", [*OMEGA, *GOOD, *HANDS], 0),
    ("tune", [*OMEGA, *BAD], 1),
    ("tune", LATE, 1),
    ("tune", [*OMEGA, "--at-stiffness", "-1"], 2),
    ("design", [*OMEGA, "--stiffness", "1000"], 0),
    ("design", [*OMEGA, "--stiffness", "1e8"], 1),
    ("design", OMEGA, 2),
    ("scene explain", ["scene.toml"], 0),
    ("scene explain", ["none.toml"], 2),
    ("scene init", [], 0),
    ("scene init", ["-o", "scene.toml"], 2),
    ("scene presets", [], 0),
    ("scene presets", ["more"], 2),
    ("identify", ["--help"], 0),  # tests/lab/identify/test_identify.py fits logs
    ("identify", ["none.csv"], 2),
    ("joints", [ARM, "--simulated"], 0),
    ("joints", [ARM, "--rate", "500", "--delay", "2e-3"], 1),
    ("joints", [ARM], 2),
    ("joints", [ARM, "--simulated", "--json", "--csv", "-"], 2),
    ("explore", ["scene.toml"], 0),
    ("explore", ["none.toml"], 2),
    ("files", [], 0),
    ("files", ["more"], 2),
    ("guard", ["--help"], 0),  # tests/lab/guard/test_guard.py builds some
    ("guard", [*OMEGA, "-o", "none/g.h"], 2),
    ("region", ["--gamma", "0", "--delta", "0"], 0),
    ("region", ["--gamma", "-1", "--delta", "0"], 2),
    ("figure", ["4"], 0),
    ("figure", ["3"], 2),
    ("atlas spec", ["--scene", "scene.toml"], 0),
    ("atlas spec", ["--scene", "spec.toml"], 2),
    ("atlas build", ["--spec", "spec.toml"], 0),
    ("atlas build", ["--spec", "scene.toml"], 2),
    ("atlas info", ["small.h5"], 0),
    ("atlas info", ["damaged.h5"], 2),
    ("atlas verify", ["small.h5", "--sample", "1"], 0),
    ("atlas verify", ["none.h5"], 2),
    ("atlas query", ["small.h5", *POINT], 0),
    ("atlas query", ["small.h5", *POINT, "--alpha", "9"], 1),
    ("atlas query", ["none.h5", *POINT], 2),
    ("atlas plot", ["small.h5", "-o", "a.png"], 0),
    ("atlas plot", ["small.h5", "-o", "a.pdf"], 2),
]
LONG = {"atlas plot", "design"}  # commands of which some take seconds


def commands_of(group: click.Group, prefix: str = "") -> Iterator[str]:
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands_of(command, f"{prefix}{name} ")
        else:
            yield prefix + name


def test_the_table_of_exit_codes_has_every_command() -> None:
    assert {name for name, *_ in COMMANDS} == set(commands_of(main))


@pytest.mark.parametrize(
    ("name", "arguments", "code"),
    [
        pytest.param(*asked, marks=pytest.mark.campaign) if asked[0] in LONG else asked
        for asked in COMMANDS
    ],
    ids=[f"{name}-{code}-{number}" for number, (name, _, code) in enumerate(COMMANDS)],
)
def test_exit_codes(name: str, arguments: list[str], code: int, folder: Path) -> None:
    answer = run(*name.removesuffix(" answer").split(), *arguments)
    assert answer.exit_code == code, answer.stderr
    if code == 2:
        assert answer.stdout == ""
        assert_one_sentence(answer.stderr)


def test_a_fault_of_ours_does_not_end_like_an_unstable_wall(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(_: Scene, **__: Any) -> Any:
        raise ZeroDivisionError

    monkeypatch.setattr("jaxstab.app.scene.check_walls", broken)
    answer = run("check", *OMEGA, *GOOD)
    assert (answer.exit_code, "ZeroDivisionError" in answer.stderr) == (2, True)


# --------------------------------------------------------------------------------------- warnings


@pytest.mark.parametrize("command", ["limits", "check", "tune"])
def test_a_delay_that_is_assumed_is_said_beside_the_estimator(command: str) -> None:
    arguments = [command, *OMEGA[:4], *GOOD]
    lines = run(*arguments).stdout.splitlines()
    assert lines[0].startswith("velocity ")
    assert lines[1].split(maxsplit=1) == ["delay", "0 (assumed: the scene names none)"]
    inputs = json.loads(run(*arguments, "--json").stdout)["inputs"]
    assert (inputs["delay"], inputs["delay_is"]) == (0.0, "assumed: the scene names none")
    given = run(*arguments, "--delay", "0").stdout.splitlines()[1]
    assert given.split(maxsplit=1) == ["delay", "0 s (0 samples)"]


def test_a_device_without_damping_has_none_and_says_so() -> None:
    words = ("limits", "--mass", "0.3", "--rate", "1000", "--delay", "0.001")
    assumed, given = run(*words), run(*words, "--damping", "0")
    said = [line for line in assumed.stdout.splitlines() if line not in given.stdout.splitlines()]
    assert [line.split(maxsplit=2) for line in said] == [
        ["device", "damping", "0 (assumed: the scene names none)"]
    ]


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--delay-samples", "3e-4"], 0, "the delay is 0.0003 samples; one in s is given as delay"),
        (["--wall", "a", "3", "0.1"], 0, "walls.a.stiffness is 3 N/m; is it in N/mm?"),
        (["--wall", "a", "2", "5000"], 1, "damping of 5000 N s/m beside a stiffness of 2 N/m; are"),
    ],
)
def test_slips_of_units_are_one_line_on_stderr(options: list[str], code: int, words: str) -> None:
    answer = run("limits", *OMEGA[:4], *options)
    assert answer.exit_code == code
    assert answer.stderr.startswith("jaxstab: warning: ")
    assert answer.stderr.count("\n") == 1
    assert words in answer.stderr
    usual = run("limits", *OMEGA, *GOOD, "--wall", "damper", "0", "5")
    assert usual.stderr == ""


def test_masses_in_grams_are_remarked_on() -> None:
    scene = Scene.from_table({"device": {"mass": [144.0, 225.0], "damping": 0.1}, **CONTROLLER})
    assert "device.mass is 144 kg, usual are 0.001 to 50 kg" in scene.unusual()


CONTROLLER = {"controller": {"sample_time": 1e-3}}


def test_a_delay_in_samples_is_refused_by_the_loop() -> None:
    fields = {"device_mass": 0.1, "device_damping": 1.0, "sample_time": 1e-3}
    with pytest.raises(ValueError, match="a delay in samples is multiplied by sample_time"):
        HapticLoop(**fields, delay=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        HapticLoop(**fields, delay=0.4)


# ---------------------------------------------------------------------------------------- refused


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["limits", "--device", "omega.7", *OMEGA[2:]], "'omega.7'; did you mean 'omega'?"),
        (["limits", "--device", "Omega", *OMEGA[2:]], "'Omega'; did you mean 'omega'?"),
        (["limits", "--device", "foo", *OMEGA[2:]], "device.preset is 'foo'; give phantom, omega"),
        (["limits"], "no scene is given; give the FILE of one"),
        (["check"], "no scene is given; give the FILE of one"),
        (["guard", "-o", "g.h"], "no scene is given; give the FILE of one"),
        (["limits", "small.h5"], "small.h5 is HDF5, not text; jaxstab atlas info"),
        (["check", "spec.toml"], "the specification of an atlas; jaxstab atlas build"),
        (["atlas", "build", "--spec", "scene.toml"], "is a scene; jaxstab limits"),
        (
            ["study", *OMEGA, "--over", "device.mas=0.1:0.5:20"],
            "jaxstab: device.mas is unknown; did you mean 'mass'?\n",
        ),
    ],
)
def test_what_is_misspelt_or_of_another_kind_is_named(
    arguments: list[str], words: str, folder: Path
) -> None:
    answer = run(*arguments)
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert words in answer.stderr


# ---------------------------------------------------------------------------------------- outputs


OUTPUTS = [
    ["limits", *OMEGA, "--csv", "none/a.csv"],
    ["limits", *OMEGA, "--plot", "none/a.png"],
    ["check", *OMEGA, *GOOD, "--csv", "none/a.csv"],
    ["study", *OMEGA, "--over", "device.mass=0.1,0.2", "--csv", "none/a.csv"],
    ["study", *OMEGA, "--over", "device.mass=0.1,0.2", "-o", "none/a.h5"],
    ["tune", *OMEGA, "--csv", "none/a.csv"],
    ["design", *OMEGA, "--stiffness", "1000", "--csv", "none/a.csv"],
    ["scene", "init", "-o", "none/a.toml"],
    ["explore", "scene.toml", "-o", "none/a.html"],
    ["guard", *OMEGA, "-o", "none/a.h"],
    ["guard", *OMEGA, "-o", "a.h", "--plot", "none/a.png"],
    ["region", "--gamma", "0", "--delta", "0", "-o", "none/a.png"],
    ["atlas", "build", "--spec", "spec.toml", "-o", "none/a.h5"],
    ["atlas", "plot", "small.h5", "-o", "none/a.png"],
]


@pytest.mark.parametrize("arguments", OUTPUTS, ids=lambda words: "-".join(words[:2]))
def test_a_folder_that_does_not_exist_is_refused_before_the_work(
    arguments: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for work in ("scene_limits", "check_walls", "tune_walls", "design_loop"):
        monkeypatch.delattr(f"jaxstab.app.scene.{work}", raising=False)
    monkeypatch.setattr("jaxstab.lab.guard.build_guard", None)
    answer = run(*arguments)
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert f"the folder {folder / 'none'} does not exist" in answer.stderr


@pytest.mark.campaign
def test_a_figure_makes_its_folder_and_files_are_named(folder: Path) -> None:
    figure = run("figure", "4", "-o", "new/folder")
    assert figure.stdout == "new/folder/figure_4.png\n"
    assert (folder / "new/folder/figure_4.png").read_bytes().startswith(b"\x89PNG")
    assert "not the name of a folder" in run("figure", "4", "-o", "a.png").stderr
    answer = run("limits", *OMEGA, "--plot", "a.png", "--json")
    assert json.loads(answer.stdout)
    assert answer.stderr == "jaxstab: wrote a.png\n"
    region = run("region", "--gamma", "0", "--delta", "0", "-o", "b.png")
    assert region.stderr == "jaxstab: wrote b.png\n"
    assert run("limits", *OMEGA, "--csv", "a.csv").stderr == "jaxstab: wrote a.csv\n"
    assert run("scene", "init", "-o", "new.toml").stdout == "new.toml\n"
    assert run("atlas", "plot", "small.h5", "-o", "c.png").stdout == "c.png\n"


def test_pairs_are_two_columns_of_csv() -> None:
    arguments = ["check", *OMEGA, *HANDS, *GOOD]
    (row,) = csv.DictReader(run(*arguments, "--csv", "-").stdout.splitlines())
    table = json.loads(run(*arguments, "--json").stdout)
    low, high = table["walls"]["good"]["stiffness_limits"]
    assert float(row["walls.good.stiffness_limits_low"]) == low
    assert float(row["walls.good.stiffness_limits_high"]) == high
    assert float(row["inputs.hand_mass_high"]) == 0.2
    assert not any("[" in cell for cell in row.values())


@pytest.mark.parametrize(
    "arguments",
    [
        ["limits", *OMEGA, *HANDS, *GOOD, "--at-damping", "5"],
        ["limits", *OMEGA, "--window-samples", "20", "--delay", "0"],
        ["check", *OMEGA, *HANDS, *GOOD],
        ["tune", *OMEGA, *GOOD],
        ["design", *OMEGA, "--stiffness", "1000"],
    ],
    ids=" ".join,
)
def test_json_has_inputs_units_and_one_style_of_keys(arguments: list[str], folder: Path) -> None:
    answer = json.loads(run(*arguments, "--json").stdout)
    inputs, units = answer.pop("inputs"), answer.pop("units")
    assert inputs.keys() >= {"velocity", "sample_time", "delay", "delay_samples", "mass", "damping"}
    assert inputs["delay"] == inputs["delay_samples"] * inputs["sample_time"]
    numbers = set()

    def walk(table: dict[str, Any], names: bool = False) -> None:
        for name, value in table.items():
            assert names or (name.isidentifier() and name.islower()), name
            if isinstance(value, dict):
                walk(value, name in ("walls", "islands", "windows", "answers"))
            elif not isinstance(value, str):
                numbers.add(name)

    walk(inputs)
    walk(answer)
    assert numbers == units.keys()
    assert units["delay"] == units["sample_time"] == "s"
    assert set(units.values()) <= {"1", "s", "m", "kg", "Hz", "N", "N/m", "N s/m", "degrees"}


def test_units_are_those_of_rotation() -> None:
    wheel = ["--inertia", "0.02", "--damping", "0.02", "--sample-time", "0.001"]
    walls = ["--hand-inertia", "0:0.05", "--wall", "mass", "1", "0.05"]
    answer = json.loads(run("limits", *wheel, *walls, "--json").stdout)
    assert answer["inputs"]["inertia"] == [0.02, 0.02]
    assert answer["inputs"]["hand_inertia"] == [0.0, 0.05]
    assert answer["units"]["largest_stiffness"] == "N m/rad"
    assert "mass" in answer["walls"]  # a name, not a quantity


@pytest.mark.parametrize(
    "arguments",
    [
        ["region", "--gamma", "0", "--delta", "0.015", "--delay", "1", "--json"],
        ["region", "--gamma", "0", "--delta", "0.015", "--radius", "0.9", "--json"],
        ["atlas", "query", "small.h5", *POINT, "--format", "json"],
    ],
    ids=" ".join,
)
def test_json_of_regions_and_of_atlases_has_inputs_and_units(
    arguments: list[str], folder: Path
) -> None:
    """Regions had their inputs between their results; queries were a list of rows alone."""
    answer = json.loads(run(*arguments).stdout)
    inputs, units = answer.pop("inputs"), answer.pop("units")
    assert inputs["velocity"] == "the difference over a window of 1 sample"
    (found,) = answer.pop("points", [answer])
    numbers = (inputs | found).items()
    assert [*units] == [name for name, value in numbers if isinstance(value, float | list)]
    assert set(units.values()) == {"1"}
    given = pairwise(arguments)
    asked = {name[2:]: float(value) for name, value in given if name[2:] in units}
    assert asked.items() <= (inputs | found).items()


# ---------------------------------------------------------------------------------------- streams


def in_a_shell(redirection: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", "-c", f'"$@" {redirection}', "sh", sys.executable, "-c", START, *arguments],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.campaign
def test_closed_streams(folder: Path) -> None:
    check = ["check", *OMEGA, *GOOD]
    closed = in_a_shell("2>&-", *check)
    assert (closed.returncode, closed.stdout) == (0, run_process(*check).stdout)
    assert in_a_shell("2>&-", "check", *OMEGA, *BAD).returncode == 1
    assert in_a_shell("2>&-", "limits").returncode == 2
    query = in_a_shell("<&-", "atlas", "query", "small.h5", "--csv", "-")
    assert (query.returncode, query.stdout) == (2, "")
    assert_one_sentence(query.stderr)
    assert "stdin is closed" in query.stderr


def test_a_design_whose_largest_delay_is_none_at_all() -> None:
    device = {
        "mass": 0.25,
        "damping": 0.1,
        "actuator": {"bandwidth": 200.0},
        "modes": [{"frequency": 80.0, "damping_ratio": 0.02, "modal_mass": 1.5}],
    }
    controller = {"sample_time": 1e-3, "delay": 0.0, "velocity": {"cutoff": 100.0}}
    table = {"device": device, "controller": controller}
    largest = loop_of(Scene.from_table(table)).limits().stiffness
    wanted = {"stiffness": largest * (1.0 - 1e-12)}
    found = design_loop(Scene.from_table({**table, "wanted": wanted}))
    assert 0.0 <= found.delay.largest_delay < 1e-9
    assert 0.998e-3 < found.sample_time.largest_sample_time <= 1e-3


def test_a_scene_is_written_whole_or_not_at_all(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int, data: bytes) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(durable, "write_all", full)
        answer = run("scene", "init", "-o", "new.toml")
    assert (answer.exit_code, "No space left" in answer.stderr) == (2, True)
    assert not [entry for entry in folder.iterdir() if "new.toml" in entry.name]
    assert run("scene", "init", "-o", "new.toml").exit_code == 0
    assert (folder / "new.toml").read_text(encoding="utf-8") == EXAMPLE
    assert run("scene", "init", "-o", "new.toml").exit_code == 2


def test_many_angles_are_divided(monkeypatch: pytest.MonkeyPatch) -> None:
    """A design that tried long delays recurred without end: one row of angles was never halved."""
    loop = HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=1e-3, velocity=Velocity.difference(5)
    )
    c = loop.region().region.curve
    theta = np.linspace(0.01, 3.0, 40)
    whole = others_inside(c, theta)
    for at_once in (4 * c.degree, 1):
        monkeypatch.setattr("jaxstab.region.pieces._AT_ONCE", at_once)
        assert (others_inside(c, theta) == whole).all()
    assert 0 < whole.sum() < whole.size


@pytest.mark.parametrize(
    ("command", "option", "users"),
    [
        *(
            (name, (option, "1"), "check, contact")
            for name in ("limits", "study", "guard", "tune")
            for option in ("--push", "--speed", "--friction")
        ),
        ("guard", ("--wall", "a", "1", "1"), "limits, check, contact, tune, design, study"),
        ("guard", ("--gains", "1", "1"), "limits, check, contact, tune, design, study, joints"),
        ("guard", ("--json",), "limits, check, contact, tune, design, joints, region"),
        ("guard", ("--csv", "-"), "limits, check, contact, tune, design, study, joints"),
    ],
)
def test_an_option_that_changes_nothing_is_refused_with_who_has_it(
    command: str, option: tuple[str, ...], users: str
) -> None:
    """limits, study, guard, tune and design took --push, --speed and --friction without effect."""
    answer = run(command, *option)
    assert answer.exit_code == 2
    assert_one_sentence(answer.stderr)
    assert f"No such option '{option[0]}'" in answer.stderr
    assert answer.stderr.endswith(f"It is an option of {users}.\n")
    assert option[0] not in run(command, "--help").stdout.split()
