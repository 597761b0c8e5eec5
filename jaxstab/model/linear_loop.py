"""Any linear loop as the triple (base, stiffness, damping): p(z) is affine in the wall's gains.

With the plant N/D, a position filter P = Ap/Bp and a velocity estimator V = Av/Bv, all of them in
powers of 1/z and the denominators 1 at first,

    z^-degree p(z) = base + alpha stiffness + beta damping = D Bp Bv + N (alpha Ap Bv + beta Av Bp).

What filters multiply is formed in exact numbers, and rounded once; where JAX has their parameters,
in pairs of float64. One mass multiplies it in pairs too, with bounds of all errors (lemma V7 of
docs/proofs.md), on grids and under transformations of JAX. The triple of a single loop, of
any device, is the middle of its balls (``balls.linear_loop``).
"""

from fractions import Fraction
from functools import lru_cache, partial, reduce
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, Numbers, float_arrays, is_any_jax, namespace, tree_map
from jaxstab.batches import MANY, compiled
from jaxstab.model.double_double import DoubleDouble, size_sum
from jaxstab.model.filters import (
    NO_FILTERS,
    Filter,
    Filters,
    Section,
    Velocity,
    exact_chain,
    given_filters,
)
from jaxstab.model.plant import (
    TracedDelay,
    bounded_delay,
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    may_cancel,
    pairs_error,
    plant_pairs,
    require_x64,
    whole_and_fraction,
)
from jaxstab.numbers import real_numbers, require_together
from jaxstab.rounding import FILTERS, PAIR_PRODUCT

Polynomial = tuple[DoubleDouble, ...]
"""Coefficients in powers of 1/z, lowest first; in powers of z they are those, highest first."""

_ZERO, _ONE = DoubleDouble(0.0), DoubleDouble(1.0)


class LinearLoop(NamedTuple):
    """p(z) of a loop with any plant, estimator and filter; arrays have the shape of the plants.

    base: coefficients of the part without a wall, monic, highest power of z first.
    stiffness: those that alpha multiplies, as many, the first one 0.
    damping: those that beta multiplies, as many, the first one 0.
    at_one: the parts of p(1).
    at_minus_one: the parts of (-1)^degree p(-1).
    errors: bounds of the errors of the coefficients of each part, summed, and of both its values.
    is_free: whether p(1) is exactly 0 for alpha = 0: a device that nothing holds.
    """

    base: Polynomial
    stiffness: Polynomial
    damping: Polynomial
    at_one: Polynomial
    at_minus_one: Polynomial
    errors: tuple[Array, Array, Array]
    is_free: Array

    @property
    def degree(self) -> int:
        """The degree of p."""
        return len(self.base) - 1


def filtered_loop(
    gamma: Array,
    delta: Array,
    whole_delay: int | Array,
    fraction: Array | float,
    filters: Filters,
    longest: int | None = None,
) -> LinearLoop:
    """The loop of device and hand of one mass (eq. (9)) with filters in units of one sample.

    The fraction of the delay is 0.0, or nowhere 0, or traced: then p(z) may be divisible by z. A
    whole delay that is traced is at most ``longest``.
    """
    pairs = plant_pairs(gamma, delta, fraction)
    xp = namespace(pairs)
    denominator: Polynomial = (_ONE, pairs.d1, pairs.d0)
    numerator: Polynomial = (pairs.n2, pairs.n1, pairs.n0)
    relative, size = pairs_error(gamma, delta), size_sum(numerator)
    rounding = relative * xp.where(may_cancel(gamma, delta), xp.sqrt(size), size)
    if isinstance(fraction, float) and fraction == 0.0:
        numerator = numerator[:2]
    plants = denominator, numerator, numerator
    errors = 2.0 * relative + gamma * rounding, 3.0 * rounding, 3.0 * rounding  # D(1) = gamma N(1)
    factors, inherited = filter_factors(filters)
    parts = [product(plant, factor) for plant, factor in zip(plants, factors, strict=True)]
    parts[1:] = [_delayed(part, whole_delay, longest) for part in parts[1:]]
    degree = max(map(len, parts)) - 1
    base, stiffness, damping = (part + (_ZERO,) * (degree + 1 - len(part)) for part in parts)
    late = 2.0 * (whole_delay % 2) - 1.0
    turned = (-pairs.d1 + _ONE + pairs.d0, *[pairs.difference.scaled(late)] * 2)
    ends = (pairs.den_at_one, pairs.sum, pairs.sum), turned
    sizes = [size_sum(part) + error for part, error in zip(factors, inherited, strict=True)]
    bounds = [
        error * size + size_sum(plant) * (of_filters + 2.0 * PAIR_PRODUCT * size)
        for plant, error, size, of_filters in zip(plants, errors, sizes, inherited, strict=True)
    ]
    at_one, at_minus_one = (
        tuple(map(DoubleDouble.__mul__, end, _values_at(z, factors)))
        for z, end in zip((1, -1), ends, strict=True)
    )
    return LinearLoop(
        base,
        stiffness,
        damping,
        at_one=at_one,
        at_minus_one=at_minus_one,
        errors=(bounds[0], bounds[1], bounds[2]),
        is_free=xp.asarray(gamma) == 0.0,
    )


