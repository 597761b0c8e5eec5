"""Labelled arrays, computed in blocks and stored as one netCDF-4 file: maps that outgrow a call.

A dataset has named dimensions with coordinates, and variables over all of them. It is computed in
blocks, boxes of the grid of dimensions, by ``jaxstab.tiles``: in any executor, resumed after an
interruption, the same bytes however the work was done. A block is also a chunk of the file, which
xarray, h5py and any HDF5 viewer open. The file has the key of its dataset, so an equal call finds
that all is done.

A variable may lack some of the dimensions, of which each block then holds the whole. A dataset can
be computed in *parts*, every n-th block each, by processes that know nothing of each other: the
file of a part has all dimensions and its own chunks, and ``merged`` puts the chunks together.
"""

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from jaxstab.durable import PatientStream, named_errors, replacing
from jaxstab.tiles import Arrays, Job, Progress, Shards, complete, computed_by

Item = TypeVar("Item")
Block = tuple[slice, ...]

# Of HDF5: it writes checksums of its own structures, and 1.10 and newer read it.
_FORMAT_VERSIONS = "v110", "v110"
_FILTERS = {"shuffle": True, "compression": "gzip", "compression_opts": 1, "fletcher32": True}
_KEY, _PART = "key", "part"
_AT_ONCE = 256  # blocks in flight, and so the most workers that are busy


