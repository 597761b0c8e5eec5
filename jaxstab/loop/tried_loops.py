"""Walls that all loops between two allow: guessed by some of them, and proved for all.

The intersection of the regions of some loops is too large. Where the proof of a wall, or of a
polygon, fails, the loop half way between the two next to it joins, and it is tried again.
"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from jaxstab.loop.common_walls import common_walls, setter_of, stiffest_wall
from jaxstab.loop.region import TOLERANCE, WallRegion, wall_region
from jaxstab.ranges import RobustLimit
from jaxstab.ranges.families import failures, first_roots
from jaxstab.ranges.robust_region import RobustStatus, pulled_in
from jaxstab.region import RegionStatus

if TYPE_CHECKING:
    from jaxstab.loop.between import LoopsBetween
    from jaxstab.loop.loop import HapticLoop

WIDER = (1.0, 2.0, 4.0)  # times the tolerance, by which a polygon is pulled in
_FIRST = (0.0, 0.25, 0.5, 0.75, 1.0)
_CLOSEST = 2.0**-10  # of the way: there is no loop tried between two that are so close
_ATTEMPTS = 24
_AT_ONCE = 3  # loops that are added
_PULLS = (0.01, 0.02, 0.04, 0.08)  # of the limit: the wall that is proved lies so far below

Points = Float64[np.ndarray, "vertex 2"]
Shares = Float64[np.ndarray, " share"]


class TriedLoops:
    """Loops between two that are tried, with the walls that small gains lead to in each."""

    def __init__(self, between: "LoopsBetween") -> None:
        self.between = between
        self.shares: list[float] = []
        self.regions: dict[float, WallRegion] = {}
        for share in _FIRST:
            self._add(share)

    @property
    def is_empty(self) -> bool:
        """Whether one of the loops has no stable wall."""
        return any(region.is_empty for region in self.regions.values())

    @property
    def loops(self) -> "tuple[HapticLoop, ...]":
        """The loops, from the first on."""
        return tuple(self.between.loop(share) for share in self.shares)

    def refine(self, failed: Shares) -> bool:
        """Add loops where a proof failed; return whether there are any."""
        last = len(self.shares) - 1
        numbers = np.clip(np.searchsorted(self.shares, failed, "right"), 1, last)
        numbers, counts = np.unique(numbers, return_counts=True)
        pairs = [
            (self.shares[number - 1], self.shares[number])
            for number in numbers[np.argsort(-counts, kind="stable")]
        ]
        pairs = [(low, high) for low, high in pairs if high - low > _CLOSEST][:_AT_ONCE]
        for low, high in pairs:
            self._add(0.5 * (low + high))
        return bool(pairs)

    def _add(self, share: float) -> None:
        self.shares = sorted([*self.shares, share])
        region = wall_region(self.between.loop(share), TOLERANCE)
        if region.status != RegionStatus.UNRESOLVED:  # the proof covers this loop, too
            self.regions[share] = region if region.is_empty else region.main or region.components[0]


def robust_limit(between: "LoopsBetween") -> RobustLimit:
    """Return the stiffest wall that all loops between two allow: ``LoopsBetween``."""
    tried, pulls = TriedLoops(between), list(_PULLS)
    found = RobustLimit(np.nan, np.nan, False, np.nan, between.first)
    for _ in range(_ATTEMPTS):
        if not tried.regions or tried.is_empty:
            break
        top = stiffest_wall([*tried.regions.values()])
        if top is None:
            break
        stiffness = top.stiffness - pulls[0] * abs(top.stiffness)
        setter = between.loop(setter_of(tried.regions, top.damping))
        found = RobustLimit(stiffness, top.damping, False, top.stiffness, setter)
        wall = np.array([[stiffness, top.damping]])
        roots = first_roots(between.family, wall)
        if roots is None:
            break
        if np.isinf(roots.low[0]):
            is_stable = bool(between.first.is_stable(*wall[0]))
            return found._replace(is_proved=is_stable)
        if not tried.refine(roots.low):
            pulls.pop(0)
            if not pulls:
                break
    return found


def common_outline(tried: TriedLoops, tolerance: float) -> tuple[RobustStatus, Points, float]:
    """Return a polygon that is proved for all loops between two, and by how much it is pulled in.

    Args:
        tried: the first loops, to which others are added.
        tolerance: by which part of its size it is pulled in at first.
    """
    family, nothing = tried.between.family, np.zeros((0, 2))
    pulls = [times * tolerance for times in WIDER]
    for _ in range(_ATTEMPTS):
        if not tried.regions:
            break
        outer = nothing if tried.is_empty else common_walls([*tried.regions.values()])
        if not len(outer):
            return RobustStatus.EMPTY, nothing, tolerance
        outline = pulled_in(outer, pulls[0])
        roots = first_roots(family, outline)
        failed = None if roots is None else roots.low[np.isfinite(roots.low)]
        if failed is not None and not failed.size:
            failed = failures(family, outline)
        if failed is None:
            break
        if not failed.size:
            return RobustStatus.PROVED, outline, pulls[0]
        if not tried.refine(failed):
            pulls.pop(0)
            if not pulls:
                break
    return RobustStatus.UNPROVED, nothing, tolerance
