"""Are all roots inside of the circle at a wall of the boundary, told in double-double? NumPy only.

Slow modes have roots next to each other near z = 1; float64 coefficients of p(z) do not tell where
those are. The coefficients in pairs do, by the verdict on p(r z), with r so much larger than 1 that
the roots that the wall puts on the circle count as inside.
"""

import numpy as np
from jaxtyping import Bool

from jaxstab.arrays import Array
from jaxstab.conventions import STABLE
from jaxstab.model.double_double import DoubleDouble
from jaxstab.point.radius.dense import scaled_codes
from jaxstab.point.verdict.recursion import PAIR_UNIT
from jaxstab.region.filtered_curve import FilteredCurve

_ON_CIRCLE = 1e-11  # a root so close is on the circle: a wall in float64 shifts it by less
_AT_ONCE = 1 << 11  # walls
_OPERATIONS = 4.0  # roundings of a coefficient


def all_inside(
    curve: FilteredCurve, alpha: Array, beta: Array, within: float
) -> Bool[np.ndarray, "*wall"]:
    """Return where all roots of p(z) lie within a circle, those on the unit circle as well."""
    inside = np.zeros(np.shape(alpha), bool)
    walls = np.ravel(alpha), np.ravel(beta)
    for start in range(0, inside.size, _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        inside.flat[part] = _are_inside(curve, walls[0][part], walls[1][part], within)
    return inside


def _are_inside(
    curve: FilteredCurve, alpha: Array, beta: Array, within: float
) -> Bool[np.ndarray, " _"]:
    base, stiffness, damping = (
        DoubleDouble(*part[:, :, None]) for part in curve.pairs.transpose(1, 0, 2)
    )
    products = stiffness * DoubleDouble.of(alpha), damping * DoubleDouble.of(beta)
    coefficients = base + (products[0] + products[1])
    sizes = np.sum(abs(base.hi) + abs(products[0].hi) + abs(products[1].hi), axis=0)
    scale = np.full(alpha.shape, within * (1.0 + _ON_CIRCLE))
    codes = scaled_codes(coefficients, _OPERATIONS * PAIR_UNIT * sizes, scale, PAIR_UNIT)
    inside: Bool[np.ndarray, " _"] = codes == STABLE
    return inside
