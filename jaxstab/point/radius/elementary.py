"""Reciprocals, roots and powers of two that XLA fuses with the arithmetic around them.

XLA does not fuse divisions and square roots whose results are used more than once. There they start
from the bits of the number and are refined by Newton's method; NumPy divides.
"""

import numpy as np

from jaxstab.arrays import Array, is_jax

_EXPONENT = 0x7FF0_0000_0000_0000
_LARGEST_EXPONENT = 0x7FE0_0000_0000_0000
_RECIPROCAL = 0x7FDE_6238_22FC_16E6  # minus the bits of x: 1/x within 13 %
_INVERSE_ROOT = 0x5FE6_EB50_C7B5_37A9  # minus half the bits of x: 1/sqrt(x) within 4 %


def reciprocal(x: Array) -> Array:
    """Return 1/x for x > 0 to eight digits."""
    if not is_jax(x):
        return 1.0 / x
    y = _floats(_RECIPROCAL - _bits(x))
    for _ in range(3):
        y = y * (2.0 - x * y)
    return y


def square_root(x: Array) -> Array:
    """Return the root of x >= 0 to eight digits."""
    if not is_jax(x):
        return np.sqrt(x)
    y = _floats(_INVERSE_ROOT - (_bits(x) >> 1))
    for _ in range(3):
        y = y * (1.5 - 0.5 * x * y * y)
    return x * y


def power_of_two_below_inverse(x: Array) -> Array:
    """Return the power of two that brings x > 0 to [1, 2)."""
    return _floats(_LARGEST_EXPONENT - (_bits(x) & _EXPONENT))


def _bits(x: Array) -> Array:
    if is_jax(x):
        from jax import lax

        return lax.bitcast_convert_type(x, np.int64)
    return np.asarray(x, np.float64).view(np.int64)


def _floats(bits: Array) -> Array:
    if is_jax(bits):
        from jax import lax

        return lax.bitcast_convert_type(bits, np.float64)
    return np.asarray(bits, np.int64).view(np.float64)
