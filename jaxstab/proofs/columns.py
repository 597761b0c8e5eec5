"""Limits of alpha over columns: boxes of beta, gamma, delta and delay with known stable alphas.

An atlas states for each column the alphas between which the loop is stable. In a column the walls
with a root on the unit circle lie in a few strips of alpha, each within an error of a plane over
the column's parameters: the line of a root at 1, the patches of the curve (``curve_patches``), and
the line of a root at -1. Between two strips, and below and above them all, no root crosses the
circle, so one certified verdict holds for the whole gap (lemma B8 of docs/proofs.md). It takes four
steps:

1. Patches that follow each other along the curve through a column form a run (``runs_of``).
2. A plane is laid along each run (``surfaces``). Any plane is correct: the error of the strip is
   the largest distance of the run's patches from it (``distances``).
3. Strips that touch anywhere in the column are merged into one flat strip (``apart``,
   ``above_line``), so that the others are in one order from below in the whole column.
4. One wall of each gap gets a certified verdict (``_gap_verdicts``). If one gap is stable, the
   strips beside it are the limits, planes with errors (``_limits``).

The shape of the stable set may be arbitrary. Where strips meet, or more than one gap is stable, the
alphas between them stay undecided. If the delay is an interval, planes get terms in its square and
its products with the other variables, for the curve turns with the delay (lemma B16).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64

from jaxstab.arrays import joined, take
from jaxstab.boxes.enclosures import LinearModel
from jaxstab.conventions import Verdict
from jaxstab.model import by_name
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.point import verdict
from jaxstab.proofs.curve_patches import Domain, Patches, curve_patches, minus_line_models
from jaxstab.proofs.filters import Ends, filter_ends
from jaxstab.proofs.plant import HandBoxes
from jaxstab.rounding import COSINES, OVERLAP, PLANES

# Runs of patches of the curve through columns, and the surfaces that follow them.
#
# A surface is a plane over beta, gamma and delta at each delay: its height has a term in the square
# of the delay, and its slopes change linearly with it.

T, SQUARE = 3, 4  # the variables of columns that are t and its square; its products follow
_T = 3  # the variable of patches that is the delay; the next is its square, then its products
_THETA, _HANDS = 0, slice(1, _T)
_BLOCK = 2**17  # patches in columns
_STEEPEST = 1e3  # of slopes along beta that are tried


@dataclass(frozen=True)
class Columns:
    """Boxes of beta and the variables of the plant, all with the same delays.

    The variables are x = beta, gamma, delta and, where the delays have a width, t, the square of t
    less half of what it can be, and t x, with t from the delay in the middle and x from its own.
    """

    centre: Float64[np.ndarray, "column variable"]
    half: Float64[np.ndarray, "column variable"]
    delay: float
    half_delay: float

    @cached_property
    def corners(self) -> Float64[np.ndarray, "corner column variable"]:
        """The corners of the columns, as deviations from their centres."""
        # A function that is affine in each variable, products included, is largest at one of them.
        count = min(self.half.shape[1], SQUARE + 1)
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * count), axis=-1).reshape(-1, 1, count)
        return with_products(self.half[:, :count] * signs)

    def take(self, which: np.ndarray) -> "Columns":
        """Return chosen columns."""
        return replace(self, centre=self.centre[which], half=self.half[which])


def with_products(
    deviations: Float64[np.ndarray, "*point variable"],
) -> Float64[np.ndarray, "*point variable_or_product"]:
    """Return deviations of x, t and its square with the products t x; of x alone as they are."""
    if deviations.shape[-1] <= T:
        return deviations
    products = deviations[..., T, None] * deviations[..., :T]
    return np.concatenate([deviations[..., : SQUARE + 1], products], axis=-1)


def columns_of(
    beta: Float64[np.ndarray, " edge"], hands: HandBoxes, delay: float, half_delay: float = 0.0
) -> Columns:
    """Return the columns of all boxes, those of one box side by side."""
    cells, boxes = beta.size - 1, hands.gamma.size
    middle, half = 0.5 * (beta[1:] + beta[:-1]), (0.5 + OVERLAP) * np.diff(beta)
    along_beta = np.tile(middle, boxes), np.tile(half, boxes)
    of_hands = [np.repeat(values, cells) for values in hands]
    centre = np.stack([along_beta[0], *of_hands[:2]], axis=-1)
    half_widths = np.stack([along_beta[1], *of_hands[2:]], axis=-1)
    if half_delay:
        widths = np.broadcast_to([half_delay, 0.5 * half_delay**2], (cells * boxes, 2))
        half_widths = np.concatenate([half_widths, widths, half_delay * half_widths], axis=-1)
        centre = np.concatenate([centre, np.zeros((cells * boxes, T + 2))], axis=-1)
    return Columns(centre, half_widths, delay, half_delay)


class Runs(NamedTuple):
    """Patches of the curve that follow each other through a column, run after run."""

    patch: Int64[np.ndarray, " entry"]
    column: Int64[np.ndarray, " entry"]
    run: Int64[np.ndarray, " entry"]  # its number
    start: Int64[np.ndarray, " run"]  # its first entry


def runs_of(patches: Patches, beta: Float64[np.ndarray, " edge"]) -> Runs:
    """Return the runs of patches through the columns of a cell of delays, of all boxes of hands."""
    cells = beta.size - 1
    beyond = 2.0 * OVERLAP * np.max(np.diff(beta))
    low, high = patches.beta.low - beyond, patches.beta.high + beyond
    start = np.searchsorted(beta[1:], np.where(np.isnan(low), -np.inf, low))
    end = np.searchsorted(beta[:-1], np.where(np.isnan(high), np.inf, high), "right") - 1
    counts = np.maximum(end - start + 1, 0)
    patch = np.repeat(np.arange(counts.size), counts)
    column = np.arange(patch.size) - np.repeat(np.cumsum(counts) - counts, counts)
    column += (patches.box * cells + start)[patch]
    order = np.lexsort((patch, column))
    patch, column = patch[order], column[order]
    follows = (patch[1:] == patch[:-1] + 1) & (column[1:] == column[:-1])
    follows &= patches.start[patch[1:]] == patches.end[patch[:-1]]
    begins = np.append(True, ~follows)[: patch.size]
    return Runs(patch, column, np.cumsum(begins) - 1, np.flatnonzero(begins))


def distances(
    patches: Patches,
    columns: Columns,
    runs: Runs,
    middle: Float64[np.ndarray, " run"],
    slope: Float64[np.ndarray, "run variable"],
) -> tuple[Float64[np.ndarray, " entry"], Float64[np.ndarray, " entry"]]:
    """The smallest and largest distance of each patch above its run's surface, in its column."""
    # Many patches are taken block by block, which bounds the memory.
    blocks = (slice(i, i + _BLOCK) for i in range(0, max(runs.patch.size, 1), _BLOCK))
    parts = [
        _distances_of(
            patches,
            columns,
            runs._replace(patch=runs.patch[block], column=runs.column[block], run=runs.run[block]),
            middle,
            slope,
        )
        for block in blocks
    ]
    low, high = (np.concatenate(ends) for ends in zip(*parts, strict=True))
    return low, high


