r"""Single-token mutants of rooms that prove: do the default tests notice them?

    python -m pytest -o addopts= -m "not campaign" --cov=jaxstab --cov-context=test \
        --cov-report= --junitxml=seconds.xml
    python -m benchmarks mutants --points 500

The first command (it needs pytest-cov) records in ``.coverage`` which tests execute which line, and
in ``seconds.xml`` how long they take; several such pairs of files, of parts of the tests, may lie
in the folder that ``JAXSTAB_MUTANTS`` names (here otherwise); ``JAXSTAB_MUTANTS_ROOMS`` names fewer
rooms. Of all operators, numbers, booleans and names like ``min`` in the code, without annotations,
imports and docstrings, a seeded sample is changed, one at a time. The tests that execute the
changed line run on it, the quickest first, until one fails. Lines that few tests execute, for they
run while a module is imported or JAX traces, are tried with all tests of their file. A mutant
survives if ``_BUDGET`` seconds of tests pass.

No file is changed. A process imports jaxstab and the tests once. Each mutant is a fork of it in
which functions are given the changed code, or constants the changed value. What is neither, such as
a default argument, is left out. Threads of JAX do not survive a fork, and JAX starts when
``region/batch.py`` is imported: it is changed in a copy of all files, and its tests run there in a
new process. Processes that tests start run the code as it is. Results are appended to
``mutants.jsonl`` in the same folder; a later call goes on from there, and tries a survivor again if
its tests have changed.
"""

import ast
import gc
import io
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
import tokenize
import warnings
from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice, pairwise, permutations
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest
from coverage import CoverageData

ROOT = Path(__file__).resolve().parents[1]
ROOMS = os.environ.get("JAXSTAB_MUTANTS_ROOMS", "exact boxes point region").split()
FOLDER = Path(os.environ.get("JAXSTAB_MUTANTS", "."))

_RECORDED = 30.0  # seconds that the tests of one mutant took when they were recorded
_BUDGET = 4.0  # processor seconds after which a mutant has survived
_ENOUGH = 5  # tests of a line, so that those of its file are not needed
_START = 8.0  # processor seconds beyond its recorded ones after which a test hangs
_LONGEST = 300.0  # seconds of a mutant, by the clock
_MEMORY = 1 << 34  # bytes of address space
_STARTS_JAX = {"jaxstab/region/batch.py": "tests/test_batch.py"}  # when imported; its tests
_LEFT_OUT = 77  # exit code where a change is neither in a function nor in a constant
_OPTIONS = [
    *["-s", "-q", "--tb=no", "-o", "addopts=", "-m", "not campaign"],
    *["-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:cov", "-p", "no:benchmark"],
]
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
        """Whether it compiles: ``not not in`` does not."""
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
        case ast.Import() | ast.ImportFrom():
            return
        case ast.BinOp():
            yield ast.operator, _end(node.left), _begin(node.right)
        case ast.AugAssign():
            yield ast.operator, _end(node.target), _begin(node.value)
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
                module, *within = case.attrib["classname"].split(".", 2)[1:]
                test = "::".join([f"tests/{module}.py", *within, case.attrib["name"]])
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
        lines = self.lines.get(mutant.path, {})
        here = lines.get(mutant.line, set())
        spent, tests = 0.0, []
        elsewhere = set() if len(here) >= _ENOUGH else set().union(*lines.values()) - here
        for group in (here, elsewhere):
            for test in sorted(group, key=self.seconds.__getitem__):
                spent += self.seconds[test]
                if spent > _RECORDED and tests:
                    return tests
                tests.append(test)
        return tests


class Watch:
    """A plugin of pytest that notices failures, and ends a process whose test hangs."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self.seconds = seconds
        self.has_failed = False

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """End after the budget; bound the processor time of each test."""
        if time.process_time() > _BUDGET:
            os._exit(0)
        limit = int(time.process_time() + _START + self.seconds[nodeid])
        resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Remember failures."""
        self.has_failed |= report.failed


