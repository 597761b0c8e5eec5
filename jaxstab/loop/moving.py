"""Limits of loops that JAX traces: searched for on the host, with derivatives at the limit.

At the stiffest wall a pair of roots is on the circle where the boundary turns or crosses B = 0, or
two roots are on it at once, at a corner. These are equations for the wall and the roots' angles,
which the implicit function theorem differentiates by all numbers of the loop. They are those of
``circle_equations``, in which the delay is a real number, so that one program serves loops of all
degrees. Under vmap the loops are searched together, as ``limits_of`` searches; inside jit they are
searched one by one, by a callback.
"""

from collections.abc import Callable, Iterable
from functools import cache, partial
from math import pi
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float64

from jaxstab.arrays import is_any_traced
from jaxstab.batches import alike
from jaxstab.loop.many import ManyLimits, resolved
from jaxstab.loop.region import TOLERANCE, WallRegion, wall_region
from jaxstab.model import LoopParameters
from jaxstab.model.filters import given_filters
from jaxstab.point import closed_loop_poles
from jaxstab.proofs.filters import Responses
from jaxstab.proofs.plant import circle_equations, quick_slice
from jaxstab.region import RegionStatus, measures

_REAL = 1e-6  # rad: a root this near to the real axis is real


class _Extreme(NamedTuple):
    """A wall with the largest alpha or beta, and the angles of the roots on the circle there."""

    alpha: Array
    beta: Array
    angle: Array
    other_angle: (
        Array  # NaN where the boundary turns, or crosses the axis: then the other gain is 0
    )
    status: Array
    is_reachable: Array
    is_single: Array


_FIELDS = len(_Extreme._fields)


def moving_limits_of(loops: list[Any]) -> ManyLimits:
    """Return the limits of many loops, some of which JAX traces, as ``moving_limits`` does.

    Loops of one structure are stacked: their filters are of the same kinds, orders and windows.
    """
    loops = [loop.tree_unflatten((None, loop.device), loop.tree_flatten()[0]) for loop in loops]
    groups = alike(map(jax.tree.structure, loops))
    stacks = (
        jax.tree.map(lambda *leaves: jnp.stack(leaves), *(loops[index] for index in members))
        for members in groups
    )
    answers = [jax.vmap(moving_limits)(loops) for loops in stacks]
    order = np.argsort(np.concatenate(groups))
    columns = (jnp.concatenate(column)[order] for column in zip(*answers, strict=True))
    return ManyLimits(*columns)


def moving_limits(loop: LoopParameters) -> ManyLimits:
    """Return the limits of a traced loop, differentiable once in its leaves; islands are left out.

    All are NaN where no wall is stable and where the region is UNRESOLVED; derivatives are NaN
    where more than two roots are on the circle.
    """
    leaves, structure = jax.tree.flatten(loop)
    extremes: Any = _search(structure)(*(jax.lax.stop_gradient(leaf) for leaf in leaves))
    limits: ManyLimits = _moved(loop, _Extreme(*extremes.T))
    return limits


@cache
def _search(structure: Any) -> Callable[..., Array]:
    """Return the search for the extreme walls of loops of one structure, from their leaves."""

    def loop_of(values: Iterable[Any]) -> Any:
        return jax.tree.unflatten(structure, [float(value) for value in values])

    def search(*values: Any) -> Float64[np.ndarray, "2 field"]:
        return _extremes(wall_region(loop_of(values), TOLERANCE))

    @jax.custom_batching.custom_vmap
    def extremes(*leaves: Any) -> Array:
        shape = jax.ShapeDtypeStruct((2, _FIELDS), jnp.float64)
        traced: Array = jax.pure_callback(search, shape, *leaves, vmap_method="sequential")
        return traced

    @extremes.def_vmap
    def together(size: int, is_batched: list[bool], *leaves: Any) -> tuple[Array, bool]:
        if is_any_traced(*leaves):
            axes = [0 if batched else None for batched in is_batched]
            return jax.vmap(extremes.fun, axes)(*leaves), True
        rows = zip(*(np.broadcast_to(np.asarray(leaf), size) for leaf in leaves), strict=True)
        return jnp.asarray(_extremes_of([loop_of(row) for row in rows])), True

    return extremes


