"""Strips: where in a column roots may cross the unit circle.

A strip lies within an error of a plane alpha(beta, gamma, delta). The boundary in a column is a few
of them: the line of a root at 1, the runs of patches of the curve (``enclosure``), and the line of
a root at -1. Strips that touch somewhere in a column become one flat strip (lemma B8 of
docs/proofs.md).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.boxes.enclosure import Domain, Patches, curve_patches, minus_line_models
from jaxstab.boxes.filter_parts import Ends, filter_ends
from jaxstab.boxes.models import LinearModel
from jaxstab.boxes.plant import HandBoxes
from jaxstab.model.filters import Filters

_PATCHES_PER_CELL = 2.0
_PATCHES_PER_DOMAIN = 256.0  # along alpha
_MARGIN = 0.1  # of the domain along alpha: a strip that leaves it leaves it for good
_EPS = 16 * np.finfo(np.float64).eps
_EDGE = 1e-9  # of a column: it reaches beyond its edges, so that rounding finds no gap


class Columns(NamedTuple):
    """Boxes of (beta, gamma, delta); corners are deviations from the centre, (8, column, 3)."""

    centre: Float64[np.ndarray, "column 3"]
    half: Float64[np.ndarray, "column 3"]

    @property
    def corners(self) -> Float64[np.ndarray, "8 column 3"]:
        """The corners of the columns."""
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(8, 1, 3)
        corners: np.ndarray = self.half * signs
        return corners


class Strips(NamedTuple):
    """Planes by centre value, slopes and error; NaN in columns that have fewer strips.

    A strip ``folds`` where for one beta and hand it may hold more than one root on the circle:
    there it may hide stable alphas, though on both sides all are unstable.
    """

    centre: Float64[np.ndarray, "column strip"]
    slope: Float64[np.ndarray, "column strip 3"]
    error: Float64[np.ndarray, "column strip"]
    folds: Bool[np.ndarray, "column strip"]

    def ends(self, columns: Columns) -> tuple[np.ndarray, np.ndarray]:
        """Return the low and high ends at the corners of the columns, (8, column, strip)."""
        planes = self.centre + np.einsum("kcv,cbv->kcb", columns.corners, self.slope)
        return planes - self.error, planes + self.error


def strips_of(
    beta: Float64[np.ndarray, " edge"],
    columns: Columns,
    hands: HandBoxes,
    delay: float,
    domain: Domain,
    filters: Filters | None = None,
) -> Strips:
    """Return the strips of all columns, in order from below and apart from each other.

    ``filters`` are the velocity estimator and the position filter, in units of one sample.
    """
    height = domain.alpha[1] - domain.alpha[0]
    cell = (beta[-1] - beta[0]) / (beta.size - 1)
    width = (height / _PATCHES_PER_DOMAIN, cell / _PATCHES_PER_CELL)
    wide = widened(domain)
    ends = Ends(1.0, (1.0, 2.0), 0.0) if filters is None else _checked_ends(filters)
    patches = curve_patches(hands, delay, wide, width, filters)
    lines = _line_strips(columns, hands, delay, wide, ends)
    return _merged(_joined(_curve_strips(patches, columns, beta, height), lines), columns)


def _checked_ends(filters: Filters) -> Ends:
    ends = filter_ends(filters)
    if ends.position_at_one == 0.0:
        raise ValueError(
            f"position is {filters[1]}, whose gain at z = 1 is 0: it holds no hand at rest; give a "
            "filter that passes what does not move."
        )
    return ends


def widened(domain: Domain) -> Domain:
    """Return the domain with a margin along alpha, in which strips are known."""
    low, high = domain.alpha
    margin = _MARGIN * (high - low)
    return Domain((low - margin, high + margin), domain.beta)


def columns_of(beta: Float64[np.ndarray, " edge"], hands: HandBoxes) -> Columns:
    """Return the columns of all boxes, those of one box side by side."""
    cells, boxes = beta.size - 1, hands.gamma.size
    middle, half = 0.5 * (beta[1:] + beta[:-1]), (0.5 + _EDGE) * np.diff(beta)
    along_beta = np.tile(middle, boxes), np.tile(half, boxes)
    of_hands = [np.repeat(part, cells) for part in hands]
    return Columns(
        np.stack([along_beta[0], *of_hands[:2]], axis=-1),
        np.stack([along_beta[1], *of_hands[2:]], axis=-1),
    )


def _line_strips(
    columns: Columns, hands: HandBoxes, delay: float, domain: Domain, ends: Ends
) -> Strips:
    """Return the lines of a real root at 1, alpha P(1) = -gamma, and at -1."""
    beta, gamma, _ = columns.centre.T
    cells = beta.size // hands.gamma.size
    per_gamma = -1.0 / ends.position_at_one
    at_one = np.broadcast_to([0.0, per_gamma, 0.0], columns.centre.shape)
    lost_at_one = ends.lost * np.abs(per_gamma) * (gamma + columns.half[:, 1])
    value, weight = minus_line_models(hands, delay)
    line, per_beta, error = _minus_line(value, weight, columns, domain, ends)
    centre, *slope = (
        np.where(np.isnan(error), np.nan, np.repeat(part, cells))
        for part in (line.centre, *line.slope)
    )
    at_minus_one = np.stack([np.full_like(beta, per_beta), *slope], axis=-1)
    return Strips(
        np.stack([per_gamma * gamma, centre + per_beta * beta], axis=-1),
        np.stack([at_one, at_minus_one], axis=1),
        np.stack([lost_at_one, error], axis=-1),
        np.stack([np.zeros_like(gamma, bool), error == np.inf], axis=-1),
    )


def _minus_line(
    value: LinearModel, weight: LinearModel, columns: Columns, domain: Domain, ends: Ends
) -> tuple[LinearModel, float, Float64[np.ndarray, " column"]]:
    """Return the line of a root at -1: alpha at beta = 0, per beta, and its error in each column.

    The error is NaN where no wall of the domain is on the line, and infinite where all may be.
    """
    beta, half = columns.centre[:, 0], columns.half[:, 0]
    cells = beta.size // value.centre.size
    per_alpha, per_damping = ends.at_minus_one
    farthest = np.max(np.abs(domain.alpha)), np.max(np.abs(domain.beta))
    if per_alpha == 0.0:  # where a wall is on the line depends on its damping alone
        gains = np.abs(per_damping) * np.array([np.abs(beta) + half, half])
        gains[0] *= 1.0 + ends.lost
        middle = np.repeat(value.centre, cells) - np.repeat(weight.centre, cells) * (
            per_damping * beta
        )
        reach = np.repeat(value.swing, cells) + np.repeat(weight.swing, cells) * gains[0]
        reach += np.repeat(np.abs(weight.centre), cells) * (gains[1] + ends.lost * gains[0])
        off = np.abs(middle) > reach * (1.0 + ends.lost) + _EPS * np.abs(middle)
        return value * 0.0, 0.0, np.where(off, np.nan, np.inf)
    lost = ends.lost * (np.abs(per_alpha) * farthest[0] + np.abs(per_damping) * farthest[1])
    reach = np.abs(per_alpha) * farthest[0] + np.abs(per_damping) * farthest[1] + lost
    off = (value.low > reach * weight.size) | (value.high < -reach * weight.size)
    line = value * weight.reciprocal()
    if per_alpha != 1.0:
        line = line * (1.0 / per_alpha)
    error = np.where(off, np.nan, line.rest + lost / np.abs(per_alpha))
    return line, -per_damping / per_alpha, np.repeat(error, cells)


class _Runs(NamedTuple):
    """Patches of the curve that follow each other through a column, run after run."""

    patch: Int64[np.ndarray, " entry"]
    column: Int64[np.ndarray, " entry"]
    number: Int64[np.ndarray, " entry"]  # of the run
    start: Int64[np.ndarray, " run"]  # its first entry


def _curve_strips(
    patches: Patches, columns: Columns, beta: Float64[np.ndarray, " edge"], height: float
) -> Strips:
    """Return one strip for each run of patches through a column."""
    runs = _runs(patches, beta)
    if not runs.patch.size:
        return _no_strips(columns, 0)
    stops = np.append(runs.start[1:], runs.patch.size)
    typical, column = runs.patch[(runs.start + stops) // 2], runs.column[runs.start]
    slope = _slopes(patches, typical, columns.half[column, 0], height)
    middle = patches.alpha.centre[typical] - slope[:, 0] * (
        patches.beta.centre[typical] - columns.centre[column, 0]
    )
    off, half_width = _distances(patches, columns, runs, middle, slope)
    low = np.minimum.reduceat(off - half_width, runs.start)
    high = np.maximum.reduceat(off + half_width, runs.start)

    rank = np.arange(column.size) - np.searchsorted(column, column)
    strips = _no_strips(columns, int(rank.max()) + 1)
    known = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    strips.centre[column, rank] = np.where(known, middle, 0.0) + 0.5 * (low + high)
    strips.slope[column, rank] = np.where(known[:, None], slope, 0.0)
    strips.error[column, rank] = np.where(known, 0.5 * (high - low), np.inf)
    may_turn = np.logical_or.reduceat(patches.may_turn[runs.patch], runs.start)
    strips.folds[column, rank] = ~known | may_turn
    return strips


def _runs(patches: Patches, beta: Float64[np.ndarray, " edge"]) -> _Runs:
    cells = beta.size - 1
    beyond = 2.0 * _EDGE * np.max(np.diff(beta))
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
    return _Runs(patch, column, np.cumsum(begins) - 1, np.flatnonzero(begins))


def _distances(
    patches: Patches,
    columns: Columns,
    runs: _Runs,
    middle: Float64[np.ndarray, " run"],
    slope: Float64[np.ndarray, "run 3"],
) -> tuple[Float64[np.ndarray, " entry"], Float64[np.ndarray, " entry"]]:
    """Return how far each patch is from its run's plane at its centre, and within how much."""
    alpha, gain, patch = patches.alpha, patches.beta, runs.patch
    per_beta = slope[runs.number, 0]
    off = alpha.centre[patch] - middle[runs.number]
    off -= per_beta * (gain.centre[patch] - columns.centre[runs.column, 0])
    tilt = alpha.slope[:, patch] - per_beta * gain.slope[:, patch]
    tilt[1:] -= slope[runs.number, 1:].T
    half_width = np.sum(np.abs(tilt) * alpha.half[:, patch], axis=0)
    with np.errstate(invalid="ignore"):  # a slope of 0 times no bound
        return off, half_width + alpha.rest[patch] + np.abs(per_beta) * gain.rest[patch]


