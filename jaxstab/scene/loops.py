"""The loops of a scene, and the stable walls of a loop."""

from dataclasses import dataclass, replace
from itertools import product
from operator import add
from typing import Any, NamedTuple

import numpy as np

from jaxstab.boxes.hands import HandRange
from jaxstab.loop import Gains, HapticLoop, WallRegion
from jaxstab.model import Device, Mode
from jaxstab.model import Hand as Arm
from jaxstab.model.filters import Velocity, given_filters
from jaxstab.model.parameters import DELTA_LIMIT, GAIN_LIMIT, GAMMA_LIMIT
from jaxstab.region import RegionStatus
from jaxstab.scene.answers import Answer, Damping, Mass, Stiffness
from jaxstab.scene.scene import Hand, Scene, Units, range_in_words


@dataclass(frozen=True)
class OneHand(Answer):
    """A hand of the range, and the mass of the device if that varies; None for its lowest one."""

    mass: Mass
    stiffness: Stiffness
    damping: Damping
    device_mass: Mass | None = None

    def in_words(self, units: Units) -> str:
        """The hand, such as "a hand of 0.2 kg, 100 N/m and 0 N s/m", and the device."""
        mass, stiffness, damping, *device = (words for _, _, words in self.leaves("", units))
        is_there = self.mass or self.stiffness or self.damping
        words = f"a hand of {mass}, {stiffness} and {damping}" if is_there else "no hand"
        return " and ".join([words, *(f"a device of {own}" for own in device)])


def wall_region(loop: HapticLoop) -> WallRegion:
    """The stable walls of a loop; ValueError where the region is not resolved."""
    region = loop.region()
    if region.status == RegionStatus.UNRESOLVED:
        raise ValueError(
            f"the stable region of {_inputs(loop)} was not resolved; change one value a little."
        )
    return region


def loop_of(scene: Scene, hand: OneHand | None = None) -> HapticLoop:
    """The loop of a scene with a hand; without, the one at the lowest ends of the ranges."""
    hand = hand or _lowest_hand(scene)
    _check_scale(scene)
    controller = scene.controller
    mechanics = _one_mass(scene, hand) if is_one_mass(scene) else {"device": device_of(scene, hand)}
    return HapticLoop(
        **mechanics,
        sample_time=controller.sample_time,
        delay=controller.time_delay,
        velocity=controller.estimator,
        position=controller.position_filter,
    )


def is_one_mass(scene: Scene) -> bool:
    """True if the device and a hand rigidly attached to it are one mass."""
    device, hand = scene.device, scene.hand or Hand()
    return not device.modes and device.actuator is None and hand.grip is None


def is_plain(loop: HapticLoop) -> bool:
    """True if the simple rules hold for the loop: one mass, one-sample difference, no filters."""
    return loop.body is not None and given_filters(**loop.filters) is None


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


def hands_among(scene: Scene, count: int) -> list[OneHand]:
    """A grid over the ranges of the scene's hand and device mass; ``count`` 2 gives the corners."""
    from jaxstab.boxes.hands import spread_hands

    hands, masses = spread_hands(range_of_hands(scene), count).tolist(), masses_of(scene)
    among = [None] if masses is None else np.linspace(*masses, count).tolist()
    return [replace(OneHand(*hand), device_mass=mass) for hand in hands for mass in among]


def corner_loops(scene: Scene) -> list[HapticLoop]:
    """The loop of a scene with each hand and mass at the corners of the ranges."""
    return [loop_of(scene, hand) for hand in hands_among(scene, 2)]


def range_of_hands(scene: Scene) -> HandRange:
    """Return the range of hands; of a scene without a hand, that of no hand."""
    hand = scene.hand or Hand()
    return HandRange(mass=hand.effective_mass, stiffness=hand.stiffness, damping=hand.damping)


def _one_mass(scene: Scene, hand: OneHand) -> dict[str, float]:
    return {
        "device_mass": hand.device_mass or scene.device.effective_mass[0],
        "device_damping": scene.device.damping,
        "hand_mass": hand.mass,
        "hand_damping": hand.damping,
        "hand_stiffness": hand.stiffness,
    }


def _lowest_hand(scene: Scene) -> OneHand:
    held = scene.hand or Hand()
    return OneHand(held.effective_mass[0], held.stiffness[0], held.damping[0])


