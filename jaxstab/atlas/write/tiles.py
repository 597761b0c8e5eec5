"""Tiles on disk: an image for each, in a folder beside the atlas until the atlas is published.

What is in the folder is what is done: a build that was interrupted goes on from there. The folder
is its owner's alone, and a tile counts if it is of this build and code, and as the schema says.
"""

import errno
import hashlib
import os
import platform
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

import jaxstab
from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.format.schema import (
    SCHEMA_VERSION,
    VARIABLES,
    image_of,
    sealed,
    values_digest,
)
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.format.table import check
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.read.file import check_values
from jaxstab.atlas.write.variables import FORMAT_VERSIONS, TROUBLES, checked_layout, filters_of
from jaxstab.durable import Folder, named_errors, own_folder, target_of

VALUES_DIGEST = "values_sha256"
_TILE = "tile"
_MAKER = "computed_by"
_LOCK = "lock"
_LEFT_OVER = re.compile(r"\..+\.[0-9a-f]{16}\.part")
_OURS = re.compile(rf"\d+-\d+-\d+\.tile|{_LEFT_OVER.pattern}")
_BUSY = "another process is building it"
_ATTEMPTS = 100


@cache
def computed_by() -> str:
    """Return what computes tiles here: jaxstab and a hash of its code, NumPy and Python."""
    root = Path(jaxstab.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root).as_posix()}\n".encode() + path.read_bytes())
    code = digest.hexdigest()[:16]
    versions = f"NumPy {np.__version__}, Python {platform.python_version()}"
    return f"jaxstab {jaxstab.__version__} (code {code}), {versions}"


def build_key(spec: AtlasSpec) -> str:
    """Return the hash of a specification and of what computes it; other tiles do not match it."""
    words = "\n".join([spec.to_toml(), str(SCHEMA_VERSION), computed_by()])
    return hashlib.sha256(words.encode()).hexdigest()


def encode_tile(plan: Plan, tile: Tile, key: str, arrays: dict[str, NDArray[Any]]) -> bytes:
    """Return the sealed image of a tile; its chunks are those of the atlas.

    Raises:
        RuntimeError: an array is not of the type and shape that the schema says.
    """
    with h5py.File.in_memory(libver=FORMAT_VERSIONS) as file:
        file.attrs[_TILE] = np.bytes_(_title(key, tile))
        file.attrs[_MAKER] = np.bytes_(computed_by())
        for name, values in arrays.items():
            _check(plan, tile, name, values)
            if values.size:
                chunk = plan.chunk(name) if plan.is_gridded(name) else values.shape
                _write(file, name, values, chunk)
        file.flush()
        return sealed(bytes(file.id.get_file_image()))


@contextmanager
def opened_tile(plan: Plan, tile: Tile, key: str, image: bytes) -> Iterator[h5py.File]:
    """Open the image of a tile in memory, after a look at all of it.

    Raises:
        ValueError: it is damaged, of another build, or not as the schema says.
        RuntimeError: another jaxstab, NumPy or Python computed it.
    """
    whole = image_of(image)
    if whole is None:
        raise ValueError(f"tile {_name(tile)} is damaged; build the same atlas again.")
    with h5py.File.in_memory(whole) as file:
        try:
            maker = bytes(file.attrs.get(_MAKER, b"an older jaxstab")).decode("utf-8")
            if maker == computed_by():
                check(bytes(file.attrs[_TILE]).decode("utf-8") == _title(key, tile))
                _check_datasets(file, plan, tile)
        except TROUBLES as error:
            raise ValueError(
                f"tile {_name(tile)} is none of this build; build the same atlas again."
            ) from error
        if maker != computed_by():
            raise RuntimeError(
                f"a worker computes with {maker}, and this build with {computed_by()}; install the "
                "same for all workers."
            )
        yield file


def _check_datasets(file: h5py.File, plan: Plan, tile: Tile) -> None:
    """Refuse other variables than those of a tile, and others than its values in their chunks."""
    chosen = [PRODUCTS[product] for product in plan.spec.products]
    held = [v.name for p in chosen for v in p.variables if not v.is_axis and v.name not in p.known]
    gridded = {n for n in held if plan.is_gridded(n) and 0 not in plan.shape(n, tile)}
    flat = {name for name in held if not plan.is_gridded(name)}
    check(gridded <= set(file) <= gridded | flat)
    for name in file:
        variable, dtype = VARIABLES[name], np.dtype(VARIABLES[name].dtype).newbyteorder("<")
        if name in gridded:
            chunk, shape = plan.chunk(name), plan.shape(name, tile)
            whole = _whole_chunks(shape, chunk)
        else:
            whole = chunk = shape = file[name].shape
        dataset = checked_layout(file, variable, dtype, whole, chunk)
        values = dataset[()][tuple(map(slice, shape))]
        check_values(variable, values)
        said = bytes(dataset.attrs[VALUES_DIGEST]).decode("ascii").split(" ")
        check(said == [values_digest(part) for part in _parts(values, chunk)])


