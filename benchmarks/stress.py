"""Where numbers go wrong: random and adversarial loops, judged by certified roots of python-flint.

Random loops are of four families: next to the boundary, next to multiple roots, at special plants
(critical damping, Nyquist frequency, none), and anywhere, from 1e-300 to the largest allowed
values. Adversaries climb: they change the loops at which a bound came closest to the true error, or
a verdict to the circle, and keep what is worse. ``error`` is the largest error of a radius in units
of its last place. ``share_of_bound`` is the largest true error over its proved bound: above 1 the
proof would be wrong. ``band`` is the largest distance of a root from the circle at which a verdict
was UNDECIDED. The worst loops are given by their five parameters.
"""

import math
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from time import perf_counter
from typing import Any, NamedTuple

import jax
import numpy as np
import truth
from near_boundary import points_near_the_boundary, random_plants

from benchmarks.judge import METHODS, Judgement, Loops, Truth, answers_of, judged, truth_of
from benchmarks.record import Row

MEASURE = "largest error of a spectral radius in units of its last place"
DEFAULT_POINTS = 100_000

_PLANTS, _WALLS = 16, 128  # of a task of random loops, and
_CLIMBERS, _CHILDREN = 16, 8  # loops that are changed and how often, at short delays
_GENERATIONS = 8
_ADVERSARIAL = 0.2  # of all points
_DELAYS = {  # and how many of the points have it: the judge takes long for long ones
    0.0: 16, 1.0: 16, 0.5: 8, 2.0: 10, 1e-12: 4, 1.0 - 1e-12: 4, 1.5: 6, 2.75: 6, 3.0: 8, 5.0: 6,
    7.3: 4, 10.0: 4, 20.0: 1, 21.5: 1, 33.3: 0.4, 60.0: 0.3, 200.0: 0.02,
}  # fmt: skip
_SMALL_DELAYS = {0.0: 1}
_LEAST_DECADE = -20  # of gamma and delta: smaller ones, and 0, count with it
_AXES = ("delay", "gamma", "delta")


class Task(NamedTuple):
    """A share of the work of one process."""

    seed: int
    delay: float
    is_adversarial: bool

    @property
    def walls(self) -> int:
        """Walls of a plant; fewer where the judge takes long."""
        most = _CHILDREN if self.is_adversarial else _WALLS
        return max(1, int(most / (1.0 + (self.delay / 10.0) ** 2)))

    @property
    def points(self) -> int:
        """How many loops are judged."""
        return self.walls * (_CLIMBERS * _GENERATIONS if self.is_adversarial else _PLANTS)


