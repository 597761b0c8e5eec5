"""Simulated contacts with the walls of a scene: the worst of some starts. Nothing is proved.

Each wall is simulated from rest under the scene's push, and at its speed with and without the push,
and from four phases of the encoder if there is one. The hand and the device's mass are at the
lowest ends of their ranges, the delay is constant and the longest one. The answer is that of the
worst start, which it names.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import isnan
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from jaxtyping import Float64

from jaxstab.loop import Contact, ContactKind, HapticLoop, contact_map
from jaxstab.scene.answers import Answer, Basis, Frequency, Quantity, basis_of
from jaxstab.scene.contact_table import plan_contacts
from jaxstab.scene.loops import hands_of, loop_of, walls_of, with_delay
from jaxstab.scene.scene import Scene

if TYPE_CHECKING:
    from xarray import Dataset


Floats = Float64[np.ndarray, " _"]


@dataclass(frozen=True)
class Simulated(Answer):
    """How the worst of the simulated contacts ends."""

    contact: ContactKind
    time_to_rest: Annotated[float, Quantity("s", 3, infinite="never")]
    amplitude: Annotated[float, Quantity("m", 3)]
    contact_frequency: Frequency | None
    penetration: Annotated[float, Quantity("m", 3)]
    largest_force: Annotated[float, Quantity("N", 3)]
    worst_start: str
    contact_is: str


@dataclass(frozen=True)
class NotSimulated(Answer):
    """Why the contact with a wall is not simulated: proofs do not need it."""

    contact: str


@dataclass(frozen=True)
class Contacts(Answer):
    """The simulated contact of each wall, by its name."""

    inputs: Basis | None
    friction: Annotated[float, Quantity("N")]
    walls: dict[str, Simulated]

    @property
    def all_stable(self) -> bool:
        """Whether every simulated contact came to rest; nothing is proved."""
        return all(wall.contact == ContactKind.RESTS for wall in self.walls.values())


def simulate_contacts(scene: Scene) -> Contacts:
    """The worst simulated contact with each wall of a scene that says how the device meets it."""
    scene.require_walls()
    _require_contact(scene)
    return Contacts(basis_of(scene), scene.device.friction, contacts_of(scene))


def _require_contact(scene: Scene) -> None:
    if scene.contact is None:
        raise ValueError(
            "contact is missing; give contact.push in N, or contact.speed in m/s (on the command "
            "line --push or --speed)."
        )


def contacts_of(scene: Scene) -> dict[str, Simulated]:
    """Return the worst simulated contact of each wall; none where none is simulated."""
    if scene.contact is None or not scene.walls:
        return {}
    starts = _starts(scene)
    gains = np.array([*walls_of(scene).values()]).T[:, :, None]
    push, speed, phase = np.array(starts).T
    contact = simulated_map(scene, *gains, push=push, speed=speed, phase=phase)
    worst_last = (
        ContactKind.UNTOUCHED,
        ContactKind.OUTSIDE,
        ContactKind.RESTS,
        ContactKind.DECAYS,
        ContactKind.OSCILLATES,
        ContactKind.BOUNCES,
        ContactKind.GROWS,
        ContactKind.PUSHED_THROUGH,
    )
    ranks = np.argsort(worst_last)
    is_thrown = (contact.kind == ContactKind.OUTSIDE) & (push > 0.0)  # further than what returns
    rank = np.where(is_thrown, ranks[ContactKind.BOUNCES - 1], ranks[contact.kind - 1])
    order = (contact.time_to_rest, contact.amplitude, rank)
    worst = np.lexsort(np.nan_to_num(order, posinf=np.finfo(float).max), axis=-1)[:, -1]
    return {
        name: _simulated(
            scene, Contact(*(values[k, start] for values in contact[:-1])), starts[start]
        )
        for k, (name, start) in enumerate(zip(scene.walls, worst, strict=True))
    }


def contacts_or_reasons(scene: Scene) -> Mapping[str, Simulated | NotSimulated]:
    """Return ``contacts_of``; for a wall whose contact cannot be simulated, the reason."""
    try:
        return contacts_of(scene)
    except ValueError as error:
        if len(scene.walls) == 1:
            return dict.fromkeys(scene.walls, NotSimulated(f"not simulated: {error}"))
    alone = (replace(scene, walls={name: wall}) for name, wall in scene.walls.items())
    return {
        name: answer for single in alone for name, answer in contacts_or_reasons(single).items()
    }


def simulated_map(scene: Scene, stiffness: Any, damping: Any, **start: Any) -> Contact:
    """Return the contacts of walls with the device of a scene; by default at its own start."""
    return contact_map(contact_loop(scene), stiffness, damping, **{**_conditions(scene), **start})


def map_contacts(scene: Scene, count: int, friction: list[float] | None = None) -> "Dataset":
    """Return a map of walls around the stable ones, from the scene's own start, not yet computed.

    ``friction``, in the unit of the scene's force, is a dimension of the table if it is given.
    """
    _require_contact(scene)
    loop = contact_loop(scene)
    walls = walls_around(loop, count, walls_of(scene).values())
    given = {"stiffness": walls[0], "damping": walls[1][:, 0], **_conditions(scene)}
    if friction is not None:
        if given["static_friction"] is not None:
            raise ValueError(
                "device.static_friction is given beside a range of friction; leave it out: it is "
                "then equal to friction."
            )
        given["friction"] = friction
    units = scene.units

    def in_units(unit: str) -> str:
        return f"{units.length}/s" if unit == "m/s" else units.unit(unit)

    return plan_contacts(loop, given, in_units)


def _conditions(scene: Scene) -> dict[str, Any]:
    """Return what a scene says of contacts, as arguments of ``contact_map``."""
    assert scene.contact is not None  # callers look
    device, controller, given = scene.device, scene.controller, scene.contact
    push, speed = scene.start
    return {
        "friction": device.friction,
        "static_friction": device.static_friction,
        "encoder": device.encoder.resolution if device.encoder else 0.0,
        "force_step": controller.force_step,
        "max_force": controller.max_force,
        "one_sided": given.one_sided,
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


def contact_loop(scene: Scene) -> HapticLoop:
    """Return the loop whose contacts are simulated: the lightest one with the longest delay."""
    return loop_of(with_delay(scene, scene.controller.delays[1]))


def _starts(scene: Scene) -> list[tuple[float, float, float]]:
    """Return pushes, speeds and phases of the encoder to try."""
    push, speed = scene.start
    pairs = dict.fromkeys([(push, 0.0), (0.0, speed), (push, speed)])
    phases = (0.0, 0.25, 0.5, 0.75) if scene.device.encoder else (0.0,)
    return [(*pair, phase) for pair in pairs if any(pair) for phase in phases]


def start_in_words(scene: Scene, push: float, speed: float) -> str:
    """Return at which speed a device meets a wall, and how it is pushed."""
    words = [f"at {speed:g} {scene.units.length}/s"] if speed else []
    words += [f"pushed with {Quantity('N').words(push, scene.units)}"] if push else []
    return ", ".join(words)


def _simulated(scene: Scene, contact: Contact, start: tuple[float, float, float]) -> Simulated:
    push, speed, phase = start
    words = [start_in_words(scene, push, speed)]
    if scene.device.encoder:
        words.append(f"encoder at {phase:g} of a step")
    assert scene.contact is not None  # callers look
    about = [f"simulated for {scene.contact.duration:g} s, not proved"]
    if not scene.controller.has_one_delay:
        about.append("the delay constant, its longest")
    if hands_of(scene) is not None:
        about.append("hand and device at their lowest values")
    frequency = float(contact.frequency)
    return Simulated(
        ContactKind(int(contact.kind)),
        float(contact.time_to_rest),
        float(contact.amplitude),
        None if isnan(frequency) else frequency,
        float(contact.penetration),
        float(contact.largest_force),
        ", ".join(words),
        "; ".join(about),
    )
