"""The walls of a loop that come to rest fastest, and of several loops at worst, in SI units."""

from collections.abc import Iterable, Sequence
from decimal import ROUND_CEILING
from functools import lru_cache
from math import isnan
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.conventions import Excitation
from jaxstab.loop.many import in_floats
from jaxstab.loop.region import TOLERANCE, wall_region
from jaxstab.model.filters import behind_measured
from jaxstab.motion.settling import checked_level, likely_settling
from jaxstab.numbers import checked_number, checked_word
from jaxstab.shown import exact_text, number_text, shortened, text_with_bound
from jaxstab.tuning import TuningStatus
from jaxstab.tuning.radius import Axis, Best, Values, minimised, smallest_radius, walls_of
from jaxstab.tuning.settling import TunedLoop, shortest_settling

if TYPE_CHECKING:  # alone: other loops are refused by sentences, not by the types
    from jaxstab.loop.loop import HapticLoop


def wall_axes(
    outline: Float64[np.ndarray, "vertex 2"], stiffness: float | None
) -> tuple[Axis, Axis]:
    """A grid over the walls, both gains >= 0, that an outline encloses; or those of a stiffness."""
    low, high = np.maximum([outline.min(axis=0), outline.max(axis=0)], 0.0)
    if stiffness is None:
        return np.linspace(low[0], high[0], 25), np.linspace(low[1], high[1], 25)
    return np.array([stiffness]), np.linspace(low[1], high[1], 25**2)


def fastest_calm_wall(
    loop: "HapticLoop", objective: Values, chatter: Values, limit: float, alpha: float | None
) -> tuple[tuple[float, float], TuningStatus]:
    """The gains of the least objective found whose chatter is within a limit, and a status."""
    region = wall_region(loop.in_floats(), TOLERANCE).region.reachable
    if not len(region.points):
        return (np.nan, np.nan), TuningStatus.NO_STABLE_GAINS

    def values(alphas: np.ndarray, betas: np.ndarray) -> np.ndarray:
        values, inside = np.full(alphas.size, np.inf), np.asarray(region.contains(alphas, betas))
        likely = np.full(alphas.size, np.inf)
        likely[inside] = np.nan_to_num(objective(alphas[inside], betas[inside]), nan=np.inf)
        for value in np.unique(likely[np.isfinite(likely)]):  # the fastest walls first
            walls = np.flatnonzero(likely == value)
            reached = chatter(alphas[walls], betas[walls])
            calm = reached <= limit
            if np.any(calm):  # of equally fast walls the calmest one is the least
                values[walls[calm]] = value + 1e-9 * reached[calm] / limit
                slower = likely > value  # calm or not, these are not the best
                values[slower] = likely[slower]
                break
        return values

    wall, _ = minimised(values, wall_axes(region.points, alpha), zooms=3, lowest=0.0)
    return wall, TuningStatus.NOT_CALM if np.isnan(wall[0]) else TuningStatus.SCANNED


class OptimalWall(NamedTuple):
    """The best wall in SI units, and what exactly these gains achieve.

    ``radius`` is the spectral radius of exactly these gains, proved to within ``radius_error``.
    ``chatter`` is how far an encoder can drive the position, in m, proved, if one is given.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> best = loop.tune("radius")
        >>> print(f"K = {best.stiffness:.0f} N/m, B = {best.damping:.1f} N s/m, {best.status.name}")
        K = 7297 N/m, B = 40.1 N s/m, TRIPLE_ROOT
    """

    stiffness: float
    damping: float
    radius: float
    radius_error: float
    settling_time: float
    status: TuningStatus
    chatter: float = np.nan

    def __repr__(self) -> str:
        wall = f"K = {exact_text(self.stiffness)} N/m at B = {exact_text(self.damping)} N s/m"
        lines = [
            f"OptimalWall: {wall} ({self.status.words})",
            f"  spectral radius  {text_with_bound(self.radius, self.radius_error)}",
            f"  settling time    {number_text(self.settling_time, 6, unit='s')}",
            f"  encoder chatter  {number_text(self.chatter, 3, ROUND_CEILING, 'm')}",
        ]
        return "\n".join(lines[: 3 if isnan(self.chatter) else 4])


