"""The boundary of one slice: run time against error, N points or cells to a side.

``error`` is the largest distance of a found point from the exact boundary, ``gap`` the largest
distance of the exact boundary from what was found (points joined by straight lines), both relative
to the extents of the stable region; ``radius_error`` is the largest |spectral radius - 1| by
certified roots. Each is taken over a sample of the points.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import flint
import numpy as np
from mpmath import mp, mpc, mpf

import jaxstab
from benchmarks.grids import LoopFamily, Outline, bisected, contour, eigenvalue_grid
from benchmarks.record import Row
from benchmarks.timing import Timing, interleaved
from jaxstab.region import stable_region
from jaxstab.trace import trace_boundary
from tests.truth import loop as truth
from tests.truth.balls import ExactPlant
from tests.truth.boundary import Boundary

GAMMA, DELTA = 1e-3, 0.015
MEASURE = "largest distance of found points from the exact boundary, relative to the region"

_COARSE = 25  # cells to a side from which n-cubes are bisected
_UNSTABLE_IS_ONE = np.array([np.nan, -1.0, 1.0, 1.0])  # by code: what the contour runs between
_FINEST_TRACE = 1e-3  # of trace_boundary
_OUTLINE_POINTS = 256
_STEPS = 6  # of the search for the nearest point

Call = Callable[[], Any]


class Judge:
    """The boundary of one slice: points of it, and how far others are from it, in 50 digits.

    Lengths are relative to the extents of the stable region along alpha and beta.
    """

    def __init__(self, delay: float) -> None:
        self.delay, self.plant = delay, (GAMMA, DELTA, delay)
        balls = ExactPlant.of(*self.plant).loop(delay)
        boundary = Boundary(balls)
        self.points = boundary.points(np.random.default_rng(20), 2000)
        self.size = np.ptp(self.points, axis=0)
        self._theta = np.geomspace(1e-6, np.pi - 1e-6, 4000)
        self._curve = boundary.solved(np.exp(1j * self._theta)) / self.size
        with flint.ctx.workprec(balls.bits):
            self._lines = [[truth.as_mpf(part(z)) for part in balls[:3]] for z in (1, -1)]

    def box(self, margin: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends of alpha and of beta around the stable region."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        alpha, beta = np.stack([low - margin * self.size, high + margin * self.size], axis=1)
        return alpha, beta

    def distance(self, alpha: float, beta: float) -> float:
        """The distance of a point from the curve, or from a line of a real root that is closer.

        A line's distance is p(z) over its slope. From the closest of many points of the curve a
        few steps go to where the way to the point is square to it; each doubles the digits.
        """
        size = [mpf(value) for value in self.size.tolist()]
        lines = [
            abs(base + mpf(alpha) * k + mpf(beta) * b) / mp.hypot(k * size[0], b * size[1])
            for base, k, b in self._lines
        ]

        def offset(theta: mpf) -> mpc:
            a, b = truth.boundary_point(theta, *self.plant)
            return mpc((a - mpf(alpha)) / size[0], (b - mpf(beta)) / size[1])

        away = np.linalg.norm(self._curve - np.array([alpha, beta]) / self.size, axis=1)
        theta, small = mpf(float(self._theta[np.argmin(away)])), mpf(10) ** -15
        for _ in range(_STEPS):
            here = offset(theta)
            along = (offset(theta + small) - here) / small
            theta -= (here * mp.conj(along)).real / abs(along) ** 2
            theta = min(max(theta, mpf(10) ** -9), mp.pi - mpf(10) ** -9)
        return float(min(abs(offset(theta)), *lines))

    def gap(self, segments: np.ndarray, count: int) -> float:
        """Return the largest distance of the boundary's points from segments (n, 2, 2)."""
        start, end = segments[:, 0] / self.size, segments[:, 1] / self.size
        along = end - start
        square = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
        largest = 0.0
        for point in self.points[:: max(len(self.points) // count, 1)] / self.size:
            part = np.clip(((point - start) * along).sum(axis=1) / square, 0.0, 1.0)
            nearest = np.linalg.norm(start + part[:, None] * along - point, axis=1).min()
            largest = max(largest, float(nearest))
        return largest


def rows(small: bool) -> Iterator[Row]:
    delays = (1.0,) if small else (0.0, 1.0, 2.0, 5.0)
    for delay in delays:
        exact = Judge(delay)
        yield from _outline_rows(exact, small)
        yield from _region_rows(exact, small)


# ------------------------------------------------------------------------- run time against error


def _outline_rows(exact: Judge, small: bool) -> Iterator[Row]:
    """N from coarse to fine for each way to find the boundary."""
    family = LoopFamily(GAMMA, DELTA, exact.delay)
    ends = exact.box()
    for count in (_OUTLINE_POINTS,) if small else (50, 100, 200, 400, 800, 1600, 2000):
        alpha, beta = (np.linspace(*pair, count) for pair in ends)
        halvings = max(round(np.log2(count / _COARSE)), 0)
        squares = -(-count >> halvings), halvings
        calls: dict[str, Call] = {
            "eigenvalue grid": partial(eigenvalue_grid, family, alpha, beta),
            "verdict grid": partial(verdict_grid, alpha, beta, exact.delay),
            "n-cube bisection": partial(
                bisected, lambda *walls: family.radius(*walls) - 1.0, *ends, *squares
            ),
            "traced": partial(_traced, exact, max(1.0 / count, _FINEST_TRACE)),
            "closed form": partial(_stable_region, exact.delay, 0.35 / count**2),
        }
        timings = interleaved(calls, budget=0.1 if small else 2.0)
        for method, timing in timings.items():
            found = timing.answer
            if not isinstance(found, Outline):
                found = Outline(found, np.stack([found[:-1], found[1:]], axis=1))
            gap = exact.gap(found.segments, 40 if small else 400)
            yield _row("outline", method, timing, exact, found.points, small, n=count, gap=gap)


def verdict_grid(alpha: np.ndarray, beta: np.ndarray, delay: float) -> Outline:
    """Contour certified verdicts on a grid."""
    codes = np.asarray(jaxstab.verdict(alpha, beta[:, None], gamma=GAMMA, delta=DELTA, delay=delay))
    return contour(alpha, beta, _UNSTABLE_IS_ONE[codes])


def _traced(exact: Judge, resolution: float) -> Outline:
    """Trace all branches in the box, and keep what bounds the stable set."""
    alpha_ends, beta_ends = exact.box()
    trace = trace_boundary(
        ("alpha", "beta"),
        (tuple(alpha_ends.tolist()), tuple(beta_ends.tolist())),
        resolution=resolution,
        gamma=GAMMA,
        delta=DELTA,
        delay=exact.delay,
    )
    joined = trace.edge[1:] & trace.edge[:-1] & (np.diff(trace.piece) == 0)
    segments = np.stack([trace.points[:-1], trace.points[1:]], axis=1)[joined]
    return Outline(trace.points[trace.edge], segments)


def _row(
    section: str,
    method: str,
    timing: Timing,
    exact: Judge,
    points: np.ndarray,
    small: bool,
    **own: float,
) -> Row:
    """Judge a sample of the points."""
    count = min(8 if small else 64, len(points))
    some = points[np.linspace(0, len(points) - 1, count).round().astype(int)].tolist()
    radii = [truth.spectral_radius(*point, GAMMA, DELTA, exact.delay) for point in some]
    return timing.row(
        section,
        method,
        max(exact.distance(*point) for point in some),
        MEASURE,
        delay=exact.delay,
        points=len(points),
        radius_error=float(max(abs((low + high) / 2 - 1) for low, high in radii)),
        **own,
    )


# --------------------------------------------------------------------------- regions per second


def _region_rows(exact: Judge, small: bool) -> Iterator[Row]:
    """One region, and many over a grid of (gamma, delta)."""
    side = 3 if small else 32
    gamma, delta = np.meshgrid(np.linspace(0.0, GAMMA, side), np.linspace(0.0, DELTA, side))
    loop = jaxstab.HapticLoop(  # of which K is alpha, and B is beta
        device_mass=1.0, device_damping=0.0, sample_time=1.0, delay=exact.delay
    )
    hands = {"hand_stiffness": gamma.ravel(), "device_damping": delta.ravel()}
    calls: dict[str, Call] = {
        "stable_region": partial(_stable_region, exact.delay, 1e-3 if small else 1e-6),
        "regions_of": lambda: jaxstab.regions_of(loop, **hands).outline,
    }
    for method, timing in interleaved(calls, budget=0.1 if small else 3.0).items():
        found, regions = timing.answer, 1
        if method == "regions_of":
            found, regions = found[-1], side**2  # the last one is of GAMMA and DELTA
        points = np.asarray(found)
        rate = regions / timing.median
        yield _row(
            "region", method, timing, exact, points, small, regions=regions, regions_per_second=rate
        )


def _stable_region(delay: float, tolerance: float) -> np.ndarray:
    return stable_region(gamma=GAMMA, delta=DELTA, delay=delay, tolerance=tolerance).points
