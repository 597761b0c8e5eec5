"""Spectral radii at all points: a few functions of each cell, with a proved error.

A cell is one along alpha, beta, gamma, delta and delay. ``proofs.radius_cells`` proves for it that
the spectral radius is one function of second order, the larger of two, or that of two or three
roots whose polynomial has such functions as coefficients (lemma B19 of docs/proofs.md), each within
an error. A file has their terms in single precision, rounded to a small share of the error, so that
they compress well; what that changes is added to the error (``_in_float32``). A reader evaluates
the functions at a point and bounds the radius (``radius_bounds``).
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format.variables import Variable, numbers
from jaxstab.atlas.products.limits import Integers, in_parts
from jaxstab.atlas.products.product import Array, Arrays, Check, Floats, Product
from jaxstab.rounding import OVERLAP, ROOTS, SURFACES

if TYPE_CHECKING:
    from jaxstab.atlas.compute.layout import Grid
    from jaxstab.atlas.compute.plan import Plan, Tile
    from jaxstab.atlas.read.atlas import Atlas
    from jaxstab.model.filters import Filters
    from jaxstab.proofs.radius_cells import RadiusSurfaces

SPECTRAL_RADIUS = "spectral_radius"
RADIUS_RANGE = "radius_range"
RADIUS_KIND = "radius_kind"
RADIUS_TERMS = "radius_terms"
RADIUS_ROW = "radius_row"
RADIUS_CELL = (
    "radius_alpha_cell",
    "radius_beta_cell",
    "radius_gamma_cell",
    "radius_delta_cell",
    "radius_delay_cell",
)

TERMS_OF_RADIUS = 22  # of each function: those up to second order, and an error
RADIUS_KINDS = (1, 4)  # the least and the largest
RADIUS_FUNCTIONS = (0, 1, 2, 2, 3)  # of cells of each kind

_VARIABLES = (
    *(
        numbers(name, "cell i of n is the i-th of n equal parts of the range")
        for name in RADIUS_CELL[:-1]
    ),
    numbers(RADIUS_CELL[-1], "cell i holds the delays radius_range[i, 0] to [i, 1]"),
    numbers(
        "radius_end",
        "0 and 1: lowest and highest delay of a cell; 2 and 3: likewise alpha; 4 and 5: beta",
    ),
    Variable(
        RADIUS_RANGE,
        "float64",
        ("radius_delay_cell", "radius_end"),
        "delays, alpha and beta for which spectral radii are given",
        "one row for each cell of delays, ascending; of two cells that share a delay the "
        "second answers for it",
    ),
    numbers(
        "radius_term",
        "0: constant; 1 to 5: slopes along alpha, beta, gamma, delta and delay, each from -1 "
        "to 1 in the cell; 6 to 20: of their products in the order 11 12 13 14 15 22 ... 55; "
        "21: error",
    ),
    replace(
        numbers(RADIUS_ROW, "functions of all cells, one cell after the other, the delay slowest"),
        packed=True,
    ),
    Variable(
        RADIUS_KIND,
        "int32",
        RADIUS_CELL,
        "what the spectral radius, the largest modulus of a closed-loop pole, is made of",
        "Proved for each point of the closed cell. 1: it is a function, 2: the larger of two "
        "functions, each within its error. 3: it is the largest |m + w| of two w at which "
        "|w^2 + Q| is not larger than the error of m; 4: of three w at which |w^3 + P w + Q| "
        "is not; m, P and Q are functions in this order, and the error of the second one is "
        "that of |m + w|",
        *RADIUS_KINDS,
        packed=True,
    ),
    Variable(
        RADIUS_TERMS,
        "float32",
        ("radius_term", RADIUS_ROW),
        "terms of the functions of which the spectral radius is made",
        "of 1, 2, 2 and 3 functions for the kinds 1 to 4; an infinite error: nothing is known",
        packed=True,
    ),
)


class Radii(Product):
    """Functions of cells that bound the spectral radius."""

    name = SPECTRAL_RADIUS
    variables = _VARIABLES
    gridded = (RADIUS_KIND,)
    known = (RADIUS_RANGE,)
    rows = RADIUS_RANGE
    lengths = {"radius_term": TERMS_OF_RADIUS, "radius_end": 6}  # noqa: RUF012
    unit = RADIUS_CELL

    def compute(self, plan: "Plan", tile: "Tile") -> dict[str, Array]:
        """Return the functions of a tile, one cell of delays after the other."""
        from jaxstab.proofs.plant import HandBoxes
        from jaxstab.proofs.radius_cells import WallBoxes, radius_surfaces

        grid = plan.grid
        counts = grid.radius_cells
        kinds = np.zeros(plan.shape(RADIUS_KIND, tile), np.int32)
        rows = [np.zeros((TERMS_OF_RADIUS, 0), np.float32)]
        for number, cell in enumerate(plan.numbers(RADIUS_CELL[-1], tile) if kinds.size else ()):
            early, late, *walls = grid.radius_range[cell].tolist()
            ends = (*np.reshape(walls, (2, 2)), grid.gamma[[0, -1]], grid.delta[[0, -1]])
            boxes = [_parts(pair, count) for pair, count in zip(ends, counts, strict=True)]
            middles = np.meshgrid(*(middle for middle, _ in boxes), indexing="ij")
            halves = [np.full(middles[0].size, half) for _, half in boxes]
            alpha, beta, gamma, delta = (middle.ravel() for middle in middles)
            middle = 0.5 * (early + late)
            half = (1.0 + OVERLAP) * max(middle - early, late - middle)
            surfaces = radius_surfaces(
                WallBoxes(alpha, beta, *halves[:2]),
                HandBoxes(gamma, delta, *halves[2:]),
                middle,
                half,
                plan.spec.filters,
            )
            kind, of_cells = _in_float32(surfaces)
            kinds[..., number] = kind.reshape(counts)
            rows.append(of_cells)
        return {RADIUS_KIND: kinds, RADIUS_TERMS: np.concatenate(rows, axis=1)}

    def known_before(self, grid: "Grid", filters: "Filters | None") -> dict[str, Array]:
        return {RADIUS_RANGE: grid.radius_range}

    def are_values(self, name: str, values: Array) -> bool:
        if name != RADIUS_TERMS:
            return True
        return bool(np.all(np.isfinite(values[:-1])) and values[-1].min() >= 0.0)

    def fit_together(self, arrays: Arrays, lengths: Mapping[str, int]) -> bool:
        """Whether there are as many functions as the kinds of the cells say."""
        if RADIUS_KIND not in arrays:
            return True
        counts = np.bincount(arrays[RADIUS_KIND].reshape(-1), minlength=len(RADIUS_FUNCTIONS))
        return int(counts @ np.array(RADIUS_FUNCTIONS)) == lengths[RADIUS_ROW]

    def part(self, grid: "Grid", place: Floats) -> "Grid":
        delay, *hand, beta = place
        alphas, betas, *of_hands = grid.radius_cells
        columns, ends = grid.row_at(grid.radius_range, delay, betas, _BETAS, beta)
        sides = [
            np.unique(nodes[0] + np.ptp(nodes) * (int(share * count) + np.arange(2.0)) / count)
            for nodes, count, share in zip((grid.gamma, grid.delta), of_hands, hand, strict=True)
        ]
        return replace(
            grid.without_walls(ends),
            gamma=sides[0],
            delta=sides[1],
            radius_cells=(alphas, columns, 1, 1),
            radius_range=ends,
        )

    def checks_of_answers(
        self, atlas: "Atlas", sample: int, chance: np.random.Generator
    ) -> Iterator[Check]:
        """Ask for radii at random points of cells of delays, and compute them."""
        from jaxstab.model import by_name
        from jaxstab.model.filters import as_keywords
        from jaxstab.point import spectral_radius

        rows = atlas.arrays[RADIUS_RANGE]
        each, wrong = -(-sample // _ROWS), 0
        filters = as_keywords(atlas.filters)
        hands = [atlas.arrays[name][[0, -1]] for name in ("gamma", "delta")]
        for row in rows[chance.integers(len(rows), size=_ROWS)]:
            ends = row[2:4], row[4:], *hands
            alpha, beta, gamma, delta = (chance.uniform(low, high, each) for low, high in ends)
            point = alpha, beta, gamma, delta, chance.uniform(*row[:2])
            answer = atlas.query(**by_name(*point), outside="undecided")
            radius = spectral_radius(**by_name(*point), **filters)
            off = np.abs(answer.spectral_radius - radius.value) - radius.error
            is_known = np.isfinite(answer.radius_error)
            wrong += int(np.sum(is_known & ~(off <= answer.radius_error)))  # NaN is wrong, too
        yield Check(SPECTRAL_RADIUS, wrong == 0, f"{wrong} of {each * _ROWS} points are wrong")


_BETAS = 16  # cells along beta of a part
_ROWS = 16  # cells of delays that are verified
_STEP = 1 / 64  # of an error: terms are multiples of less than this, which take little room
_LEAST_ERROR = 1e-9
_DIGITS = 5  # of an error, rounded up
_LARGEST = 1e6  # of terms


def _parts(ends: Floats, count: int) -> tuple[Floats, float]:
    """Return the middles of equal parts of a range, and half of their width."""
    low, high = ends.tolist()
    half = 0.5 * (high - low) / count
    return low + half * (2.0 * np.arange(count) + 1.0), half * (1.0 + OVERLAP)


def _in_float32(surfaces: "RadiusSurfaces") -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the kinds of cells and the terms of their functions, with what rounding loses."""
    from jaxstab.proofs.radius_cells import WIDEST_CLUSTER, SurfaceKind

    kind, terms = surfaces.kind.astype(np.int32), surfaces.terms.copy()
    errors = np.concatenate([surfaces.error, np.zeros((1, kind.size))])
    is_known = (kind != SurfaceKind.NONE) & np.all(np.abs(terms) < _LARGEST, axis=(0, 1))
    is_known &= np.all(np.isfinite(errors), axis=0)
    terms[..., ~is_known], errors[:, ~is_known], kind[~is_known] = 0.0, np.inf, SurfaceKind.ONE
    meets = np.isin(kind, (SurfaceKind.PAIR, SurfaceKind.CLUSTER))
    scale = np.where(meets, errors[0], errors)
    step = np.exp2(np.floor(np.log2(_STEP * np.clip(scale, _LEAST_ERROR, 1.0))))
    rounded = (np.round(terms / step[:, None]) * step[:, None]).astype(np.float32)
    moved = np.abs(rounded - terms).sum(axis=1) + OVERLAP * np.abs(terms[:, 1:]).sum(axis=1)
    # A mean that is moved moves the roots; the others change the polynomial in w.
    of_polynomial = np.where(
        kind == SurfaceKind.PAIR, moved[1], WIDEST_CLUSTER * moved[1] + moved[2]
    )
    moved = np.where(meets, np.stack([of_polynomial, moved[0], 0.0 * moved[0]]), moved)
    of_cells = np.concatenate([rounded, _raised(errors + moved + _LEAST_ERROR)[:, None]], axis=1)
    is_used = np.arange(len(terms))[:, None] < np.array(RADIUS_FUNCTIONS)[kind]
    rows = np.moveaxis(of_cells, (0, 1, 2), (1, 2, 0))  # (cell, function, term)
    return kind, np.ascontiguousarray(rows[is_used.T].T)  # (term, row), cell after cell


