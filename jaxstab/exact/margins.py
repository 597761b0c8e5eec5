"""E5, B5, J1. Margins of the gain, the phase, the delay and its jitter; peaks of the closed loop.

E5. The loop is opened at its force: L = N/D, p = D + N, S = D/p and T = N/p, D and N without the
roots at 0, 1 and -1 that they share. On the circle (docs/proofs.md has the reasons):

- Gain margins: D + t N is a line of walls, and the interval of t that holds 1 is known (E3).
- Phase margin: |L| = 1 at the zeros of |N|^2 - |D|^2, a cosine sum. There L is -1 after a lag of
  pi + arg L, arg L in (-pi, pi], or after a lead of what is left of 2 pi. The least of all counts.
- Delay margin of a loop that is known at its samples alone: the least of these lags over their
  angles while |N| < |D| at z = -1, else one sample at most.
- Peaks of |X/p|, X = D, N or D - N: where z d/dz log(X/p) is real, at angles that E3 has, or at
  z = 1 or -1. The disk margin is 2/max |S - T|.

Every number is a ball that is as narrow as a float64, or more bits are asked for.

B5. The largest extra delay of a stable wall, up to the first one with a root on the circle. For a
delay of n + f samples, n whole and 0 <= f < 1, a root lies at z = e^(i theta) if

    1 + z^-(n+1) W = 0,    W = N_f H/D,    N_f = (z - 1) N[v(f)] + N[v(0)]

(lemma V10), H the wall, v(f) what a force held for 1 - f adds to the states, and N[.] linear. Over
a box of theta and f, log W is enclosed by its mean-value form: the value in the middle and the
slopes over all of the box. Where its real part is not 0 the box has no root for any n (|W| = 1 is
needed). Else its imaginary part gives the whole numbers n that may have one,

    (n + 1) theta = arg W + pi + 2 pi l,

and the least n + f of them is the key of the box. The box of the smallest key is halved, again and
again: whatever the keys are, no delay below the smallest one has a root on the circle. So that key
is a proved margin at any time, and where no box is left no delay is too long. Near zeros of N_f H,
where log W is no use, |N_f H| < |D| is shown by mean values of both.

All is evaluated in powers of z - 1, where D and N_f vanish together next to 0; a window is a sum of
phases. The search ends where the box is too short to matter.

J1. Stability for every sequence of delays, as the isolation of zeros of one cosine sum. The delay
of each sample lies between L and L + J, in samples, and the newest sample that has arrived sets the
force. With p = z^lag D Dp Dv + N H of the loop of delay L, H = K Np Dv + B Nv Dp the wall and Q the
response of the device to changes of the force that come up to J late (``late_cosines``), the
small-gain theorem (Kao, Lincoln 2004; lemma J1 of docs/proofs.md) says: if the loop of delay L is
stable, and on the whole unit circle

    |p|^2 > Q |(z - 1) H|^2,

then it is stable for every sequence. On the circle |a|^2 is the cosine sum with the coefficients of
a(z) a(1/z), and so is all of the difference. It has no zero in (0, pi) and is positive at 0 and pi:
that is the inequality (``circle``). Nothing is divided, so that a free device is no special case.
"""

from collections.abc import Callable, Collection
from functools import cache, partial, reduce
from heapq import heappop, heappush
from math import inf, nan, nextafter, pi, ulp
from operator import add
from typing import Any, NamedTuple

import numpy as np
from flint import acb, acb_poly, arb, arb_mat, arb_poly
from jaxtyping import Complex128, Float64

from jaxstab.conventions import Status
from jaxstab.exact.circle import is_patient, is_positive, zeros
from jaxstab.exact.line import OnCircle, real_quotient_angles, stable_pencil
from jaxstab.exact.roots import Number, are_inside, is_sharp, sign_of
from jaxstab.model.balls import Factored, LoopFactors
from jaxstab.model.device.parts import FIRST_BITS, decided, working_precision
from jaxstab.model.device.sampling import OneSample, states_and_force


class Reading(NamedTuple):
    """A number, a bound of its error, and the angle where it is; NaN where it is not proved.

    The error is infinite where the number is only known to be no smaller.
    """

    value: float = nan
    error: float = nan
    angle: float = nan


class Readings(NamedTuple):
    """Factors of the open loop, the phase in rad, the delay in samples, and peaks."""

    least_gain: Reading
    largest_gain: Reading
    phase: Reading
    delay: Reading
    sensitivity: Reading
    complementary: Reading
    disk: Reading


_OF_NOTHING = Readings(
    *[Reading(-inf, 0.0), *[Reading(inf, 0.0)] * 3],
    *[Reading(1.0, 0.0), Reading(0.0, 0.0), Reading(2.0, 0.0)],
)


