"""What people do today, written as well as it goes: eigenvalues, contours of grids, n-cubes."""

from collections.abc import Callable
from typing import NamedTuple

import contourpy
import numpy as np

import jaxstab
from benchmarks import eigenvalues
from jaxstab.model import by_name

_BATCH = 1 << 15  # matrices per call of LAPACK, so that memory stays bounded

Function = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Outline(NamedTuple):
    """A boundary as found: the points (n, 2), and the segments (m, 2, 2) between them."""

    points: np.ndarray
    segments: np.ndarray


class LoopFamily:
    """p(z) of one gamma, delta, delay and estimator as what it is, affine in (alpha, beta)."""

    def __init__(
        self, gamma: float, delta: float, delay: float, velocity: jaxstab.Velocity | None = None
    ) -> None:
        plant = gamma, delta, delay
        alpha, beta = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
        parts = jaxstab.characteristic_polynomial(alpha, beta, **by_name(*plant), velocity=velocity)
        plant, with_alpha, with_beta = np.asarray(parts)
        self.plant, self.alpha, self.beta = plant, with_alpha - plant, with_beta - plant

    def coefficients(self, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """Return monic coefficients (point, degree + 1), highest power first."""
        return (
            self.plant + np.multiply.outer(alpha, self.alpha) + np.multiply.outer(beta, self.beta)
        )

    def radius(self, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """Return the spectral radius by batched LAPACK, for flat arrays of points."""
        found = np.empty(alpha.shape)
        for start in range(0, alpha.size, _BATCH):
            part = slice(start, start + _BATCH)
            found[part] = eigenvalues.radius(self.coefficients(alpha[part], beta[part]))
        return found


def contour(alpha: np.ndarray, beta: np.ndarray, values: np.ndarray) -> Outline:
    """Return the zero contour of values on a grid, values[j, i] at (alpha[i], beta[j])."""
    lines = contourpy.contour_generator(alpha, beta, values).lines(0.0)
    segments = [np.stack([line[:-1], line[1:]], axis=1) for line in lines]
    return Outline(np.concatenate(lines), np.concatenate(segments))


def eigenvalue_grid(family: LoopFamily, alpha: np.ndarray, beta: np.ndarray) -> Outline:
    """Contour the spectral radius by companion eigenvalues on a grid."""
    points = np.meshgrid(alpha, beta)
    radius = family.radius(*(p.ravel() for p in points)).reshape(points[0].shape)
    return contour(alpha, beta, radius - 1.0)


# ------------------------------------------------------------------------------- n-cube bisection


def bisected(
    function: Function, alpha_ends: np.ndarray, beta_ends: np.ndarray, coarse: int, halvings: int
) -> Outline:
    """Follow the zero of a function by n-cube bisection in the plane, as MDBM.jl does.

    The squares of a coarse grid whose corners differ in sign are kept; each is cut in four,
    halvings times, again keeping those that bracket; then squares beside edges that the line
    crosses are added until none is missing. Zeros are interpolated linearly on the edges.
    """
    count, start = coarse << halvings, np.array([alpha_ends[0], beta_ends[0]])
    step = np.array([np.ptp(alpha_ends), np.ptp(beta_ends)]) / count
    is_known, values = (np.zeros((count + 1, count + 1), kind) for kind in (bool, float))

    def at(nodes: np.ndarray) -> np.ndarray:
        """Function values at nodes (..., 2) of the finest lattice, each evaluated once."""
        missing = np.unique(nodes[~is_known[*np.moveaxis(nodes, -1, 0)]], axis=0)
        if missing.size:
            values[*missing.T] = function(*(start + missing * step).T)
            is_known[*missing.T] = True
        return values[*np.moveaxis(nodes, -1, 0)]

    def bracketing(squares: np.ndarray, side: int) -> np.ndarray:
        known = np.empty((0, 2), np.int64)
        while squares.size:
            signs = at(squares[:, None] + side * _CORNERS) > 0.0
            differs = signs.any(axis=1) & ~signs.all(axis=1)
            squares, signs = squares[differs], signs[differs]
            known = np.unique(np.concatenate([known, squares]), axis=0)
            crossed = signs != np.roll(signs, -1, axis=1)  # the edge from each corner to the next
            beside = np.unique((squares[:, None] + side * _BESIDE)[crossed], axis=0)
            is_inside = ((beside >= 0) & (beside <= count - side)).all(axis=1)
            is_new = ~np.isin(*(some @ [count + 1, 1] for some in (beside, known)))
            squares = beside[is_inside & is_new]
        return known

    side = 1 << halvings
    squares = np.stack(np.meshgrid(*2 * [np.arange(coarse) * side]), axis=-1).reshape(-1, 2)
    squares = bracketing(squares, side)
    while side > 1:
        side //= 2
        squares = bracketing((squares[:, None] + side * _CORNERS).reshape(-1, 2), side)
    corners = squares[:, None] + _CORNERS
    here, following = at(corners), np.roll(at(corners), -1, axis=1)
    crossed = (here > 0.0) != (following > 0.0)
    part = here / np.where(crossed, here - following, 1.0)
    found = start + step * (corners + part[..., None] * (np.roll(corners, -1, axis=1) - corners))
    # A square has two crossings, or four at a saddle: joined in pairs.
    return Outline(found[crossed], found[crossed].reshape(-1, 2, 2))


_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])  # of a square, around it
_BESIDE = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])  # the squares at the edges that begin there
