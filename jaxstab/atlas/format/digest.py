"""A digest of what an atlas holds, the same for equal values on any machine. No JAX.

The bytes of a file depend on the libraries that compressed it; its values do not. The digest is the
SHA-256 of a line for each variable, in the order of the schema:

    name, dtype, shape, shape of the chunks, and the SHA-256 of the values of each chunk

with the chunks in the order of their places (the last dimension fastest), and the values of a chunk
in that order too, little endian, and only those inside of the array.
"""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


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
