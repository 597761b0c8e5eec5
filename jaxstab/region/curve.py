"""The boundary curve of a loop: the walls at which a pair of roots is on the circle. NumPy only.

At z = e^(i theta), p = base + N (alpha A + beta B) = 0, with N the numerator of the plant and A, B
what filter and estimator make of the wall, reads, by Cramer's rule,

    q = base/N,   alpha = Im(conj(B) q)/det,   beta = -Im(conj(A) q)/det,   det = Im(conj(A) B).

The polynomials come from balls, rounded once: on each half of the circle, z = +-zeta with
|arg zeta| <= pi/2, in powers of z and of s = zeta - 1, of which the one with the smaller terms
is evaluated. Real and imaginary parts keep their own digits next to s = 0, so that nothing cancels.

Where det < 0 the stable side of the curve is its right one: such angles count as negative ones,
which run the other way, so the stable set lies to the left everywhere. Where det = 0, at the
*poles*, the curve goes to infinity. The straight parts of the boundary are ``lines``: walls that
keep a root, which balls give as they are (``exact.boundary``).

Next to an undamped mode that walls hardly move the curve passes gains of all sizes within 1e-12
radians, and less. Angles around it, and around others that ask for it, are drawn out (``Stretch``):
theta = theta_0 + u, u a hyperbolic sine of the given angle less theta_0, and the gains are
quotients of series in u. All angles of a region are such drawn ones; ``true_angles`` tells what
they are.

A circle of radius r is the unit circle of the polynomials of r z.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from jaxstab.arrays import PI_REST, Array
from jaxstab.conventions import Verdict
from jaxstab.exact.boundary import (
    CurveParts,
    RootLine,
    ScaledLoop,
    curve_around,
    curve_parts,
    root_lines,
    undamped_modes,
)
from jaxstab.exact.roots import wall_verdict
from jaxstab.model import LoopParameters
from jaxstab.model.device.parts import FIRST_BITS, working_precision
from jaxstab.rounding import UNIT

Angles = Float64[np.ndarray, " _"]
_TINY = 1e-100  # in place of the angle 0, where quotients have a limit


class Stretch(NamedTuple):
    """An interval of angles around one, drawn out, and what rounding took from that.

    ``series``: see ``exact.boundary.curve_around``.
    """

    angle: float
    low: float
    series: Float64[np.ndarray, "3 order"]
    half_width: float

    @property
    def growth(self) -> float:
        """By how much the middle is drawn out, as a logarithm."""
        least = 1e-24  # radians: what it tells apart
        return float(np.log(2.0 * self.half_width / least))

    @property
    def scan(self) -> Angles:
        """Angles of a scan, at all distances from the middle."""
        scan_steps = 120  # on each side of the middle
        shares = np.arange(1, scan_steps) / scan_steps
        return self.angle + self.half_width * np.concatenate([-shares[::-1], shares])

    def holds(self, size: Angles) -> Bool[np.ndarray, " _"]:
        """True for angles between 0 and pi that are drawn out."""
        return np.abs(size - self.angle) < self.half_width

    def offsets(self, size: Angles, low: Angles) -> tuple[Angles, Angles]:
        """Return true angles less the middle, and their derivatives."""
        share = self.growth * ((size - self.angle) + low) / self.half_width
        unit = self.half_width / np.sinh(self.growth)
        return unit * np.sinh(share), unit * np.cosh(share) * self.growth / self.half_width

    def gains_and_slopes(self, size: Angles, low: Angles) -> tuple[Array, Array]:
        """Return alpha and beta, stacked, and their derivatives by drawn angles."""
        offset, speed = self.offsets(size, low)
        orders = np.arange(float(self.series.shape[1]))
        columns = offset ** orders[:, None]
        values, slopes = self.series @ columns, (self.series * orders)[:, 1:] @ columns[:-1]
        gains = values[:2] / values[2]
        return gains, (slopes[:2] - gains * slopes[2]) / values[2] * speed

    def errors(self, size: Angles) -> Array:
        """Return by how much rounding may move the curve at drawn angles: alpha, beta."""
        columns = self.offsets(size, np.zeros(1))[0] ** np.arange(self.series.shape[1])[:, None]
        values, lost = self.series @ columns, np.abs(self.series) @ np.abs(columns)
        lost *= _roundings(self.series.shape[1])
        return (lost[:2] + np.abs(values[:2] / values[2]) * lost[2]) / np.abs(values[2])

    def is_upwards(self, size: Angles) -> Bool[np.ndarray, " angle"]:
        """Where det > 0."""
        offset = self.offsets(size, np.zeros(1))[0]
        return np.polyval(self.series[2, ::-1], offset) > 0.0


class Curve(NamedTuple):
    """The curve of a loop and its lines.

    Attributes:
        parts: base, stiffness and damping of p(z), monic, the highest power first.
        straight: base, N, A and B in powers of z, the lowest first, and their derivatives times z.
        shifted: the same in powers of s, for z = zeta and z = -zeta; derivatives are not
            multiplied.
        close: where |s| is less, powers of s have the smaller terms.
        ends: the parts of p(1) and of (-1)^n p(-1), positive for stable walls.
        lines: the straight parts of the boundary.
        poles: the angles where V is real, or the plant if V always is.
        is_straight: True if V is real everywhere: there is no curve, and the boundary is lines.
        resonances: the angles of the plant's roots, and how far these are from the circle.
        stretches: the intervals of angles that are drawn out.
        loop: what the balls are of.
    """

    parts: Float64[np.ndarray, "3 power"]
    straight: Float64[np.ndarray, "row power"]
    shifted: Float64[np.ndarray, "half row power"]
    close: Float64[np.ndarray, "half part"]
    ends: Float64[np.ndarray, "half part"]
    lines: list[RootLine]
    poles: Angles
    is_straight: bool
    resonances: Float64[np.ndarray, "2 root"]
    stretches: list[Stretch]
    loop: ScaledLoop

    @property
    def degree(self) -> int:
        """The degree of p(z)."""
        return self.parts.shape[1] - 1

    def is_stable(self, wall: Iterable[float]) -> bool:
        """True if balls prove a wall stable."""
        return wall_verdict(self.loop.triple, *map(float, wall)).verdict == Verdict.STABLE


@lru_cache(64)
def curve_of(loop: ScaledLoop) -> Curve:
    """Return the curve of a loop.

    Raises: ValueError for a wall that does not push back at rest, P(1) = 0 or G(0) = 0, and for
    filters so slow that their product of poles less 1 is next to nothing.
    """
    lost = 1e-30  # a product of 1 - pole
    nearest, farthest = 1e-12, 2.0  # distances of roots from the circle
    half_circle = np.linspace(0.0, 1.5, 151)[1:]  # |zeta - 1|, at most sqrt(2)
    with working_precision(FIRST_BITS):
        own = loop.balls()
    if isinstance(loop.loop, LoopParameters) and own.position[0].at_one and loop.radius == 1.0:
        raise ValueError(
            "the position filter has P(1) = 0: the wall does not push back at rest. It has no "
            "region and no limits; give a filter of gain 1 at z = 1, or ask for verdicts and radii."
        )
    if own.numerator.at_one:
        raise ValueError(
            "the device has zero DC gain: its transfer function in s is 0 at s = 0. It has no "
            "region and no limits here; use verdicts, radii, poles or margins."
        )
    for name, (_, below) in (
        ("velocity estimator", own.velocity),
        ("position filter", own.position),
    ):
        with working_precision(FIRST_BITS):
            poles = below.at_end(1) / below.polynomial()[below.degree]
        if not abs(poles) > lost:
            raise ValueError(
                f"the {name} is so slow that its gain or 1 - pole is lost in float64: it has no "
                "region and no limits; give a higher cut-off, a larger factor or a lower order."
            )
    parts = curve_parts(loop)
    acting = parts.triple[1:] / np.maximum(np.abs(parts.triple[1:]).max(axis=1), 1e-300)[:, None]
    if np.linalg.matrix_rank(acting) < 2:
        raise ValueError(
            "the stable gains are not bounded: both gains act alike, or one of them does not act. "
            "Ask for intervals and verdicts."
        )
    order = np.arange(float(parts.straight.shape[1]))
    moved = np.zeros_like(parts.shifted)
    moved[..., :-1] = (parts.shifted * order)[..., 1:]
    sizes = np.sum(np.abs(parts.straight), axis=-1)
    terms = np.abs(parts.shifted) @ half_circle ** order[:, None]
    roots = np.concatenate([parts.zeros, parts.roots])
    roots = roots[roots.imag >= 0.0]
    distance = np.abs(np.log(np.maximum(np.abs(roots) / loop.radius, 1e-300)))
    return Curve(
        parts=parts.triple,
        straight=np.concatenate([parts.straight, parts.straight * order]),
        shifted=np.concatenate([parts.shifted, moved], axis=1),
        close=np.max(np.where(terms < sizes[:, None], half_circle, 0.0), axis=-1),
        ends=parts.ends,
        lines=root_lines(loop),
        poles=parts.poles,
        is_straight=parts.is_straight,
        resonances=np.stack([np.abs(np.angle(roots)), np.clip(distance, nearest, farthest)]),
        stretches=[] if parts.is_straight else _undamped(loop, parts),
        loop=loop,
    )


def _undamped(loop: ScaledLoop, parts: CurveParts) -> list[Stretch]:
    closest = 1e-6  # to the circle
    hardly = 1e-4  # how far a gain of 1 moves a mode that walls hardly move
    roots = parts.roots[parts.roots.imag > 0.0]
    roots = roots[np.abs(np.abs(roots) / loop.radius - 1.0) < closest]
    angles = undamped_modes(loop, roots, hardly)
    return _stretches(loop, angles, parts.poles, parts.triple.shape[1])


def drawn_out(c: Curve, angles: Float64[np.ndarray, "angle 2"]) -> Curve:
    """Return the same curve with angles around others drawn out; each has its rest beside it."""
    neighbours = 1e-6  # radians: angles closer than that are drawn out as one
    centers = [(stretch.angle, stretch.low) for stretch in c.stretches]
    for angle, low in angles.tolist():
        others = [*(other for other, _ in centers), *c.poles.tolist(), 0.0, np.pi]
        if min(abs(angle - other) for other in others) > neighbours:
            centers.append((angle, low))
    return c._replace(stretches=_stretches(c.loop, centers, c.poles, c.degree))


def _stretches(
    loop: ScaledLoop, centers: list[tuple[float, float]], poles: Angles, degree: int
) -> list[Stretch]:
    widest, share = 1e-2, 0.3  # radians, and of the distance to the next one
    limits = np.concatenate([[angle for angle, _ in centers], poles, [0.0, np.pi]])
    stretches = []
    for center, series in zip(centers, curve_around(loop, centers), strict=True):
        away = np.abs(limits - center[0])
        nearest = float(np.min(away[away > 0.0]))
        stretches.append(Stretch(*center, series, min(widest, 0.5 / degree, share * nearest)))
    return stretches


def true_angles(c: Curve, size: Angles) -> tuple[Angles, Angles]:
    """Return the true angles of drawn ones between 0 and pi, and what rounding took from them."""
    angles, low = size.copy(), np.zeros_like(size)
    for stretch in c.stretches:
        held = stretch.holds(size)
        angles[held] = stretch.angle
        low[held] = stretch.low + stretch.offsets(size[held], np.zeros(1))[0]
    return angles, low


def drawn_angles(c: Curve, angles: Angles, low: Angles | float = 0.0) -> Angles:
    """Return true angles as drawn ones; ``low`` is what rounding took from them."""
    drawn, rest = angles.copy(), np.broadcast_to(low, angles.shape)
    for stretch in c.stretches:
        held = stretch.holds(angles)
        gap = (angles[held] - stretch.angle) + (rest[held] - stretch.low)
        growth, half_width = stretch.growth, stretch.half_width
        share = np.arcsinh(gap * np.sinh(growth) / half_width) / growth
        drawn[held] = stretch.angle + half_width * share
    return drawn


def curve_gains(c: Curve, theta: Array, low: Array | float = 0.0) -> Array:
    """Return alpha and beta of the curve, stacked, at angles, which may be negative.

    ``low`` is what rounding took from the angles.
    """
    values = _values(c, theta, 1, low)[0]
    walls = _crossed(values, values[0] / values[1])
    for held, _, (own, _) in _drawn(c, theta, low) if c.stretches else ():
        walls[:, held] = own
    return walls.reshape(2, *np.shape(theta))


def gains_and_slopes(c: Curve, theta: Array, low: Array | float = 0.0) -> tuple[Array, Array]:
    """Return alpha and beta, and their derivatives by the angle."""
    values, (base_slope, n_slope, a_slope, b_slope) = _values(c, theta, 2, low)
    quotient = values[0] / values[1]
    walls = _crossed(values, quotient)
    moved = (base_slope - quotient * n_slope) / values[1]
    steps = _crossed(values, moved + (walls[0] * a_slope + walls[1] * b_slope))
    for held, turned, (own, own_steps) in _drawn(c, theta, low) if c.stretches else ():
        walls[:, held], steps[:, held] = own, own_steps * turned
    return walls.reshape(2, *np.shape(theta)), steps.reshape(2, *np.shape(theta))


def _drawn(
    c: Curve, theta: Array, low: Array | float
) -> Iterator[tuple[Array, Angles, tuple[Array, Array]]]:
    """Yield which angles are drawn out, their signs, their gains and slopes by their sizes."""
    flat = np.ravel(np.asarray(theta, float))
    size, turned = np.abs(flat), np.where(flat < 0.0, -1.0, 1.0)
    rest = np.broadcast_to(low, np.shape(theta)).ravel() * turned
    for stretch in c.stretches:
        held = np.flatnonzero(stretch.holds(size))
        if held.size:
            yield held, turned[held], stretch.gains_and_slopes(size[held], rest[held])


def curve_errors(c: Curve, theta: Angles) -> Array:
    """Return by how much rounding may move the curve at angles, in alpha and in beta, stacked.

    That is to first order: real and imaginary parts may each be off by the roundings of their own
    terms. Powers k of z and of s turn away from the axes by less than k theta.
    """
    orders, size = np.arange(c.straight.shape[1])[:, None], np.abs(theta)
    is_upper = size > np.pi / 2
    u = np.maximum(np.where(is_upper, (np.pi - size) + PI_REST, size), _TINY)
    chord = 2.0 * np.sin(0.5 * u)
    turned = 1.0 + 1j * np.minimum(orders * u, 1.0)
    powers = _sizes(chord**orders * turned * np.where(orders % 2 == 0, 1.0, 1j))
    straight = np.abs(c.straight[:4]) @ turned
    shifted = np.where(is_upper, *(np.abs(c.shifted[half, :4]) @ powers for half in (1, 0)))
    is_close = chord < np.where(is_upper, *c.close[::-1, :, None])
    lost = _roundings(len(orders)) * np.where(is_close, shifted, straight)
    values = _values(c, theta, 1)[0]
    quotient = values[0] / values[1]
    walls, (_, _, a, b) = np.abs(_crossed(values, quotient)), _sizes(values)
    off = _size_of_product(lost[0] + _size_of_product(quotient, lost[1]), 1.0 / values[1])
    off = off + np.sum(walls * lost[2:], axis=0) + _roundings(0) * _sizes(quotient)
    errors = np.stack([_size_of_product(x, off).imag for x in (b, a)])
    errors /= np.abs(_cross(*values[2:]))
    for stretch in c.stretches:
        held = stretch.holds(size)
        errors[:, held] = stretch.errors(size[held])
    return errors


def _sizes(value: Array) -> Array:
    """Return the sizes of real and imaginary parts."""
    return np.abs(value.real) + 1j * np.abs(value.imag)


def _size_of_product(one: Array, other: Array) -> Array:
    """Return bounds of the sizes of a product's parts."""
    one, other = _sizes(one), _sizes(other)
    return (np.conj(one) * other).real + 1j * (one * other).imag


