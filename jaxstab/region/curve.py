"""The boundary curve of a loop with any plant, estimator and filter. NumPy only.

A curve is three things, and all else in this folder needs no more: points at angles, the lines of
real roots at z = r and z = -r, and the polynomial p(r zeta), base + alpha stiffness + beta damping.

Divided by the position filter, p = 0 reads alpha + beta V(z) = W(z), V = X/Y, W = -z^w D/N (the
position filter's numerator counts to N and Y, its denominator to D and X). On each half of the
circle, z = +-zeta with |arg zeta| <= pi/2, everything is divided by s = zeta - 1 first:

    V = V1 + s V',     W = W1 + s W',     a = alpha + beta V1 - W1,     a/s + beta V' = W'

with V1, W1 the values at z = +-1. As 1/s = -1/2 - i/(2 tan(u/2)), u = arg zeta, both gains follow
without cancellation, and a is how far the wall is from the line of a real root at +-1. Where V1 or
W1 is large at z = -1 the same is done with 1/V or 1/W (``Form``).

Where Im V < 0 the stable side of the curve is its right one: such angles count as negative ones,
which run the other way, so the stable set lies to the left everywhere. V is real at its *poles*,
where the curve goes to infinity.

A circle of radius r is the unit circle of the polynomials of r zeta, with r^w for z^w
(``Around.of_radius``). They are formed about z = 1 first, where the plant is known best.

In this order follow polynomials about zeta = 1 (``Around``, ``Rows``), whole lines of the boundary
at poles (``PoleLine``), angles rescaled where the curve is too fast for float64 (``Stretch``), and
the curve itself (``Curve``). Its points are evaluated by ``points``, or by ``exact``.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum
from fractions import Fraction
from functools import cache, lru_cache, reduce
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from jaxstab.arrays import Array, tree_map
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import ONE, Filters, Polynomial, Transfer, product, size_of
from jaxstab.model.linear_loop import (
    LinearLoop,
    LoopFilters,
    SampledPlant,
    loop_factors,
    loop_filters,
    loop_of,
    loop_of_radius,
    sampled_mass,
)

# Polynomials in powers of zeta and of zeta - 1, in double-double and as rows of numbers.

_VANISHING = DoubleDouble(0.0, 0.0)
_NOTHING = 1e-25  # of the size of a polynomial: pairs that are rounding

# |zeta - 1|: on half of the circle at most sqrt(2).
_HALF_CIRCLE = np.linspace(0.0, 1.5, 151)[1:]

Angles = Float64[np.ndarray, " _"]


class Around(NamedTuple):
    """A polynomial in powers of zeta and of s = zeta - 1, highest power first."""

    straight: Polynomial
    shifted: Polynomial

    @classmethod
    def from_polynomial(cls, polynomial: Polynomial) -> "Around":
        """Return a polynomial with its powers of s; rounding errors count as 0."""
        nothing = _NOTHING * size_of(polynomial)
        shifted = (c if abs(c.hi) >= nothing else _VANISHING for c in about_one(polynomial))
        return cls(polynomial, tuple(shifted))

    def times(self, other: "Around") -> "Around":
        """Return the product."""
        both = zip(self, other, strict=True)
        return Around(*(product(a, b) for a, b in both))

    def of_radius(self, radius: float) -> "Around":
        """Return the polynomial of radius zeta."""
        if radius == 1.0:
            return self
        inner = DoubleDouble.from_value(radius) + -1.0  # zeta - 1 becomes inner + radius s
        shifted = _about(self.shifted, lambda total, c: total * inner + c)
        return Around(*(rescaled(p, radius) for p in (self.straight, shifted)))

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
        return Around(sums or (_VANISHING,), self.shifted[:-1] or (_VANISHING,))


def around(polynomial: Polynomial, sign: int, radius: float = 1.0) -> Around:
    """Return a polynomial of sign radius zeta."""
    return Around.from_polynomial(polynomial if sign > 0 else turned(polynomial)).of_radius(radius)


def minor(p: Around, q: Around) -> Around:
    """Return (Q(1) P - P(1) Q) / (zeta - 1) of two polynomials."""
    pairs = zip(p.quotient, q.quotient, strict=True)
    return Around(*(_crossed_products(above, below, p.value, q.value) for above, below in pairs))


def _crossed_products(
    above: Polynomial, below: Polynomial, value: DoubleDouble, other: DoubleDouble
) -> Polynomial:
    """Return other above - value below, with 0 for what is rounding of the two."""
    length = max(len(above), len(below))
    above, below = ((_VANISHING,) * (length - len(p)) + p for p in (above, below))
    terms = [(a * other, b * -value) for a, b in zip(above, below, strict=True)]
    sums = ((a + b, _NOTHING * (abs(a.hi) + abs(b.hi))) for a, b in terms)
    return tuple(total if abs(total.hi) >= nothing else _VANISHING for total, nothing in sums)


def turned(polynomial: Polynomial) -> Polynomial:
    """Return the polynomial of -z."""
    degree = len(polynomial) - 1
    return tuple(-c if (degree - k) % 2 else c for k, c in enumerate(polynomial))


def power(degree: int) -> Polynomial:
    """Return a power of z."""
    return (DoubleDouble(1.0, 0.0), *(_VANISHING,) * degree)


def rescaled(polynomial: Polynomial, radius: float) -> Polynomial:
    """Return the polynomial of radius z."""
    *rising, _ = accumulate(polynomial, lambda power, _: power * radius, initial=ONE[0])
    return tuple(c * power for c, power in zip(polynomial, rising[::-1], strict=True))


def about_one(polynomial: Polynomial) -> Polynomial:
    """Return the coefficients in powers of z - 1."""
    return _about(polynomial, DoubleDouble.__add__)


def _about(
    polynomial: Polynomial, step: Callable[[DoubleDouble, DoubleDouble], DoubleDouble]
) -> Polynomial:
    """Return the coefficients about a point, by Horner's rule whose steps are given."""
    quotient, coefficients = polynomial, []
    while len(quotient) > 1:
        *sums, value = accumulate(quotient, step)
        coefficients.append(value)
        quotient = tuple(sums)
    return (*quotient, *coefficients[::-1])


