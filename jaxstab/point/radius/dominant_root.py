"""The dominant root of p(z) without eigenvalues, point by point.

Only elementwise operations, the same for every point: a compiler keeps all of it in registers.
``power_iteration`` makes the guess; Newton's method works on t = z - 1, where the terms of

    p(z) = z^(n-2) D(z) + N(z) (alpha z + beta t),    D = t^2 + (1 - d0 + D(1)) t + D(1)

are as small as the gains that make them, so slow loops with roots close to 1 lose no digits. That a
root is dominant is proved in ``dominance``.

Source: eq. (9) in the form of the design.
"""

from functools import partial
from typing import Any, NamedTuple

from jaxstab.arrays import Array
from jaxstab.batches import compiled, over_tiles
from jaxstab.point.radius.elementary import reciprocal
from jaxstab.point.verdict.loop import Plant

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
    from jaxstab.point.radius.cubic import largest_root
    from jaxstab.point.radius.power_iteration import guessed_root

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
    """Return N and its derivative."""
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
