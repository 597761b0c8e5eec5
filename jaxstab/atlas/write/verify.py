"""Check an atlas file: that it is whole, as the schema says, and right at a sample of points.

One slice is in memory at a time, however large the atlas is. Half of the sample is next to where
the verdict changes, where a wrong one would be. Outlines and summaries are computed again for whole
slices: an outline must lie on the exact boundary, enclose its area and have its corners.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import prod
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from jaxtyping import Float64, Int8, Int64
from numpy.typing import NDArray

from jaxstab.atlas.compute.products import slice_summaries
from jaxstab.atlas.format.schema import (
    CELL_VERDICT,
    PRODUCTS,
    RADIUS_RANGE,
    SLICE,
    SPEC,
    SPECTRAL_RADIUS,
    VERDICT,
    content_digest,
    digest_of,
)
from jaxstab.atlas.format.spec import filters_of
from jaxstab.atlas.format.table import Table
from jaxstab.atlas.read.atlas import Atlas, open_atlas
from jaxstab.atlas.read.file import TooLargeError, table_of
from jaxstab.atlas.read.outline import AtlasOutline, outline_at
from jaxstab.atlas.write.variables import checked_datasets, opened, text_of
from jaxstab.conventions import AXES, Verdict
from jaxstab.model import by_name
from jaxstab.model.filters import as_keywords, known_filters
from jaxstab.point import spectral_radius, verdict
from jaxstab.region import RegionStatus, stable_region

_SLICES = 16  # that are looked at
_NEAR = 1e-9  # of the size of a slice's stable region, or of a number in its summary
_FAR = 1e-6  # of a coordinate of an extreme, where what is extreme hardly changes
_POLYGON = 1e-5  # of that size squared: a polygon leaves the boundary by 1e-6 of it

Datasets = Mapping[str, h5py.Dataset]
Place = Sequence[int]  # numbers along gamma, delta and delay


class _Grid(NamedTuple):
    """The axes of a file, and its estimator and filter as keywords of the five-number functions."""

    axes: Mapping[str, NDArray[Any]]
    filters: Mapping[str, Any]


class Check(NamedTuple):
    """One check: its name, whether it passed, and its finding in words."""

    name: str
    passed: bool
    words: str

    def __str__(self) -> str:
        return f"{self.name}: {'ok' if self.passed else 'WRONG'}, {self.words}"


def verify_atlas(path: str | PathLike[str], sample: int = 1000, seed: int = 0) -> Iterator[Check]:
    """Yield one check after the other; the first that fails may be the last.

    Args:
        path: of the file.
        sample: about how many nodes, and as many points in cells, are computed again; of outlines
            and summaries those of at most 16 slices are.
        seed: of the sample.

    Raises:
        OSError: the file is missing or unreadable.

    Source: ``jaxstab.verdict`` with resolve="exact", ``jaxstab.spectral_radius``,
        ``jaxstab.stable_region`` and ``jaxstab.minimize_radius``.
    """
    chance = np.random.default_rng(seed)
    path = Path(path)
    try:
        table = table_of(path)
        yield Check("file", True, "whole by its SHA-256, of this version of the schema")
        with opened(path) as file:
            datasets = checked_datasets(file, table)
            yield Check("schema", True, f"{len(datasets)} variables as it says")
            yield _content(file, datasets, table)
            axes = {name: datasets[name][()] for name in AXES}
            grid = _Grid(axes, as_keywords(filters_of(b"\n".join(datasets[SPEC][()]).decode())))
            for name in (name for name in _COMPARED if name in datasets):
                yield _sampled(name, datasets, grid, sample, chance)
            for product in (p for p in _OF_SLICES if PRODUCTS[p][0] in datasets):
                yield _sampled_slices(product, datasets, grid, sample, chance)
        atlas = open_atlas(path)
        if SPECTRAL_RADIUS in atlas.products:
            yield _radii(atlas, sample, chance)
        yield _answers(atlas, sample, chance)
    except TooLargeError:
        return
    except ValueError as error:
        yield Check("file", False, str(error))


def _content(file: h5py.File, datasets: Datasets, table: Table) -> Check:
    found = content_digest(digest_of(name, dataset) for name, dataset in datasets.items())
    is_said = table.content_digest == text_of(file, "content_sha256")
    return Check("content", is_said and found == table.content_digest, f"its digest is {found}")


def _sampled(
    name: str, datasets: Datasets, grid: _Grid, sample: int, chance: np.random.Generator
) -> Check:
    """Compare a variable with what is computed at points of some slices."""
    places = _places(datasets[name].shape[2:], sample, chance)
    each = -(-sample // len(places))
    wrong = sum(_COMPARED[name](datasets, grid, place, each, chance) for place in places)
    return Check(name, wrong == 0, f"{wrong} of {each * len(places)} points are wrong")


def _sampled_slices(
    product: str, datasets: Datasets, grid: _Grid, sample: int, chance: np.random.Generator
) -> Check:
    """Compare a product with what is computed for some slices."""
    places = _places([grid.axes[name].size for name in SLICE], sample, chance)
    wrong = sum(_OF_SLICES[product](datasets, grid, place) for place in places)
    return Check(
        product, wrong == 0, f"{wrong} of {len(places)} slices are off by {_MOST[product]}"
    )


def _places(counts: Sequence[int], sample: int, chance: np.random.Generator) -> list[Place]:
    """Return some of the slices, each once."""
    slices = prod(counts)
    some = chance.choice(slices, min(_SLICES, sample, slices), replace=False)
    places: list[Place] = np.stack(np.unravel_index(some, counts), axis=-1).tolist()
    return places


def _wrong_nodes(
    datasets: Datasets, grid: _Grid, place: Place, count: int, chance: np.random.Generator
) -> int:
    gamma, delta, delay = place
    codes = datasets[VERDICT][:, :, gamma, delta, delay]
    i, j = _some(codes, count, chance)
    return _wrong_codes(codes[i, j], _nodes(grid, i, j, place), grid.filters)


def _wrong_cells(
    datasets: Datasets, grid: _Grid, place: Place, count: int, chance: np.random.Generator
) -> int:
    gamma, delta, delay = place
    codes = datasets[CELL_VERDICT][:, :, gamma, delta, delay]
    i, j = _some(codes, count, chance)
    inside = [
        _within(nodes, cell, chance)
        for nodes, cell in (
            (grid.axes["alpha"][:, delay], i),
            (grid.axes["beta"][:, delay], j),
            (grid.axes["gamma"], np.full(count, gamma)),
            (grid.axes["delta"], np.full(count, delta)),
        )
    ]
    return _wrong_codes(codes[i, j], (*inside, grid.axes["delay"][delay]), grid.filters)


def _is_wrong_outline(datasets: Datasets, grid: _Grid, place: Place) -> bool:
    """Whether points or corners are not on the boundary, or parts of it are missing."""
    loop = _loop(grid, place)
    stored, region = (
        outline_at({**datasets, **grid.axes}, *loop),
        stable_region(**by_name(*loop), **grid.filters),
    )
    if stored.status != int(region.status) or not np.all(np.isfinite(stored.points)):
        return True
    if stored.status != RegionStatus.COMPLETE:
        return False
    size = float(np.hypot(*np.ptp(region.points, axis=0)))
    points = np.resize(stored.points, region.outline.vertices.shape)  # one shape is compiled once
    aside = np.asarray(region.distance(*points.T))
    missing = float(region.area) - _enclosed(stored)
    return not (
        np.all(np.abs(aside) <= _NEAR * size)
        and abs(missing) <= _POLYGON * size**2
        and stored.corners.shape == region.corners.shape
        and np.allclose(stored.corners, region.corners, 0.0, _NEAR * size)
    )


def _enclosed(outline: AtlasOutline) -> float:
    """Return the area of the polygon, or of several without the ways between them."""
    (x0, y0), (x1, y1) = outline.points[:-1].T, outline.points[1:].T
    return 0.5 * float(np.sum(x0 * y1 - x1 * y0, where=outline.branch >= 0))


def _is_wrong_summary(datasets: Datasets, grid: _Grid, place: Place) -> bool:
    gamma, delta, delay = _loop(grid, place)
    exact = slice_summaries(np.array([[gamma, delta]]), delay, known_filters(**grid.filters))
    tolerances = {name: _FAR if "_of_" in name else _NEAR for name in exact}
    return not all(
        np.isclose(datasets[name][tuple(place)], exact[name], tolerance, _NEAR**2, equal_nan=True)
        for name, tolerance in tolerances.items()
    )


def _some(
    values: NDArray[Any], count: int, chance: np.random.Generator
) -> tuple[Int64[np.ndarray, " count"], Int64[np.ndarray, " count"]]:
    """Return places in a slice, half of them where the value changes along beta."""
    i, j = (chance.integers(0, length, count) for length in values.shape)
    changes = np.argwhere(values[:, 1:] != values[:, :-1])
    if len(changes):
        near = chance.choice(changes, count // 2)
        i[: count // 2], j[: count // 2] = near[:, 0], near[:, 1] + chance.integers(0, 2)
    return i, j


def _nodes(
    grid: _Grid, i: Int64[np.ndarray, " point"], j: Int64[np.ndarray, " point"], place: Place
) -> tuple[Any, ...]:
    delay = place[-1]
    return (grid.axes["alpha"][i, delay], grid.axes["beta"][j, delay], *_loop(grid, place))


def _loop(grid: _Grid, place: Place) -> tuple[float, float, float]:
    """Return gamma, delta and delay of a slice."""
    gamma, delta, delay = place
    return (
        float(grid.axes["gamma"][gamma]),
        float(grid.axes["delta"][delta]),
        float(grid.axes["delay"][delay]),
    )


def _within(
    nodes: Float64[np.ndarray, " node"],
    cell: Int64[np.ndarray, " point"],
    chance: np.random.Generator,
) -> Float64[np.ndarray, " point"]:
    """Return a random point of each cell; a single node is its cell."""
    lower, upper = nodes[cell], nodes[np.minimum(cell + 1, nodes.size - 1)]
    inside: np.ndarray = np.clip(lower + chance.random(cell.size) * (upper - lower), lower, upper)
    return inside


def _wrong_codes(
    codes: Int8[np.ndarray, " point"], point: tuple[Any, ...], filters: Mapping[str, Any]
) -> int:
    """Count codes that are none, and those that say the opposite of a verdict for the point."""
    exact = np.asarray(verdict(**by_name(*point), resolve="exact", **filters))
    both = np.isin(codes, (Verdict.STABLE, Verdict.UNSTABLE)) & np.isin(
        exact, (Verdict.STABLE, Verdict.UNSTABLE)
    )
    return int(np.sum((both & (codes != exact)) | (codes == Verdict.NOT_COMPUTED)))


def _radii(atlas: Atlas, sample: int, chance: np.random.Generator) -> Check:
    """Ask for radii at random points of cells of delays, and compute them."""
    rows = atlas.arrays[RADIUS_RANGE]
    each, wrong = -(-sample // _SLICES), 0
    filters = as_keywords(atlas.filters)
    hands = [atlas.arrays[name][[0, -1]] for name in ("gamma", "delta")]
    for row in rows[chance.integers(len(rows), size=_SLICES)]:
        ends = row[2:4], row[4:], *hands
        alpha, beta, gamma, delta = (chance.uniform(low, high, each) for low, high in ends)
        point = alpha, beta, gamma, delta, chance.uniform(*row[:2])
        answer = atlas.query(**by_name(*point), outside="undecided")
        radius = spectral_radius(**by_name(*point), **filters)
        off = np.abs(answer.spectral_radius - radius.value) - radius.error
        is_known = np.isfinite(answer.radius_error)
        wrong += int(np.sum(is_known & ~(off <= answer.radius_error)))  # NaN is wrong, too
    return Check(SPECTRAL_RADIUS, wrong == 0, f"{wrong} of {each * _SLICES} points are wrong")


def _answers(atlas: Atlas, sample: int, chance: np.random.Generator) -> Check:
    """Ask the atlas about random points of each delay, as its users do."""
    each, wrong = -(-sample // atlas.delays.size), 0
    filters = as_keywords(atlas.filters)
    for number, delay in enumerate(atlas.delays):
        ends = [(nodes[0], nodes[-1]) for nodes in atlas.nodes(number).values()]
        point = (*(chance.uniform(*side, each) for side in ends), delay)
        answer = atlas.query(**by_name(*point))
        codes = np.where(
            answer.verdict == Verdict.NOT_COMPUTED, np.int8(Verdict.UNDECIDED), answer.verdict
        )
        wrong += _wrong_codes(codes, point, filters)
    points = each * atlas.delays.size
    return Check("answers", wrong == 0, f"{wrong} of {points} points are wrong")


_COMPARED = {VERDICT: _wrong_nodes, CELL_VERDICT: _wrong_cells}
_OF_SLICES = {"outline": _is_wrong_outline, "summary": _is_wrong_summary}
_MOST = {
    "outline": f"more than {_NEAR:g} of their size",
    "summary": f"more than {_NEAR:g}, or {_FAR:g} in where an extreme lies",
}
