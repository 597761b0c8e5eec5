"""The boundary in any plane of two quantities, complete without seeds.

1. The window times the angles [0, pi] is halved into boxes; those proved free of roots on the
   circle are dropped (``proofs.exclusion``).
2. From a box that is left, a point of the boundary is solved for and its branch followed both ways
   by pseudo-arclength steps, until every box left lies at a branch; others are halved further.
3. Boxes that can be neither excluded nor explained are returned as unresolved.

So every wall of the window with a root on the unit circle lies within two resolutions of a point
of the trace or of an unresolved box.

Points are solved for by optimistix, in one program for every plane; its lanes are the branches, of
one trace or of several, that are followed at the same time. The boxes are computed by NumPy.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from math import inf, pi, prod
from typing import Any, NamedTuple, overload

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64

from jaxstab.arrays import Array, Numbers, is_traced, namespace, take
from jaxstab.batches import lists
from jaxstab.boxes.search import ParameterBox, Proof, excluded, joined
from jaxstab.conventions import AXES, Status
from jaxstab.model import (
    Filter,
    LoopParameters,
    Velocity,
    by_name,
    characteristic_polynomial,
    companion_matrix,
)
from jaxstab.model.filters import Filters, as_keywords, known_filters
from jaxstab.numbers import checked, checked_number, require_x64
from jaxstab.proofs.exclusion import Loops, exclude
from jaxstab.proofs.filters import Responses
from jaxstab.proofs.plant import circle_equations, quick_slice
from jaxstab.region.closed_form import SliceCoefficients, slice_coefficients
from jaxstab.region.pieces import Branch

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
SIGNED = {"alpha", "beta", "stiffness", "damping"}  # all others are >= 0
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
    return DIMENSIONLESS if set(plane) <= set(DIMENSIONLESS) else PHYSICAL


def loop_quantities(loop: LoopParameters) -> dict[str, float]:
    """Return the physical quantities of a loop under the names used here.

    TypeError: the device is not one mass.
    """
    body = loop.body
    if body is None:
        raise TypeError(
            f"the device ({loop.device}) is not one mass; a trace takes mass, spring and damper."
        )
    return {
        "mass": body.mass,
        "sample_time": loop.sample_time,
        "physical_stiffness": body.stiffness,
        "physical_damping": body.damping,
        "time_delay": loop.delay,
    }


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
        chain.transfer()  # refuses what is too long
    return filters


def _check_names(plane: tuple[str, str], fixed: Mapping[str, Numbers]) -> None:
    names = [*plane, *fixed]
    table = _table(plane)
    unknown = [name for name in names if name not in DIMENSIONLESS and name not in PHYSICAL]
    unknown += [name for name in names if name not in table]
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
    least, is_open = -inf if name in SIGNED else 0.0, name in POSITIVE
    if is_traced(value):
        return np.array(checked_number(name, value))  # which refuses it
    require_x64(value)
    return np.asarray(checked(name, value, least, is_open=is_open))


def corner_ranges(
    plane: Monomials, center: Float64[np.ndarray, "boxes 2"], half: Float64[np.ndarray, "boxes 2"]
) -> tuple[
    Float64[np.ndarray, "5 boxes"], Float64[np.ndarray, "5 boxes"], Float64[np.ndarray, "2 5 boxes"]
]:
    """Return the parameters at the centers of boxes, radii that cover them, and those by axis."""
    sides = [
        [plane.raised(axis, center[:, axis] + side * half[:, axis]) for side in (-1, 0, 1)]
        for axis in (0, 1)
    ]

    def parameters(x_side: int, y_side: int) -> Float64[np.ndarray, "5 boxes"]:
        values: Float64[np.ndarray, "5 boxes"]
        values = plane.factor.reshape(5, -1) * sides[0][x_side + 1] * sides[1][y_side + 1]
        return values

    middle = parameters(0, 0)
    corners = np.stack([parameters(x, y) for x in (-1, 1) for y in (-1, 1)])
    along_x = np.maximum(np.abs(parameters(-1, 0) - middle), np.abs(parameters(1, 0) - middle))
    along_y = np.maximum(np.abs(parameters(0, -1) - middle), np.abs(parameters(0, 1) - middle))
    radius = np.max(np.abs(corners - middle), axis=0) * (1 + 1e-12)
    return middle, radius, np.stack([along_x, along_y])


# Branches of the boundary in any plane: pseudo-arclength steps, corrected by Newton's method.
#
# Unknown is u = (x, y, theta / pi) in the unit cube. On a branch of a pair of roots two equations
# hold (``circle_equations``), on the branch of a real root Re g = 0 and theta = 0 or pi. A step
# along the tangent is corrected in the plane across it, so folds in x or y are nothing special.
# Each branch is followed in one lane, and a step of all lanes is one call of a program
# that is compiled once: the plane, its window and the fixed quantities are arguments of it.

Points = Float64[np.ndarray, "points 3"]

Rows = Float64[np.ndarray, "points 2 3"]

_CONVERGED = 1e-9  # of the unit cube: distance to both equations and the last Newton step
_MOST_STEPS = 8
_DIFFERENCE = 2.0**-25  # of the unit cube: derivatives are then good to about 1e-7
_STRAIGHT = 0.985  # cosine between tangents: grow the step
_BENT = 0.94  # shrink it
_SHORTEST = 1e-7
_ON_FACE = 1e-12
_MOST_POINTS = 20_000
_MOST_LANES, _FEWEST_LANES = 512, 64  # both are compiled, nothing else


class Lanes(NamedTuple):
    """The trace and the kind of branch of each point, and the filters of all."""

    maps: Monomials
    branch: Int8[Array, " points"]
    responses: Responses

    def select(self, chosen: Int64[np.ndarray, " chosen"]) -> "Lanes":
        """Return chosen lanes."""
        return Lanes(self.maps.select(chosen), self.branch[chosen], self.responses)


class Corrected(NamedTuple):
    """Points, the derivatives of both equations there, and whether Newton's method converged."""

    position: Points
    rows: Rows
    converged: Bool[np.ndarray, " points"]

    @property
    def tangent(self) -> Points:
        """The unit tangents of the branches."""
        along = np.cross(self.rows[:, 0], self.rows[:, 1])
        unit: Points = along / np.linalg.norm(along, axis=1, keepdims=True)
        return unit


