"""What a log tells about a device: against logs that an independent simulation made."""

import math
import os
import re
import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.signal
from campaign import first, many, some
from commands import assert_one_sentence, run

import jaxstab
from docs.pushed import Log, Pushed, as_csv, difference, moved
from docs.pushed import run as simulated
from jaxstab.app.scene import Scene
from jaxstab.lab.identify import chance_of_white
from jaxstab.results import Estimate, Identified
from jaxstab.tables import parsed

DEVICES = {
    "that of the page": Pushed(),
    "a coarse encoder": Pushed(encoder=1e-4),
    "friction that holds it often": Pushed(size=0.8, friction=0.5, held=35),
    "no friction": Pushed(size=0.5, friction=0.0, damping=1.0, encoder=1e-6),
    "a whole delay": Pushed(delay=2e-3),
    "no delay": Pushed(delay=0.0),
    "a long delay": Pushed(delay=12.35e-3, spring=30.0),
    "4 kHz": Pushed(period=2.5e-4, delay=4e-4, held=80),
}
ROWS = 10_000


def identified(device: Pushed, log: Log) -> Identified:
    return jaxstab.identify(force=log.force, position=log.position, sample_time=device.period)


def estimates(found: Identified) -> dict[str, Estimate]:
    return {name: getattr(found, name) for name in ("mass", "damping", "friction", "delay")}


def test_the_simulated_device_moves_as_scipy_integrates_it(rng: np.random.Generator) -> None:
    device = Pushed()
    for v, force in zip(rng.normal(0.0, 0.02, 5), rng.normal(0.0, 1.0, 5), strict=True):
        state, time, others = [0.0, v], 0.0, force - device.offset

        def stops(_: float, state: np.ndarray) -> float:
            return float(state[1])

        stops.terminal = True  # type: ignore[attr-defined]
        while time < 5e-3 and (state[1] or abs(others) > device.friction):
            sign = math.copysign(1.0, state[1] or others)
            found = scipy.integrate.solve_ivp(
                lambda _, y, sign=sign, others=others: [
                    y[1],
                    (others - sign * device.friction - device.damping * y[1]) / device.mass,
                ],
                (time, 5e-3),
                state,
                events=stops if state[1] else None,
                rtol=1e-11,
                atol=1e-14,
            )
            time, state = found.t[-1], list(found.y[:, -1])
            state[1] = 0.0 if found.status == 1 else state[1]
        assert moved(device, 0.0, v, force, 5e-3) == pytest.approx(state, rel=1e-8, abs=1e-12)


def assert_covered(device: Pushed, logs: int) -> None:
    """95 % intervals contain the truth in at least 90 of 100 logs, delays to 0.05 samples."""
    hits: Counter[str] = Counter()
    for seed in range(logs):
        found = estimates(identified(device, simulated(device, ROWS, seed)))
        for name, (value, low, high) in found.items():
            hits[name] += low <= getattr(device, name) <= high
            assert low <= value <= high
        assert abs(found["delay"].value - device.delay) < 0.05 * device.period
    least = 0.9 if logs >= 100 else 0.75  # of a few logs 90 % may be missed by chance
    assert min(hits.values()) >= least * logs, hits


@pytest.mark.campaign
def test_intervals_contain_the_truth() -> None:
    assert_covered(Pushed(), 4)


@pytest.mark.campaign
@pytest.mark.parametrize("name", some(DEVICES, 3))
def test_intervals_contain_the_truth_in_90_of_100_logs(name: str) -> None:
    assert_covered(DEVICES[name], many(100, 4))


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(4))
def test_intervals_of_a_loop_that_diverges_contain_the_truth(seed: int) -> None:
    """The software's spring is too stiff: most of what a log of meters tells is in its end."""
    device = Pushed(mass=0.2, spring=1100.0)
    log = simulated(device, 4000, seed)
    assert np.ptp(log.position) > 100.0
    found = identified(device, log)
    assert found.residual == pytest.approx(device.encoder / math.sqrt(12.0), rel=0.02)
    assert found.mass.low <= device.mass <= found.mass.high < device.mass + 1e-5
    assert found.damping.low <= device.damping <= found.damping.high
    assert found.delay.low <= device.delay <= found.delay.high


