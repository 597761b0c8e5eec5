"""B5. The largest extra delay of a stable wall, up to the first one with a root on the circle.

For a delay of n + f samples, n whole and 0 <= f < 1, a root lies at z = e^(i theta) if

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
"""

from collections.abc import Callable
from functools import cache, reduce
from heapq import heappop, heappush
from math import inf, nan, nextafter, pi, ulp
from operator import add
from typing import Any, NamedTuple

from flint import acb, acb_poly, arb, arb_mat, arb_poly

from jaxstab.conventions import Status
from jaxstab.model.balls import BallLoop, Factored
from jaxstab.model.device.parts import FIRST_BITS, working_precision
from jaxstab.model.device.sampling import OneSample, states_and_force

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
    loop: Callable[[], BallLoop],
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
        search = _Search(loop(), sample(), delay, wall)
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


class _Form(NamedTuple):
    """A function over a box: its value in the middle, slopes by theta and values over all of it."""

    middle: "acb"
    slope: "acb"
    all: "acb"

    def times(self, other: "_Form") -> "_Form":
        slope = self.slope * other.all + self.all * other.slope
        return _Form(self.middle * other.middle, slope, self.all * other.all)

    def plus(self, other: "_Form") -> "_Form":
        return _Form(*map(add, self, other))


class _Search:
    """The functions of one wall, over intervals of theta and of the fraction."""

    def __init__(
        self, loop: BallLoop, sample: OneSample, delay: float, wall: tuple[float, float]
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

    def _force(self, place: "_Form", late: "_Pair") -> _Form:
        """N_f(z), place being z - 1."""
        middle, everywhere = late
        (w, slope, all_w), rising = place, self.whole
        by_w = everywhere(all_w) + all_w * everywhere.derivative()(all_w)
        by_w += rising.derivative()(all_w)
        value = all_w * everywhere(all_w) + rising(all_w)
        return _Form(w * middle(w) + rising(w), by_w * slope, value)

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

    def _over_theta(self, theta: Interval) -> tuple[_Form, _Form, _Form]:
        everywhere = _around(theta)
        middle = everywhere.mid()
        turn = acb(0, everywhere).exp()
        place = _Form(acb(0, middle).exp() - 1, acb(0, 1) * turn, turn - 1)
        phases = middle, everywhere
        terms = (_value(term, place, phases) for term in self.above)
        above = reduce(_Form.plus, terms, _Form(*[acb(0)] * 3))
        return place, above, _value(self.below, place, phases)


_Pair = tuple["arb_poly", "arb_poly"]


def _around(interval: Interval) -> "arb":
    low, high = arb(interval[0]), arb(interval[1])
    return arb((low + high).mid() / 2, (high - low) / 2)


def _about_one(p: Factored) -> Factored:
    """The rest in powers of z - 1."""
    return p._replace(rest=p.rest(arb_poly([1, 1])))


def _value(p: Factored, place: _Form, phases: "tuple[arb, arb]") -> _Form:
    """A polynomial of which the rest is in powers of z - 1, over an interval of theta."""
    w, slope, all_w = place
    value = _Form(p.rest(w), p.rest.derivative()(all_w) * slope, p.rest(all_w))
    for root, count in ((0, p.at_one), (2, p.at_minus_one)):
        for _ in range(count):
            value = value.times(_Form(w + root, slope, all_w + root))
    for n in p.windows:
        value = value.times(_window(n, phases))
    if p.power:
        turns = [(acb(0, p.power) * phase).exp() for phase in phases]
        value = value.times(_Form(turns[0], acb(0, p.power) * turns[1], turns[1]))
    return value


def _window(n: int, phases: "tuple[arb, arb]") -> _Form:
    """1 + z + ... + z^(n-1): its second derivative by theta is at most 1 + 4 + ... + (n-1)^2."""
    z, spread = acb(0, phases[0]).exp(), phases[1].rad()
    terms = acb_poly([1] * n)
    bend = spread * sum(k**2 for k in range(n))
    middle = terms(z)
    slope = acb(0, 1) * z * terms.derivative()(z) + acb(arb(0, bend), arb(0, bend))
    return _Form(middle, slope, middle + slope * acb(arb(0, spread)))


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
