"""The best gains of loops with estimators and filters, against certified roots and brute force."""

import tracemalloc
from typing import Any

import flint
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from campaign import first, many
from matplotlib.path import Path

import jaxstab
from jaxstab import Filter, Velocity
from jaxstab.model import by_name
from jaxstab.results import TuningStatus
from tests.truth import filtered as truth
from tests.truth.descents import better_wall, descent, ordinary_loop, radii

MOST_FOUND = 2e-4  # as the words of SCANNED have it

WINDOW = {"velocity": Velocity.difference(samples=20)}
LOW_PASS = {"velocity": Velocity.low_pass(0.05, order=2)}
BOTH = {"velocity": Velocity.exponential(0.25), "position": Filter.low_pass(0.2)}
BUTTERWORTH = {"velocity": Velocity.butterworth(0.02, order=2)}

_SLOW = truth.times(truth.difference(1), truth.low_pass(0.05, order=2))
_SMOOTH = truth.times(truth.difference(1), truth.exponential(0.25))
_NONE = truth.average(1)

# Filters, beside the truth's estimator and filter, and a plant.
CASES: dict[str, tuple[dict[str, Any], tuple[Any, Any], tuple[float, float, float]]] = {
    "window": (WINDOW, (truth.difference(20), _NONE), (1e-4, 1e-3, 1.0)),
    "low pass, with an island that decays faster": (LOW_PASS, (_SLOW, _NONE), (0.0, 0.0, 0.0)),
    "estimator and filter": (BOTH, (_SMOOTH, truth.low_pass(0.2, order=1)), (1e-3, 0.015, 2.5)),
    "Butterworth": (
        BUTTERWORTH,
        (truth.times(truth.difference(1), truth.butterworth(0.02, order=2)), _NONE),
        (1e-4, 1e-3, 5.0),
    ),
}


def polynomials(plant: tuple[float, float, float], filters: tuple[Any, Any]) -> np.ndarray:
    """Return p without a wall, and what a unit of alpha and of beta adds, from balls."""
    loop = truth.FilteredLoop(*plant, *filters)
    base, alpha, beta = (
        np.array([float(c.mid()) for c in loop.polynomial(*wall)])
        for wall in ((0, 0), (1, 0), (0, 1))
    )
    return np.stack([base, alpha - base, beta - base])


