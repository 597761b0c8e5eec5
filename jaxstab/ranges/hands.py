"""One wall and a range of hands: whether it is stable for all of them, and which hand is worst.

The worst hand is found among samples. Boxes of 1/m, k, b and theta prove all others
(``ranges.box``, lemma B6 of docs/proofs.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import pi, sqrt
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.arrays import take
from jaxstab.conventions import Verdict
from jaxstab.model import Device, LoopParameters, by_name
from jaxstab.model.filters import known_filters
from jaxstab.model.linear_loop import filtered_loop
from jaxstab.numbers import checked_number
from jaxstab.point import spectral_radius, verdict
from jaxstab.point.radius import have_roots_inside
from jaxstab.proofs.exclusion import Loops, exclude
from jaxstab.proofs.plant import quick_plant
from jaxstab.ranges.box import ParameterBox, Proof, excluded, worst_of_range
from jaxstab.rounding import MIDDLE

Loop = TypeVar("Loop", bound=LoopParameters)
Range = tuple[float, float]
Hands = Float64[np.ndarray, "hand 4"]  # mass, stiffness and damping; the device's mass
Column = Float64[np.ndarray, " hand"]
Integers = Int64[np.ndarray, " row"]
Values = Float64[np.ndarray, " row"]
Walls = Float64[np.ndarray, "wall 2"]  # K and B

_SAMPLES = 9  # hands along each range
_ASIDE = 1e-7  # of a radius
_CERTAIN = 1.0 + 1e-6  # a radius that is proved to be above 1
_AT_ONCE = 32  # walls
_FEW_BOXES, _MOST_BOXES = 4096, 120_000  # of a wall, among others and alone
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


class HeldLoop(NamedTuple):
    """A loop, the hands that may hold its device, and the masses that the device may have."""

    loop: Any  # a LoopParameters of one mass
    hands: HandRange
    masses: Range


class Plants(NamedTuple):
    """Device and hands: whether they are outermost, the units of K and B, gamma and delta."""

    hand: Hands
    is_outermost: Bool[np.ndarray, " hand"]
    alpha: Column  # of a wall of 1 N/m
    beta: Column  # of a wall of 1 N s/m
    gamma: Column
    delta: Column


class Rows(NamedTuple):
    """Walls with hands: the numbers of wall and plant, and the gains."""

    wall: Integers
    plant: Integers
    stiffness: Values
    damping: Values


class WorstHand(NamedTuple):
    """The verdict on a wall for all hands of a range, with the worst hand that was sampled.

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


def worst_hand(
    loop: Loop, hands: HandRange, stiffness: float, damping: float, mass: Range | None = None
) -> WorstHand:
    """Return whether a wall is stable for every hand of a range: ``HapticLoop.worst_hand``."""
    wall = (checked_number("stiffness", stiffness), checked_number("damping", damping))
    (worst,) = worst_hands(loop, hands, [wall], mass)
    return worst


