"""The closed form of the boundary against 50-digit truth, its limits and its derivatives."""

from collections.abc import Callable
from functools import partial
from typing import Any

import flint
import jax
import numpy as np
import pytest
from campaign import many
from mpmath import mp, mpf

from jaxstab.exact.boundary import ScaledLoop
from jaxstab.model import LoopParameters, by_name
from jaxstab.paper import minus_line, plus_line
from jaxstab.region import boundary_curve
from jaxstab.region.closed_form import Responses, circle_equations, quick_plant
from jaxstab.region.curve import Curve, bracketed_root, curve_gains, curve_of, gains_and_slopes
from tests.truth import loop as truth
from tests.truth.balls import ExactPlant

ACCURACY = 1e-13
ROUNDING = 2.0**-52
ENDS = 1e-8

Slices = tuple[np.ndarray, np.ndarray, np.ndarray]


def random_angles(rng: np.random.Generator, count: int) -> np.ndarray:
    """Half of them uniform, half of them as close to one of the ends as 1e-8."""
    distance = np.where(
        rng.random(count) < 0.5, rng.uniform(0, np.pi, count), 10 ** rng.uniform(-8, 0, count)
    )
    theta = np.where(rng.random(count) < 0.5, distance, np.pi - distance)
    return np.clip(theta, ENDS, np.pi - ENDS)


def random_slices(rng: np.random.Generator, count: int) -> Slices:
    """Over the whole box and over all magnitudes, with each special case among them."""
    gamma = np.where(
        rng.random(count) < 0.5, rng.uniform(0, 40, count), 10 ** rng.uniform(-12, 1.6, count)
    )
    delta = np.where(
        rng.random(count) < 0.5, rng.uniform(0, 10, count), 10 ** rng.uniform(-12, 1, count)
    )
    delay = np.where(rng.random(count) < 0.5, rng.integers(0, 51, count), rng.uniform(0, 51, count))
    case = rng.integers(0, 8, count)
    gamma[case == 1], delta[case == 1] = 0.0, 0.0
    gamma[case == 2], delta[case == 2] = np.pi**2, 0.0
    critical = case == 3
    delta[critical] = np.minimum(2.0 * np.sqrt(gamma[critical]), 10.0)
    gamma[critical] = delta[critical] ** 2 / 4.0
    delta[case == 4] = 0.0
    return gamma, delta, delay


def worst_error(theta: Any, gamma: Any, delta: Any, delay: Any, radius: Any) -> float:
    """The largest error beside the distance from (-gamma, 0), beyond the rounding of alpha."""
    alpha, beta = boundary_curve(theta, gamma=gamma, delta=delta, delay=delay, radius=radius)
    worst = 0.0
    places = np.broadcast_arrays(theta, gamma, delta, delay, radius)
    for a, b, *place in zip(alpha, beta, *places, strict=True):
        exact_alpha, exact_beta = truth.boundary_point(*map(float, place))
        distance = mp.hypot(exact_alpha + mpf(float(place[1])), exact_beta)
        alpha_error = abs(mpf(float(a)) - exact_alpha) - ROUNDING * abs(exact_alpha)
        worst = max(worst, alpha_error / distance, abs(mpf(float(b)) - exact_beta) / distance)
    return float(worst)


def test_the_curve_is_within_1e_13_of_the_truth_over_the_whole_box(
    rng: np.random.Generator,
) -> None:
    slices = random_slices(rng, 150)
    assert worst_error(random_angles(rng, 150), *slices, np.ones(150)) < ACCURACY


def test_the_curve_of_a_decay_rate_is_within_1e_13_of_the_truth(rng: np.random.Generator) -> None:
    slices = random_slices(rng, 200)
    radius = np.where(
        rng.random(200) < 0.5, rng.uniform(0.05, 1, 200), 1 - 10 ** rng.uniform(-12, -1, 200)
    )
    assert worst_error(random_angles(rng, 200), *slices, radius) < ACCURACY


def test_without_hand_and_delay_the_curve_is_the_known_one() -> None:
    theta = np.linspace(1e-3, 3.0, 50)
    alpha, beta = boundary_curve(theta, gamma=0.0, delta=0.0, delay=0.0)
    np.testing.assert_allclose(alpha, 2 * beta * (2 - beta) / (beta + 2), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.5, 50.0])
