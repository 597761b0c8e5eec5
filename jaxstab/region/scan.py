"""The angles at which a scan looks for arcs of the boundary of the stable set."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float64

from jaxstab.region.crossings import Angles, in_batches
from jaxstab.region.curve import SliceCoefficients
from jaxstab.region.pieces import Arcs, other_roots, others_inside

_FIRST, _PI_MINUS_LAST = 1e-7, 1e-7
_CLOSEST = 1e-11
_OFFSETS = 24  # to each side of a place
_PLACES = 6  # for each slot
_NEAR_CIRCLE = 1e-2
_SAME = 1e-10


@cache
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
    angles = np.concatenate([start, even, np.pi - end[::-1]])
    angles.flags.writeable = False
    return angles


def most_places(slots: int) -> int:
    """Return around how many places ``closer_angles`` looks."""
    return _PLACES * slots


def closer_angles(angles: Angles, places: Angles, slots: int) -> Angles:
    """Return the angles with more of them around some places; their number depends on the slots."""
    centers = np.full(most_places(slots), angles[0])
    centers[: len(places)] = places[: len(centers)]
    offsets = np.geomspace(_CLOSEST, np.max(np.diff(angles)), _OFFSETS)
    around = centers[:, None] + np.concatenate([-offsets, offsets])
    return np.sort(np.concatenate([angles, np.clip(around.ravel(), angles[0], angles[-1])]))


def hiding_places(
    c: SliceCoefficients, arcs: Arcs, known: Angles, outside: float, *, length: int
) -> Angles:
    """Return the angles around which something may hide between two of the scan, with those known.

    They are the corners found and the angles of the roots that are on the circle there, or close.
    """
    ends = np.concatenate([np.asarray(arcs.begin), np.asarray(arcs.end)])
    corners = np.tile(np.asarray(arcs.exists), 2) & (ends > 0.0) & (ends < np.pi)
    others = np.asarray(_others(c, jnp.asarray(ends), length=length))[:, corners]
    partners = [_angles_near_circle(polynomial) for polynomial in others.T]
    found = np.concatenate([known, ends[corners], *partners])
    return nearly_stable(c, found, outside, length=length)


def nearly_stable(c: SliceCoefficients, places: Angles, outside: float, *, length: int) -> Angles:
    """Return those angles, in order, at which no other root is farther than that outside."""
    places = np.sort(places)
    places = places[np.diff(places, prepend=-1.0) > _CLOSEST]
    inside = partial(_others_inside, c, within=1.0 + outside, length=length)
    chosen: Angles = places[in_batches(inside, places).astype(bool)]
    return chosen


def are_among(places: Angles, known: Angles) -> bool:
    """Return whether each of these places is one of those known."""
    away = np.abs(places[:, None] - known)
    return bool(np.all(np.min(away, axis=1, initial=np.inf) < _SAME))


_others = jax.jit(other_roots, static_argnames="length")
_others_inside = jax.jit(others_inside, static_argnames="length")


def _angles_near_circle(polynomial: Float64[np.ndarray, " coefficient"]) -> Angles:
    """Return the angles between 0 and pi of the roots close to the circle."""
    roots = np.roots(polynomial)
    near = roots[(np.abs(np.abs(roots) - 1.0) < _NEAR_CIRCLE) & (roots.imag > 0.0)]
    angles: Angles = np.angle(near)
    return angles
