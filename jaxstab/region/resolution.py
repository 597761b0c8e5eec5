"""The outline of one slice, with as many angles and digits as it needs. NumPy only."""

from math import ceil, sqrt

import numpy as np

from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.region import measures
from jaxstab.region.audit import fails_audit
from jaxstab.region.corners import Branch
from jaxstab.region.curve import SliceCoefficients, curve_and_lift
from jaxstab.region.exact_curve import in_pairs
from jaxstab.region.exact_points import Pairs, exact_gains
from jaxstab.region.filtered_curve import System, loop_of_system, parts_in_pairs
from jaxstab.region.outline import Outline, extra_vertices, polygon
from jaxstab.region.pieces import Pieces
from jaxstab.region.scan import lone_partners
from jaxstab.region.search import refined_pieces

_FEWEST_POINTS, _MOST_POINTS = 256, 65536
_STRETCHINGS = 3  # rounds
_ASKED, _STRAYED = 32, 1e-12  # points, and how far aside they may be beside the outline's size
_NOTHING = 2.0**-86  # of the coefficients of p(z): pairs know that much
_BULGE = 0.35  # times points^-2 is at most about how far the boundary leaves the polygon


def resolved_outline(
    c: SliceCoefficients,
    delay: float,
    tolerance: float,
    *,
    may_be_empty: bool,
    system: System | None,
) -> tuple[SliceCoefficients, Outline]:
    """Return the outline of a slice, and the coefficients by which it was resolved.

    Where no number of digits resolves it, or it fails the audit, the outline is not ``resolved``.
    That nothing is stable is said after all have been tried.
    """
    if c.filtered is None or system is None:
        return c, _outline(c, delay, tolerance, may_be_empty, None)[0]
    loop = loop_of_system(system)
    curve, rough = c.filtered, None
    if not curve.loses_digits:
        outline, _ = _outline(c, delay, tolerance, may_be_empty, loop)
        rough = outline if _is_known(outline) else None
        if rough is not None and not (curve.may_lose_some and _strays(c, rough, system)):
            return c, rough
    pairs = parts_in_pairs(system)
    if not curve.loses_digits and outline.resolved and _keeps_a_root(pairs):
        return c, outline
    centers = DoubleDouble.of(np.empty(0))
    for _ in range(_STRETCHINGS):
        exact = c._replace(filtered=in_pairs(curve, pairs, centers))
        outline, pieces = _outline(exact, delay, tolerance, may_be_empty, loop)
        if _is_known(outline):
            break
        more = lone_partners(exact, pieces)
        if not more.hi.size:
            break
        both = (centers.hi, more.hi), (centers.lo, more.lo)
        centers = DoubleDouble(*map(np.concatenate, both))
    if rough is not None and not _is_known(outline):
        return c, rough
    return exact, outline


def _strays(c: SliceCoefficients, outline: Outline, system: System) -> bool:
    """Return whether some points of an outline in float64 are beside the curve in double-double."""
    curve = c.filtered
    assert curve is not None
    size = np.abs(outline.angles)
    straight = np.any([line.holds(size[:, 0]) for line in curve.lines], axis=0)
    edges = np.flatnonzero((outline.branches == Branch.CURVE) & ~straight)
    edges = edges[np.linspace(0, len(edges) - 1, min(_ASKED, len(edges))).round().astype(int)]
    extent = np.ptp(outline.vertices, axis=0)
    points = np.stack(curve_and_lift(c, outline.angles[edges, 0])[:2], axis=1)
    angles = DoubleDouble.of(size[edges, 0])
    exact = exact_gains(parts_in_pairs(system), angles, with_slopes=False).values[:2]
    away = (points - np.stack([one.rounded() for one in exact], axis=1)) / extent
    along = (outline.vertices[edges + 1] - outline.vertices[edges]) / extent
    length = np.hypot(*along.T)
    aside = np.abs(away[:, 0] * along[:, 1] - away[:, 1] * along[:, 0])
    return bool(np.any(aside > _STRAYED * length))


def _keeps_a_root(pairs: Pairs) -> bool:
    """Return whether all walls leave a root at z = -1, as far as pairs tell."""
    values, sizes = np.abs(pairs[1, 1, 0, :, 0]), np.sum(np.abs(pairs[1, 0, 0]), axis=1)
    return bool(np.all(values <= _NOTHING * sizes))


def _is_known(outline: Outline) -> bool:
    return bool(outline.resolved) and int(outline.size) > 0


def _outline(
    c: SliceCoefficients,
    delay: float,
    tolerance: float,
    may_be_empty: bool,
    loop: LinearLoop | None,
) -> tuple[Outline, Pieces]:
    """Return an outline, not ``resolved`` if it fails the audit, and its pieces."""
    pieces = refined_pieces(c, delay, may_be_empty=may_be_empty)
    outline, deviation = _adapted(c, pieces, tolerance)
    if outline.resolved and loop is not None and fails_audit(c, outline, loop, deviation):
        outline = polygon(c, pieces._replace(resolved=np.bool_(False)), _FEWEST_POINTS)
    return outline, pieces


def _adapted(c: SliceCoefficients, pieces: Pieces, tolerance: float) -> tuple[Outline, float]:
    """Return an outline of as many points as the tolerance asks for, and its deviation."""
    fewest = max(_FEWEST_POINTS, 2 * extra_vertices(len(pieces.exists)))
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
