"""The rules of the house that a machine can check (CONTRIBUTING.md)."""

import ast
import re
import subprocess
import sys
from collections.abc import Callable
from inspect import Parameter, getmodule, signature
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calls import COMPUTING_CALLS, PUBLIC

import jaxstab

ROOT = Path(__file__).resolve().parents[1]
LONGEST_FILE = 1000  # lines
MOST_BOUND = 45  # names in a function: arguments, variables, functions inside of it
FLOORS_THAT_COMPUTE = tuple(
    f"jaxstab.{floor}"
    for floor in (
        "model", "exact", "point", "region", "boxes", "paper", "motion", "tuning", "trace", "loop"
    )
)  # fmt: skip
MOST_NAMES = 51  # that a program finds at the top
CONVERSIONS = {  # of a loop: nothing is asked of it
    "alpha", "beta", "stiffness", "damping", "in_floats", "plot", "to_control", "tree_flatten",
    "tree_unflatten",
}  # fmt: skip

MAKERS = {"admittance", "coupling", "pid", "simulated_pd"}  # of loops, whose methods compute


def run_python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )


def assert_succeeds(*arguments: str) -> None:
    completed = run_python(*arguments)
    assert completed.returncode == 0, completed.stdout + completed.stderr


def loaded_by(module: str) -> set[str]:
    """The modules that a fresh interpreter holds after importing this one."""
    completed = run_python("-c", f"import sys, {module}; print(*sys.modules)")
    assert completed.returncode == 0, completed.stderr
    return set(completed.stdout.split())


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


def test_the_linter_has_nothing_to_say() -> None:
    assert_succeeds("-m", "ruff", "check", ".")


def test_the_code_is_formatted() -> None:
    assert_succeeds("-m", "ruff", "format", "--check", ".")


@pytest.mark.skipif(np.__version__ < "2.3", reason="older types of NumPy say less")
def test_the_types_are_right_under_strict_mypy() -> None:
    assert_succeeds("-m", "mypy")


def test_imports_keep_their_contracts() -> None:
    assert_succeeds("-c", "from importlinter.cli import lint_imports_command as c; c()")


@pytest.mark.parametrize(
    "package",
    [
        "",
        ".model",
        ".exact",
        ".point",
        ".region",
        ".boxes",
        ".paper",
        ".atlas",
        ".results",
    ],
)
def test_importing_a_package_loads_nothing_heavy(package: str) -> None:
    loads = loaded_by(f"jaxstab{package}")
    assert loads.isdisjoint({"jax", "numpy", "h5py", "matplotlib", "pydantic"})


@pytest.mark.parametrize("module", ["file", "query", "table"])
def test_the_reader_of_an_atlas_loads_no_jax(module: str) -> None:
    assert loaded_by(f"jaxstab.atlas.{module}").isdisjoint({"jax", "jaxlib", "matplotlib"})


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_name_can_be_imported(name: str) -> None:
    assert attrgetter(name)(jaxstab) is not None


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


RIDDLE = re.compile(r"(?:[A-Z]\d+\. )?(?:Return )?(?:what|which|how|whether)\b", re.IGNORECASE)


def test_a_docstring_begins_with_a_noun_and_not_with_a_question() -> None:
    """ "True if the wall is stable", "The number of roots": not "Whether", "Return how many"."""
    riddles = {}
    for path in (ROOT / "jaxstab").rglob("*.py"):
        place = path.relative_to(ROOT / "jaxstab").as_posix()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                text = ast.get_docstring(node) or ""
                if RIDDLE.match(text):
                    riddles[f"{place}: {getattr(node, 'name', '')}"] = text
    assert riddles == {}


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


def test_every_computing_function_is_in_the_table_of_calls() -> None:
    computing = {name for name in PUBLIC if computes(attrgetter(name)(jaxstab))}
    assert (computing - MAKERS) | computing_methods() == set(COMPUTING_CALLS)


def test_tests_import_no_tests() -> None:
    texts = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "tests").glob("*.py")}
    assert [n for n, text in texts.items() if re.search(r"(?m)^(from|import) test_", text)] == []


def test_no_file_is_longer_than_one_subject() -> None:
    lengths = {
        path.relative_to(ROOT).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for path in (ROOT / "jaxstab").rglob("*.py*")
        if path.suffix in {".py", ".pyi"}
    }
    assert lengths
    assert {path: n for path, n in lengths.items() if n > LONGEST_FILE} == {}


def bound_names(function: ast.FunctionDef) -> set[str]:
    """The names that a function binds, with those of the functions inside of it."""
    names = set()
    for node in ast.walk(function):
        if isinstance(node, ast.arg):
            names.add(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef) and node is not function:
            names.add(node.name)
        elif isinstance(node, ast.alias):
            names.add(node.asname or node.name)
    return names


def test_names_of_a_function_are_counted_with_those_inside_of_it() -> None:
    text = (
        "def f(a, *b, c=1, **d):\n"
        "    import e\n"
        "    for g, (h, _) in a:\n"
        "        g.i = e.j(k=c)\n"
        "    def l(m):\n"
        "        return [n for n in m if (o := n)]\n"
        "    return lambda p: l(p)\n"
    )
    (function,) = ast.parse(text).body
    assert isinstance(function, ast.FunctionDef)
    assert bound_names(function) == set("abcdegh_lmnop")


def test_no_function_has_more_names_than_a_reader_holds() -> None:
    busy = set()
    for path in (ROOT / "jaxstab").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and len(bound_names(node)) > MOST_BOUND:
                busy.add(f"{path.relative_to(ROOT).as_posix()}: {node.name}")
    assert busy == set()


@pytest.mark.campaign
def test_51_14_all_of_it_is_there_without_docstrings() -> None:
    code = (
        "import importlib, pkgutil, jaxstab\n"
        "modules = pkgutil.walk_packages(jaxstab.__path__, 'jaxstab.')\n"
        "names = [m.name for m in modules if not m.name.endswith('__main__')]\n"
        "print(len([*map(importlib.import_module, names)]))\n"
        "print(len([getattr(jaxstab, name) for name in dir(jaxstab)]))\n"
    )
    done = run_python("-OO", "-c", code)
    assert done.returncode == 0, done.stderr
    modules, names = map(int, done.stdout.split())
    assert modules > 100
    assert names == len(dir(jaxstab))
    device = ["--mass", "0.3", "--damping", "0.2", "--sample-time", "0.001", "--delay", "0.001"]
    limits = run_python("-OO", "-m", "jaxstab", "limits", *device)
    assert (limits.returncode, limits.stderr) == (0, "")
    assert "largest stiffness" in limits.stdout
