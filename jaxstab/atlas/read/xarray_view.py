"""An atlas as an ``xarray.Dataset``. No JAX, and xarray only when it is asked for."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from jaxstab.atlas.format.schema import VARIABLES, attributes_of, head_attributes


def to_xarray(arrays: Mapping[str, NDArray[Any]], created_by: str, filters: str) -> Any:
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
        name: (VARIABLES[name].dimensions, values, _said(attributes_of(VARIABLES[name])))
        for name, values in arrays.items()
    }
    dataset = xarray.Dataset(variables, attrs=head_attributes(created_by, filters))
    return dataset.set_coords(["alpha", "beta"])


def _said(attributes: dict[str, Any]) -> dict[str, Any]:
    """Return attributes without the one that xarray takes for its own."""
    return {name: value for name, value in attributes.items() if name != "coordinates"}
