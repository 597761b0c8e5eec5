"""Velocity estimators and position filters: transfer functions, and loops with them.

The truth: ``scipy.signal`` for filters, certified roots of a polynomial that python-flint makes of
the filters' difference equations, and a loop that is simulated sample by sample.
"""

from collections.abc import Callable
from dataclasses import fields
from inspect import isclass
from typing import Any

import flint
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from campaign import first, many

import benchmarks.loops
import jaxstab
from jaxstab import Filter, Velocity, Verdict
from jaxstab.atlas.spec import position_of, toml_of, velocity_of
from jaxstab.model import by_name, filters
from jaxstab.model.filters import Section, exact_chain, given_filters, rounded
from jaxstab.model.linear_loop import _values_at, filter_factors, filtered_loop
from jaxstab.point.schur_cohn import dense_codes, rounded_loop, without_zeros
from jaxstab.region.curve import curve_gains
from jaxstab.rounding import UNIT
from jaxstab.tables import parsed
from tests.truth import filtered as truth
from tests.truth.random_loops import DeviceLoop, Filters, MassLoop, hostile_walls

# Each estimator beside T V(z), each filter beside P(z), by the truth.
ESTIMATORS: dict[str, tuple[Velocity, truth.Rational]] = {
    "window 20": (Velocity.difference(samples=20), truth.difference(20)),
    "low pass": (
        Velocity.low_pass(0.05, order=2),
        truth.times(truth.difference(1), truth.low_pass(0.05, order=2)),
    ),
    "Butterworth": (
        Velocity.butterworth(0.1, order=5),
        truth.times(truth.difference(1), truth.butterworth(0.1, order=5)),
    ),
    "chain": (
        Velocity.difference(samples=3) * Filter.exponential(0.25) * Filter.average(samples=2),
        truth.times(truth.difference(3), truth.exponential(0.25), truth.average(2)),
    ),
    "Kalman": (  # the tracking index is 1: gains of position and velocity are 3/4 and 1/2
        Velocity.kalman(q=1.0, r=1.0),
        truth.rational(
            [flint.fmpq(1, 2), flint.fmpq(-1, 2), flint.fmpq(0)],
            [flint.fmpq(1), flint.fmpq(-3, 4), flint.fmpq(1, 4)],
        ),
    ),
    "Savitzky and Golay": (  # a parabola through three samples
        Velocity.savitzky_golay(3, order=2),
        truth.rational(
            [flint.fmpq(3, 2), flint.fmpq(-2), flint.fmpq(1, 2)],
            [flint.fmpq(1), flint.fmpq(0), flint.fmpq(0)],
        ),
    ),
    "transfer function": (
        Velocity.transfer_function([0.75, -0.5, -0.25], [1.0, -0.5, 0.0]),
        truth.rational(
            [flint.fmpq(3, 4), flint.fmpq(-1, 2), flint.fmpq(-1, 4)],
            [flint.fmpq(1), flint.fmpq(-1, 2), flint.fmpq(0)],
        ),
    ),
}
FILTERS: dict[str, tuple[Filter, truth.Rational]] = {
    "no filter": (Filter(), truth.average(1)),
    "low pass": (Filter.low_pass(0.2), truth.low_pass(0.2, order=1)),
}
PLANTS = [(0.0, 0.0, 1.0), (1e-3, 1e-2, 0.0), (1e-3, 1e-2, 2.5)]

# The largest alpha of the component that holds small gains, and its beta; gamma = delta = 0.
LARGEST = [
    (Velocity.difference(samples=2), 0.0, 6.0 - 4.0 * np.sqrt(2.0), 0.4852813742386),
    (Velocity.difference(samples=2), 1.0, 0.09788910377032, 0.3159942848707),
    (Velocity.difference(samples=2), 1.5, 0.06568923480709, 0.2697155418987),
    (Velocity.difference(samples=20), 1.0, 0.008041674306427, 0.05169812538961),
    (Velocity.difference(samples=20), 2.0, 0.005847257730416, 0.05135450537624),
    (Velocity.low_pass(0.1), 0.0, 0.2652125792438, 0.630408236116),
    (Velocity.low_pass(0.1), 1.0, 0.07279642895231, 0.2943419901774),
]
# Points of islands, beside the component that holds small gains: window, delay, alpha, beta.
ISLANDS = [
    (10, 0.0, 0.2734, -0.704),
    (20, 0.0, 0.0678, -0.316),
    (20, 0.0, 0.1151, 0.681),
    (20, 1.0, 0.0687, -0.381),
]


def frequency_response(filter_: Filter, frequency: float, sample_time: float) -> complex:
    back = np.exp(-2j * np.pi * frequency * sample_time)
    response = 1.0 + 0.0j
    for above, below in filter_.stages(sample_time):
        response *= np.polyval(above[::-1], back) / np.polyval(below[::-1], back)
    return complex(response)


@pytest.mark.parametrize("order", [1, 2, 5, 8])
def test_butterworth_is_that_of_scipy(order: int) -> None:
    sos = scipy.signal.butter(order, 80.0, fs=1000.0, output="sos")
    filter_ = Filter.butterworth(80.0, order=order)
    for frequency in (0.0, 3.0, 80.0, 333.0):
        _, (expected,) = scipy.signal.sosfreqz(sos, [frequency], fs=1000.0)
        np.testing.assert_allclose(frequency_response(filter_, frequency, 1e-3), expected, 1e-11)