def _roundings(terms: int) -> float:
    """Of the sum of the sizes of complex terms, each with a power that is a product of two more."""
    return 8.0 * (terms + 1) * UNIT


def is_oriented(c: Curve, theta: Angles) -> Bool[np.ndarray, " angle"]:
    """Return where the sign of angles is that of det: the stable side is the left one."""
    _, _, a, b = _values(c, theta, 1)[0]
    is_upper = np.abs(theta) > np.pi / 2  # zeta is on the other half, z conjugate
    upwards: np.ndarray = (_cross(a, b) > 0.0) != is_upper
    for stretch in c.stretches:
        held = stretch.holds(np.abs(theta))
        upwards[held] = stretch.is_upwards(np.abs(theta[held]))
    return upwards == (theta > 0.0)


def _crossed(values: Array, quotient: Array) -> Array:
    """Return the alpha and beta with alpha A + beta B = -quotient."""
    a, b = values[2:]
    walls = _cross(values[:1:-1], quotient) / _cross(a, b)
    walls[1] = -walls[1]
    return walls


def _cross(one: Array, other: Array) -> Array:
    """Return Im(conj(one) other)."""
    return one.real * other.imag - one.imag * other.real


def _values(c: Curve, theta: Array, orders: int, low: Array | float = 0.0) -> Array:
    """Return the parts (order, part, angle), of conjugate z beyond pi/2; order 1 is by theta."""
    flat, count, rows = np.ravel(theta), c.straight.shape[1], 4 * orders
    way = np.where(flat < 0.0, -1.0, 1.0)
    size, rest = np.abs(flat), 0.0 if isinstance(low, float) else np.ravel(low) * way
    is_upper = size > np.pi / 2
    u = np.where(is_upper, (np.pi - size) + (PI_REST - rest), size + rest)
    u = np.where(u == 0.0, _TINY, u)
    zeta, half_turn, side = np.exp(1j * u), np.exp(0.5j * u), np.where(is_upper, -1.0, 1.0)
    chord = 2.0 * half_turn.imag
    powers = _powers(np.concatenate([side * zeta, 1j * chord * half_turn]), count)
    straight = _product(c.straight[:rows], powers[:, : flat.size])
    halves = _product(c.shifted[:, :rows].reshape(2 * rows, count), powers[:, flat.size :])
    shifted = np.where(is_upper, halves[rows:], halves[:rows])
    shifted[4:] *= zeta
    is_close = chord < np.where(is_upper, *c.close[::-1, :, None])
    parts: Array = np.where(is_close, *(x.reshape(orders, 4, -1) for x in (shifted, straight)))
    if orders > 1:
        parts[1] *= 1j * side * way
    return parts


