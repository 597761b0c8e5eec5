"""Limits of the stable alpha, from which most verdicts of an atlas follow.

A column (``atlas.lookup``) holds a lower and an upper limit of the stable alphas, each with an
error. ``proofs.columns`` proves them in double precision. A file has them in single precision: what
that changes is added to the error (``in_float32``).

Some axes hold the whole stable set: ``atlas.proved`` proves of which cells of delays, and a
wall beyond such an axis is unstable.
"""

from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.lookup import LIMIT_TERMS, WHOLE_BOTH, limits_at
from jaxstab.atlas.product import Array, Floats, Product, Variable, numbers
from jaxstab.rounding import PLANES

if TYPE_CHECKING:
    from jaxstab.atlas.plan import Extents, Grid, Plan, Tile
    from jaxstab.model.filters import Filters

ALPHA_LIMITS = "alpha_limits"
LIMIT_RANGE = "limit_range"
LIMIT_WHOLE = "limit_whole"
LIMITS = ("limit_cell", "gamma_cell", "delta_cell", "delay_cell", "limit_term")

_VARIABLES = (
    numbers("limit_cell", "cell i of n is the i-th of n equal parts of the range of beta"),
    numbers("delay_cell", "cell i holds the delays limit_range[i, 0] to limit_range[i, 1]"),
    numbers(
        "limit_end",
        "0 and 1: lowest and highest delay of a cell; 2 and 3: likewise alpha; 4 and 5: beta",
    ),
    Variable(
        LIMIT_RANGE,
        "float64",
        ("delay_cell", "limit_end"),
        "delays, alpha and beta for which limits of alpha are given",
        "one row for each cell of delays, ascending; of two cells that share a delay the "
        "second answers for it",
    ),
    Variable(
        LIMIT_WHOLE,
        "int32",
        ("delay_cell",),
        "axes that hold the whole stable set",
        "for all gamma and delta of the atlas and all delays of the cell: 1, a wall beyond the "
        "alphas of limit_range, at one of its betas, is unstable; 2, and so is one beyond its "
        "betas; 0, nothing is known. Proved: columns between the axes and bounds of all stable "
        "gains are empty",
        0,
        WHOLE_BOTH,
    ),
    numbers(
        "limit_term",
        "0 to 9: constant, slopes along beta, gamma, delta, delay, the square of the delay and "
        "the delay times beta, gamma and delta, and error of the lower limit; 10 to 19: of the "
        "upper limit",
    ),
    Variable(
        ALPHA_LIMITS,
        "float32",
        LIMITS,
        "limits of the stable alpha",
        "limit = constant + slopes (beta, gamma, delta, delay, delay^2, delay beta, delay "
        "gamma, delay delta). Proved for each point of the closed cell, and alpha in the range "
        "of limit_range: unstable below the lower "
        "limit - error and above the upper limit + error, stable between lower + error and "
        "upper - error (the boundary in closed form is enclosed, and a verdict computed in "
        "each gap). Constants "
        "of infinity: lower, no alpha is stable; upper, the limit is beyond the atlas",
    ),
)


