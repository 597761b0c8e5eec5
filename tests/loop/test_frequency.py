"""Margins in the language of frequency are true by mpmath, and say so where they are not proved."""

import re
import warnings
from math import inf, isnan, nan
from typing import Any

import flint
import jax
import numpy as np
import pytest
import scipy.signal
from campaign import first, many
from commands import run
from matplotlib.figure import Figure
from mpmath import mp

import jaxstab
from jaxstab import Device, HapticLoop, Loop, Mode, Velocity
from jaxstab.app.scene import Scene, check_walls
from jaxstab.exact.margins import readings
from jaxstab.model.balls import Factored
from tests.truth import open_loops

WINDOW = HapticLoop(
    device_mass=0.25,
    device_damping=0.1,
    sample_time=1e-3,
    delay=1e-3,
    velocity=Velocity.difference(window=0.02),
)


def pure_delay(samples: int) -> Loop:
    """L = a z^-n + b z^(1-n)."""
    base = [1.0, *[0.0] * samples]
    return Loop.from_coefficients(base=base, first=[1], second=[1, 0], sample_time=1.0)


# ------------------------------------------------------------------------------------------ mpmath
@pytest.mark.parametrize("number", first(range(9), 4))  # one loop of each kind
def test_margins_and_peaks_are_those_of_mpmath(number: int) -> None:
    asked = open_loops.drawn(number, seed=55)
    assert list(open_loops.wrong(asked)) == [], asked.words


@pytest.mark.campaign
def test_no_margin_of_random_loops_is_wrong() -> None:
    for number in range(many(1000, small=20)):
        asked = open_loops.drawn(number, seed=551)
        assert list(open_loops.wrong(asked)) == [], asked.words


@pytest.mark.campaign
def test_the_truth_denies_what_is_wrong() -> None:
    asked = open_loops.of_kind("kp-ki", np.random.default_rng(3))
    assert list(open_loops.wrong(asked)) == []
    moved = {
        (name, factor): own._replace(value=own.value * factor)
        for name, own in asked.margins._asdict().items()
        if name != "verdict" and np.isfinite(own.value) and own.value
        for factor in (1.0 - 1e-6, 1.0 + 1e-6)
    }
    assert len(moved) >= 12
    for (name, _), own in moved.items():
        claims = asked.margins._replace(**{name: own})
        assert [*open_loops.wrong(asked._replace(margins=claims), grid=60)], name


# -------------------------------------------------------------------------------------- other tools
def by_control(truth: open_loops.OpenLoop) -> tuple[float, float, float]:
    """Gain margin, phase margin in degrees and least |1 + L| of python-control."""
    import control

    sides = [truth.below, [w - d for w, d in zip(truth.whole, truth.below, strict=True)]]
    floats = [[float(c) if abs(c) > 1e-60 * max(map(abs, p)) else 0.0 for c in p] for p in sides]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loop = control.TransferFunction(np.trim_zeros(floats[1], "f"), floats[0], truth.period)
        gain, phase, distance, *_ = control.stability_margins(loop)
    return float(gain), abs(float(phase)), float(distance)


@pytest.mark.campaign
def test_python_control_agrees_or_mpmath_denies_it() -> None:
    pytest.importorskip("control")
    agreed = asked_for = 0
    for number in range(many(500, small=30)):
        asked = open_loops.drawn(number, seed=552)
        margins = asked.margins
        own = margins.largest_gain.value, margins.phase.value, 1.0 / margins.sensitivity.value
        theirs = by_control(asked.truth)
        is_same = np.isclose(theirs, np.array(own, float), rtol=1e-6)
        is_same[0] |= np.isclose(theirs[0], margins.least_gain.value, rtol=1e-6)  # which is nearer
        agreed, asked_for = agreed + int(is_same.sum()), asked_for + 3
        if not is_same.all():
            assert list(open_loops.wrong(asked)) == [], asked.words
    assert agreed > 0.7 * asked_for


