"""Answers with units, which print themselves as words and as JSON.

An answer is a frozen dataclass. The annotation of a number has its Quantity: the unit, the digits
that are printed and the side to which they are rounded. Limits are rounded inwards: what is printed
as the largest stable stiffness is not above it. JSON has all digits. Answers of a scene that turns
have the units of rotation, and inertia for mass.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN
from enum import IntEnum
from functools import cache
from math import isfinite, isinf, isnan
from typing import Annotated, Any, ClassVar, get_args, get_type_hints

from jaxstab.scene.units import Units
from jaxstab.shown import rounded_text

_LIMIT_DIGITS = 4
_MOST_DIGITS = 17
_COLUMN = 34  # where values begin


@dataclass(frozen=True)
class Quantity:
    """How a number is printed.

    Args:
        unit: of the number; one in s is printed in ms, one in m or rad in millionths.
        digits: significant digits.
        rounding: in the words of the module ``decimal``.
        infinite: the words for an infinite number.
    """

    unit: str = ""
    digits: int = 6
    rounding: str = ROUND_HALF_EVEN
    infinite: str = "unlimited"

    def words(self, value: Any, units: Units = Units.LINE) -> str:
        """Return a finite or infinite number with its unit."""
        return self._with_unit(self._text(value, self.rounding, self.digits), units)

    def _text(self, value: float, rounding: str, digits: int) -> str:
        if isinf(value):
            return self.infinite
        factor = {"s": 1000, "m": 10**6}.get(self.unit, 1)
        return rounded_text(value, digits, rounding, factor=factor)

    def _with_unit(self, text: str, units: Units) -> str:
        unit = {"s": "ms", "m": f"u{units.length}"}.get(self.unit, units.unit(self.unit))
        return f"{text} {unit}" if unit and text[-1].isdigit() else text


class IntervalQuantity(Quantity):
    """How an interval is printed: its ends inwards, with enough digits that they stay in order."""

    def words(self, value: Any, units: Units = Units.LINE) -> str:
        """Return the two ends with their unit."""
        low, high = value
        for digits in range(self.digits, _MOST_DIGITS + 1):
            ends = self._text(low, ROUND_CEILING, digits), self._text(high, ROUND_FLOOR, digits)
            if isinf(low) or isinf(high) or float(ends[0]) <= float(ends[1]):
                break
        return self._with_unit(" to ".join(ends), units)


def rounded_gain(value: float) -> float:
    """Return a gain with the digits with which it is printed."""
    return float(f"{value:.{Quantity.digits}g}")


Stiffness = Annotated[float, Quantity("N/m")]
Damping = Annotated[float, Quantity("N s/m")]
Mass = Annotated[float, Quantity("kg")]
Time = Annotated[float, Quantity("s")]
Frequency = Annotated[float, Quantity("Hz")]
Number = Annotated[float, Quantity()]
Bound = Annotated[float, Quantity(digits=3, rounding=ROUND_CEILING, infinite="not proved")]
LargestStiffness = Annotated[float, Quantity("N/m", _LIMIT_DIGITS, ROUND_FLOOR)]
StiffnessBound = Annotated[float, Quantity("N/m", _LIMIT_DIGITS, ROUND_CEILING)]
LargestDamping = Annotated[float, Quantity("N s/m", _LIMIT_DIGITS, ROUND_FLOOR)]
LargestTime = Annotated[float, Quantity("s", _LIMIT_DIGITS, ROUND_FLOOR)]
StiffnessLimits = Annotated[tuple[float, float], IntervalQuantity("N/m", _LIMIT_DIGITS)]
DampingLimits = Annotated[tuple[float, float], IntervalQuantity("N s/m", _LIMIT_DIGITS)]


class Answer:
    """What a dataclass of quantities, words and further answers has in common.

    A field is left out where it is None; a field of a dictionary stands for what is in it. An
    answer that ``is_part`` of another one has no heading of its own. An answer with a field
    ``basis`` has its units, and so has what is in it.
    """

    is_part: ClassVar[bool] = False
    absent: ClassVar[str] = "none"
    """The words for a number that is NaN."""

    def as_json(self, units: Units = Units.LINE) -> dict[str, Any]:
        """Return names and values as JSON has them: without NaN and infinity, which are None."""
        return dict(self._json_entries(self._units(units)))

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """Return a line for each value, its name in front."""
        lines, own = [], {field.name for field in fields(self)}  # type: ignore[arg-type]
        units = self._units(units)
        for name, value in self._entries():
            words = _named(name, units).replace("_", " ") if name in own else name  # as it is
            if isinstance(value, Answer):
                heading = [] if value.is_part else [indent + words]
                lines += heading + value.lines(indent if value.is_part else indent + "  ", units)
            else:
                text = self._words(name, value, units)
                lines.append(f"{indent}{words:{_COLUMN - len(indent)}}{text}")
        return lines

    def leaves(self, prefix: str = "", units: Units = Units.LINE) -> Iterator[tuple[str, Any, str]]:
        """Yield the dotted path, the value as JSON has it, and the words of each value."""
        units = self._units(units)
        for name, value in self._entries():
            path = prefix + _named(name, units)
            if isinstance(value, Answer):
                yield from value.leaves(prefix if value.is_part else f"{path}.", units)
            else:
                yield path, _for_json(value), self._words(name, value, units)

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def _units(self, units: Units) -> Units:
        basis = getattr(self, "basis", None)
        return basis.units if isinstance(basis, Basis) else units

    def _entries(self) -> Any:
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if isinstance(value, dict):
                yield from value.items()
            elif value is not None:
                yield field.name, value

    def _json_entries(self, units: Units) -> Any:
        for name, value in self._entries():
            if not isinstance(value, Answer):
                yield _named(name, units), _for_json(value)
            elif value.is_part:
                yield from value._json_entries(units)
            else:
                yield name, value.as_json(units)

    def _words(self, name: str, value: Any, units: Units) -> str:
        if isinstance(value, str | IntEnum):
            return in_words(value)
        is_absent = isnan(sum(value) if isinstance(value, tuple) else value)
        kind: Any = type(self)  # mypy holds it for not hashable
        return self.absent if is_absent else _quantities(kind)[name].words(value, units)


@dataclass(frozen=True)
class Basis(Answer):
    """What a scene's answers hold for.

    The estimator, the filter, what moves beside one mass, the masses of a device of several, and
    whether it turns.
    """

    is_part = True

    velocity: str
    position: str | None
    mechanics: str | None
    postures: str | None
    motion: str | None

    @property
    def units(self) -> Units:
        """The units of the answers."""
        return Units.LINE if self.motion is None else Units.ROTATION


@dataclass(frozen=True)
class Answers(Answer):
    """Several answers by their names."""

    basis: Basis | None
    by_name: dict[str, Any]


def in_words(value: str | IntEnum) -> str:
    """Return the words of a status, or the name of a verdict."""
    return value if isinstance(value, str) else getattr(value, "words", value.name.lower())


def _named(name: str, units: Units) -> str:
    moved = Units.LINE.moved
    return name.removesuffix(moved) + units.moved if name.endswith(moved) else name


def _for_json(value: Any) -> Any:
    if isinstance(value, str | IntEnum):
        return in_words(value)
    if isinstance(value, tuple):
        return [_for_json(part) for part in value]
    return value if isfinite(value) else None


@cache
def _quantities(kind: Any) -> dict[str, Quantity]:
    """Return the quantities of the annotated fields of an answer."""
    hints = get_type_hints(kind, include_extras=True)
    found = {}
    for name, hint in hints.items():
        for part in (hint, *get_args(hint)):  # of "quantity | None", too
            for note in getattr(part, "__metadata__", ()):
                if isinstance(note, Quantity):
                    found[name] = note
    return found
