"""The images of tiles, and how they become one file.

``jaxstab.tiles`` stores the image of each tile that is done. A tile counts if it is of this build
and this code, and as the schema says.

At the end the tiles are merged, with one of them in memory at a time. The chunks of variables over
a grid are copied as they are, compressed, to their places; lists (outlines, corners) are
strung together in the order of the tiles. Table and footer follow the image, and the file is opened
once before it takes the place of a former one.
"""

import hashlib
import io
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from itertools import product
from math import prod
from operator import add
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.file import TooLargeError, check_values, contents_of, table_in, unpacked
from jaxstab.atlas.plan import Plan, Tile
from jaxstab.atlas.product import LARGEST_UNASKED, SPEC
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.schema import (
    ALWAYS,
    SCHEMA_VERSION,
    VARIABLES,
    Chunked,
    RefusalError,
    check,
    content_digest,
    digest_of,
    footer_of,
    head_attributes,
    image_of,
    sealed,
    table_text,
    values_digest,
)
from jaxstab.atlas.spec import AtlasSpec, words_of
from jaxstab.atlas.write.variables import (
    TROUBLES,
    checked_layout,
    create_variable,
    filters_of,
    packed,
    places_of,
    write_variable,
)
from jaxstab.datasets import FORMAT_VERSIONS, write_attributes
from jaxstab.durable import PatientStream, replacing, write_all
from jaxstab.tiles import Shards, computed_by

VALUES_DIGEST = "values_sha256"
_TILE = "tile"
_MAKER = "computed_by"


def build_key(spec: AtlasSpec) -> str:
    """Return the hash of a specification and of what computes it; other tiles do not match it."""
    words = "\n".join([spec.to_toml(), str(SCHEMA_VERSION), computed_by()])
    return hashlib.sha256(words.encode()).hexdigest()


def encode_tile(plan: Plan, tile: Tile, key: str, arrays: dict[str, NDArray[Any]]) -> bytes:
    """The sealed image of a tile; its chunks are those of the atlas."""
    with h5py.File.in_memory(libver=FORMAT_VERSIONS) as file:
        file.attrs[_TILE] = np.bytes_(_title(key, tile))
        file.attrs[_MAKER] = np.bytes_(computed_by())
        for name, values in arrays.items():
            _check_shape(plan, tile, name, values)
            if values.size:
                _check_range(name, values)
                chunk = plan.chunk(name) if plan.is_gridded(name) else values.shape
                _write(file, name, values, chunk)
        file.flush()
        return sealed(bytes(file.id.get_file_image()))


@contextmanager
def opened_tile(plan: Plan, tile: Tile, key: str, image: bytes) -> Iterator[h5py.File]:
    """Open the image of a tile in memory, after a check of its layout and of who computed it."""
    with _whole_image(tile, image) as file:
        try:
            maker = bytes(file.attrs.get(_MAKER, b"an older jaxstab")).decode("utf-8")
            if maker == computed_by():
                check(bytes(file.attrs[_TILE]).decode("utf-8") == _title(key, tile))
                _check_datasets(file, plan, tile)
        except TROUBLES as error:
            raise ValueError(
                f"tile {name_of(tile)} is not of this build; build the same atlas again."
            ) from error
        if maker != computed_by():
            raise RuntimeError(
                f"a worker computes with {maker}, and this build with {computed_by()}; install the "
                "same for all workers."
            )
        yield file


@contextmanager
def _whole_image(tile: Tile, image: bytes) -> Iterator[h5py.File]:
    """Open the image of a tile in memory, if all of its bytes are those that were sealed."""
    whole = image_of(image)
    if whole is None:
        raise ValueError(f"tile {name_of(tile)} is damaged; build the same atlas again.")
    with h5py.File.in_memory(whole) as file:
        yield file


def stored_tile(shards: Shards, tile: Tile) -> AbstractContextManager[h5py.File]:
    """Open the image of a stored tile that was checked; ValueError: it is damaged."""
    return _whole_image(tile, shards.read(name_of(tile)))


def is_whole(plan: Plan, tile: Tile, key: str, image: bytes) -> bool:
    """Whether the image of a tile is whole and of this build."""
    try:
        with opened_tile(plan, tile, key, image) as file:
            _check_contents(file, plan, tile)
            return True
    except TROUBLES:
        return False


def _check_datasets(file: h5py.File, plan: Plan, tile: Tile) -> None:
    """Refuse other variables than those of a tile, and chunks of other shapes."""
    chosen = [PRODUCTS[product] for product in plan.spec.products]
    held = [v.name for p in chosen for v in p.variables if not v.is_axis and v.name not in p.fixed]
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
        check(isinstance(dataset.attrs[VALUES_DIGEST], np.bytes_))


