"""Labelled tables: arrays over named dimensions, computed in blocks by dask, kept as netCDF-4.

A function of plain arrays is applied to columns, which are labelled: ``xarray.apply_ufunc`` cuts
the grid of their dimensions into blocks, and dask computes these where it is told to: in threads or
processes (``dask.config.set(scheduler="processes")``), or by the workers of the
``distributed.Client`` that is open. By default one block follows another in this process, as the
programs of JAX in a block use all cores and the memory is that of one block.

Nothing is kept of a table that is not finished. A finished one is written to memory, and then in
one step to a path at which nothing may have appeared meanwhile.
"""

import os
from collections.abc import Callable, Mapping
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxstab.durable import is_memory_short, named_errors, replacing, require_no_output, write_all

if TYPE_CHECKING:
    from xarray import DataArray, Dataset


class Variable(NamedTuple):
    """A variable: its description, its unit, and its codes, if its numbers are these.

    along: a dimension that the function itself adds at the end.
    """

    long_name: str
    units: str = "1"
    codes: type[IntEnum] | None = None
    along: tuple[str, ...] = ()

    @property
    def dtype(self) -> str:
        """The type of its numbers."""
        return "int8" if self.codes else "float64"

    @property
    def attributes(self) -> dict[str, Any]:
        """The attributes of the variable, as CF names them."""
        attributes: dict[str, Any] = {"long_name": self.long_name, "units": self.units}
        if self.codes:
            attributes["flag_values"] = np.array([*self.codes], self.dtype)
            attributes["flag_meanings"] = " ".join(code.name.lower() for code in self.codes)
        return attributes


def xarray_module() -> Any:
    """Return xarray; RuntimeError where it, dask or h5netcdf is missing."""
    try:
        import dask.array  # noqa: F401
        import h5netcdf  # noqa: F401
        import xarray
    except ImportError as error:
        raise RuntimeError(
            f"labelled tables need xarray, dask and h5netcdf, and {error.name} is missing: "
            "python -m pip install 'jaxstab[study]'."
        ) from error
    return xarray


def table_of(
    function: Callable[..., Any],
    columns: Mapping[str, "DataArray"],
    variables: Mapping[str, Variable],
    size: int,
    added: Mapping[str, int],
) -> "Dataset":
    """Return the variables that a function makes of columns, to be computed block by block.

    The function takes arrays that broadcast and returns a tuple of arrays, one for each variable;
    it can be pickled. ``size`` is the most points of a block; ``added`` are the lengths of the
    dimensions that the function adds.
    """
    xarray = xarray_module()
    lengths = {name: n for column in columns.values() for name, n in column.sizes.items()}
    chunks = dict[str, int]()
    for name, length in reversed(lengths.items()):  # whole dimensions from the last one on
        chunks[name] = max(1, min(length, size))
        size //= chunks[name]
    used = {name for variable in variables.values() for name in variable.along}
    found = xarray.apply_ufunc(
        function if len(variables) > 1 else partial(_only, function),
        *(
            column.chunk({name: chunks[name] for name in column.dims})
            for column in columns.values()
        ),
        output_core_dims=[variable.along for variable in variables.values()],
        output_dtypes=[variable.dtype for variable in variables.values()],
        dask="parallelized",
        dask_gufunc_kwargs={"output_sizes": {name: added[name] for name in used}},
    )
    arrays = found if len(variables) > 1 else [found]
    named = zip(variables.items(), arrays, strict=True)
    return xarray.Dataset(
        {name: array.assign_attrs(own.attributes) for (name, own), array in named}
    )


def _only(function: Callable[..., Any], *columns: Any) -> Any:
    (one,) = function(*columns)  # xarray takes a single variable as it is
    return one


def computed(table: "Dataset") -> "Dataset":
    """Return a table with its values, computed by the scheduler of dask that is set, if any."""
    from dask.base import get_scheduler

    return table.compute(**({} if get_scheduler() else {"scheduler": "synchronous"}))


def require_free(path: Path) -> None:
    """Refuse a path at which there is something; FileExistsError."""
    if os.path.lexists(path):
        raise FileExistsError(f"{path} exists; remove it, or give another name.")


def write(table: "Dataset", path: Path) -> None:
    """Write a table as a netCDF-4 file, whole or not at all; FileExistsError, OSError."""
    stored = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
    encoding = {name: stored for name in table.data_vars if table[name].ndim}
    with (
        table.to_netcdf(engine="h5netcdf", encoding=encoding) as image,
        replacing(path, former=None) as descriptor,
    ):
        write_all(descriptor, image)


def read(path: Path) -> "Dataset":
    """Return the table in a file, whole; OSError: it cannot be read; ValueError: it is no table."""
    xarray = xarray_module()
    require_no_output(path)
    with named_errors("read", path), path.open("rb"):
        pass
    unreadable = AttributeError, IndexError, KeyError, OSError, RuntimeError, TypeError, ValueError
    try:
        return xarray.load_dataset(path, engine="h5netcdf")
    except unreadable as error:
        if is_memory_short():
            raise MemoryError(f"there is not enough memory to read {path}.") from error
        raise ValueError(f"{path} is not a netCDF-4 file, or is damaged.") from error
