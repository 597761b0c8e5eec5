"""Labelled arrays, computed in blocks and stored as one netCDF-4 file: maps that outgrow a call.

A dataset has named dimensions with coordinates, and variables over all of them. It is computed in
blocks, boxes of the grid of dimensions, by ``jaxstab.tiles``: in any executor, resumed after an
interruption, the same bytes however the work was done. A block is also a chunk of the file, which
xarray, h5py and any HDF5 viewer open. The file has the key of its dataset, so an equal call finds
that all is done.
"""

import hashlib
import io
import os
import zipfile
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from jaxstab.durable import PatientStream, named_errors, replacing
from jaxstab.tiles import Job, Progress, Shards, complete, computed_by

Arrays = dict[str, NDArray[Any]]
Block = tuple[slice, ...]

FORMAT_VERSIONS: Final = ("v110", "v110")

"""Of HDF5: checksums of its own structures; 1.10 and newer read it."""

_FILTERS = {"shuffle": True, "compression": "gzip", "compression_opts": 1, "fletcher32": True}
_KEY, _MAKER = "key", "computed_by"
_AT_ONCE = 8  # blocks in flight


class Variable(NamedTuple):
    """A variable, or the coordinate of a dimension: its type, its name in words and its unit.

    flags: the words of codes, by their numbers.
    """

    dtype: str
    long_name: str
    units: str
    flags: Mapping[int, str] = {}

    @property
    def attributes(self) -> dict[str, Any]:
        """The attributes of the dataset in the file, as CF names them."""
        attributes: dict[str, Any] = {"long_name": self.long_name, "units": self.units}
        if self.flags:
            attributes["flag_values"] = np.array([*self.flags], self.dtype)
            attributes["flag_meanings"] = " ".join(self.flags.values())
        return attributes


@dataclass(frozen=True)
class Dataset(Job[Block]):
    """A dataset that is computed in blocks of ``size`` values at most, and where its file goes.

    Attributes:
        path: of the file.
        coordinates: the dimensions in order, with the values along each.
        variables: those over all dimensions, and what coordinates are, by their names.
        attributes: of the file, as text.
        identity: what tells it from other datasets, all that is computed from, to the last digit.
        compute: the variables in a block, by name; it and its arguments can be pickled.
    """

    path: Path
    coordinates: Mapping[str, NDArray[Any]]
    variables: Mapping[str, Variable]
    attributes: Mapping[str, str]
    identity: str
    compute: Callable[[Block], Arrays]
    size: int
    at_once: int = _AT_ONCE
    key: str = field(init=False, default="")

    def __post_init__(self) -> None:
        digest = hashlib.sha256(repr([self.identity, self.size, computed_by()]).encode())
        digest.update(repr([*self.attributes.items(), *self.variables.items()]).encode())
        for name, values in self.coordinates.items():
            digest.update(f"\n{name} {values.dtype.str} {values.shape} ".encode())
            digest.update(np.ascontiguousarray(values).tobytes())
        object.__setattr__(self, "key", digest.hexdigest())

    @property
    def shape(self) -> tuple[int, ...]:
        """The lengths of the dimensions."""
        return tuple(len(values) for values in self.coordinates.values())

    @property
    def chunk(self) -> tuple[int, ...]:
        """The shape of a block: whole dimensions from the last one on, as many as it may hold."""
        left, lengths = self.size, list[int]()
        for length in reversed(self.shape):
            lengths.append(max(1, min(length, left)))
            left //= lengths[-1]
        return tuple(reversed(lengths))

    @property
    def computed(self) -> dict[str, Variable]:
        """The variables that blocks hold."""
        return {n: v for n, v in self.variables.items() if n not in self.coordinates}

    @property
    def items(self) -> list[Block]:
        """The blocks."""
        starts = (range(0, n, step) for n, step in zip(self.shape, self.chunk, strict=True))
        return [
            tuple(
                slice(first, min(first + step, n))
                for first, step, n in zip(place, self.chunk, self.shape, strict=True)
            )
            for place in product(*starts)
        ]

    def name(self, item: Block) -> str:
        """The name of a block: where it begins."""
        return "-".join(str(part.start) for part in item)

    def image(self, item: Block) -> bytes:
        """The block, computed, as an archive of arrays."""
        stream = io.BytesIO()
        said: dict[str, Any] = {_KEY: self.key, _MAKER: computed_by()}
        np.savez(stream, **self.compute(item) | said)
        return stream.getvalue()

    def check(self, item: Block, image: bytes) -> None:
        """Refuse a block that is damaged, of another dataset or of other code."""
        arrays = _arrays(image)
        maker = str(arrays.get(_MAKER, "an older jaxstab"))
        if arrays and maker != computed_by():
            raise RuntimeError(
                f"a worker computes with {maker}, and this process with {computed_by()}; install "
                "the same for all workers."
            )
        if not self._is_own(item, arrays):
            raise ValueError(f"block {self.name(item)} of {self.path} is damaged; do it again.")

    def is_done(self, item: Block, image: bytes) -> bool:
        """Whether a stored block is whole and of this dataset."""
        return self._is_own(item, _arrays(image))

    def _is_own(self, item: Block, arrays: Arrays) -> bool:
        shape = tuple(part.stop - part.start for part in item)
        return str(arrays.get(_KEY)) == self.key and all(
            name in arrays and arrays[name].shape == shape and arrays[name].dtype == variable.dtype
            for name, variable in self.computed.items()
        )

    def publish(self, shards: Shards) -> None:
        """Write the file: a chunk for each block, in their order."""
        with replacing(self.path, shards.folder) as descriptor:
            stream = PatientStream(descriptor)
            with h5py.File(stream, "w", libver=FORMAT_VERSIONS) as file:
                datasets = self._created(file)
                for item in self.items:
                    arrays = _arrays(shards.read(self.name(item)))
                    for name, dataset in datasets.items():
                        dataset[item] = arrays[name]
                    stream.check()
            stream.check()
            os.ftruncate(descriptor, stream.size)

    def _created(self, file: h5py.File) -> dict[str, h5py.Dataset]:
        """Write attributes and coordinates, and create the variables."""
        write_attributes(file, {**self.attributes, "Conventions": "CF-1.8", _KEY: self.key})
        for name, values in self.coordinates.items():
            is_text = values.dtype.kind == "U"
            stored = np.char.encode(values, "utf-8") if is_text else values
            dataset = file.create_dataset(name, data=stored, track_times=False)
            dataset.make_scale(name)
            write_attributes(dataset, self.variables[name].attributes)
        datasets = {}
        for name, variable in self.computed.items():
            datasets[name] = file.create_dataset(
                name, self.shape, variable.dtype, chunks=self.chunk, track_times=False, **_FILTERS
            )
            write_attributes(datasets[name], variable.attributes)
            for number, dimension in enumerate(self.coordinates):
                datasets[name].dims[number].attach_scale(file[dimension])
        return datasets

    @property
    def is_published(self) -> bool:
        """Whether the file at the path is of this dataset."""
        try:
            with h5py.File(self.path, "r") as file:
                return bytes(file.attrs[_KEY]).decode() == self.key
        except (OSError, KeyError, ValueError, TypeError):
            return False

    def read(self) -> Arrays:
        """The variables of the file, whole."""
        with named_errors("read", self.path), h5py.File(self.path, "r") as file:
            return {name: file[name][()] for name in self.computed}