@pytest.mark.campaign
def test_a_search_that_does_not_end_is_told(tmp_path: Path) -> None:
    """The log grows to kilometers within two seconds."""
    log = simulated(Pushed(mass=0.2, spring=2400.0), 2000, 0)
    assert "the best fit was not found in 100 steps" in identified(Pushed(), log).warning
    path = tmp_path / "log.csv"
    path.write_text(as_csv(log))
    scene = Scene.from_table(parsed(run("identify", path, "-o", "-").stdout))
    low, high = scene.device.effective_mass
    assert low == high


@pytest.mark.parametrize(("rows", "delay"), [(5, -3.63e-3), (2, -0.63e-3), (1, 0.37e-3)])
def test_columns_that_are_shifted_in_time_are_told(rows: int, delay: float) -> None:
    """A force is logged some rows later than the position that was read with it."""
    log = simulated(Pushed(), 4000, 3)
    moved = replace(log, force=log.force[:-rows], position=log.position[rows:])
    found = identified(Pushed(), moved)
    assert found.delay.value == pytest.approx(delay, abs=5e-6)
    assert found.mass.value == pytest.approx(0.25, rel=1e-3)
    words = f"positions are {-1e3 * delay:.3g} ms ahead of the forces that cause them"
    assert (words in found.warning) == (delay < 0.0) == bool(found.warning)


def test_columns_that_are_shifted_by_more_rows_than_are_tried_are_refused() -> None:
    """The search stays within the rows of the log that it keeps beside a segment."""
    log = simulated(Pushed(), 4000, 3)
    far = replace(log, force=log.force[:-12], position=log.position[12:])
    with pytest.raises(ValueError, match="log force and position of the same sample in one row"):
        identified(Pushed(), far)


def test_a_mass_without_friction_is_found_to_rounding() -> None:
    """In closed form, with positions of float64: constant accelerations from sample to sample."""
    push = np.repeat(np.random.default_rng(3).choice([-1.0, 1.0], 200), 10)
    speed = np.append(0.0, np.cumsum(push / 0.4) * 2e-3)[:-1]
    place = np.append(0.0, np.cumsum(speed * 2e-3 + push / 0.4 * 2e-6))[:-1]
    found = jaxstab.identify(force=push, position=place, sample_time=2e-3)
    assert found.mass.value == pytest.approx(0.4, rel=1e-6)
    assert found.damping.value == pytest.approx(0.0, abs=1e-5)
    assert found.friction.value == pytest.approx(0.0, abs=1e-5)
    assert found.delay.value == pytest.approx(0.0, abs=1e-7)
    assert (found.resolution, found.warning) == (None, "")


@pytest.mark.parametrize(
    "name",
    ["a coarse encoder", pytest.param("friction that holds it often", marks=pytest.mark.campaign)],
)
def test_what_is_left_is_the_rounding_of_the_encoder(name: str) -> None:
    """In no segment the search ends in a motion that friction stopped elsewhere."""
    device = DEVICES[name]
    for seed in (2,):
        found = identified(device, simulated(device, ROWS, seed))
        rounding = device.encoder / math.sqrt(12.0)
        assert 0.95 * rounding < found.residual < 1.02 * rounding
        assert not found.warning


