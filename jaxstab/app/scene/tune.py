"""Choices for a scene: the walls that come to rest fastest, sample time and delay.

``tune_walls`` finds these walls, and the best damping at given stiffnesses; ``design_loop`` the
sample time and the delay up to which a wanted stiffness is allowed.

``Backwards`` has the values of one quantity with which a scene's walls are stable: ``design --for``
asks for any quantity, ``limits --gains`` without an inertia for that. What is asked for may be
missing in the scene, and a damping that is missing counts as 0: the answer says so. Of a range of
delays it is the longest one, as a constant delay, and the answer says so, too.
"""

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from math import floor, inf, isnan, nan, sqrt
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from jaxstab.answers import (
    BUT_FOR_DRIFT,
    Basis,
    GainAnswer,
    Quantity,
    Units,
    formats_of,
    printed_pair,
)
from jaxstab.app.scene import loops
from jaxstab.app.scene.answers import basis_of
from jaxstab.app.scene.check import settled
from jaxstab.app.scene.limits import StableGains, numbered
from jaxstab.app.scene.scene import Scene, presets
from jaxstab.conventions import Status, Verdict
from jaxstab.loop import Gains, HapticLoop, StableValues, tune_for_all
from jaxstab.loop.backwards import range_of
from jaxstab.loop.wanted import margins_in_words
from jaxstab.loop.worst_settling import settling_times
from jaxstab.model.filters import dividing_periods, sections_of
from jaxstab.model.gain import Gain
from jaxstab.region.curve import bracketed_root
from jaxstab.shown import Printed, exact_text, rounded_text, stable_pair
from jaxstab.tuning import TuningStatus

# The wall that is fastest at worst over the device's mass, the hands and the delay of a scene.
#
# Settling times over ranges are not proved: loops at the corners of the ranges decide, others
# between them are tried, and the slowest of those joins the corners. What is printed is the slowest
# of all.


def tune_over_ranges(scene: Scene, fastest: Gains | None) -> GainAnswer | None:
    """The gains whose longest settling time over the ranges is the least that was found.

    None where the scene has no range.

    Settling is that of constant delays: of a delay that moves, the longest one.
    """
    given = loops.with_tolerances(scene)
    scene = loops.with_tolerances(scene.at_longest_delay) if scene.controller.moves else given
    ranges = loops.ranges_of(scene)
    if all(low == high for low, high in ranges):
        return None
    corners = loops.corner_loops(scene)
    every = [*corners, *(loops.loop_within(scene, values) for values in _between(ranges))]
    tried = [*corners]
    for _ in range(3):  # rounds, in which the slowest of them joins the corners
        wall = tune_for_all(tried)
        if wall.status == TuningStatus.NO_STABLE_GAINS:
            words = "no wall was found that settles over all of the ranges"
            return GainAnswer({"stiffness": None, "certainty": words}, is_stable=False)
        rounded = _rounded(tried, Gains(wall.stiffness, wall.damping))
        times = settling_times(every, *rounded)
        slowest = int(np.argmax(times))
        if times[slowest] <= wall.settling_time or every[slowest] in tried:
            break
        tried.append(every[slowest])
    slow, ((worst, _),) = loops.held_by(every[slowest], scene), loops.worst_on(given, [rounded])
    mass = slow.device_mass or scene.device.effective_mass[0]
    hand = replace(slow, device_mass=None) if scene.hand else None
    return GainAnswer(
        {
            **rounded._asdict(),
            "settling_time_at_worst": float(times[slowest]),
            "fastest_wall_at_worst": (
                None if fastest is None else float(settling_times(every, *fastest).max())
            ),
            "slowest": GainAnswer({"mass": mass, "delay": every[slowest].delay, "hand": hand}),
            "certainty": f"the slowest of {len(every)} loops that were tried, {len(corners)} of "
            "them at corners of the ranges; the settling of others is not proved",
            "verdict": worst.for_all,
        },
        is_stable=worst.for_all == Verdict.STABLE,
    )


