"""What each product holds in a tile of the plan: functions of the plan and the tile alone."""

from collections.abc import Callable, Mapping
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int8
from numpy.typing import NDArray

from jaxstab.atlas.blocks import prove_blocks
from jaxstab.atlas.fill import plan_filling
from jaxstab.atlas.plan import Plan, Tile
from jaxstab.atlas.schema import CELL_VERDICT, RADIUS_ERROR, SPECTRAL_RADIUS, VERDICT
from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE
from jaxstab.stability import spectral_radius

Arrays = dict[str, NDArray[Any]]


def compute_tile(plan: Plan, tile: Tile) -> Arrays:
    """Return what the chosen products hold in a tile, each array of the shape ``plan.shape``.

    Raises:
        ValueError: a parameter is too large for the model.
        RuntimeError: JAX's x64 mode is off.
    """
    arrays: Arrays = {}
    for chosen in plan.spec.products:
        arrays |= _COMPUTED_BY[chosen](plan, tile)
    return arrays


def _verdicts(plan: Plan, tile: Tile) -> Arrays:
    nodes = np.zeros(plan.shape(VERDICT, tile), np.int8)
    cells = np.zeros(plan.shape(CELL_VERDICT, tile), np.int8)
    gammas, deltas = (plan.numbers(name, tile) for name in ("gamma", "delta"))
    corners = {
        (gamma, delta): plan_filling(plan.slice_at(gamma, delta, tile.delay)).codes()
        for gamma in _with_next(gammas, plan.grid.gamma.size)
        for delta in _with_next(deltas, plan.grid.delta.size)
    }
    for j, delta in enumerate(deltas):
        nodes[:, :, 0, j, 0] = corners[tile.gamma, delta]
    for gamma in plan.numbers("gamma_cell", tile):
        for j, delta in enumerate(plan.numbers("delta_cell", tile)):
            proved = prove_blocks(plan.cells_at(gamma, delta, tile.delay)).cells()
            around = [
                corners[corner]
                for corner in product((gamma, gamma + 1), (delta, delta + 1))
                if corner in corners
            ]
            cells[:, :, 0, j, 0] = _cell_codes(proved, np.stack(around))
    return {VERDICT: nodes, CELL_VERDICT: cells}


def _with_next(numbers: range, count: int) -> range:
    """Return the numbers of nodes, and of the one after them, if any, where their cells end."""
    return range(numbers.start, min(numbers.stop + 1, count))


def _cell_codes(
    proved: Bool[np.ndarray, "alpha_cell beta_cell"],
    corners: Int8[np.ndarray, "corner alpha_node beta_node"],
) -> Int8[np.ndarray, "alpha_cell beta_cell"]:
    """Return the verdicts of cells without a crossing, from the verdicts at their corners."""
    some_stable, some_unstable = (_at_some_corner(corners == code) for code in (STABLE, UNSTABLE))
    return np.select(
        [proved & some_stable & ~some_unstable, proved & some_unstable & ~some_stable],
        [np.int8(STABLE), np.int8(UNSTABLE)],
        np.int8(UNDECIDED),
    )


def _at_some_corner(
    corners: Bool[np.ndarray, "corner alpha_node beta_node"],
) -> Bool[np.ndarray, "alpha_cell beta_cell"]:
    nodes = np.logical_or.reduce(corners)
    either = nodes[:-1] | nodes[1:]
    beside: np.ndarray = either[:, :-1] | either[:, 1:]
    return beside


def _radii(plan: Plan, tile: Tile) -> Arrays:
    grid = plan.grid
    deltas = plan.numbers("delta", tile)
    radius = spectral_radius(
        grid.alpha[:, tile.delay, None, None],
        grid.beta[:, tile.delay, None],
        grid.gamma[tile.gamma],
        grid.delta[deltas.start : deltas.stop],
        grid.delay[tile.delay],
    )
    value, error = np.asarray(radius.value), np.asarray(radius.error)
    value, error = _rounded(value, error, plan.spec.radius_rounding)
    shape = plan.shape(SPECTRAL_RADIUS, tile)
    return {SPECTRAL_RADIUS: value.reshape(shape), RADIUS_ERROR: error.reshape(shape)}


def _rounded(
    value: Float64[np.ndarray, "*grid"], error: Float64[np.ndarray, "*grid"], rounding: float | int
) -> tuple[Float64[np.ndarray, "*grid"], Float64[np.ndarray, "*grid"]]:
    """Round radii as the specification says, and their errors up to powers of two."""
    if rounding > 0.0:
        step = 2.0 ** np.floor(np.log2(rounding))
        rounded = np.round(value / step) * step
        error = (error + np.abs(rounded - value)) * (1.0 + 2.0**-50)  # these are rounded, too
        value = rounded
    return value, _raised_to_power_of_two(error)


def _raised_to_power_of_two(
    error: Float64[np.ndarray, "*grid"],
) -> Float64[np.ndarray, "*grid"]:
    fraction, exponent = np.frexp(error)
    raised = np.ldexp(1.0, exponent - (fraction == 0.5))
    return np.where(np.isfinite(error) & (error > 0.0), raised, error)


_COMPUTED_BY: Mapping[str, Callable[[Plan, Tile], Arrays]] = {
    VERDICT: _verdicts,
    SPECTRAL_RADIUS: _radii,
}
"""For each product the function that computes all of its variables in a tile."""
