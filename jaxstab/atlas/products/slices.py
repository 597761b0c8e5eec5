"""Products of slices (gamma, delta, delay), from the closed form: without a grid.

An outline is the boundary of the stable region of a slice, with its corners; a summary has the
extremes of the region, its area and the fastest loop. The outlines of an atlas have different
numbers of points, so their points are strung together, slice after slice, each ended by NaN; their
counts say which points belong to a slice (``outline_at``).

Both are verified for whole slices: an outline must lie on the exact boundary, enclose its area and
have its corners.
"""

from collections.abc import Iterator, Mapping
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.product import (
    SLICE,
    Array,
    Check,
    Floats,
    Inspection,
    Product,
    SliceIndex,
    Variable,
    numbers,
)

if TYPE_CHECKING:
    from jaxstab.atlas.plan import Plan, Tile
    from jaxstab.model.filters import Filters
    from jaxstab.region import StableRegion

OUTLINE_ALPHA = "outline_alpha"
OUTLINE_BETA = "outline_beta"
OUTLINE_BRANCH = "outline_branch"
OUTLINE_SIZE = "outline_size"
OUTLINE_STATUS = "outline_status"
CORNER_ALPHA = "corner_alpha"
CORNER_BETA = "corner_beta"
CORNER_COUNT = "corner_count"

_NEAR = 1e-9  # of the size of a slice's stable region, or of a number in its summary
_FAR = 1e-6  # of a coordinate of an extreme, where the extreme value hardly changes
_POLYGON = 1e-5  # of that size squared: a polygon leaves the boundary by 1e-6 of it


def _point(name: str, dimension: str, what: str) -> Variable:
    words = "the slices follow each other in the order of delay, gamma, delta; NaN ends each"
    return Variable(name, "float64", (dimension,), what, words, has_nan=True)


def _measure(name: str, long_name: str, interpretation: str) -> Variable:
    return Variable(name, "float64", SLICE, long_name, interpretation, has_nan=True)


def _count(name: str, long_name: str, interpretation: str, highest: float | int) -> Variable:
    return Variable(name, "int32", SLICE, long_name, interpretation, 0, highest)


_OUTLINE = (
    numbers("outline_point", "point of all outlines, one after the other"),
    numbers("corner", "corner of all outlines, one after the other"),
    _point(OUTLINE_ALPHA, "outline_point", "alpha along the boundary of the stable region"),
    _point(OUTLINE_BETA, "outline_point", "beta along the boundary of the stable region"),
    Variable(
        OUTLINE_BRANCH,
        "int32",
        ("outline_point",),
        "what the boundary is from this point to the next",
        "0 a pair of roots on the unit circle, 1 a root at z = 1, 2 one at z = -1, -1 no piece",
        -1,
        2,
    ),
    _point(CORNER_ALPHA, "corner", "alpha of the corners, where two branches meet"),
    _point(CORNER_BETA, "corner", "beta of the corners, where two branches meet"),
    _count(OUTLINE_SIZE, "number of outline points", "with the NaN at their end", inf),
    _count(CORNER_COUNT, "number of corners", "with the NaN at their end", inf),
    _count(
        OUTLINE_STATUS,
        "status of the outline",
        "0 complete, 1 the stable region is empty, 2 unresolved: do not use it",
        2,
    ),
)

_SUMMARY = (
    _measure("largest_alpha", "largest stable alpha", "closed form; NaN if none is stable"),
    _measure("beta_of_largest_alpha", "beta of the largest stable alpha", "from the closed form"),
    _measure("largest_beta", "largest stable beta", "closed form; NaN if none is stable"),
    _measure("stable_area", "area of the stable region", "in the (alpha, beta) plane"),
    _measure("least_radius", "smallest spectral radius", "over all (alpha, beta)"),
    _measure(
        "alpha_of_least_radius", "alpha of the smallest spectral radius", "solved for, not gridded"
    ),
    _measure(
        "beta_of_least_radius", "beta of the smallest spectral radius", "solved for, not gridded"
    ),
)


class _BySlices(Product):
    """A product of whole slices."""

    tolerance: str

    def checks(self, stored: Inspection) -> Iterator[Check]:
        places = stored.places([stored.datasets[name].size for name in SLICE])
        wrong = sum(self.is_wrong(stored, place) for place in places)
        words = f"{wrong} of {len(places)} slices are off by {self.tolerance}"
        yield Check(self.name, wrong == 0, words)

    def is_wrong(self, stored: Inspection, place: SliceIndex) -> bool:
        raise NotImplementedError


