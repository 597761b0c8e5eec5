"""The stiffest wall that every hand of a range allows: searched between two proved bounds.

For one hand, columns of the damping are divided into gaps of proved verdicts
(``proofs.columns.column_gaps``). A stiffness in an unstable gap of one hand is not allowed in that
column; one in stable gaps of all sampled hands is allowed, as far as these hands go. So sampled
hands bound the limit from both sides, whatever the shapes of their stable sets; columns in which
the bounds differ are divided again. A wall a little below is then proved for all hands
(``worst_hand``).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64

from jaxstab.arrays import Numbers
from jaxstab.conventions import Verdict
from jaxstab.model import by_name, checked_delay, checked_delta, checked_gamma
from jaxstab.model.filters import Filter, Filters, Velocity, as_keywords, known_filters
from jaxstab.model.parameters import wall_grid
from jaxstab.numbers import checked_number
from jaxstab.point import verdict
from jaxstab.proofs.columns import column_gaps
from jaxstab.proofs.curve_patches import Domain
from jaxstab.proofs.exclusion import Loops, exclude
from jaxstab.proofs.plant import HandBoxes
from jaxstab.ranges.box import (
    NOTHING,
    Guess,
    ParameterBox,
    Points,
    Proof,
    RobustLimit,
    RobustStatus,
    excluded,
    limit_for_hands,
    search,
    verdicts_of_range,
)
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
from jaxstab.region.region import stable_region
from jaxstab.region.stable_set import RegionStatus, StableRegion

# Walls that are stable for every hand of a range: the intersection of stable regions of sampled
# hands, pulled in and proved along its edges for all gamma, delta and theta of the ranges at once
# (``ranges.box``, lemma B7 of docs/proofs.md).

Hands = Float64[np.ndarray, "hands 2"]

Rows = Float64[np.ndarray, " rows"]

_FIRST_FREQUENCIES = 17
_FIRST_DAMPINGS = 3
_ROWS = 129
_SMALLEST = 2.0**-12  # of the ranges: boxes are not halved beyond
_MOST_BOXES = 60_000  # at once
_OUTLINE_TOLERANCE = 1e-4


@dataclass(frozen=True)
class RobustRegion:
    """Walls (alpha, beta) that are stable for every hand of a range at one delay.

    ``outline`` holds the vertices of a polygon, shape (n, 2), counterclockwise, the first one not
    repeated; no vertex for an empty region. With the status PROVED every wall inside and on it is
    stable for every hand. ``hands`` are the sampled (gamma, delta): the true region lies inside of
    the intersection of their stable regions, which is larger than the outline by about
    ``tolerance`` of its size. The intersection is searched on 129 rows of damping: EMPTY does not
    prove that there is none between them. With ``filters``, velocity estimator and position filter
    in units of one sample, it is that of the components that contain small gains, or of the largest
    one of a hand that has no such component.

    Example:
        >>> region = jaxstab.robust_region(gamma=(0.0, 0.001), delta=(0.0, 0.015), delay=1.0)
        >>> region.status.name, bool(region.contains(0.05, 0.3))
        ('PROVED', True)
        >>> region = jaxstab.robust_region(gamma=(0.0, 0.001), delta=(0.01, 0.015), delay=1.0)
        >>> region.max_alpha.round(3).tolist(), region.verdict([0.05, 0.2], 0.3).tolist()
        ([0.147, 0.426], [1, 2])
    """

    gamma: Range
    delta: Range
    delay: float
    tolerance: float
    status: RobustStatus
    outline: Points = field(repr=False)
    hands: Hands = field(repr=False)
    filters: Filters | None = None

    @property
    def max_alpha(self) -> Float64[np.ndarray, " 2"]:
        """The vertex (alpha, beta) of the largest stiffness; NaN for an empty region."""
        if not len(self.outline):
            return np.full(2, np.nan)
        vertex: Float64[np.ndarray, " 2"] = self.outline[np.argmax(self.outline[:, 0])]
        return vertex

    def contains(self, alpha: Numbers, beta: Numbers) -> Bool[np.ndarray, "*grid"]:
        """Where walls are proved stable for all hands of the range, outside the outline too.

        Args and Raises: see ``jaxstab.conventions``.
        """
        return np.asarray(self.verdict(alpha, beta) == Verdict.STABLE)

    def verdict(self, alpha: Numbers, beta: Numbers) -> Int8[np.ndarray, "*grid"]:
        """A proved code of ``Verdict`` for each wall and all hands of the range.

        STABLE where the wall is proved stable for every hand, UNSTABLE where it is proved unstable
        for one of them, otherwise UNDECIDED. Args and Raises: see ``jaxstab.conventions``.
        """
        grid = wall_grid(alpha=alpha, beta=beta)
        walls = grid.reshape(-1, 2)

        def prove(likely: Int64[np.ndarray, " likely"]) -> Int8[np.ndarray, " likely"]:
            range_of_hands = self.gamma, self.delta, self.delay
            failed = [failures(walls[[n]], *range_of_hands, filters=self.filters) for n in likely]
            codes = [Verdict.UNDECIDED if len(hands) else Verdict.STABLE for hands in failed]
            return np.array(codes, np.int8)

        sampled = _verdicts(walls, self.hands, self.delay, self.filters)
        return verdicts_of_range(sampled, prove).reshape(grid.shape[:-1])


def robust_region(
    *,
    gamma: Range,
    delta: Range,
    delay: float = 0.0,
    tolerance: float = 0.02,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> RobustRegion:
    """The walls that are stable for every hand with gamma and delta in given ranges.

    Args:
        gamma: lower and upper end of the physical stiffness k T^2/m in [0, 1e4]; Nyquist frequency
            is at pi^2 + delta^2/4. Equal ends fix it.
        delta: lower and upper end of the physical damping b T/m in [0, 1e3].
        delay, velocity, position: see ``jaxstab.conventions``.
        tolerance: how far the polygon is pulled in to be proved, as a share of its size, in
            [1e-3, 0.5].

    Returns:
        RobustRegion with its status. An empty region is an answer, not an error.

    Raises: see ``jaxstab.conventions``; ValueError also for ends in the wrong order.

    Source: sec. VIII of Hulin, Preusche, Hirzinger (2008); lemmas B7 and B11 of docs/proofs.md.

    Example:
        >>> window = jaxstab.Velocity.difference(samples=5)
        >>> hands = {"gamma": (0.0, 1e-3), "delta": (0.005, 0.01)}
        >>> region = jaxstab.robust_region(**hands, delay=1.0, tolerance=0.1, velocity=window)
        >>> region.status.name, round(float(region.max_alpha[0]), 3)
        ('PROVED', 0.044)
    """
    filters = known_filters(velocity, position)
    for name, ends, check in (("gamma", gamma, checked_gamma), ("delta", delta, checked_delta)):
        check(np.asarray(ends, np.float64))
        if not ends[0] <= ends[1]:
            raise ValueError(f"{name} is {ends}; give the lower end first.")
    checked_delay(delay)
    checked_number("tolerance", tolerance, 1e-3, 0.5)
    sample = _Sample(gamma, delta, delay, filters)
    result = search(sample.polygon, sample.unproved, sample.add, [tolerance])
    outline = (result.guess or NOTHING).walls
    return RobustRegion(
        gamma, delta, delay, tolerance, result.status, outline, sample.hands, filters
    )


class _Sample:
    """Sampled hands and their stable regions."""

    def __init__(self, gamma: Range, delta: Range, delay: float, filters: Filters | None) -> None:
        self.range = gamma, delta, delay
        self.filters = filters
        self.regions: list[StableRegion] = []
        self.hands = np.zeros((0, 2))
        frequencies = _FIRST_FREQUENCIES if gamma[0] < gamma[1] else 1
        frequency = np.linspace(sqrt(gamma[0]), sqrt(gamma[1]), frequencies)
        stiffness = np.clip(frequency**2, *gamma)
        damping = np.linspace(*delta, _FIRST_DAMPINGS if delta[0] < delta[1] else 1)
        self.add(np.stack(np.meshgrid(stiffness, damping), axis=-1).reshape(-1, 2))

    def add(self, hands: Hands) -> bool:
        """Add hands that are not there yet."""
        before = len(self.hands)
        for hand in hands:
            if not np.any(np.all(self.hands == hand, axis=1)):
                self.hands = np.concatenate([self.hands, hand[None]])
                gamma, delta = map(float, hand)
                region = stable_region(
                    gamma=gamma,
                    delta=delta,
                    delay=self.range[2],
                    tolerance=_OUTLINE_TOLERANCE,
                    **as_keywords(self.filters),
                )
                if region.status != RegionStatus.UNRESOLVED:  # the proof covers this hand too
                    self.regions.append(reachable(region, self.filters))
        return len(self.hands) > before

    def polygon(self, pull: float) -> Guess | None:
        """A polygon of the spans of some rows of the intersection, pulled in by a share."""
        # No slice is known with a row of several intervals; its span would hold unstable walls, and
        # the proof would fail. An intersection that lies between two rows may be missed.
        if not self.regions:
            return None
        if any(region.is_empty for region in self.regions):
            return NOTHING
        tops = [region.points[:, 1] for region in self.regions]
        low, high = max(t.min() for t in tops), min(t.max() for t in tops)
        return Guess(pulled_in(polygon_of_rows(self._limits, low, high), pull))

    def unproved(self, walls: Points) -> Hands:
        """Hands at which walls of the polygon are not proved."""
        failed = failures(walls, *self.range, filters=self.filters)
        code = _verdicts(walls[:1], self.hands[:1], self.range[2], self.filters)
        return failed if len(failed) or np.all(code == Verdict.STABLE) else self.hands[:1]

    def _limits(self, rows: Rows) -> tuple[Rows, Rows]:
        limits = np.stack([np.asarray(region.alpha_limits(rows)) for region in self.regions])
        limits = np.where(np.isnan(limits), [np.inf, -np.inf], limits)
        return limits[..., 0].max(axis=0), limits[..., 1].min(axis=0)


def polygon_of_rows(
    limits: Callable[[Rows], tuple[Rows, Rows]], low: float, high: float, count: int = _ROWS
) -> Points:
    """A polygon of the spans of rows from low to high; no point if no row has one.

    ``limits`` takes rows, and returns the left and the right end of each.
    """
    for _ in range(3):  # the spans may end before the rows do
        rows = np.linspace(low, high, count + 2)[1:-1]
        left, right = limits(rows)
        met = np.flatnonzero(left < right)
        if not len(met):
            return np.zeros((0, 2))
        step = rows[1] - rows[0]
        low, high = rows[met[0]] - step, rows[met[-1]] + step
    rows, left, right = rows[met], left[met], right[met]
    upwards = np.stack([right, rows], axis=-1)
    downwards = np.stack([left, rows], axis=-1)[::-1]
    return np.concatenate([upwards, downwards])


def reachable(region: StableRegion, filters: Filters | None) -> StableRegion:
    """The part of a hand's region that counts: with filters, one component."""
    if filters is None or region.is_empty:
        return region
    return region.main or region.components[0]


