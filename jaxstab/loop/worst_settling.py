"""The wall that settles fastest, at worst, over several loops."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.conventions import Excitation
from jaxstab.loop.many import in_floats
from jaxstab.loop.tune import wall_axes
from jaxstab.motion.bounds import checked_level, likely_settling
from jaxstab.numbers import checked_number
from jaxstab.shown import shortened
from jaxstab.tuning import TuningStatus, minimised

if TYPE_CHECKING:
    from jaxstab.loop.loop import HapticLoop

_MOST = 2**15  # samples within which a wall must have settled

Floats = Float64[np.ndarray, " wall"]


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
        excitation: of the settling time, see ``jaxstab.settling_samples``.

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
    given: Any = loops
    if not isinstance(given, Iterable):
        raise TypeError(f"loops is {shortened(given)}; give a list of HapticLoop.")
    loops = [in_floats(loop) for loop in given]
    if not loops:
        raise ValueError("loops is empty; give at least one loop.")
    options: dict[str, Any] = {"level": checked_level(level, excitation), "excitation": excitation}
    if stiffness is not None:
        stiffness = checked_number("stiffness", stiffness, 0.0)
    region = loops[0].region().reachable
    wall, longest = (np.nan, np.nan), np.inf
    for horizon in (64, 512, 4096, _MOST) if len(region.outline) else ():

        def values(*gains: Floats, horizon: int = horizon) -> Floats:
            """The longest settling times; of equal ones, the shortest on average is least."""
            nonlocal longest
            values, inside = np.full(gains[0].size, np.inf), region.contains(*gains)
            walls = [each[inside] for each in gains]
            settling = _times(loops, walls, longest, **options, horizon=horizon)
            longest = min(longest, settling.max(axis=0).min(initial=np.inf))
            values[inside] = settling.max(axis=0) + 1e-6 * settling.mean(axis=0)
            return values

        axes = wall_axes(region.outline, stiffness)
        wall, _ = minimised(values, axes, zooms=4, lowest=0.0)
        if np.isfinite(longest):
            break
    if np.isnan(wall[0]):
        return CommonWall(np.nan, np.nan, np.inf, loops[0], TuningStatus.NO_STABLE_GAINS)
    times = settling_times(loops, *wall, **options)
    slowest = loops[int(np.argmax(times))]
    return CommonWall(*wall, float(times.max()), slowest, TuningStatus.SCANNED)


def settling_times(
    loops: "Sequence[HapticLoop]",
    stiffness: float,
    damping: float,
    level: float = 0.02,
    excitation: Excitation = "force",
) -> Float64[np.ndarray, " loop"]:
    """Return the settling time of one wall in s for each loop; infinite where none is proved."""
    options: dict[str, Any] = {"level": level, "excitation": excitation, "horizon": _MOST}
    settling = [loop.settling_time(stiffness, damping, **options).value for loop in loops]
    return np.nan_to_num(np.hstack(settling), nan=np.inf, posinf=np.inf)


def _times(
    loops: "Sequence[HapticLoop]", walls: list[Floats], longest: float, **options: Any
) -> Float64[np.ndarray, "loop wall"]:
    """Likely settling times in s; infinite where there is none, or one is longer than allowed."""
    times = np.full((len(loops), len(walls[0])), np.inf)
    hopeful = np.arange(len(walls[0]))
    for own, loop in zip(times, loops, strict=True):
        value = likely_settling(loop, *(gains[hopeful] for gains in walls), **options)
        own[hopeful] = np.where(value <= longest, value, np.inf)  # NaN is none
        hopeful = hopeful[np.isfinite(own[hopeful])]
        if not len(hopeful):
            break
    times[:, ~np.isfinite(times.max(axis=0))] = np.inf
    return times
