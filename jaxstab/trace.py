"""The boundary in any plane of two quantities, complete without seeds.

1. The window times the angles [0, pi] is halved into boxes; those proved free of roots on the
   circle are dropped (``proofs.exclusion``).
2. From a box that is left, a point of the boundary is solved for and its branch followed both ways
   by pseudo-arclength steps, until every box left lies at a branch; others are halved further.
3. Boxes that can be neither excluded nor explained are returned as unresolved.

So every wall of the window with a root on the unit circle lies within two resolutions of a point
of the trace or of an unresolved box.

Points are solved for by Newton's method in NumPy. Optimistix, whose Newton method solves for the
dominant root under JAX (``point/traced_radius.py``), would have to be compiled for each plane.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64

from jaxstab.conventions import AXES, Status
from jaxstab.model import LoopParameters, characteristic_polynomial, companion_matrix
from jaxstab.numbers import checked_number
from jaxstab.proofs.exclusion import Loops, exclude
from jaxstab.proofs.plant import circle_equations, quick_slice
from jaxstab.ranges.box import ParameterBox, Proof, excluded
from jaxstab.region.corners import Branch
from jaxstab.region.curve import SliceCoefficients, slice_coefficients

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
    """The five parameters factor x^i y^j over a window."""

    factor: Float64[np.ndarray, " 5"]
    powers: Float64[np.ndarray, "5 2"]  # -1, 0, 1 or 2
    lower: Float64[np.ndarray, " 2"]
    width: Float64[np.ndarray, " 2"]

    def parameters(
        self, position: Float64[np.ndarray, "*points 2"]
    ) -> Float64[np.ndarray, "5 *points"]:
        """Return the parameters at positions (..., 2) in the window's unit square: (5, ...)."""
        x, y = np.moveaxis(self.lower + self.width * position, -1, 0)
        table = np.column_stack([self.factor, self.powers]).T
        factor, of_x, of_y = table.reshape(3, -1, *[1] * x.ndim)
        return np.asarray(factor * x**of_x * y**of_y)


def monomials(plane: tuple[str, str], window: Window, fixed: Mapping[str, float]) -> Monomials:
    """Return the map from a plane to the parameters.

    Raises:
        ValueError: unknown, missing or doubled names, values outside their range, an empty window.
    """
    _check_names(plane, fixed)
    table = _table(plane)
    for name, value in fixed.items():
        _check_value(name, value)
    for name, (lower, upper) in zip(plane, window, strict=True):
        _check_value(name, lower)
        _check_value(name, upper)
        if not lower < upper:
            raise ValueError(
                f"the window of {name} is ({lower}, {upper}); give a lower and a larger upper end."
            )
    powers = np.array([[table[name].get(axis, 0) for name in plane] for axis in AXES], np.float64)
    factor = np.array(
        [
            np.prod([value ** table[name].get(axis, 0) for name, value in fixed.items()])
            * any(axis in table[name] for name in (*plane, *fixed) if name not in POSITIVE)
            for axis in AXES
        ]
    )
    lower, upper = np.array(window, np.float64).T
    return Monomials(factor, powers, lower, upper - lower)


def _table(plane: tuple[str, str]) -> dict[str, dict[str, int]]:
    return DIMENSIONLESS if set(plane) <= set(DIMENSIONLESS) else PHYSICAL


def loop_quantities(loop: LoopParameters) -> dict[str, float]:
    """Return the physical quantities of a loop under the names used here."""
    return {
        "mass": loop.mass,
        "sample_time": loop.sample_time,
        "physical_stiffness": loop.hand_stiffness,
        "physical_damping": loop.device_damping + loop.hand_damping,
        "time_delay": loop.delay,
    }


def _check_names(plane: tuple[str, str], fixed: Mapping[str, float]) -> None:
    names = [*plane, *fixed]
    table = _table(plane)
    unknown = [name for name in names if name not in DIMENSIONLESS and name not in PHYSICAL]
    unknown += [name for name in names if name not in table]
    if unknown:
        raise ValueError(
            f"{unknown[0]!r} is no quantity of this plane; give names all of "
            f"{', '.join(DIMENSIONLESS)}, or all of {', '.join(PHYSICAL)}."
        )
    doubled = [name for name in names if names.count(name) > 1]
    if doubled:
        raise ValueError(f"{doubled[0]} is given twice; an axis of the plane has no fixed value.")
    missing = [name for name in table if name not in names]
    if missing:
        raise ValueError(f"{missing[0]} has no value; fix every quantity beside the two axes.")