def pulled_in(outline: Points, tolerance: float) -> Points:
    """The outline shrunk towards its centroid."""
    if not len(outline):
        return outline
    following = np.roll(outline, -1, axis=0)
    cross = outline[:, 0] * following[:, 1] - following[:, 0] * outline[:, 1]
    centroid = np.sum((outline + following) * cross[:, None], axis=0) / (3 * np.sum(cross))
    pulled: Points = centroid + (1 - tolerance) * (outline - centroid)
    return pulled


def failures(
    outline: Points, gamma: Range, delta: Range, delay: float, *, filters: Filters | None
) -> Hands:
    """Some hands at which walls on a closed polygon could not be proved; none is a proof.

    The axes of the boxes are the way along an edge, from -1 to 1, gamma, delta and theta.
    """
    following = np.roll(outline, -1, axis=0)
    middle, half_edge = 0.5 * (outline + following), 0.5 * (following - outline)
    ranges = np.array([(-1.0, 1.0), gamma, delta, (0.0, pi)])
    middles, halves = ranges.mean(axis=1), 0.5 * np.ptp(ranges, axis=1)
    boxes = ParameterBox.from_axes(
        np.arange(len(outline)),
        shift=(middles[0], np.where(np.all(half_edge == 0.0, axis=1), 0.0, halves[0])),
        gamma=(middles[1], halves[1]),
        delta=(middles[2], halves[2]),
        theta=(middles[3], halves[3]),
    )

    def prove(boxes: ParameterBox) -> Proof:
        shift, stiffness, damping, theta = boxes.center.T
        by_shift, by_gamma, by_delta, by_theta = boxes.half.T
        (alpha, beta), (along, up) = middle[boxes.index].T, half_edge[boxes.index].T
        moves = {
            ("shift", "alpha"): np.abs(along) * by_shift,
            ("shift", "beta"): np.abs(up) * by_shift,
            ("gamma", "gamma"): by_gamma,
            ("delta", "delta"): by_delta,
            ("theta", "theta"): by_theta,
        }
        walls = alpha + shift * along, beta + shift * up
        center = Loops(*walls, stiffness, damping, np.full_like(theta, delay), theta)
        return excluded(partial(exclude, filters=filters), center, boxes.moved(moves))

    remaining = boxes.paved(prove, _SMALLEST * np.ptp(ranges, axis=1), most=_MOST_BOXES).boxes
    if not remaining.count:
        return np.zeros((0, 2))
    hands = remaining.center[:, 1:3]
    extremes: Hands = hands[[*np.argmin(hands, axis=0), *np.argmax(hands, axis=0)]]
    return np.unique(extremes, axis=0)


