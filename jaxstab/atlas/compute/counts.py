"""The same range with more or fewer nodes: the counts along each axis of a specification."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from jaxstab.atlas.compute.layout import plant_axis
from jaxstab.atlas.format.spec import FEWEST_FITTED, AtlasSpec, FittedAxis

Counts = Mapping[str, int]
"""Of nodes along alpha and beta, of cells along gamma and delta, and ``limit_cells`` and
``delay_cells`` of the limits of alpha."""

WALLS, HANDS, OF_LIMITS = ("alpha", "beta"), ("gamma", "delta"), ("limit_cells", "delay_cells")


def with_known_nodes(spec: AtlasSpec) -> AtlasSpec:
    """Return a specification whose axes by tolerance are nodes.

    Raises:
        ValueError: as ``jaxstab.plan_atlas`` for such an axis.
    """
    return replace(spec, **{name: plant_axis(spec, name).tolist() for name in HANDS})


def counts_of(spec: AtlasSpec) -> dict[str, int]:
    """Return the counts of a specification with known nodes; no cells where only delays are."""
    along: dict[str, int] = {name: _length(getattr(spec, name)) for name in (*WALLS, *HANDS)}
    along |= {name: max(1, along[name] - 1) for name in HANDS}
    cells = 0 if is_fixed(spec, "delay_cells") else int(spec.delay_cells or 0)
    return along | {"limit_cells": spec.limit_cells, "delay_cells": cells}


def is_fixed(spec: AtlasSpec, name: str) -> bool:
    """Whether a count cannot be another one: an axis of one node, or limits at delays alone."""
    if name == "delay_cells":
        return not spec.delay_cells or _length(spec.delay) == 1
    return name in HANDS and _length(getattr(spec, name)) == 1


def with_counts(spec: AtlasSpec, counts: Counts) -> AtlasSpec:
    """Return a specification of the same range with other counts; nodes stay as dense as they were.

    Raises:
        ValueError: the atlas would be too large.
    """
    now = counts_of(spec)
    changed: dict[str, Any] = {}
    for name in (name for name in counts if counts[name] != now[name]):
        if name in OF_LIMITS:
            changed[name] = counts[name]
        elif isinstance(getattr(spec, name), FittedAxis):
            changed[name] = replace(getattr(spec, name), count=counts[name])
        else:
            nodes = np.array(getattr(spec, name))
            changed[name] = _resampled(nodes, counts[name] + (name in HANDS)).tolist()
    return replace(spec, **changed)


def least_count(spec: AtlasSpec, name: str) -> int:
    """Return the smallest count that a specification may have."""
    if name not in WALLS:
        return 1
    return FEWEST_FITTED if isinstance(getattr(spec, name), FittedAxis) else 2


def _resampled(nodes: Float64[np.ndarray, " node"], count: int) -> Float64[np.ndarray, " count"]:
    numbers = np.arange(nodes.size)
    return np.interp(np.linspace(0.0, nodes.size - 1.0, count), numbers, nodes)


def _length(axis: Any) -> int:
    return axis.count if isinstance(axis, FittedAxis) else len(axis)
