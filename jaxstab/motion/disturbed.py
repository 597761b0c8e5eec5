"""Disturbed sampled loops: what errors of the encoder and of the force, and friction, do.

What a unit of each does at the samples is a sum of moduli of an impulse response (lemmas M6 and M7
of docs/proofs.md).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, namespace
from jaxstab.motion.contraction import Matrices, Systems
from jaxstab.motion.controller import Bank
from jaxstab.motion.impulse import impulse_sums
from jaxstab.motion.state_space import (
    DIFFERENCE,
    FORCE,
    POSITION,
    VELOCITY,
    groups,
    steps_of,
)

PerLoop = Float64[np.ndarray, " loop"]

_NUMBERS = 1 << 18  # of the matrices of all loops that are looked at together
_ROUNDING = 2.0**-53
_ROUNDINGS = 16  # of an entry of the transition, beside those of filters (lemma M7)
_HARD = 8.0  # roundings of 1: the error of a transition of which an entry may nearly vanish
_ACCURATE_GAMMA, _ACCURATE_DELTA = 0.5, 1.0  # up to which no entry of it nearly vanishes
_SAFETY = 1.0 + 2.0**-40  # on sums of a few bounds


class Causes(NamedTuple):
    """The kinds of disturbances: of the sampled position, of the computed force, of the device."""

    position: bool
    force: bool
    friction: bool


class Gains(NamedTuple):
    """The most that one disturbance of size 1 does at the samples.

    middle: of the velocity where the delayed force changes, between two samples.
    """

    position: Array
    velocity: Array
    force: Array
    middle: Array


def gains_of_disturbances(*lanes: Array, bank: Bank, causes: Causes) -> tuple[Gains, Gains, Gains]:
    """Return what a unit of each disturbance does; infinite where nothing is proved.

    The lanes hold alpha, beta, the entries (2, 4) of the propagator of a sample, the entries (3) of
    the velocity in the middle, gamma, delta and the whole delay. What is not asked for is 0.
    """
    columns = np.array([np.ravel(lane) for lane in lanes])
    gains = np.zeros((3, 4, columns.shape[1]))
    whole_delay, is_any = columns[-1], np.ones(columns.shape[1], bool)
    for whole, some in groups(whole_delay, is_any, len(bank.steps), _NUMBERS):
        loops = _Loops.of(columns[:, some])
        sums = impulse_sums(_systems(loops, whole, bank, causes))
        gains[:, :, some] = _gains(sums, loops, causes)
    one, two, three = gains.reshape(3, 4, *lanes[0].shape)
    return Gains(*one), Gains(*two), Gains(*three)


def throw(gamma: Array, delta: Array) -> Array:
    """Return a bound of how far a unit impulse moves the device within a sample (lemma M7)."""
    xp = namespace(gamma, delta)
    return 1.0 / xp.maximum(1.0, xp.maximum(delta, xp.sqrt(gamma)))


def path(delta: Array) -> Array:
    """Return a bound of the path of a device within a sample after a unit impulse (lemma M7)."""
    xp = namespace(delta)
    return 1.0 / xp.sqrt(xp.maximum(1.0, 2.0 * delta))


def drag(gamma: Array, delta: Array) -> Array:
    """Return a bound of the device's acceleration after a unit impulse (lemma M7)."""
    xp = namespace(gamma, delta)
    return delta + xp.minimum(gamma, xp.sqrt(gamma))


class _Loops(NamedTuple):
    """Loops side by side: gains, propagators of a sample, velocities in the middle, plants."""

    alpha: PerLoop
    beta: PerLoop
    rows: Float64[np.ndarray, "loop 2 4"]
    middle: Float64[np.ndarray, "loop 3"]
    gamma: PerLoop
    delta: PerLoop

    @classmethod
    def of(cls, columns: Float64[np.ndarray, "lane loop"]) -> "_Loops":
        """Return the loops of lanes."""
        rows = np.ascontiguousarray(columns[2:10].T).reshape(-1, 2, 4)
        return cls(columns[0], columns[1], rows, columns[10:13].T, columns[13], columns[14])

    def sizes(self) -> tuple[Float64[np.ndarray, "loop 2 4"], Float64[np.ndarray, "loop 3"]]:
        """Return the sizes to which the errors of the propagators are relative (lemma M7)."""
        is_hard = (self.gamma > _ACCURATE_GAMMA) | (self.delta > _ACCURATE_DELTA)
        hard = np.where(is_hard, _HARD, 0.0)[:, None]
        rows, middle = np.abs(self.rows), np.abs(self.middle) + hard
        rows[:, :, 2] += 2.0 * rows[:, :, 3]  # the acting force's is a difference
        rows += hard[:, :, None]
        stiff = hard[:, 0] * np.sqrt(self.gamma)
        rows[:, 1, 0] += stiff
        middle[:, 0] += stiff
        return rows, middle


