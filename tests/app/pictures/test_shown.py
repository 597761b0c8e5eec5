"""What answers print and draw of themselves says no more than what was computed."""

import pickle
import re
from base64 import b64decode
from dataclasses import replace
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from fractions import Fraction
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

import jaxstab
from jaxstab.region import RegionStatus
from jaxstab.region.stable_set import ALPHA_BETA, limits_text
from jaxstab.shown import rounded_text, text_with_bound

GOLDEN = Path(__file__).parents[3] / "data" / "golden" / "atlas-v5.h5"
OMEGA = {"device_mass": 0.25, "device_damping": 0.1, "sample_time": 1e-3, "delay": 1e-3}
WINDOW = jaxstab.HapticLoop(**OMEGA, velocity=jaxstab.Velocity.difference(window=0.02))
PLAIN = jaxstab.HapticLoop(**OMEGA)


@given(
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(0.0, allow_nan=False, allow_infinity=False),
)
def test_what_is_printed_with_a_bound_holds_all_that_the_bound_held(
    value: float, error: float
) -> None:
    digits, bound = text_with_bound(value, error).split(" +/- ")
    moved = abs(Fraction(Decimal(digits)) - Fraction(value))
    assert moved + Fraction(error) <= Fraction(Decimal(bound))


def test_ten_digits_of_a_limit_are_rounded_inwards() -> None:
    assert rounded_text(12.814606139755455, 10, ROUND_FLOOR) == "12.81460613"
    assert rounded_text(0.03509350341001, 10, ROUND_CEILING) == "0.03509350342"
    assert rounded_text(2999.9999999999995, 10, ROUND_FLOOR) == "3000"  # but for rounding


def test_a_radius_prints_its_bound_and_how_it_is_known() -> None:
    radius = PLAIN.spectral_radius(1000.0, 10.0)
    shown = re.fullmatch(r"(\S+) \+/- (\S+) \(proved\)", repr(radius))
    assert shown
    assert float(shown[1]) == pytest.approx(float(radius.value), abs=float(shown[2]))
    assert float(shown[2]) >= float(radius.error)
    assert len(shown[0]) < 50


def test_many_radii_print_one_line() -> None:
    many = PLAIN.spectral_radius(np.linspace(0.0, 1e5, 100), 10.0)
    shown = repr(many)
    assert "100 loops" in shown
    assert f"{np.max(many.value):.6g}" in shown
    assert len(shown) < 120
    two = jaxstab.results.SpectralRadius(np.array([0.5, 0.75]), np.array([1e-15, 1.21e-14]), [1, 1])
    assert repr(two) == "SpectralRadius of 2 loops: 0.5 to 0.75, bound 1.3e-14 at most (2 proved)"
    none = PLAIN.spectral_radius(np.zeros(0), 10.0)
    assert repr(none) == "SpectralRadius of no loop"


def test_margins_print_a_table_that_is_rounded_inwards() -> None:
    margins = PLAIN.margins(1000.0, 10.0)
    head, stiffness, damping, _, delay = repr(margins).splitlines()
    assert head.split() == ["Margins:", "stable", "least", "largest", "factors"]
    for row, limits, gain in (
        (stiffness, margins.stiffness, margins.stiffness_gain),
        (damping, margins.damping, margins.damping_gain),
    ):
        low, high, _, _, factor = row.split()[-5:]
        low, high, factor = map(float, (low, high, factor))
        assert low == 0.0 or limits[0] <= low
        assert abs(limits[0] - low) < 1e-4 * abs(limits[0]) + 1e-9 * (limits[1] - limits[0])
        assert low <= high <= limits[1]
        assert 0.9999 * gain <= factor <= gain
    assert "(N/m)" in stiffness
    assert "(N s/m)" in damping
    assert float(delay.split()[-1]) <= margins.extra_delay
    plain = repr(jaxstab.margins(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0))
    assert "alpha" in plain
    assert "N/m" not in plain


@pytest.mark.parametrize("stiffness", [1e-3, 1000.0, [1000.0, 2000.0]])
def test_a_limit_that_is_zero_but_for_rounding_prints_as_zero(stiffness: float) -> None:
    """Of a free device stiffness ends at 0, by the root at z = 1."""
    margins = PLAIN.margins(stiffness, 10.0)
    assert np.all(margins.stiffness[..., 0] == 0.0)
    margins = margins._replace(first=margins.first + np.array([1e-7, 0.0]))
    assert not re.search(r"e-\d\d", repr(margins))


def test_margins_of_many_walls_are_a_row_each() -> None:
    few = repr(PLAIN.margins([1000.0, 1e6], 10.0)).splitlines()
    assert few[0] == "Margins of 2 pairs of gains"
    assert few[2].startswith("stable")
    assert few[3].split() == ["unstable", *["none"] * 8]
    many = repr(PLAIN.margins(np.linspace(10.0, 1000.0, 12), 10.0)).splitlines()
    assert many[-1] == "... and 4 more"


