"""Walls that several loops render stably: the intersection of their exact regions, proved."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8

from jaxstab.arrays import Numbers
from jaxstab.conventions import Excitation, Verdict
from jaxstab.loop.between import LoopsBetween, TriedLoops, common_polygon
from jaxstab.loop.many import in_floats
from jaxstab.loop.region import Gains
from jaxstab.model.filters import given_filters
from jaxstab.model.loop import as_one
from jaxstab.motion.settling import checked_level
from jaxstab.numbers import checked_number
from jaxstab.ranges.box import NOTHING, Points, RobustStatus, Unproved, search
from jaxstab.ranges.margins import is_stable_along
from jaxstab.ranges.robust import failures
from jaxstab.tuning import TuningStatus
from jaxstab.tuning.gains import Grid

if TYPE_CHECKING:  # alone: other loops are refused by sentences, not by the types
    from jaxstab.loop.loop import HapticLoop

_WIDER = 1.0, 2.0, 4.0  # times the tolerance, by which a polygon is pulled in


@dataclass(frozen=True)
class CommonRegion:
    """Walls that are stable in each of several loops, in the component that contains small gains.

    Attributes:
        loops: the loops; of all loops between two, those that were tried.
        status: PROVED if every wall of the outline is proved stable in every loop; EMPTY if no row
            of damping was found with such a wall; otherwise UNPROVED.
        outline: a polygon of walls (K, B), counter-clockwise, the first vertex not repeated; none
            unless the status is PROVED.
        tolerance: how far the outline was pulled in to be proved, as a share of its size: the
            intersection of the regions is larger by about as much.
        between: all of the loops where they are those between two; the proof then holds for all.

    Example:
        >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
        >>> common = jaxstab.common_region([light, heavy])
        >>> common.status.name, common.contains(5000.0, [50.0, 500.0]).tolist()
        ('PROVED', [True, False])
        >>> common.verdict([5000.0, 200000.0], 50.0).tolist()
        [1, 2]
        >>> print(f"{common.stiffest.stiffness:.0f} N/m at {common.stiffest.damping:.1f} N s/m")
        69796 N/m at 82.5 N s/m
    """

    loops: "tuple[HapticLoop, ...]"
    status: RobustStatus
    outline: Points = field(repr=False)
    tolerance: float
    between: LoopsBetween | None = None

    @property
    def stiffest(self) -> Gains:
        """The wall of the outline with the largest K and B >= 0; NaN where no such K is positive.

        It is a vertex, or where an edge crosses B = 0.
        """
        vertices = self.outline
        low, high = vertices, np.roll(vertices, -1, axis=0)
        crosses = (low[:, 1] < 0.0) != (high[:, 1] < 0.0)
        (k, b), (more, rise) = low[crosses].T, (high - low)[crosses].T
        crossings = np.stack([k - more * b / rise, np.zeros_like(b)], axis=-1)
        walls = np.concatenate([vertices[vertices[:, 1] >= 0.0], crossings, [(0.0, np.nan)]])
        stiffness, damping = walls[np.argmax(walls[:, 0])].tolist()
        return Gains(stiffness if stiffness > 0.0 else np.nan, damping)

    def verdict(self, stiffness: Numbers, damping: Numbers) -> Int8[np.ndarray, "*grid"]:
        """Proved codes of ``Verdict`` for walls in all of the loops together.

        Args and Raises: see ``jaxstab.conventions``.

        Returns:
            STABLE where a wall is proved stable in every loop, outside the outline too; UNSTABLE
            where it is proved unstable in one loop; otherwise UNDECIDED.
        """
        if self.between is not None:
            return self.between.verdict(stiffness, damping)
        codes = np.stack([np.asarray(loop.verdict(stiffness, damping)) for loop in self.loops])
        is_stable = np.all(codes == Verdict.STABLE, axis=0)
        stable = np.where(is_stable, Verdict.STABLE, Verdict.UNDECIDED)
        is_unstable = np.any(codes == Verdict.UNSTABLE, axis=0)
        return np.asarray(np.where(is_unstable, Verdict.UNSTABLE, stable), np.int8)

    def contains(self, stiffness: Numbers, damping: Numbers) -> Bool[np.ndarray, "*grid"]:
        """Where walls are proved stable in every loop; see ``verdict``."""
        return np.asarray(self.verdict(stiffness, damping) == Verdict.STABLE)


def common_region(
    loops: "Sequence[HapticLoop] | LoopsBetween", *, tolerance: float = 0.02
) -> CommonRegion:
    """The walls that are stable in each of several loops, with a proved polygon.

    The loops of a list may differ in everything: devices, hands, estimators, delays, sampling
    periods. The answer holds for these loops alone, not for loops between them. For an interval of
    one parameter give ``jaxstab.LoopsBetween``: then it holds for every loop between the two.

    Args:
        loops: at least one, or all loops between two.
        tolerance: how far the polygon is pulled in to be proved, as a share of its size, in
            [1e-3, 0.1]; twice or four times as much where that is not enough.

    Returns:
        CommonRegion with its status. An empty one is an answer, not an error.

    Raises: see ``jaxstab.conventions``; ValueError also if there is no loop, or a device has zero
    DC gain.

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
        return _proved_region(tried.loops, tried.unproved, tried.add, tolerance, loops)
    if not isinstance(loops, Iterable):
        raise TypeError(f"loops is {loops!r}; give a list of HapticLoop, or LoopsBetween two.")
    given = [in_floats(loop) for loop in loops]
    if not given:
        raise ValueError("loops is empty; give at least one HapticLoop.")

    def unproved(walls: Points) -> "list[HapticLoop]":
        return [loop for loop in given if not _is_proved(loop, walls)]

    return _proved_region(given, unproved, lambda _: False, tolerance)


