"""The stable set in an (alpha, beta) plane: outline, corners, extremes, limits and distances."""

from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from math import isfinite, sqrt

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float64, Int

from jaxstab.model import checked_delay, checked_gain, require_x64
from jaxstab.region import measures
from jaxstab.region.crossings import crossings
from jaxstab.region.curve import SliceCoefficients, slice_coefficients
from jaxstab.region.outline import Outline, extra_vertices, polygon
from jaxstab.region.pieces import Arcs, find_arcs
from jaxstab.region.scan import (
    are_among,
    closer_angles,
    hiding_places,
    most_places,
    nearly_stable,
    scan_angles,
)

# Fineness of the scan, slots for arcs, and the places to look closer at: how far other roots may
# be outside of the circle there. The last ones take the places of the best chances only.
_SCANS = ((1, 4, 1e-4), (4, 32, 1e-4), (16, 128, 1e-4), (64, 256, 1e-7))
_EMPTY_FINENESS = 4
_ROUNDS = 8
_POINTS = (256, 1024, 4096, 16384, 65536)
_BULGE = 0.2  # times points^-2 is about how far the boundary leaves the polygon
_FINEST = 1e-10
_ROUNDING = 1e-13


class RegionStatus(IntEnum):
    """What is known of a stable region.

    COMPLETE: the pieces that were found close to loops. EMPTY: the scan found none.
    UNRESOLVED: the pieces do not close, or there are more than the arrays hold. Such a region
    claims nothing: it has no points and its numbers are NaN. ``contains`` is False everywhere, as
    for no point it is known that it is stable; it does not mean that points are unstable.
    """

    COMPLETE = 0
    EMPTY = 1
    UNRESOLVED = 2


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class StableRegion:
    """The gains (alpha, beta) for which all roots of p(z) lie inside of a circle about 0.

    ``stable_region`` makes one; ``region_outline`` makes one, or many under ``jax.vmap``, in
    compiled code. Limits, ``contains``, ``distance`` and ``area`` are those of the exact boundary,
    not of the polygon.

    Attributes:
        coefficients: what the exact boundary is made of.
        outline: the polygon in arrays of one length.
        status: a RegionStatus.
        max_alpha: the point (alpha, beta) of the largest alpha; NaN where there is none.
        max_beta: the point (alpha, beta) of the largest beta; NaN where there is none.

    Source: design of eq. (9): the D-decomposition, of which the pieces around the stable set are
    kept.
    """

    coefficients: SliceCoefficients
    outline: Outline
    status: Array
    max_alpha: Array
    max_beta: Array

    @property
    def is_empty(self) -> bool:
        """Whether no (alpha, beta) is stable."""
        return int(self.status) == RegionStatus.EMPTY

    @property
    def points(self) -> Float64[np.ndarray, "point 2"]:
        """The outline as points (alpha, beta), counter-clockwise, the last one equal to the first.

        Of several loops each is closed, one follows the other, and the branch between them is -1.
        """
        return np.asarray(self.outline.vertices)[: int(self.outline.size)]

    @property
    def branch(self) -> Int[np.ndarray, " piece"]:
        """The Branch of each piece between two points: which root is on the circle there."""
        return np.asarray(self.outline.branches)[: max(int(self.outline.size) - 1, 0)]

    @property
    def corners(self) -> Float64[np.ndarray, "corner 2"]:
        """The points where two branches meet, in the order of the outline, to full precision.

        That is to a few rounding errors, also next to the Nyquist frequency; regions of undamped
        hands closer to it than a relative 1e-6 may be UNRESOLVED.
        """
        corners: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
        corners = np.asarray(self.outline.corners)
        return corners[np.isfinite(corners[:, 0])]

    @property
    def loops(self) -> int:
        """The number of closed curves that bound the region."""
        return int(self.outline.loops)

    @property
    def rows_are_intervals(self) -> bool:
        """Whether each line of constant beta meets the region in one interval of alpha, or not."""
        return self._are_intervals(axis=1)

    @property
    def columns_are_intervals(self) -> bool:
        """Whether each line of constant alpha meets the region in one interval of beta, or not."""
        return self._are_intervals(axis=0)

    def _are_intervals(self, axis: int) -> bool:
        known = int(self.status) != RegionStatus.UNRESOLVED
        return known and self.loops <= 1 and _turns(self.points[:, axis]) <= 2

    @property
    def area(self) -> Float64[Array, ""]:
        """The area in the (alpha, beta) plane; holes are taken off. NaN for UNRESOLVED.

        To rounding, but for undamped hands next to the Nyquist frequency: with
        e = |sqrt(gamma)/pi - 1| the relative error there is up to about 1e-16/e.
        """
        enclosed: Array = measures.area(self.coefficients, self.outline)
        return enclosed

    def alpha_limits(self, beta: ArrayLike) -> Float64[Array, "*grid 2"]:
        """Return the least and the largest alpha of the region in rows of constant beta.

        Args:
            beta: wall damping B T/m, any shape.

        Returns:
            Array (*grid, 2), differentiable; NaN where the row misses the region. Where
            ``rows_are_intervals`` is False there may be unstable alpha between the two.

        Raises:
            ValueError: beta is NaN or infinite.
        """
        rows = jnp.asarray(checked_gain("beta", beta), jnp.float64)
        least_and_most: Array = measures.limits(self.coefficients, self.outline, rows, axis=1)
        return least_and_most

    def beta_limits(self, alpha: ArrayLike) -> Float64[Array, "*grid 2"]:
        """Return the least and the largest beta of the region in columns of constant alpha.

        Args:
            alpha: wall stiffness K T^2/m, any shape.

        Returns:
            Array (*grid, 2), differentiable; NaN where the column misses the region. Where
            ``columns_are_intervals`` is False there may be unstable beta between the two.

        Raises:
            ValueError: alpha is NaN or infinite.
        """
        columns = jnp.asarray(checked_gain("alpha", alpha), jnp.float64)
        least_and_most: Array = measures.limits(self.coefficients, self.outline, columns, axis=0)
        return least_and_most

    def contains(self, alpha: ArrayLike, beta: ArrayLike) -> Array:
        """Return whether points lie inside of the exact boundary.

        Args:
            alpha: wall stiffness K T^2/m, any shape; it broadcasts with beta.
            beta: wall damping B T/m.

        Returns:
            A boolean array of the broadcast shape; all False for UNRESOLVED, which claims nothing.

        Raises:
            ValueError: alpha or beta is NaN or infinite.
        """
        points = _checked_points(alpha, beta)
        inside: Array = measures.contains(self.coefficients, self.outline, *points)
        return inside

    def distance(self, alpha: ArrayLike, beta: ArrayLike) -> Float64[Array, "*grid"]:
        """Return the Euclidean distance to the boundary, positive inside and negative outside.

        Args:
            alpha: wall stiffness K T^2/m, any shape; it broadcasts with beta.
            beta: wall damping B T/m.

        Returns:
            Array of the broadcast shape; -inf for an empty region, NaN for UNRESOLVED.

        Raises:
            ValueError: alpha or beta is NaN or infinite.
        """
        points = _checked_points(alpha, beta)
        signed: Array = measures.distance(self.coefficients, self.outline, *points)
        return signed