@pytest.mark.parametrize(
    ("filter_", "above", "below"),
    [
        (Filter.average(samples=4), [0.25] * 4, [1.0]),
        (Filter.average(window=4e-3), [0.25] * 4, [1.0]),
        (Filter.exponential(0.3), [0.3], [1.0, -0.7]),
        (Filter.low_pass(50.0), [1.0 - np.exp(-0.1 * np.pi)], [1.0, -np.exp(-0.1 * np.pi)]),
        (Filter.transfer_function([2.0, 0.0, 1.0], [1.0, 0.5, 0.0]), [2.0, 0.0, 1.0], [1.0, 0.5]),
    ],
)
def test_filters_by_their_difference_equations(
    filter_: Filter, above: list[float], below: list[float]
) -> None:
    for frequency in (0.0, 30.0, 444.0):
        _, (expected,) = scipy.signal.freqz(above, below, [frequency], fs=1000.0)
        np.testing.assert_allclose(frequency_response(filter_, frequency, 1e-3), expected, 1e-13)


def velocity_response(velocity: Velocity, frequency: float, sample_time: float) -> complex:
    z = np.exp(2j * np.pi * frequency * sample_time)
    smoothing = frequency_response(velocity.filter, frequency, sample_time)
    return complex((1.0 - 1.0 / z) / sample_time * smoothing)


@pytest.mark.parametrize(
    ("q", "r", "period"), [(100.0, 1e-10, 1e-3), (1e-3, 1e-6, 1e-3), (1e6, 1e-12, 1e-4)]
)
def test_a_kalman_filter_has_the_gain_of_the_riccati_equation(
    q: float, r: float, period: float
) -> None:
    step, push = np.array([[1.0, period], [0.0, 1.0]]), np.array([[period**2 / 2.0], [period]])
    seen = np.array([[1.0, 0.0]])
    spread = scipy.linalg.solve_discrete_are(step.T, seen.T, q * push @ push.T, np.array([[r]]))
    gain = spread @ seen.T / (seen @ spread @ seen.T + r)
    follow = (np.eye(2) - gain @ seen) @ step
    for frequency in (0.1, 5.0, 300.0):
        z = np.exp(2j * np.pi * frequency * period)
        expected = (z * np.linalg.solve(z * np.eye(2) - follow, gain))[1, 0]
        answered = velocity_response(Velocity.kalman(q, r), frequency, period)
        np.testing.assert_allclose(answered, expected, 1e-8)  # the equation is solved to that


@pytest.mark.parametrize(("samples", "order"), [(2, 1), (5, 2), (9, 4), (20, 3)])
def test_slopes_of_polynomials_are_those_of_scipy(samples: int, order: int) -> None:
    weights = scipy.signal.savgol_coeffs(
        samples, order, deriv=1, delta=1e-3, pos=samples - 1, use="dot"
    )
    velocity = Velocity.savitzky_golay(samples, order=order)
    for frequency in (1.0, 50.0, 333.0):
        _, (expected,) = scipy.signal.freqz(weights[::-1], [1.0], [frequency], fs=1000.0)
        np.testing.assert_allclose(velocity_response(velocity, frequency, 1e-3), expected, 1e-10)
    t = -1e-3 * np.arange(samples)
    for power in range(order + 1):  # the slope of t^power at 0
        slope = np.dot(np.diff(t**power) / -1e-3, velocity.filter.sections[0].weights)
        assert slope == pytest.approx(float(power == 1), abs=1e-12)


@pytest.mark.parametrize(
    "filter_", [Filter.low_pass(1.0, order=3), Filter.butterworth(1.0, order=4)]
)
def test_the_gain_at_rest_is_one_although_the_cut_off_is_low(filter_: Filter) -> None:
    above, below = (sum(rounded(p)) for p in exact_chain(filter_.checked(1e-4).sections))
    assert above / below == pytest.approx(1.0, abs=1e-2)  # sums of float64; pairs know better
    factors, _ = filter_factors((Velocity(), filter_.checked(1e-4)))
    base, stiffness, _ = _values_at(1, factors)
    assert (stiffness / base).rounded() == pytest.approx(1.0, abs=1e-13)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("position", FILTERS)
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_verdicts_and_radii_against_certified_roots(
    estimator: str, position: str, plant: tuple[float, float, float]
) -> None:
    (velocity, v), (smoother, p) = ESTIMATORS[estimator], FILTERS[position]
    loop = truth.FilteredLoop(*plant, v, p)
    rng = np.random.default_rng(len(estimator) + int(10 * plant[2]))
    alpha, beta = rng.uniform(-0.01, 0.08, 6), rng.uniform(-0.1, 0.3, 6)
    filters: dict[str, Any] = {"velocity": velocity, "position": smoother}
    codes = jaxstab.verdict(alpha, beta, **by_name(*plant), **filters)
    assert codes.tolist() == [loop.code(*wall) for wall in zip(alpha, beta, strict=True)]
    radius = jaxstab.spectral_radius(alpha, beta, **by_name(*plant), **filters)
    assert np.all(radius.error < 1e-13)
    for wall, value, error in zip(zip(alpha, beta, strict=True), *radius[:2], strict=True):
        assert abs(loop.radius(*wall) - flint.arb(float(value))) <= float(error)


@pytest.mark.parametrize(("velocity", "delay", "alpha", "beta"), LARGEST)
def test_the_largest_stiffness_of_known_estimators(
    velocity: Velocity, delay: float, alpha: float, beta: float
) -> None:
    walls = alpha * np.array([1.0 - 1e-9, 1.0 + 1e-9])
    assert jaxstab.verdict(
        walls, beta, gamma=0.0, delta=0.0, delay=delay, velocity=velocity
    ).tolist() == [
        Verdict.STABLE,
        Verdict.UNSTABLE,
    ]
    around = beta * (1.0 + np.linspace(-1e-2, 1e-2, 21))
    codes = jaxstab.verdict(walls[1], around, gamma=0.0, delta=0.0, delay=delay, velocity=velocity)
    assert np.all(codes == Verdict.UNSTABLE)


