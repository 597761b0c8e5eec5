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
from functools import partial
from math import inf, isnan
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float64

import jaxstab
from jaxstab.arrays import Numbers
from jaxstab.loop import Contact, ContactKind, HapticLoop
from jaxstab.loop.contact import contact, setup_of
from jaxstab.model import LoopParameters
from jaxstab.numbers import checked, require_kind
from jaxstab.scene.answers import GainAnswer, Phrase, Quantity, basis_of, first_way
from jaxstab.scene.loops import Floats, hands_of, loop_of, walls_of
from jaxstab.scene.scene import Scene, Units
from jaxstab.shown import shortened
from jaxstab.tables import Variable, computed, table_of, xarray_module

if TYPE_CHECKING:
    from xarray import Dataset


_RESTS = "{contact} after {time_to_rest}, penetration {penetration} (simulated, {start})"
_MOVES = "{contact}[, amplitude {amplitude!} at {contact_frequency}] (simulated, {start})"


class WorstContact(GainAnswer, Phrase):
    """The end of the worst of the simulated contacts."""

    def in_words(self, units: Units) -> str:
        """Its end, and the start, the delay and the hand that it is from."""
        way = _RESTS if self.contact == ContactKind.RESTS else _MOVES
        return first_way([way], self._said(units)) or ""

    def lines(self, indent: str = "", units: Units = Units.LINE) -> list[str]:
        """The lines, without the size of a motion that nothing holds."""
        is_through = self.contact == ContactKind.PUSHED_THROUGH
        own = dict.fromkeys(("amplitude", "penetration"), inf) if is_through else {}
        return GainAnswer(self.values | own).lines(indent, units)


