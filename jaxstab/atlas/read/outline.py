"""One outline out of the list of all. NumPy alone."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format import schema


class AtlasOutline(NamedTuple):
    """The boundary of the stable region of one slice, from an atlas.

    Attributes:
        points: (n, 2), alpha and beta counter-clockwise, the last one equal to the first.
        branch: (n - 1,), what each piece is: 0 a pair of roots on the unit circle, 1 a root at
            z = 1, 2 a root at z = -1; -1 between two loops.
        corners: (m, 2), where two branches meet, to full precision.
        status: 0 complete, 1 the region is empty, 2 unresolved: do not use it.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> hand = {"gamma": (0.0,), "delta": (0.01,), "delay": (1.0,)}
        >>> spec = jaxstab.AtlasSpec(**hand, products=("outline",))
        >>> with TemporaryDirectory() as folder:
        ...     atlas = jaxstab.build_atlas(spec, Path(folder) / "outline.h5")
        >>> outline = atlas.outline(gamma=0.0, delta=0.01, delay=1.0)
        >>> int(outline.status), outline.corners.round(3).tolist()
        (0, [[0.0, -0.01], [0.0, 0.836]])
    """

    points: NDArray[np.float64]
    branch: NDArray[np.int32]
    corners: NDArray[np.float64]
    status: int


def outline_at(
    arrays: Mapping[str, NDArray[Any]], gamma: float, delta: float, delay: float
) -> AtlasOutline:
    """Return the outline at a node of gamma, delta and delay.

    Raises:
        ValueError: it is no node, or the atlas holds no outlines.
    """
    if schema.OUTLINE_SIZE not in arrays:
        raise ValueError("this atlas holds no outlines; build one with the product 'outline'.")
    given = {"gamma": gamma, "delta": delta, "delay": delay}
    i, j, k = (_number(name, arrays[name], value) for name, value in given.items())
    points = _part(arrays, schema.OUTLINE_SIZE, (i, j, k))
    corners = _part(arrays, schema.CORNER_COUNT, (i, j, k))
    return AtlasOutline(
        np.stack([arrays[n][points] for n in (schema.OUTLINE_ALPHA, schema.OUTLINE_BETA)], axis=-1),
        arrays[schema.OUTLINE_BRANCH][points][:-1],
        np.stack([arrays[n][corners] for n in (schema.CORNER_ALPHA, schema.CORNER_BETA)], axis=-1),
        int(arrays[schema.OUTLINE_STATUS][i, j, k]),
    )


def _part(arrays: Mapping[str, NDArray[Any]], counts: str, place: tuple[int, int, int]) -> slice:
    """Return the range of the values of a slice, without the NaN at its end."""
    gamma, delta, delay = place
    in_order = np.transpose(arrays[counts], (2, 0, 1))
    ends = np.cumsum(in_order).reshape(in_order.shape)
    end = int(ends[delay, gamma, delta])
    return slice(end - int(arrays[counts][place]), end - 1)


def _number(name: str, nodes: NDArray[np.float64], value: float) -> int:
    (found,) = np.nonzero(nodes == value)
    if not found.size:
        listed = ", ".join(map(repr, nodes.tolist()))
        raise ValueError(f"{name} is {value!r}; outlines are at its nodes {listed}.")
    return int(found[0])
