"""Atlases of loops with a velocity estimator and a position filter."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import jaxstab
from benchmarks.truth.filtered import FilteredLoop, average, difference
from jaxstab import AtlasSpec, Filter, FittedAxis, Velocity
from jaxstab.cli.main import main
from jaxstab.model import by_name

WINDOW = Path(__file__).resolve().parents[1] / "data" / "golden" / "atlas-v3-window.h5"
FIVE = Velocity.difference(samples=5)


@pytest.fixture(scope="module")
def atlas() -> jaxstab.Atlas:
    return jaxstab.open_atlas(WINDOW)


# ------------------------------------------------------------------------------- specification


@pytest.mark.parametrize(
    ("text", "velocity", "position"),
    [
        ("[velocity]\nwindow_samples = 20", Velocity.difference(samples=20), None),
        (
            "[velocity]\nwindow_samples = 4\ncutoff = 0.1\norder = 2\nfactor = 0.5",
            Velocity.difference(samples=4)
            * Filter.low_pass(0.1, order=2)
            * Filter.exponential(0.5),
            None,
        ),
        (
            '[position]\ncutoff = 0.2\norder = 3\nkind = "butterworth"',
            None,
            Filter.butterworth(0.2, order=3),
        ),
        (
            "[velocity]\nnumerator = [1.0, 0.0, -1.0]\ndenominator = [2.0, 0.0, 0.0]\n"
            "[[position]]\nwindow_samples = 2\n[[position]]\nwindow_samples = 3",
            Velocity.transfer_function([1.0, 0.0, -1.0], [2.0, 0.0, 0.0]),
            Filter.average(2) * Filter.average(3),
        ),
    ],
)
def test_a_specification_names_its_filters(
    text: str, velocity: Velocity | None, position: Filter | None
) -> None:
    spec = AtlasSpec.from_toml(text)
    plain = Velocity(), Filter()
    assert (spec.velocity or plain[0], spec.position or plain[1]) == (
        velocity or plain[0],
        position or plain[1],
    )
    assert AtlasSpec.from_toml(spec.to_toml()) == spec
    assert AtlasSpec(velocity=velocity, position=position) == spec


def test_the_difference_over_one_sample_needs_no_word() -> None:
    spec = AtlasSpec(velocity=Velocity.difference(samples=1))
    assert spec == AtlasSpec()
    assert "velocity" not in spec.to_toml()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[velocity]\nwindow = 0.02", "window is in s, which an atlas has not; give window_s"),
        ("[velocity]\nwindow_sample = 2", "window_sample is unknown; did you mean 'window_samples"),
        ("velocity = 3", "velocity is 3; give a table"),
        ("[velocity]", "velocity is {}; give a table"),
        ("[velocity]\nwindow_samples = 250", "250; give a whole number from 1 to 200"),
        ("[velocity]\ncutoff = 100.0", "cutoff is 100.0; give it as a share of the sampling rate"),
        ("[velocity]\norder = 2", "velocity.order is 2 without cutoff"),
        ("[velocity]\npolynomial = 2", "velocity.polynomial is 2 without window_samples"),
        ("[velocity]\nposition_variance = 1.0", "velocity.position_variance is given alone"),
        (
            "[position]\nwindow_samples = 3\npolynomial = 1",
            "polynomial is 1 for a filter; it makes",
        ),
        ("[velocity]\nnumerator = [1.0]", "velocity.numerator is given alone; give numerator and"),
        (
            '[position]\ncutoff = 0.1\nkind = "bessel"',
            "position.kind is 'bessel'; give low-p",
        ),
    ],
)
def test_a_bad_filter_is_refused_in_a_sentence(text: str, words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=words):
        AtlasSpec.from_toml(text)


# -------------------------------------------------------------------------------------- answers


def test_an_atlas_answers_for_its_estimator(atlas: jaxstab.Atlas, rng: np.random.Generator) -> None:
    for number, delay in enumerate(atlas.delays.tolist()):
        points = [rng.uniform(axis[0], axis[-1], 4000) for axis in atlas.nodes(number).values()]
        answer = atlas.query(**by_name(*points, delay))
        exact = jaxstab.verdict(**by_name(*points, delay), velocity=FIVE)
        is_decided = np.isin(answer.verdict, (jaxstab.Verdict.STABLE, jaxstab.Verdict.UNSTABLE))
        assert np.mean(is_decided) > 0.97
        assert not np.any(
            is_decided & (answer.verdict != exact) & (exact != jaxstab.Verdict.UNDECIDED)
        )
        assert np.any(
            exact != jaxstab.verdict(**by_name(*points, delay))
        )  # for the other loop it were wrong


def test_answers_hold_against_certified_roots(
    atlas: jaxstab.Atlas, rng: np.random.Generator
) -> None:
    nodes = atlas.nodes(1)
    judged = 0
    for _ in range(60):
        alpha, beta, gamma, delta = (rng.uniform(axis[0], axis[-1]) for axis in nodes.values())
        code = atlas.verdict(alpha, beta, gamma=gamma, delta=delta, delay=1.0)
        true = FilteredLoop(gamma, delta, 1.0, difference(5), average(1)).code(alpha, beta)
        if code != jaxstab.Verdict.UNDECIDED and true != jaxstab.Verdict.UNDECIDED:
            assert code == true
            judged += 1
    assert judged > 50


def test_what_it_leaves_open_is_computed_for_its_estimator(atlas: jaxstab.Atlas) -> None:
    delay, hand = 1.0, (0.0002, 0.003)
    limits = atlas.alpha_limits(0.1, **by_name(*hand, delay))
    point = (float(limits.upper), 0.1, *hand, delay)
    assert atlas.query(**by_name(*point)).verdict == jaxstab.Verdict.UNDECIDED
    exact = jaxstab.verdict(**by_name(*point), velocity=FIVE)
    assert atlas.query(**by_name(*point), exact=True).verdict == exact != jaxstab.Verdict.UNDECIDED


def test_the_file_says_its_estimator_in_words_and_numbers(atlas: jaxstab.Atlas) -> None:
    words = "velocity: the difference over a window of 5 samples; position: no filter"
    assert atlas.filters_in_words == words
    assert atlas.filters == (FIVE, Filter())
    assert words in CliRunner().invoke(main, ["atlas", "info", str(WINDOW)]).output


@pytest.mark.campaign
def test_every_product_of_a_window_of_twenty(tmp_path: Path) -> None:
    path = tmp_path / "window.h5"
    spec = AtlasSpec(
        alpha=FittedAxis(16),
        beta=FittedAxis(12),
        gamma=(0.0, 1e-3),
        delta=(0.0, 8e-3),
        delay=(1.0, 2.5),
        limit_cells=32,
        velocity=Velocity.difference(samples=20),
        products=("verdict", "alpha_limits", "fields", "outline", "summary"),
    )
    jaxstab.build_atlas(spec, path)
    result = CliRunner().invoke(main, ["atlas", "verify", str(path), "--sample", "100"])
    assert result.exit_code == 0, result.output
