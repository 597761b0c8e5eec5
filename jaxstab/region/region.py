"""The stable set in an (alpha, beta) plane: outline, corners, extremes, limits and distances."""

from dataclasses import dataclass
from math import ceil, sqrt

import numpy as np
from jaxtyping import Bool, Float64, Int

from jaxstab.arrays import Array, Numbers, float_arrays, is_traced, namespace, pytree, stored
from jaxstab.batches import compiled
from jaxstab.model import checked_gain, require_x64
from jaxstab.model.filters import Filter, Filters, Velocity, given_filters
from jaxstab.model.linear_loop import LinearLoop, filtered_loop
from jaxstab.model.loop import refuses_loops
from jaxstab.model.parameters import DELTA_LIMIT, GAMMA_LIMIT, whole_and_fraction
from jaxstab.numbers import checked_count, checked_number
from jaxstab.region import measures
from jaxstab.region.audit import is_contradicted
from jaxstab.region.components import components_of, holds_small_gains
from jaxstab.region.curve import SliceCoefficients, mass_coefficients, slice_coefficients
from jaxstab.region.outline import Outline, extra_vertices, polygon
from jaxstab.region.pieces import Pieces, find_pieces
from jaxstab.region.scan import scan_angles
from jaxstab.region.search import coefficient_count, refined_pieces
from jaxstab.region.shown import ShownRegion
from jaxstab.region.status import RegionStatus

LONGEST_DELAY = 500.0  # samples: the work grows as the third power
_FEWEST_POINTS, _MOST_POINTS = 256, 65536
_BULGE = 0.35  # times points^-2 is at most about how far the boundary leaves the polygon
_FINEST = 1e-10


