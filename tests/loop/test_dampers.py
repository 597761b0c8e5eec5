"""Pure dampers: walls without a spring on a device that nothing holds, which may drift."""

import json
from typing import Any

import numpy as np
import pytest
from commands import run
from scipy.signal import butter, cont2discrete

from jaxstab import Device, Filter, HapticLoop, Mode, Velocity
from jaxstab.answers import BUT_FOR_DRIFT
from jaxstab.app.scene import Scene, check_walls
from jaxstab.app.scene.loops import verdict_with_drift
from jaxstab.conventions import Verdict

T = 1e-3
DEVICE: dict[str, Any] = {"device_mass": 0.1, "device_damping": 0.1, "sample_time": T}
FREE = ["--mass", "0.1", "--damping", "0.1", "--sample-time", "0.001", "--delay", "0.001"]
WORDS = "stable but for the position, which nothing holds"

# position over force in s, the estimator in z less its difference, and the loop with both
MASS = [1.0], [0.1, 0.1, 0.0]
VIBRATING = [1.0, 40.0, 1.2e5], np.polymul([0.1, 0.1, 0.0], [0.9, 40.0, 1.2e5])
LOOPS = {
    "difference": (MASS, ([1.0], [1.0]), HapticLoop(**DEVICE, delay=T)),
    "a window": (
        MASS,
        ([0.05] * 20, [1.0] + [0.0] * 19),
        HapticLoop(**DEVICE, delay=2 * T, velocity=Velocity.difference(20)),
    ),
    "Butterworth": (
        MASS,
        butter(2, 100.0, fs=1.0 / T),
        HapticLoop(**DEVICE, velocity=Velocity.butterworth(100.0, order=2)),
    ),
    "a device with a mode": (
        VIBRATING,
        ([1.0], [1.0]),
        HapticLoop(device=Device.transfer_function(*map(list, VIBRATING)), sample_time=T, delay=T),
    ),
}


def roots_beside_1(name: str, damping: float) -> np.ndarray:
    """Return the poles but for the one at z = 1, of a polynomial formed by scipy alone."""
    plant, (above, below), loop = LOOPS[name]
    numerator, denominator, _ = cont2discrete(plant, T, "zoh")
    estimate = np.polymul(above, [damping / T, -damping / T])
    free = np.polymul(np.polymul(denominator, below), [1.0] + [0.0] * (1 + round(loop.delay / T)))
    roots = np.roots(np.polyadd(free, np.polymul(np.ravel(numerator), estimate)))
    return np.delete(roots, np.argmin(np.abs(roots - 1.0)))


@pytest.mark.parametrize("name", LOOPS)
def test_a_damper_is_stable_if_all_poles_but_that_of_the_position_are(name: str) -> None:
    loop = LOOPS[name][2]
    low, high = loop.damping_limits(0.0)
    assert low < 0.0 < high
    for share in (0.01, 0.5, 1.0 - 1e-6, 1.0 + 1e-6, 1.5):
        radius = np.abs(roots_beside_1(name, share * high)).max()
        code = verdict_with_drift(loop, 0.0, share * high)
        assert code == (BUT_FOR_DRIFT if share < 1.0 else Verdict.UNSTABLE)
        assert (radius < 1.0) == (share < 1.0)
    assert loop.verdict(0.0, 0.5 * high) != Verdict.STABLE  # with the position it is not


def test_a_damper_without_any_damping_is_decided_only_if_the_device_slows_down() -> None:
    still = HapticLoop(**DEVICE | {"device_damping": 0.0})
    assert verdict_with_drift(HapticLoop(**DEVICE), 0.0, 0.0) == BUT_FOR_DRIFT
    assert verdict_with_drift(still, 0.0, 0.0) == Verdict.UNSTABLE  # it moves for ever
    assert verdict_with_drift(still, 0.0, 1.0) == BUT_FOR_DRIFT


def test_springs_and_held_devices_have_the_ordinary_verdict() -> None:
    held = HapticLoop(**DEVICE, hand_stiffness=1e-9)
    assert verdict_with_drift(held, 0.0, 4.0) is None
    assert verdict_with_drift(HapticLoop(**DEVICE), 1e-9, 4.0) is None
    mode = Device.modes([Mode(frequency=80.0, damping_ratio=0.05, modal_mass=0.2)], mass=0.3)
    loop = HapticLoop(device=mode, sample_time=T)
    assert verdict_with_drift(loop, 0.0, 4.0) == BUT_FOR_DRIFT


