"""The page of the measured paddle says what its data and its record say."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import measured, measured_page, record
from jaxstab import HapticLoop

DEGREES = 180.0 / np.pi
T = 350e-6
(RECORD,) = (
    one for one in record.read_all(record.RESULTS) if one["benchmark"] == "measured"
)  # fmt: skip
PAGE = measured_page.PAGE.read_text(encoding="utf-8")


def test_the_data_have_43_points_and_all_are_read() -> None:
    with Path(measured.DATA).open(encoding="utf-8") as lines:
        points = [(row["estimator"], float(row["damping"])) for row in csv.DictReader(lines)]
    assert len(points) == len(set(points)) == 43
    read = measured.curves()
    assert sum(len(damping) for damping, _ in read.values()) == 43
    assert all((np.diff(damping) > 0.0).all() for damping, _ in read.values())


def test_the_tables_of_the_page_are_those_of_the_record() -> None:
    for name, table in measured_page.tables(RECORD["rows"]).items():
        begin, end = (
            f"<!-- {measured_page.MARKER.format(name, side)} -->" for side in ("begin", "end")
        )
        assert f"{begin}\n{table}\n{end}" in PAGE


def test_the_errors_of_the_record_follow_from_its_limits_and_the_data() -> None:
    read = measured.curves()
    for row in RECORD["rows"]:
        if row["section"] != "rate":
            stiffness = read[row["estimator"]][1]
            misses = np.array(row["limits"].split(), float) - stiffness
            assert np.sqrt(np.mean(misses**2)) / stiffness.max() == pytest.approx(
                row["error"], rel=2e-3
            )


def test_the_inertia_of_the_ultimate_gains_is_gain_over_squared_frequency() -> None:
    for gain, period in ((0.07, 23e-3), (0.01345, 45e-3), (1.8, 23e-3)):
        inertia = gain * DEGREES * (period / (2.0 * np.pi)) ** 2
        assert f"{inertia:.1e} kg m^2" in PAGE


def test_the_curves_of_levant_and_of_the_difference_are_a_factor_of_two_apart() -> None:
    read = measured.curves()
    (at, low), (more, high) = read["difference_low_pass"], read["levant"]
    np.testing.assert_array_equal(at, more[: len(at)])
    assert (high[: len(at)] > 2.0 * low).all()


def steady_kalman() -> tuple[np.ndarray, np.ndarray]:
    """Transition and gain of the firmware's filter, after many updates of its covariance."""
    step = np.array([[1.0, T, 0.5 * T * T], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    covariance = np.eye(3)
    for _ in range(5000):
        covariance = step @ covariance @ step.T + np.diag([0.0, 0.0, 1e5])
        gain = covariance[:, 0] / (covariance[0, 0] + 4.8e-5)
        covariance = covariance - np.outer(gain, covariance[0])
    return step, gain


STEP, GAIN = steady_kalman()


def next_state(state: np.ndarray, row: dict[str, Any], wall: tuple[float, float]) -> np.ndarray:
    """One turn of the firmware and the motion of the paddle until the next."""
    whole = int(row["delay"])
    (x, v), past, smooth, kalman, forces = np.split(state, [2, 22, 23, 26])
    past = np.array([x, *past[:-1]])
    newest = past[0]
    slope = (past[0] - past[1]) / T
    if row["estimator"] == "foaw":
        slope, newest = np.polyfit(-T * np.arange(20.0), past, 1)
    low_pass = T / (T + 1.0 / (100.0 * np.pi))
    speed = (1.0 - low_pass) * smooth[0] + low_pass * slope
    kalman = STEP @ kalman
    for state_number in range(3):  # one after the other
        kalman[state_number] += GAIN[state_number] * (x - kalman[0])
    if row["estimator"] == "kalman":
        newest, seen = kalman[:2]
    else:
        seen = speed
    forces = np.array([-(wall[0] * newest + wall[1] * seen), *forces[:-1]])
    share, mass, damping = row["delay"] - whole, row["inertia"], row["damping"]
    for force, time in ((forces[whole + 1], share * T), (forces[whole], (1.0 - share) * T)):
        last, decay = force / damping, np.exp(-damping / mass * time)
        x = x + last * time + (v - last) * (1.0 - decay) * mass / damping
        v = last + (v - last) * decay
    return np.concatenate([[x, v], past, [speed], kalman, forces])


@pytest.mark.parametrize(
    ("fitted_to", "estimator", "number"),
    [("difference, low pass", "levant", 4), ("Kalman", "kalman", 3), ("Kalman", "foaw", 2)],
)
def test_linear_limits_agree_with_eigenvalues_of_the_firmware_turn_by_turn(
    fitted_to: str, estimator: str, number: int
) -> None:
    (row,) = (
        row
        for row in RECORD["rows"]
        if (row["section"], row.get("fitted_to"), row.get("estimator"))
        == ("linear", fitted_to, estimator)
    )
    damping, limit = (float(row[column].split()[number]) for column in ("at", "limits"))
    states = np.eye(26 + int(row["delay"]) + 2)
    for share, is_stable in ((0.998, True), (1.002, False)):  # the record has four digits
        wall = share * limit * DEGREES, damping * DEGREES
        turn = np.array([next_state(state, row, wall) for state in states]).T
        assert (np.abs(np.linalg.eigvals(turn)).max() < 1.0) == is_stable


def test_a_double_integrator_has_the_ratios_of_the_page() -> None:
    def limits(delays: tuple[float, ...], damping: float | None = None) -> list[float]:
        found = []
        for delay in delays:
            loop = HapticLoop(
                device_mass=1.0, device_damping=0.0, sample_time=5e-3, delay=delay * 5e-3
            )
            if damping is None:
                best = loop.region().stiffest
                assert best is not None
                found.append(best.stiffness)
            else:
                found.append(float(loop.stiffness_limits(damping)[1]))
        return [stiffness / found[-1] for stiffness in found]

    best, small = limits((0.5, 1.5, 2.5)), limits((0.0, 1.0, 2.5), 1e-3)
    assert "5.85 : 1.99 : 1" in PAGE
    assert best == pytest.approx([5.85, 1.99, 1.0], abs=5e-3)
    assert small == pytest.approx([6.0, 2.0, 1.0], rel=1e-3)
