"""The simulated loop, against scipy's discretisation of a finer grid and against p(z)."""

import jax
import numpy as np
import pytest

from jaxstab import HapticLoop
from tests.truth import loop as truth
from tests.truth.march import FINE, HELD, OSCILLATING, PHANTOM, march_on_a_fine_grid

SCENES = [
    (PHANTOM, 20_000.0, 20.0),
    (HELD, 2_000.0, 30.0),
    (OSCILLATING, 0.05, -0.02),
    (HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=1.0), 0.1, 0.4),
]


class TestSimulate:
    @pytest.mark.parametrize(("loop", "stiffness", "damping"), SCENES)
    def test_is_the_fine_discretisation_at_samples_and_between(
        self, loop: HapticLoop, stiffness: float, damping: float
    ) -> None:
        response = loop.simulate(
            stiffness, damping, samples=60, force=2.0, initial_velocity=0.1, between=FINE - 1
        )
        states, forces = march_on_a_fine_grid(
            loop, stiffness, damping, 60, 2.0, np.array([0.0, 0.1])
        )
        for mine, theirs in [
            (response.position, states[:, 0]),
            (response.velocity, states[:, 1]),
            (response.force, forces),
        ]:
            np.testing.assert_allclose(mine, theirs, atol=1e-11 * np.abs(theirs).max())
        step = loop.sample_time / FINE
        np.testing.assert_allclose(response.time, np.arange(60 * FINE) * step, rtol=1e-14)

    @pytest.mark.parametrize(("loop", "stiffness", "damping"), SCENES)
    def test_an_impact_obeys_the_recurrence_of_the_characteristic_polynomial(
        self, loop: HapticLoop, stiffness: float, damping: float
    ) -> None:
        position = np.asarray(loop.simulate(stiffness, damping, initial_velocity=1.0).position)
        scene = loop.alpha(stiffness), loop.beta(damping), loop.gamma, loop.delta
        coefficients = np.array(truth.polynomial(*scene, loop.delay_samples), float)
        recurrence = np.convolve(position, coefficients, mode="valid")
        assert np.abs(recurrence).max() < 1e-13 * np.abs(position).max()

    def test_an_unstable_loop_grows_as_its_spectral_radius(self) -> None:
        response = PHANTOM.simulate(20_000.0, 200.0, samples=400, initial_velocity=0.01)
        scene = PHANTOM.alpha(20_000.0), PHANTOM.beta(200.0), PHANTOM.gamma, PHANTOM.delta
        radius = float(truth.spectral_radius(*scene, 0)[0])
        assert radius > 1
        x = np.asarray(response.position)[-4:]
        ratio = (x[1] * x[3] - x[2] ** 2) / (x[0] * x[2] - x[1] ** 2)  # radius^2 of a lone pair
        assert ratio**0.5 == pytest.approx(radius, rel=1e-9)

    def test_a_pushing_hand_ends_where_all_springs_carry_its_force(self) -> None:
        response = HELD.simulate(2_000.0, 30.0, samples=2000, force=5.0)
        assert float(response.position[-1]) == pytest.approx(5.0 / 2150.0, rel=1e-12)
        assert float(response.force[-1]) == pytest.approx(-5.0 * 2000 / 2150, rel=1e-12)
        assert abs(float(response.velocity[-1])) < 1e-12

    def test_a_displaced_device_returns(self) -> None:
        response = PHANTOM.simulate(10_000.0, 30.0, samples=300, initial_position=1e-3)
        assert float(response.position[0]) == 1e-3
        assert abs(float(response.position[-1])) < 1e-9

    def test_walls_and_excitations_broadcast(self) -> None:
        walls, speeds = np.array([[1_000.0], [5_000.0]]), np.array([0.1, 0.2, 0.4])
        response = PHANTOM.simulate(walls, 10.0, samples=30, initial_velocity=speeds)
        assert response.position.shape == response.force.shape == (2, 3, 30)
        assert response.time.shape == (30,)
        np.testing.assert_allclose(response.position[:, 2], 4 * response.position[:, 0], rtol=1e-12)
        assert not np.allclose(response.position[0], response.position[1])

    def test_of_jax_arrays_is_that_of_numpy(self) -> None:
        walls = np.array([2_000.0, 3_000.0])
        options = {"samples": 30, "initial_velocity": 0.1, "between": 2, "unilateral": True}
        plain = HELD.simulate(walls, 30.0, **options)
        compiled = HELD.simulate(jax.numpy.asarray(walls), 30.0, **options)
        assert all(isinstance(field, np.ndarray) for field in plain)
        assert all(isinstance(field, jax.Array) for field in compiled)
        for mine, other in zip(plain, compiled, strict=True):
            np.testing.assert_allclose(mine, other, rtol=1e-12, atol=1e-12 * np.abs(mine).max())

    def test_the_derivative_in_stiffness_is_that_of_the_fine_discretisation(self) -> None:
        last = lambda k: HELD.simulate(k, 30.0, samples=40, force=5.0).position[-1]  # noqa: E731
        start = np.zeros(2)
        above, below = (
            march_on_a_fine_grid(HELD, 2_000.0 + h, 30.0, 40, 5.0, start)[0][-FINE, 0]
            for h in (1.0, -1.0)
        )
        assert float(jax.grad(last)(2_000.0)) == pytest.approx((above - below) / 2, rel=1e-5)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({}, "nothing moves"),
            ({"initial_velocity": 0.1, "samples": 0}, "samples is 0"),
            ({"initial_velocity": 0.1, "between": -1}, "between is -1"),
            ({"initial_velocity": np.nan}, "initial_velocity is nan"),
        ],
    )
    def test_refuses(self, arguments: dict[str, float], message: str) -> None:
        with pytest.raises(ValueError, match=message):
            PHANTOM.simulate(1_000.0, 10.0, **arguments)

    @pytest.mark.parametrize("gain", [np.nan, np.inf])
    def test_refuses_a_gain_that_is_not_finite(self, gain: float) -> None:
        with pytest.raises(ValueError, match="stiffness is"):
            PHANTOM.simulate(gain, 10.0, initial_velocity=0.1)


class TestUnilateralWall:
    def test_a_device_that_stays_inside_does_not_notice(self) -> None:
        """Remark 1: the hand pushes hard enough, so the position never leaves the wall."""
        arguments = {"samples": 150, "force": 5.0, "initial_velocity": 0.05}
        one, both = (
            PHANTOM.simulate(10_000.0, 30.0, unilateral=side, **arguments) for side in (True, False)
        )
        assert (one.position[1:] > 0).all()
        np.testing.assert_array_equal(one.position, both.position)

    def test_a_bouncing_device_flies_freely(self) -> None:
        free = HapticLoop(device_mass=0.1, device_damping=0.0, sample_time=1e-3)
        response = free.simulate(
            10_000.0, 30.0, samples=200, initial_velocity=0.5, unilateral=True, between=1
        )
        outside = np.flatnonzero(np.asarray(response.position) < 0)
        assert outside.size
        flight = slice(outside[0] + 2, None)  # the last force is still held for one sample
        assert (response.force[flight] == 0).all()
        assert np.ptp(response.velocity[flight]) == 0
        assert -0.5 < float(response.velocity[-1]) < 0
