"""Where numbers go wrong: random and adversarial loops, judged by certified roots of python-flint.

Random loops are of four families: next to the boundary, next to multiple roots, at special plants
(critical damping, Nyquist frequency, none), and anywhere, from 1e-300 to the largest allowed
values. Adversaries climb: they change the loops at which a bound came closest to the true error, or
a verdict to the circle, and keep what is worse. ``error`` is the largest error of a radius in units
of its last place. ``share_of_bound`` is the largest true error over its proved bound: above 1 the
proof would be wrong. ``band`` is the largest distance of a root from the circle at which a verdict
was UNDECIDED. ``unjudged`` loops have roots that 400 digits do not tell apart. The worst loops are
given by their five parameters. The record is written every half minute: a campaign that is ended
leaves one of what it did.
"""

import math
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxstab
from benchmarks import record
from benchmarks.hard_loops import changed_loops, random_loops
from benchmarks.record import Row
from tests.truth.judge import METHODS, Judgement, Loops, Truth, answers_of, judged, truth_of

MEASURE = "largest error of a spectral radius in units of its last place"
DEFAULT_POINTS = 100_000

# Plants, and walls of each, that are asked at once: each size is compiled for each delay, so there
# are two. Where the judge takes long, there is one adversary for many loops.
_RANDOM, _ADVERSARIES, _LONG_DELAYS = (8, 128), (16, 64), (16, 4)
_LONG = 25.0
_GENERATIONS = 8
_ADVERSARIAL = 0.2  # of all points
_DELAYS = {  # and how many of the points have it: the judge takes long for long ones
    0.0: 20, 1.0: 20, 0.5: 10, 2.0: 12, 1e-12: 4, 1.0 - 1e-12: 4, 1.5: 6, 2.75: 6, 3.0: 7, 5.0: 4,
    7.3: 2, 10.0: 2, 20.0: 0.5, 21.5: 0.5, 33.3: 0.1, 60.0: 0.05, 200.0: 0.003,
}  # fmt: skip
_SMALL_DELAYS = {0.0: 1}
_SMALL_POINTS = 2_000
_LEAST_DECADE = -20  # of gamma and delta: smaller ones, and 0, count with it
_SECONDS_BETWEEN_RECORDS = 30.0


class Task(NamedTuple):
    """A share of the work of one process."""

    seed: int
    delay: float
    is_adversarial: bool

    @property
    def shape(self) -> tuple[int, int]:
        """How many plants are asked at once, and walls of each."""
        if self.delay > _LONG:
            return _LONG_DELAYS
        return _ADVERSARIES if self.is_adversarial else _RANDOM

    @property
    def points(self) -> int:
        """How many loops are judged."""
        return math.prod(self.shape) * (_GENERATIONS if self.is_adversarial else 1)


