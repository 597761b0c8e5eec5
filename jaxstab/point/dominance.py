"""The proof that an approximate root of p(z) is the dominant one, with a bound of its error.

A root lies within n |p(z) / p'(z)| of any z (lemma R1 of docs/proofs.md). Divided by it, and by its
conjugate where there is one, p leaves Q(z); if all roots of Q are proved to be inside the circle
through z, the root is dominant (lemma R2). So the proof needs only as much precision as the
distance to the second largest root requires.

Sources: Schur (1917), Cohn (1922); Henrici, Applied and Computational Complex Analysis I, 6.4, for
the distance.
"""

from collections.abc import Iterator
from functools import partial, reduce
from math import prod
from operator import add
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int64

from jaxstab.arrays import (
    Array,
    is_any_jax,
    joined,
    namespace,
    power_of_two_below_inverse,
    reciprocal,
    repeat,
    take,
    tree_map,
    true_indices,
    with_values,
)
from jaxstab.batches import MANY, compiled, is_on_cpu, lists, on_few_sizes, over_tiles
from jaxstab.model import polynomial_degree
from jaxstab.point.poles import looked_up
from jaxstab.point.verdicts import Plant, float_plant
from jaxstab.rounding import UNIT

# The dominant root of p(z) without eigenvalues, point by point.
#
# Only elementwise operations, the same for every point: a compiler keeps all of it in registers.
# Powers of the companion matrix (``traced_radius``) make the guess; Newton's method works on
# t = z - 1, where the terms of
#
#     p(z) = z^(n-2) D(z) + N(z) (alpha z + beta t),    D = t^2 + (1 - d0 + D(1)) t + D(1)
#
# are as small as the gains that make them, so slow loops with roots close to 1 lose no digits. That
# a root is dominant is proved above.
#
# Source: eq. (9) in the form of the design.

Column = Any  # an array, or None for zeros

_LONGEST_UNROLLED = 4000  # about as many products; beyond, code was up to 100 times slower
TILE = 256  # points whose polynomials of a higher degree stay in the cache


class Loop(NamedTuple):
    """Points of one degree; all fields broadcast. For a whole delay N(0) = 0 is divided out."""

    alpha: Array
    beta: Array
    gamma: Array
    plant: Plant[Array]

    @property
    def numerator(self) -> tuple[Array, ...]:
        """The coefficients of N(1 + t), highest power of t first."""
        stiff = self.plant.stiff
        if len(stiff) == 3:
            return stiff[2], self.plant.sum
        return stiff[3], 2.0 * stiff[3] + stiff[2], self.plant.sum

    @property
    def denominator(self) -> tuple[Array, Array]:
        """The coefficients of t and 1 in D(1 + t)."""
        at_one = self.gamma * self.plant.sum
        return self.plant.gap + at_one, at_one

    def coefficients(self, degree: int) -> list[Column]:
        """The coefficients of p(z) below z^degree, lowest power first."""
        plant = self.plant
        columns: list[Column] = [None] * degree
        columns[-1], columns[-2] = plant.d1, plant.d0
        for power, (stiff, damp) in enumerate(zip(plant.stiff, plant.damp, strict=True)):
            wall = stiff * self.alpha - damp * self.beta
            column = columns[power]
            columns[power] = wall if column is None else column + wall
        return columns


class Complex(NamedTuple):
    """Real and imaginary part: XLA fuses them better than complex numbers."""

    re: Array
    im: Array

    def times(self, other: "Complex") -> "Complex":
        """Return the product with another number."""
        return Complex(
            self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re
        )

    def scaled(self, factor: Array | float) -> "Complex":
        """Return the product with a real number."""
        return Complex(self.re * factor, self.im * factor)

    def plus(self, other: "Complex") -> "Complex":
        """Return the sum with another number."""
        return Complex(self.re + other.re, self.im + other.im)

    def shifted(self, number: Array | float) -> "Complex":
        """Return the sum with a real number."""
        return Complex(self.re + number, self.im)

    def squared_modulus(self) -> Array:
        """Return re^2 + im^2."""
        return self.re * self.re + self.im * self.im


