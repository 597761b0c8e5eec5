"""Walls that several loops render stably: the intersection of their exact regions, proved."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float64, Int8

from jaxstab.arrays import Numbers
from jaxstab.conventions import Verdict
from jaxstab.loop.between import LoopsBetween
from jaxstab.loop.common_walls import common_walls
from jaxstab.loop.region import TOLERANCE, Gains, wall_region
from jaxstab.loop.tried_loops import WIDER, TriedLoops, common_outline
from jaxstab.model import LoopParameters
from jaxstab.model.filters import given_filters
from jaxstab.numbers import checked_number
from jaxstab.point import verdict
from jaxstab.ranges.device_margins import is_stable_along
from jaxstab.ranges.robust_region import RobustStatus, failures, pulled_in
from jaxstab.region import RegionStatus

if TYPE_CHECKING:
    from jaxstab.loop.loop import HapticLoop

Points = Float64[np.ndarray, "vertex 2"]


@dataclass(frozen=True)
class CommonRegion:
    """Walls that are stable in every one of several loops, reached by turning gains up from 0.

    Attributes:
        loops: the loops; of all loops between two, those that were tried.
        status: PROVED if every wall of the outline is proved stable in every loop; EMPTY if no row
            of damping was found with such a wall; otherwise UNPROVED.
        outline: a polygon of walls (K, B), counter-clockwise, the first vertex not repeated; none
            unless the status is PROVED.
        tolerance: how far the outline was pulled in to be proved, as a share of its size: the
            intersection of the regions is larger by about as much.
        between: all of the loops where they are those between two; what is proved holds for all.

    Example:
        >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
        >>> common = jaxstab.common_region([light, heavy])
        >>> common.status.name, bool(common.contains(5000.0, 50.0))
        ('PROVED', True)
    """

    loops: "tuple[HapticLoop, ...]"
    status: RobustStatus
    outline: Points = field(repr=False)
    tolerance: float
    between: LoopsBetween | None = None

    @property
    def stiffest(self) -> Gains:
        """The vertex of the largest stiffness; NaN without an outline.

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> common = jaxstab.common_region([light, heavy])
            >>> print(f"{common.stiffest.stiffness:.0f} N/m at {common.stiffest.damping:.1f} N s/m")
            69796 N/m at 82.5 N s/m
        """
        if not len(self.outline):
            return Gains(np.nan, np.nan)
        stiffness, damping = self.outline[np.argmax(self.outline[:, 0])].tolist()
        return Gains(stiffness, damping)

    def verdict(self, stiffness: Numbers, damping: Numbers) -> Int8[np.ndarray, "*grid"]:
        """Return proved codes of ``Verdict`` for walls in all of the loops together.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Returns:
            STABLE where a wall is proved stable in every loop, outside the outline too; UNSTABLE
            where it is proved unstable in one loop; otherwise UNDECIDED.

        Raises:
            ValueError: a gain is infinite or NaN.

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> common = jaxstab.common_region([light, heavy])
            >>> common.verdict([5000.0, 200000.0], 50.0).tolist()
            [1, 2]
        """
        if self.between is not None:
            return self.between.verdict(stiffness, damping)
        codes = np.stack([np.asarray(loop.verdict(stiffness, damping)) for loop in self.loops])
        is_stable = np.all(codes == Verdict.STABLE, axis=0)
        known = np.where(is_stable, Verdict.STABLE, Verdict.UNDECIDED)
        is_unstable = np.any(codes == Verdict.UNSTABLE, axis=0)
        return np.asarray(np.where(is_unstable, Verdict.UNSTABLE, known), np.int8)

    def contains(self, stiffness: Numbers, damping: Numbers) -> Bool[np.ndarray, "*grid"]:
        """Return where walls are proved stable in every loop; see ``verdict``.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Raises:
            ValueError: a gain is infinite or NaN.

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> common = jaxstab.common_region([light, heavy])
            >>> common.contains(5000.0, [50.0, 500.0]).tolist()
            [True, False]
        """
        return np.asarray(self.verdict(stiffness, damping) == Verdict.STABLE)


def common_region(
    loops: "Sequence[HapticLoop] | LoopsBetween", *, tolerance: float = 0.02
) -> CommonRegion:
    """Return the walls that are stable in each of several loops, with a polygon that is proved.

    The loops of a list may differ in everything: devices, hands, estimators, delays, sampling
    periods. The answer holds for these loops alone, not for loops between them. For an interval of
    one parameter give ``jaxstab.LoopsBetween``: then it holds for every loop between the two.

    Args:
        loops: at least one, or all loops between two.
        tolerance: how far the polygon is pulled in to be proved, as a share of its size, in
            [1e-3, 0.1]; twice or four times as much where that is not enough.

    Returns:
        CommonRegion with its status. An empty one is an answer, not an error.

    Raises:
        ValueError: there is no loop, the tolerance is out of range, or a device does not give way
            to a constant force.
        TypeError: JAX traces a loop.

    Source: sec. VIII of Hulin, Preusche, Hirzinger (2008) for ranges of hands; lemmas B11, B13 and
    B17 of docs/proofs.md.

    Example:
        >>> arm = jaxstab.Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
        >>> free = jaxstab.Device.mass_spring_damper(mass=0.25, damping=0.1)
        >>> loops = [
        ...     jaxstab.HapticLoop(device=device, sample_time=1e-3, delay=1e-3)
        ...     for device in (free, free.held_by(arm.with_grip(stiffness=2000.0, damping=4.0)))
        ... ]
        >>> jaxstab.common_region(loops).status.name
        'PROVED'
    """
    tolerance = checked_number("tolerance", tolerance, 1e-3, 0.1)
    if isinstance(loops, LoopsBetween):
        tried = TriedLoops(loops)
        found = common_outline(tried, tolerance)
        return CommonRegion(tried.loops, *found, between=loops)
    given = tuple(loops)
    if not given:
        raise ValueError("loops is empty; give at least one HapticLoop.")
    regions = [wall_region(loop.in_floats(), TOLERANCE) for loop in given]
    nothing = np.zeros((0, 2))
    if any(region.status == RegionStatus.UNRESOLVED for region in regions):
        return CommonRegion(given, RobustStatus.UNPROVED, nothing, tolerance)
    if any(region.is_empty for region in regions):
        return CommonRegion(given, RobustStatus.EMPTY, nothing, tolerance)
    outer = common_walls([region.main or region.components[0] for region in regions])
    if not len(outer):
        return CommonRegion(given, RobustStatus.EMPTY, nothing, tolerance)
    for times in WIDER:
        outline = pulled_in(outer, times * tolerance)
        if all(_is_proved(loop.in_floats(), outline) for loop in given):
            return CommonRegion(given, RobustStatus.PROVED, outline, times * tolerance)
    return CommonRegion(given, RobustStatus.UNPROVED, nothing, tolerance)


def _is_proved(loop: LoopParameters, outline: Points) -> bool:
    if loop.sampled is not None:
        (proved,) = is_stable_along(
            [loop.sampled], outline, velocity=loop.velocity, position=loop.position
        )
        return bool(proved)
    gamma, delta, delay = loop.slice.values()
    walls = np.stack([loop.alpha(outline[:, 0]), loop.beta(outline[:, 1])], axis=-1)
    hand, ends = ((gamma, gamma), (delta, delta)), (walls, np.roll(walls, -1, axis=0))
    is_free = not len(failures(*ends, *hand, delay, filters=given_filters(**loop.filters)))
    alpha, beta = walls[0]
    one = verdict(alpha, beta, gamma=gamma, delta=delta, delay=delay, **loop.filters)
    return is_free and int(one) == Verdict.STABLE
