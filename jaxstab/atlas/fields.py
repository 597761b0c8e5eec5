"""Dense fields at nodes: spectral radius, frequency and damping ratio, poles outside the circle.

These are plain arrays over the five axes, for pictures and for programs that know nothing of
jaxstab; ``point.fields`` computes them. Axes of alpha and beta may be fitted: laid around the
stable regions of the atlas's hands at each delay, with a margin, and with nodes close to the line
alpha = -gamma, where stability ends (``_fitted_alpha``).

A node is *near* if it is stable, or a corner of a cell in the plane of alpha and beta that has a
stable corner: so contours at the boundary can be drawn. With ``where = "near"`` the other nodes
have NaN in place of radius, frequency and damping ratio, which makes a file smaller; ``outside`` is
given everywhere.

Work is divided into tiles (``Tile``), each a chunk of the file, compressed where it is computed.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.file import PACKED, packed
from jaxstab.atlas.spec import AtlasSpec, FieldSpec
from jaxstab.atlas.table import PLANT
from jaxstab.model import by_name
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.motion import dominant_mode
from jaxstab.point import closed_loop_poles, spectral_radius
from jaxstab.point.fields import fields_of_grid
from jaxstab.region import RegionStatus, stable_region

Floats = NDArray[np.float64]

_MARGIN = 0.03  # around the stable region, of its size


@dataclass(frozen=True)
class FieldGrid:
    """The nodes of fields; alpha and beta have a column for each delay."""

    alpha: Floats
    beta: Floats
    gamma: Floats
    delta: Floats
    delay: Floats

    @property
    def deltas_of_a_tile(self) -> int:
        """The largest number of nodes along delta that are in one tile."""
        tile_nodes = 2**18  # at most, where a tile holds more than one slice
        return min(max(1, tile_nodes // (len(self.alpha) * len(self.beta))), self.delta.size)

    @property
    def chunk(self) -> tuple[int, ...]:
        """The shape of a whole tile."""
        return len(self.alpha), len(self.beta), 1, self.deltas_of_a_tile, 1

    @property
    def tiles(self) -> list["Tile"]:
        """The units of work; none needs another."""
        step, deltas = self.deltas_of_a_tile, self.delta.size
        starts = range(0, deltas, step)
        numbers = product(range(self.delay.size), range(self.gamma.size), starts)
        return [Tile(i, range(j, min(j + step, deltas)), k) for k, i, j in numbers]


class Tile(NamedTuple):
    """All alpha and beta at one gamma, some neighbouring delta and one delay, by their numbers."""

    gamma: int
    delta: range
    delay: int


def lay_out(spec: AtlasSpec) -> FieldGrid:
    """The nodes of a specification's fields, with fitted axes laid around each stable region.

    ValueError: an axis is fitted to a stable region that is empty or unresolved.
    """
    own = spec.fields
    assert own is not None
    gamma, delta, delay = (np.array(axis, float) for axis in (own.gamma, own.delta, own.delay))
    walls = [_wall_axes(own, spec.filters, samples) for samples in delay.tolist()]
    alpha, beta = (np.stack(columns, axis=1) for columns in zip(*walls, strict=True))
    return FieldGrid(alpha, beta, gamma, delta, delay)


def _wall_axes(own: FieldSpec, filters: Filters | None, delay: float) -> tuple[Floats, Floats]:
    alpha, beta = own.alpha, own.beta
    if isinstance(alpha, int) or isinstance(beta, int):
        gamma, delta = np.array(own.gamma, float), np.array(own.delta, float)
        highest, *ends = _stable_box(gamma, delta, delay, filters)
        margin = _MARGIN * (ends[1] - ends[0])
        if isinstance(alpha, int):
            alpha = _fitted_alpha(alpha, gamma, highest)
        if isinstance(beta, int):
            beta = np.linspace(ends[0] - margin, ends[1] + margin, beta)
    return np.array(alpha, float), np.array(beta, float)


def _stable_box(
    gamma: Floats, delta: Floats, delay: float, filters: Filters | None
) -> tuple[float, float, float]:
    """Return the largest alpha, the lowest and the highest beta of the regions of some hands."""
    fineness = 1e-3  # of outlines, whose extremes are exact
    # Islands do not count where there is a component that contains small gains. Between these hands
    # a region may extend further; the margin of the axes covers that.
    points = []
    few = (np.unique(nodes[[0, nodes.size // 2, -1]]).tolist() for nodes in (gamma, delta))
    for hand in product(*few):
        region = stable_region(**by_name(*hand, delay), tolerance=fineness, **as_keywords(filters))
        if region.status == RegionStatus.UNRESOLVED:
            raise ValueError(
                f"no axis can be laid around the region at gamma {hand[0]:g}, delta {hand[1]:g}, "
                f"delay {delay:g} ({RegionStatus.UNRESOLVED.words}); give its nodes."
            )
        points.append((region.main or region).points)
    alpha, beta = np.concatenate(points).T
    if not alpha.size:
        raise ValueError(
            f"no (alpha, beta) is stable at delay {delay:g}, so alpha and beta cannot be fitted; "
            "give their nodes, or other hands or delays."
        )
    return float(np.nanmax(alpha)), float(np.nanmin(beta)), float(np.nanmax(beta))


def _fitted_alpha(count: int, gamma: Floats, highest: float) -> Floats:
    """Nodes from below the line alpha = -gamma, where stability ends, to above the region."""
    band_guard = 0.02  # around the line alpha = -gamma, of two nodes' distance or of its width
    # The line sweeps a band with gamma. Contours bend at its edges, so these get close nodes.
    low, high = -gamma[-1], max(highest, -gamma[0])
    step = (1.0 + 2.0 * _MARGIN) * (high - low) / (count - 1)
    guard = band_guard * max(gamma[-1] - gamma[0], step)
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


def packed_fields(spec: AtlasSpec, grid: FieldGrid, tile: Tile) -> dict[str, bytes]:
    """The chunks of a tile, by the names of the fields."""
    own = spec.fields
    assert own is not None
    k = tile.delay
    delta = grid.delta[tile.delta.start : tile.delta.stop]
    fields = fields_of_grid(
        grid.alpha[:, k],
        grid.beta[:, k],
        np.full_like(delta, grid.gamma[tile.gamma]),
        delta,
        float(grid.delay[k]),
        spec.filters,
        longest=float(grid.delay[-1]),
        method=own.method,
    )
    if own.where == "near":
        # Where a pole is on the circle, or too close to it to tell, the radius decides.
        least = fields.radius - fields.error
        near = _near((fields.outside == 0) | ((fields.outside < 0) & (least <= 1.0)))
        for values in fields[:-1]:
            np.copyto(values, np.nan, where=~near)
    return {
        name: packed(np.asarray(values)[:, :, None, :, None], grid.chunk)
        for name, values in zip(PACKED, fields, strict=True)
    }


def _near(stable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """True for nodes at corners of cells along the first two axes with a stable corner."""
    near = stable.copy()
    for axis in (0, 1):
        along = near.swapaxes(0, axis)
        before = along.copy("K")
        along[1:] |= before[:-1]
        along[:-1] |= before[1:]
    return near


def wrong_nodes(
    group: Mapping[str, Any], filters: Filters | None, count: int, chance: np.random.Generator
) -> int:
    """Count nodes of a file, of about ``count``, that differ from a new computation.

    Radius and poles are those of eigenvalues of the companion matrix, all at nodes of one slice.
    """
    near_circle, same, apart = 1e-6, 2e-6, 1e-5  # of poles from the circle, of modes, of two moduli
    shape, keywords = group["outside"].shape, as_keywords(filters)
    i, j = (chance.integers(0, n, count) for n in shape[:2])
    place = [int(chance.integers(0, n)) for n in shape[2:]]
    plant = [float(group[name][at]) for name, at in zip(PLANT, place, strict=True)]
    alpha, beta = (group[name][:, place[-1]] for name in ("alpha", "beta"))
    point = by_name(alpha[i], beta[j], *plant)
    here = (slice(None), slice(None), *place)
    given = {name: np.asarray(group[name][here], float)[i, j] for name in PACKED}
    radius = spectral_radius(**point, method="companion", **keywords)
    poles = np.asarray(closed_loop_poles(**point, **keywords))
    upper, error = given["spectral_radius"], given["spectral_radius_error"]
    is_within = radius.value - radius.error <= upper
    is_within &= np.isinf(error) | (radius.value + radius.error >= upper - error)
    off = ~(np.isnan(upper) | is_within)  # NaN in the new computation is wrong, too
    moduli = np.abs(poles)
    off |= (given["outside"] == 0) & np.isnan(error) | np.isnan(upper) & np.isfinite(error)
    counted = (np.min(np.abs(moduli - 1.0), axis=-1) > near_circle) & (given["outside"] >= 0)
    off |= counted & (np.sum(moduli > 1.0, axis=-1) != given["outside"])
    # Eigenvalues tell the dominant pole, and its frequency, where it is simple.
    others = np.min(np.abs(poles[:, :1] - poles[:, 1:]), axis=-1)
    rival = np.where(poles[:, 0].imag == 0.0, moduli[:, 1], moduli[:, 2])
    simple = (moduli[:, 0] - rival > apart) & (others > apart**0.5)
    mode = dominant_mode(**point, **keywords)
    for name, value in (("frequency", mode.frequency), ("damping_ratio", mode.damping_ratio)):
        off |= simple & (np.abs(value - given[name]) > same)
    return int(np.sum(off))
