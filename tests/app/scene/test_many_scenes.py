"""Several scenes in one process: tables, CSV, JSON, a picture, and what is refused."""

import csv
import json
from pathlib import Path

import pytest
from commands import assert_one_sentence, run

from jaxstab.app.pictures.scene import comparison_figure
from jaxstab.app.scene import Scene

SCENES = Path(__file__).parents[3] / "data" / "scenes"
SCENE = "[device]\nmass = {mass}\ndamping = 0.1\n[controller]\nsample_time = 0.001\n"
WALL = ["--wall", "a", "3000", "20", "--csv", "-"]


def scenes(folder: Path, *masses: float) -> list[Path]:
    """Files of scenes that differ in the mass of the device."""
    files = [folder / f"{mass}.toml" for mass in masses]
    for file, mass in zip(files, masses, strict=True):
        file.write_text(SCENE.format(mass=mass))
    return files


def test_several_files_are_compared(tmp_path: Path) -> None:
    files = [SCENES / "phantom.toml", SCENES / "falcon.toml"]
    picture, table = tmp_path / "compared.png", tmp_path / "compared.csv"
    result = run("limits", *files, "--plot", picture, "--csv", table, "--json")
    assert result.exit_code == 1, result.stderr  # a wall of each is outside
    answers = json.loads(result.stdout)
    assert [Path(one["scene"]).name for one in answers] == ["phantom.toml", "falcon.toml"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    (first, second) = csv.DictReader(table.read_text(encoding="utf-8").splitlines())
    assert (
        float(first["best.largest_stiffness"]) == answers[0]["answer"]["best"]["largest_stiffness"]
    )
    assert first["walls.too_stiff.damping"] == "80.0"
    assert second["walls.too_stiff.damping"] == ""
    assert not first["refusal"] + second["refusal"]


def test_a_row_has_the_numbers_of_its_scene_alone(tmp_path: Path) -> None:
    files = scenes(tmp_path, 0.1, 0.2)
    rows = list(csv.DictReader(run("limits", *files, "--csv", "-").stdout.splitlines()))
    assert [row["scene"] for row in rows] == list(map(str, files))
    single = json.loads(run("limits", files[1], "--json").stdout)
    assert float(rows[1]["best.largest_stiffness"]) == single["best"]["largest_stiffness"]
    assert rows[1]["inputs.velocity"] == single["inputs"]["velocity"]


def test_check_ends_with_zero_only_if_all_walls_of_all_scenes_are_stable(tmp_path: Path) -> None:
    stable = run("check", *scenes(tmp_path, 0.2, 0.3), *WALL)
    assert stable.exit_code == 0, stable.stderr
    light = run("check", *scenes(tmp_path, 0.2, 0.001), *WALL)
    assert light.exit_code == 1
    rows = list(csv.DictReader(light.stdout.splitlines()))
    assert [row["walls.a.verdict"] for row in rows] == ["stable", "unstable"]


def test_a_scene_that_is_refused_is_a_row_with_its_sentence_and_exit_code_two(
    tmp_path: Path,
) -> None:
    result = run("limits", *scenes(tmp_path, 0.2, -1.0), "--csv", "-")
    assert result.exit_code == 2
    good, bad = csv.DictReader(result.stdout.splitlines())
    assert good["refusal"] == ""
    assert bad["refusal"].startswith("device.mass is -1.0")
    assert_one_sentence(result.stderr, "1 of 2", tmp_path / "-1.0.toml", bad["refusal"])


def test_a_scene_without_an_answer_is_a_row_with_the_reason(tmp_path: Path) -> None:
    files = scenes(tmp_path, 0.2, 0.3)
    files[0].write_text(files[0].read_text() + "[walls.a]\nstiffness = 100.0\ndamping = 5.0\n")
    result = run("check", *files)
    assert result.exit_code == 2
    assert "stable" in result.stdout
    assert "walls is empty" in result.stderr


def test_a_picture_of_scenes_has_their_names() -> None:
    table = {"device": {"preset": "omega"}, "controller": {"sample_time": 1e-3}}
    phantom = {**table, "device": {"preset": "phantom"}}
    two = {"omega": Scene.from_table(table), "phantom": Scene.from_table(phantom)}
    ticks = comparison_figure(two).axes[1].get_yticklabels()
    assert [tick.get_text() for tick in ticks] == ["omega", "phantom"]
    turning = {**table, "device": {"inertia": 0.1, "damping": 0.1}}
    with pytest.raises(ValueError, match="linear and rotational scenes"):
        comparison_figure({**two, "turning": Scene.from_table(turning)})
