"""The walls that settle after the fewest samples, with both gains free or the stiffness given.

Settling counts whole samples, so it jumps. The search minimises the largest deviation from sample n
on instead, which is continuous in the gains. It lowers n for as long as the deviation can be
brought within the level. At the smallest n, the gains with the smallest deviation are taken: they
are unique, and lie inside the set of all gains that settle as fast.
"""

from collections.abc import Callable
from functools import lru_cache, partial
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from jaxstab.arrays import Numbers
from jaxstab.conventions import Excitation
from jaxstab.model import checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.model.filters import Filter, Velocity, as_keywords, given_filters
from jaxstab.model.loop import LoopParameters, unit_loop
from jaxstab.motion.response import deviations
from jaxstab.motion.settling import Settling, checked_level, loop_settling_samples
from jaxstab.numbers import checked_number
from jaxstab.tuning.radius import (
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


class TunedLoop(NamedTuple):
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
    loop = TunedLoop(unit, walls_of(unit))
    if alpha is not None:
        alpha = checked_number("alpha", checked_gain("alpha", alpha))
    return shortest_settling(loop, smallest_radius(loop.walls, alpha), alpha, level, excitation)


def shortest_settling(
    loop: TunedLoop, start: Best, alpha: float | None, level: float, excitation: Excitation
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
    loop: TunedLoop,
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
