"""A haptic scene in SI units: the tables of a TOML file or of options, checked; no JAX here."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

from jaxstab import tables as t
from jaxstab.answers import Units
from jaxstab.model import Filter, Velocity
from jaxstab.model.filter_tables import WINDOW, FilterTable
from jaxstab.model.plant import LONGEST_DELAY
from jaxstab.shown import shortened

# Devices and software by name: the numbers of data/presets, each with its source.


@cache
def presets(kind: str) -> Mapping[str, Mapping[str, Any]]:
    """Return the "devices", or the velocity estimators of "software", by their names.

    Each has a title, perhaps a note, and by their keys numbers or lists of coefficients: tables of
    value, unit, source and date.
    """
    text = (folder_of("presets") / f"{kind}.toml").read_text(encoding="utf-8")
    return t.parsed(text, f"{kind}.toml: ")


def numbers_in(preset: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The numbers of a preset, by their keys."""
    return {name: own for name, own in preset.items() if isinstance(own, dict)}


def values_in(preset: Mapping[str, Any], keys: Iterable[str]) -> dict[str, Any]:
    """The values of those keys that a preset has."""
    return {name: preset[name]["value"] for name in keys if name in preset}


def folder_of(name: str) -> Traversable:
    """Return a folder of data/: in the package where it is installed, or in a checkout."""
    installed = files("jaxstab") / name
    in_checkout = Path(__file__).parents[3] / "data" / name
    return installed if installed.is_dir() else in_checkout


# What moves in a scene: the device and the hand that holds it, as tables of a file.

LENGTH = "m, or in rad for a device that turns"


FORCE = "N, or in N m for a device that turns"


_DELAYS = t.Usual(0.0, 2.0)  # in s


_STIFFNESS = t.Usual(0.0, 1e6, (0.0, 1e5))  # of hands, grips and walls


_DAMPING_OF_HANDS = t.Usual(0.0, 1e3, (0.0, 100.0))


@dataclass(frozen=True, kw_only=True)
class Encoder(t.Table):
    """The encoder, by its resolution at the handle."""

    resolution: float = t.key(t.quantity(LENGTH, is_positive=True), usual=t.Usual(1e-9, 1e-3))


@dataclass(frozen=True, kw_only=True)
class VibrationMode(t.Table):
    """A vibration mode of the device: its displacement adds to the rigid body's.

    ``motor``, ``encoder`` and ``handle`` are its shapes there, 1 where they are one point.
    """

    frequency: float = t.key(t.quantity("Hz", is_positive=True), usual=t.Usual(0.1, 1e4))
    damping_ratio: float = t.key(t.quantity("1"), usual=t.Usual(0.0, 1.0))
    modal_mass: float | None = t.key(t.not_zero("kg"), None, t.Usual(1e-3, 5e3))
    modal_inertia: float | None = t.key(t.not_zero("kg m^2"), None, t.Usual(1e-8, 100.0))
    motor: float = t.key(t.any_number, 1.0, words="shape of the mode at the motor")
    encoder: float = t.key(t.any_number, 1.0, words="shape of the mode at the encoder")
    handle: float = t.key(t.any_number, 1.0, words="shape of the mode where the hand is")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.modal_mass is None) == (self.modal_inertia is None):
            given = "both given" if self.modal_mass is not None else "missing"
            raise ValueError(
                f"modal_mass and modal_inertia are {given}; give modal_mass in kg, or "
                "modal_inertia in kg m^2 for a device that turns."
            )

    @property
    def effective_mass(self) -> float:
        """The modal mass in kg, or the modal moment of inertia in kg m^2."""
        return self.modal_mass or self.modal_inertia or 0.0


@dataclass(frozen=True, kw_only=True)
class Actuator(t.Table):
    """The motor with its amplifier: the bandwidth at which the force is 3 dB too weak."""

    bandwidth: float = t.key(t.quantity("Hz", is_positive=True), usual=t.Usual(1.0, 1e5))