def _check_value(name: str, value: float) -> None:
    least = -inf if name in SIGNED else 0.0
    checked_number(name, value, least, is_open=name in POSITIVE)


def corner_ranges(
    plane: Monomials, center: Float64[np.ndarray, "boxes 2"], half: Float64[np.ndarray, "boxes 2"]
) -> tuple[
    Float64[np.ndarray, "5 boxes"], Float64[np.ndarray, "5 boxes"], Float64[np.ndarray, "2 5 boxes"]
]:
    """Return the parameters at the centers of boxes, radii that cover them, and those by axis."""

    def parameters(x_side: int, y_side: int) -> Float64[np.ndarray, "5 boxes"]:
        values: Float64[np.ndarray, "5 boxes"]
        values = plane.parameters(center + half * np.array([x_side, y_side]))
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


Cloud = Float64[np.ndarray, "points 3"]

_COVER = 1.0  # resolutions: a box this near to a traced point is explained by it
_REFINEMENTS = 4  # each to a quarter of the size before
_MOST_BOXES = 60_000  # at once
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


def trace_boundary(
    plane: tuple[str, str],
    window: Window,
    *,
    loop: LoopParameters | None = None,
    resolution: int | float = 1 / 64,
    **fixed: float,
) -> BoundaryTrace:
    """Trace where a root lies on the unit circle, in a plane of two quantities.

    Args:
        plane: names of the two axes, either both dimensionless (alpha, beta, gamma, delta, delay)
            or both physical, in SI units: stiffness K, damping B, mass m, sample_time T,
            physical_stiffness k, physical_damping b, time_delay t_d (Table I).
        window: lower and upper end of each axis.
        loop: gives the physical quantities beside K and B that are neither axes nor fixed.
        resolution: largest step along a branch and size of the smallest boxes, as a part of the
            window (and of pi for theta), in [1e-3, 0.25].
        **fixed: a value for each other quantity of the same kind.

    Returns:
        BoundaryTrace. In theory a closed branch smaller than three resolutions may be missed where
        it lies next to another branch.

    Raises:
        ValueError: a name is unknown, missing or doubled, a value outside its range, a window
            empty, the resolution out of range.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle; pseudo-arclength
    continuation (Keller 1977); exclusion boxes, ``exclude`` of jaxstab/proofs/exclusion.py.

    Example:
        >>> window = (0.0, 0.2), (0.0, 0.8)
        >>> hand = {"gamma": 0.0, "delta": 0.0, "delay": 1.0}
        >>> trace = jaxstab.trace_boundary(("alpha", "beta"), window, **hand)
        >>> round(float(trace.points[trace.edge, 0].max()), 3)
        0.144
    """
    resolution = checked_number("resolution", resolution, 1e-3, 0.25, unit="of the window")
    if loop is not None:
        fixed = {
            name: value for name, value in loop_quantities(loop).items() if name not in plane
        } | fixed
    scene = monomials(plane, window, fixed)
    tracer = _Tracer(scene, resolution)
    for branch, low, high in ((Branch.Z_PLUS_ONE, 0.0, 0.0), (Branch.Z_MINUS_ONE, 1.0, 1.0)):
        tracer.search(branch, low, high)
    tracer.search(Branch.CURVE, 0.0, 1.0)
    return _gathered(plane, scene, tracer)


