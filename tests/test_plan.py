"""What is not computed equals what dense computation gives, bit for bit; the plan says why."""

from itertools import product
from typing import NamedTuple

import flint
import numpy as np
import pytest
from atlases import SMALL, small_contents

from benchmarks import truth
from jaxstab import (
    STABLE,
    UNDECIDED,
    UNSTABLE,
    AtlasSpec,
    FittedAxis,
    QueryStatus,
    ToleranceAxis,
    build_atlas,
    characteristic_polynomial,
    plan_atlas,
    verdict,
)
from jaxstab.atlas.compute import products
from jaxstab.atlas.compute.blocks import CellSlice, prove_blocks
from jaxstab.atlas.compute.fill import Filling, Slice, plan_filling
from jaxstab.atlas.compute.products import compute_tile
from jaxstab.atlas.format import schema
from jaxstab.atlas.format.schema import VARIABLES

DELAYS = (0.0, 0.5, 1.0, 2.3, 5.0, 20.0, 41.7, 60.0)
SLICES = 12  # of each delay
LONGEST = 2**13
ONE_SLICE = {"gamma": [0.001], "delta": [0.015], "products": ["verdict"]}


class Box(NamedTuple):
    lowest: tuple[float, float]
    highest: tuple[float, float]


def random_box(rng: np.random.Generator, delay: float) -> Box:
    """Around the stable set, over all turns of the curve, or anywhere of any size."""
    scale = 1 / (1 + delay)
    kind = rng.integers(3)
    if kind == 0:
        return Box((-0.2 * scale**2, -0.2 * scale), (1.2 * scale**2, 2 * scale))
    if kind == 1:
        return Box((-4.0, -4.0), (4.0, 4.0))
    low = rng.uniform(-1, 1, 2) * 10 ** rng.uniform(-6, 2, 2)
    high = low + 10 ** rng.uniform(-6, 2, 2)
    return Box(tuple(low.tolist()), tuple(high.tolist()))


def random_axis(
    rng: np.random.Generator, low: float, high: float, count: int, special: float
) -> np.ndarray:
    """Even nodes, or uneven ones and one on a line of the boundary."""
    if rng.random() < 0.5:
        return np.linspace(low, high, count)
    return np.unique(np.append(rng.uniform(low, high, count), special))


def random_slice(rng: np.random.Generator, delay: float) -> Slice:
    gammas = [0.0, 1e-3, np.pi**2, 10 ** rng.uniform(-12, 2), rng.uniform(0, 12)]
    deltas = [0.0, 0.015, 10 ** rng.uniform(-12, 1), rng.uniform(0, 0.6)]
    gamma, delta = float(rng.choice(gammas)), float(rng.choice(deltas))
    (alpha_low, beta_low), (alpha_high, beta_high) = random_box(rng, delay)
    counts = rng.integers(1, 90, 2).tolist()
    alpha = random_axis(rng, alpha_low, alpha_high, counts[0], -gamma)
    beta = random_axis(rng, beta_low, beta_high, counts[1], 0.0)
    return Slice(alpha, beta, gamma, delta, delay)


def dense(of: Slice) -> np.ndarray:
    """Every node by a verdict of its own; all in lists of one length, compiled once."""
    alpha, beta = (gain.ravel() for gain in np.meshgrid(of.alpha, of.beta, indexing="ij"))
    listed = np.resize(alpha, LONGEST), np.resize(beta, LONGEST)
    codes = np.asarray(verdict(*listed, of.gamma, of.delta, of.delay, resolve="exact"))
    return codes[: alpha.size].reshape(of.shape)


# ------------------------------------------------------------------------------------------ filling


