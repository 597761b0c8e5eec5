"""The boundary of a stable set from balls: its curve in float64, and its straight lines.

The curve of a loop has the walls at which a pair of roots is on the circle, p(e^(i theta)) = 0. Its
coefficients are rounded once (``curve_parts``). Where V is real on the circle the curve goes to
infinity: these *poles* follow from the filters alone.

The walls that keep a root at z = 1 or z = -1 are a line. So are those that keep a pair at a pole at
which the plant is real as well (windows, undamped hands, delays of whole or half samples). Divided
by that root, p0 + t q is a line like any other (``line``): its stable intervals are the straight
pieces of the boundary, all of them, proved, each with the angle of the root that ends it (lemma G2
of docs/proofs.md). Where V is real on the whole circle there is no curve, only such lines, at the
angles where the plant is real: as of ki and kd with an integrator by the forward rule.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import lru_cache, partial
from itertools import pairwise
from math import nan
from typing import NamedTuple

import numpy as np
from flint import acb, acb_poly, arb, arb_poly, ctx
from jaxtyping import Bool, Complex128, Float64

from jaxstab.conventions import Verdict
from jaxstab.exact.line import (
    End,
    Interval,
    StableLine,
    is_real_quotient,
    real_quotient_angles,
    stable_pencil,
)
from jaxstab.exact.roots import are_inside, is_sharp, wall_verdict
from jaxstab.model import LoopParameters
from jaxstab.model.affine import AffineParts, affine_triple
from jaxstab.model.balls import Factored, LoopFactors, Triple, ball_loop
from jaxstab.model.device.parts import FIRST_BITS, MOST_BITS, decided, remembered, working_precision

Angles = Float64[np.ndarray, " _"]


class ScaledLoop(NamedTuple):
    """A loop, the units of K and B in SI units, and the radius of the circle."""

    loop: LoopParameters | AffineParts
    units: tuple[float, float]
    radius: float = 1.0

    @remembered()
    def balls(self) -> LoopFactors:
        """The parts of the loop in balls of the precision that is set."""
        if isinstance(self.loop, LoopParameters):
            own = ball_loop(self.loop)
        else:
            own = LoopFactors.from_triple(affine_triple(self.loop))
        return own.scaled(self.units, self.radius)

    def triple(self) -> Triple:
        """The parts of p(z), likewise."""
        return self.balls().triple

    @remembered()
    def polynomials(self) -> list[arb_poly]:
        """These parts multiplied out."""
        return [part.polynomial() for part in self.triple()]

    def at_angle(self, angle: "arb") -> "tuple[acb, list[acb], acb]":
        """The root e^(i angle), the parts of p(z) there, and the conjugate of one of the gains'."""
        z = acb(0, angle).exp()
        parts = [part(z) for part in self.polynomials()]
        return z, parts, (parts[2] if parts[1].contains(0) else parts[1]).conjugate()


_LAST_BITS = FIRST_BITS << 2  # a plant that is real to that precision is real


class CurveParts(NamedTuple):
    """The parts of p = base + N (alpha A + beta B) in float64.

    A and B are what estimator and filter make of the wall.

    Attributes:
        triple: base, stiffness and damping, p(z) monic, the highest power first.
        straight: coefficients of base, N, A and B in powers of z, the lowest first.
        shifted: the same in powers of zeta - 1, for z = zeta and for z = -zeta.
        ends: the parts of p(1) and of (-1)^n p(-1).
        zeros, roots: of the plant's numerator and of its denominator.
        poles: the angles where V is real, or the plant if V always is.
        is_straight: True if V is real on the whole circle.
    """

    triple: Float64[np.ndarray, "3 power"]
    straight: Float64[np.ndarray, "part power"]
    shifted: Float64[np.ndarray, "half part power"]
    ends: Float64[np.ndarray, "half part"]
    zeros: Complex128[np.ndarray, " root"]
    roots: Complex128[np.ndarray, " root"]
    poles: Float64[np.ndarray, " pole"]
    is_straight: bool


