"""The motion of device, hand and wall on a grid finer than the sampling period, by scipy."""

import numpy as np
import scipy.signal

from jaxstab import HapticLoop

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
