"""The walls of a scene: verdict, margins, radius, settling and chatter, with proofs."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import permutations
from math import inf, isinf, isnan, nan
from typing import Any

import numpy as np

from jaxstab.arrays import tree_map
from jaxstab.conventions import Verdict
from jaxstab.loop import FrequencyMargins as LoopFrequencyMargins
from jaxstab.loop import Gains, HapticLoop
from jaxstab.loop import Margins as LoopMargins
from jaxstab.loop.frequency import wall_frequency_margins
from jaxstab.motion import Amplitude as Amplitudes
from jaxstab.motion import Oscillation as Mode
from jaxstab.motion import Settling as MotionSettling
from jaxstab.motion import SettlingStatus
from jaxstab.point import SpectralRadius
from jaxstab.rounding import EPS
from jaxstab.scene.answers import (
    LABELS,
    GainAnswer,
    Part,
    Quantity,
    basis_of,
    line,
)
from jaxstab.scene.contact import Simulated, contacts_or_reasons
from jaxstab.scene.limits import StableGains, stable_in_words
from jaxstab.scene.loops import (
    Floats,
    OneHand,
    WallVerdict,
    corner_loops,
    hands_of,
    held_by,
    loops_over_delays,
    masses_of,
    walls_of,
    with_delay,
    worst_on,
)
from jaxstab.scene.scene import Scene, Units
from jaxstab.shown import table_text


class FrequencyMargins(GainAnswer, Part):
    """The distances of the open loop from -1, and where they are: each the worst over some hands.

    Without a gain margin it is one line, of two numbers.
    """

    def rows(self, units: Units = Units.LINE) -> dict[str, str]:
        """The words of each number, the frequency behind it."""
        rows = dict[str, str]()
        for path, _, words in self.leaves("", units):
            name, is_place, _ = path.partition("_at")
            label = LABELS.get(name, name.replace("_", " "))
            rows[label] = f"{rows[label]} at {words}" if is_place else words
        if "gain_margin" not in self.values:
            phase, peak = rows.values()
            words = phase if isnan(self.phase_margin) else f"{phase}, peak sensitivity {peak}"
            rows = {"phase margin": words}
        return rows

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """A line for each number."""
        return [line(indent, name, words) for name, words in self.rows(units).items()]


# What a check says in short.


def in_short(answer: GainAnswer) -> str:
    """Notes that are easily overlooked, and the main answers of each pair of gains."""
    inputs, kind = answer.inputs, "walls" if "walls" in answer.values else "gains"
    pairs = answer.values[kind]
    rows, delays = [*inputs.facts().items()], getattr(inputs, "range_of_delays", None)
    if delays or any(pair.values.get("worst_hand") for pair in pairs.values()):
        words = "verdicts cover all of them; other numbers are the worst at their ends"
        rows.append(("ranges", words + ", of constant delays" * (delays is not None)))
    for name, pair in pairs.items():
        rows += _rows(f"{kind.replace('walls', 'wall')} {name}", pair, inputs, delays)
    return table_text(rows)


def _rows(
    title: str, pair: GainAnswer, inputs: Any, delays: str | None
) -> Iterator[tuple[str, str]]:
    """At most eight lines, or some more with all margins over frequency."""
    units = getattr(inputs, "units", Units.LINE)
    said = {path: words for path, _, words in pair.leaves("", units)}
    values, (first, second, *_) = pair.values, pair.values
    of_wall = title.startswith("wall")
    own = [said[name] if of_wall else f"{name} = {said[name]}" for name in (first, second)]
    yield title, f"{(' at ' if of_wall else ' and ').join(own)}: {_verdict(values, said, units)}"
    verdict, reason = values["verdict"], values.get("measures_are")
    if reason and reason.startswith("left out: nothing"):
        yield "  measures", reason
    if verdict == Verdict.UNSTABLE and delays:
        return  # all else is of constant delays
    if "both_factors" in values:
        factors = [f"{name} by {said[f'{name}_factors_low']}" for name in (first, second, "both")]
        yield "  gain margins", f"may be multiplied: {', '.join(factors)}"
    elif "stiffness_gain" in values:
        growth = [said[f"{gain}_gain"] for gain in ("stiffness", "damping")]
        growth = [f"a factor of {x}" if x[0].isdigit() else f"{x} factor" for x in growth]
        yield "  gain margins", "K may grow by {}, B by {}".format(*growth)
        moving = said.get("extra_delay_moving") if delays else None
        words = f"{said['extra_delay']} (constant)"
        yield "  extra delay", f"{words}, {moving} (varying)" if moving else words
    elif f"{first}_limits" in values:
        letters = ("K", "B") if of_wall else (first, second)
        places = zip((first, second), letters, own[::-1], strict=True)
        beside = [
            stable_in_words(letter, name, place, said.get(f"{name}_limits_low"), said)
            for name, letter, place in places
        ]
        yield f"  stable {'walls' if of_wall else 'gains'}", "; ".join(beside)
    frequency = values.get("margins_over_frequency")
    yield from ((f"  {x}", w) for x, w in (frequency.rows(units) if frequency else {}).items())
    if "settling_status" in values:
        is_open = values["settling_status"] == SettlingStatus.NOT_SETTLED
        horizon = Quantity("s", 3).words(_HORIZON * inputs.sample_time)
        words = f"not proved within {horizon}" if is_open else said["settling_time_2_percent"]
        yield "  settling time (2 %)", words
    if "chatter_at_most" in values:
        most = said["chatter_at_most"], said["force_chatter_at_most"]
        is_endless = isinf(values["chatter_at_most"])
        yield "  encoder chatter", most[0] if is_endless else "at most {} and {}".format(*most)
    if felt := values.get("simulated"):
        yield "  contact", felt if isinstance(felt, str) else felt.in_short(units)


def _verdict(values: Mapping[str, Any], said: Mapping[str, str], units: Units) -> str:
    words, hand = said["verdict"], values.get("worst_hand")
    if "hands_are" in said:
        return f"{words}: {said['hands_are']}"
    if values["verdict"] == Verdict.UNSTABLE:
        cause = f"{words} with {hand.in_words(units)}" if hand else words
        return "; ".join(filter(None, [cause, values.get("worst_delays")]))
    kinds = ["hand", *[units.moved] * (hand.device_mass is not None)] if hand else []
    return f"{words} for every {' and '.join(kinds)}" if hand else words


# The walls of a scene.


@dataclass(frozen=True)
class _Wall:
    """A wall of a scene, the loops with the hands at the corners of its range and the worst."""

    scene: Scene
    gains: Gains
    loops: list[HapticLoop]
    worst: WallVerdict
    worst_loop: HapticLoop


def check_walls(scene: Scene, *, in_full: bool = True) -> GainAnswer:
    """The verdict on each wall and the requested measures, at their worst; at least one wall.

    The worst hand is that of the largest radius, which is given for it; every other measure is the
    worst over the hands that are tried, but for the jitter, which is proved for every hand. Not
    ``in_full`` the answer has what ``in_short`` prints.
    """
    scene.require_walls()
    felt = contacts_or_reasons(scene) if scene.wanted.measures else {}
    walls = zip(scene.walls, _walls_of(scene), strict=True)
    checked = {name: _checked(wall, felt.get(name), in_full=in_full) for name, wall in walls}
    return GainAnswer({"inputs": basis_of(scene), "walls": checked})


def _checked(wall: _Wall, felt: Simulated | str | None, *, in_full: bool) -> GainAnswer:
    scene, is_unstable = wall.scene, wall.worst.verdict == Verdict.UNSTABLE
    encoder, wanted, answers = scene.device.encoder, scene.wanted, dict[str, Any]()
    options: dict[str, dict[str, Any]] = {
        "frequency": {"in_full": wanted.frequency},
        "chatter": {"encoder": encoder.resolution} if encoder else {},
        "jitter": {"hands": hands_of(scene), "mass": masses_of(scene)},
    }
    of_worst = {"jitter": [replace(wall.worst_loop, delay=scene.controller.delays[0])]}
    of_worst |= {} if scene.controller.moves else {"radius": [wall.worst_loop]}
    printed = ["margins", "frequency", "settling", "chatter"] + ["jitter"] * scene.controller.moves
    of_stable = [*printed, "jitter"] if not in_full else ["margins", "frequency", "jitter"]
    reason = None
    if wall.worst.drifts:
        reason = "left out: nothing holds the position; limits --at-stiffness 0 gives the dampings"
    elif scene.controller.moves and wall.worst.verdict != Verdict.STABLE:
        reason = "left out: they are of constant delays, but the delay moves"
    for name, (method, summarise) in _MEASURES.items() if not reason else ():
        is_known = name != "chatter" or encoder is not None
        if name not in wanted.measures or not (is_known and (in_full or name in printed)):
            continue
        if not (is_unstable and name in of_stable):
            loops = of_worst.get(name, wall.loops)
            found = [method(loop, *wall.gains, **options.get(name, {})) for loop in loops]
            each = tree_map(lambda *parts: np.stack(parts), *found)
            answers |= summarise(wall, loops, each)
        if name == "margins" and (in_full or not wall.worst.worst_delays):
            answers |= _stable_around(wall)
    measures = _measures_are(wall) if answers else reason if wanted.measures else None
    values = {**wall.worst.values, "measures_are": measures, **answers, "simulated": felt}
    return GainAnswer(values, is_stable=wall.worst.is_stable)


def _walls_of(scene: Scene) -> list[_Wall]:
    loops = loops_over_delays(scene)
    if hands_of(scene) and (scene.controller.has_one_delay or scene.controller.moves):
        every = (corner_loops(with_delay(scene, loop.delay)) for loop in loops)
        loops = list(dict.fromkeys([*loops, *(loop for corners in every for loop in corners)]))
    gains = list(walls_of(scene).values())
    return [
        _Wall(scene, pair, list(dict.fromkeys([*loops, held])), verdict, held)
        for pair, (verdict, held) in zip(gains, worst_on(scene, gains), strict=True)
    ]


def _measures_are(wall: _Wall) -> str | None:
    """Of how many hands and delays the measures are the worst; None of a single loop."""
    loops, controller = len(wall.loops), wall.scene.controller
    delays = len({loop.delay for loop in wall.loops})
    kinds = ["hands"] * (delays < loops) + ["constant delays"] * (delays > 1)
    lost = ", no sample lost" if controller.moves else ""
    return f"the worst of {loops} {' and '.join(kinds)}{lost}" if loops > 1 or lost else None


def _hand_of(wall: _Wall, loop: HapticLoop) -> OneHand | None:
    return None if wall.worst.worst_hand is None else held_by(loop, wall.scene)


def _stable_around(wall: _Wall) -> dict[str, Any]:
    """The stable values of one gain at the other one, for all loops."""
    stable, rows = StableGains(wall.loops[0], besides=(*wall.loops[1:],)), dict[str, Any]()
    for own, value, fixed, at in (
        (*pair, *other)
        for pair, other in permutations(zip(HapticLoop.gains, wall.gains, strict=True))
    ):
        try:
            rows |= stable.row(fixed, at, value)
        except ValueError:
            rows[f"{own.name}_limits"] = "not resolved"
    return rows


def _least_margins(_: _Wall, __: list[HapticLoop], margins: LoopMargins) -> dict[str, Any]:
    """The change that each quantity allows alone: the least over the hands."""
    names = "stiffness_gain", "damping_gain", "extra_delay"
    # NaN, of a hand with which the wall is not stable, goes through.
    return {name: float(getattr(margins, name).min()) for name in names}


def frequency_answer(found: LoopFrequencyMargins, *, in_full: bool) -> FrequencyMargins:
    """The worst of some margins over frequency."""
    answer = dict[str, Any]()
    for name, own, worst in (
        ("phase_margin", found.phase, np.argmin),
        ("peak_sensitivity", found.sensitivity, np.argmax),
        ("gain_margin", found.largest_gain, np.argmin),
        ("least_gain", found.least_gain, np.argmax),
        ("delay_margin", found.delay, np.argmin),
        ("peak_complementary", found.complementary, np.argmax),
        ("disk_margin", found.disk, np.argmin),
    ):
        value, _, place = (float(np.ravel(each)[worst(own.value)]) for each in own)  # NaN first
        if in_full or name in ("phase_margin", "peak_sensitivity"):
            answer[name] = max(value, 0.0)
            answer[f"{name}_at"] = place if place >= 0.0 and name != "least_gain" else None
    return FrequencyMargins(answer)


def _radius(_: _Wall, __: list[HapticLoop], radius: SpectralRadius) -> dict[str, Any]:
    worst = int(np.argmax(radius.value))
    own = {"spectral_radius": radius.value, "radius_error": radius.error}
    return {name: float(values[worst]) for name, values in own.items()}


def _longest(
    wall: _Wall, loops: list[HapticLoop], settlings: list[MotionSettling]
) -> dict[str, Any]:
    numbers = [_slowest(settling) for settling in settlings]
    two, five = (
        MotionSettling(settling.value[index], settling.status[index])
        for index, settling in zip(numbers, settlings, strict=True)
    )
    return {
        "settling_time_2_percent": settled(two),
        "settling_time_5_percent": settled(five),
        "settling_status": SettlingStatus(int(two.status)),
        "slowest_hand": _hand_of(wall, loops[numbers[0]]),
    }


def _slowest(settling: MotionSettling) -> int:
    """Return the number of the hand that takes longest: an unstable one, or one not proved."""
    values, status = np.asarray(settling.value), np.asarray(settling.status)
    rank = np.select(
        [status == SettlingStatus.UNSTABLE, status == SettlingStatus.SETTLED], [2, 0], 1
    )
    return int(np.lexsort((values, rank))[-1])


def settled(settling: MotionSettling) -> float:
    """Return a settling time in s; infinite for an unstable loop, NaN where none is proved."""
    status = int(settling.status)
    if status == SettlingStatus.SETTLED:
        return float(settling.value)
    return inf if status == SettlingStatus.UNSTABLE else nan


def _least_damped(wall: _Wall, loops: list[HapticLoop], modes: Mode) -> dict[str, Any]:
    ratios = np.asarray(modes.damping_ratio)
    index = int(np.argmin(np.where(np.isnan(ratios), inf, ratios)))
    return {
        "damping_ratio": float(ratios[index]),
        "frequency": float(modes.frequency[index]),
        "least_damped_hand": _hand_of(wall, loops[index]),
    }


def _chatter(_: _Wall, __: list[HapticLoop], amplitude: Amplitudes) -> dict[str, Any]:
    return {
        "chatter_at_most": float(amplitude.position.max()),
        "force_chatter_at_most": float(amplitude.force.max()),
        "force_per_count": float(amplitude.force_per_count[0]),
    }


def _jitter(wall: _Wall, _: list[HapticLoop], margin: Floats) -> dict[str, Any]:
    """The range in which the delay may vary above that of the scene, with every hand."""
    controller, extra = wall.scene.controller, float(margin[0])
    if not controller.has_one_delay:  # the margin of the shortest, rounded down, less the range
        low, high = controller.delays
        spent = high - low + controller.lost_samples * controller.sample_time
        extra = max(extra * (1.0 - 8.0 * EPS) - spent * (1.0 + 8.0 * EPS), 0.0)
    words = ["beyond the range"] * (not controller.has_one_delay)
    words += ["proved for every hand"] * (extra > 0.0 and hands_of(wall.scene) is not None)
    return {"extra_delay_moving": extra or nan, "moving_is": ", ".join(words) or None}


_HORIZON = 2**17  # samples within which settling is looked for


_MEASURES: dict[str, tuple[Callable[..., Any], Callable[..., dict[str, Any]]]] = {
    "margins": (HapticLoop.margins, _least_margins),
    "frequency": (
        wall_frequency_margins,
        lambda wall, _, found: {
            "margins_over_frequency": frequency_answer(found, in_full=wall.scene.wanted.frequency)
        },
    ),
    "distance": (
        HapticLoop.boundary_distance,
        lambda *own: {"distance_to_boundary": float(own[-1].min())},
    ),
    "radius": (HapticLoop.spectral_radius, _radius),
    "settling": (
        lambda loop, *gains: [
            loop.settling_time(*gains, level=level, horizon=_HORIZON) for level in (0.02, 0.05)
        ],
        _longest,
    ),
    "oscillation": (HapticLoop.oscillation, _least_damped),
    "chatter": (HapticLoop.amplitude, _chatter),
    "jitter": (HapticLoop.jitter_margin, _jitter),
}
"""The method of a loop that gives a measure, and how it is summarised over the hands."""
