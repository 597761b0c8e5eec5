"""Atlas files of schema version 2, which have no table, are written anew. No JAX.

HDF5 says where their arrays lie, and libhdf5 was not made for hostile files: so no reader opens
them, and who trusts one upgrades it. Verdicts of nodes far from the boundary are not proved there.
Spectral radii, which were interpolated between nodes, are computed anew.
"""

import io
import os
from collections.abc import Mapping
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxstab.atlas.compute.layout import Grid, radius_cells_of
from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.compute.radii import radii
from jaxstab.atlas.format import schema
from jaxstab.atlas.format.digest import digest_of
from jaxstab.atlas.format.filters import words_of
from jaxstab.atlas.format.footer import image_of
from jaxstab.atlas.format.schema import VARIABLES, Variable
from jaxstab.atlas.format.single import in_float32
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.format.table import DAMAGED, RefusalError, check
from jaxstab.atlas.read.chunks import Array, TooLargeError, check_axes, check_values, too_large
from jaxstab.atlas.write.merge import Filled, publish
from jaxstab.atlas.write.variables import write_variable
from jaxstab.conventions import AXES
from jaxstab.durable import named_errors

_VERSION = 2
_OF_LIMITS = ("limit_cell", "limit_term", schema.ALPHA_LIMITS)
_RADII = ("spectral_radius", "spectral_radius_error", "cell_spectral_radius_error")  # of nodes
_ROUNDING = b"radius_rounding "  # begins a line of the specification that has no meaning any more
_TERMS = 10  # of both limits: those by the delay were missing
_LIMITS = replace(
    VARIABLES[schema.ALPHA_LIMITS],
    dtype="float64",
    dimensions=("limit_cell", "gamma_cell", "delta_cell", "delay", "limit_term"),
)
_CELLS = {"alpha": "alpha_node", "beta": "beta_node", "gamma": "gamma", "delta": "delta"}
_TROUBLES = (ValueError, LookupError, TypeError, RuntimeError, OSError, MemoryError)


def upgrade_atlas(old: str | os.PathLike[str], new: str | os.PathLike[str]) -> None:
    """Write an atlas of schema version 2 anew, as files are today.

    Args:
        old: the file, which one trusts: HDF5 parses it.
        new: where the new file goes; a former one is replaced.

    Raises:
        OSError: the old file is missing or unreadable, or the new one cannot be written.
        ValueError: the old file is damaged, or not of version 2.

    Example:
        >>> jaxstab.upgrade_atlas("old.h5", "new.h5")  # doctest: +SKIP
    """
    path = Path(old)
    with named_errors("read", path):
        data = path.read_bytes()
    try:
        image = image_of(data)
        check(image is not None)
        arrays, created_by = _read(image or b"")
    except (RefusalError, TooLargeError) as refusal:
        raise ValueError(f"{path} {refusal}") from None

    def fill(file: h5py.File, _: object) -> Filled:
        datasets = {
            name: write_variable(file, variable, arrays[name])
            for name, variable in VARIABLES.items()
            if name in arrays
        }
        digests = [digest_of(name, dataset) for name, dataset in datasets.items()]
        return datasets, [one._replace(digests=list(one.digests)) for one in digests]

    publish(Path(new), created_by, words_of(None), fill)


def _read(image: bytes) -> tuple[dict[str, Array], str]:
    """Return the arrays of an HDF5 image by their names, and who made it."""
    try:
        with h5py.File(io.BytesIO(image), "r") as file:
            _check_version(file)
            variables = VARIABLES | {schema.ALPHA_LIMITS: _LIMITS}
            names = _names(file)
            arrays = {name: _values(file, variables[name]) for name in variables if name in names}
            created_by = bytes(_attribute(file, "created_by")).decode("ascii")
    except (RefusalError, TooLargeError):
        raise
    except _TROUBLES as error:
        raise RefusalError(DAMAGED) from error
    _check_together(arrays)
    arrays |= _spec_of_today(arrays[schema.SPEC])
    has_radii = not names.isdisjoint(_RADII)
    return arrays | _limits_of_today(arrays) | (
        _radii_of_today(arrays) if has_radii else {}
    ), created_by


def _check_version(file: h5py.File) -> None:
    version = _attribute(file, "schema_version")
    check(_attribute(file, "format") == np.bytes_(schema.FORMAT))
    if version != _VERSION:
        raise RefusalError(f"has schema version {version}; only version 2 needs to be upgraded.")


def _attribute(file: h5py.File, name: str) -> Any:
    identifier = file.attrs.get_id(name)
    size = identifier.dtype.itemsize
    check(identifier.shape == () and identifier.dtype.kind in "Si" and size <= schema.LONGEST_LINE)
    return file.attrs[name]


def _names(file: h5py.File) -> set[str]:
    """Return the names of the variables; there is nothing but them, and products are whole."""
    names = set(file)
    products = schema.PRODUCTS | {schema.ALPHA_LIMITS: _OF_LIMITS, schema.SPECTRAL_RADIUS: _RADII}
    chosen = [set(group) for group in products.values() if names & set(group)]
    check(chosen and names == schema.ALWAYS.union(*chosen))
    return names


