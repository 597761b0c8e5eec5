"""Usable gains, against roots of loops that are turned, closed forms and python-control."""

import warnings
from collections.abc import Iterator
from math import cos, radians, sin
from typing import Any, NamedTuple

import numpy as np
import pytest
from campaign import many
from mpmath import mp

import jaxstab
from jaxstab import HapticLoop, Loop, Velocity
from tests.truth.affine_kinds import KINDS, Case, polynomial_exactly

OMEGA = {"device_mass": 0.25, "device_damping": 0.1, "sample_time": 1e-3, "delay": 1e-3}
WINDOW = HapticLoop(**OMEGA, velocity=Velocity.difference(window=0.02))
CAMPAIGN = pytest.mark.campaign
ROW = [kind for kind in KINDS if kind != "admittance"]


# -------------------------------------------------------------------------------- perturbed roots
class Perturbed(NamedTuple):
    """A row of a random loop by its recursion: D, W0 and W1, the highest power first."""

    case: Case
    names: tuple[str, str]
    given: float
    below: np.ndarray
    start: np.ndarray
    along: np.ndarray

    @classmethod
    def drawn(cls, kind: str, rng: np.random.Generator) -> "Perturbed":
        while True:
            case = KINDS[kind](rng)
            if case.loop._only_few:  # p(z) has no leading coefficient of its own
                continue
            axis = int(rng.integers(2))
            names = case.gains[axis], case.gains[1 - axis]
            given = float(case.scale[1 - axis] * 10 ** rng.uniform(-2.0, 0.0))
            if not case.intervals(**{names[1]: given}).intervals:
                continue
            opened = {"is_open": True} if kind in ("kp-ki", "kp-kd", "ki-kd") else {}
            pairs = [(0.0, given), (case.scale[axis], given)]
            ordered = [pair if axis == 0 else pair[::-1] for pair in pairs]
            with mp.workdps(120):
                below = polynomial_exactly(case.matrix(0.0, 0.0, exact=True, **opened))
                at = [polynomial_exactly(case.matrix(*pair, exact=True)) for pair in ordered]
                sides = [
                    below,
                    [x - d for x, d in zip(at[0], below, strict=True)],
                    [(y - x) / case.scale[axis] for x, y in zip(*at, strict=True)],
                ]
                floats = [np.array([float(c) for c in side]) for side in sides]
            return cls(case, names, given, floats[0], floats[1], floats[2])

    def largest_radius(self, t: float, factors: np.ndarray) -> float:
        """Of D + w (W0 + t W1) over factors w."""
        above = self.start + t * self.along
        return max(float(np.abs(np.roots(self.below + w * above)).max()) for w in factors)


def wishes(rng: np.random.Generator) -> tuple[dict[str, Any], np.ndarray]:
    """Margins, and factors of the open loop that they allow, all of the outermost among them."""
    phase, gain, peak = rng.uniform([10.0, 1.2, 1.4], [60.0, 3.0, 3.0]).tolist()
    arc = np.exp(1j * np.linspace(0.0, radians(phase), 41))  # the others are mirror images
    disk = (peak + np.exp(1j * np.linspace(0.0, np.pi, 61))) * peak / (peak**2 - 1.0)
    both = np.geomspace(1.0 / gain, gain, 41)
    chosen: list[tuple[dict[str, Any], list[np.ndarray]]] = [
        ({"phase_margin": phase}, [arc]),
        ({"gain_margin": gain}, [both[20:]]),
        ({"gain_margin": (1.0 / gain, gain)}, [both]),
        ({"sensitivity": peak}, [disk]),
        ({"phase_margin": phase, "gain_margin": gain, "sensitivity": peak}, [arc, both[20:], disk]),
    ]
    wanted, factors = chosen[int(rng.integers(len(chosen)))]
    return wanted, np.concatenate(factors)


