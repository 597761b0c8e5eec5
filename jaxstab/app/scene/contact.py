"""Simulated contacts with the walls of a scene: the worst of some starts. Nothing is proved.

Each wall is simulated from rest under the scene's push, and at its speed with and without the push,
and from four phases of the encoder if there is one. The hand and the device's mass are at the
lowest ends of their ranges, the delay is constant and the longest one. The answer is that of the
worst start, which it names.

A table of contacts has a dimension for each list of numbers; ``jaxstab.tables`` computes
``jaxstab.contact`` over their grid, block by block.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import inf, isnan
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float64

from jaxstab import lab
from jaxstab.answers import GainAnswer, Phrase, Quantity, Units, first_way
from jaxstab.app.scene.answers import basis_of
from jaxstab.app.scene.loops import Floats, hands_of, loop_of, walls_of
from jaxstab.app.scene.scene import Scene
from jaxstab.loop import HapticLoop

if TYPE_CHECKING:
    from xarray import Dataset


_RESTS = "{contact} after {time_to_rest}, penetration {penetration} (simulated, {start})"


_MOVES = "{contact}[, amplitude {amplitude!} at {contact_frequency}] (simulated, {start})"


class WorstContact(GainAnswer, Phrase):
    """The end of the worst of the simulated contacts."""

    def in_words(self, units: Units) -> str:
        """Its end, and the start, the delay and the hand that it is from."""
        way = _RESTS if self.contact == lab.contact.ContactKind.RESTS else _MOVES
        return first_way([way], self._said(units)) or ""

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """The lines, without the size of a motion that nothing holds."""
        is_through = self.contact == lab.contact.ContactKind.PUSHED_THROUGH
        own = dict.fromkeys(("amplitude", "penetration"), inf) if is_through else {}
        return GainAnswer(self.values | own).lines(indent, units)


def simulate_contacts(scene: Scene) -> GainAnswer:
    """The worst simulated contact with each wall of a scene that says how the device meets it."""
    scene.require_walls()
    walls = contacts_of(scene)
    rest = all(wall.contact == lab.contact.ContactKind.RESTS for wall in walls.values())
    values = {"inputs": basis_of(scene, at_longest=True), "friction": scene.device.friction}
    return GainAnswer(values | {"walls": walls}, is_stable=rest)


def contacts_of(scene: Scene) -> dict[str, WorstContact]:
    """Return the worst simulated contact of each wall."""
    push, speed = scene.start
    pairs = dict.fromkeys([(push, 0.0), (0.0, speed), (push, speed)])
    phases = (0.0, 0.25, 0.5, 0.75) if scene.device.encoder else (0.0,)
    starts = [(*pair, phase) for pair in pairs if any(pair) for phase in phases]
    gains = np.array([*walls_of(scene).values()]).T[:, :, None]
    given = dict(zip(("push", "speed", "phase"), np.array(starts).T, strict=True))
    contact = simulated_map(scene, *gains, **given)
    worst_last = (
        lab.contact.ContactKind.UNTOUCHED,
        lab.contact.ContactKind.OUTSIDE,
        lab.contact.ContactKind.RESTS,
        lab.contact.ContactKind.DECAYS,
        lab.contact.ContactKind.OSCILLATES,
        lab.contact.ContactKind.BOUNCES,
        lab.contact.ContactKind.GROWS,
        lab.contact.ContactKind.PUSHED_THROUGH,
    )
    ranks = np.argsort(worst_last)
    # Thrown out against a push: further than what returns.
    is_thrown = (contact.kind == lab.contact.ContactKind.OUTSIDE) & (given["push"] > 0.0)
    rank = np.where(is_thrown, ranks[lab.contact.ContactKind.BOUNCES - 1], ranks[contact.kind - 1])
    order = (contact.time_to_rest, contact.amplitude, rank)
    worst = np.lexsort(np.nan_to_num(order, posinf=np.finfo(float).max), axis=-1)[:, -1]
    return {
        name: _simulated(
            scene,
            lab.contact.Contact(*(values[k, start] for values in contact[:-1])),
            starts[start],
        )
        for k, (name, start) in enumerate(zip(scene.walls, worst, strict=True))
    }


def contacts_or_reasons(scene: Scene) -> Mapping[str, WorstContact | str]:
    """Return ``contacts_of``, if there is any; where one cannot be simulated, the reason."""
    if scene.contact is None:
        return {}
    try:
        return contacts_of(scene)
    except ValueError as error:
        if len(scene.walls) == 1:
            return dict.fromkeys(scene.walls, f"not simulated: {error}")
    alone = (replace(scene, walls={name: wall}) for name, wall in scene.walls.items())
    return {
        name: answer for single in alone for name, answer in contacts_or_reasons(single).items()
    }


def simulated_map(
    scene: Scene, stiffness: Any, damping: Any, **start: Any
) -> "lab.contact.Contact":
    """Return the contacts of walls with the device of a scene; by default at its own start."""
    given = _conditions(scene) | start
    return lab.contact.contact(
        loop_of(scene.at_longest_delay), stiffness, damping, path=False, **given
    )


def map_contacts(
    scene: Scene, count: int, friction: Sequence[float | str] | None = None
) -> "Dataset":
    """Return a map of walls around the stable ones, from the scene's own start, not yet computed.

    ``friction``, in the unit of the scene's force, is a dimension of the table if it is given.
    """
    conditions, loop = _conditions(scene), loop_of(scene.at_longest_delay)
    walls = walls_around(loop, count, walls_of(scene).values())
    given = {"stiffness": walls[0], "damping": walls[1][:, 0], **conditions}
    if friction is not None:
        if given["static_friction"] is not None:
            raise ValueError(
                "device.static_friction is given beside a range of friction; leave it out: it is "
                "then equal to friction."
            )
        given["friction"] = friction
    return lab.contact.plan_contacts(loop, given, scene.units)


def _conditions(scene: Scene) -> dict[str, Any]:
    """The contacts of a scene, as arguments of ``jaxstab.contact``; ValueError if it has none."""
    if scene.contact is None:
        raise ValueError(
            f"contact is missing; give contact.push in {scene.units.force}, or contact.speed in "
            f"{scene.units.speed} (on the command line --push or --speed)."
        )
    device, controller, given = scene.device, scene.controller, scene.contact
    push, speed = scene.start
    return {
        "friction": device.friction,
        "static_friction": device.static_friction,
        "encoder": device.encoder.resolution if device.encoder else 0.0,
        "force_step": controller.force_step,
        "max_force": controller.max_force,
        "one_sided": given.one_sided,
        "gate": given.gate,
        "duration": given.duration,
        "push": push,
        "speed": speed,
    }


def walls_around(
    loop: HapticLoop, count: int, others: Iterable[tuple[float, float]] = ()
) -> tuple[Floats, Float64[np.ndarray, "_ 1"]]:
    """Return a grid of walls beyond the stable ones and others, (count,) and (count, 1)."""
    limits = loop.limits()
    gains = np.array([(limits.stiffness, limits.damping), *others])
    wider = 1.6  # times the largest gains
    stiffness, damping = wider * np.nanmax(gains, axis=0)
    return np.linspace(0.0, stiffness, count + 1)[1:], np.linspace(0.0, damping, count)[:, None]


def _simulated(
    scene: Scene, contact: "lab.contact.Contact", start: tuple[float, float, float]
) -> WorstContact:
    push, speed, phase = start
    words = [f"at {speed:g} {scene.units.speed}"] if speed else []
    words += [f"pushed with {Quantity('N').words(push, scene.units)}"] if push else []
    if scene.device.encoder:
        words.append(f"encoder at {phase:g} of a step")
    assert scene.contact is not None  # else nothing is simulated
    about = list[str]()
    if not scene.controller.has_one_delay:
        about.append("the longest delay, held constant")
    if hands_of(scene) is not None:
        about.append("hand and device at their lowest values")
    frequency = float(contact.frequency)
    return WorstContact(
        {
            "contact": lab.contact.ContactKind(int(contact.kind)),
            "time_to_rest": float(contact.time_to_rest),
            "amplitude": float(contact.amplitude),
            "contact_frequency": None if isnan(frequency) else frequency,
            "penetration": float(contact.penetration),
            "largest_force": float(contact.largest_force),
            "worst_start": ", ".join(words),
            "contact_is": "; ".join([f"{scene.contact.duration:g} s, not proved", *about]),
        },
        remarks={"start": "; ".join([", ".join(words), *about])},
    )
