"""The examples in docstrings run and give what stands there."""

import doctest
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import numpy as np
import pytest

import jaxstab

ROOT = Path(__file__).parents[2]
# Numbers may end in dots: their last digits are those of a machine.
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def examples() -> Iterator[doctest.DocTest]:
    finder = doctest.DocTestFinder(exclude_empty=True)
    for found in walk_packages(jaxstab.__path__, "jaxstab."):
        module = import_module(found.name)
        names = {**vars(module), "jaxstab": jaxstab, "np": np}
        yield from finder.find(module, found.name, globs=names)


@pytest.mark.parametrize("example", [e for e in examples() if e.examples], ids=lambda e: e.name)
def test_the_example_gives_what_it_shows(
    example: doctest.DocTest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    said: list[str] = []
    failed = doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=said.append).failed
    assert not failed, "".join(said)
