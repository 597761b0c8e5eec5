"""The stable gains of a loop, walls among them: its stable region, in the units of the gains."""

from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR
from functools import cached_property, lru_cache
from math import isfinite, isinf
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array, Numbers, are_numbers, float_arrays, is_jax, namespace
from jaxstab.conventions import Verdict
from jaxstab.exact.line import StableLine
from jaxstab.loop.gains import Gain
from jaxstab.model import checked_gain, require_x64
from jaxstab.model.device.parts import FIRST_BITS, working_precision
from jaxstab.numbers import without_noise
from jaxstab.region import RegionStatus, StableRegion, measures
from jaxstab.region.region import loop_region, proved_extremes
from jaxstab.region.stable_set import GainNames, ShownRegion, limits_text, printed_extremes
from jaxstab.shown import Printed, stable_pair

TOLERANCE = 1e-6  # of the outline, by default
Part = TypeVar("Part", bound="GainRegion")

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
        return limits_text(words, _NAMES, extremes, islands, is_reachable=bool(self.is_reachable))


@dataclass(frozen=True, repr=False)
class GainRegion(ShownRegion):
    """The stable gains of a loop, in coordinates in which they are bounded.

    Attributes:
        loop: the loop.
        region: the same set in dimensionless numbers.

    Example:
        >>> region = jaxstab.simulated_pd(0.1, step=2e-3).region()
        >>> region.status.name, region.contains(kp=[1000.0, 1e5], kd=50.0).tolist()
        ('COMPLETE', [True, False])
        >>> region.outline.max(axis=0).round(3).tolist(), len(region.components)
        ([100000.0, 100.0], 1)
        >>> region.is_empty, region.main is None, region.islands, region.names.labels
        (False, False, [], ('kp (N m/rad)', 'kd (N m s/rad)'))
        >>> [point.round(3).tolist() for point in region.extremes]
        [[100000.0, 0.0], [0.0, 100.0]]
        >>> region.area, region.extent.round(3).tolist(), len(region.corners)
        (5000000.0, [100000.0, 100.0], 3)
        >>> region.in_si_units(np.array([1.0, 2.0])).tolist()
        [32768.0, 64.0]
        >>> f"{region.distance(kp=1000.0, kd=50.0):.4f}"
        '0.0305'
    """

    loop: Any  # TwoGains
    region: StableRegion

    @property
    def names(self) -> GainNames:  # type: ignore[override]
        """The names and units of the coordinates."""
        return names_of(self.loop.coordinates)

    @property
    def units(self) -> tuple[float, float]:
        """The size of 1 of the dimensionless numbers, in the coordinates.

        Example:
            >>> jaxstab.simulated_pd(0.1, step=2e-3).region().units
            (32768.0, 32.0)
        """
        return self.loop._scale

    @property
    def status(self) -> RegionStatus:
        """The status of the region."""
        return self.region.status

    @property
    def is_empty(self) -> bool:
        """True if no gains are stable."""
        return self.region.is_empty

    @cached_property
    def outline(self) -> Float64[np.ndarray, "point 2"]:
        """The outline, loop after loop, each of them closed, counter-clockwise."""
        return self.in_si_units(self.region.points)

    @property
    def corners(self) -> Float64[np.ndarray, "corner 2"]:
        """The points where two branches of the boundary meet."""
        return self.in_si_units(self.region.corners)

    @property
    def area(self) -> float:
        """The area in the units of the coordinates, without holes."""
        return float(self.region.area) * self.units[0] * self.units[1]

    @cached_property
    def components(self: Part) -> list[Part]:
        """The connected components: the one with small gains, then islands by their area."""
        if self.region.loops <= 1:
            return [self] * self.region.loops
        return [type(self)(self.loop, component) for component in self.region.components]

    @property
    def main(self: Part) -> Part | None:
        """The gains that are reached from small ones; None where small gains are not stable."""
        return next((each for each in self.components[:1] if each.region.main is not None), None)

    @property
    def islands(self: Part) -> list[Part]:
        """All other components, the largest first."""
        return self.components[self.main is not None :]

    @cached_property
    def extent(self) -> Any:
        """The extent of the region from end to end, along each coordinate."""
        return np.ptp(self.outline, axis=0) if len(self.outline) else np.full(2, np.nan)

    @cached_property
    def extremes(self) -> tuple[Any, Any]:
        """The points of the largest first and second coordinate, both >= 0."""
        first, second = proved_extremes(self.region)
        return self._extreme(first, 0), self._extreme(second, 1)

    def contains(self, *wall: Numbers, **gains: Numbers) -> Bool[Array, "*grid"]:
        """True where gains lie inside the exact boundary; all False if UNRESOLVED."""
        is_known, own = self._own(wall, gains)
        return self.region.contains(*own) & is_known

    def distance(self, *wall: Numbers, **gains: Numbers) -> Float64[Array, "*grid"]:
        """The Euclidean distance of gains to the boundary in dimensionless numbers.

        It is positive inside and negative outside, -inf for an empty region, and where gains take
        the highest power from p(z).
        """
        is_known, own = self._own(wall, gains)
        return namespace(own).where(is_known, self.region.distance(*own), -np.inf)

    def in_si_units(self, points: Float64[np.ndarray, "*grid 2"]) -> Float64[np.ndarray, "*grid 2"]:
        """Points of dimensionless numbers in the coordinates, such as (K, B)."""
        return points * np.array(self.units)

    def _own(self, wall: tuple[Any, ...], gains: dict[str, Any]) -> tuple[Any, tuple[Any, Any]]:
        """Gains in the units of the region; first where these have a place there."""
        first, second = self.loop._in_units(*self.loop._named(wall, gains).values())
        xp = namespace(first, second)
        is_known = xp.isfinite(first) & xp.isfinite(second)
        return is_known, (xp.where(is_known, first, 0.0), xp.where(is_known, second, 0.0))

    def _extreme(self, point: Float64[np.ndarray, "2"], axis: int) -> Any:
        gains = np.array(self.in_si_units(point))
        other = 1 - axis  # what is largest is proved to the digit
        gains[other] = without_noise(gains[other], self.extent[other])
        return gains

    def __repr__(self) -> str:
        """Return status, extremes and the number of islands."""
        if not self.components:
            return f"GainRegion: {self.status.words}"
        names, held = self.names, self.loop._charted
        one, two = (self.main or self.components[0]).extremes
        first = printed_limit(held, 0, one[0], one[1], 5)
        second = printed_limit(held, 1, two[1], two[0], 5)[::-1]
        small = "" if self.main else "; small gains are not stable"
        return "\n".join(
            [
                f"GainRegion ({names.stiffness}, {names.damping}): {self.status.words}{small}",
                f"  largest  {names.at_largest_stiffness(first)}",
                f"  largest  {names.at_largest_damping(second)}",
                f"  islands  {len(self.islands) or 'none found'}",
            ]
        )


