"""The grid of a guard: limits at its nodes, and their largest and smallest values over boxes."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

Reals = Float64[np.ndarray, " box"]
Ends = Float64[np.ndarray, "axis box"]  # in cells

_SLACK = 1e-9  # of the largest value: more than the arithmetic of the header rounds


class Grid(NamedTuple):
    """Limits at nodes, between which a guard interpolates linearly in mass, delay and damping.

    Attributes:
        mass: of the device at the nodes in kg, evenly spaced.
        delay: at the nodes in samples, evenly spaced.
        top: the largest damping in N s/m, shape (mass, delay).
        limit: the largest stiffness in N/m at evenly spaced dampings from 0 to the largest one,
            shape (mass, delay, damping).
    """

    mass: Float64[np.ndarray, " mass"]
    delay: Float64[np.ndarray, " delay"]
    top: Float64[np.ndarray, "mass delay"]
    limit: Float64[np.ndarray, "mass delay damping"]

    @property
    def cells(self) -> tuple[int, int, int]:
        """How many cells there are along mass, delay and damping."""
        first, second, third = (size - 1 for size in self.limit.shape)
        return first, second, third


class Models(NamedTuple):
    """A function over boxes: its centre, its moves along the axes, and a bound of what they leave.

    Boxes of several cells have no moves; there the bound covers all of the variation.
    """

    centre: Reals
    moves: Float64[np.ndarray, "axis box"]
    rest: Reals


class Pyramid:
    """Bounds of a grid over boxes whose ends, in cells, are multiples of powers of two."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._slack = _SLACK * float(np.max(grid.limit))
        self._most = _heaps(_of_cells(grid.limit, np.maximum), np.maximum)
        self._high = _heaps(_of_cells(grid.top, np.maximum), np.maximum)
        self._low = _heaps(_of_cells(grid.top, np.minimum), np.minimum)

    def limits(
        self, low: Float64[np.ndarray, "3 box"], high: Float64[np.ndarray, "3 box"]
    ) -> Models:
        """Bound the limit from above, by models without a rest, over boxes of three axes."""
        large = self._most[self._heap_of(low, high)]
        known = _model(self._grid.limit, low, high)
        is_small = _are_small(low, high)
        return Models(
            np.where(is_small, known.centre + known.rest, large) + self._slack,
            np.where(is_small, known.moves, 0.0),
            np.zeros_like(large),
        )

    def tops(self, low: Ends, high: Ends) -> Models:
        """Enclose the largest damping over boxes of mass and delay."""
        heap = self._heap_of(low, high)
        least, most = self._low[heap], self._high[heap]
        known = _model(self._grid.top, low, high)
        is_small = _are_small(low, high)
        rest = np.where(is_small, known.rest, 0.5 * (most - least))
        centre = np.where(is_small, known.centre, 0.5 * (most + least))
        return Models(centre, np.where(is_small, known.moves, 0.0), rest + _SLACK * centre)

    def _heap_of(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, ...]:
        ends = zip(low, high, self._grid.cells, strict=False)
        return tuple(_heap(first, last, count) for first, last, count in ends)


def step_of(nodes: Float64[np.ndarray, " node"]) -> float:
    """Return the step of evenly spaced nodes."""
    return float(nodes[-1] - nodes[0]) / (len(nodes) - 1)


def interpolated(nodes: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return values between nodes at places in cells, (axis, place)."""
    return _at_corners(nodes, (index, index))[0]


def _are_small(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    small: np.ndarray = np.all(high - low <= 1.0, axis=0)
    return small


def _model(nodes: np.ndarray, low: np.ndarray, high: np.ndarray) -> Models:
    """Return the model of the interpolation over boxes within one cell."""
    corners = _at_corners(nodes, (low, high))
    signs = np.indices((2,) * len(low)).reshape(len(low), -1) * 2.0 - 1.0
    moves = signs @ corners / corners.shape[0]
    centre = corners.mean(axis=0)
    # Linear in each variable, it is farthest from its model at a corner.
    rest = np.max(np.abs(corners - centre - signs.T @ moves), axis=0)
    return Models(centre, moves, rest)


def _of_cells(nodes: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    for axis in range(nodes.ndim):
        nodes = np.moveaxis(nodes, axis, 0)
        nodes = np.moveaxis(extreme(nodes[:-1], nodes[1:]), 0, axis)
    return nodes


def _heaps(cells: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """Return extremes over blocks of 2^k cells along each axis, each axis as a binary heap."""
    for axis in range(cells.ndim):
        values = np.moveaxis(cells, axis, 0)
        rows = [values]
        while len(rows[0]) > 1:
            rows.insert(0, extreme(rows[0][::2], rows[0][1::2]))
        rows.insert(0, values[:1])  # heaps begin at 1
        cells = np.moveaxis(np.concatenate(rows), 0, axis)
    return cells


def _heap(low: Reals, high: Reals, count: int) -> Int64[np.ndarray, " box"]:
    """Return the place in a heap of the smallest block that holds each interval."""
    width = np.maximum(high - low, 1.0)
    place: np.ndarray = ((count + np.floor(low)) / width).astype(int)
    return place


def _at_corners(nodes: np.ndarray, ends: tuple[Ends, Ends]) -> np.ndarray:
    """Return the interpolation at the corners of boxes within one cell, (corner, box)."""
    low, high = ends
    count = np.array(nodes.shape)[:, None] - 1
    cell = np.clip(np.floor(0.5 * (low + high)).astype(int), 0, count - 1)
    values = np.stack(
        [nodes[tuple(cell + np.array(corner)[:, None])] for corner in np.ndindex(*(2,) * len(cell))]
    ).reshape(*(2,) * len(cell), -1)
    for axis in range(len(cell)):
        first, last = np.moveaxis(values, axis, 0)
        parts = [first + (last - first) * (end[axis] - cell[axis]) for end in ends]
        values = np.moveaxis(np.stack(parts), 0, axis)
    corners: np.ndarray = values.reshape(2 ** len(cell), -1)
    return corners
