"""All hands of a scene, and all masses of its device: the worst for a wall, the stiffest wall.

Hands are tried: what one of them contradicts is proved. For all others a proof is looked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, isnan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.batches import by_kind
from jaxstab.conventions import Verdict
from jaxstab.loop import Gains, HapticLoop
from jaxstab.loop.common_walls import common_walls
from jaxstab.model.device.parts import MassSpringDamper, Modes
from jaxstab.ranges.hands import HeldWall, worst_hands
from jaxstab.scene.answers import (
    Answer,
    Damping,
    LargestStiffness,
    Mass,
    Stiffness,
    StiffnessBound,
)
from jaxstab.scene.loops import (
    hands_of,
    is_one_mass,
    loop_of,
    masses_of,
    range_of_hands,
    reachable,
    wall_region,
)
from jaxstab.scene.scene import Scene

_PROVED = "proved for every hand"
_TRIED = "no hand that was tried is unstable, but not all others are proved"
_ROWS = 400  # of B, in which walls are stable for all hands

WallOfScene = tuple[Scene, Gains]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class HeldBy(Answer):
    """A hand, and the mass of the device if that varies."""

    mass: Mass
    stiffness: Stiffness
    damping: Damping
    device_mass: Mass | None = None


@dataclass(frozen=True)
class AllHands(Answer):
    """A wall for all hands of a range, nearly the stiffest, and a proved bound if there is one."""

    largest_stiffness: LargestStiffness
    at_damping: Damping
    certainty: str
    none_is_stiffer_than: StiffnessBound | None
    worst_hand: HeldBy

    @property
    def all_stable(self) -> bool:
        """Whether the wall is proved stable for every hand."""
        return self.certainty.startswith(_PROVED) and isfinite(self.largest_stiffness)


class WorstHeld(NamedTuple):
    """The verdict on a wall for all hands, the worst of them, and the loop that it holds.

    ``hand`` is None where neither a hand nor the mass varies; ``tried`` says what is known where
    the verdict is UNDECIDED.
    """

    verdict: Verdict
    loop: HapticLoop
    hand: HeldBy | None
    tried: str | None


def worst_held(walls: Sequence[WallOfScene]) -> list[WorstHeld]:
    """Return what is known of walls for all hands of their scenes' ranges, and the worst hands."""
    return by_kind(walls, [is_one_mass(scene) for scene, _ in walls], _worst_of_a_kind)


def _worst_of_a_kind(walls: Sequence[WallOfScene]) -> list[WorstHeld]:
    """Return the same for scenes that are all of one mass, or none of them."""
    held = [
        HeldWall(loop_of(scene), range_of_hands(scene), *gains, masses_of(scene))
        for scene, gains in walls
    ]
    if is_one_mass(walls[0][0]):
        found = worst_hands(held)
    else:
        found = [loop.worst_hand(*wall, mass=mass) for loop, *wall, mass in held]
    return [
        WorstHeld(
            worst.verdict,
            worst.loop,
            held_by(worst.loop, scene),
            _TRIED if worst.verdict == Verdict.UNDECIDED else None,
        )
        for worst, (scene, _) in zip(found, walls, strict=True)
    ]


def limit_for_all(scene: Scene, safety: float) -> AllHands | None:
    """Return what all hands of a scene allow; None where neither the hand nor the mass varies."""
    hands = hands_of(scene)
    if hands is None:
        return None
    loop, mass = loop_of(scene), masses_of(scene)
    found = loop.robust_limit(hands, mass=mass)
    is_proved, stiffness = found.is_proved, safety * found.stiffness
    if safety < 1.0 and not isnan(stiffness):
        worst = loop.worst_hand(hands, stiffness, found.damping, mass=mass)
        is_proved = worst.verdict == Verdict.STABLE
    proved = _PROVED + ("" if mass is None else f" and {scene.units.moved}")
    tried = "no wall was found" if isnan(stiffness) else "not proved"
    return AllHands(
        largest_stiffness=stiffness,
        at_damping=found.damping,
        certainty=proved if is_proved else tried,
        none_is_stiffer_than=found.limit if is_one_mass(scene) else None,
        worst_hand=held_by(found.loop, scene),
    )


def at_lowest(scene: Scene, rest: str = ", where nothing else is said") -> str | None:
    """Return for which hand answers hold that name none, and the rest; None where none varies."""
    if hands_of(scene) is None:
        return None
    mass = f", the device at its lowest {scene.units.moved}" if scene.device.varies else ""
    return f"at its lowest values{mass}{rest}"


def held_by(loop: HapticLoop, scene: Scene) -> HeldBy:
    """Return the hand of a loop of a scene, and the device's mass if that varies."""
    hand, own = (loop.hand_mass, loop.hand_stiffness, loop.hand_damping), loop.device_mass
    if loop.device is not None:
        arm, body = loop.device.hands[0].dynamics, loop.device.mechanism
        assert isinstance(arm, MassSpringDamper)  # as scenes make hands
        assert isinstance(body, MassSpringDamper | Modes)  # and devices
        hand, own = (arm.mass, arm.stiffness, arm.damping), body.mass
    return HeldBy(*hand, own if scene.device.varies else None)


def common_outline(loops: list[HapticLoop]) -> Floats:
    """Return walls (K, B) that are stable for each of some loops: ``common_walls``, not proved."""
    regions = [reachable(wall_region(loop)) for loop in loops]
    if any(region.is_empty for region in regions):
        return np.zeros((0, 2))
    return common_walls(regions, _ROWS)
