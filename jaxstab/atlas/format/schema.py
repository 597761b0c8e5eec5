"""The format of an atlas file: every name, meaning, code and limit in one place.

Standard library only. A file holds one HDF5 image, a table of its chunks (``format.table``) and a
footer; the image holds the variables below in its root group, with dimension scales. All numbers
are dimensionless. What a file may hold is written here once: the readers refuse the rest.
"""

import errno
import hashlib
import io
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format import schema
from jaxstab.conventions import Verdict

FORMAT: Final = "jaxstab atlas"

SCHEMA_VERSION: Final = 3

FOOTER_MAGIC: Final = b"jaxstab\n"

"""At the end: these 8 bytes, the length of the image (uint64, little endian), and the SHA-256 (32
bytes) of all that is before."""

CHECKSUM_SIZE: Final = 4  # bytes of Fletcher32 after the values of a chunk

BEST_COMPRESSION: Final = 1100  # deflate cannot do better than about 1032

LARGEST_EXPANSION: Final = 20  # of numbers, when they are more than the next

LARGEST_UNASKED: Final = 2 * 10**8  # bytes

LARGEST_ARRAY: Final = 2**31  # bytes that are read into memory at once

LARGEST_ATLAS: Final = 2**38  # nodes

LARGEST_SLICE: Final = 2**22  # nodes along alpha and beta

LARGEST_DELAY: Final = 100.0

LEAST_SPAN: Final = 1e-300  # of alpha and beta: cells to it do not overflow

LEAST_SHARE: Final = 2.0**-24  # of the larger of its ends: rounding swallows no cell of a span

VERDICT: Final = "verdict"

CELL_VERDICT: Final = "cell_verdict"

ALPHA_LIMITS: Final = "alpha_limits"

LIMIT_RANGE: Final = "limit_range"

LIMIT_WHOLE: Final = "limit_whole"

WHOLE_ALPHA: Final = 1

WHOLE_BOTH: Final = 2

SPECTRAL_RADIUS: Final = "spectral_radius"

RADIUS_RANGE: Final = "radius_range"

RADIUS_KIND: Final = "radius_kind"

RADIUS_TERMS: Final = "radius_terms"

RADIUS_ROW: Final = "radius_row"

OUTLINE_ALPHA: Final = "outline_alpha"

OUTLINE_BETA: Final = "outline_beta"

OUTLINE_BRANCH: Final = "outline_branch"

OUTLINE_SIZE: Final = "outline_size"

OUTLINE_STATUS: Final = "outline_status"

CORNER_ALPHA: Final = "corner_alpha"

CORNER_BETA: Final = "corner_beta"

CORNER_COUNT: Final = "corner_count"

SUMMARY: Final = (
    "largest_alpha",
    "beta_of_largest_alpha",
    "largest_beta",
    "stable_area",
    "least_radius",
    "alpha_of_least_radius",
    "beta_of_least_radius",
)

SPEC: Final = "spec"

NODE: Final = ("alpha_node", "beta_node", "gamma", "delta", "delay")

CELL: Final = ("alpha_cell", "beta_cell", "gamma_cell", "delta_cell", "delay")

SLICE: Final = ("gamma", "delta", "delay")

LIMITS: Final = ("limit_cell", "gamma_cell", "delta_cell", "delay_cell", "limit_term")

LIMIT_TERMS: Final = 10  # of each of the two limits

RADIUS_CELL: Final = (
    "radius_alpha_cell",
    "radius_beta_cell",
    "radius_gamma_cell",
    "radius_delta_cell",
    "radius_delay_cell",
)

TERMS_OF_RADIUS: Final = 22  # of each function: those up to second order, and an error

RADIUS_KINDS: Final = (1, 4)  # the least and the largest

RADIUS_FUNCTIONS: Final = (0, 1, 2, 2, 3)  # of cells of each kind


