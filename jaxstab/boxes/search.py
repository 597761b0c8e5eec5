"""Proof and search of claims about every loop of a range, over boxes of its parameters.

A range is a box of loops. Hands and delays of a range, robust regions and guards differ in their
axes (``enclosures``); the plant (``plant``) and the three arguments below are the same for all.

1. *No root on the circle.* Boxes are halved, along the axes that move the characteristic function
   most, until each of them is proved free of roots on the unit circle (``paved``; lemma B20 of
   docs/proofs.md).
2. *One proof of stability is enough.* The roots move continuously with the loop, and a range is
   connected: if no loop of it has a root on the circle, all have the same number of roots outside
   of it, and the verdict on a single one holds for all (B20). For a closed polygon it is enough
   that no wall on its edges has such a root: no curve of walls with a root on the circle can lie
   inside without crossing the edges (B11).
3. *Sampled loops bound the answer, the proof confirms it.* The stiffest wall, or the polygon of
   walls, that all sampled loops allow is too large, so it is pulled in a little and proved for the
   whole range. Where the proof fails, loops from there join the sample; where that adds none, it is
   pulled in further (``search``).

A sampled loop that is proved unstable refutes a wall. A box that can be neither halved nor proved
free shows nothing: the wall is undecided. The walls that the samples suggest, the order in which
boxes are halved and the work after which a proof is given up decide how much is proved, but never
whether a proof is valid.

Of all hands of a range, all masses of a device and all its delays (``unproved_members``) the axes
of the boxes are what varies of the device's mass, of the delay, and of the hand's mass, stiffness
and damping (lemma B20 of docs/proofs.md).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, nan, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.boxes.enclosures import HAND, THETA, ParameterBoxes, joined
from jaxstab.boxes.plant import BEYOND, Arms, DeviceBoxes, Extent
from jaxstab.conventions import Range, Status
from jaxstab.model import Device, LoopParameters
from jaxstab.numbers import two_ends
from jaxstab.shown import exact_text, number_text, shortened

Points = Float64[np.ndarray, "point 2"]

Judge = Callable[[ParameterBoxes], tuple[Bool[np.ndarray, " box"], Float64[np.ndarray, "axis box"]]]
"""Gives True for boxes that are free of roots, and what halving along each axis would help."""

# Next to theta = 0 little of the plant is far from 0: boxes begin smaller there.
_CELLS = pi * (1.0 + BEYOND) * np.array([0, 1, 2, 3, 4, 6, 8, 12, 16, 20, 24, 32, 48, 64]) / 64.0
_TOO = 0.2  # of what the best axis helps: then a second one is halved in the same round
PULLS = 0.01, 0.02, 0.04, 0.08
"""Shares of the stiffness by which the wall that is proved lies below the limit."""


class Paving(NamedTuple):
    """The boxes that paving could not prove: too small to be halved, or of proofs given up.

    ``judged`` is how many boxes of each index were judged.
    """

    boxes: ParameterBoxes
    judged: Int64[np.ndarray, " index"]


def paved(
    judged_free: Judge,
    count: int,
    smallest: float,
    *,
    most: int | float = inf,
    effort: int | float = inf,
    **ends: tuple[Any, Any],
) -> Paving:
    """Halve boxes along the axes that matter most, until each is proved free of roots.

    There are ``count`` indices, for example of walls; each begins with boxes between the ``ends``
    along its axes, and of the angle from 0 to pi. Axes are not halved at or below ``smallest`` of
    their first half-width. A proof is given up where more than ``most`` boxes are open at once, and
    that of an index where ``effort`` were judged in all; this makes the result for an index
    independent of the others.
    """
    index, cell = (row.ravel() for row in np.indices((count, len(_CELLS) - 1)))
    own: dict[str, Any] = {
        name: tuple(end[index] if np.ndim(end) else end for end in pair)
        for name, pair in ends.items()
    }
    boxes = ParameterBoxes.between(index, **own, theta=(_CELLS[cell], _CELLS[cell + 1]))
    least, judged = smallest * boxes.half.max(axis=1, keepdims=True), np.zeros(count, np.int64)
    unproved = [boxes.select(slice(0))]
    while boxes.index.size:
        open_boxes = np.bincount(boxes.index, minlength=count)
        is_over = judged + open_boxes > effort
        given_up = is_over[boxes.index] | (boxes.index.size > most)
        unproved.append(boxes.select(given_up))
        boxes = boxes.select(~given_up)
        judged += np.bincount(boxes.index, minlength=count)
        free, share = judged_free(boxes)
        share = np.where(boxes.half > least, share, -1.0)
        is_small = share.max(axis=0) < 0.0
        unproved.append(boxes.select(~free & is_small))
        going = ~free & ~is_small
        boxes = _halved(boxes.select(going), share[:, going])
    return Paving(joined(unproved), judged)


def _halved(boxes: ParameterBoxes, share: Float64[np.ndarray, "axis box"]) -> ParameterBoxes:
    """The halves of boxes along the axis that helps most, and along a second one like it."""
    order = np.argsort(share, axis=0)
    rows = np.arange(boxes.index.size)
    first, second = order[-1], order[max(-2, -len(order))]
    too = (share[second, rows] > _TOO * share[first, rows]) & (first != second)
    halves = boxes.halved(first)
    again = np.tile(too, 2)
    return joined([halves.select(~again), halves.select(again).halved(np.tile(second[too], 2))])


# Sampled loops bound the answer, the proof confirms it: limits and regions.


class RobustStatus(Status):
    """The status of a robust region.

    Example:
        >>> jaxstab.results.RobustStatus(1).words
        'every wall of the outline is proved stable for every hand'
    """

    NOT_COMPUTED = 0, "not computed"
    PROVED = 1, "every wall of the outline is proved stable for every hand"
    EMPTY = 2, "no wall was found that is stable for all of the sampled hands"
    UNPROVED = 3, "stable for the sampled hands, but not proved between them"


class RobustLimit(NamedTuple):
    """A wall that is proved for all hands of a range, in SI units; NaN where none was proved.

    Attributes:
        stiffness: K of a wall 1 % below the stiffest wall of the search, or farther below where
            the proof fails closer to it.
        damping: B of that wall.
        is_proved: True if there is that wall, proved stable for every hand.
        limit: the largest stiffness with B >= 0 that was found in the exact stable regions of all
            tried hands: computed, not proved. With an estimator or a filter it is that of the
            components with small gains.
        loop: the loop with the hand that sets the limit.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> limit = loop.robust_limit(jaxstab.HandRange(mass=(0.0, 1.0)))
        >>> limit.is_proved, limit.stiffness < limit.limit
        (True, True)
    """

    stiffness: float
    damping: float
    is_proved: bool
    limit: float
    loop: Any  # of the class of the given one

    def __repr__(self) -> str:
        wall = f"K = {exact_text(self.stiffness)} N/m at B = {exact_text(self.damping)} N s/m"
        words = f"{wall}, proved for all hands" if self.is_proved else "no wall is proved"
        limit = number_text(self.limit, 5, unit="N/m")
        return f"RobustLimit: {words}\n  limit of hands tried  {limit}, {self.loop!r}"


class Guess(NamedTuple):
    """Walls that all sampled loops of a range allow, pulled in a little: one, or a polygon.

    No row if nothing is allowed. ``limit`` is the largest stiffness that they allow, ``loop`` the
    sampled loop that allows least there.
    """

    walls: Points
    limit: float = nan
    loop: Any = None


NOTHING = Guess(np.zeros((0, 2)))


def search(
    guess: Callable[[float], Guess | None],
    unproved: Callable[[Points], Sequence[Any] | np.ndarray],
    add: Callable[[Any], bool],
    pulls: Sequence[float],
) -> tuple[Guess | None, bool]:
    """Walls that sampled loops allow, and whether they are proved for the whole range.

    ``guess`` returns the walls that the sampled loops allow, pulled in by a share; None if unknown.
    ``unproved`` returns loops at which a wall, or a polygon with all that is inside, is not proved;
    none is a proof. ``add`` adds such loops to the sample and says whether one is new; where none
    is, or after so many that each only just refuted a wall, the next one of the ``pulls`` is tried.
    """
    attempts = 24  # proofs of a search
    for pull in pulls:
        for _ in range(attempts // len(pulls)):
            current = guess(pull)
            if current is None or not len(current.walls):
                return current, False
            failed = unproved(current.walls)
            if not len(failed):
                return current, True
            if not add(failed):
                break
    return current, False


# ------------------------------------------------------------------------- hands, masses and delays
Members = Float64[np.ndarray, "member 5"]
"""Mass, stiffness and damping of hands; the device's mass in kg, and the delay in samples."""

