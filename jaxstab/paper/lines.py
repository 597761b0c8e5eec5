"""The straight lines of the plane (alpha, beta) on which a real root lies at z = 1 or z = -1."""

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, Numbers, float_arrays
from jaxstab.model import checked_gain, require_x64
from jaxstab.region.curve import (
    minus_offset,
    minus_slope,
    plus_offset,
    plus_slope,
    slice_coefficients,
)


def plus_line(
    beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers, radius: Numbers = 1.0
) -> Float64[Array, "*grid"]:
    """Return the alpha that puts a real root at z = +radius; for radius 1 it is -gamma.

    Args:
        beta, gamma, delta, delay: see ``jaxstab.conventions``.
        radius: modulus of the root in (0, 1].

    Returns:
        alpha of the broadcast shape; infinite where N(radius) = 0.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) at z = radius.

    Example:
        >>> float(jaxstab.paper.plus_line(0.5, gamma=0.001, delta=0.015, delay=0.0))
        -0.001
    """
    require_x64(beta, gamma, delta, radius)
    coefficients = slice_coefficients(gamma, delta, delay, radius)
    damping = float_arrays(checked_gain("beta", beta))[0]
    with np.errstate(all="ignore"):
        return plus_offset(coefficients) - damping * plus_slope(coefficients)


def minus_line(
    beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers, radius: Numbers = 1.0
) -> Float64[Array, "*grid"]:
    """Return the alpha that puts a real root at z = -radius.

    Args:
        beta, gamma, delta, delay: see ``jaxstab.conventions``.
        radius: modulus of the root in (0, 1].

    Returns:
        alpha of the broadcast shape; infinite where N(-radius) = 0 (delta = 0 and a whole delay).

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) at z = -radius.

    Example:
        >>> round(float(jaxstab.paper.minus_line(0.5, gamma=0.0, delta=0.015, delay=0.0)), 4)
        1599.036
    """
    require_x64(beta, gamma, delta, radius)
    coefficients = slice_coefficients(gamma, delta, delay, radius)
    damping = float_arrays(checked_gain("beta", beta))[0]
    with np.errstate(all="ignore"):
        return minus_offset(coefficients) - damping * minus_slope(coefficients)