@pytest.mark.parametrize(("samples", "delay", "alpha", "beta"), ISLANDS)
def test_islands_are_stable_and_cut_off_from_small_gains(
    samples: int, delay: float, alpha: float, beta: float
) -> None:
    window = Velocity.difference(samples=samples)
    shares = np.linspace(0.01, 1.0, 100)
    codes = jaxstab.verdict(
        alpha * shares, beta * shares, gamma=0.0, delta=0.0, delay=delay, velocity=window
    )
    assert codes[-1] == Verdict.STABLE
    assert Verdict.UNSTABLE in codes


def bisected(function: Callable[[float], int], low: float, high: float) -> float:
    """Where codes change from STABLE to another."""
    while high - low > 1e-15 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) == Verdict.STABLE else (low, middle)
    return low


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_only_walls_next_to_the_boundary_are_undecided(estimator: str) -> None:
    velocity, v = ESTIMATORS[estimator]
    plant = (1e-4, 2e-3, 1.0)
    beta = 0.04
    edge = bisected(
        lambda alpha: int(jaxstab.verdict(alpha, beta, **by_name(*plant), velocity=velocity)),
        0.0,
        1.0,
    )
    walls = edge * (1.0 + np.array([-1e-9, -1e-11, 1e-11, 1e-9]))
    codes = jaxstab.verdict(walls, beta, **by_name(*plant), velocity=velocity)
    loop = truth.FilteredLoop(*plant, v, truth.average(1))
    assert codes.tolist() == [loop.code(alpha, beta) for alpha in walls]
    assert Verdict.UNDECIDED not in codes


@pytest.mark.parametrize("kind", [MassLoop, DeviceLoop])
def test_hostile_walls_of_random_loops_against_balls(kind: type[MassLoop | DeviceLoop]) -> None:
    rng = np.random.default_rng(11)
    for _ in range(8):
        loop = kind.drawn(rng)
        walls = hostile_walls(rng, loop.balls, 30)
        for wall, code in zip(walls.tolist(), loop.verdict(*walls.T).tolist(), strict=True):
            is_stable = loop.balls.is_stable(*wall)
            if is_stable is not None and code != Verdict.UNDECIDED:
                assert is_stable == (code == Verdict.STABLE), (loop, wall)


@pytest.mark.parametrize(
    ("velocity", "transfer"),
    [
        (Velocity.difference(samples=20), truth.difference(20)),  # steps on both ends, unrolled
        (Velocity.difference(samples=40), truth.difference(40)),  # the same in a loop
        ESTIMATORS["Butterworth"],  # on all coefficients, unrolled
    ],
)
def test_compiled_verdicts_against_balls_however_close_to_the_boundary(
    velocity: Velocity, transfer: truth.Rational
) -> None:
    plant = (1e-3, 1e-2, 1.0)
    balls = truth.FilteredLoop(*plant, transfer, truth.average(1)).balls()
    walls = hostile_walls(np.random.default_rng(5), balls, 100)
    compiled = jax.jit(lambda *gains: jaxstab.verdict(*gains, **by_name(*plant), velocity=velocity))
    codes = np.asarray(compiled(*jnp.asarray(walls.T)))
    truths = np.array([balls.is_stable(*wall) for wall in walls.tolist()])
    is_decided = (codes != Verdict.UNDECIDED) & (truths != None)  # noqa: E711
    np.testing.assert_array_equal(codes[is_decided] == Verdict.STABLE, truths[is_decided])
    assert {Verdict.STABLE, Verdict.UNSTABLE} <= set(codes.tolist())


@pytest.mark.parametrize(("samples", "delay"), [(20, 1.0), (12, 2.5), (2, 12.0), (30, 0.0)])
def test_zeros_left_out_change_no_verdict(samples: int, delay: float) -> None:
    filters = given_filters(Velocity.difference(samples=samples), None)
    assert filters is not None
    loop = filtered_loop(1e-3, 1e-2, int(delay), delay % 1.0, filters)
    short = without_zeros(loop)
    assert len(short.base) < len(loop.base)
    alpha, beta = np.random.default_rng(3).normal(scale=0.1, size=(2, 500))
    codes = [
        dense_codes(alpha, beta, rounded_loop(one), unit=UNIT, degree=loop.degree)
        for one in (loop, short)
    ]
    np.testing.assert_array_equal(*codes)
    assert set(codes[0].tolist()) == {Verdict.STABLE, Verdict.UNSTABLE}