def rounded(polynomial: Polynomial) -> Float64[np.ndarray, " coefficient"]:
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
    def from_polynomials(cls, polynomials: Sequence[Around]) -> "Rows":
        """Return the rows of some polynomials."""
        length = max(len(p.straight) for p in polynomials)
        both = np.zeros((2, 2, len(polynomials), length))
        for row, polynomial in enumerate(polynomials):
            for form, falling in enumerate(polynomial):
                both[form, 0, row, : len(falling)] = rounded(falling)[::-1]
        order = np.arange(float(length))
        both[0, 1] = both[0, 0] * order
        both[1, 1, :, :-1] = (both[1, 0] * order)[:, 1:]
        sizes, terms = np.abs(both[:, 0])
        is_less = terms @ _powers_of_steps(length) < np.sum(sizes, axis=1)[:, None]
        close = np.max(np.where(is_less, _HALF_CIRCLE, 0.0), axis=1)
        return cls(straight=both[0], shifted=both[1], close=close)

    def above(self, other: "Rows") -> "Rows":
        """Return these rows and those of another, as one table."""
        count = max(self.straight.shape[2], other.straight.shape[2])
        both = [
            [np.pad(table, ((0, 0), (0, 0), (0, count - table.shape[2]))) for table in rows[:2]]
            for rows in (self, other)
        ]
        straight, shifted = (np.concatenate(tables, axis=1) for tables in zip(*both, strict=True))
        return Rows(straight, shifted, np.concatenate([self.close, other.close]))


@cache
def _powers_of_steps(count: int) -> Float64[np.ndarray, "power step"]:
    return _HALF_CIRCLE ** np.arange(count)[:, None]


# Whole lines of the boundary: walls of a line that keep a pair of roots on the circle.
#
# Where V is real W mostly is not, and the curve goes to infinity. Where both are (windows, undamped
# hands, delays of whole or half samples) all walls of one line have the pair z, 1/z: it belongs to
# the boundary like the curve. With a unit normal (s, r) of the line, a = s alpha + r beta, b = s
# beta - r alpha, p = 0 reads a + b V = W, with V = 0 and W real at the angle t of the pair. As in
# all curves, V = (z - z0) V', W = W0 + (z - z0) W', and with e = theta - t, g = 2 sin(e/2),
# U = z0 e^(ie/2)
#
#     b Re(U V') = Re(U W') + q,     a = W0 + g (b Im(U V') - Im(U W')),     g q = Im W0 = 0.
#
# The curve has q = 0, the line g = 0, and both are one limit of the curves with a small Im W0. So
# the line gets a part of the angles around t, as if they were those of such a curve: the curve is
# drawn closer to t, and between its two halves the line comes from infinity or goes there. Where
# Re(U V') is 0 at t, the curve goes to infinity at t, and the whole line lies between its halves
# (lemma G2).

