"""The footer after an HDF5 image, by which a reader knows that the image is whole. No JAX."""

import errno
import hashlib
import io
import struct

from jaxstab.atlas.format.schema import FOOTER_MAGIC

_FOOTER = struct.Struct(f"<{len(FOOTER_MAGIC)}sQ32s")
_BLOCK = 2**20  # bytes


def footer_of(stream: io.FileIO | io.BytesIO, length: int) -> bytes:
    """Return the footer of an image of this length at the beginning of a stream.

    Raises:
        OSError: the stream is shorter, or cannot be read.
    """
    stream.seek(0)
    digest, rest = hashlib.sha256(), length
    while rest:
        block = stream.read(min(rest, _BLOCK))
        if not block:
            raise OSError(errno.EIO, f"the file ends {rest} bytes early")
        digest.update(block)
        rest -= len(block)
    return _FOOTER.pack(FOOTER_MAGIC, length, digest.digest())


def sealed(image: bytes) -> bytes:
    """Return an image with its footer."""
    return image + footer_of(io.BytesIO(image), len(image))


def image_of(data: bytes) -> bytes | None:
    """Return the image if its footer is right."""
    return data[: -_FOOTER.size] if is_sealed(io.BytesIO(data)) else None


def is_sealed(stream: io.FileIO | io.BytesIO) -> bool:
    """Whether a stream holds an image and its footer, and both are right."""
    length = stream.seek(0, io.SEEK_END) - _FOOTER.size
    if length < 0:
        return False
    stream.seek(length)
    return stream.read(_FOOTER.size) == footer_of(stream, length)