@pytest.mark.parametrize("loop", [PLAIN, WINDOW], ids=["plain", "window"])
def test_a_region_prints_four_lines_with_units(loop: jaxstab.HapticLoop) -> None:
    region = loop.region()
    lines = repr(region).splitlines()
    assert len(lines) == 4
    stiffest = re.search(r"stiffest +K = (\S+) N/m at B = (\S+) N s/m", lines[1])
    damped = re.search(r"most damped +B = (\S+) N s/m at K = (\S+) N/m", lines[2])
    assert stiffest
    assert damped
    limits = loop.limits()
    assert 0.9999 * limits.stiffness <= float(stiffest[1]) <= limits.stiffness
    assert 0.9999 * limits.damping <= float(damped[1]) <= limits.damping
    assert ("none found" in lines[3]) == (not region.islands)
    assert "N/m" not in repr(region.region)
    assert len(repr(region.region).splitlines()) == 4


@pytest.mark.parametrize(("count", "dots"), [(2, ""), (3, "; ...")])
def test_two_islands_are_described_and_of_more_it_is_said_that_there_are(
    count: int, dots: str
) -> None:
    islands = [np.array([0.5 + k, 0.25]) for k in range(count)]
    text = limits_text("", ALPHA_BETA, (islands[0],) * 2, islands, is_reachable=True)
    described = "alpha = 0.5 at beta = 0.25; alpha = 1.5 at beta = 0.25"
    assert text.endswith(f"islands      {count}, the stiffest of each: {described}{dots}")


def test_a_region_that_claims_nothing_prints_one_line() -> None:
    empty = jaxstab.stable_region(gamma=np.pi**2, delta=0.0, delay=1.0)
    assert empty.status != RegionStatus.COMPLETE
    assert repr(empty) == f"StableRegion: {empty.status.words}"
    assert empty._repr_html_() == f"<pre>{empty!r}</pre>"
    with pytest.raises(ValueError, match="nothing to draw"):
        empty.plot()


def test_what_jax_maps_over_prints_itself() -> None:
    printed = []

    def radius(alpha: jax.Array) -> jax.Array:
        found = jaxstab.spectral_radius(alpha, 0.2, gamma=0.0, delta=0.015, delay=1.0)
        margins = jaxstab.margins(alpha, 0.2, gamma=0.0, delta=0.015, delay=1.0)
        printed.extend([repr(found), repr(margins)])
        return found.value

    jax.eval_shape(radius, jnp.asarray(0.1))
    assert [text.split("(")[0] for text in printed] == ["SpectralRadius", "Margins"]


def test_an_atlas_prints_seven_lines() -> None:
    atlas = jaxstab.open_atlas(GOLDEN)
    lines = repr(atlas).splitlines()
    assert len(lines) == 7
    assert atlas.filters_in_words in lines[1]
    assert [line.split()[0] for line in lines[3:6]] == ["gamma", "delta", "delay"]
    assert lines[6].endswith("0 wrong")


def picture_in(html: str) -> bytes:
    (encoded,) = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    return b64decode(encoded)


@pytest.mark.campaign
def test_notebooks_show_a_picture_and_the_words() -> None:
    atlas = jaxstab.open_atlas(GOLDEN)
    for answer in (WINDOW.region(), PLAIN.region().region, atlas):
        html = answer._repr_html_()
        assert picture_in(html).startswith(b"\x89PNG")
        assert "<pre>" in html
        assert repr(answer).splitlines()[0].split("(")[0] in html


def test_plots_draw_what_is_asked_on_the_axes_that_are_given() -> None:
    axes = Figure().subplots()
    assert WINDOW.region().plot(axes) is axes
    filled = [patch.get_label() for patch in axes.patches]
    assert filled == ["stable", "stable, not connected to zero gains"]
    outline = axes.lines[0].get_xydata()
    assert np.nanmax(outline[:, 0]) == pytest.approx(WINDOW.limits().stiffness, rel=1e-6)
    axes = Figure().subplots()
    labels = [line.get_label() for line in PLAIN.plot(ax=axes).lines]
    assert "linear rule" in labels
    linear = axes.lines[labels.index("linear rule")].get_xydata()
    assert linear[:, 0] == pytest.approx((linear[:, 1] + 0.1) / 1.5e-3)
    assert "linear rule" not in [
        line.get_label() for line in WINDOW.plot(ax=Figure().subplots()).lines
    ]


