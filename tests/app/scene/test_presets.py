"""Presets of devices and software: each number has a source, each estimator is what it says."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from jaxstab.app.scene import Scene
from jaxstab.app.scene.scene import PositionTable, VelocityTable, numbers_in, presets, values_in
from jaxstab.model import Filter, Velocity
from jaxstab.model.filters import exact_chain, rounded

DATA = Path(__file__).parents[3] / "data" / "presets"
ALL = {**presets("devices"), **presets("software")}
DOCUMENTED = [name for name, preset in presets("software").items() if numbers_in(preset)]


@pytest.mark.parametrize("name", ALL)
def test_each_preset_has_a_title_and_each_number_a_unit_a_source_and_a_date(name: str) -> None:
    preset = ALL[name]
    assert preset["title"]
    assert numbers_in(preset) or preset["note"]
    for number in numbers_in(preset).values():
        assert [*number] == ["value", "unit", "source", "date"]
        assert number["unit"]
        assert number["source"]
        assert number["date"][:4].isdigit()


def test_what_no_maker_publishes_is_called_assumed() -> None:
    for name in ("omega", "falcon"):
        preset = presets("devices")[name]
        assert preset["mass"]["source"] == preset["damping"]["source"] == "assumed"
    assert "assumed" in presets("software")["force-dimension-sdk"]["window"]["source"]
    assert "assumed" in str(VelocityTable.from_table({"preset": "force-dimension-sdk"}))


def test_the_limits_of_chai3d_are_there_for_each_device_but_none_is_used() -> None:
    for preset in presets("devices").values():
        assert {"largest_stiffness", "largest_damping"} <= preset.keys()
    device = Scene.from_table({"device": {"preset": "omega"}, "controller": {"sample_time": 1e-3}})
    assert device.walls == {}


@pytest.mark.parametrize("name", DOCUMENTED)
def test_each_documented_estimator_makes_a_scene_at_its_own_rate(name: str) -> None:
    meant = values_in(presets("software")[name], ["sample_time"]).get("sample_time", 1e-3)
    scene = Scene.from_table(
        {
            "device": {"preset": "omega"},
            "controller": {"sample_time": meant, "velocity": {"preset": name}},
        }
    )
    assert scene.unusual() == []
    assert name in str(scene.controller.velocity)


def as_run(name: str, positions: np.ndarray, period: float) -> np.ndarray:
    """The velocities that the source of a software computes, line by line."""
    padded = np.concatenate([np.zeros(60), positions])
    found = []
    smooth = [0.0, 0.0]
    for k in range(60, len(padded)):
        if name == "hapkit":
            raw = (padded[k] - padded[k - 1]) / 0.0001
            value = -(0.95 * 0.95) * smooth[-2] + 2 * 0.95 * smooth[-1] + (1 - 0.95) ** 2 * raw
        else:
            window = {"chai3d": 0.015, "chai3d-rotation": 0.030}.get(name, 0.020)
            samples = round(window / period)
            value = (padded[k] - padded[k - samples]) / window
            if name == "ros-force-dimension":
                value = smooth[-1] + 0.15 * (value - smooth[-1])
        smooth = [smooth[-1], value]
        found.append(value)
    return np.array(found)


@pytest.mark.parametrize("name", DOCUMENTED)
def test_each_documented_estimator_is_what_its_source_computes(name: str) -> None:
    period = {"ros-force-dimension": 0.0005, "hapkit": 0.0001}.get(name, 0.001)
    positions = np.random.default_rng(0).normal(size=200)
    smoothing = VelocityTable.from_table({"preset": name}).as_velocity().filter.checked(period)
    sides = map(rounded, exact_chain(smoothing.sections))
    velocities = lfilter(*sides, np.diff(positions, prepend=0.0) / period)
    expected = as_run(name, positions, period)
    np.testing.assert_allclose(velocities, expected, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("table", "made"),
    [
        ({"window": 0.02}, Velocity.difference(window=0.02)),
        ({"window_samples": 5}, Velocity.difference(5)),
        ({"cutoff": 100.0}, Velocity.low_pass(100.0)),
        (
            {"cutoff": 80.0, "order": 2, "kind": "butterworth", "window_samples": 3},
            Velocity.difference(3) * Filter.butterworth(80.0, order=2),
        ),
        ({"factor": 0.2}, Velocity.exponential(0.2)),
        (
            {"acceleration_variance": 100.0, "position_variance": 1e-10, "cutoff": 100.0},
            Velocity.kalman(100.0, 1e-10) * Filter.low_pass(100.0),
        ),
        ({"window_samples": 9, "polynomial": 2}, Velocity.savitzky_golay(9, order=2)),
        (
            {"numerator": [25.0, -25.0, 0.0], "denominator": [1.0, -1.9, 0.9025]},
            Velocity.transfer_function([25.0, -25.0, 0.0], [1.0, -1.9, 0.9025]),
        ),
        ({"preset": "chai3d"}, Velocity.difference(window=0.015)),
        ({"preset": "chai3d", "window_samples": 14}, Velocity.difference(14)),
        (
            {"preset": "force-dimension-sdk", "cutoff": 30.0},
            Velocity.difference(window=0.020) * Filter.low_pass(30.0),
        ),
    ],
)
def test_a_table_is_the_estimator_that_it_says(table: dict[str, Any], made: Velocity) -> None:
    assert VelocityTable.from_table(table).as_velocity() == made


def test_a_table_of_the_position_is_the_filter_that_it_says() -> None:
    table = {"window_samples": 4, "cutoff": 50.0}
    made = PositionTable.from_table(table).as_filter()
    assert made == Filter.average(4) * Filter.low_pass(50.0)
