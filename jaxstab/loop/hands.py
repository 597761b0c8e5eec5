"""A loop in the hands of a range: the worst hand of a wall, the stiffest wall that all allow.

Some hands are tried, in balls; all others, all masses of a device and all constant delays of a
range, are proved in boxes (``boxes.search``). The stiffest wall is searched in the
exact regions of the hands that were tried, row by row of the damping, and a wall a little below it
is proved for all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import product
from math import isfinite, nan
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.boxes.plant import Arms, with_parts
from jaxstab.boxes.polygons import polygon_of_rows
from jaxstab.boxes.search import (
    NOTHING,
    PULLS,
    Guess,
    HandRange,
    Members,
    Points,
    RobustLimit,
    checked_range,
    search,
    spread_hands,
    unproved_members,
)
from jaxstab.conventions import Range, Verdict
from jaxstab.exact import rough_radius
from jaxstab.loop.jitter import Jitter, stiffest_proved
from jaxstab.loop.region import TOLERANCE, Region, region_of_loop
from jaxstab.model.balls import ball_triple
from jaxstab.model.device.parts import MassSpringDamper, Modes
from jaxstab.numbers import two_ends
from jaxstab.region import RegionStatus
from jaxstab.shown import rounded_text

Wall = tuple[float, float]


class WorstHand(NamedTuple):
    """The verdict on a wall for all hands of a range, with the worst hand that was tried.

    A ``verdict`` of STABLE is proved for every hand. UNSTABLE is proved for ``loop``, the loop with
    the worst hand: that of the largest spectral ``radius`` of those tried.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> worst = loop.worst_hand(jaxstab.HandRange(mass=(0.0, 1.0)), 1000.0, 10.0)
        >>> worst.verdict.name, worst.loop.hand_mass
        ('STABLE', 1.0)
    """

    verdict: Verdict
    loop: Any  # of the class of the given one
    radius: float

    def __repr__(self) -> str:
        words = {
            Verdict.STABLE: "stable, proved for all hands",
            Verdict.UNSTABLE: "unstable with the hand below",
            Verdict.UNDECIDED: "not proved for all hands",
        }
        radius = rounded_text(self.radius, 6)
        return f"WorstHand: {words[self.verdict]}\n  largest radius tried  {radius}, {self.loop!r}"


@dataclass(frozen=True)
class HandFamily:
    """A loop with its device and all hands of a range, in place of its hand; a grip stays.

    ``mass`` is the lowest and the highest mass of the device in kg, None for its own. ``delay`` is
    the range of constant delays in s, None for that of the loop; ``delays`` and ``lost`` are of one
    that moves, whose shortest delay the loop then has. Errors: as ``HapticLoop.worst_hand``.
    """

    loop: Any  # a HapticLoop
    hands: HandRange
    mass: Range | None = None
    delay: Range | None = None
    delays: Range | None = None
    lost: int = 0

    def __post_init__(self) -> None:
        if self.moving and self.delay is not None:
            raise TypeError(
                f"delay is {self.delay} beside delays; give those that move, or the others."
            )
        own = Jitter.from_loop(self.loop, **self.moving).loop if self.moving else self.loop
        object.__setattr__(self, "loop", own.in_floats())
        device = self.loop.held_device
        checked_range(self.hands, self.mass, device)
        if self.delay is not None:
            low, high = two_ends("delay", self.delay, 0.0, unit="s")
            if low > high:
                raise ValueError(f"delay is {self.delay}; give the shortest one first.")
        if len(device.hands) > 1:
            raise ValueError(
                f"the device ({device}) is held by {len(device.hands)} hands; give one "
                "that has a single hand, which the hands of the range replace."
            )
        if self.mass is not None and self._own_mass is None:
            raise ValueError(
                f"mass is {self.mass}, but the device ({device}) has none that could vary; "
                "leave it out."
            )

    def worst(self, stiffness: float, damping: float) -> WorstHand:
        """The verdict on a wall for all of them, and the worst of those tried."""
        values = 3  # values of each number that varies
        most_tried = 64  # loops of those that could not be proved
        wall = stiffness, damping

        def judge(members: Members) -> WorstHand:
            return _worst_of([self._held(member) for member in members], wall, self.moving)

        worst = judge(self._spread(values))
        if worst.verdict != Verdict.STABLE:
            return worst
        failed = self.unproved(wall)
        if failed is not None:
            if not len(failed):
                return worst
            count = min(len(failed), most_tried)
            other = judge(failed[np.arange(count) * len(failed) // count])
            if other.verdict == Verdict.UNSTABLE:
                return other
            worst = max(worst, other, key=lambda each: each.radius)
        return worst._replace(verdict=Verdict.UNDECIDED)

    def robust_limit(self) -> RobustLimit:
        """The stiffest wall that all of them allow: ``HapticLoop.robust_limit``."""
        if self.moving:
            return self._limit_of_moving()
        tried = self.corners  # those that refute a wall join them

        def unproved(walls: Points) -> list[WorstHand]:
            hand = self.worst(*walls[0].tolist())
            return [] if hand.verdict == Verdict.STABLE else [hand]

        def add(found: list[WorstHand]) -> bool:
            new = [hand.loop for hand in found if hand.verdict == Verdict.UNSTABLE]
            new = [loop for loop in new if loop not in tried]
            tried.extend(new)
            return bool(new)

        found, is_proved = search(partial(_stiffest_wall, tried), unproved, add, PULLS)
        guess = found or NOTHING
        wall = _wall_of(guess)
        if not is_proved:
            wall = self._proved_below(wall, (0.8, 0.5, 0.2))
        return RobustLimit(*wall, wall[0] > 0.0, guess.limit, guess.loop or tried[0])

    def _limit_of_moving(self) -> RobustLimit:
        """The same for delays that move: the stiffest wall of the corners, proved for all."""
        loops = [replace(loop, delay=d) for d in self.moving["delays"] for loop in self.corners]
        guess = _stiffest_wall(loops, 0.0) or NOTHING  # bounds the search: of constant delays
        moving = [Jitter.from_loop(loop, **self.moving) for loop in self.corners]

        def is_proved(stiffness: float, damping: float) -> bool:
            for k, loop in enumerate(moving):
                if not loop.is_proved(stiffness, damping):
                    moving.insert(0, moving.pop(k))  # which mostly denies the next wall, too
                    return False
            return True

        wall = stiffest_proved(is_proved, guess.limit, _wall_of(guess)[1])
        wall = self._proved_below(wall, (1.0, 0.99, 0.95, 0.9, 0.8, 0.65, 0.5, 0.3, 0.1))
        return RobustLimit(*wall, wall[0] > 0.0, guess.limit, guess.loop or loops[0])

    def _proved_below(self, wall: Wall, shares: Sequence[float]) -> Wall:
        """The first wall that is proved, of some shares of the stiffness; NaN if none is."""
        stiffness, damping = wall
        tried = ((share * stiffness, damping) for share in shares if stiffness > 0.0)
        proved = (wall for wall in tried if self.worst(*wall).verdict == Verdict.STABLE)
        return next(proved, (nan, nan))

    def jitter_margin(self, stiffness: float, damping: float) -> float:
        """The proved range of the delay for all of them, in s: ``HapticLoop.jitter_margin``."""
        wall, delay = (stiffness, damping), float(self.loop.delay)
        most = float(self._held(self._spread(1)[0]).jitter_margin(*wall))

        def is_proved(share: float) -> bool:
            delays = (delay, delay + share * most if isfinite(most) else delay)
            left = replace(self, delays=delays).unproved(wall)
            return left is not None and not len(left)

        if most == 0.0 or is_proved(1.0):
            return most
        low, high = 0.0, 1.0
        for _ in range(7):  # halvings of what one hand allows
            share = 0.5 * (low + high)
            low, high = (share, high) if is_proved(share) else (low, share)
        return low * most if low > 0.0 else 0.0

    @property
    def moving(self) -> dict[str, Any]:
        """The keywords of delays that move, if they do."""
        is_moving = self.delays is not None or self.lost
        return {"delays": self.delays, "lost": self.lost} if is_moving else {}

    @property
    def corners(self) -> list[Any]:
        """The loops at the corners of the ranges."""
        return [self._held(member) for member in self._spread(2)]

    @property
    def _own_mass(self) -> float | None:
        body = self.loop.held_device.mechanism
        return body.mass if isinstance(body, MassSpringDamper | Modes) else None

    @property
    def _masses(self) -> Range:
        own = self._own_mass or 1.0  # of another device no mass is used
        return self.mass or (own, own)

    @property
    def _delays(self) -> Range:
        """The constant delays in samples, or the shortest one of those that move."""
        shortest = self.moving["delays"][0] if self.moving else self.loop.delay
        ends = self.delay or (shortest, shortest)
        low, high = (float(replace(self.loop, delay=end).delay_samples) for end in ends)
        return low, high

    def _spread(self, count: int) -> Members:
        others = [
            np.linspace(low, high, count if low < high else 1).tolist()
            for low, high in (self._masses, self._delays)
        ]
        hands = spread_hands(self.hands, count).tolist()
        return np.array([(*hand, *other) for hand, *other in product(hands, *others)])

    def _held(self, member: Float64[np.ndarray, " 5"]) -> Any:
        *arm, own, samples = member.tolist()
        changes: dict[str, Any] = {}
        if self.delay is not None:
            changes["delay"] = float(np.clip(samples * self.loop.sample_time, *self.delay))
        if self.loop.device is None:
            changes |= zip(("hand_mass", "hand_stiffness", "hand_damping"), arm, strict=True)
            changes["device_mass"] = own
        else:
            mass = None if self.mass is None else own
            changes["device"] = with_parts(self.loop.device, mass, Arms(*arm))
        return replace(self.loop, **changes)

    def unproved(self, wall: Wall, until: Wall | None = None) -> Members | None:
        """Members at which a root on the circle is not excluded; None if boxes do not apply.

        With ``until`` for all walls between two.
        """
        jitter = 0.0
        if self.moving:
            jitter = Jitter.from_loop(self.loop, **self.moving).delays.jitter
        device = with_parts(self.loop.held_device, None, Arms(0.0, 0.0, 0.0))
        ranges = self.hands, self._masses, self._delays
        try:
            ends = (np.array([wall]), jitter, until and np.array([until]))
            return unproved_members(device, self.loop, *ranges, *ends)
        except NotImplementedError:
            return None


def _worst_of(loops: list[Any], wall: Wall, moving: dict[str, Any]) -> WorstHand:
    """The verdict on a wall in the loop of the largest radius; of unstable ones, if any.

    That is the radius at the longest delay, if the delay moves.
    """
    codes = np.array([loop.verdict(*wall, **moving) for loop in loops])
    if moving:
        loops = [replace(loop, delay=moving["delays"][1]) for loop in loops]
    sizes = [rough_radius(partial(ball_triple, loop), *wall) for loop in loops]
    unstable = codes == Verdict.UNSTABLE
    worst = int(np.argmax(np.where(unstable | ~unstable.any(), sizes, -1.0)))
    radius = float(loops[worst].spectral_radius(*wall).value)
    return WorstHand(Verdict(int(codes[worst])), loops[worst], radius)


# Walls that several sampled loops share, by rows of the damping (``boxes.search``).
_ROWS = 33

Rows = Float64[np.ndarray, " row"]
Intervals = Float64[np.ndarray, "row _ 2"]


def _walls_of(loops: Sequence[Any]) -> dict[Any, Region]:
    """The stable walls of loops: the component that contains small gains, if there is one.

    Regions that are UNRESOLVED are left out; a proof for the range covers these loops, too.
    """
    regions = {loop: region_of_loop(loop.in_floats(), TOLERANCE) for loop in loops}
    return {
        loop: region if region.is_empty else region.main or region.components[0]
        for loop, region in regions.items()
        if region.status != RegionStatus.UNRESOLVED
    }


def common_walls(regions: Sequence[Region], count: int = _ROWS) -> Points:
    """A polygon of walls that all regions have, by rows; no point where no row has one.

    Of several intervals of a row it takes the widest. Walls between two rows may be missed, and
    nothing is proved of the polygon. No region may be empty.
    """
    low, high = _common_rows(regions)
    if not low < high:
        return np.zeros((0, 2))
    return polygon_of_rows(partial(_common_limits, regions), low, high, count)


def _stiffest_wall(loops: Sequence[Any], pull: float) -> Guess | None:
    """The stiffest wall with B >= 0 that all loops have, pulled down by a share of it."""
    regions = _walls_of(loops)
    if not regions:
        return None
    even, dense = np.linspace(0.0, 1.0, _ROWS + 2), np.linspace(0.0, 1.0, 4 * _ROWS)
    near = 2.0 ** -np.arange(5.0, 24.0)  # what all share may be thin: next to an end
    if any(region.is_empty for region in regions.values()):
        return NOTHING
    low, high = _common_rows([*regions.values()])
    low = max(low, 0.0)
    walls: list[list[float]] = []  # both ends of the stiffness, and the damping, of each zoom
    shares = np.unique([*even, *dense, *near, *(1.0 - near)])
    while len(walls) < 5 and low < high:
        ends = low + (high - low) * shares
        left, right = _common_limits([*regions.values()], ends[1:-1])
        right = np.where((left < right) & (right > 0.0), right, -np.inf)
        best = int(np.argmax(right))
        if right[best] == -np.inf:
            break
        walls.insert(0, [float(row[best]) for row in (left, right, ends[1:-1])])
        low, high, shares = ends[best], ends[best + 2], even
    if not walls:
        return NOTHING
    least, limit, damping = max(walls, key=lambda wall: wall[1])  # of equal ones the last
    stiffness = max(limit - pull * abs(limit), 0.5 * (least + limit))
    row = np.array([damping])
    tops = {loop: region.stiffness_limits(row)[0, 1] for loop, region in regions.items()}
    return Guess(np.array([[stiffness, damping]]), limit, min(tops, key=lambda loop: tops[loop]))


def _wall_of(guess: Guess) -> Wall:
    """The one wall of a guess; NaN without."""
    stiffness, damping = guess.walls[0].tolist() if len(guess.walls) else (nan, nan)
    return stiffness, damping


def _common_rows(regions: Sequence[Region]) -> tuple[float, float]:
    """The dampings between which all regions may have a wall."""
    tops = [region.outline[:, 1] for region in regions]
    return max(top.min() for top in tops), min(top.max() for top in tops)


def _common_limits(regions: Sequence[Region], rows: Rows) -> tuple[Rows, Rows]:
    """The ends of the widest interval of stiffness that all regions have in each row."""
    shared = reduce(_shared, (region.stiffness_intervals(rows) for region in regions))
    shared = np.pad(shared, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)  # there may be none
    shared = np.where(np.isnan(shared), [np.inf, -np.inf], shared)
    widest = np.argmax(shared[..., 1] - shared[..., 0], axis=1)
    left, right = shared[np.arange(len(rows)), widest].T
    return left, right


def _shared(mine: Intervals, other: Intervals) -> Intervals:
    """The intervals that two sets of intervals share; NaN for none."""
    low = np.maximum(mine[:, :, None, 0], other[:, None, :, 0])
    high = np.minimum(mine[:, :, None, 1], other[:, None, :, 1])
    both = np.where((low < high)[..., None], np.stack([low, high], axis=-1), np.nan)
    shared = both.reshape(len(mine), low.shape[1] * low.shape[2], 2)
    return shared[:, ~np.isnan(shared[..., 0]).all(axis=0)]
