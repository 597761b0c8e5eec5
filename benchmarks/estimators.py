"""Dense slices of loops with velocity estimators beside eigenvalues, per point.

LAPACK's matrices are made beforehand, of a random part of the slice, stated as ``points``; jaxstab
starts from the axes. ``error`` is how far from the boundary a verdict was still wrong or undecided,
as a share of the gains. Balls of python-flint judge, at walls that come closer and closer to the
boundary; ``undecided`` counts these walls, ``undecided_of_slice`` is the share of the slice.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.rivals import LoopFamily
from benchmarks.timing import interleaved
from benchmarks.truth.boundary import Boundary
from benchmarks.truth.filtered import (
    FilteredLoop,
    Rational,
    average,
    butterworth,
    difference,
    low_pass,
    times,
)
from jaxstab import Velocity
from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE

MEASURE = "largest distance from the boundary with a wrong or no verdict, as a share of the gains"
GAMMA, DELTA, DELAY = 1e-3, 0.015, 1.0

_CUTOFF = 0.05  # of the sampling rate
_ESTIMATORS: dict[str, tuple[Velocity, Rational]] = {
    "window of 10": (Velocity.difference(samples=10), difference(10)),
    "window of 20": (Velocity.difference(samples=20), difference(20)),
    "low pass": (Velocity.low_pass(_CUTOFF), times(difference(1), low_pass(_CUTOFF, 1))),
    "Butterworth of order 4": (
        Velocity.butterworth(_CUTOFF, order=4),
        times(difference(1), butterworth(_CUTOFF, 4)),
    ),
}
_LAPACK_WORK = 2e4  # points times degree squared of one call
_SHARES = 10.0 ** np.arange(-15.0, -2.0)  # of the gains, by which judged walls are moved
_JUDGED = 24  # walls of the boundary

_jax_eigenvalues = jax.jit(jnp.linalg.eigvals)


def rows(small: bool) -> Iterator[Row]:
    for words, (velocity, truth) in list(_ESTIMATORS.items())[: 1 if small else None]:
        yield from _estimator_rows(words, velocity, truth, small)


def _estimator_rows(words: str, velocity: Velocity, truth: Rational, small: bool) -> Iterator[Row]:
    balls = FilteredLoop(GAMMA, DELTA, DELAY, truth, average(1)).balls()
    border = Boundary(balls).points(np.random.default_rng(20))
    side = 8 if small else 1000
    alpha, beta = (np.linspace(axis.min(), axis.max(), side) for axis in border.T)
    family = LoopFamily(GAMMA, DELTA, DELAY, velocity)
    slice_ = np.stack(np.meshgrid(alpha, beta), axis=-1).reshape(-1, 2)
    some = max(int(_LAPACK_WORK / (family.plant.size - 1) ** 2), 1)
    part = np.random.default_rng(0).permutation(slice_)[:some]
    matrices = family.companions(*part.T)
    on_device = jax.device_put(matrices)

    answers: dict[str, Callable[..., Any]] = {
        "verdict": partial(_verdict, velocity),
        "numpy eigvals": lambda *walls: _codes(np.linalg.eigvals(family.companions(*walls))),
        "jax eigvals": lambda *walls: _codes(_jax_eigenvalues(family.companions(*walls))),
    }
    calls: dict[str, Callable[[], Any]] = {
        "verdict": partial(_verdict, velocity, alpha, beta[:, None]),
        "numpy eigvals": partial(np.linalg.eigvals, matrices),
        "jax eigvals": partial(_jax_eigenvalues, on_device),
    }
    points = {"verdict": side**2, "numpy eigvals": some, "jax eigvals": some}
    timings = interleaved(calls, budget=0.1 if small else 3.0, most=30)
    cpu = {name: float(np.median(timings[name].cpu_seconds)) / points[name] for name in calls}
    undecided = float(np.mean(np.asarray(timings["verdict"].answer) == UNDECIDED))

    shares = np.concatenate([-_SHARES, _SHARES])
    chosen = border[:: max(len(border) // (2 if small else _JUDGED), 1)]
    walls = (chosen * (1.0 + shares[:, None, None])).reshape(-1, 2)
    truths = [balls.is_stable(*wall) for wall in walls.tolist()]
    known = np.array([one is not None for one in truths])
    stable = np.array([bool(one) for one in truths])
    distance = np.repeat(np.abs(shares), len(chosen))
    for name, answer in answers.items():
        codes = np.asarray(answer(*walls.T))
        right = codes == np.where(stable, STABLE, UNSTABLE)
        open_ = codes == UNDECIDED
        yield {
            "section": words,
            "method": name,
            "delay": DELAY,
            "degree": family.plant.size - 1,
            "points": points[name],
            **timings[name].columns(),
            "seconds_per_point": timings[name].median / points[name],
            "error": float(distance[known & ~right].max(initial=0.0)),
            "error_measure": MEASURE,
            "judged": int(known.sum()),
            "wrong": int(np.sum(known & ~right & ~open_)),
            "undecided": int(np.sum(known & open_)),
            **({} if name != "verdict" else {"undecided_of_slice": undecided}),
            **({} if name != "verdict" else _ratios(cpu)),
        }


def _verdict(velocity: Velocity, alpha: np.ndarray, beta: np.ndarray) -> Any:
    return jaxstab.verdict(alpha, beta, GAMMA, DELTA, DELAY, velocity=velocity)


def _codes(poles: Any) -> np.ndarray:
    radius = np.abs(np.asarray(poles)).max(axis=-1)
    return np.where(radius < 1.0, STABLE, UNSTABLE)


def _ratios(cpu: dict[str, float]) -> dict[str, float]:
    rivals = ("numpy eigvals", "jax eigvals")
    return {f"cpu_times_{name.replace(' ', '_')}": cpu[name] / cpu["verdict"] for name in rivals}