def _extremes_of(loops: list[Any]) -> Float64[np.ndarray, "loop 2 field"]:
    """Return the extreme walls of many loops: a batch, and one by one those that it left open."""
    rows = np.ones((len(loops), 2, _FIELDS))
    for members, (extremes, _) in resolved(loops):
        rows[members, :, :2], rows[members, :, 2:4] = extremes.walls, extremes.angles
        rows[members, :, 4:] = RegionStatus.COMPLETE, True, False
    for row in np.flatnonzero(rows[:, 0, -1]):
        rows[row] = _extremes(wall_region(loops[row], TOLERANCE))
    return rows


def _extremes(region: WallRegion) -> Float64[np.ndarray, "2 field"]:
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
        rows.append([*point, *angles, region.status, main is not None, True])
    return np.array(rows, float)


@jax.jit
def _moved(loop: LoopParameters, extremes: _Extreme) -> ManyLimits:
    """Return both extreme walls, with their derivatives by the numbers of the loop."""
    plant = loop.gamma, loop.delta, loop.delay / loop.sample_time
    numbers = plant, Responses.from_filters(given_filters(**loop.filters))
    fixed = jax.lax.stop_gradient(numbers)

    def moved(extreme: _Extreme, axis: Array) -> Array:
        is_corner = ~jnp.isnan(extreme.other_angle)
        start = jnp.stack([*extreme[:3], jnp.where(is_corner, extreme.other_angle, 0.0)])
        residual = partial(_equations, start, is_corner, axis)
        step = jnp.linalg.solve(jax.jacfwd(residual)(start, fixed), residual(start, numbers))
        wall = start[:2] - (step - jax.lax.stop_gradient(step))[:2]
        return jnp.where(~is_corner & (start[:2] == 0.0), 0.0, wall)  # on an axis it stays there

    (stiffest, at_damping), (at_stiffness, damping) = jax.vmap(moved)(extremes, jnp.arange(2))
    return ManyLimits(
        loop.stiffness(stiffest),
        loop.damping(at_damping),
        loop.damping(damping),
        loop.stiffness(at_stiffness),
        extremes.status[0].astype(jnp.int8),
        extremes.is_reachable[0] == 1.0,
        extremes.is_single[0] == 1.0,
    )


def _equations(
    start: Array, is_corner: Array, axis: Array, unknown: Array, numbers: tuple[Any, Responses]
) -> Array:
    """Return what is 0 at an extreme wall, of alpha, beta and the angles of its roots."""
    plant, responses = numbers
    c, wall, angles = quick_slice(*plant), unknown[:2], unknown[2:]
    other = (jnp.arange(2) != axis).astype(float)

    def with_slopes(wall: Array, angle: Array) -> tuple[Array, Array]:
        def values(angle: Array) -> Array:
            return jnp.stack(circle_equations(c, wall[0], wall[1], angle, responses))

        both: tuple[Array, Array] = jax.jvp(values, (angle,), (jnp.ones(()),))
        return both

    walls, at = jnp.stack([wall, wall, wall + other]), angles[jnp.array([0, 1, 0])]
    values, turns = jax.vmap(with_slopes)(walls, at)
    # At a real root the second equation is that its angle stays.
    ends = jnp.round(start[2:] / pi) * pi
    is_real = abs(start[2:] - ends) < _REAL
    roots = values[:2].at[:, 1].set(jnp.where(is_real, angles - ends, values[:2, 1]))
    # Where the boundary turns, p stays 0 to first order as the other gain and the angle change.
    rises = values[2] - values[0]
    turning = rises[0] * turns[0, 1] - rises[1] * turns[0, 0]
    is_on_axis = start[:2] @ other == 0.0
    smooth = jnp.stack([jnp.where(is_on_axis, wall @ other, turning), angles[1]])
    return jnp.concatenate([roots[0], jnp.where(is_corner, roots[1], smooth)])
