"""The proof of instability by one root outside, for loops whose recursion loses its digits.

One z outside the unit circle at which p is small enough proves that a root is outside (lemma V5 of
docs/proofs.md). It is taken from the eigenvalues of the companion matrix.
"""

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.model import companion_matrix
from jaxstab.point.verdict.recursion import FLOAT_UNIT

_BATCH = 256  # polynomials at once: each takes a matrix
_ON_CIRCLE = 1e-13  # of the sum of the coefficients' sizes
_PER_DEGREE = 8.0  # roundings of a complex product, of the sum, and of a coefficient, and to spare


def have_outer_root(
    coefficients: Float64[np.ndarray, "point coefficient"],
) -> Bool[np.ndarray, " point"]:
    """Prove for polynomials that not all of their roots lie inside the unit circle.

    Polynomials with a root at 1 or -1 up to rounding, as on whole lines of walls, are not tried.

    Args:
        coefficients: monic, highest power first, each within two roundings of the true one.

    Returns:
        True where a root is proved to be outside; False says nothing.

    Source: Laguerre's bound for the distance to the nearest root.
    """
    alternating = (-1.0) ** np.arange(coefficients.shape[-1])
    ends = np.abs(np.stack([coefficients.sum(axis=-1), coefficients @ alternating]))
    sizes = np.abs(coefficients).sum(axis=-1)
    tried = np.flatnonzero(np.all(ends > _ON_CIRCLE * sizes, axis=0))
    proved = np.zeros(sizes.shape, bool)
    for start in range(0, tried.size, _BATCH):
        batch = tried[start : start + _BATCH]
        proved[batch] = _has_outer_root(coefficients[batch])
    return proved


def _has_outer_root(
    coefficients: Float64[np.ndarray, "point coefficient"],
) -> Bool[np.ndarray, " point"]:
    degree = coefficients.shape[-1] - 1
    poles = np.linalg.eigvals(companion_matrix(coefficients))
    z = np.take_along_axis(poles, np.argmax(np.abs(poles), -1)[..., None], -1)[..., 0]
    size = np.abs(z)
    value, slope = np.zeros_like(z), np.zeros_like(z)
    value_size, slope_size = np.zeros_like(size), np.zeros_like(size)
    for coefficient in coefficients.T:
        slope, slope_size = slope * z + value, slope_size * size + value_size
        value, value_size = value * z + coefficient, value_size * size + np.abs(coefficient)
    rounding = _PER_DEGREE * (degree + 1) * FLOAT_UNIT
    steepness = np.abs(slope) - rounding * slope_size
    with np.errstate(divide="ignore", invalid="ignore"):
        half_width = degree * (np.abs(value) + rounding * value_size) / steepness
    return (steepness > 0.0) & (size - (1.0 + rounding) * half_width > 1.0 + rounding)
