"""All hands of a scene: the worst one for a wall, and the stiffest wall for all of them.

Where device and hand are one mass this is proved for every hand of the range, and for any other
device where one quantity of the hand varies. Of several hands are tried: what one of them
contradicts is proved, and all else is said to be tried.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.batches import by_kind
from jaxstab.conventions import Verdict
from jaxstab.loop import Gains, HapticLoop
from jaxstab.loop.common_walls import common_walls
from jaxstab.model.device.parts import MassSpringDamper
from jaxstab.ranges import WorstHand
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
    OneHand,
    corner_loops,
    hands_among,
    hands_of,
    is_one_mass,
    loop_of,
    proves_hands,
    range_of_hands,
    reachable,
    wall_region,
)
from jaxstab.scene.scene import Scene

LOWEST_HAND = "at its lowest values, where nothing else is said"
_TRIED = 3  # hands along each quantity
_ROWS = 400  # of B, in which walls are stable for all hands
_PULL = 0.01  # of the limit: the wall that is tried lies so far below, then twice as far
_ATTEMPTS = 4

WallOfScene = tuple[Scene, Gains]
Floats = NDArray[np.float64]
Integers = NDArray[np.int8]


@dataclass(frozen=True)
class HeldBy(Answer):
    """A hand."""

    mass: Mass
    stiffness: Stiffness
    damping: Damping


@dataclass(frozen=True)
class AllHands(Answer):
    """A wall for all hands of a range, nearly the stiffest, and a proved bound if there is one."""

    largest_stiffness: LargestStiffness
    at_damping: Damping
    certainty: str
    none_is_stiffer_than: StiffnessBound | None
    worst_hand: HeldBy


class WorstHeld(NamedTuple):
    """The verdict on a wall for all hands, the worst of them, and the loop that it holds.

    ``hand`` is None where no hand varies; ``tried`` says how many hands were tried where nothing is
    proved of those between.
    """

    verdict: Verdict
    loop: HapticLoop
    hand: HeldBy | None
    tried: str | None


def worst_held(walls: Sequence[WallOfScene]) -> list[WorstHeld]:
    """Return what is known of walls for all hands of their scenes' ranges, and the worst hands."""
    kinds = [None if is_one_mass(scene) else id(scene) for scene, _ in walls]
    return by_kind(walls, kinds, _worst_of_a_kind)


def _worst_of_a_kind(walls: Sequence[WallOfScene]) -> list[WorstHeld]:
    """Return the same for scenes of one mass, or for one scene."""
    scene, _ = walls[0]
    if is_one_mass(scene):
        held = [HeldWall(loop_of(one), range_of_hands(one), *gains) for one, gains in walls]
        return [_held_at_worst(worst) for worst in worst_hands(held)]
    gains = [gains for _, gains in walls]
    if not proves_hands(scene):
        return _tried_hands(scene, gains)
    loop, hands = loop_of(scene), range_of_hands(scene)
    return [
        _tried_hands(scene, [wall])[0]
        if found.verdict == Verdict.UNDECIDED
        else _held_at_worst(found)
        for wall, found in ((wall, loop.worst_hand(hands, *wall)) for wall in gains)
    ]


def _tried_hands(scene: Scene, walls: Sequence[Gains]) -> list[WorstHeld]:
    """Return the worst of some hands for each wall."""
    among = hands_among(scene, _TRIED)
    loops = [loop_of(scene, hand) for hand in among]
    gains = np.array(walls).T
    codes = np.stack([loop.verdict(*gains) for loop in loops], axis=1)
    radii = np.stack([loop.spectral_radius(*gains).value for loop in loops], axis=1)
    return [_worst_tried(among, loops, *wall) for wall in zip(codes, radii, strict=True)]


def _held_at_worst(worst: WorstHand) -> WorstHeld:
    return WorstHeld(worst.verdict, worst.loop, held_by(worst.loop), None)


