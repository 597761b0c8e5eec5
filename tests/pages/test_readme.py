"""What README.md shows, works as it stands there."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import jaxstab
from benchmarks import record
from benchmarks.table import resolutions, rivals, sizes

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
START = "from jaxstab.__main__ import main; main()"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def run(*command: str, folder: Path, exit_code: int = 0) -> str:
    completed = subprocess.run(
        [sys.executable, *command], cwd=folder, capture_output=True, text=True, check=False
    )
    assert completed.returncode == exit_code, completed.stderr
    return completed.stdout


def jaxstab_command(line: str, folder: Path, exit_code: int = 0) -> str:
    program, *arguments = shlex.split(line)
    assert program == "jaxstab"
    return run("-c", START, *arguments, folder=folder, exit_code=exit_code)


@pytest.mark.campaign
def test_the_main_job_writes_one_file_that_answers(tmp_path: Path) -> None:
    """The first command, its installation aside, and all that asks its atlas."""
    install, limits, build = blocks("sh")[0].strip().split(" && ")
    assert install == "python -m pip install ."
    assert "largest stiffness" in jaxstab_command(limits, tmp_path)
    said = jaxstab_command(build, tmp_path)
    assert [path.name for path in tmp_path.glob("*.h5")] == ["atlas.h5"]
    assert "stable" in jaxstab_command(said.splitlines()[-1], tmp_path)

    atlas = jaxstab.open_atlas(tmp_path / "atlas.h5")
    nodes = atlas.table
    assert (nodes.delay[0], nodes.delay[-1]) == (0.0, 3.0)
    assert (nodes.gamma[0], nodes.gamma[-1]) == (0.0, 1e-3)
    assert (nodes.delta[0], nodes.delta[-1]) == (0.0, 0.015)


def test_the_lines_for_one_loop_run(tmp_path: Path) -> None:
    assert_prints_what_it_promises(blocks("python")[0].split("import jax ")[0], tmp_path)


@pytest.mark.campaign
def test_the_lines_for_the_map_run_behind_them(tmp_path: Path) -> None:
    (lines,) = blocks("python")
    assert_prints_what_it_promises(lines, tmp_path)


def assert_prints_what_it_promises(code: str, folder: Path) -> None:
    printed = run("-c", code, folder=folder).splitlines()
    promised = re.findall(r"print\(.*\)\s+# ([A-Z]+)$", code, flags=re.MULTILINE)
    assert set(promised) <= set(printed)
    assert len(printed) >= code.count("print(")


def test_pictures_and_pages_are_there() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert target.startswith("http") or (ROOT / target).exists(), target


def test_the_tables_are_those_of_the_records() -> None:
    table = run("-m", "benchmarks", "table", folder=ROOT)
    page = (ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8")
    records = record.read_all(record.RESULTS)
    for own in (table, rivals(records), resolutions(records)):
        assert own in page
    assert sizes(records) in README
    (one,) = (record for record in records if record["benchmark"] == "resolution")
    cubic = [row for row in one["rows"] if row["method"] == "cubic"]
    assert 1.2 < max(row["ratio"] for row in cubic) <= 1.3  # as docs/accuracy.md says
    assert max(row["wrong"] for row in cubic) == 0


def test_the_first_answer_is_what_the_command_prints() -> None:
    (shown,) = re.findall(r"^```\n\$ (jaxstab .*)\n((?:.*\n)+?)```", README, re.MULTILINE)
    assert jaxstab_command(shown[0], ROOT).startswith(shown[1])


def test_it_is_one_screen_and_a_half() -> None:
    lines = README.splitlines()
    assert len(lines) <= 70
    assert max(map(len, lines)) <= 120
    assert len(README.split()) <= 600
