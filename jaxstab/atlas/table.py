"""The limits of the stable alpha between the nodes of an atlas. NumPy alone.

A table has nodes along gamma, delta, delay and *row*. A row is a share u, from 0 to 1, of the
interval of beta in which a plant (gamma, delta, delay) has stable walls: so every row of every
plant has a lower and an upper limit of the stable alpha, and all delays share the axes. At nodes
these limits, and the ends of the interval of beta, are exact to rounding. Between nodes they are
multilinear.

Beside each cell stands its measured error: how far the multilinear limits are from the exact ones
at most, over a stencil of three nodes an axis, which has the middles of the cell and of its faces
and edges. That is no proof, so a verdict follows from the table only where alpha, and beta, are
clear of the limits by ``CLEAR`` times these errors. No point is answered from a cell with a plant
whose stable set is not known to have one interval of alpha in each row; and no beta beyond the ends
unless no wall at all is stable there (``beyond``). All other points are UNDECIDED here, and are
computed by whoever asks (``atlas.query``).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.conventions import Verdict

CLEAR: Final = 4.0
"""So many times the error of its cell a point must be away from a limit. Of 480,000 points the
interpolated limit was wrong by 2.2 times that at most, and by 1.3 times or less at 99.9 %."""

PLANT: Final = ("gamma", "delta", "delay")

Array = NDArray[np.float64]
Errors = NDArray[np.float32]
Codes = NDArray[np.int8]
Cells = NDArray[np.intp]
_BLOCK = 2**14  # points: what a block needs stays in the cache


class AlphaLimits(NamedTuple):
    """The smallest and the largest stable alpha, and the error of each.

    Attributes:
        lower, upper: interpolated limits; NaN where no alpha is stable, or nothing is known.
        lower_error, upper_error: the measured error of the cell, which a limit hardly ever exceeds
            (twice it in one of 100,000 places); infinite where nothing is known.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v4.h5")
        >>> limits = atlas.alpha_limits(0.3, gamma=0.0005, delta=0.01, delay=1.0)
        >>> round(float(limits.lower), 6), round(float(limits.upper), 2)
        (-0.0005, 0.14)
    """

    lower: Array
    upper: Array
    lower_error: Array
    upper_error: Array


class _Place(NamedTuple):
    """Where points are: the flat numbers of their plants' corners, weights of these, and cells."""

    corners: list[Cells]
    weights: list[Array]
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
    def _pairs(self) -> Array:
        """The limits at the two rows of each cell of rows, of all plants: (plant, cell, 4)."""
        limits = self.alpha_limits
        pairs = np.concatenate([limits[..., :-1, :], limits[..., 1:, :]], axis=-1)
        return pairs.reshape(-1, 4)

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
        (size,) = np.broadcast_shapes(*(v.shape for v in (alpha, beta, gamma, delta, delay)))
        codes = np.empty(size, np.int8)
        for start in range(0, size, _BLOCK):
            some = slice(start, start + _BLOCK)
            block = [v if v.size == 1 else v[some] for v in (alpha, beta, gamma, delta, delay)]
            codes[some] = self._codes(*block)
        return codes

    @np.errstate(invalid="ignore", divide="ignore", over="ignore")  # NaN is clear of nothing
    def _codes(self, alpha: Array, beta: Array, *plant: Array) -> Codes:
        place = self._place(*plant)
        band = self._allowed[1].take(place.cell, axis=0)
        low, high, row, u = self._rows(place, beta)
        is_within = (beta > low + band[:, 0]) & (beta < high - band[:, 1])
        is_beyond = (beta < low - band[:, 0]) | (beta > high + band[:, 1])
        limits = self._limits(place, row, u)
        room = self._allowed[0].take(place.cell * (self.row.size - 1) + row, axis=0)
        lower, upper = alpha - limits[:, 0], alpha - limits[:, 1]
        is_stable = (lower > room[:, 0]) & (upper < -room[:, 1])
        is_unstable = (lower < -room[:, 0]) | (upper > room[:, 1])
        is_unstable &= np.isfinite(room).all(axis=-1)
        unstable = is_within & is_unstable
        unstable |= is_beyond & (self.beyond.reshape(-1).take(place.cell) == 1)
        codes = np.full(np.broadcast(alpha, beta, unstable).size, Verdict.UNDECIDED, np.int8)
        codes[np.broadcast_to(place.is_inside & is_within & is_stable, codes.shape)] = (
            Verdict.STABLE
        )
        codes[np.broadcast_to(place.is_inside & unstable, codes.shape)] = Verdict.UNSTABLE
        return codes

    @np.errstate(invalid="ignore", divide="ignore")
    def limits(self, beta: Array, gamma: Array, delta: Array, delay: Array) -> AlphaLimits:
        """The limits at points, flat arrays of one length; NaN outside of nodes and rows."""
        place = self._place(gamma, delta, delay)
        low, high, row, u = self._rows(place, beta)
        is_known = place.is_inside & (beta >= low) & (beta <= high)
        limits = np.where(is_known[:, None], self._limits(place, row, u), np.nan)
        errors = self.alpha_error.reshape(-1, 2).take(
            place.cell * (self.row.size - 1) + row, axis=0
        )
        errors = np.where(np.isnan(limits), np.inf, errors.astype(float))
        return AlphaLimits(*limits.T, *errors.T)

    def ends(self, gamma: Array, delta: Array, delay: Array) -> Array:
        """The interpolated ends of beta, (point, 2); NaN outside of the nodes."""
        place = self._place(gamma, delta, delay)
        ends = self._blended(self.beta_limits.reshape(-1, 2), place, place.corners)
        return np.where(place.is_inside[:, None], ends, np.nan)

    def _place(self, *plant: Array) -> _Place:
        """Return the corners of the cells of plants, with their weights."""
        cell = np.zeros(1, np.intp)
        numbers, shares, is_inside = [], [], np.ones(1, bool)
        for nodes, values in zip(self.axes, plant, strict=True):
            is_inside = is_inside & (values >= nodes[0]) & (values <= nodes[-1])
            count = max(nodes.size - 1, 1)
            at = np.searchsorted(nodes[1:-1], values, "right") if nodes.size > 2 else 0
            at = np.broadcast_to(at, values.shape).astype(np.intp)
            width = nodes[at + 1] - nodes[at] if nodes.size > 1 else 1.0
            share = (values - nodes[at]) / width
            numbers.append([at, at + 1] if nodes.size > 1 else [at])
            shares.append([1.0 - share, share] if nodes.size > 1 else [np.ones(values.shape)])
            cell = cell * count + at
        corners, weights = [], []
        _, deltas, delays = map(np.size, self.axes)
        for i, j, k in product(*(range(len(pair)) for pair in numbers)):
            corners.append((numbers[0][i] * deltas + numbers[1][j]) * delays + numbers[2][k])
            weights.append(shares[0][i] * shares[1][j] * shares[2][k])
        return _Place(corners, weights, cell, is_inside)

    def _rows(self, place: _Place, beta: Array) -> tuple[Array, Array, Cells, Array]:
        """Return the ends of beta, the cells along the rows, and the shares of these."""
        low, high = self._blended(self.beta_limits.reshape(-1, 2), place, place.corners).T
        count = self.row.size - 1
        u = (beta - low) / (high - low) * count
        row = np.clip(np.nan_to_num(u), 0.0, count - 1.0).astype(np.intp)
        return low, high, row, u - row

    def _limits(self, place: _Place, row: Cells, share: Array) -> Array:
        """Return the limits of alpha in cells of rows, (point, 2)."""
        count = self.row.size - 1
        pairs = self._blended(
            self._pairs, place, [corner * count + row for corner in place.corners]
        )
        return pairs[:, :2] + share[:, None] * (pairs[:, 2:] - pairs[:, :2])

    @staticmethod
    def _blended(values: Array, place: _Place, corners: Sequence[Cells]) -> Array:
        total = values.take(corners[0], axis=0) * place.weights[0][:, None]
        for corner, weight in zip(corners[1:], place.weights[1:], strict=True):
            total += values.take(corner, axis=0) * weight[:, None]
        return total


def largest_of_cells(values: Array, axes: int = 3) -> Array:
    """The largest of the values at the corners of each cell along the first axes.

    An axis of one node has one cell, at it.
    """
    for axis in range(axes):
        if values.shape[axis] > 1:
            moved = np.moveaxis(values, axis, 0)
            values = np.moveaxis(np.maximum(moved[:-1], moved[1:]), 0, axis)
    return values