@pytest.mark.parametrize("delay", DELAYS)
def test_filled_slices_equal_dense_ones_bit_for_bit(
    delay: float, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    given_up = []
    monkeypatch.setattr(Slice, "dense", lambda of: given_up.append(of) or dense(of))
    for _ in range(SLICES):
        of = random_slice(rng, delay)
        filled = plan_filling(of).codes()
        assert filled.dtype == np.int8
        np.testing.assert_array_equal(filled, dense(of), err_msg=str(of[2:]))
    # Only where a root stays at -1 for all gains are there no samples to go by.
    assert all(of.gamma == np.pi**2 and of.delta == 0.0 for of in given_up)


@pytest.mark.parametrize("delay", [0.0, 2.0])
def test_a_curve_that_runs_to_infinity_leaves_vertices_for_its_way_past_coarse_grids(
    delay: float,
) -> None:
    """Without spring and damper N(-1) is 0, so the last step of the curve has no end."""
    for alphas, betas, top in product((6, 9, 14), (7, 8, 9, 14), (0.2, 0.4, 0.6)):
        nodes = np.linspace(-0.01, top, alphas), np.linspace(-0.0764743, 2.0779526, betas)
        of = Slice(*nodes, 0.0, 0.0, delay)
        filling = plan_filling(of)
        np.testing.assert_array_equal(filling.codes(), dense(of))
        assert filling.near.size < 3


@pytest.mark.parametrize("delay", [0.0, 3.0, 20.0, 59.5])
def test_a_filled_slice_has_the_roots_of_the_truth(delay: float, rng: np.random.Generator) -> None:
    gamma, delta, scale = 1e-3, 0.015, 1 / (1 + delay)
    alpha = np.linspace(-0.05 * scale**2, 1.1 * scale**2, 300)
    beta = np.linspace(-0.1 * scale, 1.7 * scale, 300)
    codes = plan_filling(Slice(alpha, beta, gamma, delta, delay)).codes()
    assert set(np.unique(codes)) == {STABLE, UNSTABLE}
    changes = np.argwhere(codes[:, 1:] != codes[:, :-1])
    for i, j in rng.choice(changes, 12, axis=0):
        for beside in (j, j + 1):
            point = float(alpha[i]), float(beta[beside]), gamma, delta, delay
            unstable = truth.unstable_count(*point)
            assert codes[i, beside] == (UNSTABLE if unstable else STABLE)


@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0, 5.0, 20.0, 60.0])
@pytest.mark.parametrize("side", ["the stable set", "many turns"])
def test_a_slice_of_4096_squared_evaluates_less_than_a_percent(side: str, delay: float) -> None:
    scale = 1 / (1 + delay)
    ends = {
        "the stable set": [-0.05 * scale**2, 1.1 * scale**2, -0.1 * scale, 1.7 * scale],
        "many turns": [-4, 4, -4, 4],
    }[side]
    alpha, beta = np.linspace(*ends[:2], 4096), np.linspace(*ends[2:], 4096)
    filling = plan_filling(Slice(alpha, beta, 1e-3, 0.015, delay))
    assert filling.computed < 0.01 * alpha.size * beta.size
    assert filling.computed < 5000


def test_a_slice_against_which_a_sample_speaks_is_computed_throughout() -> None:
    of = Slice(np.linspace(-0.1, 1, 40), np.linspace(0, 1, 40), 1e-3, 0.015, 0.0)
    filling = plan_filling(of)
    wrong = Filling(of, filling.starts, ~filling.inside, filling.near, filling.samples)
    swapped = filling.samples._replace(inside=~filling.samples.inside)
    np.testing.assert_array_equal(filling.codes(), dense(of))
    assert np.any(wrong.codes() != dense(of))
    caught = Filling(of, filling.starts, ~filling.inside, filling.near, swapped)
    np.testing.assert_array_equal(caught.codes(), dense(of))


def test_nodes_on_the_line_of_a_root_at_one_are_computed_not_filled() -> None:
    of = Slice(np.linspace(-1.0, 1.0, 21), np.linspace(0.1, 1.0, 10), 0.0, 0.0, 0.0)
    assert of.alpha[10] == 0.0
    filling = plan_filling(of)
    assert set(range(100, 110)) <= set(filling.near.tolist())
    assert np.all(filling.codes()[10] == UNDECIDED)


# ------------------------------------------------------------------------- verdicts far from stable


def test_unstable_loops_of_a_long_delay_are_decided_by_a_root_where_the_recursion_is_lost(
    rng: np.random.Generator,
) -> None:
    alpha, beta = rng.uniform(-4, 4, (2, 400))
    at = {"gamma": 69.9, "delta": 0.015, "delay": 100.0}
    quick = np.asarray(verdict(alpha, beta, **at))
    exact = np.asarray(verdict(alpha, beta, **at, resolve="exact"))
    assert np.mean(quick == UNDECIDED) > 0.2
    assert np.all(exact != UNDECIDED)
    coefficients = np.asarray(characteristic_polynomial(alpha, beta, **at))
    for index in rng.choice(np.flatnonzero(quick == UNDECIDED), 10):
        with flint.ctx.workprec(300):
            balls = flint.acb_poly(coefficients[index, ::-1].tolist()).roots()
            assert exact[index] == UNSTABLE
            assert any(abs(ball) > 1 for ball in balls)


