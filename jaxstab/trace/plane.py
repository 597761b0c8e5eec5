"""Planes of two quantities: how the five dimensionless parameters follow from them (Table I).

Each parameter is a monomial of the physical quantities, so it is monotone along each axis of a
plane, and its range over a box is known from the corners.
"""

from collections.abc import Mapping
from math import inf
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.conventions import AXES
from jaxstab.model import LoopParameters
from jaxstab.numbers import checked_number

PHYSICAL = {  # Table I: powers of the quantities in each parameter
    "stiffness": {"alpha": 1},
    "damping": {"beta": 1},
    "mass": {"alpha": -1, "beta": -1, "gamma": -1, "delta": -1},
    "sample_time": {"alpha": 2, "beta": 1, "gamma": 2, "delta": 1, "delay": -1},
    "physical_stiffness": {"gamma": 1},
    "physical_damping": {"delta": 1},
    "time_delay": {"delay": 1},
}
DIMENSIONLESS = {name: {name: 1} for name in AXES}
SIGNED = {"alpha", "beta", "stiffness", "damping"}  # all others are >= 0
POSITIVE = {"mass", "sample_time"}

Window = tuple[tuple[float, float], tuple[float, float]]


class Monomials(NamedTuple):
    """The five parameters factor x^i y^j over a window."""

    factor: Float64[np.ndarray, " 5"]
    powers: Float64[np.ndarray, "5 2"]  # -1, 0, 1 or 2
    lower: Float64[np.ndarray, " 2"]
    width: Float64[np.ndarray, " 2"]

    def parameters(
        self, position: Float64[np.ndarray, "*points 2"]
    ) -> Float64[np.ndarray, "5 *points"]:
        """Return the parameters at positions (..., 2) in the window's unit square: (5, ...)."""
        x, y = np.moveaxis(self.lower + self.width * position, -1, 0)
        table = np.column_stack([self.factor, self.powers]).T
        factor, of_x, of_y = table.reshape(3, -1, *[1] * x.ndim)
        return np.asarray(factor * x**of_x * y**of_y)


def monomials(plane: tuple[str, str], window: Window, fixed: Mapping[str, float]) -> Monomials:
    """Return the map from a plane to the parameters.

    Raises:
        ValueError: unknown, missing or doubled names, values outside their range, an empty window.
    """
    _check_names(plane, fixed)
    table = _table(plane)
    for name, value in fixed.items():
        _check_value(name, value)
    for name, (lower, upper) in zip(plane, window, strict=True):
        _check_value(name, lower)
        _check_value(name, upper)
        if not lower < upper:
            raise ValueError(
                f"the window of {name} is ({lower}, {upper}); give a lower and a larger upper end."
            )
    powers = np.array([[table[name].get(axis, 0) for name in plane] for axis in AXES], np.float64)
    factor = np.array(
        [
            np.prod([value ** table[name].get(axis, 0) for name, value in fixed.items()])
            * any(axis in table[name] for name in (*plane, *fixed) if name not in POSITIVE)
            for axis in AXES
        ]
    )
    lower, upper = np.array(window, np.float64).T
    return Monomials(factor, powers, lower, upper - lower)


def _table(plane: tuple[str, str]) -> dict[str, dict[str, int]]:
    return DIMENSIONLESS if set(plane) <= set(DIMENSIONLESS) else PHYSICAL


def loop_quantities(loop: LoopParameters) -> dict[str, float]:
    """Return the physical quantities of a loop under the names used here."""
    return {
        "mass": loop.mass,
        "sample_time": loop.sample_time,
        "physical_stiffness": loop.hand_stiffness,
        "physical_damping": loop.device_damping + loop.hand_damping,
        "time_delay": loop.delay,
    }


def _check_names(plane: tuple[str, str], fixed: Mapping[str, float]) -> None:
    names = [*plane, *fixed]
    table = _table(plane)
    unknown = [name for name in names if name not in DIMENSIONLESS and name not in PHYSICAL]
    unknown += [name for name in names if name not in table]
    if unknown:
        raise ValueError(
            f"{unknown[0]!r} is no quantity of this plane; give names all of "
            f"{', '.join(DIMENSIONLESS)}, or all of {', '.join(PHYSICAL)}."
        )
    doubled = [name for name in names if names.count(name) > 1]
    if doubled:
        raise ValueError(f"{doubled[0]} is given twice; an axis of the plane has no fixed value.")
    missing = [name for name in table if name not in names]
    if missing:
        raise ValueError(f"{missing[0]} has no value; fix every quantity beside the two axes.")


def _check_value(name: str, value: float) -> None:
    least = -inf if name in SIGNED else 0.0
    checked_number(name, value, least, is_open=name in POSITIVE)


def corner_ranges(
    plane: Monomials, center: Float64[np.ndarray, "boxes 2"], half: Float64[np.ndarray, "boxes 2"]
) -> tuple[
    Float64[np.ndarray, "5 boxes"], Float64[np.ndarray, "5 boxes"], Float64[np.ndarray, "2 5 boxes"]
]:
    """Return the parameters at the centers of boxes, radii that cover them, and those by axis."""

    def parameters(x_side: int, y_side: int) -> Float64[np.ndarray, "5 boxes"]:
        values: Float64[np.ndarray, "5 boxes"]
        values = plane.parameters(center + half * np.array([x_side, y_side]))
        return values

    middle = parameters(0, 0)
    corners = np.stack([parameters(x, y) for x in (-1, 1) for y in (-1, 1)])
    along_x = np.maximum(np.abs(parameters(-1, 0) - middle), np.abs(parameters(1, 0) - middle))
    along_y = np.maximum(np.abs(parameters(0, -1) - middle), np.abs(parameters(0, 1) - middle))
    radius = np.max(np.abs(corners - middle), axis=0) * (1 + 1e-12)
    return middle, radius, np.stack([along_x, along_y])