def test_the_curve_starts_on_the_line_of_a_root_at_plus_one(delay: float) -> None:
    for radius in (1.0, 0.8):
        start = boundary_curve(0.0, gamma=0.3, delta=0.2, delay=delay, radius=radius)
        near = boundary_curve(1e-7, gamma=0.3, delta=0.2, delay=delay, radius=radius)
        np.testing.assert_allclose(start, near, rtol=1e-10)
        np.testing.assert_allclose(
            start[0],
            plus_line(start[1], gamma=0.3, delta=0.2, delay=delay, radius=radius),
            rtol=1e-14,
        )


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.5, 50.0])
def test_the_curve_ends_on_the_line_of_a_root_at_minus_one(delay: float) -> None:
    for radius in (1.0, 0.8):
        end = boundary_curve(np.pi, gamma=0.3, delta=0.2, delay=delay, radius=radius)
        near = boundary_curve(np.pi - 1e-7, gamma=0.3, delta=0.2, delay=delay, radius=radius)
        np.testing.assert_allclose(end, near, rtol=1e-9)
        np.testing.assert_allclose(
            end[0], minus_line(end[1], gamma=0.3, delta=0.2, delay=delay, radius=radius), rtol=1e-12
        )


@pytest.mark.parametrize("delay", [0.0, 3.0, 0.25, 7.75])
@pytest.mark.parametrize("radius", [1.0, 0.7])
def test_the_lines_put_a_real_root_at_plus_and_minus_the_radius(
    delay: float, radius: float
) -> None:
    gamma, delta, beta = 0.4, 0.3, 0.75
    for line, z in ((plus_line, radius), (minus_line, -radius)):
        alpha = float(line(beta, gamma=gamma, delta=delta, delay=delay, radius=radius))
        polynomial = truth.polynomial(alpha, beta, gamma, delta, delay)
        scale = sum(abs(c) for c in polynomial)
        assert abs(truth.evaluate(polynomial, mpf(z))) < 1e-14 * scale


def test_a_root_at_one_takes_alpha_to_minus_gamma_exactly() -> None:
    gamma = np.array([0.0, 1e-9, 0.3, np.pi**2, 40.0])
    np.testing.assert_array_equal(plus_line(0.7, gamma=gamma, delta=0.1, delay=2.0), -gamma)


def test_without_damping_and_with_a_whole_delay_the_line_of_minus_one_is_at_infinity() -> None:
    assert np.isinf(minus_line(0.5, gamma=0.3, delta=0.0, delay=1.0))
    assert np.isfinite(minus_line(0.5, gamma=0.3, delta=0.0, delay=1.5))


@partial(jax.jit, static_argnames="delay")
def slope_along(place: Any, way: Any, delay: float | None) -> Any:
    """The curve's slope in one direction: for all at once XLA compiles twice as long."""

    def curve(theta: Any, *slice_: Any) -> Any:
        return boundary_curve(theta, **by_name(*slice_, *([] if delay is None else [delay])))

    return jax.jvp(curve, place, way)[1]


def slopes_of(place: tuple[float, ...]) -> np.ndarray:
    """Slopes (argument, 2) in theta, gamma, delta, and in the delay where it is a fraction."""
    is_fraction = bool(place[3] % 1)
    free, delay = (place, None) if is_fraction else (place[:3], place[3])
    return np.array([slope_along(free, tuple(way), delay) for way in np.eye(len(free)).tolist()])


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("theta", "gamma", "delta", "delay"),
    [
        (2.5, 0.25, 1.0, 0.5),
        (3.1, 9.9, 0.1, 3.3),
        (0.7, 0.0, 0.0, 1.0),
        (1e-4, 1e-3, 0.015, 2.0),
    ],
)
def test_the_derivatives_are_those_of_the_truth(
    theta: float, gamma: float, delta: float, delay: float
) -> None:
    place = (theta, gamma, delta, delay)
    step = mpf(10) ** -20
    for argument, slopes in enumerate(slopes_of(place)):
        there = list(map(mpf, place))
        there[argument] += step
        for of_alpha_or_beta, slope in enumerate(slopes):
            ahead = truth.boundary_point(*there)[of_alpha_or_beta]
            exact = (ahead - truth.boundary_point(*place)[of_alpha_or_beta]) / step
            assert abs(mpf(float(slope)) - exact) < 1e-11 * (1 + abs(exact))


