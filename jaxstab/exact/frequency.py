"""E5. The open loop on the circle: gain, phase and delay margins, and peaks of the closed loop.

The loop is opened at its force: L = N/D, p = D + N, S = D/p and T = N/p, D and N without the roots
at 0, 1 and -1 that they share. On the circle (docs/proofs.md has the reasons):

- Gain margins: D + t N is a line of walls, and the interval of t that holds 1 is known (E3).
- Phase margin: |L| = 1 at the zeros of |N|^2 - |D|^2, a cosine sum. There L is -1 after a lag of
  pi + arg L, arg L in (-pi, pi], or after a lead of what is left of 2 pi. The least of all counts.
- Delay margin of a loop that is known at its samples alone: the least of these lags over their
  angles while |N| < |D| at z = -1, else one sample at most.
- Peaks of |X/p|, X = D, N or D - N: where z d/dz log(X/p) is real, at angles that E3 has, or at
  z = 1 or -1. The disk margin is 2/max |S - T|.

Every number is a ball that is as narrow as a float64, or more bits are asked for.
"""

from collections.abc import Callable
from functools import partial
from math import inf, nan
from typing import NamedTuple

import numpy as np
from flint import arb, arb_poly, ctx
from jaxtyping import Complex128, Float64

from jaxstab.exact.circle import PATIENT, zeros
from jaxstab.exact.line import OnCircle, real_quotient_angles, stable_pencil
from jaxstab.exact.roots import Number, is_sharp
from jaxstab.exact.small_gain import squared
from jaxstab.model.balls import Factored
from jaxstab.model.device.parts import FIRST_BITS, decided, working_precision


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
    complementary: Reading = Reading()
    disk: Reading = Reading()


_OF_NOTHING = Readings(
    *[Reading(-inf, 0.0), *[Reading(inf, 0.0)] * 3],
    *[Reading(1.0, 0.0), Reading(0.0, 0.0), Reading(2.0, 0.0)],
)


def readings(parts: Callable[[], tuple[Factored, Factored]], *, in_full: bool = True) -> Readings:
    """The margins and peaks of a loop that is stable, from D and N in balls.

    Not ``in_full`` they are phase, delay and the peak of S, which take a third of the time.
    """

    def opened() -> tuple[Factored, Factored]:
        below, above = parts()
        shared = [*map(min, below[1:4], above[1:4])]
        return below.divided(*shared), above.divided(*shared)

    with working_precision(FIRST_BITS):
        if parts()[1].is_zero:
            return _OF_NOTHING
    ends = (in_full and stable_pencil(opened).holding(1.0)) or [Reading()] * 2
    phase, delay = decided(lambda: _crossovers(*opened())) or [Reading()] * 2
    kinds = ((1, 0), (0, 1), (1, -1)) if in_full else ((1, 0),)
    peaks = [decided(partial(_peak, opened, *kind)) or Reading() for kind in kinds]
    least, largest = (Reading(*end[:3]) for end in ends)
    return Readings(least, largest, phase, delay, *peaks)


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
    found = zeros([sums[0], *(2 * c for c in sums.coeffs()[1:])], is_last_try=ctx.prec >= PATIENT)
    if found is None:
        return None
    phases, delays = list[_Place](), list[_Place]()
    circle, pi = (OnCircle.of(above), OnCircle.of(below)), arb.pi()
    for angle, slope in found:
        upper, lower = (side.at(angle) for side in circle)
        if lower.contains(0):
            return None
        value = upper / lower
        if value.imag.contains(0) and not value.real > 0:
            return None
        lag = pi + value.arg()
        phases.append(_Place(lag.min(2 * pi - lag), angle, slope != 0))
        delays.append(_Place(lag / angle if angle > 0 else lag / angle.upper(), angle, slope != 0))
    if not abs(above.at_end(-1)) < abs(below.at_end(-1)):
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
    z, both, (_, a, b) = arb_poly([0, 1]), x.rest * p.rest, x[1:4]
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