@dataclass
class Tally:
    """What is known of one method at one delay, or in one decade of gamma or delta."""

    points: int = 0
    wrong: int = 0
    undecided: int = 0
    error: float = 0.0
    share_of_bound: float = 0.0
    band: float = 0.0
    worst: dict[str, list[float]] = field(default_factory=dict)

    def add(self, points: np.ndarray, truth: Truth, found: Judgement) -> None:
        self.points += len(points)
        self.wrong += int(found.wrong.sum())
        self.undecided += int(found.undecided.sum())
        if found.wrong.any():
            self.worst["wrong"] = points[int(np.argmax(found.wrong))].tolist()
        self._keep("error", found.ulps, points)
        self._keep("share_of_bound", found.share, points)
        self._keep("band", np.where(found.undecided, truth.distance, 0.0), points)

    def merge(self, other: "Tally") -> None:
        for name in ("points", "wrong", "undecided"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        if "wrong" in other.worst:
            self.worst.setdefault("wrong", other.worst["wrong"])
        for name in ("error", "share_of_bound", "band"):
            if getattr(other, name) > getattr(self, name):
                setattr(self, name, getattr(other, name))
                self.worst[name] = other.worst[name]

    def _keep(self, name: str, values: np.ndarray, points: np.ndarray) -> None:
        finite = np.where(np.isfinite(values), values, 0.0)
        worst = int(np.argmax(finite))
        if finite[worst] > getattr(self, name):
            setattr(self, name, float(finite[worst]))
            self.worst[name] = points[worst].tolist()


Key = tuple[str, float, str]  # an axis, the delay or the decade, the method
Tallies = dict[Key, Tally]


def rows(small: bool, points: int = DEFAULT_POINTS) -> Iterator[Row]:
    """Share the work among processes and yield a row for each method and place on an axis."""
    tasks = _tasks(_PLANTS * _WALLS if small else points, _SMALL_DELAYS if small else _DELAYS)
    total: Tallies = {}
    seconds: dict[float, list[float]] = {}
    workers = 1 if small else os.cpu_count() or 1
    with ProcessPoolExecutor(workers, get_context("spawn"), _start_worker) as pool:
        shares = [pool.submit(run, task) for task in tasks]
        for number, share in enumerate(as_completed(shares), start=1):
            task, tallies, spent = share.result()
            seconds.setdefault(task.delay, []).append(spent)
            for key, tally in tallies.items():
                total.setdefault(key, Tally()).merge(tally)
            if not small and number % 20 == 0:
                done = sum(t.points for (axis, _, m), t in total.items() if _counts(axis, m))
                print(f"{number} of {len(tasks)} shares, {done:,} points", flush=True)
    spent = [second for some in seconds.values() for second in some]
    for (axis, place, method), tally in sorted(total.items()):
        times = seconds[place] if axis == "delay" else spent
        yield _row(axis, place, method, tally, times)


def run(task: Task) -> tuple[Task, Tallies, float]:
    """Return what one share of the work has found."""
    start = perf_counter()
    tallies: Tallies = {}
    rng = np.random.default_rng([task.seed, round(1e3 * task.delay), task.is_adversarial])
    if task.is_adversarial:
        _climb(rng, task, tallies)
    else:
        _judge(_random_loops(rng, task.delay, _PLANTS, task.walls), tallies)
    return task, tallies, perf_counter() - start


def _tasks(points: int, delays: dict[float, float]) -> list[Task]:
    """Share the points among delays, a part of them to adversaries; the long shares first."""
    tasks = []
    for delay, part in delays.items():
        wanted = points * part / sum(delays.values())
        for is_adversarial, share in ((True, _ADVERSARIAL), (False, 1.0 - _ADVERSARIAL)):
            count = math.ceil(share * wanted / Task(0, delay, is_adversarial).points)
            tasks += [Task(seed, delay, is_adversarial) for seed in range(count)]
    return sorted(tasks, key=lambda task: -task.delay)


def _start_worker() -> None:
    jax.config.update("jax_enable_x64", True)


def _judge(loops: Loops, tallies: Tallies) -> dict[str, Judgement]:
    exact, points = truth_of(loops), loops.points
    found = {name: judged(answer, exact) for name, answer in answers_of(loops).items()}
    places = {"delay": points[:, 4], "gamma": _decade(points[:, 2]), "delta": _decade(points[:, 3])}
    for axis, values in places.items():
        for place in np.unique(values).tolist():
            here = values == place
            some = Truth(*(column[here] for column in exact))
            for name, judgement in found.items():
                tally = tallies.setdefault((axis, place, name), Tally())
                tally.add(points[here], some, Judgement(*(column[here] for column in judgement)))
    # Nearest to a wrong answer: a bound that is used up, a verdict close to the circle.
    for name in ("verdict", "verdict, exact"):
        close = np.where(found[name].undecided, 0.0, -np.log10(exact.distance + 1e-300))
        found[name] = found[name]._replace(share=np.where(found[name].wrong, np.inf, close))
    return found


def _decade(values: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.maximum(np.floor(np.log10(values)), _LEAST_DECADE)


# ---------------------------------------------------------------------------------- random loops


def _random_loops(rng: np.random.Generator, delay: float, plants: int, walls: int) -> Loops:
    """Return loops of all families, a family for each plant."""
    pairs = [_plant(rng) for _ in range(plants)]
    gains = [_gains(rng, *pair, delay, walls) for pair in pairs]
    gamma, delta = np.array(pairs).T
    alpha, beta = (np.array(column) for column in zip(*gains, strict=True))
    return Loops(gamma, delta, alpha, beta, delay)


def _plant(rng: np.random.Generator) -> tuple[float, float]:
    kind = rng.integers(4)
    if kind <= 1:
        return random_plants(rng, 1)[0]
    if kind == 2:  # anywhere
        lowest = rng.choice([-300.0, -10.0], 2)
        gamma, delta = 10.0 ** rng.uniform(lowest, [4.0, 3.0])
        return min(float(gamma), 1e4), min(float(delta), 1e3)
    delta = float(rng.choice([0.0, 5e-324, 10.0 ** rng.uniform(-16, 2.9), rng.uniform(0.0, 2.0)]))
    gamma = float(rng.choice([0.0, 5e-324, 0.25 * delta**2, (np.pi * rng.integers(1, 32)) ** 2]))
    for _ in range(rng.integers(3)):
        gamma = float(np.nextafter(gamma, 1e4))
    return min(gamma, 1e4), delta


def _gains(
    rng: np.random.Generator, gamma: float, delta: float, delay: float, walls: int
) -> tuple[np.ndarray, np.ndarray]:
    kind = rng.integers(8)
    if kind == 0:  # anywhere
        sizes = 10.0 ** (rng.uniform(-300.0, 150.0, (2, walls)) / rng.choice([1.0, 50.0]))
        alpha, beta = np.minimum(sizes, 1e150) * rng.choice([-1.0, 0.0, 1.0], (2, walls))
    elif kind <= 2:
        alpha, beta = _multiple_root_gains(rng, gamma, delta, delay, walls)
    else:
        with np.errstate(all="ignore"):
            alpha, beta, _ = points_near_the_boundary(rng, gamma, delta, delay, walls)
    usable = (np.abs(alpha) <= 1e150) & (np.abs(beta) <= 1e150)
    return np.where(usable, alpha, 0.1), np.where(usable, beta, 0.3)


def _multiple_root_gains(
    rng: np.random.Generator, gamma: float, delta: float, delay: float, walls: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return gains next to those with a double real root: p(r) = p'(r) = 0 is linear in them."""
    whole, fraction = truth.split_delay(delay)
    plant = truth.sampled_plant(gamma, delta, fraction if fraction else 0)
    d1, d0, n2, n1, n0 = (float(value) for value in plant[:5])
    r = rng.uniform(-1.1, 1.1, walls)
    start, numerator = np.poly1d([1.0, d1, d0]), np.poly1d([n2, n1, n0])
    power = np.poly1d([1.0, *[0.0] * (whole + 1)])
    free, stiff, damp = power * start, numerator * np.poly1d([1, 0]), numerator * np.poly1d([1, -1])
    columns = [[p(r), p.deriv()(r)] for p in (stiff, damp, free)]
    (s, s_slope), (t, t_slope), (f, f_slope) = columns
    with np.errstate(all="ignore"):
        determinant = s * t_slope - t * s_slope
        alpha = (t * f_slope - f * t_slope) / determinant
        beta = (f * s_slope - s * f_slope) / determinant
    off = 10.0 ** rng.uniform(-17, -3, (2, walls)) * rng.choice([-1.0, 0.0, 1.0], (2, walls))
    gains = np.nan_to_num(np.stack([alpha, beta]) * (1.0 + off), nan=0.1, posinf=0.1, neginf=0.1)
    return gains[0], gains[1]


# ------------------------------------------------------------------------------------- adversaries


def _climb(rng: np.random.Generator, task: Task, tallies: Tallies) -> None:
    """Change loops, and keep those that come closest to a wrong answer of one method."""
    method = METHODS[rng.integers(4)]
    parents = _random_loops(rng, task.delay, _CLIMBERS, task.walls)
    fitness = np.full(_CLIMBERS, -np.inf)
    best = Loops(*parents[:2], parents.alpha[:, :1], parents.beta[:, :1], task.delay)
    for _ in range(_GENERATIONS):
        share = _judge(parents, tallies)[method].share.reshape(parents.alpha.shape)
        share = np.nan_to_num(share, nan=-1.0, posinf=1e300)
        child = np.argmax(share, axis=1)
        top = share[np.arange(_CLIMBERS), child]
        better = top > fitness
        fitness = np.where(better, top, fitness)
        best = Loops(
            np.where(better, parents.gamma, best.gamma),
            np.where(better, parents.delta, best.delta),
            np.where(better, parents.alpha[np.arange(_CLIMBERS), child], best.alpha[:, 0])[:, None],
            np.where(better, parents.beta[np.arange(_CLIMBERS), child], best.beta[:, 0])[:, None],
            task.delay,
        )
        parents = _changed(rng, best, task.walls)


def _changed(rng: np.random.Generator, best: Loops, children: int) -> Loops:
    """Return loops around the best ones: by a little or by much, the plant or the gains."""
    shape = (_CLIMBERS, children)

    def factor(size: tuple[int, ...]) -> np.ndarray:
        return 1.0 + rng.standard_normal(size) * 10.0 ** rng.uniform(-16.0, -0.5, size)

    of_plant = np.where(rng.random(_CLIMBERS) < 0.5, factor((_CLIMBERS,)), 1.0)
    of_damper = np.where(rng.random(_CLIMBERS) < 0.5, factor((_CLIMBERS,)), 1.0)
    return Loops(
        np.clip(np.abs(best.gamma * of_plant), 0.0, 1e4),
        np.clip(np.abs(best.delta * of_damper), 0.0, 1e3),
        np.clip(best.alpha * factor(shape), -1e150, 1e150),
        np.clip(best.beta * factor(shape), -1e150, 1e150),
        best.delay,
    )


# ------------------------------------------------------------------------------------------ report


def _row(axis: str, place: float, method: str, tally: Tally, times: list[float]) -> dict[str, Any]:
    low, middle, high = np.quantile(times, (0.25, 0.5, 0.75)).tolist()
    return {
        "section": axis,
        "method": method,
        "delay": place if axis == "delay" else 0.0,
        "points": tally.points,
        "seconds": middle,  # of one share, all methods and the judge
        "seconds_quartiles": [low, high],
        "repeats": len(times),
        "error": tally.error,
        "error_measure": MEASURE,
        "place": place,
        "wrong": tally.wrong,
        "undecided": tally.undecided,
        "share_of_bound": tally.share_of_bound,
        "band": tally.band,
        **{f"worst_{name}": repr(point) for name, point in tally.worst.items()},
    }


def _counts(axis: str, method: str) -> bool:
    """Whether the points of a tally are to be counted, each of them once."""
    return axis == "delay" and method == METHODS[0]