class _Tracer:
    """The branches found so far, and the boxes that none of them explains."""

    def __init__(self, scene: Monomials, resolution: float) -> None:
        self.scene = scene
        self.resolution = resolution
        self.paths: list[tuple[Branch, Path]] = []
        self.unresolved: list[ParameterBox] = []

    def search(self, branch: Branch, low: float, high: float) -> None:
        """Find all branches of one kind with theta / pi between low and high."""
        angle = 0.5 * (low + high), 0.5 * (high - low)
        open_ = ParameterBox.of(np.zeros(1, int), u=(0.5, 0.5), v=(0.5, 0.5), angle=angle)
        smallest = 0.25 * self.resolution
        for _ in range(_REFINEMENTS + 1):
            paving = open_.paved(self._proof, smallest, most=_MOST_BOXES)
            open_ = paving.boxes
            if not paving.finished:
                break
            open_ = open_.select(~self._explained(open_.center))
            open_ = self._followed(branch, open_)
            if not len(open_.center):
                return
            smallest /= 4
        self.unresolved.append(open_)

    def _followed(self, branch: Branch, boxes: ParameterBox) -> ParameterBox:
        """Follow the branches that start in boxes; return the boxes that none explains."""
        if not len(boxes.center):
            return boxes
        bound = _COVER * self.resolution
        starts = project(boxes.center, self.scene, branch)
        inside = np.all((starts.position >= 0.0) & (starts.position <= 1.0), axis=1)
        is_open = starts.converged & inside & ~self._explained(starts.position)
        for number in range(len(is_open)):
            start = Corrected(*(column[number : number + 1] for column in starts))
            away = boxes.center - start.position
            if is_open[number] and np.any(np.linalg.norm(away, axis=1) < bound):
                path = follow(start, self.scene, branch, self.resolution)
                self.paths.append((branch, path))
                is_open &= ~self._explained(starts.position)
        return boxes.select(~self._explained(boxes.center))

    def _explained(self, centers: Cloud) -> Bool[np.ndarray, " points"]:
        explained = np.zeros(len(centers), bool)
        for _, path in self.paths:
            for chunk in np.array_split(path.points, 1 + len(path.points) // 256):
                rest = np.flatnonzero(~explained)
                away = np.linalg.norm(centers[rest, None] - chunk, axis=-1).min(axis=1)
                explained[rest] = away < _COVER * self.resolution
        return explained

    def _proof(self, boxes: ParameterBox) -> Proof:
        middle, radius, by_axis = corner_ranges(self.scene, boxes.center[:, :2], boxes.half[:, :2])
        theta, turn = pi * boxes.center[:, 2:].T, pi * boxes.half[:, 2:].T
        parts = np.zeros((3, 6, turn.size))
        parts[:2, :5], parts[2, 5] = by_axis, turn
        center, radius = (np.concatenate(part) for part in ((middle, theta), (radius, turn)))
        return excluded(exclude, Loops(*center), parts, Loops(*radius))


def _gathered(plane: tuple[str, str], scene: Monomials, tracer: _Tracer) -> BoundaryTrace:
    lower, width = scene.lower, scene.width
    cubes = [path.points for _, path in tracer.paths]
    cloud = np.concatenate([np.zeros((0, 3)), *cubes])
    sizes = [len(points) for points in cubes]
    status = np.full(len(cloud), TraceStatus.CONVERGED, np.int8)
    ends = np.cumsum([0, *sizes])
    for (_, path), first, beyond in zip(tracer.paths, ends[:-1], ends[1:], strict=True):
        if path.stalled[0]:
            status[first] = TraceStatus.STALLED
        if path.stalled[1]:
            status[beyond - 1] = TraceStatus.STALLED
    return BoundaryTrace(
        plane=plane,
        resolution=tracer.resolution,
        points=lower + width * cloud[:, :2],
        theta=np.clip(pi * cloud[:, 2], 0.0, pi),
        branch=np.repeat(np.array([b for b, _ in tracer.paths], np.int8), sizes),
        piece=np.repeat(np.arange(len(sizes)), sizes),
        edge=_no_root_outside(scene, cloud[:, :2]),
        residual=np.concatenate([np.zeros(0), *(path.residual for _, path in tracer.paths)]),
        status=status,
        unresolved=lower + width * _merged(tracer.unresolved, tracer.resolution),
    )


def _merged(unresolved: list[ParameterBox], resolution: float) -> Float64[np.ndarray, "boxes 2 2"]:
    """Return the corners of boxes in the plane, those in one square of the resolution as one."""
    hulls: dict[tuple[int, int], Float64[np.ndarray, "2 2"]] = {}
    for boxes in unresolved:
        for center, half in zip(boxes.center[:, :2], boxes.half[:, :2], strict=True):
            square = (int(center[0] // resolution), int(center[1] // resolution))
            low, high = hulls.get(square, (center, center))
            hulls[square] = np.stack(
                [np.minimum(low, center - half), np.maximum(high, center + half)]
            )
    return np.stack(list(hulls.values())) if hulls else np.zeros((0, 2, 2))


def _no_root_outside(
    scene: Monomials, positions: Float64[np.ndarray, "points 2"]
) -> Bool[np.ndarray, " points"]:
    if not len(positions):
        return np.zeros(0, bool)
    alpha, beta, *plant = scene.parameters(positions)
    gamma, delta, delay = (np.maximum(values, 0.0) for values in plant)
    polynomials = characteristic_polynomial(alpha, beta, gamma=gamma, delta=delta, delay=delay)
    roots = np.linalg.eigvals(companion_matrix(polynomials))
    edge: Bool[np.ndarray, " points"] = np.abs(roots).max(axis=1) <= 1.0 + _ON_CIRCLE
    return edge
