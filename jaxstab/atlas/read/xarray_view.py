"""An atlas as an ``xarray.Dataset``. No JAX, and xarray only when it is asked for."""

from typing import Any

from jaxstab.atlas.format import schema
from jaxstab.atlas.read.file import PackedArrays


def to_xarray(arrays: PackedArrays) -> Any:
    """Return the variables of an atlas with named coordinates, as ``xarray.open_dataset`` does.

    Raises:
        RuntimeError: xarray is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        raise RuntimeError(
            "an xarray.Dataset needs xarray: python -m pip install 'jaxstab[xarray]'."
        ) from error
    variables = {
        name: (
            schema.VARIABLES[name].dimensions,
            values,
            arrays.attributes(name, schema.ATTRIBUTES),
        )
        for name, values in arrays.items()
    }
    dataset = xarray.Dataset(variables, attrs=arrays.attributes("/", schema.ROOT_ATTRIBUTES))
    return dataset.set_coords(["alpha", "beta"])
