"""Points next to the boundary, and their true verdicts by certified roots of python-flint."""

from typing import NamedTuple

import flint
import numpy as np
import truth
from mpmath import mp, mpf

from jaxstab import STABLE, UNDECIDED, UNSTABLE


class Points(NamedTuple):
    alpha: np.ndarray
    beta: np.ndarray
    distance: np.ndarray  # from the boundary, relative to the gains: about, and 0 on it


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
    offset = (1 - plant.d1 + plant.d0) / plant.difference if plant.difference else 0
    at_minus_one = (-1) ** whole * float(offset)
    kind = rng.integers(0, 10, count)
    beta = np.where(kind <= 1, free, beta)
    alpha = np.select([kind == 0, kind == 1], [-gamma, at_minus_one - 2 * free], alpha)
    distance = 10 ** np.where(
        rng.random(count) < 0.8, rng.uniform(-16, -6, count), rng.uniform(-6, 0, count)
    )
    sides = rng.choice([-1, 0, 1], (2, count)) * distance
    return Points(alpha * (1 + sides[0]), beta * (1 + sides[1]), np.abs(sides).max(axis=0))


def random_plants(rng: np.random.Generator, count: int) -> list[tuple[float, float]]:
    gammas = [0.0, 1e-3, *10 ** rng.uniform(-16, 3.9, count), *rng.uniform(0, 12, count)]
    deltas = [0.015, *10 ** rng.uniform(-16, 2.5, count), *rng.uniform(0, 0.6, count)]
    return [(float(rng.choice(gammas)), float(rng.choice(deltas))) for _ in range(count)]
