"""The stable gains of a loop as a region in the units of the gains, and their limits.

Regions are searched where p(z) is monic: the set of stable polynomials of one degree with the
leading coefficient 1 is bounded, and so is what two gains can reach of it. Where the gains move the
leading coefficient, other coordinates do not (``model.affine``): an admittance has its region in
the coordinates 1/M and D/M. Its least mass and damping are looked up in that outline, to its
tolerance; where the row of gains through such a point has a proved end, that is taken.

A limit is an end of an open set: rounded to few digits it may be unstable. So limits are made with
the text of a pair that is proved stable (``printed_limit``), and all that show them show that pair.
"""

from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR
from functools import cached_property, lru_cache, partial
from math import isfinite, isinf, nan
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Self, TypeVar

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array, Numbers, are_numbers, float_arrays, is_jax, namespace
from jaxstab.drawing import Floats, cover_beyond, with_gaps
from jaxstab.exact.boundary import ScaledLoop
from jaxstab.exact.line import StableLine
from jaxstab.loop.gains import TwoGains, by_gain
from jaxstab.model import checked_gain, require_x64
from jaxstab.model.device.parts import FIRST_BITS, working_precision
from jaxstab.model.gain import WALL, Gain
from jaxstab.numbers import without_noise
from jaxstab.region import RegionStatus, StableRegion, measures
from jaxstab.region.pieces import NO_BRANCH
from jaxstab.region.region import proved_extremes, region_of
from jaxstab.region.stable_set import DIGITS, ShownRegion, limits_text
from jaxstab.shown import (
    Printed,
    exact_text,
    number_text,
    stable_pair,
    text_with_bound,
)
from jaxstab.tuning import TuningStatus

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TOLERANCE = 1e-6  # of the outline, by default
Number = TypeVar("Number")  # a float, or an array of many


class Gains(NamedTuple):
    """A wall: stiffness K in N/m and damping B in N s/m.

    Example:
        >>> wall = jaxstab.results.Gains(stiffness=1000.0, damping=10.0)
        >>> wall.damping
        10.0
    """

    stiffness: float
    damping: float


@lru_cache
def _point(names: tuple[str, ...]) -> Any:
    """The class of two coordinates by their names."""
    return Gains if names == Gains._fields else namedtuple("Gains", names, rename=True)


