"""Queries of an atlas: what a resolution costs in bytes and seconds, and how good its answers are.

The same random points, between nodes, are asked of atlases of growing resolution; of the nearest
node, of scipy's linear interpolation of the same nodes, and of the verdict and the eigenvalues
computed on the spot. ``error`` is the share of points without a right verdict: undecided or wrong.
True verdicts are by LAPACK and, within 1e-8 of the unit circle, by certified roots.
"""

import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator

import jaxstab
from benchmarks import truth
from benchmarks.record import Row
from benchmarks.rivals import largest_modulus
from benchmarks.timing import interleaved
from jaxstab.conventions import Verdict
from jaxstab.model import by_name

MEASURE = "share of random points without a right verdict: undecided or wrong"
GAMMA_END, DELTA_END = 1e-3, 0.015

_CLEAR = 1e-8  # from the unit circle: LAPACK decides
_BATCH = 1 << 15


class Asked(NamedTuple):
    """Random points of one delay, and what is true of them."""

    axes: tuple[np.ndarray, ...]  # alpha, beta, gamma, delta
    delay: float
    radius: np.ndarray
    codes: np.ndarray


class Built(NamedTuple):
    """An atlas of one resolution, and what it cost."""

    atlas: jaxstab.Atlas
    nodes: tuple[int, int]  # along alpha and beta, along gamma and delta
    file_bytes: int
    build_seconds: float


class Answer(NamedTuple):
    """Verdicts and radii; NaN where a method says nothing of the radius."""

    codes: np.ndarray
    radius: np.ndarray


