"""What may be asked of an atlas, and what is said about what may not."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from atlases import SMALL, SMALL_TOML

from jaxstab import AtlasSpec, FieldSpec, Velocity
from jaxstab.atlas.spec import HAPTIC

ROOT = Path(__file__).resolve().parents[2]


def test_the_default_is_the_haptic_range_of_the_paper_for_delays_up_to_three() -> None:
    spec = AtlasSpec()
    assert (spec.gamma[0], spec.gamma[-1]) == (0.0, 0.001)
    assert (spec.delta[0], spec.delta[-1]) == (0.0, 0.015)
    assert (spec.delay[0], spec.delay[-1], len(spec.delay)) == (0.0, 3.0, 73)
    assert spec.fields is None
    assert HAPTIC.fields is not None
    assert (HAPTIC.fields.where, HAPTIC.fields.method) == ("near", "fast")
    assert HAPTIC.fields.delay == (0.0, 1.0, 2.0, 3.0)
    assert replace(HAPTIC, fields=None) == spec


def test_the_example_specification_is_what_is_built_without_one() -> None:
    assert AtlasSpec.from_file(ROOT / "data/specs/haptic.toml") == HAPTIC


def test_the_example_with_an_estimator_has_a_window_of_twenty_samples() -> None:
    spec = AtlasSpec.from_file(ROOT / "data/specs/window.toml")
    assert spec.velocity == Velocity.difference(samples=20)


def test_whole_delays_are_nodes_and_fields_have_the_axes_of_the_limits() -> None:
    spec = AtlasSpec(delay=[0.5, 2.75], fields=FieldSpec(gamma=[0.0]))
    assert spec.delay == (0.5, 1.0, 2.0, 2.75)
    assert isinstance(spec.fields, FieldSpec)
    assert (spec.fields.gamma, spec.fields.delta) == ((0.0,), spec.delta)
    assert spec.fields.delay == spec.delay
    assert AtlasSpec(delay=[0.5]).delay == (0.5,)


@pytest.mark.parametrize(
    "spec",
    [
        AtlasSpec(),
        HAPTIC,
        SMALL,
        AtlasSpec(fields=FieldSpec(where="all", method="companion", alpha=[0.0, 0.1])),
        AtlasSpec(gamma=np.geomspace(1e-9, 12.3, 99), rows=7),
        AtlasSpec(velocity=Velocity.difference(samples=3)),
    ],
)
def test_a_specification_survives_its_own_toml(spec: AtlasSpec) -> None:
    assert AtlasSpec.from_toml(spec.to_toml()) == spec
    assert max(map(len, spec.to_toml().splitlines())) <= 120


def test_an_axis_can_be_written_in_several_ways() -> None:
    assert AtlasSpec.from_toml(SMALL_TOML) == SMALL
    spec = AtlasSpec.from_toml(
        'gamma = {start = 0.001, stop = 0.1, count = 3, spacing = "geometric"}\n'
        "[fields]\nalpha = {start = 0, stop = 1, count = 3}\n"
    )
    assert spec.gamma == pytest.approx((0.001, 0.01, 0.1), rel=1e-15)
    assert isinstance(spec.fields, FieldSpec)
    assert (spec.fields.alpha, spec.fields.beta) == ((0.0, 0.5, 1.0), 112)


@pytest.mark.parametrize(
    ("toml", "says"),
    [
        ("gama = [0, 1]", "gama is unknown; did you mean 'gamma'?"),
        ("gamma = [0, 1", "not TOML"),
        ("gamma = [1, 0]", "gamma has 0.0 after 1.0"),
        ("gamma = [0, 0]", "ascending"),
        ("fields = {beta = [0]}", "at least two"),
        ("gamma = []", "at least one"),
        ("fields = {alpha = []}", "at least two"),
        ("gamma = [0, nan]", "gamma is nan"),
        ("gamma = [0, inf]", "gamma is inf"),
        ("gamma = [-1, 0]", "gamma is -1.0; allowed are finite values >= 0"),
        ("fields = {beta = [1, 1.00000005]}", "axis beta is 4.9999999"),
        ("alpha = [0, 1]", "alpha is unknown"),
        ("fields = 7", "fields is 7; give a table"),
        ("fields = {gama = [0]}", "fields.gama is unknown; did you mean 'gamma'?"),
        ("rows = 1", "rows is 1; give a whole number from 2"),
        ("rows = 1000000", "the limits have 438000000 nodes; at most"),
        ("delay = [-1]", "delay is -1.0"),
        ("delay = [1000]", "from 0 to 100"),
        ("gamma = ['a', 1]", "gamma is 'a'"),
        ("gamma = [false, true]", "gamma is False"),
        ("gamma = 'wide'", "gamma is 'wide'"),
        ("gamma = {fitted = 20}", "gamma.fitted is unknown; known are values, start,"),
        ("fields = {alpha = {fitted = 2}}", "fitted is 2; give a whole number from 8"),
        ("fields = {alpha = {fitted = 20, values = [0, 1]}}", "alpha has fitted, values"),
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
        ("fields = {where = 'far'}", 'where is \'far\'; give one of "near", "all"'),
        ("fields = {method = 'slow'}", 'method is \'slow\'; give one of "fast", "companion"'),
        ("radius_rounding = 1e-7", "radius_rounding is unknown"),
        ("fields = {alpha = {fitted = 100000}, beta = {fitted = 100000}}", "nodes; at most"),
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


@pytest.mark.parametrize("values", [np.array(5.0), np.ones((2, 2))])
def test_an_axis_is_a_list_of_numbers(values: Any) -> None:
    with pytest.raises(TypeError, match=r"axis gamma is .*; give a list"):
        AtlasSpec(gamma=values)


def test_a_count_of_numpy_is_a_count() -> None:
    assert FieldSpec(alpha=np.int64(20)) == FieldSpec(alpha=20)


def test_a_fitted_axis_is_only_for_the_gains() -> None:
    with pytest.raises(TypeError, match="gamma"):
        AtlasSpec(gamma=20.0)


def test_a_fitted_axis_has_a_whole_number_of_nodes() -> None:
    with pytest.raises(TypeError, match="alpha"):
        FieldSpec(alpha=20.5)
