"""What people do today, written as well as it goes: eigenvalues, contours of grids, n-cubes."""

from collections.abc import Callable
from typing import NamedTuple

import contourpy
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

import jaxstab
from jaxstab.model import by_name

LAPACK_WORK = 2e4  # points times degree squared of a timed call: as short as those of jaxstab
_BATCH = 1 << 15  # matrices per call of LAPACK, so that memory stays bounded

jax_eigenvalues = jax.jit(jnp.linalg.eigvals)

Function = Callable[[np.ndarray, np.ndarray], np.ndarray]


def largest_modulus(poles: ArrayLike) -> np.ndarray:
    """Return the modulus of the largest of each row of poles."""
    return np.abs(np.asarray(poles)).max(axis=-1)


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

    def companions(self, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """Return the companion matrices (point, degree, degree), as numpy.roots has them."""
        coefficients = self.coefficients(alpha, beta)
        degree = coefficients.shape[-1] - 1
        matrices = np.zeros((*coefficients.shape[:-1], degree, degree))
        matrices[...] = np.eye(degree, k=-1)
        matrices[..., 0, :] = -coefficients[..., 1:]
        return matrices

    def radius(self, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """Return the spectral radius by batched LAPACK, for flat arrays of points."""
        found = np.empty(alpha.shape)
        for start in range(0, alpha.size, _BATCH):
            part = slice(start, start + _BATCH)
            poles = np.linalg.eigvals(self.companions(alpha[part], beta[part]))
            found[part] = largest_modulus(poles)
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
    plane = _Samples(function, alpha_ends, beta_ends, coarse << halvings)
    side = 1 << halvings
    squares = np.stack(np.meshgrid(*2 * [np.arange(coarse) * side]), axis=-1).reshape(-1, 2)
    squares = _with_neighbours(plane, _bracketing(plane, squares, side), side)
    while side > 1:
        side //= 2
        parts = (squares[:, None] + side * _CORNERS[[0, 1, 3, 2]]).reshape(-1, 2)
        squares = _with_neighbours(plane, _bracketing(plane, parts, side), side)
    return _crossings(plane, squares)


_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])  # of a square, around it


class _Samples:
    """Function values at the nodes of a fine lattice, each evaluated at most once."""

    def __init__(
        self, function: Function, alpha_ends: np.ndarray, beta_ends: np.ndarray, count: int
    ) -> None:
        self.function, self.count = function, count
        self.start = np.array([alpha_ends[0], beta_ends[0]])
        self.step = np.array([np.ptp(alpha_ends), np.ptp(beta_ends)]) / count
        self.keys = np.empty(0, np.int64)
        self.values = np.empty(0)

    def at(self, nodes: np.ndarray) -> np.ndarray:
        """Return the values at nodes (..., 2)."""
        wanted = nodes[..., 0] * (self.count + 1) + nodes[..., 1]
        missing = np.setdiff1d(wanted, self.keys)
        if missing.size:
            new = np.stack(np.divmod(missing, self.count + 1), axis=-1)
            values = np.concatenate([self.values, self.function(*self.position(new).T)])
            keys = np.concatenate([self.keys, missing])
            order = np.argsort(keys)
            self.keys, self.values = keys[order], values[order]
        return self.values[np.searchsorted(self.keys, wanted)]

    def position(self, nodes: np.ndarray) -> np.ndarray:
        """Return (alpha, beta) of nodes."""
        return self.start + nodes * self.step


def _bracketing(plane: _Samples, squares: np.ndarray, side: int) -> np.ndarray:
    signs = plane.at(squares[:, None] + side * _CORNERS) > 0.0
    return squares[signs.any(axis=1) & ~signs.all(axis=1)]


def _with_neighbours(plane: _Samples, squares: np.ndarray, side: int) -> np.ndarray:
    """Add squares that bracket beside those that do, until there are no more."""
    known = np.unique(squares, axis=0)
    newest = known
    while newest.size:
        signs = plane.at(newest[:, None] + side * _CORNERS) > 0.0
        crossed = signs != np.roll(signs, -1, axis=1)  # the edge from each corner to the next
        beside = side * np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])
        candidates = np.unique((newest[:, None] + beside)[crossed], axis=0)
        limit = plane.count - side
        candidates = candidates[((candidates >= 0) & (candidates <= limit)).all(axis=1)]
        candidates = candidates[~_contains(known, candidates, plane.count)]
        newest = _bracketing(plane, candidates, side)
        known = np.concatenate([known, newest])
    return known


def _contains(squares: np.ndarray, candidates: np.ndarray, count: int) -> np.ndarray:
    keys = [rows[:, 0] * (count + 1) + rows[:, 1] for rows in (candidates, squares)]
    return np.isin(*keys)


def _crossings(plane: _Samples, squares: np.ndarray) -> Outline:
    corners = squares[:, None] + _CORNERS
    values = plane.at(corners)
    following = np.roll(values, -1, axis=1)
    crossed = (values > 0.0) != (following > 0.0)
    part = values / np.where(crossed, values - following, 1.0)
    start, end = plane.position(corners), plane.position(np.roll(corners, -1, axis=1))
    found = start + part[..., None] * (end - start)
    # A square has two crossings, or four at a saddle: joined in pairs.
    return Outline(found[crossed], found[crossed].reshape(-1, 2, 2))
