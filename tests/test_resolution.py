"""Resolutions that wishes need: what is promised comes, and what cannot be is refused."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from campaign import many
from click.testing import CliRunner

from jaxstab import (
    Atlas,
    AtlasSpec,
    FittedAxis,
    Velocity,
    build_atlas,
    plan_atlas,
    plan_resolution,
    stable_region,
)
from jaxstab.atlas.plan import Plan, Tile, compute_tile
from jaxstab.atlas.schema import VARIABLES
from jaxstab.atlas.write import resolution
from jaxstab.cli.main import main
from jaxstab.model import by_name
from jaxstab.results import ResolutionPlan

SLICE = AtlasSpec(
    gamma=[0.0005], delta=[0.01], delay=[1.0], products=["alpha_limits"], limit_cells=64
)
RANGES = {
    "arm": (
        AtlasSpec(alpha=FittedAxis(48), beta=FittedAxis(40)),
        {"accuracy": 0.01},
    ),
    "slice": (
        AtlasSpec(
            alpha=np.linspace(-0.01, 0.2, 64),
            beta=np.linspace(0.0, 1.0, 64),
            gamma=[0.001],
            delta=[0.015],
            delay=[1.0, 1.5],
            products=["verdict"],
        ),
        {"size": 1e5},
    ),
    "stiff": (
        AtlasSpec(
            gamma=[0.0, 0.05, 0.3, 1.0],
            delta=np.linspace(0.0, 0.6, 9),
            delay=[0.0, 1.0],
            products=["alpha_limits"],
        ),
        {"size": 1e6},
    ),
    "low pass": (
        AtlasSpec(
            delay=[0.5, 1.0, 2.0],
            products=["verdict", "alpha_limits"],
            velocity=Velocity.low_pass(0.1),
        ),
        {"size": 2e6},
    ),
    "wheel": (  # a moment of inertia in place of a mass: the loop per sample is the same
        AtlasSpec(
            gamma=[0.0, 2e-4],
            delta=[0.0, 0.005, 0.01],
            delay=range(11),
            delay_cells=4,
            products=["alpha_limits"],
            velocity=Velocity.difference(20),
        ),
        {"accuracy": 0.03},
    ),
}


@pytest.mark.campaign
@pytest.mark.parametrize("name", list(RANGES)[: many(5, small=2)])
def test_what_is_promised_comes(name: str, tmp_path: Path) -> None:
    """Errors and sizes of an atlas that is built are those of its plan, within 20 %."""
    spec, wish = RANGES[name]
    planned = plan_resolution(spec, **wish)
    atlas = build_atlas(planned.spec, tmp_path / "atlas.h5")
    chosen = planned.chosen
    came = {"size": (tmp_path / "atlas.h5").stat().st_size}
    if "alpha_limits" in spec.products:
        came["limit_error"] = limit_error(atlas)
    for key, value in came.items():
        promised = getattr(chosen, key)
        value_promised, spread = promised if isinstance(promised, tuple) else (promised, 0.0)
        assert abs(value - value_promised) <= 0.2 * value_promised + 2.0 * spread, (key, value)
    for key, least in (("limit_error", "accuracy"), ("size", "size")):
        if least in wish:
            assert came[key] <= 1.2 * wish[least]


def places(atlas: Atlas, count: int = 200_000) -> list[np.ndarray]:
    rng = np.random.default_rng(20120412)
    hands = [
        rng.uniform(atlas.arrays[n][0], atlas.arrays[n][-1], count) for n in ("gamma", "delta")
    ]
    if "limit_range" in atlas.arrays:
        rows = atlas.arrays["limit_range"]
        width = np.diff(rows[:, :2])[:, 0]
        share = width / width.sum() if width.any() else None
        rows = rows[rng.choice(len(rows), count, p=share)].T
    else:
        number = rng.integers(atlas.delays.size, size=count)
        ends = [
            (nodes[0], nodes[-1]) for name in ("alpha", "beta") for nodes in [atlas.arrays[name]]
        ]
        rows = [atlas.delays[number]] * 2 + [end[number] for pair in ends for end in pair]
    return [rng.uniform(*rows[2:4]), rng.uniform(*rows[4:6]), *hands, rng.uniform(*rows[:2])]


def limit_error(atlas: Atlas) -> float:
    """Return what 95 % of the errors keep, over the largest alphas: from regions, at some hands."""
    _, *others = places(atlas)
    limits = atlas.alpha_limits(**by_name(*others))
    stable = ~np.isnan(limits.upper) & ((limits.upper < np.inf) | (limits.upper_error == np.inf))
    velocity, position = atlas.filters or (None, None)
    delays = np.unique([*np.linspace(atlas.delays[0], atlas.delays[-1], 31), *atlas.delays])
    hands = [
        (gamma, delta)
        for gamma in {*atlas.arrays["gamma"][[0, -1]].tolist()}
        for delta in {*atlas.arrays["delta"][[0, -1]].tolist()}
    ]
    largest = [
        max(
            float((region.main or region).points[:, 0].max())
            for hand in hands
            for region in [
                stable_region(**by_name(*hand, delay), velocity=velocity, position=position)
            ]
            if not region.is_empty
        )
        for delay in delays.tolist()
    ]
    scale = np.interp(others[-1], delays, largest)
    return float(np.quantile((limits.upper_error / scale)[stable], 0.95, method="higher"))


@pytest.fixture(scope="module")
def planned() -> ResolutionPlan:
    return plan_resolution(SLICE, accuracy=0.002)


@pytest.mark.campaign
def test_a_small_range_keeps_its_promises(planned: ResolutionPlan, tmp_path: Path) -> None:
    atlas = build_atlas(planned.spec, tmp_path / "atlas.h5")
    chosen = planned.chosen
    assert limit_error(atlas) == pytest.approx(chosen.limit_error.value, rel=0.2)
    assert (tmp_path / "atlas.h5").stat().st_size == pytest.approx(chosen.size, rel=0.2)
    assert chosen.limit_error.value <= 0.002


@pytest.mark.parametrize("wish", [{}, {"accuracy": 0.001}, {"size": 3e6}], ids=str)
def test_a_plan_computes_less_than_its_build(
    wish: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted in values of limits of alpha: with a wish, less than half of those of the build."""
    spec = AtlasSpec(delay=[0.0, 1.0], products=["alpha_limits"])
    computed = []

    def counting(plan: Plan, tile: Tile) -> dict[str, np.ndarray]:
        arrays = compute_tile(plan, tile)
        computed.append(sum(arrays[name].size for name in plan.variables))
        return arrays

    monkeypatch.setattr(resolution, "compute_tile", counting)
    if wish:
        spec = plan_resolution(spec, **wish).spec
    plan = plan_atlas(spec)
    if not wish:
        resolution.estimate_build(plan)
    assert 0 < sum(computed) < (0.5 if wish else 0.1) * values_of(plan)


