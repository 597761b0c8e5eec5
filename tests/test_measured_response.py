"""Walls on a device of which only a frequency response is known: judged by roots in mpmath.

The response is that of state matrices stepped by scipy, behind a delay of any length; jaxstab has
no part in it. A wall is stable where all roots of its closed loop are inside the circle.
"""

import re
from functools import partial
from math import inf, pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from campaign import first, many
from commands import assert_one_sentence, run
from mpmath import mp
from scipy.linalg import block_diag, expm

import jaxstab
from jaxstab import Device, Filter, HapticLoop, Velocity
from jaxstab.results import MeasuredVerdict

NOISE = 0.01
Matrix = np.ndarray[Any, np.dtype[np.float64]]


class Known(NamedTuple):
    """A sampled device x+ = F x + G u, its position C x, w samples late, and an estimator."""

    move: Matrix
    push: Matrix
    read: Matrix
    whole: int
    period: float
    velocity: Velocity
    rate: tuple[Matrix, Matrix]  # its numerator and denominator in powers of 1/z

    def response(self, hertz: Matrix) -> Matrix:
        z = np.exp(2j * pi * hertz * self.period)
        one = np.eye(len(self.move))
        moved = [(self.read @ np.linalg.solve(x * one - self.move, self.push))[0, 0] for x in z]
        return np.array(moved) * z**-self.whole

    def is_stable(self, stiffness: float, damping: float) -> bool:
        """Sums of products in powers of 1/z, whose roots mpmath has."""
        above, below = self.rate
        free = np.poly(self.move)
        moved = np.poly(self.move - self.push @ self.read) - free
        wall = np.pad(stiffness * below, (0, len(above) - len(below))) + damping * above
        left, right = np.convolve(free, below), np.convolve(moved, wall)
        size = max(len(left), len(right) + self.whole)
        p = np.pad(left, (0, size - len(left)))
        p[self.whole : self.whole + len(right)] += right
        with mp.workdps(30):
            rising = list(map(float, np.trim_zeros(p, "b")[::-1]))
            roots = mp.polyroots(rising, maxsteps=500, extraprec=300, asc=True)
            return bool(max(map(abs, roots)) < 1)


def known(
    mass: float = 0.25,
    damping: float = 0.1,
    stiffness: float = 0.0,
    modes: tuple[tuple[float, float, float], ...] = (),
    delay: float = 1.0,
    window: int = 0,
    cutoff: float = 0.0,
    period: float = 1e-3,
) -> Known:
    rate = np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]])
    push, read = [[0.0], [1.0 / mass]], [1.0, 0.0]
    for frequency, ratio, modal in modes:
        w = 2.0 * pi * frequency
        rate = block_diag(rate, [[0.0, 1.0], [-w * w, -2.0 * ratio * w]])
        push, read = [*push, [0.0], [1.0 / modal]], [*read, 1.0, 0.0]
    n, force = len(rate), np.array(push)

    def held(time: float) -> tuple[Matrix, Matrix]:
        both = expm(np.block([[rate, force], [np.zeros((1, n + 1))]]) * time)
        return both[:n, :n], both[:n, n:]

    whole = int(delay)
    late = (delay - whole) * period
    (before, newest), (_, oldest) = held(period - late), held(late)
    move = np.block([[held(period)[0], before @ oldest], [np.zeros((1, n + 1))]])
    position = np.array([[*read, 0.0]])
    q = float(np.exp(-2.0 * pi * cutoff * period))
    estimator = Velocity.low_pass(cutoff) if cutoff else Velocity.difference(window or 1)
    span = np.zeros((window or 1) + 1)
    span[[0, -1]] = np.array([1.0, -1.0]) / (window or 1) / period
    sides = (span * (1.0 - q), np.array([1.0, -q])) if cutoff else (span, np.array([1.0]))
    return Known(move, np.vstack([newest, [[1.0]]]), position, whole, period, estimator, sides)