def _values(file: h5py.File, variable: Variable) -> Array:
    check(isinstance(file.get(variable.name, getlink=True), h5py.HardLink))
    dataset = file[variable.name]
    check(isinstance(dataset, h5py.Dataset) and dataset.ndim == len(variable.dimensions))
    layout = dataset.id.get_create_plist()
    check(layout.get_layout() == h5py.h5d.CHUNKED and layout.get_external_count() == 0)
    # Missing chunks read as zeros without end.
    elements = max(dataset.size, prod(dataset.chunks))
    stored = dataset.id.get_storage_size() * schema.BEST_COMPRESSION
    check(0 < elements * dataset.dtype.itemsize <= stored)
    expected = dataset.dtype if variable.dtype == "S" else np.dtype(variable.dtype)
    check(dataset.dtype == expected and expected.kind == np.dtype(variable.dtype).kind)
    if dataset.nbytes > schema.LARGEST_ARRAY:
        raise TooLargeError(too_large(dataset.nbytes, variable.name, schema.LARGEST_ARRAY))
    values: Array = dataset[()]
    check_values(variable, values)
    values.flags.writeable = False
    return values


def _check_together(arrays: dict[str, Array]) -> None:
    """Refuse arrays that do not fit together."""
    lengths: dict[str, int] = {}
    for name, values in arrays.items():
        variable = _LIMITS if name == schema.ALPHA_LIMITS else VARIABLES[name]
        for dimension, length in zip(variable.dimensions, values.shape, strict=True):
            check(lengths.setdefault(dimension, length) == length)
    for axis, nodes in _CELLS.items():
        check(lengths[f"{axis}_cell"] == max(lengths[nodes] - 1, 1))
    check(lengths.get("limit_term", _TERMS) == _TERMS)
    axes = {name for name in arrays if VARIABLES[name].is_axis} | set(AXES)
    check_axes({name: arrays[name] for name in axes})
    for counts, dimension in schema.STRUNG.items():
        if counts in arrays:
            check(int(arrays[counts].sum(dtype=np.int64)) == lengths[dimension])


def _limits_of_today(arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Return the limits of alpha in single precision, each at the one delay of its cell."""
    if schema.ALPHA_LIMITS not in arrays:
        return {}
    delay, beta = arrays["delay"], arrays["beta"]
    ends = [axis[end] for axis in (arrays["alpha"], beta) for end in (0, -1)]
    hand = float(arrays["gamma"][-1]), float(arrays["delta"][-1])
    largest = float(np.max(np.abs(beta))), *hand, float(delay[-1])
    limits = []
    for old in np.split(arrays[schema.ALPHA_LIMITS], 2, axis=-1):
        still = np.zeros((*old.shape[:-1], 5))
        terms = np.concatenate([old[..., :4], still, old[..., 4:]], axis=-1)
        limits.append(in_float32(terms, largest))
    return {
        schema.LIMIT_RANGE: np.column_stack([delay, delay, *ends]),
        schema.ALPHA_LIMITS: np.concatenate(limits, axis=-1),
        "limit_term": np.arange(2 * schema.LIMIT_TERMS, dtype=np.int32),
        "delay_cell": np.arange(delay.size, dtype=np.int32),
        "limit_end": np.arange(6, dtype=np.int32),
    }


def _spec_of_today(lines: Array) -> dict[str, Array]:
    kept = np.array([line for line in lines.tolist() if not line.startswith(_ROUNDING)])
    return {schema.SPEC: kept, "spec_line": np.arange(kept.size, dtype=np.int32)}


def _radii_of_today(arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Compute the spectral radii at the delays of the atlas."""
    alpha, beta, gamma, delta, delay = (arrays[name] for name in AXES)
    cells = radius_cells_of(len(alpha), len(beta), gamma.size, delta.size)
    ends = np.column_stack(
        [delay, delay, *(axis[end] for axis in (alpha, beta) for end in (0, -1))]
    )
    grid = Grid(alpha, beta, gamma, delta, delay, 1, ends, cells, ends)
    plan = Plan(AtlasSpec(), grid)
    parts = [radii(plan, Tile(0, range(1), number)) for number in range(delay.size)]
    kinds, terms = (
        np.concatenate([part[name] for part in parts], axis=-1)
        for name in (schema.RADIUS_KIND, schema.RADIUS_TERMS)
    )
    known = {schema.RADIUS_KIND: kinds, schema.RADIUS_TERMS: terms, schema.RADIUS_RANGE: ends}
    lengths = grid.lengths | {schema.RADIUS_ROW: terms.shape[-1]}
    others = set(schema.PRODUCTS[schema.SPECTRAL_RADIUS]) - set(known)
    return known | {name: np.arange(lengths[name], dtype=np.int32) for name in others}