def worst_hands(
    loop: Loop,
    hands: HandRange,
    walls: Sequence[tuple[float, float]],
    mass: Range | None = None,
) -> list[WorstHand]:
    """Return for each wall (K, B) whether it is stable for every hand, and the worst hand."""
    checked_range(hands, mass)
    given, gains = HeldLoop(loop, hands, masses_of(loop, mass)), np.array(walls, np.float64)
    groups = np.array_split(gains, -(-len(gains) // _AT_ONCE))
    return [worst for group in groups for worst in _worst_at_once(given, group)]


def _worst_at_once(given: HeldLoop, walls: Walls) -> list[WorstHand]:
    def unproved(numbers: list[int]) -> dict[int, Hands]:
        # Nearly all walls need few boxes; those that need more are proved singly.
        hard = [numbers[n] for n in _unproved_hands(given, walls[numbers], _FEW_BOXES)]
        alone = {wall: _unproved_hands(given, walls[[wall]], _MOST_BOXES) for wall in hard}
        return {wall: hands[0] for wall, hands in alone.items() if hands}

    def judge(wall: int, hands: Hands) -> WorstHand:
        return _worst_of(given.loop, walls[[wall]], hands)[0]

    hands = spread_bodies(given.hands, given.masses, _SAMPLES)
    return worst_of_range(_worst_of(given.loop, walls, hands), unproved, judge, _MOST)


def _worst_of(loop: LoopParameters, walls: Walls, hands: Hands) -> list[WorstHand]:
    """For each wall the verdict on the worst of some hands."""
    plants = _plants_of(loop, hands)
    wall, plant = np.indices((len(walls), len(hands))).reshape(2, -1)
    rows = Rows(wall, plant, *walls[wall].T)
    rows = take(rows, _may_be_worst(loop, plants, rows))
    points = _points(loop, plants, rows)
    radii = np.asarray(spectral_radius(**points, **loop.filters).value)
    codes = np.asarray(verdict(**points, **loop.filters))
    ends = np.searchsorted(rows.wall, np.arange(len(walls) + 1))
    answers = []
    for of_wall in map(slice, ends[:-1], ends[1:]):
        unstable = codes[of_wall] == Verdict.UNSTABLE
        index = np.argmax(np.where(unstable | ~unstable.any(), radii[of_wall], -1.0))
        worst = of_wall.start + int(index)
        hand = plants.hand[rows.plant[worst]]
        code, radius = Verdict(int(codes[worst])), float(radii[worst])
        answers.append(WorstHand(code, held(loop, hand), radius))
    return answers


def _plants_of(loop: LoopParameters, hands: Hands) -> Plants:
    mass, spring, damper, own = hands.T
    mass = own + mass
    return Plants(
        hands,
        _are_outermost(hands),
        loop.sample_time**2 / mass,
        loop.sample_time / mass,
        spring * loop.sample_time**2 / mass,
        (loop.device_damping + damper) * loop.sample_time / mass,
    )


def _are_outermost(hands: Hands) -> Bool[np.ndarray, " hand"]:
    """Which hands are farthest towards a corner of their range."""
    low, span = hands.min(axis=0), np.ptp(hands, axis=0)
    shares = (hands - low) / np.where(span > 0.0, span, 1.0)
    towards = np.array(list(product((-1.0, 1.0), repeat=hands.shape[1])))
    outermost = np.full(len(hands), len(hands) <= len(towards))
    outermost[np.argmax(shares @ towards.T, axis=0)] = True
    return outermost


def _may_be_worst(loop: LoopParameters, plants: Plants, rows: Rows) -> Bool[np.ndarray, " row"]:
    """Which hands may have the largest radius, or may be proved unstable, of each wall."""
    # The radii of the outermost hands are computed. A recursion in float64 leaves out the hands
    # whose poles are all in a smaller circle.
    chosen = plants.is_outermost[rows.plant] | (loop.delay_samples > _LONG)
    if chosen.all():
        return chosen
    outer, inner = take(rows, chosen), take(rows, ~chosen)
    radii = np.asarray(spectral_radius(**_points(loop, plants, outer), **loop.filters).value)
    radius = np.zeros(rows.wall[-1] + 1)
    np.maximum.at(radius, outer.wall, radii)
    # Next to the circle any of them may be the only one that is proved unstable.
    radius = np.where(radius > _CERTAIN, radius, np.minimum(radius, 1.0)) * (1.0 - _ASIDE)
    points = _points(loop, plants, inner)
    base, stiffness, damping = _rough_polynomials(loop, plants)[..., inner.plant]
    coefficients = base + points["alpha"] * stiffness + points["beta"] * damping
    chosen[~chosen] = ~have_roots_inside(coefficients, radius[inner.wall])
    return chosen


def _rough_polynomials(
    loop: LoopParameters, plants: Plants
) -> Float64[np.ndarray, "3 coefficient plant"]:
    """p(z) without a wall, and the terms that stiffness and damping add, in plain float64."""
    whole, fraction = divmod(loop.delay_samples, 1.0)
    filters = known_filters(**loop.filters)
    if filters is not None:
        linear = filtered_loop(plants.gamma, plants.delta, int(whole), fraction, filters)
        rounded = [[c.rounded() for c in polynomial] for polynomial in linear[:3]]
        return np.array([[np.broadcast_to(c, len(plants.gamma)) for c in p] for p in rounded])
    plant = quick_plant(plants.gamma, plants.delta, np.float64(loop.delay_samples))
    parts = np.zeros((3, int(whole) + 5, len(plants.gamma)))
    parts[0, 0], parts[0, 1], parts[0, 2] = 1.0, plant.d1, plant.d0
    for k, numerator in enumerate((plant.n2, plant.n1, plant.n0)):
        start = int(whole) + 1 + k
        parts[1, start] += numerator
        parts[2, start] += numerator
        parts[2, start + 1] -= numerator
    return parts


def _points(loop: LoopParameters, plants: Plants, rows: Rows) -> dict[str, Any]:
    """Alpha, beta, gamma, delta and the delay of walls with hands, by name."""
    alpha = rows.stiffness * plants.alpha[rows.plant]
    beta = rows.damping * plants.beta[rows.plant]
    gamma, delta = plants.gamma[rows.plant], plants.delta[rows.plant]
    return by_name(alpha, beta, gamma, delta, float(loop.delay_samples))


def _unproved_hands(given: HeldLoop, walls: Walls, most: int) -> dict[int, Hands]:
    """Hands at which a root on the circle could not be excluded, by the index of the wall.

    The axes of the boxes are shares of the intervals of 1/m, of k and b of the hand, and of theta
    from 0 to pi; ``most`` boxes of each wall are open at once.
    """
    if not len(walls):
        return {}
    loop, hands, masses = given
    period, own = loop.sample_time, loop.device_damping
    lightest, heaviest = map(sum, zip(masses, hands.mass, strict=True))  # with the hand
    ends = (1.0 / heaviest, 1.0 / lightest), hands.stiffness, hands.damping
    low, high = np.array(ends).T[:, :, None]
    span = high - low
    varies = np.where(span[:, 0] > 0.0, 0.5, 0.0)

    def prove(boxes: ParameterBox) -> Proof:
        middle = low + span * boxes.center.T[:3]
        light, spring, damper = middle
        by_light, by_spring, by_damper = span * boxes.half.T[:3] + MIDDLE * middle
        stiffness, damping = walls[boxes.index].T
        theta, by_theta = boxes["theta"]
        per_mass = np.stack(
            [stiffness * period**2, damping * period, spring * period**2, (own + damper) * period]
        )
        alpha, beta, gamma, delta = per_mass * light
        # Radii cover the product of two intervals.
        names = "alpha", "beta", "gamma", "delta"
        by_mass = zip(names, np.abs(per_mass) * by_light, strict=True)
        moves = {("light", name): far for name, far in by_mass}
        moves["spring", "gamma"] = (light + by_light) * period**2 * by_spring
        moves["damper", "delta"] = (light + by_light) * period * by_damper
        moves["theta", "theta"] = pi * by_theta
        delay = np.full_like(theta, loop.delay_samples)
        center = Loops(alpha, beta, gamma, delta, delay, pi * theta)
        return excluded(test, center, boxes.moved(moves))

    test = partial(exclude, filters=known_filters(**loop.filters))
    light, spring, damper = ((0.5, half) for half in varies)
    boxes = ParameterBox.from_axes(
        np.arange(len(walls)), light=light, spring=spring, damper=damper, theta=(0.5, 0.5)
    )
    remaining = boxes.paved(prove, _SMALLEST, most_each=most).boxes
    light, spring, damper = low + span * remaining.center.T[:3]
    share = np.clip((1.0 / light - lightest) / max(heaviest - lightest, 1e-300), 0.0, 1.0)
    of_hand, of_device = (np.interp(share, (0.0, 1.0), pair) for pair in (hands.mass, masses))
    rows = np.column_stack([of_hand, spring, damper, of_device])
    return {wall: rows[remaining.index == wall] for wall in np.unique(remaining.index).tolist()}


def spread_hands(hands: HandRange, count: int) -> Float64[np.ndarray, "hand 3"]:
    """Hands spread over the range, with stiffnesses spaced evenly in frequency."""
    ends = (hands.mass, tuple(sqrt(end) for end in hands.stiffness), hands.damping)
    axes = [np.linspace(low, high, count if low < high else 1) for low, high in ends]
    axes[1] = axes[1] ** 2
    axes[1][[0, -1]] = hands.stiffness
    return np.array(list(product(*axes)))


def spread_bodies(hands: HandRange, mass: Range, count: int) -> Hands:
    """Hands spread over the range, and masses of the device that grow with theirs."""
    varies = hands.mass[0] < hands.mass[1] or mass[0] < mass[1]
    both = [np.linspace(*ends, count if varies else 1) for ends in (hands.mass, mass)]
    others = spread_hands(replace(hands, mass=(0.0, 0.0)), count)[:, 1:].tolist()
    rows = product(zip(*both, strict=True), others)
    return np.array([(moved, *other, own) for (moved, own), other in rows])


def held(loop: Loop, hand: Float64[np.ndarray, " 4"]) -> Loop:
    """The loop with a hand of (mass, stiffness, damping), and a mass of the device."""
    names = ("hand_mass", "hand_stiffness", "hand_damping", "device_mass")
    return replace(loop, **dict(zip(names, hand.tolist(), strict=True)))


def masses_of(loop: LoopParameters, mass: Range | None) -> Range:
    """The masses that a device of one mass may have: those given, or that of the loop."""
    return mass or (float(loop.device_mass), float(loop.device_mass))


def checked_range(hands: object, mass: Range | None = None, device: Device | None = None) -> None:
    """Validate hands, and the masses or the device that they hold.

    TypeError unless a HandRange; ValueError unless ends are in order and not negative, and the
    device, if there is a hand, has one handle.
    """
    if mass is not None and not 0.0 < mass[0] <= mass[1] < np.inf:
        raise ValueError(
            f"mass is {mass}; give the lowest mass of the device, > 0, and the highest one."
        )
    if not isinstance(hands, HandRange):
        raise TypeError(f"hands is {hands!r}; give a jaxstab.HandRange, as HandRange(mass=(0, 1)).")
    for name, (low, high) in vars(hands).items():
        if not 0.0 <= low <= high < np.inf:
            raise ValueError(
                f"hands.{name} is ({low}, {high}); give the lowest, >= 0, and the highest value."
            )
        if device is not None and high > 0.0:
            device.require_one_handle()
