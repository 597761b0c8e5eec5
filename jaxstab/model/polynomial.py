"""The characteristic polynomial p(z) of the loop and its companion matrix."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, Numbers, float_arrays, is_any_traced, namespace, tree_map
from jaxstab.batches import MANY, compiled
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filter, Filters, Velocity, given_filters
from jaxstab.model.linear_loop import LinearLoop, filtered_loop
from jaxstab.model.parameters import (
    TracedDelay,
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    require_x64,
    whole_and_fraction,
)
from jaxstab.model.plant import PlantPairs, plant_pairs


def polynomial_degree(delay: Numbers) -> int:
    """The degree of p(z) without filters, the largest of all delays: 3 + d, or 4 + floor(d)."""
    if isinstance(delay, TracedDelay):  # a fraction that is traced may be any
        return 4 + delay.whole
    return 3 + int(np.ceil(np.max(checked_delay(delay), initial=0.0)))


def characteristic_polynomial(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Float64[Array, "*grid coefficient"]:
    """Coefficients of p(z), monic, highest power first.

    With n = floor(delay) and the plant's D and N for the fraction of the delay,

        p(z) = z^(n+2) D(z) + N(z) ((alpha + beta) z - beta)

    divided by z for a whole delay, where N(0) = 0. All coefficients are summed in double-double and
    rounded once, so cancellation between wall and plant costs no digits.

    Args:
        alpha, beta, gamma, delta, velocity, position: see ``jaxstab.conventions``.
        delay: time delay t_d/T >= 0 in samples, concrete. Polynomials of unlike degree in one array
            are multiplied by powers of z (zeros at the end): their other roots stay.

    Returns:
        Array of shape (*grid, degree + 1), differentiable in alpha, beta, gamma, delta, and in the
        cut-offs and factors of filters. Without filters the degree is 3 + ceil(delay).

    Raises: see ``jaxstab.conventions``; ValueError also if a filter is incompatible with a sampling
    period of 1, TypeError if an array of delays meets filters and traced arguments.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) divided by -2 c1 gamma.

    Example:
        >>> jaxstab.characteristic_polynomial(0.1, 0.2, gamma=0.0, delta=0.0, delay=0.0).tolist()
        [1.0, -1.85, 1.05, -0.1]
    """
    require_x64(alpha, beta, gamma, delta)
    whole_part, fraction = whole_and_fraction(delay)
    gains = float_arrays(checked_gain("alpha", alpha), checked_gain("beta", beta))
    hand = checked_gamma(gamma), checked_delta(delta)
    filters = given_filters(velocity, position)
    if filters:
        if isinstance(delay, TracedDelay):
            return _filtered_polynomial(
                gains[0], gains[1], hand, fraction, filters, whole_delay=delay.whole
            )
        delays = np.asarray(whole_part + fraction)
        return _filtered_polynomials((*gains, *hand), delays, filters)
    plant = plant_pairs(*hand, fraction)
    degree = polynomial_degree(delay)
    return _polynomial(gains[0], gains[1], plant, whole_part, degree=degree)


def companion_matrix(coefficients: Numbers) -> Float64[Array, "*grid degree degree"]:
    """The companion matrix of monic polynomials: its eigenvalues are their roots.

    Args:
        coefficients: shape (*grid, degree + 1), highest power first, the first one 1 (not read).

    Returns:
        Array of shape (*grid, degree, degree): minus the other coefficients in the first row, ones
        below the diagonal.

    Raises: see ``jaxstab.conventions``; ValueError also for fewer than two coefficients.

    Source: theorem 3.3.14 of Horn and Johnson, Matrix Analysis, in the layout of numpy.roots.

    Example:
        >>> jaxstab.companion_matrix([1.0, -0.5, 0.25]).tolist()
        [[0.5, -0.25], [1.0, 0.0]]
    """
    require_x64(coefficients)
    xp = namespace(coefficients)
    coefficients = xp.asarray(coefficients, xp.float64)
    degree = coefficients.shape[-1] - 1 if coefficients.ndim else 0
    if degree < 1:
        raise ValueError(
            f"coefficients has shape {coefficients.shape}; give at least two on the last axis."
        )
    below = xp.broadcast_to(
        xp.eye(degree - 1, degree), (*coefficients.shape[:-1], degree - 1, degree)
    )
    return xp.concatenate([-coefficients[..., None, 1:], below], axis=-2)


@compiled(static=["degree"], many=MANY)
def _polynomial(
    alpha: Array,
    beta: Array,
    plant: PlantPairs,
    whole_delay: Array,
    *,
    degree: int,
) -> Array:
    wall = _times_wall(alpha, beta, plant)
    xp = namespace(alpha, beta, plant)
    unit = DoubleDouble.of(xp.ones_like(plant.d0.hi))
    denominator = (unit, plant.d1, plant.d0)
    grid = xp.broadcast_shapes(wall[0].hi.shape, whole_delay.shape)
    columns = []
    for power in range(degree + 1):
        place = power - 1 - whole_delay  # the wall acts a sample after the hold and the delay
        column = _chosen(place, wall)
        if power < len(denominator):
            column = column + denominator[power]
        columns.append(xp.broadcast_to(column.rounded(), grid))
    return xp.stack(columns, axis=-1)


def _filtered_polynomials(
    point: tuple[Array, ...], delay: Float64[np.ndarray, "*grid"], filters: Filters
) -> Array:
    """Return p(z) with filters, one form after the other where the delays have several."""
    twice = np.floor(delay) + np.ceil(delay)
    forms = np.unique(twice)
    if forms.size == 1:
        whole = int(forms[0] // 2)
        fraction = delay - whole if forms[0] % 2 else 0.0
        alpha, beta, *hand = point
        return _filtered_polynomial(alpha, beta, hand, fraction, filters, whole_delay=whole)
    if is_any_traced(point, filters):
        raise TypeError("filters take an array of delays with concrete arguments only.")
    grid = np.broadcast_shapes(delay.shape, *(np.shape(value) for value in point))
    arguments = [np.broadcast_to(np.asarray(value), grid) for value in (*point, delay)]
    members = [np.broadcast_to(twice == form, grid) for form in forms]
    blocks = []
    for chosen in members:
        *listed, delays = (argument[chosen] for argument in arguments)
        blocks.append(_filtered_polynomials(tuple(listed), delays, filters))
    result = np.zeros((*grid, max(block.shape[-1] for block in blocks)))
    for chosen, block in zip(members, blocks, strict=True):
        result[chosen, : block.shape[-1]] = block
    return namespace(point).asarray(result)


@compiled(static=["whole_delay"])
def _filtered_polynomial(
    alpha: Array,
    beta: Array,
    hand: Sequence[Array],
    fraction: Array | float,
    filters: Filters,
    *,
    whole_delay: int,
) -> Array:
    gamma, delta = hand
    return loop_polynomial(alpha, beta, filtered_loop(gamma, delta, whole_delay, fraction, filters))


def loop_polynomial(
    alpha: Array, beta: Array, loop: LinearLoop
) -> Float64[Array, "*grid coefficient"]:
    """Return p(z) of walls of one loop, summed in pairs and rounded once; for numbers unchecked."""
    columns = [
        (base + (stiff * alpha + damp * beta)).rounded()
        for base, stiff, damp in zip(loop.base, loop.stiffness, loop.damping, strict=True)
    ]
    xp = namespace(columns)
    return xp.stack(xp.broadcast_arrays(*columns), axis=-1)


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
        chosen = tree_map(partial(namespace(here, value).where, here), value, chosen)
    return chosen
