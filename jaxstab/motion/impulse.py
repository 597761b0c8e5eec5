"""Sums of moduli of impulse responses, |C b| + |C A b| + |C A^2 b| + ..., proved from above.

In coordinates in which every sample is a contraction the errors of products do not grow, so sums,
their rounding and their tails can be bounded even next to the boundary of stability (lemmas M3 to
M5 of docs/proofs.md).
"""

from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.motion.contraction import (
    SAFETY,
    Contraction,
    Matrices,
    PerLoop,
    Systems,
    columns,
    contraction,
    decay,
    error_of_square,
    lost_in,
    norm,
    rows,
    transposed,
)

_ROUNDING = 2.0**-53
_TAIL = 1e-11  # the norm of a power behind which a sum ends
_FURTHER = 6  # doublings until then, at most
_SUMMED = 22  # doublings, beyond which the tail is bounded as it is
_STEEP = 0.5  # the norm of a power of which no square gives a better bound of the tail
_TRIED = 20  # such squares
_NUMBERS = 1 << 21  # of an array that is filled at once, about


def impulse_sums(systems: Systems) -> Float64[np.ndarray, "loop output input"]:
    """Return upper bounds of the sums of |C A^k b| over k >= 0; infinite where none is proved."""
    new = contraction(systems)
    sums = np.full((len(new.doublings), new.outputs.shape[1], new.inputs.shape[2]), np.inf)
    with np.errstate(all="ignore"):
        for doublings in np.unique(new.doublings[new.doublings >= 0]).tolist():
            for some in _parts(new, doublings):
                sums[some] = _sums(new.chosen(some), doublings)
    return sums


def _parts(new: Contraction, doublings: int) -> list[np.ndarray]:
    """Cut loops so that the vectors of each part fill no more memory than they may."""
    alike = np.flatnonzero(new.doublings == doublings)
    longest = 2.0 ** (0.5 * min(doublings + _FURTHER, _SUMMED))
    width = longest * (new.inputs.shape[2] + new.outputs.shape[1])
    count = ceil(len(alike) * new.inputs.shape[1] * width / _NUMBERS)
    return np.array_split(alike, min(count, len(alike)))


def _sums(new: Contraction, doublings: int) -> Float64[np.ndarray, "loop output input"]:
    """Return the bounds of systems of which A was squared equally often."""
    power, error, lost = new.transition, new.transition_error, lost_in(new.transition)
    levels: list[tuple[Matrices, PerLoop]] = []
    most = min(doublings + _FURTHER, _SUMMED)
    while len(levels) < most and not (levels and np.all(norm(power) <= _TAIL)):
        levels.append((power, error))
        power, error = power @ power, error_of_square(power, error)
    half = len(levels) // 2
    late = _Family.begun(transposed(new.outputs), new.outputs_error)
    early = _Family.begun(new.inputs, new.inputs_error)
    for level in levels[:half]:
        late = late.doubled(transposed(level[0]), level[1])
    for level in levels[half:]:
        early = early.doubled(*level)
    sums = _sum_of_moduli(late.vectors, early.vectors, new.outputs.shape[1], new.inputs.shape[2])
    sums *= 1.0 + 2.0 ** (len(levels) + 1) * _ROUNDING
    one, two = late.size[:, :, None], early.size[:, None, :]
    one_error, two_error = late.error[:, :, None], early.error[:, None, :]
    wrong = one_error * (two + two_error) + one * two_error + lost[:, None, None] * one * two
    behind = np.minimum(new.norms, _sum_of_norms(power, error, 2.0 ** len(levels)))
    return sums + SAFETY * (wrong + _tail(new, *levels[-1]) * behind[:, None, None])


def _tail(new: Contraction, power: Matrices, error: PerLoop) -> Float64[np.ndarray, "_ _ _"]:
    """Return bounds of |c A^h| |A^h b| for a power A^h.

    The power is applied from either side, so that only what is slow is left of rows and columns.
    """
    norms, error = decay(power, error)[:, None], error[:, None]
    late = rows(new.outputs @ power) + norms * new.outputs_error
    late += error * (rows(new.outputs) + new.outputs_error)
    early = columns(power @ new.inputs) + norms * new.inputs_error
    early += error * (columns(new.inputs) + new.inputs_error)
    return late[:, :, None] * early[:, None, :]


def _sum_of_norms(power: Matrices, error: PerLoop, length: float) -> PerLoop:
    """Return bounds of |1| + |A| + |A^2| + ... by A^length (M4); infinite where none is proved."""
    total = np.full(len(power), np.inf)
    for _ in range(_TRIED):
        size = decay(power, error)
        total = np.where(size < 1.0, np.minimum(total, length / (1.0 - size)), total)
        if np.all(size <= _STEEP):
            break
        power, error, length = power @ power, error_of_square(power, error), 2.0 * length
    return total


class _Family(NamedTuple):
    """Vectors v, A v, A^2 v, ... of several v, the sums of their norms, and of their errors."""

    vectors: Matrices  # side by side, those of one power together
    size: Float64[np.ndarray, "loop vector"]
    error: Float64[np.ndarray, "loop vector"]

    @classmethod
    def begun(cls, vectors: Matrices, error: np.ndarray) -> "_Family":
        """Return the vectors alone."""
        return cls(vectors, columns(vectors), error)

    def doubled(self, power: Matrices, error: PerLoop) -> "_Family":
        """Return as many again, by a power and a bound of its error (lemma M5)."""
        further = power @ self.vectors
        shape = (*further.shape[:2], -1, self.size.shape[1])
        size = self.size + np.sum(columns(further).reshape(shape[0], *shape[2:]), axis=1)
        lost = (error + lost_in(power) * norm(power))[:, None]
        wrong = self.error * (1.0 + decay(power, error)[:, None]) + lost * (self.size + self.error)
        return _Family(np.concatenate([self.vectors, further], axis=2), size, SAFETY * wrong)


def _sum_of_moduli(
    late: Matrices, states: Matrices, outputs: int, inputs: int
) -> Float64[np.ndarray, "loop output input"]:
    """Return the sums of the moduli of all products of an output and of an input."""
    loops, _, width = late.shape
    late = transposed(late)
    total = np.zeros((loops, outputs, inputs))
    length = inputs * max(1, _NUMBERS // (loops * width * inputs))
    for part in range(0, states.shape[2], length):
        terms = np.abs(late @ states[:, :, part : part + length])
        total += terms.reshape(loops, width // outputs, outputs, -1, inputs).sum(axis=(1, 3))
    return total
