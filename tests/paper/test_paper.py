"""The paper's figures and the region command: what is drawn is what the captions say."""

import json
from math import pi

import numpy as np
import pytest
from click.testing import CliRunner

from jaxstab.app.cli.main import main
from jaxstab.app.pictures.plane import paper_figure, region_figure
from jaxstab.drawing import picture
from jaxstab.paper import linear_validity


def lines(panel):
    return [np.asarray(line.get_xydata()) for line in panel.get_lines()]


def outlines(panel):
    return [points for points in lines(panel) if len(points) > 20]


def panels(number):
    return paper_figure(number).axes


def test_figure_4_shows_the_four_limits_of_the_haptic_range_without_delay():
    (panel,) = panels(4)
    assert len(outlines(panel)) == 4
    free = outlines(panel)[0]
    assert np.max(free[:, 0]) == pytest.approx(12 - 8 * np.sqrt(2), rel=1e-5)
    assert np.max(free[:, 1]) == pytest.approx(2.0, rel=1e-12)


def test_figure_5_has_its_left_edges_at_minus_gamma():
    (panel,) = panels(5)
    edges = [np.min(points[:, 0]) for points in outlines(panel)]
    assert edges == pytest.approx([0.0, -1e-3, 0.0, -1e-3], abs=1e-12)
    assert panel.get_xlim()[0] < -1e-3 < 0.0 < panel.get_xlim()[1] < 0.01


def test_figure_6_has_one_and_two_samples_of_delay():
    tops = [np.max(outlines(panel)[0][:, 0]) for panel in panels(6)]
    assert tops == pytest.approx([0.144469345, 0.062430490], rel=1e-5)


@pytest.mark.campaign
def test_figure_7_marks_2_and_5_percent():
    drawn = panels(7)
    assert len(drawn) == 4
    for panel, (delay, gamma) in zip(
        drawn, [(0.0, 0.0), (0.0, 1e-3), (1.0, 0.0), (1.0, 1e-3)], strict=True
    ):
        marks = sorted(tuple(points[0]) for points in lines(panel) if len(points) == 1)
        scenes = [(level, delta) for delta in (0.0, 0.005, 0.01, 0.015) for level in (0.02, 0.05)]
        found = (
            linear_validity(level, gamma=gamma, delta=delta, delay=delay) for level, delta in scenes
        )
        assert marks == sorted((float(point.alpha), float(point.beta)) for point in found)


@pytest.mark.parametrize(
    ("number", "rows"), [(8, [(0.0, 0)]), (9, [(1.0, 0)]), (10, [(0.0, 1), (1.0, 1)])]
)
def test_figures_8_to_10_go_up_to_half_and_to_all_of_nyquist_frequency(number, rows):
    drawn = panels(number)
    assert len(drawn) == 2 * len(rows)
    for place, panel in enumerate(drawn):
        delta, _ = rows[place // 2]
        frequency = pi * (0.5 if place % 2 == 0 else 1.0)
        left = [np.min(points[:, 0]) for points in outlines(panel)]
        assert len(left) == 6
        largest = frequency**2 + delta**2 / 4
        assert min(left) == pytest.approx(-largest, rel=1e-3) or number == 10
        assert len(panel.patches) == (1 if delta else 0)  # the passive region


def test_there_are_no_other_figures():
    with pytest.raises(ValueError, match="no figure 3"):
        paper_figure(3)


def test_a_region_is_drawn_with_its_numbers():
    figure = region_figure(1e-3, 0.015, 1.0)
    words = " ".join(text.get_text() for text in figure.legends[0].get_texts())
    for expected in ("stable region", "passive region", "linear condition", "corners", "0.1517"):
        assert expected in words


@pytest.mark.parametrize(("form", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_a_picture_is_a_file_of_its_format(form, start):
    assert picture(region_figure(0.0, 0.0, 0.0), form).startswith(start)


def test_the_figure_command_writes_a_file(tmp_path):
    result = CliRunner().invoke(main, ["figure", "5", "-o", str(tmp_path), "--format", "svg"])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "figure_5.svg").read_bytes().startswith(b"<?xml")
    assert "figure_5.svg" in result.stdout


def test_the_region_command_prints_the_numbers():
    arguments = ["region", "--gamma", "0", "--delta", "0", "--delay", "0"]
    facts = json.loads(CliRunner().invoke(main, [*arguments, "--json"]).stdout)
    assert facts["largest_alpha"] == pytest.approx([12 - 8 * 2**0.5, 2 * 2**0.5 - 2], rel=1e-9)
    assert facts["largest_beta"] == pytest.approx([0.0, 2.0], abs=1e-9)
    numbers = [value for point in [*facts["corners"], facts["largest_beta"]] for value in point]
    assert facts["largest_beta"][0] == 0.0  # on the line alpha = -gamma, without noise
    assert not any(np.signbit(value) for value in numbers)
    # The integral of 2 b (2 - b) / (b + 2) over 0 ... 2.
    assert facts["area"] == pytest.approx(12 - 16 * np.log(2), rel=1e-9)
    alpha, beta = facts["linear_condition_within_2_percent_up_to"]
    assert alpha == pytest.approx(0.038827412153, rel=1e-10)
    assert (2 * beta - alpha) / alpha == pytest.approx(0.02, rel=1e-10)
    assert facts["largest_passive_alpha"] == [0.0, 0.0]
    words = CliRunner().invoke(main, arguments).stdout
    assert "largest alpha" in words
    assert "0.6862915" in words


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["region", "--gamma", "0", "--delta", "0", "--delay", "-1"], "delay is -1"),
        (["region", "--gamma", "nan", "--delta", "0"], "gamma is nan"),
        (["region", "--gamma", "0", "--delta", "0", "--radius", "0.1"], "no wall is stable"),
        (["figure", "11"], "11"),
    ],
)
def test_commands_refuse_in_one_sentence(arguments, sentence):
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code != 0
    assert sentence in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
