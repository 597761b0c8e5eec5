"""The largest stiffness and damping, and the limits of each at the other, by the closed form.

On a line of constant beta (or alpha) the curve and the line z = -1 are met at places that follow
from the closed form; z = 1 is met at alpha = -gamma. Between two neighbouring places the number of
unstable roots is the same, so one certified verdict decides each interval.
"""

from collections.abc import Callable
from math import pi
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Float64

from jaxstab.conventions import Verdict
from jaxstab.host_search import found_on_host
from jaxstab.model import HapticLoop, checked_gain, require_x64
from jaxstab.point import verdict
from jaxstab.region.curve import curve_point, minus_offset, slice_coefficients

Values = Float64[np.ndarray, " values"]
Limits = Float64[np.ndarray, "values 2"]
Pairs = Float64[np.ndarray, "2 values"]

_ANGLES = 4096  # of the curve, for each 64 samples of delay
_BATCH = 512  # angles, and walls to judge, at once: one size, compiled once
_MOST_STEPS, _ULPS = 120, 4  # of the search for a root: when it ends
_ROWS = 48
_ZOOMS = 9
_PIECE = 1e-9  # of the size of the region: shorter intervals are rounding


class WallLimits(NamedTuple):
    """The stiffest and the most damped wall, in SI units; NaN where no wall is stable.

    ``stiffness`` is the largest stable K in N/m, reached at the damping ``at_damping`` in N s/m;
    ``damping`` is the largest stable B in N s/m, reached at the stiffness ``at_stiffness`` in N/m.
    All four are limits: stable walls come as close as one likes.
    """

    stiffness: float
    at_damping: float
    damping: float
    at_stiffness: float


def wall_limits(loop: HapticLoop) -> WallLimits:
    """Return the largest stiffness and the largest damping that a loop allows.

    Args:
        loop: device, hand, sample time and delay.

    Returns:
        WallLimits in SI units.

    Raises:
        ValueError: the dimensionless parameters are out of range.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.
    """
    require_x64()
    plane = Plane(loop)
    alpha, beta = plane.farthest(0)
    other_alpha, other_beta = plane.farthest(1)
    return WallLimits(
        loop.stiffness(alpha),
        loop.damping(beta),
        loop.damping(other_beta),
        loop.stiffness(other_alpha),
    )


def stiffest_wall(loop: HapticLoop) -> tuple[float, float]:
    """Return the largest stable stiffness in N/m and its damping in N s/m, as ``wall_limits``."""
    alpha, beta = Plane(loop).farthest(0)
    return loop.stiffness(alpha), loop.damping(beta)


def stiffness_limits(loop: HapticLoop, damping: ArrayLike) -> Float64[np.ndarray, "*grid 2"]:
    """Return the least and the largest stable stiffness at given dampings.

    Args:
        loop: device, hand, sample time and delay.
        damping: B of the wall in N s/m, any shape.

    Returns:
        Array (*grid, 2) in N/m; NaN where no stiffness is stable. Where the stable stiffnesses are
        more than one interval, it is the one that reaches farthest.

    Raises:
        ValueError: a damping is infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.
    """
    require_x64()
    values = np.asarray(checked_gain("damping", damping), np.float64)
    limits = Plane(loop).limits(loop.beta(values.ravel()), 0)
    return loop.stiffness(limits).reshape(*values.shape, 2)


def damping_limits(loop: HapticLoop, stiffness: ArrayLike) -> Float64[np.ndarray, "*grid 2"]:
    """Return the least and the largest stable damping at given stiffnesses.

    Args:
        loop: device, hand, sample time and delay.
        stiffness: K of the wall in N/m, any shape.

    Returns:
        Array (*grid, 2) in N s/m; NaN where no damping is stable. Where the stable dampings are
        more than one interval, it is the one that reaches farthest.

    Raises:
        ValueError: a stiffness is infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.
    """
    require_x64()
    values = np.asarray(checked_gain("stiffness", stiffness), np.float64)
    limits = Plane(loop).limits(loop.alpha(values.ravel()), 1)
    return loop.damping(limits).reshape(*values.shape, 2)


