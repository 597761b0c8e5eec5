"""Unevaluated sums of two float64 numbers: about 31 decimal digits, in NumPy and in compiled JAX.

The plant coefficients and the coefficients of p(z) are sums that can cancel for any gains a user
may choose; computed in pairs and rounded once, each is right to the last digit.

The rounding error of a float64 sum is itself a float64 number, and five more additions compute it
(Knuth, TAOCP 4.2.2). That of a product follows from the four products of the factors' upper and
lower halves (Dekker 1971). An operation on pairs applies these to the high numbers, adds what the
low numbers contribute, and renormalises the result (the accurate variants of Joldes, Muller and
Popescu 2017). XLA rewrites sums, which ``jaxstab.arrays.kept`` prevents, and fuses a product with a
sum, which changes nothing where the products are exact, as those of halves are.

JAX is given the derivatives of the whole operations, in float64: those of each step say no more
and take four times as long to compile.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from struct import Struct
from typing import Any, Union

import numpy as np

from jaxstab.arrays import Array, is_jax, kept, load_jax, namespace, pytree, tree_map

_UPPER_HALF = np.uint64(0xFFFFFFFFF8000000)  # sign, exponent and 26 bits of the significand
_FLOAT, _BITS = Struct("<d"), Struct("<Q")


@pytree
@dataclass(frozen=True, slots=True)
class DoubleDouble:
    """The number ``hi + lo`` with ``|lo| <= ulp(hi) / 2``.

    Relative error of one ``+`` or ``-`` below 2^-104 (Joldes, Muller, Popescu 2017), of ``*`` and
    ``/`` below 2^-100 (lemma V7 of docs/proofs.md). The fields are arrays of one shape; overflow
    beyond about 1e300 gives NaN.
    """

    hi: Array
    lo: Array = 0.0

    @classmethod
    def from_value(cls, value: Union[Array, float, Fraction, "DoubleDouble"]) -> "DoubleDouble":
        """Return a float64 array, a Python float or a pair, unchanged in value, as a pair.

        A whole number or a fraction is rounded to a pair.
        """
        if isinstance(value, DoubleDouble):
            return value
        if type(value) is float:  # many times faster than a NumPy array of one
            return cls(value)
        if isinstance(value, int | Fraction):
            hi = float(value)
            return cls(hi, float(value - Fraction(hi)))
        xp = namespace(value)
        hi = xp.asarray(value, xp.float64)
        return DoubleDouble(hi, xp.zeros_like(hi))

    def __getitem__(self, index: Any) -> "DoubleDouble":
        return DoubleDouble(self.hi[index], self.lo[index])

    def __add__(self, other: Union[Array, float, "DoubleDouble"]) -> "DoubleDouble":
        return _of_namespace(_sum, self, other)

    def __radd__(self, other: int | Fraction) -> "DoubleDouble":
        return self + other

    def __neg__(self) -> "DoubleDouble":
        return DoubleDouble(-self.hi, -self.lo)

    def __sub__(self, other: Union[Array, float, "DoubleDouble"]) -> "DoubleDouble":
        return self + (-other)

    def __rsub__(self, other: int | Fraction) -> "DoubleDouble":
        return -self + other

    def __mul__(self, other: Union[Array, float, "DoubleDouble"]) -> "DoubleDouble":
        return _of_namespace(_product, self, other)

    def __rmul__(self, other: int | Fraction) -> "DoubleDouble":
        return self * other

    def __truediv__(self, other: Union[Array, float, "DoubleDouble"]) -> "DoubleDouble":
        return _of_namespace(_quotient, self, other)

    def scaled(self, power_of_two: Array | float) -> "DoubleDouble":
        """Multiply by a power of two, which is exact."""
        return DoubleDouble(self.hi * power_of_two, self.lo * power_of_two)

    def rounded(self) -> Array:
        """Return the nearest float64."""
        return self.hi + self.lo


Factor = Array | float | DoubleDouble
Operation = Callable[[DoubleDouble, Factor], DoubleDouble]


def _sum(pair: DoubleDouble, other: Factor) -> DoubleDouble:
    if not isinstance(other, DoubleDouble):
        high, high_error = two_sum(pair.hi, other)
        return DoubleDouble(*_quick_two_sum(high, high_error + pair.lo))
    high, high_error = two_sum(pair.hi, other.hi)
    low, low_error = two_sum(pair.lo, other.lo)
    high, high_error = _quick_two_sum(high, high_error + low)
    return DoubleDouble(*_quick_two_sum(high, high_error + low_error))


def _product(pair: DoubleDouble, other: Factor) -> DoubleDouble:
    if not isinstance(other, DoubleDouble):
        high, error = two_product(pair.hi, other)
        return DoubleDouble(*_quick_two_sum(high, error + pair.lo * other))
    high, error = two_product(pair.hi, other.hi)
    return DoubleDouble(*_quick_two_sum(high, error + (pair.hi * other.lo + pair.lo * other.hi)))


def _quotient(pair: DoubleDouble, other: Factor) -> DoubleDouble:
    other = DoubleDouble.from_value(other)
    quotient = pair.hi / other.hi
    remainder = _sum(pair, -_product(other, quotient))
    correction = remainder.hi / other.hi
    second_correction = _sum(remainder, -_product(other, correction)).hi / other.hi
    return _sum(DoubleDouble(*_quick_two_sum(quotient, correction)), second_correction)


_SLOPES: dict[Operation, Callable[..., Array]] = {  # of result, numbers and how these move
    _sum: lambda result, pair, other, move, other_move: move + other_move,
    _product: lambda result, pair, other, move, other_move: move * other + pair * other_move,
    _quotient: lambda result, pair, other, move, other_move: (move - result * other_move) / other,
}


def _of_namespace(operation: Operation, pair: DoubleDouble, other: Factor) -> DoubleDouble:
    if isinstance(other, int | Fraction):
        other = DoubleDouble.from_value(other)
    if not is_jax(pair.hi) and not is_jax(leading(other)):
        return operation(pair, other)
    return _differentiable(operation)(*tree_map(namespace(pair, other).asarray, (pair, other)))


def leading(value: Factor) -> Array:
    """Return the number rounded to float64, its sign being exact."""
    return value.hi if isinstance(value, DoubleDouble) else value


def size(value: Factor) -> Array:
    """Return the absolute value, to float64 accuracy."""
    return abs(leading(value))


def size_sum(numbers: Iterable[Factor]) -> Array:
    """Return the sum of the absolute values."""
    return sum(map(size, numbers), 0.0)


@cache
def _differentiable(operation: Operation) -> Operation:
    with_slopes: Any = load_jax().custom_jvp(operation)

    def moved(numbers: tuple[Any, ...], moves: tuple[Any, ...]) -> tuple[DoubleDouble, ...]:
        result = with_slopes(*numbers)
        steps = [move.rounded() if isinstance(move, DoubleDouble) else move for move in moves]
        step = _SLOPES[operation](result.hi, *map(leading, numbers), *steps)
        step = namespace(result).broadcast_to(step, result.hi.shape)
        return result, DoubleDouble.from_value(step)

    with_slopes.defjvp(moved)
    return with_slopes


def two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Return ``fl(a + b)`` and the rounding error of it, exactly (Knuth)."""
    total = kept(a + b)
    b_seen = total - a
    return total, (a - (total - b_seen)) + (b - b_seen)


