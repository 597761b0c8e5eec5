"""The limits of gains: their largest and least values, the stable ones of a row, and around pairs.

``StableGains`` has them for the walls of a held device and for any other two gains; a limit is
printed as a stable pair, proved. With margins they are those of usable gains. ``scene_limits``
gives those of walls beside the simple rules.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from math import inf, isfinite, isnan, nan
from typing import Any

from jaxstab import paper
from jaxstab.answers import (
    BUT_FOR_DRIFT,
    LIMIT_DIGITS,
    GainAnswer,
    Quantity,
    Template,
    Units,
    formats_of,
    printed_pair,
)
from jaxstab.app.scene import loops
from jaxstab.app.scene.answers import basis_of
from jaxstab.app.scene.scene import Scene
from jaxstab.conventions import Verdict
from jaxstab.exact import LineStatus, StableLine
from jaxstab.loop import Gains, HapticLoop, Limits
from jaxstab.loop.answers import Answers
from jaxstab.loop.region import ABOVE_0, other_gain, printed_limit
from jaxstab.loop.usable import UsableLimits
from jaxstab.loop.wanted import margins_in_words
from jaxstab.model import Velocity
from jaxstab.model.gain import Gain
from jaxstab.region import RegionStatus
from jaxstab.shown import Printed, exact_text, shortened

_SEE_BELOW = " (all hands: see below)"


@dataclass(frozen=True)
class StableGains:
    """The stable gains of a loop, and of others beside it, times a factor of safety."""

    loop: Answers
    safety: float = 1.0
    besides: tuple[Answers, ...] = ()  # loops for which rows are to be stable, too
    units: Units = Units.LINE
    are_walls: bool = False  # with intervals below 0, beside the linear rule
    margins: Mapping[str, Any] = field(default_factory=dict)  # as of ``is_usable``

    @property
    def certainty(self) -> str | None:
        """The certainty of a limit that is proved, if it is to be said."""
        return f"with {margins_in_words(self.margins)}" if self.margins else None

    @cached_property
    def _usable(self) -> UsableLimits:
        return self.loop.limits(**self.margins)

    def verdict(self, first: float, second: float) -> Verdict | str:
        """The verdict on two gains; of a device that nothing holds it may be but for a drift."""
        return loops.verdict_on(self.loop, first, second)

    @property
    def formats(self) -> dict[str, Quantity]:
        """The formats of what answers say of the gains."""
        return formats_of({gain.name: self.units.unit(gain.unit) for gain in self.loop.gains})

    def other(self, own: Gain) -> Gain:
        """The other gain."""
        return next(gain for gain in self.loop.gains if gain != own)

    def is_stable(self, own: Gain, value: float, other: float) -> bool:
        """True if a value of a gain, and one of the other, are stable."""
        pair = (value, other) if own == self.loop.gains[0] else (other, value)
        if self.margins:
            names = (gain.name for gain in self.loop.gains)
            gains: Any = dict(zip(names, pair, strict=True))
            return bool(self.loop.is_usable(**gains, **self.margins))
        return self.verdict(*pair) in (Verdict.STABLE, BUT_FOR_DRIFT)

    def found(self, own: Gain) -> tuple[float, float]:
        """The limit of a gain, and the other gain there; RuntimeError where it is not resolved."""
        if self.margins:
            pairs = self._usable[:2], self._usable[2:4]
            return pairs[self.loop.gains.index(own)]
        region = self.loop.region()
        if region.status == RegionStatus.UNRESOLVED:
            raise RuntimeError(
                "the stable region was not resolved; change one value a little, or ask for the "
                "intervals of one gain at the other."
            )
        axis = self.loop.gains.index(own)
        point = region.reachable.limit_points[axis]
        return float(point[axis]), float(point[1 - axis])

    def limit(self, own: Gain, value: float, at: float) -> GainAnswer:
        """A limit of a gain times the safety, and the other gain there, as a stable pair."""
        other, is_largest = self.other(own), own.sense == "largest"
        value *= self.safety if is_largest else 1.0 / self.safety
        names = f"{own.sense}_{own.name}", f"at_{other.name}"
        if value == inf:
            return GainAnswer({names[0]: value}, self.formats)
        found = printed_limit(
            self.loop,
            self.loop.gains.index(own),
            value,
            at,
            LIMIT_DIGITS,
            is_stable=partial(self.is_stable, own),
            beside=partial(self.beside, own),
            is_limit=self.safety == 1.0,
        )
        pair, words = (nan, nan), None if isnan(value) else "no pair is proved"
        if isnan(value) and self.margins:
            words = self._usable.none_in_words
        if found and found[0].text == ABOVE_0:
            pair, words = (found[0], nan), "0 itself is not stable"
        elif found:
            pair, words = (found[0].shown, found[1].shown), self.certainty
        values: dict[str, Any] = dict(zip(names, pair, strict=True))
        told = {"certainty": words} if words else {}
        return GainAnswer(values | told, self.formats, is_stable=found is not None)

    def beside(self, own: Gain, value: float, at: float) -> float:
        """The other gain: a given one, or one between the ends of the nearest stable interval."""
        if self.margins:
            return at
        return other_gain(self.loop, self.loop.gains.index(own), value, at)

    def usable(self, margins: Mapping[str, Any]) -> "StableGains":
        """The gains with margins, if there are any: limits of these are what a search finds."""
        if margins and self.safety != 1.0:
            raise ValueError(
                f"wanted.safety is {self.safety:g} beside {' and '.join(margins)}; give one of "
                "them: each keeps a distance."
            )
        return replace(self, margins=margins)

    def largest(self) -> dict[str, GainAnswer]:
        """The limit of each gain, by its name."""
        return {own.name: self.limit(own, *self.found(own)) for own in self.loop.gains}

    def row(self, fixed: Gain, value: float, around: float = nan) -> dict[str, Any]:
        """The stable values of the other gain: first those around one, or small ones."""
        own, every = self.other(fixed), (self.loop, *self.besides)
        lines = [loop.intervals(**{fixed.name: value}, **self.margins) for loop in every]
        found = stable_intervals(lines, self.safety, around)
        least = 0.0 if own.sense == "least" else -inf  # a mass is not negative
        found = [(max(low, least), high) for low, high in found if self.are_walls or high > 0.0]
        first, *others = found or [(nan, nan)]
        values = {f"{own.name}_limits": first, f"other_{own.name}": numbered(others)}
        is_wall = self.are_walls and not self.margins
        has_rule = is_wall and fixed.name == "damping" and loops.is_plain(self.loop)
        return values | ({"linear_rule_stiffness": self.linear_rule(value)} if has_rule else {})

    def linear_rule(self, damping: float) -> float:
        """The largest stiffness of the linear rule at a damping of a wall."""
        loop: Any = self.loop
        beta, delay = loop.beta(damping), loop.delay_samples
        limit = paper.linear_alpha_limit(beta, delta=loop.delta, delay=delay)
        return float(self.safety * loop.stiffness(float(limit)))

    def at(self, fixed: Gain, value: float | None) -> GainAnswer | None:
        """The row at a given value, if there is one, with that."""
        if value is None:
            return None
        given = {f"at_{fixed.name}": Printed(value, exact_text(value))}
        return GainAnswer(given | self.row(fixed, value), self.formats)

    def around(self, pair: Mapping[str, float]) -> GainAnswer:
        """The verdict on a pair of gains, and the stable values of each at the other one.

        It is stable if that is so with the safety, too.
        """
        (first, one), (second, two) = zip(self.loop.gains, pair.values(), strict=True)
        values: dict[str, Any] = {**pair, "verdict": self.verdict(one, two)}
        values |= self.row(second, two, one) | self.row(first, one, two)
        low, high = values[f"{first.name}_limits"]
        is_stable = values["verdict"] == Verdict.STABLE and low <= one <= high
        return GainAnswer(values, self.formats, is_stable or values["verdict"] == BUT_FOR_DRIFT)


def numbered(values: Iterable[Any]) -> dict[str, Any]:
    """Return values by their numbers, from 1 on."""
    return {str(number): value for number, value in enumerate(values, 1)}


def stable_intervals(
    lines: Sequence[StableLine], safety: float, value: float
) -> list[tuple[float, float]]:
    """The intervals that are in all lines, times the safety: that of a value comes first.

    Else that of small gains does, or the farthest. ValueError where they are not resolved.
    """
    if any(line.status == LineStatus.UNDECIDED for line in lines):
        raise ValueError(
            f"the intervals of stable gains were not resolved: {LineStatus.UNDECIDED.words}; "
            "change one value a little."
        )
    common = [(-inf, inf)]
    for line in lines:
        pairs = product(common, line.inner)
        common = [(max(a, c), min(b, d)) for (a, b), (c, d) in pairs if max(a, c) <= min(b, d)]
    scaled = [inwards(low, high, safety) for low, high in common]
    scaled = [(low, high) for low, high in scaled if low <= high] or [(nan, nan)]
    holding = [k for k, (low, high) in enumerate(scaled) if low <= value <= high]
    small = [k for k, (low, high) in enumerate(scaled) if low <= 0.0 < high]
    (first,) = (holding or small or [len(scaled) - 1])[:1]
    return [scaled[first], *scaled[:first], *scaled[first + 1 :]]


def inwards(low: float, high: float, safety: float) -> tuple[float, float]:
    """Return the limits of an interval, each moved inwards by a factor; NaN where nothing stays."""
    # Limits of one sign are moved away from it: a lower one above 0 is divided by the factor.
    low = low * safety if low < 0.0 else low / safety
    high = high * safety if high > 0.0 else high / safety
    return (low, high) if low <= high else (nan, nan)


# What limits say in short: rows, of gains by their names.

SAFETY = Template("safety factor", ("{safety}, applied to every limit",))


def limit_row(
    name: str, of: str, own: str, other: str, noun: str = "gains", more: str = ""
) -> Template:
    """The row of a limit of a gain, such as largest_kp, and of the other one there."""
    pair = f"{{{own}}}[ at {{at_{other}}}][, {{certainty}}]{more}"
    return Template(name, (pair, "{certainty}", f"no stable {noun}"), of)


def usable_rows(own: str, other: str, more: str = "") -> tuple[Template, ...]:
    """The rows of the largest usable value of each gain, and of those at a value of the other."""
    each = (limit_row("", "", f"largest_{name}", at) for name, at in ((own, other), (other, own)))
    limits = [f"{row.ways[0]}{more}" for row in each]
    rows = (given_row(*pair, "usable") for pair in ((own, other), (other, own)))
    return Template(
        "largest usable {}", (*limits, "{certainty}", "none was found"), "usable"
    ), *rows


def given_row(own: str, fixed: str, kind: str = "stable") -> Template:
    """The row of the stable values of a gain at a value of the other one that is asked for."""
    words = f"[{{{own}_limits}}|none] at {{at_{fixed}}}[, also {{other_{own}}}]"
    place = "" if kind == "stable" else f"{kind}_"
    return Template(f"{kind} {own}", (words,), f"{place}at_given_{fixed}")


def pair_row(name: str, of: str, own: str, other: str) -> Template:
    """The row of pairs of gains: how each stands to the limits of its first gain, or a verdict."""
    pair, exception = f"{{{own}}} at {{{other}}}", "[; {exception}]"
    to_limits = f"{pair}, {{standing}}[ of {{{own}_limits}}][, also {{other_{own}}}]"
    verdict = f"{pair}, {{verdict}}[, {{worst_delays}}]"
    return Template(name, (to_limits + exception, verdict + exception), of)


def standing(pair: GainAnswer) -> GainAnswer:
    """A pair of gains with a remark on how it stands to the limits of its first gain, if any."""
    own, *_ = pair.values
    low, high = pair.values.get(f"{own}_limits", (None, None))
    if low is None or pair.verdict == BUT_FOR_DRIFT:
        return pair
    words = f"where no {own} is stable"
    if not isnan(low):
        place = "within" if low < pair.values[own] < high else "outside"
        words = f"{place} the stable range"
    return replace(pair, remarks={"standing": words})


_STIFFEST = partial(limit_row, own="largest_stiffness", other="damping", noun="wall")
_LIMITS = (
    SAFETY,
    _STIFFEST("largest stiffness", "best", more="[, hand {hand}]"),
    _STIFFEST("for all hands", "all_hands"),
    *usable_rows("stiffness", "damping", "[, hand {hand}]"),
    Template(
        "stiffest passive",
        ("{largest_stiffness} at {at_damping}", "no wall: the device has no damper"),
        "passive",
    ),
    Template("note", ("{reached}",)),
)
_HINT = Template("islands", ("{isolated}: see --islands",))
_ISLANDS = _STIFFEST("island {}", "islands", more=", {reached}")
_COLUMNS = (
    "best.largest_stiffness",
    "best.at_damping",
    "all_hands.largest_stiffness",
    "usable.stiffness.largest_stiffness",
    "most_damped.largest_damping",
    "walls.*.verdict",
)
_WALLS = (
    given_row("stiffness", "damping"),
    given_row("damping", "stiffness"),
    pair_row("wall {}", "walls", "stiffness", "damping"),
)


# The walls of a scene.


def scene_limits(scene: Scene, *, islands: bool = False) -> GainAnswer:
    """The largest stiffness and damping, the linear rule, the passive limit, all hands.

    They are those of the hand at its lowest values; ``all_hands`` has all of them. Over a range of
    delays that are constant the best wall, the only limit, is for all hands. Where a safety is
    wanted, all limits are multiplied by it, towards small gains, and islands, which have no such
    side, are left out. The linear rule is that of the difference over one sample, and left out for
    others; passive walls are those of devices of one mass that have a damper. The short text has a
    row for each of the ``islands`` on demand.
    """
    if not scene.controller.has_one_delay:
        return _over_delays(scene)
    loop, wanted = loops.loop_of(scene), scene.wanted
    region, stable = (
        loops.wall_region(loop),
        StableGains(loop, wanted.safety or 1.0, are_walls=True),
    )
    limits, (of_k, of_b) = region.limits(), loop.gains
    usable = stable.usable(wanted.margins) if wanted.margins else None
    is_any_stable = isfinite(limits.stiffness)  # with K >= 0 and B >= 0
    has_rules, is_reached = loops.is_plain(loop), limits.is_reachable or region.is_empty
    isolated = {"reached": "isolated: not connected to zero gains"}
    isles = [
        stable.limit(of_k, *own[:2]).values | stable.limit(of_b, *own[2:4]).values | isolated
        for own in (() if wanted.safety else limits.islands)
    ]
    seen = any(own["largest_stiffness"] > 0.0 and own["at_damping"] >= 0.0 for own in isles)
    return GainAnswer(
        {
            "inputs": basis_of(scene),
            "safety": wanted.safety,
            "hand": loops.at_lowest(scene, _SEE_BELOW),
            "best": stable.limit(of_k, *limits[:2]),
            "all_hands": loops.limit_for_all(scene, stable.safety),
            "most_damped": stable.limit(of_b, *limits[2:4]),
            "usable": usable.largest() if usable else {},
            "reached": None if is_reached else "small gains are not stable",
            "islands": numbered(map(GainAnswer, isles)),
            "passive": _passive(loop, stable.safety),
            "linear_rule": _linear_rule(stable, limits) if has_rules and is_any_stable else None,
            "windows": _other_windows(loop, stable) if scene.controller.velocity is None else {},
            "at_given_damping": stable.at(of_b, wanted.at_damping),
            "at_given_stiffness": stable.at(of_k, wanted.at_stiffness),
            "usable_at_given_damping": usable and usable.at(of_b, wanted.at_damping),
            "usable_at_given_stiffness": usable and usable.at(of_k, wanted.at_stiffness),
            "walls": {
                name: standing(_around(scene, stable, wall))
                for name, wall in loops.walls_of(scene).items()
            },
        },
        remarks={
            "hand": loops.at_lowest(scene, ""),
            "isolated": "stable walls that are not connected to zero gains" if seen else None,
        },
        short=(*_LIMITS, _ISLANDS if islands else _HINT, *_WALLS),
        columns=_COLUMNS,
    )


def _around(scene: Scene, stable: StableGains, wall: Gains) -> GainAnswer:
    """The limits around a wall; other hands are asked only where it is stable at the lowest."""
    found = stable.around(wall._asdict())
    if not found.is_stable or loops.hands_of(scene) is None:
        return found
    ((worst, _),) = loops.worst_on(scene, [wall])
    if worst.is_stable:
        return found
    words = "not proved for every hand"
    if worst.verdict == Verdict.UNSTABLE:
        words = "unstable for some hand: see jaxstab check"
    return replace(found, values=found.values | {"exception": words}, is_stable=False)


def _given(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else shortened(value)


def _over_delays(scene: Scene) -> GainAnswer:
    """Return the stiffest wall that is proved for a range of delays, and the verdicts on walls."""
    wanted, loop, controller = scene.wanted, loops.loops_over_delays(scene)[0], scene.controller
    walls = loops.walls_of(scene)
    given = {name: getattr(wanted, name) for name in ("at_damping", "at_stiffness")}
    for name, value in {**given, **wanted.margins}.items():
        if value is not None:
            raise ValueError(
                f"wanted.{name} is {_given(value)} beside a range of delays; leave it out, or give "
                "one delay."
            )
    unstable, safety, every = None, wanted.safety or 1.0, "constant delay"
    if controller.moves:
        delays, every = loops.delays_of(scene), "sequence of delays"
        moving = loop.limits(delays=controller.delays, lost=controller.lost_samples)
        unstable, found = moving.unstable_stiffness, Gains(moving.stiffness, moving.damping)

        def is_proved_wall(stiffness: float, damping: float) -> bool:
            return bool(loop.verdict(stiffness, damping, **delays) == Verdict.STABLE)

        best = loops.with_safety(found, safety, is_proved_wall)
    else:
        best, _ = loops.wall_for_all(scene, safety)
        every = "hand and constant delay" if loops.hands_of(scene) else every
    verdicts = zip(walls, loops.worst_on(scene, [*walls.values()]), strict=True)
    return GainAnswer(
        {
            "inputs": basis_of(scene),
            "safety": wanted.safety,
            "hand": loops.at_lowest(scene, _SEE_BELOW) if controller.moves else None,
            "best": loops.stiffest_wall(best, every, proved_unstable_at=unstable),
            "all_hands": loops.limit_for_all(scene, safety) if controller.moves else None,
            "walls": {name: verdict for name, (verdict, _) in verdicts},
        },
        remarks={"hand": loops.at_lowest(scene, "") if controller.moves else None},
        short=(*_LIMITS, *_WALLS),
        columns=_COLUMNS,
    )


# The rules of small gains and of passive walls, and other estimators.


def _linear_rule(stable: StableGains, limits: Limits[float]) -> GainAnswer:
    stiffness = stable.linear_rule(limits.at_damping)
    exact, words = stable.safety * limits.stiffness, "an approximation for small gains"
    if exact > 0.0:
        words += f", here {stiffness / exact:.2g} times the exact limit"
    return loops.stiffest_wall(Gains(stiffness, limits.at_damping), linear_rule_is=words)


def _passive(loop: HapticLoop, safety: float) -> GainAnswer | None:
    try:
        stiffest = loop.passive_region().stiffest
    except ValueError:
        return None

    def is_passive(stiffness: float, damping: float) -> bool:
        return bool(loop.is_passive(stiffness, damping))

    stiffness, damping = stiffest.tolist()
    pair = printed_pair(safety * stiffness, damping, is_passive) if stiffness else (nan, nan)
    return replace(loops.stiffest_wall(Gains(*pair)), is_stable=True)  # there may be none


def _other_windows(loop: HapticLoop, stable: StableGains) -> dict[str, GainAnswer]:
    """The largest stiffness with windows that haptics software uses; unresolved ones left out."""
    answers = {}
    for samples in (10, 20):  # 10 and 20 ms at 1 kHz
        other = replace(loop, velocity=Velocity.difference(samples))
        region = other.region()
        if region.status != RegionStatus.UNRESOLVED:
            found = replace(stable, loop=other).limit(other.gains[0], *region.limits()[:2])
            answers[str(samples)] = replace(found, is_stable=True)
    return answers