def optimal_wall(
    loop: "HapticLoop",
    goal: Literal["radius", "settling"],
    stiffness: float | None,
    level: float,
    excitation: Excitation,
    encoder: float | None,
    chatter: float | None,
) -> OptimalWall:
    """Return the wall that comes to rest fastest: ``HapticLoop.tune``."""
    slower = 64  # than the fastest wall: how slow calm walls are looked for at first
    limit, step = np.inf, 0.0
    if encoder is not None:
        step = checked_number("encoder", encoder, 0.0, is_open=True, unit="m")
    elif chatter is not None:
        raise TypeError(
            f"chatter is {shortened(chatter)} without encoder; give its resolution in m."
        )
    if chatter is not None:
        limit = checked_number("chatter", chatter, 0.0, is_open=True, unit="m")

    def in_si_units(alphas: Any, betas: Any) -> tuple[Any, Any]:
        return loop.stiffness(alphas), loop.damping(betas)

    def moved(*walls: Any) -> np.ndarray:
        """Proved amplitudes of walls in m, by the encoder."""
        return np.asarray(loop.amplitude(*in_si_units(*walls), encoder=step).position)

    checked_word("goal", goal, ("radius", "settling"))
    level = checked_level(level, excitation)
    given = None if stiffness is None else checked_number("stiffness", stiffness, 0.0)
    alpha = None if given is None else loop.alpha(given)
    plain = loop.in_floats()
    tuned, best = _of_smallest_radius(plain, alpha)
    wall, status = best.wall, best.status
    if goal == "settling":
        settled = shortest_settling(tuned, best, alpha, level, excitation)
        wall = float(settled.alpha), float(settled.beta)
        status = TuningStatus(int(settled.status))
    is_asked = step > 0.0 and status != TuningStatus.NO_STABLE_GAINS
    reached = float(moved(*wall)) if is_asked else np.nan
    if is_asked and not reached <= limit:
        options: dict[str, Any] = {"level": level, "excitation": excitation}
        fastest = float(tuned.settling(*wall, **options).value)

        def likely(*walls: np.ndarray) -> np.ndarray:
            horizon = int(np.clip(slower * fastest, 1 << 10, 1 << 16))
            return likely_settling(plain, *in_si_units(*walls), **options, horizon=horizon)

        def proved(*walls: np.ndarray) -> np.ndarray:
            return np.asarray(tuned.settling(*walls, **options).value)

        for objective in (tuned.walls.radii,) if goal == "radius" else (likely, proved):
            wall, status = fastest_calm_wall(loop, objective, moved, limit, alpha)
            if status != TuningStatus.NOT_CALM:
                break
        reached = float(moved(*wall)) if np.isfinite(wall[0]) else np.nan
    if np.isnan(wall[0]):
        return OptimalWall(np.nan, np.nan, np.nan, np.inf, np.inf, status)
    gains = loop.stiffness(wall[0]) if given is None else given, loop.damping(wall[1])
    radius = loop.spectral_radius(*gains)
    settling = np.nan  # of a velocity that is measured, the radius alone is known
    if loop.velocity is None or behind_measured(loop.velocity) is None:
        found = loop.settling_time(*gains, level=level, excitation=excitation)
        settling = float(found.value)
    return OptimalWall(*gains, float(radius.value), float(radius.error), settling, status, reached)


@lru_cache(maxsize=16)
def _of_smallest_radius(plain: Any, alpha: float | None) -> tuple[TunedLoop, Best]:
    """A loop and its wall of the smallest radius, where the search for fast settling begins, too.

    The most recent ones are remembered: scenes are tuned for both goals.
    """
    tuned = TunedLoop(plain, walls_of(plain)._replace(lowest=0.0))
    return tuned, smallest_radius(tuned.walls, alpha)


# The wall that settles fastest, at worst, over several loops.

_MOST = 2**15  # samples within which a wall must have settled

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
    loops = [in_floats(loop) for loop in loops]
    if not loops:
        raise ValueError("loops is empty; give at least one loop.")
    options: dict[str, Any] = {"level": checked_level(level, excitation), "excitation": excitation}
    if stiffness is not None:
        stiffness = checked_number("stiffness", stiffness, 0.0)
    region = loops[0].region().reachable
    wall, longest = (np.nan, np.nan), np.inf
    for horizon in (64, 512, 4096, _MOST) if len(region.outline) else ():

        def values(*gains: Walls, horizon: int = horizon) -> Walls:
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
    loops: "Sequence[HapticLoop]", walls: list[Walls], longest: float, **options: Any
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
