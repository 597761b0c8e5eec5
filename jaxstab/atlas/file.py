"""Atlas files on disk: the only place that opens one. No JAX.

A file is made in memory, whole, and published by an atomic rename; it is checked against its footer
before the HDF5 parser sees it, and against the schema before a dataset is read. So a reader meets
the old file, the new file or a refusal in one sentence, whatever happened to writer and disk.
"""

import errno
import hashlib
import os
import secrets
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxstab.atlas import schema
from jaxstab.atlas.schema import VARIABLES, Variable

Arrays = Mapping[str, np.ndarray[Any, np.dtype[Any]]]

_FOOTER = struct.Struct(f"<{len(schema.FOOTER_MAGIC)}sQ32s")
_FILTERS = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32}
_LARGEST_CHUNK = 2**20  # elements
_LONGEST_ATTRIBUTE = 2**16  # bytes
_BEST_COMPRESSION = 1100  # deflate cannot do better than about 1032
_DAMAGED = "is damaged, or no jaxstab atlas; build it again or copy it anew."


@dataclass(frozen=True)
class Contents:
    """What an atlas file holds: arrays by the names of the schema, and who made it."""

    arrays: Arrays
    created_by: str

    def __post_init__(self) -> None:
        problem = _inconsistency(self.arrays)
        if problem:
            raise ValueError(f"the arrays of an atlas do not fit together: {problem}.")


def check_folder_of(path: Path) -> None:
    """Make sure, before hours of work, that a file can be written at this place.

    Raises:
        OSError: the folder is missing or not writable, or there is a folder of this name.
    """
    with _named_errors("write", path):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "there is a folder of this name")
        temporary = _temporary_name(path)
        os.close(_create(temporary))
        temporary.unlink()


def write(contents: Contents, path: Path) -> None:
    """Publish an atlas: afterwards the whole file is at its place, durably, or nothing changed.

    Raises:
        OSError: the folder is missing, read-only or full.
    """
    publish(sealed(encode(contents)), path)


def sealed(image: bytes) -> bytes:
    """Return the image with the footer by which a reader knows that it is whole."""
    digest = hashlib.sha256(image).digest()
    return image + _FOOTER.pack(schema.FOOTER_MAGIC, len(image), digest)


def publish(data: bytes, path: Path) -> None:
    """Put a whole file in its place, durably and by one rename, or change nothing.

    Raises:
        OSError: the folder is missing, read-only or full.
    """
    with _named_errors("write", path):
        _publish(data, path)


def read(path: Path) -> Contents:
    """Return what the file holds, all of it checked.

    Raises:
        OSError: the file is missing or unreadable.
        ValueError: it is foreign, truncated, damaged or of another version of the schema.
    """
    with _named_errors("read", path), path.open("rb") as stream:
        data = stream.read(schema.LARGEST_IMAGE + _FOOTER.size + 1)
    return decode(_image_of(data, path), path)


def encode(contents: Contents) -> bytes:
    """Return the HDF5 image; equal contents give equal bytes (there are no times in it)."""
    with h5py.File.in_memory(libver=("v110", "v110")) as file:
        for name, value in _root_attributes(contents).items():
            file.attrs[name] = value
        for variable in VARIABLES.values():
            if variable.name in contents.arrays:
                _write_variable(file, variable, contents.arrays[variable.name])
        file.flush()
        return bytes(file.id.get_file_image())


def decode(image: bytes, path: Path) -> Contents:
    """Return the contents of an HDF5 image whose footer was right.

    Raises:
        ValueError: it is not what the schema says; nothing outside of the schema is touched.
    """
    try:
        with h5py.File.in_memory(image) as file:
            version = _attribute(file, "schema_version")
            if _attribute(file, "format") != np.bytes_(schema.FORMAT):
                raise _Refusal(_DAMAGED)
            if version != schema.SCHEMA_VERSION:
                raise _Refusal(
                    f"has schema version {version}, and this jaxstab reads version "
                    f"{schema.SCHEMA_VERSION}; use the jaxstab that wrote it, or build it again."
                )
            names = _checked_names(file)
            arrays = {name: _read_variable(file, VARIABLES[name]) for name in names}
            created_by = bytes(_attribute(file, "created_by")).decode("utf-8")
        return Contents(arrays, created_by)
    except _Refusal as refusal:
        raise ValueError(f"{path} {refusal}") from None
    except (ValueError, KeyError, TypeError, RuntimeError, OSError, MemoryError) as error:
        raise ValueError(f"{path} {_DAMAGED}") from error


class _Refusal(Exception):
    """Why a file is not read, without its name."""


