"""The HDF5 image of an atlas as HDF5 sees it, for those who verify that it is what the table says.

libhdf5 was not made for hostile files: a reader that only asks uses ``read.file``.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxstab.atlas.format.schema import Variable
from jaxstab.atlas.format.table import DAMAGED, RefusalError, Stored, Table, check
from jaxstab.atlas.write.variables import places_of

_FILTERS = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32}
_LONGEST_ATTRIBUTE = 2**16  # bytes
_ROOM = 2**28  # bytes
TROUBLES = (
    RefusalError,
    ValueError,
    LookupError,
    TypeError,
    ArithmeticError,
    RuntimeError,
    OSError,
)
"""What HDF5, h5py and who uses them raise at a file that is not as it should be."""


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open the image of a file of which the table was found right.

    Raises:
        ValueError: HDF5, or who uses it, cannot go on.
        MemoryError: it has not the memory to go on.
    """
    try:
        with path.open("rb", buffering=0) as stream, h5py.File(stream, "r") as file:
            yield file
    except TROUBLES as error:
        if "alloc" in str(error) or not _has_room():  # HDF5 raises the same error for both
            raise MemoryError(f"there is not enough memory to verify {path}.") from error
        raise ValueError(f"{path} {DAMAGED}") from error


def _has_room() -> bool:
    """Whether there is memory for what HDF5 takes to read some chunks."""
    try:
        return bool(bytearray(_ROOM))
    except MemoryError:
        return False


def checked_datasets(file: h5py.File, table: Table) -> dict[str, h5py.Dataset]:
    """Return the variables by name; they, and nothing else, are stored as the table says.

    Raises:
        RefusalError: as it says.
    """
    check(set(file) == set(table.variables))
    return {name: _checked_dataset(file, stored) for name, stored in table.variables.items()}


def text_of(file: h5py.File, name: str) -> str:
    """Return an attribute of the root group.

    Raises:
        RefusalError: it is no text of a moderate length.
    """
    identifier = file.attrs.get_id(name)
    check(identifier.shape == () and identifier.dtype.kind == "S")
    check(prod(identifier.shape) * identifier.dtype.itemsize <= _LONGEST_ATTRIBUTE)
    return bytes(file.attrs[name]).decode("utf-8")


def _checked_dataset(file: h5py.File, stored: Stored) -> h5py.Dataset:
    dataset = checked_layout(file, stored.variable, stored.dtype, stored.shape, stored.chunk)
    check(places_of(dataset) == list(stored.places))
    return dataset


def checked_layout(
    file: h5py.File,
    variable: Variable,
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    chunk: tuple[int, ...],
) -> h5py.Dataset:
    """Return the dataset of a variable, which is stored as variables are, with this layout.

    Raises:
        RefusalError: it is not.
    """
    check(isinstance(file.get(variable.name, getlink=True), h5py.HardLink))
    dataset = file[variable.name]
    check(isinstance(dataset, h5py.Dataset))
    layout = dataset.id.get_create_plist()
    check(layout.get_layout() == h5py.h5d.CHUNKED and layout.get_external_count() == 0)
    filters = [layout.get_filter(number)[0] for number in range(layout.get_nfilters())]
    check(len(filters) == len(set(filters)))
    known = _FILTERS if variable.is_packed else {h5py.h5z.FILTER_FLETCHER32}
    check(set(filters) == known)
    check(dataset.shape == shape and dataset.chunks == chunk)
    check(dataset.dtype == dtype and "enum" not in (dataset.dtype.metadata or {}))
    return dataset
