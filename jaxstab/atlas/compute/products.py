"""What each product holds in a tile of the plan: functions of the plan and the tile alone."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from jaxstab.atlas.compute.limits import alpha_limits
from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.compute.radii import radii
from jaxstab.atlas.compute.slices import outlines, summaries
from jaxstab.atlas.compute.verdicts import cell_verdicts, node_verdicts
from jaxstab.atlas.format.schema import (
    ALPHA_LIMITS,
    CELL_VERDICT,
    SPECTRAL_RADIUS,
    VERDICT,
)
from jaxstab.proofs.plant import HandBoxes

Arrays = dict[str, NDArray[Any]]

_BEYOND = 1e-9  # of a cell: cells overlap, so that rounding finds no gap between them


def compute_tile(plan: Plan, tile: Tile) -> Arrays:
    """Return what the chosen products hold in a tile, each array of the shape ``plan.shape``.

    Raises:
        ValueError: a parameter is too large for the model.
    """
    arrays: Arrays = {}
    for chosen in plan.spec.products:
        arrays |= _COMPUTED_BY[chosen](plan, tile)
    return arrays


def _verdicts(plan: Plan, tile: Tile) -> Arrays:
    alpha, beta, delay = plan.grid.walls(tile.delay)
    hands = plan.hands(tile)
    nodes = node_verdicts(alpha, beta, hands[:, 0], hands[:, 1], delay, plan.spec.filters)
    cells = np.zeros((0, alpha.size - 1, beta.size - 1), np.int8)
    sides = _sides(plan, tile)
    if sides.size:
        cells = cell_verdicts(alpha, beta, _boxes(sides), delay, plan.spec.filters)
    return {
        VERDICT: np.moveaxis(nodes, 0, -1).reshape(plan.shape(VERDICT, tile)),
        CELL_VERDICT: np.moveaxis(cells, 0, -1).reshape(plan.shape(CELL_VERDICT, tile)),
    }


def _alpha_limits(plan: Plan, tile: Tile) -> Arrays:
    return {ALPHA_LIMITS: alpha_limits(plan, tile, _boxes(_sides(plan, tile)))}


def _sides(plan: Plan, tile: Tile) -> Float64[np.ndarray, "cell hand side"]:
    """Return the ends of the cells of hands in a tile, along gamma and delta."""
    sides = [
        (plan.grid.sides("gamma")[gamma], plan.grid.sides("delta")[delta])
        for gamma in plan.numbers("gamma_cell", tile)
        for delta in plan.numbers("delta_cell", tile)
    ]
    return np.array(sides).reshape(-1, 2, 2)


def _boxes(sides: Float64[np.ndarray, "cell hand side"]) -> HandBoxes:
    half = 0.5 * np.diff(sides, axis=-1)[..., 0] * (1.0 + _BEYOND)
    return HandBoxes(*sides.mean(axis=-1).T, *half.T)


_COMPUTED_BY: Mapping[str, Callable[[Plan, Tile], Arrays]] = {
    VERDICT: _verdicts,
    ALPHA_LIMITS: _alpha_limits,
    SPECTRAL_RADIUS: radii,
    "outline": outlines,
    "summary": summaries,
}
"""For each product the function that computes all of its variables in a tile."""