class Variable(NamedTuple):
    """A variable, or the coordinate of a dimension: its type, its description and its unit.

    flags: the names of codes; without: dimensions that the variable lacks.
    """

    dtype: str
    long_name: str
    units: str
    flags: Mapping[int, str] = {}
    without: tuple[str, ...] = ()

    @property
    def fill(self) -> float:
        """The value where other parts compute: not a number, or the smallest code."""
        return float(min(self.flags)) if self.flags else np.nan

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
        identity: everything that the values depend on, to the last digit.
        compute: the variables in a block, by name; it and its arguments can be pickled.
        size: values in a block, at most.
        labels: further coordinates along one dimension each, by name: the dimension, the values.
        part: which part of how many, counted from 1.
    """

    path: Path
    coordinates: Mapping[str, NDArray[Any]]
    variables: Mapping[str, Variable]
    attributes: Mapping[str, str]
    identity: str
    compute: Callable[[Block], Arrays]
    size: int
    labels: Mapping[str, tuple[str, NDArray[Any]]] = field(default_factory=dict)
    part: tuple[int, int] = (1, 1)
    at_once: int = _AT_ONCE
    whole_key: str = field(init=False, default="")
    key: str = field(init=False, default="")

    def __post_init__(self) -> None:
        digest = hashlib.sha256(repr([self.identity, self.size, computed_by()]).encode())
        digest.update(repr([*self.attributes.items(), *self.variables.items()]).encode())
        for name, values in self.all_coordinates.items():
            digest.update(f"\n{name} {values.dtype.str} {values.shape} ".encode())
            digest.update(np.ascontiguousarray(values).tobytes())
        object.__setattr__(self, "whole_key", digest.hexdigest())
        if self.part != (1, 1):
            digest.update(repr(self.part).encode())
        object.__setattr__(self, "key", digest.hexdigest())

    @property
    def all_coordinates(self) -> Arrays:
        """The values along each dimension, and the labels."""
        return {**self.coordinates, **{name: values for name, (_, values) in self.labels.items()}}

    @property
    def shape(self) -> tuple[int, ...]:
        """The lengths of the dimensions."""
        return tuple(len(values) for values in self.coordinates.values())

    @property
    def chunk(self) -> tuple[int, ...]:
        """The shape of a block: whole dimensions from the last one on, as many as it may hold."""
        room, lengths = self.size, list[int]()
        for length in reversed(self.shape):
            lengths.append(max(1, min(length, room)))
            room //= lengths[-1]
        return tuple(reversed(lengths))

    @property
    def computed(self) -> dict[str, Variable]:
        """The variables that blocks hold."""
        others = self.all_coordinates
        return {name: v for name, v in self.variables.items() if name not in others}

    def own(self, variable: Variable, along: Sequence[Item]) -> tuple[Item, ...]:
        """The items of the dimensions that a variable has, from one item for each dimension."""
        pairs = zip(self.coordinates, along, strict=True)
        return tuple(item for name, item in pairs if name not in variable.without)

    @property
    def items(self) -> list[Block]:
        """The blocks of the part."""
        index, count = self.part
        return self.blocks[index - 1 :: count]

    @property
    def blocks(self) -> list[Block]:
        """The blocks of all parts."""
        starts = (range(0, n, step) for n, step in zip(self.shape, self.chunk, strict=True))
        return [
            tuple(
                slice(start, min(start + step, n))
                for start, step, n in zip(place, self.chunk, self.shape, strict=True)
            )
            for place in product(*starts)
        ]

    def name(self, item: Block) -> str:
        """The name of a block: where it begins."""
        return "-".join(str(span.start) for span in item)

    def are_of(self, item: Block, arrays: Arrays) -> bool:
        """Whether arrays have the names, types and shapes of the variables in a block."""
        lengths = tuple(span.stop - span.start for span in item)
        return all(
            name in arrays
            and arrays[name].shape == self.own(variable, lengths)
            and arrays[name].dtype == variable.dtype
            for name, variable in self.computed.items()
        )

    def publish(self, shards: Shards) -> None:
        """Write the file: a chunk for each block, in their order."""
        with (
            replacing(self.path, shards.folder, former=None) as descriptor,
            written(descriptor) as (stream, file),
        ):
            datasets = self._created(file)
            for item in self.items:
                arrays = self.arrays(item, shards.read(self.name(item)))
                for name, dataset in datasets.items():
                    dataset[self.own(self.variables[name], item)] = arrays[name]
                stream.check()

    def _created(self, file: h5py.File) -> dict[str, h5py.Dataset]:
        """Write attributes and coordinates, and create the variables."""
        said = {"Conventions": "CF-1.8", _KEY: self.whole_key}
        if self.part != (1, 1):
            said[_PART] = "{} of {}".format(*self.part)
        write_attributes(file, {**self.attributes, **said})
        for name, values in self.all_coordinates.items():
            kind = h5py.string_dtype() if values.dtype.kind == "U" else values.dtype
            dataset = file.create_dataset(name, data=values.astype(kind), track_times=False)
            if name in self.coordinates:
                dataset.make_scale(name)
            else:
                dataset.dims[0].attach_scale(file[self.labels[name][0]])
            write_attributes(dataset, self.variables[name].attributes)
        datasets = {}
        for name, variable in self.computed.items():
            shape, chunk = self.own(variable, self.shape), self.own(variable, self.chunk)
            options = {"chunks": chunk, "fillvalue": variable.fill, **_FILTERS}
            created = file.create_dataset(name, shape, variable.dtype, track_times=False, **options)
            own = self.own(variable, [*self.coordinates])
            labelled = [label for label, (along, _) in self.labels.items() if along in own]
            coordinates = {"coordinates": " ".join(labelled)} if labelled else {}
            write_attributes(created, {**variable.attributes, **coordinates})
            for axis, dimension in enumerate(own):
                created.dims[axis].attach_scale(file[dimension])
            datasets[name] = created
        return datasets

    @property
    def is_published(self) -> bool:
        """Whether the file at the path is of this dataset, and of this part."""
        try:
            with h5py.File(self.path, "r") as file:
                part = (1, 1) if _PART not in file.attrs else _part(file)
                return _text(file, _KEY) == self.whole_key and part == self.part
        except (OSError, KeyError, ValueError, TypeError):
            return False

    def read(self) -> Arrays:
        """The variables of the file, whole."""
        with _opened(self.path) as file:
            return {name: file[name][()] for name in self.computed}


def ensure(
    dataset: Dataset, progress: Progress | None = None, executor: Executor | None = None
) -> None:
    """Compute the file of a dataset unless it is done already.

    ``progress`` is called with the number of finished blocks and of all blocks.

    OSError: the folder is missing, read-only or full, or another process computes this dataset;
    FileExistsError: another file is at the path, or was put there meanwhile; RuntimeError: workers
    died, or are of other code.
    """
    if dataset.is_published:
        if progress is not None:
            progress(len(dataset.items), len(dataset.items))
    elif os.path.lexists(dataset.path):
        raise FileExistsError(
            f"{dataset.path} exists, and holds something else or is of another version of jaxstab; "
            "remove it, or give another name."
        )
    else:
        complete(dataset, progress, executor)


def stored(
    dataset: Dataset, progress: Progress | None = None, executor: Executor | None = None
) -> Arrays:
    """Return the variables of a dataset, whole; arguments and errors as ``ensure``."""
    ensure(dataset, progress, executor)
    return dataset.read()


# What is read of files, chunk by chunk.


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    with named_errors("read", path):
        with path.open("rb"):  # HDF5's own sentences are long
            if not h5py.is_hdf5(path):
                raise ValueError(f"{path} is not an HDF5 file, or is damaged.")
        with h5py.File(path, "r") as file:
            yield file


class Header(NamedTuple):
    """Attributes and coordinates of a file; dimensions, units and long names by variable."""

    attributes: dict[str, str]
    coordinates: dict[str, NDArray[Any]]
    dimensions: dict[str, tuple[str, ...]]
    units: dict[str, str]
    long_names: dict[str, str]


def header_of(path: Path) -> Header:
    """The contents of the file of a dataset, without the values of its variables.

    OSError: it cannot be read; ValueError: it is no file of a dataset.
    """
    with _opened(path) as file:
        if _KEY not in file.attrs:
            raise ValueError(f"{path} is not a jaxstab dataset.")
        scales = {name for name in file if file[name].is_scale}
        return Header(
            {name: _text(file, name) for name in file.attrs},
            {name: _decoded(file[name][()]) for name in sorted(scales)},
            {
                name: tuple(str(dim[0].name)[1:] for dim in file[name].dims)
                for name in file
                if name not in scales
            },
            {name: _text(file[name], "units") for name in file},
            {name: _text(file[name], "long_name") for name in file},
        )


def chunks(path: Path, name: str) -> Iterator[tuple[Block, NDArray[Any]]]:
    """Yield the values of a variable, a chunk at a time, each with its block."""
    with _opened(path) as file:
        for block in file[name].iter_chunks():
            yield tuple(block), file[name][block]


def values(path: Path, name: str) -> NDArray[Any]:
    """Return the values of a variable, whole."""
    with _opened(path) as file:
        return _decoded(file[name][()])


def merged(parts: Sequence[Path], path: Path) -> None:
    """Put the files of all parts of a dataset together, chunk by chunk, as they are.

    ValueError: parts are of different datasets, missing or given twice; FileExistsError: another
    file is at the path; OSError: a file cannot be read or written.
    """
    if os.path.lexists(path):
        raise FileExistsError(f"{path} exists; remove it, or give another name.")
    own: dict[tuple[int, int], Path] = {}
    keys = dict[str, Path]()
    for each in parts:
        with _opened(each) as file:
            if _PART not in file.attrs or _KEY not in file.attrs:
                raise ValueError(f"{each} is no part of a study; give the files that --part wrote.")
            key, part = _text(file, _KEY), _part(file)
        keys.setdefault(key, each)
        if len(keys) > 1:
            base, other = keys.values()
            raise ValueError(
                f"{other} and {base} are parts of different studies, or of different versions of "
                "jaxstab; give those of one."
            )
        if part in own:
            raise ValueError(f"{each} and {own[part]} are the same part; give each once.")
        own[part] = each
    count = max((count for _, count in own), default=0)
    missing = [k for k in range(1, count + 1) if (k, count) not in own]
    if missing or not own:
        words = f"part {missing[0]} of {count} is missing" if own else "no part is given"
        raise ValueError(f"{words}; give the files of all parts.")
    base, *others = (own[part] for part in sorted(own))
    with replacing(path) as descriptor, written(descriptor, base) as (stream, target):
        del target.attrs[_PART]
        for other in others:
            with _opened(other) as source:
                _copy_chunks(source, target)
            stream.check()


@contextmanager
def written(descriptor: int, base: Path | None = None) -> Iterator[tuple[PatientStream, h5py.File]]:
    """Open an HDF5 file to write, empty or a copy; errors of the disk are raised when it is done.

    A long write calls ``PatientStream.check`` often.
    """
    stream = PatientStream(descriptor)
    if base is not None:
        with base.open("rb") as source:
            shutil.copyfileobj(source, stream)
        stream.check()
    with h5py.File(stream, "r+" if base else "w", libver=_FORMAT_VERSIONS) as file:
        yield stream, file
    stream.check()
    os.ftruncate(descriptor, stream.size)


def _copy_chunks(source: h5py.File, target: h5py.File) -> None:
    for name in source:
        if source[name].chunks is None:  # a coordinate
            continue
        chunks = source[name].id
        for index in range(chunks.get_num_chunks()):
            place = chunks.get_chunk_info(index).chunk_offset
            mask, raw = chunks.read_direct_chunk(place)
            target[name].id.write_direct_chunk(place, raw, mask)


def _part(file: h5py.File) -> tuple[int, int]:
    index, _, count = _text(file, _PART).partition(" of ")
    return int(index), int(count)


def _text(holder: h5py.File | h5py.Dataset, name: str) -> str:
    value = holder.attrs.get(name, b"")
    return value.decode() if isinstance(value, bytes) else str(value)


def _decoded(array: NDArray[Any]) -> NDArray[Any]:
    return array if array.dtype != object else np.array([text.decode() for text in array])


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
                f"{name} has the shape {array.shape}; for a file each array varies along a "
                "different axis: give those of np.ix_(...)."
            )
        owners |= dict.fromkeys(axes, name)
    return {owners[axis]: arrays[owners[axis]].ravel() for axis in sorted(owners)}


def write_attributes(to: h5py.File | h5py.Dataset, attributes: Mapping[str, Any]) -> None:
    """Write attributes; texts as UTF-8 of a fixed length."""
    for name, value in attributes.items():
        to.attrs[name] = np.bytes_(value.encode("utf-8")) if isinstance(value, str) else value
