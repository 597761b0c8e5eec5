"""The boundary in any plane of two quantities, to the resolution of a grid.

1. At each node of a grid over the window, the roots of p(z) outside of the unit circle are counted
   by the recursion of Schur and Cohn (``point.fields``). The signs of p(1) and p(-1) tell how many
   of them, modulo 2, are real and beyond 1 or -1; the others are pairs. So there are three counts,
   and each of them changes where one kind of root crosses the circle: a pair, or a real root at 1
   or at -1.
2. The contour lines of a count pass between nodes that differ in it. Their vertices lie on edges of
   the grid, and in a few halvings the change of count is bracketed on each edge.
3. On its edge each vertex is solved for, with the angle of its root, by optimistix: one program for
   all vertices of all traces and for every plane.

What lies between two nodes without a change of count is not seen: nothing is said to be complete. A
vertex that Newton's method does not reach stays in the middle of its bracket, and its status says
so. Counts are taken on a circle that is a little larger than the unit circle, so that nodes exactly
on a boundary, as those of a hand without stiffness at alpha = 0, have one, too.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from math import ceil, inf, pi, prod, sqrt
from typing import Any, NamedTuple, overload

import numpy as np
from contourpy import contour_generator
from jaxtyping import Bool, Complex128, Float64, Int8, Int64

from jaxstab.arrays import Array, Numbers, is_traced, load_jax, namespace
from jaxstab.batches import compiler_options, lists, own_settings
from jaxstab.conventions import AXES, Status
from jaxstab.model import (
    Filter,
    LoopParameters,
    Velocity,
    by_name,
    characteristic_polynomial,
)
from jaxstab.model.filters import Filters, as_keywords, known_filters
from jaxstab.numbers import checked, checked_number, has_shape, require_x64
from jaxstab.point.fields import UNKNOWN, poles_outside
from jaxstab.region.closed_form import Responses, circle_equations
from jaxstab.region.pieces import Branch
from jaxstab.rounding import UNIT
from jaxstab.shown import shortened

# Planes of two quantities: how the five dimensionless parameters follow from them (Table I).
#
# Each parameter is a monomial of the physical quantities, so it is monotone along each axis of a
# plane, and its range over a box is known from the corners.

PHYSICAL = {  # Table I: powers of the quantities in each parameter
    "stiffness": {"alpha": 1},
    "damping": {"beta": 1},
    "mass": {"alpha": -1, "beta": -1, "gamma": -1, "delta": -1},
    "sample_time": {"alpha": 2, "beta": 1, "gamma": 2, "delta": 1, "delay": -1},
    "physical_stiffness": {"gamma": 1},
    "physical_damping": {"delta": 1},
    "time_delay": {"delay": 1},
}

DIMENSIONLESS = {name: {name: 1} for name in AXES}
POSITIVE = {"mass", "sample_time"}

Window = tuple[tuple[float, float], tuple[float, float]]


class Monomials(NamedTuple):
    """The five parameters factor x^i y^j over a window, for one loop or for each of several."""

    factor: Float64[Array, "5 *points"]
    powers: Int64[Array, "2 5"]  # i and j: -1, 0, 1 or 2
    lower: Float64[Array, " 2"]
    width: Float64[Array, " 2"]

    def select(self, chosen: Int64[np.ndarray, " points"]) -> "Monomials":
        """Return the maps of chosen loops."""
        return self._replace(factor=self.factor[:, chosen])

    def parameters(self, position: Float64[Array, "points 2"]) -> Float64[Array, "5 points"]:
        """Return the parameters at positions in the window's unit square."""
        x, y = (self.raised(axis, position[:, axis]) for axis in (0, 1))
        return self.factor.reshape(5, -1) * x * y

    def raised(self, axis: int, position: Float64[Array, " points"]) -> Float64[Array, "5 points"]:
        """Return x^i, or y^j for axis 1, for each parameter."""
        xp = namespace(self.factor, position)
        x = self.lower[axis] + self.width[axis] * position
        inverse = 1.0 / xp.where(x == 0.0, 1.0, x)
        return xp.stack([xp.ones_like(x), x, x * x, inverse])[self.powers[axis]]


