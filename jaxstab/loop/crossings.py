"""Where a root crosses the circle, under JAX: by the implicit function theorem.

Unknowns that solve equations move with the numbers of the loop as the equations say. A margin ends
at one root on the circle, at the wall and the angle where p(z) = 0.
"""

from collections.abc import Callable
from functools import lru_cache
from math import pi
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float64, Int64

from jaxstab.arrays import solved
from jaxstab.model.filters import Filters
from jaxstab.region.closed_form import Responses, circle_equations


def grown(equations: Callable[..., Array], start: Array, numbers: Any) -> Array:
    """Unknowns that move so that they solve the equations, by the implicit function theorem."""
    slopes = jax.jacfwd(equations)(start, jax.lax.stop_gradient(numbers))
    return -solved(slopes, equations(start, numbers)[:, None])[:, 0]


def moving_ends(
    point: Float64[Array, "*grid 5"],
    ends: Float64[Array, "*grid way"],
    angles: Float64[Array, "*grid way"],
    axes: Int64[np.ndarray, " way"],
    filters: Filters | None = None,
) -> Float64[Array, "*grid way"]:
    """The ends of all ways from points, each along an axis, with their derivatives by these."""
    return _moving(ends, _moved_ends(filters)(point[..., None, :], ends, angles, axes))


@jax.custom_jvp
def _moving(value: Array, moved: Array) -> Array:
    """A value with the derivatives of another one, which may be NaN."""
    del moved
    return value


_moving.defjvp(lambda values, moves: (values[0], moves[1]))


@lru_cache(maxsize=16)
def _moved_ends(filters: Filters | None) -> Callable[..., Array]:
    """A function that moves as the end of a way does, by p(z) = 0 at the crossing."""
    nearly_real = 2.0**-29  # of pi: a root this near to the real axis is taken for real
    responses = Responses.from_filters(filters)

    def moved(point: Array, end: Array, angle: Array, axis: Array) -> Array:
        here = jnp.where(axis < 2, point[axis], 0.0)  # of a delay the end is how much longer it is
        nearest = jnp.round(angle)
        is_real = jnp.abs(angle - nearest) < nearly_real
        start = pi * jnp.where(is_real, nearest, angle)

        def equations(crossing: Array, point: Array) -> Array:
            alpha, beta, *plant = point.at[axis].add(crossing[0])
            real, imaginary = circle_equations(plant, alpha, beta, crossing[1], responses)
            return jnp.stack([real, jnp.where(is_real, crossing[1] - start, imaginary)])

        crossing = jnp.stack([end - jax.lax.stop_gradient(here), start])
        return here + grown(equations, crossing, point)[0]

    return jax.jit(jnp.vectorize(moved, signature="(n),(),(),()->()"))
