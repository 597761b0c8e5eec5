"""Atlas files are read here, and nowhere else. No JAX, and no HDF5.

A file is checked against its footer before anything in it is read, its table against the schema
before memory is allocated, and its values against their digests and ranges before a query uses
them. It was published by an atomic rename. So a reader finds the old file, the new file or a
refusal in one sentence, whatever happened to the writer and the disk. The checked bytes stay in
memory, and the arrays are unpacked from them: later changes of the file change no answer.
"""

import io
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas import schema
from jaxstab.atlas.product import (
    LARGEST_ARRAY,
    LARGEST_UNASKED,
    LEAST_SHARE,
    LEAST_SPAN,
    NODE,
    SPEC,
    Variable,
)
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.schema import (
    FOOTER,
    VARIABLES,
    RefusalError,
    Stored,
    Table,
    check,
    image_size,
    read_table,
    values_digest,
)
from jaxstab.conventions import AXES
from jaxstab.durable import named_errors, target_of

# Arrays out of the chunks of a file, and whether their values may be. No JAX, and no HDF5.

Array = np.ndarray[Any, np.dtype[Any]]


class TooLargeError(ValueError):
    """A file is sound but larger than is read into memory."""


def unpacked(data: bytes, stored: Stored) -> Array:
    """An array, read-only, checked; memory is allocated only as far as the file has values."""
    _check_size(stored)
    values = np.empty(stored.shape, stored.dtype)
    for index, start in enumerate(stored.starts()):
        place = tuple(slice(i, i + n) for i, n in zip(start, stored.chunk, strict=True))
        values[place] = _inside(data, stored, index, start)
    check_values(stored.variable, values)
    values.flags.writeable = False
    return values


def _inside(data: bytes, stored: Stored, index: int, start: tuple[int, ...]) -> Array:
    """The values of a chunk inside of the array, checked by their digest."""
    offset, size = stored.places[index]
    chunk = _chunk(memoryview(data)[offset : offset + size - schema.CHECKSUM_SIZE], stored)
    inside = chunk[tuple(slice(n - i) for i, n in zip(start, stored.shape, strict=True))]
    check(values_digest(inside) == stored.digests[index])
    return inside


def _check_size(stored: Stored) -> None:
    """Refuse arrays too large to read whole, and large ones that hardly any bytes hold."""
    most = LARGEST_ARRAY
    if not stored.variable.holds_verdicts:
        expanded = schema.LARGEST_EXPANSION * stored.stored_size
        most = min(most, max(LARGEST_UNASKED, expanded))
    if stored.size > most:
        raise TooLargeError(too_large(stored.size, stored.variable.name, most))


def too_large(size: int, what: str, most: int) -> str:
    """The sentence that refuses an array of this size."""
    return (
        f"has {size} bytes of {what}, and at most {most} are read into memory; "
        "read parts of it with h5py or xarray."
    )


def _chunk(stored_bytes: memoryview, stored: Stored) -> Array:
    """The values of a chunk; one with more or fewer than its table says is refused."""
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
    """Refuse values out of the range of their variable."""
    if variable.dtype == "S":
        return
    if variable.has_nan:
        low, high = np.nanmin(values, initial=0.0), np.nanmax(values, initial=0.0)
    else:
        low, high = values.min(), values.max()  # NaN where one is
    check(variable.lowest <= low and high <= variable.highest)
    check(all(product.are_values(variable.name, values) for product in PRODUCTS.values()))


def check_axes(arrays: Mapping[str, Array]) -> None:
    """Refuse axes that do not ascend, or so little or so far that cells have no width."""
    for name, values in arrays.items():
        if name in AXES:
            with np.errstate(all="ignore"):
                widths = np.diff(values, axis=0)
            check(np.all(np.isfinite(values)) and np.all(widths > 0))
        elif VARIABLES[name].is_axis:
            check(np.array_equal(values, np.arange(values.size)))
    for product in PRODUCTS.values():
        if product.rows in arrays:
            _check_range(arrays[product.rows], arrays["delay"])
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
    check(np.all(spans >= np.maximum(LEAST_SPAN, LEAST_SHARE * largest)))
    check(spans.max() < np.inf)


def check_text(lines: Array) -> None:
    """Refuse lines of a specification that are no text."""
    try:
        b"\n".join(lines.tolist()).decode("utf-8")
    except UnicodeDecodeError:
        check(condition=False)


def check_together(arrays: Mapping[str, Array], table: Table) -> None:
    """Refuse arrays of a product that do not fit to each other."""
    lengths = table.lengths
    for product in PRODUCTS.values():
        check(product.fit_together(arrays, lengths))


# Where points are in a grid: the cells that they are in, and the nodes that they are. No JAX.

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class GridIndex:
    """Where points are in a grid: index arrays, one for each axis."""

    cell: tuple[Integers, ...]  # nodes[cell] <= point <= nodes[cell + 1]
    node: tuple[Integers, ...]  # the node, where the point is one
    at_node: Mask

    @classmethod
    def from_axes(cls, axes: Sequence[tuple[Floats, Floats]]) -> "GridIndex":
        """Find points along each axis, given as its nodes and the points' coordinates."""
        cells, node, at_node = [], [], np.ones(axes[0][1].shape, bool)
        for nodes, points in axes:
            cells_along = max(nodes.size - 1, 1)
            cell = np.clip(np.searchsorted(nodes, points, side="right") - 1, 0, cells_along - 1)
            lower, upper = nodes[cell], nodes[np.minimum(cell + 1, nodes.size - 1)]
            cells.append(cell)
            node.append(cell + ((points == upper) & (upper > lower)))
            at_node &= (points == lower) | (points == upper)
        return cls(tuple(cells), tuple(node), at_node)


