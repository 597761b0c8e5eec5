"""Runs of patches of the curve through columns, and the surfaces that follow them.

A surface is a plane over beta, gamma, delta and delay, plus a term in the square of the delay.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.boxes.enclosure import Patches
from jaxstab.boxes.models import LinearModel
from jaxstab.boxes.plant import HandBoxes

EDGE = 1e-9  # of a column: it reaches beyond its edges, so that rounding finds no gap
_T = 3  # the variable of patches that is the delay; the next one is its square
_EPS = 16 * np.finfo(np.float64).eps


class Columns(NamedTuple):
    """Boxes of beta and the variables of the plant, all with the same delays.

    The variables are beta, gamma, delta and, if the delays have a width, t and the square of t less
    half of its largest value, with t measured from the delay in the middle.
    """

    centre: Float64[np.ndarray, "column variable"]
    half: Float64[np.ndarray, "column variable"]
    delay: float
    half_delay: float

    @property
    def corners(self) -> Float64[np.ndarray, "corner column variable"]:
        """The corners of the columns, as deviations from their centres."""
        count = self.half.shape[1]
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * count), axis=-1).reshape(-1, 1, count)
        corners: np.ndarray = self.half * signs
        return corners

    def some(self, which: np.ndarray) -> "Columns":
        """Return some of the columns."""
        return self._replace(centre=self.centre[which], half=self.half[which])


def columns_of(
    beta: Float64[np.ndarray, " edge"], hands: HandBoxes, delay: float, half_delay: float = 0.0
) -> Columns:
    """Return the columns of all boxes, those of one box side by side."""
    cells, boxes = beta.size - 1, hands.gamma.size
    middle, half = 0.5 * (beta[1:] + beta[:-1]), (0.5 + EDGE) * np.diff(beta)
    along_beta = np.tile(middle, boxes), np.tile(half, boxes)
    of_hands = [np.repeat(part, cells) for part in hands]
    widths = (half_delay, 0.5 * half_delay**2) if half_delay else ()
    along_delay = [np.full(cells * boxes, width) for width in widths]
    return Columns(
        np.stack([along_beta[0], *of_hands[:2], *(0.0 * half for half in along_delay)], axis=-1),
        np.stack([along_beta[1], *of_hands[2:], *along_delay], axis=-1),
        delay,
        half_delay,
    )


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
    """Return the distance of each patch from its run's plane at its centre, with a bound."""
    alpha, gain, patch = patches.alpha, patches.beta, runs.patch
    per_beta = slope[runs.number, 0]
    off = alpha.centre[patch] - middle[runs.number]
    off -= per_beta * (gain.centre[patch] - columns.centre[runs.column, 0])
    tilt = alpha.slope[:, patch] - per_beta * gain.slope[:, patch]
    tilt[1 : slope.shape[1]] -= slope[runs.number, 1:].T
    if columns.half_delay:
        half_width, middle_of_tilt = _tilted_inside(patches, columns, runs, tilt)
        off += middle_of_tilt
    else:
        half_width = np.sum(np.abs(tilt) * alpha.half[:, patch], axis=0)
    with np.errstate(invalid="ignore"):  # a slope of 0 times no bound
        return off, half_width + alpha.rest[patch] + np.abs(per_beta) * gain.rest[patch]


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
    per_beta = np.where(steep, 0.0, of_alpha[0] / np.where(steep, 1.0, of_beta[0]))
    known = columns.centre.shape[1]
    slope = np.stack([per_beta, *(of_alpha - per_beta * of_beta)[1:known]], axis=-1)
    middle = _at_delay(patches.alpha, typical, columns, 0.0) - per_beta * away
    if half_delay:
        early, late = (
            _at_delay(patches.alpha, patch, columns, t) - per_beta * off
            for t in (-half_delay, half_delay)
            for patch, off in [_in_the_middle(patches, columns, runs, t)]
        )
        bend = (0.5 * (early + late) - middle) / half_delay**2
        slope[:, 3] = 0.5 * (late - early) / half_delay
        slope[:, 4] = bend
        middle += bend * columns.half[column, 4]
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
