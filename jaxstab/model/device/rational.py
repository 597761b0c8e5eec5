"""Exact rational functions of s, whose coefficients are rational numbers times powers of pi.

Numbers that users give are float64, rational numbers therefore; a frequency in Hz brings a factor
pi. As pi is no root of a polynomial with rational coefficients, it is a second variable here, and
what cancels is found exactly. Numbers that stand for all of an interval are polynomials in a third
variable. Only where such numbers are asked for python-flint is imported.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from threading import RLock
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from flint import arb, fmpq, fmpq_mpoly, fmpq_mpoly_ctx

_PRECISION = RLock()


@contextmanager
def working_precision(bits: int) -> Iterator[None]:
    """Compute with balls of so many bits, one thread at a time, and restore the precision before.

    The precision of python-flint is one number of the whole process. Balls hold the true value at
    any precision: threads of a program that set it meanwhile can cost an answer its digits, or end
    it in an error, but cannot make it wrong.
    """
    import flint

    with _PRECISION, flint.ctx.workprec(bits):
        yield


@dataclass(frozen=True)
class Span:
    """All numbers of an interval: first + t (last - first), t from 0 to 1."""

    first: float
    last: float

    def __format__(self, spec: str) -> str:
        return f"{format(self.first, spec)}..{format(self.last, spec)}"


Number = float | Span


class Rational(NamedTuple):
    """A quotient of two polynomials in s, pi and t; the denominator is not 0."""

    numerator: "fmpq_mpoly"
    denominator: "fmpq_mpoly"

    def plus(self, other: "Rational") -> "Rational":
        """Return the sum."""
        if self.denominator == other.denominator:
            return Rational(self.numerator + other.numerator, self.denominator)
        return Rational(
            self.numerator * other.denominator + other.numerator * self.denominator,
            self.denominator * other.denominator,
        )

    def times(self, other: "Rational") -> "Rational":
        """Return the product."""
        return Rational(self.numerator * other.numerator, self.denominator * other.denominator)

    def in_series(self, other: "Rational") -> "Rational":
        """Return 1 / (1/a + 1/b): two dynamic stiffnesses that bear the same force."""
        (a, b), (c, d) = self, other
        return Rational(a * c, a * d + c * b)

    def held_by(self, stiffness: "Rational") -> "Rational":
        """Return the compliance G / (1 + G Z) of what a dynamic stiffness Z holds."""
        (n, d), (z, y) = self, stiffness
        return Rational(n * y, d * y + n * z)

    def reduced(self) -> tuple["Rational", "fmpq_mpoly"]:
        """Return the function without its common factor, and that factor; equals are equal then."""
        common = self.numerator.gcd(self.denominator)
        above, below = self.numerator / common, self.denominator / common
        first = below.leading_coefficient()
        return Rational(above / first, below / first), common

    @property
    def degrees(self) -> tuple[int, int]:
        """The degrees in s of numerator and denominator; -1 for 0."""
        return degree_of(self.numerator), degree_of(self.denominator)


def degree_of(polynomial: "fmpq_mpoly") -> int:
    """Return the degree in s, -1 for 0."""
    return max((int(powers[0]) for powers in polynomial.monoms()), default=-1)


def rational(numerator: Sequence[Number], denominator: Sequence[Number]) -> Rational:
    """Return a function by the coefficients of its polynomials, highest power of s first."""
    return Rational(polynomial(numerator), polynomial(denominator))


def polynomial(falling: Sequence["Number | fmpq"]) -> "fmpq_mpoly":
    """Return the polynomial with these coefficients, highest power of s first."""
    degree = len(falling) - 1
    s = _ring().gen(0)
    return sum(exact(value) * s ** (degree - k) for k, value in enumerate(falling)) + 0 * s


def turn(hertz: Number) -> "fmpq_mpoly":
    """Return 2 pi f for a frequency in Hz."""
    return 2 * exact(hertz) * _ring().gen(1)


def exact(value: "Number | fmpq") -> Any:
    """Return the rational number that a float64 is, and what a span is as a polynomial in t."""
    from flint import fmpq

    if isinstance(value, Span):
        first, last = exact(value.first), exact(value.last)
        return first + (last - first) * _ring().gen(2)
    return fmpq(*value.as_integer_ratio()) if isinstance(value, float) else value


def balls_of(polynomial: "fmpq_mpoly", t: Any = None) -> list["arb"]:
    """Return the coefficients of the powers of s, lowest first, in balls of the precision set.

    ``t`` is a real or complex ball: where in their spans numbers are.
    """
    from flint import arb

    coefficients = [arb(0)] * (degree_of(polynomial) + 1)
    for (power, power_of_pi, power_of_t), factor in polynomial.to_dict().items():
        term = arb(factor) * arb.pi() ** power_of_pi
        coefficients[power] += term * t**power_of_t if power_of_t else term
    return coefficients


@cache
def _ring() -> "fmpq_mpoly_ctx":
    from flint import fmpq_mpoly_ctx

    return fmpq_mpoly_ctx.get(("s", "pi", "t"), "lex")
