"""The spectral radius all over cells, from the roots that can be outermost there (lemma B19).

In the middle of a cell the k outermost roots are taken, for the least k of 1 ... 4 for which a
circle separates them from the others all over the cell. They are one or two real roots, a conjugate
pair, a real root and a pair, or two pairs; or two or three roots that may meet, which are enclosed
together.
"""

from enum import IntEnum
from functools import reduce
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.arrays import at
from jaxstab.model import companion_matrix
from jaxstab.model.filters import Filters
from jaxstab.model.linear_loop import loop_factors
from jaxstab.model.sections import UNIT
from jaxstab.model.sections import product as polynomial_product
from jaxstab.proofs.enclosures import PLACES, TERMS, VARIABLES, Array, Quadratic
from jaxstab.proofs.plant import BENDS, HandBoxes, delay_moves, stencil
from jaxstab.rounding import EPS, OVERLAP, PLANT_MODEL

# The characteristic polynomial over cells of (alpha, beta, gamma, delta, delay), to second order.
#
# p is affine in alpha and beta and in the plant's coefficients. Products of a wall with a quadratic
# term of the plant are of third order; they are kept as terms of their own as long as coefficients
# of p are only added up: in powers of z - c they cancel. Lemma B18 of docs/proofs.md.

_HAND = (2, 3, 4)  # gamma, delta and delay among the variables
_PAIRS = [(i, j) for i in _HAND for j in _HAND if i <= j]
_CUBES = {
    (wall, *pair): TERMS + n
    for n, (wall, pair) in enumerate((wall, pair) for wall in (0, 1) for pair in _PAIRS)
}
_ALL_TERMS = TERMS + len(_CUBES)
_CLIPPED = (
    4e-9  # of the slopes: cells reach so much of themselves beyond their ends, but not below 0
)

# Bounds of third derivatives by gamma and by delta; of the delay's slope by gamma twice, by gamma
# and delta, by delta twice; and of the delay's second derivative by gamma and delta: lemma B18.
_THIRD = {
    "d1": (1 / 60, 1.0),
    "d0": (0.0, 1.0),
    "n2": (1 / 6720, 1 / 20),
    "n1": (1 / 3360, 1 / 4),
    "n0": (1 / 6720, 1 / 5),
}

_SLOPE_BENDS = (1 / 60, 1 / 12, 1 / 3)


class WallBoxes(NamedTuple):
    """Boxes of alpha and beta: middles and half-widths."""

    alpha: Array
    beta: Array
    half_alpha: Array
    half_beta: Array


class CellPolynomial(NamedTuple):
    """A monic polynomial over cells, highest power first: terms of coefficients, and their rest.

    The terms (coefficient, term, cell) are those of ``Quadratic``, then the products of a wall and
    two variables of the plant.
    """

    terms: Array
    rest: Array

    @property
    def degree(self) -> int:
        """The degree."""
        return len(self.terms) - 1

    def coefficient(self, number: int) -> Quadratic:
        """Return a coefficient as a quadratic."""
        return self._quadratic(self.terms[number], self.rest[number])

    def coefficients(self) -> list[Quadratic]:
        """Return all coefficients as quadratics."""
        return [self.coefficient(number) for number in range(self.degree + 1)]

    def shifted(self, to: Array) -> "CellPolynomial":
        """Return the polynomial in powers of z - to, a number for each cell."""
        terms, rest = self.terms.copy(), self.rest.copy()
        size = np.abs(terms).sum(axis=1)
        for last in range(self.degree, 0, -1):
            for number in range(1, last + 1):
                terms[number] += terms[number - 1] * to
                rest[number] += rest[number - 1] * np.abs(to)
                size[number] += size[number - 1] * np.abs(to)
        return CellPolynomial(terms, rest + 2.0 * self.degree * EPS * size)

    def by_powers_of(self, factor: list[Array]) -> list[list[Quadratic]]:
        """c_0, c_1 ... of lower degree than a monic f with p = c_0 + c_1 f + c_2 f^2 + ...

        ``factor`` has the coefficients of f after the first, highest power first, numbers.
        """
        parts, left, k = [], self, len(factor)
        while left.degree >= k:
            left, low = left._divided(factor)
            parts.append([low.coefficient(number) for number in range(k)])
        zero = Quadratic.constant(np.zeros(self.rest.shape[1]))
        rows = left.coefficients()
        return [*parts, [zero] * (k - len(rows)) + rows]

    def _divided(self, factor: list[Array]) -> "tuple[CellPolynomial, CellPolynomial]":
        terms, rest = self.terms.copy(), self.rest.copy()
        quotient = self.degree + 1 - len(factor)
        for number in range(quotient):
            lost = rest[number] + 4.0 * EPS * np.abs(terms[number]).sum(axis=0)
            for step, value in enumerate(factor, number + 1):
                terms[step] -= terms[number] * value
                rest[step] += lost * np.abs(value) + 2.0 * EPS * np.abs(terms[step]).sum(axis=0)
        low = CellPolynomial(terms[quotient:], rest[quotient:])
        return CellPolynomial(terms[:quotient], rest[:quotient]), low

    @staticmethod
    def _quadratic(terms: Array, rest: Array) -> Quadratic:
        lost = np.abs(terms[TERMS:]).sum(axis=0) + 16.0 * EPS * np.abs(terms).sum(axis=0)
        return Quadratic(terms[:TERMS], rest + lost)


