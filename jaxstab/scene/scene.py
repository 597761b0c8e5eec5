"""A haptic scene in SI units: what a TOML file or the command line says, checked; no JAX here."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Any, NamedTuple

from jaxstab.tables import Table, check_keys, interval, key, one_of, quantity, read_table, some_of

ANSWERS = ("limits", "check", "tune", "design")
MEASURES = ("margins", "distance", "radius", "settling", "oscillation")
MOST_SAMPLES = 1024  # of delay: the degree of what is solved
_MANY_SAMPLES = 1000  # of delay: more likely a slip of the unit


class Preset(NamedTuple):
    """A device by name: mass in kg, damping in N s/m, and where the numbers are from."""

    mass: float
    damping: float
    source: str


PRESETS = {
    "phantom": Preset(0.1, 1.5, "Remark 4 of Hulin, Preusche, Hirzinger (2008)"),
    "omega": Preset(0.25, 0.1, "assumed: the maker publishes neither mass nor damping"),
    "falcon": Preset(0.2, 0.1, "assumed: the maker publishes neither mass nor damping"),
}


@dataclass(frozen=True, kw_only=True)
class Device(Table):
    """The haptic device: effective mass in kg and physical damping in N s/m, or a preset."""

    preset: str | None = key(one_of(PRESETS), None)
    mass: float = key(quantity("kg", is_positive=True))
    damping: float = key(quantity("N s/m"))

    @classmethod
    def filled_in(cls, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """Let a preset give what the table does not."""
        preset = PRESETS.get(str(table.get("preset")))
        return {"mass": preset.mass, "damping": preset.damping, **table} if preset else table


@dataclass(frozen=True, kw_only=True)
class Hand(Table):
    """The hand that holds the device; each quantity a range from lowest to highest."""

    mass: tuple[float, float] = key(interval("kg"), (0.0, 0.0))
    stiffness: tuple[float, float] = key(interval("N/m"), (0.0, 0.0))
    damping: tuple[float, float] = key(interval("N s/m"), (0.0, 0.0))

    @property
    def varies(self) -> bool:
        """Whether this is more than one hand."""
        return any(low < high for low, high in (self.mass, self.stiffness, self.damping))


@dataclass(frozen=True, kw_only=True)
class Controller(Table):
    """The sampling period in s, and the delay of the loop in s or in samples."""

    sample_time: float = key(quantity("s", is_positive=True))
    delay: float | None = key(quantity("s"), None)
    delay_samples: float | None = key(quantity("samples"), None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.delay is not None and self.delay_samples is not None:
            raise ValueError(f"delay is {self.delay:g} beside delay_samples; give one.")
        if self.samples > MOST_SAMPLES:
            raise ValueError(
                f"delay is {self.samples:g} samples of {self.sample_time:g} s; give at most "
                f"{MOST_SAMPLES} samples, or a longer sample_time."
            )

    @property
    def time_delay(self) -> float:
        """The delay t_d in s."""
        return self.delay or (self.delay_samples or 0.0) * self.sample_time

    @property
    def samples(self) -> float:
        """The delay in samples."""
        return self.time_delay / self.sample_time


@dataclass(frozen=True, kw_only=True)
class Wall(Table):
    """A virtual wall: stiffness K in N/m and damping B in N s/m."""

    stiffness: float = key(quantity("N/m"))
    damping: float = key(quantity("N s/m"))


@dataclass(frozen=True, kw_only=True)
class Wanted(Table):
    """What to answer, and with which measures of a wall beside its verdict."""

    answers: tuple[str, ...] = key(some_of(ANSWERS), ("limits",))
    measures: tuple[str, ...] = key(some_of(MEASURES), MEASURES)
    at_damping: float | None = key(quantity("N s/m"), None)
    at_stiffness: float | None = key(quantity("N/m"), None)
    stiffness: float | None = key(quantity("N/m", is_positive=True), None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.answers:
            raise ValueError(f"answers is empty; give at least one of {', '.join(ANSWERS)}.")


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A device, the hand that holds it, its controller, walls, and what is wanted."""

    device: Device
    controller: Controller
    hand: Hand | None = None
    walls: dict[str, Wall] = field(default_factory=dict)
    wanted: Wanted = field(default_factory=Wanted)

    @classmethod
    def from_file(cls, path: str | PathLike[str]) -> "Scene":
        """Read a TOML file.

        Raises:
            OSError: the file cannot be read.
            ValueError: as for ``from_table``, with the name of the file.
        """
        return cls.from_table(read_table(path), str(path))

    @classmethod
    def from_table(cls, table: Mapping[str, Any], source: str = "") -> "Scene":
        """Check a table of tables, as TOML has them.

        Raises:
            ValueError: one sentence on the first key that is unknown, missing or has a bad value.
        """
        try:
            return cls(**_parts(table))
        except ValueError as error:
            raise ValueError(f"{source}: {error}" if source else str(error)) from None

    def require_walls(self) -> None:
        """Refuse a scene without a wall.

        Raises:
            ValueError: there is no wall.
        """
        if not self.walls:
            raise ValueError("walls is empty; give at least one wall with stiffness and damping.")

    def unusual(self) -> list[str]:
        """Return what looks like a slip of the unit, in words."""
        device, controller = self.device, self.controller
        hand = self.hand or Hand()
        found = [
            _outside("device.mass", device.mass, 1e-3, 50.0, "kg"),
            _outside("device.damping", device.damping, 0.0, 100.0, "N s/m"),
            _outside("hand.mass", hand.mass[1], 0.0, 20.0, "kg"),
            _outside("hand.stiffness", hand.stiffness[1], 0.0, 1e6, "N/m"),
            _outside("hand.damping", hand.damping[1], 0.0, 1e3, "N s/m"),
            _outside("controller.sample_time", controller.sample_time, 1e-5, 0.05, "s"),
            _outside("the delay", controller.time_delay, 0.0, 2.0, "s"),
            _many_samples(controller),
        ]
        for name, wall in self.walls.items():
            found.append(_outside(f"walls.{name}.stiffness", wall.stiffness, 0.0, 1e6, "N/m"))
            found.append(_outside(f"walls.{name}.damping", wall.damping, 0.0, 1e4, "N s/m"))
        return [words for words in found if words]


