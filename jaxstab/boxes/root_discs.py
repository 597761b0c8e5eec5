"""The spectral radius over whole cells of the parameters, from discs that hold all roots.

For distinct z_1 ... z_n the roots of a monic p of degree n lie in the discs around the z_j with the
radii n |p(z_j)| / prod |z_j - z_k|, and a disc apart from all others holds one (Smith 1970). Here
every z_j follows a root to first order through the cell, as an affine function of alpha, beta,
gamma and delta; so the discs are small of second order, and linear models bound them for all points
of the cell. |z_j| is convex, which leaves its multilinear interpolation to compare:

    |z_j(x)| <= interpolation of |z_j| at the corners,    |z_j(x)| >= its tangent in the middle.
"""

from functools import reduce
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64

from jaxstab.boxes.models import LinearModel
from jaxstab.boxes.plant import HandBoxes, PlantModels, plant_models
from jaxstab.model import characteristic_polynomial, companion_matrix
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.model.linear_loop import loop_factors
from jaxstab.model.transfer import UNIT
from jaxstab.model.transfer import product as polynomial_product

_PAIRS_OF_ROOTS = 2**16  # of the cells that are computed at once: they stay in the cache of a CPU
_ROUNDING = 1e-13  # of 1 and the largest root, and as a share of the discs
_CORNERS = list(product((0, 1), repeat=4))  # along alpha, beta, gamma and delta

Roots = Complex128[np.ndarray, "root cell"]
Cells = Float64[np.ndarray, " cell"]
Walls = tuple[Cells, Cells]
Halves = Float64[np.ndarray, "4 1 cell"]
Slopes = Complex128[np.ndarray, "4 root cell"]
Pairs = Complex128[np.ndarray, "root root cell"]
Radii = Float64[np.ndarray, "root cell"]
Distances = Float64[np.ndarray, "root root cell"]


