"""A second look at regions of loops with any plant, estimator and filter, by proved verdicts.

The curve of such a loop, and the count of its other roots, may lose digits without any status
showing it. So walls on both sides of the outline get a verdict, which is a proof. This does not
prove the region, but a region that a proof contradicts is not given. The walls keep a distance from
the outline, so that the rounding of a corner contradicts nothing.
"""

import numpy as np
from jaxtyping import Float64

from jaxstab.conventions import STABLE, UNSTABLE
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.point.verdict.linear import linear_verdict
from jaxstab.region import measures
from jaxstab.region.curve import SliceCoefficients
from jaxstab.region.outline import Outline
from jaxstab.region.polygons import are_inside, edges_of

_ASIDE = 1e-3  # of the outline's size
_ROUGH = 1e-3  # of the same: edges that leave the boundary by more
_WALLS = 24  # on each side
_GAINS = np.geomspace(1e-8, 1.0, 9)  # of alpha and of beta, of both signs

Points = Float64[np.ndarray, "_ 2"]


def is_contradicted(
    c: SliceCoefficients, outline: Outline, loop: LinearLoop, deviation: float
) -> bool:
    """Return whether a wall inside is proved unstable, or one outside stable.

    An outline without a loop claims that no wall is stable; gains of all sizes are tried then. An
    outline that stays away from its curve whatever the number of vertices follows nothing but
    rounding.

    Args:
        c: the coefficients of the slice.
        outline: of the region.
        loop: the same loop, by which verdicts are proved.
        deviation: of the outline from its curve.
    """
    size = int(outline.size)
    if size == 0:
        alpha, beta = _walls_of_all_sizes().T
        return bool(np.any(linear_verdict(alpha, beta, loop) == STABLE))
    if deviation > _ROUGH:
        return True
    edges = edges_of(outline.vertices[:size], outline.branches[: size - 1])
    walls = _beside(edges).T
    alpha, beta = walls
    codes = linear_verdict(alpha, beta, loop)
    doubtful = codes == np.where(are_inside(edges, walls), UNSTABLE, STABLE)
    if not np.any(doubtful):
        return False
    is_inside = measures.contains(c, outline, *walls[:, doubtful])  # a polygon is not exact
    return bool(np.any(codes[doubtful] == np.where(is_inside, UNSTABLE, STABLE)))


def _beside(edges: Float64[np.ndarray, "edge 4"]) -> Points:
    """Return walls on both sides of some edges of an outline, of those that have a length."""
    extent = np.ptp(edges[:, :2], axis=0)
    here, there = edges[:, :2], edges[:, 2:]
    normal = (there - here)[:, ::-1] * [-1.0, 1.0] / extent[::-1]
    length = np.hypot(*normal.T)
    long = np.flatnonzero(length > 0.0)
    chosen = long[np.linspace(0, len(long) - 1, _WALLS).round().astype(int)]
    aside = _ASIDE * extent * normal[chosen] / length[chosen, None]
    middle = 0.5 * (here[chosen] + there[chosen])
    return np.concatenate([middle + aside, middle - aside])


def _walls_of_all_sizes() -> Points:
    gains = np.concatenate([-_GAINS, [0.0], _GAINS])
    return np.stack(np.meshgrid(gains, gains), axis=-1).reshape(-1, 2)