def _product(rows: Array, columns: Complex128[np.ndarray, "power angle"]) -> Array:
    """Return a real matrix times a complex one; NumPy would make the first complex, too.

    It is formed in blocks: a larger product is divided among threads by BLAS, which wait for each
    other up to a hundred times as long as they compute where processors are busy.
    """
    one_thread, even = 2**18, 64  # multiplications, up to which OpenBLAS takes one; columns
    parts, block = columns.view(float), max(one_thread // (rows.size * even), 1) * even
    product = np.empty((len(rows), parts.shape[1]))
    for start in range(0, parts.shape[1], block):
        held = slice(start, start + block)
        np.matmul(rows, parts[:, held], out=product[:, held])
    return product.view(complex)


def _powers(base: Array, count: int) -> Complex128[np.ndarray, "power angle"]:
    """Return the powers 0 ... count - 1, by a few products of many of them."""
    powers = np.empty((count, len(base)), complex)
    powers[0], powers[1:2] = 1.0, base
    filled = 2
    while filled < count:
        more = min(filled - 1, count - filled)
        np.multiply(powers[1 : 1 + more], powers[filled - 1], out=powers[filled : filled + more])
        filled += more
    return powers


# Bracketed roots of many smooth functions of one angle at once, to full precision.


def nonzero(divisor: Array, instead: float) -> Array:
    """Return a divisor without zeros: 1 or infinity in their place keeps quotients finite."""
    return np.where(divisor == 0.0, instead, divisor)


def bracketed_root(
    function: Callable[[Array], Array],
    lower: Array,
    upper: Array,
    ends: tuple[Array, Array] | None = None,
) -> Array:
    """Return a root of an elementwise function between two angles at which its signs differ.

    It is the secant method, with a bisection wherever that would leave the bracket or crawl. Where
    the signs at the ends agree, or one is 0, the result is the end of the smaller value. ``ends``
    are the values at the ends, if they are known.

    Source: the safeguards of Press et al., Numerical Recipes, 9.4.
    """
    steps = 60  # bisection alone would take 53 from any bracket of like ends
    still = 4.0 * UNIT
    enough = 1e-10  # of a step of the secant method: what is left after it is below rounding
    if not lower.size:
        return lower
    at_lower, at_upper = ends or (function(lower), function(upper))
    sign = np.sign(at_upper)
    rise = at_upper - at_lower
    share = -at_lower / nonzero(rise, 1.0)
    is_lower_nearer = abs(at_lower) < abs(at_upper)
    last = np.where(is_lower_nearer, lower, upper)
    at_last = np.where(is_lower_nearer, at_lower, at_upper)
    has_root = np.sign(at_lower) * sign < 0.0
    x: Array = np.where(has_root, lower + share * (upper - lower), last)
    low: Array = lower
    high: Array = upper
    moving = has_root & (lower < upper)
    for _ in range(steps):
        if not np.any(moving):
            break
        value = function(x)
        above = value * sign > 0.0
        low, high = np.where(above, low, x), np.where(above, x, high)
        following = x - value * (x - last) / (value - at_last)  # NaN or infinite: bisected
        step = abs(following - x)
        inside = (following > low) & (following < high)
        done = (step <= enough * abs(x)) | (value == 0.0) | (high - low <= still * high)
        usable = (done & np.isfinite(following)) | (inside & (2.0 * step < abs(x - last)))
        following = np.where(usable, np.clip(following, low, high), 0.5 * (low + high))
        following = np.where(moving & (value != 0.0), following, x)
        x, last, at_last, moving = following, x, value, moving & ~done
    return x
