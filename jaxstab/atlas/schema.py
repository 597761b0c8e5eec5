"""The format of an atlas file, version 3: its variables, attributes, digest, footer and table.

A file is an HDF5 image, a table of its chunks and a footer that proves it complete. Every atlas has
axes and its specification, and the variables of the chosen products. NumPy alone.
"""

import errno
import hashlib
import io
import re
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import prod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.product import (
    AXIS_VARIABLES,
    CELL,
    FLAG_MEANINGS,
    FLAG_VALUES,
    LARGEST_SLICE,
    NODE,
    SPEC_VARIABLES,
    Variable,
)
from jaxstab.atlas.products.table import PRODUCTS

FORMAT: Final = "jaxstab atlas"
SCHEMA_VERSION: Final = 3
FOOTER_MAGIC: Final = b"jaxstab\n"

"""At the end: these 8 bytes, the length of the image (uint64, little endian), and the SHA-256 (32
bytes) of all that is before."""

CHECKSUM_SIZE: Final = 4  # bytes of Fletcher32 after the values of a chunk
BEST_COMPRESSION: Final = 1100  # deflate cannot do better than about 1032
LARGEST_EXPANSION: Final = 20  # of numbers, when they are more than the next
LONGEST_LINE: Final = 4096  # bytes in a line of the specification

VARIABLES: Final = {
    variable.name: variable
    for variable in (
        *AXIS_VARIABLES,
        *(variable for chosen in PRODUCTS.values() for variable in chosen.variables),
        *SPEC_VARIABLES,
    )
}

"""All variables in the order in which they are written; those of a product only if it is chosen."""

ALWAYS: Final = frozenset(variable.name for variable in (*AXIS_VARIABLES, *SPEC_VARIABLES))


# Attributes of a file and of its datasets, as text and numbers. No JAX.


def head_attributes(created_by: str, filters: str) -> dict[str, Any]:
    """Return the attributes of a file, without the digest of its values."""
    return {
        "format": FORMAT,
        "title": "Stability of a haptic rendering loop over its dimensionless parameters",
        "created_by": created_by,
        "source": "characteristic polynomial of Hulin, Preusche, Hirzinger (2008), eq. (9)",
        "symbols": "K, B stiffness and damping of the virtual wall; m, b, k mass, damping and "
        "stiffness of device and hand; T sampling period, t_d delay",
        "filters": filters,
        "Conventions": "CF-1.8",
        "schema_version": np.int32(SCHEMA_VERSION),
    }


def attributes_of(variable: Variable) -> dict[str, Any]:
    """Return the attributes of a dataset."""
    attributes: dict[str, Any] = {
        "long_name": variable.long_name,
        "interpretation": variable.interpretation,
    }
    if variable.dtype.startswith("float"):
        attributes["units"] = "1"
    if variable.dimensions == NODE:
        attributes["coordinates"] = "alpha beta"
    if variable.holds_verdicts:
        attributes["flag_values"] = np.array(FLAG_VALUES, np.int8)
        attributes["flag_meanings"] = FLAG_MEANINGS
    return attributes | dict(variable.attributes)


# A digest of the values of an atlas, the same for equal values on any machine. No JAX.
#
# The bytes of a file depend on the libraries that compressed it; its values do not. The digest is
# the SHA-256 of a line for each variable, in the order of the schema:
#
#     name, dtype, shape, shape of the chunks, and the SHA-256 of the values of each chunk
#
# with the chunks in the order of their places (the last dimension fastest), and the values of a
# chunk in that order too, little endian, and only those inside of the array.


def content_digest(lines: Iterable[str]) -> str:
    """Return the digest of the lines of all variables, in hexadecimal."""
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()


def values_digest(values: NDArray[Any]) -> str:
    """Return the SHA-256 of values, in hexadecimal."""
    ordered = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return hashlib.sha256(ordered.reshape(-1).view(np.uint8).data).hexdigest()


# The footer of a file, which shows that the file is complete. No JAX.

FOOTER = struct.Struct(f"<{len(FOOTER_MAGIC)}sQ32s")
_BLOCK = 2**18  # bytes, which stay in the cache


def footer_of(stream: io.FileIO | io.BytesIO, length: int, image_size: int) -> bytes:
    """The footer of the first ``length`` bytes of a stream; OSError if the stream is shorter."""
    stream.seek(0)
    digest, remaining, block = hashlib.sha256(), length, memoryview(bytearray(_BLOCK))
    while remaining:
        count = stream.readinto(block[:remaining])
        if not count:
            raise OSError(errno.EIO, f"the file ends {remaining} bytes early")
        digest.update(block[:count])
        remaining -= count
    return FOOTER.pack(FOOTER_MAGIC, image_size, digest.digest())


