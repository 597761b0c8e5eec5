"""Lookups in the limits of alpha: one column of the table decides a point. NumPy alone.

A column is a cell along beta, gamma, delta and delay. It holds two surfaces over these, the lower
and the upper limit of the stable alphas, and the error of each (``schema.ALPHA_LIMITS``). For one
delay they are planes.
"""

from bisect import bisect_right
from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format.schema import LIMIT_TERMS
from jaxstab.atlas.read.delays import DelayCells
from jaxstab.atlas.read.parts import in_parts
from jaxstab.atlas.read.sides import (
    codes_by_limits,
    codes_by_one,
    deciding_alphas,
    ignoring,
    surface,
    surfaces,
)
from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]
Range = tuple[float, float]

_FEW = 16  # nodes


class OutsideError(ValueError):
    """A point is outside of the table."""


class AlphaLimits(NamedTuple):
    """The smallest and largest stable alpha of points, each with a proved error bound.

    Of the alphas of the atlas every one from ``lower + lower_error`` to ``upper - upper_error`` is
    stable, and every one below ``lower - lower_error`` or above ``upper + upper_error`` unstable.
    Where none is stable both are NaN with an error of 0; an infinite limit is beyond the atlas,
    and with an infinite error nothing is known.

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

    A hand is stable at ``beta`` and every alpha just below ``alpha``, and at no alpha above
    ``bound`` and no beta of the atlas. Where the stable set may go on beyond the atlas, across its
    largest alpha or an end of beta, ``bound`` is infinite.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> largest = atlas.max_alpha(gamma=0.0005, delta=0.01, delay=1.5)
        >>> print(f"{largest.alpha:.4f} at {largest.beta:.4f}, none above {largest.bound:.4f}")
        0.0942 at 0.3492, none above 0.0956
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
        whole: (delay_cell,), which axes hold the whole stable set.
        gamma: nodes of gamma, one or ascending.
        delta: nodes of delta, one or ascending.
    """

    def __init__(
        self,
        terms: NDArray[np.float32],
        ends: Floats,
        whole: NDArray[np.int32],
        *,
        gamma: Floats,
        delta: Floats,
    ) -> None:
        self._cells, gammas, deltas, delays, count = terms.shape
        self._columns = np.ascontiguousarray(terms).reshape(-1, count)
        self.delays = DelayCells(ends, whole)
        self._beta, highest = self.delays.ends["beta"]
        self._per_beta = self._cells / (highest - self._beta)
        self._steps = gammas * deltas * delays, deltas * delays, delays
        self._inner = gamma[1:-1], delta[1:-1]
        self._inner_lists = gamma[1:-1].tolist(), delta[1:-1].tolist()
        self._nodes = gamma, delta
        self._rows = np.column_stack([ends, self._per_beta]).tolist()
        hands = ((float(nodes[0]), float(nodes[-1])) for nodes in self._nodes)
        self.plants: tuple[Range, ...] = *hands, self.delays.span
        """The lowest and the highest gamma, delta and delay."""

    def beta_cell(self, number: Integers, beta: Floats) -> Integers:
        """Return the cells along beta that hold values, in cells of delays."""
        cell = ((beta - self._beta.take(number)) * self._per_beta.take(number)).astype(np.intp)
        return np.asarray(np.minimum(cell, self._cells - 1))

    def holds(self, alpha: float, beta: float, gamma: float, delta: float, delay: float) -> bool:
        """Whether a point is inside of the table."""
        cell = self.delays.of_one(delay)
        if cell < 0:
            return False
        _, late, least, most, lowest, highest, _ = self._rows[cell]
        (least_gamma, most_gamma), (least_delta, most_delta), _ = self.plants
        return bool(
            delay <= late
            and least <= alpha <= most
            and lowest <= beta <= highest
            and least_gamma <= gamma <= most_gamma
            and least_delta <= delta <= most_delta
        )

    def verdicts(self, points: Sequence[NDArray[Any]]) -> NDArray[np.int8]:
        """Return the codes of points, real numbers of any kind and any broadcast shape.

        Raises:
            OutsideError: a point is outside of the table, or NaN.
        """
        is_large = np.broadcast(*points).size >= len(self._columns)
        deciding = self._deciding if is_large else None  # for few it takes longer than they do
        return in_parts(partial(self._verdicts, deciding), points, np.int8)[0]

    def _verdicts(
        self, deciding: Floats | None, alpha: Floats, beta: Floats, *plant: Floats
    ) -> tuple[NDArray[np.int8]]:
        """Return the codes of points; a plant that all of them share is looked up once."""
        ends = [(values.min(), values.max()) for values in plant]
        for (least, most), (low, high) in zip(ends, self.plants, strict=True):
            if not low <= least <= most <= high:
                raise OutsideError
        gamma, delta, delay = (
            values[:1] if least == most else values
            for values, (least, most) in zip(plant, ends, strict=True)
        )
        cell = self.delays.of(delay)
        if not self.delays.hold(cell, delay, alpha=alpha, beta=beta):
            raise OutsideError
        point = beta, gamma, delta, delay
        rows = self._rows_of(cell, *point[:-1])
        if deciding is None:
            return (codes_by_limits(alpha, *self._limits(rows, *point)),)
        return (self._codes(deciding.take(rows, axis=0), rows, alpha, *point),)

    def _codes(
        self, deciding: Floats, rows: Integers, alpha: Floats, *point: Floats
    ) -> NDArray[np.int8]:
        """Return the codes of points, by one limit where that is enough; see ``_deciding``."""
        by_upper, by_lower = alpha > deciding[:, 0], alpha < deciding[:, 1]
        each = self._columns.reshape(-1, LIMIT_TERMS).take(2 * rows + by_upper, axis=0)
        codes = codes_by_one(alpha, by_upper, each.T, *point)
        both = np.flatnonzero(~(by_upper | by_lower))
        if both.size:
            some = [np.broadcast_to(v, alpha.shape)[both] for v in (rows, alpha, *point)]
            codes[both] = codes_by_limits(some[1], *self._limits(some[0], *some[2:]))
        return codes

    @cached_property
    def _deciding(self) -> Floats:
        """Above which alpha the upper limit decides, and below which one the lower, in columns."""
        return deciding_alphas(self._columns, *self._boxes)

    @cached_property
    def _boxes(self) -> tuple[list[Floats], list[Floats]]:
        """Middles, and half widths, of the cells of beta, gamma, delta and delay, as a grid."""
        number = np.arange(self._cells).reshape(-1, 1, 1, 1) + 0.5
        middles, halves = [number / self._per_beta + self._beta], [0.5 / self._per_beta]
        for shape, nodes in zip(((-1, 1, 1), (-1, 1)), self._nodes, strict=True):
            low, high = (nodes[:-1], nodes[1:]) if nodes.size > 1 else (nodes, nodes)
            middles.append(0.5 * (high + low).reshape(shape))
            halves.append(0.5 * (high - low).reshape(shape))
        early, late = self.delays.ends["delay"]
        return [*middles, 0.5 * (late + early)], [*halves, 0.5 * (late - early)]

    def verdict(self, alpha: float, beta: float, gamma: float, delta: float, delay: float) -> int:
        """Return the code of one point, without the cost of arrays."""
        number = self.delays.of_one(delay)
        lowest, _, per_beta = self._rows[number][4:]
        cell = min(int((beta - lowest) * per_beta), self._cells - 1)
        row = cell * self._steps[0] + bisect_right(self._inner_lists[0], gamma) * self._steps[1]
        row += bisect_right(self._inner_lists[1], delta) * self._steps[2] + number
        column = self._columns[row].tolist()
        low, high = column[:LIMIT_TERMS], column[LIMIT_TERMS:]
        error, upper_error = low[-1], high[-1]
        lower, upper = (surface(terms, beta, gamma, delta, delay) for terms in (low, high))
        if alpha < lower - error or alpha > upper + upper_error:
            return int(UNSTABLE)
        return int(STABLE if lower + error < alpha < upper - upper_error else UNDECIDED)

    def known_limits(
        self, beta: Floats, gamma: Floats, delta: Floats, delay: Floats
    ) -> AlphaLimits:
        """Return the limits at points inside of the table, as far as they are within its alphas."""
        ends = self.delays.walls("alpha", self.delays.of(delay))
        return within(self.limits(beta, gamma, delta, delay), *ends)

    def limits(self, beta: Floats, gamma: Floats, delta: Floats, delay: Floats) -> AlphaLimits:
        """Return the surfaces at points inside of the table, which hold for its alphas alone.

        Both are infinite where none is stable.
        """
        return AlphaLimits(*in_parts(self._limits_of, (beta, gamma, delta, delay), *[float] * 4))

    def _limits_of(self, *point: Floats) -> Sequence[Floats]:
        return self._limits(self._rows_of(self.delays.of(point[-1]), *point[:-1]), *point)

    def _limits(self, rows: Integers, *point: Floats) -> Sequence[Floats]:
        """Return the limits of columns at points."""
        return surfaces(self._columns.take(rows, axis=0).T, *point)

    def _rows_of(self, number: Integers, beta: Floats, gamma: Floats, delta: Floats) -> Integers:
        """Return the numbers of columns, in cells of delays."""
        rows = self.beta_cell(number, beta) * self._steps[0] + self._hands(gamma, delta) + number
        return np.asarray(rows)

    def _hands(self, gamma: Floats, delta: Floats) -> Integers:
        """Return the numbers of the cells of hands within a cell along beta."""
        along_gamma, along_delta = (
            _rank(inner, values) for inner, values in zip(self._inner, (gamma, delta), strict=True)
        )
        rows: Integers = along_gamma * self._steps[1] + along_delta * self._steps[2]
        return rows

    @ignoring
    def max_alpha(self, gamma: Floats, delta: Floats, delay: Floats) -> MaxAlpha:
        """Return the largest stable alpha for hands inside of the table, arrays of one length."""
        columns = self._columns.reshape(self._cells, self._steps[0], -1)
        numbers = self.delays.of(delay)
        found = np.full((3, gamma.size), np.nan)
        for point, row in enumerate(self._hands(gamma, delta) + numbers):
            number = numbers[point]
            edges = np.arange(self._cells + 1) / self._per_beta[number] + self._beta[number]
            sides = np.stack([edges[:-1], edges[1:]])  # planes are highest at their sides
            one = slice(point, point + 1)
            least, most = (end[number] for end in self.delays.ends["alpha"])
            found_at = limits_at(columns[:, row].T, sides, gamma[one], delta[one], delay[one])
            at = within(found_at, least, most)
            top = np.minimum(at.upper - at.upper_error, most)
            holds = at.lower + at.lower_error < top
            if holds.any():
                best = np.argmax(np.where(holds, top, -np.inf))
                ends = at.upper + at.upper_error
                bound = float(np.max(ends, where=at.lower < np.inf, initial=-np.inf))
                may_hold = ~(at.lower - at.lower_error >= ends)
                if may_hold[0, 0] or may_hold[1, -1]:  # the stable set crosses an end of beta
                    bound = np.inf
                found[:, point] = top.flat[best], sides.flat[best], bound
        return MaxAlpha(*found)

    @ignoring
    def decided_share(self, delay: float) -> float:
        """Return the share of the volume at a delay that is decided, by the middles of columns."""
        number = self.delays.of_one(delay)
        spans = [  # shares, for products of tiny spans are 0
            np.diff(nodes) / np.ptp(nodes) if nodes.size > 1 else np.ones(1)
            for nodes in self._nodes
        ]
        beta, gamma, delta, _ = np.broadcast_arrays(*self._boxes[0])
        point = (middle[..., number].ravel() for middle in (beta, gamma, delta))
        columns = self._columns[number :: self._steps[2]].T
        at = limits_at(columns, *point, np.array(delay))
        weights = np.multiply.outer(np.ones(self._cells), np.multiply.outer(*spans)).ravel()
        undecided = undecided_share(at, *self._rows[number][2:4])
        return float(1.0 - np.average(undecided, weights=weights))

    @ignoring
    def common_limits(
        self, beta: float, gamma: Range, delta: Range, delay: float
    ) -> tuple[float, float]:
        """Return between which alphas all hands of a box are proved stable; empty if it is so."""
        at = self._limits_over(beta, gamma, delta, delay)
        least, most = self._rows[self.delays.of_one(delay)][2:4]
        lowest, highest = np.max(at.lower + at.lower_error), np.min(at.upper - at.upper_error)
        return float(np.maximum(lowest, least)), float(np.minimum(highest, most))

    def worst_verdict(
        self, alpha: float, beta: float, gamma: Range, delta: Range, delay: float
    ) -> int:
        """Return STABLE for all hands of a box, UNSTABLE for one, or UNDECIDED."""
        codes = codes_by_limits(np.array(alpha), *self._limits_over(beta, gamma, delta, delay))
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
        number = self.delays.of_one(delay)
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


