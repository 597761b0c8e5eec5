"""How the variables of the schema are written to HDF5. No JAX."""

import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from jaxstab.atlas.product import Variable
from jaxstab.atlas.schema import DAMAGED, RefusalError, Span, Stored, Table, attributes_of, check
from jaxstab.datasets import write_attributes

_LEVEL = 6  # of compression
_PACKED: Final = {"shuffle": True, "compression": "gzip", "compression_opts": _LEVEL}
_LARGEST_CHUNK = 2**17  # values of an array that is not laid out in tiles


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


def packed(values: NDArray[Any]) -> bytes:
    """Return a chunk as these filters would store it, but numbers are deflated by ISA-L.

    That takes a sixth of the time of zlib at its lowest level, and about as much space; codes
    deflate better by zlib.
    """
    is_codes = values.dtype == np.int8
    engine: Any = zlib.compressobj(_LEVEL) if is_codes else isal_zlib.compressobj(2)
    planes = values.reshape(-1).view(np.uint8).reshape(-1, values.itemsize).T
    deflated = [engine.compress(np.ascontiguousarray(plane).data) for plane in planes]
    data = b"".join([*deflated, engine.flush()])
    # Fletcher's checksum: sums of 16-bit words, and of these sums, modulo 65535 from 1 on.
    words = np.frombuffer(data + bytes(len(data) % 2), ">u2").astype(np.uint64)
    weights = np.arange(words.size, 0, -1, dtype=np.uint64) % 65535
    low, high = ((int(total) - 1) % 65535 + 1 for total in (words.sum(), words @ weights))
    return data + struct.pack("<HH", low, high)


def create_variable(
    file: h5py.File,
    variable: Variable,
    shape: Sequence[int],
    chunk: Sequence[int],
    dtype: np.dtype[Any],
) -> h5py.Dataset:
    """Create a dataset with its attributes, without values; its axes are there already."""
    dataset = file.create_dataset(
        variable.name,
        tuple(shape),
        dtype.newbyteorder("<"),
        chunks=tuple(chunk),
        **filters_of(variable),
    )
    write_attributes(dataset, attributes_of(variable))
    if variable.is_axis:
        dataset.make_scale(variable.name)
    else:
        for axis, dimension in enumerate(variable.dimensions):
            dataset.dims[axis].attach_scale(file[dimension])
    return dataset


def places_of(dataset: h5py.Dataset) -> list[Span]:
    """Return the offsets of the chunks of a dataset in a flushed file, in order."""
    places: dict[tuple[int, ...], Span] = {}

    def note(chunk: Any) -> None:
        if chunk.filter_mask:
            raise RuntimeError(f"HDF5 left out a filter of {dataset.name}; use another libhdf5.")
        places[chunk.chunk_offset] = chunk.byte_offset, chunk.size

    dataset.id.chunk_iter(note)
    return [place for _, place in sorted(places.items())]


# The HDF5 image of an atlas as HDF5 sees it, for those who verify that it is what the table says.
#
# libhdf5 was not made for hostile files: a reader that only asks uses ``atlas.file``.

_FILTERS = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32}
_LONGEST_ATTRIBUTE = 2**16  # bytes
_ROOM = 2**28  # bytes that HDF5 takes to read some chunks
_ROOM_TO_OPEN = 2**25  # with less, libhdf5 may crash, or fail on every later file

# What HDF5, h5py and who uses them raise at a file that is not as it should be.
_TROUBLES = RefusalError, ValueError, LookupError, TypeError, ArithmeticError, RuntimeError, OSError


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open the image of a file whose table was checked; ValueError or MemoryError if HDF5 fails."""
    if not _has_room(_ROOM_TO_OPEN):
        raise MemoryError(f"there is not enough memory to verify {path}.")
    try:
        with path.open("rb", buffering=0) as stream, h5py.File(stream, "r") as file:
            yield file
    except _TROUBLES as error:
        if "alloc" in str(error) or not _has_room(_ROOM):  # HDF5 raises the same error for both
            raise MemoryError(f"there is not enough memory to verify {path}.") from error
        raise ValueError(f"{path} {DAMAGED}") from error


def _has_room(size: int) -> bool:
    try:
        np.empty(size, np.uint8)
    except MemoryError:
        return False
    return True


def checked_datasets(file: h5py.File, table: Table) -> dict[str, h5py.Dataset]:
    """Return the variables by name; they, and nothing else, are stored as the table says."""
    check(set(file) == set(table.variables))
    datasets = {name: _checked_dataset(file, stored) for name, stored in table.variables.items()}
    check(all(places_of(datasets[n]) == list(table.variables[n].places) for n in datasets))
    return datasets


def _checked_dataset(file: h5py.File, stored: Stored) -> h5py.Dataset:
    name = stored.variable.name
    check(isinstance(file.get(name, getlink=True), h5py.HardLink))
    dataset = file[name]
    check(isinstance(dataset, h5py.Dataset))
    layout = dataset.id.get_create_plist()
    check(layout.get_layout() == h5py.h5d.CHUNKED and layout.get_external_count() == 0)
    filters = [layout.get_filter(index)[0] for index in range(layout.get_nfilters())]
    check(len(filters) == len(set(filters)))
    allowed = _FILTERS if stored.variable.is_packed else {h5py.h5z.FILTER_FLETCHER32}
    check(set(filters) == allowed)
    check(dataset.shape == stored.shape and dataset.chunks == stored.chunk)
    check(dataset.dtype == stored.dtype and "enum" not in (dataset.dtype.metadata or {}))
    return dataset


def text_of(file: h5py.File, name: str) -> str:
    """An attribute of the root group; RefusalError unless it is text of a moderate length."""
    identifier = file.attrs.get_id(name)
    check(identifier.shape == () and identifier.dtype.kind == "S")
    check(prod(identifier.shape) * identifier.dtype.itemsize <= _LONGEST_ATTRIBUTE)
    return bytes(file.attrs[name]).decode("utf-8")
