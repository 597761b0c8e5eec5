"""Limits of alpha over columns: boxes of (beta, gamma, delta) in which the stable alphas are known.

In a column the boundary is a few bands, each within an error of a plane over (beta, gamma, delta):
the line of a root at 1, the parts of the curve (``enclosure``), and the line of a root at -1.
Between two bands, and below and above them all, no root crosses the unit circle, so that one
certified verdict speaks for the whole gap. This needs nothing to be known about the shape of the
stable set; where bands meet, or more than one gap is stable, what lies between stays undecided.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64

from jaxstab.boxes.enclosure import Domain, Patches, curve_patches, minus_line_models
from jaxstab.boxes.plant import HandBoxes
from jaxstab.conventions import NOT_COMPUTED, STABLE, UNDECIDED, UNSTABLE
from jaxstab.model import require_x64
from jaxstab.point import verdict

TERMS = ("constant", "per_beta", "per_gamma", "per_delta", "error")
"""A plane over (beta, gamma, delta) and how far from it the true limit can be."""

_PATCHES_PER_CELL = 2.0
_PATCHES_PER_DOMAIN = 256.0  # along alpha
_MARGIN = 0.1  # of the domain along alpha: a band that leaves it leaves it for good
_MANY_POINTS = 2**12
_EDGE = 1e-9  # of a column: it reaches beyond its edges, so that rounding finds no gap
_ROUNDING = 1e-14  # of the domain: sums of the terms of a plane

Planes = Float64[np.ndarray, "*column 5"]


class StableColumns(NamedTuple):
    """What is proved of alpha in columns, shape (box, beta cell, term of ``TERMS``).

    Where alpha is below the lower plane by more than its error, or above the upper one, the loop is
    unstable, and between them, by more than the errors, it is stable. Lower planes are infinite in
    a column that has no stable alpha, upper planes in one that has no end of them in the domain.
    """

    lower: Float64[np.ndarray, "box beta_cell 5"]
    upper: Float64[np.ndarray, "box beta_cell 5"]


class ColumnGaps(NamedTuple):
    """Open intervals of alpha in which no root crosses the unit circle anywhere in a column.

    Each has one verdict for all beta, gamma and delta of its closed column. A column has fewer gaps
    than there is room for where ``low < high`` does not hold.

    Attributes:
        low: lower ends, shape (box, beta cell, gap), from below.
        high: upper ends, of the same shape.
        verdict: codes of ``jaxstab.Verdict``, of the same shape.
    """

    low: Float64[np.ndarray, "box beta_cell gap"]
    high: Float64[np.ndarray, "box beta_cell gap"]
    verdict: Int8[np.ndarray, "box beta_cell gap"]


class _Columns(NamedTuple):
    """Boxes of (beta, gamma, delta); corners are deviations from the centre, (8, column, 3)."""

    centre: Float64[np.ndarray, "column 3"]
    half: Float64[np.ndarray, "column 3"]

    @property
    def corners(self) -> Float64[np.ndarray, "8 column 3"]:
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(8, 1, 3)
        corners: np.ndarray = self.half * signs
        return corners


class _Bands(NamedTuple):
    """Planes by centre value, slopes and error; NaN in columns that have fewer bands.

    A band ``folds`` where for one beta and hand it may hold more than one root on the circle: there
    it may hide stable alphas, though on both sides all are unstable.
    """

    centre: Float64[np.ndarray, "column band"]
    slope: Float64[np.ndarray, "column band 3"]
    error: Float64[np.ndarray, "column band"]
    folds: Bool[np.ndarray, "column band"]

    def ends(self, columns: _Columns) -> tuple[np.ndarray, np.ndarray]:
        """Return the low and high ends at the corners of the columns, (8, column, band)."""
        planes = self.centre + np.einsum("kcv,cbv->kcb", columns.corners, self.slope)
        return planes - self.error, planes + self.error


def stable_columns(
    beta: Float64[np.ndarray, " edge"], hands: HandBoxes, delay: float, domain: Domain
) -> StableColumns:
    """Return which alphas of a domain are proved stable in each column.

    Args:
        beta: edges of the cells along beta, ascending.
        hands: boxes of gamma in [0, 1e4] and delta in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples.
        domain: of alpha and beta.

    Raises:
        ValueError: gamma, delta or delay is outside the range of the model.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle, and the certified
    verdict; the bounds are derived in the heading of ``jaxstab.boxes.plant``.
    """
    require_x64()
    columns = _columns(beta, hands)
    bands = _bands(beta, columns, hands, delay, domain)
    codes = _gap_verdicts(bands, columns, delay, domain)
    lower, upper = _limits(bands, codes, columns, domain)
    shape = (hands.gamma.size, beta.size - 1, len(TERMS))
    return StableColumns(lower.reshape(shape), upper.reshape(shape))


def column_gaps(
    beta: Float64[np.ndarray, " edge"], hands: HandBoxes, delay: float, domain: Domain
) -> ColumnGaps:
    """Return what is proved of each column of a domain, gap by gap.

    Args, errors and source: as ``stable_columns``.
    """
    require_x64()
    columns = _columns(beta, hands)
    bands = _bands(beta, columns, hands, delay, domain)
    codes = _gap_verdicts(bands, columns, delay, domain)
    terms = np.sum(np.abs(bands.slope * columns.centre[:, None]), axis=-1)
    error = bands.error + _ROUNDING * (np.abs(bands.centre) + 2.0 * terms)
    low, high = _gaps(*bands._replace(error=error).ends(columns), _widened(domain))
    shape = (hands.gamma.size, beta.size - 1, codes.shape[1])
    return ColumnGaps(
        low.max(axis=0).reshape(shape), high.min(axis=0).reshape(shape), codes.reshape(shape)
    )


def _bands(
    beta: Float64[np.ndarray, " edge"],
    columns: _Columns,
    hands: HandBoxes,
    delay: float,
    domain: Domain,
) -> _Bands:
    """Return the bands of all columns, in order from below and apart from each other."""
    height = domain.alpha[1] - domain.alpha[0]
    cell = (beta[-1] - beta[0]) / (beta.size - 1)
    width = (height / _PATCHES_PER_DOMAIN, cell / _PATCHES_PER_CELL)
    wide = _widened(domain)
    patches = curve_patches(hands, delay, wide, width)
    lines = _line_bands(columns, hands, delay, wide, beta.size - 1)
    return _merged(_joined(_curve_bands(patches, columns, beta, height), lines), columns)


def _widened(domain: Domain) -> Domain:
    low, high = domain.alpha
    margin = _MARGIN * (high - low)
    return Domain((low - margin, high + margin), domain.beta)


def _columns(beta: Float64[np.ndarray, " edge"], hands: HandBoxes) -> _Columns:
    cells, boxes = beta.size - 1, hands.gamma.size
    middle, half = 0.5 * (beta[1:] + beta[:-1]), (0.5 + _EDGE) * np.diff(beta)
    along_beta = np.tile(middle, boxes), np.tile(half, boxes)
    of_hands = [np.repeat(part, cells) for part in hands]
    return _Columns(
        np.stack([along_beta[0], *of_hands[:2]], axis=-1),
        np.stack([along_beta[1], *of_hands[2:]], axis=-1),
    )


def _line_bands(
    columns: _Columns, hands: HandBoxes, delay: float, domain: Domain, cells: int
) -> _Bands:
    """Return the lines of a real root at 1, alpha = -gamma, and at -1."""
    beta, gamma, _ = columns.centre.T
    at_one = np.broadcast_to([0.0, -1.0, 0.0], columns.centre.shape)
    value, weight = minus_line_models(hands, delay)
    farthest = np.max(np.abs(domain.alpha)) + 2.0 * np.max(np.abs(domain.beta))
    off = (value.low > farthest * weight.size) | (value.high < -farthest * weight.size)
    sum_of_gains = value * weight.reciprocal()
    centre, *slope = (
        np.repeat(np.where(off, np.nan, part), cells)
        for part in (sum_of_gains.centre, *sum_of_gains.slope)
    )
    error = np.repeat(np.where(off, np.nan, sum_of_gains.rest), cells)
    at_minus_one = np.stack([np.full_like(beta, -2.0), *slope], axis=-1)
    return _Bands(
        np.stack([-gamma, centre - 2.0 * beta], axis=-1),
        np.stack([at_one, at_minus_one], axis=1),
        np.stack([np.zeros_like(gamma), error], axis=-1),
        np.stack([np.zeros_like(gamma, bool), error == np.inf], axis=-1),
    )


def _curve_bands(
    patches: Patches, columns: _Columns, beta: Float64[np.ndarray, " edge"], height: float
) -> _Bands:
    """Return one band for each run of patches through a column."""
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
    if not patch.size:
        return _no_bands(columns, 0)

    follows = (patch[1:] == patch[:-1] + 1) & (column[1:] == column[:-1])
    follows &= patches.first[patch[1:]] == patches.last[patch[:-1]]
    starts = np.flatnonzero(np.append(True, ~follows))
    run = np.cumsum(np.append(True, ~follows)) - 1
    stops = np.append(starts[1:], patch.size)
    typical, of_run = patch[(starts + stops) // 2], column[starts]
    slope = _slopes(patches, typical, columns.half[of_run, 0], height)
    middle = patches.alpha.centre[typical] - slope[:, 0] * (
        patches.beta.centre[typical] - columns.centre[of_run, 0]
    )

    alpha, gain = patches.alpha, patches.beta
    per_beta = slope[run, 0]
    off = alpha.centre[patch] - middle[run]
    off -= per_beta * (gain.centre[patch] - columns.centre[column, 0])
    tilt = alpha.slope[:, patch] - per_beta * gain.slope[:, patch]
    tilt[1:] -= slope[run, 1:].T
    reach = np.sum(np.abs(tilt) * alpha.half[:, patch], axis=0)
    reach += alpha.rest[patch] + np.abs(per_beta) * gain.rest[patch]
    low = np.minimum.reduceat(off - reach, starts)
    high = np.maximum.reduceat(off + reach, starts)

    rank = np.arange(of_run.size) - np.searchsorted(of_run, of_run)
    bands = _no_bands(columns, int(rank.max()) + 1)
    known = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    bands.centre[of_run, rank] = np.where(known, middle, 0.0) + 0.5 * (low + high)
    bands.slope[of_run, rank] = np.where(known[:, None], slope, 0.0)
    bands.error[of_run, rank] = np.where(known, 0.5 * (high - low), np.inf)
    bands.folds[of_run, rank] = ~known | np.logical_or.reduceat(patches.may_turn[patch], starts)
    return bands


def _slopes(
    patches: Patches, typical: Int64[np.ndarray, " run"], half: np.ndarray, height: float
) -> Float64[np.ndarray, "run 3"]:
    """Return how alpha changes with beta along the curve, and with gamma and delta beside it."""
    of_alpha, of_beta = patches.alpha.slope[:, typical], patches.beta.slope[:, typical]
    steep = np.abs(of_alpha[0]) * half > height * np.abs(of_beta[0])
    per_beta = np.where(steep, 0.0, of_alpha[0] / np.where(steep, 1.0, of_beta[0]))
    return np.stack([per_beta, *(of_alpha - per_beta * of_beta)[1:]], axis=-1)


def _no_bands(columns: _Columns, count: int) -> _Bands:
    shape = (columns.centre.shape[0], count)
    nothing = np.full(shape, np.nan)
    return _Bands(nothing, np.full((*shape, 3), np.nan), nothing.copy(), np.zeros(shape, bool))


def _joined(one: _Bands, other: _Bands) -> _Bands:
    return _Bands(*(np.concatenate(parts, axis=1) for parts in zip(one, other, strict=True)))


def _merged(bands: _Bands, columns: _Columns) -> _Bands:
    """Put bands in order from below, those that touch somewhere in a column as one flat band."""
    while True:
        order = np.argsort(bands.centre, axis=1)
        slope = np.take_along_axis(bands.slope, order[..., None], 1)
        centre, error, folds = (
            np.take_along_axis(part, order, 1) for part in (bands.centre, bands.error, bands.folds)
        )
        bands = _Bands(centre, slope, error, folds)
        low, high = bands.ends(columns)
        touching = np.any(low[..., 1:] <= high[..., :-1], axis=0)
        if not touching.any():
            return bands
        low, high = low.min(axis=0), high.max(axis=0)
        for upper in range(1, touching.shape[1] + 1):
            column = np.flatnonzero(touching[:, upper - 1])
            low[column, upper] = np.minimum(low[column, upper - 1], low[column, upper])
            high[column, upper] = np.maximum(high[column, upper - 1], high[column, upper])
            _set_flat(bands, (column, upper), low[column, upper], high[column, upper])
            centre[column, upper - 1] = np.nan  # in the next round the last of its column
            folds[column, upper - 1] = False


def _set_flat(
    bands: _Bands, where: tuple[np.ndarray, int | np.ndarray], low: np.ndarray, high: np.ndarray
) -> None:
    """Put a band between two alphas in place of another."""
    known = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    bands.centre[where] = 0.5 * (low + high)
    bands.error[where] = np.where(known, 0.5 * (high - low), np.inf)
    bands.slope[where] = 0.0
    bands.folds[where] = True


def _gap_verdicts(
    bands: _Bands, columns: _Columns, delay: float, domain: Domain
) -> Int8[np.ndarray, "column gap"]:
    """Return a verdict for each gap of a domain, from below; NOT_COMPUTED where there is none."""
    low, high = bands.centre - bands.error, bands.centre + bands.error
    floor, ceiling = _gaps(low, high, _widened(domain))
    exists = floor < ceiling
    column, _ = np.nonzero(exists)
    points = np.column_stack([0.5 * (floor + ceiling)[exists], columns.centre[column]])
    codes = np.full(exists.shape, NOT_COMPUTED, np.int8)
    codes[exists] = _verdicts(points, delay)
    # What the middle of a column does not see of it
    begins, ends = _gaps(*bands.ends(columns), domain)
    codes[~exists & np.any(begins < ends, axis=0)] = UNDECIDED
    return codes


def _verdicts(points: Float64[np.ndarray, "point 4"], delay: float) -> Int8[np.ndarray, " point"]:
    # A few sizes of long lists: each is compiled.
    count = len(points)
    if count > _MANY_POINTS:
        count = 1 << (count - 1).bit_length()
    alpha, beta, gamma, delta = np.resize(points, (count, 4)).T
    codes = np.asarray(verdict(alpha, beta, gamma, delta, delay, resolve="exact"))
    return codes[: len(points)]


def _gaps(
    low: Float64[np.ndarray, "*column band"], high: Float64[np.ndarray, "*column band"], of: Domain
) -> tuple[Float64[np.ndarray, "*column gap"], Float64[np.ndarray, "*column gap"]]:
    """Return where gaps begin and end; NaN for those that a column has not."""
    *shape, _ = low.shape
    lowest, highest = (np.full((*shape, 1), end) for end in of.alpha)
    begins = np.concatenate([lowest, high], axis=-1)
    ends = np.concatenate([low, np.full_like(highest, np.nan)], axis=-1)
    ends = np.where(np.isnan(ends) & ~np.isnan(begins), highest, ends)
    return np.maximum(begins, lowest), np.minimum(ends, highest)


def _limits(
    bands: _Bands, codes: Int8[np.ndarray, "column gap"], columns: _Columns, asked: Domain
) -> tuple[Planes, Planes]:
    """Return the bands below and above the stable gap of each column.

    A band hides what is in it unless it parts two unstable gaps and does not fold.
    """
    is_stable = codes == STABLE
    first, count = np.argmax(is_stable, axis=1), is_stable.sum(axis=1)
    low, high = bands.ends(columns)
    number = np.arange(bands.centre.shape[1])
    beside = (number == first[:, None]) | (number == first[:, None] - 1)
    between_unstable = (codes[:, :-1] == UNSTABLE) & (codes[:, 1:] == UNSTABLE)
    is_seen = np.any((high >= asked.alpha[0]) & (low <= asked.alpha[1]), axis=0)
    hiding = is_seen & (bands.folds | ~between_unstable) & ~((count == 1)[:, None] & beside)
    hides = hiding.any(axis=1) | (count > 1)
    # The span of all that may be stable
    last = is_stable.shape[1] - 1 - np.argmax(is_stable[:, ::-1], axis=1)
    spanned = (number >= first[:, None] - 1) & (number <= last[:, None]) & (count > 0)[:, None]
    some = (spanned | hiding) & hides[:, None]
    low = np.min(low, axis=(0, 2), where=some, initial=np.inf)
    high = np.max(high, axis=(0, 2), where=some, initial=-np.inf)
    is_open = (count > 0) & ((first == 0) | np.isnan(_taken(bands.centre, last)))
    lost = np.any(codes == UNDECIDED, axis=1) | np.any(bands.error == np.inf, axis=1)
    lost |= hides & is_open
    low, high = (np.where(hides & ~lost, end, 0.0) for end in (low, high))
    planes = []
    for band, outermost in ((first - 1, -np.inf), (first, np.inf)):
        centre, slope, error = (_taken(part, band) for part in bands[:3])
        open_end = np.isnan(centre) | (count == 0)
        centre = np.where(open_end, np.where(count == 0, np.inf, outermost), centre)
        slope, error = np.where(open_end[:, None], 0.0, slope), np.where(open_end, 0.0, error)
        centre = np.where(hides, 0.5 * (low + high), centre)
        slope, error = (
            np.where(hides[:, None], 0.0, slope),
            np.where(hides, 0.5 * (high - low), error),
        )
        centre, slope = np.where(lost, 0.0, centre), np.where(lost[:, None], 0.0, slope)
        planes.append(_planes(centre, slope, np.where(lost, np.inf, error), columns))
    return planes[0], planes[1]


def _taken(part: np.ndarray, band: Int64[np.ndarray, " column"]) -> np.ndarray:
    """Return what is said of one band of each column; NaN where there is no such band."""
    count = part.shape[1]
    some = part[np.arange(band.size), np.clip(band, 0, count - 1)]
    outside = (band < 0) | (band >= count)
    taken: np.ndarray = np.where(outside.reshape(-1, *[1] * (some.ndim - 1)), np.nan, some)
    return taken


def _planes(
    centre: Float64[np.ndarray, " column"],
    slope: Float64[np.ndarray, "column 3"],
    error: Float64[np.ndarray, " column"],
    columns: _Columns,
) -> Planes:
    constant = centre - np.sum(slope * columns.centre, axis=1)
    size = np.abs(centre) + 2.0 * np.sum(np.abs(slope * columns.centre), axis=1)
    error = error + _ROUNDING * np.where(np.isfinite(size), size, 0.0)
    return np.column_stack([constant, slope, error])
