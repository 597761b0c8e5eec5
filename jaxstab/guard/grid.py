"""The grid of a guard: limits at its nodes, and its loops over boxes in cells."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.model import Device, LoopParameters
from jaxstab.proofs.device_boxes import (
    AXES,
    DAMPING,
    DELAY,
    MASS,
    Boxes,
    DeviceBoxes,
    Extent,
    FirstRow,
    along,
)
from jaxstab.proofs.enclosures import LinearModel
from jaxstab.ranges import HandRange
from jaxstab.rounding import RAISED_MUCH

Ends = Float64[np.ndarray, "axis box"]  # in cells

_SLACK = 1e-9  # of the largest value: more than the arithmetic of the header rounds


class Grid(NamedTuple):
    """Limits at nodes, between which a guard interpolates linearly in mass, delay and damping.

    The nodes of mass in kg and of delay in samples are evenly spaced. ``top`` is the largest
    damping in N s/m, ``limit`` the largest stiffness in N/m at evenly spaced dampings from 0 to
    that one. Where the delay moves, both nodes of the delay are the shortest one, and ``jitter`` is
    by how many samples a delay may be longer.
    """

    mass: Float64[np.ndarray, " mass"]
    delay: Float64[np.ndarray, " delay"]
    top: Float64[np.ndarray, "mass delay"]
    limit: Float64[np.ndarray, "mass delay damping"]
    jitter: float = 0.0

    @property
    def cells(self) -> tuple[int, int, int]:
        """How many cells there are along mass, delay and damping."""
        masses, delays, dampings = (size - 1 for size in self.limit.shape)
        return masses, delays, dampings


def grid_boxes(device: Device, loop: LoopParameters, hands: HandRange, grid: Grid) -> DeviceBoxes:
    """The loops of boxes, each in a cell of a grid, whose walls are those up to its limits.

    The first three axes are in cells; lemma B20 of docs/proofs.md. Errors: as ``DeviceBoxes``.
    """
    count = grid.cells[2]
    corners = grid.limit[:, :, 0]
    begins = np.max(
        [corners[:-1, :-1], corners[1:, :-1], corners[:-1, 1:], corners[1:, 1:]], axis=0
    )

    def limits(center: Boxes, half: Boxes) -> tuple[LinearModel, LinearModel]:
        low, high = (center - half)[:3], (center + half)[:3]
        top = _model(grid.top, low[:2], high[:2])
        return _limits_over(grid, low, high), replace(top, rest=top.rest + _SLACK * top.centre)

    def extent(center: Boxes, half: Boxes) -> Extent:
        mass, delay = (
            along(axis, nodes[0] + center[axis] * step, half[axis] * step * RAISED_MUCH)
            for axis, nodes in ((MASS, grid.mass), (DELAY, grid.delay))
            for step in [step_of(nodes)]
        )
        share = along(DAMPING, center[DAMPING] / count, half[DAMPING] / count)
        limit, top = limits(center, half)
        return Extent(mass, delay, limit, share * top)

    def is_first(center: Boxes) -> Bool[np.ndarray, " box"]:
        column = tuple(np.floor(center[:2]).astype(int))
        is_at_0: Bool[np.ndarray, " box"] = (center[DAMPING] < 1.0) & (begins[column] == 0.0)
        return is_at_0

    def whole_walls(center: Boxes, half: Boxes) -> tuple[LinearModel, LinearModel]:
        end, none = center.copy(), half.copy()
        end[DAMPING], none[DAMPING] = 1.0, 0.0
        limit, top = limits(end, none)
        return limit, top * (1.0 / count)

    mass = float(grid.mass[0]), float(grid.mass[-1])
    arm = hands.stiffness[1], hands.damping[0]
    first_row = FirstRow(is_first, whole_walls)
    return DeviceBoxes(device, loop, mass, arm, extent, first_row, grid.jitter)


def _limits_over(grid: Grid, low: Ends, high: Ends) -> LinearModel:
    """Bound the limit from above, by models without a rest, over boxes within a cell."""
    model = _model(grid.limit, low, high)
    slack = _SLACK * float(np.max(grid.limit))
    return replace(model, centre=model.centre + model.rest + slack, rest=np.zeros_like(model.rest))


def step_of(nodes: Float64[np.ndarray, " node"]) -> float:
    """Return the step of evenly spaced nodes."""
    return float(nodes[-1] - nodes[0]) / (len(nodes) - 1)


def interpolated(nodes: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return values between nodes at places in cells, (axis, place)."""
    return _at_corners(nodes, (index, index))[0]


def _model(nodes: np.ndarray, low: np.ndarray, high: np.ndarray) -> LinearModel:
    """Return the model of the interpolation over boxes within one cell."""
    corners = _at_corners(nodes, (low, high))
    signs = np.indices((2,) * len(low)).reshape(len(low), -1) * 2.0 - 1.0
    moves = signs @ corners / corners.shape[0]
    centre = corners.mean(axis=0)
    # Linear in each variable, it is farthest from its model at a corner.
    error = np.max(np.abs(corners - centre - signs.T @ moves), axis=0)
    slope = np.zeros((AXES, centre.size))
    slope[: len(moves)] = moves
    return LinearModel(centre, slope, error, np.ones((AXES, 1)))


def _at_corners(nodes: np.ndarray, ends: tuple[Ends, Ends]) -> np.ndarray:
    """Return the interpolation at the corners of boxes within one cell, (corner, box)."""
    low, high = ends
    count = np.array(nodes.shape)[:, None] - 1
    cell = np.clip(np.floor(0.5 * (low + high)).astype(int), 0, count - 1)
    values = np.stack(
        [nodes[tuple(cell + np.array(corner)[:, None])] for corner in np.ndindex(*(2,) * len(cell))]
    ).reshape(*(2,) * len(cell), -1)
    for axis in range(len(cell)):
        lower, upper = np.moveaxis(values, axis, 0)
        parts = [lower + (upper - lower) * (end[axis] - cell[axis]) for end in ends]
        values = np.moveaxis(np.stack(parts), 0, axis)
    corners: np.ndarray = values.reshape(2 ** len(cell), -1)
    return corners