_PEAKS = {"sensitivity": (1, 0), "complementary": (0, 1), "disk": (1, -1)}


def readings(
    parts: Callable[[], tuple[Factored, Factored]], *, asked: Collection[str] = Readings._fields
) -> Readings:
    """The margins and peaks of a loop that is stable, from D and N in balls; those asked for."""

    def opened() -> tuple[Factored, Factored]:
        below, above = parts()
        shared = [*map(min, below.known, above.known)]
        return below.divided(*shared), above.divided(*shared)

    with working_precision(FIRST_BITS):
        if parts()[1].is_zero:
            return _OF_NOTHING
    none = [Reading()] * 2
    has_gain, has_phase = ("largest_gain" in asked or "least_gain" in asked), "phase" in asked
    ends = (has_gain and stable_pencil(opened).holding(1.0)) or none
    lags = ((has_phase or "delay" in asked) and decided(lambda: _crossovers(*opened()))) or none
    peaks = [
        (name in asked and decided(partial(_peak, opened, *kind))) or Reading()
        for name, kind in _PEAKS.items()
    ]
    return Readings(*(Reading(*end[:3]) for end in ends), *lags, *peaks)


def frequency_response(
    parts: Callable[[], tuple[Factored, Factored]], angles: Float64[np.ndarray, " angle"]
) -> Complex128[np.ndarray, " angle"]:
    """L at angles in (0, pi], for pictures: each to some digits more than float64 has."""
    with working_precision(FIRST_BITS):
        below, above = map(OnCircle.of, parts())
        places = map(arb, angles.tolist())
        return np.array([complex(above.at(place) / below.at(place)) for place in places])


class _Place(NamedTuple):
    """A number in a ball, the angle where it is, and whether it is known to be there at all."""

    ball: arb
    angle: arb
    is_known: bool = True


def _crossovers(below: Factored, above: Factored) -> tuple[Reading, Reading] | None:
    """The phase margin, and the delay margin in whole samples; None for more bits."""
    sums = arb_poly(squared(above)) - arb_poly(squared(below))
    found = zeros([sums[0], *(2 * c for c in sums.coeffs()[1:])], is_last_try=is_patient())
    if found is None:
        return None
    phases, delays = list[_Place](), list[_Place]()
    circle, pi = (OnCircle.of(above), OnCircle.of(below)), arb.pi()
    for angle, slope in found:
        upper, lower = (side.at(angle) for side in circle)
        value = upper / lower  # NaN, which contains 0, where D may be 0
        if value.imag.contains(0) and not value.real > 0:
            return None
        lag = pi + value.arg()
        phases.append(_Place(lag.min(2 * pi - lag), angle, slope != 0))
        delays.append(_Place(lag / angle if angle > 0 else lag / angle.upper(), angle, slope != 0))
    if sign_of(abs(below.at_end(-1)) - abs(above.at_end(-1))) != 1:
        delays.append(_Place(arb(1), pi))
    phase, delay = _extreme(phases), _extreme(delays)
    return None if phase is None or delay is None else (phase, delay)


def _peak(
    opened: Callable[[], tuple[Factored, Factored]], of_below: int, of_above: int
) -> Reading | None:
    """The largest modulus of a multiple of D and one of N over p, or 2 over it for the two.

    With X = (z-1)^a (z+1)^b u and p = w but for a power of z, z d/dz log(X/p) = Q/P with
    P = (z-1) (z+1) u w and Q = z (a (z+1) + b (z-1)) u w + z (z-1) (z+1) (u' w - u w'), without the
    factor whose order, a or b, is 0.
    """
    below, above = opened()
    x = below.scaled(of_below).plus(above.scaled(of_above)).without_windows()
    p = below.plus(above)
    z, both, (_, a, b) = arb_poly([0, 1]), x.rest * p.rest, x.known
    minus, plus = (z - 1 if a else 1), (z + 1 if b else 1)
    rising = (x.rest.derivative() * p.rest - x.rest * p.rest.derivative()) * minus * plus
    rising += both * (a * plus + b * minus)
    turning = Factored(both, 0, min(a, 1), min(b, 1)), Factored(rising, 1)
    angles = real_quotient_angles(*turning) if rising.length() else list[arb]()
    if angles is None:
        return None
    sides = OnCircle.of(x), OnCircle.of(p)
    places = [_Place(abs(sides[0].at(t) / sides[1].at(t)), t) for t in angles]
    for place, angle in ((1, arb(0)), (-1, arb.pi())):
        places.append(_Place(abs(x.at_end(place) / p.at_end(place)), angle))
    return _extreme(places, is_largest=True, of=2 if of_below * of_above else None)


