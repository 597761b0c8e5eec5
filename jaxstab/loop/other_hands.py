"""A loop with any device, held by all hands of a range, its device of any mass of another one.

Some hands are tried, and all others are proved in boxes (``ranges.device_hands``). Devices of which
boxes know nothing are proved where one number varies, as the loops between two.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from jaxstab.conventions import UNDECIDED, Verdict
from jaxstab.loop.between import LoopsBetween
from jaxstab.loop.common_walls import setter_of, stiffest_wall
from jaxstab.loop.region import TOLERANCE, WallRegion, wall_region
from jaxstab.model import Device, Hand
from jaxstab.model.device.parts import MassSpringDamper, Modes
from jaxstab.ranges import HandRange, RobustLimit, WorstHand
from jaxstab.ranges.device_hands import unproved_hands
from jaxstab.ranges.hands import Hands, Range, checked_range, spread_hands
from jaxstab.region import RegionStatus

if TYPE_CHECKING:
    from jaxstab.loop.loop import HapticLoop

_TRIED = 3  # values of each number that varies
_MOST_TRIED = 64  # hands of those that could not be proved
_PULLS = (0.01, 0.02, 0.04, 0.08)  # of the limit: the wall that is proved lies so far below
_ATTEMPTS = 12


@dataclass(frozen=True)
class LoopsWithHands:
    """A loop with its device and all hands of a range, in place of the hand that it has.

    A grip stays.

    Args:
        loop: the loop, with its device.
        device: the device.
        hands: the range of hands.
        mass: the lowest and the highest mass of the device in kg; None for its own.

    Raises:
        TypeError: ``hands`` is no range of hands.
        ValueError: a range is out of order, the device has several hands, or no mass that could
            vary.
    """

    loop: "HapticLoop"
    device: Device
    hands: HandRange
    mass: Range | None = None

    def __post_init__(self) -> None:
        checked_range(self.hands, self.mass)
        if len(self.device.hands) > 1:
            raise ValueError(
                f"the device ({self.device}) is held by {len(self.device.hands)} hands; give one "
                "that has a single hand, in place of which those of the range hold it."
            )
        if self.mass is not None and self._own_mass is None:
            raise ValueError(
                f"mass is {self.mass}, but the device ({self.device}) has none that could vary; "
                "leave it out."
            )

    def worst(self, stiffness: float, damping: float) -> WorstHand:
        """Return whether a wall is stable for all of them, and the worst that was found."""
        wall = stiffness, damping
        worst = _worst_of([self._held(row) for row in self._spread(_TRIED)], wall)
        if worst.verdict != Verdict.STABLE:
            return worst
        left = self._unproved(wall)
        if left is None:
            if self._between is None:
                return worst._replace(verdict=UNDECIDED)
            code, loop, _, radius = self._between.worst_loop(*wall)
            return WorstHand(code, loop, radius)
        if not len(left):
            return worst  # one verdict holds for all
        count = min(len(left), _MOST_TRIED)
        some = left[np.arange(count) * len(left) // count]
        found = _worst_of([self._held(row) for row in some], wall)
        is_known = found.verdict == Verdict.UNSTABLE
        return found if is_known else worst._replace(verdict=UNDECIDED)

    def robust_limit(self) -> RobustLimit:
        """Return the stiffest wall that all of them allow: ``HapticLoop.robust_limit``."""
        loops = [self._held(row) for row in self._spread(2)]
        found, pulls = RobustLimit(nan, nan, False, nan, loops[0]), list(_PULLS)
        regions: dict[HapticLoop, WallRegion] = {}
        for _ in range(_ATTEMPTS):
            regions |= {loop: _reachable(loop) for loop in loops if loop not in regions}
            known = {
                loop: region
                for loop, region in regions.items()
                if region.status != RegionStatus.UNRESOLVED  # the proof covers this loop, too
            }
            is_empty = not known or any(region.is_empty for region in known.values())
            top = None if is_empty else stiffest_wall([*known.values()])
            if top is None:
                break
            stiffness = top.stiffness - pulls[0] * abs(top.stiffness)
            setter = setter_of(known, top.damping)
            found = RobustLimit(stiffness, top.damping, False, top.stiffness, setter)
            worst = self.worst(stiffness, top.damping)
            if worst.verdict == Verdict.STABLE:
                return found._replace(is_proved=True)
            if worst.loop in regions:
                pulls.pop(0)
                if not pulls:
                    break
            loops.append(worst.loop)
        return found

    @cached_property
    def _between(self) -> LoopsBetween | None:
        """The loops between two that these are; None where more than one number varies."""
        ends = [self.hands.mass, self.hands.stiffness, self.hands.damping, self._masses]
        if sum(low < high for low, high in ends) > 1:
            return None
        return LoopsBetween(*(self._held(row) for row in np.transpose(ends)))

    @property
    def _own_mass(self) -> float | None:
        body = self.device.mechanism
        return body.mass if isinstance(body, MassSpringDamper | Modes) else None

    @property
    def _masses(self) -> Range:
        own = self._own_mass or nan
        return self.mass or (own, own)

    def _spread(self, count: int) -> Hands:
        low, high = self._masses
        masses = np.linspace(low, high, count if low < high else 1).tolist()
        hands = spread_hands(self.hands, count).tolist()
        return np.array([(*hand, mass) for hand, mass in product(hands, masses)])

    def _held(self, row: np.ndarray) -> "HapticLoop":
        """Return the loop with a hand, and with a mass of the device."""
        mass, stiffness, damping, own = row.tolist()
        hand = Hand.mass_spring_damper(mass, damping=damping, stiffness=stiffness)
        grip = self.device.hands[0].grip if self.device.hands else None
        body = self.device.mechanism
        moved = body if self.mass is None else replace(body, mass=own)
        free = replace(self.device, mechanism=moved, hands=())
        return replace(self.loop, device=free.held_by(replace(hand, grip=grip)))

    def _unproved(self, wall: tuple[float, float]) -> Hands | None:
        """Return hands that are not proved; None where boxes know nothing of such a device."""
        device = self._held(self._spread(1)[0]).device
        assert device is not None
        try:
            return unproved_hands(device, self.loop, self.hands, self._masses, wall)
        except NotImplementedError:
            return None


def _worst_of(loops: "list[HapticLoop]", wall: tuple[float, float]) -> WorstHand:
    """Return the verdict on a wall in the loop of the largest radius; of unstable ones, if any."""
    codes = np.array([loop.verdict(*wall) for loop in loops])
    poles = [np.abs(np.asarray(loop.poles(*wall))).max() for loop in loops]
    unstable = codes == Verdict.UNSTABLE
    number = int(np.argmax(np.where(unstable | ~unstable.any(), poles, -1.0)))
    loop = loops[number]
    radius = float(loop.spectral_radius(*wall).value)
    return WorstHand(Verdict(int(codes[number])), loop, radius)


def _reachable(loop: "HapticLoop") -> WallRegion:
    """Return the walls that small gains lead to, if there are any."""
    region = wall_region(loop, TOLERANCE)
    if region.status == RegionStatus.UNRESOLVED or region.is_empty:
        return region
    return region.main or region.components[0]
