"""What each product holds in a tile of the plan: functions of the plan and the tile alone."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64
from numpy.typing import NDArray

from jaxstab.atlas.compute.limits import alpha_limits
from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.compute.radii import surfaces
from jaxstab.atlas.compute.slices import outlines, summaries
from jaxstab.atlas.compute.verdicts import cell_verdicts, node_verdicts
from jaxstab.atlas.format.schema import (
    ALPHA_LIMITS,
    CELL_RADIUS_ERROR,
    CELL_VERDICT,
    RADIUS_ERROR,
    RADIUS_SURFACES,
    SPECTRAL_RADIUS,
    VERDICT,
)
from jaxstab.boxes.plant import HandBoxes
from jaxstab.boxes.root_discs import interpolation_errors
from jaxstab.model.filters import as_keywords
from jaxstab.point import spectral_radius

Arrays = dict[str, NDArray[Any]]

_FLOAT32_STEP = 2.0**-23  # of values from 1 to 2
_LEAST_EXPONENT, _LARGEST_EXPONENT = -100, 30  # of errors
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


def _radii(plan: Plan, tile: Tile) -> Arrays:
    grid = plan.grid
    gammas = _with_next(plan.numbers("gamma", tile), grid.gamma.size)
    deltas = np.array(_with_next(plan.numbers("delta", tile), grid.delta.size))
    columns = []
    for gamma in gammas:  # one after the other: all corners of a large slice fill the memory
        radius = spectral_radius(
            grid.alpha[:, tile.delay, None, None, None],
            grid.beta[:, tile.delay, None, None],
            grid.gamma[[gamma], None],
            grid.delta[deltas],
            grid.delay[tile.delay],
            **as_keywords(plan.spec.filters),
        )
        columns.append(_rounded(radius.value, radius.error, plan.spec.radius_rounding))
    value, error = (np.concatenate(parts, axis=2) for parts in zip(*columns, strict=True))
    cells = np.zeros(plan.shape(CELL_RADIUS_ERROR, tile), np.float32)
    for number, sides in enumerate(_sides(plan, tile)):
        corners = np.moveaxis(value[:, :, :2, number : number + 2], (2, 3), (0, 1))
        cells[:, :, 0, number, 0] = _cell_errors(plan, tile, sides, corners)
    nodes = np.s_[:, :, :1, : len(tile.delta)]
    shape = plan.shape(SPECTRAL_RADIUS, tile)
    return {
        SPECTRAL_RADIUS: value[nodes].reshape(shape),
        RADIUS_ERROR: error[nodes].reshape(shape),
        CELL_RADIUS_ERROR: cells,
    }


def _cell_errors(
    plan: Plan,
    tile: Tile,
    sides: Float64[np.ndarray, "hand side"],
    corners: Float32[np.ndarray, "gamma_side delta_side alpha_node beta_node"],
) -> Float32[np.ndarray, "alpha_cell beta_cell"]:
    alpha, beta, delay = plan.grid.walls(tile.delay)
    both = np.broadcast_to(corners, (2, 2, alpha.size, beta.size))  # of one node, both sides
    box, values = _boxes(sides[None]), both.astype(np.float64)
    errors = interpolation_errors(alpha, beta, box, delay, values, plan.spec.filters)
    # In its own tile a node can be rounded to the other side.
    digit = max(_FLOAT32_STEP, float(np.spacing(corners.max())))
    step = max(_rounding_step(plan.spec.radius_rounding), digit)
    return _raised(errors + 2.0 * step)


def _with_next(indices: range, count: int) -> range:
    """Return the indices of nodes, and of the one after them, if any, where their cells end."""
    return range(indices.start, min(indices.stop + 1, count))


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


def _rounded(
    value: Float64[np.ndarray, "*grid"], error: Float64[np.ndarray, "*grid"], rounding: float | int
) -> tuple[Float32[np.ndarray, "*grid"], Float32[np.ndarray, "*grid"]]:
    """Round radii as the specification says, and their errors up."""
    step = _rounding_step(rounding)
    near = np.round(value / step) * step if step > 0.0 else value
    rounded = near.astype(np.float32)
    return rounded, _raised((error + np.abs(rounded - value)) * (1.0 + 2.0**-50))


def _rounding_step(rounding: float | int) -> float:
    return float(2.0 ** np.floor(np.log2(rounding))) if rounding > 0.0 else 0.0


def _raised(error: Float64[np.ndarray, "*grid"]) -> Float32[np.ndarray, "*grid"]:
    """Round errors up to powers of two, which float32 has and which take little room."""
    fraction, exponent = np.frexp(error)
    raised = np.ldexp(1.0, np.maximum(exponent - (fraction == 0.5), _LEAST_EXPONENT))
    bounded = np.isfinite(error) & (exponent <= _LARGEST_EXPONENT)
    return np.where(bounded, raised, np.inf).astype(np.float32)


_COMPUTED_BY: Mapping[str, Callable[[Plan, Tile], Arrays]] = {
    VERDICT: _verdicts,
    ALPHA_LIMITS: _alpha_limits,
    SPECTRAL_RADIUS: _radii,
    RADIUS_SURFACES: surfaces,
    "outline": outlines,
    "summary": summaries,
}
"""For each product the function that computes all of its variables in a tile."""
