"""Tiles on disk: an image for each, in a folder beside the atlas until the atlas is published.

What is in the folder is what is done: a build that was interrupted goes on from there.
"""

import errno
import hashlib
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
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
from jaxstab.durable import named_errors, publish

VALUES_DIGEST = "values_sha256"
_TILE = "tile"


def build_key(spec: AtlasSpec, created_by: str) -> str:
    """Return what tells the tiles of a build from those of others: a digest of what it builds."""
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
            f"shape {shape}; look at the worker's JAX and its x64 mode."
        )


def _write(file: h5py.File, name: str, values: NDArray[Any], chunk: Sequence[int]) -> None:
    whole = np.zeros(chunk, values.dtype.newbyteorder("<"))
    whole[tuple(map(slice, values.shape))] = values
    filters = filters_of(VARIABLES[name])
    dataset = file.create_dataset(name, data=whole, chunks=tuple(chunk), **filters)
    dataset.attrs[VALUES_DIGEST] = np.bytes_(values_digest(values))


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
        """Remove the folder with all that is in it."""
        shutil.rmtree(self.folder, ignore_errors=True)


@contextmanager
def shards_of(path: Path, key: str) -> Iterator[Shards]:
    """Open, or make, the folder of a build of the atlas at a path; it is this process's alone.

    It stays for the next build of the same atlas unless it is empty, or removed.

    Raises:
        OSError: it cannot be made, there is a folder at the path, or another process builds this
            atlas.
    """
    folder = path.with_name(f".{path.name}.{key[:16]}.tiles")
    with named_errors("write", path):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "there is a folder of this name")
        folder.mkdir(exist_ok=True)
        lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o666)
    shards = Shards(folder, key)
    with _locked(lock, path):
        for left_over in folder.glob(".*.part"):
            left_over.unlink()
        try:
            yield shards
        finally:
            if not any(folder.glob("*.tile")):
                shards.remove()


@contextmanager
def _locked(lock: int, path: Path) -> Iterator[None]:
    """Keep other processes out; the system opens the lock when this one ends in whatever way."""
    try:
        with named_errors("write", path):
            if os.name == "posix":
                _lock(lock)
        yield
    finally:
        os.close(lock)


def _lock(descriptor: int) -> None:
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BlockingIOError(error.errno, "another process is building it") from error
    except OSError:
        return  # a file system without locks
