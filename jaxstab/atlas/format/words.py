"""Attributes of a file and of its datasets, in words and numbers. No JAX."""

from typing import Any

import numpy as np

from jaxstab.atlas.format import schema
from jaxstab.atlas.format.schema import Variable


def head_attributes(created_by: str, filters: str) -> dict[str, Any]:
    """Return the attributes of a file, without the digest of its values."""
    return {
        "format": schema.FORMAT,
        "title": "Stability of a haptic rendering loop over its dimensionless parameters",
        "created_by": created_by,
        "source": "characteristic polynomial of Hulin, Preusche, Hirzinger (2008), eq. (9)",
        "symbols": "K, B stiffness and damping of the virtual wall; m, b, k mass, damping and "
        "stiffness of device and hand; T sampling period, t_d delay",
        "filters": filters,
        "Conventions": "CF-1.8",
        "schema_version": np.int32(schema.SCHEMA_VERSION),
    }


def attributes_of(variable: Variable) -> dict[str, Any]:
    """Return the attributes of a dataset."""
    attributes: dict[str, Any] = {
        "long_name": variable.long_name,
        "interpretation": variable.interpretation,
    }
    if variable.dtype.startswith("float"):
        attributes["units"] = "1"
    if variable.dimensions == schema.NODE:
        attributes["coordinates"] = "alpha beta"
    if variable.holds_verdicts:
        attributes["flag_values"] = np.array(schema.FLAG_VALUES, np.int8)
        attributes["flag_meanings"] = schema.FLAG_MEANINGS
    return attributes
