"""The fastest wall that an encoder drives no further than a limit: a search on grids."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxstab.loop.region import TOLERANCE, wall_region
from jaxstab.model import LoopParameters
from jaxstab.model.filters import given_filters
from jaxstab.motion import amplitude
from jaxstab.motion.amplitude import device_amplitude
from jaxstab.region import StableRegion
from jaxstab.tuning import TuningStatus
from jaxstab.tuning.gains import Grid

_POINTS = 25  # on an axis
_ZOOMS = 4

Objective = Callable[[np.ndarray, np.ndarray], Any]  # of alpha and beta; infinite, NaN: no wall


class Chatter(NamedTuple):
    """The resolution of an encoder in m, and how far it may drive the position, in m."""

    encoder: float
    limit: float = np.inf

    def of(self, loop: LoopParameters, alpha: Any, beta: Any) -> np.ndarray:
        """Return proved amplitudes of walls in m."""
        sampled = loop.sampled
        if sampled is None:
            found = amplitude(alpha, beta, **loop.slice, encoder=self.encoder, **loop.filters)
        else:
            filters = given_filters(loop.velocity, loop.position)
            found = device_amplitude(
                *(sampled.device, sampled.sample_time, sampled.delay, filters),
                *(loop.stiffness(alpha), loop.damping(beta)),
                encoder=self.encoder,
            )
        return np.asarray(found.position)


class CalmWall(NamedTuple):
    """Gains alpha and beta, their amplitude in m, and how they were found."""

    gains: tuple[float, float]
    amplitude: float
    status: TuningStatus


def fastest_calm_wall(
    loop: LoopParameters, objective: Objective, chatter: Chatter, alpha: float | None
) -> CalmWall:
    """Return the wall with the smallest objective among those found within the limit.

    The first grid spans the walls reached by turning gains up from 0; each further grid surrounds
    the best wall so far. Among equally fast walls the calmest one is taken.
    """
    best, least, status = (np.nan, np.nan), (np.inf, np.inf), TuningStatus.NOT_CALM
    region = _searched(loop)
    if not len(region.points):
        return CalmWall(best, np.inf, TuningStatus.NO_STABLE_GAINS)
    (left, low), (right, high) = region.points.min(axis=0), region.points.max(axis=0)
    if alpha is None:
        grid = Grid((left, right), (low, high), _POINTS)
    else:
        grid = Grid((alpha, alpha), (low, high), _POINTS**2)
    for _ in range(_ZOOMS):
        alphas, betas = (np.ravel(gains) for gains in np.broadcast_arrays(*grid.points))
        inside = np.asarray(region.contains(alphas, betas))
        reached = np.full(alphas.shape, np.inf)
        reached[inside] = chatter.of(loop, alphas[inside], betas[inside])
        calm = np.flatnonzero(reached <= chatter.limit)
        if calm.size:
            values = np.nan_to_num(np.asarray(objective(alphas[calm], betas[calm])), nan=np.inf)
            first = np.lexsort((reached[calm], values))[0]
            value = float(values[first]), float(reached[calm[first]])
            if value < least:
                place = int(calm[first])
                least, best = value, (float(alphas[place]), float(betas[place]))
                status = TuningStatus.SCANNED
        if not np.isfinite(least[0]):
            break
        grid = grid.around(best)
    return CalmWall(best, least[1], status)


def _searched(loop: LoopParameters) -> StableRegion:
    """Return the component of small gains, or all of the region where small gains do not hold."""
    region = wall_region(loop.in_floats(), TOLERANCE).region
    return region.main or region
