"""The walls of a loop that come to rest fastest, in SI units.

``minimize_settling`` has the wall that settles after the fewest samples, with both gains free or
the stiffness given. Settling counts whole samples, so it jumps. The search minimises the largest
deviation from sample n on instead, which is continuous in the gains. It lowers n for as long as the
deviation can be brought within the level. At the smallest n, the gains with the smallest deviation
are taken: they are unique, and lie inside the set of all gains that settle as fast.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from math import isfinite
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Numbers
from jaxstab.conventions import Excitation
from jaxstab.loop.region import TOLERANCE, Tuned, region_of_loop
from jaxstab.loop.usable import LikelyUsable, UsableLimits, usable_limits
from jaxstab.loop.wanted import WantedMargins
from jaxstab.model import checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.model.filters import Filter, Velocity, as_keywords, behind_measured, given_filters
from jaxstab.model.loop import LoopParameters, unit_loop
from jaxstab.motion.bounds import Settling, checked_level, likely_settling, loop_settling_samples
from jaxstab.motion.response import deviations
from jaxstab.numbers import checked_number, checked_word
from jaxstab.shown import shortened
from jaxstab.tuning import (
    Axis,
    Best,
    OptimalGains,
    TuningStatus,
    Values,
    Walls,
    found_gains,
    minimised,
    on_grid,
    smallest_radius,
    walls_of,
)


# ------------------------------------------------------------------------------- the fewest samples
class SearchedWalls(NamedTuple):
    """A loop in plain numbers, and all walls (alpha, beta) among which the best one is searched."""

    loop: LoopParameters
    walls: Walls

    def settling(self, alpha: Any, beta: Any, **options: Any) -> Settling:
        """The settling of walls in samples, for keywords ``level`` and ``excitation``."""
        wall = self.loop.stiffness(np.asarray(alpha)), self.loop.damping(np.asarray(beta))
        return loop_settling_samples(self.loop, *wall, **options)


def minimize_settling(
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    level: float = 0.02,
    alpha: Numbers | None = None,
    excitation: Excitation = "force",
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> OptimalGains:
    """The gains that settle after the fewest samples, for one slice.

    Both gains may be negative; ``HapticLoop.tune`` gives walls of K >= 0 and B >= 0. Many gains
    settle equally fast; those with the smallest deviation from then on are returned. The
    search covers all stable gains around those of the smallest radius with a grid and zooms in;
    with an estimator or a filter it stays in the component in which that radius was found.

    Args:
        gamma, delta, delay, velocity, position: see ``jaxstab.conventions``.
        level: half width of the band, between 0 and 1.
        alpha: wall stiffness K T^2/m if it is given; only beta is then chosen.
        excitation: "force" or "impact", see ``settling_samples``.

    Returns:
        OptimalGains of single numbers, ``value`` in samples, as ``settling_samples`` proves it.

    Raises: see ``jaxstab.conventions``.

    Source: the loop of eqs. (1)-(5); settling as in later papers of the same authors.

    Example:
        >>> best = jaxstab.minimize_settling(gamma=0.0, delta=0.015, delay=0.0)
        >>> int(best.value)  # samples
        6
    """
    level = checked_level(level, excitation)
    require_x64(alpha, gamma, delta)
    plant = (
        checked_number("gamma", checked_gamma(gamma)),
        checked_number("delta", checked_delta(delta)),
        checked_number("delay", delay, 0.0),
    )
    filters = as_keywords(given_filters(velocity, position))
    unit = unit_loop(*plant, **filters)
    loop = SearchedWalls(unit, walls_of(unit))
    if alpha is not None:
        alpha = checked_number("alpha", checked_gain("alpha", alpha))
    return shortest_settling(loop, smallest_radius(loop.walls, alpha), alpha, level, excitation)


def shortest_settling(
    loop: SearchedWalls, start: Best, alpha: float | None, level: float, excitation: Excitation
) -> OptimalGains:
    """Return the gains that settle after the fewest samples, from those of the smallest radius.

    ``alpha`` is the stiffness if it is given.
    """
    settling = partial(loop.settling, level=level, excitation=excitation)
    wall, status = start.wall, start.status
    samples = float(settling(*wall).value)
    if status == TuningStatus.NO_STABLE_GAINS or not isfinite(samples):
        return found_gains(wall, np.inf, status)
    if status in (TuningStatus.ISLAND, TuningStatus.ANY_COMPONENT):
        loop = loop._replace(walls=loop.walls._replace(main=None))
    else:
        status = TuningStatus.SCANNED
    best = _fewest_samples(loop, start, alpha, level, excitation, int(samples))
    reached = float(settling(*best).value)
    if not reached <= samples:  # a mode of the best wall leaves the level after what was seen
        best, reached = wall, samples
    return found_gains(best, reached, status)


def _fewest_samples(
    loop: SearchedWalls,
    start: Best,
    alpha: float | None,
    level: float,
    excitation: Excitation,
    samples: int,
) -> tuple[float, float]:
    samples_at_once = 256  # of the first grid that are kept
    # A mode that grows, or keeps ringing, may be small for as long as walls are seen.
    slowest = 1.0 - (1.0 - start.radius) / 16.0
    axes, lowest = _stable_box(loop.walls, start.wall, alpha), loop.walls.lowest

    def at(value: Callable[[np.ndarray], np.ndarray]) -> Values:
        """A value of the tails of walls (wall, sample): the largest deviations from then on.

        Those of gains elsewhere are infinite, and of those that are too slow and within the level.
        """

        def values(alphas: np.ndarray, betas: np.ndarray) -> np.ndarray:
            walls, parts = (loop.loop.stiffness(alphas), loop.loop.damping(betas)), []
            for own, deviation in deviations(loop.loop, *walls, excitation, 2 * samples + 8):
                alpha, beta = alphas[own], betas[own]
                with np.errstate(all="ignore"):
                    tails = np.maximum.accumulate(np.abs(deviation)[:, ::-1], axis=1)[:, ::-1]
                    if excitation == "impact":
                        tails = tails / tails[:, :1]
                tails = np.nan_to_num(tails, nan=np.inf, posinf=np.inf)
                tails[~loop.walls.holds(alpha, beta)] = np.inf
                quiet = np.flatnonzero(tails[:, samples] <= level)
                tails[quiet[~loop.walls.are_inside(alpha[quiet], beta[quiet], slowest)]] = np.inf
                parts.append(value(tails).copy())  # a view would keep all of the tails
            return np.concatenate(parts)

        return values

    def first_within(tails: np.ndarray) -> np.ndarray:
        return np.where(tails[:, -1] <= level, np.argmax(tails <= level, axis=1), np.inf)

    def near(wall: tuple[float, float]) -> tuple[Axis, Axis]:
        halves = [4.0 * (axis[-1] - axis[0]) / max(axis.size - 1, 1) for axis in axes]
        first, second = (
            np.linspace(max(x - half, lowest), x + half, 33 if half > 0.0 else 1)
            for x, half in zip(wall, halves, strict=True)
        )
        return first, second

    def tail_from(sample: int) -> Values:
        return at(lambda tails: tails[:, sample])

    @lru_cache(1)
    def on_axes(block: int) -> np.ndarray:
        own = slice(block * samples_at_once, (block + 1) * samples_at_once)
        return at(lambda tails: tails[:, own])(*on_grid(axes))

    best, fewest = minimised(at(first_within), axes, zooms=0)
    best, count = (best, int(fewest)) if fewest <= samples else (start.wall, samples)
    while count > 0:
        block, column = divmod(count - 1, samples_at_once)
        known = on_axes(block)[:, column], None
        # The whole set may be too coarse for what is left.
        for grid, first in zip((axes, near(best)), known, strict=True):
            point, tail = minimised(
                tail_from(count - 1), grid, first=first, enough=level, lowest=lowest
            )
            if tail <= level:
                break
        else:
            break
        (within,) = at(first_within)(*np.array(point)[:, None])
        count, best = min(count - 1, int(within)), point
    calmest, tail = minimised(tail_from(count), near(best), lowest=lowest)
    return calmest if tail <= level else best


def _stable_box(walls: Walls, wall: tuple[float, float], alpha: float | None) -> tuple[Axis, Axis]:
    """Return a grid that reaches from some gains to the edge of stability on each side."""
    steps = np.geomspace(2.0**-24, 2.0**8, 129)

    def reached(sign: float, place: int) -> float:
        gains = np.tile(wall, (steps.size, 1))
        gains[:, place] += sign * steps
        outside = np.flatnonzero(~(walls.radii(*gains.T) < 1.0))
        return float(gains[outside[0] if outside.size else -1, place])

    points = (1, 65**2) if alpha is not None else (65, 65)
    ends = [(max(reached(-1.0, k), walls.lowest), reached(1.0, k)) for k in range(2)]
    first, second = (np.linspace(*pair, count) for pair, count in zip(ends, points, strict=True))
    return (first if alpha is None else np.array([alpha])), second


# --------------------------------------------------------------------------------- the fastest wall
def wall_axes(
    outline: Float64[np.ndarray, "vertex 2"], stiffness: float | None
) -> tuple[Axis, Axis]:
    """A grid over the walls, both gains >= 0, that an outline encloses; or those of a stiffness."""
    low, high = np.maximum([outline.min(axis=0), outline.max(axis=0)], 0.0)
    if stiffness is None:
        return np.linspace(low[0], high[0], 25), np.linspace(low[1], high[1], 25)
    return np.array([stiffness]), np.linspace(low[1], high[1], 25**2)


class _Bounds(NamedTuple):
    """What a wall shall keep: a limit on its chatter, and margins, which few walls may have.

    ``most`` are the largest gains with the margins, (alpha, beta).
    """

    chatter: Values
    limit: float
    are_usable: Callable[[Any, Any], Any] | None = None
    most: tuple[float, float] = (np.inf, np.inf)


def fastest_wall_within(
    loop: Any, objective: Values, bounds: _Bounds, alpha: float | None
) -> tuple[float, float]:
    """The gains of the least objective found that keep the bounds; NaN if there are none."""
    region = region_of_loop(loop.in_floats(), TOLERANCE).region.reachable
    if not len(region.points):
        return np.nan, np.nan
    chatter, limit, are_usable, most = bounds

    def values(alphas: np.ndarray, betas: np.ndarray) -> np.ndarray:
        values, inside = np.full(alphas.size, np.inf), np.asarray(region.contains(alphas, betas))
        if are_usable:
            inside[inside] = are_usable(alphas[inside], betas[inside])
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

    axes = wall_axes(np.minimum(region.points, most), alpha)
    wall, _ = minimised(values, axes, zooms=3 if np.isinf(most[0]) else 6, lowest=0.0)
    return wall


def _at_rest(alphas: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.zeros(alphas.size)


def _fastest_usable_wall(
    loop: Any,
    usable: LikelyUsable,
    objectives: Sequence[Values],
    bounds: _Bounds,
    alpha: float | None,
) -> tuple[float, float]:
    """The gains of the least objective found that keep the bounds, and the margins, proved."""
    largest, rounds = _largest_usable(loop.in_floats(), usable.wanted), 8

    def are_usable(alphas: np.ndarray, betas: np.ndarray) -> np.ndarray:
        return usable(loop.stiffness(alphas), loop.damping(betas))

    bounds = bounds._replace(
        are_usable=are_usable, most=(loop.alpha(largest.first), loop.beta(largest.second))
    )
    for objective in objectives if np.isfinite(largest.first) else ():
        for _ in range(rounds):
            wall = fastest_wall_within(loop, objective, bounds, alpha)
            if np.isnan(wall[0]):
                break
            if usable.confirms(loop.stiffness(wall[0]), loop.damping(wall[1])):
                return wall
    return np.nan, np.nan


def optimal_wall(
    loop: Any,
    goal: Literal["radius", "settling"],
    stiffness: float | None,
    level: float,
    excitation: Excitation,
    encoder: float | None,
    chatter: float | None,
    wanted: WantedMargins,
) -> Tuned:
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
    has_walls = status != TuningStatus.NO_STABLE_GAINS
    reached = float(moved(*wall)) if step > 0.0 and has_walls else np.nan
    usable = LikelyUsable(loop, wanted) if wanted.texts and has_walls else None
    is_good = not usable or usable.confirms(*in_si_units(*wall))
    if has_walls and not (is_good and (np.isnan(reached) or reached <= limit)):
        options: dict[str, Any] = {"level": level, "excitation": excitation}
        fastest = float(tuned.settling(*wall, **options).value)

        def likely(*walls: np.ndarray) -> np.ndarray:
            horizon = int(np.clip(slower * fastest, 1 << 10, 1 << 16))
            return likely_settling(plain, *in_si_units(*walls), **options, horizon=horizon)

        def proved(*walls: np.ndarray) -> np.ndarray:
            return np.asarray(tuned.settling(*walls, **options).value)

        objectives = (tuned.walls.radii,) if goal == "radius" else (likely, proved)
        bounds = _Bounds(moved if step > 0.0 else _at_rest, limit)
        if usable:
            wall = _fastest_usable_wall(loop, usable, objectives, bounds, alpha)
        else:
            walls = (fastest_wall_within(loop, own, bounds, alpha) for own in objectives)
            wall = next((own for own in walls if np.isfinite(own[0])), (np.nan, np.nan))
        missed = TuningStatus.NOT_USABLE if usable else TuningStatus.NOT_CALM
        status = TuningStatus.SCANNED if np.isfinite(wall[0]) else missed
        reached = float(moved(*wall)) if step > 0.0 and np.isfinite(wall[0]) else np.nan
    if np.isnan(wall[0]):
        return Tuned(np.nan, np.nan, np.nan, np.inf, status, np.inf)
    gains = loop.stiffness(wall[0]) if given is None else given, loop.damping(wall[1])
    radius = loop.spectral_radius(*gains)
    settling = np.nan  # of a velocity that is measured, the radius alone is known
    if loop.velocity is None or behind_measured(loop.velocity) is None:
        found = loop.settling_time(*gains, level=level, excitation=excitation)
        settling = float(found.value)
    return Tuned(*gains, float(radius.value), float(radius.error), status, settling, reached)


@lru_cache(maxsize=16)
def _largest_usable(plain: Any, wanted: WantedMargins) -> UsableLimits:
    """The largest usable gains of a loop: scenes are tuned for several walls."""
    return usable_limits(plain, wanted)


@lru_cache(maxsize=16)
def _of_smallest_radius(plain: Any, alpha: float | None) -> tuple[SearchedWalls, Best]:
    """A loop and its wall of the smallest radius, where the search for fast settling begins, too.

    The most recent ones are remembered: scenes are tuned for both goals.
    """
    tuned = SearchedWalls(plain, walls_of(plain)._replace(lowest=0.0))
    return tuned, smallest_radius(tuned.walls, alpha)
