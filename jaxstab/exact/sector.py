"""C7. Forces that only push, clip or harden: rest from every start, proved by one cosine sum.

The commanded force is -phi(y), y of the linear wall and 0 <= (phi(a) - phi(b))/(a - b) <= 1: the
function is the same at all times and need not be odd, as max(0, y), a motor that clips, a dead
zone. p1 is p(z) without that force, p2 the one of the linear wall, phi(y) = y; L = (p2 - p1)/p1 is
the loop. If p1 has all roots inside the circle and, for a multiplier of Zames and Falb,

    M(z) = 1 - sum of h_k z^-k,    h_k >= 0 for some k != 0,    sum of h_k < 1,
    Re(M p2 conj p1) > 0    on the whole circle,

then every such phi, each constant push and each start lead to one place of rest, as fast as a power
(lemma C7; Zames and Falb 1968; O'Shea 1967; Willems and Brockett 1968). The left side is a cosine
sum, which is positive (``circle``) or not proved to be. The condition does not say the contrary:
what is not proved may rest.

It is affine in p2: one multiplier for two walls and the same p1 is one for all between them. The
shares of a wall, phi(s y), 0 <= s <= 1, are of the class anyhow.

The weights are suggested by a linear program in float64: the largest least value of
Re(M p2/p1)/|p2/p1| over some angles, to which those are added where the rest of them is lower.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from flint import arb, arb_poly
from jaxtyping import Float64

from jaxstab.exact.circle import is_positive
from jaxstab.exact.floats import FloatValues
from jaxstab.exact.roots import TripleAt, are_inside
from jaxstab.model.balls import Factored
from jaxstab.model.device.parts import FIRST_BITS, decided, working_precision

Taps = tuple[tuple[int, float], ...]
"""The k and h_k of a multiplier."""

_ORDERS = 1, 8  # the largest |k|: most walls need k = 1 and -1 alone


class OneSidedWall(NamedTuple):
    """Two gains without the force, and those of the linear wall."""

    triple: TripleAt
    without: tuple[float, float]
    linear: tuple[float, float]

    def sides(self) -> tuple[Factored, Factored]:
        """p1 and p2 in balls of the precision that is set."""
        triple = self.triple()
        return triple.at(*self.without), triple.at(*self.linear)


def multiplier(walls: Sequence[OneSidedWall]) -> Taps | None:
    """One multiplier that proves all of some walls; None if none is found."""
    for order in _ORDERS:
        taps = _suggested(walls, [k for k in range(-order, order + 1) if k])
        if taps is not None and all(proves(taps, wall) for wall in walls):
            return taps
    return None


def proves(taps: Taps, wall: OneSidedWall) -> bool:
    """True if a multiplier proves a wall."""
    if not all(k and h >= 0.0 for k, h in taps):
        return False

    def answer() -> bool | None:
        if not sum((arb(h) for _, h in taps), arb(0)) < 1:
            return False
        p1, p2 = wall.sides()
        if p1.degree != p2.degree or not (p1.leading - p2.leading).contains(0):
            return False  # the force depends on itself without a sample between
        is_stable = are_inside(p1)
        return is_positive(_cosines(taps, p1, p2)) if is_stable else is_stable

    return bool(decided(answer))


def _cosines(taps: Taps, p1: Factored, p2: Factored) -> list[arb]:
    """Re(M p2 conj p1) as a cosine sum."""
    below = p1.polynomial()
    product = p2.polynomial() * arb_poly(below.coeffs()[::-1])
    middle, reach = below.degree(), max((abs(k) for k, _ in taps), default=0)
    total = [arb(0)] * (middle + reach + 1)
    for place, g in enumerate(product.coeffs()):
        total[abs(place - middle)] += g
        for k, h in taps:
            total[abs(place - middle - k)] -= g * arb(h)
    return total


# What follows suggests.


def _suggested(walls: Sequence[OneSidedWall], lags: list[int]) -> Taps | None:
    from scipy.optimize import linprog  # it takes longer to import than a proof

    most, rounds, first, more = 0.9999999, 8, 400, 100  # of the sum; of exchanges; of angles
    rows = [_phases(wall) for wall in walls]
    phases = np.concatenate([phase for _, phase in rows])
    turns = np.exp(-1j * np.concatenate([angles for angles, _ in rows])[:, None] * np.array(lags))
    real, by_lag = phases.real, (turns * phases[:, None]).real
    spread = np.linspace(0, len(real) - 1, first).astype(int)
    chosen = np.unique(np.r_[spread, np.argmin(real)])
    sum_of_weights = np.r_[np.ones(len(lags)), 0.0]
    weights, least = np.zeros(len(lags)), 0.0
    for _ in range(rounds):
        found = linprog(
            np.r_[np.zeros(len(lags)), -1.0],
            A_ub=np.vstack([np.c_[by_lag[chosen], np.ones(len(chosen))], sum_of_weights]),
            b_ub=np.r_[real[chosen], most],
            bounds=[(0.0, None)] * len(lags) + [(None, 1.0)],
        )
        if found.status or found.x[-1] <= 0.0:
            return None
        weights, least = found.x[:-1], found.x[-1]
        values = real - by_lag @ weights
        missed = np.flatnonzero(values < 0.5 * least)
        if not missed.size:
            break
        chosen = np.union1d(chosen, missed[np.argsort(values[missed])[:more]])
    return tuple((k, float(h)) for k, h in zip(lags, weights, strict=True) if h > 1e-9)


def _phases(wall: OneSidedWall) -> tuple[Float64[np.ndarray, " angle"], np.ndarray]:
    """Angles in (0, pi], some of them next to roots, and p2/p1 there over its modulus."""
    with working_precision(FIRST_BITS):
        parts, sides = ([FloatValues(p) for p in own] for own in (wall.triple(), wall.sides()))
    found = [np.geomspace(1e-7, 0.1, 3000), np.linspace(0.1, np.pi, 6000)]
    found += [own for side in sides for own in side.angles()]
    angles = np.unique(np.concatenate(found))
    angles = angles[(angles > 0.0) & (angles <= np.pi)]
    base, by_first, by_second = (part(angles) for part in parts)  # of few powers, each
    below, above = (
        base + first * by_first + second * by_second
        for first, second in (wall.without, wall.linear)
    )
    ratio = above / below
    return angles, ratio / np.abs(ratio)
