"""The component of a stable set in which the best gains are searched: the one with small gains."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8

from jaxstab.arrays import Array
from jaxstab.conventions import Status
from jaxstab.model.filters import Filters
from jaxstab.region import RegionStatus, StableRegion, stable_region
from jaxstab.region.pieces import are_inside, edges_of
from jaxstab.region.stable_set import holds_small_gains

# What is known about the best gains.


class TuningStatus(Status):
    """How the best gains are known; small integers, so that arrays store int8.

    None of them proves that no other gains are better. With filters the stable set may have several
    components: the search covers the one that holds small positive gains, which is reached by
    turning gains up from 0, and other components only where the status says so.

    Example:
        >>> jaxstab.results.TuningStatus(1).words
        'the best found: a triple real pole, solved for to full precision'
    """

    NOT_COMPUTED = 0, "not computed"
    TRIPLE_ROOT = 1, "the best found: a triple real pole, solved for to full precision"
    DOUBLE_PAIR = 2, "the best found: a double pair of poles, solved for to full precision"
    SCANNED = 3, "best of a search; up to 0.01 % better may exist"
    NO_STABLE_GAINS = 4, "no gains found that make the loop stable"
    ISLAND = 5, "the best found, of a scan: in an island, for small gains are not stable"
    ANY_COMPONENT = 6, "the best found, of a scan: perhaps in an island, the region is unresolved"
    NOT_CALM = 7, "no gains found that the encoder drives no further than the limit"


class OptimalGains(NamedTuple):
    """The best gains, what they achieve (a radius, or samples) and how they are known.

    Example:
        >>> best = jaxstab.minimize_radius(gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(best.value), 9)  # 4^(1/3) - 1
        0.587401052
    """

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    value: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]


_NUMBERS = 1 << 20  # of an array that points beside edges fill, about


class Component(NamedTuple):
    """A component of a stable set, or all gains.

    edges: of its outline, from (alpha, beta) to (alpha, beta); None for all gains.
    status: of gains that are found there; NOT_COMPUTED leaves it to the search.
    """

    edges: Float64[np.ndarray, "edge 4"] | None = None
    status: TuningStatus = TuningStatus.NOT_COMPUTED

    def holds(self, alpha: np.ndarray, beta: np.ndarray) -> Bool[np.ndarray, "*grid"]:
        """Return which stable gains are in the component: those that its outline encloses."""
        # Stable gains are not next to another component's edge, so the polygon is as good for this
        # as the exact curve.
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
def searched_component(
    gamma: float, delta: float, delay: float, filters: Filters | None
) -> Component:
    """Return the component of small gains; if there is none, all gains and a status."""
    if filters is None:  # the stable set was always seen to be one component
        return ALL_GAINS
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
