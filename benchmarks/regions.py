"""Stable regions of random slices against certified root counts.

``error`` is the share of points misclassified. An UNRESOLVED region claims of no point that it is
stable: of its points those are wrong that it contains and that are not stable.

Slices are random: weak and strong hands, beyond the Nyquist frequency and next to its multiples,
without damping, whole and fractional delays to 50 samples, stability and decay rates. Points are
anywhere around a region, next to its outline, and next to pieces of the boundary that eigenvalues
find at random angles, whether the region has them or not; of the last two kinds half are where
region and eigenvalues agree least. A rival is the polygon itself. The judge is the criterion of
Schur and Cohn in balls of python-flint, on coefficients of 50 digits.
"""

from collections.abc import Iterator
from time import perf_counter
from typing import NamedTuple

import flint
import numpy as np
from matplotlib.path import Path as Polygon
from mpmath import mp, mpf

from benchmarks import truth
from benchmarks.record import Row
from jaxstab.region import RegionStatus, StableRegion, stable_region

MEASURE = "share of points misclassified, by certified root counts"

DISTANCES = 10.0 ** -np.arange(3, 10)  # from the boundary, relative to the region
_CLASSES = ((0, 2, 5000), (2, 8, 3000), (8, 20, 2000), (20, 51, 500))  # delays, how many slices
_POINTS = 16  # of each kind, for each slice
_ANGLES = 500
_ON_CIRCLE = 1e-9  # float64 roots this close to the circle count as inside
_DIGITS = 80

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
        seconds = [one.seconds for one in tallies]
        columns = {
            "section": "slices",
            "delay": stop - 1,
            "points": judged // len(slices),
            "repeats": len(slices),
            "error_measure": MEASURE,
            "slices": len(slices),
            "judged": judged,
            **{s.name.lower(): sum(one.status == s for one in tallies) for s in RegionStatus},
            "seconds": float(np.median(seconds)),
            "seconds_quartiles": np.quantile(seconds, (0.25, 0.75)).tolist(),
        }
        for method in ("wrong", "wrong_of_polygon"):
            wrong = sum(getattr(one, method) for one in tallies)
            name = "stable_region" if method == "wrong" else "its polygon"
            yield {**columns, "method": name, "wrong": wrong, "error": wrong / judged}


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
    region = stable_region(*place)
    seconds = perf_counter() - start
    status = RegionStatus(int(region.status))
    judge = Judge(place)
    points = probes(region, judge, rng)
    expected = [judge.is_stable(*point) for point in points.tolist()]
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


def probes(region: StableRegion, judge: "Judge", rng: np.random.Generator) -> np.ndarray:
    """Return points (n, 2) anywhere and next to the boundary, as many for each region."""
    found = judge.boundary(rng.uniform(0, np.pi, _ANGLES))
    outline = region.points
    if not len(outline):
        outline = found if len(found) > 1 else judge.curve(rng.uniform(0, np.pi, _ANGLES))
    found = found if len(found) else outline
    low, high = outline.min(axis=0), outline.max(axis=0)
    size = high - low
    anywhere = rng.uniform(low - 0.2 * size, high + 0.2 * size, (_POINTS, 2))
    here = rng.integers(0, len(outline) - 1, _ANGLES)
    share = rng.choice([0.0, 0.5, 1.0], (_ANGLES, 1))
    edges = outline[here] + share * (outline[here + 1] - outline[here])
    others = found[rng.integers(0, len(found), _ANGLES)]
    outside = judge.largest_roots(edges)
    missed = np.abs(np.asarray(region.distance(*others.T)))
    near = np.concatenate(
        [_half_at_the_largest(edges, outside), _half_at_the_largest(others, missed)]
    )
    away = rng.choice(DISTANCES, (len(near), 1)) * rng.normal(size=near.shape)
    return np.concatenate([anywhere, near + size * away])


def _half_at_the_largest(points: np.ndarray, doubts: np.ndarray) -> np.ndarray:
    """Return ``_POINTS`` of these points, half of them the one with the largest doubt."""
    half = _POINTS // 2
    return np.concatenate([np.tile(points[np.argmax(doubts)], (half, 1)), points[:half]])


class Judge:
    """Root counts of one slice, on a plant of 50 digits."""

    def __init__(self, place: Slice) -> None:
        gamma, delta, delay, radius = place
        self.whole, self.fraction = truth.split_delay(delay)
        self.plant = truth.plant(gamma, delta, self.fraction)
        self.radius = radius
        self.size = self.whole + (4 if self.fraction else 3)  # the degree of p

    def is_stable(self, alpha: float, beta: float) -> bool | None:
        """Return whether all roots lie inside of the circle; None where 80 digits do not tell."""
        with flint.ctx.workdps(_DIGITS), mp.workdps(_DIGITS):
            exact = self._coefficients(mpf(alpha), mpf(beta), mpf(self.radius))
            blur = flint.arb(0, flint.arb(10) ** -truth.DIGITS)
            return roots_inside([truth.as_arb(value) * (1 + blur) for value in exact])

    def curve(self, angles: np.ndarray) -> np.ndarray:
        """Return points (n, 2) that have roots at these angles of the circle, in float64."""
        z = self.radius * np.exp(1j * angles)
        d1, d0, n2, n1, n0 = map(float, self.plant[:5])
        with np.errstate(all="ignore"):
            w = -(z ** (self.whole + 1)) * ((z + d1) * z + d0) / ((n2 * z + n1) * z + n0)
            slope = 1 - 1 / z
            beta = w.imag / slope.imag
            points = np.stack([w.real - beta * slope.real, beta], axis=1)
        return points[np.all(np.isfinite(points), axis=1)]

    def boundary(self, angles: np.ndarray) -> np.ndarray:
        """Return the points of the curve at these angles next to which walls are stable."""
        points = self.curve(angles)
        return points[self.largest_roots(points) < 1 + _ON_CIRCLE]

    def largest_roots(self, points: np.ndarray) -> np.ndarray:
        """Return for points (n, 2) the largest |z| / radius by eigenvalues."""
        p = [self._coefficients(alpha, beta, self.radius) for alpha, beta in points.tolist()]
        companion = np.tile(np.eye(self.size, k=-1), (len(p), 1, 1))
        companion[:, 0, :] = -np.array(p).reshape(len(p), -1)[:, 1:]
        return np.max(np.abs(np.linalg.eigvals(companion)), axis=1, initial=0.0)

    def _coefficients(self, alpha: mpf | float, beta: mpf | float, radius: mpf | float) -> list:
        """Return p(radius z) over a power of the radius, in the arithmetic of its arguments."""
        number = type(radius)
        d1, d0, n2, n1, n0 = map(number, self.plant[:5])
        both = alpha + beta
        force = [n2 * both, n1 * both - n2 * beta, n0 * both - n1 * beta, -n0 * beta]
        powers = [number(1), d1, d0] + [number(0)] * (self.whole + 2)
        for place, value in enumerate(force, start=self.whole + 1):
            powers[place] += value
        return [value / radius**k for k, value in enumerate(powers[: self.size + 1])]


def roots_inside(p: list[flint.arb]) -> bool | None:
    """Return whether all roots, of real coefficients, lie inside of the unit circle, or None.

    Source: the criterion of Schur and Cohn, in ball arithmetic.
    """
    while len(p) > 1:
        if p[-1] == 0:  # a root at 0
            p = p[:-1]
            continue
        reflection = p[-1] / p[0]
        if abs(reflection) > 1:
            return False
        if not abs(reflection) < 1:
            return None
        p = [a - reflection * b for a, b in zip(p[:-1], p[:0:-1], strict=True)]
    return True