_BITS = 200  # of fixed point
_ZERO = 2.0**-86  # of the sizes of the polynomials: pairs know that much
_MAYBE = 1e-6  # the same, to be looked at: double roots are known to half of the digits
_SAME = 1e-5  # angles closer than that are one, and slopes smaller beside the next one are 0
_LINE_SHARE, _WIDEST_LINE = 0.3, 0.1  # half width: of the distance to the next pole, and radians
_DOUBLE = 1e-6  # Re(U V') beside V' at a double pole
_MIDDLE = 0.5  # where the line meets the curve, as a share of the half width
_NEWTON_STEPS = 6

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
        (rise, rise_slope), (run, run_slope) = self._quotients(offset)
        rise_slope, run_slope = rise_slope * turn, run_slope * turn
        if self.is_double:
            on_line = np.abs(size - self.angle) < _MIDDLE * self.half_width
            b = np.where(on_line, q, run.real / rise.real)
            slope = (run_slope.real - b * rise_slope.real) / rise.real
            b_slope = np.where(on_line, q_slope, slope)
        else:
            b = (run.real + q) / rise.real
            b_slope = (run_slope.real + q_slope - b * rise_slope.real) / rise.real
        a = self.level + g * (b * rise.imag - run.imag)
        swing = b_slope * rise.imag + b * rise_slope.imag - run_slope.imag
        a_slope = g_slope * (b * rise.imag - run.imag) + g * swing
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
        last = 2.0 * np.sin(0.5 * self.half_width)
        steep = np.cos(0.5 * self.half_width) * self.half_width
        if self.is_double:
            beyond = np.maximum(share - _MIDDLE, 0.0)
            linear, square = 4.0 * last - steep, 2.0 * steep - 4.0 * last
            g, slope = beyond * (linear + square * beyond), linear + 2.0 * square * beyond
            g_slope = np.where(share > _MIDDLE, slope, 0.0) / self.half_width
            turned = np.pi * np.clip((size - self.angle) / self.half_width, -_MIDDLE, _MIDDLE)
            q = self.unit * np.tan(turned)
            q_slope = self.unit * np.pi / (self.half_width * np.cos(turned) ** 2)
            return side * g, g_slope, q, q_slope
        share = np.maximum(share, np.finfo(float).tiny)
        x = _climb(share, last, steep, self.half_width)
        slope = (steep + self.half_width * (1.0 / share**2 - 1.0)) / self.half_width
        g, g_slope = np.where(x > 0.0, (x, slope), 0.0)
        q, q_slope = np.where(x > 0.0, 0.0, (-x, -slope))
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
    floats = [rounded(polynomial) for polynomial in loop]
    sizes = [float(np.sum(np.abs(polynomial))) for polynomial in floats]
    candidates = _candidates([p / size for p, size in zip(floats, sizes, strict=True)], poles)
    if not len(candidates):
        return ()
    fixed = [_fixed(polynomial, size) for polynomial, size in zip(loop, sizes, strict=True)]
    lines: list[PoleLine] = []
    for candidate in candidates.tolist():
        angle = _refined(fixed, candidate)
        if angle is None or any(abs(angle - line.angle) < _SAME for line in lines):
            continue
        away = np.abs(np.concatenate([poles, [0.0, np.pi]]) - angle)
        half_width = min(_LINE_SHARE * float(np.min(away[away > _SAME])), _WIDEST_LINE)
        line = _line(floats, angle, half_width)
        if line is not None:
            lines.append(line)
    return tuple(lines)


def _candidates(parts: list[Angles], poles: Angles) -> Angles:
    """Return the angles at which all of p is real but for a factor, and gains count at all."""
    circle = np.exp(1j * poles)
    base, stiffness, damping = (np.polyval(polynomial, circle) for polynomial in parts)
    crosses = np.abs([(np.conj(gain) * base).imag for gain in (stiffness, damping)])
    counts = np.maximum(np.abs(stiffness), np.abs(damping)) > _SAME
    chosen: Angles = np.sort(poles[(np.max(crosses, axis=0) < _MAYBE) & counts])
    return chosen


def _line(parts: list[Angles], angle: float, half_width: float) -> PoleLine | None:
    base, stiffness, damping = parts
    zero = np.exp(1j * angle)
    values = [np.polyval(polynomial, zero) for polynomial in (stiffness, damping)]
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
    (rise, rise_slope), (run, _) = line._quotients(np.zeros(1))
    swing, level_swing = float(rise.real[0]), float(run.real[0])
    if abs(swing) > _DOUBLE * abs(rise[0]):
        return line._replace(unit=float(abs(run[0])) / half_width)
    second = float(rise_slope.real[0])
    if second == 0.0 or level_swing == 0.0:
        return None
    return line._replace(is_double=True, unit=level_swing / second)


def _divided(polynomial: Angles, zero: complex) -> Coefficients:
    """Return a polynomial divided by z - zero, a root of it up to rounding."""
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
        rows = [_derivatives(polynomial, z) for polynomial in parts]
        f = [_crossed(rows[1], rows[2], order) for order in range(3)]
        is_double = abs(f[1]) < _SAME * abs(f[2])
        step = -f[1] / f[2] if is_double else (-f[0] / f[1] if f[1] else 0.0)
        if not abs(step) < _SAME:
            return None
        turned += step
        z = _turned(z, step)
    rows = [_derivatives(polynomial, z) for polynomial in parts]
    crosses = [_crossed(rows[i], rows[k], 0) for i, k in ((1, 2), (1, 0), (2, 0))]
    return angle + turned if max(map(abs, crosses)) < _ZERO else None