def _check_contents(file: h5py.File, plan: Plan, tile: Tile) -> None:
    """Refuse values out of their ranges, and others than those of the digests."""
    for name, dataset in file.items():
        shape = plan.shape(name, tile) if plan.is_gridded(name) else dataset.shape
        values = dataset[()][tuple(map(slice, shape))]
        check_values(VARIABLES[name], values)
        said = bytes(dataset.attrs[VALUES_DIGEST]).decode("ascii").split(" ")
        check(said == [values_digest(chunk) for chunk in _parts(values, dataset.chunks)])


def _whole_chunks(shape: Sequence[int], chunk: Sequence[int]) -> tuple[int, ...]:
    return tuple(-(-n // step) * step for n, step in zip(shape, chunk, strict=True))


def _parts(values: NDArray[Any], chunk: Sequence[int]) -> Iterator[NDArray[Any]]:
    starts = product(*(range(0, n, step) for n, step in zip(values.shape, chunk, strict=True)))
    return (values[tuple(map(slice, start, np.add(start, chunk)))] for start in starts)


def name_of(tile: Tile) -> str:
    """Return the name of a tile."""
    return f"{tile.delay}-{tile.gamma}-{tile.delta.start}"


def _title(key: str, tile: Tile) -> str:
    return f"{key} {tile.delay} {tile.gamma} {tile.delta.start} {tile.delta.stop}"


def _check_shape(plan: Plan, tile: Tile, name: str, values: NDArray[Any]) -> None:
    dtype = np.dtype(VARIABLES[name].dtype)
    shape = plan.shape(name, tile) if plan.is_gridded(name) else values.shape
    if values.dtype != dtype or values.shape != shape:
        raise RuntimeError(
            f"{name} was computed as {values.dtype} of shape {values.shape}, not as {dtype} of "
            f"shape {shape}; compare the versions of the worker."
        )


def _check_range(name: str, values: NDArray[Any]) -> None:
    """Refuse values that the schema does not allow; they are not decoded again in this build."""
    try:
        check_values(VARIABLES[name], values)
    except RefusalError as error:
        raise RuntimeError(f"{name} was computed out of its range; please report this.") from error


def _write(file: h5py.File, name: str, values: NDArray[Any], chunk: Sequence[int]) -> None:
    shape, dtype = _whole_chunks(values.shape, chunk), values.dtype.newbyteorder("<")
    whole = values.astype(dtype, copy=False)
    if shape != values.shape:
        whole = np.zeros(shape, dtype)
        whole[tuple(map(slice, values.shape))] = values
    variable, layout = VARIABLES[name], {"chunks": tuple(chunk), "dtype": dtype}
    dataset = file.create_dataset(name, shape, **layout, **filters_of(variable))
    if variable.is_packed and not variable.holds_verdicts:  # codes deflate better by zlib
        dataset.id.write_direct_chunk((0,) * whole.ndim, packed(whole))
    else:
        dataset[...] = whole
    dataset.attrs[VALUES_DIGEST] = np.bytes_(" ".join(map(values_digest, _parts(values, chunk))))


# ------------------------------------------------------------------------------ tiles to one file

_FLAT_CHUNK = 2**16  # values of a chunk of rows


def merge(plan: Plan, shards: Shards, path: Path, created_by: str) -> None:
    """Publish the atlas of which all tiles are done; if it fails, a former file is still there."""
    filters = words_of(plan.spec.filters)
    with replacing(path, shards.folder) as descriptor:
        stream = PatientStream(descriptor)
        with h5py.File(stream, "w", libver=FORMAT_VERSIONS) as file:
            write_attributes(file, head_attributes(created_by, filters))
            datasets = _create_variables(file, plan, shards)
            variables = list(_chunked(datasets, _copy_tiles(datasets, plan, shards, stream)))
            write_attributes(file, {"content_sha256": content_digest(variables)})
            for product_name in plan.spec.products:
                write_attributes(file, PRODUCTS[product_name].attributes(datasets))
            file.flush()
            places = {name: places_of(dataset) for name, dataset in datasets.items()}
        stream.check()
        os.ftruncate(descriptor, stream.size)
        os.lseek(descriptor, stream.size, os.SEEK_SET)
        table = table_text(created_by, filters, variables, places)
        write_all(descriptor, table)
        with open(descriptor, "rb", buffering=0, closefd=False) as written:
            write_all(descriptor, footer_of(written, stream.size + len(table), stream.size))
            _check_whole(path, written)


def _check_whole(path: Path, written: io.FileIO) -> None:
    """Refuse what could not be opened, before it takes the place of a former file."""
    try:
        if written.seek(0, io.SEEK_END) <= LARGEST_UNASKED:
            written.seek(0)
            data = written.readall()
            contents_of(path, data)
            for stored in table_in(io.BytesIO(data)).variables.values():
                unpacked(data, stored)  # one at a time: all of them may fill the memory
        else:
            table_in(written)
    except TooLargeError:
        pass
    except (RefusalError, ValueError) as error:
        raise ValueError(
            f"the tiles of {path} make no sound atlas; remove .{path.name}.*.tiles beside it and "
            "build again."
        ) from error


def _create_variables(file: h5py.File, plan: Plan, shards: Shards) -> dict[str, h5py.Dataset]:
    """Write the variables known without the tiles, and allocate the others."""
    names = ALWAYS.union(*(PRODUCTS[product].names for product in plan.spec.products))
    lengths = plan.grid.lengths | _flat_lengths(plan, shards, names)
    given = _known_variables(plan, lengths)
    datasets = {}
    for name, variable in VARIABLES.items():
        if name in given and name in names:
            datasets[name] = write_variable(file, variable, given[name])
        elif name in names:
            shape = [lengths[dimension] for dimension in variable.dimensions]
            *others, length = shape
            flat = (*others, max(1, min(length, _FLAT_CHUNK // prod(others))))
            chunk = plan.chunk(name) if plan.is_gridded(name) else flat
            datasets[name] = create_variable(file, variable, shape, chunk, np.dtype(variable.dtype))
    return datasets


def _known_variables(plan: Plan, lengths: Mapping[str, int]) -> dict[str, NDArray[Any]]:
    grid = plan.grid
    lines = np.array([line.encode("utf-8") for line in plan.spec.to_toml().splitlines()])
    given: dict[str, NDArray[Any]] = {
        "alpha": grid.alpha,
        "beta": grid.beta,
        "gamma": grid.gamma,
        "delta": grid.delta,
        "delay": grid.delay,
        SPEC: lines,
    }
    for chosen in plan.spec.products:
        given |= PRODUCTS[chosen].known_before(grid, plan.spec.filters)
    counted = {**lengths, "spec_line": lines.size}
    numbers = {name: np.arange(count, dtype=np.int32) for name, count in counted.items()}
    return numbers | given


def _flat_lengths(plan: Plan, shards: Shards, names: Iterable[str]) -> dict[str, int]:
    """Return the total length of all tiles along each dimension that is not one of the grid."""
    flat = [n for n in names if not (plan.is_gridded(n) or VARIABLES[n].is_axis or n == SPEC)]
    lengths = {VARIABLES[name].dimensions[-1]: 0 for name in flat}
    for tile in plan.tiles if flat else ():
        with stored_tile(shards, tile) as image:
            sizes = {
                VARIABLES[name].dimensions[-1]: image[name].shape[-1]
                for name in flat
                if name in image
            }
        lengths |= {dimension: lengths[dimension] + size for dimension, size in sizes.items()}
    return lengths


_Digests = dict[str, dict[tuple[int, ...], str]]


def _copy_tiles(
    datasets: Mapping[str, h5py.Dataset], plan: Plan, shards: Shards, stream: PatientStream
) -> _Digests:
    """Copy the chunks of gridded variables, and string the others together in the tiles' order."""
    digests: _Digests = {}
    filled = dict.fromkeys(datasets, 0)
    for tile in plan.tiles:
        with stored_tile(shards, tile) as image:
            for name, shard in image.items():
                if plan.is_gridded(name):
                    dimensions = VARIABLES[name].dimensions
                    corner = tuple(plan.numbers(dimension, tile).start for dimension in dimensions)
                    starts = product(*map(range, [0] * shard.ndim, shard.shape, shard.chunks))
                    of_chunks = shard.attrs[VALUES_DIGEST].decode().split(" ")
                    for start, digest in zip(starts, of_chunks, strict=True):
                        mask, chunk = shard.id.read_direct_chunk(start)
                        place = tuple(map(add, corner, start))
                        datasets[name].id.write_direct_chunk(place, chunk, mask)
                        digests.setdefault(name, {})[place] = digest
                else:
                    length = shard.shape[-1]
                    datasets[name][..., filled[name] : filled[name] + length] = shard[()]
                    filled[name] += length
        stream.check()
    return digests


def _chunked(datasets: Mapping[str, h5py.Dataset], digests: _Digests) -> Iterator[Chunked]:
    for name, dataset in datasets.items():
        whole = digest_of(name, dataset)
        copied = [digest for _, digest in sorted(digests.get(name, {}).items())]
        yield whole._replace(digests=copied or list(whole.digests))