def _extreme(
    places: "list[_Place]", *, is_largest: bool = False, of: int | None = None
) -> Reading | None:
    """The least number, or the largest, or ``of`` over it; of equals that at the smallest angle."""
    if not places:
        return Reading(inf, 0.0)
    best = places[0].ball
    for ball, *_ in places[1:]:
        best = best.max(ball) if is_largest else best.min(ball)
    equal = [place for place in places if place.ball.overlaps(best)]
    best = best if of is None else of / best
    if not equal or not is_sharp(best):
        return None
    _, angle, is_known = min(equal, key=lambda place: float(place.angle.mid()))
    value, error = Number.of(best)
    return Reading(value, error if is_known else inf, float(angle.mid()))


# ---------------------------------------------------------------------------------------- the delay
_TURNS = 32  # of (n + 1) theta that are looked at
_TERMS = 8  # of v(f) about the middle of an interval

Interval = tuple[float, float]


class DelayStatus(Status):
    """The status of a margin of the delay."""

    PROVED = 1, "no shorter delay has a root on the circle, proved"
    UNLIMITED = 2, "no delay is too long, proved"
    NOT_SHARP = 3, "proved, but the search was ended: the margin may be larger"


class DelayMargin(NamedTuple):
    """A proved margin in samples, the angle of the root that then is on the circle, the status."""

    samples: float
    angle: float
    status: DelayStatus


def delay_margin(
    loop: Callable[[], LoopFactors],
    sample: Callable[[], OneSample],
    delay: float,
    wall: tuple[float, float],
) -> DelayMargin:
    """By how many samples the delay of a stable wall (K, B) may at least grow.

    Args:
        loop: the loop in balls of the precision that is set; its delay is not used.
        sample: its device within a sample.
        delay: of the loop, in samples, at which the wall is stable.
        wall: stiffness and damping.
    """
    short = 5e-10  # of a margin: a box that is reported
    most_boxes = 20_000
    with working_precision(FIRST_BITS):
        search = _DelayedWall(loop(), sample(), delay, wall)
        boxes = search.boxes((0.0, nextafter(pi, 4.0)), (0.0, 1.0))  # with z = -1
        for _ in range(most_boxes):
            if not boxes:
                return DelayMargin(inf, nan, DelayStatus.UNLIMITED)
            key, theta, fraction, by_theta = heappop(boxes)
            margin = max(key - delay - 2.0 * ulp(key), 0.0)  # what was rounded
            if fraction[1] - fraction[0] < short * max(margin, short):
                return DelayMargin(margin, 0.5 * sum(theta), DelayStatus.PROVED)
            low, high = theta if by_theta else fraction
            middle = 0.5 * (low + high)
            for half in ((low, middle), (middle, high)):
                for box in search.boxes(*((half, fraction) if by_theta else (theta, half))):
                    heappush(boxes, box)
        return DelayMargin(margin, nan, DelayStatus.NOT_SHARP)


class _CentredForm(NamedTuple):
    """A function over a box: its value in the middle, slopes by theta and values over all of it."""

    middle: "acb"
    slope: "acb"
    all: "acb"

    def times(self, other: "_CentredForm") -> "_CentredForm":
        slope = self.slope * other.all + self.all * other.slope
        return _CentredForm(self.middle * other.middle, slope, self.all * other.all)

    def plus(self, other: "_CentredForm") -> "_CentredForm":
        return _CentredForm(*map(add, self, other))


