"""The limits of the stable alpha between the nodes of an atlas. NumPy alone.

A table has nodes along gamma, delta, delay and *row*. A row is a share u, from 0 to 1, of the
interval of beta in which a plant (gamma, delta, delay) has stable walls: so every row of every
plant has a lower and an upper limit of the stable alpha, and all delays share the axes. At nodes
these limits, and the ends of the interval of beta, are exact to rounding. Between nodes they are
cubic along each axis, through the four nearest nodes (``atlas.axis``).

Each cell has a measured error: the largest difference between the cubic limits and the exact ones,
over a stencil of three nodes an axis, which has the middles of the cell and of its faces and edges.
That is no proof, so a verdict follows from the table only where alpha, and beta, are
clear of the limits by ``CLEAR`` times these errors. No point is answered from a cell for which a
plant counts whose stable set is not known to have one interval of alpha in each row; and no beta
beyond the ends unless no wall at all is stable there (``beyond``). All other points are UNDECIDED
here, and are computed by whoever asks (``atlas.query``).

The points of a block are sorted by the cells of their plants. Those of one cell share its nodes, so
one product of matrices gives the rows of all their plants.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.axis import Array, Axis, Cells, axes_of
from jaxstab.conventions import Verdict

CLEAR: Final = 4.0
"""So many times the error of its cell a point must be away from a limit. At 100,000 random
walls, no limit of tables of 468 to 373,455 nodes was wrong by more than 1.3 times that (``ratio``
in the record of ``benchmarks resolution``)."""

PLANT: Final = ("gamma", "delta", "delay")

Errors = NDArray[np.float32]
Codes = NDArray[np.int8]
_BLOCK = 2**20  # values of rows of plants: what a block of points needs stays in the cache


class AlphaLimits(NamedTuple):
    """The smallest and the largest stable alpha, and the error of each.

    Attributes:
        lower, upper: interpolated limits; NaN where no alpha is stable, or nothing is known.
        lower_error, upper_error: the measured error of the cell, which the error of a limit hardly
            ever exceeds (``atlas.table.CLEAR``); infinite where nothing is known.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v5.h5")
        >>> limits = atlas.alpha_limits(0.3, gamma=0.0005, delta=0.01, delay=1.0)
        >>> round(float(limits.lower), 6), round(float(limits.upper), 2)
        (-0.0005, 0.14)
    """

    lower: Array
    upper: Array
    lower_error: Array
    upper_error: Array


class _Plants(NamedTuple):
    """Plants of points, or one for all: their ends of beta with their rows, and their cells."""

    rows: Array  # (plant, 2 + 2 rows): of the ends and of each row the lower limit and the upper
    cell: Cells
    is_inside: NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True)
class LimitTable:
    """Limits at nodes with the errors of cells, and what they say of points.

    Attributes:
        row, gamma, delta, delay: ascending nodes; rows are from 0 to 1.
        alpha_limits: (gamma, delta, delay, row, 2); NaN where nothing is stable, or known.
        beta_limits: (gamma, delta, delay, 2), likewise.
        alpha_error: (gamma_cell, delta_cell, delay_cell, row_cell, 2). An axis of one node has
            one cell, at it.
        beta_error: (gamma_cell, delta_cell, delay_cell, 2).
        beyond: the same shape without the ends; 1 where no wall beyond the ends of beta is stable.
    """

    row: Array
    gamma: Array
    delta: Array
    delay: Array
    alpha_limits: Array
    beta_limits: Array
    alpha_error: Errors
    beta_error: Errors
    beyond: Codes

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays by name, as a file has them."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """The nodes along gamma, delta and delay."""
        return self.gamma, self.delta, self.delay

    @cached_property
    def _axes(self) -> tuple[Axis, Axis, Axis]:
        return axes_of(*self.axes)

    @cached_property
    def _row(self) -> Axis:
        return Axis(np.arange(float(self.row.size)))

    @cached_property
    def _nodal(self) -> Array:
        """The ends of beta and the rows of the plants at nodes, as those of ``_Plants``."""
        limits = self.alpha_limits
        return np.concatenate([self.beta_limits, limits.reshape(*limits.shape[:3], -1)], axis=-1)

    @cached_property
    def _allowed(self) -> tuple[Array, Array]:
        """CLEAR times the errors of alpha and of beta, with room for what is rounded."""
        rounding = 2.0**-44  # of the largest gain of a cell: many times what interpolation rounds
        sizes = np.nan_to_num(np.max(np.abs(self.alpha_limits), initial=0.0, axis=(-1, -2)))
        spans = np.nan_to_num(np.max(np.abs(self.beta_limits), initial=0.0, axis=-1))
        alpha_size, beta_size = (largest_of_cells(values) for values in (sizes, spans))
        alpha = CLEAR * self.alpha_error.astype(float) + rounding * alpha_size[..., None, None]
        beta = CLEAR * self.beta_error.astype(float) + rounding * beta_size[..., None]
        return alpha.reshape(-1, 2), beta.reshape(-1, 2)

    def verdicts(
        self, alpha: Array, beta: Array, gamma: Array, delta: Array, delay: Array
    ) -> Codes:
        """The codes of points, flat arrays of one length or of length 1; UNDECIDED if not clear."""
        return self._of_points(self._codes, (alpha, beta), (gamma, delta, delay))

    def limits(self, beta: Array, gamma: Array, delta: Array, delay: Array) -> AlphaLimits:
        """The limits at points, flat arrays of one length; NaN outside of nodes and rows."""
        return AlphaLimits(*self._of_points(self._known, (beta,), (gamma, delta, delay)).T)

    def ends(self, gamma: Array, delta: Array, delay: Array) -> Array:
        """The interpolated ends of beta, (point, 2); NaN outside of the nodes."""
        return self._of_points(self._ends, (), (gamma, delta, delay))

    @np.errstate(invalid="ignore", divide="ignore", over="ignore")  # NaN is clear of nothing
    def _of_points(
        self, answer: Callable[..., Any], walls: Sequence[Array], plant: Sequence[Array]
    ) -> Any:
        """What an answer says of points, in blocks that are sorted by the nodes of their plants."""
        (size,) = np.broadcast_shapes(*(values.shape for values in (*walls, *plant)))
        number_type = np.min_scalar_type(self._nodal.size)  # short numbers are sorted faster
        step = max(1, _BLOCK // self._nodal.shape[-1])
        found = []
        for start in range(0, max(size, 1), step):
            block = [v if v.size == 1 else v[start : start + step] for v in (*walls, *plant)]
            cells = [axis.cell(v) for axis, v in zip(self._axes, block[-3:], strict=True)]
            nodes = [axis.first.take(cell) for axis, cell in zip(self._axes, cells, strict=True)]
            first = (nodes[0] * self.delta.size + nodes[1]) * self.delay.size + nodes[2]
            order = np.argsort(first.astype(number_type), kind="stable")
            if order.size > 1:
                cells = [v if v.size == 1 else v[order] for v in cells]
                block = [v if v.size == 1 else v[order] for v in block]
            part = answer(self._plants(first[order], cells, block[-3:]), *block[:-3])
            if order.size > 1:
                part[order] = part.copy()
            found.append(part)
        return np.concatenate(found)

    def _plants(self, first: Cells, cells: Sequence[Cells], plant: Sequence[Array]) -> _Plants:
        """Plants in cells along each axis, sorted by the first node that counts for them."""
        axes = self._axes
        is_inside, weights, near = np.ones(1, bool), np.ones((1, 1)), np.zeros(1, np.intp)
        for axis, own, values in zip(axes, cells, plant, strict=True):
            is_inside = is_inside & (values >= axis.nodes[0]) & (values <= axis.nodes[-1])
            weights = weights[:, None] * axis.weights(own, values)
            weights = weights.reshape(near.size * axis.width, weights.shape[-1])
            near = (near[:, None] * axis.nodes.size + np.arange(axis.width)).reshape(-1)
        nodal = self._nodal.reshape(-1, self._nodal.shape[-1])
        rows = np.empty((first.size, nodal.shape[-1]))
        starts = [0, *(np.flatnonzero(np.diff(first)) + 1).tolist()][: first.size]
        for start, stop in pairwise([*starts, first.size]):
            values = nodal.take(first[start] + near, axis=0)
            np.matmul(weights[:, start:stop].T, values, out=rows[start:stop])
        counts = [axis.cells for axis in axes]
        return _Plants(rows, (cells[0] * counts[1] + cells[1]) * counts[2] + cells[2], is_inside)

    def _codes(self, plants: _Plants, alpha: Array, beta: Array) -> Codes:
        band = self._allowed[1].take(plants.cell, axis=0)
        low, high = plants.rows[:, 0], plants.rows[:, 1]
        is_within = (beta > low + band[:, 0]) & (beta < high - band[:, 1])
        is_beyond = (beta < low - band[:, 0]) | (beta > high + band[:, 1])
        least, most, cell = self._between(plants, beta)
        room = self._allowed[0].take(cell, axis=0)
        lower, upper = alpha - least, alpha - most
        is_stable = (lower > room[:, 0]) & (upper < -room[:, 1])
        is_unstable = (lower < -room[:, 0]) | (upper > room[:, 1])
        is_unstable &= np.isfinite(room).all(axis=-1)
        unstable = is_within & is_unstable
        unstable |= is_beyond & (self.beyond.reshape(-1).take(plants.cell) == 1)
        codes = np.full(np.broadcast(alpha, beta, unstable).size, Verdict.UNDECIDED, np.int8)
        codes[np.broadcast_to(plants.is_inside & is_within & is_stable, codes.shape)] = (
            Verdict.STABLE
        )
        codes[np.broadcast_to(plants.is_inside & unstable, codes.shape)] = Verdict.UNSTABLE
        return codes

    def _known(self, plants: _Plants, beta: Array) -> Array:
        """Limits with their errors, (point, 4); NaN and infinite where nothing is known."""
        is_known = plants.is_inside & (beta >= plants.rows[:, 0]) & (beta <= plants.rows[:, 1])
        least, most, cell = self._between(plants, beta)
        limits = np.where(is_known, np.stack([least, most]), np.nan)
        errors = self.alpha_error.reshape(-1, 2).take(cell, axis=0).T
        return np.concatenate([limits, np.where(np.isnan(limits), np.inf, errors)]).T

    @staticmethod
    def _ends(plants: _Plants) -> Array:
        return np.where(plants.is_inside[:, None], plants.rows[:, :2], np.nan)

    def _between(self, plants: _Plants, beta: Array) -> tuple[Array, Array, Cells]:
        """Return the limits of alpha between rows, and the numbers of the cells there."""
        low, high = plants.rows[:, 0], plants.rows[:, 1]
        u = (beta - low) / (high - low) * (self.row.size - 1)
        row = np.clip(np.nan_to_num(u), 0.0, self.row.size - 2.0).astype(np.intp)
        begin = np.arange(0, plants.rows.size, plants.rows.shape[1]) + 2
        begin = begin + 2 * self._row.first.take(row)
        least, most = (
            sum(
                weight * plants.rows.take(begin + (2 * number + end))
                for number, weight in enumerate(self._row.weights(row, u))
            )
            for end in (0, 1)
        )
        return least, most, plants.cell * self._row.cells + row


def largest_of_cells(values: Array, axes: int = 3) -> Array:
    """The largest of the values at the corners of each cell along the first axes.

    An axis of one node has one cell, at it.
    """
    for axis in range(axes):
        if values.shape[axis] > 1:
            moved = np.moveaxis(values, axis, 0)
            values = np.moveaxis(np.maximum(moved[:-1], moved[1:]), 0, axis)
    return values