class Path(NamedTuple):
    """Points along a branch, the derivatives there, and how it goes on at its two ends."""

    points: Points
    rows: Rows
    stalled: tuple[bool, bool]


def _values(c: SliceCoefficients, alpha: Array, beta: Array, turn: Array, lanes: Lanes) -> Array:
    """Return the two equations of a branch at gains and theta / pi: (2, ...)."""
    xp = namespace(c, alpha)
    is_pair, end = lanes.branch == Branch.CURVE, 1.0 * (lanes.branch == Branch.Z_MINUS_ONE)
    theta = pi * xp.where(is_pair, turn, end)
    real, imaginary = circle_equations(c, alpha, beta, theta, lanes.responses)
    return xp.stack([real, xp.where(is_pair, imaginary, turn - end)])


@cache
def _corrector() -> Callable[..., tuple[Array, Array, Array]]:
    """Return the compiled program that solves for a point of a branch in each lane."""
    import jax
    import jax.numpy as jnp
    import lineax
    import optimistix

    newton: Any = optimistix.Newton(rtol=0.0, atol=_CONVERGED)
    shift = _DIFFERENCE * np.eye(4, 3, -1)

    def equations(u: Array, lanes: Lanes) -> tuple[Array, Array]:
        moved = u + shift
        alpha, beta, *plant = lanes.maps.parameters(moved[:, :2])
        value = _values(quick_slice(*plant), alpha, beta, moved[:, 2], lanes)
        return value[:, 0], (value[:, 1:] - value[:, :1]) / _DIFFERENCE

    def correct(guess: Array, normal: Array, lanes: Lanes) -> tuple[Array, Array, Array]:
        def residual(u: Array, _: None) -> tuple[Array, Array]:
            here = jax.lax.stop_gradient(u)
            value, rows = equations(here, lanes)
            row, other = rows
            along = jnp.cross(row, other)
            across = jnp.where(jnp.any(normal != 0.0), normal, along)
            sides = jnp.stack([jnp.cross(other, across), jnp.cross(across, row), along])
            distance = jnp.append(value, normal @ (here - guess))
            # The derivatives are at hand: solved for, the equations have those of u itself.
            return (u - here) + distance @ sides / (across @ along), rows

        solution: Any = optimistix.root_find(
            residual,
            newton,
            guess,
            has_aux=True,
            max_steps=_MOST_STEPS,
            throw=False,
            tags=frozenset({lineax.diagonal_tag}),
        )
        return solution.value, solution.aux, solution.result == optimistix.RESULTS.successful

    # What is not of each lane is of the plane.
    of_lane: Any = Lanes(Monomials(1, None, None, None), 0, None)  # type: ignore[arg-type]
    program = jax.jit(jax.vmap(correct, in_axes=(0, 0, of_lane)))

    def in_float64(*arguments: Any) -> tuple[Array, Array, Array]:
        with jax.enable_x64(True):
            answer: tuple[Array, Array, Array] = jax.device_get(program(*arguments))
        return answer

    return in_float64


