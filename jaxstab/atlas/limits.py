"""Limits of the stable alpha at the nodes of an atlas, and the errors of its cells.

For the wall of the paper and the plants of haptic devices the stable set of a plant is what lies
between the line alpha = -gamma and the first arc of the boundary curve: from theta -> 0, where the
arc leaves that line, to the angle where it returns to it, while beta rises all the way. Then all
rows of all plants are solved together: the curve is known in closed form (``region.closed_form``),
and the angle of a row follows by the secant method. Whether a range is of this kind is asked of
exact regions at its corners and at some delays (``_is_arc``), and of each arc of a run.

Everywhere else, and for loops with an estimator or a filter, the exact region of each plant gives
its rows (``region``). The rows are those of the component that holds small gains, or of the largest
one. Where a row has more than one stable interval its limits are unknown: NaN, and an infinite
error. Where another component reaches to other betas, nothing is said beyond the ends
(``LimitTable.beyond``).

An atlas is computed in runs of cells of delays (``limits_of_cells``), each with the exact limits at
its nodes, and at the middles of its cells and of their faces and edges: at the rows that the table
interpolates, so that what the ends of beta miss is part of the error.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.table import PLANT, Array, LimitTable, largest_of_cells
from jaxstab.model.filters import Filters, as_keywords
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
        theta = np.stack(
            [np.interp(*pair) for pair in zip(goals, self._beta, self._theta, strict=True)]
        )
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
        cells_of_a_run = 8
        last = len(self.spec.nodes[2]) - 1
        step = cells_of_a_run if self.is_arc else 1
        starts = range(0, last, step) if last else [0]
        return [range(start, min(start + step, last) + 1) for start in starts]

    def computed(self, run: range) -> Arrays:
        """Return the arrays of a run, named as those of ``LimitTable``."""
        spec = self.spec
        gamma, delta, delay = spec.nodes
        axes = gamma, delta, delay[run.start : run.stop]
        fine = [_with_middles(nodes) for nodes in axes]
        plants = [values.ravel() for values in np.meshgrid(*fine, indexing="ij")]
        shape = tuple(nodes.size for nodes in fine)
        stable = self._stable(*plants)
        nodes = tuple(slice(None, None, 2) if n.size > 1 else slice(None) for n in axes)
        ends = stable.ends.reshape(*shape, 2)
        between = _interpolated(ends[nodes])
        row = _with_middles(np.linspace(0.0, 1.0, spec.rows))
        beta = between[..., :1] + row * (between[..., 1:] - between[..., :1])
        limits = stable.rows(beta.reshape(-1, row.size)).reshape(*shape, row.size, 2)
        at_nodes = limits[nodes][..., ::2, :]
        exact, interpolated = limits, _interpolated(at_nodes, axes=4)
        aside = np.abs(exact - interpolated)
        beta_aside = np.abs(ends - between)
        is_all = stable.is_all.reshape(shape).astype(float)
        return {
            "alpha_limits": at_nodes,
            "beta_limits": ends[nodes],
            "alpha_error": _rounded_up(_largest_in_cells(aside, 4)),
            "beta_error": _rounded_up(_largest_in_cells(beta_aside, 3)),
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


def _interpolated(values: Array, axes: int = 3) -> Array:
    """Values at nodes with those at middles, multilinear, along the first axes."""
    for axis in range(axes):
        values = np.moveaxis(_with_middles(np.moveaxis(values, axis, 0)), 0, axis)
    return values


def _largest_in_cells(values: Array, axes: int) -> Array:
    """The largest value of each cell of a stencil along the first axes; NaN counts as infinite."""
    halves = largest_of_cells(np.where(np.isnan(values), np.inf, values), axes)
    return largest_of_cells(halves, axes)[(slice(None, None, 2),) * axes]


def _rounded_up(errors: Array) -> NDArray[np.float32]:
    rounded = errors.astype(np.float32)
    return np.where(rounded < errors, np.nextafter(rounded, np.float32(np.inf)), rounded)
