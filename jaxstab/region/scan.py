"""The angles at which a scan looks for pieces of the boundary of the stable set. NumPy only."""

from functools import cache

import numpy as np
from jaxtyping import Float64

from jaxstab.model import companion_matrix
from jaxstab.model.double_double import DoubleDouble
from jaxstab.region.curve import SliceCoefficients
from jaxstab.region.exact_roots import angles_on_circle
from jaxstab.region.filtered_curve import FilteredCurve
from jaxstab.region.filtered_points import exact_walls, is_oriented
from jaxstab.region.other_roots import other_roots, others_inside
from jaxstab.region.pieces import Pieces
from jaxstab.region.pole_lines import PoleLine
from jaxstab.region.stretches import standing_for

_FIRST, _PI_MINUS_LAST = 1e-7, 1e-7
_CLOSEST = 1e-11
_OFFSETS = 24  # to each side of an angle to look closer at
_NEAR_CIRCLE = 1e-2
_SAME = 1e-10
_ON_CIRCLE, _APART, _MOST_CENTERS = 1e-9, 1e-7, 8
_WIDTHS, _STEPS_AROUND = 8.0, 16  # of a resonance
_STEPS_OF_LINE = 48  # on each side of a line at a pole

Angles = Float64[np.ndarray, " _"]  # of any length


@cache
def scan_angles(length: int, fineness: int) -> Angles:
    """Return the angles of a scan: even steps, a part of a turn of z^m, and finer to both ends.

    ``length`` is that of the polynomials, as for ``find_pieces``.
    """
    count = fineness * (24 + 8 * length)
    even = (np.arange(count) + 0.5) * (np.pi / count)
    start, end = (
        np.geomspace(first, even[0], 12 * fineness, endpoint=False)
        for first in (_FIRST, _PI_MINUS_LAST)
    )
    angles = np.concatenate([start, even, np.pi - end[::-1]])
    angles.flags.writeable = False
    return angles


def slice_angles(c: SliceCoefficients, length: int, fineness: int) -> Angles:
    """Return the angles of a scan: with filters more of them at the poles and where beta is 0.

    They have the sign of Im V: see ``filtered_curve``.
    """
    angles = scan_angles(length, fineness)
    if c.filtered is None:
        return angles
    offsets = np.geomspace(_CLOSEST, np.pi / len(angles), 8 * fineness)
    centers = np.concatenate([c.filtered.poles[0], c.filtered.steep])
    around = centers[:, None] + np.concatenate([-offsets, offsets])
    lines = [_around_line(line, fineness) for line in c.filtered.lines]
    drawn = [one.scan for one in c.filtered.stretches]
    around = np.concatenate(
        [around.ravel(), _around_resonances(c.filtered, fineness), *lines, *drawn]
    )
    inner = around[(around > angles[0]) & (around < angles[-1])]
    angles = np.sort(np.concatenate([angles, inner]))
    return np.sort(np.where(is_oriented(c.filtered, angles), angles, -angles))


def _around_resonances(curve: FilteredCurve, fineness: int) -> Angles:
    """Return angles around zeros and poles of a device, in steps that grow with the distance."""
    angle, width = curve.resonances[:, :, None]
    reach = np.maximum(angle, _WIDTHS * width)
    growth = np.linspace(0.0, 1.0, _STEPS_AROUND * fineness)
    offsets = width / _WIDTHS * (reach / (width / _WIDTHS)) ** growth
    around: Angles = (angle + np.concatenate([-offsets, offsets], axis=1)).ravel()
    return around


def _around_line(line: PoleLine, fineness: int) -> Angles:
    """Return angles of a line at a pole: the knots twice, as pieces end there."""
    count = _STEPS_OF_LINE * fineness
    even = line.half_width * (np.arange(count) + 0.5) / count
    close = np.geomspace(_CLOSEST, even[0], 8 * fineness)
    offsets = np.concatenate([-even, even, -close, close])
    knots = np.array(line.knots)
    beside = knots[:, None] + np.concatenate([-close, close, [0.0, 0.0]])
    return np.concatenate([line.angle + offsets, beside.ravel()])


