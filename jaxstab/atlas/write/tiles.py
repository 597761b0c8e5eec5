"""Building an atlas as a job in tiles, and how these become one file.

A tile has the values of its variables; of those over nodes and cells, which are many, the chunk of
the file, compressed by the worker, with the digest of its values. ``jaxstab.tiles`` stores it.

At the end the tiles are merged, with one of them in memory at a time. Chunks are copied as they are
to their places; lists (outlines, corners) are strung together in the order of the tiles. Table and
footer follow the image, and the file is opened once before it takes the place of a former one.
"""

import hashlib
import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

import jaxstab
from jaxstab.atlas.file import TooLargeError, check_values, contents_of, table_in, unpacked
from jaxstab.atlas.plan import Plan, Tile, compute_tile, plan_atlas
from jaxstab.atlas.product import LARGEST_UNASKED, SPEC
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.schema import (
    ALWAYS,
    SCHEMA_VERSION,
    VARIABLES,
    RefusalError,
    Stored,
    content_digest,
    footer_of,
    head_attributes,
    stored_of,
    table_text,
    values_digest,
)
from jaxstab.atlas.spec import AtlasSpec, words_of
from jaxstab.atlas.write.variables import create_variable, packed, places_of, write_variable
from jaxstab.conventions import AXES
from jaxstab.datasets import write_attributes, written
from jaxstab.durable import PatientStream, replacing, write_all
from jaxstab.tiles import Arrays, Job, Shards, computed_by

_DIGEST = "{} sha256"  # name, in a tile, of the digest of the values in a chunk
_NODES_IN_FLIGHT = 2**26


def build_key(spec: AtlasSpec) -> str:
    """Return the hash of a specification and of what computes it; other tiles do not match it."""
    words = "\n".join([spec.to_toml(), str(SCHEMA_VERSION), computed_by()])
    return hashlib.sha256(words.encode()).hexdigest()