@dataclass(frozen=True, repr=False)
class WallRegion(GainRegion):
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

    names = _NAMES
    __repr__ = ShownRegion.__repr__

    @cached_property
    def extent(self) -> Gains:
        """The extent of the region from end to end, in K and in B."""
        return Gains(*super().extent.tolist())

    @property
    def stiffest(self) -> Gains:
        """The largest K of walls with B >= 0; NaN where there are none."""
        return super().extremes[0]

    @property
    def most_damped(self) -> Gains:
        """The largest B of walls with K >= 0; NaN where there are none."""
        return super().extremes[1]

    @property
    def extremes(self) -> tuple[Gains, Gains]:
        """The stiffest and the most damped wall; if none has K >= 0 and B >= 0, of all walls."""
        if not np.isnan(self.stiffest.stiffness):
            return super().extremes
        return self._extreme(self.region.max_alpha, 0), self._extreme(self.region.max_beta, 1)

    def limits(self) -> WallLimits:
        """The stiffest and the most damped wall, and those of each island."""
        limits = tuple(_limits_of(*island._printed, island.status) for island in self.islands)
        main = self.reachable
        is_there = not np.isnan(main.stiffest.stiffness)
        walls = main._printed if is_there else (main.stiffest, main.most_damped)
        own = _limits_of(*walls, self.status)
        return own._replace(is_reachable=self.main is not None, islands=limits)

    @cached_property
    def _printed(self) -> tuple[Gains, Gains]:
        stiffest, damped = printed_extremes(self)
        return Gains(*stiffest), Gains(*damped)

    def stiffness_limits(self, damping: Numbers) -> Float64[Array, "*grid 2"]:
        """The smallest and the largest stable K at dampings B in N s/m.

        NaN where none is stable. Of several intervals the one that reaches farthest is given.
        """
        require_x64(damping)
        return self._last_interval(checked_gain("damping", damping), axis=1)

    def damping_limits(self, stiffness: Numbers) -> Float64[Array, "*grid 2"]:
        """The smallest and the largest stable B at stiffnesses K in N/m, likewise."""
        require_x64(stiffness)
        return self._last_interval(checked_gain("stiffness", stiffness), axis=0)

    def stiffness_intervals(
        self, damping: Float64[np.ndarray, " row"]
    ) -> Float64[np.ndarray, "row interval 2"]:
        """All intervals of stable K at dampings B in N s/m, ascending, then NaN."""
        return self._intervals(checked_gain("damping", damping), axis=1)

    def damping_intervals(
        self, stiffness: Float64[np.ndarray, " row"]
    ) -> Float64[np.ndarray, "row interval 2"]:
        """All intervals of stable B at stiffnesses K in N/m, ascending, then NaN."""
        return self._intervals(checked_gain("stiffness", stiffness), axis=0)

    def _extreme(self, point: Float64[np.ndarray, "2"], axis: int) -> Gains:
        return Gains(*super()._extreme(point, axis).tolist())

    def _is_stable(self, stiffness: float, damping: float) -> bool:
        return bool(self.loop.verdict(stiffness, damping) == Verdict.STABLE)

    def _intervals_at(self, value: float, axis: int) -> np.ndarray:
        intervals = self.stiffness_intervals if axis == 1 else self.damping_intervals
        return intervals(np.array([value]))[0]

    def _intervals(self, gains: Float64[np.ndarray, " row"], *, axis: int) -> np.ndarray:
        region, values = self.region, self._in_units(gains, axis)
        ends = measures.interval_ends(region.curve, region.outline, values, axis=axis)
        count = ends.shape[1] // 2  # lines that meet nothing have one column of NaN
        intervals = self.units[1 - axis] * ends[:, : 2 * count].reshape(len(values), count, 2)
        return self._told(gains[:, None], intervals, axis)

    def _last_interval(self, gains: Numbers, *, axis: int) -> Array:
        boundary, (values,) = (self.region.curve, self.region.outline), float_arrays(gains)
        values = self._in_units(values, axis)
        limits = measures.limits(*boundary, values, axis=axis, outermost=False)
        limits = self.units[1 - axis] * limits
        return limits if is_jax(limits) else self._told(np.asarray(gains), limits, axis)

    def _in_units(self, gains: Array, axis: int) -> Array:
        return self.loop.beta(gains) if axis == 1 else self.loop.alpha(gains)

    def _told(self, gains: np.ndarray, intervals: np.ndarray, axis: int) -> np.ndarray:
        """Intervals of lines, those that the outline does not tell from 0 or a point by proof."""
        extent = self.extent[1 - axis]
        told, widths = (
            without_noise(intervals, extent),
            without_noise(np.ptp(intervals, -1), extent),
        )
        doubted = (widths == 0.0) | np.any((told == 0.0) & (intervals != 0.0), axis=-1)
        known = np.broadcast_to(gains, doubted.shape)
        for place in map(tuple, np.argwhere(doubted)):
            line = self.loop.intervals(**{self.loop.gains[axis].name: float(known[place])})
            own, middle = intervals[place], np.mean(intervals[place])
            proved = [[low.told, high.told] for low, high in line.intervals]
            beside = [ends for ends in proved if ends[0] <= middle <= ends[1]]
            if isinf(line.horizon):  # else nothing is proved
                nearest = np.array(beside[0] if beside else [np.nan, np.nan])
                is_same = without_noise(nearest - own, extent) == 0.0
                told[place] = np.where(is_same | np.isnan(nearest), nearest, told[place])
        return told


