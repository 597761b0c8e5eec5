"""As many nodes along gamma or delta as a tolerance needs: where little changes, few."""

from collections.abc import Sequence
from itertools import pairwise
from math import ceil

import numpy as np
from jaxtyping import Float64

from jaxstab.atlas.compute.edge import SAMPLES, Edge, Plane
from jaxstab.atlas.format.spec import ToleranceAxis

_PROBES = 17  # values along the axis at which the boundary is looked at


def tolerant_nodes(
    axis: ToleranceAxis, name: str, across: Sequence[float], delays: Sequence[float]
) -> Float64[np.ndarray, " node"]:
    """Return nodes between which the boundary of the stable set moves by the tolerance at most.

    The motion is that of the curve at a fixed angle of the roots on the circle, and of the lines of
    a real root there, wherever they bound the stable set, in units of its extents. It is added up
    over even steps along the axis, and the nodes share it equally.

    Args:
        axis: its ends and the tolerance.
        name: "gamma" or "delta".
        across: values of the other one of the two.
        delays: time delays t_d/T.

    Raises:
        ValueError: nowhere along the axis a stable set is found, or a parameter is too large.
    """
    values = np.linspace(axis.start, axis.stop, _PROBES)
    moved = np.zeros(_PROBES - 1)
    for other in across:
        for delay in delays:
            planes = [
                Plane(value, other, delay) if name == "gamma" else Plane(other, value, delay)
                for value in values.tolist()
            ]
            moved = np.maximum(moved, _motions(planes))
    passed = np.concatenate([[0.0], np.cumsum(moved)])
    steps = max(1, ceil(passed[-1] / axis.tolerance))
    nodes = np.interp(np.linspace(0.0, passed[-1], steps + 1), passed, values)
    return np.concatenate([[axis.start], nodes[1:-1], [axis.stop]])


def _motions(planes: Sequence[Plane]) -> list[float]:
    """Return how far the boundary moves from each plane to the next."""
    curves = [plane.curve() for plane in planes]
    is_edge = np.concatenate([curve.is_edge for curve in curves])
    if not is_edge.any():
        raise ValueError(
            f"no stable set was found at delay {planes[0].delay:g} along an axis that is given by "
            "a tolerance; give its nodes."
        )
    beta = np.concatenate([curve.beta for curve in curves])[is_edge]
    wide = float(np.ptp(np.concatenate([curve.alpha for curve in curves])[is_edge]))
    rows = np.linspace(beta.min(), beta.max(), SAMPLES)
    lines = [plane.lines(rows, wide) for plane in planes]
    extent = wide, float(np.ptp(beta))
    return [
        max(_motion(*sides, extent) for sides in zip((a, *b), (c, *d), strict=True))
        for (a, b), (c, d) in pairwise(zip(curves, lines, strict=True))
    ]


def _motion(before: Edge, after: Edge, extent: tuple[float, float]) -> float:
    """Return how far points move that are on the edge before or after."""
    known = (before.is_edge | after.is_edge) & np.isfinite(before.alpha) & np.isfinite(after.alpha)
    way = [
        np.max(np.abs(one[known] - two[known]), initial=0.0) / size
        for one, two, size in zip(after[:2], before[:2], extent, strict=True)
    ]
    return float(max(way))
