"""The certified verdict and the certified bound of a radius, against certified roots."""

from collections.abc import Callable
from fractions import Fraction
from typing import NamedTuple

import flint
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import truth
from mpmath import mp, mpf

from jaxstab import STABLE, UNDECIDED, UNSTABLE, characteristic_polynomial, verdict
from jaxstab.stability.schur_cohn import radius_error

DELAYS = (0.0, 0.25, 1.0, 1.5, 2.0, 2.75, 5.0, 7.3, 8.0, 20.0, 33.0, 59.5, 60.0)
POINTS = {True: 2000, False: 200}  # of short delays, of long ones
PER_PLANT = 200
HAPTIC = {"gamma": 1e-3, "delta": 0.015}
DELAY_OF_MANY = np.array([0.0, 0.5, 1.0, 3.25, 14.0])


class Points(NamedTuple):
    alpha: np.ndarray
    beta: np.ndarray


class ExactPlant(NamedTuple):
    """The truth's plant in balls of 400 digits, which serve many points."""

    d1: flint.arb
    d0: flint.arb
    n2: flint.arb
    n1: flint.arb
    n0: flint.arb

    @classmethod
    def of(cls, gamma: float, delta: float, delay: float) -> "ExactPlant":
        with mp.workdps(420), flint.ctx.workprec(1400):
            _, fraction = truth.split_delay(delay)
            plant = truth.sampled_plant(gamma, delta, fraction if fraction else 0)
            return cls(*(truth.as_arb(mpf(value)) for value in plant[:5]))

    def polynomial(self, alpha: float, beta: float, delay: float) -> list[flint.arb]:
        whole, fraction = truth.split_delay(delay)
        with flint.ctx.workprec(1400):
            a, b = flint.arb(alpha), flint.arb(beta)
            wall = [
                self.n2 * (a + b),
                self.n1 * (a + b) - self.n2 * b,
                self.n0 * (a + b) - self.n1 * b,
                -self.n0 * b,
            ][: 3 if fraction == 0 else 4]
            coefficients = [flint.arb(1), self.d1, self.d0] + [flint.arb(0)] * (
                whole + len(wall) - 2
            )
            for place, value in enumerate(reversed(wall), start=1):
                coefficients[-place] += value
            return coefficients


