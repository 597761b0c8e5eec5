"""All hands of a scene, all masses of its device and all its delays: verdicts, the stiffest wall.

Hands are tried: what one of them contradicts is proved. For all others a proof is looked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite, isnan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.conventions import Verdict
from jaxstab.exact import wall_verdict
from jaxstab.loop import Gains, HapticLoop
from jaxstab.loop.hands import LoopsWithHands
from jaxstab.model.balls import ball_triple
from jaxstab.model.device.parts import MassSpringDamper, Modes
from jaxstab.scene.answers import (
    Answer,
    Damping,
    GivenDamping,
    GivenStiffness,
    LargestStiffness,
    Quantity,
    printed_wall,
)
from jaxstab.scene.loops import (
    OneHand,
    hands_of,
    loop_of,
    masses_of,
    range_of_hands,
    wall_region,
    with_delay,
)
from jaxstab.scene.scene import Scene

_PROVED = "proved for every hand"
_TRIED = "no hand that was tried is unstable, but not all others are proved"
BUT_FOR_DRIFT = "stable but for the position, which nothing holds"
_DRIFTS = "nothing holds the position of a damper alone; over ranges the rest is not proved"
_ROWS = 400  # of B, in which walls are stable for all hands

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class AllHands(Answer):
    """A wall for all hands of a range, nearly the stiffest, times the safety if one is wanted."""

    largest_stiffness: LargestStiffness
    at_damping: Damping
    certainty: str
    worst_hand: OneHand

    @property
    def all_stable(self) -> bool:
        """Whether the wall is proved stable for every hand."""
        return self.certainty.startswith(_PROVED) and isfinite(self.largest_stiffness)


@dataclass(frozen=True)
class WallVerdict(Answer):
    """The verdict on a wall for all hands and delays, and the worst of them."""

    stiffness: GivenStiffness
    damping: GivenDamping
    verdict: Verdict | str
    hands_are: str | None
    worst_hand: OneHand | None
    worst_delays: str | None

    @property
    def is_stable(self) -> bool:
        """Whether the wall is proved for all hands and delays, but for a position that drifts."""
        return self.verdict in (Verdict.STABLE, BUT_FOR_DRIFT) and self.hands_are is None


class WorstHeld(NamedTuple):
    """The verdict on a wall for all hands, the worst of them, and the loop that it holds.

    The verdict is ``BUT_FOR_DRIFT`` for a stable damper on a device that nothing holds. ``hand`` is
    None where neither a hand nor the mass varies; ``tried`` describes the search where the verdict
    is UNDECIDED, and ``delays`` those of a range with which a motion grows.
    """

    verdict: Verdict | str
    loop: HapticLoop
    hand: OneHand | None
    tried: str | None
    delays: str | None = None

    @property
    def drifts(self) -> bool:
        """Whether nothing holds the position, and no other root of a loop that was tried grows."""
        return self.verdict == BUT_FOR_DRIFT or self.tried == _DRIFTS

    @property
    def for_all(self) -> Verdict | str:
        """The verdict for all hands, or why there is none."""
        return self.verdict if self.verdict == Verdict.UNSTABLE else self.tried or self.verdict

    def on(self, wall: Gains) -> WallVerdict:
        """Return the verdict as an answer about the wall."""
        return WallVerdict(*wall, self.verdict, self.tried, self.hand, self.delays)


def worst_on(scene: Scene, walls: Sequence[Gains]) -> list[WorstHeld]:
    """The verdict on each wall for all hands, masses and delays of a scene, and the worst of them.

    Of a delay that moves it is for every sequence; of one that is constant, but not known, for each
    constant one.
    """
    loops, moving, hands = loops_over_delays(scene), moving_delays(scene), hands_of(scene)
    loop, mass = loops[0], masses_of(scene)
    if len(loops) > 1 and not moving:
        return [_worst_delay(scene, gains) for gains in walls]
    pairs: list[Any]
    if hands is None and not moving:
        codes = loop.verdict(*np.array(walls).T)
        pairs = [
            (verdict_with_drift(loop, w) or c, loop) for w, c in zip(walls, codes, strict=True)
        ]
    elif hands is None:
        pairs = [(loop.verdict(*gains, **moving), loop) for gains in walls]
    else:
        pairs = [loop.worst_hand(hands, *gains, mass=mass, **moving)[:2] for gains in walls]
    answers = []
    for gains, (code, worst) in zip(walls, pairs, strict=True):
        verdict, drifts = _but_for_drift(code, worst, gains)
        hand = None if hands is None else held_by(worst, scene)
        tried = drifts or (_TRIED if hand and verdict == Verdict.UNDECIDED else None)
        grows = bool(moving) and verdict == Verdict.UNSTABLE
        words = str(worst.worst_delays(*gains, **moving)) if grows else None
        answers.append(WorstHeld(verdict, worst, hand, tried, words))
    return answers


def verdict_with_drift(loop: HapticLoop, wall: Gains) -> Verdict | str | None:
    """Return the verdict on a damper without a spring on a free device; None for another wall."""
    if wall.stiffness != 0.0 or loop.held_device.static_stiffness() != 0.0:
        return None
    triple = partial(ball_triple, loop)
    code = wall_verdict(triple, 0.0, wall.damping, may_drift=True).verdict
    return BUT_FOR_DRIFT if code == Verdict.STABLE else code


def _but_for_drift(code: Any, worst: HapticLoop, wall: Gains) -> tuple[Verdict | str, str | None]:
    """Return the verdict over ranges, and why there is none where the worst loop only drifts."""
    if isinstance(code, str):
        return code, None
    if code == Verdict.UNSTABLE and verdict_with_drift(worst, wall) == BUT_FOR_DRIFT:
        return Verdict.UNDECIDED, _DRIFTS
    return Verdict(int(code)), None


def with_constant_delays(scene: Scene) -> LoopsWithHands:
    """Return the loop of a scene with all of its hands, masses and constant delays."""
    hands = hands_of(scene) or range_of_hands(scene)
    loop = loops_over_delays(scene)[0]
    return LoopsWithHands(loop, hands, masses_of(scene), scene.controller.delays)


def _worst_delay(scene: Scene, gains: Gains) -> WorstHeld:
    """Return the verdict on a wall for each constant delay of a range, and the worst of them."""
    worst = with_constant_delays(scene).worst(*gains)
    delay = Quantity("s").words(worst.loop.delay)
    words = f"a constant delay of {delay}: a factor of {worst.radius:.6g} per sample"
    verdict, drifts = _but_for_drift(worst.verdict, worst.loop, gains)
    hand = None if hands_of(scene) is None else held_by(worst.loop, scene)
    tried = drifts or (_TRIED if verdict == Verdict.UNDECIDED else None)
    is_unstable = verdict == Verdict.UNSTABLE
    return WorstHeld(verdict, worst.loop, hand, tried, words if is_unstable else None)


def loops_over_delays(scene: Scene) -> list[HapticLoop]:
    """Return the loops of the shortest and the longest delay; one where these are the same."""
    return [loop_of(with_delay(scene, delay)) for delay in dict.fromkeys(scene.controller.delays)]


def moving_delays(scene: Scene) -> dict[str, Any]:
    """Return the arguments ``delays`` and ``lost`` for a delay that moves; none for another."""
    moves, delays = scene.controller.moves, scene.controller.delays
    return {"delays": delays, "lost": scene.controller.lost_samples} if moves else {}


def limit_for_all(scene: Scene, safety: float) -> AllHands | None:
    """Return what all hands of a scene allow; None where neither the hand nor the mass varies."""
    hands = hands_of(scene)
    if hands is None:
        return None
    loop, mass, moving = loops_over_delays(scene)[0], masses_of(scene), moving_delays(scene)
    robust = loop.robust_limit(hands, mass=mass, **moving)

    def is_proved_for_all(stiffness: float, damping: float) -> bool:
        worst = loop.worst_hand(hands, stiffness, damping, mass=mass, **moving)
        return worst.verdict == Verdict.STABLE

    is_proved, stiffness, damping = robust.is_proved, safety * robust.stiffness, robust.damping
    if safety < 1.0 and not isnan(stiffness):
        is_proved = is_proved_for_all(stiffness, damping)
    if is_proved:
        stiffness, damping = printed_wall(stiffness, damping, is_proved_for_all)
    proved = _PROVED + ("" if mass is None else f" and {scene.units.moved}")
    proved += " and every sequence of delays" if moving else ""
    tried = "no wall was found" if isnan(stiffness) else "not proved"
    return AllHands(
        largest_stiffness=stiffness,
        at_damping=damping,
        certainty=proved if is_proved else tried,
        worst_hand=held_by(robust.loop, scene),
    )


def at_lowest(scene: Scene, others: str = " unless stated otherwise") -> str | None:
    """Return for which hand answers hold that name none, and of others; None where none varies."""
    if hands_of(scene) is None:
        return None
    mass = f", the device at its lowest {scene.units.moved}" if scene.device.varies else ""
    return f"at its lowest values{mass}{others}"


def held_by(loop: HapticLoop, scene: Scene) -> OneHand:
    """Return the hand of a loop of a scene, and the device's mass if that varies."""
    hand, own = (loop.hand_mass, loop.hand_stiffness, loop.hand_damping), loop.device_mass
    if loop.device is not None:
        arm, body = loop.device.hands[0].dynamics, loop.device.mechanism
        assert isinstance(arm, MassSpringDamper)  # as scenes make hands
        assert isinstance(body, MassSpringDamper | Modes)  # and devices
        hand, own = (arm.mass, arm.stiffness, arm.damping), body.mass
    return OneHand(*hand, own if scene.device.varies else None)


def common_outline(loops: list[HapticLoop]) -> Floats:
    """Return walls (K, B) that are stable for each of some loops: ``common_walls``, not proved."""
    from jaxstab.loop.hands import common_walls

    regions = [wall_region(loop).reachable for loop in loops]
    if any(region.is_empty for region in regions):
        return np.zeros((0, 2))
    return common_walls(regions, _ROWS)
