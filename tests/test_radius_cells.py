"""The spectral radius over whole cells: proved intervals, against certified and computed roots."""

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks import truth
from jaxstab import AtlasSpec, FittedAxis, build_atlas, spectral_radius
from jaxstab.atlas.products.radii import radius_bounds
from jaxstab.model import by_name, characteristic_polynomial
from jaxstab.model.filters import Velocity, as_keywords, known_filters
from jaxstab.proofs.enclosures import FIRST, SECOND, VARIABLES, Quadratic
from jaxstab.proofs.plant import HandBoxes
from jaxstab.proofs.radius_cells import (
    RadiusSurfaces,
    SurfaceKind,
    WallBoxes,
    cell_polynomial,
    radius_surfaces,
)
from jaxstab.results import QueryStatus

Floats = NDArray[np.float64]

CELLS, POINTS = 300, 4
RANGES = {  # alpha, beta, gamma, delta, and the widths of cells along these and the delay
    "free": ((0.0, 0.7), (0.0, 2.0), (0.0, 1e-3), (0.0, 0.015), (0.03, 0.03, 1e-3, 4e-3, 1 / 16)),
    "slow": ((0.0, 0.05), (0.0, 0.4), (0.0, 1e-3), (0.0, 0.015), (2e-3, 7e-3, 1e-3, 4e-3, 1 / 16)),
    "stiff": ((-2.0, 1.0), (-0.5, 1.0), (2.0, 5.0), (0.1, 0.6), (0.05, 0.03, 0.02, 0.02, 1 / 32)),
}


def monomials(x: Floats) -> Floats:
    return np.concatenate([np.ones((1, x.shape[1])), x, x[FIRST] * x[SECOND]])


def random_quadratic(rng: np.random.Generator, cells: int) -> Quadratic:
    terms = rng.normal(size=(1 + VARIABLES + FIRST.size, cells)) * 0.1
    terms[0] += 3.0
    return Quadratic(terms, rng.uniform(0.0, 0.01, cells))


def test_sums_products_and_roots_of_quadratics_enclose(rng: np.random.Generator) -> None:
    one, two = random_quadratic(rng, 200), random_quadratic(rng, 200)
    results = one + two, one - two, one * two, one.root(), one.times(two.middle)
    for _ in range(50):
        x = rng.choice([-1.0, 1.0, 0.3, -0.7], (VARIABLES, 200))
        f, g = (
            np.sum(q.terms * monomials(x), axis=0) + q.rest * rng.choice([-1.0, 1.0], 200)
            for q in (one, two)
        )
        exact = f + g, f - g, f * g, np.sqrt(f), f * two.middle
        for result, value in zip(results, exact, strict=True):
            middle = np.sum(result.terms * monomials(x), axis=0)
            assert np.all(np.abs(value - middle) <= result.rest)


def drawn(
    rng: np.random.Generator, name: str, cells: int = CELLS
) -> tuple[WallBoxes, HandBoxes, tuple[float, ...]]:
    *ends, widths = RANGES[name]
    halves = [0.5 * width for width in widths]
    middles = [
        rng.uniform(low + min(half, 0.5 * (high - low)), max(high - half, low + half), cells)
        for (low, high), half in zip(ends, halves, strict=False)
    ]
    full = [np.full(cells, half) for half in halves[:4]]
    return WallBoxes(*middles[:2], *full[:2]), HandBoxes(*middles[2:], *full[2:]), widths


def inside(
    walls: WallBoxes, hands: HandBoxes, delay: float, half: float, x: Floats
) -> tuple[Floats, ...]:
    """Return alpha, beta, gamma, delta and delay of a point of each cell."""
    middles = walls.alpha, walls.beta, hands.gamma, hands.delta, np.full(x.shape[1], delay)
    halves = *walls[2:], *hands[2:], np.full(x.shape[1], half)
    return tuple(m + h * part for m, h, part in zip(middles, halves, x, strict=True))


def bounds_of(known: RadiusSurfaces, x: Floats) -> tuple[Floats, Floats]:
    values = np.sum(known.terms * monomials(x), axis=1)
    low, high = radius_bounds(known.kind, values, known.error)
    is_known = known.kind != SurfaceKind.NONE
    return np.where(is_known, low, 0.0), np.where(is_known, high, np.inf)


@pytest.mark.parametrize("name", RANGES)
@pytest.mark.parametrize("whole", [0, 1, 2])
def test_the_polynomial_of_a_cell_encloses_its_coefficients(
    name: str, whole: int, rng: np.random.Generator
) -> None:
    walls, hands, widths = drawn(rng, name, 12)
    half = 0.5 * widths[-1]
    for delay in (whole + half, whole + 0.4, whole + 1.0 - half):
        p = cell_polynomial(walls, hands, delay, half)
        rows = p.coefficients()
        x = rng.choice([-1.0, 1.0, 0.2, -0.6], (VARIABLES, 12))
        points = inside(walls, hands, delay, half, x)
        for cell in range(12):
            point = [float(part[cell]) for part in points]
            point[-1] = min(max(point[-1], whole), whole + 1.0 - 1e-12)
            exact = [float(c) for c in truth.polynomial(*point)]
            exact += [0.0] * (len(rows) - len(exact))  # without the fraction's root at 0
            for row, value in zip(rows, exact, strict=True):
                middle = float(row.terms[:, cell] @ monomials(x)[:, cell])
                assert abs(value - middle) <= row.rest[cell] + 1e-11