def interpolation_errors(
    alpha: Float64[np.ndarray, " alpha_node"],
    beta: Float64[np.ndarray, " beta_node"],
    hands: HandBoxes,
    delay: float,
    corners: Float64[np.ndarray, "2 2 alpha_node beta_node"],
    filters: Filters | None = None,
) -> Float64[np.ndarray, "alpha_cell beta_cell"]:
    """Bound the error of a multilinear interpolation of the spectral radius in each cell.

    Args:
        alpha: nodes of alpha, ascending.
        beta: nodes of beta, ascending.
        hands: one box of gamma and delta.
        delay: time delay t_d/T >= 0 in samples.
        corners: what is interpolated, at the lower and the upper gamma and delta of the box.
        filters: velocity estimator and position filter, in units of one sample.

    Returns:
        Bounds for all points of the cells; infinite where the roots cannot be told apart.

    Raises:
        ValueError: gamma, delta or delay is outside the range of the model.

    Source: Smith (1970), Error bounds for zeros of a polynomial based upon Gerschgorin's theorems,
    for the characteristic polynomial of eq. (9) of Hulin, Preusche, Hirzinger (2008).
    """
    plant = plant_models(hands, delay)
    hand = float(hands.gamma[0]), float(hands.delta[0]), delay
    errors = np.empty((alpha.size - 1, beta.size - 1))
    multipliers = _multipliers(delay, filters)
    degree = 2 + len(multipliers[0].coefficients) - 1 + multipliers[0].power
    most = max(1, _PAIRS_OF_ROOTS // degree**2)
    for start in range(0, errors.size, most):
        cells = np.arange(start, min(start + most, errors.size))
        i, j = np.unravel_index(cells, errors.shape)
        (a, half_a), (b, half_b) = _middles_and_halves(alpha, i), _middles_and_halves(beta, j)
        polynomials = characteristic_polynomial(a, b, *hand, **as_keywords(filters))
        matrices = companion_matrix(polynomials)
        z = np.linalg.eigvals(matrices).T.astype(np.complex128)
        half = np.concatenate([[half_a, half_b], np.broadcast_to(plant.gamma.half, (2, a.size))])
        p = _Polynomial.over((a, b), half[:, None], plant, delay, multipliers)
        given = [corners[k, m, i + di, j + dj] for di, dj, k, m in _CORNERS]
        with np.errstate(all="ignore"):  # where roots meet, discs are infinite
            errors.flat[cells] = _errors(z, p, given)
    return errors


def _middles_and_halves(
    nodes: Float64[np.ndarray, " node"], cell: Int64[np.ndarray, " cell"]
) -> tuple[Cells, Cells]:
    low, high = nodes[cell], nodes[cell + 1]
    middle = 0.5 * (low + high)
    return middle, np.maximum(high - middle, middle - low)


class _Multiplier(NamedTuple):
    """A polynomial in z: z^power times one by its coefficients, highest power first."""

    coefficients: tuple[float, ...]
    power: int

    def at(self, z: LinearModel) -> LinearModel:
        # The models' own rounding, of each step, is more than that of the coefficients.
        value = z * 0.0 + self.coefficients[0]
        for coefficient in self.coefficients[1:]:
            value = value * z + coefficient
        return value * _power(z, self.power) if self.power else value

    def of_number(self, z: Roots) -> Roots:
        value: np.ndarray = np.polyval(self.coefficients, z) * z**self.power
        return value


def _multipliers(delay: float, filters: Filters | None) -> list[_Multiplier]:
    """Return what estimator, filter and delay multiply D, alpha N and beta N by."""
    velocity, position = UNIT, UNIT
    if filters:
        velocity, position = filters[0].filter.transfer(), filters[1].transfer()
    lag = int(delay) + (not float(delay).is_integer())
    powers, factors = loop_factors(lag, velocity, position)
    polynomials = (reduce(polynomial_product, each) for each in factors)
    return [
        _Multiplier(tuple(float(c.rounded()) for c in polynomial), power)
        for polynomial, power in zip(polynomials, powers, strict=True)
    ]


class _Polynomial(NamedTuple):
    """p over cells, in linear models of (alpha, beta, gamma, delta) of shape (1, cell)."""

    alpha: LinearModel
    beta: LinearModel
    d1: LinearModel
    d0: LinearModel
    n2: LinearModel
    n1: LinearModel
    n0: LinearModel
    multipliers: list[_Multiplier]
    is_whole: bool

    @classmethod
    def over(
        cls,
        walls: Walls,
        half: Halves,
        plant: PlantModels,
        delay: float,
        multipliers: list[_Multiplier],
    ) -> "_Polynomial":
        still = np.zeros((2, 1, 1))
        unit = np.eye(4)[:, :, None, None]
        is_whole = float(delay).is_integer()

        def of_hand(name: str) -> LinearModel:
            model: LinearModel = getattr(plant, name)
            slope = np.concatenate([still, model.slope[:, None]])
            return LinearModel(model.centre, slope, model.rest, half)

        alpha, beta = (
            LinearModel(gain, slope, np.zeros(1), half)
            for gain, slope in zip(walls, unit[:2], strict=True)
        )
        d1, d0, n2, n1, n0 = map(of_hand, ("d1", "d0", "n2", "n1", "n0"))
        return cls(alpha, beta, d1, d0, n2, n1, n0, multipliers, is_whole)

    def at(self, z: LinearModel) -> LinearModel:
        numerator = z * self.n2 + self.n1
        if not self.is_whole:  # else z divides N
            numerator = numerator * z + self.n0
        base, stiffness, damping = (multiplier.at(z) for multiplier in self.multipliers)
        wall = self.alpha * stiffness + self.beta * damping
        return base * ((z + self.d1) * z + self.d0) + numerator * wall

    def slopes(self, z: Roots) -> Slopes:
        """Return the derivatives of p(z) at fixed z, in the middles of the cells."""
        numerator = (self.n2, self.n1) if self.is_whole else (self.n2, self.n1, self.n0)
        n = np.polyval([model.centre for model in numerator], z)
        d_hand, n_hand = (
            np.polyval([model.slope[2:] for model in models], z)
            for models in ((self.d1, self.d0), numerator)
        )
        base, stiffness, damping = (multiplier.of_number(z) for multiplier in self.multipliers)
        wall = self.alpha.centre * stiffness + self.beta.centre * damping
        return np.stack([n * stiffness, n * damping, *(base * d_hand + wall * n_hand)])


def _errors(z: Roots, p: _Polynomial, corners: list[Cells]) -> Cells:
    between = z[:, None] - z
    roots = _following(z, between, p)
    radii, distance = _discs(roots, between, p.at(roots))
    is_apart = np.all(distance > radii[:, None] + radii, axis=1)
    lost = np.where(is_apart, radii, 2.0 * np.sum(radii, axis=0))  # a chain of discs has a root

    size = np.abs(z)
    inwards = np.conj(z) / np.where(z == 0.0, 1.0, size)
    moves = roots.slope * roots.half
    above, below = np.full(z.shape[1], -np.inf), np.full(z.shape, -np.inf)
    for corner, given in zip(_CORNERS, corners, strict=True):
        at_corner = z + sum(
            move if side else -move for side, move in zip(corner, moves, strict=True)
        )
        above = np.maximum(above, np.max(np.abs(at_corner) + radii, axis=0) - given)
        below = np.maximum(below, given - (inwards * at_corner).real)
    rounding = _ROUNDING * (1.0 + np.max(size, axis=0))
    return np.maximum(above, np.min(below + lost, axis=0)) + rounding


def _following(z: Roots, between: Pairs, p: _Polynomial) -> LinearModel:
    """Return affine functions that follow the roots from the middles of the cells."""
    steepness = np.prod(np.where(_itself(z), 1.0, between), axis=1)  # p'(z)
    slope = -p.slopes(z) / np.where(steepness == 0.0, np.inf, steepness)
    return LinearModel(z, slope, np.zeros(1), p.alpha.half)


def _discs(roots: LinearModel, between: Pairs, values: LinearModel) -> tuple[Radii, Distances]:
    """Return the radii of discs that hold all roots, and how far apart their middles stay."""
    distance = np.abs(between)
    for slope, half in zip(roots.slope, roots.half, strict=True):
        distance -= np.abs(slope[:, None] - slope) * half
    apart = np.maximum(distance, 0.0)
    spread = np.prod(np.where(_itself(between), 1.0, apart), axis=1) * (1.0 - _ROUNDING)
    radii = len(between) * values.size / spread
    radii = np.where(radii >= 0.0, radii, np.inf)
    return radii, np.where(_itself(between), np.inf, apart)


def _itself(z: Complex128[np.ndarray, "root *rest"]) -> Bool[np.ndarray, "root root 1"]:
    """Say in which pairs of roots both are the same."""
    return np.eye(len(z), dtype=bool)[:, :, None]


def _power(z: LinearModel, exponent: int) -> LinearModel:
    if exponent == 1:
        return z
    half = _power(z, exponent // 2)
    return half * half * z if exponent % 2 else half * half