def _derivatives(polynomial: list[int], z: Point) -> list[Point]:
    """Return the value of a polynomial on the circle and its first two slopes in the angle."""
    sums = [[0, 0] for _ in range(3)]
    power: Point = (1 << _BITS, 0)
    for k, coefficient in enumerate(polynomial):
        term = coefficient * power[0] >> _BITS, coefficient * power[1] >> _BITS
        for order in range(3):
            factor = k**order
            sums[order][0] += factor * term[0]
            sums[order][1] += factor * term[1]
        power = _times(power, z)
    (a, b), (c, d), (e, f) = sums
    return [(a, b), (-d, c), (-e, -f)]


def _crossed(p: list[Point], q: list[Point], order: int) -> float:
    """Return a slope of Im(conj(p) q) in the angle."""
    weights = ((1,), (1, 1), (1, 2, 1))[order]
    total = 0
    for k, weight in enumerate(weights):
        (a, b), (c, d) = p[k], q[order - k]
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


def _times(w: Point, z: Point) -> Point:
    (a, b), (c, d) = w, z
    return (a * c - b * d) >> _BITS, (a * d + b * c) >> _BITS


def _to_fixed(value: float) -> int:
    return int(Fraction(float(value)) * (1 << _BITS))


# Angle intervals rescaled to resolve fast arcs of the curve.
#
# Where slow filters leave next to nothing of the gains, a fast resonance crosses the circle within
# 1e-9 to 1e-20 radians while the gains run through all of the stable set: no two angles in float64
# need lie on such an arc. So around its angle c, known in double-double, an angle t within h of it
# is mapped to c + h sinh(L (t - c)/h) / sinh(L): all distances from 1e-24 on have digits.

_LEAST = 1e-24  # the distance that is rescaled to a share of 1 / L
_WIDEST_STRETCH, _STRETCH_SHARE = 0.05, 0.45  # h: radians, and of the distance to the next angle
_SCAN_STEPS = 120  # of a scan, to each side
_NO_DIGITS = 0.01  # of the least distance: closer to the middle, gains are rounding


class Stretch(NamedTuple):
    """An interval of angles around one, rescaled."""

    angle: float
    low: float  # what rounding took from it
    half_width: float

    @property
    def growth(self) -> float:
        """The number L."""
        return float(np.log(2.0 * self.half_width / _LEAST))

    @property
    def scan(self) -> Angles:
        """Angles of a scan, at all distances from the middle."""
        shares = np.arange(1, _SCAN_STEPS) / _SCAN_STEPS
        return self.angle + self.half_width * np.concatenate([-shares[::-1], shares])

    def holds(self, size: Angles) -> Bool[np.ndarray, " _"]:
        """Whether angles between 0 and pi are rescaled."""
        held: np.ndarray = np.abs(size - self.angle) < self.half_width
        return held

    def is_rounding(self, size: Angles) -> Bool[np.ndarray, " _"]:
        """Whether points of the curve at angles next to the middle are rounding."""
        lost: np.ndarray = np.abs(size - self.angle) < self.rounding
        return lost

    @property
    def rounding(self) -> float:
        """How far from the middle points of the curve are rounding."""
        return _NO_DIGITS * self.half_width / self.growth


def stretches_around(centers: DoubleDouble, others: Angles) -> tuple[Stretch, ...]:
    """Return disjoint stretches around angles in (0, pi)."""
    limits = np.concatenate([centers.hi, others, [0.0, np.pi]])
    stretches = []
    for angle, low in zip(centers.hi.tolist(), centers.lo.tolist(), strict=True):
        away = np.abs(limits - angle)
        half_width = min(_WIDEST_STRETCH, _STRETCH_SHARE * float(np.min(away[away > 0.0])))
        stretches.append(Stretch(angle, low, half_width))
    return tuple(stretches)


def true_angles(
    stretches: Sequence[Stretch], size: Angles, low: Angles
) -> tuple[DoubleDouble, Angles]:
    """Return the true angles of rescaled ones between 0 and pi, and the derivatives."""
    angles, speed = DoubleDouble.from_value(size) + low, np.ones_like(size)
    for stretch in stretches:
        held, growth, half_width = stretch.holds(size), stretch.growth, stretch.half_width
        share = growth * ((size[held] - stretch.angle) + low[held]) / half_width
        unit = half_width / np.sinh(growth)
        moved = DoubleDouble.from_value(unit * np.sinh(share)) + stretch.low + stretch.angle
        angles.hi[held], angles.lo[held] = moved.hi, moved.lo
        speed[held] = unit * np.cosh(share) * growth / half_width
    return angles, speed