def _verdicts(
    walls: Points, hands: Hands, delay: float, filters: Filters | None
) -> Int8[np.ndarray, "points hands"]:
    arguments = walls[:, :1], walls[:, 1:], hands[:, 0], hands[:, 1]
    return np.asarray(verdict(**by_name(*arguments, delay), **as_keywords(filters)))


_COLUMNS = 64
_AT_ONCE = 16  # columns with the highest bounds are divided
_FINER = 4
_ROUNDS = 16
_NEAR = 2e-3  # of the limit: bounds that differ less are near enough
_BEYOND = 1e-6  # of the span of a region: its polygon is that near to it

Ends = Float64[np.ndarray, "column gap"]


def robust_limit(loop: Loop, hands: HandRange, mass: Range | None = None) -> RobustLimit:
    """Return the largest stiffness that every hand of a range allows: ``HapticLoop``."""
    checked_range(hands, mass)
    loops = [held(loop, hand) for hand in spread_bodies(hands, masses_of(loop, mass), 2)]
    return limit_for_hands(loops, _common_limit, lambda k, b: worst_hand(loop, hands, k, b, mass))


class _Columns(NamedTuple):
    """Columns of the damping, and the stiffness that all hands allow there; -inf where none."""

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


def _common_limit(loops: list[Loop], pull: float) -> Guess:
    """The stiffest wall with B >= 0 that all loops allow, pulled down by a share of itself."""
    span = _common_span(loops)
    if span is None:
        return NOTHING
    edges = np.linspace(*span.domain.beta, _COLUMNS + 1)
    columns = _judged(loops, edges, span)
    for _ in range(_ROUNDS):
        best = int(np.argmax(columns.high))
        stiffest = columns.high[best]
        enough = stiffest + _NEAR * abs(stiffest) if np.isfinite(stiffest) else stiffest
        hopeful = columns.most > enough
        if not hopeful.any():
            break
        order = np.argsort(np.where(hopeful, columns.most, -np.inf))
        chosen = np.zeros_like(hopeful)
        chosen[order[-_AT_ONCE:]] = True
        chosen &= hopeful
        parts = _judged(loops, _divided(columns.begin[chosen], columns.end[chosen]), span)
        inside = np.any(
            (parts.begin[:, None] >= columns.begin[chosen])
            & (parts.end[:, None] <= columns.end[chosen]),
            axis=1,
        )
        columns = _Columns(
            *(
                np.concatenate([old[~chosen], new[inside]])
                for old, new in zip(columns, parts, strict=True)
            )
        )
    top, best = int(np.argmax(columns.most)), int(np.argmax(columns.high))
    if not columns.most[top] > 0.0:
        return NOTHING
    limit, setter = float(columns.most[top]), loops[int(columns.setter[top])]
    if not columns.high[best] > 0.0:
        return Guess(NOTHING.walls, limit, setter)
    low, high = columns.low[best], columns.high[best]
    pulled = max(high - pull * abs(high), 0.5 * (low + high))
    damping = 0.5 * (columns.begin[best] + columns.end[best])
    return Guess(np.array([[pulled, damping]]), limit, setter)


