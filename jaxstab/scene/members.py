"""The members of a scene's ranges: masses of the device, hands and delays."""

from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

from jaxstab.loop import HapticLoop
from jaxstab.scene.loops import OneHand, loop_of
from jaxstab.scene.mechanics import Hand
from jaxstab.scene.scene import Scene


class Member(NamedTuple):
    """A member of the ranges: the device's mass, the hand and the delay in s."""

    mass: float
    hand: OneHand
    delay: float


def ranges_of(scene: Scene) -> list[tuple[float, float]]:
    """Return the ends of mass, hand (3) and delay."""
    wanted, hand, delay = scene.wanted, scene.hand or Hand(), scene.controller.time_delay
    masses, share = scene.device.effective_mass, wanted.mass_tolerance or 0.0
    aside = wanted.delay_tolerance or 0.0
    return [
        (masses[0] * (1.0 - share), masses[1] * (1.0 + share)),
        hand.effective_mass,
        hand.stiffness,
        hand.damping,
        (max(delay - aside, 0.0), delay + aside),
    ]


def member_of(values: Any) -> Member:
    """Return the member of five numbers, one of each range."""
    mass, *hand, delay = values
    return Member(mass, OneHand(*hand), delay)


def corners_of(scene: Scene) -> list[Member]:
    """Return the members at the corners of the ranges, each once."""
    return list(dict.fromkeys(member_of(values) for values in product(*ranges_of(scene))))


def loop_of_member(scene: Scene, member: Member) -> HapticLoop:
    """Return the loop of a member of the ranges."""
    delayed = replace(scene.controller, delay=member.delay, delay_samples=None)
    hand = member.hand._replace(device_mass=member.mass)
    return loop_of(replace(scene, controller=delayed), hand)