def image_size(stream: io.FileIO | io.BytesIO) -> int | None:
    """Return the length of the image in a stream; None where the footer is missing or wrong."""
    length = stream.seek(0, io.SEEK_END) - FOOTER.size
    if length < 0:
        return None
    stream.seek(length)
    footer = stream.read(FOOTER.size)
    size = int(FOOTER.unpack(footer)[1])
    is_right = size <= length and footer == footer_of(stream, length, size)
    return size if is_right else None


# The table of an atlas file: where each chunk lies, so that a reader needs no HDF5. No JAX.
#
# It is ASCII text after the HDF5 image, in three blocks with an empty line between them:
#
#     jaxstab atlas 3
#     made by PROGRAM
#     filters WORDS on the velocity estimator and the position filter
#     content SHA-256 of the second block with the end of its last line
#
#     name dtype shape chunk digest digest ...         the lines of the digest
#
#     name offset+size offset+size ...                 in bytes, of the same chunks in that order
#
# A chunk is its values, shuffled and deflated where ``Variable.is_packed``, and their Fletcher32.

_TITLE = re.compile(rb"jaxstab atlas (\d{1,9})\n")
_HEAD = re.compile(
    r"jaxstab atlas \d+\nmade by ([ -~]{1,200})\nfilters ([ -~]{1,4000})\ncontent ([0-9a-f]{64})"
)
_LENGTH = r"[1-9]\d{0,11}"
_SHAPE = rf"({_LENGTH}(?:x{_LENGTH}){{0,4}})"
_LINE = re.compile(rf"(\w{{1,40}}) (\S{{2,8}}) {_SHAPE} {_SHAPE} ([0-9a-f ]+)")
_WHERE = re.compile(r"(\w{1,40}) ([0-9+ ]+)")
_PLACE = re.compile(r"(\d{1,12})\+(\d{1,12})")
_TEXT = re.compile(r"\|S([1-9]\d{0,5})")
_DIGITS = 64  # of a digest
_MOST_LINES = 6 + 2 * len(VARIABLES)
Span = tuple[int, int]  # offset and size in bytes


class RefusalError(Exception):
    """Why a file is not read, without its name."""


DAMAGED = "is damaged, or no jaxstab atlas; build it again or copy it anew."


def check(condition: object) -> None:
    """Raise RefusalError, a file is not as the schema says, unless the condition holds."""
    if not condition:
        raise RefusalError(DAMAGED)


@dataclass(frozen=True)
class Stored:
    """A variable in a file: its type, its shape, and its chunks in their order."""

    variable: Variable
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    digests: Sequence[str]
    places: Sequence[Span] = ()

    @property
    def line(self) -> str:
        """The line of which the digest of the content is taken."""
        shapes = ("x".join(map(str, shape)) for shape in (self.shape, self.chunk))
        dtype = self.dtype.newbyteorder("<").str
        return " ".join([self.variable.name, dtype, *shapes, *self.digests])

    @property
    def size(self) -> int:
        """The bytes of all values."""
        return prod(self.shape) * self.dtype.itemsize

    @property
    def stored_size(self) -> int:
        """The bytes of all chunks in the file."""
        return sum(size for _, size in self.places)

    def starts(self) -> Iterator[tuple[int, ...]]:
        """Yield where each chunk begins in the array."""
        return product(*(range(0, n, step) for n, step in zip(self.shape, self.chunk, strict=True)))


def stored_of(name: str, dataset: Any, digests: Sequence[str] = ()) -> Stored:
    """An HDF5 dataset without the places of its chunks; digests not given are computed."""
    stored = Stored(VARIABLES[name], dataset.dtype, dataset.shape, dataset.chunks, digests)
    if digests:
        return stored
    # One chunk at a time is in memory.
    blocks = (tuple(map(slice, start, np.add(start, stored.chunk))) for start in stored.starts())
    return replace(stored, digests=[values_digest(dataset[block]) for block in blocks])


@dataclass(frozen=True)
class Table:
    """The contents of a file: its variables by name, and its head."""

    variables: Mapping[str, Stored]
    created_by: str
    filters: str
    content_digest: str

    @property
    def lengths(self) -> dict[str, int]:
        """The lengths of the dimensions."""
        pairs = (zip(s.variable.dimensions, s.shape, strict=True) for s in self.variables.values())
        return dict(pair for variable in pairs for pair in variable)


def table_text(created_by: str, filters: str, variables: Sequence[Stored]) -> bytes:
    """Return the table of a file."""
    lines = [variable.line for variable in variables]
    head = (
        f"{FORMAT} {SCHEMA_VERSION}\nmade by {created_by}\nfilters {filters}\n"
        f"content {content_digest(lines)}\n"
    )
    where = (
        " ".join([v.variable.name, *(f"{offset}+{size}" for offset, size in v.places)])
        for v in variables
    )
    blocks = (head, "".join(f"{line}\n" for line in lines), "".join(f"{w}\n" for w in where))
    return "\n".join(blocks).encode("ascii")


