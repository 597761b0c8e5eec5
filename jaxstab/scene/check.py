"""The walls of a scene: verdict, margins, radius, settling and chatter, with proofs."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import permutations
from math import inf, isinf, isnan, nan
from typing import Any

import numpy as np

from jaxstab.arrays import take, tree_map
from jaxstab.conventions import Verdict
from jaxstab.loop import FrequencyMargins as LoopFrequencyMargins
from jaxstab.loop import Gains, HapticLoop
from jaxstab.loop.margins import wall_frequency_margins
from jaxstab.motion import Settling as MotionSettling
from jaxstab.motion import SettlingStatus
from jaxstab.rounding import EPS
from jaxstab.scene import loops
from jaxstab.scene.answers import LABELS, GainAnswer, Part, Quantity, basis_of, line
from jaxstab.scene.contact import contacts_or_reasons
from jaxstab.scene.limits import StableGains, stable_in_words
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


def check_walls(scene: Scene, *, in_full: bool = True) -> GainAnswer:
    """The verdict on each wall and the requested measures, at their worst; at least one wall.

    The worst hand is that of the largest radius, which is given for it; every other measure is the
    worst over the hands that are tried, but for the jitter, which is proved for every hand. Not
    ``in_full`` the answer has what ``in_short`` prints.
    """
    scene.require_walls()
    felt = contacts_or_reasons(scene) if scene.wanted.measures else {}
    constant = (loops.with_delay(scene, delay) for delay in dict.fromkeys(scene.controller.delays))
    corners = [loop for own in constant for loop in loops.corner_loops(own)]
    found = loops.worst_on(scene, [*loops.walls_of(scene).values()])
    checked, controller = dict[str, GainAnswer](), scene.controller
    for name, (wall, held) in zip(scene.walls, found, strict=True):
        tried, words, measured = list(dict.fromkeys([*corners, held])), None, dict[str, Any]()
        if wall.drifts:
            words = (
                "left out: nothing holds the position; limits --at-stiffness 0 gives the dampings"
            )
        elif controller.moves and wall.verdict != Verdict.STABLE:
            words = "left out: they are of constant delays, but the delay moves"
        elif measured := _measured(scene, wall, tried, held, in_full=in_full):
            delays, count = len({loop.delay for loop in tried}), len(tried)
            kinds = ["hands"] * (delays < count) + ["constant delays"] * (delays > 1)
            lost = ", no sample lost" * controller.moves
            of_many = f"the worst of {count} {' and '.join(kinds)}{lost}"
            words = of_many if count > 1 or lost else None
        told = {"measures_are": words if scene.wanted.measures else None}
        values = {**wall.values, **told, **measured, "simulated": felt.get(name)}
        checked[name] = GainAnswer(values, is_stable=wall.is_stable)
    return GainAnswer({"inputs": basis_of(scene), "walls": checked})


_HORIZON = 2**17  # samples within which settling is looked for


def _measured(
    scene: Scene,
    wall: loops.WallVerdict,
    tried: list[HapticLoop],
    worst_loop: HapticLoop,
    *,
    in_full: bool,
) -> dict[str, Any]:
    """The requested measures of a wall, each the worst over the hands and delays of its loops."""
    controller, wanted, gains = scene.controller, scene.wanted, Gains(wall.stiffness, wall.damping)
    printed = {"margins", "frequency", "settling", "chatter", *["jitter"] * controller.moves}
    of_stable = {"margins", "frequency", "jitter"} if in_full else printed | {"jitter"}
    asked = {name for name in wanted.measures if in_full or name in printed}
    answers = dict[str, Any]()

    def found(name: str, method: Any, among: Any = tried, **options: Any) -> Any:
        """A measure for each loop, stacked; None where it is not asked for."""
        if name not in asked or (wall.verdict == Verdict.UNSTABLE and name in of_stable):
            return None
        return tree_map(
            lambda *parts: np.stack(parts),
            *(method(loop, *gains, **options) for loop in among),
        )

    def hand(number: int) -> loops.OneHand | None:
        return None if wall.worst_hand is None else loops.held_by(tried[number], scene)

    if (margins := found("margins", HapticLoop.margins)) is not None:
        # NaN, of a hand with which the wall is not stable, goes through.
        for name in ("stiffness_gain", "damping_gain", "extra_delay"):
            answers[name] = float(getattr(margins, name).min())
    if "margins" in asked and (in_full or not wall.worst_delays):
        answers |= _stable_around(tried, gains)
    own = found("frequency", wall_frequency_margins, in_full=wanted.frequency)
    if own is not None:
        answers["margins_over_frequency"] = frequency_answer(own, in_full=wanted.frequency)
    if (distance := found("distance", HapticLoop.boundary_distance)) is not None:
        answers["distance_to_boundary"] = float(distance.min())
    of_radius = tried if controller.moves else [worst_loop]
    if (radius := found("radius", HapticLoop.spectral_radius, of_radius)) is not None:
        worst = int(np.argmax(radius.value))
        answers["spectral_radius"] = float(radius.value[worst])
        answers["radius_error"] = float(radius.error[worst])
    settlings = [
        found("settling", HapticLoop.settling_time, level=level, horizon=_HORIZON)
        for level in (0.02, 0.05)
    ]
    if settlings[0] is not None:
        slowest = [*map(_slowest, settlings)]
        two, five = map(take, settlings, slowest)
        answers |= {
            "settling_time_2_percent": settled(two),
            "settling_time_5_percent": settled(five),
            "settling_status": SettlingStatus(int(two.status)),
            "slowest_hand": hand(slowest[0]),
        }
    if (modes := found("oscillation", HapticLoop.oscillation)) is not None:
        ratios = np.asarray(modes.damping_ratio)
        least = int(np.argmin(np.where(np.isnan(ratios), inf, ratios)))
        answers |= {
            "damping_ratio": float(ratios[least]),
            "frequency": float(modes.frequency[least]),
            "least_damped_hand": hand(least),
        }
    step = scene.device.encoder.resolution if scene.device.encoder else None
    chatter = found("chatter", HapticLoop.amplitude, encoder=step) if step else None
    if chatter is not None:
        answers |= {
            "chatter_at_most": float(chatter.position.max()),
            "force_chatter_at_most": float(chatter.force.max()),
            "force_per_count": float(chatter.force_per_count[0]),
        }
    # The range in which the delay may vary above that of the scene, with every hand.
    shortest = [replace(worst_loop, delay=controller.delays[0])]
    every: Any = {"hands": loops.hands_of(scene), "mass": loops.masses_of(scene)}
    if (jitter := found("jitter", HapticLoop.jitter_margin, shortest, **every)) is not None:
        extra, words = float(jitter[0]), list[str]()
        if not controller.has_one_delay:  # the margin of the shortest, rounded down, less the range
            low, high = controller.delays
            spent = high - low + controller.lost_samples * controller.sample_time
            extra = max(extra * (1.0 - 8.0 * EPS) - spent * (1.0 + 8.0 * EPS), 0.0)
            words.append("beyond the range")
        words += ["proved for every hand"] * (extra > 0.0 and every["hands"] is not None)
        answers |= {"extra_delay_moving": extra or nan, "moving_is": ", ".join(words) or None}
    return answers


def _stable_around(every: list[HapticLoop], gains: Gains) -> dict[str, Any]:
    """The stable values of one gain at the other one, for all loops."""
    stable, rows = StableGains(every[0], besides=(*every[1:],)), dict[str, Any]()
    for own, value, fixed, at in (
        (*pair, *other) for pair, other in permutations(zip(HapticLoop.gains, gains, strict=True))
    ):
        try:
            rows |= stable.row(fixed, at, value)
        except ValueError:
            rows[f"{own.name}_limits"] = "not resolved"
    return rows


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


def _slowest(settling: MotionSettling) -> int:
    """Return the number of the hand that takes longest: an unstable one, or one not proved."""
    values, status = np.asarray(settling.value), np.asarray(settling.status)
    rank = np.select(
        [status == SettlingStatus.UNSTABLE, status == SettlingStatus.SETTLED], [2, 0], 1
    )
    return int(np.lexsort((values, rank))[-1])


def settled(settling: MotionSettling) -> float:
    """Return a settling time in s; infinite for an unstable loop, NaN where none is proved."""
    known = {SettlingStatus.SETTLED: float(settling.value), SettlingStatus.UNSTABLE: inf}
    return known.get(SettlingStatus(int(settling.status)), nan)