def curve_parts(loop: ScaledLoop) -> CurveParts:
    """The polynomials and numbers that make the curve of a loop."""
    with _enough_bits(loop):
        own, degree = loop.balls(), loop.triple().degree
        parts, factors = loop.triple(), _factors(loop)
        unit = 1 / loop.polynomials()[0][degree]
        triple = [_floats((part * unit).coeffs(), degree) for part in loop.polynomials()]
        length = max(part.degree for part in factors)
        whole = [_floats(part.polynomial().coeffs(), length) for part in factors]
        shifted = [
            [_floats(part.around(place).coeffs(), length) for part in factors] for place in (1, -1)
        ]
        ends = [
            [float((part.at_end(place) * unit).mid()) * place**degree for part in parts]
            for place in (1, -1)
        ]
        roots = _roots(own.numerator), _roots(own.denominator)
        angles, is_straight = decided(partial(_poles, loop), most=_LAST_BITS) or ([], False)
        poles = np.array([float(angle.mid()) for angle in angles])
    falling = np.array(triple)[:, ::-1]
    rows = falling, np.array(whole), np.array(shifted), np.array(ends)
    return CurveParts(*rows, *roots, poles, is_straight)


def _enough_bits(loop: ScaledLoop) -> AbstractContextManager[None]:
    """Set a precision at which all coefficients have the digits of float64, and some more."""
    return working_precision(_bits_for_digits(loop))


@lru_cache
def _bits_for_digits(loop: ScaledLoop) -> int:
    def bits() -> int | None:
        return ctx.prec if all(map(_has_digits, (*loop.triple(), *_factors(loop)))) else None

    return decided(bits) or MOST_BITS


def _has_digits(part: Factored) -> bool:
    """Coefficients in powers of z - 1 are sums that cancel by their number and by slow filters."""
    digits = 1e-51  # of the largest coefficient: 21 of them, and what ``curve_of`` refuses
    rising = part.rest.coeffs()
    enough = max(c.abs_upper() for c in rising) * digits * arb(2) ** -len(rising) if rising else 0
    return all(c.rad() <= enough for c in rising)


def _factors(loop: ScaledLoop) -> tuple[Factored, ...]:
    own = loop.balls()
    return own.free, own.numerator, *own.walls


def _floats(rising: "list[arb]", degree: int) -> list[float]:
    return [float(c.mid()) for c in rising] + [0.0] * (degree + 1 - len(rising))


def _roots(part: Factored) -> Complex128[np.ndarray, " root"]:
    """The roots but for those at 0, 1 and -1, roughly."""
    slow = 0.3  # roots closer to 1 are found in powers of z - 1
    plain = Factored(part.without_windows().rest)
    straight, shifted = (
        np.array([float(c.mid()) for c in polynomial.coeffs()])[::-1]
        for polynomial in (plain.rest, plain.around(1))
    )
    far, from_one = np.roots(straight), np.roots(shifted)
    parts = far[abs(far - 1.0) > slow], 1.0 + from_one[abs(from_one) <= slow]
    return np.concatenate(parts, dtype=complex)


_ORDERS = 29  # of a series: 1/29! is below 2^-102


def curve_around(
    loop: ScaledLoop, angles: list[tuple[float, float]]
) -> list[Float64[np.ndarray, "3 order"]]:
    """The curve around angles theta_0, each given with what rounding took from it, by series.

    In u = theta - theta_0, they are those of |N|^2 Im(conj(B) q), of -|N|^2 Im(conj(A) q) and of
    |N|^2 det, whose quotients are alpha and beta: nothing is left to cancel. For |u| < 1/(2 degree)
    what is cut off is below 2^-96 of the sizes of the parts.
    """
    found = []
    with _enough_bits(loop):
        factors = [part.polynomial().coeffs() for part in _factors(loop)]
        for angle, low in angles:
            turn = acb(0, arb(angle) + arb(low)).exp()
            base, n, a, b = (acb_poly(_in_u(rising, turn)) for rising in factors)
            a, b, n = (acb_poly([c.conjugate() for c in part.coeffs()]) for part in (a, b, n))
            square = n * acb_poly([c.conjugate() for c in n.coeffs()])
            det = [c.conjugate() for c in b.coeffs()]
            parts = b * n * base, -(a * n * base), a * acb_poly(det) * square
            series = [[float(c.imag.mid()) for c in part.coeffs()[:_ORDERS]] for part in parts]
            found.append(np.array(series))
    return found