CASES = {
    "a mass": known(),
    "a window and a fraction": known(delay=1.37, window=20),
    "a hand": known(mass=0.75, damping=5.0, stiffness=300.0, delay=1.5, window=10),
    "a mode": known(mass=0.3, damping=1.0, modes=((60.0, 0.03, 1.0),), window=5),
    "two modes": known(
        mass=0.3, damping=1.0, modes=((60.0, 0.03, 1.0), (120.0, 0.02, 2.0)), cutoff=40.0
    ),
    "a low pass": known(mass=2.0, damping=10.0, delay=5.0, cutoff=40.0),
}
HERTZ = np.arange(0.5, 500.5, 0.5)


def noisy(case: Known, seed: int) -> Matrix:
    """Its response, anywhere within 1 %."""
    rng = np.random.default_rng(seed)
    size, turn = rng.uniform(0.0, 1.0, (2, len(HERTZ)))
    return case.response(HERTZ) * (1.0 + NOISE * np.sqrt(size) * np.exp(2j * pi * turn))


def measured(case: Known, response: Matrix, error: float | None = None) -> HapticLoop:
    device = Device.from_response(HERTZ, response, error=error)
    return HapticLoop(device=device, sample_time=case.period, velocity=case.velocity)


SLOW = "a window and a fraction"  # roots of degree 25 by mpmath
MOST = first([*(name for name in CASES if name != SLOW), SLOW], 2)


@pytest.mark.parametrize("name", MOST)
def test_walls_are_judged_as_their_roots_are(name: str) -> None:
    """Without an error, walls that 3 % more or less of both gains do not change."""
    case, rng = CASES[name], np.random.default_rng(55)
    loops = [measured(case, noisy(case, 55)), measured(case, noisy(case, 55), NOISE)]
    limits = loops[0].limits()
    count = many(300, 8)
    walls = rng.uniform(0.0, 2.0, (count, 2)) * [limits.stiffness, limits.damping]
    truth = np.array([case.is_stable(*wall) for wall in walls])
    plain, within = (np.asarray(loop.verdict(*walls.T)) for loop in loops)
    near = [np.array([case.is_stable(*(s * wall)) for wall in walls]) for s in (0.97, 1.03)]
    is_clear = (near[0] == truth) & (near[1] == truth)
    assert not np.any((plain == MeasuredVerdict.STABLE) & ~truth & is_clear)
    assert not np.any((plain == MeasuredVerdict.UNSTABLE) & truth & is_clear)
    assert not np.any((within == MeasuredVerdict.STABLE) & ~truth)
    assert not np.any((within == MeasuredVerdict.UNSTABLE) & truth)
    assert np.mean(plain != MeasuredVerdict.UNDECIDED) > 0.8
    assert set(plain) >= {1, 2}


@pytest.mark.parametrize("name", MOST)
def test_limits_and_rows_are_stable_and_near_the_truth(name: str) -> None:
    """With the error: inside of the truth, and by no more than a sixth."""
    case = CASES[name]
    loop = measured(case, noisy(case, 7), NOISE)
    limits = loop.limits()
    assert limits.status.words == "from measured data, not proved"
    assert "islands" not in repr(limits)
    assert case.is_stable(limits.stiffness, limits.at_damping)
    assert case.is_stable(limits.at_stiffness, limits.damping)
    assert not case.is_stable(1.2 * limits.stiffness, limits.at_damping)
    assert not case.is_stable(limits.at_stiffness, 1.2 * limits.damping)
    damping, stiffness = 0.5 * limits.at_damping, 0.3 * limits.stiffness
    rows = {
        partial(case.is_stable, damping=damping): loop.stiffness_intervals(damping),
        partial(case.is_stable, stiffness): loop.damping_intervals(stiffness),
    }
    for is_stable, row in rows.items():
        assert row.status.words == "from measured data, not proved"
        assert row.intervals
        for low, high in row.intervals:
            assert is_stable(0.5 * (low.value + high.value))
            assert is_stable(high.value)
            assert not is_stable(high.value + high.error)


