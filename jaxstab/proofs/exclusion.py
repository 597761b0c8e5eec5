"""Proof that a box of loops and angles has no root on the unit circle (lemma B3 of docs/proofs.md).

g of ``jaxstab.proofs.plant`` vanishes where the loop has a root at e^(i theta). It is expanded at
the centre of a box of alpha, beta, gamma, delta, delay and theta:

    |g - value - sum_k linear_k (x_k - centre_k)| <= rest,

where lemma B2 bounds how far the plant's second derivatives can bend g. So the values of g in the
box lie in a sum of segments, widened by a disc of radius ``rest``. If a straight line through 0
parts that set from 0, the box is free of roots (``is_free``); otherwise the caller halves it, along
the axis in which g is steepest. A connected set of loops that free boxes cover, at all angles, is
stable as soon as one of its loops is (lemma B6): every claim about a range rests on this.

Along lines through the space of loops, ``search`` brackets the first root: boxes of (t, theta) that
are not free are shrunk to where both real parts of g can vanish. If the shrunk box lies inside of
the box, it is proved to hold a root (lemma B4).

These products are written out here for one mass in closed form, for speed; models of any other loop
(``jaxstab.proofs.linear_circle``) go into the same search.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64

from jaxstab.arrays import joined, take
from jaxstab.model.filters import Filters
from jaxstab.proofs.filters import Gains, Wall, wall_over
from jaxstab.proofs.plant import (
    BENDS,
    NUMERATOR_SLOPES,
    QuickPlant,
    accurate_plant,
    quick_errors,
    quick_plant,
)
from jaxstab.rounding import EPS

Reals = Float64[np.ndarray, " boxes"]

Complexes = Complex128[np.ndarray, " boxes"]


class Loops(NamedTuple):
    """Loops and an angle each: the five parameters in their order, then theta."""

    alpha: Reals
    beta: Reals
    gamma: Reals
    delta: Reals
    delay: Reals
    theta: Reals


class Exclusion(NamedTuple):
    """Whether a box is proved free of roots on the circle, and how steep g is in each variable."""

    free: Bool[np.ndarray, " boxes"]
    slopes: Float64[np.ndarray, "6 boxes"]


class Expansion(NamedTuple):
    """g over boxes: |g - value - sum_k linear_k (x_k - centre_k)| <= rest.

    ``free`` is the part D/z of the value, ``free_theta`` its derivative by theta; ``rest_slopes``
    says how steep the rest is in each variable, ``rounding`` how much of it is rounding.
    """

    value: Complexes
    linear: Complex128[np.ndarray, "6 boxes"]
    rest: Reals
    free: Complexes
    free_theta: Complexes
    rest_slopes: Float64[np.ndarray, "6 boxes"]
    rounding: Reals


def exclude(center: Loops, radius: Loops, filters: Filters | None = None) -> Exclusion:
    """Prove that no loop of a box center +- radius has a root on the circle at the box's angles.

    Boxes may extend to negative gamma, delta or delay; nothing is proved about those parts.
    """
    g = expansion(center, radius, filters=filters)
    free = is_free(g.value, g.linear * np.stack(radius), g.rest)
    return Exclusion(free, np.abs(g.linear) + g.rest_slopes)


def exclude_any_delay(center: Loops, radius: Loops, filters: Filters | None = None) -> Exclusion:
    """Prove the same as ``exclude`` for these delays and all that are whole samples longer.

    A box is free when nowhere in it |D/z| = |(N/z) H|: then no phase z^-m brings the two to cancel.
    """
    g = expansion(center, radius, filters=filters)
    slope = np.abs(g.linear)
    slope[5] = np.abs(g.free_theta) + np.abs(g.linear[5] - g.free_theta)
    apart = np.abs(np.abs(g.free) - np.abs(g.value - g.free))
    clear = apart - np.sum(slope * np.stack(radius), axis=0) - g.rest
    return Exclusion(clear > 0, slope + g.rest_slopes)


def is_free(
    value: Complexes, moves: Complex128[np.ndarray, "variable boxes"], rest: Reals
) -> Bool[np.ndarray, " boxes"]:
    """In which boxes value + sum_k x_k moves_k, |x_k| <= 1, stays off a disc about 0."""
    # It does where a straight line separates the two. The lines tried are across the value and,
    # best for a sum of segments, along each of them.
    size = np.abs(value)
    clear = size * (size - rest) > np.sum(np.abs(_along(value, moves)), axis=0)
    unsure = np.flatnonzero(~clear)
    value, moves, rest = value[unsure], moves[:, unsure], rest[unsure]
    for segment in moves:
        normal = 1j * segment
        seen = np.abs(_along(normal, value)) - np.sum(np.abs(_along(normal, moves)), axis=0)
        clear[unsure] |= seen > rest * np.abs(segment)
    return clear


def expansion(
    center: Loops,
    radius: Loops,
    plant: QuickPlant | None = None,
    filters: Filters | None = None,
) -> Expansion:
    """Expand g over boxes center +- radius; see lemmas B3 and B10.

    The plant at the centre may be given; the filters are in units of one sample.
    """
    if plant is None:
        hand = (np.maximum(value, 0.0) for value in center[2:5])
        plant = quick_plant(*hand)
    turns = np.floor(center.delay) + 1.0
    back = np.exp(-1j * center.theta)  # 1/z
    z = back.conj()
    behind = np.exp(-1j * turns * center.theta)  # z^-m
    lag = 1.0 - back
    gains = Gains(*center[:2], *radius[:2], center.theta, radius.theta)
    wall = wall_over(gains, back, filters)
    ahead, after = behind * plant.n2 * z, behind * plant.n0 * back
    force = ahead + behind * plant.n1 + after  # z^-m N/z
    force_theta = 1j * (ahead - after - turns * force)
    free, free_theta = z + plant.d1 + plant.d0 * back, 1j * (z - plant.d0 * back)
    turned = 1j * center.beta * force * back if filters is None else force * wall.per_theta
    linear = np.stack(
        [
            force * wall.per_alpha,
            force * wall.per_beta,
            plant.impulse + 0j,
            plant.impulse_rate - plant.d0 * back,
            behind * lag * -(plant.late + plant.early * z) * wall.value,
            free_theta + force_theta * wall.value + turned,
        ]
    )
    rest, slopes, rounding = _rest(center, radius, plant, (turns, np.abs(lag), wall))
    value = free + force * wall.value
    return Expansion(value, linear, rest + rounding, free, free_theta, slopes, rounding)


def _rest(
    center: Loops, radius: Loops, plant: QuickPlant, parts: tuple[Reals, Reals, Wall]
) -> tuple[Reals, Float64[np.ndarray, "6 boxes"], Reals]:
    """Return the rest of the expansion, how steep it is in each variable, and the rounding."""
    turns, lag_here, wall = parts
    total = np.abs(plant.n2) + np.abs(plant.n1) + np.abs(plant.n0)
    steps = np.floor(center.delay + radius.delay) + 2.0  # the largest m + 1
    lag = np.minimum(lag_here + radius.theta, 2.0)  # the largest |1 - 1/z|
    per_gamma, per_delta, per_delay = NUMERATOR_SLOPES
    force_change = per_gamma * radius.gamma + per_delta * radius.delta
    hand = (
        wall.size * (force_change + lag * radius.delay**2)
        + radius.delay * lag * wall.change
        + BENDS["d1"].rest(radius.gamma, radius.delta)
        + BENDS["d0"].rest(radius.gamma, radius.delta)
    )
    if wall.bend is None:
        turns_of_wall = (2 * steps + 1) * wall.slope
    else:
        turns_of_wall = 2 * steps * wall.slope + wall.bend
    bend = 1.0 + 0.5 * total * (steps**2 * wall.size + turns_of_wall)
    turning = radius.theta * (
        bend * radius.theta
        + radius.delta
        + radius.delay * ((steps * lag + 1) * wall.size + lag * wall.slope)
        + total * (steps * wall.change + wall.turned_change)
    )
    most_force = total + force_change + per_delay * radius.delay
    rounding = 4 * EPS * (turns + 8) * (4.0 + most_force * wall.terms)
    rounding += plant.d_error + plant.n_error * wall.size + most_force * wall.error
    d_error, n_error = quick_errors(center.gamma)  # of the slopes, which are those of a quick plant
    rounding += d_error * (radius.gamma + radius.delta + radius.theta)
    rounding += n_error * wall.size * (radius.delay + steps * radius.theta)
    slopes = np.zeros((6, len(total)))
    slopes[2], slopes[3] = wall.size * per_gamma, wall.size * per_delta
    slopes[4] = wall.size * lag * radius.delay
    slopes[5] = bend * radius.theta
    return hand + turning, slopes, rounding


def _along(direction: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return the part of complex numbers along a direction, times its length."""
    projection: np.ndarray = direction.real * value.real + direction.imag * value.imag
    return projection


