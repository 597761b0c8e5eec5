"""Scenes of other loops than walls: ``[loop] kind = ...``, pairs of gains, and their answers.

A table [loop] has the arguments of the function that makes the loop, which checks them. PID, a
coupling and a wall of two rates, both gains of which are slow, take their device from [device],
[hand] and [controller], as walls do. [gains.NAME] has
both gains, as the loop calls them; at_NAME in [wanted] asks for the stable values of the other one.

Limits are printed as a stable pair, proved. An admittance may have a range of environments; its
loop is that of the stiffest. Without a virtual spring p(z) is homogeneous in mass M, damping D and
stiffness Ke, so all Ke of [low, high] at one pair of gains are the pairs (s M, s D), s from 1 to
high/low, at Ke = high: a piece of a line, whose stable intervals are complete and proved. A pair is
stable for all of the range where one of them holds that piece.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, make_dataclass, replace
from functools import cache, partial
from inspect import Parameter, signature
from math import inf, isfinite, isnan, nan
from typing import Any, ClassVar

import numpy as np

from jaxstab import loop as doors
from jaxstab import tables as t
from jaxstab.answers import GainAnswer, Template, Units
from jaxstab.app.scene.answers import basis_of
from jaxstab.app.scene.check import MARGINS_ROW, frequency_answer, stable_row, usable_in_words
from jaxstab.app.scene.limits import (
    SAFETY,
    StableGains,
    given_row,
    limit_row,
    pair_row,
    standing,
    usable_rows,
)
from jaxstab.app.scene.loops import device_of, hands_of, loop_of
from jaxstab.app.scene.scene import (
    DeviceTable,
    HandTable,
    MarginTable,
    PositionTable,
    Scene,
    margins_of,
)
from jaxstab.app.scene.tune import largest_value
from jaxstab.conventions import Verdict
from jaxstab.exact import LineStatus, stable_line
from jaxstab.loop import Loop
from jaxstab.model.affine import affine_triple
from jaxstab.model.gain import Gain
from jaxstab.numbers import without_noise
from jaxstab.rounding import EPS

_DOORS: Mapping[str, tuple[Any, tuple[str, ...]]] = {
    "simulator": (doors.simulated_pd, ()),
    "admittance": (doors.admittance, ()),
    "pid": (doors.pid, ("loop",)),
    "coupling": (doors.coupling, ("first", "sample_time", "delays_samples", "velocity")),
    "two_rates": (doors.two_rates, ("loop", "slow")),
}
"""The function of each kind of loop, and what it takes from the tables of a held device."""
KEYS = {
    "inertia": ("moment of inertia of the joint", "kg m^2"),
    "damping": ("damping of the joint", "N m s/rad"),
    "stiffness": ("stiffness of the spring", ""),  # N m/rad, or N/m with admittance
    "step": ("step of the engine", "s"),
    "substeps": ("engine steps per control step", ""),
    "delay_steps": ("delay in engine steps", ""),
    "environment": ("stiffness of the environment", "N/m"),
    "sample_time": ("sampling period", "s"),
    "delay_samples": ("delay", "samples"),
    "every": ("samples of a frame", ""),
    "slow_delay": ("delay of the slow force", "s"),
    "kp": ("kp", "N/m"),
    "ki": ("ki", "N/(m s)"),
    "kd": ("kd", "N s/m"),
}
"""Keys of [loop]: what they are, and their units."""


@dataclass(frozen=True, kw_only=True)
class OtherDevice(DeviceTable):
    """The second device of a coupling, with its hand and its delay."""

    has_options: ClassVar[bool] = False

    # Answers would not say that none is assumed.
    damping: float = t.key(t.quantity("N s/m"))
    hand: HandTable | None = t.key(t.nested(HandTable), None)
    delay_samples: float = t.key(t.quantity("samples"), 0.0)


def _loop(table: Any, held: Scene | None) -> tuple[Loop, tuple[float, float]]:
    """Return the loop of a table [loop], and the range of its environment; 1 twice without one."""
    given, ends = dict(table), (1.0, 1.0)
    door, provided = _DOORS[given.pop("kind")]
    arguments = signature(door).parameters.values()
    keys = {own.name: own for own in arguments if own.name not in provided}
    t.check_keys("loop", given, [*keys])
    for name, own in keys.items():
        if own.default is Parameter.empty and name not in given:
            words = f"it in {KEYS[name][1]} (--set loop.{name}=...)" if name in KEYS else None
            raise ValueError(f"loop.{name} is missing; give {words or f'a table [loop.{name}]'}.")
    if "outside" in given:
        t.checked("loop.outside", given["outside"], t.truth)
    for name in {"robot", "force_filter"} & given.keys():
        given[name] = PositionTable.from_table(given[name], f"loop.{name}").as_filter()
    if "environment" in given:
        ends = t.checked(
            "loop.environment", given["environment"], t.IntervalCheck("N/m", is_positive=True)
        )
        given["environment"] = ends[1]
        if given.get("stiffness") and ends[0] < ends[1]:
            raise ValueError(
                "loop.stiffness is given beside a range of environments, which is proved without "
                "a virtual spring; give one environment."
            )
    if held and "loop" in provided:
        given["loop"] = loop_of(held)
    elif held:
        controller = held.controller
        try:
            second = OtherDevice.from_table(given["second"], "loop.second")
        except ValueError as error:
            raise ValueError(held.units.translated(str(error))) from None
        other = _single(replace(held, device=second, hand=second.hand))
        if other.units is not held.units or controller.position is not None:
            raise ValueError(
                "loop.second moves in another way than device, or controller.position is given; a "
                "coupling is of two devices that both turn, or both do not, without a filter."
            )
        given |= {"first": device_of(held), "second": device_of(other)}
        given |= {"sample_time": controller.sample_time, "velocity": controller.estimator}
        given["delays_samples"] = controller.samples, second.delay_samples
    try:
        return door(**given), ends
    except (TypeError, ValueError) as error:
        raise ValueError(f"loop: {error}") from None


def _single(scene: Scene) -> Scene:
    """Return a scene without ranges, and without what is of simulated contacts; ValueError."""
    if hands_of(scene) is not None or scene.contact is not None:
        raise ValueError(
            "beside [loop] a mass or a hand is a range, or friction, max_force or force_step is "
            "given, which are of simulated contacts; give one number for each, and no contacts."
        )
    scene.controller.require_one_delay("an answer about [loop]")
    return scene


@dataclass(frozen=True)
class _ForEach(StableGains):
    """Gains that are stable with each environment of a range; the loop is that of the stiffest."""

    environment: tuple[float, float] = (1.0, 1.0)

    @property
    def certainty(self) -> str | None:
        """The certainty of a limit that is proved."""
        return super().certainty if self._is_one else "proved for every environment"

    @property
    def _is_one(self) -> bool:
        low, high = self.environment
        return low == high

    def verdict(self, first: float, second: float) -> Verdict | str:
        """The verdict on both gains."""
        verdict = super().verdict(first, second)
        if verdict != Verdict.STABLE or self._is_one:
            return verdict
        line = stable_line(partial(affine_triple, self.loop.parts), (0.0, 0.0), (first, second))
        ends = ((low.value, high.value - high.error) for low, high in line.intervals)
        if any(low < 1.0 and high > self._ratio for low, high in ends):
            return verdict
        return Verdict.UNSTABLE if line.status == LineStatus.PROVED else Verdict.UNDECIDED

    def around(self, pair: Mapping[str, float]) -> GainAnswer:
        """The verdict on a pair, and of one environment the stable values of each gain."""
        if self._is_one:
            return super().around(pair)
        verdict = self.verdict(*pair.values())
        return GainAnswer({**pair, "verdict": verdict}, self.formats, verdict == Verdict.STABLE)

    def found(self, own: Gain) -> tuple[float, float]:
        """The least value of a gain, and the other gain there; of a range, that a search finds."""
        limit, (low, high) = super().found(own), self.environment
        if low == high or isnan(limit[0]):
            return limit
        slopes = np.geomspace(1e-6, 1e4, 41) / self.loop.sample_time  # damping/mass, at first
        if limit[0] == 0.0 and self._least(own, 1e-6 * slopes[0])[0] < inf:
            return limit  # as without a delay: all dampings above 0
        best = inf, nan
        for _ in range(5):
            pairs = [self._least(own, slope) for slope in slopes.tolist()]
            place = min(range(len(pairs)), key=pairs.__getitem__)
            best, last = min(best, pairs[place]), len(slopes) - 1
            slopes = np.geomspace(slopes[max(place - 1, 0)], slopes[min(place + 1, last)], 9)
        return best if best[0] < inf else (nan, nan)

    def _least(self, own: Gain, slope: float) -> tuple[float, float]:
        """The least value of a gain for all of the range at a ratio of damping to mass; infinite.

        Beside it stands the other gain.
        """
        line = stable_line(partial(affine_triple, self.loop.parts), (0.0, 0.0), (1.0, slope))
        ends = ((low.value + low.error, high.value - high.error) for low, high in line.intervals)
        mass = min((low for low, high in ends if high > self._ratio * low > 0.0), default=inf)
        pair = mass, slope * mass
        return pair if own == self.loop.gains[0] else pair[::-1]

    @property
    def _ratio(self) -> float:
        """The stiffest environment over the softest one, rounded up."""
        low, high = self.environment
        return high / low * (1.0 + EPS)

    def beside(self, own: Gain, value: float, at: float) -> float:
        """The other gain: a given one, or one in the middle of stable ones around it."""
        if self._is_one:
            return super().beside(own, value, at)
        steps = np.geomspace(1e-5, 3.0, 24)
        others = at * np.sort([*(1.0 + steps), 1.0, *(1.0 / (1.0 + steps))])
        stable = [other for other in others.tolist() if self.is_stable(own, value, other)]
        return stable[len(stable) // 2] if stable else at


@dataclass(frozen=True)
class GainScene:
    """A loop of two gains (that of the stiffest environment), pairs of gains by name, and wishes.

    ``tables`` are those of the file, and ``held`` is the scene of the device, if there is one.
    """

    tables: Mapping[str, Any]
    held: Scene | None
    environment: tuple[float, float]
    loop: Loop
    pairs: dict[str, dict[str, float]]
    wanted: dict[str, Any]

    @classmethod
    def from_table(cls, tables: Mapping[str, Any]) -> "GainScene":
        """Check a table of tables; ValueError on the first key that is unknown, missing or bad."""
        table, pairs = tables["loop"], tables.get("gains", {})
        if not isinstance(table, Mapping) or not isinstance(pairs, Mapping):
            raise ValueError("loop or gains is no table; give [loop], and [gains.NAME] for pairs.")
        if "kind" not in table:
            raise ValueError(f"loop.kind is missing; give one of {', '.join(_DOORS)}.")
        kind = t.checked("loop.kind", table["kind"], t.one_of(_DOORS))
        beside = ("device", "hand", "controller") if _DOORS[kind][1] else ()
        t.check_keys("", tables, ["loop", "gains", "wanted", *beside])
        of_device = {name: tables[name] for name in beside if name in tables}
        held = _single(Scene.from_table(of_device)) if beside else None
        (loop, (low, high)), units = _loop(table, held), held.units if held else Units.LINE
        first, second = (replace(gain, unit=units.unit(gain.unit)) for gain in loop.gains)
        every = f"{low:g} to {high:g} N/m" if low < high else f"{high:g} N/m"
        words = loop.words.replace(f"{high:g} N/m", every)
        loop = replace(loop, gains=(first, second), words=words)
        pair, wanted = _tables_of(first, second)
        both = {
            t.checked_label(name): dict(vars(pair.from_table(own, f"gains.{name}")))
            for name, own in pairs.items()
        }
        wishes = dict(vars(wanted.from_table(tables.get("wanted", {}), "wanted")))
        return cls(tables, held, (low, high), loop, both, wishes)

    @property
    def is_range(self) -> bool:
        """True if the environments are a range."""
        return self.environment[0] < self.environment[1]

    @property
    def stable(self) -> StableGains:
        """The stable gains, with every environment of the range."""
        safety = self.wanted["safety"] or 1.0
        return _ForEach(self.loop, safety, environment=self.environment)

    @property
    def margins(self) -> dict[str, Any]:
        """The margins that are wanted, as ``is_usable`` takes them."""
        return margins_of(self.wanted)

    def unusual(self) -> list[str]:
        """Describe values that look like a slip of the unit."""
        return self.held.unusual() if self.held else []

    def answer(self, command: str) -> "GainAnswer":
        """The answer of a command; ValueError for one that has none."""
        if command not in _ANSWERS:
            others = ", ".join(_ANSWERS)
            raise ValueError(f"{command} has no answer for {self.loop.words}; {others}, study do.")
        try:
            return _ANSWERS[command](self)
        except OverflowError:
            raise ValueError(
                "the numbers are too large or small to compute with; check the units."
            ) from None


@cache
def _tables_of(*gains: Gain) -> tuple[Any, Any]:
    """Return the tables of a pair of gains, and of wishes about them."""
    both = {gain.name: t.quantity(gain.unit) for gain in gains}
    wishes: dict[str, Any] = {"safety": t.share, "frequency": t.truth, **both}
    wishes |= {f"at_{name}": own for name, own in both.items()}
    made: Any = partial(make_dataclass, frozen=True, kw_only=True)
    pair = [(name, Any, t.key(own)) for name, own in both.items()]
    wanted = [(name, Any, t.key(own, None)) for name, own in wishes.items()]
    return made("Pair", pair, bases=(t.Table,)), made("Wanted", wanted, bases=(MarginTable,))


# Answers, whose names are those of the gains.


def gain_limits(scene: GainScene) -> GainAnswer:
    """The limits of both gains, the stable values of one at the other, and around each pair."""
    stable, values, gains, is_any = scene.stable, _stated(scene), scene.loop.gains, True
    try:
        found = {own: stable.found(own) for own in gains}
        is_any = not all(isnan(value) for value, _ in found.values())
        none = "there are no stable gains"
        if scene.is_range:
            none = "no gains were found that are stable in every environment"
        limits = {own.name: stable.limit(own, *pair) for own, pair in found.items()}
        values |= limits if is_any else {"limits": none}
    except (ValueError, RuntimeError) as error:  # both gains act alike, or it is not resolved
        values["limits"], is_any = str(error), isinstance(error, ValueError)
    for own in gains:
        at = scene.wanted[f"at_{own.name}"]
        if at is not None and scene.is_range:
            raise ValueError(
                f"wanted.at_{own.name} is {at:g} beside a range of environments, for which pairs "
                "of gains are proved; give one environment, or [gains.NAME]."
            )
        values[f"at_given_{own.name}"] = stable.at(own, at)
    if is_any and scene.margins:
        usable = stable.usable(scene.margins)
        values["usable"] = usable.largest()
        for own in gains:
            at = scene.wanted[f"at_{own.name}"]
            values[f"usable_at_given_{own.name}"] = usable.at(own, at)
    pairs = {name: standing(stable.around(pair)) for name, pair in scene.pairs.items()}
    one, two = (gain.name for gain in gains)
    limits_of_each = (
        limit_row(f"{own.sense} {own.name}", own.name, f"{own.sense}_{own.name}", other)
        for own, other in zip(gains, (two, one), strict=True)
    )
    rows = (
        SAFETY,
        *limits_of_each,
        *usable_rows(one, two),
        Template("note", ("{limits}",)),
        given_row(two, one),
        given_row(one, two),
        pair_row("gains {}", "gains", one, two),
    )
    main = [f"{place}{own.name}.*_{own.name}" for place in ("", "usable.") for own in gains]
    main += ["gains.*.verdict"]
    return GainAnswer(values | {"gains": pairs}, is_stable=is_any, short=rows, columns=main)


def _checked(scene: GainScene, pair: dict[str, float]) -> GainAnswer:
    """The surroundings of a pair, its spectral radius and, of stable gains, the margins."""
    found = scene.stable.around(pair)
    verdict = found.values["verdict"]
    if scene.is_range:
        if scene.wanted["frequency"]:
            raise ValueError(
                "margins over frequency are asked for beside a range of environments, for which "
                "verdicts are proved; give one environment."
            )
        return found
    radius, margins = scene.loop.spectral_radius(**pair), dict[str, Any]()
    if verdict == Verdict.STABLE:
        own = scene.loop.frequency_margins(**pair)
        margins["margins_over_frequency"] = frequency_answer(
            own, in_full=bool(scene.wanted["frequency"])
        )
        names = (f"{name}_factors" for name in (*pair, "both"))
        for name, (low, high) in zip(names, scene.loop.margins(**pair)[3:6], strict=True):
            margins[name] = (*without_noise([low, high], 1.0).tolist(),)
    radii = {"spectral_radius": float(radius.value), "radius_error": float(radius.error)}
    is_usable = verdict == Verdict.STABLE
    if is_usable and scene.margins:
        one, two = pair.values()
        margins["usable"], is_usable = usable_in_words([scene.loop], (one, two), scene.margins)
    values = pair | {"verdict": verdict} | radii | margins | found.values
    return replace(found, values=values, is_stable=is_usable, short=_of_pair(*pair))


def _of_pair(one: str, two: str) -> list[Template]:
    """The rows of a check of two gains beside their verdict."""
    factors = (f"{name} by {{{name}_factors}}" for name in (one, two, "both"))
    around = (one, one, f"{two} = {{{two}}}"), (two, two, f"{one} = {{{one}}}")
    return [
        Template("gain margins", (f"may be multiplied: {', '.join(factors)}",)),
        stable_row("stable gains", "both_factors", *around),
        Template("", of="margins_over_frequency"),
        MARGINS_ROW,
    ]


def check_gains(scene: GainScene) -> GainAnswer:
    """The verdict on each pair, its spectral radius, and the stable values around it."""
    if not scene.pairs:
        names = " and ".join(gain.name for gain in scene.loop.gains)
        raise ValueError(f"gains is empty; give at least one pair, [gains.NAME] with {names}.")
    pairs = {name: _checked(scene, pair) for name, pair in scene.pairs.items()}
    both = " and ".join(f"{gain.name} = {{{gain.name}}}" for gain in scene.loop.gains)
    rows = [Template("gains {}", (f"{both}: {{verdict}}",), "gains")]
    values = _stated(scene) | {"gains": pairs}
    return GainAnswer(values, short=rows, columns=["gains.*.verdict"])


def explain_gains(scene: GainScene) -> str:
    """The loop, its numbers and its gains."""
    gains = ", ".join(f"{gain.name} in {gain.unit}" for gain in scene.loop.gains)
    return str(GainAnswer(_stated(scene) | {"gains": gains}))


def _stated(scene: GainScene) -> dict[str, Any]:
    """The inputs of answers, the loop, its numbers and its device, and the safety."""
    own = {name: value for name, value in scene.tables["loop"].items() if name != "kind"}
    given = ", ".join(f"{name} = {value}" for name, value in own.items())
    device = basis_of(scene.held) if scene.held else None
    inputs = GainAnswer({"loop": scene.loop.words, "given": given, "device": device})
    return {"inputs": inputs, "safety": scene.wanted["safety"]}


def tune_gains(scene: GainScene) -> GainAnswer:
    """The gains of the smallest spectral radius, and what is stable around them."""
    if scene.margins:
        raise ValueError(
            f"{' and '.join(scene.margins)} in [wanted], and the gains of [loop] are tuned without "
            "margins; ask limits, or leave them out."
        )
    best = scene.loop.tune()
    values = _stated(scene) | {"status": best.status}
    if isfinite(best.radius):
        pair = {name: float(f"{gain:.6g}") for name, gain in best.gains.items()}
        values["least_radius"] = _checked(scene, pair)
        more = {name: 3.0 * gain for name, gain in best.gains.items()}
        slower = float(scene.loop.spectral_radius(**more).value) - best.radius
        if slower <= 1e-6 * (1.0 - best.radius):  # as that of a coupling's devices together
            values["note"] = (
                "three times these gains decay as fast: they do not move the slowest root"
            )
    return GainAnswer(values, is_stable="least_radius" in values)


def design_gains(scene: GainScene) -> GainAnswer:
    """The sample time, and the delay, up to which the wanted value of a gain is allowed."""
    asked = [gain for gain in scene.loop.gains if scene.wanted[gain.name] is not None]
    if len(asked) != 1:
        both = " and ".join(gain.name for gain in scene.loop.gains)
        raise ValueError(f"wanted has {len(asked)} of {both}; give the one to design for.")
    own, goal, place = asked[0], scene.wanted[asked[0].name], "controller" if scene.held else "loop"
    t.checked(f"wanted.{own.name}", goal, t.quantity(own.unit, is_positive=True))
    if scene.tables["loop"]["kind"] == "two_rates":
        raise ValueError(
            "design has no answer for a wall of two rates: its delay is a whole number of samples, "
            "whose length would change; give another every or slow_delay, and ask limits."
        )
    section = scene.tables[place]
    period = "step" if "step" in section else "sample_time"
    late = "delay_steps" if period == "step" else "delay" if "delay" in section else "delay_samples"

    def at(name: str, value: Any) -> StableGains:
        other = scene.from_table(
            t.with_value(scene.tables, f"{place}.{name}", value, [place, name])
        )
        return other.stable.usable(scene.margins)

    start = section[period]
    at(period, 0.7317 * start)  # refuses a window in s, which goes with few sample times
    unit = start if late == "delay" else 1.0
    is_whole = not scene.held  # steps, or samples
    stable = scene.stable.usable(scene.margins)
    now = stable.limit(own, *stable.found(own))
    values = {own.name: goal, "now": replace(now, is_stable=True)}
    values[period] = largest_value(
        period, partial(at, period), own, goal, start, (start / 1024.0, 1024.0 * start)
    )
    values[late] = largest_value(
        late, partial(at, late), own, goal, unit, (0.0, 256.0 * unit), is_whole=is_whole
    )
    main = [f"{name}.largest_{name}" for name in (period, late)]
    return GainAnswer(_stated(scene) | values, scene.stable.formats, columns=main)


_ANSWERS: Mapping[str, Callable[[GainScene], GainAnswer]] = {
    "limits": gain_limits,
    "check": check_gains,
    "tune": tune_gains,
    "design": design_gains,
}


def any_scene(tables: Mapping[str, Any], source: str = "") -> Any:
    """The scene of walls or of another loop; ValueError with its source."""
    if "loop" not in tables:
        return Scene.from_table(tables, source)
    try:
        return GainScene.from_table(tables)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{source}: {error}" if source else str(error)) from None