class Limits(NamedTuple, Generic[Number]):
    """The limits of two gains, those of a loop or arrays of many; NaN where no gains are stable.

    Gains are >= 0: a hand with stiffness and damping is stable with a negative K or B as well, and
    the stable set may extend farther there. All four are limits: stable gains come as close to them
    as one likes; infinite where there is none. They hold for the component that contains small
    gains. Where small gains are not stable, ``is_reachable`` is False and the limits are those of
    all stable gains. A pair is printed with digits with which it is proved stable, next to a corner
    a little inside of it. Each has a name of the gains, too: ``stiffness`` and ``at_damping`` of a
    wall, ``kp`` and ``at_kd`` of PD control.

    Attributes:
        first: the largest stable first gain, or the least, as of an admittance.
        at_second: the second gain at which it is reached.
        second, at_first: the same of the second gain.
        status: of the region; if it is UNRESOLVED all four are NaN, though gains may be stable.
        is_reachable: True for gains that are connected to zero gains.
        is_single: False for loops that the program of a batch answered.
        islands: the limits of each component that is not reached so. An island without gains >= 0
            has those of all its gains, with a negative one. Many loops have none.
        names: those of the gains, and their units.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> loop.limits()
        Limits: the boundary closes to loops
          stiffest     K = 70643 N/m at B = 82.549 N s/m
          most damped  B = 202 N s/m at K = 0 N/m
          islands      none found
        >>> limits = loop.limits()
        >>> limits.stiffness == limits.first, limits.at_damping == limits.at_second
        (True, True)
        >>> limits.damping == limits.second, limits.at_stiffness
        (True, 0.0)
        >>> jaxstab.simulated_pd(0.1, step=2e-3, substeps=4).limits()
        Limits: the boundary closes to loops
          largest  kp = 6249.9 N m/rad at kd = 18.75 N m s/rad
          largest  kd = 24.999 N m s/rad at kp = 0.125 N m/rad
          islands  none found
        >>> loops = [jaxstab.simulated_pd(0.1, step=step) for step in (1e-3, 2e-3)]
        >>> jaxstab.limits_of(loops).kp.round().tolist()
        [400000.0, 100000.0]
    """

    first: Number
    at_second: Number
    second: Number
    at_first: Number
    status: Any  # RegionStatus, or codes of many
    is_reachable: Any  # bool, or many
    is_single: Any = True
    islands: tuple["Limits[float]", ...] = ()
    names: tuple[Gain, Gain] = WALL

    @property
    def stiffness(self) -> Number:
        """The limit of the stiffness, of loops with that gain."""
        return self._of("stiffness")

    @property
    def at_damping(self) -> Number:
        """The damping at the limit of the other gain."""
        return self._of("at_damping")

    @property
    def damping(self) -> Number:
        """The limit of the damping, of loops with that gain."""
        return self._of("damping")

    @property
    def at_stiffness(self) -> Number:
        """The stiffness at the limit of the damping."""
        return self._of("at_stiffness")

    def __getattr__(self, name: str) -> Any:
        """The limit of a gain, or the gain at a limit, by its name."""
        return self._of(name)

    def _of(self, name: str) -> Any:
        one, two = (gain.name for gain in self.names)
        values = one, f"at_{two}", two, f"at_{one}"
        return by_gain(self, name, dict(zip(values, self[:4], strict=True)))

    def __repr__(self) -> str:
        """Return status, limits and islands in four lines, as a region does."""
        if not are_numbers(self[:6]) or np.ndim(self.status):
            return f"Limits{tuple(self)}"
        words = f"Limits: {RegionStatus(int(self.status)).words}"
        if np.isnan(self.first):
            names = " and ".join(f"{own.symbol or own.name} >= 0" for own in self.names)
            is_negative = self.status == RegionStatus.COMPLETE
            return words + is_negative * f"; no gains with {names} are stable"
        limits: Any = self[:4]
        numbers = (x if isinstance(x, float) else float(x) for x in limits)  # of JAX, too
        first, at_second, second, at_first = numbers
        points = (first, at_second), (at_first, second)
        islands = [island[:2] for island in self.islands]
        is_reachable = bool(self.is_reachable)
        return limits_text(words, self.names, points, islands, is_reachable=is_reachable)


class Tuned(NamedTuple):
    """The best gains, and what exactly these achieve; by their names, too.

    ``radius`` is the spectral radius of exactly these gains, proved to within ``radius_error``; the
    settling time in s is NaN where it was not asked for. ``chatter`` is how far an encoder can
    drive the position, in m, proved, if one is given.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> best = loop.tune("radius")
        >>> print(f"K = {best.stiffness:.0f} N/m, B = {best.damping:.1f} N s/m, {best.status.name}")
        K = 7297 N/m, B = 40.1 N s/m, TRIPLE_ROOT
        >>> best = jaxstab.simulated_pd(0.1, step=2e-3).tune()
        >>> {name: round(gain, -1) for name, gain in best.gains.items()}, best.radius < 1e-3
        ({'kp': 25000.0, 'kd': 50.0}, True)
    """

    first: float
    second: float
    radius: float
    radius_error: float
    status: TuningStatus
    settling_time: float = nan
    chatter: float = nan
    names: tuple[Gain, Gain] = WALL

    @property
    def gains(self) -> dict[str, float]:
        """The gains by their names, as a loop takes them."""
        return {gain.name: value for gain, value in zip(self.names, self[:2], strict=True)}

    def __getattr__(self, name: str) -> float:
        """A gain by its name."""
        value: float = by_gain(self, name, self.gains)
        return value

    def __repr__(self) -> str:
        texts = []
        for gain, value in zip(self.names, self[:2], strict=True):
            unit = f" {gain.unit}" if gain.unit and isfinite(value) else ""
            texts.append(f"{gain.symbol or gain.name} = {exact_text(value)}{unit}")
        pair = " at ".join(texts)
        lines = [f"Tuned: {pair} ({self.status.words})"]
        if self.status != TuningStatus.ENDLESS:
            lines.append(f"spectral radius  {text_with_bound(self.radius, self.radius_error)}")
        if not np.isnan(self.settling_time):
            lines.append(f"settling time    {number_text(self.settling_time, 6, unit='s')}")
        if not np.isnan(self.chatter):
            chatter = number_text(self.chatter, 3, ROUND_CEILING, "m")
            lines.append(f"encoder chatter  {chatter}")
        return "\n  ".join(lines)


