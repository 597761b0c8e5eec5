"""Loops of a held device over boxes of a guard: in cells of its grid (lemma B20)."""

import numpy as np
from jaxtyping import Bool

from jaxstab.guard.grid import Grid, Models, limits_over, step_of, tops_over
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

_ROUNDED_UP = 1.0 + 1e-9


def grid_boxes(device: Device, loop: LoopParameters, hands: HandRange, grid: Grid) -> DeviceBoxes:
    """Return the loops of boxes, each in a cell of a grid, whose walls are those up to its limits.

    Raises:
        NotImplementedError: as ``DeviceBoxes``.
    """
    count = grid.cells[2]
    corners = grid.limit[:, :, 0]
    begins = np.maximum.reduce(
        [corners[:-1, :-1], corners[1:, :-1], corners[:-1, 1:], corners[1:, 1:]]
    )

    def limits(center: Boxes, half: Boxes) -> tuple[LinearModel, LinearModel]:
        low, high = (center - half)[:3], (center + half)[:3]
        return _model(limits_over(grid, low, high)), _model(tops_over(grid, low[:2], high[:2]))

    def extent(center: Boxes, half: Boxes) -> Extent:
        mass, delay = (
            along(axis, nodes[0] + center[axis] * step, half[axis] * step * _ROUNDED_UP)
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
    return DeviceBoxes(device, loop, mass, arm, extent, FirstRow(is_first, whole_walls))


def _model(bounds: Models) -> LinearModel:
    slope = np.zeros((AXES, bounds.centre.size))
    slope[: len(bounds.moves)] = bounds.moves
    return LinearModel(bounds.centre, slope, bounds.rest, np.ones((AXES, 1)))
