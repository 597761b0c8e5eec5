"""A loop whose delays repeat in turn: the matrix of one turn, and a proof that it grows.

Sample j is read at the time j, in samples, and its force arrives at j + t_j; the newest sample that
has arrived sets the force. Between two arrivals the force is constant, so with F(t) = exp(A t) and
G(t) the integral of F B from 0 to t, a force f that acts from a to b of a sample adds

    (G(1 - a) - G(1 - b)) f

to the device's states at the next sample. These, what the controller remembers and the forces that
may still act move by one matrix per sample, a product of N matrices per turn of N delays. An
eigenvalue of the product outside of the unit circle proves that some motion grows (lemma J2 of
docs/proofs.md). The same matrices are formed in float64, for searches, and in balls, for proofs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial, reduce
from math import ceil, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxstab.model.device.device import Device
from jaxstab.model.device.parts import exact, working_precision
from jaxstab.model.device.sampling import (
    SampledDevice,
    force_of,
    held,
    in_fastest_time,
    in_samples,
    without_force,
)
from jaxstab.model.filters import Filters, Polynomial, Transfer
from jaxstab.rounding import FILTERS

if TYPE_CHECKING:
    from flint import arb_poly

_BITS = 512
_STEPS = 6  # of Newton's iteration towards a root of the characteristic polynomial

Held = tuple[np.ndarray, np.ndarray, np.ndarray]
Delays = Sequence[float]  # in samples; infinite for a sample that is lost
Segments = tuple[tuple[int, float, float], ...]

"""The forces that act in a sample: age in samples, start and end of each."""


def segments_of(delays: Delays) -> list[Segments]:
    """The forces that act in each sample of a turn; ValueError if all samples are lost."""
    period = len(delays)
    finite = [delay for delay in delays if isfinite(delay)]
    if not finite:
        raise ValueError("every sample is lost; give at least one delay that is finite.")
    oldest = period + ceil(max(finite))
    turns = []
    for k in range(period):
        arrivals = [delays[(k - age) % period] - age for age in range(oldest + 1)]
        acting = next(age for age, time in enumerate(arrivals) if time <= 0.0)
        start, segments = 0.0, []
        newer = sorted((time, age) for age, time in enumerate(arrivals[:acting]) if time < 1.0)
        for time, age in newer:
            if age < acting:
                if time > start:
                    segments.append((acting, start, time))
                acting, start = age, time
        turns.append((*segments, (acting, start, 1.0)))
    return turns


@dataclass(frozen=True)
class PeriodicLoop:
    """A loop with one wall, in float64 or in balls; forces are in the unit of the device.

    Attributes:
        held: F and G of the rest of a sample, by where it starts, and the position's row.
        above, below: numerator and denominator of the controller in powers of 1/z, below[0] = 1.
    """

    held: partial[Held]
    above: np.ndarray
    below: np.ndarray

    @classmethod
    def from_device(
        cls, device: SampledDevice, filters: Filters | None, alpha: float, beta: float
    ) -> "PeriodicLoop":
        """Return the loop in balls; its controller is alpha P + beta V."""
        given = device.device, device.sample_time, device.stiffness_unit
        with working_precision(_BITS):
            above, below = _controller(device, filters, alpha, beta)
        return cls(partial(_held, *given), above, below)

    def rounded(self) -> "PeriodicLoop":
        """Return the loop in float64, without a bound."""
        held = partial(_held_in_floats, *self.held.args)
        return PeriodicLoop(held, _floats(self.above), _floats(self.below))

    def steps(self, delays: Delays) -> list[np.ndarray]:
        """Return the matrices of the samples of a turn."""
        turns = segments_of(delays)
        oldest = max(age for segments in turns for age, *_ in segments)
        return [self.step(segments, oldest) for segments in turns]

    def step(self, segments: Segments, oldest: int) -> np.ndarray:
        """Return the matrix of a sample, of the device, the controller and the last forces."""
        transition, _, position = self.held(0.0)
        states, memory = len(position), len(self.above) - 1
        forces = states + memory
        step = np.zeros((forces + oldest, forces + oldest), position.dtype)
        force = np.zeros(len(step), position.dtype)  # the negative of the controller's output
        force[:states], force[states : states + min(memory, 1)] = -self.above[0] * position, -1
        step[:states, :states] = transition
        for age, start, end in segments:
            push = self.held(start)[1] - self.held(end)[1]
            if age:
                step[:states, forces + age - 1] += push
            else:
                step[:states] += push[:, None] * force
        for k in range(1, memory + 1):
            step[states + k - 1] = self.below[k] * force
            step[states + k - 1, :states] += self.above[k] * position
            step[states + k - 1, states + k : states + min(k + 1, memory)] += 1
        step[forces : forces + 1] = force if oldest else 0
        for age in range(1, oldest):
            step[forces + age, forces + age - 1] = 1
        return step


def proved_growth(loop: PeriodicLoop, delays: Delays) -> float:
    """Return a lower bound of the spectral radius of a turn, proved; 0 if none above 1 is."""
    import flint

    steps = loop.rounded().steps(delays)
    with np.errstate(all="ignore"):
        turn = reduce(lambda total, step: step @ total, steps)
    if not np.all(np.isfinite(turn)):
        return 0.0
    eigenvalues = np.linalg.eigvals(turn)
    guess = complex(eigenvalues[np.argmax(np.abs(eigenvalues))])
    with working_precision(_BITS):
        exactly = [flint.arb_mat(step.tolist()) for step in loop.steps(delays)]
        polynomial = flint.acb_poly(reduce(lambda total, step: step * total, exactly).charpoly())
        slope, z = polynomial.derivative(), flint.acb(guess)
        for _ in range(_STEPS):
            move = polynomial(z) / slope(z)
            if not move.is_finite():
                return 0.0
            z = flint.acb((z - move).mid())
        distance = len(turn) * abs(polynomial(z) / slope(z))  # a root is as near (lemma R1)
        radius = abs(z) - distance
        return float(radius.lower()) * (1.0 - 2.0**-50) if radius > 1 else 0.0


# ------------------------------------------------------------------------- device and controller
@lru_cache(maxsize=256)
def _held(device: Device, sample_time: float, unit: float, start: float) -> Held:

    with working_precision(_BITS):
        above, below, speed = in_fastest_time(*in_samples(device.compliance(), sample_time))
        matrix = held(below, (1 - exact(start)) * speed)
        states, force = without_force(matrix).tolist(), force_of(matrix) / exact(unit)
        return np.array(states), np.array(force.tolist())[:, 0], np.array(above)


@lru_cache(maxsize=256)
def _held_in_floats(device: Device, sample_time: float, unit: float, start: float) -> Held:
    transition, push, position = map(_floats, _held(device, sample_time, unit, start))
    return transition, push, position


def _floats(balls: np.ndarray) -> np.ndarray:
    return np.array([float(ball.mid()) for ball in balls.ravel()]).reshape(balls.shape)


def _controller(
    device: SampledDevice, filters: Filters | None, alpha: float, beta: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return numerator and denominator of alpha P + beta V in powers of 1/z, of one length."""
    import flint

    (above, below), (above_p, below_p) = map(_in_lags, device.transfers(filters))
    stiffness = above_p * below * exact(alpha)
    damping = flint.arb_poly([1, -1]) * above * below_p * exact(beta)
    polynomials = stiffness + damping, below * below_p
    size = max(map(len, polynomials))
    leading = polynomials[1][0]
    numerator, denominator = (np.array([p[k] / leading for k in range(size)]) for p in polynomials)
    return numerator, denominator


def _in_lags(transfer: Transfer) -> "tuple[arb_poly, arb_poly]":
    """Return numerator and denominator in powers of 1/z, with the errors of lemma V8."""
    import flint

    def balls(falling: Polynomial, size: float) -> list[Any]:
        error = flint.arb(0, float(size) * FILTERS)
        return [flint.arb(c.hi) + flint.arb(c.lo) + error for c in falling]

    above, below = (
        balls(falling, size) for falling, size in zip(transfer[:2], transfer.sizes, strict=True)
    )
    late = transfer.lag + len(below) - len(above)
    return flint.arb_poly([0] * late + above), flint.arb_poly(below)
