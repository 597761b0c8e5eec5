"""A million verdicts next to the boundary against certified roots of python-flint.

Points are random: any plant of the model, most of them within 1e-6 ... 1e-16 of the boundary's
curve or of its two lines, relative to the gains. ``error`` is the share of wrong verdicts; a column
``undecided_beyond_1e-k`` is the share of UNDECIDED among the points farther away than that. Where a
root is on the circle to 360 digits, STABLE and UNSTABLE both count as wrong.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from time import perf_counter, process_time

import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.timing import Timing
from benchmarks.truth.balls import ExactPlant
from benchmarks.truth.near_boundary import points_near_the_boundary, random_plants
from jaxstab.conventions import Verdict

MEASURE = "share of verdicts that certified roots contradict"
DECADES = tuple(range(16, 5, -1))

_PER_PLANT = 500
_PLANTS = {  # for each delay, fewer where the judge takes long; a million points in all
    0.0: 320, 0.25: 200, 0.5: 200, 1.0: 300, 1.5: 160, 2.0: 200, 2.75: 100, 3.0: 120, 4.5: 80,
    5.0: 100, 7.3: 60, 8.0: 50, 10.0: 40, 14.5: 20, 20.0: 20, 33.0: 10, 41.7: 8, 59.5: 6, 60.0: 6,
}  # fmt: skip
_SMALL = {0.0: 1, 1.0: 1}


@dataclass
class _Answers:
    """What one method said, plant after plant, and how long it took each time."""

    codes: list[np.ndarray] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)


def rows(small: bool) -> Iterator[Row]:
    for delay, plants in (_SMALL if small else _PLANTS).items():
        yield from _delay_rows(delay, plants, 60 if small else _PER_PLANT)


def _delay_rows(delay: float, plants: int, per_plant: int) -> Iterator[Row]:
    rng = np.random.default_rng([20120412, round(100 * delay)])
    answers = {name: _Answers() for name in ("verdict", "verdict, exact", "python-flint roots")}
    distances = []
    for gamma, delta in random_plants(rng, plants):
        points = points_near_the_boundary(rng, gamma, delta, delay, per_plant)
        distances.append(points.distance)
        for name, answer in answers.items():
            start, cpu_start = perf_counter(), process_time()
            codes = _codes(name, points.alpha, points.beta, gamma, delta, delay)
            answer.seconds.append(perf_counter() - start)
            answer.cpu_seconds.append(process_time() - cpu_start)
            answer.codes.append(codes)
    true = np.concatenate(answers["python-flint roots"].codes)
    distance = np.concatenate(distances)
    for name, answer in answers.items():
        codes = np.concatenate(answer.codes)
        undecided = codes == Verdict.UNDECIDED
        wrong = ~undecided & (codes != true)
        seconds = Timing(codes, answer.seconds, answer.seconds, answer.cpu_seconds)
        yield {
            "section": "campaign",
            "method": name,
            "delay": delay,
            "points": codes.size,
            **seconds.columns(),
            "seconds_per_point": seconds.median / per_plant,
            "error": float(np.mean(wrong)),
            "error_measure": MEASURE,
            "wrong": int(wrong.sum()),
            "within_1e-6": int(np.sum(distance < 1e-6)),
            "undecided": float(np.mean(undecided)),
            **{
                f"undecided_beyond_1e-{decade}": _share(undecided, distance >= 10.0**-decade)
                for decade in DECADES
            },
        }


def _codes(
    method: str, alpha: np.ndarray, beta: np.ndarray, gamma: float, delta: float, delay: float
) -> np.ndarray:
    if method == "python-flint roots":
        plant = ExactPlant.of(gamma, delta, delay)
        points = zip(alpha.tolist(), beta.tolist(), strict=True)
        return np.array([plant.code(a, b, gamma, delay) for a, b in points])
    resolve = "exact" if method == "verdict, exact" else None
    return np.asarray(
        jaxstab.verdict(alpha, beta, gamma=gamma, delta=delta, delay=delay, resolve=resolve)
    )


def _share(undecided: np.ndarray, chosen: np.ndarray) -> float:
    return float(np.mean(undecided[chosen])) if chosen.any() else 0.0