# The first root on the unit circle along straight lines through the space of loops, bracketed.
#
# The search keeps boxes of (t, theta), with t from 0 at the start of a line to 1 at its end. Boxes
# in which g has no zero are dropped (lemma B3 of docs/proofs.md); the others are shrunk to where
# both real parts of g can vanish (lemma B4), and halved if that shrinks them little. Shrinking
# squares the width, so a few rounds lead from a coarse grid to the last digits.

Ends = Float64[np.ndarray, "2 box"]

_MOST = 100_000  # boxes at once
_NARROW = 1e-12  # of the way from the start: a root bracketed like this is found
_FINEST = np.array([[2.0**-48], [2.0**-30]])  # of t and theta: boxes are not halved beyond
_PROGRESS = 0.6  # a box shrunk to less than this along t or theta is not halved


class Lines(NamedTuple):
    """Where lines start and how far they go: the five parameters, a line in each column."""

    start: Float64[np.ndarray, "5 line"]
    change: Float64[np.ndarray, "5 line"]


class LineBoxes(NamedTuple):
    """Boxes of (t, theta) along lines: the index of the line, and the ends of both."""

    line: Int64[np.ndarray, " box"]
    low: Ends
    high: Ends


class FirstRoots(NamedTuple):
    """For each line: no root is on the circle before ``low``, and one is proved before ``high``.

    Both are parts of the line. ``low`` is infinite where all boxes are free of roots, ``high``
    where no root is proved; ``theta`` is an angle next to ``low``.
    """

    low: Float64[np.ndarray, " line"]
    high: Float64[np.ndarray, " line"]
    theta: Float64[np.ndarray, " line"]


