"""Answers with units, which print themselves as words and as JSON.

An answer has values by name, and each name of a number its Quantity (``FORMATS``): the unit, the
digits that are printed and the side to which they are rounded. Answers about two gains have the
names of these (``formats_of``): ``largest_kp`` is rounded down.
Limits are rounded inwards, and two gains that are printed as a stable wall are one
(``jaxstab.shown.stable_pair``), of which JSON has the same digits. All other numbers have all
digits there, in SI units but for a phase in degrees. JSON has the unit of each key. Answers of a
scene that turns have the units of rotation, and inertia for mass.

The long text has a line for each value. The short one has the rows of a table that the answer
brings along (``Template``), made where the answer is made: nothing is computed to print it.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal
from enum import Enum, IntEnum
from math import isfinite, isinf, isnan, nan
from typing import Any, ClassVar, NamedTuple

from jaxstab.shown import MOST_DIGITS, Printed, exact_text, rounded_text, stable_pair, table_text

# All hands, masses and delays: verdicts, and the stiffest wall.

BUT_FOR_DRIFT = "stable but for the position, which nothing holds"


# The units of a scene: those of motion along a line, or those of rotation.


class Units(Enum):
    """The units of mass, stiffness, damping, length, force, speed, an integrator; what moves."""

    LINE = "kg", "N/m", "N s/m", "m", "N", "m/s", "N/(m s)", "mass"
    ROTATION = "kg m^2", "N m/rad", "N m s/rad", "rad", "N m", "rad/s", "N m/(rad s)", "inertia"

    def __init__(self, *words: str) -> None:
        self.kilogram, self.stiffness, self.damping, self.length, self.force = words[:5]
        self.speed, _, self.moved = words[5:]

    def unit(self, of_line: str) -> str:
        """Return the unit that replaces one of linear motion."""
        return dict(zip(Units.LINE.value, self.value, strict=True)).get(of_line, of_line)

    def translated(self, sentence: str) -> str:
        """Return a sentence with the units of motion along a line in these units."""
        return re.sub(r"N/m\b|N s/m\b", lambda match: self.unit(match[0]), sentence)


_LIMIT_DIGITS = 4


_PREFIXES = ((0.1, 1, ""), (1e-3, 1000, "m"), (1e-6, 10**6, "u"), (1e-9, 10**9, "n"))


_HEADINGS = {
    "walls": "wall {}",
    "islands": "island {}",
    "windows": "with a window of {} samples",
}
"""The headings of the answers in a field that is a dictionary, by its name."""


LABELS = {
    "best": "stiffest wall",
    "most_damped": "most damped wall",
    "passive": "stiffest passive wall",
    "least_radius": "smallest spectral radius",
    "least_settling": "fastest settling",
    "share_of_largest": "share of the largest stiffness",
    "over_ranges": "best worst case over the ranges",
    "settling_time_at_worst": "settling time, worst case",
    "fastest_wall_at_worst": "nominally fastest, worst case",
    "slowest": "slowest loop",
    "now_allowed_stiffness": "stiffness allowed now",
    "settling_time_2_percent": "settling time (2 %)",
    "settling_time_5_percent": "settling time (5 %)",
    "reached": "connection",
    "extra_delay_moving": "extra delay, varying",
    "moving_is": "varying delay",
    "contact_is": "simulation",
    "hands_are": "hands",
    "measures_are": "measures",
    "linear_rule_is": "note",
}
"""Labels of fields whose names do not read as English, by name."""


GIVEN = 0
"""The digits of a number that a user gave, or that was rounded: all that it has."""


@dataclass(frozen=True)
class Quantity:
    """Format of a number: its unit and digits, a rounding mode, words for infinity and for NaN.

    Times and lengths have the prefix of their size. The ends of an interval are rounded inwards,
    with enough digits that they stay in order.
    """

    unit: str = ""
    digits: int = 6
    rounding: str = ROUND_HALF_EVEN
    infinite: str = "unlimited"
    absent: str = "none"

    def words(self, value: Any, units: Units = Units.LINE) -> str:
        """Return a number, or the two ends of an interval, with their unit."""
        ends = value if isinstance(value, tuple) else (value,)
        if any(map(isnan, ends)):
            return self.absent
        size, sizes = max(map(abs, ends)), _PREFIXES if self.unit in ("s", "m") else ()
        factor, prefix = next(((own, name) for least, own, name in sizes if size >= least), (1, ""))
        if isinstance(value, tuple):
            text = self._interval(value, factor)
        else:
            text = self._text(value, self.rounding, self.digits, factor)
        unit = f"{prefix}{units.length if self.unit == 'm' else units.unit(self.unit)}"
        return f"{text} {unit}" if unit and text[-1].isdigit() else text

    def _interval(self, ends: tuple[float, float], factor: int) -> str:
        low, high = ends
        for digits in range(self.digits, MOST_DIGITS + 1):
            least = self._text(low, ROUND_CEILING, digits, factor)
            largest = self._text(high, ROUND_FLOOR, digits, factor)
            if isinf(low) or isinf(high) or float(least) <= float(largest):
                break
        return f"{least} to {largest}"

    def _text(self, value: float | int, rounding: str, digits: int, factor: int) -> str:
        if isinf(value):
            return self.infinite if value > 0.0 else f"-{self.infinite}"
        if isinstance(value, Printed) or digits == GIVEN:
            text = value.text if isinstance(value, Printed) else exact_text(value)
            if not value:  # 0, or above 0
                return text
            return rounded_text(Decimal(text), MOST_DIGITS, factor=factor)
        return rounded_text(value, digits, rounding, factor=factor)


LIMIT_DIGITS = _LIMIT_DIGITS, Quantity.digits  # of a limit, and of the other gain there


def printed_pair(limit: float, other: float, *known: Any) -> tuple[float, float]:
    """A limit and the other gain in the digits that are printed, a stable pair: ``stable_pair``.

    NaN where no such pair is found; infinite limits are as they were.
    """
    pair = stable_pair(limit, other, LIMIT_DIGITS, *known)
    if not isfinite(limit):
        return pair
    first, second = (n.shown if isinstance(n, Printed) else nan for n in pair)
    return first, second


NOT_PROVED = "not proved"


_SPARE = Quantity("", 4, ROUND_FLOOR, "any", NOT_PROVED)


_SETTLING = Quantity("s", infinite="never", absent=NOT_PROVED)


def formats_of(units: Mapping[str, str]) -> dict[str, Quantity]:
    """The formats of all that answers give of quantities, from the units of these, by name."""
    forms = {
        "{}": Quantity(digits=GIVEN),
        "largest_{}": Quantity(digits=_LIMIT_DIGITS, rounding=ROUND_FLOOR),
        "least_{}": Quantity(digits=_LIMIT_DIGITS, rounding=ROUND_CEILING),
        "at_{}": Quantity(),
        "{}_limits": Quantity(digits=_LIMIT_DIGITS),
        "other_{}": Quantity(digits=_LIMIT_DIGITS),
    }
    return {
        words.format(name): replace(form, unit=unit)
        for name, unit in units.items()
        for words, form in forms.items()
    } | {f"{name}_factors": Quantity(digits=_LIMIT_DIGITS) for name in (*units, "both")}


_FORMS = {
    # Of limits and designs.
    "safety share_of_largest": Quantity(),
    "linear_rule_stiffness now_allowed_stiffness": Quantity("N/m", _LIMIT_DIGITS, ROUND_FLOOR),
    "proved_unstable_at": Quantity("N/m", infinite="no unstable wall was found there"),
    # Of checks and tuned gains: the change that each quantity allows alone, the least distance to
    # the edge of stability in units of alpha and beta, times, and the bounds of what an encoder
    # causes.
    "stiffness_gain damping_gain gain_margin disk_margin": _SPARE,
    "extra_delay extra_delay_moving varying delay_margin": replace(_SPARE, unit="s"),
    "phase_margin": replace(_SPARE, unit="degrees"),
    "peak_sensitivity peak_complementary least_gain": Quantity(
        "", 4, ROUND_CEILING, absent=NOT_PROVED
    ),
    "phase_margin_at gain_margin_at delay_margin_at disk_margin_at": Quantity("Hz"),
    "peak_sensitivity_at peak_complementary_at frequency contact_frequency": Quantity("Hz"),
    "distance_to_boundary": Quantity(rounding=ROUND_FLOOR, absent="not known"),
    "spectral_radius damping_ratio": Quantity(),
    "radius_error": Quantity(digits=3, rounding=ROUND_CEILING, infinite=NOT_PROVED),
    "settling_time_2_percent settling_time_5_percent": _SETTLING,
    "settling_time_at_worst fastest_wall_at_worst": _SETTLING,
    "horizon": Quantity("s", 3),
    "chatter_at_most": Quantity("m", 3, ROUND_CEILING, NOT_PROVED),
    "force_chatter_at_most": Quantity("N", 3, ROUND_CEILING, NOT_PROVED),
    "force_per_count": Quantity("N", 3),
    # Of simulated contacts.
    "time_to_rest": Quantity("s", 3, infinite="never"),
    "amplitude penetration": Quantity("m", 3),
    "largest_force": Quantity("N", 3),
    "friction": Quantity("N"),
    # Of inputs.
    "mass hand_mass device_mass": Quantity("kg"),
    "sample_time delay": Quantity("s"),
    "delay_samples lost_samples": Quantity(),
    "hand_stiffness": Quantity("N/m"),
    "hand_damping": Quantity("N s/m"),
}


_TIMES = {"sample_time": "s", "step": "s", "delay": "s", "delay_samples": "", "delay_steps": ""}


FORMATS = formats_of({"stiffness": "N/m", "damping": "N s/m"} | _TIMES) | {
    name: form for names, form in _FORMS.items() for name in names.split()
}
"""The formats of numbers, by their names."""


class Template(NamedTuple):
    """A row of a short text: its name, and ways to say it, with ``{name}`` for a value's words.

    The first way is taken whose values are there: NaN is not, and ``{name!}`` asks for a finite
    number, or an interval. In brackets ways are separated by |; where all of them lack a value the
    brackets say nothing. A row is left out without a way, without the value ``when``, which may be
    NaN, and beside the value ``unless``.

    A row of an entry takes values of this before those around it, and the entry's own rows follow.
    Of a dictionary each entry has a row, and its key stands for {} in the name.
    """

    name: str
    ways: tuple[str, ...] = ()
    of: str = ""
    when: str = ""
    unless: str = ""


def first_way(ways: Sequence[str], said: Mapping[str, str]) -> str | None:
    """The first of the ways of a ``Template`` whose values are there, in words."""

    def filled(text: str) -> str:
        return re.sub(r"\{([^}]+)\}", lambda name: said[name[1]], text)

    for way in ways:
        always, *more = re.split(r"\[(.*?)\]", way)
        with suppress(KeyError):  # of a value that is missing
            words = filled(always)
            for options, text in zip(more[::2], more[1::2], strict=True):
                words += (first_way(options.split("|"), said) or "") + filled(text)
            return words
    return None


class Answer:
    """A dataclass of quantities, descriptions and further answers.

    A field is left out where it is None; one that is a dictionary has answers, or quantities, by
    their names. An answer with a field ``inputs`` has its units, and so have the answers in it.
    """

    has_heading: ClassVar[bool] = True  # else its values stand among those around it

    def as_json(self, units: Units = Units.LINE) -> dict[str, Any]:
        """Names and values as JSON has them (NaN, infinity: None), with units beside the inputs."""
        units = self._units(units)
        table: dict[str, Any] = {}
        for (*outer, name), value in self._entries():
            place = table
            for key in outer:
                place = place.setdefault(key, {})
            own = value.as_json(units) if isinstance(value, Answer) else _for_json(value)
            place |= (
                own
                if isinstance(value, Answer) and not value.has_heading
                else {name if outer else _named(name, units): own}
            )
            if name == "inputs":
                table["units"] = self._units_of_keys(units)
        return table

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """Return a line for each value, its name in front."""
        lines = []
        units = self._units(units)
        for (*outer, name), value in self._entries():
            words = (
                _HEADINGS.get(outer[0], f"{outer[0].replace('_', ' ')} {{}}").format(name)
                if outer
                else LABELS.get(name) or _named(name, units).replace("_", " ")
            )
            if not isinstance(value, Answer):
                lines.append(line(indent, words, self._words([*outer, name][0], value, units)))
            elif not value.has_heading or name == "inputs":
                lines += value.lines(indent, units)
            else:
                lines += [indent + words, *value.lines(indent + "  ", units)]
        return lines

    def leaves(self, prefix: str = "", units: Units = Units.LINE) -> Iterator[tuple[str, Any, str]]:
        """Yield the dotted path, the value as JSON has it, and the words of each value.

        Of a pair come both numbers, as ``..._low`` and ``..._high``.
        """
        units = self._units(units)
        for (*outer, name), value in self._entries():
            path = prefix + ".".join([*outer, name if outer else _named(name, units)])
            if isinstance(value, Answer):
                yield from value.leaves(f"{path}." if value.has_heading else prefix, units)
                continue
            words = self._words([*outer, name][0], value, units)
            ends = ("_low", "_high") if isinstance(value, tuple) else ("",)
            values = value if isinstance(value, tuple) else (value,)
            for end, entry in zip(ends, values, strict=True):
                yield path + end, _for_json(entry), words

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def _units(self, units: Units) -> Units:
        found = (value.units for _, value in self._entries() if isinstance(value, Basis))
        return next(found, units)

    def _entries(self) -> Iterator[tuple[tuple[str, ...], Any]]:
        """Yield each value after its key, or after the two of one in a dictionary."""
        for name, value in self._values().items():
            if isinstance(value, dict):
                yield from (((name, inner), entry) for inner, entry in value.items())
            elif value is not None:
                yield (name,), value

    def _values(self) -> Mapping[str, Any]:
        return vars(self)

    def _units_of_keys(self, units: Units) -> dict[str, str]:
        """Return the unit of each key of a number, "1" where it has none."""
        units_by_key: dict[str, str] = {}
        for (name, *_), value in self._entries():
            if isinstance(value, Answer):
                units_by_key |= value._units_of_keys(units)
            elif not isinstance(value, str | IntEnum):
                units_by_key[_named(name, units)] = units.unit(self._quantity(name).unit) or "1"
        return units_by_key

    def _quantity(self, name: str) -> Quantity:
        return FORMATS[name]

    def _words(self, name: str, value: Any, units: Units) -> str:
        is_text = isinstance(value, str | IntEnum)
        return in_words(value) if is_text else self._quantity(name).words(value, units)


class Phrase(Answer):
    """An answer that has words for a row of the one that it is in."""

    def in_words(self, units: Units) -> str:
        """The words, with units."""
        raise NotImplementedError


@dataclass(frozen=True)
class GainAnswer(Answer):
    """Values by their names, which are attributes too, their formats, and whether it is stable.

    ``remarks`` are values that the short text alone has, and ``short`` are its rows. A table of
    several scenes has the values of which ``columns`` are the paths; * stands for any name.
    """

    values: dict[str, Any]
    formats: Mapping[str, Quantity] = field(default_factory=dict)
    is_stable: bool = True
    remarks: Mapping[str, Any] = field(default_factory=dict)
    short: Sequence[Template] = ()
    columns: Sequence[str] = ()

    def __getattr__(self, name: str) -> Any:
        """A value by its name."""
        if name == "values" or name not in self.values:
            raise AttributeError(f"the answer has no {name}")
        return self.values[name]

    @property
    def all_stable(self) -> bool:
        """True if the gains in it, and in all answers in it, are stable, or nothing is asked."""
        inner = (value for _, value in self._entries() if isinstance(value, GainAnswer))
        return self.is_stable and all(answer.all_stable for answer in inner)

    def facts(self) -> dict[str, str]:
        """The texts of an answer by name; of inputs those that are easily overlooked."""
        found = dict[str, str]()
        for (name, *_), value in self._entries():
            found |= value.facts() if isinstance(value, GainAnswer) else {name: value}
        return found

    def main_paths(self) -> Iterator[str]:
        """Return the paths of the values for a table of several scenes, in the order of leaves."""
        wanted = "|".join(self.columns).replace(".", r"\.").replace("*", "[^.]+")
        return (path for path, *_ in self.leaves() if re.fullmatch(wanted, path))

    def in_short(self) -> str:
        """The facts of the inputs, and the rows of the short text, in columns."""
        rows = self._rows(self.short, {}, self._units(Units.LINE))
        return table_text([*self.inputs.facts().items(), *rows])

    def _rows(
        self, rows: Sequence[Template], around: Mapping[str, str], units: Units
    ) -> Iterator[tuple[str, str]]:
        """Yield the names and words of the rows that have any."""

        def is_there(name: str) -> bool:
            return self.values.get(name) is not None

        said = {**around, **self._said(units)}
        for row in rows:
            if row.of:
                entry, indent = self.values.get(row.of) or {}, "  " * bool(row.ways)
                for key, answer in (entry if isinstance(entry, dict) else {"": entry}).items():
                    own = row._replace(name=row.name.format(key), of="")
                    yield from answer._rows([own], said, units)
                    inner = answer._rows(answer.short, said, units)
                    yield from ((indent + name, words) for name, words in inner)
            elif not is_there(row.unless) and (is_there(row.when) or not row.when):
                words = first_way(row.ways, said)
                yield from [] if words is None else [(row.name, words)]

    def _said(self, units: Units) -> dict[str, str]:
        """The words of values by name, those of a dictionary together, for ``Template``."""
        said = dict[str, str]()
        for name, value in {**self.values, **self.remarks}.items():
            every = value.values() if isinstance(value, dict) else [value] * (value is not None)
            phrases = [each.in_words(units) for each in every if isinstance(each, Phrase)]
            plain = [each for each in every if not isinstance(each, Answer)]
            words = ", also ".join([*phrases, *(self._words(name, each, units) for each in plain)])
            if words not in ("", Quantity.absent):
                said[name] = words
                if isinstance(value, tuple) or (isinstance(value, float) and isfinite(value)):
                    said[f"{name}!"] = words
        return said

    def _values(self) -> Mapping[str, Any]:
        return self.values

    def _quantity(self, name: str) -> Quantity:
        return self.formats.get(name) or FORMATS[name]


class Basis(GainAnswer):
    """The inputs that a scene's answers hold for; those that are easily overlooked are printed."""

    @property
    def units(self) -> Units:
        """The units of the answers."""
        return Units.LINE if self.motion is None else Units.ROTATION

    @property
    def range_of_delays(self) -> str | None:
        """The description of a range of delays; None for one delay."""
        return None if self.delay_is == ASSUMED else self.delay_is

    @property
    def delay_in_words(self) -> str:
        """The delay with its unit and in samples, or that it is assumed."""
        if self.delay_is == ASSUMED:
            return f"{self.delay:g} ({self.delay_is})"
        words = Quantity("s").words(self.delay)
        plural = "" if self.delay_samples == 1.0 else "s"
        return f"{words} ({Quantity().words(self.delay_samples)} sample{plural})"

    def facts(self) -> dict[str, str]:
        """The estimator, the filter, the delay and its range, and what moves."""
        words = {
            "velocity estimator": self.velocity,
            "position filter": self.position,
            "delay": self.delay_in_words,
            "range of delays": self.range_of_delays and f"the delay {self.range_of_delays}",
            "device damping": self.damping_is and f"0 ({self.damping_is})",
            "mechanics": self.mechanics,
            "postures": self.postures,
            "motion": self.motion,
        }
        return {name: said for name, said in words.items() if said is not None}

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """Return a line for each of the facts."""
        return [line(indent, name, said) for name, said in self.facts().items()]


def in_words(value: str | IntEnum) -> str:
    """Return the words of a status, or the name of a verdict."""
    return value if isinstance(value, str) else getattr(value, "words", value.name.lower())


def _named(name: str, units: Units) -> str:
    """Return the key of a quantity: inertia in place of mass for what turns."""
    return name.replace(Units.LINE.moved, units.moved)


def line(indent: str, name: str, words: str) -> str:
    """A name and words, which begin in the column of all answers."""
    column = 34  # where values begin
    return f"{indent}{name:{column - len(indent)}}{words}"


def _for_json(value: Any) -> Any:
    if isinstance(value, str | IntEnum):
        return in_words(value)
    if isinstance(value, tuple):
        return [_for_json(entry) for entry in value]
    return value if isfinite(value) else None


# The basis of a scene's answers, stated in front of them.

ASSUMED = "assumed: the scene names none"
