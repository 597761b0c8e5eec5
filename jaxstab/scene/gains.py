"""Scenes of other loops than walls: ``[loop] kind = ...``, pairs of gains, and their answers.

A table [loop] has the arguments of the function that makes the loop, which checks them. PID and a
coupling take their device from [device], [hand] and [controller], as walls do. [gains.NAME] has
both gains, as the loop calls them; at_NAME in [wanted] asks for the stable values of the other one.

Limits are printed as a stable pair, proved. An admittance may have a range of environments; its
loop is that of the stiffest. Without a virtual spring p(z) is homogeneous in mass M, damping D and
stiffness Ke, so all Ke of [low, high] at one pair of gains are the pairs (s M, s D), s from 1 to
high/low, at Ke = high: a piece of a line, whose stable intervals are complete and proved. A pair is
stable for all of the range where one of them holds that piece.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, make_dataclass, replace
from decimal import ROUND_CEILING, ROUND_FLOOR
from functools import cache, partial
from inspect import Parameter, signature
from math import inf, isfinite, isnan, nan
from typing import Any, ClassVar

from jaxstab import loop as doors
from jaxstab import model
from jaxstab import tables as t
from jaxstab.conventions import MEASURED, Verdict
from jaxstab.exact import LineStatus, StableLine, stable_line
from jaxstab.loop import Gain, GainLimit, Gains, HapticLoop, Loop
from jaxstab.model.affine import affine_triple
from jaxstab.numbers import without_noise
from jaxstab.region import RegionStatus
from jaxstab.rounding import EPS
from jaxstab.scene.answers import (
    GIVEN,
    Answer,
    Quantity,
    basis_of,
    quantities,
)
from jaxstab.scene.check import WallCheck, frequency_answer
from jaxstab.scene.limits import AroundWall, numbered, stable_in_words, stable_intervals
from jaxstab.scene.loops import StiffestWall, WallVerdict, device_of, hands_of, loop_of
from jaxstab.scene.scene import (
    Controller,
    Device,
    Hand,
    PositionTable,
    Scene,
    Units,
    Wall,
    walls_in,
)
from jaxstab.scene.tune import DesignStatus, largest_value
from jaxstab.shown import Printed, stable_pair, table_text

_DOORS: Mapping[str, tuple[Any, tuple[str, ...]]] = {
    "simulator": (doors.simulated_pd, ()),
    "admittance": (doors.admittance, ()),
    "pid": (doors.pid, ("loop",)),
    "coupling": (doors.coupling, ("first", "sample_time", "delays_samples", "velocity")),
}
"""The function of each kind of loop, and what it takes from the tables of a held device."""
_UNITS = {"inertia": "kg m^2", "step": "s", "environment": "N/m", "sample_time": "s"}
"""Of the keys of [loop] that some loop needs."""


@dataclass(frozen=True, kw_only=True)
class OtherDevice(Device):
    """The second device of a coupling, with its hand and its delay."""

    has_options: ClassVar[bool] = False

    # Answers would not say that none is assumed.
    damping: float = t.key(t.quantity("N s/m"))
    hand: Hand | None = t.key(t.nested(Hand), None)
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
            words = f"it in {_UNITS[name]} (--set loop.{name}=...)" if name in _UNITS else None
            raise ValueError(f"loop.{name} is missing; give {words or f'a table [loop.{name}]'}.")
    if "outside" in given:
        t.checked("loop.outside", given["outside"], t.truth)
    for name in {"robot", "force_filter"} & given.keys():
        given[name] = PositionTable.from_table(given[name], f"loop.{name}").as_filter()
    if "environment" in given:
        ends = t.checked(
            "loop.environment", given["environment"], t.Interval("N/m", is_positive=True)
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
        first, second = (gain._replace(unit=units.unit(gain.unit)) for gain in loop.gains)
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

    def unusual(self) -> list[str]:
        """Describe values that look like a slip of the unit."""
        return self.held.unusual() if self.held else []

    def verdict(self, first: float, second: float) -> Verdict:
        """The verdict on both gains, with every environment of the range."""
        pair = dict(zip((gain.name for gain in self.loop.gains), (first, second), strict=True))
        verdict = Verdict(int(self.loop.verdict(**pair)))
        if verdict != Verdict.STABLE or not self.is_range:
            return verdict
        line = stable_line(partial(affine_triple, self.loop.parts), (0.0, 0.0), (first, second))
        most = self.environment[1] / self.environment[0] * (1.0 + EPS)
        if any(low.value < 1.0 and high.value - high.error > most for low, high in line.intervals):
            return verdict
        return Verdict.UNSTABLE if line.status == LineStatus.PROVED else Verdict.UNDECIDED

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
    made: Any = partial(make_dataclass, bases=(t.Table,), frozen=True, kw_only=True)
    return (
        made("Pair", [(name, Any, t.key(own)) for name, own in both.items()]),
        made("Wanted", [(name, Any, t.key(own, None)) for name, own in wishes.items()]),
    )


# Answers, whose names are those of the gains.


@dataclass(frozen=True)
class GainAnswer(Answer):
    """Values by their names, the formats of numbers, and whether the gains in it are stable."""

    values: dict[str, Any]
    formats: Mapping[str, Quantity] = field(default_factory=dict)
    is_stable: bool = True

    @property
    def all_stable(self) -> bool:
        """True if the gains in it, and in all answers in it, are stable."""
        inner = (value for _, value in self._entries() if isinstance(value, GainAnswer))
        return self.is_stable and all(answer.all_stable for answer in inner)

    def in_short(self) -> str:
        """Of each pair of gains what most people ask for, in at most eight lines."""
        if "gains" not in self.values:  # measured walls, which are short as they are
            return str(self)
        inputs = self.values["inputs"].values
        rows = [("loop", inputs["loop"]), ("given", inputs["given"])]
        rows += inputs["device"].facts().items() if inputs["device"] else ()
        for name, pair in self.values["gains"].items():
            rows += pair.rows(f"gains {name}")
        return table_text(rows)

    def rows(self, name: str) -> Iterator[tuple[str, str]]:
        """The verdict on a pair of gains, and what is left where it is stable."""
        said, both = {path: words for path, _, words in self.leaves()}, [*self.values][:2]
        own = [f"{gain} = {said[gain]}" for gain in both]
        yield name, f"{own[0]} and {own[1]}: {said['verdict']}"
        if "both_factors_low" in said:
            factors = [f"{gain} by {said[f'{gain}_factors_low']}" for gain in (*both, "both")]
            yield "  gain margins", f"may be multiplied: {', '.join(factors)}"
            yield from ((f"  {x}", words) for x, words in self.values["frequency"].rows().items())
        elif f"{both[0]}_limits_low" in said:
            places = zip(both, own[::-1], strict=True)
            beside = [stable_in_words(x, x, y, said[f"{x}_limits_low"], said) for x, y in places]
            yield "  stable gains", "; ".join(beside)

    def _values(self) -> Mapping[str, Any]:
        return self.values

    def _quantity(self, name: str) -> Quantity:
        return self.formats[name]


def gain_limits(scene: GainScene) -> GainAnswer:
    """The limits of both gains, the stable values of one at the other, and around each pair."""
    values, is_any = _stated(scene), True
    try:
        limits = _limits(scene)
        is_any = not all(isnan(limit.value) for limit in limits)
        every = {limit.gain.name: _limit(scene, limit) for limit in limits}
        values |= every if is_any else {"limits": "there are no stable gains"}
    except ValueError as error:  # both gains act alike
        values["limits"] = str(error)
    for gain in scene.loop.gains:
        at = scene.wanted[f"at_{gain.name}"]
        if at is not None and scene.is_range:
            raise ValueError(
                f"wanted.at_{gain.name} is {at:g} beside a range of environments, for which pairs "
                "of gains are proved; give one environment, or [gains.NAME]."
            )
        values[f"at_given_{gain.name}"] = None if at is None else _row(scene, gain, at)
    pairs = {name: _around(scene, pair) for name, pair in scene.pairs.items()}
    return GainAnswer(values | {"gains": pairs}, is_stable=is_any)


def check_gains(scene: GainScene) -> GainAnswer:
    """The verdict on each pair, its spectral radius, and the stable values around it."""
    if not scene.pairs:
        names = " and ".join(gain.name for gain in scene.loop.gains)
        raise ValueError(f"gains is empty; give at least one pair, [gains.NAME] with {names}.")
    pairs = {name: _around(scene, pair, in_full=True) for name, pair in scene.pairs.items()}
    return GainAnswer(_stated(scene) | {"gains": pairs})


def explain_gains(scene: GainScene) -> str:
    """The loop, its numbers and its gains."""
    gains = ", ".join(f"{gain.name} in {gain.unit}" for gain in scene.loop.gains)
    return str(GainAnswer(_stated(scene) | {"gains": gains}))


def _stated(scene: GainScene) -> dict[str, Any]:
    """The range for which answers hold, in words."""
    own = {name: value for name, value in scene.tables["loop"].items() if name != "kind"}
    given = ", ".join(f"{name} = {value}" for name, value in own.items())
    values = {"loop": scene.loop.words, "given": given, "safety": scene.wanted["safety"]}
    values["device"] = basis_of(scene.held) if scene.held else None
    return {"inputs": GainAnswer(values, {"safety": Quantity()})}


def _limits(scene: GainScene) -> tuple[GainLimit, GainLimit]:
    """The limits of both gains, times the safety; RuntimeError where they are not resolved."""
    limits, safety = scene.loop.limits(), scene.wanted["safety"] or 1.0
    if limits.status == RegionStatus.UNRESOLVED:
        raise RuntimeError("the stable region was not resolved; change one value a little.")
    factors = {"largest": safety, "least": 1.0 / safety}
    first, second = (own._replace(value=own.value * factors[own.gain.sense]) for own in limits[:2])
    return first, second


def _limit(scene: GainScene, limit: GainLimit) -> GainAnswer:
    """A limit and the other gain there, to be printed as a stable pair."""
    own, value, at = limit
    other, is_largest = _other(scene, own), own.sense == "largest"
    name = f"{own.sense}_{own.name}"
    if value == inf:
        return GainAnswer({name: value}, {name: Quantity(own.unit)})
    if isfinite(value):
        inside = value * (1.0 - 2e-4 if is_largest else 1.0 + 2e-4)
        at = _beside(scene.loop.intervals(**{own.name: inside}), at)
    way, allows = ROUND_FLOOR if is_largest else ROUND_CEILING, partial(_is_stable, scene, own)
    value, at = stable_pair(value, at, (4, 6), allows, way=way)
    is_proved = isinstance(value, Printed)
    certainty = "proved for every environment" if is_proved else "not proved"
    return GainAnswer(
        {
            name: value,
            f"at_{other.name}": at,
            "certainty": certainty if scene.is_range or not is_proved else None,
        },
        {name: Quantity(own.unit), f"at_{other.name}": Quantity(other.unit)},
        is_proved,
    )


def _beside(row: StableLine, at: float) -> float:
    """A gain inside of a row: a given one or, where that is in a corner, one between the ends."""
    if not row.intervals or row.holding(at):
        return at
    low, high = (max(end.value, 0.0) for end in row.intervals[-1])
    return 0.5 * (low + min(high, 3.0 * low + 1.0))


def _other(scene: GainScene, own: Gain) -> Gain:
    return scene.loop.gains[1 - scene.loop.gains.index(own)]


def _is_stable(scene: GainScene, own: Gain, value: float, other: float) -> bool:
    """True if a value of a gain, and one of the other, are >= 0 and stable."""
    pair = (value, other) if own == scene.loop.gains[0] else (other, value)
    return min(pair) >= 0.0 and scene.verdict(*pair) == Verdict.STABLE


def _row(scene: GainScene, fixed: Gain, value: float, around: float = nan) -> GainAnswer:
    """The stable values of the other gain: first those around one, or small ones."""
    own, line = _other(scene, fixed), scene.loop.intervals(**{fixed.name: value})
    found = stable_intervals(line, scene.wanted["safety"] or 1.0, around)
    least = 0.0 if own.sense == "least" else -inf  # a mass is not negative
    first, *others = [(max(low, least), high) for low, high in found if high > 0.0] or [(nan, nan)]
    names, limits = (f"{own.name}_limits", f"other_{own.name}"), Quantity(own.unit, 4)
    return GainAnswer(
        {f"at_{fixed.name}": value, names[0]: first, names[1]: numbered(others)},
        {f"at_{fixed.name}": Quantity(fixed.unit, GIVEN), **dict.fromkeys(names, limits)},
    )


def _around(scene: GainScene, pair: dict[str, float], *, in_full: bool = False) -> GainAnswer:
    """The verdict on a pair, and the stable values of each gain at the other one."""
    verdict = scene.verdict(*pair.values())
    values: dict[str, Any] = {**pair, "verdict": verdict}
    own_formats = {x.name: Quantity(x.unit, GIVEN) for x in scene.loop.gains}
    formats = quantities(WallCheck) | own_formats
    if scene.is_range:
        return GainAnswer(values, formats, verdict == Verdict.STABLE)
    if in_full:
        radius = scene.loop.spectral_radius(**pair)
        values["spectral_radius"] = float(radius.value)
        values["radius_error"] = float(radius.error)
    if in_full and verdict == Verdict.STABLE:
        margins = scene.loop.frequency_margins(**pair)
        values["frequency"] = frequency_answer(margins, in_full=bool(scene.wanted["frequency"]))
        names = [f"{name}_factors" for name in (*pair, "both")]
        for name, (low, high) in zip(names, scene.loop.margins(**pair)[3:6], strict=True):
            values[name] = (*without_noise([low, high], high - low).tolist(),)
        formats |= dict.fromkeys(names, Quantity("", 4))
    for own in scene.loop.gains:
        fixed = _other(scene, own)
        row = _row(scene, fixed, pair[fixed.name], pair[own.name])
        values |= {name: value for name, value in row.values.items() if name[:3] != "at_"}
        formats |= row.formats
    return GainAnswer(values, formats, verdict == Verdict.STABLE)


def tune_gains(scene: GainScene) -> GainAnswer:
    """The gains of the smallest spectral radius, and what is stable around them."""
    best = scene.loop.tune()
    values = _stated(scene) | {"status": best.status}
    if isfinite(best.radius):
        pair = {name: float(f"{gain:.6g}") for name, gain in best.gains.items()}
        values["least_radius"] = _around(scene, pair, in_full=True)
        more = {name: 3.0 * gain for name, gain in best.gains.items()}
        slower = float(scene.loop.spectral_radius(**more).value) - best.radius
        if slower <= 1e-6 * (1.0 - best.radius):  # as that of a coupling's devices together
            values["note"] = (
                "three times these gains decay as fast: they do not move the slowest root"
            )
    return GainAnswer(values, is_stable="least_radius" in values)


def design_gains(scene: GainScene) -> GainAnswer:
    """The largest sample time, and the largest delay, that allow the wanted value of a gain."""
    asked = [gain for gain in scene.loop.gains if scene.wanted[gain.name] is not None]
    if len(asked) != 1:
        both = " and ".join(gain.name for gain in scene.loop.gains)
        raise ValueError(f"wanted has {len(asked)} of {both}; give the one to design for.")
    own = asked[0]
    t.checked(f"wanted.{own.name}", scene.wanted[own.name], t.quantity(own.unit, is_positive=True))
    section = scene.tables["controller" if scene.held else "loop"]
    period = "step" if "step" in section else "sample_time"
    late = "delay_steps" if period == "step" else "delay" if "delay" in section else "delay_samples"
    now = _limit(scene, _limits(scene)[scene.loop.gains.index(own)])
    values = {own.name: scene.wanted[own.name], "now": replace(now, is_stable=True)}
    values |= {name: _largest(scene, own, section[period], name) for name in (period, late)}
    return GainAnswer(_stated(scene) | values, {own.name: Quantity(own.unit, GIVEN)})


def _largest(scene: GainScene, own: Gain, period: float, name: str) -> GainAnswer:
    """The largest value of a key that allows the wanted gain, which is taken to fall with it."""
    axis, goal, other = scene.loop.gains.index(own), scene.wanted[own.name], _other(scene, own)
    place = ["controller" if scene.held else "loop", name]
    kind: Any = int if "delay" in name and not scene.held else float  # of steps, or samples
    is_time = name in ("step", "sample_time", "delay")

    def at(value: float) -> GainScene:
        return scene.from_table(t.with_value(scene.tables, ".".join(place), kind(value), place))

    @cache
    def limit(value: float) -> GainLimit:
        return _limits(at(value))[axis]

    def spare(value: float) -> float:
        """The rest of the limit, relative; -1 where no gains are stable."""
        try:
            found = limit(float(kind(value))).value
        except ValueError:  # beyond what a filter, or the longest delay, allows
            return -1.0
        share = found / goal if own.sense == "largest" else goal / max(found, 1e-300)
        return -1.0 if isnan(share) else min(max(share - 1.0, -1.0), 1e6)

    if "delay" in name:
        start = period if is_time else 1.0
        ends = 0.0, 256.0 * start
    else:
        at(0.7317 * period)  # refuses a window in s, which goes with few sample times
        start, ends = period, (period / 1024.0, 1024.0 * period)
    value, status = largest_value(spare, start, *ends)
    near = nan
    if status != DesignStatus.NONE:
        value = float(kind(value))
        row = at(value if kind is int else value * (1.0 - 2e-4)).loop.intervals(**{own.name: goal})
        near = _beside(row, limit(value).at)
        value, near = stable_pair(
            value, near, (4, 6), lambda one, two: _is_stable(at(one), own, goal, two)
        )
    names = f"largest_{name}", f"at_{other.name}"
    words = status.words.replace("stiffness", "gain")
    return GainAnswer(
        {names[0]: value, names[1]: near, "status": words},
        {names[0]: Quantity("s" if is_time else ""), names[1]: Quantity(other.unit)},
        status != DesignStatus.NONE,
    )


_ANSWERS: Mapping[str, Callable[[GainScene], GainAnswer]] = {
    "limits": gain_limits,
    "check": check_gains,
    "tune": tune_gains,
    "design": design_gains,
}


# Scenes of a device that was measured: ``[device] response = "sweep.csv"``, beside the scene. A
# hand that held the device is in it. Their walls are judged from measured data, not proved.


def _file_name(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError("give the name of a CSV file")
    return value


@dataclass(frozen=True, kw_only=True)
class MeasuredDevice(t.Table):
    """A device by the file of its response, its relative error, and whether it turns."""

    response: str = t.key(_file_name)
    error: float | None = t.key(t.tolerance, None)
    turns: bool = t.key(t.truth, False)


@dataclass(frozen=True)
class MeasuredScene:
    """The loop of a measured device, and walls by name."""

    loop: HapticLoop
    units: Units
    walls: dict[str, Wall]
    asks_frequency: bool

    @classmethod
    def from_table(cls, tables: Mapping[str, Any]) -> "MeasuredScene":
        """Check a table of tables; ValueError on the first key that is unknown, missing or bad."""
        t.check_keys("", tables, ["device", "controller", "walls", "wanted"])
        device = MeasuredDevice.from_table(tables["device"], "device")
        controller = Controller.from_table(tables.get("controller", {}), "controller")
        controller.require_one_delay("an answer about a measured response")
        wanted = tables.get("wanted", {})
        t.check_keys("wanted", wanted, ["frequency"])
        loop = HapticLoop(
            device=model.Device.from_response(device.response, error=device.error),
            sample_time=controller.sample_time,
            delay=controller.time_delay,
            velocity=controller.estimator,
            position=controller.position_filter,
        )
        units = Units.ROTATION if device.turns else Units.LINE
        walls = walls_in(tables.get("walls", {}))
        return cls(loop, units, walls, bool(wanted.get("frequency", False)))

    def unusual(self) -> list[str]:
        """There is no number of which unusual values are known."""
        return []

    def answer(self, command: str) -> GainAnswer:
        """The limits, or what is known of the walls; ValueError for another command."""
        if command not in ("limits", "check"):
            raise ValueError(
                f"{command} needs a model, but the device is a measured response; limits and check "
                "answer, and jaxstab identify fits a model to a log."
            )
        if command == "check" and not self.walls:
            raise ValueError("walls is empty; give at least one wall with stiffness and damping.")
        loop = self.loop
        stated = {
            "device": str(loop.device),
            "velocity": str(loop.velocity or "the difference over one sample (assumed)"),
            "position": None if loop.position is None else str(loop.position),
            "delay": f"{loop.delay_samples:g} samples beside what was measured",
            "certainty": MEASURED,
        }
        values: dict[str, Any] = {"inputs": GainAnswer(stated)}
        if command == "limits":
            stiffness, at_damping, damping, at_stiffness = loop.limits()[:4]
            stiffest = {"largest_stiffness": stiffness, "at_damping": at_damping}
            damped = {"largest_damping": damping, "at_stiffness": at_stiffness}
            values |= {"stiffest": self._shown(stiffest), "most_damped": self._shown(damped)}
        walls = {name: self._wall(own, command == "check") for name, own in self.walls.items()}
        return GainAnswer(values | {"walls": walls})

    def _wall(self, wall: Wall, in_full: bool) -> GainAnswer:
        loop, gains = self.loop, Gains(wall.stiffness, wall.damping)
        verdict = Verdict(int(loop.verdict(*gains)))
        values: dict[str, Any] = {**gains._asdict(), "verdict": verdict}
        rows = loop.stiffness_intervals(gains.damping), loop.damping_intervals(gains.stiffness)
        for (name, gain), row in zip(gains._asdict().items(), rows, strict=True):
            ends = ((low.value, high.value) for low, high in row.intervals)
            found = sorted((not low <= gain <= high, (low, high)) for low, high in ends)
            values[f"{name}_limits"] = found[0][1] if found else None
            plural = {"stiffness": "stiffnesses", "damping": "dampings"}[name]
            values[f"other_{plural}"] = numbered(own for _, own in found[1:])
        if in_full:
            margins = loop.frequency_margins(*gains)
            values["frequency"] = frequency_answer(margins, in_full=self.asks_frequency)
        return replace(self._shown(values), is_stable=verdict == Verdict.STABLE)

    def _shown(self, values: dict[str, Any]) -> GainAnswer:
        formats = quantities(AroundWall) | quantities(StiffestWall) | quantities(WallVerdict)
        known = {k: v for k, v in values.items() if not (isinstance(v, float) and not isfinite(v))}
        return GainAnswer(
            known, {k: replace(v, unit=self.units.unit(v.unit)) for k, v in formats.items()}
        )


def any_scene(tables: Mapping[str, Any], source: str = "", *, may_be_measured: bool = False) -> Any:
    """The scene of walls, of another loop or of a measured device; ValueError with its source."""
    device = tables.get("device")
    kind: Any = GainScene if "loop" in tables else None
    if may_be_measured and isinstance(device, Mapping) and "response" in device:
        kind = MeasuredScene
    if kind is None:
        return Scene.from_table(tables, source)
    try:
        return kind.from_table(tables)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{source}: {error}" if source else str(error)) from None