def test_a_window_of_one_sample_is_the_loop_of_the_paper() -> None:
    walls = np.linspace(-0.1, 0.8, 50)[:, None], np.linspace(-0.2, 2.0, 40)
    loop = by_name(*walls, 1e-3, 1e-2, 0.5)
    for function in (jaxstab.verdict, jaxstab.spectral_radius, jaxstab.closed_loop_poles):
        plain = function(**loop)
        window = function(**loop, velocity=Velocity.difference(samples=1))
        for one, other in zip(np.atleast_1d(plain), np.atleast_1d(window), strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("delays", [[0.0, 1.0, 2.5], [[0.5], [1.5]]])
def test_arrays_of_delays_answer_as_single_ones(delays: Any) -> None:
    velocity = Velocity.low_pass(0.1)
    delays = np.array(delays)
    alpha = np.array([0.02, 0.3, -0.1])
    together = jaxstab.verdict(alpha, 0.2, gamma=1e-3, delta=1e-2, delay=delays, velocity=velocity)
    radii = jaxstab.spectral_radius(
        alpha, 0.2, gamma=1e-3, delta=1e-2, delay=delays, velocity=velocity
    )
    grid = np.broadcast_arrays(alpha, delays)
    for index in np.ndindex(together.shape):
        one = grid[0][index], 0.2, 1e-3, 1e-2, grid[1][index]
        assert together[index] == jaxstab.verdict(**by_name(*one), velocity=velocity)
        alone = jaxstab.spectral_radius(**by_name(*one), velocity=velocity)
        assert abs(radii.value[index] - alone.value) <= radii.error[index] + alone.error


def simulated_growth(
    filter_: tuple[list[float], list[float]], alpha: float, beta: float, delay: int
) -> float:
    """Growth per sample of a mass with a wall, far from its start, by scipy alone."""
    transition = scipy.linalg.expm([[0.0, 1.0, 0.0], [-1e-3, -1e-2, 1.0], [0.0, 0.0, 0.0]])
    state, memory = np.array([1.0, 0.0]), np.zeros(max(map(len, filter_)) - 1)
    waiting, sizes = [0.0] * delay, []
    for _ in range(4000):
        velocity, memory = scipy.signal.lfilter(*filter_, [state[0]], zi=memory)
        waiting.append(-(alpha * state[0] + beta * velocity[0]))
        state = transition[:2, :2] @ state + transition[:2, 2] * waiting.pop(0)
        sizes.append(np.hypot(*state))
    return float((np.max(sizes[3000:]) / np.max(sizes[1000:2000])) ** (1.0 / 2000.0))


@pytest.mark.parametrize(
    ("velocity", "filter_"),
    [
        (Velocity.difference(samples=5), ([0.2, 0.0, 0.0, 0.0, 0.0, -0.2], [1.0])),
        (Velocity.exponential(0.2), ([0.2, -0.2], [1.0, -0.8])),
    ],
)
@pytest.mark.parametrize("alpha", [0.01, 0.05])
def test_radii_are_the_growth_of_a_simulated_loop(
    velocity: Velocity, filter_: tuple[list[float], list[float]], alpha: float
) -> None:
    growth = simulated_growth(filter_, alpha, 0.1, 1)
    radius = jaxstab.spectral_radius(
        alpha, 0.1, gamma=1e-3, delta=1e-2, delay=1.0, velocity=velocity
    )
    assert growth == pytest.approx(float(radius.value), abs=5e-4)


WALL, HAND, STEP = (0.02, 0.1), (1e-3, 1e-2, 1.0), 2.0**-40


def slope_of_true_radius(factor: float) -> float:
    """The slope of the radius in the factor of exponential smoothing, by balls of many digits."""
    low, high = (
        truth.FilteredLoop(
            *HAND, truth.times(truth.difference(1), truth.exponential(one)), truth.average(1)
        ).radius(*WALL)
        for one in (factor - STEP, factor + STEP)
    )
    return float((high - low) / (2.0 * STEP))


@pytest.mark.campaign
def test_the_derivative_in_a_factor_against_differences_of_balls() -> None:
    def radius(factor: float) -> Any:
        velocity = Velocity.exponential(factor)
        return jaxstab.spectral_radius(*WALL, **by_name(*HAND), velocity=velocity).value

    assert jax.grad(radius)(0.25) == pytest.approx(slope_of_true_radius(0.25), rel=1e-10)


@pytest.mark.campaign
@pytest.mark.parametrize("way", ["forwards", "backwards"])
def test_the_derivative_in_a_cut_off_against_differences_of_balls(way: str) -> None:
    def radius(cutoff: float) -> Any:
        return jaxstab.spectral_radius(
            *WALL, **by_name(*HAND), velocity=Velocity.low_pass(cutoff)
        ).value

    cutoff = -np.log(0.75) / (2.0 * np.pi)  # the same filter as by a factor of 0.25
    slope = slope_of_true_radius(0.25) * 2.0 * np.pi * 0.75  # d factor / d cutoff
    derivative = jax.jit(jax.jacfwd(radius) if way == "forwards" else jax.grad(radius))
    assert derivative(cutoff) == pytest.approx(slope, rel=1e-9)


def test_jax_arrays_and_transformations_answer_as_numpy_does() -> None:
    alpha = np.linspace(-0.01, 0.1, 7)
    rest: tuple[float, ...] = (0.05, 1e-3, 1e-2, 1.5)
    velocity, position = Velocity.difference(samples=4), Filter.low_pass(0.2)
    plain = jaxstab.verdict(**by_name(alpha, *rest), velocity=velocity, position=position)

    def code(alpha: Any) -> Any:
        return jaxstab.verdict(**by_name(alpha, *rest), velocity=velocity, position=position)

    given = code(jnp.asarray(alpha))
    assert isinstance(given, jax.Array)
    np.testing.assert_array_equal(given, plain)
    np.testing.assert_array_equal(jax.jit(jax.vmap(code))(jnp.asarray(alpha)), plain)


@pytest.mark.campaign
def test_grids_that_go_through_xla_answer_as_few_points_do() -> None:
    alpha, beta = np.linspace(-0.002, 0.01, 120)[:, None], np.linspace(-0.02, 0.1, 100)
    velocity = Velocity.difference(samples=20)
    many = jaxstab.verdict(alpha, beta, gamma=1e-6, delta=1e-4, delay=1.0, velocity=velocity)
    for row in (0, 30, 77):
        few = jaxstab.verdict(
            alpha[row], beta, gamma=1e-6, delta=1e-4, delay=1.0, velocity=velocity
        )
        np.testing.assert_array_equal(many[row], few)


def test_arrays_of_delays_refuse_traced_filters_in_one_sentence() -> None:
    def code(cutoff: Any) -> Any:
        return jaxstab.verdict(
            0.1, 0.1, gamma=0.0, delta=0.0, delay=[0.0, 1.0], velocity=Velocity.low_pass(cutoff)
        )

    with pytest.raises(TypeError, match="traced arguments with one delay"):
        jax.jit(code)(0.1)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Filter.average(), "samples or window"),
        (lambda: Filter.average(3, window=0.1), "samples or window"),
        (lambda: Filter.average(0), "samples is 0"),
        (lambda: Filter.low_pass(-1.0), "cutoff is -1.0"),
        (lambda: Filter.low_pass("10 Hz"), "cutoff is '10 Hz'"),
        (lambda: Filter.low_pass(1.0, order=0), "order is 0"),
        (lambda: Filter.low_pass(1e9).checked(1.0), "closer to 1 / period"),
        (
            lambda: Filter.butterworth(600.0, order=2).checked(1e-3),
            "below half of the sampling rate",
        ),
        (lambda: Filter.exponential(1.5), "factor is 1.5"),
        (lambda: Velocity.kalman(0.0, 1e-9), "q is 0"),
        (lambda: Velocity.kalman(1.0, float("inf")), "r is inf"),
        (lambda: Velocity.kalman(1e30, 1e-30).per_sample(1.0), "it leaves no filter in float64"),
        (lambda: Velocity.savitzky_golay(1, order=1), "samples is 1"),
        (lambda: Velocity.savitzky_golay(5, order=5), "order is 5"),
        (lambda: Filter.average(window=15.5e-3).checked(1e-3), r"0.015 s \(15 .* 0.016 s \(16"),
        (lambda: Filter.transfer_function([1.0, 2.0, 3.0], [1.0, 0.5]), "proper"),
        (lambda: Filter.transfer_function([1.0], [1.0, -1.0]), "inside the unit circle"),
        (lambda: Filter.transfer_function([0.0], [1.0, 0.5]), "not all of them 0"),
        (lambda: Filter.transfer_function([1.0], [float("nan")]), "denominator is nan"),
        (lambda: Filter.transfer_function([1.0], [1.0] + [0.0] * 41), "degree 41"),
        (
            lambda: (Filter.low_pass(0.1, order=40) * Filter.low_pass(0.1)).checked(),
            "order 41; give 40 poles",
        ),
        (lambda: Velocity.transfer_function([1.0, -0.9], [1.0, 0.0]), "0 at rest"),
        (lambda: Velocity.transfer_function([1.0], [1.0, 0.0]), "0 at rest"),
        (lambda: given_filters(20, None), "give a jaxstab.Velocity"),
        (lambda: given_filters(None, Velocity()), "give a jaxstab.Filter"),
    ],
)
def test_what_is_no_filter_is_refused_in_one_sentence(make: Callable[[], Any], words: str) -> None:
    with pytest.raises((ValueError, TypeError), match=words):
        make()


