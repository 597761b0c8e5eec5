"""A loop to be tuned: one mass, or any linear device.

Searches for the best walls ask the same of both: verdicts, radii, settling, and how walls come to
rest. A ``TunedLoop`` holds the functions that answer for one loop, of arrays of alpha and beta.
"""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from jaxstab.conventions import Excitation, Verdict
from jaxstab.model import LoopParameters, by_name
from jaxstab.model.device.mechanics import mechanics
from jaxstab.model.filters import Filters, as_keywords, given_filters
from jaxstab.motion.response import OF_MASS, Loops, bank_for, loops_of, propagator
from jaxstab.motion.settling import Settling, loop_settling_samples, settling_samples
from jaxstab.point import SpectralRadius, spectral_radius
from jaxstab.point.radius import linear_spectral_radius
from jaxstab.point.verdicts import linear_verdict, verdict
from jaxstab.region.region import loop_region
from jaxstab.tuning.radius import (
    ALL_GAINS,
    Component,
    OptimalGains,
    Walls,
    component_of,
    mass_walls,
    minimize_radius,
    smallest_radius,
    walls_of,
)

_TOLERANCE = 1e-6  # of the outline of a component, of its size


class TunedLoop(NamedTuple):
    """A loop, and the component of its stable set that searches cover.

    walls: p(z) of its walls; None where ``spectral_radius`` alone gives their radii.
    smallest_radius: returns the gains of the smallest radius.
    settling: the settling of walls in samples, for keywords ``level`` and ``excitation``.
    deviations: how walls, side by side, come to rest.
    hides_modes: whether a mode that the position hardly shows may ring unseen.
    """

    component: Component
    walls: Walls | None
    verdicts: Callable[[Any, Any], np.ndarray]
    spectral_radius: Callable[[Any, Any], SpectralRadius]
    smallest_radius: Callable[[], OptimalGains]
    settling: Callable[..., Settling]
    deviations: Callable[[np.ndarray, np.ndarray, Excitation], Loops]
    hides_modes: bool

    def anywhere(self) -> "TunedLoop":
        """Return the same loop with a search that covers all gains."""
        return self._replace(component=Component(lowest=self.component.lowest))

    def radii(self, alpha: Any, beta: Any) -> np.ndarray:
        """Return the radii of walls; with ``walls``, infinite for those outside the component."""
        if self.walls is None:
            return np.asarray(self.spectral_radius(alpha, beta).value)
        alpha, beta = np.broadcast_arrays(alpha, beta)
        radii = np.full(alpha.shape, np.inf)
        searched = np.asarray(self.verdicts(alpha, beta) == Verdict.STABLE)
        if not np.any(searched):
            searched = np.full(alpha.shape, True)
        radii[searched] = self._largest_pole(alpha[searched], beta[searched])
        return radii

    def decays(self, alpha: np.ndarray, beta: np.ndarray, slowest: float) -> np.ndarray:
        """Return which walls are stable; with hidden modes, those of a radius up to ``slowest``."""
        if self.hides_modes:
            return np.asarray(self._largest_pole(alpha, beta) <= slowest)
        return np.asarray(self.verdicts(alpha, beta) == Verdict.STABLE)

    def _largest_pole(self, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
        assert self.walls is not None
        walls = self.walls._replace(component=self.component)
        return np.asarray(walls.largest_pole(alpha, beta))


def mass_loop(gamma: float, delta: float, delay: float, filters: Filters | None) -> TunedLoop:
    """A loop of one mass, its filters in units of one sample; the component is of small gains."""
    plant = gamma, delta, delay
    options = by_name(*plant) | as_keywords(filters)
    walls = None if filters is None else mass_walls(*plant, filters)

    def deviations(alpha: np.ndarray, beta: np.ndarray, excitation: Excitation) -> Loops:
        rows = propagator(gamma, delta, delay % 1.0, np.ones(1))[0, :, :4]
        return loops_of(alpha, beta, rows, OF_MASS, int(delay), excitation, bank_for(filters))

    return TunedLoop(
        ALL_GAINS if walls is None else walls.component,
        walls,
        partial(verdict, **options),
        partial(spectral_radius, **options),
        partial(minimize_radius, **options),
        partial(settling_samples, **options),
        deviations,
        hides_modes=False,
    )


@lru_cache(maxsize=64)
def device_loop(loop: LoopParameters) -> TunedLoop:
    """A loop of a device that is not one mass, in its units; as ``mass_loop``."""
    device = loop.sampled
    assert device is not None
    filters = given_filters(loop.velocity, loop.position)
    linear = device.loop(filters)
    walls = walls_of(linear, component_of(loop_region(loop, _TOLERANCE)))

    def verdicts(alpha: Any, beta: Any) -> np.ndarray:
        return np.asarray(linear_verdict(*_as_arrays(alpha, beta), linear))

    def radius(alpha: Any, beta: Any) -> SpectralRadius:
        return linear_spectral_radius(*_as_arrays(alpha, beta), linear)

    def settling(alpha: Any, beta: Any, **options: Any) -> Settling:
        wall = np.asarray(alpha) / device.stiffness_unit, np.asarray(beta) / device.damping_unit
        return loop_settling_samples(loop, *wall, **options)

    def deviations(alpha: np.ndarray, beta: np.ndarray, excitation: Excitation) -> Loops:
        moves = mechanics(device.device, device.sample_time, device.delay % 1.0, (1.0,))
        bank = bank_for(filters, device.sample_time)
        rate = device.damping_unit * device.sample_time
        wall, rows = (alpha / device.stiffness_unit, beta / rate), moves.rows[-1, :, :-1]
        return loops_of(*wall, rows, moves.starts, int(device.delay), excitation, bank)

    best = partial(smallest_radius, walls, verdicts)
    return TunedLoop(
        walls.component, walls, verdicts, radius, best, settling, deviations, hides_modes=True
    )


def _as_arrays(alpha: Any, beta: Any) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(alpha, np.float64), np.asarray(beta, np.float64)
