"""What is published says the same of itself everywhere; `.ci/release` tries it out."""

import re
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


def test_the_badges_say_what_is_so() -> None:
    said = {
        path.stem: re.findall(r"<text[^>]*>(.+?)</text>", path.read_text(encoding="utf-8"))[1]
        for path in (ROOT / "docs" / "badges").glob("*.svg")
    }
    lowest = PROJECT["requires-python"].removeprefix(">=")
    assert said.pop("python") == f"{lowest} or newer"
    assert said.pop("license") == PROJECT["license"]
    assert said.pop("typed") == "checked by mypy --strict"  # test_house runs it
    assert (ROOT / "jaxstab" / "py.typed").exists()
    assert said == {}
