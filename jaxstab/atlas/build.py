"""Build an atlas: compute the tiles of the plan, put them together, publish one file."""

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int8
from numpy.typing import NDArray

import jaxstab
from jaxstab.atlas import file, schema
from jaxstab.atlas.layout import Grid
from jaxstab.atlas.plan import Plan, Tile, plan_atlas
from jaxstab.atlas.query import Atlas, open_atlas
from jaxstab.atlas.schema import CELL_VERDICT, RADIUS_ERROR, SPECTRAL_RADIUS, VARIABLES, VERDICT
from jaxstab.atlas.spec import AtlasSpec
from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE
from jaxstab.model import require_x64
from jaxstab.stability import spectral_radius

Arrays = dict[str, NDArray[Any]]
Progress = Callable[[int, int], object]


def build_atlas(
    spec: AtlasSpec, path: str | PathLike[str], progress: Progress | None = None
) -> Atlas:
    """Compute an atlas, publish it as one file and open it.

    The file appears whole and durably, or not at all; a former one of this name is replaced. One
    machine makes equal bytes of equal specifications.

    Args:
        spec: what the atlas shall hold.
        path: of the file.
        progress: called with the number of tiles done and of all tiles, first with none done.

    Raises:
        OSError: the folder is missing, read-only or full; the former file is still there.
        ValueError: a parameter is too large for the model, or an axis cannot be fitted.
        RuntimeError: JAX's x64 mode is off.

    Source: the verdicts, the radii and the proofs for cells name theirs.
    """
    require_x64()
    path = Path(path)
    file.check_folder_of(path)
    arrays = compute(spec, progress or (lambda done, total: None))
    file.write(file.Contents(arrays, f"jaxstab {jaxstab.__version__}"), path)
    return open_atlas(path)


def compute(spec: AtlasSpec, progress: Progress) -> Arrays:
    """Return all arrays of an atlas, by the names of the schema.

    Raises:
        ValueError, RuntimeError: as ``build_atlas``.
    """
    plan = plan_atlas(spec)
    tiles = plan.tiles
    progress(0, len(tiles))
    arrays = _axes(plan.grid, spec) | _empty_products(plan.grid, spec)
    for done, tile in enumerate(tiles, start=1):
        for name, values in computed(plan, tile, arrays).items():
            arrays[name][:, :, tile.gamma, :, tile.delay] = values
        progress(done, len(tiles))
    return {name: arrays[name] for name in VARIABLES if name in arrays}


def computed(plan: Plan, tile: Tile, known: Arrays) -> Arrays:
    """Return what a tile holds, each array of shape (alpha, beta, delta).

    Args:
        plan: what to compute.
        tile: one of the plan's.
        known: for cells, the verdicts at the nodes.
    """
    if tile.variable == VERDICT:
        slices = [filling.codes() for filling in plan.fillings(tile.gamma, tile.delay)]
        return {VERDICT: np.stack(slices, axis=-1)}
    if tile.variable == SPECTRAL_RADIUS:
        return _radii(plan, tile)
    corners = known[VERDICT][:, :, tile.gamma : tile.gamma + 2, :, tile.delay]
    proved = [blocks.cells() for blocks in plan.blocks(tile.gamma, tile.delay)]
    return {CELL_VERDICT: _cell_codes(np.stack(proved, axis=-1), corners)}


def _radii(plan: Plan, tile: Tile) -> Arrays:
    grid = plan.grid
    radius = spectral_radius(
        grid.alpha[:, tile.delay, None, None],
        grid.beta[:, tile.delay, None],
        grid.gamma[tile.gamma],
        grid.delta,
        grid.delay[tile.delay],
    )
    value, error = np.asarray(radius.value), np.asarray(radius.error)
    value, error = _rounded(value, error, plan.spec.radius_rounding)
    return {SPECTRAL_RADIUS: value, RADIUS_ERROR: error}


def _cell_codes(
    proved: Bool[np.ndarray, "alpha_cell beta_cell delta_cell"],
    corners: Int8[np.ndarray, "alpha_node beta_node gamma_side delta"],
) -> Int8[np.ndarray, "alpha_cell beta_cell delta_cell"]:
    """Return the verdicts of cells without a crossing, from the verdicts at their corners."""
    some_stable, some_unstable = (_at_some_corner(corners == code) for code in (STABLE, UNSTABLE))
    return np.select(
        [proved & some_stable & ~some_unstable, proved & some_unstable & ~some_stable],
        [np.int8(STABLE), np.int8(UNSTABLE)],
        np.int8(UNDECIDED),
    )


def _at_some_corner(
    nodes: Bool[np.ndarray, "alpha_node beta_node gamma_side delta"],
) -> Bool[np.ndarray, "alpha_cell beta_cell delta_cell"]:
    for axis, count in enumerate(nodes.shape):
        if count > 1:  # a fixed parameter has one node, which is both sides of the cell
            lower, upper = (np.take(nodes, range(k, k + count - 1), axis) for k in (0, 1))
            nodes = lower | upper
    return nodes[:, :, 0]


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


def _axes(grid: Grid, spec: AtlasSpec) -> Arrays:
    lines = np.array([line.encode("utf-8") for line in spec.to_toml().splitlines()])
    arrays: Arrays = {
        "alpha": grid.alpha,
        "beta": grid.beta,
        "gamma": grid.gamma,
        "delta": grid.delta,
        "delay": grid.delay,
        schema.SPEC: lines,
        "spec_line": np.arange(lines.size, dtype=np.int32),
    }
    counts = dict(zip(schema.NODE, grid.shape, strict=True))
    counts |= dict(zip(schema.CELL, grid.cell_shape, strict=True))
    for name, count in counts.items():
        arrays.setdefault(name, np.arange(count, dtype=np.int32))
    return arrays


def _empty_products(grid: Grid, spec: AtlasSpec) -> Arrays:
    names = [name for chosen in spec.products for name in schema.PRODUCTS[chosen]]
    arrays: Arrays = {}
    for name in names:
        shape = grid.cell_shape if VARIABLES[name].dimensions == schema.CELL else grid.shape
        arrays[name] = np.zeros(shape, VARIABLES[name].dtype)
    return arrays