def _delayed(part: Polynomial, whole_delay: int | Array, longest: int | None) -> Polynomial:
    """A polynomial in 1/z, a sample and the whole delay later."""
    if longest is None or isinstance(whole_delay, int):
        return (_ZERO,) * (whole_delay + 1) + part

    def at(place: int) -> DoubleDouble:
        value = _ZERO
        for power, coefficient in enumerate(part):
            if 0 <= place - power <= longest:
                is_here = whole_delay == place - power
                value = tree_map(partial(namespace(is_here).where, is_here), coefficient, value)
        return value

    return (_ZERO, *map(at, range(longest + len(part))))


Factors = tuple[Polynomial, Polynomial, Polynomial]
Errors = tuple[Array, Array, Array]


def _values_at(z: int, factors: Factors) -> Polynomial:
    """The values at z = 1 or -1, where that of Av at 1 is exactly 0."""
    first, second, third = (
        reduce(lambda value, c: value.scaled(float(z)) + c, part[::-1], _ZERO) for part in factors
    )
    return first, second, _ZERO if z == 1 else third


def filter_factors(filters: Filters) -> tuple[Factors, Errors]:
    """Factors of filters in units of one sample, beside D and N in powers of 1/z, and errors.

    They are Bp Bv beside D, Ap Bv and Av Bp beside N; the errors are bounds of those of the
    coefficients of each, summed, and of its values at 1 and -1.
    """
    velocity, position = filters
    chains = velocity.filter.sections, position.sections
    if not any(chains):
        return ((_ONE,), (_ONE,), (_ONE, -_ONE)), (0.0, 0.0, 0.0)
    if not is_any_jax(filters):
        return _exact_factors(*chains)
    (above_v, below_v, sizes_v), (above_p, below_p, sizes_p) = map(_in_pairs, chains)
    above_v, size = product((_ONE, -_ONE), above_v), 2.0 * sizes_v[0]
    # Lemma V7 counts the stages, and what is done with their product.
    rounding = FILTERS * (4 + sum(len(section.stages()) for chain in chains for section in chain))
    factors = product(below_p, below_v), product(above_p, below_v), product(above_v, below_p)
    sizes = sizes_p[1] * sizes_v[1], sizes_p[0] * sizes_v[1], size * sizes_p[1]
    return factors, (rounding * sizes[0], rounding * sizes[1], rounding * sizes[2])


@lru_cache(maxsize=256)
def _exact_factors(
    velocity: tuple[Section, ...], position: tuple[Section, ...]
) -> tuple[Factors, Errors]:
    (above_v, below_v), (above_p, below_p) = map(exact_chain, (velocity, position))
    above_v -= above_v.left_shift(1)
    exact_parts = below_p * below_v, above_p * below_v, above_v * below_p
    base, stiffness, damping = (tuple(map(_nearest, part.coeffs())) for part in exact_parts)
    errors = [4.0 * FILTERS * size_sum(part) for part in (base, stiffness, damping)]
    return (base, stiffness, damping), (errors[0], errors[1], errors[2])


def _nearest(number: Any) -> DoubleDouble:
    """The pair next to an exact number of python-flint."""
    return DoubleDouble.from_value(Fraction(int(number.p), int(number.q)))


def _in_pairs(sections: tuple[Section, ...]) -> tuple[Polynomial, Polynomial, tuple[Array, Array]]:
    """Numerator and denominator of a chain, and the products of the sizes of its stages."""
    sides: list[Polynomial] = [(_ONE,), (_ONE,)]
    sizes: list[Array] = [1.0, 1.0]
    for section in sections:
        for stage in section.stages():
            for side, row in enumerate(stage):
                factor = tuple(map(DoubleDouble.from_value, row))
                sides[side] = product(sides[side], factor)
                sizes[side] = sizes[side] * size_sum(factor)
    return sides[0], sides[1], (sizes[0], sizes[1])