def test_a_recursion_that_breaks_down_leaves_unstable_loops_decided() -> None:
    # gamma = delta = 0 without delay: p(0) = beta / 2, so a coefficient of reflection is exactly 1.
    codes = verdict(np.array([0.1, 0.5, 1.5]), 2.0, 0.0, 0.0, 0.0, resolve="exact")
    assert np.all(codes == UNSTABLE)


# -------------------------------------------------------------------------------------------- cells


@pytest.mark.parametrize("delay", [0.0, 1.5, 12.0])
@pytest.mark.parametrize("delta", [(0.015, 0.015), (0.015, 0.016)])
def test_cells_proved_in_blocks_are_those_proved_alone(
    delay: float, delta: tuple[float, float]
) -> None:
    scale = 1 / (1 + delay)
    alpha = np.linspace(-0.05 * scale**2, 1.1 * scale**2, 131)
    beta = np.linspace(-0.1 * scale, 1.7 * scale, 104)
    cells = CellSlice(alpha, beta, np.array([1e-3, 1e-3]), np.array(delta), delay)
    blocks = prove_blocks(cells)
    alone = cells.proved_in_blocks(np.zeros((130, 103), bool), 1)
    np.testing.assert_array_equal(blocks.cells(), alone)
    assert blocks.tried < alone.size


# --------------------------------------------------------------------------------------------- plan


def test_a_plan_counts_every_point_and_says_why_it_is_not_evaluated() -> None:
    plan = plan_atlas(SMALL)
    shares = {share.variable: share for share in plan.shares()}
    assert set(shares) == {
        "verdict",
        "cell_verdict",
        "alpha_limits",
        "spectral_radius",
        "cell_spectral_radius_error",
    }
    assert shares["verdict"].asked == 24 * 20 * 2 * 3 * 2
    assert shares["cell_verdict"].asked == 23 * 19 * 1 * 2 * 2
    for share in shares.values():
        left_out = sum(count for count, why in share.reasons if why)
        assert share.asked == share.evaluated + left_out
    assert shares["verdict"].evaluated < 0.5 * shares["verdict"].asked
    assert "1.5 (degree 5)" in str(plan)


def test_a_tile_is_the_same_alone_and_in_an_atlas_of_any_tiles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan, whole = plan_atlas(SMALL), small_contents().arrays
    monkeypatch.setattr("jaxstab.atlas.compute.plan.TILE_NODES", 1)
    assert len(plan.tiles) == 2 * 3 * 2
    for tile in plan.tiles[::-1]:
        for name, values in compute_tile(plan, tile).items():
            places = (plan.numbers(dimension, tile) for dimension in VARIABLES[name].dimensions)
            np.testing.assert_array_equal(values, whole[name][np.ix_(*places)])


