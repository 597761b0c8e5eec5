"""The dominant root of p(z) without eigenvalues, point by point, and a proof that it is dominant.

Only elementwise operations, the same for every point: a compiler keeps all of it in registers.
``power_iteration`` makes the guess.

**Newton** works on t = z - 1, where the terms of

    p(z) = z^(n-2) D(z) + N(z) (alpha z + beta t),    D = t^2 + (1 - d0 + D(1)) t + D(1)

are as small as the gains that make them, so slow loops with roots close to 1 lose no digits.

**Proof.** p of degree n has a root z1 within n |p(z) / p'(z)| of any z, a multiple root too: that
is ``distance``, the rounding of p and p' included. Divided by z1, and by its conjugate where there
is one, p leaves Q(z). If all roots of Q are proved to be inside the circle through z, z1 is
dominant. The Schur-Cohn steps a -> (a - k a*) / z (1 - k^2) from Q down to a constant give, with
the k that were computed, however wrong, a polynomial with all roots inside and on the circle the
modulus

    prod (1 - |k|)  at least, while its coefficients sum up to  prod (1 + |k|)  at most;

Q is no further from it than its own error and what the steps rounded, each step's rounding being
raised by the steps before it: by Rouche's theorem Q has all roots inside too if that is less than
the modulus. So the proof needs no more precision than the distance to the second largest root asks.

Sources: eq. (9) in the form of the design; Schur (1917), Cohn (1922); Henrici, Applied and
Computational Complex Analysis I, 6.4, for the distance.
"""

from functools import partial, reduce
from operator import add
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxstab.point.radius.cubic import largest_root
from jaxstab.point.radius.power_iteration import (
    Column,
    guessed_root,
    plus,
    power_of_two_below_inverse,
    reciprocal,
)
from jaxstab.point.verdict.door import over_tiles
from jaxstab.point.verdict.loop import Plant
from jaxstab.point.verdict.recursion import FLOAT_UNIT
from jaxstab.wide_vectors import wide_jit

_LONGEST_UNROLLED = 4000  # about as many products; beyond, code was up to 100 times slower
_HIGHEST_UNROLLED = 28  # degree of such a proof; the same happens from 33 on
_TILE = 256  # points whose polynomials of a higher degree stay in the cache
_LOST_IN_SQUARES = 1e-150  # moduli below are flushed to zero
_SAFETY = 1.0 + 1e-6  # the bounds themselves are rounded


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
            columns[power] = plus(columns[power], stiff * self.alpha - damp * self.beta)
        return columns


class _Complex(NamedTuple):
    """Real and imaginary part: XLA fuses them better than complex numbers."""

    re: Array
    im: Array

    def times(self, other: "_Complex") -> "_Complex":
        return _Complex(
            self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re
        )

    def scaled(self, factor: Array | float) -> "_Complex":
        return _Complex(self.re * factor, self.im * factor)

    def plus(self, other: "_Complex") -> "_Complex":
        return _Complex(self.re + other.re, self.im + other.im)

    def shifted(self, number: Array | float) -> "_Complex":
        return _Complex(self.re + number, self.im)

    def squared_modulus(self) -> Array:
        return self.re * self.re + self.im * self.im


