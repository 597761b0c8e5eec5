"""Outlines and summaries of slices in an atlas, from the closed form."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import truth
from jaxstab import (
    Atlas,
    AtlasSpec,
    FittedAxis,
    build_atlas,
    minimize_radius,
    open_atlas,
    plan_atlas,
    stable_region,
)
from jaxstab.pictures.atlas import draw_atlas

SLICES = AtlasSpec(
    alpha=FittedAxis(8),
    beta=FittedAxis(8),
    gamma=[0.0, 0.001],
    delta=[0.0, 0.005, 0.015],
    delay=[0.0, 1.5],
    products=["outline", "summary"],
)


@pytest.fixture(scope="module")
def atlas(tmp_path_factory: pytest.TempPathFactory) -> Atlas:
    return build_atlas(SLICES, tmp_path_factory.mktemp("slices") / "slices.h5")


@pytest.mark.campaign
def test_outlines_and_corners_are_those_of_the_region(atlas: Atlas) -> None:
    for gamma, delta, delay in ((0.0, 0.0, 0.0), (0.001, 0.005, 0.0), (0.0, 0.015, 1.5)):
        region = stable_region(gamma=gamma, delta=delta, delay=delay)
        outline = atlas.outline(gamma=gamma, delta=delta, delay=delay)
        assert outline.status == 0
        np.testing.assert_array_equal(outline.points, region.points)
        np.testing.assert_array_equal(outline.branch, region.branch)
        np.testing.assert_array_equal(outline.corners, region.corners)


def test_the_points_have_a_root_on_the_unit_circle(atlas: Atlas) -> None:
    outline = atlas.outline(gamma=0.001, delta=0.015, delay=1.5)
    for alpha, beta in outline.points[::200].tolist():
        moduli = [abs(root) for root in truth.roots(alpha, beta, 0.001, 0.015, 1.5)]
        assert min(abs(modulus - 1) for modulus in moduli) < 1e-9


def test_summaries_are_the_closed_forms(atlas: Atlas) -> None:
    at = {name: atlas.arrays[name][0, 0, 0] for name in atlas.arrays if "least" in name}
    assert at["least_radius"] == pytest.approx(4 ** (1 / 3) - 1, abs=1e-12)
    assert at["alpha_of_least_radius"] == pytest.approx(6 * at["least_radius"] ** 2 - 2, abs=1e-9)
    assert at["beta_of_least_radius"] == pytest.approx(2 * at["least_radius"] ** 3, abs=1e-9)
    assert atlas.arrays["largest_alpha"][0, 0, 0] == pytest.approx(12 - 8 * 2**0.5, rel=1e-12)
    assert atlas.arrays["beta_of_largest_alpha"][0, 0, 0] == pytest.approx(2 * 2**0.5 - 2, 1e-7)
    assert atlas.arrays["largest_beta"][0, 0, 0] == pytest.approx(2.0, rel=1e-12)
    # The integral of 2 b (2 - b) / (b + 2) over 0 < b < 2
    assert atlas.arrays["stable_area"][0, 0, 0] == pytest.approx(12 - 16 * np.log(2), rel=1e-9)
    other = minimize_radius(gamma=0.001, delta=0.005, delay=1.5)
    assert atlas.arrays["least_radius"][1, 1, 1] == pytest.approx(float(other.value), abs=1e-12)


def test_what_is_not_there_is_refused_in_a_sentence(atlas: Atlas, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"delta is 0.004; outlines are at its nodes 0.0, 0.005"):
        atlas.outline(gamma=0.0, delta=0.004, delay=0.0)
    verdicts = build_atlas(
        AtlasSpec(
            alpha=[0, 0.1],
            beta=[0, 0.1],
            gamma=[0.0],
            delta=[0.0],
            delay=[0.0],
            products=["verdict"],
        ),
        tmp_path / "verdicts.h5",
    )
    with pytest.raises(ValueError, match="holds no outlines"):
        verdicts.outline(gamma=0.0, delta=0.0, delay=0.0)
    assert open_atlas(tmp_path / "verdicts.h5").products == ("verdict",)


def test_a_picture_needs_verdicts_or_radii(atlas: Atlas) -> None:
    assert atlas.products == ("outline", "summary")
    with pytest.raises(ValueError, match=r"holds outline, summary; a picture needs one of"):
        draw_atlas(atlas, 0.0, 0.0)


def test_the_plan_says_that_no_grid_is_needed() -> None:
    assert "outline: 12 slices, each from the closed form, without a grid" in str(
        plan_atlas(SLICES)
    )
