"""Loops of a held device over boxes of a guard: in cells of its grid (lemma B20)."""

import numpy as np

from jaxstab.boxes.device_boxes import DAMPING, DELAY, MASS, DeviceBoxes, Extent, along
from jaxstab.boxes.models import LinearModel
from jaxstab.boxes.parted import AXES, Boxes
from jaxstab.guard.grid import Grid, Models, Pyramid, step_of
from jaxstab.model import Device, LoopParameters
from jaxstab.ranges import HandRange

_ROUNDED_UP = 1.0 + 1e-9


def grid_boxes(device: Device, loop: LoopParameters, hands: HandRange, grid: Grid) -> DeviceBoxes:
    """Return the loops of boxes in cells of a grid, whose walls are those up to its limits.

    Raises:
        NotImplementedError: as ``DeviceBoxes``.
    """
    pyramid = Pyramid(grid)

    def extent(center: Boxes, half: Boxes) -> Extent:
        low, high = (center - half)[:3], (center + half)[:3]
        mass, delay = (
            along(axis, nodes[0] + center[axis] * step, half[axis] * step * _ROUNDED_UP)
            for axis, nodes in ((MASS, grid.mass), (DELAY, grid.delay))
            for step in [step_of(nodes)]
        )
        count = grid.cells[2]
        share = along(DAMPING, center[DAMPING] / count, half[DAMPING] / count)
        top = _model(pyramid.tops(low[:2], high[:2]))
        return Extent(mass, delay, _model(pyramid.limits(low, high)), share * top)

    mass = float(grid.mass[0]), float(grid.mass[-1])
    arm = hands.stiffness[1], hands.damping[0]
    return DeviceBoxes(device, loop, mass, arm, extent, from_none=True)


def _model(bounds: Models) -> LinearModel:
    slope = np.zeros((AXES, bounds.centre.size))
    slope[: len(bounds.moves)] = bounds.moves
    return LinearModel(bounds.centre, slope, bounds.rest, np.ones((AXES, 1)))
