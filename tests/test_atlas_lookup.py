"""How an atlas answers for many points: in parts, by cells of delays, by the limit that decides."""

import numpy as np
import pytest
from atlases import moving_atlas, small_atlas

from jaxstab import Atlas
from jaxstab.atlas.lookup import DelayCells, LimitTable, in_blocks
from jaxstab.model import by_name


@pytest.fixture(scope="module", params=[small_atlas, moving_atlas])
def atlas(request: pytest.FixtureRequest) -> Atlas:
    return request.param()


def table_of(atlas: Atlas) -> LimitTable:
    names = ("alpha_limits", "limit_range", "limit_whole", "gamma", "delta")
    terms, ends, whole, gamma, delta = (atlas.arrays[name] for name in names)
    return LimitTable(terms, ends, whole, gamma=gamma, delta=delta)


def points_in_cells(atlas: Atlas, count: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Points of all cells of delays; a third each next to a limit and on faces of columns."""
    early, late, *walls = rng.choice(atlas.arrays["limit_range"], count).T
    delay = rng.uniform(early, late)
    beta = rng.uniform(*walls[2:])
    faces = np.round((beta - walls[2]) / (walls[3] - walls[2]) * 96) / 96
    beta = np.where(rng.random(count) < 1 / 3, walls[2] + faces * (walls[3] - walls[2]), beta)
    beta = np.clip(beta, *walls[2:])
    gamma, delta = rng.uniform(0.0, 0.001, count), rng.choice([0.0, 0.003, 0.005, 0.015], count)
    at = atlas.alpha_limits(beta, gamma=gamma, delta=delta, delay=delay)
    with np.errstate(invalid="ignore"):
        ends = np.array([at.lower, at.upper]) + rng.choice([-1, 1], count) * [
            at.lower_error,
            at.upper_error,
        ]
    beside = np.nextafter(rng.permuted(ends, axis=0)[0], rng.choice([-1.0, 1.0], count))
    is_beside = np.isfinite(beside) & (rng.random(count) < 1 / 3)
    alpha = np.where(is_beside, beside, rng.uniform(*walls[:2]))
    return [np.clip(alpha, *walls[:2]), beta, gamma, delta, delay]


def test_many_points_are_answered_as_one_by_one(atlas: Atlas, rng: np.random.Generator) -> None:
    points = points_in_cells(atlas, 150_000, rng)  # more than a part, and than there are columns
    many = atlas.verdict(**by_name(*points))
    some = rng.choice(many.size, 3000, replace=False)
    for index in some.tolist():
        point = (float(values[index]) for values in points)
        assert atlas.verdict(**by_name(*point)) == many[index]
    few = [values[some[:500]] for values in points]  # fewer than there are columns
    np.testing.assert_array_equal(atlas.verdict(**by_name(*few)), many[some[:500]])


def test_a_plant_that_many_share_is_answered_as_any(atlas: Atlas, rng: np.random.Generator) -> None:
    alpha, beta, *plant = (values[:20_000] for values in points_in_cells(atlas, 20_000, rng))
    nodes = atlas.nodes(0)
    alpha, beta = (rng.uniform(*nodes[name][[0, -1]], 20_000) for name in ("alpha", "beta"))
    shared = float(plant[0][0]), float(plant[1][0]), float(atlas.delays[0])
    codes = atlas.verdict(**by_name(alpha, beta, *shared))
    each = (np.full(20_000, value) for value in shared)
    np.testing.assert_array_equal(codes, atlas.verdict(**by_name(alpha, beta, *each)))
    one_wall = atlas.verdict(**by_name(alpha[0], beta[0], np.full(20_000, shared[0]), *shared[1:]))
    np.testing.assert_array_equal(one_wall, codes[0])


def test_one_limit_decides_only_where_the_other_cannot(
    atlas: Atlas, rng: np.random.Generator
) -> None:
    table = table_of(atlas)
    _, beta, *plant = points = points_in_cells(atlas, 100_000, rng)
    cell = table.delays.cells_at(points[-1])
    deciding = table._deciding[table._rows_of(cell, beta, *plant[:2])]
    at = table.limits(beta, *plant)
    above, below = deciding.T
    holds = at.lower < np.inf  # others are unstable by the lower limit, whatever alpha
    with np.errstate(invalid="ignore"):
        assert not np.any(above[holds] < (at.lower + at.lower_error)[holds])
        assert not np.any(below[holds] > (at.upper - at.upper_error)[holds])
    assert np.mean(above[holds] < below[holds]) > 0.7
    assert np.all(below[~holds] == np.inf)


@pytest.mark.parametrize(
    "edges",
    [
        [0.0, 3.0],
        [0.0, 0.0155, 0.0315, 1.0, 1.0458, 2.0],
        [0.3, 0.3 + 1e-9, 2.0, 2.5],  # so short that cells are searched for
        [2.0, *np.nextafter(2.0, 3.0, dtype=float) + np.array([0.0, 1.0, 2.0])],
    ],
)
def test_a_delay_is_in_the_last_cell_that_begins_before(
    edges: list[float], rng: np.random.Generator
) -> None:
    walls = np.tile([0.0, 1.0, 0.0, 1.0], (len(edges) - 1, 1))
    cells = DelayCells(
        np.column_stack([edges[:-1], edges[1:], walls]), np.zeros(len(walls), np.int32)
    )
    beside = [np.nextafter(edges, side) for side in (-np.inf, np.inf)]
    inside = rng.uniform(edges[0], edges[-1], 10_000)
    delays = np.concatenate([edges, *beside, inside, [-1.0, 0.0, 1e9]])
    expected = [sum(begin <= delay for begin in edges[:-1]) - 1 for delay in delays.tolist()]
    np.testing.assert_array_equal(cells.cells_at(delays), expected)
    assert [cells.cell_at(delay) for delay in delays.tolist()] == expected
    reached = (delays >= edges[0]) & (delays <= edges[-1])
    np.testing.assert_array_equal(cells.covers(delays), reached)


def test_between_cells_of_single_delays_there_is_nothing() -> None:
    ends = np.array([[d, d, 0.0, 1.0, 0.0, 1.0] for d in (0.0, 1.0, 3.0)])
    covered = DelayCells(ends, np.zeros(3, np.int32)).covers(
        np.array([0.0, 0.5, 1.0, 2.999, 3.0, 3.1])
    )
    assert covered.tolist() == [True, False, True, False, True, False]


@pytest.mark.parametrize("dtype", [np.float32, np.int16, np.uint64, ">f8", np.longdouble])
def test_parts_are_of_floats_and_of_bounded_length(dtype: str) -> None:
    sizes = []

    def halved_sum(one: np.ndarray, other: np.ndarray) -> list[np.ndarray]:
        assert one.dtype == other.dtype == np.float64
        sizes.append(one.size)
        return [0.5 * (one + other), one > other]

    one, other = np.arange(1000).astype(dtype)[:, None], np.arange(0, 600, 2).astype(dtype)
    half, is_more = in_blocks(halved_sum, [one, other.T[::-1]], np.float64, np.bool_)
    expected = one.astype(float), other[::-1].astype(float)
    np.testing.assert_array_equal(half, 0.5 * (expected[0] + expected[1]))
    np.testing.assert_array_equal(is_more, expected[0] > expected[1])
    assert sum(sizes) == 300_000
    assert max(sizes) <= 65_536
    empty, _ = in_blocks(halved_sum, [one[:0], other], np.float64, np.bool_)
    assert empty.shape == (0, 300)
