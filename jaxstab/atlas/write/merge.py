"""The tiles of a build become one file: chunks are copied as they are, one tile at a time."""

import io
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from math import prod
from operator import add
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.format import schema
from jaxstab.atlas.format.schema import (
    VARIABLES,
    Chunked,
    content_digest,
    digest_of,
    footer_of,
)
from jaxstab.atlas.format.spec import words_of
from jaxstab.atlas.format.table import RefusalError, table_text
from jaxstab.atlas.format.variables import LARGEST_UNASKED, SPEC
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.read.file import TooLargeError, contents_of, table_in
from jaxstab.atlas.write.tiles import VALUES_DIGEST, Shards
from jaxstab.atlas.write.variables import (
    FORMAT_VERSIONS,
    create_variable,
    places_of,
    write_content_digest,
    write_head,
    write_variable,
)
from jaxstab.durable import PatientStream, replacing, write_all

_FLAT_CHUNK = 2**16  # values of what is strung together


def merge(plan: Plan, shards: Shards, path: Path, created_by: str) -> None:
    """Publish the atlas of which all tiles are done.

    Raises:
        OSError: the folder is read-only or full; a former file is still there.
        ValueError: a tile was damaged since it was looked at, or the tiles make no atlas that
            could be opened; a former file is still there.
    """
    filters = words_of(plan.spec.filters)
    with replacing(path, shards.folder) as descriptor:
        stream = PatientStream(descriptor)
        with h5py.File(stream, "w", libver=FORMAT_VERSIONS) as file:
            write_head(file, created_by, filters)
            datasets = _create_variables(file, plan, shards)
            variables = list(_chunked(datasets, _copy_tiles(datasets, plan, shards, stream)))
            write_content_digest(file, content_digest(variables))
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
            dict(contents_of(path, written.readall()).arrays)
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
    """Write what is known without the tiles, and make room for the rest."""
    names = schema.ALWAYS.union(*(PRODUCTS[product].names for product in plan.spec.products))
    lengths = plan.grid.lengths | _flat_lengths(plan, shards, names)
    known = _known_variables(plan, lengths)
    datasets = {}
    for name, variable in VARIABLES.items():
        if name in known and name in names:
            datasets[name] = write_variable(file, variable, known[name])
        elif name in names:
            shape = [lengths[dimension] for dimension in variable.dimensions]
            chunk = plan.chunk(name) if plan.is_gridded(name) else _flat_chunk(shape)
            datasets[name] = create_variable(file, variable, shape, chunk, np.dtype(variable.dtype))
    return datasets


def _flat_chunk(shape: Sequence[int]) -> list[int]:
    *others, length = shape
    return [*others, max(1, min(length, _FLAT_CHUNK // prod(others)))]


def _known_variables(plan: Plan, lengths: Mapping[str, int]) -> dict[str, NDArray[Any]]:
    """Return the axes and the specification."""
    grid = plan.grid
    lines = np.array([line.encode("utf-8") for line in plan.spec.to_toml().splitlines()])
    known: dict[str, NDArray[Any]] = {
        "alpha": grid.alpha,
        "beta": grid.beta,
        "gamma": grid.gamma,
        "delta": grid.delta,
        "delay": grid.delay,
        SPEC: lines,
    }
    for chosen in plan.spec.products:
        known |= PRODUCTS[chosen].known_before(grid, plan.spec.filters)
    counted = {**lengths, "spec_line": lines.size}
    numbers = {name: np.arange(count, dtype=np.int32) for name, count in counted.items()}
    return numbers | known


def _flat_lengths(plan: Plan, shards: Shards, names: Iterable[str]) -> dict[str, int]:
    """Return the total length of all tiles along each dimension that is not one of the grid."""
    flat = [n for n in names if not (plan.is_gridded(n) or VARIABLES[n].is_axis or n == SPEC)]
    lengths = {VARIABLES[name].dimensions[-1]: 0 for name in flat}
    for tile in plan.tiles if flat else ():
        with shards.opened(plan, tile) as image:
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
        with shards.opened(plan, tile) as image:
            for name, part in image.items():
                if plan.is_gridded(name):
                    first = _place(plan, name, tile)
                    starts = product(*map(range, [0] * part.ndim, part.shape, part.chunks))
                    of_chunks = part.attrs[VALUES_DIGEST].decode().split(" ")
                    for start, digest in zip(starts, of_chunks, strict=True):
                        mask, chunk = part.id.read_direct_chunk(start)
                        place = tuple(map(add, first, start))
                        datasets[name].id.write_direct_chunk(place, chunk, mask)
                        digests.setdefault(name, {})[place] = digest
                else:
                    length = part.shape[-1]
                    datasets[name][..., filled[name] : filled[name] + length] = part[()]
                    filled[name] += length
        stream.check()
    return digests


def _place(plan: Plan, name: str, tile: Tile) -> tuple[int, ...]:
    return tuple(plan.numbers(dimension, tile).start for dimension in VARIABLES[name].dimensions)


def _chunked(datasets: Mapping[str, h5py.Dataset], digests: _Digests) -> Iterator[Chunked]:
    for name, dataset in datasets.items():
        whole = digest_of(name, dataset)
        copied = [digest for _, digest in sorted(digests.get(name, {}).items())]
        yield whole._replace(digests=copied or list(whole.digests))