@dataclass(frozen=True, repr=False)
class Region(ShownRegion):
    """The stable gains of a loop: its exact stable region, in coordinates in which it is bounded.

    Those of a wall are K in N/m and B in N s/m. Every number is NaN where no gains are stable, and
    where the region is UNRESOLVED. JAX arrays in give JAX arrays out, computed on the host.

    Attributes:
        loop: the loop.
        region: the same set in dimensionless numbers.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> region = loop.region()
        >>> region
        Region (K, B): the boundary closes to loops
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
        >>> region = jaxstab.simulated_pd(0.1, step=2e-3).region()
        >>> region.status.name, region.contains(kp=[1000.0, 1e5], kd=50.0).tolist()
        ('COMPLETE', [True, False])
        >>> region.outline.max(axis=0).round(3).tolist(), [gain.label for gain in region.names]
        ([100000.0, 100.0], ['kp (N m/rad)', 'kd (N m s/rad)'])
        >>> region.area, region.extent.kp, len(region.corners), region.units
        (5000000.0, 100000.0, 3, (32768.0, 32.0))
        >>> f"{region.distance(kp=1000.0, kd=50.0):.4f}"
        '0.0305'
        >>> region.limits_at(kd=[50.0]).round(6).tolist()
        [[0.0, 50000.0]]
        >>> region.intervals_at(kd=np.array([50.0])).round(6).tolist()
        [[[0.0, 50000.0]]]
    """

    loop: TwoGains
    region: StableRegion

    @property
    def names(self) -> tuple[Gain, Gain]:
        """The names and units of the coordinates."""
        return self.loop.coordinates

    @property
    def units(self) -> tuple[float, float]:
        """The size of 1 of the dimensionless numbers, in the coordinates."""
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
    def _drawn(self) -> Floats:
        """The outline with NaN between two loops."""
        return with_gaps(self.outline, self.region.branch)

    def _write_axes(self, panel: "Axes") -> None:
        """Name the coordinates, and cover those beyond infinite gains, or a gain of 0."""
        chart = self.loop._chart
        ends = "infinite gains", *(f"{gain.name} = 0" for gain in self.loop.gains)
        cover_beyond(panel, chart.shares, ends[chart.pivot])
        first, second = (f"{gain.name} " * bool(gain.symbol) + gain.label for gain in self.names)
        panel.set(xlabel=first, ylabel=second)

    @property
    def corners(self) -> Float64[np.ndarray, "corner 2"]:
        """The points where two branches of the boundary meet."""
        return self.in_si_units(self.region.corners)

    @property
    def area(self) -> float:
        """The area in the units of the coordinates, without holes."""
        return float(self.region.area) * self.units[0] * self.units[1]

    @cached_property
    def components(self) -> list[Self]:
        """The connected components: the one with small gains, then islands by their area."""
        if self.region.loops <= 1:
            return [self] * self.region.loops
        return [type(self)(self.loop, component) for component in self.region.components]

    @property
    def main(self) -> Self | None:
        """The gains that are reached from small ones; None where small gains are not stable."""
        return next((each for each in self.components[:1] if each.region.main is not None), None)

    @property
    def islands(self) -> list[Self]:
        """All other components, the largest first."""
        return self.components[self.main is not None :]

    @cached_property
    def extent(self) -> Any:
        """The extent of the region from end to end, along each coordinate."""
        points = self.outline if len(self.outline) else np.full((1, 2), nan)
        return self._named(*np.ptp(points, axis=0).tolist())

    @cached_property
    def _in_quadrant(self) -> tuple[Any, Any]:
        first, second = proved_extremes(self.region)
        return self._extreme(first, 0), self._extreme(second, 1)

    @property
    def stiffest(self) -> Any:
        """The point of the largest first coordinate, both >= 0; NaN where there is none."""
        return self._in_quadrant[0]

    @property
    def most_damped(self) -> Any:
        """The point of the largest second coordinate, both >= 0; NaN where there is none."""
        return self._in_quadrant[1]

    @property
    def extremes(self) -> tuple[Any, Any]:
        """The points of the largest coordinates, both >= 0; if there are none, of all points."""
        if not np.isnan(self.stiffest[0]):
            return self._in_quadrant
        return self._extreme(self.region.max_alpha, 0), self._extreme(self.region.max_beta, 1)

    def limits(self) -> Limits[float]:
        """The limits of both gains, and those of each island."""
        main = self.reachable
        return main._limits(is_there=not np.isnan(main.stiffest[0]))._replace(
            status=self.status,
            is_reachable=self.main is not None,
            islands=tuple(island._limits(is_there=True) for island in self.islands),
        )

    def _limits(self, *, is_there: bool) -> Limits[float]:
        loop, points = self.loop, self.limit_points
        if not loop._chart.are_gains:
            points = _printed(loop, points)
        elif is_there:
            points = self._printed
        (one, at_two), (at_one, two) = points
        return Limits(one, at_two, two, at_one, self.status, is_reachable=False, names=loop.gains)

    @cached_property
    def limit_points(self) -> tuple[Any, Any]:
        """The gains at the limits of the first and of the second one, both >= 0; NaN without.

        Example:
            >>> region = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4).region()
            >>> [point.round(4).tolist() for point in region.limit_points]  # least mass, damping
            [[0.0159, 26.7009], [0.0159, 26.7009]]
        """
        return self._in_quadrant if self.loop._chart.are_gains else self._in_rows()

    @cached_property
    def _printed(self) -> tuple[Any, Any]:
        return _printed(self.loop._charted, self.extremes)

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

    def limits_at(self, **gain: Numbers) -> Float64[Array, "*grid 2"]:
        """The smallest and the largest stable value of a coordinate at values of the other one.

        NaN where none is stable. Of several intervals the one that reaches farthest is given.
        """
        axis, given = self._coordinate(gain)
        boundary, (values,) = (self.region.curve, self.region.outline), float_arrays(given)
        values = self._in_units(values, axis)
        limits = measures.limits(*boundary, values, axis=axis, outermost=False)
        limits = self.units[1 - axis] * limits
        return limits if is_jax(limits) else self._told(np.asarray(given), limits, axis)

    def intervals_at(
        self, **gain: Float64[np.ndarray, " row"]
    ) -> Float64[np.ndarray, "row interval 2"]:
        """All intervals of a coordinate at values of the other one, ascending, then NaN."""
        axis, given = self._coordinate(gain)
        values = self._in_units(given, axis)
        ends = measures.interval_ends(self.region.curve, self.region.outline, values, axis=axis)
        count = ends.shape[1] // 2  # lines that meet nothing have one column of NaN
        intervals = self.units[1 - axis] * ends[:, : 2 * count].reshape(len(values), count, 2)
        return self._told(given[:, None], intervals, axis)

    def stiffness_limits(self, damping: Numbers) -> Float64[Array, "*grid 2"]:
        """The smallest and the largest stable K at dampings B in N s/m: ``limits_at``."""
        return self.limits_at(damping=damping)

    def damping_limits(self, stiffness: Numbers) -> Float64[Array, "*grid 2"]:
        """The smallest and the largest stable B at stiffnesses K in N/m, likewise."""
        return self.limits_at(stiffness=stiffness)

    def stiffness_intervals(
        self, damping: Float64[np.ndarray, " row"]
    ) -> Float64[np.ndarray, "row interval 2"]:
        """All intervals of stable K at dampings B in N s/m: ``intervals_at``."""
        return self.intervals_at(damping=damping)

    def damping_intervals(
        self, stiffness: Float64[np.ndarray, " row"]
    ) -> Float64[np.ndarray, "row interval 2"]:
        """All intervals of stable B at stiffnesses K in N/m, likewise."""
        return self.intervals_at(stiffness=stiffness)

    def in_si_units(self, points: Float64[np.ndarray, "*grid 2"]) -> Float64[np.ndarray, "*grid 2"]:
        """Points of dimensionless numbers in the coordinates, such as (K, B)."""
        return points * np.array(self.units)

    def _coordinate(self, gain: dict[str, Any]) -> tuple[int, Any]:
        """The axis of the one coordinate that is given, and its values, checked."""
        names = [own.name for own in self.names]
        if len(gain) != 1 or not set(gain) <= set(names):
            given = ", ".join(gain) or "none"
            raise TypeError(f"coordinates given: {given}; give one of {names[0]} and {names[1]}.")
        ((name, value),) = gain.items()
        require_x64(value)
        return names.index(name), checked_gain(name, value)

    def _in_units(self, values: Array, axis: int) -> Array:
        pair: list[Any] = [0.0, 0.0]
        pair[axis] = values
        return self.loop._charted._in_units(*pair)[axis]

    def _own(self, wall: tuple[Any, ...], gains: dict[str, Any]) -> tuple[Any, tuple[Any, Any]]:
        """Gains in the units of the region; first where these have a place there."""
        first, second = self.loop._in_units(*self.loop._named(wall, gains).values())
        xp = namespace(first, second)
        is_known = xp.isfinite(first) & xp.isfinite(second)
        return is_known, (xp.where(is_known, first, 0.0), xp.where(is_known, second, 0.0))

    def _named(self, *point: float) -> Any:
        return _point(tuple(own.name for own in self.names))(*point)

    def _extreme(self, point: Float64[np.ndarray, "2"], axis: int) -> Any:
        gains = np.array(self.in_si_units(point))
        other = 1 - axis  # what is largest is proved to the digit
        gains[other] = without_noise(gains[other], self.extent[other])
        return self._named(*gains.tolist())

    def _told(self, gains: np.ndarray, intervals: np.ndarray, axis: int) -> np.ndarray:
        """Intervals of lines, those that the outline does not tell from 0 or a point by proof."""
        extent, loop = self.extent[1 - axis], self.loop._charted
        told, widths = (
            without_noise(intervals, extent),
            without_noise(np.ptp(intervals, -1), extent),
        )
        doubted = (widths == 0.0) | np.any((told == 0.0) & (intervals != 0.0), axis=-1)
        known = np.broadcast_to(gains, doubted.shape)
        for place in map(tuple, np.argwhere(doubted)):
            line = loop._row(self.names[axis].name, float(known[place]))
            own, middle = intervals[place], np.mean(intervals[place])
            proved = [[low.told, high.told] for low, high in line.intervals]
            beside = [ends for ends in proved if ends[0] <= middle <= ends[1]]
            if isinf(line.horizon):  # else nothing is proved
                nearest = np.array(beside[0] if beside else [nan, nan])
                is_same = without_noise(nearest - own, extent) == 0.0
                told[place] = np.where(is_same | np.isnan(nearest), nearest, told[place])
        return told

    def _in_rows(self) -> tuple[Float64[np.ndarray, "2"], Float64[np.ndarray, "2"]]:
        """The extreme gains >= 0 of an outline in other coordinates, as ends of proved rows.

        1/l, a/l and b/l are >= 0 in a triangle. Linear fractions as a and b are the largest and the
        least at vertices of what the outline and the triangle share; infinite where 1/l is 0.
        """
        none, chart = (np.full(2, nan), np.full(2, nan)), self.loop._chart
        if not self.components:
            return none
        here = np.stack(chart.whole(*self.outline.T), axis=-1)
        ahead, is_edge = here[1:], self.region.branch != NO_BRANCH
        with np.errstate(all="ignore"):  # 0/0 along the sides, and at the corners of infinite gains
            share = here[:-1] / (here[:-1] - ahead)
            crossed = here[:-1, None] + share[..., None] * (ahead - here[:-1])[:, None]
            crossed = crossed[(share > 0.0) & (share < 1.0) & is_edge[:, None]]
            weights = np.array(chart.weights)
            corners = np.diag(1.0 / weights)[weights > 0.0]
            places = np.delete(corners, chart.by, axis=1) / self.units
            corners = corners[self.region.contains(*places.T)]
            whole = np.concatenate([here, crossed, corners])
            whole[np.abs(whole) < 1e-9 * np.abs(whole).max(axis=0)] = 0.0
            gains = whole[:, 1:] / whole[:, :1]
        is_here = np.all(whole >= 0.0, axis=1)
        if not np.all(whole[is_here].max(axis=0, initial=0.0) > 0.0):  # it touches an axis at most
            return none
        return self._best(0, gains[is_here]), self._best(1, gains[is_here])

    def _best(self, axis: int, gains: Float64[np.ndarray, "point 2"]) -> Float64[np.ndarray, "2"]:
        """Of some gains those of the largest or least one; finite ones are the end of a row."""
        is_least = self.loop.gains[axis].sense == "least"
        gains = gains[~np.isnan(gains[:, axis])]
        if not gains.size:
            return np.full(2, nan)
        best = gains[(np.argmin if is_least else np.argmax)(gains[:, axis])].copy()
        if np.all(np.isfinite(best)):
            row = self.loop._row(self.loop.gains[1 - axis].name, float(best[1 - axis]))
            ends = [pair[0 if is_least else 1] for pair in row.intervals]
            values = [end.value if end.value > end.error else 0.0 for end in ends]
            near = min(values, key=lambda value: abs(value - best[axis]), default=np.inf)
            if abs(near - best[axis]) <= 1e-4 * best[axis]:  # at a corner the row may miss it
                best[axis] = near
        return best