# ------------------------------------------------------------------------------------- closed forms
def test_a_pure_delay_has_the_margins_of_its_gain() -> None:
    margins = pure_delay(4).frequency_margins(a=0.5, b=0.0)
    expected = {
        "least_gain": -2.0,
        "largest_gain": 2.0,
        "phase": inf,
        "delay": inf,
        "sensitivity": 2.0,
        "complementary": 1.0,
        "disk": 2.0 / 3.0,
    }
    for name, value in expected.items():
        assert getattr(margins, name).value == pytest.approx(value, rel=1e-15), name
    assert margins.largest_gain.frequency == pytest.approx(1.0 / 8.0, rel=1e-15)  # e^(4 i th) = -1
    assert margins.sensitivity.frequency == pytest.approx(1.0 / 8.0, rel=1e-15)
    assert isnan(margins.phase.frequency)


@pytest.mark.parametrize("gain", [0.1, 0.5, 1.0, 1.9])
def test_an_integrator_has_margins_in_closed_form(gain: float) -> None:
    """L = g/(z - 1): |L| = 1 at 2 sin(th/2) = g, where arg L = -(pi + th)/2; p = z - 1 + g."""
    loop = Loop.from_coefficients(base=[1, -1], first=[1], second=[2], sample_time=0.01)
    margins = loop.frequency_margins(a=gain, b=0.0)
    angle = 2.0 * np.arcsin(gain / 2.0)
    assert margins.largest_gain.value == pytest.approx(2.0 / gain, rel=1e-15)
    assert margins.phase.value == pytest.approx(np.degrees(np.pi - angle) / 2.0, rel=1e-14)
    assert margins.phase.frequency == pytest.approx(angle / (2.0 * np.pi * 0.01), rel=1e-14)
    lag = (np.pi - angle) / 2.0 / angle
    assert margins.delay.value == pytest.approx(0.01 * lag, rel=1e-14)
    assert margins.sensitivity.value == pytest.approx(max(2.0 / (2.0 - gain), 1.0), rel=1e-15)


def test_without_an_open_loop_and_with_one_of_1_the_numbers_are_known() -> None:
    """L = 0; and L = 1, which has the modulus 1 everywhere: no angle is the crossover."""
    below = Factored(flint.arb_poly([-0.5, 1]))
    nothing = readings(lambda: (below, Factored(flint.arb_poly([]))))
    assert [own.value for own in nothing] == [-inf, inf, inf, inf, 1.0, 0.0, 2.0]
    assert all(own.error == 0.0 for own in nothing)
    equal = readings(lambda: (below, below))
    assert isnan(equal.phase.value)
    assert isnan(equal.delay.value)
    assert equal.sensitivity == equal.complementary == (0.5, 0.0, 0.0)


def test_gain_margins_are_those_of_the_interval_that_holds_the_loop() -> None:
    """L = 3/(2 (z - 2)): z - 2 + 3 t/2 is stable for t from 2/3 to 2, not at t = 1/2."""
    sides = Factored(flint.arb_poly([-2, 1])), Factored(flint.arb_poly([1.5]))
    margins = readings(lambda: sides)
    assert margins.least_gain.value == pytest.approx(2.0 / 3.0, rel=1e-15)
    assert margins.largest_gain.value == pytest.approx(2.0, rel=1e-15)


def test_a_gain_that_only_touches_1_may_be_a_crossover() -> None:
    """L = (z^2 - 1)/(2 z^2): |L| = sin(theta) is 1 at a right angle, where L = 1."""
    sides = Factored(flint.arb_poly([1]), 2), Factored(flint.arb_poly([0.5]), 0, 1, 1)
    value, error, angle = readings(lambda: sides).phase
    assert value == pytest.approx(np.pi, rel=1e-15)
    assert error == inf  # the margin may be larger
    assert angle == pytest.approx(np.pi / 2, rel=1e-15)


def test_a_crossover_at_which_the_loop_is_1_leaves_the_others() -> None:
    """L = 1 + (z^2 + 1)/(2 z^3) = 1 + c e^(-2 i theta), c = cos(theta), is 1 at i."""
    sides = Factored(flint.arb_poly([1]), 3), Factored(flint.arb_poly([0.5, 0, 0.5, 1]))
    theta = np.arccos((-1.0 - np.sqrt(33.0)) / 8.0)
    lag = np.pi + np.angle(1.0 + np.cos(theta) * np.exp(-2j * theta))
    value, error, angle = readings(lambda: sides).phase
    assert (value, angle) == pytest.approx((lag, theta), rel=1e-14)
    assert error < 1e-15


