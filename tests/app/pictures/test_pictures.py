"""Pictures show what is asked, with labels that agree with the text."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign import first, many
from commands import run
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

import jaxstab
from jaxstab.answers import Units
from jaxstab.app.pictures.scene import guard_figure, scene_figure, study_figure
from jaxstab.app.scene import (
    Scene,
    check_walls,
    design_loop,
    scene_limits,
    simulate_contacts,
    tune_walls,
)
from jaxstab.drawing import picture, plain

ROOT = Path(__file__).parents[3]

WINDOW = jaxstab.Velocity.difference(window=0.02)
TABLE: dict[str, Any] = {
    "device": {"mass": 0.25, "damping": 0.1},
    "controller": {"sample_time": 1e-3, "delay_samples": 1.0},
    "walls": {
        "soft": {"stiffness": 500.0, "damping": 5.0},
        "stiff": {"stiffness": 4e4, "damping": 5.0},
    },
}
HAND = {"mass": [0.0, 1.0], "stiffness": [0.0, 700.0], "damping": [0.0, 12.0]}
MODES = [
    {"frequency": 60.0 + 20.0 * number, "damping_ratio": 0.02, "modal_mass": 0.5 + number}
    for number in range(4)
]


def labels_of(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def marks_of(panel: Axes) -> dict[str, np.ndarray[Any, Any]]:
    """The points of each label that has a mark."""
    lines = [line for line in panel.get_lines() if line.get_marker() != "None"]
    return {str(line.get_label()): np.asarray(line.get_xydata()) for line in lines}


@pytest.mark.parametrize("delay", [0.0, 1e-3])
def test_the_main_component_fills_the_axes(delay: float) -> None:
    loop = jaxstab.HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=delay, velocity=WINDOW
    )
    region = loop.region()
    main = region.main
    assert main is not None
    assert region.islands
    for axes in (loop.plot(ax=Figure().subplots()), region.plot(Figure().subplots())):
        for (low, high), ends, extent in zip(
            (axes.get_xlim(), axes.get_ylim()), main.outline.T, main.extent, strict=True
        ):
            assert low < ends.min()
            assert ends.max() < high
            assert extent > 0.5 * (high - low)
        (inset,) = axes.child_axes
        (left, right), (bottom, top) = inset.get_xlim(), inset.get_ylim()
        for island in region.islands:
            (least_k, least_b), (most_k, most_b) = island.outline.min(0), island.outline.max(0)
            assert left < least_k < most_k < right
            assert bottom < least_b < most_b < top
    without = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
    assert not without.plot(ax=Figure().subplots()).child_axes


def test_limits_draw_the_walls_and_what_all_hands_allow() -> None:
    scene = Scene.from_table(TABLE | {"hand": HAND})
    limits = scene_limits(scene)
    figure = scene_figure(scene, limits)
    marks = marks_of(figure.axes[0])
    assert marks["wall, stable"].tolist() == [[500.0, 5.0]]
    assert marks["wall, unstable"].tolist() == [[4e4, 5.0]]
    assert {text.get_text() for text in figure.axes[0].texts} >= {"soft", "stiff"}
    assert "stable for the hands at all corners of the range" in labels_of(figure)
    assert not any(text.get_text().endswith(" ms") for text in figure.axes[0].texts)


@pytest.mark.campaign
def test_check_draws_how_far_each_gain_may_go_alone_and_the_responses() -> None:
    scene = Scene.from_table(TABLE | {"hand": HAND})
    checked = check_walls(scene)
    plane, responses = scene_figure(scene, checked).axes
    (label,) = {patch.get_label() for patch in plane.patches} - {"stable"}
    assert label == "stable for the hands at all corners of the range"
    crosses = [line.get_xydata() for line in plane.get_lines() if line.get_marker() in "|_"]
    wall = checked.walls["soft"]
    assert wall.stiffness_limits is not None
    assert wall.damping_limits is not None
    along, across = (np.asarray(cross) for cross in crosses)  # of the stable wall alone
    np.testing.assert_allclose(along, [(k, 5.0) for k in wall.stiffness_limits])
    np.testing.assert_allclose(across, [(500.0, b) for b in wall.damping_limits])
    assert len(responses.get_lines()) == 2


def test_tune_draws_what_it_answers() -> None:
    scene = Scene.from_table(TABLE | {"wanted": {"at_stiffness": 2000.0}})
    tuned = tune_walls(scene)
    (panel,) = scene_figure(scene, tuned).axes
    assert 1 <= len({text.get_text() for text in panel.texts if " ms" in text.get_text()}) <= 3
    marks = marks_of(panel)
    by_word = {label.split(":")[0]: points for label, points in marks.items()}
    for words, best in (
        ("fastest", tuned.least_settling.rounded),
        ("smallest radius", tuned.least_radius.rounded),
    ):
        assert best is not None
        assert by_word[words].tolist() == [[best.stiffness, best.damping]]
    given = tuned.walls["soft"].rounded, tuned.at_given_stiffness.rounded
    expected = [[one.stiffness, one.damping] for one in given]
    assert by_word["best damping at a given stiffness"].tolist() == expected


@pytest.mark.campaign
def test_design_draws_what_it_answers() -> None:
    scene = Scene.from_table(TABLE | {"wanted": {"stiffness": 20000.0}})
    design = design_loop(scene)
    loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3)
    longest = design.sample_time.largest_sample_time, design.delay.largest_delay
    for panel, found, name in zip(
        scene_figure(scene, design).axes, longest, ("sample time", "delay"), strict=True
    ):
        assert panel.get_xlabel() == f"{name} (ms)"
        curve, wanted, _, mark = panel.get_lines()
        assert set(wanted.get_ydata()) == {20000.0}
        assert np.ravel(mark.get_xydata()).tolist() == [1e3 * found, 20000.0]
        times, stiffness = curve.get_data()
        assert np.interp(1e3 * found, times, stiffness) == pytest.approx(20000.0, rel=1e-2)
        for time, value in list(zip(times, stiffness, strict=True))[::40]:
            changed = {"sample_time": time / 1e3} if name == "sample time" else {}
            delay = {"delay": time / 1e3}  # of one sample, where the sample time changes
            exact = replace(loop, **changed, **delay).limits().stiffness
            assert value == pytest.approx(exact, rel=1e-9)
    none = Scene.from_table(TABLE | {"wanted": {"stiffness": 1e9}, "walls": {}})
    for panel in scene_figure(none, design_loop(none)).axes:
        assert not any(str(line.get_label()).startswith("largest d") for line in panel.get_lines())


@pytest.mark.campaign
@pytest.mark.parametrize("count", [1, 4][: many(2, small=1)])
def test_nothing_of_a_device_with_modes_is_cut_off(count: int) -> None:
    device = TABLE["device"] | {
        "modes": MODES[:count],
        "actuator": {"bandwidth": 300.0},
        "encoder": {"resolution": 1e-5},
    }
    grip = {"stiffness": 2000.0, "damping": 4.0}
    hand = {"mass": [0.0, 0.5], "damping": [0.0, 5.0], "grip": grip}
    velocity = {"window_samples": 20, "cutoff": 300.0, "order": 2, "kind": "butterworth"}
    table = TABLE | {"device": device, "hand": hand, "walls": {}}
    table["controller"] = TABLE["controller"] | {"velocity": velocity}
    figure = scene_figure(Scene.from_table(table))
    figure.draw_without_rendering()
    assert figure.get_suptitle()
    for part in (*figure.legends, *figure.texts, *(panel.title for panel in figure.axes)):
        box = part.get_window_extent()
        assert figure.bbox.x0 <= box.x0, part
        assert box.x1 <= figure.bbox.x1, part
        assert figure.bbox.y0 <= box.y0, part
        assert box.y1 <= figure.bbox.y1, part


@pytest.mark.campaign
@pytest.mark.parametrize(
    "command",
    [
        ["limits", "--wall", "soft", "500", "5"],
        ["tune", "--wall", "soft", "500", "5"],
        ["design", "--stiffness", "2000"],
    ],
)
def test_commands_draw_their_answers(command: list[str], tmp_path: Path) -> None:
    picture = tmp_path / "answer.svg"
    loop = ["--mass", "0.25", "--damping", "0.1", "--sample-time", "0.001"]
    done = run(*command, *loop, "--plot", picture)
    assert done.exit_code == 0, done.stderr
    assert picture.stat().st_size > 10_000


def test_an_atlas_draws_the_walls_of_a_loop_in_si_units() -> None:
    window = jaxstab.Velocity.difference(window=0.005)
    device = {"device_mass": 0.2, "device_damping": 2.0, "sample_time": 1e-3, "delay": 1e-3}
    loop = jaxstab.HapticLoop(**device, velocity=window)
    walls = jaxstab.open_atlas(ROOT / "data/golden/atlas-v5-window.h5").for_loop(loop)
    axes = walls.plot(Figure().subplots())
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("stiffness K (N/m)", "damping B (N s/m)")
    assert "window of 5 samples" in axes.get_title()
    (mesh,) = axes.collections
    codes = np.asarray(mesh.get_array())
    stiffness, damping = (np.linspace(*ends, 400) for ends in (axes.get_xlim(), axes.get_ylim()))
    exact = loop.verdict(stiffness[::20], damping[::20, None])
    decided = codes[::20, ::20] != jaxstab.Verdict.UNDECIDED
    assert decided.mean() > 0.9
    # Cells are drawn around their walls, so next to the boundary a cell may have the other verdict.
    assert (codes[::20, ::20] == exact)[decided].mean() > 0.98


# ------------------------------------------------------------------------------------ texts


def boxes_of_texts(panel: Axes) -> dict[str, Bbox]:
    """The pixels of each text in axes; names of walls and values of lines are different texts."""
    words = {text.get_text(): Text.get_window_extent(text) for text in panel.texts}
    words.pop("", None)  # lines that lead to names
    return words


def assert_texts_hide_nothing(figure: Figure, panel: Axes) -> None:
    figure.draw_without_rendering()
    boxes = list(boxes_of_texts(panel).values())
    assert boxes
    for number, box in enumerate(boxes):
        assert panel.bbox.contains(*box.min)
        assert panel.bbox.contains(*box.max)
        assert not box.count_overlaps(boxes[number + 1 :])
    for points in marks_of(panel).values():
        for pixel in panel.transData.transform(points):
            assert not any(box.contains(*pixel) for box in boxes)


CROWDED = {
    f"a wall with a long name, number {k}": {"stiffness": 1000.0 + 60.0 * k, "damping": 10.0}
    for k in range(6)
}


@pytest.mark.parametrize(
    "walls",
    [TABLE["walls"], pytest.param(CROWDED, marks=pytest.mark.campaign)],
    ids=["two", "crowded"],
)
@pytest.mark.parametrize("ask", first([scene_limits, check_walls, tune_walls], 1))
def test_texts_cover_neither_marks_nor_each_other(ask: Any, walls: dict[str, Any]) -> None:
    device = TABLE["device"] | {"encoder": {"resolution": 1e-5}}
    scene = Scene.from_table(TABLE | {"walls": walls, "device": device})
    figure = scene_figure(scene, ask(scene))
    panel = figure.axes[0]
    texts = boxes_of_texts(panel)
    if ask is tune_walls:
        assert any(text.endswith(" ms") for text in texts)
    assert all(any(text.endswith(name[-10:]) for text in texts) for name in walls)
    assert_texts_hide_nothing(figure, panel)


@pytest.mark.campaign
def test_a_map_of_contacts_names_its_conditions_and_its_colours() -> None:
    walls = {
        "passive": {"stiffness": 2500.0, "damping": 0.0},
        "next to it": {"stiffness": 2400.0, "damping": 1.0},
    }
    contact = {"push": 2.0, "speed": 0.05, "duration": 0.2}
    scene = Scene.from_table(TABLE | {"walls": walls, "contact": contact})
    figure = scene_figure(scene, simulate_contacts(scene))
    panel = figure.axes[0]
    title = panel.get_title()
    assert "push 2 N, speed 0.05 m/s, friction 0 N" in title
    assert "one-sided wall" in title
    assert "velocity: " in figure.get_suptitle()
    assert_texts_hide_nothing(figure, panel)
    (legend,) = figure.legends
    (swatch,) = legend.get_patches()
    rests = next(
        mesh for mesh in panel.collections if isinstance(mesh, QuadMesh) and mesh.cmap.N == 1
    )
    assert swatch.get_facecolor() == tuple(rests.cmap(0.5))
    both = replace(scene, contact=replace(scene.contact, one_sided=False))
    assert "wall that also pulls" in scene_figure(both, simulate_contacts(both)).axes[0].get_title()
    gated = replace(scene, contact=replace(scene.contact, gate="force"))
    title = scene_figure(gated, simulate_contacts(gated)).axes[0].get_title()
    assert "one-sided wall, gated by its force" in title


@pytest.mark.campaign
def test_the_proved_area_of_a_moving_delay_holds_the_walls_that_are_called_stable() -> None:
    walls = {
        "soft": {"stiffness": 5.0, "damping": 0.05},  # below the lowest damping of the picture
        "firm": {"stiffness": 1700.0, "damping": 12.4},
        "damped": {"stiffness": 100.0, "damping": 44.0},
        "stiff": {"stiffness": 5000.0, "damping": 30.0},
    }
    controller = {"sample_time": 1e-3, "delay_samples": [0.8, 1.2]}
    controller |= {"velocity": {"window_samples": 20}}
    scene = Scene.from_table(TABLE | {"controller": controller, "walls": walls})
    (panel,) = scene_figure(scene).axes
    marks = marks_of(panel)
    assert len(marks["wall, stable"]) == 3
    assert len(marks["wall, unstable"]) == 1
    (area,) = panel.collections
    (path,) = area.get_paths()
    at_edge = path.contains_points(marks["wall, stable"], radius=-1e-9)
    assert (at_edge | path.contains_points(marks["wall, stable"], radius=1e-9)).all()
    assert not path.contains_points(marks["wall, unstable"]).any()


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("2.5e-05 kg m^2", r"2.5$\,\times 10^{-5}$ kg m²"),
        ("3e+11 N/m", r"3$\,\times 10^{11}$ N/m"),
        ("for 5 $", r"for 5 \$"),
        ("wall 2 east", "wall 2 east"),
    ],
)
def test_powers_are_raised_and_dollars_begin_no_formula(text: str, shown: str) -> None:
    assert plain(text) == shown


@pytest.mark.campaign
def test_small_inertias_are_written_as_powers_of_ten() -> None:
    tiny = {"inertia": 2.2e-7, "damping": 1e-7}
    walls = {"w": {"stiffness": 0.01, "damping": 3e-5}}
    scene = Scene.from_table({**TABLE, "device": tiny, "walls": walls})
    figure = scene_figure(scene, tune_walls(scene))
    image = picture(figure, "svg").decode()
    assert not re.search(r"\de-0?\d", " ".join(re.findall("<!-- (.*?) -->", image)))
    labels = labels_of(figure)
    assert any("10^{-5}" in label for label in labels)
    assert all(len(label) < 100 for label in labels)


def test_a_guard_names_what_its_curves_are_for() -> None:
    device = {"device_mass": 2.5e-5, "device_damping": 1e-6, "sample_time": 1e-3}
    ranges: Any = {"mass": (2.3e-5, 2.7e-5), "delay": (3e-4, 7e-4)}
    loop, few = jaxstab.HapticLoop(**device, delay=1e-3), (1, 1, 2)
    guard = jaxstab.build_guard(loop, jaxstab.HandRange(), **ranges, cells=few, constant_delay=True)
    left, right = guard_figure(guard, Units.ROTATION).axes
    assert left.get_title() == r"five delays; inertia 2.5$\,\times 10^{-5}$ kg m²"
    assert right.get_title() == "five inertias; delay 0.5 ms"
    assert "kg m²" in right.get_legend().get_texts()[0].get_text()


@pytest.mark.parametrize(
    ("of", "over"),
    first(
        [
            ({}, {"device.preset": ["omega", "falcon", "phantom"]}),
            ({"device": {"inertia": 1e-4, "damping": 1e-3}}, {"device.inertia": (1e-4, 5e-4, 7)}),
            ("simulator", {"loop.inertia": (0.1, 0.5, 7), "loop.substeps": [1, 2]}),
            ("admittance", {"loop.environment": (1e3, 2e4, 5)}),
        ],
        1,
    ),
)
def test_ticks_of_a_study_stand_apart_and_axes_have_names(of: Any, over: dict[str, Any]) -> None:
    table = TABLE | {"walls": {}} | of if isinstance(of, dict) else GAINS / f"{of}.toml"
    if over.keys() == {"device.preset"}:
        table = TABLE | {"walls": {}, "device": {}}
    figure = study_figure(jaxstab.study(table, over, answers=["limits"]))
    picture(figure, "png")
    panel = figure.axes[0]
    labels = [tick.get_window_extent() for tick in panel.get_xticklabels() if tick.get_text()]
    seen = [box for box in labels if panel.bbox.x0 - 1.0 <= (box.x0 + box.x1) / 2]
    assert all(a.x1 < b.x0 for a, b in pairwise(seen))
    words = panel.get_xlabel() + panel.get_ylabel()
    words += panel.get_legend().get_title().get_text() if panel.get_legend() else ""
    assert not any(key in words for key in over)
    assert "joint (kg m²)" in words or of != "simulator"


GAINS = ROOT / "data" / "scenes" / "gains"
