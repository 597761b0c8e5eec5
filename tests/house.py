"""The rules of the house that a machine can check (CONTRIBUTING.md): how jaxstab is written.

They are no tests of the product. `.ci/lint` runs them: python -m pytest -n0 tests/house.py
"""

import ast
import doctest
import re
from collections.abc import Callable, Iterator
from inspect import Parameter, getmembers, getmodule, isclass, signature
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest
from calls import COMPUTING_CALLS, PUBLIC

import jaxstab
from jaxstab.model import filters

ROOT = Path(__file__).resolve().parents[1]
LONGEST_FILE = 1000  # lines
FLOORS_THAT_COMPUTE = tuple(
    f"jaxstab.{floor}"
    for floor in (
        "model", "exact", "point", "region", "boxes", "paper", "motion", "tuning", "trace", "loop",
        "lab.contact.runs",
    )
)  # fmt: skip
MOST_NAMES = 51  # that a program finds at the top
CONVERSIONS = {  # of a loop: nothing is asked of it
    "alpha", "beta", "stiffness", "damping", "in_floats", "plot", "to_control", "tree_flatten",
    "tree_unflatten",
}  # fmt: skip

MAKERS = {
    "admittance",
    "coupling",
    "pid",
    "simulated_pd",
    "two_rates",
}  # of loops, whose methods compute


def is_function(value: object) -> bool:
    """By being callable and no class: ``inspect.isfunction`` would miss the jitted ones."""
    return callable(value) and not isinstance(value, type)


def computes(value: object) -> bool:
    return is_function(value) and value.__module__.startswith(FLOORS_THAT_COMPUTE)


def computing_methods() -> set[str]:
    """The answers of a loop."""
    loop = jaxstab.HapticLoop
    own = {name for name in dir(loop) if name[0] != "_" and computes(getattr(loop, name))}
    return {f"HapticLoop.{name}" for name in own - CONVERSIONS}


def test_the_public_names_are_few_and_each_has_one_place() -> None:
    assert len(jaxstab.__all__) <= MOST_NAMES
    own_names = [name.rpartition(".")[2] for name in PUBLIC]
    assert len(set(own_names)) == len(own_names)
    for name in (*jaxstab.results.__all__, *jaxstab.paper.__all__):
        with pytest.raises(AttributeError):
            getattr(jaxstab, name)


@pytest.mark.parametrize("name", [*PUBLIC, *sorted(computing_methods())])
def test_every_public_callable_says_what_it_is_refuses_and_shows_and_where_it_is_from(
    name: str,
) -> None:
    value = attrgetter(name)(jaxstab)
    if not callable(value):
        pytest.skip(f"{name} is a value")
    # A dataclass or a named tuple without a docstring gets its signature for one.
    text = value.__doc__ or ""
    assert text
    assert not text.startswith(f"{name.rpartition('.')[2]}(")
    assert ">>> " in text, "shows no example"
    # What all methods share is said once, by their class.
    shared = jaxstab.HapticLoop.__doc__ if "HapticLoop." in name else ""
    text += shared or ""
    if is_function(value):
        assert re.search(r"\bRaises:", text), "says nothing about errors"
    if computes(value):
        assert re.search(r"(?i)\b(paper|eqs?\.|theorem|criterion|table|sec\.)", text), "no source"


SHARED = dict(re.findall(r"(?m)^    (\w+): (.+)$", jaxstab.conventions.__doc__ or ""))


def undocumented(function: ast.FunctionDef) -> set[str]:
    """The arguments that a docstring with a section of arguments neither has nor links to.

    A line such as "alpha, beta: see ``jaxstab.conventions``." links to the shared arguments, and
    "Args and Raises: see ``jaxstab.conventions``" says that all of them are.
    """
    text = ast.get_docstring(function) or ""
    given = function.args
    arguments = {one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs)}
    arguments -= {"self", "cls"}
    if re.search(r"(?m)^Args and Raises: see ``jaxstab\.conventions``", text):
        return arguments - SHARED.keys()
    section = re.search(r"(?m)^Args:\n((?:    .*\n?|\n)*)", text)
    if section is None:
        return set()
    own_lines = set(re.findall(r"(?m)^    (\w+)(?: \(.*\))?:", section[1]))
    links = re.findall(r"(?m)^    ([\w, ]+): see ``jaxstab\.conventions``\.$", section[1])
    linked = {name for names in links for name in names.split(", ")}
    wrong = linked - (arguments & SHARED.keys())
    public = {name for name in arguments if name[0] != "_"}
    return wrong | (public - own_lines - linked)


