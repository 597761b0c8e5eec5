"""The walls of a loop that come to rest fastest, in SI units."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from jaxstab.arrays import Numbers
from jaxstab.conventions import Excitation
from jaxstab.loop.region import TOLERANCE, wall_region
from jaxstab.model import LoopParameters
from jaxstab.model.filters import given_filters
from jaxstab.motion.settling import checked_level, likely_settling
from jaxstab.numbers import checked_number, checked_word
from jaxstab.tuning import OptimalGains, TuningStatus
from jaxstab.tuning.gains import (
    Grid,
    shortest_settling,
    smallest_radius_around,
    smallest_radius_damping,
)
from jaxstab.tuning.loops import TunedLoop, device_loop, mass_loop

if TYPE_CHECKING:
    from jaxstab.loop.loop import HapticLoop

# The fastest wall that an encoder drives no further than a limit, or with the smallest radius where
# the best gains are no wall, one being negative: searches on grids.

_POINTS = 25  # on an axis
_ZOOMS = 4
_SLOWER = 64  # than the fastest wall: how slow calm walls are looked for at first
_RADIUS_POINTS, _EDGE_POINTS = 65, 1025  # on an axis, on K = 0 and B = 0: valleys are narrow

Objective = Callable[[np.ndarray, np.ndarray], Any]  # of alpha and beta; infinite, NaN: no wall


class Chatter(NamedTuple):
    """The resolution of an encoder in m, and how far it may drive the position, in m."""

    encoder: float
    limit: float = np.inf

    def amplitudes(self, loop: "HapticLoop", alpha: Any, beta: Any) -> np.ndarray:
        """Proved amplitudes of walls in m."""
        wall = loop.stiffness(alpha), loop.damping(beta)
        return np.asarray(loop.amplitude(*wall, encoder=self.encoder).position)


def fastest_calm_wall(
    loop: "HapticLoop", objective: Objective, chatter: Chatter, alpha: float | None
) -> tuple[tuple[float, float], float, TuningStatus]:
    """The gains of the least objective found within the limit, their amplitude in m, a status."""
    # The first grid spans the component that contains small gains; each further grid surrounds the
    # best wall so far. Among equally fast walls the calmest one is taken.
    best, least, status = (np.nan, np.nan), (np.inf, np.inf), TuningStatus.NOT_CALM
    region = wall_region(loop.in_floats(), TOLERANCE).region.reachable
    if not len(region.points):
        return best, np.inf, TuningStatus.NO_STABLE_GAINS
    grid = Grid.over_walls(region.points, _POINTS, alpha)
    for _ in range(_ZOOMS):
        alphas, betas = (np.ravel(gains) for gains in np.broadcast_arrays(*grid.points))
        inside = np.asarray(region.contains(alphas, betas))
        alphas, betas = alphas[inside], betas[inside]
        values = np.asarray(objective(alphas, betas))
        for value in np.unique(values[values <= least[0]]).tolist():  # the fastest walls first
            walls = np.flatnonzero(values == value)
            reached = chatter.amplitudes(loop, alphas[walls], betas[walls])
            calmest = int(np.argmin(reached))
            if reached[calmest] <= chatter.limit:
                if (value, reached[calmest]) < least:
                    least, place = (value, float(reached[calmest])), int(walls[calmest])
                    best, status = (float(alphas[place]), float(betas[place])), TuningStatus.SCANNED
                break
        if not np.isfinite(least[0]):
            break
        grid = grid.around(best)
    return best, least[1], status


def _smallest_radius(loop: LoopParameters, tuned: TunedLoop) -> OptimalGains:
    """Return the gains >= 0 with the smallest radius."""
    best = tuned.smallest_radius()
    if min(best.alpha, best.beta) >= 0.0:
        return best
    # The best wall may lie on an edge, in a valley that a grid over both gains steps over.
    region = wall_region(loop.in_floats(), TOLERANCE).region.reachable
    grid = Grid.over_walls(region.points, _RADIUS_POINTS)
    if not all(low < high for low, high in (grid.alphas, grid.betas)):
        return best._replace(status=np.array(TuningStatus.NO_STABLE_GAINS, np.int8))
    edges = (
        replace(grid, alphas=(0.0, 0.0), size=_EDGE_POINTS),
        replace(grid, betas=(0.0, 0.0), size=_EDGE_POINTS),
    )
    found = [smallest_radius_around(tuned, each) for each in (grid, *edges)]
    return min(found, key=lambda each: float(each.value))


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


def optimal_wall(
    loop: "HapticLoop",
    goal: Literal["radius", "settling"],
    stiffness: float | None,
    level: float,
    excitation: Excitation,
    chatter: Chatter | None,
) -> OptimalWall:
    """Return the wall that comes to rest fastest: ``HapticLoop.tune``."""
    checked_word("goal", goal, ("radius", "settling"))
    level = checked_level(level, excitation)
    alpha = None if stiffness is None else loop.alpha(checked_number("stiffness", stiffness, 0.0))
    tuned = _tuned(loop)
    tuned = tuned._replace(component=tuned.component._replace(lowest=0.0))
    best = _smallest_radius(loop, tuned) if alpha is None else smallest_radius_damping(tuned, alpha)
    if goal == "settling":
        best = shortest_settling(tuned, best, alpha is not None, level, excitation)
    wall, status = (float(best.alpha), float(best.beta)), TuningStatus(int(best.status))

    def radii(alphas: Numbers, betas: Numbers) -> np.ndarray:
        return np.asarray(tuned.spectral_radius(alphas, betas).value)

    def settling(alphas: Numbers, betas: Numbers) -> np.ndarray:
        return np.asarray(tuned.settling(alphas, betas, level=level, excitation=excitation).value)

    def likely(alphas: Numbers, betas: Numbers) -> np.ndarray:
        walls = loop.stiffness(alphas), loop.damping(betas)
        horizon = int(np.clip(_SLOWER * settling(*wall), 1 << 10, 1 << 16))
        options: dict[str, Any] = {"level": level, "excitation": excitation, "horizon": horizon}
        return likely_settling(loop.in_floats(), *walls, **options)

    reached = np.nan if chatter is None else float(chatter.amplitudes(loop, *wall))
    is_stable = status != TuningStatus.NO_STABLE_GAINS
    if chatter is not None and is_stable and not reached <= chatter.limit:
        for objective in (radii,) if goal == "radius" else (likely, settling):
            calm, reached, status = fastest_calm_wall(loop, objective, chatter, alpha)
            if status != TuningStatus.NOT_CALM:
                break
        wall = calm
    if status == TuningStatus.NOT_CALM or np.isnan(wall[0]):
        return OptimalWall(np.nan, np.nan, np.nan, np.inf, np.inf, status)
    radius = tuned.spectral_radius(*wall)
    return OptimalWall(
        loop.stiffness(wall[0]),
        loop.damping(wall[1]),
        float(radius.value),
        float(radius.error),
        float(settling(*wall)) * loop.sample_time,
        status,
        reached,
    )


def _tuned(loop: LoopParameters) -> TunedLoop:
    loop = loop.in_floats()
    if loop.body is None:
        return device_loop(loop)
    gamma, delta, delay = loop.slice.values()
    return mass_loop(gamma, delta, delay, given_filters(**loop.filters))


def checked_chatter(encoder: float | None, limit: float | None) -> Chatter | None:
    """The limit on how far an encoder may drive the position, if an encoder is given."""
    if encoder is None:
        if limit is not None:
            raise TypeError(f"chatter is {limit!r} without encoder; give its resolution in m.")
        return None
    encoder = checked_number("encoder", encoder, 0.0, is_open=True, unit="m")
    if limit is None:
        return Chatter(encoder)
    return Chatter(encoder, checked_number("chatter", limit, 0.0, is_open=True, unit="m"))
