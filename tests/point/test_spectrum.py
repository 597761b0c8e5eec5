"""Poles and spectral radius by companion eigenvalues, against certified roots."""

import csv
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf

import jaxstab
from jaxstab.conventions import AXES, RadiusStatus, Verdict
from jaxstab.model import by_name
from tests.truth import loop as truth

REFERENCE = Path(__file__).parents[2] / "data" / "reference"
SCENE = (0.05, 0.3, 1e-3, 0.015)
TRIPLE_ROOT = 4.0 ** (1 / 3) - 1  # the smallest radius over all gains at gamma = delta = delay = 0


def reference_scenes() -> dict[tuple[float, ...], list[mpf]]:
    """The moduli of all roots of each scene of the reference file, largest first."""
    lines = (REFERENCE / "roots.tsv").read_text().splitlines()
    scenes: dict[tuple[float, ...], list[mpf]] = {}
    for row in csv.DictReader((x for x in lines if x[0] != "#"), delimiter="\t"):
        key = tuple(float(row[axis]) for axis in AXES)
        scenes.setdefault(key, []).append(mpf(row["modulus"]))
    return scenes


def random_scenes(rng: np.random.Generator, count: int) -> np.ndarray:
    delay = rng.choice([0.0, 0.5, 1.0, 2.0, 3.7, 6.0], count)
    gains = rng.uniform(-0.2, 1.0, (2, count)) / (1 + delay)
    return np.array([*gains, rng.uniform(0, 2, count), rng.uniform(0, 1, count), delay])


class TestPoles:
    @pytest.mark.parametrize("shape", [(0,), (2, 0)])
    def test_of_no_loop_there_are_no_poles(self, shape: tuple[int, ...]) -> None:
        poles = jaxstab.closed_loop_poles(np.ones(shape), 0.3, gamma=0.0, delta=0.1, delay=1.0)
        assert poles.shape == (*shape, 4)
        loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        assert loop.poles(np.ones(shape), 1.0).shape == (*shape, 3)

    def test_are_the_certified_roots(self) -> None:
        for scene in [
            (0.1, 0.3, 0.2, 0.1, 0),
            (0.05, 0.2, 1e-3, 0.015, 2),
            (0.1, 0.2, 2.0, 0.1, 1.5),
        ]:
            poles = np.asarray(jaxstab.closed_loop_poles(**by_name(*scene)))
            exact = np.array([complex(root) for root in truth.roots(*scene)])
            assert len(poles) == len(exact)
            distance = np.abs(poles[:, None] - exact)
            assert distance.min(axis=0).max() < 1e-12
            assert distance.min(axis=1).max() < 1e-12
            assert (np.diff(np.abs(poles)) <= 1e-15).all()

    def test_a_lower_degree_in_an_array_of_delays_ends_in_zeros(self) -> None:
        delays = np.array([2.5, 0.0, 1.0])
        poles = jaxstab.closed_loop_poles(**by_name(*SCENE, delays))
        assert poles.shape == (3, 6)
        for row, delay in zip(poles, delays, strict=True):
            alone = jaxstab.closed_loop_poles(**by_name(*SCENE, delay))
            np.testing.assert_allclose(row[: len(alone)], alone, rtol=1e-12)
            assert (row[len(alone) :] == 0).all()


