"""The stable walls of a loop in SI units: its stable region, scaled to N/m and N s/m."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array, Numbers, are_numbers, float_arrays, is_jax
from jaxstab.model import LoopParameters, checked_gain, require_x64
from jaxstab.model.loop import refuse_arrays
from jaxstab.numbers import without_noise
from jaxstab.region import RegionStatus, StableRegion, measures
from jaxstab.region.region import loop_region, proved_extremes
from jaxstab.region.stable_set import GainNames, ShownRegion, limits_text, printed_extremes

TOLERANCE = 1e-6  # of the outline, by default
_NAMES = GainNames("K", "B", "N/m", "N s/m")


class Gains(NamedTuple):
    """A wall: stiffness K in N/m and damping B in N s/m.

    Example:
        >>> wall = jaxstab.results.Gains(stiffness=1000.0, damping=10.0)
        >>> wall.damping
        10.0
    """

    stiffness: float
    damping: float


class WallLimits(NamedTuple):
    """The stiffest and the most damped stable wall, in SI units; NaN where no wall is stable.

    Walls have K >= 0 and B >= 0: a hand with stiffness and damping is stable with negative gains as
    well, and the stable set may extend farther there. All four are limits: stable walls come as
    close to them as one likes. They hold for the component that contains small gains. Where small
    gains are not stable, ``is_reachable`` is False and the limits are those of all stable walls.

    Attributes:
        stiffness: the largest stable K in N/m.
        at_damping: the B in N s/m at which it is reached; 0 where the boundary crosses B = 0.
        damping: the largest stable B in N s/m.
        at_stiffness: the K in N/m at which it is reached; 0 where the boundary crosses K = 0.
        status: of the region; if it is UNRESOLVED all four are NaN, though walls may be stable.
        is_reachable: True for walls that are connected to zero gains.
        islands: the limits of each component that is not reached so. An island without walls of
            K >= 0 and B >= 0 has those of all its walls, with a negative gain.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> loop.limits()
        WallLimits: the boundary closes to loops
          stiffest     K = 70643 N/m at B = 82.549 N s/m
          most damped  B = 202 N s/m at K = 0 N/m
          islands      none found
    """

    stiffness: float
    at_damping: float
    damping: float
    at_stiffness: float
    status: RegionStatus
    is_reachable: bool
    islands: tuple["WallLimits", ...] = ()

    def __repr__(self) -> str:
        """Return status, limits and islands in four lines, as a region does."""
        name = type(self).__name__
        if not are_numbers(self):
            return f"{name}{tuple(self)}"
        words = f"{name}: {RegionStatus(int(self.status)).words}"
        if np.isnan(self.stiffness):
            is_negative = self.status == RegionStatus.COMPLETE
            return words + is_negative * "; no wall with K >= 0 and B >= 0 is stable"
        extremes = self[:2], (self.at_stiffness, self.damping)
        islands = [island[:2] for island in self.islands]
        text = limits_text(words, _NAMES, extremes, islands, is_reachable=bool(self.is_reachable))
        return text.rpartition("\n")[0] if self.status == RegionStatus.MEASURED else text


@dataclass(frozen=True, repr=False)
class WallRegion(ShownRegion):
    """The stable walls of a loop: its exact stable region, in N/m and N s/m.

    ``HapticLoop.region`` makes one. Every number is NaN where no wall is stable, and where the
    region is UNRESOLVED. JAX arrays in give JAX arrays out, computed on the host.

    Attributes:
        loop: the loop.
        region: the same set in the (alpha, beta) plane.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> region = loop.region()
        >>> region
        WallRegion (K, B): the boundary closes to loops
          stiffest     K = 70643 N/m at B = 82.549 N s/m
          most damped  B = 202 N s/m at K = 0 N/m
          islands      none found
        >>> region.status.name, region.is_empty, len(region.components), len(region.islands)
        ('COMPLETE', False, 1, 0)
        >>> f"{region.stiffest.stiffness:.1f} N/m, {region.most_damped.damping:.1f} N s/m"
        '70643.1 N/m, 202.0 N s/m'
        >>> round(region.extent.damping, 1), round(region.limits().damping, 1)
        (203.5, 202.0)
        >>> [round(point.stiffness) for point in region.extremes]
        [70643, 0]
        >>> print(f"{region.area:.4g}")
        9.526e+06
        >>> region.outline.max(axis=0).round().tolist(), region.corners.round(1).tolist()
        ([70643.0, 202.0], [[0.0, -1.5], [0.0, 202.0]])
        >>> region.contains(2000.0, [20.0, 300.0]).tolist(), bool(region.main.contains(100.0, 1.0))
        ([True, False], True)
        >>> region.distance(2000.0, [20.0, 300.0]).round(6).tolist()
        [0.02, -0.980116]
        >>> region.stiffness_limits([20.0, 300.0]).round().tolist()
        [[0.0, 35325.0], [nan, nan]]
        >>> region.damping_limits(2000.0).round(3).tolist()
        [-0.508, 200.014]
        >>> region.stiffness_intervals(np.array([20.0])).round().tolist()  # one interval
        [[[0.0, 35325.0]]]
        >>> region.damping_intervals(np.array([2000.0])).round(3).tolist()
        [[[-0.508, 200.014]]]
        >>> region.in_si_units(np.array([0.02, 0.2])).round(6).tolist()
        [2000.0, 20.0]
    """

    loop: LoopParameters
    region: StableRegion

    names = _NAMES

    @property
    def status(self) -> RegionStatus:
        """The status of the region."""
        return self.region.status

    @property
    def is_empty(self) -> bool:
        """True if no wall is stable."""
        return self.region.is_empty

    @cached_property
    def outline(self) -> Float64[np.ndarray, "point 2"]:
        """The outline as points (K, B), counter-clockwise; loop after loop, each of them closed."""
        return self.in_si_units(self.region.points)

    @property
    def corners(self) -> Float64[np.ndarray, "corner 2"]:
        """The points (K, B) where two branches of the boundary meet."""
        return self.in_si_units(self.region.corners)

    @cached_property
    def extent(self) -> Gains:
        """The extent of the region from end to end, in K and in B."""
        if not len(self.outline):
            return Gains(np.nan, np.nan)
        return Gains(*(float(size) for size in np.ptp(self.outline, axis=0)))

    @cached_property
    def stiffest(self) -> Gains:
        """The largest K of walls with B >= 0; NaN where there are none."""
        return self._quadrant[0]

    @cached_property
    def most_damped(self) -> Gains:
        """The largest B of walls with K >= 0; NaN where there are none."""
        return self._quadrant[1]

    @property
    def extremes(self) -> tuple[Gains, Gains]:
        """The stiffest and the most damped wall; if none has K >= 0 and B >= 0, of all walls."""
        if not np.isnan(self.stiffest.stiffness):
            return self._quadrant
        return self._gains(self.region.max_alpha), self._gains(self.region.max_beta)

    @cached_property
    def _quadrant(self) -> tuple[Gains, Gains]:
        stiffest, damped = proved_extremes(self.region)
        return self._gains(stiffest), self._gains(damped)

    @property
    def area(self) -> float:
        """The area in N/m times N s/m, without holes."""
        return float(self.region.area) * self.loop.stiffness(1.0) * self.loop.damping(1.0)

    @cached_property
    def components(self) -> list["WallRegion"]:
        """The connected components: the one with small gains, then islands by their area."""
        if self.region.loops <= 1:
            return [self] * self.region.loops
        return [WallRegion(self.loop, component) for component in self.region.components]

    @cached_property
    def main(self) -> "WallRegion | None":
        """The walls connected to zero gains; None where small gains are not stable."""
        return next((each for each in self.components[:1] if each.region.main is not None), None)

    @property
    def islands(self) -> list["WallRegion"]:
        """The components that are not connected to zero gains, the largest first."""
        return self.components[self.main is not None :]

    def limits(self) -> WallLimits:
        """Return the stiffest and the most damped wall, and those of each island."""
        limits = tuple(_limits_of(*island._printed, island.status) for island in self.islands)
        main = self.reachable
        is_there = not np.isnan(main.stiffest.stiffness)
        own = _limits_of(*(main._printed if is_there else main._quadrant), self.status)
        return own._replace(is_reachable=self.main is not None, islands=limits)

    @cached_property
    def _printed(self) -> tuple[Gains, Gains]:
        stiffest, damped = printed_extremes(self)
        return Gains(*stiffest), Gains(*damped)

    def stiffness_limits(self, damping: Numbers) -> Float64[Array, "*grid 2"]:
        """Return the smallest and the largest stable K at dampings B in N s/m.

        NaN where none is stable. Of several intervals the one that reaches farthest is given.
        """
        require_x64(damping)
        rows = self.loop.beta(checked_gain("damping", damping))
        return self._last_interval(rows, self.loop.stiffness, axis=1)

    def damping_limits(self, stiffness: Numbers) -> Float64[Array, "*grid 2"]:
        """Return the smallest and the largest stable B at stiffnesses K in N/m.

        NaN where none is stable. Of several intervals the one that reaches farthest is given.
        """
        require_x64(stiffness)
        columns = self.loop.alpha(checked_gain("stiffness", stiffness))
        return self._last_interval(columns, self.loop.damping, axis=0)

    def stiffness_intervals(
        self, damping: Float64[np.ndarray, " row"]
    ) -> Float64[np.ndarray, "row interval 2"]:
        """Return all intervals of stable K at dampings B in N s/m, ascending, then NaN."""
        rows = self.loop.beta(np.asarray(checked_gain("damping", damping)))
        return self._intervals(rows, self.loop.stiffness, axis=1)

    def damping_intervals(
        self, stiffness: Float64[np.ndarray, " row"]
    ) -> Float64[np.ndarray, "row interval 2"]:
        """Return all intervals of stable B at stiffnesses K in N/m, ascending, then NaN."""
        columns = self.loop.alpha(np.asarray(checked_gain("stiffness", stiffness)))
        return self._intervals(columns, self.loop.damping, axis=0)

    def contains(self, stiffness: Numbers, damping: Numbers) -> Bool[Array, "*grid"]:
        """True where walls (K, B) lie inside the exact boundary; all False if UNRESOLVED."""
        return self.region.contains(*scaled(self.loop, stiffness, damping))

    def distance(self, stiffness: Numbers, damping: Numbers) -> Float64[Array, "*grid"]:
        """Return the Euclidean distance of walls to the boundary in units of alpha and beta.

        It is positive inside and negative outside, -inf for an empty region.
        """
        return self.region.distance(*scaled(self.loop, stiffness, damping))

    def in_si_units(self, points: Float64[np.ndarray, "*grid 2"]) -> Float64[np.ndarray, "*grid 2"]:
        """Return points (alpha, beta) as (K, B)."""
        return points * np.array([self.loop.stiffness(1.0), self.loop.damping(1.0)])

    def _gains(self, point: Float64[np.ndarray, "2"]) -> Gains:
        exact = self.in_si_units(point)
        return Gains(
            *(float(without_noise(*pair)) for pair in zip(exact, self.extent, strict=True))
        )

    def _intervals_at(self, value: float, axis: int) -> np.ndarray:
        intervals = self.stiffness_intervals if axis == 1 else self.damping_intervals
        return intervals(np.array([value]))[0]

    def _intervals(
        self, values: Float64[np.ndarray, " row"], in_units: Callable[[Any], Any], axis: int
    ) -> np.ndarray:
        region = self.region
        ends = measures.interval_ends(region.curve, region.outline, values, axis=axis)
        count = ends.shape[1] // 2  # lines that meet nothing have one column of NaN
        intervals = in_units(ends[:, : 2 * count].reshape(len(values), count, 2))
        return without_noise(intervals, self.extent[1 - axis])

    def _last_interval(self, gains: Numbers, in_units: Callable[[Any], Any], axis: int) -> Array:
        region, (values,) = self.region, float_arrays(gains)
        boundary = region.curve, region.outline
        limits = in_units(measures.limits(*boundary, values, axis=axis, outermost=False))
        return limits if is_jax(limits) else without_noise(limits, self.extent[1 - axis])


def scaled(loop: LoopParameters, stiffness: Numbers, damping: Numbers) -> tuple[Array, Array]:
    """Return walls (K, B) of a loop, checked, as alpha and beta."""
    require_x64(stiffness, damping)
    if np.ndim(loop.sample_time) and (loop.velocity or loop.position):
        refuse_arrays(loop)  # windows and cut-offs would be arrays per sample
    alpha = loop.alpha(checked_gain("stiffness", stiffness))
    return alpha, loop.beta(checked_gain("damping", damping))


def _limits_of(stiffest: Gains, damped: Gains, status: RegionStatus) -> WallLimits:
    return WallLimits(*stiffest, damped.damping, damped.stiffness, status, is_reachable=False)


@lru_cache(maxsize=64)
def wall_region(loop: LoopParameters, tolerance: float) -> WallRegion:
    """Return the stable walls of a loop; the most recent ones are remembered."""
    return WallRegion(loop, loop_region(loop, tolerance))