def moduli(coefficients: list[flint.arb], bits: int) -> list[flint.arb]:
    with flint.ctx.workprec(bits):
        tolerance = flint.arb(2) ** (-bits // 2)
        return [abs(ball) for ball in flint.acb_poly(coefficients[::-1]).roots(tol=tolerance)]


def true_code(coefficients: list[flint.arb]) -> int:
    """UNDECIDED where a root is on the circle, as far as 360 digits can tell."""
    for bits in (160, 400, 1200):
        try:
            balls = moduli(coefficients, bits)
        except ValueError:
            continue
        if all(ball < 1 for ball in balls):
            return STABLE
        if any(ball > 1 for ball in balls):
            return UNSTABLE
    return UNDECIDED


def points_near_the_boundary(
    rng: np.random.Generator, gamma: float, delta: float, delay: float, count: int
) -> Points:
    """Curve and both lines of the boundary, most points within 1e-6 ... 1e-16 of them."""
    whole, fraction = truth.split_delay(delay)
    plant = truth.sampled_plant(gamma, delta, fraction if fraction else 0)
    d1, d0, n2, n1, n0 = (float(value) for value in plant[:5])
    low = np.pi * 10 ** rng.uniform(-3, 0, count) / (1 + whole)
    theta = np.where(rng.random(count) < 0.5, rng.uniform(0, np.pi, count), low)
    z = np.exp(1j * theta)
    w = -(z ** (whole + 1)) * (z * z + d1 * z + d0) / (n2 * z * z + n1 * z + n0)
    beta = w.imag / np.sin(theta)
    alpha = w.real - beta * (1 - np.cos(theta))
    free = rng.uniform(-0.2, 1, count) * 4 / (1 + delay)
    at_minus_one = (-1) ** whole * float((1 - plant.d1 + plant.d0) / plant.difference or 0)
    kind = rng.integers(0, 10, count)
    beta = np.where(kind <= 1, free, beta)
    alpha = np.select([kind == 0, kind == 1], [-gamma, at_minus_one - 2 * free], alpha)
    distance = 10 ** np.where(
        rng.random(count) < 0.8, rng.uniform(-16, -6, count), rng.uniform(-6, 0, count)
    )
    sides = rng.choice([-1, 0, 1], (2, count)) * distance
    return Points(alpha * (1 + sides[0]), beta * (1 + sides[1]))


def random_plants(rng: np.random.Generator, count: int) -> list[tuple[float, float]]:
    gammas = [0.0, 1e-3, *10 ** rng.uniform(-16, 3.9, count), *rng.uniform(0, 12, count)]
    deltas = [0.015, *10 ** rng.uniform(-16, 2.5, count), *rng.uniform(0, 0.6, count)]
    return [(float(rng.choice(gammas)), float(rng.choice(deltas))) for _ in range(count)]


@pytest.mark.parametrize("delay", DELAYS)
def test_no_verdict_is_wrong_however_close_to_the_boundary(
    delay: float, rng: np.random.Generator
) -> None:
    for gamma, delta in random_plants(rng, POINTS[delay < 10] // PER_PLANT):
        plant = ExactPlant.of(gamma, delta, delay)
        alpha, beta = points_near_the_boundary(rng, gamma, delta, delay, PER_PLANT)
        quick = np.asarray(verdict(alpha, beta, gamma, delta, delay))
        exact = np.asarray(verdict(alpha, beta, gamma, delta, delay, resolve="exact"))
        for a, b, *codes in zip(alpha, beta, quick, exact, strict=True):
            true = true_code(plant.polynomial(a, b, delay))
            assert set(codes) <= {true, UNDECIDED}, (a, b, gamma, delta, delay, codes, true)


@pytest.mark.parametrize(("delay", "band"), [(0.0, 1e-13), (1.0, 1e-12), (5.0, 1e-11)])
def test_the_undecided_band_is_narrow_and_closes_when_resolved(
    delay: float, band: float, rng: np.random.Generator
) -> None:
    # On the curve that bounds the stable set of a PHANToM-like device with a hand.
    thetas = rng.uniform(0.1, 0.8, 40) / (delay + 1)
    edge = [truth.boundary_point(theta, delay=delay, **HAPTIC) for theta in thetas]
    alpha, beta = np.array(edge, float).T
    for distance, resolve, share in ((band, None, 0.1), (1e-14, "exact", 0.0)):
        both = np.stack([alpha * (1 - distance), alpha * (1 + distance)])
        codes = np.asarray(verdict(both, beta, **HAPTIC, delay=delay, resolve=resolve))
        assert np.mean(codes == UNDECIDED) <= share
    assert np.all(codes[0] != codes[1])


def test_the_undamped_free_device_without_delay_has_the_known_stable_set(
    rng: np.random.Generator,
) -> None:
    # 0 < alpha < 2 beta (2 - beta) / (beta + 2), 0 < beta < 2 for the rational numbers given.
    beta = rng.uniform(0, 2, 400)
    distance = 10 ** rng.uniform(-17, -1, 400) * rng.choice([-1, 1], 400)
    alpha = 2 * beta * (2 - beta) / (beta + 2) * (1 + distance)
    codes = np.asarray(verdict(alpha, beta, 0.0, 0.0, 0.0, resolve="exact"))
    for a, b, code in zip(alpha, beta, codes, strict=True):
        a, b = Fraction(a), Fraction(b)
        limit = 2 * b * (2 - b) / (b + 2)
        assert code == (UNDECIDED if a == limit else STABLE if a < limit else UNSTABLE)


@pytest.mark.parametrize("resolve", [None, "exact"])
def test_a_root_at_one_stays_undecided(resolve: str | None) -> None:
    codes = verdict(-1e-3, np.linspace(0.1, 0.5, 9), 1e-3, 0.015, DELAY_OF_MANY[:, None])
    assert np.all((codes == UNDECIDED) | (codes == UNSTABLE))
    assert verdict(-1e-3, 0.1, 1e-3, 0.015, 0.0, resolve=resolve) == UNDECIDED


@pytest.mark.parametrize("delay", [0.0, 2.5, 40.0])
@pytest.mark.parametrize("gains", [(1e150, 0.1), (-1e150, 0.1), (0.1, 1e150), (1e150, -1e150)])
def test_enormous_gains_are_unstable(gains: tuple[float, float], delay: float) -> None:
    assert verdict(*gains, 1e-3, 0.015, delay) == UNSTABLE


def test_every_delay_of_an_array_gets_the_verdict_of_its_own(rng: np.random.Generator) -> None:
    alpha, beta = rng.uniform(-0.01, 0.2, (7, 1, 1)), rng.uniform(0, 1, (11, 1))
    codes = verdict(alpha, beta, **HAPTIC, delay=DELAY_OF_MANY)
    assert codes.shape == (7, 11, 5)
    assert codes.dtype == jnp.int8
    for place, delay in enumerate(DELAY_OF_MANY):
        alone = verdict(alpha, beta, **HAPTIC, delay=delay)[..., 0]
        np.testing.assert_array_equal(codes[..., place], alone)


def test_the_verdict_of_a_large_grid_is_that_of_its_points(rng: np.random.Generator) -> None:
    alpha, beta = rng.uniform(-0.01, 0.05, (150, 1)), rng.uniform(0, 0.5, (1, 70))
    grid = np.asarray(verdict(alpha, beta, **HAPTIC, delay=4.0))
    some = rng.integers(0, (150, 70), (50, 2))
    points = verdict(alpha[some[:, 0], 0], beta[0, some[:, 1]], **HAPTIC, delay=4.0)
    np.testing.assert_array_equal(grid[some[:, 0], some[:, 1]], points)


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap])
def test_the_verdict_goes_through_jit_and_vmap(transform: Callable[..., Callable]) -> None:
    alpha, beta = jnp.array([0.02, 0.3]), jnp.array([0.2, 0.2])
    codes = transform(lambda a, b: verdict(a, b, 1e-3, 0.015, 1.0))(alpha, beta)
    np.testing.assert_array_equal(codes, [STABLE, UNSTABLE])


