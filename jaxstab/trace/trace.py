"""The boundary in any plane of two quantities, complete without seeds.

1. The window times the angles [0, pi] is halved into boxes; those proved free of roots on the
   circle are dropped (``circle.exclude``).
2. From a box that is left, a point of the boundary is solved for and its branch followed both ways
   (``continuation``), until every box left lies at a branch; boxes that do not are halved further.
3. Boxes that can be neither excluded nor explained are returned as unresolved.

So every wall of the window with a root on the unit circle lies within two resolutions of a point
of the trace or of an unresolved box.

Points are solved for by Newton's method in NumPy. Optimistix, whose Newton method solves for the
dominant root under JAX (``point/radius/derivative.py``), would have to be compiled for each plane.
"""

from dataclasses import dataclass, field
from math import pi

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64

from jaxstab.conventions import Status
from jaxstab.model import LoopParameters, characteristic_polynomial, companion_matrix
from jaxstab.numbers import checked_number
from jaxstab.proofs.exclusion import Boxes, Extent, Loops, pave
from jaxstab.region.corners import Branch
from jaxstab.trace.continuation import Corrected, Path, follow, project
from jaxstab.trace.plane import Monomials, Window, corner_ranges, loop_quantities, monomials

Cloud = Float64[np.ndarray, "points 3"]

_COVER = 1.0  # resolutions: a box this near to a traced point is explained by it
_REFINEMENTS = 4  # each to a quarter of the size before
_ON_CIRCLE = 1e-7  # a modulus this little above 1 counts as 1 (corners are double roots)


class TraceStatus(Status):
    """What is known about one point of a trace.

    Example:
        >>> [status.name for status in jaxstab.TraceStatus]
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
    continuation (Keller 1977); exclusion boxes, ``exclude`` of jaxstab/boxes/exclusion.py.

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
        self.unresolved: list[Boxes] = []

    def search(self, branch: Branch, low: float, high: float) -> None:
        """Find all branches of one kind with theta / pi between low and high."""
        center = np.array([[0.5, 0.5, 0.5 * (low + high)]])
        open_ = Boxes(center, np.array([[0.5, 0.5, 0.5 * (high - low)]]))
        smallest = 0.25 * self.resolution
        for _ in range(_REFINEMENTS + 1):
            paving = pave(open_, smallest, self._extent)
            open_ = paving.boxes
            if not paving.finished:
                break
            open_ = open_.select(~self._explained(open_.center))
            open_ = self._followed(branch, open_)
            if not len(open_.center):
                return
            smallest /= 4
        self.unresolved.append(open_)

    def _followed(self, branch: Branch, boxes: Boxes) -> Boxes:
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

    def _extent(self, boxes: Boxes) -> Extent:
        middle, radius, by_axis = corner_ranges(self.scene, boxes.center[:, :2], boxes.half[:, :2])
        theta, turn = pi * boxes.center[:, 2:].T, pi * boxes.half[:, 2:].T
        parts = np.zeros((3, 6, turn.size))
        parts[:2, :5], parts[2, 5] = by_axis, turn
        center, radius = (np.concatenate(part) for part in ((middle, theta), (radius, turn)))
        return Extent(Loops(*center), Loops(*radius), parts)


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


def _merged(unresolved: list[Boxes], resolution: float) -> Float64[np.ndarray, "boxes 2 2"]:
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
