"""Lookups in the limits of alpha: one column of the table decides a point. NumPy alone.

A column is a cell along beta, gamma and delta. It holds two planes over (beta, gamma, delta), the
lower and the upper limit of the stable alphas, and the error of each (``schema.ALPHA_LIMITS``).
"""

from bisect import bisect_right
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]
Range = tuple[float, float]

_CHUNK = 2**13  # points: their columns stay in the cache
_ignoring = np.errstate(over="ignore", invalid="ignore")  # infinite limits may have infinite errors


class AlphaLimits(NamedTuple):
    """The smallest and largest stable alpha of points, each with a proved error bound.

    Every alpha from ``lower + lower_error`` to ``upper - upper_error`` is stable, and every one
    below ``lower - lower_error`` or above ``upper + upper_error`` in the atlas is unstable. Where
    none is stable both are NaN with an error of 0; an infinite limit is beyond the atlas, and with
    an infinite error nothing is known.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> limits = atlas.alpha_limits(0.3, 0.0005, 0.01, delay=1.0)
        >>> print(f"up to {limits.upper:.6f}, wrong by less than {limits.upper_error:.0e}")
        up to 0.136756, wrong by less than 4e-04
    """

    lower: Floats
    lower_error: Floats
    upper: Floats
    upper_error: Floats


class MaxAlpha(NamedTuple):
    """The largest stable alpha of hands, by proofs; NaN where none is proved stable.

    A hand is stable at ``beta`` and every alpha just below ``alpha``, and at no alpha of the atlas
    above ``bound``, whatever beta.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> largest = atlas.max_alpha(0.0005, 0.01, delay=1.0)
        >>> print(f"{largest.alpha:.4f} at {largest.beta:.4f}, none above {largest.bound:.4f}")
        0.1489 at 0.4343, none above 0.1496
    """

    alpha: Floats
    beta: Floats
    bound: Floats