_PARTS: Mapping[str, type[Table]] = {
    "device": Device,
    "controller": Controller,
    "hand": Hand,
    "wanted": Wanted,
}


def _parts(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of a scene, checked."""
    check_keys("", table, [*_PARTS, "walls"])
    given = {"device": {}, "controller": {}, **table}  # which must not be left out
    parts: dict[str, Any] = {
        name: part.from_table(given[name], name) for name, part in _PARTS.items() if name in given
    }
    return parts | {"walls": _walls(table.get("walls", {}))}


def _walls(table: Any) -> dict[str, Wall]:
    walls = table if isinstance(table, Mapping) else {"": table}
    for name, wall in walls.items():
        if not isinstance(wall, Mapping):
            key_name = f"walls.{name}".rstrip(".")
            raise ValueError(f"{key_name} is {wall!r}; give a table [walls.NAME] for each wall.")
    return {name: Wall.from_table(wall, f"walls.{name}") for name, wall in walls.items()}


def _outside(name: str, value: float, low: float, high: float, unit: str) -> str:
    if low <= value <= high:
        return ""
    return f"{name} is {value:g} {unit}, usual are {low:g} to {high:g} {unit}"


def _many_samples(controller: Controller) -> str:
    """Return a warning for a delay that was meant in samples and given in s."""
    if controller.samples < _MANY_SAMPLES:
        return ""
    return f"the delay is {controller.samples:g} samples; one in samples is given as delay_samples"
