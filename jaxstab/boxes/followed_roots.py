"""A root, or a pair of roots, of p that is followed to second order through cells (lemma B19).

A factor f of p, z - r or z^2 - s z + q, starts from the roots in the middle of a cell. Two steps of
Newton's method in quadratics of the parameters leave a remainder of p by f of third order, which is
bounded: so is how far the roots of p are from those of f.
"""

from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.boxes.cell_polynomial import CellPolynomial
from jaxstab.boxes.quadratics import VARIABLES, Array, Quadratic

Roots = NDArray[np.complex128]

_STEPS = 2  # of Newton's method: quadratics are exact to second order
_ARCS = 24  # of half of a circle
_FARTHEST = 0.05  # that a root of p may be from the one that is followed
_BEYOND = 1e-9  # of what a root moves: more than the rounding of roots

_HALF_ARC = 0.5 * pi / _ARCS
_TURNS = np.exp(1j * (2.0 * np.arange(_ARCS) + 1.0) * _HALF_ARC)


class Followed(NamedTuple):
    """Roots of p that are followed, or numbers about them.

    Attributes:
        factor: the coefficients of the monic f after the first, highest power of z first.
        remainder: bounds of the coefficients of p modulo f, in powers of z - ``centre``.
        centre: what is taken from z before p is divided by f.
        radius: the modulus of the roots of f, as a function; of no meaning where ``error`` is
            infinite, as where a pair meets on the real line.
        error: how far roots of p, one for each of f, are from these at most.
        move: how far the roots of f are from where they start.
        apart: half of the distance of two conjugate roots; infinite for a real root.
    """

    factor: list[Quadratic]
    remainder: list[Array]
    centre: Array
    radius: Quadratic
    error: Array
    move: Array
    apart: Array

    def some(self, cells: NDArray[np.intp]) -> "Followed":
        """Return what belongs to chosen cells."""

        def chosen(part: Quadratic) -> Quadratic:
            return Quadratic(part.terms[:, cells], part.rest[cells])

        factor, left = [chosen(part) for part in self.factor], [r[cells] for r in self.remainder]
        numbers = (part[cells] for part in (self.error, self.move, self.apart))
        return Followed(factor, left, self.centre[cells], chosen(self.radius), *numbers)

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
    move = position.swing + _BEYOND
    bend = _bend(p, root.astype(complex), move)
    error = _distance(left.size, np.abs(slope.middle) - slope.swing, bend)
    error = np.where(np.abs(root) > move + _FARTHEST, error, np.inf)
    endless = np.full_like(root, np.inf)
    still = np.zeros_like(root)
    return Followed([factor], [left.size], still, position.times(sign), error, move, endless)


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
        move = 0.5 * total_moved.swing + 0.25 * gap.swing / distance + _BEYOND
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
    return Followed(factor, sizes, centre, factor[1].root(), error, move, 0.5 * distance)


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
    """Return f, p modulo f, and (p - that)/f modulo f, each highest power first."""
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
    """Bound a monic polynomial from below on circles around 0, over cells.

    Args:
        coefficients: from the first one, which is 1.
        roots: of the polynomial in the middle of each cell, (root, cell).
        circle: radius for each cell.

    Returns:
        A bound; where it is positive, as many roots are beyond the circle all over the cell.
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