def _systems(loops: _Loops, whole_delay: int, bank: Bank, causes: Causes) -> Systems:
    """Return the loops with inputs: encoder, computed force, and three of a push on the device.

    The difference is that to the last position *as it was read*: so an error that was read with it
    is in the state, and need not be remembered beside it.
    """
    alpha, beta, rows, middle, *_ = loops
    row_sizes, middle_sizes = loops.sizes()
    step = with_inputs(-alpha, -beta, rows, bank.outputs, bank.steps, whole_delay)
    size = step.shape[1]
    step[:, DIFFERENCE, size] -= 1.0
    sizes = with_inputs(np.abs(alpha), np.abs(beta), row_sizes, *bank.sizes, whole_delay)
    sizes[:, DIFFERENCE, [POSITION, size]] += [2.0, 1.0]  # the modulus of -1, for the difference
    step = np.concatenate([step, _pushes(rows, size)], axis=2)
    sizes = np.concatenate([sizes, _pushes(row_sizes, size)], axis=2)
    outputs = np.zeros((alpha.size, 4, size))
    outputs[:, [0, 1, 2], [POSITION, VELOCITY, FORCE]] = 1.0
    output_sizes = outputs.copy()
    outputs[:, 3, [POSITION, VELOCITY, FORCE]] = middle
    output_sizes[:, 3, [POSITION, VELOCITY, FORCE]] = middle_sizes
    is_wanted = np.array([True] * size + [*causes[:2], *causes[2:] * 3])
    which = slice(4 if np.any(middle[:, 2]) else 3)
    return Systems(
        transition=step[:, :, :size],
        inputs=step[:, :, is_wanted][:, :, size:],
        outputs=outputs[:, which],
        sizes=sizes[:, :, is_wanted],
        output_sizes=output_sizes[:, which],
        error=(_ROUNDINGS + bank.roundings) * _ROUNDING,
    )


def with_inputs(
    alpha: PerLoop,
    beta: PerLoop,
    rows: Matrices,
    outputs: np.ndarray,
    steps: np.ndarray,
    whole_delay: int,
) -> Matrices:
    """Return the steps of loops with two more inputs: the reading error, and an extra push."""
    wall = alpha[:, None] * outputs[0] + beta[:, None] * outputs[1]
    wall = np.column_stack([wall, wall[:, 0] + wall[:, 1], np.ones(len(wall))])
    remembered = np.column_stack([steps, steps[:, 0] + steps[:, 1], np.zeros(len(steps))])
    return steps_of(wall, rows, remembered, whole_delay)


def _pushes(rows: Matrices, size: int) -> Matrices:
    """Return what unit impulses do to the state: a hit, a displacement, and a hit a sample ago."""
    pushes = np.zeros((len(rows), size, 3))
    pushes[:, VELOCITY, 0] = 1.0
    pushes[:, [POSITION, DIFFERENCE], 1] = 1.0
    pushes[:, [POSITION, DIFFERENCE], 2] = rows[:, 0, [1]]
    pushes[:, VELOCITY, 2] = rows[:, 1, 1]
    return pushes


def _gains(
    sums: Float64[np.ndarray, "loop output input"], loops: _Loops, causes: Causes
) -> Float64[np.ndarray, "3 4 loop"]:
    gains = np.zeros((3, 4, len(sums)))
    columns = np.moveaxis(sums, 0, 2)
    which = slice(columns.shape[0])
    simple = [number for number, cause in enumerate(causes[:2]) if cause]
    for place, number in enumerate(simple):
        gains[number, which] = columns[:, place]
    if causes.friction:
        hit, moved, ended = np.moveaxis(columns[:, len(simple) :], 1, 0)
        gains[2, which] = _of_friction(hit, moved, ended, loops)
    return gains


def _of_friction(
    hit: Float64[np.ndarray, "output loop"],
    moved: Float64[np.ndarray, "output loop"],
    ended: Float64[np.ndarray, "output loop"],
    loops: _Loops,
) -> Float64[np.ndarray, "output loop"]:
    """Return the integrals over all times of what unit impulses do, at most (lemma M7)."""
    gamma, delta = loops.gamma, loops.delta
    bent = drag(gamma, delta)
    curved = 0.5 * (hit + ended) + (moved * bent + hit * (delta * bent + gamma)) / 12.0
    thrown = moved * np.minimum(0.5, throw(gamma, delta)) + hit * path(delta)
    return _SAFETY * np.minimum(curved, thrown)
