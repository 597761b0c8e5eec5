"""The loop as mathematics: parameters, plant coefficients and p(z) against 50-digit truth."""

import csv
from operator import add, mul
from pathlib import Path

import flint
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from jax.test_util import check_grads
from mpmath import mp, mpf

import jaxstab
from jaxstab.model import DoubleDouble, by_name, polynomial_degree
from tests.truth import loop as truth

REFERENCE = Path(__file__).parents[2] / "data" / "reference"
FIELDS = jaxstab.results.PlantCoefficients._fields
SMALLEST_KEPT = 1e-300  # below, XLA flushes to zero
PI = np.pi


def ulps(values: jax.Array, exact: list[mpf]) -> float:
    pairs = zip(np.asarray(values).ravel().tolist(), exact, strict=True)
    return max(truth.ulps(value, x) for value, x in pairs if not 0 < abs(x) < SMALLEST_KEPT)


def assert_right(computed: jaxstab.results.PlantCoefficients, exact: list[truth.Plant]) -> None:
    """Every coefficient within 3 ulp, or within the last pair digits of the gain N(1).

    The second is needed where a coefficient vanishes for no reason of its own: N(-1) of a
    fractional delay at gamma = pi^2, n0 of an overdamped plant.
    """
    for name in truth.Plant._fields:
        for value, plant in zip(np.asarray(getattr(computed, name)).tolist(), exact, strict=True):
            right = getattr(plant, name)
            within_pair = abs(mpf(value) - right) <= 1e-31 * plant.sum
            assert within_pair or truth.ulps(value, right) <= 3.0, (name, value, right)


def hard_slices() -> list[tuple[float, float]]:
    """(gamma, delta) where eq. (9) is 0/0 or cancels, and places between."""
    gammas = [0.0, 1e-300, 1e-100, 1e-30, 1e-12, 1e-8, 1e-6, 1e-3, 0.1]
    gammas += [PI**2 / 16, PI**2 / 4, PI**2, PI**2 + 0.25, 4 * PI**2, 39.3, 40.0]
    deltas = [0.0, 1e-300, 1e-100, 1e-16, 1e-12, 1e-8, 1e-3, 0.015, 0.1, 1.0, 10.0]
    critical = [delta**2 / 4 for delta in deltas]
    beside = [np.nextafter(g, np.inf) for g in critical], [np.nextafter(g, 0) for g in critical]
    at_critical = [pair for g in (critical, *beside) for pair in zip(g, deltas, strict=True)]
    return [(float(g), d) for g in gammas for d in deltas] + [(float(g), d) for g, d in at_critical]


def sampled_mass(gamma: float, delta: float, period: float) -> tuple[np.ndarray, np.ndarray]:
    """scipy's zero-order hold of mass, spring and damper: state (position, velocity)."""
    dynamics = (np.array([[0.0, 1.0], [-gamma, -delta]]), np.array([[0.0], [1.0]]))
    output = (np.array([[1.0, 0.0]]), np.array([[0.0]]))
    a, b, *_ = scipy.signal.cont2discrete((*dynamics, *output), period)
    return a, b[:, 0]


def random_scenes(rng: np.random.Generator, count: int) -> list[tuple[float, ...]]:
    pick = rng.choice
    return [
        (
            float(pick([rng.normal(), 3 * rng.normal(), 0.0, 1e-8, 0.1])),
            float(pick([rng.normal(), 0.0, 1e-8, 0.3])),
            float(pick([0.0, 1e-12, 1e-3, rng.uniform(0, 40)])),
            float(pick([0.0, 1e-12, 1e-2, rng.uniform(0, 10)])),
        )
        for _ in range(count)
    ]


