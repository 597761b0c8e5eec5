"""The table of an atlas file: where each chunk lies, so that a reader needs no HDF5. No JAX.

It is ASCII text after the HDF5 image, in three blocks with an empty line between them:

    jaxstab atlas 3
    made by PROGRAM
    filters WORDS on the velocity estimator and the position filter
    content SHA-256 of the second block with the end of its last line

    name dtype shape chunk digest digest ...         the lines of ``format.digest``

    name offset+size offset+size ...                 in bytes, of the same chunks in that order

A chunk is its values, shuffled and deflated where ``Variable.is_packed``, and their Fletcher32.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

import numpy as np

from jaxstab.atlas.format import schema
from jaxstab.atlas.format.schema import VARIABLES, Chunked, content_digest
from jaxstab.atlas.format.variables import CELL, LARGEST_SLICE, NODE, Variable
from jaxstab.atlas.products.table import PRODUCTS

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
Place = tuple[int, int]  # offset and size in bytes


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
    places: Sequence[Place]

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


@dataclass(frozen=True)
class Table:
    """The contents of a file: its variables by name, and what its head says."""

    variables: Mapping[str, Stored]
    created_by: str
    filters: str
    content_digest: str

    @property
    def lengths(self) -> dict[str, int]:
        """The lengths of the dimensions."""
        pairs = (zip(s.variable.dimensions, s.shape, strict=True) for s in self.variables.values())
        return dict(pair for variable in pairs for pair in variable)


def table_text(
    created_by: str,
    filters: str,
    variables: Sequence[Chunked],
    places: Mapping[str, Iterable[Place]],
) -> bytes:
    """Return the table of a file."""
    head = (
        f"{schema.FORMAT} {schema.SCHEMA_VERSION}\nmade by {created_by}\nfilters {filters}\n"
        f"content {content_digest(variables)}\n"
    )
    where = (
        " ".join([name, *(f"{offset}+{size}" for offset, size in chunks)])
        for name, chunks in places.items()
    )
    blocks = (head, "".join(f"{line}\n" for line in variables), "".join(f"{w}\n" for w in where))
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
    return Table({one.variable.name: one for one in stored}, *head.groups())


def _check_version(text: bytes) -> None:
    title = _TITLE.match(text)
    if title is None:
        raise RefusalError(
            f"has no table of schema version {schema.SCHEMA_VERSION}: it is not an atlas, or of an "
            "older jaxstab; build it again."
        )
    if int(title[1]) != schema.SCHEMA_VERSION:
        raise RefusalError(
            f"has schema version {int(title[1])}, and this jaxstab reads version "
            f"{schema.SCHEMA_VERSION}; use the jaxstab that wrote it, or build it again."
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
    check(all(part <= whole for part, whole in zip(chunk, shape, strict=True)))
    chunks = prod(-(-whole // part) for part, whole in zip(chunk, shape, strict=True))
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
        packed = size - schema.CHECKSUM_SIZE
        check(raw <= packed * schema.BEST_COMPRESSION if is_packed else raw == packed)


def _dtype(variable: Variable, word: str) -> np.dtype[Any]:
    if variable.dtype != "S":
        dtype = np.dtype(variable.dtype).newbyteorder("<")
        check(word == dtype.str)
        return dtype
    text = _TEXT.fullmatch(word)
    check(text and int(text[1]) <= schema.LONGEST_LINE)
    return np.dtype(word)


def _lengths(text: str) -> tuple[int, ...]:
    return tuple(map(int, text.split("x")))


def _places(text: str) -> list[Place]:
    places = [_PLACE.fullmatch(word) for word in text.split(" ")]
    check(all(places))
    return [(int(place[1]), int(place[2])) for place in places if place]


def _check_together(variables: Sequence[Stored], image_size: int) -> None:
    """Refuse variables that are not those of some products, or do not fit together or the file."""
    names = [one.variable.name for one in variables]
    chosen = [p for p in PRODUCTS.values() if not set(p.names).isdisjoint(names)]
    known = schema.ALWAYS.union(*(product.names for product in chosen))
    check(chosen and names == [name for name in VARIABLES if name in known])
    check(all(offset + size <= image_size for one in variables for offset, size in one.places))
    check(sum(one.stored_size for one in variables) <= image_size)
    lengths: dict[str, int] = {}
    for one in variables:
        for dimension, length in zip(one.variable.dimensions, one.shape, strict=True):
            check(lengths.setdefault(dimension, length) == length)
    for nodes, cells in zip(NODE[:4], CELL[:4], strict=True):
        check(lengths[cells] == max(lengths[nodes] - 1, 1))
    check(lengths["alpha_node"] > 1 and lengths["beta_node"] > 1)
    check(all(lengths[key] == n for product in chosen for key, n in product.lengths.items()))
