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
from benchmarks.record import Row
from benchmarks.rivals import LoopFamily, Outline, bisected, contour, eigenvalue_grid
from benchmarks.timing import interleaved
from benchmarks.truth.slices import ExactSlice
from jaxstab.region import stable_region
from jaxstab.trace import trace_boundary

GAMMA, DELTA = 1e-3, 0.015
MEASURE = "largest distance of found points from the exact boundary, relative to the region"

_COARSE = 25  # cells to a side from which n-cubes are bisected
_UNSTABLE_IS_ONE = np.array([np.nan, -1.0, 1.0, 1.0])  # by code: what the contour runs between
_FINEST_TRACE = 1e-3  # of trace_boundary
_OUTLINE_POINTS = 256

Call = Callable[[], Any]


def rows(small: bool) -> Iterator[Row]:
    delays = (1.0,) if small else (0.0, 1.0, 2.0, 5.0)
    for delay in delays:
        exact = ExactSlice(GAMMA, DELTA, delay)
        yield from _outline_rows(exact, small)
        yield from _region_rows(exact, small)


# ------------------------------------------------------------------------- run time against error


def _outline_rows(exact: ExactSlice, small: bool) -> Iterator[Row]:
    """N from coarse to fine for each way to find the boundary."""
    family = LoopFamily(GAMMA, DELTA, exact.delay)
    for count in (_OUTLINE_POINTS,) if small else (50, 100, 200, 400, 800, 1600, 2000):
        calls = _grids(exact, family, count) | {
            "traced": partial(_traced, exact, max(1.0 / count, _FINEST_TRACE)),
            "closed form": partial(_stable_region, exact.delay, 0.35 / count**2),
        }
        timings = interleaved(calls, budget=0.1 if small else 2.0)
        for method, timing in timings.items():
            found = timing.answer
            if not isinstance(found, Outline):
                found = _outline_of(np.asarray(found))
            yield {
                "section": "outline",
                "method": method,
                "delay": exact.delay,
                "n": count,
                "points": len(found.points),
                **timing.columns(),
                **_errors(exact, found.points, small),
                "gap": exact.gap(found.segments, 40 if small else 400),
            }


def _grids(exact: ExactSlice, family: LoopFamily, count: int) -> dict[str, Call]:
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
    codes = np.asarray(jaxstab.verdict(alpha, beta[:, None], gamma=GAMMA, delta=DELTA, delay=delay))
    return contour(alpha, beta, _UNSTABLE_IS_ONE[codes])


def _traced(exact: ExactSlice, resolution: float) -> Outline:
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


def _outline_of(vertices: np.ndarray) -> Outline:
    return Outline(vertices, np.stack([vertices[:-1], vertices[1:]], axis=1))


def _errors(exact: ExactSlice, points: np.ndarray, small: bool) -> dict[str, Any]:
    sample = 8 if small else 64
    return {
        "error": exact.largest_distance(points, sample),
        "error_measure": MEASURE,
        "radius_error": exact.largest_radius_error(points, sample),
    }


# --------------------------------------------------------------------------- regions per second


def _region_rows(exact: ExactSlice, small: bool) -> Iterator[Row]:
    """One region, and many over a grid of (gamma, delta)."""
    side = 3 if small else 32
    gamma, delta = np.meshgrid(np.linspace(0.0, GAMMA, side), np.linspace(0.0, DELTA, side))
    loop = jaxstab.HapticLoop(  # of which K is alpha, and B is beta
        device_mass=1.0, device_damping=0.0, sample_time=1.0, delay=exact.delay
    )
    hands = {"hand_stiffness": gamma.ravel(), "device_damping": delta.ravel()}
    grids = _grids(exact, LoopFamily(GAMMA, DELTA, exact.delay), 20 if small else 200)
    calls: dict[str, Call] = {name: grids[name] for name in ("eigenvalue grid", "n-cube bisection")}
    calls |= {
        "stable_region": partial(_stable_region, exact.delay, 1e-3 if small else 1e-6),
        "regions_of": partial(_outlines, loop, hands),
    }
    for method, timing in interleaved(calls, budget=0.1 if small else 3.0).items():
        found, regions = timing.answer, 1
        if method == "regions_of":
            found, regions = found[-1], side**2  # the last one is of GAMMA and DELTA
        points = found.points if isinstance(found, Outline) else np.asarray(found)
        yield {
            "section": "region",
            "method": method,
            "delay": exact.delay,
            "points": len(points),
            **timing.columns(),
            **_errors(exact, points, small),
            "regions": regions,
            "regions_per_second": regions / timing.median,
        }


def _stable_region(delay: float, tolerance: float) -> np.ndarray:
    return stable_region(gamma=GAMMA, delta=DELTA, delay=delay, tolerance=tolerance).points


def _outlines(loop: jaxstab.HapticLoop, hands: dict[str, np.ndarray]) -> np.ndarray:
    return jaxstab.regions_of(loop, **hands).outline
