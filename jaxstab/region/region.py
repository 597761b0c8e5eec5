"""Stable regions of loops, found by a search. NumPy only.

A region is computed in three steps: the pieces of the curve that bound the stable set, refined
until they join up to loops (``crossings.refined_pieces``); a polygon with its corners on them, with
as many points as the tolerance requires (``outline.polygon``); and a value with limits, membership
and distances on the exact boundary (``stable_set``). Each point of the boundary is right to
rounding, but no step proves that every component was found (docs/proofs.md, G1 to G3).

The curve may lose digits without a sign of it, most of all with slow filters. So walls on both
sides of the outline get certified verdicts (``fails_audit``), and where poles are close to each
other, points of the outline are compared with double-double (``_strays``). If either fails, or
walls hardly move an undamped mode, all is computed in double-double, with angles rescaled around
such modes and where other resonances turn out to need it. A region that fails then, too, is
UNRESOLVED and claims nothing.
"""

from math import ceil, sqrt

import numpy as np
from jaxtyping import Float64, Int

from jaxstab.arrays import Numbers, is_traced, joined
from jaxstab.conventions import Verdict
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import NO_FILTERS, Filter, Transfer, Velocity, known_filters
from jaxstab.model.linear_loop import LinearLoop, SampledPlant
from jaxstab.model.loop import refuses_loops
from jaxstab.model.parameters import DELTA_LIMIT, GAMMA_LIMIT, LONGEST_DELAY
from jaxstab.numbers import checked_number
from jaxstab.point.verdicts import linear_verdict
from jaxstab.region import measures
from jaxstab.region.crossings import refined_pieces
from jaxstab.region.curve import (
    UNDAMPED,
    Curve,
    System,
    curve_of_system,
    hardly_moved,
    loop_of_system,
    mass_system,
    parts_in_pairs,
)
from jaxstab.region.exact import (
    Pairs,
    all_inside,
    exact_gains,
    in_pairs,
    polished_modes,
    wall_errors,
)
from jaxstab.region.outline import (
    Outline,
    are_inside,
    edges_of,
    extra_vertices,
    polygon,
    vertex_roots,
)
from jaxstab.region.pieces import (
    NO_BRANCH,
    Branch,
    Pieces,
    lone_partners,
)
from jaxstab.region.points import curve_gains
from jaxstab.region.stable_set import StableRegion, region_within

# A-posteriori check of regions, by certified verdicts.
#
# The curve of a loop, and the count of its other roots, may lose digits without any status
# showing it. So walls on both sides of the outline get a verdict, which is a proof. This does not
# prove the region, but a region that a proof contradicts is not given. The walls keep a distance
# from the outline, so that the rounding of a corner contradicts nothing. Next to corners they are
# closer: the curve passes a mode that walls hardly move within an angle that the search may step
# over, and where gains are small such a mode can cut off a corner of the set. Where walls move it
# so little that no verdict decides, more digits do not help, and the region is not given.

_ASIDE = 1e-3  # of the outline's size
_ROUGH = 1e-3  # of the same: edges that leave the boundary by more
_BLURRED = 1e-9  # of the same: points of a curve in double-double that rounding moves by more
_WALLS = 24  # on each side
_FROM_CORNER = 10.0 ** -np.arange(1.0, 6.0)  # shares of an edge that ends at a corner
_SHORTEST = 1e-8  # of the outline's size: an edge next to a corner
_GAINS = np.append(np.outer([-1.0, 1.0], np.geomspace(1e-12, 1.0, 13)), 0.0)  # alpha and beta

Edges = Float64[np.ndarray, "_ 4"]

Walls = Float64[np.ndarray, "2 _"]


