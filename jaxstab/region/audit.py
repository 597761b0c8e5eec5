"""A second look at regions of loops with any plant, estimator and filter, by proved verdicts.

The curve and the count of the other roots of such loops may lose digits that no status tells. So
walls on both sides of the outline are asked for their verdict, which is a proof. That does not
prove a region; but one that a proof contradicts is not given.
"""

import numpy as np
from jaxtyping import Float64

from jaxstab.conventions import STABLE, UNSTABLE
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.point.verdict.linear import linear_verdict
from jaxstab.region.outline import Outline
from jaxstab.region.polygons import are_inside, edges_of

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
    vertices = outline.vertices[:size]
    walls = _beside(vertices).T
    alpha, beta = walls
    is_inside = are_inside(edges_of(vertices, outline.branches[: size - 1]), walls)
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


def _walls_of_all_sizes() -> Points:
    gains = np.concatenate([-_GAINS, [0.0], _GAINS])
    return np.stack(np.meshgrid(gains, gains), axis=-1).reshape(-1, 2)
