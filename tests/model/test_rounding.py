"""Bounds of rounding errors, against exact arithmetic and the formulas of docs/proofs.md.

Numbers are drawn at random, of all sizes. Where rounding seldom comes near to its bound, the bound
is compared with what its lemma says.
"""

from fractions import Fraction
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from jaxstab.model import polynomial_degree
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.point import dominance, fields, radius
from jaxstab.point.dominance import Complex
from jaxstab.point.radius import scaled_codes
from jaxstab.point.schur_cohn import Chain, _quotient, _step, loop_coefficients
from jaxstab.point.verdicts import _closed_loop, _ends, float_plant
from jaxstab.rounding import UNIT
from tests.truth import loop as truth

COUNT = 400


def drawn(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Numbers of either sign, from 1e-3 to 1e3."""
    return rng.choice([-1.0, 1.0], shape) * 10 ** rng.uniform(-3.0, 3.0, shape)


def exact(values: Any) -> list[Any]:
    """Fractions in place of floats, in lists."""
    return [Fraction(v) if isinstance(v, float) else exact(v) for v in np.asarray(values).tolist()]


def chain_of(gap: Any, head: Any, tail: Any) -> Chain:
    nothing = np.zeros(COUNT)
    return Chain(gap, tuple(head), tuple(tail), nothing, nothing.copy())


def test_a_step_rounds_by_no_more_than_lemma_v3_says() -> None:
    rng = np.random.default_rng(1)
    gap, head, tail = drawn(rng, COUNT), drawn(rng, 2, COUNT), drawn(rng, 3, COUNT)
    after = _step(chain_of(gap, head, tail), UNIT)
    ratios = tail[0] / (gap + head[1])
    for k, (g, (u1, u2), (v0, v1, v2)) in enumerate(
        zip(exact(gap), exact(head.T), exact(tail.T), strict=True)
    ):
        ratio = Fraction(float(ratios[k]))
        made = [Fraction(float(row[k])) for row in (*after.head[:2], after.gap, *after.tail[:2])]
        true = [
            u1 - ratio * v1,
            u2 - ratio * v2,
            g - ratio * (v0 - v2),
            v1 - ratio * u1,
            v2 - ratio * u2,
        ]
        away = [abs(a - b) for a, b in zip(made, true, strict=True)]
        dropped = abs(v0 - ratio * (g + u2))
        assert away[0] + 2 * away[1] <= Fraction(float(after.head_error[k]))
        assert sum(away[2:]) + dropped <= Fraction(float(after.error[k]))
        modulus, small = abs(ratio), abs(g) + abs(v1) + abs(v2)
        sizes = sum(map(abs, (g + u2, v0, u1, u2, v2)))
        of_head = abs(u1) + 2 * abs(u2) + 2 * modulus * (abs(v1) + 2 * abs(v2))
        lemma = float(UNIT * (small + 4 * modulus * sizes)), float(UNIT * of_head)
        bounds = after.error[k], after.head_error[k]
        assert bounds == pytest.approx(lemma, rel=1e-12, abs=0.0)


@pytest.mark.parametrize("is_alone", [False, True])
def test_a_ratio_of_jax_is_right_to_three_roundings(is_alone: bool) -> None:
    """Lemma V2: what a step drops counts on it, for divisors of either sign."""
    dividend, divisor = drawn(np.random.default_rng(8), 2, COUNT)
    made = np.asarray(_quotient(jnp.array(dividend), jnp.array(divisor), is_alone=is_alone))
    for a, b, c in zip(dividend.tolist(), divisor.tolist(), made.tolist(), strict=True):
        true = Fraction(a) / Fraction(b)
        assert abs(Fraction(c) - true) <= 3 * Fraction(UNIT) * abs(true)


@pytest.mark.parametrize("plant_error", [0.0, 1e-9])
def test_values_at_minus_one_are_within_their_errors(plant_error: float) -> None:
    """For large gains, at which these values are large, and N(-1) that is wrong by its error."""
    rng = np.random.default_rng(4)
    gamma, delta = rng.uniform(0.1, 9.0, (2, 40))
    plant = float_plant(gamma, delta, np.zeros(40), is_fractional=False)
    plant = plant._replace(error=plant.error + plant_error)
    alpha, beta = 10 ** rng.uniform(2.0, 5.0, (2, 40))
    degree = len(plant.stiff) + 1
    ends = _ends(alpha, beta, gamma, plant, degree)
    for k in range(40):
        true = truth.plant(float(gamma[k]), float(delta[k]), 0)
        force = true.n2 - true.n1 + true.n0 + plant_error * float(plant.size[k])
        value = 1 - true.d1 + true.d0 + force * (float(alpha[k]) + 2 * float(beta[k]))
        assert abs(ends.at_minus_one[k] - value) <= ends.at_minus_one_error[k]


@pytest.mark.parametrize("fraction", [0.0, 0.4])
def test_a_loop_of_a_plant_that_is_wrong_is_within_its_errors(fraction: float) -> None:
    """Of u1 and twice u2, and of all others: each number is wrong by that of the plant.

    Without it u1 and u2 are rounded.
    """
    rng, wrong = np.random.default_rng(9), 1e-9
    gamma, delta = rng.uniform(0.1, 4.0, (2, 40))
    plant = float_plant(gamma, delta, np.full(40, fraction), is_fractional=fraction > 0.0)
    alpha, beta = drawn(rng, 2, 40)
    chain = _closed_loop(alpha, beta, plant._replace(error=np.full(40, wrong)))
    walls = len(plant.stiff) * plant.size * (abs(alpha) + 2.0 * abs(beta))
    assert np.all((3.0 * wrong < chain.head_error) & (chain.head_error < 6.0 * wrong))
    assert np.all(wrong * (1.0 + 0.9 * walls) < chain.error)
    assert np.all(chain.error < 2.0 * wrong * (1.0 + walls))
    chain = _closed_loop(alpha, beta, plant._replace(error=np.zeros(40)))
    u1, u2 = map(abs, chain.head)
    np.testing.assert_allclose(chain.head_error, UNIT * (u1 + 2.0 * u2), rtol=1e-12, atol=0.0)


def test_sums_of_large_gains_are_within_the_error_of_their_coefficients() -> None:
    """Lemma V7: four roundings."""
    rng = np.random.default_rng(5)
    rows = [tuple(drawn(rng, 5, COUNT)) for _ in range(3)]
    nothing = np.zeros(COUNT)
    end = (nothing,) * 3
    loop = LinearLoop(*rows, end, end, end, nothing == 1.0)
    alpha, beta = drawn(rng, COUNT), drawn(rng, COUNT)
    made, bound = loop_coefficients(alpha, beta, loop, UNIT)
    for k in range(COUNT):
        k_alpha, k_beta = Fraction(float(alpha[k])), Fraction(float(beta[k]))
        away = Fraction(0)
        for column, value in zip(zip(*rows, strict=True), made, strict=True):
            base, stiffness, damping = (Fraction(float(row[k])) for row in column)
            true = base + stiffness * k_alpha + damping * k_beta
            away += abs(true - Fraction(float(value[k])))
        assert away <= Fraction(float(bound[k]))


def test_coefficients_of_small_circles_are_within_their_errors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Lemma R3: of p(r z) / r^n, with and without zeros in the middle."""
    rng = np.random.default_rng(6)
    given: list[Any] = []
    monkeypatch.setattr(radius, "polynomial_codes", lambda *values: given.extend(values))
    scale = rng.uniform(0.02, 0.3, COUNT)
    for places in (range(8), (0, 1, 2, 19, 20)):
        rows = [np.ones(COUNT), *drawn(rng, len(places) - 1, COUNT)]
        scaled_codes(np.array(rows), np.zeros(COUNT), scale, UNIT, places)
        made, bound, ends = given[-5:-2]
        for k in range(COUNT):
            r = Fraction(float(scale[k]))
            true = [Fraction(float(row[k])) / r**n for n, row in zip(places, rows, strict=True)]
            away = (abs(a - Fraction(float(b[k]))) for a, b in zip(true, made, strict=True))
            assert sum(away) <= Fraction(float(bound[k]))
            lemma = (2 * places[-1] + 8) * UNIT * float(sum(map(abs, true)))
            assert bound[k] == pytest.approx(lemma, rel=1e-9, abs=0.0)
            turned = sum(value * (-1) ** n for n, value in zip(places, true, strict=True))
            for end, value in ((ends[:2], sum(true)), (ends[2:], turned)):
                assert abs(Fraction(float(end[0][k])) - value) <= Fraction(float(end[1][k]))


@pytest.mark.parametrize("fraction", [0.0, 0.4])
@pytest.mark.parametrize("plant_error", [0.0, 1e-9])
def test_a_loop_on_another_circle_is_within_its_errors(fraction: float, plant_error: float) -> None:
    """Lemma R1: p(r z) / r^n by exact fractions, for plants that are wrong by their errors."""
    rng, count, degree = np.random.default_rng(7), 60, polynomial_degree(2.0 + fraction)
    gamma, delta = rng.uniform(0.1, 4.0, (2, count))
    plant = float_plant(gamma, delta, np.full(count, fraction), is_fractional=fraction > 0.0)
    plant = plant._replace(error=np.full(count, plant_error))
    alpha, beta = drawn(rng, 2, count)
    t = rng.uniform(-0.9, 0.5, count)
    loop = dominance.PlantPoints(alpha, beta, gamma, plant)
    chain, ends = dominance._circle(t, np.zeros(count), loop, degree)
    worst = np.zeros(2)
    for k in range(count):

        def true(value: np.ndarray, most: float = 0.0, k: int = k) -> Fraction:
            sign = Fraction(int(rng.choice([-1, 1])))
            return Fraction(float(value[k])) + sign * Fraction(most * plant_error)

        r, size = 1 + Fraction(float(t[k])), float(plant.size[k])
        gap = true(plant.gap, 1.0)
        walls = [
            true(stiff, size) * true(alpha) - true(damp, 2.0 * size) * true(beta)
            for stiff, damp in zip(plant.stiff, plant.damp, strict=True)
        ]
        tail = [wall / r ** (degree - n) for n, wall in enumerate(walls)]
        head = [true(plant.d1, 1.0) / r, (1 - gap) / r**2]
        pairs = [*zip(chain.head, head, strict=True), (chain.gap, (gap + r * r - 1) / r**2)]
        pairs += zip(chain.tail, tail, strict=True)
        away = [abs(Fraction(float(made[k])) - exact) for made, exact in pairs]
        of_head, of_all = away[0] + 2 * away[1], sum(away[2:])
        assert of_head <= Fraction(float(chain.head_error[k]))
        assert of_all <= Fraction(float(chain.error[k]))
        value = 1 - head[0] + head[1] + sum(c * (-1) ** (degree + n) for n, c in enumerate(tail))
        apart = abs(Fraction(float(ends.at_minus_one[k])) - value)
        assert apart <= Fraction(float(ends.at_minus_one_error[k]))
        shares = of_head / chain.head_error[k], of_all / chain.error[k]
        worst = np.maximum(worst, np.array(shares, float))
    assert plant_error == 0.0 or np.all(worst > 0.5)


def test_a_plant_on_another_circle_is_rounded_by_12_and_20_units() -> None:
    """Without a wall: 12 u of gap and r^2 - 1, over r^2, and 20 u of the other two."""
    rng = np.random.default_rng(10)
    plant = float_plant(*rng.uniform(0.1, 4.0, (2, 40)), np.zeros(40), is_fractional=False)
    plant, t = plant._replace(error=np.zeros(40)), rng.uniform(-0.9, 0.5, 40)
    loop = dominance.PlantPoints(np.zeros(40), np.zeros(40), np.ones(40), plant)
    chain, _ = dominance._circle(t, np.zeros(40), loop, 5)
    of_gap = 12.0 * UNIT * (abs(plant.gap) + abs((1.0 + t) ** 2 - 1.0)) / (1.0 + t) ** 2
    np.testing.assert_allclose(chain.error, of_gap, rtol=1e-9, atol=0.0)
    of_head = 20.0 * UNIT * (abs(plant.d1) / (1.0 + t) + abs(plant.d0) / (1.0 + t) ** 2)
    np.testing.assert_allclose(chain.head_error, of_head, rtol=1e-9, atol=0.0)


@pytest.mark.parametrize("degree", [3, 12, 30])
@pytest.mark.parametrize("root", [0.5, 4.0])
def test_at_a_root_rounding_alone_is_the_distance(degree: int, root: float) -> None:
    """Lemma R1 for z^(n-1) (z - root), all numbers powers of 2: n (4 n + 10) u and 4 u for |z|."""
    columns = [np.array([c]) for c in (1.0, -root, *[0.0] * (degree - 1))]
    bound = fields._bound(columns, np.zeros(1), np.array([root + 0j]))
    of_terms = degree * (4 * degree + 10) * UNIT * 2.0 * root  # two terms of one size
    assert bound[0] == pytest.approx(of_terms + 4.0 * UNIT * root, rel=2e-3, abs=0.0)


def test_how_far_the_circle_is_inside_of_a_root_is_known_to_64_units() -> None:
    """Lemma R1: p/p' has one large term, d, and the others are n - 1 over that distance at most."""
    loop = dominance.loop_of([np.array([v]) for v in (0.1, 0.3, 0.2, 0.1)], 0.0)
    root = max(truth.roots(0.1, 0.3, 0.2, 0.1, 0), key=lambda z: (abs(z), z.imag))
    off = 2.0**-28
    t = Complex(np.array([float(root.real) - 1.0 + off]), np.array([float(root.imag)]))
    size, radius_there = abs(t.re + 1j * t.im), abs(1.0 + t.re + 1j * t.im)
    distance, _ = dominance._distance_to_root(t, size, radius_there, loop, 3)
    _, bound = dominance.with_distance(t, loop, 3)
    share = dominance._SLACK * distance / (bound - 4.0 * UNIT * radius_there)
    apart = 2.0 * distance / (3.0 - share)
    least = 2.0**-25 * np.minimum(size, radius_there)
    assert (least - apart) / size == pytest.approx(64.0 * UNIT, rel=0.1, abs=0.0)


@pytest.mark.parametrize("fraction", [0.0, 0.4])
def test_the_rounding_of_a_value_and_a_slope_is_that_of_lemma_r1(fraction: float) -> None:
    """(4 (n - 2) + 30) u of all terms without their signs, and of the derivatives of these."""
    delay = 6.0 + fraction
    loop = dominance.loop_of([np.array([v]) for v in (-0.1, 0.1, 0.5, 0.3)], delay)
    degree = polynomial_degree(delay)
    linear, constant = (float(c[0]) for c in loop.denominator)
    numerator = [abs(float(c[0])) for c in loop.numerator]
    alpha, beta = abs(float(loop.alpha[0])), float(loop.beta[0])

    def terms(size: float, modulus: float) -> float:
        wall = alpha * modulus + beta * size
        return modulus ** (degree - 2) * ((size + linear) * size + constant) + (
            np.polyval(numerator, size) * wall
        )

    # Where the slope is nearly 0 its rounding counts.
    low, high = -0.9, -1e-3

    def slope(t: float) -> float:
        return float(
            dominance.evaluated(Complex(np.array([t]), np.zeros(1)), loop, degree)[1].re[0]
        )

    grid = np.linspace(low, high, 400)
    signs = np.sign([slope(t) for t in grid])
    (first, *_) = np.flatnonzero(signs[1:] != signs[:-1])
    low, high = grid[first], grid[first + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if slope(middle) * slope(low) > 0.0 else (low, middle)
    t = low + 1e-9
    size, modulus = abs(t), 1.0 + t
    at = Complex(np.array([t]), np.zeros(1))
    distance, rounding = dominance._distance_to_root(
        at, np.array([size]), np.array([modulus]), loop, degree
    )
    unit = (4.0 * (degree - 2) + 30.0) * UNIT
    assert rounding[0] == pytest.approx(unit * terms(size, modulus), rel=1e-9, abs=0.0)
    h = 1e-6
    of_slope = (terms(size + h, modulus + h) - terms(size - h, modulus - h)) / (2.0 * h)
    value = float(dominance.evaluated(at, loop, degree)[0].re[0])
    taken = abs(slope(t)) - degree * (abs(value) + rounding[0]) * dominance._SLACK / distance[0]
    assert taken == pytest.approx(unit * of_slope, rel=1e-2, abs=0.0)
