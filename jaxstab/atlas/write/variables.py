"""How the variables of the schema are written to HDF5. No JAX."""

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format.schema import Variable
from jaxstab.atlas.format.table import Place
from jaxstab.atlas.format.words import attributes_of, head_attributes

FORMAT_VERSIONS: Final = ("v110", "v110")
"""Of HDF5: checksums of its own structures, and the other readers know it."""

_PACKED: Final = {"shuffle": True, "compression": "gzip", "compression_opts": 6}

_LARGEST_CHUNK = 2**17  # values of an array that is not laid out in tiles


def write_head(file: h5py.File, created_by: str, filters: str) -> None:
    """Write what the file says of itself."""
    _write_attributes(file, head_attributes(created_by, filters))


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


def filters_of(variable: Variable) -> dict[str, Any]:
    """Return how the chunks of a variable are stored."""
    return {"fletcher32": True, "track_times": False} | (_PACKED if variable.is_packed else {})


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
        variable.name,
        tuple(shape),
        dtype.newbyteorder("<"),
        chunks=tuple(chunk),
        **filters_of(variable),
    )
    _write_attributes(dataset, attributes_of(variable))
    if variable.is_axis:
        dataset.make_scale(variable.name)
    else:
        for number, dimension in enumerate(variable.dimensions):
            dataset.dims[number].attach_scale(file[dimension])
    return dataset


def _write_attributes(to: h5py.File | h5py.Dataset, attributes: Mapping[str, Any]) -> None:
    for name, value in attributes.items():
        to.attrs[name] = np.bytes_(value.encode("utf-8")) if isinstance(value, str) else value


def places_of(dataset: h5py.Dataset) -> list[Place]:
    """Return the offsets of the chunks of a dataset in a flushed file, in order."""
    found: dict[tuple[int, ...], Place] = {}

    def note(chunk: Any) -> None:
        if chunk.filter_mask:
            raise RuntimeError(f"HDF5 left out a filter of {dataset.name}; use another libhdf5.")
        found[chunk.chunk_offset] = chunk.byte_offset, chunk.size

    dataset.id.chunk_iter(note)
    return [place for _, place in sorted(found.items())]
