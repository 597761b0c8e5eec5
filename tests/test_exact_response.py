"""E4 against closed forms, and recursions that are run for long."""

import flint
import numpy as np
import pytest

from jaxstab import Device, Filter, Hand, HapticLoop, Velocity
from jaxstab.exact.response import (
    Bounds,
    ResponseStatus,
    TransferAt,
    l1_norm,
    peak,
    settling_sample,
)
from jaxstab.model.balls import Factored, ball_triple


def ratio(above: list[float], below: list[float]) -> TransferAt:
    """Coefficients, lowest first."""
    return lambda: (Factored(flint.arb_poly(above)), Factored(flint.arb_poly(below)))


def encoder(loop: HapticLoop, stiffness: float, damping: float) -> TransferAt:
    """From an error of the encoder to the position, but for its sign."""

    def transfer() -> tuple[Factored, Factored]:
        parts = ball_triple(loop)
        wall = parts.stiffness.scaled(stiffness).plus(parts.damping.scaled(damping))
        return wall, parts.at(stiffness, damping)

    return transfer


def simulated(transfer: TransferAt, count: int) -> np.ndarray:
    """h_k by the difference equation in float64."""
    with flint.ctx.workprec(200):
        above, below = (part.polynomial().coeffs()[::-1] for part in transfer())
    b = np.array([float(c.mid()) for c in above]) / float(below[0].mid())
    a = np.array([float(c.mid()) for c in below]) / float(below[0].mid())
    h = np.zeros(count)
    for k in range(count):
        recent = h[max(0, k - len(a) + 1) : k][::-1]
        h[k] = (b[k] if k < len(b) else 0.0) - a[1 : len(recent) + 1] @ recent
    return h


@pytest.mark.parametrize("pole", [0.5, -0.75, 0.9990234375])
def test_one_pole(pole: float) -> None:
    transfer = ratio([1.0], [-pole, 1.0])
    norm, highest = l1_norm(transfer), peak(transfer)
    assert norm.low <= 1.0 / (1.0 - abs(pole)) <= norm.high <= norm.low * (1.0 + 1e-8)
    assert highest.low <= 1.0 <= highest.high <= highest.low * (1.0 + 1e-12)
    expected = int(np.floor(np.log(1e-3) / np.log(abs(pole)))) + 1
    assert settling_sample(transfer, 1e-3).sample == expected


def test_two_poles_with_signs_that_change() -> None:
    # 1/((z - 1/2)(z + 1/2)) = 1/z^2 + 1/4/z^4 + ...
    norm = l1_norm(ratio([1.0], [-0.25, 0.0, 1.0]))
    assert norm.low <= 4.0 / 3.0 <= norm.high <= norm.low * (1.0 + 1e-8)


def test_a_direct_term_and_roots_at_zero_count() -> None:
    # (z^2 + 1)/(z (z - 1/2)) = 1 + 1/2/z + 5/4/z^2 + 5/8/z^3 ...
    transfer = ratio([1.0, 0.0, 1.0], [0.0, -0.5, 1.0])
    shifted = Factored(flint.arb_poly([-0.5, 1.0]), power=1)
    for norm in (l1_norm(lambda: (transfer()[0], shifted)),):
        assert norm.low <= 1.0 + 0.5 + 2.5 <= norm.high <= norm.low * (1.0 + 1e-8)


LOOPS = [
    (HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3), 1000.0, 20.0),
    (
        HapticLoop(
            device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1.5e-3,
            velocity=Velocity.difference(samples=20), position=Filter.butterworth(300.0, order=2),
        ),
        800.0,
        10.0,
    ),
    (  # quotients of series lose digits with every sample: 192 bits do not do
        HapticLoop(
            device=Device.mass_spring_damper(0.25, damping=0.1).with_actuator(200.0).held_by(
                Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
                .with_grip(stiffness=2000.0, damping=4.0)
            ),
            sample_time=1e-3, delay=0.5e-3, velocity=Velocity.difference(samples=4),
        ),
        1000.0,
        10.0,
    ),
]  # fmt: skip


@pytest.mark.parametrize(("loop", "stiffness", "damping"), LOOPS)
def test_loops_are_as_their_recursions(loop: HapticLoop, stiffness: float, damping: float) -> None:
    transfer = encoder(loop, stiffness, damping)
    h = simulated(transfer, 20000)
    norm, highest, settled = l1_norm(transfer), peak(transfer), settling_sample(transfer, 1e-5)
    assert norm.low * (1 - 1e-9) <= np.sum(abs(h)) <= norm.high * (1 + 1e-9)
    assert norm.high <= norm.low * (1.0 + 1e-8)
    assert highest.low <= np.max(abs(h)) * (1 + 1e-9)
    assert highest.high >= np.max(abs(h)) * (1 - 1e-9)
    first = int(np.flatnonzero(abs(h))[0])
    assert settled.sample == np.flatnonzero(abs(h) > 1e-5)[-1] + 1 - first
    old = loop.amplitude(stiffness, damping, encoder=2.0).position
    assert norm.low <= old <= norm.high * 1.1  # at all times, not at samples alone


def test_a_disturbance_of_signs_comes_close_to_the_norm() -> None:
    loop, stiffness, damping = LOOPS[0]
    transfer = encoder(loop, stiffness, damping)
    h = simulated(transfer, 2000)
    reached = np.convolve(np.sign(h[::-1]), h)[: len(h)][-1]
    norm = l1_norm(transfer)
    assert 0.999 * norm.low < reached <= norm.high


def test_unstable_loops_and_poles_that_coincide_are_not_proved() -> None:
    unstable = l1_norm(ratio([1.0], [-2.0, 1.0]))
    assert unstable == Bounds(0.0, np.inf, ResponseStatus.UNSTABLE)
    double = l1_norm(ratio([1.0], [0.25, -1.0, 1.0]))
    assert double.status == ResponseStatus.NOT_PROVED
    assert settling_sample(ratio([1.0], [0.25, -1.0, 1.0]), 0.1).sample == np.inf
    free = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
    assert peak(encoder(free, 0.0, 10.0)).status == ResponseStatus.UNSTABLE
