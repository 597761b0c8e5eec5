"""Cost as work grows: 1e4 to 1e9 points streamed through memory, and delays from 0 to 60 samples.

Each size runs in a process of its own, so that ``peak_mib``, its largest resident memory, is its
own; ``start_mib`` is what the imports took. ``error`` is, for verdicts, the share of
sampled points that were wrong or undecided; for radii, the largest error; by certified roots.
"""

import resource
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np

import jaxstab
from benchmarks import truth
from benchmarks.record import Row
from benchmarks.rivals import LoopFamily
from benchmarks.timing import Timing, interleaved
from jaxstab.conventions import Verdict
from jaxstab.model import by_name
from jaxstab.region import boundary_curve

GAMMA, DELTA = 1e-3, 0.015
WRONG = "share of sampled points whose verdict was wrong or undecided"
RADIUS_ERROR = "largest error of the spectral radius of sampled points"

_STREAM_DELAY = 1.0
_CHUNK = 1 << 18
_EIGENVALUE_WORK = 1e6  # points times degree squared

Axes = tuple[np.ndarray, np.ndarray]  # alpha (m, 1) and beta (n,)


def rows(small: bool, billion: bool = False) -> Iterator[Row]:
    run = _here if small else _in_new_process
    powers = range(4, 6 if small else 10 if billion else 9)
    delays = (1, 10) if small else (0, 1, 2, 3, 5, 8, 9, 10, 15, 20, 40, 60)
    for power in powers:
        yield from run(streamed_rows, 10**power, 10 if small else 200)
    for delay in delays:
        yield from run(delay_rows, float(delay), 8 if small else 300, 8 if small else 100)


def streamed_rows(count: int, judged: int) -> list[Row]:
    """Take the verdicts of a slice that is never in memory as a whole."""
    axes = _axes(_STREAM_DELAY, round(count**0.5))
    start_mib = _peak_mib()
    call = partial(_streamed, axes)
    timing = interleaved({"streamed": call}, budget=5.0, least=1, most=5)["streamed"]
    peak_mib = _peak_mib()
    points = _sampled(axes, judged)
    codes = np.asarray(jaxstab.verdict(*points, gamma=GAMMA, delta=DELTA, delay=_STREAM_DELAY))
    row = _row("points", "streamed verdict", _STREAM_DELAY, axes[0].size * axes[1].size, timing)
    row |= _wrong_share(codes, points, _STREAM_DELAY)
    row |= {"stable_points": timing.answer, "start_mib": start_mib, "peak_mib": peak_mib}
    return [row]


def delay_rows(delay: float, side: int, judged: int) -> list[Row]:
    """Time verdict, radius and LAPACK on a slice at one delay."""
    axes = _axes(delay, side)
    family = LoopFamily(GAMMA, DELTA, delay)
    few = int(_EIGENVALUE_WORK / family.plant.size**2)
    some = family.companions(*_sampled(axes, min(few, side**2)))
    start_mib = _peak_mib()
    calls: dict[str, Callable[[], Any]] = {
        "verdict": lambda: jaxstab.verdict(*axes, gamma=GAMMA, delta=DELTA, delay=delay),
        "spectral_radius": lambda: jaxstab.spectral_radius(
            *axes, gamma=GAMMA, delta=DELTA, delay=delay
        ),
        "numpy eigvals": lambda: np.linalg.eigvals(some),
    }
    timings = interleaved(calls, budget=1.0, most=20)
    memory = {"start_mib": start_mib, "peak_mib": _peak_mib()}
    points = _sampled(axes, judged)
    exact = np.array([_true_radius(*point, delay) for point in zip(*points, strict=True)])
    radius = np.asarray(
        jaxstab.spectral_radius(*points, gamma=GAMMA, delta=DELTA, delay=delay).value
    )
    codes = np.asarray(jaxstab.verdict(*points, gamma=GAMMA, delta=DELTA, delay=delay))
    errors = {
        "verdict": _wrong_share(codes, points, delay),
        "spectral_radius": _radius_error(radius, exact),
        "numpy eigvals": _radius_error(family.radius(*points), exact),
    }
    sizes = {"numpy eigvals": len(some)}
    return [
        _row("delay", name, delay, sizes.get(name, side**2), timing) | errors[name] | memory
        for name, timing in timings.items()
    ]


def _streamed(axes: Axes) -> int:
    """Return how many points are stable, chunk after chunk."""
    chunks = jaxstab.evaluate_grid(
        jaxstab.verdict, **by_name(*axes, GAMMA, DELTA, _STREAM_DELAY), chunk=_CHUNK
    )
    return sum(int(np.count_nonzero(np.asarray(codes) == Verdict.STABLE)) for _, codes in chunks)


def _axes(delay: float, side: int) -> Axes:
    """Return the axes of a square grid around the stable region."""
    angles = np.linspace(0.0, 1.0, 200) * np.pi / (2.0 * delay + 2.0)
    alpha, beta = (
        np.asarray(v) for v in boundary_curve(angles, gamma=GAMMA, delta=DELTA, delay=delay)
    )
    return (
        np.linspace(-2.0 * GAMMA, 1.1 * alpha.max(), side)[:, None],
        np.linspace(1.1 * beta.min(), 1.1 * beta.max(), side),
    )


def _sampled(axes: Axes, count: int) -> Axes:
    """Return random points of the grid as two flat arrays."""
    rng = np.random.default_rng(20120412)
    alpha, beta = axes
    return rng.choice(alpha.ravel(), count), rng.choice(beta, count)


def _row(section: str, method: str, delay: float, points: int, timing: Timing) -> Row:
    return {
        "section": section,
        "method": method,
        "delay": delay,
        "points": points,
        **timing.columns(),
        "seconds_per_point": timing.median / points,
    }


def _wrong_share(codes: np.ndarray, points: Axes, delay: float) -> dict[str, Any]:
    exact = np.array([_true_radius(*point, delay) for point in zip(*points, strict=True)])
    right = codes == np.where(exact < 1.0, Verdict.STABLE, Verdict.UNSTABLE)
    return {"error": float(np.mean(~right)), "error_measure": WRONG}


def _radius_error(radius: np.ndarray, exact: np.ndarray) -> dict[str, Any]:
    return {"error": float(np.abs(radius - exact).max()), "error_measure": RADIUS_ERROR}


def _true_radius(alpha: float, beta: float, delay: float) -> float:
    lower, upper = truth.spectral_radius(float(alpha), float(beta), GAMMA, DELTA, delay)
    return float((lower + upper) / 2)


def _peak_mib() -> float:
    """Return the largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _here(function: Callable[..., list[Row]], *arguments: Any) -> list[Row]:
    return function(*arguments)


def _in_new_process(function: Callable[..., list[Row]], *arguments: Any) -> list[Row]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        return executor.submit(function, *arguments).result()
