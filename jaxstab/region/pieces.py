"""The arcs of the curve that bound the stable set, and how they join with its straight parts.

A point of the curve bounds the stable set exactly where the other roots of p lie inside of the
circle, and the set is then on the left (lemmas G1 and G3 of docs/proofs.md). So the search is
one-dimensional: angles are tested by the recursion of Schur and Cohn of p without its pair, in
float64, and neighbours that pass are one *arc*. Its ends are narrowed by dividing their brackets,
but where a bracket is short and holds the end of a straight part, which balls know.

An arc ends where another root reaches the circle. If that is the root of one of the lines, the end
of a straight part of the boundary has the arc's angle, and balls know both (``Curve.lines``).
Otherwise another arc begins there, and Newton's method finds the corner of the two. Where all ends
are joined the boundary consists of closed loops; what stays open has been missed by the angles. At
such an end the angle of the second pair on the circle tells where the arc that was missed begins.

Straight parts may form a loop without an arc. Where two lines cross, crossing either one moves a
root or a pair in or out, so the walls in one of the four sectors are stable at most: such a loop is
convex, and is the outer boundary of a component.
"""

from collections.abc import Iterable, Iterator
from enum import IntEnum
from itertools import product
from math import nan
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array
from jaxstab.exact.boundary import others_inside as balls_inside
from jaxstab.exact.line import End
from jaxstab.region.curve import (
    Angles,
    Curve,
    curve_gains,
    drawn_angles,
    gains_and_slopes,
    is_oriented,
    nonzero,
    true_angles,
)
from jaxstab.rounding import UNIT

NO_BRANCH = -1
MARGIN = 1e-12  # reflection coefficients closer to 1 are taken for roots on the circle
_AT_ONCE = 1 << 18  # coefficients of polynomials that are held in memory
_FIRST = 1e-7  # the angles next to 0 and pi
_ANGLES_AGREE, _WALLS_AGREE = 1e-6, 1e-8
_ANGLES_NEAR, _WALLS_NEAR = 1e-4, 1e-3  # an end that is not exact

Centers = Float64[np.ndarray, "_ 2"]  # angles, and what rounding took from them


class Branch(IntEnum):
    """The root that lies on the circle along a piece of the boundary.

    Example:
        >>> [branch.name for branch in jaxstab.results.Branch]
        ['CURVE', 'Z_PLUS_ONE', 'Z_MINUS_ONE']
    """

    CURVE = 0
    Z_PLUS_ONE = 1
    Z_MINUS_ONE = 2


class Edge(NamedTuple):
    """A straight part of the boundary: the angle of the root that stays, and where it ends."""

    angle: float
    wall: Float64[np.ndarray, "2"]

    @property
    def branch(self) -> Branch:
        """The root that stays; a pair at a pole counts as the curve."""
        return {0.0: Branch.Z_PLUS_ONE, np.pi: Branch.Z_MINUS_ONE}.get(self.angle, Branch.CURVE)


class Pieces(NamedTuple):
    """Arcs, from the angles ``begin`` to ``end``, and what follows each.

    Attributes:
        begin, end: angles, which are equal where a piece is straight.
        begin_wall, end_wall: the walls there.
        edges: the straight parts that follow.
        successor: the arc that begins at the end of these.
        open: walls at ends that nothing joins; without any the boundary is closed.
        lone: the angles of such ends of arcs.
    """

    begin: Angles
    end: Angles
    begin_wall: Float64[np.ndarray, "piece 2"]
    end_wall: Float64[np.ndarray, "piece 2"]
    edges: list[list[Edge]]
    successor: list[int]
    open: Float64[np.ndarray, "wall 2"]
    lone: Angles


