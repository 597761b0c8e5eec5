"""Settling and the dominant oscillation, against fine discretisations, closed forms and roots."""

import math

import jax
import numpy as np
import pytest
from mpmath import mp
from scipy.linalg import expm

import jaxstab
from jaxstab import HapticLoop, Velocity
from jaxstab.model import by_name
from jaxstab.motion import response
from jaxstab.results import SettlingStatus
from tests.truth import loop as truth
from tests.truth.march import (
    FINE,
    HELD,
    OSCILLATING,
    PHANTOM,
    butterworth_taps,
    difference_taps,
    march_on_a_fine_grid,
    march_through_filters,
)

LONG = 4000  # samples, enough for every loop below to come to rest


def settled_since(position: np.ndarray, final: float, band: float) -> int:
    outside = np.flatnonzero(np.abs(position - final) > band)
    return int(outside[-1]) + 1 if outside.size else 0


class TestSettling:
    @pytest.mark.parametrize(
        ("loop", "stiffness", "damping"),
        [(PHANTOM, 20_000.0, 20.0), (HELD, 2_000.0, 30.0), (OSCILLATING, 0.05, -0.24)],
    )
    @pytest.mark.parametrize("level", [0.02, 0.05])
    def test_of_a_push_and_of_an_impact_are_those_of_the_fine_discretisation(
        self, loop: HapticLoop, stiffness: float, damping: float, level: float
    ) -> None:
        push = stiffness + loop.hand_stiffness
        arguments = (loop, stiffness, damping, LONG)
        pushed, _ = march_on_a_fine_grid(*arguments, push, np.zeros(2))
        hit, _ = march_on_a_fine_grid(*arguments, 0.0, np.array([0.0, 1.0]))
        pushed, hit = pushed[::FINE, 0], hit[::FINE, 0]
        assert abs(pushed[-1] - 1.0) < 1e-6
        assert abs(hit[-1]) < 1e-6 * np.abs(hit).max()
        expected = {
            "force": settled_since(pushed, 1.0, level),
            "impact": settled_since(hit, 0.0, level * np.abs(hit).max()),
        }
        for excitation, samples in expected.items():
            found = loop.settling_time(stiffness, damping, level=level, excitation=excitation)
            assert int(found.status) == SettlingStatus.SETTLED
            assert float(found.value) == pytest.approx(samples * loop.sample_time, rel=1e-14)

    def test_without_a_wall_is_that_of_the_free_oscillator(self) -> None:
        gamma, delta, delay = 0.09, 0.06, 2.6
        time = np.arange(1000)
        frequency = math.sqrt(gamma - delta**2 / 4)
        phase = frequency * time
        deviation = np.exp(-delta / 2 * time) * (
            np.cos(phase) + delta / 2 / frequency * np.sin(phase)
        )
        found = jaxstab.settling_samples(0.0, 0.0, gamma=gamma, delta=delta, delay=delay)
        assert float(found.value) == settled_since(deviation, 0.0, 0.02)

    def test_of_a_grid_of_delays_are_those_of_each_loop(self) -> None:
        delays = np.array([0.0, 0.4, 2.5])
        betas = np.array([[0.08], [0.1]])
        together = jaxstab.settling_samples(0.004, betas, gamma=1e-3, delta=0.015, delay=delays)
        assert together.value.shape == (2, 3)
        assert (together.status == SettlingStatus.SETTLED).all()
        for column, delay in enumerate(delays):
            alone = HapticLoop(
                device_mass=1.0,
                device_damping=0.015,
                hand_stiffness=1e-3,
                sample_time=1.0,
                delay=delay,
            )
            response = alone.simulate(0.004, betas[:, 0], samples=800, force=0.005)
            for row, position in enumerate(np.asarray(response.position)):
                assert float(together.value[row, column]) == settled_since(position, 1.0, 0.02)

    def test_many_loops_at_once_are_those_of_a_recurrence(self) -> None:
        """gamma = delta = 0, delay 1, on a grid: all in plain NumPy."""
        alpha, beta = np.linspace(0.002, 0.14, 16)[:, None], np.linspace(0.02, 0.55, 16)
        found = jaxstab.settling_samples(alpha, beta, gamma=0.0, delta=0.0, delay=1.0)
        stable = (
            np.asarray(jaxstab.verdict(alpha, beta, gamma=0.0, delta=0.0, delay=1.0))
            == jaxstab.Verdict.STABLE
        )
        alpha, beta = np.broadcast_arrays(alpha, beta)
        alpha, beta = alpha[stable], beta[stable]
        x, v, previous, waiting, last = -np.ones((5, alpha.size))
        v, waiting, last = np.zeros_like(v), alpha, np.zeros_like(last)
        for sample in range(20_000):
            last = np.where(np.abs(x) > 0.02, sample + 1, last)
            force, waiting = waiting, -(alpha * x + beta * (x - previous))
            x, v, previous = x + v + force / 2, v + force, x
        value, status = (np.asarray(field)[stable] for field in found)
        settled = status == SettlingStatus.SETTLED
        assert settled.mean() > 0.9
        np.testing.assert_array_equal(value[settled], last[settled])
        assert (last[~settled] > 400).all()
        assert (np.asarray(found.status)[~stable] == SettlingStatus.UNSTABLE).all()

    def test_of_an_unstable_loop_is_infinite_and_says_so(self) -> None:
        found = PHANTOM.settling_time(20_000.0, 300.0)
        assert math.isinf(found.value)
        assert SettlingStatus(int(found.status)).words == "the loop is unstable and never settles"

    def test_beyond_the_horizon_is_not_a_number_and_says_so(self) -> None:
        found = PHANTOM.settling_time(20.0, 0.0, horizon=64)
        assert math.isnan(found.value)
        assert int(found.status) == SettlingStatus.NOT_SETTLED
        assert "horizon" in SettlingStatus(int(found.status)).words

    def test_on_the_edge_of_stability_does_not_end(self) -> None:
        found = jaxstab.settling_samples(0.0, 0.5, gamma=0.0, delta=0.0, delay=0)
        assert found.value == math.inf  # a root stays at z = 1
        assert int(found.status) == SettlingStatus.UNSTABLE

    @pytest.mark.parametrize("device_damping", [0.0, 0.5, 1.5, 3.0])
    def test_of_long_delays_that_were_called_infinite_once(self, device_damping: float) -> None:
        """1 kg at 1 kHz behind 30 ms: a bound of all powers at once is too large to be of use."""
        loop = HapticLoop(
            device_mass=1.0, device_damping=device_damping, sample_time=1e-3, delay=0.03
        )
        walls = [(414.11, 24.598), (302.36, 16.943), (181.64, 39.512)]
        for stiffness, damping in walls:
            states, _ = march_on_a_fine_grid(loop, stiffness, damping, LONG, stiffness, np.zeros(2))
            expected = settled_since(states[::FINE, 0], 1.0, 0.02)
            found = loop.settling_time(stiffness, damping)
            assert int(found.status) == SettlingStatus.SETTLED
            assert float(found.value) == pytest.approx(expected * 1e-3, rel=1e-14)

    def test_of_a_loop_that_rings_for_long_is_that_of_its_slowest_pole(self) -> None:
        """A free oscillator again: 30,000 samples until a spring without a wall is at rest."""
        gamma, delta = 0.04, 2.5e-4
        time = np.arange(1 << 16)
        frequency = math.sqrt(gamma - delta**2 / 4)
        deviation = np.exp(-delta / 2 * time) * (
            np.cos(frequency * time) + delta / 2 / frequency * np.sin(frequency * time)
        )
        found = jaxstab.settling_samples(0.0, 0.0, gamma=gamma, delta=delta, delay=1.0)
        assert float(found.value) == settled_since(deviation, 0.0, 0.02) > 30_000

    def test_of_random_loops_are_those_of_their_simulation(self, rng: np.random.Generator) -> None:
        """Either excitation, any delay; what is not settled is unstable or rings for long."""
        count, settled = 25, 0
        for _ in range(count):
            loop = HapticLoop(
                device_mass=1.0,
                device_damping=10 ** rng.uniform(-3, 0),
                hand_stiffness=rng.choice([0.0, 10 ** rng.uniform(-4, 0.5)]),
                sample_time=1.0,
                delay=rng.choice([0.0, 1.0, rng.uniform(0, 12)]),
            )
            slow = 1 + loop.delay
            wall = 0.2 * rng.uniform() / slow**2, 0.6 * rng.uniform() / slow
            level = rng.choice([0.01, 0.02, 0.1])
            push = loop.simulate(*wall, samples=LONG, force=wall[0] + loop.hand_stiffness).position
            hit = np.asarray(loop.simulate(*wall, samples=LONG, initial_velocity=1.0).position)
            expected = {
                "force": settled_since(np.asarray(push), 1.0, level),
                "impact": settled_since(hit, 0.0, level * np.abs(hit).max()),
            }
            for excitation, samples in expected.items():
                found = loop.settling_time(*wall, level=level, excitation=excitation)
                if int(found.status) == SettlingStatus.SETTLED:
                    assert samples == LONG or float(found.value) == samples
                    settled += 1
                else:
                    assert samples == LONG
        assert settled > count

    @pytest.mark.campaign
    def test_of_jax_arrays_are_jax_arrays_also_when_compiled(self) -> None:
        alphas = jax.numpy.array([0.01, 0.03, 0.9])
        direct = jaxstab.settling_samples(np.asarray(alphas), 0.3, gamma=0.0, delta=0.0, delay=1)
        function = jax.jit(
            lambda a: jaxstab.settling_samples(a, 0.3, gamma=0.0, delta=0.0, delay=1)
        )
        for other in (
            function(alphas),
            jaxstab.settling_samples(alphas, 0.3, gamma=0.0, delta=0.0, delay=1),
        ):
            assert all(isinstance(field, jax.Array) for field in other)
            np.testing.assert_array_equal(other.value, direct.value)
            np.testing.assert_array_equal(other.status, direct.status)

    def test_maps_over_gains(self) -> None:
        alphas = np.array([0.01, 0.03])
        direct = jaxstab.settling_samples(alphas, 0.3, gamma=0.0, delta=0.0, delay=0).value
        mapped = jax.vmap(
            lambda a: jaxstab.settling_samples(a, 0.3, gamma=0.0, delta=0.0, delay=0).value
        )(alphas)
        np.testing.assert_array_equal(direct, mapped)
        walls = np.array([2_000.0, 20_000.0])
        direct = PHANTOM.settling_time(walls, 20.0).value
        mapped = jax.vmap(lambda wall: PHANTOM.settling_time(wall, 20.0).value)(walls)
        np.testing.assert_array_equal(direct, mapped)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"level": 0.0}, "level is 0.0"),
            ({"level": 2.0}, "level is 2.0"),
            ({"level": math.nan}, "level is nan"),
            ({"excitation": "kick"}, "excitation"),
            ({"horizon": 0}, "horizon is 0"),
        ],
    )
    def test_refuses(self, options: dict[str, object], message: str) -> None:
        with pytest.raises((ValueError, TypeError), match=message):
            jaxstab.settling_samples(0.1, 0.3, gamma=0.0, delta=0.0, delay=0, **options)

    def test_of_walls_behind_a_butterworth_filter_at_10_khz_is_proved(self) -> None:
        """None of them was; one of them against scipy's sections, run sample by sample."""
        loop = HapticLoop(
            device_mass=2.0,
            device_damping=0.5,
            hand_mass=0.5,
            hand_damping=2.0,
            hand_stiffness=100.0,
            sample_time=1e-4,
            delay=2e-4,
            velocity=Velocity.butterworth(20.0, order=2),
        )
        stiffness, damping = np.array([[30.0], [100.0], [300.0]]), np.array([2.0, 5.0, 20.0])
        for excitation in ("force", "impact"):
            found = loop.settling_time(stiffness, damping, excitation=excitation)
            assert (found.status == SettlingStatus.SETTLED).all()
        units = 1e-8 / 2.5, 1e-4 / 2.5
        plant, wall = (100.0 * units[0], 2.5 * units[1], 2.0), (300.0 * units[0], 20.0 * units[1])
        taps = [difference_taps(1), *butterworth_taps(20.0 * 1e-4, 2)]
        push = wall[0] + plant[0]
        states, _ = march_through_filters(plant, wall, taps, [], 40_000, push=push)
        assert abs(states[-1, 0] - 1.0) < 1e-3
        expected = settled_since(states[:, 0], 1.0, 0.02)
        assert float(loop.settling_time(300.0, 20.0).value) == pytest.approx(1e-4 * expected)


