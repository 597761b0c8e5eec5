"""The work that a specification needs."""

from dataclasses import dataclass
from math import prod
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from jaxstab.atlas.compute.layout import Grid, lay_out
from jaxstab.atlas.format.schema import VARIABLES
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.format.variables import LARGEST_ARRAY
from jaxstab.atlas.products.limits import ALPHA_LIMITS
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.model import by_name, characteristic_polynomial
from jaxstab.model.filters import as_keywords
from jaxstab.proofs.plant import HandBoxes
from jaxstab.rounding import OVERLAP

TILE_NODES = 2**18  # at most, where a tile holds more than one slice


class Tile(NamedTuple):
    """A unit of work: all alpha and beta at one gamma, some neighbouring delta and one delay.

    These are the numbers of nodes, and of the cells that begin at them.
    """

    gamma: int
    delta: range
    delay: int


@dataclass(frozen=True)
class Plan:
    """The work that a specification needs; printed, it gives the amount, and what is left out.

    ``plan_atlas`` makes one. A product is computed variable by variable, on the nodes of the grid
    or in its cells; nothing is computed for a product that was not chosen.

    Attributes:
        spec: the specification.
        grid: the nodes.

    Example:
        >>> plan = jaxstab.plan_atlas(jaxstab.AtlasSpec(delay=(1.0,), products=("alpha_limits",)))
        >>> len(plan.tiles), plan.variables
        (3, ('alpha_limits',))
    """

    spec: AtlasSpec
    grid: Grid

    @property
    def variables(self) -> tuple[str, ...]:
        """The variables of which each value is requested in a grid; errors come with values."""
        chosen = (PRODUCTS[product] for product in self.spec.products)
        return tuple(name for product in chosen for name in product.gridded)

    @property
    def deltas_of_a_tile(self) -> int:
        """The largest number of nodes along delta that are in one tile."""
        alphas, betas, _, deltas, _ = self.grid.shape
        return min(max(1, TILE_NODES // (alphas * betas)), deltas)

    @property
    def tiles(self) -> list[Tile]:
        """The units of work; none needs another."""
        *_, gammas, deltas, delays = self.grid.shape
        step = self.deltas_of_a_tile
        return [
            Tile(gamma, range(first, min(first + step, deltas)), delay)
            for delay in range(delays)
            for gamma in range(gammas)
            for first in range(0, deltas, step)
        ]

    def numbers(self, dimension: str, tile: Tile) -> range:
        """Return which indices along a dimension of the schema are in a tile."""
        if dimension == "delay_cell":
            return self.grid.delay_cells(tile.delay)
        count = self.grid.lengths[dimension]
        gamma, delay = (range(index, index + 1) for index in (tile.gamma, tile.delay))
        inside = {"gamma": gamma, "delta": tile.delta, "delay": delay}
        indices = inside.get(dimension.removesuffix("_cell"), range(count))
        return range(indices.start, max(indices.start, min(indices.stop, count)))

    def shape(self, variable: str, tile: Tile) -> tuple[int, ...]:
        """Return the shape of the part of a variable that is in a tile."""
        dimensions = VARIABLES[variable].dimensions
        return tuple(len(self.numbers(dimension, tile)) for dimension in dimensions)

    def is_gridded(self, variable: str) -> bool:
        """Whether each value of a variable has its place in the grid, and is not one of a list."""
        return set(VARIABLES[variable].dimensions) <= set(self.grid.lengths)

    def chunk(self, variable: str) -> tuple[int, ...]:
        """Return the shape of the part of a gridded variable that is in a whole tile."""
        lengths = {name: self.grid.lengths[name] for name in VARIABLES[variable].dimensions}
        most = {"gamma": 1, "delta": self.deltas_of_a_tile, "delay": 1}
        return tuple(
            min(most.get(name.removesuffix("_cell"), length), length)
            for name, length in lengths.items()
        )

    def hands(self, tile: Tile) -> Float64[np.ndarray, "hand 2"]:
        """Return gamma and delta of the slices in a tile."""
        deltas = self.grid.delta[tile.delta.start : tile.delta.stop]
        return np.stack([np.full_like(deltas, self.grid.gamma[tile.gamma]), deltas], axis=-1)

    def boxes(self, tile: Tile) -> HandBoxes:
        """Return the cells of hands that begin in a tile."""
        sides = [
            (self.grid.sides("gamma")[gamma], self.grid.sides("delta")[delta])
            for gamma in self.numbers("gamma_cell", tile)
            for delta in self.numbers("delta_cell", tile)
        ]
        ends = np.array(sides).reshape(-1, 2, 2)
        half = 0.5 * np.diff(ends, axis=-1)[..., 0] * (1.0 + OVERLAP)
        return HandBoxes(*ends.mean(axis=-1).T, *half.T)

    def __str__(self) -> str:
        lines = [_axis_line(self, name) for name in ("gamma", "delta")]
        degrees = (f"{d:g} (degree {_degree(d, self.spec)})" for d in self.grid.delay.tolist())
        lines.append(f"delay: {', '.join(degrees)}; each computed at its own degree")
        if ALPHA_LIMITS in self.variables:
            lines.append(_delay_cells_line(self))
        for name in self.variables:
            count = prod(self.grid.lengths[axis] for axis in VARIABLES[name].dimensions)
            lines.append(f"{name}: {count} values")
        slices = prod(self.grid.shape[2:])
        lines += [
            f"{name}: {slices} slices, each from the closed form, without a grid"
            for name in self.spec.products
            if not PRODUCTS[name].gridded
        ]
        left_out = [product for product in PRODUCTS if product not in self.spec.products]
        lines += [f"{product}: not requested, nothing evaluated" for product in left_out]
        return "\n".join(lines)


def plan_atlas(spec: AtlasSpec) -> Plan:
    """The work that a specification needs; ``print`` it to see.

    Raises:
        ValueError: a parameter is too large for the model, an axis cannot be fitted, or the grid or
            the limits of alpha in a tile are too large.

    Example:
        >>> plan = jaxstab.plan_atlas(jaxstab.AtlasSpec(delay=(1.0,)))
        >>> plan.grid.shape  # alpha, beta, gamma, delta, delay
        (128, 112, 3, 9, 1)
    """
    plan = Plan(spec, lay_out(spec))
    for name in plan.variables:
        size = prod(plan.chunk(name)) * np.dtype(VARIABLES[name].dtype).itemsize
        if size > LARGEST_ARRAY:
            raise ValueError(f"{name} takes {size} bytes in a tile; give fewer limit_cells.")
    return plan


def compute_tile(plan: Plan, tile: Tile) -> dict[str, NDArray[Any]]:
    """What the chosen products hold in a tile, each array of the shape ``plan.shape``."""
    arrays: dict[str, NDArray[Any]] = {}
    for product in plan.spec.products:
        arrays |= PRODUCTS[product].compute(plan, tile)
    return arrays


def _degree(delay: float, spec: AtlasSpec) -> int:
    """Return the degree of the polynomials at a delay; no gain and no hand changes it."""
    zeros = (0.0, 0.0, 0.0, 0.0)
    coefficients = characteristic_polynomial(**by_name(*zeros, delay), **as_keywords(spec.filters))
    return int(coefficients.shape[-1]) - 1


def _axis_line(plan: Plan, name: str) -> str:
    nodes = getattr(plan.grid, name)
    if nodes.size == 1:
        return f"{name}: fixed at {nodes[0]:g}, not gridded"
    return f"{name}: {nodes.size} nodes from {nodes[0]:g} to {nodes[-1]:g}"


def _delay_cells_line(plan: Plan) -> str:
    cells = plan.grid.limit_range
    if np.all(cells[:, 0] == cells[:, 1]):
        return "limits of alpha: at these delays alone, and not between them"
    return (
        f"limits of alpha: {len(cells)} cells of delays from {cells[0, 0]:g} to {cells[-1, 1]:g}, "
        "whole samples on their edges"
    )
