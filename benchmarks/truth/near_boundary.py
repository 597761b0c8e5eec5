"""Points next to the boundary of random plants."""

import flint
import numpy as np

from benchmarks.truth import loop as truth
from benchmarks.truth.balls import ExactPlant
from benchmarks.truth.boundary import Boundary


def points_near_the_boundary(
    rng: np.random.Generator, gamma: float, delta: float, delay: float, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Alpha and beta on curve and lines of the boundary, most within 1e-6 ... 1e-16 of them."""
    whole, _ = truth.split_delay(delay)
    plant = ExactPlant.of(gamma, delta, delay)
    low = np.pi * 10 ** rng.uniform(-3, 0, count) / (1 + whole)
    theta = np.where(rng.random(count) < 0.5, rng.uniform(0, np.pi, count), low)
    alpha, beta = Boundary(plant.loop(delay)).solved(np.exp(1j * theta)).T
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
    return alpha * (1 + sides[0]), beta * (1 + sides[1])


def random_plants(rng: np.random.Generator, count: int) -> list[tuple[float, float]]:
    gammas = [0.0, 1e-3, *10 ** rng.uniform(-16, 3.9, count), *rng.uniform(0, 12, count)]
    deltas = [0.015, *10 ** rng.uniform(-16, 2.5, count), *rng.uniform(0, 0.6, count)]
    return [(float(rng.choice(gammas)), float(rng.choice(deltas))) for _ in range(count)]
