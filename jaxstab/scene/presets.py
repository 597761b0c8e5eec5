"""Devices and software by name: the numbers of data/presets, each with its source."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from jaxstab.tables import Table, key, parsed

ASSUMED = "assumed"


def _words(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError("give words")
    return value


def _number_or_list(value: Any) -> Any:
    numbers = value if isinstance(value, list) else [value]
    if not all(isinstance(number, float) for number in numbers):
        raise ValueError("give a number with a decimal point, or a list of such")
    return value


@dataclass(frozen=True, kw_only=True)
class Sourced(Table):
    """A number or a list of coefficients, and where it is from."""

    value: Any = key(_number_or_list)
    unit: str = key(_words)
    source: str = key(_words)
    date: str = key(_words)

    def __str__(self) -> str:
        number = self.value if isinstance(self.value, list) else f"{self.value:g}"
        return f"{number} {self.unit}  ({self.source}; {self.date})"


@dataclass(frozen=True)
class Preset:
    """What is known of a device or of a velocity estimator, by the keys of a scene.

    Attributes:
        title: what it is.
        note: a remark on the numbers; may be empty.
        numbers: by key, in SI units. Keys that a scene does not have are for comparison.
    """

    title: str
    note: str
    numbers: dict[str, Sourced]

    def values(self, keys: tuple[str, ...]) -> dict[str, Any]:
        """Return the numbers of those of some keys that are known."""
        return {name: self.numbers[name].value for name in keys if name in self.numbers}

    def lines(self) -> list[str]:
        """Return a line for the title, one for each number with its source, and the note."""
        numbers = [f"  {name.replace('_', ' '):28}{value}" for name, value in self.numbers.items()]
        return [self.title, *numbers, *([f"  {self.note}"] if self.note else [])]


def device_presets() -> Mapping[str, Preset]:
    """Return the devices by their names."""
    return _presets("devices.toml")


def software_presets() -> Mapping[str, Preset]:
    """Return the velocity estimators of software by their names."""
    return _presets("software.toml")


@cache
def _presets(file: str) -> Mapping[str, Preset]:
    tables = parsed((_folder() / file).read_text(encoding="utf-8"), f"{file}: ")
    return {name: _preset(table, f"{file}: {name}") for name, table in tables.items()}


def _preset(table: Mapping[str, Any], place: str) -> Preset:
    numbers = {name: entry for name, entry in table.items() if name not in ("title", "note")}
    return Preset(
        table["title"],
        table.get("note", ""),
        {name: Sourced.from_table(entry, f"{place}.{name}") for name, entry in numbers.items()},
    )


def _folder() -> Traversable:
    """Return the folder of the presets: in the package where it is installed, or in a checkout."""
    installed = files("jaxstab") / "presets"
    in_checkout = Path(__file__).parents[2] / "data" / "presets"
    return installed if installed.is_dir() else in_checkout
