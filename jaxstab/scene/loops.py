"""The loops of a scene, and the stable walls of a loop."""

from dataclasses import replace
from itertools import product

from jaxstab.loop import Gains, HapticLoop, WallRegion
from jaxstab.model.filters import Velocity, given_filters
from jaxstab.model.parameters import DELTA_LIMIT, GAMMA_LIMIT
from jaxstab.ranges import HandRange
from jaxstab.region import RegionStatus
from jaxstab.region.region import LONGEST_DELAY
from jaxstab.scene.scene import Hand, Scene


def wall_region(loop: HapticLoop) -> WallRegion:
    """Return the stable walls of a loop.

    Raises:
        ValueError: the dimensionless parameters are out of range, or the region is not resolved.
    """
    if loop.delay_samples > LONGEST_DELAY:
        raise ValueError(
            f"the delay is {loop.delay_samples:g} samples, and limits are computed for at most "
            f"{LONGEST_DELAY:g}; a delay that is meant in samples is given as delay_samples."
        )
    region = loop.region()
    if region.status == RegionStatus.UNRESOLVED:
        raise ValueError(
            f"the stable region of gamma = {loop.gamma:g}, delta = {loop.delta:g}, "
            f"delay = {loop.delay_samples:g} samples{_with_filters(loop)} was not resolved; change "
            "one value a little."
        )
    return region


def loop_of(scene: Scene) -> HapticLoop:
    """Return the loop of a scene with the hand at the lowest ends of its range.

    Raises:
        ValueError: a quantity is out of range.
    """
    hand = scene.hand or Hand()
    _check_scale(scene)
    return HapticLoop(
        device_mass=scene.device.effective_mass,
        device_damping=scene.device.damping,
        sample_time=scene.controller.sample_time,
        hand_mass=hand.effective_mass[0],
        hand_damping=hand.damping[0],
        hand_stiffness=hand.stiffness[0],
        delay=scene.controller.time_delay,
        velocity=scene.controller.estimator,
        position=scene.controller.position_filter,
    )


def is_plain(loop: HapticLoop) -> bool:
    """Return whether the velocity is the difference over one sample, and nothing is filtered."""
    return given_filters(**loop.filters) is None


def reachable(region: WallRegion) -> WallRegion:
    """Return the walls that turning gains up from 0 reaches; all where small gains do not hold."""
    return region.main or region


def hands_of(scene: Scene) -> HandRange | None:
    """Return the range of hands, or None where there is one hand at most."""
    hand = scene.hand
    if hand is None or not hand.varies:
        return None
    return HandRange(hand.effective_mass, hand.stiffness, hand.damping)


def walls_of(scene: Scene) -> dict[str, Gains]:
    """Return the gains of the walls by name."""
    return {name: Gains(wall.stiffness, wall.damping) for name, wall in scene.walls.items()}


def corner_loops(loop: HapticLoop, hands: HandRange) -> list[HapticLoop]:
    """Return the loop with each hand at the corners of a range.

    Raises:
        ValueError: a quantity is out of range.
    """
    return [
        replace(loop, hand_mass=mass, hand_stiffness=stiffness, hand_damping=damping)
        for mass, stiffness, damping in product(*(sorted(set(ends)) for ends in hands))
    ]


def _check_scale(scene: Scene) -> None:
    """Refuse hands and dampers that the model cannot compute, in the words of a scene."""
    hand, period = scene.hand or Hand(), scene.controller.sample_time
    per_speed = period / (scene.device.effective_mass + hand.effective_mass[0])
    damping, moved = scene.device.damping + hand.damping[1], scene.units.moved
    for words, value, most in (
        (f"hand.stiffness T^2/{moved}", hand.stiffness[1] * period * per_speed, GAMMA_LIMIT),
        (f"damping T/{moved} of device and hand", damping * per_speed, DELTA_LIMIT),
    ):
        if not value <= most:
            raise ValueError(
                f"{words} is {value:g}, where T is the sample_time, and at most {most:g} can be "
                "computed; check the units."
            )


def _with_filters(loop: HapticLoop) -> str:
    return "" if is_plain(loop) else f", {loop.velocity or Velocity()}"
