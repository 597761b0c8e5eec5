"""The page of the rooms names what is there, and the table of engines stands in the code, too."""

import re
from importlib import import_module
from pathlib import Path

import pytest

import jaxstab.loop
from jaxstab import HapticLoop

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
TABLE = re.findall(r"(?m)^\|.*\|$", PAGE)


def test_the_table_of_engines_is_that_of_the_code() -> None:
    assert re.findall(r"(?m)^\|.*\|$", jaxstab.loop.__doc__ or "") == TABLE


@pytest.mark.parametrize("module", re.findall(r"`(\w+\.\w+)[`:]", "".join(TABLE)))
def test_each_engine_is_a_module(module: str) -> None:
    assert import_module(f"jaxstab.{module}").__doc__


@pytest.mark.parametrize("row", TABLE[2:], ids=lambda row: row.split("|")[1].strip())
def test_each_answer_is_a_method_of_a_loop(row: str) -> None:
    for name in re.findall(r"`(\w+)`", row.split("|")[1]):
        assert callable(getattr(HapticLoop, name))


@pytest.mark.parametrize("file", sorted(set(re.findall(r"`((?:\w+/)*\w+\.py)`", PAGE))))
def test_each_file_of_a_walk_is_there(file: str) -> None:
    beside = ("", "jaxstab/", "jaxstab/region/")
    assert any((ROOT / folder / file).is_file() for folder in beside)


def test_it_fits_on_a_screen_and_draws_every_folder_and_file() -> None:
    assert len(PAGE.splitlines()) <= 75
    drawing = PAGE.split("```")[1]
    own = [path for path in (ROOT / "jaxstab").iterdir() if path.name[0] not in "_."]
    own += [*(ROOT / "jaxstab" / "app").iterdir(), *(ROOT / "jaxstab" / "lab").iterdir()]
    names = {path.name.split(".")[0] for path in own if path.name[0] != "_"}
    assert names - {"py", "lazy", "results"} - set(re.findall(r"\w+", drawing)) == set()