@dataclass(frozen=True)
class Build(Job[Tile]):
    """The job of building an atlas: its specification, its key and where the file goes."""

    spec: AtlasSpec
    key: str
    path: Path

    @cached_property
    def plan(self) -> Plan:
        """The plan, made when the place of the file is known to be good."""
        return plan_atlas(self.spec)

    @property
    def items(self) -> list[Tile]:
        return self.plan.tiles

    @property
    def at_once(self) -> int:
        alphas, betas, *_ = self.plan.grid.shape
        return max(2, _NODES_IN_FLIGHT // (self.plan.deltas_of_a_tile * alphas * betas))

    def name(self, item: Tile) -> str:
        return f"{item.delay}-{item.gamma}-{item.delta.start}"

    def compute(self, item: Tile) -> Arrays:
        return packed_tile(self.plan, item, compute_tile(self.plan, item))

    def are_of(self, item: Tile, arrays: Arrays) -> bool:
        held = _held(self.plan, item)
        digests = {_DIGEST.format(name) for name in held if VARIABLES[name].is_packed}
        return arrays.keys() == {*held, *digests} and all(
            arrays[name].dtype == VARIABLES[name].dtype and shape in (None, arrays[name].shape)
            for name, shape in held.items()
            if not VARIABLES[name].is_packed
        )

    def are_sound(self, item: Tile, arrays: Arrays) -> bool:
        try:
            for name, shape in _held(self.plan, item).items():
                variable, values = VARIABLES[name], arrays[name]
                if not variable.is_packed or shape is None:
                    check_values(variable, values)
                    continue
                digests, places = [str(arrays[_DIGEST.format(name)])], [(0, values.size)]
                dtype, chunk = np.dtype(variable.dtype).newbyteorder("<"), self.plan.chunk(name)
                unpacked(values.tobytes(), Stored(variable, dtype, shape, chunk, digests, places))
        except RefusalError:
            return False
        return True

    def publish(self, shards: Shards) -> None:
        merge(self, shards, f"jaxstab {jaxstab.__version__}")


def packed_tile(plan: Plan, tile: Tile, arrays: Arrays) -> Arrays:
    """The arrays of a tile; those over nodes and cells as chunks of the file, with digests."""
    image = Arrays()
    for name, shape in _held(plan, tile).items():
        variable, values = VARIABLES[name], arrays[name]
        if values.dtype != variable.dtype or shape not in (None, values.shape):
            raise RuntimeError(
                f"{name} was computed as {values.dtype} of shape {values.shape}, not as "
                f"{variable.dtype} of shape {shape}; compare the versions of the worker."
            )
        try:  # values are not decoded again in this build
            check_values(variable, values)
        except RefusalError as error:
            raise RuntimeError(
                f"{name} was computed out of its range; please report this."
            ) from error
        image[name] = values
        if variable.is_packed:
            whole = np.zeros(plan.chunk(name), np.dtype(variable.dtype).newbyteorder("<"))
            whole[tuple(map(slice, values.shape))] = values
            image[name] = np.frombuffer(packed(whole), np.uint8)
            image[_DIGEST.format(name)] = np.array(values_digest(values))
    return image


def _held(plan: Plan, tile: Tile) -> dict[str, tuple[int, ...] | None]:
    """Return the variables in a tile with their shapes; None for lists, of any length."""
    chosen = (PRODUCTS[product] for product in plan.spec.products)
    names = (v.name for p in chosen for v in p.variables if not v.is_axis and v.name not in p.fixed)
    shapes = {name: plan.shape(name, tile) if plan.is_gridded(name) else None for name in names}
    return {name: shape for name, shape in shapes.items() if shape is None or 0 not in shape}


# ------------------------------------------------------------------------------ tiles to one file

_FLAT_CHUNK = 2**16  # values of a chunk of rows


def merge(build: Build, shards: Shards, created_by: str) -> None:
    """Publish the atlas of which all tiles are done; if it fails, a former file is still there."""
    plan, path = build.plan, build.path
    filters = words_of(plan.spec.filters)
    with replacing(path, shards.folder, shards.former) as descriptor:
        with written(descriptor) as (stream, file):
            write_attributes(file, head_attributes(created_by, filters))
            datasets = _create_variables(file, build, shards)
            copied = _copy_tiles(datasets, build, shards, stream)
            variables = [
                stored_of(name, dataset, [own for _, own in sorted(copied[name].items())])
                for name, dataset in datasets.items()
            ]
            digest = content_digest(variable.line for variable in variables)
            write_attributes(file, {"content_sha256": digest})
            for product_name in plan.spec.products:
                write_attributes(file, PRODUCTS[product_name].attributes(datasets))
            file.flush()
            pairs = zip(variables, datasets.values(), strict=True)
            variables = [replace(v, places=places_of(dataset)) for v, dataset in pairs]
        os.lseek(descriptor, stream.size, os.SEEK_SET)
        table = table_text(created_by, filters, variables)
        write_all(descriptor, table)
        with open(descriptor, "rb", buffering=0, closefd=False) as whole:
            write_all(descriptor, footer_of(whole, stream.size + len(table), stream.size))
            _check_whole(path, whole)


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


def _create_variables(file: h5py.File, build: Build, shards: Shards) -> dict[str, h5py.Dataset]:
    """Write the variables known without the tiles, and allocate the others."""
    plan = build.plan
    names = ALWAYS.union(*(PRODUCTS[product].names for product in plan.spec.products))
    lengths = plan.grid.lengths | _flat_lengths(build, shards)
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
    lines = np.array([line.encode("utf-8") for line in plan.spec.to_toml().splitlines()])
    given = {SPEC: lines} | {name: getattr(plan.grid, name) for name in AXES}
    for chosen in plan.spec.products:
        given |= PRODUCTS[chosen].known_before(plan.grid, plan.spec.filters)
    counted = {**lengths, "spec_line": lines.size}
    numbers = {name: np.arange(count, dtype=np.int32) for name, count in counted.items()}
    return numbers | given


def _flat_lengths(build: Build, shards: Shards) -> dict[str, int]:
    """Return the total length of all tiles along each dimension that is not one of the grid."""
    flat = [name for name, shape in _held(build.plan, build.items[0]).items() if shape is None]
    along = {VARIABLES[name].dimensions[0]: name for name in flat}
    lengths = dict.fromkeys(along, 0)
    for tile in build.items if along else ():
        arrays = build.arrays(tile, shards.read(build.name(tile)))
        for dimension, name in along.items():
            lengths[dimension] += len(arrays[name])
    return lengths


_Digests = dict[str, dict[tuple[int, ...], str]]  # of chunks that were copied


def _copy_tiles(
    datasets: Mapping[str, h5py.Dataset], build: Build, shards: Shards, stream: PatientStream
) -> _Digests:
    """Put the tiles in their places, chunks as they are; string lists together in their order."""
    plan, digests = build.plan, _Digests({name: {} for name in datasets})
    filled = dict.fromkeys(datasets, 0)
    for tile in plan.tiles:
        arrays = build.arrays(tile, shards.read(build.name(tile)))
        for name, shape in _held(plan, tile).items():
            dataset, values = datasets[name], arrays[name]
            if shape is None:
                dataset[filled[name] : filled[name] + len(values)] = values
                filled[name] += len(values)
                continue
            spans = [plan.numbers(dimension, tile) for dimension in VARIABLES[name].dimensions]
            if VARIABLES[name].is_packed:
                corner = tuple(span.start for span in spans)
                dataset.id.write_direct_chunk(corner, values.tobytes())
                digests[name][corner] = str(arrays[_DIGEST.format(name)])
            else:
                dataset[tuple(slice(span.start, span.stop) for span in spans)] = values
        stream.check()
    return digests