def _whole_chunks(shape: Sequence[int], chunk: Sequence[int]) -> tuple[int, ...]:
    return tuple(-(-n // step) * step for n, step in zip(shape, chunk, strict=True))


def _parts(values: NDArray[Any], chunk: Sequence[int]) -> Iterator[NDArray[Any]]:
    starts = product(*(range(0, n, step) for n, step in zip(values.shape, chunk, strict=True)))
    return (values[tuple(map(slice, start, np.add(start, chunk)))] for start in starts)


def _name(tile: Tile) -> str:
    return f"{tile.delay}-{tile.gamma}-{tile.delta.start}"


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
    whole = np.zeros(_whole_chunks(values.shape, chunk), values.dtype.newbyteorder("<"))
    whole[tuple(map(slice, values.shape))] = values
    filters = filters_of(VARIABLES[name])
    dataset = file.create_dataset(name, data=whole, chunks=tuple(chunk), **filters)
    dataset.attrs[VALUES_DIGEST] = np.bytes_(" ".join(map(values_digest, _parts(values, chunk))))


@dataclass(frozen=True)
class Shards:
    """The tiles of one build that are done; ``shards_of`` makes it.

    Attributes:
        folder: where they are.
        key: of the build.
    """

    folder: Folder
    key: str

    def put(self, tile: Tile, image: bytes) -> None:
        """Keep the image of a tile, durably.

        Raises:
            OSError: the folder is full or gone.
        """
        with named_errors("write", self.folder.path):
            self.folder.put(f"{_name(tile)}.tile", image)

    def has(self, plan: Plan, tile: Tile) -> bool:
        """Whether the image of a tile is here, whole and of this build."""
        try:
            with self.opened(plan, tile):
                return True
        except (OSError, ValueError, RuntimeError):
            return False

    def has_any(self) -> bool:
        """Whether the image of any tile is here."""
        return any(name.endswith(".tile") for name in self.folder.names())

    @contextmanager
    def opened(self, plan: Plan, tile: Tile) -> Iterator[h5py.File]:
        """Open the image of a tile in memory.

        Raises:
            OSError: it is not here.
            ValueError, RuntimeError: as ``opened_tile``.
        """
        image = self.folder.read(f"{_name(tile)}.tile")
        with opened_tile(plan, tile, self.key, image) as file:
            yield file

    def clear(self, pattern: re.Pattern[str] = _OURS) -> None:
        """Remove what builds put into the folder, and nothing else."""
        for name in self.folder.names():
            if pattern.fullmatch(name):
                self.folder.remove(name)

    def remove(self) -> None:
        """Remove the tiles and the folder, the lock last: until then it keeps others out.

        Another process may have made a new lock by then, and goes on in the folder.
        """
        with suppress(OSError):
            self.clear()
            self.folder.remove(_LOCK)
            os.rmdir(self.folder.path)


@contextmanager
def shards_of(path: Path, key: str) -> Iterator[Shards]:
    """Open, or make, the folder of a build of the atlas at a path; it is this process's alone.

    It stays for the next build of the same atlas unless it is empty, or removed.

    Raises:
        OSError: it cannot be made or locked, it is a link, another user's or open to others, there
            is no file at the path but something else, or another process builds this atlas.
    """
    with ExitStack() as stack:
        with named_errors("write", path):
            target, _ = target_of(path)
            place = target.with_name(f".{target.name}.{key[:16]}.tiles")
            shards = _locked(place, key, stack)
        try:  # the system opens the lock when this process ends in whatever way
            shards.clear(_LEFT_OVER)
            yield shards
        finally:
            if not shards.has_any():
                shards.remove()


def _locked(place: Path, key: str, stack: ExitStack) -> Shards:
    """Return the folder of a build, open and locked until the stack is left."""
    for _ in range(_ATTEMPTS):
        with ExitStack() as attempt, suppress(_GoneError):
            try:
                shards = Shards(attempt.enter_context(own_folder(place)), key)
            except FileNotFoundError as error:
                if place.parent.is_dir():
                    raise _GoneError from error
                raise
            attempt.callback(os.close, _lock_in(shards))
            stack.push(attempt.pop_all())
            return shards
    raise BlockingIOError(errno.EAGAIN, _BUSY)


class _GoneError(Exception):
    """Who had the lock removed the folder in the meantime."""


def _lock_in(shards: Shards) -> int:
    try:
        lock = shards.folder.open(_LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    except FileNotFoundError as error:
        raise _GoneError from error
    try:
        _lock(lock)
        if not shards.folder.has(_LOCK, lock):
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
