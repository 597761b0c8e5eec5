"""Loops without inputs, as matrices: the deviation from rest follows s -> A s from s_0 on."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.model.device.mechanics import Mechanics
from jaxstab.motion.controller import PLAIN, Bank
from jaxstab.motion.state_space import (
    FORCE,
    POSITION,
    VELOCITY,
    Matrices,
    steps_of,
    units_of,
)

_POWERS = 11  # of A that are made small: A, A^2, A^4 ...
_SWEEPS = 8  # that look for units
_SMALLEST = 1e-30  # of the units

Lanes = Float64[np.ndarray, " loop"]


class Loops(NamedTuple):
    """Loops side by side whose delays have the same whole part: s -> A s, from s_0 on.

    The state is given in units of its own; that of the position is the final displacement, or
    velocity.
    """

    transition: Matrices
    start: Float64[np.ndarray, "loop state 1"]


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
    units = units_of(np.abs(alpha) + np.abs(entries[4]), whole_delay, bank)
    last = FORCE + whole_delay
    start = np.zeros(step.shape[:2])
    if excitation == "impact":
        start[:, VELOCITY] = 1.0
    else:
        start[:, POSITION], start[:, FORCE : last + 1] = -1.0, _gain(bank) * alpha[:, None]
        start[:, last + 1 :] = -bank.at_rest
    return _in_units(step, start, units)


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
    else:
        wall = _gain(bank) * stiffness[:, None]  # less the force at rest
        start[:, plant] = np.where(moves.follows, wall, -moves.at_rest)
        start[:, first : last + 1] = wall
        start[:, last + 1 :] = -bank.at_rest
    return Loops(step, start[..., None])


def balanced(loops: Loops) -> Loops:
    """Return the same loops in units, powers of two, in which powers of A have small norms."""
    return _in_units(loops.transition, loops.start[..., 0], balance(loops.transition))


def _in_units(step: Matrices, start: np.ndarray, units: np.ndarray) -> Loops:
    transition = step * units[:, None, :] / units[:, :, None]
    return Loops(transition, (start / units)[..., None])


def _wall(stiffness: Lanes, damping: Lanes, bank: Bank) -> Float64[np.ndarray, "loop known"]:
    """Return the force of walls, of position, difference and what the filters remember."""
    felt, estimated = bank.outputs
    return -(stiffness[:, None] * felt + damping[:, None] * estimated)


def _gain(bank: Bank) -> float:
    """Return the gain of the position filter at rest."""
    return float(bank.outputs[0] @ np.array([1.0, 0.0, *bank.at_rest]))


def balance(step: Matrices) -> Float64[np.ndarray, "loop state"]:
    """Return powers of two, the first one 1, in whose units all powers of A are nearly small.

    The unit of a state is how large it becomes, after 1, 2, 4 ... samples, from other states of
    unit size; repeated, this comes close to the units with the smallest norms. Any units are
    correct, but these lose least to the bounds of rounding.
    """
    units = np.ones(step.shape[:2])
    sizes, power = [], step
    with np.errstate(all="ignore"):  # what grows overflows
        for _ in range(_POWERS):
            sizes.append(np.abs(power))
            power = power @ power
        for sweep in range(_SWEEPS):
            largest = np.max([(size @ units[:, :, None])[:, :, 0] for size in sizes], axis=0)
            mixed = largest if sweep < _SWEEPS // 2 else np.sqrt(largest * units)
            units = np.maximum(mixed / mixed.max(axis=1, keepdims=True), _SMALLEST)
    units = np.exp2(np.rint(np.log2(np.where(np.isfinite(units), units, 1.0))))
    return units / units[:, :1]
