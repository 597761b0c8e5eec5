"""Files with their right footer, and the image of a file."""

import io

from jaxstab.atlas.schema import footer_of, image_size


def sealed(image: bytes, table: bytes = b"") -> bytes:
    """An image, and perhaps a table, with their footer."""
    data = image + table
    return data + footer_of(io.BytesIO(data), len(data), len(image))


def image_of(data: bytes) -> bytes | None:
    """The image if the footer is right."""
    size = image_size(io.BytesIO(data))
    return None if size is None else data[:size]