def test_a_spring_that_starts_at_0_leaves_no_more_than_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One more number never fits worse, wherever the regression lets its search begin."""
    log, begin = simulated(Pushed(), 4000, 2), jaxstab.lab.identify._start

    def at_0(*given: Any) -> Any:
        values, speeds = begin(*given)
        values[5:] = 0.0
        return values, speeds

    monkeypatch.setattr(jaxstab.lab.identify, "_start", at_0)
    columns = {"force": log.force, "position": log.position, "sample_time": Pushed().period}
    plain = identified(Pushed(), log)
    found = jaxstab.identify(**columns, spring=True)
    assert found.residual <= 1.0001 * plain.residual
    assert found.stiffness.low < 0.0 < found.stiffness.high


def test_a_spring_of_the_device_is_found() -> None:
    """A spring of the software is known to the log; hidden from it, it is one of the device."""
    device = Pushed(delay=0.0)
    log = simulated(device, ROWS, 5)
    hidden = replace(log, force=log.force + device.spring * log.position)
    found = jaxstab.identify(
        force=hidden.force, position=log.position, sample_time=1e-3, spring=True
    )
    # It is held for a sample, so it acts half a sample late and takes damping away.
    assert found.stiffness.value == pytest.approx(device.spring, rel=1e-3)
    assert found.mass.value == pytest.approx(device.mass, rel=1e-3)
    assert found.damping.value == pytest.approx(device.damping - 0.5e-3 * device.spring, rel=2e-2)


@pytest.mark.parametrize("samples", [1, 15, 200])
def test_a_window_is_told_from_the_velocity(samples: int) -> None:
    log = simulated(Pushed(), 2000, 7)
    velocity = difference(log, samples)
    found = jaxstab.identify(
        force=log.force, position=log.position, sample_time=1e-3, velocity=velocity
    )
    assert found.velocity == jaxstab.Velocity.difference(samples=samples)
    assert found.unexplained < 1e-9


def low_passed(log: Log, cutoff: float) -> np.ndarray:
    q = math.exp(-2.0 * math.pi * cutoff * 1e-3)
    return scipy.signal.lfilter([1.0 - q], [1.0, -q], difference(log, 1))


def test_a_low_pass_is_told_from_the_velocity() -> None:
    log = simulated(Pushed(), 2000, 7)
    found = jaxstab.identify(
        force=log.force, position=log.position, sample_time=1e-3, velocity=low_passed(log, 40.0)
    )
    assert found.velocity is not None
    assert found.velocity.filter.sections[0].cutoff == pytest.approx(40.0, rel=1e-9)
    assert found.unexplained < 1e-9


def test_a_velocity_that_nothing_explains_is_told_in_percent(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(with_velocity(np.random.default_rng(1).normal(size=2000)))
    assert "; 100 % rms unexplained\n" in run("identify", path).stdout


def test_a_vibration_mode_is_noticed_with_its_frequency() -> None:
    log = simulated(Pushed(), ROWS, 2)
    mode = 2.0 * math.pi * 61.0
    push = scipy.signal.StateSpace([[0, 1], [-(mode**2), -0.02 * mode]], [[0], [0.2]], [[1, 0]], 0)
    shaken = scipy.signal.lsim(push, log.force, log.time)[1]
    found = identified(Pushed(), replace(log, position=np.round((log.position + shaken), 5)))
    frequency = float(found.warning.split(" Hz")[0].split()[-1])
    assert frequency == pytest.approx(61.0, abs=3.0)


def with_backlash(log: Log, play: float) -> Log:
    """The log of an encoder that a play separates from the handle: it moves when it is pushed."""
    read = np.empty_like(log.position)
    place = log.position[0]
    for row, handle in enumerate(log.position):
        place = min(max(place, handle - 0.5 * play), handle + 0.5 * play)
        read[row] = place
    return replace(log, position=np.round(read, 5))


# The command, as a user meets it.


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = simulated(Pushed(), ROWS, 0)
    path = tmp_path_factory.mktemp("log") / "log.csv"
    path.write_text(as_csv(made, velocity=difference(made, 20)), encoding="utf-8")
    return path


def test_the_scene_is_what_limits_takes(log: Path, tmp_path: Path) -> None:
    scene, picture = tmp_path / "my.toml", tmp_path / "fit.png"
    answer = run("identify", log, "-o", scene, "--plot", picture)
    assert answer.exit_code == 0, answer.stderr
    assert "the difference over a window of 20 samples" in answer.stdout
    assert "95 % confidence intervals, if the model holds" in answer.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    text = scene.read_text(encoding="utf-8")
    assert text.startswith("# From log.csv by jaxstab identify")
    made = Scene.from_table(parsed(text))
    low, high = made.device.effective_mass
    assert low < 0.25 < high < 0.251
    low, high = made.controller.delays
    assert low < 1.37e-3 < high < 1.38e-3
    assert made.device.friction == pytest.approx(0.3, rel=1e-3)
    assert made.device.encoder is not None
    assert made.device.encoder.resolution == pytest.approx(1e-5)
    limits = run("limits", scene)
    assert limits.exit_code == 0, limits.stderr
    assert "for every hand and mass and every sequence of delays" in limits.stdout


def test_columns_have_names_and_a_device_may_turn(tmp_path: Path) -> None:
    made = simulated(Pushed(), 2000, 0)
    text = as_csv(made).replace("time,force,position", "t,torque,angle")
    path = tmp_path / "wheel.csv"
    path.write_text(text, encoding="utf-8")
    names = ["--force", "torque", "--position", "angle", "--sample-time", "0.001"]
    answer = run("identify", path, *names, "--turns", "-o", "-")
    assert answer.exit_code == 0, answer.stderr
    scene = Scene.from_table(parsed(answer.stdout))
    assert scene.device.inertia is not None
    assert scene.device.inertia[0] == pytest.approx(0.25, rel=1e-2)


def test_a_sample_time_beside_a_time_column_that_grows_otherwise_is_told(tmp_path: Path) -> None:
    """Dates are no numbers: there is nothing to compare with."""
    path, made = tmp_path / "log.csv", as_csv(simulated(Pushed(), 2000, 0))
    path.write_text(made)
    answer = run("identify", path, "--sample-time", "0.002", "-o", "-")
    assert answer.exit_code == 0, answer.stderr
    assert_one_sentence(answer.stderr, "warning", "0.001", "--sample-time is 0.002 s")
    assert "sample_time = 0.002" in answer.stdout
    dated = re.sub("(?m)^([0-9.e-]+),", r"2026-11-29T12:00:\1,", made)
    assert dated != made
    for text in (made, made.replace("time", "t"), dated):
        path.write_text(text)
        answer = run("identify", path, "--sample-time", "0.001")
        assert (answer.exit_code, answer.stderr) == (0, "")


SLIPS = {
    "time": ("controller.sample_time is 1 s, usual are 1e-05 to 0.05 s", "250"),  # in ms
    "force": ("device.mass is 25", "usual are 0.001 to 50 kg"),  # in mN
    "position": ("device.mass is 0.00025", "encoder.resolution is 0.01 m"),  # in mm
}


@pytest.mark.parametrize("column", SLIPS)
def test_a_column_in_thousandths_is_warned_of(column: str, tmp_path: Path) -> None:
    made = simulated(Pushed(), 2000, 0)
    path = tmp_path / "log.csv"
    path.write_text(as_csv(replace(made, **{column: 1e3 * getattr(made, column)})))
    answer = run("identify", path, "-o", "-")
    assert answer.exit_code == 0, answer.stderr
    assert_one_sentence(answer.stderr)
    for words in ("warning: ", *SLIPS[column]):
        assert words in answer.stderr
    Scene.from_table(parsed(answer.stdout))


def test_after_a_warning_a_scene_has_no_range(tmp_path: Path) -> None:
    """A play of 0.2 mm: the interval of the delay is far off the truth, and no proof may use it."""
    device = Pushed()
    shaken = with_backlash(simulated(device, ROWS, 0), 2e-4)
    found = identified(device, shaken)
    assert found.warning
    assert found.delay.low > device.delay + 0.2e-3
    path, scene = tmp_path / "log.csv", tmp_path / "my.toml"
    path.write_text(as_csv(shaken))
    answer = run("identify", path, "-o", scene)
    assert answer.stdout.endswith("if the model holds; by the warning it does not\n")
    made = Scene.from_table(parsed(scene.read_text(encoding="utf-8")))
    assert made.controller.delays == pytest.approx((found.delay.value,) * 2, rel=1e-6)
    assert made.device.effective_mass == pytest.approx((found.mass.value,) * 2, rel=1e-6)


GOOD = as_csv(simulated(Pushed(), 2000, 0))


def with_velocity(values: np.ndarray) -> str:
    columns = zip(GOOD.splitlines(), ["velocity", *values.tolist()], strict=True)
    return "\n".join(f"{line},{value}" for line, value in columns)


STILL = as_csv(Log(1e-3 * np.arange(2000), np.ones(2000), np.zeros(2000)))
WEAK = as_csv(
    Log(
        1e-3 * np.arange(2000),
        np.round(np.sin(1e-3 * np.arange(2000)), 3),
        np.round(1e-3 * np.arange(2000) % 2.0, 2),
    )
)
BAD = {
    "a missing column": (GOOD.replace("force", "torque", 1), "no column 'force'"),
    "a word": (GOOD.replace("\n0.5,", "\nhalf,", 1), "time is 'half'"),
    "NaN": (GOOD.replace("\n0.5,", "\nnan,", 1), "give a finite number"),
    "a missing row": (GOOD.replace("\n0.5,", "\n0.5005,", 1), "the time does not grow"),
    "a gap": (
        re.sub(r"\n(0\.[5-9]|[1-9])", lambda found: f"\n7{found[1]}", GOOD),
        "from 0.499 s to 70.5 s (rows 500 and 501) the time does not grow by the usual step of 0.0",
    ),
    "times of no number": (GOOD.replace("\n0.5,", "\n1e308,", 1), "(rows 500 and 501)"),
    "too short": ("\n".join(GOOD.splitlines()[:100]), "rows of the log: 99"),
    "no motion": (STILL, "position spans 0"),
    "the sign of the force": (
        as_csv(replace(made := simulated(Pushed(), 2000, 0), force=-made.force)),
        "accelerates against the force",
    ),
    "a motion of its own": (WEAK, "force"),
    "empty": ("", "no column"),
    "forces of 1e-300 N": (
        as_csv(replace(made, force=1e-300 * np.sign(made.force))),
        "the motion of this log is beyond the range of float64; give force in N",
    ),
    "a device that stands": (
        as_csv(replace(made, position=np.full(2000, 0.25))),
        "position spans 0 and force spans 5.1644; give",
    ),
    "semicolons": (GOOD.replace(",", ";"), "names in the first line need commas between"),
    "a comment": (f"# by our logger\n{GOOD}", "names in the first line need commas between"),
    "a decimal comma": (GOOD.replace("\n0.5,", "\n0,5,", 1), "line 502 has 4 values, but"),
    "a cut line": (re.sub("\n0.5,.*", "\n0.5,1", GOOD, count=1), "line 502: position is ''"),
    "a header alone": (GOOD.splitlines()[0], "has 0 rows of numbers; give all."),
    "a velocity that is none": (
        with_velocity(np.zeros(2000)),
        "velocity is 0 throughout; give the one",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_log_is_one_sentence_and_no_scene(name: str, tmp_path: Path) -> None:
    text, words = BAD[name]
    path, scene = tmp_path / "bad.csv", tmp_path / "my.toml"
    path.write_text(text, encoding="utf-8")
    answer = run("identify", path, "-o", scene)
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert words in answer.stderr
    assert not scene.exists()


def test_a_log_that_hardly_tells_the_mass_is_refused() -> None:
    """A force that changes so slowly that friction and damping alone balance it."""
    device = Pushed(size=0.4, held=1000, damping=20.0, spring=0.0, encoder=1e-4)
    log = simulated(device, 4000, 0)
    with pytest.raises(ValueError, match=r"does not determine the mass; excite the device"):
        identified(device, log)


def test_a_single_sine_does_not_tell_mass_damping_and_delay() -> None:
    """Two numbers, of three that are asked for: any delay fits, to rounding."""
    turn = 0.01 * np.arange(2000)
    with pytest.raises(ValueError, match="does not separate the mass from damping and friction"):
        jaxstab.identify(force=np.sin(turn), position=-np.sin(turn), sample_time=1e-3)


@pytest.mark.parametrize("period", [0.0, 1e-200, 1e200, 1e308, np.inf, np.nan])
def test_a_sample_time_of_no_log_is_refused(period: float, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(GOOD, encoding="utf-8")
    for servo_options in ([], ["--kp", 1, "--kd", 1, "--setpoint", "position"]):
        answer = run("identify", log, *servo_options, "--sample-time", period)
        assert (answer.exit_code, answer.stdout) == (2, "")
        assert_one_sentence(answer.stderr)
        assert "finite values from 1e-09 to 1e+06 s" in answer.stderr


def test_a_log_is_read_from_a_pipe_once(tmp_path: Path) -> None:
    pipe, log = tmp_path / "pipe.csv", tmp_path / "log.csv"
    log.write_text(GOOD, encoding="utf-8")
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_text, args=(GOOD,))
    writer.start()
    answer = run("identify", pipe, "--sample-time", 1e-3)
    writer.join()
    assert answer.stdout == run("identify", log, "--sample-time", 1e-3).stdout
    assert answer.exit_code == 0


def test_columns_of_other_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="force has 3 rows but position has 2"):
        jaxstab.identify(force=[0.0, 1.0, 0.0], position=[0.0, 0.0], sample_time=1e-3)


# Units and colour.


def test_a_slip_of_units_is_warned_of_in_python() -> None:
    log = simulated(Pushed(), 2100, 0)
    with pytest.warns(UserWarning, match=r"sample_time is 1 s, usual are 1e-05 to 0\.05"):
        jaxstab.identify(force=log.force, position=log.position, sample_time=1.0)
    with pytest.warns(UserWarning, match=r"mass is 25\d\.\d+ kg or kg m\^2, usual are"):
        jaxstab.identify(force=1e3 * log.force, position=log.position, sample_time=1e-3)


def test_white_noise_is_told_from_coloured_noise() -> None:
    """Of white noise the chance is uniform; a correlation of 0.1 is seen in 8,000 samples."""
    rng = np.random.default_rng(55)
    noise = rng.normal(size=(400, 16, 500))
    chances = np.array([chance_of_white(one) for one in noise])
    assert np.mean(chances < 0.05) == pytest.approx(0.05, abs=0.03)
    assert np.mean(chances < 0.5) == pytest.approx(0.5, abs=0.08)
    assert np.mean(chances < 1e-3) < 0.01
    coloured = scipy.signal.lfilter([1.0], [1.0, -0.1], noise[:40])
    assert max(map(chance_of_white, coloured)) < 1e-3


@pytest.mark.parametrize("colour", [0.0, 0.6])
def test_a_residual_that_is_not_white_is_a_sentence(colour: float) -> None:
    """An analog position: noise without steps, white or not."""
    log, rng = simulated(Pushed(encoder=1e-9), 4000, 1), np.random.default_rng(1)
    noise = scipy.signal.lfilter([1.0], [1.0, -colour], rng.normal(0.0, 2e-5, 4000))
    found = identified(Pushed(), replace(log, position=log.position + noise))
    assert found.resolution is None
    assert bool(found.warning) == (colour > 0.0)
    assert ("not white (p = " in found.warning) == (colour > 0.0)


# A closed servo, stepped by scipy from sample to sample.


def rounded(values: Any, step: float) -> Any:
    """Readings of an encoder."""
    return step * np.rint(values / step)


def servo(
    inertia: float = 0.01,
    damping: float = 0.05,
    delay: float = 1.5,
    window: int = 1,
    kp: float = 20.0,
    kd: float = 0.6,
    period: float = 2e-3,
    rows: int = 150,
    resolution: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Set points, which step by 0.1 after 30 rows, and readings; the delay is in samples."""
    rate = np.array([[0.0, 1.0, 0.0], [0.0, -damping / inertia, 1.0 / inertia], [0.0, 0.0, 0.0]])
    whole = int(delay)
    parts = [
        scipy.linalg.expm(rate * period * share) for share in (delay - whole, 1 - delay + whole)
    ]
    goals, places, forces = np.repeat([0.2, 0.3], [30, rows]), [0.2] * (window + 1), [0.0] * 40
    state = np.array([0.2, 0.0, 0.0])
    for goal in goals:
        places.append(rounded(state[0], resolution) if resolution else state[0])
        speed = (places[-1] - places[-1 - window]) / (window * period)
        forces.append(kp * (goal - places[-1]) - kd * speed)
        for part, force in zip(parts, (forces[-2 - whole], forces[-1 - whole]), strict=True):
            state[2] = force
            state = part @ state
    return goals, np.array(places[window + 1 :])


