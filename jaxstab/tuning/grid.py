"""Grids of gains that zoom in on their best point."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

FINE = 33  # points on an axis of the grids that zoom in
_NEIGHBOURS = 4  # steps of a grid to which the next one zooms in
_ZOOMS = 12


@dataclass(frozen=True)
class Grid:
    """Gains between two ends on each axis; a single value where the ends are equal."""

    alphas: tuple[float, float]
    betas: tuple[float, float]
    size: int

    @property
    def axes(self) -> list[Float64[np.ndarray, " gain"]]:
        """The gains on each axis."""
        ends = (self.alphas, self.betas)
        return [np.linspace(a, b, self.size if a < b else 1) for a, b in ends]

    @property
    def points(self) -> tuple[Float64[np.ndarray, "alpha 1"], Float64[np.ndarray, "1 beta"]]:
        """The gains as arrays that broadcast to the grid."""
        alphas, betas = self.axes
        return alphas[:, None], betas[None, :]

    def __getitem__(self, place: int) -> tuple[float, float]:
        alphas, betas = self.axes
        row, column = divmod(place, betas.size)
        return float(alphas[row]), float(betas[column])

    def around(self, point: tuple[float, float]) -> "Grid":
        """Zoom in on a few steps to each side of a point."""
        widths = (b - a for a, b in (self.alphas, self.betas))
        halves = (_NEIGHBOURS * width / (self.size - 1) for width in widths)
        alphas, betas = ((x - half, x + half) for x, half in zip(point, halves, strict=True))
        return Grid(alphas, betas, FINE)


def zoomed(
    least: Callable[[Grid], tuple[float, int]], grid: Grid, enough: float = -np.inf
) -> tuple[tuple[float, float], float]:
    """Minimise over the gains; ``least`` returns the smallest value on a grid, and its place.

    The search ends early once ``enough`` is reached.
    """
    best, value = (np.nan, np.nan), np.inf
    for _ in range(_ZOOMS):
        found, place = least(grid)
        if found < value:
            best, value = grid[place], found
        if value <= enough:
            break
        grid = grid.around(best)
    return best, value
