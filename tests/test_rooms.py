"""Each room of the lab can be deleted, and all of them: the rest imports and answers without."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LAB = ROOT / "jaxstab" / "lab"
ROOMS = re.findall(r"(?m)^from \. import (\w+) as", (LAB / "__init__.pyi").read_text("utf-8"))
PYTEST = [
    "-m",
    "pytest",
    "-n0",
    "-q",
    "--collect-only",
    "-o",
    f"cache_dir={ROOT / '.pytest_cache'}",
]

QUESTIONS = """
import jaxstab
loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
assert loop.verdict(20000.0, 20.0)
assert loop.limits().stiffness > 20000.0
assert loop.margins(2000.0, 20.0).extra_delay > 0.0
loop.region().plot()
from jaxstab.lab import {}
"""


@pytest.fixture
def without(tmp_path: Path) -> Callable[[Sequence[str]], Path]:
    """Copies the repository without some rooms and their tests."""

    def copied(rooms: Sequence[str]) -> Path:
        names = "jaxstab", "tests", "data", "docs", "benchmarks", "pyproject.toml", "README.md"
        for name in names:
            source, target = ROOT / name, tmp_path / name
            if name in ("jaxstab", "tests"):
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                target.symlink_to(source)
        for room in rooms:
            shutil.rmtree(tmp_path / "tests" / "lab" / room)
            place = tmp_path / "jaxstab" / "lab" / room
            shutil.rmtree(place) if place.is_dir() else place.with_suffix(".py").unlink()
        return tmp_path

    return copied


def python(folder: Path, words: Sequence[str | Path]) -> str:
    done = subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder), "MPLBACKEND": "Agg"},
        check=False,
    )
    assert done.returncode in (0, 1), (words, done.stdout[-2000:], done.stderr[-2000:])
    return done.stdout


def test_every_room_has_a_test_of_its_own() -> None:
    assert set(ROOMS) == {path.name for path in (ROOT / "tests" / "lab").iterdir() if path.is_dir()}


@pytest.mark.campaign
@pytest.mark.parametrize("room", ROOMS)
def test_no_room_of_the_lab_nor_its_tests_import_another(
    room: str, without: Callable[[Sequence[str]], Path]
) -> None:
    folder, others = without([room]), sorted(set(ROOMS) - {room})
    python(folder, ["-c", QUESTIONS.format(", ".join(others))])
    said = python(folder, [*PYTEST, *(folder / "tests" / "lab" / other for other in others)])
    assert "error" not in said, said
    for other in others:
        assert f"tests/lab/{other}/" in said


@pytest.mark.campaign
def test_commands_answer_without_any_room_of_the_lab(
    without: Callable[[Sequence[str]], Path],
) -> None:
    folder = without(ROOMS)
    assert "limits" in python(folder, ["-m", "jaxstab", "--help"])
    scene = folder / "data" / "scenes" / "phantom.toml"
    for command in ("limits", "check", "tune"):
        assert "stable" in python(folder, ["-m", "jaxstab", command, scene])
