"""Spectral radii of any linear loops, and a bound of the error of each.

The dominant eigenvalue of the companion matrix is corrected by Newton's method with a residual in
double-double, and proved by a ladder of verdicts on p(r z) (lemmas R3 and V8 of docs/proofs.md).
"""

import operator
from functools import reduce
from math import prod
from typing import Any

import numpy as np

from jaxstab.arrays import Array, leaves, namespace, tree_map
from jaxstab.batches import compiled
from jaxstab.model import DoubleDouble
from jaxstab.model.filters import Filters
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.point.poles import companion_poles
from jaxstab.point.radius.ladder import proved_error
from jaxstab.point.verdict.dense import loop_coefficients, part_of, polynomial_codes
from jaxstab.point.verdict.linear import filtered_loops
from jaxstab.point.verdict.points import Points, gathered
from jaxstab.point.verdict.recursion import (
    FLOAT_UNIT,
    PAIR_UNIT,
    SAFETY,
    UNDERFLOW,
    Number,
    leading,
    size,
)

_NEWTON_STEPS = 2
_LIST = 1 << 11  # points at once

Values = np.ndarray[Any, np.dtype[Any]]


def linear_radius(alpha: Values, beta: Values, loop: LinearLoop) -> tuple[Values, Values]:
    """Return the spectral radii of walls of one loop and bounds of their errors.

    Args:
        alpha: float64, any shape; it broadcasts with beta and with the loop.
        beta: likewise.
        loop: what base + alpha stiffness + beta damping is.

    Returns:
        Radii and bounds, which are infinite where none holds.
    """
    shape = np.broadcast_shapes(*(np.shape(leaf) for leaf in leaves((alpha, beta, loop))))
    every = np.arange(prod(shape))
    value, error = _listed_radii((alpha, beta, loop), shape, every)
    return value.reshape(shape), error.reshape(shape)


def filtered_radius(points: Points, filters: Filters) -> tuple[Values, Values]:
    """Return the spectral radii of points and bounds of their errors, infinite where none holds."""
    value, error = np.zeros(points.shape), np.full(points.shape, np.inf)
    for form, indices in points.groups(np.full(points.shape, True)):
        walls = points.alpha, points.beta, filtered_loops(points, form, filters)
        value.flat[indices], error.flat[indices] = _listed_radii(walls, points.shape, indices)
    return value, error


def _listed_radii(
    walls: tuple[Values, Values, LinearLoop], shape: tuple[int, ...], indices: Values
) -> tuple[Values, Values]:
    """Return radii and bounds at flat indices of a grid."""
    value, error = np.zeros(indices.size), np.full(indices.size, np.inf)
    for start in range(0, indices.size, _LIST):
        part = slice(start, start + _LIST)
        alpha, beta, loops = gathered(walls, shape, indices[part])
        gains = DoubleDouble.of(alpha), DoubleDouble.of(beta)
        with np.errstate(all="ignore"):
            coefficients, lost = loop_coefficients(*gains, loops, PAIR_UNIT)
            value[part] = _dominant_modulus(coefficients)
            error[part] = dense_radius_error(coefficients, lost, value[part], unit=PAIR_UNIT)
    return value, error


def traced_radius_error(coefficients: Array, radius: Array) -> Array:
    """Return bounds of the errors of radii in float64, for coefficients of (*grid, coefficient)."""
    xp = namespace(coefficients, radius)
    lost = 2.0 * FLOAT_UNIT * xp.sum(abs(coefficients), axis=-1)
    return dense_radius_error(xp.moveaxis(coefficients, -1, 0), lost, radius, unit=FLOAT_UNIT)


def _dominant_modulus(coefficients: DoubleDouble) -> Values:
    rounded = coefficients.rounded()
    z = companion_poles(np.moveaxis(rounded, 0, -1))[..., 0]
    for _ in range(_NEWTON_STEPS):
        slope = np.polyval(rounded[:-1] * np.arange(len(rounded) - 1, 0, -1)[:, None], z)
        moved = z - _value(coefficients, z) / slope
        z = np.where(np.isfinite(moved), moved, z)
    return np.abs(z)


def _value(coefficients: DoubleDouble, z: Values) -> Values:
    """Return p(z), by division by the real quadratic of z and its conjugate, in pairs."""
    total = DoubleDouble.of(2.0 * z.real)
    square = DoubleDouble.of(z.real) * z.real + DoubleDouble.of(z.imag) * z.imag
    zero = total - total
    before, last = zero, zero
    for column in _columns(coefficients):
        before, last = last, column + (total * last - square * before)
    # The remainder is ``before`` (z - total) + ``last``, and z - total is minus the conjugate.
    real = last - before * z.real
    return real.rounded() + 1j * (before * z.imag).rounded()


def _columns(coefficients: DoubleDouble) -> list[DoubleDouble]:
    pairs = zip(coefficients.hi, coefficients.lo, strict=True)
    return [DoubleDouble(hi, lo) for hi, lo in pairs]


@compiled(static=["unit"])
def dense_radius_error(coefficients: Number, error: Array, radius: Array, *, unit: float) -> Array:
    """Prove how far spectral radii can be from the true ones; infinite where 2^-6 of them is more.

    Args:
        coefficients: of monic polynomials, on the first axis, highest power first.
        error: bound of the sum of their errors.
        radius: the estimate, > 0.
        unit: roundoff of the coefficients' numbers.
    """
    xp = namespace(coefficients, error, radius)
    both = tree_map(lambda values: xp.stack([values, values], axis=1), coefficients)
    return proved_error(lambda scale: scaled_codes(both, error, scale, unit), radius)


def scaled_codes(coefficients: Number, error: Array, scale: Array, unit: float) -> Array:
    """Return the codes of p(scale z) / scale^n; see ``dense_radius_error`` for the arguments."""
    xp = namespace(coefficients, error, scale)
    columns = [part_of(coefficients, index) for index in range(len(leading(coefficients)))]
    inverse, power = columns[0] / scale, columns[0]  # the first coefficient is 1
    scaled: list[Number] = []
    for column in columns:
        scaled.append(column * power)
        power = power * inverse
    signed = [-value if index % 2 else value for index, value in enumerate(scaled)]
    sizes = sum(map(size, scaled))
    degree = len(columns) - 1
    lost = SAFETY * error * xp.maximum(1.0, size(inverse) ** degree)
    lost = lost + (2 * degree + 6) * unit * sizes + UNDERFLOW
    ends = [
        (leading(reduce(operator.add, terms)), lost + degree * unit * sizes)
        for terms in (scaled, signed)
    ]
    return polynomial_codes(tree_map(lambda *c: xp.stack(c), *scaled), lost, ends, unit, degree)