@compiled(static=["degree", "doublings", "corrections"], many=0, wide=True)
def dominant_root(loop: Loop, *, degree: int, doublings: int, corrections: int = 2) -> Array:
    """Return t = z - 1 of a root z >= 0 that is probably dominant, by XLA, as a complex array.

    The imaginary part is >= 0, and 0 for real roots. Each doubling halves the number of points
    where two roots of nearly one modulus are confused; no doublings means the closed form for
    degree 3. ``distance_of_dominant`` tells how it went.
    """
    products = doublings * degree * (degree + 10) + 160 * corrections
    is_unrolled = products <= _LONGEST_UNROLLED
    root = partial(
        _root,
        degree=degree,
        doublings=doublings,
        corrections=corrections,
        is_unrolled=is_unrolled,
    )
    return root(loop) if is_unrolled else over_tiles(root, (loop,), TILE)


def _root(loop: Loop, *, degree: int, doublings: int, corrections: int, is_unrolled: bool) -> Array:
    from jax import lax

    t = _guess(loop.coefficients(degree), doublings, is_unrolled)
    for _ in range(corrections):
        t = newton(t, loop, degree)
    return lax.complex(t.re, t.im)  # of two arrays XLA would compute each on its own


def _guess(coefficients: list[Column], doublings: int, is_unrolled: bool) -> Complex:
    from jaxstab.point.traced_radius import guessed_root, largest_root

    if doublings == 0:
        c, b, a = coefficients
        return Complex(*largest_root(a, b, c)).shifted(-1.0)
    return Complex(*guessed_root(coefficients, doublings, is_unrolled=is_unrolled))


def newton(t: Complex, loop: Loop, degree: int) -> Complex:
    """Return t after a step of Newton's method towards a root of p(1 + t)."""
    value, slope = evaluated(t, loop, degree)
    inverse = reciprocal(slope.squared_modulus())
    correction = value.times(Complex(slope.re, -slope.im)).scaled(-inverse)
    return t.plus(correction)


def evaluated(t: Complex, loop: Loop, degree: int) -> tuple[Complex, Complex]:
    """Return p and its derivative at z = 1 + t."""
    z = t.shifted(1.0)
    linear, constant = loop.denominator
    denominator = t.shifted(linear).times(t).shifted(constant)
    wall = z.scaled(loop.alpha).plus(t.scaled(loop.beta))
    numerator, numerator_slope = _numerator(t, loop.numerator)
    below = _to_power(z, degree - 3)  # z^(n-3)
    delayed = z.times(denominator)
    delayed_slope = denominator.scaled(degree - 2.0).plus(
        z.times(Complex(2.0 * t.re + linear, 2.0 * t.im))
    )
    if below is not None:
        delayed, delayed_slope = below.times(delayed), below.times(delayed_slope)
    slope = delayed_slope.plus(numerator.scaled(loop.alpha + loop.beta))
    return delayed.plus(numerator.times(wall)), slope.plus(numerator_slope.times(wall))


def _numerator(t: Complex, coefficients: tuple[Array, ...]) -> tuple[Complex, Complex]:
    if len(coefficients) == 2:
        slope, value = coefficients
        return t.scaled(slope).shifted(value), Complex(slope, 0.0 * slope)
    second, first, value = coefficients
    inner = t.scaled(second).shifted(first)
    return inner.times(t).shifted(value), t.scaled(2.0 * second).shifted(first)


def _to_power(z: Complex, exponent: int) -> Complex | None:
    """Return z^exponent by repeated squaring, None for 1."""
    result = None
    while exponent:
        if exponent % 2:
            result = z if result is None else result.times(z)
        exponent //= 2
        z = z.times(z)
    return result