@pytest.mark.parametrize("changed", [{}, {"delay": 0.0}, {"window": 5}, {"damping": 0.0}])
def test_a_servo_is_found_to_rounding(changed: dict[str, float]) -> None:
    truth = {"inertia": 0.01, "damping": 0.05, "delay": 1.5} | changed
    setpoint, position = servo(**changed)  # type: ignore[arg-type]
    velocity = jaxstab.Velocity.difference(5) if "window" in changed else None
    found = jaxstab.identify_servo(
        setpoint=setpoint, position=position, kp=20.0, kd=0.6, sample_time=2e-3, velocity=velocity
    )
    assert found.mass.value == pytest.approx(truth["inertia"], rel=1e-4)
    assert found.damping.value == pytest.approx(truth["damping"], abs=5e-5)
    assert found.delay.value / 2e-3 == pytest.approx(truth["delay"], abs=2e-3)
    assert not found.warning
    assert (found.friction.high, found.velocity) == (0.0, velocity)


@pytest.mark.parametrize("kd", [0.6, 2.2])  # of at most 3.3: an encoder's errors are magnified
@pytest.mark.parametrize(
    "kind", first(["noise", "an encoder in the log", "an encoder in the servo"], 1)
)
def test_intervals_of_a_servo_contain_the_truth(kind: str, kd: float) -> None:
    rng, hits, size = np.random.default_rng(3), np.zeros(3), 3e-4
    logs, warnings = many(100, 10), 0
    for _ in range(logs):
        inertia = float(rng.uniform(0.009, 0.011))
        step = size if kind == "an encoder in the servo" else 0.0
        setpoint, position = servo(inertia, kd=kd, resolution=step)
        if kind == "noise":
            position += rng.normal(0.0, size, len(position))
        elif not step:
            position = rounded(position, size)
        found = jaxstab.identify_servo(
            setpoint=setpoint, position=position, kp=20.0, kd=kd, sample_time=2e-3
        )
        own = (found.mass, inertia), (found.damping, 0.05), (found.delay, 3e-3)
        hits += [low <= truth <= high for (_, low, high), truth in own]
        warnings += bool(found.warning)
        assert found.mass.value == pytest.approx(inertia, rel=0.05)
    assert np.all(hits >= (0.9 if logs >= 100 else 0.7) * logs)
    assert warnings <= 0.02 * logs