def _raised(errors: Floats) -> NDArray[np.float32]:
    """Round errors up to a few digits, which float32 has and which take little room."""
    fraction, exponent = np.frexp(errors)
    raised = np.ldexp(np.ceil(np.ldexp(fraction, _DIGITS)), exponent - _DIGITS)
    return np.where(np.isfinite(errors), raised, np.inf).astype(np.float32)


ONE, LARGER, PAIR, CLUSTER = 1, 2, 3, 4


def radius_bounds(kind: NDArray[Any], values: Floats, errors: Floats) -> tuple[Floats, Floats]:
    """The lowest and the highest radius of points.

    ``kind`` is that of the cell of each point, ``values`` (3, point) those of its functions, and
    ``errors`` (2, point) bound the errors of the first two.
    """
    low, high = np.zeros(kind.size), np.full(kind.size, np.inf)
    below, above = values[:2] - errors, values[:2] + errors
    is_larger = kind == LARGER
    for number, known in ((0, (kind == ONE) | is_larger), (1, is_larger)):
        low = np.where(known, np.fmax(low, below[number]), low)
        high = np.where(known, above[number] if number == 0 else np.fmax(high, above[1]), high)
    for of_kind, bounds in ((PAIR, _of_pairs), (CLUSTER, _of_clusters)):
        some = np.flatnonzero(kind == of_kind)
        if some.size:
            of_some = [of_function[some] for of_function in values]
            found = bounds(of_some, errors[0, some])
            low[some], high[some] = found[0] - errors[1, some], found[1] + errors[1, some]
    return np.maximum(low - SURFACES, 0.0), high + SURFACES


