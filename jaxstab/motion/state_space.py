"""Sampled loops as state spaces, many side by side: the state moves by one matrix per sample.

The state: position, its difference to the last one that was read, velocity (or what other states a
plant has), the acting force, those on their way, the next one to arrive first, and what the filters
remember.
"""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import is_any_traced, leaves
from jaxstab.model.filters import Filters
from jaxstab.motion.contraction import Matrices
from jaxstab.motion.controller import PLAIN, Bank, Controller, bank_of

POSITION, DIFFERENCE, VELOCITY, FORCE = range(4)  # the first entries of the state, of one mass


def bank_for(filters: Filters | None, sample_time: float = 1.0) -> Bank:
    """Return the matrices of an estimator and a filter for a sampling period.

    Raises:
        TypeError: a filter is traced.
    """
    if filters is None:
        return PLAIN
    if is_any_traced(filters):
        raise TypeError(
            "a filter is traced; this is computed outside of JAX: give filters of concrete numbers."
        )
    is_plain = all(isinstance(leaf, float | int) for leaf in leaves(filters))
    bank = _remembered_bank if is_plain else _bank
    return bank(filters, sample_time)


def _bank(filters: Filters, sample_time: float) -> Bank:
    return bank_of(Controller.of(filters, sample_time))


_remembered_bank = lru_cache(maxsize=64)(_bank)  # one loop is asked about many walls


def steps_of(
    wall: Float64[np.ndarray, "loop known"],
    rows: Float64[np.ndarray, "loop plant column"],
    remembered: Float64[np.ndarray, "memory known"],
    whole_delay: int,
) -> Matrices:
    """Return the matrix of the next state (rows) from the state and the inputs (columns).

    Args:
        wall: the force that is computed, of position, difference, what is remembered, and inputs.
        rows: the plant's states at the next sample, position first, of those at this one, of the
            acting force, and of the one that arrives.
        remembered: the next memory of the filters, from the same columns as the force.
        whole_delay: of the force, in samples.
    """
    states = rows.shape[1]
    plant = [POSITION, *range(VELOCITY, states + 1)]
    first, last = states + 1, states + 1 + whole_delay  # of the forces
    size = last + 1 + len(remembered)
    inputs = wall.shape[1] - 2 - len(remembered)
    known = [POSITION, DIFFERENCE, *range(last + 1, size + inputs)]
    step = np.zeros((len(wall), size, size + inputs))
    step[:, range(first, last), range(first + 1, last + 1)] = 1.0
    step[:, last, known] = wall
    motion = rows[:, :, -1:] * step[:, [first]]  # the force that arrives is the next one to act
    motion[:, :, [*plant, first]] += rows[:, :, :-1]
    step[:, plant] = motion
    step[:, DIFFERENCE] = motion[:, 0]
    step[:, DIFFERENCE, POSITION] -= 1.0
    step[:, last + 1 :, known] = remembered
    return step


def groups(
    whole_delay: np.ndarray, is_hopeful: np.ndarray, memory: int, numbers: int
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield whole delays and the loops that have them, in groups of limited memory."""
    for whole in np.unique(whole_delay):
        together = np.flatnonzero((whole_delay == whole) & is_hopeful)
        count = max(1, int(numbers // (FORCE + 1 + whole + memory) ** 2))
        for begin in range(0, together.size, count):
            yield int(whole), together[begin : begin + count]
