"""Loops whose delay moves, in time: an exact hold on parts of a sample, by scipy's exponential.

A sample is divided into equal parts, and delays are whole numbers of parts. Within a part the force
is constant and the motion exact; the newest sample that has arrived sets the force. Many sequences
run side by side. Nothing is shared with jaxstab: the controller is written out as a difference
equation, the device as matrices of mass, damper and spring, or of numerator and denominator.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.signal import tf2ss

LOST = -1  # instead of a delay


@dataclass(frozen=True)
class Moving:
    """A device n(s)/d(s), sampled every T, with a velocity over a window and then a low pass.

    numerator, denominator: of position over force, highest power of s first, SI units.
    window: of the difference, in samples.
    smoothing: q of the low pass (1 - q) z / (z - q) of the velocity; 0 for none.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    sample_time: float
    window: int = 1
    smoothing: float = 0.0
    parts: int = 8

    def positions(
        self,
        stiffness: float | np.ndarray,
        damping: float | np.ndarray,
        delays: np.ndarray,
        seed: int = 0,
        *,
        rest: bool = False,
    ) -> np.ndarray:
        """Positions at the samples, (sequence, sample), from random states on.

        With ``rest`` the device had been at its first position before, as the controller sees it.

        ``delays`` are whole numbers of parts, (sequence, sample), or LOST; stiffness and damping
        may differ by sequence.
        """
        a, b, c, _ = tf2ss(self.numerator, self.denominator)
        order, part = len(a), self.sample_time / self.parts
        whole = expm(np.block([[a, b], [np.zeros((1, order + 1))]]) * part)
        count, samples = delays.shape
        random = np.random.default_rng(seed)
        states = random.standard_normal((order, count))
        states /= np.maximum(np.abs(c).T, 1e-9) + np.linalg.norm(c)
        past = np.repeat(c @ states, self.window, axis=0) * rest
        velocity = np.zeros(count)
        newest = np.full(count, -1)
        forces = np.zeros((samples + 1, count))  # the last one acts before any has arrived
        positions = np.empty((samples, count))
        arrivals = np.where(delays == LOST, np.iinfo(np.int64).max, delays)
        arrivals = arrivals + np.where(delays == LOST, 0, np.arange(samples) * self.parts)
        oldest = int(delays.max()) // self.parts + 2
        lanes = np.arange(count)
        for sample in range(samples):
            x = (c @ states)[0]
            difference = (x - past[sample % self.window]) / (self.window * self.sample_time)
            past[sample % self.window] = x
            velocity = self.smoothing * velocity + (1.0 - self.smoothing) * difference
            forces[sample] = -(stiffness * x + damping * velocity)
            positions[sample] = x
            for step in range(self.parts):
                now = sample * self.parts + step
                for one in range(max(0, sample - oldest), sample + 1):
                    has_arrived = arrivals[:, one] == now
                    newest = np.where(has_arrived & (one > newest), one, newest)
                states = whole[:order, :order] @ states
                states = states + whole[:order, order:] * forces[newest, lanes]
        return positions.T


def growth(positions: np.ndarray, turn: int) -> np.ndarray:
    """Growth per sample of sequences that repeat, from the last two quarters of the samples."""
    samples = positions.shape[1]
    length = max(turn, (samples // 4) // turn * turn)
    late = np.abs(positions[:, samples - length :]).max(axis=1)
    early = np.abs(positions[:, samples - 2 * length : samples - length]).max(axis=1)
    return (late / early) ** (1.0 / length)