class TestDominantMode:
    @pytest.mark.parametrize(
        "scene",
        [
            (0.1, 0.3, 0.2, 0.1, 0.0),
            (0.05, 0.02, 1e-3, 0.015, 1.5),
            (0.1, 2.2, 0.0, 0.0, 0.0),  # a pole on the negative axis, outside
            (1e-3, 0.4, 0.0, 0.0, 0.0),  # a slow positive pole
        ],
    )
    def test_is_the_logarithm_of_the_certified_root(self, scene: tuple[float, ...]) -> None:
        exponent = mp.log(truth.roots(*scene)[0])
        mode = jaxstab.dominant_mode(**by_name(*scene))
        ratio = -exponent.real / abs(exponent)
        assert float(mode.damping_ratio) == pytest.approx(float(ratio), rel=1e-11)
        assert float(mode.frequency) == pytest.approx(float(abs(exponent.imag)), rel=1e-11)

    def test_of_a_loop_without_a_wall_is_that_of_its_springs(self) -> None:
        loop = HapticLoop(
            device_mass=0.4,
            device_damping=0.0,
            hand_mass=0.1,
            hand_damping=2.0,
            hand_stiffness=200.0,
            sample_time=1e-3,
            delay=5e-4,
        )
        mode = loop.oscillation(0.0, 0.0)
        ratio = 2.0 / (2 * math.sqrt(200.0 * 0.5))
        assert float(mode.damping_ratio) == pytest.approx(ratio, rel=1e-10)
        hertz = math.sqrt(400.0 * (1 - ratio**2)) / (2 * math.pi)
        assert float(mode.frequency) == pytest.approx(hertz, rel=1e-10)


