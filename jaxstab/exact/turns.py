"""V10. Delays that repeat in turn: the matrix of one turn, and a proof that its motion grows.

Sample j is read at the time j, in samples, and its force arrives at j + t_j; the newest sample that
has arrived sets the force. Between two arrivals the force is constant, so with F(t) = exp(A t) and
G(t) the integral of F B from 0 to t, a force f that acts from a to b of a sample adds

    (G(1 - a) - G(1 - b)) f

to the device's states at the next sample. These, what the controller remembers and the forces that
may still act move by one matrix per sample, a product of N matrices per turn of N delays. If the
characteristic polynomial of the product has a root outside the unit circle (E1), the motion that
begins in the real part of its eigenvector grows. The same matrices are formed in float64, for
searches, and in balls, for proofs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial, reduce
from itertools import count, takewhile
from math import isfinite

import numpy as np

from jaxstab.exact.roots import are_inside
from jaxstab.model.balls import Factored, ball_loop
from jaxstab.model.device.device import Device
from jaxstab.model.device.parts import exact, flint, working_precision
from jaxstab.model.device.sampling import one_sample, states_and_force
from jaxstab.model.loop import LoopParameters

_BITS = 512

Held = tuple[np.ndarray, np.ndarray, np.ndarray]
Delays = Sequence[float]  # in samples; infinite for a sample that is lost
Segments = tuple[tuple[int, float, float], ...]

"""The forces that act in a sample: age in samples, start and end of each."""


def segments_of(delays: Delays) -> list[Segments]:
    """The forces that act in each sample of a turn; ValueError if all samples are lost."""
    period = len(delays)
    if not any(map(isfinite, delays)):
        raise ValueError("every sample is lost; give at least one delay that is finite.")
    turns = []
    for k in range(period):
        arrivals = (delays[(k - age) % period] - age for age in count())
        late = list(takewhile(lambda time: time > 0.0, arrivals))  # when the sample starts
        acting, start, segments = len(late), 0.0, []
        newer = sorted((time, age) for age, time in enumerate(late) if time < 1.0)
        for time, age in newer:
            if age < acting:
                if time > start:
                    segments.append((acting, start, time))
                acting, start = age, time
        turns.append((*segments, (acting, start, 1.0)))
    return turns


@dataclass(frozen=True)
class TransitionMatrices:
    """What maps the state of a loop with one wall from sample to sample, in float64 or in balls.

    In SI units.

    Attributes:
        held: F and G of the rest of a sample, by where it starts, and the position's row.
        above, below: numerator and denominator of the controller in powers of 1/z, below[0] = 1.
    """

    held: partial[Held]
    above: np.ndarray
    below: np.ndarray

    @classmethod
    def from_loop(
        cls, loop: LoopParameters, stiffness: float, damping: float
    ) -> "TransitionMatrices":
        """Return the loop in balls; its own delay does not count."""
        with working_precision(_BITS):
            parts = ball_loop(loop)
            below = parts.position[1].times(parts.velocity[1]).polynomial()
            above = parts.wall(stiffness, damping).polynomial()
            lags = range(below.degree(), -1, -1)
            numerator, denominator = (
                np.array([side[power] for power in lags]) for side in (above, below)
            )
        given = loop.held_device, float(loop.sample_time)
        return cls(partial(_held, *given), numerator, denominator)

    def rounded(self) -> "TransitionMatrices":
        """Return the loop in float64, without a bound."""
        held = partial(_held_in_floats, *self.held.args)
        return TransitionMatrices(held, _floats(self.above), _floats(self.below))

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
        step[forces : forces + 1] = force
        for age in range(1, oldest):
            step[forces + age, forces + age - 1] = 1
        return step


def is_growing(loop: TransitionMatrices, delays: Delays) -> bool:
    """True if a motion is proved to grow with delays in turn, of a loop in balls."""
    with working_precision(_BITS):
        steps = [flint.arb_mat(step.tolist()) for step in loop.steps(delays)]
        turn = reduce(lambda total, step: step * total, steps)
        return are_inside(Factored(turn.charpoly())) is False


@lru_cache
def _held(device: Device, sample_time: float, start: float) -> Held:
    with working_precision(_BITS):
        sample = one_sample(device, sample_time)
        states, force = states_and_force(sample.held(flint.arb(1 - exact(start))))
        return np.array(states.tolist()), np.array(force.entries()), np.array(sample.above)


@lru_cache
def _held_in_floats(device: Device, sample_time: float, start: float) -> Held:
    transition, push, position = map(_floats, _held(device, sample_time, start))
    return transition, push, position


def _floats(balls: np.ndarray) -> np.ndarray:
    return np.array([float(ball.mid()) for ball in balls.ravel()]).reshape(balls.shape)
