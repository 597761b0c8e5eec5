"""The boundary curve in double-double, where float64 loses all digits. NumPy only.

Filters with many slow poles have these next to each other: at z next to 1 their polynomials are
1e-5 to 1e-30 of their coefficients. So p(z) = base + alpha S + beta R itself is taken in powers of
z -+ 1 there, and in powers of z elsewhere, in pairs of float64; with Cramer's rule

    alpha = Im(conj(R) base) / Im(conj(S) R),     beta = -Im(conj(S) base) / Im(conj(S) R).

Powers of zeta - 1 have real and imaginary parts with all of their digits, so nothing is divided by
hand, as it is in ``region.points``: enough of the 106 bits remain.

Three things are computed so: points and slopes of the curve (``exact_gains``); the angles of its
poles and of beta = 0, which float64 misses (``in_pairs``); and whether the other roots of walls are
inside the circle (``all_inside``), by Routh's criterion in a variable that keeps slow roots apart.
"""

from fractions import Fraction
from functools import cache, lru_cache, partial
from math import comb, factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from jaxstab.arrays import PI_REST, Array, joined, tree_map
from jaxstab.model.double_double import DoubleDouble
from jaxstab.region.curve import (
    CLOSEST,
    UNDAMPED,
    Angles,
    Curve,
    stretches_around,
    to_rescaled,
    true_angles,
)
from jaxstab.region.roots import bracketed_root
from jaxstab.rounding import PAIR_UNIT

_CLOSE = 0.5  # of zeta - 1: up to there its powers are taken
_LEAST = 1e-11  # in place of the angle 0: there the curve has a limit, and even in the angle
_HALVINGS = 3  # of angles before the series
_AT_ONCE = 1 << 18  # coefficients that are held in memory
_POLISHING, _POLISHED = 3, 1e-3  # steps, and the longest one beside the root
_TERMS = 10  # of the series of sine and cosine, for angles up to 0.1

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

    def indexed(self, *index: slice | None) -> "_Complex":
        """Return both parts at an index of their arrays."""
        return _Complex(self.real[index], self.imag[index])


class ExactGains(NamedTuple):
    """alpha, beta and (alpha + beta V(r) - W(r)) / (1 - cos theta), and their slopes in theta."""

    values: tuple[DoubleDouble, DoubleDouble, DoubleDouble]
    slopes: tuple[Array, Array, Array]


