"""Tiles on disk: an image for each, in a folder beside the atlas until the atlas is published.

What is in the folder is what is done: a build that was interrupted goes on from there.
"""

import errno
import hashlib
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.compute.products import Arrays
from jaxstab.atlas.format.digest import values_digest
from jaxstab.atlas.format.footer import image_of, sealed
from jaxstab.atlas.format.schema import SCHEMA_VERSION, VARIABLES
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.write.variables import FORMAT_VERSIONS, filters_of
from jaxstab.durable import is_named, named_errors, publish, sync_folder, target_of

VALUES_DIGEST = "values_sha256"
_TILE = "tile"
_LOCK = "lock"
_BUSY = "another process is building it"
_ATTEMPTS = 100


def build_key(spec: AtlasSpec, created_by: str) -> str:
    """Return the hash of a specification; tiles of other builds do not match it."""
    words = "\n".join([spec.to_toml(), str(SCHEMA_VERSION), created_by])
    return hashlib.sha256(words.encode()).hexdigest()


def encode_tile(plan: Plan, tile: Tile, key: str, arrays: Arrays) -> bytes:
    """Return the sealed image of a tile; its chunks are those of the atlas.

    Raises:
        RuntimeError: an array is not of the type and shape that the schema says.
    """
    with h5py.File.in_memory(libver=FORMAT_VERSIONS) as file:
        file.attrs[_TILE] = np.bytes_(_title(key, tile))
        for name, values in arrays.items():
            _check(plan, tile, name, values)
            if values.size:
                chunk = plan.chunk(name) if plan.is_gridded(name) else values.shape
                _write(file, name, values, chunk)
        file.flush()
        return sealed(bytes(file.id.get_file_image()))


def _title(key: str, tile: Tile) -> str:
    return f"{key} {tile.delay} {tile.gamma} {tile.delta.start} {tile.delta.stop}"


def _check(plan: Plan, tile: Tile, name: str, values: NDArray[Any]) -> None:
    dtype = np.dtype(VARIABLES[name].dtype)
    shape = plan.shape(name, tile) if plan.is_gridded(name) else values.shape
    if values.dtype != dtype or values.shape != shape:
        raise RuntimeError(
            f"{name} was computed as {values.dtype} of shape {values.shape}, not as {dtype} of "
            f"shape {shape}; look at the versions of the worker."
        )


def _write(file: h5py.File, name: str, values: NDArray[Any], chunk: Sequence[int]) -> None:
    sides = list(zip(values.shape, chunk, strict=True))
    whole = np.zeros([-(-n // step) * step for n, step in sides], values.dtype.newbyteorder("<"))
    whole[tuple(map(slice, values.shape))] = values
    filters = filters_of(VARIABLES[name])
    dataset = file.create_dataset(name, data=whole, chunks=tuple(chunk), **filters)
    starts = product(*(range(0, n, step) for n, step in sides))
    parts = (values[tuple(map(slice, start, np.add(start, chunk)))] for start in starts)
    dataset.attrs[VALUES_DIGEST] = np.bytes_(" ".join(map(values_digest, parts)))


@dataclass(frozen=True)
class Shards:
    """The tiles of one build that are done; ``shards_of`` makes it.

    Attributes:
        folder: where they are.
        key: of the build.
    """

    folder: Path
    key: str

    def path(self, tile: Tile) -> Path:
        """Return where the image of a tile is, or will be."""
        return self.folder / f"{tile.delay}-{tile.gamma}-{tile.delta.start}.tile"

    def put(self, tile: Tile, image: bytes) -> None:
        """Keep the image of a tile, durably.

        Raises:
            OSError: the folder is full or gone.
        """
        publish(image, self.path(tile))

    def has(self, tile: Tile) -> bool:
        """Whether the image of a tile is here, whole and of this build."""
        try:
            with self.opened(tile):
                return True
        except (OSError, KeyError, ValueError):
            return False

    def has_any(self) -> bool:
        """Whether the image of any tile is here."""
        return any(self.folder.glob("*.tile"))

    @contextmanager
    def opened(self, tile: Tile) -> Iterator[h5py.File]:
        """Open the image of a tile in memory.

        Raises:
            OSError: it is not here.
            ValueError: it is damaged, or of another build.
        """
        path = self.path(tile)
        image = image_of(path.read_bytes())
        if image is None:
            raise ValueError(f"{path} is damaged; run the same build again.")
        with h5py.File.in_memory(image) as file:
            if file.attrs[_TILE] != np.bytes_(_title(self.key, tile)):
                raise ValueError(f"{path} is of another build; remove it and build again.")
            yield file

    def remove(self) -> None:
        """Remove the folder with all that is in it, the lock last: until then it keeps others out.

        Another process may have made a new lock by then, and goes on in the folder.
        """
        lock = self.folder / _LOCK
        with suppress(OSError):
            for entry in self.folder.iterdir():
                if entry != lock:
                    entry.unlink()
            lock.unlink()
            self.folder.rmdir()


@contextmanager
def shards_of(path: Path, key: str) -> Iterator[Shards]:
    """Open, or make, the folder of a build of the atlas at a path; it is this process's alone.

    It stays for the next build of the same atlas unless it is empty, or removed.

    Raises:
        OSError: it cannot be made or locked, there is no file at the path but something else, or
            another process builds this atlas.
    """
    with named_errors("write", path):
        target, _ = target_of(path)
        shards = Shards(target.with_name(f".{target.name}.{key[:16]}.tiles"), key)
        lock = _locked(shards)
    try:  # the system opens the lock when this process ends in whatever way
        for left_over in shards.folder.glob(".*.part"):
            left_over.unlink()
        yield shards
    finally:
        if not shards.has_any():
            shards.remove()
        os.close(lock)


def _locked(shards: Shards) -> int:
    """Return the descriptor of the locked file by which the folder of a build is one's own."""
    for _ in range(_ATTEMPTS):
        with suppress(FileExistsError):
            os.mkdir(shards.folder)
            sync_folder(shards.folder.parent)
        with suppress(_GoneError):
            return _lock_in(shards)
    raise BlockingIOError(errno.EAGAIN, _BUSY)


class _GoneError(Exception):
    """Who had the lock removed the folder in the meantime."""


def _lock_in(shards: Shards) -> int:
    name = shards.folder / _LOCK
    try:
        lock = os.open(name, os.O_RDWR | os.O_CREAT, 0o666)
    except FileNotFoundError as error:
        raise _GoneError from error
    try:
        _lock(lock)
        if not is_named(lock, name):
            raise _GoneError
    except BaseException as error:
        os.close(lock)
        if not isinstance(error, BlockingIOError | _GoneError) and not shards.has_any():
            shards.remove()
        raise
    return lock


def _lock(descriptor: int) -> None:
    """Lock a file, or raise OSError."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError) as error:
        raise BlockingIOError(error.errno, _BUSY) from error
    except OSError as error:
        words = f"its folder cannot be locked ({error.strerror}), so build it elsewhere and copy it"
        raise OSError(error.errno, words) from error