# ----------------------------------------------------------------------- the angles of a scan
def scan_angles(c: Curve, centers: Centers, *, with_balls: bool = False) -> Angles:
    """Return angles, more of them around poles, resonances and given centres; see ``curve``.

    Where the other roots are counted in balls, angles come closer to ends that are proved.
    """
    if c.is_straight:
        return np.empty(0)
    per_turn, fewest, per_branch = 8, 500, 20  # even angles: of a turn of z^n, and of a branch
    to_ends = 12  # angles that come closer and closer
    to_poles, to_proved = 1e-11, 1e-14 if with_balls else 1e-9  # how close
    count = max(per_turn * c.degree, fewest, per_branch * (len(c.poles) + 1))
    step = np.pi / count
    even = step * (np.arange(count) + 0.5)
    start = _FIRST * (even[0] / _FIRST) ** (np.arange(to_ends) / to_ends)
    around = [
        _around(c.poles, to_poles, step),
        _around(drawn_angles(c, *angles_of(line_ends(c)).T), to_proved, step),
        _around(drawn_angles(c, *centers.T), to_poles, step),
        _around_resonances(c),
        *(stretch.scan for stretch in c.stretches),
    ]
    angles = np.concatenate([even, *around])
    angles = angles[(angles > _FIRST) & (angles < np.pi - _FIRST)]
    angles = np.unique(np.concatenate([start, angles, np.pi - start]))
    return np.sort(np.where(is_oriented(c, angles), angles, -angles))


def line_ends(c: Curve) -> list[End]:
    """Return the ends of straight parts."""
    return [end for line in c.lines for ends in line.line.intervals for end in ends]


def angles_of(ends: "Iterable[End | _Stop]") -> Centers:
    """Return angles and what rounding took from them; NaN where an end has none."""
    return np.array([(end.angle, end.angle_rest) for end in ends]).reshape(-1, 2)


def _around(centers: Angles, closest: float, farthest: float) -> Angles:
    to_centers = 14  # angles that come closer and closer
    offsets = closest * (farthest / closest) ** (np.arange(to_centers) / (to_centers - 1))
    return (centers[:, None] + np.concatenate([-offsets, offsets])).ravel()


def _around_resonances(c: Curve) -> Angles:
    """Return angles around roots of the plant, in steps that grow with the distance."""
    to_roots = 16  # angles around a resonance
    widths = 8.0  # of a resonance
    angle, width = c.resonances[:, :, None]
    extent = np.maximum(angle, widths * width)
    growth = np.linspace(0.0, 1.0, to_roots)
    offsets = width / widths * (extent / (width / widths)) ** growth
    return (angle + np.concatenate([-offsets, offsets], axis=1)).ravel()