def exact_gains(pairs: Pairs, theta: DoubleDouble, *, with_slopes: bool) -> ExactGains:
    """Return points of the curve at angles between 0 and pi; their slopes take as long again.

    ``pairs`` are base, stiffness and damping in powers of zeta and of zeta - 1, lowest power first,
    on the halves of z = zeta and of z = -zeta.
    """
    width = max(1, _AT_ONCE // pairs.shape[-1])
    starts = range(0, max(len(theta.hi), 1), width)
    return joined([_gains(pairs, theta[k : k + width], with_slopes) for k in starts])


def wall_errors(curve: Curve, theta: Angles) -> Float64[np.ndarray, "2 angle"]:
    """Return how far rounding of the coefficients of p(z) moves points of the curve, roughly.

    It moves the roots by its size over p'(z), and the curve passes gains with their angle.
    """
    angles, _ = true_angles(curve.stretches, theta, np.zeros_like(theta))
    gains = exact_gains(curve.pairs, angles, with_slopes=True)
    parts = np.stack([np.ones_like(theta), *(gain.rounded() for gain in gains.values[:2])])
    upper, u = _folded(angles)
    zeta, sine, _ = _on_circle(u)
    _, rows = _rows(curve.pairs, upper, zeta, sine, with_slopes=True)
    slopes = np.stack([row.real.rounded() + 1j * row.imag.rounded() for row in rows])
    sizes = np.sum(np.abs(curve.pairs[0, 0, 0]), axis=1) @ np.abs(parts)
    moved = PAIR_UNIT * sizes / np.abs(np.sum(parts * slopes, axis=0))
    return moved * np.abs(np.stack(gains.slopes[:2]))


def determinants(pairs: Pairs, theta: DoubleDouble) -> Array:
    """Return Im(conj(S) R), of the sign of Im V, and Im(conj(base) S), 0 where beta is."""
    upper, u = _folded(theta)
    zeta, sine, _ = _on_circle(u)
    (base, stiffness, damping), _ = _rows(pairs, upper, zeta, sine, with_slopes=False)
    both = (stiffness, damping), (base, stiffness)
    turned = np.where(upper, -1.0, 1.0)
    return turned * np.stack([a.cross(b).rounded() for a, b in both])


def lines_crossing_of(pairs: Pairs) -> tuple[DoubleDouble, DoubleDouble]:
    """Return the wall with real roots at r and at -r."""
    (base, stiffness, damping), others = (_numbers(pairs[k, 1, :, :, 0]) for k in range(2))
    offset, slope = -base / stiffness, damping / stiffness
    beta = -(others[0] + others[1] * offset) / (others[2] - others[1] * slope)
    return offset - slope * beta, beta


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
        point = _Complex(
            DoubleDouble.from_value(step.real) + 1.0 * straight, DoubleDouble.from_value(step.imag)
        )
        value, slope = (_wall_value(rows, alpha, beta) for rows in _rows_at(coefficients, point))
        change = value / slope
    root = _Complex(DoubleDouble.from_value(step.real) + 1.0, DoubleDouble.from_value(step.imag))
    rough = np.angle(1.0 + step)
    upper, u = _folded(DoubleDouble.from_value(rough))
    zeta, _, _ = _on_circle(u)
    real = DoubleDouble(*(np.where(upper, -x, x) for x in (zeta.real.hi, zeta.real.lo)))
    modulus = np.abs(1.0 + step)
    turn = _Complex(real, zeta.imag).cross(root).rounded() / modulus
    moved = change / (1.0 + step)
    square = root.real * root.real + root.imag * root.imag + (-1.0)
    excess = square.rounded() / (1.0 + modulus) - moved.real * modulus
    return DoubleDouble.from_value(rough) + (turn - moved.imag), excess


def _wall_value(rows: list[_Complex], alpha: DoubleDouble, beta: DoubleDouble) -> Array:
    """Return base + alpha stiffness + beta damping as complex numbers."""
    parts = zip(*rows, strict=True)
    real, imag = ((base + s * alpha + r * beta).rounded() for base, s, r in parts)
    return real + 1j * imag


def _where(condition: Array, value: DoubleDouble, other: DoubleDouble) -> DoubleDouble:
    return tree_map(lambda a, b: np.where(condition, a, b), value, other)


def _numbers(columns: Float64[np.ndarray, "2 part"]) -> list[DoubleDouble]:
    return [DoubleDouble(*pair) for pair in columns.T]


def _folded(theta: DoubleDouble) -> tuple[Array, DoubleDouble]:
    """Return which angles are in the upper half, and the angles u of zeta, none of them 0."""
    upper = theta.hi > np.pi / 2
    beyond = -theta + DoubleDouble.from_value(np.full_like(theta.hi, np.pi)) + PI_REST
    folded = _where(upper, beyond, theta)
    return upper, _where(folded.hi < _LEAST, DoubleDouble(_LEAST, 0.0), folded)


def _gains(pairs: Pairs, theta: DoubleDouble, with_slopes: bool) -> ExactGains:
    upper, u = _folded(theta)
    zeta, sine, cosine = _on_circle(u)
    rows, slopes = _rows(pairs, upper, zeta, sine, with_slopes=with_slopes)
    base, stiffness, damping = rows
    below = stiffness.cross(damping)
    alpha, beta = damping.cross(base) / below, base.cross(stiffness) / below
    at_one = _numbers(pairs[0, 1, :, :, 0])
    line, across = -at_one[0] / at_one[1], at_one[2] / at_one[1]
    side = _where(upper, cosine, sine)
    height = (side * side).scaled(2.0)  # 1 - cos(theta)
    lift = (alpha + beta * across - line) / height
    if not with_slopes:
        return ExactGains((alpha, beta, lift), (np.empty(0),) * 3)
    base_slope, stiffness_slope, damping_slope = slopes
    turn = stiffness_slope.cross(damping) + stiffness.cross(damping_slope)
    alpha_slope = damping_slope.cross(base) + damping.cross(base_slope) - alpha * turn
    beta_slope = base_slope.cross(stiffness) + base.cross(stiffness_slope) - beta * turn
    alpha_slope, beta_slope = alpha_slope / below, beta_slope / below
    turned = np.where(upper, -1.0, 1.0)
    swing = (sine * cosine).scaled(2.0) * turned
    lift_slope = (alpha_slope + beta_slope * across - lift * swing) / height
    every = [turned * slope.rounded() for slope in (alpha_slope, beta_slope, lift_slope)]
    return ExactGains((alpha, beta, lift), (every[0], every[1], every[2]))


def _rows(
    pairs: Pairs, upper: Array, zeta: _Complex, sine: DoubleDouble, *, with_slopes: bool
) -> tuple[list[_Complex], list[_Complex]]:
    """Return base, stiffness and damping at zeta, and their slopes."""
    is_close = 2.0 * sine.hi < _CLOSE
    count = pairs.shape[-1]
    chosen = np.moveaxis(pairs, 2, 0)[:, upper.astype(int), is_close.astype(int)]
    coefficients = DoubleDouble(*chosen)
    point = _Complex(_where(is_close, (sine * sine).scaled(-2.0), zeta.real), zeta.imag)
    if not with_slopes:
        return _sums(coefficients, _powers(point, count)), []
    rows, slopes = _rows_at(coefficients, point)
    turn = _Complex(-zeta.imag, zeta.real)  # i zeta
    return rows, [row.times(turn) for row in slopes]


def _rows_at(coefficients: DoubleDouble, point: _Complex) -> tuple[list[_Complex], list[_Complex]]:
    """Return polynomials and their derivatives at complex numbers."""
    count = coefficients.hi.shape[-1]
    powers = _powers(point, count)
    order = np.arange(1.0, count)
    higher = coefficients[..., 1:] * order
    lower = powers.indexed(slice(None), slice(count - 1))
    return _sums(coefficients, powers), _sums(higher, lower)


def _sums(coefficients: DoubleDouble, powers: _Complex) -> list[_Complex]:
    """Return sums of coefficients (angle, part, power) times powers (angle, power)."""
    columns = powers.indexed(slice(None), None)
    real, imag = (_total(coefficients * column) for column in columns)
    return [_Complex(real[:, k], imag[:, k]) for k in range(real.hi.shape[1])]


def _total(terms: DoubleDouble) -> DoubleDouble:
    """Return the sum over the last axis, half and half."""
    while (count := terms.hi.shape[-1]) > 1:
        middle = count // 2
        halved = terms[..., :middle] + terms[..., middle : 2 * middle]
        terms = joined([halved, terms[..., 2 * middle :]], -1)
    return terms[..., 0]


def _powers(base: _Complex, count: int) -> _Complex:
    """Return the powers 0 ... count - 1 on a second axis."""
    base = base.indexed(slice(None), None)
    ones = DoubleDouble.from_value(np.ones_like(base.real.hi))
    powers, next_power = _Complex(ones, DoubleDouble.from_value(np.zeros_like(ones.hi))), base
    while powers.real.hi.shape[1] < count:
        powers = joined([powers, powers.times(next_power)], 1)
        next_power = next_power.times(next_power)
    return powers.indexed(slice(None), slice(count))


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
    both = DoubleDouble.from_value(np.zeros((2, *square.hi.shape)))
    for term in _terms():
        both = both * square + term
    sine, cosine = both[0] * x, both[1]
    for _ in range(_HALVINGS):
        sine, cosine = (sine * cosine).scaled(2.0), _versed(sine)
    return sine, cosine


@cache
def _terms() -> list[DoubleDouble]:
    """Return (-1)^k / (2k + 1)! and (-1)^k / (2k)!, the last k first, in columns."""
    terms = []
    for k in range(_TERMS, -1, -1):
        exact = [Fraction((-1) ** k, factorial(2 * k + start)) for start in (1, 0)]
        high = [float(value) for value in exact]
        low = [float(value - Fraction(head)) for value, head in zip(exact, high, strict=True)]
        terms.append(DoubleDouble(np.array(high)[:, None], np.array(low)[:, None]))
    return terms


_SEARCHED = np.concatenate(  # angles between which poles are looked for, on each half
    [np.geomspace(1e-7, 0.1, 240, endpoint=False), np.linspace(0.1, 0.5 * np.pi, 400)]
)
_SAME = 1e-5  # of angles that float64 finds, too


def in_pairs(curve: Curve, pairs: Pairs, centers: DoubleDouble) -> Curve:
    """Return a curve as it is evaluated in double-double, rescaled around the angles ``centers``.

    ``pairs`` are the parts of p(z), as ``exact_gains`` takes them.
    """
    lines = [line.angle + side * line.half_width for line in curve.lines for side in (-1.0, 1.0)]
    stretches = stretches_around(centers, np.array(lines))
    even = np.concatenate([_SEARCHED, np.pi - _SEARCHED])
    outside = ~np.any([s.holds(even) for s in stretches], axis=0) if stretches else slice(None)
    angles = np.unique(np.concatenate([even[outside], *(s.scan for s in stretches)]))

    def both(theta: Angles) -> Float64[np.ndarray, "2 angle"]:
        return determinants(pairs, true_angles(stretches, theta, np.zeros_like(theta))[0])

    def value(which: np.ndarray, theta: Angles) -> Angles:
        chosen: Angles = np.choose(which, both(theta))
        return chosen

    values = both(angles)
    which, index = np.nonzero(np.diff(np.sign(values), axis=1))
    ends = values[which, index], values[which, index + 1]
    roots = bracketed_root(partial(value, which), angles[index], angles[index + 1], ends)
    real, steep = (roots[which == k] for k in range(2))
    poles, lone, resonances = (
        to_rescaled(stretches, DoubleDouble.from_value(a))
        for a in (curve.poles[0], curve.steep, curve.resonances[0])
    )
    is_pole, is_steep = _are_apart(poles, real), _are_apart(lone, steep)
    distances = np.concatenate([curve.poles[1, is_pole], np.full(len(real), CLOSEST)])
    return curve._replace(
        poles=np.stack([np.concatenate([poles[is_pole], real]), distances]),
        steep=np.concatenate([lone[is_steep], steep]),
        resonances=np.stack([resonances, curve.resonances[1]]),
        stretches=stretches,
        pairs=pairs,
        is_exact=True,
    )


def polished_modes(pairs: Pairs, rough: Angles) -> DoubleDouble:
    """Return the angles of undamped modes, roots without a wall, to all digits."""
    nothing = DoubleDouble(0.0, 0.0)
    angles, excess = polished_angles(pairs, nothing, nothing, np.exp(1j * rough) - 1.0)
    return angles[(np.abs(excess) < UNDAMPED) & (np.abs(angles.hi - rough) < _SAME)]


def _are_apart(angles: Angles, others: Angles) -> Bool[np.ndarray, " _"]:
    """Return which angles differ from others by more than rounding."""
    gaps = np.abs(angles[:, None] - others)
    apart: np.ndarray = np.all(gaps > _SAME * angles[:, None], axis=1)
    return apart


# Whether all other roots are inside the circle, at walls on the boundary.
#
# Slow modes have roots next to each other near z = 1, which the coefficients in powers of z cannot
# tell apart. So p(z) is written in powers of z - 1, where each small root makes one more
# coefficient small, and z = r (1 + w) / (1 - w) turns the circle of radius r into the imaginary
# axis, z = r into 0. With
#
#     p = sum c_k (z - r)^k = (1 - w)^-n sum c_k (2 r w)^k (1 - w)^(n - k)
#
# Routh's criterion counts the roots. r is just so much larger than 1 that the roots which the wall
# puts on the unit circle count as inside: the less, the smaller the gains are, because a mode that
# nothing damps is on the circle without them, and moves as little as they are small.

_ON_CIRCLE = 1e-18  # a root so close is on the circle, where gains count as much as the plant
_LEAST_DISTANCE = 1e-28  # of a root on the circle: rounding of pairs
_STEP, _SMALLEST_SHARE = 1e-3, 1e-15  # of the share that gains count for, and the least one
_NEAR_CIRCLE = 1e-2
_WALLS_AT_ONCE = 1 << 11


def all_inside(
    curve: Curve, alpha: DoubleDouble, beta: DoubleDouble, within: float
) -> Bool[np.ndarray, "*wall"]:
    """Return where all roots of p(z) are inside a circle; those on the unit circle count."""
    inside = np.zeros(np.shape(alpha.hi), bool)
    walls = [tree_map(np.ravel, wall) for wall in (alpha, beta)]
    falling = curve.pairs[0, 1, :, :, ::-1].tobytes()  # in powers of z - 1
    outside = np.maximum(within - 1.0, _widths_of_circle(curve, *walls))
    for distance in np.unique(outside).tolist():
        parts = _parts_in_half_plane(falling, distance)
        base, stiffness, damping = (parts[:, k, None] for k in range(3))
        chosen = np.flatnonzero(outside == distance)
        for start in range(0, chosen.size, _WALLS_AT_ONCE):
            chunk = chosen[start : start + _WALLS_AT_ONCE]
            alpha, beta = (wall[chunk] for wall in walls)
            inside.flat[chunk] = _are_hurwitz(base + (stiffness * alpha + damping * beta))
    return inside


def _widths_of_circle(
    curve: Curve, alpha: DoubleDouble, beta: DoubleDouble
) -> Float64[np.ndarray, " wall"]:
    """Return how far outside a root counts as on the circle, by the gains' share in p(z)."""
    base, stiffness, damping = np.sum(np.abs(curve.pairs[0, 0, 0]), axis=-1)
    share = (np.abs(alpha.hi) * stiffness + np.abs(beta.hi) * damping) / base
    share = np.clip(np.nan_to_num(share, nan=1.0), _SMALLEST_SHARE, 1.0)
    steps: np.ndarray = np.floor(np.log(share) / np.log(_STEP))
    return np.maximum(_ON_CIRCLE * _STEP**steps, _LEAST_DISTANCE)


@lru_cache(maxsize=64)
def _parts_in_half_plane(falling: bytes, outside: float) -> DoubleDouble:
    """Return base, stiffness and damping (coefficient, part) in powers of w, highest first.

    They are given in powers of z - 1, (pair, part, coefficient); r = 1 + outside. They are
    remembered, for one curve serves many walls.
    """
    pairs = np.frombuffer(falling).reshape(2, 3, -1).transpose(0, 2, 1)
    return _to_half_plane(
        _about(DoubleDouble(*pairs), outside), DoubleDouble.from_value(outside) + 1.0
    )


def angles_on_circle(
    curve: Curve, alpha: DoubleDouble, beta: DoubleDouble, *, within: float = np.inf
) -> DoubleDouble:
    """Return the angles in (0, pi) of roots that are close to the circle for slow roots.

    ``within`` is how close they have to be at last.
    """
    base, stiffness, damping = curve.pairs[0, 1, 0, :, ::-1]
    angles = [DoubleDouble.from_value(np.empty(0))]
    for k in range(len(alpha.hi)):
        coefficients = base + stiffness * alpha.hi[k] + damping * beta.hi[k]
        step = np.roots(coefficients) if np.all(np.isfinite(coefficients)) else np.empty(0)
        modulus = np.abs(1.0 + step)
        is_near = np.abs(modulus - 1.0) < _NEAR_CIRCLE * np.minimum(1.0, np.abs(step))
        rough = step[is_near & (step.imag > 0.0)]
        polished, excess = polished_angles(curve.pairs, alpha[k], beta[k], rough)
        angles.append(polished[np.abs(excess) < within])
    return joined(angles)


def _about(falling: DoubleDouble, move: float) -> DoubleDouble:
    """Return the coefficients in powers of s - move by those in powers of s, part by part.

    sum c_k s^k has the coefficients sum over k of binomial(k, j) move^(k - j) c_k.
    """
    degree = len(falling.hi) - 1
    total, power = falling, DoubleDouble.from_value(1.0)
    for more in range(1, degree + 1):
        power = power * move
        ways = np.array([float(comb(k, more)) for k in range(degree, more - 1, -1)])[:, None]
        higher = falling[:-more] * power * ways
        total = total + tree_map(lambda x, by=more: np.pad(x, ((by, 0), (0, 0))), higher)
    return total


def _to_half_plane(falling: DoubleDouble, radius: DoubleDouble) -> DoubleDouble:
    """Return sum c_k (2 r w)^k (1 - w)^(n - k), highest power of w first."""
    degree = len(falling.hi) - 1
    total, factor = DoubleDouble.from_value(np.zeros_like(falling.hi)), DoubleDouble.from_value(1.0)
    for power in range(degree + 1):
        term = falling[degree - power] * factor
        total = total + term[None] * _binomials(degree, power)
        factor = factor * radius.scaled(2.0)
    return total


def _binomials(degree: int, power: int) -> Float64[np.ndarray, "coefficient 1"]:
    """Return the coefficients of w^power (1 - w)^(degree - power), highest first."""
    order = degree - power
    signed = [float((-1) ** k * comb(order, k)) for k in range(order, -1, -1)]
    return np.array(signed + [0.0] * power)[:, None]


def _are_hurwitz(falling: DoubleDouble) -> Bool[np.ndarray, " wall"]:
    """Return where all roots have negative real parts (Routh 1877)."""
    even, odd = falling[::2], falling[1::2]
    is_hurwitz = np.ones(falling.hi.shape[1], bool)
    while len(odd.hi):
        is_hurwitz = is_hurwitz & (odd.hi[0] * even.hi[0] > 0.0)
        ratio, missing = even[0] / odd[0], len(even.hi) - len(odd.hi)
        above = tree_map(lambda x, by=missing: np.pad(x, ((0, by), (0, 0))), odd[1:])
        even, odd = odd, even[1:] - above * ratio
    return is_hurwitz
