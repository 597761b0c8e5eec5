"""Lookups in limits of alpha: which column holds a point, and what it says. NumPy alone.

A column is a cell along beta, gamma, delta and delay. It holds two surfaces over these, the lower
and the upper limit of the stable alphas, and the error of each; for one delay they are planes. One
column decides a point: below lower - error and above upper + error it is unstable, between lower +
error and upper - error stable, elsewhere the atlas leaves it undecided. Many points are answered by
one of the two surfaces, where that one alone decides (``_deciding``).
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.product import Array, Floats
from jaxstab.conventions import Range, Verdict

LIMIT_TERMS = 10  # of each of the two limits
WHOLE_ALPHA = 1
WHOLE_BOTH = 2

# The cells of delays of an atlas: which one holds a delay, and how far it reaches. NumPy alone.

Integers = NDArray[np.intp]
_MOST_STEPS = 2**12


class DelayCells:
    """The cells of all delays, ascending; arguments as ``LimitTable``."""

    def __init__(self, ends: Floats, whole: NDArray[np.int32]) -> None:
        self._whole = whole
        lowest, highest = np.ascontiguousarray(ends.T[::2]), np.ascontiguousarray(ends.T[1::2])
        self.ends = dict(
            zip(("delay", "alpha", "beta"), zip(lowest, highest, strict=True), strict=True)
        )
        """The lowest and the highest delay, alpha and beta of the cells."""
        self._early, self._late = self.ends["delay"]
        self._are_joined = np.array_equal(self._late[:-1], self._early[1:])
        self._begins = np.append(self._early, np.inf)
        self._per_delay, self._counts = _steps(self._early)
        self._early_list = self._early.tolist()
        self.span: Range = float(self._early[0]), float(self._late[-1])

    def cells_at(self, delay: Floats) -> Integers:
        """The indices of the last cells that begin at delays or before; -1 for none."""
        if not self._counts.size:
            return np.asarray(np.searchsorted(self._early, delay, "right") - 1)
        place = np.clip((delay - self.span[0]) * self._per_delay, 0.0, self._counts.size - 1.0)
        count = self._counts.take(place.astype(np.intp))
        count += delay >= self._begins.take(count)
        count -= 1
        return np.asarray(count)

    def cell_at(self, delay: float) -> int:
        """The index of the last cell that begins at a delay or before; -1 for none."""
        return bisect_right(self._early_list, delay) - 1

    def covers(self, delay: Floats) -> NDArray[np.bool_]:
        """Whether delays are in a cell."""
        cell = self.cells_at(delay)
        return np.asarray((cell >= 0) & (delay <= self._late.take(cell)))

    def walls(self, name: str, cell: Integers) -> tuple[Floats, Floats]:
        """Return the lowest and the highest alpha, or beta, of cells."""
        least, most = self.ends[name]
        return np.asarray(least.take(cell)), np.asarray(most.take(cell))

    def beyond(self, cell: Integers, alpha: Floats, beta: Floats) -> NDArray[np.bool_]:
        """Whether walls are beyond axes of cells that hold the whole stable set: unstable."""
        inside = []
        for name, values in (("alpha", alpha), ("beta", beta)):
            least, most = self.walls(name, cell)
            inside.append((values >= least) & (values <= most))
        whole = self._whole.take(cell)
        is_beyond = ((whole >= WHOLE_ALPHA) & ~inside[0] & inside[1]) | (
            (whole == WHOLE_BOTH) & ~inside[1]
        )
        return np.asarray(is_beyond)

    def hold(self, cell: Integers, delay: Floats, **walls: Floats) -> bool:
        """Whether these cells reach to delays that they begin before, and to alphas or betas."""
        inside = self._are_joined or delay <= self._late.take(cell)
        for name, values in walls.items():
            least, most = self.walls(name, cell)
            inside = inside & (values >= least) & (values <= most)
        return bool(np.all(inside))


def _steps(early: Floats) -> tuple[float, Integers]:
    """The number of even steps to a delay, and how many cells begin before each step."""
    # A step is at most half as long as a cell, and what begins in its last quarter counts for the
    # next one. So no more than one cell begins from there to the end of a step, whatever is
    # rounded. Without steps cells are so short that they are searched for.
    width = float(early[-1] - early[0])
    if not width:
        return 0.0, np.zeros(1, np.intp)
    count = np.ceil(2.0 * width / np.min(np.diff(early)))
    if count > _MOST_STEPS:
        return 0.0, np.zeros(0, np.intp)
    begins = early[0] + width * (np.arange(count + 1.0) - 0.25) / count
    return float(count / width), np.searchsorted(early, begins, "right")


# Queries of many points, answered block by block. NumPy alone.

_BLOCK = 2**16  # points: enough for what a call of NumPy costs, and few for the memory


def in_blocks(
    answers: Callable[..., Sequence[Array]], points: Sequence[Array], *dtypes: type
) -> list[Array]:
    """Values of a function at points of any broadcast shape, computed block by block.

    ``answers`` takes as many float64 arrays of one length as there are ``points``, and returns an
    array for each of ``dtypes``. Conversion and broadcasting are done block by block as well.
    """
    count = len(points)
    operands: Any = [*points, *(None for _ in dtypes)]
    uses: Any = [["readonly"] for _ in points] + [["writeonly", "allocate"] for _ in dtypes]
    with np.nditer(
        operands,
        flags=["external_loop", "buffered", "zerosize_ok"],
        op_flags=uses,
        op_dtypes=[*(np.float64 for _ in points), *dtypes],
        order="C",
        casting="same_kind",
        buffersize=_BLOCK,
    ) as blocks:
        for block in blocks:
            for place, values in zip(block[count:], answers(*block[:count]), strict=True):
                place[...] = values
        return list(blocks.operands[count:])


# The verdicts of the limits of a column on an alpha, and which of the two decides. NumPy alone.

Codes = NDArray[np.int8]
Mask = NDArray[np.bool_]
ignoring = np.errstate(over="ignore", invalid="ignore")  # infinite limits may have infinite errors
_ROUNDING = 1e-6  # of a sum: far above its rounding error, also at the edges of cells


def surface(terms: Any, beta: Any, gamma: Any, delta: Any, delay: Any) -> Any:
    """Return a limit by its terms; numbers or arrays."""
    c, per_beta, per_gamma, per_delta, per_delay, bend, by_beta, by_gamma, by_delta, _ = terms
    rate = per_delay + bend * delay + by_beta * beta + by_gamma * gamma + by_delta * delta
    return c + per_beta * beta + per_gamma * gamma + per_delta * delta + rate * delay


def surfaces(columns: NDArray[np.float32], *point: Floats) -> Sequence[Floats]:
    """Return the lower limit, its error, the upper and its error, of columns (20, point)."""
    terms = columns.astype(np.float64, order="C")  # at once: many times faster than in each product
    lower, upper = terms[:LIMIT_TERMS], terms[LIMIT_TERMS:]
    return surface(lower, *point), lower[-1], surface(upper, *point), upper[-1]


@ignoring
def codes_by_limits(
    alpha: Floats, lower: Floats, lower_error: Floats, upper: Floats, upper_error: Floats
) -> Codes:
    """Return the verdicts on alphas."""
    is_unstable = (alpha < lower - lower_error) | (alpha > upper + upper_error)
    is_stable = (alpha > lower + lower_error) & (alpha < upper - upper_error)
    return _codes(is_unstable | is_stable, is_stable)


@ignoring
def codes_by_one(
    alpha: Floats, is_upper: Mask, terms: NDArray[np.float32], *point: Floats
) -> Codes:
    """Return the verdicts on alphas that one limit decides, by its terms (10, point)."""
    of_limit = terms.astype(np.float64, order="C")
    limit, error = surface(of_limit, *point), of_limit[-1]
    is_below = alpha < limit - error
    is_decided = is_below | (alpha > limit + error)
    return _codes(is_decided, is_decided & (is_below == is_upper))


def _codes(is_decided: Mask, is_stable: Mask) -> Codes:
    """Return UNDECIDED, UNSTABLE or STABLE: codes that follow each other downwards."""
    codes: Codes = np.int8(Verdict.UNDECIDED) - is_decided.view(np.int8)
    codes -= is_stable.view(np.int8)
    return codes


@ignoring
def _deciding(
    columns: NDArray[np.float32], numbers: Floats, *boxes: Floats
) -> tuple[Floats, Floats]:
    terms = columns.take(numbers.astype(np.intp), axis=0).T.astype(np.float64, order="C")
    lower, upper = terms[:LIMIT_TERMS], terms[LIMIT_TERMS:]
    (low, low_width), (high, high_width) = (_range(limit, *boxes) for limit in (lower, upper))
    is_empty = lower[0] - lower[-1] == np.inf
    return low + low_width, np.where(is_empty, np.inf, high - high_width)


def _range(terms: Floats, *boxes: Floats) -> tuple[Floats, Floats]:
    """A limit at the middle of its column, and the half-width of its values there with errors."""
    beta, gamma, delta, delay, *halves = boxes
    _, per_beta, per_gamma, per_delta, per_delay, bend, *mixed, error = terms
    by_beta, by_gamma, by_delta = mixed
    slopes = (
        per_beta + by_beta * delay,
        per_gamma + by_gamma * delay,
        per_delta + by_delta * delay,
        per_delay + 2.0 * bend * delay + by_beta * beta + by_gamma * gamma + by_delta * delta,
    )
    half_delay = halves[-1]
    bends = zip((*mixed, bend), halves, strict=True)
    half_width = error + half_delay * sum(np.abs(term) * half for term, half in bends)
    half_width += sum(np.abs(slope) * half for slope, half in zip(slopes, halves, strict=True))
    farthest = (np.abs(middle) + half for middle, half in zip(boxes[:4], halves, strict=True))
    return surface(terms, *boxes[:4]), half_width + _ROUNDING * surface(np.abs(terms), *farthest)


_FEW = 16  # nodes


class OutsideError(ValueError):
    """A point is outside of the table, or of an atlas."""


class AlphaLimits(NamedTuple):
    """The smallest and largest stable alpha of points, each with a proved error bound.

    Of the alphas of the atlas every one from ``lower + lower_error`` to ``upper - upper_error`` is
    stable, and every one below ``lower - lower_error`` or above ``upper + upper_error`` unstable.
    Where none is stable both are NaN with an error of 0; an infinite limit is beyond the atlas, and
    with an infinite error nothing is known.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> limits = atlas.alpha_limits(0.3, gamma=0.0005, delta=0.01, delay=1.0)
        >>> print(f"up to {limits.upper:.6f} +/- {limits.upper_error:.0e}")
        up to 0.136525 +/- 7e-04
    """

    lower: Floats
    lower_error: Floats
    upper: Floats
    upper_error: Floats


class MaxAlpha(NamedTuple):
    """The largest stable alpha of a slice, by proofs; NaN where none is proved stable.

    The loop is stable at ``beta`` and every alpha just below ``alpha``, and at no alpha above
    ``bound`` and no beta of the atlas, which may hold negative ones. Where the stable set may
    continue beyond the atlas, across its largest alpha or an end of beta, ``bound`` is infinite.

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
        whole: (delay_cell,), which axes hold the whole stable set (``LIMIT_WHOLE``).
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

    def beta_cell(self, delay_cell: Integers, beta: Floats) -> Integers:
        """Return the cells along beta that hold values, in cells of delays."""
        widths = (beta - self._beta.take(delay_cell)) * self._per_beta.take(delay_cell)
        return np.asarray(np.minimum(widths.astype(np.intp), self._cells - 1))

    def holds(self, alpha: float, beta: float, gamma: float, delta: float, delay: float) -> bool:
        """Whether a point is inside of the table."""
        cell = self.delays.cell_at(delay)
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
        """The codes of points of any broadcast shape; OutsideError for a point outside, or NaN."""
        is_large = np.broadcast(*points).size >= len(self._columns)
        deciding = self._deciding if is_large else None  # for few it takes longer than they do
        return in_blocks(partial(self._verdicts, deciding), points, np.int8)[0]

    def _verdicts(
        self, deciding: Floats | None, alpha: Floats, beta: Floats, *plant: Floats
    ) -> tuple[NDArray[np.int8]]:
        """Return the codes of points; a plant that all of them share is looked up once."""
        ends = [(np.min(values), np.max(values)) for values in plant]
        for (least, most), (low, high) in zip(ends, self.plants, strict=True):
            if not low <= least <= most <= high:
                raise OutsideError
        gamma, delta, delay = (
            values[:1] if least == most else values
            for values, (least, most) in zip(plant, ends, strict=True)
        )
        cell = self.delays.cells_at(delay)
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
            undecided = [np.broadcast_to(v, alpha.shape)[both] for v in (rows, alpha, *point)]
            codes[both] = codes_by_limits(undecided[1], *self._limits(undecided[0], *undecided[2:]))
        return codes

    @cached_property
    def _deciding(self) -> Floats:
        """Above which alpha, and below which one, one limit decides, in columns (column, 2)."""
        # Above the first, which is above all that the lower limit leaves open in the column, that
        # is the upper limit; below the second, which is below all that the upper one leaves open,
        # the lower. Of a column without a stable alpha the lower limit says so: there it is
        # infinite.
        middles, halves = self._boxes
        shape = np.broadcast_shapes(*(middle.shape for middle in middles))
        rows = np.arange(len(self._columns), dtype=np.float64).reshape(shape)
        alphas = in_blocks(
            partial(_deciding, self._columns), [rows, *middles, *halves], float, float
        )
        return np.stack(alphas, axis=-1).reshape(-1, 2)

    @cached_property
    def _boxes(self) -> tuple[list[Floats], list[Floats]]:
        """Middles, and half widths, of the cells of beta, gamma, delta and delay, as a grid."""
        middle = np.arange(self._cells).reshape(-1, 1, 1, 1) + 0.5
        middles, halves = [middle / self._per_beta + self._beta], [0.5 / self._per_beta]
        for shape, nodes in zip(((-1, 1, 1), (-1, 1)), self._nodes, strict=True):
            low, high = (nodes[:-1], nodes[1:]) if nodes.size > 1 else (nodes, nodes)
            middles.append(0.5 * (high + low).reshape(shape))
            halves.append(0.5 * (high - low).reshape(shape))
        early, late = self.delays.ends["delay"]
        return [*middles, 0.5 * (late + early)], [*halves, 0.5 * (late - early)]

    def verdict(self, alpha: float, beta: float, gamma: float, delta: float, delay: float) -> int:
        """Return the code of one point, without the cost of arrays."""
        delay_cell = self.delays.cell_at(delay)
        lowest, _, per_beta = self._rows[delay_cell][4:]
        cell = min(int((beta - lowest) * per_beta), self._cells - 1)
        row = cell * self._steps[0] + bisect_right(self._inner_lists[0], gamma) * self._steps[1]
        row += bisect_right(self._inner_lists[1], delta) * self._steps[2] + delay_cell
        column = self._columns[row].tolist()
        low, high = column[:LIMIT_TERMS], column[LIMIT_TERMS:]
        error, upper_error = low[-1], high[-1]
        lower, upper = (surface(terms, beta, gamma, delta, delay) for terms in (low, high))
        if alpha < lower - error or alpha > upper + upper_error:
            return int(Verdict.UNSTABLE)
        return int(
            Verdict.STABLE if lower + error < alpha < upper - upper_error else Verdict.UNDECIDED
        )

    def limits_within(
        self, beta: Floats, gamma: Floats, delta: Floats, delay: Floats
    ) -> AlphaLimits:
        """Return the limits at points inside of the table, as far as they are within its alphas."""
        ends = self.delays.walls("alpha", self.delays.cells_at(delay))
        return within(self.limits(beta, gamma, delta, delay), *ends)

    def limits(self, beta: Floats, gamma: Floats, delta: Floats, delay: Floats) -> AlphaLimits:
        """The limits at points of the table, for its alphas; infinite where none is stable."""
        return AlphaLimits(*in_blocks(self._limits_of, (beta, gamma, delta, delay), *[float] * 4))

    def _limits_of(self, *point: Floats) -> Sequence[Floats]:
        return self._limits(self._rows_of(self.delays.cells_at(point[-1]), *point[:-1]), *point)

    def _limits(self, rows: Integers, *point: Floats) -> Sequence[Floats]:
        return surfaces(self._columns.take(rows, axis=0).T, *point)

    def _rows_of(self, cell: Integers, beta: Floats, gamma: Floats, delta: Floats) -> Integers:
        rows = self.beta_cell(cell, beta) * self._steps[0] + self._hands(gamma, delta) + cell
        return np.asarray(rows)

    def _hands(self, gamma: Floats, delta: Floats) -> Integers:
        """The indices of the cells of hands within a cell along beta."""
        along_gamma, along_delta = (
            _rank(inner, values) for inner, values in zip(self._inner, (gamma, delta), strict=True)
        )
        rows: Integers = along_gamma * self._steps[1] + along_delta * self._steps[2]
        return rows

    @ignoring
    def max_alpha(self, gamma: Floats, delta: Floats, delay: Floats) -> MaxAlpha:
        """Return the largest stable alpha for hands inside of the table, arrays of one length."""
        columns = self._columns.reshape(self._cells, self._steps[0], -1)
        numbers = self.delays.cells_at(delay)
        largest = np.full((3, gamma.size), np.nan)
        for point, row in enumerate(self._hands(gamma, delta) + numbers):
            delay_cell = numbers[point]
            edges = np.arange(self._cells + 1) / self._per_beta[delay_cell] + self._beta[delay_cell]
            sides = np.stack([edges[:-1], edges[1:]])  # planes are highest at their sides
            here = slice(point, point + 1)
            least, most = (end[delay_cell] for end in self.delays.ends["alpha"])
            unbounded = limits_at(columns[:, row].T, sides, gamma[here], delta[here], delay[here])
            limits = within(unbounded, least, most)
            top = np.minimum(limits.upper - limits.upper_error, most)
            holds = limits.lower + limits.lower_error < top
            if holds.any():
                best = np.argmax(np.where(holds, top, -np.inf))
                ends = limits.upper + limits.upper_error
                bound = float(np.max(ends, where=limits.lower < np.inf, initial=-np.inf))
                may_hold = ~(limits.lower - limits.lower_error >= ends)
                if may_hold[0, 0] or may_hold[1, -1]:  # the stable set crosses an end of beta
                    bound = np.inf
                largest[:, point] = top.flat[best], sides.flat[best], bound
        return MaxAlpha(*largest)

    @ignoring
    def decided_share(self, delay: float) -> float:
        """Return the share of the volume at a delay that is decided, by the middles of columns."""
        delay_cell = self.delays.cell_at(delay)
        spans = [  # shares, for products of tiny spans are 0
            np.diff(nodes) / np.ptp(nodes) if nodes.size > 1 else np.ones(1)
            for nodes in self._nodes
        ]
        beta, gamma, delta, _ = np.broadcast_arrays(*self._boxes[0])
        point = (middle[..., delay_cell].ravel() for middle in (beta, gamma, delta))
        columns = self._columns[delay_cell :: self._steps[2]].T
        limits = limits_at(columns, *point, np.array(delay))
        weights = np.multiply.outer(np.ones(self._cells), np.multiply.outer(*spans)).ravel()
        undecided = undecided_share(limits, *self._rows[delay_cell][2:4])
        return float(1.0 - np.average(undecided, weights=weights))

    @ignoring
    def common_limits(
        self, beta: float, gamma: Range, delta: Range, delay: float
    ) -> tuple[float, float]:
        """The alphas between which a whole box of (gamma, delta) is proved stable; may be empty."""
        limits = self._limits_over(beta, gamma, delta, delay)
        least, most = self._rows[self.delays.cell_at(delay)][2:4]
        lowest = np.max(limits.lower + limits.lower_error)
        highest = np.min(limits.upper - limits.upper_error)
        return float(np.maximum(lowest, least)), float(np.minimum(highest, most))

    def worst_verdict(
        self, alpha: float, beta: float, gamma: Range, delta: Range, delay: float
    ) -> int:
        """STABLE for a whole box of (gamma, delta), UNSTABLE for a point of it, or UNDECIDED."""
        codes = codes_by_limits(np.array(alpha), *self._limits_over(beta, gamma, delta, delay))
        if np.any(codes == Verdict.UNSTABLE):
            return int(Verdict.UNSTABLE)
        return int(Verdict.STABLE if np.all(codes == Verdict.STABLE) else Verdict.UNDECIDED)

    def _limits_over(self, beta: float, gamma: Range, delta: Range, delay: float) -> AlphaLimits:
        """The limits at the corners of all cells of a box of hands, where planes are extreme."""
        corners = []
        for inner, (low, high) in zip(self._inner, (gamma, delta), strict=True):
            edges = inner[(inner > low) & (inner < high)]
            ends = np.concatenate([[low], edges, [high]])
            corners.append(np.stack([ends[:-1], ends[1:]]))
        # A corner belongs to a cell by the middle of its part of the box.
        middles = np.meshgrid(*(ends.mean(axis=0) for ends in corners), indexing="ij")
        gammas, deltas = (middle.ravel() for middle in middles)
        delay_cell = self.delays.cell_at(delay)
        lowest, _, per_beta = self._rows[delay_cell][4:]
        cell = min(int((beta - lowest) * per_beta), self._cells - 1)
        columns = self._columns[cell * self._steps[0] + self._hands(gammas, deltas) + delay_cell]
        sides = [
            np.meshgrid(corners[0][i], corners[1][j], indexing="ij") for i in (0, 1) for j in (0, 1)
        ]
        at_gamma, at_delta = (np.concatenate([side[k].ravel() for side in sides]) for k in (0, 1))
        still = (np.full_like(at_gamma, value) for value in (beta, delay))
        at_beta, at_delay = still
        return limits_at(np.tile(columns.T, 4), at_beta, at_gamma, at_delta, at_delay)


def _rank(inner: Floats, values: Floats) -> Integers:
    """The number of ascending nodes that are not above each of the values."""
    if inner.size > _FEW:
        return np.asarray(np.searchsorted(inner, values, "right"))
    count = np.zeros(values.shape, np.int8)
    for node in inner:  # a third of the time of a search
        count += values >= node
    return count.astype(np.intp)


@ignoring
def undecided_share(limits: AlphaLimits, low: Floats | float, high: Floats | float) -> Floats:
    """The share of the alphas from the lowest to the highest that the limits leave open."""
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
def within(limits: AlphaLimits, least: Floats | float, most: Floats | float) -> AlphaLimits:
    """The limits between two alphas: one beyond them is infinite, as nothing is known of it."""
    is_below = limits.lower + limits.lower_error <= least
    is_above = limits.upper - limits.upper_error >= most
    return AlphaLimits(
        np.where(is_below, -np.inf, limits.lower),
        np.where(is_below, 0.0, limits.lower_error),
        np.where(is_above, np.inf, limits.upper),
        np.where(is_above, 0.0, limits.upper_error),
    )