def cell_polynomial(
    walls: WallBoxes,
    hands: HandBoxes,
    delay: float,
    half_delay: float,
    filters: Filters | None = None,
) -> CellPolynomial:
    """Enclose the characteristic polynomial p of eq. (9), times a power of z, over cells.

    Arguments and errors: as ``radius_surfaces``.
    """
    plant = _plants(hands, delay, half_delay)
    base, stiffness, damping = _multipliers(int(delay) + 1, filters)
    degree = base.size + 1
    cells = walls.alpha.size
    terms, rest = np.zeros((degree + 1, _ALL_TERMS, cells)), np.zeros((degree + 1, cells))
    terms[: base.size, 0] += base[:, None]
    for step, name in ((1, "d1"), (2, "d0")):
        part = plant[name]
        terms[step : step + base.size, :TERMS] += base[:, None, None] * part.terms
        rest[step : step + base.size] += np.abs(base)[:, None] * part.rest
    length = max(stiffness.size, damping.size)
    gains = np.stack([np.append(np.zeros(length - g.size), g) for g in (stiffness, damping)])
    first = degree - (length + 1)  # of N times the wall
    for power, (by_alpha, by_beta) in enumerate(gains.T.tolist()):
        wall = by_alpha * walls.alpha + by_beta * walls.beta
        halves = by_alpha * walls.half_alpha, by_beta * walls.half_beta
        for step, name in enumerate(("n2", "n1", "n0")):
            _add_product(terms, rest, first + power + step, plant[name], wall, halves)
    size = np.abs(terms).sum(axis=1)
    return CellPolynomial(terms, rest + 8.0 * length * EPS * (size + size.max(axis=0)))


def _add_product(
    terms: Array, rest: Array, row: int, part: Quadratic, wall: Array, halves: tuple[Array, Array]
) -> None:
    """Add the product of a coefficient of N, without walls, with an affine function of a wall."""
    terms[row, :TERMS] += part.terms * wall
    size = np.abs(wall)
    for variable, half in enumerate(halves):
        terms[row, 1 + variable] += part.middle * half
        for other in _HAND:
            terms[row, PLACES[variable, other]] += part.terms[1 + other] * half
        for pair in _PAIRS:
            terms[row, _CUBES[(variable, *pair)]] += part.terms[PLACES[pair]] * half
        size = size + np.abs(half)
    rest[row] += (part.rest + 8.0 * EPS * part.size) * size


def _multipliers(lag: int, filters: Filters | None) -> list[Array]:
    """Return what delay, estimator and filter multiply D, alpha N and beta N by, in powers of z."""
    velocity, position = UNIT, UNIT
    if filters:
        velocity, position = filters[0].filter.transfer(), filters[1].transfer()
    powers, factors = loop_factors(lag, velocity, position)
    return [
        np.array([float(c.rounded()) for c in reduce(polynomial_product, each)] + [0.0] * power)
        for power, each in zip(powers, factors, strict=True)
    ]


def _plants(hands: HandBoxes, delay: float, half_delay: float) -> dict[str, Quadratic]:
    """Enclose the plant's coefficients of each cell; cells share few boxes of hands."""
    boxes, number = np.unique(np.stack(hands), axis=1, return_inverse=True)
    known = _plant(HandBoxes(*boxes), delay, half_delay)
    number = number.ravel()
    return {name: Quadratic(q.terms[:, number], q.rest[number]) for name, q in known.items()}


def _plant(hands: HandBoxes, delay: float, half_delay: float) -> dict[str, Quadratic]:
    """Enclose the plant's coefficients: parabolas through three points, and what these leave."""
    h_gamma, h_delta = hands.half_gamma, hands.half_delta
    gamma, delta, values, lost = stencil(hands, delay)
    moves = delay_moves(gamma, delta, delay) if half_delay else {}
    highest = gamma.max(axis=0), delta.max(axis=0)
    plant = {}
    for name, (third_gamma, third_delta) in _THIRD.items():
        middle, *ends = values[name]
        terms = np.zeros((TERMS, h_gamma.size))
        terms[0] = middle
        for variable, below, above in ((2, *ends[:2]), (3, *ends[2:])):
            terms[1 + variable] = 0.5 * (above - below)
            terms[PLACES[variable, variable]] = 0.5 * (above + below) - middle
        # A parabola through -1, 0 and 1 leaves |third derivative| x (1 - x^2)/6 at most.
        rest = BENDS[name].mixed * h_gamma * h_delta
        rest += 0.0642 * (third_gamma * h_gamma**3 + third_delta * h_delta**3)
        rest += lost[name]
        rest += PLANT_MODEL * (np.max(np.abs(values[name]), axis=0) + half_delay)
        if name in moves:
            _add_moves(terms, moves[name], half_delay)
            rest += _rest_of_delay(name, hands, highest, half_delay)
        plant[name] = Quadratic(terms, rest + _CLIPPED * np.abs(terms[1:]).sum(axis=0))
    return plant