def test_a_loop_above_1_at_half_the_sampling_rate_has_at_most_a_sample_of_delay() -> None:
    """L = 0.6 (z - 0.9)/z: z^2 + 0.6 z - 0.54, a sample later, has a root at -1.09."""
    sides = Factored(flint.arb_poly([1]), 1), Factored(flint.arb_poly([-0.54, 0.6]))
    value, error, angle = readings(lambda: sides).delay
    assert (value, angle) == (1.0, np.pi)
    assert error < 1e-15


def test_a_loop_that_is_1_at_no_frequency_has_any_margin_of_the_delay() -> None:
    """L = 1/(2 z - 1) is 1 at z = 1 and smaller anywhere else: no delay makes it -1."""
    sides = Factored(flint.arb_poly([-0.5, 1])), Factored(flint.arb_poly([0.5]))
    value, _, angle = readings(lambda: sides).delay
    assert value > 1e30
    assert angle < 1e-30


def test_a_lead_that_makes_the_loop_unstable_is_the_phase_margin() -> None:
    """L = -a/(z + 1/2), a = 1.2: |L| is 1 at cos(theta) = a^2 - 5/4; L is -1 by arg(z + 1/2)."""
    loop = Loop.from_coefficients(base=[1.0, 0.5], first=[1.0], second=[1.0, 0.0], sample_time=1.0)
    theta = np.arccos(1.2**2 - 1.25)
    lead = np.degrees(np.angle(np.exp(1j * theta) + 0.5))
    phase = loop.frequency_margins(a=-1.2, b=0.0).phase
    assert float(phase.value) == pytest.approx(lead, abs=1e-12)
    assert float(phase.frequency) == pytest.approx(theta / (2.0 * np.pi), rel=1e-14)


def test_whole_samples_of_delay_below_the_margin_are_stable_and_one_more_is_not() -> None:
    loop = Loop.from_coefficients(base=[1, -1], first=[1], second=[2], sample_time=1.0)
    more = float(loop.frequency_margins(a=0.11, b=0.0).delay.value)
    radii = [
        np.abs(np.roots([1.0, -1.0, *[0.0] * (samples - 1), 0.11])).max()
        for samples in range(1, int(more) + 2)
    ]
    assert more > 5.0
    assert [radius < 1.0 for radius in radii] == [True] * int(more) + [False]


def test_where_the_gain_is_above_one_at_half_the_sampling_rate_no_sample_more_is_allowed() -> None:
    loop = Loop.from_coefficients(base=[1, 1.5], first=[1], second=[2], sample_time=0.5)
    margins = loop.frequency_margins(a=-1.25, b=0.0)  # L(-1) = -2.5
    assert margins.verdict == jaxstab.Verdict.STABLE
    assert 0.0 < margins.delay.value <= 0.5
    assert np.abs(np.roots([1.0, 1.5, -1.25])).max() > 1.0


# -------------------------------------------------------------------------------------------- edges
def test_an_unstable_wall_has_no_margins_and_says_so() -> None:
    margins = WINDOW.frequency_margins(5000.0, 30.0)
    assert margins.verdict == jaxstab.Verdict.UNSTABLE
    assert all(isnan(own.value) for own in margins[1:])
    assert repr(margins) == "Frequency margins: none, the loop is unstable"


def test_without_a_wall_nothing_is_fed_back() -> None:
    held = HapticLoop(
        device_mass=0.25, device_damping=0.1, hand_stiffness=300.0, sample_time=1e-3
    ).frequency_margins(0.0, 0.0)
    values = [float(own.value) for own in held[1:]]
    assert values == [-inf, inf, inf, inf, 1.0, 0.0, 2.0]
    free = WINDOW.frequency_margins(0.0, 0.0)
    assert free.verdict == jaxstab.Verdict.UNSTABLE


