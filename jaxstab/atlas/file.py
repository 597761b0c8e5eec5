"""The file of an atlas, version 5: HDF5 that any program reads, with a checksum on every dataset.

The root group holds the limits with their axes, and the specification; the group ``fields`` holds
the fields, on axes of their own. Both are NXdata groups whose datasets have dimension scales, so
that xarray, HDF5 viewers and C see named coordinates. Every dataset is chunked with Fletcher32, and
the superblock and the headers of format v110 have checksums of their own: a damaged file is refused
by libhdf5. What is not damaged but foreign is refused here: a reader asks for the datasets of
``VARIABLES``, their types, shapes and ranges, before it allocates memory and before a query uses
them.

Limits are stored plainly; fields are shuffled and deflated. A file has no times: equal
specifications give equal bytes on one machine.
"""

import os
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import inf, pi, prod
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from jaxstab.durable import PatientStream, is_memory_short, named_errors, target_of

FORMAT: Final = "jaxstab atlas"
SCHEMA_VERSION: Final = 5
FIELDS: Final = "fields"
NODE: Final = ("alpha_node", "beta_node", "gamma", "delta", "delay")
_PLANT_CELL = ("gamma_cell", "delta_cell", "delay_cell")
_LONGEST_LINE = 2**16  # bytes in a line of the specification

Array = NDArray[Any]
Arrays = Mapping[str, Array]


@dataclass(frozen=True)
class StoredVariable:
    """One dataset: its type, its dimensions (itself for an axis), what it means and its range."""

    name: str
    dtype: str
    dimensions: tuple[str, ...]
    long_name: str
    interpretation: str
    lowest: float | int = -inf
    highest: float | int = inf
    has_nan: bool = False
    said: tuple[tuple[str, str], ...] = ()

    @property
    def is_axis(self) -> bool:
        """True for the coordinate of the dimension of its name (an HDF5 dimension scale)."""
        return self.dimensions == (self.name,)

    @property
    def is_packed(self) -> bool:
        """True if its chunks are shuffled and deflated; those of others are plain numbers."""
        return self.dimensions == NODE

    @property
    def attributes(self) -> dict[str, Any]:
        """The attributes of the dataset."""
        given = {"long_name": self.long_name, "interpretation": self.interpretation}
        given |= {"units": "1"} if self.dtype.startswith("float") else {}
        given |= {"coordinates": "alpha beta"} if self.dimensions == NODE else {}
        return given | dict(self.said)


def _axis(name: str, long_name: str, words: str, highest: float = inf) -> StoredVariable:
    return StoredVariable(name, "float64", (name,), long_name, words, 0.0, highest)


def _numbers(name: str, words: str) -> StoredVariable:
    return StoredVariable(name, "int32", (name,), f"number along {name}", words, 0)


def _cells(axis: str) -> StoredVariable:
    return _numbers(f"{axis}_cell", "cell i lies between nodes i and i + 1; of one node, at it")


def _field(
    name: str, long_name: str, words: str, low: float, high: float, **said: str
) -> StoredVariable:
    return StoredVariable(
        name, "float32", NODE, long_name, words, low, high, True, tuple(said.items())
    )