@pytest.mark.parametrize("name", RANGES)
@pytest.mark.parametrize("whole", [0, 1, 2, 5])
def test_the_radius_of_a_cell_is_enclosed_at_its_points(
    name: str, whole: int, rng: np.random.Generator
) -> None:
    half = 0.5 * RANGES[name][-1][-1]
    widths, found = [], set()
    for delay in (whole + half, whole + 1.0 - half):
        walls, hands, _ = drawn(rng, name)
        known = radius_surfaces(walls, hands, delay, half)
        found |= set(known.kind.tolist())
        for _ in range(POINTS):
            x = rng.choice([-1.0, 1.0, 0.31], (VARIABLES, CELLS))
            low, high = bounds_of(known, x)
            *point, delays = inside(walls, hands, delay, half, x)
            for d in np.unique(delays):
                some = np.flatnonzero(delays == d)
                radius = computed([part[some] for part in point], float(d))
                assert np.all((low[some] <= radius + 1e-7) & (radius <= high[some] + 1e-7))
            for k in range(2):
                least, most = truth.spectral_radius(*(float(p[k]) for p in (*point, delays)))
                assert low[k] <= float(most)
                assert float(least) <= high[k]
            widths.append(high - low)
    assert np.quantile(np.concatenate(widths), 0.5) < 0.01
    assert found > {SurfaceKind.ONE} or whole > 1


def computed(walls_and_hands: list[Floats], delay: float, **filters: Any) -> Floats:
    """Return radii by NumPy's eigenvalues."""
    alpha, beta, gamma, delta = walls_and_hands
    rows = np.asarray(
        characteristic_polynomial(alpha, beta, gamma=gamma, delta=delta, delay=delay, **filters)
    )
    matrices = np.zeros((len(rows), rows.shape[1] - 1, rows.shape[1] - 1))
    matrices[:, 0] = -rows[:, 1:]
    matrices[:, range(1, matrices.shape[1]), range(matrices.shape[1] - 1)] = 1.0
    radius: Floats = np.abs(np.linalg.eigvals(matrices)).max(axis=1)
    return radius


def test_where_three_roots_meet_they_stay_together() -> None:
    r = 4 ** (1 / 3) - 1  # a triple root at delay 0
    one = np.ones(1)
    walls = WallBoxes((6 * r**2 - 2) * one, 2 * r**3 * one, 1e-3 * one, 1e-3 * one)
    known = radius_surfaces(walls, HandBoxes(*np.zeros((4, 1))), 0.0, 0.0)
    assert known.kind.tolist() == [SurfaceKind.CLUSTER]
    low, high = bounds_of(known, np.zeros((VARIABLES, 1)))
    assert low[0] <= r <= high[0]
    assert high[0] - low[0] < 0.05


@pytest.mark.parametrize("window", [3, 8])
def test_loops_with_filters_are_enclosed(window: int, rng: np.random.Generator) -> None:
    filters = known_filters(Velocity.difference(window), None)
    cells, delay = 100, 1.5
    walls = WallBoxes(
        rng.uniform(0.0, 0.02, cells), rng.uniform(0.0, 0.2, cells), *np.full((2, cells), 1e-4)
    )
    hands = HandBoxes(*np.tile([[5e-4], [0.01], [1e-4], [1e-4]], cells))
    known = radius_surfaces(walls, hands, delay, 0.0, filters)
    widths = []
    for corner in product((-1.0, 0.5), repeat=2):
        x = np.zeros((VARIABLES, cells))
        x[:2] = np.array(corner)[:, None]
        low, high = bounds_of(known, x)
        point = inside(walls, hands, delay, 0.0, x)
        radius = computed(list(point[:4]), delay, **as_keywords(filters))
        assert np.all((low <= radius + 1e-7) & (radius <= high + 1e-7))
        widths.append(high - low)
    assert np.median(np.concatenate(widths)) < 0.05


