"""Points and slopes of the boundary in double-double, where float64 loses all digits.

Filters with many slow poles have these next to each other: at z next to 1 their polynomials are
1e-5 to 1e-30 of their coefficients. So p(z) = base + alpha S + beta R itself is taken in powers of
z -+ 1 there, and in powers of z elsewhere, in pairs of float64; with Cramer's rule

    alpha = Im(conj(R) base) / Im(conj(S) R),     beta = -Im(conj(S) base) / Im(conj(S) R).

Powers of zeta - 1 have real and imaginary parts of all their digits, so nothing is divided by hand,
as it is in ``filtered_points``: there is enough left of 106 bits. NumPy only.
"""

from fractions import Fraction
from functools import cache
from math import factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from jaxstab.arrays import PI_REST, Array
from jaxstab.model.double_double import DoubleDouble

_CLOSE = 0.5  # of zeta - 1: up to there its powers are taken
_LEAST = 1e-11  # in place of the angle 0: there the curve has a limit, and even in the angle
_HALVINGS = 3  # of angles before the series
_AT_ONCE = 1 << 18  # coefficients that are held in memory
_POLISHING, _POLISHED = 3, 1e-3  # steps, and the longest one beside the root
_TERMS = 10  # of the series of sine and cosine, for angles up to 0.1

Angles = Float64[np.ndarray, " _"]
Pairs = Float64[np.ndarray, "half form pair part coefficient"]


class _Complex(NamedTuple):
    """Complex numbers in pairs of float64."""

    real: DoubleDouble
    imag: DoubleDouble

    def times(self, other: "_Complex") -> "_Complex":
        return _Complex(
            self.real * other.real - self.imag * other.imag,
            self.real * other.imag + self.imag * other.real,
        )

    def cross(self, other: "_Complex") -> DoubleDouble:
        """The imaginary part of other times the conjugate of these."""
        return self.real * other.imag - self.imag * other.real

    def part(self, *index: slice | None) -> "_Complex":
        """Return what an index of arrays gives."""
        real, imag = (DoubleDouble(one.hi[index], one.lo[index]) for one in self)
        return _Complex(real, imag)


class ExactGains(NamedTuple):
    """alpha, beta and (alpha - W(1)) / (1 - cos theta), and their slopes in theta."""

    values: tuple[DoubleDouble, DoubleDouble, DoubleDouble]
    slopes: tuple[Array, Array, Array]


