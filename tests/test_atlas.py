"""An atlas answers what was computed at a node, what is proved between nodes, and nothing else."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from atlases import SMALL, small_atlas, write_small

from benchmarks import truth
from jaxstab import Atlas, AtlasSpec, FittedAxis, Verdict, build_atlas, open_atlas
from jaxstab.atlas.plan import Grid, lay_out
from jaxstab.conventions import AXES
from jaxstab.results import QueryStatus

TRIANGLE = AtlasSpec(
    alpha=FittedAxis(16),
    beta=FittedAxis(12),
    gamma=[9.859, 9.86],
    delta=[0.99, 1.0],
    delay=[0.0],
)
"""Next to the resonant case of the paper's sec. VIII, whose stable region is a triangle."""


@pytest.fixture(scope="module")
def atlas() -> Atlas:
    return small_atlas()


def random_points(
    atlas: Atlas, delay_number: int, count: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    nodes = atlas.nodes(delay_number)
    return {name: rng.uniform(axis[0], axis[-1], count) for name, axis in nodes.items()}


def node_points(
    atlas: Atlas, delay_number: int, count: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    return {name: rng.choice(axis, count) for name, axis in atlas.nodes(delay_number).items()}


def true_verdict(point: tuple[float, ...]) -> int | None:
    unstable = truth.unstable_count(*point)
    return unstable if unstable is None else (Verdict.UNSTABLE if unstable else Verdict.STABLE)


# --------------------------------------------------------------------------------------------- axes


@pytest.fixture(scope="module")
def grid() -> Grid:
    return lay_out(AtlasSpec(alpha=FittedAxis(40), beta=FittedAxis(40), delay_cells=0))


@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_the_fitted_axes_hold_the_stable_region_of_each_delay_closely(
    number: int, grid: Grid
) -> None:
    """Against the closed-form extent of the region without damping, and random search outside."""
    largest = [12 - 8 * 2**0.5, 0.14447, 0.06243, 0.03478][number]
    alpha, beta = grid.alpha[:, number], grid.beta[:, number]
    assert 1.02 * largest < alpha[-1] < 1.25 * largest
    assert alpha[0] < -0.001
    assert np.all(np.diff(alpha) > 0)
    thetas = np.linspace(0.001, 3.14, 120)
    for gamma, delta in ((0.0, 0.0), (0.001, 0.015)):
        edge = [truth.boundary_point(t, gamma, delta, float(number)) for t in thetas]
        inside = [
            (float(a), float(b))
            for a, b in edge
            if truth.unstable_count(float(a) * 0.999 + 1e-6, float(b), gamma, delta, number) == 0
        ]
        assert inside
        assert all(alpha[0] < a < alpha[-1] and beta[0] < b < beta[-1] for a, b in inside)


def test_axes_can_be_given(tmp_path: Path) -> None:
    spec = AtlasSpec(
        alpha=[0.0, 0.1, 0.5],
        beta=[0.2, 0.4],
        gamma=[0, 0.001],
        delta=[0, 0.1],
        delay=[0],
        products=["verdict"],
    )
    atlas = build_atlas(spec, tmp_path / "given.h5")
    assert {name: nodes.tolist() for name, nodes in atlas.nodes(0).items()} == {
        "alpha": [0.0, 0.1, 0.5],
        "beta": [0.2, 0.4],
        "gamma": [0.0, 0.001],
        "delta": [0.0, 0.1],
    }
    assert AtlasSpec.from_toml(atlas.spec) == spec


# ---------------------------------------------------------------------------------------- honesty


@pytest.mark.parametrize("number", [0, 1])
def test_no_answer_between_nodes_is_wrong(
    atlas: Atlas, number: int, rng: np.random.Generator
) -> None:
    points = random_points(atlas, number, 400, rng)
    delay = float(atlas.delays[number])
    answer = atlas.query(**points, delay=delay)
    decided = answer.verdict != Verdict.UNDECIDED
    assert decided.mean() > 0.5
    assert abs(decided.mean() - atlas.decided_fraction(number)) < 0.1
    assert set(answer.verdict[decided]) == {Verdict.STABLE, Verdict.UNSTABLE}
    for index in np.flatnonzero(decided):
        point = tuple(float(points[name][index]) for name in points)
        assert answer.verdict[index] == true_verdict((*point, delay))
    np.testing.assert_array_equal(
        answer.status, np.where(decided, QueryStatus.CELL, QueryStatus.UNDECIDED_CELL)
    )


@pytest.mark.parametrize("number", [0, 1])
def test_a_node_answers_what_is_true_there(
    atlas: Atlas, number: int, rng: np.random.Generator
) -> None:
    points = node_points(atlas, number, 60, rng)
    delay = float(atlas.delays[number])
    answer = atlas.query(**points, delay=delay)
    assert set(answer.status) == {QueryStatus.NODE}
    for index, point in enumerate(zip(*points.values(), strict=True)):
        exact = tuple(map(float, point))
        if answer.verdict[index] != Verdict.UNDECIDED:
            assert answer.verdict[index] == true_verdict((*exact, delay))


@pytest.mark.campaign
def test_the_resonant_case_is_honest_too(tmp_path: Path, rng: np.random.Generator) -> None:
    atlas = build_atlas(TRIANGLE, tmp_path / "triangle.h5")
    points = random_points(atlas, 0, 200, rng)
    verdict = atlas.query(**points, delay=0.0).verdict
    assert {Verdict.STABLE, Verdict.UNSTABLE} < set(verdict)
    for index in np.flatnonzero(verdict != Verdict.UNDECIDED):
        point = tuple(float(points[name][index]) for name in points)
        assert verdict[index] == true_verdict((*point, 0.0))


# --------------------------------------------------------------------------------------- the border


def inner_point(atlas: Atlas) -> dict[str, Any]:
    return {name: float(axis[len(axis) // 2]) for name, axis in atlas.nodes(0).items()} | {
        "delay": 0.0
    }


@pytest.mark.parametrize("name", AXES)
def test_a_point_outside_is_refused_by_name_value_and_range_or_undecided(
    name: str, atlas: Atlas
) -> None:
    point = inner_point(atlas) | {name: 1e3}
    if name in ("alpha", "beta"):  # beyond axes that hold the whole stable set
        assert atlas.query(**point).verdict == Verdict.UNSTABLE
        return
    with pytest.raises(ValueError, match=rf"^{name} is 1000\.0, and this atlas covers .* to"):
        atlas.query(**point)
    answer = atlas.query(**point, outside="undecided")
    assert answer.verdict == Verdict.UNDECIDED
    assert answer.status == QueryStatus.OUTSIDE


@pytest.mark.parametrize("name", AXES)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_by_name_even_where_outside_is_allowed(
    value: float, name: str, atlas: Atlas
) -> None:
    with pytest.raises(ValueError, match=f"^{name} is {value}; allowed are finite values"):
        atlas.query(**(inner_point(atlas) | {name: value}), outside="undecided")


@pytest.mark.parametrize("name", AXES)
def test_the_ends_of_an_axis_belong_to_the_atlas(name: str, atlas: Atlas) -> None:
    axis = atlas.nodes(0)[name] if name != "delay" else atlas.delays
    ends = axis if name == "delay" else axis[[0, -1]]
    point = inner_point(atlas) | {name: ends}
    if name == "delay":
        point |= {"alpha": float(atlas.nodes(1)["alpha"][3]), "beta": 0.1}
    assert QueryStatus.OUTSIDE not in atlas.query(**point).status
    beyond = [np.nextafter(ends[0], -np.inf), np.nextafter(ends[-1], np.inf)]
    answer = atlas.query(**(point | {name: beyond}), outside="undecided")
    if name in ("alpha", "beta"):  # these axes hold the whole stable set
        assert set(answer.verdict) == {Verdict.UNSTABLE}
    else:
        assert set(answer.status) == {QueryStatus.OUTSIDE}


def test_between_two_delays_the_atlas_says_nothing(atlas: Atlas) -> None:
    answer = atlas.query(**(inner_point(atlas) | {"delay": 0.75}))
    assert answer.verdict == Verdict.UNDECIDED
    assert answer.status == QueryStatus.BETWEEN_DELAYS


def test_text_is_no_number(atlas: Atlas) -> None:
    with pytest.raises(TypeError, match="beta"):
        atlas.query(**(inner_point(atlas) | {"beta": "much"}))


def test_queries_broadcast_and_may_be_empty(atlas: Atlas) -> None:
    nodes = atlas.nodes(0)
    answer = atlas.query(nodes["alpha"], nodes["beta"][:, None], gamma=0.0, delta=0.005, delay=0.0)
    assert answer.verdict.shape == answer.status.shape == (20, 24)
    assert answer.verdict.dtype == answer.status.dtype == np.int8
    assert atlas.query([], 0.1, gamma=0.0, delta=0.0, delay=[0.0]).verdict.shape == (0,)
    assert all(status.words for status in QueryStatus)


# ----------------------------------------------------------------------------------------- building


@pytest.mark.parametrize("product", ["verdict", "fields"])
def test_only_the_chosen_product_is_there(product: str, tmp_path: Path) -> None:
    spec = AtlasSpec.from_toml(f"products = ['{product}']\n" + SMALL_WITHOUT_PRODUCTS)
    atlas = build_atlas(spec, tmp_path / "one.h5")
    assert atlas.products == (product,)
    answer = atlas.query(**inner_point(atlas))
    assert (answer.verdict == Verdict.NOT_COMPUTED) == (product == "fields")


SMALL_WITHOUT_PRODUCTS = "".join(
    line for line in SMALL.to_toml().splitlines(keepends=True) if "products" not in line
)


@pytest.mark.campaign
def test_progress_is_told_from_none_to_all(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    build_atlas(SMALL, tmp_path / "a.h5", lambda done, total: told.append((done, total)))
    totals = {total for _, total in told}
    assert len(totals) == 1
    assert [done for done, _ in told] == list(range(totals.pop() + 1))


def test_an_answer_needs_no_jax(tmp_path: Path) -> None:
    script = (
        "import sys\n"
        "for name in ('jax', 'jaxlib', 'jaxtyping', 'equinox', 'optimistix', 'rich'):\n"
        "    sys.modules[name] = None\n"
        "import jaxstab\n"
        "atlas = jaxstab.open_atlas(sys.argv[1])\n"
        "print(atlas.query(0.1, 0.5, gamma=0.0005, delta=0.01, delay=0.0).verdict)\n"
    )
    path = write_small(tmp_path)
    completed = subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=False
    )
    assert (completed.stdout, completed.stderr) == (f"{int(Verdict.STABLE)}\n", "")


def test_an_opened_atlas_cannot_be_changed(tmp_path: Path) -> None:
    atlas = open_atlas(write_small(tmp_path))
    with pytest.raises(ValueError, match="read-only"):
        atlas.arrays["verdict"][0] = Verdict.STABLE
