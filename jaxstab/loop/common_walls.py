"""Walls that several stable regions share, by rows of the damping."""

from collections.abc import Mapping, Sequence
from functools import partial, reduce
from typing import TypeVar

import numpy as np
from jaxtyping import Float64

from jaxstab.loop.region import Gains, WallRegion
from jaxstab.ranges.robust_region import polygon_of_rows

_ROWS = 33
_ZOOMS = 5

Key = TypeVar("Key")
Points = Float64[np.ndarray, "vertex 2"]
Rows = Float64[np.ndarray, " row"]
Intervals = Float64[np.ndarray, "row _ 2"]


def common_walls(regions: Sequence[WallRegion], count: int = _ROWS) -> Points:
    """Return a polygon of walls that all regions have, by rows; no point where no row has one.

    Of several intervals of a row it is the widest. What lies between two rows may be missed, and of
    the polygon nothing is proved.

    Args:
        regions: at least one, none of them empty.
        count: of rows.
    """
    low, high = common_rows(regions)
    if not low < high:
        return np.zeros((0, 2))
    return polygon_of_rows(partial(common_limits, regions), low, high, count)


def stiffest_wall(regions: Sequence[WallRegion]) -> Gains | None:
    """Return the largest stiffness that regions share, none of them empty, and its damping."""
    low, high = common_rows(regions)
    best: Gains | None = None
    for _ in range(_ZOOMS):
        if not low < high:
            break
        rows = np.linspace(low, high, _ROWS + 2)[1:-1]
        left, right = common_limits(regions, rows)
        right = np.where(left < right, right, -np.inf)
        number = int(np.argmax(right))
        if right[number] == -np.inf:
            break
        if best is None or right[number] >= best.stiffness:
            best = Gains(float(right[number]), float(rows[number]))
        step = rows[1] - rows[0]
        low, high = rows[number] - step, rows[number] + step
    return best


def setter_of(regions: Mapping[Key, WallRegion], damping: float) -> Key:
    """Return which of some regions allows least at a damping."""
    row = np.array([damping])
    tops = {key: region.stiffness_limits(row)[0, 1] for key, region in regions.items()}
    return min(tops, key=lambda key: tops[key])


def common_rows(regions: Sequence[WallRegion]) -> tuple[float, float]:
    """Return the dampings between which all regions may have a wall."""
    tops = [region.outline[:, 1] for region in regions]
    return max(top.min() for top in tops), min(top.max() for top in tops)


def common_limits(regions: Sequence[WallRegion], rows: Rows) -> tuple[Rows, Rows]:
    """Return the ends of the widest interval of stiffness that all regions have in each row."""
    shared = reduce(_shared, (region.stiffness_intervals(rows) for region in regions))
    if not shared.shape[1]:
        return np.full(len(rows), np.inf), np.full(len(rows), -np.inf)
    shared = np.where(np.isnan(shared), [np.inf, -np.inf], shared)
    widest = np.argmax(shared[..., 1] - shared[..., 0], axis=1)
    left, right = shared[np.arange(len(rows)), widest].T
    return left, right


def _shared(one: Intervals, other: Intervals) -> Intervals:
    """Return the intervals that two sets of intervals share; NaN for none."""
    low = np.maximum(one[:, :, None, 0], other[:, None, :, 0])
    high = np.minimum(one[:, :, None, 1], other[:, None, :, 1])
    both = np.where((low < high)[..., None], np.stack([low, high], axis=-1), np.nan)
    shared = both.reshape(len(one), low.shape[1] * low.shape[2], 2)
    return shared[:, ~np.isnan(shared[..., 0]).all(axis=0)]