def out_of_rounding(stretches: Sequence[Stretch], theta: Angles, beside: Angles) -> Angles:
    """Return angles, moved towards others from where points of the curve are rounding."""
    for stretch in stretches:
        side = np.where(np.abs(beside) < stretch.angle, -1.0, 1.0)
        edge = np.copysign(stretch.angle + side * stretch.rounding, theta)
        theta = np.where(stretch.is_rounding(np.abs(theta)), edge, theta)
    return theta


def to_rescaled(stretches: Sequence[Stretch], angles: DoubleDouble) -> Angles:
    """Return the rescaled angles of true ones."""
    size = angles.hi + 0.0
    for stretch in stretches:
        held, growth, half_width = stretch.holds(size), stretch.growth, stretch.half_width
        gap = (angles[held] - stretch.angle) - stretch.low
        share = np.arcsinh(gap.rounded() * np.sinh(growth) / half_width) / growth
        size[held] = stretch.angle + half_width * share
    return size


_DIFFERENCE = (DoubleDouble(1.0, 0.0), DoubleDouble(-1.0, 0.0))  # z - 1
_ILL_CONDITIONED = 1e5  # sum of a denominator's coefficients over its least size on the circle
_DOUBTFUL = 30.0  # the same: above this, points are compared with double-double
CLOSEST, _FARTHEST = 1e-9, 4.0  # of the distances of poles that are told apart
UNDAMPED = 1e-6  # how far the roots of such a mode are from the circle
_HARDLY = 1e-4  # how far a gain of 1 moves them
_ON_CIRCLE = 1e-6  # a root of Im V this close to the circle is on it
_REMEMBERED = 64  # pairs of filters, curves, and roots of devices
_SLOW = 0.5  # of the distance from 1

# A plant with T V(z) less its factor (1 - 1/z), P(z), and the radius of the circle.
System = tuple[SampledPlant, Transfer, Transfer, float]

_NO_PAIRS = np.empty((2, 2, 2, 3, 0))


class Form(IntEnum):
    """How the imaginary part of V or of W is computed near zeta = 1 without cancellation.

    DIRECT is the form at the head of this file. Where the value at zeta = 1 is large it takes the
    digits, and the same is done with 1/V, or with -z^w/W = N/D: INVERSE. WHOLE divides nothing by
    s: 0/0 at zeta = 1.
    """

    DIRECT = 0
    INVERSE = 1
    WHOLE = 2


class Half(NamedTuple):
    """One half of the circle.

    With a dash for the quotient (Q - Q(1)) / s the rows are N, D and D' N(1) - N' D(1), then Y, X
    and X' Y(1) - Y' X(1), which is V' Y Y(1).
    """

    rows: Rows
    at_one: tuple[float, float, float, float]  # N, D, Y, X at zeta = 1
    gain: float  # z^w at zeta = 1
    forms: tuple[Form, Form]  # of W and of V
    values: tuple[float, float]  # W and V at zeta = 1, each if its form is DIRECT


class Curve(NamedTuple):
    """What the boundary of a loop is made of, at the circle of radius r."""

    plus: Half
    minus: Half
    lag: float  # w
    parts: Float64[np.ndarray, "3 coefficient"]  # base, stiffness, damping, highest power first
    at_minus_one: Float64[np.ndarray, "3"]  # the same of p(-r), its sign plus in the stable set
    poles: Float64[np.ndarray, "2 pole"]  # angles in [0, pi], and how far they are from the circle
    resonances: Float64[np.ndarray, "2 root"]  # the same of zeros and poles of a general device
    steep: Angles  # those at which beta is 0: where V is small the curve is there for an instant
    lines: tuple[PoleLine, ...]  # whole lines at poles
    loses_digits: bool  # in float64
    may_lose_some: bool
    stretches: tuple[Stretch, ...] = ()  # rescaled intervals of angles
    pairs: Float64[np.ndarray, "half form pair part coefficient"] = _NO_PAIRS  # if it is exact
    is_exact: bool = False  # whether all of it is evaluated in double-double

    @property
    def length(self) -> int:
        """The number of coefficients of p(z) without the pair of roots on the circle."""
        return self.parts.shape[1] - 2

    @property
    def num_plus(self) -> float:
        """N(r)."""
        return self.plus.at_one[0]

    @property
    def plus_offset(self) -> float:
        """W(r): the line z = r is alpha + plus_slope beta = W(r)."""
        return 0.0 + self.plus.values[0]  # not the number -0

    @property
    def plus_slope(self) -> float:
        """V(r)."""
        return self.plus.values[1]

    def minus_margin(self, alpha: Array | float, beta: Array | float) -> Array:
        """p(-r) with the sign chosen so that it is positive inside the stable set."""
        base, stiffness, damping = self.at_minus_one
        return base + (stiffness * alpha + damping * beta)

    @property
    def lines_crossing(self) -> tuple[float, float]:
        """(alpha, beta) where the lines of a real root at r and at -r cross."""
        _, stiffness, damping = self.at_minus_one
        with np.errstate(all="ignore"):  # they may be parallel
            divisor = damping - stiffness * self.plus_slope
            beta = -self.minus_margin(self.plus_offset, 0.0) / divisor
            return self.plus_offset - self.plus_slope * beta, beta

    def along_lines(self, alpha: Array, beta: Array) -> tuple[Array, Array]:
        """Coordinates along the lines z = r and z = -r, with the stable set on the left."""
        _, stiffness, damping = self.at_minus_one
        level = np.sign(damping) * alpha  # of a line of constant beta
        minus = np.where(stiffness == 0.0, level, -np.sign(stiffness) * beta)
        return -np.sign(self.num_plus) * beta, minus

    @property
    def lines_turn(self) -> float:
        """A sign: 1 where the boundary turns from the line z = r into the line z = -r.

        It is -1 where it turns from z = -r into z = r, and 0 where they are parallel.
        """
        _, stiffness, damping = self.at_minus_one
        turn: float = np.sign(self.num_plus) * np.sign(damping - stiffness * self.plus_slope)
        return turn

    def polynomial(self, alpha: Array, beta: Array) -> Array:
        """The coefficients of p(r zeta) of walls, but for the last two, highest power first."""
        columns = (-1, *(1 for _ in np.shape(alpha)))
        base, stiffness, damping = (row[: self.length].reshape(columns) for row in self.parts)
        return base + (stiffness * alpha + damping * beta)