def test_an_atlas_draws_the_verdicts_of_a_plane() -> None:
    atlas = jaxstab.open_atlas(GOLDEN)
    axes = atlas.plot(Figure().subplots(), delay=1.1)
    (mesh,) = axes.collections
    assert set(np.unique(mesh.get_array())) <= {1, 2, 3}
    with pytest.raises(ValueError, match="are outside of this atlas, or nothing is stable"):
        atlas.plot(Figure().subplots(), delay=77.0)


def test_without_axes_a_figure_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    from matplotlib import pyplot

    try:
        assert PLAIN.plot().figure.number in pyplot.get_fignums()
    finally:
        pyplot.close("all")


def _devices() -> list[jaxstab.Device]:
    """A device of each maker."""
    device, hand = jaxstab.Device, jaxstab.Hand
    mode = jaxstab.Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)
    arm = hand.mass_spring_damper(mass=1.0, stiffness=300.0)
    return [
        device.mass_spring_damper(0.25, damping=0.1),
        device.mass_spring_damper(0.25).with_actuator(200.0).held_by(arm),
        device.modes([mode], mass=0.25).held_by(arm.with_grip(stiffness=2000.0, damping=4.0)),
        device.transfer_function([1.0], [1.0, 100.0]).held_by(hand.mass_spring_damper()),
        device.state_space([[0, 1], [0, -0.4]], [[0], [4]], [[1, 0]]).held_by(
            hand.transfer_function([1.0, 5.0, 300.0], [1.0])
        ),
    ]


def _estimators() -> list[jaxstab.Velocity]:
    """An estimator of each maker, and chains."""
    velocity, low_pass = jaxstab.Velocity, jaxstab.Filter.low_pass(100.0)
    differentiator = velocity.transfer_function([500.0, -500.0], [1.0, 0.0])
    return [
        velocity(),
        velocity() * jaxstab.Filter.transfer_function([0.5, 0.5], [1.0, 0.0]),
        velocity.difference(20),
        velocity.difference(window=0.02) * low_pass * jaxstab.Filter.average(4),
        velocity.low_pass(30.0, order=2),
        velocity.butterworth(20.0, order=2) * jaxstab.Filter.exponential(0.9),
        velocity.exponential(0.1),
        differentiator,
        differentiator.per_sample(1e-3) * low_pass.per_sample(1e-3),
    ]


@pytest.mark.parametrize(
    "loop",
    [
        PLAIN,
        WINDOW,
        replace(PLAIN, hand_mass=1.0, hand_stiffness=300.0, position=jaxstab.Filter.average(3)),
        *(jaxstab.HapticLoop(sample_time=1e-3, device=device) for device in _devices()),
        *(replace(PLAIN, velocity=estimator) for estimator in _estimators()),
    ],
    ids=str,
)
def test_a_loop_prints_the_call_that_makes_it(loop: jaxstab.HapticLoop) -> None:
    names = {name: getattr(jaxstab, name) for name in ("HapticLoop", "Device", "Hand", "Mode")}
    names |= {"Velocity": jaxstab.Velocity, "Filter": jaxstab.Filter}
    assert eval(repr(loop), names) == loop
    assert "None" not in repr(loop)
    assert "sections" not in repr(loop)


def test_a_loop_that_jax_traces_prints_its_tracers() -> None:
    printed = []
    jax.jit(lambda loop: printed.append(repr(loop)))(PLAIN)
    assert "device_mass=" in printed[0]


def test_completion_of_a_loop_shows_questions() -> None:
    names = dir(WINDOW)
    assert {"verdict", "limits", "plot", "device_mass", "alpha"} <= set(names)
    assert not {"tree_flatten", "tree_unflatten", "in_floats", "sampled", "linear"} & set(names)


@pytest.mark.parametrize(("wall", "code"), [((1000.0, 10.0), "STABLE"), ((1e6, 10.0), "UNSTABLE")])
def test_the_code_of_one_wall_prints_its_name(wall: tuple[float, float], code: str) -> None:
    for loop in (PLAIN, WINDOW, jaxstab.HapticLoop(sample_time=1e-3, device=_devices()[2])):
        verdict = loop.verdict(*wall)
        expected = jaxstab.Verdict[code]
        assert repr(verdict) == repr(expected)
        assert str(verdict) == f"{verdict}" == code
        assert f"{verdict:d}" == str(int(verdict)) == str(int(expected))
        assert verdict == expected
        assert jaxstab.Verdict(verdict) is expected
        assert (verdict.name, verdict.value) == (code, int(expected))
        sent = pickle.loads(pickle.dumps(verdict))  # to another process, and back
        assert (sent.name, repr(sent), sent == verdict) == (code, repr(verdict), True)
        assert {expected: True}[verdict]
        assert verdict is expected
    radius = PLAIN.spectral_radius(*wall)
    proved = jaxstab.results.RadiusStatus.PROVED
    assert repr(radius.status) == repr(proved)
    assert (radius.status.name, radius.status.words) == ("PROVED", proved.words)
    many = PLAIN.verdict(np.array([wall[0]]), wall[1])
    assert repr(many) == f"array([{int(expected)}], dtype=int8)"


