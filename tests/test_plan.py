"""A plan says what is computed and why the rest is not; tiles are the same however they are cut."""

import math
import re
from dataclasses import replace
from time import process_time

import numpy as np
import pytest
from atlases import SMALL, small_contents

from benchmarks import truth
from jaxstab import (
    AtlasSpec,
    FittedAxis,
    Velocity,
    Verdict,
    build_atlas,
    plan_atlas,
    stable_region,
    verdict,
)
from jaxstab.atlas import plan as plans
from jaxstab.atlas.plan import compute_tile
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.schema import VARIABLES
from jaxstab.atlas.write.resolution import estimate_build
from jaxstab.results import QueryStatus, RegionStatus

ONE_SLICE = {"gamma": [0.001], "delta": [0.015], "products": ["verdict"]}


# --------------------------------------------------------------------------------------------- plan


def test_a_plan_counts_the_values_of_every_variable() -> None:
    plan = str(plan_atlas(SMALL))
    for line in (
        f"verdict: {24 * 20 * 2 * 3 * 2} values",
        f"cell_verdict: {23 * 19 * 1 * 2 * 2} values",
    ):
        assert line in plan.splitlines()
    for name in ("alpha_limits", "spectral_radius"):
        assert re.search(rf"(?m)^{name}: \d+ values$", plan)
    assert "1.5 (degree 5)" in plan


@pytest.mark.parametrize("delay", [0.0, 1.0, 1.5])
@pytest.mark.parametrize("window", [1, 2, 20])
def test_a_plan_names_the_degree_of_loops_with_estimators(window: int, delay: float) -> None:
    axes = {"alpha": [0.0, 0.1], "beta": [0.0, 0.1], "gamma": [0.0], "delta": [0.01]}
    spec = AtlasSpec(**axes, delay=[delay], velocity=Velocity.difference(window))
    states = 2 + window + math.ceil(delay)  # of the mass, its past positions, forces on their way
    assert f"delay: {delay:g} (degree {states});" in str(plan_atlas(spec))


@pytest.mark.campaign
def test_a_tile_is_the_same_alone_and_in_an_atlas_of_any_tiles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan, whole = plan_atlas(SMALL), small_contents()
    monkeypatch.setattr("jaxstab.atlas.plan.TILE_NODES", 1)
    assert len(plan.tiles) == 2 * 3 * 2
    for tile in plan.tiles[::-1]:
        for name, values in compute_tile(plan, tile).items():
            places = (plan.numbers(dimension, tile) for dimension in VARIABLES[name].dimensions)
            np.testing.assert_array_equal(values, whole[name][np.ix_(*places)])


@pytest.mark.parametrize("product", ["verdict", "fields"])
def test_what_is_not_asked_for_is_not_computed(
    product: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = AtlasSpec(
        alpha=[0.0, 0.1, 0.2], beta=[0.1, 0.2], gamma=[0.001], delta=[0.015], delay=[1.0],
        products=[product],
    )  # fmt: skip
    plan = plan_atlas(spec)
    other = {"verdict": "fields", "fields": "verdict"}[product]
    monkeypatch.setattr(PRODUCTS[other], "compute", None)
    assert set(compute_tile(plan, plan.tiles[0])) == set(PRODUCTS[product].names)
    assert f"{other}: not requested" in str(plan)


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
        nodes["alpha"][:, None], nodes["beta"], gamma=0.001, delta=0.015, delay=2.0, resolve="exact"
    )
    np.testing.assert_array_equal(atlas.arrays["verdict"][:, :, 0, 0, 1], dense_codes)
    alpha, beta = (rng.uniform(nodes[name][0], nodes[name][-1], 300) for name in ("alpha", "beta"))
    answer = atlas.query(alpha, beta, gamma=0.001, delta=0.015, delay=2.0)
    decided = answer.status == QueryStatus.CELL
    assert decided.mean() > 0.9
    assert atlas.decided_fraction(1) > 0.9
    for index in np.flatnonzero(decided)[:60]:
        point = float(alpha[index]), float(beta[index]), 0.001, 0.015, 2.0
        assert answer.verdict[index] == (
            Verdict.UNSTABLE if truth.unstable_count(*point) else Verdict.STABLE
        )
    with pytest.raises(ValueError, match="gamma is"):
        atlas.query(0.01, 0.1, gamma=0.0011, delta=0.015, delay=2.0)


@pytest.mark.parametrize(
    ("status", "says"),
    [
        (RegionStatus.EMPTY, "no (alpha, beta) is stable at delay 1"),
        (RegionStatus.UNRESOLVED, "delta 0, delay 1 (the boundary was not resolved: nothing is"),
    ],
)
def test_an_axis_is_laid_around_a_region_that_is_known(
    status: RegionStatus, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty = replace(stable_region(gamma=np.pi**2, delta=0.0, delay=1.0), status=status)
    assert not len(empty.points)
    monkeypatch.setattr(plans, "stable_region", lambda *_, **__: empty)
    with pytest.raises(ValueError, match=re.escape(says)) as caught:
        plan_atlas(AtlasSpec(gamma=[1.0], delta=[0.0], delay=[1.0]))
    assert "\n" not in str(caught.value)


@pytest.mark.campaign
@pytest.mark.parametrize("products", [SMALL.products, ("outline", "summary")], ids=" ".join)
def test_a_build_takes_about_the_time_and_the_size_that_were_estimated(
    products: tuple[str, ...], tmp_path
) -> None:
    spec = replace(SMALL, products=products)
    estimate = estimate_build(plan_atlas(spec))
    begin = process_time()
    build_atlas(spec, tmp_path / "atlas.h5")
    seconds, size = process_time() - begin, (tmp_path / "atlas.h5").stat().st_size
    assert 1 / 3 < estimate.seconds / seconds < 3
    assert 1 / 2 < estimate.size / size < 2
    assert re.fullmatch(
        r"build: about [\d.]+ seconds of CPU time on this machine, and a file of about 0\.[\d]+ "
        "MB, judged by parts of a few tiles",
        str(estimate),
    )


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
    assert "verdict: 10000 values" in answer.stdout
    assert answer.stdout.splitlines()[-1].startswith("build: about ")
    spec.write_text("gamma = [1, 0]", encoding="utf-8")
    assert CliRunner().invoke(main, ["atlas", "plan", str(spec)]).exit_code == 2
