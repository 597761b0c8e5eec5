"""A loop with any device, held by all hands of an interval of one quantity."""

from dataclasses import replace
from typing import TYPE_CHECKING

from jaxstab.loop.between import LoopsBetween
from jaxstab.model import Device, Hand
from jaxstab.ranges import HandRange
from jaxstab.ranges.hands import checked_range

if TYPE_CHECKING:
    from jaxstab.loop.loop import HapticLoop


def loops_with_hands(loop: "HapticLoop", device: Device, hands: HandRange) -> LoopsBetween:
    """Return a loop with its device and all hands of a range, in place of the hand that it has.

    A grip stays.

    Raises:
        ValueError: a range is out of order, more than one quantity varies, or the device has
            several hands.
    """
    checked_range(hands)
    varying = [f"hands.{name}" for name, (low, high) in vars(hands).items() if low < high]
    if len(varying) > 1:
        raise ValueError(
            f"{' and '.join(varying)} vary; with a device an interval of one quantity of the hand "
            "is proved: fix the others."
        )
    if len(device.hands) > 1:
        raise ValueError(
            f"the device ({device}) is held by {len(device.hands)} hands; give one that has a "
            "single hand, in place of which those of the range hold it."
        )
    grip = device.hands[0].grip if device.hands else None
    free = replace(device, hands=())
    first, last = (
        Hand.mass_spring_damper(**{name: pair[end] for name, pair in vars(hands).items()})
        for end in (0, 1)
    )
    return LoopsBetween(
        *(replace(loop, device=free.held_by(replace(hand, grip=grip))) for hand in (first, last))
    )