def monomials(plane: tuple[str, str], window: Window, fixed: Mapping[str, Numbers]) -> Monomials:
    """Return the map from a plane to the parameters, for each of the fixed values.

    ValueError: unknown, missing or doubled names, values outside their range, an empty window,
    lists of fixed values of several lengths.
    """
    _check_names(plane, fixed)
    table = _table(plane)
    values = {name: np.atleast_1d(_checked(name, value)) for name, value in fixed.items()}
    shapes = {name: value.shape for name, value in values.items() if value.shape != (1,)}
    if len(set(shapes.values())) > 1 or any(
        len(shape) > 1 or shape == (0,) for shape in shapes.values()
    ):
        raise ValueError(
            f"the fixed values have shapes {shapes}; give numbers, or lists of one length."
        )
    for name, (lower, upper) in zip(plane, window, strict=True):
        if not _checked(name, lower) < _checked(name, upper):
            raise ValueError(
                f"the window of {name} is ({lower}, {upper}); give a lower and a larger upper end."
            )
    powers = np.array([[table[name].get(axis, 0) for axis in AXES] for name in plane])
    factor = [
        any(axis in table[name] for name in (*plane, *fixed) if name not in POSITIVE)
        * prod(value ** table[name].get(axis, 0) for name, value in values.items())
        for axis in AXES
    ]
    lower, upper = np.array(window, np.float64).T
    return Monomials(np.stack(np.broadcast_arrays(*factor)), powers, lower, upper - lower)


def _table(plane: tuple[str, str]) -> dict[str, dict[str, int]]:
    return PHYSICAL if DIMENSIONLESS.keys().isdisjoint(plane) else DIMENSIONLESS


def _filters_of(
    plane: tuple[str, str],
    window: Window,
    fixed: Mapping[str, Numbers],
    velocity: Velocity | None,
    position: Filter | None,
) -> Filters | None:
    """Return the filters in units of one sample.

    ValueError: they change with a sampling period that does.
    """
    given = known_filters(velocity, position)
    if given is None:
        return None
    ranges = {**fixed, **dict(zip(plane, window, strict=True))}
    periods = np.unique(ranges.get("sample_time", 1.0)).tolist()
    filters, *others = [(given[0].per_sample(each), given[1].per_sample(each)) for each in periods]
    if any(other != filters for other in others):
        raise ValueError(
            f"velocity is {given[0]} and position {given[1]}, which change with sample_time; fix "
            "sample_time, or give windows in samples and factors in place of cut-offs."
        )
    for chain in (filters[0].filter, filters[1]):
        chain.checked()
    return filters


def _check_names(plane: tuple[str, str], fixed: Mapping[str, Numbers]) -> None:
    names = [*plane, *fixed]
    table = _table(plane)
    unknown = [name for name in names if name not in table]
    if unknown:
        raise ValueError(
            f"{unknown[0]!r} is not a quantity of this plane; choose all names from "
            f"{', '.join(DIMENSIONLESS)}, or all from {', '.join(PHYSICAL)}."
        )
    doubled = [name for name in names if names.count(name) > 1]
    if doubled:
        raise ValueError(f"{doubled[0]} is given twice; an axis of the plane has no fixed value.")
    missing = [name for name in table if name not in names]
    if missing:
        raise ValueError(f"{missing[0]} has no value; fix every quantity beside the two axes.")


def _checked(name: str, value: Numbers) -> Float64[np.ndarray, "*values"]:
    signed = {"alpha", "beta", "stiffness", "damping"}  # all others are >= 0
    least, is_open = -inf if name in signed else 0.0, name in POSITIVE
    if is_traced(value):
        return np.array(checked_number(name, value))  # which refuses it
    require_x64(value)
    return np.asarray(checked(name, value, least, is_open=is_open))


# Counts of roots outside of the circle, and the edges of a grid on which they change.

Points = Float64[np.ndarray, "point 2"]  # of the window's unit square


class Edges(NamedTuple):
    """Edges of grids from an end where a count is below a level to one where it is above.

    shares: between which shares of the edge the count passes the level.
    edge: True where the loops on one side are stable.
    """

    trace: Int64[np.ndarray, " edge"]
    piece: Int64[np.ndarray, " edge"]
    branch: Int8[np.ndarray, " edge"]
    level: Float64[np.ndarray, " edge"]
    ends: Float64[np.ndarray, "edge 2 2"]
    shares: Float64[np.ndarray, "edge 2"]
    edge: Bool[np.ndarray, " edge"]

    def at(self, share: Float64[np.ndarray, " edge"]) -> Points:
        """Return the points at shares of the way between the ends."""
        return self.ends[:, 0] + share[:, None] * (self.ends[:, 1] - self.ends[:, 0])