class Models(NamedTuple):
    """g over boxes: the value in the middle, the moves to the ends of each axis, the rest."""

    value: np.ndarray
    moves: np.ndarray  # (2, box)
    rest: np.ndarray
    bends: np.ndarray  # (2, box): how much each axis moves g, and its rest
    rounding: np.ndarray


def first_roots(lines: Lines, boxes: LineBoxes, filters: Filters | None = None) -> FirstRoots:
    """The first roots on the unit circle along lines, within boxes of (t, theta)."""
    with np.errstate(all="ignore"):
        plants = accurate_plant(*lines.start[2:])
    return search(lines.start.shape[1], boxes, lambda these: _models(lines, plants, these, filters))


def search(count: int, boxes: LineBoxes, models_of: Callable[[LineBoxes], Models]) -> FirstRoots:
    """Return the first roots on some lines, by models of g over boxes."""
    roots = FirstRoots(*(np.full(count, end) for end in (np.inf, np.inf, np.nan)))
    with np.errstate(all="ignore"):
        while boxes.line.size:
            models = models_of(boxes)
            is_open = ~is_free(*models[:3])
            boxes, models = take((boxes, models), (..., is_open))
            shrunk, is_proved = _shrunk(boxes, models)
            np.minimum.at(roots.high, shrunk.line[is_proved], shrunk.high[0, is_proved])
            is_open = np.all(shrunk.low <= shrunk.high, axis=0)
            is_open &= shrunk.low[0] <= roots.high[shrunk.line]
            size, before = shrunk.high - shrunk.low, boxes.high - boxes.low
            has_shrunk = np.any(size < _PROGRESS * before, axis=0)
            is_narrow = size[0] <= _NARROW * shrunk.high[0]
            is_rounded = models.rest <= 2.0 * models.rounding
            is_flat = np.sum(np.abs(models.moves), axis=0) <= 4.0 * models.rest
            is_done = is_proved & is_narrow | is_rounded & (is_proved | is_flat)
            is_done |= np.all(size <= _FINEST, axis=0)
            is_done |= np.sum(is_open) > _MOST
            _record(roots, take(shrunk, (..., is_open & is_done)))
            is_open &= ~is_done
            bends = np.where(size > _FINEST, models.bends * (size / before), -1.0)
            wide = is_open & ~has_shrunk
            halves = _halved(take(shrunk, (..., wide)), bends[:, wide])
            boxes = joined([take(shrunk, (..., is_open & has_shrunk)), halves], -1)
    return roots


