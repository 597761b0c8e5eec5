"""The pieces of the closed-form boundary that bound the stable set, and how they join.

A point of the curve bounds the stable set exactly where the other roots of p lie inside of the
circle (``other_roots``). So the search is one-dimensional: a *piece* is an interval of th that
passes that test. The stable set lies to the left of a piece in the direction of growing th, because
z -> (alpha, beta) preserves orientation. A piece ends where another root reaches the circle: a real
one (a corner with one of the two lines) or a pair (a corner with another piece, which begins
there). The stable set is bounded and two lines bound nothing, so each component has a piece (lemma
G1): what a scan of th can miss are components of which it meets no piece (docs/proofs.md, G3).
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from jaxstab.arrays import Array, constant, first_indices, kept, namespace, repeat
from jaxstab.region.corners import Branch, Scales, nearest_branch, scales, solved_corners
from jaxstab.region.curve import SliceCoefficients, curve_and_lift
from jaxstab.region.lines import along_lines, lines_crossing, lines_turn
from jaxstab.region.other_roots import lines_crossing_is_stable, others_inside

_SLACK = 1e-6  # of angles: with more roots close to the circle, the margin shifts the ends
_NARROWING = {"numpy": (2, 23), "jax": (9, 2)}  # rounds, parts: few calls, or few angles
_EXACT_NARROWING = 16, 8, 1e-14  # and the width that is enough
_STRAY = 16.0  # brackets: an iterate of Newton's method this far outside is given up
NO_BRANCH = -1


class Pieces(NamedTuple):
    """Intervals of th that bound the stable set; arrays of one length, in JAX a fixed one, padded.

    ``begin`` and ``end`` are angles, ``begin_low`` and ``end_low`` what rounding took from them,
    and ``begin_branch``, ``end_branch`` say what the piece meets there (a Branch). After its end
    the boundary goes on to the piece ``successor``: at once, or along a line, or ``via`` the
    crossing of both lines. ``resolved`` is False where the pieces do not join up to loops.
    """

    exists: Array
    begin: Array
    end: Array
    begin_low: Array
    end_low: Array
    begin_branch: Array
    end_branch: Array
    successor: Array
    via: Array
    resolved: Array


class _Ends(NamedTuple):
    """The ends of all pieces, first the begins, then the ends.

    ``pinned`` ones are at a ``limit`` of the angles: 0 or +-pi, on a ``line``, or a knot, where a
    line at a pole meets the curve and the next piece begins. ``outer`` and
    ``inner`` fail and pass the test of the other roots; ``rough`` lies between them and ``points``
    (2, end) are the curve's there.
    """

    exists: Array
    pinned: Array
    limit: Array
    line: Array
    outer: Array
    inner: Array
    rough: Array
    points: Array
    scale: Scales


class _Links(NamedTuple):
    """What follows each piece, whether via the crossing of both lines, and whether it exists."""

    successor: Array
    via: Array
    exists: Array


def find_pieces(
    c: SliceCoefficients, angles: Array, *, length: int, slots: int | None = None
) -> Pieces:
    """Return the pieces of one slice that a scan over these angles finds.

    Args:
        c: the coefficients of the slice.
        angles: of the scan, in (0, pi) and in order.
        length: that of the polynomials with the other roots: floor(delay) + 3, or more.
        slots: the largest number of pieces and the length of the arrays; JAX needs it.

    Source: the D-decomposition of Gryazina, Polyak, Tremba (2008), with the criterion of Schur and
    Cohn for the other roots. Differentiable in the slice by the theorem of the implicit function.
    """
    xp = namespace(c, angles)
    known = constant(c)
    ends, fits = _found_ends(known, angles, length, slots)
    slots = len(ends.exists) // 2
    to_join, _, _ = _joined(ends, ends.exists & ~ends.pinned)
    met = nearest_branch(known, to_join, ends.scale)
    branch = xp.where(ends.exists, xp.where(ends.pinned, ends.line, met), NO_BRANCH)
    to_join, following, preceding = _joined(ends, branch == Branch.CURVE)
    if c.filtered is not None and c.filtered.lines:
        following, preceding = _across_knots(ends, following, preceding)
    theta, low, is_solved = _solved(c, ends, branch, to_join)

    begin, end = (
        xp.where(ends.exists[:slots], x, xp.asarray(1.0 + i)) for i, x in enumerate(theta)
    )
    begin_branch, end_branch = branch[:slots], branch[slots:]
    exists = ends.exists[:slots]
    walls = kept(xp.stack(curve_and_lift(known, xp.stack([begin, end]))[:2]))
    links = _linked(known, exists, walls, begin_branch, end_branch, following)
    number = xp.arange(slots)
    is_mutual = (begin_branch[following] == Branch.CURVE) & (preceding[following] == number)
    follows = exists[:, None] & (links.successor[:, None] == number)
    is_closed = (
        xp.all(xp.isfinite(walls[1]), axis=0)
        & ((end_branch != Branch.CURVE) | is_mutual)
        & links.exists
        & (xp.sum(follows, axis=0) == 1)
        & xp.all(is_solved, axis=0)
        & (~links.via | _may_turn(known, links.via, length))
        & (begin < end)
    )
    return Pieces(
        exists=exists,
        begin=begin,
        end=end,
        begin_low=low[0],
        end_low=low[1],
        begin_branch=begin_branch,
        end_branch=end_branch,
        successor=links.successor,
        via=links.via & exists,
        resolved=fits & xp.all(~exists | is_closed),
    )


# ---------------------------------------------------------------------------- where pieces end


def _found_ends(
    c: SliceCoefficients, angles: Array, length: int, slots: int | None
) -> tuple[_Ends, Array]:
    """Return the ends of the pieces between two angles each, and whether all fit into the slots."""
    xp = namespace(c, angles)
    inside = partial(others_inside, c, length=length)
    passes = xp.concatenate([xp.zeros(1, bool), kept(inside(angles)), xp.zeros(1, bool)])
    before, after = passes[:-2], passes[2:]
    is_knot = _are_knots(c, angles)
    if is_knot is not None:
        before, after = before & ~is_knot[0], after & ~is_knot[1]
    is_begin, is_end = passes[1:-1] & ~before, passes[1:-1] & ~after
    count = xp.sum(is_begin)
    slots = max(int(count), 1) if slots is None else slots
    begins, ends = first_indices(is_begin, slots), first_indices(is_end, slots)
    exists = xp.tile(begins < len(angles), 2)
    first = xp.sum(angles < 0.0)  # negative angles, of filters, begin at -pi
    at_zero = begins == first
    pinned = xp.concatenate([at_zero | (begins == 0), ends == len(angles) - 1])
    limit = xp.concatenate([xp.where(at_zero, 0.0, -xp.pi), xp.full(slots, xp.pi)])
    line = xp.where(limit == 0.0, Branch.Z_PLUS_ONE, Branch.Z_MINUS_ONE)
    if is_knot is not None:
        at_knot = (
            np.concatenate(
                [
                    part[np.minimum(k, len(angles) - 1)]
                    for part, k in zip(is_knot, (begins, ends), strict=True)
                ]
            )
            & exists
        )
        pinned = pinned | at_knot
        at_ends = angles[np.minimum(np.concatenate([begins, ends]), len(angles) - 1)]
        limit = np.where(at_knot, at_ends, limit)
        line = np.where(at_knot, Branch.CURVE, line)
    # Both ends of all pieces are solved in one batch.
    padded = xp.concatenate([xp.zeros(1), angles, xp.full(1, xp.pi)])
    neighbours = padded[xp.minimum(xp.concatenate([begins, ends + 2]), len(angles) + 1)]
    is_exact = c.filtered is not None and c.filtered.is_exact
    outer, inner = _narrowed(
        inside,
        _EXACT_NARROWING if is_exact else (*_NARROWING["numpy" if xp is np else "jax"], _SLACK),
        xp.where(pinned, limit, neighbours),
        padded[xp.concatenate([begins, ends]) + 1],
    )
    rough = xp.where(exists, 0.5 * (outer + inner), 1.0)
    points = kept(xp.stack(curve_and_lift(c, rough)[:2]))
    scale = scales(c, points[0], points[1], rough)
    return _Ends(exists, pinned, limit, line, outer, inner, rough, points, scale), count <= slots


def _are_knots(c: SliceCoefficients, angles: Array) -> tuple[Array, Array] | None:
    """Return which angles are knots at which pieces begin, and which are those where they end.

    A scan has them twice; without lines at poles there are none.
    """
    if c.filtered is None or not c.filtered.lines:
        return None
    knots = np.concatenate([line.knots for line in c.filtered.lines])
    twice = (np.diff(angles) == 0.0) & np.isin(np.abs(angles[1:]), knots)
    return np.append(False, twice), np.append(twice, False)


def _across_knots(ends: _Ends, following: Array, preceding: Array) -> tuple[Array, Array]:
    """Join the pieces that end at a knot and the next ones, which begin there."""
    count = len(following)
    at_knot = ends.exists & ends.pinned & (ends.line == Branch.CURVE)
    number = np.arange(count)
    following = np.where(at_knot[count:], number + 1, following)
    return following, np.where(at_knot[:count], number - 1, preceding)


def _narrowed(
    inside: Callable[[Array], Array],
    narrowing: tuple[int, int, float],
    outer: Array,
    inner: Array,
) -> tuple[Array, Array]:
    """Divide the intervals between angles that fail the test and angles that pass it."""
    xp = namespace(outer, inner)
    rounds, parts, enough = narrowing
    if xp is np and np.max(abs(outer - inner)) <= enough:
        return outer, inner
    steps = xp.arange(1.0, parts)[:, None]

    def divided(ends: Array) -> Array:
        outer, inner = ends

        def ladder(step: Array) -> Array:
            return outer + (inner - outer) * (step / parts)

        failed = xp.cumprod(~inside(ladder(steps)), axis=0)  # up to the first that passes
        last = xp.sum(failed, axis=0)
        beyond = xp.where(last == parts - 1, inner, ladder(last + 1.0))
        return xp.stack([ladder(1.0 * last), beyond])

    return tuple(repeat(rounds, divided, kept(xp.stack([outer, inner]))))


def _joined(ends: _Ends, is_open: Array) -> tuple[Array, Array, Array]:
    """Return for open ends their angles and those next to them, and which is next to which."""
    xp = namespace(ends)
    slots = len(is_open) // 2
    begins, lasts = ends.points[:, None, :slots], ends.points[:, slots:, None]
    gaps = xp.sum((lasts - begins) ** 2, axis=0)
    gaps = xp.where(is_open[slots:, None] & is_open[None, :slots], gaps, xp.inf)
    following, preceding = xp.argmin(gaps, axis=1), xp.argmin(gaps, axis=0)
    others = ends.rough[xp.concatenate([slots + preceding, following])]
    return xp.stack([ends.rough, others]), following, preceding


def _solved(
    c: SliceCoefficients, ends: _Ends, branch: Array, angles: Array
) -> tuple[Array, Array, Array]:
    """Return angles, what rounding took from them, and whether they are right; (2, piece) each."""
    xp = namespace(c, ends)
    half_width = _STRAY * (abs(ends.outer - ends.inner) + _SLACK)
    unpinned = xp.where(ends.pinned, NO_BRANCH, branch)
    theta, low, is_solved = solved_corners(c, unpinned, angles, ends.scale, half_width)
    slack = 2.0 * abs(ends.outer - ends.inner) + _SLACK
    is_between = (theta >= xp.minimum(ends.outer, ends.inner) - slack) & (
        theta <= xp.maximum(ends.outer, ends.inner) + slack
    )
    is_solved = ends.pinned | (is_solved & is_between)
    theta, low = xp.where(is_solved, theta, ends.rough), xp.where(is_solved, low, 0.0)
    theta, low = xp.where(ends.pinned, ends.limit, theta), xp.where(ends.pinned, 0.0, low)
    return theta.reshape(2, -1), low.reshape(2, -1), is_solved.reshape(2, -1)


# ------------------------------------------------------------------------ what follows a piece


def _may_turn(c: SliceCoefficients, via: Array, length: int) -> Array:
    """Return whether the boundary may turn where the lines cross, if any piece asks for it."""
    if namespace(c, via) is np and not np.any(via):
        return np.False_
    return lines_crossing_is_stable(c, length)


def _linked(
    c: SliceCoefficients,
    exists: Array,
    walls: Array,
    begin_branch: Array,
    end_branch: Array,
    following: Array,
) -> _Links:
    """Return what follows each piece.

    ``walls`` are alpha and beta of the begins and of the ends.
    """
    xp = namespace(c, walls)
    plus, minus = along_lines(c, *walls)
    plus_start, minus_start = along_lines(c, *lines_crossing(c))
    from_plus = end_branch == Branch.Z_PLUS_ONE
    exits = xp.where(from_plus[:, None], plus[0], minus[0])
    ahead = exits - xp.where(from_plus, plus[1], minus[1])[:, None]
    here = exists & (begin_branch == end_branch[:, None]) & (ahead > 0.0)
    # Along this line the boundary may run into the other one, and not come from there.
    runs_in = lines_turn(c) * xp.where(from_plus, 1.0, -1.0) > 0.0
    other_line = xp.where(from_plus, Branch.Z_MINUS_ONE, Branch.Z_PLUS_ONE)
    around = xp.where(from_plus[:, None], minus[0] - minus_start, plus[0] - plus_start)
    there = exists & (begin_branch == other_line[:, None]) & (around > 0.0) & runs_in[:, None]
    straight = xp.any(here, axis=1)
    distance = xp.where(
        straight[:, None], xp.where(here, ahead, xp.inf), xp.where(there, around, xp.inf)
    )
    crosses = end_branch == Branch.CURVE
    return _Links(
        successor=xp.where(crosses, following, xp.argmin(distance, axis=1)),
        via=~crosses & ~straight,
        exists=crosses | straight | xp.any(there, axis=1),
    )