def correct(guess: Points, normal: Points, lanes: Lanes) -> Corrected:
    """Solve for points of branches in the planes through ``guess`` across ``normal``.

    Where the normal is 0, each step goes to the nearest point of the linearised equations.
    """
    parts = []
    for chunk, filled in lists(np.arange(len(guess)), _MOST_LANES, _FEWEST_LANES):
        answer = _corrector()(guess[filled], normal[filled], lanes.select(filled))
        parts.append([column[: chunk.size] for column in answer])
    return Corrected(*map(np.concatenate, zip(*parts, strict=True)))


def polish(
    points: Points, rows: Rows, lanes: Lanes
) -> tuple[Points, Float64[np.ndarray, " points"]]:
    """Correct points once more with plant coefficients of full accuracy; also return |g| there."""
    across = np.swapaxes(rows, 1, 2)
    for _ in range(2):  # steps of least length; the residual is the one before the last
        alpha, beta, *plant = lanes.maps.parameters(points[:, :2])
        gamma, delta, delay = (np.maximum(value, 0.0) for value in plant)
        c = slice_coefficients(gamma, delta, delay, np.ones(len(points)))
        value = _values(c, alpha, beta, points[:, 2], lanes).T[..., None]
        points = points - (across @ np.linalg.solve(rows @ across, value))[..., 0]
    return points, np.linalg.norm(value[..., 0], axis=1)


def follow(starts: Corrected, lanes: Lanes, longest: float) -> list[Path]:
    """Return the whole branch through each start, as far as it lies in the unit cube.

    Steps are at most ``longest``; they are halved where the branch bends. A path stalls where even
    the shortest step fails: at a point where branches meet without a common direction.
    """
    count = len(starts.position)
    both = np.tile(np.arange(count), 2)
    sign = np.repeat([1.0, -1.0], count)[:, None]
    walks = _walk(starts.position[both], sign * starts.tangent[both], lanes.select(both), longest)
    paths = []
    for start, ahead, back in zip(range(count), walks, walks[count:], strict=False):
        points, rows = starts.position[start, None], starts.rows[start, None]
        if ahead.closed:
            points = np.concatenate([points, ahead.points[:-1], points])
            rows = np.concatenate([rows, ahead.rows[:-1], rows])
            paths.append(Path(points, rows, (False, False)))
        else:
            points = np.concatenate([back.points[::-1], points, ahead.points])
            rows = np.concatenate([back.rows[::-1], rows, ahead.rows])
            paths.append(Path(points, rows, (back.stalled, ahead.stalled)))
    return paths


class _Walk(NamedTuple):
    """The points behind a start, and how they end."""

    points: Points
    rows: Rows
    stalled: bool
    closed: bool