def mass_system(
    gamma: float, delta: float, delay: float, filters: Filters, radius: float = 1.0
) -> System:
    """Return the plant of one mass, with T V(z) less its factor (1 - 1/z), and with P(z)."""
    whole, fraction = divmod(delay, 1.0)
    plant = sampled_mass(np.float64(gamma), np.float64(delta), int(whole), fraction)
    # Double-double is many times faster with Python floats.
    return tree_map(float, plant)._replace(lag=plant.lag), *_transfers(filters), radius


@lru_cache(_REMEMBERED)
def _transfers(filters: Filters) -> tuple[Transfer, Transfer]:
    velocity, position = filters
    return velocity.filter.transfer(), position.transfer()


class _HalfShare(NamedTuple):
    """The share of estimator and position filter in one half of the circle, for any plant."""

    d: Around  # the factors of D and N
    n: Around
    at_one: tuple[float, float]  # Y, X at zeta = 1
    rows: Rows
    form: Form


class FilterShare(NamedTuple):
    """The share of estimator and position filter in the curve, for any plant."""

    plus: _HalfShare
    minus: _HalfShare
    loop: LoopFilters
    real_angles: Angles  # of V
    condition: float

    @property
    def loses_digits(self) -> bool:
        """Whether float64 does not tell the poles of the filters apart."""
        return self.condition > _ILL_CONDITIONED


@lru_cache(_REMEMBERED)
def curve_of_system(system: System) -> Curve:
    """Return the curve of a loop."""
    plant, velocity, position, radius = system
    whole = plant.lag + position.lag
    share = filter_share(velocity, position, radius)
    above, below = _plants_around(plant, radius)
    loop = loop_of_system(system)
    real_angles = share.real_angles
    lines = () if share.loses_digits else pole_lines(loop[:3], real_angles)
    zeros = rounded(rescaled(product(plant.numerator, position.numerator), radius))
    poles = rescaled(product(plant.denominator, position.denominator), radius)
    return Curve(
        plus=_half(*above, share.plus, gain=radius**whole, of_plant=Form.DIRECT),
        minus=_half(*below, share.minus, gain=(-radius) ** whole),
        lag=float(whole),
        parts=np.array([rounded(polynomial) for polynomial in loop[:3]]),
        at_minus_one=rounded(tuple(end.value for end in loop.at_minus_one)),
        poles=_poles(real_angles, zeros, lines),
        resonances=resonances_of(plant, radius),
        steep=_real_angles(rounded(product(poles, power(whole))), zeros),
        lines=lines,
        loses_digits=share.loses_digits or hardly_moved(plant).size > 0,
        may_lose_some=share.condition > _DOUBTFUL or plant.shifted is not None,
    )


