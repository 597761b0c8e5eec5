"""Limits, membership, distance and area by the exact boundary, from where its points are known."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxstab.region.curve import SliceCoefficients, curve_point
from jaxstab.region.outline import Outline
from jaxstab.region.pieces import Branch
from jaxstab.region.roots import bracketed_root

_CROSSINGS = 8  # of a row with the boundary; rows with more are answered by NaN
_BATCH = 1024
_LAST_STEP = 1e-10  # radians
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(16)


@partial(jax.jit, static_argnames="axis")
def limits(c: SliceCoefficients, outline: Outline, values: Array, *, axis: int) -> Array:
    """Return where lines of constant alpha (axis 0) or beta (axis 1) enter and leave the region."""

    def outermost(value: Array) -> Array:
        places, exist = _crossings(c, outline, value, axis)
        least = jnp.min(jnp.where(exist, places, jnp.inf))
        most = jnp.max(jnp.where(exist, places, -jnp.inf))
        return jnp.where(jnp.any(exist), jnp.stack([least, most]), jnp.nan)

    flat: Array = lax.map(outermost, values.ravel(), batch_size=_BATCH)
    pairs: Array = flat.reshape(*values.shape, 2)
    return pairs


@jax.jit
def contains(c: SliceCoefficients, outline: Outline, alpha: Array, beta: Array) -> Array:
    """Return whether an odd number of crossings of the row lies beyond alpha."""

    def is_inside(point: tuple[Array, Array]) -> Array:
        places, exist = _crossings(c, outline, point[1], 1)
        return jnp.sum(exist & (places > point[0])) % 2 == 1

    flat: Array = lax.map(is_inside, (alpha.ravel(), beta.ravel()), batch_size=_BATCH)
    return flat.reshape(alpha.shape)


@jax.jit
def distance(c: SliceCoefficients, outline: Outline, alpha: Array, beta: Array) -> Array:
    """Return the distance to the exact boundary, positive inside."""

    def to_boundary(point: tuple[Array, Array]) -> Array:
        return _nearest(c, outline, jnp.stack(point))

    flat = lax.map(to_boundary, (alpha.ravel(), beta.ravel()), batch_size=_BATCH)
    nothing = jnp.where(outline.resolved, jnp.inf, jnp.nan)
    away = jnp.where(outline.size > 0, flat.reshape(alpha.shape), nothing)
    return jnp.where(contains(c, outline, alpha, beta), away, -away)


@jax.jit
def area(c: SliceCoefficients, outline: Outline) -> Array:
    """Return the integral of alpha d(beta) around the boundary, by Gauss' rule on each piece."""
    begin, end = outline.angles[:, :1], outline.angles[:, 1:]
    half = 0.5 * (end - begin)
    theta = begin + half * (1.0 + jnp.asarray(_GAUSS_NODES))
    (alpha, _), (_, slope) = jax.jvp(lambda x: curve_point(c, x), (theta,), (jnp.ones_like(theta),))
    on_curve = jnp.sum(half * alpha * slope * jnp.asarray(_GAUSS_WEIGHTS), axis=1)
    here, there = outline.vertices[:-1], outline.vertices[1:]
    on_line = 0.5 * (here[:, 0] + there[:, 0]) * (there[:, 1] - here[:, 1])
    pieces = jnp.where(outline.branches == Branch.CURVE, on_curve, on_line)
    enclosed = jnp.sum(jnp.where(outline.branches < 0, 0.0, pieces))
    return jnp.where(outline.resolved, enclosed, jnp.nan)


@jax.jit
def deviation(c: SliceCoefficients, outline: Outline) -> Array:
    """Return how far the boundary leaves the polygon, as a share of the region's diameter."""
    middle = jnp.stack(curve_point(c, jnp.mean(outline.angles, axis=1)), axis=-1)
    bulges = jnp.hypot(*_from_chord(outline, middle).T)
    on_curve = outline.branches == Branch.CURVE
    size = jnp.hypot(*(jnp.max(outline.vertices, axis=0) - jnp.min(outline.vertices, axis=0)))
    return jnp.max(jnp.where(on_curve, bulges, 0.0)) / size


