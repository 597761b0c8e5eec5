"""J1. Stability for every sequence of delays, as the isolation of zeros of one cosine sum.

The delay of each sample lies between L and L + J, in samples, and the newest sample that has
arrived sets the force. With p = z^lag D Dp Dv + N H of the loop of delay L, H = K Np Dv + B Nv Dp
the wall and Q the response of the device to changes of the force that come up to J late
(``late_cosines``), the small-gain theorem (Kao, Lincoln 2004; lemma J1 of docs/proofs.md) says: if
the loop of delay L is stable, and on the whole unit circle

    |p|^2 > Q |(z - 1) H|^2,

then it is stable for every sequence. On the circle |a|^2 is the cosine sum with the coefficients of
a(z) a(1/z), and so is all of the difference. It has no zero in (0, pi) and is positive at 0 and pi:
that is the inequality (``circle``). Nothing is divided, so that a free device is no special case.

C6 is asked in the same way: a wall behind a sampler, a delay n + f and a hold is passive with the
damping delta where, in the notation of ``paper.rules``,

    delta - R - f (1 - f) |H|^2 / (4 delta) > 0

for all angles. R and |H|^2 are cosine sums, so the left side is one.
"""

from collections.abc import Callable
from math import floor

from flint import arb, arb_poly

from jaxstab.conventions import Status
from jaxstab.exact.circle import is_positive
from jaxstab.exact.verdict import are_inside
from jaxstab.model.balls import BallLoop, Factored
from jaxstab.model.device.parts import decided


class SmallGainStatus(Status):
    """The verdict of the small-gain theorem on a wall."""

    PROVED = 1, "stable for every sequence of delays, proved"
    NOT_PROVED = 2, "the inequality does not hold: nothing is said"
    UNSTABLE = 3, "unstable at the shortest delay already"
    UNDECIDED = 4, "3,072 bits do not tell whether the inequality holds"


def small_gain(
    loop: Callable[[], BallLoop], late: "Callable[[], list[arb]]", stiffness: float, damping: float
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
    loop: Callable[[], BallLoop],
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


def is_passive(alpha: float, beta: float, delta: float, delay: float) -> bool:
    """True if a wall is proved passive with a damping > 0; False also where balls do not tell."""
    whole = floor(delay)

    def answer() -> bool | None:
        a, b, damping = arb(alpha), arb(beta), arb(delta)
        fraction = arb(delay) - whole
        needed = [arb(0)] * (whole + 3)  # coefficients of cos(k theta)
        needed[: whole + 2] = [a / 2, *[a] * whole, a * fraction]
        needed[whole + 1] -= b * (1 - fraction)
        needed[whole + 2] -= b * fraction
        fold = fraction * (1 - fraction) / (4 * damping)
        needed[0] += fold * ((a + b) ** 2 + b**2)
        needed[1] -= fold * 2 * b * (a + b)
        return is_positive([damping - needed[0], *(-c for c in needed[1:])])

    return bool(alpha >= 0.0 and decided(answer))
