"""Multiple roots of p(z), which the best gains have, as equations for Newton's method.

A triple real root solves p = p' = p'' = 0, a double complex pair p = p' = 0, for the gains and z.
p is affine in the gains, so that triple roots are those of one polynomial: all of them are known.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, constant, namespace
from jaxstab.model.linear_loop import LinearLoop

LARGEST = 1.3  # radius of the search; a root beyond it is no longer the one that was followed
NEARLY_REAL = 1e-3  # imaginary parts of real roots of polynomials with rounded coefficients


class Family(NamedTuple):
    """p(z) = base + alpha stiff + beta damp, each with the highest power first."""

    base: Float64[Array, "*grid coefficient"]
    stiff: Float64[Array, "*grid coefficient"]
    damp: Float64[Array, "*grid coefficient"]

    def polynomial(self, alpha: Array, beta: Array) -> Float64[Array, "*grid coefficient"]:
        """Return the coefficients for arrays of gains, on a new last axis."""
        return self.base + alpha[..., None] * self.stiff + beta[..., None] * self.damp


class Pair(NamedTuple):
    """The gains that put a pair of poles at x +- i y."""

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    x: Float64[Array, "*grid"]
    y: Float64[Array, "*grid"]


def family_of_loop(loop: LinearLoop) -> Family:
    """Return the polynomials of all walls at any linear loop."""
    xp = namespace(loop[:3])
    parts = ([coefficient.rounded() for coefficient in polynomial] for polynomial in loop[:3])
    return Family(*(xp.stack(polynomial, axis=-1) for polynomial in parts))


def triple_roots(family: Family) -> Pair:
    """Return all triple real roots, with y = 0, to the accuracy of the roots of a polynomial."""
    # The equations are linear in the gains and 1, so that the determinant of the three is a
    # polynomial in z that vanishes at the triple roots of all gains.
    base, stiff, damp = map(_derivatives, family)
    determinant: Array = np.zeros(1)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        minor = np.convolve(stiff[j], damp[k]), np.convolve(stiff[k], damp[j])
        determinant = np.polyadd(determinant, np.convolve(base[i], np.polysub(*minor)))
    roots = np.roots(determinant)
    z = roots[(abs(roots.imag) < NEARLY_REAL * abs(roots)) & (abs(roots) < LARGEST)].real
    p, stiff, damp = (
        [value(polynomials, z) for polynomials in parts[:2]] for parts in (base, stiff, damp)
    )
    divisor = stiff[0] * damp[1] - stiff[1] * damp[0]
    alpha = (p[1] * damp[0] - p[0] * damp[1]) / divisor
    beta = (p[0] * stiff[1] - p[1] * stiff[0]) / divisor
    return Pair(alpha, beta, z, np.zeros_like(z))


def multiple_root(family: Family, start: Pair, is_triple: bool) -> Pair:
    """Solve for the multiple root; NaN where the steps do not become small."""
    nothing = Pair(*(np.float64(np.nan),) * 4)
    pair = start._replace(y=np.float64(0.0)) if is_triple else start
    change = np.inf
    for count in range(10):
        try:
            step = newton_step(family, pair, np.asarray(is_triple))
        except np.linalg.LinAlgError:
            return nothing
        pair = Pair(*(a + b for a, b in zip(pair, step, strict=True)))
        change = np.hypot(step.x, step.y) / np.hypot(pair.x, pair.y)
        size = max(abs(entry) for entry in pair)
        if not max(abs(entry) for entry in step) > 1e-15 * size or abs(pair.x) > LARGEST:
            break
        if count == 4 and change > 0.05:  # no root is near
            break
    return pair if change < 1e-6 else nothing


def newton_step(family: Family, pair: Pair, is_triple: Array) -> Pair:
    """Return the step of Newton's method to a triple real root, or to a double complex pair."""
    # The equations are p = p' = p'' = y = 0 or p = p' = 0, those for alpha, beta, x and y.
    xp = namespace(family, pair)
    z = pair.x + 1j * pair.y
    whole = family.polynomial(pair.alpha, pair.beta)
    # The polynomial and its derivatives, and those of its derivatives in alpha and beta.
    every = xp.stack(xp.broadcast_arrays(whole, family.stiff, family.damp))
    p, stiff, damp = value(_derivatives(every), z[..., None])
    orders, after = slice(0, 3), slice(1, 4)
    columns = stiff[..., orders], damp[..., orders], p[..., after], 1j * p[..., after]
    rows = xp.stack([*columns, p[..., orders]], axis=-1)
    zero = xp.zeros_like(pair.y)
    last = xp.stack([zero, zero, zero, zero + 1.0, pair.y], axis=-1)
    triple = xp.concatenate([rows.real, last[..., None, :]], axis=-2)
    pairs = xp.stack([rows.real[..., :2, :], rows.imag[..., :2, :]], axis=-2)
    system = xp.where(xp.asarray(is_triple)[..., None, None], triple, pairs.reshape(triple.shape))
    step = xp.linalg.solve(constant(system[..., :4]), -system[..., 4:])[..., 0]
    return Pair(*(step[..., column] for column in range(4)))


def _derivatives(coefficients: Array) -> Float64[Array, "*grid 4 coefficient"]:
    """Return polynomials and their first three derivatives, with zeros in front."""
    places, factors = _places_and_factors(coefficients.shape[-1])
    return coefficients[..., places] * factors


@cache
def _places_and_factors(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where the coefficients of derivatives come from, and times what."""
    order, place = np.arange(4)[:, None], np.arange(size) - np.arange(4)[:, None]
    powers = size - 1.0 - place
    factors = np.ones(place.shape)
    for below in range(3):
        factors *= np.where(order > below, powers - below, 1.0)
    return np.maximum(place, 0), np.where(place >= 0, factors, 0.0)


def value(coefficients: Array, z: Array) -> Array:
    """Return the value of a polynomial."""
    result = 0.0 * z
    for power in range(coefficients.shape[-1]):
        result = result * z + coefficients[..., power]
    return result