def boundary_distance(
    loop: HapticLoop, stiffness: ArrayLike, damping: ArrayLike
) -> Float64[Array, "*grid"]:
    """Return how far stable walls are from the edge of stability, in the (alpha, beta) plane.

    The way to a root on the unit circle, whichever, is meant: from a stable wall the nearest one
    lies on the edge. From an unstable wall it is the nearest point where some root crosses.

    Args:
        loop: device, hand, sample time and delay.
        stiffness: K of the wall in N/m, any shape; broadcasts with the damping.
        damping: B of the wall in N s/m.

    Returns:
        The distance in units of alpha and beta, positive for a stable wall, negative otherwise.
        Each wall is searched by itself, outside of JAX: vmap goes through, jit does not.
        Differentiable once in K and B.

    Raises:
        ValueError: a gain is infinite or NaN.
        TypeError: a gain is traced by jit.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.
    """
    require_x64()
    alpha = loop.alpha(jnp.asarray(checked_gain("stiffness", stiffness), jnp.float64))
    beta = loop.beta(jnp.asarray(checked_gain("damping", damping), jnp.float64))
    side, near_alpha, near_beta = jnp.moveaxis(
        found_on_host(Plane(loop).nearest, 3, alpha, beta), -1, 0
    )
    # To first order the nearest point may stay where it is when the wall moves.
    distance: Array = side * jnp.hypot(alpha - near_alpha, beta - near_beta)
    return distance


def highest(tops: Callable[[Values], Values], low: float, high: float) -> tuple[float, float]:
    """Return the largest value of a function and where it is; NaN rows are passed over.

    The function has one peak between neighbours of the best of the first rows.
    """
    best = (np.nan, np.nan)
    for _ in range(_ZOOMS):
        rows = np.linspace(low, high, _ROWS)
        found = tops(rows)
        if np.isnan(found).all():
            break
        top = int(np.nanargmax(found))
        if not found[top] <= best[0]:
            best = (float(found[top]), float(rows[top]))
        step = rows[1] - rows[0]
        low, high = best[1] - step, best[1] + step
    return best


