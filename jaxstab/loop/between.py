"""All loops between two: walls that each of them renders stably, proved."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial, reduce
from itertools import product
from math import inf, isfinite, nan, pi
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8, Int64

from jaxstab.arrays import Numbers, joined
from jaxstab.conventions import Verdict
from jaxstab.loop.jitter import MovingLoop
from jaxstab.loop.region import TOLERANCE, WallRegion, wall_region
from jaxstab.model import Device, LoopParameters
from jaxstab.model.device.family import LoopFamily, merged, value_at
from jaxstab.model.device.parts import MassSpringDamper, Modes
from jaxstab.model.parameters import wall_grid
from jaxstab.numbers import checked_number
from jaxstab.point.verdicts import linear_verdict
from jaxstab.proofs.device_boxes import (
    BEYOND,
    DELAY,
    MASS,
    Arms,
    Boxes,
    DeviceBoxes,
    Extent,
    along,
    with_parts,
)
from jaxstab.proofs.exclusion import FirstRoots, LineBoxes, Models, is_free
from jaxstab.proofs.exclusion import search as search_roots
from jaxstab.proofs.linear_circle import (
    FamilyBoxes,
    FamilyCells,
    PieceBoxes,
    family_cells,
    family_models,
)
from jaxstab.ranges import RobustLimit, WorstHand
from jaxstab.ranges.box import (
    NOTHING,
    PULLS,
    Guess,
    ParameterBox,
    Points,
    Proof,
    limit_for_hands,
    limit_of,
    paved_device,
    search,
    verdicts_of_range,
    worst_of_range,
)
from jaxstab.ranges.hands import HandRange, Hands, Range, checked_range, spread_hands
from jaxstab.ranges.robust import polygon_of_rows, pulled_in
from jaxstab.region import RegionStatus
from jaxstab.rounding import RAISED_FEW, RAISED_MUCH

if TYPE_CHECKING:
    from jaxstab.loop.loop import HapticLoop

_TRIED, _FINER = 17, 4  # loops of which the worst is looked for, and rounds around it

Wall = tuple[float, float]


class WorstLoop(NamedTuple):
    """The verdict on a wall for all loops between two, and the worst of those tried.

    Attributes:
        verdict: STABLE is proved for every loop between the two, UNSTABLE for ``loop``.
        loop: the loop of the largest spectral radius of those that were tried.
        share: its position between the first loop (0) and the last (1).
        radius: its spectral radius.

    Example:
        >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
        >>> worst = jaxstab.LoopsBetween(light, heavy).worst_loop(10_000.0, 20.0)
        >>> worst.verdict.name, worst.share
        ('STABLE', 1.0)
    """

    verdict: Verdict
    loop: "HapticLoop"
    share: float
    radius: float


@dataclass(frozen=True)
class LoopsBetween:
    """All loops between two that differ in numbers alone, such as one mass or one cut-off.

    Each number that differs runs straight from its value in the first loop to that in the last, all
    of them together: an interval of one parameter, or a line through the space of several, and not
    the box of all their combinations. Any number of a device, a hand, its grip, an actuator, a low
    pass and a delay may differ; the sampling period, windows, orders, state spaces and transfer
    functions in z may not. ``jaxstab.common_region`` takes it in place of a list.

    A proof holds for every loop between the two, both included, the numbers being exact and
    constant while the wall is touched: a delay that moves within the interval is not covered. A
    filter whose cut-off differs has the exact coefficients that belong to each cut-off, and a part
    of the device that the position does not show for one of the values counts as part of the loop.

    Args:
        first: a loop of concrete numbers.
        last: another one of the same sampling period and of the same parts.

    Raises: TypeError if one of them is not a HapticLoop, or JAX traces it; ValueError if they
    differ in more than numbers.

    Source: sec. VIII of Hulin, Preusche, Hirzinger (2008) for ranges of hands; lemmas B4, B5 and
    B17 of docs/proofs.md.

    Example:
        >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
        >>> loops = jaxstab.LoopsBetween(light, heavy)
        >>> loops.loop(0.25).device_mass, loops.verdict([1e4, 1e5], 20.0).tolist()
        (0.125, [1, 2])
        >>> worst = loops.worst_loop(1e5, 20.0)
        >>> worst.verdict.name, round(worst.loop.device_mass, 3)
        ('UNSTABLE', 0.1)
        >>> limit = loops.robust_limit()
        >>> limit.is_proved, round(limit.limit)
        (True, 70643)
    """

    first: "HapticLoop"
    last: "HapticLoop"

    def __post_init__(self) -> None:
        for name in ("first", "last"):
            if not isinstance(getattr(self, name), LoopParameters):
                raise TypeError(f"{name} is {getattr(self, name)!r}; give a jaxstab.HapticLoop.")
            object.__setattr__(self, name, getattr(self, name).in_floats())
        _ = self.family, self._merged

    @cached_property
    def family(self) -> LoopFamily:
        """The loops as functions of the share."""
        return LoopFamily.between(self.first, self.last)

    @cached_property
    def _merged(self) -> dict[str, Any]:
        return {
            field.name: merged(getattr(self.first, field.name), getattr(self.last, field.name))
            for field in fields(self.first)
        }

    def loop(self, share: float) -> "HapticLoop":
        """The loop at a share in [0, 1] of the way between the two, its numbers rounded.

        Raises: see ``jaxstab.conventions``.
        """
        share = checked_number("share", share, 0.0, 1.0)
        numbers = {name: value_at(pair, share) for name, pair in self._merged.items()}
        return replace(self.first, **numbers)

    def verdict(self, stiffness: Numbers, damping: Numbers) -> Int8[np.ndarray, "*grid"]:
        """Proved codes of ``Verdict`` for walls and all of the loops.

        Args and Raises: see ``jaxstab.conventions``.

        Returns:
            STABLE where a wall is proved stable in every loop between the two, UNSTABLE where one
            of them is proved to have a root on the unit circle or outside, UNDECIDED elsewhere.
        """
        grid = wall_grid(stiffness=stiffness, damping=damping)
        return family_verdicts(self.family, grid.reshape(-1, 2)).reshape(grid.shape[:-1])

    def worst_loop(self, stiffness: float, damping: float) -> WorstLoop:
        """Whether a wall is stable in all of the loops, and the worst of those tried.

        UNDECIDED where all loops that were tried are stable, but not all others could be proved.

        Args and Raises: see ``jaxstab.conventions``; the gains are single numbers.
        """
        wall = (checked_number("stiffness", stiffness), checked_number("damping", damping))
        radii: dict[float, float] = {}

        def judge(shares: Shares) -> WorstLoop:
            """The worst of the loops at shares and of all that were tried before."""
            for share in map(float, shares):
                if share not in radii:
                    radii[share] = float(self.loop(share).spectral_radius(*wall).value)
            share = max(radii, key=lambda share: radii[share])
            loop = self.loop(share)
            return WorstLoop(Verdict(int(loop.verdict(*wall))), loop, share, radii[share])

        def unproved(numbers: list[int]) -> dict[int, Shares]:
            """Shares next to the first one at which a root may be on the circle."""
            roots = first_roots(self.family, np.array([wall] * len(numbers)).reshape(-1, 2))
            if roots is None:
                return {index: np.zeros(0) for index in numbers}
            after = roots.low[:, None] + np.append(0.0, 2.0 ** -np.arange(4.0, 40.0))
            return {
                n: row[row <= 1.0] for n, row in zip(numbers, after, strict=True) if row[0] < inf
            }

        worst = judge(np.linspace(0.0, 1.0, _TRIED))
        for _ in range(_FINER):
            shares = sorted(radii)
            index = shares.index(worst.share)
            low, high = shares[max(index - 1, 0)], shares[min(index + 1, len(shares) - 1)]
            worst = judge(np.linspace(low, high, 5)[1:-1])
        return worst_of_range([worst], unproved, lambda _, shares: judge(shares), _MOST_TRIED)[0]

    def robust_limit(self) -> RobustLimit:
        """The largest stiffness, and its damping, that all of the loops allow.

        With ``is_proved`` the wall is proved stable in every loop between the two. ``limit`` is
        that of the exact regions of the loops that were tried: computed, not proved.
        """
        tried = TriedLoops(self)
        found = search(partial(stiffest_wall, tried.loops), tried.unproved, tried.add, PULLS)
        return limit_of(found, self.first)


# Walls that several sampled loops share, by rows of the damping (``ranges.box``).
_ROWS, _ZOOMS = 33, 5

Rows = Float64[np.ndarray, " row"]
Intervals = Float64[np.ndarray, "row _ 2"]


def walls_of(loops: "Sequence[HapticLoop]") -> "dict[HapticLoop, WallRegion]":
    """The stable walls of loops: the component that contains small gains, if there is one.

    Regions that are UNRESOLVED are left out; a proof for the range covers these loops, too.
    """
    regions = {loop: wall_region(loop.in_floats(), TOLERANCE) for loop in loops}
    return {
        loop: region if region.is_empty else region.main or region.components[0]
        for loop, region in regions.items()
        if region.status != RegionStatus.UNRESOLVED
    }


def common_polygon(loops: "Sequence[HapticLoop]", pull: float) -> Guess | None:
    """A polygon of walls that all of the loops have, pulled in by a share of its size."""
    regions = walls_of(loops).values()
    if not regions:
        return None
    if any(region.is_empty for region in regions):
        return NOTHING
    return Guess(pulled_in(common_walls([*regions]), pull))


def common_walls(regions: Sequence[WallRegion], count: int = _ROWS) -> Points:
    """A polygon of walls that all regions have, by rows; no point where no row has one.

    Of several intervals of a row it takes the widest. Walls between two rows may be missed, and
    nothing is proved of the polygon. No region may be empty.
    """
    low, high = common_rows(regions)
    if not low < high:
        return np.zeros((0, 2))
    return polygon_of_rows(partial(common_limits, regions), low, high, count)


def stiffest_wall(loops: "Sequence[HapticLoop]", pull: float) -> Guess | None:
    """The stiffest wall with B >= 0 that all loops have, pulled down by a share of it."""
    regions = walls_of(loops)
    if not regions:
        return None
    if any(region.is_empty for region in regions.values()):
        return NOTHING
    low, high = common_rows([*regions.values()])
    low = max(low, 0.0)
    wall: tuple[float, float, float] | None = None  # both ends of the stiffness, and the damping
    for _ in range(_ZOOMS):
        if not low < high:
            break
        rows = np.linspace(low, high, _ROWS + 2)[1:-1]
        left, right = common_limits([*regions.values()], rows)
        right = np.where((left < right) & (right > 0.0), right, -np.inf)
        best = int(np.argmax(right))
        if right[best] == -np.inf:
            break
        if wall is None or right[best] >= wall[1]:
            wall = float(left[best]), float(right[best]), float(rows[best])
        step = rows[1] - rows[0]
        low, high = rows[best] - step, rows[best] + step
    if wall is None:
        return NOTHING
    least, limit, damping = wall
    stiffness = max(limit - pull * abs(limit), 0.5 * (least + limit))
    row = np.array([damping])
    tops = {loop: region.stiffness_limits(row)[0, 1] for loop, region in regions.items()}
    return Guess(np.array([[stiffness, damping]]), limit, min(tops, key=lambda loop: tops[loop]))


def common_rows(regions: Sequence[WallRegion]) -> tuple[float, float]:
    """The dampings between which all regions may have a wall."""
    tops = [region.outline[:, 1] for region in regions]
    return max(top.min() for top in tops), min(top.max() for top in tops)


def common_limits(regions: Sequence[WallRegion], rows: Rows) -> tuple[Rows, Rows]:
    """The ends of the widest interval of stiffness that all regions have in each row."""
    shared = reduce(_shared, (region.stiffness_intervals(rows) for region in regions))
    if not shared.shape[1]:
        return np.full(len(rows), np.inf), np.full(len(rows), -np.inf)
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


_FIRST = (0.0, 0.25, 0.5, 0.75, 1.0)
_CLOSEST = 2.0**-10  # of the way: between two loops that are closer no other one is tried
_AT_ONCE = 3  # loops that are added

Shares = Float64[np.ndarray, " share"]


class TriedLoops:
    """The loops between two that are tried: where a proof fails, those half way between join."""

    def __init__(self, between: LoopsBetween) -> None:
        self.between, self.shares = between, [*_FIRST]
        self.loops = [*map(between.loop, self.shares)]

    def unproved(self, walls: Points) -> Shares | None:
        """Shares at which walls could not be proved; None if nothing can be proved."""
        return failures(self.between.family, walls)

    def add(self, shares: Shares) -> bool:
        """Add the loops in the middle of the gaps in which most of the shares are."""
        last = len(self.shares) - 1
        ends = np.clip(np.searchsorted(self.shares, shares, "right"), 1, last)
        ends, counts = np.unique(ends, return_counts=True)
        pairs = [
            (self.shares[end - 1], self.shares[end])
            for end in ends[np.argsort(-counts, kind="stable")]
        ]
        pairs = [(low, high) for low, high in pairs if high - low > _CLOSEST][:_AT_ONCE]
        self.shares = sorted(self.shares + [0.5 * (low + high) for low, high in pairs])
        self.loops[:] = map(self.between.loop, self.shares)
        return bool(pairs)


# A loop with any device, held by all hands of a range, its device of any mass of another one.
#
# Some hands are tried, and all others are proved in boxes (``DeviceBoxes``). Devices that these
# boxes do not cover are proved where one number varies, as the loops between two.

_VALUES = 3  # values of each number that varies
_MOST_TRIED = 64  # loops of those that could not be proved
_LOWERED = (1.0, 0.95, 0.9, 0.8, 0.65, 0.5)  # shares of what one hand allows if the delay moves
_SMALLEST = 2.0**-16  # of the ranges: boxes are not halved beyond
_MARGINS = 7  # halvings of what one hand allows, for a margin of all
_MOST = 40_000  # boxes at once


@dataclass(frozen=True)
class LoopsWithHands:
    """A loop with its device and all hands of a range, in place of its hand; a grip stays.

    ``mass`` is the lowest and the highest mass of the device in kg, None for its own. ``moving``
    has the keywords ``delays`` and ``lost`` of a delay that moves. Errors: as
    ``HapticLoop.worst_hand``.
    """

    loop: "HapticLoop"
    device: Device
    hands: HandRange
    mass: Range | None = None
    moving: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        checked_range(self.hands, self.mass, self.device)
        if len(self.device.hands) > 1:
            raise ValueError(
                f"the device ({self.device}) is held by {len(self.device.hands)} hands; give one "
                "that has a single hand, which the hands of the range replace."
            )
        if self.mass is not None and self._own_mass is None:
            raise ValueError(
                f"mass is {self.mass}, but the device ({self.device}) has none that could vary; "
                "leave it out."
            )

    def worst(self, stiffness: float, damping: float) -> WorstHand:
        """Whether a wall is stable for all of them, and the worst of those tried."""
        wall = stiffness, damping

        def judge(_: int, rows: Hands) -> WorstHand:
            return _worst_of([self._held(row) for row in rows], wall, self.moving)

        def unproved(numbers: list[int]) -> dict[int, Hands]:
            try:
                return {n: left for n in numbers if len(left := self._unproved(wall))}
            except NotImplementedError:  # boxes do not cover such a device
                return {n: np.zeros((0, 4)) for n in numbers}

        sampled = [judge(0, self._spread(_VALUES))]
        (worst,) = worst_of_range(sampled, unproved, judge, _MOST_TRIED)
        if worst.verdict == Verdict.UNDECIDED and not self.moving and self._between is not None:
            code, loop, _, radius = self._between.worst_loop(*wall)
            return WorstHand(code, loop, radius)
        return worst

    def robust_limit(self) -> RobustLimit:
        """The stiffest wall that all of them allow: ``HapticLoop.robust_limit``."""
        loops = [self._held(row) for row in self._spread(2)]
        delays = self.moving.get("delays", (self.loop.delay,))
        at_delays = [replace(loop, delay=delay) for delay in delays for loop in loops]
        limit = limit_for_hands(at_delays, stiffest_wall, self.worst)
        if limit.is_proved or not self.moving:
            return limit
        # Constant delays may allow much more than is proved: what one hand allows comes next.
        wall = loops[0].limits(**self.moving)
        for share in _LOWERED if wall.stiffness > 0.0 else ():
            stiffness = share * wall.stiffness
            worst = self.worst(stiffness, wall.damping)
            if worst.verdict == Verdict.STABLE:
                return RobustLimit(stiffness, wall.damping, True, limit.limit, limit.loop)
        return limit

    def jitter_margin(self, stiffness: float, damping: float) -> float:
        """How far the delay may move for all of them, in s: ``HapticLoop.jitter_margin``."""
        wall, delay = (stiffness, damping), float(self.loop.delay)
        most = float(self._held(self._spread(1)[0]).jitter_margin(*wall))

        def is_proved(share: float) -> bool:
            delays = (delay, delay + share * most if isfinite(most) else delay)
            try:
                return not len(replace(self, moving={"delays": delays})._unproved(wall))
            except NotImplementedError:  # boxes do not cover such a device
                return False

        if most == 0.0 or is_proved(1.0):
            return most
        low, high = 0.0, 1.0
        for _ in range(_MARGINS):
            share = 0.5 * (low + high)
            low, high = (share, high) if is_proved(share) else (low, share)
        return low * most if low > 0.0 else 0.0

    @cached_property
    def _between(self) -> LoopsBetween | None:
        """They as the loops between two; None where more than one number varies."""
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
        *arm, own = row.tolist()
        mass = None if self.mass is None else own
        return replace(self.loop, device=with_parts(self.device, mass, Arms(*arm)))

    def _unproved(self, wall: Wall) -> Hands:
        """Hands, and masses of the device, at which a root on the circle is not excluded."""
        # Boxes of both and of the angle are halved (lemma B21 of docs/proofs.md).
        loop, hands, mass = self.loop, self.hands, self._masses
        device = self._held(self._spread(1)[0]).device
        assert device is not None

        def extent(center: Boxes, half: Boxes) -> Extent:
            own, by_own = center[MASS], half[MASS] * RAISED_MUCH
            fixed = np.ones_like(own), np.zeros_like(own)
            values = (float(loop.delay_samples), *wall)
            numbers = (along(DELAY, value * fixed[0], fixed[1]) for value in values)
            return Extent(along(MASS, own, by_own), *numbers)

        arm = hands.stiffness[1], hands.damping[0]
        jitter = MovingLoop.from_loop(loop, **self.moving).delays.jitter if self.moving else 0.0
        loops = DeviceBoxes(device, loop, mass, arm, extent, jitter=jitter)
        fixed = (0.0, 0.0)  # the delay and the damping of the wall
        ends = mass, fixed, fixed, *vars(hands).values(), (0.0, pi * (1.0 + BEYOND))
        paving = paved_device(loops, np.zeros(1, int), ends, _SMALLEST, most=_MOST)
        return np.clip(paving.boxes.center, *np.transpose(ends))[:, [3, 4, 5, MASS]]


def _worst_of(
    loops: "list[HapticLoop]", wall: tuple[float, float], moving: dict[str, Any]
) -> WorstHand:
    """The verdict on a wall in the loop of the largest radius; of unstable ones, if any.

    That is the radius at the longest delay, if the delay moves.
    """
    codes = np.array([loop.verdict(*wall, **moving) for loop in loops])
    if moving:
        loops = [replace(loop, delay=moving["delays"][1]) for loop in loops]
    poles = [np.abs(np.asarray(loop.poles(*wall))).max() for loop in loops]
    unstable = codes == Verdict.UNSTABLE
    worst = int(np.argmax(np.where(unstable | ~unstable.any(), poles, -1.0)))
    loop = loops[worst]
    radius = float(loop.spectral_radius(*wall).value)
    return WorstHand(Verdict(int(codes[worst])), loop, radius)


# Walls (K, B), and polygons of walls, that are stable in all loops between two, proved.

Walls = Float64[np.ndarray, "wall 2"]

_ANGLES = 64  # boxes at first, for half a turn
_WALLS_AT_ONCE = 64  # walls
_SMALLEST_BOX = np.array([2.0**-12, 2.0**-14, 2.0**-20])  # along the edge, of t, of theta / pi
_MOST_BOXES = 100_000


def first_roots(family: LoopFamily, walls: Walls) -> FirstRoots | None:
    """Where along t a root of walls (K, B) is first on the unit circle (lemmas B4 and B17).

    No root is there where ``low`` is infinite. None for loops that need too many pieces.
    """
    cells = family_cells(family)
    if cells is None:
        return None
    walls = walls * _units(family)
    starts = range(0, max(len(walls), 1), _WALLS_AT_ONCE)
    return joined([_first_roots(cells, walls[i : i + _WALLS_AT_ONCE]) for i in starts])


def _first_roots(cells: FamilyCells, walls: Walls) -> FirstRoots:
    pieces = len(cells.pieces)
    # Roots at 0 and pi are within boxes.
    edges = np.pi * (np.arange(_ANGLES + 2) - 0.5) / _ANGLES
    line, angle = (column.ravel() for column in np.indices((len(walls) * pieces, _ANGLES + 1)))
    ends = cells.ends[line % pieces].T
    boxes = LineBoxes(line, *(np.stack([ends[k], edges[angle + k]]) for k in (0, 1)))
    roots = search_roots(len(walls) * pieces, boxes, partial(_wall_models, cells, walls))
    low, high, theta = (column.reshape(len(walls), pieces) for column in roots)
    nearest = np.argmin(low, axis=1)
    rows = np.arange(len(walls))
    return FirstRoots(low[rows, nearest], high.min(axis=1), theta[rows, nearest])


def _wall_models(cells: FamilyCells, walls: Walls, boxes: LineBoxes) -> Models:
    wall, piece = np.divmod(boxes.line, len(cells.pieces))
    middle, half = 0.5 * (boxes.low + boxes.high), 0.5 * (boxes.high - boxes.low) * RAISED_FEW
    place = PieceBoxes(piece, *middle, *half)
    gains = walls[wall].T
    over = family_models(cells, FamilyBoxes(gains, np.zeros_like(gains), cells.lags[piece], place))
    return over._replace(moves=over.moves[1:], bends=over.bends[1:])


def family_verdicts(family: LoopFamily, walls: Walls) -> Int8[np.ndarray, " wall"]:
    """Codes of ``Verdict`` for walls (K, B) and all loops between two (lemmas B4, B5 and B17).

    STABLE is proved of all loops; UNSTABLE of one: it has a root on the circle or outside.
    """

    def prove(likely: Int64[np.ndarray, " likely"]) -> Int8[np.ndarray, " likely"]:
        codes = np.full(len(likely), Verdict.UNDECIDED, np.int8)
        roots = first_roots(family, walls[likely])
        if roots is not None:
            codes[roots.low == inf] = Verdict.STABLE
            codes[roots.high < inf] = Verdict.UNSTABLE
        return codes

    ends = np.stack([_end_verdicts(family, share, walls) for share in (0, 1)], axis=-1)
    return verdicts_of_range(ends, prove)


def _end_verdicts(family: LoopFamily, share: int, walls: Walls) -> Int8[np.ndarray, " wall"]:
    device, filters = family.end(share)
    alpha, beta = (walls * [device.stiffness_unit, device.damping_unit]).T
    return np.asarray(linear_verdict(alpha, beta, device.loop(filters)))


def failures(family: LoopFamily, outline: Walls) -> Float64[np.ndarray, " t"] | None:
    """Some t at which walls of a closed polygon could not be proved; an empty array is a proof.

    The polygon has vertices (K, B); a single one is one wall. None for loops that need too many
    pieces. Source: lemmas B11 and B17 of docs/proofs.md.
    """
    roots = first_roots(family, outline)
    if roots is None:
        return None
    failed = roots.low[np.isfinite(roots.low)]
    if not failed.size and len(outline) > 1:
        failed = _failures_on_edges(family, outline * _units(family))
    if not failed.size and not np.all(_end_verdicts(family, 0, outline[:1]) == Verdict.STABLE):
        return np.zeros(1)
    return failed


def _failures_on_edges(family: LoopFamily, outline: Walls) -> Float64[np.ndarray, " t"]:
    """Some t at which walls (alpha, beta) of edges could not be proved free of roots."""
    cells = family_cells(family)
    assert cells is not None
    following = np.roll(outline, -1, axis=0)
    middle, half = 0.5 * (outline + following), 0.5 * (following - outline) * RAISED_FEW

    def prove(boxes: ParameterBox) -> Proof:
        shift, t, angle = boxes.center.T
        by_shift, by_t, by_angle = boxes.half.T * RAISED_FEW
        edge, piece = np.divmod(boxes.index, len(cells.pieces))
        place = PieceBoxes(piece, t, pi * angle, by_t, pi * by_angle)
        along = half[edge].T
        walls = middle[edge].T + along * shift, along * by_shift
        over = family_models(cells, FamilyBoxes(*walls, cells.lags[piece], place))
        return Proof(is_free(*over[:3]), over.bends.T)

    index, angle = (
        column.ravel() for column in np.indices((len(outline) * len(cells.pieces), _ANGLES // 4))
    )
    ends = cells.ends[index % len(cells.pieces)].T
    boxes = ParameterBox.from_axes(
        index,
        shift=(0.0, 1.0),
        t=(0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])),
        angle=((angle + 0.5) * 4.0 / _ANGLES, 2.0 / _ANGLES),
    )
    return boxes.paved(prove, _SMALLEST_BOX, most=_MOST_BOXES).boxes["t"][0]


def _units(family: LoopFamily) -> Float64[np.ndarray, " 2"]:
    return np.array([family.first.stiffness_unit, family.first.damping_unit])
