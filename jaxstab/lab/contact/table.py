"""Contacts as a labelled table: a dimension for each list of numbers, computed block by block."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

import jaxstab
from jaxstab.answers import Units
from jaxstab.arrays import Numbers
from jaxstab.lab.contact.runs import ContactKind, contact, setup_of
from jaxstab.model import LoopParameters
from jaxstab.numbers import checked, require_kind
from jaxstab.shown import shortened
from jaxstab.tables import Variable, computed, table_of, xarray_module

if TYPE_CHECKING:
    from xarray import Dataset


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