def test_values_for_a_damper_are_those_for_all_other_poles_and_say_so() -> None:
    loop = LOOPS["difference"][2]
    for damping in (0.4, 40.0):
        delays = loop.range_of("delay", 0.0, damping, between=(0.0, 3 * T), count=4)
        assert delays.drift
        assert "but for the position, which nothing holds" in repr(delays)
        is_stable = max(abs(roots_beside_1("difference", damping))) < 1.0
        assert any(low.stable <= T <= high.stable for low, high in delays.intervals) == is_stable
    held = loop.range_of("hand_stiffness", 0.0, 10.0)
    assert not held.drift
    assert held.least > 0.0
    assert not HapticLoop(**DEVICE, hand_stiffness=50.0).range_of("delay", 0.0, 10.0).drift
    assert "but for the drift" in repr(loop.damping_intervals(0.0))
    assert "drift" not in repr(loop.stiffness_intervals(10.0))


def test_a_spring_that_does_not_push_back_at_rest_is_stable_for_no_value() -> None:
    """With P(1) = 0 on a free device all three parts of p(z) are 0 at z = 1."""
    washed = Filter.transfer_function([1.0, -1.0], [1.0, -0.95])
    loop = HapticLoop(**DEVICE, position=washed)
    for quantity in ("device_damping", "delay", "sample_time"):
        assert not loop.range_of(quantity, 100.0, 1.0).intervals
    assert loop.range_of("hand_stiffness", 100.0, 1.0).least > 0.0


def test_check_and_limits_agree_about_dampers() -> None:
    shown = run("limits", *FREE, "--at-stiffness", "0").stdout
    assert "stable damping      -0.1 to 82.91 N s/m at 0 N/m" in shown
    for damping, verdict, code in (("4", WORDS, 0), ("82.91", WORDS, 0), ("82.92", "unstable", 1)):
        wall = ["--wall", "damper", "0", damping]
        answer = run("check", *FREE, *wall, "--json")
        assert json.loads(answer.stdout)["walls"]["damper"]["verdict"] == verdict
        assert answer.exit_code == code
        limits = run("limits", *FREE, *wall)
        assert limits.exit_code == code
        assert (WORDS in limits.stdout) == (code == 0)


def test_a_damper_has_no_measures_of_a_position_that_nothing_holds() -> None:
    table = {
        "device": {"mass": 0.1, "damping": 0.1},
        "controller": {"sample_time": T, "delay_samples": 1.0},
        "walls": {"damper": {"stiffness": 0.0, "damping": 4.0}},
    }
    checked = check_walls(Scene.from_table(table))
    assert checked.all_stable
    wall = checked.walls["damper"]
    assert wall.verdict == WORDS
    assert wall.measures_are is not None
    assert wall.measures_are.startswith("left out: nothing holds the position")
    left_out = {"stiffness_gain", "spectral_radius", "extra_delay_moving", "settling_status"}
    assert not left_out & wall.values.keys()
    held = table | {"hand": {"stiffness": 50.0}}
    wall = check_walls(Scene.from_table(held)).walls["damper"]
    assert wall.verdict == Verdict.STABLE
    assert wall.settling_status is not None


@pytest.mark.parametrize(
    "ranges",
    [
        ["--hand-mass", "0:0.2"],
        ["--delay", "0.0005:0.0015"],
        ["--delay", "0.0005:0.0015", "--constant-delay"],
    ],
)
@pytest.mark.parametrize(("damping", "verdict"), [("4", "undecided"), ("200", "unstable")])
def test_over_ranges_a_damper_that_only_drifts_is_not_called_unstable(
    ranges: list[str], damping: str, verdict: str
) -> None:
    answer = run("check", *FREE, *ranges, "--wall", "damper", "0", damping)
    words = " ".join(answer.stdout.split())
    assert f" at {damping} N s/m: {verdict}" in words
    assert ("nothing holds the position" in words) == (verdict == "undecided")
    assert ("measures left out" in words) or verdict == "unstable"
    assert answer.exit_code == 1


@pytest.mark.campaign
def test_a_picture_has_the_mark_of_a_damper(tmp_path: Any) -> None:
    walls = ["--wall", "damper", "0", "4", "--wall", "soft", "100", "4"]
    assert run("check", *FREE, *walls, "--plot", tmp_path / "a.png").exit_code == 0
