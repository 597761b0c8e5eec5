"""The largest root of real cubics to about eight digits, by additions and products alone.

Source: with z = y - a/3 the cubic is y^3 + P y + Q; one root has the sign of -Q, and
Newton's method approaches it monotonically from above.
"""

import jax.numpy as jnp
from jax import Array, lax

from jaxstab.point.radius.elementary import reciprocal, square_root

_THIRD_OF_BITS = 715_094_163  # x^(1/3) within 6 %, from a third of the upper bits of x
_ABOVE = 1.06
_STEPS = 5


def largest_root(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Return real and imaginary part, the latter >= 0, of z^3 + a z^2 + b z + c = 0."""
    shift = a * (1.0 / 3.0)
    linear = b - a * shift
    constant = c - b * shift + 2.0 * shift * shift * shift
    size = jnp.abs(constant)
    y = _above_cube_root(size) + square_root(jnp.maximum(-linear, 0.0))
    for _ in range(_STEPS):
        square = y * y
        y = (2.0 * y * square + size) * reciprocal(3.0 * square + linear)
    y = jnp.where(constant < 0.0, y, -y)
    single = y - shift
    # The other two are centre +- sqrt(offset).
    centre = -0.5 * y - shift
    offset = -0.75 * y * y - linear
    width = square_root(jnp.abs(offset))
    is_pair = offset < 0.0
    re = jnp.where(is_pair, centre, centre + jnp.where(centre < 0.0, -width, width))
    im = jnp.where(is_pair, width, 0.0)
    is_single = single * single > re * re + im * im
    return jnp.where(is_single, single, re), jnp.where(is_single, 0.0, im)


def _above_cube_root(x: Array) -> Array:
    upper = (lax.bitcast_convert_type(x, jnp.int64) >> 32).astype(jnp.int32)
    third = (upper.astype(jnp.float64) * (1.0 / 3.0)).astype(jnp.int32) + _THIRD_OF_BITS
    return _ABOVE * lax.bitcast_convert_type(third.astype(jnp.int64) << 32, jnp.float64)
