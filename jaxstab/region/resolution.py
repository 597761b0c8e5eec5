"""The outline of one slice, as finely and in as many digits as it takes. NumPy only."""

from math import ceil, sqrt

import numpy as np

from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.linear_loop import LinearLoop, linear_loop
from jaxstab.region import measures
from jaxstab.region.audit import is_contradicted
from jaxstab.region.curve import SliceCoefficients
from jaxstab.region.exact_curve import in_pairs
from jaxstab.region.filtered_curve import System, parts_in_pairs
from jaxstab.region.outline import Outline, extra_vertices, polygon
from jaxstab.region.pieces import Pieces
from jaxstab.region.scan import lone_partners
from jaxstab.region.search import refined_pieces

_FEWEST_POINTS, _MOST_POINTS = 256, 65536
_STRETCHINGS = 3  # rounds
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

    Where no number of digits resolves it, or verdicts of the loop contradict it, the outline is not
    ``resolved``. That nothing is stable is said after all have been tried.
    """
    if c.filtered is None or system is None:
        return c, _outline(c, delay, tolerance, may_be_empty, None)[0]
    loop = linear_loop(*system)
    if not c.filtered.loses_digits:
        outline, _ = _outline(c, delay, tolerance, may_be_empty, loop)
        if _is_known(outline):
            return c, outline
    curve, pairs = c.filtered, parts_in_pairs(system)
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
    return exact, outline


def _is_known(outline: Outline) -> bool:
    return bool(outline.resolved) and int(outline.size) > 0


def _outline(
    c: SliceCoefficients,
    delay: float,
    tolerance: float,
    may_be_empty: bool,
    loop: LinearLoop | None,
) -> tuple[Outline, Pieces]:
    """Return an outline, not ``resolved`` if verdicts contradict it, and its pieces."""
    pieces = refined_pieces(c, delay, may_be_empty=may_be_empty)
    outline = _adapted(c, pieces, tolerance)
    if outline.resolved and loop is not None and is_contradicted(c, outline, loop):
        outline = polygon(c, pieces._replace(resolved=np.bool_(False)), _FEWEST_POINTS)
    return outline, pieces


def _adapted(c: SliceCoefficients, pieces: Pieces, tolerance: float) -> Outline:
    """Return an outline of as many points as the tolerance asks for."""
    fewest = max(_FEWEST_POINTS, 2 * extra_vertices(len(pieces.exists)))
    points = _enough_points(sqrt(_BULGE / tolerance), fewest)
    outline = polygon(c, pieces, points)
    deviation = float(measures.deviation(c, outline))
    if outline.resolved and outline.size > 0 and deviation > tolerance:
        points = _enough_points(1.2 * points * sqrt(deviation / tolerance), fewest)
        outline = polygon(c, pieces, points)
    return outline


def _enough_points(wanted: float, fewest: int) -> int:
    return max(fewest, min(ceil(wanted), _MOST_POINTS))
