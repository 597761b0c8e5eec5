"""Which polynomials have all roots in a circle, in float64 and not proved: a sieve."""

import numpy as np
from jaxtyping import Bool, Float64


def are_inside(
    coefficients: Float64[np.ndarray, "coefficient *grid"], radius: Float64[np.ndarray, "..."]
) -> Bool[np.ndarray, "*grid"]:
    """Return where all roots of monic polynomials seem to be in the circle of a radius.

    Args:
        coefficients: highest power first.
        radius: broadcasts with the grid.

    Source: Schur-Cohn criterion (Jury 1964) for p(r z).
    """
    degree = len(coefficients) - 1
    inside = np.ones(coefficients.shape[1:], bool)
    scaled = coefficients.copy()
    for power in range(1, degree + 1):
        scaled[power:] /= radius
    with np.errstate(all="ignore"):
        for count in range(degree, 0, -1):
            ratio = scaled[count] / scaled[0]
            inside &= np.abs(ratio) < 1.0
            scaled = (scaled - ratio * scaled[::-1])[:count]
    return inside