def test_settling_times_print_in_ms_and_samples() -> None:
    settled = WINDOW.settling_time(1000.0, 10.0)
    assert repr(settled) == f"Settling: {1e3 * settled.value:g} ms (settled)"
    samples = jaxstab.settling_samples(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)
    assert repr(samples) == f"Settling: {samples.value:g} samples (settled)"
    never = WINDOW.settling_time(1e6, 10.0)
    assert repr(never) == f"Settling: {jaxstab.results.SettlingStatus.UNSTABLE.words}"
    assert repr(never.status) == repr(jaxstab.results.SettlingStatus.UNSTABLE)
    many = WINDOW.settling_time([1000.0, 1500.0, 1e6], 10.0)
    low, high = 1e3 * np.array(many.value[:2])
    assert repr(many) == f"Settling of 3 loops: {low:g} to {high:g} ms (2 settled, 1 unstable)"


def test_amplitudes_print_with_units_rounded_up() -> None:
    found = WINDOW.amplitude(1000.0, 10.0, encoder=1e-5)
    shown = re.fullmatch(
        r"Amplitude: position (\S+) um, velocity (\S+) mm/s, force (\S+) N, "
        r"force per count (\S+) N \(proved\)",
        repr(found),
    )
    assert shown
    exact = [Fraction(float(found[k])) * (10**6, 1000, 1, 1)[k] for k in range(4)]
    for text, value in zip(shown.groups(), exact, strict=True):
        assert value * (1 - Fraction(1, 10**10)) <= Fraction(text) <= value * Fraction(1001, 1000)
    lost = WINDOW.amplitude(1e6, 10.0, encoder=1e-5)
    assert "not proved" in repr(lost)
    assert " um" not in repr(lost)
    device = jaxstab.HapticLoop(sample_time=1e-3, device=_devices()[2])
    assert " um" in repr(device.amplitude(10.0, 1.0, encoder=1e-5))
    plain = jaxstab.amplitude(0.1, 0.4, gamma=0.0, delta=0.001, delay=0.0, encoder=1.0)
    assert "um" not in repr(plain)


def test_a_response_prints_one_line() -> None:
    response = WINDOW.simulate([1000.0, 500.0], 10.0, samples=50, force=1.0)
    shown = repr(response)
    assert shown.startswith("Response of 2 loops at 50 times: 0 to 49 ms, position 0 to ")
    assert f"{1e3 * response.position.max():.4g} mm" in shown
    assert "\n" not in shown


def test_limits_print_as_a_region_does() -> None:
    limits, region = WINDOW.limits(), WINDOW.region()
    assert repr(limits).splitlines()[1:] == repr(region).splitlines()[1:]
    assert repr(limits).startswith("Limits: ")
    none = jaxstab.HapticLoop(
        device_mass=1.0, device_damping=0.0, hand_stiffness=np.pi**2, sample_time=1.0
    ).limits()
    assert "\n" not in repr(none)


def test_answers_print_themselves_as_a_person_would_write_them() -> None:
    loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    hands = jaxstab.HandRange(mass=(0.0, 1.0))
    row = repr(loop.stiffness_intervals(20.0)).splitlines()
    assert row[0] == "StableLine: all stable intervals of the line, proved"
    assert row[1].startswith("  0 to 35324.95892")
    assert " +/- " in row[1]
    assert repr(loop.stiffness_intervals(2000.0)).splitlines()[1] == "  none"
    best = loop.tune("radius")
    assert f"K = {best.stiffness!r} N/m at B = {best.damping!r} N s/m" in repr(best)
    assert repr(best).splitlines()[2] == f"  settling time    {best.settling_time:.6g} s"
    worst = repr(loop.worst_hand(hands, 1000.0, 10.0))
    assert worst.startswith("WorstHand: stable, proved for all hands\n  largest radius tried  0.")
    assert repr(loop.worst_hand(hands, 1e5, 10.0)).startswith("WorstHand: unstable with the hand")
    limit = loop.robust_limit(hands)
    assert f"K = {limit.stiffness!r} N/m" in repr(limit)
    assert "proved for all hands\n" in repr(limit)
    gains = repr(jaxstab.simulated_pd(0.1, step=1e-3).tune())
    assert gains.startswith("Tuned: kp = ")
    assert "\n  spectral radius  " in gains
    endless = repr(jaxstab.simulated_pd(0.1, step=1e-3, integrator="implicit").tune())
    assert endless.startswith("Tuned: kp = unlimited at kd = unlimited (there are no best gains")
    assert len(endless.splitlines()) == 1