def _crossings(
    c: SliceCoefficients, outline: Outline, value: Array, axis: int
) -> tuple[Array, Array]:
    """Return the other coordinate where a line of constant ``axis`` meets the exact boundary."""
    known = lax.stop_gradient(outline)
    along = known.vertices[:, axis]
    met = ((along[:-1] <= value) != (along[1:] <= value)) & (known.branches >= 0)
    edges = jnp.nonzero(met, size=_CROSSINGS, fill_value=-1)[0]

    def excess(parameters: tuple[SliceCoefficients, Array], theta: Array) -> Array:
        slice_, goal = parameters
        return curve_point(slice_, theta)[axis] - goal

    angles = known.angles[edges]
    theta = bracketed_root(excess, (c, value), angles[:, 0], angles[:, 1])
    here, there = outline.vertices[edges], outline.vertices[edges + 1]
    share = (value - here[:, axis]) / _nonzero(there[:, axis] - here[:, axis])
    on_line = here[:, 1 - axis] + share * (there[:, 1 - axis] - here[:, 1 - axis])
    on_curve = curve_point(c, theta, _last_step(c, theta, value, axis))[1 - axis]
    places = jnp.where(known.branches[edges] == Branch.CURVE, on_curve, on_line)
    return jnp.where(jnp.sum(met) <= _CROSSINGS, places, jnp.nan), edges >= 0


def _last_step(c: SliceCoefficients, theta: Array, value: Array, axis: int) -> Array:
    """Return Newton's step from a crossing's angle: close to pi, what rounding took from it."""
    c, theta, value = lax.stop_gradient((c, theta, value))
    here, tangent = jax.jvp(lambda x: curve_point(c, x), (theta,), (jnp.ones_like(theta),))
    return jnp.clip((value - here[axis]) / _nonzero(tangent[axis]), -_LAST_STEP, _LAST_STEP)


def _nearest(c: SliceCoefficients, outline: Outline, point: Array) -> Array:
    """Return the distance to the boundary: to the nearest chord, then to the curve around it."""
    gaps = jnp.sum(_from_chord(outline, point) ** 2, axis=-1)
    edge = jnp.argmin(jnp.where(outline.branches >= 0, gaps, jnp.inf))
    near = jnp.clip(edge + jnp.arange(-1, 2), 0, len(gaps) - 1)

    def along(parameters: tuple[SliceCoefficients, Array], theta: Array) -> Array:
        slice_, target = parameters
        here, tangent = jax.jvp(lambda x: curve_point(slice_, x), (theta,), (jnp.ones_like(theta),))
        dot: Array = (here[0] - target[0]) * tangent[0] + (here[1] - target[1]) * tangent[1]
        return dot

    def gap(theta: Array) -> Array:
        alpha, beta = curve_point(c, theta)
        return (alpha - point[0]) ** 2 + (beta - point[1]) ** 2

    begin, end = outline.angles[near].T
    foot = bracketed_root(along, (c, point), begin, end)
    to_curve = jnp.minimum(jnp.minimum(gap(begin), gap(end)), gap(foot))
    nearest = jnp.where(outline.branches[near] == Branch.CURVE, to_curve, gaps[near])
    least: Array = jnp.min(jnp.where(outline.branches[near] >= 0, nearest, jnp.inf))
    return jnp.sqrt(least)


def _from_chord(outline: Outline, points: Array) -> Array:
    """Return the vectors from the nearest points of the edges' chords to points."""
    here = outline.vertices[:-1]
    chord = outline.vertices[1:] - here
    share = jnp.sum((points - here) * chord, axis=-1) / _nonzero(jnp.sum(chord**2, axis=-1))
    return points - here - jnp.clip(share, 0.0, 1.0)[:, None] * chord


def _nonzero(x: Array) -> Array:
    return jnp.where(x == 0.0, 1.0, x)
