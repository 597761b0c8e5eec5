"""Each room of the lab can be deleted: the rest imports, answers and passes tests without it."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LAB = ROOT / "jaxstab" / "lab"
ROOMS = re.findall(r"(?m)^from \. import (\w+) as", (LAB / "__init__.pyi").read_text("utf-8"))
TESTS = {  # some of each room, which take seconds
    "guard": ("test_guard.py", "refused and not command"),
    "study": ("test_study.py", "as_texts or one_unit or needs_no_list"),
    "identify": ("test_identify.py", "slip or sample_time"),
    "joints": ("test_joints.py", "least_inertia_is_the_known_one or not_affine"),
    "contact": ("test_contact.py", "bad_input or slides"),
}

PYTEST = [
    "-m",
    "pytest",
    "-n0",
    "-q",
    "-o",
    f"cache_dir={ROOT / '.pytest_cache'}",
    "-m",
    "not campaign",
]

QUESTIONS = """
import jaxstab
loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
assert loop.verdict(20000.0, 20.0)
assert loop.limits().stiffness > 20000.0
assert loop.margins(2000.0, 20.0).extra_delay > 0.0
loop.region().plot()
"""


@pytest.fixture(params=ROOMS)
def without(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str]:
    """A copy of the repository, in which a room and its tests are missing; the room's name."""
    for name in ("jaxstab", "tests", "data", "docs", "benchmarks", "pyproject.toml", "README.md"):
        source, target = ROOT / name, tmp_path / name
        if name in ("jaxstab", "tests"):
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            target.symlink_to(source)
    room: str = request.param
    shutil.rmtree(tmp_path / "tests" / "lab" / room)
    place = tmp_path / "jaxstab" / "lab" / room
    shutil.rmtree(place) if place.is_dir() else place.with_suffix(".py").unlink()
    return tmp_path, room


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
def test_a_room_of_the_lab_can_be_deleted(without: tuple[Path, str]) -> None:
    folder, room = without
    python(folder, ["-c", QUESTIONS])
    assert "limits" in python(folder, ["-m", "jaxstab", "--help"])
    for command in ("limits", "check", "tune"):
        scene = folder / "data" / "scenes" / "phantom.toml"
        assert "stable" in python(folder, ["-m", "jaxstab", command, scene])
    others = {other: TESTS[other] for other in sorted(set(ROOMS) - {room})}
    files = [folder / "tests" / "lab" / other / file for other, (file, _) in others.items()]
    chosen = (f"({Path(file).stem} and ({words}))" for file, words in others.values())
    said = python(folder, [*PYTEST, "-v", *files, "-k", " or ".join(chosen)])
    assert "failed" not in said, said
    for other, (file, _) in others.items():
        assert re.search(rf"{other}/{file} \.+", said), said
