"""Walls beyond an atlas: unstable where its axes hold the whole stable set, else not known."""

import csv
from pathlib import Path

import numpy as np
import pytest
from atlases import write_whole
from commands import run

from benchmarks import truth
from jaxstab import (
    Atlas,
    AtlasSpec,
    FittedAxis,
    Velocity,
    Verdict,
    build_atlas,
    open_atlas,
    plan_atlas,
    verdict,
)
from jaxstab.atlas.proved import _bounds
from jaxstab.model import by_name

SCENE = """
[device]
mass = 0.2
damping = 0.5
[hand]
stiffness = [0.0, 100.0]
damping = [0.0, 1.0]
[controller]
sample_time = 0.001
delay_samples = 1.0
{velocity}
[walls.soft]
stiffness = 500.0
damping = 5.0
[walls.stiff]
stiffness = 200000.0
damping = 5.0
[walls.damped]
stiffness = 500.0
damping = 900.0
"""


@pytest.fixture(scope="module")
def atlas(tmp_path_factory: pytest.TempPathFactory) -> Atlas:
    return open_atlas(write_whole(tmp_path_factory.mktemp("whole") / "a.h5"))


def test_20_walls_beyond_the_axes_are_unstable_in_truth(atlas: Atlas) -> None:
    """Next to the axes and far out, by certified roots; at all delays that the flags are of."""
    rng = np.random.default_rng(20)
    rows = atlas.arrays["limit_range"]
    whole = atlas.arrays["limit_whole"]
    assert np.count_nonzero(whole == 2) > 0
    tried = 0
    for row, code in zip(rows.tolist(), whole.tolist(), strict=True):
        early, late, least, most, low, high = row
        for _ in range(8):
            gamma, delta = rng.uniform(0.0, 0.001), rng.uniform(0.0, 0.015)
            delay, far = rng.uniform(early, late), 10.0 ** rng.uniform(-4.0, 1.0)
            kind = int(rng.integers(4))
            beta = rng.uniform(low, high)
            alpha = (most + far, least - far, *rng.uniform(-0.01, 4.0, 2))[kind]
            beta = (beta, beta, high + far, low - far)[kind]
            point = by_name(alpha, beta, gamma, delta, delay)
            answer = atlas.query(**point, outside="undecided")
            if code >= (1 if kind < 2 else 2):
                tried += 1
                assert answer.verdict == Verdict.UNSTABLE
                assert truth.spectral_radius(*point.values())[0] >= 1.0
                assert atlas.verdict(**point) == Verdict.UNSTABLE
            else:
                assert answer.verdict != Verdict.UNSTABLE
                with pytest.raises(ValueError, match="this atlas covers"):
                    atlas.query(**point)
    assert tried > 50


def test_20_the_bounds_of_lemma_b21_hold_for_stable_polynomials() -> None:
    rng = np.random.default_rng(21)
    for _ in range(2000):
        pairs = int(rng.integers(1, 8))
        radius, angle = 1.0 - 10.0 ** -rng.uniform(0.0, 9.0, pairs), rng.uniform(0, np.pi, pairs)
        roots = np.concatenate([radius * np.exp(1j * angle), radius * np.exp(-1j * angle)])
        n, mean = 2 * pairs, 2.0 * np.sum(radius * np.cos(angle)) / (2 * pairs)
        at_one, at_i = abs(np.prod(1.0 - roots)), abs(np.prod(1j - roots))
        assert at_one < 2.0**n * (1.0 + 1e-12)
        assert at_one**2 <= (2.0 - 2.0 * mean) ** n * (1.0 + 1e-9)
        assert at_i <= 2.0 ** (n / 2) * (1.0 + 1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 1.7, 4.0])
def test_20_no_stable_wall_is_beyond_the_bounds(delay: float) -> None:
    """Against stable walls that are found at random in a wide box."""
    rng = np.random.default_rng(22)
    spec = AtlasSpec(gamma=[0.0, 0.4], delta=[0.0, 0.3], delay=[delay], products=["verdict"])
    grid = plan_atlas(AtlasSpec(delay=[1.0], products=["verdict"])).grid
    grid = type(grid)(
        **{**vars(grid), "gamma": np.array(spec.gamma), "delta": np.array(spec.delta)}
    )
    bounds = _bounds(grid, int(delay), 1)
    assert np.isfinite(bounds.alpha)
    alpha, beta = rng.uniform(-0.4, 2.0, 20_000), rng.uniform(-2.5, 2.5, 20_000)
    gamma, delta = rng.uniform(0.0, 0.4, 20_000), rng.uniform(0.0, 0.3, 20_000)
    codes = np.asarray(verdict(alpha, beta, gamma=gamma, delta=delta, delay=delay))
    stable = codes == Verdict.STABLE
    assert stable.sum() > 20
    assert np.all(alpha[stable] <= bounds.alpha)
    assert np.all(np.abs(beta[stable]) <= bounds.beta)


def test_20_islands_beyond_the_betas_are_not_called_unstable(tmp_path: Path) -> None:
    """A window of 10 samples without delay has an island around (0.2734, -0.704)."""
    spec = AtlasSpec(
        alpha=FittedAxis(8), beta=FittedAxis(8), gamma=[0.0], delta=[0.0], delay=[0.0],
        products=["alpha_limits"], limit_cells=16, velocity=Velocity.difference(10),
    )  # fmt: skip
    atlas = build_atlas(spec, tmp_path / "a.h5")
    island = by_name(0.2734, -0.704, 0.0, 0.0, 0.0)
    assert atlas.query(**island, outside="undecided").verdict != Verdict.UNSTABLE
    assert atlas.query(**island, outside="undecided", exact=False).status == 5


@pytest.mark.parametrize("velocity", ["", "[controller.velocity]\nwindow_samples = 5"])
def test_20_query_agrees_with_check_on_the_walls_of_the_scene(
    velocity: str, tmp_path: Path
) -> None:
    scene, file = tmp_path / "scene.toml", tmp_path / "a.h5"
    scene.write_text(SCENE.format(velocity=velocity))
    printed = run("atlas", "spec", "--scene", scene)
    assert printed.exit_code == 0, printed.stderr
    spec = AtlasSpec.from_toml(printed.stdout)
    atlas = build_atlas(spec, file)
    asked = run("atlas", "query", file, "--scene", scene)
    assert asked.exit_code == 1, asked.stderr  # two walls are unstable
    rows = list(csv.DictReader(asked.stdout.splitlines()))
    assert {row["wall"]: row["verdict"] for row in rows} == {
        "soft": "stable",
        "stiff": "unstable",
        "damped": "unstable",
    }
    assert atlas.products == ("verdict", "alpha_limits")