def curve_of_region(gamma: float, delta: float, delay: float, radius: float) -> Curve:
    hand = {"device_damping": delta, "hand_stiffness": gamma}
    loop = LoopParameters(device_mass=1.0, sample_time=1.0, delay=delay, **hand)
    return curve_of(ScaledLoop(loop, (1.0, 1.0), radius))


@np.errstate(divide="ignore")
def test_the_curve_of_regions_is_the_closed_form(rng: np.random.Generator) -> None:
    """Two ways to the same points: a closed form, and polynomials of any loop."""
    gamma, delta, delay = random_slices(rng, 40)
    radius = np.where(rng.random(40) < 0.5, 1.0, 1 - 10 ** rng.uniform(-6, -0.5, 40))
    for place in np.stack([gamma, delta, delay, radius], axis=-1).tolist():
        theta = random_angles(rng, 10)
        expected = np.stack(boundary_curve(theta, **by_name(*place[:3]), radius=place[3]))
        curve = curve_gains(curve_of_region(*place), theta)
        distance = np.hypot(expected[0] + place[0], expected[1])
        assert np.max(np.abs(curve - expected) / distance) < 1e-11, place


@np.errstate(divide="ignore")
@pytest.mark.parametrize("count", [30, pytest.param(many(3000, 120), marks=pytest.mark.campaign)])
def test_slopes_in_numpy_are_within_1e_12_of_the_truth(
    rng: np.random.Generator, count: int
) -> None:
    theta, slices = random_angles(rng, count), random_slices(rng, count)
    step = mpf(10) ** -20
    for angle, *slice_ in np.stack([theta, *slices], axis=-1).tolist():
        c = curve_of_region(*slice_, 1.0)
        slopes = gains_and_slopes(c, np.array([angle]))[1][:, 0]
        here = truth.boundary_point(angle, *slice_)
        ahead = truth.boundary_point(mpf(angle) + step, *slice_)
        exact = [(a - b) / step for a, b in zip(ahead, here, strict=True)]
        error = max(
            abs(mpf(one) - other) for one, other in zip(slopes.tolist(), exact, strict=True)
        )
        # Next to a pole slopes are sums that cancel: of the curve over the distance of the pole.
        nearest = min(
            np.hypot(angle - pole, apart) for pole, apart in [*c.resonances.T, (0.0, 1.0)]
        )
        distance = mp.hypot(here[0] + mpf(slice_[0]), here[1])
        # Next to 0 and pi, where the curve is even, a slope is a rounding of points over the angle.
        rounding = 8.0 * ROUNDING * distance / min(angle, np.pi - angle)
        allowed = 1e-12 * (mp.hypot(*exact) + distance / min(1.0, nearest)) + rounding
        assert error < allowed, (angle, slice_)


@pytest.mark.campaign
@pytest.mark.parametrize("delay", [1.5, 1.0])
def test_the_limits_have_finite_derivatives(delay: float) -> None:
    for theta in (0.0, np.pi):
        slopes = slopes_of((theta, 0.3, 0.2, delay))
        assert np.all(np.isfinite(slopes))
        np.testing.assert_allclose(slopes[0], 0.0, atol=1e-8)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"theta": -0.1}, "theta"),
        ({"theta": np.nan}, "theta"),
        ({"gamma": -1.0}, "gamma"),
        ({"delta": np.inf}, "delta"),
        ({"delay": -1.0}, "delay"),
        ({"radius": 0.0}, "radius"),
        ({"radius": 1.5}, "radius"),
        ({"radius": -0.5}, "radius"),
        ({"radius": np.nan}, "radius"),
    ],
)
def test_bad_input_is_refused_by_name(arguments: dict[str, float], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name} is [^\n]*; [^\n]*\.$"):
        boundary_curve(**{"theta": 0.5, "gamma": 0.0, "delta": 0.0, "delay": 0.0} | arguments)


