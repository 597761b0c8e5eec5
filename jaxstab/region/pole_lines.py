"""Whole lines of the boundary: walls of a line that keep a pair of roots on the circle. NumPy only.

Where V is real W mostly is not, and the curve goes to infinity. Where both are (windows, undamped
hands, delays of whole or half samples) all walls of one line have the pair z, 1/z: it belongs to
the boundary like the curve. With a unit normal (s, r) of the line, a = s alpha + r beta,
b = s beta - r alpha, p = 0 reads a + b V = W, with V = 0 and W real at the angle t of the pair. As
in ``filtered_curve``, V = (z - z0) V', W = W0 + (z - z0) W', and with e = theta - t,
g = 2 sin(e/2), U = z0 e^(ie/2)

    b Re(U V') = Re(U W') + q,     a = W0 + g (b Im(U V') - Im(U W')),     g q = Im W0 = 0.

The curve has q = 0, the line g = 0, and both are one limit of the curves with a small Im W0. So the
line gets a part of the angles around t, as if they were those of such a curve: the curve is drawn
closer to t, and between its two halves the line comes from infinity or goes there. Where Re(U V')
is 0 at t, the curve goes to infinity at t, and the whole line lies between its halves (lemma G2).
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from jaxstab.arrays import Array
from jaxstab.model.transfer import Polynomial

_BITS = 200  # of fixed point
_ZERO = 2.0**-86  # of the sizes of the polynomials: pairs know that much
_MAYBE = 1e-6  # the same, to be looked at: double roots are known to half of the digits
_SAME = 1e-5  # of angles of a double root
_REACH, _WIDEST = 0.3, 0.1  # of a line: as a share of the distance to the next pole, and radians
_DOUBLE = 1e-6  # Re(U V') beside V' at a double pole
_MIDDLE = 0.5  # where the line meets the curve, as a share of the half width
_NEWTON_STEPS = 6

Angles = Float64[np.ndarray, " _"]
Coefficients = Complex128[np.ndarray, " _"]
Point = tuple[int, int]  # a complex number in fixed point


class PoleLine(NamedTuple):
    """One line, and the part of the angles that it has with the curve next to it."""

    angle: float
    half_width: float
    is_double: bool
    normal: tuple[float, float]  # s, r
    level: float  # W0
    unit: float  # along the line
    rise: Coefficients  # numerators of V' and W', highest power first, and the divisor of both
    run: Coefficients
    divisor: Coefficients

    @property
    def poles(self) -> list[float]:
        """The angles at which the curve and the line are at infinity."""
        if not self.is_double:
            return [self.angle]
        return [self.angle + side * _MIDDLE * self.half_width for side in (-1.0, 1.0)]

    def holds(self, size: Angles) -> Bool[np.ndarray, " _"]:
        """Whether angles between 0 and pi belong to the line or to the curve next to it."""
        held: np.ndarray = np.abs(size - self.angle) < self.half_width
        return held

    def is_straight(self, size: Angles) -> Bool[np.ndarray, " _"]:
        """Whether angles between 0 and pi belong to the line itself."""
        ends = self.poles if self.is_double else self.knots
        straight: np.ndarray = (size >= ends[0]) & (size <= ends[1])
        return straight

    def gains(self, size: Angles) -> tuple[list[Angles], list[Angles]]:
        """Return alpha, beta and the angle of the roots, and their slopes."""
        g, g_slope, q, q_slope = self._parts(size)
        offset = 2.0 * np.arcsin(0.5 * g)
        turn = g_slope / np.sqrt(1.0 - 0.25 * g * g)
        (one, one_slope), (two, two_slope) = self._quotients(offset)
        one_slope, two_slope = one_slope * turn, two_slope * turn
        if self.is_double:
            on_line = np.abs(size - self.angle) < _MIDDLE * self.half_width
            b = np.where(on_line, q, two.real / one.real)
            slope = (two_slope.real - b * one_slope.real) / one.real
            b_slope = np.where(on_line, q_slope, slope)
        else:
            b = (two.real + q) / one.real
            b_slope = (two_slope.real + q_slope - b * one_slope.real) / one.real
        a = self.level + g * (b * one.imag - two.imag)
        swing = b_slope * one.imag + b * one_slope.imag - two_slope.imag
        a_slope = g_slope * (b * one.imag - two.imag) + g * swing
        s, r = self.normal
        values = [s * a - r * b, r * a + s * b, self.angle + offset]
        return values, [s * a_slope - r * b_slope, r * a_slope + s * b_slope, turn]

    def _quotients(self, offset: Angles) -> list[tuple[Array, Array]]:
        """Return U V' and U W', and their slopes in the angle."""
        zero = np.exp(1j * self.angle)
        z, half = zero * np.exp(1j * offset), zero * np.exp(0.5j * offset)
        below, below_slope = np.polyval(self.divisor, z), np.polyval(np.polyder(self.divisor), z)
        both = []
        for numerator in (self.rise, self.run):
            value = np.polyval(numerator, z) / below
            slope = (np.polyval(np.polyder(numerator), z) - value * below_slope) / below
            both.append((half * value, half * (1j * z * slope + 0.5j * value)))
        return both

    def _parts(self, size: Angles) -> tuple[Angles, Angles, Angles, Angles]:
        """Return g and q (double: b on the line) and their slopes, by the share of the width."""
        side = np.where(size < self.angle, -1.0, 1.0)
        share = np.abs(size - self.angle) / self.half_width
        last, steep = 2.0 * np.sin(0.5 * self.half_width), np.cos(0.5 * self.half_width)
        steep = steep * self.half_width
        nothing = np.zeros_like(share)
        if self.is_double:
            beyond = np.maximum(share - _MIDDLE, 0.0)
            first, second = 4.0 * last - steep, 2.0 * steep - 4.0 * last
            g, slope = beyond * (first + second * beyond), first + 2.0 * second * beyond
            g_slope = np.where(share > _MIDDLE, slope, 0.0) / self.half_width
            turned = np.pi * np.clip((size - self.angle) / self.half_width, -_MIDDLE, _MIDDLE)
            q = self.unit * np.tan(turned)
            q_slope = self.unit * np.pi / (self.half_width * np.cos(turned) ** 2)
            return side * g, g_slope, q, q_slope
        share = np.maximum(share, np.finfo(float).tiny)
        x = _climb(share, last, steep, self.half_width)
        slope = steep + self.half_width * (1.0 / share**2 - 1.0)
        slope = slope / self.half_width
        is_curve = x > 0.0
        g, g_slope = np.where(is_curve, x, nothing), np.where(is_curve, slope, 0.0)
        q, q_slope = np.where(is_curve, nothing, -x), np.where(is_curve, 0.0, -slope)
        return side * g, g_slope, side * self.unit * q, self.unit * q_slope

    @property
    def knots(self) -> list[float]:
        """The angles at which the curve meets the line."""
        if self.is_double:
            return []
        last, steep = 2.0 * np.sin(0.5 * self.half_width), np.cos(0.5 * self.half_width)
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            value = _climb(middle, last, steep * self.half_width, self.half_width)
            low, high = (low, middle) if value > 0.0 else (middle, high)
        return [self.angle - high * self.half_width, self.angle + high * self.half_width]


def _climb(share: Array, last: float, steep: float, width: float) -> Array:
    """Return what is g where it is positive, and -q where not: g = last at 1, with that slope."""
    return last + steep * (share - 1.0) - width * (1.0 - share) ** 2 / share


def pole_lines(
    loop: tuple[Polynomial, Polynomial, Polynomial], poles: Angles
) -> tuple[PoleLine, ...]:
    """Return the lines of a loop, base + alpha stiffness + beta damping, at angles of real V."""
    floats = [np.array([float(c.rounded()) for c in part]) for part in loop]
    sizes = [float(np.sum(np.abs(part))) for part in floats]
    candidates = _candidates([part / size for part, size in zip(floats, sizes, strict=True)], poles)
    if not len(candidates):
        return ()
    fixed = [_fixed(part, size) for part, size in zip(loop, sizes, strict=True)]
    lines: list[PoleLine] = []
    for candidate in candidates.tolist():
        angle = _refined(fixed, candidate)
        if angle is None or any(abs(angle - line.angle) < _SAME for line in lines):
            continue
        away = np.abs(np.concatenate([poles, [0.0, np.pi]]) - angle)
        half_width = min(_REACH * float(np.min(away[away > _SAME])), _WIDEST)
        line = _line(floats, angle, half_width)
        if line is not None:
            lines.append(line)
    return tuple(lines)


def _candidates(parts: list[Angles], poles: Angles) -> Angles:
    """Return the angles at which all of p is real but for a factor, and gains count at all."""
    circle = np.exp(1j * poles)
    base, stiffness, damping = (np.polyval(part, circle) for part in parts)
    crosses = np.abs([(np.conj(one) * base).imag for one in (stiffness, damping)])
    counts = np.maximum(np.abs(stiffness), np.abs(damping)) > _SAME
    chosen: Angles = np.sort(poles[(np.max(crosses, axis=0) < _MAYBE) & counts])
    return chosen


def _line(parts: list[Angles], angle: float, half_width: float) -> PoleLine | None:
    base, stiffness, damping = parts
    zero = np.exp(1j * angle)
    values = [np.polyval(part, zero) for part in (stiffness, damping)]
    unit = max(values, key=abs)
    s, r = ((np.conj(unit) * value).real for value in values)
    s, r = s / np.hypot(s, r), r / np.hypot(s, r)
    divisor = s * stiffness + r * damping
    level = float((-np.polyval(base, zero) / np.polyval(divisor, zero)).real)
    line = PoleLine(
        angle=angle,
        half_width=half_width,
        is_double=False,
        normal=(float(s), float(r)),
        level=level,
        unit=1.0,
        rise=_divided(s * damping - r * stiffness, zero),
        run=_divided(-base - level * divisor, zero),
        divisor=divisor.astype(complex),
    )
    (one, one_slope), (two, _) = line._quotients(np.zeros(1))
    swing, level_swing = float(one.real[0]), float(two.real[0])
    if abs(swing) > _DOUBLE * abs(one[0]):
        return line._replace(unit=float(abs(two[0])) / half_width)
    second = float(one_slope.real[0])
    if second == 0.0 or level_swing == 0.0:
        return None
    return line._replace(is_double=True, unit=level_swing / second)


def _divided(polynomial: Angles, zero: complex) -> Coefficients:
    """Return a polynomial divided by z - zero, of which it has the root but for rounding."""
    quotient = np.empty(len(polynomial) - 1, complex)
    last = 0.0j
    for k, coefficient in enumerate(polynomial[:-1]):
        last = coefficient + zero * last
        quotient[k] = last
    return quotient


# ------------------------------------------------------------------------- in fixed point


def _fixed(polynomial: Polynomial, size: float) -> list[int]:
    """Return coefficients over their size, lowest power first, in fixed point."""
    scale = Fraction(2) ** _BITS / Fraction(float(size))
    return [int((Fraction(float(c.hi)) + Fraction(float(c.lo))) * scale) for c in polynomial[::-1]]


def _refined(parts: list[list[int]], angle: float) -> float | None:
    """Return the angle of a line next to one, or None if there is none.

    Newton's method for the root of Im V, or of its slope where that is a double root.
    """
    z = _on_circle((_to_fixed(np.cos(angle)), _to_fixed(np.sin(angle))))
    turned = 0.0
    for _ in range(_NEWTON_STEPS):
        rows = [_derivatives(part, z) for part in parts]
        f = [_crossed(rows[1], rows[2], order) for order in range(3)]
        is_double = abs(f[1]) < _SAME * abs(f[2])
        step = -f[1] / f[2] if is_double else (-f[0] / f[1] if f[1] else 0.0)
        if not abs(step) < _SAME:
            return None
        turned += step
        z = _turned(z, step)
    rows = [_derivatives(part, z) for part in parts]
    crosses = [_crossed(rows[i], rows[k], 0) for i, k in ((1, 2), (1, 0), (2, 0))]
    return angle + turned if max(map(abs, crosses)) < _ZERO else None


def _derivatives(part: list[int], z: Point) -> list[Point]:
    """Return the value of a polynomial on the circle and its first two slopes in the angle."""
    sums = [[0, 0] for _ in range(3)]
    power: Point = (1 << _BITS, 0)
    for k, coefficient in enumerate(part):
        term = coefficient * power[0] >> _BITS, coefficient * power[1] >> _BITS
        for order in range(3):
            factor = k**order
            sums[order][0] += factor * term[0]
            sums[order][1] += factor * term[1]
        power = _times(power, z)
    (a, b), (c, d), (e, f) = sums
    return [(a, b), (-d, c), (-e, -f)]


def _crossed(one: list[Point], other: list[Point], order: int) -> float:
    """Return a slope of Im(conj(one) other) in the angle."""
    weights = ((1,), (1, 1), (1, 2, 1))[order]
    total = 0
    for k, weight in enumerate(weights):
        (a, b), (c, d) = one[k], other[order - k]
        total += weight * (a * d - b * c)
    return total / (1 << 2 * _BITS)


def _turned(z: Point, step: float) -> Point:
    e = _to_fixed(step)
    square = e * e >> _BITS
    cubic = square * e >> _BITS
    return _on_circle(_times(z, ((1 << _BITS) - square // 2, e - cubic // 6)))


def _on_circle(z: Point) -> Point:
    """Return a number over its modulus, which is next to 1, by Newton's method."""
    for _ in range(3):
        square = (z[0] * z[0] + z[1] * z[1]) >> _BITS
        factor = (3 * (1 << _BITS) - square) // 2
        z = (z[0] * factor >> _BITS, z[1] * factor >> _BITS)
    return z


def _times(one: Point, other: Point) -> Point:
    (a, b), (c, d) = one, other
    return (a * c - b * d) >> _BITS, (a * d + b * c) >> _BITS


def _to_fixed(value: float) -> int:
    return int(Fraction(float(value)) * (1 << _BITS))