class TestHapticLoop:
    phantom = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)

    def test_normalises_as_table_1_says(self) -> None:
        loop = jaxstab.HapticLoop(
            device_mass=0.4,
            device_damping=0.5,
            hand_mass=0.1,
            hand_damping=1.5,
            hand_stiffness=200.0,
            sample_time=2e-3,
            delay=3e-3,
        )
        assert loop.mass == 0.5
        assert loop.gamma == pytest.approx(200.0 * 4e-6 / 0.5, rel=1e-15)
        assert loop.delta == pytest.approx(2.0 * 2e-3 / 0.5, rel=1e-15)
        assert loop.delay_samples == 1.5
        assert loop.alpha(1000.0) == pytest.approx(1000.0 * 4e-6 / 0.5, rel=1e-15)
        assert loop.beta(10.0) == pytest.approx(10.0 * 2e-3 / 0.5, rel=1e-15)

    def test_gains_go_to_si_units_and_back(self) -> None:
        loop = self.phantom
        assert loop.stiffness(loop.alpha(1234.0)) == pytest.approx(1234.0, rel=1e-15)
        assert loop.damping(loop.beta(5.5)) == pytest.approx(5.5, rel=1e-15)
        np.testing.assert_allclose(loop.alpha(np.array([1.0, 2.0])), [1e-5, 2e-5], rtol=1e-15)

    def test_nyquist_stiffness_of_remark_4(self) -> None:
        nyquist = PI**2 + self.phantom.delta**2 / 4  # eq. (27)
        assert self.phantom.stiffness(nyquist) == pytest.approx(987.0e3, rel=1e-4)

    @pytest.mark.parametrize(("delay", "samples"), [(3e-4, 3.0), (7e-4, 7.0), (2.5e-4, 2.5)])
    def test_a_delay_of_whole_periods_is_whole(self, delay: float, samples: float) -> None:
        # 3e-4 / 1e-4 is 2.9999999999999996 in float64
        loop = jaxstab.HapticLoop(
            device_mass=1.0, device_damping=0.0, sample_time=1e-4, delay=delay
        )
        assert loop.delay_samples == samples

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("device_mass", 0.0),
            ("device_mass", -1.0),
            ("device_mass", float("nan")),
            ("sample_time", 0.0),
            ("sample_time", float("inf")),
            ("delay", -1e-3),
            ("hand_stiffness", -1.0),
            ("device_damping", float("nan")),
        ],
    )
    def test_refuses_bad_values_by_name(self, name: str, value: float) -> None:
        good = {"device_mass": 0.1, "device_damping": 1.5, "sample_time": 1e-3}
        with pytest.raises(ValueError, match=rf"{name} is {value}"):
            jaxstab.HapticLoop(**good | {name: value})

    def test_refuses_strings(self) -> None:
        with pytest.raises(TypeError):
            jaxstab.HapticLoop(device_mass="0.1", device_damping=1.5, sample_time=1e-3)


class TestDoubleDouble:
    """Sums and products of pairs against exact rationals."""

    @staticmethod
    def exact(pair: DoubleDouble) -> list[flint.fmpq]:
        halves = (np.asarray(half).ravel().tolist() for half in (pair.hi, pair.lo))
        return [
            truth.as_fmpq(mpf(h)) + truth.as_fmpq(mpf(low)) for h, low in zip(*halves, strict=True)
        ]

    def test_operations_keep_31_digits(self, rng: np.random.Generator) -> None:
        def draw() -> DoubleDouble:
            hi = rng.normal(size=500) * 10.0 ** rng.integers(-8, 8, 500)
            return DoubleDouble(jnp.asarray(hi), jnp.asarray(hi * rng.uniform(-1, 1, 500) * 2**-54))

        @jax.jit
        def operations(a: DoubleDouble, b: DoubleDouble) -> tuple[DoubleDouble, ...]:
            return a + b, a - b, a * b, a / b, a * a, a + 1.0, DoubleDouble.from_value(1.0) + a

        a, b = draw(), draw()
        x, y = self.exact(a), self.exact(b)
        truths = [
            [p + q for p, q in zip(x, y, strict=True)],
            [p - q for p, q in zip(x, y, strict=True)],
            [p * q for p, q in zip(x, y, strict=True)],
            [p / q for p, q in zip(x, y, strict=True)],
            [p * p for p in x],
            [p + 1 for p in x],
            [p + 1 for p in x],
        ]
        for result, right in zip(operations(a, b), truths, strict=True):
            worst = max(abs(r / t - 1) for r, t in zip(self.exact(result), right, strict=True))
            assert worst < flint.fmpq(1, 2**100)

    def test_floats_have_the_bits_of_arrays(self, rng: np.random.Generator) -> None:
        hi = rng.normal(size=400) * 10.0 ** rng.integers(-150, 150, 400)
        hi[:3] = 0.0, -1.0, 1e-300
        lo = hi * rng.uniform(-1, 1, 400) * 2**-54
        arrays = DoubleDouble(hi[:200], lo[:200]), DoubleDouble(hi[200:], lo[200:])
        floats = [list(map(DoubleDouble, x.hi.tolist(), x.lo.tolist())) for x in arrays]
        for operation in (add, mul):
            for whole, others in ((arrays[1], floats[1]), (arrays[1].hi, arrays[1].hi.tolist())):
                together = operation(arrays[0], whole)
                alone = list(map(operation, floats[0], others))
                np.testing.assert_array_equal(together.hi, [one.hi for one in alone])
                np.testing.assert_array_equal(together.lo, [one.lo for one in alone])

    def test_a_product_of_tiny_numbers_is_rounded_not_flushed(self) -> None:
        product = DoubleDouble.from_value(jnp.asarray(0.3)) * jnp.asarray(1e-300)
        assert float(product.rounded()) == 0.3 * 1e-300


