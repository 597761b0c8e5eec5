"""The work that a specification needs: nodes and cells, laid out, and tiles of them.

Axes of gamma, delta and delay are given as nodes. Axes of alpha and beta may be fitted: laid around
the stable regions of the atlas's hands at each delay, with a margin, and with nodes close to the
line alpha = -gamma, where stability ends and no cell can be decided (``_fitted_alpha``).

Limits of alpha also answer between the delays, in cells of delays. Whole samples are edges of
cells, for there the degree of the polynomial changes. A cell is longer as the delay grows, for the
boundary bends less. The ends of alpha and beta of a cell follow from the regions at some edges
(``_delay_cells``).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product
from math import ceil, floor, prod
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from jaxstab.atlas.product import CELL, LARGEST_ARRAY, NODE
from jaxstab.atlas.products.limits import ALPHA_LIMITS
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.schema import VARIABLES
from jaxstab.atlas.spec import AtlasSpec, FittedAxis, check_size
from jaxstab.model import by_name, characteristic_polynomial
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.proofs.plant import HandBoxes
from jaxstab.region import RegionStatus, StableRegion, stable_region
from jaxstab.rounding import OVERLAP

_FINENESS = 1e-3  # of outlines, whose extremes are exact


def known_region(gamma: float, delta: float, delay: float, filters: Filters | None) -> StableRegion:
    """The stable region of a slice, which may be empty; ValueError where it is unresolved."""
    region = stable_region(
        gamma=gamma, delta=delta, delay=delay, tolerance=_FINENESS, **as_keywords(filters)
    )
    if region.status == RegionStatus.UNRESOLVED:
        raise ValueError(
            f"no axis can be laid around the region at gamma {gamma:g}, delta {delta:g}, delay "
            f"{delay:g} ({RegionStatus.UNRESOLVED.words}); give its nodes."
        )
    return region


_MARGIN = 0.03  # around the stable region, of its size
_BAND_GUARD = 0.02  # around the line alpha = -gamma, of the distance of two nodes or of its width
_STATIONS = 0.25  # of a delay and half a sample: how far apart regions are computed
_COARSE = 32  # cells to a sample, at some of whose edges regions are computed beforehand
_MOST_SLICES = 5  # of gamma and of delta, to find the region's size


@dataclass(frozen=True)
class Grid:
    """The nodes of an atlas; alpha and beta have a column for each delay.

    ``limit_range`` has the cells of delays with limits of alpha: the lowest and the highest delay,
    alpha and beta of each.
    """

    alpha: Float64[np.ndarray, "alpha_node delay"]
    beta: Float64[np.ndarray, "beta_node delay"]
    gamma: Float64[np.ndarray, " gamma"]
    delta: Float64[np.ndarray, " delta"]
    delay: Float64[np.ndarray, " delay"]
    limit_cells: int
    limit_range: Float64[np.ndarray, "delay_cell 6"]

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of nodes along alpha, beta, gamma, delta and delay."""
        axes = (self.alpha, self.beta, self.gamma, self.delta, self.delay)
        return tuple(axis.shape[0] for axis in axes)

    @property
    def lengths(self) -> dict[str, int]:
        """The lengths of the dimensions of nodes and cells, by the names of the schema."""
        *nodes, delays = self.shape
        cells = *(max(count - 1, 1) for count in nodes), delays
        lengths = dict(zip((*NODE, *CELL), (*self.shape, *cells), strict=True))
        lengths |= {"limit_cell": self.limit_cells, "delay_cell": len(self.limit_range)}
        fixed = (pair for product in PRODUCTS.values() for pair in product.lengths.items())
        return lengths | dict(fixed)

    def delay_cells(self, delay: int) -> range:
        """The indices of the cells that begin between the delay of this index and the next one."""
        last = self.delay.size - 1
        ends = self.delay[delay], self.delay[delay + 1] if delay < last else np.inf
        start, stop = np.searchsorted(self.limit_range[:, 0], ends)
        return range(int(start), int(stop))

    def walls(
        self, delay: int
    ) -> tuple[Float64[np.ndarray, " alpha_node"], Float64[np.ndarray, " beta_node"], float]:
        """Return the nodes of alpha and beta at the delay of this index, and the delay."""
        return self.alpha[:, delay], self.beta[:, delay], float(self.delay[delay])

    def sides(self, axis: str) -> Float64[np.ndarray, "cell 2"]:
        """Return the ends of the cells along gamma or delta; one node alone is both of them."""
        nodes = getattr(self, axis)
        return np.stack([nodes, nodes] if nodes.size == 1 else [nodes[:-1], nodes[1:]], axis=-1)

    def slice_at(self, delay: float, gamma: float, delta: float, boxes: int = 1) -> "Grid":
        """The part with one delay and one box of (gamma, delta), or one pair if ``boxes`` is 0.

        ``delay``, ``gamma`` and ``delta`` say where the part is along the axes, from 0 to 1.
        """
        i, j = (
            _index(np.diff(nodes), share)
            for nodes, share in ((self.gamma, gamma), (self.delta, delta))
        )
        at_delay = slice(int(delay * self.delay.size), int(delay * self.delay.size) + 1)
        return replace(
            self,
            alpha=self.alpha[:, at_delay],
            beta=self.beta[:, at_delay],
            gamma=self.gamma[i : i + 1 + boxes],
            delta=self.delta[j : j + 1 + boxes],
            delay=self.delay[at_delay],
        )

    def row_at(
        self, delay: float, beta: float, most: int
    ) -> tuple[int, Float64[np.ndarray, "1 6"]]:
        """The number of cells along beta of a part, and its row of delays, alpha and beta.

        ``delay`` and ``beta`` say where the part is, from 0 to 1; ``most`` limits its cells.
        """
        rows, cells = self.limit_range, self.limit_cells
        row = rows[_index(np.diff(rows[:, :2])[:, 0], delay)]
        runs = -(-cells // most)
        ends = (np.array([0, 1]) + int(beta * runs)) * cells // runs
        low, high = row[4] + (row[5] - row[4]) * ends / cells
        return int(ends[1] - ends[0]), np.array([[*row[:4], low, high]])


def _index(widths: Float64[np.ndarray, " cell"], share: float) -> int:
    if not widths.any():
        return min(int(share * widths.size), max(widths.size - 1, 0))
    ends = np.cumsum(widths)
    return min(int(np.searchsorted(ends, share * ends[-1], "right")), widths.size - 1)


@dataclass(frozen=True)
class Extents:
    """The largest alpha, the lowest and highest beta (``ends``) of the regions, by delay."""

    delay: Float64[np.ndarray, " delay"]
    ends: Float64[np.ndarray, "delay 3"]

    def along(self, delay: Float64[np.ndarray, "*point"]) -> Float64[np.ndarray, "*point 3"]:
        """The ends at other delays, by linear interpolation."""
        return np.stack([np.interp(delay, self.delay, end) for end in self.ends.T], axis=-1)


def extents_of(spec: AtlasSpec) -> Extents:
    """The extents of the regions at the corners of gamma and delta: fewer than an axis needs."""
    gamma, delta = (np.unique(np.array(axis)[[0, -1]]) for axis in (spec.gamma, spec.delta))
    delays = np.array(spec.delay)
    stations = _stations(_delay_edges(delays, _COARSE) if spec.delay_cells else [], delays)
    boxes = [_stable_box(gamma, delta, delay, spec.filters) for delay in stations]
    return Extents(np.array(stations), np.array([[highest, *beta] for highest, beta in boxes]))


def lay_out(spec: AtlasSpec, extents: Extents | None = None) -> Grid:
    """The nodes of a specification, with the fitted axes laid around each stable region.

    With ``extents`` no region is computed. ValueError: an axis is fitted to a stable region that is
    empty or unresolved; or the grid is too large.
    """
    gamma, delta, delay = map(np.array, (spec.gamma, spec.delta, spec.delay))
    walls = [_wall_axes(spec, samples, extents) for samples in delay.tolist()]
    alpha, beta = (np.stack(columns, axis=1) for columns in zip(*walls, strict=True))
    limit_range = _delay_cells(spec, walls, extents)
    grid = Grid(alpha, beta, gamma, delta, delay, spec.limit_cells, limit_range)
    check_size(grid.shape)
    return grid


def _delay_cells(
    spec: AtlasSpec,
    walls: list[tuple[Float64[np.ndarray, " alpha_node"], Float64[np.ndarray, " beta_node"]]],
    extents: Extents | None,
) -> Float64[np.ndarray, "delay_cell 6"]:
    """The cells of delays with their ends of alpha and beta; without any, the delays alone."""
    # Whole samples and the delays of the atlas are edges of cells. The ends of alpha and beta are
    # laid around the stable regions at some edges; between these they follow straight lines, above
    # which no region is, as it shrinks ever more slowly with the delay.
    at_nodes = [(alpha[0], alpha[-1], beta[0], beta[-1]) for alpha, beta in walls]
    delay = np.array(spec.delay)
    fineness = int(spec.delay_cells or 0) if ALPHA_LIMITS in spec.products else 0
    if delay.size == 1 or not fineness:
        return np.column_stack([delay, delay, at_nodes])
    edges = _delay_edges(delay, fineness)
    ends_at = dict(zip(delay.tolist(), at_nodes, strict=True))
    stations = _stations(edges, delay)
    for edge in (edge for edge in stations if edge not in ends_at):
        alpha, beta = _wall_axes(spec, edge, extents)
        ends_at[edge] = alpha[0], alpha[-1], beta[0], beta[-1]
    ends = np.array([ends_at[station] for station in stations])
    along = np.stack([np.interp(edges, stations, column) for column in ends.T], axis=-1)
    low, high = np.minimum(along[1:], along[:-1]), np.maximum(along[1:], along[:-1])
    walls_of = [low[:, 0], high[:, 1], low[:, 2], high[:, 3]]
    return np.column_stack([edges[:-1], edges[1:], *walls_of])


def _stations(edges: list[float], delay: Float64[np.ndarray, " delay"]) -> list[float]:
    """Return the delays, whole samples among the edges of cells, and some edges between them."""
    nodes = set(delay.tolist())
    stations, last = set(nodes), float(delay[0])
    for edge in edges:
        if edge in nodes or edge.is_integer() or edge - last >= _STATIONS * (last + 0.5):
            stations.add(edge)
            last = edge
    return sorted(stations)


def _corners(delay: Float64[np.ndarray, " delay"]) -> list[float]:
    """Return the delays of an atlas and the whole samples between them: edges of all cells."""
    whole = range(ceil(delay[0]), floor(delay[-1]) + 1)
    return sorted({*delay.tolist(), *map(float, whole)})


def _delay_edges(delay: Float64[np.ndarray, " delay"], fineness: int) -> list[float]:
    """Return edges of cells between delays, at whole samples too."""
    # A cell is (delay + 1/2) / fineness long, for as the delay grows the boundary bends less: so
    # errors are about equal in all cells.
    edges = [float(delay[0])]
    for low, high in pairwise(_corners(delay)):
        count = max(1, ceil(np.log((high + 0.5) / (low + 0.5)) * fineness - 1e-9))
        inner = np.geomspace(low + 0.5, high + 0.5, count + 1)[1:-1] - 0.5
        edges += [*inner.tolist(), high]
    return edges


def _wall_axes(
    spec: AtlasSpec, delay: float, extents: Extents | None
) -> tuple[Float64[np.ndarray, " alpha_node"], Float64[np.ndarray, " beta_node"]]:
    if not isinstance(spec.alpha, FittedAxis) and not isinstance(spec.beta, FittedAxis):
        return np.array(spec.alpha), np.array(spec.beta)
    gamma = np.array(spec.gamma)
    if extents is None:
        highest_alpha, beta_ends = _stable_box(gamma, np.array(spec.delta), delay, spec.filters)
    else:
        highest_alpha, *both = extents.along(np.array(delay)).tolist()
        beta_ends = both[0], both[1]
    margin = _MARGIN * (beta_ends[1] - beta_ends[0])
    betas = partial(np.linspace, beta_ends[0] - margin, beta_ends[1] + margin)
    alphas = partial(_fitted_alpha, gamma=gamma, highest=highest_alpha)
    return _nodes_of(spec.alpha, alphas), _nodes_of(spec.beta, betas)


def _nodes_of(axis: Any, fitted: Callable[[int], Any]) -> Float64[np.ndarray, " node"]:
    """Nodes, or fitted ones whose ends are moved out to those that the axis requires."""
    if not isinstance(axis, FittedAxis):
        return np.array(axis)
    nodes = fitted(axis.count)
    low = nodes[0] if axis.least is None else min(nodes[0], axis.least)
    high = nodes[-1] if axis.most is None else max(nodes[-1], axis.most)
    return np.array([low, *nodes[1:-1], high])


def _stable_box(
    gamma: Float64[np.ndarray, " gamma"],
    delta: Float64[np.ndarray, " delta"],
    delay: float,
    filters: Filters | None,
) -> tuple[float, tuple[float, float]]:
    """Return the largest alpha and the range of beta of the stable regions of some hands."""
    # Islands do not count where there is a component that contains small gains. Between these hands
    # a region may extend further; the margin of the axes covers that.
    hands = product(_thinned(gamma), _thinned(delta))
    regions = [known_region(*hand, delay, filters) for hand in hands]
    points = np.concatenate([region.reachable.points for region in regions])
    if not points.size:
        raise ValueError(
            f"no (alpha, beta) is stable at delay {delay:g}, so alpha and beta cannot be fitted, "
            "and errors have no scale; give their nodes without a wish, or other hands or delays."
        )
    alpha, beta = points.T
    return float(alpha.max()), (float(beta.min()), float(beta.max()))


def _thinned(nodes: Float64[np.ndarray, " node"]) -> list[float]:
    count = min(nodes.size, _MOST_SLICES)
    chosen: list[float] = nodes[np.linspace(0, nodes.size - 1, count).round().astype(int)].tolist()
    return chosen


def _fitted_alpha(
    count: int, gamma: Float64[np.ndarray, " gamma"], highest: float
) -> Float64[np.ndarray, " count"]:
    """Nodes from below the line alpha = -gamma, where stability ends, to above the region."""
    # The line sweeps a band with gamma. Cells that meet the line cannot be decided, so the band
    # gets nodes close to its edges.
    low, high = -gamma[-1], max(highest, -gamma[0])
    step = (1.0 + 2.0 * _MARGIN) * (high - low) / (count - 1)
    guard = _BAND_GUARD * max(gamma[-1] - gamma[0], step)
    band = (low - guard, -gamma[0] + guard)
    inside = min(max(1, round((band[1] - band[0]) / step)), count - 3)
    top = max(high, band[1]) + _MARGIN * (high - low)
    return np.concatenate(
        [
            [band[0] - step],
            np.linspace(*band, inside, endpoint=False),
            np.linspace(band[1], top, count - 1 - inside),
        ]
    )


# The tiles of the work.

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
            Tile(gamma, range(start, min(start + step, deltas)), delay)
            for delay in range(delays)
            for gamma in range(gammas)
            for start in range(0, deltas, step)
        ]

    def numbers(self, dimension: str, tile: Tile) -> range:
        """The indices along a dimension of the schema that are in a tile."""
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
        degrees = []  # no gain and no hand changes one
        for delay in self.grid.delay.tolist():
            point = by_name(0.0, 0.0, 0.0, 0.0, delay)
            coefficients = characteristic_polynomial(**point, **as_keywords(self.spec.filters))
            degrees.append(f"{delay:g} (degree {coefficients.shape[-1] - 1})")
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
    """The arrays of the chosen products in a tile, each of the shape ``plan.shape``."""
    arrays: dict[str, NDArray[Any]] = {}
    for name in plan.spec.products:
        arrays |= PRODUCTS[name].compute(plan, tile)
    return arrays


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
