"""The footer of a file, by which a reader knows that all of it is there. No JAX."""

import errno
import hashlib
import io
import struct

from jaxstab.atlas.format.schema import FOOTER_MAGIC

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