# ------------------------------------------------------------------------------------- regions

# The areas of the components, that of small gains first (from dense grids, to their digits).
COMPONENTS = [
    (Velocity.difference(samples=2), 0.0, [0.3015]),
    (Velocity.difference(samples=10), 0.0, [0.0104, 0.0208]),
    (Velocity.difference(samples=20), 0.0, [0.0018, 0.0083, 0.0015]),
    (Velocity.difference(samples=20), 1.0, [0.00099, 0.00042]),
]


@pytest.mark.parametrize(("velocity", "delay", "areas"), COMPONENTS)
def test_regions_have_their_islands(velocity: Velocity, delay: float, areas: list[float]) -> None:
    region = jaxstab.stable_region(gamma=0.0, delta=0.0, delay=delay, velocity=velocity)
    assert [float(one.area) for one in region.components] == pytest.approx(areas, rel=0.03)
    assert region.main is not None
    assert float(region.main.area) == float(region.components[0].area)
    assert len(region.islands) == len(areas) - 1
    assert sum(len(one.corners) for one in region.components) == len(region.corners)
    assert sum(len(one.points) for one in region.components) == len(region.points)
    for one in region.components:
        assert np.array_equal(one.points[0], one.points[-1])
        assert len(one.branch) == len(one.points) - 1
    assert float(region.area) == pytest.approx(sum(float(one.area) for one in region.components))


@pytest.mark.parametrize(("samples", "delay", "alpha", "beta"), ISLANDS)
def test_points_of_islands_are_in_one_island(
    samples: int, delay: float, alpha: float, beta: float
) -> None:
    velocity = Velocity.difference(samples=samples)
    region = jaxstab.stable_region(gamma=0.0, delta=0.0, delay=delay, velocity=velocity)
    assert region.contains(alpha, beta)
    assert [bool(island.contains(alpha, beta)) for island in region.islands].count(True) == 1
    assert region.main is not None
    assert not region.main.contains(alpha, beta)


@pytest.mark.parametrize(("velocity", "delay", "alpha", "beta"), LARGEST)
def test_the_main_component_has_the_known_largest_stiffness(
    velocity: Velocity, delay: float, alpha: float, beta: float
) -> None:
    region = jaxstab.stable_region(gamma=0.0, delta=0.0, delay=delay, velocity=velocity)
    assert region.main is not None
    np.testing.assert_allclose(region.main.max_alpha, [alpha, beta], rtol=1e-11)


@pytest.mark.parametrize(
    ("plant", "position"),
    [
        ((0.0, 0.0, 1.0), "no filter"),
        ((1e-3, 1e-2, 2.5), "low pass"),
        pytest.param((0.0, 0.0, 1.0), "low pass", marks=pytest.mark.campaign),
        pytest.param((1e-3, 1e-2, 2.5), "no filter", marks=pytest.mark.campaign),
    ],
)
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_regions_agree_with_certified_verdicts(
    estimator: str, position: str, plant: tuple[float, float, float]
) -> None:
    filters: dict[str, Any] = {
        "velocity": ESTIMATORS[estimator][0],
        "position": FILTERS[position][0],
    }
    region = jaxstab.stable_region(**by_name(*plant), **filters)
    assert region.status == jaxstab.results.RegionStatus.COMPLETE
    rng = np.random.default_rng(7)
    low, high = region.points.min(axis=0), region.points.max(axis=0)
    size = high - low
    edges = rng.integers(len(region.points), size=100)
    near = region.points[edges] + size * rng.normal(size=(100, 2)) * 10.0 ** rng.uniform(
        -6.0, -1.0, (100, 1)
    )
    far = 0.5 * (low + high) + size * rng.normal(size=(200, 2)) * 10.0 ** rng.uniform(
        -1.0, 2.0, (200, 1)
    )
    alpha, beta = np.concatenate([near, far]).T
    codes = jaxstab.verdict(alpha, beta, **by_name(*plant), **filters)
    inside = region.contains(alpha, beta)
    assert not np.any(inside & (codes == Verdict.UNSTABLE))
    assert not np.any(~inside & (codes == Verdict.STABLE))
    assert np.sum(codes == Verdict.UNDECIDED) == 0