def _proved_region(
    loops: "list[HapticLoop]",
    unproved: Unproved,
    add: Callable[[Any], bool],
    tolerance: float,
    between: LoopsBetween | None = None,
) -> CommonRegion:
    """The region that a search finds from sampled loops, to which it may add others."""
    pulls = [times * tolerance for times in _WIDER]
    searched = search(partial(common_polygon, loops), unproved, add, pulls)
    if searched.guess is None or not searched.is_proved:
        return CommonRegion(tuple(loops), searched.status, NOTHING.walls, tolerance, between)
    return CommonRegion(tuple(loops), searched.status, searched.guess.walls, searched.pull, between)


def _is_proved(loop: "HapticLoop", outline: Points) -> bool:
    if loop.body is None:
        return is_stable_along(loop, outline)
    gamma, delta, delay = loop.slice.values()
    walls = np.stack([loop.alpha(outline[:, 0]), loop.beta(outline[:, 1])], axis=-1)
    hand, filters = ((gamma, gamma), (delta, delta)), given_filters(**loop.filters)
    is_free = not len(failures(walls, *hand, delay, filters=filters))
    return is_free and bool(loop.verdict(*outline[0]) == Verdict.STABLE)


# The wall with the smallest worst settling time over several loops: a search on grids.

_POINTS = 25  # on an axis of the first grid
_ZOOMS = 4
_FIRST_HORIZON, _MOST = 64, 2**15  # samples within which a wall must have settled
_LONGER = 8

Walls = Float64[np.ndarray, " wall"]


class CommonWall(NamedTuple):
    """A wall for several loops.

    Attributes:
        stiffness: K in N/m.
        damping: B in N s/m.
        settling_time: the longest of the loops' settling times in s, each of them proved; infinite
            if no wall was found.
        slowest: the loop that takes longest.
        status: SCANNED or NO_STABLE_GAINS.

    Example:
        >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> heavy = jaxstab.HapticLoop(device_mass=0.12, device_damping=1.5, sample_time=1e-3)
        >>> wall = jaxstab.tune_for_all([light, heavy])
        >>> wall.slowest is heavy or wall.slowest is light, wall.status.name
        (True, 'SCANNED')
    """

    stiffness: float
    damping: float
    settling_time: float
    slowest: "HapticLoop"
    status: TuningStatus


