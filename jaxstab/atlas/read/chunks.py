"""Arrays out of the chunks of a file, and whether their values may be. No JAX, and no HDF5."""

import zlib
from collections.abc import Mapping
from itertools import islice
from math import prod
from typing import Any

import numpy as np

from jaxstab.atlas.format import schema
from jaxstab.atlas.format.digest import values_digest
from jaxstab.atlas.format.schema import VARIABLES, Variable
from jaxstab.atlas.format.table import Stored, Table, check
from jaxstab.conventions import AXES

Array = np.ndarray[Any, np.dtype[Any]]


class TooLargeError(ValueError):
    """A file is sound but larger than is read into memory."""


def unpacked(data: bytes, stored: Stored) -> Array:
    """Return an array, read-only; memory is asked for only as far as the file has values.

    Raises:
        RefusalError: a chunk is not what its digest says, or values are out of their range.
        TooLargeError: the array is larger than is read into memory.
    """
    _check_size(stored)
    values = np.empty(stored.shape, stored.dtype)
    for number, start in enumerate(stored.starts()):
        place = tuple(slice(i, i + n) for i, n in zip(start, stored.chunk, strict=True))
        values[place] = _inside(data, stored, number, start)
    check_values(stored.variable, values)
    values.flags.writeable = False
    return values


def unpacked_chunk(data: bytes, stored: Stored, number: int) -> tuple[tuple[int, ...], Array]:
    """Return where a chunk begins, and its values inside of the array.

    Raises:
        RefusalError: as ``unpacked``.
    """
    start = next(islice(stored.starts(), number, None))
    values = _inside(data, stored, number, start)
    check_values(stored.variable, values)
    return start, values


def _inside(data: bytes, stored: Stored, number: int, start: tuple[int, ...]) -> Array:
    """Return the values of a chunk inside of the array, which are what their digest says."""
    offset, size = stored.places[number]
    chunk = _chunk(memoryview(data)[offset : offset + size - schema.CHECKSUM_SIZE], stored)
    inside = chunk[tuple(slice(n - i) for i, n in zip(start, stored.shape, strict=True))]
    check(values_digest(inside) == stored.digests[number])
    return inside


def _check_size(stored: Stored) -> None:
    """Refuse what is not read whole, and numbers that hardly anything in the file stands for."""
    most = schema.LARGEST_ARRAY
    if not stored.variable.holds_verdicts:
        expanded = schema.LARGEST_EXPANSION * stored.stored_size
        most = min(most, max(schema.LARGEST_UNASKED, expanded))
    if stored.size > most:
        raise TooLargeError(too_large(stored.size, stored.variable.name, most))


def too_large(size: int, what: str, most: int) -> str:
    """Return the sentence that refuses so many bytes."""
    return (
        f"has {size} bytes of {what}, and at most {most} are read into memory; "
        "read parts of it with h5py or xarray."
    )


def _chunk(stored_bytes: memoryview, stored: Stored) -> Array:
    """Return the values of a chunk; one that has more or fewer than it promised is refused."""
    dtype, count = stored.dtype, prod(stored.chunk)
    if not stored.variable.is_packed:
        return np.frombuffer(stored_bytes, dtype).reshape(stored.chunk)
    engine = zlib.decompressobj()
    try:
        shuffled = engine.decompress(stored_bytes, count * dtype.itemsize)
        is_whole = (engine.eof or not engine.decompress(engine.unconsumed_tail, 1)) and engine.eof
    except zlib.error as error:
        if str(error).startswith("Error -4 "):
            raise MemoryError from error
        is_whole, shuffled = False, b""
    check(is_whole and not engine.unused_data and len(shuffled) == count * dtype.itemsize)
    planes = np.frombuffer(shuffled, np.uint8).reshape(dtype.itemsize, count)
    return np.ascontiguousarray(planes.T).view(dtype).reshape(stored.chunk)


def check_values(variable: Variable, values: Array) -> None:
    """Refuse values out of the range of their variable.

    Raises:
        RefusalError: as it says.
    """
    if variable.dtype == "S":
        return
    if variable.has_nan:
        low, high = (f.reduce(values, axis=None, initial=0.0) for f in (np.fmin, np.fmax))
    else:
        low, high = values.min(), values.max()  # NaN where one is
    check(variable.lowest <= low and high <= variable.highest)
    if variable.name == schema.ALPHA_LIMITS:
        for limit in np.split(values, 2, axis=-1):
            slopes, error = limit[..., 1:-1], limit[..., -1]
            check(np.all(np.isfinite(slopes)) and error.min() >= 0.0)
    if variable.name == schema.RADIUS_TERMS:
        check(np.all(np.isfinite(values[:-1])) and values[-1].min() >= 0.0)


def check_axes(arrays: Mapping[str, Array]) -> None:
    """Refuse axes that do not ascend, or so little or so far that cells have no width.

    Raises:
        RefusalError: as it says.
    """
    for name, values in arrays.items():
        if name in AXES:
            with np.errstate(all="ignore"):
                widths = np.diff(values, axis=0)
            check(np.all(np.isfinite(values)) and np.all(widths > 0))
        elif VARIABLES[name].is_axis:
            check(np.array_equal(values, np.arange(values.size)))
    for name in (schema.LIMIT_RANGE, schema.RADIUS_RANGE):
        if name in arrays:
            _check_range(arrays[name], arrays["delay"])
    for name in ("alpha", "beta"):
        _check_spans(arrays[name][0], arrays[name][-1])


def _check_range(ends: Array, delay: Array) -> None:
    """Refuse cells of delays that do not follow each other to the last, and ends without width."""
    early, late = ends[:, 0], ends[:, 1]
    check(np.all(np.isfinite(ends)) and early[0] == delay[0] and late[-1] == delay[-1])
    check(np.all(early <= late) and np.all(late[:-1] <= early[1:]) and np.all(np.diff(early) > 0.0))
    _check_spans(ends[:, 2::2], ends[:, 3::2])


def _check_spans(low: Array, high: Array) -> None:
    """Refuse spans that overflow, and those so narrow that rounding swallows their cells."""
    with np.errstate(all="ignore"):
        spans, largest = high - low, np.maximum(np.abs(low), np.abs(high))
    check(np.all(spans >= np.maximum(schema.LEAST_SPAN, schema.LEAST_SHARE * largest)))
    check(spans.max() < np.inf)


def check_text(lines: Array) -> None:
    """Refuse lines of a specification that are no text.

    Raises:
        RefusalError: as it says.
    """
    try:
        b"\n".join(lines.tolist()).decode("utf-8")
    except UnicodeDecodeError:
        check(condition=False)


def check_counts(arrays: Mapping[str, Array], table: Table) -> None:
    """Refuse lists that are not as long as their parts together.

    Raises:
        RefusalError: as it says.
    """
    for counts, dimension in schema.STRUNG.items():
        if counts in arrays:
            check(int(arrays[counts].sum(dtype=np.int64)) == table.variables[dimension].shape[0])


def check_functions(kinds: Array, table: Table) -> None:
    """Refuse other numbers of functions of radii than the kinds of the cells say.

    Raises:
        RefusalError: as it says.
    """
    counts = np.bincount(kinds.reshape(-1), minlength=len(schema.RADIUS_FUNCTIONS))
    functions = int(counts @ np.array(schema.RADIUS_FUNCTIONS))
    check(functions == table.variables[schema.RADIUS_TERMS].shape[-1])