class _DelayedWall:
    """The functions of one wall, over intervals of theta and of the fraction."""

    def __init__(
        self, loop: LoopFactors, sample: OneSample, delay: float, wall: tuple[float, float]
    ) -> None:
        self.sample, self.delay = sample, delay
        about_one = arb_poly([1, 1])
        self.whole = sample.whole(about_one)
        scaled = map(Factored.scaled, loop.walls, wall)
        self.above = [_about_one(part) for part in scaled if not part.is_zero]
        below = loop.denominator.times(loop.position[1]).times(loop.velocity[1])
        self.below = _about_one(below)
        self.over_theta = cache(self._over_theta)
        self.over_fraction = cache(self._over_fraction)

    def boxes(self, theta: Interval, fraction: Interval) -> list[Any]:
        """The box with its key, and which side of it to halve; none if no root can be there."""
        late, late_slope = self.over_fraction(fraction)
        place, above, below = self.over_theta(theta)
        half = _around(theta).rad(), _around(fraction).rad()
        spread = acb(arb(0, half[0])), acb(arb(0, half[1]))
        x, y = self._force(place, late).times(above), below
        by_fraction = place.all * late_slope(place.all) * above.all
        all_x = sum((x.slope * spread[0], by_fraction * spread[1]), x.middle)
        all_y = y.middle + y.slope * spread[0]
        if all_x.abs_upper() < all_y.abs_lower() or all_x.abs_lower() > all_y.abs_upper():
            return []
        least = self.delay - fraction[1]
        if all_x.contains(0) or all_y.contains(0):
            key = max(self.delay, fraction[0])
            slopes = x.slope.abs_upper() + y.slope.abs_upper(), by_fraction.abs_upper()
            return [(key, theta, fraction, bool(slopes[0] * half[0] > slopes[1] * half[1]))]
        turn = x.slope / all_x - y.slope / all_y
        moves = turn * spread[0], by_fraction / all_x * spread[1]
        log = sum(moves, (x.middle / y.middle).log())
        if not log.real.contains(0):
            return []
        n = _least_whole(log.imag + arb.pi(), theta, least)
        sizes = [float(move.abs_upper()) for move in moves]
        return [(max(n + fraction[0], self.delay), theta, fraction, sizes[0] > sizes[1])]

    def _force(self, place: "_CentredForm", late: "_Pair") -> _CentredForm:
        """N_f(z), place being z - 1."""
        middle, everywhere = late
        (w, slope, all_w), rising = place, self.whole
        by_w = everywhere(all_w) + all_w * everywhere.derivative()(all_w)
        by_w += rising.derivative()(all_w)
        value = all_w * everywhere(all_w) + rising(all_w)
        return _CentredForm(w * middle(w) + rising(w), by_w * slope, value)

    def _over_fraction(self, fraction: Interval) -> "tuple[_Pair, arb_poly]":
        """N[v(f)] in powers of z - 1, in the middle and over an interval, and its slope.

        Both are Taylor polynomials about the middle, N[.] of each coefficient: over all of a wide
        interval the exponential alone, of what its last term misses, is enclosed.
        """
        sample, around = self.sample, _around(fraction)
        middle, offset = 1 - around.mid(), arb(0, around.rad())
        step = sample.generator
        rate, column = step, sample.held(middle)
        terms = [self._moved(column)]
        for k in range(1, _TERMS):
            terms.append(self._moved(column * rate) * (arb(-1) ** k / arb.fac_ui(k)))
            rate = rate * step
        wide = sample.held(1 - around) * rate
        last = self._moved(wide) * (arb(-1) ** _TERMS / arb.fac_ui(_TERMS))
        value, slope = last, last * _TERMS
        for k in range(_TERMS - 1, -1, -1):
            value = value * offset + terms[k]
            if k:
                slope = slope * offset + terms[k] * k
        return (terms[0], value), slope

    def _moved(self, matrix: "arb_mat") -> "arb_poly":
        """N[.] of the last column of a matrix, the force's, in powers of z - 1."""
        return self.sample.moved(states_and_force(matrix)[1])(arb_poly([1, 1]))

    def _over_theta(self, theta: Interval) -> tuple[_CentredForm, _CentredForm, _CentredForm]:
        everywhere = _around(theta)
        middle = everywhere.mid()
        turn = acb(0, everywhere).exp()
        place = _CentredForm(acb(0, middle).exp() - 1, acb(0, 1) * turn, turn - 1)
        phases = middle, everywhere
        terms = (_value(term, place, phases) for term in self.above)
        above = reduce(_CentredForm.plus, terms, _CentredForm(*[acb(0)] * 3))
        return place, above, _value(self.below, place, phases)


_Pair = tuple["arb_poly", "arb_poly"]


def _around(interval: Interval) -> "arb":
    low, high = arb(interval[0]), arb(interval[1])
    return arb((low + high).mid() / 2, (high - low) / 2)


def _about_one(p: Factored) -> Factored:
    """The rest in powers of z - 1."""
    return p._replace(rest=p.rest(arb_poly([1, 1])))


def _value(p: Factored, place: _CentredForm, phases: "tuple[arb, arb]") -> _CentredForm:
    """A polynomial of which the rest is in powers of z - 1, over an interval of theta."""
    w, slope, all_w = place
    value = _CentredForm(p.rest(w), p.rest.derivative()(all_w) * slope, p.rest(all_w))
    for root, count in ((0, p.at_one), (2, p.at_minus_one)):
        for _ in range(count):
            value = value.times(_CentredForm(w + root, slope, all_w + root))
    for n in p.windows:
        value = value.times(_window(n, phases))
    if p.power:
        turns = [(acb(0, p.power) * phase).exp() for phase in phases]
        value = value.times(_CentredForm(turns[0], acb(0, p.power) * turns[1], turns[1]))
    return value


