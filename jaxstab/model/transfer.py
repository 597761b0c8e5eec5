"""Transfer functions in z as quotients of polynomials, in pairs of float64."""

from functools import reduce
from typing import NamedTuple

from jaxstab.arrays import Array
from jaxstab.model.double_double import DoubleDouble

Polynomial = tuple[DoubleDouble, ...]  # highest power of z first


class Transfer(NamedTuple):
    """z^-lag numerator(z) / denominator(z), the denominator monic.

    ``sizes`` bound the sums of the moduli of the coefficients of numerator and denominator. The
    coefficients' errors are below 2^-91 of them (lemma V8).
    """

    numerator: Polynomial
    denominator: Polynomial
    lag: int
    sizes: tuple[Array, Array]

    @classmethod
    def of(cls, numerator: Polynomial, denominator: Polynomial, lag: int) -> "Transfer":
        """Return a transfer function with its sizes."""
        return cls(numerator, denominator, lag, (size_of(numerator), size_of(denominator)))

    def times(self, other: "Transfer") -> "Transfer":
        """Return the product of two transfer functions."""
        return Transfer(
            product(self.numerator, other.numerator),
            product(self.denominator, other.denominator),
            self.lag + other.lag,
            (self.sizes[0] * other.sizes[0], self.sizes[1] * other.sizes[1]),
        )

    def scaled(self, factor: DoubleDouble) -> "Transfer":
        """Return a multiple."""
        numerator = tuple(coefficient * factor for coefficient in self.numerator)
        return self._replace(
            numerator=numerator, sizes=(self.sizes[0] * abs(factor.hi), self.sizes[1])
        )

    def at(self, z: float) -> tuple[DoubleDouble, DoubleDouble]:
        """Return numerator and denominator at z."""
        above, below = (reduce(lambda value, c: value * z + c, one) for one in self[:2])
        return above, below

    @property
    def order(self) -> int:
        """The number of its poles, those at z = 0 included."""
        return len(self.denominator) - 1 + max(self.lag, 0)


def product(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return the product of two polynomials; those of windows have few terms that are not 0."""
    terms: list[list[DoubleDouble]] = [[] for _ in range(len(a) + len(b) - 1)]
    others = [(j, other) for j, other in enumerate(b) if not _is_zero(other)]
    for i, one in enumerate(a):
        for j, other in [] if _is_zero(one) else others:
            terms[i + j].append(one * other)
    if not all(terms):
        nothing = (a[0] * b[0]).scaled(0.0)  # of the shape of all
        terms = [column or [nothing] for column in terms]
    return tuple(reduce(DoubleDouble.__add__, column) for column in terms)


def _is_zero(number: DoubleDouble) -> bool:
    return type(number.hi) is float and number.hi == 0.0


def size_of(polynomial: Polynomial) -> Array:
    """Return the sum of the moduli of the coefficients."""
    return sum((abs(coefficient.hi) for coefficient in polynomial), 0.0)


ONE: Polynomial = (DoubleDouble(1.0, 0.0),)
UNIT = Transfer.of(ONE, ONE, 0)