@lru_cache(_REMEMBERED)
def filter_share(velocity: Transfer, position: Transfer, radius: float = 1.0) -> FilterShare:
    """Return the share of two filters in the curve.

    Raises:
        ValueError: P(1) = 0, or a filter is so slow that pairs of float64 take its pole for 1.
    """
    for name, transfer in (("velocity estimator", velocity), ("position filter", position)):
        if around(transfer.denominator, 1).value.hi == 0.0 or size_of(transfer.numerator) == 0.0:
            raise ValueError(
                f"the {name} is so slow that its gain or 1 - pole is lost in float64: it has no "
                "region and no limits; give a higher cut-off, a larger factor or a lower order."
            )
    if around(position.numerator, 1).value.hi == 0.0:
        raise ValueError(
            "the position filter has P(1) = 0: the wall does not push back at rest. It has no "
            "region and no limits; give a filter of gain 1 at z = 1, or ask for verdicts and radii."
        )
    lag = velocity.lag + 1 - position.lag
    above = power(max(-lag, 0)), _DIFFERENCE, velocity.numerator, position.denominator
    below = power(max(lag, 0)), velocity.denominator, position.numerator
    plus, minus = (_half_share(above, below, position, sign, radius) for sign in (1, -1))
    both = (rescaled(reduce(product, each), radius) for each in (above, below))
    return FilterShare(
        plus,
        minus,
        loop=loop_filters(velocity, position),
        real_angles=_real_angles(*map(rounded, both)),
        condition=_condition((velocity.denominator, position.denominator), radius),
    )


def _half_share(
    above: Sequence[Polynomial],
    below: Sequence[Polynomial],
    position: Transfer,
    sign: int,
    radius: float,
) -> _HalfShare:
    """Return one half from the factors of X and Y."""
    x, y = (
        reduce(Around.times, (around(factor, sign, radius) for factor in factors))
        for factors in (above, below)
    )
    return _HalfShare(
        d=around(position.denominator, sign, radius),
        n=around(position.numerator, sign, radius),
        at_one=(y.value.rounded(), x.value.rounded()),
        rows=Rows.from_polynomials([y, x, minor(x, y)]),
        form=Form.DIRECT if sign > 0 else _form(x, y),
    )


def _half(
    d: Around, n: Around, share: _HalfShare, *, gain: float, of_plant: Form | None = None
) -> Half:
    d, n = d.times(share.d), n.times(share.n)
    y, x = share.at_one
    form = _form(d, n) if of_plant is None else of_plant
    # The quotient in pairs is -gamma to the last digit for a mass: its line is K = -k of the hand.
    of_plant_one = -gain * (d.value / n.value).rounded() if form == Form.DIRECT else 0.0
    return Half(
        rows=Rows.from_polynomials([n, d, minor(d, n)]).above(share.rows),
        at_one=(n.value.rounded(), d.value.rounded(), y, x),
        gain=gain,
        forms=(form, share.form),
        values=(of_plant_one, x / y if share.form == Form.DIRECT else 0.0),
    )


def loop_of_system(system: System) -> LinearLoop:
    """Return the same loop as three polynomials."""
    plant, velocity, position, radius = system
    return loop_of_radius(loop_of(plant, filter_share(velocity, position, radius).loop), radius)


def _condition(denominators: Sequence[Polynomial], radius: float) -> float:
    """Return by how much rounding may be amplified where poles are close to each other."""
    coefficients = rounded(rescaled(reduce(product, denominators), radius))
    coefficients /= coefficients[0]
    circle = np.exp(1j * np.geomspace(1e-3, np.pi, 64))
    least = np.min(np.abs(np.prod(circle[:, None] - np.roots(coefficients), axis=1)))
    return float(np.sum(np.abs(coefficients)) / least)


def parts_in_pairs(system: System) -> Float64[np.ndarray, "2 2 2 3 coefficient"]:
    """Return base, stiffness and damping, lowest power first, with what rounding took from them.

    They are in powers of zeta and of zeta - 1, on the halves of z = zeta and of z = -zeta.
    """
    plant, velocity, position, radius = system
    loop = loop_of_system(system)[:3]
    powers, factors = loop_factors(plant.lag, velocity, position)
    unit = ONE[0] / rescaled(power(len(loop[0]) - 1), radius)[0]  # p(z) of a radius is monic
    halves = []
    for (d, n), sign in zip(_plants_around(plant, radius), (1, -1), strict=True):
        shifted = []
        for polynomial, count, others in zip((d, n, n), powers, factors, strict=True):
            parts = [around(factor, sign, radius).shifted for factor in (power(count), *others)]
            whole = reduce(product, parts, polynomial.shifted)
            shifted.append(whole if radius == 1.0 else tuple(c * unit for c in whole))
        straight = loop if sign > 0 else [turned(p) for p in loop]
        halves.append([_as_array(each, len(loop[0])) for each in (straight, shifted)])
    return np.array(halves)


def _as_array(
    parts: Sequence[Polynomial], length: int
) -> Float64[np.ndarray, "2 part coefficient"]:
    """Return coefficients, lowest power first, with zeros up to a length."""
    rows = [[(c.hi, c.lo) for c in p[::-1]] + [(0.0, 0.0)] * (length - len(p)) for p in parts]
    return np.array(rows, float).transpose(2, 0, 1)


