"""What has to be computed for a specification, and why the rest has not."""

from dataclasses import dataclass
from itertools import product
from math import prod
from typing import NamedTuple

from jaxstab.atlas.compute.blocks import CellSlice, prove_blocks
from jaxstab.atlas.compute.fill import Slice, plan_filling
from jaxstab.atlas.compute.layout import Grid, lay_out
from jaxstab.atlas.format.schema import (
    ALPHA_LIMITS,
    CELL_RADIUS_ERROR,
    CELL_VERDICT,
    PRODUCTS,
    SPECTRAL_RADIUS,
    VARIABLES,
    VERDICT,
)
from jaxstab.atlas.format.spec import AtlasSpec, ToleranceAxis
from jaxstab.model import require_x64

TILE_NODES = 2**18  # at most, where a tile holds more than one slice


_IN_GRID = (VERDICT, CELL_VERDICT, ALPHA_LIMITS, SPECTRAL_RADIUS, CELL_RADIUS_ERROR)
_BY_SLICES = ("outline", "summary")


class Tile(NamedTuple):
    """A unit of work: all alpha and beta at one gamma, some neighbouring delta and one delay.

    These are the numbers of nodes, and of the cells that begin at them.
    """

    gamma: int
    delta: range
    delay: int


class Share(NamedTuple):
    """How many of the points that are asked for are evaluated, and why each of the others is not.

    Attributes:
        variable: what is asked for, by its name in the file.
        asked: number of points.
        evaluated: number of points.
        reasons: for all others, how many of them and why.
    """

    variable: str
    asked: int
    evaluated: int
    reasons: tuple[tuple[int, str], ...] = ()

    def __str__(self) -> str:
        asked = f"{self.variable}: {_points(self.asked)} asked for, {self.evaluated} evaluated"
        share = f" ({100.0 * self.evaluated / self.asked:.3g} %)" if self.asked else ""
        return "\n".join([asked + share, *(f"  {count} not: {why}" for count, why in self.reasons)])


@dataclass(frozen=True)
class Plan:
    """The work that a specification asks for; its text says how much, and what is left out and why.

    ``plan_atlas`` makes one. A product is computed variable by variable: on the nodes of the grid,
    or in its cells, and nothing of a product that was not chosen.

    Attributes:
        spec: what is asked for.
        grid: the nodes.
    """

    spec: AtlasSpec
    grid: Grid

    @property
    def variables(self) -> tuple[str, ...]:
        """The variables of which each value is asked for in a grid; errors come with values."""
        chosen = (name for product in self.spec.products for name in PRODUCTS[product])
        return tuple(name for name in chosen if name in _IN_GRID)

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
        """Return which places along a dimension of the schema are in a tile."""
        count = self.grid.lengths[dimension]
        one = {"gamma": tile.gamma, "delay": tile.delay}
        inside = {name: range(number, number + 1) for name, number in one.items()}
        inside |= {"delta": tile.delta}
        part = inside.get(dimension.removesuffix("_cell"), range(count))
        return range(part.start, max(part.start, min(part.stop, count)))

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

    def slice_at(self, gamma: int, delta: int, delay: int) -> Slice:
        """Return the nodes of alpha and beta at the numbers of the others."""
        grid = self.grid
        at = float(grid.gamma[gamma]), float(grid.delta[delta]), float(grid.delay[delay])
        return Slice(grid.alpha[:, delay], grid.beta[:, delay], *at)

    def cells_at(self, gamma: int, delta: int, delay: int) -> CellSlice:
        """Return the cells of alpha and beta in the numbered cells of gamma and delta."""
        grid = self.grid
        sides = grid.sides("gamma")[gamma], grid.sides("delta")[delta]
        return CellSlice(
            grid.alpha[:, delay], grid.beta[:, delay], *sides, float(grid.delay[delay])
        )

    def shares(self) -> list[Share]:
        """Return for each variable how much of it is evaluated.

        The boundary is looked at in every slice for this, but no verdict and no radius is computed.

        Raises:
            RuntimeError: JAX's x64 mode is off.
        """
        return [self._share(name) for name in self.variables]

    def __str__(self) -> str:
        lines = [_axis_line(self, name) for name in ("gamma", "delta")]
        degrees = (f"{d:g} (degree {int(d) + 3 + (d % 1 > 0)})" for d in self.grid.delay.tolist())
        lines.append(f"delay: {', '.join(degrees)}; each computed at its own degree")
        lines += map(str, self.shares())
        slices = prod(self.grid.shape[2:])
        lines += [
            f"{name}: {slices} slices, each from the closed form, without a grid"
            for name in self.spec.products
            if name in _BY_SLICES
        ]
        left_out = [product for product in PRODUCTS if product not in self.spec.products]
        lines += [f"{product}: not asked for, nothing evaluated" for product in left_out]
        return "\n".join(lines)

    def _share(self, variable: str) -> Share:
        counts = [self.grid.lengths[dimension] for dimension in VARIABLES[variable].dimensions]
        asked = prod(counts) if variable != ALPHA_LIMITS else prod(counts[:-1])
        places = product(*map(range, counts[2:]))
        if variable == VERDICT:
            fillings = [plan_filling(self.slice_at(*place)) for place in places]
            evaluated = sum(filling.computed for filling in fillings)
            inside = sum(filling.filled_inside for filling in fillings)
            return Share(
                variable,
                asked,
                evaluated,
                (
                    (
                        inside,
                        "between crossings of the exact boundary, in the region that has the "
                        "fewest unstable roots: filled with its certified verdict",
                    ),
                    (
                        asked - evaluated - inside,
                        "between crossings of the exact boundary, outside of that region: unstable",
                    ),
                ),
            )
        if variable == CELL_VERDICT:
            tried = sum(prove_blocks(self.cells_at(*place)).tried for place in places)
            why = "in blocks of cells that are proved whole"
            return Share(variable, asked, tried, ((asked - tried, why),))
        return Share(variable, asked, asked)


def plan_atlas(spec: AtlasSpec) -> Plan:
    """Decide what to compute for a specification; ``print`` it to see.

    Raises:
        ValueError: a parameter is too large for the model, an axis cannot be fitted, or the grid is
            too large.
        RuntimeError: JAX's x64 mode is off.
    """
    require_x64()
    return Plan(spec, lay_out(spec))


def _axis_line(plan: Plan, name: str) -> str:
    nodes, axis = getattr(plan.grid, name), getattr(plan.spec, name)
    if nodes.size == 1:
        return f"{name}: fixed at {nodes[0]:g}, not gridded"
    text = f"{name}: {nodes.size} nodes from {nodes[0]:g} to {nodes[-1]:g}"
    if isinstance(axis, ToleranceAxis):
        text += (
            f", as many as keep the boundary's motion between two of them below {axis.tolerance:g}"
        )
    return text


def _points(count: int) -> str:
    return f"{count} point" + ("s" if count != 1 else "")
