"""Lookups of spectral radii: a few functions of a cell bound the radius of a point. NumPy alone.

A cell is one along alpha, beta, gamma, delta and delay (``schema.RADIUS_KIND``).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format import schema
from jaxstab.atlas.read.parts import in_parts
from jaxstab.atlas.read.surfaces import radius_bounds

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]

_VARIABLES = 5
_FIRST, _SECOND = np.triu_indices(_VARIABLES)


class RadiusTable:
    """Spectral radii of an atlas at any point.

    Args:
        arrays: of the atlas.
    """

    def __init__(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        kinds, terms = arrays[schema.RADIUS_KIND], arrays[schema.RADIUS_TERMS]
        self._counts = kinds.shape
        self._kinds = np.moveaxis(kinds, -1, 0).reshape(-1).astype(np.int8)
        functions = np.array(schema.RADIUS_FUNCTIONS)[self._kinds]
        self._rows = np.cumsum(functions, dtype=np.int64) - functions
        self._terms = np.ascontiguousarray(terms.T)
        self._ends = arrays[schema.RADIUS_RANGE]
        hands = (arrays[name] for name in ("gamma", "delta"))
        self._hands = [(float(nodes[0]), float(nodes[-1])) for nodes in hands]

    def bounds(self, points: list[Floats]) -> tuple[Floats, Floats]:
        """Return the lowest and the highest radius of points; 0 and infinity where none is known.

        Args:
            points: alpha, beta, gamma, delta and delay of each, inside of gamma and delta.
        """
        low, high = in_parts(self._bounds, points, float, float)
        return low, high

    def _bounds(self, *points: Floats) -> tuple[Floats, Floats]:
        number = np.searchsorted(self._ends[:, 0], points[-1], side="right") - 1
        ends = self._ends[number].T
        inside = points[-1] <= ends[1]
        cell = number
        beside = np.empty((_VARIABLES, number.size))
        for axis, values in enumerate(points[:-1]):
            walls = ends[2 + 2 * axis : 4 + 2 * axis]
            lowest, highest = walls if axis < 2 else self._hands[axis - 2]
            inside &= (values >= lowest) & (values <= highest)
            count = self._counts[axis]
            width = np.asarray((highest - lowest) / count)
            with np.errstate(all="ignore"):
                part = np.where(width > 0.0, (values - lowest) / width, 0.5)
            along = np.clip(np.nan_to_num(part), 0, count - 1).astype(np.intp)
            beside[axis] = 2.0 * (part - along) - 1.0
            cell = cell * count + along
        middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
        beside[-1] = (points[-1] - middle) / np.where(half > 0.0, half, 1.0)
        beside[:, ~inside] = 0.0  # what is far outside would overflow
        low, high = self._of_cells(cell, beside)
        return np.where(inside, low, 0.0), np.where(inside, high, np.inf)

    def _of_cells(self, cell: Integers, beside: Floats) -> tuple[Floats, Floats]:
        kind, first = self._kinds[cell], self._rows[cell]
        functions = np.array(schema.RADIUS_FUNCTIONS)[kind]
        powers = np.concatenate(
            [np.ones((1, cell.size)), beside, beside[_FIRST] * beside[_SECOND]]
        ).T
        values, errors = np.zeros((3, cell.size)), np.zeros((2, cell.size))
        for number in range(3):
            has = np.flatnonzero(functions > number)
            terms = self._terms[first[has] + number]
            values[number, has] = np.einsum("pt,pt->p", terms[:, :-1], powers[has])
            if number < 2:
                errors[number, has] = terms[:, -1]
        return radius_bounds(kind, values, errors)