@dataclass(frozen=True, eq=False)
class PackedArrays(Mapping[str, Array]):
    """The arrays of a file by name; those over nodes and cells are unpacked at their first use.

    Verdict codes compress a thousandfold, so those that would fill the memory are unpacked chunk by
    chunk for each query (``codes_at``, ``blocks``). ValueError for an array that is damaged,
    TooLargeError for one that is larger than is read whole.
    """

    path: Path
    data: bytes = field(repr=False)
    table: Table = field(repr=False)
    _unpacked: dict[str, Array] = field(init=False, repr=False, default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        if name not in self._unpacked:
            stored = self.table.variables[name]
            with _told_of(self.path):
                # Threads that meet here unpack the same values, and continue with one of them.
                values = unpacked(self.data, stored)
                check_together({name: values}, self.table)
                self._unpacked.setdefault(name, values)
        return self._unpacked[name]

    def codes_at(self, name: str, place: Sequence[Integers]) -> Array:
        """Return the verdict codes at points, given as index arrays along all axes."""
        stored = self.table.variables[name]
        if stored.size <= LARGEST_UNASKED:
            codes: Array = self[name][tuple(place)]
            return codes
        along = [index // step for index, step in zip(place, stored.chunk, strict=True)]
        counts = [-(-n // step) for n, step in zip(stored.shape, stored.chunk, strict=True)]
        chunk = np.ravel_multi_index(tuple(along), counts)
        codes = np.empty(chunk.shape, stored.dtype)
        for k in np.unique(chunk).tolist():
            here = np.flatnonzero(chunk == k)
            start, values = self._block(name, k)
            inside = (index[here] - begin for index, begin in zip(place, start, strict=True))
            codes[here] = values[tuple(inside)]
        return codes

    def blocks(self, name: str, delay: int) -> Iterator[tuple[tuple[int, ...], Array]]:
        """Yield where the chunks of verdict codes at one delay begin, and their codes."""
        for index, start in enumerate(self.table.variables[name].starts()):
            if start[-1] == delay:
                yield self._block(name, index)

    def _block(self, name: str, index: int) -> tuple[tuple[int, ...], Array]:
        """The start of a chunk, and its values inside of the array."""
        with _told_of(self.path):
            stored = self.table.variables[name]
            start = next(islice(stored.starts(), index, None))
            values = _inside(self.data, stored, index, start)
            check_values(stored.variable, values)
            return start, values

    def __contains__(self, name: object) -> bool:
        return name in self.table.variables

    def __iter__(self) -> Iterator[str]:
        return iter(self.table.variables)

    def __len__(self) -> int:
        return len(self.table.variables)


def read(path: Path) -> PackedArrays:
    """The arrays of a file; all of its bytes are checked, and in memory.

    OSError: it is missing or unreadable; ValueError: it is foreign, truncated, damaged or of
    another version of the schema; TooLargeError: it is larger than is read whole.
    """
    return contents_of(path, _bytes_of(path))


def contents_of(path: Path, data: bytes) -> PackedArrays:
    """The arrays of the bytes of a file, after the checks of ``read``."""
    with _told_of(path):
        table = table_in(io.BytesIO(data))
    arrays = PackedArrays(path, data, table)
    plain = {
        name: arrays[name]
        for name, stored in table.variables.items()
        if not stored.variable.is_packed and stored.size <= LARGEST_ARRAY
    }
    with _told_of(path):
        check_axes(plain)
        check_together(plain, table)
        check_text(plain[SPEC])
    return arrays


def table_of(path: Path) -> Table:
    """The table of a file that may be larger than the memory; errors as ``read``."""
    with (
        named_errors("read", path),
        _opened(path) as stream,
        _told_of(path),
    ):
        return table_in(stream)


def node_count(path: Path) -> int:
    """The number of nodes of an atlas, without a look at its values; errors as ``table_of``."""
    variables = table_of(path).variables
    return prod(variables[dimension].shape[0] for dimension in NODE)


def _bytes_of(path: Path) -> bytes:
    with named_errors("read", path), _opened(path) as stream:
        size = stream.seek(0, io.SEEK_END)
        if size > LARGEST_ARRAY:
            raise TooLargeError(f"{path} {too_large(size, 'file', LARGEST_ARRAY)}")
        stream.seek(0)
        return stream.readall()


def _opened(path: Path) -> io.FileIO:
    """Open a regular file; others are refused without waiting."""
    target_of(path)
    return path.open("rb", buffering=0)


def table_in(stream: io.FileIO | io.BytesIO) -> Table:
    """Return the table of a whole file, all bytes of which are checked."""
    size = image_size(stream)
    check(size is not None)
    stream.seek(size or 0)
    return read_table(stream.read()[: -FOOTER.size], size or 0)


@contextmanager
def _told_of(path: Path) -> Iterator[None]:
    """Put the name of the file in front of a refusal."""
    try:
        yield
    except TooLargeError as refusal:
        raise TooLargeError(f"{path} {refusal}") from None
    except RefusalError as refusal:
        raise ValueError(f"{path} {refusal}") from None
    except MemoryError as error:
        raise MemoryError(f"{path} does not fit into memory.") from error
