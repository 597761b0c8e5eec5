"""How the variables of the schema are written to HDF5. No JAX."""

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format import schema
from jaxstab.atlas.format.schema import Variable

FORMAT_VERSIONS: Final = ("v110", "v110")
"""Of HDF5: checksums of its own structures, and the other readers know it."""

FILTERS: Final = {
    "shuffle": True,
    "compression": "gzip",
    "compression_opts": 6,
    "fletcher32": True,
    "track_times": False,
}

_LARGEST_CHUNK = 2**17  # values of an array that is not laid out in tiles


def write_head(file: h5py.File, created_by: str) -> None:
    """Write what the file says of itself."""
    _write_attributes(file, head_attributes(created_by))


def head_attributes(created_by: str) -> dict[str, Any]:
    """Return what a file says of itself, but for the digest of its values."""
    return {
        "format": schema.FORMAT,
        "title": "Stability of a haptic rendering loop over its dimensionless parameters",
        "created_by": created_by,
        "source": "characteristic polynomial of Hulin, Preusche, Hirzinger (2008), eq. (9)",
        "symbols": "K, B stiffness and damping of the virtual wall; m, b, k mass, damping and "
        "stiffness of device and hand; T sampling period, t_d delay",
        "Conventions": "CF-1.8",
        "schema_version": np.int32(schema.SCHEMA_VERSION),
    }


def write_content_digest(file: h5py.File, digest: str) -> None:
    """Write the digest of all values, for those who compare files of two machines."""
    _write_attributes(file, {"content_sha256": digest})


def write_variable(file: h5py.File, variable: Variable, values: NDArray[Any]) -> h5py.Dataset:
    """Write a whole variable; its axes are there already."""
    count, *others = values.shape
    rows = max(1, min(count, _LARGEST_CHUNK // prod(others)))
    dataset = create_variable(file, variable, values.shape, (rows, *others), values.dtype)
    dataset[...] = values
    return dataset


def create_variable(
    file: h5py.File,
    variable: Variable,
    shape: Sequence[int],
    chunk: Sequence[int],
    dtype: np.dtype[Any],
) -> h5py.Dataset:
    """Create a dataset that says what it means, without values; its axes are there already.

    Args:
        file: to write to.
        variable: what it holds.
        shape: of all of it.
        chunk: shape of what is compressed together.
        dtype: of its values.
    """
    dataset = file.create_dataset(
        variable.name, tuple(shape), dtype.newbyteorder("<"), chunks=tuple(chunk), **FILTERS
    )
    _write_attributes(dataset, attributes_of(variable))
    if variable.is_axis:
        dataset.make_scale(variable.name)
    else:
        for number, dimension in enumerate(variable.dimensions):
            dataset.dims[number].attach_scale(file[dimension])
    return dataset


def attributes_of(variable: Variable) -> dict[str, Any]:
    """Return what a dataset says of itself."""
    attributes: dict[str, Any] = {
        "long_name": variable.long_name,
        "interpretation": variable.interpretation,
    }
    if variable.dtype.startswith("float"):
        attributes["units"] = "1"
    if len(variable.dimensions) == len(schema.NODE) and "alpha_node" in variable.dimensions:
        attributes["coordinates"] = "alpha beta"
    if variable.holds_verdicts:
        attributes["flag_values"] = np.array(schema.FLAG_VALUES, np.int8)
        attributes["flag_meanings"] = schema.FLAG_MEANINGS
    return attributes


def _write_attributes(to: h5py.File | h5py.Dataset, attributes: Mapping[str, Any]) -> None:
    for name, value in attributes.items():
        to.attrs[name] = np.bytes_(value.encode("utf-8")) if isinstance(value, str) else value
