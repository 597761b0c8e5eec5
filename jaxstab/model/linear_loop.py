"""Any linear loop as the triple (base, stiffness, damping): p(z) is affine in the wall's gains.

With the plant z^-lag N/D, a position filter P = Np/Dp and a velocity estimator V = (z - 1) Nv/Dv,

    p(z) = base + alpha stiffness + beta damping
         = z^lag D Dp Dv + alpha N Np Dv + beta N (z - 1) Nv Dp

up to powers of z. All coefficients are formed in pairs of float64, with bounds of their errors
(lemma V8 of docs/proofs.md).
"""

from collections.abc import Sequence
from functools import partial, reduce
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, Numbers, float_arrays, is_any_traced, namespace, tree_map
from jaxstab.batches import MANY, compiled
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import (
    Filter,
    Filters,
    Polynomial,
    Transfer,
    Velocity,
    given_filters,
    product,
    size_of,
)
from jaxstab.model.parameters import (
    TracedDelay,
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    require_x64,
    whole_and_fraction,
)
from jaxstab.model.plant import PlantPairs, may_cancel, pairs_error, plant_pairs
from jaxstab.rounding import FILTERS, PAIR_PRODUCT

_DIFFERENCE = (DoubleDouble(1.0, 0.0), DoubleDouble(-1.0, 0.0))  # z - 1


class Bounded(NamedTuple):
    """A number, and a bound of its error."""

    value: DoubleDouble
    error: Array

    def __mul__(self, other: "Bounded") -> "Bounded":  # type: ignore[override]
        a, b = abs(self.value.hi), abs(other.value.hi)
        error = self.error * (b + other.error) + a * other.error + PAIR_PRODUCT * a * b
        return Bounded(self.value * other.value, error)

    def __neg__(self) -> "Bounded":
        return Bounded(-self.value, self.error)


class Affine(NamedTuple):
    """The three parts of base + alpha stiffness + beta damping."""

    base: Bounded
    stiffness: Bounded
    damping: Bounded


class SampledPlant(NamedTuple):
    """A plant behind a hold and a delay, z^-lag N(z)/D(z), times m/T^2 if it is made of numbers.

    numerator, denominator: coefficients, highest power of z first; the denominator is monic.
    lag: whole samples.
    errors: bounds of the errors of the coefficients of N and D, summed.
    at_one: N(1) and D(1) up to a common positive factor.
    at_minus_one: N(-1) and D(-1).
    shifted: N(z), D(z), N(-z) and D(-z) by their coefficients in powers of z - 1, where they are
        known to more digits than sums of the coefficients are.
    """

    numerator: Polynomial
    denominator: Polynomial
    lag: int
    errors: tuple[Array, Array]
    at_one: tuple[Bounded, Bounded]
    at_minus_one: tuple[Bounded, Bounded]
    shifted: tuple[Polynomial, Polynomial, Polynomial, Polynomial] | None = None


class LinearLoop(NamedTuple):
    """p(z) of a loop with any plant, estimator and filter; arrays have the shape of the plants.

    base: coefficients of the part without a wall, monic, highest power of z first.
    stiffness: those that alpha multiplies, as many, the first one 0.
    damping: those that beta multiplies, as many, the first one 0.
    errors: bounds of the errors of the coefficients of the three, summed.
    at_one: p(1) up to a positive factor.
    at_minus_one: (-1)^degree p(-1).
    """

    base: Polynomial
    stiffness: Polynomial
    damping: Polynomial
    errors: tuple[Array, Array, Array]
    at_one: Affine
    at_minus_one: Affine

    @property
    def degree(self) -> int:
        """The degree of p."""
        return len(self.base) - 1


def sampled_mass(
    gamma: Array, delta: Array, whole_delay: int, fraction: Array | float
) -> SampledPlant:
    """Device and hand of one mass (eq. (9)); the fraction of the delay is 0.0, or nowhere 0."""
    pairs = plant_pairs(gamma, delta, fraction)
    xp = namespace(pairs)
    unit = DoubleDouble.from_value(xp.ones_like(pairs.d0.hi))
    numerator: Polynomial = (pairs.n2, pairs.n1, pairs.n0)
    relative = pairs_error(gamma, delta)
    size = size_of(numerator)
    rounding = relative * xp.where(may_cancel(gamma, delta), xp.sqrt(size), size)
    at_minus_one = (
        Bounded(pairs.difference, rounding),
        Bounded(unit - pairs.d1 + pairs.d0, 4.0 * relative),
    )
    is_whole = isinstance(fraction, float) and fraction == 0.0
    if is_whole:  # N(0) = 0: a sample less
        numerator = numerator[:2]
        at_minus_one = -at_minus_one[0], at_minus_one[1]
    return SampledPlant(
        numerator=numerator,
        denominator=(unit, pairs.d1, pairs.d0),
        lag=whole_delay + (not is_whole),
        errors=(3.0 * rounding, 2.0 * relative),
        at_one=(Bounded(unit, 0.0), Bounded(DoubleDouble.from_value(gamma), 0.0)),
        at_minus_one=at_minus_one,
    )


def filtered_loop(
    gamma: Array, delta: Array, whole_delay: int, fraction: Array | float, filters: Filters
) -> LinearLoop:
    """Return the loop of device and hand of one mass with filters, for T = 1."""
    plant = sampled_mass(gamma, delta, whole_delay, fraction)
    velocity, position = filters
    return linear_loop(plant, velocity.filter.transfer(), position.transfer())