@pytest.mark.parametrize("delay", [0.3, 2.75])
@pytest.mark.parametrize(("gamma", "delta"), [(0.1, 0.2), (30.0, 0.1), (60.0, 3.0), (2.0, 5.0)])
def test_poles_of_the_curve_are_the_zeros_of_the_numerator(
    gamma: float, delta: float, delay: float
) -> None:
    """Their angles, and how far they are from the circle, by numpy's roots of the exact N."""
    c = curve_of_region(gamma, delta, delay, 1.0)
    plant = truth.plant(gamma, delta, delay % 1.0)
    zeros = np.roots([float(n) for n in (plant.n2, plant.n1, plant.n0)])
    zeros = zeros[zeros != 0.0]
    angles, distances = c.resonances
    for zero in zeros:
        away = np.abs(np.log(np.abs(zero)))
        k = np.argmin(np.abs(angles - np.abs(np.angle(zero))) + np.abs(distances - away))
        assert angles[k] == pytest.approx(np.abs(np.angle(zero)), abs=1e-9)
        if 1e-6 < away < 1.0:
            assert distances[k] == pytest.approx(away, rel=1e-6)


@pytest.mark.parametrize(
    "function",
    [
        lambda x, root: x**25 - root**25,
        lambda x, root: np.expm1(40.0 * (x - root)),
        lambda x, root: np.log((x + 1e-9) / (root + 1e-9)),
        lambda x, root: np.arctan(300.0 * (x - root)),
    ],
)
def test_bracketed_roots_are_found_in_spite_of_flat_and_of_steep_parts(
    function: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> None:
    """There the secant method alone crawls along one side of the bracket."""
    roots = np.geomspace(1e-3, 0.9, 40)
    with np.errstate(divide="ignore", invalid="ignore"):
        answers = bracketed_root(lambda x: function(x, roots), np.full(40, 1e-6), np.ones(40))
    assert answers == pytest.approx(roots, rel=1e-14)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_bracket_of_neighbours_in_float64_has_a_root(count: int) -> None:
    """Its ends are all there is to try; a secant through one point twice is 0/0."""
    lower = np.full(4, 0.347)
    upper, shift = lower + count * np.spacing(lower), np.array([1e-30, 1e-16, 2e-17, 5e-17])
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = bracketed_root(lambda x: 1e3 * ((x - 0.347) - shift), lower, upper)
    assert np.all((lower <= roots) & (roots <= upper))


def test_the_quick_plant_has_thirteen_digits_of_one(rng: np.random.Generator) -> None:
    """D and N on the circle against balls; stiff and damped hands lose a digit."""
    gamma, delta = 10.0 ** rng.uniform(-8.0, 4.0, 300), 10.0 ** rng.uniform(-8.0, 3.0, 300)
    fraction = rng.choice([0.0, 0.25, 0.999], 300)
    quick = quick_plant(gamma, delta, fraction)
    for k, hand in enumerate(zip(gamma.tolist(), delta.tolist(), fraction.tolist(), strict=True)):
        true = ExactPlant.of(*hand, 400)
        names = ("d1", "d0", "n2", "n1", "n0")
        wrong = [abs(flint.arb(float(getattr(quick, x)[k])) - getattr(true, x)) for x in names]
        assert max(map(float, wrong)) < 1e-13 * (1.0 + gamma[k] ** 0.5 / 4.0)


def test_the_equations_of_a_root_on_the_circle_are_the_polynomial_there(
    rng: np.random.Generator,
) -> None:
    """p(z) over the power of z below its first, on both halves of the circle."""
    responses = Responses.from_filters(None)
    for gamma, delta, delay in [
        (0.0, 0.0, 0.0),
        (2.3, 0.4, 1.0),
        (0.7, 3.0, 2.25),
        (9.0, 0.1, 5.5),
    ]:
        alpha, beta = rng.uniform(-1.0, 1.0, 2).tolist()
        theta = rng.uniform(0.05, np.pi - 0.05, 12)
        hand = np.array(gamma), np.array(delta), np.array(delay)
        real, imag_over_sine = circle_equations(hand, alpha, beta, theta, responses)
        falling = truth.polynomial(alpha, beta, gamma, delta, delay)
        for k, z in enumerate(map(mp.expj, map(mpf, theta.tolist()))):
            true = truth.evaluate(falling, z) / z ** (len(falling) - 2)
            found = mp.mpc(real[k], imag_over_sine[k] * np.sin(theta[k]))
            assert abs(found - true) < 1e-13 * sum(map(abs, falling))
