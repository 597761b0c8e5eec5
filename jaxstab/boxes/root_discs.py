"""The spectral radius over whole cells of the parameters, from discs that hold all roots.

For distinct z_1 ... z_n the roots of a monic p of degree n lie in the discs around the z_j with the
radii n |p(z_j)| / prod |z_j - z_k|, and a disc apart from all others holds one (Smith 1970). Here
every z_j follows a root to first order through the cell, as an affine function of alpha, beta,
gamma and delta; so the discs are small of second order, and linear models bound them for all points
of the cell. |z_j| is convex, which leaves its multilinear interpolation to compare:

    |z_j(x)| <= interpolation of |z_j| at the corners,    |z_j(x)| >= its tangent in the middle.
"""

from functools import partial
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Complex128, Float64

from jaxstab.boxes.models import LinearModel
from jaxstab.boxes.plant import HandBoxes, plant_models
from jaxstab.model import characteristic_polynomial, companion_matrix, require_x64

_LARGEST_STRIP = 2**14  # cells at once: memory stays bounded
_ROUNDING = 1e-13  # of 1 and the largest root, and as a share of the discs

Cells = Float64[np.ndarray, "alpha_cell beta_cell"]


def interpolation_errors(
    alpha: Float64[np.ndarray, " alpha_node"],
    beta: Float64[np.ndarray, " beta_node"],
    hands: HandBoxes,
    delay: float,
    corners: Float64[np.ndarray, "2 2 alpha_node beta_node"],
) -> Cells:
    """Bound the error of a multilinear interpolation of the spectral radius in each cell.

    Args:
        alpha: nodes of alpha, ascending.
        beta: nodes of beta, ascending.
        hands: one box of gamma and delta.
        delay: time delay t_d/T >= 0 in samples.
        corners: what is interpolated, at the lower and the upper gamma and delta of the box.

    Returns:
        Bounds for all points of the cells; infinite where the roots are not told apart.

    Raises:
        ValueError: gamma, delta or delay is outside the range of the model.
        RuntimeError: JAX's x64 mode is off.

    Source: Smith (1970), Error bounds for zeros of a polynomial based upon Gerschgorin's theorems,
    for the characteristic polynomial of eq. (9) of Hulin, Preusche, Hirzinger (2008).
    """
    require_x64()
    plant = _Plant.over(hands, delay)
    rows, columns = alpha.size - 1, beta.size - 1
    strip = min(rows, max(1, _LARGEST_STRIP // columns))
    errors: Cells = np.empty((rows, columns))
    for start in range(0, rows, strip):
        first = min(start, rows - strip)  # strips of one shape, compiled once
        end = first + strip
        errors[first:end] = _strip_errors(
            alpha[first : end + 1], beta, hands, delay, plant, corners[:, :, first : end + 1]
        )
    return errors


def _strip_errors(
    alpha: Float64[np.ndarray, " alpha_node"],
    beta: Float64[np.ndarray, " beta_node"],
    hands: HandBoxes,
    delay: float,
    plant: "_Plant",
    corners: Float64[np.ndarray, "2 2 alpha_node beta_node"],
) -> Cells:
    middles, halves = zip(*(_middle_and_half(nodes) for nodes in (alpha, beta)), strict=True)
    polynomials = characteristic_polynomial(
        middles[0][:, None], middles[1], hands.gamma[0], hands.delta[0], delay
    )
    is_whole = float(delay).is_integer()
    errors: Cells = np.asarray(
        _errors(
            _Walls(*map(jnp.asarray, (*middles, *halves))),
            plant,
            polynomials,
            jnp.asarray(corners),
            power=int(delay) + (1 if is_whole else 2),
            is_whole=is_whole,
        )
    )
    return errors


class _Walls(NamedTuple):
    """Middles and half-widths of cells along alpha and beta."""

    alpha: Array
    beta: Array
    half_alpha: Array
    half_beta: Array


class _Plant(NamedTuple):
    """d1, d0, n2, n1 and n0 of one box of hands, with slopes along gamma and delta."""

    value: Float64[Array, "5"]
    slope: Float64[Array, "5 2"]
    rest: Float64[Array, "5"]
    half: Float64[Array, "2"]

    @classmethod
    def over(cls, hands: HandBoxes, delay: float) -> "_Plant":
        models = plant_models(hands, delay)
        coefficients = (models.d1, models.d0, models.n2, models.n1, models.n0)
        return cls(
            jnp.asarray([model.centre[0] for model in coefficients]),
            jnp.asarray([model.slope[:, 0] for model in coefficients]),
            jnp.asarray([model.rest[0] for model in coefficients]),
            jnp.asarray(models.gamma.half[:, 0]),
        )


class _Polynomial(NamedTuple):
    """p over cells, in linear models of (alpha, beta, gamma, delta) of shape (1, *cell)."""

    alpha: LinearModel
    beta: LinearModel
    d1: LinearModel
    d0: LinearModel
    n2: LinearModel
    n1: LinearModel
    n0: LinearModel

    @classmethod
    def over(cls, walls: _Walls, plant: _Plant) -> "_Polynomial":
        zero = jnp.zeros((1, walls.alpha.size, walls.beta.size))
        widths = (walls.half_alpha[:, None], walls.half_beta, *plant.half)
        half = jnp.stack([zero + width for width in widths])
        unit = jnp.stack([zero, zero + 1.0])
        along_alpha = jnp.stack([unit[1], unit[0], unit[0], unit[0]])
        along_beta = jnp.stack([unit[0], unit[1], unit[0], unit[0]])

        def of_hands(value: Array, slope: Array, rest: Array) -> LinearModel:
            slopes = jnp.stack([zero, zero, zero + slope[0], zero + slope[1]])
            return LinearModel(zero + value, slopes, zero + rest, half)

        return cls(
            LinearModel(walls.alpha[:, None] + zero, along_alpha, zero, half),
            LinearModel(walls.beta + zero, along_beta, zero, half),
            *map(of_hands, *plant[:3]),
        )

    def at(self, z: LinearModel, power: int, *, is_whole: bool) -> LinearModel:
        numerator = z * self.n2 + self.n1
        if not is_whole:  # else z divides N
            numerator = numerator * z + self.n0
        wall = (self.alpha + self.beta) * z - self.beta
        return _power(z, power) * ((z + self.d1) * z + self.d0) + numerator * wall


@partial(jax.jit, static_argnames=("power", "is_whole"))
def _errors(
    walls: _Walls,
    plant: _Plant,
    polynomials: Float64[Array, "alpha_cell beta_cell coefficient"],
    corners: Float64[Array, "2 2 alpha_node beta_node"],
    *,
    power: int,
    is_whole: bool,
) -> Float64[Array, "alpha_cell beta_cell"]:
    z = jnp.moveaxis(jnp.linalg.eigvals(companion_matrix(polynomials)), -1, 0)
    p = _Polynomial.over(walls, plant)
    roots = _following(z, p, power, is_whole=is_whole)
    radii, distance = _discs(roots, p.at(roots, power, is_whole=is_whole))
    is_apart = jnp.all(distance > radii[:, None] + radii, axis=1)
    lost = jnp.where(is_apart, radii, 2.0 * jnp.sum(radii, axis=0))  # a chain of discs has a root

    inwards = jnp.conj(z) / jnp.where(z == 0.0, 1.0, jnp.abs(z))
    above, below = jnp.full(z.shape[1:], -jnp.inf), jnp.full(z.shape, -jnp.inf)
    for corner in product((0, 1), repeat=4):
        i, j, *hand = corner
        at_corner = z + sum(
            (2.0 * side - 1.0) * roots.slope[k] * p.alpha.half[k] for k, side in enumerate(corner)
        )
        cells_along_alpha, cells_along_beta = z.shape[1:]
        given = corners[*hand, i : i + cells_along_alpha, j : j + cells_along_beta]
        above = jnp.maximum(above, jnp.max(jnp.abs(at_corner) + radii, axis=0) - given)
        below = jnp.maximum(below, given - (inwards * at_corner).real)
    rounding = _ROUNDING * (1.0 + jnp.max(jnp.abs(z), axis=0))
    return jnp.maximum(above, jnp.min(below + lost, axis=0)) + rounding


def _following(
    z: Complex128[Array, "root *cell"], p: _Polynomial, power: int, *, is_whole: bool
) -> LinearModel:
    """Return affine functions that follow the roots from the middles of the cells."""
    half = p.alpha.half
    still = LinearModel(z, jnp.zeros((4, *z.shape), z.dtype), jnp.zeros(z.shape), half)
    steepness = jnp.prod(jnp.where(_itself(z), 1.0, z[:, None] - z), axis=1)  # p'(z)
    motion = -p.at(still, power, is_whole=is_whole).slope
    slope = motion / jnp.where(steepness == 0.0, jnp.inf, steepness)
    return LinearModel(z, slope, still.rest, half)


def _discs(
    roots: LinearModel, values: LinearModel
) -> tuple[Float64[Array, "root *cell"], Float64[Array, "root root *cell"]]:
    """Return the radii of discs that hold all roots, and how far apart their middles stay."""
    z, slope = roots.centre, roots.slope
    motion = jnp.sum(jnp.abs(slope[:, :, None] - slope[:, None]) * roots.half[:, None], axis=0)
    apart = jnp.maximum(jnp.abs(z[:, None] - z) - motion, 0.0)
    spread = jnp.prod(jnp.where(_itself(z), 1.0, apart), axis=1) * (1.0 - _ROUNDING)
    radii = len(z) * values.size / spread
    radii = jnp.where(radii >= 0.0, radii, jnp.inf)
    return radii, jnp.where(_itself(z), jnp.inf, apart)


def _itself(z: Complex128[Array, "root *cell"]) -> Bool[Array, "root root *one"]:
    """Say in which pairs of roots both are the same."""
    return jnp.eye(len(z), dtype=bool).reshape(len(z), len(z), *[1] * (z.ndim - 1))


def _power(z: LinearModel, exponent: int) -> LinearModel:
    if exponent == 1:
        return z
    half = _power(z, exponent // 2)
    return half * half * z if exponent % 2 else half * half


def _middle_and_half(
    nodes: Float64[np.ndarray, " node"],
) -> tuple[Float64[np.ndarray, " cell"], Float64[np.ndarray, " cell"]]:
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    return middle, np.maximum(nodes[1:] - middle, middle - nodes[:-1])