def _window(n: int, phases: "tuple[arb, arb]") -> _CentredForm:
    """1 + z + ... + z^(n-1): its second derivative by theta is at most 1 + 4 + ... + (n-1)^2."""
    z, spread = acb(0, phases[0]).exp(), phases[1].rad()
    terms = acb_poly([1] * n)
    bend = spread * sum(k**2 for k in range(n))
    middle = terms(z)
    slope = acb(0, 1) * z * terms.derivative()(z) + acb(arb(0, bend), arb(0, bend))
    return _CentredForm(middle, slope, middle + slope * acb(arb(0, spread)))


def _least_whole(angle: "arb", theta: Interval, least: float) -> float:
    """A whole n >= ``least`` and 0 below which none has (n + 1) theta = angle + 2 pi l."""
    first = max(arb(least).ceil(), arb(0)) + 1
    turn = 2 * arb.pi()
    start = ((first * arb(theta[0]) - angle.upper()) / turn).lower().ceil()
    lowest = first
    for more in range(_TURNS):
        low, high = ((end + (start + more) * turn) for end in (angle.lower(), angle.upper()))
        lowest = max(first, (low / arb(theta[1])).lower().ceil())
        if theta[0] == 0.0 or lowest <= (high / arb(theta[0])).upper():
            break
    return float(lowest.mid()) - 1.0


# --------------------------------------------------------------------------------------- the jitter
class SmallGainStatus(Status):
    """The verdict of the small-gain theorem on a wall."""

    PROVED = 1, "stable for every sequence of delays, proved"
    NOT_PROVED = 2, "the inequality does not hold: nothing is said"
    UNSTABLE = 3, "unstable at the shortest delay already"
    UNDECIDED = 4, "3,072 bits do not tell whether the inequality holds"


def small_gain(
    loop: Callable[[], LoopFactors],
    late: "Callable[[], list[arb]]",
    stiffness: float,
    damping: float,
) -> SmallGainStatus:
    """The verdict on the wall (K, B) for every sequence of delays.

    Args:
        loop: the loop of the shortest delay, in balls of the precision that is set.
        late: the coefficients of Q, as ``late_cosines`` has them.
        stiffness, damping: see ``jaxstab.conventions``.
    """

    def answer() -> SmallGainStatus | None:
        parts = loop()
        wall = parts.wall(stiffness, damping)
        p = parts.triple.at(stiffness, damping)
        is_stable = are_inside(p)
        if not is_stable:
            return None if is_stable is None else SmallGainStatus.UNSTABLE
        if wall.is_zero:
            return SmallGainStatus.PROVED
        steps = Factored(arb_poly([1]), at_one=1).times(wall)
        change, q = squared(steps), late()
        both = arb_poly([*change[:0:-1], *change]) * arb_poly([*q[:0:-1], *q])
        more = arb_poly(squared(p)) - both.right_shift(len(change) + len(q) - 2)
        holds = is_positive([more[0], *(2 * c for c in more.coeffs()[1:])])
        if holds is None:
            return None
        return SmallGainStatus.PROVED if holds else SmallGainStatus.NOT_PROVED

    return decided(answer) or SmallGainStatus.UNDECIDED


def largest_jitter(
    loop: Callable[[], LoopFactors],
    late: "Callable[[float], list[arb]]",
    wall: tuple[float, float],
    most: float,
) -> float:
    """A jitter in samples with which a wall is proved, the largest up to ``most`` but for 1e-6.

    It is 0 where none is proved. ``late`` takes the jitter. Q grows with it, so that all smaller
    ones are proved as well.
    """
    close = 1e-6  # of the jitter that is found
    halvings = 40  # of an interval of jitters

    def is_proved(jitter: float) -> bool:
        return small_gain(loop, lambda: late(jitter), *wall) == SmallGainStatus.PROVED

    low, high = 0.0, min(1.0, most)
    while is_proved(high):
        if high == most:
            return most
        low, high = high, min(2.0 * high, most)
    for _ in range(halvings):
        if high - low <= close * high:
            break
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_proved(middle) else (low, middle)
    return low


def squared(p: Factored) -> "list[arb]":
    """The coefficients of |p|^2 = s_0 + 2 s_1 cos(theta) + 2 s_2 cos(2 theta) + ..."""
    rising = p._replace(power=0).polynomial().coeffs()
    product = arb_poly(rising) * arb_poly(rising[::-1])
    return [product[len(rising) - 1 + lag] for lag in range(len(rising))]