class TestSpectralRadius:
    def test_is_honest_over_the_reference_scenes(self) -> None:
        scenes = reference_scenes()
        radius = jaxstab.spectral_radius(**by_name(*np.array(list(scenes)).T))
        for number, (scene, moduli) in enumerate(scenes.items()):
            value, error = float(radius.value[number]), float(radius.error[number])
            assert abs(mpf(value) - moduli[0]) <= error, scene

    def test_converges_where_the_dominant_root_is_simple(self, rng: np.random.Generator) -> None:
        radius = jaxstab.spectral_radius(**by_name(*random_scenes(rng, 300)))
        assert (radius.status == RadiusStatus.PROVED).all()
        assert np.quantile(radius.error, 0.95) < 1e-12

    @pytest.mark.campaign
    def test_is_honest_at_random_scenes(self, rng: np.random.Generator) -> None:
        scenes = random_scenes(rng, 300)
        radius = jaxstab.spectral_radius(**by_name(*scenes))
        for scene, value, error in zip(scenes.T.tolist(), radius.value, radius.error, strict=True):
            lower, upper = truth.spectral_radius(*scene)
            assert lower - float(error) <= mpf(float(value)) <= upper + float(error), scene

    def test_is_honest_at_a_triple_root(self) -> None:
        alpha, beta = 6 * TRIPLE_ROOT**2 - 2, 2 * TRIPLE_ROOT**3
        radius = jaxstab.spectral_radius(alpha, beta, gamma=0.0, delta=0.0, delay=0)
        lower, _ = truth.spectral_radius(alpha, beta, 0.0, 0.0, 0)
        assert abs(mpf(float(radius.value)) - lower) <= float(radius.error)
        assert float(radius.error) < 1e-3

    @pytest.mark.parametrize("delay", [0, 2])
    def test_is_honest_without_a_controller(self, delay: int) -> None:
        """alpha = beta = 0: roots at zero as many as the delay, defective in the companion."""
        radius = jaxstab.spectral_radius(0.0, 0.0, gamma=0.5, delta=0.2, delay=delay)
        assert abs(float(radius.value) - float(mp.exp(-mpf(0.2) / 2))) <= float(radius.error)
        assert float(radius.error) < 1e-12

    @pytest.mark.parametrize("method", ["fast", "companion"])
    def test_points_of_many_delays_are_those_of_each_alone(
        self, method: str, rng: np.random.Generator
    ) -> None:
        delay = np.concatenate([rng.uniform(0.0, 4.0, 60), rng.integers(0, 8, 60) / 2.0])
        point = {"gamma": 0.01, "delta": 0.2, "method": method}
        alpha, beta = rng.uniform(-0.1, 0.4, 120), rng.uniform(-0.1, 0.8, 120)
        together = jaxstab.spectral_radius(alpha, beta, delay=delay, **point)
        for k in range(120):
            alone = jaxstab.spectral_radius(alpha[k], beta[k], delay=delay[k], **point)
            assert (together.value[k], together.error[k]) == (alone.value, alone.error)

    def test_broadcasts_over_five_axes_with_fractional_delays(self) -> None:
        axes = np.ix_([0.01, 0.1, 0.2], [0.1, 0.3], [0.0, 1e-3], [0.0, 0.015], [0.0, 0.5, 2.0])
        radius = jaxstab.spectral_radius(**by_name(*axes))
        assert radius.value.shape == radius.error.shape == radius.status.shape == (3, 2, 2, 2, 3)
        lower, upper = truth.spectral_radius(0.2, 0.1, 1e-3, 0.015, 0.5)
        error = float(radius.error[2, 0, 1, 1, 1])
        assert lower - error <= float(radius.value[2, 0, 1, 1, 1]) <= upper + error

    @pytest.mark.campaign
    @pytest.mark.parametrize("delay", [0, 1.5])
    def test_gradient_is_the_motion_of_the_dominant_root(self, delay: float) -> None:
        scenes = np.array([SCENE, (0.02, 0.1, 1e-3, 0.015), (0.1, 0.5, 0.01, 0.05)])
        function = lambda *points: jaxstab.spectral_radius(**by_name(*points, delay)).value.sum()  # noqa: E731
        gradients = jax.jit(jax.grad(function, argnums=(0, 1, 2, 3)))(*scenes.T)
        for scene, gradient in zip(scenes, np.transpose(gradients), strict=True):
            for axis, derivative in enumerate(gradient):
                with mp.workdps(60):
                    moved = [list(map(mpf, scene)) for _ in range(2)]
                    moved[0][axis] -= mpf(10) ** -20
                    moved[1][axis] += mpf(10) ** -20
                    below, above = (truth.spectral_radius(*point, delay)[0] for point in moved)
                    exact = float((above - below) / (2 * mpf(10) ** -20))
                assert derivative == pytest.approx(exact, rel=1e-10)

    @pytest.mark.campaign
    def test_gradient_is_finite_where_the_companion_matrix_is_defective(self) -> None:
        """alpha = beta = 0 with delay: the roots at zero are multiple, the dominant pair is not."""
        function = lambda alpha: (  # noqa: E731
            jaxstab.spectral_radius(alpha, 0.0, gamma=0.5, delta=0.2, delay=2).value
        )
        assert jnp.isfinite(jax.grad(function)(0.0))

    @pytest.mark.campaign
    def test_jit_and_vmap_agree_with_a_direct_call(self) -> None:
        direct = jaxstab.spectral_radius(**by_name(*SCENE, 1))
        function = lambda alpha: jaxstab.spectral_radius(**by_name(alpha, *SCENE[1:], 1))  # noqa: E731
        for wrapped in (jax.jit(function), lambda a: jax.vmap(function)(jnp.array([a]))):
            assert float(jnp.ravel(wrapped(SCENE[0]).value)[0]) == pytest.approx(
                float(direct.value), rel=1e-14
            )


