"""Random loops with estimators and filters, each beside its truth, and walls next to the boundary.

Parameters of filters are numbers that the truth can take over exactly; the loops are hostile as
well as ordinary: cut-offs down to a thousandth of the sampling rate, orders to 20, hands without
stiffness or damping, stiff ones, and delays of whole samples and of fractions next to them.
"""

from typing import Any, NamedTuple

import numpy as np

from benchmarks.truth import filtered
from benchmarks.truth.balls import BallLoop
from benchmarks.truth.boundary import Boundary
from benchmarks.truth.filtered import FilteredLoop, Rational
from jaxstab.model import Filter, Velocity

_HIGHEST_ORDER = 24

Factor = tuple[Filter, Rational, int]  # and its order


class RandomLoop(NamedTuple):
    """A loop as jaxstab is asked for it, and its truth."""

    plant: tuple[float, float, float]  # gamma, delta, delay
    velocity: Velocity
    position: Filter
    truth: FilteredLoop

    @property
    def filters(self) -> dict[str, Any]:
        """The arguments of jaxstab's functions that name the estimator and the filter."""
        return {"velocity": self.velocity, "position": self.position}

    def __str__(self) -> str:
        gamma, delta, delay = self.plant
        return f"{gamma!r}, {delta!r}, {delay!r}; {self.velocity}; {self.position}"


def random_loop(rng: np.random.Generator) -> RandomLoop:
    """Return any loop of the model, with an estimator and, for four of ten, a position filter."""
    plant = _hand(rng)
    velocity, v, order = _estimator(rng)
    position, p = Filter(), filtered.average(1)
    if rng.random() < 0.4:
        position, p, more = _factor(rng)
        if order + more > _HIGHEST_ORDER:
            position, p = Filter(), filtered.average(1)
    return RandomLoop(plant, velocity, position, FilteredLoop(*plant, v, p))


def _hand(rng: np.random.Generator) -> tuple[float, float, float]:
    nyquist = (np.pi * rng.integers(1, 3)) ** 2 * (1.0 + 10.0 ** rng.uniform(-4, -1))
    gammas = 0.0, 10.0 ** rng.uniform(-9, 0), 12.0 * rng.uniform(), nyquist
    deltas = 0.0, 10.0 ** rng.uniform(-9, 1), rng.uniform(0.0, 0.6)
    close = 10.0 ** rng.uniform(-9, -1)
    fraction = rng.choice([0.0, rng.uniform(), close, 1.0 - close], p=[0.5, 0.3, 0.1, 0.1])
    whole = int(rng.choice([rng.integers(0, 4), rng.integers(0, 30)]))
    gamma = rng.choice(gammas, p=[0.2, 0.5, 0.2, 0.1])
    delta = rng.choice(deltas, p=[0.2, 0.5, 0.3])
    return float(gamma), float(delta), float(min(whole + fraction, 30.0))


def _estimator(rng: np.random.Generator) -> tuple[Velocity, Rational, int]:
    samples = int(rng.choice([rng.integers(1, 5), rng.integers(5, 25)]))
    window = Velocity.difference(samples=samples), filtered.difference(samples), samples
    kind = rng.integers(0, 5)
    if kind == 0:
        return window
    if kind == 1:
        return _rational_estimator(rng)
    if kind == 2 and samples < 5:  # a chain on a window
        velocity, v, order = window
    else:
        velocity, v, order = Velocity.difference(samples=1), filtered.difference(1), 1
    filter_, f, more = _factor(rng)
    return velocity * filter_, filtered.times(v, f), order + more


def _factor(rng: np.random.Generator) -> Factor:
    """Return a filter, its truth and its order."""
    cutoff = float(10.0 ** rng.uniform(-3.0, -0.35))
    order = int(rng.choice([1, 2, rng.integers(1, 9)]))
    kind = rng.integers(0, 4)
    if kind == 0:
        return Filter.low_pass(cutoff, order), filtered.low_pass(cutoff, order), order
    if kind == 1:
        return Filter.butterworth(cutoff, order), filtered.butterworth(cutoff, order), order
    if kind == 2:
        samples = int(rng.integers(2, 9))
        return Filter.average(samples=samples), filtered.average(samples), samples
    factor = float(rng.uniform(0.02, 1.0))
    return Filter.exponential(factor), filtered.exponential(factor), 1


def _rational_estimator(rng: np.random.Generator) -> tuple[Velocity, Rational, int]:
    """Return (z - 1) (z - a) / (z (z - b) (z - c)), all in sixteenths, so that it is exact."""
    a, b, c = (float(one) / 16.0 for one in rng.integers(-14, 15, 3))
    numerator, denominator = (np.poly(roots).tolist() for roots in ([1.0, a], [0.0, b, c]))
    exact = filtered.rational(
        *([filtered.exact(value) for value in one] for one in (numerator, denominator))
    )
    return Velocity.transfer_function(numerator, denominator), exact, 3


def hostile_walls(rng: np.random.Generator, balls: BallLoop, count: int) -> np.ndarray:
    """Return walls (count, 2), half of them within 1e-6 of the boundary, relative to themselves."""
    points = Boundary(balls).points(rng)
    walls = points[rng.integers(0, len(points), count)]
    sides = rng.choice([-1.0, 0.0, 1.0], (count, 2))
    near = 10.0 ** rng.uniform(-14.0, -6.0, (count, 1))
    far = 10.0 ** rng.uniform(-6.0, 0.5, (count, 1))
    is_near = np.arange(count)[:, None] % 2 == 0
    return walls * (1.0 + sides * np.where(is_near, near, far))