def wrong(kind: str, seed: int, points: int) -> Iterator[str]:
    """What perturbed roots deny of the usable intervals of one row."""
    rng = np.random.default_rng([86, list(KINDS).index(kind), seed])
    row = Perturbed.drawn(kind, rng)
    wanted, factors = wishes(rng)
    own, other = row.names
    stable = row.case.loop.intervals(**{other: row.given})
    usable = row.case.loop.intervals(**{other: row.given}, **wanted)
    for interval in stable.intervals:
        low, high = (end.value for end in interval)
        inside = [
            (low_.value + low_.error, high_.value - high_.error)
            for low_, high_ in usable.intervals
            if low <= low_.value and high_.value <= high
        ]
        tried = low + (high - low) * rng.uniform(0.0, 1.0, points)
        tried = np.r_[tried, [end for pair in inside for end in pair]]
        for t in tried.tolist():
            largest = row.largest_radius(t, factors)
            is_inside = any(low_ <= t <= high_ for low_, high_ in inside)
            if is_inside and largest > 1.0 + 1e-7:
                yield f"{kind} {seed} {wanted}: {own} = {t!r} has a radius of {largest!r}"
            if not is_inside and largest < 1.0 - 1e-3:
                yield f"{kind} {seed} {wanted}: {own} = {t!r} is usable, {largest!r}"


@pytest.mark.parametrize("kind", ROW)
def test_usable_intervals_are_those_of_perturbed_roots(kind: str) -> None:
    assert list(wrong(kind, seed=1, points=12)) == []


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ROW)
def test_no_usable_interval_of_random_loops_is_wrong(kind: str) -> None:
    for seed in range(many(60, small=4)):
        assert list(wrong(kind, 100 + seed, points=40)) == []


def test_perturbed_roots_deny_ends_that_are_moved_outwards() -> None:
    denied = 0
    for seed in range(5):
        rng = np.random.default_rng([87, seed])
        row = Perturbed.drawn("kp-kd", rng)
        wanted, factors = wishes(rng)
        usable = row.case.loop.intervals(**{row.names[1]: row.given}, **wanted)
        for low, high in usable.intervals:
            beyond = high.value + 0.01 * (high.value - low.value)
            denied += row.largest_radius(beyond, factors) > 1.0
            assert row.largest_radius(high.value - high.error, factors) < 1.0 + 1e-7
    assert denied >= 2


# ------------------------------------------------------------------------------------ closed forms
def late(samples: int) -> Loop:
    """L = a z^-n + b z^(1-n)."""
    base = [1.0, *[0.0] * samples]
    return Loop.from_coefficients(base=base, first=[1], second=[1, 0], sample_time=1.0)


def test_margins_of_a_pure_delay_are_its_size() -> None:
    # |L| = |a| at all phases: |S| is 1/(1 - |a|) at most, and the phase margin infinite to |a| = 1.
    for wanted, end in (
        ({"sensitivity": 2.0}, 0.5),
        ({"gain_margin": 4.0}, 0.25),
        ({"phase_margin": 90.0}, 1.0),
        ({"phase_margin": 90.0, "gain_margin": (0.5, 1.25), "sensitivity": 4.0}, 0.75),
    ):
        [(low, high)] = late(3).intervals(b=0.0, **wanted).intervals  # type: ignore[arg-type]
        assert -low.value == pytest.approx(end, rel=1e-9), wanted
        assert high.value == pytest.approx(end, rel=1e-9), wanted


@pytest.mark.parametrize("damping", [0.01, 0.1])
def test_a_free_mass_has_a_cusp_at_small_gains(damping: float) -> None:
    # Slow motions of m x'' = -K x - B x': PM >= phi is K <= B^2 cos(phi)/(m sin(phi)^2).
    loop = HapticLoop(**OMEGA | {"device_damping": 0.0}, velocity=WINDOW.velocity)
    [(low, high)] = loop.intervals(damping=damping, phase_margin=30.0).intervals
    angle = radians(30.0)
    assert low.told == 0.0
    assert high.value == pytest.approx(damping**2 * cos(angle) / (0.25 * sin(angle) ** 2), rel=0.01)


# -------------------------------------------------------------------------------- worked examples
def control_margins(loop: Any, *wall: float, **gains: float) -> tuple[float, float, float]:
    """Gain margin, phase margin in degrees and peak of |S| by python-control."""
    import control

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gain, phase, distance, *_ = control.stability_margins(loop.to_control(*wall, **gains))
    return gain, phase, 1.0 / distance


