"""The one minimiser: a grid over two coordinates, and finer grids around its best points.

Radii and settling times have kinks, edges, and narrow valleys where poles meet, so no slopes are
asked for. All points of a grid are computed at once. Around the best of its local minima finer
grids follow, each a quarter or less as wide as the last one; a minimum that cannot become the best
one is given up. One coordinate may be fixed. Where the minimum is a multiple pole, its
equations are solved afterwards, to full precision (``multiple_roots``).
"""

from collections.abc import Callable
from itertools import product

import numpy as np
from jaxtyping import Float64, Int64

Axis = Float64[np.ndarray, " _"]
Values = Callable[[np.ndarray, np.ndarray], np.ndarray]  # at lists of both coordinates


def minimised(
    values: Values,
    axes: tuple[Axis, Axis],
    *,
    starts: int = 1,
    points: int = 33,
    reach: int = 4,
    zooms: int = 12,
    enough: float = -np.inf,
    lowest: float = -np.inf,
) -> tuple[tuple[float, float], float]:
    """Return the point of the smallest value that grids find, and this value.

    They are NaN and infinite where no value of the first grid is finite.

    Args:
        values: infinite where a point does not count.
        axes: the first grid, increasing; an axis of one value is fixed.
        starts: how many local minima of the first grid are followed.
        points: on an axis of finer grids.
        reach: steps of a grid, to each side of its best point, over which the next one extends.
        zooms: how many finer grids there are at most.
        enough: a value at which the search ends; minima that cannot reach it are given up.
        lowest: no coordinate of a finer grid is below it.
    """
    first = values(*(mesh.ravel() for mesh in np.meshgrid(*axes, indexing="ij")))
    first = first.reshape([axis.size for axis in axes])
    places = _local_minima(first)[:starts].T
    if not places.size:
        return (np.nan, np.nan), np.inf
    centres, least = np.array([axes[0][places[0]], axes[1][places[1]]]), first[tuple(places)]
    halves = np.array([_reached(*pair, reach) for pair in zip(axes, places, strict=True)])
    steps = np.linspace(-1.0, 1.0, points)
    shares = np.meshgrid(*(steps if axis.size > 1 else np.zeros(1) for axis in axes), indexing="ij")
    offsets = np.stack([mesh.ravel() for mesh in shares])[:, None, :]
    best, value = centres[:, 0], float(least[0])
    for _ in range(zooms):
        if value <= enough or not least.size:
            break
        finer = np.maximum(centres[..., None] + halves[..., None] * offsets, lowest)
        found = values(*finer.reshape(2, -1)).reshape(finer.shape[1:])
        boxes, place = np.arange(least.size), np.argmin(found, axis=1)
        is_better = found[boxes, place] < least
        centres = np.where(is_better, finer[:, boxes, place], centres)
        least = np.minimum(least, found[boxes, place])
        smallest = np.argmin(least)
        if least[smallest] < value:
            best, value = centres[:, smallest], float(least[smallest])
        # Between two points, slopes go down by no more than about what they do over the grid.
        spread = np.where(np.isfinite(found), found, -np.inf).max(axis=1) - least
        lower = least - np.maximum(spread, 0.0) * (4.0 / points)
        is_open = lower < (enough if enough > -np.inf else value)
        centres, least, halves = centres[:, is_open], least[is_open], halves[:, is_open]
        halves = halves * (reach / (points // 2))
    return (float(best[0]), float(best[1])), value


def _reached(axis: Axis, index: np.ndarray, reach: int) -> Axis:
    """Return how far some steps along an axis reach from points of it."""
    sides = [np.clip(index + side * reach, 0, axis.size - 1) for side in (-1, 1)]
    return np.max([np.abs(axis[side] - axis[index]) for side in sides], axis=0)


def _local_minima(values: np.ndarray) -> Int64[np.ndarray, "minimum 2"]:
    """Return the places of values that no neighbour is below, the least first."""
    rows, columns = values.shape
    padded = np.full((rows + 2, columns + 2), np.inf)
    padded[1:-1, 1:-1] = values
    is_least = np.isfinite(values)
    for row, column in product(range(3), repeat=2):
        is_least &= values <= padded[row : row + rows, column : column + columns]
    places = np.argwhere(is_least)
    return places[np.argsort(values[is_least], kind="stable")]