class TestMinimizeRadius:
    @pytest.mark.parametrize("case", CASES)
    def test_is_reached_in_the_component_of_small_gains(self, case: str) -> None:
        filters, exact, plant = CASES[case]
        best = jaxstab.minimize_radius(**by_name(*plant), **filters)
        gains = float(best.alpha), float(best.beta)
        loop = truth.FilteredLoop(*plant, *exact)
        reached = float(loop.radius(*gains).mid())
        assert reached == pytest.approx(float(best.value), rel=1e-3)
        main = jaxstab.stable_region(**by_name(*plant), **filters).main
        assert main is not None
        assert main.contains(*gains)

    @pytest.mark.parametrize("case", first(CASES, 1))
    def test_is_not_beaten_by_descents_that_stay_in_the_component(
        self, case: str, rng: np.random.Generator
    ) -> None:
        filters, exact, plant = CASES[case]
        best = jaxstab.minimize_radius(**by_name(*plant), **filters)
        parts = polynomials(plant, exact)
        main = jaxstab.stable_region(**by_name(*plant), **filters).main
        assert main is not None
        gains, outline = np.array([float(best.alpha), float(best.beta)]), Path(main.points)
        for start in (gains, 0.1 * gains, 0.9 * main.points[len(main.points) // 3]):
            least, _ = descent(parts, start, rng, outline)
            assert least > float(best.value) * (1.0 - 1e-4)

    def test_of_a_dense_grid_of_the_component_none_is_better(self) -> None:
        """The low pass has an island at (0.63, -2.76) with a radius of 0.915."""
        filters, exact, plant = CASES["low pass, with an island that decays faster"]
        best = jaxstab.minimize_radius(**by_name(*plant), **filters)
        main = jaxstab.stable_region(**by_name(*plant), **filters).main
        assert main is not None
        low, high = main.points.min(axis=0), main.points.max(axis=0)
        alpha, beta = np.meshgrid(*(np.linspace(a, b, 60) for a, b in zip(low, high, strict=True)))
        inside = np.asarray(main.contains(alpha, beta))
        grid = np.stack([alpha[inside], beta[inside]], axis=1)
        values = radii(polynomials(plant, exact), grid)
        assert values.min() >= float(best.value) - 1e-9
        island = jaxstab.spectral_radius(0.6275, -2.7573, **by_name(*plant), **filters)
        assert float(island.value) + float(island.error) < float(best.value)

    def test_where_small_gains_are_not_stable_says_that_it_is_an_island(self) -> None:
        """A hand beyond the Nyquist frequency, undamped: the stable set is at alpha < 0."""
        plant, filters = (12.0, 0.0, 0.0), {"velocity": Velocity.difference(samples=2)}
        assert jaxstab.stable_region(**by_name(*plant), **filters).main is None
        best = jaxstab.minimize_radius(**by_name(*plant), **filters)
        assert int(best.status) == TuningStatus.ISLAND
        wall = float(best.alpha), float(best.beta)
        assert int(jaxstab.verdict(*wall, **by_name(*plant), **filters)) == jaxstab.Verdict.STABLE

    def test_a_window_of_one_sample_is_the_loop_of_the_paper(self) -> None:
        plain = jaxstab.minimize_radius(gamma=1e-3, delta=0.015, delay=1.5)
        window = jaxstab.minimize_radius(
            gamma=1e-3, delta=0.015, delay=1.5, velocity=Velocity.difference(samples=1)
        )
        for one, other in zip(plain, window, strict=True):
            np.testing.assert_array_equal(one, other)

    @pytest.mark.campaign
    def test_of_many_hands_and_of_jax_arrays(self) -> None:
        gammas, filters = np.array([0.0, 1e-3]), {"velocity": Velocity.difference(samples=3)}
        together = jaxstab.minimize_radius(gamma=gammas, delta=0.01, delay=1.0, **filters)
        compiled = jax.jit(
            lambda g: jaxstab.minimize_radius(gamma=g, delta=0.01, delay=1.0, **filters)
        )(jnp.asarray(gammas))
        for number, gamma in enumerate(gammas):
            alone = jaxstab.minimize_radius(gamma=gamma, delta=0.01, delay=1.0, **filters)
            for one, all_, traced in zip(alone, together, compiled, strict=True):
                assert float(one) == pytest.approx(float(all_[number]), rel=1e-12)
                assert float(one) == pytest.approx(float(traced[number]), rel=1e-9)

    def test_of_a_loop_whose_plant_has_no_zero_near_the_circle(self) -> None:
        plant = (1e-4, 2.1, 1.0)
        best = jaxstab.minimize_radius(**by_name(*plant), velocity=Velocity.difference(samples=3))
        assert int(best.status) != TuningStatus.NO_STABLE_GAINS

    def test_refuses_traced_filters_in_one_sentence(self) -> None:
        def radius(cutoff: Any) -> Any:
            return jaxstab.minimize_radius(
                gamma=0.0, delta=0.0, delay=0.0, velocity=Velocity.low_pass(cutoff)
            ).value

        with pytest.raises(TypeError, match="JAX traces; give numbers"):
            jax.jit(radius)(0.1)


class TestMinimizeRadiusDamping:
    @pytest.mark.parametrize("case", CASES)
    def test_is_the_least_of_a_dense_scan(self, case: str) -> None:
        filters, exact, plant = CASES[case]
        alpha = 5e-4
        best = jaxstab.minimize_radius(alpha=alpha, **by_name(*plant), **filters)
        betas = np.linspace(0.0, 0.1, 4001)
        values = radii(polynomials(plant, exact), np.stack([np.full_like(betas, alpha), betas], 1))
        assert float(best.value) <= values.min() + 1e-6
        assert float(best.beta) == pytest.approx(betas[values.argmin()], abs=1e-4)
        reached = truth.FilteredLoop(*plant, *exact).radius(alpha, float(best.beta))
        assert abs(reached - flint.arb(float(best.value))) < 1e-6

    def test_of_a_stiffness_that_only_an_island_has_says_so(self) -> None:
        best = jaxstab.minimize_radius(alpha=0.6, gamma=0.0, delta=0.0, delay=0.0, **LOW_PASS)
        assert int(best.status) == TuningStatus.ISLAND
        assert float(best.value) < 1.0
        none = jaxstab.minimize_radius(alpha=0.6, gamma=0.0, delta=0.0, delay=0.0, **WINDOW)
        assert int(none.status) == TuningStatus.NO_STABLE_GAINS


def settled_mass(alpha: np.ndarray, beta: np.ndarray, window: int, length: int) -> np.ndarray:
    """2 % settling of a pushed, undamped mass behind one sample of delay, by its recurrence."""
    x, v = -np.ones(alpha.shape), np.zeros(alpha.shape)
    past, waiting, first = [x] * window, alpha, np.zeros(alpha.shape)
    for sample in range(length):
        first = np.where(np.abs(x) <= 0.02, first, sample + 1)
        force, waiting = waiting, -(alpha * x + beta * (x - past[0]) / window)
        past = [*past[1:], x]
        x, v = x + v + force / 2, v + force
    return first


class TestMinimizeSettling:
    @pytest.mark.campaign
    def test_is_reached_and_not_beaten_by_brute_force(self) -> None:
        window, plant = 6, (0.0, 0.0, 1.0)
        filters = {"velocity": Velocity.difference(samples=window)}
        best = jaxstab.minimize_settling(**by_name(*plant), **filters)
        gains = np.asarray(best.alpha), np.asarray(best.beta)
        assert settled_mass(*gains, window, 200) == float(best.value)
        main = jaxstab.stable_region(**by_name(*plant), **filters).main
        assert main is not None
        (_, high_alpha), (_, high_beta) = zip(main.points.min(0), main.points.max(0), strict=True)
        grid = np.meshgrid(np.linspace(0.0, high_alpha, 300), np.linspace(0.0, high_beta, 300))
        assert settled_mass(*grid, window, 60).min() >= float(best.value)

    def test_with_a_given_stiffness_is_not_beaten_by_brute_force(self) -> None:
        velocity = Velocity.difference(samples=6)
        best = jaxstab.minimize_settling(
            gamma=0.0, delta=0.0, delay=1.0, alpha=0.005, velocity=velocity
        )
        betas = np.linspace(0.0, 0.3, 4001)
        brute = settled_mass(np.full(betas.shape, 0.005), betas, 6, 300)
        assert float(best.alpha) == 0.005
        assert float(best.value) == brute.min()


class TestTune:
    @pytest.mark.campaign
    def test_of_a_device_with_a_window_in_si_units(self) -> None:
        """0.25 kg at 1 kHz, 15 ms as in CHAI3D: both goals, and a given stiffness."""
        loop = jaxstab.HapticLoop(
            device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3,
            velocity=Velocity.difference(window=0.015),
        )  # fmt: skip
        quick, calm = loop.tune("settling"), loop.tune("radius")
        assert quick.settling_time < calm.settling_time
        assert calm.radius < quick.radius < 1.0
        for wall in (quick, calm):
            found = loop.settling_time(wall.stiffness, wall.damping)
            assert float(found.value) == wall.settling_time
            main = loop.region().main
            assert main is not None
            assert main.contains(wall.stiffness, wall.damping)
        assert calm.status == TuningStatus.TRIPLE_ROOT
        given = loop.tune("radius", stiffness=500.0)
        assert given.stiffness == pytest.approx(500.0, rel=1e-14)
        assert calm.radius < given.radius < 1.0

    def test_the_edges_belong_to_the_search(self) -> None:
        """A damper is calmest: the radius at K = 0 is 0.8145, and 0.8160 close to it."""
        period = 2.0**-10
        loop = jaxstab.HapticLoop(
            device_mass=1.0, device_damping=77.391, hand_stiffness=14114.8, sample_time=period,
            delay=0.87 * period, velocity=Velocity.difference(4),
        )  # fmt: skip
        best, at_zero = loop.tune("radius"), loop.tune("radius", stiffness=0.0)
        assert best.radius <= at_zero.radius * (1.0 + 1e-8)
        assert best.stiffness == 0.0

    def test_memory_does_not_grow_with_the_settling_time(self) -> None:
        """4,225 walls, each seen for twice the settling time, would take 108 MB."""
        loop = jaxstab.HapticLoop(
            device_mass=1.0, device_damping=0.1, sample_time=1e-3, velocity=Velocity.low_pass(1.0)
        )
        tracemalloc.start()
        try:
            best = loop.tune(stiffness=60.0)
            most = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert best.settling_time > 1.0
        assert most < 100e6  # it was 149 MB

    @pytest.mark.campaign
    def test_other_searches_find_no_more_than_the_status_says(self) -> None:
        rng = np.random.default_rng([20120412, 1])
        assert max(better_wall(ordinary_loop(rng), rng) for _ in range(many(1000, 40))) < MOST_FOUND