def _rank(inner: Floats, values: Floats) -> Integers:
    """Return how many of some ascending nodes are not above each of some values."""
    if inner.size > _FEW:
        return np.asarray(np.searchsorted(inner, values, "right"))
    count = np.zeros(values.shape, np.int8)
    for node in inner:  # a third of the time of a search
        count += values >= node
    return count.astype(np.intp)


@ignoring
def undecided_share(limits: AlphaLimits, low: Floats | float, high: Floats | float) -> Floats:
    """Return which share of the alphas from the lowest to the highest the limits leave open."""
    lower, lower_error, upper, upper_error = limits
    ends = [lower - lower_error, lower + lower_error, upper - upper_error, upper + upper_error]
    a, b, c, d = (np.clip(end, low, high) for end in ends)
    may_be_stable, stable = np.maximum(d - a, 0.0), np.maximum(c - b, 0.0)
    return np.asarray((may_be_stable - stable) / (high - low))


@ignoring
def limits_at(columns: NDArray[np.float32], *point: Floats) -> AlphaLimits:
    """Return the limits of columns, (20, point), at points."""
    return AlphaLimits(*surfaces(columns, *point))


@ignoring
def within(at: AlphaLimits, least: Floats | float, most: Floats | float) -> AlphaLimits:
    """Return limits between two alphas: one that is not there is infinite, for it says nothing."""
    is_below = at.lower + at.lower_error <= least
    is_above = at.upper - at.upper_error >= most
    return AlphaLimits(
        np.where(is_below, -np.inf, at.lower),
        np.where(is_below, 0.0, at.lower_error),
        np.where(is_above, np.inf, at.upper),
        np.where(is_above, 0.0, at.upper_error),
    )
