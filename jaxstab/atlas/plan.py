"""What a specification means in numbers: the nodes of each delay, and the tiles of work."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.atlas.spec import AtlasSpec, FittedAxis
from jaxstab.boundary.curve import boundary_curve, minus_line
from jaxstab.stability import spectral_radius

_MARGIN = 0.03  # around the stable region, of its size
_BAND_GUARD = 0.02  # around the line alpha = -gamma, of the distance of two nodes or of its width
_ANGLES = 256
_MOST_SLICES = 5  # of gamma and of delta, to find the region's size
_TOLERANCE = 1e-6  # a double root on the circle is computed that well


@dataclass(frozen=True)
class Grid:
    """The nodes of an atlas; alpha and beta have a column for each delay."""

    alpha: Float64[np.ndarray, "alpha_node delay"]
    beta: Float64[np.ndarray, "beta_node delay"]
    gamma: Float64[np.ndarray, " gamma"]
    delta: Float64[np.ndarray, " delta"]
    delay: Float64[np.ndarray, " delay"]

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of nodes along alpha, beta, gamma, delta and delay."""
        axes = (self.alpha, self.beta, self.gamma, self.delta, self.delay)
        return tuple(axis.shape[0] for axis in axes)

    @property
    def cell_shape(self) -> tuple[int, ...]:
        """The number of cells along alpha, beta, gamma and delta, and of delays."""
        *nodes, delays = self.shape
        return (*(count - 1 for count in nodes), delays)


class Tile(NamedTuple):
    """A unit of work: all alpha, beta and delta at one gamma (node or cell) and one delay."""

    gamma: int
    delay: int


def lay_out(spec: AtlasSpec) -> Grid:
    """Return the nodes of a specification, with the fitted axes laid around each stable region.

    Raises:
        ValueError: an axis is to be fitted to a stable region that is empty; or a parameter is too
            large for the model.
        RuntimeError: JAX's x64 mode is off.
    """
    gamma, delta, delay = (np.array(axis) for axis in (spec.gamma, spec.delta, spec.delay))
    walls = [_wall_axes(spec, gamma, delta, samples) for samples in delay.tolist()]
    alpha, beta = (np.stack(columns, axis=1) for columns in zip(*walls, strict=True))
    return Grid(alpha, beta, gamma, delta, delay)


def node_tiles(spec: AtlasSpec) -> list[Tile]:
    """Return the tiles that cover all nodes."""
    *_, gamma, _, delay = spec.shape
    return [Tile(g, d) for d in range(delay) for g in range(gamma)]


def cell_tiles(spec: AtlasSpec) -> list[Tile]:
    """Return the tiles that cover all cells; each needs the nodes of two tiles."""
    *_, gamma, _, delay = spec.shape
    return [Tile(g, d) for d in range(delay) for g in range(gamma - 1)]


def _wall_axes(
    spec: AtlasSpec,
    gamma: Float64[np.ndarray, " gamma"],
    delta: Float64[np.ndarray, " delta"],
    delay: float,
) -> tuple[Float64[np.ndarray, " alpha_node"], Float64[np.ndarray, " beta_node"]]:
    if not isinstance(spec.alpha, FittedAxis) and not isinstance(spec.beta, FittedAxis):
        return np.array(spec.alpha), np.array(spec.beta)
    highest_alpha, beta_ends = _stable_box(gamma, delta, delay)
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
    gamma: Float64[np.ndarray, " gamma"], delta: Float64[np.ndarray, " delta"], delay: float
) -> tuple[float, tuple[float, float]]:
    """Return the largest alpha and the range of beta of the stable region, over (gamma, delta).

    They are found among sampled points of the boundary: on the curve, and where the lines of a root
    at 1 and at -1 meet. So this is close, not proved; the margin of the axes covers the rest.
    """
    stiffness, damping = _thinned(gamma)[:, None, None], _thinned(delta)[:, None]
    even = np.linspace(0.0, 1.0, _ANGLES)
    angles = np.pi * np.concatenate([even**2, even])  # at a long delay the region's edge is near 0
    curve = boundary_curve(angles, stiffness, damping, delay)
    both_lines = (minus_line(0.0, stiffness, damping, delay) + stiffness) / 2.0
    alpha = np.concatenate([curve[0], np.broadcast_to(-stiffness, both_lines.shape)], axis=-1)
    beta = np.concatenate([curve[1], both_lines], axis=-1)
    possible = np.isfinite(alpha) & np.isfinite(beta)
    alpha, beta = np.where(possible, alpha, 0.0), np.where(possible, beta, 0.0)
    radius = np.asarray(spectral_radius(alpha, beta, stiffness, damping, delay).value)
    edge = possible & (radius < 1.0 + _TOLERANCE)
    if np.unique(beta[edge]).size < 2:
        raise ValueError(
            f"no stable region was found at delay {delay:g}, so alpha and beta cannot be fitted to "
            "it; give their nodes."
        )
    return float(alpha[edge].max()), (float(beta[edge].min()), float(beta[edge].max()))


def _thinned(nodes: Float64[np.ndarray, " node"]) -> Float64[np.ndarray, " some"]:
    count = min(nodes.size, _MOST_SLICES)
    some: np.ndarray = nodes[np.linspace(0, nodes.size - 1, count).round().astype(int)]
    return some


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
