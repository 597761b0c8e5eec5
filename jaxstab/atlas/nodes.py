"""The contents of an atlas at its nodes: limits of the stable alpha, and dense fields.

Limits, and the errors of cells. For the wall of the paper and the plants of haptic devices the
stable set of a plant is what lies between the line alpha = -gamma and the first arc of the boundary
curve: from theta -> 0, where the arc leaves that line, to the angle where it returns to it, while
beta rises all the way. Then all rows of all plants are solved together: the curve is known in
closed form (``region.closed_form``), and the angle of a row follows by the secant method. Whether a
range is of this kind is asked of exact regions at its corners and at some delays (``_is_arc``), and
of each arc of a run.

Everywhere else, and for loops with an estimator or a filter, the exact region of each plant gives
its rows (``region``). The rows are those of the component that holds small gains, or of the largest
one. Where a row has more than one stable interval its limits are unknown: NaN, and an infinite
error. Where another component reaches to other betas, nothing is said beyond the ends
(``LimitTable.beyond``).

An atlas is computed in runs of cells of delays (``LimitPlan.computed``), each with the exact limits
at the nodes that count there, and at the middles of its cells and of their faces and edges: at the
rows that the table interpolates, so that what the ends of beta miss is part of the error.

Dense fields: spectral radius, frequency and damping ratio, poles outside the circle. These are
plain arrays over the five axes, for pictures and for programs that know nothing of jaxstab;
``point.fields`` computes them. Axes of alpha and beta may be fitted: laid around the stable regions
of the atlas's hands at each delay, with a margin, and with nodes close to the line alpha = -gamma,
where stability ends (``_fitted_alpha``).

A node is *near* if it is stable, or a corner of a cell in the plane of alpha and beta that has a
stable corner: so contours at the boundary can be drawn. With ``where = "near"`` the other nodes
have NaN in place of radius, frequency and damping ratio, which makes a file smaller; ``outside`` is
given everywhere.

Work is divided into tiles (``Tile``), each a chunk of the file, compressed where it is computed.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.axis import Array, Axis, Cells, axes_of
from jaxstab.atlas.file import PACKED, packed
from jaxstab.atlas.spec import AtlasSpec, FieldSpec
from jaxstab.atlas.table import PLANT, LimitTable, largest_of_cells
from jaxstab.model import by_name
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.motion import dominant_mode
from jaxstab.point import closed_loop_poles, spectral_radius
from jaxstab.point.fields import fields_of_grid
from jaxstab.region import Branch, RegionStatus, stable_region
from jaxstab.region.closed_form import curve_point, slice_coefficients
from jaxstab.region.curve import bracketed_root
from jaxstab.region.measures import interval_ends

if TYPE_CHECKING:
    from jaxstab.atlas.spec import AtlasSpec

Arrays = dict[str, NDArray[np.generic]]


class _NoArcError(Exception):
    """A plant's stable set is not what lies between the line and the first arc."""


class Arcs:
    """Stable sets of plants between the line alpha = -gamma and the first arc of the curve.

    Those of the haptic range are; ``_NoArcError`` for others.

    Attributes:
        ends: (plant, 2), the ends of beta; NaN where nothing is stable.
        is_all: (plant,), whether no wall beyond the ends is stable.
    """

    @np.errstate(invalid="ignore", divide="ignore")  # roots within brackets may step aside
    def __init__(self, gamma: Array, delta: Array, delay: Array) -> None:
        longest_arc = 1.3  # of the arc of a free mass
        arc_points = 96
        self.gamma = gamma
        self._curve = slice_coefficients(gamma[:, None], delta[:, None], delay[:, None])
        longest = np.minimum(longest_arc * np.pi / 2.0 / (delay[:, None] + 1.0), np.pi)
        theta = longest * np.linspace(0.0, 1.0, arc_points)
        height = self._height(theta)
        falls = height[:, 1:] <= 0.0
        first = np.argmax(falls, axis=1)
        if not np.all(falls.any(axis=1) & (first > 0)):
            raise _NoArcError
        plant = np.arange(gamma.size)
        end = bracketed_root(self._height, theta[plant, first, None], theta[plant, first + 1, None])
        self._theta = end * np.linspace(0.0, 1.0, arc_points)
        self._beta = np.asarray(curve_point(self._curve, self._theta)[1])
        if not (
            np.all(np.diff(self._beta) > 0.0) and np.all(self._height(self._theta)[:, 1:-1] > 0)
        ):
            raise _NoArcError
        self.ends = self._beta[:, [0, -1]]
        self.is_all = np.ones(gamma.size, bool)

    def _height(self, theta: Array) -> Array:
        return np.asarray(curve_point(self._curve, theta)[0]) + self.gamma[:, None]

    @np.errstate(invalid="ignore", divide="ignore")
    def rows(self, beta: Array) -> Array:
        """The limits of alpha (plant, row, 2) at betas (plant, row), moved to the ends at most."""
        secant_steps = 6
        goals = np.clip(beta, self._beta[:, :1], self._beta[:, -1:])
        # Beta begins as a parabola in theta.
        squares = zip(goals, self._beta, self._theta**2, strict=True)
        theta = np.sqrt(np.stack([np.interp(*triple) for triple in squares]))
        last, missing = np.zeros_like(theta), self._beta[:, :1] - goals
        for _ in range(secant_steps):
            alpha, at = map(np.asarray, curve_point(self._curve, theta))
            before, missing = missing, at - goals
            step = missing * (theta - last) / (missing - before)
            last, theta = theta, theta - np.where(np.isfinite(step), step, 0.0)
        floor = np.broadcast_to(-self.gamma[:, None], goals.shape)
        is_end = (goals == self._beta[:, :1]) | (goals == self._beta[:, -1:])
        return np.stack([floor, np.where(is_end, floor, alpha)], axis=-1)