class LoopFilters(NamedTuple):
    """The effect of estimator and position filter on the loop of any plant.

    products: the factors of base (beside D), stiffness and damping (beside N).
    sizes: bounds of the sums of the moduli of their coefficients.
    lags: powers of 1/z before stiffness and damping.
    at_one: numerator and denominator of P at z = 1.
    at_minus_one: the same of V, less its difference, and of P at z = -1.
    """

    products: tuple[Polynomial, ...]
    sizes: tuple[Array, ...]
    lags: tuple[int, int]
    at_one: tuple[Bounded, Bounded]
    at_minus_one: tuple[Bounded, Bounded, Bounded, Bounded]


def linear_loop(plant: SampledPlant, velocity: Transfer, position: Transfer) -> LinearLoop:
    """Return the loop of a plant, with T V(z) less its factor (1 - 1/z), and with P(z)."""
    return loop_of(plant, loop_filters(velocity, position))


def loop_filters(velocity: Transfer, position: Transfer) -> LoopFilters:
    """The parts of all loops that two filters decide, for ``loop_of``."""
    (above, steady), (below, steady_below) = velocity.sizes, position.sizes
    return LoopFilters(
        products=tuple(reduce(product, each) for each in _factors(velocity, position)),
        sizes=(steady_below * steady, below * steady, 2.0 * above * steady_below),
        lags=(velocity.lag + 1, position.lag),  # z - 1 is a sample more than 1 - 1/z
        at_one=_values(position, 1.0),
        at_minus_one=(*_values(velocity, -1.0), *_values(position, -1.0)),
    )


def loop_of(plant: SampledPlant, filters: LoopFilters) -> LinearLoop:
    """Return the loop of a plant with two filters."""
    powers = _powers(plant.lag, filters.lags)
    plants = plant.denominator, plant.numerator, plant.numerator
    zero = plant.denominator[0] - plant.denominator[0]
    parts = [
        product(polynomial, factor) + (zero,) * power
        for polynomial, factor, power in zip(plants, filters.products, powers, strict=True)
    ]
    degree = len(parts[0]) - 1
    base, stiffness, damping = ((zero,) * (degree + 1 - len(terms)) + terms for terms in parts)
    roundings = plant.errors[1], plant.errors[0], plant.errors[0]
    errors = [
        size * (rounding + FILTERS * size_of(polynomial))
        for size, rounding, polynomial in zip(filters.sizes, roundings, plants, strict=True)
    ]
    return LinearLoop(
        base,
        stiffness,
        damping,
        errors=(errors[0], errors[1], errors[2]),
        at_one=_at_one(plant, filters),
        at_minus_one=_at_minus_one(plant, filters, [degree + power for power in powers]),
    )


def loop_without_drift(loop: LinearLoop) -> LinearLoop:
    """Return the loop of p(z) z / (z - 1), for alpha = 0 and a device that nothing holds.

    Such a device has a pole at z = 1, which a damper leaves there: the position may stay anywhere.
    The other roots of p are those of the loop returned, and one at 0 (lemma V11).
    """
    degree, nothing = loop.degree, loop.base[0] - loop.base[0]
    parts = [(*accumulate(p[:-1], DoubleDouble.__add__), nothing) for p in loop[:3]]
    rounding = degree * PAIR_PRODUCT
    errors = [
        degree * (error + rounding * size_of(polynomial))
        for error, polynomial in zip(loop.errors, loop[:3], strict=True)
    ]
    sums = [reduce(DoubleDouble.__add__, part) for part in parts]
    base, stiffness, damping = parts
    bounds = errors[0], errors[1], errors[2]
    at_one = Affine(*map(Bounded, sums, errors))
    return LinearLoop(base, stiffness, damping, bounds, at_one, loop.at_minus_one)


def _powers(lag: int, lags: tuple[int, int]) -> list[int]:
    powers = [lag + sum(lags), *lags]
    return [power - min(powers) for power in powers]


def _factors(velocity: Transfer, position: Transfer) -> tuple[tuple[Polynomial, ...], ...]:
    (nv, dv), (np_, dp) = velocity[:2], position[:2]
    return (dp, dv), (np_, dv), (_DIFFERENCE, nv, dp)


def _at_one(plant: SampledPlant, filters: LoopFilters) -> Affine:
    """Return p(1) over Dv(1), which is positive."""
    numerator, denominator = plant.at_one
    above, below = filters.at_one
    stiffness = numerator * above
    return Affine(denominator * below, stiffness, Bounded(stiffness.value * 0.0, 0.0))


def _at_minus_one(plant: SampledPlant, filters: LoopFilters, powers: list[int]) -> Affine:
    """Return (-1)^degree p(-1); ``powers`` are those of z before the parts, and the degree more."""
    numerator, denominator = plant.at_minus_one
    nv, dv, np_, dp = filters.at_minus_one
    minus_two = Bounded(DoubleDouble(-2.0, 0.0), 0.0)
    terms = denominator * dp * dv, numerator * np_ * dv, minus_two * numerator * nv * dp
    return Affine(
        *(-term if power % 2 else term for term, power in zip(terms, powers, strict=True))
    )


def _values(transfer: Transfer, z: float) -> tuple[Bounded, Bounded]:
    both = zip(transfer.values_at(z), transfer.sizes, strict=True)
    above, below = (Bounded(value, FILTERS * size) for value, size in both)
    return above, below


# The same with its coefficients summed and rounded: p(z) as arrays, and its companion matrix.


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
    unit = DoubleDouble.from_value(xp.ones_like(plant.d0.hi))
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
    stiffness, damping = DoubleDouble.from_value(alpha), DoubleDouble.from_value(beta)
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
    chosen = DoubleDouble.from_value(0.0)
    for index, value in enumerate(values):
        here = place == index
        chosen = tree_map(partial(namespace(here, value).where, here), value, chosen)
    return chosen