@pytest.mark.parametrize(
    ("wanted", "stiffness", "damping", "which", "value"),
    [
        ({"phase_margin": 30}, 399.8880630, 12.968603, 1, 30.0),
        pytest.param({"sensitivity": 2}, 317.6960163, 9.619415, 2, 2.0, marks=CAMPAIGN),
        pytest.param({"gain_margin": 2}, 1017.294741, 6.409452, 0, 2.0, marks=CAMPAIGN),
        pytest.param({"phase_margin": 20}, 693.9376440, 14.013524, 1, 20.0, marks=CAMPAIGN),
        pytest.param({"phase_margin": 45}, 155.4779720, 10.510541, 1, 45.0, marks=CAMPAIGN),
        pytest.param({"sensitivity": 1.5}, 128.3274633, 6.753815, 2, 1.5, marks=CAMPAIGN),
    ],
)
def test_the_largest_stiffness_has_just_the_margin(
    wanted: dict[str, float], stiffness: float, damping: float, which: int, value: float
) -> None:
    pytest.importorskip("control")
    limits = WINDOW.limits(**wanted)
    assert limits.stiffness == pytest.approx(stiffness, rel=3e-8)  # 1e-8 inside of the end
    assert limits.at_damping == pytest.approx(damping, rel=1e-4)
    pair = float(limits.stiffness), float(limits.at_damping)
    measured = control_margins(WINDOW, *pair)[which]
    assert measured == pytest.approx(value, rel=1e-3)
    text = repr(limits).splitlines()[1]
    printed = [float(word) for word in text.split() if word[0].isdigit()]
    assert WINDOW.is_usable(printed[0], printed[1], **wanted)
    assert WINDOW.is_usable(printed[0] * 1.0001, printed[1], **wanted) is False


def test_rows_end_where_the_margin_is_missed() -> None:
    for wanted, end in (
        ({"phase_margin": 30}, 397.0513321),
        ({"sensitivity": 2}, 288.6257022),
        ({"gain_margin": 2}, 841.7855980),
    ):
        [(low, high)] = WINDOW.intervals(damping=12.0, **wanted).intervals  # type: ignore[arg-type]
        assert low.told == 0.0
        assert high.value == pytest.approx(end, abs=1e-7)
        assert WINDOW.is_usable(high.value - high.error, 12.0, **wanted)  # type: ignore[arg-type]
        assert WINDOW.is_usable(high.value + high.error, 12.0, **wanted) is False  # type: ignore[arg-type]
    assert not WINDOW.intervals(damping=12.0, sensitivity=1.5).intervals
    text = repr(WINDOW.intervals(damping=12.0, sensitivity=2))
    assert "that there are no others is searched" in text


def test_a_delay_margin_is_that_of_the_device_between_samples() -> None:
    assert WINDOW.is_usable(650.62, 12.0, delay_margin=5e-3)
    assert WINDOW.is_usable(650.63, 12.0, delay_margin=5e-3) is False
    found = WINDOW.limits(delay_margin=5e-3)
    pair = float(found.stiffness), float(found.at_damping)
    later = HapticLoop(**OMEGA | {"delay": 6e-3}, velocity=WINDOW.velocity)
    assert later.verdict(*pair)
    assert not later.verdict(pair[0] * 1.001, pair[1])


@pytest.mark.campaign
def test_every_kind_of_loop_has_limits_with_margins() -> None:
    joint = jaxstab.simulated_pd(0.1, step=2e-3, substeps=4)
    assert joint.limits(sensitivity=1.5).kp == pytest.approx(383.0992350, rel=1e-8)
    both = joint.limits(phase_margin=45, gain_margin=2)
    assert both.kp == pytest.approx(467.9833453, rel=1e-8)
    pid = jaxstab.pid(HapticLoop(**OMEGA), kd=50.0)
    most = pid.limits(phase_margin=30, gain_margin=(1 / 1.5, 1.5))
    assert most.ki == pytest.approx(577599.8362, rel=1e-6)
    light, heavy = (
        jaxstab.Device.mass_spring_damper(mass, damping=damping)
        for mass, damping in ((0.25, 0.1), (0.5, 0.2))
    )
    coupling = jaxstab.coupling(light, heavy, sample_time=1e-3, delays_samples=(1.0, 2.0))
    assert coupling.limits(phase_margin=30).stiffness == pytest.approx(5264.474889, rel=1e-8)


