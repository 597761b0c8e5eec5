"""Runs of patches of the curve through columns, and the surfaces that follow them.

A surface is a plane over beta, gamma and delta at each delay: its height has a term in the square
of the delay, and its slopes change linearly with it.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.boxes.enclosure import Patches
from jaxstab.boxes.models import LinearModel
from jaxstab.boxes.plant import HandBoxes

T, SQUARE = 3, 4  # the variables of columns that are t and its square; its products follow
EDGE = 1e-9  # of a column: it reaches beyond its edges, so that rounding finds no gap
_T = 3  # the variable of patches that is the delay; the next is its square, then its products
_THETA, _HANDS = 0, slice(1, _T)
_BLOCK = 2**17  # patches in columns
_STEEPEST = 1e3  # of slopes along beta that are tried
_EPS = 16 * np.finfo(np.float64).eps


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
        """The corners of the columns, as deviations from their centres.

        What is affine in each variable, products taken as products, is largest at one of them.
        """
        count = min(self.half.shape[1], SQUARE + 1)
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * count), axis=-1).reshape(-1, 1, count)
        return with_products(self.half[:, :count] * signs)

    def some(self, which: np.ndarray) -> "Columns":
        """Return some of the columns."""
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
    middle, half = 0.5 * (beta[1:] + beta[:-1]), (0.5 + EDGE) * np.diff(beta)
    along_beta = np.tile(middle, boxes), np.tile(half, boxes)
    of_hands = [np.repeat(part, cells) for part in hands]
    centre = np.stack([along_beta[0], *of_hands[:2]], axis=-1)
    reach = np.stack([along_beta[1], *of_hands[2:]], axis=-1)
    if half_delay:
        widths = np.broadcast_to([half_delay, 0.5 * half_delay**2], (cells * boxes, 2))
        reach = np.concatenate([reach, widths, half_delay * reach], axis=-1)
        centre = np.concatenate([centre, np.zeros((cells * boxes, T + 2))], axis=-1)
    return Columns(centre, reach, delay, half_delay)


class Runs(NamedTuple):
    """Patches of the curve that follow each other through a column, run after run."""

    patch: Int64[np.ndarray, " entry"]
    column: Int64[np.ndarray, " entry"]
    number: Int64[np.ndarray, " entry"]  # of the run
    start: Int64[np.ndarray, " run"]  # its first entry


def runs_of(patches: Patches, beta: Float64[np.ndarray, " edge"]) -> Runs:
    """Return the runs of patches through the columns of a cell of delays, of all boxes of hands."""
    cells = beta.size - 1
    beyond = 2.0 * EDGE * np.max(np.diff(beta))
    low, high = patches.beta.low - beyond, patches.beta.high + beyond
    first = np.searchsorted(beta[1:], np.where(np.isnan(low), -np.inf, low))
    last = np.searchsorted(beta[:-1], np.where(np.isnan(high), np.inf, high), "right") - 1
    counts = np.maximum(last - first + 1, 0)
    patch = np.repeat(np.arange(counts.size), counts)
    column = np.arange(patch.size) - np.repeat(np.cumsum(counts) - counts, counts)
    column += (patches.box * cells + first)[patch]
    order = np.lexsort((patch, column))
    patch, column = patch[order], column[order]
    follows = (patch[1:] == patch[:-1] + 1) & (column[1:] == column[:-1])
    follows &= patches.first[patch[1:]] == patches.last[patch[:-1]]
    begins = np.append(True, ~follows)[: patch.size]
    return Runs(patch, column, np.cumsum(begins) - 1, np.flatnonzero(begins))


def distances(
    patches: Patches,
    columns: Columns,
    runs: Runs,
    middle: Float64[np.ndarray, " run"],
    slope: Float64[np.ndarray, "run variable"],
) -> tuple[Float64[np.ndarray, " entry"], Float64[np.ndarray, " entry"]]:
    """Return the lowest and the highest that each patch is above its run's surface in its column.

    Many patches are looked at block by block, which bounds the memory.
    """
    blocks = (slice(i, i + _BLOCK) for i in range(0, max(runs.patch.size, 1), _BLOCK))
    parts = [
        _distances_of(
            patches,
            columns,
            runs._replace(
                patch=runs.patch[block], column=runs.column[block], number=runs.number[block]
            ),
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
    """Return the distances of a block of patches.

    Another slope along beta may be taken for a patch, if what it differs by is added for all beta
    of the column: those that level a patch along theta, or the delay, are tried (lemma B16).
    """
    alpha, gain, patch = patches.alpha, patches.beta, runs.patch
    own, of_beta = alpha.slope[:, patch], gain.slope[:, patch]
    goal, rest, moved = _surface_in_patches(patches, columns, runs, slope)
    away = gain.centre[patch] - columns.centre[runs.column, 0]
    above = alpha.centre[patch] - middle[runs.number] - moved
    rest += alpha.rest[patch]
    chosen = slope[runs.number, 0]
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
            half_width += rest + np.abs(per_beta) * gain.rest[patch] + _EPS * np.abs(off)
            half_width *= 1.0 + _EPS
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
        goal[_HANDS] = slope[runs.number, 1:].T
        return goal, moved.copy(), moved
    terms = slope[runs.number].T
    goal[_HANDS] = terms[1:T]
    goal[_T : _T + 2] = terms[T : SQUARE + 1]
    turn, most = terms[SQUARE + 1], columns.half_delay
    first, last = _T + 2, 2 * _T + 2
    goal[first + 1 : last] = terms[SQUARE + 2 :]
    goal[first:last] += turn * of_beta[:_T]
    goal[_T] += turn * (gain.centre[patch] - columns.centre[runs.column, 0])
    goal[_T + 1] += turn * of_beta[_T]
    moved += turn * of_beta[_T] * half[_T + 1]
    left = np.abs(of_beta[_T + 1]) * half[_T + 1] + gain.rest[patch]
    left += np.sum(np.abs(of_beta[first:last]) * half[first:last], axis=0)
    with np.errstate(invalid="ignore"):
        rest = np.where(turn == 0.0, 0.0, np.abs(turn) * most * left) * (1.0 + EDGE)
    return goal, rest + _EPS * np.abs(moved), moved


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
    reach = np.sum(np.abs(slope[others]) * half[others], axis=0)
    rate = slope[_T]
    room = (columns.half[runs.column, 0] + reach + gain.rest[patch]) * (1.0 + EDGE)
    away = gain.centre[patch] - columns.centre[runs.column, 0]
    most = half[_T]
    moves = np.abs(rate) * most > room
    ends = (np.stack([-room, room]) - away) / np.where(moves, rate, 1.0)
    ends = np.where(moves, np.clip(ends, -most, most), np.stack([-most, most]))
    # t = middle + u, |u| <= width, in tilt t + bend (t^2 - most^2 / 2)
    middle, width = 0.5 * (ends[0] + ends[1]), 0.5 * np.abs(ends[1] - ends[0]) + _EPS * most
    rate, bend = tilt[_T], tilt[_T + 1]
    bulge = 0.5 * bend * width**2
    others[_T + 1] = False
    half_width = np.sum(np.abs(tilt[others]) * half[others], axis=0)
    half_width += np.abs(rate + 2.0 * bend * middle) * width + np.abs(bulge)
    return half_width, rate * middle + bend * (middle**2 - half[_T + 1]) + bulge


def surfaces(
    patches: Patches, columns: Columns, runs: Runs, height: float
) -> tuple[Float64[np.ndarray, " run"], Float64[np.ndarray, "run variable"]]:
    """Return surfaces along runs: alpha in the middle of the column, and how it changes.

    Any surface would be correct; these follow the patches in the middle of the column along beta,
    and for early and late delays the patches that are there then.
    """
    column, half_delay = runs.column[runs.start], columns.half_delay
    typical, away = _in_the_middle(patches, columns, runs, 0.0)
    of_alpha, of_beta = patches.alpha.slope[:, typical], patches.beta.slope[:, typical]
    steep = np.abs(of_alpha[0]) * columns.half[column, 0] > height * np.abs(of_beta[0])
    per_theta = np.where(steep, 1.0, of_beta[0])
    per_beta = np.where(steep, 0.0, of_alpha[0] / per_theta)
    left = of_alpha - per_beta * of_beta
    slope = np.stack([per_beta, *left[_HANDS]], axis=-1)
    middle = _at_delay(patches.alpha, typical, columns, 0.0) - per_beta * away
    if half_delay:
        by_theta, *by_hands = left[_T + 2 :]
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
    known = np.isfinite(middle) & np.all(np.isfinite(slope), axis=1)
    return np.where(known, middle, 0.0), np.where(known[:, None], slope, 0.0)


def _in_the_middle(
    patches: Patches, columns: Columns, runs: Runs, t: float
) -> tuple[Int64[np.ndarray, " run"], Float64[np.ndarray, " run"]]:
    """Return for each run its patch next to the middle of the column at a delay, and how far."""
    away = _at_delay(patches.beta, runs.patch, columns, t) - columns.centre[runs.column, 0]
    away = np.where(np.isnan(away), np.inf, away)
    nearest = np.minimum.reduceat(np.abs(away), runs.start)
    entry = np.flatnonzero(np.abs(away) == nearest[runs.number])[::-1]
    chosen = np.zeros(runs.start.size, np.intp)
    chosen[runs.number[entry]] = entry
    return runs.patch[chosen], away[chosen]


def _at_delay(
    gain: LinearModel, patch: Int64[np.ndarray, " entry"], columns: Columns, t: float
) -> Float64[np.ndarray, " entry"]:
    """Return a gain in the middle of patches, at a delay that is so far from the middle."""
    value: np.ndarray = gain.centre[patch]
    if columns.half_delay:
        rate, bend = gain.slope[_T : _T + 2, patch]
        value = value + rate * t + bend * (t**2 - 0.5 * columns.half_delay**2)
    return value
