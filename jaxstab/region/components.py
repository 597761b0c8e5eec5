"""The connected components of a stable set, each bounded by a loop, and by those around its holes.

NumPy only.
"""

import numpy as np

from jaxstab.region import measures
from jaxstab.region.curve import SliceCoefficients
from jaxstab.region.outline import Outline
from jaxstab.region.pieces import NO_BRANCH

_SMALL = 1e-8  # of what a set spans
_RATIOS = 10.0 ** np.arange(-6.0, 1.0)  # of alpha to beta, in that measure


def components_of(c: SliceCoefficients, outline: Outline) -> list[Outline]:
    """Return the outlines of the components: first the one with small gains, then by area."""
    parts = _loops(outline)
    if len(parts) == 1:
        return parts
    loops = [(loop, float(measures.area(c, loop))) for loop in parts]
    holes = [one for one in loops if one[1] <= 0.0]
    groups = [
        [outer, *(hole for hole in holes if _holds(c, outer[0], hole[0]))]
        for outer in loops
        if outer[1] > 0.0
    ]
    whole = [
        (_joined([loop for loop, _ in group]), sum(area for _, area in group)) for group in groups
    ]
    whole.sort(key=lambda one: (not holds_small_gains(c, one[0]), -one[1]))
    return [component for component, _ in whole]


def holds_small_gains(c: SliceCoefficients, outline: Outline) -> bool:
    """Return whether a set holds positive gains that are small beside its own size."""
    extent = np.max(np.abs(outline.vertices[: int(outline.size)]), axis=0)
    alpha = _SMALL * extent[0] * _RATIOS
    beta = np.full_like(alpha, _SMALL * extent[1])
    return bool(np.any(measures.contains(c, outline, alpha, beta)))


def _loops(outline: Outline) -> list[Outline]:
    size = int(outline.size)
    breaks = np.flatnonzero(outline.branches[: size - 1] == NO_BRANCH).tolist()
    ends = zip([0, *(last + 1 for last in breaks)], [*breaks, size - 1], strict=True)
    return [_part(outline, first, last) for first, last in ends]


def _part(outline: Outline, first: int, last: int) -> Outline:
    """Return one loop, from its first vertex to its last, which are the same."""
    vertices = outline.vertices[first : last + 1]
    is_own = np.any(np.all(outline.corners[:, None] == vertices, axis=-1), axis=1)
    return outline._replace(
        vertices=vertices,
        branches=outline.branches[first:last],
        angles=outline.angles[first:last],
        size=np.asarray(last + 1 - first),
        loops=np.asarray(1),
        corners=outline.corners[is_own],
    )


def _joined(loops: list[Outline]) -> Outline:
    """Return loops as one outline, with an edge of no branch between them."""
    gap = np.array([NO_BRANCH]), np.zeros((1, 2))
    branches = [part for loop in loops for part in (gap[0], loop.branches)][1:]
    angles = [part for loop in loops for part in (gap[1], loop.angles)][1:]
    return loops[0]._replace(
        vertices=np.concatenate([loop.vertices for loop in loops]),
        branches=np.concatenate(branches),
        angles=np.concatenate(angles),
        size=np.asarray(sum(int(loop.size) for loop in loops)),
        loops=np.asarray(len(loops)),
        corners=np.concatenate([loop.corners for loop in loops]),
    )


def _holds(c: SliceCoefficients, outer: Outline, inner: Outline) -> bool:
    return bool(measures.contains(c, outer, *inner.vertices[:1].T)[0])
