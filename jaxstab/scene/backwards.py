"""Requirements of a scene's walls: the values of one quantity with which they are stable.

``design --for`` asks for any quantity, ``limits --gains`` without an inertia for that. What is
asked for may be missing in the scene, and a damping that is missing counts as 0: the answer says
so. Of a range of delays it is the longest one, as a constant delay, and the answer says so, too.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import nan
from typing import Any

from jaxstab.loop import Gains, StableValues
from jaxstab.loop.backwards import range_of
from jaxstab.scene.answers import Basis, GainAnswer, basis_of, formats_of
from jaxstab.scene.limits import numbered
from jaxstab.scene.loops import loop_of, masses_of, range_of_hands, walls_of
from jaxstab.scene.scene import Scene, Units, presets

QUANTITIES: Mapping[str, str] = {
    "inertia": "device_mass",
    "mass": "device_mass",
    "damping": "device_damping",
    "delay": "delay",
    "sample-time": "sample_time",
    "cutoff": "cutoff",
    "window": "window",
}
"""What may be asked for, as commands call it."""

_NO_WALL = (
    "the scene has a table [loop], but --for, and --gains without a mass, are for walls of a held "
    "device; jaxstab study SCENE --over KEY=VALUES asks for other loops, such as "
    "loop.inertia=0.05,0.2."
)


def known_of(table: Mapping[str, Any]) -> set[str]:
    """The keys of the device of a table, with those that its preset has."""
    device = table.get("device", {})
    own = device if isinstance(device, Mapping) else {}
    preset = presets("devices").get(str(own.get("preset")))
    return {*own, *(preset.numbers if preset else ())}


@dataclass(frozen=True)
class Backwards:
    """A scene, and the quantity that is asked for."""

    scene: Scene
    asked: str

    @classmethod
    def from_table(cls, table: Mapping[str, Any], source: str, asked: str) -> "Backwards":
        """Check a scene in which what is asked for may be missing; ValueError: ``Scene``."""
        if "loop" in table:
            raise ValueError(f"{source}: {_NO_WALL}" if source else _NO_WALL)
        known, device = known_of(table), table.get("device", {})
        is_missing = QUANTITIES[asked] == "device_mass" and not {"mass", "inertia"} & known
        if is_missing and isinstance(device, Mapping):  # others are refused
            device = {**device, asked: 1.0}  # any
        scene = Scene.from_table({**table, "device": device}, source)
        scene.require_walls()
        return cls(scene, asked)

    def unusual(self) -> list[str]:
        """Describe values that look like a slip of the unit."""
        return self.scene.unusual()

    def answer(self, command: str) -> GainAnswer:
        """The values that each wall needs."""
        scene, quantity = self.scene.at_longest_delay, QUANTITIES[self.asked]
        held = "each value that is tried" if self.asked == "delay" else "the longest"
        inputs = basis_of(self.scene, at_longest=True, constant=held)
        options: Any = {
            "in_samples": scene.controller.delay_samples is not None,
            "mass": masses_of(scene),
        }
        if quantity == "device_mass":
            inputs, options["mass"] = Basis(inputs.values | {"mass": (nan, nan)}), None
        if options["mass"] or (scene.hand and scene.hand.varies):
            options["hands"] = range_of_hands(scene)
        found = {
            name: (wall, range_of(loop_of(scene), quantity, wall, **options))
            for name, wall in walls_of(scene).items()
        }
        has_one_delay = self.scene.controller.has_one_delay
        every = " for every hand" if "hands" in options else ""
        every += "" if has_one_delay else " at a constant delay"
        walls = {
            name: _needs(wall, values, scene.units, every) for name, (wall, values) in found.items()
        }
        if self.asked == "damping":
            inputs = Basis(inputs.values | {"damping_is": None})
        # ``limits`` answers for all delays, ``design`` for the one that its answer names.
        is_for_all = command == "design" or has_one_delay
        values = {"inputs": inputs, "walls": walls}
        return GainAnswer(values, is_stable=is_for_all)


def _needs(wall: Gains, found: StableValues, units: Units, every: str) -> GainAnswer:
    """The values that one wall needs: the interval that is widest by its ratio, and others.

    ``every``: beyond what one loop needs, what its ends are proved for.
    """
    name = units.moved if found.quantity == "device_mass" else found.quantity
    least, largest, others = f"least_{name}", f"largest_{name}", f"other_{name}"
    values: dict[str, Any] = {"stiffness": wall.stiffness, "damping": wall.damping}
    if found.intervals:
        inner = [(low.stable, high.stable) for low, high in found.intervals]
        inner.sort(key=lambda ends: ends[0] / ends[1] if ends[1] else 0.0)
        (low, high), *more = inner
        values[least] = low if low > found.between[0] else None
        values[largest] = high if high < found.between[1] else None
        values[others] = numbered(more)
        is_all = len(inner) == 1 and inner[0] == found.between
        values["status"] = "every value tried is stable" if is_all else None
        words = f"{'each end is' if found.is_proved else 'not'} proved{every}"
        values["certainty"] = words if every else None
    else:
        values["status"] = "no value tried is stable"
    values["scan"] = found._replace(unit=units.unit(found.unit)).scan
    formats = formats_of({name: found.unit})
    formats = {key: replace(form, digits=10) for key, form in formats.items() if key != name}
    return GainAnswer(values, formats, bool(found.intervals) and found.is_proved)
