"""The motion of device, hand and wall on a grid finer than the sampling period, by scipy."""

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.signal

from jaxstab import HapticLoop
from tests.truth import devices

# Loops whose delays are multiples of a fine step.
PHANTOM = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)  # Remark 4
HELD = HapticLoop(
    device_mass=0.2,
    device_damping=0.1,
    hand_mass=0.3,
    hand_damping=3.0,
    hand_stiffness=150.0,
    sample_time=2e-3,
    delay=3.5e-3,
)
OSCILLATING = HapticLoop(  # beyond the haptic range: gamma = 1, undamped
    device_mass=1.0, device_damping=0.0, hand_stiffness=1.0, sample_time=1.0, delay=2.25
)
FINE = 4  # steps per sample


def march_on_a_fine_grid(
    loop: HapticLoop, stiffness: float, damping: float, samples: int, push: float, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity, and the wall's force, with the delay as a queue of fine steps."""
    rates = np.array([[0.0, 1.0], [-loop.hand_stiffness, 0.0]])
    rates[1, 1] = -(loop.device_damping + loop.hand_damping)
    rates[1] /= loop.mass
    system = (rates, np.array([[0.0], [1 / loop.mass]]), np.eye(2), np.zeros((2, 1)))
    phi, gain, *_ = scipy.signal.cont2discrete(system, loop.sample_time / FINE)
    queue = [0.0] * round(loop.delay / loop.sample_time * FINE)
    state, sampled, wall = start.astype(float), start[0], 0.0
    states, forces = [], []
    for step in range(samples * FINE):
        if step % FINE == 0:
            wall = -stiffness * state[0] - damping * (state[0] - sampled) / loop.sample_time
            sampled = state[0]
        queue.append(wall)
        acting = queue.pop(0)
        states.append(state)
        forces.append(acting)
        state = phi @ state + gain[:, 0] * (acting + push)
    return np.array(states), np.array(forces)


Taps = tuple[list[float], list[float]]  # a difference equation as ``scipy.signal.lfilter`` takes it


def difference_taps(samples: int) -> Taps:
    """(x_k - x_(k-n)) / n."""
    zeros = [0.0] * (samples - 1)
    return [1.0 / samples, *zeros, -1.0 / samples], [1.0, *zeros, 0.0]


def low_pass_taps(cutoff: float) -> Taps:
    """One pole at exp(-2 pi f)."""
    pole = float(np.exp(-2.0 * np.pi * cutoff))
    return [1.0 - pole, 0.0], [1.0, -pole]


def butterworth_taps(cutoff: float, order: int) -> list[Taps]:
    """Butterworth's filter as scipy's sections of second order."""
    sections = scipy.signal.butter(order, cutoff, fs=1.0, output="sos")
    return [(row[:3].tolist(), row[3:].tolist()) for row in sections]


class Plant(NamedTuple):
    """x' = A x + B_wall u + B_hand w, with the position C x."""

    a: np.ndarray
    wall: np.ndarray
    hand: np.ndarray
    c: np.ndarray


def march_through_filters(
    plant: tuple[float, float, float],
    wall: tuple[float, float],
    velocity: list[Taps],
    position: list[Taps],
    samples: int,
    *,
    push: float = 0.0,
    start: tuple[float, float] = (0.0, 0.0),
    unilateral: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Sampled states and forces of (gamma, delta, delay) at (alpha, beta), filters by lfilter."""
    gamma, delta, delay = plant
    force, shown = np.array([0.0, 1.0]), np.array([1.0, 0.0])
    mass = Plant(np.array([[0.0, 1.0], [-gamma, -delta]]), force, force, shown)
    return march_of_plant(
        mass, delay, wall, velocity, position, samples,
        push=push, start=np.array(start), unilateral=unilateral,
    )  # fmt: skip


def arriving(drawn: devices.Drawn) -> np.ndarray:
    """The states of a device whose body and arm move at velocity 1; its modes are at rest."""
    states = np.zeros(drawn.mechanism.system().a.rows)
    states[1] = 1.0
    if drawn.hand is not None and drawn.hand[3] is not None:
        states[2 * (1 + len(drawn.modes)) + 1] = 1.0
    return states


def march_of_plant(
    plant: Plant,
    delay: float,
    wall: tuple[float, float],
    velocity: list[Taps],
    position: list[Taps],
    samples: int,
    *,
    push: float = 0.0,
    start: np.ndarray,
    unilateral: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Sampled states and forces of any plant in units of one sample, filters by lfilter.

    The device stood where it starts before time 0.
    """
    size = len(plant.c)
    rates = np.zeros((size + 2, size + 2))
    rates[:size] = np.column_stack([plant.a, plant.wall, plant.hand])
    whole, fraction = divmod(delay, 1.0)
    early, late = (scipy.linalg.expm(rates * t)[:size] for t in (fraction, 1.0 - fraction))
    memories = []
    for chain in (velocity, position):
        value, memory = plant.c @ start, []
        for above, below in chain:
            memory.append(scipy.signal.lfilter_zi(above, below) * value)
            value *= sum(above) / sum(below)
        memories.append(memory)
    state, queue, acting, states, forces = start, [0.0] * int(whole), 0.0, [], []
    for _ in range(samples):
        shown, outputs = plant.c @ state, []
        for chain, memory in zip((velocity, position), memories, strict=True):
            value = np.array([shown])
            for number, taps in enumerate(chain):
                value, memory[number] = scipy.signal.lfilter(*taps, value, zi=memory[number])
            outputs.append(float(value[0]))
        force = -(wall[0] * outputs[1] + wall[1] * outputs[0])
        queue.append(force * (shown > 0.0) if unilateral else force)
        states.append(state)
        arriving = queue.pop(0)
        forces.append(acting if fraction else arriving)
        state = early @ [*state, acting, push]
        state = late @ [*state, arriving, push]
        acting = arriving
    return np.array(states), np.array(forces)
