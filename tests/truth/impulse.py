"""Impulse responses of sampled loops to 50 digits, from the difference equations of the filters.

Nothing is shared with jaxstab: the plant is an exponential of a matrix, a filter its definition.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from mpmath import mp, mpf

DIGITS = 50
Taps = tuple[list[mpf], list[mpf]]  # of inputs and of outputs, from the present one backwards


def difference(samples: int) -> Taps:
    """(u_k - u_(k-n)) / n."""
    return [mpf(1) / samples, *[mpf(0)] * (samples - 1), -mpf(1) / samples], [mpf(1)]


def average(samples: int) -> Taps:
    """The mean of the last n."""
    return [mpf(1) / samples] * samples, [mpf(1)]


def smoothing(factor: float) -> Taps:
    """y = (1 - a) y_before + a u."""
    return [mpf(factor)], [mpf(1), mpf(factor) - 1]


def low_pass(pole: float) -> Taps:
    """One pole, gain 1 at rest."""
    return [1 - mpf(pole)], [mpf(1), -mpf(pole)]


@dataclass
class _Running:
    taps: Taps
    inputs: list[mpf] = field(default_factory=list)
    outputs: list[mpf] = field(default_factory=list)

    def step(self, value: mpf) -> mpf:
        above, below = self.taps
        self.inputs = [value, *self.inputs][: len(above)]
        result = mp.fsum(b * u for b, u in zip(above, self.inputs, strict=False))
        result -= mp.fsum(a * y for a, y in zip(below[1:], self.outputs, strict=False))
        self.outputs = [result / below[0], *self.outputs][: len(below)]
        return self.outputs[0]


@dataclass(frozen=True)
class ExactLoop:
    """A loop for T = m = 1, with chains of filters for velocity and position."""

    alpha: float
    beta: float
    gamma: float
    delta: float
    delay: float
    velocity: Sequence[Taps] = ()
    position: Sequence[Taps] = ()

    def _moved(self, time: mpf) -> mp.matrix:
        rates = mp.matrix([[0, 1, 0], [-mpf(self.gamma), -mpf(self.delta), 1], [0, 0, 0]])
        return mp.expm(rates * time)

    def response(
        self, samples: int, *, error: float = 0.0, pushed: float = 0.0, impulse: float | None = None
    ) -> Iterator[tuple[mpf, mpf, mpf]]:
        """Position, velocity and acting force at the samples from 1 on.

        At sample 0 the position is misread by an error and the computed force pushed; an impulse
        hits the device so many samples before sample 1.
        """
        with mp.workdps(DIGITS):
            whole = int(self.delay)
            fraction = mpf(self.delay) - whole
            early, late = self._moved(fraction), self._moved(1 - fraction)
            chains = [
                [_Running(taps) for taps in chain] for chain in (self.velocity, self.position)
            ]
            x = v = acting = mpf(0)
            queue = [mpf(0)] * whole
            for sample in range(samples):
                read = x + (mpf(error) if sample == 0 else 0)
                outputs = []
                for chain in chains:
                    value = read
                    for one in chain:
                        value = one.step(value)
                    outputs.append(value)
                force = -(mpf(self.alpha) * outputs[1] + mpf(self.beta) * outputs[0])
                queue.append(force + (mpf(pushed) if sample == 0 else 0))
                arriving = queue.pop(0)
                state = early * mp.matrix([x, v, acting])
                state = late * mp.matrix([state[0], state[1], arriving])
                x, v, acting = state[0], state[1], arriving
                if sample == 0 and impulse is not None:
                    hit = self._moved(mpf(impulse))
                    x, v = x + hit[0, 1], v + hit[1, 1]
                yield x, v, acting

    def sums(self, samples: int, **cause: float) -> list[mpf]:
        """Sums of the moduli of position, velocity and force over so many samples."""
        with mp.workdps(DIGITS):
            totals = [mpf(0)] * 3
            for values in self.response(samples, **cause):
                totals = [total + abs(value) for total, value in zip(totals, values, strict=True)]
            return totals
