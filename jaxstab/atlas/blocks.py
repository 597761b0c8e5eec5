"""Proofs for cells, block by block: a block that is proved as one large cell is filled whole."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.atlas.certificate import cells_without_crossing

_SIDE = 32  # cells along each side of a block


class CellSlice(NamedTuple):
    """All cells of (alpha, beta) between two gamma and two delta, at one delay."""

    alpha: Float64[np.ndarray, " alpha_node"]
    beta: Float64[np.ndarray, " beta_node"]
    gamma: Float64[np.ndarray, "2"]
    delta: Float64[np.ndarray, "2"]
    delay: float

    def without_crossing(
        self, alpha: Int64[np.ndarray, " alpha_edge"], beta: Int64[np.ndarray, " beta_edge"]
    ) -> Bool[np.ndarray, "alpha_cell beta_cell"]:
        """Say for which cells between chosen nodes it is proved that no root is on the circle."""
        nodes = self.alpha[alpha], self.beta[beta]
        return cells_without_crossing(*nodes, self.gamma, self.delta, self.delay)


class Blocks(NamedTuple):
    """Which blocks of cells are proved whole, and the cells of the others that are to be tried."""

    of: CellSlice
    proved: Bool[np.ndarray, "alpha_cell beta_cell"]

    @property
    def tried(self) -> int:
        """The number of cells that are not in a block proved whole."""
        return int(np.sum(~self.proved))

    def cells(self) -> Bool[np.ndarray, "alpha_cell beta_cell"]:
        """Prove the rest cell by cell."""
        proved = self.proved.copy()
        # Windows of one shape, compiled once: those at the upper ends overlap others.
        starts = [np.minimum(_edges(count)[:-1], max(count - _SIDE, 0)) for count in proved.shape]
        sides = [min(_SIDE, count) for count in proved.shape]
        for i in starts[0]:
            for j in starts[1]:
                window = proved[i : i + sides[0], j : j + sides[1]]
                if not window.all():
                    window |= self.of.without_crossing(
                        i + np.arange(sides[0] + 1), j + np.arange(sides[1] + 1)
                    )
        return proved


def prove_blocks(of: CellSlice) -> Blocks:
    """Prove blocks of cells as if each were one cell.

    Raises:
        ValueError: gamma, delta or delay is outside the range of the model.
        RuntimeError: JAX's x64 mode is off.
    """
    alpha, beta = (_edges(nodes.size - 1) for nodes in (of.alpha, of.beta))
    proved = of.without_crossing(alpha, beta)
    for axis, edges in enumerate((alpha, beta)):
        proved = np.repeat(proved, np.diff(edges), axis)
    return Blocks(of, proved)


def _edges(count: int) -> Int64[np.ndarray, " edge"]:
    return np.append(np.arange(0, count, _SIDE), count)
