"""The grid of a guard: limits at its nodes, and their largest and smallest values over boxes."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

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
    """Functions over boxes: centres, moves along the axes, and bounds of what these leave."""

    centre: Reals
    moves: Float64[np.ndarray, "axis box"]
    rest: Reals


def limits_over(grid: Grid, low: Ends, high: Ends) -> Models:
    """Bound the limit from above, by models without a rest, over boxes within a cell."""
    known = _model(grid.limit, low, high)
    slack = _SLACK * float(np.max(grid.limit))
    return Models(known.centre + known.rest + slack, known.moves, np.zeros_like(known.rest))


def tops_over(grid: Grid, low: Ends, high: Ends) -> Models:
    """Enclose the largest damping over boxes of mass and delay within a cell."""
    known = _model(grid.top, low, high)
    return known._replace(rest=known.rest + _SLACK * known.centre)


def step_of(nodes: Float64[np.ndarray, " node"]) -> float:
    """Return the step of evenly spaced nodes."""
    return float(nodes[-1] - nodes[0]) / (len(nodes) - 1)


def interpolated(nodes: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return values between nodes at places in cells, (axis, place)."""
    return _at_corners(nodes, (index, index))[0]


def _model(nodes: np.ndarray, low: np.ndarray, high: np.ndarray) -> Models:
    """Return the model of the interpolation over boxes within one cell."""
    corners = _at_corners(nodes, (low, high))
    signs = np.indices((2,) * len(low)).reshape(len(low), -1) * 2.0 - 1.0
    moves = signs @ corners / corners.shape[0]
    centre = corners.mean(axis=0)
    # Linear in each variable, it is farthest from its model at a corner.
    rest = np.max(np.abs(corners - centre - signs.T @ moves), axis=0)
    return Models(centre, moves, rest)


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