_HIGHEST_UNROLLED = 28  # degree; from 33 on unrolled code was up to 100 times slower
_SHORT_FOR_NUMPY = 8  # degree up to which single columns cost less than whole arrays
_LOST_IN_SQUARES = 1e-150  # moduli below are flushed to zero
_SAFETY = 1.0 + 1e-6  # the bounds themselves are rounded


@compiled(static=["degree"], many=MANY, wide=True)
def distance_of_dominant(root: Array, loop: Loop, *, degree: int) -> Array:
    """Return a proved bound of | |1 + root| - spectral radius |, inf where there is no proof.

    The bound includes the rounding of ``modulus``.
    """
    distance = partial(_distance, degree=degree)
    if degree <= _HIGHEST_UNROLLED:
        return distance(root, loop)
    return over_tiles(distance, (root, loop), TILE)


@compiled(many=MANY, wide=True)
def modulus(root: Array) -> Array:
    """Return |1 + root| to 3 ulp."""
    return namespace(root).sqrt(Complex(root.real, root.imag).shifted(1.0).squared_modulus())


def _distance(root: Array, loop: Loop, *, degree: int) -> Array:
    xp = namespace(root, loop)
    t = Complex(root.real, root.imag)
    radius = xp.sqrt(t.shifted(1.0).squared_modulus())
    distance = _distance_to_root(t, radius, loop, degree)
    is_real = t.im == 0.0
    rest, error = _deflated(t, is_real, radius, distance, loop, degree)
    longest = _SHORT_FOR_NUMPY if xp is np else _HIGHEST_UNROLLED
    is_proved = are_all_inside(rest, error, longest) & (is_real | (t.im > distance))
    return xp.where(is_proved, distance + 4.0 * UNIT * radius, xp.inf)


def are_all_inside(polynomial: list[Array], error: Array, longest: int) -> Array:
    """Return True where all roots are proved to be in |z| < 1; highest power first, monic.

    ``longest`` is the degree up to which the steps are unrolled.
    """
    all_inside = _all_inside if len(polynomial) <= longest else _rolled_all_inside
    return all_inside(polynomial, error)


def _distance_to_root(t: Complex, radius: Array, loop: Loop, degree: int) -> Array:
    """Return n |p/p'|, raised by what rounding may have changed."""
    # Each product of complex numbers errs by at most 3 ulp, z^(n-2) therefore by 4 (n - 2), and
    # what it is multiplied with and added to by less than 30 ulp of the same terms taken without
    # their signs.
    xp = namespace(t, loop)
    value, slope = evaluated(t, loop, degree)
    t_size = xp.sqrt(t.squared_modulus())
    plant_error = loop.plant.error / UNIT
    linear, constant = loop.denominator
    linear = linear + plant_error
    denominator = (t_size + linear) * t_size + constant
    first, *inner, last = (abs(c) + plant_error * loop.plant.size for c in loop.numerator)
    numerator, numerator_slope = first * t_size + last, first
    if inner:
        numerator = (first * t_size + inner[0]) * t_size + last
        numerator_slope = 2.0 * first * t_size + inner[0]
    stiffness, damping = abs(loop.alpha), abs(loop.beta)
    wall = stiffness * radius + damping * t_size
    below = _real_power(radius, degree - 3)
    value_terms = below * radius * denominator + numerator * wall
    slope_terms = (
        below * ((degree - 2.0) * denominator + radius * (2.0 * t_size + linear))
        + numerator * (stiffness + damping)
        + numerator_slope * wall
    )
    unit = (4.0 * (degree - 2) + 30.0) * UNIT
    value_size = xp.sqrt(value.squared_modulus()) + unit * value_terms + _LOST_IN_SQUARES
    slope_size = xp.sqrt(slope.squared_modulus()) - unit * slope_terms
    distance = (_SAFETY * degree) * value_size / slope_size
    return xp.where(slope_size > 0.0, distance, xp.inf)


