"""J1: thresholds beside constant delays, a known counter-sequence, and the inequality itself."""

import numpy as np
import pytest

from jaxstab import HapticLoop, Velocity
from jaxstab.exact.line import stable_line
from jaxstab.exact.margins import SmallGainStatus, largest_jitter, small_gain
from jaxstab.model.balls import ball_loop, ball_triple
from jaxstab.model.device.sampling import late_cosines

PERIOD = 1e-3
LIGHT = {"device_mass": 0.1, "device_damping": 0.05}
OMEGA = {"device_mass": 0.25, "device_damping": 0.1}


def loop_at(delay: float, samples: int, fields: dict[str, float]) -> HapticLoop:
    return HapticLoop(
        **fields, sample_time=PERIOD, delay=delay * PERIOD,
        velocity=Velocity.difference(samples=samples),
    )  # fmt: skip


def status(loop: HapticLoop, jitter: float, wall: tuple[float, float]) -> SmallGainStatus:
    shortest = loop.delay_samples

    def late() -> list[object]:
        return late_cosines(loop.held_device, PERIOD, shortest, jitter)

    return small_gain(lambda: ball_loop(loop), late, *wall)


@pytest.mark.parametrize(
    ("fields", "delays", "samples", "damping", "proved"),
    [  # tried in float64 with a sum over 121 aliases, design of the project
        (OMEGA, (1.0, 2.0), 20, 5.0, 1132.0),
        (OMEGA, (1.0, 2.0), 20, 12.8, 1458.0),
        (OMEGA, (1.0, 2.0), 20, 25.0, 1024.0),
        (LIGHT, (0.0, 1.0), 1, 40.0, 13796.0),
        (LIGHT, (0.0, 1.0), 1, 60.0, 4324.0),
    ],
)
def test_the_largest_proved_stiffness(
    fields: dict[str, float],
    delays: tuple[float, float],
    samples: int,
    damping: float,
    proved: float,
) -> None:
    loop, jitter = loop_at(delays[0], samples, fields), delays[1] - delays[0]
    assert status(loop, jitter, (0.998 * proved, damping)) == SmallGainStatus.PROVED
    assert status(loop, jitter, (1.003 * proved, damping)) == SmallGainStatus.NOT_PROVED


@pytest.mark.parametrize("damping", [5.0, 12.8, 25.0])
def test_no_wall_is_proved_that_a_constant_delay_of_the_range_makes_unstable(
    damping: float,
) -> None:
    shortest, jitter = loop_at(0.8, 20, OMEGA), 0.4
    longest = loop_at(1.2, 20, OMEGA)
    line = stable_line(lambda: ball_triple(longest), (0.0, damping), (1.0, 0.0))
    limit = line.intervals[0].high.value
    for share in (1.0 + 1e-9, 1.01, 1.1):
        assert status(shortest, jitter, (limit * share, damping)) != SmallGainStatus.PROVED


def test_a_wall_with_a_growing_sequence_is_not_proved() -> None:
    # Delays of 1, 1, 1, 0 ms in turn make it grow; it is stable at each constant delay.
    wall = (6669.1, 71.60)
    assert status(loop_at(0.0, 1, LIGHT), 1.0, wall) == SmallGainStatus.NOT_PROVED


def test_an_unstable_wall_is_called_so() -> None:
    assert status(loop_at(0.0, 1, LIGHT), 1.0, (1e6, 10.0)) == SmallGainStatus.UNSTABLE
    assert status(loop_at(0.0, 1, LIGHT), 1.0, (0.0, 10.0)) == SmallGainStatus.UNSTABLE


@pytest.mark.parametrize("jitter", [0.3, 1.0, 1.7])
def test_the_inequality_is_that_of_the_sampled_functions(jitter: float) -> None:
    """Formed in NumPy at many angles: where it fails clearly the wall is not proved."""
    loop = loop_at(1.0, 4, OMEGA)
    z = np.exp(1j * np.linspace(1e-4, np.pi, 20001))
    m, b, period = 0.25, 0.1, PERIOD
    decay = np.exp(-b / m * period)
    slow = (1.0 - decay) * m / b  # the velocity after a unit of velocity, integrated
    n1 = (period - slow) / b
    n0 = (slow - period * decay) / b
    plant = (n1 * z + n0) / ((z - 1.0) * (z - decay) * z)
    q = np.array([float(c.mid()) for c in late_cosines(loop.held_device, period, 1.0, jitter)])
    theta = np.angle(z)
    late = q[0] + 2.0 * sum(c * np.cos(k * theta) for k, c in enumerate(q) if k)
    for stiffness in (500.0, 2000.0, 4000.0, 5000.0):
        wall = stiffness + 20.0 * (1.0 - z**-4.0) / (4.0 * period)
        device = (z - 1.0) * (z - decay)
        gain = late * abs((1.0 - 1.0 / z) * wall) ** 2
        share = np.max(gain / abs(device * (1.0 + plant * wall)) ** 2)
        found = status(loop, jitter, (stiffness, 20.0))
        if found != SmallGainStatus.UNSTABLE:
            assert (found == SmallGainStatus.PROVED) == (share < 1.0), (stiffness, share)


@pytest.mark.parametrize(
    ("wall", "least", "most"), [((5000.0, 60.0), 0.1, 1.0), ((1000.0, 30.0), 2.0, 4.0)]
)
def test_the_largest_jitter_is_proved_and_a_little_more_is_not(
    wall: tuple[float, float], least: float, most: float
) -> None:
    loop = loop_at(0.0, 1, LIGHT)

    def late(jitter: float) -> list[object]:
        return late_cosines(loop.held_device, PERIOD, 0.0, jitter)

    jitter = largest_jitter(lambda: ball_loop(loop), late, wall, 9.0)
    assert least < jitter < most
    assert status(loop, jitter, wall) == SmallGainStatus.PROVED
    assert status(loop, jitter * (1.0 + 1e-5), wall) == SmallGainStatus.NOT_PROVED
