"""Branches of the boundary in any plane: pseudo-arclength steps, corrected by Newton's method.

Unknown is u = (x, y, theta / pi) in the unit cube. On a branch of a pair of roots two equations
hold (``circle_equations``), on the branch of a real root Re g = 0 and theta = 0 or pi. A step along
the tangent is corrected in the plane across it, so folds in x or y are nothing special.
"""

from functools import partial
from math import pi
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Float64

from jaxstab.arrays import Array
from jaxstab.batches import in_batches
from jaxstab.boxes.circle import circle_equations, quick_slice
from jaxstab.region.corners import Branch
from jaxstab.region.curve import SliceCoefficients, slice_coefficients
from jaxstab.trace.plane import Monomials

Vector = Float64[np.ndarray, " 3"]

_CONVERGED = 1e-9  # of the unit cube: the last Newton step, which the next one squares
_STRAIGHT = 0.985  # cosine between tangents: grow the step
_BENT = 0.94  # shrink it
_SHORTEST = 1e-7
_ON_FACE = 1e-12
_MOST_POINTS = 20_000
_BATCH = 256  # points polished at once: one size, compiled once


class Corrected(NamedTuple):
    """A point, whether Newton's method converged, and the unit tangent."""

    position: Array
    converged: Array
    tangent: Array


class Path(NamedTuple):
    """Points along a branch, their residuals, and how the branch goes on at its two ends."""

    points: Float64[np.ndarray, "points 3"]
    residual: Float64[np.ndarray, " points"]
    stalled: tuple[bool, bool]


def _equations(u: Array, plane: Monomials, branch: Array) -> Array:
    """Return the two equations of a branch."""
    _, _, gamma, delta, delay = plane.parameters(u[:2])
    return _equations_on(quick_slice(gamma, delta, delay), u, plane, branch)


def _equations_on(c: SliceCoefficients, u: Array, plane: Monomials, branch: Array) -> Array:
    alpha, beta, *_ = plane.parameters(u[:2])
    end = jnp.where(branch == Branch.Z_PLUS_ONE, 0.0, 1.0)
    pair = branch == Branch.CURVE
    theta = pi * jnp.where(pair, u[2], end)
    real, imaginary = circle_equations(c, alpha, beta, theta)
    return jnp.stack([real, jnp.where(pair, imaginary, u[2] - end)])


def _correct(
    start: Array, normal: Array, anchor: Array, plane: Monomials, branch: Array
) -> Corrected:
    """Solve for the point of a branch in the plane through ``anchor`` across ``normal``."""

    def equations(u: Array, _: None = None) -> Array:
        across = jnp.dot(normal, u - anchor)
        return jnp.append(_equations(u, plane, branch), across)

    solver: optimistix.Newton[Array, Array, None] = optimistix.Newton(rtol=1e-10, atol=1e-10)
    solution: optimistix.Solution[Array, None]
    solution = optimistix.root_find(equations, solver, start, max_steps=12, throw=False)
    jacobian = jax.jacfwd(equations)(solution.value)
    move = jnp.linalg.solve(jacobian, equations(solution.value))
    position = solution.value - move
    tangent = jnp.cross(jacobian[0], jacobian[1])
    return Corrected(
        position,
        jnp.max(jnp.abs(move)) < _CONVERGED,
        tangent / jnp.linalg.norm(tangent),
    )


correct = jax.jit(_correct)


@jax.jit
@partial(jax.vmap, in_axes=(0, None, None))
def project(start: Array, plane: Monomials, branch: Array) -> Corrected:
    """Bring points near a branch onto it, across the tangent that they would have on it."""
    rows = jax.jacfwd(_equations)(start, plane, branch)
    tangent = jnp.cross(rows[0], rows[1])
    return _correct(start, tangent / jnp.linalg.norm(tangent), start, plane, branch)


def polish(
    points: Float64[np.ndarray, "points 3"], plane: Monomials, branch: Branch
) -> tuple[Float64[np.ndarray, "points 3"], Float64[np.ndarray, " points"]]:
    """Correct points once more with plant coefficients of full accuracy; also return |g| there."""
    residual = np.zeros(len(points))
    for _ in range(2):
        points, residual = in_batches(_BATCH, partial(_polished, plane, branch), points)
    return points, residual


def _polished(plane: Monomials, branch: Branch, points: Array) -> tuple[Array, Array]:
    return _polish_step(points, _accurate_slices(points, plane), plane, np.float64(branch))