def polynomials(
    maps: Monomials, positions: Points, filters: Filters | None
) -> Float64[np.ndarray, "point coefficient"]:
    """Return the coefficients of p(z), highest power first."""
    alpha, beta, *plant = maps.parameters(positions)
    return characteristic_polynomial(
        alpha, beta, **by_name(*np.maximum(plant, 0.0)), **as_keywords(filters)
    )


def on_circle(
    falling: Float64[np.ndarray, "point coefficient"],
) -> Complex128[np.ndarray, "point angle"]:
    """Return p(z) / z^n at angles from 0 to pi."""
    angles, per_turn = 1 << 12, 64  # on the circle, at least; of a turn of z^n
    return np.fft.rfft(falling, max(angles, per_turn * falling.shape[1]))


def counted(
    maps: Monomials, positions: Points, filters: Filters | None
) -> Int64[np.ndarray, "4 *point"]:
    """Count the roots outside of the circle: pairs, real ones beyond 1 and -1 (``Branch``), all."""
    circle = 1.0 + 2.0**-30  # roots beyond it are counted
    at_once, few_at_once = 1 << 14, 1 << 9  # polynomials in memory, and with many values of each
    parts = []
    for rows in np.array_split(np.arange(len(positions)), 1 + len(positions) // at_once):
        own = maps.select(rows) if maps.factor.shape[1] > 1 else maps
        falling = polynomials(own, positions[rows], filters)
        powers = np.arange(falling.shape[1])
        scaled = falling * circle ** -powers.astype(float)
        columns = list(scaled.T)
        outside = poles_outside(columns, 4.0 * UNIT * sum(map(abs, columns))).astype(np.int64)
        unknown = np.flatnonzero(outside == UNKNOWN)
        for few in np.array_split(unknown, 1 + len(unknown) // few_at_once):
            values = on_circle(scaled[few])  # their phase turns back once for each root outside
            turns = np.angle(values[:, 1:] * values[:, :-1].conj()).sum(axis=1) / pi
            outside[few] = -np.round(turns).astype(int)
        plus, minus = scaled.sum(axis=1) < 0.0, scaled @ (-1.0) ** powers < 0.0
        parts.append(np.stack([(outside - plus - minus) // 2, plus, minus, outside]))
    return np.concatenate(parts, axis=1)


def crossed_edges(maps: Monomials, trace: int, filters: Filters | None, cells: int) -> Edges:
    """Return the edges of a grid of squares that the branches of one trace cross, in order."""
    nodes = np.linspace(0.0, 1.0, cells + 1)
    grid = np.stack(np.meshgrid(nodes, nodes), axis=-1)
    counts = counted(maps, grid.reshape(-1, 2), filters).reshape(4, *grid.shape[:2])
    lines: list[tuple[Branch, float, Any]] = [
        (branch, level, line)
        for branch in Branch
        for level in (np.arange(counts[branch].min(), counts[branch].max()) + 0.5).tolist()
        for line in contour_generator(z=counts[branch]).lines(level)
    ]
    sizes = [len(line) for *_, line in lines]
    places = np.concatenate([np.zeros((0, 2)), *(line for *_, line in lines)])
    branch = np.repeat(np.array([line[0] for line in lines], np.int8), sizes)
    level = np.repeat(np.array([line[1] for line in lines]), sizes)
    # A vertex lies on an edge along one axis: along the other one its place is a whole number.
    whole = np.round(places)
    is_whole = np.abs(places - whole) < 1e-6
    lower, upper = (np.where(is_whole, whole, to(places)) for to in (np.floor, np.ceil))
    column, row = lower.astype(int).T
    is_falling = (counts[branch, row, column] > level)[:, None]
    ends = np.where(is_falling, [upper, lower], [lower, upper]) / cells
    count = len(places)
    return Edges(
        trace=np.full(count, trace),
        piece=np.repeat(np.arange(len(lines)), sizes),
        branch=branch,
        level=level,
        ends=np.swapaxes(ends, 0, 1),
        shares=np.tile([0.0, 1.0], (count, 1)),
        edge=np.zeros(count, bool),
    )


def halved(maps: Monomials, edges: Edges, filters: Filters | None) -> Edges:
    """Narrow the shares between which counts change; leave out pairs that are two real roots.

    Where a real root crosses to the inside while another one stays outside, the count of pairs
    changes as well.
    """
    halvings = 8  # of the edges: a change of count is then known to 1/256 of one
    if not len(edges.trace):
        return edges
    below, above = edges.shares.T
    rows, maps = np.arange(len(below)), maps.select(edges.trace)
    for _ in range(halvings):
        middle = 0.5 * (below + above)
        counts = counted(maps, edges.at(middle), filters)
        is_above = counts[edges.branch, rows] > edges.level
        below, above = np.where(is_above, below, middle), np.where(is_above, middle, above)
    sides = [counted(maps, edges.at(share), filters) for share in (below, above)]
    is_real = np.any(sides[0][1:3] != sides[1][1:3], axis=0)
    is_kept = (edges.branch != Branch.CURVE) | ~is_real
    narrowed = edges._replace(
        piece=edges.piece + np.cumsum(~is_kept),  # a line is cut where vertices are left out
        shares=np.stack([below, above], axis=1),
        edge=np.minimum(sides[0][3], sides[1][3]) == 0,
    )
    return Edges(*(column[is_kept] for column in narrowed))


# Points of the boundary on edges, by Newton's method.
#
# Unknown are the share s of the edge and theta / pi. Where a pair crosses, two equations hold
# (``circle_equations``); where a real root does, Re g = 0 and theta = 0 or pi. Each edge is a lane
# of a program that is compiled once: the plane, its window and the fixed quantities are arguments.

_CONVERGED = 1e-9  # of an edge, and of pi
_BEYOND = 0.01  # of an edge: how far the larger circle may move a bracket


def _equations(u: Array, ends: Array, branch: Array, maps: Monomials, filters: Responses) -> Array:
    """Return the two equations of edges (2, edge) at u = (s, theta / pi)."""
    xp, (share, turn) = namespace(u), u
    position = ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0])
    alpha, beta, *others = maps.parameters(position)
    hand = [xp.maximum(x, 0.0) for x in others]
    is_pair, end = branch == Branch.CURVE, 1.0 * (branch == Branch.Z_MINUS_ONE)
    theta = pi * xp.where(is_pair, turn, end)
    real, imaginary = circle_equations(hand, alpha, beta, theta, filters)
    return xp.stack([real, xp.where(is_pair, imaginary, turn - end)])


@cache
def _corrector() -> Callable[..., tuple[Array, Array]]:
    """Return the compiled program that solves for the point on the edge of each lane."""
    import optimistix

    jax = load_jax()
    solver: Any = optimistix.Newton(rtol=0.0, atol=_CONVERGED)

    def correct(start: Array, ends: Array, branch: Array, *plane: Any) -> tuple[Array, Array]:
        def equations(u: Array, _: None) -> Array:
            return _equations(u[:, None], ends[None], branch, *plane)[:, 0]

        solution: Any = optimistix.root_find(equations, solver, start, max_steps=16, throw=False)
        return solution.value, solution.result == optimistix.RESULTS.successful

    # Arguments without a lane axis are shared by the whole plane. Compiling takes longer than all
    # lanes of a trace, so XLA optimises little.
    of_lane: Any = 0, 0, 0, Monomials(1, None, None, None), None
    options = compiler_options({"xla_backend_optimization_level": 0})
    return jax.jit(jax.vmap(correct, in_axes=of_lane), compiler_options=options)


def solved(
    maps: Monomials, edges: Edges, filters: Filters | None
) -> tuple[Points, Float64[np.ndarray, " edge"], Bool[np.ndarray, " edge"]]:
    """Return shares of edges and theta / pi, |g| there, and where Newton's method converged."""
    lanes_at_once = 512  # are compiled, nothing else
    if not len(edges.trace):
        return np.zeros((0, 2)), np.zeros(0), np.zeros(0, bool)
    start, responses = _starts(maps, edges, filters), Responses.from_filters(filters)
    parts = []
    for chunk, filled in lists(np.arange(len(start)), lanes_at_once):
        lanes = start[filled], edges.ends[filled], edges.branch[filled], maps.select(filled)
        with own_settings():
            answer = _corrector()(*lanes, responses)
        parts.append([np.asarray(column)[: chunk.size] for column in answer])
    u, is_solved = map(np.concatenate, zip(*parts, strict=True))
    farthest = np.ptp(edges.shares, axis=1) + _BEYOND
    is_solved &= np.abs(u[:, 0] - start[:, 0]) <= farthest
    is_solved &= np.abs(u[:, 1] - 0.5) <= 0.5 + _CONVERGED
    u = np.where(is_solved[:, None], u, start)
    value = _equations(u.T, edges.ends, edges.branch, maps, responses)
    return u, np.linalg.norm(value, axis=0), is_solved


def _starts(maps: Monomials, edges: Edges, filters: Filters | None) -> Points:
    """Return the middles of brackets and theta / pi of the pair that is next to the circle."""
    share = edges.shares.mean(axis=1)
    falling = polynomials(maps, edges.at(share), filters)
    # z - p/p' at points of the circle is a root where that is close to them.
    slope = on_circle(falling * np.arange(falling.shape[1])[::-1])
    step = (on_circle(falling) / slope)[:, 1:-1]
    z = np.exp(1j * np.linspace(0.0, pi, slope.shape[1]))[1:-1]
    root, size = z - z * step, np.abs(step)
    away = np.where(size < 2.0 * pi / slope.shape[1], np.abs(np.abs(root) - 1.0), size)
    is_real = root.imag < 0.5 * z.imag
    nearest = np.argmin(np.where(is_real, inf, away), axis=1)
    turn = np.angle(root[np.arange(len(root)), nearest]) / pi
    end = 1.0 * (edges.branch == Branch.Z_MINUS_ONE)
    return np.stack([share, np.where(edges.branch == Branch.CURVE, turn, end)], axis=1)


class TraceStatus(Status):
    """The status of one point of a trace.

    Example:
        >>> [status.name for status in jaxstab.results.TraceStatus]
        ['NOT_COMPUTED', 'CONVERGED', 'BRACKETED']
    """

    NOT_COMPUTED = 0, "not computed"
    CONVERGED = 1, "on the boundary to full precision, which is complete to the resolution only"
    BRACKETED = 2, "to the resolution: between loops of unlike numbers of unstable poles"


@dataclass(frozen=True)
class BoundaryTrace:
    """Points of the plane with a root on the unit circle, branch by branch in order.

    Attributes:
        points: (n, 2), the two quantities of ``plane``.
        theta: angle of the root in [0, pi].
        branch: a ``Branch``.
        piece: number of the connected piece, counted from 0.
        edge: True where loops on one side of it are stable, so that it bounds the stable set.
        residual: the error of the two equations, in units of p(z) with leading coefficient 1.
        status: a ``TraceStatus``.

    Example:
        >>> window = (0.0, 0.2), (0.0, 0.8)
        >>> hand = {"gamma": 0.0, "delta": 0.0, "delay": 1.0}
        >>> trace = jaxstab.trace_boundary(("alpha", "beta"), window, **hand)
        >>> trace
        BoundaryTrace(plane=('alpha', 'beta'), resolution=0.015625)
        >>> bool(trace.edge.any())
        True
    """

    plane: tuple[str, str]
    resolution: float
    points: Float64[np.ndarray, "points 2"] = field(repr=False)
    theta: Float64[np.ndarray, " points"] = field(repr=False)
    branch: Int8[np.ndarray, " points"] = field(repr=False)
    piece: Int64[np.ndarray, " points"] = field(repr=False)
    edge: Bool[np.ndarray, " points"] = field(repr=False)
    residual: Float64[np.ndarray, " points"] = field(repr=False)
    status: Int8[np.ndarray, " points"] = field(repr=False)


@overload
def trace_boundary(
    plane: tuple[str, str],
    window: Window,
    *,
    loop: LoopParameters | None = None,
    velocity: Velocity | None = None,
    position: Filter | None = None,
    resolution: int | float = 1 / 64,
    **fixed: float,
) -> BoundaryTrace: ...


@overload
def trace_boundary(
    plane: tuple[str, str],
    window: Window,
    *,
    loop: LoopParameters | None = None,
    velocity: Velocity | None = None,
    position: Filter | None = None,
    resolution: int | float = 1 / 64,
    **fixed: Numbers,
) -> list[BoundaryTrace]: ...


def trace_boundary(
    plane: tuple[str, str],
    window: Window,
    *,
    loop: LoopParameters | None = None,
    velocity: Velocity | None = None,
    position: Filter | None = None,
    resolution: int | float = 1 / 64,
    **fixed: Numbers,
) -> BoundaryTrace | list[BoundaryTrace]:
    """Trace the points with a root on the unit circle, in a plane of two quantities.

    Args:
        plane: names of the two axes, either both dimensionless (alpha, beta, gamma, delta, delay)
            or both physical, in SI units: stiffness K, damping B, mass m, sample_time T,
            physical_stiffness k, physical_damping b, time_delay t_d (Table I).
        window: lower and upper end of each axis.
        loop: gives the physical quantities beside K and B that are neither axes nor fixed, and the
            velocity estimator and the position filter.
        velocity: estimator in place of that of the loop, in SI units in a physical plane and in
            units of one sample in a dimensionless one.
        position: filter in place of that of the loop, in the same units.
        resolution: largest distance of neighbours along a branch, as a part of the window, in
            [1e-3, 0.25]. Roots outside of the circle are counted on a grid whose diagonals are not
            longer.
        **fixed: a value for each other quantity of the same kind. Lists, all of one length, ask for
            as many traces, which are solved for together.

    Returns:
        BoundaryTrace, or a list of them where a fixed quantity is a list. What is smaller than a
        cell of the grid may be missed: a closed branch, a bend, or two branches side by side.

    Raises: see ``jaxstab.conventions``; ValueError also if a name is unknown, missing or doubled, a
    window empty, lists are of several lengths, or filters change with a sampling period that is an
    axis or a list; TypeError if the loop's device is not one mass.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle; counts of roots by
    Schur (1917) and Cohn (1922).

    Example:
        >>> window = (0.0, 0.2), (0.0, 0.8)
        >>> hand = {"gamma": 0.0, "delta": 0.0, "delay": 1.0}
        >>> trace = jaxstab.trace_boundary(("alpha", "beta"), window, **hand)
        >>> round(float(trace.points[trace.edge, 0].max()), 3)
        0.144
        >>> traces = jaxstab.trace_boundary(
        ...     ("alpha", "beta"), window, gamma=0.0, delta=0.0, delay=[1.0, 2.0]
        ... )
        >>> [round(float(trace.points[trace.edge, 0].max()), 3) for trace in traces]
        [0.144, 0.062]
    """
    resolution = checked_number("resolution", resolution, 1e-3, 0.25, unit="of the window")
    if not has_shape(plane, 2) or not all(isinstance(name, str) for name in plane):
        raise TypeError(f'plane is {shortened(plane)}; give two names, as ("delay", "alpha").')
    if not has_shape(window, 2, 2):
        raise TypeError(f"window is {shortened(window)}; give both ends of both axes.")
    if loop is not None:
        body = loop.body
        if body is None:
            raise TypeError(
                f"the device ({loop.device}) is not one mass; a trace takes mass, spring and "
                "damper."
            )
        values = body.mass, loop.sample_time, body.stiffness, body.damping, loop.delay
        known = dict(zip([*PHYSICAL][2:], values, strict=True))
        fixed = {name: value for name, value in known.items() if name not in plane} | fixed
        velocity, position = velocity or loop.velocity, position or loop.position
    maps = monomials(plane, window, fixed)
    filters = _filters_of(plane, window, fixed, velocity, position)
    cells = ceil(sqrt(2.0) / resolution)
    numbers = range(maps.factor.shape[1])
    with np.errstate(all="ignore"):  # what overflows is infinite or NaN
        parts = [crossed_edges(maps.select(np.array([n])), n, filters, cells) for n in numbers]
        edges = halved(maps, Edges(*map(np.concatenate, zip(*parts, strict=True))), filters)
        u, residual, is_solved = solved(maps.select(edges.trace), edges, filters)
    columns = {
        "points": maps.lower + maps.width * edges.at(u[:, 0]),
        "theta": np.clip(pi * u[:, 1], 0.0, pi),
        "branch": edges.branch,
        "piece": edges.piece,
        "edge": edges.edge,
        "residual": residual,
        "status": np.where(is_solved, TraceStatus.CONVERGED, TraceStatus.BRACKETED).astype(np.int8),
    }
    traces = []
    for number in numbers:
        own = {name: values[edges.trace == number] for name, values in columns.items()}
        own["piece"] = np.unique(own["piece"], return_inverse=True)[1]
        traces.append(BoundaryTrace(plane, resolution, **own))
    return traces if any(map(np.ndim, fixed.values())) else traces[0]