def test_margins_are_those_of_the_device_within_its_error() -> None:
    """By the open loop at 50,000 frequencies, and by the roots for gain and delay."""
    case, wall = CASES["a mode"], (2000.0, 15.0)
    found = measured(case, noisy(case, 3), NOISE).frequency_margins(*wall)
    hertz = np.arange(0.1, 500.0, 0.01)
    lag = np.exp(-2j * pi * hertz * case.period)
    opened = case.response(hertz) * (wall[0] + wall[1] * np.polyval(case.rate[0][::-1], lag))
    crossed = np.flatnonzero(np.diff(np.sign(abs(opened) - 1.0)))
    phases = np.degrees(abs(np.angle(-opened[crossed])))
    assert phases.min() - 2.0 < float(found.phase.value) <= phases.min() + 0.01
    at = hertz[crossed[np.argmin(phases)]]
    assert float(found.phase.frequency) == pytest.approx(at, rel=0.02)
    peak = float(np.max(1.0 / abs(1.0 + opened)))
    assert peak <= float(found.sensitivity.value) < 1.2 * peak
    largest = float(found.largest_gain.value)
    assert case.is_stable(*(largest * np.array(wall)))
    assert not case.is_stable(*(1.3 * largest * np.array(wall)))
    samples = int(float(found.delay.value) / case.period)
    assert case._replace(whole=case.whole + samples).is_stable(*wall)
    assert not case._replace(whole=case.whole + samples + 2).is_stable(*wall)
    assert repr(found).endswith("from measured data, not proved")


@pytest.mark.parametrize("size", [0.93, 0.95, 1.02, 1.05])
def test_margins_hold_where_only_another_response_reaches_1(size: float) -> None:
    """L = s (1 - a)/(z - a) stays near 1 over decades: an error of 10 % moves where it is 1."""
    error, a, lag = 0.1, np.exp(-2.0 * pi * 0.03), np.exp(-2j * pi * HERTZ * 1e-3)
    shape = (1.0 - a) / (1.0 / lag - a)
    device = Device.from_response(HERTZ, size / 285.0 * shape, error=error)
    found = HapticLoop(device=device, sample_time=1e-3).frequency_margins(285.0, 0.0)
    hertz = np.geomspace(0.1, 500.0, 400_001)
    opened = (1.0 - a) / (np.exp(2j * pi * hertz * 1e-3) - a)
    within = abs(abs(size * opened) - 1.0) <= error * abs(size * opened)
    r = abs(size * opened[within])
    more = np.arccos((1.0 / r + r * (1.0 - error**2)) / 2.0)  # by the triangle 0, L, L'
    lags = np.angle(-opened[within]) % (2.0 * pi) - more
    assert float(found.phase.value) == pytest.approx(np.degrees(lags.min()), abs=0.5)
    delay = np.min(lags / (2.0 * pi * hertz[within]))
    assert float(found.delay.value) == pytest.approx(delay, rel=0.02)
    samples = int(delay / 1e-3)
    for gain in size * (1.0 + error * np.array([-0.99, -0.5, 0.5, 0.99])):
        late = np.append([1.0, -a], np.zeros(samples)) + gain * (1.0 - a) * np.eye(samples + 2)[-1]
        assert np.max(abs(np.roots(late))) < 1.0
    beyond = 1.25 * samples
    assert any(
        np.max(abs(np.roots([1.0, -a, *[0.0] * (n - 1), 1.099 * size * (1.0 - a)]))) > 1.0
        for n in range(samples, round(beyond) + 1)
    )


def test_no_gain_and_no_largest_gain_make_no_warning() -> None:
    held = 1.0 / (300.0 * (1.0 + 1j * HERTZ / 30.0))
    loop = HapticLoop(device=Device.from_response(HERTZ, held), sample_time=1e-3)
    for wall in ((285.0, 0.0), (0.0, 0.5)):
        largest = loop.frequency_margins(*wall).largest_gain
        assert float(largest.value) == inf
        assert np.isnan(largest.frequency)
    assert loop.stiffness_intervals(0.5).intervals[0].high.value == inf
    limits = loop.limits()
    assert (limits.stiffness, limits.damping) == (inf, inf)