def _slopes(
    patches: Patches, typical: Int64[np.ndarray, " run"], half: np.ndarray, height: float
) -> Float64[np.ndarray, "run 3"]:
    """Return how alpha changes with beta along the curve, and with gamma and delta beside it."""
    of_alpha, of_beta = patches.alpha.slope[:, typical], patches.beta.slope[:, typical]
    steep = np.abs(of_alpha[0]) * half > height * np.abs(of_beta[0])
    per_beta = np.where(steep, 0.0, of_alpha[0] / np.where(steep, 1.0, of_beta[0]))
    return np.stack([per_beta, *(of_alpha - per_beta * of_beta)[1:]], axis=-1)


def _no_strips(columns: Columns, count: int) -> Strips:
    shape = (columns.centre.shape[0], count)
    nothing = np.full(shape, np.nan)
    return Strips(nothing, np.full((*shape, 3), np.nan), nothing.copy(), np.zeros(shape, bool))


def _joined(one: Strips, other: Strips) -> Strips:
    return Strips(*(np.concatenate(parts, axis=1) for parts in zip(one, other, strict=True)))


def _merged(strips: Strips, columns: Columns) -> Strips:
    """Put strips in order from below, those that touch somewhere in a column as one flat strip."""
    while True:
        order = np.argsort(strips.centre, axis=1)
        slope = np.take_along_axis(strips.slope, order[..., None], 1)
        centre, error, folds = (
            np.take_along_axis(part, order, 1)
            for part in (strips.centre, strips.error, strips.folds)
        )
        strips = Strips(centre, slope, error, folds)
        low, high = strips.ends(columns)
        touching = np.any(low[..., 1:] <= high[..., :-1], axis=0)
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
    known = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    strips.centre[where] = 0.5 * (low + high)
    strips.error[where] = np.where(known, 0.5 * (high - low), np.inf)
    strips.slope[where] = 0.0
    strips.folds[where] = True