class TestPlantCoefficients:
    @pytest.mark.parametrize("fraction", [0.0, 1e-12, 0.25, 0.5, 1 - 1e-12])
    def test_have_the_last_digit_right(self, fraction: float) -> None:
        slices = hard_slices() if fraction == 0.0 else hard_slices()[::3]
        gamma, delta = np.array(slices).T
        computed = jaxstab.paper.plant_coefficients(gamma=gamma, delta=delta, delay=fraction)
        assert_right(computed, [truth.plant(g, d, fraction) for g, d in slices])

    def test_meet_the_reference_file(self) -> None:
        lines = (REFERENCE / "coefficients.tsv").read_text().splitlines()
        rows = list(csv.DictReader((x for x in lines if x[0] != "#"), delimiter="\t"))
        inputs = np.array([[float(r[k]) for k in ("gamma", "delta", "fraction")] for r in rows]).T
        computed = jaxstab.paper.plant_coefficients(**by_name(*inputs))
        exact = [truth.Plant(*(mpf(row[name]) for name in truth.Plant._fields)) for row in rows]
        assert_right(computed, exact)

    def test_at_rest_the_numerator_is_half_z_plus_1(self) -> None:
        plant = jaxstab.paper.plant_coefficients(gamma=0.0, delta=0.0)
        assert [float(x) for x in plant] == [-2.0, 1.0, 0.5, 0.5, 0.0, 1.0, 0.0, 0.0]

    def test_the_denominator_at_one_keeps_its_digits(self) -> None:
        gamma = np.array([1e-300, 1e-30, 1e-12, 1e-3, 1.0, 40.0])
        computed = jaxstab.paper.plant_coefficients(gamma=gamma, delta=0.015).den_at_one
        exact = [g * truth.plant(g, 0.015).sum for g in gamma.tolist()]
        assert ulps(computed, exact) <= 1.0

    @pytest.mark.campaign
    def test_far_outside_the_box_they_stay_right(self) -> None:
        slices = [(1e3, 0.0), (1e4, 1.0), (0.0, 1e3), (1e3, 1e3), (250000.0 / 25, 100.0)]
        gamma, delta = np.array(slices).T
        computed = jaxstab.paper.plant_coefficients(gamma=gamma, delta=delta)
        assert_right(computed, [truth.plant(g, d) for g, d in slices])

    @pytest.mark.parametrize(
        ("mode", "delay"),
        [
            pytest.param("forwards", 0.3, marks=pytest.mark.campaign),
            pytest.param("backwards", 0.0, marks=pytest.mark.campaign),
            pytest.param("forwards", 0.0, marks=pytest.mark.campaign),
            pytest.param("backwards", 0.3, marks=pytest.mark.campaign),
        ],
    )
    def test_derivatives_are_right_where_eq_9_has_none(self, mode: str, delay: float) -> None:
        slices = [(0.0, 0.0), (1e-300, 1e-300), (1e-12, 0.0), (0.25, 1.0), (0.0, 1.0)]
        slices += [(PI**2, 0.0), (1e-3, 0.015), (25.0, 10.0), (np.nextafter(0.25, 1), 1.0)]
        slopes = plant_slopes(mode, delay, *np.array(slices).T)
        for number, point in enumerate(slices):
            for variable in (0, 1):
                computed = slopes[variable, :7, number]
                exact = np.array(plant_derivatives(point, variable, delay), float)
                np.testing.assert_allclose(computed, exact, rtol=1e-13, atol=1e-16)

    def test_a_whole_delay_is_the_limit_of_fractional_ones(self) -> None:
        tiny = 2.0**-40
        whole = jaxstab.paper.plant_coefficients(gamma=2.0, delta=0.3, delay=1.0)
        above = jaxstab.paper.plant_coefficients(gamma=2.0, delta=0.3, delay=1.0 + tiny)
        below = jaxstab.paper.plant_coefficients(gamma=2.0, delta=0.3, delay=1.0 - tiny)
        numerator = lambda p: np.array([p.n2, p.n1, p.n0])  # noqa: E731
        np.testing.assert_allclose(numerator(above), numerator(whole), atol=4 * tiny)
        # just below, one sample less of delay makes up for one power of z
        np.testing.assert_allclose(numerator(below), [0.0, whole.n2, whole.n1], atol=4 * tiny)

    @pytest.mark.parametrize(("gamma", "delta"), [(0.0, 0.0), (2.0, 0.3), (9.0, 1.0)])
    def test_fraction_matches_a_finely_sampled_delay(self, gamma: float, delta: float) -> None:
        """scipy samples the plant 10 times a period; the input is held for 10 and 7 late."""
        fine, late = 10, 7
        a, b = sampled_mass(gamma, delta, 1.0 / fine)
        force, state, seen = (
            np.r_[np.zeros(late), np.ones(fine), np.zeros(60)],
            np.zeros(2),
            [],
        )
        for number, push in enumerate(force):
            if number % fine == 0:
                seen.append(state[0])
            state = a @ state + b * push
        plant = jaxstab.paper.plant_coefficients(gamma=gamma, delta=delta, delay=late / fine)
        numerator = [float(plant.n2), float(plant.n1), float(plant.n0)]
        impulse = np.zeros(len(seen))
        impulse[0] = 1.0
        denominator = [1.0, float(plant.d1), float(plant.d0)]
        response = scipy.signal.lfilter([0.0, *numerator], [*denominator, 0.0], impulse)
        np.testing.assert_allclose(response, seen, atol=1e-12)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ((-1.0, 0.0, 0.0), "gamma is -1.0"),
            ((0.0, -0.1, 0.0), "delta is -0.1"),
            ((float("nan"), 0.0, 0.0), "gamma is nan"),
            ((1e5, 0.0, 0.0), "gamma is 100000.0"),
            ((0.0, 0.0, -0.5), "delay is -0.5"),
            ((0.0, 0.0, float("inf")), "delay is inf"),
        ],
    )
    def test_refuses_bad_values_by_name(self, arguments: tuple[float, ...], message: str) -> None:
        with pytest.raises(ValueError, match=message):
            jaxstab.paper.plant_coefficients(**by_name(*arguments))

    def test_what_is_remembered_of_arrays_is_nobody_elses_to_change(self) -> None:
        gamma, delta = np.array([0.0, 0.3]), np.array([0.1, 0.2])
        first = jaxstab.paper.plant_coefficients(gamma=gamma, delta=delta, delay=0.4)
        kept = np.copy(first.n1)
        first.n1[:] = 7.0
        np.testing.assert_array_equal(
            jaxstab.paper.plant_coefficients(gamma=gamma, delta=delta, delay=0.4).n1, kept
        )
        gamma[1], alone = 2.0, jaxstab.paper.plant_coefficients(gamma=2.0, delta=0.2, delay=0.4)
        again = jaxstab.paper.plant_coefficients(gamma=gamma, delta=delta, delay=0.4)
        np.testing.assert_array_equal([part[1] for part in again], alone)

    def test_refuses_a_traced_delay(self) -> None:
        with pytest.raises(TypeError, match="delay is traced"):
            jax.jit(
                lambda delay: jaxstab.paper.plant_coefficients(gamma=0.0, delta=0.0, delay=delay)
            )(1.0)


