"""Loops that are hard to compute, at random; changes of them, and walls next to the boundary."""

import flint
import numpy as np

from tests.truth.balls import ExactPlant, split_delay
from tests.truth.boundary import Boundary
from tests.truth.judge import Loops

_MOST = (1e150, 1e4, 1e3)  # a gain, gamma and delta


def random_loops(rng: np.random.Generator, delay: float, plants: int, walls: int) -> Loops:
    """Return loops of all families, a family for each plant and one for its walls."""
    pairs = [_plant(rng) for _ in range(plants)]
    gains = [_gains(rng, *pair, delay, walls) for pair in pairs]
    gamma, delta = np.array(pairs).T
    alpha, beta = (np.array(column) for column in zip(*gains, strict=True))
    return Loops(gamma, delta, alpha, beta, delay)


def changed_loops(rng: np.random.Generator, parents: Loops, children: int) -> Loops:
    """Return loops around those given, by a little or by much: the plant, and each child's gains.

    Args:
        parents: one wall for each plant.
        children: walls of each plant returned.
    """
    plants = parents.gamma.size

    def factor(shape: tuple[int, ...]) -> np.ndarray:
        return 1.0 + rng.standard_normal(shape) * 10.0 ** rng.uniform(-16.0, -0.5, shape)

    def sometimes(factors: np.ndarray) -> np.ndarray:
        return np.where(rng.random(factors.shape) < 0.5, factors, 1.0)

    gain, gamma, delta = _MOST
    return Loops(
        np.minimum(np.abs(parents.gamma * sometimes(factor((plants,)))), gamma),
        np.minimum(np.abs(parents.delta * sometimes(factor((plants,)))), delta),
        np.clip(parents.alpha * factor((plants, children)), -gain, gain),
        np.clip(parents.beta * factor((plants, children)), -gain, gain),
        parents.delay,
    )


def _plant(rng: np.random.Generator) -> tuple[float, float]:
    _, most_gamma, most_delta = _MOST
    kind = rng.integers(4)
    if kind <= 1:
        return random_plants(rng, 1)[0]
    if kind == 2:  # anywhere
        lowest = rng.choice([-300.0, -10.0], 2)
        gamma, delta = 10.0 ** rng.uniform(lowest, [4.0, 3.0])
        return min(float(gamma), most_gamma), min(float(delta), most_delta)
    delta = float(rng.choice([0.0, 5e-324, 10.0 ** rng.uniform(-16, 2.9), rng.uniform(0.0, 2.0)]))
    gamma = float(rng.choice([0.0, 5e-324, 0.25 * delta**2, (np.pi * rng.integers(1, 32)) ** 2]))
    for _ in range(rng.integers(3)):
        gamma = float(np.nextafter(gamma, most_gamma))
    return min(gamma, most_gamma), delta


def _gains(
    rng: np.random.Generator, gamma: float, delta: float, delay: float, walls: int
) -> tuple[np.ndarray, np.ndarray]:
    kind = rng.integers(8)
    if kind == 0:  # anywhere
        sizes = 10.0 ** (rng.uniform(-300.0, 150.0, (2, walls)) / rng.choice([1.0, 50.0]))
        alpha, beta = sizes * rng.choice([-1.0, 0.0, 1.0], (2, walls))
    elif kind <= 2:
        alpha, beta = _multiple_root_gains(rng, gamma, delta, delay, walls)
    else:
        with np.errstate(all="ignore"):
            alpha, beta = points_near_the_boundary(rng, gamma, delta, delay, walls)
    usable = (np.abs(alpha) <= _MOST[0]) & (np.abs(beta) <= _MOST[0])
    return np.where(usable, alpha, 0.1), np.where(usable, beta, 0.3)


def _multiple_root_gains(
    rng: np.random.Generator, gamma: float, delta: float, delay: float, walls: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return gains next to those with a double real root: p(r) = p'(r) = 0 is linear in them."""
    parts = map(np.poly1d, Boundary(ExactPlant.of(gamma, delta, delay).loop(delay)).parts)
    r = rng.uniform(-1.1, 1.1, walls)
    (f, f_slope), (s, s_slope), (t, t_slope) = ([p(r), p.deriv()(r)] for p in parts)
    with np.errstate(all="ignore"):
        determinant = s * t_slope - t * s_slope
        alpha = (t * f_slope - f * t_slope) / determinant
        beta = (f * s_slope - s * f_slope) / determinant
    off = 10.0 ** rng.uniform(-17, -3, (2, walls)) * rng.choice([-1.0, 0.0, 1.0], (2, walls))
    gains = np.nan_to_num(np.stack([alpha, beta]) * (1.0 + off), nan=0.1, posinf=0.1, neginf=0.1)
    return gains[0], gains[1]


def points_near_the_boundary(
    rng: np.random.Generator, gamma: float, delta: float, delay: float, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Alpha and beta on curve and lines of the boundary, most within 1e-6 ... 1e-16 of them."""
    whole, _ = split_delay(delay)
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
