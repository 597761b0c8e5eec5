"""The boundary of one slice: run time against error, N points or cells to a side.

``error`` is the largest distance of a found point from the exact boundary, ``gap`` the largest
distance of the exact boundary from what was found (points joined by straight lines), both relative
to the extents of the stable region; ``radius_error`` is the largest |spectral radius - 1| by
certified roots. Each is taken over a sample of the points.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

import jaxstab
from benchmarks.exact import ExactSlice
from benchmarks.record import Row
from benchmarks.rivals import (
    LoopFamily,
    Outline,
    bisected,
    contour,
    eigenvalue_grid,
)
from benchmarks.timing import interleaved

GAMMA, DELTA = 1e-3, 0.015
MEASURE = "largest distance of found points from the exact boundary, relative to the region"

_COARSE = 25  # cells to a side from which n-cubes are bisected
_UNSTABLE_IS_ONE = np.array([np.nan, -1.0, 1.0, 1.0])  # by code: what the contour runs between


def rows(small: bool) -> Iterator[Row]:
    delays = (0.0, 1.0) if small else (0.0, 1.0, 2.0, 5.0)
    counts = (20, 40) if small else (50, 100, 200, 400, 800, 1600, 2000)
    for delay in delays:
        exact = ExactSlice(GAMMA, DELTA, delay)
        family = LoopFamily(GAMMA, DELTA, delay)
        for count in counts:
            calls = _rivals(exact, family, count)
            timings = interleaved(calls, budget=0.2 if small else 2.0)
            for method, timing in timings.items():
                yield _row(exact, method, count, timing.answer, timing.columns(), small)


def _rivals(exact: ExactSlice, family: LoopFamily, count: int) -> dict[str, Callable[[], Outline]]:
    alpha_ends, beta_ends = exact.box()
    alpha, beta = np.linspace(*alpha_ends, count), np.linspace(*beta_ends, count)
    halvings = max(round(np.log2(count / _COARSE)), 0)
    return {
        "eigenvalue grid": partial(eigenvalue_grid, family, alpha, beta),
        "verdict grid": partial(verdict_grid, alpha, beta, exact.delay),
        "n-cube bisection": partial(
            bisected, _decay(family), alpha_ends, beta_ends, -(-count >> halvings), halvings
        ),
    }


def _decay(family: LoopFamily) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    return lambda alpha, beta: family.radius(alpha, beta) - 1.0


def verdict_grid(alpha: np.ndarray, beta: np.ndarray, delay: float) -> Outline:
    """Contour certified verdicts on a grid."""
    codes = np.asarray(jaxstab.verdict(alpha, beta[:, None], GAMMA, DELTA, delay))
    return contour(alpha, beta, _UNSTABLE_IS_ONE[codes])


def _row(
    exact: ExactSlice,
    method: str,
    count: int,
    found: Outline,
    times: dict[str, Any],
    small: bool,
) -> Row:
    sample = 8 if small else 64
    return {
        "section": "outline",
        "method": method,
        "delay": exact.delay,
        "n": count,
        "points": len(found.points),
        **times,
        "error": exact.largest_distance(found.points, sample),
        "error_measure": MEASURE,
        "gap": exact.gap(found.segments, 40 if small else 400),
        "radius_error": exact.largest_radius_error(found.points, sample),
    }