@dataclass(frozen=True)
class Variable:
    """One dataset: its type, its dimensions (itself for an axis) and what its numbers mean.

    Attributes:
        lowest: that its values may be.
        highest: likewise.
        has_nan: whether NaN has a meaning.
    """

    name: str
    dtype: str
    dimensions: tuple[str, ...]
    long_name: str
    interpretation: str
    lowest: float | int = -inf
    highest: float | int = inf
    has_nan: bool = False

    @property
    def is_packed(self) -> bool:
        """Whether its chunks are shuffled and deflated; those of others are plain numbers."""
        return self.dimensions in (NODE, CELL, RADIUS_CELL) or RADIUS_ROW in self.dimensions

    @property
    def is_axis(self) -> bool:
        """Whether this is the coordinate of the dimension of its name (an HDF5 dimension scale)."""
        return self.dimensions == (self.name,)

    @property
    def holds_verdicts(self) -> bool:
        """Whether the values are codes of ``jaxstab.Verdict``."""
        return self.dtype == "int8"


def _axis(name: str, long_name: str, interpretation: str, highest: float = inf) -> Variable:
    return Variable(name, "float64", (name,), long_name, interpretation, 0.0, highest)


def _numbers(name: str, interpretation: str) -> Variable:
    return Variable(name, "int32", (name,), f"number along {name}", interpretation, 0)


def _cells(axis: str, nodes: str) -> Variable:
    return _numbers(f"{axis}_cell", f"cell i lies between {nodes} i and i + 1; of one node, at it")


def _point(name: str, dimension: str, what: str) -> Variable:
    words = "the slices follow each other in the order of delay, gamma, delta; NaN ends each"
    return Variable(name, "float64", (dimension,), what, words, has_nan=True)


def _measure(name: str, long_name: str, interpretation: str) -> Variable:
    return Variable(name, "float64", SLICE, long_name, interpretation, has_nan=True)


def _count(name: str, long_name: str, interpretation: str, highest: float | int) -> Variable:
    return Variable(name, "int32", SLICE, long_name, interpretation, 0, highest)


FLAG_VALUES: Final = tuple(int(code) for code in Verdict)

FLAG_MEANINGS: Final = " ".join(code.name.lower() for code in Verdict)

_CODES: Final = (min(FLAG_VALUES), max(FLAG_VALUES))