def device_of(scene: Scene, hand: OneHand | None = None) -> Device:
    """Return the device with its modes and its actuator, held by a hand; as ``loop_of``."""
    hand = hand or _lowest_hand(scene)
    table = scene.device
    modes = [
        Mode(
            frequency=mode.frequency,
            damping_ratio=mode.damping_ratio,
            modal_mass=mode.effective_mass,
            motor=mode.motor,
            encoder=mode.encoder,
            handle=mode.handle,
        )
        for mode in table.modes
    ]
    mass, damping = hand.device_mass or table.effective_mass[0], table.damping
    device = Device.mass_spring_damper(mass, damping=damping)
    if modes:
        device = Device.modes(modes, mass=mass, damping=damping)
    if table.actuator is not None:
        device = device.with_actuator(table.actuator.bandwidth)
    if scene.hand is None:
        return device
    arm = Arm.mass_spring_damper(hand.mass, damping=hand.damping, stiffness=hand.stiffness)
    grip = scene.hand.grip
    return device.held_by(
        arm if grip is None else arm.with_grip(stiffness=grip.stiffness, damping=grip.damping)
    )


def _check_scale(scene: Scene) -> None:
    """Refuse masses, hands and dampers that the model cannot compute, in the words of a scene."""
    hand, period = scene.hand or Hand(), scene.controller.sample_time
    lightest, heaviest = map(add, scene.device.effective_mass, hand.effective_mass)
    damping, moved = scene.device.damping + hand.damping[1], scene.units.moved
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


def _inputs(loop: HapticLoop) -> str:
    """The parameters that determine the region of a loop."""
    velocity = loop.velocity or Velocity()
    filters = "" if given_filters(**loop.filters) is None else f", {velocity}"
    if loop.body is None:
        return f"this device and hand, delay = {loop.delay_samples:g} samples{filters}"
    return (
        f"gamma = {loop.gamma:g}, delta = {loop.delta:g}, delay = {loop.delay_samples:g} "
        f"samples{filters}"
    )


# The members of a scene's ranges: masses of the device, hands and delays.


class Member(NamedTuple):
    """A member of the ranges: the device's mass, the hand and the delay in s."""

    mass: float
    hand: OneHand
    delay: float


def ranges_of(scene: Scene) -> list[tuple[float, float]]:
    """Return the ends of mass, hand (3) and delay."""
    wanted, hand, controller = scene.wanted, scene.hand or Hand(), scene.controller
    masses, share = scene.device.effective_mass, wanted.mass_tolerance or 0.0
    aside = wanted.delay_tolerance or 0.0
    shortest, longest = controller.delays
    if controller.moves:
        raise ValueError(
            f"the delay is {range_in_words(controller.delays)} s and moves, but this answer is for "
            'constant delays; give delay_is = "constant" in [controller], and no lost_samples.'
        )
    return [
        (masses[0] * (1.0 - share), masses[1] * (1.0 + share)),
        hand.effective_mass,
        hand.stiffness,
        hand.damping,
        (max(shortest - aside, 0.0), longest + aside),
    ]


def with_tolerances(scene: Scene) -> Scene:
    """Return a scene whose ranges of mass and delay are as wide as their tolerances make them."""
    masses, *_ = ranges_of(scene.at_longest_delay)
    controller, aside = scene.controller, scene.wanted.delay_tolerance or 0.0
    (shortest, longest), kind = controller.delays, "moving" if controller.moves else "constant"
    delays: Any = {"delay": (max(shortest - aside, 0.0), longest + aside), "delay_samples": None}
    mass: Any = {"mass" if scene.device.inertia is None else "inertia": masses}
    return replace(
        scene,
        device=replace(scene.device, **mass),
        controller=replace(controller, delay_is=kind, **delays),
    )


def member_of(values: Any) -> Member:
    """Return the member of five numbers, one of each range."""
    mass, *hand, delay = values
    return Member(mass, OneHand(*hand), delay)


def corners_of(scene: Scene) -> list[Member]:
    """Return the members at the corners of the ranges, each once."""
    return list(dict.fromkeys(member_of(values) for values in product(*ranges_of(scene))))


def loop_of_member(scene: Scene, member: Member) -> HapticLoop:
    """Return the loop of a member of the ranges."""
    hand = replace(member.hand, device_mass=member.mass)
    return loop_of(with_delay(scene, member.delay), hand)


def with_delay(scene: Scene, delay: float) -> Scene:
    """Return a scene with one constant delay in s."""
    constant: Any = {"delay_samples": None, "delay_is": None, "lost_samples": 0}
    return replace(scene, controller=replace(scene.controller, delay=(delay, delay), **constant))