@pytest.mark.parametrize(
    ("loop", "wall"),
    [
        (  # L(1) = 1: |L| = 1 at an end of the circle as well
            HapticLoop(
                device_mass=0.25, device_damping=0.1, hand_stiffness=300.0, sample_time=1e-3
            ),
            (300.0, 10.0),
        ),
        (  # poles of L on the circle
            HapticLoop(
                device_mass=0.25, device_damping=0.0, hand_stiffness=500.0, sample_time=1e-3
            ),
            (100.0, 5.0),
        ),
        (  # three zeros of L at z = -1, where S has a value of 1 to the fourth order
            HapticLoop(
                device_mass=0.25,
                device_damping=0.1,
                sample_time=1e-3,
                velocity=Velocity.butterworth(100.0, order=3),
            ),
            (100.0, 5.0),
        ),
    ],
)
def test_ends_of_the_circle_and_poles_on_it_are_no_obstacle(
    loop: HapticLoop, wall: tuple[float, float]
) -> None:
    margins = loop.frequency_margins(*wall)
    assert all(np.isfinite(own.error) and own.error < 1e-9 for own in margins[1:])
    frequencies = np.geomspace(0.01, 500.0, 4000)
    response = frequency_response(loop, wall, frequencies)
    assert 1.0 / abs(1.0 + response).min() == pytest.approx(margins.sensitivity.value, rel=1e-4)
    assert abs(response / (1 + response)).max() == pytest.approx(
        margins.complementary.value, rel=1e-4
    )


def frequency_response(loop: HapticLoop, wall: tuple[float, float], frequencies: Any) -> np.ndarray:
    """L of one mass behind the difference or a filter, from its own poles in 40 digits."""
    from jaxstab.model.balls import ball_triple
    from jaxstab.model.device.parts import working_precision

    with working_precision(400), mp.workdps(40):
        base, *sides = (
            [mp.mpf(c.mid().str(60, radius=False)) for c in part.polynomial().coeffs()[::-1]]
            for part in ball_triple(loop)
        )
        found = []
        for frequency in frequencies:
            z = mp.expjpi(2 * frequency * loop.sample_time)
            k, b = (open_loops.horner(side, z) for side in sides)
            found.append(complex((wall[0] * k + wall[1] * b) / open_loops.horner(base, z)))
    return np.array(found)


def test_a_sharp_resonance_is_not_missed() -> None:
    device = Device.modes([Mode(frequency=34.7, damping_ratio=1e-7, modal_mass=2.9)], mass=0.12)
    loop = HapticLoop(device=device, sample_time=1e-3, delay=1e-3)
    margins = loop.frequency_margins(20.0, 2.0)
    assert margins.verdict == 1
    spread = 34.7 * (1.0 + np.linspace(-1e-5, 1e-5, 2001))
    response = frequency_response(loop, (20.0, 2.0), spread)
    assert 1.0 / abs(1.0 + response).min() <= margins.sensitivity.value * (1.0 + 1e-12)


@pytest.mark.parametrize(
    "margins",
    [
        pytest.param(lambda: pure_delay(200).frequency_margins(a=0.5, b=0.2), id="delay"),
        pytest.param(
            lambda: HapticLoop(
                device_mass=0.25,
                device_damping=0.1,
                sample_time=1e-3,
                velocity=Velocity.difference(samples=200),
            ).frequency_margins(1.0, 1.0),
            id="window",
            marks=pytest.mark.campaign,
        ),
    ],
)
def test_high_degrees_are_answered(margins: Any) -> None:
    found = margins()
    assert found.verdict == 1
    assert all(own.error < 1e-9 for own in found[1:])


def test_what_is_not_proved_is_nan_and_is_called_so() -> None:
    wide = Loop.from_coefficients(base=[1, -1], first=[(0.4, 0.5)], second=[1], sample_time=1.0)
    margins = wide.frequency_margins(a=0.5, b=0.0)
    assert margins.verdict == 1
    assert isnan(margins.sensitivity.value)
    assert re.search(r"peak sensitivity +not proved", repr(margins))


def test_a_delay_that_is_too_long_to_be_tried_is_a_bound() -> None:
    late = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=0.1)
    slow = late.frequency_margins(0.02, 0.02)
    assert slow.delay.error == inf
    assert slow.delay.value == late.margins(0.02, 0.02).extra_delay
    assert "at least" in repr(slow)


# -------------------------------------------------------------------------------- shapes, refusals
def test_gains_broadcast_as_those_of_margins_do() -> None:
    many_walls = WINDOW.frequency_margins([[1000.0], [5000.0]], [10.0, 15.0, 12.0])
    assert many_walls.verdict.shape == many_walls.phase.value.shape == (2, 3)
    assert many_walls.verdict.tolist() == [[1, 1, 1], [2, 2, 2]]
    assert many_walls.phase.value[0, 1] == WINDOW.frequency_margins(1000.0, 15.0).phase.value
    assert repr(many_walls).splitlines()[-1].split() == ["unstable", *["none"] * 7]
    robots = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4)
    assert robots.frequency_margins(mass=[2.0, 3.0], damping=50.0).disk.error.shape == (2,)