VARIABLES: Final = {
    variable.name: variable
    for variable in (
        _axis("delay", "time delay", "t_d/T, in sampling periods T", LARGEST_DELAY),
        _axis("gamma", "physical stiffness", "k T^2/m, k of device and hand"),
        _axis("delta", "physical damping", "b T/m, b of device and hand"),
        _numbers("alpha_node", "node i at delay k is at alpha[i, k]"),
        _numbers("beta_node", "node i at delay k is at beta[i, k]"),
        _cells("alpha", "alpha_node"),
        _cells("beta", "beta_node"),
        _cells("gamma", "gamma"),
        _cells("delta", "delta"),
        Variable(
            "alpha",
            "float64",
            ("alpha_node", "delay"),
            "stiffness of the virtual wall",
            "K T^2/m; one column of ascending nodes for each delay",
        ),
        Variable(
            "beta",
            "float64",
            ("beta_node", "delay"),
            "damping of the virtual wall",
            "B T/m; one column of ascending nodes for each delay",
        ),
        Variable(
            VERDICT,
            "int8",
            NODE,
            "stability at the node",
            "stable: all roots of the characteristic polynomial inside the unit circle; "
            "unstable: not so; both proved. Undecided: too close to the boundary",
            *_CODES,
        ),
        Variable(
            CELL_VERDICT,
            "int8",
            CELL,
            "stability of all points of the cell",
            "stable or unstable: proved for each point of the closed cell (the boundary in closed "
            "form is enclosed and passes elsewhere); undecided: no proof",
            *_CODES,
        ),
        _numbers("limit_cell", "cell i of n is the i-th of n equal parts of the range of beta"),
        _numbers("delay_cell", "cell i holds the delays limit_range[i, 0] to limit_range[i, 1]"),
        _numbers(
            "limit_end",
            "0 and 1: lowest and highest delay of a cell; 2 and 3: likewise alpha; 4 and 5: beta",
        ),
        Variable(
            LIMIT_RANGE,
            "float64",
            ("delay_cell", "limit_end"),
            "delays, alpha and beta for which limits of alpha are given",
            "one row for each cell of delays, ascending; of two cells that share a delay the "
            "second answers for it",
        ),
        Variable(
            LIMIT_WHOLE,
            "int32",
            ("delay_cell",),
            "axes that hold the whole stable set",
            "for all gamma and delta of the atlas and all delays of the cell: 1, a wall beyond the "
            "alphas of limit_range, at one of its betas, is unstable; 2, and so is one beyond its "
            "betas; 0, nothing is known. Proved: columns between the axes and bounds of all stable "
            "gains are empty",
            0,
            WHOLE_BOTH,
        ),
        _numbers(
            "limit_term",
            "0 to 9: constant, slopes along beta, gamma, delta, delay, the square of the delay and "
            "the delay times beta, gamma and delta, and error of the lower limit; 10 to 19: of the "
            "upper limit",
        ),
        Variable(
            ALPHA_LIMITS,
            "float32",
            LIMITS,
            "limits of the stable alpha",
            "limit = constant + slopes (beta, gamma, delta, delay, delay^2, delay beta, delay "
            "gamma, delay delta). Proved for each point of the closed cell, and alpha in the range "
            "of limit_range: unstable below the lower "
            "limit - error and above the upper limit + error, stable between lower + error and "
            "upper - error (the boundary in closed form is enclosed, and a verdict computed in "
            "each gap). Constants "
            "of infinity: lower, no alpha is stable; upper, the limit is beyond the atlas",
        ),
        *(
            _numbers(name, "cell i of n is the i-th of n equal parts of the range")
            for name in RADIUS_CELL[:-1]
        ),
        _numbers(RADIUS_CELL[-1], "cell i holds the delays radius_range[i, 0] to [i, 1]"),
        _numbers(
            "radius_end",
            "0 and 1: lowest and highest delay of a cell; 2 and 3: likewise alpha; 4 and 5: beta",
        ),
        Variable(
            RADIUS_RANGE,
            "float64",
            ("radius_delay_cell", "radius_end"),
            "delays, alpha and beta for which spectral radii are given",
            "one row for each cell of delays, ascending; of two cells that share a delay the "
            "second answers for it",
        ),
        _numbers(
            "radius_term",
            "0: constant; 1 to 5: slopes along alpha, beta, gamma, delta and delay, each from -1 "
            "to 1 in the cell; 6 to 20: of their products in the order 11 12 13 14 15 22 ... 55; "
            "21: error",
        ),
        _numbers(RADIUS_ROW, "functions of all cells, one cell after the other, the delay slowest"),
        Variable(
            RADIUS_KIND,
            "int32",
            RADIUS_CELL,
            "what the spectral radius, the largest modulus of a closed-loop pole, is made of",
            "Proved for each point of the closed cell. 1: it is a function, 2: the larger of two "
            "functions, each within its error. 3: it is the largest |m + w| of two w at which "
            "|w^2 + Q| is not larger than the error of m; 4: of three w at which |w^3 + P w + Q| "
            "is not; m, P and Q are functions in this order, and the error of the second one is "
            "that of |m + w|",
            *RADIUS_KINDS,
        ),
        Variable(
            RADIUS_TERMS,
            "float32",
            ("radius_term", RADIUS_ROW),
            "terms of the functions of which the spectral radius is made",
            "of 1, 2, 2 and 3 functions for the kinds 1 to 4; an infinite error: nothing is known",
        ),
        _numbers("outline_point", "point of all outlines, one after the other"),
        _numbers("corner", "corner of all outlines, one after the other"),
        _point(OUTLINE_ALPHA, "outline_point", "alpha along the boundary of the stable region"),
        _point(OUTLINE_BETA, "outline_point", "beta along the boundary of the stable region"),
        Variable(
            OUTLINE_BRANCH,
            "int32",
            ("outline_point",),
            "what the boundary is from this point to the next",
            "0 a pair of roots on the unit circle, 1 a root at z = 1, 2 one at z = -1, -1 no piece",
            -1,
            2,
        ),
        _point(CORNER_ALPHA, "corner", "alpha of the corners, where two branches meet"),
        _point(CORNER_BETA, "corner", "beta of the corners, where two branches meet"),
        _count(OUTLINE_SIZE, "number of outline points", "with the NaN at their end", inf),
        _count(CORNER_COUNT, "number of corners", "with the NaN at their end", inf),
        _count(
            OUTLINE_STATUS,
            "what is known of the outline",
            "0 complete, 1 the stable region is empty, 2 unresolved: do not use it",
            2,
        ),
        _measure(SUMMARY[0], "largest stable alpha", "closed form; NaN if none is stable"),
        _measure(SUMMARY[1], "beta of the largest stable alpha", "from the closed form"),
        _measure(SUMMARY[2], "largest stable beta", "closed form; NaN if none is stable"),
        _measure(SUMMARY[3], "area of the stable region", "in the (alpha, beta) plane"),
        _measure(SUMMARY[4], "smallest spectral radius", "over all (alpha, beta)"),
        _measure(SUMMARY[5], "alpha of the smallest spectral radius", "solved for, not gridded"),
        _measure(SUMMARY[6], "beta of the smallest spectral radius", "solved for, not gridded"),
        _numbers("spec_line", "line of the specification"),
        Variable(
            SPEC,
            "S",
            ("spec_line",),
            "specification of this atlas",
            "the lines of a TOML file from which the same atlas can be built",
        ),
    )
}

