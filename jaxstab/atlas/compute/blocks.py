"""Proofs for cells, block by block: a block that is proved as one large cell is filled whole."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.atlas.compute.certificate import cells_without_crossing

_COARSE = 32  # cells along each side of a block
_FINER = (8, 2, 1)  # those of its parts, one after the other


class CellSlice(NamedTuple):
    """All cells of (alpha, beta) between two gamma and two delta, at one delay."""

    alpha: Float64[np.ndarray, " alpha_node"]
    beta: Float64[np.ndarray, " beta_node"]
    gamma: Float64[np.ndarray, "2"]
    delta: Float64[np.ndarray, "2"]
    delay: float

    @property
    def shape(self) -> tuple[int, int]:
        """The number of cells along alpha and beta."""
        return self.alpha.size - 1, self.beta.size - 1

    def proved_in_blocks(
        self, proved: Bool[np.ndarray, "alpha_cell beta_cell"], side: int
    ) -> Bool[np.ndarray, "alpha_cell beta_cell"]:
        """Try blocks of so many cells along each side, where not all of them are proved, as one."""
        first = [np.arange(0, count, side) for count in self.shape]
        last = [np.append(f[1:], count) for f, count in zip(first, self.shape, strict=True)]
        whole = np.logical_and.reduceat(np.logical_and.reduceat(proved, first[0], 0), first[1], 1)
        left = np.nonzero(~whole)
        alpha, beta = (
            np.stack([nodes[f[number]], nodes[s[number]]], axis=-1)
            for nodes, f, s, number in zip((self.alpha, self.beta), first, last, left, strict=True)
        )
        whole[left] = cells_without_crossing(alpha, beta, self.gamma, self.delta, self.delay)
        for axis in (0, 1):
            whole = np.repeat(whole, last[axis] - first[axis], axis)
        return whole


class Blocks(NamedTuple):
    """Which blocks of cells are proved whole, and the cells of the others that are to be tried."""

    of: CellSlice
    proved: Bool[np.ndarray, "alpha_cell beta_cell"]

    @property
    def tried(self) -> int:
        """The number of cells that are not in a block proved whole."""
        return int(np.sum(~self.proved))

    def cells(self) -> Bool[np.ndarray, "alpha_cell beta_cell"]:
        """Prove the rest in ever smaller blocks, and at last cell by cell."""
        proved = self.proved
        for side in _FINER:
            proved = self.of.proved_in_blocks(proved, side)
        return proved


def prove_blocks(of: CellSlice) -> Blocks:
    """Prove blocks of cells as if each were one cell.

    Raises:
        ValueError: gamma, delta or delay is outside the range of the model.
        RuntimeError: JAX's x64 mode is off.
    """
    return Blocks(of, of.proved_in_blocks(np.zeros(of.shape, bool), _COARSE))