def tune_for_all(
    loops: "Sequence[HapticLoop]",
    *,
    stiffness: float | None = None,
    level: float = 0.02,
    excitation: Excitation = "force",
) -> CommonWall:
    """The wall whose longest settling time over several loops is the shortest one found.

    The answer holds for these loops alone: give the corners of your ranges of hands, masses and
    delays, and some loops between. Walls have K >= 0 and B >= 0. The search covers the stable
    component of the first loop that contains small gains. Among walls that are equally fast at
    worst, the one that is fastest on average is returned. That no other wall is faster is not
    proved.

    Args:
        loops: at least one.
        stiffness: K in N/m if it is given; only the damping is then chosen.
        level: half width of the band of the settling time, between 0 and 1.
        excitation: what the settling time refers to, see ``jaxstab.settling_samples``.

    Raises: see ``jaxstab.conventions``; ValueError also if there is no loop, or for an unknown
    word.

    Source: the loop of eqs. (1)-(5); settling as in later papers of Hulin, Preusche, Hirzinger.

    Example:
        >>> loops = [
        ...     jaxstab.HapticLoop(device_mass=mass, device_damping=1.5, sample_time=1e-3)
        ...     for mass in (0.09, 0.1, 0.11)
        ... ]
        >>> wall = jaxstab.tune_for_all(loops)
        >>> max(float(loop.settling_time(*wall[:2]).value) for loop in loops) == wall.settling_time
        True
    """
    if not loops:
        raise ValueError("loops is empty; give at least one loop.")
    loops = [in_floats(loop) for loop in loops]
    level = checked_level(level, excitation)
    grid = _first_grid(loops[0], stiffness)
    nothing = CommonWall(np.nan, np.nan, np.inf, loops[0], TuningStatus.NO_STABLE_GAINS)
    if grid is None:
        return nothing
    horizon, best, times = _FIRST_HORIZON, (np.nan, np.nan), np.full(len(loops), np.inf)
    for zoom in range(_ZOOMS + 1):
        walls = [np.ravel(gains) for gains in np.broadcast_arrays(*grid.points)]
        region = loops[0].region()
        is_reached = np.asarray(region.reachable.contains(*walls))
        walls = [gains[is_reached] for gains in walls]
        settling = _times(loops, walls, times.max(), level, excitation, horizon)
        while not np.isfinite(settling.max(axis=0)).any() and zoom == 0 and horizon < _MOST:
            horizon *= _LONGER
            settling = _times(loops, walls, times.max(), level, excitation, horizon)
        if settling.shape[1]:
            index = int(np.lexsort((settling.mean(axis=0), settling.max(axis=0)))[0])
            value = settling[:, index]
            if (value.max(), value.mean()) < (times.max(), times.mean()):
                times, best = value, (float(walls[0][index]), float(walls[1][index]))
        if not np.isfinite(times.max()):
            return nothing
        grid = grid.around(best)
    slowest = loops[int(np.argmax(times))]
    return CommonWall(*best, float(times.max()), slowest, TuningStatus.SCANNED)


def settling_times(
    loops: "Sequence[HapticLoop]",
    stiffness: float,
    damping: float,
    level: float = 0.02,
    excitation: Excitation = "force",
) -> Float64[np.ndarray, " loop"]:
    """Return the settling time of one wall in s for each loop; infinite where none is proved."""
    controllers = {(loop.sample_time, loop.velocity, loop.position) for loop in loops}
    options: dict[str, Any] = {"level": level, "excitation": excitation, "horizon": _MOST}
    if len(controllers) == 1 and all(loop.body is not None for loop in loops):
        loops = [as_one(loops)]
    settling = [loop.settling_time(stiffness, damping, **options).value for loop in loops]
    return np.nan_to_num(np.hstack(settling), nan=np.inf, posinf=np.inf)


def _first_grid(loop: "HapticLoop", stiffness: float | None) -> Grid | None:
    """A grid that spans the walls of the stable component that contains small gains."""
    outline = loop.region().reachable.outline
    if not len(outline):
        return None
    if stiffness is not None:
        stiffness = float(checked_number("stiffness", stiffness, 0.0))
    return Grid.over_walls(outline, _POINTS, stiffness)


def _times(
    loops: "Sequence[HapticLoop]",
    walls: list[Walls],
    longest: float,
    level: float,
    excitation: Excitation,
    horizon: int,
) -> Float64[np.ndarray, "loop wall"]:
    """Settling times in s; infinite where none is proved, or one is longer than allowed."""
    times = np.full((len(loops), len(walls[0])), np.inf)
    hopeful = np.arange(len(walls[0]))
    for index, loop in enumerate(loops):
        stiffness, damping = (gains[hopeful] for gains in walls)
        settling = loop.settling_time(
            stiffness, damping, level=level, excitation=excitation, horizon=horizon
        )
        value = np.asarray(settling.value)
        value = np.where(value <= longest, value, np.inf)  # NaN is not proved
        times[index, hopeful] = value
        hopeful = hopeful[np.isfinite(value)]
        if not len(hopeful):
            times[index:] = np.inf
            break
    times[:, ~np.isfinite(times.max(axis=0))] = np.inf
    return times
