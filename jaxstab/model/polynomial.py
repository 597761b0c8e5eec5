"""The characteristic polynomial p(z) of the loop and its companion matrix."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float64

from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.parameters import (
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    require_x64,
)
from jaxstab.model.plant import PlantPairs, plant_pairs


def polynomial_degree(delay: ArrayLike) -> int:
    """Return the degree of p(z), of its longest one for an array of delays.

    It is 3 + d for a whole delay and 4 + floor(d) for a fractional one.

    Raises:
        TypeError: the delay is traced.
        ValueError: a delay is negative, infinite or NaN.

    Source: eq. (9), and its modified z-transform for a fractional delay.
    """
    return 3 + int(np.ceil(np.max(checked_delay(delay), initial=0.0)))


def characteristic_polynomial(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> Float64[Array, "*grid coefficient"]:
    """Return the coefficients of p(z), monic, highest power first.

    With n = floor(delay) and the plant's D and N for the fraction of the delay,

        p(z) = z^(n+2) D(z) + N(z) ((alpha + beta) z - beta)

    divided by z for a whole delay, where N(0) = 0. All coefficients are summed in double-double and
    rounded once, so a cancellation between wall and plant costs no digits.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, concrete. Polynomials of unlike degree in one array
            are multiplied by powers of z (zeros at the end): their other roots stay.

    Returns:
        Array of shape (*grid, degree + 1), degree = polynomial_degree(delay); differentiable in
        alpha, beta, gamma and delta.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        TypeError: the delay is traced.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) divided by -2 c1 gamma.
    """
    require_x64()
    delay = checked_delay(delay)
    whole_part = np.floor(delay)
    plant = plant_pairs(checked_gamma(gamma), checked_delta(delta), delay - whole_part)
    coefficients: Array = _polynomial(
        jnp.asarray(checked_gain("alpha", alpha), jnp.float64),
        jnp.asarray(checked_gain("beta", beta), jnp.float64),
        plant,
        jnp.asarray(whole_part),
        degree=polynomial_degree(delay),
    )
    return coefficients


def companion_matrix(coefficients: ArrayLike) -> Float64[Array, "*grid degree degree"]:
    """Return the companion matrix of monic polynomials: its eigenvalues are their roots.

    Args:
        coefficients: shape (*grid, degree + 1), highest power first, the first one 1 (not read).

    Returns:
        Array of shape (*grid, degree, degree): minus the other coefficients in the first row, ones
        below the diagonal.

    Raises:
        ValueError: fewer than two coefficients.
        RuntimeError: JAX's x64 mode is off.

    Source: theorem 3.3.14 of Horn and Johnson, Matrix Analysis, in the layout of numpy.roots.
    """
    require_x64()
    coefficients = jnp.asarray(coefficients, jnp.float64)
    degree = coefficients.shape[-1] - 1 if coefficients.ndim else 0
    if degree < 1:
        raise ValueError(
            f"coefficients has shape {coefficients.shape}; give at least two on the last axis."
        )
    shifted = jnp.broadcast_to(jnp.eye(degree, k=-1), (*coefficients.shape[:-1], degree, degree))
    return shifted.at[..., 0, :].set(-coefficients[..., 1:])


@partial(jax.jit, static_argnames="degree")
def _polynomial(
    alpha: Array,
    beta: Array,
    plant: PlantPairs,
    whole_delay: Array,
    *,
    degree: int,
) -> Array:
    wall = _times_wall(alpha, beta, plant)
    one = DoubleDouble.of(jnp.ones_like(plant.d0.hi))
    denominator = (one, plant.d1, plant.d0)
    grid = jnp.broadcast_shapes(wall[0].hi.shape, whole_delay.shape)
    columns = []
    for power in range(degree + 1):
        place = power - 1 - whole_delay  # the wall acts a sample after the hold and the delay
        column = _chosen(place, wall)
        if power < len(denominator):
            column = column + denominator[power]
        columns.append(jnp.broadcast_to(column.rounded(), grid))
    return jnp.stack(columns, axis=-1)


def _times_wall(alpha: Array, beta: Array, plant: PlantPairs) -> tuple[DoubleDouble, ...]:
    """Return the coefficients of N(z) ((alpha + beta) z - beta), highest power first."""
    stiffness, damping = DoubleDouble.of(alpha), DoubleDouble.of(beta)
    # b2 - b1 vanishes with delta for a whole delay; N(-1) knows it to all of its digits.
    falls = (-plant.n2, plant.difference - plant.n0, plant.n1 - plant.n0, plant.n0)
    lowered = tuple(stiffness * n for n in (plant.n2, plant.n1, plant.n0))
    return (
        lowered[0] - damping * falls[0],
        lowered[1] - damping * falls[1],
        lowered[2] - damping * falls[2],
        -(damping * falls[3]),
    )


def _chosen(place: Array, values: tuple[DoubleDouble, ...]) -> DoubleDouble:
    """Return ``values[place]``, and zero where ``place`` is outside of the tuple."""
    chosen = DoubleDouble.of(0.0)
    for index, value in enumerate(values):
        here = place == index
        chosen = jax.tree.map(partial(jnp.where, here), value, chosen)
    return chosen