@dataclass
class Tally:
    """What is known of one method at one delay, or in one decade of gamma or delta."""

    points: int = 0
    wrong: int = 0
    undecided: int = 0
    unjudged: int = 0
    error: float = 0.0
    share_of_bound: float = 0.0
    band: float = 0.0
    worst: dict[str, list[float]] = field(default_factory=dict)

    def add(self, points: np.ndarray, truth: Truth, found: Judgement) -> None:
        self.points += len(points)
        self.wrong += int(found.wrong.sum())
        self.undecided += int(found.undecided.sum())
        self.unjudged += int(np.isnan(truth.distance).sum())
        if found.wrong.any():
            self.worst["wrong"] = points[int(np.argmax(found.wrong))].tolist()
        self._keep_largest("error", found.ulps, points)
        self._keep_largest("share_of_bound", found.share, points)
        self._keep_largest("band", np.where(found.undecided, truth.distance, 0.0), points)

    def merge(self, other: "Tally") -> None:
        for name in ("points", "wrong", "undecided", "unjudged"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        if "wrong" in other.worst:
            self.worst.setdefault("wrong", other.worst["wrong"])
        for name in ("error", "share_of_bound", "band"):
            self._keep(name, getattr(other, name), other.worst.get(name, []))

    def _keep_largest(self, name: str, values: np.ndarray, points: np.ndarray) -> None:
        known = np.where(np.isnan(values), 0.0, np.minimum(values, 1e300))
        worst = int(np.argmax(known))
        self._keep(name, float(known[worst]), points[worst].tolist())

    def _keep(self, name: str, value: float, point: list[float]) -> None:
        if value > getattr(self, name):
            setattr(self, name, value)
            self.worst[name] = point


Key = tuple[str, float, str]  # an axis, the delay or the decade, the method
Tallies = dict[Key, Tally]


class Share(NamedTuple):
    """What one task has found."""

    task: Task
    tallies: Tallies
    seconds: float


@dataclass
class Findings:
    """What all shares so far have found."""

    tallies: Tallies = field(default_factory=dict)
    seconds: dict[float, list[float]] = field(default_factory=dict)

    @property
    def points(self) -> int:
        """How many loops were judged."""
        each = (t.points for (axis, _, m), t in self.tallies.items() if (axis, m) == _EACH_ONCE)
        return sum(each)

    def add(self, share: Share) -> None:
        self.seconds.setdefault(share.task.delay, []).append(share.seconds)
        for key, tally in share.tallies.items():
            self.tallies.setdefault(key, Tally()).merge(tally)

    def rows(self) -> list[Row]:
        """Return a row for each method and place on an axis."""
        spent = [second for some in self.seconds.values() for second in some]
        return [
            _row(key, tally, self.seconds[key[1]] if key[0] == "delay" else spent)
            for key, tally in sorted(self.tallies.items())
        ]


_EACH_ONCE = ("delay", METHODS[0])


def rows(
    small: bool, points: int = DEFAULT_POINTS, keep: Callable[[list[Row]], object] | None = None
) -> Iterator[Row]:
    """Share the work among processes; now and then ``keep`` is given the rows of what is done."""
    tasks = tasks_of(*((_SMALL_POINTS, _SMALL_DELAYS) if small else (points, _DELAYS)))
    found, failed = Findings(), []
    kept = perf_counter()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of the workers: there is one for each core
    with TemporaryDirectory() as compiled:
        workers = 1 if small else os.cpu_count()
        pool = ProcessPoolExecutor(workers, get_context("spawn"), _start_worker, (compiled,))
        try:
            shares = {pool.submit(share_of, task): task for task in tasks}
            for number, share in enumerate(as_completed(shares), start=1):
                if error := share.exception():
                    failed.append(f"{shares[share]}: {error!r}")
                    print(failed[-1], flush=True)
                else:
                    found.add(share.result())
                if found.points and perf_counter() - kept > _SECONDS_BETWEEN_RECORDS:
                    kept = perf_counter()
                    print(f"{number} of {len(tasks)} shares, {found.points:,} loops", flush=True)
                    if keep is not None:
                        keep(found.rows())
        finally:
            pool.shutdown(cancel_futures=True)
    yield from found.rows()
    if failed:
        raise RuntimeError(f"{len(failed)} shares of the work failed, the first of {failed[0]}")


def tasks_of(points: int, delays: dict[float, float]) -> list[Task]:
    """Share the points among delays, a part of them to adversaries; each beginning is a mixture."""
    placed = []
    for delay, part in delays.items():
        wanted = points * part / sum(delays.values())
        for is_adversarial, share in ((True, _ADVERSARIAL), (False, 1.0 - _ADVERSARIAL)):
            count = math.ceil(share * wanted / Task(0, delay, is_adversarial).points)
            tasks = [Task(seed, delay, is_adversarial) for seed in range(count)]
            placed += [((task.seed + 0.5) / count, task) for task in tasks]
    return [task for _, task in sorted(placed)]


def share_of(task: Task) -> Share:
    """Do one share of the work."""
    start = perf_counter()
    tallies: Tallies = {}
    bits = int(np.float64(task.delay).view(np.uint64))
    rng = np.random.default_rng([task.seed, bits, task.is_adversarial])
    loops = random_loops(rng, task.delay, *task.shape)
    if task.is_adversarial:
        _climb(rng, loops, tallies)
    else:
        _judge(loops, tallies)
    return Share(task, tallies, perf_counter() - start)


def _start_worker(compiled: str) -> None:
    """Leave Ctrl-C to the parent, and share a folder of compiled functions with other workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    jaxstab.use_compilation_cache(compiled)
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


def _climb(rng: np.random.Generator, parents: Loops, tallies: Tallies) -> None:
    """Change loops, and keep those that come closest to a wrong answer of one method."""
    method = METHODS[rng.integers(4)]
    plants, children = parents.alpha.shape
    each = np.arange(plants)
    fitness = np.full(plants, -np.inf)
    best = Loops(*parents[:2], parents.alpha[:, :1], parents.beta[:, :1], parents.delay)
    for _ in range(_GENERATIONS):
        share = _judge(parents, tallies)[method].share.reshape(parents.alpha.shape)
        share = np.nan_to_num(share, nan=-1.0, posinf=1e300)
        child = np.argmax(share, axis=1)
        better = share[each, child] > fitness
        fitness = np.where(better, share[each, child], fitness)
        best = Loops(
            np.where(better, parents.gamma, best.gamma),
            np.where(better, parents.delta, best.delta),
            np.where(better, parents.alpha[each, child], best.alpha[:, 0])[:, None],
            np.where(better, parents.beta[each, child], best.beta[:, 0])[:, None],
            parents.delay,
        )
        parents = changed_loops(rng, best, children)


def _decade(values: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.maximum(np.floor(np.log10(values)), _LEAST_DECADE)


def _row(key: Key, tally: Tally, times: list[float]) -> dict[str, Any]:
    axis, place, method = key
    return record.row(
        axis,
        method,
        times,  # of one share, all methods and the judge
        tally.error,
        MEASURE,
        delay=place if axis == "delay" else 0.0,
        points=tally.points,
        place=place,
        wrong=tally.wrong,
        undecided=tally.undecided,
        unjudged=tally.unjudged,
        share_of_bound=tally.share_of_bound,
        band=tally.band,
        **{f"worst_{name}": repr(point) for name, point in tally.worst.items()},
    )
