"""One loop whose delay moves from sample to sample: verdicts, margins, limits and sequences.

A wall is STABLE if the small-gain theorem proves it for every sequence of delays of a range (lemma
J1 of docs/proofs.md), and UNSTABLE if one sequence, constant or in turn, is proved to grow (lemma
J2). Between the two it is UNDECIDED.
"""

from dataclasses import dataclass, replace
from decimal import ROUND_FLOOR
from math import inf, isinf, nan
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8

from jaxstab.arrays import Array, Numbers, is_any_traced, named
from jaxstab.conventions import Range, Verdict
from jaxstab.loop.region import TOLERANCE, WallRegion, wall_region
from jaxstab.model import LoopParameters, require_x64
from jaxstab.model.device import SampledDevice, sampled_device
from jaxstab.model.filters import Filters, given_filters
from jaxstab.model.parameters import LONGEST_DELAY, wall_grid
from jaxstab.motion.moving_delays import Delays, Growth, growing_turn
from jaxstab.numbers import checked_number
from jaxstab.point.verdicts import linear_verdict
from jaxstab.proofs.jitter import (
    Walls,
    are_polygons_stable,
    is_stable_for_all,
    largest_jitters,
    stiffest_for_all,
)
from jaxstab.rounding import EPS
from jaxstab.shown import exact_text, number_text, shortened, stable_pair

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CONSTANT = 5  # constant delays of a range that are tried
_GRID, _ZOOMS = 16, 3  # gains tried at once, and how often around the best damping
_PROOFS = 3  # rounds of walls that are proved at the best damping
_COARSE = 9  # of one that is unstable
_COLUMNS, _EVERY = 24, 3  # dampings of a region, and of walls that are proved unstable
_LEAST = 1e-3  # of the stiffest wall: the least stiffness of a region
_PULLS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)  # by which the stiffest walls are lowered


@dataclass(frozen=True, repr=False)
class WorstDelays:
    """Delays in turn under which the motion grows, or decays most slowly: the worst found.

    Attributes:
        delays: one turn, in s; infinite for a sample that is lost.
        growth: the factor per sample by which the motion grows, below 1 if it decays.
        is_proved: whether it is proved that a motion grows.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=0.05, sample_time=1e-3)
        >>> loop.worst_delays(6669.1, 71.60, delays=(0.0, 1e-3))
        delays of 0, 1, 1, 1 ms in turn: a factor of 1.00916 per sample (growth proved)
    """

    delays: tuple[float, ...]
    growth: float
    is_proved: bool

    def __repr__(self) -> str:
        turn = ", ".join("lost" if isinf(delay) else f"{1e3 * delay:.6g}" for delay in self.delays)
        what = f"delays of {turn} ms in turn" if len(self.delays) > 1 else f"a delay of {turn} ms"
        how = "growth proved" if self.is_proved else "best of a search"
        return f"{what}: a factor of {self.growth:.6g} per sample ({how})"


@dataclass(frozen=True, repr=False)
class MovingLimits:
    """The stiffest wall that is proved for every sequence of delays, of those that a search tried.

    Attributes:
        stiffness: K in N/m of the proved wall; NaN if none was found.
        damping: its B in N s/m.
        unstable_stiffness: K in N/m of a wall at the same damping that is proved unstable, the
            lowest found, infinite if none was; between the two nothing is known.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> loop.limits(delays=(0.0, 0.2e-3))
        K = 43655.763794586725 N/m at B = 62.73319225142225 N s/m is proved for every sequence of
        delays; K = 44849 N/m there is unstable
    """

    stiffness: float
    damping: float
    unstable_stiffness: float

    def __repr__(self) -> str:
        if not self.stiffness > 0.0:
            return "no wall was found that is proved for every sequence of delays"
        unstable = f"K = {self.unstable_stiffness:.5g} N/m there is unstable"
        if isinf(self.unstable_stiffness):
            unstable = "no unstable wall was found there"
        return (
            f"K = {exact_text(self.stiffness)} N/m at B = {exact_text(self.damping)} N s/m is "
            f"proved for every sequence of delays; {unstable}"
        )