# ----------------------------------------------------------------------------------------- refusals
def settles_sooner(loop: HapticLoop, wanted: dict[str, Any], seconds: float) -> list[Any]:
    """Walls of a grid that have the margins and settle more than a sample sooner than that."""
    most = loop.limits(**wanted)
    shares = np.linspace(0.0, 1.0, 21)[1:]
    gains = np.meshgrid(most.first * shares, most.second * shares)
    times = loop.settling_time(*gains).value
    sooner = np.argwhere(times < seconds - loop.sample_time)
    walls = [tuple(float(gain[tuple(place)]) for gain in gains) for place in sooner]
    return [wall for wall in walls if loop.is_usable(*wall, **wanted)]


def test_the_fastest_usable_wall_has_the_margins_and_no_wall_of_a_grid_settles_sooner() -> None:
    best = HapticLoop(**OMEGA).tune(phase_margin=45)
    assert HapticLoop(**OMEGA).is_usable(best.stiffness, best.damping, phase_margin=45)
    assert settles_sooner(HapticLoop(**OMEGA), {"phase_margin": 45}, best.settling_time) == []
    free = HapticLoop(**OMEGA).tune()
    assert HapticLoop(**OMEGA).tune(phase_margin=28) == free  # it has 28.996
    lacking = WINDOW.tune(stiffness=100.0, phase_margin=60)
    assert lacking.status.name == "NOT_USABLE"
    assert np.isnan(lacking.stiffness)


@pytest.mark.campaign
def test_no_usable_wall_of_random_loops_settles_sooner_than_the_tuned_one(
    rng: np.random.Generator,
) -> None:
    best = HapticLoop(**OMEGA).tune(delay_margin=5e-3)
    assert HapticLoop(**OMEGA).is_usable(best.stiffness, best.damping, delay_margin=5e-3)
    assert settles_sooner(HapticLoop(**OMEGA), {"delay_margin": 5e-3}, best.settling_time) == []
    estimators = Velocity(), Velocity.difference(samples=5), Velocity.low_pass(60.0)
    for _ in range(many(200, small=8)):
        period = float(rng.choice([5e-4, 1e-3, 2e-3]))
        loop = HapticLoop(
            device_mass=float(10.0 ** rng.uniform(-1.3, 0.5)),
            device_damping=float(10.0 ** rng.uniform(-2.0, 1.0)),
            hand_stiffness=float(rng.choice([0.0, 300.0])),
            sample_time=period,
            delay=float(rng.choice([0.0, 1.0, 1.5])) * period,
            velocity=estimators[rng.integers(3)],
        )
        wanted, _ = wishes(rng)
        best = loop.tune(**wanted)
        if best.status.name == "NOT_USABLE":
            continue
        assert loop.is_usable(best.stiffness, best.damping, **wanted)
        assert settles_sooner(loop, wanted, best.settling_time) == []


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ({"phase_margin": 0.0}, "phase_margin is 0.0"),
        ({"phase_margin": 200.0}, "phase_margin is 200.0"),
        ({"gain_margin": 1.0}, "give a factor above 1"),
        ({"gain_margin": (0.0, 2.0)}, "the least and the largest factor"),
        ({"sensitivity": 1.0}, "sensitivity is 1.0"),
        ({"delay_margin": -1.0}, "delay_margin is -1.0"),
        ({}, "no margin is given"),
    ],
)
def test_margins_that_make_no_sense_are_refused(wanted: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        WINDOW.is_usable(100.0, 5.0, **wanted)


def test_what_is_not_available_says_so() -> None:
    robot = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4)
    assert robot.is_usable(mass=2.0, damping=100.0, phase_margin=10) is not None
    with pytest.raises(ValueError, match="mass and damping move the leading coefficient"):
        robot.limits(phase_margin=30)
    with pytest.raises(ValueError, match="not proved for whole intervals"):
        WINDOW.intervals(damping=5.0, delay_margin=1e-3)
    with pytest.raises(TypeError, match="limits takes no phase; give phase_margin"):
        WINDOW.limits(phase=30)
    with pytest.raises(ValueError, match="beside delays that move"):
        WINDOW.limits(delays=(0.0, 1e-3), phase_margin=30)
    joint = jaxstab.simulated_pd(0.1, step=2e-3)  # a free mass: a lag of 90 degrees and more
    assert "no gains with a phase margin of 120 degrees" in repr(joint.limits(phase_margin=120))
