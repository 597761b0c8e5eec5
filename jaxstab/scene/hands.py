"""All hands of a scene, all masses of its device and all its delays: verdicts, the stiffest wall.

Hands are tried: what one of them contradicts is proved. For all others a proof is looked for.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite, isnan, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.conventions import Verdict
from jaxstab.exact import wall_verdict
from jaxstab.loop import Gains, HapticLoop
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
BUT_FOR_DRIFT = "stable but for the position, which nothing holds"
_DRIFTS = "nothing holds the position of a damper alone; over ranges the rest is not proved"

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
        """True if the wall is proved stable for every hand."""
        return self.certainty.startswith(_PROVED) and isfinite(self.largest_stiffness)


@dataclass(frozen=True)
class WallVerdict(Answer):
    """The verdict on a wall for all hands and delays, and the worst of them.

    The verdict is ``BUT_FOR_DRIFT`` for a stable damper on a device that nothing holds.
    ``hands_are`` describes the search where a verdict over ranges is UNDECIDED; ``worst_hand`` is
    None where neither a hand nor the mass varies; with ``worst_delays`` a motion grows.
    """

    stiffness: GivenStiffness
    damping: GivenDamping
    verdict: Verdict | str
    hands_are: str | None
    worst_hand: OneHand | None
    worst_delays: str | None

    @property
    def is_stable(self) -> bool:
        """True if the wall is proved for all hands and delays, but for a position that drifts."""
        return self.verdict in (Verdict.STABLE, BUT_FOR_DRIFT) and self.hands_are is None

    @property
    def drifts(self) -> bool:
        """True if nothing holds the position, and no other root of a loop that was tried grows."""
        return self.verdict == BUT_FOR_DRIFT or self.hands_are == _DRIFTS

    @property
    def for_all(self) -> Verdict | str:
        """The verdict for all hands, or why there is none."""
        return self.verdict if self.verdict == Verdict.UNSTABLE else self.hands_are or self.verdict


def worst_on(scene: Scene, walls: Sequence[Gains]) -> list[tuple[WallVerdict, HapticLoop]]:
    """The verdict on each wall for all hands, masses and delays of a scene, and the worst loop.

    Of a delay that moves it is for every sequence; of one that is constant, but not known, for each
    constant one.
    """
    unproved = "none of the hands that were tried is unstable, but not all hands are proved"
    loop, delays, every = loops_over_delays(scene)[0], delays_of(scene), ranges_of_all(scene)
    is_alone = hands_of(scene) is None
    worst: list[tuple[Any, HapticLoop, float]]  # verdict, loop and radius
    if is_alone and not delays:
        codes = loop.verdict(*np.array(walls).T)
        worst = [
            (verdict_with_drift(loop, w) or c, loop, nan) for w, c in zip(walls, codes, strict=True)
        ]
    elif is_alone and scene.controller.moves:
        worst = [(loop.verdict(*gains, **delays), loop, nan) for gains in walls]
    else:
        found = [loop.worst_hand(stiffness=k, damping=b, **every) for k, b in walls]
        worst = [(one.verdict, one.loop, one.radius) for one in found]
    answers = []
    for gains, (code, held, radius) in zip(walls, worst, strict=True):
        verdict, drifts = _but_for_drift(code, held, gains)
        hand, words = None if is_alone else held_by(held, scene), None
        is_range = not is_alone or "delay" in delays
        tried = drifts or (unproved if is_range and verdict == Verdict.UNDECIDED else None)
        if delays and verdict == Verdict.UNSTABLE:
            constant = f"a constant delay of {Quantity('s').words(held.delay)}"
            words = f"{constant}: the motion grows by a factor of {radius:.6g} per sample"
            if scene.controller.moves:
                words = str(held.worst_delays(*gains, **delays))
        answers.append((WallVerdict(*gains, verdict, tried, hand, words), held))
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


def loops_over_delays(scene: Scene) -> list[HapticLoop]:
    """Return the loops of the shortest and the longest delay; one where these are the same."""
    return [loop_of(with_delay(scene, delay)) for delay in dict.fromkeys(scene.controller.delays)]


def delays_of(scene: Scene) -> dict[str, Any]:
    """Return the arguments of a loop's methods for a range of delays; none for one delay.

    These are ``delays`` and ``lost`` of a delay that moves, ``delay`` of one that is constant.
    """
    controller = scene.controller
    if controller.moves:
        return {"delays": controller.delays, "lost": controller.lost_samples}
    return {} if controller.has_one_delay else {"delay": controller.delays}


def ranges_of_all(scene: Scene) -> dict[str, Any]:
    """Return the arguments for all hands, masses and delays of a scene, as ``robust_limit`` has."""
    hands = hands_of(scene) or range_of_hands(scene)
    return {"hands": hands, "mass": masses_of(scene), **delays_of(scene)}


def limit_for_all(scene: Scene, safety: float) -> AllHands | None:
    """The limit for all hands of a scene; None where neither the hand nor the mass varies."""
    if hands_of(scene) is None:
        return None
    best, is_proved, limiting = wall_for_all(scene, safety)
    proved = _PROVED + ("" if masses_of(scene) is None else f" and {scene.units.moved}")
    proved += " and every sequence of delays" if scene.controller.moves else ""
    tried = "no wall was found" if isnan(best.stiffness) else "not proved"
    return AllHands(*best, proved if is_proved else tried, held_by(limiting, scene))


def wall_for_all(scene: Scene, safety: float) -> tuple[Gains, bool, HapticLoop]:
    """Return the stiffest wall for all hands, masses and delays, times the safety.

    Beside it stand whether it is proved, and the loop that limits it.
    """
    loop, every = loops_over_delays(scene)[0], ranges_of_all(scene)
    robust = loop.robust_limit(**every)

    def is_proved(stiffness: float, damping: float) -> bool:
        worst = loop.worst_hand(stiffness=stiffness, damping=damping, **every)
        return worst.verdict == Verdict.STABLE

    best = Gains(robust.stiffness, robust.damping)
    return *with_safety(best, robust.is_proved, safety, is_proved), robust.loop


def with_safety(
    best: Gains, is_best: bool, safety: float, is_proved: Callable[[float, float], bool]
) -> tuple[Gains, bool]:
    """Return a largest stiffness times the safety as it is printed, and whether it is proved."""
    stiffness = safety * best.stiffness
    if safety < 1.0 and (is_best or stiffness > 0.0):
        is_best = is_proved(stiffness, best.damping)
    if not is_best:
        return Gains(stiffness, best.damping), False
    return Gains(*printed_wall(stiffness, best.damping, is_proved)), True


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
    return common_walls(regions, 400)  # rows of B