def test_pairs_and_clusters_are_bounded_by_their_polynomials(rng: np.random.Generator) -> None:
    count = 4000
    size = 10.0 ** rng.uniform(-9, -2, count)
    bound = size * 10.0 ** rng.uniform(-6, 0, count)
    mean = rng.uniform(-1.0, 1.0, count)
    for kind, degree in ((SurfaceKind.PAIR, 2), (SurfaceKind.CLUSTER, 3)):
        slope = rng.normal(size=count) * size ** (2 / 3) * (degree == 3)
        constant = rng.normal(size=count) * size
        values = np.stack([mean, constant if degree == 2 else slope, constant])
        errors = np.stack([bound, np.zeros(count)])
        low, high = radius_bounds(np.full(count, kind), values, errors)
        for share in (0.0, 0.999, -0.999):
            for k in range(0, count, 8):
                moved = share * bound[k]
                row = [1.0, 0.0, constant[k] + moved]
                if degree == 3:
                    row = [1.0, 0.0, slope[k], constant[k] + moved]
                w = np.roots(row)
                radius = np.max(np.abs(mean[k] + w))
                assert low[k] - 1e-7 <= radius <= high[k] + 1e-7


def test_roots_that_meet_are_bounded_as_closely_as_they_move() -> None:
    bound = 1e-6
    rows = {  # m, then Q; or P and Q: a pair that meets, three, and a pair beside a single root
        SurfaceKind.PAIR: [([0.5, 0.0, 0.0], bound**0.5)],
        SurfaceKind.CLUSTER: [([0.5, 0.0, 0.0], bound ** (1 / 3)), ([0.5, -0.75, 0.25], 2e-3)],
    }
    for kind, cases in rows.items():
        for values, reach in cases:
            functions, errors = np.array(values)[:, None], np.array([[bound], [0.0]])
            low, high = radius_bounds(np.array([kind]), functions, errors)
            degree = 2 if kind == SurfaceKind.PAIR else 3
            for turn in np.exp(2j * np.pi * np.arange(12) / 12):  # any root of |f| <= bound
                row = [1.0, 0.0, *values[1:degree]]
                row[-1] += 0.999 * bound * turn
                radius = np.max(np.abs(values[0] + np.roots(row)))
                assert low[0] <= radius <= high[0]
            assert high[0] - low[0] <= 2.02 * reach


@pytest.mark.campaign
def test_radii_between_delays_are_within_their_bounds(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    spec = AtlasSpec(
        alpha=FittedAxis(64),
        beta=FittedAxis(56),
        gamma=(0.0, 0.0005),
        delta=(0.005, 0.01),
        delay=(0.5, 1.5),
        products=("spectral_radius",),
        delay_cells=12,
    )
    atlas = build_atlas(spec, tmp_path / "delays.h5")
    cells, errors = atlas.arrays["radius_range"], []
    for delay in (*rng.uniform(0.5, 1.5, 4), 0.5, 1.0, float(cells[3, 0])):
        ends = cells[np.searchsorted(cells[:, 0], delay, side="right") - 1]
        low, high = ends[2::2], ends[3::2]
        walls = low[:, None] + (high - low)[:, None] * rng.random((2, 300))
        along = np.linspace(low[0], high[0], atlas.arrays["radius_kind"].shape[0] + 1)
        walls[0, ::3] = rng.choice(along[1:-1], 100)  # on faces of cells
        points = (*walls, *rng.uniform([[0.0], [0.005]], [[0.0005], [0.01]], (2, 300)), delay)
        answer = atlas.query(**by_name(*points), outside="undecided")
        exact = spectral_radius(**by_name(*points))
        off = np.abs(answer.spectral_radius - exact.value) - exact.error
        assert np.all((off <= answer.radius_error) | (answer.status == QueryStatus.OUTSIDE))
        for index in range(3):
            lower, upper = truth.spectral_radius(*(float(p[index]) for p in points[:-1]), delay)
            error = answer.radius_error[index]
            assert lower - error <= answer.spectral_radius[index] <= upper + error
        errors.append(answer.radius_error[exact.value < 1.0])
    assert np.median(np.concatenate(errors)) < 3e-3


@pytest.mark.campaign
@pytest.mark.parametrize("first", [0.0, 1.0, 2.0, 2.875])
def test_radii_of_the_default_atlas_keep_what_is_promised(
    first: float, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Cells as in the default atlas, of an eighth of a sample: the whole one takes minutes."""
    atlas = build_atlas(AtlasSpec(delay=(first, first + 0.125)), tmp_path / "part.h5")
    ends, errors = atlas.arrays["limit_range"], []
    for delay in (first, *rng.uniform(first, first + 0.125, 5)):
        low, high = ends[np.searchsorted(ends[:, 0], delay, side="right") - 1, 2:].reshape(2, 2).T
        walls = rng.uniform(low[:, None], high[:, None], (2, 5000))
        hands = rng.uniform(0.0, [[1e-3], [0.015]], (2, 5000))
        answer = atlas.query(**by_name(*walls, *hands, delay))
        exact = spectral_radius(**by_name(*walls, *hands, delay))
        off = np.abs(answer.spectral_radius - exact.value) - exact.error
        assert np.all(off <= answer.radius_error)
        errors.append(answer.radius_error[exact.value < 1.0])
    assert np.median(np.concatenate(errors)) < 3e-4
    assert np.quantile(np.concatenate(errors), 0.99) < 2e-2