class _Regions:
    """Stable sets of plants by their exact regions; attributes and ``rows`` as of ``Arcs``."""

    def __init__(self, plants: Sequence[Array], filters: Filters | None) -> None:
        keywords = as_keywords(filters)
        self._regions = [
            stable_region(gamma=gamma, delta=delta, delay=delay, **keywords)
            for gamma, delta, delay in np.stack(plants, axis=-1).tolist()
        ]
        count = len(self._regions)
        self.ends, self.is_all = np.full((count, 2), np.nan), np.zeros(count, bool)
        for place, region in enumerate(self._regions):
            if region.status == RegionStatus.COMPLETE and region.components:
                spans = [(p.points[:, 1].min(), p.points[:, 1].max()) for p in region.components]
                self.ends[place] = spans[0]
                self.is_all[place] = spans[0] == (np.nanmin(spans), np.nanmax(spans))

    def rows(self, beta: Array) -> Array:
        outermost = 1e-9  # of the interval of beta: so far inside its ends are the outermost rows
        limits = np.full((*beta.shape, 2), np.nan)
        for own, goals, (low, high), region in zip(
            limits, beta, self.ends, self._regions, strict=True
        ):
            if low < high:
                aside = outermost * (high - low)
                values = np.clip(goals, low + aside, high - aside)
                found = interval_ends(region.curve, region.outline, values, axis=1)
                is_one = np.sum(~np.isnan(found), axis=1) == 2
                own[is_one] = found[is_one, :2]
        return limits


def _is_arc(spec: "AtlasSpec") -> bool:
    """True if regions at the corners of a range, and at some delays, are bounded by an arc."""
    most_asked = 12  # delays at which regions are asked whether the range is of arcs
    if spec.filters is not None:
        return False
    gamma, delta, delay = spec.nodes
    count = min(int(np.ptp(delay)) + 2, most_asked)
    asked = np.linspace(delay[0], delay[-1], count)
    delays = np.unique(np.concatenate([asked, np.floor(asked[asked >= np.ceil(delay[0])])]))
    hands = np.unique(gamma[[0, -1]]), np.unique(delta[[0, -1]])
    corners = product(*(axis.tolist() for axis in (*hands, delays)))
    return all(_is_bounded_by_an_arc(*corner) for corner in corners)


def _is_bounded_by_an_arc(gamma: float, delta: float, delay: float) -> bool:
    region = stable_region(gamma=gamma, delta=delta, delay=delay)
    branches, counts = np.unique(region.branch, return_counts=True)
    return (
        region.status == RegionStatus.COMPLETE
        and region.loops == 1
        and region.rows_are_intervals
        and branches.tolist() == [Branch.CURVE, Branch.Z_PLUS_ONE]
        and int(counts[1]) == 1
    )