def test_a_response_of_python_control_is_taken() -> None:
    control = pytest.importorskip("control")
    case = CASES["a hand"]
    data = control.frd(case.response(HERTZ), 2.0 * pi * HERTZ)
    same = Device.from_response(HERTZ, case.response(HERTZ))
    taken = Device.from_control(data)
    assert str(taken) == str(same)
    assert np.allclose(taken.mechanism.response, same.mechanism.response)


def test_what_was_not_measured_is_undecided() -> None:
    """A mode between two frequencies, a crossover below the first, and one above the last."""
    case = known(mass=0.3, damping=1.0, modes=((60.0, 0.002, 1.0),), window=5)
    coarse = np.arange(2.0, 501.0, 2.0)
    device = Device.from_response(coarse, case.response(coarse))
    loop = HapticLoop(device=device, sample_time=1e-3, velocity=case.velocity)
    assert loop.verdict(2000.0, 15.0) == MeasuredVerdict.UNDECIDED
    case, high, low = CASES["a mass"], HERTZ[HERTZ > 20.0], HERTZ[HERTZ < 40.0]
    for part, wall in ((high, (100.0, 2.0)), (low, (20000.0, 60.0))):
        device = Device.from_response(part, case.response(part))
        assert HapticLoop(device=device, sample_time=1e-3).verdict(*wall) == 3
        assert measured(case, case.response(HERTZ)).verdict(*wall) == MeasuredVerdict.STABLE


def test_walls_beyond_a_resonance_between_two_frequencies_are_undecided() -> None:
    """A held device at 3.4 Hz, measured every 2.5 Hz, turns from 0.67 to 3.2 Hz by 180 degrees."""
    case = known(mass=0.73, damping=0.25, stiffness=342.0, delay=1.6, window=5)
    coarse, fine = np.linspace(0.67, 500.0, 200), np.linspace(0.5, 500.0, 20_000)
    limits = []
    for hertz in (coarse, fine):
        device = Device.from_response(hertz, case.response(hertz))
        loop = HapticLoop(device=device, sample_time=1e-3, velocity=case.velocity)
        assert not case.is_stable(500.0, 0.0)
        assert loop.verdict(500.0, 0.0) == (3 if hertz is coarse else MeasuredVerdict.UNSTABLE)
        limits.append(loop.stiffness_intervals(0.0).intervals[-1].high.value)
    assert 0.0 < limits[0] <= limits[1]


def test_a_resonance_of_which_both_sides_are_small_may_be_large() -> None:
    """A held device at 12.3 Hz, measured every 8.3 Hz: |L| is 0.6 and 0.7, and 100 between them."""
    case = known(mass=0.186, damping=0.056, stiffness=1109.0, delay=2.3, window=5)
    coarse, wall = np.linspace(500.0 / 60, 500.0, 60), (500.0, 0.0)
    sides = wall[0] * abs(case.response(coarse[:2]))
    assert sides.max() < 1.0 < wall[0] * abs(case.response(np.array([12.3])))[0]
    assert not case.is_stable(*wall)
    device = Device.from_response(coarse, case.response(coarse))
    loop = HapticLoop(device=device, sample_time=1e-3, velocity=case.velocity)
    assert loop.verdict(*wall) == MeasuredVerdict.UNDECIDED


@pytest.mark.parametrize("wall", [(0.0, 0.0), (15.0, 0.03), (10.0, 0.02)])
def test_margins_of_soft_walls_on_a_held_device(wall: tuple[float, float]) -> None:
    """Of few walls of the line through one, which need not be among those that are tried."""
    case = known(mass=0.5, damping=1.0, stiffness=200.0, delay=2.0)
    loop = measured(case, case.response(HERTZ), 0.1)
    found = loop.frequency_margins(*wall)
    assert (found.verdict, case.is_stable(*wall)) == (MeasuredVerdict.STABLE, True)
    largest = float(found.largest_gain.value)
    assert largest > 1.0
    if any(wall):
        assert case.is_stable(*(largest * np.array(wall)))


def test_a_delay_beside_the_measured_one_counts() -> None:
    case = CASES["a mass"]
    later = case._replace(whole=case.whole + 3)
    device = Device.from_response(HERTZ, case.response(HERTZ))
    loop = HapticLoop(device=device, sample_time=1e-3, delay=3e-3)
    row = loop.stiffness_intervals(20.0).intervals[-1]
    assert later.is_stable(row.high.value, 20.0)
    assert not later.is_stable(row.high.value + row.high.error, 20.0)


