"""The loops of a scene: with one hand, at the corners of its ranges, and for all of them.

For all hands of a scene, all masses of its device and all its delays some hands are tried: what one
of them contradicts is proved. For all others a proof is looked for.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import isfinite, isnan, nan
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.answers import BUT_FOR_DRIFT, GainAnswer, Phrase, Quantity, Units, printed_pair
from jaxstab.app.scene.scene import HandTable, Scene, range_in_words
from jaxstab.boxes.search import HandRange
from jaxstab.conventions import Verdict
from jaxstab.loop import Gains, HapticLoop, Region
from jaxstab.loop.gains import TwoGains
from jaxstab.loop.hands import common_walls
from jaxstab.model import Device, Hand, Mode
from jaxstab.model.device.parts import MassSpringDamper, Modes
from jaxstab.model.filters import Velocity, given_filters
from jaxstab.model.plant import DELTA_LIMIT, GAIN_LIMIT, GAMMA_LIMIT
from jaxstab.region import RegionStatus

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class OneHand(Phrase):
    """A hand of the range, and the mass of the device if that varies; None for its lowest one."""

    mass: float
    stiffness: float
    damping: float
    device_mass: float | None = None

    def in_words(self, units: Units) -> str:
        """The hand, such as "a hand of 0.2 kg, 100 N/m and 0 N s/m", and the device."""
        mass, stiffness, damping, *device = (words for _, _, words in self.leaves("", units))
        is_there = self.mass or self.stiffness or self.damping
        words = f"a hand of {mass}, {stiffness} and {damping}" if is_there else "no hand"
        return " and ".join([words, *(f"a device of {own}" for own in device)])

    def _quantity(self, name: str) -> Quantity:
        return replace(super()._quantity(name), digits=Quantity.digits)


def wall_region(loop: HapticLoop) -> Region:
    """The stable walls of a loop; RuntimeError where the region is not resolved."""
    region = loop.region()
    if region.status == RegionStatus.UNRESOLVED:
        raise RuntimeError(
            f"the stable region of a loop with a delay of {loop.delay:g} s, "
            f"{loop.velocity or Velocity()}, was not resolved; change one value a little."
        )
    return region


def loop_of(scene: Scene, hand: OneHand | None = None) -> HapticLoop:
    """The loop of a scene with a hand; without, the one at the lowest ends of the ranges."""
    hand = hand or _lowest_hand(scene)
    _check_scale(scene)
    controller, mechanics = scene.controller, dict[str, Any]()
    if is_one_mass(scene):
        mechanics = {"hand_mass": hand.mass, "hand_stiffness": hand.stiffness}
        mechanics["hand_damping"] = hand.damping
        mechanics["device_mass"] = hand.device_mass or scene.device.effective_mass[0]
        mechanics["device_damping"] = scene.device.effective_damping
    else:
        mechanics["device"] = device_of(scene, hand)
    return HapticLoop(
        **mechanics,
        sample_time=controller.sample_time,
        delay=controller.time_delay,
        velocity=controller.estimator,
        position=controller.position_filter,
    )


def is_one_mass(scene: Scene) -> bool:
    """True if the device and a hand rigidly attached to it are one mass."""
    device, hand = scene.device, scene.hand or HandTable()
    return not device.modes and device.actuator is None and hand.grip is None


def is_plain(loop: TwoGains) -> bool:
    """True if the simple rules hold for the loop: one mass, one-sample difference, no filters."""
    return (
        isinstance(loop, HapticLoop)
        and loop.body is not None
        and given_filters(**loop.filters) is None
    )


def hands_of(scene: Scene) -> HandRange | None:
    """Return the range of hands; None where neither the hand nor the device's mass varies."""
    varies = scene.device.varies or (scene.hand is not None and scene.hand.varies)
    return range_of_hands(scene) if varies else None


def masses_of(scene: Scene) -> tuple[float, float] | None:
    """Return the range of the device's mass; None where there is one mass."""
    return scene.device.effective_mass if scene.device.varies else None


