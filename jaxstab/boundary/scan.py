"""The angles at which a scan looks for arcs of the boundary of the stable set."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float64

from jaxstab.boundary.arcs import Arcs, minus_margin, other_roots
from jaxstab.boundary.curve import SliceCoefficients, curve_and_lift

_FIRST, _PI_MINUS_LAST = 1e-7, 1e-7
_CLOSEST = 1e-9
_OFFSETS = 20  # to each side of an angle
_CENTERS = 6  # for each slot
_NEAR_CIRCLE = 0.02
_SAME = 1e-7

Angles = Float64[np.ndarray, " _"]  # of any length


def scan_angles(length: int, fineness: int) -> Angles:
    """Return the angles of a scan: even steps, a part of a turn of z^m, and finer to both ends.

    ``length`` is that of the polynomials, as for ``find_arcs``.
    """
    count = fineness * (24 + 8 * length)
    even = (np.arange(count) + 0.5) * (np.pi / count)
    start, end = (
        np.geomspace(first, even[0], 12 * fineness, endpoint=False)
        for first in (_FIRST, _PI_MINUS_LAST)
    )
    return np.concatenate([start, even, np.pi - end[::-1]])


def padded_angles(angles: Angles, slots: int) -> Angles:
    """Return the angles in an array as long as that of ``closer_angles``, for one compilation."""
    return np.concatenate([np.full(_CENTERS * slots * 2 * _OFFSETS, angles[0]), angles])


def closer_angles(c: SliceCoefficients, arcs: Arcs, angles: Angles, *, length: int) -> Angles:
    """Return the angles with more of them around those where something may hide between two.

    What was missed begins or ends where the curve crosses a line, next to a corner that was found,
    or at the angle of another pair of roots that reaches the circle at such a corner.
    """
    exists = np.tile(np.asarray(arcs.exists), 2)
    ends = np.concatenate([np.asarray(arcs.begin), np.asarray(arcs.end)])
    others = np.asarray(_others(c, jnp.asarray(ends), length=length))
    corners, partners = ends[exists], _angles_near_circle(others[:, exists & _is_open(ends)])
    known = np.concatenate([corners, partners, _line_crossings(c, angles)])
    centers = np.full(_CENTERS * len(arcs.exists), angles[0])
    centers[: len(known)] = known[: len(centers)]
    offsets = np.geomspace(_CLOSEST, np.max(np.diff(angles)), _OFFSETS)
    around = centers[:, None] + np.concatenate([-offsets, offsets])
    return np.sort(np.concatenate([angles, np.clip(around.ravel(), angles[0], angles[-1])]))


def same_arcs(one: Arcs, other: Arcs) -> bool:
    """Return whether two scans found the same arcs."""
    first, second = (np.stack([arcs.exists, arcs.begin, arcs.end]) for arcs in (one, other))
    return bool(np.allclose(first, second, rtol=_SAME, atol=_SAME))


_others = jax.jit(other_roots, static_argnames="length")


def _is_open(angles: Angles) -> Bool[np.ndarray, " _"]:
    inner: Bool[np.ndarray, " _"] = (angles > 0.0) & (angles < np.pi)
    return inner


def _angles_near_circle(polynomials: Float64[np.ndarray, "coefficient _"]) -> Angles:
    """Return the angles in [0, pi] of the roots close to the circle."""
    roots = np.concatenate([np.empty(0), *(np.roots(p) for p in polynomials.T)])
    near = roots[(np.abs(np.abs(roots) - 1.0) < _NEAR_CIRCLE) & (roots.imag >= 0.0)]
    angles: Angles = np.angle(near)
    return angles


def _line_crossings(c: SliceCoefficients, angles: Angles) -> Angles:
    """Return the angles, to a step of the scan, at which the curve crosses one of the lines."""
    changes = np.diff(np.sign(np.asarray(_line_margins(c, jnp.asarray(angles)))), axis=1) != 0.0
    steps = np.flatnonzero(np.any(changes, axis=0))
    middles: Angles = 0.5 * (angles[steps] + angles[steps + 1])
    return middles


@jax.jit
def _line_margins(c: SliceCoefficients, theta: Array) -> Array:
    alpha, beta, lift = curve_and_lift(c, theta)
    return jnp.stack([lift, minus_margin(c, alpha, beta)])
