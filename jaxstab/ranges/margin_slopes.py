"""Margins under JAX: the search is called back, and derivatives come from what holds at its end.

How a crossing moves with the loop follows from the two equations for a root on the circle, by the
implicit function theorem.
"""

from functools import partial
from math import pi

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float64

from jaxstab.arrays import is_traced
from jaxstab.boxes.circle import circle_equations, quick_slice
from jaxstab.ranges.first_crossings import WAYS, first_crossings

_REAL = 2.0**-29  # of pi: a root this near to the real axis is taken for real


def moving_steps(
    point: Float64[Array, "*grid 5"],
) -> tuple[Float64[Array, "*grid"], Float64[Array, "*grid way"]]:
    """Return codes of verdicts, and the steps to the first crossings with their derivatives."""
    found = _called_back(jax.lax.stop_gradient(point))
    steps = [
        _moving(point, found[..., 1 + 2 * way], found[..., 2 + 2 * way], axis)
        for way, (axis, _) in enumerate(WAYS)
    ]
    return found[..., 0], jnp.stack(steps, axis=-1)


def _called_back(point: Array) -> Array:
    if not is_traced(point):
        return jnp.asarray(_search(point))
    shape = (*point.shape[:-1], 1 + 2 * len(WAYS))
    result = jax.ShapeDtypeStruct(shape, jnp.float64)
    found: Array = jax.pure_callback(_search, result, point, vmap_method="broadcast_all")
    return found


def _search(point: Array) -> Float64[np.ndarray, "*grid found"]:
    walls = np.asarray(point)
    found = first_crossings(walls.reshape(-1, walls.shape[-1]))
    return found.reshape(*walls.shape[:-1], found.shape[-1])


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def _moving(point: Array, step: Array, angle: Array, axis: int) -> Array:
    """Return the steps along an axis to the crossings, and how they move when the points do."""
    del point, angle, axis
    return step


@_moving.defjvp
def _moving_jvp(
    axis: int, primals: tuple[Array, Array, Array], tangents: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    return primals[1], jnp.sum(_slopes(*primals, axis) * tangents[0], axis=-1)


@jax.jit
@partial(jnp.vectorize, signature="(n),(),(),()->(n)")
def _slopes(point: Array, step: Array, angle: Array, axis: Array) -> Array:
    """Return the derivatives of a step by the point, from p(z) = 0 at both ends of the step."""
    end = jnp.round(angle)
    is_real = jnp.abs(angle - end) < _REAL
    start = pi * jnp.where(is_real, end, angle)

    def equations(crossing: Array, point: Array) -> Array:
        alpha, beta, gamma, delta, delay = point.at[axis].add(crossing[0])
        plant = quick_slice(gamma, delta, delay)
        real, imaginary = circle_equations(plant, alpha, beta, crossing[1])
        return jnp.stack([real, jnp.where(is_real, crossing[1] - start, imaginary)])

    bracketed = jnp.stack([step, start])
    by_crossing = jax.jacfwd(equations)(bracketed, point)
    crossing = bracketed - jnp.linalg.solve(by_crossing, equations(bracketed, point))
    by_crossing, by_point = jax.jacfwd(equations, (0, 1))(crossing, point)
    slopes: Array = -jnp.linalg.solve(by_crossing, by_point)[0]
    return slopes
