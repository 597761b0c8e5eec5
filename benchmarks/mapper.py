"""The map of docs/mapper.md: time against error on dense grids, of every way to compute them.

Points are the grid of one delay or estimator. Verdicts and radii come from jaxstab as NumPy arrays
(a first call, in a fresh process, and later ones), as arrays of JAX, and in a jit of the caller;
``method="companion"`` and LAPACK, which takes coefficients and eigenvalues of a random part of the
points, are timed in the same turns. ``error`` is the largest error of a radius at walls whose roots
are certified in balls, or the share of wrong verdicts there.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab
from benchmarks.grids import LoopFamily
from benchmarks.record import Row
from benchmarks.timing import interleaved
from jaxstab import Velocity, Verdict
from tests.truth.filtered import FilteredLoop, Rational, average, difference, low_pass, times
from tests.truth.loop import as_mpf

GAMMA, DELTA = 1e-3, 0.015
_CUTOFF = 0.05  # of the sampling rate
_LOOPS: dict[str, tuple[float, Velocity, Rational]] = {
    "delay 0": (0.0, Velocity.difference(samples=1), difference(1)),
    "delay 5": (5.0, Velocity.difference(samples=1), difference(1)),
    "delay 20": (20.0, Velocity.difference(samples=1), difference(1)),
    "low pass": (1.0, Velocity.low_pass(_CUTOFF), times(difference(1), low_pass(_CUTOFF, 1))),
    "window of 20": (1.0, Velocity.difference(samples=20), difference(20)),
}
_SIDES = (32, 100, 316, 1000)  # at 3,162 a jit of the caller takes 31 GB for radii
_MOST = {"low pass": 316, "window of 20": 316}  # of a side: radii take minutes beyond
_LAPACK_WORK = 4e5  # points times degree squared of a timed call
_JUDGED = 40

_FIRST = """
import sys
from time import process_time
import numpy as np
from benchmarks import mapper
section, side, question = sys.argv[1:]
call = mapper.question(section, int(side), question)
call(np.zeros(0), np.zeros(0))  # of no point: the imports
start = process_time()
call()
print(process_time() - start)
"""


def rows(small: bool, points: int = 1_000_000) -> Iterator[Row]:
    """Rows of grids of at most so many points."""
    sections = list(_LOOPS)[:1] if small else list(_LOOPS)
    for section in sections:
        for side in (20,) if small else _SIDES:
            if side <= _MOST.get(section, side) and side**2 <= points:
                yield from _of_grid(section, side, small)


def question(section: str, side: int, name: str) -> Callable[..., Any]:
    """A question about the grid, or about other walls."""
    delay, velocity, _ = _LOOPS[section]
    own: dict[str, Any] = {"gamma": GAMMA, "delta": DELTA, "delay": delay}
    if section in ("low pass", "window of 20"):
        own["velocity"] = velocity
    if name == "verdict":
        ask: Callable[..., Any] = partial(jaxstab.verdict, **own)
    else:
        ask = partial(jaxstab.spectral_radius, **own)
        ask = partial(ask, method="companion") if name == "companion" else ask
    alpha, beta = _axes(section, side)

    def call(*walls: Any) -> Any:
        return ask(*(walls or (alpha, beta)))

    return call


def _axes(section: str, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Around the stable set, whose size falls with the delay of the loop and the window."""
    late = {"low pass": 4.0, "window of 20": 11.0}.get(section, _LOOPS[section][0])
    alpha = np.linspace(-0.05, 1.2, side) / (1.0 + late) ** 2
    return alpha[:, None], np.linspace(-0.05, 2.1, side) / (1.0 + 2.0 * late)


def _of_grid(section: str, side: int, small: bool) -> Iterator[Row]:
    delay, velocity, truth = _LOOPS[section]
    alpha, beta = _axes(section, side)
    family = LoopFamily(GAMMA, DELTA, delay, velocity)
    degree = family.plant.size - 1
    every = [axis.ravel() for axis in np.broadcast_arrays(alpha, beta)]
    chosen = np.random.default_rng(0).permutation(side**2)
    few = chosen[: max(int(_LAPACK_WORK / degree**2), 100)]
    some = [axis[few] for axis in every]
    on_device = jnp.asarray(alpha), jnp.asarray(beta)
    points = {"numpy eigvals": few.size, "companion": few.size}
    calls: dict[str, Callable[[], Any]] = {
        "numpy eigvals": partial(family.radius, *some),
        "companion": partial(question(section, side, "companion"), *some),
    }
    answers: dict[str, Callable[..., Any]] = {
        "numpy eigvals": family.radius,
        "companion": question(section, side, "companion"),
    }
    for name in ("verdict", "spectral_radius"):
        ask = question(section, side, name)
        program = jax.jit(ask)
        for words, own, walls in (
            (name, ask, (alpha, beta)),
            (f"{name}, jax", ask, on_device),
            (f"{name}, jit", program, on_device),
        ):
            calls[words], answers[words] = partial(own, *walls), own
    timings = interleaved(calls, budget=0.05 if small else 1.0, most=15)
    exact = FilteredLoop(GAMMA, DELTA, delay, truth, average(1))
    judged = [axis[chosen[: 4 if small else _JUDGED]] for axis in every]
    radii = np.array([float(as_mpf(exact.radius(*wall))) for wall in np.transpose(judged).tolist()])
    seconds = {name: timings[name].cpu_median / points.get(name, side**2) for name in calls}
    for name, ask in answers.items():
        first = {}
        if name in ("verdict", "spectral_radius") and not small:
            first["first_cpu_seconds"] = _first_call(section, side, name)
        yield timings[name].row(
            section,
            name,
            *_error(np.asarray(_given(ask(*judged))), radii, is_verdict="verdict" in name),
            delay=delay,
            points=points.get(name, side**2),
            degree=degree,
            batch=side**2,
            seconds_per_point=seconds[name],
            times_numpy_eigvals=seconds["numpy eigvals"] / seconds[name],
            **first,
        )


def _given(answer: Any) -> Any:
    return answer.value if hasattr(answer, "value") else answer


def _error(answer: np.ndarray, radii: np.ndarray, *, is_verdict: bool) -> tuple[float, str]:
    if not is_verdict:
        return float(np.abs(answer - radii).max()), "largest error at walls with certified roots"
    wrong = answer != np.where(radii < 1.0, Verdict.STABLE, Verdict.UNSTABLE)
    return float(np.mean(wrong)), "share of wrong verdicts or none, at walls with certified roots"


def _first_call(section: str, side: int, name: str) -> float:
    words = [sys.executable, "-c", _FIRST, section, str(side), name]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return float(json.loads(done.stdout))
