"""The best wall: by radius or by settling time, with both gains free or with the stiffness given.

Settling counts whole samples, so it jumps. What is minimised instead is the largest deviation from
sample n on, which is continuous in the gains, for one n after the other, downwards, as long as the
deviation can be brought within the level. At the least n, the gains with the smallest deviation are
taken: they are unique, and inside the set of all gains that settle as fast.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import ceil, isfinite, log2
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from jaxtyping import Float64

from jaxstab.conventions import Verdict
from jaxstab.model import (
    HapticLoop,
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    require_x64,
)
from jaxstab.motion.response import Motion
from jaxstab.motion.settling import (
    Excitation,
    Lanes,
    advanced,
    check_options,
    excited,
    lanes_of,
    settling_samples,
)
from jaxstab.point.radius.door import spectral_radius
from jaxstab.point.verdict.door import verdict
from jaxstab.tuning.radius import OptimalGains, TuningStatus, least_radius, one_number

_STEPS = np.geomspace(2.0**-24, 2.0**8, 129)  # from a stable point until the loop is unstable
_COARSE, _FINE = 129, 33  # points on an axis of the first grid and of those that zoom in
_NEIGHBOURS = 4  # steps of a grid to which the next one zooms in
_ZOOMS = 12
_DAMPINGS = np.geomspace(1e-7, 1e2, 600)  # of either sign, tried where the stiffness is given


class OptimalWall(NamedTuple):
    """The best wall in SI units, and what it reaches."""

    stiffness: float
    damping: float
    radius: float
    settling_time: float
    status: TuningStatus


def optimal_gains(
    loop: HapticLoop,
    goal: Literal["radius", "settling"] = "settling",
    *,
    stiffness: float | None = None,
    level: float = 0.02,
    excitation: Excitation = "force",
) -> OptimalWall:
    """Return the wall (K, B) that comes to rest fastest, or the best B for a given K.

    A search for one loop, without vmap or derivatives; ``least_radius`` has both over gamma and
    delta.

    Args:
        loop: device, hand, sample time and delay.
        goal: "radius", the smallest spectral radius, or "settling", the smallest settling time.
        stiffness: K in N/m if it is given; only the damping is then chosen.
        level: half width of the band of the settling time, between 0 and 1.
        excitation: what the settling time refers to, see ``settling_samples``.

    Returns:
        OptimalWall: stiffness in N/m, damping in N s/m, spectral radius per sample, settling time
        in s (infinite without a stable wall), and a TuningStatus.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN, or an unknown word.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9); settling as in later papers of the same authors.
    """
    require_x64()
    if goal not in ("radius", "settling"):
        raise ValueError(f'goal is {goal!r}; give "radius" or "settling".')
    check_options(level, excitation)
    plant = (loop.gamma, loop.delta, loop.delay_samples)
    alpha = None if stiffness is None else loop.alpha(float(stiffness))
    if goal == "settling":
        best = least_settling(*plant, level, alpha=alpha, excitation=excitation)
    elif alpha is None:
        best = least_radius(*plant)
    else:
        best = least_radius_damping(alpha, *plant)
    scene = (best.alpha, best.beta, *plant)
    settling = settling_samples(*scene, level, excitation=excitation).value
    return OptimalWall(
        loop.stiffness(float(best.alpha)),
        loop.damping(float(best.beta)),
        float(spectral_radius(*scene).value),
        float(settling) * loop.sample_time,
        TuningStatus(int(best.status)),
    )


def least_radius_damping(
    alpha: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> OptimalGains:
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
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9).
    """
    require_x64()
    plant = _one_plant(gamma, delta, delay)
    alpha = one_number("alpha", checked_gain("alpha", alpha))
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


def least_settling(
    gamma: ArrayLike,
    delta: ArrayLike,
    delay: ArrayLike,
    level: float = 0.02,
    *,
    alpha: ArrayLike | None = None,
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
        RuntimeError: JAX's x64 mode is off.

    Source: the loop of eqs. (1)-(5); settling as in later papers of the same authors.
    """
    require_x64()
    check_options(level, excitation)
    plant = _one_plant(gamma, delta, delay)
    start = least_radius(*plant) if alpha is None else least_radius_damping(alpha, *plant)
    settles = partial(settling_samples, level=level, excitation=excitation)
    samples = float(settles(start.alpha, start.beta, *plant).value)
    if int(start.status) == TuningStatus.NO_STABLE_GAINS or not isfinite(samples):
        return start._replace(value=jnp.full((), jnp.inf))
    best = _least_samples(start, plant, level, excitation, int(samples), alpha is not None)
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


def _least_samples(
    start: OptimalGains,
    plant: tuple[float, float, float],
    level: float,
    excitation: Excitation,
    samples: int,
    is_stiffness_given: bool,
) -> tuple[float, float]:
    length = 2 ** ceil(log2(2 * samples + 8))
    tails = partial(_least_tails, impact=excitation == "impact", length=length)

    def least_after(sample: int) -> Callable[[_Grid], tuple[float, int]]:
        def least(grid: _Grid) -> tuple[float, int]:
            values, places = tails(lanes_of(*grid.points, *plant)[0])
            return float(values[sample]), int(places[sample])

        return least

    coarse = _stable_box(start, plant, is_stiffness_given)
    values, places = (np.asarray(x) for x in tails(lanes_of(*coarse.points, *plant)[0]))
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


def _stable_box(
    start: OptimalGains, plant: tuple[float, float, float], is_stiffness_given: bool
) -> _Grid:
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


@partial(jax.jit, static_argnames=("impact", "length"))
def _least_tails(lanes: Lanes, *, impact: bool, length: int) -> tuple[Array, Array]:
    """Return, for every sample, the smallest of all lanes' largest deviations from then on."""

    def tail(lane: Lanes) -> Array:
        def step(motion: Motion, _: None) -> tuple[Motion, Array]:
            return advanced(lane, motion), jnp.abs(motion.position)

        _, deviation = lax.scan(step, excited(lane, impact=impact), length=length)
        reference = jnp.max(deviation) if impact else 1.0
        return lax.cummax(deviation, reverse=True) / reference

    tails = jnp.nan_to_num(jax.vmap(tail)(lanes), nan=jnp.inf, posinf=jnp.inf)
    return jnp.min(tails, axis=0), jnp.argmin(tails, axis=0)


def _one_plant(gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike) -> tuple[float, float, float]:
    return (
        one_number("gamma", checked_gamma(gamma)),
        one_number("delta", checked_delta(delta)),
        one_number("delay", checked_delay(delay)),
    )


def _as_gains(alpha: float, beta: float, value: float, status: TuningStatus) -> OptimalGains:
    point = [jnp.asarray(number, jnp.float64) for number in (alpha, beta, value)]
    return OptimalGains(point[0], point[1], point[2], jnp.asarray(int(status), jnp.int8))
