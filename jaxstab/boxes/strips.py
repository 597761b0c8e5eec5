"""Strips: where in a column roots may cross the unit circle.

A strip lies within an error of a surface alpha(beta, gamma, delta, delay): at each delay a plane
(``runs``). The boundary in a column is a few of them: the line of a root at 1, the runs of patches
of the curve (``enclosure``), and the line of a root at -1. Strips that touch somewhere in a column
become one flat strip (lemma B8 of docs/proofs.md).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.boxes.enclosure import Domain, Patches, curve_patches, minus_line_models
from jaxstab.boxes.filter_parts import Ends, filter_ends
from jaxstab.boxes.models import LinearModel
from jaxstab.boxes.plant import HandBoxes
from jaxstab.boxes.runs import SQUARE, Columns, distances, runs_of, surfaces
from jaxstab.model.filters import Filters

_PATCHES_PER_CELL = 2.0
_PATCHES_PER_MOVING_CELL = 3.0  # of which the delay is an interval
_PATCHES_PER_DOMAIN = 256.0  # along alpha
_MARGIN = 0.1  # of the domain along alpha: a strip that leaves it leaves it for good
_EPS = 16 * np.finfo(np.float64).eps


class Strips(NamedTuple):
    """Surfaces by centre value, slopes and error; NaN in columns that have fewer strips.

    A strip ``folds`` if for one beta and hand it may hold more than one root on the circle: it may
    then hide stable alphas, though all alphas on both sides are unstable.
    """

    centre: Float64[np.ndarray, "column strip"]
    slope: Float64[np.ndarray, "column strip variable"]
    error: Float64[np.ndarray, "column strip"]
    folds: Bool[np.ndarray, "column strip"]

    def some(self, which: np.ndarray) -> "Strips":
        """Return the strips of some of the columns."""
        return Strips(*(part[which] for part in self))

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
    """Return the strips of all columns: first the line of a root at 1, then others in any order.

    ``filters`` are the velocity estimator and the position filter, in units of one sample.
    """
    height = domain.alpha[1] - domain.alpha[0]
    cell = (beta[-1] - beta[0]) / (beta.size - 1)
    per_cell = _PATCHES_PER_MOVING_CELL if columns.half_delay else _PATCHES_PER_CELL
    width = (height / _PATCHES_PER_DOMAIN, cell / per_cell)
    wide = widened(domain)
    ends = Ends(1.0, (1.0, 2.0), 0.0) if filters is None else _checked_ends(filters)
    patches = curve_patches(hands, columns.delay, wide, width, filters, columns.half_delay)
    lines = _line_strips(columns, hands, wide, ends)
    return _joined(lines, _curve_strips(patches, columns, beta, height))


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
        Strips(*(part[:, some] for part in strips._replace(centre=centre)))
        for some in (slice(0, 1), slice(1, None))
    )
    return _joined(line, _merged(others, columns, high[..., :1]))


def holds_line(filters: Filters | None) -> bool:
    """Whether a root lies beyond 1 at all alphas below the line of a root at 1."""
    return filters is None or filter_ends(filters).position_at_one > 0.0


def _checked_ends(filters: Filters) -> Ends:
    ends = filter_ends(filters)
    if ends.position_at_one == 0.0:
        raise ValueError(
            f"position is {filters[1]}, whose gain at z = 1 is 0: it holds no hand at rest; give a "
            "filter that passes what does not move."
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
    lost_at_one = ends.lost * np.abs(per_gamma) * (gamma + columns.half[:, 1])
    value, weight = minus_line_models(hands, columns.delay, columns.half_delay)
    line, per_beta, error = _minus_line(value, weight, columns, domain, ends)
    centre, *slope = (
        np.where(np.isnan(error), np.nan, np.repeat(part, cells))
        for part in (line.centre, *line.slope)
    )
    if columns.half_delay:  # with the delay the line does not turn along beta
        slope.insert(SQUARE, np.zeros_like(beta))
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
    known = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    strips.centre[column, rank] = np.where(known, middle, 0.0) + 0.5 * (low + high)
    strips.slope[column, rank] = np.where(known[:, None], slope, 0.0)
    strips.error[column, rank] = np.where(known, 0.5 * (high - low), np.inf)
    may_turn = np.logical_or.reduceat(patches.may_turn[runs.patch], runs.start)
    strips.folds[column, rank] = ~known | may_turn
    return strips


def _no_strips(columns: Columns, count: int) -> Strips:
    number, variables = columns.centre.shape
    shape = (number, count)
    nothing = np.full(shape, np.nan)
    return Strips(
        nothing, np.full((*shape, variables), np.nan), nothing.copy(), np.zeros(shape, bool)
    )


def _joined(one: Strips, other: Strips) -> Strips:
    return Strips(*(np.concatenate(parts, axis=1) for parts in zip(one, other, strict=True)))


def _merged(strips: Strips, columns: Columns, line: np.ndarray | float = -np.inf) -> Strips:
    """Put strips in order from below, those that touch somewhere in a column as one flat strip.

    Two of them touch, too, where the upper one touches a line.
    """
    while True:
        order = np.argsort(strips.centre, axis=1)
        slope = np.take_along_axis(strips.slope, order[..., None], 1)
        centre, error, folds = (
            np.take_along_axis(part, order, 1)
            for part in (strips.centre, strips.error, strips.folds)
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
    known = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    strips.centre[where] = 0.5 * (low + high)
    strips.error[where] = np.where(known, 0.5 * (high - low), np.inf)
    strips.slope[where] = 0.0
    strips.folds[where] = True