def _in_u(rising: "list[arb]", turn: "acb") -> "list[acb]":
    """Return a polynomial of z = turn e^(iu) in powers of u."""
    terms, power = [], acb(1)
    for c in rising:
        terms.append(c * power)
        power *= turn
    series, factor = [], acb(1)
    for order in range(1, _ORDERS + 1):
        series.append(sum(terms, acb(0)) * factor)
        terms = [k * term for k, term in enumerate(terms)]
        factor *= acb(0, 1) / order
    return series


def slope_of_end(loop: ScaledLoop, end: End, other: float, axis: int) -> float:
    """By how much an end of a line of alpha (axis 0) or of beta moves with the other gain.

    A root that stays on the circle moves along i z: i z p' dtheta + N_own dt + N_other dother = 0.
    """
    with _enough_bits(loop):
        z, parts, _ = loop.at_angle(arb(end.angle) + arb(end.angle_rest))
        weights = 1.0, *(end.value, other)[:: 1 - 2 * axis]
        slope = sum(
            (w * part.derivative()(z) for w, part in zip(weights, loop.polynomials(), strict=True)),
            acb(0),
        )
        along = (acb(0, 1) * z * slope).conjugate()
        own, aside = ((parts[k] * along).imag for k in (1 + axis, 2 - axis))
        return float((-aside / own).mid())


def undamped_modes(
    loop: ScaledLoop, roots: Complex128[np.ndarray, " root"], most: float
) -> list[tuple[float, float]]:
    """Return the angles of modes, known roughly, that a gain of 1 moves by less than ``most``.

    The curve passes gains of all sizes next to such a mode that is hardly damped. Each angle has
    what rounding took from it beside it.
    """
    newton_steps = 8
    angles = []
    with _enough_bits(loop):
        below = acb_poly(loop.balls().denominator.polynomial())
        slope = below.derivative()
        base, n, a, _ = (acb_poly(part.polynomial()) for part in _factors(loop))
        moving = base.derivative()
        for root in roots.tolist():
            z = acb(root.real, root.imag)
            for _ in range(newton_steps):
                z = (z - below(z) / slope(z)).mid()
            angle = float(z.arg().mid())
            if abs(n(z) * a(z)) < abs(moving(z)) * most:
                angles.append((angle, float((z.arg() - angle).mid())))
    return angles


class RootLine(NamedTuple):
    """The walls start + t along keep a root at an angle; ``line`` is about all other roots.

    With t > ``turn`` stable walls are on the other side of the line than with t < ``turn``; NaN if
    they are on one side.
    """

    angle: float
    start: Float64[np.ndarray, "2"]
    along: Float64[np.ndarray, "2"]
    line: StableLine
    turn: float

    def wall(self, t: float) -> Float64[np.ndarray, "2"]:
        """Return a wall of the line."""
        return self.start + t * self.along


class _Kept(NamedTuple):
    """The walls that keep a root: b + alpha s + beta r = 0, and the polynomial that has it.

    The root z leaves the disc beside the line by the sign of Im(``direction`` conj(p/divisor)).
    """

    b: "arb"
    s: "arb"
    r: "arb"
    divisor: "Factored"
    z: "acb | None" = None
    direction: "acb | None" = None


def root_lines(loop: ScaledLoop) -> list[RootLine]:
    """Return the lines of walls with a root at 1, at -1, and at poles where the plant is real."""
    places = [(0.0, partial(_at_end, loop, 1)), (np.pi, partial(_at_end, loop, -1))]
    places += [(float(pole.mid()), partial(_at_pole, loop, pole)) for pole in _real_poles(loop)]
    lines = []
    for angle, kept in places:
        with working_precision(FIRST_BITS):
            _, s, r = (abs(float(x.mid())) for x in kept()[:3])
        by = int(s < r)  # the gain that the other one tells: a line may be next to parallel to one
        ends = decided(lambda: _start_and_along(kept(), by))  # noqa: B023
        if ends:
            line = stable_pencil(partial(_divided, loop, kept, by))
            start, along = (np.array([float(arb.mid()) for arb in pair]) for pair in ends)
            turn = decided(partial(_turn, loop, kept, by))
            own = RootLine(angle, start, along, line, turn)
            lines += [_bounding(loop, own, kept, by)] if line.drift else [own]
    return [own for own in lines if own.line.intervals or not own.line.drift]


