"""Atlas files are read here, and nowhere else. No JAX, and no HDF5.

A file is checked against its footer before anything in it is looked at, its table against the
schema before memory is asked for, and its values against their digests and ranges before a question
sees them. It was published by an atomic rename. So a reader meets the old file, the new file or a
refusal in one sentence, whatever happened to writer and disk. The bytes that were checked stay in
memory, and the arrays are unpacked from them: what becomes of the file later changes no answer.
"""

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np

from jaxstab.atlas.format import schema
from jaxstab.atlas.format.footer import FOOTER, image_size
from jaxstab.atlas.format.table import RefusalError, Table, check, read_table
from jaxstab.atlas.read.cells import Integers
from jaxstab.atlas.read.chunks import (
    Array,
    TooLargeError,
    check_axes,
    check_counts,
    check_functions,
    check_text,
    too_large,
    unpacked,
    unpacked_chunk,
)
from jaxstab.durable import named_errors, target_of


@dataclass(frozen=True)
class Contents:
    """What an atlas file holds: arrays by the names of the schema, who made it, for which loop."""

    arrays: Mapping[str, Array]
    created_by: str
    filters: str


class PackedArrays(Mapping[str, Array]):
    """The arrays of a file; those over nodes and cells are unpacked when they are first asked for.

    Verdict codes compress a thousandfold, so those that would fill the memory are unpacked chunk by
    chunk for each question (``codes_at``, ``blocks``).

    Args:
        path: of the file, for what is said of it.
        data: all of its bytes, found right.
        table: of its chunks.

    Raises:
        ValueError: an array that is asked for is not what its digest says, or out of its range.
        TooLargeError: it is larger than is read whole.
    """

    def __init__(self, path: Path, data: bytes, table: Table) -> None:
        self._path, self._data, self._table = path, data, table
        self._unpacked: dict[str, Array] = {}

    def __getitem__(self, name: str) -> Array:
        if name not in self._unpacked:
            stored = self._table.variables[name]
            with _told_of(self._path):
                # Threads that meet here unpack the same values, and go on with one of them.
                values = unpacked(self._data, stored)
                if name == schema.RADIUS_KIND:
                    check_functions(values, self._table)
                self._unpacked.setdefault(name, values)
        return self._unpacked[name]

    def codes_at(self, name: str, place: Sequence[Integers]) -> Array:
        """Return the verdict codes at points, given as index arrays along all axes."""
        stored = self._table.variables[name]
        if stored.size <= schema.LARGEST_UNASKED:
            codes: Array = self[name][tuple(place)]
            return codes
        along = [index // step for index, step in zip(place, stored.chunk, strict=True)]
        counts = [-(-n // step) for n, step in zip(stored.shape, stored.chunk, strict=True)]
        chunk = np.ravel_multi_index(tuple(along), counts)
        codes = np.empty(chunk.shape, stored.dtype)
        for number in np.unique(chunk).tolist():
            here = np.flatnonzero(chunk == number)
            start, values = self._block(name, number)
            inside = (index[here] - first for index, first in zip(place, start, strict=True))
            codes[here] = values[tuple(inside)]
        return codes

    def blocks(self, name: str, delay: int) -> Iterator[tuple[tuple[int, ...], Array]]:
        """Yield where the chunks of verdict codes at one delay begin, and their codes."""
        for number, start in enumerate(self._table.variables[name].starts()):
            if start[-1] == delay:
                yield self._block(name, number)

    def _block(self, name: str, number: int) -> tuple[tuple[int, ...], Array]:
        with _told_of(self._path):
            return unpacked_chunk(self._data, self._table.variables[name], number)

    def __contains__(self, name: object) -> bool:
        return name in self._table.variables

    def __iter__(self) -> Iterator[str]:
        return iter(self._table.variables)

    def __len__(self) -> int:
        return len(self._table.variables)


def read(path: Path) -> Contents:
    """Return what the file holds; all of its bytes are checked, and in memory.

    Raises:
        OSError: the file is missing or unreadable.
        ValueError: it is foreign, truncated, damaged or of another version of the schema.
        TooLargeError: it is larger than is read whole.
    """
    return contents_of(path, _bytes_of(path))


def contents_of(path: Path, data: bytes) -> Contents:
    """Return what the bytes of a file hold, after the checks of ``read``.

    Raises:
        ValueError: as ``read``.
    """
    with _told_of(path):
        table = table_in(io.BytesIO(data))
    arrays = PackedArrays(path, data, table)
    plain = {
        name: arrays[name]
        for name, stored in table.variables.items()
        if not stored.variable.is_packed and stored.size <= schema.LARGEST_ARRAY
    }
    with _told_of(path):
        check_axes(plain)
        check_counts(plain, table)
        check_text(plain[schema.SPEC])
    return Contents(arrays, table.created_by, table.filters)


def table_of(path: Path) -> Table:
    """Return the table of a file that may be larger than the memory; all of its bytes are checked.

    Raises:
        OSError: the file is missing or unreadable.
        ValueError: it is foreign, truncated, damaged or of another version of the schema.
    """
    with (
        named_errors("read", path),
        _opened(path) as stream,
        _told_of(path),
    ):
        return table_in(stream)


def node_count(path: Path) -> int:
    """Return how many nodes an atlas has, without a look at its values.

    Raises:
        OSError, ValueError: as ``table_of``.
    """
    variables = table_of(path).variables
    return prod(variables[dimension].shape[0] for dimension in schema.NODE)


def _bytes_of(path: Path) -> bytes:
    with named_errors("read", path), _opened(path) as stream:
        size = stream.seek(0, io.SEEK_END)
        if size > schema.LARGEST_ARRAY:
            raise TooLargeError(f"{path} {too_large(size, 'file', schema.LARGEST_ARRAY)}")
        stream.seek(0)
        return stream.readall()


def _opened(path: Path) -> io.FileIO:
    """Open a file; what is none is refused before it is waited for."""
    target_of(path)
    return path.open("rb", buffering=0)


def table_in(stream: io.FileIO | io.BytesIO) -> Table:
    """Return the table of a whole file, all bytes of which are checked.

    Raises:
        RefusalError: as ``table_of`` refuses with a ValueError.
    """
    size = image_size(stream)
    check(size is not None)
    stream.seek(size or 0)
    return read_table(stream.read()[: -FOOTER.size], size or 0)


@contextmanager
def _told_of(path: Path) -> Iterator[None]:
    """Tell of a refusal as of this file."""
    try:
        yield
    except TooLargeError as refusal:
        raise TooLargeError(f"{path} {refusal}") from None
    except RefusalError as refusal:
        raise ValueError(f"{path} {refusal}") from None
    except MemoryError as error:
        raise MemoryError(f"{path} does not fit into memory.") from error