def fails_audit(c: Curve, outline: Outline, loop: LinearLoop, deviation: float) -> bool:
    """Return whether a verdict proves a wall inside unstable, or one outside stable.

    Where a mode is next to undamped, an outline also fails if no wall beside it is proved stable.
    An outline without a loop claims that no wall is stable; gains of all sizes are tried then, and
    those that no verdict decides in double-double. An outline that stays away from its curve
    (``deviation``) whatever the number of vertices, or that rounding of double-double moves, is not
    known.
    """
    size = int(outline.size)
    if size == 0:
        walls = np.stack(np.meshgrid(_GAINS, _GAINS)).reshape(2, -1)
        codes = linear_verdict(walls[0], walls[1], loop)
        may_be_stable = codes == Verdict.STABLE
        if c.is_exact:
            is_open = (codes == Verdict.UNDECIDED) & np.all(walls != 0.0, axis=0)
            gains = DoubleDouble.from_value(walls[:, is_open])
            may_be_stable[is_open] = all_inside(c, gains[0], gains[1], 1.0)
        return bool(np.any(may_be_stable))
    if deviation > _ROUGH:
        return True
    vertices = outline.vertices[:size]
    edges, extent = edges_of(vertices, outline.branches[: size - 1]), np.ptp(vertices, axis=0)
    if c.is_exact:
        errors = wall_errors(c, np.abs(outline.angles[_on_the_curve(c, outline), 0]))
        if np.any(errors > _BLURRED * extent[:, None]):
            return True
    walls = _beside(edges, extent)
    codes = linear_verdict(walls[0], walls[1], loop)
    is_any_proved = bool(np.any(codes == Verdict.STABLE))
    doubtful = codes == np.where(are_inside(edges, walls), Verdict.UNSTABLE, Verdict.STABLE)
    walls, codes = walls[:, doubtful], codes[doubtful]  # a polygon is not exact
    angles, distances = c.resonances
    if np.any((angles > 0.0) & (distances < UNDAMPED)):
        if not is_any_proved:
            return True
        near = _beside(_near_corners(c, outline), extent, is_near=True)
        walls = np.concatenate([walls, near], axis=1)
        codes = np.concatenate([codes, linear_verdict(near[0], near[1], loop)])
    if not codes.size:
        return False
    is_inside = measures.contains(c, outline, walls[0], walls[1])
    return bool(np.any(codes == np.where(is_inside, Verdict.UNSTABLE, Verdict.STABLE)))


def _beside(edges: Edges, extent: Float64[np.ndarray, "2"], *, is_near: bool = False) -> Walls:
    """Return walls on both sides of edges: of some of an outline, or of all next to corners.

    Next to corners they are as close to their edges as these are short.
    """
    here, there = edges[:, :2], edges[:, 2:]
    normal = (there - here)[:, ::-1] * [-1.0, 1.0] / extent[::-1]
    length = np.hypot(*normal.T)
    chosen = np.flatnonzero(length > (_SHORTEST if is_near else 0.0))
    if not is_near:
        chosen = chosen[np.linspace(0, len(chosen) - 1, _WALLS).round().astype(int)]
        normal /= np.where(length > 0.0, length, 1.0)[:, None]
    aside, middle = _ASIDE * extent * normal[chosen], 0.5 * (here + there)[chosen]
    return np.concatenate([middle + aside, middle - aside]).T


def _near_corners(c: Curve, outline: Outline) -> Edges:
    """Return short edges of the boundary, at some distances from the corners."""
    size = int(outline.size)
    vertices = outline.vertices[:size]
    _, is_corner = vertex_roots(c, outline)
    is_edge = (outline.branches[: size - 1] != NO_BRANCH) & np.any(np.diff(vertices, axis=0), 1)
    begins, ends = (np.flatnonzero(is_edge & is_end) for is_end in (is_corner[:-1], is_corner[1:]))
    edges = np.repeat(np.append(begins, ends), len(_FROM_CORNER))
    close, far = (
        np.append(np.tile(shares, len(begins)), 1.0 - np.tile(shares, len(ends)))
        for shares in (_FROM_CORNER, 2.0 * _FROM_CORNER)
    )
    both = [_on_edges(c, outline, edges, shares) for shares in (close, far)]
    return np.concatenate(both, axis=1)


def _on_edges(
    c: Curve,
    outline: Outline,
    edges: Int[np.ndarray, " edge"],
    shares: Float64[np.ndarray, " edge"],
) -> Float64[np.ndarray, "edge 2"]:
    """Return points of the boundary at shares of edges."""
    here, there = outline.vertices[edges], outline.vertices[edges + 1]
    straight = here + (there - here) * shares[:, None]
    start, end = outline.angles[edges].T
    curved = curve_gains(c, start + (end - start) * shares).T
    return np.where((outline.branches[edges] == Branch.CURVE)[:, None], curved, straight)