def _bounding(loop: ScaledLoop, line: RootLine, at_root: Callable[[], _Kept], by: int) -> RootLine:
    """The parts of a line beside which walls are stable, where it keeps a second root at 1 or -1.

    So does ki = 0 where kp is 0. Beside it p = (z - 1)^2 c + e s has the two roots exp(u),
    u = +-i h + h^2 (1 + c'/c - s'/s)/2, h^2 = e s/c, both inside on a part of the line at most.
    """
    aside = 1e-6  # of a part
    with working_precision(FIRST_BITS):
        meeting = _meeting(loop, line, at_root, by)
    found = []
    for low, high in line.line.intervals:
        cut = [End(meeting, 0.0, line.angle)] if low.value < meeting < high.value else []
        for start, end in pairwise((low, *cut, high)):
            step = aside * (end.value - start.value) * line.along[::-1] * (1.0, -1.0)
            middle = line.wall(0.5 * (start.value + end.value))
            walls = [(middle + way * step).tolist() for way in (-1.0, 1.0)]
            if any(wall_verdict(loop.triple, *x).verdict == Verdict.STABLE for x in walls):
                found.append(Interval(start, end))
    return line._replace(line=line.line._replace(intervals=tuple(found)))


def _meeting(loop: ScaledLoop, line: RootLine, at_root: Callable[[], _Kept], by: int) -> float:
    """The place on such a line where 1 + c'/c = s'/s; NaN if there is none."""
    (_, *sides), parts = loop.triple(), _divided(loop, at_root, by)
    if parts is None:
        return nan
    (p, p0, p1), (q, q0, q1), (s0, s1, _) = (
        [*part.around(-1 if line.angle else 1).coeffs(), *[arb(0)] * 3][:3]
        for part in (*parts, sides[by])
    )
    k = s1 / s0 - 1
    return float(((p1 - k * p0) / (k * q0 - q1)).mid()) if p == q == 0 else nan


def _turn(loop: ScaledLoop, at_root: Callable[[], _Kept], by: int) -> float:
    """The place on a line where the side of its stable walls changes; NaN nowhere."""
    kept = at_root()
    if kept.z is None or kept.direction is None:
        return nan
    parts = _divided(loop, at_root, by)
    if parts is None:
        return nan
    p0, q = (part.polynomial()(kept.z) for part in parts)  # p' at the root over 2i sin(theta)
    rest, slope = ((kept.direction * value.conjugate()).imag for value in (p0, q))
    return float((-rest / slope).mid())  # NaN where the slope may be 0


def _at_end(loop: ScaledLoop, place: int) -> _Kept:
    b, s, r = (part.at_end(place) for part in loop.triple())
    one = arb_poly([1])
    return _Kept(b, s, r, Factored(one, at_one=1) if place == 1 else Factored(one, at_minus_one=1))


def _at_pole(loop: ScaledLoop, angle: "arb") -> _Kept:
    z, (base, stiffness, damping), unit = loop.at_angle(angle)
    s = arb(0) if stiffness.contains(0) else (stiffness * unit).real
    divisor = Factored(arb_poly([1, -2 * angle.cos(), 1]))
    return _Kept((base * unit).real, s, (damping * unit).real, divisor, z, (z * unit).conjugate())


def _start_and_along(
    kept: _Kept, by: int
) -> "tuple[tuple[arb, arb], tuple[arb, arb]] | tuple[()] | None":
    """Return where a line starts and where it leads; () if there is none, None for more bits."""
    b, *slopes = kept[:3]
    own, other = slopes[by], slopes[1 - by]
    if own.contains(0):
        return () if own == other == 0 else None
    start, along = (-b / own, arb(0)), (-other / own, arb(1))
    return (start[::-1], along[::-1]) if by else (start, along)


