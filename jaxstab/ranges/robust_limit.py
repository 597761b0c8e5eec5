"""The stiffest wall that every hand of a range allows: searched between two proved bounds.

For one hand, columns of the damping are divided into gaps of proved verdicts
(``boxes.columns.column_gaps``). A stiffness in an unstable gap of one hand is not allowed in that
column; one in stable gaps of all sampled hands is allowed, as far as these hands go. So sampled
hands bound the limit from both sides, whatever the shapes of their stable sets; columns in which
the bounds differ are divided again. A wall a little below is then proved for all hands
(``worst_hand``).
"""

from math import nan
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.conventions import Verdict
from jaxstab.model.filters import known_filters
from jaxstab.proofs.columns import column_gaps
from jaxstab.proofs.enclosures import Domain
from jaxstab.proofs.plant import HandBoxes
from jaxstab.ranges.hands import (
    HandRange,
    Loop,
    Range,
    checked_range,
    held,
    masses_of,
    spread_bodies,
    worst_hand,
)
from jaxstab.ranges.robust_region import reachable
from jaxstab.region import RegionStatus, stable_region

_COLUMNS = 64
_AT_ONCE = 16  # columns with the highest bounds are divided
_FINER = 4
_ROUNDS = 16
_NEAR = 2e-3  # of the limit: bounds that differ less are near enough
_PULL = 0.01  # of the limit: the wall that is proved lies so far below, then twice as far
_ATTEMPTS = 4
_BEYOND = 1e-6  # of the span of a region: its polygon is that near to it

Ends = Float64[np.ndarray, "column gap"]


class RobustLimit(NamedTuple):
    """The stiffest wall for all hands of a range, in SI units; NaN where there is none.

    Attributes:
        stiffness: K of a wall 1 % below the stiffest one that was found, or up to 8 % below where
            the proof failed closer to it.
        damping: B of that wall.
        is_proved: whether that wall is proved stable for every hand.
        limit: no stiffer wall is stable for every hand: every wall above it, within the span of the
            sampled hands' stable regions, is proved unstable for one of these hands. With an
            estimator or a filter the span is that of the components with small gains.
        loop: the loop with the hand that sets the limit.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> found = loop.robust_limit(jaxstab.HandRange(mass=(0.0, 1.0)))
        >>> found.is_proved, found.stiffness < found.limit
        (True, True)
    """

    stiffness: float
    damping: float
    is_proved: bool
    limit: float
    loop: Any  # of the class of the given one


def robust_limit(loop: Loop, hands: HandRange, mass: Range | None = None) -> RobustLimit:
    """Return the largest stiffness that every hand of a range allows: ``HapticLoop``."""
    checked_range(hands, mass)
    loops = [held(loop, hand) for hand in spread_bodies(hands, masses_of(loop, mass), 2)]
    for attempt in range(_ATTEMPTS):
        found = _common_limit(loops, _PULL * 2.0**attempt)
        if np.isnan(found.stiffness):
            break
        worst = worst_hand(loop, hands, found.stiffness, found.damping, mass)
        if worst.verdict == Verdict.STABLE:
            return found._replace(is_proved=True)
        if attempt < _ATTEMPTS - 1:
            loops.append(worst.loop)
    return found


class _Columns(NamedTuple):
    """Columns of the damping, and what some hands allow there; -inf where it is nothing."""

    begin: np.ndarray
    end: np.ndarray
    most: np.ndarray  # no larger stiffness is allowed
    setter: np.ndarray  # the number of the loop that forbids it
    low: np.ndarray  # from here to ``high`` it is allowed
    high: np.ndarray


class _Span(NamedTuple):
    """The span of walls that all stable regions share; ``setter`` has the least stiff one."""

    domain: Domain
    setter: int


class _Gaps(NamedTuple):
    """Gaps of the stiffness in columns of the damping, of all hands side by side."""

    low: Ends
    high: Ends
    verdict: np.ndarray
    hand: np.ndarray  # (gap,)


def _common_limit(loops: list[Loop], pull: float) -> RobustLimit:
    """Return the stiffest wall that some loops allow, pulled down by a share of its stiffness."""
    nothing = RobustLimit(nan, nan, False, nan, loops[0])
    span = _common_span(loops)
    if span is None:
        return nothing
    edges = np.linspace(*span.domain.beta, _COLUMNS + 1)
    columns = _judged(loops, edges, span)
    for _ in range(_ROUNDS):
        best = int(np.argmax(columns.high))
        found = columns.high[best]
        enough = found + _NEAR * abs(found) if np.isfinite(found) else found
        hopeful = columns.most > enough
        if not hopeful.any():
            break
        order = np.argsort(np.where(hopeful, columns.most, -np.inf))
        first = np.zeros_like(hopeful)
        first[order[-_AT_ONCE:]] = True
        first &= hopeful
        parts = _judged(loops, _divided(columns.begin[first], columns.end[first]), span)
        inside = np.any(
            (parts.begin[:, None] >= columns.begin[first])
            & (parts.end[:, None] <= columns.end[first]),
            axis=1,
        )
        columns = _Columns(
            *(
                np.concatenate([old[~first], new[inside]])
                for old, new in zip(columns, parts, strict=True)
            )
        )
    top, best = int(np.argmax(columns.most)), int(np.argmax(columns.high))
    if columns.most[top] == -np.inf:
        return nothing
    limit, setter = float(columns.most[top]), loops[int(columns.setter[top])]
    if columns.high[best] == -np.inf:
        return nothing._replace(limit=limit, loop=setter)
    low, high = columns.low[best], columns.high[best]
    pulled = float(max(high - pull * abs(high), 0.5 * (low + high)))
    damping = float(0.5 * (columns.begin[best] + columns.end[best]))
    return RobustLimit(pulled, damping, False, limit, setter)