def simulate_contacts(scene: Scene) -> GainAnswer:
    """The worst simulated contact with each wall of a scene that says how the device meets it."""
    scene.require_walls()
    walls = contacts_of(scene)
    rest = all(wall.contact == ContactKind.RESTS for wall in walls.values())
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
    # Thrown out against a push: further than what returns.
    is_thrown = (contact.kind == ContactKind.OUTSIDE) & (given["push"] > 0.0)
    rank = np.where(is_thrown, ranks[ContactKind.BOUNCES - 1], ranks[contact.kind - 1])
    order = (contact.time_to_rest, contact.amplitude, rank)
    worst = np.lexsort(np.nan_to_num(order, posinf=np.finfo(float).max), axis=-1)[:, -1]
    return {
        name: _simulated(
            scene, Contact(*(values[k, start] for values in contact[:-1])), starts[start]
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


def simulated_map(scene: Scene, stiffness: Any, damping: Any, **start: Any) -> Contact:
    """Return the contacts of walls with the device of a scene; by default at its own start."""
    given = _conditions(scene) | start
    return contact(loop_of(scene.at_longest_delay), stiffness, damping, path=False, **given)


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
    return plan_contacts(loop, given, scene.units)


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


def _simulated(scene: Scene, contact: Contact, start: tuple[float, float, float]) -> WorstContact:
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
            "contact": ContactKind(int(contact.kind)),
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


# Contacts as a labelled table.

_BLOCK, _LEAST = 2**26, 1024  # samples of a block; contacts at least

_VARIABLES = {
    "kind": Variable("how the simulated contact ends", "1", ContactKind),
    "amplitude": Variable("half of the peak-to-peak position at the end", "m"),
    "frequency": Variable("frequency of the position at the end", "Hz"),
    "time_to_rest": Variable("from when on it rests", "s"),
    "penetration": Variable("largest position", "m"),
    "largest_force": Variable("largest modulus of the wall's force", "N"),
    "energy": Variable("energy that the wall gave to device and hand", "J"),
}
_AXES = {  # arguments that may be lists
    "stiffness": Variable("stiffness of the virtual wall", "N/m"),
    "damping": Variable("damping of the virtual wall", "N s/m"),
    "friction": Variable("Coulomb friction", "N"),
    "static_friction": Variable("static friction", "N"),
    "encoder": Variable("resolution of the encoder", "m"),
    "phase": Variable("phase of the encoder, in steps", "1"),
    "force_step": Variable("resolution of the force", "N"),
    "max_force": Variable("largest force", "N"),
    "push": Variable("push of the hand", "N"),
    "speed": Variable("speed at the start", "m/s"),
    "position": Variable("position at the start", "m"),
    "tolerance": Variable("of rest", "m"),
}


def contact_table(
    loop: LoopParameters, stiffness: Numbers, damping: Numbers, **options: Any
) -> "Dataset":
    """Simulate contacts as one labelled table, in blocks that dask computes.

    Its workers are those of ``jaxstab.study``. Nothing in the table is proved.

    Args:
        loop: any device with a mass at its handle.
        stiffness, damping: see ``jaxstab.conventions``.
        **options: those of ``jaxstab.contact``. Gains and options may be lists of numbers, each
            of which is a dimension of its name.

    Returns:
        ``xarray.Dataset`` over a dimension for each list, in their order, with the fields of
        ``Contact``; names, units and the meaning of codes are attributes.

    Raises: as ``jaxstab.contact``; ValueError for arrays of several dimensions, or no list;
    RuntimeError if xarray, dask or h5netcdf is missing, or a worker died.

    Source: eqs. (1)-(5) of Hulin, Preusche, Hirzinger (2008); Coulomb friction between the samples.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> table = jaxstab.contact_table(
        ...     loop, [1000.0, 2000.0], 5.0, friction=[0.0, 0.1, 0.3], push=1.0, duration=1.0
        ... )
        >>> table.penetration.dims, table.penetration.units
        (('stiffness', 'friction'), 'm')
    """
    return computed(plan_contacts(loop, {"stiffness": stiffness, "damping": damping, **options}))


def plan_contacts(
    loop: LoopParameters, given: Mapping[str, Any], units: Units = Units.LINE
) -> "Dataset":
    """Return the table of contacts, to be computed by dask; ``given`` as ``contact`` has it."""
    require_kind("loop", loop, LoopParameters, "HapticLoop")
    xarray, loop = xarray_module(), loop.in_floats()
    lists = {
        name: checked(name, value)
        for name, value in given.items()
        if name in _AXES and (isinstance(value, Sequence) or np.ndim(value))
    }
    if not lists:
        raise ValueError("no argument is a list, so there is nothing to map; use jaxstab.contact.")
    for name, values in lists.items():
        if values.ndim > 1 or not values.size:
            raise ValueError(
                f"{name} has the shape {values.shape}; give a number or a list of numbers."
            )
    fixed = {name: value for name, value in given.items() if name not in lists}
    corner = {name: values[0] for name, values in lists.items()}
    samples = setup_of(loop, **fixed, **corner).samples  # refuses what no block can compute
    table = table_of(
        partial(_fields, loop, fixed, tuple(lists)),
        {name: xarray.DataArray(values, dims=name) for name, values in lists.items()},
        {name: own._replace(units=units.unit(own.units)) for name, own in _VARIABLES.items()},
        max(_LEAST, _BLOCK // samples),
        {},
    )
    return table.assign_coords(
        {
            name: (name, values, own._replace(units=units.unit(own.units)).attributes)
            for name, values, own in ((x, values, _AXES[x]) for x, values in lists.items())
        }
    ).assign_attrs(
        title="Simulated contacts with virtual walls; nothing is proved",
        source=f"jaxstab {jaxstab.__version__}, contact_table",
        loop=repr(loop),
        conditions=", ".join(f"{name}={shortened(value)}" for name, value in fixed.items()),
    )


def _fields(
    loop: LoopParameters, fixed: Mapping[str, Any], names: tuple[str, ...], *columns: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return the fields of the contacts in a block of a table."""
    given: Any = dict(zip(names, columns, strict=True))
    ends = contact(loop, **fixed, **given, path=False)
    shape = np.broadcast_shapes(*map(np.shape, columns))
    return tuple(np.reshape(getattr(ends, name), shape) for name in _VARIABLES)