def _add_moves(terms: Array, moves: Array, half: float) -> None:
    slope, twice = moves
    terms[5] = slope[0] * half
    terms[PLACES[4, 4]] = twice[0] * half**2
    terms[PLACES[2, 4]] = 0.5 * (slope[2] - slope[1]) * half
    terms[PLACES[3, 4]] = 0.5 * (slope[4] - slope[3]) * half


def _rest_of_delay(name: str, hands: HandBoxes, highest: tuple[Array, Array], half: float) -> Array:
    """Bound what the terms of the delay leave: lemma B18."""
    h_gamma, h_delta, delta = hands.half_gamma, hands.half_delta, highest[1]
    twice, mixed, delta_twice = _SLOPE_BENDS
    slope = twice * h_gamma**2 + mixed * h_gamma * h_delta + delta_twice * h_delta**2
    of_n2 = 0.5 * h_gamma + h_delta
    of_n0 = (0.5 + delta / 6.0) * h_gamma + (2.0 + 0.5 * delta) * h_delta
    bend = {"n2": of_n2, "n0": of_n0, "n1": of_n2 + of_n0}[name]
    third = BENDS[name].delay_thrice * (highest[0] + highest[1]) / 6.0
    times = 2.0 if name == "n1" else 1.0
    return half * times * slope + 0.5 * half**2 * bend + half**3 * third


# A root, or a pair of roots, of p that is followed to second order through cells (lemma B19).
#
# A factor f of p, z - r or z^2 - s z + q, starts from the roots in the middle of a cell. Two steps
# of Newton's method in quadratics of the parameters leave a remainder of p by f of third order,
# which is bounded: so is how far the roots of p are from those of f.

Roots = NDArray[np.complex128]

_STEPS = 2  # of Newton's method: quadratics are exact to second order
_ARCS = 24  # of half of a circle
_FARTHEST = 0.05  # that a root of p may be from the one that is followed
_HALF_ARC = 0.5 * pi / _ARCS
_TURNS = np.exp(1j * (2.0 * np.arange(_ARCS) + 1.0) * _HALF_ARC)


class Followed(NamedTuple):
    """Roots of p that are followed, or numbers about them.

    Attributes:
        factor: the coefficients of the monic f after the first, highest power of z first.
        remainder: bounds of the coefficients of p modulo f, in powers of z - ``centre``.
        centre: subtracted from z before p is divided by f.
        radius: the modulus of the roots of f, as a function; meaningless where ``error`` is
            infinite, as where a pair meets on the real line.
        error: largest distance of roots of p, one for each of f, from these.
        move: distance of the roots of f from where they start.
    """

    factor: list[Quadratic]
    remainder: list[Array]
    centre: Array
    radius: Quadratic
    error: Array
    move: Array

    @property
    def lowest(self) -> Array:
        """A lower bound of the modulus of these roots of f and of p; NaN where none is known."""
        return np.where(np.isfinite(self.error), self.radius.low - self.error, np.nan)

    def remainder_size(self, circle: Array) -> Array:
        """Bound |p modulo f| on circles around 0."""
        size = np.zeros_like(circle)
        for part in self.remainder:
            size = size * (circle + np.abs(self.centre)) + part
        return size


def follow_root(p: CellPolynomial, root: Array) -> Followed:
    """Follow a real root that is simple in the middle of each cell."""
    (factor,), (left,), (slope,) = _newton(p, [-root])
    position = -factor
    sign = np.where(root >= 0.0, 1.0, -1.0)
    move = position.swing + OVERLAP
    bend = _bend(p, root.astype(complex), move)
    error = _distance(left.size, np.abs(slope.middle) - slope.swing, bend)
    error = np.where(np.abs(root) > move + _FARTHEST, error, np.inf)
    centre = np.zeros_like(root)
    return Followed([factor], [left.size], centre, position.times(sign), error, move)


