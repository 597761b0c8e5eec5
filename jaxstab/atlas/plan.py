"""What has to be computed for a specification, and why the rest has not."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxstab.atlas.blocks import Blocks, CellSlice, prove_blocks
from jaxstab.atlas.fill import Filling, Slice, plan_filling
from jaxstab.atlas.layout import Grid, lay_out
from jaxstab.atlas.schema import CELL_VERDICT, PRODUCTS, RADIUS_ERROR, VERDICT
from jaxstab.atlas.spec import AtlasSpec, ToleranceAxis
from jaxstab.model import require_x64


class Tile(NamedTuple):
    """A unit of work: one variable for all alpha, beta and delta at one gamma and one delay."""

    variable: str
    gamma: int  # number of the node, or of the cell
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
        """The variables to compute; an error comes with its value."""
        chosen = (name for product in self.spec.products for name in PRODUCTS[product])
        return tuple(name for name in chosen if name != RADIUS_ERROR)

    @property
    def tiles(self) -> list[Tile]:
        """The units of work in an order in which what one needs comes first."""
        *_, delays = self.grid.shape
        return [
            Tile(variable, gamma, delay)
            for variable in self.variables
            for delay in range(delays)
            for gamma in range(self._counts(variable)[2])
        ]

    def fillings(self, gamma: int, delay: int) -> Iterator[Filling]:
        """Yield for each delta how verdicts at the nodes are filled in."""
        grid = self.grid
        for delta in grid.delta.tolist():
            alpha, beta = grid.alpha[:, delay], grid.beta[:, delay]
            at = float(grid.gamma[gamma]), delta, float(grid.delay[delay])
            yield plan_filling(Slice(alpha, beta, *at))

    def blocks(self, gamma: int, delay: int) -> Iterator[Blocks]:
        """Yield for each cell along delta which blocks of cells are proved whole."""
        grid = self.grid
        for delta in grid.sides("delta"):
            alpha, beta = grid.alpha[:, delay], grid.beta[:, delay]
            sides = grid.sides("gamma")[gamma], delta
            yield prove_blocks(CellSlice(alpha, beta, *sides, float(grid.delay[delay])))

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
        left_out = [product for product in PRODUCTS if product not in self.spec.products]
        lines += [f"{product}: not asked for, nothing evaluated" for product in left_out]
        return "\n".join(lines)

    def _counts(self, variable: str) -> Sequence[int]:
        return self.grid.cell_shape if variable == CELL_VERDICT else self.grid.shape

    def _share(self, variable: str) -> Share:
        asked = int(np.prod(self._counts(variable)))
        tiles = [tile[1:] for tile in self.tiles if tile.variable == variable]
        if variable == VERDICT:
            fillings = [filling for tile in tiles for filling in self.fillings(*tile)]
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
            tried = sum(blocks.tried for tile in tiles for blocks in self.blocks(*tile))
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
