"""Limits, outlines and margins under JAX: searched for on the host, then differentiated.

At the stiffest wall a pair of roots is on the circle where the boundary turns or crosses B = 0, or
two roots are on it at once, at a corner. These are equations for the wall and the roots' angles,
which the implicit function theorem differentiates by all numbers of the loop. They are those of
``circle_equations``, in which the delay is a real number, so that one program serves loops of all
degrees. Vertices of an outline have the same equations: one at a corner moves with it, any other
one across the boundary, at a right angle.

Under vmap the loops are searched together, as ``limits_of`` searches. Inside jit the program of a
batch (``region.batch``) becomes part of the caller's, if there are enough loops to pay for its
compilation and JAX traces neither delay nor filters, which decide its shapes. All other loops are
searched there one by one, by a callback.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, lru_cache, partial
from math import pi, prod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float64

from jaxstab.arrays import is_any_traced, solved
from jaxstab.batches import alike
from jaxstab.loop.crossings import grown
from jaxstab.loop.many import (
    Form,
    ManyRegions,
    Stack,
    column_of,
    common_form,
    empty_outlines,
    in_shape,
    outline_of,
    resolved,
    singles,
    stacked,
    triples_of_masses,
    varied_loops,
)
from jaxstab.loop.region import TOLERANCE, Limits, Region, region_of_loop
from jaxstab.model import LoopParameters
from jaxstab.model.filters import given_filters
from jaxstab.model.loop import MECHANICS
from jaxstab.point import closed_loop_poles
from jaxstab.region import RegionStatus, measures
from jaxstab.region.batch import Triples, components, cross
from jaxstab.region.closed_form import Responses, circle_equations
from jaxstab.region.measures import vertex_roots

_Numbers = tuple[Any, Responses]  # of the plant: gamma, delta and the delay

_REAL = 2e-6  # rad: a root this near to the real axis is real; scans of batches begin at 1e-6
_RESOLVED = np.array([RegionStatus.COMPLETE, 1.0, 0.0])  # status, is_reachable, is_single


class _Extreme(NamedTuple):
    """A wall with the largest alpha or beta, and the angles of the roots on the circle there."""

    alpha: Array
    beta: Array
    angle: Array
    other_angle: Array  # NaN where the boundary turns, or on the axis: the other gain is 0 there
    status: Array
    is_reachable: Array
    is_single: Array


def moved(
    many: Any, fields: dict[str, Any], shape: tuple[int, ...], *, outlines: bool
) -> ManyRegions:
    """The limits of loops, some of which JAX traces, and, with ``outlines``, outlines and areas."""
    are_columns = prod(shape) > 1 and fields.keys() <= {*MECHANICS}
    if are_columns and isinstance(many, LoopParameters) and many.device is None:
        columns = {name: column_of(x, shape) for name, x in fields.items()}
        answer = _moved_columns(many, columns, outlines=outlines)
    else:
        answer = _moved_together(varied_loops(many, fields, shape), outlines=outlines)
    return in_shape(answer, shape)


def _moved_together(given: list[Any], *, outlines: bool) -> ManyRegions:
    """Return ``moving_regions`` of each of many loops, some of which JAX traces.

    Loops of one structure are stacked: their filters are of the same kinds, orders and windows.
    """
    loops = list(map(_of_leaves, given))
    groups = alike(map(jax.tree.structure, loops))
    answers = []
    for members in groups:
        form = common_form([given[index] for index in members])
        own = partial(moving_regions, form=form, outlines=outlines)
        if len(members) == 1:  # under vmap of the caller it meets the others of its kind
            answers.append(jax.tree.map(lambda column: column[None], own(loops[members[0]])))
        else:
            stack = jax.tree.map(
                lambda *leaves: jnp.stack(leaves), *map(loops.__getitem__, members)
            )
            answers.append(jax.vmap(own)(stack))
    order = np.argsort(np.concatenate(groups))
    moved: ManyRegions = jax.tree.map(lambda *columns: jnp.concatenate(columns)[order], *answers)
    return moved


def _of_leaves(loop: Any) -> Any:
    """Return a loop all of whose numbers are leaves, as those of its kind have them."""
    return loop.tree_unflatten((None, loop.device), loop.tree_flatten()[0])


def _moved_columns(given: Any, columns: dict[str, Array], *, outlines: bool) -> ManyRegions:
    """Return the same of one loop of which some numbers are columns: no loop is a piece of code."""
    form = common_form([given])

    def moved(row: dict[str, Array]) -> ManyRegions:
        return moving_regions(_of_leaves(replace(given, **row)), form=form, outlines=outlines)

    answers: ManyRegions = jax.vmap(moved)({k: jnp.asarray(x) for k, x in columns.items()})
    return answers


def moving_regions(loop: LoopParameters, form: Form | None, *, outlines: bool) -> ManyRegions:
    """Return the limits of a traced loop and, with ``outlines``, its outline and area, else None.

    They are differentiable once in its leaves; islands are left out. All are NaN where no wall is
    stable and where the region is UNRESOLVED; derivatives are NaN where more than two roots are on
    the circle.
    """
    leaves, structure = jax.tree.flatten(loop)
    search = _search(structure, form, outlines=outlines)
    extremes, outline = search(*(jax.lax.stop_gradient(leaf) for leaf in leaves))
    vertices, area = _moved_outline(loop, outline) if outlines else (None, None)
    return ManyRegions(vertices, area, _moved(loop, _Extreme(*extremes.T)))


@cache
def _search_alone(structure: Any, *, outlines: bool) -> Callable[..., Any]:
    """Return the search for one loop by its leaves: the same function, which JAX compiles once."""

    def search(*leaves: Any) -> Any:
        (loop,) = _loops_of(structure, [leaves])
        return _alone(loop, outlines=outlines)

    return search


def _loops_of(structure: Any, rows: Iterable[Iterable[Any]]) -> list[Any]:
    return [jax.tree.unflatten(structure, [float(value) for value in row]) for row in rows]


@lru_cache(maxsize=64)
def _search(
    structure: Any, form: Form | None, *, outlines: bool
) -> Callable[..., tuple[Array, Any]]:
    """Return the search for extreme walls and outlines of loops of one structure, by leaves."""
    fewest = 512  # loops inside of jit: to compile takes as long as some thousands one by one
    search = _search_alone(structure, outlines=outlines)

    @jax.custom_batching.custom_vmap
    def searched(*leaves: Any) -> Any:
        empty = _empty(outlines=outlines)
        shapes = jax.tree.map(lambda column: jax.ShapeDtypeStruct(column.shape, float), empty)
        return jax.pure_callback(search, shapes, *leaves, vmap_method="sequential")

    @searched.def_vmap
    def together(size: int, is_batched: list[bool], *leaves: Any) -> tuple[Any, Any]:
        if is_any_traced(*leaves):
            triples = None
            if form is not None and size >= fewest:
                columns = [jnp.broadcast_to(leaf, size) for leaf in leaves]
                many: Any = jax.tree.unflatten(structure, columns)
                triples = triples_of_masses(many.gamma, many.delta, form)
            if triples is None:
                axes = [0 if batched else None for batched in is_batched]
                answers = jax.vmap(searched.fun, axes)(*leaves)
            else:
                answers = _in_one_program(triples, outlines=outlines)
        else:
            stacks = _stacks_of(structure, size, is_batched, leaves)
            answers = jax.tree.map(jnp.asarray, _all(stacks, size, outlines=outlines))
        return answers, jax.tree.map(lambda _: True, answers)

    return searched


def _in_one_program(triples: Triples, *, outlines: bool) -> Any:
    """Search for many loops by the program of a batch alone; what it leaves open is UNRESOLVED."""
    extremes, outline = components(triples, outlines=outlines)
    is_open = (extremes.failures != 0)[:, None, None]
    walls = jnp.concatenate([extremes.walls, extremes.angles], axis=-1)
    flags = jnp.where(is_open, jnp.array([RegionStatus.UNRESOLVED, 0.0, 0.0]), _RESOLVED)
    flags = jnp.broadcast_to(flags, (*walls.shape[:2], len(_RESOLVED)))
    rows = jnp.concatenate([jnp.where(is_open, jnp.nan, walls), flags], axis=-1)
    return rows, jax.tree.map(
        lambda x: jnp.where(is_open.reshape(-1, *[1] * (x.ndim - 1)), jnp.nan, x),
        outline and tuple(outline),
    )


def _empty(*shape: int, outlines: bool) -> tuple[Float64[np.ndarray, "*loop 2 field"], Any]:
    return np.ones((*shape, 2, len(_Extreme._fields))), empty_outlines(*shape) if outlines else None


def _stacks_of(structure: Any, size: int, is_batched: list[bool], leaves: Any) -> list[Stack]:
    """Return loops of one structure in one stack, unless their filters differ."""
    values = [np.asarray(x) if y else float(x) for x, y in zip(leaves, is_batched, strict=True)]
    many: Any = jax.tree.unflatten(structure, values)
    of_filters = jax.tree.leaves((many.velocity, many.position))
    if of_filters and any(map(np.ndim, [*of_filters, many.sample_time])):
        return stacked(_loops_of(structure, zip(*np.broadcast_arrays(*values), strict=True)))
    return [Stack(np.arange(size), many)]


def _all(stacks: list[Stack], size: int, *, outlines: bool) -> Any:
    """Search for many loops: a batch, and one by one those that it left open."""
    answers = rows, _ = _empty(size, outlines=outlines)
    for members, _, (extremes, own) in resolved(stacks, outlines=outlines):
        shape = (*extremes.walls.shape[:2], len(_RESOLVED))
        row = extremes.walls, extremes.angles, np.broadcast_to(_RESOLVED, shape)
        _write(answers, members, (np.concatenate(row, axis=-1), own))
    for index, loop in singles(stacks, rows[:, 0, -1] == 1.0):
        _write(answers, index, _alone(loop, outlines=outlines))
    return answers


def _write(answers: Any, members: Any, own: Any) -> None:
    for column, values in zip(jax.tree.leaves(answers), jax.tree.leaves(own), strict=True):
        column[members] = values


def _alone(loop: Any, *, outlines: bool) -> Any:
    region = region_of_loop(loop, TOLERANCE)
    return _extremes(region), outline_of(region) if outlines else None


def _extremes(region: Region) -> Float64[np.ndarray, "2 field"]:
    """The two extreme walls of the reachable part, or of all, and the status of the region."""
    main = region.main
    of = region if main is None else main
    curve, outline, rows = of.region.curve, of.region.outline, []
    loop: Any = region.loop
    for point, vertex in measures.quadrant_extremes(curve, outline):
        angles = np.full(2, np.nan)
        if np.any(np.isnan(point)):
            pass
        elif vertex is None:
            poles = closed_loop_poles(*point.tolist(), **loop.slice | loop.filters)
            angles[0] = abs(np.angle(poles[np.argmin(abs(abs(poles) - 1.0))]))
        else:
            roots, is_corner = vertex_roots(curve, outline)
            angles = np.where([True, is_corner[vertex]], roots[vertex], np.nan)
        rows.append([*point, *angles, region.status, main is not None, True])
    return np.array(rows, float)


@jax.jit
def _moved(loop: LoopParameters, extremes: _Extreme) -> Limits[Any]:
    """Return both extreme walls, with their derivatives by the numbers of the loop."""
    numbers = _numbers(loop)

    def moved(extreme: _Extreme, axis: Array) -> Array:
        is_corner = ~jnp.isnan(extreme.other_angle)
        start = jnp.stack([*extreme[:3], jnp.where(is_corner, extreme.other_angle, 0.0)])
        residual = partial(_equations, start, is_corner, axis)
        wall = start[:2] + _change(grown(residual, start, numbers))[:2]
        return jnp.where(~is_corner & (start[:2] == 0.0), 0.0, wall)  # on an axis it stays there

    (stiffest, at_damping), (at_stiffness, damping) = jax.vmap(moved)(extremes, jnp.arange(2))
    return Limits(
        loop.stiffness(stiffest),
        loop.damping(at_damping),
        loop.damping(damping),
        loop.stiffness(at_stiffness),
        extremes.status[0].astype(jnp.int8),
        extremes.is_reachable[0] == 1.0,
        extremes.is_single[0] == 1.0,
    )


@jax.jit
def _moved_outline(loop: LoopParameters, outline: tuple[Array, Array, Array]) -> Any:
    """Return an outline in SI units and its area, with their derivatives.

    The area grows by what its edges pass over: curves by Gauss's rule, at constant angles.
    """
    nodes_of_rule, weights = np.polynomial.legendre.leggauss(4)
    vertices, roots, area = outline
    numbers = _numbers(loop)
    fixed = jax.lax.stop_gradient(numbers)

    def move(wall: Array, angles: Array) -> Array:
        start = jnp.concatenate([wall, angles])
        first, second = jax.jacfwd(partial(_on_circle, start))(start, fixed)
        along = jnp.cross(first[0, :3], first[1, :3])
        across = jnp.eye(4)[2:].at[0].set(jnp.append(along, 0.0).at[2].set(0.0))
        is_corner = (angles[0] != angles[1]) | (jnp.sin(angles[0]) < _REAL)
        here, other = _on_circle(start, start, numbers)
        slopes = jnp.concatenate([first, jnp.where(is_corner, second, across)])
        values = jnp.concatenate([here, jnp.where(is_corner, other, 0.0)])
        return -_change(solved(slopes, values[:, None]))[:2, 0]

    moves = jax.vmap(move)(vertices, roots)
    begin, end = roots[:-1, 1], roots[1:, 0]
    is_curve = (begin != end) & jnp.any(roots[1:] != roots[:-1], axis=1)
    middle, half = jnp.where(is_curve, 0.5 * jnp.stack([begin + end, end - begin]), 1.0)
    nodes = (middle + half * nodes_of_rule[:, None]).ravel()
    walls, slopes = jax.jvp(partial(_curve, fixed), (nodes,), (jnp.ones_like(nodes),))
    passed = cross(_curve(numbers, nodes) - walls, slopes).reshape(len(nodes_of_rule), -1)
    straight = 0.5 * cross((moves[1:] + moves[:-1]).T, jnp.diff(vertices, axis=0).T)
    grown = jnp.sum(jnp.where(is_curve, half * (weights @ passed), straight))
    units = jnp.stack([loop.stiffness(1.0), loop.damping(1.0)])
    return (vertices + moves) * units, (area + _change(grown)) * jnp.prod(units)


def _change(value: Array) -> Array:
    """Return 0 with the derivative of a value."""
    return value - jax.lax.stop_gradient(value)


def _numbers(loop: LoopParameters) -> _Numbers:
    plant = loop.gamma, loop.delta, loop.delay / loop.sample_time
    return plant, Responses.from_filters(given_filters(**loop.filters))


def _curve(numbers: _Numbers, theta: Array) -> Array:
    """Return the curve (2, angle)."""

    def at_angle(angle: Array) -> Array:
        values, none = partial(_values, numbers, angle=angle), jnp.zeros(2)
        (stiffness, damping), base = jax.jacfwd(values)(none).T, values(none)
        return jnp.stack([cross(damping, base), cross(base, stiffness)]) / cross(stiffness, damping)

    return jax.vmap(at_angle, out_axes=1)(theta)


def _on_circle(start: Array, unknown: Array, numbers: _Numbers) -> Array:
    """Return p at both roots (root, 2), of alpha, beta and their angles; it is 0 there.

    At a real root it is the distance of its angle from where it stays; of a second root there the
    other number is the derivative of p.
    """
    wall, angles = unknown[:2], unknown[2:]
    real, imaginary = jax.vmap(partial(_values, numbers, wall))(angles).T
    ends = jnp.round(start[2:] / pi) * pi
    is_real = abs(start[2:] - ends) < _REAL
    is_double = jnp.all(is_real) & (ends[0] == ends[1])
    real = real.at[1].set(jnp.where(is_double, imaginary[1], real[1]))
    return jnp.stack([real, jnp.where(is_real, angles - ends, imaginary)], axis=1)


def _values(numbers: _Numbers, wall: Array, angle: Array) -> Array:
    plant, responses = numbers
    return jnp.stack(circle_equations(plant, wall[0], wall[1], angle, responses))


def _equations(
    start: Array, is_corner: Array, axis: Array, unknown: Array, numbers: _Numbers
) -> Array:
    """Functions of alpha, beta and the angles of the roots that are 0 at an extreme wall."""
    wall, angles = unknown[:2], unknown[2:]
    other = (jnp.arange(2) != axis).astype(float)
    first, second = _on_circle(start, unknown, numbers)
    # Where the boundary turns, p stays 0 to first order as the other gain and the angle change.
    value, turn = jax.jvp(partial(_values, numbers, wall), (angles[0],), (jnp.ones(()),))
    turning = cross(_values(numbers, wall + other, angles[0]) - value, turn)
    is_on_axis = start[:2] @ other == 0.0
    smooth = jnp.stack([jnp.where(is_on_axis, wall @ other, turning), angles[1]])
    return jnp.concatenate([first, jnp.where(is_corner, second, smooth)])
