"""A second look at regions of loops with any plant, estimator and filter, by proved verdicts.

The curve and the count of the other roots of such loops may lose digits that no status tells. So
walls on both sides of the outline are asked for their verdict, which is a proof. That does not
prove a region; but one that a proof contradicts is not given.
"""

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.conventions import STABLE, UNSTABLE
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.point.verdict.linear import linear_verdict
from jaxstab.region.outline import Outline

_ASIDE = 1e-3  # of the outline's size
_WALLS = 24  # on each side
_GAINS = np.geomspace(1e-8, 1.0, 9)  # of alpha and of beta, of both signs

Points = Float64[np.ndarray, "_ 2"]


def is_contradicted(outline: Outline, loop: LinearLoop) -> bool:
    """Return whether a wall inside is proved unstable, or one outside stable.

    An outline without a loop says that no wall is stable: there gains of all sizes are tried.

    Args:
        outline: of the region.
        loop: the same loop, by which verdicts are proved.
    """
    size = int(outline.size)
    if size == 0:
        alpha, beta = _walls_of_all_sizes().T
        return bool(np.any(linear_verdict(alpha, beta, loop) == STABLE))
    vertices, branches = outline.vertices[:size], outline.branches[: size - 1]
    walls = _beside(vertices)
    alpha, beta = walls.T
    is_inside = _are_inside(walls, vertices, branches >= 0)
    codes = linear_verdict(alpha, beta, loop)
    return bool(np.any(codes == np.where(is_inside, UNSTABLE, STABLE)))


def _beside(vertices: Points) -> Points:
    """Return walls on both sides of some edges of an outline."""
    edges = np.linspace(0, len(vertices) - 2, _WALLS).round().astype(int)
    step = vertices[edges + 1] - vertices[edges]
    extent = np.ptp(vertices, axis=0)
    normal = step[:, ::-1] * [-1.0, 1.0] / extent[::-1]
    length = np.hypot(*normal.T)[:, None]
    aside = _ASIDE * extent * normal / np.where(length > 0.0, length, 1.0)
    middle = vertices[edges] + 0.5 * step
    return np.concatenate([middle + aside, middle - aside])


def _are_inside(
    walls: Points, vertices: Points, is_edge: Bool[np.ndarray, " _"]
) -> Bool[np.ndarray, " _"]:
    """Return which walls are inside of polygons: a ray to the right crosses them an odd time."""
    (x, y), (x0, y0), (x1, y1) = walls.T[:, :, None], vertices[:-1].T, vertices[1:].T
    spans = ((y0 > y) != (y1 > y)) & is_edge
    crossing = x0 + (y - y0) * (x1 - x0) / np.where(y1 == y0, 1.0, y1 - y0)
    inside: np.ndarray = np.sum(spans & (x < crossing), axis=1) % 2 == 1
    return inside


def _walls_of_all_sizes() -> Points:
    gains = np.concatenate([-_GAINS, [0.0], _GAINS])
    return np.stack(np.meshgrid(gains, gains), axis=-1).reshape(-1, 2)