class Limits(Product):
    """Limits of alpha in columns."""

    name = ALPHA_LIMITS
    variables = _VARIABLES
    gridded = (ALPHA_LIMITS,)
    fixed = LIMIT_RANGE, LIMIT_WHOLE
    rows = LIMIT_RANGE
    lengths = {"limit_term": 2 * LIMIT_TERMS, "limit_end": 6}  # noqa: RUF012
    unit = LIMITS[:4]

    def compute(self, plan: "Plan", tile: "Tile") -> dict[str, Array]:
        from jaxstab.proofs.columns import stable_columns
        from jaxstab.proofs.curve_patches import Domain

        shape, hands = plan.shape(ALPHA_LIMITS, tile), plan.boxes(tile)
        limits = np.zeros((shape[0], hands.gamma.size, *shape[3:]), np.float32)
        for index, cell in enumerate(plan.numbers("delay_cell", tile) if limits.size else ()):
            early, late, *walls = plan.grid.limit_range[cell].tolist()
            domain = Domain((walls[0], walls[1]), (walls[2], walls[3]))
            edges = np.linspace(*domain.beta, plan.grid.limit_cells + 1)
            middle = 0.5 * (early + late)
            half = np.nextafter(max(middle - early, late - middle), np.inf) if late > early else 0.0
            columns = stable_columns(edges, hands, middle, domain, plan.spec.filters, float(half))
            beta = max(map(abs, domain.beta))
            hand = plan.grid.gamma[-1], plan.grid.delta[-1]
            limits[:, :, index] = np.concatenate(
                [in_float32(terms, (beta, *hand, late)) for terms in columns], axis=-1
            ).swapaxes(0, 1)
        return {ALPHA_LIMITS: limits.reshape(shape)}

    def known_before(self, grid: "Grid", filters: "Filters | None") -> dict[str, Array]:
        from jaxstab.atlas.proved import whole_axes

        return {LIMIT_RANGE: grid.limit_range, LIMIT_WHOLE: whole_axes(grid, filters)}

    def are_values(self, name: str, values: Array) -> bool:
        if name != ALPHA_LIMITS:
            return True
        limits = np.split(values, 2, axis=-1)
        return all(np.all(np.isfinite(v[..., 1:-1])) and v[..., -1].min() >= 0.0 for v in limits)

    def small_grid(self, grid: "Grid", place: Floats) -> "Grid":
        delay, gamma, delta, beta = place
        columns, ends = grid.row_at(delay, beta, _COLUMNS)
        plants = grid.slice_at(0.0, gamma, delta)
        wall = {"alpha": plants.alpha[:1, :1], "beta": plants.beta[:1, :1]}  # one of no interest
        delay = ends[0, :1]  # where the row begins
        return replace(plants, **wall, delay=delay, limit_cells=columns, limit_range=ends)


_COLUMNS, _PER_COLUMN = 64, 4  # of a part, and points in each at which it is judged


def upper_errors(
    grid: "Grid", limits: Array, extents: "Extents", chance: np.random.Generator
) -> Floats:
    """Return errors of the upper limits of a part, over the largest stable alpha at their delay."""
    early, late, _, _, low, high = grid.limit_range[0].tolist()
    terms = limits.reshape(-1, 2 * LIMIT_TERMS)
    column = np.repeat(np.arange(len(terms)), _PER_COLUMN)
    beta = low + (column + chance.random(column.size)) / len(terms) * (high - low)
    ends = *((nodes[0], nodes[-1]) for nodes in (grid.gamma, grid.delta)), (early, late)
    others = [chance.uniform(*pair, column.size) for pair in ends]
    at = limits_at(terms[column].T, beta, *others)
    stable = (at.lower < inf) & ((at.upper < inf) | (at.upper_error == inf))
    errors: Floats = at.upper_error[stable] / extents.along(others[-1][stable])[:, 0]
    return errors


def in_float32(terms: Floats, largest: tuple[float, float, float, float]) -> NDArray[np.float32]:
    """Round the terms of limits (``columns.TERMS``) to float32, and their errors up accordingly.

    ``largest`` are the largest |beta|, gamma, delta and delay at which they are evaluated.
    """
    exact, error = terms[..., :-1], terms[..., -1]
    *others, delay = largest
    sizes = np.array([1.0, *largest, *(delay * size for size in (delay, *others))])
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        rounded = exact.astype(np.float32).astype(np.float64)
        moved = np.where(rounded == exact, 0.0, np.abs(rounded - exact)) * sizes
        rounding = PLANES * np.where(np.isfinite(exact), np.abs(exact), 0.0) * sizes
        raised = (error + moved.sum(axis=-1) + rounding.sum(axis=-1)) * (1.0 + 1e-12)
        above = raised.astype(np.float32)
        above = np.where(above < raised, np.nextafter(above, np.float32(np.inf)), above)
    is_known = np.all(np.isfinite(rounded) | (rounded == exact), axis=-1) & ~np.isnan(above)
    limits = np.concatenate([rounded, above[..., None]], axis=-1).astype(np.float32)
    unknown = np.append(np.zeros(sizes.size), np.inf).astype(np.float32)
    chosen: np.ndarray = np.where(is_known[..., None], limits, unknown)
    return chosen