@pytest.mark.parametrize("samples", [2, 4])
@pytest.mark.parametrize("plant", [(1e-3, 1e-2, 0.0), (1e-3, 1e-2, 0.5)])
def test_regions_where_the_position_filter_is_zero_at_the_nyquist_frequency(
    samples: int, plant: tuple[float, float, float]
) -> None:
    # The line of a real root at -1 is one of constant beta then.
    filters: dict[str, Any] = {"position": Filter.average(samples)}
    region = jaxstab.stable_region(**by_name(*plant), **filters)
    assert region.status == jaxstab.results.RegionStatus.COMPLETE
    rng = np.random.default_rng(1)
    alpha, beta = rng.uniform(-0.5, 2.0, 2000), rng.uniform(-1.0, 4.0, 2000)
    codes = jaxstab.verdict(alpha, beta, **by_name(*plant), **filters)
    np.testing.assert_array_equal(region.contains(alpha, beta), codes == Verdict.STABLE)
    assert Verdict.STABLE in codes


def test_corners_of_filtered_regions_have_roots_on_the_circle_and_none_outside() -> None:
    velocity, v = ESTIMATORS["window 20"]
    loop = truth.FilteredLoop(1e-3, 1e-2, 1.0, v, truth.average(1))
    corners = jaxstab.stable_region(gamma=1e-3, delta=1e-2, delay=1.0, velocity=velocity).corners
    for alpha, beta in corners:
        coefficients = [float(c.mid()) for c in loop.polynomial(float(alpha), float(beta))]
        moduli = np.abs(np.roots(coefficients))
        # Three, or two at z = 1, where the curve begins on the line of a real root.
        assert np.sum(np.abs(moduli - 1.0) < 1e-6) >= (2 if alpha < -1e-3 + 1e-9 else 3)
        assert np.max(moduli) < 1.0 + 1e-6


def test_a_window_of_one_sample_has_the_region_of_the_paper() -> None:
    plain = jaxstab.stable_region(gamma=1e-3, delta=1e-2, delay=0.5)
    window = jaxstab.stable_region(
        gamma=1e-3, delta=1e-2, delay=0.5, velocity=Velocity.difference(samples=1)
    )
    np.testing.assert_array_equal(plain.points, window.points)
    assert len(plain.components) == 1
    assert not plain.islands


@pytest.mark.campaign
def test_regions_of_filters_whose_poles_float64_does_not_tell_apart() -> None:
    velocity = Velocity.butterworth(0.02, order=8)
    region = jaxstab.stable_region(gamma=1e-3, delta=1e-2, delay=1.0, velocity=velocity)
    assert region.status == jaxstab.results.RegionStatus.COMPLETE
    rng = np.random.default_rng(8)
    vertices = region.points[rng.integers(0, len(region.points), 400)]
    away = np.repeat([[1e-4], [1e-1]], 200, axis=0) * np.ptp(region.points, axis=0)
    walls = (vertices + rng.normal(size=(400, 2)) * away).T
    codes = jaxstab.verdict(*walls, gamma=1e-3, delta=1e-2, delay=1.0, velocity=velocity)
    inside = region.contains(*walls)
    is_decided = codes != Verdict.UNDECIDED
    assert np.mean(is_decided) > 0.95
    assert np.array_equal(inside[is_decided], codes[is_decided] == Verdict.STABLE)


@pytest.mark.campaign
def test_a_hand_far_above_a_cut_off_has_a_region() -> None:
    # At its resonance the curve is a steep line, for 2e-8 of an angle.
    place = (0.5316505894594178, 8.394132253328545e-05, 2.0)
    velocity = Velocity.butterworth(0.017358, order=10)
    region = jaxstab.stable_region(**by_name(*place), velocity=velocity)
    assert region.status == jaxstab.results.RegionStatus.COMPLETE
    rng = np.random.default_rng(3)
    edges = rng.integers(len(region.points), size=400)
    away = rng.normal(size=(400, 2)) * 10.0 ** rng.uniform(-6.0, 0.0, (400, 1))
    walls = (region.points[edges] + np.ptp(region.points, axis=0) * away).T
    codes = jaxstab.verdict(*walls, **by_name(*place), velocity=velocity)
    inside = region.contains(*walls)
    assert not np.any(inside & (codes == Verdict.UNSTABLE))
    assert not np.any(~inside & (codes == Verdict.STABLE))
    assert np.sum(codes == Verdict.STABLE) > 50


def test_a_filter_whose_gain_is_lost_in_float64_has_no_region() -> None:
    velocity = Velocity.butterworth(0.005, order=20)
    with pytest.raises(ValueError, match="so slow that its gain or 1 - pole is lost"):
        jaxstab.stable_region(gamma=1e-3, delta=1e-2, delay=1.0, velocity=velocity)


def test_filters_whose_coefficients_are_beyond_float64_are_refused() -> None:
    gains = Filter.transfer_function([2.0], [1e-49])
    assert jaxstab.verdict(
        1e-100, 0.2, gamma=0.0, delta=0.015, delay=1.0, position=gains * gains
    ) == jaxstab.verdict(4e-2, 0.2, gamma=0.0, delta=0.015, delay=1.0)
    with pytest.raises(ValueError, match=r"transfer function .* beyond 1e\+150"):
        jaxstab.HapticLoop(
            device_mass=0.1,
            device_damping=0.1,
            sample_time=1e-3,
            position=gains * gains * gains * gains,
        )