Walls = Float64[np.ndarray, "wall 2"]

_SMALLEST = 2.0**-16  # of the ranges: boxes are not halved beyond
_MOST = 40_000  # boxes at once


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


def checked_range(hands: object, mass: Range | None = None, device: Device | None = None) -> None:
    """Validate hands, and the masses or the device that they hold.

    TypeError unless a HandRange of pairs; ValueError unless ends are in order and not negative, and
    it is known where a hand holds the device.
    """
    if mass is not None:
        low, high = two_ends("mass", mass)
        if not 0.0 < low <= high:
            raise ValueError(
                f"mass is {mass}; give the lowest mass of the device, > 0, and the highest one."
            )
    if not isinstance(hands, HandRange):
        raise TypeError(
            f"hands is {shortened(hands)}; give a jaxstab.HandRange, as HandRange(mass=(0, 1))."
        )
    for name, ends in vars(hands).items():
        low, high = two_ends(f"hands.{name}", ends)
        if not 0.0 <= low <= high:
            raise ValueError(
                f"hands.{name} is ({low}, {high}); give the lowest, >= 0, and the highest value."
            )
        if device is not None and high > 0.0:
            device.require_handle()


def spread_hands(hands: HandRange, count: int) -> Float64[np.ndarray, "hand 3"]:
    """Hands spread over the range, with stiffnesses spaced evenly in frequency."""
    ends = (hands.mass, tuple(sqrt(end) for end in hands.stiffness), hands.damping)
    axes = [np.linspace(low, high, count if low < high else 1) for low, high in ends]
    axes[1] = axes[1] ** 2
    axes[1][[0, -1]] = hands.stiffness
    return np.array(list(product(*axes)))


