"""The format of an atlas file, version 3: its variables, attributes, digest and footer.

A file is an HDF5 image, a table of its chunks (``format.table``) and a footer by which a reader
knows that all of it is there. Every atlas has axes and its specification; what else it has are the
variables of the products that were chosen. NumPy alone.
"""

import errno
import hashlib
import io
import struct
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format.variables import (
    AXIS_VARIABLES,
    FLAG_MEANINGS,
    FLAG_VALUES,
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


# A digest of what an atlas holds, the same for equal values on any machine. No JAX.
#
# The bytes of a file depend on the libraries that compressed it; its values do not. The digest is
# the SHA-256 of a line for each variable, in the order of the schema:
#
#     name, dtype, shape, shape of the chunks, and the SHA-256 of the values of each chunk
#
# with the chunks in the order of their places (the last dimension fastest), and the values of a
# chunk in that order too, little endian, and only those inside of the array.


class Chunked(NamedTuple):
    """A variable as the digest sees it."""

    name: str
    dtype: np.dtype[Any]
    shape: Sequence[int]
    chunk: Sequence[int]
    digests: Iterable[str]

    def __str__(self) -> str:
        shapes = ("x".join(map(str, shape)) for shape in (self.shape, self.chunk))
        dtype = self.dtype.newbyteorder("<").str
        return " ".join([self.name, dtype, *shapes, *self.digests])


def content_digest(variables: Iterable[Chunked | str]) -> str:
    """Return the digest of all variables, or of their lines, in hexadecimal."""
    digest = hashlib.sha256()
    for variable in variables:
        digest.update(f"{variable}\n".encode())
    return digest.hexdigest()


def values_digest(values: NDArray[Any]) -> str:
    """Return the SHA-256 of values, in hexadecimal."""
    ordered = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return hashlib.sha256(ordered.reshape(-1).view(np.uint8).data).hexdigest()


def chunk_digests(dataset: Any) -> Iterator[str]:
    """Yield the digest of each chunk of an HDF5 dataset, with one chunk at a time in memory."""
    starts = [range(0, n, step) for n, step in zip(dataset.shape, dataset.chunks, strict=True)]
    for place in product(*starts):
        inside = zip(place, dataset.chunks, strict=True)
        yield values_digest(dataset[tuple(slice(start, start + step) for start, step in inside)])


def digest_of(name: str, dataset: Any) -> Chunked:
    """Return an HDF5 dataset as the digest sees it; its values are read when they are needed."""
    return Chunked(name, dataset.dtype, dataset.shape, dataset.chunks, chunk_digests(dataset))


# The footer of a file, by which a reader knows that all of it is there. No JAX.

FOOTER = struct.Struct(f"<{len(FOOTER_MAGIC)}sQ32s")
_BLOCK = 2**18  # bytes, which stay in the cache


def footer_of(stream: io.FileIO | io.BytesIO, length: int, image_size: int) -> bytes:
    """The footer of the first ``length`` bytes of a stream; OSError if the stream is shorter."""
    stream.seek(0)
    digest, rest, block = hashlib.sha256(), length, memoryview(bytearray(_BLOCK))
    while rest:
        count = stream.readinto(block[:rest])
        if not count:
            raise OSError(errno.EIO, f"the file ends {rest} bytes early")
        digest.update(block[:count])
        rest -= count
    return FOOTER.pack(FOOTER_MAGIC, image_size, digest.digest())


def sealed(image: bytes, table: bytes = b"") -> bytes:
    """Return an image, and perhaps a table, with their footer."""
    data = image + table
    return data + footer_of(io.BytesIO(data), len(data), len(image))


def image_of(data: bytes) -> bytes | None:
    """Return the image if the footer is right."""
    size = image_size(io.BytesIO(data))
    return None if size is None else data[:size]


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
