"""Where the curve crosses itself or one of the lines: any corner of the stable set is there.

A piece of the boundary may be shorter than the steps of a scan, but it ends at crossings; so these
are searched for, and the scan is refined around them. Between two angles of the scan the curve is
replaced by the cubic with the same ends and tangents. A cubic stays in the hull of its control
points, so two parts whose hulls are apart do not meet. For the few pairs that remain Newton's
method runs on the cubics, from four starts, and then on the curve itself. Pairs of crossings
between two angles are found too, though the side does not change from one angle to the other.

``refined_pieces`` looks for pieces with these angles, adds the angles of other roots that are next
to the circle at the ends of the pieces, and repeats this, on finer scans if need be, until nothing
new shows and the pieces join up to loops. NumPy only.
"""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from jaxstab.arrays import tree_map
from jaxstab.region.curve import Angles, Curve
from jaxstab.region.pieces import (
    Pieces,
    closer_angles,
    find_pieces,
    nearly_stable,
    others_inside,
    scan_angles,
    steps_to_meeting,
    suspects,
)
from jaxstab.region.points import curve_and_lift, curve_gains
from jaxstab.region.roots import bracketed_root, with_slope

_AT_ONCE = 1 << 20  # pairs of boxes that are held in memory
_CUBIC_STEPS = 12  # of Newton's method on the cubics
_NEWTON_STEPS = 6  # on the curve; where two parts nearly touch, each step halves the rest
_BEYOND = 0.5  # share of a part by which Newton's method may leave it
_ARRIVED = 1e-3  # share of a part: largest last step, and least distance of two angles that meet
_SAME = 1e-4  # share of a part: closer starts are one
_MISS = 0.05  # distance of cubics beside their sizes, up to which the curve may meet
_NEARLY_STABLE = 1.1  # of the circle: parts with roots farther out bound nothing
_SETTLED = 1e-9  # share of a part: a smaller step is the last one
_CLOSE = 1e-6  # crossings closer to each other are one
_STARTS = np.array([[0.0, 0.0, 1.0, 1.0], [0.0, 1.0, 0.0, 1.0]])  # of two parts: one end of each
_POWERS = np.array([[1, 0, 0, 0], [-3, 3, 0, 0], [3, -6, 3, 0], [-1, 3, -3, 1]])  # by controls

Parts = Int[np.ndarray, " _"]  # numbers of intervals between two angles of the scan

Controls = Float64[np.ndarray, "4 2 part"]


class _Cubics(NamedTuple):
    """The parts of the curve that may touch another one or a line, as cubics in their angle.

    Points and slopes are alpha, beta and the margins to the lines z = r and z = -r.
    """

    interval: Parts
    begin: Angles
    end: Angles
    controls: Float64[np.ndarray, "4 4 part"]  # the control points: (control, value, part)
    begin_slopes: Float64[np.ndarray, "4 part"]
    end_slopes: Float64[np.ndarray, "4 part"]
    line: Parts  # number of the line at a pole on which the part lies, or 0


@np.errstate(all="ignore")
def crossings(c: Curve, angles: Angles) -> Angles:
    """Return the angles, in order, at which the curve of a scan meets itself or a line."""
    cubics = _cubics(c, angles)
    if not cubics.interval.size:
        return np.empty(0)
    every = np.sort(np.concatenate([_self_crossings(c, cubics), _line_crossings(c, cubics)]))
    return every[np.diff(every, prepend=-np.inf) > _CLOSE]