REFUSED = {
    "limits with delays": lambda loop: loop.limits(delays=(0.0, 1e-3)),
    "region": lambda loop: loop.region(),
    "poles": lambda loop: loop.poles(100.0, 1.0),
    "spectral_radius": lambda loop: loop.spectral_radius(100.0, 1.0),
    "margins": lambda loop: loop.margins(100.0, 1.0),
    "tune": lambda loop: loop.tune(),
    "simulate": lambda loop: loop.simulate(100.0, 1.0, force=1.0),
    "contact": lambda loop: loop.contact(100.0, 1.0, push=1.0),
    "amplitude": lambda loop: loop.amplitude(100.0, 1.0, encoder=1e-5),
    "range_of": lambda loop: loop.range_of("delay", 100.0, 1.0),
    "robust_limit": lambda loop: loop.robust_limit(jaxstab.HandRange(mass=(0.0, 1.0))),
    "poles of the device": lambda loop: loop.device.poles(),
    "a hand": lambda loop: loop.device.held_by(jaxstab.Hand.mass_spring_damper(1.0)),
    "an actuator": lambda loop: loop.device.with_actuator(100.0),
}


@pytest.mark.parametrize("question", REFUSED)
def test_what_needs_a_model_is_refused_in_one_sentence(question: str) -> None:
    loop = measured(CASES["a hand"], noisy(CASES["a hand"], 1))
    with pytest.raises(ValueError, match="has no model to answer this: ask verdict") as refused:
        REFUSED[question](loop)
    assert_one_sentence(f"jaxstab: {refused.value}\n")