class LimitTable:
    """The columns of one delay.

    Args:
        planes: (limit_cell, gamma_cell, delta_cell, 10): constant, slopes along beta, gamma and
            delta, and error, of the lower and then of the upper limit.
        alpha: ascending nodes of alpha, of which the ends count.
        beta: ascending nodes of beta, of which the ends count: the cells between them are even.
        gamma: nodes of gamma, one or ascending.
        delta: nodes of delta, one or ascending.
    """

    def __init__(
        self, planes: Floats, *, alpha: Floats, beta: Floats, gamma: Floats, delta: Floats
    ) -> None:
        self._cells, gammas, deltas, terms = planes.shape
        self._columns = np.ascontiguousarray(planes).reshape(-1, terms)
        nodes = {"alpha": alpha, "beta": beta, "gamma": gamma, "delta": delta}
        self._ends = {name: (float(along[0]), float(along[-1])) for name, along in nodes.items()}
        self._beta, highest = self._ends["beta"]
        self._per_beta = self._cells / (highest - self._beta)
        self._steps = gammas * deltas, deltas
        self._inner = gamma[1:-1], delta[1:-1]
        self._inner_lists = gamma[1:-1].tolist(), delta[1:-1].tolist()

    def ends(self, name: str) -> Range:
        """Return the lowest and the highest value of a parameter."""
        return self._ends[name]

    def holds(self, *point: float) -> bool:
        """Whether alpha, beta, gamma and delta are inside of the table."""
        ends = self._ends.values()
        return all(low <= v <= high for v, (low, high) in zip(point, ends, strict=True))

    def holds_all(self, *points: Floats) -> bool:
        """Whether all of some points are inside of the table."""
        return all(
            v.size and low <= v.min() and v.max() <= high
            for v, (low, high) in zip(points, self._ends.values(), strict=True)
        )

    def verdicts(
        self, alpha: Floats, beta: Floats, gamma: Floats, delta: Floats
    ) -> NDArray[np.int8]:
        """Return the codes of points inside of the table, arrays of one length."""
        codes = np.empty(alpha.size, np.int8)
        for start in range(0, alpha.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            limits = self.limits(beta[part], gamma[part], delta[part])
            codes[part] = _codes(alpha[part], limits)
        return codes

    def verdict(self, alpha: float, beta: float, gamma: float, delta: float) -> int:
        """Return the code of one point, without the cost of arrays."""
        cell = min(int((beta - self._beta) * self._per_beta), self._cells - 1)
        row = cell * self._steps[0] + bisect_right(self._inner_lists[0], gamma) * self._steps[1]
        column = self._columns[row + bisect_right(self._inner_lists[1], delta)].tolist()
        c, per_beta, per_gamma, per_delta, error = column[:5]
        lower = c + per_beta * beta + per_gamma * gamma + per_delta * delta
        c, per_beta, per_gamma, per_delta, upper_error = column[5:]
        upper = c + per_beta * beta + per_gamma * gamma + per_delta * delta
        if alpha < lower - error or alpha > upper + upper_error:
            return int(UNSTABLE)
        return int(STABLE if lower + error < alpha < upper - upper_error else UNDECIDED)

    def limits(self, beta: Floats, gamma: Floats, delta: Floats) -> AlphaLimits:
        """Return the limits at points inside of the table; both infinite where none is stable."""
        cell = ((beta - self._beta) * self._per_beta).astype(np.intp)
        np.minimum(cell, self._cells - 1, out=cell)
        rows = cell * self._steps[0] + self._hands(gamma, delta)
        return _at(self._columns[rows].T, beta, gamma, delta)

    def _hands(self, gamma: Floats, delta: Floats) -> Integers:
        """Return the numbers of the cells of hands within a cell along beta."""
        along_gamma, along_delta = (
            np.searchsorted(inner, values, "right")
            for inner, values in zip(self._inner, (gamma, delta), strict=True)
        )
        rows: Integers = along_gamma * self._steps[1] + along_delta
        return rows

    @_ignoring
    def max_alpha(self, gamma: Floats, delta: Floats) -> MaxAlpha:
        """Return the largest stable alpha for hands inside of the table, arrays of one length."""
        edges = np.arange(self._cells + 1) / self._per_beta + self._beta
        sides = np.stack([edges[:-1], edges[1:]])  # planes are highest at the sides of their cells
        columns = self._columns.reshape(self._cells, self._steps[0], -1)
        found = np.full((3, gamma.size), np.nan)
        for point, row in enumerate(self._hands(gamma, delta)):
            hand = gamma[point : point + 1], delta[point : point + 1]
            at = _at(columns[:, row].T, sides, *hand)
            top = at.upper - at.upper_error
            holds = (at.lower + at.lower_error < top) & np.isfinite(top)
            if holds.any():
                best = np.argmax(np.where(holds, top, -np.inf))
                bound = np.max(at.upper + at.upper_error, where=at.lower < np.inf, initial=-np.inf)
                found[:, point] = top.flat[best], sides.flat[best], bound
        return MaxAlpha(*found)

    @_ignoring
    def decided_share(self, gamma: Floats, delta: Floats) -> float:
        """Return the share of the table's volume that is decided, by the middles of the columns.

        Args:
            gamma: nodes of gamma.
            delta: nodes of delta.
        """
        beta = (np.arange(self._cells) + 0.5) / self._per_beta + self._beta
        spans = [  # shares, for products of tiny spans are 0
            np.diff(nodes) / np.ptp(nodes) if nodes.size > 1 else np.ones(1)
            for nodes in (gamma, delta)
        ]
        middles = [
            0.5 * (nodes[1:] + nodes[:-1]) if nodes.size > 1 else nodes for nodes in (gamma, delta)
        ]
        points = (point.ravel() for point in np.meshgrid(beta, *middles, indexing="ij"))
        lower, lower_error, upper, upper_error = _at(self._columns.T, *points)
        low, high = self._ends["alpha"]
        ends = [lower - lower_error, lower + lower_error, upper - upper_error, upper + upper_error]
        a, b, c, d = (np.clip(end, low, high) for end in ends)
        open_height = np.where(c > b, b - a + d - c, d - a)
        weights = np.multiply.outer(np.ones(self._cells), np.multiply.outer(*spans)).ravel()
        return float(1.0 - np.average(open_height, weights=weights) / (high - low))

    @_ignoring
    def common_limits(self, beta: float, gamma: Range, delta: Range) -> tuple[float, float]:
        """Return between which alphas all hands of a box are proved stable; empty if it is so."""
        at = self._limits_over(beta, gamma, delta)
        lowest, highest = np.max(at.lower + at.lower_error), np.min(at.upper - at.upper_error)
        return float(lowest), float(highest)

    def worst_verdict(self, alpha: float, beta: float, gamma: Range, delta: Range) -> int:
        """Return STABLE for all hands of a box, UNSTABLE for one, or UNDECIDED."""
        codes = _codes(np.array(alpha), self._limits_over(beta, gamma, delta))
        if np.any(codes == UNSTABLE):
            return int(UNSTABLE)
        return int(STABLE if np.all(codes == STABLE) else UNDECIDED)

    def _limits_over(self, beta: float, gamma: Range, delta: Range) -> AlphaLimits:
        """Return the limits at the corners of all cells of a box of hands: planes bend nowhere."""
        corners = []
        for inner, (low, high) in zip(self._inner, (gamma, delta), strict=True):
            edges = inner[(inner > low) & (inner < high)]
            ends = np.concatenate([[low], edges, [high]])
            corners.append(np.stack([ends[:-1], ends[1:]]))
        # A corner belongs to a cell by the middle of its part of the box.
        middles = np.meshgrid(*(ends.mean(axis=0) for ends in corners), indexing="ij")
        gammas, deltas = (middle.ravel() for middle in middles)
        cell = min(int((beta - self._beta) * self._per_beta), self._cells - 1)
        columns = self._columns[cell * self._steps[0] + self._hands(gammas, deltas)]
        sides = [
            np.meshgrid(corners[0][i], corners[1][j], indexing="ij") for i in (0, 1) for j in (0, 1)
        ]
        at_gamma, at_delta = (np.concatenate([side[k].ravel() for side in sides]) for k in (0, 1))
        return _at(np.tile(columns.T, 4), np.full_like(at_gamma, beta), at_gamma, at_delta)


@_ignoring
def _at(columns: Floats, beta: Floats, gamma: Floats, delta: Floats) -> AlphaLimits:
    """Return the limits of columns, (10, point), at points."""
    limits = []
    for planes in (columns[:5], columns[5:]):
        constant, per_beta, per_gamma, per_delta, error = planes
        limits += [constant + per_beta * beta + per_gamma * gamma + per_delta * delta, error]
    return AlphaLimits(*limits)


@_ignoring
def _codes(alpha: Floats, limits: AlphaLimits) -> NDArray[np.int8]:
    lower, lower_error, upper, upper_error = limits
    is_unstable = (alpha < lower - lower_error) | (alpha > upper + upper_error)
    is_stable = (alpha > lower + lower_error) & (alpha < upper - upper_error)
    codes: NDArray[np.int8] = np.full(np.shape(is_stable), UNDECIDED, np.int8)
    codes[is_unstable] = UNSTABLE
    codes[is_stable] = STABLE
    return codes