@pytest.mark.parametrize("count", [3, pytest.param(many(300, 20), marks=pytest.mark.campaign)])
def test_regions_of_decay_rates_hold_the_walls_with_all_roots_in_the_circle(count: int) -> None:
    right = unresolved = 0
    for number in range(count):
        rng = np.random.default_rng([20121121, number])
        loop = MassLoop.drawn(rng)
        radius = float(rng.choice([rng.uniform(0.6, 1.0), 1.0 - 10.0 ** rng.uniform(-6, -1)]))
        named = {"velocity": loop.filters.velocity, "position": loop.filters.position}
        region = jaxstab.stable_region(**by_name(*loop.plant), **named, radius=radius)
        if region.status == jaxstab.results.RegionStatus.UNRESOLVED:
            unresolved += 1
            continue
        corners = region.points if len(region.points) else np.array([[0.0, 0.0], [0.1, 0.1]])
        size = np.ptp(corners, axis=0)
        anywhere = corners.min(axis=0) + size * rng.uniform(-0.2, 1.2, (6, 2))
        beside = corners[rng.integers(0, len(corners), 6)] + 1e-3 * size * rng.normal(size=(6, 2))
        for wall in np.concatenate([anywhere, beside]).tolist():
            expected = loop.balls.is_stable(*wall, radius)
            assert expected is None or expected == bool(region.contains(*wall)), (number, wall)
            right += expected is not None
    assert right > 11 * count
    assert unresolved <= count // 50


@pytest.mark.campaign
def test_a_region_that_proofs_contradict_claims_nothing() -> None:
    # The scan finds no piece of this one; most small gains are stable.
    velocity = Velocity.transfer_function([1.0, -1.1875, 0.1875], [1.0, 0.3125, -0.2578125, 0.0])
    filters = {"velocity": velocity, "position": Filter.butterworth(0.005355365513565198, order=7)}
    plant = 0.6185486656816983, 0.0, 1.3859936203430451e-09
    assert jaxstab.verdict(1.5e-5, 5.6e-6, **by_name(*plant), **filters) == Verdict.STABLE
    region = jaxstab.stable_region(**by_name(*plant), **filters)
    assert (
        region.contains(1.5e-5, 5.6e-6) or region.status == jaxstab.results.RegionStatus.UNRESOLVED
    )


@pytest.mark.parametrize("number", [7, 13, 30, 45, 72, 111])
def test_the_curve_of_plants_that_are_nearly_zero_at_the_nyquist_frequency(number: int) -> None:
    # W is up to 1e16 at z = -1, or V is: divided by z + 1 they took 8 to 16 digits.
    loop = MassLoop.drawn(np.random.default_rng([20121120, number]))
    angles = np.linspace(1.6, 3.1, 12)
    walls = curve_gains(loop.region().curve, angles).T
    truths = np.array([loop.balls.wall_with_roots_at(theta) for theta in angles.tolist()])
    size = np.max(np.abs(truths), axis=1, keepdims=True)
    assert np.max(np.abs(walls - truths) / size) < 1e-12


@pytest.mark.parametrize("samples", [3, 5])
def test_walls_of_the_line_of_a_real_root_at_minus_one_have_that_root(samples: int) -> None:
    window = Velocity.difference(samples)
    c = jaxstab.stable_region(**by_name(0.3, 0.1, 1.5), velocity=window).curve
    base, stiffness, damping = c.ends[1]
    for beta in (-0.2, 0.4):
        alpha = -(base + damping * beta) / stiffness
        poles = jaxstab.closed_loop_poles(alpha, beta, **by_name(0.3, 0.1, 1.5), velocity=window)
        assert np.min(np.abs(np.asarray(poles) + 1.0)) < 1e-12


@pytest.mark.parametrize("loop", [(MassLoop, 300), (MassLoop, 573), (DeviceLoop, 310)])
def test_regions_of_undamped_hands_and_devices(loop: tuple[Any, int]) -> None:
    kind, number = loop
    rng = np.random.default_rng([20121120, number])
    tally = benchmarks.loops.region(kind.drawn(rng), rng)
    assert tally.open == tally.wrong == 0


@pytest.mark.parametrize("number", [120, 367, 546, 771, 1231, 1497])
def test_regions_that_were_wrong_next_to_their_curve(number: int) -> None:
    rng = np.random.default_rng([20121120, number])
    tally = benchmarks.loops.region(MassLoop.drawn(rng), rng)
    assert tally.open == tally.wrong == 0


@pytest.mark.parametrize(
    ("window", "average", "delay", "gamma"),
    [
        *((window, 1, 1.0, 0.0) for window in (3, 6, 9, 12)),
        (1, 4, 0.0, 0.0),  # the line beta = 2 between two halves of the curve
        (1, 4, 0.0, 0.01),
        (1, 6, 0.5, 0.0),
        (1, 8, 1.0, 0.01),
        (3, 14, 3.0, 0.3),  # two such lines meet
        (11, 11, 2.0, 0.3),  # where P and V are zero there is none
        pytest.param(12, 7, 2.5, 0.3, marks=pytest.mark.campaign),
    ],
)
def test_lines_at_poles_of_the_curve_bound_regions(
    window: int, average: int, delay: float, gamma: float
) -> None:
    filters = Filters(
        Velocity.difference(samples=window),
        Filter.average(samples=average) if average > 1 else Filter(),
        (truth.difference(window), truth.average(average)),
    )
    loop = MassLoop((gamma, 0.0, delay), filters)
    tally = benchmarks.loops.region(loop, np.random.default_rng(window))
    assert tally.open == tally.wrong == tally.unjudged == 0


