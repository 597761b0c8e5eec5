"""Stable regions of loops: a scan in float64 proposes, proved rows of walls decide. NumPy only.

A region is computed in three steps: the arcs of the curve that bound the stable set, joined with
straight parts that balls give (``pieces``); a polygon with its corners on them, with as many points
as the tolerance requires (``outline``); and a value with limits, membership and distances on the
exact boundary (``stable_set``).

Whether that is right is decided by lines of walls whose stable intervals are all known and proved
(``exact.line``): some rows through each component, and, on the inner and the outer side of each
limit, 1e-9 beside it, the line of that gain. There the outline must have the same intervals. At
the middle of each edge the other roots are asked for (``_cut_through``). Where arcs do not join,
the roots that meet at their ends tell where others begin, and the scan is repeated from arc to arc.
Where that is not enough, or a line has other intervals, the angles of the roots that cross the
circle on such lines tell where to look closer: from the third time on the other roots are counted
in balls where float64 is not clear, and these angles are drawn out (``curve``), for an arc may be
narrower than float64 tells two angles apart. A region that fails to the end is UNRESOLVED and
claims nothing. What is not proved is that no island was missed between angles and rows.
"""

import warnings
from collections.abc import Iterable, Iterator
from functools import lru_cache
from math import ceil, isfinite, sqrt

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Numbers, is_traced
from jaxstab.exact.boundary import ScaledLoop, slope_of_end
from jaxstab.exact.line import End, LineStatus, StableLine, stable_line
from jaxstab.model import LoopParameters
from jaxstab.model.device.parts import FIRST_BITS, working_precision
from jaxstab.model.filters import Filter, Velocity, as_keywords, known_filters
from jaxstab.model.loop import refuses_loops, unit_loop
from jaxstab.model.plant import DELTA_LIMIT, GAMMA_LIMIT, LONGEST_DELAY
from jaxstab.numbers import checked_number
from jaxstab.region import measures
from jaxstab.region.curve import Curve, curve_gains, curve_of, drawn_out, true_angles
from jaxstab.region.measures import Outline, empty_outline, polygon, survey
from jaxstab.region.pieces import (
    Centers,
    Passes,
    Pieces,
    angles_of,
    find_pieces,
    line_ends,
    others_inside,
    scan_angles,
    second_pairs,
)
from jaxstab.region.stable_set import StableRegion, components_of, region_within
from jaxstab.rounding import UNIT

_BESIDE = 1e-9  # of a limit: how far from it lines are compared
_LEAST = 1e-12  # of a component's size: the same for limits that are small beside that

Point = Float64[np.ndarray, "2"]
Points = Float64[np.ndarray, "point 2"]


@np.errstate(all="ignore")  # NaN and infinity are answers
def region_of(loop: ScaledLoop, tolerance: float) -> StableRegion:
    """Return the region of a loop; see ``stable_region`` for the tolerance and what is raised.

    Warns: UserWarning before balls count for a loop of a high degree, which may take minutes.
    """
    scans, closer = 5, 2  # and from which on balls count and angles are drawn out
    quick = 80  # a degree: some thousand counts of roots in balls take seconds
    rough = 1e-3  # of the same: an outline that leaves its curve by more has too few angles
    c = curve_of(loop)
    if _keeps_a_root(loop):
        return region_within(c, empty_outline(resolved=True))
    centers, with_balls, lines = np.empty((0, 2)), bool(c.stretches), _Lines(loop)
    is_slow = c.degree > quick
    for scan in range(scans):
        with_balls = with_balls or scan >= closer
        if scan >= closer:
            c = drawn_out(c, np.concatenate([_inner(line_ends(c)), centers]))
        if is_slow and with_balls:
            is_slow = False
            warnings.warn(
                f"the region of a loop of degree {c.degree} may take minutes: float64 leaves it "
                "open; a shorter window or delay takes less.",
                stacklevel=3,
            )
        pieces, centers = _followed(c, centers, with_balls=with_balls)
        more: Centers | None = np.empty((0, 2))
        if pieces.open.size:
            more = _angles_beside(lines, pieces.open)
        elif pieces.begin.size:
            outline, deviation = _adapted(c, pieces, tolerance)
            more = _contradictions(c, lines, outline) if deviation < rough else None
            if more is not None and not len(more):
                more = _cut_through(c, lines, outline)
            if more is not None and not len(more):
                return region_within(c, outline)
        elif with_balls:
            more = _angles_of_rays(lines)
            if more is not None and not len(more):
                return region_within(c, empty_outline(resolved=True))
        else:
            more = None
        if more is not None:
            centers = np.concatenate([centers, more])
        elif with_balls:
            break
        else:
            with_balls = True
    return region_within(c, empty_outline(resolved=False))


