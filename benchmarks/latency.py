"""What one question costs: user and system time of a fresh process, its imports included, and its
peak memory. No program is cached: each process has an empty folder for what XLA compiles.

Every row is the median of runs of one question. ``target_seconds`` is what it may cost at most; the
rival is a process with NumPy's eigenvalues that answers the same to the resolution of a grid.
``error`` is that of what the process prints, by the truth; for commands, the share that failed.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from statistics import median
from typing import NamedTuple

from mpmath import mp, mpf

from benchmarks import record
from benchmarks.eigenvalues import ALPHA, BETA, DELAY, DELTA, GAMMA, MASS, SAMPLE_TIME
from benchmarks.record import Row
from tests.truth import loop as truth

ROOT = Path(__file__).parents[1]
MEASURE = "error of what the process prints; of commands the share that failed"
MEMORY_TARGET = 500.0  # MiB

Answer = list[float]
Exact = Callable[[Answer], mpf | float]  # what the first number of an answer should be

_RUNS = 5
_LOOP = (GAMMA, DELTA, float(DELAY))
_SCENE = [
    "--mass", "0.25", "--damping", "0.1", "--sample-time", "0.001", "--delay", "0.001",
]  # fmt: skip
_HANDS = ["--hand-mass", "0:1", "--hand-stiffness", "0:400", "--hand-damping", "0:5"]
_FOUR_WALLS = [
    "--wall", "soft", "500", "10", "--wall", "medium", "2000", "20",
    "--wall", "hard", "8000", "40", "--wall", "harder", "20000", "80",
]  # fmt: skip
_LOOP_CODE = (
    "import jaxstab\n"
    "loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3, "
    "hand_mass=0.15, hand_damping=5.0, hand_stiffness=400.0, delay=1e-3)\n"
)
_COMMAND = "from jaxstab.__main__ import main; main()"
_WALL = f"{ALPHA * MASS / SAMPLE_TIME**2!r}, {BETA * MASS / SAMPLE_TIME!r}"


@dataclass(frozen=True)
class Question:
    """A question: what a fresh Python is given to answer it, the truth and the rival."""

    name: str
    target: float  # s of CPU
    words: tuple[str, ...]
    exact: Exact | None = None
    rival: str = ""


class Run(NamedTuple):
    """A process that has ended: its CPU and wall time, the peak of its memory, what it printed."""

    seconds: float
    wall: float
    peak: float  # MiB
    printed: str
    failed: bool


def rows(small: bool) -> Iterator[Row]:
    for question in _questions():
        if small and question.target > 2.0:
            continue
        runs = 1 if small else _RUNS
        yield _row(question, "jaxstab", [run(question.words) for _ in range(runs)])
        if question.rival:
            words = ("-m", "benchmarks.eigenvalues", question.rival)
            yield _row(question, "NumPy eigenvalues", [run(words) for _ in range(runs)])


def _python(code: str) -> tuple[str, ...]:
    return ("-c", _LOOP_CODE + code)


def _command(*words: str) -> tuple[str, ...]:
    return ("-c", _COMMAND, *words)


def _questions() -> list[Question]:
    slice_ = f"gamma={GAMMA}, delta={DELTA}, delay={float(DELAY)}"
    five = f"{ALPHA}, {BETA}, {slice_}"
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    snippet = re.findall(r"```python\n(.*?)\nimport jax ", readme, flags=re.DOTALL)[0]
    golden = ROOT / "data" / "golden" / "atlas-v5.h5"
    return [
        Question("atlas, one verdict", 0.5, ("-c",
            "import jaxstab\n"
            f"atlas = jaxstab.open_atlas({str(golden)!r})\n"
            "print(int(atlas.query(0.05, 0.3, gamma=0.0004, delta=0.01, delay=1.1).verdict))"
        ), lambda _: _code(0.05, 0.3, 0.0004, 0.01, 1.1)),
        Question("verdict", 1.2, _python(f"print(int(jaxstab.verdict({five})))"),
                 lambda _: _code(ALPHA, BETA, *_LOOP), "verdict"),
        Question("spectral_radius", 1.5, _python(
            f"print(float(jaxstab.spectral_radius({five}).value))"
        ), _radius, "spectral_radius"),
        Question("stable_region", 2.0, _python(
            f"print(float(jaxstab.stable_region({slice_}).max_alpha[0]))"
        ), _largest, "outline"),
        Question("margins", 2.0, _python(
            f"print(loop.alpha(float(loop.margins({_WALL}).stiffness[1])))"
        ), _end_of_margin, "margins"),
        Question("wall_limits", 2.0, _python(
            "print(loop.alpha(float(loop.limits().stiffness)))"
        ), _largest, "outline"),
        Question("optimal_gains", 3.0, _python(
            "best = loop.tune('radius')\n"
            "print(best.radius, loop.alpha(best.stiffness), loop.beta(best.damping))"
        ), _radius_of_gains, "best_gains"),
        Question("robust_region", 4.0, _python(
            f"slice_ = dict(gamma=(0.0, {GAMMA}), delta=(0.0, 0.015), delay={float(DELAY)})\n"
            "region = jaxstab.robust_region(**slice_)\n"
            "print(float(region.max_alpha[0]))"
        ), _largest_of_all, "robust_region"),
        Question("README's first snippet", 3.0, ("-c", snippet)),
        Question("jaxstab limits", 2.5, _command("limits", *_SCENE)),
        Question("jaxstab check, a range of hands", 4.0, _command(
            "check", *_SCENE, "--wall", "wall", "20000", "80",
            *_HANDS,
        )),
        Question("jaxstab check, a range of hands and four walls", 4.0, _command(
            "check", *_SCENE, *_HANDS, *_FOUR_WALLS,
        )),
        Question("jaxstab tune", 4.0, _command("tune", *_SCENE)),
        Question("jaxstab design", 3.0, _command("design", *_SCENE, "--stiffness", "5000")),
        Question("jaxstab region, with a picture", 3.0, _command(
            "region", "--gamma", str(GAMMA), "--delta", str(DELTA), "--delay", str(DELAY),
            "-o", "region.png",
        ), rival="picture"),
        Question("jaxstab figure all", 15.0, _command("figure", "all")),
        Question("jaxstab atlas build, the default", 25.0, _command("atlas", "build")),
    ]  # fmt: skip


# What a process took is asked by a small one: a child inherits the peak memory of its parent.
_MEASURED = """
import json, os, sys, time
start = time.perf_counter()
child = os.posix_spawn(sys.executable, [sys.executable, *sys.argv[1:]], os.environ)
_, status, used = os.wait4(child, 0)
with open("used.json", "w") as file:
    json.dump({
        "seconds": used.ru_utime + used.ru_stime,
        "wall": time.perf_counter() - start,
        "peak": used.ru_maxrss / 1024.0,
        "code": os.waitstatus_to_exitcode(status),
    }, file)
