"""Proof that a box of loops and angles has no root on the unit circle (lemma B3 of docs/proofs.md).

Over a power of z, and over the denominators of the filters, the polynomial of any loop is

    g = D + F (alpha P + beta V),

which vanishes where the loop has a root at e^(i theta). Models of D, F and the wall over a box of
parameters and theta are multiplied (lemma B13), so the values of g in the box lie in a sum of
segments, one for each axis, widened by a disc. If a straight line through 0 parts that set from 0,
the box is free of roots (``is_free``); otherwise the caller halves it, along the axis that moves g
most. A connected set of loops that free boxes cover, at all angles, is stable as soon as one of its
loops is (lemma B6): every claim about a range rests on this.

For one mass in closed form D and F are those of ``jaxstab.proofs.plant``; lemma B2 bounds how far
their second derivatives can bend them. Models of any other loop are in
``jaxstab.proofs.linear_circle``.

Along lines through the space of loops, ``search`` brackets the first root: boxes of (t, theta) that
are not free are shrunk to where both real parts of g can vanish. If the shrunk box lies inside of
the box, it is proved to hold a root (lemma B4).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64

from jaxstab.arrays import joined, take
from jaxstab.boxes.enclosures import LinearModel, variable
from jaxstab.model.filters import Filters
from jaxstab.proofs.filters import OverCells, filter_cells
from jaxstab.proofs.plant import (
    BENDS,
    NUMERATOR_SLOPES,
    QuickPlant,
    quick_errors,
    quick_plant,
)
from jaxstab.rounding import ELEMENTARY, EPS

Reals = Float64[np.ndarray, " boxes"]

Complexes = Complex128[np.ndarray, " boxes"]

_FLOOR = 256 * EPS  # of the terms of g, and of turns: about what the arithmetic of models adds


class Loops(NamedTuple):
    """Loops and an angle each: the five parameters in their order, then theta."""

    alpha: Reals
    beta: Reals
    gamma: Reals
    delta: Reals
    delay: Reals
    theta: Reals


class Exclusion(NamedTuple):
    """Whether a box is proved free of roots on the circle, and how far each parameter moves g."""

    free: Bool[np.ndarray, " boxes"]
    moves: Float64[np.ndarray, "6 boxes"]


class Models(NamedTuple):
    """g over boxes: the value in the middle, the moves to the ends of each axis, the rest."""

    value: np.ndarray
    moves: np.ndarray  # (axis, box)
    rest: np.ndarray
    bends: np.ndarray  # (axis, box): how much each axis moves g, and its rest
    rounding: np.ndarray


def expanded(
    free: LinearModel,
    force: LinearModel,
    rounding: Reals,
    turns: Reals | float = 0.0,
    known: Float64[np.ndarray, "axis box"] | float = 0.0,
) -> Models:
    """The sum g of D and F (alpha P + beta V), the second behind a number of turns of z.

    The moves of g by each axis, with its part of the rest, say which axis to halve: parts of the
    rest whose axis is ``known``, and of what is left as much as the axis moves g. ``rounding``
    bounds that of values: where the rest is little more, halving is in vain.
    """
    g = free + force
    moves = np.abs(free.slope) + np.abs(force.slope)
    share = moves / np.maximum(moves.sum(axis=0), 1e-300)
    parts = known + np.maximum(g.rest - np.sum(known, axis=0), 0.0) * share
    floor = rounding + _FLOOR * (np.abs(free.centre) + (1.0 + turns) * np.abs(force.centre))
    return Models(g.centre, g.slope, g.rest, np.abs(g.slope) + 2.0 * parts, floor)


def exclude(center: Loops, radius: Loops, filters: Filters | None = None) -> Exclusion:
    """Prove that no loop of a box center +- radius has a root on the circle at the box's angles.

    Boxes may extend to negative gamma, delta or delay; nothing is proved about those parts.
    """
    g = expanded(*terms(center, radius, filters=filters))
    return Exclusion(is_free(g.value, g.moves, g.rest), g.bends)


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


def terms(
    center: Loops,
    radius: Loops,
    plant: QuickPlant | None = None,
    filters: Filters | None = None,
) -> tuple[LinearModel, LinearModel, Reals, Reals, Float64[np.ndarray, "axis box"]]:
    """D and F (alpha P + beta V) of one mass over boxes center +- radius, and the rounding of g.

    The last two values are the number of turns, and how much of the rest N leaves that gamma and
    delta change: it has no slopes by them. The plant at the centre may be given; the filters are in
    units of one sample. See lemmas B3 and B10.
    """
    if plant is None:
        hand = (np.maximum(value, 0.0) for value in center[2:5])
        plant = quick_plant(*hand)
    turns = np.floor(center.delay) + 1.0
    total = np.abs(plant.n2) + np.abs(plant.n1) + np.abs(plant.n0)
    rounding = 64 * EPS + plant.d_error, 4 * EPS * (turns + 8) * total + plant.n_error
    back = np.exp(-1j * center.theta)  # 1/z
    free = _free(center, radius, plant, back, rounding[0])
    force = _force(center, radius, plant, back, rounding[1])
    axes, unit = len(Loops._fields), free.half
    if filters is None:
        slope = np.zeros((axes, turns.size), complex)
        slope[-1] = 1j * back * radius.theta
        rest = 0.5 * radius.theta**2 + 2.0 * ELEMENTARY * (1.0 + radius.theta)
        wall = variable(1, axes, center.beta, radius.beta) * LinearModel(
            1.0 - back, slope, rest, unit
        )
        wall = wall + variable(0, axes, center.alpha, radius.alpha)
        error = 2.0 * ELEMENTARY * np.abs(center.beta)
    else:
        over = OverCells.from_cells(filter_cells(filters), center.theta, radius.theta)
        position, velocity = over.values_along(axes)
        wall = variable(0, axes, center.alpha, radius.alpha) * position
        wall = wall + variable(1, axes, center.beta, radius.beta) * velocity
        error = np.abs(center.alpha) * over.error[0] + np.abs(center.beta) * over.error[1]
    of_force = rounding[1] * np.abs(wall.centre) + total * error
    by_hand = np.zeros((axes, turns.size))
    by_hand[2:4] = wall.size * np.stack(_changes(radius))
    return free, force * wall, rounding[0] + of_force, turns, by_hand


def _free(
    center: Loops, radius: Loops, plant: QuickPlant, back: Complexes, rounding: Reals
) -> LinearModel:
    """Return D/z over boxes (lemma B3)."""
    z, late = back.conj(), plant.d0 * back
    slope = np.zeros((len(Loops._fields), back.size), complex)
    slope[2] = plant.impulse * radius.gamma
    slope[3] = (plant.impulse_rate - late) * radius.delta
    slope[5] = 1j * (z - late) * radius.theta
    rest = BENDS["d1"].rest(radius.gamma, radius.delta)
    rest += BENDS["d0"].rest(radius.gamma, radius.delta)
    rest += radius.theta * (radius.theta + radius.delta)
    # The slopes are those of a quick plant.
    moved = radius.gamma + radius.delta + radius.theta
    rest += rounding + (quick_errors(center.gamma)[0] + 32 * EPS) * moved
    return LinearModel(z + plant.d1 + late, slope, rest, np.ones((len(slope), 1)))


def _force(
    center: Loops, radius: Loops, plant: QuickPlant, back: Complexes, rounding: Reals
) -> LinearModel:
    """Return z^-m N/z over boxes (lemma B3)."""
    turns = np.floor(center.delay) + 1.0
    most = np.floor(center.delay + radius.delay) + 2.0  # the largest m + 1
    z, lag = back.conj(), 1.0 - back
    behind = np.exp(-1j * turns * center.theta)  # z^-m
    ahead, after = behind * plant.n2 * z, behind * plant.n0 * back
    value = ahead + behind * plant.n1 + after
    slope = np.zeros((len(Loops._fields), back.size), complex)
    slope[4] = behind * lag * -(plant.late + plant.early * z) * radius.delay
    slope[5] = 1j * (ahead - after - turns * value) * radius.theta
    total = np.abs(plant.n2) + np.abs(plant.n1) + np.abs(plant.n0)
    far = np.minimum(np.abs(lag) + radius.theta, 2.0)  # the largest |1 - 1/z|
    rest = sum(_changes(radius)) + far * radius.delay**2
    rest += radius.theta * (
        0.5 * total * most**2 * radius.theta + (most * far + 1.0) * radius.delay
    )
    moved = radius.delay + most * radius.theta
    rest += rounding + (quick_errors(center.gamma)[1] + 4 * EPS * (turns + 8)) * moved
    return LinearModel(value, slope, rest, np.ones((len(slope), 1)))


def _changes(radius: Loops) -> tuple[Reals, Reals]:
    """Bound the changes of N by gamma and by delta in boxes."""
    per_gamma, per_delta, _ = NUMERATOR_SLOPES
    return per_gamma * radius.gamma, per_delta * radius.delta


def _along(direction: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return the part of complex numbers along a direction, times its length."""
    projection: np.ndarray = direction.real * value.real + direction.imag * value.imag
    return projection


# The first root on the unit circle along lines of loops, bracketed.
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