def test_the_margins_of_pid_are_those_of_all_three_gains() -> None:
    device = jaxstab.HapticLoop(
        device_mass=0.5, device_damping=1.0, hand_stiffness=100.0, sample_time=1e-3, delay=1e-3
    )
    gains = {"kp": 900.0, "ki": 4000.0, "kd": 15.0}
    plant = scipy.signal.cont2discrete(([1.0], [0.5, 1.0, 100.0]), 1e-3)
    # N/D in z behind a delay of a sample: kp + ki T z/(z - 1) + kd (z - 1)/(T z) before the plant.
    wall = [
        np.array(own) * gains[name]
        for name, own in (
            ("kp", [1.0, -1.0, 0.0]),
            ("ki", [1e-3, 0.0, 0.0]),
            ("kd", [1e3, -2e3, 1e3]),
        )
    ]
    above = np.polymul(np.squeeze(plant[0]), np.sum(wall, axis=0))
    below = np.polymul(plant[1], [1.0, -1.0, 0.0, 0.0])

    def radius(factor: float) -> float:
        return float(np.abs(np.roots(np.polyadd(below, factor * above))).max())

    circle = np.exp(1j * np.geomspace(1e-4, np.pi, 200_000))
    opened = np.polyval(above, circle) / np.polyval(below, circle)
    for name, value in gains.items():
        others = {other: gains[other] for other in gains if other != name}
        found = jaxstab.pid(device, **{name: value}).frequency_margins(**others)
        most = float(found.largest_gain.value)
        assert radius(most * (1.0 - 1e-6)) < 1.0 < radius(most * (1.0 + 1e-6))
        assert float(found.sensitivity.value) == pytest.approx(np.abs(1.0 / (1.0 + opened)).max())


def test_gain_and_delay_margins_are_those_of_margins() -> None:
    margins, own = WINDOW.margins(1000.0, 10.0), WINDOW.frequency_margins(1000.0, 10.0)
    assert own.delay.value == margins.extra_delay
    assert own.delay.error < 1e-8 * own.delay.value
    pd = jaxstab.simulated_pd(0.1, step=2e-3, substeps=4)
    both = pd.margins(kp=500.0, kd=10.0).both_factors
    found = pd.frequency_margins(kp=500.0, kd=10.0)
    assert found.largest_gain.value == pytest.approx(both[1], rel=1e-14)


def test_an_admittance_is_opened_at_its_acceleration() -> None:
    robot = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4)
    factor = float(robot.frequency_margins(mass=2.0, damping=50.0).largest_gain.value)
    masses = [2.0 / (factor * near) for near in (1.0 - 1e-9, 1.0 + 1e-9)]
    assert robot.verdict(mass=masses, damping=50.0).tolist() == [1, 2]