def _rounded(
    own: list[HapticLoop], wall: Gains, margins: Mapping[str, Any] = MappingProxyType({})
) -> Gains:
    """A wall that is stable in each of some loops in few digits, with which it is printed.

    It has the margins in these digits, too.
    """

    def is_stable(*wall: float) -> bool:
        if margins:
            return all(bool(loop.is_usable(*wall, **margins)) for loop in own)
        return all(loop.verdict(*wall) == Verdict.STABLE for loop in own)

    nearest = Gains(*(float(rounded_text(gain, Quantity.digits)) for gain in wall))
    if is_stable(*nearest):
        return nearest
    k, b = stable_pair(*wall, (Quantity.digits, Quantity.digits), is_stable)
    if isinstance(k, Printed) and isinstance(b, Printed):
        return Gains(float(k.text), float(b.text))
    return Gains(k, b)


def _between(ranges: list[tuple[float, float]]) -> list[list[float]]:
    """Return random values of ranges, and those in the middle; stiffness evenly in frequency."""
    rng = np.random.default_rng(20081120)
    shares = np.concatenate([np.full((1, len(ranges)), 0.5), rng.random((100, len(ranges)))])
    low, high = np.array(ranges).T
    values: loops.Floats = low + shares * (high - low)
    roots = sqrt(low[2]) + shares[:, 2] * (sqrt(high[2]) - sqrt(low[2]))
    values[:, 2] = np.clip(roots**2, low[2], high[2])
    return values.tolist()


class BestWall(GainAnswer):
    """The best wall, the same with rounded gains, and how it is known.

    Where poles coincide the radius depends on the last digits of the gains. So the
    printed radius is that of the printed gains; JSON has both.
    """

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """The lines of the rounded wall, and the rest."""
        rounded = self.values["rounded"]
        own = {**self.values, **(rounded.values if rounded else {}), "rounded": None}
        return GainAnswer(own).lines(indent, units)


