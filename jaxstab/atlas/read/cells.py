"""Where points are in a grid: the cells that they are in, and the nodes that they are. No JAX."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jaxstab.conventions import STABLE, UNSTABLE

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Place:
    """Where points are in a grid: index arrays, one for each axis."""

    cell: tuple[Integers, ...]  # nodes[cell] <= point <= nodes[cell + 1]
    node: tuple[Integers, ...]  # the node, where the point is one
    at_node: Mask

    @classmethod
    def of(cls, axes: Sequence[tuple[Floats, Floats]]) -> "Place":
        """Find points along each axis, given as its nodes and the points' coordinates."""
        cells, node, at_node = [], [], np.ones(axes[0][1].shape, bool)
        for nodes, points in axes:
            cells_along = max(nodes.size - 1, 1)
            cell = np.clip(np.searchsorted(nodes, points, side="right") - 1, 0, cells_along - 1)
            lower, upper = nodes[cell], nodes[np.minimum(cell + 1, nodes.size - 1)]
            cells.append(cell)
            node.append(cell + ((points == upper) & (upper > lower)))
            at_node &= (points == lower) | (points == upper)
        return cls(tuple(cells), tuple(node), at_node)


def decided_share(
    blocks: Iterable[tuple[tuple[int, ...], NDArray[np.int8]]], axes: Sequence[Floats]
) -> float:
    """Return the share of the volume of a grid in which the verdicts of cells are decided.

    Args:
        blocks: where blocks of cells begin along alpha, beta, gamma, delta and delay, and their
            codes.
        axes: the nodes along the first four.
    """
    widths = [np.diff(nodes) / np.ptp(nodes) if nodes.size > 1 else np.ones(1) for nodes in axes]
    total = 0.0
    for start, codes in blocks:
        share = ((codes == STABLE) | (codes == UNSTABLE)).astype(np.float64)[..., 0]
        for first, along in zip(start, widths, strict=False):
            share = np.tensordot(along[first : first + share.shape[0]], share, 1)
        total += float(share)
    return total
