"""The loops of a scene, and the stable walls of a loop in SI units: one region, asked for all."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Numbers
from jaxstab.model import HapticLoop
from jaxstab.model.parameters import DELTA_LIMIT, GAMMA_LIMIT
from jaxstab.numbers import without_noise
from jaxstab.ranges import HandRange
from jaxstab.region import RegionStatus, StableRegion, stable_region
from jaxstab.region.region import LONGEST_DELAY
from jaxstab.scene.scene import Hand, Scene

Pairs = Float64[np.ndarray, "*grid 2"]

_REMEMBERED = 16  # regions


class Gains(NamedTuple):
    """Stiffness K in N/m and damping B in N s/m."""

    stiffness: float
    damping: float


@dataclass(frozen=True)
class WallRegion:
    """The stable walls of a loop: its exact stable region, in N/m and N s/m.

    Every number is NaN where no wall is stable. ``wall_region`` makes one.
    """

    loop: HapticLoop
    region: StableRegion

    @cached_property
    def outline(self) -> Float64[np.ndarray, "point 2"]:
        """The outline as points (K, B); one loop after the other."""
        return self.in_si_units(self.region.points)

    @cached_property
    def extent(self) -> Gains:
        """How far the region reaches from end to end, in K and in B."""
        if not len(self.outline):
            return Gains(np.nan, np.nan)
        return Gains(*(float(size) for size in np.ptp(self.outline, axis=0)))

    @cached_property
    def stiffest(self) -> Gains:
        """The point of the largest K."""
        return self._gains(self.region.max_alpha)

    @cached_property
    def most_damped(self) -> Gains:
        """The point of the largest B."""
        return self._gains(self.region.max_beta)

    def stiffness_limits(self, damping: float | Float64[np.ndarray, "*grid"]) -> Pairs:
        """Return the least and the largest stable K at given B; NaN where none is stable."""
        limits = self.region.alpha_limits(self.loop.beta(damping))
        return without_noise(self.loop.stiffness(np.asarray(limits)), self.extent.stiffness)

    def damping_limits(self, stiffness: float | Float64[np.ndarray, "*grid"]) -> Pairs:
        """Return the least and the largest stable B at given K; NaN where none is stable."""
        limits = self.region.beta_limits(self.loop.alpha(stiffness))
        return without_noise(self.loop.damping(np.asarray(limits)), self.extent.damping)

    def _gains(self, point: Numbers) -> Gains:
        exact = self.in_si_units(np.asarray(point))
        return Gains(
            *(float(without_noise(*pair)) for pair in zip(exact, self.extent, strict=True))
        )

    def in_si_units(self, points: Pairs) -> Pairs:
        """Return points (alpha, beta) as (K, B)."""
        return points * np.array([self.loop.stiffness(1.0), self.loop.damping(1.0)])


@lru_cache(_REMEMBERED)
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
    region = stable_region(loop.gamma, loop.delta, loop.delay_samples)
    if int(region.status) == RegionStatus.UNRESOLVED:
        raise ValueError(
            f"the stable region of gamma = {loop.gamma:g}, delta = {loop.delta:g}, "
            f"delay = {loop.delay_samples:g} samples was not resolved; change one value a little."
        )
    return WallRegion(loop, region)


def loop_of(scene: Scene) -> HapticLoop:
    """Return the loop of a scene with the hand at the lowest ends of its range.

    Raises:
        ValueError: a quantity is out of range.
    """
    hand = scene.hand or Hand()
    _check_scale(scene)
    return HapticLoop(
        device_mass=scene.device.mass,
        device_damping=scene.device.damping,
        sample_time=scene.controller.sample_time,
        hand_mass=hand.mass[0],
        hand_damping=hand.damping[0],
        hand_stiffness=hand.stiffness[0],
        delay=scene.controller.time_delay,
    )


def hands_of(scene: Scene) -> HandRange | None:
    """Return the range of hands, or None where there is one hand at most."""
    hand = scene.hand
    return HandRange(hand.mass, hand.stiffness, hand.damping) if hand and hand.varies else None


def walls_of(scene: Scene) -> dict[str, Gains]:
    """Return the gains of the walls by name."""
    return {name: Gains(wall.stiffness, wall.damping) for name, wall in scene.walls.items()}


def point_of(loop: HapticLoop, gains: Gains) -> tuple[float, float, float, float, float]:
    """Return the five numbers of a loop with a wall."""
    alpha, beta = loop.alpha(gains.stiffness), loop.beta(gains.damping)
    return alpha, beta, loop.gamma, loop.delta, loop.delay_samples


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
    per_speed = period / (scene.device.mass + hand.mass[0])
    damping = scene.device.damping + hand.damping[1]
    for words, value, most in (
        ("hand.stiffness T^2/mass", hand.stiffness[1] * period * per_speed, GAMMA_LIMIT),
        ("damping T/mass of device and hand", damping * per_speed, DELTA_LIMIT),
    ):
        if not value <= most:
            raise ValueError(
                f"{words} is {value:g}, where T is the sample_time, and at most {most:g} can be "
                "computed; check the units."
            )