def stable_region(
    gamma: float,
    delta: float,
    delay: float,
    radius: float = 1.0,
    tolerance: float = 1e-6,
) -> StableRegion:
    """Return the set of all (alpha, beta) with every root of p(z) inside of a circle.

    Every corner is where the curve crosses itself or a line: all crossings are searched for, and
    the scan of the boundary is refined around them until its pieces close to loops. What may be
    missed are crossings where the curve bends more, between two angles of the first scan, than a
    cubic with the same ends and tangents.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.
        radius: the circle's radius in (0, 1]: 1 for stability, less for a decay rate.
        tolerance: largest distance between the polygon and the boundary, as a share of the
            region's diameter, > 1e-10.

    Returns:
        StableRegion, with its status. An empty region is an answer, not an error.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.
    """
    require_x64()
    if not (isfinite(tolerance) and tolerance > _FINEST):
        raise ValueError(f"tolerance is {tolerance}; give a number > {_FINEST:g}.")
    c = slice_coefficients(gamma, delta, delay, radius)
    arcs = _refined_arcs(c, _padded_length(delay), may_be_empty=delta == 0.0 or radius < 1.0)
    slots = len(arcs.exists)
    points = _enough_points(max(sqrt(_BULGE / tolerance), 2.0 * extra_vertices(slots)))
    region: StableRegion = _region(c, arcs, points=points)
    deviation = float(measures.deviation(c, region.outline))
    if region.status == RegionStatus.COMPLETE and deviation > tolerance:
        points = _enough_points(1.2 * points * sqrt(deviation / tolerance))
        region = _region(c, arcs, points=points)
    return region


