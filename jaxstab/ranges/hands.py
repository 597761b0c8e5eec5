"""One wall and a range of hands: whether it is stable for all of them, and which hand is worst.

The worst hand is found among samples. The proof for all other hands halves boxes of mass,
stiffness, damping and theta until each of them is proved free of roots on the unit circle
(``boxes.exclusion``): then the number of unstable roots is the same for all hands, and one proof of
stability is enough (lemma B6 of docs/proofs.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import pi, sqrt
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.boxes.bisection import Boxes, Extent, pave
from jaxstab.boxes.circle import quick_plant
from jaxstab.boxes.exclusion import Loops, exclude
from jaxstab.conventions import UNDECIDED, Verdict
from jaxstab.model import LoopParameters, by_name
from jaxstab.model.filters import known_filters
from jaxstab.model.linear_loop import filtered_loop
from jaxstab.numbers import checked_number
from jaxstab.point import spectral_radius, verdict
from jaxstab.point.radius.inside import are_inside

Loop = TypeVar("Loop", bound=LoopParameters)
Range = tuple[float, float]
Hands = Float64[np.ndarray, "hands 3"]
Column = Float64[np.ndarray, " hands"]
Integers = Int64[np.ndarray, " number"]
Values = Float64[np.ndarray, " number"]
Walls = Float64[np.ndarray, "wall 2"]

_SAMPLES = 9  # hands along each range
_ASIDE = 1e-7  # of a radius
_CERTAIN = 1.0 + 1e-6  # a radius that is proved to be above 1
_MOST_BOXES = 60_000  # of a wall, at once
_LONG = 64  # samples of delay, beyond which all radii are computed
_MOST = 1024  # hands judged at once
_SMALLEST = 2.0**-20  # of the ranges: boxes are not halved beyond


@dataclass(frozen=True, kw_only=True)
class HandRange:
    """A range of hands: lowest and highest mass in kg, stiffness in N/m and damping in N s/m.

    Example:
        >>> jaxstab.HandRange(mass=(0.0, 1.0), stiffness=(0.0, 700.0), damping=(0.0, 12.0))
        HandRange(mass=(0.0, 1.0), stiffness=(0.0, 700.0), damping=(0.0, 12.0))
    """

    mass: Range = (0.0, 0.0)
    stiffness: Range = (0.0, 0.0)
    damping: Range = (0.0, 0.0)


class Plants(NamedTuple):
    """Device and hand: their mass, and the dimensionless stiffness and damping."""

    mass: Column
    gamma: Column
    delta: Column


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
    (worst,) = worst_hands(loop, hands, [wall])
    return worst


def worst_hands(
    loop: Loop, hands: HandRange, walls: Sequence[tuple[float, float]]
) -> list[WorstHand]:
    """Return for each wall (K, B) whether it is stable for every hand of a range."""
    checked_range(hands)
    gains = np.array(walls, np.float64).reshape(-1, 2)
    answers = _worst_of(loop, spread_hands(hands, _SAMPLES), gains)
    hopeful = [number for number, one in enumerate(answers) if one.verdict == Verdict.STABLE]
    for number, left in _unproved(loop, hands, gains[hopeful]).items():
        wall = hopeful[number]
        count = min(len(left), _MOST)
        some = left[np.arange(count) * len(left) // count]  # of too many, some
        (among,) = _worst_of(loop, some, gains[wall : wall + 1])
        is_known = among.verdict == Verdict.UNSTABLE
        answers[wall] = among if is_known else among._replace(verdict=UNDECIDED)
    return answers


def _worst_of(loop: Loop, hands: Hands, walls: Walls) -> list[WorstHand]:
    """Return for each wall the verdict on the worst of some hands."""
    plants = _plants(loop, hands)
    may_be_worst = _may_be_worst(loop, hands, plants, walls)
    wall, hand = np.nonzero(may_be_worst)
    radii = np.full(may_be_worst.shape, -1.0)
    points = _points(loop, plants, walls, (wall, hand))
    radii[wall, hand] = spectral_radius(**by_name(*points), **loop.filters).value
    codes = np.full(radii.shape, Verdict.NOT_COMPUTED)
    codes[wall, hand] = verdict(**by_name(*points), **loop.filters)
    answers = []
    for number in range(len(walls)):
        unstable = codes[number] == Verdict.UNSTABLE
        worst = int(np.argmax(np.where(unstable | ~unstable.any(), radii[number], -1.0)))
        code, radius = Verdict(int(codes[number, worst])), float(radii[number, worst])
        answers.append(WorstHand(code, held(loop, hands[worst]), radius))
    return answers


def _may_be_worst(
    loop: LoopParameters, hands: Hands, plants: Plants, walls: Walls
) -> Bool[np.ndarray, "wall hand"]:
    """Say which hands may have the largest radius, or may be proved unstable, of each wall.

    The outermost ones have some radius. A recursion in float64 leaves out the hands whose poles are
    all in a smaller circle.
    """
    count = len(plants.gamma)
    if count <= 2 ** hands.shape[1] or loop.delay_samples > _LONG:
        return np.ones((len(walls), count), bool)
    grid = np.meshgrid(np.arange(len(walls)), _outermost(hands), indexing="ij")
    wall, hand = (numbers.ravel() for numbers in grid)
    points = _points(loop, plants, walls, (wall, hand))
    some = np.asarray(spectral_radius(**by_name(*points), **loop.filters).value)
    radius = some.reshape(len(walls), -1).max(axis=1)
    # Next to the circle all may be the only one that is proved unstable.
    radius = np.where(radius > _CERTAIN, radius, np.minimum(radius, 1.0)) * (1.0 - _ASIDE)
    alpha = walls[:, :1] * (loop.sample_time**2 / plants.mass)
    beta = walls[:, 1:] * (loop.sample_time / plants.mass)
    base, stiffness, damping = _rough_polynomials(loop, plants)
    coefficients = base[:, None] + alpha * stiffness[:, None] + beta * damping[:, None]
    is_inside = are_inside(coefficients, radius[:, None])
    is_inside[wall, hand] = False
    return ~is_inside


def _rough_polynomials(
    loop: LoopParameters, plants: Plants
) -> Float64[np.ndarray, "3 coefficient hand"]:
    """Return what p(z) is without a wall, and what stiffness and damping add, in plain float64."""
    whole, fraction = divmod(loop.delay_samples, 1.0)
    filters = known_filters(**loop.filters)
    if filters is not None:
        linear = filtered_loop(plants.gamma, plants.delta, int(whole), fraction, filters)
        rounded = [[one.rounded() for one in part] for part in linear[:3]]
        return np.array([[np.broadcast_to(c, len(plants.mass)) for c in part] for part in rounded])
    plant = quick_plant(plants.gamma, plants.delta, np.float64(loop.delay_samples))
    parts = np.zeros((3, int(whole) + 5, len(plants.mass)))
    parts[0, 0], parts[0, 1], parts[0, 2] = 1.0, plant.d1, plant.d0
    for number, numerator in enumerate((plant.n2, plant.n1, plant.n0)):
        first = int(whole) + 1 + number
        parts[1, first] += numerator
        parts[2, first] += numerator
        parts[2, first + 1] -= numerator
    return parts


def _outermost(hands: Hands) -> Integers:
    """Return the numbers of the hands that are farthest towards each corner of their range."""
    low, span = hands.min(axis=0), np.ptp(hands, axis=0)
    places = (hands - low) / np.where(span > 0.0, span, 1.0)
    towards = np.array(list(product((-1.0, 1.0), repeat=hands.shape[1])))
    return np.unique(np.argmax(places @ towards.T, axis=0))


def _unproved(loop: LoopParameters, hands: HandRange, walls: Walls) -> dict[int, Hands]:
    """Return hands at which a root on the circle could not be excluded, by the wall.

    The axes of the boxes: the wall, which is not halved, 1/m, k, b of the hand, theta.
    """
    lightness = tuple(1.0 / (loop.device_mass + mass) for mass in reversed(hands.mass))
    ranges = np.array([(0.0, 0.0), lightness, hands.stiffness, hands.damping, (0.0, pi)])
    period, own = loop.sample_time, loop.device_damping

    def extent(boxes: Boxes) -> Extent:
        wall, light, spring, damper, theta = boxes.center.T
        _, by_light, by_spring, by_damper, turn = boxes.half.T
        stiffness, damping = walls[wall.astype(np.int64)].T
        per_mass = np.stack(
            [stiffness * period**2, damping * period, spring * period**2, (own + damper) * period]
        )
        alpha, beta, gamma, delta = per_mass * light
        delay = np.full_like(light, loop.delay_samples)
        center = Loops(alpha, beta, gamma, delta, delay, theta)
        # Exact centers; radii cover the product of two intervals.
        by_axis = np.zeros((5, 6, light.size))
        by_axis[1, :4] = np.abs(per_mass) * by_light
        by_axis[2, 2] = (light + by_light) * period**2 * by_spring
        by_axis[3, 3] = (light + by_light) * period * by_damper
        by_axis[4, 5] = turn
        return Extent.of(center, by_axis)

    boxes = Boxes(
        np.tile(ranges.mean(axis=1), (len(walls), 1)),
        np.tile(0.5 * np.ptp(ranges, axis=1), (len(walls), 1)),
    )
    boxes.center[:, 0] = np.arange(len(walls))
    prove = partial(exclude, filters=known_filters(**loop.filters))
    smallest = _SMALLEST * np.ptp(ranges, axis=1)
    most = _MOST_BOXES * max(len(walls), 1)
    wall, light, *others = pave(boxes, smallest, extent, most, prove).boxes.center[:, :4].T
    mass = np.clip(1.0 / light - loop.device_mass, *hands.mass)
    left = np.column_stack([mass, *others])
    return {int(number): left[wall == number] for number in np.unique(wall)}


def spread_hands(hands: HandRange, count: int) -> Hands:
    """Return hands spread over the range, with stiffnesses spaced evenly in frequency."""
    ends = (hands.mass, tuple(sqrt(end) for end in hands.stiffness), hands.damping)
    axes = [np.linspace(low, high, count if low < high else 1) for low, high in ends]
    axes[1] = axes[1] ** 2
    axes[1][[0, -1]] = hands.stiffness
    return np.array(list(product(*axes)))


def _plants(loop: LoopParameters, hands: Hands) -> Plants:
    mass, spring, damper = hands.T
    mass = loop.device_mass + mass
    gamma = spring * loop.sample_time**2 / mass
    delta = (loop.device_damping + damper) * loop.sample_time / mass
    return Plants(mass, gamma, delta)


def _points(
    loop: LoopParameters, plants: Plants, walls: Walls, numbers: tuple[Integers, Integers]
) -> tuple[Values, Values, Values, Values, float]:
    """Return alpha, beta, gamma, delta, delay of walls with hands, each given by their numbers."""
    wall, hand = numbers
    mass = plants.mass[hand]
    alpha = walls[wall, 0] * (loop.sample_time**2 / mass)
    beta = walls[wall, 1] * (loop.sample_time / mass)
    return alpha, beta, plants.gamma[hand], plants.delta[hand], float(loop.delay_samples)


def held(loop: Loop, hand: Float64[np.ndarray, " 3"]) -> Loop:
    """Return the loop with a hand of (mass, stiffness, damping)."""
    mass, stiffness, damping = (float(value) for value in hand)
    return replace(loop, hand_mass=mass, hand_stiffness=stiffness, hand_damping=damping)


def checked_range(hands: HandRange) -> None:
    """Refuse a range whose ends are out of order or negative."""
    for name, (low, high) in vars(hands).items():
        if not 0.0 <= low <= high < np.inf:
            raise ValueError(
                f"hands.{name} is ({low}, {high}); give the lowest, >= 0, and the highest value."
            )
