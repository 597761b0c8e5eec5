"""Sampled positions of many loops side by side, in stretches that are doubled by powers of A."""

from math import ceil, log2
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.motion.contraction import Matrices
from jaxstab.motion.transition import Loops

STRETCH = 32  # samples, a power of two
_BLOCK = 64  # stretches of one product, a power of two


def positions(loops: Loops, samples: int) -> Float64[np.ndarray, "loop sample"]:
    """Return the sampled deviations of loops, at least as many as asked for."""
    outputs = np.zeros((len(loops.start), 1, loops.start.shape[1]))
    outputs[:, 0, 0] = 1.0
    motion = Motion.begun(outputs, *loops)
    found = [motion.latest()]
    known = motion.samples
    while known < samples:
        blocks = ceil((samples - known) / (STRETCH * _BLOCK))
        motion = motion._replace(states=motion.states[:, : blocks * _BLOCK]).doubled()
        found.append(motion.latest())
        known += found[-1].shape[1]
    return np.concatenate(found, axis=1)


class Motion(NamedTuple):
    """The motion of loops over M stretches of W samples."""

    rows: Float64[np.ndarray, "loop sample state"]  # of the position, times A^i, i < W
    power: Matrices  # A^(MW)
    states: Float64[np.ndarray, "loop stretch state"]  # at the beginning of each stretch

    @classmethod
    def begun(cls, outputs: Matrices, power: Matrices, start: Matrices) -> "Motion":
        """Return the first stretch."""
        rows = outputs
        for _ in range(int(log2(STRETCH))):
            rows = np.concatenate([rows, rows @ power], axis=1)
            power = power @ power
        return cls(rows, power, np.swapaxes(start, 1, 2))

    @property
    def samples(self) -> int:
        """How many samples of each loop are known."""
        return self.states.shape[1] * STRETCH

    def latest(self) -> Float64[np.ndarray, "loop sample"]:
        """Return the positions in the second half of the stretches; all, if there is but one."""
        states = self.states[:, self.states.shape[1] // 2 :]
        return _mapped(self.rows, states).reshape(len(self.power), -1)

    def doubled(self) -> "Motion":
        """Return twice as many stretches."""
        states = np.concatenate([self.states, _mapped(self.power, self.states)], axis=1)
        return self._replace(power=self.power @ self.power, states=states)

    def chosen(self, which: Any) -> "Motion":
        """Return the motion of some of the loops."""
        return Motion(*(field[which] for field in self))


def _mapped(matrices: Matrices, states: np.ndarray) -> Float64[np.ndarray, "loop stretch row"]:
    """Return the products of each loop's matrix and its states.

    They are taken in blocks that BLAS does not share out to threads, which for matrices as small as
    these wait for each other longer than they work.
    """
    loops, stretches, size = states.shape
    blocks = states.reshape(loops, -1, min(stretches, _BLOCK), size)
    return (blocks @ np.swapaxes(matrices, 1, 2)[:, None]).reshape(loops, stretches, -1)
