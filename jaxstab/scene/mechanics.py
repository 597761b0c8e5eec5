"""What moves in a scene: the device and the hand that holds it, as tables of a file."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jaxstab.scene.presets import device_presets
from jaxstab.scene.units import Units
from jaxstab.tables import Table, each, interval, key, nested, not_zero, one_of, quantity

LENGTH = "m, or in rad for a device that turns"
_NO_MASS = "mass is missing; give it a value."


@dataclass(frozen=True, kw_only=True)
class Encoder(Table):
    """What the position is rounded to: the resolution at the handle."""

    resolution: float = key(quantity(LENGTH, is_positive=True))


@dataclass(frozen=True, kw_only=True)
class VibrationMode(Table):
    """A vibration mode of the device: its displacement at the handle adds to the rigid body's."""

    frequency: float = key(quantity("Hz", is_positive=True))
    damping_ratio: float = key(quantity("1"))
    modal_mass: float | None = key(not_zero("kg"), None)
    modal_inertia: float | None = key(not_zero("kg m^2"), None)

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
class Actuator(Table):
    """The motor with its amplifier: the bandwidth at which the force is 3 dB too weak."""

    bandwidth: float = key(quantity("Hz", is_positive=True))


@dataclass(frozen=True, kw_only=True)
class Device(Table):
    """The haptic device: effective mass in kg and physical damping in N s/m, or a preset.

    A device that turns has a moment of inertia in kg m^2 in place of the mass, and its damping is
    in N m s/rad. Either may be a range, from the lowest to the highest one of all postures.
    Vibration modes and an actuator are of any device.
    """

    preset: str | None = key(lambda name: one_of(device_presets())(name), None)
    mass: tuple[float, float] | None = key(interval("kg", is_positive=True), None)
    inertia: tuple[float, float] | None = key(interval("kg m^2", is_positive=True), None)
    damping: float = key(quantity("N s/m"))
    encoder: Encoder | None = key(nested(Encoder), None)
    modes: tuple[VibrationMode, ...] = key(each(nested(VibrationMode)), ())
    actuator: Actuator | None = key(nested(Actuator), None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mass is not None and self.inertia is not None:
            raise ValueError(
                f"mass is {self.mass[0]:g} beside inertia; give mass for a device that moves along "
                "a line, or inertia for one that turns."
            )
        if self.mass is None and self.inertia is None:
            raise ValueError(_NO_MASS)
        for number, mode in enumerate(self.modes):
            if (mode.modal_inertia is None) != (self.inertia is None):
                own, other = ("mass", "inertia") if self.inertia is None else ("inertia", "mass")
                raise ValueError(
                    f"modes.{number}.modal_{other} is {mode.effective_mass:g} beside {own}; give "
                    f"modal_{own}."
                )

    @classmethod
    def filled_in(cls, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """Let a preset give what the table does not."""
        preset = device_presets().get(str(table.get("preset")))
        if preset is None:
            if not {"preset", "mass", "inertia"} & {*table}:
                raise ValueError(_NO_MASS)
            return table  # a preset that is not known is refused
        known = preset.values(("mass", "damping"))
        for name in ("mass", "damping"):
            if name not in known and name not in table:
                raise ValueError(
                    f"{name} is missing; no source has that of the preset {table['preset']!r}, so "
                    "give it a value."
                )
        return {**known, **table}

    @property
    def units(self) -> Units:
        """The units of whatever belongs to the device."""
        return Units.LINE if self.inertia is None else Units.ROTATION

    @property
    def effective_mass(self) -> tuple[float, float]:
        """The lowest and the highest mass in kg, or moment of inertia in kg m^2."""
        return self.mass or self.inertia or (0.0, 0.0)

    @property
    def varies(self) -> bool:
        """Whether the mass is a range."""
        return self.effective_mass[0] < self.effective_mass[1]


@dataclass(frozen=True, kw_only=True)
class Grip(Table):
    """What is between the device and the arm: a spring and a damper side by side."""

    stiffness: float = key(quantity("N/m"))
    damping: float = key(quantity("N s/m"), 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stiffness == self.damping == 0.0:
            raise ValueError("stiffness and damping are 0; give a grip that holds something.")


@dataclass(frozen=True, kw_only=True)
class Hand(Table):
    """The hand that holds the device; each quantity a range from lowest to highest.

    With a grip these are of the arm behind it; without one the hand is glued to the device.
    """

    mass: tuple[float, float] = key(interval("kg"), (0.0, 0.0))
    inertia: tuple[float, float] | None = key(interval("kg m^2"), None)
    stiffness: tuple[float, float] = key(interval("N/m"), (0.0, 0.0))
    damping: tuple[float, float] = key(interval("N s/m"), (0.0, 0.0))
    grip: Grip | None = key(nested(Grip), None)

    @property
    def effective_mass(self) -> tuple[float, float]:
        """The mass in kg, or the moment of inertia in kg m^2."""
        return self.inertia or self.mass

    @property
    def varies(self) -> bool:
        """Whether this is more than one hand."""
        return any(low < high for low, high in (self.effective_mass, self.stiffness, self.damping))
