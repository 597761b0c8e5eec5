"""The walls of a loop that come to rest fastest, in SI units."""

from decimal import ROUND_CEILING
from math import isnan
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.conventions import Excitation
from jaxstab.loop.region import TOLERANCE, wall_region
from jaxstab.model.filters import behind_measured
from jaxstab.motion.settling import checked_level, likely_settling
from jaxstab.numbers import checked_number, checked_word
from jaxstab.shown import exact_text, number_text, text_with_bound
from jaxstab.tuning import TuningStatus
from jaxstab.tuning.radius import Axis, Values, minimised, smallest_radius
from jaxstab.tuning.settling import TunedLoop, shortest_settling

if TYPE_CHECKING:
    from jaxstab.loop.loop import HapticLoop


def wall_axes(
    outline: Float64[np.ndarray, "vertex 2"], stiffness: float | None
) -> tuple[Axis, Axis]:
    """A grid over the walls, both gains >= 0, that an outline encloses; or those of a stiffness."""
    low, high = np.maximum([outline.min(axis=0), outline.max(axis=0)], 0.0)
    if stiffness is None:
        return np.linspace(low[0], high[0], 25), np.linspace(low[1], high[1], 25)
    return np.array([stiffness]), np.linspace(low[1], high[1], 25**2)


class Chatter(NamedTuple):
    """The resolution of an encoder in m, and how far it may drive the position, in m."""

    encoder: float
    limit: float = np.inf

    def amplitudes(self, loop: "HapticLoop", alpha: Any, beta: Any) -> np.ndarray:
        """Proved amplitudes of walls in m."""
        wall = loop.stiffness(alpha), loop.damping(beta)
        return np.asarray(loop.amplitude(*wall, encoder=self.encoder).position)


def fastest_calm_wall(
    loop: "HapticLoop", objective: Values, chatter: Chatter, alpha: float | None
) -> tuple[tuple[float, float], TuningStatus]:
    """The gains of the least objective found within the limit, and a status."""
    region = wall_region(loop.in_floats(), TOLERANCE).region.reachable
    if not len(region.points):
        return (np.nan, np.nan), TuningStatus.NO_STABLE_GAINS

    def values(alphas: np.ndarray, betas: np.ndarray) -> np.ndarray:
        values, inside = np.full(alphas.size, np.inf), np.asarray(region.contains(alphas, betas))
        likely = np.full(alphas.size, np.inf)
        likely[inside] = np.nan_to_num(objective(alphas[inside], betas[inside]), nan=np.inf)
        for value in np.unique(likely[np.isfinite(likely)]):  # the fastest walls first
            walls = np.flatnonzero(likely == value)
            reached = np.asarray(chatter.amplitudes(loop, alphas[walls], betas[walls]))
            calm = reached <= chatter.limit
            if np.any(calm):  # of equally fast walls the calmest one is the least
                values[walls[calm]] = value + 1e-9 * reached[calm] / chatter.limit
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
    chatter: Chatter | None,
) -> OptimalWall:
    """Return the wall that comes to rest fastest: ``HapticLoop.tune``."""
    slower = 64  # than the fastest wall: how slow calm walls are looked for at first
    checked_word("goal", goal, ("radius", "settling"))
    level = checked_level(level, excitation)
    alpha = None if stiffness is None else loop.alpha(checked_number("stiffness", stiffness, 0.0))
    tuned = TunedLoop.from_loop(loop.in_floats())
    tuned = tuned._replace(walls=tuned.walls._replace(lowest=0.0))
    best = smallest_radius(tuned.walls, alpha)
    wall, status = best.wall, best.status
    if goal == "settling":
        settled = shortest_settling(tuned, best, alpha, level, excitation)
        wall = float(settled.alpha), float(settled.beta)
        status = TuningStatus(int(settled.status))
    reached = np.nan if chatter is None else float(chatter.amplitudes(loop, *wall))
    is_stable = status != TuningStatus.NO_STABLE_GAINS
    if chatter is not None and is_stable and not reached <= chatter.limit:
        options: dict[str, Any] = {"level": level, "excitation": excitation}
        fastest = float(tuned.settling(*wall, **options).value)

        def likely(alphas: np.ndarray, betas: np.ndarray) -> np.ndarray:
            walls = loop.stiffness(alphas), loop.damping(betas)
            horizon = int(np.clip(slower * fastest, 1 << 10, 1 << 16))
            return likely_settling(loop.in_floats(), *walls, **options, horizon=horizon)

        def proved(alphas: np.ndarray, betas: np.ndarray) -> np.ndarray:
            return np.asarray(tuned.settling(alphas, betas, **options).value)

        for objective in (tuned.walls.radii,) if goal == "radius" else (likely, proved):
            wall, status = fastest_calm_wall(loop, objective, chatter, alpha)
            if status != TuningStatus.NOT_CALM:
                break
        reached = float(chatter.amplitudes(loop, *wall)) if np.isfinite(wall[0]) else np.nan
    if np.isnan(wall[0]):
        return OptimalWall(np.nan, np.nan, np.nan, np.inf, np.inf, status)
    gains = loop.stiffness(wall[0]), loop.damping(wall[1])
    radius = loop.spectral_radius(*gains)
    settling = np.nan  # of a velocity that is measured, the radius alone is known
    if loop.velocity is None or behind_measured(loop.velocity) is None:
        found = loop.settling_time(*gains, level=level, excitation=excitation)
        settling = float(found.value)
    return OptimalWall(*gains, float(radius.value), float(radius.error), settling, status, reached)


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