def _distances_of(
    patches: Patches,
    columns: Columns,
    runs: Runs,
    middle: Float64[np.ndarray, " run"],
    slope: Float64[np.ndarray, "run variable"],
) -> tuple[Float64[np.ndarray, " entry"], Float64[np.ndarray, " entry"]]:
    """The distances of a block of patches."""
    # Another slope along beta may be taken for a patch, if the difference is added for all beta of
    # the column: the slopes that level a patch along theta, or the delay, are tried (lemma B16).
    alpha, gain, patch = patches.alpha, patches.beta, runs.patch
    own, of_beta = alpha.slope[:, patch], gain.slope[:, patch]
    goal, rest, moved = _surface_in_patches(patches, columns, runs, slope)
    away = gain.centre[patch] - columns.centre[runs.column, 0]
    above = alpha.centre[patch] - middle[runs.run] - moved
    rest += alpha.rest[patch]
    chosen = slope[runs.run, 0]
    low, high = np.full((2, patch.size), [[-np.inf], [np.inf]])
    for level in (None, _THETA, _T) if columns.half_delay else (None, _THETA):
        per_beta = chosen
        if level is not None:
            steep = np.abs(own[level] - goal[level]) >= _STEEPEST * np.abs(of_beta[level])
            quotient = (own[level] - goal[level]) / np.where(steep, 1.0, of_beta[level])
            per_beta = np.where(steep, chosen, quotient)
        tilt = own - goal - per_beta * of_beta
        off = above - per_beta * away
        half_width = np.abs(per_beta - chosen) * columns.half[runs.column, 0]
        if columns.half_delay:
            inside, middle_of_tilt = _tilted_inside(patches, columns, runs, tilt)
            off, half_width = off + middle_of_tilt, half_width + inside
        else:
            half_width += np.sum(np.abs(tilt) * alpha.half[:, patch], axis=0)
        with np.errstate(invalid="ignore"):  # a slope of 0 times no bound
            half_width += rest + np.abs(per_beta) * gain.rest[patch] + COSINES * np.abs(off)
            half_width *= 1.0 + COSINES
        low, high = np.fmax(low, off - half_width), np.fmin(high, off + half_width)
    return low, high


def _surface_in_patches(
    patches: Patches, columns: Columns, runs: Runs, slope: Float64[np.ndarray, "run variable"]
) -> tuple[
    Float64[np.ndarray, "variable entry"],
    Float64[np.ndarray, " entry"],
    Float64[np.ndarray, " entry"],
]:
    """Return a surface less its slope along beta in the variables of patches: slopes, rest, centre.

    The product of t and beta is that of t and the patch's model of beta.
    """
    gain, patch = patches.beta, runs.patch
    of_beta, half = gain.slope[:, patch], gain.half[:, patch]
    goal = np.zeros_like(of_beta)
    moved = np.zeros(patch.size)
    if not columns.half_delay:
        goal[_HANDS] = slope[runs.run, 1:].T
        return goal, moved.copy(), moved
    terms = slope[runs.run].T
    goal[_HANDS] = terms[1:T]
    goal[_T : _T + 2] = terms[T : SQUARE + 1]
    turn, most = terms[SQUARE + 1], columns.half_delay
    start, end = _T + 2, 2 * _T + 2
    goal[start + 1 : end] = terms[SQUARE + 2 :]
    goal[start:end] += turn * of_beta[:_T]
    goal[_T] += turn * (gain.centre[patch] - columns.centre[runs.column, 0])
    goal[_T + 1] += turn * of_beta[_T]
    moved += turn * of_beta[_T] * half[_T + 1]
    remainder = np.abs(of_beta[_T + 1]) * half[_T + 1] + gain.rest[patch]
    remainder += np.sum(np.abs(of_beta[start:end]) * half[start:end], axis=0)
    with np.errstate(invalid="ignore"):
        rest = np.where(turn == 0.0, 0.0, np.abs(turn) * most * remainder) * (1.0 + OVERLAP)
    return goal, rest + COSINES * np.abs(moved), moved


