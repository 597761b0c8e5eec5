"""Bounds of lemma V7 beside the errors that they bound: plants and polynomials in balls.

These are computed again by matrix exponentials in state space; nothing of the package enters them.
Half of the loops are ordinary, half lie where the bounds are nearest to what they bound: next to
the limits of gamma and delta, to critical damping, to the zeros of N at gamma = (2 pi k)^2, and to
whole delays. The slack is a bound over the error that it bounds; below 1 it refutes the lemma.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import flint
import numpy as np

from jaxstab.model import DoubleDouble
from jaxstab.point import verdicts
from jaxstab.rounding import UNIT
from tests.truth.balls import ExactPlant

_BITS = 700
_TINY = 1e-300  # an error below it counts as none


class Finding(NamedTuple):
    """A bound beside the error that it bounds, and the loop where that was."""

    lemma: str
    bound: float
    error: float
    loop: tuple[float, ...]

    @property
    def slack(self) -> float:
        return self.bound / self.error if self.error > _TINY else math.inf


# ------------------------------------------------------------------------------------ loops, drawn


def hand(rng: np.random.Generator, hostile: bool) -> tuple[float, float, float]:
    """Draw gamma, delta and the fraction of a delay."""
    gamma = _chosen(rng, 0.0, 10.0 ** rng.uniform(-12.0, 4.0), rng.uniform(0.0, 45.0))
    delta = _chosen(rng, 0.0, 10.0 ** rng.uniform(-12.0, 3.0), rng.uniform(0.0, 11.0))
    if hostile:
        close = 1.0 + rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-17.0, -1.0)
        zero = (2.0 * math.pi * rng.integers(1, 16)) ** 2
        delta = _chosen(rng, delta, 0.0, 10.0 ** rng.uniform(-18.0, -3.0), 10.0, 1e3)
        limits = 40.0, 36.0, math.nextafter(36.0, 40.0), 1e4, zero
        gamma = _chosen(rng, gamma, 0.25 * delta**2, *limits) * close
    fraction = _chosen(rng, 0.0, 0.0, rng.uniform())
    if hostile and rng.random() < 0.3:
        tiny = 10.0 ** rng.uniform(-16.0, -1.0)
        fraction = _chosen(rng, tiny, 1.0 - tiny)
    return float(min(gamma, 1e4)), float(min(delta, 1e3)), min(fraction, math.nextafter(1.0, 0.0))


def _chosen(rng: np.random.Generator, *values: float) -> float:
    return float(values[rng.integers(len(values))])


def _wall(rng: np.random.Generator) -> tuple[float, float]:
    size = 10.0 ** rng.uniform(-4.0, 2.0, 2)
    return tuple((size * rng.choice([-1.0, 1.0, 1.0], 2)).tolist())


# --------------------------------------------------------------------------------------- lemma V7


def plant_findings(gamma: float, delta: float, fraction: float) -> Iterator[Finding]:
    """Compare the plant's pairs with balls."""
    loop = gamma, delta, fraction
    is_fractional = fraction > 0.0
    pairs = verdicts.plant_pairs(gamma, delta, fraction)
    plant = verdicts._plant_of(gamma, delta, pairs, is_fractional=is_fractional)
    error, size = float(plant.error), float(plant.size)
    with flint.ctx.workprec(_BITS):
        true = ExactPlant.of(gamma, delta, fraction, _BITS)
        n = [true.n0, true.n1, true.n2] if is_fractional else [true.n1, true.n2]
        numerator = list(plant.stiff)[-len(n) :]
        difference = true.n2 - true.n1 + true.n0
        yield _finding("V7 D", error, [plant.d1, plant.d0], [true.d1, true.d0], loop, max)
        yield _finding("V7 N", error * size, numerator, n, loop, max)
        yield _finding("V7 N(-1)", error * size, [plant.difference], [difference], loop)


def polynomial(rng: np.random.Generator, hostile: bool) -> Iterator[Finding]:
    """Compare the coefficients of a polynomial, and p(-1), with balls."""
    gamma, delta, fraction = hand(rng, hostile)
    alpha, beta = _wall(rng)
    yield from plant_findings(gamma, delta, fraction)
    is_fractional = fraction > 0.0
    degree = 3 + is_fractional
    loop = (alpha, beta, gamma, delta, fraction)
    with flint.ctx.workprec(_BITS):
        true = ExactPlant.of(gamma, delta, fraction, _BITS)
        a, b = flint.arb(alpha), flint.arb(beta)
        n = [true.n0, true.n1, true.n2] if is_fractional else [true.n1, true.n2]
        shifted = [flint.arb(0), *n], [*n, flint.arb(0)]
        tail = [(a + b) * up - b * down for up, down in zip(*shifted, strict=True)]
        difference = true.n2 - true.n1 + true.n0
        d_minus = 1 - true.d1 + true.d0
        plant = verdicts.float_plant(gamma, delta, fraction, is_fractional=is_fractional)
        chain = verdicts._closed_loop(alpha, beta, plant)
        got, exact = [chain.gap, *chain.tail], [1 - true.d0, *tail]
        yield _finding("V7 tail", float(chain.error), got, exact, loop)
        heads = [chain.head[0], chain.head[1], chain.head[1]], [true.d1, true.d0, true.d0]
        yield _finding("V7 head", float(chain.head_error), *heads, loop)
        ends = verdicts._ends(alpha, beta, gamma, plant, degree)
        at_end = d_minus - (a + 2 * b) * difference * (-1) ** (degree - len(plant.stiff))
        # Its sign counts, so that it may be rounded to float64.
        off = _distance(ends.at_minus_one, at_end) - UNIT * abs(float(ends.at_minus_one))
        yield Finding("V7 p(-1)", float(ends.at_minus_one_error), off, loop)


def _finding(
    lemma: str, bound: float, got: list, true: list, loop: tuple[float, ...], of: type = sum
) -> Finding:
    errors = [_distance(one, other) for one, other in zip(got, true, strict=True)]
    return Finding(lemma, bound, of(errors), loop)


def _distance(number: object, true: flint.arb) -> float:
    """Return the largest that the distance may be."""
    parts = (number.hi, number.lo) if isinstance(number, DoubleDouble) else (number,)
    return float(abs(sum((flint.arb(float(part)) for part in parts), flint.arb(0)) - true).upper())
