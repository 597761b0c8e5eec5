"""Hands of a range, and masses of a general device, at which a wall could not be proved.

Boxes of the device's mass, the hand and the angle are halved until none has a root on the unit
circle (``boxes.device_boxes``). Then all of these loops have the same number of unstable roots, and
one proof of stability is enough (lemma B21 of docs/proofs.md).
"""

from math import pi

import numpy as np

from jaxstab.model import Device, LoopParameters
from jaxstab.proofs import exclusion as bisection
from jaxstab.proofs.device_boxes import AXES, BEYOND, DELAY, MASS, Boxes, DeviceBoxes, Extent, along
from jaxstab.ranges.hands import HandRange, Hands, Range

_SMALLEST = 2.0**-16  # of the ranges: boxes are not halved beyond
_MOST = 40_000  # boxes at once
_ROUNDED_UP = 1.0 + 1e-9


def unproved_hands(
    device: Device,
    loop: LoopParameters,
    hands: HandRange,
    mass: Range,
    wall: tuple[float, float],
    most: int = _MOST,
) -> Hands:
    """Return hands at which a root on the circle could not be excluded; none is a proof.

    Args:
        device: the device; its mass and its arm are not used.
        loop: its loop.
        hands: the range of hands.
        mass: the lowest and the highest mass of the device.
        wall: K in N/m and B in N s/m.
        most: boxes at once; where there are more, the proof is given up.

    Raises:
        NotImplementedError: as ``boxes.device_boxes.DeviceBoxes``.
    """
    delay = float(loop.delay_samples)

    def extent(center: Boxes, half: Boxes) -> Extent:
        own, by_own = center[MASS], half[MASS] * _ROUNDED_UP
        fixed = np.ones_like(own), np.zeros_like(own)
        values = (delay, *wall)
        numbers = (along(DELAY, value * fixed[0], fixed[1]) for value in values)
        return Extent(along(MASS, own, by_own), *numbers)

    arm = hands.stiffness[1], hands.damping[0]
    loops = DeviceBoxes(device, loop, mass, arm, extent)

    def prove(boxes: bisection.Boxes) -> bisection.Proof:
        free, shares = loops.judged(boxes.center.T, boxes.half.T)
        return bisection.Proof(free, shares.T)

    low, high = np.zeros((2, AXES))
    low[MASS], high[MASS] = mass
    low[3:6], high[3:6] = np.transpose([hands.mass, hands.stiffness, hands.damping])
    high[6] = pi * (1.0 + BEYOND)
    half = 0.5 * (high - low)
    all_hands = bisection.Boxes((low + half)[None], half[None])
    left = bisection.pave_by(all_hands, _SMALLEST * half, prove, most).boxes.center
    return np.clip(left, low, high)[:, [3, 4, 5, MASS]]
