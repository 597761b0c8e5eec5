"""Which points lie inside an outline's polygon; the same answer as the curve, except next to it."""

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.region.pieces import NO_BRANCH


def edges_of(points: np.ndarray, branch: np.ndarray) -> Float64[np.ndarray, "edge 4"]:
    """Return the edges of an outline, without those between its loops."""
    return np.concatenate([points[:-1], points[1:]], axis=1)[branch != NO_BRANCH]


def are_inside(edges: np.ndarray, points: np.ndarray) -> Bool[np.ndarray, " point"]:
    """Count the edges to the right of each point: an odd number of them encloses it."""
    alpha, beta = points[:, None]
    first_alpha, first_beta, last_alpha, last_beta = edges.T[..., None]
    crosses = (first_beta > beta) != (last_beta > beta)
    with np.errstate(all="ignore"):  # edges that run level are not crossed
        share = (beta - first_beta) / (last_beta - first_beta)
        is_right = first_alpha + share * (last_alpha - first_alpha) > alpha
    inside: np.ndarray = np.sum(crosses & is_right, axis=0) % 2 == 1
    return inside
