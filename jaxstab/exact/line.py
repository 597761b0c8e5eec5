"""E3. All stable intervals of a line of walls p_t = p0 + t q, complete and proved.

A root crosses the unit circle at z = e^(i theta) for the wall t where p0 = -t q there, so that
I(theta) = Im(p0 conj q) = 0, and then t = -p0/q. Every factor of p0 and q that the structure knows
(``model.balls.Factored``) is a real function times a phase on the circle:

    z^k = e^(i k theta),     z - 1 = i e^(i theta/2) 2 sin(theta/2),
    z + 1 = e^(i theta/2) 2 cos(theta/2),
    W_n = e^(i (n-1) theta/2) sin(n theta/2)/sin(theta/2).

With a, b the orders of p0 and q at z = 1, u and v their rests, R the product of the real functions,

    I = R Im(i^(a-b) e^(i nu theta/2) u conj v),      nu an integer,

the last factor is a sum of sines or of cosines of whole or of half multiples of theta. Divided by
what it has of sin(theta/2) and cos(theta/2), which are positive, it is a cosine sum c(theta), and
its zeros in (0, pi) are known one by one (``circle``). So all pairs of roots on the circle are
found, and no zero of W_n is taken for one: there q = 0, and the wall is at infinity, as wherever q
vanishes and p0 does not. z = 1 and z = -1 give one wall each, if q is not 0 there. Where p0 and q
both vanish the root stays there for all t: it is divided out, and counted as ``drift``.

These are all crossings, so between two neighbours the number of roots outside is constant. As t
grows

    d|z|^2/dt = -2 I'(theta)/|dp/dtheta|^2:

a pair goes out where I falls and comes in where it rises; the sign of I' is that of c' times that
of R. At z = 1 and -1 the sign of -q/p_t' tells. With the changes known, one count of the roots
outside (E1) gives all: it is taken where the number is least, and again where it is largest. That
both agree is part of the answer: a wrong sign of R would leave a difference. Walls where two
crossings are not told apart, or that have no direction (a root that only touches the circle, two
roots at z = 1), begin a new chain of counts.

Ends that E1 counts between are at most as wide as a float64 where the balls allow it. An interval
is open: at its ends a root is on the circle. ``horizon`` is how far out the line was looked at; it
is infinite but where q vanishes next to a zero of c.
"""

from collections.abc import Callable
from fractions import Fraction
from functools import partial
from itertools import accumulate, pairwise
from math import inf, nan
from typing import NamedTuple

from flint import acb, acb_poly, arb, arb_poly, ctx, fmpq_poly

from jaxstab.conventions import Status
from jaxstab.exact.circle import is_patient, zeros
from jaxstab.exact.roots import (
    Number,
    TripleAt,
    is_sharp,
    rational_verdict,
    roots_outside,
    sign_of,
)
from jaxstab.model.balls import Factored
from jaxstab.model.device.parts import FIRST_BITS, decided, remembered, working_precision
from jaxstab.shown import text_with_bound

_BLOCK = 32  # terms of a polynomial that are summed by Horner's rule
_SHARE = 0.4873  # of a gap, where a count is taken


class LineStatus(Status):
    """The completeness of a line of walls."""

    PROVED = 1, "all stable intervals of the line, proved"
    UNDECIDED = (
        2,
        "3,072 bits do not tell all crossings of the circle, or the counts between them, or the "
        "leading coefficient vanishes all along the line: the loop is algebraic",
    )
    USABLE = (
        3,
        "usable intervals, each proved from end to end; that there are no others is searched",
    )