class LimitPlan(NamedTuple):
    """The computation of an atlas's limits: by arcs where that may be, in runs of cells."""

    spec: "AtlasSpec"
    is_arc: bool

    @classmethod
    def of(cls, spec: "AtlasSpec") -> "LimitPlan":
        """Return the plan of a specification, by arcs if the corners of its range have one."""
        return cls(spec, _is_arc(spec))

    @property
    def runs(self) -> list[range]:
        """The numbers of nodes along delay of each run, of which neighbours share one."""
        cells_of_a_run = 8 if self.is_arc else 4
        last = len(self.spec.nodes[2]) - 1
        starts = range(0, last, cells_of_a_run) if last else [0]
        return [range(start, min(start + cells_of_a_run, last) + 1) for start in starts]

    def computed(self, run: range) -> Arrays:
        """Return the arrays of a run, named as those of ``LimitTable``."""
        gamma, delta, delay = axes_of(*self.spec.nodes)
        row = Axis(np.arange(float(self.spec.rows)))
        # The nodes that count in the cells of the run: some of them are beyond it.
        begin = int(delay.first[run.start])
        end = int(delay.first[max(run.stop - 2, run.start)]) + delay.width
        near = Axis(delay.nodes[begin:end], bends_at_integers=True)
        stencil = [_with_middles(nodes) for nodes in (gamma.nodes, delta.nodes)]
        stencil += [_with_middles(delay.nodes[run.start : run.stop]), _with_middles(row.nodes)]
        first_cells = 0, 0, run.start - begin, 0
        cells = [_cells(own.size, first) for own, first in zip(stencil, first_cells, strict=True)]
        axes = gamma, delta, near, row

        def between(nodal: Array, dimensions: int) -> Array:
            for along, own in enumerate(zip(axes[:dimensions], cells, stencil, strict=False)):
                axis, cell, values = own
                nodal = axis.interpolated(nodal, cell, values, along)
            return nodal

        delays = np.union1d(stencil[2], near.nodes)
        inside = np.searchsorted(delays, stencil[2])
        plants = [values.ravel() for values in np.meshgrid(*stencil[:2], delays, indexing="ij")]
        shape = (*(own.size for own in stencil[:2]), delays.size)
        nodes = np.ix_(
            *(np.arange(0, n, 2) for n in shape[:2]), np.searchsorted(delays, near.nodes)
        )
        stable = self._stable(*plants)
        ends = stable.ends.reshape(*shape, 2)
        spans = ends.copy()
        spans[:, :, inside] = interpolated_ends = between(ends[nodes], 3)
        spans[nodes] = ends[nodes]
        share = stencil[3] / row.cells
        beta = spans[..., :1] + share * (spans[..., 1:] - spans[..., :1])
        limits = stable.rows(beta.reshape(-1, share.size)).reshape(*shape, share.size, 2)
        at_nodes = limits[nodes][..., ::2, :]
        own = slice(run.start - begin, run.stop - begin)
        is_all = stable.is_all.reshape(shape)[:, :, inside].astype(float)
        return {
            "alpha_limits": at_nodes[:, :, own],
            "beta_limits": ends[nodes][:, :, own],
            "alpha_error": _largest(limits[:, :, inside] - between(at_nodes, 4), 4),
            "beta_error": _largest(ends[:, :, inside] - interpolated_ends, 3),
            "beyond": (-_largest_in_cells(-is_all, 3)).astype(np.int8),
        }

    def _stable(self, *plants: Array) -> Arcs | _Regions:
        if self.is_arc:
            with suppress(_NoArcError):
                return Arcs(*plants)
        return _Regions(plants, self.spec.filters)


def table_of(spec: "AtlasSpec") -> LimitTable:
    """The table of a specification, computed here."""
    plan = LimitPlan.of(spec)
    return joined(spec, [plan.computed(run) for run in plan.runs])


def joined(spec: "AtlasSpec", parts: Sequence[Mapping[str, NDArray[np.generic]]]) -> LimitTable:
    """The table of all runs in order."""
    whole: dict[str, Any] = {}
    for name in parts[0]:
        arrays = [part[name] for part in parts]
        if name in ("alpha_limits", "beta_limits"):  # neighbours share a node
            arrays = [arrays[0], *(array[:, :, 1:] for array in arrays[1:])]
        whole[name] = np.concatenate(arrays, axis=2)
    whole |= zip(PLANT, spec.nodes, strict=True)
    return LimitTable(row=np.linspace(0.0, 1.0, spec.rows), **whole)


def _with_middles(values: Array) -> Array:
    """Values with the middle between each two, along the first axis."""
    fine = np.empty((2 * len(values) - 1, *values.shape[1:]))
    fine[::2], fine[1::2] = values, 0.5 * (values[1:] + values[:-1])
    return fine


def _cells(count: int, first: int) -> Cells:
    """The cells of nodes with middles, from a first one on; the last node is in the last cell."""
    return first + np.minimum(np.arange(count) // 2, max(count // 2 - 1, 0))


def _largest_in_cells(values: Array, axes: int) -> Array:
    """The largest value of each cell of a stencil along the first axes; NaN counts as infinite."""
    halves = largest_of_cells(np.where(np.isnan(values), np.inf, values), axes)
    return largest_of_cells(halves, axes)[(slice(None, None, 2),) * axes]


def _largest(misses: Array, axes: int) -> NDArray[np.float32]:
    """The largest errors of cells, rounded up."""
    errors = _largest_in_cells(np.abs(misses), axes)
    rounded = errors.astype(np.float32)
    return np.where(rounded < errors, np.nextafter(rounded, np.float32(np.inf)), rounded)


# ------------------------------------------------------------------------------------------- fields
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