"""


def run(words: tuple[str, ...]) -> Run:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ours = ("JAX_", "OPENBLAS_", "XLA_")
        inherited = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
        empty = {"XDG_CACHE_HOME": f"{name}/cache", "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
        done = subprocess.run(
            [sys.executable, "-S", "-c", _MEASURED, *words],
            cwd=folder,
            env=inherited | empty,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=True,
        )
        used = json.loads((folder / "used.json").read_text())
    failed = used.pop("code") not in (0, 1) or "Traceback" in done.stderr  # 1: unstable walls
    if failed:
        print(done.stderr, file=sys.stderr)
    return Run(**used, printed=done.stdout, failed=failed)


def _row(question: Question, method: str, runs: list[Run]) -> Row:
    seconds = [run.seconds for run in runs]
    return record.row(
        question.name,
        method,
        seconds,
        max(_error_of(question, run) for run in runs),
        MEASURE,
        delay=float(DELAY),
        wall_seconds=median(run.wall for run in runs),
        peak_mib=max(run.peak for run in runs),
        target_seconds=question.target,
        target_mib=MEMORY_TARGET,
        is_on_target=bool(median(seconds) <= question.target),
    )


def _error_of(question: Question, run: Run) -> float:
    if run.failed:
        return 1.0
    if question.exact is None:
        return 0.0
    answer = [float(word) for word in run.printed.split()]
    error = float(abs(mpf(answer[0]) / question.exact(answer) - 1))
    return error if error < 1.0 else 1.0  # NaN, too


# ------------------------------------------------------------------------------------- the truths


def _code(*point: float) -> int:
    return 1 if truth.unstable_count(*point) == 0 else 2


def _radius(_: Answer) -> mpf:
    return truth.spectral_radius(ALPHA, BETA, *_LOOP)[0]


def _largest(_: Answer) -> mpf:
    return _largest_alpha(GAMMA, DELTA)


def _end_of_margin(_: Answer) -> mpf:
    angle = mp.findroot(lambda t: truth.boundary_point(t, *_LOOP)[1] - mpf(BETA), mpf("0.35"))
    return truth.boundary_point(angle, *_LOOP)[0]


def _radius_of_gains(answer: Answer) -> mpf:
    """The radius that is printed must be that of the gains that are printed."""
    return truth.spectral_radius(*answer[1:], *_LOOP)[0]


def _largest_of_all(_: Answer) -> mpf:
    """No wall is stable for all hands beyond the least of the largest alphas of some of them."""
    return min(_largest_alpha(gamma, delta) for gamma in (0.0, GAMMA) for delta in (0.0, 0.015))


@cache
def _largest_alpha(gamma: float, delta: float) -> mpf:
    """The top of the curve, by thirds: of all angles between the ends of the stable piece."""
    low, high = mpf("0.05"), mpf("0.8")
    for _ in range(60):
        first, second = low + (high - low) / 3, high - (high - low) / 3
        values = [truth.boundary_point(t, gamma, delta, float(DELAY))[0] for t in (first, second)]
        low, high = (first, high) if values[0] < values[1] else (low, second)
    return truth.boundary_point(low, gamma, delta, float(DELAY))[0]
