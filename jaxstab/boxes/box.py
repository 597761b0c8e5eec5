"""Boxes of loops: center +- half along named axes, and the models of what is an axis.

An axis is one quantity that varies: a mass, a stiffness or a damping of device or hand, the delay,
the way along an edge of walls, and always theta, the angle of a root on the unit circle. What does
not vary is no axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.boxes.enclosures import LinearModel, variable
from jaxstab.rounding import PARAMETER, RAISED_MUCH

HAND = "hand_mass", "hand_stiffness", "hand_damping"
THETA = "theta"

Rows = Float64[np.ndarray, "axis box"]
Row = Float64[np.ndarray, " box"]


@dataclass(frozen=True)
class ParameterBoxes:
    """Boxes along named axes; ``index`` is, for example, the number of the wall or cell of each."""

    axes: tuple[str, ...]
    center: Rows
    half: Rows
    index: Int64[np.ndarray, " box"]

    @classmethod
    def between(cls, index: Int64[np.ndarray, " box"], **ends: tuple[Any, Any]) -> "ParameterBoxes":
        """One box for each index, from the ends along each named axis.

        Numbers that are the same at both ends are no axes; arrays are, whatever they hold.
        """
        axes = {
            name: (low, high)
            for name, (low, high) in ends.items()
            if np.ndim(low) or np.ndim(high) or low < high
        }
        low, high = (
            np.stack([np.broadcast_to(np.float64(pair[k]), index.shape) for pair in axes.values()])
            for k in (0, 1)
        )
        half = 0.5 * (high - low)
        return cls(tuple(axes), low + half, half, index)

    def ends(self, name: str) -> tuple[Row, Row]:
        """The middles and the half-widths along an axis."""
        row = self.axes.index(name)
        return self.center[row], self.half[row]

    def middles(self, name: str, low: float, high: float) -> Row:
        """The middles of a quantity between two ends, also of one that is no axis."""
        if name in self.axes:
            return np.clip(self.ends(name)[0], low, high)
        return np.full(self.index.size, low)

    def select(self, chosen: Any) -> "ParameterBoxes":
        """Chosen boxes: an index of numbers, of truth values, or a slice."""
        parts = self.center[:, chosen], self.half[:, chosen], self.index[chosen]
        return ParameterBoxes(self.axes, *parts)

    def halved(self, axis: Int64[np.ndarray, " box"]) -> "ParameterBoxes":
        """The halves of each box along one of its axes, given by number."""
        boxes = np.arange(self.index.size)
        half, shift = self.half.copy(), np.zeros_like(self.half)
        half[axis, boxes] *= 0.5
        shift[axis, boxes] = half[axis, boxes]
        sides = [replace(self, center=self.center + side, half=half) for side in (-shift, shift)]
        return joined(sides)

    def along(self, name: str, unit: float = 1.0, start: float = 0.0) -> LinearModel:
        """A quantity that is an axis, counted from a start in steps of a unit."""
        center, half = self.ends(name)
        middle = start + center * unit
        exact = variable(self.axes.index(name), len(self.axes), middle, half * unit * RAISED_MUCH)
        return replace(exact, rest=PARAMETER * (np.abs(middle) + abs(start)))

    def constant(self, value: Any) -> LinearModel:
        """A number, or one for each box, that was converted between units."""
        centre = np.broadcast_to(np.asarray(value), self.index.shape)
        slope = np.zeros((len(self.axes), centre.size))
        return LinearModel(centre, slope, PARAMETER * np.abs(centre))

    def quantity(self, name: str, value: float, unit: float = 1.0) -> LinearModel:
        """A quantity in units of the plant: along its axis, or the number that it always is."""
        return self.along(name, unit) if name in self.axes else self.constant(value * unit)


def joined(parts: Sequence[ParameterBoxes]) -> ParameterBoxes:
    """The boxes of one, then of the next, all with the same axes."""
    columns = zip(*((boxes.center, boxes.half, boxes.index) for boxes in parts), strict=True)
    return ParameterBoxes(parts[0].axes, *(np.concatenate(column, axis=-1) for column in columns))
