"""What README.md shows, works as it stands there."""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import jaxstab

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
START = "import sys; from jaxstab.cli.main import main; main()"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def run(*command: str, folder: Path) -> str:
    completed = subprocess.run(
        [sys.executable, *command], cwd=folder, capture_output=True, text=True, check=False
    )
    assert completed.returncode == 0, completed.stderr
    return completed.stdout


def jaxstab_command(line: str, folder: Path) -> str:
    program, *arguments = shlex.split(line)
    assert program == "jaxstab"
    return run("-c", START, *arguments, folder=folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder where the first command was run, its installation aside."""
    folder = tmp_path_factory.mktemp("readme")
    install, build = blocks("sh")[0].strip().split(" && ")
    assert install == "python -m pip install ."
    said = jaxstab_command(build, folder)
    (folder / "said").write_text(said)
    return folder


@pytest.mark.campaign
def test_the_main_job_writes_one_file_and_says_how_to_ask_it(folder: Path) -> None:
    said = (folder / "said").read_text()
    assert [path.name for path in folder.glob("*.h5")] == ["atlas.h5"]
    answer = jaxstab_command(said.splitlines()[-1], folder)
    assert "stable" in answer


@pytest.mark.campaign
def test_the_atlas_of_the_main_job_holds_the_haptic_range(folder: Path) -> None:
    atlas = jaxstab.open_atlas(folder / "atlas.h5")
    assert atlas.delays.tolist() == [0.0, 1.0, 2.0, 3.0]
    nodes = atlas.nodes(0)
    assert (nodes["gamma"][0], nodes["gamma"][-1]) == (0.0, 1e-3)
    assert (nodes["delta"][0], nodes["delta"][-1]) == (0.0, 0.015)


@pytest.mark.campaign
def test_the_query_answers(folder: Path) -> None:
    header, answer = jaxstab_command(blocks("sh")[1].strip(), folder).splitlines()
    row = dict(zip(header.split(","), answer.split(","), strict=True))
    assert row["verdict"] == "stable"


def lines_of_python() -> Iterator[object]:
    """Each block; one that opens the atlas of the main job belongs to the campaign."""
    for code in blocks("python"):
        marks = [pytest.mark.campaign] if "open_atlas" in code else []
        yield pytest.param(code, marks=marks, id=code.splitlines()[-1])


@pytest.mark.parametrize("code", list(lines_of_python()))
def test_the_lines_of_python_run(code: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    folder = request.getfixturevalue("folder") if "open_atlas" in code else tmp_path
    printed = run("-c", code, folder=folder).splitlines()
    promised = re.findall(r"print\(.*\)\s+# ([A-Z]+)$", code, flags=re.MULTILINE)
    assert set(promised) <= set(printed)
    assert len(printed) >= code.count("print(")


def test_pictures_and_pages_are_there() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert target.startswith("http") or (ROOT / target).exists(), target


def test_the_table_is_that_of_the_records() -> None:
    table = run("-m", "benchmarks", "table", folder=ROOT)
    assert table in (ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8")
    lines = [line for line in README.splitlines() if line.startswith("| ") and " per point" in line]
    assert len(lines) == 3
    assert set(lines) <= set(table.splitlines())


def test_the_first_answer_is_what_the_command_prints() -> None:
    (shown,) = re.findall(r"^```\n\$ (jaxstab .*)\n((?:.*\n)+?)```", README, re.MULTILINE)
    assert jaxstab_command(shown[0], ROOT).startswith(shown[1])
