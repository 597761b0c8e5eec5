"""Sine, cosine and sin(x) / x of positive angles, with derivatives to full precision."""

from math import factorial, pi

import numpy as np

from jaxstab.arrays import Array, constant, namespace

# sin(x) / x and cos(x) as series in x^2, for all x up to pi/4 and derivatives, too.
_SINC = tuple((-1.0) ** k / factorial(2 * k + 1) for k in range(10))
_COSINE = tuple((-1.0) ** k / factorial(2 * k) for k in range(10))
_SMALL, _SMALL_TERMS = 0.3, 6  # the first terms of the same are enough up to there
# A quarter turn in parts of 27 bits: multiples of the first two are exact.
_QUARTER_TURN = (1.570796325802803, 9.920935739593517e-10, 5.721188726109832e-18)


def sines(x: Array, *, are_small: bool = False) -> tuple[Array, Array, Array]:
    """Return sin(x), cos(x) and sin(x) / x for x >= 0, with derivatives to full precision.

    A quotient would lose digits of the derivative of sin(x) / x next to 0; a series is used there.
    ``are_small`` says that all x are at most pi/4, which saves time in XLA.
    """
    xp = namespace(x)
    if xp is not np:
        return _sines_of_small(x) if are_small else _sines_of_vectors(x)
    sine, cosine = np.sin(x.real), np.cos(x.real)
    if np.iscomplexobj(x):  # a complex step: real to first order
        sine, cosine = sine + 1j * (x.imag * cosine), cosine - 1j * (x.imag * sine)
    small = x.real < _SMALL
    sinc = _series(_SINC[:_SMALL_TERMS], x * x)
    return sine, cosine, np.where(small, sinc, sine / np.where(small, 1.0, x))


def _sines_of_vectors(x: Array) -> tuple[Array, Array, Array]:
    """Return the same; XLA makes vectors of this, and not of calls of sin and cos.

    Most of the run time is here.
    """
    xp = namespace(x)
    quarters = constant(xp.round(x * (2.0 / pi)))
    rest = x
    for part in _QUARTER_TURN:
        rest = rest - quarters * part
    sine, cosine, sinc = _sines_of_small(rest)
    odd = quarters % 2.0 == 1.0
    sine, cosine = xp.where(odd, cosine, sine), xp.where(odd, -sine, cosine)
    sign = xp.where(quarters % 4.0 >= 2.0, -1.0, 1.0)
    sine, cosine = sign * sine, sign * cosine
    first = quarters == 0.0
    return sine, cosine, xp.where(first, sinc, sine / xp.where(first, 1.0, x))


def _sines_of_small(x: Array) -> tuple[Array, Array, Array]:
    square = x**2
    sinc = _series(_SINC, square)
    return x * sinc, _series(_COSINE, square), sinc


def _series(coefficients: tuple[float, ...], x: Array) -> Array:
    total: Array = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = coefficient + x * total
    return total