def test_an_unknown_way_to_resolve_is_refused() -> None:
    with pytest.raises(ValueError, match=r"resolve is 'more'; give \"exact\" or None\."):
        verdict(0.1, 0.2, 1e-3, 0.015, 1.0, resolve="more")


@pytest.mark.parametrize(
    ("delay", "typical"),
    [(0.0, 2e-13), (0.5, 2e-13), (1.0, 2e-13), (4.5, 1e-12), (8.0, 1e-12), (20.0, 1e-11)],
)
def test_the_bound_of_a_radius_holds_and_is_narrow(
    delay: float, typical: float, rng: np.random.Generator
) -> None:
    gamma, delta, count = 1e-3, 0.015, 60
    alpha = rng.uniform(-0.01, 0.3, count) / (1 + delay) ** 2
    beta = rng.uniform(0, 1, count) / (1 + delay)
    plant = ExactPlant.of(gamma, delta, delay)
    roots = [moduli(plant.polynomial(*p, delay), 400) for p in zip(alpha, beta, strict=True)]
    largest = [max(map(float, some)) for some in roots]
    coefficients = characteristic_polynomial(alpha, beta, gamma, delta, delay)
    for off in (0.0, 1e-9, -1e-5):
        radius = np.array(largest) * (1 + off)
        error = np.asarray(radius_error(coefficients, jnp.asarray(radius)))
        assert np.all(error >= np.abs(radius - largest) - np.spacing(radius))
        assert np.median(error) <= typical + 5 * abs(off)


def test_the_bound_of_a_radius_holds_at_a_triple_root() -> None:
    # gamma = delta = 0: r = 4^(1/3) - 1, alpha = 6 r^2 - 2, beta = 2 r^3 has a triple root.
    root = mp.cbrt(4) - 1
    alpha, beta = float(6 * root**2 - 2), float(2 * root**3)
    lower, upper = truth.spectral_radius(alpha, beta, 0, 0, 0)
    coefficients = characteristic_polynomial(alpha, beta, 0.0, 0.0, 0.0)
    for radius in (float(root), float(upper), float(root) * (1 + 1e-7)):
        error = float(radius_error(coefficients, jnp.asarray(radius)))
        assert max(abs(lower - radius), abs(upper - radius)) <= error < 1e-3


def test_coefficients_that_the_recursion_does_not_follow_give_no_bound() -> None:
    coefficients = jnp.array([1.0, 0, 0, 0.5, 0, 0, 0, 0.1])
    assert jnp.isinf(radius_error(coefficients, jnp.asarray(0.9)))