def _followed(c: Curve, centers: Centers, *, with_balls: bool) -> tuple[Pieces, Centers]:
    """Return the pieces that scans find, and the centres with those that arcs told of.

    As long as a scan in float64 finds more arcs for them, it is repeated with their angles. Where
    it finds several times as many at once, they are rounding: rows tell then.
    """
    known, most = 1e-7, 100  # radians: a centre is there; centers
    scans = 8 + len(c.poles)  # each finds the next arc, and hardly two of them are of one branch
    arcs, inside = -1, Passes(c, with_balls=with_balls)
    for _ in range(scans):
        pieces = find_pieces(c, scan_angles(c, centers, with_balls=with_balls), inside)
        if with_balls or not pieces.lone.size or len(pieces.begin) <= arcs:
            break
        told = second_pairs(c, pieces.lone)
        away = np.min(np.abs(told[:, None] - centers[:, 0]), axis=1, initial=np.inf)
        new = told[(away > known) & np.isfinite(told)]
        if not 0 < new.size <= most:
            break
        new_centers = np.stack([new, np.zeros_like(new)], axis=1)
        arcs, centers = len(pieces.begin), np.concatenate([centers, new_centers])
    return pieces, centers


def _keeps_a_root(loop: ScaledLoop) -> bool:
    with working_precision(FIRST_BITS):
        parts = [part.without_windows() for part in loop.triple()]
    return min(p.at_one for p in parts) > 0 or min(p.at_minus_one for p in parts) > 0


# What proved lines of walls tell.


class _Lines:
    """Proved lines of the walls of a loop; each begins with the precision of the last one."""

    def __init__(self, loop: ScaledLoop) -> None:
        self.loop, self.bits = loop, FIRST_BITS

    def along(self, start: tuple[float, float], along: tuple[float, float]) -> StableLine:
        """The line of walls start + t along."""
        line = _proved_line(self.loop, start, along, self.bits)
        self.bits = line.bits
        return line

    def at(self, axis: int, value: float) -> StableLine:
        """The line of constant alpha (axis 0) or beta (axis 1)."""
        return self.along(
            *(((value, 0.0), (0.0, 1.0)) if axis == 0 else ((0.0, value), (1.0, 0.0)))
        )


@lru_cache  # a region and its limits ask for the row of the stiffest wall
def _proved_line(
    loop: ScaledLoop, start: tuple[float, float], along: tuple[float, float], bits: int
) -> StableLine:
    return stable_line(loop.triple, start, along, bits)


def _angles_on(line: StableLine) -> Centers:
    return _inner(end for ends in line.intervals for end in ends)


def _inner(ends: Iterable[End]) -> Centers:
    angles = angles_of(ends)
    return angles[(angles[:, 0] > 0.0) & (angles[:, 0] < np.pi)]


def _angles_beside(lines: _Lines, walls: Points) -> Centers:
    """Return the angles of roots that cross the circle on rows beside walls."""
    aside = 1e-5  # of an open end's damping: where a row tells what was missed
    most_open = 6
    found = [np.empty((0, 2))]
    finite = walls[np.all(np.isfinite(walls), axis=1)]
    for _, beta in finite[:most_open].tolist():
        for side in (1.0 - aside, 1.0 + aside):
            found.append(_angles_on(lines.at(1, beta * side)))
    return np.concatenate(found)


def _angles_of_rays(lines: _Lines) -> Centers | None:
    """Return the angles of roots at the ends of stable intervals of walls from 0; None: not known.

    There are none where no wall of these rays is stable. Where one root stays at 1 along a ray, the
    intervals are those of all others; where two do, they tell nothing of the walls beside it.
    """
    slopes = (1.0, 0.1), (1.0, 1.0), (1.0, 10.0), (1.0, -1.0), (0.0, 1.0)
    rays = [lines.along((0.0, 0.0), along) for along in slopes]
    if any(ray.status != LineStatus.PROVED for ray in rays):
        return None
    return np.concatenate([_angles_on(ray) for ray in rays if ray.drift < 2])


