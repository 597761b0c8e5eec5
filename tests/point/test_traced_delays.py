"""A delay that JAX traces, up to a longest one: one program, judged at 50 digits."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from campaign import first
from mpmath import mpf

import jaxstab
from jaxstab import Velocity, Verdict
from jaxstab.model import by_name
from tests.truth import loop as truth

LONGEST = 2.7
DELAYS = [0.0, 0.3, 1.0, np.nextafter(1.0, 0.0), np.nextafter(2.0, 3.0), 2.0, 2.5, LONGEST]


def walls(rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Half of them stable, of every delay and many hands; the rest of any size."""
    delay = np.resize(DELAYS, count)
    alpha = rng.uniform(-0.2, 1.5, count) / (1.0 + delay) ** 2
    beta = rng.uniform(-0.1, 2.2, count) / (1.0 + 2.0 * delay)
    wild = rng.random(count) < 0.2
    alpha[wild] *= 10.0 ** rng.uniform(-12.0, 120.0, wild.sum())
    beta[wild] *= 10.0 ** rng.uniform(-12.0, 120.0, wild.sum())
    gamma = rng.choice([0.0, 1e-9, 1e-3, 0.4, 39.4, 1e4], count, p=[0.3, 0.1, 0.3, 0.1, 0.1, 0.1])
    delta = rng.choice([0.0, 1e-9, 0.015, 0.3, 20.0, 1e3], count, p=[0.2, 0.1, 0.4, 0.1, 0.1, 0.1])
    return [alpha, beta, gamma, delta, delay]


class TestATracedDelay:
    def test_takes_one_program_for_all_delays(self, rng: np.random.Generator) -> None:
        points, traced = walls(rng, 400), []

        def answers(*point: jax.Array) -> tuple[Any, ...]:
            traced.append(point)
            own = by_name(*point) | {"longest_delay": LONGEST}
            polynomial = jaxstab.characteristic_polynomial(**own)
            poles = jaxstab.closed_loop_poles(**own)
            matrix = jaxstab.companion_matrix(polynomial)
            return jaxstab.verdict(**own), jaxstab.spectral_radius(**own), poles, matrix

        codes, radius, poles, matrix = jax.jit(jax.vmap(answers))(*points)
        assert len(traced) == 1
        plain = np.asarray(jaxstab.verdict(**by_name(*points)))
        decided = (codes != Verdict.UNDECIDED) & (plain != Verdict.UNDECIDED)
        assert np.array_equal(codes[decided], plain[decided])
        assert np.mean(codes == Verdict.UNDECIDED) <= np.mean(plain == Verdict.UNDECIDED)
        assert poles.shape == (400, 6)
        assert matrix.shape == (400, 6, 6)
        slow = np.abs(np.asarray(jaxstab.closed_loop_poles(**by_name(*points))))
        np.testing.assert_allclose(np.abs(poles)[:, 0], slow[:, 0], rtol=1e-3)
        for place in range(5, 400, 11):
            lower, upper = truth.spectral_radius(*(float(axis[place]) for axis in points))
            value, error = mpf(float(radius.value[place])), mpf(float(radius.error[place]))
            assert upper - error <= value <= lower + error
            if codes[place] != Verdict.UNDECIDED:
                assert (upper < 1) == (codes[place] == Verdict.STABLE)
                assert (lower > 1) or (codes[place] == Verdict.STABLE)

    @pytest.mark.parametrize("velocity", first([None, Velocity.difference(samples=3)], 1))
    def test_is_judged_next_to_the_boundary(self, velocity: Velocity | None) -> None:
        """Walls closer and closer to the boundary: what is said there is what a plain delay has."""
        delay, hand = (
            np.array([0.0, 0.5, 1.0, 2.25, 3.0])[:, None, None],
            {"gamma": 1e-3, "delta": 0.015},
        )
        loop = hand | {"velocity": velocity}
        rough = np.linspace(0.0, 2.0, 400)
        inside = np.array(
            [
                rough[jaxstab.verdict(rough, 0.1, delay=d, **loop) == Verdict.STABLE].max()
                for d in delay.ravel().tolist()
            ]
        )
        low, high = inside, inside + rough[1]
        for _ in range(60):
            middle = 0.5 * (low + high)
            codes = jaxstab.verdict(middle, 0.1, delay=delay.ravel(), resolve="exact", **loop)
            is_in = codes == Verdict.STABLE
            low, high = np.where(is_in, middle, low), np.where(is_in, high, middle)
        shares = 10.0 ** np.arange(-16.0, -1.0)
        alpha = low[:, None, None] * (1.0 + np.array([-1.0, 1.0])[:, None] * shares)
        codes = jax.jit(
            lambda alpha, delay: jaxstab.verdict(alpha, 0.1, delay=delay, longest_delay=3, **loop)
        )(alpha, delay)
        exact = jaxstab.verdict(alpha, 0.1, delay=delay, resolve="exact", **loop)
        decided = np.asarray(codes) != Verdict.UNDECIDED
        assert np.array_equal(np.asarray(codes)[decided], exact[decided])
        assert decided[..., shares >= 1e-10].all()

    @pytest.mark.parametrize("velocity", first([None, Velocity.low_pass(0.2)], 1))
    def test_has_the_derivatives_of_differences(self, velocity: Velocity | None) -> None:
        hand = {"gamma": 1e-3, "delta": 0.015, "velocity": velocity}
        delay, step = np.array([0.4, 1.3, 2.6]), 1e-5

        def value(delay: jax.Array) -> jax.Array:
            return jaxstab.spectral_radius(
                0.05, 0.15, delay=delay, longest_delay=LONGEST, **hand
            ).value

        slopes = jax.jit(jax.vmap(jax.grad(value)))(jnp.asarray(delay))
        later, earlier = (
            jaxstab.spectral_radius(0.05, 0.15, delay=delay + sign * step, **hand).value
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(slopes, (later - earlier) / (2.0 * step), rtol=1e-7)

    def test_beyond_the_longest_has_no_answer(self) -> None:
        hand = {"gamma": 0.0, "delta": 0.1, "longest_delay": 1}

        def answers(delay: jax.Array) -> tuple[jax.Array, jax.Array]:
            own = hand | {"delay": delay}
            return jaxstab.verdict(0.1, 0.2, **own), jaxstab.spectral_radius(0.1, 0.2, **own).value

        codes, radii = jax.jit(answers)(jnp.array([-1.0, 0.0, 1.0, 1.1, jnp.nan]))
        assert codes.tolist() == [3, 1, 1, 3, 3]
        assert np.isnan(radii).tolist() == [True, False, False, True, True]

    def test_is_refused_in_words_where_it_is_concrete(self) -> None:
        with pytest.raises(ValueError, match=r"delay is 4\.0; allowed are finite values"):
            jaxstab.verdict(0.1, 0.2, gamma=0.0, delta=0.1, delay=4.0, longest_delay=3.0)
        with pytest.raises(TypeError, match="longest_delay"):
            jax.jit(lambda d: jaxstab.verdict(0.1, 0.2, gamma=0.0, delta=0.1, delay=d))(1.0)