def _real_power(x: Array, exponent: int) -> Array:
    result = namespace(x).ones_like(x)
    for _ in range(exponent):
        result = result * x
    return result


def _deflated(
    t: Complex, is_real: Array, radius: Array, distance: Array, loop: Loop, degree: int
) -> tuple[list[Array], Array]:
    """Return Q(radius z), highest power first, and a bound of the l1 norm of its error."""
    inverse = 1.0 / radius
    powers = [inverse]
    for _ in range(degree - 1):
        powers.append(powers[-1] * inverse)
    rest = divided(t.re + 1.0, is_real, powers, loop.coefficients(degree)[::-1])
    return rest, _error_of_division(rest, powers, distance, loop, degree)


def divided(
    re: Array, is_real: Array, powers: list[Array], coefficients: list[Column]
) -> list[Array]:
    """Return the quotient of p by a root and its conjugate, on the circle of radius 1 now.

    ``re`` is the real part of the root, ``powers`` are those of its inverse modulus from the first
    on, and the coefficients those below the leading 1, highest power first.
    """
    # With s and q their sum and product, b_j = c_j + s b_(j-1) - q b_(j-2).
    xp, degree = namespace(re, coefficients), len(coefficients)
    twice = xp.where(is_real, xp.sign(re), 2.0 * re * powers[0])
    product = xp.where(is_real, 0.0, 1.0)
    is_unrolled = xp is np or degree <= _HIGHEST_UNROLLED
    quotient = _quotient if is_unrolled else _rolled_quotient
    rest = quotient(coefficients[:-1], powers[:-1], twice, product)
    rest[-1] = xp.where(is_real, rest[-1], 0.0)
    return rest


def _error_of_division(
    rest: list[Array], powers: list[Array], distance: Array, loop: Loop, degree: int
) -> Array:
    """Bound the l1 norm of the quotient's error, as after lemma R2."""
    plant = loop.plant
    terms = 1.0 + (1.0 + abs(plant.d1)) * powers[0] + (1.0 + plant.d0) * powers[1]
    for stiff, damp, power in zip(plant.stiff, plant.damp, powers[::-1], strict=False):
        wall = (abs(stiff) + plant.sum) * abs(loop.alpha)
        terms = terms + power * (wall + (abs(damp) + 2.0 * plant.sum) * abs(loop.beta))
    moved = distance * powers[0] + 8.0 * UNIT
    once = (2.0 * degree + 16.0) * UNIT * terms + 4.0 * moved * reduce(add, map(abs, rest))
    xp = namespace(moved)
    return xp.where(degree * moved < 0.5, degree * (degree + 1.0) * once, xp.inf)


def _quotient(
    coefficients: list[Column], powers: list[Array], twice: Array, product: Array
) -> list[Array]:
    rest = [namespace(twice).ones_like(twice)]
    for coefficient, power in zip(coefficients, powers, strict=True):
        follows = twice * rest[-1]
        if len(rest) > 1:
            follows = follows - product * rest[-2]
        rest.append(follows if coefficient is None else follows + coefficient * power)
    return rest


def _rolled_quotient(
    coefficients: list[Column], powers: list[Array], twice: Array, product: Array
) -> list[Array]:
    """Return the same by a loop: the code does not grow with the degree."""
    import jax.numpy as jnp
    from jax import lax

    zero, one = jnp.zeros_like(twice), jnp.ones_like(twice)
    scaled = [
        zero if coefficient is None else coefficient * power
        for coefficient, power in zip(coefficients, powers, strict=True)
    ]

    def divided(last: tuple[Array, Array], added: Array) -> tuple[tuple[Array, Array], Array]:
        follows = twice * last[0] - product * last[1] + added
        return (follows, last[0]), follows

    _, rest = lax.scan(divided, (one, zero), jnp.stack(scaled))
    return [one, *rest]


