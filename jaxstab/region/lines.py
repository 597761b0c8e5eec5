"""The lines of a real root at z = r and z = -r: margins to them, directions, where they cross."""

import numpy as np

from jaxstab.arrays import Array, namespace
from jaxstab.region.curve import (
    SliceCoefficients,
    minus_offset,
    minus_slope,
    parity,
    plus_offset,
    plus_slope,
)


def minus_margin(c: SliceCoefficients, alpha: Array, beta: Array) -> Array:
    """Return p(-r) / r^2 with the sign chosen so that it is positive inside the stable set."""
    if c.filtered is not None:
        base, stiffness, damping = c.filtered.at_minus_one
        return base + (stiffness * alpha + damping * beta)
    return c.gain * c.den_minus + parity(c) * c.num_minus * (alpha + minus_slope(c) * beta)


def lines_crossing(c: SliceCoefficients) -> tuple[Array, Array]:
    """Return (alpha, beta) where the lines of a real root at r and at -r cross."""
    if c.filtered is not None:
        damping, alpha = c.filtered.at_minus_one[2], plus_offset(c)
        with np.errstate(all="ignore"):  # an estimator may make them parallel
            return alpha, -minus_margin(c, alpha, np.float64(0.0)) / damping
    beta = (minus_offset(c) - plus_offset(c)) / (minus_slope(c) - plus_slope(c))
    return plus_offset(c) - plus_slope(c) * beta, beta


def along_lines(c: SliceCoefficients, alpha: Array, beta: Array) -> tuple[Array, Array]:
    """Return coordinates along the lines z = r and z = -r, with the stable set on the left."""
    xp = namespace(c, beta)
    plus = -xp.sign(c.num_plus) * beta
    if c.filtered is not None and c.filtered.at_minus_one[1] == 0.0:  # a line of constant beta
        return plus, np.sign(c.filtered.at_minus_one[2]) * alpha
    return plus, -xp.sign(parity(c) * c.num_minus) * beta


def lines_turn(c: SliceCoefficients) -> Array:
    """Return a sign: 1 where the boundary turns from the line z = r into the line z = -r.

    It is -1 where it turns from z = -r into z = r, and 0 where they are parallel.
    """
    xp = namespace(c)
    slanted = parity(c) * c.num_minus if c.filtered is None else c.filtered.at_minus_one[2]
    return xp.sign(c.num_plus) * xp.sign(slanted)
