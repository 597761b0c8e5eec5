"""What is published says the same of itself everywhere; `.ci/release` tries it out."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import yaml

import jaxstab

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def loaded(path: str) -> Any:
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


def test_the_citation_is_of_this_version() -> None:
    citation = loaded("CITATION.cff")
    assert citation["version"] == jaxstab.__version__
    assert citation["license"] == PROJECT["license"]
    assert {"cff-version", "message", "title", "authors"} <= set(citation)


def test_every_dependency_has_a_lowest_version() -> None:
    for requirement in PROJECT["dependencies"]:
        assert re.fullmatch(r"[a-z0-9-]+>=[0-9.]+", requirement), requirement


def test_the_changelog_has_a_place_for_what_comes_next() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    heads = re.findall(r"^## \[(.+?)\]", text, re.MULTILINE)
    assert heads[0] == "Unreleased"
    assert len(set(heads)) == len(heads)


def test_answers_need_neither_assertions_nor_docstrings() -> None:
    code = (
        "import jaxstab; loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, "
        "sample_time=1e-3, delay=1e-3); print(round(loop.limits().stiffness, -2))"
    )
    done = subprocess.run(
        [sys.executable, "-OO", "-c", code], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr) == ("36200.0\n", "")