def _of_pairs(functions: list[Floats], bound: Floats) -> tuple[Floats, Floats]:
    """Bound the larger |mean + w| of two w with |w^2 + constant| <= bound."""
    mean, constant, _ = functions
    half = np.sqrt(np.abs(constant))
    radius = np.where(constant > 0.0, np.hypot(mean, half), np.abs(mean) + half)
    distance, loss = 2.0 * half, bound + ROOTS
    with np.errstate(invalid="ignore"):
        alone = 2.0 * loss / (distance + np.sqrt(distance**2 - 4.0 * loss))
    reach = np.where(distance**2 > 4.0 * loss, alone, np.inf)
    farthest = np.sqrt(np.abs(constant) + loss)
    low, high = np.abs(mean) - farthest, np.abs(mean) + farthest
    return np.maximum(radius - reach, low), np.minimum(radius + reach, high)


def _of_clusters(functions: list[Floats], bound: Floats) -> tuple[Floats, Floats]:
    """Bound the largest |mean + w| of three w with |w^3 + slope w + constant| <= bound."""
    mean, slope, constant = functions
    roots = _cubic_roots(slope, constant)
    one, two, three = roots
    products = one * two + one * three + two * three, one * two * three
    size = np.abs(roots).max(axis=0) + 5.0 * np.cbrt(bound)
    residual = np.abs(one + two + three) * size**2 + np.abs(products[0] - slope) * size
    loss = bound + residual + np.abs(products[1] + constant) + ROOTS
    farthest = _farthest(np.abs(slope), np.abs(constant) + bound + ROOTS)
    lowest, highest = np.abs(mean) - farthest, np.abs(mean) + farthest
    low, high = lowest, np.zeros(mean.size)
    for first, second, third in ((one, two, three), (two, one, three), (three, one, two)):
        near, far = np.sort([np.abs(first - second), np.abs(first - third)], axis=0)
        reach = _component(near, far, loss)
        radius = np.abs(mean + first)
        low, high = np.maximum(low, radius - reach), np.maximum(high, radius + reach)
    return low, np.minimum(high, highest)


