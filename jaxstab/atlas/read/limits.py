"""Lookups in the limits of alpha: one column of the table decides a point. NumPy alone.

A column is a cell along beta, gamma, delta and delay. It holds two surfaces over these, the lower
and the upper limit of the stable alphas, and the error of each (``schema.ALPHA_LIMITS``). For one
delay they are planes.
"""

from bisect import bisect_right
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format.schema import LIMIT_TERMS
from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]
Range = tuple[float, float]

_MOST_GUESSES = 2**12
_FEW = 16  # nodes
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
        >>> limits = atlas.alpha_limits(0.3, gamma=0.0005, delta=0.01, delay=1.0)
        >>> print(f"up to {limits.upper:.6f}, wrong by less than {limits.upper_error:.0e}")
        up to 0.136525, wrong by less than 7e-04
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
        >>> largest = atlas.max_alpha(gamma=0.0005, delta=0.01, delay=1.0)
        >>> print(f"{largest.alpha:.4f} at {largest.beta:.4f}, none above {largest.bound:.4f}")
        0.1486 at 0.4343, none above 0.1506
    """

    alpha: Floats
    beta: Floats
    bound: Floats


class LimitTable:
    """The columns of all delays.

    Args:
        terms: (limit_cell, gamma_cell, delta_cell, delay_cell, 20): constant, slopes along beta,
            gamma, delta, delay, its square and its products with beta, gamma and delta, and error,
            of the lower and then of the upper limit.
        ends: (delay_cell, 6), the lowest and the highest delay, alpha and beta of cells; those
            along beta are even.
        gamma: nodes of gamma, one or ascending.
        delta: nodes of delta, one or ascending.
    """

    def __init__(
        self, terms: NDArray[np.float32], ends: Floats, *, gamma: Floats, delta: Floats
    ) -> None:
        self._cells, gammas, deltas, delays, count = terms.shape
        self._columns = np.ascontiguousarray(terms).reshape(-1, count)
        self._early, self._late, self._least, self._most, self._beta, highest = (
            np.ascontiguousarray(end) for end in ends.T
        )
        self._highest_beta = highest
        self._next = np.append(self._early[1:], np.inf)
        self._first = self._early[0]
        self._per_delay, self._guesses = _guesses_of(self._early)
        self._per_beta = self._cells / (highest - self._beta)
        self._steps = gammas * deltas * delays, deltas * delays, delays
        self._nodes = gamma, delta
        self._inner = gamma[1:-1], delta[1:-1]
        self._inner_lists = gamma[1:-1].tolist(), delta[1:-1].tolist()
        self._early_list = self._early.tolist()
        self._rows = np.column_stack([ends, self._per_beta]).tolist()

    def covers(self, delay: Floats) -> NDArray[np.bool_]:
        """Say which delays there are limits for."""
        cell = self.delay_cell(delay)
        return np.asarray((cell >= 0) & (delay <= self._late.take(cell)))

    def delay_cell(self, delay: Floats) -> Integers:
        """Return the numbers of the last cells that begin at delays or before; -1 for none."""
        place = (delay - self._first) * self._per_delay
        cell = self._guesses.take(np.clip(place, 0.0, self._guesses.size - 1.0).astype(np.intp))
        cell += delay >= self._next.take(cell)
        cell -= delay < self._early.take(cell)
        found = (delay < self._next.take(cell)) & (delay >= self._early.take(cell))
        if found.all():  # as where no cell is very short
            return np.asarray(cell)
        return np.asarray(np.searchsorted(self._early, delay, "right") - 1)

    def ends(self, name: str, cell: Integers) -> tuple[Floats, Floats]:
        """Return the lowest and the highest alpha, or beta, of cells of delays."""
        if name == "alpha":
            return np.asarray(self._least[cell]), np.asarray(self._most[cell])
        return np.asarray(self._beta[cell]), np.asarray(self._highest_beta[cell])

    @property
    def plants(self) -> tuple[Range, Range, Range]:
        """The lowest and the highest gamma, delta and delay."""
        gamma, delta = self._nodes
        delays = float(self._early[0]), float(self._late[-1])
        return (float(gamma[0]), float(gamma[-1])), (float(delta[0]), float(delta[-1])), delays

    def beta_cell(self, number: Integers, beta: Floats) -> Integers:
        """Return the cells along beta that hold values, in cells of delays."""
        cell = ((beta - self._beta.take(number)) * self._per_beta.take(number)).astype(np.intp)
        return np.asarray(np.minimum(cell, self._cells - 1))

    def beta_edge(self, number: Integers, cell: Integers) -> Floats:
        """Return where cells along beta begin, in cells of delays."""
        return np.asarray(self._beta.take(number) + cell / self._per_beta.take(number))

    def holds(self, alpha: float, beta: float, gamma: float, delta: float, delay: float) -> bool:
        """Whether a point is inside of the table."""
        cell = bisect_right(self._early_list, delay) - 1
        if cell < 0:
            return False
        _, late, least, most, lowest, highest, _ = self._rows[cell]
        gammas, deltas = self._nodes
        return bool(
            delay <= late
            and least <= alpha <= most
            and lowest <= beta <= highest
            and gammas[0] <= gamma <= gammas[-1]
            and deltas[0] <= delta <= deltas[-1]
        )

    def verdicts_inside(
        self, alpha: Floats, beta: Floats, gamma: Floats, delta: Floats, delay: Floats
    ) -> NDArray[np.int8] | None:
        """Return the codes of points, arrays of one length; None if one is outside of the table."""
        codes = np.empty(alpha.size, np.int8)
        for start in range(0, alpha.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            some = alpha[part], beta[part], gamma[part], delta[part], delay[part]
            cell = self.delay_cell(some[4])
            if not self._holds(cell, *some):
                return None
            codes[part] = _codes(some[0], self._limits(cell, *some[1:]))
        return codes

    def _holds(
        self,
        cell: Integers,
        alpha: Floats,
        beta: Floats,
        gamma: Floats,
        delta: Floats,
        delay: Floats,
    ) -> bool:
        """Whether all of some points, in these cells of delays, are inside."""
        hands = zip((gamma, delta), self._nodes, strict=True)
        if not all(n[0] <= v.min() and v.max() <= n[-1] for v, n in hands) or cell.min() < 0:
            return False
        inside = delay <= self._late.take(cell)
        inside &= (alpha >= self._least.take(cell)) & (alpha <= self._most.take(cell))
        inside &= (beta >= self._beta.take(cell)) & (beta <= self._highest_beta.take(cell))
        return bool(inside.all())

    def verdicts(
        self, alpha: Floats, beta: Floats, gamma: Floats, delta: Floats, delay: Floats
    ) -> NDArray[np.int8]:
        """Return the codes of points inside of the table, arrays of one length."""
        codes = np.empty(alpha.size, np.int8)
        for start in range(0, alpha.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            limits = self.limits(beta[part], gamma[part], delta[part], delay[part])
            codes[part] = _codes(alpha[part], limits)
        return codes

    def verdict(self, alpha: float, beta: float, gamma: float, delta: float, delay: float) -> int:
        """Return the code of one point, without the cost of arrays."""
        number = bisect_right(self._early_list, delay) - 1
        lowest, _, per_beta = self._rows[number][4:]
        cell = min(int((beta - lowest) * per_beta), self._cells - 1)
        row = cell * self._steps[0] + bisect_right(self._inner_lists[0], gamma) * self._steps[1]
        row += bisect_right(self._inner_lists[1], delta) * self._steps[2] + number
        column = self._columns[row].tolist()
        low, high = column[:LIMIT_TERMS], column[LIMIT_TERMS:]
        error, upper_error = low[-1], high[-1]
        lower, upper = (_surface(terms, beta, gamma, delta, delay) for terms in (low, high))
        if alpha < lower - error or alpha > upper + upper_error:
            return int(UNSTABLE)
        return int(STABLE if lower + error < alpha < upper - upper_error else UNDECIDED)

    def limits(self, beta: Floats, gamma: Floats, delta: Floats, delay: Floats) -> AlphaLimits:
        """Return the limits at points inside of the table; both infinite where none is stable."""
        return self._limits(self.delay_cell(delay), beta, gamma, delta, delay)

    def _limits(
        self, number: Integers, beta: Floats, gamma: Floats, delta: Floats, delay: Floats
    ) -> AlphaLimits:
        """Return the limits at points in these cells of delays."""
        rows = self.beta_cell(number, beta) * self._steps[0] + self._hands(gamma, delta) + number
        return limits_at(self._columns.take(rows, axis=0).T, beta, gamma, delta, delay)

    def _hands(self, gamma: Floats, delta: Floats) -> Integers:
        """Return the numbers of the cells of hands within a cell along beta."""
        along_gamma, along_delta = (
            _rank(inner, values) for inner, values in zip(self._inner, (gamma, delta), strict=True)
        )
        rows: Integers = along_gamma * self._steps[1] + along_delta * self._steps[2]
        return rows

    @_ignoring
    def max_alpha(self, gamma: Floats, delta: Floats, delay: Floats) -> MaxAlpha:
        """Return the largest stable alpha for hands inside of the table, arrays of one length."""
        columns = self._columns.reshape(self._cells, self._steps[0], -1)
        numbers = self.delay_cell(delay)
        found = np.full((3, gamma.size), np.nan)
        for point, row in enumerate(self._hands(gamma, delta) + numbers):
            number = numbers[point]
            edges = np.arange(self._cells + 1) / self._per_beta[number] + self._beta[number]
            sides = np.stack([edges[:-1], edges[1:]])  # planes are highest at their sides
            one = slice(point, point + 1)
            at = limits_at(columns[:, row].T, sides, gamma[one], delta[one], delay[one])
            top = at.upper - at.upper_error
            holds = (at.lower + at.lower_error < top) & np.isfinite(top)
            if holds.any():
                best = np.argmax(np.where(holds, top, -np.inf))
                bound = np.max(at.upper + at.upper_error, where=at.lower < np.inf, initial=-np.inf)
                found[:, point] = top.flat[best], sides.flat[best], bound
        return MaxAlpha(*found)

    @_ignoring
    def decided_share(self, delay: float) -> float:
        """Return the share of the volume at a delay that is decided, by the middles of columns."""
        number = int(self.delay_cell(np.array([delay]))[0])
        beta = (np.arange(self._cells) + 0.5) / self._per_beta[number] + self._beta[number]
        spans = [  # shares, for products of tiny spans are 0
            np.diff(nodes) / np.ptp(nodes) if nodes.size > 1 else np.ones(1)
            for nodes in self._nodes
        ]
        middles = [
            0.5 * (nodes[1:] + nodes[:-1]) if nodes.size > 1 else nodes for nodes in self._nodes
        ]
        along_beta, gamma, delta = (
            point.ravel() for point in np.meshgrid(beta, *middles, indexing="ij")
        )
        columns = self._columns[number :: self._steps[2]].T
        at = limits_at(columns, along_beta, gamma, delta, np.full(gamma.size, delay))
        weights = np.multiply.outer(np.ones(self._cells), np.multiply.outer(*spans)).ravel()
        undecided = undecided_share(at, float(self._least[number]), float(self._most[number]))
        return float(1.0 - np.average(undecided, weights=weights))

    @_ignoring
    def common_limits(
        self, beta: float, gamma: Range, delta: Range, delay: float
    ) -> tuple[float, float]:
        """Return between which alphas all hands of a box are proved stable; empty if it is so."""
        at = self._limits_over(beta, gamma, delta, delay)
        lowest, highest = np.max(at.lower + at.lower_error), np.min(at.upper - at.upper_error)
        return float(lowest), float(highest)

    def worst_verdict(
        self, alpha: float, beta: float, gamma: Range, delta: Range, delay: float
    ) -> int:
        """Return STABLE for all hands of a box, UNSTABLE for one, or UNDECIDED."""
        codes = _codes(np.array(alpha), self._limits_over(beta, gamma, delta, delay))
        if np.any(codes == UNSTABLE):
            return int(UNSTABLE)
        return int(STABLE if np.all(codes == STABLE) else UNDECIDED)

    def _limits_over(self, beta: float, gamma: Range, delta: Range, delay: float) -> AlphaLimits:
        """Return the limits at the corners of all cells of a box of hands: planes bend nowhere."""
        corners = []
        for inner, (low, high) in zip(self._inner, (gamma, delta), strict=True):
            edges = inner[(inner > low) & (inner < high)]
            ends = np.concatenate([[low], edges, [high]])
            corners.append(np.stack([ends[:-1], ends[1:]]))
        # A corner belongs to a cell by the middle of its part of the box.
        middles = np.meshgrid(*(ends.mean(axis=0) for ends in corners), indexing="ij")
        gammas, deltas = (middle.ravel() for middle in middles)
        number = bisect_right(self._early_list, delay) - 1
        lowest, _, per_beta = self._rows[number][4:]
        cell = min(int((beta - lowest) * per_beta), self._cells - 1)
        columns = self._columns[cell * self._steps[0] + self._hands(gammas, deltas) + number]
        sides = [
            np.meshgrid(corners[0][i], corners[1][j], indexing="ij") for i in (0, 1) for j in (0, 1)
        ]
        at_gamma, at_delta = (np.concatenate([side[k].ravel() for side in sides]) for k in (0, 1))
        still = (np.full_like(at_gamma, value) for value in (beta, delay))
        at_beta, at_delay = still
        return limits_at(np.tile(columns.T, 4), at_beta, at_gamma, at_delta, at_delay)


def _surface(terms: Any, beta: Any, gamma: Any, delta: Any, delay: Any) -> Any:
    """Return a limit by its terms; numbers or arrays."""
    c, per_beta, per_gamma, per_delta, per_delay, bend, by_beta, by_gamma, by_delta, _ = terms
    rate = per_delay + bend * delay + by_beta * beta + by_gamma * gamma + by_delta * delta
    return c + per_beta * beta + per_gamma * gamma + per_delta * delta + rate * delay


def _rank(inner: Floats, values: Floats) -> Integers:
    """Return how many of some ascending nodes are not above each of some values."""
    if inner.size > _FEW:
        return np.asarray(np.searchsorted(inner, values, "right"))
    count = np.zeros(values.shape, np.int8)
    for node in inner:  # a third of the time of a search
        count += values >= node
    return count.astype(np.intp)


def _guesses_of(early: Floats) -> tuple[float, Integers]:
    """Return how many even steps there are to a delay, and for each the cell in which it begins."""
    width = float(early[-1] - early[0])
    if not width:
        return 0.0, np.zeros(1, np.intp)
    count = int(min(np.ceil(width / np.diff(early).min()), _MOST_GUESSES))
    steps = early[0] + width * np.arange(count + 1) / count
    cells = np.searchsorted(early, steps, "right") - 1
    return count / width, np.maximum(cells, 0)


@_ignoring
def undecided_share(limits: AlphaLimits, low: float, high: float) -> Floats:
    """Return which share of the alphas from the lowest to the highest the limits leave open."""
    lower, lower_error, upper, upper_error = limits
    ends = [lower - lower_error, lower + lower_error, upper - upper_error, upper + upper_error]
    a, b, c, d = (np.clip(end, low, high) for end in ends)
    may_be_stable, stable = np.maximum(d - a, 0.0), np.maximum(c - b, 0.0)
    return np.asarray((may_be_stable - stable) / (high - low))


@_ignoring
def limits_at(
    columns: NDArray[np.float32], beta: Floats, gamma: Floats, delta: Floats, delay: Floats
) -> AlphaLimits:
    """Return the limits of columns, (20, point), at points."""
    limits = []
    for terms in (columns[:LIMIT_TERMS], columns[LIMIT_TERMS:]):
        limits += [_surface(terms, beta, gamma, delta, delay), terms[-1]]
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