def _accurate_slices(points: Array, plane: Monomials) -> SliceCoefficients:
    _, _, gamma, delta, delay = plane.parameters(points[:, :2])
    gamma, delta, delay = (np.maximum(value, 0.0) for value in (gamma, delta, delay))
    return slice_coefficients(gamma, delta, delay, np.ones(len(points)))


@jax.jit
@partial(jax.vmap, in_axes=(0, 0, None, None))
def _polish_step(
    u: Array, c: SliceCoefficients, plane: Monomials, branch: Array
) -> tuple[Array, Array]:
    """One Newton step of least length; the residual is the one before the step."""
    value = _equations_on(c, u, plane, branch)
    rows = jax.jacfwd(_equations)(u, plane, branch)
    move = rows.T @ jnp.linalg.solve(rows @ rows.T, value)
    return u - move, jnp.linalg.norm(value)


def follow(start: Corrected, plane: Monomials, branch: Branch, longest: float) -> Path:
    """Return the whole branch through a point, as far as it lies in the unit cube.

    Steps are at most ``longest``; they are halved where the branch bends. A path stalls where even
    the shortest step fails: at a point where branches meet without a common direction.
    """
    ahead = _walk(start, 1.0, plane, branch, longest)
    points, stalled = ahead.points, (False, False)
    if not ahead.closed:
        back = _walk(start, -1.0, plane, branch, longest)
        points = np.concatenate([back.points[:0:-1], points])
        stalled = (back.stalled, ahead.stalled)
    points, residual = polish(points, plane, branch)
    return Path(points, residual, stalled)


class _Walk(NamedTuple):
    points: Float64[np.ndarray, "points 3"]
    stalled: bool
    closed: bool


def _walk(start: Corrected, sign: float, plane: Monomials, branch: Branch, longest: float) -> _Walk:
    code = np.float64(branch)
    here, tangent = np.asarray(start.position), sign * np.asarray(start.tangent)
    first, first_tangent = here, tangent
    points = [here]
    step, stalled, closed, inside = longest / 4, False, False, True
    while inside and not closed and not stalled and len(points) < _MOST_POINTS:
        guess = here + step * tangent
        found = correct(guess, tangent, guess, plane, code)
        there, along = np.asarray(found.position), np.asarray(found.tangent)
        cosine = float(along @ tangent)
        usable = bool(found.converged) and np.linalg.norm(there - here) < 2 * step
        if not usable or abs(cosine) < _BENT:
            step /= 2
            stalled = step < _SHORTEST
            continue
        face = _first_face(here, there)
        if face is not None:
            landing = _land(here, there, face, plane, code)
            if landing is None:
                step /= 2
                stalled = step < _SHORTEST
                continue
            found, inside = landing, False
            there = np.asarray(found.position)
        closed = inside and len(points) > 2 and _passes(first, first_tangent, here, there)
        here, tangent = (first, tangent) if closed else (there, np.copysign(1.0, cosine) * along)
        points.append(here)
        step = min(longest, 1.5 * step) if abs(cosine) > _STRAIGHT else step
    return _Walk(np.stack(points), stalled, closed)


def _first_face(here: Vector, there: Vector) -> tuple[int, float] | None:
    """Return the axis and the value of the first face of the unit cube between two points."""
    faces = []
    for axis in range(3):
        for value, beyond in ((0.0, there[axis] < -_ON_FACE), (1.0, there[axis] > 1.0 + _ON_FACE)):
            if beyond:
                faces.append(((value - here[axis]) / (there[axis] - here[axis]), axis, value))
    return min(faces)[1:] if faces else None


def _land(
    here: Vector, there: Vector, face: tuple[int, float], plane: Monomials, branch: np.float64
) -> Corrected | None:
    axis, value = face
    part = (value - here[axis]) / (there[axis] - here[axis])
    normal = np.eye(3)[axis]
    landing = correct(here + part * (there - here), normal, value * normal, plane, branch)
    near = np.linalg.norm(np.asarray(landing.position) - here) < 2 * np.linalg.norm(there - here)
    return landing if bool(landing.converged) and near else None


def _passes(first: Vector, first_tangent: Vector, here: Vector, there: Vector) -> bool:
    """Tell whether the start of a path lies on this step of it, in the same direction."""
    step, back = there - here, first - here
    length = np.linalg.norm(step)
    along = float(back @ step) / length**2
    aside = np.linalg.norm(back - along * step)
    aligned = float(step @ first_tangent) > _BENT * length
    return bool(0.0 < along <= 1.0 and aside < 0.2 * length and aligned)
