"""The wall with the smallest worst settling time over several loops: a search on grids."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.model import LoopParameters
from jaxstab.motion.settling import Excitation, checked_level, settling_samples
from jaxstab.numbers import checked_number
from jaxstab.tuning import TuningStatus
from jaxstab.tuning.gains import Grid

if TYPE_CHECKING:
    from jaxstab.loop.loop import HapticLoop

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
    """Return the wall whose longest settling time over several loops is the shortest one found.

    The answer holds for these loops alone: give the corners of your ranges of hands, masses and
    delays, and some loops between. The search covers the walls that are reached by turning gains up
    from 0 in the first loop. Among walls that are equally fast at worst, the one that is fastest on
    average is returned.

    Args:
        loops: at least one.
        stiffness: K in N/m if it is given; only the damping is then chosen.
        level: half width of the band of the settling time, between 0 and 1.
        excitation: what the settling time refers to, see ``jaxstab.settling_samples``.

    Returns:
        CommonWall. That no other wall is faster is not proved.

    Raises:
        ValueError: there is no loop, an argument is out of range, or an unknown word.
        TypeError: an argument is not one number, or JAX traces a loop.

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
    loops = [_in_floats(loop) for loop in loops]
    level = checked_level(level, excitation)
    grid = _first_grid(loops[0], stiffness)
    nothing = CommonWall(np.nan, np.nan, np.inf, loops[0], TuningStatus.NO_STABLE_GAINS)
    if grid is None:
        return nothing
    horizon, best, times = _FIRST_HORIZON, (np.nan, np.nan), np.full(len(loops), np.inf)
    for zoom in range(_ZOOMS + 1):
        walls = [np.ravel(gains) for gains in np.broadcast_arrays(*grid.points)]
        region = loops[0].region()
        is_reached = np.asarray((region.main or region).contains(*walls))
        walls = [gains[is_reached] for gains in walls]
        found = _times(loops, walls, times.max(), level, excitation, horizon)
        while not np.isfinite(found.max(axis=0)).any() and zoom == 0 and horizon < _MOST:
            horizon *= _LONGER
            found = _times(loops, walls, times.max(), level, excitation, horizon)
        if found.shape[1]:
            first = int(np.lexsort((found.mean(axis=0), found.max(axis=0)))[0])
            value = found[:, first]
            if (value.max(), value.mean()) < (times.max(), times.mean()):
                times, best = value, (float(walls[0][first]), float(walls[1][first]))
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
    first = loops[0]
    if any(loop.body is None or not _are_alike(loop, first) for loop in loops):
        wall = [np.array([stiffness]), np.array([damping])]
        single = [_times([loop], wall, np.inf, level, excitation, _MOST) for loop in loops]
        return np.concatenate(single)[:, 0]
    points = np.array(
        [(loop.alpha(stiffness), loop.beta(damping), *loop.slice.values()) for loop in loops]
    )
    alpha, beta, gamma, delta, delay = points.T
    found = settling_samples(
        alpha,
        beta,
        gamma=gamma,
        delta=delta,
        delay=delay,
        level=level,
        excitation=excitation,
        horizon=_MOST,
        **first.filters,
    )
    samples = np.asarray(found.value)
    return np.where(np.isnan(samples), np.inf, samples * first.sample_time)


def _are_alike(one: "HapticLoop", other: "HapticLoop") -> bool:
    """Return whether two loops have one controller, but for the delay."""
    return (one.sample_time, one.filters) == (other.sample_time, other.filters)


def _in_floats(loop: "HapticLoop") -> Any:
    if not isinstance(loop, LoopParameters):
        raise TypeError(f"loops has {loop!r}; give a HapticLoop for each.")
    return loop.in_floats()


def _first_grid(loop: "HapticLoop", stiffness: float | None) -> Grid | None:
    """Return a grid that spans the walls that turning gains up from 0 reaches."""
    region = loop.region()
    outline = (region.main or region).outline
    if not len(outline):
        return None
    (left, low), (right, high) = outline.min(axis=0).tolist(), outline.max(axis=0).tolist()
    if stiffness is None:
        return Grid((left, right), (low, high), _POINTS)
    stiffness = checked_number("stiffness", stiffness)
    return Grid((stiffness, stiffness), (low, high), _POINTS**2)


def _times(
    loops: "Sequence[HapticLoop]",
    walls: list[Walls],
    longest: float,
    level: float,
    excitation: Excitation,
    horizon: int,
) -> Float64[np.ndarray, "loop wall"]:
    """Return settling times in s; infinite where none is proved, or one is longer than allowed."""
    times = np.full((len(loops), len(walls[0])), np.inf)
    hopeful = np.arange(len(walls[0]))
    for number, loop in enumerate(loops):
        stiffness, damping = (gains[hopeful] for gains in walls)
        settling = loop.settling_time(
            stiffness, damping, level=level, excitation=excitation, horizon=horizon
        )
        found = np.asarray(settling.value)
        found = np.where(found <= longest, found, np.inf)  # NaN is not proved
        times[number, hopeful] = found
        hopeful = hopeful[np.isfinite(found)]
        if not len(hopeful):
            times[number:] = np.inf
            break
    times[:, ~np.isfinite(times.max(axis=0))] = np.inf
    return times