def _cubics(c: Curve, angles: Angles) -> _Cubics:
    """Return the parts of the scan near the stable set, as cubics with slopes at their ends."""
    line = _lines_of_parts(c, angles)
    is_near = others_inside(c, angles, within=_NEARLY_STABLE)
    is_near = is_near[1:] | is_near[:-1] | (line != 0)  # those of lines may be long
    interval = np.flatnonzero(is_near & ~_spans_a_pole(c, angles))
    ends = np.unique(np.concatenate([interval, interval + 1]))
    values, slopes = with_slope(partial(_values, c), angles[ends])
    start = np.searchsorted(ends, interval)
    begin, end = angles[interval], angles[interval + 1]
    here, there = values[:, start], values[:, start + 1]
    begin_slopes, end_slopes = slopes[:, start], slopes[:, start + 1]
    third = (end - begin) / 3.0
    controls = np.stack([here, here + third * begin_slopes, there - third * end_slopes, there])
    return _Cubics(interval, begin, end, controls, begin_slopes, end_slopes, line[interval])


def _values(c: Curve, theta: np.ndarray) -> np.ndarray:
    """Return alpha, beta and the margins to the lines z = r and z = -r."""
    alpha, beta, lift = curve_and_lift(c, theta)
    return np.stack([alpha, beta, lift, c.minus_margin(alpha, beta)])


def _spans_a_pole(curve: Curve, angles: Angles) -> np.ndarray:
    """Return which parts have a pole between their ends, or angles of the other orientation."""
    poles = np.sort(curve.poles[0])
    count = np.searchsorted(poles, np.abs(angles)) * np.sign(angles)
    spans: np.ndarray = (np.diff(count) != 0) | (np.diff(np.sign(angles)) != 0)
    return spans


def _lines_of_parts(curve: Curve, angles: Angles) -> Parts:
    """Return the number of the line at a pole on which a part lies, which does not meet itself."""
    lines = np.zeros(len(angles), int)
    for index, line in enumerate(curve.lines):
        lines[line.is_straight(np.abs(angles))] = index + 1
    return np.where(lines[1:] == lines[:-1], lines[1:], 0)


# ---------------------------------------------------------------------------- of two parts
def _self_crossings(c: Curve, cubics: _Cubics) -> Angles:
    controls = cubics.controls[:, :2]
    pairs = np.concatenate([_touching_parts(cubics.interval, controls), _loops(cubics)], axis=1)
    line = cubics.line[pairs]
    pairs = pairs[:, (line[0] != line[1]) | (line[0] == 0)]
    if not pairs.size:
        return np.empty(0)
    parts, shares = _starts(controls, pairs)
    begin, width = cubics.begin[parts], (cubics.end - cubics.begin)[parts]
    return _meetings(c, begin + shares * width, begin, width)


def _touching_parts(interval: Parts, controls: Controls) -> Int[np.ndarray, "2 pair"]:
    """Return the pairs of parts, neighbours excepted, whose hulls may touch."""
    touching = [
        np.stack([here, there])[
            :, _hulls_overlap(controls, here, there) & _hulls_overlap(controls, there, here)
        ]
        for here, there in _overlapping_boxes(interval, controls.min(axis=0), controls.max(axis=0))
    ]
    return np.concatenate(touching, axis=1)


