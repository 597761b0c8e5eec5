"""Limits of a loop that JAX traces: searched for on the host, with derivatives at the limit.

At the stiffest wall a pair of roots is on the circle where the boundary turns or crosses B = 0, or
two roots are on it at once, at a corner. These are equations for the wall and the roots' angles,
which the implicit function theorem differentiates by all numbers of the loop. Under vmap the loops
are searched together, as ``limits_of`` searches; inside jit they are searched one by one, by a
callback.
"""

from collections.abc import Callable, Iterable
from functools import cache
from math import pi
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float64

from jaxstab.arrays import is_any_traced
from jaxstab.loop.many import resolved
from jaxstab.loop.region import TOLERANCE, Gains, WallLimits, WallRegion, wall_region
from jaxstab.model import LoopParameters, characteristic_polynomial
from jaxstab.point import closed_loop_poles
from jaxstab.region import RegionStatus, measures

_FOUND = 5  # numbers of one extreme wall
_REAL = 1e-6  # rad: a root this near to the real axis is real


_Parts = tuple[Array, Array, Array]  # p(z) as base, and what the two gains multiply


class _Extreme(NamedTuple):
    """A wall with the largest alpha or beta, and the angles of the roots on the circle there."""

    alpha: Array
    beta: Array
    first: Array
    second: Array  # NaN where the boundary turns, or crosses the axis: then the other gain is 0
    is_reachable: Array


def moving_limits(loop: LoopParameters) -> WallLimits:
    """Return the limits of a traced loop, differentiable once in its leaves; islands are left out.

    All are NaN where no wall is stable and where the region is UNRESOLVED; derivatives are NaN
    where more than two roots are on the circle.
    """
    leaves, structure = jax.tree.flatten(loop)
    found: Any = _search(structure)(*(jax.lax.stop_gradient(leaf) for leaf in leaves))
    parts = _parts(loop)
    stiffest, most_damped = (
        _moved(loop, parts, _Extreme(*found[axis, :_FOUND]), axis) for axis in range(2)
    )
    return WallLimits(
        *stiffest,
        most_damped.damping,
        most_damped.stiffness,
        found[0, _FOUND].astype(jnp.int8),
        found[0, _FOUND - 1] == 1.0,
    )


@cache
def _search(structure: Any) -> Callable[..., Array]:
    """Return the search for the extreme walls of loops of one structure, from their leaves."""

    def loop_of(values: Iterable[Any]) -> Any:
        return jax.tree.unflatten(structure, [float(value) for value in values])

    def search(*values: Any) -> Float64[np.ndarray, "2 found"]:
        return _extremes(wall_region(loop_of(values), TOLERANCE))

    @jax.custom_batching.custom_vmap
    def found(*leaves: Array) -> Array:
        shape = jax.ShapeDtypeStruct((2, _FOUND + 1), jnp.float64)
        traced: Array = jax.pure_callback(search, shape, *leaves, vmap_method="sequential")
        return traced

    @found.def_vmap
    def together(size: int, is_batched: list[bool], *leaves: Array) -> tuple[Array, bool]:
        if is_any_traced(*leaves):
            axes = [0 if batched else None for batched in is_batched]
            return jax.vmap(found.fun, axes)(*leaves), True
        rows = zip(*(np.broadcast_to(np.asarray(leaf), size) for leaf in leaves), strict=True)
        return jnp.asarray(_extremes_of([loop_of(row) for row in rows])), True

    return found


def _extremes_of(loops: list[Any]) -> Float64[np.ndarray, "loop 2 found"]:
    """Return the extreme walls of many loops, those that the program of a batch left open alone."""
    rows, is_open = np.ones((len(loops), 2, _FOUND + 1)), np.ones(len(loops), bool)
    for members, (extremes, _) in resolved(loops):
        rows[members, :, :2], rows[members, :, 2:4] = extremes.walls, extremes.angles
        rows[members, :, _FOUND], is_open[members] = RegionStatus.COMPLETE, False
    for number in np.flatnonzero(is_open):
        rows[number] = _extremes(wall_region(loops[number], TOLERANCE))
    return rows