@lru_cache(maxsize=64)
def region_of_loop(loop: TwoGains, tolerance: float) -> Region:
    """The stable gains of a loop; the most recent ones are remembered."""
    return Region(loop, region_of(ScaledLoop(loop._source, loop._scale), tolerance))


# Limits as they are printed: a pair that is stable.

ABOVE_0 = "above 0"  # a least value that is not stable itself
Pair = tuple[float, float]


def _printed(loop: TwoGains, points: Any) -> tuple[Pair, Pair]:
    """The points of the limits of two gains, as pairs that are stable."""
    (one, at_two), (at_one, two) = np.array(points).tolist()
    first = printed_limit(loop, 0, one, at_two) or (one, at_two)
    second = printed_limit(loop, 1, two, at_one) or (two, at_one)
    return first, second[::-1]


def printed_limit(
    loop: TwoGains,
    axis: int,
    value: float,
    at: float,
    digits: tuple[int, int] = (DIGITS, DIGITS),
    *,
    is_stable: Callable[[float, float], bool] | None = None,
    beside: Callable[[float, float], float] | None = None,
    is_limit: bool = True,
) -> tuple[Printed, Printed] | None:
    """A limit of a gain, and the other gain there, to be printed as a pair that is stable.

    Where rounding to digits finds none, as at a corner, the pair is a little inside of the limit,
    with another gain ``beside`` it. None where that finds none either.

    Args:
        loop: of two gains.
        axis: 0 for the first one of the gains.
        value: the limit; or, not ``is_limit``, a value inside of it.
        at: the other gain there.
        digits: of both.
        is_stable: judges a value and the other gain; None for the loop's own verdicts.
        beside: the other gain at a value, if the given one does not do; None for that of the loop.
        is_limit: False to look for the other gain at once.
    """
    own, other = loop.gains[axis], loop.gains[1 - axis]
    is_largest = own.sense == "largest"
    way, inwards = (ROUND_FLOOR, -1.0) if is_largest else (ROUND_CEILING, 1.0)
    beside = beside or partial(other_gain, loop, axis)

    def allows(value: float, at: float) -> bool:
        return loop._is_stable(*((at, value) if axis else (value, at)))

    def row(at: float) -> list[Pair]:  # of which the upper ends are tried
        inner = loop._row(other.name, at).inner if is_largest else ()
        below = ((low, min(high, value)) for low, high in inner)
        return [(low, high) for low, high in below if abs(value - high) < 0.01 * abs(value)]

    is_stable = is_stable or allows
    for share in (0.0, 1e-5, 2e-4, 1e-2, 0.1) if isfinite(value) else ():
        if 0.0 < share < 0.5 * 10.0 ** -digits[0]:  # which the digits do not show
            continue
        inside = value + inwards * share * abs(value)
        near = at if share == 0.0 and is_limit else beside(inside, at)
        pair = stable_pair(inside, near, digits, is_stable, row, way)
        if isinstance(pair[0], Printed) and isinstance(pair[1], Printed):
            return Printed(value, pair[0].text), Printed(at, pair[1].text)
    if value == 0.0 and not is_largest:
        return Printed(0.0, ABOVE_0), Printed(at, number_text(at, digits[1]))
    return None