_PLANTS = (
    _axis("gamma", "physical stiffness", "k T^2/m, k of device and hand"),
    _axis("delta", "physical damping", "b T/m, b of device and hand"),
    _axis("delay", "time delay", "t_d/T, in sampling periods T", 100.0),
)
_ERROR = (
    "how far the cubic limits are from the exact ones at most, over a stencil of three nodes "
    "an axis; infinite: a limit of the stencil is unknown"
)
LIMITS: Final = (
    *_PLANTS,
    _axis("row", "share of the stable interval of beta", "even, from 0 to 1", 1.0),
    _numbers("end", "0: the lower one, 1: the upper one"),
    *map(_cells, ("gamma", "delta", "delay", "row")),
    StoredVariable(
        "beta_limits",
        "float64",
        ("gamma", "delta", "delay", "end"),
        "ends of the beta with a stable alpha",
        "B T/m, of the component of the stable set that holds small gains, or of the largest one; "
        "NaN: nothing is stable",
        has_nan=True,
    ),
    StoredVariable(
        "alpha_limits",
        "float64",
        ("gamma", "delta", "delay", "row", "end"),
        "ends of the stable alpha",
        "K T^2/m at beta = beta_limits[0] + row (beta_limits[1] - beta_limits[0]); between nodes "
        "cubic along each axis, through the four nearest, but none beyond a whole delay. NaN: more "
        "than one interval of alpha is stable there, or none",
        has_nan=True,
    ),
    StoredVariable(
        "beta_error", "float32", (*_PLANT_CELL, "end"), "measured error of beta_limits", _ERROR, 0.0
    ),
    StoredVariable(
        "alpha_error",
        "float32",
        (*_PLANT_CELL, "row_cell", "end"),
        "measured error of alpha_limits",
        f"{_ERROR}. Rely on a limit only where alpha is four times this away from it",
        0.0,
    ),
    StoredVariable(
        "beyond",
        "int8",
        _PLANT_CELL,
        "what is beyond the ends of beta",
        "1: no wall is stable there; 0: another component of the stable set may be",
        0,
        1,
    ),
    _numbers("spec_line", "line of the specification"),
    StoredVariable(
        "spec",
        "S",
        ("spec_line",),
        "specification of this atlas",
        "the lines of a TOML file from which the same atlas can be built",
    ),
)
_LEFT_OUT = "NaN: more than one cell outside of the stable set"
_UNRESOLVED = "NaN also where two poles or pairs have nearly the same modulus"
FIELD_VARIABLES: Final = (
    *_PLANTS,
    _numbers("alpha_node", "node i at delay k is at alpha[i, k]"),
    _numbers("beta_node", "node i at delay k is at beta[i, k]"),
    StoredVariable(
        "alpha",
        "float64",
        ("alpha_node", "delay"),
        "stiffness of the virtual wall",
        "K T^2/m; one column of ascending nodes for each delay",
    ),
    StoredVariable(
        "beta",
        "float64",
        ("beta_node", "delay"),
        "damping of the virtual wall",
        "B T/m; one column of ascending nodes for each delay",
    ),
    _field(
        "spectral_radius",
        "spectral radius, the largest modulus of a closed-loop pole",
        f"rounded up: no pole is outside of this radius; {_LEFT_OUT}",
        *(0.0, inf),
        standard_name="spectral_radius",
        ancillary_variables="spectral_radius_error",
    ),
    _field(
        "spectral_radius_error",
        "proved bound of the error of the spectral radius",
        "the true radius lies between spectral_radius less this and spectral_radius; infinite: "
        f"none is proved; {_LEFT_OUT}",
        *(0.0, inf),
        standard_name="spectral_radius standard_error",
    ),
    _field(
        "frequency",
        "frequency of the dominant pole z = exp(s)",
        "|Im s| in rad per sample, within 1e-6: 0 for a positive real pole, pi for a negative one; "
        f"{_LEFT_OUT}. {_UNRESOLVED}",
        *(0.0, float(np.float32(pi))),
        units="rad",
    ),
    _field(
        "damping_ratio",
        "damping ratio of the dominant pole z = exp(s)",
        "-Re s / |s|, within 1e-6: 1 and -1 for positive real poles inside and outside of the unit "
        f"circle; {_LEFT_OUT}. {_UNRESOLVED}",
        *(-1.0, 1.0),
    ),
    StoredVariable(
        "outside",
        "int16",
        NODE,
        "number of poles outside of the unit circle",
        "proved; 0 is stable, -1: a pole is too close to the circle to tell",
        -1,
    ),
)
PACKED: Final = tuple(variable.name for variable in FIELD_VARIABLES if variable.is_packed)


class RefusalError(ValueError):
    """A file is no sound atlas."""


# ------------------------------------------------------------------------------------------ writing


@contextmanager
def written(descriptor: int) -> Iterator[tuple[PatientStream, h5py.File]]:
    """Open an empty HDF5 file to write; errors of the disk are raised when it is done.

    A long write calls ``PatientStream.check`` often.
    """
    stream = PatientStream(descriptor)
    with h5py.File(stream, "w", libver=("v110", "v110")) as file:
        yield stream, file
    stream.check()
    os.ftruncate(descriptor, stream.size)