def two_product(a: Array, b: Array) -> tuple[Array, Array]:
    """Return ``a b`` rounded and the error of it; their sum is right to 2^-101 relative."""
    halves_underflow = 1e-270  # below, products of halves are flushed to zero: rounded once instead
    # It is summed from products of half significands, which are exact. XLA contracts a product and
    # a sum to one fused operation as it likes: with exact products that changes nothing. A product
    # below 1e-270 is only rounded.
    a_high, a_low = _halves(a)
    b_high, b_low = _halves(b)
    middle, middle_error = two_sum(a_high * b_low, a_low * b_high)
    product, error = _quick_two_sum(a_high * b_high, middle)
    error = error + (middle_error + a_low * b_low)
    underflows = abs(product) < halves_underflow
    if type(underflows) is bool:
        return (a * b, 0.0) if underflows else (product, error)
    xp = namespace(a, b)
    return xp.where(underflows, a * b, product), xp.where(underflows, 0.0, error)


def _quick_two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    total = kept(a + b)
    return total, b - (total - a)


def _halves(a: Array) -> tuple[Array, Array]:
    bits: Array
    if type(a) is float:
        (bits,) = _BITS.unpack(_FLOAT.pack(a))
        (high,) = _FLOAT.unpack(_BITS.pack(bits & int(_UPPER_HALF)))
    elif is_jax(a):
        lax = load_jax().lax
        bits = lax.bitcast_convert_type(a, np.uint64) & _UPPER_HALF
        high = lax.bitcast_convert_type(bits, np.float64)
    else:
        bits = np.asarray(a, np.float64).view(np.uint64)
        high = (bits & _UPPER_HALF).view(np.float64)
    return high, a - high
