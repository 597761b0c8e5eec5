"""The walls of a scene: verdict, margins, radius, settling and chatter, with proofs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from math import inf, isnan, nan
from typing import Any

import numpy as np

from jaxstab.answers import GainAnswer, Template, Units, line
from jaxstab.app.scene import loops
from jaxstab.app.scene.answers import basis_of
from jaxstab.app.scene.contact import contacts_or_reasons
from jaxstab.app.scene.limits import StableGains
from jaxstab.app.scene.scene import Scene
from jaxstab.arrays import take, tree_map
from jaxstab.conventions import Verdict
from jaxstab.loop import FrequencyMargins, Gains, HapticLoop
from jaxstab.loop.answers import Answers
from jaxstab.loop.margins import wall_frequency_margins
from jaxstab.loop.usable import missed_margins
from jaxstab.loop.wanted import WantedMargins
from jaxstab.motion import Settling as MotionSettling
from jaxstab.motion import SettlingStatus
from jaxstab.rounding import EPS

# What a check says in short, of each pair of gains.

_RANGES = "verdicts cover all of them; other numbers are the worst at their ends"
_WALL = "{stiffness} at {damping}: {verdict}"
_WALLS = (
    Template("ranges", ("{ranges}",)),
    Template(
        "wall {}",
        (
            f"{_WALL}: {{hands_are}}",
            f"{_WALL} for every {{every}}",
            f"{_WALL}[ with {{worst_hand}}][; {{worst_delays}}]",
        ),
        "walls",
    ),
)
_COLUMNS = "walls.*.verdict", "walls.*.stiffness_gain", "walls.*.settling_time_2_percent"


def stable_row(name: str, unless: str, *gains: tuple[str, str, str]) -> Template:
    """The row of the stable values of two gains: of each the name, a symbol and the other one."""
    words = (
        f"[{symbol} from {{{own}_limits!}}|{symbol} is {{{own}_limits}}|no {symbol}]"
        f"[, also {{other_{own}}}] at {other}"
        for own, symbol, other in gains
    )
    return Template(name, ("; ".join(words),), when=f"{gains[0][0]}_limits", unless=unless)


MARGINS_ROW = Template("margins wanted", ("{usable}",))


def usable_in_words(
    tried: Sequence[Answers], pair: tuple[float, float], margins: Mapping[str, Any]
) -> tuple[str, bool]:
    """Whether a stable pair of gains has margins with each of some loops; and that as a truth."""
    wanted, missed, is_known = WantedMargins.checked(**margins), dict[str, None](), True
    for loop in tried:
        found = missed_margins(loop, pair, wanted)
        is_known = is_known and found is not None
        missed |= dict.fromkeys(found or [])
    if missed:
        return f"misses {' and '.join(missed)}", False
    return (f"has {wanted.words}", True) if is_known else (f"not proved: {wanted.words}", False)


_OF_WALL = (
    Template("measures", ("{left_out}",)),
    Template(
        "gain margins",
        (
            "K may grow by [a factor of {stiffness_gain!}|{stiffness_gain} factor], "
            "B by [a factor of {damping_gain!}|{damping_gain} factor]",
        ),
        when="stiffness_gain",
    ),
    Template("extra delay", ("{extra_delay} (constant)[, {varying} (varying)]",)),
    stable_row(
        "stable walls",
        "stiffness_gain",
        ("stiffness", "K", "{damping}"),
        ("damping", "B", "{stiffness}"),
    ),
    Template("", of="margins_over_frequency"),
    MARGINS_ROW,
    Template("passive", ("{passive}",)),
    Template("settling time (2 %)", ("not proved within {horizon}", "{settling_time_2_percent}")),
    Template(
        "encoder chatter",
        ("at most {chatter_at_most!} and {force_chatter_at_most}", "{chatter_at_most}"),
    ),
    Template("contact", ("{simulated}",), unless="worst_delays"),
)


class WorstMargins(GainAnswer):
    """The distances of the open loop from -1, and where they are: each the worst over some hands.

    Each has one line with its frequency.
    """

    has_heading = False

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """A line for each number, or for two."""
        return [line(indent, *row) for row in self._rows(self.short, {}, units)]


# The walls of a scene.


def check_walls(scene: Scene, *, in_full: bool = True) -> GainAnswer:
    """The verdict on each wall and the requested measures, at their worst; at least one wall.

    The worst hand is that of the largest radius, which is given for it; every other measure is the
    worst over the hands that are tried, but for the jitter, which is proved for every hand. A wall
    that misses a margin that is wanted, with one of them, does not count as stable. Not
    ``in_full`` the answer has what its short text says.
    """
    scene.require_walls()
    if margins := scene.wanted.margins:
        scene.controller.require_one_delay(f"a check of {' and '.join(margins)}")
    felt = contacts_or_reasons(scene) if scene.wanted.measures else {}
    constant = (loops.with_delay(scene, delay) for delay in dict.fromkeys(scene.controller.delays))
    corners = [loop for own in constant for loop in loops.corner_loops(own)]
    found = loops.worst_on(scene, [*loops.walls_of(scene).values()])
    checked, controller = dict[str, GainAnswer](), scene.controller
    for name, (wall, held) in zip(scene.walls, found, strict=True):
        tried, words, measured = list(dict.fromkeys([*corners, held])), None, dict[str, Any]()
        remarks = {**wall.remarks}
        if wall.drifts:
            words = (
                "left out: nothing holds the position; limits --at-stiffness 0 gives the dampings"
            )
            remarks["left_out"] = words if scene.wanted.measures else None
        elif controller.moves and wall.verdict != Verdict.STABLE:
            words = "left out: they are of constant delays, but the delay moves"
        else:
            measured, more = _measured(scene, wall, tried, held, in_full=in_full)
            remarks |= more
        if measured:
            delays, count = len({loop.delay for loop in tried}), len(tried)
            kinds = ["hands"] * (delays < count) + ["constant delays"] * (delays > 1)
            lost = ", no sample lost" * controller.moves
            of_many = f"the worst of {count} {' and '.join(kinds)}{lost}"
            words = of_many if count > 1 or lost else None
        told = {"measures_are": words if scene.wanted.measures else None}
        is_usable = True
        if controller.has_one_delay and wall.verdict == Verdict.STABLE:
            told["passive"] = _passive_in_words(corners[0], wall.stiffness, wall.damping)
        if margins and wall.verdict == Verdict.STABLE:
            pair = wall.stiffness, wall.damping
            told["usable"], is_usable = usable_in_words(tried, pair, margins)
        values = {**wall.values, **told, **measured, "simulated": felt.get(name)}
        checked[name] = GainAnswer(
            values, is_stable=wall.is_stable and is_usable, remarks=remarks, short=_OF_WALL
        )
    ranges = None
    if not controller.has_one_delay or loops.hands_of(scene) is not None:
        ranges = _RANGES + ", of constant delays" * (not controller.has_one_delay)
    values = {"inputs": basis_of(scene), "walls": checked}
    return GainAnswer(values, remarks={"ranges": ranges}, short=_WALLS, columns=_COLUMNS)


def _passive_in_words(loop: HapticLoop, stiffness: float, damping: float) -> str | None:
    """Whether a wall is passive, which no hand changes; None where no wall is known to be."""
    words = {
        True: "yes: stable with every passive hand",
        False: "no: some passive hand can draw energy from it",
        None: "not proved",
    }
    try:
        return words[loop.is_passive(stiffness, damping)]
    except ValueError:
        return None


_HORIZON = 2**17  # samples within which settling is looked for


def _measured(
    scene: Scene,
    wall: loops.JudgedWall,
    tried: list[HapticLoop],
    worst_loop: HapticLoop,
    *,
    in_full: bool,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The requested measures of a wall, each the worst over the hands and delays of its loops.

    Beside them stand remarks.
    """
    controller, wanted, gains = scene.controller, scene.wanted, Gains(wall.stiffness, wall.damping)
    printed = {"margins", "frequency", "settling", "chatter", *["jitter"] * controller.moves}
    of_stable = {"margins", "frequency", "jitter"} if in_full else printed | {"jitter"}
    asked = {name for name in wanted.measures if in_full or name in printed}
    answers, remarks = dict[str, Any](), dict[str, Any]()

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
        if two.status == SettlingStatus.NOT_SETTLED:
            remarks["horizon"] = _HORIZON * controller.sample_time
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
            remarks["varying"] = extra or nan
        words += ["proved for every hand"] * (extra > 0.0 and every["hands"] is not None)
        answers |= {"extra_delay_moving": extra or nan, "moving_is": ", ".join(words) or None}
    return answers, remarks


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


_PHASE = "{phase_margin}[ at {phase_margin_at}]"
_PEAK = ", peak sensitivity {peak_sensitivity}[ at {peak_sensitivity_at}]"


def frequency_answer(found: FrequencyMargins, *, in_full: bool) -> WorstMargins:
    """The worst of some margins over frequency."""
    answer, rows = dict[str, Any](), list[Template]()
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
        rows.append(Template(name.replace("_", " "), (f"{{{name}}}[ at {{{name}_at}}]",)))
    if not in_full:
        rows = [Template("phase margin", (_PHASE + _PEAK * (not isnan(answer["phase_margin"])),))]
    return WorstMargins(answer, short=rows)


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