def arms_over(boxes: ParameterBoxes, hands: HandRange, period: float) -> Arms:
    """The arms of all hands over boxes, with a sampling period in s as the unit of time."""
    units = 1.0, period**2, period
    parts = zip(HAND, vars(hands).values(), units, strict=True)
    return Arms(*(boxes.quantity(name, ends[0], unit) for name, ends, unit in parts))


def unproved_members(
    device: Device,
    loop: LoopParameters,
    hands: HandRange,
    mass: Range,
    delay: Range,
    walls: Walls,
    jitter: float = 0.0,
    until: Walls | None = None,
) -> Members:
    """Members of the ranges at which a root on the circle is not excluded; none is a proof.

    The delay in samples is constant within its range; with ``jitter`` it may exceed that by so many
    samples, in each sample anew. Walls are (K, B); with ``until`` all between two are meant.
    NotImplementedError: as ``DeviceBoxes``.
    """
    period = float(loop.sample_time)
    units = np.array([period**2, period])
    way_of = None if until is None else (until - walls) * units

    def extent(boxes: ParameterBoxes) -> Extent:
        stiffness, damping = map(boxes.constant, (walls * units)[boxes.index].T)
        if way_of is not None:
            share, ways = boxes.along("edge"), map(boxes.constant, way_of[boxes.index].T)
            stiffness, damping = stiffness + share * next(ways), damping + share * next(ways)
        return Extent(
            boxes.quantity("mass", mass[0]),
            boxes.quantity("delay", delay[0]),
            arms_over(boxes, hands, period),
            stiffness,
            damping,
            boxes.along(THETA),
        )

    ends: dict[str, Any] = dict(zip(HAND, vars(hands).values(), strict=True))
    ends |= {"mass": mass, "delay": delay}
    edge: dict[str, Any] = {} if until is None else {"edge": (0.0, 1.0)}
    arm = hands.stiffness[1], hands.damping[0]
    boxes = DeviceBoxes(device, loop, mass, arm, extent, jitter=jitter)
    left = paved(boxes.judged, len(walls), _SMALLEST, most=_MOST, **ends, **edge).boxes
    return np.stack([left.middles(name, *pair) for name, pair in ends.items()], axis=1)