@pytest.mark.parametrize("product", ["verdict", "spectral_radius"])
def test_what_is_not_asked_for_is_not_computed(
    product: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = AtlasSpec(
        alpha=[0.0, 0.1, 0.2], beta=[0.1, 0.2], gamma=[0.001], delta=[0.015], delay=[1.0],
        products=[product],
    )  # fmt: skip
    plan = plan_atlas(spec)
    other = {"verdict": "spectral_radius", "spectral_radius": "verdict"}[product]
    monkeypatch.setattr(products, "spectral_radius" if product == "verdict" else "plan_filling", 0)
    assert set(compute_tile(plan, plan.tiles[0])) == set(schema.PRODUCTS[product])
    assert f"{other}: not asked for" in str(plan)


def test_fixed_parameters_are_not_gridded_and_the_atlas_answers_at_them(
    tmp_path, rng: np.random.Generator
) -> None:
    spec = AtlasSpec(alpha=FittedAxis(80), beta=FittedAxis(70), delay=[0.0, 2.0], **ONE_SLICE)
    assert "gamma: fixed at 0.001, not gridded" in str(plan_atlas(spec))
    assert AtlasSpec.from_toml(spec.to_toml()) == spec
    atlas = build_atlas(spec, tmp_path / "slice.h5")
    assert atlas.arrays["verdict"].shape == (80, 70, 1, 1, 2)
    assert atlas.arrays["cell_verdict"].shape == (79, 69, 1, 1, 2)
    nodes = atlas.nodes(1)
    dense_codes = verdict(
        nodes["alpha"][:, None], nodes["beta"], 0.001, 0.015, 2.0, resolve="exact"
    )
    np.testing.assert_array_equal(atlas.arrays["verdict"][:, :, 0, 0, 1], dense_codes)
    alpha, beta = (rng.uniform(nodes[name][0], nodes[name][-1], 300) for name in ("alpha", "beta"))
    answer = atlas.query(alpha, beta, 0.001, 0.015, 2.0)
    decided = answer.status == QueryStatus.CELL
    assert decided.mean() > 0.9
    assert atlas.decided_fraction(1) > 0.9
    for index in np.flatnonzero(decided)[:60]:
        point = float(alpha[index]), float(beta[index]), 0.001, 0.015, 2.0
        assert answer.verdict[index] == (UNSTABLE if truth.unstable_count(*point) else STABLE)
    with pytest.raises(ValueError, match="gamma is"):
        atlas.query(0.01, 0.1, 0.0011, 0.015, 2.0)


def test_the_radius_of_a_slice_is_interpolated_in_it(tmp_path) -> None:
    spec = AtlasSpec(
        alpha=[0.1, 0.2], beta=[0.4, 0.6], gamma=[0.001], delta=[0.015], delay=[0.0],
        products=["spectral_radius"],
    )  # fmt: skip
    atlas = build_atlas(spec, tmp_path / "radius.h5")
    corners = atlas.arrays["spectral_radius"][:, :, 0, 0, 0]
    answer = atlas.query(0.15, 0.5, 0.001, 0.015, 0.0)
    assert float(answer.spectral_radius) == pytest.approx(corners.mean(), rel=1e-12)


@pytest.mark.parametrize("name", ["gamma", "delta"])
def test_a_tolerance_sets_the_number_of_nodes_and_what_moves_between_them(name: str) -> None:
    ends = {"gamma": (0.0, 0.001), "delta": (0.0, 0.015)}
    fixed = {"gamma": [0.0005], "delta": [0.01]} | {"delay": [1.0], "products": ["verdict"]}

    def nodes(tolerance: float) -> np.ndarray:
        axis = {name: ToleranceAxis(*ends[name], tolerance)}
        spec = AtlasSpec(alpha=[0.0, 0.1], beta=[0.1, 0.2], **(fixed | axis))
        assert AtlasSpec.from_toml(spec.to_toml()) == spec
        return getattr(plan_atlas(spec).grid, name)

    coarse, fine = nodes(0.5), nodes(0.002)
    np.testing.assert_array_equal(coarse, ends[name])
    assert (fine[0], fine[-1]) == ends[name]
    assert 3 <= fine.size < 100
    # The truth's curve, between neighbours: in units of the set's extents of delay 1.
    other = {"gamma": 0.01, "delta": 0.0005}[name]
    for theta in np.linspace(0.02, 0.45, 6):
        edge = [
            truth.boundary_point(theta, *((v, other) if name == "gamma" else (other, v)), 1.0)
            for v in fine.tolist()
        ]
        motion = np.abs(np.diff(np.array(edge, float), axis=0)) / [0.14447, 0.66]
        assert motion.max() < 0.002 * 1.3


@pytest.mark.parametrize(
    ("toml", "says"),
    [
        ("gamma = {start = 0, stop = 1, tolerance = 0}", "tolerance of an axis has 0.0"),
        ("gamma = {start = 1, stop = 0, tolerance = 0.1}", "give stop > start"),
        ("gamma = {start = -1, stop = 0, tolerance = 0.1}", "start of an axis has -1.0"),
        ("gamma = {start = 0, stop = 'a', tolerance = 0.1}", "stop of gamma has 'a'"),
        ("gamma = {start = 0, tolerance = 0.1}", "or start, stop and tolerance"),
        ("alpha = {start = 0, stop = 1, tolerance = 0.1}", "no 'tolerance'"),
    ],
)
def test_a_bad_tolerance_is_refused_in_one_sentence(toml: str, says: str) -> None:
    with pytest.raises((ValueError, TypeError)) as caught:
        AtlasSpec.from_toml(toml)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_plan_is_printed_by_a_command(tmp_path) -> None:
    from click.testing import CliRunner

    from jaxstab.cli.main import main

    spec = tmp_path / "slice.toml"
    spec.write_text(
        'products = ["verdict"]\ngamma = [0.001]\ndelta = [0.015]\ndelay = [1]\n'
        "alpha = {start = -0.01, stop = 0.2, count = 100}\n"
        "beta = {start = 0, stop = 1, count = 100}\n",
        encoding="utf-8",
    )
    answer = CliRunner().invoke(main, ["atlas", "plan", str(spec)])
    assert answer.exit_code == 0, answer.output
    assert "verdict: 10000 points asked for," in answer.stdout
    assert "between crossings of the exact boundary" in answer.stdout
    spec.write_text("gamma = [1, 0]", encoding="utf-8")
    assert CliRunner().invoke(main, ["atlas", "plan", str(spec)]).exit_code == 1
