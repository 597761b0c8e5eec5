r"""Single-token mutants of rooms that prove: do the default tests notice them?

    python -m pytest -o addopts= -m "not campaign" --cov=jaxstab --cov-context=test \
        --cov-report= --junitxml=seconds.xml
    python tests/mutants.py --points 500

The first command (it needs pytest-cov) records in ``.coverage`` which tests execute which line, and
in ``seconds.xml`` how long they take; several such pairs of files, of parts of the tests, may lie
in the folder that ``JAXSTAB_MUTANTS`` names (here otherwise); ``JAXSTAB_MUTANTS_ROOMS`` names fewer
rooms. Of all operators, numbers, booleans and names like ``min`` in the code, without annotations,
imports, docstrings and ``strict=`` of zip, which asserts what is so, a seeded sample is changed,
one at a time. The tests that execute the changed line run on it, those of the module first and the
quickest of these, until one fails. Lines that few tests execute, for they run while a module is
imported or JAX traces, are tried with all tests of their file.

No file is changed: beside links to all others lies a copy of jaxstab with the mutant, and its tests
run there in a new process. A mutant survives if ``_RECORDED`` seconds of tests pass. Processes that
tests start may run the code as it is. Results are appended to ``mutants.jsonl`` in the same folder;
a later call goes on from there, and tries a survivor again if its tests have changed.
"""

import argparse
import ast
import io
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import tokenize
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator
from itertools import islice, pairwise, permutations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from xml.etree import ElementTree

from coverage import CoverageData

ROOT = Path(__file__).resolve().parents[1]
ROOMS = os.environ.get("JAXSTAB_MUTANTS_ROOMS", "exact boxes point region").split()
FOLDER = Path(os.environ.get("JAXSTAB_MUTANTS", "."))

_RECORDED = 60.0  # seconds that the tests of one mutant took when they were recorded
_ENOUGH = 5  # tests of a line, so that those of its file are not needed
_LONGEST = 300.0  # seconds of a mutant, by the clock
_MEMORY = 1 << 34  # bytes of address space
_OPTIONS = ["-x", "-q", "--tb=no", "-o", "addopts=", "-m", "not campaign"]
_CHANGES = (
    "+ -, - +, * /, / *, // /, % *, ** *, @ *, & |, | &, ^ &, << >>, >> <<, ~, not, and or, or and"
    ", += -=, -= +=, *= /=, /= *=, &= |=, |= &=, < <= >=, <= < >, > >= <=, >= > <, == !=, != =="
)
_OPERATORS = {one: others or [""] for one, *others in map(str.split, _CHANGES.split(","))}
_OPERATORS |= {"is": ["is not"], "in": ["not in"]}
_PAIRS = ("min max", "minimum maximum", "any all", "floor ceil", "argmin argmax", "cos sin")
_NAMES = {one: [other] for pair in _PAIRS for one, other in permutations(pair.split())}

Place = tuple[int, int]  # line and column


class Mutant(NamedTuple):
    """A piece of a line, and what replaces it."""

    path: str
    line: int
    column: int  # in characters
    old: str
    new: str

    def is_python(self) -> bool:
        """True if it compiles: ``not not in`` does not."""
        try:
            ast.parse(self.source())
        except SyntaxError:
            return False
        return True

    def source(self) -> str:
        """The changed file."""
        lines = (ROOT / self.path).read_text(encoding="utf-8").splitlines(keepends=True)
        text = lines[self.line - 1]
        end = self.column + len(self.old)
        lines[self.line - 1] = text[: self.column] + self.new + text[end:]
        return "".join(lines)

    def __str__(self) -> str:
        text = (ROOT / self.path).read_text(encoding="utf-8").splitlines()[self.line - 1]
        return (
            f"{self.path}:{self.line}:{self.column}: {self.old} -> {self.new or 'nothing'}"
            f"    {text.strip()}"
        )


def mutants(path: Path, rng: random.Random) -> Iterator[Mutant]:
    """One mutant for each token of a file that can be changed."""
    source = path.read_text(encoding="utf-8")
    tokens = list(tokenize.generate_tokens(io.StringIO(source).readline))
    starts = [token.start for token in tokens]
    for kind, begin, end in _places(ast.parse(source)):
        for token in tokens[bisect_left(starts, begin) : bisect_left(starts, end)]:
            if token.string in (_NAMES if kind is ast.Name else _OPERATORS):
                new = rng.choice((_NAMES if kind is ast.Name else _OPERATORS)[token.string])
            elif kind is ast.Constant and token.string in ("True", "False"):
                new = str(token.string == "False")
            elif kind is ast.Constant and token.type == tokenize.NUMBER:
                new = _number(ast.literal_eval(token.string), rng)
            else:
                continue
            yield Mutant(path.relative_to(ROOT).as_posix(), *token.start, token.string, new)