@contextmanager
def _named_errors(deed: str, path: Path) -> Iterator[None]:
    """Give an error of the operating system one sentence with the name of the file."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise type(error)(error.errno, f"cannot {deed} {path}: {reason}.") from error


# ------------------------------------------------------------------------------------------ publish


def _publish(data: bytes, path: Path) -> None:
    temporary = _temporary_name(path)
    descriptor = _create(temporary)
    try:
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[os.write(descriptor, rest) :]
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    _sync_folder(path.parent)


def _temporary_name(path: Path) -> Path:
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")


def _create(path: Path) -> int:
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":  # elsewhere a folder cannot be opened, and the rename is journaled
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


# -------------------------------------------------------------------------------------------- write


def _root_attributes(contents: Contents) -> dict[str, Any]:
    words = {
        "format": schema.FORMAT,
        "title": "Stability of a haptic rendering loop over its dimensionless parameters",
        "created_by": contents.created_by,
        "source": "characteristic polynomial of Hulin, Preusche, Hirzinger (2008), eq. (9)",
        "symbols": "K, B stiffness and damping of the virtual wall; m, b, k mass, damping and "
        "stiffness of device and hand; T sampling period, t_d delay",
        "Conventions": "CF-1.8",
    }
    return _as_bytes(words) | {"schema_version": np.int32(schema.SCHEMA_VERSION)}


def _as_bytes(words: Mapping[str, str]) -> dict[str, Any]:
    return {name: np.bytes_(text.encode("utf-8")) for name, text in words.items()}


def _write_variable(
    file: h5py.File, variable: Variable, values: np.ndarray[Any, np.dtype[Any]]
) -> None:
    dataset = file.create_dataset(
        variable.name,
        data=values,
        chunks=_chunk_shape(variable, values.shape),
        shuffle=True,
        compression="gzip",
        compression_opts=6,
        fletcher32=True,
        track_times=False,
    )
    words = {"long_name": variable.long_name, "interpretation": variable.interpretation}
    if variable.dtype == "float64":
        words["units"] = "1"
    if len(variable.dimensions) == len(schema.NODE) and "alpha_node" in variable.dimensions:
        words["coordinates"] = "alpha beta"
    for name, value in _as_bytes(words).items():
        dataset.attrs[name] = value
    if variable.holds_verdicts:
        dataset.attrs["flag_values"] = np.array(schema.FLAG_VALUES, np.int8)
        dataset.attrs["flag_meanings"] = np.bytes_(schema.FLAG_MEANINGS)
    if variable.is_axis:
        dataset.make_scale(variable.name)
    else:
        for number, dimension in enumerate(variable.dimensions):
            dataset.dims[number].attach_scale(file[dimension])


def _chunk_shape(variable: Variable, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the whole of a small array; of a large one, whole slices first."""
    chunk = list(shape)
    for axis in (4, 2, 3, 1, 0):  # delay, gamma, delta, beta, alpha
        if axis < len(chunk) and np.prod(chunk) > _LARGEST_CHUNK:
            others = int(np.prod(chunk)) // chunk[axis]
            chunk[axis] = max(1, _LARGEST_CHUNK // others)
    return tuple(chunk)


# --------------------------------------------------------------------------------------------- read


def _image_of(data: bytes, path: Path) -> bytes:
    if len(data) < _FOOTER.size:
        raise ValueError(f"{path} {_DAMAGED}")
    image, footer = data[: -_FOOTER.size], data[-_FOOTER.size :]
    magic, length, digest = _FOOTER.unpack(footer)
    if magic != schema.FOOTER_MAGIC or length != len(image):
        raise ValueError(f"{path} {_DAMAGED}")
    if digest != hashlib.sha256(image).digest():
        raise ValueError(f"{path} {_DAMAGED}")
    return image


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


def _read_variable(file: h5py.File, variable: Variable) -> np.ndarray[Any, np.dtype[Any]]:
    """Return the values after looking at everything that could make the read unsafe."""
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
        and 0 < dataset.size <= schema.LARGEST_ARRAY
        and _is_stored(dataset)
        and _has_dtype(dataset.dtype, variable)
    )
    if not fits:
        raise _Refusal(_DAMAGED)
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
    return bool(dtype == np.dtype(variable.dtype))


def _inconsistency(arrays: Arrays) -> str:
    """Return in words what is wrong with the shapes, axes or codes; empty when nothing is."""
    lengths: dict[str, int] = {}
    for name, values in arrays.items():
        for dimension, length in zip(VARIABLES[name].dimensions, values.shape, strict=True):
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
    for axis in ("alpha", "beta", "gamma", "delta", "delay"):
        if not (np.all(np.isfinite(arrays[axis])) and np.all(np.diff(arrays[axis], axis=0) > 0)):
            return f"{axis} is not ascending"
    for name, values in arrays.items():
        if VARIABLES[name].holds_verdicts and not np.all(np.isin(values, schema.FLAG_VALUES)):
            return f"{name} has a code that is no verdict"
    return ""