class Outlines(_BySlices):
    """Outlines and corners of stable regions."""

    name = "outline"
    variables = _OUTLINE
    strung = {OUTLINE_SIZE: "outline_point", CORNER_COUNT: "corner"}  # noqa: RUF012
    tolerance = f"more than {_NEAR:g} of their size"

    def compute(self, plan: "Plan", tile: "Tile") -> dict[str, Array]:
        regions = _regions(plan.hands(tile), plan.grid.walls(tile.delay)[2], plan.spec.filters)
        points = [_ended(region.points) for region in regions]
        corners = [_ended(region.corners) for region in regions]
        # A piece begins at every point but the last one and the end mark.
        branches = [
            np.append(region.branch, np.full(len(points_of) - len(region.branch), -1))
            for region, points_of in zip(regions, points, strict=True)
        ]
        counts = {
            OUTLINE_STATUS: [int(region.status) for region in regions],
            OUTLINE_SIZE: [len(points_of) for points_of in points],
            CORNER_COUNT: [len(points_of) for points_of in corners],
        }
        shape = plan.shape(OUTLINE_SIZE, tile)
        arrays: dict[str, Array] = {
            name: np.array(n, np.int32).reshape(shape) for name, n in counts.items()
        }
        outline, corner = np.concatenate(points), np.concatenate(corners)
        return arrays | {
            OUTLINE_ALPHA: outline[:, 0].copy(),
            OUTLINE_BETA: outline[:, 1].copy(),
            OUTLINE_BRANCH: np.concatenate(branches).astype(np.int32),
            CORNER_ALPHA: corner[:, 0].copy(),
            CORNER_BETA: corner[:, 1].copy(),
        }

    def is_wrong(self, stored: Inspection, place: SliceIndex) -> bool:
        from jaxstab.model import by_name
        from jaxstab.region import RegionStatus, stable_region

        loop = stored.loop(place)
        outline = outline_at(stored.datasets, *loop)
        region = stable_region(**by_name(*loop), **stored.filters)
        if outline.status != int(region.status) or not np.all(np.isfinite(outline.points)):
            return True
        if outline.status != RegionStatus.COMPLETE:
            return False
        size = float(np.hypot(*np.ptp(region.points, axis=0)))
        points = np.resize(outline.points, region.outline.vertices.shape)  # one shape: one program
        aside = np.asarray(region.distance(*points.T))
        (x0, y0), (x1, y1) = outline.points[:-1].T, outline.points[1:].T
        enclosed = 0.5 * float(np.sum(x0 * y1 - x1 * y0, where=outline.branch >= 0))
        missing = float(region.area) - enclosed
        return not (
            np.all(np.abs(aside) <= _NEAR * size)
            and abs(missing) <= _POLYGON * size**2
            and outline.corners.shape == region.corners.shape
            and np.allclose(outline.corners, region.corners, 0.0, _NEAR * size)
        )


class Summaries(_BySlices):
    """Extremes of stable regions, and the fastest loops."""

    name = "summary"
    variables = _SUMMARY
    tolerance = f"more than {_NEAR:g}, or {_FAR:g} in where an extreme lies"

    def compute(self, plan: "Plan", tile: "Tile") -> dict[str, Array]:
        delay = plan.grid.walls(tile.delay)[2]
        values = slice_summaries(plan.hands(tile), delay, plan.spec.filters)
        return {name: value.reshape(plan.shape(name, tile)) for name, value in values.items()}

    def is_wrong(self, stored: Inspection, place: SliceIndex) -> bool:
        from jaxstab.model.filters import known_filters

        gamma, delta, delay = stored.loop(place)
        hand = np.array([[gamma, delta]])
        exact = slice_summaries(hand, delay, known_filters(**stored.filters))
        return not all(
            np.isclose(
                stored.datasets[name][tuple(place)],
                value,
                _FAR if "_of_" in name else _NEAR,
                _NEAR**2,
                equal_nan=True,
            )
            for name, value in exact.items()
        )


