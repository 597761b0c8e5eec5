"""Atlas files are read here, and nowhere else. No JAX.

A file is checked against its footer before the HDF5 parser sees it, and against the schema before a
dataset is read. It was published by an atomic rename. So a reader meets the old file, the new file
or a refusal in one sentence, whatever happened to writer and disk. The bytes that were checked stay
in memory, and the arrays are unpacked from them: what becomes of the file later changes no answer.
"""

import io
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxstab.atlas.format import schema
from jaxstab.atlas.format.footer import is_sealed
from jaxstab.atlas.format.schema import VARIABLES, Variable
from jaxstab.conventions import AXES
from jaxstab.durable import named_errors

Array = np.ndarray[Any, np.dtype[Any]]
Arrays = Mapping[str, Array]

_FILTERS = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32}
_LONGEST_ATTRIBUTE = 2**16  # bytes
_BEST_COMPRESSION = 1100  # deflate cannot do better than about 1032
_DAMAGED = "is damaged, or no jaxstab atlas; build it again or copy it anew."


@dataclass(frozen=True)
class Contents:
    """What an atlas file holds: arrays by the names of the schema, who made it, and a digest."""

    arrays: "PackedArrays"
    created_by: str
    content_digest: str


class PackedArrays(Mapping[str, Array]):
    """The arrays of a file, each unpacked and checked when it is first asked for.

    Args:
        path: of the file, for what is said of it.
        data: all of its bytes, found right.
        shapes: of its arrays.
        unpacked: some of them.

    Raises:
        ValueError: an array that is asked for has a wrong checksum or values that make no sense.
        TooLargeError: it is larger than is read whole.
    """

    def __init__(
        self, path: Path, data: bytes, shapes: Mapping[str, tuple[int, ...]], unpacked: Arrays
    ) -> None:
        self._path, self._data, self._shapes = path, data, shapes
        self._unpacked = {name: _read_only(values) for name, values in unpacked.items()}

    def __getitem__(self, name: str) -> Array:
        if name not in self._unpacked:
            # Threads that meet here unpack the same values, and go on with one of them.
            self._unpacked.setdefault(name, self._unpack(name))
        return self._unpacked[name]

    def __contains__(self, name: object) -> bool:
        return name in self._shapes

    def __iter__(self) -> Iterator[str]:
        return iter(self._shapes)

    def __len__(self) -> int:
        return len(self._shapes)

    def attributes(self, name: str, wanted: Iterable[str]) -> dict[str, Any]:
        """Return what the file says of a variable, or of itself ("/"), where it says it."""
        with _parsed(io.BytesIO(self._data), self._path) as file:
            of = file[name]
            said = {
                word: _attribute(of, word, dimensions=int(word == "flag_values"))
                for word in wanted
                if word in of.attrs
            }
        return {
            word: value.decode() if isinstance(value, bytes) else value
            for word, value in said.items()
        }

    def _unpack(self, name: str) -> Array:
        if name not in self:
            raise KeyError(name)
        with _parsed(io.BytesIO(self._data), self._path) as file:
            values = _values(file[name])
            if not _makes_sense(name, values, self._shapes):
                raise _Refusal(_DAMAGED)
            return _read_only(values)


def read(path: Path) -> Contents:
    """Return what the file holds; all of its bytes are checked, and in memory.

    Raises:
        OSError: the file is missing or unreadable.
        ValueError: it is foreign, truncated, damaged or of another version of the schema.
        TooLargeError: it is larger than is read whole.
    """
    data = _bytes_of(path)
    with _checked(io.BytesIO(data), path) as file:
        datasets = checked_datasets(file)
        shapes = {name: dataset.shape for name, dataset in datasets.items()}
        unpacked = {name: _values(datasets[name]) for name in (*AXES, schema.SPEC)}
        if inconsistency(shapes, unpacked):
            raise _Refusal(_DAMAGED)
        arrays = PackedArrays(path, data, shapes, unpacked)
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
    with (
        named_errors("read", path),
        path.open("rb", buffering=0) as stream,
        _checked(stream, path) as file,
    ):
        yield file


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


def _bytes_of(path: Path) -> bytes:
    with named_errors("read", path), path.open("rb") as stream:
        size = stream.seek(0, io.SEEK_END)
        if size > schema.LARGEST_ARRAY:
            raise TooLargeError(f"{path} {_too_large(size, 'file')}")
        stream.seek(0)
        return stream.read(size)


@contextmanager
def _checked(stream: io.FileIO | io.BytesIO, path: Path) -> Iterator[h5py.File]:
    if not is_sealed(stream):
        raise ValueError(f"{path} {_DAMAGED}")
    with _parsed(stream, path) as file:
        _check_version(file)
        yield file


@contextmanager
def _parsed(stream: io.FileIO | io.BytesIO, path: Path) -> Iterator[h5py.File]:
    """Open a file that has the right footer, and tell of its troubles as of this path."""
    try:
        with h5py.File(stream, "r") as file:
            yield file
    except TooLargeError as refusal:
        raise TooLargeError(f"{path} {refusal}") from None
    except _Refusal as refusal:
        raise ValueError(f"{path} {refusal}") from None
    except (ValueError, KeyError, TypeError, RuntimeError, OSError, MemoryError) as error:
        raise ValueError(f"{path} {_DAMAGED}") from error


def _check_version(file: h5py.File) -> None:
    version = _attribute(file, "schema_version")
    if _attribute(file, "format") != np.bytes_(schema.FORMAT):
        raise _Refusal(_DAMAGED)
    if version not in schema.READ_VERSIONS:
        known = " and ".join(map(str, schema.READ_VERSIONS))
        raise _Refusal(
            f"has schema version {version}, and this jaxstab reads versions {known}; use the "
            "jaxstab that wrote it, or build it again."
        )


def _attribute(of: h5py.Group | h5py.Dataset, name: str, dimensions: int = 0) -> Any:
    identifier = of.attrs.get_id(name)
    size = prod(identifier.shape) * identifier.dtype.itemsize
    is_expected = len(identifier.shape) == dimensions and identifier.dtype.kind in "Si"
    if not is_expected or size > _LONGEST_ATTRIBUTE:
        raise _Refusal(_DAMAGED)
    return of.attrs[name]


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


def _values(dataset: h5py.Dataset) -> Array:
    if dataset.nbytes > schema.LARGEST_ARRAY:
        raise TooLargeError(_too_large(dataset.nbytes, dataset.name[1:]))
    values: Array = dataset[()]
    return values


def _too_large(size: int, what: str) -> str:
    return (
        f"has {size} bytes of {what}, and at most {schema.LARGEST_ARRAY} are read into memory; "
        "read parts of it with h5py or xarray."
    )


def _read_only(values: Array) -> Array:
    values.flags.writeable = False
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


def _makes_sense(name: str, values: Array, shapes: Mapping[str, tuple[int, ...]]) -> bool:
    """Whether verdicts have codes of verdicts, and lists are as long as their parts together."""
    if VARIABLES[name].holds_verdicts:
        codes = schema.FLAG_VALUES
        return bool(min(codes) <= values.min() and values.max() <= max(codes))
    return name not in schema.STRUNG or (int(values.sum()),) == shapes[schema.STRUNG[name]]
