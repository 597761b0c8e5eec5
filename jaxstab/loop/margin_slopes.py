"""Margins under JAX: the search is called back, derivatives follow from the crossing it returns.

The derivatives of a crossing follow from the two equations for a root on the circle, by the
implicit function theorem.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from math import pi

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float64

from jaxstab.arrays import is_traced, solved
from jaxstab.model.filters import Filters
from jaxstab.region.closed_form import Responses, circle_equations

Search = Callable[..., Float64[np.ndarray, "wall column"]]


def moving_ends(
    search: Search,
    ways: Sequence[tuple[int, float]],
    point: Float64[Array, "*grid 5"],
    filters: Filters | None = None,
) -> tuple[Float64[Array, "*grid"], Float64[Array, "*grid way"]]:
    """Codes of verdicts, and the ends of all ways with their derivatives.

    ``search`` is ``first_crossings``; ``ways`` are those that it goes.
    """
    table = _called_back(search, len(ways), jax.lax.stop_gradient(point), filters)
    ends = [
        _moving(point, table[..., 1 + 2 * way], table[..., 2 + 2 * way], axis, filters)
        for way, (axis, _) in enumerate(ways)
    ]
    return table[..., 0], jnp.stack(ends, axis=-1)


def _called_back(search: Search, ways: int, point: Array, filters: Filters | None) -> Array:
    of_grid = partial(_of_grid, search, filters)
    if not is_traced(point):
        return jnp.asarray(of_grid(point))
    shape = (*point.shape[:-1], 1 + 2 * ways)
    result = jax.ShapeDtypeStruct(shape, jnp.float64)
    table: Array = jax.pure_callback(of_grid, result, point, vmap_method="broadcast_all")
    return table


def _of_grid(
    search: Search, filters: Filters | None, point: Array
) -> Float64[np.ndarray, "*grid column"]:
    walls = np.asarray(point)
    table = search(walls.reshape(-1, walls.shape[-1]), filters)
    return table.reshape(*walls.shape[:-1], table.shape[-1])


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
            real, imaginary = circle_equations(plant, alpha, beta, crossing[1], responses)
            return jnp.stack([real, jnp.where(is_real, crossing[1] - start, imaginary)])

        bracketed = jnp.stack([step, start])
        by_crossing = jax.jacfwd(equations)(bracketed, point)
        crossing = bracketed - solved(by_crossing, equations(bracketed, point)[:, None])[:, 0]
        by_crossing, by_point = jax.jacfwd(equations, (0, 1))(crossing, point)
        moved: Array = -solved(by_crossing, by_point)[0]
        return moved

    return jax.jit(jnp.vectorize(slopes, signature="(n),(),(),()->(n)"))