def values_of(plan: Plan) -> int:
    """Return how many values the products of an atlas have."""
    return sum(
        math.prod(len(plan.numbers(dimension, tile)) for dimension in VARIABLES[name].dimensions)
        for tile in plan.tiles
        for name in plan.variables
    )


def test_only_what_the_wish_needs_is_changed(planned: ResolutionPlan) -> None:
    assert planned.spec.limit_cells != SLICE.limit_cells
    changed = AtlasSpec.from_toml(planned.spec.to_toml())
    assert changed == planned.spec
    for name in ("alpha", "beta", "gamma", "delta", "delay", "products", "delay_cells"):
        assert getattr(changed, name) == getattr(SLICE, name)
    assert planned.given.spec == SLICE


def test_resolutions_print_themselves_as_a_table(planned: ResolutionPlan) -> None:
    heading, *lines = str(planned).splitlines()
    assert re.split(" {2,}", heading.strip())[:6] == [
        "alpha",
        "beta",
        "gamma",
        "delta",
        "limits",
        "delays",
    ]
    assert sum("meets accuracy 0.002" in line for line in lines) == 1
    assert sum("as given" in line for line in lines) == 1


def test_a_given_axis_keeps_its_ends_and_its_density() -> None:
    spec = AtlasSpec(gamma=[0.0, 0.1, 1.0], delta=[0.0], delay=[1.0], products=["verdict"])
    counts = resolution.counts_of(spec)
    assert (counts["gamma"], counts["delta"], counts["delay_cells"]) == (2, 1, 0)
    finer = resolution.scaled(spec, 2.0)
    np.testing.assert_allclose(finer.gamma, [0.0, 0.05, 0.1, 0.55, 1.0], rtol=1e-15)
    assert (finer.delta, finer.alpha, finer.beta) == (spec.delta, FittedAxis(256), FittedAxis(224))


