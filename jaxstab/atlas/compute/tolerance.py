"""As many nodes along gamma or delta as a tolerance needs: where little changes, few."""

from collections.abc import Sequence
from itertools import pairwise
from math import ceil

import numpy as np
from jaxtyping import Float64

from jaxstab.atlas.format.spec import ToleranceAxis
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.region import Branch, RegionStatus, StableRegion, stable_region
from jaxstab.region.curve import (
    curve_point,
    minus_offset,
    minus_slope,
    plus_offset,
    plus_slope,
)

_PROBES = 17  # values along the axis at which the boundary is looked at
_FINENESS = 1e-3  # of outlines, whose extremes are exact

Slice = tuple[float, float, float]


def tolerant_nodes(
    axis: ToleranceAxis,
    name: str,
    across: Sequence[float],
    delays: Sequence[float],
    filters: Filters | None,
) -> Float64[np.ndarray, " node"]:
    """Return nodes between which the boundary of the stable set moves by the tolerance at most.

    The motion is that of the boundary's points at a fixed angle of the roots on the circle, and for
    a real root at a fixed beta, in units of the set's extents. It is added up over even steps along
    the axis, and the nodes share it equally.

    Args:
        axis: its ends and the tolerance.
        name: "gamma" or "delta".
        across: values of the other one of the two.
        delays: time delays t_d/T.
        filters: velocity estimator and position filter.

    Raises:
        ValueError: nowhere along the axis a loop is stable, a region is unresolved, or a parameter
            is too large.
    """
    values = np.linspace(axis.start, axis.stop, _PROBES)
    moved = np.zeros(_PROBES - 1)
    for other in across:
        for delay in delays:
            slices = [
                (value, other, delay) if name == "gamma" else (other, value, delay)
                for value in values.tolist()
            ]
            moved = np.maximum(moved, _motions(slices, filters))
    passed = np.concatenate([[0.0], np.cumsum(moved)])
    steps = max(1, ceil(passed[-1] / axis.tolerance))
    nodes = np.interp(np.linspace(0.0, passed[-1], steps + 1), passed, values)
    return np.concatenate([[axis.start], nodes[1:-1], [axis.stop]])


def known_region(gamma: float, delta: float, delay: float, filters: Filters | None) -> StableRegion:
    """Return the stable region of a slice, which may be empty.

    Raises:
        ValueError: it is unresolved, or a parameter is too large for the model.
    """
    region = stable_region(
        gamma=gamma, delta=delta, delay=delay, tolerance=_FINENESS, **as_keywords(filters)
    )
    if region.status == RegionStatus.UNRESOLVED:
        raise ValueError(
            f"no axis can be laid around the region at gamma {gamma:g}, delta {delta:g}, delay "
            f"{delay:g} ({RegionStatus.UNRESOLVED.words}); give its nodes."
        )
    return region


def _motions(slices: Sequence[Slice], filters: Filters | None) -> list[float]:
    """Return how far the boundary moves from each slice to the next."""
    regions = [known_region(*one, filters) for one in slices]
    points = np.concatenate([region.points for region in regions])
    if not points.size:
        raise ValueError(
            f"no (alpha, beta) is stable at delay {slices[0][2]:g} along an axis that is given by "
            "a tolerance; give its nodes."
        )
    extent = np.ptp(points, axis=0)
    there = [_motion(*pair, extent) for pair in pairwise(regions)]
    back = [_motion(*pair, extent) for pair in zip(regions[1:], regions[:-1], strict=True)]
    return list(map(max, there, back))


def _motion(region: StableRegion, other: StableRegion, extent: Float64[np.ndarray, "2"]) -> float:
    """Return how far the outline's points move to another slice, at their angle or their beta."""
    points, branch, c = region.points[:-1], region.branch[:, None], other.coefficients
    beta = points[:, 1]
    moved = np.select(
        [branch == kind for kind in (Branch.CURVE, Branch.Z_PLUS_ONE, Branch.Z_MINUS_ONE)],
        [
            np.stack(curve_point(c, region.outline.angles[: beta.size, 0]), axis=-1),
            np.stack([plus_offset(c) - plus_slope(c) * beta, beta], axis=-1),
            np.stack([minus_offset(c) - minus_slope(c) * beta, beta], axis=-1),
        ],
        np.nan,
    )
    way = np.abs(moved - points) / extent
    return float(np.max(way, where=np.isfinite(way), initial=0.0))