@pytest.mark.parametrize(
    "changed",
    [
        {"delay": 25.0},  # nothing has moved yet
        {"delay": 18.0},  # two rows tell of it
        {"inertia": 0.5},  # it was fitted as 0.25 to 0.39 kg m^2, at the end of what is tried
    ],
)
def test_a_log_that_ends_too_soon_determines_no_servo(changed: dict[str, float]) -> None:
    setpoint, position = servo(rows=20, **changed)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="does not determine inertia, damping and delay; give"):
        jaxstab.identify_servo(
            setpoint=setpoint, position=position, kp=20.0, kd=0.6, sample_time=2e-3
        )


@pytest.mark.campaign
@pytest.mark.filterwarnings("error")
def test_a_long_log_of_a_servo_is_fitted_though_tries_grow_without_end() -> None:
    setpoint, position = servo(rows=4000)
    found = jaxstab.identify_servo(
        setpoint=setpoint, position=position, kp=20.0, kd=0.6, sample_time=2e-3
    )
    assert found.mass.value == pytest.approx(0.01, rel=1e-4)
    assert found.delay.value == pytest.approx(3e-3, abs=4e-6)


def test_a_servo_with_another_gain_does_not_fit() -> None:
    """Less damping than is said, which no damping of the device makes up: the residual tells."""
    setpoint, position = servo()
    found = jaxstab.identify_servo(
        setpoint=setpoint, position=np.round(position, 4), kp=20.0, kd=0.8, sample_time=2e-3
    )
    assert "not white" in found.warning
    flat = np.ones(100)
    for columns, words in (
        ({"setpoint": flat, "position": flat}, "0 of them after a step"),
        ({"setpoint": setpoint, "position": flat}, "and position 100"),
        ({"setpoint": setpoint, "position": -position}, "does not fit this step"),
    ):
        with pytest.raises(ValueError, match=words):
            jaxstab.identify_servo(**columns, kp=20.0, kd=0.6, sample_time=2e-3)