def product(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return the product of two polynomials; those of windows have few terms that are not 0."""
    terms: list[list[DoubleDouble]] = [[] for _ in range(len(a) + len(b) - 1)]
    others = [(j, other) for j, other in enumerate(b) if not _is_zero(other)]
    for i, value in enumerate(a):
        for j, other in [] if _is_zero(value) else others:
            is_sign = type(other.hi) is float and abs(other.hi) == 1.0 and other.lo == 0.0
            terms[i + j].append(value.scaled(other.hi) if is_sign else value * other)
    return tuple(reduce(DoubleDouble.__add__, column) if column else _ZERO for column in terms)


def _is_zero(value: DoubleDouble) -> bool:
    return type(value.hi) is float and value.hi == 0.0


# The same with its coefficients summed and rounded: p(z) as arrays, and its companion matrix.


def polynomial_degree(delay: Numbers) -> int:
    """The degree of p(z) without filters, the largest of all delays: 3 + d, or 4 + floor(d)."""
    if isinstance(delay, TracedDelay):  # a fraction that is traced may be any
        return 4 + delay.longest
    return 3 + int(np.ceil(np.max(checked_delay(delay), initial=0.0)))


def characteristic_polynomial(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    longest_delay: int | float | None = None,
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
        delay: time delay t_d/T >= 0 in samples, concrete or, with ``longest_delay``, traced by JAX.
            Polynomials of unlike degree in one array are multiplied by powers of z (zeros at the
            end): their other roots stay.
        longest_delay: see ``jaxstab.conventions``.

    Returns:
        Array of shape (*grid, degree + 1), differentiable in alpha, beta, gamma, delta, a traced
        delay, and in the cut-offs and factors of filters. Without filters the degree is 3 +
        ceil(delay), and 4 + floor(longest_delay) for a traced delay.

    Raises: see ``jaxstab.conventions``; ValueError also if a filter is incompatible with a sampling
    period of 1, TypeError if an array of delays meets filters and traced arguments.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) divided by -2 c1 gamma.

    Example:
        >>> jaxstab.characteristic_polynomial(0.1, 0.2, gamma=0.0, delta=0.0, delay=0.0).tolist()
        [1.0, -1.85, 1.05, -0.1]
    """
    require_together(alpha=alpha, beta=beta, gamma=gamma, delta=delta, delay=delay)
    late = bounded_delay(delay, longest_delay)
    whole_part, fraction = whole_and_fraction(late)
    gains = float_arrays(checked_gain("alpha", alpha), checked_gain("beta", beta))
    hand = checked_gamma(gamma), checked_delta(delta)
    filters = given_filters(velocity, position) or NO_FILTERS
    if isinstance(late, TracedDelay):
        gamma, delta = hand
        loop = filtered_loop(gamma, delta, late.whole, fraction, filters, late.longest)
        return loop_polynomial(gains[0], gains[1], loop)
    return _polynomials((*gains, *hand), np.asarray(whole_part + fraction), filters)


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
    given = real_numbers("coefficients", coefficients) if xp is np else coefficients
    coefficients = xp.asarray(given, xp.float64)
    degree = coefficients.shape[-1] - 1 if coefficients.ndim else 0
    if degree < 1:
        raise ValueError(
            f"coefficients has shape {coefficients.shape}; give at least two on the last axis."
        )
    below = xp.broadcast_to(
        xp.eye(degree - 1, degree), (*coefficients.shape[:-1], degree - 1, degree)
    )
    return xp.concatenate([-coefficients[..., None, 1:], below], axis=-2)


def _polynomials(
    point: tuple[Array, ...], delay: Float64[np.ndarray, "*grid"], filters: Filters
) -> Array:
    """The coefficients, one form after the other where the delays have several."""
    twice = np.floor(delay) + np.ceil(delay)
    forms = np.unique(twice).tolist() or [0.0]
    if len(forms) == 1:
        whole, is_late = divmod(int(forms[0]), 2)
        fraction = delay - whole if is_late else None
        return _polynomial(point, fraction, filters, whole_delay=whole)
    xp = namespace(point, filters)
    grid = np.broadcast_shapes(delay.shape, *map(xp.shape, point))
    every = [xp.broadcast_to(value, grid).ravel() for value in (*point, delay)]
    members = [np.flatnonzero(np.broadcast_to(twice == form, grid)) for form in forms]
    rows = [
        _polynomials(
            tuple(x[own] for x in every[:-1]), np.broadcast_to(delay, grid).flat[own], filters
        )
        for own in members
    ]
    length = max((row.shape[-1] for row in rows), default=1)
    rows = [xp.pad(row, [(0, 0), (0, length - row.shape[-1])]) for row in rows]
    order = np.argsort(np.concatenate(members))
    return xp.concatenate(rows)[order].reshape(*grid, length)


@compiled(static=["whole_delay"])
def _polynomial(
    point: tuple[Array, ...], fraction: Array | None, filters: Filters, *, whole_delay: int
) -> Array:
    alpha, beta, gamma, delta = point
    late = 0.0 if fraction is None else fraction
    return loop_polynomial(alpha, beta, filtered_loop(gamma, delta, whole_delay, late, filters))


@compiled(many=MANY)
def loop_polynomial(
    alpha: Array, beta: Array, loop: LinearLoop
) -> Float64[Array, "*grid coefficient"]:
    """p(z) of walls of one loop, summed in pairs and rounded once; for numbers unchecked."""
    columns = [
        base if _is_zero(stiff) and _is_zero(damp) else base + (stiff * alpha + damp * beta)
        for base, stiff, damp in zip(loop.base, loop.stiffness, loop.damping, strict=True)
    ]
    xp = namespace(alpha, beta, loop)
    return xp.stack(xp.broadcast_arrays(*(column.rounded() for column in columns)), axis=-1)