def test_a_line_at_a_pole_is_part_of_the_boundary() -> None:
    region = jaxstab.stable_region(
        gamma=0.0, delta=0.0, delay=0.0, position=Filter.average(samples=4)
    )
    assert region.max_alpha == pytest.approx([8.0 / 3.0, 2.0], rel=1e-12)
    on_line = np.abs(region.points[:, 1] - 2.0) < 1e-12
    assert np.ptp(region.points[on_line, 0]) == pytest.approx(8.0 / 3.0)
    for alpha in (0.1, 1.0, 2.6):
        assert region.contains(alpha, 2.0 - 1e-9)
        assert not region.contains(alpha, 2.0 + 1e-9)
        assert jaxstab.verdict(
            alpha,
            [2.0 - 1e-9, 2.0 + 1e-9],
            gamma=0.0,
            delta=0.0,
            delay=0.0,
            position=Filter.average(samples=4),
        ).tolist() == [Verdict.STABLE, Verdict.UNSTABLE]


@pytest.mark.parametrize("number", first([2516, 943, 1246], 1))
def test_a_curve_that_is_rounding_bounds_no_region(number: int) -> None:
    # Seven poles of a low pass within 0.02 of z = 1, of which float64 tells nothing.
    rng = np.random.default_rng([20121120, number])
    assert benchmarks.loops.region(MassLoop.drawn(rng), rng).wrong == 0


def test_audits_ask_no_wall_on_a_corner() -> None:
    # One edge of the outline joins two equal points, a corner; its wall is stable by a rounding.
    window = Filter.average(window=0.02) * Filter.exponential(0.15)
    loop = jaxstab.HapticLoop(
        sample_time=0.0005,
        device_mass=0.2,
        device_damping=0.1,
        hand_mass=0.0144069853970622,
        hand_damping=3.030643694449534,
        hand_stiffness=39.39331295976678,
        delay=0.0,
        velocity=Velocity(filter=window),
    )
    assert loop.region().status == jaxstab.results.RegionStatus.COMPLETE
    largest = loop.damping_limits(0.0)[1]
    assert loop.verdict(0.0, 0.99 * largest) == Verdict.STABLE
    assert loop.verdict(0.0, 1.01 * largest) == Verdict.UNSTABLE


def test_a_cut_off_may_be_an_array_of_jax() -> None:
    numbers = 0.01, 0.1, 0.0, 0.01, 1.0
    plain, of_jax = (Velocity.low_pass(cutoff) for cutoff in (0.05, jnp.asarray(0.05)))
    assert jaxstab.verdict(**by_name(*numbers), velocity=of_jax) == jaxstab.verdict(
        **by_name(*numbers), velocity=plain
    )
    one, other = (
        jaxstab.stable_region(**by_name(*numbers[2:]), velocity=velocity)
        for velocity in (of_jax, plain)
    )
    np.testing.assert_array_equal(one.points, other.points)


@pytest.mark.parametrize("count", [80, pytest.param(200, marks=pytest.mark.campaign)])
def test_long_windows_are_answered(count: int) -> None:
    """Truth: balls, a closed form."""
    place = 0.001, 0.0004, 1.0
    window = Velocity.difference(samples=count)
    region = jaxstab.stable_region(**by_name(*place), velocity=window)
    balls = truth.FilteredLoop(*place, truth.difference(count), truth.average(1)).balls()
    alpha, beta = map(float, region.main.max_alpha)
    for factor, code in ((1.0 - 1e-6, Verdict.STABLE), (1.0 + 1e-6, Verdict.UNSTABLE)):
        assert jaxstab.verdict(factor * alpha, beta, **by_name(*place), velocity=window) == code
        assert balls.is_stable(factor * alpha, beta) == (code == Verdict.STABLE)


KINDS = [kind for kind in vars(filters).values() if isclass(kind) and issubclass(kind, Section)]
OF_POSITIONS = [kind for kind in KINDS if kind not in (Section, filters.Measured)]


@pytest.mark.parametrize("kind", OF_POSITIONS)
def test_every_kind_of_section_has_makers_a_text_and_keys(kind: type[Section]) -> None:
    given = {
        "samples": 3, "window": None, "cutoff": 0.1, "order": 2, "factor": 0.5,
        "numerator": (0.5, -0.5), "denominator": (1.0, 0.25), "period": 1.0, "q": 2.0, "r": 0.5,
    }  # fmt: skip
    section = kind(**{field.name: given[field.name] for field in fields(kind)})
    assert "object at" not in str(section)
    assert section.maker is None or callable(getattr(Filter, section.maker))
    chain = Filter((section,))
    if section.estimator:
        velocity = Velocity(chain)
        assert callable(getattr(Velocity, section.estimator))
        assert eval(repr(velocity), {"Velocity": Velocity, "Filter": Filter}) == velocity
        assert velocity_of(parsed(f"velocity = {toml_of(velocity)}")["velocity"]) == velocity
    if kind is not filters.Differentiator:
        assert eval(repr(chain), {"Velocity": Velocity, "Filter": Filter}) == chain
    if section.maker is None:
        with pytest.raises(ValueError, match="give it as the first table of velocity"):
            position_of(parsed(f"position = {toml_of(chain)}")["position"])
    elif kind is not filters.Differentiator:
        assert position_of(parsed(f"position = {toml_of(chain)}")["position"]) == chain


def test_a_measured_velocity_is_no_filter_of_positions() -> None:
    velocity = Velocity.measured() * Filter.average(samples=2)
    assert str(velocity) == "the device's own velocity, a window of 2 samples"
    assert eval(repr(velocity), {"Velocity": Velocity, "Filter": Filter}) == velocity
    for call in (toml_of, Velocity.stages):
        with pytest.raises(ValueError, match="needs an estimator from positions"):
            call(velocity)
    with pytest.raises(ValueError, match="needs an estimator from positions"):
        jaxstab.HapticLoop(
            device_mass=1.0, device_damping=0.0, sample_time=1e-3, position=velocity.filter
        )