def walls_of(scene: Scene) -> dict[str, Gains]:
    """Return the gains of the walls by name."""
    return {name: Gains(wall.stiffness, wall.damping) for name, wall in scene.walls.items()}


def range_of_hands(scene: Scene) -> HandRange:
    """Return the range of hands; of a scene without a hand, that of no hand."""
    mass, stiffness, damping = (scene.hand or HandTable()).ranges
    return HandRange(mass=mass, stiffness=stiffness, damping=damping)


def _lowest_hand(scene: Scene) -> OneHand:
    return OneHand(*(low for low, _ in (scene.hand or HandTable()).ranges))


def device_of(scene: Scene, hand: OneHand | None = None) -> Device:
    """Return the device with its modes and its actuator, held by a hand; as ``loop_of``."""
    hand = hand or _lowest_hand(scene)
    table = scene.device
    names = "frequency", "damping_ratio", "motor", "encoder", "handle"
    modes = [
        Mode(modal_mass=mode.effective_mass, **{name: getattr(mode, name) for name in names})
        for mode in table.modes
    ]
    mass, damping = hand.device_mass or table.effective_mass[0], table.effective_damping
    device = Device.mass_spring_damper(mass, damping=damping)
    if modes:
        device = Device.modes(modes, mass=mass, damping=damping)
    if table.actuator is not None:
        device = device.with_actuator(table.actuator.bandwidth)
    if scene.hand is None:
        return device
    arm = Hand.mass_spring_damper(hand.mass, damping=hand.damping, stiffness=hand.stiffness)
    grip = scene.hand.grip
    return device.held_by(
        arm if grip is None else arm.with_grip(stiffness=grip.stiffness, damping=grip.damping)
    )


def _check_scale(scene: Scene) -> None:
    """Refuse masses, hands and dampers that the model cannot compute, in the words of a scene."""
    hand, period = scene.hand or HandTable(), scene.controller.sample_time
    lightest, heaviest = map(add, scene.device.effective_mass, hand.effective_mass)
    damping, moved = scene.device.effective_damping + hand.damping[1], scene.units.moved
    gamma = hand.stiffness[1] * period * period / lightest
    for words, value, most in (
        (f"{moved}/T^2 of device and hand", heaviest / period / period, GAIN_LIMIT),
        (f"hand.stiffness T^2/{moved}", gamma, GAMMA_LIMIT),
        (f"damping T/{moved} of device and hand", damping * period / lightest, DELTA_LIMIT),
        (f"T^2/{moved} of device and hand", period * period / lightest, GAIN_LIMIT),
    ):
        if not value <= most:
            raise ValueError(
                f"{words} is {value:g}, where T is the sample_time, and at most {most:g} can be "
                "computed; check the units."
            )


# The ranges of a scene: masses of the device, hands and delays.


def ranges_of(scene: Scene) -> list[tuple[float, float]]:
    """Return the ends of mass, hand (3) and delay; ValueError for a delay that moves."""
    hand, controller = scene.hand or HandTable(), scene.controller
    if controller.moves:
        raise ValueError(
            f"the delay is {range_in_words(controller.delays)} s and moves, but this answer is for "
            'constant delays; give delay_is = "constant" in [controller], and no lost_samples.'
        )
    return [scene.device.effective_mass, *hand.ranges, controller.delays]


def with_tolerances(scene: Scene) -> Scene:
    """Return a scene whose ranges of mass and delay are as wide as their tolerances make them."""
    device, controller, wanted = scene.device, scene.controller, scene.wanted
    share, aside = wanted.mass_tolerance or 0.0, wanted.delay_tolerance or 0.0
    (lightest, heaviest), (shortest, longest) = device.effective_mass, controller.delays
    masses: Any = {scene.units.moved: (lightest * (1.0 - share), heaviest * (1.0 + share))}
    delays: Any = {"delay": (max(shortest - aside, 0.0), longest + aside), "delay_samples": None}
    kind = "moving" if controller.moves else "constant"
    return replace(
        scene,
        device=replace(device, **masses),
        controller=replace(controller, delay_is=kind, **delays),
    )