def _tilted_inside(
    patches: Patches, columns: Columns, runs: Runs, tilt: Float64[np.ndarray, "variable entry"]
) -> tuple[Float64[np.ndarray, " entry"], Float64[np.ndarray, " entry"]]:
    """Bound what a tilt adds to patches while they are in their columns: half-width and middle.

    With the delay a patch moves along beta, and where it is beyond the edges of the column it does
    not matter.
    """
    gain, patch = patches.beta, runs.patch
    half, slope = gain.half[:, patch], gain.slope[:, patch]
    others = np.arange(len(slope)) != _T
    swing = np.sum(np.abs(slope[others]) * half[others], axis=0)
    rate = slope[_T]
    room = (columns.half[runs.column, 0] + swing + gain.rest[patch]) * (1.0 + OVERLAP)
    away = gain.centre[patch] - columns.centre[runs.column, 0]
    most = half[_T]
    moves = np.abs(rate) * most > room
    ends = (np.stack([-room, room]) - away) / np.where(moves, rate, 1.0)
    ends = np.where(moves, np.clip(ends, -most, most), np.stack([-most, most]))
    # t = middle + u, |u| <= width, in tilt t + bend (t^2 - most^2 / 2)
    middle, width = 0.5 * (ends[0] + ends[1]), 0.5 * np.abs(ends[1] - ends[0]) + COSINES * most
    rate, bend = tilt[_T], tilt[_T + 1]
    bulge = 0.5 * bend * width**2
    others[_T + 1] = False
    half_width = np.sum(np.abs(tilt[others]) * half[others], axis=0)
    half_width += np.abs(rate + 2.0 * bend * middle) * width + np.abs(bulge)
    return half_width, rate * middle + bend * (middle**2 - half[_T + 1]) + bulge


def surfaces(
    patches: Patches, columns: Columns, runs: Runs, height: float
) -> tuple[Float64[np.ndarray, " run"], Float64[np.ndarray, "run variable"]]:
    """Surfaces along runs: alpha in the middle of the column, and its slopes."""
    # Any surface would be correct; these follow the patches in the middle of the column along beta,
    # and for early and late delays the patches that are there then.
    column, half_delay = runs.column[runs.start], columns.half_delay
    typical, away = _in_the_middle(patches, columns, runs, 0.0)
    of_alpha, of_beta = patches.alpha.slope[:, typical], patches.beta.slope[:, typical]
    steep = np.abs(of_alpha[0]) * columns.half[column, 0] > height * np.abs(of_beta[0])
    per_theta = np.where(steep, 1.0, of_beta[0])
    per_beta = np.where(steep, 0.0, of_alpha[0] / per_theta)
    tilt = of_alpha - per_beta * of_beta
    slope = np.stack([per_beta, *tilt[_HANDS]], axis=-1)
    middle = _at_delay(patches.alpha, typical, columns, 0.0) - per_beta * away
    if half_delay:
        by_theta, *by_hands = tilt[_T + 2 :]
        turn = np.where(steep, 0.0, by_theta / per_theta)
        turns = [turn, *(by_hands - turn * of_beta[_HANDS])]
        early, late = (
            _at_delay(patches.alpha, patch, columns, t) - (per_beta + turn * t) * off
            for t in (-half_delay, half_delay)
            for patch, off in [_in_the_middle(patches, columns, runs, t)]
        )
        rate = 0.5 * (late - early) / half_delay
        bend = (0.5 * (early + late) - middle) / half_delay**2
        slope = np.stack([*slope.T, rate, bend, *turns], axis=-1)
        middle += bend * columns.half[column, SQUARE]
    is_finite = np.isfinite(middle) & np.all(np.isfinite(slope), axis=1)
    return np.where(is_finite, middle, 0.0), np.where(is_finite[:, None], slope, 0.0)


def _in_the_middle(
    patches: Patches, columns: Columns, runs: Runs, t: float
) -> tuple[Int64[np.ndarray, " run"], Float64[np.ndarray, " run"]]:
    """The patch of each run nearest to the middle of its column at a delay, and its distance."""
    away = _at_delay(patches.beta, runs.patch, columns, t) - columns.centre[runs.column, 0]
    away = np.where(np.isnan(away), np.inf, away)
    nearest = np.minimum.reduceat(np.abs(away), runs.start)
    entry = np.flatnonzero(np.abs(away) == nearest[runs.run])[::-1]
    chosen = np.zeros(runs.start.size, np.intp)
    chosen[runs.run[entry]] = entry
    return runs.patch[chosen], away[chosen]


