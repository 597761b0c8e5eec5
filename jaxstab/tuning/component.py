"""The component of a stable set in which the best gains are searched: the one with small gains."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.model.filters import Filters
from jaxstab.region import RegionStatus, StableRegion, stable_region
from jaxstab.region.pieces import are_inside, edges_of
from jaxstab.region.stable_set import holds_small_gains
from jaxstab.tuning.status import TuningStatus

_NUMBERS = 1 << 20  # of an array that points beside edges fill, about


class Component(NamedTuple):
    """A component of a stable set, or all gains.

    edges: of its outline, from (alpha, beta) to (alpha, beta); None for all gains.
    status: of gains that are found there; NOT_COMPUTED leaves it to the search.
    """

    edges: Float64[np.ndarray, "edge 4"] | None = None
    status: TuningStatus = TuningStatus.NOT_COMPUTED

    def holds(self, alpha: np.ndarray, beta: np.ndarray) -> Bool[np.ndarray, "*grid"]:
        """Return which stable gains are in the component: those that its outline encloses.

        Stable gains are not next to another component's edge, so the polygon is as good for this as
        the exact curve.
        """
        alpha, beta = np.broadcast_arrays(alpha, beta)
        if self.edges is None:
            return np.full(alpha.shape, True)
        count = max(1, _NUMBERS // len(self.edges))
        points = np.stack([alpha.ravel(), beta.ravel()])
        parts = [
            are_inside(self.edges, points[:, begin : begin + count])
            for begin in range(0, points.shape[1], count)
        ]
        return np.concatenate([np.zeros(0, bool), *parts]).reshape(alpha.shape)


ALL_GAINS = Component()


@lru_cache(maxsize=64)
def searched_component(gamma: float, delta: float, delay: float, filters: Filters) -> Component:
    """Return the component of small gains; if there is none, all gains and a status."""
    velocity, position = filters
    return component_of(
        stable_region(gamma=gamma, delta=delta, delay=delay, velocity=velocity, position=position)
    )


def component_of(region: StableRegion) -> Component:
    """Return the component of small gains of a stable set; all gains if there is none."""
    if region.status == RegionStatus.UNRESOLVED:
        return Component(None, TuningStatus.ANY_COMPONENT)
    components = region.components
    if not components or not holds_small_gains(region.coefficients, components[0].outline):
        return Component(None, TuningStatus.ISLAND)
    first, *islands = components
    return Component(edges_of(first.points, first.branch)) if islands else ALL_GAINS