def _all_inside(polynomial: list[Array], error: Array) -> Array:
    """Return True where all roots are proved to be in |z| < 1; highest power first, monic."""
    xp = namespace(error)
    below = above = whole = xp.ones_like(error)
    quotients = xp.zeros_like(error)
    is_inside = xp.isfinite(error)
    while len(polynomial) > 1:
        first, last = polynomial[0], polynomial[-1]
        lowest, highest = first - abs(last), first + abs(last)
        is_inside = is_inside & (lowest > 0.0)
        below, above, whole = below * lowest, above * highest, whole * first
        quotients = quotients + highest / lowest
        pairs = zip(polynomial[1:-1], polynomial[-2:0:-1], strict=True)
        lowered = [lowest * highest, *(first * a - last * b for a, b in pairs)]
        scale = power_of_two_below_inverse(lowered[0])
        polynomial = [value * scale for value in lowered]
    return is_inside & (_lost(error, above, whole, quotients) < below)


def _rolled_all_inside(polynomial: list[Array], error: Array) -> Array:
    """Return the same by loops over a -> (a - k a*) / z and its reverse, zeros filling both."""
    xp = namespace(error)
    one, zero = xp.ones_like(error), xp.zeros_like(error)

    def lower(state: tuple[Array, ...]) -> tuple[Array, ...]:
        rows, turned, is_inside, below, above, whole, quotients = state
        first, last = rows[0], turned[0]
        lowest, highest = first - abs(last), first + abs(last)
        scale = power_of_two_below_inverse(lowest * highest)
        large, small = first * scale, last * scale
        return (
            xp.concatenate([(lowest * highest * scale)[None], (large * rows - small * turned)[1:]]),
            xp.concatenate([(large * turned - small * rows)[1:], zero[None]]),
            is_inside & (lowest > 0.0),
            below * lowest,
            above * highest,
            whole * first,
            quotients + highest / lowest,
        )

    rows = xp.stack(polynomial)
    half = len(polynomial) // 2
    start = rows, rows[::-1], xp.isfinite(error), one, one, one, zero
    rows, turned, *rest = repeat(half, lower, start)
    # Half of the coefficients are left.
    halves = rows[:-half], turned[:-half], *rest
    _, _, is_inside, below, above, whole, quotients = repeat(
        len(polynomial) - 1 - half, lower, halves
    )
    return is_inside & (_lost(error, above, whole, quotients) < below)


def _lost(error: Array, above: Array, whole: Array, quotients: Array) -> Array:
    """Bound what the polynomial's own error and the rounding of all steps come to at the end."""
    return _SAFETY * (error * whole + 8.0 * UNIT * above * quotients)


# Spectral radius and its error over many points by dominant roots, wherever these can be proved.
#
# Each point is computed independently of the others. Where the first try is not proved to
# ``TOLERANCE``, mostly because two roots have nearly the same modulus, the next one squares the
# power of z more often. The few points that are then still open have multiple or nearly equal
# dominant roots.

LONGEST_DELAY = 64.0  # beyond, polynomials of many points do not stay in the cache
TOLERANCE = 1e-12
_LIST = 2**18  # up to this many points, lists are filled up to a length compiled once for all
_SHORTEST_LIST = 8
_BLOCK = 2**21  # points of a larger grid that are computed at once

Values = np.ndarray[Any, np.dtype[Any]]
Indices = Int64[np.ndarray, " point"]
Answer = tuple[Array, Array]  # value and error


class _Try(NamedTuple):
    """What is spent on a point: squarings of a power of z, 0 for a closed form; Newton steps."""

    doublings: int
    corrections: int
    longest_list: int


