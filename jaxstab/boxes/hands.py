"""All hands of a range, all masses of a device and all its delays: which are not proved stable.

The axes of the boxes are what varies of the device's mass, of the delay, and of the hand's mass,
stiffness and damping (lemma B20 of docs/proofs.md).
"""

from dataclasses import dataclass
from itertools import product
from math import sqrt
from typing import Any

import numpy as np
from jaxtyping import Float64

from jaxstab.boxes.enclosures import HAND, THETA, ParameterBoxes
from jaxstab.boxes.plant import Arms, DeviceBoxes, Extent
from jaxstab.boxes.search import paved
from jaxstab.conventions import Range
from jaxstab.model import Device, LoopParameters
from jaxstab.numbers import two_ends
from jaxstab.shown import shortened

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