def test_arguments_are_documented_where_they_are_or_among_the_shared_ones() -> None:
    missing = {}
    for path in (ROOT / "jaxstab").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and (names := undocumented(node)):
                missing[f"{path.relative_to(ROOT)}: {node.name}"] = names
    assert missing == {}


def test_an_argument_that_is_not_documented_is_named() -> None:
    line = "alpha, radius: see ``jaxstab.conventions``."
    code = f'def f(alpha, radius, other):\n    """Say.\n\n    Args:\n        {line}\n    """'
    (function,) = ast.parse(code).body
    assert isinstance(function, ast.FunctionDef)
    assert undocumented(function) == {"radius", "other"}
    line = "Args and Raises: see ``jaxstab.conventions``."
    code = f'def f(alpha, other):\n    """Say.\n\n    {line}\n    """'
    (function,) = ast.parse(code).body
    assert isinstance(function, ast.FunctionDef)
    assert undocumented(function) == {"other"}


POSITIONAL = Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD
WALLS = ["alpha", "beta"], ["stiffness", "damping"]
NUMBERS = {
    "alpha", "beta", "gamma", "delta", "delay", "theta", "level", "radius", "tolerance", "mass",
    "stiffness", "damping", "cutoff", "order", "frequency", "bandwidth", "samples",
}  # fmt: skip
NO_NUMBERS = {"C", "about", "executor", "function", "outside", "progress", "self", "units"}


@pytest.mark.parametrize("name", PUBLIC)
def test_but_for_walls_no_two_numbers_go_without_a_name(name: str) -> None:
    value = attrgetter(name)(jaxstab)
    functions = [value] if is_function(value) else public_methods(value)
    for function in functions:
        named = [p.name for p in signature(function).parameters.values() if p.kind in POSITIONAL]
        given = [p for p in named if p not in NO_NUMBERS]
        numbers = [p for p in given if p in NUMBERS]
        assert numbers in WALLS or (len(numbers) <= 1 and len(given) <= 2), (name, named)


def public_methods(value: object) -> list[Callable[..., Any]]:
    """The public functions that a class defines."""
    if not isinstance(value, type):
        return []
    found = [getattr(value, name) for name in dir(value) if not name.startswith("_")]
    return [one for one in found if callable(one) and "jaxstab" in str(getmodule(one))]


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
    "Together": {"leaves", "lines"},
    "Velocity": {"stages"},
}  # fmt: skip
OF_PYTREES = {"in_floats", "tree_flatten", "tree_unflatten"}


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


def test_every_computing_function_is_in_the_table_of_calls() -> None:
    computing = {name for name in PUBLIC if computes(attrgetter(name)(jaxstab))}
    assert (computing - MAKERS) | computing_methods() == set(COMPUTING_CALLS)


def test_tests_import_no_tests() -> None:
    texts = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py")}
    assert [n for n, text in texts.items() if re.search(r"(?m)^(from|import) test_", text)] == []


def test_no_file_is_longer_than_one_subject() -> None:
    lengths = {
        path.relative_to(ROOT).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for path in (ROOT / "jaxstab").rglob("*.py*")
        if path.suffix in {".py", ".pyi"}
    }
    assert lengths
    assert {path: n for path, n in lengths.items() if n > LONGEST_FILE} == {}


def test_files_outside_of_one_do_not_name_a_kind_of_filter() -> None:
    classes = [kind for kind in vars(filters).values() if isclass(kind)]
    kinds = {kind.__name__ for kind in classes if issubclass(kind, filters.Section)}
    names = kinds - {"Section"}
    words = {repr(kind.kind).replace("'", '"') for kind in filters.LOW_PASSES}
    pattern = re.compile("|".join([*(rf"\b{name}\b" for name in sorted(names)), *sorted(words)]))
    package = Path(jaxstab.__file__).parent
    naming = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if any(
            pattern.search(line.partition("#")[0])
            for line in path.read_text(encoding="utf-8").splitlines()
        )
    }
    own = {"model/filters.py", "model/filter_tables.py"}
    assert naming == {*own, "model/loop.py"}  # which counts windows
