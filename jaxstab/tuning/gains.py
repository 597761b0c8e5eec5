"""The best wall: by radius or by settling time, with both gains free or with the stiffness given.

Settling counts whole samples, so it jumps. What is minimised instead is the largest deviation from
sample n on, which is continuous in the gains, for one n after the other, downwards, as long as the
deviation can be brought within the level. At the least n, the gains with the smallest deviation are
taken: they are unique, and inside the set of all gains that settle as fast.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import isfinite

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Numbers
from jaxstab.conventions import Verdict
from jaxstab.model import checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.motion.response import propagator
from jaxstab.motion.settling import (
    Excitation,
    checked_level,
    loops_of,
    positions,
    settling_samples,
)
from jaxstab.numbers import checked_number
from jaxstab.point.radius.door import spectral_radius
from jaxstab.point.verdict.door import verdict
from jaxstab.tuning.radius import OptimalGains, TuningStatus, minimize_radius

Plant = tuple[float, float, float]

_STEPS = np.geomspace(2.0**-24, 2.0**8, 129)  # from a stable point until the loop is unstable
_COARSE, _FINE = 65, 33  # points on an axis of the first grid and of those that zoom in
_NEIGHBOURS = 4  # steps of a grid to which the next one zooms in
_ZOOMS = 12
_NUMBERS = 1 << 20  # of an array that walls side by side fill, about
_DAMPINGS = np.geomspace(1e-7, 1e2, 600)  # of either sign, tried where the stiffness is given


def minimize_radius_damping(alpha: float, gamma: float, delta: float, delay: float) -> OptimalGains:
    """Return the damping beta with the smallest spectral radius for a given stiffness alpha.

    Found by a scan over both signs and nine decades of beta, and by zooming in on its best point.
    Where two real poles meet there, beta is right to about 1e-14 and the radius to about 1e-8.

    Args:
        alpha: wall stiffness K T^2/m, one number, like all arguments.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples.

    Returns:
        OptimalGains of single numbers, ``value`` the radius.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN.
        TypeError: an argument is not one number.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9).
    """
    require_x64(alpha, gamma, delta)
    plant = _one_plant(gamma, delta, delay)
    alpha = checked_number("alpha", checked_gain("alpha", alpha))
    betas = np.concatenate([-_DAMPINGS[::-1], [0.0], _DAMPINGS])
    radii = np.asarray(spectral_radius(alpha, betas, *plant).value)
    middle = int(radii.argmin())
    around = betas[max(middle - 2, 0)], betas[min(middle + 2, betas.size - 1)]

    def least(at: _Grid) -> tuple[float, int]:
        values = np.asarray(spectral_radius(*at.points, *plant).value)
        return float(values.min()), int(values.argmin())

    (_, beta), radius = _zoomed(least, _Grid((alpha, alpha), around, _FINE))
    status = TuningStatus.SCANNED if radius < 1.0 else TuningStatus.NO_STABLE_GAINS
    return _as_gains(alpha, beta, radius, status)


def minimize_settling(
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    level: float = 0.02,
    *,
    alpha: Numbers | None = None,
    excitation: Excitation = "force",
) -> OptimalGains:
    """Return the gains that settle after the fewest samples.

    Many gains do: those whose deviation from then on is the smallest are returned. The search looks
    at all stable gains around those of the smallest radius, on a grid, and zooms in.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4], one number, like all arguments.
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples.
        level: half width of the band, between 0 and 1.
        alpha: wall stiffness K T^2/m if it is given; only beta is then chosen.
        excitation: "force" or "impact", see ``settling_samples``.

    Returns:
        OptimalGains of single numbers, ``value`` in samples, as ``settling_samples`` proves it.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN, or an unknown word.
        TypeError: an argument is not one number.
        RuntimeError: JAX arrays are given without x64.

    Source: the loop of eqs. (1)-(5); settling as in later papers of the same authors.
    """
    level = checked_level(level, excitation)
    require_x64(alpha, gamma, delta)
    plant = _one_plant(gamma, delta, delay)
    start = minimize_radius(*plant) if alpha is None else minimize_radius_damping(alpha, *plant)
    settles = partial(settling_samples, level=level, excitation=excitation)
    samples = float(settles(start.alpha, start.beta, *plant).value)
    if int(start.status) == TuningStatus.NO_STABLE_GAINS or not isfinite(samples):
        return start._replace(value=np.array(np.inf))
    best = _fewest_samples(start, plant, level, excitation, int(samples), alpha is not None)
    reached = settles(*best, *plant).value
    return _as_gains(*best, float(reached), TuningStatus.SCANNED)


@dataclass(frozen=True)
class _Grid:
    """Gains between two ends on each axis; a single value where the ends are equal."""

    alphas: tuple[float, float]
    betas: tuple[float, float]
    size: int

    @property
    def axes(self) -> list[Float64[np.ndarray, " gain"]]:
        ends = (self.alphas, self.betas)
        return [np.linspace(a, b, self.size if a < b else 1) for a, b in ends]

    @property
    def points(self) -> tuple[Float64[np.ndarray, "alpha 1"], Float64[np.ndarray, "1 beta"]]:
        alphas, betas = self.axes
        return alphas[:, None], betas[None, :]

    def __getitem__(self, place: int) -> tuple[float, float]:
        alphas, betas = self.axes
        row, column = divmod(place, betas.size)
        return float(alphas[row]), float(betas[column])

    def around(self, point: tuple[float, float]) -> "_Grid":
        """Zoom in on a few steps to each side of a point."""
        widths = (b - a for a, b in (self.alphas, self.betas))
        halves = (_NEIGHBOURS * width / (self.size - 1) for width in widths)
        alphas, betas = ((x - half, x + half) for x, half in zip(point, halves, strict=True))
        return _Grid(alphas, betas, _FINE)


def _zoomed(
    least: Callable[[_Grid], tuple[float, int]], grid: _Grid, enough: float = -np.inf
) -> tuple[tuple[float, float], float]:
    """Minimise over the gains; ``least`` gives the smallest value on a grid, and its place.

    The search ends early once ``enough`` is reached.
    """
    best, value = (np.nan, np.nan), np.inf
    for _ in range(_ZOOMS):
        found, place = least(grid)
        if found < value:
            best, value = grid[place], found
        if value <= enough:
            break
        grid = grid.around(best)
    return best, value


def _fewest_samples(
    start: OptimalGains,
    plant: Plant,
    level: float,
    excitation: Excitation,
    samples: int,
    is_stiffness_given: bool,
) -> tuple[float, float]:
    tails = partial(_smallest_tails, plant=plant, excitation=excitation, length=2 * samples + 8)

    def least_after(sample: int) -> Callable[[_Grid], tuple[float, int]]:
        def least(grid: _Grid) -> tuple[float, int]:
            values, places = tails(grid)
            return float(values[sample]), int(places[sample])

        return least

    coarse = _stable_box(start, plant, is_stiffness_given)
    values, places = tails(coarse)
    best = (float(start.alpha), float(start.beta))
    within = np.flatnonzero(values <= level)
    if within.size and within[0] <= samples:
        samples, best = int(within[0]), coarse[int(places[within[0]])]
    while samples > 0:
        near = coarse.around(coarse[int(places[samples - 1])])
        point, tail = _zoomed(least_after(samples - 1), near, enough=level)
        if tail > level:
            break
        samples, best = samples - 1, point
    calmest, tail = _zoomed(least_after(samples), coarse.around(best))
    return calmest if tail <= level else best


def _stable_box(start: OptimalGains, plant: Plant, is_stiffness_given: bool) -> _Grid:
    """Return a box that reaches from the first gains to the edge of stability on each side."""
    alpha, beta = float(start.alpha), float(start.beta)

    def reach(along_alpha: float, along_beta: float) -> float:
        codes = verdict(alpha + along_alpha * _STEPS, beta + along_beta * _STEPS, *plant)
        outside = np.flatnonzero(np.asarray(codes) != Verdict.STABLE)
        return float(_STEPS[outside[0] if outside.size else -1])

    betas = (beta - reach(0.0, -1.0), beta + reach(0.0, 1.0))
    if is_stiffness_given:
        return _Grid((alpha, alpha), betas, _COARSE**2)
    return _Grid((alpha - reach(-1.0, 0.0), alpha + reach(1.0, 0.0)), betas, _COARSE)


def _smallest_tails(
    grid: _Grid, plant: Plant, excitation: str, length: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return, for every sample, the smallest of all walls' largest deviations from then on."""
    gamma, delta, delay = plant
    entries = propagator(gamma, delta, delay % 1.0, np.ones(1))[0, :, :4].reshape(8, 1)
    alphas, betas = (np.ravel(gains) for gains in np.broadcast_arrays(*grid.points))
    count = max(1, _NUMBERS // (length + (4 + int(delay)) ** 2 * 32))
    smallest: list[tuple[np.ndarray, np.ndarray]] = []
    for begin in range(0, alphas.size, count):
        some = slice(begin, begin + count)
        same = np.broadcast_to(entries, (8, alphas[some].size))
        loops = loops_of(alphas[some], betas[some], same, int(delay), excitation)
        with np.errstate(all="ignore"):  # unstable walls overflow
            deviation = np.abs(positions(loops, length))
            tails = np.maximum.accumulate(deviation[:, ::-1], axis=1)[:, ::-1]
            if excitation == "impact":
                tails = tails / tails[:, :1]
        tails = np.nan_to_num(tails, nan=np.inf, posinf=np.inf)
        smallest.append((np.min(tails, axis=0), begin + np.argmin(tails, axis=0)))
    values, places = (np.array(part) for part in zip(*smallest, strict=True))
    best = np.argmin(values, axis=0), np.arange(values.shape[1])
    return values[best], places[best]


def _one_plant(gamma: Numbers, delta: Numbers, delay: Numbers) -> Plant:
    return (
        checked_number("gamma", checked_gamma(gamma)),
        checked_number("delta", checked_delta(delta)),
        checked_number("delay", delay, 0.0),
    )


def _as_gains(alpha: float, beta: float, value: float, status: TuningStatus) -> OptimalGains:
    point = [np.array(number, np.float64) for number in (alpha, beta, value)]
    return OptimalGains(point[0], point[1], point[2], np.array(status, np.int8))
