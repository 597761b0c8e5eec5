"""A loop to be tuned: one mass, or any linear device."""

from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from jaxstab.conventions import Excitation, Verdict
from jaxstab.model import by_name
from jaxstab.model.device import SampledDevice
from jaxstab.model.device.mechanics import mechanics
from jaxstab.model.filters import Filter, Filters, Velocity, as_keywords
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.motion.response import Loops, bank_for, device_loops, loops_of, propagator
from jaxstab.motion.settling import Settling, device_settling_samples, settling_samples
from jaxstab.point import SpectralRadius, spectral_radius
from jaxstab.point.radius import linear_spectral_radius
from jaxstab.point.verdicts import linear_verdict, verdict
from jaxstab.region.region import linear_region
from jaxstab.tuning.radius import (
    Component,
    OptimalGains,
    Walls,
    component_of,
    mass_walls,
    minimize_radius,
    searched_component,
    smallest_radius,
    walls_of,
)

Plant = tuple[float, float, float]

_TOLERANCE = 1e-6  # of the outline of a component, of its size


class MassLoop(NamedTuple):
    """Device and hand of one mass: gamma, delta, delay; estimator and filter, T = 1."""

    plant: Plant
    filters: Filters | None
    component: Component

    @classmethod
    def from_plant(cls, plant: Plant, filters: Filters | None) -> "MassLoop":
        """Return a loop whose search covers the component of small gains, if there is one."""
        return cls(plant, filters, searched_component(*plant, filters))

    def anywhere(self) -> "MassLoop":
        """Return the same loop with a search that covers all gains."""
        return self._replace(component=Component(lowest=self.component.lowest))

    def verdicts(self, alpha: Any, beta: Any) -> np.ndarray:
        """Return the codes of walls."""
        return np.asarray(verdict(alpha, beta, **by_name(*self.plant), **as_keywords(self.filters)))

    def spectral_radius(self, alpha: Any, beta: Any) -> SpectralRadius:
        """Return the radii of walls, with bounds."""
        return spectral_radius(alpha, beta, **by_name(*self.plant), **as_keywords(self.filters))

    def radii(self, alpha: Any, beta: Any) -> np.ndarray:
        """Return the radii of walls; with filters, infinite for walls outside the search."""
        if self.filters is None:
            return np.asarray(self.spectral_radius(alpha, beta).value)
        walls = mass_walls(*self.plant, self.filters)
        return _radii(walls._replace(component=self.component), self.verdicts, alpha, beta)

    def decays(self, alpha: np.ndarray, beta: np.ndarray, slowest: float) -> np.ndarray:
        """Return which walls are stable: a single mass has no mode that rings unseen."""
        return self.verdicts(alpha, beta) == Verdict.STABLE

    def smallest_radius(self) -> OptimalGains:
        """Return the gains of the smallest radius."""
        return minimize_radius(**by_name(*self.plant), **as_keywords(self.filters))

    def settling(self, alpha: Any, beta: Any, level: float, excitation: Excitation) -> Settling:
        """Return the settling of walls in samples."""
        loop, filters = self.plant, as_keywords(self.filters)
        return settling_samples(
            alpha, beta, **by_name(*loop), level=level, excitation=excitation, **filters
        )

    def deviations(self, alpha: np.ndarray, beta: np.ndarray, excitation: Excitation) -> Loops:
        """Return how walls, side by side, come to rest."""
        gamma, delta, delay = self.plant
        entries = propagator(gamma, delta, delay % 1.0, np.ones(1))[0, :, :4].reshape(8, 1)
        same, bank = np.broadcast_to(entries, (8, alpha.size)), bank_for(self.filters)
        return loops_of(alpha, beta, same, int(delay), excitation, bank)


class DeviceLoop(NamedTuple):
    """Any linear device, in its units, with the methods of ``MassLoop``; filters in SI units."""

    device: SampledDevice
    filters: Filters | None
    component: Component

    @classmethod
    def from_device(cls, device: SampledDevice, filters: Filters | None) -> "DeviceLoop":
        """A loop whose search covers the component of small gains, if there is one."""
        return cls(device, filters, _device_walls(device, filters).component)

    def anywhere(self) -> "DeviceLoop":
        return self._replace(component=Component(lowest=self.component.lowest))

    def verdicts(self, alpha: Any, beta: Any) -> np.ndarray:
        return np.asarray(linear_verdict(*_as_arrays(alpha, beta), self._linear))

    def spectral_radius(self, alpha: Any, beta: Any) -> SpectralRadius:
        return linear_spectral_radius(*_as_arrays(alpha, beta), self._linear)

    def radii(self, alpha: Any, beta: Any) -> np.ndarray:
        walls = _device_walls(self.device, self.filters)
        return _radii(walls._replace(component=self.component), self.verdicts, alpha, beta)

    def decays(self, alpha: np.ndarray, beta: np.ndarray, slowest: float) -> np.ndarray:
        """Return which walls have a radius no larger than a limit."""
        return _device_walls(self.device, self.filters).largest_pole(alpha, beta) <= slowest

    def smallest_radius(self) -> OptimalGains:
        return smallest_radius(_device_walls(self.device, self.filters), self.verdicts)

    def settling(self, alpha: Any, beta: Any, level: float, excitation: Excitation) -> Settling:
        device = self.device
        gains = np.asarray(alpha) / device.stiffness_unit, np.asarray(beta) / device.damping_unit
        loop = device.device, device.sample_time, device.delay, self.filters
        return device_settling_samples(*loop, *gains, level, excitation=excitation)

    def deviations(self, alpha: np.ndarray, beta: np.ndarray, excitation: Excitation) -> Loops:
        device = self.device
        moves = mechanics(device.device, device.sample_time, device.delay % 1.0, (1.0,))
        bank = bank_for(self.filters, device.sample_time)
        rate = device.damping_unit * device.sample_time
        walls = alpha / device.stiffness_unit, beta / rate
        return device_loops(*walls, moves, int(device.delay), excitation, bank)

    @property
    def _linear(self) -> LinearLoop:
        return _linear(self.device, self.filters)


TunedLoop: TypeAlias = MassLoop | DeviceLoop


@lru_cache(maxsize=64)
def _linear(device: SampledDevice, filters: Filters | None) -> LinearLoop:
    return device.loop(filters)


@lru_cache(maxsize=64)
def _device_walls(device: SampledDevice, filters: Filters | None) -> Walls:
    transfers = device.transfers(filters or (Velocity(), Filter()))
    component = component_of(linear_region(device.plant, *transfers, _TOLERANCE))
    return walls_of(_linear(device, filters), component)


def _radii(walls: Walls, verdicts: Any, alpha: Any, beta: Any) -> np.ndarray:
    alpha, beta = np.broadcast_arrays(alpha, beta)
    radii = np.full(alpha.shape, np.inf)
    searched = verdicts(alpha, beta) == Verdict.STABLE
    if not np.any(searched):
        searched[...] = True
    radii[searched] = walls.largest_pole(alpha[searched], beta[searched])
    return radii


def _as_arrays(alpha: Any, beta: Any) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(alpha, np.float64), np.asarray(beta, np.float64)