def _farthest(slope: Floats, constant: Floats) -> Floats:
    """Bound s with s^3 <= slope s + constant, by Newton's method from above."""
    size = np.maximum(np.sqrt(2.0 * slope), np.cbrt(2.0 * constant))
    for _ in range(3):
        size = (2.0 * size**3 + constant) / (3.0 * size**2 - slope)
    return size * (1.0 + 1e-12)


def _component(near: Floats, far: Floats, loss: Floats) -> Floats:
    """Bound the distance of a root of a cubic in its component of |cubic| <= loss, loss > 0.

    ``near`` and ``far`` are the distances to the other two roots.
    """
    with np.errstate(all="ignore"):
        alone = 1.2 * loss / (near * far)
        is_alone = (alone < near) & (alone * (near - alone) * (far - alone) > loss)
        with_one = 0.5 * near + np.sqrt(0.25 * near**2 + 1.5 * loss / far)
        is_apart = (with_one < far) & (with_one * (with_one - near) * (far - with_one) > loss)
    return np.where(is_alone, alone, np.where(is_apart, with_one, np.inf))


def _cubic_roots(slope: Floats, constant: Floats) -> NDArray[np.complex128]:
    """Return the roots of w^3 + slope w + constant, good to about a rounding of the largest."""
    third, half = slope / 3.0, 0.5 * constant
    inside = half**2 + third**3
    sign = np.where(half > 0.0, -1.0, 1.0)
    first = sign * np.cbrt(np.abs(half) + np.sqrt(np.maximum(inside, 0.0)))
    second = -third / np.where(first == 0.0, 1.0, first)
    real = first + second
    pair = -0.5 * real + 0.5j * np.sqrt(3.0) * (first - second)
    radius = np.sqrt(np.maximum(-third, 0.0))
    cosine = -half / np.where(radius == 0.0, 1.0, radius) ** 3
    angle = np.arccos(np.clip(cosine, -1.0, 1.0)) / 3.0
    turned = [2.0 * radius * np.cos(angle - 2.0 * np.pi * k / 3.0) for k in range(3)]
    is_real = inside < 0.0
    alone = (real, pair, pair.conj())
    return np.stack([np.where(is_real, a, b) for a, b in zip(turned, alone, strict=True)])


