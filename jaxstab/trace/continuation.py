"""Branches of the boundary in any plane: pseudo-arclength steps, corrected by Newton's method.

Unknown is u = (x, y, theta / pi) in the unit cube. On a branch of a pair of roots two equations
hold (``circle_equations``), on the branch of a real root Re g = 0 and theta = 0 or pi. A step along
the tangent is corrected in the plane across it, so folds in x or y are nothing special.
"""

from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.proofs.plant import circle_equations, quick_slice
from jaxstab.region.corners import Branch
from jaxstab.region.curve import SliceCoefficients, slice_coefficients
from jaxstab.trace.plane import Monomials

Vector = Float64[np.ndarray, " 3"]
Points = Float64[np.ndarray, "points 3"]
Turns = Float64[np.ndarray, "*points"]

_CONVERGED = 1e-9  # of the unit cube: the last Newton step, which the next one squares
_MOST_STEPS = 13
_DIFFERENCE = 2.0**-17  # of the unit cube: derivatives are then good to about 1e-10
_STRAIGHT = 0.985  # cosine between tangents: grow the step
_BENT = 0.94  # shrink it
_SHORTEST = 1e-7
_ON_FACE = 1e-12
_MOST_POINTS = 20_000


class Corrected(NamedTuple):
    """Points, whether Newton's method converged, and the unit tangents."""

    position: Points
    converged: Bool[np.ndarray, " points"]
    tangent: Points


class Path(NamedTuple):
    """Points along a branch, their residuals, and how the branch goes on at its two ends."""

    points: Points
    residual: Float64[np.ndarray, " points"]
    stalled: tuple[bool, bool]


class _Equations(NamedTuple):
    """The two equations of a branch at points: values and derivatives by u."""

    value: Float64[np.ndarray, "2 points"]
    rows: Float64[np.ndarray, "2 points 3"]

    @property
    def tangent(self) -> Points:
        """The unit tangents of the branch."""
        along = _cross(*self.rows)
        unit: Points = along / np.sqrt(np.sum(along**2, axis=-1, keepdims=True))
        return unit


def _cross(one: Points, other: Points) -> Points:
    following, last = [1, 2, 0], [2, 0, 1]
    product: Points = one[:, following] * other[:, last] - one[:, last] * other[:, following]
    return product


def _equations(u: Points, plane: Monomials, branch: Branch) -> _Equations:
    """Return the equations, their derivatives by central differences."""
    shift = _DIFFERENCE * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    moved = u + shift[:, None]
    alpha, beta, *plant = plane.parameters(moved[..., :2])
    value = _values(quick_slice(*plant), alpha, beta, moved[..., 2], branch)
    rows = (value[:, 1:4] - value[:, 4:]) / (2.0 * _DIFFERENCE)
    return _Equations(value[:, 0], rows.swapaxes(1, 2))


def _values(
    c: SliceCoefficients, alpha: Turns, beta: Turns, turn: Turns, branch: Branch
) -> Float64[np.ndarray, "2 *points"]:
    """Return the equations at gains and theta / pi."""
    if branch == Branch.CURVE:
        return np.stack(circle_equations(c, alpha, beta, pi * turn))
    end = 0.0 if branch == Branch.Z_PLUS_ONE else 1.0
    real, _ = circle_equations(c, alpha, beta, np.full_like(alpha, pi * end))
    return np.stack([real, turn - end])


def correct(
    start: Points, normal: Points, anchor: Points, plane: Monomials, branch: Branch
) -> Corrected:
    """Solve for the points of a branch in the planes through ``anchor`` across ``normal``."""
    position = start
    with np.errstate(all="ignore"):  # what diverges is infinite or NaN
        for _ in range(_MOST_STEPS):
            (one, other), (row, last) = equations = _equations(position, plane, branch)
            across = np.sum(normal * (position - anchor), axis=-1)
            # Cramer's rule
            sides = _cross(last, normal), _cross(normal, row), _cross(row, last)
            parts = zip((one, other, across), sides, strict=True)
            volume = np.sum(normal * sides[2], axis=-1)
            move = sum(value[:, None] * side for value, side in parts) / volume[:, None]
            position = position - move
            size = np.max(np.abs(move), axis=-1)
            if not np.any(size > 0.1 * _CONVERGED):
                break
        return Corrected(position, size < _CONVERGED, equations.tangent)