@pytree
@dataclass(frozen=True, repr=False)
class StableRegion(ShownRegion):
    """The gains (alpha, beta) for which all roots of p(z) lie inside of a circle about 0.

    ``stable_region`` makes one of NumPy arrays; ``region_outline`` makes one in arrays of fixed
    sizes, also of JAX, or many under ``jax.vmap``. Limits, ``contains``, ``distance`` and ``area``
    are those of the exact boundary, not of the polygon; JAX arrays in give JAX arrays out.

    Attributes:
        coefficients: what the exact boundary is made of.
        outline: the polygon in arrays of one length.
        status: a RegionStatus.
        max_alpha: the point (alpha, beta) of the largest alpha; NaN where there is none.
        max_beta: the point (alpha, beta) of the largest beta; NaN where there is none.

    Source: eq. (9) by the D-decomposition, of which the pieces around the stable set are kept.

    Example:
        >>> round(float(jaxstab.stable_region(0.0, 0.0, 0.0).area), 6)
        0.909645
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
        return np.asarray(self.outline.vertices)[: int(self.outline.size)] + 0.0  # no -0

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
        corners = np.asarray(self.outline.corners) + 0.0
        return corners[np.isfinite(corners[:, 0])]

    @property
    def components(self) -> list["StableRegion"]:
        """The connected parts of the region: first the one that holds small gains, then by area.

        Estimators cut islands off. All are there whose boundary the search found, as for the
        region itself: see ``stable_region``.
        """
        if int(self.outline.size) == 0:
            return []
        outlines = components_of(self.coefficients, self.outline)
        return [_of_outline(self.coefficients, outline) for outline in outlines]

    @property
    def main(self) -> "StableRegion | None":
        """The component that holds small positive gains: what turning gains up from 0 reaches.

        None where small positive gains are not stable.
        """
        return next(filter(_holds_small_gains, self.components[:1]), None)

    @property
    def islands(self) -> list["StableRegion"]:
        """The components that turning gains up from 0 does not reach, the largest first."""
        components = self.components
        return components[any(map(_holds_small_gains, components[:1])) :]

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
        return known and self.loops <= 1 and measures.turns(self.points[:, axis]) <= 2

    @property
    def area(self) -> Float64[Array, ""]:
        """The area in the (alpha, beta) plane; holes are taken off. NaN for UNRESOLVED.

        To rounding, but for undamped hands next to the Nyquist frequency: with
        e = |sqrt(gamma)/pi - 1| the relative error there is up to about 1e-16/e.
        """
        return measures.area(self.coefficients, self.outline)

    def alpha_limits(self, beta: Numbers) -> Float64[Array, "*grid 2"]:
        """Return the least and the largest alpha of the region in rows of constant beta.

        Args:
            beta: wall damping B T/m, any shape.

        Returns:
            Array (*grid, 2), differentiable; NaN where the row misses the region. Where
            ``rows_are_intervals`` is False there may be unstable alpha between the two.

        Raises:
            ValueError: beta is NaN or infinite.
        """
        (rows,) = float_arrays(checked_gain("beta", beta))
        return measures.limits(self.coefficients, self.outline, rows, axis=1)

    def beta_limits(self, alpha: Numbers) -> Float64[Array, "*grid 2"]:
        """Return the least and the largest beta of the region in columns of constant alpha.

        Args:
            alpha: wall stiffness K T^2/m, any shape.

        Returns:
            Array (*grid, 2), differentiable; NaN where the column misses the region. Where
            ``columns_are_intervals`` is False there may be unstable beta between the two.

        Raises:
            ValueError: alpha is NaN or infinite.
        """
        (columns,) = float_arrays(checked_gain("alpha", alpha))
        return measures.limits(self.coefficients, self.outline, columns, axis=0)

    def contains(self, alpha: Numbers, beta: Numbers) -> Bool[Array, "*grid"]:
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
        return measures.contains(self.coefficients, self.outline, *points)

    def distance(self, alpha: Numbers, beta: Numbers) -> Float64[Array, "*grid"]:
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
        return measures.distance(self.coefficients, self.outline, *points)


@refuses_loops("region()")
def stable_region(
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    radius: Numbers = 1.0,
    tolerance: Numbers = 1e-6,
    *,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> StableRegion:
    """Return the set of all (alpha, beta) with every root of p(z) inside of a circle.

    Every corner is where the curve crosses itself or a line: all crossings are searched for, and
    the scan of the boundary is refined around them until its pieces close to loops. What may be
    missed are crossings where the curve bends more, between two angles of the first scan, than a
    cubic with the same ends and tangents, and, with filters, parts of it at which another root is
    beyond 1.1. That all components are found is argued so, not proved (docs/proofs.md, G1 to G3).

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4], a number like all arguments.
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T in samples, whole or fractional, in [0, 500].
        radius: the circle's radius in (0, 1]: 1 for stability, less for a decay rate.
        tolerance: largest distance between the polygon and the boundary, as a share of the
            region's diameter, > 1e-10.
        velocity: the velocity estimator in units of one sample; None for the difference over one
            sample, the wall of the paper. The radius is 1 with it.
        position: the position filter in units of one sample; None for none.

    Returns:
        StableRegion of NumPy arrays, with its status. An empty region is an answer, not an error.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN.
        TypeError: an argument is traced by JAX (``region_outline`` takes tracers), or no number.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

    Example:
        >>> region = jaxstab.stable_region(0.0, 0.0, 0.0)
        >>> round(float(region.max_alpha[0]), 9)  # 12 - 8 sqrt(2)
        0.686291501
    """
    if any(map(is_traced, (gamma, delta, delay, radius, tolerance))):
        raise TypeError(
            "stable_region searches outside of JAX; under jit, vmap and grad call region_outline."
        )
    plant = (
        checked_number("gamma", gamma, 0.0, GAMMA_LIMIT),
        checked_number("delta", delta, 0.0, DELTA_LIMIT),
        checked_number("delay", delay, 0.0, LONGEST_DELAY, unit="samples"),
        checked_number("radius", radius, 0.0, 1.0, is_open=True),
    )
    smallest = checked_number("tolerance", tolerance, _FINEST, is_open=True)
    filters = given_filters(velocity, position)
    if filters and plant[3] != 1.0:
        raise ValueError(f"radius is {plant[3]:g}; with a filter only 1 is answered.")
    return _stable_region(*plant, smallest, filters)


def region_outline(
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    radius: Numbers = 1.0,
    *,
    points: int = 256,
    slots: int = 4,
    fineness: int = 1,
) -> StableRegion:
    """Return the stable set in arrays of fixed sizes, for jit, vmap and derivatives.

    Unlike ``stable_region`` it neither searches for crossings nor refines: check the status of each
    lane. A cut into the set may lie between two angles of the scan; then a test of every fourth
    vertex makes the lane UNRESOLVED in most cases. Of 115,000 random hands 4 had one unnoticed.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4], a scalar; traced or not.
        delta: physical damping b T/m in [0, 1e3], a scalar; traced or not.
        delay: time delay t_d/T >= 0 in samples, concrete.
        radius: the circle's radius in (0, 1], a scalar; traced or not.
        points: length of the outline; the last point is repeated where fewer are needed.
        slots: the largest number of pieces of the curve; more of them are UNRESOLVED.
        fineness: how often the steps of the scan are divided.

    Returns:
        StableRegion of arrays of fixed sizes, of JAX where an argument is. There ``max_alpha``,
        ``max_beta``, ``outline`` and the limits are differentiable once in gamma, delta and radius.

    Raises:
        ValueError: a concrete argument is outside its range, or ``points`` is too small.
        TypeError: the delay is traced, or a count is no whole number.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

    Example:
        >>> round(float(jaxstab.region_outline(0.001, 0.015, 1.0).max_alpha[0]), 6)
        0.15172
    """
    require_x64(gamma, delta, radius)
    slots, fineness = checked_count("slots", slots, 1), checked_count("fineness", fineness, 1)
    least = 2 * extra_vertices(slots)
    if checked_count("points", points, 0) < least:
        raise ValueError(f"points is {points}; give at least {least} for {slots} slots.")
    length = coefficient_count(float(whole_and_fraction(delay)[0]))
    c = stored(slice_coefficients(gamma, delta, delay, radius))
    angles = namespace(c).asarray(scan_angles(length, fineness))
    pieces = _pieces(c, angles, length=length, slots=slots)
    return _region(c, pieces, points=points, length=length)


@compiled()
def _stable_region(
    gamma: float,
    delta: float,
    delay: float,
    radius: float,
    tolerance: float,
    filters: Filters | None,
) -> StableRegion:
    may_be_empty = delta == 0.0 or radius < 1.0
    if not filters:
        c = slice_coefficients(gamma, delta, delay, radius)
        return region_of(c, delay, tolerance, may_be_empty=may_be_empty)
    c = mass_coefficients(gamma, delta, delay, filters)
    loop = filtered_loop(np.float64(gamma), np.float64(delta), int(delay), delay % 1.0, filters)
    return region_of(c, delay, tolerance, may_be_empty=may_be_empty, loop=loop)


def region_of(
    c: SliceCoefficients,
    delay: float,
    tolerance: float,
    *,
    may_be_empty: bool,
    loop: LinearLoop | None = None,
) -> StableRegion:
    """Return the region of a slice, UNRESOLVED if verdicts of the loop contradict it."""
    pieces = refined_pieces(c, delay, may_be_empty=may_be_empty)
    fewest = max(_FEWEST_POINTS, 2 * extra_vertices(len(pieces.exists)))
    points = _enough_points(sqrt(_BULGE / tolerance), fewest)
    region = _region(c, pieces, points=points)
    deviation = float(measures.deviation(c, region.outline))
    if region.status == RegionStatus.COMPLETE and deviation > tolerance:
        points = _enough_points(1.2 * points * sqrt(deviation / tolerance), fewest)
        region = _region(c, pieces, points=points)
    if loop is not None and region.outline.resolved and is_contradicted(c, region.outline, loop):
        region = _region(c, pieces._replace(resolved=np.bool_(False)), points=points)
    return region


def _enough_points(wanted: float, fewest: int) -> int:
    return max(fewest, min(ceil(wanted), _MOST_POINTS))


_pieces = compiled(static=("length", "slots"))(find_pieces)


@compiled(static=("points", "length"))
def _region(
    c: SliceCoefficients, pieces: Pieces, *, points: int, length: int | None = None
) -> StableRegion:
    return _of_outline(c, polygon(c, pieces, points, length))


def _of_outline(c: SliceCoefficients, outline: Outline) -> StableRegion:
    xp = namespace(c, outline)
    largest = xp.argmax(xp.nan_to_num(outline.vertices, nan=-xp.inf), axis=0)
    known = xp.where(outline.size > 0, RegionStatus.COMPLETE, RegionStatus.EMPTY)
    status = xp.where(outline.resolved, known, RegionStatus.UNRESOLVED)
    return StableRegion(
        coefficients=c,
        outline=outline,
        status=RegionStatus(int(status)) if xp is np else status.astype(xp.int8),
        max_alpha=outline.vertices[largest[0]] + 0.0,  # no -0
        max_beta=outline.vertices[largest[1]] + 0.0,
    )


def _holds_small_gains(component: StableRegion) -> bool:
    return holds_small_gains(component.coefficients, component.outline)


def _checked_points(alpha: Numbers, beta: Numbers) -> tuple[Array, Array]:
    gains = float_arrays(checked_gain("alpha", alpha), checked_gain("beta", beta))
    stiffness, damping = namespace(gains).broadcast_arrays(*gains)
    return stiffness, damping