def loop_within(scene: Scene, values: Sequence[float]) -> HapticLoop:
    """The loop with a mass of the device, a hand (3) and a delay of a scene's ranges."""
    mass, *hand, delay = values
    return loop_of(with_delay(scene, delay), replace(OneHand(*hand), device_mass=mass))


def corner_loops(scene: Scene) -> list[HapticLoop]:
    """The loops at the corners of a scene's ranges, each once."""
    return [loop_within(scene, values) for values in dict.fromkeys(product(*ranges_of(scene)))]


def with_delay(scene: Scene, delay: float) -> Scene:
    """Return a scene with one constant delay in s."""
    constant: Any = {"delay_samples": None, "delay_is": None, "lost_samples": 0}
    return replace(scene, controller=replace(scene.controller, delay=(delay, delay), **constant))


_DRIFTS = "nothing holds the position of a damper alone; over ranges the rest is not proved"


def stiffest_wall(wall: Gains, every: str | None = None, **more: Any) -> GainAnswer:
    """The largest stable stiffness, and where it is reached: proved for ``every`` of a range.

    Beside it stand a stiffness proved unstable, the worst hand, or that a rule is no limit.
    """
    is_found = isfinite(wall.stiffness)
    values: dict[str, Any] = {"largest_stiffness": wall.stiffness, "at_damping": wall.damping}
    if every:
        values["certainty"] = f"proved for every {every}" if is_found else "no wall is proved"
    return GainAnswer(values | more, is_stable=is_found)


class JudgedWall(GainAnswer):
    """The verdict on a wall for all hands and delays, and the worst of them.

    The verdict is ``BUT_FOR_DRIFT`` for a stable damper on a device that nothing holds.
    ``hands_are`` describes the search where a verdict over ranges is UNDECIDED; ``worst_hand`` is
    None where neither a hand nor the mass varies; with ``worst_delays`` a motion grows. It is
    stable if it is proved for all hands and delays, but for a position that drifts.
    """

    @property
    def drifts(self) -> bool:
        """True if nothing holds the position, and no other root of a loop that was tried grows."""
        return self.verdict == BUT_FOR_DRIFT or self.hands_are == _DRIFTS

    @property
    def for_all(self) -> Verdict | str:
        """The verdict for all hands, or why there is none."""
        own: Verdict | str = self.verdict
        return own if own == Verdict.UNSTABLE else self.hands_are or own


def worst_on(scene: Scene, walls: Sequence[Gains]) -> list[tuple[JudgedWall, HapticLoop]]:
    """The verdict on each wall for all hands, masses and delays of a scene, and the worst loop.

    Of a delay that moves it is for every sequence; of one that is constant, but not known, for each
    constant one.
    """
    unproved = "none of the hands that were tried is unstable, but not all hands are proved"
    loop, delays, every = loops_over_delays(scene)[0], delays_of(scene), ranges_of_all(scene)
    is_alone = hands_of(scene) is None
    of_hands = "hand" if masses_of(scene) is None else f"hand and {scene.units.moved}"
    worst: list[tuple[Any, HapticLoop, float]]  # verdict, loop and radius
    if is_alone and not delays:
        worst = [(verdict_on(loop, *gains), loop, nan) for gains in walls]
    elif is_alone and scene.controller.moves:
        worst = [(loop.verdict(*gains, **delays), loop, nan) for gains in walls]
    else:
        found = [loop.worst_hand(stiffness=k, damping=b, **every) for k, b in walls]
        worst = [(one.verdict, one.loop, one.radius) for one in found]
    answers = []
    for gains, (code, held, radius) in zip(walls, worst, strict=True):
        verdict, drifts = code if isinstance(code, str) else Verdict(int(code)), None
        is_unstable = verdict == Verdict.UNSTABLE
        if is_unstable and verdict_with_drift(held, *gains) == BUT_FOR_DRIFT:
            verdict, drifts, is_unstable = Verdict.UNDECIDED, _DRIFTS, False
        hand, words = None if is_alone else held_by(held, scene), None
        is_range = not is_alone or "delay" in delays
        tried = drifts or (unproved if is_range and verdict == Verdict.UNDECIDED else None)
        if delays and is_unstable:
            constant = f"a constant delay of {Quantity('s').words(held.delay)}"
            words = f"{constant}: the motion grows by a factor of {radius:.6g} per sample"
            if scene.controller.moves:
                words = str(held.worst_delays(*gains, **delays))
        told = {"hands_are": tried, "worst_hand": hand, "worst_delays": words}
        is_stable = verdict in (Verdict.STABLE, BUT_FOR_DRIFT) and not tried
        values = gains._asdict() | {"verdict": verdict} | told
        remarks = {"every": None if hand is None or is_unstable else of_hands}
        answers.append((JudgedWall(values, is_stable=is_stable, remarks=remarks), held))
    return answers


