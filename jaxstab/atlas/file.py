"""Atlas files are read here, and nowhere else. No JAX.

A file is checked against its footer before the HDF5 parser sees it, and against the schema before a
dataset is read. It was published by an atomic rename. So a reader meets the old file, the new file
or a refusal in one sentence, whatever happened to writer and disk.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxstab.atlas import schema
from jaxstab.atlas.durable import named_errors
from jaxstab.atlas.footer import is_sealed
from jaxstab.atlas.schema import VARIABLES, Variable
from jaxstab.conventions import AXES

Arrays = Mapping[str, np.ndarray[Any, np.dtype[Any]]]

_FILTERS = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32}
_LONGEST_ATTRIBUTE = 2**16  # bytes
_BEST_COMPRESSION = 1100  # deflate cannot do better than about 1032
_DAMAGED = "is damaged, or no jaxstab atlas; build it again or copy it anew."


@dataclass(frozen=True)
class Contents:
    """What an atlas file holds: arrays by the names of the schema, who made it, and a digest."""

    arrays: Arrays
    created_by: str
    content_digest: str

    def __post_init__(self) -> None:
        shapes = {name: values.shape for name, values in self.arrays.items()}
        problem = inconsistency(shapes, self.arrays) or _wrong_value(self.arrays)
        if problem:
            raise ValueError(f"the arrays of an atlas do not fit together: {problem}.")


def read(path: Path) -> Contents:
    """Return what the file holds, all of it checked and in memory.

    Raises:
        OSError: the file is missing or unreadable.
        ValueError: it is foreign, truncated, damaged or of another version of the schema.
        TooLargeError: it is larger than is read whole.
    """
    with opened(path) as file:
        arrays = {name: _values(dataset) for name, dataset in checked_datasets(file).items()}
        return Contents(arrays, text_of(file, "created_by"), text_of(file, "content_sha256"))


def node_count(path: Path) -> int:
    """Return how many nodes an atlas has, without a look at its values.

    Raises:
        OSError, ValueError: as ``read``.
    """
    with opened(path) as file:
        return prod(file[dimension].size for dimension in schema.NODE)


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open a file for reading after its footer, its format and its version were found right.

    What is wrong with the contents in the eyes of HDF5 or of its user is told as of this file.

    Raises:
        OSError, ValueError: as ``read``.
    """
    with named_errors("read", path), path.open("rb", buffering=0) as stream:
        if not is_sealed(stream):
            raise ValueError(f"{path} {_DAMAGED}")
        try:
            with h5py.File(stream, "r") as file:
                _check_version(file)
                yield file
        except TooLargeError as refusal:
            raise TooLargeError(f"{path} {refusal}") from None
        except _Refusal as refusal:
            raise ValueError(f"{path} {refusal}") from None
        except (ValueError, KeyError, TypeError, RuntimeError, OSError, MemoryError) as error:
            raise ValueError(f"{path} {_DAMAGED}") from error


def checked_datasets(file: h5py.File) -> dict[str, h5py.Dataset]:
    """Return the variables by name, after a look at everything that could make a read unsafe."""
    return {name: _checked_dataset(file, VARIABLES[name]) for name in _checked_names(file)}


def text_of(file: h5py.File, name: str) -> str:
    """Return an attribute of the root group."""
    return bytes(_attribute(file, name)).decode("utf-8")


class TooLargeError(ValueError):
    """A file is sound but larger than is read into memory."""


class _Refusal(Exception):
    """Why a file is not read, without its name."""


def _check_version(file: h5py.File) -> None:
    version = _attribute(file, "schema_version")
    if _attribute(file, "format") != np.bytes_(schema.FORMAT):
        raise _Refusal(_DAMAGED)
    if version != schema.SCHEMA_VERSION:
        raise _Refusal(
            f"has schema version {version}, and this jaxstab reads version "
            f"{schema.SCHEMA_VERSION}; use the jaxstab that wrote it, or build it again."
        )


def _attribute(file: h5py.File, name: str) -> Any:
    identifier = file.attrs.get_id(name)
    if identifier.shape != () or identifier.dtype.kind not in "Si":
        raise _Refusal(_DAMAGED)
    if identifier.dtype.itemsize > _LONGEST_ATTRIBUTE:
        raise _Refusal(_DAMAGED)
    return file.attrs[name]


