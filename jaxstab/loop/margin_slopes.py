"""Margins under JAX: the search is called back, derivatives follow from the crossing it returns.

The derivatives of a crossing follow from the two equations for a root on the circle, by the
implicit function theorem.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from math import pi

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float64

from jaxstab.arrays import solved
from jaxstab.loop.margins import WAYS
from jaxstab.model.filters import Filters
from jaxstab.region.on_circle import Responses, circle_equations, quick_slice


def moving_ends(
    point: Float64[Array, "*grid 5"],
    ends: Sequence[Array],
    angles: Sequence[Array],
    filters: Filters | None = None,
) -> Float64[Array, "*grid way"]:
    """The ends of all ways from points, with their derivatives by these."""
    ways = zip(WAYS, ends, angles, strict=True)
    moved = [_moving(point, end, angle, axis, filters) for (axis, _), end, angle in ways]
    return jnp.stack(moved, axis=-1)


@partial(jax.custom_jvp, nondiff_argnums=(3, 4))
def _moving(point: Array, end: Array, angle: Array, axis: int, filters: Filters | None) -> Array:
    """The ends of a way along an axis, with their derivatives by the points."""
    del point, angle, axis, filters
    return end


@_moving.defjvp
def _moving_jvp(
    axis: int,
    filters: Filters | None,
    primals: tuple[Array, Array, Array],
    tangents: tuple[Array, Array, Array],
) -> tuple[Array, Array]:
    point, end, angle = primals
    is_gain = axis < 2  # of a delay the end is how much longer it is
    slopes = _slopes(filters)(point, end - point[..., axis] if is_gain else end, angle, axis)
    moved = jnp.sum(slopes * tangents[0], axis=-1)
    return end, moved + tangents[0][..., axis] if is_gain else moved


@lru_cache(maxsize=16)
def _slopes(filters: Filters | None) -> Callable[..., Array]:
    """A function for the derivatives of a step by the point, from p(z) = 0 at the crossing."""
    nearly_real = 2.0**-29  # of pi: a root this near to the real axis is taken for real
    responses = Responses.from_filters(filters)

    def slopes(point: Array, step: Array, angle: Array, axis: Array) -> Array:
        end = jnp.round(angle)
        is_real = jnp.abs(angle - end) < nearly_real
        start = pi * jnp.where(is_real, end, angle)

        def equations(crossing: Array, point: Array) -> Array:
            alpha, beta, *plant = point.at[axis].add(crossing[0])
            c = quick_slice(*plant)
            real, imaginary = circle_equations(c, alpha, beta, crossing[1], responses)
            return jnp.stack([real, jnp.where(is_real, crossing[1] - start, imaginary)])

        bracketed = jnp.stack([step, start])
        by_crossing = jax.jacfwd(equations)(bracketed, point)
        crossing = bracketed - solved(by_crossing, equations(bracketed, point)[:, None])[:, 0]
        by_crossing, by_point = jax.jacfwd(equations, (0, 1))(crossing, point)
        moved: Array = -solved(by_crossing, by_point)[0]
        return moved

    return jax.jit(jnp.vectorize(slopes, signature="(n),(),(),()->(n)"))