def _places(node: ast.AST) -> Iterator[tuple[type, Place, Place]]:
    """Kind, begin and end of the places of operators, numbers and names."""
    match node:
        case ast.Import() | ast.ImportFrom() | ast.keyword(arg="strict"):
            return
        case ast.BinOp(left=left, right=right) | ast.AugAssign(target=left, value=right):
            yield ast.operator, _end(left), _begin(right)
        case ast.UnaryOp():
            yield ast.operator, _begin(node), _begin(node.operand)
        case ast.Compare():
            for left, right in pairwise([node.left, *node.comparators]):
                yield ast.operator, _end(left), _begin(right)
        case ast.BoolOp():
            for left, right in pairwise(node.values):
                yield ast.operator, _end(left), _begin(right)
        case ast.Constant():
            yield ast.Constant, _begin(node), _end(node)
        case ast.Name():
            yield ast.Name, _begin(node), _end(node)
        case ast.Attribute():
            yield ast.Name, _end(node.value), _end(node)
    for field, value in ast.iter_fields(node):
        if field not in ("annotation", "returns"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _places(child)


def _begin(node: ast.expr) -> Place:
    return node.lineno, node.col_offset


def _end(node: ast.expr) -> Place:
    return node.end_lineno or 0, node.end_col_offset or 0


def _number(value: complex, rng: random.Random) -> str:
    """Another number: half or twice as large, or beside an integer."""
    if isinstance(value, int):
        return str(value + rng.choice([-1, 1] if value > 0 else [1]))
    return repr(value * rng.choice([0.5, 2.0]) if value else 0.5)


class Map:
    """Which tests execute a line, and how many seconds they take."""

    def __init__(self, folder: Path) -> None:
        self.seconds: dict[str, float] = {}
        for path in folder.glob("*.xml"):
            for case in ElementTree.parse(path).iter("testcase"):
                within = case.attrib["classname"].split(".")
                last = next(k for k, name in enumerate(within, 1) if name.startswith("test_"))
                file = "/".join(within[:last]) + ".py"
                test = "::".join([file, *within[last:], case.attrib["name"]])
                self.seconds[test] = float(case.attrib["time"])
        self.lines: dict[str, dict[int, set[str]]] = {}
        for path in folder.glob(".coverage*"):
            data = CoverageData(str(path))
            data.read()
            for file in data.measured_files():
                lines = self.lines.setdefault(Path(file).relative_to(ROOT).as_posix(), {})
                for line, contexts in data.contexts_by_lineno(file).items():
                    tests = {context.split("|")[0] for context in contexts} & set(self.seconds)
                    lines.setdefault(line, set()).update(tests)

    def tests(self, mutant: Mutant) -> list[str]:
        """The tests of a mutant, in the order in which they run."""
        module = Path(mutant.path).stem
        lines = self.lines.get(mutant.path, {})
        here = lines.get(mutant.line, set())
        spent, tests = 0.0, []
        elsewhere = set() if len(here) >= _ENOUGH else set().union(*lines.values()) - here
        for group in (here, elsewhere):
            for test in sorted(
                group, key=lambda test: (module not in test.split("::")[0], self.seconds[test])
            ):
                spent += self.seconds[test]
                if spent > _RECORDED and tests:
                    return tests
                tests.append(test)
        return tests


def main(points: int, seed: int) -> None:
    """Try mutants, and say which of them survive."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))  # of the tests, too
    rng = random.Random(seed)
    paths = sorted(path for room in ROOMS for path in (ROOT / "jaxstab" / room).glob("*.py"))
    places = [mutant for path in paths for mutant in mutants(path, rng)]
    rng.shuffle(places)
    print(f"{len(places)} tokens in {len(paths)} files", flush=True)
    known, results = Map(FOLDER), FOLDER / "mutants.jsonl"
    earlier: dict[str, Any] = {}
    if results.exists():
        rows = map(json.loads, results.read_text(encoding="utf-8").splitlines())
        earlier = {row["mutant"]: row for row in rows}
    counts: Counter[tuple[str, str]] = Counter()
    survivors = []
    sample = list(islice(filter(Mutant.is_python, places), points))
    if fate(None, known.tests(sample[0])) != "survived":
        raise SystemExit("Tests fail on the code as it is: mend them, or record them anew.")
    for mutant in sample:
        tests = known.tests(mutant)
        row = earlier.get(str(mutant), {"said": "survived", "tests": None})
        if row["said"] == "survived" and row["tests"] != tests:
            row = {"mutant": str(mutant), "said": fate(mutant, tests), "tests": tests}
            with results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            print(f"{row['said']}: {mutant}", flush=True)
        counts[mutant.path.split("/")[1], row["said"]] += 1
        survivors += [str(mutant)] if row["said"] == "survived" else []
    for room in ROOMS:
        print(room, {said: count for (at, said), count in counts.items() if at == room})
    print(*survivors, sep="\n")


def fate(mutant: Mutant | None, tests: list[str]) -> str:
    """What tests say of a mutant, or of the code as it is."""
    if not tests:
        return "survived"
    with TemporaryDirectory() as name:
        folder = Path(name)
        for path in ROOT.iterdir():
            if path.name != "jaxstab":
                (folder / path.name).symlink_to(path)
        shutil.copytree(
            ROOT / "jaxstab", folder / "jaxstab", ignore=shutil.ignore_patterns("__pycache__")
        )
        if mutant:
            (folder / mutant.path).write_text(mutant.source(), encoding="utf-8")
        try:
            run = subprocess.run(
                [sys.executable, "-m", "pytest", *_OPTIONS, *tests],
                capture_output=True,
                check=False,
                cwd=folder,
                env=os.environ | {"PYTHONPATH": name},
                timeout=_LONGEST,
            )
        except subprocess.TimeoutExpired:
            return "timeout"
    return "killed" if run.returncode else "survived"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=500, help="how many mutants are tried")
    parser.add_argument("--seed", type=int, default=20120412, help="of the sample")
    main(**vars(parser.parse_args()))