def write_attributes(to: h5py.Group | h5py.Dataset, attributes: Mapping[str, Any]) -> None:
    """Write attributes; texts as UTF-8 of a fixed length."""
    for name, value in attributes.items():
        to.attrs[name] = np.bytes_(value.encode("utf-8")) if isinstance(value, str) else value


def write_head(
    file: h5py.File,
    created_by: str,
    filters: str,
    tested: Mapping[str, int],
    *,
    has_filters: bool,
) -> None:
    """Write the attributes of a file; ``tested`` says what its build found at random points."""
    head = {
        "format": FORMAT,
        "title": "Stability of a haptic rendering loop over its dimensionless parameters",
        "created_by": created_by,
        "source": "characteristic polynomial of Hulin, Preusche, Hirzinger (2008), eq. (9)",
        "symbols": "K, B stiffness and damping of the virtual wall; m, b, k mass, damping and "
        "stiffness of device and hand; T sampling period, t_d delay",
        "filters": filters,
        "has_filters": np.int32(has_filters),
        "Conventions": "CF-1.8",
        "schema_version": np.int32(SCHEMA_VERSION),
        "NX_class": "NXdata",
        "signal": "alpha_limits",
        "axes": np.array(["gamma", "delta", "delay", "row", "end"], "S"),
    }
    write_attributes(file, head | {name: np.int64(count) for name, count in tested.items()})


def write_limits(file: h5py.File, spec: str, arrays: Arrays) -> None:
    """Write the limits with their axes, and the text of the specification."""
    lines = np.array([line.encode("utf-8") or b" " for line in spec.splitlines()])
    _write_all(file, LIMITS, {"spec": lines, **arrays})


def create_fields(file: h5py.File, axes: Arrays, chunk: Sequence[int]) -> h5py.Group:
    """Create the group of fields with its axes; the chunks of its fields are written later."""
    group = file.create_group(FIELDS)
    _write_all(group, FIELD_VARIABLES, axes)
    shape = [group[name].size for name in NODE]
    for variable in FIELD_VARIABLES:
        if variable.is_packed:
            _created(group, variable, shape, chunk, np.dtype(variable.dtype))
    described = {
        "NX_class": "NXdata",
        "signal": "spectral_radius",
        "axes": np.array(NODE, "S"),
        "auxiliary_signals": np.array(["frequency", "damping_ratio", "outside"], "S"),
    }
    write_attributes(group, described)
    return group