BAD = {
    "few": ((HERTZ[:7], np.ones(7)), "has 7 frequencies"),
    "twice": ((np.ones(9), np.ones(9)), "or one twice"),
    "lengths": ((HERTZ, np.ones(9)), "response has 9 values and error 1"),
    "errors": ((HERTZ, np.ones(1000), [0.1, 0.2]), "error 2"),
    "NaN": ((HERTZ, np.full(1000, np.nan)), "response is nan"),
    "sign": ((HERTZ, 1j / HERTZ), "the phase at 0.5 Hz is 90 degrees"),
    "zero": ((np.append(0.0, HERTZ), np.ones(1001)), "frequency is 0.0"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_response_is_refused(name: str) -> None:
    (frequency, response, *error), words = BAD[name]
    with pytest.raises(ValueError, match=re.escape(words)) as refused:
        Device.from_response(frequency, response, error=error[0] if error else None)
    assert_one_sentence(f"jaxstab: {refused.value}\n")


def test_sampling_of_loop_and_response_must_fit() -> None:
    device = Device.from_response(HERTZ, CASES["a mass"].response(HERTZ))
    with pytest.raises(ValueError, match="up to half of the sampling rate, 250 Hz"):
        HapticLoop(device=device, sample_time=2e-3).verdict(1.0, 1.0)
    with pytest.raises(ValueError, match=r"beside it is 0\.5 samples"):
        HapticLoop(device=device, sample_time=1e-3, delay=0.5e-3).limits()


def test_position_filters_count() -> None:
    """A first-order low pass of the position, in closed form: 0.4 below 1 - 0.6/z."""
    response = CASES["a hand"].response(HERTZ)
    smooth = Filter.exponential(0.4)
    loop = HapticLoop(
        device=Device.from_response(HERTZ, response), sample_time=1e-3, position=smooth
    )
    z = np.exp(2j * pi * HERTZ * 1e-3)
    same = Device.from_response(HERTZ, response * 0.4 / (1.0 - 0.6 / z))
    other = HapticLoop(device=same, sample_time=1e-3)
    ends = [x.stiffness_intervals(0.0).intervals[-1].high.value for x in (loop, other)]
    assert ends[0] == pytest.approx(ends[1], rel=1e-6)
    assert 0.0 < ends[0] < inf


# The command, by a scene beside the file of the response.

SCENE = """
[device]
response = "sweep.csv"
error = 0.01
[controller]
sample_time = 0.001
velocity.window_samples = 20
[walls.soft]
stiffness = 800.0
damping = 10.0
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    response = noisy(CASES["a window and a fraction"], 5)
    columns = np.stack([HERTZ, abs(response), np.degrees(np.angle(response))], axis=1)
    header = "frequency,gain,phase"
    np.savetxt(tmp_path / "sweep.csv", columns, delimiter=",", header=header, comments="")
    (tmp_path / "measured.toml").write_text(SCENE)
    return tmp_path / "measured.toml"


COMMANDS = "limits", "check"


def test_limits_and_check_answer_by_the_file_of_a_response(scene: Path) -> None:
    limits, check = run("limits", scene), run("check", scene)
    assert (limits.exit_code, check.exit_code) == (0, 0), limits.stderr + check.stderr
    for answer in (limits, check):
        assert "from measured data, not proved" in answer.stdout
        assert "a response measured at 1000 frequencies, 0.5 to 500 Hz" in answer.stdout
    assert "largest stiffness" in limits.stdout
    assert (
        "wall soft          800 N/m at 10 N s/m, within the known stable range of" in limits.stdout
    )
    assert "wall soft       800 N/m at 10 N s/m: stable\n" in check.stdout
    assert "phase margin" in check.stdout
    hard = run("check", scene, "--wall", "hard", 3000.0, 10.0)
    assert hard.exit_code == 1
    assert re.search(r"wall hard +3000 N/m at 10 N s/m: unstable\n", hard.stdout)


def test_where_the_data_do_not_tell_no_gain_is_called_unstable(scene: Path) -> None:
    case = known(mass=0.5, damping=1.0, stiffness=200.0, delay=2.0, window=20)
    assert case.is_stable(300.0, 5.0)
    response, hertz = case.response(HERTZ[1::4]), HERTZ[1::4]
    columns = np.stack([hertz, abs(response), np.degrees(np.angle(response))], axis=1)
    header = "frequency,gain,phase"
    np.savetxt(scene.parent / "sweep.csv", columns, delimiter=",", header=header, comments="")
    limits, check = (run(name, scene, "--wall", "a", 300.0, 5.0).stdout for name in COMMANDS)
    assert re.search(r"wall a +300 N/m at 5 N s/m, where no stiffness is known to be", limits)
    assert re.search(r"a +300 N/m at 5 N s/m: undecided\n +stable walls +no known K at 5", check)


@pytest.mark.parametrize(
    ("column", "changed", "words"),
    [
        (2, lambda degrees: np.unwrap(np.radians(degrees)), "give phases in degrees"),
        (1, lambda gain: 20.0 * np.log10(gain), "gain is -7.86"),
    ],
)
def test_radians_and_decibels_are_refused(
    column: int, changed: Any, words: str, scene: Path
) -> None:
    file = scene.parent / "sweep.csv"
    columns = np.loadtxt(file, delimiter=",", skiprows=1)
    columns[:, column] = changed(columns[:, column])
    np.savetxt(file, columns, delimiter=",", header="frequency,gain,phase", comments="")
    answer = run("check", scene)
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert words in answer.stderr


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("tune",), "tune needs a model"),
        (("guard", "-o", "guard.h"), "device.response is measured and no model"),
        (("limits", "--mass", 1.0), "device.mass is unknown"),
        (("limits", "--plot", "x.png"), "a measured response has no picture"),
        (("check", "--set", "device.response=none.csv"), "cannot read none.csv"),
        (("limits", "--set", "device.error=2"), "device.error is 2"),
        (("check", "--set", "wanted=3"), "wanted is 3; give a table"),
        (("check", "--set", "wanted.frequency=no"), "wanted.frequency is 'no'; give true or false"),
        (("check", "--hand-mass", 1.0), "leave [hand] out"),
    ],
)
def test_commands_refuse_in_one_sentence(
    command: tuple[Any, ...], words: str, scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(scene.parent)
    answer = run(command[0], scene, *command[1:])
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert words in answer.stderr
