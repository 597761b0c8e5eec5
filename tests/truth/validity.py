"""Where the error of the linear condition first rises through a level, by certified roots.

The loop's equation at z and at 1/z gives (alpha, beta) as rational functions of z, so the excess
of the error is a polynomial in x = cos(theta). It is interpolated from values of the curve in many
digits; python-flint isolates all of its roots.
"""

import math
from typing import NamedTuple

import flint
import numpy as np
from mpmath import mp, mpc, mpf

from tests.truth import loop as truth

DIGITS = 60


class Rise(NamedTuple):
    """The first rise of the error through a level."""

    theta: mpf
    alpha: mpf
    beta: mpf


def random_questions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Rows level, gamma, delta, delay: hands of all sizes, levels from 0.1 to 100 percent.

    A tenth each without stiffness, without damping; half of the delays whole.
    """
    level = 10.0 ** rng.uniform(-3.0, 0.0, count)
    gamma = 10.0 ** rng.uniform(-7.0, -0.5, count) * (rng.random(count) > 0.1)
    delta = 10.0 ** rng.uniform(-6.0, -0.5, count) * (rng.random(count) > 0.1)
    whole = rng.integers(0, 4, count).astype(float)
    delay = np.where(rng.random(count) < 0.5, whole, rng.uniform(0.0, 3.0, count))
    return np.stack([level, gamma, delta, delay])


def first_rise(level: float, gamma: float, delta: float, delay: float) -> Rise | None:
    """The first angle in (0, pi) where the signed error rises through the level; None: never.

    NotCertain where two roots, or a root and the end of an interval, are not told apart.
    """
    with mp.workdps(3 * DIGITS):
        plant = truth.sampled_plant(gamma, delta, truth.split_delay(delay)[1])

        def curve(x: mpf) -> tuple[mpf, mpf, mpf]:
            return _curve_point(plant, math.floor(delay), x)

        def excess(x: mpf) -> mpf:
            alpha, beta, square = curve(x)
            limit = (beta + delta) / (mpf(delay) + mpf(1) / 2)
            return square * (limit - alpha - mpf(level) * (alpha + gamma))

        polynomial = _interpolated(excess, math.floor(delay) + 4)
        slope = polynomial.derivative()
        for x in _roots(polynomial):  # from x = 1 down: theta grows
            alpha, beta, _ = curve(x)
            at_x = truth.as_mpf(slope(truth.as_arb(x)))
            if -at_x * (alpha + gamma) > 0:
                return Rise(mp.acos(x), alpha, beta)
    return None


def _curve_point(plant: truth.Plant, whole: int, x: mpf) -> tuple[mpf, mpf, mpf]:
    """(alpha, beta) of the curve and |N|^2 at cos(theta) = x."""
    z = mpc(x, mp.sqrt(1 - x * x))
    numerator = truth.evaluate((plant.n2, plant.n1, plant.n0), z)
    w = -(z ** (whole + 1)) * truth.evaluate((1, plant.d1, plant.d0), z) / numerator
    beta = w.imag / z.imag
    return w.real - beta * (1 - x), beta, abs(numerator) ** 2


def _interpolated(function, terms: int) -> flint.arb_poly:
    """The polynomial of this many terms; its value at one more point is checked."""
    nodes = [mp.cos(mp.pi * (2 * k + 1) / (2 * terms)) for k in range(terms)]
    matrix = mp.matrix([[node**power for power in range(terms)] for node in nodes])
    values = mp.matrix([function(node) for node in nodes])
    coefficients = mp.lu_solve(matrix, values)
    spare = mpf(1) / 3
    seen = sum(c * spare**power for power, c in enumerate(coefficients))
    size = max(abs(c) for c in coefficients)
    assert abs(seen - function(spare)) < size * mpf(10) ** (-2 * DIGITS)
    error = flint.arb(0, truth.as_arb(size * mpf(10) ** (-2 * DIGITS)))
    with flint.ctx.workdps(3 * DIGITS):
        balls = [truth.as_arb(c) + error for c in coefficients]
        while balls and balls[-1].contains(0):
            balls.pop()  # without damping the degree is lower
        return flint.arb_poly(balls)


def _roots(polynomial: flint.arb_poly) -> list[mpf]:
    """The roots in (-1, 1), the largest first; those within 1e-50 of 1, x = 1 itself, are none."""
    with flint.ctx.workdps(3 * DIGITS):
        balls = flint.acb_poly(polynomial).roots(tol=flint.arb(10) ** -DIGITS)
        real = [ball.real for ball in balls if ball.imag.contains(0)]
        found = [truth.as_mpf(ball.mid()) for ball in real]
    return sorted((x for x in found if -1 < x < 1 - mpf(10) ** -50), reverse=True)
