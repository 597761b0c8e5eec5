"""Verdict and radius of a dense slice beside eigenvalues, per point: delays, batches, estimators.

LAPACK's matrices are made beforehand; jaxstab starts from the axes. Where a rival is slow it gets a
random part of the slice, stated as ``points``. ``error`` is, for a verdict, how far from the
boundary it was still wrong or undecided, as a share of the gains; for a radius, the largest error.
Balls of python-flint judge both, at walls that come closer and closer to the boundary.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxstab
from benchmarks.eigenvalues import companions
from benchmarks.grids import LoopFamily
from benchmarks.record import Row
from benchmarks.timing import Timing, interleaved
from jaxstab import Velocity
from jaxstab.conventions import Verdict
from tests.truth.boundary import Boundary
from tests.truth.filtered import (
    FilteredLoop,
    Rational,
    average,
    butterworth,
    difference,
    low_pass,
    times,
)
from tests.truth.loop import as_mpf

GAMMA, DELTA = 1e-3, 0.015
BAND = "largest distance from the boundary with a wrong or no verdict, as a share of the gains"
RADIUS_ERROR = "largest error of the spectral radius by certified roots"

_CUTOFF = 0.05  # of the sampling rate
_PLAIN_ESTIMATOR = Velocity.difference(samples=1), difference(1)
_ESTIMATORS: dict[str, tuple[Velocity, Rational]] = {
    "window of 10": (Velocity.difference(samples=10), difference(10)),
    "window of 20": (Velocity.difference(samples=20), difference(20)),
    "low pass": (Velocity.low_pass(_CUTOFF), times(difference(1), low_pass(_CUTOFF, 1))),
    "Butterworth of order 4": (
        Velocity.butterworth(_CUTOFF, order=4),
        times(difference(1), butterworth(_CUTOFF, 4)),
    ),
}
_LAPACK_WORK = 2e4  # points times degree squared of a timed call: as short as those of jaxstab
_EIGENVALUES_ON_ACCELERATOR = 100
_SHARES = 10.0 ** np.arange(-16.0, -2.0)  # of the gains, by which judged walls are moved
_JUDGED = 16  # walls of the boundary


class Method(NamedTuple):
    """A way to answer: the timed ``call`` of so many points, and ``answer(alpha, beta)``."""

    points: int
    call: Callable[[], Any]
    answer: Callable[..., Any]
    is_verdict: bool = False


class Judged(NamedTuple):
    """Walls, how far they are from the boundary as a share of the gains, and what is true there."""

    walls: np.ndarray
    distance: np.ndarray
    stable: np.ndarray
    radius: np.ndarray


_jax_eigenvalues = jax.jit(jax.numpy.linalg.eigvals)


def rows(small: bool) -> Iterator[Row]:
    side = 8 if small else 1000
    for delay in (1.0,) if small else (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0):
        yield from _rows("delay", delay, side, small)
    for side in (6,) if small else (10, 32, 100, 316, 1000, 3162):
        yield from _rows("batch", 1.0, side, small)
    for words, estimator in list(_ESTIMATORS.items())[: 1 if small else None]:
        yield from _rows(words, 1.0, 8 if small else 1000, small, estimator)


def _rows(
    section: str,
    delay: float,
    side: int,
    small: bool,
    estimator: tuple[Velocity, Rational] = _PLAIN_ESTIMATOR,
) -> Iterator[Row]:
    velocity, truth = estimator
    exact = FilteredLoop(GAMMA, DELTA, delay, truth, average(1))
    border = Boundary(exact.balls()).points(np.random.default_rng(20))
    judged = _judged(exact, border[:: max(len(border) // (2 if small else _JUDGED), 1)])
    family = LoopFamily(GAMMA, DELTA, delay, velocity)
    axes = [np.linspace(axis.min(), axis.max(), side) for axis in border.T]
    place = {"gamma": GAMMA, "delta": DELTA, "delay": delay, "velocity": velocity}
    methods = _methods(place, family, axes[0], axes[1][:, None])
    calls = {name: method.call for name, method in methods.items()}
    timings = interleaved(calls, budget=0.1 if small else 2.0, most=30)
    for name, method in methods.items():
        yield timings[name].row(
            section,
            name,
            delay=delay,
            points=method.points,
            degree=family.plant.size - 1,
            batch=side**2,
            seconds_per_point=timings[name].median / method.points,
            **_errors(method, judged),
            **_ratios(name, methods, timings),
        )


def _methods(
    place: dict[str, Any], family: LoopFamily, alpha: np.ndarray, beta: np.ndarray
) -> dict[str, Method]:
    slice_ = np.stack(np.broadcast_arrays(alpha, beta), axis=-1).reshape(-1, 2)
    order = np.random.default_rng(0).permutation(len(slice_))

    def part(most: float) -> np.ndarray:
        return slice_[order[: max(int(most), 1)]].T

    lapack = part(_LAPACK_WORK / (family.plant.size - 1) ** 2)
    few = lapack if jax.default_backend() == "cpu" else part(_EIGENVALUES_ON_ACCELERATOR)
    matrices = companions(family.coefficients(*lapack))
    on_device = jax.device_put(companions(family.coefficients(*few)))
    verdict = partial(jaxstab.verdict, **place)
    radius = partial(jaxstab.spectral_radius, **place)
    companion = partial(radius, method="companion")

    def by_jax(*walls: np.ndarray) -> np.ndarray:
        poles = _jax_eigenvalues(companions(family.coefficients(*walls)))
        return np.abs(np.asarray(poles)).max(axis=-1)

    return {
        "verdict": Method(len(slice_), partial(verdict, alpha, beta), verdict, is_verdict=True),
        "spectral_radius": Method(
            len(slice_), partial(radius, alpha, beta), lambda *walls: radius(*walls).value
        ),
        "spectral_radius, companion": Method(
            lapack.shape[1], partial(companion, *lapack), lambda *walls: companion(*walls).value
        ),
        "numpy eigvals": Method(len(matrices), partial(np.linalg.eigvals, matrices), family.radius),
        "jax eigvals": Method(len(on_device), partial(_jax_eigenvalues, on_device), by_jax),
    }


def _judged(exact: FilteredLoop, border: np.ndarray) -> Judged:
    """Walls on both sides of the boundary, closer and closer, those that balls tell apart."""
    balls = exact.balls()
    moved = [
        (wall, abs(share), balls.is_stable(*wall))
        for share in [*-_SHARES, *_SHARES]
        for wall in (border * (1.0 + share)).tolist()
    ]
    walls, distances, stable = zip(*(one for one in moved if one[2] is not None), strict=True)
    radii = [float(as_mpf(exact.radius(*wall))) for wall in walls]
    return Judged(*map(np.array, (walls, distances, stable, radii)))


def _errors(method: Method, judged: Judged) -> Row:
    answer = np.asarray(method.answer(*judged.walls.T))
    codes = (
        answer if method.is_verdict else np.where(answer < 1.0, Verdict.STABLE, Verdict.UNSTABLE)
    )
    right = codes == np.where(judged.stable, Verdict.STABLE, Verdict.UNSTABLE)
    undecided = codes == Verdict.UNDECIDED
    band = float(judged.distance[~right].max(initial=0.0))
    error = band if method.is_verdict else float(np.abs(answer - judged.radius).max())
    return {
        "error": error,
        "measure": BAND if method.is_verdict else RADIUS_ERROR,
        "judged": len(right),
        "wrong": int(np.sum(~right & ~undecided)),
        "undecided": int(np.sum(undecided)),
        "band": band,
    }


def _ratios(name: str, methods: dict[str, Method], timings: dict[str, Timing]) -> Row:
    """How many times as long, and as much CPU time, rivals take for a point."""
    if name not in ("verdict", "spectral_radius"):
        return {}
    seconds = {one: timings[one].median / methods[one].points for one in methods}
    cpu = {one: timings[one].cpu_median / methods[one].points for one in methods}
    ratios: Row = {}
    for rival in ("numpy eigvals", "jax eigvals"):
        word = rival.replace(" ", "_")
        ratios[f"times_{word}"] = seconds[rival] / seconds[name]
        ratios[f"cpu_times_{word}"] = cpu[rival] / cpu[name]
    return ratios