@dataclass(frozen=True, repr=False, eq=False)
class MovingRegion:
    """Walls that are proved for every sequence of delays: a polygon, with all that is inside.

    It is what a search finds, not the set of all such walls: it begins at 1/1000 of its largest
    stiffness and at the first of its dampings, though softer walls may be stable as well.

    Attributes:
        outline: (n, 2), K in N/m and B in N s/m, counter-clockwise; empty if no wall is proved.
        unstable: (m, 2), walls that are proved unstable, at dampings of the outline: K is the
            lowest one found there, infinite if none was. Between both nothing is known.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> region = loop.region(delays=(0.0, 1e-3))
        >>> region.contains(5000.0, [20.0, 60.0, 170.0]).tolist()
        [True, True, False]
        >>> region
        MovingRegion: every wall of a polygon is proved for every sequence of delays
          stiffest     K = 34502 N/m at B = 97.25 N s/m
          most damped  B = 159.7 N s/m
    """

    outline: Float64[np.ndarray, "vertex 2"]
    unstable: Float64[np.ndarray, "wall 2"]

    def contains(self, stiffness: Numbers, damping: Numbers) -> Bool[np.ndarray, "*grid"]:
        """Which walls are in the polygon; arrays of K in N/m and B in N s/m broadcast."""
        given = np.broadcast_arrays(*(np.asarray(v, np.float64) for v in (stiffness, damping)))
        if not len(self.outline):
            return np.zeros(given[0].shape, bool)
        (least, most_damping), (_, least_damping), *_ = self.outline
        tops = self.outline[2:]
        rounding = 8.0 * EPS * tops[:, 0].max()  # of an edge, whose ends may be of other sizes
        most = np.interp(given[1], tops[:, 1], tops[:, 0]) - rounding
        is_between = (given[0] >= least) & (given[0] <= most)
        return np.asarray(is_between & (given[1] >= least_damping) & (given[1] <= most_damping))

    def __repr__(self) -> str:
        if not len(self.outline):
            return "MovingRegion: no wall was found that is proved for every sequence of delays"
        stiffest, damping = self.outline[np.argmax(self.outline[:, 0])], self.outline[:, 1].max()
        k, b = stable_pair(float(stiffest[0]), float(stiffest[1]), (5, 4), self.contains)
        return (
            "MovingRegion: every wall of a polygon is proved for every sequence of delays\n"
            f"  stiffest     K = {number_text(k, 5)} N/m at B = {number_text(b, 4)} N s/m\n"
            f"  most damped  B = {number_text(damping, 4, ROUND_FLOOR)} N s/m"
        )

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the polygon, and walls that are proved unstable; axes of a new figure by default.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
            >>> axes = loop.region(delays=(0.0, 1e-3)).plot()
        """
        from jaxstab.pictures.style import plot_moving_region

        return plot_moving_region(self, ax)


class MovingLoop(NamedTuple):
    """A loop whose delays lie in a range, in samples.

    device: behind the shortest delay.
    """

    loop: LoopParameters
    device: SampledDevice
    filters: Filters | None
    delays: Delays

    @classmethod
    def from_loop(cls, loop: LoopParameters, delays: Any, lost: Any = 0) -> "MovingLoop":
        """Return a loop with a range of delays in s and of samples lost in a row."""
        loop = loop.in_floats()
        low, high = _checked_range(delays)
        shortest, longest = (replace(loop, delay=delay) for delay in (low, high))
        samples = Delays.between(float(shortest.delay_samples), float(longest.delay_samples), lost)
        filters = given_filters(loop.velocity, loop.position)
        return cls(shortest, _sampled(shortest), filters, samples)

    def walls(self, stiffness: Numbers, damping: Numbers) -> tuple[Walls, tuple[int, ...]]:
        """Return gains as walls (alpha, beta), and the shape of their grid."""
        require_x64(stiffness, damping)
        refuse_traced(stiffness, damping)
        grid = wall_grid(stiffness=stiffness, damping=damping)
        return grid.reshape(-1, 2) * self.units, grid.shape[:-1]

    @property
    def units(self) -> tuple[float, float]:
        """alpha/K and beta/B."""
        return self.device.stiffness_unit, self.device.damping_unit

    def codes(self, walls: Walls) -> Int8[np.ndarray, " wall"]:
        """Return the verdicts on walls."""
        codes = np.full(len(walls), Verdict.UNDECIDED, np.int8)
        codes[self.is_proved(walls)] = Verdict.STABLE
        low, high, _ = self.delays
        for delay in np.linspace(low, high, _CONSTANT if high > low else 1).tolist():
            device = sampled_device(self.device.device, self.device.sample_time, delay)
            undecided = np.flatnonzero(codes == Verdict.UNDECIDED)
            if undecided.size:
                alpha, beta = walls[undecided].T
                verdicts = linear_verdict(alpha, beta, device.loop(self.filters))
                codes[undecided[np.asarray(verdicts) == Verdict.UNSTABLE]] = Verdict.UNSTABLE
        for index in np.flatnonzero(codes == Verdict.UNDECIDED):
            if self.worst(walls[index])[1]:
                codes[index] = Verdict.UNSTABLE
        return codes

    def is_proved(self, walls: Walls) -> Bool[np.ndarray, " wall"]:
        """Return which walls are proved for every sequence of delays."""
        return is_stable_for_all(self.device, self.filters, walls, self.delays.jitter)

    def lowest_unstable(self, stiffness: float, damping: float) -> float:
        """Return a stiffness above one that is STABLE, proved UNSTABLE, by bisection."""
        low, high = stiffness, inf
        for _ in range(_COARSE):
            tried = min(0.5 * (low + high), 2.0 * low)
            is_unstable = self.codes(self.walls(tried, damping)[0])[0] == Verdict.UNSTABLE
            low, high = (low, tried) if is_unstable else (tried, high)
        return high

    def worst(self, wall: np.ndarray, *, is_thorough: bool = False) -> tuple[Growth, bool]:
        """Return the worst turn of delays that a search found, and whether it is proved to grow."""
        gains = float(wall[0]), float(wall[1])
        return growing_turn(self.device, self.filters, gains, self.delays, is_thorough=is_thorough)

    def verdict(self, stiffness: Numbers, damping: Numbers) -> Int8[Array, "*grid"]:
        """Return the verdicts on walls: ``HapticLoop.verdict``."""
        walls, shape = self.walls(stiffness, damping)
        return named(self.codes(walls).reshape(shape), Verdict)

    def worst_delays(self, stiffness: float, damping: float) -> WorstDelays:
        """Return the worst delays that a search found: ``HapticLoop.worst_delays``."""
        gains = checked_number("stiffness", stiffness), checked_number("damping", damping)
        (wall,), _ = self.walls(*gains)
        growth, is_proved = self.worst(wall, is_thorough=True)
        turn = tuple(delay * float(self.loop.sample_time) for delay in growth.turn)
        return WorstDelays(turn, growth.per_sample, is_proved)

    def limits(self) -> MovingLimits:
        """Return the stiffest proved wall that a search finds: ``HapticLoop.limits``."""
        search = _Search.from_loop(self)
        low, high, best = 0.0, search.corner[1], np.zeros(2)
        for _ in range(_ZOOMS):
            dampings = np.linspace(low, high, _GRID + 1)[1:]
            stiffest = search.stiffest(dampings)
            column, step = int(np.argmax(stiffest)), (high - low) / _GRID
            best = np.array([stiffest[column], dampings[column]])
            low, high = max(best[1] - step, 0.0), min(best[1] + step, search.corner[1])
        stiffness, damping = map(float, best)
        share, step = 0.0, 1.0
        for _ in range(_PROOFS):
            step /= _GRID
            shares = share + step * np.arange(1, _GRID + 1)
            proved = self.is_proved(self.walls(stiffness * shares, damping)[0])
            share = float(np.max(shares[proved], initial=share))
        if stiffness * share == 0.0:
            return MovingLimits(nan, nan, nan)
        stiffness *= share
        return MovingLimits(stiffness, damping, self.lowest_unstable(stiffness, damping))

    def region(self) -> MovingRegion:
        """Return a polygon of proved walls: ``HapticLoop.region``."""
        # Between two dampings a trapezoid below the stiffest walls, pulled in until all of it is
        # proved; it stays so where its neighbour lowers a corner.
        search, most = _Search.from_loop(self), 0.0
        for _ in range(2):  # the second time where walls are proved
            most = most or search.corner[1]
            dampings = np.linspace(0.0, most, _COLUMNS + 1)[1:]
            tops = search.stiffest(dampings)
            most = dampings[min(np.flatnonzero(tops)[-1] + 1, _COLUMNS - 1)] if tops.any() else 0.0
        least, kept = _LEAST * np.max(tops), np.zeros(_COLUMNS - 1)
        for pull in _PULLS:
            lower = np.stack([tops[:-1], tops[1:]]) * (1.0 - pull)
            chosen = np.flatnonzero((kept == 0.0) & np.all(lower > least, axis=0))
            left, right = lower[:, chosen]
            gains = np.full((chosen.size, 4, 2), least)
            gains[:, 2, 0], gains[:, 3, 0] = right, left
            gains[:, [0, 3], 1], gains[:, [1, 2], 1] = dampings[[chosen, chosen + 1]][..., None]
            walls = gains * self.units
            proved = are_polygons_stable(self.device, self.filters, walls, self.delays.jitter)
            kept[chosen[proved]] = 1.0 - pull
        edges = np.flatnonzero(np.diff(np.concatenate([[False], kept > 0.0, [False]])))
        if not edges.size:
            return MovingRegion(np.zeros((0, 2)), np.zeros((0, 2)))
        areas = [np.sum(tops[begin : end + 1]) for begin, end in edges.reshape(-1, 2)]
        begin, end = edges.reshape(-1, 2)[int(np.argmax(areas))]
        shares = np.minimum(np.append(kept[begin:end], 1.0), np.append(1.0, kept[begin:end]))
        here = dampings[begin : end + 1]
        edge = np.stack([tops[begin : end + 1] * shares, here], axis=-1)
        lowest = [[self.lowest_unstable(*wall), wall[1]] for wall in edge[::_EVERY].tolist()]
        outline = np.concatenate([[[least, here[-1]], [least, here[0]]], edge])
        return MovingRegion(outline, np.array(lowest))


class _Search(NamedTuple):
    """The search for walls that are proved, within the stable region of the shortest delay.

    corner: the largest K and B of that region.
    """

    moving: MovingLoop
    region: WallRegion
    corner: Float64[np.ndarray, "2"]

    @classmethod
    def from_loop(cls, moving: MovingLoop) -> "_Search":
        """Return the search for the walls of a loop."""
        region = wall_region(moving.loop, TOLERANCE).reachable
        return cls(moving, region, np.max(region.outline, axis=0, initial=0.0))

    def stiffest(
        self, dampings: Float64[np.ndarray, " damping"]
    ) -> Float64[np.ndarray, " damping"]:
        """Return up to which K walls may be proved at each damping; 0 if none is."""
        moving, (_, high) = self.moving, self.region.stiffness_limits(dampings).T
        alpha, beta = np.nan_to_num(high) * moving.units[0], dampings * moving.units[1]
        jitter = moving.delays.jitter
        stiffest = stiffest_for_all(moving.device, moving.filters, beta, alpha, jitter)
        return stiffest / moving.units[0]


def jitter_margin(
    loop: LoopParameters, stiffness: Numbers, damping: Numbers
) -> Float64[np.ndarray, "*grid"]:
    """Return how far the delay may move above the loop's, in s: ``HapticLoop.jitter_margin``."""
    moving = MovingLoop.from_loop(loop, (float(loop.delay), float(loop.delay)))
    walls, shape = moving.walls(stiffness, damping)
    most = LONGEST_DELAY - moving.delays.low
    samples = largest_jitters(moving.device, moving.filters, walls, most).reshape(shape)
    return np.asarray(samples * (float(moving.loop.sample_time) * (1.0 - 8.0 * EPS)))