# ------------------------------------------------------------------------ the other roots of p
def others_inside(c: Curve, theta: Angles, *, with_balls: bool = False) -> Bool[np.ndarray, " _"]:
    """Return where all roots of p but those at e^(+-i theta) lie inside of the circle.

    In float64, or by balls where that is not clear, which takes a thousand times as long.

    Source: the criterion of Schur and Cohn, as a recursion for the polynomial and its reverse.
    """
    if theta.size * c.degree > _AT_ONCE and theta.size > 1:
        chunks = np.array_split(theta, -(-theta.size * c.degree // _AT_ONCE))
        return np.concatenate([others_inside(c, chunk, with_balls=with_balls) for chunk in chunks])
    angles = np.abs(theta)
    true = true_angles(c, angles)
    alpha, beta = curve_gains(c, angles)
    terms = c.ends[..., None] * np.stack([np.ones_like(alpha), alpha, beta])
    slack = -UNIT if with_balls else UNIT
    inside = np.all(np.sum(terms, axis=1) > 16 * slack * np.sum(abs(terms), axis=1), axis=0)
    base, stiffness, damping = c.parts[:, :-2, None]
    falling = base + (stiffness * alpha[inside] + damping * beta[inside])
    others = without_pair(falling, 2.0 * np.cos(true[0][inside] + true[1][inside]))
    answers = all_inside(others)
    if with_balls:
        doubted = ~_is_clear(others)
        answers[doubted] = balls_inside(c.loop, *(x[inside][doubted] for x in true))
    inside[inside] = answers
    return inside


class Passes:
    """Where all other roots lie inside, for angles of which each is asked once."""

    def __init__(self, c: Curve, *, with_balls: bool = False) -> None:
        self.c, self.with_balls = c, with_balls
        self.asked, self.answers = np.empty(0), np.empty(0, bool)

    def __call__(self, theta: Array) -> Array:
        """Return where they do; see ``others_inside``."""
        new = np.setdiff1d(theta, self.asked)
        if new.size:
            place = np.searchsorted(self.asked, new)
            own = others_inside(self.c, new, with_balls=self.with_balls)
            self.asked = np.insert(self.asked, place, new)
            self.answers = np.insert(self.answers, place, own)
        return self.answers[np.searchsorted(self.asked, theta)]


def without_pair(falling: Array, total: Array, product: Array | float = 1.0) -> Array:
    """Divide polynomials by z^2 - total z + product, two roots of each; highest power first.

    The last two coefficients of a polynomial do not count, and are not given.
    """
    quotient = np.empty_like(falling)
    before = last = np.zeros_like(falling[0])
    for power, coefficient in enumerate(falling):
        before, last = last, coefficient + total * last - product * before
        quotient[power] = last
    return quotient


@np.errstate(all="ignore")  # NaN and infinity are answers
def all_inside(falling: Array, radius: Array | float = 1.0) -> Bool[np.ndarray, " polynomial"]:
    """Return where all roots of polynomials (coefficient, polynomial) lie inside of a circle.

    In float64, and not proved. The recursion runs on fewer and fewer polynomials, which are shorter
    and shorter.
    """
    at_once = 32  # steps after which the polynomials that failed are dropped
    falling = falling / radius ** np.arange(len(falling))[:, None]
    passes, index = np.zeros(falling.shape[1], bool), np.arange(falling.shape[1])
    while len(falling) > 1 and index.size:
        inside = np.ones(index.size, bool)
        for _ in range(min(at_once, len(falling) - 1)):
            falling, reflection = _lowered(falling)
            inside &= abs(reflection) < 1.0 - MARGIN
        falling, index = falling[:, inside], index[inside]
    passes[index] = True
    return passes


def _is_clear(falling: Array) -> Bool[np.ndarray, " polynomial"]:
    """Return where rounding is far from changing the answer of ``all_inside``.

    That is not proved: what is lost grows by each step, about as 1 over 1 less the reflection.
    """
    far = 1e4  # times that; of 6,000 hostile polynomials none was wrong beyond 12
    lost = np.full(falling.shape[1], len(falling) ** 2 * UNIT)
    is_clear, is_open = np.ones(lost.shape, bool), np.ones(lost.shape, bool)
    while len(falling) > 1 and np.any(is_open):
        falling, reflection = _lowered(falling)
        apart = np.abs(1.0 - np.abs(reflection))
        lost = lost / apart
        is_clear &= ~is_open | (apart > far * lost)
        is_open &= is_clear & (np.abs(reflection) < 1.0)
    return is_clear


def _lowered(falling: Array) -> tuple[Array, Array]:
    reflection = falling[-1] / falling[0]
    return falling[:-1] - reflection * falling[:0:-1], reflection


# ---------------------------------------------------------------------------------- the arcs
class _ArcEnds(NamedTuple):
    """The ends of arcs, first all begins: angle, width of the bracket, wall.

    ``is_pinned``: at 0 or pi.
    """

    theta: Angles
    width: Angles
    is_pinned: Bool[np.ndarray, " end"]
    walls: Float64[np.ndarray, "end 2"]


def _arc_ends(c: Curve, angles: Angles, inside: Passes) -> _ArcEnds:
    rounds, parts = (26, 2) if inside.with_balls else (6, 32)  # of the brackets of ends
    nothing = 0.0 if inside.with_balls else 3e-11  # radians: shorter arcs and gaps are rounding
    passes = inside(angles)
    branch = np.searchsorted(np.concatenate([-c.poles[::-1], [0.0], c.poles]), angles)
    goes_on = passes[:-1] & passes[1:] & (branch[:-1] == branch[1:])
    begins = np.flatnonzero(passes & ~np.append(False, goes_on))
    ends = np.flatnonzero(passes & ~np.append(goes_on, False))
    inner = angles[np.concatenate([begins, ends])]
    padded = np.concatenate([angles[:1], angles, angles[-1:]])
    outer = padded[np.concatenate([begins, ends + 2])]
    limit = np.where(np.abs(inner) <= _FIRST, 0.0, np.sign(inner) * np.pi)
    is_pinned = np.abs(inner - limit) <= 1.001 * _FIRST
    is_pinned &= (inner - limit) * np.repeat([1.0, -1.0], len(begins)) >= 0.0
    outer = np.where(is_pinned, inner, outer)
    enough = 0.1 * nothing
    shares = np.arange(1.0, parts)[:, None] / parts
    # Poles end arcs, too.
    limits = np.concatenate([-c.poles[::-1], c.poles])
    if limits.size:
        nearest = np.searchsorted(limits, inner) - np.repeat([1, 0], len(begins))
        pole = limits[np.clip(nearest, 0, len(limits) - 1)]
        outer = np.where((pole - inner) * (pole - outer) < 0.0, pole, outer)
    if not inside.with_balls:
        inner, outer = _at_line_ends(c, inner, outer)
    for _ in range(rounds if len(inner) else 0):
        width = inner - outer
        if np.max(np.abs(width)) < enough:
            break
        failed = np.cumprod(~inside(outer + width * shares), axis=0)
        last = np.sum(failed, axis=0)  # up to the first that passes
        inner = np.where(last == parts - 1, inner, outer + width * (last + 1.0) / parts)
        outer = outer + width * (last / parts)
    theta = np.where(is_pinned, limit, 0.5 * (inner + outer))
    begin, end = theta.reshape(2, -1)
    keeps_gap = np.append(True, begin[1:] - end[:-1] > nothing) if len(begin) else np.ones(0, bool)
    firsts, lasts = np.flatnonzero(keeps_gap), np.flatnonzero(np.append(keeps_gap[1:], True))
    lasts = lasts[: len(firsts)]
    is_long = end[lasts] - begin[firsts] > nothing
    chosen = np.concatenate([firsts[is_long], len(begin) + lasts[is_long]])
    theta = theta[chosen]
    return _ArcEnds(theta, abs(inner - outer)[chosen], is_pinned[chosen], curve_gains(c, theta).T)


def _at_line_ends(c: Curve, inner: Angles, outer: Angles) -> tuple[Angles, Angles]:
    """Return brackets, or twice the end of a straight part that a short one holds, and no other."""
    short = 1e-8  # radians
    sizes = drawn_angles(c, *angles_of(line_ends(c)).T)
    known = np.sort(np.concatenate([-sizes, sizes, [np.inf]]))
    first = np.searchsorted(known, np.minimum(inner, outer), side="right")
    is_alone = np.searchsorted(known, np.maximum(inner, outer)) - first == 1
    is_known = is_alone & (np.abs(inner - outer) < short)
    return np.where(is_known, known[first], inner), np.where(is_known, known[first], outer)


def second_pairs(c: Curve, theta: Angles) -> Angles:
    """Return the angles of the second pairs on the circle at ends of arcs: arcs begin there.

    NaN where none is found. Angles are not drawn out. Newton's method begins at those of some even
    angles that are about as close to a root as to their neighbours.
    """
    about = 1e-6  # what rounding may move roots by
    per_root, steps = 4, 6  # even angles, and of Newton's method
    walls = np.vstack([np.ones(len(theta)), curve_gains(c, theta)])
    finite = np.flatnonzero(np.all(np.isfinite(walls), axis=0))
    falling = walls[:, finite].T @ c.parts
    count = per_root * c.degree
    orders = np.arange(c.degree, -1.0, -1.0)
    p, turned = (np.fft.rfft(x[:, ::-1], 2 * count) for x in (falling, falling * orders))
    end, place = np.nonzero(np.abs(p) * count < np.pi * np.abs(turned))
    z, own = np.exp(1j * np.pi / count * place), falling[end].T
    for _ in range(steps):
        value, slope = own[0].astype(complex), np.zeros_like(z)
        for coefficient in own[1:]:
            slope = slope * z + value
            value = value * z + coefficient
        z = z - value / slope
    aside, angle = np.abs(np.abs(z) - 1.0), np.angle(z)
    is_other = (angle > 0.0) & (np.abs(angle - theta[finite[end]]) > about) & (aside < about)
    aside = np.where(is_other, aside, np.inf)
    found, order = np.full(len(theta), nan), np.argsort(-aside, kind="stable")
    order = order[is_other[order]]
    found[finite[end[order]]] = angle[order]  # the closest one of each comes last
    return found


# ------------------------------------------------------------------------------------- joining
class _Stop(NamedTuple):
    """An end of a straight part: the line, the angle that ends it, and the wall there.

    The angle is NaN where several roots reach the circle: the next arc begins with one of them.
    Where stable walls turn from one side of a line to the other, the curve passes the line. Such an
    end has a direction, into its part.
    """

    line: int
    angle: float
    angle_rest: float
    wall: Float64[np.ndarray, "2"]
    inwards: Float64[np.ndarray, "2"] | None = None


def _stops(c: Curve) -> Iterator[_Stop]:
    """Both ends of each straight part, one after the other: that of number k has another, k ^ 1."""
    for number, line in enumerate(c.lines):
        for interval in line.line.intervals:
            angles = (nan if end.is_shared else end.angle for end in interval)
            low, high = (
                _Stop(number, angle, end.angle_rest, line.wall(end.value))
                for angle, end in zip(angles, interval, strict=True)
            )
            yield low
            if interval.low.value < line.turn < interval.high.value:
                turn = _Stop(number, line.angle, 0.0, line.wall(line.turn))
                yield turn._replace(inwards=-line.along)
                yield turn._replace(inwards=line.along)
            yield high


@np.errstate(all="ignore")  # NaN and infinity are answers
def find_pieces(c: Curve, angles: Angles, inside: Passes) -> Pieces:
    """Return the arcs that angles in (-pi, pi), in order, find, and how they join.

    Ends of arcs and of straight parts are joined that are each other's nearest.

    Source: the D-decomposition of Gryazina, Polyak, Tremba (2008), with the criterion of Schur and
    Cohn for the other roots.
    """
    ends = _arc_ends(c, angles, inside)
    count = len(ends.theta) // 2
    stops = list(_stops(c))
    middles = curve_gains(c, np.mean(ends.theta.reshape(2, -1), axis=0)).T
    stopped = np.array([stop.wall for stop in stops]).reshape(-1, 2)
    every = np.concatenate([ends.walls, middles, stopped])
    size = np.max(np.abs(every), axis=0, initial=0.0, where=np.isfinite(every))
    size = np.where(size > 0.0, size, 1.0)
    theta, walls = ends.theta.copy(), ends.walls.copy()
    angles = drawn_angles(c, *angles_of(stops).T)
    of_end, of_stop = _matches(c, ends, stops, angles, size)
    for end, number in of_end.items():
        angle = angles[number]
        theta[end] = theta[end] if np.isnan(angle) else np.copysign(angle, theta[end])
        walls[end] = stops[number].wall
    shared = [end for end, number in of_end.items() if np.isnan(angles[number])]
    if shared:
        theta[shared] = _angles_at(c, theta[shared], walls[shared], size)
    lone = np.array([end for end in range(2 * count) if end not in of_end], int)
    following, is_left = _corners(c, ends, lone, theta, walls, size)
    opened = [walls[end] for end in is_left]
    opened += [stop.wall for number, stop in enumerate(stops) if number not in of_stop]

    end_at = {number: end for end, number in of_end.items()}
    edges: list[list[Edge]] = []
    successor: list[int] = []
    left = set(of_stop)
    for arc in range(count):
        own: list[Edge] = []
        goal, stop = following.get(count + arc), of_end.get(count + arc)
        while stop is not None and len(own) <= len(stops):
            there = stop ^ 1
            left -= {stop, there}
            own.append(Edge(c.lines[stops[there].line].angle, stops[there].wall))
            goal = end_at.get(there)
            stop = of_stop.get(there) if goal is None else None
        edges.append(own)
        successor.append(-1 if goal is None else goal)
    if sorted(successor) != list(range(count)):
        opened += [walls[count + k] for k in range(count) if not 0 <= successor[k] < count]
        opened = opened or list(walls)
    (begin, close), (begin_wall, end_wall) = theta.reshape(2, -1), walls.reshape(2, -1, 2)
    straight: list[tuple[float, Array, Array]] = []
    for loop in _straight_loops(stops, of_stop, left):
        first, *own = [Edge(c.lines[stops[stop].line].angle, stops[stop ^ 1].wall) for stop in loop]
        straight.append((first.angle, stops[loop[0]].wall, first.wall))
        successor.append(len(edges))
        edges.append(own)
    if straight:
        places, starts, goals = map(np.array, zip(*straight, strict=True))
        begin, close = np.append(begin, places), np.append(close, places)
        begin_wall, end_wall = np.append(begin_wall, starts, 0), np.append(end_wall, goals, 0)
    return Pieces(
        begin=begin,
        end=close,
        begin_wall=begin_wall,
        end_wall=end_wall,
        edges=edges,
        successor=successor,
        open=np.array(opened).reshape(-1, 2),
        lone=np.abs(ends.theta[is_left]),
    )


def _straight_loops(
    stops: list[_Stop], of_stop: dict[int, int], left: set[int]
) -> Iterator[list[int]]:
    """Yield closed loops of the parts left: the stops where these begin, counter-clockwise."""
    while left:
        loop, stop = list[int](), max(left)  # not of the lines of z = 1 and -1, which come first
        while stop in left:
            left -= {stop, stop ^ 1}
            loop.append(stop)
            stop = of_stop.get(stop ^ 1, -1)
        if stop == loop[0]:
            alpha, beta = np.transpose([stops[stop].wall for stop in loop])
            swept = np.sum(alpha * np.roll(beta, -1) - np.roll(alpha, -1) * beta)
            yield loop if swept > 0.0 else [stop ^ 1 for stop in reversed(loop)]


def _angles_at(
    c: Curve,
    theta: Angles,
    walls: Float64[np.ndarray, "end 2"],
    size: Float64[np.ndarray, "2"],
) -> Angles:
    """Return where the curve comes closest to walls, next to these angles, by Newton's method."""
    steps = 3
    best, least = theta, np.full(theta.shape, np.inf)
    for _ in range(steps + 1):
        here, slopes = gains_and_slopes(c, theta)
        away, speed = (walls.T - here) / size[:, None], slopes / size[:, None]
        distance = np.sum(away**2, axis=0)
        best = np.where(distance < least, theta, best)
        least = np.fmin(distance, least)
        step = np.sum(away * speed, axis=0) / nonzero(np.sum(speed**2, axis=0), np.inf)
        theta = theta + np.clip(np.nan_to_num(step), -_ANGLES_AGREE, _ANGLES_AGREE)
    return best


def _matches(
    c: Curve, ends: _ArcEnds, stops: list[_Stop], angles: Angles, size: Float64[np.ndarray, "2"]
) -> tuple[dict[int, int], dict[int, int]]:
    """Return the stop of ends of arcs, and what is joined to each stop: an end, or another stop.

    Of the second, the values are stops where lines cross, and -1 for ends of arcs.
    """
    beside = 1e-4  # of an arc, where its tangents are taken
    pairs: list[tuple[float, int, int, bool]] = []
    for number, (stop, angle) in enumerate(zip(stops, angles, strict=True)):
        aside = np.max(np.abs(ends.walls - stop.wall) / size, axis=1)
        away = np.abs(np.abs(ends.theta) - angle)
        near = np.where(ends.is_pinned, away == 0.0, (away < _ANGLES_NEAR) & (aside < _WALLS_NEAR))
        if stop.inwards is not None:  # the curve is 0/0; stable walls are on the left of arcs
            begin, end = ends.theta.reshape(2, -1)
            step = beside * (end - begin)
            along = gains_and_slopes(c, np.concatenate([begin + step, end - step]))[1]
            is_left = along[0] * stop.inwards[1] - along[1] * stop.inwards[0] > 0.0
            near = (away < _ANGLES_AGREE) & is_left
        near |= np.isnan(angle) & (aside < _ANGLES_AGREE)
        cost = np.nan_to_num(away) + np.nan_to_num(aside, nan=0.0, posinf=0.0)
        pairs += [(float(cost[end]), number, end, True) for end in np.flatnonzero(near).tolist()]
    for (one, a), (other, b) in product(enumerate(stops), repeat=2):
        if one < other and a.line != b.line:
            apart = np.abs([b.angle - c.lines[a.line].angle, a.angle - c.lines[b.line].angle])
            gap = float(np.max(np.abs(a.wall - b.wall) / size))
            if np.all(np.isnan(apart) | (apart < _ANGLES_AGREE)) and gap < _WALLS_AGREE:
                pairs.append((gap, one, other, False))
    of_end: dict[int, int] = {}
    of_stop: dict[int, int] = {}
    for _, number, partner, is_end in sorted(pairs):
        if number in of_stop or partner in (of_end if is_end else of_stop):
            continue
        of_stop[number] = -1 if is_end else partner
        if is_end:
            of_end[partner] = number
        else:
            of_stop[partner] = number
    return of_end, of_stop


def _corners(
    c: Curve,
    ends: _ArcEnds,
    lone: np.ndarray,
    theta: Angles,
    walls: Float64[np.ndarray, "end 2"],
    size: Float64[np.ndarray, "2"],
) -> tuple[dict[int, int], list[int]]:
    """Solve for corners of arcs; return which begin follows which end, and the ends left alone.

    Angles and walls of corners are written. Where ends are not quite at their corner another arc
    may cut it off.
    """
    steps = 12  # of Newton's method
    rounding = 8.0 * UNIT  # of angles: where the curve flies they round to walls that are apart
    stray, certain = 16.0, 1e-8  # brackets, and radians, that ends may be from their corner
    count = len(theta) // 2
    begins, lasts = lone[lone < count], lone[lone >= count]
    if not (begins.size and lasts.size):
        return {}, lone.tolist()
    gaps = np.max(np.abs(walls[lasts, None] - walls[None, begins]) / size, axis=2)
    gaps = np.nan_to_num(gaps, nan=np.inf)
    nearest = np.argmin(gaps, axis=1)
    is_mutual = np.argmin(gaps, axis=0)[nearest] == np.arange(len(lasts))
    pair = np.stack([lasts, begins[nearest]])[:, is_mutual]
    start = here = theta[pair]
    for _ in range(steps):
        (alpha, beta), (alpha_slope, beta_slope) = gains_and_slopes(c, here)
        across, along = alpha[0] - alpha[1], beta[0] - beta[1]
        turn = nonzero(beta_slope[0] * alpha_slope[1] - alpha_slope[0] * beta_slope[1], np.inf)
        step = np.nan_to_num((alpha_slope[::-1] * along - beta_slope[::-1] * across) / turn)
        here = here - step
        if np.all(np.abs(step) <= UNIT * np.abs(here)):
            break
    both, slopes = gains_and_slopes(c, here)
    gap = np.max(np.abs(both[:, 0] - both[:, 1]) / size[:, None], axis=0)
    speed = np.max(np.abs(slopes) / size[:, None, None], axis=0)
    enough = _WALLS_AGREE + rounding * np.max(speed * np.abs(here), axis=0)
    moved = np.max(np.abs(here - start), axis=0) - stray * np.max(ends.width[pair], axis=0)
    is_solved = (gap < enough) & (moved <= _ANGLES_AGREE)
    slower = np.argmin(speed, axis=0)
    following = {}
    for k in np.flatnonzero(is_solved).tolist():
        if moved[k] > certain and not c.stretches:
            own, other = second_pairs(c, np.abs(start[:, k])), np.abs(start[::-1, k])
            if np.any(np.abs(own - other) > _ANGLES_NEAR):
                continue
        theta[pair[:, k]] = here[:, k]
        walls[pair[:, k]] = both[:, slower[k], k]
        following[int(pair[0, k])] = int(pair[1, k])
    joined = {*following, *following.values()}
    return following, [end for end in lone.tolist() if end not in joined]