def _plants_around(plant: SampledPlant, radius: float) -> list[tuple[Around, Around]]:
    """Return D and N on both halves of the circle."""
    n, d = plant.numerator, plant.denominator
    if plant.shifted is not None:
        n_shifted, d_shifted, n_turned, d_turned = plant.shifted
        above = Around(d, d_shifted), Around(n, n_shifted)
        below = Around(turned(d), d_turned), Around(turned(n), n_turned)
    else:  # the values at the ends are known to more digits than sums of coefficients
        numerator = around(n, 1)
        ratio = plant.at_one[1].value / plant.at_one[0].value
        values = [end.value for end in plant.at_minus_one]
        above = around(d, 1).with_value(numerator.value * ratio), numerator
        below = around(d, -1).with_value(values[1]), around(n, -1).with_value(values[0])
    return [(d.of_radius(radius), n.of_radius(radius)) for d, n in (above, below)]


def _form(above: Around, below: Around) -> Form:
    """Return the form for the quotient of two polynomials."""
    of_above, of_below = (abs(p.value.hi) / size_of(p.straight) for p in (above, below))
    if of_above == of_below == 0.0:
        return Form.WHOLE
    return Form.DIRECT if of_below >= of_above else Form.INVERSE


def _poles(
    estimator: Angles, numerator: Angles, lines: Sequence[PoleLine]
) -> Float64[np.ndarray, "2 pole"]:
    """Return the angles in [0, pi] where Im V = 0 or N is small, and how far their roots are."""
    roots = np.roots(numerator)
    roots = roots[roots.imag >= 0.0]
    distance = np.abs(np.log(np.maximum(np.abs(roots), 1e-300)))
    distances = np.concatenate([np.zeros(len(estimator)), distance])
    angles = np.concatenate([estimator, np.abs(np.angle(roots))])
    for line in lines:
        others = ~line.holds(angles)
        angles = np.concatenate([angles[others], line.poles])
        distances = np.concatenate([distances[others], np.zeros(len(line.poles))])
    return np.stack([angles, np.clip(distances, CLOSEST, _FARTHEST)])


def _real_angles(above: Angles, below: Angles) -> Angles:
    """Return the angles in (0, pi) where the quotient of two polynomials is real.

    Its imaginary part, times |below|^2, is a series of sines: the odd part of above(z) below(1/z).
    """
    length = max(len(above), len(below))
    above, below = (np.append(np.zeros(length - len(p)), p) for p in (above, below))
    series = np.convolve(above, below[::-1])
    roots = np.roots(series - series[::-1])
    roots = roots[np.abs(np.log(np.maximum(np.abs(roots), 1e-300))) < _ON_CIRCLE]
    angles = np.angle(roots)
    return angles[(angles > _ON_CIRCLE) & (angles < np.pi - _ON_CIRCLE)]


def resonances_of(plant: SampledPlant, radius: float = 1.0) -> Float64[np.ndarray, "2 root"]:
    """Return the angles in [0, pi] of zeros and poles of a general device, and how far they are.

    Next to 1 they are found in powers of z - 1: those of slow modes differ by less than the
    coefficients in powers of z tell. One mass needs none of them.
    """
    if plant.shifted is None:
        return np.empty((2, 0))
    pairs = zip((plant.numerator, plant.denominator), plant.shifted[:2], strict=True)
    every = np.concatenate([_roots(*pair) for pair in pairs])
    every = every[every.imag >= 0.0]
    distance = np.abs(np.log(np.maximum(np.abs(every) / radius, 1e-300)))
    return np.stack([np.abs(np.angle(every)), np.clip(distance, CLOSEST, _FARTHEST)])


def hardly_moved(plant: SampledPlant) -> Angles:
    """Return the angles of undamped modes of a general device that walls hardly move.

    There the curve passes gains of all sizes within angles that float64 does not tell apart.
    """
    if plant.shifted is None:
        return np.empty(0)
    n, d = map(rounded, plant.shifted[:2])
    poles = _roots(plant.denominator, plant.shifted[1])
    poles = poles[(np.abs(np.abs(poles) - 1.0) < UNDAMPED) & (poles.imag > 0.0)]
    gains, slopes = (np.polyval(p, poles - 1.0) for p in (n, np.polyder(d)))
    angles: Angles = np.angle(poles[np.abs(gains) < _HARDLY * np.abs(slopes)])
    return angles


@lru_cache(_REMEMBERED)
def _roots(straight: Polynomial, shifted: Polynomial) -> Array:
    far, near = np.roots(rounded(straight)), 1.0 + np.roots(rounded(shifted))
    return np.concatenate([far[abs(far - 1.0) > _SLOW], near[abs(near - 1.0) <= _SLOW]])