def rows(small: bool) -> Iterator[Row]:
    plants = (2,) if small else (2, 3, 5, 9, 17)
    walls = (8,) if small else (16, 32, 64, 128, 256)
    middle = walls[(len(walls) - 1) // 2]
    for delay in (1.0,) if small else (1.0, 3.0):
        atlases = {
            "wall": [_built(delay, wall, plants[len(plants) // 2]) for wall in walls],
            "plant": [_built(delay, middle, plant) for plant in plants],
        }
        finest = atlases["wall"][-1].atlas
        asked = _asked(finest, delay, 300 if small else 100_000)
        for section, built in atlases.items():
            for one in built:
                yield from _rows(section, one, asked, small)


def _built(delay: float, wall: int, plant: int) -> Built:
    spec = jaxstab.AtlasSpec(
        alpha=jaxstab.FittedAxis(wall),
        beta=jaxstab.FittedAxis(wall),
        gamma=np.linspace(0.0, GAMMA_END, plant).tolist(),
        delta=np.linspace(0.0, DELTA_END, plant).tolist(),
        delay=(delay,),
        limit_cells=2 * wall,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "atlas.h5"
        build = partial(jaxstab.build_atlas, spec, path)
        timing = interleaved({"build": build}, budget=0.0, least=1, most=1)["build"]
        return Built(timing.answer, (wall, plant), path.stat().st_size, timing.median)


def _asked(atlas: jaxstab.Atlas, delay: float, count: int) -> Asked:
    rng = np.random.default_rng(20120412)
    axes = tuple(rng.uniform(nodes[0], nodes[-1], count) for nodes in atlas.nodes(0).values())
    radius = _eigenvalue_radius(axes, delay)
    codes = np.where(radius < 1.0, Verdict.STABLE, Verdict.UNSTABLE)
    for place in np.flatnonzero(np.abs(radius - 1.0) < _CLEAR):
        _, upper = truth.spectral_radius(*(float(axis[place]) for axis in axes), delay)
        codes[place] = Verdict.STABLE if upper < 1 else Verdict.UNSTABLE
    return Asked(axes, delay, radius, codes)


def _rows(section: str, built: Built, asked: Asked, small: bool) -> Iterator[Row]:
    methods = _methods(built.atlas, asked)
    calls: dict[str, Callable[[], Any]] = {name: call for name, (call, _) in methods.items()}
    timings = interleaved(calls, budget=0.1 if small else 2.0, most=20)
    for name, timing in timings.items():
        answer: Answer = timing.answer
        undecided = answer.codes == Verdict.UNDECIDED
        wrong = ~undecided & (answer.codes != asked.codes)
        falsely_stable = wrong & (answer.codes == Verdict.STABLE)
        off = np.abs(answer.radius - asked.radius)
        off = off[np.isfinite(off)]
        yield {
            "section": section,
            "method": name,
            "delay": asked.delay,
            "nodes_wall": built.nodes[0],
            "nodes_plant": built.nodes[1],
            "points": asked.codes.size,
            **timing.columns(),
            "seconds_per_point": timing.median / asked.codes.size,
            "bytes": built.file_bytes if name == "atlas" else methods[name][1],
            "build_seconds": built.build_seconds if methods[name][1] else 0.0,
            "error": float(np.mean(undecided | wrong)),
            "error_measure": MEASURE,
            "undecided": float(np.mean(undecided)),
            "wrong": float(np.mean(wrong)),
            "falsely_stable": float(np.mean(falsely_stable)),
            "radius_error": float(off.max()) if off.size else None,
            "radius_error_median": float(np.median(off)) if off.size else None,
        }


def _methods(atlas: jaxstab.Atlas, asked: Asked) -> dict[str, tuple[Callable[[], Answer], int]]:
    """Return the ways to answer, each with the bytes that it keeps."""
    nodes = tuple(atlas.nodes(0).values())
    codes = atlas.arrays["verdict"][..., 0]
    radius = np.asarray(jaxstab.spectral_radius(**by_name(*np.ix_(*nodes), asked.delay)).value)
    linear = RegularGridInterpolator(nodes, radius, bounds_error=False)
    in_memory = sum(array.nbytes for array in atlas.arrays.values())
    return {
        "atlas": (partial(_of_atlas, atlas, asked), in_memory),
        "nearest node": (partial(_of_nearest, nodes, codes, radius, asked), codes.nbytes),
        "scipy linear": (partial(_of_interpolator, linear, asked), radius.nbytes),
        "verdict": (partial(_of_verdict, asked), 0),
        "numpy eigvals": (partial(_of_eigenvalues, asked), 0),
    }


def _of_atlas(atlas: jaxstab.Atlas, asked: Asked) -> Answer:
    answer = atlas.query(**by_name(*asked.axes, asked.delay), outside="undecided")
    return Answer(answer.verdict, np.full(answer.verdict.shape, np.nan))


def _of_nearest(
    nodes: tuple[np.ndarray, ...], codes: np.ndarray, radius: np.ndarray, asked: Asked
) -> Answer:
    middles = [(axis[1:] + axis[:-1]) / 2.0 for axis in nodes]
    place = tuple(np.searchsorted(m, axis) for m, axis in zip(middles, asked.axes, strict=True))
    return Answer(codes[place], radius[place])


def _of_interpolator(linear: RegularGridInterpolator, asked: Asked) -> Answer:
    radius = linear(np.stack(asked.axes, axis=-1))
    return Answer(_codes(radius), radius)


def _of_verdict(asked: Asked) -> Answer:
    codes = np.asarray(jaxstab.verdict(**by_name(*asked.axes, asked.delay)))
    return Answer(codes, np.full(codes.shape, np.nan))


def _of_eigenvalues(asked: Asked) -> Answer:
    radius = _eigenvalue_radius(asked.axes, asked.delay)
    return Answer(_codes(radius), np.full(radius.shape, np.nan))  # it would judge itself


def _codes(radius: np.ndarray) -> np.ndarray:
    decided = np.where(radius < 1.0, Verdict.STABLE, Verdict.UNSTABLE)
    return np.where(np.isnan(radius), Verdict.UNDECIDED, decided).astype(np.int8)


def _eigenvalue_radius(axes: tuple[np.ndarray, ...], delay: float) -> np.ndarray:
    found = []
    for start in range(0, axes[0].size, _BATCH):
        part = (axis[start : start + _BATCH] for axis in axes)
        coefficients = jaxstab.characteristic_polynomial(**by_name(*part, delay))
        companions = np.asarray(jaxstab.companion_matrix(coefficients))
        found.append(largest_modulus(np.linalg.eigvals(companions)))
    return np.concatenate(found)
