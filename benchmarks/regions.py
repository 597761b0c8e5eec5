"""Stable regions of random slices against certified root counts.

``error`` is the share of points misclassified. An UNRESOLVED region claims of no point that it is
stable: of its points those are wrong that it contains and that are not stable.

Slices are random: weak and strong hands, beyond the Nyquist frequency and next to its multiples,
without damping, whole and fractional delays to 50 samples, stability and decay rates. Points are
those of ``loops``. A rival is the polygon itself. The judge is the criterion of Schur and Cohn in
balls of python-flint.
"""

from collections.abc import Iterator
from time import perf_counter
from typing import NamedTuple

import numpy as np
from matplotlib.path import Path as Polygon

from benchmarks import record
from benchmarks.loops import probes
from benchmarks.record import Row
from jaxstab.region import RegionStatus, stable_region
from tests.truth.balls import ExactPlant

MEASURE = "share of points misclassified, by certified root counts"

_CLASSES = ((0, 2, 5000), (2, 8, 3000), (8, 20, 2000), (20, 51, 500))  # delays, how many slices

Slice = tuple[float, float, float, float]


class Tally(NamedTuple):
    """What became of one slice: its status, the judged points, those answered wrong, seconds."""

    status: RegionStatus
    judged: int
    wrong: int
    wrong_of_polygon: int
    seconds: float


def rows(small: bool) -> Iterator[Row]:
    for first, stop, count in _CLASSES[:1] if small else _CLASSES:
        rng = np.random.default_rng(stop)
        slices = random_slices(rng, 4 if small else count, first, stop)
        tallies = [tally(place, rng) for place in slices]
        judged = sum(one.judged for one in tallies)
        for column, method in (("wrong", "stable_region"), ("wrong_of_polygon", "its polygon")):
            wrong = sum(getattr(one, column) for one in tallies)
            yield record.row(
                "slices",
                method,
                [one.seconds for one in tallies],
                wrong / judged,
                MEASURE,
                delay=stop - 1,
                points=judged // len(slices),
                slices=len(slices),
                judged=judged,
                wrong=wrong,
                **{s.name.lower(): sum(one.status == s for one in tallies) for s in RegionStatus},
            )


def random_slices(rng: np.random.Generator, count: int, first: int, stop: int) -> list[Slice]:
    """Return slices (gamma, delta, delay, radius) with delays from first to below stop."""
    return [_random_slice(rng, first, stop) for _ in range(count)]


def _random_slice(rng: np.random.Generator, first: int, stop: int) -> Slice:
    nyquist = (np.pi * rng.integers(1, 4)) ** 2
    gamma = rng.choice(
        [
            12 * rng.uniform() ** 3,
            10 ** rng.uniform(-9, 0),
            10 ** rng.uniform(0, 3),
            nyquist * (1 + rng.choice([-1, 1]) * 10 ** rng.uniform(-4, -1)),
            0.0,
        ],
        p=[0.35, 0.3, 0.15, 0.15, 0.05],
    )
    delta = rng.choice(
        [rng.uniform(0, 0.6), 10 ** rng.uniform(-9, 1), 10 ** rng.uniform(0, 2), 0.0],
        p=[0.35, 0.35, 0.1, 0.2],
    )
    whole = int(rng.integers(first, stop))
    close = 10 ** rng.uniform(-9, -1)
    fraction = rng.choice([0.0, rng.uniform(), close, 1 - close], p=[0.5, 0.3, 0.1, 0.1])
    delay = min(whole + fraction, stop - 1.0)
    radius = rng.choice([1.0, 0.6 ** (rng.uniform() / (1 + delay))], p=[0.7, 0.3])
    return float(gamma), float(delta), float(delay), float(radius)


def tally(place: Slice, rng: np.random.Generator) -> Tally:
    """Judge one slice at random points."""
    start = perf_counter()
    gamma, delta, delay, radius = place
    region = stable_region(gamma=gamma, delta=delta, delay=delay, radius=radius)
    seconds = perf_counter() - start
    status = RegionStatus(int(region.status))
    balls = ExactPlant.of(gamma, delta, delay).loop(delay).within(radius)
    points = probes(region, balls, rng)
    expected = [balls.is_stable(*point) for point in points.tolist()]
    decided = np.array([one is not None for one in expected])
    truths = np.array([bool(one) for one in expected])
    answers = np.asarray(region.contains(*points.T))
    filled = np.zeros(len(points), bool)
    if len(region.points):
        filled = Polygon(region.points).contains_points(points)
    claimed = decided & (answers | (status != RegionStatus.UNRESOLVED))
    return Tally(
        status,
        int(np.sum(decided)),
        int(np.sum(claimed & (answers != truths))),
        int(np.sum(claimed & (filled != truths))),
        seconds,
    )
