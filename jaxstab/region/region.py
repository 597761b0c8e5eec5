"""Stable regions of slices: found by a search, or in arrays of fixed sizes for JAX."""

from jaxstab.arrays import Numbers, is_traced, namespace, stored
from jaxstab.batches import compiled
from jaxstab.model import require_x64
from jaxstab.model.filters import Filter, Filters, Velocity, known_filters
from jaxstab.model.loop import refuses_loops
from jaxstab.model.parameters import (
    DELTA_LIMIT,
    GAMMA_LIMIT,
    LONGEST_DELAY,
    whole_and_fraction,
)
from jaxstab.numbers import checked_count, checked_number
from jaxstab.region.curve import (
    SliceCoefficients,
    filtered_coefficients,
    slice_coefficients,
)
from jaxstab.region.filtered_curve import System, mass_system
from jaxstab.region.outline import extra_vertices, polygon
from jaxstab.region.pieces import Pieces, find_pieces
from jaxstab.region.resolution import resolved_outline
from jaxstab.region.scan import scan_angles
from jaxstab.region.search import coefficient_count
from jaxstab.region.stable_set import StableRegion, region_within
from jaxstab.region.status import RegionStatus

_FINEST = 1e-10


@refuses_loops("region()")
def stable_region(
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    radius: Numbers = 1.0,
    tolerance: Numbers = 1e-6,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> StableRegion:
    """Return the set of all (alpha, beta) for which every root of p(z) is inside a circle.

    Every corner of the set is a point where the boundary curve crosses itself or a line. The search
    looks for all of these crossings and refines its scan around them until the pieces of the
    boundary join up to closed loops. It may miss a crossing where the curve bends more, between two
    angles of the first scan, than a cubic with the same ends and tangents; with filters it also
    leaves out parts of the curve at which another root is beyond 1.1. So it is argued, not proved,
    that all components are found (docs/proofs.md, G1 to G3).

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
        >>> region = jaxstab.stable_region(gamma=0.0, delta=0.0, delay=0.0)
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
    filters = known_filters(velocity, position)
    if filters and plant[3] != 1.0:
        raise ValueError(f"radius is {plant[3]:g}; with a filter only 1 is answered.")
    return _stable_region(*plant, smallest, filters)


def region_outline(
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    radius: Numbers = 1.0,
    points: int = 256,
    slots: int = 4,
    fineness: int = 1,
) -> StableRegion:
    """Return the stable set in arrays of fixed sizes, for jit, vmap and derivatives.

    Unlike ``stable_region`` it neither searches for crossings nor refines its scan, so check the
    status of each lane. A narrow cut into the set may lie between two angles of the scan; testing
    every fourth vertex then makes the lane UNRESOLVED in most cases. Of 115,000 random hands, 4 had
    a cut that went unnoticed.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4], a scalar; traced or not.
        delta: physical damping b T/m in [0, 1e3], a scalar; traced or not.
        delay: time delay t_d/T >= 0 in samples, concrete.
        radius: the circle's radius in (0, 1], a scalar; traced or not.
        points: length of the outline; the last point is repeated where fewer are needed.
        slots: the largest number of pieces of the curve; a set with more of them is UNRESOLVED.
        fineness: into how many parts each step of the scan is divided.

    Returns:
        StableRegion of arrays of fixed sizes, of JAX where an argument is. There ``max_alpha``,
        ``max_beta``, ``outline`` and the limits are differentiable once in gamma, delta and radius.

    Raises:
        ValueError: a concrete argument is outside its range, or ``points`` is too small.
        TypeError: the delay is traced, or a count is no whole number.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

    Example:
        >>> region = jaxstab.region_outline(gamma=0.001, delta=0.015, delay=1.0)
        >>> round(float(region.max_alpha[0]), 6)
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
        region = region_of(c, delay, tolerance, may_be_empty=may_be_empty)
        if region.status != RegionStatus.UNRESOLVED or radius != 1.0:
            return region
        filters = Velocity.difference(samples=1), Filter()  # the same loop in another form
    system = mass_system(gamma, delta, delay, filters)
    c = filtered_coefficients(*system)
    return region_of(c, delay, tolerance, may_be_empty=may_be_empty, system=system)


def region_of(
    c: SliceCoefficients,
    delay: float,
    tolerance: float,
    *,
    may_be_empty: bool,
    system: System | None = None,
) -> StableRegion:
    """Return the region of a slice, UNRESOLVED if that of a loop with filters fails the audit."""
    both = resolved_outline(c, delay, tolerance, may_be_empty=may_be_empty, system=system)
    return region_within(*both)


_pieces = compiled(static=("length", "slots"))(find_pieces)


@compiled(static=("points", "length"))
def _region(
    c: SliceCoefficients, pieces: Pieces, *, points: int, length: int | None = None
) -> StableRegion:
    return region_within(c, polygon(c, pieces, points, length))
