"""HDF5 files that atlases write: errors of the disk are raised when it is done, texts are UTF-8."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import h5py
import numpy as np

from jaxstab.durable import PatientStream

# Of HDF5: it writes checksums of its own structures, and 1.10 and newer read it.
_FORMAT_VERSIONS = "v110", "v110"


@contextmanager
def written(descriptor: int) -> Iterator[tuple[PatientStream, h5py.File]]:
    """Open an HDF5 file to write; errors of the disk are raised when it is done.

    A long write calls ``PatientStream.check`` often.
    """
    stream = PatientStream(descriptor)
    with h5py.File(stream, "w", libver=_FORMAT_VERSIONS) as file:
        yield stream, file
    stream.check()
    os.ftruncate(descriptor, stream.size)


def write_attributes(to: h5py.File | h5py.Dataset, attributes: Mapping[str, Any]) -> None:
    """Write attributes; texts as UTF-8 of a fixed length."""
    for name, value in attributes.items():
        to.attrs[name] = np.bytes_(value.encode("utf-8")) if isinstance(value, str) else value