def exact_gains(pairs: Pairs, theta: DoubleDouble, *, with_slopes: bool) -> ExactGains:
    """Return points of the curve at angles between 0 and pi.

    Args:
        pairs: base, stiffness and damping in powers of zeta and of zeta - 1, lowest power first,
            on the halves of z = zeta and of z = -zeta.
        theta: the angles, on one axis.
        with_slopes: whether slopes are wanted, which take as long again; else they are empty.
    """
    width = max(1, _AT_ONCE // pairs.shape[-1])
    starts = range(0, max(len(theta.hi), 1), width)
    thetas = (DoubleDouble(*(one[k : k + width] for one in (theta.hi, theta.lo))) for k in starts)
    parts = [_gains(pairs, part, with_slopes) for part in thetas]
    if len(parts) == 1:
        return parts[0]
    alpha, beta, lift = (_joined([part.values[k] for part in parts]) for k in range(3))
    slopes = zip(*(part.slopes for part in parts), strict=True)
    alpha_slope, beta_slope, lift_slope = (np.concatenate(each) for each in slopes)
    return ExactGains((alpha, beta, lift), (alpha_slope, beta_slope, lift_slope))


def determinants(pairs: Pairs, theta: DoubleDouble) -> Array:
    """Return Im(conj(S) R), of the sign of Im V, and Im(conj(base) S), 0 where beta is."""
    upper, u = _folded(theta)
    zeta, sine, _ = _on_circle(u)
    (base, stiffness, damping), _ = _rows(pairs, upper, zeta, sine, with_slopes=False)
    both = (stiffness, damping), (base, stiffness)
    turned = np.where(upper, -1.0, 1.0)
    return turned * np.stack([one.cross(two).rounded() for one, two in both])


def lines_crossing_of(pairs: Pairs) -> tuple[DoubleDouble, DoubleDouble]:
    """Return the wall with real roots at 1 and at -1."""
    (base, stiffness, _), others = (_numbers(pairs[half, 1, :, :, 0]) for half in range(2))
    alpha = -base / stiffness
    return alpha, -(others[0] + others[1] * alpha) / others[2]


def polished_angles(
    pairs: Pairs, alpha: DoubleDouble, beta: DoubleDouble, step: Complex128[np.ndarray, " root"]
) -> tuple[DoubleDouble, Array]:
    """Return angles and moduli of roots 1 + step of p(z) of a wall, by Newton's method.

    They are in the upper half of the plane. The moduli are less 1.
    """
    change = np.zeros_like(step)
    for _ in range(_POLISHING if len(step) else 0):
        step = step - np.where(np.abs(change) < _POLISHED * np.abs(step), change, 0.0)
        straight = (abs(step) > _CLOSE).astype(int)
        coefficients = DoubleDouble(*np.moveaxis(pairs, 2, 0)[:, 0, 1 - straight])
        number = _Complex(DoubleDouble.of(step.real) + 1.0 * straight, DoubleDouble.of(step.imag))
        value, slope = (_wall_value(rows, alpha, beta) for rows in _rows_at(coefficients, number))
        change = value / slope
    root = _Complex(DoubleDouble.of(step.real) + 1.0, DoubleDouble.of(step.imag))
    rough = np.angle(1.0 + step)
    upper, u = _folded(DoubleDouble.of(rough))
    zeta, _, _ = _on_circle(u)
    real = DoubleDouble(*(np.where(upper, -part, part) for part in (zeta.real.hi, zeta.real.lo)))
    modulus = np.abs(1.0 + step)
    turn = _Complex(real, zeta.imag).cross(root).rounded() / modulus
    moved = change / (1.0 + step)
    square = root.real * root.real + root.imag * root.imag + (-1.0)
    excess = square.rounded() / (1.0 + modulus) - moved.real * modulus
    return DoubleDouble.of(rough) + (turn - moved.imag), excess


def _wall_value(rows: list[_Complex], alpha: DoubleDouble, beta: DoubleDouble) -> Array:
    """Return base + alpha stiffness + beta damping as complex numbers."""
    parts = zip(*rows, strict=True)
    real, imag = ((base + one * alpha + two * beta).rounded() for base, one, two in parts)
    return real + 1j * imag


def _joined(parts: list[DoubleDouble]) -> DoubleDouble:
    return DoubleDouble(
        *(np.concatenate([getattr(p, name) for p in parts]) for name in ("hi", "lo"))
    )


def _numbers(columns: Float64[np.ndarray, "2 part"]) -> list[DoubleDouble]:
    return [DoubleDouble(*pair) for pair in columns.T]


def _folded(theta: DoubleDouble) -> tuple[Array, DoubleDouble]:
    """Return which angles are in the upper half, and the angles u of zeta, none of them 0."""
    upper = theta.hi > np.pi / 2
    beyond = -theta + DoubleDouble.of(np.full_like(theta.hi, np.pi)) + PI_REST
    high, low = np.where(upper, [beyond.hi, beyond.lo], [theta.hi, theta.lo])
    is_least = high < _LEAST
    return upper, DoubleDouble(np.where(is_least, _LEAST, high), np.where(is_least, 0.0, low))


def _gains(pairs: Pairs, theta: DoubleDouble, with_slopes: bool) -> ExactGains:
    upper, u = _folded(theta)
    zeta, sine, cosine = _on_circle(u)
    rows, slopes = _rows(pairs, upper, zeta, sine, with_slopes=with_slopes)
    base, stiffness, damping = rows
    below = stiffness.cross(damping)
    alpha, beta = damping.cross(base) / below, base.cross(stiffness) / below
    at_one = _numbers(pairs[0, 1, :, :, 0])
    line = -at_one[0] / at_one[1]
    side = DoubleDouble(
        *(np.where(upper, *each) for each in ((cosine.hi, sine.hi), (cosine.lo, sine.lo)))
    )
    height = (side * side).scaled(2.0)  # 1 - cos(theta)
    lift = (alpha - line) / height
    if not with_slopes:
        return ExactGains((alpha, beta, lift), (np.empty(0),) * 3)
    base_slope, stiffness_slope, damping_slope = slopes
    turn = stiffness_slope.cross(damping) + stiffness.cross(damping_slope)
    alpha_slope = damping_slope.cross(base) + damping.cross(base_slope) - alpha * turn
    beta_slope = base_slope.cross(stiffness) + base.cross(stiffness_slope) - beta * turn
    alpha_slope, beta_slope = alpha_slope / below, beta_slope / below
    turned = np.where(upper, -1.0, 1.0)
    swing = (sine * cosine).scaled(2.0) * turned
    lift_slope = (alpha_slope - lift * swing) / height
    every = [turned * one.rounded() for one in (alpha_slope, beta_slope, lift_slope)]
    return ExactGains((alpha, beta, lift), (every[0], every[1], every[2]))


def _rows(
    pairs: Pairs, upper: Array, zeta: _Complex, sine: DoubleDouble, *, with_slopes: bool
) -> tuple[list[_Complex], list[_Complex]]:
    """Return base, stiffness and damping at zeta, and their slopes."""
    is_close = 2.0 * sine.hi < _CLOSE
    count = pairs.shape[-1]
    coefficients = DoubleDouble(
        *np.moveaxis(pairs, 2, 0)[:, upper.astype(int), is_close.astype(int)]
    )
    number = _Complex(
        DoubleDouble(
            np.where(is_close, (sine * sine).scaled(-2.0).hi, zeta.real.hi),
            np.where(is_close, (sine * sine).scaled(-2.0).lo, zeta.real.lo),
        ),
        zeta.imag,
    )
    if not with_slopes:
        return _sums(coefficients, _powers(number, count)), []
    rows, slopes = _rows_at(coefficients, number)
    turn = _Complex(-zeta.imag, zeta.real)  # i zeta
    return rows, [row.times(turn) for row in slopes]


def _rows_at(coefficients: DoubleDouble, number: _Complex) -> tuple[list[_Complex], list[_Complex]]:
    """Return polynomials and their derivatives at complex numbers."""
    count = coefficients.hi.shape[-1]
    powers = _powers(number, count)
    order = np.arange(1.0, count)
    higher = DoubleDouble(coefficients.hi[..., 1:], coefficients.lo[..., 1:]) * order
    lower = powers.part(slice(None), slice(count - 1))
    return _sums(coefficients, powers), _sums(higher, lower)


def _sums(coefficients: DoubleDouble, powers: _Complex) -> list[_Complex]:
    """Return sums of coefficients (angle, part, power) times powers (angle, power)."""
    columns = powers.part(slice(None), None)
    real, imag = (_total(coefficients * part) for part in columns)
    return [_Complex(*parts) for parts in zip(_unstacked(real), _unstacked(imag), strict=True)]


def _unstacked(both: DoubleDouble) -> list[DoubleDouble]:
    return [DoubleDouble(*pair) for pair in zip(both.hi.T, both.lo.T, strict=True)]


def _total(terms: DoubleDouble) -> DoubleDouble:
    """Return the sum over the last axis, half and half."""
    while (count := terms.hi.shape[-1]) > 1:
        middle = count // 2
        first, second, rest = (
            DoubleDouble(terms.hi[..., part], terms.lo[..., part])
            for part in (slice(middle), slice(middle, 2 * middle), slice(2 * middle, None))
        )
        halved = first + second
        terms = DoubleDouble(
            *(
                np.concatenate(each, axis=-1)
                for each in ((halved.hi, rest.hi), (halved.lo, rest.lo))
            )
        )
    return DoubleDouble(terms.hi[..., 0], terms.lo[..., 0])


def _powers(number: _Complex, count: int) -> _Complex:
    """Return the powers 0 ... count - 1 on a second axis."""
    number = number.part(slice(None), None)
    one = DoubleDouble.of(np.ones_like(number.real.hi))
    powers, next_power = _Complex(one, DoubleDouble.of(np.zeros_like(one.hi))), number
    while powers.real.hi.shape[1] < count:
        higher = powers.times(next_power)
        powers = _Complex(
            *(
                DoubleDouble(
                    *(np.concatenate(each, axis=1) for each in ((a.hi, b.hi), (a.lo, b.lo)))
                )
                for a, b in zip(powers, higher, strict=True)
            )
        )
        next_power = next_power.times(next_power)
    return powers.part(slice(None), slice(count))


def _on_circle(u: DoubleDouble) -> tuple[_Complex, DoubleDouble, DoubleDouble]:
    """Return zeta = e^(iu), and sine and cosine of u/2."""
    sine, cosine = _half_turn(u)
    zeta = _Complex(_versed(sine), (sine * cosine).scaled(2.0))
    return zeta, sine, cosine


def _versed(sine: DoubleDouble) -> DoubleDouble:
    """Return the cosine of twice the angle."""
    return -(sine * sine).scaled(2.0) + 1.0


def _half_turn(u: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    """Return sine and cosine of u/2, u in (0, pi/2]."""
    x = u.scaled(0.5 ** (1 + _HALVINGS))
    square = x * x
    both = DoubleDouble.of(np.zeros((2, *square.hi.shape)))
    for term in _terms():
        both = both * square + term
    sine, cosine = _unstacked(DoubleDouble(both.hi.T, both.lo.T))
    sine = sine * x
    for _ in range(_HALVINGS):
        sine, cosine = (sine * cosine).scaled(2.0), _versed(sine)
    return sine, cosine


@cache
def _terms() -> list[DoubleDouble]:
    """Return (-1)^k / (2k + 1)! and (-1)^k / (2k)!, the last k first, in columns."""
    terms = []
    for k in range(_TERMS, -1, -1):
        exact = [Fraction((-1) ** k, factorial(2 * k + start)) for start in (1, 0)]
        high = [float(one) for one in exact]
        low = [float(one - Fraction(part)) for one, part in zip(exact, high, strict=True)]
        terms.append(DoubleDouble(np.array(high)[:, None], np.array(low)[:, None]))
    return terms