@dataclass(frozen=True, kw_only=True)
class DeviceTable(t.Table):
    """The haptic device: effective mass in kg and physical damping in N s/m, or a preset.

    A device that turns has a moment of inertia in kg m^2 in place of the mass, and its damping is
    in N m s/rad; it is 0 if none is given. Mass or inertia may be a range, from the lowest to the
    highest one of all postures. Vibration modes and an actuator are of any device. Friction is
    simulated, see ``ContactTable``.
    """

    preset: str | None = t.key(
        lambda name: t.one_of(presets("devices"))(name),
        None,
        words="a device by name; jaxstab scene presets lists names",
    )
    mass: tuple[float, float] | None = t.key(
        t.IntervalCheck("kg", is_positive=True), None, t.MASSES, words="mass of the device"
    )
    inertia: tuple[float, float] | None = t.key(
        t.IntervalCheck("kg m^2", is_positive=True),
        None,
        t.INERTIAS,
        words="moment of inertia of the device",
    )
    damping: float | None = t.key(
        t.quantity("N s/m"), None, t.Usual(0.0, 100.0, (0.0, 10.0)), words="damping of the device"
    )
    encoder: Encoder | None = t.key(t.nested(Encoder), None)
    modes: tuple[VibrationMode, ...] = t.key(t.each(t.nested(VibrationMode)), ())
    actuator: Actuator | None = t.key(t.nested(Actuator), None)
    friction: float = t.key(t.quantity(FORCE), 0.0, words="Coulomb friction of simulated contacts")
    static_friction: float | None = t.key(t.quantity(FORCE), None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.static_friction is not None and self.static_friction < self.friction:
            raise ValueError(
                f"static_friction is {self.static_friction:g} beside a friction of "
                f"{self.friction:g}; give it at least as large."
            )
        if self.mass is not None and self.inertia is not None:
            raise ValueError(
                f"mass is {self.mass[0]:g} beside inertia; give mass for a device that moves along "
                "a line, or inertia for one that turns."
            )
        if self.mass is None and self.inertia is None:
            raise ValueError(
                f"mass is missing; give it {self.asked('mass')}, or inertia "
                f"{self.asked('inertia')} for a device that turns."
            )
        for index, mode in enumerate(self.modes):
            if (mode.modal_inertia is None) != (self.inertia is None):
                own, other = ("mass", "inertia") if self.inertia is None else ("inertia", "mass")
                raise ValueError(
                    f"modes.{index}.modal_{other} is {mode.effective_mass:g} beside {own}; give "
                    f"modal_{own}."
                )

    @classmethod
    def filled_in(cls, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """Take the values that are missing in the table from its preset."""
        preset = presets("devices").get(str(table.get("preset")))
        if preset is None:
            return table  # a preset that is not known is refused
        defaults = values_in(preset, ("mass", "damping"))
        if "mass" not in {*defaults, *table}:
            raise ValueError(
                f"mass is missing; no source has that of the preset {table['preset']!r}, so give "
                f"it {cls.asked('mass')}."
            )
        return {**defaults, **table}

    @property
    def units(self) -> Units:
        """The units of whatever belongs to the device."""
        return Units.LINE if self.inertia is None else Units.ROTATION

    @property
    def effective_mass(self) -> tuple[float, float]:
        """The lowest and the highest mass in kg, or moment of inertia in kg m^2."""
        return self.mass or self.inertia or (0.0, 0.0)

    @property
    def effective_damping(self) -> float:
        """The damping in N s/m, or N m s/rad; 0 where none is given."""
        return self.damping or 0.0

    @property
    def varies(self) -> bool:
        """True if the mass is a range."""
        return self.effective_mass[0] < self.effective_mass[1]


@dataclass(frozen=True, kw_only=True)
class Grip(t.Table):
    """The grip between device and arm: a spring and a damper in parallel."""

    stiffness: float = t.key(t.quantity("N/m"), usual=_STIFFNESS)
    damping: float = t.key(t.quantity("N s/m"), 0.0, _DAMPING_OF_HANDS)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stiffness == self.damping == 0.0:
            raise ValueError("stiffness and damping are 0; give a grip that holds something.")


@dataclass(frozen=True, kw_only=True)
class HandTable(t.Table):
    """The hand that holds the device; each quantity a range from lowest to highest.

    With a grip these are of the arm behind it; without one the hand is rigidly attached to the
    device.
    """

    mass: tuple[float, float] = t.key(
        t.IntervalCheck("kg"), (0.0, 0.0), t.Usual(0.0, 20.0), words="mass of the hand"
    )
    inertia: tuple[float, float] | None = t.key(
        t.IntervalCheck("kg m^2"), None, t.Usual(0.0, 5.0), words="moment of inertia of the hand"
    )
    stiffness: tuple[float, float] = t.key(
        t.IntervalCheck("N/m"), (0.0, 0.0), _STIFFNESS, words="stiffness of the hand"
    )
    damping: tuple[float, float] = t.key(
        t.IntervalCheck("N s/m"), (0.0, 0.0), _DAMPING_OF_HANDS, words="damping of the hand"
    )
    grip: Grip | None = t.key(t.nested(Grip), None)

    @property
    def effective_mass(self) -> tuple[float, float]:
        """The mass in kg, or the moment of inertia in kg m^2."""
        return self.inertia or self.mass

    @property
    def ranges(self) -> tuple[tuple[float, float], ...]:
        """The ranges of mass or inertia, stiffness and damping."""
        return self.effective_mass, self.stiffness, self.damping

    @property
    def varies(self) -> bool:
        """True for more than one hand."""
        return any(low < high for low, high in self.ranges)

    @property
    def is_there(self) -> bool:
        """True if a hand of the range does anything."""
        return any(high for _, high in self.ranges)


# The velocity estimator and the position filter of a scene, as tables of a file.


@dataclass(frozen=True, kw_only=True)
class _TimedTable(FilterTable):
    """The keys of a filter, and the window in s."""

    window: float | None = t.key(t.quantity("s", is_positive=True), None, words=WINDOW)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.window is not None and self.window_samples is not None:
            raise ValueError(f"window is {self.window:g} beside window_samples; give one.")

    @property
    def _length(self) -> dict[str, Any]:
        return super()._length if self.window is None else {"window": self.window}


@dataclass(frozen=True, kw_only=True)
class PositionTable(_TimedTable):
    """The filter of the position that the wall's spring sees."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.as_filter()


@dataclass(frozen=True, kw_only=True)
class VelocityTable(_TimedTable):
    """The estimator of the velocity that the wall's damper sees, or that of a software by name."""

    preset: str | None = t.key(
        lambda name: t.one_of(presets("software"))(name),
        None,
        words="as this software estimates it; jaxstab scene presets lists names",
    )

    names_besides: ClassVar[tuple[str, ...]] = ("preset",)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.as_velocity()

    @classmethod
    def filled_in(cls, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """Take the values that are missing in the table from its preset."""
        preset = presets("software").get(str(table.get("preset")))
        if preset is None:
            return table
        defaults = values_in(preset, (entry.name for entry in fields(cls)))
        if "window_samples" in table:
            defaults.pop("window", None)
        if len(table) == 1 and not defaults:
            raise ValueError(
                f"preset is {table['preset']!r}, whose estimator its maker does not document; "
                "give window, cutoff or coefficients that you have measured."
            )
        return {**defaults, **table}

    @property
    def of_preset(self) -> Mapping[str, Any]:
        """The preset."""
        return presets("software")[self.preset] if self.preset else {}

    def __str__(self) -> str:
        words, others = f"preset {self.preset}", list[str]()
        for name, number in numbers_in(self.of_preset).items():
            value = number["value"]
            given = getattr(self, name, value)
            if (list(given) if isinstance(value, list) else given) != value:
                others.append(name)
            elif "assumed" in number["source"]:
                words = f"preset {self.preset}, assumed in part"
        words += f", with another {' and '.join(others)}" if others else ""
        return f"{self.as_velocity()}{f' ({words})' if self.preset else ''}"


MEASURES = (
    *("margins", "frequency", "distance", "radius", "settling", "oscillation", "chatter", "jitter"),
)


def range_in_words(ends: tuple[float, float]) -> str:
    """Return one number, or the two ends of a range."""
    low, high = ends
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


@dataclass(frozen=True, kw_only=True)
class ControllerTable(t.Table):
    """The sampling period in s, the delay of the loop in s or in samples, and the filters.

    A range of delays is of one that moves from sample to sample, the newest sample that has arrived
    setting the force, unless ``delay_is`` says that it is constant, only unknown.
    """

    sample_time: float = t.key(
        t.quantity("s", is_positive=True), usual=t.PERIODS, words="sampling period"
    )
    delay: tuple[float, float] | None = t.key(t.IntervalCheck("s"), None, words="delay")
    delay_samples: tuple[float, float] | None = t.key(
        t.IntervalCheck("samples"), None, words="delay"
    )
    delay_is: str | None = t.key(
        t.one_of(("moving", "constant")),
        None,
        words="a delay in a range is constant but unknown; else it moves with every sample",
    )
    lost_samples: int = t.key(
        t.whole(0, int(LONGEST_DELAY)),
        0,
        words="samples in a row that may never arrive, with a delay that moves",
    )
    max_force: float | None = t.key(t.quantity(FORCE, is_positive=True), None)
    force_step: float = t.key(t.quantity(FORCE), 0.0)
    velocity: VelocityTable | None = t.key(t.nested(VelocityTable), None)
    position: PositionTable | None = t.key(t.nested(PositionTable), None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.delay is not None and self.delay_samples is not None:
            words = range_in_words(self.delay)
            raise ValueError(f"delay is {words} beside delay_samples; give one.")
        if self.lost_samples and not self.moves:
            raise ValueError(
                f"lost_samples is {self.lost_samples} beside a delay that is constant; give delay "
                '= [shortest, longest], or delay_is = "moving" if only samples are lost.'
            )
        if self.samples + self.lost_samples > LONGEST_DELAY:
            loss = f" and {self.lost_samples} are lost" if self.lost_samples else ""
            raise ValueError(
                f"delay is {self.samples:g} samples of {self.sample_time:g} s{loss}; give at most "
                f"{LONGEST_DELAY:g} samples, or a longer sample_time; one in samples is given as "
                "delay_samples."
            )
        for name, made in (("velocity", self.estimator), ("position", self.position_filter)):
            if made is not None:
                filter_ = made.filter if isinstance(made, Velocity) else made
                try:
                    filter_.checked(self.sample_time)
                except ValueError as error:
                    raise ValueError(f"{name}.{error}") from None

    @property
    def delays(self) -> tuple[float, float]:
        """The shortest and the longest delay in s."""
        low, high = self.delay_samples or (0.0, 0.0)
        return self.delay or (low * self.sample_time, high * self.sample_time)

    @property
    def moves(self) -> bool:
        """True if the delay changes from sample to sample."""
        low, high = self.delays
        return self.delay_is != "constant" and (low < high or self.delay_is == "moving")

    @property
    def has_one_delay(self) -> bool:
        """True if the delay is known and constant."""
        return not self.moves and self.delays[0] == self.delays[1]

    @property
    def time_delay(self) -> float:
        """The delay t_d in s; ValueError unless it is known and constant."""
        self.require_one_delay("this answer")
        return self.delays[0]

    def require_one_delay(self, what: str) -> None:
        """Refuse a delay that is not known or not constant."""
        if not self.has_one_delay:
            option = " --lost-samples 0" if self.lost_samples else ""
            raise ValueError(
                f"the delay is {range_in_words(self.delays)} s{' and moves' if self.moves else ''},"
                f" but {what} is for one constant delay; give one, such as --delay "
                f"{self.delays[1]:g}{option}."
            )

    @property
    def samples(self) -> float:
        """The longest delay in samples."""
        return self.delays[1] / self.sample_time

    @property
    def estimator(self) -> Velocity | None:
        """The velocity estimator; None for the difference over one sample."""
        return None if self.velocity is None else self.velocity.as_velocity()

    @property
    def position_filter(self) -> Filter | None:
        """The filter of the position, if there is one."""
        return None if self.position is None else self.position.as_filter()


@dataclass(frozen=True, kw_only=True)
class WallTable(t.Table):
    """A virtual wall: stiffness K in N/m and damping B in N s/m."""

    stiffness: float = t.key(t.quantity("N/m"), usual=_STIFFNESS)
    damping: float = t.key(t.quantity("N s/m"), usual=t.Usual(0.0, 1e4, (0.0, 1e3)))


@dataclass(frozen=True, kw_only=True)
class ContactTable(t.Table):
    """The way in which the device meets a wall in simulated contacts; see ``Scene.start``."""

    push: float | None = t.key(
        t.quantity(FORCE), None, words="push of the hand in simulated contacts"
    )
    speed: float | None = t.key(
        t.quantity("m/s, or in rad/s for a device that turns"),
        None,
        words="speed at which simulated contacts begin",
    )
    one_sided: bool = t.key(t.truth, True)
    gate: str = t.key(t.one_of(("position", "force")), "position")
    duration: float = t.key(t.quantity("s", is_positive=True), 4.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.push == self.speed == 0.0:
            raise ValueError("push and speed are 0, so nothing moves; give one of them.")
        if self.gate == "force" and not self.one_sided:
            raise ValueError('gate is "force", of a wall that only pushes; leave out one_sided.')


FINGER = {Units.LINE: (1.0, 0.1), Units.ROTATION: (0.05, 1.0)}  # push and speed: N, m/s; N m, rad/s


def _factors(value: Any) -> tuple[float, float]:
    """Return the least and the largest factor of a gain margin; one alone is the largest."""
    both = value if isinstance(value, list | tuple) else (1.0, value)
    words = "give a factor > 1, such as 2, or [least, largest], such as [0.5, 2]"
    try:
        low, high = map(t.any_number, both)
    except ValueError:
        raise ValueError(words) from None
    if not 0.0 < low <= 1.0 < high:
        raise ValueError(words)
    return low, high


@dataclass(frozen=True, kw_only=True)
class MarginTable(t.Table):
    """The margins that usable gains have; None for one that does not matter."""

    phase_margin: float | None = t.key(
        t.NumberCheck("a number > 0 and < 180 in degrees", lambda x: 0.0 < x < 180.0, "degrees"),
        None,
        words="the phase margin that usable gains have,",
    )
    gain_margin: tuple[float, float] | None = t.key(
        _factors, None, words="the factor up to which usable gains may be multiplied, such as 2"
    )
    sensitivity: float | None = t.key(
        t.NumberCheck("a finite number > 1", lambda x: x > 1.0),
        None,
        words="the peak of |S| of usable gains, at most, such as 2",
    )
    delay_margin: float | None = t.key(
        t.quantity("s", is_positive=True),
        None,
        words="the delay by which the loop of usable gains may be late,",
    )

    @property
    def margins(self) -> dict[str, Any]:
        """Those that are wanted, as ``is_usable`` takes them."""
        return margins_of(vars(self))


def margins_of(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """The margins among what is wanted, as ``is_usable`` takes them."""
    values = {entry.name: wanted[entry.name] for entry in fields(MarginTable)}
    return {name: value for name, value in values.items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class Wanted(MarginTable):
    """The measures of a wall beside its verdict, and requirements on the answers."""

    measures: tuple[str, ...] = t.key(t.each(t.one_of(MEASURES)), MEASURES)
    frequency: bool = t.key(
        t.truth,
        False,
        words="print all frequency margins, peaks of |S| and |T|, and the disk margin",
    )
    at_damping: float | None = t.key(
        t.quantity("N s/m"), None, words="give the limits of K at this B"
    )
    at_stiffness: float | None = t.key(
        t.quantity("N/m"), None, words="give the limits of B, or the best B, at this K"
    )
    stiffness: float | None = t.key(
        t.quantity("N/m", is_positive=True), None, words="the stiffness to design for"
    )
    chatter: float | None = t.key(t.quantity(LENGTH, is_positive=True), None)
    safety: float | None = t.key(t.share, None, words="multiply all limits by this, such as 0.8")
    mass_tolerance: float | None = t.key(
        t.tolerance, None, words="of the device; 0.1 means 10 % up and down"
    )
    delay_tolerance: float | None = t.key(t.quantity("s"), None, words="of the delay, up and down,")


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A device, the hand that holds it, its controller, walls, and wishes."""

    device: DeviceTable
    controller: ControllerTable
    hand: HandTable | None = None
    walls: dict[str, WallTable] = field(default_factory=dict)
    wanted: Wanted = field(default_factory=Wanted)
    contact: ContactTable | None = None

    def __post_init__(self) -> None:
        hand, turns = self.hand or HandTable(), self.device.units is Units.ROTATION
        most_samples_of_hands = 128  # the same for each of hundreds of hands of a range
        if hand.varies and self.controller.samples > most_samples_of_hands:
            raise ValueError(
                f"controller.delay is {self.controller.samples:g} samples beside a range of hands; "
                f"give at most {most_samples_of_hands} samples, or one hand."
            )
        if self.wanted.chatter is not None and self.device.encoder is None:
            raise ValueError(
                f"wanted.chatter is {self.wanted.chatter:g}, but no encoder is known; give "
                "device.encoder.resolution."
            )
        limits = self.controller.max_force, self.controller.force_step
        frictions = self.device.friction, self.device.static_friction
        if self.contact is None and any((*frictions, *limits)):  # verdicts are without these
            object.__setattr__(self, "contact", ContactTable())
        if turns and hand.mass != (0.0, 0.0):
            raise ValueError(
                f"hand.mass is {list(hand.mass)} beside device.inertia; a device that turns moves "
                "an inertia of the hand: give hand.inertia in kg m^2."
            )
        for index, mode in enumerate(self.device.modes if hand.is_there else ()):
            if mode.effective_mass < 0.0:
                raise ValueError(
                    f"device.modes.{index}.modal_{self.units.moved} is {mode.effective_mass:g} "
                    "beside a hand: such a mode moves motor and encoder against each other, and "
                    f"the hand's place is not known; give {-mode.effective_mass:g} with motor = 1, "
                    "encoder = -1, and handle = 1 or -1, where the hand is."
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

    @property
    def start(self) -> tuple[float, float]:
        """Push and speed of simulated contacts; those of a finger where they are not given."""
        given, (push, speed) = self.contact or ContactTable(), FINGER[self.units]
        friction = self.device.static_friction or self.device.friction
        push = max(push, 2.0 * friction)  # it moves the device
        return (
            push if given.push is None else given.push,
            speed if given.speed is None else given.speed,
        )

    @classmethod
    def from_file(cls, path: str | PathLike[str]) -> "Scene":
        """Read a TOML file; OSError if it is unreadable, ValueError, with its name, if bad."""
        return cls.from_table(t.read_table(path, "scene"), str(path))

    @classmethod
    def from_table(cls, table: Mapping[str, Any], source: str = "") -> "Scene":
        """Check a table of tables; ValueError on the first key that is unknown, missing or bad."""
        try:
            if "loop" in table:
                raise ValueError(
                    "the scene has a table [loop], but this answer is for walls; limits, check, "
                    "tune, design and study answer for other loops."
                )
            t.check_keys("", table, [*TABLES, "walls"])
            given = {"device": {}, "controller": {}, **table}  # which must not be left out
            tables: dict[str, Any] = {
                name: kind.from_table(given[name], name)
                for name, kind in TABLES.items()
                if name in given
            }
            return cls(**tables, walls=walls_in(table.get("walls", {})))
        except ValueError as error:
            device = table.get("device")
            turns = isinstance(device, Mapping) and "inertia" in device
            words = (Units.ROTATION if turns else Units.LINE).translated(str(error))
            raise ValueError(f"{source}: {words}" if source else words) from None

    @property
    def at_longest_delay(self) -> "Scene":
        """The scene with its longest delay as one that is constant, no sample lost."""
        controller, name = self.controller, "delay" if self.controller.delay else "delay_samples"
        if controller.has_one_delay:
            return self
        longest = (getattr(controller, name) or (0.0, 0.0))[1]
        constant: Any = {name: (longest, longest), "delay_is": None, "lost_samples": 0}
        return replace(self, controller=replace(controller, **constant))

    def require_walls(self) -> None:
        """Refuse a scene without a wall."""
        if not self.walls:
            raise ValueError("walls is empty; give at least one wall with stiffness and damping.")

    def unusual(self) -> list[str]:
        """Describe values that look like a slip of the unit, each once."""
        return list(dict.fromkeys(self._unusual()))

    def _unusual(self) -> Iterator[str]:
        controller, units = self.controller, self.units
        tables: dict[str, t.Table] = {
            "device": self.device, "hand": self.hand or HandTable(), "controller": controller,
        } | {f"walls.{name}": wall for name, wall in self.walls.items()}  # fmt: skip
        found = [own for name, table in tables.items() for own in table.quantities(name)]
        for name, value, unit, usual in (*found, ("the delay", controller.delays[1], "s", _DELAYS)):
            low, high = (units is Units.ROTATION and usual.turning) or usual[:2]
            size = abs(value) if "modal_" in name else value  # which may be negative
            own = "" if unit == "1" else f" {units.unit(unit.partition(',')[0])}"
            if not low <= size <= high:
                yield f"{name} is {value:g}{own}, usual are {low:g} to {high:g}{own}"
        words = f"the delay is {controller.samples:g} samples"
        if controller.samples >= 200.0:
            yield f"{words}; one in samples is given as delay_samples"
        if 0.0 < (controller.delay_samples or (0.0, 0.0))[1] < 0.01:
            yield f"{words}; one in s is given as delay"
        estimator = controller.velocity
        period = controller.sample_time
        meant = values_in(estimator.of_preset, ["sample_time"]) if estimator else {}
        if estimator and meant.get("sample_time", period) != period:
            own = f"a sample_time of {meant['sample_time']:g} s"
            yield f"the preset {estimator.preset!r} is meant for {own}"
        elif estimator and estimator.numerator and estimator.denominator:
            powers = enumerate(reversed(estimator.numerator))
            rate = period * sum(power * number for power, number in powers)
            rate /= sum(estimator.denominator)
            if not 0.5 <= rate <= 2.0:
                yield (
                    f"controller.velocity has {rate:.3g} of a velocity that is constant; are its "
                    "coefficients for another unit or sample_time?"
                )
        is_heavy = units is Units.LINE and self.device.effective_mass[0] > 0.01  # kg
        for name, wall in self.walls.items():
            if wall.damping > wall.stiffness > 0.0:
                yield (
                    f"walls.{name} has a damping of {wall.damping:g} {units.damping} beside a "
                    f"stiffness of {wall.stiffness:g} {units.stiffness}; are they swapped?"
                )
            elif is_heavy and 0.0 < wall.stiffness < 5.0:
                yield f"walls.{name}.stiffness is {wall.stiffness:g} N/m; is it in N/mm?"


TABLES: Mapping[str, type[t.Table]] = {
    "device": DeviceTable,
    "controller": ControllerTable,
    "hand": HandTable,
    "wanted": Wanted,
    "contact": ContactTable,
}


INNER: Mapping[str, type[t.Table]] = {
    "encoder": Encoder,
    "modes": VibrationMode,
    "actuator": Actuator,
    "grip": Grip,
    "velocity": VelocityTable,
    "position": PositionTable,
}
"""The tables in those of a scene, by their keys."""


def walls_in(table: Any) -> dict[str, WallTable]:
    """The walls of a table by name; ValueError."""
    if not isinstance(table, Mapping):
        raise ValueError(f"walls is {shortened(table)}; give a table [walls.NAME] for each wall.")
    if len(table) > 1000:
        raise ValueError(f"walls has {len(table)} entries; give 1000 at most.")
    for name, wall in table.items():
        t.checked_label(name)
        if not isinstance(wall, Mapping):
            raise ValueError(
                f"walls.{name} is {shortened(wall)}; give a table [walls.NAME] for each wall."
            )
    return {name: WallTable.from_table(wall, f"walls.{name}") for name, wall in table.items()}
