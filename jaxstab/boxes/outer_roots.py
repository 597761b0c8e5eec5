"""The spectral radius all over cells, from the roots that can be outermost there (lemma B19).

In the middle of a cell the k outermost roots are taken, for the least k of 1 ... 4 for which a
circle parts them from the others all over the cell. They are a real root or two, a conjugate pair,
both or two of these; or two or three that may meet, and are kept together.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.boxes.cell_polynomial import CellPolynomial, WallBoxes, cell_polynomial
from jaxstab.boxes.followed_roots import (
    Followed,
    Roots,
    follow_cluster,
    follow_pair,
    follow_root,
    least_size,
)
from jaxstab.boxes.plant import HandBoxes
from jaxstab.boxes.quadratics import TERMS, Array, Quadratic
from jaxstab.model import companion_matrix
from jaxstab.model.filters import Filters

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
    """What is proved of the spectral radius in cells.

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
    """Enclose the spectral radius over cells.

    Args:
        walls: boxes of alpha and beta.
        hands: boxes of gamma in [0, 1e4] and delta in [0, 1e3], one for each of those.
        delay: the middle delay t_d/T >= 0 in samples.
        half_delay: how far the delay is from this at most, between two whole samples.
        filters: velocity estimator and position filter, in units of one sample.

    Raises:
        ValueError: gamma, delta or delay is outside the range of the model.

    Source: Rouche's theorem, for the characteristic polynomial of eq. (9) of Hulin, Preusche,
    Hirzinger (2008).
    """
    known = RadiusSurfaces.unknown(walls.alpha.size)
    for start in range(0, walls.alpha.size, _CELLS):
        cells = slice(start, min(start + _CELLS, walls.alpha.size))
        some = WallBoxes(*(part[cells] for part in walls)), HandBoxes(*(p[cells] for p in hands))
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
            enclose(p.some(cells), roots[:, cells], count, cells, known)
    for count in range(2, min(3, p.degree) + 1):
        cells = np.flatnonzero((known.kind == SurfaceKind.NONE) & _may_be_outer(roots, count))
        if cells.size:
            _enclose_meeting(p.some(cells), roots[:, cells], count, cells, known)
    cells = np.flatnonzero(known.kind == SurfaceKind.NONE)
    if cells.size:
        _enclose_roughly(p.some(cells), roots[:, cells], cells, known)
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
    terms, error = _surface(outer.some(some))
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
    """Follow a real root and a conjugate pair, or two such pairs, of which either may be outer."""
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
    surfaces = (_surface(followed.some(some)) for followed in (first, second))
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
