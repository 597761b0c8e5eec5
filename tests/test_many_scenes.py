"""Several scenes and sweeps in one process: tables, CSV, JSON, pictures, and what is refused."""

import csv
import json
import re
from pathlib import Path

import pytest
from commands import run

from jaxstab.pictures.scene import comparison_figure
from jaxstab.scene import check_walls
from jaxstab.scene.many import answer_all, sweep_of, variants_of

SCENES = Path(__file__).parents[1] / "data" / "scenes"
OMEGA = ["--device", "omega", "--sample-time", "0.001", "--window-samples", "2"]


def test_a_sweep_has_a_row_for_each_value_and_the_numbers_of_single_scenes() -> None:
    text = run("limits", *OMEGA, "--sweep", "device.mass=0.1:0.3:3", "--csv", "-").stdout
    rows = list(csv.DictReader(text.splitlines()))
    assert [row["device.mass"] for row in rows] == ["0.1", "0.2", "0.3"]
    single = json.loads(run("limits", *OMEGA, "--mass", "0.2", "--json").stdout)
    assert float(rows[1]["best.largest_stiffness"]) == single["best"]["largest_stiffness"]
    assert rows[1]["inputs.velocity"] == single["inputs"]["velocity"]
    assert not any(row["refusal"] for row in rows)


def test_sweeps_combine_and_may_be_words() -> None:
    sweeps = [
        "--sweep",
        "device.mass=0.1,0.4",
        "--sweep",
        "controller.velocity.preset=chai3d,hapkit",
    ]
    table = run("limits", *OMEGA, *sweeps).stdout.splitlines()
    assert re.match(r"device.mass +controller.velocity.preset +best: largest stiffness", table[0])
    assert [line.split()[:2] for line in table[1:]] == [
        ["0.1", "chai3d"],
        ["0.1", "hapkit"],
        ["0.4", "chai3d"],
        ["0.4", "hapkit"],
    ]


def test_several_files_are_compared(tmp_path: Path) -> None:
    files = [SCENES / "phantom.toml", SCENES / "falcon.toml"]
    picture, table = tmp_path / "compared.png", tmp_path / "compared.csv"
    result = run("limits", *files, "--plot", picture, "--csv", table, "--json")
    assert result.exit_code == 0, result.stderr
    answers = json.loads(result.stdout)
    assert [Path(one["scene"]).name for one in answers] == ["phantom.toml", "falcon.toml"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    (first, second) = csv.DictReader(table.read_text(encoding="utf-8").splitlines())
    assert (
        float(first["best.largest_stiffness"]) == answers[0]["answer"]["best"]["largest_stiffness"]
    )
    assert first["walls.too_stiff.at_damping"] == "80.0"
    assert second["walls.too_stiff.at_damping"] == ""


def test_check_ends_with_zero_only_if_all_walls_of_all_scenes_are_stable() -> None:
    wall = ["--wall", "a", "3000", "20", "--csv", "-"]
    stable = run("check", *OMEGA, *wall, "--sweep", "controller.delay_samples=0,1")
    assert stable.exit_code == 0, stable.stderr
    late = run("check", *OMEGA, *wall, "--sweep", "controller.delay_samples=1,40")
    assert late.exit_code == 1
    rows = list(csv.DictReader(late.stdout.splitlines()))
    assert [row["walls.a.verdict"] for row in rows] == ["stable", "unstable"]


def test_checks_of_many_scenes_are_bit_for_bit_those_of_each_alone() -> None:
    table = {
        "device": {"damping": 0.1, "encoder": {"resolution": 1e-5}},
        "hand": {"mass": [0.0, 1.0], "stiffness": [0.0, 400.0]},
        "controller": {"sample_time": 1e-3},
        "walls": {
            "nearly none": {"stiffness": 1e-3, "damping": 10.0},
            "hard": {"stiffness": 4000.0, "damping": 25.0},
        },
    }
    hard = {"hard": table["walls"]["hard"]}
    window = {"velocity": {"window_samples": 3}, "sample_time": 1e-3}
    tables = {
        "soft": table,
        "stiff": {**table, "hand": {"stiffness": 1e6, "damping": 100.0}},
        "filtered": {**table, "controller": window, "walls": hard},
        "no wall": {**table, "walls": {}},
    }
    sweep = {"device.mass": [0.2, -1.0], "controller.delay": [0.0, 0.0025]}
    rows = list(answer_all(variants_of(tables, sweep), check_walls))
    assert sum(row.answer is not None for row in rows) == 6
    for row in rows:
        if row.answer:
            assert row.variant.scene
            assert repr(row.answer) == repr(check_walls(row.variant.scene))
        else:
            assert row.refusal.startswith(("device.mass is -1.0", "walls is empty"))


def test_a_scene_that_is_refused_is_a_row_with_its_sentence_and_exit_code_two() -> None:
    result = run("limits", *OMEGA, "--sweep", "device.mass=0.2,-1.0", "--csv", "-")
    assert result.exit_code == 2
    good, bad = csv.DictReader(result.stdout.splitlines())
    assert good["refusal"] == ""
    assert (
        bad["refusal"]
        == "device.mass is -1.0; give a finite number > 0 in kg, or [lowest, highest]."
    )
    assert result.stderr.startswith("jaxstab: 1 of 2 scenes were refused; the first, device.mass")


@pytest.mark.parametrize(
    "sweep", ["device.mass", "device.mass=", "=1:2:3", "device.mass=1:2", "device.mass=1:2:0.5"]
)
def test_a_bad_sweep_is_one_sentence(sweep: str) -> None:
    result = run("limits", *OMEGA, "--sweep", sweep)
    assert (result.exit_code, result.stdout) == (2, "")
    assert re.fullmatch(r"jaxstab: sweep is .*; give KEY=.*\n", result.stderr)


def test_more_scenes_than_one_process_should_answer_are_refused() -> None:
    values = dict([sweep_of("device.mass=0.1:0.2:1000"), sweep_of("device.damping=0:1:101")])
    with pytest.raises(ValueError, match="the sweep has 101000 scenes; give 100000 at most"):
        variants_of({"": {}}, values)


def test_a_picture_of_scenes_compares_over_numbers_or_by_name() -> None:
    table = {"device": {"preset": "omega"}, "controller": {"sample_time": 1e-3}}
    numbers = variants_of({"": table}, dict([sweep_of("device.mass=0.1:0.3:3")]))
    assert comparison_figure(numbers).axes[1].get_xlabel() == "device.mass"
    names = variants_of({"": table}, {"device.preset": ["omega", "phantom"]})
    ticks = comparison_figure(names).axes[1].get_yticklabels()
    assert [tick.get_text() for tick in ticks] == ["omega", "phantom"]
    turning = {**table, "device": {"inertia": 0.1, "damping": 0.1}}
    with pytest.raises(ValueError, match="linear and rotational scenes"):
        comparison_figure(variants_of({"a": table, "b": turning}, {}))