def _worst_tried(
    among: list[OneHand], loops: list[HapticLoop], codes: Integers, radii: Floats
) -> WorstHeld:
    is_unstable = codes == Verdict.UNSTABLE
    number = int(np.argmax(np.where(is_unstable | ~is_unstable.any(), radii, -1.0)))
    hand = HeldBy(*among[number])
    if is_unstable.any():
        return WorstHeld(Verdict.UNSTABLE, loops[number], hand, None)
    are = "all are stable, " if np.all(codes == Verdict.STABLE) else ""
    words = f"{len(loops)} hands were tried: {are}nothing is proved of those between"
    return WorstHeld(Verdict.UNDECIDED, loops[number], hand, words)


def limit_for_all(scene: Scene, safety: float) -> AllHands | None:
    """Return what all hands of a scene allow; None where there is one hand at most."""
    hands = hands_of(scene)
    if hands is None:
        return None
    if not proves_hands(scene):
        return _tried_limit(scene, safety)
    loop = loop_of(scene)
    found = loop.robust_limit(hands)
    if not is_one_mass(scene) and not found.is_proved:
        return _tried_limit(scene, safety)
    is_proved, stiffness = found.is_proved, safety * found.stiffness
    if safety < 1.0:
        is_proved = loop.worst_hand(hands, stiffness, found.damping).verdict == Verdict.STABLE
    return AllHands(
        largest_stiffness=stiffness,
        at_damping=found.damping,
        certainty="proved for every hand" if is_proved else "not proved",
        none_is_stiffer_than=found.limit if is_one_mass(scene) else None,
        worst_hand=held_by(found.loop),
    )


def held_by(loop: HapticLoop) -> HeldBy:
    """Return the hand of a loop of one mass, or with a device that one hand holds."""
    if loop.device is not None:
        arm = loop.device.hands[0].dynamics
        assert isinstance(arm, MassSpringDamper)  # as scenes make hands
        return HeldBy(arm.mass, arm.stiffness, arm.damping)
    return HeldBy(loop.hand_mass, loop.hand_stiffness, loop.hand_damping)


def common_outline(loops: list[HapticLoop]) -> Floats:
    """Return walls (K, B) that are stable for each of some loops: ``common_walls``, not proved."""
    regions = [reachable(wall_region(loop)) for loop in loops]
    if any(region.is_empty for region in regions):
        return np.zeros((0, 2))
    return common_walls(regions, _ROWS)


def _tried_limit(scene: Scene, safety: float) -> AllHands:
    """Return nearly the stiffest wall of the hands at the corners, tried for hands between."""
    among: list[OneHand | HeldBy] = [*hands_among(scene, 2)]
    loops, pull = corner_loops(scene), _PULL
    for _ in range(_ATTEMPTS):
        outline = common_outline(loops)
        if not len(outline):
            return AllHands(nan, nan, "no wall was found", None, _as_answer(among[0]))
        most, damping = outline[np.argmax(outline[:, 0])]
        setter = int(np.argmin([_reach(one, most, damping) for one in loops]))
        stiffness = safety * float(most - pull * abs(most))
        (worst,) = worst_held([(scene, Gains(stiffness, float(damping)))])
        if worst.tried:
            break
        loops.append(worst.loop)
        among.append(held_by(worst.loop))
        pull *= 2.0
    return AllHands(
        largest_stiffness=stiffness if worst.tried else nan,
        at_damping=float(damping),
        certainty=worst.tried or "unstable for a hand that was tried",
        none_is_stiffer_than=None,
        worst_hand=_as_answer(among[setter]),
    )


def _reach(loop: HapticLoop, stiffness: float, damping: float) -> float:
    """Return how far the interval of stable K goes that a wall is in, or ends nearest to."""
    ends = reachable(wall_region(loop)).stiffness_intervals(np.array([damping]))[0, :, 1]
    return float(ends[np.nanargmin(np.abs(ends - stiffness))])


def _as_answer(hand: OneHand | HeldBy) -> HeldBy:
    return hand if isinstance(hand, HeldBy) else HeldBy(*hand)
