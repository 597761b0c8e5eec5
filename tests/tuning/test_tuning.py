"""The best gains, against closed forms, 50-digit multiple roots and brute force in plain NumPy."""

import itertools
import math
from functools import partial

import jax
import numpy as np
import pytest
import scipy.optimize
from mpmath import mp, mpf

import jaxstab
from jaxstab.model import by_name
from jaxstab.results import TuningStatus
from jaxstab.tuning import _largest_moduli
from tests.truth import loop as truth
from tests.truth.march import HELD, PHANTOM

LEAST_RADII = (0.587401, 0.752114, 0.824656, 0.864687, 0.889931, 0.907271)  # gamma = delta = 0
LARGEST_ALPHAS = (12 - 8 * math.sqrt(2), 0.14447, 0.06243, 0.03478)

Plant = tuple[float, float, float]


def exact_family(plant: Plant) -> list[np.ndarray]:
    """p at no gains, and what a unit of alpha and of beta adds, all to 50 digits."""
    base, alpha, beta = (
        np.array(truth.polynomial(*gains, *plant)) for gains in [(0, 0), (1, 0), (0, 1)]
    )
    return [base, alpha - base, beta - base]


def radii(plant: Plant, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    base, stiff, damp = (part.astype(float) for part in exact_family(plant))
    alpha, beta = np.broadcast_arrays(alpha, beta)
    coefficients = base + alpha[..., None] * stiff + beta[..., None] * damp
    companion = np.zeros((*alpha.shape, base.size - 1, base.size - 1))
    companion[..., 1:, :-1] = np.eye(base.size - 2)
    companion[..., 0, :] = -coefficients[..., 1:]
    return np.abs(np.linalg.eigvals(companion)).max(-1)


@pytest.mark.parametrize("degree", [12, 60, 61, 200])
def test_the_largest_modulus_is_that_of_chosen_roots(degree: int) -> None:
    """At equal angles coefficients tell the roots; of a degree of 200 LAPACK is off by 17 %."""
    rng = np.random.default_rng(degree)
    sizes = rng.uniform(0.9, 1.0, (5, degree // 2)) * rng.uniform(0.5, 1.2, (5, 1))
    angles = (np.arange(degree // 2) + 0.5) * 2.0 * np.pi / degree
    pairs = sizes * np.exp(1j * angles)
    roots = np.concatenate([pairs, pairs.conj(), np.zeros((5, degree % 2))], axis=1)
    falling = np.array([np.poly(rng.permutation(own)).real for own in roots])
    assert _largest_moduli(falling) == pytest.approx(sizes.max(axis=1), rel=1e-6)


def multiple_root(plant: Plant, near: jaxstab.results.OptimalGains, angle: float) -> list[mpf]:
    """alpha, beta and the radius of the triple real root or the double pair, to 40 digits."""
    with mp.workdps(60):
        base, stiff, damp = exact_family(plant)

        def equations(alpha: mpf, beta: mpf, *parts: mpf) -> list[mpf]:
            slopes = [list(base + alpha * stiff + beta * damp)]
            for _ in range(2):
                powers = range(len(slopes[-1]) - 1, 0, -1)
                slopes.append([c * k for c, k in zip(slopes[-1][:-1], powers, strict=True)])
            if len(parts) == 1:
                return [truth.evaluate(slope, parts[0]) for slope in slopes]
            values = [truth.evaluate(slope, mp.mpc(*parts)) for slope in slopes[:2]]
            return [value.real for value in values] + [value.imag for value in values]

        radius = float(near.value)
        parts = [radius] if angle == 0 else [radius * math.cos(angle), radius * math.sin(angle)]
        start = [float(near.alpha), float(near.beta), *parts]
        solution = mp.findroot(equations, start, tol=mpf(10) ** -80, maxsteps=50)
        return [solution[0], solution[1], mp.norm(solution[2:])]


TRIPLE_ROOTS = [(0.0, 0.0, 0.0), (1e-3, 0.015, 1.0), (0.1, 1.0, 0.5), (0.0, 0.3, 2.3)]
DOUBLE_PAIRS = [((1.0, 0.0, 1.0), 0.94862), ((5.0, 0.3, 0.5), 2.11121)]


@partial(jax.jit, static_argnums=2)
def slopes_in_gamma(gamma: jax.Array, delta: jax.Array, delay: float) -> tuple[jax.Array, ...]:
    """The derivatives of the smallest radius and of its gains: compiled once for each delay."""
    return jax.jacfwd(lambda g: jaxstab.minimize_radius(gamma=g, delta=delta, delay=delay)[:3])(
        gamma
    )


class TestMinimizeRadius:
    @pytest.mark.parametrize("delay", range(6))
    def test_of_the_undamped_mass_is_the_known_one(self, delay: int) -> None:
        best = jaxstab.minimize_radius(gamma=0.0, delta=0.0, delay=delay)
        assert float(best.value) == pytest.approx(LEAST_RADII[delay], abs=5e-7)
        assert int(best.status) == TuningStatus.TRIPLE_ROOT

    def test_of_the_undamped_mass_without_delay_is_a_closed_form(self) -> None:
        best = jaxstab.minimize_radius(gamma=0.0, delta=0.0, delay=0)
        root = 4 ** (1 / 3) - 1
        assert float(best.value) == pytest.approx(root, rel=1e-14)
        assert float(best.alpha) == pytest.approx(6 * root**2 - 2, rel=1e-13)
        assert float(best.beta) == pytest.approx(2 * root**3, rel=1e-14)

    @pytest.mark.parametrize(
        ("plant", "angle"), [(plant, 0.0) for plant in TRIPLE_ROOTS] + DOUBLE_PAIRS
    )
    def test_is_the_multiple_root_to_full_precision(self, plant: Plant, angle: float) -> None:
        best = jaxstab.minimize_radius(**by_name(*plant))
        kind = TuningStatus.TRIPLE_ROOT if angle == 0 else TuningStatus.DOUBLE_PAIR
        assert int(best.status) == kind
        for mine, exact in zip(best[:3], multiple_root(plant, best, angle), strict=True):
            assert float(mine) == pytest.approx(float(exact), rel=1e-12)

    @pytest.mark.parametrize(
        "plant", [*TRIPLE_ROOTS, *(p for p, _ in DOUBLE_PAIRS), (10.601024803602744, 0.0, 0.5)]
    )
    def test_is_not_beaten_by_brute_force(self, plant: Plant, rng: np.random.Generator) -> None:
        best = jaxstab.minimize_radius(**by_name(*plant))
        alpha, beta, value = (float(x) for x in best[:3])
        span = np.linspace(-1.5, 1.5, 120) * max(abs(alpha), abs(beta))
        grid = radii(plant, alpha + span[:, None], beta + span)
        near = rng.normal(size=(2, 8000)) * np.geomspace(1e-7, 1e-1, 8000)
        assert min(grid.min(), radii(plant, alpha + near[0], beta + near[1]).min()) >= value - 1e-9
        assert float(radii(plant, alpha, beta)) == pytest.approx(value, abs=1e-4)

    def test_says_where_it_only_knows_a_scan(self) -> None:
        """Beyond the Nyquist frequency a double and a simple real pole can face each other."""
        plant = (10.601024803602744, 0.0, 0.5)
        best = jaxstab.minimize_radius(**by_name(*plant))
        assert int(best.status) == TuningStatus.SCANNED
        assert "found by a search" in TuningStatus(int(best.status)).words

    @pytest.mark.campaign
    def test_what_a_scan_found_has_no_slopes(self) -> None:
        plant = (10.601024803602744, 0.0, 0.5)
        slopes = jax.jacfwd(lambda g: jaxstab.minimize_radius(**by_name(g, *plant[1:]))[:3])(
            plant[0]
        )
        assert all(math.isnan(slope) for slope in slopes)

    def test_at_half_the_sampling_rate_no_gains_are_stable(self) -> None:
        """gamma = pi^2, delta = 0: a pole at z = -1 for every delay (sec. VIII of the paper)."""
        best = jaxstab.minimize_radius(gamma=math.pi**2, delta=0.0, delay=1.0)
        assert int(best.status) == TuningStatus.NO_STABLE_GAINS
        assert float(best.value) == pytest.approx(1.0, abs=1e-5)

    @pytest.mark.parametrize(
        "plant",
        [
            (10.066923895620718, 0.005884497685831669, 0.5),  # all stable gains near theta = pi
            (39.81098965769077, 0.003624424766600166, 6.503942924075369),  # N(1) is all but 0
            (39.4728614848101, 0.0, 6.012824175776159),
        ],
    )
    def test_finds_stable_gains_where_a_region_has_an_area(self, plant: Plant) -> None:
        assert float(jaxstab.stable_region(**by_name(*plant)).area) > 10
        best = jaxstab.minimize_radius(**by_name(*plant))
        alpha, beta, value = (float(x) for x in best[:3])
        assert int(best.status) == TuningStatus.SCANNED
        assert value < 0.998
        assert truth.spectral_radius(alpha, beta, *plant)[1] < value + 1e-6
        assert jaxstab.stable_region(**by_name(*plant), radius=value * 0.999).is_empty

    def test_of_random_plants_is_reached_and_no_region_is_left_below(
        self, rng: np.random.Generator
    ) -> None:
        """With damping the loop without a wall is stable, so there are always stable gains."""
        for _ in range(12):
            gamma = rng.choice([0.0, 10 ** rng.uniform(-5, 0), 10 ** rng.uniform(0, 2)])
            plant = gamma, 10 ** rng.uniform(-4, 0.5), rng.choice([0.0, 2.0, rng.uniform(0, 8)])
            best = jaxstab.minimize_radius(**by_name(*plant))
            assert int(best.status) != TuningStatus.NO_STABLE_GAINS
            value = float(best.value)
            reached = truth.spectral_radius(float(best.alpha), float(best.beta), *plant)[1]
            assert float(reached) == pytest.approx(value, rel=1e-3)
            assert jaxstab.stable_region(**by_name(*plant), radius=value * 0.999).is_empty

    @pytest.mark.campaign
    def test_of_jax_arrays_is_that_of_numpy_also_when_compiled(self) -> None:
        gammas = np.array([1e-3, 1.0, 10.601024803602744])
        plain = jaxstab.minimize_radius(gamma=gammas, delta=0.0, delay=0.5)
        compiled = jax.jit(lambda g: jaxstab.minimize_radius(gamma=g, delta=0.0, delay=0.5))(gammas)
        assert all(isinstance(field, np.ndarray) for field in plain)
        for mine, other in zip(plain, compiled, strict=True):
            np.testing.assert_allclose(mine, other, rtol=1e-12)

    def test_broadcasts_over_plants(self) -> None:
        gammas, deltas = np.array([[0.0], [1e-3], [1.0]]), np.array([0.0, 0.1])
        best = jaxstab.minimize_radius(gamma=gammas, delta=deltas, delay=1.0)
        assert best.value.shape == best.status.shape == (3, 2)
        assert set(np.unique(best.status)) == {TuningStatus.TRIPLE_ROOT, TuningStatus.DOUBLE_PAIR}
        assert float(best.value[0, 0]) == pytest.approx(LEAST_RADII[1], abs=5e-7)

    @pytest.mark.campaign
    @pytest.mark.parametrize(
        ("plant", "angle"),
        [
            DOUBLE_PAIRS[1],
            (TRIPLE_ROOTS[2], 0.0),
            (TRIPLE_ROOTS[1], 0.0),
            DOUBLE_PAIRS[0],
        ],
    )
    def test_derivative_is_the_motion_of_the_multiple_root(
        self, plant: Plant, angle: float
    ) -> None:
        gamma, delta, delay = plant
        slopes = slopes_in_gamma(gamma, delta, delay)
        step = mpf(10) ** -8
        best = jaxstab.minimize_radius(**by_name(*plant))
        below, above = (
            multiple_root((mpf(gamma) + sign * step, delta, delay), best, angle) for sign in (-1, 1)
        )
        for slope, low, high in zip(slopes, below, above, strict=True):
            assert float(slope) == pytest.approx(float((high - low) / (2 * step)), rel=1e-9)

    @pytest.mark.campaign
    @pytest.mark.parametrize("plant", [TRIPLE_ROOTS[1], DOUBLE_PAIRS[0][0]])
    def test_derivative_is_the_same_backwards(self, plant: Plant) -> None:
        smallest = lambda gamma: jaxstab.minimize_radius(**by_name(gamma, *plant[1:])).value  # noqa: E731
        backwards, forwards = jax.grad(smallest)(plant[0]), jax.jacfwd(smallest)(plant[0])
        assert float(backwards) == pytest.approx(float(forwards), rel=1e-12)

    @pytest.mark.campaign
    def test_derivative_can_be_taken_backwards(self) -> None:
        """It is traced, and not compiled, which takes long."""
        smallest = lambda gamma: jaxstab.minimize_radius(gamma=gamma, delta=0.1, delay=1.0).value  # noqa: E731
        assert jax.make_jaxpr(jax.grad(smallest))(1e-3).out_avals[0].shape == ()

    def test_needs_less_than_half_of_the_largest_stable_stiffness(self) -> None:
        for delay, largest in enumerate(LARGEST_ALPHAS):
            assert (
                0
                < float(jaxstab.minimize_radius(gamma=0.0, delta=0.0, delay=delay).alpha)
                < largest / 2
            )

    def test_refuses_an_array_of_delays(self) -> None:
        with pytest.raises((ValueError, TypeError), match="delay"):
            jaxstab.minimize_radius(gamma=0.0, delta=0.0, delay=np.array([0.0, 1.0]))


class TestMinimizeRadiusDamping:
    @pytest.mark.parametrize(
        ("alpha", "plant"),
        [(0.1, (0.0, 0.0, 0.0)), (0.02, (1e-3, 0.015, 1.5)), (0.0, (1.0, 0.0, 1.0))],
    )
    def test_is_the_minimum_over_beta(self, alpha: float, plant: Plant) -> None:
        best = jaxstab.minimize_radius(alpha=alpha, **by_name(*plant))
        betas = np.linspace(-1.0, 2.0, 30_001)
        values = radii(plant, np.array(alpha), betas)
        middle = values.argmin()
        refined = scipy.optimize.minimize_scalar(
            lambda beta: radii(plant, np.array(alpha), np.array(beta)),
            bounds=(betas[middle - 1], betas[middle + 1]),
            method="bounded",
            options={"xatol": 1e-12},
        )
        assert float(best.value) <= refined.fun + 1e-6
        assert float(best.beta) == pytest.approx(refined.x, abs=1e-6)

    def test_is_that_of_each_plant_of_an_array(self) -> None:
        best = jaxstab.minimize_radius(alpha=0.05, gamma=0.0, delta=[0.0, 0.015], delay=1.0)
        for k, delta in enumerate((0.0, 0.015)):
            alone = jaxstab.minimize_radius(alpha=0.05, gamma=0.0, delta=delta, delay=1.0)
            assert (best.alpha[k], best.beta[k], best.value[k]) == alone[:3]

    def test_of_a_wall_that_is_too_stiff_says_so(self) -> None:
        best = jaxstab.minimize_radius(alpha=0.8, gamma=0.0, delta=0.0, delay=0.0)
        assert int(best.status) == TuningStatus.NO_STABLE_GAINS
        assert float(best.value) > 1


def settled_mass(
    alpha: np.ndarray,
    beta: np.ndarray,
    delay: int,
    length: int,
    hand: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """2 % settling of a pushed mass, held by a hand (gamma, delta), after ``length`` samples."""
    alpha, beta = np.broadcast_arrays(alpha, beta)
    rates = np.zeros((3, 3))
    rates[0, 1], rates[1] = 1.0, [-hand[0], -hand[1], 1.0]
    (xx, xv, xf), (vx, vv, vf), _ = scipy.linalg.expm(rates)
    x, v = -np.ones(alpha.shape), np.zeros(alpha.shape)
    previous, waiting, first = x, [alpha] * delay, np.zeros(alpha.shape)
    for sample in range(length):
        first = np.where(np.abs(x) <= 0.02, first, sample + 1)
        waiting = [*waiting, -(alpha * x + beta * (x - previous))]
        force = waiting.pop(0)
        x, v, previous = xx * x + xv * v + xf * force, vx * x + vv * v + vf * force, x
    return first


@pytest.fixture(scope="module")
def best() -> list[jaxstab.results.OptimalGains]:
    """The gains of least settling for the undamped mass, by delay."""
    return [jaxstab.minimize_settling(gamma=0.0, delta=0.0, delay=delay) for delay in range(4)]


class TestMinimizeSettling:
    @pytest.mark.campaign
    def test_grows_by_about_5_samples_per_sample_of_delay(
        self, best: list[jaxstab.results.OptimalGains]
    ) -> None:
        samples = [float(gains.value) for gains in best]
        assert all(4 <= b - a <= 6 for a, b in itertools.pairwise(samples))
        assert (samples[-1] - samples[0]) / 3 == pytest.approx(5, abs=0.5)

    def test_needs_less_than_half_of_the_largest_stable_stiffness(
        self, best: list[jaxstab.results.OptimalGains]
    ) -> None:
        for gains, largest in zip(best, LARGEST_ALPHAS, strict=True):
            assert 0 < float(gains.alpha) < largest / 2

    def test_is_reached_and_not_beaten_by_brute_force(
        self, best: list[jaxstab.results.OptimalGains]
    ) -> None:
        for delay, gains in enumerate(best):
            alpha, beta, samples = (np.asarray(x) for x in gains[:3])
            assert settled_mass(alpha, beta, delay, 400) == samples
            alphas = np.linspace(0, LARGEST_ALPHAS[delay], 300)[:, None]
            betas = np.linspace(0, 2 / (1 + delay), 300)
            assert settled_mass(alphas, betas, delay, 120).min() >= samples

    def test_with_a_given_stiffness_is_not_beaten_by_brute_force(self) -> None:
        gains = jaxstab.minimize_settling(gamma=0.0, delta=0.0, delay=0, alpha=0.3)
        brute = settled_mass(np.array(0.3), np.linspace(0.0, 2.0, 20_001), 0, 400)
        assert float(gains.alpha) == 0.3
        assert float(gains.value) == brute.min()

    def test_of_an_impact_is_slower_than_of_a_push(
        self, best: list[jaxstab.results.OptimalGains]
    ) -> None:
        gains = jaxstab.minimize_settling(gamma=0.0, delta=0.0, delay=1, excitation="impact")
        proved = jaxstab.settling_samples(
            *gains[:2], gamma=0.0, delta=0.0, delay=1, excitation="impact"
        )
        assert float(best[1].value) < float(gains.value) == float(proved.value)

    def test_without_stable_gains_is_infinite(self) -> None:
        gains = jaxstab.minimize_settling(gamma=0.0, delta=0.0, delay=0, alpha=0.8)
        assert math.isinf(gains.value)
        assert int(gains.status) == TuningStatus.NO_STABLE_GAINS

    def test_refuses_several_plants(self) -> None:
        with pytest.raises((ValueError, TypeError), match="gamma"):
            jaxstab.minimize_settling(gamma=np.array([0.0, 0.1]), delta=0.0, delay=0)


class TestOptimalGains:
    def test_for_the_radius_are_those_of_the_dimensionless_loop(self) -> None:
        wall = HELD.tune("radius")
        best = jaxstab.minimize_radius(gamma=HELD.gamma, delta=HELD.delta, delay=1.75)
        assert HELD.alpha(wall.stiffness) == pytest.approx(float(best.alpha), rel=1e-14)
        assert HELD.beta(wall.damping) == pytest.approx(float(best.beta), rel=1e-14)
        assert wall.radius == pytest.approx(float(best.value), abs=1e-4)
        assert wall.status == TuningStatus.TRIPLE_ROOT

    def test_for_settling_beat_those_for_the_radius(self) -> None:
        quick, damped = (PHANTOM.tune(goal) for goal in ("settling", "radius"))
        assert quick.settling_time < damped.settling_time
        assert quick.radius > damped.radius
        response = PHANTOM.simulate(
            quick.stiffness, quick.damping, samples=100, force=quick.stiffness
        )
        outside = np.abs(np.asarray(response.position) - 1) > 0.02
        assert np.flatnonzero(outside)[-1] + 1 == round(quick.settling_time / PHANTOM.sample_time)

    def test_keep_a_given_stiffness(self) -> None:
        for goal in ("radius", "settling"):
            for stiffness in (1e3, 5e3):
                wall = PHANTOM.tune(goal, stiffness=stiffness)
                assert wall.stiffness == stiffness
                assert wall.radius < 1

    def test_have_the_radius_that_they_are_given_with(self) -> None:
        for goal in ("radius", "settling"):
            wall = PHANTOM.tune(goal)
            with mp.workdps(60):
                period, mass = mpf(PHANTOM.sample_time), mpf(PHANTOM.device_mass)
                alpha = mpf(wall.stiffness) * period**2 / mass
                beta, delta = (
                    mpf(drag) * period / mass for drag in (wall.damping, PHANTOM.device_damping)
                )
                low, high = truth.spectral_radius(alpha, beta, 0.0, delta, 0.0)
                assert low - wall.radius_error <= wall.radius <= high + wall.radius_error
            assert wall.radius_error < 1e-15

    def test_of_six_digits_miss_the_smallest_radius_by_far(self) -> None:
        """As the docstring says: the sixth digit of a gain is worth 0.004 of the radius here."""
        wall = PHANTOM.tune("radius")
        gains = (float(f"{gain:.6g}") for gain in (wall.stiffness, wall.damping))
        alpha, beta = (
            scale(gain) for scale, gain in zip((PHANTOM.alpha, PHANTOM.beta), gains, strict=True)
        )
        low, _ = truth.spectral_radius(alpha, beta, PHANTOM.gamma, PHANTOM.delta, 0.0)
        assert wall.radius + 1e-3 < low < wall.radius + 1e-2

    @pytest.mark.parametrize(
        ("mechanics", "stiffness", "is_negative"),
        [
            ({"device_damping": 1.0, "hand_stiffness": 20000.0}, None, "alpha"),
            ({"device_damping": 1.0, "hand_stiffness": 5000.0, "hand_damping": 9.0}, None, "alpha"),
            ({"device_damping": 30.0}, 500.0, "beta"),
            ({"device_damping": 9.0, "hand_damping": 50.0, "hand_stiffness": 200.0}, 2e3, "beta"),
        ],
    )
    def test_are_those_of_a_wall(
        self, mechanics: dict[str, float], stiffness: float | None, is_negative: str
    ) -> None:
        """The paper's best gains are negative here; no wall of a fine grid beats these."""
        loop = jaxstab.HapticLoop(device_mass=0.1, sample_time=1e-3, delay=1e-3, **mechanics)
        alpha = None if stiffness is None else loop.alpha(stiffness)
        if alpha is None:
            free = jaxstab.minimize_radius(**loop.slice)
        else:
            free = jaxstab.minimize_radius(alpha=alpha, **loop.slice)
        assert getattr(free, is_negative) < 0.0
        calm, quick = (loop.tune(goal, stiffness=stiffness) for goal in ("radius", "settling"))
        limits = loop.limits()
        shares = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 80), np.linspace(0.01, 1.0, 80)])
        alphas = loop.alpha(limits.stiffness) * shares if alpha is None else np.array([alpha])
        betas = loop.beta(limits.damping) * shares
        plant = (loop.gamma, loop.delta, 1.0)
        grid = alphas[:, None], betas[None, :]
        assert float(free.value) < calm.radius <= radii(plant, *grid).min() + 1e-6
        samples = round(quick.settling_time / loop.sample_time)
        assert settled_mass(*grid, 1, samples + 40, plant[:2]).min() >= samples
        wall = np.array(loop.alpha(quick.stiffness)), np.array(loop.beta(quick.damping))
        assert settled_mass(*wall, 1, samples + 40, plant[:2]) == samples
        for gains in (calm, quick):
            assert gains.stiffness >= 0.0
            assert gains.damping >= 0.0
            assert stiffness is None or gains.stiffness == pytest.approx(stiffness, rel=1e-14)

    def test_of_several_loops_are_those_of_a_wall(self) -> None:
        """The only loop has its fastest wall at K = 0, where the hand's own spring is stiff."""
        stiff = jaxstab.HapticLoop(
            device_mass=0.1, device_damping=1.0, hand_stiffness=2e4, sample_time=1e-3, delay=1e-3
        )
        wall, own = jaxstab.tune_for_all([stiff]), stiff.tune()
        assert wall.stiffness >= 0.0
        assert wall.damping >= 0.0
        assert own.settling_time <= wall.settling_time <= own.settling_time + 1e-3

    def test_refuse_an_unknown_goal(self) -> None:
        with pytest.raises(ValueError, match="stiffness is -1"):
            PHANTOM.tune(stiffness=-1.0)
        with pytest.raises((ValueError, TypeError), match="goal"):
            PHANTOM.tune("beauty")
