"""What a specification means in numbers: the nodes along each axis, for each delay."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64

from jaxstab.atlas.compute.tolerance import known_region, tolerant_nodes
from jaxstab.atlas.format.schema import CELL, NODE
from jaxstab.atlas.format.spec import AtlasSpec, FittedAxis, ToleranceAxis, check_size
from jaxstab.boxes.columns import TERMS
from jaxstab.model.filters import Filters

_MARGIN = 0.03  # around the stable region, of its size
_BAND_GUARD = 0.02  # around the line alpha = -gamma, of the distance of two nodes or of its width
_MOST_SLICES = 5  # of gamma and of delta, to find the region's size


@dataclass(frozen=True)
class Grid:
    """The nodes of an atlas; alpha and beta have a column for each delay."""

    alpha: Float64[np.ndarray, "alpha_node delay"]
    beta: Float64[np.ndarray, "beta_node delay"]
    gamma: Float64[np.ndarray, " gamma"]
    delta: Float64[np.ndarray, " delta"]
    delay: Float64[np.ndarray, " delay"]
    limit_cells: int

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of nodes along alpha, beta, gamma, delta and delay."""
        axes = (self.alpha, self.beta, self.gamma, self.delta, self.delay)
        return tuple(axis.shape[0] for axis in axes)

    @property
    def cell_shape(self) -> tuple[int, ...]:
        """The number of cells along alpha, beta, gamma and delta, and of delays."""
        *nodes, delays = self.shape
        return (*(max(count - 1, 1) for count in nodes), delays)

    @property
    def lengths(self) -> dict[str, int]:
        """The lengths of the dimensions of nodes and cells, by the names of the schema."""
        lengths = dict(zip((*NODE, *CELL), (*self.shape, *self.cell_shape), strict=True))
        return lengths | {"limit_cell": self.limit_cells, "limit_term": 2 * len(TERMS)}

    def walls(
        self, delay: int
    ) -> tuple[Float64[np.ndarray, " alpha_node"], Float64[np.ndarray, " beta_node"], float]:
        """Return the nodes of alpha and beta at the delay of this index, and the delay."""
        return self.alpha[:, delay], self.beta[:, delay], float(self.delay[delay])

    def sides(self, axis: str) -> Float64[np.ndarray, "cell 2"]:
        """Return the ends of the cells along gamma or delta; one node alone is both of them."""
        nodes = getattr(self, axis)
        return np.stack([nodes, nodes] if nodes.size == 1 else [nodes[:-1], nodes[1:]], axis=-1)


def lay_out(spec: AtlasSpec) -> Grid:
    """Return the nodes of a specification, with the fitted axes laid around each stable region.

    Raises:
        ValueError: an axis is fitted to a stable region, or given by a tolerance, and the region is
            empty or unresolved; a parameter is too large for the model; or the grid is too large.
    """
    gamma, delta = (_plant_axis(spec, name) for name in ("gamma", "delta"))
    delay = np.array(spec.delay)
    walls = [_wall_axes(spec, gamma, delta, samples) for samples in delay.tolist()]
    alpha, beta = (np.stack(columns, axis=1) for columns in zip(*walls, strict=True))
    grid = Grid(alpha, beta, gamma, delta, delay, spec.limit_cells)
    check_size(grid.shape)
    return grid


def _plant_axis(spec: AtlasSpec, name: str) -> Float64[np.ndarray, " node"]:
    """Return the nodes of gamma or delta; those by tolerance with the other one at its ends."""
    axis = getattr(spec, name)
    if not isinstance(axis, ToleranceAxis):
        return np.array(axis)
    across = getattr(spec, "delta" if name == "gamma" else "gamma")
    nodes = [across.start, across.stop] if isinstance(across, ToleranceAxis) else list(across)
    ends, delays = sorted({nodes[0], nodes[-1]}), np.array(spec.delay).tolist()
    return tolerant_nodes(axis, name, ends, delays, spec.filters)


def _wall_axes(
    spec: AtlasSpec,
    gamma: Float64[np.ndarray, " gamma"],
    delta: Float64[np.ndarray, " delta"],
    delay: float,
) -> tuple[Float64[np.ndarray, " alpha_node"], Float64[np.ndarray, " beta_node"]]:
    if not isinstance(spec.alpha, FittedAxis) and not isinstance(spec.beta, FittedAxis):
        return np.array(spec.alpha), np.array(spec.beta)
    highest_alpha, beta_ends = _stable_box(gamma, delta, delay, spec.filters)
    alpha = (
        _fitted_alpha(spec.alpha.count, gamma, highest_alpha)
        if isinstance(spec.alpha, FittedAxis)
        else np.array(spec.alpha)
    )
    beta = (
        _fitted_beta(spec.beta.count, *beta_ends)
        if isinstance(spec.beta, FittedAxis)
        else np.array(spec.beta)
    )
    return alpha, beta


def _stable_box(
    gamma: Float64[np.ndarray, " gamma"],
    delta: Float64[np.ndarray, " delta"],
    delay: float,
    filters: Filters | None,
) -> tuple[float, tuple[float, float]]:
    """Return the largest alpha and the range of beta of the stable regions of some hands.

    Where turning gains up from 0 leads to a part of the region, islands do not count. Between these
    hands a region may reach further; the margin of the axes covers that.
    """
    hands = product(_thinned(gamma), _thinned(delta))
    regions = [known_region(*hand, delay, filters) for hand in hands]
    points = np.concatenate([(region.main or region).points for region in regions])
    if not points.size:
        raise ValueError(
            f"no (alpha, beta) is stable at delay {delay:g}, so alpha and beta cannot be fitted; "
            "give their nodes."
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
    """Return nodes from below the line alpha = -gamma, where stability ends, to above the region.

    The line sweeps a band with gamma. Cells that meet the line cannot be decided, so the band gets
    nodes close to its edges.
    """
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


def _fitted_beta(count: int, lowest: float, highest: float) -> Float64[np.ndarray, " count"]:
    margin = _MARGIN * (highest - lowest)
    return np.linspace(lowest - margin, highest + margin, count)