def read_table(text: bytes, image_size: int) -> Table:
    """The table of a file, checked, from the bytes between image and footer."""
    _check_version(text)
    check(text.isascii() and text.endswith(b"\n") and text.count(b"\n") <= _MOST_LINES)
    blocks = text.decode("ascii")[:-1].split("\n\n")
    head = _HEAD.fullmatch(blocks[0])
    if head is None or len(blocks) != 3:
        raise RefusalError(DAMAGED)
    lines, where = (block.split("\n") for block in blocks[1:])
    check(len(lines) == len(where) and content_digest(lines) == head[3])
    stored = [_stored(*pair) for pair in zip(lines, where, strict=True)]
    _check_together(stored, image_size)
    return Table({entry.variable.name: entry for entry in stored}, *head.groups())


def _check_version(text: bytes) -> None:
    title = _TITLE.match(text)
    if title is None:
        raise RefusalError(
            f"has no table of schema version {SCHEMA_VERSION}: it is not an atlas, or of an "
            "older jaxstab; build it again."
        )
    if int(title[1]) != SCHEMA_VERSION:
        raise RefusalError(
            f"has schema version {int(title[1])}, and this jaxstab reads version "
            f"{SCHEMA_VERSION}; use the jaxstab that wrote it, or build it again."
        )


def _stored(line: str, where: str) -> Stored:
    """Return a variable from its two lines, whose length grows with its chunks."""
    fields, places = _LINE.fullmatch(line), _WHERE.fullmatch(where)
    if fields is None or places is None:
        raise RefusalError(DAMAGED)
    name, dtype, shape, chunk = fields[1], fields[2], _lengths(fields[3]), _lengths(fields[4])
    check(name == places[1] and name in VARIABLES)
    variable = VARIABLES[name]
    check(len(shape) == len(chunk) == len(variable.dimensions))
    check(all(step <= n for step, n in zip(chunk, shape, strict=True)))
    chunks = prod(-(-n // step) for step, n in zip(chunk, shape, strict=True))
    check(chunks - 1 == fields[5].count(" ") == places[2].count(" "))
    digests = fields[5].split(" ")
    check(all(len(digest) == _DIGITS for digest in digests))
    stored = Stored(variable, _dtype(variable, dtype), shape, chunk, digests, _places(places[2]))
    _check_sizes(stored)
    return stored


def _check_sizes(stored: Stored) -> None:
    """Refuse chunks that are larger than those of a slice, or than their bytes can hold."""
    is_packed, values = stored.variable.is_packed, prod(stored.chunk)
    check(not is_packed or values <= LARGEST_SLICE)
    raw = values * stored.dtype.itemsize
    for _, size in stored.places:
        packed = size - CHECKSUM_SIZE
        check(raw <= packed * BEST_COMPRESSION if is_packed else raw == packed)


def _dtype(variable: Variable, word: str) -> np.dtype[Any]:
    if variable.dtype != "S":
        dtype = np.dtype(variable.dtype).newbyteorder("<")
        check(word == dtype.str)
        return dtype
    text = _TEXT.fullmatch(word)
    check(text and int(text[1]) <= LONGEST_LINE)
    return np.dtype(word)


def _lengths(text: str) -> tuple[int, ...]:
    return tuple(map(int, text.split("x")))


def _places(text: str) -> list[Span]:
    places = [_PLACE.fullmatch(word) for word in text.split(" ")]
    check(all(places))
    return [(int(place[1]), int(place[2])) for place in places if place]


def _check_together(variables: Sequence[Stored], image_size: int) -> None:
    """Refuse variables that are not those of some products, or do not fit together or the file."""
    names = [entry.variable.name for entry in variables]
    chosen = [p for p in PRODUCTS.values() if not set(p.names).isdisjoint(names)]
    allowed = ALWAYS.union(*(product.names for product in chosen))
    check(chosen and names == [name for name in VARIABLES if name in allowed])
    check(all(offset + size <= image_size for entry in variables for offset, size in entry.places))
    check(sum(entry.stored_size for entry in variables) <= image_size)
    lengths: dict[str, int] = {}
    for entry in variables:
        for dimension, length in zip(entry.variable.dimensions, entry.shape, strict=True):
            check(lengths.setdefault(dimension, length) == length)
    for nodes, cells in zip(NODE[:4], CELL[:4], strict=True):
        check(lengths[cells] == max(lengths[nodes] - 1, 1))
    check(lengths["alpha_node"] > 1 and lengths["beta_node"] > 1)
    check(all(lengths[key] == n for product in chosen for key, n in product.lengths.items()))