def _checked_names(file: h5py.File) -> list[str]:
    """Return the names of the variables; there is nothing but them, and products are whole."""
    names = set(file)
    chosen = [set(group) for group in schema.PRODUCTS.values() if names & set(group)]
    if names != schema.ALWAYS.union(*chosen) or not chosen:
        raise _Refusal(_DAMAGED)
    return [name for name in VARIABLES if name in names]


def _checked_dataset(file: h5py.File, variable: Variable) -> h5py.Dataset:
    if not isinstance(file.get(variable.name, getlink=True), h5py.HardLink):
        raise _Refusal(_DAMAGED)
    dataset = file[variable.name]
    if not isinstance(dataset, h5py.Dataset):
        raise _Refusal(_DAMAGED)
    layout = dataset.id.get_create_plist()
    filters = [layout.get_filter(number)[0] for number in range(layout.get_nfilters())]
    fits = (
        layout.get_layout() == h5py.h5d.CHUNKED
        and layout.get_external_count() == 0
        and len(filters) == len(_FILTERS)
        and set(filters) == _FILTERS
        and dataset.ndim == len(variable.dimensions)
        and dataset.size > 0
        and _is_stored(dataset)
        and _has_dtype(dataset.dtype, variable)
    )
    if not fits:
        raise _Refusal(_DAMAGED)
    return dataset


def _values(dataset: h5py.Dataset) -> np.ndarray[Any, np.dtype[Any]]:
    if dataset.size > schema.LARGEST_ARRAY:
        raise TooLargeError(
            f"has {dataset.size} values of {dataset.name[1:]}, and at most {schema.LARGEST_ARRAY} "
            "are read into memory; read parts of it with h5py or xarray."
        )
    values: np.ndarray[Any, np.dtype[Any]] = dataset[()]
    return values


def _is_stored(dataset: h5py.Dataset) -> bool:
    """Whether the file holds as much as it promises: missing chunks read as zeros without end."""
    stored = dataset.id.get_storage_size() * _BEST_COMPRESSION
    elements = max(int(dataset.size), int(np.prod(dataset.chunks, dtype=object)))
    return bool(elements * int(dataset.dtype.itemsize) <= stored)


def _has_dtype(dtype: np.dtype[Any], variable: Variable) -> bool:
    if variable.dtype == "S":
        return bool(dtype.kind == "S" and 0 < dtype.itemsize <= schema.LONGEST_LINE)
    return bool(dtype == np.dtype(variable.dtype) and dtype.metadata is None)  # no enumeration


def inconsistency(shapes: Mapping[str, tuple[int, ...]], axes: Arrays) -> str:
    """Return in words what is wrong with shapes or axes; empty when nothing is."""
    lengths: dict[str, int] = {}
    for name, shape in shapes.items():
        for dimension, length in zip(VARIABLES[name].dimensions, shape, strict=True):
            if lengths.setdefault(dimension, length) != length:
                return f"{name} has {length} values along {dimension}, not {lengths[dimension]}"
    for axis, nodes in (
        ("alpha", "alpha_node"),
        ("beta", "beta_node"),
        ("gamma", "gamma"),
        ("delta", "delta"),
    ):
        if lengths[f"{axis}_cell"] != max(lengths[nodes] - 1, 1):
            return f"{axis} has {lengths[nodes]} nodes and {lengths[f'{axis}_cell']} cells"
    for axis in AXES:
        if not (np.all(np.isfinite(axes[axis])) and np.all(np.diff(axes[axis], axis=0) > 0)):
            return f"{axis} is not ascending"
    return ""


def _wrong_value(arrays: Arrays) -> str:
    for name, values in arrays.items():
        if VARIABLES[name].holds_verdicts and not (
            values.min() >= min(schema.FLAG_VALUES) and values.max() <= max(schema.FLAG_VALUES)
        ):
            return f"{name} has a code that is no verdict"
    for name, dimension in schema.STRUNG.items():
        if name in arrays and arrays[name].sum() != arrays[dimension].size:
            return f"{name} counts {arrays[name].sum()} of {arrays[dimension].size}"
    return ""