def _common_span(loops: list[Loop]) -> _Span | None:
    """The span of stiffness and damping >= 0 that all stable regions share, in SI units."""
    low, high, setter = np.array([-np.inf, 0.0]), np.full(2, np.inf), 0
    for index, loop in enumerate(loops):
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
        setter = index if ends[0] < high[0] else setter
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
        scaled = Domain(
            (loop.alpha(domain.alpha[0]), loop.alpha(domain.alpha[1])),
            (loop.beta(domain.beta[0]), loop.beta(domain.beta[1])),
        )
        filters = known_filters(**loop.filters)
        gaps = column_gaps(loop.beta(edges), hand, loop.delay_samples, scaled, filters)
        parts.append([loop.stiffness(gaps.low[0]), loop.stiffness(gaps.high[0]), gaps.verdict[0]])
    low, high, verdict = (np.concatenate(ends, axis=1) for ends in zip(*parts, strict=True))
    # All hands end at the same stiffness, which rounding must not take apart.
    low, high = np.maximum(low, domain.alpha[0]), np.minimum(high, domain.alpha[1])
    counts = [of_loop[0].shape[1] for of_loop in parts]
    verdict = np.where(low < high, verdict, Verdict.NOT_COMPUTED)
    return _Gaps(low, high, verdict, np.repeat(np.arange(len(loops)), counts))


