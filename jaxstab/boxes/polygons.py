"""Walls that are stable for every hand of a range of gamma and delta: a polygon, proved.

The intersection of the stable regions of sampled hands is pulled in a little and proved along its
edges for all gamma, delta and theta of the ranges at once (``boxes.search``, lemma B11 of
docs/proofs.md). The device is one mass: 1 kg, held by a spring gamma and a damper delta, T = 1.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import sqrt

import numpy as np
from jaxtyping import Bool, Float64, Int8

from jaxstab.arrays import Numbers, named
from jaxstab.boxes.search import (
    NOTHING,
    Guess,
    HandRange,
    Points,
    RobustStatus,
    search,
    unproved_members,
)
from jaxstab.conventions import Range, Verdict
from jaxstab.model import by_name, checked_delay, checked_delta, checked_gamma
from jaxstab.model.filters import Filter, Filters, Velocity, as_keywords, known_filters
from jaxstab.model.loop import unit_loop
from jaxstab.model.plant import wall_grid
from jaxstab.numbers import checked_number, two_ends
from jaxstab.point import verdict
from jaxstab.region.region import stable_region
from jaxstab.region.stable_set import RegionStatus, StableRegion

Hands = Float64[np.ndarray, "hands 2"]

Rows = Float64[np.ndarray, " rows"]

_ROWS = 129


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
        >>> region = jaxstab.robust_region(gamma=(0.0, 0.001), delta=(0.01, 0.015), delay=1.0)
        >>> region.max_alpha.round(3).tolist(), region.verdict([0.05, 0.2], 0.3).tolist()
        ([0.147, 0.426], [1, 2])
        >>> bool(region.contains(0.05, 0.3))
        True
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
        return self.outline[np.argmax(self.outline[:, 0])]

    def contains(self, alpha: Numbers, beta: Numbers) -> Bool[np.ndarray, "*grid"]:
        """True where walls are proved stable for all hands of the range, outside the outline too.

        Args and Raises: see ``jaxstab.conventions``.
        """
        return np.asarray(self.verdict(alpha, beta) == Verdict.STABLE)

    def verdict(self, alpha: Numbers, beta: Numbers) -> Verdict | Int8[np.ndarray, "*grid"]:
        """A proved code of ``Verdict`` for each wall and all hands of the range.

        STABLE where the wall is proved stable for every hand, UNSTABLE where it is proved unstable
        for one of them, otherwise UNDECIDED. Args and Raises: see ``jaxstab.conventions``.
        """
        grid = wall_grid(alpha=alpha, beta=beta)
        walls = grid.reshape(-1, 2)
        sampled = _verdicts(walls, self.hands, self.delay, self.filters)
        is_unstable = np.any(sampled == Verdict.UNSTABLE, axis=1)
        codes = np.where(is_unstable, Verdict.UNSTABLE, Verdict.UNDECIDED).astype(np.int8)
        for number in np.flatnonzero(np.any(sampled == Verdict.STABLE, axis=1) & ~is_unstable):
            range_of_hands = self.gamma, self.delta, self.delay
            if not len(failures(walls[[number]], *range_of_hands, filters=self.filters)):
                codes[number] = Verdict.STABLE
        return named(codes.reshape(grid.shape[:-1]), Verdict)


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
        tolerance: the share of its size by which the polygon is pulled in to be proved, in
            [1e-3, 0.5].

    Returns:
        RobustRegion with its status. An empty region is an answer, not an error.

    Raises: see ``jaxstab.conventions``; ValueError also for ends in the wrong order.

    Source: sec. VIII of Hulin, Preusche, Hirzinger (2008); lemma B11 of docs/proofs.md.

    Example:
        >>> window = jaxstab.Velocity.difference(samples=5)
        >>> hands = {"gamma": (0.0, 1e-3), "delta": (0.005, 0.01)}
        >>> region = jaxstab.robust_region(**hands, delay=1.0, tolerance=0.1, velocity=window)
        >>> region.status.name, round(float(region.max_alpha[0]), 3)
        ('PROVED', 0.044)
    """
    filters = known_filters(velocity, position)
    gamma, delta = two_ends("gamma", gamma), two_ends("delta", delta)
    for name, ends, check in (("gamma", gamma, checked_gamma), ("delta", delta, checked_delta)):
        check(np.asarray(ends))
        if not ends[0] <= ends[1]:
            raise ValueError(f"{name} is {ends}; give the lower end first.")
    delay = checked_number("delay", checked_delay(delay))
    checked_number("tolerance", tolerance, 1e-3, 0.5)
    sample = _Sample(gamma, delta, delay, filters)
    guess, is_proved = search(sample.polygon, sample.unproved, sample.add, [tolerance])
    status = RobustStatus.PROVED if is_proved else RobustStatus.UNPROVED
    if guess is not None and not len(guess.walls):
        status = RobustStatus.EMPTY
    outline = (guess or NOTHING).walls
    return RobustRegion(gamma, delta, delay, tolerance, status, outline, sample.hands, filters)


class _Sample:
    """Sampled hands and their stable regions."""

    def __init__(self, gamma: Range, delta: Range, delay: float, filters: Filters | None) -> None:
        first_frequencies = 17
        first_dampings = 3
        self.range = gamma, delta, delay
        self.filters = filters
        self.regions: list[StableRegion] = []
        self.hands = np.zeros((0, 2))
        frequencies = first_frequencies if gamma[0] < gamma[1] else 1
        frequency = np.linspace(sqrt(gamma[0]), sqrt(gamma[1]), frequencies)
        stiffness = np.clip(frequency**2, *gamma)
        damping = np.linspace(*delta, first_dampings if delta[0] < delta[1] else 1)
        self.add(np.stack(np.meshgrid(stiffness, damping), axis=-1).reshape(-1, 2))

    def add(self, hands: Hands) -> bool:
        """Add hands that are not there yet."""
        outline_tolerance = 1e-4
        before = len(self.hands)
        for hand in hands:
            if not np.any(np.all(self.hands == hand, axis=1)):
                self.hands = np.concatenate([self.hands, hand[None]])
                own = by_name(*hand.tolist(), self.range[2]) | as_keywords(self.filters)
                region = stable_region(**own, tolerance=outline_tolerance)
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
        limits = np.where(np.isnan(limits), np.inf, limits)  # no left end: no wall of the row
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
    return centroid + (1 - tolerance) * (outline - centroid)


def failures(
    outline: Points, gamma: Range, delta: Range, delay: float, *, filters: Filters | None
) -> Hands:
    """Some hands at which walls on a closed polygon could not be proved; none is a proof."""
    loop = unit_loop(0.0, 0.0, delay, **as_keywords(filters))
    ranges = HandRange(stiffness=gamma, damping=delta), (1.0, 1.0), (delay, delay)
    following = np.roll(outline, -1, axis=0) if len(outline) > 1 else None
    try:
        members = unproved_members(loop.held_device, loop, *ranges, outline, until=following)
    except NotImplementedError:  # a hand so stiff that the plant has no bound at high frequencies
        return np.array([[gamma[0], delta[0]]])
    if not len(members):
        return np.zeros((0, 2))
    hands = members[:, 1:3]
    extremes: Hands = hands[[*np.argmin(hands, axis=0), *np.argmax(hands, axis=0)]]
    return np.unique(extremes, axis=0)


def _verdicts(
    walls: Points, hands: Hands, delay: float, filters: Filters | None
) -> Int8[np.ndarray, "points hands"]:
    arguments = walls[:, :1], walls[:, 1:], hands[:, 0], hands[:, 1]
    return np.asarray(verdict(**by_name(*arguments, delay), **as_keywords(filters)))
