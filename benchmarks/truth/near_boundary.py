"""Points next to the boundary, and their true verdicts by certified roots of python-flint."""

from typing import NamedTuple

import flint
import numpy as np

from benchmarks import truth
from jaxstab import STABLE, UNDECIDED, UNSTABLE


class Points(NamedTuple):
    alpha: np.ndarray
    beta: np.ndarray
    distance: np.ndarray  # from the boundary, relative to the gains: about, and 0 on it


class ExactPlant(NamedTuple):
    """The truth's plant in balls of so many bits, which serve many points."""

    d1: flint.arb
    d0: flint.arb
    n2: flint.arb
    n1: flint.arb
    n0: flint.arb
    bits: int

    @classmethod
    def of(cls, gamma: float, delta: float, delay: float, bits: int = 1400) -> "ExactPlant":
        _, fraction = truth.split_delay(delay)
        with flint.ctx.workprec(bits):
            stiffness, damping = flint.arb(gamma), flint.arb(delta)
            position, velocity = _motion(stiffness, damping, flint.arb(1))
            state_12, state_22 = velocity, 1 - damping * velocity - stiffness * position
            d1, d0 = stiffness * position - 1 - state_22, (-damping).exp()
            if fraction == 0:
                n1 = velocity**2 - state_22 * position
                return cls(d1, d0, position, n1, flint.arb(0), bits)
            n2, early = _motion(stiffness, damping, 1 - flint.arb(fraction))
            late_position, late_velocity = position - n2, velocity - early
            n1 = late_position + state_12 * early - state_22 * n2
            n0 = state_12 * late_velocity - state_22 * late_position
            return cls(d1, d0, n2, n1, n0, bits)

    def polynomial(self, alpha: float, beta: float, delay: float) -> list[flint.arb]:
        whole, fraction = truth.split_delay(delay)
        with flint.ctx.workprec(self.bits):
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


def _motion(
    stiffness: flint.arb, damping: flint.arb, time: flint.arb
) -> tuple[flint.arb, flint.arb]:
    """Position and velocity of the plant at rest after a unit of force for a time."""
    still = flint.arb(0)
    generator = [[still, time, still], [-stiffness * time, -damping * time, time], [still] * 3]
    transition = flint.arb_mat(generator).exp()
    return transition[0, 2], transition[1, 2]


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
    whole, _ = truth.split_delay(delay)
    plant = ExactPlant.of(gamma, delta, delay)
    d1, d0, n2, n1, n0 = (float(value.mid()) for value in plant[:5])
    low = np.pi * 10 ** rng.uniform(-3, 0, count) / (1 + whole)
    theta = np.where(rng.random(count) < 0.5, rng.uniform(0, np.pi, count), low)
    z = np.exp(1j * theta)
    w = -(z ** (whole + 1)) * (z * z + d1 * z + d0) / (n2 * z * z + n1 * z + n0)
    beta = w.imag / np.sin(theta)
    alpha = w.real - beta * (1 - np.cos(theta))
    free = rng.uniform(-0.2, 1, count) * 4 / (1 + delay)
    with flint.ctx.workprec(plant.bits):
        difference = plant.n2 - plant.n1 + plant.n0
        lost = difference.contains(0)
        offset = 0.0 if lost else float(((1 - plant.d1 + plant.d0) / difference).mid())
    at_minus_one = (-1) ** whole * offset
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