def _overlapping_boxes(
    interval: Parts, low: Float64[np.ndarray, "2 part"], high: Float64[np.ndarray, "2 part"]
) -> Iterator[tuple[Parts, Parts]]:
    """Yield pairs of parts, neighbours excepted, whose boxes overlap."""
    count = len(interval)
    rows = max(1, _AT_ONCE // count)
    for start in range(0, count, rows):
        block = slice(start, start + rows)
        overlap = interval[block, None] + 1 < interval[start:]
        for lower, upper in zip(low, high, strict=True):
            overlap &= lower[block, None] <= upper[start:]
            overlap &= lower[start:] <= upper[block, None]
        here, there = np.nonzero(overlap)
        yield here + start, there + start


def _hulls_overlap(controls: Controls, base: Parts, other: Parts) -> np.ndarray:
    """Return where the hulls of two parts overlap, seen along the chord of the first."""
    start = controls[0][:, base]
    along = controls[3][:, base] - start
    low, high = np.empty((2, 2, len(base)))
    for row, hull in enumerate((base, other)):
        away = controls[:, :, hull] - start
        height = along[0] * away[:, 1] - along[1] * away[:, 0]
        low[row], high[row] = height.min(axis=0), height.max(axis=0)
    overlap: np.ndarray = (low[0] <= high[1]) & (low[1] <= high[0])
    return overlap


def _loops(cubics: _Cubics) -> Int[np.ndarray, "2 pair"]:
    """Return the parts that turn, alone or with the next one, by more than a right angle.

    There may be a loop about what was a cusp: each is a pair with itself and with the next one.
    """
    begin, end = cubics.begin_slopes[:2], cubics.end_slopes[:2]
    turns = np.sum(begin * end, axis=0) < 0.0
    both_turn = np.sum(begin[:, :-1] * end[:, 1:], axis=0) < 0.0
    is_next = np.diff(cubics.interval) == 1
    is_loop = turns.copy()
    is_loop[:-1] |= is_next & (turns[1:] | both_turn)
    alone, with_next = np.flatnonzero(is_loop), np.flatnonzero(is_loop[:-1] & is_next)
    return np.stack([np.append(alone, with_next), np.append(alone, with_next + 1)])


def _starts(
    controls: Controls, pairs: Int[np.ndarray, "2 pair"]
) -> tuple[Int[np.ndarray, "2 start"], Float64[np.ndarray, "2 start"]]:
    """Return pairs of parts with the shares of them at which their cubics meet, or all but do."""
    parts = np.repeat(pairs, _STARTS.shape[1], axis=1)
    # (power, value, of the pair, start)
    constant, once, twice, thrice = np.tensordot(_POWERS, controls, 1)[:, :, parts]
    doubled, tripled = 2.0 * twice, 3.0 * thrice
    shares = np.tile(_STARTS, pairs.shape[1])
    for _ in range(_CUBIC_STEPS):
        points = constant + shares * (once + shares * (twice + shares * thrice))
        slopes = once + shares * (doubled + shares * tripled)
        steps = np.stack(steps_to_meeting(*points, *slopes))
        shares = np.clip(shares - steps, -_BEYOND, 1.0 + _BEYOND)
    away = np.sum((points[:, 0] - points[:, 1]) ** 2, axis=0)
    size = np.max(np.ptp(controls, axis=0)[:, parts], axis=(0, 1)) ** 2
    chosen = np.flatnonzero(away < _MISS**2 * size)
    rounded = np.concatenate([parts, np.round(shares / _SAME)])[:, chosen]
    _, unique = np.unique(rounded, axis=1, return_index=True)
    return parts[:, chosen[unique]], shares[:, chosen[unique]]


def _meetings(
    c: Curve,
    start: Float64[np.ndarray, "2 pair"],
    begin: Float64[np.ndarray, "2 pair"],
    width: Float64[np.ndarray, "2 pair"],
) -> Angles:
    """Return the angles at which the curve meets itself, of pairs of parts."""
    lowest, highest = begin - _BEYOND * width, begin + (1.0 + _BEYOND) * width
    angles, last = start.copy(), np.full_like(start, np.inf)
    moving = np.arange(start.shape[1])
    for _ in range(_NEWTON_STEPS):
        if not moving.size:
            break
        points, slopes = with_slope(partial(curve_gains, c), angles[:, moving])
        steps = np.stack(steps_to_meeting(*points, *slopes))
        moved = np.clip(angles[:, moving] - steps, lowest[:, moving], highest[:, moving])
        stays = np.all(np.abs(moved - angles[:, moving]) <= _SETTLED * width[:, moving], axis=0)
        angles[:, moving], last[:, moving] = moved, steps
        moving = moving[~stays]
    apart = np.abs(angles[0] - angles[1]) > _ARRIVED * np.max(width, axis=0)
    arrived = np.all(np.abs(last) < _ARRIVED * width, axis=0) & apart
    meetings: Angles = angles[:, arrived].ravel()
    return meetings


# ------------------------------------------------------------------------ of parts and lines
def _line_crossings(c: Curve, cubics: _Cubics) -> Angles:
    controls, begin, end = cubics.controls[:, 2:], cubics.begin, cubics.end
    crosses = _unlike(controls[0], controls[3])
    line, step = np.nonzero(crosses)
    may_touch = (controls.min(axis=0) < 0.0) & (controls.max(axis=0) > 0.0)
    returns = may_touch & ~crosses & _unlike(cubics.begin_slopes[2:], cubics.end_slopes[2:])
    near_line, near_step = np.nonzero(returns)
    lower, upper = begin[near_step], end[near_step]
    nearest = bracketed_root(partial(_margin_slope, c, near_line), lower, upper)
    begins, ends = np.concatenate([lower, nearest]), np.concatenate([nearest, upper])
    margins = controls[0][crosses], controls[3][crosses]
    across = bracketed_root(partial(_margin, c, line), begin[step], end[step], margins)
    margin = partial(_margin, c, np.tile(near_line, 2))
    return np.append(across, bracketed_root(margin, begins, ends))


def _unlike(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    unlike: np.ndarray = (a > 0.0) != (b > 0.0)
    return unlike


def _margin(c: Curve, line: Parts, theta: np.ndarray) -> np.ndarray:
    """Return how far the curve is from the line z = r, number 0, or z = -r, number 1."""
    return np.choose(line, _values(c, theta)[2:])


def _margin_slope(c: Curve, line: Parts, theta: np.ndarray) -> np.ndarray:
    return with_slope(partial(_margin, c, line), theta)[1]


# The search for the pieces of one curve: finer and finer, until they close to loops.

# Fineness of the scan, the most angles to look closer at, and how far other roots may be outside of
# the circle there. The last ones take the angles of the best chances only.
_SCANS = ((1, 24, 1e-4), (4, 192, 1e-4), (16, 768, 1e-4), (64, 1536, 1e-7))
_FEW_SCANS = 2  # where digits are short: finer ones take minutes and resolve no more
_EMPTY_FINENESS = 4
_ROUNDS = 8
_KEPT = 32  # pieces that do not close


def refined_pieces(c: Curve, *, may_be_empty: bool) -> Pieces:
    """Return pieces that join up to loops, searched until nothing hides at their ends.

    With damping, the loop without a wall is stable, so an empty answer means that the scan was too
    coarse. Where even the finest scan is not enough, the pieces' ``resolved`` is False.
    """
    coarsest = scan_angles(c, 1)
    closer = crossings(c, coarsest)
    scans = _SCANS[: _FEW_SCANS if c.is_exact or c.may_lose_some else None]
    for fineness, most, outside in scans:
        scan = coarsest if fineness == 1 else scan_angles(c, fineness)
        pieces, closer, is_settled = _settled_pieces(c, scan, closer, most, outside)
        if is_settled:
            return pieces
        if may_be_empty and fineness >= _EMPTY_FINENESS and not pieces.begin.size:
            return pieces
    truncated = tree_map(lambda x: x[:_KEPT] if x.ndim else x, pieces)  # there may be 1e5 of them
    nowhere = np.zeros(len(truncated.begin), int)
    return truncated._replace(successor=nowhere, resolved=np.bool_(False))


def _settled_pieces(
    c: Curve, scan: Angles, closer: Angles, most: int, outside: float
) -> tuple[Pieces, Angles, bool]:
    """Look closer at more and more angles, until no new one shows; return whether all is resolved.

    Beside the pieces, the angles looked at are returned.
    """
    closer = nearly_stable(c, closer, outside)
    for _ in range(_ROUNDS):
        pieces = find_pieces(c, closer_angles(c, scan, closer[:most]))
        if not pieces.begin.size:
            return pieces, closer, False
        fresh = suspects(c, pieces, closer, outside)
        closer = np.sort(np.concatenate([closer, fresh]))
        if not fresh.size or len(closer) > most:
            is_all = not fresh.size and len(closer) <= most
            return pieces, closer, is_all and bool(pieces.resolved)
    return pieces, closer, False
