"""Any linear loop as the triple (base, stiffness, damping): p(z) is affine in the wall's gains.

With the plant z^-lag N/D, a position filter P = Np/Dp and a velocity estimator V = (z - 1) Nv/Dv,

    p(z) = base + alpha stiffness + beta damping
         = z^lag D Dp Dv + alpha N Np Dv + beta N (z - 1) Nv Dp

up to powers of z. All coefficients are formed in pairs of float64, with bounds of their errors
(lemma V8 of docs/proofs.md).
"""

from functools import reduce
from typing import NamedTuple

from jaxstab.arrays import Array, namespace
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filters, Polynomial, Transfer, product, size_of
from jaxstab.model.plant import may_cancel, pairs_error, plant_pairs
from jaxstab.rounding import FILTERS, PAIR_PRODUCT

_DIFFERENCE = (DoubleDouble(1.0, 0.0), DoubleDouble(-1.0, 0.0))  # z - 1


class Bounded(NamedTuple):
    """A number, and a bound of its error."""

    value: DoubleDouble
    error: Array

    def __mul__(self, other: "Bounded") -> "Bounded":  # type: ignore[override]
        one, two = abs(self.value.hi), abs(other.value.hi)
        error = self.error * (two + other.error) + one * other.error + PAIR_PRODUCT * one * two
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
    one = DoubleDouble.of(xp.ones_like(pairs.d0.hi))
    numerator: Polynomial = (pairs.n2, pairs.n1, pairs.n0)
    relative = pairs_error(gamma, delta)
    size = size_of(numerator)
    rounding = relative * xp.where(may_cancel(gamma, delta), xp.sqrt(size), size)
    at_minus_one = (
        Bounded(pairs.difference, rounding),
        Bounded(one - pairs.d1 + pairs.d0, 4.0 * relative),
    )
    is_whole = isinstance(fraction, float) and fraction == 0.0
    if is_whole:  # N(0) = 0: a sample less
        numerator = numerator[:2]
        at_minus_one = -at_minus_one[0], at_minus_one[1]
    return SampledPlant(
        numerator=numerator,
        denominator=(one, pairs.d1, pairs.d0),
        lag=whole_delay + (not is_whole),
        errors=(3.0 * rounding, 2.0 * relative),
        at_one=(Bounded(one, 0.0), Bounded(DoubleDouble.of(gamma), 0.0)),
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
    """What estimator and position filter make of the loops of all plants.

    products: what base (beside D), stiffness and damping (beside N) are products with.
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
        product(one, other) + (zero,) * power
        for one, other, power in zip(plants, filters.products, powers, strict=True)
    ]
    degree = len(parts[0]) - 1
    base, stiffness, damping = ((zero,) * (degree + 1 - len(part)) + part for part in parts)
    roundings = plant.errors[1], plant.errors[0], plant.errors[0]
    errors = [
        size * (rounding + FILTERS * size_of(one))
        for size, rounding, one in zip(filters.sizes, roundings, plants, strict=True)
    ]
    return LinearLoop(
        base,
        stiffness,
        damping,
        errors=(errors[0], errors[1], errors[2]),
        at_one=_at_one(plant, filters),
        at_minus_one=_at_minus_one(plant, filters, [degree + power for power in powers]),
    )


def loop_factors(
    lag: int, velocity: Transfer, position: Transfer
) -> tuple[list[int], tuple[tuple[Polynomial, ...], ...]]:
    """Return what base (beside D), stiffness and damping (beside N) are made of.

    First the powers of z before the three, then the factors of each.
    """
    return _powers(lag, (velocity.lag + 1, position.lag)), _factors(velocity, position)


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
    parts = denominator * dp * dv, numerator * np_ * dv, minus_two * numerator * nv * dp
    return Affine(
        *(-part if power % 2 else part for part, power in zip(parts, powers, strict=True))
    )


def _values(transfer: Transfer, z: float) -> tuple[Bounded, Bounded]:
    both = zip(transfer.values_at(z), transfer.sizes, strict=True)
    above, below = (Bounded(value, FILTERS * size) for value, size in both)
    return above, below