def plant_slopes(mode: str, delay: float, gammas: np.ndarray, deltas: np.ndarray) -> np.ndarray:
    """The derivatives (gamma or delta, field, slice) of the plant's coefficients, by JAX."""

    def fields(gamma: jax.Array, delta: jax.Array) -> jax.Array:
        return jnp.stack(jaxstab.paper.plant_coefficients(gamma=gamma, delta=delta, delay=delay))

    @jax.jit
    def forwards(*plant: jax.Array) -> jax.Array:
        units = jnp.eye(2)[:, :, None] * jnp.ones_like(plant[0])
        return jax.vmap(lambda unit: jax.jvp(fields, plant, tuple(unit))[1])(units)

    @jax.jit
    def backwards(*plant: jax.Array) -> jax.Array:
        found, pull = jax.vjp(fields, *plant)
        units = jnp.eye(len(found))[:, :, None] * jnp.ones_like(plant[0])
        return jnp.stack(jax.vmap(pull)(units))

    return np.asarray({"forwards": forwards, "backwards": backwards}[mode](gammas, deltas))


def plant_derivatives(point: tuple[float, float], variable: int, fraction: float) -> list[mpf]:
    """The derivatives of the plant's coefficients by gamma (variable 0) or delta (1)."""

    def coefficients(value: mpf) -> truth.Plant:
        gamma, delta = (value if k == variable else mpf(x) for k, x in enumerate(point))
        return truth.sampled_plant(gamma, delta, mpf(fraction))

    with mp.workdps(100):
        return [mp.diff(lambda x, k=k: coefficients(x)[k], point[variable]) for k in range(7)]


