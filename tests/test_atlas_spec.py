"""What may be asked of an atlas, and what is said about what may not."""

from pathlib import Path

import numpy as np
import pytest
from atlases import SMALL, SMALL_TOML

from jaxstab import AtlasSpec, FittedAxis, Velocity

ROOT = Path(__file__).resolve().parents[1]


def test_the_default_is_the_haptic_range_of_the_paper_for_delays_up_to_three() -> None:
    spec = AtlasSpec()
    assert (spec.gamma[0], spec.gamma[-1]) == (0.0, 0.001)
    assert (spec.delta[0], spec.delta[-1]) == (0.0, 0.015)
    assert spec.delay == (0.0, 1.0, 2.0, 3.0)
    assert spec.products == ("verdict", "alpha_limits", "fields")
    assert (spec.where, spec.method) == ("near", "fast")


def test_the_example_specification_is_the_default() -> None:
    assert AtlasSpec.from_file(ROOT / "data/specs/haptic.toml") == AtlasSpec()


def test_the_example_with_an_estimator_has_a_window_of_twenty_samples() -> None:
    spec = AtlasSpec.from_file(ROOT / "data/specs/window.toml")
    assert spec.velocity == Velocity.difference(samples=20)


@pytest.mark.parametrize(
    "spec",
    [
        AtlasSpec(),
        SMALL,
        AtlasSpec(where="all", method="companion"),
        AtlasSpec(where="all", products=["verdict"]),
        AtlasSpec(gamma=np.geomspace(1e-9, 12.3, 99), products=["verdict"]),
    ],
)
def test_a_specification_survives_its_own_toml(spec: AtlasSpec) -> None:
    assert AtlasSpec.from_toml(spec.to_toml()) == spec
    assert max(map(len, spec.to_toml().splitlines())) <= 120


def test_an_axis_can_be_written_in_several_ways() -> None:
    assert AtlasSpec.from_toml(SMALL_TOML) == SMALL
    spec = AtlasSpec.from_toml(
        "alpha = {start = 0, stop = 1, count = 3}\n"
        'gamma = {start = 0.001, stop = 0.1, count = 3, spacing = "geometric"}\n'
    )
    assert spec.alpha == (0.0, 0.5, 1.0)
    assert spec.gamma == pytest.approx((0.001, 0.01, 0.1), rel=1e-15)
    assert spec.beta == AtlasSpec().beta


@pytest.mark.parametrize(
    ("toml", "says"),
    [
        ("gama = [0, 1]", "gama is unknown; did you mean 'gamma'?"),
        ("gamma = [0, 1", "not TOML"),
        ("gamma = [1, 0]", "gamma has 0.0 after 1.0"),
        ("gamma = [0, 0]", "ascending"),
        ("beta = [0]", "at least two"),
        ("gamma = []", "at least one"),
        ("alpha = []", "at least two"),
        ("gamma = [0, nan]", "gamma is nan"),
        ("gamma = [0, inf]", "gamma is inf"),
        ("gamma = [-1, 0]", "gamma is -1.0; allowed are finite values >= 0"),
        ("beta = [1, 1.00000005]", "axis beta is 4.9999999"),
        ("delay = [-1]", "delay is -1.0"),
        ("delay = [1000]", "from 0 to 100"),
        ("gamma = ['a', 1]", "gamma is 'a'"),
        ("gamma = [false, true]", "gamma is False"),
        ("gamma = 'wide'", "gamma is 'wide'"),
        ("gamma = {fitted = 20}", "gamma.fitted is unknown; known are values, start,"),
        ("alpha = {fitted = 2}", "fitted is 2; give a whole number from 8"),
        ("alpha = {fitted = 20, values = [0, 1]}", "alpha has fitted, values"),
        ("gamma = {start = 0, stop = 1}", "gamma has start, stop"),
        ("gamma = {}", "gamma has nothing"),
        (
            "gamma = {strat = 0, stop = 1, count = 3}",
            "gamma.strat is unknown; did you mean 'start'?",
        ),
        ("gamma = {start = 0, stop = 1, count = 1}", "give a whole number from 2"),
        ("gamma = {start = 0, stop = 1, count = 3, spacing = 'log'}", "spacing of gamma is 'log'"),
        ("gamma = {start = 0, stop = 1, count = 3, spacing = 'geometric'}", "give ends > 0"),
        ("gamma = {start = 1, stop = 0, count = 3}", "ascending"),
        ("gamma = {start = 0, stop = nan, count = 3}", "stop of gamma is nan"),
        ("products = ['verdicts']", "products.verdicts is unknown; did you mean 'verdict'?"),
        ("products = []", "products is empty"),
        ("products = 'verdict'", "products is 'verdict'"),
        ("where = 'far'", 'where is \'far\'; give one of "near", "all"'),
        ("method = 'slow'", 'method is \'slow\'; give one of "fast", "companion"'),
        ("radius_rounding = 1e-7", "radius_rounding is unknown"),
        ("alpha = {fitted = 100000}\nbeta = {fitted = 100000}", "nodes; at most"),
    ],
)
def test_a_bad_specification_is_refused_in_one_sentence(toml: str, says: str) -> None:
    with pytest.raises((ValueError, TypeError)) as caught:
        AtlasSpec.from_toml(toml)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_bad_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text("gamma = [1, 0]", encoding="utf-8")
    with pytest.raises(ValueError, match=r"wrong\.toml: axis gamma"):
        AtlasSpec.from_file(path)
    with pytest.raises(FileNotFoundError):
        AtlasSpec.from_file(tmp_path / "missing.toml")


def test_a_fitted_axis_is_only_for_the_gains() -> None:
    with pytest.raises(TypeError, match="gamma"):
        AtlasSpec(gamma=FittedAxis(20))


def test_a_fitted_axis_has_a_whole_number_of_nodes() -> None:
    with pytest.raises(TypeError):
        FittedAxis(20.5)
