"""One axis of an atlas: which nodes count for a point, and how much. NumPy alone.

Between two nodes, values are those of the polynomial through the nodes of that cell and the nearest
one on each side: a cubic of four nodes (Lagrange's). At an end of the axis these are the last four
nodes, and an axis of three or two nodes has a parabola or a line. Limits of the stable gains bend
at whole delays, where one more sample begins to count: there the axis of delays has ends, too, so
that no polynomial crosses a whole delay.
"""

from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Cells = NDArray[np.intp]

MOST_NODES: Final = 4


class Axis:
    """Ascending nodes, and the polynomials between them.

    An axis of one node has one cell, at it.

    Attributes:
        nodes: (node,).
        cells: the number of cells.
        pieces: the first and the last node of each piece that no polynomial leaves.
        width: how many nodes count for a point at most.
        first: (cell,), the first of ``width`` neighbouring nodes that count in each cell.
    """

    # Between nodes that are too close for float64, weights are NaN, and points are computed.
    @np.errstate(over="ignore", divide="ignore")
    def __init__(self, nodes: Array, *, bends_at_integers: bool = False) -> None:
        self.nodes = nodes
        last = nodes.size - 1
        self.cells = max(last, 1)
        ends = {0, last, *(np.flatnonzero(nodes == np.round(nodes)) if bends_at_integers else ())}
        self.pieces = list(pairwise(sorted(ends))) or [(0, 0)]
        self.width = min(MOST_NODES, 1 + max(last - first for first, last in self.pieces))
        self.first = np.zeros(self.cells, np.intp)
        # A piece of fewer nodes is filled up to the width with nodes that do not count: their
        # weight is 0, and seen from a place as far away as this any delay is the same.
        far = -(2.0**60)
        self._place = np.full((self.width, self.cells), far)
        self._scale = np.zeros((self.width, self.cells))
        for first, last in self.pieces:
            count = min(self.width, last - first + 1)
            for cell in range(first, max(last, 1)):
                begin = min(max(cell - 1, first), last - count + 1)
                self.first[cell] = min(begin, nodes.size - self.width)
                used = begin - self.first[cell] + np.arange(count)
                self._place[used, cell] = nodes[begin : begin + count]
                apart = self._place[used, cell, None] - self._place[None, :, cell]
                apart[np.arange(count), used] = 1.0
                self._scale[used, cell] = 1.0 / np.prod(apart, axis=1)

    def cell(self, values: Array) -> Cells:
        """The cells of values; of a value at a node, the cell above it."""
        return np.searchsorted(self.nodes[1:-1], values, "right")

    @np.errstate(invalid="ignore")
    def weights(self, cell: Cells, values: Array) -> Array:
        """What the nodes from ``first`` on count at values in cells: (width, value)."""
        aside = [values - place.take(cell) for place in self._place]
        weights = np.empty((self.width, *np.shape(values)))
        for j, (scale, weight) in enumerate(zip(self._scale, weights, strict=True)):
            scale.take(cell, out=weight, mode="clip")
            for other in aside[:j] + aside[j + 1 :]:
                weight *= other
        return weights

    @np.errstate(invalid="ignore")
    def interpolated(self, nodal: NDArray[Any], cell: Cells, values: Array, along: int) -> Array:
        """Values between nodes, of an array with values at the nodes along one of its axes."""
        nodal = np.moveaxis(nodal, along, 0)
        begin = self.first[cell]
        terms = (
            weight.reshape(-1, *(1,) * (nodal.ndim - 1)) * nodal[begin + number]
            for number, weight in enumerate(self.weights(cell, values))
        )
        return np.moveaxis(np.asarray(sum(terms)), 0, along)


def axes_of(gamma: Array, delta: Array, delay: Array) -> tuple[Axis, Axis, Axis]:
    """The axes of plants."""
    return Axis(gamma), Axis(delta), Axis(delay, bends_at_integers=True)
