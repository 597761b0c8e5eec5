"""One-sided walls of every kind of loop: what a proof covers, limits, and what is refused."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import jaxstab
from jaxstab import Device, HapticLoop, Velocity
from jaxstab.results import OneSided
from tests.truth.one_sided import Body, Sampled, T

WINDOW = Velocity.difference(5)


def held(spring: float = 100.0, **others: Any) -> HapticLoop:
    given = {"delay": T, "velocity": WINDOW} | others
    return HapticLoop(
        device_mass=0.25, device_damping=0.1, hand_stiffness=spring, sample_time=T, **given
    )


TRUTH = Sampled.of(Body(0.25, 0.1, 100.0), 1.0, window=5)
CIRCLE = np.exp(1j * np.unique(np.r_[np.geomspace(1e-5, 0.1, 1000), np.linspace(0.1, np.pi, 3000)]))


def least(own: Sampled, wall: np.ndarray, taps: tuple[tuple[int, float], ...]) -> float:
    """The least Re M (1 + L) on the circle, L from the matrices of the truth."""
    size = len(own.matrix)
    loop = [wall @ np.linalg.solve(z * np.eye(size) - own.matrix, own.force) for z in CIRCLE]
    multiplier = 1.0 - sum(h * CIRCLE**-k for k, h in taps)
    return float(np.min((multiplier * (1.0 + np.array(loop))).real))


# ------------------------------------------------------------------------------------------ proofs
def test_a_ray_is_proved_by_its_end() -> None:
    limit = held().one_sided_limit(ratio=5e-3)
    assert limit
    assert limit.stiffness == pytest.approx(0.9999 * 10912.55484, rel=1e-9)
    assert limit.damping == pytest.approx(5e-3 * limit.stiffness)
    (taps,) = limit.multipliers
    assert least(TRUTH, TRUTH.read(limit.stiffness, limit.damping), taps) > 0.0
    for share in (0.01, 0.3, 0.9):
        assert held().one_sided(share * limit.stiffness, share * limit.damping)


def test_a_row_is_proved_from_end_to_end_by_a_fan() -> None:
    limit = held().one_sided_limit(damping=30.0)
    linear = held().intervals(damping=30.0).holding(0.0)
    assert linear is not None
    assert limit.stiffness == pytest.approx(0.9999 * linear.high.value, rel=1e-9)
    assert limit.damping == 30.0
    # The parts are halves of halves: each multiplier proves both of its ends.
    assert len(limit.multipliers) > 1
    ends = limit.stiffness * np.r_[0.0, 0.5 ** np.arange(len(limit.multipliers))[::-1]]
    for taps, pair in zip(limit.multipliers, pairwise(ends), strict=True):
        for stiffness in pair:
            assert least(TRUTH, TRUTH.read(stiffness, 30.0), taps) > 0.0


def test_a_spring_beside_a_damper_is_proved_in_rows() -> None:
    limit = held().one_sided_limit(form="spring", damping=30.0)
    (taps,) = limit.multipliers
    damped = TRUTH.damped(30.0)
    for share in (0.1, 0.5, 1.0):
        assert least(damped, damped.read(share * limit.stiffness, 0.0), taps) > 0.0
        assert held().one_sided(share * limit.stiffness, 30.0, form="spring")
    alone = [held().one_sided_limit(form=form, damping=0.0) for form in ("force", "spring")]
    assert alone[0].stiffness == alone[1].stiffness


def test_nothing_is_proved_beyond_the_linear_limit() -> None:
    loop = held()
    linear = loop.intervals(damping=30.0).holding(0.0)
    assert linear is not None
    for share in (1.0 + 1e-9, 1.01, 2.0):
        for form in ("force", "spring"):
            answer = loop.one_sided(share * linear.high.value, 30.0, form=form)
            assert not answer
            assert "not proved at stiffness" in repr(answer)
    none = loop.one_sided_limit(damping=1e6)
    assert not none
    assert np.isnan(none.stiffness)
    assert repr(none) == "OneSided: no stiffness above 0 was proved"


def test_the_softest_spring_will_do() -> None:
    shares = []
    for spring in (100.0, 1e-2, 1e-6):
        loop = held(spring)
        linear = loop._line((0.0, 0.0), (1.0, 5e-3)).holding(0.0)
        assert linear is not None
        shares.append(loop.one_sided_limit(ratio=5e-3).stiffness / linear.high.value)
    assert min(shares) > 0.995


def test_a_window_of_200_samples_is_proved_to_its_limit() -> None:
    loop = held(velocity=Velocity.difference(200))
    line = loop._line((0.0, 0.0), (1.0, 8e-3)).holding(0.0)
    assert line is not None
    assert loop.one_sided_limit(ratio=8e-3).stiffness > 0.5 * line.high.value


# ----------------------------------------------------------------------------------- kinds of loops
def bodies(*stiffnesses: float) -> list[Device]:
    return [
        Device.mass_spring_damper(mass=0.25 * (k + 1), damping=0.1, stiffness=stiffness)
        for k, stiffness in enumerate(stiffnesses)
    ]


def test_a_pid_without_integrator_is_a_wall() -> None:
    wall, pid = held().one_sided_limit(ratio=5e-3), jaxstab.pid(held(), ki=0.0)
    assert pid.one_sided_limit(ratio=5e-3).kp == pytest.approx(wall.stiffness, rel=1e-9)
    late = jaxstab.pid(held(), ki=0.0, kd_delay=0.0)
    assert late.one_sided(kp=2000.0, kd=20.0, form="spring")


@pytest.mark.parametrize(
    "loop",
    [
        jaxstab.two_rates(held(delay=0.0), 5, slow_delay=T),
        jaxstab.two_rates(held(delay=0.0), 4, ramp=True, velocity="fast"),
        jaxstab.coupling(*bodies(20.0, 50.0), sample_time=T, delays_samples=(1.0, 2.5)),
        jaxstab.Loop.from_coefficients(
            base=[1.0, -1.9, 0.905, 0.0],
            first=[1e-3, 0.0],
            second=[1.0, -1.0],
            sample_time=T,
            gains=("stiffness", "damping"),
        ),
    ],
    ids=["two rates", "ramp", "coupling", "coefficients"],
)
def test_other_kinds_are_proved_up_to_their_linear_limit(loop: jaxstab.Loop) -> None:
    line = loop._line((0.0, 0.0), (1.0, 12e-3)).holding(0.0)
    assert line is not None
    limit = loop.one_sided_limit(ratio=12e-3)
    assert 0.99 < limit.stiffness / line.high.value < 1.0
    assert loop.verdict(stiffness=limit.stiffness, damping=limit.damping)
    assert not loop.one_sided(stiffness=1.001 * line.high.value, damping=12e-3 * line.high.value)


@pytest.mark.parametrize(
    ("ask", "error", "words"),
    [
        (lambda: held(0.0).one_sided(1.0, 1.0), ValueError, "give the hand a stiffness"),
        (lambda: held(0.0).one_sided_limit(damping=1.0), ValueError, "such as 1e-6 N/m"),
        (
            lambda: jaxstab.pid(held(), kd=10.0).one_sided(kp=1.0, ki=1.0),
            ValueError,
            "an integrator goes on",
        ),
        (
            lambda: jaxstab.pid(held(), ki=0.0, kd_delay=0.0).one_sided(kp=1.0, kd=1.0),
            ValueError,
            'delays of their own, .* give form="spring"',
        ),
        (
            lambda: jaxstab.admittance(1e4, sample_time=T, delay_samples=4).one_sided(
                mass=2.0, damping=50.0
            ),
            ValueError,
            "move the leading coefficient",
        ),
        (lambda: held().one_sided(1.0, 1.0, form="wall"), ValueError, 'one of "force", "spring"'),
        (lambda: held().one_sided(np.nan, 1.0), ValueError, "stiffness is nan"),
        (lambda: held().one_sided(1.0), TypeError, "give both stiffness and damping"),
        (lambda: held().one_sided_limit(), TypeError, "given: none; give damping, or its ratio to"),
        (lambda: held().one_sided_limit(stiffness=1.0), TypeError, "given: stiffness"),
        (lambda: held().one_sided_limit(ratio=1.0, damping=1.0), TypeError, "damping, ratio"),
        (lambda: held().one_sided_limit(ratio=np.inf), ValueError, "ratio is inf"),
        (lambda: held().one_sided_limit(ratio=1.0, form="spring"), ValueError, "not a share of"),
        (
            lambda: HapticLoop(
                device_mass=[0.1, 0.2], hand_stiffness=1.0, device_damping=0.1, sample_time=T
            ).one_sided(1.0, 1.0),
            TypeError,
            "one loop is needed",
        ),
    ],
)
def test_what_has_no_answer_is_refused_in_one_sentence(
    ask: Callable[[], OneSided], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        ask()


def test_an_answer_has_the_names_of_its_gains() -> None:
    answer = held().one_sided(2000.0, 20.0)
    assert (answer.stiffness, answer.damping) == (2000.0, 20.0)
    assert repr(answer).endswith("damping = 20 N s/m, and all shares of both")
    with pytest.raises(AttributeError, match="its gains give stiffness, damping"):
        _ = answer.kp