# The outline of one loop, with as many angles and digits as it needs.

_FEWEST_POINTS, _MOST_POINTS = 256, 65536
_STRETCHINGS = 3  # rounds
_TESTED, _STRAYED = 32, 1e-12  # points, and how far aside they may be beside the outline's size
_NOTHING = 2.0**-86  # of the coefficients of p(z): pairs know that much
_BULGE = 0.35  # times points^-2 is at most about how far the boundary leaves the polygon


@np.errstate(all="ignore")  # NaN and infinity are answers
def region_of_system(system: System, tolerance: float, *, may_be_empty: bool) -> StableRegion:
    """Return the region of a loop.

    Where no number of digits resolves its outline, or it fails the audit, it is UNRESOLVED. That
    nothing is stable, in the unit circle, is said after all have been tried.
    """
    c, loop = curve_of_system(system), loop_of_system(system)
    rough = None
    if not c.loses_digits:
        outline, _ = _audited(c, tolerance, may_be_empty, loop)
        rough = outline if _is_known(outline) else None
        if rough is not None and not (c.may_lose_some and _strays(c, rough, system)):
            return region_within(c, rough)
        if outline.resolved and system[3] < 1.0 and not c.may_lose_some:
            return region_within(c, outline)  # a circle that no wall keeps all roots in
    pairs = parts_in_pairs(system)
    if not c.loses_digits and outline.resolved and _keeps_a_root(pairs):
        return region_within(c, outline)
    centers = polished_modes(pairs, hardly_moved(system[0]))
    for _ in range(_STRETCHINGS):
        exact = in_pairs(c, pairs, centers)
        outline, pieces = _audited(exact, tolerance, may_be_empty, loop)
        if _is_known(outline):
            break
        more = lone_partners(exact, pieces)
        if not more.hi.size:
            break
        centers = joined([centers, more])
    if rough is not None and not _is_known(outline):
        return region_within(c, rough)
    return region_within(exact, outline)


def _strays(c: Curve, outline: Outline, system: System) -> bool:
    """Return whether some points of an outline in float64 are off the curve in double-double."""
    edges = _on_the_curve(c, outline)
    edges = edges[np.linspace(0, len(edges) - 1, min(_TESTED, len(edges))).round().astype(int)]
    extent = np.ptp(outline.vertices, axis=0)
    angles = outline.angles[edges, 0]
    size = DoubleDouble.from_value(np.abs(angles))
    exact = exact_gains(parts_in_pairs(system), size, with_slopes=False).values[:2]
    away = (curve_gains(c, angles) - np.stack([gain.rounded() for gain in exact])).T / extent
    along = (outline.vertices[edges + 1] - outline.vertices[edges]) / extent
    length = np.hypot(*along.T)
    aside = np.abs(away[:, 0] * along[:, 1] - away[:, 1] * along[:, 0])
    return bool(np.any(aside > _STRAYED * length))


def _on_the_curve(c: Curve, outline: Outline) -> Int[np.ndarray, " edge"]:
    """Return the edges of the curve, without lines at poles."""
    size = np.abs(outline.angles[:, 0])
    straight = np.any([line.holds(size) for line in c.lines], axis=0)
    return np.flatnonzero((outline.branches == Branch.CURVE) & ~straight)


def _keeps_a_root(pairs: Pairs) -> bool:
    """Return whether all walls leave a root at z = -1, to the precision of pairs."""
    values, sizes = np.abs(pairs[1, 1, 0, :, 0]), np.sum(np.abs(pairs[1, 0, 0]), axis=1)
    return bool(np.all(values <= _NOTHING * sizes))


def _is_known(outline: Outline) -> bool:
    return bool(outline.resolved) and int(outline.size) > 0


