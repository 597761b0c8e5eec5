"""Margins and ranges of hands, at random and hostile loops, against certified roots and balls.

Margins are those of the loops of ``tests.truth.random_loops``: one mass with windows, low
passes, Butterworth filters, exponential smoothing, transfer functions and chains of them, or with a
difference over one sample; devices with modes, grips and motors; delays of 0 to 30 samples with
fractions. Walls lie in all components of the stable set, islands too, half of them next to the
boundary. A margin is ``wrong`` where a wall within it is unstable, and ``short`` where the wall is
stable farther by a millionth of the way and by 1e-9 of the region's size.

Ranges are of hands that hold one mass. A limit is ``wrong`` where the proved wall is unstable for a
hand, or a stiffer one stable for all.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from time import process_time
from typing import NamedTuple

import numpy as np

from benchmarks import eigenvalues, record
from benchmarks.record import Row
from jaxstab import Filter, Velocity
from jaxstab.boxes import HandRange, RobustLimit
from jaxstab.conventions import Verdict
from jaxstab.loop import HapticLoop
from jaxstab.loop.margins import WAYS, crossings_of
from jaxstab.model import by_name, characteristic_polynomial
from jaxstab.model.loop import unit_loops
from jaxstab.results import StableRegion
from tests.truth import loop as truth
from tests.truth.filtered import average, difference
from tests.truth.random_loops import DeviceLoop, Filters, MassLoop

_WALLS, _SMALL_WALLS = 400, 6
_RANGES, _SMALL_RANGES = 400, 2
_PARTS = (0.3, 0.9, 1.0 - 1e-9)  # of the way, judged
_DELAY_PARTS = (0.1, 0.37, 0.71, 0.93, 1.0 - 1e-9)
_FARTHER = 1e-6  # of the way
_SHARE = 1e-9  # of the region's size
_FARTHEST_DELAY = 20.0
_HANDS, _FEW = 200, 6  # of a range, for which a proved wall and many stiffer ones are looked at
_STIFFER = 1.0 + np.geomspace(1e-3, 4.0, 24)
_DAMPINGS = np.linspace(-1.0, 3.0, 81)  # in units of m/T
_CLEAR = 1e-6  # a radius that is as much below 1
_LIKELY = 4  # stiffer walls of a range that are judged

Loop = MassLoop | DeviceLoop

PLAIN = Filters(Velocity.difference(samples=1), Filter(), (difference(1), average(1)))


def rows(small: bool) -> Iterator[Row]:
    rng = np.random.default_rng(20121)
    yield _limits(rng, _SMALL_RANGES if small else _RANGES)
    for name, draw in (("margins", mass_loop), ("margins of devices", DeviceLoop.drawn)):
        tally, seconds = margins(rng, _SMALL_WALLS if small else _WALLS, draw)
        yield _row(name, tally.wrong / max(tally.judged, 1), seconds, **tally._asdict())


# ------------------------------------------------------------------------------------ margins


class Tally(NamedTuple):
    """How many claims were judged, are wrong, and fall short."""

    judged: int = 0
    wrong: int = 0
    short: int = 0

    def __add__(self, other: "Tally") -> "Tally":  # type: ignore[override]
        return Tally(*(a + b for a, b in zip(self, other, strict=True)))


def margins(
    rng: np.random.Generator, count: int, draw: Callable[[np.random.Generator], Loop]
) -> tuple[Tally, list[float]]:
    """Judge the margins of walls of random loops; totals, and CPU seconds of each question."""
    tally, seconds = Tally(), []
    for loop, region in _loops(rng, draw, count):
        wall = _wall(rng, region)
        start = process_time()
        code, *found = _crossings(loop, wall)
        seconds.append(process_time() - start)
        if code == Verdict.STABLE:
            one = loop.loop
            ends = np.array(found[::2]) * [*np.repeat([one.alpha(1.0), one.beta(1.0)], 2), 1.0]
            tally += judged_steps(loop, wall, steps_to(ends, wall), region)
    return tally, seconds


def _crossings(loop: Loop, wall: np.ndarray) -> Sequence[float]:
    """The answer of jaxstab: for arrays of loops of one mass, and for one device in SI."""
    if isinstance(loop, MassLoop):
        made = unit_loops(*loop.filters[:2])(*loop.plant)
        return crossings_of(made, tuple(wall.tolist()))
    return crossings_of(loop.loop, tuple((wall / loop.units).tolist()))


def steps_to(ends: Sequence[float], wall: np.ndarray) -> np.ndarray:
    """The signed steps from a wall (alpha, beta) to the ends of its ways."""
    return np.array(ends) - [*np.repeat(wall[:2], 2), 0.0]


def mass_loop(rng: np.random.Generator) -> MassLoop:
    """A loop of one mass, a third of them without filters."""
    loop = MassLoop.drawn(rng)
    return MassLoop(loop.plant, PLAIN) if rng.random() < 1.0 / 3.0 else loop


def _loops(
    rng: np.random.Generator, draw: Callable[[np.random.Generator], Loop], count: int
) -> Iterator[tuple[Loop, StableRegion]]:
    """Yield random loops that have a region."""
    given = 0
    while given < count:
        loop = draw(rng)
        region = loop.region()
        if region.status.name == "COMPLETE" and len(_finite(region)) > 2:
            given += 1
            yield loop, region


def _finite(region: StableRegion) -> np.ndarray:
    return region.points[np.isfinite(region.points).all(axis=1)]


def _wall(rng: np.random.Generator, region: StableRegion) -> np.ndarray:
    """Return a wall in or near a component, half of the walls next to the boundary."""
    components = region.components
    points = _finite(components[rng.integers(len(components))])
    one, other = points[rng.integers(len(points), size=2)]
    wall: np.ndarray = one + rng.choice([rng.uniform(), 10 ** rng.uniform(-9, -1)]) * (other - one)
    return wall


def judged_steps(loop: Loop, wall: np.ndarray, steps: np.ndarray, region: StableRegion) -> Tally:
    """Judge the steps of a wall, one for each of ``WAYS``."""
    size = np.ptp(_finite(region), axis=0)

    def with_gain(axis: int, way: float) -> bool | None:
        moved = wall.copy()
        moved[axis] += way
        return loop.balls.is_stable(*map(float, moved))

    def with_delay(way: float) -> bool | None:
        return loop.balls_at(float(loop.loop.delay_samples + way)).is_stable(*map(float, wall))

    tally = Tally()
    for (axis, _), step in zip(WAYS[:-1], steps[:-1].tolist(), strict=True):
        # A part that is rounded to the end, which is not claimed, is left out.
        parts = [part for part in _PARTS if abs(wall[axis] + part * step - wall[axis]) < abs(step)]
        farther = step + np.copysign(max(_FARTHER * abs(step), _SHARE * size[axis]), step)
        tally += _judged(partial(with_gain, axis), step, parts, farther)
    way = min(float(steps[-1]), _FARTHEST_DELAY)
    farther = way * (1.0 + _FARTHER) + _SHARE if way < _FARTHEST_DELAY else None
    return tally + _judged(with_delay, way, _DELAY_PARTS, farther)


def _judged(
    is_stable: Callable[[float], bool | None],
    step: float,
    parts: Sequence[float],
    farther: float | None,
) -> Tally:
    """Judge parts of a step, and whether the wall is still stable farther, if that can be short."""
    within = [is_stable(part * step) for part in parts]
    return Tally(
        sum(one is not None for one in within),
        sum(one is False for one in within),
        int(farther is not None and is_stable(farther) is True),
    )


# ------------------------------------------------------------------------------------- limits


def is_limit_wrong(
    loop: HapticLoop, hands: HandRange, answer: RobustLimit, rng: np.random.Generator
) -> bool:
    """True if a hand refutes the proved wall, or a wall the limit."""
    choices = [[*ends, rng.uniform(*ends)] for ends in vars(hands).values() for _ in range(_HANDS)]
    drawn = np.array([rng.choice(ends) for ends in choices]).reshape(3, -1).T
    sample = [answer.loop, *(_held(loop, hand) for hand in drawn)]
    if answer.is_proved:
        gains = np.array([[answer.stiffness]]), np.array([answer.damping])
        one = sample[int(np.argmax([_radii(one, *gains).item() for one in sample]))]
        wall = one.alpha(answer.stiffness), one.beta(answer.damping)
        if truth.unstable_count(*wall, one.gamma, one.delta, one.delay_samples) != 0:
            return True
    if not answer.limit > 0.0:
        return False
    stiffness, damping = answer.limit * _STIFFER[:, None], loop.damping(_DAMPINGS)
    corners = np.unique(
        np.stack(np.meshgrid(*vars(hands).values()), axis=-1).reshape(-1, 3), axis=0
    )
    few = [*sample[:_FEW], *(_held(loop, corner) for corner in corners)]
    tops = [one.limits() for one in few]
    walls = [((1.0 - _CLEAR) * top.stiffness, top.at_damping) for top in tops]
    if any(
        loop.worst_hand(hands, *wall).verdict == Verdict.STABLE
        for wall in walls
        if wall[0] > answer.limit
    ):
        return True
    radii = np.max([_radii(one, stiffness, damping) for one in few], axis=0)
    likely = np.argsort(radii, axis=None)[:_LIKELY]
    for row, column in zip(*np.unravel_index(likely, radii.shape), strict=True):
        if radii[row, column] < 1.0 - _CLEAR:
            wall = float(stiffness[row, 0]), float(damping[column])
            if loop.worst_hand(hands, *wall).verdict == Verdict.STABLE:
                return True
    return False


def _limits(rng: np.random.Generator, count: int) -> Row:
    seconds, wrong, proved = [], 0, 0
    for _ in range(count):
        loop, hands = _random_range(rng)
        start = process_time()
        answer = loop.robust_limit(hands)
        seconds.append(process_time() - start)
        proved += answer.is_proved
        wrong += is_limit_wrong(loop, hands, answer, rng)
    return _row("robust_limit", wrong / count, seconds, judged=count, wrong=wrong, proved=proved)


def _row(name: str, error: float, seconds: list[float], **extra: int | float) -> Row:
    measure = "share of answers that are wrong, by certified root counts"
    return record.row(name, name, seconds, error, measure, delay=8.0, **extra)


def _radii(loop: HapticLoop, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    plant = loop.gamma, loop.delta, loop.delay_samples
    walls = characteristic_polynomial(loop.alpha(stiffness), loop.beta(damping), **by_name(*plant))
    return eigenvalues.radius(np.asarray(walls))


def _random_range(rng: np.random.Generator) -> tuple[HapticLoop, HandRange]:
    loop = HapticLoop(
        device_mass=1.0,
        device_damping=float(10 ** rng.uniform(-2, 0)),
        sample_time=1.0,
        delay=float(rng.choice([0.0, 0.5, 1.0, rng.uniform(0, 3)])),
    )
    stiffest = rng.choice([10 ** rng.uniform(-3, 0), rng.uniform(1, 12)])
    ends = rng.uniform(0, 3), stiffest, rng.uniform(0, 1)
    ranges = [(0.0, float(end * rng.integers(0, 2))) for end in ends]
    return loop, HandRange(mass=ranges[0], stiffness=ranges[1], damping=ranges[2])


def _held(loop: HapticLoop, hand: np.ndarray | list[float]) -> HapticLoop:
    mass, stiffness, damping = map(float, hand)
    return replace(loop, hand_mass=mass, hand_stiffness=stiffness, hand_damping=damping)