def _limits_of(stiffest: Gains, damped: Gains, status: RegionStatus) -> WallLimits:
    return WallLimits(*stiffest, damped.damping, damped.stiffness, status, is_reachable=False)


def printed_limit(
    loop: Any, axis: int, value: float, at: float, digits: int = 6
) -> tuple[float, float]:
    """A limit of a gain, and the other gain there, to be printed as a pair that is stable.

    Where rounding to digits finds none, as at a corner, the pair is that in the middle of a row
    which is a little inside.
    """
    own, other = loop.gains[axis], loop.gains[1 - axis]
    is_largest = own.sense == "largest"
    way, inwards = (ROUND_FLOOR, -1.0) if is_largest else (ROUND_CEILING, 1.0)

    def is_stable(value: float, at: float) -> bool:
        return bool(loop._verdict(*(value, at)[:: 1 - 2 * axis]))

    def row(at: float) -> list[tuple[float, float]]:
        ends = loop.intervals(**{other.name: at}).intervals if is_largest else ()
        below = ((low.value, min(high.value - high.error, value)) for low, high in ends)
        return [(low, high) for low, high in below if abs(value - high) < 0.01 * abs(value)]

    if value == 0.0 and not is_largest and not is_stable(value, at):
        return Printed(0.0, "above 0"), at
    for share in (0.0, 1e-5, 1e-4, 1e-2) if isfinite(value) and isfinite(at) else ():
        inside = value + inwards * share * abs(value)
        beside, line = at, loop.intervals(**{own.name: inside}).intervals if share else ()
        if line:
            nearest = min(line, key=lambda ends: max(ends[0].value - at, at - ends[1].value))
            low, high = (max(end.value, 0.0) for end in nearest)
            beside = 0.5 * (low + min(high, 3.0 * low + 1.0))
        pair = stable_pair(inside, beside, (digits, digits), is_stable, row, way)
        if isinstance(pair[0], Printed) and isinstance(pair[1], Printed):
            return Printed(value, pair[0].text), Printed(at, pair[1].text)
    return value, at


