"""The best wall: by radius or by settling time, with both gains free or with the stiffness given.

Settling counts whole samples, so it jumps. The search minimises the largest deviation from sample n
on instead, which is continuous in the gains. It lowers n for as long as the deviation can be
brought within the level. At the smallest n, the gains with the smallest deviation are taken: they
are unique, and lie inside the set of all gains that settle as fast.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Numbers
from jaxstab.conventions import Excitation, Verdict
from jaxstab.model import checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.model.filters import Filter, Velocity, given_filters
from jaxstab.motion.response import STRETCH, positions
from jaxstab.motion.settling import checked_level
from jaxstab.numbers import checked_number
from jaxstab.tuning.loops import TunedLoop, mass_loop
from jaxstab.tuning.radius import Component, OptimalGains, TuningStatus

# Grids of gains that zoom in on their best point.

FINE = 33  # points on an axis of the grids that zoom in
_NEIGHBOURS = 4  # steps of a grid to which the next one zooms in
_ZOOMS = 12


@dataclass(frozen=True)
class Grid:
    """Gains between two ends on each axis; a single value where the ends are equal.

    Those of grids around a point are at least ``lowest``.
    """

    alphas: tuple[float, float]
    betas: tuple[float, float]
    size: int
    lowest: float = -np.inf

    @classmethod
    def over_walls(cls, gains: np.ndarray, size: int, alpha: float | None = None) -> "Grid":
        """A grid over the walls, alpha and beta >= 0, among some gains; or over those of one alpha.

        Ends are out of order where there is none.
        """
        lowest = gains.min(axis=0, initial=np.inf)
        ends = np.maximum([lowest, gains.max(axis=0, initial=0.0)], 0.0)
        (left, low), (right, high) = ends.tolist()
        if alpha is None:
            return cls((left, right), (low, high), size, 0.0)
        return cls((alpha, alpha), (low, high), size**2, 0.0)

    @property
    def axes(self) -> list[Float64[np.ndarray, " gain"]]:
        """The gains on each axis."""
        ends = (self.alphas, self.betas)
        return [np.linspace(a, b, self.size if a < b else 1) for a, b in ends]

    @property
    def points(self) -> tuple[Float64[np.ndarray, "alpha 1"], Float64[np.ndarray, "1 beta"]]:
        """The gains as arrays that broadcast to the grid."""
        alphas, betas = self.axes
        return alphas[:, None], betas[None, :]

    def __getitem__(self, place: int) -> tuple[float, float]:
        alphas, betas = self.axes
        row, column = divmod(place, betas.size)
        return float(alphas[row]), float(betas[column])

    def around(self, point: tuple[float, float]) -> "Grid":
        """Zoom in on a few steps to each side of a point."""
        widths = (b - a for a, b in (self.alphas, self.betas))
        halves = (_NEIGHBOURS * width / (self.size - 1) for width in widths)
        alphas, betas = (
            (max(x - half, self.lowest), x + half) for x, half in zip(point, halves, strict=True)
        )
        return Grid(alphas, betas, FINE, self.lowest)


def zoomed(
    least: Callable[[Grid], tuple[float, int]], grid: Grid, enough: float = -np.inf
) -> tuple[tuple[float, float], float]:
    """Minimise over the gains; ``least`` returns the smallest value on a grid, and its place.

    The search ends early once ``enough`` is reached, and where no value is finite.
    """
    best, value = (np.nan, np.nan), np.inf
    for _ in range(_ZOOMS):
        lowest, place = least(grid)
        if lowest < value:
            best, value = grid[place], lowest
        if not enough < value < np.inf:
            break
        grid = grid.around(best)
    return best, value


_STEPS = np.geomspace(2.0**-24, 2.0**8, 129)  # from a stable point until the loop is unstable
_COARSE = 65  # points on an axis of the first grid
_SLOWEST = 1.0 / 16.0  # of the decay of the wall of the smallest radius
_NUMBERS = 1 << 20  # of an array that walls side by side fill, about
_DAMPINGS = np.geomspace(1e-7, 1e2, 600)  # of either sign, tried where the stiffness is given


def minimize_radius_damping(
    alpha: float,
    *,
    gamma: float,
    delta: float,
    delay: float,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> OptimalGains:
    """The damping beta with the smallest spectral radius, ``value``, for a given stiffness alpha.

    It is found by a scan over both signs and nine decades of beta, which zooms in on its best
    point. If two real poles meet there, beta is right to about 1e-14 and the radius to about 1e-8.
    With an estimator or a filter it is the best damping in the component that holds small positive
    gains; if that has no gains of this stiffness, the best one of an island, and the status says
    so. Source: eq. (9).

    beta may be negative, as of a strongly damped hand; ``HapticLoop.tune`` gives walls of B >= 0.

    Args and Raises: see ``jaxstab.conventions``; all are single numbers.

    Example:
        >>> best = jaxstab.minimize_radius_damping(0.05, gamma=0.0, delta=0.015, delay=1.0)
        >>> round(float(best.beta), 4), round(float(best.value), 4)
        (0.3203, 0.823)
    """
    require_x64(alpha, gamma, delta)
    loop = _one_loop(gamma, delta, delay, velocity, position)
    return smallest_radius_damping(loop, checked_number("alpha", checked_gain("alpha", alpha)))


def smallest_radius_damping(loop: TunedLoop, alpha: float) -> OptimalGains:
    """Return the damping with the smallest radius for a stiffness: ``minimize_radius_damping``."""
    lowest = loop.component.lowest
    betas = np.concatenate([-_DAMPINGS[::-1], [0.0], _DAMPINGS])
    betas = betas[betas >= lowest]
    radii = loop.radii(alpha, betas)
    if not radii.min() < 1.0:
        loop = loop._replace(component=Component(None, TuningStatus.ISLAND, lowest))
        radii = loop.radii(alpha, betas)
    middle = int(np.argmin(radii))
    around = betas[max(middle - 2, 0)], betas[min(middle + 2, betas.size - 1)]
    return smallest_radius_around(loop, Grid((alpha, alpha), around, FINE, lowest))


def smallest_radius_around(loop: TunedLoop, grid: Grid) -> OptimalGains:
    """Return the gains of the smallest radius that grids find which zoom in, from a first one."""

    def least(at: Grid) -> tuple[float, int]:
        values = loop.radii(*at.points)
        return float(np.min(values)), int(np.argmin(values))

    wall, radius = zoomed(least, grid)
    found_by = loop.component.status or TuningStatus.SCANNED
    status = found_by if radius < 1.0 else TuningStatus.NO_STABLE_GAINS
    return _as_gains(*wall, radius, status)


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
    loop = _one_loop(gamma, delta, delay, velocity, position)
    if alpha is not None:
        alpha = checked_number("alpha", checked_gain("alpha", alpha))
    start = loop.smallest_radius() if alpha is None else smallest_radius_damping(loop, alpha)
    return shortest_settling(loop, start, alpha is not None, level, excitation)


def shortest_settling(
    loop: TunedLoop,
    start: OptimalGains,
    is_stiffness_given: bool,
    level: float,
    excitation: Excitation,
) -> OptimalGains:
    """Return the gains that settle after the fewest samples, from those of the smallest radius."""
    settling = partial(loop.settling, level=level, excitation=excitation)
    samples = float(settling(start.alpha, start.beta).value)
    status = TuningStatus(int(start.status))
    if status == TuningStatus.NO_STABLE_GAINS or not isfinite(samples):
        return start._replace(value=np.array(np.inf))
    if status in (TuningStatus.ISLAND, TuningStatus.ANY_COMPONENT):
        loop = loop.anywhere()
    else:
        status = TuningStatus.SCANNED
    best = _fewest_samples(start, loop, level, excitation, int(samples), is_stiffness_given)
    reached = float(settling(*best).value)
    if not reached <= samples:  # a mode of the best wall leaves the level after what was seen
        return start._replace(value=np.array(samples), status=np.array(status, np.int8))
    return _as_gains(*best, reached, status)


def _fewest_samples(
    start: OptimalGains,
    loop: TunedLoop,
    level: float,
    excitation: Excitation,
    samples: int,
    is_stiffness_given: bool,
) -> tuple[float, float]:
    radius = float(loop.spectral_radius(start.alpha, start.beta).value)
    slowest = 1.0 - _SLOWEST * (1.0 - radius)
    settled = _Settled(level, samples, 2 * samples + 8, slowest)
    tails = partial(_smallest_tails, loop=loop, excitation=excitation, settled=settled)

    def least_after(sample: int) -> Callable[[Grid], tuple[float, int]]:
        def least(grid: Grid) -> tuple[float, int]:
            values, places = tails(grid)
            return float(values[sample]), int(places[sample])

        return least

    coarse = _stable_box(start, loop, is_stiffness_given)
    values, places = tails(coarse)
    best = (float(start.alpha), float(start.beta))
    within = np.flatnonzero(values <= level)
    if within.size and within[0] <= samples:
        samples, best = int(within[0]), coarse[int(places[within[0]])]
    while samples > 0:
        near = coarse.around(coarse[int(places[samples - 1])])
        point, tail = zoomed(least_after(samples - 1), near, enough=level)
        if tail > level:
            break
        samples, best = samples - 1, point
    calmest, tail = zoomed(least_after(samples), coarse.around(best))
    return calmest if tail <= level else best


def _stable_box(start: OptimalGains, loop: TunedLoop, is_stiffness_given: bool) -> Grid:
    """Return a box that reaches from the first gains to the edge of stability on each side."""
    alpha, beta = float(start.alpha), float(start.beta)

    def reach(along_alpha: float, along_beta: float) -> float:
        codes = loop.verdicts(alpha + along_alpha * _STEPS, beta + along_beta * _STEPS)
        outside = np.flatnonzero(codes != Verdict.STABLE)
        return float(_STEPS[outside[0] if outside.size else -1])

    lowest = loop.component.lowest
    betas = (max(beta - reach(0.0, -1.0), lowest), beta + reach(0.0, 1.0))
    if is_stiffness_given:
        return Grid((alpha, alpha), betas, _COARSE**2, lowest)
    alphas = (max(alpha - reach(-1.0, 0.0), lowest), alpha + reach(1.0, 0.0))
    return Grid(alphas, betas, _COARSE, lowest)


class _Settled(NamedTuple):
    """The level, the samples after which a wall is known to be within, and how many are seen.

    slowest: the largest radius that a device may have: one that rings for ever settles, too, where
        it rings within the level.
    """

    level: float
    samples: int
    length: int
    slowest: float


def _smallest_tails(
    grid: Grid, loop: TunedLoop, excitation: Excitation, settled: _Settled
) -> tuple[np.ndarray, np.ndarray]:
    """Return, for every sample, the smallest of all walls' largest deviations from then on."""
    alphas, betas = (np.ravel(gains) for gains in np.broadcast_arrays(*grid.points))
    size = loop.deviations(alphas[:1], betas[:1], excitation).transition.shape[1]
    count = max(1, _NUMBERS // (settled.length + size * (size + STRETCH)))
    smallest: list[tuple[np.ndarray, np.ndarray]] = []
    for begin in range(0, alphas.size, count):
        block = slice(begin, begin + count)
        loops = loop.deviations(alphas[block], betas[block], excitation)
        with np.errstate(all="ignore"):  # unstable walls overflow
            deviation = np.abs(positions(loops, settled.length))
            tails = np.maximum.accumulate(deviation[:, ::-1], axis=1)[:, ::-1]
            if excitation == "impact":
                tails = tails / tails[:, :1]
        tails = np.nan_to_num(tails, nan=np.inf, posinf=np.inf)
        tails[~loop.component.holds(alphas[block], betas[block])] = np.inf
        # A mode that grows, or keeps ringing, may be small for as long as this.
        quiet = np.flatnonzero(tails[:, settled.samples] <= settled.level)
        decays = loop.decays(alphas[block][quiet], betas[block][quiet], settled.slowest)
        tails[quiet[~decays]] = np.inf
        smallest.append((np.min(tails, axis=0), begin + np.argmin(tails, axis=0)))
    values, places = (np.array(column) for column in zip(*smallest, strict=True))
    best = np.argmin(values, axis=0), np.arange(values.shape[1])
    return values[best], places[best]


def _one_loop(
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None,
    position: Filter | None,
) -> TunedLoop:
    return mass_loop(
        checked_number("gamma", checked_gamma(gamma)),
        checked_number("delta", checked_delta(delta)),
        checked_number("delay", delay, 0.0),
        given_filters(velocity, position),
    )


def _as_gains(alpha: float, beta: float, value: float, status: TuningStatus) -> OptimalGains:
    point = [np.array(entry, np.float64) for entry in (alpha, beta, value)]
    return OptimalGains(point[0], point[1], point[2], np.array(status, np.int8))
