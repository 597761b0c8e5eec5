"""A loop to be tuned: one mass, or any linear device.

Searches for the best walls ask the same of both: poles, settling, and how walls come to rest. A
``TunedLoop`` holds what answers for one loop, for arrays of alpha and beta.
"""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from jaxstab.conventions import Excitation
from jaxstab.model import LoopParameters, by_name
from jaxstab.model.device.mechanics import mechanics
from jaxstab.model.filters import Filters, as_keywords, given_filters
from jaxstab.motion.response import OF_MASS, Loops, bank_for, loops_of, propagator
from jaxstab.motion.settling import Settling, device_settling_samples, settling_samples
from jaxstab.point.verdicts import linear_verdict
from jaxstab.region.region import loop_region
from jaxstab.tuning.radius import Walls, mass_walls


class TunedLoop(NamedTuple):
    """A loop, and all walls among which the best one is searched.

    settling: the settling of walls in samples, for keywords ``level`` and ``excitation``.
    deviations: how walls, side by side, come to rest.
    """

    walls: Walls
    settling: Callable[..., Settling]
    deviations: Callable[[np.ndarray, np.ndarray, Excitation], Loops]


def tuned_loop(loop: LoopParameters) -> TunedLoop:
    """The loop to be tuned; its gains are ``loop.alpha(K)`` and ``loop.beta(B)``."""
    loop = loop.in_floats()
    if loop.body is None:
        return _device_loop(loop)
    gamma, delta, delay = loop.slice.values()
    return mass_loop(gamma, delta, delay, given_filters(**loop.filters))


def mass_loop(gamma: float, delta: float, delay: float, filters: Filters | None) -> TunedLoop:
    """A loop of one mass, its filters in units of one sample."""
    options = by_name(gamma, delta, delay) | as_keywords(filters)

    def deviations(alpha: np.ndarray, beta: np.ndarray, excitation: Excitation) -> Loops:
        rows = propagator(gamma, delta, delay % 1.0, np.ones(1))[0, :, :4]
        return loops_of(alpha, beta, rows, OF_MASS, int(delay), excitation, bank_for(filters))

    walls = mass_walls(gamma, delta, delay, filters)
    return TunedLoop(walls, partial(settling_samples, **options), deviations)


@lru_cache(maxsize=64)
def _device_loop(loop: LoopParameters) -> TunedLoop:
    device = loop.sampled
    assert device is not None
    filters = given_filters(loop.velocity, loop.position)
    linear = loop.linear

    def verdicts(alpha: Any, beta: Any) -> np.ndarray:
        return np.asarray(linear_verdict(np.asarray(alpha), np.asarray(beta), linear))

    def settling(alpha: Any, beta: Any, **options: Any) -> Settling:
        wall = np.asarray(alpha) / device.stiffness_unit, np.asarray(beta) / device.damping_unit
        return device_settling_samples(device, filters, *wall, **options)

    def deviations(alpha: np.ndarray, beta: np.ndarray, excitation: Excitation) -> Loops:
        moves = mechanics(device.device, device.sample_time, device.delay % 1.0, (1.0,))
        bank = bank_for(filters, device.sample_time)
        rate = device.damping_unit * device.sample_time
        wall, rows = (alpha / device.stiffness_unit, beta / rate), moves.rows[-1, :, :-1]
        return loops_of(*wall, rows, moves.starts, int(device.delay), excitation, bank)

    region = loop_region(loop, 1e-6)  # its size beside that of the outline's error
    return TunedLoop(Walls.of_loop(linear, verdicts, region), settling, deviations)