def _walk(start: Points, start_tangent: Points, lanes: Lanes, longest: float) -> list[_Walk]:
    """Follow branches from points on them, one way, all a step at a time."""
    count = len(start)
    here, tangent, normal = start.copy(), start_tangent.copy(), start_tangent.copy()
    step = np.full(count, longest / 4)
    guess, farthest = here + step[:, None] * tangent, 2 * step
    lands, exited, closed, stalled = np.zeros((4, count), bool)
    steps = np.zeros(count, int)
    history: list[tuple[Int64[np.ndarray, " lanes"], Points, Rows]] = []
    while True:
        i = np.flatnonzero(~exited & ~closed & ~stalled & (steps < _MOST_POINTS))
        if not i.size:
            break
        solved = correct(guess[i], normal[i], lanes.select(i))
        there, move = solved.position, solved.position - here[i]
        length = np.linalg.norm(move, axis=1)
        cosine = np.sum(solved.tangent * tangent[i], axis=1)
        usable = solved.converged & (length < farthest[i]) & (lands[i] | (np.abs(cosine) >= _BENT))
        face, landing = _first_face(here[i], there)
        crosses = usable & ~lands[i] & (face >= 0)
        is_new = usable & ~crosses
        again = is_new & ~lands[i] & (steps[i] > 1)
        again &= _passes(start[i], start_tangent[i], here[i], there)
        exited[i], closed[i], steps[i] = is_new & lands[i], again, steps[i] + is_new
        new = i[is_new]
        history.append((new, there[is_new], solved.rows[is_new]))
        here[new] = there[is_new]
        tangent[new] = (np.copysign(1.0, cosine)[:, None] * solved.tangent)[is_new]
        grows = is_new & (np.abs(cosine) > _STRAIGHT)
        step[i] = np.where(grows, np.minimum(longest, 1.5 * step[i]), step[i])
        step[i[~usable]] /= 2
        stalled[i] = ~usable & (step[i] < _SHORTEST)
        # Where a step leaves the cube, the next one lands on the face.
        lands[i] = crosses
        ahead = here[i] + step[i, None] * tangent[i]
        guess[i] = np.where(crosses[:, None], landing, ahead)
        normal[i] = np.where(crosses[:, None], np.eye(3)[face], tangent[i])
        farthest[i] = 2 * np.where(crosses, length, step[i])
    lane, points, rows = (np.concatenate(column) for column in zip(*history, strict=True))
    order, ends = np.argsort(lane, kind="stable"), np.cumsum(steps)[:-1]
    columns = (np.split(column[order], ends) for column in (points, rows))
    walks = zip(*columns, stalled.tolist(), closed.tolist(), strict=True)
    return [_Walk(*walk) for walk in walks]


def _first_face(here: Points, there: Points) -> tuple[Int64[np.ndarray, " points"], Points]:
    """Return the axis of the first face of the unit cube between points, or -1, and where it is."""
    beyond = (there < -_ON_FACE) | (there > 1.0 + _ON_FACE)
    value = np.where(there > 0.5, 1.0, 0.0)
    share = np.where(beyond, (value - here) / np.where(beyond, there - here, 1.0), np.inf)
    axis = np.argmin(share, axis=1)
    rows = np.arange(len(axis))
    landing = here + share[rows, axis][:, None] * (there - here)
    landing[rows, axis] = value[rows, axis]
    return np.where(beyond.any(axis=1), axis, -1), landing


def _passes(
    start: Points, start_tangent: Points, here: Points, there: Points
) -> Bool[np.ndarray, " points"]:
    """Tell whether the start of a path lies on this step of it, in the same direction."""
    step, back = there - here, start - here
    length = np.linalg.norm(step, axis=1)
    along = np.sum(back * step, axis=1) / length**2
    aside = np.linalg.norm(back - along[:, None] * step, axis=1)
    aligned = np.sum(step * start_tangent, axis=1) > _BENT * length
    passes: Bool[np.ndarray, " points"]
    passes = (along > 0.0) & (along <= 1.0) & (aside < 0.2 * length) & aligned
    return passes


_COVER = 1.0  # resolutions: a box this near to a traced point is explained by it
_REFINEMENTS = 4  # each to a quarter of the size before
_KINDS = (Branch.Z_PLUS_ONE, Branch.Z_MINUS_ONE, Branch.CURVE)
_MOST_BOXES = 60_000  # of a search, at once
_PATIENCE = 4  # rounds without a start
_MATRICES = 1024  # at once: those of long windows need 0.3 MB each
_AT_ONCE = 64  # traces: as many fill the lanes, and their boxes the memory
_ON_CIRCLE = 1e-7  # a modulus this little above 1 counts as 1 (corners are double roots)