def _common_span(loops: list[Loop]) -> _Span | None:
    """Return the span of stiffness and damping that all stable regions share, in SI units."""
    low, high, setter = np.full(2, -np.inf), np.full(2, np.inf), 0
    for number, loop in enumerate(loops):
        region = stable_region(
            gamma=loop.gamma, delta=loop.delta, delay=loop.delay_samples, **loop.filters
        )
        if region.status == RegionStatus.UNRESOLVED:
            continue
        if region.is_empty:
            return None
        region = reachable(region, known_filters(**loop.filters))
        points = np.nan_to_num(region.points) * [loop.stiffness(1.0), loop.damping(1.0)]
        beyond = _BEYOND * np.ptp(points, axis=0)
        low, ends = np.maximum(low, points.min(axis=0) - beyond), points.max(axis=0) + beyond
        setter = number if ends[0] < high[0] else setter
        high = np.minimum(high, ends)
    if not np.all((low < high) & np.isfinite(high - low)):
        return None
    domain = Domain((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))
    return _Span(domain, setter)


def _judged(loops: list[Loop], edges: Float64[np.ndarray, " edge"], span: _Span) -> _Columns:
    gaps = _gaps(loops, edges, span.domain)
    return _Columns(edges[:-1], edges[1:], *_not_unstable(gaps, span), *_stable(gaps, len(loops)))


def _gaps(loops: list[Loop], edges: Float64[np.ndarray, " edge"], domain: Domain) -> _Gaps:
    parts = []
    for loop in loops:
        hand = HandBoxes(*(np.array([v]) for v in (loop.gamma, loop.delta, 0.0, 0.0)))
        own = Domain(
            (loop.alpha(domain.alpha[0]), loop.alpha(domain.alpha[1])),
            (loop.beta(domain.beta[0]), loop.beta(domain.beta[1])),
        )
        filters = known_filters(**loop.filters)
        gaps = column_gaps(loop.beta(edges), hand, loop.delay_samples, own, filters)
        parts.append([loop.stiffness(gaps.low[0]), loop.stiffness(gaps.high[0]), gaps.verdict[0]])
    low, high, verdict = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    # All hands end at the same stiffness, which rounding must not take apart.
    low, high = np.maximum(low, domain.alpha[0]), np.minimum(high, domain.alpha[1])
    counts = [part[0].shape[1] for part in parts]
    verdict = np.where(low < high, verdict, Verdict.NOT_COMPUTED)
    return _Gaps(low, high, verdict, np.repeat(np.arange(len(loops)), counts))


def _not_unstable(gaps: _Gaps, span: _Span) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest stiffness of each column that is in no unstable gap, and whose gap begins.

    The union of open gaps ends below at the lower end of a gap that is in no other. Where none
    reaches the end of the span nothing is known there.
    """
    unstable = gaps.verdict == Verdict.UNSTABLE
    low, high = np.where(unstable, [gaps.low, gaps.high], np.nan)
    top = span.domain.alpha[1]
    ends = np.concatenate([low, np.full_like(low[:, :1], top)], axis=1)[:, :, None]
    covered = np.any((low[:, None] < ends) & (ends < high[:, None]), axis=2)
    covered[:, -1] |= np.any(high >= top, axis=1)
    open_ends = np.where(covered | np.isnan(ends[..., 0]), -np.inf, ends[..., 0])
    first = np.argmax(open_ends, axis=1)
    return np.max(open_ends, axis=1), np.append(gaps.hand, span.setter)[first]


def _stable(gaps: _Gaps, hands: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the highest interval of stiffness of each column in stable gaps of all hands."""
    stable = gaps.verdict == Verdict.STABLE
    low, high = np.where(stable, [gaps.low, gaps.high], np.nan)
    holds = (low[:, None] < high[:, :, None]) & (high[:, :, None] <= high[:, None])
    begins = np.full(high.shape, -np.inf)
    for hand in range(hands):
        own = np.where(holds & (gaps.hand == hand), low[:, None], np.inf).min(axis=2)
        begins = np.maximum(begins, own)
    ends = np.where(np.isfinite(begins), high, -np.inf)
    best = np.argmax(ends, axis=1)[:, None]
    return np.take_along_axis(begins, best, 1)[:, 0], np.take_along_axis(ends, best, 1)[:, 0]


def _divided(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return edges that divide columns; between them may be others."""
    part = np.arange(_FINER + 1) / _FINER
    return np.unique(np.concatenate([np.outer(begin, 1.0 - part) + np.outer(end, part)]))