def follow_pair(p: CellPolynomial, total: Array, product: Array) -> Followed:
    """Follow two roots, conjugate or real, given by sum and product in the middle of each cell."""
    centre = 0.5 * total
    around = p.shifted(centre)
    (minus_sum, constant), left, slope = _newton(around, [0.0 * centre, product - centre**2])
    total_moved = -minus_sum
    four = np.full_like(centre, 4.0)
    gap = constant.times(four) - total_moved * total_moved  # (2 Im z)^2
    distance = np.sqrt(np.maximum(gap.low, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        move = 0.5 * total_moved.swing + 0.25 * gap.swing / distance + OVERLAP
        start = 0.5j * np.sqrt(np.maximum(4.0 * constant.middle, 0.0)) + 0.5 * total_moved.middle
        # p'(z) = f'(z) g(z) + the slope of the remainder, and |g|^2 is the resultant of f and g.
        a, b = slope
        size = b * b + a * b * total_moved + a * a * constant
        steepness = np.sqrt(np.maximum(size.low, 0.0)) * distance - left[0].size
        lost = left[0].size * np.sqrt(constant.size) + left[1].size
        error = _distance(lost, steepness, _bend(around, start, move))
    error = np.where(error < 0.25 * distance, error, np.inf)
    moved_back = (minus_sum.plus(-2.0 * centre), constant - minus_sum.times(centre))
    factor = [moved_back[0], moved_back[1].plus(centre**2)]
    sizes = [part.size for part in left]
    return Followed(factor, sizes, centre, factor[1].root(), error, move)


class Cluster(NamedTuple):
    """Roots of p that may meet: those of a monic f of degree 2 or 3.

    Attributes:
        factor: the coefficients of f after the first, highest power first, in powers of z.
        left: bounds of the coefficients of p modulo f, in powers of z - ``centre``.
        centre: a number for each cell.
        mean: the mean of the roots of f.
        reduced: the coefficients of f in powers of z - mean, after those of the first two powers:
            Q of w^2 + Q, or P and Q of w^3 + P w + Q.
    """

    factor: list[Quadratic]
    left: list[Array]
    centre: Array
    mean: Quadratic
    reduced: list[Quadratic]

    def bound(self, least: Array) -> Array:
        """Bound |f| at the outer roots of p, where |g| is at least so much beyond a circle.

        First within a circle around 0 beyond which |f| is larger, and then near the mean.
        """
        farthest = self.mean.size + self.reach(np.zeros_like(least)) + 0.2
        bound = self._remainder(farthest + np.abs(self.centre)) / least
        is_known = (least > 0.0) & (bound < 0.2 ** len(self.factor))
        bound = np.where(is_known, bound, 1.0)
        aside = self.mean.plus(-self.centre).size
        bound = (self._remainder(self.reach(bound) + aside) + 1e-15) / np.where(is_known, least, 1)
        reach = self.reach(bound)
        for part in self.reduced:  # who reads these has no more than their terms
            bound = bound + part.rest * (reach if part is not self.reduced[-1] else 1.0)
        bound = bound + (self.mean.rest + 1e-15) * len(self.factor) * (reach + self.mean.rest) ** (
            len(self.factor) - 1
        )
        return np.where(is_known, 1.01 * bound + 1e-15, np.inf)

    def reach(self, bound: Array) -> Array:
        """Bound |z - mean| where |f| is no more than so much."""
        last = self.reduced[-1].size + bound
        if len(self.factor) == 2:
            return np.sqrt(last)
        return np.maximum(np.sqrt(2.0 * self.reduced[0].size), np.cbrt(2.0 * last))

    def _remainder(self, aside: Array) -> Array:
        """Bound |p modulo f| so far from the centre."""
        size = np.zeros_like(aside)
        for part in self.left:
            size = size * aside + part
        return size


def follow_cluster(p: CellPolynomial, roots: Roots) -> Cluster:
    """Follow two or three roots by the coefficients of their polynomial."""
    count = len(roots)
    centre = roots.real.mean(axis=0)
    start = [part.real for part in _coefficients(roots - centre)]
    factor, left, _ = _newton(p.shifted(centre), start)
    share = np.full_like(centre, -1.0 / count)
    mean = factor[0].times(share)
    reduced = _shifted(factor, mean)[1:]
    moved = _shifted(factor, Quadratic.constant(-centre))
    return Cluster(moved, [part.size for part in left], centre, mean.plus(centre), reduced)


def _coefficients(roots: Roots) -> list[Roots]:
    """Return the coefficients of the polynomial of some roots after the first."""
    known = np.zeros((len(roots) + 1, roots.shape[1]), complex)
    known[0] = 1.0
    for root in roots:
        known[1:] -= root * known[:-1]
    return list(known[1:])


def _shifted(factor: list[Quadratic], to: Quadratic) -> list[Quadratic]:
    """Return a monic polynomial in powers of z - to."""
    rows = list(factor)
    for last in range(len(rows), 0, -1):
        rows[0] = rows[0] + to
        for number in range(1, last):
            rows[number] = rows[number] + rows[number - 1] * to
    return rows


def _newton(
    p: CellPolynomial, start: list[Array]
) -> tuple[list[Quadratic], list[Quadratic], list[Quadratic]]:
    """f, p modulo f, and (p - that)/f modulo f, each highest power first.

    f_0 is the factor in the middle of the cell. With p = c_0 + c_1 f_0 + c_2 f_0^2 + ..., deg c_j
    less than that of f, and f_0 = f + e, p modulo f is c_0 + c_1 e + ..., as small as e is. A step
    of Newton's method adds to f a term that makes that 0 to first order: ``inverse`` is the inverse
    of f -> c_1 f modulo f_0, taken in the middle alone. The first step makes it small of second
    order, the next one of third, which quadratics do not resolve. No proof depends on how good f
    is: its rests are dropped on the way, and p modulo f is that of the f which is returned.
    """
    parts = p.by_powers_of(start)
    factor = [Quadratic.constant(value) for value in start]
    inverse = _inverse([part.middle for part in parts[1]], start)
    left = slope = parts[0]  # of f_0
    for step in range(1, _STEPS + 1):
        factor = [
            Quadratic(
                part.terms + sum(share * rest.terms for share, rest in zip(row, left, strict=True)),
                np.zeros_like(part.rest),
            )
            for part, row in zip(factor, inverse, strict=True)
        ]
        beside = [-part.plus(-value) for part, value in zip(factor, start, strict=True)]
        left, slope = _modulo(parts, factor, beside, with_slope=step == _STEPS)
    return factor, left, slope


def _modulo(
    parts: list[list[Quadratic]],
    factor: list[Quadratic],
    beside: list[Quadratic],
    *,
    with_slope: bool,
) -> tuple[list[Quadratic], list[Quadratic]]:
    """Return sum c_j e^j and sum j c_j e^(j - 1) modulo f, where f_0 is f + e."""
    value, slope = parts[-1], [part.times(0.0 * part.middle) for part in parts[-1]]
    for part in parts[-2::-1]:
        if with_slope:
            slope = _added(_product(slope, beside, factor), value)
        value = _added(_product(value, beside, factor), part)
    return value, slope


def _product(
    one: list[Quadratic], two: list[Quadratic], factor: list[Quadratic]
) -> list[Quadratic]:
    """Return a product of polynomials of lower degree than f modulo f."""
    count = len(factor)
    rows = [one[0] * part for part in two]
    for number, part in enumerate(one[1:], 1):
        for step, other in enumerate(two, number):
            rows[step : step + 1] = (
                [rows[step] + part * other] if step < len(rows) else [part * other]
            )
    for number in range(count - 1):
        for step, part in enumerate(factor, number + 1):
            rows[step] = rows[step] - rows[number] * part
    return rows[count - 1 :]


def _added(one: list[Quadratic], two: list[Quadratic]) -> list[Quadratic]:
    return [a + b for a, b in zip(one, two, strict=True)]


def _inverse(slope: list[Array], start: list[Array]) -> Array:
    """Return how f changes with p modulo f, in the middle: division by ``slope`` modulo f."""
    count = len(start)
    row = list(slope)  # slope times z^j modulo f
    columns = [np.stack(row)]
    for _ in range(count - 1):
        lead, row = row[0], [*row[1:], np.zeros_like(row[0])]
        row = [part - lead * value for part, value in zip(row, start, strict=True)]
        columns.append(np.stack(row))
    matrix = np.moveaxis(np.stack(columns[::-1], axis=1), -1, 0)
    is_singular = ~(np.abs(np.linalg.det(matrix)) > 0.0)
    matrix[is_singular] = np.eye(count)  # a root of both f and g: no move is right, none is wrong
    inverse: Array = np.asarray(np.linalg.inv(matrix), np.float64)
    return np.moveaxis(inverse, 0, -1)


def _bend(p: CellPolynomial, start: Roots, move: Array) -> Array:
    """Bound |p''| over the cell as far from the start as roots of p and f may be."""
    reach = np.where(np.isfinite(move), move + _FARTHEST, 0.0)
    degree, around = p.degree, list(p.terms[:, 0].astype(complex))
    size = np.abs(start) + reach
    bend = np.zeros_like(reach)
    for power in range(degree + 1):  # Taylor coefficients in the middle, by repeated division
        for number in range(1, len(around)):
            around[number] = around[number] + around[number - 1] * start
        value = np.abs(around.pop())
        if power >= 2:
            bend += power * (power - 1) * value * reach ** (power - 2)
    changes = np.abs(p.terms[:, 1:]).sum(axis=1) + p.rest + 1e-12 * np.abs(p.terms[:, 0])
    for number in range(degree - 1):
        power = degree - number
        bend += power * (power - 1) * changes[number] * size ** (power - 2)
    return np.where(np.isfinite(move), bend, np.inf)


def _distance(left: Array, steepness: Array, bend: Array) -> Array:
    """Return within what distance of a root of f the tangent of p, and so p, has one root."""
    with np.errstate(all="ignore"):
        step = (left + 1e-15) / steepness
        near, far = 1.1 * step, 2.0 * step
        is_near, is_far = near * bend < 2.0 / 11.0 * steepness, far * bend < steepness
        error = np.where(is_near, near, np.where(is_far, far, np.inf))
        return np.where((steepness > 0.0) & (error < _FARTHEST), error, np.inf)


def least_size(coefficients: list[Quadratic], roots: Roots, circle: Array) -> Array:
    """A lower bound of a monic polynomial on circles around 0, over cells.

    Where it is positive, as many roots are beyond the circle all over the cell as in its middle.
    ``coefficients`` begin with 1; ``roots`` are those in the middle of each cell, (root, cell).
    """
    degree = len(coefficients) - 1
    known = np.zeros((degree + 1, circle.size), complex)
    known[0] = 1.0
    least = np.ones((_ARCS, circle.size))
    on_arcs = _TURNS[:, None] * circle
    for root in roots:
        known[1:] -= root * known[:-1]
        away = np.maximum(
            np.abs(on_arcs - root) - _HALF_ARC * circle, np.abs(circle - np.abs(root))
        )
        least *= away
    powers = np.arange(degree, -1, -1)[:, None]
    scale = circle**powers
    terms = np.stack([part.terms for part in coefficients])
    lines = terms[:, 1 : 1 + VARIABLES] * scale[:, None]
    waves = (_TURNS**powers).T  # (arc, coefficient)
    cosines, sines = np.ascontiguousarray(waves.real), np.ascontiguousarray(waves.imag)
    swing = np.zeros_like(least)
    for line in np.moveaxis(lines, 1, 0):  # one by one: products too small for threads of BLAS
        swing += np.sqrt((cosines @ line) ** 2 + (sines @ line) ** 2)
    along = _HALF_ARC * (powers * np.abs(lines).sum(axis=1)).sum(axis=0)
    curves = np.abs(terms[:, 1 + VARIABLES :]).sum(axis=1)
    rest = np.stack([part.rest for part in coefficients])
    apart = np.abs(known - terms[:, 0]) + 1e-13 * (np.abs(known) + np.abs(terms).sum(axis=1))
    others = ((curves + rest + apart) * scale).sum(axis=0)
    return (least - swing - along - others).min(axis=0)


Cells = NDArray[np.intp]

Flags = NDArray[np.bool_]

_CELLS = 2**11  # that are computed at once: they stay in the cache of a CPU
_GAP = 0.25  # of the way from the outer to the inner roots: where the circle is
WIDEST_CLUSTER = 2.0

"""How far roots that may meet are from their mean at most."""

_LARGEST_BOUND = 1e-2  # of a polynomial whose roots are worth to be told
_OFFSETS = (0.3, 0.2, 0.12, 0.08, 0.05, 0.03, 0.02, 0.012)

"""Where circles beside the outermost root are tried."""


class SurfaceKind(IntEnum):
    """What the radius of a cell is made of; r is it up to the error."""

    NONE = 0  # nothing is known
    ONE = 1  # r is a function of second order
    LARGER = 2  # r is the larger of two functions of second order
    PAIR = 3  # r is that of two roots m + w with w^2 + Q = 0, for functions m and Q
    CLUSTER = 4  # r is that of three roots m + w with w^3 + P w + Q = 0, for functions m, P, Q


class RadiusSurfaces(NamedTuple):
    """Proved surfaces of the spectral radius in cells.

    Attributes:
        kind: a ``SurfaceKind`` of each cell.
        terms: of each function, those of ``Quadratic``, (3, term, cell).
        error: of the first two functions; of roots that may meet, a bound of the polynomial in w
            at the outer roots of p, where |w| <= ``WIDEST_CLUSTER``, and 0.
    """

    kind: NDArray[np.int8]
    terms: Array
    error: Array

    @classmethod
    def unknown(cls, cells: int) -> "RadiusSurfaces":
        """Return what says nothing."""
        return cls(np.zeros(cells, np.int8), np.zeros((3, TERMS, cells)), np.zeros((2, cells)))

    def put(self, cells: Cells, kind: SurfaceKind, terms: list[Array], errors: list[Array]) -> None:
        """Set what is known of cells: the terms of each function, and errors."""
        self.kind[cells] = kind
        for number, of_function in enumerate(terms):
            self.terms[number][:, cells] = of_function
        for number, error in enumerate(errors):
            self.error[number][cells] = error


def radius_surfaces(
    walls: WallBoxes,
    hands: HandBoxes,
    delay: float,
    half_delay: float,
    filters: Filters | None = None,
) -> RadiusSurfaces:
    """Enclose the spectral radius over cells: boxes of walls, and of hands, one for each of those.

    Hands have gamma in [0, 1e4] and delta in [0, 1e3]; ``half_delay`` is the largest distance of
    the delay, in samples, from its middle, between two whole samples. Filters are per sample.

    Raises: see ``jaxstab.conventions``. Source: Rouche's theorem, for the characteristic polynomial
    of eq. (9) of Hulin, Preusche, Hirzinger (2008).
    """
    known = RadiusSurfaces.unknown(walls.alpha.size)
    for start in range(0, walls.alpha.size, _CELLS):
        cells = slice(start, min(start + _CELLS, walls.alpha.size))
        some = at((walls, hands), cells)
        part = _of_cells(cell_polynomial(*some, delay, half_delay, filters))
        known.kind[cells] = part.kind
        known.terms[..., cells], known.error[:, cells] = part.terms, part.error
    return known


def _of_cells(p: CellPolynomial) -> RadiusSurfaces:
    roots = _roots(p)
    known = RadiusSurfaces.unknown(roots.shape[1])
    for count in range(1, min(4, p.degree) + 1):
        cells = np.flatnonzero((known.kind == SurfaceKind.NONE) & _may_be_outer(roots, count))
        if cells.size:
            enclose = _enclose_one if count <= 2 else _enclose_two
            enclose(at(p, (..., cells)), roots[:, cells], count, cells, known)
    for count in range(2, min(3, p.degree) + 1):
        cells = np.flatnonzero((known.kind == SurfaceKind.NONE) & _may_be_outer(roots, count))
        if cells.size:
            _enclose_meeting(at(p, (..., cells)), roots[:, cells], count, cells, known)
    cells = np.flatnonzero(known.kind == SurfaceKind.NONE)
    if cells.size:
        _enclose_roughly(at(p, (..., cells)), roots[:, cells], cells, known)
    return known


def _roots(p: CellPolynomial) -> Roots:
    """Return the roots in the middle of each cell, the outermost first."""
    found = np.linalg.eigvals(companion_matrix(p.terms[:, 0].T)).astype(complex)
    order = np.argsort(-np.abs(found), axis=1, kind="stable")
    roots: Roots = np.ascontiguousarray(np.take_along_axis(found, order, axis=1).T)
    return roots


def _may_be_outer(roots: Roots, count: int) -> Flags:
    """Say where so many roots are a real root, a pair, or one of two of these, and none is torn."""
    of_pairs = np.sum(roots[:count].imag != 0.0, axis=0)
    fits: Flags = np.isin(of_pairs, {1: [0], 2: [0, 2], 3: [0, 2], 4: [4]}[count])
    if count < len(roots):
        fits &= np.abs(roots[count - 1]) > np.abs(roots[count]) * (1.0 + 1e-9)
    return fits


def _enclose_one(
    p: CellPolynomial, roots: Roots, count: int, cells: Cells, known: RadiusSurfaces
) -> None:
    """Follow one real root, or a conjugate pair."""
    if count == 1:
        outer = follow_root(p, roots[0].real)
    else:
        total, product = (roots[0] + roots[1]).real, (roots[0] * roots[1]).real
        outer = follow_pair(p, total, product)
    inner, circle = _between(outer.lowest, roots, count)
    beside = _quotient(p, outer.factor)
    least = least_size(beside, roots[count:], circle)
    size = np.maximum(
        np.maximum(outer.lowest - circle, 0.0) ** count,
        least_size(_monic(outer.factor), roots[:count], circle),
    )
    with np.errstate(invalid="ignore"):
        is_proved = (outer.lowest > inner) & (least > 0.0)
        is_proved &= size * least > outer.remainder_size(circle)
    if count == 2:
        is_proved &= roots[0].imag != 0.0
    some = np.flatnonzero(is_proved)
    terms, error = _surface(at(outer, (..., some)))
    known.put(cells[some], SurfaceKind.ONE, [terms], [error])


def _enclose_meeting(
    p: CellPolynomial, roots: Roots, count: int, cells: Cells, known: RadiusSurfaces
) -> None:
    """Enclose two or three outer roots that may meet."""
    inner = np.abs(roots[count]) if count < len(roots) else np.zeros(cells.size)
    circle = np.maximum(0.5 * (np.abs(roots[count - 1]) + inner), 1e-3)
    outer = follow_cluster(p, roots[:count])
    with np.errstate(all="ignore"):
        least = least_size(_quotient(p, outer.factor), roots[count:], circle)
        bound = outer.bound(least)
        size = least_size(_monic(outer.factor), roots[:count], circle)
        is_proved = (
            (size > bound) & (bound < _LARGEST_BOUND) & (outer.reach(bound) < WIDEST_CLUSTER)
        )
    some = np.flatnonzero(is_proved)
    terms = [part.terms[:, some] for part in (outer.mean, *outer.reduced)]
    kind = SurfaceKind.PAIR if count == 2 else SurfaceKind.CLUSTER
    known.put(cells[some], kind, terms, [bound[some], np.zeros(some.size)])


def _enclose_two(
    p: CellPolynomial, roots: Roots, count: int, cells: Cells, known: RadiusSurfaces
) -> None:
    """Follow a real root and a conjugate pair, or two such pairs, of which either may be outer.

    With p = f (f_2 g + r_2) + r, f of the pair above the axis with the larger modulus and f_2 of
    the others, a cell is proved where on one circle inside of all these roots (lemma B19)

        |f_2| |g| > |r_2|   and   |f| (|f_2| |g| - |r_2|) > |r|,

    and g has no root beyond it: then p has ``count`` roots beyond, which belong to f and f_2. The
    radius is the larger of the two moduli where the discs around the roots of f and of f_2, in
    which those of p are, stay apart.
    """
    everywhere = np.arange(cells.size)
    upper = np.argsort(
        roots[:count].imag <= 0.0, axis=0, kind="stable"
    )  # roots above the axis first
    pair = roots[upper[0], everywhere]
    first = follow_pair(p, 2.0 * pair.real, np.abs(pair) ** 2)
    if count == 3:
        number = np.argmin(np.abs(roots[:3].imag), axis=0)
        other = roots[number, everywhere]
        second, others = follow_root(p, other.real), other[None]
    else:
        other = roots[upper[1], everywhere]
        second = follow_pair(p, 2.0 * other.real, np.abs(other) ** 2)
        others = np.stack([other, other.conj()])
    lowest = np.minimum(first.lowest, second.lowest)
    inner, circle = _between(lowest, roots, count)
    beside, left = _divided(_quotient(p, first.factor), second.factor)
    least = least_size(beside, roots[count:], circle)
    gap = np.maximum(lowest - circle, 0.0)
    pairs = np.stack([pair, pair.conj()])
    size = np.maximum(gap**2, least_size(_monic(first.factor), pairs, circle))
    size_2 = np.maximum(gap ** len(others), least_size(_monic(second.factor), others, circle))
    lost = np.zeros_like(circle)
    for part in left:
        lost = lost * circle + part.size
    with np.errstate(invalid="ignore"):
        both = size_2 * least - lost
        is_proved = (lowest > inner) & (least > 0.0) & (both > 0.0)
        is_proved &= size * both > first.remainder_size(circle)
        away = np.abs(pair - other) - first.move - second.move
        is_proved &= away > first.error + second.error
    some = np.flatnonzero(is_proved)
    surfaces = (_surface(at(followed, (..., some))) for followed in (first, second))
    terms, errors = zip(*surfaces, strict=True)
    known.put(cells[some], SurfaceKind.LARGER, list(terms), list(errors))


def _enclose_roughly(p: CellPolynomial, roots: Roots, cells: Cells, known: RadiusSurfaces) -> None:
    """Enclose the radius by circles with no root beyond them, and with one."""
    coefficients, outermost = p.coefficients(), np.abs(roots[0])
    low, high = np.zeros(cells.size), np.full(cells.size, np.inf)
    for offset in _OFFSETS:
        above, below = outermost + offset, np.maximum(outermost - offset, 1e-3)
        high = np.where(least_size(coefficients, roots, above) > 0.0, above, high)
        has_one = (outermost > below) & (least_size(coefficients, roots, below) > 0.0)
        low = np.where(has_one, below, low)
    some = np.flatnonzero(np.isfinite(high))
    terms = np.zeros((TERMS, some.size))
    terms[0] = 0.5 * (low + high)[some]
    known.put(cells[some], SurfaceKind.ONE, [terms], [0.5 * (high - low)[some] + 1e-14])


def _between(lowest: Array, roots: Roots, count: int) -> tuple[Array, Array]:
    """Return the modulus of the next inner root in the middle, and the circle outside of it."""
    inner = np.abs(roots[count]) if count < len(roots) else np.zeros(roots.shape[1])
    outer = np.where(np.isfinite(lowest), lowest, np.abs(roots[count - 1]))
    return inner, np.maximum(outer - _GAP * (outer - inner), 1e-3)


def _surface(followed: Followed) -> tuple[Array, Array]:
    return followed.radius.terms, followed.error + followed.radius.rest


def _monic(factor: list[Quadratic]) -> list[Quadratic]:
    return [Quadratic.constant(np.ones(factor[0].rest.size)), *factor]


def _quotient(p: CellPolynomial, factor: list[Quadratic]) -> list[Quadratic]:
    return _divided(p.coefficients(), factor)[0]


def _divided(
    polynomial: list[Quadratic], factor: list[Quadratic]
) -> tuple[list[Quadratic], list[Quadratic]]:
    """Return quotient and remainder by a monic factor of a monic polynomial."""
    rows = list(polynomial)
    quotient = len(rows) - len(factor)
    for number in range(quotient):
        for step, part in enumerate(factor, number + 1):
            rows[step] = rows[step] - (rows[number] * part if number else part)
    return rows[:quotient], rows[quotient:]
