"""A haptic scene in SI units: what a TOML file or the command line says, checked; no JAX here."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Any, NamedTuple

from jaxstab.model import Filter, Velocity
from jaxstab.model.parameters import LONGEST_DELAY
from jaxstab.scene.estimators import PositionTable, VelocityTable
from jaxstab.scene.mechanics import LENGTH, Device, Hand
from jaxstab.scene.units import Units
from jaxstab.shown import shortened
from jaxstab.tables import (
    Table,
    check_keys,
    checked_label,
    each,
    key,
    nested,
    one_of,
    quantity,
    read_table,
    share,
    tolerance,
)

ANSWERS = ("limits", "check", "tune", "design")
MEASURES = ("margins", "distance", "radius", "settling", "oscillation", "chatter")
_FEW_SAMPLES = 0.01  # of delay: more likely s
_SOFT = 5.0  # N/m: more likely N/mm, of a device above _LIGHT in kg
_LIGHT = 0.01
_MANY_SAMPLES = 200  # of delay: more likely a slip of the unit
_MOST_SAMPLES_OF_HANDS = 128  # the same for each of hundreds of hands of a range
MOST_WALLS = 1000


@dataclass(frozen=True, kw_only=True)
class Controller(Table):
    """The sampling period in s, the delay of the loop in s or in samples, and what is filtered."""

    sample_time: float = key(quantity("s", is_positive=True))
    delay: float | None = key(quantity("s"), None)
    delay_samples: float | None = key(quantity("samples"), None)
    velocity: VelocityTable | None = key(nested(VelocityTable), None)
    position: PositionTable | None = key(nested(PositionTable), None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.delay is not None and self.delay_samples is not None:
            raise ValueError(f"delay is {self.delay:g} beside delay_samples; give one.")
        if self.samples > LONGEST_DELAY:
            raise ValueError(
                f"delay is {self.samples:g} samples of {self.sample_time:g} s; give at most "
                f"{LONGEST_DELAY:g} samples, or a longer sample_time; one in samples is given as "
                "delay_samples."
            )
        for name, made in (("velocity", self.estimator), ("position", self.position_filter)):
            if made is not None:
                filter_ = made.filter if isinstance(made, Velocity) else made
                try:
                    filter_.transfer(self.sample_time)
                except ValueError as error:
                    raise ValueError(f"{name}.{error}") from None

    @property
    def time_delay(self) -> float:
        """The delay t_d in s."""
        return self.delay or (self.delay_samples or 0.0) * self.sample_time

    @property
    def samples(self) -> float:
        """The delay in samples."""
        return self.time_delay / self.sample_time

    @property
    def estimator(self) -> Velocity | None:
        """The velocity estimator; None for the difference over one sample."""
        return None if self.velocity is None else self.velocity.as_velocity()

    @property
    def position_filter(self) -> Filter | None:
        """The filter of the position, if there is one."""
        return None if self.position is None else self.position.as_filter()


@dataclass(frozen=True, kw_only=True)
class Wall(Table):
    """A virtual wall: stiffness K in N/m and damping B in N s/m."""

    stiffness: float = key(quantity("N/m"))
    damping: float = key(quantity("N s/m"))


@dataclass(frozen=True, kw_only=True)
class Wanted(Table):
    """What to answer, and with which measures of a wall beside its verdict."""

    answers: tuple[str, ...] = key(each(one_of(ANSWERS)), ("limits",))
    measures: tuple[str, ...] = key(each(one_of(MEASURES)), MEASURES)
    at_damping: float | None = key(quantity("N s/m"), None)
    at_stiffness: float | None = key(quantity("N/m"), None)
    stiffness: float | None = key(quantity("N/m", is_positive=True), None)
    chatter: float | None = key(quantity(LENGTH, is_positive=True), None)
    safety: float | None = key(share, None)
    mass_tolerance: float | None = key(tolerance, None)
    delay_tolerance: float | None = key(quantity("s"), None)

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

    def __post_init__(self) -> None:
        hand, turns = self.hand or Hand(), self.device.units is Units.ROTATION
        if hand.varies and self.controller.samples > _MOST_SAMPLES_OF_HANDS:
            raise ValueError(
                f"controller.delay is {self.controller.samples:g} samples beside a range of hands; "
                f"give at most {_MOST_SAMPLES_OF_HANDS} samples, or one hand."
            )
        if self.wanted.chatter is not None and self.device.encoder is None:
            raise ValueError(
                f"wanted.chatter is {self.wanted.chatter:g}, but no encoder is known; give "
                "device.encoder.resolution."
            )
        if turns and hand.mass != (0.0, 0.0):
            raise ValueError(
                f"hand.mass is {list(hand.mass)} beside device.inertia; a device that turns moves "
                "an inertia of the hand: give hand.inertia in kg m^2."
            )
        if hand.inertia is not None and not turns:
            raise ValueError(
                f"hand.inertia is {list(hand.inertia)} beside device.mass; give hand.mass in kg, "
                "or device.inertia."
            )

    @property
    def units(self) -> Units:
        """The units of the whole scene."""
        return self.device.units

    @classmethod
    def from_file(cls, path: str | PathLike[str]) -> "Scene":
        """Read a TOML file.

        Raises:
            OSError: the file cannot be read.
            ValueError: as for ``from_table``, with the name of the file.
        """
        return cls.from_table(read_table(path, "scene"), str(path))

    @classmethod
    def from_table(cls, table: Mapping[str, Any], source: str = "") -> "Scene":
        """Check a table of tables, as TOML has them.

        Raises:
            ValueError: one sentence on the first key that is unknown, missing or has a bad value.
        """
        try:
            return cls(**_parts(table))
        except ValueError as error:
            words = _units_of(table).translated(str(error))
            raise ValueError(f"{source}: {words}" if source else words) from None

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
        hand, units = self.hand or Hand(), self.units
        kilogram, stiffness, damping = units.kilogram, units.stiffness, units.damping
        mass, usual = ("mass", _USUAL) if units is Units.LINE else ("inertia", _USUAL_TURNING)
        found = [
            *(
                _outside(f"device.{mass}", value, *usual.device_mass, kilogram)
                for value in dict.fromkeys(device.effective_mass)
            ),
            _outside("device.damping", device.damping, *usual.device_damping, damping),
            *_unusual_mechanics(device, hand, usual),
            _outside(f"hand.{mass}", hand.effective_mass[1], *usual.hand_mass, kilogram),
            _outside("hand.stiffness", hand.stiffness[1], *usual.stiffness, stiffness),
            _outside("hand.damping", hand.damping[1], *usual.hand_damping, damping),
            _outside("controller.sample_time", controller.sample_time, 1e-5, 0.05, "s"),
            _outside("the delay", controller.time_delay, 0.0, 2.0, "s"),
            _many_samples(controller),
            _few_samples(controller),
            _other_period(controller),
        ]
        for name, wall in self.walls.items():
            found += [
                _outside(f"walls.{name}.stiffness", wall.stiffness, *usual.stiffness, stiffness),
                _outside(f"walls.{name}.damping", wall.damping, *usual.damping, damping),
                self._slip_of_wall(f"walls.{name}", wall),
            ]
        return [words for words in found if words]

    def _slip_of_wall(self, name: str, wall: Wall) -> str:
        """Return a warning for gains that were swapped, or a stiffness in N/mm."""
        units, is_line = self.units, self.units is Units.LINE
        if wall.damping > wall.stiffness > 0.0:
            return (
                f"{name} has a damping of {wall.damping:g} {units.damping} beside a stiffness of "
                f"{wall.stiffness:g} {units.stiffness}; are they swapped?"
            )
        is_heavy = is_line and self.device.effective_mass[0] > _LIGHT
        if is_heavy and 0.0 < wall.stiffness < _SOFT:
            return f"{name}.stiffness is {wall.stiffness:g} N/m; is it in N/mm?"
        return ""


class _Usual(NamedTuple):
    """The ends of what is usual of each quantity."""

    device_mass: tuple[float, float]
    device_damping: tuple[float, float]
    hand_mass: tuple[float, float]
    hand_damping: tuple[float, float]
    stiffness: tuple[float, float]
    damping: tuple[float, float]


_USUAL = _Usual((1e-3, 50.0), (0.0, 100.0), (0.0, 20.0), (0.0, 1e3), (0.0, 1e6), (0.0, 1e4))
_USUAL_TURNING = _Usual((1e-8, 1.0), (0.0, 10.0), (0.0, 1.0), (0.0, 100.0), (0.0, 1e5), (0.0, 1e3))

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
    if not isinstance(table, Mapping):
        raise ValueError(f"walls is {shortened(table)}; give a table [walls.NAME] for each wall.")
    if len(table) > MOST_WALLS:
        raise ValueError(f"walls has {len(table)} entries; give {MOST_WALLS} at most.")
    for name, wall in table.items():
        checked_label("wall", name)
        if not isinstance(wall, Mapping):
            raise ValueError(
                f"walls.{name} is {shortened(wall)}; give a table [walls.NAME] for each wall."
            )
    return {name: Wall.from_table(wall, f"walls.{name}") for name, wall in table.items()}


def _outside(name: str, value: float, low: float, high: float, unit: str) -> str:
    if low <= value <= high:
        return ""
    words = f"{name} is {value:g} {unit}, usual are {low:g} to {high:g} {unit}"
    return " ".join(words.split()).replace(" ,", ",")


def _unusual_mechanics(device: Device, hand: Hand, usual: _Usual) -> Iterator[str]:
    """Yield warnings for an encoder, modes, an actuator and a grip in other units."""
    units = device.units
    if device.encoder is not None:
        resolution = device.encoder.resolution
        yield _outside("device.encoder.resolution", resolution, 1e-9, 1e-3, units.length)
    for number, mode in enumerate(device.modes):
        name = f"device.modes.{number}"
        yield _outside(f"{name}.frequency", mode.frequency, 0.1, 1e4, "Hz")
        yield _outside(f"{name}.damping_ratio", mode.damping_ratio, 0.0, 1.0, "")
        low, high = usual.device_mass
        moved = abs(mode.effective_mass)
        yield _outside(f"{name}.modal_{units.moved}", moved, low, 100.0 * high, units.kilogram)
    if device.actuator is not None:
        yield _outside("device.actuator.bandwidth", device.actuator.bandwidth, 1.0, 1e5, "Hz")
    if hand.grip is not None:
        grip, limits = hand.grip, (usual.stiffness, usual.hand_damping)
        yield _outside("hand.grip.stiffness", grip.stiffness, *limits[0], units.stiffness)
        yield _outside("hand.grip.damping", grip.damping, *limits[1], units.damping)


def _many_samples(controller: Controller) -> str:
    """Return a warning for a delay that was meant in samples and given in s."""
    if controller.samples < _MANY_SAMPLES:
        return ""
    return f"the delay is {controller.samples:g} samples; one in samples is given as delay_samples"


def _few_samples(controller: Controller) -> str:
    """Return a warning for a delay that was meant in s and given in samples."""
    if not 0.0 < (controller.delay_samples or 0.0) < _FEW_SAMPLES:
        return ""
    return f"the delay is {controller.delay_samples:g} samples; one in s is given as delay"


def _other_period(controller: Controller) -> str:
    """Return a warning for a preset whose numbers are meant for another sampling period."""
    usual = controller.velocity.usual_sample_time if controller.velocity else None
    if usual is None or usual == controller.sample_time:
        return ""
    name = controller.velocity.preset if controller.velocity else ""
    return f"the preset {name!r} is meant for a sample_time of {usual:g} s"


def _units_of(table: Mapping[str, Any]) -> Units:
    device = table.get("device")
    is_turning = isinstance(device, Mapping) and "inertia" in device
    return Units.ROTATION if is_turning else Units.LINE
