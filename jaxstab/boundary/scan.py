"""The angles at which a scan looks for arcs of the boundary of the stable set."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float64

from jaxstab.boundary.arcs import Arcs, minus_margin, other_roots, others_inside
from jaxstab.boundary.curve import SliceCoefficients, curve_and_lift

_FIRST, _PI_MINUS_LAST = 1e-7, 1e-7
_CLOSEST = 1e-11
_OFFSETS = 24  # to each side of a place
_PLACES = 6  # for each slot
_NEAR_CIRCLE = 1e-2
_BATCH = 16
_SAME = 1e-7
_HALVINGS = 40

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
    c: SliceCoefficients, arcs: Arcs, angles: Angles, known: Angles, outside: float, *, length: int
) -> Angles:
    """Return the angles around which something may hide between two of the scan, with those known.

    What was missed begins or ends where the curve crosses a line, or at the angle of one of the
    roots that are on the circle at a corner next to it; and there no other root is farther outside
    of the circle than ``outside``.
    """
    ends = np.concatenate([np.asarray(arcs.begin), np.asarray(arcs.end)])
    corners = np.tile(np.asarray(arcs.exists), 2) & (ends > 0.0) & (ends < np.pi)
    others = np.asarray(_others(c, jnp.asarray(ends), length=length))[:, corners]
    partners = [_angles_near_circle(polynomial) for polynomial in others.T]
    found = np.concatenate([known, ends[corners], *partners, _line_crossings(c, angles)])
    places = np.sort(found)
    places = places[np.diff(places, prepend=-1.0) > _CLOSEST]
    nearly_stable = partial(_others_inside, c, within=1.0 + outside, length=length)
    chosen: Angles = places[_in_batches(nearly_stable, places)]
    return chosen


def same_arcs(one: Arcs, other: Arcs) -> bool:
    """Return whether two scans found the same arcs."""
    first, second = (np.stack([arcs.exists, arcs.begin, arcs.end]) for arcs in (one, other))
    return bool(np.allclose(first, second, rtol=_SAME, atol=_SAME))


_others = jax.jit(other_roots, static_argnames="length")
_others_inside = jax.jit(others_inside, static_argnames="length")


def _angles_near_circle(polynomial: Float64[np.ndarray, " coefficient"]) -> Angles:
    """Return the angles in [0, pi] of the roots close to the circle."""
    roots = np.roots(polynomial)
    near = roots[(np.abs(np.abs(roots) - 1.0) < _NEAR_CIRCLE) & (roots.imag >= 0.0)]
    angles: Angles = np.angle(near)
    return angles


def _line_crossings(c: SliceCoefficients, angles: Angles) -> Angles:
    """Return the angles at which the curve crosses one of the lines."""
    changes = np.diff(np.sign(np.asarray(_line_margins(c, jnp.asarray(angles)))), axis=1) != 0.0
    line, step = np.nonzero(changes)
    return _in_batches(partial(_crossing, c), angles[step], angles[step + 1], line)


def _in_batches(compiled: Callable[..., Array], *columns: np.ndarray) -> np.ndarray:
    """Apply a function to columns of any length in batches of one size, compiled once."""
    rest = max(-len(columns[0]) % _BATCH, _BATCH - len(columns[0]))
    batches = np.stack([np.pad(one, (0, rest)) for one in columns]).reshape(
        len(columns), -1, _BATCH
    )
    answers = [np.asarray(compiled(*batch)) for batch in batches.swapaxes(0, 1)]
    return np.concatenate(answers)[: len(columns[0])]


@jax.jit
def _crossing(c: SliceCoefficients, lower: Array, upper: Array, line: Array) -> Array:
    """Bisect between angles on unlike sides of a line."""

    def side(theta: Array) -> Array:
        plus, minus = _line_margins(c, theta) > 0.0
        return jnp.where(line == 0, plus, minus)

    def halved(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = 0.5 * (ends[0] + ends[1])
        below = side(middle) == before
        return jnp.where(below, middle, ends[0]), jnp.where(below, ends[1], middle)

    before = side(lower)
    crossing: Array = lax.fori_loop(0, _HALVINGS, halved, (lower, upper))[0]
    return crossing


@jax.jit
def _line_margins(c: SliceCoefficients, theta: Array) -> Array:
    alpha, beta, lift = curve_and_lift(c, theta)
    return jnp.stack([lift, minus_margin(c, alpha, beta)])