class End(NamedTuple):
    """The end of an interval: t, a bound of its error, and the angle of the root that crosses.

    ``angle_rest`` is what rounding took from the angle, ``change`` how many more roots are outside
    beyond, None if unknown. Infinite, without an angle, where the interval has no end. Where
    several roots cross, or may, ``is_shared``, the angle is that of one of them.
    """

    value: float
    error: float
    angle: float
    is_shared: bool = False
    angle_rest: float = 0.0
    change: int | None = None

    @property
    def told(self) -> float:
        """The value; 0 where it is not told from that."""
        return 0.0 if abs(self.value) <= self.error else self.value + 0.0

    def moved(self, way: float) -> float:
        """The value moved by its error one way; 0 where it is not told from that."""
        return 0.0 if abs(self.value) <= self.error else self.value + way * self.error


class Interval(NamedTuple):
    """All t between two ends are stable."""

    low: End
    high: End


class StableLine(NamedTuple):
    """The stable walls of a line, from the smallest t to the largest.

    Attributes:
        intervals: all of them.
        crossings: the walls where roots cross or touch the unit circle.
        drift: how many roots stay at z = 1 or -1 for all t; the intervals are those of the others.
        horizon: the intervals are complete for |t| below it.
        status: whether this is proved.
        bits: the precision that this took.
    """

    intervals: tuple[Interval, ...]
    crossings: tuple[End, ...]
    drift: int
    horizon: float
    status: LineStatus
    bits: int

    def __repr__(self) -> str:
        intervals = [
            " to ".join(
                text_with_bound(end.value, end.error).removesuffix(" +/- 0") for end in interval
            )
            for interval in self.intervals
        ]
        head = f"StableLine: {self.status.words}{', but for the drift' if self.drift else ''}"
        return "\n  ".join([head, *(intervals or ["none"])])

    @property
    def inner(self) -> list[tuple[float, float]]:
        """The ends of the intervals, within their errors."""
        return [(low.moved(1.0), high.moved(-1.0)) for low, high in self.intervals]

    def holding(self, t: float) -> Interval | None:
        """The interval that holds a number, if one does for certain."""
        for interval in self.intervals:
            low, high = interval
            if low.value + low.error < t < high.value - high.error:
                return interval
        return None


def stable_line(
    triple: TripleAt,
    start: tuple[float, float],
    along: tuple[float, float],
    first_bits: int = FIRST_BITS,
) -> StableLine:
    """All stable walls start + t along, of (K, B) each; ``first_bits`` are tried first.

    Example:
        >>> from jaxstab.exact.line import stable_line
        >>> from jaxstab.model.balls import ball_triple
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> row = stable_line(lambda: ball_triple(loop), (0.0, 20.0), (1.0, 0.0))
        >>> [(low.value, round(high.value, 6)) for low, high in row.intervals]
        [(0.0, 35324.95892...)]
    """

    def line() -> tuple[Factored, Factored] | None:
        parts = triple()
        q = parts.stiffness.scaled(along[0]).plus(parts.damping.scaled(along[1]))
        p0 = parts.at(*start)
        return (p0, q) if max(p0.degree, q.degree) == parts.degree else None

    return stable_pencil(line, first_bits)


def stable_pencil(
    pencil: Callable[[], tuple[Factored, Factored] | None], first_bits: int = FIRST_BITS
) -> StableLine:
    """All t for which p0 + t q is stable; None, in place of p0 and q, asks for more bits."""

    @remembered()
    def line() -> _Line | None:
        parts = pencil()
        return None if parts is None else _Line.of(*parts)

    def crossings() -> _Found | None:
        own = line()
        return None if own is None else _found(own)

    found = decided(crossings, first=first_bits)
    counts = found and _counts(line, found)
    if found is None or counts is None:
        return StableLine((), (), 0, 0.0, LineStatus.UNDECIDED, first_bits)
    with working_precision(found.bits):
        ends = [End(-inf, 0.0, nan), *map(_end, found.crossings), End(inf, 0.0, nan)]
    stable = [Interval(*pair) for pair, n in zip(pairwise(ends), counts, strict=True) if n == 0]
    stable = [] if found.stays else stable
    return StableLine(
        intervals=tuple(stable),
        crossings=tuple(ends[1:-1]),
        drift=found.drift,
        horizon=found.horizon,
        status=LineStatus.PROVED,
        bits=found.bits,
    )


