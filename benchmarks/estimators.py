"""Dense slices of loops with velocity estimators beside eigenvalues, per point.

LAPACK's matrices are made beforehand, of a random part of the slice, stated as ``points``; jaxstab
starts from the axes. ``error`` is how far from the boundary a verdict was still wrong or undecided,
as a share of the gains. Balls of python-flint judge, at walls that come closer and closer to the
boundary; ``undecided`` counts these walls, ``undecided_of_slice`` is the share of the slice.
``share_of_plain_recursion`` is the speed of verdicts beside that of the recursion of Schur and Cohn
in float64 alone, jitted and in tiles, which proves nothing.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.rivals import LAPACK_WORK, LoopFamily, jax_eigenvalues, largest_modulus
from benchmarks.timing import Timing, interleaved
from benchmarks.truth.balls import BallLoop
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
from jaxstab.arrays import namespace
from jaxstab.batches import MANY, compiled, over_tiles
from jaxstab.conventions import Verdict

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
PLAIN = "Schur-Cohn, not proved"
_PLAIN_TILE = 512
_SHARES = 10.0 ** np.arange(-15.0, -2.0)  # of the gains, by which judged walls are moved
_JUDGED = 24  # walls of the boundary


class Judged(NamedTuple):
    """Walls at distances from the boundary that are shares of the gains, and what is true there."""

    walls: np.ndarray
    distance: np.ndarray
    known: np.ndarray
    stable: np.ndarray


def rows(small: bool) -> Iterator[Row]:
    for words, (velocity, truth) in list(_ESTIMATORS.items())[: 1 if small else None]:
        yield from _estimator_rows(words, velocity, truth, small)


def _estimator_rows(words: str, velocity: Velocity, truth: Rational, small: bool) -> Iterator[Row]:
    balls = FilteredLoop(GAMMA, DELTA, DELAY, truth, average(1)).balls()
    border = Boundary(balls).points(np.random.default_rng(20))
    judged = _judged(balls, border[:: max(len(border) // (2 if small else _JUDGED), 1)])
    side = 8 if small else 1000
    alpha, beta = (np.linspace(axis.min(), axis.max(), side) for axis in border.T)
    family = LoopFamily(GAMMA, DELTA, DELAY, velocity)
    slice_ = np.stack(np.meshgrid(alpha, beta), axis=-1).reshape(-1, 2)
    matrices = family.companions(*_part(slice_, family).T)
    on_device = jax.device_put(matrices)

    verdict, plain = partial(_verdict, velocity), _plain_verdict(family)
    answers: dict[str, Callable[..., Any]] = {
        "verdict": verdict,
        PLAIN: plain,
        "numpy eigvals": lambda *walls: _codes(np.linalg.eigvals(family.companions(*walls))),
        "jax eigvals": lambda *walls: _codes(jax_eigenvalues(family.companions(*walls))),
    }
    calls: dict[str, Callable[[], Any]] = {
        "verdict": partial(verdict, alpha, beta[:, None]),
        PLAIN: partial(plain, alpha, beta[:, None]),
        "numpy eigvals": partial(np.linalg.eigvals, matrices),
        "jax eigvals": partial(jax_eigenvalues, on_device),
    }
    points = {name: side**2 if name in ("verdict", PLAIN) else len(matrices) for name in calls}
    timings = interleaved(calls, budget=0.1 if small else 3.0, most=30)
    for name, answer in answers.items():
        yield {
            "section": words,
            "method": name,
            "delay": DELAY,
            "degree": family.plant.size - 1,
            "points": points[name],
            **timings[name].columns(),
            "seconds_per_point": timings[name].median / points[name],
            **_errors(judged, np.asarray(answer(*judged.walls.T))),
            **(_of_slice(timings, points) if name == "verdict" else {}),
        }


def _part(slice_: np.ndarray, family: LoopFamily) -> np.ndarray:
    """Return a random part of a slice, as much as LAPACK does in one short call."""
    some = max(int(LAPACK_WORK / (family.plant.size - 1) ** 2), 1)
    return np.random.default_rng(0).permutation(slice_)[:some]


def _judged(balls: BallLoop, border: np.ndarray) -> Judged:
    """Return walls on both sides of points of the boundary, closer and closer, judged by balls."""
    shares = np.concatenate([-_SHARES, _SHARES])
    walls = (border * (1.0 + shares[:, None, None])).reshape(-1, 2)
    truths = [balls.is_stable(*wall) for wall in walls.tolist()]
    return Judged(
        walls,
        distance=np.repeat(np.abs(shares), len(border)),
        known=np.array([one is not None for one in truths]),
        stable=np.array([bool(one) for one in truths]),
    )


def _errors(judged: Judged, codes: np.ndarray) -> Row:
    right = codes == np.where(judged.stable, Verdict.STABLE, Verdict.UNSTABLE)
    open_ = codes == Verdict.UNDECIDED
    return {
        "error": float(judged.distance[judged.known & ~right].max(initial=0.0)),
        "error_measure": MEASURE,
        "judged": int(judged.known.sum()),
        "wrong": int(np.sum(judged.known & ~right & ~open_)),
        "undecided": int(np.sum(judged.known & open_)),
    }


def _of_slice(timings: dict[str, Timing], points: dict[str, int]) -> Row:
    """Return the undecided share of the slice, and CPU seconds of the rivals beside its own."""
    cpu = {name: np.median(one.cpu_seconds) / points[name] for name, one in timings.items()}
    rivals = ("numpy eigvals", "jax eigvals")
    return {
        "undecided_of_slice": float(
            np.mean(np.asarray(timings["verdict"].answer) == Verdict.UNDECIDED)
        ),
        **{
            f"cpu_times_{name.replace(' ', '_')}": float(cpu[name] / cpu["verdict"])
            for name in rivals
        },
        "share_of_plain_recursion": timings[PLAIN].median / timings["verdict"].median,
    }


def _plain_verdict(family: LoopFamily) -> Callable[..., np.ndarray]:
    """Return a function for codes by the recursion of Schur and Cohn, with what is 0 left out."""
    parts = [part.tolist() for part in (family.plant, family.alpha, family.beta)]

    def codes(alpha: Any, beta: Any) -> Any:
        falling = [
            b + s * alpha + d * beta if s or d else b for b, s, d in zip(*parts, strict=True)
        ]
        xp = namespace(alpha, beta)
        inside = alpha + beta < np.inf
        while len(falling) > 1:
            ratio = falling[-1] / falling[0]
            inside = inside & (abs(ratio) < 1.0)
            pairs = zip(falling, reversed(falling), strict=True)
            falling = [
                one if isinstance(other, float) and other == 0.0 else one - ratio * other
                for one, other in pairs
            ][:-1]
        return xp.where(inside, Verdict.STABLE, Verdict.UNSTABLE).astype(np.int8)

    @compiled(many=MANY, wide=True, pointwise=True)
    def in_tiles(alpha: Any, beta: Any) -> Any:
        return over_tiles(codes, (alpha, beta), _PLAIN_TILE)

    return lambda alpha, beta: np.asarray(in_tiles(alpha, beta))


def _verdict(velocity: Velocity, alpha: np.ndarray, beta: np.ndarray) -> Any:
    return jaxstab.verdict(alpha, beta, gamma=GAMMA, delta=DELTA, delay=DELAY, velocity=velocity)


def _codes(poles: Any) -> np.ndarray:
    return np.where(largest_modulus(poles) < 1.0, Verdict.STABLE, Verdict.UNSTABLE)