def other_gain(loop: TwoGains, axis: int, value: float, at: float) -> float:
    """The other gain at a value of one: a given one, or one inside of the nearest stable ones."""
    line = loop._row(loop.gains[axis].name, value)
    if not line.intervals or line.holding(at):
        return at
    nearest = min(line.intervals, key=lambda ends: max(ends[0].value - at, at - ends[1].value))
    low, high = (max(end.value, 0.0) for end in nearest)
    return 0.5 * (low + min(high, 3.0 * low + 1.0))


# One row of walls, without a region.


def reached_interval(loop: Any, gain: str, value: float) -> Float64[np.ndarray, "2"] | None:
    """The stable interval at a stiffness or a damping, if it is the only one on that line.

    Small gains must reach it: along walls next to K = 0, then along a row. NaN if no wall of the
    line is stable. None, for the region to answer, where there are several intervals, or where
    these walls are not all stable.
    """
    line = loop._row(gain, value)
    is_known = isinf(line.horizon)  # 0 where nothing is proved
    if not is_known or len(line.intervals) > 1 or not _pushes_back(loop):
        return None
    if not line.intervals:
        return np.full(2, np.nan)
    ends = [end.told for end in line.intervals[0]]
    wall = {"stiffness": 0.0, "damping": sum(ends) / 2.0} | {gain: value}
    row = line if gain == "damping" else loop._row("damping", wall["damping"])
    steps = (row, wall["stiffness"]), (_without_stiffness(loop), wall["damping"])
    return np.array(ends) if all(_goes_to(*step) for step in steps) else None


def _pushes_back(loop: Any) -> bool:
    """True if a wall pushes at rest: P(1) and G(0) are not 0."""
    with working_precision(FIRST_BITS):
        return not loop._triple().stiffness.at_one


@lru_cache(maxsize=64)
def _without_stiffness(loop: Any) -> StableLine:
    return loop._row("stiffness", 0.0)


def _goes_to(line: StableLine, value: float) -> bool:
    """True if all walls of a line from 0 on to a value are stable; without K a root may stay at 1.

    That root is on one side of 1 in all of an interval as soon as there is a stiffness.
    """
    return any(
        low.value <= min(value, 0.0) and max(value, 0.0) < high.value - high.error
        for low, high in line.intervals
    )
