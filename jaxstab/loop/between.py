"""All loops between two: walls that each of them renders stably, proved."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial, reduce
from itertools import product
from math import nan, pi
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Numbers
from jaxstab.conventions import Verdict
from jaxstab.loop.loop import HapticLoop
from jaxstab.loop.region import TOLERANCE, Gains, WallRegion, wall_region
from jaxstab.model import Device, Hand, LoopParameters, checked_gain
from jaxstab.model.device.family import LoopFamily, merged, value_at
from jaxstab.model.device.parts import MassSpringDamper, Modes
from jaxstab.numbers import checked_number
from jaxstab.proofs import exclusion as bisection
from jaxstab.proofs.device_boxes import AXES, BEYOND, DELAY, MASS, Boxes, DeviceBoxes, Extent, along
from jaxstab.ranges import RobustLimit, WorstHand
from jaxstab.ranges.families import failures, family_verdicts, first_roots
from jaxstab.ranges.hands import HandRange, Hands, Range, checked_range, spread_hands
from jaxstab.ranges.robust import RobustStatus, polygon_of_rows, pulled_in
from jaxstab.region import RegionStatus

# Hands of a range, and masses of a general device, at which a wall could not be proved.
#
# Boxes of the device's mass, the hand and the angle are halved until none has a root on the unit
# circle (``proofs.device_boxes``). Then all of these loops have the same number of unstable roots,
# and one proof of stability is enough (lemma B21 of docs/proofs.md).

_SMALLEST = 2.0**-16  # of the ranges: boxes are not halved beyond

_MOST = 40_000  # boxes at once

_ROUNDED_UP = 1.0 + 1e-9


def unproved_hands(
    device: Device,
    loop: LoopParameters,
    hands: HandRange,
    mass: Range,
    wall: tuple[float, float],
    most: int = _MOST,
) -> Hands:
    """Return hands at which a root on the circle could not be excluded; none is a proof.

    Args:
        device: the device; its mass and its arm are not used.
        loop: its loop.
        hands: the range of hands.
        mass: the lowest and the highest mass of the device.
        wall: K in N/m and B in N s/m.
        most: boxes at once; where there are more, the proof is given up.

    Raises:
        NotImplementedError: as ``proofs.device_boxes.DeviceBoxes``.
    """
    delay = float(loop.delay_samples)

    def extent(center: Boxes, half: Boxes) -> Extent:
        own, by_own = center[MASS], half[MASS] * _ROUNDED_UP
        fixed = np.ones_like(own), np.zeros_like(own)
        values = (delay, *wall)
        numbers = (along(DELAY, value * fixed[0], fixed[1]) for value in values)
        return Extent(along(MASS, own, by_own), *numbers)

    arm = hands.stiffness[1], hands.damping[0]
    loops = DeviceBoxes(device, loop, mass, arm, extent)

    def prove(boxes: bisection.Boxes) -> bisection.Proof:
        free, shares = loops.judged(boxes.center.T, boxes.half.T)
        return bisection.Proof(free, shares.T)

    low, high = np.zeros((2, AXES))
    low[MASS], high[MASS] = mass
    low[3:6], high[3:6] = np.transpose([hands.mass, hands.stiffness, hands.damping])
    high[6] = pi * (1.0 + BEYOND)
    half = 0.5 * (high - low)
    all_hands = bisection.Boxes((low + half)[None], half[None])
    left = bisection.pave_by(all_hands, _SMALLEST * half, prove, most).boxes.center
    return np.clip(left, low, high)[:, [3, 4, 5, MASS]]


_TRIED, _FINER = 17, 4  # loops of which the worst is looked for, and rounds around it

Wall = tuple[float, float]


class WorstLoop(NamedTuple):
    """What is known of a wall for all loops between two, and the worst of those tried.

    Attributes:
        verdict: STABLE is proved for every loop between the two, UNSTABLE for ``loop``.
        loop: the loop of the largest spectral radius of those that were tried.
        share: where it is on the way from the first loop (0) to the last (1).
        radius: its spectral radius.

    Example:
        >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
        >>> worst = jaxstab.LoopsBetween(light, heavy).worst_loop(10_000.0, 20.0)
        >>> worst.verdict.name, worst.share
        ('STABLE', 1.0)
    """

    verdict: Verdict
    loop: HapticLoop
    share: float
    radius: float


@dataclass(frozen=True)
class LoopsBetween:
    """All loops between two that differ in numbers alone, such as one mass or one cut-off.

    Each number that differs runs straight from its value in the first loop to that in the last, all
    of them together: an interval of one parameter, or a line through the space of several, and not
    the box of all their combinations. Whatever a device, a hand, its grip, an actuator, a low pass
    and a delay are made of may differ; the sampling period, windows, orders, state spaces and
    transfer functions in z may not. ``jaxstab.common_region`` takes it in place of a list.

    What is proved holds for every loop between the two, both included, the numbers being exact and
    constant while the wall is touched: a delay that moves within the interval is not covered. A
    filter whose cut-off differs has the exact coefficients that belong to each cut-off, and a part
    of the device that the position does not show for one of the values counts as part of the loop.

    Args:
        first: a loop of concrete numbers.
        last: another one of the same sampling period and of the same parts.

    Raises:
        TypeError: one of them is no HapticLoop, or JAX traces it.
        ValueError: they differ in more than numbers.

    Source: sec. VIII of Hulin, Preusche, Hirzinger (2008) for ranges of hands; lemma B17 of
    docs/proofs.md.

    Example:
        >>> from dataclasses import replace
        >>> mode = jaxstab.Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)
        >>> soft = jaxstab.Device.modes([mode], mass=0.25, damping=0.1)
        >>> other = replace(mode, frequency=90.0)
        >>> stiff = jaxstab.Device.modes([other], mass=0.25, damping=0.1)
        >>> ends = [jaxstab.HapticLoop(device=one, sample_time=1e-3) for one in (soft, stiff)]
        >>> jaxstab.Verdict(jaxstab.LoopsBetween(*ends).verdict(1000.0, 1.0)).name
        'STABLE'
    """

    first: HapticLoop
    last: HapticLoop

    def __post_init__(self) -> None:
        for name in ("first", "last"):
            if not isinstance(getattr(self, name), HapticLoop):
                raise TypeError(f"{name} is {getattr(self, name)!r}; give a jaxstab.HapticLoop.")
            object.__setattr__(self, name, getattr(self, name).in_floats())
        _ = self.family, self._merged

    @cached_property
    def family(self) -> LoopFamily:
        """The mathematics of it."""
        return LoopFamily.between(self.first, self.last)

    @cached_property
    def _merged(self) -> dict[str, Any]:
        return {
            one.name: merged(getattr(self.first, one.name), getattr(self.last, one.name))
            for one in fields(self.first)
        }

    def loop(self, share: float) -> HapticLoop:
        """Return the loop that a share of the way is between the two, its numbers rounded.

        Args:
            share: 0 for the first loop, 1 for the last.

        Raises:
            TypeError: the share is no number.
            ValueError: it is not in [0, 1].

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> jaxstab.LoopsBetween(light, heavy).loop(0.25).device_mass
            0.125
        """
        share = checked_number("share", share, 0.0, 1.0)
        return HapticLoop(**{name: value_at(one, share) for name, one in self._merged.items()})

    def verdict(self, stiffness: Numbers, damping: Numbers) -> Int8[np.ndarray, "*grid"]:
        """Return proved codes of ``Verdict`` for walls and all of the loops.

        Args:
            stiffness, damping: see ``jaxstab.conventions``.

        Returns:
            STABLE where a wall is proved stable in every loop between the two, UNSTABLE where one
            of them is proved to have a root on the unit circle or outside, UNDECIDED else.

        Raises:
            ValueError: a gain is infinite or NaN.

        Source: lemmas B4, B5 and B17 of docs/proofs.md.

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> jaxstab.LoopsBetween(light, heavy).verdict([1e4, 1e5], 20.0).tolist()
            [1, 2]
        """
        gains = (checked_gain("stiffness", stiffness), checked_gain("damping", damping))
        grid = np.stack(np.broadcast_arrays(*(np.asarray(g, np.float64) for g in gains)), axis=-1)
        return family_verdicts(self.family, grid.reshape(-1, 2)).reshape(grid.shape[:-1])

    def worst_loop(self, stiffness: float, damping: float) -> WorstLoop:
        """Return whether a wall is stable in all of the loops, and the worst that was found.

        Args:
            stiffness, damping: see ``jaxstab.conventions``.

        Returns:
            WorstLoop; UNDECIDED where all loops that were tried are stable, but not all others
            could be proved.

        Raises:
            TypeError: a gain is not one real number.
            ValueError: a gain is infinite or NaN.

        Source: lemmas B4, B5 and B17 of docs/proofs.md.

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> worst = jaxstab.LoopsBetween(light, heavy).worst_loop(1e5, 20.0)
            >>> worst.verdict.name, round(worst.loop.device_mass, 3)
            ('UNSTABLE', 0.1)
        """
        wall = (checked_number("stiffness", stiffness), checked_number("damping", damping))
        radii: dict[float, float] = {}
        self._try(radii, np.linspace(0.0, 1.0, _TRIED), wall)
        for _ in range(_FINER):
            shares = sorted(radii)
            best = max(range(len(shares)), key=lambda number: radii[shares[number]])
            low, high = shares[max(best - 1, 0)], shares[min(best + 1, len(shares) - 1)]
            self._try(radii, np.linspace(low, high, 5)[1:-1], wall)
        code = int(self.verdict(*wall))
        if code == Verdict.UNSTABLE and max(radii.values()) < 1.0:
            roots = first_roots(self.family, np.array([wall]))
            if roots is not None:
                after = roots.low[0] + np.append(0.0, 2.0 ** -np.arange(4.0, 40.0))
                self._try(radii, after[after <= 1.0], wall)
        share = max(radii, key=lambda share: radii[share])
        loop = self.loop(share)
        if code != Verdict.STABLE:
            own = int(loop.verdict(*wall))
            code = own if own == Verdict.UNSTABLE else Verdict.UNDECIDED
        return WorstLoop(Verdict(code), loop, share, radii[share])

    def robust_limit(self) -> RobustLimit:
        """Return the largest stiffness, and its damping, that all of the loops allow.

        Returns:
            RobustLimit: with ``is_proved`` the wall is proved stable in every loop between the two.
            Its ``limit`` is that of the exact regions of the loops that were tried: computed, and
            no proof.

        Source: sec. VIII of Hulin, Preusche, Hirzinger (2008); lemma B17 of docs/proofs.md.

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> found = jaxstab.LoopsBetween(light, heavy).robust_limit()
            >>> found.is_proved, round(found.limit)
            (True, 70643)
        """
        return robust_limit(self)

    def _try(
        self, radii: dict[float, float], shares: Float64[np.ndarray, " share"], wall: Wall
    ) -> None:
        """Add the spectral radii of loops that have none yet."""
        for share in map(float, shares):
            if share not in radii:
                radii[share] = float(self.loop(share).spectral_radius(*wall).value)


# Walls that several stable regions share, by rows of the damping.
_ROWS = 33

_ZOOMS = 5

Key = TypeVar("Key")

Points = Float64[np.ndarray, "vertex 2"]

Rows = Float64[np.ndarray, " row"]

Intervals = Float64[np.ndarray, "row _ 2"]


def common_walls(regions: Sequence[WallRegion], count: int = _ROWS) -> Points:
    """Return a polygon of walls that all regions have, by rows; no point where no row has one.

    Of several intervals of a row it is the widest. What lies between two rows may be missed, and of
    the polygon nothing is proved.

    Args:
        regions: at least one, none of them empty.
        count: of rows.
    """
    low, high = common_rows(regions)
    if not low < high:
        return np.zeros((0, 2))
    return polygon_of_rows(partial(common_limits, regions), low, high, count)


def stiffest_wall(regions: Sequence[WallRegion]) -> Gains | None:
    """Return the largest stiffness that regions share, none of them empty, and its damping."""
    low, high = common_rows(regions)
    best: Gains | None = None
    for _ in range(_ZOOMS):
        if not low < high:
            break
        rows = np.linspace(low, high, _ROWS + 2)[1:-1]
        left, right = common_limits(regions, rows)
        right = np.where(left < right, right, -np.inf)
        number = int(np.argmax(right))
        if right[number] == -np.inf:
            break
        if best is None or right[number] >= best.stiffness:
            best = Gains(float(right[number]), float(rows[number]))
        step = rows[1] - rows[0]
        low, high = rows[number] - step, rows[number] + step
    return best


def setter_of(regions: Mapping[Key, WallRegion], damping: float) -> Key:
    """Return which of some regions allows least at a damping."""
    row = np.array([damping])
    tops = {key: region.stiffness_limits(row)[0, 1] for key, region in regions.items()}
    return min(tops, key=lambda key: tops[key])


def common_rows(regions: Sequence[WallRegion]) -> tuple[float, float]:
    """Return the dampings between which all regions may have a wall."""
    tops = [region.outline[:, 1] for region in regions]
    return max(top.min() for top in tops), min(top.max() for top in tops)


def common_limits(regions: Sequence[WallRegion], rows: Rows) -> tuple[Rows, Rows]:
    """Return the ends of the widest interval of stiffness that all regions have in each row."""
    shared = reduce(_shared, (region.stiffness_intervals(rows) for region in regions))
    if not shared.shape[1]:
        return np.full(len(rows), np.inf), np.full(len(rows), -np.inf)
    shared = np.where(np.isnan(shared), [np.inf, -np.inf], shared)
    widest = np.argmax(shared[..., 1] - shared[..., 0], axis=1)
    left, right = shared[np.arange(len(rows)), widest].T
    return left, right


def _shared(one: Intervals, other: Intervals) -> Intervals:
    """Return the intervals that two sets of intervals share; NaN for none."""
    low = np.maximum(one[:, :, None, 0], other[:, None, :, 0])
    high = np.minimum(one[:, :, None, 1], other[:, None, :, 1])
    both = np.where((low < high)[..., None], np.stack([low, high], axis=-1), np.nan)
    shared = both.reshape(len(one), low.shape[1] * low.shape[2], 2)
    return shared[:, ~np.isnan(shared[..., 0]).all(axis=0)]


# Walls that all loops between two allow: guessed by some of them, and proved for all.
#
# The intersection of the regions of some loops is too large. Where the proof of a wall, or of a
# polygon, fails, the loop half way between the two next to it joins, and it is tried again.
if TYPE_CHECKING:
    from jaxstab.loop.between import LoopsBetween
    from jaxstab.loop.loop import HapticLoop

WIDER = (1.0, 2.0, 4.0)  # times the tolerance, by which a polygon is pulled in

_FIRST = (0.0, 0.25, 0.5, 0.75, 1.0)

_CLOSEST = 2.0**-10  # of the way: there is no loop tried between two that are so close

_ATTEMPTS = 24

_AT_ONCE = 3  # loops that are added

_PULLS = (0.01, 0.02, 0.04, 0.08)  # of the limit: the wall that is proved lies so far below

Shares = Float64[np.ndarray, " share"]


class TriedLoops:
    """Loops between two that are tried, with the walls that small gains lead to in each."""

    def __init__(self, between: "LoopsBetween") -> None:
        self.between = between
        self.shares: list[float] = []
        self.regions: dict[float, WallRegion] = {}
        for share in _FIRST:
            self._add(share)

    @property
    def is_empty(self) -> bool:
        """Whether one of the loops has no stable wall."""
        return any(region.is_empty for region in self.regions.values())

    @property
    def loops(self) -> "tuple[HapticLoop, ...]":
        """The loops, from the first on."""
        return tuple(self.between.loop(share) for share in self.shares)

    def refine(self, failed: Shares) -> bool:
        """Add loops where a proof failed; return whether there are any."""
        last = len(self.shares) - 1
        numbers = np.clip(np.searchsorted(self.shares, failed, "right"), 1, last)
        numbers, counts = np.unique(numbers, return_counts=True)
        pairs = [
            (self.shares[number - 1], self.shares[number])
            for number in numbers[np.argsort(-counts, kind="stable")]
        ]
        pairs = [(low, high) for low, high in pairs if high - low > _CLOSEST][:_AT_ONCE]
        for low, high in pairs:
            self._add(0.5 * (low + high))
        return bool(pairs)

    def _add(self, share: float) -> None:
        self.shares = sorted([*self.shares, share])
        region = wall_region(self.between.loop(share), TOLERANCE)
        if region.status != RegionStatus.UNRESOLVED:  # the proof covers this loop, too
            self.regions[share] = region if region.is_empty else region.main or region.components[0]


def robust_limit(between: "LoopsBetween") -> RobustLimit:
    """Return the stiffest wall that all loops between two allow: ``LoopsBetween``."""
    tried, pulls = TriedLoops(between), list(_PULLS)
    found = RobustLimit(np.nan, np.nan, False, np.nan, between.first)
    for _ in range(_ATTEMPTS):
        if not tried.regions or tried.is_empty:
            break
        top = stiffest_wall([*tried.regions.values()])
        if top is None:
            break
        stiffness = top.stiffness - pulls[0] * abs(top.stiffness)
        setter = between.loop(setter_of(tried.regions, top.damping))
        found = RobustLimit(stiffness, top.damping, False, top.stiffness, setter)
        wall = np.array([[stiffness, top.damping]])
        roots = first_roots(between.family, wall)
        if roots is None:
            break
        if np.isinf(roots.low[0]):
            is_stable = bool(between.first.verdict(*wall[0]) == Verdict.STABLE)
            return found._replace(is_proved=is_stable)
        if not tried.refine(roots.low):
            pulls.pop(0)
            if not pulls:
                break
    return found


def common_outline(tried: TriedLoops, tolerance: float) -> tuple[RobustStatus, Points, float]:
    """Return a polygon that is proved for all loops between two, and by how much it is pulled in.

    Args:
        tried: the first loops, to which others are added.
        tolerance: by which part of its size it is pulled in at first.
    """
    family, nothing = tried.between.family, np.zeros((0, 2))
    pulls = [times * tolerance for times in WIDER]
    for _ in range(_ATTEMPTS):
        if not tried.regions:
            break
        outer = nothing if tried.is_empty else common_walls([*tried.regions.values()])
        if not len(outer):
            return RobustStatus.EMPTY, nothing, tolerance
        outline = pulled_in(outer, pulls[0])
        roots = first_roots(family, outline)
        failed = None if roots is None else roots.low[np.isfinite(roots.low)]
        if failed is not None and not failed.size:
            failed = failures(family, outline)
        if failed is None:
            break
        if not failed.size:
            return RobustStatus.PROVED, outline, pulls[0]
        if not tried.refine(failed):
            pulls.pop(0)
            if not pulls:
                break
    return RobustStatus.UNPROVED, nothing, tolerance


# A loop with any device, held by all hands of a range, its device of any mass of another one.
#
# Some hands are tried, and all others are proved in boxes (``unproved_hands``). Devices of
# which boxes know nothing are proved where one number varies, as the loops between two.
if TYPE_CHECKING:
    from jaxstab.loop.loop import HapticLoop

_VALUES = 3  # values of each number that varies

_MOST_TRIED = 64  # hands of those that could not be proved

_HAND_ATTEMPTS = 12


@dataclass(frozen=True)
class LoopsWithHands:
    """A loop with its device and all hands of a range, in place of the hand that it has.

    A grip stays.

    Args:
        loop: the loop, with its device.
        device: the device.
        hands: the range of hands.
        mass: the lowest and the highest mass of the device in kg; None for its own.

    Raises:
        TypeError: ``hands`` is no range of hands.
        ValueError: a range is out of order, the device has several hands, or no mass that could
            vary.
    """

    loop: "HapticLoop"
    device: Device
    hands: HandRange
    mass: Range | None = None

    def __post_init__(self) -> None:
        checked_range(self.hands, self.mass)
        if len(self.device.hands) > 1:
            raise ValueError(
                f"the device ({self.device}) is held by {len(self.device.hands)} hands; give one "
                "that has a single hand, in place of which those of the range hold it."
            )
        if self.mass is not None and self._own_mass is None:
            raise ValueError(
                f"mass is {self.mass}, but the device ({self.device}) has none that could vary; "
                "leave it out."
            )

    def worst(self, stiffness: float, damping: float) -> WorstHand:
        """Return whether a wall is stable for all of them, and the worst that was found."""
        wall = stiffness, damping
        worst = _worst_of([self._held(row) for row in self._spread(_VALUES)], wall)
        if worst.verdict != Verdict.STABLE:
            return worst
        left = self._unproved(wall)
        if left is None:
            if self._between is None:
                return worst._replace(verdict=Verdict.UNDECIDED)
            code, loop, _, radius = self._between.worst_loop(*wall)
            return WorstHand(code, loop, radius)
        if not len(left):
            return worst  # one verdict holds for all
        count = min(len(left), _MOST_TRIED)
        some = left[np.arange(count) * len(left) // count]
        found = _worst_of([self._held(row) for row in some], wall)
        is_known = found.verdict == Verdict.UNSTABLE
        return found if is_known else worst._replace(verdict=Verdict.UNDECIDED)

    def robust_limit(self) -> RobustLimit:
        """Return the stiffest wall that all of them allow: ``HapticLoop.robust_limit``."""
        loops = [self._held(row) for row in self._spread(2)]
        found, pulls = RobustLimit(nan, nan, False, nan, loops[0]), list(_PULLS)
        regions: dict[HapticLoop, WallRegion] = {}
        for _ in range(_HAND_ATTEMPTS):
            regions |= {loop: _reachable(loop) for loop in loops if loop not in regions}
            known = {
                loop: region
                for loop, region in regions.items()
                if region.status != RegionStatus.UNRESOLVED  # the proof covers this loop, too
            }
            is_empty = not known or any(region.is_empty for region in known.values())
            top = None if is_empty else stiffest_wall([*known.values()])
            if top is None:
                break
            stiffness = top.stiffness - pulls[0] * abs(top.stiffness)
            setter = setter_of(known, top.damping)
            found = RobustLimit(stiffness, top.damping, False, top.stiffness, setter)
            worst = self.worst(stiffness, top.damping)
            if worst.verdict == Verdict.STABLE:
                return found._replace(is_proved=True)
            if worst.loop in regions:
                pulls.pop(0)
                if not pulls:
                    break
            loops.append(worst.loop)
        return found

    @cached_property
    def _between(self) -> LoopsBetween | None:
        """The loops between two that these are; None where more than one number varies."""
        ends = [self.hands.mass, self.hands.stiffness, self.hands.damping, self._masses]
        if sum(low < high for low, high in ends) > 1:
            return None
        return LoopsBetween(*(self._held(row) for row in np.transpose(ends)))

    @property
    def _own_mass(self) -> float | None:
        body = self.device.mechanism
        return body.mass if isinstance(body, MassSpringDamper | Modes) else None

    @property
    def _masses(self) -> Range:
        own = self._own_mass or nan
        return self.mass or (own, own)

    def _spread(self, count: int) -> Hands:
        low, high = self._masses
        masses = np.linspace(low, high, count if low < high else 1).tolist()
        hands = spread_hands(self.hands, count).tolist()
        return np.array([(*hand, mass) for hand, mass in product(hands, masses)])

    def _held(self, row: np.ndarray) -> "HapticLoop":
        """Return the loop with a hand, and with a mass of the device."""
        mass, stiffness, damping, own = row.tolist()
        hand = Hand.mass_spring_damper(mass, damping=damping, stiffness=stiffness)
        grip = self.device.hands[0].grip if self.device.hands else None
        body = self.device.mechanism
        moved = body if self.mass is None else replace(body, mass=own)
        free = replace(self.device, mechanism=moved, hands=())
        return replace(self.loop, device=free.held_by(replace(hand, grip=grip)))

    def _unproved(self, wall: tuple[float, float]) -> Hands | None:
        """Return hands that are not proved; None where boxes know nothing of such a device."""
        device = self._held(self._spread(1)[0]).device
        assert device is not None
        try:
            return unproved_hands(device, self.loop, self.hands, self._masses, wall)
        except NotImplementedError:
            return None


def _worst_of(loops: "list[HapticLoop]", wall: tuple[float, float]) -> WorstHand:
    """Return the verdict on a wall in the loop of the largest radius; of unstable ones, if any."""
    codes = np.array([loop.verdict(*wall) for loop in loops])
    poles = [np.abs(np.asarray(loop.poles(*wall))).max() for loop in loops]
    unstable = codes == Verdict.UNSTABLE
    number = int(np.argmax(np.where(unstable | ~unstable.any(), poles, -1.0)))
    loop = loops[number]
    radius = float(loop.spectral_radius(*wall).value)
    return WorstHand(Verdict(int(codes[number])), loop, radius)


def _reachable(loop: "HapticLoop") -> WallRegion:
    """Return the walls that small gains lead to, if there are any."""
    region = wall_region(loop, TOLERANCE)
    if region.status == RegionStatus.UNRESOLVED or region.is_empty:
        return region
    return region.main or region.components[0]