def stored(
    dataset: Dataset, progress: Progress | None = None, executor: Executor | None = None
) -> Arrays:
    """Return the variables of a dataset from its file, which is computed unless it is done already.

    ``progress`` is called with the number of finished blocks and of all blocks.

    OSError: the folder is missing, read-only or full, or another process computes this dataset;
    FileExistsError: another file is at the path; RuntimeError: workers died, or are of other code.
    """
    if dataset.is_published:
        if progress is not None:
            progress(len(dataset.items), len(dataset.items))
    elif os.path.lexists(dataset.path):
        raise FileExistsError(
            f"{dataset.path} exists, and is of something else or of another version of jaxstab; "
            "remove it, or give another name."
        )
    else:
        complete(dataset, dataset.path, progress, executor)
    return dataset.read()


def mesh_of(values: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return the arguments that are arrays as dimensions, in the order of the axes they vary along.

    ValueError: two arguments vary along one axis, or one along two.
    """
    arrays = {name: np.asarray(value) for name, value in values.items()}
    rank = max((array.ndim for array in arrays.values()), default=0)
    owners: dict[int, str] = {}
    for name, array in arrays.items():
        axes = [rank - array.ndim + k for k, length in enumerate(array.shape) if length > 1]
        if len(axes) > 1 or owners.get(axes[0] if axes else -1, name) != name:
            raise ValueError(
                f"{name} has the shape {array.shape}; for a file each array varies along an axis "
                "of its own: give those of np.ix_(...)."
            )
        owners |= dict.fromkeys(axes, name)
    return {owners[axis]: arrays[owners[axis]].ravel() for axis in sorted(owners)}


def _arrays(image: bytes) -> Arrays:
    """Return the arrays of an image; none where it is damaged."""
    try:
        with np.load(io.BytesIO(image)) as archive:
            return dict(archive)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return {}


def write_attributes(to: h5py.File | h5py.Dataset, attributes: Mapping[str, Any]) -> None:
    """Write attributes; texts as UTF-8 of a fixed length."""
    for name, value in attributes.items():
        to.attrs[name] = np.bytes_(value.encode("utf-8")) if isinstance(value, str) else value