def region_outline(
    gamma: ArrayLike,
    delta: ArrayLike,
    delay: float,
    radius: ArrayLike = 1.0,
    *,
    points: int = 256,
    slots: int = 4,
    fineness: int = 1,
) -> StableRegion:
    """Return the stable set in compiled code of fixed sizes, for jit, vmap and derivatives.

    Unlike ``stable_region`` it neither searches for crossings nor refines: check the status of each
    lane. A cut into the set may lie between two angles of the scan; then a test of every fourth
    vertex makes the lane UNRESOLVED in most cases. Of 115,000 random hands 4 had one unnoticed.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4], a scalar; traced or not.
        delta: physical damping b T/m in [0, 1e3], a scalar; traced or not.
        delay: time delay t_d/T >= 0 in samples, concrete.
        radius: the circle's radius in (0, 1], a scalar; traced or not.
        points: length of the outline; the last point is repeated where fewer are needed.
        slots: the largest number of arcs of the curve; more of them are UNRESOLVED.
        fineness: how often the steps of the scan are divided.

    Returns:
        StableRegion with arrays of fixed sizes. ``max_alpha``, ``max_beta``, ``outline`` and the
        limits are differentiable once in gamma, delta and radius.

    Raises:
        ValueError: a concrete argument is outside its range, or ``points`` is too small.
        TypeError: the delay is traced.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.
    """
    require_x64()
    if points < 2 * extra_vertices(slots):
        raise ValueError(
            f"points is {points}; give at least {2 * extra_vertices(slots)} for {slots} slots."
        )
    length = _length(delay)
    c = slice_coefficients(gamma, delta, delay, radius)
    arcs = _arcs(c, jnp.asarray(scan_angles(length, fineness)), length=length, slots=slots)
    region: StableRegion = _region(c, arcs, points=points, length=length)
    return region


def _refined_arcs(c: SliceCoefficients, length: int, *, may_be_empty: bool) -> Arcs:
    """Return arcs that close to loops and at whose ends nothing more hides.

    With damping the loop without a wall is stable: an empty answer is then a scan too coarse. Where
    even the finest scan is not enough, ``resolved`` of the arcs is False.
    """
    places = crossings(c, scan_angles(length, 1))
    for fineness, slots, outside in _SCANS:
        scan = scan_angles(length, fineness)
        places = nearly_stable(c, places, outside, length=length)
        for _ in range(_ROUNDS):
            angles = closer_angles(scan, places, slots)
            arcs: Arcs = _arcs(c, jnp.asarray(angles), length=length, slots=slots)
            if not arcs.exists[0]:
                break
            known, places = places, hiding_places(c, arcs, places, outside, length=length)
            if len(places) > most_places(slots):
                break
            if are_among(places, known):
                if arcs.resolved:
                    return arcs
                break
        if may_be_empty and fineness >= _EMPTY_FINENESS and not arcs.exists[0]:
            return arcs
    return arcs._replace(resolved=jnp.asarray(False))


def _enough_points(wanted: float) -> int:
    return next((points for points in _POINTS if points >= wanted), _POINTS[-1])


def _length(delay: float) -> int:
    """Return how many coefficients the polynomials of the other roots have."""
    return int(np.floor(checked_delay(delay))) + 3


def _padded_length(delay: float) -> int:
    """Return a power of two, at least 4: delays alike share what is compiled."""
    return max(4, 1 << (_length(delay) - 1).bit_length())


_arcs = jax.jit(find_arcs, static_argnames=("length", "slots"))


@partial(jax.jit, static_argnames=("points", "length"))
def _region(
    c: SliceCoefficients, arcs: Arcs, *, points: int, length: int | None = None
) -> StableRegion:
    outline = polygon(c, arcs, points, length)
    largest = jnp.argmax(jnp.nan_to_num(outline.vertices, nan=-jnp.inf), axis=0)
    found = jnp.where(jnp.any(arcs.exists), RegionStatus.COMPLETE, RegionStatus.EMPTY)
    status = jnp.where(outline.resolved, found, RegionStatus.UNRESOLVED)
    return StableRegion(
        coefficients=c,
        outline=outline,
        status=status.astype(jnp.int8),
        max_alpha=outline.vertices[largest[0]],
        max_beta=outline.vertices[largest[1]],
    )


def _turns(coordinate: Float64[np.ndarray, " point"]) -> int:
    """Return how often a closed sequence changes between rising and falling."""
    if not coordinate.size:
        return 0
    steps = np.diff(coordinate)
    ways = np.sign(np.where(np.abs(steps) > _ROUNDING * np.ptp(coordinate), steps, 0.0))
    ways = ways[ways != 0]
    return int(np.sum(ways != np.roll(ways, 1)))


def _checked_points(alpha: ArrayLike, beta: ArrayLike) -> tuple[Array, Array]:
    stiffness = jnp.asarray(checked_gain("alpha", alpha), jnp.float64)
    damping = jnp.asarray(checked_gain("beta", beta), jnp.float64)
    broadcast = jnp.broadcast_arrays(stiffness, damping)
    return broadcast[0], broadcast[1]
