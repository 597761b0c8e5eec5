"""Limits of alpha over columns: boxes of beta, gamma, delta and delay with known stable alphas.

In a column the boundary is a few strips, each within an error of a plane over its parameters:
the line of a root at 1, the parts of the curve (``enclosure``), and the line of a root at -1.
Between two strips, and below and above them all, no root crosses the unit circle, so one certified
verdict holds for the whole gap. Nothing has to be known about the shape of the stable set. Where
strips meet, or more than one gap is stable, what lies between stays undecided.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64

from jaxstab.boxes.enclosure import Domain
from jaxstab.boxes.plant import HandBoxes
from jaxstab.boxes.runs import SQUARE, Columns, T, columns_of, with_products
from jaxstab.boxes.strips import (
    Strips,
    above_line,
    apart,
    holds_line,
    strips_of,
    widened,
)
from jaxstab.conventions import NOT_COMPUTED, STABLE, UNDECIDED, UNSTABLE
from jaxstab.model import by_name
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.point import verdict

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
_ROUNDING = 1e-14  # of the domain: sums of the terms of a plane

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

    Each gap has one verdict for all beta, gamma and delta of its closed column. Entries without
    ``low < high`` are padding.

    Attributes:
        low: lower ends, shape (box, beta cell, gap), from below.
        high: upper ends, of the same shape.
        verdict: codes of ``jaxstab.Verdict``, of the same shape.
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
    """Return which alphas of a domain are proved stable in each column.

    Args:
        beta: edges of the cells along beta, ascending.
        hands: boxes of gamma in [0, 1e4] and delta in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples.
        domain: of alpha and beta.
        filters: velocity estimator and position filter in units of one sample, whose gain P(1) is
            not 0; None for the difference over one sample. Then a column may have several stable
            gaps, and between the first and the last of them nothing is said.
        half_delay: largest distance of the delay from this one; no whole sample may lie between.

    Raises:
        ValueError: gamma, delta or delay is outside the range of the model, or P(1) is 0.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle, and the certified
    verdict; lemmas B8, B12 and B16 of docs/proofs.md.
    """
    columns = columns_of(beta, hands, delay, half_delay)
    strips = strips_of(beta, columns, hands, domain, filters)
    lower, upper = (np.empty((columns.centre.shape[0], len(TERMS))) for _ in range(2))
    rest = np.arange(columns.centre.shape[0])
    for ordered in (above_line, apart) if holds_line(filters) else (apart,):
        some, there = strips.some(rest), columns.some(rest)
        some = _straight_where_partial(ordered, some, there, domain)
        codes = _gap_verdicts(some, there, domain, filters)
        lower[rest], upper[rest] = _limits(some, codes, there, domain)
        rest = rest[upper[rest, -1] == np.inf]
        if not rest.size:
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
    """Return the proved verdicts of each column of a domain, gap by gap.

    Args, errors and source: as ``stable_columns``.
    """
    columns = columns_of(beta, hands, delay)
    strips = apart(strips_of(beta, columns, hands, domain, filters), columns)
    codes = _gap_verdicts(strips, columns, domain, filters)
    terms = np.sum(np.abs(strips.slope * columns.centre[:, None]), axis=-1)
    error = strips.error + _ROUNDING * (np.abs(strips.centre) + 2.0 * terms)
    low, high = _gaps(*strips._replace(error=error).ends(columns), widened(domain))
    shape = (hands.gamma.size, beta.size - 1, codes.shape[1])
    return ColumnGaps(
        low.max(axis=0).reshape(shape), high.min(axis=0).reshape(shape), codes.reshape(shape)
    )


def _gap_verdicts(
    strips: Strips, columns: Columns, domain: Domain, filters: Filters | None
) -> Int8[np.ndarray, "column gap"]:
    """Return a verdict for each gap of a domain, from below; NOT_COMPUTED where there is none.

    A gap is connected: where it is not all along its column strips are straight, and it is convex.
    """
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
    codes = np.full(exists.shape, NOT_COMPUTED, np.int8)
    resolve = "exact" if filters is None else None
    some = np.empty(alpha.size, np.int8)
    shares = np.sign(deviation[:, T]) if columns.half_delay else np.zeros_like(alpha)
    for share in np.unique(shares).tolist():
        here = shares == share
        delay = columns.delay + share * _INSIDE * columns.half_delay
        walls = alpha[here], beta[here], np.maximum(gamma[here], 0.0), np.maximum(delta[here], 0.0)
        some[here] = verdict(**by_name(*walls, delay), resolve=resolve, **as_keywords(filters))
    codes[exists] = some
    codes[(codes == NOT_COMPUTED) & _may_be(strips, columns, domain)] = UNDECIDED
    low, high = strips.ends(columns)
    crosses = np.any(low[..., 1:] <= high[..., :1], axis=0)
    codes[:, 2:][crosses & (codes[:, 2:] == STABLE)] = UNDECIDED  # its lower limit has a corner
    return codes


def _may_be(strips: Strips, columns: Columns, domain: Domain) -> Bool[np.ndarray, "column gap"]:
    """Say which gaps may reach into a domain somewhere in their columns."""
    begins, ends = _gaps(*strips.ends(columns), _EVERYWHERE)
    reach: np.ndarray = np.any(begins < ends, axis=0)
    reach &= np.any(ends > domain.alpha[0], axis=0) & np.any(begins < domain.alpha[1], axis=0)
    return reach


def _straight_where_partial(
    ordered: Callable[[Strips, Columns], Strips], strips: Strips, columns: Columns, domain: Domain
) -> Strips:
    """Order strips, straight ones in columns that hold a part of a gap alone."""
    first = ordered(strips, columns)
    if not columns.half_delay:
        return first
    begins, ends = _gaps(*first.ends(columns), widened(domain))
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
    of: Domain,
) -> tuple[Float64[np.ndarray, "*column gap"], Float64[np.ndarray, "*column gap"]]:
    """Return the ends of gaps; NaN where a column has fewer."""
    *shape, _ = low.shape
    lowest, highest = (np.full((*shape, 1), end) for end in of.alpha)
    begins = np.concatenate([lowest, np.maximum(high, high[..., :1])], axis=-1)
    ends = np.concatenate([low, np.full_like(highest, np.nan)], axis=-1)
    ends = np.where(np.isnan(ends) & ~np.isnan(begins), highest, ends)
    return np.maximum(begins, lowest), np.minimum(ends, highest)


def _limits(
    strips: Strips, codes: Int8[np.ndarray, "column gap"], columns: Columns, asked: Domain
) -> tuple[Planes, Planes]:
    """Return the strips below and above the stable gap of each column.

    Where others hide what is in them, both limits are the flat span of all that may be stable.
    """
    is_stable = codes == STABLE
    first, count = np.argmax(is_stable, axis=1), is_stable.sum(axis=1)
    last = is_stable.shape[1] - 1 - np.argmax(is_stable[:, ::-1], axis=1)
    low, high = strips.ends(columns)
    is_seen = np.any((high >= asked.alpha[0]) & (low <= asked.alpha[1]), axis=0)
    hiding = is_seen & _may_hide(strips, codes)
    number = np.arange(strips.centre.shape[1])
    beside = (number == first[:, None]) | (number == first[:, None] - 1)
    hiding &= ~((count == 1)[:, None] & beside)
    hides = hiding.any(axis=1) | (count > 1)
    spanned = (number >= first[:, None] - 1) & (number <= last[:, None]) & (count > 0)[:, None]
    some = (spanned | hiding) & hides[:, None]
    low = np.min(low, axis=(0, 2), where=some, initial=np.inf)
    high = np.max(high, axis=(0, 2), where=some, initial=-np.inf)
    is_open = (count > 0) & ((first == 0) | np.isnan(_of_strip(strips.centre, last)))
    lost = np.any(codes == UNDECIDED, axis=1) | np.any(strips.error == np.inf, axis=1)
    lost |= hides & is_open
    low, high = (np.where(hides & ~lost, end, 0.0) for end in (low, high))
    variables = columns.centre.shape[1]
    span = _flat(0.5 * (low + high), 0.5 * (high - low), variables)
    unknown = _flat(np.zeros_like(low), np.full_like(low, np.inf), variables)
    limits = []
    for strip, outermost in ((first - 1, -np.inf), (first, np.inf)):
        limit = _ends_at(strips, strip, outermost, count > 0)
        limit = limit.replaced(hides, span).replaced(lost, unknown)
        limits.append(_planes(limit, columns))
    return limits[0], limits[1]


def _may_hide(
    strips: Strips, codes: Int8[np.ndarray, "column gap"]
) -> Bool[np.ndarray, "column strip"]:
    """Say which strips may hide stable alphas: not those between unstable gaps that do not fold."""
    between_unstable = (codes[:, :-1] == UNSTABLE) & (codes[:, 1:] == UNSTABLE)
    hides: Bool[np.ndarray, "column strip"] = strips.folds | ~between_unstable
    return hides


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
    centre, slope, error = (_of_strip(part, strip) for part in strips[:3])
    open_end = np.isnan(centre) | ~is_known
    centre = np.where(open_end, np.where(is_known, outermost, np.inf), centre)
    slope, error = np.where(open_end[:, None], 0.0, slope), np.where(open_end, 0.0, error)
    return _Limits(centre, slope, error)


def _of_strip(part: np.ndarray, strip: Int64[np.ndarray, " column"]) -> np.ndarray:
    """Return the limits by one strip of each column; NaN where there is no such strip."""
    count = part.shape[1]
    some = part[np.arange(strip.size), np.clip(strip, 0, count - 1)]
    outside = (strip < 0) | (strip >= count)
    value: np.ndarray = np.where(outside.reshape(-1, *[1] * (some.ndim - 1)), np.nan, some)
    return value


def _planes(limits: _Limits, columns: Columns) -> Planes:
    """Return the terms of limits, in the parameters themselves."""
    centre, slope, error = limits
    constant = centre - np.sum(slope * columns.centre, axis=1)
    size = np.abs(centre) + 2.0 * np.sum(np.abs(slope * columns.centre), axis=1)
    of_delay = np.zeros((constant.size, len(TERMS) - 1 - T - 1))
    plane = slope[:, :T]
    if columns.half_delay:
        # t = d - d0 in rate t + bend (t^2 - half) + turns t (x - x0), where centres are 0
        middle, known = columns.delay, columns.centre[:, :T]
        rate, bend, turns = slope[:, T], slope[:, SQUARE], slope[:, SQUARE + 1 :]
        level = np.sum(turns * known, axis=1)
        constant += (level - rate) * middle + bend * (middle**2 - columns.half[:, SQUARE])
        plane = plane - turns * middle
        of_delay = np.column_stack([rate - 2.0 * middle * bend - level, bend, turns])
        latest = middle + columns.half_delay
        size += 4.0 * (np.abs(rate) + 2.0 * latest * np.abs(bend)) * latest
        size += 8.0 * latest * np.sum(np.abs(turns) * (np.abs(known) + columns.half[:, :T]), axis=1)
    error = error + _ROUNDING * np.where(np.isfinite(size), size, 0.0)
    return np.column_stack([constant, plane, of_delay, error])