class TraceStatus(Status):
    """What is known about one point of a trace.

    Example:
        >>> [status.name for status in jaxstab.results.TraceStatus]
        ['NOT_COMPUTED', 'CONVERGED', 'STALLED']
    """

    NOT_COMPUTED = 0, "not computed"
    CONVERGED = 1, "Newton's method converged to full precision"
    STALLED = 2, "the branch could not be followed beyond this point"


@dataclass(frozen=True)
class BoundaryTrace:
    """Points of the plane with a root on the unit circle, branch by branch in order.

    Attributes:
        points: (n, 2), the two quantities of ``plane``.
        theta: angle of the root in [0, pi].
        branch: a ``Branch``.
        piece: number of the connected piece, counted from 0.
        edge: True where no other root is outside, so that the point bounds the stable set.
        residual: the error of the two equations, in units of p(z) with leading coefficient 1.
        status: a ``TraceStatus``.
        unresolved: boxes (k, 2, 2), lower and upper corner, that could neither be proved free nor
            traced; ``complete`` says that there is none.

    Example:
        >>> window = (0.0, 0.2), (0.0, 0.8)
        >>> hand = {"gamma": 0.0, "delta": 0.0, "delay": 1.0}
        >>> trace = jaxstab.trace_boundary(("alpha", "beta"), window, **hand)
        >>> trace
        BoundaryTrace(plane=('alpha', 'beta'), resolution=0.015625)
        >>> bool(trace.edge.any())
        True
        >>> window, hand = ((0.0, 0.1), (0.0, 0.5)), {"gamma": 0.0, "delta": 0.015, "delay": 1.0}
        >>> jaxstab.trace_boundary(("alpha", "beta"), window, resolution=0.1, **hand).complete
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
    unresolved: Float64[np.ndarray, "boxes 2 2"] = field(repr=False)

    @property
    def complete(self) -> bool:
        """Whether the whole window is accounted for, to two resolutions."""
        return len(self.unresolved) == 0


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
    """Trace where a root lies on the unit circle, in a plane of two quantities.

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
        resolution: largest step along a branch and size of the smallest boxes, as a part of the
            window (and of pi for theta), in [1e-3, 0.25].
        **fixed: a value for each other quantity of the same kind. Lists, all of one length, ask for
            as many traces, which are solved for together, several times faster than one by one.

    Returns:
        BoundaryTrace, or a list of them where a fixed quantity is a list. In theory a closed branch
        smaller than three resolutions may be missed where it lies next to another branch.

    Raises: see ``jaxstab.conventions``; ValueError also if a name is unknown, missing or doubled, a
    window empty, lists are of several lengths, or filters change with a sampling period that is an
    axis or a list; TypeError if the loop's device is not one mass.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle; pseudo-arclength
    continuation (Keller 1977); exclusion boxes, ``exclude`` of jaxstab/proofs/exclusion.py.

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
    if loop is not None:
        fixed = {
            name: value for name, value in loop_quantities(loop).items() if name not in plane
        } | fixed
        velocity, position = velocity or loop.velocity, position or loop.position
    maps = monomials(plane, window, fixed)
    filters = _filters_of(plane, window, fixed, velocity, position)
    count = maps.factor.shape[1]
    traces: list[BoundaryTrace] = []
    for chunk in np.array_split(np.arange(count), -(-count // _AT_ONCE)):
        tracer = _Tracer(maps.select(chunk), filters, resolution)
        with np.errstate(all="ignore"):  # what diverges is infinite or NaN
            tracer.search()
        traces += _gathered(plane, tracer)
    return traces if any(map(np.ndim, fixed.values())) else traces[0]


class _Tracer:
    """The branches of some traces found so far, and the boxes that none of them explains.

    A search is for the branches of one kind in one trace. Boxes have its index: three times that of
    the trace, plus that of the kind.
    """

    def __init__(self, maps: Monomials, filters: Filters | None, resolution: float) -> None:
        self.maps = maps
        self.filters, self.responses = filters, Responses.from_filters(filters)
        self.resolution = resolution
        self.paths: list[list[tuple[Branch, Path]]] = [[] for _ in maps.factor.T]
        self.unresolved: list[ParameterBox] = []

    def search(self) -> None:
        """Find all branches."""
        turns = np.tile([[0.0, 1.0, 0.5], [0.0, 0.0, 0.5]], len(self.paths))
        index = np.arange(3 * len(self.paths))
        angle = turns[0], turns[1]
        boxes = ParameterBox.from_axes(index, u=(0.5, 0.5), v=(0.5, 0.5), angle=angle)
        smallest = 0.25 * self.resolution
        for refinement in range(_REFINEMENTS + 1):
            boxes = boxes.paved(self._proof, smallest, most_each=_MOST_BOXES).boxes
            is_large = np.any(boxes.half > smallest, axis=1)
            is_given_up = np.isin(boxes.index, boxes.index[is_large])
            self.unresolved.append(boxes.select(is_given_up))
            patience = _PATIENCE if refinement < _REFINEMENTS else inf
            boxes = self._followed(boxes.select(~is_given_up), patience)
            smallest /= 4
        self.unresolved.append(boxes)

    def _followed(self, boxes: ParameterBox, patience: int | float) -> ParameterBox:
        """Follow the branches that start in boxes; return the boxes that none explains."""
        # A search ends after ``patience`` rounds without a start; its boxes are halved first.
        index, centers = boxes.index, boxes.center
        searches, counts = np.unique(index, return_counts=True)
        groups = np.split(np.argsort(index, kind="stable"), np.cumsum(counts))[:-1]
        members = dict(zip(searches.tolist(), groups, strict=True))
        is_open = np.ones(len(index), bool)
        for search, own in members.items():
            for _, path in self.paths[search // 3]:
                is_open[own] &= ~self._are_near(centers[own], path.points)
        is_candidate, idle = is_open.copy(), Counter[int]()
        while is_candidate.any():
            active = {search: own[is_candidate[own]] for search, own in members.items()}
            active = {search: own for search, own in active.items() if own.size}
            most = max(1, (_FEWEST_LANES if len(active) <= 8 else 8 * _MOST_LANES) // len(active))
            samples = [own[:: -(-len(own) // most)] for own in active.values()]
            chosen = np.concatenate(samples)
            kinds = np.array(_KINDS, np.int8)[index[chosen] % 3]
            lanes = Lanes(self.maps.select(index[chosen] // 3), kinds, self.responses)
            starts = correct(centers[chosen], np.zeros((len(chosen), 3)), lanes)
            is_start = starts.converged & np.all(np.abs(starts.position - 0.5) <= 0.5, axis=1)
            ends = np.cumsum([sample.size for sample in samples])
            for search, sample, end in zip(active, samples, ends.tolist(), strict=True):
                tried = end - sample.size + np.flatnonzero(is_start[end - sample.size : end])
                if not tried.size:
                    continue
                here = starts.position[tried]
                is_start[tried] = self._are_near(here, centers[members[search]])
                for _, path in self.paths[search // 3]:
                    is_start[tried] &= ~self._are_near(here, path.points)
            is_candidate[chosen[~is_start]] = False
            idle.update(set(active) - set(index[chosen[is_start]].tolist()))
            for search in active:
                is_candidate[members[search]] &= idle[search] < patience
            if is_start.any():
                _, unique = np.unique(index[chosen[is_start]], return_index=True)
                unique = np.flatnonzero(is_start)[unique]
                begins = take(starts, unique)
                followed = follow(begins, lanes.select(unique), self.resolution)
                for search, path in zip(index[chosen[unique]].tolist(), followed, strict=True):
                    self.paths[search // 3].append((_KINDS[search % 3], path))
                    for other in range(search - search % 3, search - search % 3 + 3):
                        own = members.get(other, index[:0])
                        is_open[own] &= ~self._are_near(centers[own], path.points)
                is_candidate &= is_open
        return boxes.select(is_open)

    def _are_near(
        self, centers: Points, others: Float64[np.ndarray, "others 3"]
    ) -> Bool[np.ndarray, " points"]:
        """Return which points lie near one of others."""
        squares, is_near = np.sum(centers**2, axis=1)[:, None], np.zeros(len(centers), bool)
        for chunk in np.array_split(others, 1 + len(others) // 256):
            away = squares + np.sum(chunk**2, axis=1) - 2.0 * centers @ chunk.T
            is_near |= np.any(away < (_COVER * self.resolution) ** 2, axis=1)
        return is_near

    def _proof(self, boxes: ParameterBox) -> Proof:
        maps = self.maps.select(boxes.index // 3)
        middle, radius, by_axis = corner_ranges(maps, boxes.center[:, :2], boxes.half[:, :2])
        theta, turn = pi * boxes.center[:, 2:].T, pi * boxes.half[:, 2:].T
        moves = np.zeros((3, 6, turn.size))
        moves[:2, :5], moves[2, 5] = by_axis, turn
        center, radius = (np.concatenate(columns) for columns in ((middle, theta), (radius, turn)))
        test = partial(exclude, filters=self.filters)
        return excluded(test, Loops(*center), moves, Loops(*radius))


def _gathered(plane: tuple[str, str], tracer: _Tracer) -> list[BoundaryTrace]:
    """Return the traces, their points polished and judged all at once."""
    maps, resolution = tracer.maps, tracer.resolution
    paths = [path for of_trace in tracer.paths for path in of_trace]
    sizes = [len(path.points) for _, path in paths]
    counts = [len(of_trace) for of_trace in tracer.paths]
    trace = np.repeat(np.repeat(np.arange(len(counts)), counts), sizes)
    piece = np.repeat(np.concatenate([np.arange(count) for count in counts]), sizes)
    branch = np.repeat(np.array([kind for kind, _ in paths], np.int8), sizes)
    cloud = np.concatenate([np.zeros((0, 3)), *(path.points for _, path in paths)])
    rows = np.concatenate([np.zeros((0, 2, 3)), *(path.rows for _, path in paths)])
    status = np.full(len(cloud), TraceStatus.CONVERGED, np.int8)
    for (_, path), end in zip(paths, np.cumsum(sizes), strict=True):
        ends = np.array([end - len(path.points), end - 1])
        status[ends[np.array(path.stalled)]] = TraceStatus.STALLED
    lanes = Lanes(maps.select(trace), branch, tracer.responses)
    residual = np.zeros(0)
    if sizes:
        cloud, residual = polish(cloud, rows, lanes)
    columns = {
        "points": maps.lower + maps.width * cloud[:, :2],
        "theta": np.clip(pi * cloud[:, 2], 0.0, pi),
        "branch": branch,
        "piece": piece,
        "edge": _no_root_outside(lanes.maps, cloud[:, :2], tracer.filters),
        "residual": residual,
        "status": status,
    }
    boxes = joined(tracer.unresolved)
    traces = []
    for index in range(len(counts)):
        merged = _merged(boxes.select(boxes.index // 3 == index), resolution)
        own = {name: column[trace == index] for name, column in columns.items()}
        unresolved = maps.lower + maps.width * merged
        traces.append(BoundaryTrace(plane, resolution, unresolved=unresolved, **own))
    return traces


def _merged(unresolved: ParameterBox, resolution: float) -> Float64[np.ndarray, "boxes 2 2"]:
    """Return the corners of boxes in the plane, those in one square of the resolution as one."""
    hulls: dict[tuple[int, int], Float64[np.ndarray, "2 2"]] = {}
    for center, half in zip(unresolved.center[:, :2], unresolved.half[:, :2], strict=True):
        square = (int(center[0] // resolution), int(center[1] // resolution))
        low, high = hulls.get(square, (center, center))
        hulls[square] = np.stack([np.minimum(low, center - half), np.maximum(high, center + half)])
    return np.stack(list(hulls.values())) if hulls else np.zeros((0, 2, 2))


def _no_root_outside(
    maps: Monomials, positions: Float64[np.ndarray, "points 2"], filters: Filters | None
) -> Bool[np.ndarray, " points"]:
    edge = np.zeros(len(positions), bool)
    if not len(positions):
        return edge
    alpha, beta, *plant = maps.parameters(positions)
    polynomials = characteristic_polynomial(
        alpha, beta, **by_name(*np.maximum(plant, 0.0)), **as_keywords(filters)
    )
    for chunk in np.array_split(np.arange(len(edge)), 1 + len(edge) // _MATRICES):
        roots = np.linalg.eigvals(companion_matrix(polynomials[chunk]))
        edge[chunk] = np.abs(roots).max(axis=1) <= 1.0 + _ON_CIRCLE
    return edge
