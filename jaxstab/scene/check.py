"""The walls of a scene: verdict, margins, radius, settling and chatter, with proofs."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING, ROUND_FLOOR
from math import inf, isinf, isnan, nan
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import tree_map
from jaxstab.conventions import Verdict
from jaxstab.exact import LineStatus
from jaxstab.loop import FrequencyMargins as LoopFrequencyMargins
from jaxstab.loop import Gains, HapticLoop
from jaxstab.loop import Margins as LoopMargins
from jaxstab.loop.frequency import wall_frequency_margins
from jaxstab.motion import Amplitude as Amplitudes
from jaxstab.motion import Oscillation as Mode
from jaxstab.motion import Settling as MotionSettling
from jaxstab.motion import SettlingStatus
from jaxstab.numbers import without_noise
from jaxstab.point import SpectralRadius
from jaxstab.rounding import EPS
from jaxstab.scene.answers import (
    LABELS,
    Answer,
    Basis,
    Bound,
    Frequency,
    Number,
    Part,
    Quantity,
    basis_of,
    line,
)
from jaxstab.scene.contact import Simulated, contacts_or_reasons
from jaxstab.scene.limits import inner_ends, numbered, stable_in_words
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

_NOT_PROVED = "not proved"
Amplitude = Annotated[float, Quantity("m", 3, ROUND_CEILING, _NOT_PROVED)]
SettlingTime = Annotated[float, Quantity("s", infinite="never", absent=_NOT_PROVED)]
SpareTime = Annotated[float, Quantity("s", 4, ROUND_FLOOR, "any", _NOT_PROVED)]
SpareGain = Annotated[float, Quantity("", 4, ROUND_FLOOR, "any", _NOT_PROVED)]
_Peak = Annotated[float, Quantity("", 4, ROUND_CEILING, absent=_NOT_PROVED)]
_Force = Annotated[float, Quantity("N", 3, ROUND_CEILING, _NOT_PROVED)]
_Distance = Annotated[float, Quantity(rounding=ROUND_FLOOR, absent="not known")]
_Limits = tuple[float, float]
_NONE = "none is stable"
_StableStiffnesses = Annotated[_Limits, Quantity("N/m", 4, absent=_NONE)]
_StableDampings = Annotated[_Limits, Quantity("N s/m", 4, absent=_NONE)]


@dataclass(frozen=True)
class FrequencyMargins(Part):
    """The distances of the open loop from -1, and where they are: each the worst over some hands.

    Without a gain margin it is one line, of two numbers.
    """

    phase_margin: Annotated[float, Quantity("degrees", 4, ROUND_FLOOR, "any", _NOT_PROVED)]
    phase_margin_at: Frequency | None
    peak_sensitivity: _Peak
    peak_sensitivity_at: Frequency | None
    gain_margin: SpareGain | None
    gain_margin_at: Frequency | None
    least_gain: _Peak | None
    delay_margin: SpareTime | None
    delay_margin_at: Frequency | None
    peak_complementary: _Peak | None
    peak_complementary_at: Frequency | None
    disk_margin: Annotated[float, Quantity("", 4, ROUND_FLOOR, absent=_NOT_PROVED)] | None
    disk_margin_at: Frequency | None

    def rows(self, units: Units = Units.LINE) -> dict[str, str]:
        """The words of each number, the frequency behind it."""
        rows = dict[str, str]()
        for path, _, words in self.leaves("", units):
            name, is_place, _ = path.partition("_at")
            label = LABELS.get(name, name.replace("_", " "))
            rows[label] = f"{rows[label]} at {words}" if is_place else words
        if self.gain_margin is None:
            phase, peak = rows.values()
            words = phase if isnan(self.phase_margin) else f"{phase}, peak sensitivity {peak}"
            rows = {"phase margin": words}
        return rows

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """A line for each number."""
        return [line(indent, name, words) for name, words in self.rows(units).items()]


@dataclass(frozen=True)
class WallCheck(WallVerdict):
    """The verdict on a wall, and the requested measures.

    The worst hand is that of the largest radius, which is given for it; every other measure is the
    worst over the hands that are tried, but for the jitter, which is proved for every hand.
    """

    measures_are: str | None
    # The change that each quantity allows alone: the least over the hands.
    stiffness_gain: SpareGain | None = None
    damping_gain: SpareGain | None = None
    stiffness_limits: Annotated[_Limits, Quantity("N/m", 4, absent=_NOT_PROVED)] | None = None
    damping_limits: Annotated[_Limits, Quantity("N s/m", 4, absent=_NOT_PROVED)] | None = None
    extra_delay: SpareTime | None = None
    # Beside a wall that is not stable: all K at its B, all B at its K, for the hands at once. Of
    # several intervals the lowest comes first.
    stable_at_its_damping: _StableStiffnesses | str | None = None
    other_stiffnesses: dict[str, _StableStiffnesses] = field(default_factory=dict)
    stable_at_its_stiffness: _StableDampings | str | None = None
    other_dampings: dict[str, _StableDampings] = field(default_factory=dict)
    margins_over_frequency: FrequencyMargins | None = None
    # The least distance to the edge of stability, in units of alpha and beta.
    distance_to_boundary: _Distance | None = None
    spectral_radius: Number | None = None
    radius_error: Bound | None = None
    # The longest times, infinite for an unstable wall, and the hand that takes longest to 2 %.
    settling_time_2_percent: SettlingTime | None = None
    settling_time_5_percent: SettlingTime | None = None
    settling_status: SettlingStatus | None = None
    slowest_hand: OneHand | None = None
    # The slowest mode, with the hand for which it is damped least.
    damping_ratio: Number | None = None
    frequency: Frequency | None = None
    least_damped_hand: OneHand | None = None
    # The largest position and force, at all times, to which the encoder's rounding drives.
    chatter_at_most: Amplitude | None = None
    force_chatter_at_most: _Force | None = None
    force_per_count: Annotated[float, Quantity("N", 3)] | None = None
    # The excess of the delay over the scene's longest if it changes from sample to sample.
    extra_delay_moving: SpareTime | None = None
    moving_is: str | None = None
    simulated: Simulated | str | None = None

    def rows(self, name: str, inputs: Basis) -> Iterator[tuple[str, str]]:
        """At most eight lines, or some more with all margins over frequency."""
        said = {path: words for path, _, words in self.leaves("", inputs.units)}
        verdict, delays = self._verdict(said["verdict"], inputs.units), inputs.range_of_delays
        yield f"wall {name}", f"{said['stiffness']} at {said['damping']}: {verdict}"
        if self.drifts and self.measures_are:
            yield "  measures", self.measures_are
        if self.verdict == Verdict.UNSTABLE and delays:
            return  # all else is of constant delays
        if self.stable_at_its_damping is not None:
            beside = (("K", "stiffness", "damping"), ("B", "damping", "stiffness"))
            ends = (said.get(f"stable_at_its_{fixed}_low") for *_, fixed in beside)
            places = (
                stable_in_words(letter, own, said[fixed], words, said)
                for (letter, own, fixed), words in zip(beside, ends, strict=True)
            )
            yield "  stable walls", "; ".join(places)
        elif self.stiffness_gain is not None:
            growth = [said[f"{gain}_gain"] for gain in ("stiffness", "damping")]
            growth = [f"a factor of {x}" if x[0].isdigit() else f"{x} factor" for x in growth]
            yield "  gain margins", "K may grow by {}, B by {}".format(*growth)
            moving = said.get("extra_delay_moving") if delays else None
            words = f"{said['extra_delay']} (constant)"
            yield "  extra delay", f"{words}, {moving} (varying)" if moving else words
        if self.margins_over_frequency:
            rows = self.margins_over_frequency.rows(inputs.units)
            yield from ((f"  {name}", words) for name, words in rows.items())
        if self.settling_status is not None:
            is_open = self.settling_status == SettlingStatus.NOT_SETTLED
            horizon = Quantity("s", 3).words(_HORIZON * inputs.sample_time)
            words = f"not proved within {horizon}" if is_open else said["settling_time_2_percent"]
            yield "  settling time (2 %)", words
        if self.chatter_at_most is not None:
            most = said["chatter_at_most"], said["force_chatter_at_most"]
            is_endless = isinf(self.chatter_at_most)
            yield "  encoder chatter", most[0] if is_endless else "at most {} and {}".format(*most)
        if self.simulated:
            felt = self.simulated
            yield "  contact", felt if isinstance(felt, str) else felt.in_short(inputs.units)

    def _verdict(self, words: str, units: Units) -> str:
        hand = self.worst_hand
        if self.hands_are:
            return f"{words}: {self.hands_are}"
        if self.verdict == Verdict.UNSTABLE:
            cause = f"{words} with {hand.in_words(units)}" if hand else words
            return "; ".join(filter(None, [cause, self.worst_delays]))
        kinds = ["hand", *[units.moved] * (hand.device_mass is not None)] if hand else []
        return f"{words} for every {' and '.join(kinds)}" if hand else words


@dataclass(frozen=True)
class Check(Answer):
    """The answers about each wall, by its name."""

    inputs: Basis
    walls: dict[str, WallCheck]

    @property
    def all_stable(self) -> bool:
        """True if every wall is proved stable with every hand."""
        return all(wall.is_stable for wall in self.walls.values())

    def in_short(self) -> str:
        """Notes that are easily overlooked, and the main answers of each wall."""
        rows, delays = [*self.inputs.facts().items()], self.inputs.range_of_delays
        if delays or any(wall.worst_hand for wall in self.walls.values()):
            words = "verdicts cover all of them; other numbers are the worst at their ends"
            rows.append(("ranges", words + ", of constant delays" * (delays is not None)))
        for name, wall in self.walls.items():
            rows += wall.rows(name, self.inputs)
        return table_text(rows)


@dataclass(frozen=True)
class _Wall:
    """A wall of a scene, the loops with the hands at the corners of its range and the worst."""

    scene: Scene
    gains: Gains
    loops: list[HapticLoop]
    worst: WallVerdict
    worst_loop: HapticLoop


def check_walls(scene: Scene, *, in_full: bool = True) -> Check:
    """The verdict on each wall and the requested measures, at their worst; at least one wall.

    Not ``in_full`` it has of these what ``Check.in_short`` prints.
    """
    scene.require_walls()
    felt = contacts_or_reasons(scene) if scene.wanted.measures else {}
    walls = zip(scene.walls, _walls_of(scene), strict=True)
    checked = {name: _checked(wall, felt.get(name), in_full=in_full) for name, wall in walls}
    return Check(basis_of(scene), checked)


def _checked(wall: _Wall, felt: Simulated | str | None, *, in_full: bool) -> WallCheck:
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
        elif name == "margins" and (in_full or not wall.worst.worst_delays):
            answers |= _stable_around(wall)
    measures = _measures_are(wall) if answers else reason if wanted.measures else None
    return WallCheck(**vars(wall.worst), measures_are=measures, **answers, simulated=felt)


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
    """The stable walls beside one that is not stable."""
    first, *stiffnesses = _stable_beside(wall.gains.damping, wall.loops, "stiffness_intervals")
    second, *dampings = _stable_beside(wall.gains.stiffness, wall.loops, "damping_intervals")
    return {
        "stable_at_its_damping": first,
        "other_stiffnesses": numbered(stiffnesses),
        "stable_at_its_stiffness": second,
        "other_dampings": numbered(dampings),
    }


def _least_margins(_: _Wall, __: list[HapticLoop], margins: LoopMargins) -> dict[str, Any]:
    names = "stiffness_gain", "damping_gain", "extra_delay"
    # NaN, of a hand with which the wall is not stable, goes through.
    least = {name: float(getattr(margins, name).min()) for name in names}
    limits = {"stiffness": margins.stiffness, "damping": margins.damping}
    return least | {f"{name}_limits": _common(own) for name, own in limits.items()}


def _stable_beside(gain: float, loops: list[HapticLoop], method: str) -> list[Any]:
    """The gains beside another one, from 0 on, with which all loops are stable; NaN for none.

    A single text where they are not resolved.
    """
    common = [(0.0, inf)]
    for loop in loops:
        line = getattr(loop, method)(gain)
        if line.status != LineStatus.PROVED:
            return ["not resolved"]
        ends = inner_ends(line)
        pairs = ((max(a, c), min(b, d)) for a, b in common for c, d in ends)
        common = [(low, high) for low, high in pairs if low < high]
    return common or [(nan, nan)]


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
        is_shown = in_full or name in ("phase_margin", "peak_sensitivity")
        answer[name] = max(value, 0.0) if is_shown else None
        answer[f"{name}_at"] = place if is_shown and place >= 0.0 else None
    del answer["least_gain_at"]
    return FrequencyMargins(**answer)


def _common(limits: Float64[np.ndarray, "hand 2"]) -> tuple[float, float]:
    """Return the interval that is in all intervals; an end that is 0 but for rounding is 0."""
    low, high = limits[:, 0].max(), limits[:, 1].min()
    return float(without_noise(low, high - low)), float(without_noise(high, high - low))


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