class TestStableSet:
    def test_knows_the_exact_set_of_the_undamped_mass(self, rng: np.random.Generator) -> None:
        beta = rng.uniform(0.01, 1.99, 500)
        alpha = rng.uniform(-0.2, 1.0, 500)
        inside = (alpha > 0) & (alpha < 2 * beta * (2 - beta) / (beta + 2))
        np.testing.assert_array_equal(
            jaxstab.verdict(alpha, beta, gamma=0.0, delta=0.0, delay=0) == Verdict.STABLE, inside
        )

    def test_a_marginal_loop_is_not_stable(self) -> None:
        assert jaxstab.verdict(0.0, 0.5, gamma=0.0, delta=0.0, delay=0) != Verdict.STABLE


class TestEvaluateGrid:
    def test_a_grid_larger_than_its_chunks_gives_the_same_numbers(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        axes = np.ix_(np.linspace(0.01, 0.2, 9), np.linspace(0.1, 0.5, 7), [1e-3], [0.0], [0, 0.5])
        whole = jaxstab.spectral_radius(**by_name(*axes)).value
        monkeypatch.setattr("jaxstab.point.poles.CHUNK", 64)
        np.testing.assert_array_equal(jaxstab.spectral_radius(**by_name(*axes)).value, whole)

    def test_streams_a_grid_in_order(self) -> None:
        axes = np.ix_([0.01, 0.1], [0.1, 0.3, 0.5], [1e-3], [0.0, 0.01], [1.0])
        whole = np.ravel(jaxstab.spectral_radius(**by_name(*axes)).value)
        seen = np.zeros_like(whole)
        for points, part in jaxstab.evaluate_grid(
            jaxstab.spectral_radius, **by_name(*axes), chunk=5
        ):
            assert points.stop - points.start <= 5
            seen[points] = part.value
        np.testing.assert_array_equal(seen, whole)

    def test_a_billion_points_need_no_memory_before_they_are_asked_for(self) -> None:
        axis = np.linspace(0.01, 0.1, 1000)
        axes = np.ix_(axis, axis, axis, [0.0], [0.0])
        points, part = next(jaxstab.evaluate_grid(jaxstab.verdict, **by_name(*axes), chunk=100))
        assert (points, part.shape) == (slice(0, 100), (100,))

    @pytest.mark.parametrize("chunk", [0, -3])
    def test_refuses_an_empty_chunk(self, chunk: int) -> None:
        with pytest.raises(ValueError, match="chunk is"):
            jaxstab.evaluate_grid(
                jaxstab.verdict, 0.1, 0.1, gamma=0.0, delta=0.0, delay=0, chunk=chunk
            )


@pytest.mark.parametrize("method", ["fast", "companion"])
def test_a_bound_holds_for_tiny_poles_of_a_strongly_damped_plant(method: str) -> None:
    point = (-1.904433602537459e-19, 0.0, 2731.67816822823, 104.53091730637838, 0.0)
    radius = jaxstab.spectral_radius(**by_name(*point), method=method)
    low, high = truth.spectral_radius(*point)
    assert low - float(radius.error) <= float(radius.value) <= high + float(radius.error)


@pytest.mark.parametrize(("delta", "status"), [(9.5, "PROVED"), (10.5, "NO_BOUND")])
def test_small_radii_of_damped_plants_are_proved_up_to_a_damping_of_10(
    delta: float, status: str
) -> None:
    """The slower pole of a free plant: s^2 + delta s + gamma = 0."""
    gamma = 0.2 * delta**2
    radius = jaxstab.spectral_radius(0.0, 0.0, gamma=gamma, delta=delta, delay=0.0)
    true = mp.exp(-(delta - mp.sqrt(delta**2 - 4 * mpf(gamma))) / 2)
    assert true < 0.5
    assert radius.status == RadiusStatus[status]
    assert abs(true - mpf(float(radius.value))) <= float(radius.error)