@partial(wide_jit, static_argnames=("degree", "doublings", "corrections"))
def dominant_root(loop: Loop, *, degree: int, doublings: int, corrections: int = 2) -> Array:
    """Return t = z - 1 of a root z >= 0 that is likely dominant, as a complex array.

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
    return root(loop) if is_unrolled else over_tiles(root, (loop,), _TILE)


@partial(wide_jit, static_argnames=("degree",))
def distance_of_dominant(root: Array, loop: Loop, *, degree: int) -> Array:
    """Return a proved bound of | |1 + root| - spectral radius |, inf where there is no proof.

    It covers |1 + root| being rounded as ``modulus`` does.
    """
    distance = partial(_distance, degree=degree)
    if degree <= _HIGHEST_UNROLLED:
        return distance(root, loop)
    return over_tiles(distance, (root, loop), _TILE)


@wide_jit
def modulus(root: Array) -> Array:
    """Return |1 + root| to 3 ulp."""
    return jnp.sqrt(_Complex(root.real, root.imag).shifted(1.0).squared_modulus())


def _root(loop: Loop, *, degree: int, doublings: int, corrections: int, is_unrolled: bool) -> Array:
    t = _guess(loop.coefficients(degree), doublings, is_unrolled)
    for _ in range(corrections):
        t = _newton(t, loop, degree)
    return lax.complex(t.re, t.im)


def _guess(coefficients: list[Column], doublings: int, is_unrolled: bool) -> _Complex:
    if doublings == 0:
        c, b, a = (jnp.asarray(coefficient) for coefficient in coefficients)
        return _Complex(*largest_root(a, b, c)).shifted(-1.0)
    return _Complex(*guessed_root(coefficients, doublings, is_unrolled=is_unrolled))


# ------------------------------------------------------------------------------------------ Newton


def _newton(t: _Complex, loop: Loop, degree: int) -> _Complex:
    value, slope = _evaluated(t, loop, degree)
    inverse = reciprocal(slope.squared_modulus())
    correction = value.times(_Complex(slope.re, -slope.im)).scaled(-inverse)
    return t.plus(correction)


def _evaluated(t: _Complex, loop: Loop, degree: int) -> tuple[_Complex, _Complex]:
    """Return p and its derivative at z = 1 + t."""
    z = t.shifted(1.0)
    linear, constant = loop.denominator
    denominator = t.shifted(linear).times(t).shifted(constant)
    wall = z.scaled(loop.alpha).plus(t.scaled(loop.beta))
    numerator, numerator_slope = _numerator(t, loop.numerator)
    below = _to_power(z, degree - 3)  # z^(n-3)
    delayed = z.times(denominator)
    delayed_slope = denominator.scaled(degree - 2.0).plus(
        z.times(_Complex(2.0 * t.re + linear, 2.0 * t.im))
    )
    if below is not None:
        delayed, delayed_slope = below.times(delayed), below.times(delayed_slope)
    slope = delayed_slope.plus(numerator.scaled(loop.alpha + loop.beta))
    return delayed.plus(numerator.times(wall)), slope.plus(numerator_slope.times(wall))


def _numerator(t: _Complex, coefficients: tuple[Array, ...]) -> tuple[_Complex, _Complex]:
    """Return N and its derivative."""
    if len(coefficients) == 2:
        slope, value = coefficients
        return t.scaled(slope).shifted(value), _Complex(slope, jnp.zeros_like(slope))
    second, first, value = coefficients
    inner = t.scaled(second).shifted(first)
    return inner.times(t).shifted(value), t.scaled(2.0 * second).shifted(first)


def _to_power(z: _Complex, exponent: int) -> _Complex | None:
    """Return z^exponent by repeated squaring, None for 1."""
    result = None
    while exponent:
        if exponent % 2:
            result = z if result is None else result.times(z)
        exponent //= 2
        z = z.times(z)
    return result


# --------------------------------------------------------------------------------------- the proof


def _distance(root: Array, loop: Loop, *, degree: int) -> Array:
    t = _Complex(root.real, root.imag)
    radius = jnp.sqrt(t.shifted(1.0).squared_modulus())
    distance = _distance_to_root(t, radius, loop, degree)
    is_real = t.im == 0.0
    rest, error = _deflated(t, is_real, radius, distance, loop, degree)
    all_inside = _all_inside if degree <= _HIGHEST_UNROLLED else _rolled_all_inside
    is_proved = all_inside(rest, error) & (is_real | (t.im > distance))
    return jnp.where(is_proved, distance + 4.0 * FLOAT_UNIT * radius, jnp.inf)


def _distance_to_root(t: _Complex, radius: Array, loop: Loop, degree: int) -> Array:
    """Return n |p/p'|, raised by what rounding may have changed.

    Each product of complex numbers loses at most 3 ulp, z^(n-2) therefore 4 (n - 2), and what it is
    multiplied with and added to less than 30 ulp of the same terms taken without their signs.
    """
    value, slope = _evaluated(t, loop, degree)
    t_size = jnp.sqrt(t.squared_modulus())
    plant_error = loop.plant.error / FLOAT_UNIT
    linear, constant = loop.denominator
    linear = linear + plant_error
    denominator = (t_size + linear) * t_size + constant
    first, *inner, last = (jnp.abs(c) + plant_error * loop.plant.size for c in loop.numerator)
    numerator, numerator_slope = first * t_size + last, first
    if inner:
        numerator = (first * t_size + inner[0]) * t_size + last
        numerator_slope = 2.0 * first * t_size + inner[0]
    stiffness, damping = jnp.abs(loop.alpha), jnp.abs(loop.beta)
    wall = stiffness * radius + damping * t_size
    below = _real_power(radius, degree - 3)
    value_terms = below * radius * denominator + numerator * wall
    slope_terms = (
        below * ((degree - 2.0) * denominator + radius * (2.0 * t_size + linear))
        + numerator * (stiffness + damping)
        + numerator_slope * wall
    )
    unit = (4.0 * (degree - 2) + 30.0) * FLOAT_UNIT
    value_size = jnp.sqrt(value.squared_modulus()) + unit * value_terms + _LOST_IN_SQUARES
    slope_size = jnp.sqrt(slope.squared_modulus()) - unit * slope_terms
    distance = (_SAFETY * degree) * value_size / slope_size
    return jnp.where(slope_size > 0.0, distance, jnp.inf)


def _real_power(x: Array, exponent: int) -> Array:
    result = jnp.ones_like(x)
    for _ in range(exponent):
        result = result * x
    return result


def _deflated(
    t: _Complex, is_real: Array, radius: Array, distance: Array, loop: Loop, degree: int
) -> tuple[list[Array], Array]:
    """Return Q(radius z), highest power first, and a bound of the l1 norm of its error.

    The coefficients obey b_j = c_j + s b_(j-1) - q b_(j-2), where s and q are sum and product of
    the root and its conjugate, on the circle of radius 1 now. What goes wrong in one b_j goes on
    with factors (sin k theta / sin theta) of at most k.
    """
    inverse = 1.0 / radius
    plant = loop.plant
    coefficients = loop.coefficients(degree)[::-1]
    powers = [inverse]
    for _ in range(degree - 1):
        powers.append(powers[-1] * inverse)
    twice = jnp.where(is_real, jnp.sign(t.re + 1.0), 2.0 * (t.re + 1.0) * inverse)
    product = jnp.where(is_real, 0.0, 1.0)
    divided = _quotient if degree <= _HIGHEST_UNROLLED else _rolled_quotient
    rest = divided(coefficients[:-1], powers[:-1], twice, product)
    rest[-1] = jnp.where(is_real, rest[-1], 0.0)

    terms = 1.0 + (1.0 + jnp.abs(plant.d1)) * powers[0] + (1.0 + plant.d0) * powers[1]
    for stiff, damp, power in zip(plant.stiff, plant.damp, powers[::-1], strict=False):
        wall = (jnp.abs(stiff) + plant.sum) * jnp.abs(loop.alpha)
        terms = terms + power * (wall + (jnp.abs(damp) + 2.0 * plant.sum) * jnp.abs(loop.beta))
    moved = distance * inverse + 8.0 * FLOAT_UNIT
    once = (2.0 * degree + 16.0) * FLOAT_UNIT * terms + 4.0 * moved * _size_sum(rest)
    grown = degree * (degree + 1.0) * once
    return rest, jnp.where(degree * moved < 0.5, grown, jnp.inf)


def _quotient(
    coefficients: list[Column], powers: list[Array], twice: Array, product: Array
) -> list[Array]:
    rest = [jnp.ones_like(twice)]
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
    below = above = whole = jnp.ones_like(error)
    quotients = jnp.zeros_like(error)
    is_inside = jnp.isfinite(error)
    while len(polynomial) > 1:
        first, last = polynomial[0], polynomial[-1]
        lowest, highest = first - jnp.abs(last), first + jnp.abs(last)
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
    one, zero = jnp.ones_like(error), jnp.zeros_like(error)

    def lower(_: Array, state: tuple[Array, ...]) -> tuple[Array, ...]:
        rows, turned, is_inside, below, above, whole, quotients = state
        first, last = rows[0], turned[0]
        lowest, highest = first - jnp.abs(last), first + jnp.abs(last)
        scale = power_of_two_below_inverse(lowest * highest)
        kept, taken = first * scale, last * scale
        lowered = (kept * rows - taken * turned).at[0].set(lowest * highest * scale)
        return (
            lowered,
            jnp.concatenate([(kept * turned - taken * rows)[1:], zero[None]]),
            is_inside & (lowest > 0.0),
            below * lowest,
            above * highest,
            whole * first,
            quotients + highest / lowest,
        )

    rows = jnp.stack(polynomial)
    half = len(polynomial) // 2
    start = rows, rows[::-1], jnp.isfinite(error), one, one, one, zero
    rows, turned, *rest = lax.fori_loop(0, half, lower, start)
    # Half of the coefficients are left.
    halves = rows[:-half], turned[:-half], *rest
    state: tuple[Array, ...] = lax.fori_loop(half, len(polynomial) - 1, lower, halves)
    _, _, is_inside, below, above, whole, quotients = state
    return is_inside & (_lost(error, above, whole, quotients) < below)


def _lost(error: Array, above: Array, whole: Array, quotients: Array) -> Array:
    """Bound what the polynomial's own error and the rounding of all steps come to at the end."""
    return _SAFETY * (error * whole + 8.0 * FLOAT_UNIT * above * quotients)


def _size_sum(columns: list[Array]) -> Array:
    return reduce(add, (jnp.abs(column) for column in columns))
