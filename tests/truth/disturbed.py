"""Loops with a quantised encoder, a quantised force and friction, simulated many runs at a time.

The encoder rounds to the nearest multiple of 1 (from a phase of its own in each run), friction is a
force that is constant over a part of a sample. Nothing is shared with jaxstab: the plant is an
exponential of a matrix, a filter its difference equation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from tests.truth.march import Plant, Taps

PARTS = 4  # of a sample between events: as many moments are looked at


@dataclass(frozen=True)
class Disturbed:
    """A loop for T = m = 1, with chains of filters for velocity and position.

    ``device`` is in place of gamma and delta where it is given, in units of one sample.
    """

    wall: tuple[float, float]
    plant: tuple[float, float, float]
    velocity: Sequence[Taps]
    position: Sequence[Taps]
    device: Plant | None = None

    @property
    def motion(self) -> Plant:
        """The equations of motion."""
        if self.device is not None:
            return self.device
        gamma, delta, _ = self.plant
        force = np.array([0.0, 1.0])
        return Plant(np.array([[0.0, 1.0], [-gamma, -delta]]), force, force, np.array([1.0, 0.0]))


@dataclass(frozen=True)
class Disturbance:
    """What disturbs: rounding of position and force, a friction; given signals instead of these.

    errors, pushes: of position and force at each sample (samples, runs), in place of rounding.
    rubs: forces on the device in each part of each sample (samples, parts, runs).
    """

    phase: np.ndarray | None = None
    force_step: float = 0.0
    friction: float = 0.0
    errors: np.ndarray | None = None
    pushes: np.ndarray | None = None
    rubs: np.ndarray | None = None


def largest(
    loop: Disturbed, disturbance: Disturbance, start: np.ndarray, samples: int, since: int = 0
) -> np.ndarray:
    """How far runs are from undisturbed ones, at most, after a sample: (3, runs).

    Position, velocity and force; both start with position and velocity (2, runs), and with filters
    that remember nothing.
    """
    runs, still = _Runs(loop, disturbance, start), _Runs(loop, Disturbance(), start)
    worst = np.zeros((3, start.shape[1]))
    for sample in range(samples):
        for state, other in zip(runs.sample(sample), still.sample(sample), strict=True):
            if sample >= since:
                np.maximum(worst, np.abs(state - other), out=worst)
    return worst


def responses(loop: Disturbed, disturbance: Disturbance, runs: int, samples: int) -> np.ndarray:
    """Position, velocity and force at the ends of parts, from rest: (samples, parts, 3, runs)."""
    states = _Runs(loop, disturbance, np.zeros((len(loop.motion.c), runs)))
    return np.array([list(states.sample(sample)) for sample in range(samples)])


def parts_of(loop: Disturbed) -> int:
    """How many parts a sample has."""
    return PARTS * (1 + (loop.plant[2] % 1.0 > 0.0))


def worst_signals(loop: Disturbed, samples: int, sizes: tuple[float, float, float]) -> np.ndarray:
    """The largest position, velocity and force that signals of such sizes reach: (parts, 3).

    Errors, pushes and friction have the sign of the response to them, backwards in time; friction
    is constant over a part of a sample, so that what it could do is a little more.
    """
    parts = parts_of(loop)
    rubs = np.zeros((samples, parts, parts + 2))
    rubs[0, range(parts), range(parts)] = sizes[2]
    errors, pushes = np.zeros((2, samples, parts + 2))
    pushes[0, parts], errors[0, parts + 1] = sizes[1], sizes[0]
    found = responses(
        loop, Disturbance(errors=errors, pushes=pushes, rubs=rubs), parts + 2, samples
    )
    backwards = np.sign(found[::-1])  # what was done so long ago acts now with this sign
    runs = parts * 3
    signs = backwards.reshape(samples, runs, parts + 2)
    signals = Disturbance(
        errors=sizes[0] * signs[:, :, parts + 1],
        pushes=sizes[1] * signs[:, :, parts],
        rubs=sizes[2] * np.moveaxis(signs[:, :, :parts], 1, 2),
    )
    reached = responses(loop, signals, runs, samples)[-1].reshape(parts, 3, parts, 3)
    return np.array([[abs(reached[p, c, p, c]) for c in range(3)] for p in range(parts)])


class _Runs:
    def __init__(self, loop: Disturbed, disturbance: Disturbance, start: np.ndarray) -> None:
        self.loop, self.disturbance, self.motion = loop, disturbance, loop.motion
        whole, fraction = divmod(loop.plant[2], 1.0)
        size = len(self.motion.c)
        rates = np.zeros((size + 2, size + 2))
        rates[:size] = np.column_stack([self.motion.a, self.motion.wall, self.motion.hand])
        lengths = [fraction / PARTS] * PARTS * (fraction > 0.0) + [(1.0 - fraction) / PARTS] * PARTS
        self.is_late = [False] * PARTS * (fraction > 0.0) + [True] * PARTS
        self.moves = [scipy.linalg.expm(rates * length)[:size] for length in lengths]
        self.seen = np.stack([self.motion.c, self.motion.c @ self.motion.a])
        zero = np.zeros(start.shape[1])
        self.state, self.acting, self.queue = start.copy(), zero, [zero] * int(whole)
        self.memories = [
            [[zero] * (len(taps[0]) - 1) for taps in chain]
            for chain in (loop.velocity, loop.position)
        ]

    def sample(self, number: int):  # type: ignore[no-untyped-def]
        """Yield position, velocity and force at the end of each part of a sample."""
        given = self.disturbance
        read = self.seen[0] @ self.state
        if given.phase is not None:
            read = np.rint(read + given.phase) - given.phase
        if given.errors is not None:
            read = read + given.errors[number]
        outputs = []
        for chain, memories in zip(
            (self.loop.velocity, self.loop.position), self.memories, strict=True
        ):
            value = read
            for taps, memory in zip(chain, memories, strict=True):
                value = _filtered(taps, value, memory)
            outputs.append(value)
        force = -(self.loop.wall[0] * outputs[1] + self.loop.wall[1] * outputs[0])
        if given.force_step:
            force = np.rint(force / given.force_step) * given.force_step
        if given.pushes is not None:
            force = force + given.pushes[number]
        self.queue.append(force)
        arriving = self.queue.pop(0)
        for part, (move, is_late) in enumerate(zip(self.moves, self.is_late, strict=True)):
            acting = arriving if is_late else self.acting
            rub = -given.friction * np.sign(self.seen[1] @ self.state)
            if given.rubs is not None:
                rub = rub + given.rubs[number, part]
            self.state = move @ np.array([*self.state, acting, rub])
            yield np.array([*(self.seen @ self.state), acting])
        self.acting = arriving


def _filtered(taps: Taps, value: np.ndarray, memory: list[np.ndarray]) -> np.ndarray:
    above, below = taps
    output = above[0] * value + (memory[0] if memory else 0.0)
    waiting = [*memory[1:], np.zeros_like(value)]
    for index in range(len(memory)):
        memory[index] = waiting[index] + above[index + 1] * value - below[index + 1] * output
    return output