def _models(lines: Lines, plants: QuickPlant, boxes: LineBoxes, filters: Filters | None) -> Models:
    t, theta = 0.5 * (boxes.low + boxes.high)
    half = 0.5 * (boxes.high - boxes.low) * (1.0 + 4.0 * EPS)
    change = lines.change[:, boxes.line]
    middle = lines.start[:, boxes.line] + change * t
    center = Loops(*np.concatenate([middle, theta[None]]))
    moved = np.abs(change) * half[0]
    plant = take(plants, boxes.line)
    is_other = np.any(change[2:] != 0.0, axis=0)
    if np.any(is_other):
        others = quick_plant(*(np.maximum(value[is_other], 0.0) for value in center[2:5]))
        for coefficient, other in zip(plant, others, strict=True):
            coefficient[is_other] = other
    g = expansion(center, Loops(*np.concatenate([moved, half[1:]])), plant, filters)
    moves = np.stack([np.sum(g.linear[:5] * change, axis=0), g.linear[5]]) * half
    bends = np.stack([np.sum(g.rest_slopes[:5] * moved, axis=0), g.rest_slopes[5] * half[1]])
    return Models(g.value, moves, g.rest, bends + np.abs(moves), g.rounding)


def _shrunk(boxes: LineBoxes, models: Models) -> tuple[LineBoxes, Bool[np.ndarray, " box"]]:
    """Shrink boxes to where g can vanish, and say which of them are proved to hold a zero."""
    value, (by_t, by_theta), rest, *_ = models
    determinant = _cross(by_t, by_theta)
    is_regular = determinant != 0.0
    determinant = np.where(is_regular, determinant, 1.0)
    middle = np.stack([_cross(by_theta, value), -_cross(by_t, value)]) / determinant
    spread = np.stack([np.abs(by_theta), np.abs(by_t)]) * (rest / np.abs(determinant))
    spread = np.where(is_regular, spread, np.inf) * (1.0 + 64.0 * EPS)
    spread += 64.0 * EPS * np.abs(middle)
    # In units of the half-widths
    low, high = middle - spread, middle + spread
    is_proved = np.all((low > -1.0) & (high < 1.0), axis=0)
    center, half = 0.5 * (boxes.low + boxes.high), 0.5 * (boxes.high - boxes.low)
    slack = 2.0 * EPS * np.abs(center)
    low = np.maximum(np.where(low > -1.0, center + half * low - slack, boxes.low), boxes.low)
    high = np.minimum(np.where(high < 1.0, center + half * high + slack, boxes.high), boxes.high)
    return LineBoxes(boxes.line, low, high), is_proved


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the imaginary part of conj(a) b."""
    cross: np.ndarray = a.real * b.imag - a.imag * b.real
    return cross


def _record(roots: FirstRoots, done: LineBoxes) -> None:
    """Record, of each line, the box that starts first among those that are done."""
    order = np.argsort(-done.low[0], kind="stable")  # the first box is written last
    line, low = done.line[order], done.low[0, order]
    theta = 0.5 * (done.low[1] + done.high[1])[order]
    is_first = low < roots.low[line]
    roots.low[line[is_first]] = low[is_first]
    roots.theta[line[is_first]] = theta[is_first]


def _halved(boxes: LineBoxes, bends: np.ndarray) -> LineBoxes:
    """Halve boxes along the axis that moves g most."""
    axis, box = np.argmax(bends, axis=0), np.arange(boxes.line.size)
    middle = 0.5 * (boxes.low[axis, box] + boxes.high[axis, box])
    low, high = boxes.low.copy(), boxes.high.copy()
    low[axis, box] = high[axis, box] = middle
    return joined([boxes._replace(high=high), boxes._replace(low=low)], -1)
