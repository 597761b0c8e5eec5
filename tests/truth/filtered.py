"""Loops with an estimator and a filter: p(z) in balls, from the definitions of the filters.

A filter is written out here by its difference equation, as two lists of exact numbers, and the
loop's polynomial is multiplied by python-flint. Parameters that jaxstab rounds to float64 (the pole
of a low pass, the warped frequency and the sines of Butterworth's filter) are rounded here, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import flint
import numpy as np

from tests.truth.balls import BallLoop, ExactPlant, InBalls, Rational


def exact(value: float) -> flint.fmpq:
    """The binary number that a float holds."""
    return flint.fmpq(*value.as_integer_ratio())


def rational(numerator: Sequence[flint.fmpq], denominator: Sequence[flint.fmpq]) -> Rational:
    """A transfer function by its coefficients, highest power first."""
    return flint.fmpq_poly(list(numerator)[::-1]), flint.fmpq_poly(list(denominator)[::-1])


def times(*factors: Rational) -> Rational:
    """The product of transfer functions, nothing cancelled."""
    above, below = flint.fmpq_poly([1]), flint.fmpq_poly([1])
    for numerator, denominator in factors:
        above, below = above * numerator, below * denominator
    return above, below


def difference(samples: int) -> Rational:
    """(1 - z^-n) / n."""
    zeros = [flint.fmpq(0)] * (samples - 1)
    return rational(
        [flint.fmpq(1), *zeros, flint.fmpq(-1)], [flint.fmpq(samples), *zeros, flint.fmpq(0)]
    )


def average(samples: int) -> Rational:
    """(1 + ... + z^(1-n)) / n."""
    zeros = [flint.fmpq(0)] * (samples - 1)
    return rational([flint.fmpq(1)] * samples, [flint.fmpq(samples), *zeros])


def exponential(factor: float) -> Rational:
    """y = (1 - a) y_before + a x."""
    a = exact(factor)
    return rational([a, flint.fmpq(0)], [flint.fmpq(1), a - 1])


def low_pass(cutoff: float, order: int) -> Rational:
    """Poles at exp(-2 pi f), gain 1 at rest."""
    pole = exact(float(np.exp(-2.0 * np.pi * cutoff)))
    return times(*[rational([1 - pole, flint.fmpq(0)], [flint.fmpq(1), -pole])] * order)


def butterworth(cutoff: float, order: int) -> Rational:
    """The analogue prototype in s, s = (z - 1) / (z + 1)."""
    w = exact(float(np.tan(np.pi * cutoff)))
    minus, plus = flint.fmpq_poly([-1, 1]), flint.fmpq_poly([1, 1])
    factors = []
    for k in range(order // 2):
        sine = exact(float(np.sin(np.pi * (2 * k + 1) / (2 * order))))
        below = minus * minus + 2 * w * sine * minus * plus + w * w * plus * plus
        factors.append((w * w * plus * plus, below))
    if order % 2:
        factors.append((w * plus, minus + w * plus))
    return times(*factors)


@dataclass(frozen=True)
class FilteredLoop(InBalls):
    """A hand, a delay, an estimator of T times the velocity, and a position filter."""

    gamma: float
    delta: float
    delay: float
    velocity: Rational
    position: Rational

    def balls(self, bits: int = 1400) -> BallLoop:
        """p(z) for all walls, not divided by what cancels."""
        plant = ExactPlant.of(self.gamma, self.delta, self.delay, bits)
        return plant.loop(self.delay, self.velocity, self.position)