def _audited(
    c: Curve, tolerance: float, may_be_empty: bool, loop: LinearLoop
) -> tuple[Outline, Pieces]:
    """Return an outline, not ``resolved`` if it fails the audit, and its pieces."""
    pieces = refined_pieces(c, may_be_empty=may_be_empty)
    outline, deviation = _adapted(c, pieces, tolerance)
    if outline.resolved and fails_audit(c, outline, loop, deviation):
        outline = polygon(c, pieces._replace(resolved=np.bool_(False)), _FEWEST_POINTS)
    return outline, pieces


def _adapted(c: Curve, pieces: Pieces, tolerance: float) -> tuple[Outline, float]:
    """Return an outline with as many points as the tolerance requires, and its deviation."""
    fewest = max(_FEWEST_POINTS, 2 * extra_vertices(len(pieces.begin)))
    points = _enough_points(sqrt(_BULGE / tolerance), fewest)
    outline = polygon(c, pieces, points)
    deviation = float(measures.deviation(c, outline))
    if outline.resolved and outline.size > 0 and deviation > tolerance:
        points = _enough_points(1.2 * points * sqrt(deviation / tolerance), fewest)
        outline = polygon(c, pieces, points)
        deviation = float(measures.deviation(c, outline))
    return outline, deviation


def _enough_points(wanted: float, fewest: int) -> int:
    return max(fewest, min(ceil(wanted), _MOST_POINTS))


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
    angles of the first scan, than a cubic with the same ends and tangents, and it leaves out parts
    of the curve at which another root is beyond 1.1 times the radius. So it is argued, not proved,
    that all components are found (docs/proofs.md, G1 to G3).

    Args:
        gamma, delta: see ``jaxstab.conventions``.
        delay: time delay t_d/T in samples, whole or fractional, in [0, 500]; a number, like all.
        radius: the circle's radius in (0, 1]: 1 for stability, less for a decay rate.
        tolerance: largest distance between the polygon and the boundary, as a share of the
            region's diameter, > 1e-10.
        velocity: the velocity estimator in units of one sample; None for the difference over one
            sample, the wall of the paper.
        position: the position filter in units of one sample; None for none.

    Returns:
        StableRegion of NumPy arrays, with its status. An empty region is an answer, not an error.

    Raises: see ``jaxstab.conventions``; no argument may be traced (``jaxstab.regions_of`` takes
    tracers).

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

    Example:
        >>> region = jaxstab.stable_region(gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(region.max_alpha[0]), 9)  # 12 - 8 sqrt(2)
        0.686291501
    """
    if any(map(is_traced, (gamma, delta, delay, radius, tolerance))):
        raise TypeError(
            "stable_region searches outside of JAX; under jit, vmap and grad call regions_of."
        )
    slice_ = (
        checked_number("gamma", gamma, 0.0, GAMMA_LIMIT),
        checked_number("delta", delta, 0.0, DELTA_LIMIT),
        checked_number("delay", delay, 0.0, LONGEST_DELAY, unit="samples"),
    )
    size = checked_number("radius", radius, 0.0, 1.0, is_open=True)
    smallest = checked_number("tolerance", tolerance, _FINEST, is_open=True)
    filters = known_filters(velocity, position) or NO_FILTERS
    system = mass_system(*slice_, filters, size)
    return region_of_system(system, smallest, may_be_empty=slice_[1] == 0.0 or size < 1.0)


# The stable set of a loop with any plant, estimator and filter.


def linear_region(
    plant: SampledPlant, velocity: Transfer, position: Transfer, tolerance: float
) -> StableRegion:
    """Return the set of all stable (alpha, beta) of a loop, with T V(z) less (1 - 1/z), and P(z).

    The tolerance, > 1e-10, is the largest distance between the polygon and the boundary, as a share
    of the region's diameter. ValueError: the plant has zero DC gain, N(1) = 0, by which the curve
    is divided near z = 1.
    """
    if float(plant.at_one[0].value.hi) == 0.0:
        raise ValueError(
            "the device has zero DC gain: its transfer function in s is 0 at s = 0. It has no "
            "region and no limits here; use verdicts, radii, poles or margins."
        )
    return region_of_system((plant, velocity, position, 1.0), tolerance, may_be_empty=True)