"""All variables in the order in which they are written; those of a product only if it is chosen."""

PRODUCTS: Final = {
    VERDICT: (VERDICT, CELL_VERDICT),
    ALPHA_LIMITS: (
        "limit_cell",
        "delay_cell",
        "limit_end",
        LIMIT_RANGE,
        LIMIT_WHOLE,
        "limit_term",
        ALPHA_LIMITS,
    ),
    SPECTRAL_RADIUS: (
        *RADIUS_CELL,
        "radius_end",
        RADIUS_RANGE,
        "radius_term",
        RADIUS_ROW,
        RADIUS_KIND,
        RADIUS_TERMS,
    ),
    "outline": (
        "outline_point",
        "corner",
        OUTLINE_ALPHA,
        OUTLINE_BETA,
        OUTLINE_BRANCH,
        CORNER_ALPHA,
        CORNER_BETA,
        OUTLINE_SIZE,
        CORNER_COUNT,
        OUTLINE_STATUS,
    ),
    "summary": SUMMARY,
}

"""What can be chosen in a specification, and the variables that hold it."""

KNOWN_BEFORE: Final = (LIMIT_RANGE, LIMIT_WHOLE, RADIUS_RANGE)

"""Variables of products that no tile holds: they follow from the specification."""

STRUNG: Final = {OUTLINE_SIZE: "outline_point", CORNER_COUNT: "corner"}

"""How many of the places along a dimension belong to each slice."""

ALWAYS: Final = frozenset(VARIABLES) - {name for names in PRODUCTS.values() for name in names}

LONGEST_LINE: Final = 4096  # bytes in a line of the specification


# Attributes of a file and of its datasets, in words and numbers. No JAX.


def head_attributes(created_by: str, filters: str) -> dict[str, Any]:
    """Return the attributes of a file, without the digest of its values."""
    return {
        "format": schema.FORMAT,
        "title": "Stability of a haptic rendering loop over its dimensionless parameters",
        "created_by": created_by,
        "source": "characteristic polynomial of Hulin, Preusche, Hirzinger (2008), eq. (9)",
        "symbols": "K, B stiffness and damping of the virtual wall; m, b, k mass, damping and "
        "stiffness of device and hand; T sampling period, t_d delay",
        "filters": filters,
        "Conventions": "CF-1.8",
        "schema_version": np.int32(schema.SCHEMA_VERSION),
    }


def attributes_of(variable: Variable) -> dict[str, Any]:
    """Return the attributes of a dataset."""
    attributes: dict[str, Any] = {
        "long_name": variable.long_name,
        "interpretation": variable.interpretation,
    }
    if variable.dtype.startswith("float"):
        attributes["units"] = "1"
    if variable.dimensions == schema.NODE:
        attributes["coordinates"] = "alpha beta"
    if variable.holds_verdicts:
        attributes["flag_values"] = np.array(schema.FLAG_VALUES, np.int8)
        attributes["flag_meanings"] = schema.FLAG_MEANINGS
    return attributes


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
    """Return the footer of what is in the first bytes of a stream.

    Args:
        stream: of a file.
        length: how many bytes.
        image_size: how many of them are the HDF5 image.

    Raises:
        OSError: the stream is shorter, or cannot be read.
    """
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
