"""An atlas as an ``xarray.Dataset``. No JAX, and xarray only when it is asked for."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from jaxstab.atlas.format import schema
from jaxstab.atlas.write.variables import attributes_of, head_attributes


def to_xarray(arrays: Mapping[str, NDArray[Any]], created_by: str) -> Any:
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
    variables = {}
    for name, values in arrays.items():
        attributes = attributes_of(schema.VARIABLES[name])
        attributes.pop("coordinates", None)  # which alpha and beta are now
        variables[name] = (schema.VARIABLES[name].dimensions, values, attributes)
    dataset = xarray.Dataset(variables, attrs=head_attributes(created_by))
    return dataset.set_coords(["alpha", "beta"])
