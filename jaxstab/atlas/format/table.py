"""The table of an atlas file: where each chunk lies, so that a reader needs no HDF5. No JAX.

It is ASCII text after the HDF5 image, in three blocks with an empty line between them:

    jaxstab atlas 4
    made by PROGRAM
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
from jaxstab.atlas.format.digest import Chunked, content_digest
from jaxstab.atlas.format.schema import VARIABLES, Variable

_TITLE = re.compile(rb"jaxstab atlas (\d{1,9})\n")
_HEAD = re.compile(r"jaxstab atlas \d+\nmade by ([ -~]{1,200})\ncontent ([0-9a-f]{64})")
_LENGTH = re.compile(r"[1-9]\d{0,11}|0")
_DIGEST = re.compile(r"[0-9a-f]{64}")

Place = tuple[int, int]  # offset and size in bytes


class RefusalError(Exception):
    """Why a file is not read, without its name."""


DAMAGED = "is damaged, or no jaxstab atlas; build it again or copy it anew."


def check(condition: object) -> None:
    """Refuse a file that is not as the schema says.

    Raises:
        RefusalError: the condition does not hold.
    """
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
    """What a file holds: its variables by name, who made it, and the digest of its values."""

    variables: Mapping[str, Stored]
    created_by: str
    content_digest: str


def table_text(
    created_by: str, variables: Sequence[Chunked], places: Mapping[str, Iterable[Place]]
) -> bytes:
    """Return the table of a file."""
    head = (
        f"{schema.FORMAT} {schema.SCHEMA_VERSION}\nmade by {created_by}\n"
        f"content {content_digest(variables)}\n"
    )
    where = (
        " ".join([name, *(f"{offset}+{size}" for offset, size in chunks)])
        for name, chunks in places.items()
    )
    blocks = (head, "".join(f"{line}\n" for line in variables), "".join(f"{w}\n" for w in where))
    return "\n".join(blocks).encode("ascii")


def read_table(text: bytes, image_size: int) -> Table:
    """Return the table of a file after a look at all that it promises.

    Args:
        text: the bytes between image and footer.
        image_size: in bytes.

    Raises:
        RefusalError: it is not as the schema says, or of another version of it.
    """
    _check_version(text)
    check(text.isascii() and text.endswith(b"\n"))
    blocks = text.decode("ascii")[:-1].split("\n\n")
    head = _HEAD.fullmatch(blocks[0])
    if head is None or len(blocks) != 3:
        raise RefusalError(DAMAGED)
    shapes, places = (block.split("\n") for block in blocks[1:])
    check(len(shapes) == len(places) and content_digest(shapes) == head[2])
    stored = [_stored(*lines) for lines in zip(shapes, places, strict=True)]
    _check_together(stored, image_size)
    return Table({one.variable.name: one for one in stored}, head[1], head[2])


def _check_version(text: bytes) -> None:
    """Refuse what has no table, or one of another version."""
    found = _TITLE.match(text)
    if found is None:
        raise RefusalError(
            f"has no table of schema version {schema.SCHEMA_VERSION}: it is no atlas, or of an "
            "older jaxstab; build it again."
        )
    if int(found[1]) != schema.SCHEMA_VERSION:
        raise RefusalError(
            f"has schema version {int(found[1])}, and this jaxstab reads version "
            f"{schema.SCHEMA_VERSION}; use the jaxstab that wrote it, or build it again."
        )


def _stored(shapes: str, places: str) -> Stored:
    """Return what two lines say of a variable."""
    name, *words = shapes.split(" ")
    again, *where = places.split(" ")
    check(name == again and name in VARIABLES and len(words) > 3)
    variable = VARIABLES[name]
    shape, chunk = _numbers(words[1], "x"), _numbers(words[2], "x")
    check(len(shape) == len(chunk) == len(variable.dimensions))
    check(all(0 < part <= whole for part, whole in zip(chunk, shape, strict=True)))
    chunks = prod(-(-whole // part) for part, whole in zip(chunk, shape, strict=True))
    check(chunks == len(words) - 3 == len(where))
    check(all(map(_DIGEST.fullmatch, words[3:])))
    stored = Stored(variable, _dtype(variable, words[0]), shape, chunk, words[3:], _places(where))
    check(not variable.is_packed or prod(chunk) <= schema.LARGEST_SLICE)
    raw = prod(chunk) * stored.dtype.itemsize
    for _, size in stored.places:
        values = size - schema.CHECKSUM_SIZE
        fits = 0 < raw <= values * schema.BEST_COMPRESSION if variable.is_packed else values == raw
        check(fits)
    return stored


def _dtype(variable: Variable, word: str) -> np.dtype[Any]:
    if variable.dtype != "S":
        dtype = np.dtype(variable.dtype).newbyteorder("<")
        check(word == dtype.str)
        return dtype
    check(word.startswith("|S") and _LENGTH.fullmatch(word[2:]))
    check(0 < int(word[2:]) <= schema.LONGEST_LINE)
    return np.dtype(word)


def _numbers(text: str, mark: str) -> tuple[int, ...]:
    words = text.split(mark)
    check(all(map(_LENGTH.fullmatch, words)))
    return tuple(map(int, words))


def _places(words: Sequence[str]) -> list[Place]:
    places = []
    for word in words:
        numbers = _numbers(word, "+")
        check(len(numbers) == 2)
        places.append((numbers[0], numbers[1]))
    return places


def _check_together(variables: Sequence[Stored], image_size: int) -> None:
    """Refuse variables that are not those of some products, or do not fit together or the file."""
    names = [one.variable.name for one in variables]
    chosen = [held for held in schema.PRODUCTS.values() if not set(held).isdisjoint(names)]
    known = schema.ALWAYS.union(*chosen)
    check(chosen and names == [name for name in VARIABLES if name in known])
    check(all(offset + size <= image_size for one in variables for offset, size in one.places))
    check(sum(one.stored_size for one in variables) <= image_size)
    lengths: dict[str, int] = {}
    for one in variables:
        for dimension, length in zip(one.variable.dimensions, one.shape, strict=True):
            check(lengths.setdefault(dimension, length) == length)
    for nodes, cells in zip(schema.NODE[:4], schema.CELL[:4], strict=True):
        check(lengths[cells] == max(lengths[nodes] - 1, 1))
    check(lengths["alpha_node"] > 1 and lengths["beta_node"] > 1)
    check(lengths.get("limit_term", 10) == 10)