@pytest.mark.parametrize(
    ("products", "wish", "says"),
    [
        (["alpha_limits"], {}, "nothing is given; give one of accuracy, size."),
        (["alpha_limits"], {"accuracy": 0.1, "size": 1e5}, "both are given; give one of"),
        (["alpha_limits"], {"accuracy": 0.0}, "accuracy is 0.0"),
        (["alpha_limits"], {"size": -1.0}, "size is -1.0"),
        (["verdict"], {"accuracy": 0.1}, "accuracy is of limits of alpha; add 'alpha_limits'"),
        (["outline"], {"size": 1e6}, "size needs verdicts; add 'alpha_limits' to the products"),
        (["alpha_limits"], {"size": 100.0}, "the coarsest atlas of this range takes 31,300 bytes"),
        (["alpha_limits"], {"accuracy": 1e-9}, "that can be opened, with up to 2.1 GB, reaches"),
    ],
)
def test_a_wish_that_cannot_be_is_refused_in_one_sentence(
    products: list[str], wish: dict[str, float], says: str
) -> None:
    spec = AtlasSpec(gamma=[0.0], delta=[0.0], delay=[1.0], products=products, limit_cells=32)
    with pytest.raises((TypeError, ValueError), match=re.escape(says)) as caught:
        plan_resolution(spec, **wish)
    assert "\n" not in str(caught.value)


def test_a_range_whose_region_is_not_resolved_is_refused_in_one_sentence() -> None:
    spec = AtlasSpec(gamma=[np.pi**2], delta=[0.0], delay=[1.0], alpha=[0.0, 1.0], beta=[0.0, 1.0])
    with pytest.raises(ValueError, match=r"delay 1 .the boundary was not resolved") as caught:
        plan_resolution(spec, accuracy=0.1)
    assert "\n" not in str(caught.value)


def test_the_command_writes_what_meets_the_wish(tmp_path: Path) -> None:
    source, target = tmp_path / "mine.toml", tmp_path / "finer.toml"
    source.write_text(SLICE.to_toml(), encoding="utf-8")
    options = ["--size", "40kB", "-o", str(target)]
    answer = CliRunner().invoke(main, ["atlas", "plan", str(source), *options])
    assert answer.exit_code == 0, answer.output
    assert "meets size 40000" in answer.stdout
    assert f"jaxstab atlas build --spec {target}" in answer.stdout
    assert AtlasSpec.from_file(target).limit_cells > SLICE.limit_cells


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--size", "ten"], "invalid size 'ten'; give one such as 500kB, 10MB or 2GB."),
        (["-o", "finer.toml"], "-o needs a target, such as --accuracy 0.01."),
        (["--accuracy", "0.1", "-o", "finer.txt"], "finer.txt does not end in .toml."),
        (["--accuracy", "0.1", "--size", "3"], "--accuracy and --size are given; give only one."),
    ],
)
def test_the_command_refuses_in_one_sentence(options: list[str], says: str) -> None:
    answer = CliRunner().invoke(main, ["atlas", "plan", *options])
    assert answer.exit_code != 0
    assert says in answer.stderr