def slice_summaries(
    hands: Floats, delay: float, filters: "Filters | None" = None
) -> dict[str, Floats]:
    """The variables of the product ``summary`` for slices: ``hands`` are their gamma and delta."""
    from jaxstab.model.filters import as_keywords
    from jaxstab.tuning import minimize_radius

    regions = _regions(hands, delay, filters)
    best = minimize_radius(
        gamma=hands[:, 0], delta=hands[:, 1], delay=delay, **as_keywords(filters)
    )
    values = (
        [float(region.max_alpha[0]) for region in regions],
        [float(region.max_alpha[1]) for region in regions],
        [float(region.max_beta[1]) for region in regions],
        [float(region.area) for region in regions],
        best.value,
        best.alpha,
        best.beta,
    )
    names = (variable.name for variable in _SUMMARY)
    return {name: np.array(value, np.float64) for name, value in zip(names, values, strict=True)}


def _regions(hands: Floats, delay: float, filters: "Filters | None") -> "list[StableRegion]":
    from jaxstab.model.filters import as_keywords
    from jaxstab.region import stable_region

    keywords = as_keywords(filters)
    return [
        stable_region(gamma=gamma, delta=delta, delay=delay, **keywords)
        for gamma, delta in hands.tolist()
    ]


def _ended(points: Floats) -> Floats:
    """Return points and, so that a plot of many breaks off here, one that is not a number."""
    return np.append(points, [[np.nan, np.nan]], axis=0)


class AtlasOutline(NamedTuple):
    """The boundary of the stable region of one slice, from an atlas.

    Attributes:
        points: (n, 2), alpha and beta counter-clockwise, the last one equal to the first.
        branch: (n - 1,), what each piece is: 0 a pair of roots on the unit circle, 1 a root at z =
            1, 2 a root at z = -1; -1 between two loops.
        corners: (m, 2), where two branches meet, to full precision.
        status: 0 complete, 1 the region is empty, 2 unresolved: do not use it.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> axes = {"gamma": (0.0,), "delta": (0.01,), "delay": (1.0,)}
        >>> spec = jaxstab.AtlasSpec(**axes, products=("outline",))
        >>> with TemporaryDirectory() as folder:
        ...     atlas = jaxstab.build_atlas(spec, Path(folder) / "outline.h5")
        >>> outline = atlas.outline(gamma=0.0, delta=0.01, delay=1.0)
        >>> int(outline.status), outline.corners.round(3).tolist()
        (0, [[0.0, -0.01], [0.0, 0.836]])
    """

    points: NDArray[np.float64]
    branch: NDArray[np.int32]
    corners: NDArray[np.float64]
    status: int


def outline_at(
    arrays: Mapping[str, NDArray[Any]], gamma: float, delta: float, delay: float
) -> AtlasOutline:
    """The outline at a node of gamma, delta and delay; ValueError if it is no node, or has none."""
    if OUTLINE_SIZE not in arrays:
        raise ValueError("this atlas holds no outlines; build one with the product 'outline'.")
    given = {"gamma": gamma, "delta": delta, "delay": delay}
    i, j, k = (_index_of(name, arrays[name], value) for name, value in given.items())
    points = _values_of(arrays, OUTLINE_SIZE, (i, j, k))
    corners = _values_of(arrays, CORNER_COUNT, (i, j, k))
    return AtlasOutline(
        np.stack([arrays[n][points] for n in (OUTLINE_ALPHA, OUTLINE_BETA)], axis=-1),
        arrays[OUTLINE_BRANCH][points][:-1],
        np.stack([arrays[n][corners] for n in (CORNER_ALPHA, CORNER_BETA)], axis=-1),
        int(arrays[OUTLINE_STATUS][i, j, k]),
    )


def _values_of(
    arrays: Mapping[str, NDArray[Any]], counts: str, place: tuple[int, int, int]
) -> slice:
    """Return the range of the values of a slice, without the NaN at its end."""
    gamma, delta, delay = place
    in_order = np.transpose(arrays[counts], (2, 0, 1))
    ends = np.cumsum(in_order).reshape(in_order.shape)
    end = int(ends[delay, gamma, delta])
    return slice(end - int(arrays[counts][place]), end - 1)


def _index_of(name: str, nodes: NDArray[np.float64], value: float) -> int:
    (indices,) = np.nonzero(nodes == value)
    if not indices.size:
        listed = ", ".join(map(repr, nodes.tolist()))
        raise ValueError(f"{name} is {value!r}; outlines are at its nodes {listed}.")
    return int(indices[0])
