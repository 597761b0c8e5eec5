"""Run time, size and error against resolution: grids of a slice, and what is proved of its cells.

The same random points are asked of the verdict of the nearest node, of the radius interpolated
linearly between nodes, of verdicts proved for whole cells, and of the limits of alpha. There are as
many nodes along alpha as along beta, and as many cells of limits along beta. ``error`` is the share
of points without a right verdict: undecided, or wrong by ``verdict(resolve="exact")``.
"""

import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator

import jaxstab
from benchmarks.record import Row
from benchmarks.timing import interleaved
from jaxstab.conventions import Verdict
from jaxstab.model import by_name

MEASURE = "share of random points without a right verdict: undecided or wrong"

_HAND = 5e-4, 0.0075  # gamma and delta: the middle of the haptic range
_DELAY = 1.0
_POINTS = 200_000


class Rival(NamedTuple):
    """A way to answer: from an atlas with one product, which keeps so many bytes in memory."""

    answer: Callable[[], np.ndarray]
    kept: int
    build_seconds: float


def rows(small: bool) -> Iterator[Row]:
    counts = (16, 8) if small else (512, 256, 128, 64, 32, 16, 8)
    rng = np.random.default_rng(20120412)
    asked: list[np.ndarray] = []
    for count in counts:  # the finest first: it reaches least far around the region
        atlases = {product: _built(product, count) for product in ("verdict", "alpha_limits")}
        if not asked:
            walls = list(atlases["verdict"][0].nodes(0).values())[:2]
            points = 500 if small else _POINTS
            asked = [rng.uniform(nodes[0], nodes[-1], points) for nodes in walls]
            true = np.asarray(jaxstab.verdict(**by_name(*asked, *_HAND, _DELAY), resolve="exact"))
        yield from _rows(count, _rivals(atlases, asked), true, small)


def _built(product: str, count: int) -> tuple[jaxstab.Atlas, float]:
    """Return an atlas of one slice with one product, and the CPU seconds of its build."""
    spec = jaxstab.AtlasSpec(
        alpha=jaxstab.FittedAxis(count),
        beta=jaxstab.FittedAxis(count),
        gamma=_HAND[:1],
        delta=_HAND[1:],
        delay=(_DELAY,),
        limit_cells=count,
        products=(product,),
    )
    with tempfile.TemporaryDirectory() as folder:
        build = partial(jaxstab.build_atlas, spec, Path(folder) / "atlas.h5")
        timing = interleaved({"build": build}, budget=0.0, least=2, most=2)["build"]
    return timing.answer, min(timing.cpu_seconds)


def _rivals(
    atlases: dict[str, tuple[jaxstab.Atlas, float]], asked: list[np.ndarray]
) -> dict[str, Rival]:
    atlas, seconds = atlases["verdict"]
    nodes = list(atlas.nodes(0).values())[:2]
    codes = atlas.arrays["verdict"][:, :, 0, 0, 0]
    cells = atlas.arrays["cell_verdict"][:, :, 0, 0, 0]
    slice_ = by_name(*_HAND, _DELAY)
    radii = partial(jaxstab.spectral_radius, nodes[0][:, None], nodes[1], **slice_)
    timing = interleaved({"radii": radii}, budget=0.0, least=2, most=2)["radii"]
    radius, radius_seconds = np.asarray(timing.answer.value), min(timing.cpu_seconds)
    linear = RegularGridInterpolator(nodes, radius)
    limits, limit_seconds = atlases["alpha_limits"]
    return {
        "nearest node": Rival(partial(_nearest, nodes, codes, asked), codes.nbytes, seconds),
        "linear radius": Rival(partial(_by_radius, linear, asked), radius.nbytes, radius_seconds),
        "proved cells": Rival(partial(_by_cells, nodes, cells, asked), cells.nbytes, seconds),
        "proved limits": Rival(
            partial(limits.verdict, *asked, **slice_),
            limits.arrays["alpha_limits"].nbytes,
            limit_seconds,
        ),
    }


def _nearest(nodes: list[np.ndarray], codes: np.ndarray, asked: list[np.ndarray]) -> np.ndarray:
    middles = [(along[1:] + along[:-1]) / 2.0 for along in nodes]
    place = tuple(np.searchsorted(m, wall) for m, wall in zip(middles, asked, strict=True))
    return codes[place]


def _by_radius(linear: RegularGridInterpolator, asked: list[np.ndarray]) -> np.ndarray:
    return np.where(linear(np.stack(asked, axis=-1)) < 1.0, Verdict.STABLE, Verdict.UNSTABLE)


def _by_cells(nodes: list[np.ndarray], cells: np.ndarray, asked: list[np.ndarray]) -> np.ndarray:
    inner = (along[1:-1] for along in nodes)
    place = tuple(np.searchsorted(m, wall, "right") for m, wall in zip(inner, asked, strict=True))
    return cells[place]


def _rows(count: int, rivals: dict[str, Rival], true: np.ndarray, small: bool) -> Iterator[Row]:
    calls: dict[str, Callable[[], Any]] = {name: rival.answer for name, rival in rivals.items()}
    timings = interleaved(calls, budget=0.1 if small else 0.5, most=20)
    for name, timing in timings.items():
        undecided = timing.answer == Verdict.UNDECIDED
        wrong = ~undecided & (timing.answer != true)
        yield {
            "section": f"{count} nodes",
            "method": name,
            "delay": _DELAY,
            "nodes": count,
            "points": true.size,
            **timing.columns(),
            "seconds_per_point": float(np.median(timing.cpu_seconds)) / true.size,
            "bytes": rivals[name].kept,
            "build_seconds": rivals[name].build_seconds,
            "error": float(np.mean(undecided | wrong)),
            "error_measure": MEASURE,
            "undecided": float(np.mean(undecided)),
            "wrong": float(np.mean(wrong)),
            "falsely_stable": float(np.mean(wrong & (timing.answer == Verdict.STABLE))),
        }