def project(start: Points, plane: Monomials, branch: Branch) -> Corrected:
    """Bring points near a branch onto it, across the tangent that they would have on it."""
    with np.errstate(all="ignore"):
        tangent = _equations(start, plane, branch).tangent
    return correct(start, tangent, start, plane, branch)


def polish(
    points: Points, plane: Monomials, branch: Branch
) -> tuple[Points, Float64[np.ndarray, " points"]]:
    """Correct points once more with plant coefficients of full accuracy; also return |g| there."""
    for _ in range(2):  # steps of least length; the residual is the one before the last
        alpha, beta, *plant = plane.parameters(points[:, :2])
        gamma, delta, delay = (np.maximum(value, 0.0) for value in plant)
        c = slice_coefficients(gamma, delta, delay, np.ones(len(points)))
        value = _values(c, alpha, beta, points[:, 2], branch).T[..., None]
        rows = np.moveaxis(_equations(points, plane, branch).rows, 0, 1)
        across = np.swapaxes(rows, 1, 2)
        points = points - (across @ np.linalg.solve(rows @ across, value))[..., 0]
    return points, np.linalg.norm(value[..., 0], axis=1)


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
    points: Points
    stalled: bool
    closed: bool


def _walk(start: Corrected, sign: float, plane: Monomials, branch: Branch, longest: float) -> _Walk:
    here, tangent = start.position[0], sign * start.tangent[0]
    first, first_tangent = here, tangent
    points = [here]
    step, stalled, closed, inside = longest / 4, False, False, True
    while inside and not closed and not stalled and len(points) < _MOST_POINTS:
        guess = here + step * tangent
        found = _corrected(guess, tangent, guess, plane, branch)
        cosine = 0.0 if found is None else float(found[1] @ tangent)
        usable = found is not None and np.linalg.norm(found[0] - here) < 2 * step
        face = None
        if found is not None and usable and abs(cosine) >= _BENT:
            face = _first_face(here, found[0])
            if face is not None:
                found = _land(here, found[0], face, plane, branch)
        if found is None or not usable or abs(cosine) < _BENT:
            step /= 2
            stalled = step < _SHORTEST
            continue
        inside = face is None
        there, along = found
        closed = inside and len(points) > 2 and _passes(first, first_tangent, here, there)
        here, tangent = (first, tangent) if closed else (there, np.copysign(1.0, cosine) * along)
        points.append(here)
        step = min(longest, 1.5 * step) if abs(cosine) > _STRAIGHT else step
    return _Walk(np.stack(points), stalled, closed)


def _corrected(
    start: Vector, normal: Vector, anchor: Vector, plane: Monomials, branch: Branch
) -> tuple[Vector, Vector] | None:
    """Return one corrected point and the tangent there, or None if the method did not converge."""
    found = correct(start[None], normal[None], anchor[None], plane, branch)
    return (found.position[0], found.tangent[0]) if found.converged[0] else None


def _first_face(here: Vector, there: Vector) -> tuple[int, float] | None:
    """Return the axis and the value of the first face of the unit cube between two points."""
    faces = []
    for axis in range(3):
        for value, beyond in ((0.0, there[axis] < -_ON_FACE), (1.0, there[axis] > 1.0 + _ON_FACE)):
            if beyond:
                faces.append(((value - here[axis]) / (there[axis] - here[axis]), axis, value))
    return min(faces)[1:] if faces else None


def _land(
    here: Vector, there: Vector, face: tuple[int, float], plane: Monomials, branch: Branch
) -> tuple[Vector, Vector] | None:
    axis, value = face
    part = (value - here[axis]) / (there[axis] - here[axis])
    normal = np.eye(3)[axis]
    landing = _corrected(here + part * (there - here), normal, value * normal, plane, branch)
    if landing is None or np.linalg.norm(landing[0] - here) >= 2 * np.linalg.norm(there - here):
        return None
    return landing


def _passes(first: Vector, first_tangent: Vector, here: Vector, there: Vector) -> bool:
    """Tell whether the start of a path lies on this step of it, in the same direction."""
    step, back = there - here, first - here
    length = np.linalg.norm(step)
    along = float(back @ step) / length**2
    aside = np.linalg.norm(back - along * step)
    aligned = float(step @ first_tangent) > _BENT * length
    return bool(0.0 < along <= 1.0 and aside < 0.2 * length and aligned)