def fast_radius(parameters: list[Array], shape: tuple[int, ...], delay: float) -> Answer:
    """Value and error of the spectral radius, by XLA; the error is inf if nothing is proved.

    ``parameters`` are alpha, beta, gamma, delta, checked; the delay is at most LONGEST_DELAY.
    JAX arrays stay on their device; the host sees only the indices of points still open.
    """
    first, *others = _tries(delay)
    if is_any_jax(parameters):
        loop = _loop(parameters, delay)
        answer = _radius(loop, degree=polynomial_degree(delay), effort=first)
        value, error = (namespace(column).broadcast_to(column, shape) for column in answer)
    else:
        value, error = np.empty(shape), np.empty(shape)
        if value.size > _LIST:
            for part, block in _blocks(parameters, shape):
                value[part], error[part] = _tried(_loop(block, delay), delay, first)
        else:
            _try_list((value, error), parameters, np.arange(value.size), delay, first)
    for effort in others:
        still_open = true_indices(~(error <= TOLERANCE))
        value, error = _try_list((value, error), parameters, still_open, delay, effort)
    return value, error


def _try_list(
    answer: Answer, parameters: list[Array], indices: Indices, delay: float, effort: _Try
) -> Answer:
    """Return the answer with new results at flat indices."""
    shape = answer[0].shape
    plants = prod(np.broadcast_shapes(*(hand.shape for hand in parameters[2:])))
    shared = _loop(parameters, delay) if plants <= indices.size else None
    longest, shortest = effort.longest_list, _SHORTEST_LIST
    if is_any_jax(parameters):  # an accelerator computes a long list as quickly as a short one
        longest = shortest = longest if is_on_cpu() else _LIST
    columns: list[Answer] = []
    for part, padded in lists(indices, longest, shortest):
        if shared:
            loop = Loop(*looked_up(shared, shape, padded))
        else:
            loop = _loop(looked_up(parameters, shape, padded), delay)
        columns.append(take(_tried(loop, delay, effort), slice(part.size)))
    if not columns:
        return answer
    return tree_map(lambda old, new: with_values(old, indices, new), answer, joined(columns))


def _loop(parameters: list[Array], delay: float) -> Loop:
    """Return loops with their plants, which are computed on the smallest grid that holds them."""
    alpha, beta, gamma, delta = parameters
    fraction = delay % 1.0
    plant = float_plant(gamma, delta, np.float64(fraction), is_fractional=fraction > 0.0)
    return Loop(alpha, beta, gamma, plant)


def _tried(loop: Loop, delay: float, effort: _Try) -> Answer:
    radius = partial(_radius, degree=polynomial_degree(delay), effort=effort)
    return radius(loop) if is_any_jax(loop) else on_few_sizes(radius, loop)


def _radius(loop: Loop, *, degree: int, effort: _Try) -> Answer:
    root = dominant_root(
        loop, degree=degree, doublings=effort.doublings, corrections=effort.corrections
    )
    return modulus(root), distance_of_dominant(root, loop, degree=degree)


def _tries(delay: float) -> tuple[_Try, ...]:
    if delay <= 10.0:
        return _Try(8, 2, 2**15) if delay else _Try(0, 1, 2**15), _Try(16, 8, 2**15)
    if delay <= 21.0:
        return _Try(4, 4, 2**15), _Try(8, 4, 2**12), _Try(14, 8, 2**10)
    return _Try(5 if delay <= 50.0 else 7, 4, 2**12), _Try(14, 8, 2**10)


def _blocks(
    parameters: list[Values], shape: tuple[int, ...]
) -> Iterator[tuple[tuple[slice, ...], list[Values]]]:
    """Cut a grid across its longest axis; yield the index of each part and its parameters."""
    aligned = [
        values.reshape((1,) * (len(shape) - values.ndim) + values.shape) for values in parameters
    ]
    axis = int(np.argmax(shape))
    rows = max(1, _BLOCK * shape[axis] // prod(shape))
    for start in range(0, shape[axis], rows):
        part = (slice(None),) * axis + (slice(start, start + rows),)
        yield part, [values[part] if values.shape[axis] > 1 else values for values in aligned]