class Plane:
    """The curve of one loop at many angles; axis 0 is alpha, axis 1 is beta."""

    def __init__(self, loop: HapticLoop) -> None:
        self.plant = (loop.gamma, loop.delta, loop.delay_samples)
        self.slice = slice_coefficients(*self.plant)
        # Evenly, but finer towards both ends, where the curve runs to corners or to infinity.
        count = _ANGLES * (1 + int(loop.delay_samples) // 64)
        half = np.geomspace(1e-6, 1e-2, count // 8)
        inner = np.linspace(1e-2, pi - 1e-2, count - 2 * half.size + 2)[1:-1]
        self.angles = np.concatenate([half, inner, pi - half[::-1]])
        self.points = self._curve(self.angles)
        self.line = float(minus_offset(self.slice))  # alpha + 2 beta on the line z = -1

    def limits(self, values: Values, axis: int) -> Limits:
        """Return the farthest stable interval of this axis at values of the other one."""
        places = self._places(values, axis)
        low, high = places[:, :-1], places[:, 1:]
        with np.errstate(invalid="ignore"):
            middle = 0.5 * (low + high)
            wide = high - low > _PIECE * (np.abs(low) + np.abs(high))
        exists = np.isfinite(middle)
        wide &= exists
        walls = np.stack(np.broadcast_arrays(middle, values[:, None]))
        stable = np.zeros_like(wide)
        stable[wide] = self._is_stable(*walls[:: 1 - 2 * axis, wide])
        narrow = (exists & ~wide)[:, 1:-1]
        stable[:, 1:-1] |= narrow & stable[:, :-2] & stable[:, 2:]
        last = stable.shape[1] - 1 - np.argmax(stable[:, ::-1], axis=1)
        # Neighbouring stable intervals are one: only part of the curve bounds the region.
        first = last.copy()
        rows = np.arange(len(values))
        for _ in range(stable.shape[1]):
            joins = (first > 0) & stable[rows, np.maximum(first - 1, 0)]
            first = np.where(joins, first - 1, first)
        found = stable.any(axis=1)
        ends = np.stack([low[rows, first], high[rows, last]], axis=-1)
        return np.where(found[:, None], ends, np.nan)

    def farthest(self, axis: int) -> tuple[float, float]:
        """Return the point (alpha, beta) of the largest alpha or beta; NaN if none is stable."""
        top, row = highest(lambda rows: self.limits(rows, axis)[:, 1], *self.span(axis))
        return (top, row) if axis == 0 else (row, top)

    def span(self, axis: int) -> tuple[float, float]:
        """Return between which values of the other axis the region lies; NaN for an empty one."""
        across = self._edge_points()[:, 1 - axis]
        return (float(across.min()), float(across.max())) if across.size else (np.nan, np.nan)

    def nearest(self, wall: Float64[np.ndarray, " 2"]) -> Float64[np.ndarray, " 3"]:
        """Return 1 or -1 for a stable wall or not, and the nearest point with a root on the circle.

        Of a wall (alpha, beta), and as (alpha, beta).
        """
        alpha, beta = wall
        angles = self.angles
        for _ in range(4):
            curve = self._curve(angles)
            place = int(np.argmin(np.hypot(*(curve - wall).T)))
            ends = angles[max(place - 2, 0)], angles[min(place + 2, angles.size - 1)]
            angles = np.linspace(*ends, _BATCH)
        candidates = [curve[place], np.array([-self.plant[0], beta])]
        if np.isfinite(self.line):
            candidates.append(wall - 0.2 * (alpha + 2.0 * beta - self.line) * np.array([1.0, 2.0]))
        side = 1.0 if self._is_stable(wall[:1], wall[1:])[0] else -1.0
        return np.array([side, *min(candidates, key=lambda point: np.hypot(*(point - wall)))])

    def _places(self, values: Values, axis: int) -> Float64[np.ndarray, "values places"]:
        """Return where a root is on the circle, in ascending order, padded with NaN."""
        across = self.points[:, 1 - axis]
        above = across[None, :] > values[:, None]
        row, place = np.nonzero(above[:, 1:] != above[:, :-1])
        ends = np.stack([self.angles[place], self.angles[place + 1]])
        excess = np.stack([across[place], across[place + 1]]) - values[row]
        angles = self._roots(ends, excess, values[row], axis)
        met = self._curve(angles)[:, axis]
        order = np.arange(len(row)) - np.searchsorted(row, row)
        places = np.full((len(values), int(order.max(initial=-1)) + 3), np.nan)
        places[row, order] = met
        line = self.line - 2.0 * values if axis == 0 else 0.5 * (self.line - values)
        places[:, -1] = np.where(np.isfinite(line), line, np.nan)
        if axis == 0:
            places[:, -2] = -self.plant[0]
        places.sort(axis=1)
        return places

    def _roots(self, ends: Pairs, excess: Pairs, values: Values, axis: int) -> Values:
        """Return the angles between ``ends`` at which the curve takes values of the other axis.

        False position, where the weight of an end that stays is halved (Illinois); every third step
        halves the interval.
        """
        columns = np.arange(len(values))
        noise = _ULPS * np.spacing(np.abs(values) + np.abs(excess).max(axis=0))
        shortest = _ULPS * np.spacing(ends[0])
        last = np.full(len(values), -1)
        for step in range(_MOST_STEPS):
            begin, end = ends
            if np.all(end - begin <= 2.0 * shortest):
                break
            with np.errstate(invalid="ignore", divide="ignore"):
                share = excess[0] / (excess[0] - excess[1])
            is_usable = (share > 0.0) & (share < 1.0) & (step % 3 != 2)
            middle = begin + np.where(is_usable, share, 0.5) * (end - begin)
            middle = np.clip(middle, begin + shortest, np.maximum(end - shortest, begin))
            found = self._curve(middle)[:, 1 - axis] - values
            side = np.where((found > 0.0) == (excess[0] > 0.0), 0, 1)  # the end that moves
            excess[1 - side, columns] *= np.where(side == last, 0.5, 1.0)
            ends[side, columns], excess[side, columns], last = middle, found, side
            is_met = np.abs(found) <= noise
            ends[:, is_met] = middle[is_met]
        angles: Values = 0.5 * (ends[0] + ends[1])
        return angles

    def _edge_points(self) -> Float64[np.ndarray, "points 2"]:
        """Return points of the curve with stable walls beside them."""
        step = np.gradient(self.points, axis=0)
        size = np.hypot(*step.T)
        with np.errstate(invalid="ignore", divide="ignore"):
            normal = np.stack([-step[:, 1], step[:, 0]], axis=-1) / size[:, None]
        beside = self.points + 1e-3 * size[:, None] * normal
        finite = np.isfinite(beside).all(axis=1) & (np.abs(beside) < 1e6).all(axis=1)
        stable = self._is_stable(*np.where(finite[:, None], beside, 1e6).T)
        edges: Float64[np.ndarray, "points 2"] = self.points[finite & stable]
        return edges

    def _curve(self, angles: Values) -> Float64[np.ndarray, "values 2"]:
        padded = np.pad(angles, (0, -len(angles) % _BATCH), constant_values=1.0)
        chunks = [
            np.stack(curve_point(self.slice, jnp.asarray(chunk)), axis=-1)
            for chunk in padded.reshape(-1, _BATCH)
        ]
        points: Float64[np.ndarray, "values 2"]
        points = np.concatenate([np.zeros((0, 2)), *chunks])[: len(angles)]
        return points

    def _is_stable(self, alpha: Values, beta: Values) -> Bool[np.ndarray, " values"]:
        padding = (0, -len(alpha) % _BATCH)
        walls = np.pad(alpha, padding), np.pad(beta, padding)
        codes = [
            np.asarray(verdict(a, b, *self.plant))
            for a, b in zip(*(w.reshape(-1, _BATCH) for w in walls), strict=True)
        ]
        stable: Bool[np.ndarray, " values"]
        stable = np.concatenate([np.zeros(0), *codes])[: len(alpha)] == Verdict.STABLE
        return stable