def _divided(
    loop: ScaledLoop, at_root: Callable[[], _Kept], by: int
) -> tuple[Factored, Factored] | None:
    """Return p0 and q of a line without the root that it keeps."""
    kept = at_root()
    ends = _start_and_along(kept, by)
    if not ends:
        return None
    base, stiffness, damping = loop.triple()
    (start, along), divisor = ends, kept.divisor

    def wall(weights: "tuple[arb, arb]") -> Factored:
        return stiffness.scaled(weights[0]).plus(damping.scaled(weights[1]))

    return _without(base.plus(wall(start)), divisor), _without(wall(along), divisor)


def _without(part: Factored, divisor: Factored) -> Factored:
    """Divide by a divisor; the remainder is 0 and dropped."""
    if divisor.at_one and part.at_one:
        return part.divided(0, 1, 0)
    plain = part.without_windows()
    if divisor.at_minus_one and plain.at_minus_one:
        return plain.divided(0, 0, 1)
    return plain._replace(rest=plain.rest // divisor.polynomial())


@remembered()
def _poles(loop: ScaledLoop) -> "tuple[list[arb], bool] | None":
    """The angles where V is real, none if balls do not tell them, and False; None for more bits.

    If V is real on the whole circle, the angles where the plant is, too, and True.
    """
    walls, is_last = loop.balls().walls, ctx.prec >= _LAST_BITS
    angles = real_quotient_angles(*walls)
    if angles is not None and (is_last or all(map(is_sharp, angles))):
        return angles, False
    if not is_last:
        return None
    if not is_real_quotient(*walls):
        return [], False
    base, acting, _ = loop.triple()
    return real_quotient_angles(base, acting) or [], True


def _real_poles(loop: ScaledLoop) -> "list[arb]":
    """The poles that keep a pair for all walls of a line."""

    def real() -> "list[arb] | None":
        poles = _poles(loop)
        found = poles and [pole for pole in poles[0] if _is_real(loop, pole)]
        return None if found and ctx.prec < _LAST_BITS else found

    return decided(real, most=_LAST_BITS) or []


def _is_real(loop: ScaledLoop, pole: "arb") -> bool:
    _, (base, *_), unit = loop.at_angle(pole)
    return bool(not unit.contains(0) and (base * unit).imag.contains(0))


def others_inside(loop: ScaledLoop, angles: Angles, low: Angles) -> Bool[np.ndarray, " angle"]:
    """Return where all roots of p but a pair at e^(+-i (angle + low)) are inside, proved.

    False also where no bits decide. Scans ask many angles again: the last answers are remembered.
    """
    answers, bits = np.zeros(len(angles), bool), FIRST_BITS
    for k, pair in enumerate(zip(angles.tolist(), low.tolist(), strict=True)):
        answer = _decided_inside(loop, *pair, bits)
        if answer is not None:
            answers[k], bits = answer  # neighbours mostly need as many
    return answers


@lru_cache(1 << 14)
def _decided_inside(
    loop: ScaledLoop, angle: float, low: float, bits: int
) -> tuple[bool, int] | None:
    return decided(partial(_is_inside, loop, angle, low), first=bits)


def _is_inside(loop: ScaledLoop, angle: float, low: float) -> tuple[bool, int] | None:
    base, stiffness, damping = loop.polynomials()
    theta = arb(angle) + arb(low)
    z = acb(0, theta).exp()
    p, s, r = (part(z) for part in (base, stiffness, damping))
    det = (s.conjugate() * r).imag
    if det.contains(0):
        return None
    alpha, beta = (r.conjugate() * p).imag / det, -(s.conjugate() * p).imag / det
    pair = arb_poly([1, -2 * theta.cos(), 1])
    answer = are_inside(Factored((base + stiffness * alpha + damping * beta) // pair))
    return None if answer is None else (answer, ctx.prec)
