"""Choices for a scene: the walls that come to rest fastest, sample time and delay.

``tune_walls`` finds these walls, and the best damping at given stiffnesses; ``design_loop`` the
largest sample time and the largest delay that allow a wanted stiffness.
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from math import inf, nan, sqrt
from typing import Literal

import numpy as np

from jaxstab.conventions import Status, Verdict
from jaxstab.loop import Gains, HapticLoop, tune_for_all
from jaxstab.loop.tune import settling_times
from jaxstab.model.filters import LONGEST_WINDOW
from jaxstab.region.curve import bracketed_root
from jaxstab.scene.answers import (
    Answer,
    Basis,
    Bound,
    Damping,
    GivenDamping,
    GivenStiffness,
    LargestStiffness,
    LargestTime,
    Mass,
    Number,
    Part,
    Time,
    basis_of,
    printed_wall,
    rounded_wall,
)
from jaxstab.scene.check import Amplitude, SettlingTime, settled
from jaxstab.scene.loops import (
    Floats,
    Member,
    OneHand,
    at_lowest,
    corners_of,
    hands_of,
    loop_of,
    loop_of_member,
    ranges_of,
    wall_region,
    with_tolerances,
    worst_on,
)
from jaxstab.scene.scene import Scene, Units, VelocityTable
from jaxstab.shown import Printed, exact_text
from jaxstab.tuning import TuningStatus

# The wall that is fastest at worst over the device's mass, the hands and the delay of a scene.
#
# Settling times over ranges are not proved: loops at the corners of the ranges decide, others
# between them are tried, and the slowest of those joins the corners. What is printed is the slowest
# of all.


@dataclass(frozen=True)
class SlowestLoop(Answer):
    """The loop of the ranges in which a wall takes longest."""

    mass: Mass
    delay: Time
    hand: OneHand | None


@dataclass(frozen=True)
class WallOverRanges(Answer):
    """The wall whose longest settling time over the ranges is the least that was found."""

    stiffness: GivenStiffness | None
    damping: GivenDamping | None
    settling_time_at_worst: SettlingTime | None
    fastest_wall_at_worst: SettlingTime | None
    slowest: SlowestLoop | None
    certainty: str
    verdict: Verdict | str | None = None

    @property
    def is_stable(self) -> bool:
        """True if there is such a wall, proved stable over the ranges."""
        return self.verdict == Verdict.STABLE


def tune_over_ranges(scene: Scene, fastest: Gains | None) -> WallOverRanges | None:
    """The gains minimising the worst-case settling; None where the scene has no range.

    Settling is that of constant delays: of a delay that moves, the longest one.
    """
    given, scene = scene, scene.at_longest_delay if scene.controller.moves else scene
    ranges = ranges_of(scene)
    if all(low == high for low, high in ranges):
        return None
    corners = corners_of(scene)
    loops = [loop_of_member(scene, member) for member in corners]
    among = [*corners, *_between(ranges)]
    every = [*loops, *(loop_of_member(scene, member) for member in among[len(corners) :])]
    for _ in range(3):  # rounds, in which the slowest of them joins the corners
        wall = tune_for_all(loops)
        if wall.status == TuningStatus.NO_STABLE_GAINS:
            words = "no wall was found that settles over all of the ranges"
            return WallOverRanges(None, None, None, None, None, words)
        rounded = Gains(*rounded_wall(wall.stiffness, wall.damping, partial(_is_stable, loops)))
        times = settling_times(every, *rounded)
        slowest = int(np.argmax(times))
        if times[slowest] <= wall.settling_time or every[slowest] in loops:
            break
        loops.append(every[slowest])
    member, ((worst, _),) = among[slowest], worst_on(with_tolerances(given), [rounded])
    return WallOverRanges(
        *rounded,
        float(times[slowest]),
        None if fastest is None else float(settling_times(every, *fastest).max()),
        SlowestLoop(member.mass, member.delay, OneHand(*member[1:4]) if scene.hand else None),
        f"the slowest of {len(every)} loops that were tried, {len(corners)} of them at corners of "
        "the ranges; the settling of others is not proved",
        worst.for_all,
    )


def _is_stable(loops: list[HapticLoop], stiffness: float, damping: float) -> bool:
    """True if a wall is proved stable in each of some loops."""
    return all(loop.verdict(stiffness, damping) == Verdict.STABLE for loop in loops)


def _between(ranges: list[tuple[float, float]]) -> list[Member]:
    """Return random members, and the one in the middle; stiffness evenly in frequency."""
    rng = np.random.default_rng(20081120)
    shares = np.concatenate([np.full((1, len(ranges)), 0.5), rng.random((100, len(ranges)))])
    low, high = np.array(ranges).T
    values = low + shares * (high - low)
    roots = sqrt(low[2]) + shares[:, 2] * (sqrt(high[2]) - sqrt(low[2]))
    values[:, 2] = np.clip(roots**2, low[2], high[2])
    return [Member(*row) for row in values.tolist()]


@dataclass(frozen=True)
class RoundedWall(Answer):
    """Rounded gains, and the radius and settling time that these gains have."""

    stiffness: GivenStiffness
    damping: GivenDamping
    spectral_radius: Number
    radius_error: Bound
    settling_time_2_percent: SettlingTime
    chatter_at_most: Amplitude | None


@dataclass(frozen=True)
class TunedWall(RoundedWall, Part):
    """The same of gains that are not rounded."""


@dataclass(frozen=True)
class BestWall(Answer):
    """The best wall, and how it is known. Where none is stable there is only the status.

    Where poles coincide the radius depends on the last digits of the gains. So the
    printed radius is that of the printed gains; JSON has both.
    """

    exact: TunedWall | None
    rounded: RoundedWall | None
    share_of_largest: Number | None
    status: TuningStatus
    for_all_hands: Verdict | str | None
    for_all_delays: Verdict | str | None

    @property
    def is_stable(self) -> bool:
        """True if there is such a wall, proved stable for all hands and delays."""
        verdicts = self.for_all_hands, self.for_all_delays
        return self.exact is not None and all(v in (None, Verdict.STABLE) for v in verdicts)

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """Return the lines of the rounded wall, and the rest."""
        printed = TunedWall(**vars(self.rounded)) if self.rounded else None
        return Answer.lines(replace(self, exact=printed, rounded=None), indent, units)


@dataclass(frozen=True)
class Tuned(Answer):
    """The wall of the smallest radius, of the fastest settling, and the best dampings."""

    inputs: Basis
    least_radius: BestWall
    least_settling: BestWall
    walls: dict[str, BestWall]
    at_given_stiffness: BestWall | None
    hand: str | None
    over_ranges: WallOverRanges | None

    @property
    def all_stable(self) -> bool:
        """True if each wall is found and proved stable."""
        walls = [self.least_radius, self.least_settling, *self.walls.values()]
        others = [wall for wall in (self.at_given_stiffness, self.over_ranges) if wall]
        return all(wall.is_stable for wall in [*walls, *others])


def tune_walls(scene: Scene) -> Tuned:
    """The walls that settle fastest, and the best damping at the stiffnesses given.

    Of a range of delays they are those of the longest one, as a constant delay.
    """
    best = partial(_best, scene, loop_of(scene.at_longest_delay))
    given, fastest = scene.wanted.at_stiffness, best("settling")
    gains = Gains(fastest.rounded.stiffness, fastest.rounded.damping) if fastest.rounded else None
    return Tuned(
        inputs=basis_of(scene, at_longest=True),
        least_radius=best("radius"),
        least_settling=fastest,
        walls={name: best("settling", wall.stiffness) for name, wall in scene.walls.items()},
        at_given_stiffness=None if given is None else best("settling", given),
        hand=at_lowest(scene),
        over_ranges=tune_over_ranges(scene, gains),
    )


def _best(
    scene: Scene,
    loop: HapticLoop,
    goal: Literal["radius", "settling"],
    stiffness: float | None = None,
) -> BestWall:
    chatter = scene.wanted.chatter
    limit = None if chatter is None else chatter * (1.0 - 1e-4)  # for gains are rounded
    encoder = None if scene.device.encoder is None else scene.device.encoder.resolution
    best = loop.tune(goal, stiffness=stiffness, encoder=encoder, chatter=limit)
    if best.status in (TuningStatus.NO_STABLE_GAINS, TuningStatus.NOT_CALM):
        return BestWall(None, None, None, best.status, None, None)
    gains = Gains(best.stiffness, best.damping)
    rounded = Gains(*rounded_wall(*gains, partial(_is_stable, [loop])))
    over_hands, over_delays = hands_of(scene) is not None, not scene.controller.has_one_delay
    worst = worst_on(scene, [rounded])[0][0] if over_hands or over_delays else None
    return BestWall(
        _tuned(loop, gains, encoder),
        RoundedWall(**vars(_tuned(loop, rounded, encoder))),
        best.stiffness / wall_region(loop).reachable.stiffest.stiffness,
        best.status,
        worst.for_all if worst and over_hands else None,
        worst.verdict if worst and over_delays else None,
    )


def _tuned(loop: HapticLoop, gains: Gains, encoder: float | None) -> TunedWall:
    radius, chatter = loop.spectral_radius(*gains), None
    if encoder is not None:
        chatter = float(loop.amplitude(*gains, encoder=encoder).position)
    return TunedWall(
        stiffness=gains.stiffness,
        damping=gains.damping,
        spectral_radius=float(radius.value),
        radius_error=float(radius.error),
        settling_time_2_percent=settled(loop.settling_time(*gains)),
        chatter_at_most=chatter,
    )


# The largest sample time and the largest delay that allow a wanted stiffness.

_AROUND, _POINTS = (0.6, 1.6), 33  # of a picture: shares of its shortest and longest value


class DesignStatus(Status):
    """The status of a largest sample time or delay."""

    FOUND = 1, "the largest that allows the stiffness"
    NONE = 2, "no value tried reaches this stiffness; shorten the delay or the filter"
    LONGEST_TRIED = 3, "the longest value tried still allows the stiffness"


@dataclass(frozen=True)
class LargestSampleTime(Answer):
    """The largest sample time, the damping that allows most there, and a status."""

    largest_sample_time: LargestTime
    at_damping: Damping | None
    status: DesignStatus


@dataclass(frozen=True)
class LargestDelay(Answer):
    """The largest delay, the damping that allows most there, and a status."""

    largest_delay: LargestTime
    at_damping: Damping | None
    status: DesignStatus


@dataclass(frozen=True)
class Design(Answer):
    """The sample time and delay that a desired stiffness requires."""

    inputs: Basis
    stiffness: GivenStiffness
    safety: Number | None
    now_allowed_stiffness: LargestStiffness
    sample_time: LargestSampleTime
    delay: LargestDelay
    hand: str | None

    @property
    def all_stable(self) -> bool:
        """True if a sample time and a delay allow the stiffness."""
        return DesignStatus.NONE not in (self.sample_time.status, self.delay.status)


def design_loop(scene: Scene) -> Design:
    """The largest sample time, and the largest delay, that allow the wanted stiffness."""
    most_samples = 256.0  # of delay that are tried
    # A delay given in samples grows with the sample time. The damping is that of the stiffest wall.
    # The stiffness is taken to fall as the sample time or the delay grows. Where the velocity is
    # taken over a window in s, only sample times that divide it are tried. Of a range of delays it
    # is the longest one, as a constant delay.
    given, scene = scene, scene.at_longest_delay
    wanted = scene.wanted.stiffness
    if wanted is None:
        raise ValueError(
            "wanted.stiffness is missing; give the stiffness to design for in "
            f"{scene.units.stiffness}."
        )
    loop, safety = loop_of(scene), scene.wanted.safety or 1.0
    in_samples, velocity = scene.controller.delay_samples, scene.controller.velocity
    period, largest = loop.sample_time, partial(_largest, wanted, safety)
    shortest = max(period / 1024.0, loop.delay / most_samples if in_samples is None else 0.0)
    longest = min(1024.0 * period, velocity.longest_sample_time if velocity else inf)
    sampled, delayed = partial(sampled_loop, scene), partial(delayed_loop, scene)
    periods = _periods(velocity)
    periods = None if periods is None else [value for value in periods if value >= shortest]
    return Design(
        inputs=basis_of(given, at_longest=True),
        stiffness=wanted,
        safety=scene.wanted.safety,
        now_allowed_stiffness=safety * _stiffest(loop).stiffness,
        sample_time=LargestSampleTime(*largest(sampled, period, (shortest, longest), periods)),
        delay=LargestDelay(*largest(delayed, period, (0.0, most_samples * period))),
        hand=at_lowest(scene),
    )


def _periods(velocity: VelocityTable | None) -> list[float] | None:
    """Return the sample times that divide the window in s of an estimator; None without one."""
    window = velocity.window if velocity else None
    return [window / count for count in range(1, LONGEST_WINDOW + 1)] if window else None


def stiffness_over_sample_times(scene: Scene, design: Design) -> tuple[Floats, Floats]:
    """Return sample times in s, around those now and designed, and the allowed stiffness."""
    velocity, periods = scene.controller.velocity, _periods(scene.controller.velocity)
    given = scene.controller.sample_time, design.sample_time.largest_sample_time
    ends = [period for period in given if period > 0.0]
    low, high = _AROUND[0] * min(ends), _AROUND[1] * max(ends)
    high = min(high, velocity.longest_sample_time) if velocity else high
    values = np.linspace(low, high, _POINTS)
    if periods is not None:
        values = np.array([value for value in periods[::-1] if low <= value <= high])
    return values, _stiffnesses(scene, sampled_loop, values)


def stiffness_over_delays(scene: Scene, design: Design) -> tuple[Floats, Floats]:
    """Return delays in s, from 0 to beyond those now and designed, and the allowed stiffness."""
    loop, designed = loop_of(scene), design.delay.largest_delay
    longest = _AROUND[1] * max(loop.delay, loop.sample_time, designed if designed > 0.0 else 0.0)
    values = np.linspace(0.0, longest, _POINTS)
    return values, _stiffnesses(scene, delayed_loop, values)


def _stiffnesses(
    scene: Scene, loop_at: Callable[[Scene, float], HapticLoop], values: Floats
) -> Floats:
    safety = scene.wanted.safety or 1.0
    return np.array([safety * _stiffest(loop_at(scene, x)).stiffness for x in values.tolist()])


def sampled_loop(scene: Scene, period: float) -> HapticLoop:
    """Return the loop of a scene with another sample time; a delay in samples goes with it."""
    loop, in_samples = loop_of(scene), scene.controller.delay_samples
    delay = loop.delay if in_samples is None else in_samples[0] * period
    return replace(loop, sample_time=period, delay=delay)


def delayed_loop(scene: Scene, delay: float) -> HapticLoop:
    """Return the loop of a scene with another delay in s."""
    return replace(loop_of(scene), delay=delay)


def _largest(
    wanted: float,
    safety: float,
    loop_at: Callable[[float], HapticLoop],
    start: float,
    ends: tuple[float, float],
    among: Sequence[float] | None = None,
) -> tuple[float, float | None, DesignStatus]:
    """The largest value that allows the wanted stiffness, with the damping, as printed; a status.

    Of values ``among`` which it is, if they are given, the largest comes first.
    """

    def spare(value: float) -> float:
        return max(-1.0, _stiffest(loop_at(value)).stiffness * safety / wanted - 1.0)

    def is_stable(value: float, damping: float) -> bool:
        return _is_stable([loop_at(value)], wanted, damping)

    if among is not None:
        index = bisect_left(among, True, key=lambda value: spare(value) >= 0.0)
        status = DesignStatus.FOUND if index else DesignStatus.LONGEST_TRIED
        status = status if index < len(among) else DesignStatus.NONE
        largest = [*among, nan][index]
    else:
        largest, status = largest_value(spare, start, *ends)
    if status == DesignStatus.NONE:
        return largest, None, status
    damping = _stiffest(loop_at(largest)).damping
    if among is not None:  # of which no digit may be left out
        return Printed(largest, exact_text(largest)), damping, status
    return *printed_wall(largest, damping, is_stable), status


def largest_value(
    spare: Callable[[float], float], start: float, lowest: float, highest: float
) -> tuple[float, DesignStatus]:
    """The largest value that leaves a limit something to spare, relative; -1 where it has none."""
    spare, low, high = cache(spare), start, start
    least = 1e-3 * start  # of a delay: less than this is tried as none at first
    while spare(high) >= 0.0 and high < highest:
        low, high = high, min(2.0 * high, highest)
    while spare(low) < 0.0 and low > lowest:
        low, high = 0.5 * low if 0.5 * low > max(lowest, least) else lowest, low
    if spare(low) < 0.0:
        return nan, DesignStatus.NONE
    largest, status = high, DesignStatus.LONGEST_TRIED
    if spare(high) < 0.0:
        with np.errstate(all="ignore"):  # where no wall is stable the secant has no slope
            root = float(
                bracketed_root(lambda x: np.array(spare(float(x))), np.array(low), np.array(high))
            )
        largest, status = max(low, root - 1e-8 * max(root, least)), DesignStatus.FOUND
    return largest, status


def _stiffest(loop: HapticLoop) -> Gains:
    return wall_region(loop).reachable.stiffest