@lru_cache(maxsize=64)
def wall_region(loop: Any, tolerance: float) -> WallRegion:
    """The stable walls of a loop; the most recent ones are remembered."""
    return WallRegion(loop, loop_region(loop, tolerance))


def reached_interval(loop: Any, gain: str, value: float) -> Float64[np.ndarray, "2"] | None:
    """The stable interval at a stiffness or a damping, if it is the only one on that line.

    Small gains must reach it: along walls next to K = 0, then along a row. NaN if no wall of the
    line is stable. None, for the region to answer, where there are several intervals, or where
    these walls are not all stable.
    """
    line = loop.intervals(**{gain: value})
    is_known = isinf(line.horizon)  # 0 where nothing is proved
    if not is_known or len(line.intervals) > 1 or not _pushes_back(loop):
        return None
    if not line.intervals:
        return np.full(2, np.nan)
    ends = [end.told for end in line.intervals[0]]
    wall = {"stiffness": 0.0, "damping": sum(ends) / 2.0} | {gain: value}
    row = line if gain == "damping" else loop.intervals(damping=wall["damping"])
    steps = (row, wall["stiffness"]), (_without_stiffness(loop), wall["damping"])
    return np.array(ends) if all(_goes_to(*step) for step in steps) else None


def _pushes_back(loop: Any) -> bool:
    """True if a wall pushes at rest: P(1) and G(0) are not 0."""
    with working_precision(FIRST_BITS):
        return not loop._triple().stiffness.at_one


@lru_cache(maxsize=64)
def _without_stiffness(loop: Any) -> StableLine:
    return loop.intervals(stiffness=0.0)


def _goes_to(line: StableLine, value: float) -> bool:
    """True if all walls of a line from 0 on to a value are stable; without K a root may stay at 1.

    That root is on one side of 1 in all of an interval as soon as there is a stiffness.
    """
    return any(
        low.value <= min(value, 0.0) and max(value, 0.0) < high.value - high.error
        for low, high in line.intervals
    )


def names_of(gains: tuple[Gain, Gain]) -> GainNames:
    """The names of two gains as those of a plane."""
    first, second = gains
    return GainNames(first.name, second.name, first.unit, second.unit)
