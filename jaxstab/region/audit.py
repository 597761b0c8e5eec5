"""A second look at regions of loops with any plant, estimator and filter, by proved verdicts.

The curve of such a loop, and the count of its other roots, may lose digits without any status
showing it. So walls on both sides of the outline get a verdict, which is a proof. This does not
prove the region, but a region that a proof contradicts is not given. The walls keep a distance from
the outline, so that the rounding of a corner contradicts nothing. Next to corners they are closer:
the curve passes a mode that walls hardly move within an angle that the search may step over, and
where gains are small such a mode can cut off a corner of the set. Where walls move it so little
that no verdict decides, no digit of the search tells more, and the region is not given either.
"""

import numpy as np
from jaxtyping import Float64, Int

from jaxstab.conventions import STABLE, UNSTABLE
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.point.verdict.linear import linear_verdict
from jaxstab.region import measures
from jaxstab.region.corners import Branch
from jaxstab.region.curve import SliceCoefficients, curve_and_lift
from jaxstab.region.outline import Outline
from jaxstab.region.pieces import NO_BRANCH
from jaxstab.region.polygons import are_inside, edges_of

_ASIDE = 1e-3  # of the outline's size
_ROUGH = 1e-3  # of the same: edges that leave the boundary by more
_WALLS = 24  # on each side
_FROM_CORNER = 10.0 ** -np.arange(1.0, 6.0)  # shares of an edge that ends at a corner
_UNDAMPED = 1e-6  # how far the roots of such a mode are from the circle
_SHORTEST = 1e-8  # of the outline's size: an edge next to a corner
_GAINS = np.geomspace(1e-8, 1.0, 9)  # of alpha and of beta, of both signs

Edges = Float64[np.ndarray, "_ 4"]
Walls = Float64[np.ndarray, "2 _"]


def fails_audit(c: SliceCoefficients, outline: Outline, loop: LinearLoop, deviation: float) -> bool:
    """Return whether a wall inside is proved unstable, or one outside stable.

    Where a mode is next to undamped, an outline also fails if no wall beside it is proved stable.
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
        alpha, beta = _walls_of_all_sizes()
        return bool(np.any(linear_verdict(alpha, beta, loop) == STABLE))
    if deviation > _ROUGH:
        return True
    vertices = outline.vertices[:size]
    edges, extent = edges_of(vertices, outline.branches[: size - 1]), np.ptp(vertices, axis=0)
    walls = _beside(edges, extent)
    codes = linear_verdict(walls[0], walls[1], loop)
    is_any_proved = bool(np.any(codes == STABLE))
    doubtful = codes == np.where(are_inside(edges, walls), UNSTABLE, STABLE)
    walls, codes = walls[:, doubtful], codes[doubtful]  # a polygon is not exact
    assert c.filtered is not None
    angles, distances = c.filtered.resonances
    if np.any((angles > 0.0) & (distances < _UNDAMPED)):
        if not is_any_proved:
            return True
        near = _beside(_near_corners(c, outline), extent, is_near=True)
        walls = np.concatenate([walls, near], axis=1)
        codes = np.concatenate([codes, linear_verdict(near[0], near[1], loop)])
    if not codes.size:
        return False
    is_inside = measures.contains(c, outline, walls[0], walls[1])
    return bool(np.any(codes == np.where(is_inside, UNSTABLE, STABLE)))


def _beside(edges: Edges, extent: Float64[np.ndarray, "2"], *, is_near: bool = False) -> Walls:
    """Return walls on both sides of edges: of some of an outline, or of all next to corners.

    Next to corners they are as close to their edges as these are short.
    """
    here, there = edges[:, :2], edges[:, 2:]
    normal = (there - here)[:, ::-1] * [-1.0, 1.0] / extent[::-1]
    length = np.hypot(*normal.T)
    chosen = np.flatnonzero(length > (_SHORTEST if is_near else 0.0))
    if not is_near:
        chosen = chosen[np.linspace(0, len(chosen) - 1, _WALLS).round().astype(int)]
        normal /= np.where(length > 0.0, length, 1.0)[:, None]
    aside, middle = _ASIDE * extent * normal[chosen], 0.5 * (here + there)[chosen]
    return np.concatenate([middle + aside, middle - aside]).T


def _near_corners(c: SliceCoefficients, outline: Outline) -> Edges:
    """Return short edges of the boundary, at some distances from the corners."""
    size = int(outline.size)
    vertices = outline.vertices[:size]
    is_corner = np.any(np.all(outline.corners[:, None] == vertices, axis=-1), axis=0)
    is_edge = (outline.branches[: size - 1] != NO_BRANCH) & np.any(np.diff(vertices, axis=0), 1)
    begins, ends = (np.flatnonzero(is_edge & one) for one in (is_corner[:-1], is_corner[1:]))
    edges = np.repeat(np.append(begins, ends), len(_FROM_CORNER))
    close, far = (
        np.append(np.tile(part, len(begins)), 1.0 - np.tile(part, len(ends)))
        for part in (_FROM_CORNER, 2.0 * _FROM_CORNER)
    )
    both = (_on_edges(c, outline, edges, shares) for shares in (close, far))
    return np.concatenate(list(both), axis=1)


def _on_edges(
    c: SliceCoefficients,
    outline: Outline,
    edges: Int[np.ndarray, " edge"],
    shares: Float64[np.ndarray, " edge"],
) -> Float64[np.ndarray, "edge 2"]:
    """Return points of the boundary at shares of edges."""
    here, there = outline.vertices[edges], outline.vertices[edges + 1]
    straight = here + (there - here) * shares[:, None]
    first, last = outline.angles[edges].T
    curved = np.stack(curve_and_lift(c, first + (last - first) * shares)[:2], axis=1)
    return np.where((outline.branches[edges] == Branch.CURVE)[:, None], curved, straight)


def _walls_of_all_sizes() -> Walls:
    gains = np.concatenate([-_GAINS, [0.0], _GAINS])
    return np.stack(np.meshgrid(gains, gains), axis=0).reshape(2, -1)