class Crossing(NamedTuple):
    """Walls at which roots cross the circle: t, the angle, and how many more are outside beyond.

    ``change`` is None where it is not known; the angle is that of one of several.
    """

    t: "arb"
    angle: "arb"
    change: int | None
    is_shared: bool = False


class _Line(NamedTuple):
    """p0 + t q without their common roots at 0, 1 and -1; p0 has no windows."""

    p0: Factored
    q: Factored
    drift: int
    stays: bool = False  # outside or on the circle, and elsewhere, for all t

    @classmethod
    def of(cls, p0: Factored, q: Factored) -> "_Line":
        p0 = p0.without_windows()
        above, below, stays = p0.in_fractions, q.in_fractions, False
        if above and below:  # no bits find what fractions do
            common = above.gcd(below)
            both, one = Factored.from_rational(common), arb_poly([1])
            ends = both._replace(rest=one)  # roots at 0, 1 and -1, which are known
            p0 = p0._replace(rest=one).times(ends).times(Factored.from_rational(above // common))
            q = q._replace(rest=one).times(ends).times(Factored.from_rational(below // common))
            whole = ends.polynomial().unique_fmpz_poly()
            if both.rest.degree() > 0 and whole is not None:
                stays = not rational_verdict(common // fmpq_poly(whole))
        if p0.at_minus_one:
            q = q.without_windows()
        known = (part.known for part in (p0, q) if not part.is_zero)
        shared = [min(counts) for counts in zip(*known, strict=True)]
        p0, q = (part if part.is_zero else part.divided(*shared) for part in (p0, q))
        return cls(p0, q, sum(shared[1:]), stays)

    def at(self, t: "arb | float") -> "arb_poly":
        return self.p0.polynomial() + self.q.polynomial() * t


class _Found(NamedTuple):
    """All crossings in the order of t, how far out they were looked for, and the drift.

    ``between`` has a wall in each gap between them, and beyond the outermost.
    """

    crossings: list[Crossing]
    between: "list[arb]"
    horizon: float
    drift: int
    bits: int
    stays: bool = False


def _found(line: _Line) -> _Found | None:
    """The crossings, each as accurate as a float64; None for more bits."""
    nothing = 1e-30  # of the largest end: an error that small is none
    found = _crossings(line)
    if found is None:
        return None
    crossings = _joined(found[0])
    scale = max((crossing.t.abs_upper() for crossing in crossings), default=arb(), key=float)
    for t, *_ in crossings:
        is_known = is_sharp(t) or t.rad() < scale * nothing
        if not (is_known or is_patient()):
            return None
    between = _between(crossings)
    return (
        None
        if between is None
        else _Found(crossings, between, found[1], line.drift, ctx.prec, line.stays)
    )


def _end(crossing: Crossing) -> End:
    angle = float(crossing.angle.mid())
    rest = float((crossing.angle - angle).mid())
    return End(*Number.of(crossing.t), angle, crossing.is_shared, rest, crossing.change)


def real_quotient_angles(p0: Factored, q: Factored) -> "list[arb] | None":
    """The angles in (0, pi) where q/p0 is real, 0 or infinite, in order; None for more bits."""
    places = zeros(_cosines_of(p0, q), is_last_try=is_patient())
    if places is None:
        return None
    windows = {Fraction(2 * j, n) for n in p0.windows + q.windows for j in range(1, (n + 1) // 2)}
    known = [arb.pi() * share.numerator / share.denominator for share in windows]
    others = [place.angle for place in places if not any(place.angle.overlaps(t) for t in known)]
    return sorted(others + known, key=lambda t: float(t.mid()))


def is_real_quotient(p0: Factored, q: Factored) -> bool:
    """True if q/p0 is real on the whole circle, as far as the balls tell."""
    return all(c.contains(0) for c in _cosines_of(p0, q))


# --------------------------------------------------------------------------------------- crossings
def _crossings(line: _Line) -> tuple[list[Crossing], float] | None:
    """All crossings, in any order, and how far out the line was looked at; None for more bits."""
    p0, q, *_ = line
    if p0.is_zero or q.is_zero:  # no t moves a root; t = 0 may leave nothing of p
        return [Crossing(arb(0), arb("nan"), None)] * p0.is_zero, inf
    turn = p0.at_one - q.at_one
    places = zeros(_cosines_of(p0, q), is_last_try=is_patient())
    if places is None:
        return None
    above, below = OnCircle.of(p0), OnCircle.of(q)
    sign = 2 if turn // 2 % 2 else -2  # of i^turn, but for i
    at = [
        (angle, above.at(angle), below.at(angle), slope * _real_sign(q, angle) * sign)
        for angle, slope in places
    ]
    ends = (1, arb(0), q.at_one), (-1, arb.pi(), q.order_at_minus_one)
    for end, angle, order in ends:
        if not order:
            at.append((angle, acb(p0.at_end(end)), acb(q.at_end(end)), _side_at_end(line, end)))
    found, horizon = [], inf
    for angle, value, by_t, side in at:
        if not by_t.contains(0):
            found.append(Crossing(-(value / by_t).real, angle, side or None))
        elif value.contains(0):
            return None  # a root that no t moves, or too few bits
        else:
            horizon = min(horizon, float((value.abs_lower() / by_t.abs_upper()).lower()))
    return found, horizon


def _side_at_end(line: _Line, place: int) -> int:
    """The change of the roots outside at the wall with one at z = 1 or -1; 0 if not known."""
    p0, q, *_ = line
    size = q.at_end(place)
    slope = line.at(-p0.at_end(place) / size).derivative()(place)
    return sign_of(-place * size * slope)


def _phase(p: Factored) -> int:
    """The phase on the circle of the factors that the structure knows, in half angles."""
    return 2 * p.power + p.at_one + p.at_minus_one + sum(n - 1 for n in p.windows)


def _real_sign(p: Factored, angle: "arb") -> int:
    """The sign of the real functions of these factors; 0 where it is not known."""
    sign = 1
    for n in p.windows:
        sign *= sign_of((angle * n / 2).sin())
    return sign


def _cosines_of(p0: Factored, q: Factored) -> "list[arb]":
    """c(theta) of p0 and q: the sum of Im, or for an odd turn of Re, of their rests, divided.

    The terms are g_j e^(i w theta/2), w = 2j + phase. Their sines and cosines, over those of theta
    or theta/2, are sums of cosines (Dirichlet's kernel).
    """
    is_odd, phase = (p0.at_one - q.at_one) % 2 == 1, _phase(p0) - _phase(q)
    product = p0.rest * arb_poly(q.rest.coeffs()[::-1])
    sums: dict[int, arb] = {}
    for power, g in enumerate(product.coeffs()):
        w = 2 * (power - q.rest.degree()) + phase
        sums[abs(w)] = sums.get(abs(w), arb(0)) + (-g if w < 0 and not is_odd else g)
    if is_odd and phase % 2 == 0:
        return [sums.get(w, arb(0)) for w in range(0, max(sums) + 1, 2)]
    total, rising = arb(0), []
    others = arb(0)  # terms of k of the other parity
    for w in range(max(sums, default=0), 0, -2):
        k = w // 2  # sin(k theta), sin or cos((k + 1/2) theta)
        here = sums.get(w, arb(0))
        # sin(k theta) = sin(theta) (2 cos((k - 1) theta) + 2 cos((k - 3) theta) + ...)
        if phase % 2 == 0:
            total, others = others + here, total
            rising.append(total)
        else:
            total += here * (-1) ** (k if is_odd else 0)
            rising.append(total * (-1) ** (k if is_odd else 0))
    rising = rising[::-1] or [arb(0)]
    return [rising[0], *(2 * c for c in rising[1:])]


class OnCircle(NamedTuple):
    """A polynomial for values on the circle, its rest in blocks, and a bound of the rest's slope.

    A ball of angles has values without what powers of it would lose to wrapping.
    """

    p: Factored
    blocks: "list[acb_poly]"
    slope: "arb"

    @classmethod
    def of(cls, p: Factored) -> "OnCircle":
        """The values of a polynomial."""
        rising = p.rest.coeffs()
        starts = range(0, len(rising), _BLOCK)
        slope = sum((k * abs(c) for k, c in enumerate(rising)), arb(0)).abs_upper()
        return cls(p, [acb_poly(rising[start : start + _BLOCK]) for start in starts], slope)

    def at(self, angle: "arb") -> "acb":
        """The value at e^(i theta)."""
        p, half, middle = self.p, angle / 2, angle.mid()
        z, spread = acb(0, middle).exp(), angle.rad() * self.slope
        rest = acb(arb(0, spread), arb(0, spread))
        for number, block in enumerate(self.blocks):
            value = block(z)
            rest += value * acb(0, middle * (number * _BLOCK)).exp() if number else value
        if p.at_one:
            rest *= acb(0, 2 * half.sin()) ** p.at_one
        if p.at_minus_one:
            rest *= (2 * half.cos()) ** p.at_minus_one
        for n in p.windows:
            rest *= (half * n).sin() / half.sin()
        return rest * acb(0, half * _phase(p)).exp()


def _joined(crossings: list[Crossing]) -> list[Crossing]:
    joined: list[Crossing] = []
    for crossing in sorted(crossings, key=lambda c: float(c.t.lower())):
        if joined and not joined[-1].t < crossing.t:
            last = joined.pop()
            is_known = last.change is not None and crossing.change is not None
            change = last.change + crossing.change if is_known else None  # type: ignore[operator]
            crossing = Crossing(last.t.union(crossing.t), last.angle, change, is_shared=True)
        joined.append(crossing)
    return joined


# ------------------------------------------------------------------------------------------ counts
def _between(crossings: list[Crossing]) -> "list[arb] | None":
    """A wall in each gap; None where a gap is too short for the precision."""
    if not crossings:
        return [arb(_SHARE)]
    first, last = crossings[0].t.lower(), crossings[-1].t.upper()
    reach = (1 + abs(first) + abs(last)) * _SHARE
    walls = [first - reach]
    for low, high in pairwise(crossing.t for crossing in crossings):
        walls.append((low.upper() + (high.lower() - low.upper()) * _SHARE).mid())
        if not low < walls[-1] < high:
            return None
    return [*walls, last + reach]


def _counts(line: Callable[[], _Line | None], found: _Found) -> list[int] | None:
    """The number of roots outside in each gap; None where they are not known or contradict."""
    counts: list[int] = []
    begins = [k for k, crossing in enumerate(found.crossings, start=1) if crossing.change is None]
    for start, end in pairwise([0, *begins, len(found.between)]):
        changes = (crossing.change or 0 for crossing in found.crossings[start : end - 1])
        relative, shifts = list(accumulate(changes, initial=0)), set()
        for index in {relative.index(min(relative)), relative.index(max(relative))}:
            wall = partial(_outside, line, found.between[start + index].mid())
            count = decided(wall, first=found.bits)  # it may need more than crossings
            if count is None:
                return None
            shifts.add(count - relative[index])
        if len(shifts) > 1:
            return None
        counts += [count + min(shifts) for count in relative]
    return counts


def _outside(line: Callable[[], _Line | None], t: "arb") -> int | None:
    """The number of roots outside; None also where the leading coefficient is 0 by accident."""
    own = line()
    if own is None:
        return None
    p = own.at(t)
    return roots_outside(p) if p.degree() == max(own.p0.degree, own.q.degree) else None