def _write_all(group: h5py.Group, variables: Sequence[StoredVariable], arrays: Arrays) -> None:
    """Write variables that are not packed, and a scale for each dimension."""
    largest_chunk = 2**17  # values of an array that is not laid out in tiles
    lengths = {
        dimension: length
        for variable in variables
        if variable.name in arrays
        for dimension, length in zip(variable.dimensions, arrays[variable.name].shape, strict=True)
    }
    for variable in variables:
        if not variable.is_packed:
            values = arrays.get(variable.name)
            if values is None:
                values = np.arange(lengths[variable.name], dtype=variable.dtype)
            count, *others = values.shape
            rows = max(1, min(count, largest_chunk // prod(others)))
            _created(group, variable, values.shape, (rows, *others), values.dtype)[...] = values


def _created(
    group: h5py.Group,
    variable: StoredVariable,
    shape: Sequence[int],
    chunk: Sequence[int],
    dtype: np.dtype[Any],
) -> h5py.Dataset:
    """Create a dataset with its attributes, without values; its axes are there already."""
    level = 6  # of compression
    packing = {"shuffle": True, "compression": "gzip", "compression_opts": level}
    dataset = group.create_dataset(
        variable.name,
        tuple(shape),
        dtype.newbyteorder("<"),
        chunks=tuple(chunk),
        fletcher32=True,
        track_times=False,
        **(packing if variable.is_packed else {}),
    )
    write_attributes(dataset, variable.attributes)
    if variable.is_axis:
        dataset.make_scale(variable.name)
    else:
        for axis, dimension in enumerate(variable.dimensions):
            dataset.dims[axis].attach_scale(group[dimension])
    return dataset


def packed(values: Array, chunk: Sequence[int]) -> bytes:
    """Return values as a chunk of the file: shuffled, deflated, with Fletcher's checksum.

    The filters of libhdf5 would store equal values; ISA-L deflates in a sixth of the time of zlib
    at its lowest level, into about as much space.
    """
    whole = np.zeros(chunk, values.dtype.newbyteorder("<"))
    whole[tuple(map(slice, values.shape))] = values
    engine = isal_zlib.compressobj(2)
    planes = whole.reshape(-1).view(np.uint8).reshape(-1, whole.itemsize).T
    deflated = [engine.compress(np.ascontiguousarray(plane).data) for plane in planes]
    data = b"".join([*deflated, engine.flush()])
    # Sums of 16-bit words, and of these sums, modulo 65535 from 1 on.
    words = np.frombuffer(data + bytes(len(data) % 2), ">u2").astype(np.uint64)
    weights = np.arange(words.size, 0, -1, dtype=np.uint64) % 65535
    low, high = ((int(total) - 1) % 65535 + 1 for total in (words.sum(), words @ weights))
    return data + struct.pack("<HH", low, high)


# ------------------------------------------------------------------------------------------ reading


@dataclass(frozen=True)
class Contents:
    """The limits of a file with what describes them; its fields stay on disk."""

    arrays: Arrays
    spec: str
    created_by: str
    filters: str
    tested: Mapping[str, int]
    has_fields: bool


TESTED: Final = ("tested_points", "tested_wrong", "tested_computed", "tested_undecided")
_HINT = "build it again, or get a fresh copy"


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open an atlas to read; ValueError in one sentence for whatever is wrong with it.

    OSError: it is missing or unreadable.
    """
    # What HDF5, h5py and their users raise at a file that is not as it should be.
    troubles = RefusalError, ValueError, LookupError, TypeError, ArithmeticError, RuntimeError
    signature = b"\x89HDF\r\n\x1a\n"
    with ExitStack() as stack:
        with named_errors("read", path):
            target_of(path)  # which refuses folders, devices and pipes
            stream = stack.enter_context(path.open("rb", buffering=0))
            start = stream.read(len(signature))
        if start != signature:
            raise ValueError(f"{path} is no atlas of jaxstab: it is not HDF5.")
        try:
            file = stack.enter_context(h5py.File(stream, "r"))
            _check_head(path, file)
            yield file
        except (MemoryError, SystemError):  # an extension raises this if no error can be made
            raise MemoryError(f"there is not enough memory to read {path}.") from None
        except _ForeignError:
            raise
        except (*troubles, OSError) as error:
            # libhdf5 raises the same errors for both, and where a filter fails in the same words.
            if "alloc" in str(error) or is_memory_short():
                raise MemoryError(f"there is not enough memory to read {path}.") from error
            words = f"{path} is damaged, or no atlas ({_word(error)}); {_HINT}."
            raise ValueError(words) from error


class _ForeignError(ValueError):
    """A sound file of another kind, which its sentence names."""


def _word(error: Exception) -> str:
    words = str(error).strip().splitlines()
    return words[0].strip("\"'.") if words else type(error).__name__


def _check_head(path: Path, file: h5py.File) -> None:
    if "format" not in file.attrs or text_of(file, "format") != FORMAT:
        raise _ForeignError(f"{path} is HDF5, but no atlas of jaxstab.")
    version = int(file.attrs["schema_version"])
    if version != SCHEMA_VERSION:
        raise _ForeignError(
            f"{path} has version {version} of the format, and this jaxstab reads "
            f"{SCHEMA_VERSION}; build it again."
        )


def text_of(holder: h5py.Group, name: str) -> str:
    """An attribute that is text of a moderate length, or RefusalError."""
    identifier = holder.attrs.get_id(name)
    check(identifier.shape == () and identifier.dtype.kind == "S", f"attribute {name}")
    check(identifier.dtype.itemsize <= _LONGEST_LINE, f"attribute {name}")
    return bytes(holder.attrs[name]).decode("utf-8")


def check(is_sound: Any, what: str) -> None:
    """Raise RefusalError for what is not as the format says."""
    if not is_sound:
        raise RefusalError(f"its {what} is not as the format says")


def read_limits(path: Path) -> Contents:
    """Read everything but the fields, checked; errors as ``opened``."""
    with opened(path) as file:
        arrays = read_all(file, LIMITS)
        lines = arrays["spec"].tolist()
        return Contents(
            # Without the numbers along axes, and the text.
            arrays={v.name: arrays[v.name] for v in LIMITS if v.dtype not in ("int32", "S")},
            spec="\n".join(line.decode("utf-8").rstrip() for line in lines) + "\n",
            created_by=text_of(file, "created_by"),
            filters=text_of(file, "filters"),
            tested={name: int(file.attrs[name]) for name in TESTED},
            has_fields=FIELDS in file,
        )


def read_fields(path: Path) -> dict[str, Array]:
    """Read the fields with their axes, checked; errors as ``opened``."""
    with opened(path) as file:
        return read_all(file[FIELDS], FIELD_VARIABLES)


def read_all(group: h5py.Group, variables: Sequence[StoredVariable]) -> dict[str, Array]:
    """Read variables of a group; RefusalError for one that is not as it should be."""
    datasets = {v.name: checked_dataset(group, v) for v in variables}
    lengths = {v.name: datasets[v.name].shape[0] for v in variables if v.is_axis}
    for variable in variables:
        check(datasets[variable.name].shape == _shape_of(variable, lengths), variable.name)
    if "end" in lengths:
        check(lengths["end"] == 2 and lengths["row"] >= 2, "row")
    return {v.name: _checked_values(v, datasets[v.name][()]) for v in variables}


def _shape_of(variable: StoredVariable, lengths: Mapping[str, int]) -> tuple[int, ...]:
    """The shape that lengths of axes demand; an axis of cells is as long as its nodes allow."""
    axes = [(own, own.removesuffix("_cell")) for own in variable.dimensions]
    return tuple(lengths[x] if own == x else max(lengths[x] - 1, 1) for own, x in axes)


def checked_dataset(group: h5py.Group, variable: StoredVariable) -> h5py.Dataset:
    """A dataset of the type and the storage of its variable, and of a size that memory holds."""
    most_filters = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32}
    largest_array = 2**31  # bytes that are read into memory at once
    name = variable.name
    check(isinstance(group.get(name, getlink=True), h5py.HardLink), name)
    dataset = group[name]
    check(isinstance(dataset, h5py.Dataset), name)
    layout = dataset.id.get_create_plist()
    check(layout.get_layout() == h5py.h5d.CHUNKED and layout.get_external_count() == 0, name)
    filters = {layout.get_filter(index)[0] for index in range(layout.get_nfilters())}
    allowed = most_filters if variable.is_packed else {h5py.h5z.FILTER_FLETCHER32}
    check(filters == allowed and len(dataset.shape) == len(variable.dimensions), name)
    is_text = variable.dtype == "S"
    kind = dataset.dtype.kind == "S" if is_text else dataset.dtype == np.dtype(variable.dtype)
    check(kind and dataset.dtype.itemsize <= _LONGEST_LINE and dataset.size > 0, name)
    size = dataset.size * dataset.dtype.itemsize
    if size > largest_array:
        raise RefusalError(
            f"{name} has {size} bytes, and at most {largest_array} are read into memory; read "
            "parts of it with h5py or xarray"
        )
    check(variable.is_packed or size <= dataset.id.get_storage_size(), name)
    return dataset


def _checked_values(variable: StoredVariable, values: Array) -> Array:
    """Return values, read-only, in the range of their variable."""
    ordered = "gamma", "delta", "delay", "row", "alpha", "beta"
    if variable.dtype != "S":
        known = values[~np.isnan(values)] if variable.has_nan else values
        check(np.all((known >= variable.lowest) & (known <= variable.highest)), variable.name)
        if variable.has_nan and variable.dtype == "float64":
            check(not np.any(np.isinf(values)), variable.name)
        if variable.name in ordered:
            steps = np.diff(values, axis=0)
            check(np.all(np.isfinite(values)) and np.all(steps > 0.0), variable.name)
        if variable.name == "row":
            even = np.linspace(0.0, 1.0, values.size)
            check(np.array_equal(values, even), variable.name)
    values.flags.writeable = False
    return values