def _at_delay(
    gain: LinearModel, patch: Int64[np.ndarray, " entry"], columns: Columns, t: float
) -> Float64[np.ndarray, " entry"]:
    """A gain in the middle of patches, for a delay that is t from the middle of the interval."""
    value: np.ndarray = gain.centre[patch]
    if columns.half_delay:
        rate, bend = gain.slope[_T : _T + 2, patch]
        value = value + rate * t + bend * (t**2 - 0.5 * columns.half_delay**2)
    return value


# Strips: where in a column roots may cross the unit circle.
#
# A strip lies within an error of a surface alpha(beta, gamma, delta, delay): at each delay a plane
# (``runs``). The boundary in a column is a few of them: the line of a root at 1, the runs of
# patches of the curve (``enclosure``), and the line of a root at -1. Strips that touch somewhere in
# a column become one flat strip (lemma B8 of docs/proofs.md).

_PATCHES_PER_CELL = 2.0
_PATCHES_PER_MOVING_CELL = 3.0  # of which the delay is an interval
_PATCHES_PER_DOMAIN = 256.0  # along alpha
_MARGIN = 0.1  # of the domain along alpha, by which strips are followed beyond it


class Strips(NamedTuple):
    """Surfaces by centre value, slopes and error; NaN in columns that have fewer strips.

    A strip ``folds`` if for one beta and hand it may hold more than one root on the circle: it may
    then hide stable alphas, though all alphas on both sides are unstable.
    """

    centre: Float64[np.ndarray, "column strip"]
    slope: Float64[np.ndarray, "column strip variable"]
    error: Float64[np.ndarray, "column strip"]
    folds: Bool[np.ndarray, "column strip"]

    def straightened(self, columns: Columns) -> "Strips":
        """Return the strips with the square and products of the delay as parts of their errors."""
        if not columns.half_delay:
            return self
        slope = self.slope.copy()
        slope[..., SQUARE:] = 0.0
        bent = np.sum(np.abs(self.slope[..., SQUARE:]) * columns.half[:, None, SQUARE:], axis=-1)
        return self._replace(slope=slope, error=self.error + bent)

    def ends(self, columns: Columns) -> tuple[np.ndarray, np.ndarray]:
        """Return the low and high ends at the corners of the columns, (corner, column, strip)."""
        return self.ends_at(columns.corners)

    def ends_at(
        self, deviations: Float64[np.ndarray, "point column variable"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the low and high ends at points of each column, (point, column, strip)."""
        rises = self.slope @ np.moveaxis(deviations, 0, -1)
        planes = self.centre + np.moveaxis(rises, -1, 0)
        return planes - self.error, planes + self.error


def strips_of(
    beta: Float64[np.ndarray, " edge"],
    columns: Columns,
    hands: HandBoxes,
    domain: Domain,
    filters: Filters | None = None,
) -> Strips:
    """The strips of all columns: first the line of a root at 1, then others in any order."""
    height = domain.alpha[1] - domain.alpha[0]
    cell = (beta[-1] - beta[0]) / (beta.size - 1)
    per_cell = _PATCHES_PER_MOVING_CELL if columns.half_delay else _PATCHES_PER_CELL
    width = (height / _PATCHES_PER_DOMAIN, cell / per_cell)
    wide = widened(domain)
    ends = Ends(1.0, (1.0, 2.0), 0.0) if filters is None else _checked_ends(filters)
    patches = curve_patches(hands, columns.delay, wide, width, filters, columns.half_delay)
    lines = _line_strips(columns, hands, wide, ends)
    return joined([lines, _curve_strips(patches, columns, beta, height)], 1)


def apart(strips: Strips, columns: Columns) -> Strips:
    """Return the strips in order from below, merged until none of them touches another."""
    return _merged(strips, columns)


def above_line(strips: Strips, columns: Columns) -> Strips:
    """Return the line of a root at 1 and then, in order, the strips that are not all below it.

    The first of these may cross the line, which the others do not touch.
    """
    low, high = strips.ends(columns)
    is_below = np.all(high < low[..., :1], axis=0)
    centre = np.where(is_below, np.nan, strips.centre)
    line, others = (
        Strips(*(values[:, chosen] for values in strips._replace(centre=centre)))
        for chosen in (slice(0, 1), slice(1, None))
    )
    return joined([line, _merged(others, columns, high[..., :1])], 1)


def holds_line(filters: Filters | None) -> bool:
    """Whether a root lies beyond 1 at all alphas below the line of a root at 1."""
    return filters is None or filter_ends(filters).position_at_one > 0.0


def _checked_ends(filters: Filters) -> Ends:
    ends = filter_ends(filters)
    if ends.position_at_one == 0.0:
        raise ValueError(
            f"position is {filters[1]}, whose gain at z = 1 is 0: the wall does not push back at "
            "rest; give a filter that passes a constant position."
        )
    return ends


def widened(domain: Domain) -> Domain:
    """Return the domain, widened along alpha, in which strips are known."""
    low, high = domain.alpha
    margin = _MARGIN * (high - low)
    return Domain((low - margin, high + margin), domain.beta)


def _line_strips(columns: Columns, hands: HandBoxes, domain: Domain, ends: Ends) -> Strips:
    """Return the lines of a real root at 1, alpha P(1) = -gamma, and at -1."""
    beta, gamma, *_ = columns.centre.T
    cells = beta.size // hands.gamma.size
    per_gamma = -1.0 / ends.position_at_one
    at_one = np.zeros_like(columns.centre)
    at_one[:, 1] = per_gamma
    error_at_one = ends.error * np.abs(per_gamma) * (gamma + columns.half[:, 1])
    value, weight = minus_line_models(hands, columns.delay, columns.half_delay)
    line, per_beta, error = _minus_line(value, weight, columns, domain, ends)
    centre, *slope = (
        np.where(np.isnan(error), np.nan, np.repeat(values, cells))
        for values in (line.centre, *line.slope)
    )
    if columns.half_delay:  # with the delay the line does not turn along beta
        slope.insert(SQUARE, np.zeros_like(beta))
    at_minus_one = np.stack([np.full_like(beta, per_beta), *slope], axis=-1)
    return Strips(
        np.stack([per_gamma * gamma, centre + per_beta * beta], axis=-1),
        np.stack([at_one, at_minus_one], axis=1),
        np.stack([error_at_one, error], axis=-1),
        np.stack([np.zeros_like(gamma, bool), error == np.inf], axis=-1),
    )


def _minus_line(
    value: LinearModel, weight: LinearModel, columns: Columns, domain: Domain, ends: Ends
) -> tuple[LinearModel, float, Float64[np.ndarray, " column"]]:
    """The line of a root at -1: alpha at beta = 0, per beta, and its error in each column.

    The error is NaN where no wall of the domain is on the line, and infinite where all may be.
    """
    beta, half = columns.centre[:, 0], columns.half[:, 0]
    cells = beta.size // value.centre.size
    per_alpha, per_damping = ends.at_minus_one
    farthest = np.max(np.abs(domain.alpha)), np.max(np.abs(domain.beta))
    if per_alpha == 0.0:  # where a wall is on the line depends on its damping alone
        gains = np.abs(per_damping) * np.array([np.abs(beta) + half, half])
        gains[0] *= 1.0 + ends.error
        middle = np.repeat(value.centre, cells) - np.repeat(weight.centre, cells) * (
            per_damping * beta
        )
        swing = np.repeat(value.swing, cells) + np.repeat(weight.swing, cells) * gains[0]
        swing += np.repeat(np.abs(weight.centre), cells) * (gains[1] + ends.error * gains[0])
        off = np.abs(middle) > swing * (1.0 + ends.error) + COSINES * np.abs(middle)
        return value * 0.0, 0.0, np.where(off, np.nan, np.inf)
    rounding = ends.error * (np.abs(per_alpha) * farthest[0] + np.abs(per_damping) * farthest[1])
    largest = np.abs(per_alpha) * farthest[0] + np.abs(per_damping) * farthest[1] + rounding
    off = (value.low > largest * weight.size) | (value.high < -largest * weight.size)
    line = value * weight.reciprocal()
    if per_alpha != 1.0:
        line = line * (1.0 / per_alpha)
    error = np.where(off, np.nan, line.rest + rounding / np.abs(per_alpha))
    return line, -per_damping / per_alpha, np.repeat(error, cells)


def _curve_strips(
    patches: Patches, columns: Columns, beta: Float64[np.ndarray, " edge"], height: float
) -> Strips:
    """Return one strip for each run of patches through a column."""
    runs = runs_of(patches, beta)
    if not runs.patch.size:
        return _no_strips(columns, 0)
    column = runs.column[runs.start]
    middle, slope = surfaces(patches, columns, runs, height)
    low, high = distances(patches, columns, runs, middle, slope)
    low, high = np.minimum.reduceat(low, runs.start), np.maximum.reduceat(high, runs.start)

    rank = np.arange(column.size) - np.searchsorted(column, column)
    strips = _no_strips(columns, int(rank.max()) + 1)
    is_finite = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(is_finite, low, 0.0), np.where(is_finite, high, 0.0)
    strips.centre[column, rank] = np.where(is_finite, middle, 0.0) + 0.5 * (low + high)
    strips.slope[column, rank] = np.where(is_finite[:, None], slope, 0.0)
    strips.error[column, rank] = np.where(is_finite, 0.5 * (high - low), np.inf)
    may_turn = np.logical_or.reduceat(patches.may_turn[runs.patch], runs.start)
    strips.folds[column, rank] = ~is_finite | may_turn
    return strips


def _no_strips(columns: Columns, count: int) -> Strips:
    rows, variables = columns.centre.shape
    shape = (rows, count)
    nothing = np.full(shape, np.nan)
    return Strips(
        nothing, np.full((*shape, variables), np.nan), nothing.copy(), np.zeros(shape, bool)
    )


def _merged(strips: Strips, columns: Columns, line: np.ndarray | float = -np.inf) -> Strips:
    """Put strips in order from below, those that touch somewhere in a column as one flat strip.

    Two of them touch, too, where the upper one touches a line.
    """
    while True:
        order = np.argsort(strips.centre, axis=1)
        slope = np.take_along_axis(strips.slope, order[..., None], 1)
        centre, error, folds = (
            np.take_along_axis(values, order, 1)
            for values in (strips.centre, strips.error, strips.folds)
        )
        strips = Strips(centre, slope, error, folds)
        low, high = strips.ends(columns)
        touching = np.any(low[..., 1:] <= np.maximum(high[..., :-1], line), axis=0)
        if not touching.any():
            return strips
        low, high = low.min(axis=0), high.max(axis=0)
        for upper in range(1, touching.shape[1] + 1):
            column = np.flatnonzero(touching[:, upper - 1])
            low[column, upper] = np.minimum(low[column, upper - 1], low[column, upper])
            high[column, upper] = np.maximum(high[column, upper - 1], high[column, upper])
            _set_flat(strips, (column, upper), low[column, upper], high[column, upper])
            centre[column, upper - 1] = np.nan  # in the next round the last of its column
            folds[column, upper - 1] = False


def _set_flat(
    strips: Strips, where: tuple[np.ndarray, int | np.ndarray], low: np.ndarray, high: np.ndarray
) -> None:
    """Put a strip between two alphas in place of another."""
    is_finite = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(is_finite, low, 0.0), np.where(is_finite, high, 0.0)
    strips.centre[where] = 0.5 * (low + high)
    strips.error[where] = np.where(is_finite, 0.5 * (high - low), np.inf)
    strips.slope[where] = 0.0
    strips.folds[where] = True


TERMS = (
    "constant",
    "per_beta",
    "per_gamma",
    "per_delta",
    "per_delay",
    "per_delay_squared",
    "per_delay_beta",
    "per_delay_gamma",
    "per_delay_delta",
    "error",
)

"""A surface over (beta, gamma, delta, delay) and how far from it the true limit can be.

The last three slopes are those of the products of the delay and beta, gamma, delta.
"""

_INSIDE = 1.0 - 1e-6  # of the way to a corner of a column
_EVERYWHERE = Domain((-np.inf, np.inf), (-np.inf, np.inf))

Planes = Float64[np.ndarray, "*column 10"]


class StableColumns(NamedTuple):
    """The proved stable alphas of columns, shape (box, beta cell, term of ``TERMS``).

    Where alpha is below the lower plane by more than its error, or above the upper one, the loop is
    unstable, and between them, by more than the errors, it is stable. Lower planes are infinite in
    a column without a stable alpha, upper planes in one whose stable alphas do not end in the
    domain.
    """

    lower: Float64[np.ndarray, "box beta_cell 10"]
    upper: Float64[np.ndarray, "box beta_cell 10"]


class ColumnGaps(NamedTuple):
    """Open intervals of alpha in which no root crosses the unit circle anywhere in a column.

    Each gap, (box, beta cell, gap) from below, has one verdict for all beta, gamma and delta of its
    closed column. Entries without ``low < high`` are padding.
    """

    low: Float64[np.ndarray, "box beta_cell gap"]
    high: Float64[np.ndarray, "box beta_cell gap"]
    verdict: Int8[np.ndarray, "box beta_cell gap"]


def stable_columns(
    beta: Float64[np.ndarray, " edge"],
    hands: HandBoxes,
    delay: float,
    domain: Domain,
    filters: Filters | None = None,
    half_delay: float = 0.0,
) -> StableColumns:
    """The alphas of a domain that are proved stable in each column.

    ``beta`` are the edges of the cells, ascending, ``half_delay`` the largest distance of the delay
    from this one, with no whole sample between. Filters, per sample, have a gain P(1) other than 0
    (ValueError). With them a column may have several stable gaps, and the alphas between the first
    and the last of them stay undecided.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle, and the certified
    verdict; lemmas B8, B12 and B16 of docs/proofs.md.
    """
    columns = columns_of(beta, hands, delay, half_delay)
    strips = strips_of(beta, columns, hands, domain, filters)
    lower, upper = (np.empty((columns.centre.shape[0], len(TERMS))) for _ in range(2))
    pending = np.arange(columns.centre.shape[0])
    for ordered in (above_line, apart) if holds_line(filters) else (apart,):
        chosen, there = take(strips, pending), columns.take(pending)
        chosen = _straight_where_partial(ordered, chosen, there, domain)
        codes = _gap_verdicts(chosen, there, domain, filters)
        lower[pending], upper[pending] = _limits(chosen, codes, there, domain)
        pending = pending[upper[pending, -1] == np.inf]
        if not pending.size:
            break
    shape = (hands.gamma.size, beta.size - 1, len(TERMS))
    return StableColumns(lower.reshape(shape), upper.reshape(shape))


def column_gaps(
    beta: Float64[np.ndarray, " edge"],
    hands: HandBoxes,
    delay: float,
    domain: Domain,
    filters: Filters | None = None,
) -> ColumnGaps:
    """The proved verdicts of each column of a domain, gap by gap.

    Args, errors and source: as ``stable_columns``.
    """
    columns = columns_of(beta, hands, delay)
    strips = apart(strips_of(beta, columns, hands, domain, filters), columns)
    codes = _gap_verdicts(strips, columns, domain, filters)
    terms = np.sum(np.abs(strips.slope * columns.centre[:, None]), axis=-1)
    error = strips.error + PLANES * (np.abs(strips.centre) + 2.0 * terms)
    low, high = _gaps(*strips._replace(error=error).ends(columns), widened(domain))
    shape = (hands.gamma.size, beta.size - 1, codes.shape[1])
    return ColumnGaps(
        low.max(axis=0).reshape(shape), high.min(axis=0).reshape(shape), codes.reshape(shape)
    )


def _gap_verdicts(
    strips: Strips, columns: Columns, domain: Domain, filters: Filters | None
) -> Int8[np.ndarray, "column gap"]:
    """A verdict for each gap of a domain, from below; NOT_COMPUTED where there is none."""
    # A gap is connected: where it does not span its column, strips are straight, and it is convex.
    inside = columns.corners[..., : SQUARE + 1] * _INSIDE
    middle = np.zeros_like(inside[:1])
    if columns.half_delay:  # the square of the delay is not free
        middle[..., SQUARE] = -columns.half[:, SQUARE]
        inside[..., SQUARE] = (2.0 * _INSIDE**2 - 1.0) * columns.half[:, SQUARE]
    points = with_products(np.concatenate([middle, inside]))
    begins, ends = _gaps(*strips.ends_at(points), widened(domain))
    width = ends - begins
    widest = np.argmax(np.where(np.isnan(width), -np.inf, width), axis=0)
    chosen = np.where(width[0] > 0.0, 0, widest)
    exists = np.take_along_axis(width, chosen[None], 0)[0] > 0.0
    column, gap = np.nonzero(exists)
    chosen = chosen[exists]
    alpha = 0.5 * (begins + ends)[chosen, column, gap]
    deviation = points[chosen, column]
    beta, gamma, delta = (columns.centre[column] + deviation)[:, :3].T
    codes = np.full(exists.shape, Verdict.NOT_COMPUTED, np.int8)
    resolve = "exact" if filters is None else None
    verdicts = np.empty(alpha.size, np.int8)
    shares = np.sign(deviation[:, T]) if columns.half_delay else np.zeros_like(alpha)
    for share in np.unique(shares).tolist():
        here = shares == share
        delay = columns.delay + share * _INSIDE * columns.half_delay
        walls = alpha[here], beta[here], np.maximum(gamma[here], 0.0), np.maximum(delta[here], 0.0)
        verdicts[here] = verdict(**by_name(*walls, delay), resolve=resolve, **as_keywords(filters))
    codes[exists] = verdicts
    codes[(codes == Verdict.NOT_COMPUTED) & _meets(strips, columns, domain)] = Verdict.UNDECIDED
    low, high = strips.ends(columns)
    crosses = np.any(low[..., 1:] <= high[..., :1], axis=0)
    codes[:, 2:][crosses & (codes[:, 2:] == Verdict.STABLE)] = (
        Verdict.UNDECIDED
    )  # its lower limit has a corner
    return codes


def _meets(strips: Strips, columns: Columns, domain: Domain) -> Bool[np.ndarray, "column gap"]:
    """Say which gaps may meet a domain somewhere in their columns."""
    begins, ends = _gaps(*strips.ends(columns), _EVERYWHERE)
    meets: np.ndarray = np.any(begins < ends, axis=0)
    meets &= np.any(ends > domain.alpha[0], axis=0) & np.any(begins < domain.alpha[1], axis=0)
    return meets


def _straight_where_partial(
    ordered: Callable[[Strips, Columns], Strips], strips: Strips, columns: Columns, domain: Domain
) -> Strips:
    """Order strips, straightened in the columns that some gap does not span."""
    whole = ordered(strips, columns)
    if not columns.half_delay:
        return whole
    begins, ends = _gaps(*whole.ends(columns), widened(domain))
    exists = begins < ends
    partial = np.any(np.any(exists, axis=0) & ~np.all(exists, axis=0), axis=1)
    straight = strips.straightened(columns)
    bent = partial.reshape(-1, 1)
    return ordered(
        strips._replace(
            slope=np.where(bent[..., None], straight.slope, strips.slope),
            error=np.where(bent, straight.error, strips.error),
        ),
        columns,
    )


def _gaps(
    low: Float64[np.ndarray, "*column strip"],
    high: Float64[np.ndarray, "*column strip"],
    domain: Domain,
) -> tuple[Float64[np.ndarray, "*column gap"], Float64[np.ndarray, "*column gap"]]:
    """Return the ends of gaps; NaN where a column has fewer."""
    *shape, _ = low.shape
    lowest, highest = (np.full((*shape, 1), end) for end in domain.alpha)
    begins = np.concatenate([lowest, np.maximum(high, high[..., :1])], axis=-1)
    ends = np.concatenate([low, np.full_like(highest, np.nan)], axis=-1)
    ends = np.where(np.isnan(ends) & ~np.isnan(begins), highest, ends)
    return np.maximum(begins, lowest), np.minimum(ends, highest)


def _limits(
    strips: Strips, codes: Int8[np.ndarray, "column gap"], columns: Columns, requested: Domain
) -> tuple[Planes, Planes]:
    """The strips below and above the stable gap of each column.

    The strips of a column separate its gaps: gap k is between the strips k - 1 and k. There are
    three cases. (1) One gap is stable, and no strip but the two next to it may hide stable walls:
    these are the limits. (2) Several gaps are stable, or a strip elsewhere within the requested
    domain may hide stable walls: both limits are the flat span from the lowest to the highest of
    all these strips, its error half of its length, so that nothing in it is called stable or
    unstable. (3) A gap is undecided, a strip has no bound, or a span is open at one end: the limits
    are 0 with an infinite error, which states nothing. Where nothing is stable and nothing hides,
    they are infinite.
    """
    is_stable = codes == Verdict.STABLE
    lowest, count = np.argmax(is_stable, axis=1), is_stable.sum(axis=1)
    highest = is_stable.shape[1] - 1 - np.argmax(is_stable[:, ::-1], axis=1)
    low, high = strips.ends(columns)
    is_seen = np.any((high >= requested.alpha[0]) & (low <= requested.alpha[1]), axis=0)
    # Strips between unstable gaps that do not fold hide no stable alphas.
    between_unstable = (codes[:, :-1] == Verdict.UNSTABLE) & (codes[:, 1:] == Verdict.UNSTABLE)
    hiding = is_seen & (strips.folds | ~between_unstable)
    index = np.arange(strips.centre.shape[1])
    beside = (index == lowest[:, None]) | (index == lowest[:, None] - 1)
    hiding &= ~((count == 1)[:, None] & beside)
    hides = hiding.any(axis=1) | (count > 1)
    spanned = (index >= lowest[:, None] - 1) & (index <= highest[:, None]) & (count > 0)[:, None]
    merged = (spanned | hiding) & hides[:, None]
    low = np.min(low, axis=(0, 2), where=merged, initial=np.inf)
    high = np.max(high, axis=(0, 2), where=merged, initial=-np.inf)
    is_open = (count > 0) & ((lowest == 0) | np.isnan(_of_strip(strips.centre, highest)))
    is_unknown = np.any(codes == Verdict.UNDECIDED, axis=1) | np.any(strips.error == np.inf, axis=1)
    is_unknown |= hides & is_open
    low, high = (np.where(hides & ~is_unknown, end, 0.0) for end in (low, high))
    variables = columns.centre.shape[1]
    span = _flat(0.5 * (low + high), 0.5 * (high - low), variables)
    unknown = _flat(np.zeros_like(low), np.full_like(low, np.inf), variables)
    limits = []
    for strip, outermost in ((lowest - 1, -np.inf), (lowest, np.inf)):
        limit = _ends_at(strips, strip, outermost, count > 0)
        limit = limit.replaced(hides, span).replaced(is_unknown, unknown)
        limits.append(_planes(limit, columns))
    return limits[0], limits[1]


class _Limits(NamedTuple):
    """One limit of each column: a plane by its value at the centre, its slopes and its error."""

    centre: Float64[np.ndarray, " column"]
    slope: Float64[np.ndarray, "column variable"]
    error: Float64[np.ndarray, " column"]

    def replaced(self, where: Bool[np.ndarray, " column"], others: "_Limits") -> "_Limits":
        """Return other limits in some columns."""
        return _Limits(
            *(
                np.where(where.reshape(-1, *[1] * (mine.ndim - 1)), other, mine)
                for mine, other in zip(self, others, strict=True)
            )
        )


def _flat(
    centre: Float64[np.ndarray, " column"], error: Float64[np.ndarray, " column"], variables: int
) -> _Limits:
    return _Limits(centre, np.zeros((centre.size, variables)), error)


def _ends_at(
    strips: Strips,
    strip: Int64[np.ndarray, " column"],
    outermost: float,
    is_known: Bool[np.ndarray, " column"],
) -> _Limits:
    """Return one strip of each column, infinite where there is none or nothing is stable."""
    centre, slope, error = (_of_strip(values, strip) for values in strips[:3])
    open_end = np.isnan(centre) | ~is_known
    centre = np.where(open_end, np.where(is_known, outermost, np.inf), centre)
    slope, error = np.where(open_end[:, None], 0.0, slope), np.where(open_end, 0.0, error)
    return _Limits(centre, slope, error)


def _of_strip(values: np.ndarray, strip: Int64[np.ndarray, " column"]) -> np.ndarray:
    """Return the limits by one strip of each column; NaN where there is no such strip."""
    count = values.shape[1]
    chosen = values[np.arange(strip.size), np.clip(strip, 0, count - 1)]
    outside = (strip < 0) | (strip >= count)
    value: np.ndarray = np.where(outside.reshape(-1, *[1] * (chosen.ndim - 1)), np.nan, chosen)
    return value


def _planes(limits: _Limits, columns: Columns) -> Planes:
    """Return the terms of limits, in the parameters themselves."""
    centre, slope, error = limits
    constant = centre - np.sum(slope * columns.centre, axis=1)
    size = np.abs(centre) + 2.0 * np.sum(np.abs(slope * columns.centre), axis=1)
    of_delay = np.zeros((constant.size, len(TERMS) - 1 - T - 1))
    plane = slope[:, :T]
    if columns.half_delay:
        # t = d - d0 in rate t + bend (t^2 - half) + turns t (x - x0), with the other centres 0
        middle, x0 = columns.delay, columns.centre[:, :T]
        rate, bend, turns = slope[:, T], slope[:, SQUARE], slope[:, SQUARE + 1 :]
        level = np.sum(turns * x0, axis=1)
        constant += (level - rate) * middle + bend * (middle**2 - columns.half[:, SQUARE])
        plane = plane - turns * middle
        of_delay = np.column_stack([rate - 2.0 * middle * bend - level, bend, turns])
        latest = middle + columns.half_delay
        size += 4.0 * (np.abs(rate) + 2.0 * latest * np.abs(bend)) * latest
        size += 8.0 * latest * np.sum(np.abs(turns) * (np.abs(x0) + columns.half[:, :T]), axis=1)
    error = error + PLANES * np.where(np.isfinite(size), size, 0.0)
    return np.column_stack([constant, plane, of_delay, error])