@pytest.mark.parametrize(("late", "period"), [(0, 2e-3), (2, 2e-3), (3, 2e-3), (0, 1e-3)])
def test_what_moves_before_the_set_point_is_no_noise_of_a_servo(late: int, period: float) -> None:
    """Set points that are logged rows late, or a wrong sample time, give a third less inertia."""
    setpoint, position = servo(rows=100)
    found = jaxstab.identify_servo(
        setpoint=np.append(np.full(late, 0.2), setpoint)[: len(setpoint)],
        position=position + np.random.default_rng(1).normal(0.0, 1e-5, len(position)),
        kp=20.0,
        kd=0.6,
        sample_time=period,
    )
    is_right = not late and period == 2e-3
    assert (found.mass.low <= 0.01 <= found.mass.high) == is_right
    assert ("not white" in found.warning) == bool(found.warning) != is_right


def test_the_command_fits_a_servo_and_writes_its_scene(tmp_path: Path) -> None:
    setpoint, position = servo(window=5)
    times = 2e-3 * np.arange(len(setpoint))
    columns = np.stack([times, setpoint, np.round(position, 5)], axis=1)
    log, scene, picture = (tmp_path / name for name in ("servo.csv", "my.toml", "fit.png"))
    np.savetxt(log, columns, fmt="%.9g", delimiter=",", header="time,goal,angle", comments="")
    names = ["--setpoint", "goal", "--position", "angle", "--turns", "--window-samples", 5]
    gains = ["--kp", 20, "--kd", 0.6]
    answer = run("identify", log, *gains, *names, "-o", scene, "--plot", picture)
    assert answer.exit_code == 0, answer.stderr
    assert "friction" not in answer.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    made = Scene.from_table(parsed(scene.read_text(encoding="utf-8")))
    assert made.device.effective_mass[0] == pytest.approx(0.01, rel=0.01)
    assert made.controller.velocity is not None
    assert "window of 5 samples" in str(made.controller.velocity)
    for words in (["--kp", 20], ["--window-samples", 0], [*gains, "--window-samples", 0]):
        refused = run("identify", log, *names[:4], *words)
        assert (refused.exit_code, refused.stdout) == (2, "")
        assert_one_sentence(refused.stderr)
    assert "of --kp, --kd" in run("identify", log, "--kd", 0.6).stderr
    unread = run("identify", log, *gains, *names, "--velocity", "angle").stderr
    assert "--velocity is angle, which is not read beside --kp and --kd; leave it out." in unread
