"""One wall and a range of hands: whether it is stable for all of them, and which hand is worst.

The worst hand is found among samples. The proof for all other hands halves boxes of mass,
stiffness, damping and theta until each of them is proved free of roots on the unit circle
(``boxes.exclusion``): then the number of unstable roots is the same for all hands, and one proof of
stability is enough (lemma B6 of docs/proofs.md).
"""

from dataclasses import replace
from functools import partial
from itertools import product
from math import pi, sqrt
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float64

from jaxstab.boxes.bisection import Boxes, Extent, pave
from jaxstab.boxes.exclusion import Loops, exclude
from jaxstab.conventions import UNDECIDED, Verdict
from jaxstab.model import LoopParameters
from jaxstab.model.filters import known_filters
from jaxstab.numbers import checked_number
from jaxstab.point import spectral_radius, verdict

Loop = TypeVar("Loop", bound=LoopParameters)
Range = tuple[float, float]
Hands = Float64[np.ndarray, "hands 3"]
Column = Float64[np.ndarray, " hands"]

_SAMPLES = 9  # hands along each range
_MOST = 1024  # hands judged at once
_SMALLEST = 2.0**-20  # of the ranges: boxes are not halved beyond


class HandRange(NamedTuple):
    """A range of hands: lowest and highest mass in kg, stiffness in N/m and damping in N s/m.

    Example:
        >>> jaxstab.HandRange(mass=(0.0, 1.0), stiffness=(0.0, 700.0), damping=(0.0, 12.0))
        HandRange(mass=(0.0, 1.0), stiffness=(0.0, 700.0), damping=(0.0, 12.0))
    """

    mass: Range = (0.0, 0.0)
    stiffness: Range = (0.0, 0.0)
    damping: Range = (0.0, 0.0)


class WorstHand(NamedTuple):
    """What is known about a wall for all hands of a range, with the worst hand that was sampled.

    A ``verdict`` of STABLE is proved for every hand. UNSTABLE is proved for ``loop``, the loop with
    the worst hand: the sampled hand with the largest spectral ``radius``.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> worst = loop.worst_hand(jaxstab.HandRange(mass=(0.0, 1.0)), 1000.0, 10.0)
        >>> worst.verdict.name, worst.loop.hand_mass
        ('STABLE', 1.0)
    """

    verdict: Verdict
    loop: Any  # of the class of the given one
    radius: float


def worst_hand(loop: Loop, hands: HandRange, stiffness: float, damping: float) -> WorstHand:
    """Return whether a wall is stable for every hand of a range: ``HapticLoop.worst_hand``."""
    wall = (checked_number("stiffness", stiffness), checked_number("damping", damping))
    checked_range(hands)
    worst = _worst_of(loop, spread_hands(hands, _SAMPLES), *wall)
    if worst.verdict != Verdict.STABLE:
        return worst
    left = _unproved(loop, hands, *wall)
    if not len(left):
        return worst
    among = _worst_of(loop, left, *wall)
    return among if among.verdict == Verdict.UNSTABLE else among._replace(verdict=UNDECIDED)


def _worst_of(loop: Loop, hands: Hands, stiffness: float, damping: float) -> WorstHand:
    """Return the verdict on the worst of some hands; of too many, of some of them."""
    count = min(len(hands), _MOST)
    some = hands[np.arange(count) * len(hands) // count]
    scene = (*_dimensionless(loop, some, stiffness, damping), loop.delay_samples)
    radii = np.asarray(spectral_radius(*scene, **loop.filters).value)
    codes = np.asarray(verdict(*scene, **loop.filters))
    unstable = codes == Verdict.UNSTABLE
    worst = int(np.argmax(np.where(unstable | ~unstable.any(), radii, -1.0)))
    return WorstHand(Verdict(int(codes[worst])), held(loop, some[worst]), float(radii[worst]))


def _unproved(loop: LoopParameters, hands: HandRange, stiffness: float, damping: float) -> Hands:
    """Return hands at which a root on the circle could not be excluded; none is a proof.

    The axes of the boxes: 1/m, k, b of the hand, theta.
    """
    lightness = tuple(1.0 / (loop.device_mass + mass) for mass in reversed(hands.mass))
    ranges = np.array([lightness, hands.stiffness, hands.damping, (0.0, pi)])
    period, own = loop.sample_time, loop.device_damping

    def extent(boxes: Boxes) -> Extent:
        light, spring, damper, theta = boxes.center.T
        by_light, by_spring, by_damper, turn = boxes.half.T
        per_mass = np.stack(
            np.broadcast_arrays(
                stiffness * period**2, damping * period, spring * period**2, (own + damper) * period
            )
        )
        alpha, beta, gamma, delta = per_mass * light
        delay = np.full_like(light, loop.delay_samples)
        center = Loops(alpha, beta, gamma, delta, delay, theta)
        # Exact centers; radii cover the product of two intervals.
        by_axis = np.zeros((4, 6, light.size))
        by_axis[0, :4] = np.abs(per_mass) * by_light
        by_axis[1, 2] = (light + by_light) * period**2 * by_spring
        by_axis[2, 3] = (light + by_light) * period * by_damper
        by_axis[3, 5] = turn
        return Extent.of(center, by_axis)

    boxes = Boxes(ranges.mean(axis=1)[None], 0.5 * np.ptp(ranges, axis=1)[None])
    prove = partial(exclude, filters=known_filters(**loop.filters))
    smallest = _SMALLEST * np.ptp(ranges, axis=1)
    left = pave(boxes, smallest, extent, prove=prove).boxes.center[:, :3]
    mass = np.clip(1.0 / left[:, 0] - loop.device_mass, *hands.mass)
    return np.column_stack([mass, left[:, 1:]])


def spread_hands(hands: HandRange, count: int) -> Hands:
    """Return hands spread over the range, with stiffnesses spaced evenly in frequency."""
    ends = (hands.mass, tuple(sqrt(end) for end in hands.stiffness), hands.damping)
    axes = [np.linspace(low, high, count if low < high else 1) for low, high in ends]
    axes[1] = axes[1] ** 2
    axes[1][[0, -1]] = hands.stiffness
    return np.array(list(product(*axes)))


def _dimensionless(
    loop: LoopParameters, hands: Hands, stiffness: float, damping: float
) -> tuple[Column, Column, Column, Column]:
    mass, spring, damper = hands.T
    per_force = loop.sample_time**2 / (loop.device_mass + mass)
    per_speed = loop.sample_time / (loop.device_mass + mass)
    friction = loop.device_damping + damper
    return stiffness * per_force, damping * per_speed, spring * per_force, friction * per_speed


def held(loop: Loop, hand: Float64[np.ndarray, " 3"]) -> Loop:
    """Return the loop with a hand of (mass, stiffness, damping)."""
    mass, stiffness, damping = (float(value) for value in hand)
    return replace(loop, hand_mass=mass, hand_stiffness=stiffness, hand_damping=damping)


def checked_range(hands: HandRange) -> None:
    """Refuse a range whose ends are out of order or negative."""
    for name, (low, high) in hands._asdict().items():
        if not 0.0 <= low <= high < np.inf:
            raise ValueError(
                f"hands.{name} is ({low}, {high}); give the lowest, >= 0, and the highest value."
            )