_AXES = 5
_FIRST, _SECOND = np.triu_indices(_AXES)


class RadiusTable:
    """Spectral radii of an atlas (its ``arrays``) at any point."""

    def __init__(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        kinds, terms = arrays[RADIUS_KIND], arrays[RADIUS_TERMS]
        self._counts = kinds.shape
        self._kinds = np.moveaxis(kinds, -1, 0).reshape(-1).astype(np.int8)
        functions = np.array(RADIUS_FUNCTIONS)[self._kinds]
        self._rows = np.cumsum(functions, dtype=np.int64) - functions
        self._terms = np.ascontiguousarray(terms.T)
        self._ends = arrays[RADIUS_RANGE]
        hands = (arrays[name] for name in ("gamma", "delta"))
        self._hands = [(float(nodes[0]), float(nodes[-1])) for nodes in hands]

    def bounds(self, points: list[Floats]) -> tuple[Floats, Floats]:
        """The lowest and highest radius at points with gamma, delta inside; 0, inf if unknown."""
        low, high = in_parts(self._bounds, points, float, float)
        return low, high

    def _bounds(self, *points: Floats) -> tuple[Floats, Floats]:
        number = np.searchsorted(self._ends[:, 0], points[-1], side="right") - 1
        ends = self._ends[number].T
        inside = points[-1] <= ends[1]
        cell = number
        beside = np.empty((_AXES, number.size))
        for axis, values in enumerate(points[:-1]):
            walls = ends[2 + 2 * axis : 4 + 2 * axis]
            lowest, highest = walls if axis < 2 else self._hands[axis - 2]
            inside &= (values >= lowest) & (values <= highest)
            count = self._counts[axis]
            width = np.asarray((highest - lowest) / count)
            with np.errstate(all="ignore"):
                part = np.where(width > 0.0, (values - lowest) / width, 0.5)
            along = np.clip(np.nan_to_num(part), 0, count - 1).astype(np.intp)
            beside[axis] = 2.0 * (part - along) - 1.0
            cell = cell * count + along
        middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
        beside[-1] = (points[-1] - middle) / np.where(half > 0.0, half, 1.0)
        beside[:, ~inside] = 0.0  # far outside it would overflow
        low, high = self._of_cells(cell, beside)
        return np.where(inside, low, 0.0), np.where(inside, high, np.inf)

    def _of_cells(self, cell: Integers, beside: Floats) -> tuple[Floats, Floats]:
        kind, first = self._kinds[cell], self._rows[cell]
        functions = np.array(RADIUS_FUNCTIONS)[kind]
        powers = np.concatenate(
            [np.ones((1, cell.size)), beside, beside[_FIRST] * beside[_SECOND]]
        ).T
        values, errors = np.zeros((3, cell.size)), np.zeros((2, cell.size))
        for number in range(3):
            has = np.flatnonzero(functions > number)
            terms = self._terms[first[has] + number]
            values[number, has] = np.einsum("pt,pt->p", terms[:, :-1], powers[has])
            if number < 2:
                errors[number, has] = terms[:, -1]
        return radius_bounds(kind, values, errors)
