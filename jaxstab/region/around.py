"""Polynomials in powers of zeta and of zeta - 1, in double-double and as rows of numbers."""

from collections.abc import Sequence
from functools import cache
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.transfer import Polynomial, product, size_of

_ZERO = DoubleDouble(0.0, 0.0)
_NOTHING = 1e-25  # of the size of a polynomial: pairs that are rounding
_STEPS = np.linspace(0.0, 1.5, 151)[1:]  # of zeta - 1: on a half of the circle at most sqrt(2)

Coefficients = Float64[np.ndarray, " _"]


class Around(NamedTuple):
    """A polynomial in powers of zeta and of s = zeta - 1, highest power first."""

    straight: Polynomial
    shifted: Polynomial

    @classmethod
    def of(cls, polynomial: Polynomial) -> "Around":
        """Return a polynomial with its powers of s, of which rounding is taken for 0."""
        nothing = _NOTHING * size_of(polynomial)
        shifted = (c if abs(c.hi) >= nothing else _ZERO for c in _shifted(polynomial))
        return cls(polynomial, tuple(shifted))

    def times(self, other: "Around") -> "Around":
        """Return the product."""
        both = zip(self, other, strict=True)
        return Around(*(product(one, two) for one, two in both))

    @property
    def value(self) -> DoubleDouble:
        """Q(1)."""
        return self.shifted[-1]

    def with_value(self, value: DoubleDouble) -> "Around":
        """Return the polynomial with a better value at 1."""
        return self._replace(shifted=(*self.shifted[:-1], value))

    @property
    def quotient(self) -> "Around":
        """(Q - Q(1)) / s."""
        sums = tuple(accumulate(self.straight[:-1], DoubleDouble.__add__))
        return Around(sums or (_ZERO,), self.shifted[:-1] or (_ZERO,))


def around(polynomial: Polynomial, sign: int) -> Around:
    """Return a polynomial of sign zeta."""
    return Around.of(polynomial if sign > 0 else turned(polynomial))


def minor(one: Around, other: Around) -> Around:
    """Return (Q(1) P - P(1) Q) / (zeta - 1) of two polynomials."""
    pairs = zip(one.quotient, other.quotient, strict=True)
    return Around(*(_crossed(above, below, one.value, other.value) for above, below in pairs))


def _crossed(
    above: Polynomial, below: Polynomial, value: DoubleDouble, other: DoubleDouble
) -> Polynomial:
    """Return other above - value below, with 0 for what is rounding of the two."""
    length = max(len(above), len(below))
    above, below = ((_ZERO,) * (length - len(one)) + one for one in (above, below))
    terms = [(a * other, b * -value) for a, b in zip(above, below, strict=True)]
    sums = ((a + b, _NOTHING * (abs(a.hi) + abs(b.hi))) for a, b in terms)
    return tuple(total if abs(total.hi) >= nothing else _ZERO for total, nothing in sums)


def turned(polynomial: Polynomial) -> Polynomial:
    """Return the polynomial of -z."""
    degree = len(polynomial) - 1
    return tuple(-c if (degree - k) % 2 else c for k, c in enumerate(polynomial))


def power(degree: int) -> Polynomial:
    """Return a power of z."""
    return (DoubleDouble(1.0, 0.0), *(_ZERO,) * degree)


def _shifted(polynomial: Polynomial) -> Polynomial:
    """Return the coefficients in powers of z - 1, by one division after the other."""
    rest, coefficients = polynomial, []
    while len(rest) > 1:
        *sums, value = accumulate(rest, DoubleDouble.__add__)
        coefficients.append(value)
        rest = tuple(sums)
    return (*rest, *coefficients[::-1])


def rounded(polynomial: Polynomial) -> Coefficients:
    """Return the coefficients in float64."""
    return np.array([float(coefficient.rounded()) for coefficient in polynomial])


class Rows(NamedTuple):
    """Polynomials in powers of zeta and of s = zeta - 1, the lowest power first.

    Order 0 are the polynomials, order 1 their derivatives in zeta, which are multiplied by zeta in
    powers of zeta. The powers of s have the smaller terms where abs(s) < ``close``.
    """

    straight: Float64[np.ndarray, "order row power"]
    shifted: Float64[np.ndarray, "order row power"]
    close: Float64[np.ndarray, " row"]

    @classmethod
    def of(cls, polynomials: Sequence[Around]) -> "Rows":
        """Return the rows of some polynomials."""
        length = max(len(one.straight) for one in polynomials)
        both = np.zeros((2, 2, len(polynomials), length))
        for row, one in enumerate(polynomials):
            for form, falling in enumerate(one):
                both[form, 0, row, : len(falling)] = rounded(falling)[::-1]
        order = np.arange(float(length))
        both[0, 1] = both[0, 0] * order
        both[1, 1, :, :-1] = (both[1, 0] * order)[:, 1:]
        sizes, terms = np.abs(both[:, 0])
        is_less = terms @ _powers_of_steps(length) < np.sum(sizes, axis=1)[:, None]
        close = np.max(np.where(is_less, _STEPS, 0.0), axis=1)
        return cls(straight=both[0], shifted=both[1], close=close)


@cache
def _powers_of_steps(count: int) -> Float64[np.ndarray, "power step"]:
    return _STEPS ** np.arange(count)[:, None]