def _compared(c: Curve, outline: Outline) -> list[tuple[int, float, bool, float]]:
    """The lines on both sides of the limits, and rows through each component.

    Each has the gain that it keeps (0 is alpha), its value, whether it is on the inner side of a
    limit, where one stable wall is enough, and how short intervals are that need not be compared.
    Inner sides where the wall next to the limit is stable are left out.
    """
    slim = 1e-9  # of the region's width: shorter intervals need not be compared
    # In shares of its height, from so many corners: rows where modes are hardly damped.
    from_corners, most = 10.0 ** -np.arange(1.0, 8.0, 2.0), 8
    # Of a component's height: where a row is compared, or that of the limit, if corners are so far.
    row, apart = 0.47, 0.05
    main, *islands = components_of(c, outline)
    sizes = np.ptp(outline.vertices, axis=0)
    lines: list[tuple[int, float, bool, float]] = []
    extremes = measures.quadrant_extremes(c, main)
    for axis, (point, _) in enumerate(extremes):
        limit, other = point[[axis, 1 - axis]].tolist()
        extent = float(np.ptp(main.vertices[:, axis]))
        aside = max(_BESIDE * limit, _LEAST * extent)
        if np.isfinite(limit):
            lines.append((axis, limit + aside, False, 0.0))
            if not c.is_stable((limit - aside, other)[:: 1 - 2 * axis]):
                lines.append((axis, limit - aside, True, 0.0))
    heights = (component.vertices[:, 1] for component in (main, *islands))
    rows = [float(np.min(beta) + np.ptp(beta) * row) for beta in heights]
    at_limit = float(extremes[0][0][1])
    if isfinite(at_limit) and np.all(abs(main.corners[:, 1] - at_limit) > apart * sizes[1]):
        rows[0] = at_limit
    if c.stretches:
        near = np.append(-from_corners, from_corners) * sizes[1]
        rows += (_spread(outline.corners[:, 1], most)[:, None] + near).ravel().tolist()
    lines += [(1, value, False, slim * sizes[0]) for value in rows]
    return lines


def _contradictions(c: Curve, lines: _Lines, outline: Outline) -> Centers | None:
    """Return the angles of roots on lines that an outline does not agree with; None: not known.

    There are none where all agree.
    """
    agree, at_poles = 1e-6, 1e-4  # of the longest interval; where the curve is 0/0 at a pole
    share = agree if all(line.angle in (0.0, np.pi) for line in c.lines) else at_poles
    sizes, asked = np.ptp(outline.vertices, axis=0), _compared(c, outline)
    axes, values, *_ = map(np.array, zip(*asked, strict=True))
    ends = measures.interval_ends(c, outline, values, axis=axes)
    for own, (axis, value, is_inner, slim) in zip(ends, asked, strict=True):
        drawn = own[np.isfinite(own)].reshape(-1, 2)
        middles = np.mean(drawn, axis=1).tolist()
        if is_inner and any(c.is_stable((value, x)[:: 1 - 2 * axis]) for x in middles):
            continue
        line = lines.at(axis, value)
        if line.status != LineStatus.PROVED:
            return None
        if not _agree(line, drawn, slim, share, sizes[1 - axis]):
            return _inner(line.crossings)
    return np.empty((0, 2))


def _cut_through(c: Curve, lines: _Lines, outline: Outline) -> Centers:
    """Return angles of roots on rows through edges at whose middle another root is outside.

    Where many roots move alike, whole arcs lie between two angles of a scan. Float64 asks all
    edges, and balls at most six of those that fail.
    """
    most = 6
    theta = np.mean(outline.angles[outline.is_curved], axis=1)
    doubted = theta[~others_inside(c, theta)]
    if not doubted.size:
        return np.empty((0, 2))
    some = _spread(doubted, most)
    cut = some[~others_inside(c, some, with_balls=True)]
    rows = [_inner(lines.at(1, beta).crossings) for beta in curve_gains(c, cut)[1].tolist()]
    return np.concatenate([np.stack(true_angles(c, np.abs(cut)), axis=1), *rows])


def proved_extremes(region: StableRegion) -> tuple[Point, Point]:
    """Return the points of the largest alpha and of the largest beta where the other is >= 0.

    Each is the end of an interval of a row that is proved, but next to corners that are thinner
    than float64. NaN if no gain is positive.
    """
    c, lines = region.curve, _Lines(region.curve.loop)
    extents = np.ptp(region.outline.vertices, axis=0)
    points = [point for point, _ in measures.quadrant_extremes(c, region.outline)]
    for axis, point in enumerate(points):
        if np.all(np.isfinite(point)):
            limit, other = point.tolist()[:: 1 - 2 * axis]
            # An outline is right to some 1e-11 of its size.
            around = limit, _BESIDE * max(limit, extents[axis])
            limit, other = max(_ends_beside(lines, other, axis, *around), default=(limit, other))
            points[axis] = np.array([limit, other][:: 1 - 2 * axis])
    return points[0], points[1]