class TestCharacteristicPolynomial:
    @pytest.mark.parametrize("delay", [0.0, 1.0, 2.0, 5.0, 0.25, 3.5, 1 - 1e-12, 1e-12])
    def test_has_the_last_digit_of_each_coefficient_right(
        self, delay: float, rng: np.random.Generator
    ) -> None:
        scenes = random_scenes(rng, 30)
        computed = jaxstab.characteristic_polynomial(**by_name(*np.array(scenes).T, delay))
        assert computed.shape == (30, 1 + truth.degree(delay))
        for row, scene in zip(computed, scenes, strict=True):
            assert ulps(row, truth.polynomial(*scene, delay)) <= 1.0, scene

    def test_keeps_the_digits_that_wall_and_plant_cancel(self) -> None:
        """alpha + beta such that the z^2 coefficient of d = 0 nearly vanishes."""
        gamma, delta = 1.3, 0.2
        plant = truth.plant(gamma, delta)
        alpha = float(-plant.d1 / plant.n2)
        computed = jaxstab.characteristic_polynomial(alpha, 0.0, gamma=gamma, delta=delta, delay=0)
        exact = truth.polynomial(alpha, 0.0, gamma, delta, 0)
        assert abs(exact[1]) < 1e-16
        assert ulps(computed, exact) <= 8.0

    def test_broadcasts(self) -> None:
        alpha, beta = np.linspace(0, 1, 3)[:, None], np.linspace(0, 1, 4)
        assert jaxstab.characteristic_polynomial(
            alpha, beta, gamma=0.0, delta=0.0, delay=2
        ).shape == (3, 4, 6)

    def test_pads_an_array_of_delays_with_powers_of_z(self) -> None:
        delays = [0.0, 1.0, 2.5]
        padded = jaxstab.characteristic_polynomial(
            0.1, 0.2, gamma=0.3, delta=0.4, delay=np.array(delays)
        )
        assert polynomial_degree(np.array(delays)) == 6
        for row, delay in zip(padded, delays, strict=True):
            alone = jaxstab.characteristic_polynomial(0.1, 0.2, gamma=0.3, delta=0.4, delay=delay)
            np.testing.assert_array_equal(row, np.pad(alone, (0, 7 - len(alone))))

    def test_is_continuous_in_the_delay(self) -> None:
        """Below a whole delay the polynomial has one root less at zero, all others agree."""
        below = jaxstab.characteristic_polynomial(0.1, 0.2, gamma=0.3, delta=0.4, delay=2 - 1e-13)
        whole = jaxstab.characteristic_polynomial(0.1, 0.2, gamma=0.3, delta=0.4, delay=2)
        above = jaxstab.characteristic_polynomial(0.1, 0.2, gamma=0.3, delta=0.4, delay=2 + 1e-13)
        np.testing.assert_allclose(below, whole, atol=1e-12)
        np.testing.assert_allclose(above, np.append(whole, 0.0), atol=1e-12)

    @pytest.mark.campaign
    @pytest.mark.parametrize("delay", [0, 1.6])
    def test_jit_and_vmap_work(self, delay: float) -> None:
        point = (0.1, 0.2, 0.3, 0.4)
        function = lambda a, b, g, d: jaxstab.characteristic_polynomial(  # noqa: E731
            a, b, gamma=g, delta=d, delay=delay
        )
        mapped = jax.jit(jax.vmap(function, in_axes=(0, None, None, None)))
        several = (jnp.array([0.1, 0.5]), *point[1:])
        np.testing.assert_allclose(mapped(*several)[0], function(*point), rtol=1e-15)

    @pytest.mark.campaign
    @pytest.mark.parametrize("delay", [0, 1.6])
    def test_is_differentiable(self, delay: float) -> None:
        function = lambda a, b, g, d: jaxstab.characteristic_polynomial(  # noqa: E731
            a, b, gamma=g, delta=d, delay=delay
        )
        mapped = jax.jit(jax.vmap(function, in_axes=(0, None, None, None)))
        several = (jnp.array([0.1, 0.5]), 0.2, 0.3, 0.4)
        check_grads(mapped, several, order=1, modes=["fwd"], rtol=1e-6, atol=1e-6)

    @pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e200])
    def test_refuses_gains_that_are_no_numbers(self, value: float) -> None:
        with pytest.raises(ValueError, match="alpha is"):
            jaxstab.characteristic_polynomial(value, 0.0, gamma=0.0, delta=0.0, delay=0)


