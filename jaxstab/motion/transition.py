"""Loops without inputs, as matrices: the deviation from rest follows s -> A s from s_0 on."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.model.device.mechanics import Mechanics
from jaxstab.motion.contraction import Matrices, Systems
from jaxstab.motion.controller import PLAIN, Bank
from jaxstab.motion.state_space import DIFFERENCE, FORCE, POSITION, VELOCITY, steps_of

Lanes = Float64[np.ndarray, " loop"]


class Loops(NamedTuple):
    """Loops side by side whose delays have the same whole part: s -> A s, from s_0 on.

    The position, the first state, is in units of the final displacement, or of the velocity.
    """

    transition: Matrices
    start: Float64[np.ndarray, "loop state 1"]

    def systems(self) -> Systems:
        """Return the loops with the start as their input and the position as their output."""
        outputs = np.zeros((len(self.start), 1, self.start.shape[1]))
        outputs[:, 0, POSITION] = 1.0
        sizes = np.abs(np.concatenate(self, axis=2))
        return Systems(self.transition, self.start, outputs, sizes, outputs, error=0.0)


def loops_of(
    alpha: Lanes,
    beta: Lanes,
    entries: Float64[np.ndarray, "8 loop"],
    whole_delay: int,
    excitation: str,
    bank: Bank = PLAIN,
) -> Loops:
    """Return the loops of gains and of the entries (2, 4) of their propagators."""
    rows = np.moveaxis(entries.reshape(2, 4, -1), -1, 0)
    step = steps_of(_wall(alpha, beta, bank), rows, bank.steps, whole_delay)
    last = FORCE + whole_delay
    start = np.zeros(step.shape[:2])
    if excitation == "impact":
        start[:, VELOCITY] = 1.0
    else:
        start[:, POSITION], start[:, FORCE : last + 1] = -1.0, _gain(bank) * alpha[:, None]
        start[:, last + 1 :] = -bank.at_rest
    return Loops(step, start[..., None])


def device_loops(
    stiffness: Lanes,
    damping: Lanes,
    moves: Mechanics,
    whole_delay: int,
    excitation: str,
    bank: Bank = PLAIN,
) -> Loops:
    """Return the loops of gains, K in N/m and B/T in N/m, at a general device, in SI units."""
    states = len(moves.at_rest)
    first, last = states + 1, states + 1 + whole_delay  # of the forces
    plant = [0, *range(2, states + 1)]
    rows = np.broadcast_to(moves.rows[-1, :, :-1], (stiffness.size, states, states + 2))
    step = steps_of(_wall(stiffness, damping, bank), rows, bank.steps, whole_delay)
    start = np.zeros(step.shape[:2])
    if excitation == "impact":
        start[:, plant] = moves.blow
        start[:, DIFFERENCE] = moves.blow[POSITION]  # where a blow moves the device at once
    else:
        wall = _gain(bank) * stiffness[:, None]  # less the force at rest
        start[:, plant] = np.where(moves.follows, wall, -moves.at_rest)
        start[:, first : last + 1] = wall
        start[:, last + 1 :] = -bank.at_rest
    return Loops(step, start[..., None])


def _wall(stiffness: Lanes, damping: Lanes, bank: Bank) -> Float64[np.ndarray, "loop known"]:
    """Return the force of walls, of position, difference and what the filters remember."""
    felt, estimated = bank.outputs
    return -(stiffness[:, None] * felt + damping[:, None] * estimated)


def _gain(bank: Bank) -> float:
    """Return the gain of the position filter at rest."""
    return float(bank.outputs[0] @ np.array([1.0, 0.0, *bank.at_rest]))
