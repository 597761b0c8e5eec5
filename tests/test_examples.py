"""The examples in docstrings run and give what stands there, and no public method is without."""

import doctest
import re
from collections.abc import Iterator
from importlib import import_module
from inspect import getmembers, isclass
from operator import attrgetter
from pathlib import Path
from pkgutil import walk_packages

import numpy as np
import pytest
from calls import PUBLIC

import jaxstab

ROOT = Path(__file__).parents[1]
# Numbers may end in dots: their last digits are those of a machine.
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
# What other parts of jaxstab ask of a value: exact functions of s, stages of a filter, the parts of
# a plan or of a loop, and what JAX asks of a pytree.
INTERNAL = {
    "AtlasAnswer": {"reshaped"},
    "AtlasSpec": {"filters", "nodes"},
    "FieldSpec": {"from_table"},
    "Device": {"compliance", "ports", "require_handle"},
    "Filter": {"stages", "transfer"},
    "Hand": {"dynamic_stiffness"},
    "HapticLoop": {"body", "filters", "held_device", "linear", "sampled"},
    "JointAnswer": {"leaves", "lines"},
    "Joints": {"leaves", "lines"},
    "Mode": {"response", "shapes"},
    "Plan": {
        *("boxes", "chunk", "deltas_of_a_tile", "hands", "is_gridded", "numbers"),
        *("points", "shape", "variables"),
    },
    "Velocity": {"stages"},
}  # fmt: skip
OF_PYTREES = {"in_floats", "tree_flatten", "tree_unflatten"}


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


def methods() -> Iterator[object]:
    """The public methods and properties of public classes: what the package itself defines."""
    for name, cls in ((name, attrgetter(name)(jaxstab)) for name in PUBLIC):
        if not isclass(cls):
            continue
        allowed = INTERNAL.get(cls.__name__, set()) | OF_PYTREES
        for own, _ in getmembers(cls):
            defined = [vars(base)[own] for base in cls.__mro__ if own in vars(base)]
            from_here = any(
                base.__module__.startswith("jaxstab.") for base in cls.__mro__ if own in vars(base)
            )
            if own[0] == "_" or own in allowed or not from_here or not is_documented(defined[0]):
                continue
            yield pytest.param(cls, own, defined[0], id=f"{name}.{own}")


def is_documented(member: object) -> bool:
    """True if a member has a docstring of its own: methods and properties, not fields."""
    return callable(member) or hasattr(member, "func") or isinstance(member, property | classmethod)


@pytest.mark.parametrize(("cls", "name", "member"), list(methods()))
def test_every_public_method_of_a_public_class_is_shown_in_an_example(
    cls: type, name: str, member: object
) -> None:
    finder = doctest.DocTestParser()
    texts = [cls.__doc__ or "", getattr(member, "__doc__", None) or ""]
    sources = "".join(one.source for text in texts for one in finder.get_examples(text))
    assert re.search(rf"\.{name}\b", sources), "shows no example"