class TestCompanionMatrix:
    def test_has_the_polynomial_for_characteristic_polynomial(self) -> None:
        roots = np.array([0.5, -0.25, 2.0])
        matrix = jaxstab.companion_matrix(np.poly(roots))
        np.testing.assert_allclose(np.sort(np.linalg.eigvals(matrix).real), np.sort(roots))

    def test_is_the_time_domain_of_the_loop(self) -> None:
        """Simulate mass, hold and delayed wall; the recurrence of p must reproduce the motion."""
        gamma, delta, alpha, beta, delay = 0.4, 0.2, 0.3, 0.25, 2
        a, b = sampled_mass(gamma, delta, 1.0)
        state, positions = np.array([1.0, -0.5]), []
        for k in range(30):
            positions.append(state[0])
            seen = positions[k - delay] if k >= delay else 0.0
            before = positions[k - delay - 1] if k > delay else 0.0
            state = a @ state - b * (alpha * seen + beta * (seen - before))
        p = np.asarray(
            jaxstab.characteristic_polynomial(alpha, beta, gamma=gamma, delta=delta, delay=delay)
        )
        # after the start-up every window of the motion satisfies p(shift) x = 0
        windows = np.lib.stride_tricks.sliding_window_view(positions, len(p))[:, ::-1]
        np.testing.assert_allclose(windows[delay + 1 :] @ p, 0.0, atol=1e-12)

    def test_refuses_a_constant(self) -> None:
        with pytest.raises(ValueError, match="at least two"):
            jaxstab.companion_matrix(np.array([1.0]))
        with pytest.raises(TypeError, match=r"coefficients is .*; give real numbers"):
            jaxstab.companion_matrix([[1.0], [1.0, 2.0]])