@pytest.mark.parametrize(
    ("delay", "samples", "count", "way"),
    [
        (0, 1, 3, "_by_powers"),
        (0, 33, 3, "_by_powers"),
        (0, 2049, 3, "_by_powers"),
        (2, 5000, 3, "_by_powers"),
        (20, 300, 500, "_stepped"),
        (60, 700, 200, "_stepped"),
        (60, 6000, 200, "_stepped"),  # in two parts
    ],
)
def test_deviations_are_those_of_one_step_after_the_other(
    delay: int, samples: int, count: int, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Judged by scipy's exponential of a mass under a held force."""
    other = {"_stepped": "_by_powers", "_by_powers": "_stepped"}[way]
    monkeypatch.setattr(response, other, None)  # that is not asked
    mass, rubbing, period = 0.25, 0.1, 1e-3
    loop = HapticLoop(
        device_mass=mass, device_damping=rubbing, sample_time=period, delay=delay * period
    )
    stiffness, damping = np.linspace(1.0, 4.0, count), np.linspace(0.5, 1.5, count)
    found = list(response.deviations(loop, stiffness, damping, "force", samples))
    matrix = np.array([[0.0, 1.0, 0.0], [0.0, -rubbing / mass, 1.0 / mass], [0.0] * 3])
    step = expm(matrix * period)[:2]
    x, v, before = -np.ones(count), np.zeros(count), -np.ones(count)
    waiting, expected = [stiffness] * delay, []  # forces, less that at rest
    for _ in range(samples):
        expected.append(x)
        waiting.append(-(stiffness * x + damping * (x - before) / period))
        before = x
        x, v = step @ np.array([x, v, waiting.pop(0)])
    for own, deviation in found:
        np.testing.assert_allclose(deviation, np.array(expected).T[own], rtol=0, atol=1e-9)
    assert sum(len(deviation) for _, deviation in found) == count