def _ends_beside(
    lines: _Lines, other: float, axis: int, limit: float, far: float
) -> Iterator[tuple[float, float]]:
    """Yield ends of proved rows that are next to a limit, and the rows' own gain.

    The first row is that of the limit. At a corner two of its crossings are next to each other, and
    Newton's method tells on which row they meet. Beside a tip rows are empty, or nearly so.
    """
    near = 1e-6  # of the limit: crossings that may meet
    asides = 0.0, -64.0, 64.0, -1024.0, 1024.0  # roundings
    row = lines.at(1 - axis, other)
    yield from ((end, other) for end in _end_beside(row, limit, far))
    pair = sorted(row.crossings, key=lambda end: abs(end.value - limit))[:2]
    if len(pair) < 2 or abs(pair[1].value - limit) > near * limit:
        return
    first, second = (slope_of_end(lines.loop, end, other, axis) for end in pair)
    corner = other + (pair[1].value - pair[0].value) / ((first - second) or np.inf)
    for aside in asides if abs(corner - other) < near * abs(other) else ():
        beside = corner * (1.0 + aside * UNIT)
        found = _end_beside(lines.at(1 - axis, beside), limit, far)
        if found:
            yield found[0], beside
            return


def _end_beside(row: StableLine, limit: float, far: float) -> list[float]:
    ends = sorted((high.value for _, high in row.intervals), key=lambda end: abs(end - limit))
    return [end for end in ends[:1] if abs(end - limit) < far]


def _spread(values: Float64[np.ndarray, " _"], most: int) -> Float64[np.ndarray, " _"]:
    """Return some values, at most so many, from the first to the last."""
    return values[np.linspace(0, len(values) - 1, min(most, len(values))).astype(int)]


def _agree(line: StableLine, drawn: Points, slim: float, share: float, size: float) -> bool:
    rounded = 1e-11  # of the region's size: ends that are the same
    proved = np.array([[low.value, high.value] for low, high in line.intervals]).reshape(-1, 2)
    proved, drawn = (x[x[:, 1] - x[:, 0] > slim] for x in (proved, drawn))
    tolerance = share * np.max(np.ptp(drawn, axis=1), initial=0.0) + rounded * size
    return len(proved) == len(drawn) and not np.any(np.abs(proved - drawn) > tolerance)


# The outline of one loop, with as many points as it needs.


def _adapted(c: Curve, pieces: Pieces, tolerance: float) -> tuple[Outline, float]:
    bulge = 0.35  # times points^-2 is at most about how far the boundary leaves the polygon
    fewest, most, tries = 256, 65536, 2
    wanted, seen = sqrt(bulge / tolerance), survey(c, pieces)
    for _ in range(tries):
        points = max(fewest, min(ceil(wanted), most))
        outline = polygon(c, pieces, seen, points)
        deviation = float(measures.deviation(c, outline))
        if not deviation > tolerance:  # NaN: all of it is one point
            break
        wanted = 1.2 * points * sqrt(deviation / tolerance)
    return outline, deviation


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

    A search over angles finds the arcs of the boundary curve, refined until they join up to closed
    loops with the straight parts, which are proved. Then rows of walls whose stable intervals are
    all proved are compared with it: some through each component, and the lines 1e-9 within and
    beyond each limit of the component with small gains; and the other roots are asked for at the
    middle of each edge of the polygon. What may be missed is an island between these rows whose
    arcs lie between two angles, and a cut between two middles (docs/proofs.md, G1 and G3).

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
    finest = 1e-10
    if any(map(is_traced, (gamma, delta, delay, radius, tolerance))):
        raise TypeError(
            "stable_region searches outside of JAX; under jit, vmap and grad call regions_of."
        )
    stiffness = checked_number("gamma", gamma, 0.0, GAMMA_LIMIT)
    damping = checked_number("delta", delta, 0.0, DELTA_LIMIT)
    samples = checked_number("delay", delay, 0.0, LONGEST_DELAY, unit="samples")
    size = checked_number("radius", radius, 0.0, 1.0, is_open=True)
    smallest = checked_number("tolerance", tolerance, finest, is_open=True)
    filters = known_filters(velocity, position)
    loop = unit_loop(stiffness, damping, samples, **as_keywords(filters))
    return region_of(ScaledLoop(loop, (1.0, 1.0), size), smallest)


def loop_region(loop: LoopParameters, tolerance: float) -> StableRegion:
    """Return the set of all stable (alpha, beta) of a loop in SI units; else as ``region_of``."""
    return region_of(ScaledLoop(loop, (loop.stiffness(1.0), loop.damping(1.0))), tolerance)