def _extremes(region: WallRegion) -> Float64[np.ndarray, "2 found"]:
    """The two extreme walls of the reachable part, or of all, and the status of the region."""
    main = region.main
    of = region if main is None else main
    loop, rows = region.loop, []
    for point in measures.quadrant_extremes(of.region.coefficients, of.region.outline):
        angles = np.full(2, np.nan)
        if np.all(np.isfinite(point)):
            alpha, beta = point.tolist()
            poles = closed_loop_poles(alpha, beta, **loop.slice, **loop.filters)
            poles = poles[poles.imag >= 0.0]
            with np.errstate(divide="ignore"):
                order = np.argsort(np.abs(np.log(np.abs(poles))))
            is_corner = np.any(np.all(of.region.corners == point, axis=1))
            nearest = np.abs(np.angle(poles[order[: 1 + is_corner]]))
            angles[: len(nearest)] = nearest
        rows.append([*point, *angles, float(main is not None), float(region.status)])
    return np.array(rows)


def _moved(loop: LoopParameters, parts: _Parts, extreme: _Extreme, axis: int) -> Gains:
    """An extreme wall, with its derivatives by the numbers of the loop."""
    is_corner, is_on_axis = ~jnp.isnan(extreme.second), extreme[1 - axis] == 0.0
    start = jnp.stack([*extreme[:3], jnp.where(is_corner, extreme.second, 0.0)])

    def equations(unknown: Array, parts: _Parts) -> Array:
        base, *others = parts
        polynomial = base + unknown[0] * others[0] + unknown[1] * others[1]
        value, turn = _on_circle(polynomial, unknown[2])
        # The other gain and the angle change, and p stays 0: where the boundary turns.
        along, _ = _on_circle(others[1 - axis], unknown[2])
        turns = jnp.imag(jnp.conj(along) * turn)
        smooth = jnp.stack([jnp.where(is_on_axis, unknown[1 - axis], turns), unknown[3]])
        there, _ = _on_circle(polynomial, unknown[3])
        corner = _root_equations(there, unknown[3], start[3])
        first = _root_equations(value, unknown[2], start[2])
        return jnp.concatenate([first, jnp.where(is_corner, corner, smooth)])

    fixed = jax.lax.stop_gradient((start, parts))
    step = jnp.linalg.solve(jax.jacfwd(equations)(*fixed), equations(start, parts))
    wall = start - (step - jax.lax.stop_gradient(step))
    return Gains(loop.stiffness(wall[0]), loop.damping(wall[1]))


def _parts(loop: LoopParameters) -> _Parts:
    """The parts of p(z), from p(z) of three walls."""
    gains = jnp.array([0.0, 1.0, 0.0]), jnp.array([0.0, 0.0, 1.0])
    base, *others = characteristic_polynomial(*gains, **loop.slice, **loop.filters)
    return base, others[0] - base, others[1] - base


def _on_circle(polynomial: Array, angle: Array) -> tuple[Array, Array]:
    """A polynomial at exp(i angle), and its derivative by the angle, both turned back."""
    degree = len(polynomial) - 1
    powers = jnp.arange(degree, -1, -1) - 0.5 * degree
    terms = polynomial * jnp.exp(1j * powers * angle)
    return jnp.sum(terms), jnp.sum(1j * powers * terms)


def _root_equations(value: Array, angle: Array, start: Array) -> Array:
    """The residual, 0 where a root is on the circle; a real root keeps its angle."""
    is_real = (start < _REAL) | (start > pi - _REAL)
    end = jnp.round(start / pi) * pi
    # At a real root the value, turned back, is real or imaginary.
    real = jnp.stack([jnp.real(value) + jnp.imag(value), angle - end])
    return jnp.where(is_real, real, jnp.stack([jnp.real(value), jnp.imag(value)]))
