"""Scenes of a device that was measured: ``[device] response = "sweep.csv"``.

The response is a CSV file beside the scene, as ``Device.from_response`` reads it; a hand that held
the device is in it. ``limits`` and ``check`` answer, from measured data and not proved.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from jaxstab import tables as t
from jaxstab.conventions import MEASURED, Verdict
from jaxstab.exact import StableLine
from jaxstab.loop import HapticLoop
from jaxstab.model import Device
from jaxstab.scene.answers import GivenQuantity, IntervalQuantity, Quantity
from jaxstab.scene.check import frequency_answer
from jaxstab.scene.gains import GainAnswer, GainScene, any_scene
from jaxstab.scene.limits import numbered
from jaxstab.scene.scene import Controller, Scene, Units, Wall, walls_in

_FORMATS: dict[str, Quantity] = {
    "largest_stiffness": Quantity("N/m", 4, "ROUND_FLOOR"),
    "largest_damping": Quantity("N s/m", 4, "ROUND_FLOOR"),
    "at_stiffness": Quantity("N/m"),
    "at_damping": Quantity("N s/m"),
    "stiffness": GivenQuantity("N/m"),
    "damping": GivenQuantity("N s/m"),
    "stiffness_limits": IntervalQuantity("N/m", 4),
    "other_stiffnesses": IntervalQuantity("N/m", 4),
    "damping_limits": IntervalQuantity("N s/m", 4),
    "other_dampings": IntervalQuantity("N s/m", 4),
}


def _named(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError("give the name of a CSV file")
    return value


@dataclass(frozen=True, kw_only=True)
class MeasuredDevice(t.Table):
    """A device by the file of its response, its relative error, and whether it turns."""

    response: str = t.key(_named)
    error: float | None = t.key(t.tolerance, None)
    turns: bool = t.key(t.truth, False)


class MeasuredAnswer(GainAnswer):
    """The answer from a measured response, which is short as it is."""

    def in_short(self) -> str:
        """The whole answer."""
        return str(self)


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
            device=Device.from_response(device.response, error=device.error),
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
        values: dict[str, Any] = {
            "inputs": GainAnswer(
                {
                    "device": str(loop.device),
                    "velocity": str(loop.velocity or "the difference over one sample (assumed)"),
                    "position": None if loop.position is None else str(loop.position),
                    "delay": f"{loop.delay_samples:g} samples beside what was measured",
                    "certainty": MEASURED,
                }
            )
        }
        if command == "limits":
            found = loop.limits()
            stiffest = {"largest_stiffness": found.stiffness, "at_damping": found.at_damping}
            damped = {"largest_damping": found.damping, "at_stiffness": found.at_stiffness}
            values |= {"stiffest": self._shown(stiffest), "most_damped": self._shown(damped)}
        walls = {
            name: self._wall(wall, in_full=command == "check") for name, wall in self.walls.items()
        }
        return MeasuredAnswer(values | {"walls": walls})

    def _wall(self, wall: Wall, *, in_full: bool) -> GainAnswer:
        gains = wall.stiffness, wall.damping
        verdict = Verdict(int(self.loop.verdict(*gains)))
        rows = self.loop.stiffness_intervals(gains[1]), self.loop.damping_intervals(gains[0])
        (stiff, *stiffs), (damp, *damps) = map(_around, rows, gains)
        values: dict[str, Any] = {
            "stiffness": wall.stiffness,
            "damping": wall.damping,
            "verdict": verdict,
            "stiffness_limits": stiff,
            "other_stiffnesses": numbered(stiffs),
            "damping_limits": damp,
            "other_dampings": numbered(damps),
        }
        if in_full:
            margins = self.loop.frequency_margins(*gains)
            values["frequency"] = frequency_answer(margins, in_full=self.asks_frequency)
        return replace(self._shown(values), is_stable=verdict == Verdict.STABLE)

    def _shown(self, values: dict[str, Any]) -> GainAnswer:
        formats = {
            name: replace(own, unit=self.units.unit(own.unit)) for name, own in _FORMATS.items()
        }
        known = {
            name: None if isinstance(value, float) and not isfinite(value) else value
            for name, value in values.items()
        }
        return GainAnswer(known, formats)


def _around(line: StableLine, gain: float) -> list[Any]:
    """The stable intervals of a row, the one that holds a gain first, else that of small gains."""
    found: list[Any] = [(low.value, high.value) for low, high in line.intervals]
    return sorted(found, key=lambda ends: not ends[0] <= gain <= ends[1]) or [None]


def scene_to_answer(
    tables: Mapping[str, Any], source: str = ""
) -> Scene | GainScene | MeasuredScene:
    """The scene of a measured device, or any other; ValueError with its source."""
    device = tables.get("device")
    if not isinstance(device, Mapping) or "response" not in device:
        return any_scene(tables, source)
    try:
        return MeasuredScene.from_table(tables)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{source}: {error}" if source else str(error)) from None
