"""The closed loop's poles: eigenvalues of the companion matrix of p(z), by LAPACK, without a proof.

They serve unproved answers (mode shapes, frequencies) and starting values for proved ones.
"""

import numpy as np
from jaxtyping import Complex128, Float64

from jaxstab.arrays import Array, Numbers, namespace
from jaxstab.batches import MANY_COEFFICIENTS, compiled
from jaxstab.model import companion_matrix
from jaxstab.model.filters import Filter, Velocity
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.model.polynomial import loop_polynomial
from jaxstab.point.grid import over_grid

_HUGE = 2.0**400


def closed_loop_poles(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Complex128[Array, "*grid degree"]:
    """Return the poles of the closed loop, the eigenvalues of the companion matrix of p(z).

    Args:
        alpha, beta, gamma, delta, delay, velocity, position: see ``jaxstab.conventions``.

    Returns:
        Array of shape (*grid, degree), the largest modulus first. For an array of delays, a loop of
        a lower degree has zeros at the end.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        TypeError: the delay is traced.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9); each pole is an exact root of a polynomial within a few ulp of p(z) (backward
    error), so a root of multiplicity k is only good to about ulp^(1/k).

    Example:
        >>> float(abs(jaxstab.closed_loop_poles(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)).max())
        0.98712203...
    """
    point = alpha, beta, gamma, delta, delay
    return over_grid(companion_poles, *point, velocity=velocity, position=position)


def linear_poles(alpha: Array, beta: Array, loop: LinearLoop) -> Complex128[Array, "*grid degree"]:
    """Return the poles of walls of one loop, with any device, estimator and filter.

    Args:
        alpha: float64, any shape; it broadcasts with beta and with the loop.
        beta: likewise.
        loop: what base + alpha stiffness + beta damping is; walls and loops may be traced.

    Returns:
        Array of shape (*grid, degree), the largest modulus first.
    """
    return companion_poles(loop_polynomial(alpha, beta, loop))


@compiled(many=MANY_COEFFICIENTS)
def companion_poles(
    coefficients: Float64[Array, "*grid coefficient"],
) -> Complex128[Array, "*grid degree"]:
    """Return all roots of monic polynomials, highest power first, the largest root first."""
    xp = namespace(coefficients)
    unit = _unit(coefficients)[..., None]
    matrix = companion_matrix(coefficients / unit ** xp.arange(coefficients.shape[-1]))
    poles = unit * _eigenvalues(matrix)
    order = xp.argsort(-xp.abs(poles), axis=-1)
    return xp.take_along_axis(poles, order, axis=-1)


def _eigenvalues(
    matrix: Float64[Array, "*grid degree degree"],
) -> Complex128[Array, "*grid degree"]:
    xp = namespace(matrix)
    if xp is not np:
        return xp.linalg.eigvals(matrix)
    is_finite = np.isfinite(matrix).all(axis=(-2, -1))
    poles = np.full(matrix.shape[:-1], np.nan, complex)
    poles[is_finite] = np.linalg.eigvals(matrix[is_finite])
    return poles


def _unit(coefficients: Float64[Array, "*grid coefficient"]) -> Float64[Array, "*grid"]:
    """Return what to measure roots in: 1, but of huge coefficients about the largest root.

    Some builds of LAPACK lose the scale of matrices above 1e138.
    """
    xp = namespace(coefficients)
    sizes = xp.abs(coefficients[..., 1:])
    exponents = xp.log2(sizes) / xp.arange(1, coefficients.shape[-1])
    largest = xp.exp2(xp.floor(xp.max(exponents, axis=-1)))
    return xp.where(xp.max(sizes, axis=-1) > _HUGE, largest, 1.0)