def verdict_with_drift(loop: TwoGains, first: float, second: float) -> Verdict | str | None:
    """The verdict on gains without the position, where nothing holds that; None elsewhere."""
    code = loop._but_for_drift(first, second)
    return BUT_FOR_DRIFT if code == Verdict.STABLE else code


def verdict_on(loop: TwoGains, first: float, second: float) -> Verdict | str:
    """The verdict on two gains of one loop."""
    names = (gain.name for gain in loop.gains)
    code = verdict_with_drift(loop, first, second)
    if code is not None:
        return code
    return Verdict(int(loop.verdict(**dict(zip(names, (first, second), strict=True)))))


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
    return {"hands": range_of_hands(scene), "mass": masses_of(scene), **delays_of(scene)}


def limit_for_all(scene: Scene, safety: float) -> GainAnswer | None:
    """The limit for all hands of a scene; None where neither the hand nor the mass varies."""
    if hands_of(scene) is None:
        return None
    best, limiting = wall_for_all(scene, safety)
    return stiffest_wall(best, every_in_words(scene), worst_hand=held_by(limiting, scene))


def every_in_words(scene: Scene) -> str:
    """The words for all hands of a scene: "hand and mass and every sequence of delays"."""
    every = "hand"
    every += "" if masses_of(scene) is None else f" and {scene.units.moved}"
    return every + (" and every sequence of delays" if scene.controller.moves else "")


def wall_for_all(scene: Scene, safety: float) -> tuple[Gains, HapticLoop]:
    """Return the stiffest wall proved for all hands, masses and delays, and the limiting loop."""
    loop, every = loops_over_delays(scene)[0], ranges_of_all(scene)
    robust = loop.robust_limit(**every)

    def is_proved(stiffness: float, damping: float) -> bool:
        worst = loop.worst_hand(stiffness=stiffness, damping=damping, **every)
        return worst.verdict == Verdict.STABLE

    best = Gains(robust.stiffness, robust.damping)
    return with_safety(best, safety, is_proved), robust.loop


def with_safety(best: Gains, safety: float, is_proved: Callable[[float, float], bool]) -> Gains:
    """Return a proved wall times the safety, as it is printed; NaN where that is not proved."""
    stiffness, none = safety * best.stiffness, Gains(nan, nan)
    if isnan(stiffness) or (safety < 1.0 and not is_proved(stiffness, best.damping)):
        return none
    return Gains(*printed_pair(stiffness, best.damping, is_proved))


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
        body, hand = loop.device.mechanism, (0.0, 0.0, 0.0)
        assert isinstance(body, MassSpringDamper | Modes)  # as scenes make devices
        own = body.mass
        for held in loop.device.hands:
            arm = held.dynamics
            assert isinstance(arm, MassSpringDamper)  # and the one hand, if there is any
            hand = arm.mass, arm.stiffness, arm.damping
    return OneHand(*hand, own if scene.device.varies else None)


def common_outline(loops: list[HapticLoop]) -> Floats:
    """Return walls (K, B) that are stable for each of some loops: ``common_walls``, not proved."""
    regions = [wall_region(loop).reachable for loop in loops]
    if any(region.is_empty for region in regions):
        return np.zeros((0, 2))
    return common_walls(regions, 400)  # rows of B