def _not_unstable(gaps: _Gaps, span: _Span) -> tuple[np.ndarray, np.ndarray]:
    """The largest stiffness of each column in no unstable gap, and the hand that sets it."""
    # The union of open gaps ends below at the lower end of a gap that is in no other. Where no gap
    # reaches the end of the span, no verdict is known there.
    unstable = gaps.verdict == Verdict.UNSTABLE
    low, high = np.where(unstable, [gaps.low, gaps.high], np.nan)
    top = span.domain.alpha[1]
    ends = np.concatenate([low, np.full_like(low[:, :1], top)], axis=1)[:, :, None]
    covered = np.any((low[:, None] < ends) & (ends < high[:, None]), axis=2)
    covered[:, -1] |= np.any(high >= top, axis=1)
    open_ends = np.where(covered | np.isnan(ends[..., 0]), -np.inf, ends[..., 0])
    highest = np.argmax(open_ends, axis=1)
    return np.max(open_ends, axis=1), np.append(gaps.hand, span.setter)[highest]


def _stable(gaps: _Gaps, hands: int) -> tuple[np.ndarray, np.ndarray]:
    """The highest interval of stiffness of each column in stable gaps of all hands."""
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
    """Edges that divide columns; other columns may lie between."""
    share = np.arange(_FINER + 1) / _FINER
    return np.unique(np.concatenate([np.outer(begin, 1.0 - share) + np.outer(end, share)]))