@pytest.mark.parametrize(
    ("ask", "error", "sentence"),
    [
        (lambda: WINDOW.frequency_margins(nan, 1.0), ValueError, "stiffness is nan; allowed"),
        (lambda: WINDOW.frequency_margins("stiff", 1.0), TypeError, "stiffness is 'stiff'; give"),
        (
            lambda: HapticLoop(
                device_mass=[0.1, 0.2], device_damping=0.1, sample_time=1e-3
            ).frequency_margins(1.0, 1.0),
            TypeError,
            "one loop is needed here",
        ),
        (
            lambda: jax.jit(lambda k: WINDOW.frequency_margins(k, 1.0).phase.value)(1.0),
            TypeError,
            "stiffness or damping is traced; give concrete gains",
        ),
        (
            lambda: jaxstab.simulated_pd(0.1, step=2e-3).frequency_margins(kp=1.0),
            TypeError,
            "gains given: kp; give both kp and kd",
        ),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(ask: Any, error: type, sentence: str) -> None:
    with pytest.raises(error, match=sentence):
        ask()


# ---------------------------------------------------------------------------------------- pictures
@pytest.mark.parametrize(
    ("kind", "labels"),
    [("nyquist", ("Re L", "Im L")), ("bode", ("frequency (Hz)", "magnitude (dB)"))],
)
def test_pictures_name_the_margins_and_their_places(kind: str, labels: tuple[str, str]) -> None:
    axes = WINDOW.plot(kind, 1000.0, 12.0, ax=Figure().subplots())
    assert (axes.get_xlabel(), axes.get_ylabel()) == labels
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert "phase margin 12.7 degrees at 13.4 Hz" in words
    assert "peak sensitivity 4.84 at 14.1 Hz" in words
    assert axes.get_title() == ""
    unstable = WINDOW.plot(kind, 5000.0, 30.0, ax=Figure().subplots())
    assert unstable.get_title() == "not proved stable: there are no margins"


def test_the_curve_of_a_picture_is_the_open_loop() -> None:
    """L = g/(z - 1) at every frequency that is drawn."""
    loop = Loop.from_coefficients(base=[1, -1], first=[1], second=[2], sample_time=1.0)
    axes = loop.plot("nyquist", a=0.5, b=0.0, ax=Figure().subplots())
    (curve,) = (line for line in axes.lines if line.get_label() == "L")
    drawn = curve.get_xdata() + 1j * curve.get_ydata()
    turns = 1.0 + 0.5 / drawn
    np.testing.assert_allclose(np.abs(turns), 1.0, rtol=1e-12)
    assert np.angle(turns).max() == pytest.approx(np.pi)


@pytest.mark.parametrize(
    ("draw", "error", "sentence"),
    [
        (lambda: WINDOW.plot("nichols"), ValueError, "kind is 'nichols'; give one of \"region\""),
        (
            lambda: WINDOW.plot("bode", 1000.0),
            TypeError,
            "gains given: stiffness; give both",
        ),
        (lambda: WINDOW.plot("region", 1.0, 1.0), TypeError, "gains are given beside kind"),
        (
            lambda: jaxstab.simulated_pd(0.1, step=2e-3).plot("bode", kp=1.0),
            TypeError,
            "gains given: kp; give both kp and kd",
        ),
    ],
)
def test_pictures_that_cannot_be_drawn_are_refused(draw: Any, error: type, sentence: str) -> None:
    with pytest.raises(error, match=sentence):
        draw()


# ------------------------------------------------------------------------------------- command line
SOFT = {"device": {"mass": 0.25, "damping": 0.1}, "walls": {"a": {"stiffness": 1e3, "damping": 12}}}
SOFT["controller"] = {"sample_time": 1e-3, "delay": 1e-3, "velocity": {"window_samples": 20}}  # type: ignore[dict-item]


def test_check_has_a_line_of_phase_margin_and_peak_sensitivity() -> None:
    lines = str(check_walls(Scene.from_table(SOFT))).splitlines()
    (line,) = (line for line in lines if "phase margin" in line)
    words = "12.72 degrees at 13.3916 Hz, peak sensitivity 4.837 at 14.138 Hz"
    assert line.split("phase margin")[1].strip() == words


def test_check_prints_all_margins_on_request_for_the_worst_hand() -> None:
    hand = {"mass": [0.0, 0.5], "stiffness": [0.0, 100.0], "damping": [0.0, 1.0]}
    table = SOFT | {"hand": hand, "wanted": {"frequency": True, "measures": ["frequency"]}}
    (wall,) = check_walls(Scene.from_table(table)).walls.values()
    found = wall.margins_over_frequency
    assert found is not None
    assert wall.measures_are == "the worst of 8 hands"
    every = [
        HapticLoop(**own, device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3,
                   velocity=Velocity.difference(samples=20)).frequency_margins(1e3, 12.0)
        for own in (
            {"hand_mass": m, "hand_stiffness": k, "hand_damping": b}
            for m in (0.0, 0.5) for k in (0.0, 100.0) for b in (0.0, 1.0)
        )
    ]  # fmt: skip
    assert found.phase_margin == min(float(own.phase.value) for own in every)
    assert found.peak_sensitivity == max(float(own.sensitivity.value) for own in every)
    assert found.disk_margin == min(float(own.disk.value) for own in every)
    assert found.gain_margin == min(float(own.largest_gain.value) for own in every)
    assert re.search(r"(?m)^peak complementary +[\d.]+ at [\d.]+ Hz$", str(wall))


def test_check_of_other_gains_has_them_too_and_an_unstable_wall_has_none() -> None:
    pid = "data/scenes/gains/pid.toml"
    result = run("check", pid, "--frequency")
    assert re.search(r"(?m)^  disk margin +0.733 at 36.9998 Hz$", result.output)
    assert "phase margin" not in result.output.split("gains hasty")[1]