def turn_of(loop: LoopParameters, delays: Any) -> tuple[float, ...]:
    """Return delays in s, in turn, as samples of a loop; infinite for a sample that is lost."""
    given = np.asarray(delays, np.float64)
    if given.ndim != 1 or not given.size:
        raise TypeError(f"delays is {shortened(delays)}; give a sequence of delays in s.")
    finite = given[np.isfinite(given)]
    if np.any(np.isnan(given)) or np.any(given < 0.0) or not finite.size:
        raise ValueError(
            f"delays is {shortened(delays)}; give delays >= 0 s, infinite for a lost sample, one "
            "at least finite."
        )
    samples = {delay: replace(loop, delay=delay).delay_samples for delay in set(finite.tolist())}
    return tuple(samples.get(delay, inf) for delay in given.tolist())


def refuse_traced(*values: Any) -> None:
    """Refuse gains, or what else is given beside delays, that JAX traces."""
    if is_any_traced(*values):
        raise TypeError("a value is traced; with delays give numbers, outside of jit and grad.")


def _checked_range(delays: Any) -> Range:
    if np.shape(delays) != (2,):
        raise TypeError(
            f"delays is {shortened(delays)}; give the shortest and the longest delay in s, "
            "(low, high)."
        )
    low, high = (checked_number("delays", delay, 0.0, unit="s") for delay in delays)
    if low > high:
        raise ValueError(f"delays are from {low:g} to {high:g} s; give the shortest one first.")
    return low, high


def _sampled(loop: LoopParameters) -> SampledDevice:
    return sampled_device(loop.held_device, float(loop.sample_time), float(loop.delay_samples))