class Mutating:
    """A plugin of pytest: instead of the tests, mutants are run."""

    def __init__(self, points: int, known: Map, watch: Watch) -> None:
        self.points, self.known, self.watch = points, known, watch

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Try mutants, and say which of them survive."""
        rng = random.Random(20120412)
        paths = sorted(path for room in ROOMS for path in (ROOT / "jaxstab" / room).glob("*.py"))
        places = [mutant for path in paths for mutant in mutants(path, rng)]
        rng.shuffle(places)
        print(f"{len(places)} tokens in {len(paths)} files", flush=True)
        items = {item.nodeid: item for item in session.items}
        self.functions = defaultdict(list)
        for thing in gc.get_objects():
            if isinstance(thing, FunctionType):
                self.functions[thing.__code__.co_filename].append(thing)
        results = FOLDER / "mutants.jsonl"
        earlier: dict[str, Any] = {}
        if results.exists():
            rows = map(json.loads, results.read_text(encoding="utf-8").splitlines())
            earlier = {row["mutant"]: row for row in rows}
        counts: Counter[tuple[str, str]] = Counter()
        survivors = []
        for mutant in islice(filter(Mutant.is_python, places), self.points):
            own = _STARTS_JAX.get(mutant.path)
            tests = [own] if own else self.known.tests(mutant)
            row = earlier.get(str(mutant), {"said": "survived", "tests": None})
            if row["said"] == "survived" and row["tests"] != tests:
                of_line = [items[test] for test in tests if test in items]
                said = fate_in_copy(mutant, own) if own else self.fate(mutant, of_line)
                row = {"mutant": str(mutant), "said": said, "tests": tests}
                with results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
                print(f"{said}: {mutant}", flush=True)
            counts[mutant.path.split("/")[1], row["said"]] += 1
            survivors += [str(mutant)] if row["said"] == "survived" else []
        for room in ROOMS:
            print(room, {said: count for (at, said), count in counts.items() if at == room})
        print(*survivors, sep="\n")
        return True

    def fate(self, mutant: Mutant, items: list[pytest.Item]) -> str:
        """What tests say of a mutant, in a copy of this process."""
        begun = time.monotonic()
        with warnings.catch_warnings(action="ignore"):  # JAX has no threads yet
            child = os.fork()
        if child == 0:
            resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
            null = os.open(os.devnull, os.O_RDWR)
            for stream in range(3):
                os.dup2(null, stream)
            code = 1  # what raises here is the mutant
            with suppress(BaseException):
                functions = self.functions[str(ROOT / mutant.path)]
                code = self.run(items) if is_put_in(mutant, functions) else _LEFT_OUT
            os._exit(code)
        while not (ended := os.waitpid(child, os.WNOHANG))[0]:
            time.sleep(0.02)
            if time.monotonic() - begun > _LONGEST:  # it waits for something
                os.kill(child, signal.SIGKILL)
        said = {0: "survived", _LEFT_OUT: "left out"}
        said |= dict.fromkeys((-signal.SIGXCPU, -signal.SIGKILL), "timeout")
        return said.get(os.waitstatus_to_exitcode(ended[1]), "killed")

    def run(self, items: list[pytest.Item]) -> int:
        """Run tests until one fails; 1 if one does."""
        for item, after in pairwise([*items, None]):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if self.watch.has_failed:
                item.session._setupstate.teardown_exact(None)
                return 1
        return 0


def fate_in_copy(mutant: Mutant, tests: str) -> str:
    """What a file of tests says of a mutant, in a new process and a changed copy of all files."""
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".*", "__pycache__"))
        (copy / mutant.path).write_text(mutant.source(), encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-x", *_OPTIONS, tests]
        environment = os.environ | {"PYTHONPATH": str(copy)}
        try:
            run = subprocess.run(
                command,
                capture_output=True,
                check=False,
                cwd=copy,
                env=environment,
                timeout=_LONGEST,
            )
        except subprocess.TimeoutExpired:
            return "timeout"
    return "killed" if run.returncode else "survived"


def is_put_in(mutant: Mutant, of_file: list[FunctionType]) -> bool:
    """Give the functions of a module the code of a mutant, if nothing else of it differs."""
    path = ROOT / mutant.path
    module = next((m for m in sys.modules.values() if getattr(m, "__file__", 0) == str(path)), None)
    if module is None:
        return False
    functions = defaultdict(list)
    for function in of_file:
        functions[function.__code__.co_qualname, function.__code__.co_firstlineno].append(function)

    def put(old: CodeType, new: CodeType) -> bool:
        here = functions[old.co_qualname, old.co_firstlineno]
        for function in here:
            function.__code__ = new
        if here:
            return True
        codes, others = [], []
        for code in (old, new):
            codes.append([one for one in code.co_consts if isinstance(one, CodeType)])
            others.append([repr(one) for one in code.co_consts if not isinstance(one, CodeType)])
        return old.co_code == new.co_code and others[0] == others[1] and all(map(put, *codes))

    compiled = module.__loader__.source_to_code
    codes = compiled(path.read_bytes(), str(path)), compiled(mutant.source().encode(), str(path))
    return put(*codes) or is_set(mutant, module)


def is_set(mutant: Mutant, module: ModuleType) -> bool:
    """Give the constants of a module the values of a mutant, if it is in one of them.

    Those that follow from it are set, too, and the names under which other modules import them.
    """
    changed: set[str] = set()
    for node in ast.parse(mutant.source()).body:
        if not isinstance(node, ast.Assign):
            continue
        names = [name for name in ast.walk(node) if isinstance(name, ast.Name)]
        if node.lineno <= mutant.line <= node.end_lineno or changed & {n.id for n in names}:
            mine = {name.id for name in names if isinstance(name.ctx, ast.Store)}
            before = {name: vars(module)[name] for name in mine}
            exec(compile(ast.Module([node], []), mutant.path, "exec"), vars(module))
            for other in list(sys.modules.values()):
                for name, value in before.items():
                    if vars(other).get(name) is value:
                        setattr(other, name, vars(module)[name])
            changed |= mine
    return bool(changed)


def main(small: bool, points: int | None) -> int:
    """Try mutants in a process that has not imported jaxstab."""
    command = [sys.executable, "-m", "benchmarks.mutants", str(points or (5 if small else 500))]
    return subprocess.run(command, check=False, cwd=ROOT).returncode


if __name__ == "__main__":
    known = Map(FOLDER)
    files = sorted({test.split("::")[0] for test in known.seconds} - set(_STARTS_JAX.values()))
    watch = Watch(known.seconds)
    plugins = [watch, Mutating(int(sys.argv[1]), known, watch)]
    sys.exit(pytest.main([*_OPTIONS, *files], plugins=plugins))