def tune_walls(scene: Scene) -> GainAnswer:
    """The walls that settle fastest, and the best damping at the stiffnesses given.

    Of a range of delays they are those of the longest one, as a constant delay.
    """
    if margins := scene.wanted.margins:
        scene.controller.require_one_delay(f"a search for {' and '.join(margins)}")
    _require_one_hand_for_margins(scene)
    best = partial(_best, scene, loops.loop_of(scene.at_longest_delay))
    given, fastest = scene.wanted.at_stiffness, best("settling")
    gains = Gains(fastest.rounded.stiffness, fastest.rounded.damping) if fastest.rounded else None
    return GainAnswer(
        {
            "inputs": basis_of(scene, at_longest=True),
            "margins_wanted": margins_in_words(margins) if margins else None,
            "least_radius": best("radius"),
            "least_settling": fastest,
            "walls": {name: best("settling", wall.stiffness) for name, wall in scene.walls.items()},
            "at_given_stiffness": None if given is None else best("settling", given),
            "hand": loops.at_lowest(scene),
            "over_ranges": None if margins else tune_over_ranges(scene, gains),
        },
        columns=(
            "least_settling.stiffness",
            "least_settling.damping",
            "least_settling.settling_time_2_percent",
            "walls.*.settling_time_2_percent",
        ),
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
    margins = scene.wanted.margins
    best = loop.tune(goal, stiffness=stiffness, encoder=encoder, chatter=limit, **margins)
    lacking = TuningStatus.NO_STABLE_GAINS, TuningStatus.NOT_CALM, TuningStatus.NOT_USABLE
    if best.status in lacking:
        return BestWall({"rounded": None, "status": best.status}, is_stable=False)
    gains = Gains(best.stiffness, best.damping)
    rounded = _rounded([loop], gains, margins)
    over_hands, over_delays = loops.hands_of(scene) is not None, not scene.controller.has_one_delay
    worst = loops.worst_on(scene, [rounded])[0][0] if over_hands or over_delays else None
    verdicts = {
        "for_all_hands": worst.for_all if worst and over_hands else None,
        "for_all_delays": worst.verdict if worst and over_delays else None,
    }
    of_k, edge = loop.gains[0], loop.limits()
    as_printed = StableGains(loop, are_walls=True)
    largest = as_printed.limit(of_k, edge.stiffness, edge.at_damping)
    values = {
        **_tuned(loop, gains, encoder),
        "rounded": GainAnswer(_tuned(loop, rounded, encoder)),
        "share_of_largest": best.stiffness / largest.values["largest_stiffness"],
        "status": best.status,
        **verdicts,
    }
    return BestWall(values, is_stable={*verdicts.values()} <= {None, Verdict.STABLE})


def _tuned(loop: HapticLoop, gains: Gains, encoder: float | None) -> dict[str, Any]:
    radius, chatter = loop.spectral_radius(*gains), None
    if encoder is not None:
        chatter = float(loop.amplitude(*gains, encoder=encoder).position)
    return {
        **gains._asdict(),
        "spectral_radius": float(radius.value),
        "radius_error": float(radius.error),
        "settling_time_2_percent": settled(loop.settling_time(*gains)),
        "chatter_at_most": chatter,
    }


# The sample time and the delay up to which a wanted stiffness is allowed.


class DesignStatus(Status):
    """The status of a sample time or a delay that ``design`` finds."""

    FOUND = 1, "beyond it the wanted gain is not allowed; much larger values were not tried"
    NONE = 2, "no value tried allows the wanted gain; shorten the delay or the filter"
    LONGEST_TRIED = 3, "the longest value tried still allows the wanted gain"


@dataclass(frozen=True)
class _WallsForAll(StableGains):
    """The walls that are stable for every hand and mass; the loops are those of the corners.

    Limits that are found are those of the first one.
    """

    loop: HapticLoop
    ranges: Mapping[str, Any] = field(default_factory=dict)  # as of ``worst_hand``

    def is_stable(self, own: Gain, value: float, other: float) -> bool:
        """True if a wall is proved for every hand and mass."""
        wall: Any = dict(zip((own.name, self.other(own).name), (value, other), strict=True))
        return self.loop.worst_hand(**wall, **self.ranges).verdict == Verdict.STABLE

    def beside(self, own: Gain, value: float, at: float) -> float:
        """The middle of the other gain's values that all corners share, or the given one."""
        other = self.other(own)
        low, high = self.row(own, value, at)[f"{other.name}_limits"]
        return at if isnan(low) else 0.5 * (max(low, 0.0) + min(high, 3.0 * max(low, 0.0) + 1.0))


def _require_one_hand_for_margins(scene: Scene) -> None:
    """ValueError where margins are beside a range of hands."""
    if scene.wanted.margins and loops.hands_of(scene):
        raise ValueError(
            f"{' and '.join(scene.wanted.margins)} in [wanted] are beside a range of hands, for "
            "which walls are proved without margins; give one hand, or leave them out."
        )


def design_loop(scene: Scene) -> GainAnswer:
    """The sample time, and the delay, up to which the wanted stiffness is allowed for every hand.

    A delay given in samples grows with the sample time. Where a window is given in s, only sample
    times that divide it are tried. Of a range of delays it is the longest one, as a constant delay.
    """
    most_samples = 256.0  # of delay that are tried
    given, scene = scene, scene.at_longest_delay
    wanted = scene.wanted.stiffness
    if wanted is None:
        raise ValueError(
            "wanted.stiffness is missing; give the stiffness to design for in "
            f"{scene.units.stiffness}."
        )
    loop, in_samples = loops.loop_of(scene), scene.controller.delay_samples
    period, of_k, safety = loop.sample_time, loop.gains[0], scene.wanted.safety or 1.0
    hands, corners = loops.hands_of(scene), loops.corner_loops(scene)
    _require_one_hand_for_margins(scene)
    ranges = {"hands": hands, "mass": loops.masses_of(scene)}
    shortest = max(period / 1024.0, loop.delay / most_samples if in_samples is None else 0.0)
    longest = min(1024.0 * period, _longest(loop))

    def largest(name: str, loop_at: Any, *among: Any) -> GainAnswer:
        """The largest value for all corners: that of the one that limits it, proved for all."""

        def at(value: float) -> StableGains:
            first, *others = (loop_at(scene, value, corner) for corner in corners)
            if hands is None:
                stable = StableGains(first, safety, are_walls=True)
                return stable.usable(scene.wanted.margins)
            return _WallsForAll(first, safety, (*others,), are_walls=True, ranges=ranges)

        def limit(corner: HapticLoop, value: float) -> float:
            stiffness, _ = StableGains(loop_at(scene, value, corner)).found(of_k)
            return -inf if isnan(stiffness) else stiffness

        value = among[0]
        for _ in range(3):
            first = corners[0]
            corners.sort(key=partial(limit, value=value))
            if value != among[0] and corners[0] is first:
                break
            answer = largest_value(name, at, of_k, wanted, *among)
            value = answer.values[f"largest_{name}"]
            if isnan(value):
                break
        return answer

    stable = StableGains(loop, safety, are_walls=True).usable(scene.wanted.margins)
    now: Any = loops.limit_for_all(scene, safety) or stable.limit(of_k, *stable.found(of_k))
    return GainAnswer(
        {
            "inputs": basis_of(given, at_longest=True),
            "stiffness": wanted,
            "safety": scene.wanted.safety,
            "now_allowed_stiffness": now.largest_stiffness,
            "sample_time": largest(
                "sample_time",
                sampled_loop,
                period,
                (shortest, longest),
                _periods(loop, shortest, inf),
            ),
            "delay": largest("delay", delayed_loop, period, (0.0, most_samples * period)),
            "certainty": f"proved for every {loops.every_in_words(scene)}"
            if hands
            else stable.certainty,
        },
        columns=("now_allowed_stiffness", "sample_time.largest_*", "delay.largest_*"),
    )


def _longest(loop: HapticLoop) -> float:
    """The sample time in s up to which all filters are some; infinite where all always are."""
    sections = sections_of(loop.velocity, loop.position)
    return min((section.longest_sample_time for section in sections), default=inf)


def _periods(loop: HapticLoop, low: float, high: float) -> list[float] | None:
    """The sample times in a range that divide all windows in s; None without one."""
    every = dividing_periods(sections_of(loop.velocity, loop.position))
    return every and [period for period in every if low <= period <= high]


def stiffness_over(
    name: str, scene: Scene, design: GainAnswer
) -> tuple[loops.Floats, loops.Floats]:
    """Sample times, or delays, around those now and designed in s, and the allowed stiffness."""
    shares, points = (0.6, 1.6), 33  # of the shortest and the longest that are given
    loop, safety = loops.loop_of(scene), scene.wanted.safety or 1.0
    corners = loops.corner_loops(scene)
    designed, among = design.values[name].values[f"largest_{name}"], None
    given = [loop.sample_time, designed, *((0.0, loop.delay) if name == "delay" else ())]
    low, high = shares[0] * np.nanmin(given), shares[1] * np.nanmax(given)
    if name == "sample_time":
        high = min(high, _longest(loop))
        among = _periods(loop, low, high)
    values = np.linspace(low, high, points) if among is None else np.array(among[::-1])
    loop_at = sampled_loop if name == "sample_time" else delayed_loop

    def stiffest(value: float) -> float:
        regions = (loops.wall_region(loop_at(scene, value, corner)) for corner in corners)
        return safety * min(region.reachable.stiffest.stiffness for region in regions)

    return values, np.array([*map(stiffest, values.tolist())])


def sampled_loop(scene: Scene, period: float, loop: HapticLoop | None = None) -> HapticLoop:
    """Return a loop of a scene with another sample time; a delay in samples goes with it."""
    loop, in_samples = loop or loops.loop_of(scene), scene.controller.delay_samples
    delay = loop.delay if in_samples is None else in_samples[0] * period
    return replace(loop, sample_time=period, delay=delay)


def delayed_loop(scene: Scene, delay: float, loop: HapticLoop | None = None) -> HapticLoop:
    """Return a loop of a scene with another delay in s."""
    return replace(loop or loops.loop_of(scene), delay=delay)


def largest_value(
    name: str,
    at: Callable[[float], StableGains],
    own: Gain,
    goal: float,
    start: float,
    ends: tuple[float, float],
    among: Sequence[float] | None = None,
    *,
    is_whole: bool = False,
) -> GainAnswer:
    """The value of a quantity beyond which a gain is not allowed, above the start or below.

    Beside it stand the other gain, as printed, and a status. Of values ``among`` which it is, if
    they are given, the largest comes first.
    """
    stable_at = cache(lambda value: at(floor(value) if is_whole else value))
    limit = cache(lambda value: stable_at(value).found(own))

    def spare(value: float) -> float:
        """The rest of the limit, relative; -1 where no gains are stable."""
        value = floor(value) if is_whole else value
        try:
            found, safety = limit(value)[0], stable_at(value).safety
        except ValueError:  # beyond what a filter, or the longest delay, allows
            return -1.0
        is_largest = own.sense == "largest"
        share = safety * (found / goal if is_largest else goal / max(found, 1e-300))
        return -1.0 if isnan(share) else min(max(share - 1.0, -1.0), 1e6)

    def is_stable(value: float, other: float) -> bool:
        return stable_at(value).is_stable(own, goal, other)

    if among is not None:
        index = bisect_left(among, True, key=lambda value: spare(value) >= 0.0)
        status = DesignStatus.FOUND if index else DesignStatus.LONGEST_TRIED
        status = status if index < len(among) else DesignStatus.NONE
        value = [*among, nan][index]
    else:
        value, status = _searched(spare, start, *ends)
    other: float | None = None

    def printed(largest: float) -> tuple[float, float]:
        """A value and the other gain as they are printed: a pair that allows the goal."""
        value = float(floor(largest)) if is_whole else largest
        inside = value if is_whole or among is not None else value * (1.0 - 2e-4)
        other = stable_at(inside).beside(own, goal, limit(value)[1])
        if not is_stable(inside, other):
            return nan, nan
        if among is not None:  # of which no digit may be left out
            return Printed(value, exact_text(value)), other
        return printed_pair(value, other, is_stable)

    if status != DesignStatus.NONE:
        smaller: Sequence[float] = [share * value for share in (1.0, 0.99, 0.97, 0.9, 0.7)]
        if among is not None:
            smaller = among[index : index + 5]
        pairs = (pair for pair in map(printed, smaller) if not isnan(pair[0]))
        value, other = next(pairs, (nan, None))
        status = status if other is not None else DesignStatus.NONE
    beside = f"at_{stable_at(start).other(own).name}"
    return GainAnswer(
        {f"largest_{name}": value, beside: other, "status": status},
        stable_at(start).formats,
        status != DesignStatus.NONE,
    )


def _searched(
    spare: Callable[[float], float], start: float, lowest: float, highest: float
) -> tuple[float, DesignStatus]:
    """The largest value that leaves a limit something to spare, relative; -1 where it has none."""
    low, high = start, start
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


# The values of one quantity with which walls are stable.

QUANTITIES: Mapping[str, str] = {
    "inertia": "device_mass",
    "mass": "device_mass",
    "damping": "device_damping",
    "delay": "delay",
    "sample-time": "sample_time",
    "cutoff": "cutoff",
    "window": "window",
}
"""What may be asked for, as commands call it."""

_NO_WALL = (
    "the scene has a table [loop], but --for, and --gains without a mass, are for walls of a held "
    "device; jaxstab study SCENE --over KEY=VALUES asks for other loops, such as "
    "loop.inertia=0.05,0.2."
)


def known_of(table: Mapping[str, Any]) -> set[str]:
    """The keys of the device of a table, with those that its preset has."""
    device = table.get("device", {})
    own = device if isinstance(device, Mapping) else {}
    return {*own, *presets("devices").get(str(own.get("preset")), ())}


@dataclass(frozen=True)
class Backwards:
    """A scene, and the quantity that is asked for."""

    scene: Scene
    asked: str

    @classmethod
    def from_table(cls, table: Mapping[str, Any], source: str, asked: str) -> "Backwards":
        """Check a scene in which what is asked for may be missing; ValueError: ``Scene``."""
        if "loop" in table:
            raise ValueError(f"{source}: {_NO_WALL}" if source else _NO_WALL)
        known, device = known_of(table), table.get("device", {})
        is_missing = QUANTITIES[asked] == "device_mass" and not {"mass", "inertia"} & known
        if is_missing and isinstance(device, Mapping):  # others are refused
            device = {**device, asked: 1.0}  # any
        scene = Scene.from_table({**table, "device": device}, source)
        scene.require_walls()
        return cls(scene, asked)

    def unusual(self) -> list[str]:
        """Describe values that look like a slip of the unit."""
        return self.scene.unusual()

    def answer(self, command: str) -> GainAnswer:
        """The values that each wall needs."""
        scene, quantity = self.scene.at_longest_delay, QUANTITIES[self.asked]
        held = "each value that is tried" if self.asked == "delay" else "the longest"
        inputs = basis_of(self.scene, at_longest=True, constant=held)
        options: Any = {
            "in_samples": scene.controller.delay_samples is not None,
            "mass": loops.masses_of(scene),
        }
        if quantity == "device_mass":
            inputs, options["mass"] = Basis(inputs.values | {"mass": (nan, nan)}), None
        if options["mass"] or (scene.hand and scene.hand.varies):
            options["hands"] = loops.range_of_hands(scene)
        has_one_delay = self.scene.controller.has_one_delay
        every = " for every hand" if "hands" in options else ""
        every += "" if has_one_delay else " at a constant delay"
        walls = dict[str, GainAnswer]()
        for name, wall in loops.walls_of(scene).items():
            found = range_of(loops.loop_of(scene), quantity, wall, **options)
            walls[name] = _needs(wall, found, scene.units, every)
        if self.asked == "damping":
            inputs = Basis(inputs.values | {"damping_is": None})
        # ``limits`` answers for all delays, ``design`` for the one that its answer names.
        is_for_all = command == "design" or has_one_delay
        values, main = {"inputs": inputs, "walls": walls}, ("walls.*.least_*", "walls.*.largest_*")
        return GainAnswer(values, is_stable=is_for_all, columns=main)


def _needs(wall: Gains, found: StableValues, units: Units, every: str) -> GainAnswer:
    """The values that one wall needs: the interval that is widest by its ratio, and others.

    ``every``: beyond what one loop needs, what its ends are proved for.
    """
    name = units.moved if found.quantity == "device_mass" else found.quantity
    least, largest, others = f"least_{name}", f"largest_{name}", f"other_{name}"
    values: dict[str, Any] = {"stiffness": wall.stiffness, "damping": wall.damping}
    if found.intervals:
        inner = [(low.stable, high.stable) for low, high in found.intervals]
        inner.sort(key=lambda ends: ends[0] / ends[1] if ends[1] else 0.0)
        (low, high), *more = inner
        values[least] = low if low > found.between[0] else None
        values[largest] = high if high < found.between[1] else None
        values[others] = numbered(more)
        is_all = len(inner) == 1 and inner[0] == found.between
        stable = BUT_FOR_DRIFT if found.drift else "stable"
        if is_all or found.drift:
            values["status"] = f"every value tried is {stable}" if is_all else stable
        words = f"{'each end is' if found.is_proved else 'not'} proved{every}"
        values["certainty"] = words if every else None
    else:
        values["status"] = "no value tried is stable"
    values["scan"] = found._replace(unit=units.unit(found.unit)).scan
    formats = formats_of({name: found.unit})
    formats = {key: replace(form, digits=10) for key, form in formats.items() if key != name}
    return GainAnswer(values, formats, bool(found.intervals) and found.is_proved)