def closer_angles(c: SliceCoefficients, angles: Angles, centers: Angles) -> Angles:
    """Return the angles of a scan with more angles around some centres."""
    offsets = np.geomspace(_CLOSEST, np.max(np.diff(angles)), _OFFSETS)
    around = centers[:, None] + np.concatenate([-offsets, offsets])
    closer: Angles = np.clip(around.ravel(), angles[0], angles[-1])
    if c.filtered is not None:
        closer = closer[is_oriented(c.filtered, closer)]
    return np.sort(np.concatenate([angles, closer]))


def suspects(
    c: SliceCoefficients, pieces: Pieces, known: Angles, outside: float, *, length: int
) -> Angles:
    """Return further angles around which a piece may hide between two angles of the scan.

    They are the corners that the pieces have and the angles of the roots that are on the circle
    there, or close.
    """
    ends = np.concatenate([pieces.begin, pieces.end])
    size = np.abs(ends)
    corners = ends[np.tile(pieces.exists, 2) & (size > 0.0) & (size < np.pi)]
    if c.filtered is not None and c.filtered.is_exact:
        angles_of_roots = angles_on_circle(c.filtered, *exact_walls(c.filtered, corners))
        partners = standing_for(c.filtered.stretches, angles_of_roots)
    else:
        others = other_roots(c, corners, length)
        partners = _angles_near_circle(others[:, np.all(np.isfinite(others), axis=0)].T)
    if c.filtered is not None:
        partners = np.where(is_oriented(c.filtered, partners), partners, -partners)
    every = np.concatenate([corners, partners])
    away = np.min(np.abs(every[:, None] - known), axis=1, initial=np.inf)
    return nearly_stable(c, every[away >= _SAME], outside, length=length)


def lone_partners(c: SliceCoefficients, pieces: Pieces) -> DoubleDouble:
    """Return the angles at which a piece would have to begin or end for others, but none does.

    The curve is evaluated in double-double.
    """
    curve = c.filtered
    assert curve is not None
    ends = np.concatenate([pieces.begin, pieces.end])
    ends = ends[np.tile(pieces.exists, 2)]
    open_ends = ends[(ends != 0.0) & (np.abs(ends) < np.pi)]
    angles = angles_on_circle(curve, *exact_walls(curve, open_ends), within=_ON_CIRCLE)
    size = standing_for(curve.stretches, angles)
    away = np.min(np.abs(size[:, None] - np.abs(ends)), axis=1, initial=np.inf)
    known = [one.angle for one in curve.stretches]
    near = np.min(np.abs(angles.hi[:, None] - known), axis=1, initial=np.inf)
    _, first = np.unique(np.round(angles.hi / _APART), return_index=True)
    chosen = first[(away[first] > _APART) & (near[first] > _APART)][:_MOST_CENTERS]
    return DoubleDouble(angles.hi[chosen], angles.lo[chosen])


def nearly_stable(c: SliceCoefficients, angles: Angles, outside: float, *, length: int) -> Angles:
    """Return the angles, in order, at which no other root is farther outside than a limit."""
    if not angles.size:
        return angles
    angles = np.sort(angles)
    angles = angles[np.diff(angles, prepend=-np.inf) > _CLOSEST]
    chosen: Angles = angles[others_inside(c, angles, length, within=1.0 + outside)]
    return chosen


def _angles_near_circle(polynomials: Float64[np.ndarray, "polynomial coefficient"]) -> Angles:
    """Return the angles between 0 and pi of the roots close to the circle."""
    if polynomials.shape[1] < 2:
        return np.empty(0)
    roots = np.linalg.eigvals(companion_matrix(polynomials)).ravel()
    near = roots[(np.abs(np.abs(roots) - 1.0) < _NEAR_CIRCLE) & (roots.imag > 0.0)]
    angles: Angles = np.angle(near)
    return angles
