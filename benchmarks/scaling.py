"""Cost as work grows: 1e4 to 1e9 points streamed through memory; ``throughput`` has the delays.

Each size runs in a process of its own, so that ``peak_mib``, its largest resident memory, is its
own; ``start_mib`` is what the imports took. ``error`` is the share of sampled points that were
wrong or undecided, by certified roots.
"""

import resource
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.timing import interleaved
from jaxstab.conventions import Verdict
from jaxstab.region import boundary_curve
from tests.truth import loop as truth

PLACE = {"gamma": 1e-3, "delta": 0.015, "delay": 1.0}

_CHUNK = 1 << 18

Axes = tuple[np.ndarray, np.ndarray]  # alpha (m, 1) and beta (n,)


def rows(small: bool, billion: bool = False) -> Iterator[Row]:
    for power in range(4, 6 if small else 10 if billion else 9):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
            yield executor.submit(streamed, 10**power, 10 if small else 200).result()


def streamed(count: int, judged: int) -> Row:
    """Take the verdicts of a slice that is never in memory as a whole."""
    axes = _axes(round(count**0.5))
    points, start_mib = axes[0].size * axes[1].size, _peak_mib()
    call = partial(_streamed, axes)
    timing = interleaved({"streamed": call}, budget=5.0, least=1, most=5)["streamed"]
    peak_mib = _peak_mib()
    rng = np.random.default_rng(20120412)
    alpha, beta = (rng.choice(axis.ravel(), judged) for axis in axes)
    codes = np.asarray(jaxstab.verdict(alpha, beta, **PLACE))
    radii = [truth.spectral_radius(a, b, *PLACE.values()) for a, b in zip(alpha, beta, strict=True)]
    is_stable = np.array([low + high < 2 for low, high in radii])
    return timing.row(
        "points",
        "streamed verdict",
        float(np.mean(codes != np.where(is_stable, Verdict.STABLE, Verdict.UNSTABLE))),
        "share of sampled points whose verdict was wrong or undecided",
        delay=PLACE["delay"],
        points=points,
        seconds_per_point=timing.median / points,
        stable_points=timing.answer,
        start_mib=start_mib,
        peak_mib=peak_mib,
    )


def _streamed(axes: Axes) -> int:
    """The number of stable points, chunk after chunk."""
    alpha, beta = axes
    chunks = jaxstab.evaluate_grid(jaxstab.verdict, alpha=alpha, beta=beta, **PLACE, chunk=_CHUNK)
    return sum(int(np.count_nonzero(np.asarray(codes) == Verdict.STABLE)) for _, codes in chunks)


def _axes(side: int) -> Axes:
    """Return the axes of a square grid around the stable region."""
    angles = np.linspace(0.0, 1.0, 200) * np.pi / (2.0 * PLACE["delay"] + 2.0)
    alpha, beta = (np.asarray(v) for v in boundary_curve(angles, **PLACE))
    return (
        np.linspace(-2.0 * PLACE["gamma"], 1.1 * alpha.max(), side)[:, None],
        np.linspace(1.1 * beta.min(), 1.1 * beta.max(), side),
    )


def _peak_mib() -> float:
    """Return the largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
