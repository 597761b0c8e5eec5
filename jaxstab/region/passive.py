"""The region of passive walls: a convex set, as a polygon of which every point is proved.

The condition of each angle is convex in (K, B) and grows in proportion to the damper (lemma C6), so
the boundary in a direction is where the largest need over all angles is the damper. Needs are
float64: the largest of some angles, each refined by golden sections. Vertices are added until the
region bulges nowhere beyond its chords by more than a tolerance, and each is moved towards no gains
until it is proved; so is all that lies between them.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Numbers
from jaxstab.exact.passive import Wall
from jaxstab.model.plant import wall_grid

Points = Float64[np.ndarray, "points 2"]

_LEAST = 1e-9  # of the damper: what a wall needs, so that directions without a need have an end


@dataclass(frozen=True)
class PassiveRegion:
    """The passive walls of a damper, a delay and filters: a convex part of the plane of gains.

    ``outline`` holds the vertices, shape (n, 2), counterclockwise, the first one not repeated, in
    N/m and N s/m, of ``jaxstab.paper.passive_region`` in alpha and beta; there are none without a
    damper. Every point of the polygon is proved passive (vertices within 1e-12 of their size); the
    region extends at most about ``tolerance`` of its size beyond it.

    Example:
        >>> region = jaxstab.paper.passive_region(delta=1.0)
        >>> region.stiffest.round(9).tolist(), region.contains([1.0, 2.5], 0.1).tolist()
        ([2.0, 0.0], [True, False])
    """

    tolerance: float
    outline: Points = field(repr=False)
    wall: Wall = field(repr=False)

    @property
    def stiffest(self) -> Float64[np.ndarray, " 2"]:
        """The vertex of the largest stiffness; (0, 0) for an empty region."""
        if not len(self.outline):
            return np.zeros(2)
        vertex: Float64[np.ndarray, " 2"] = self.outline[np.argmax(self.outline[:, 0])]
        return vertex

    def contains(self, stiffness: Numbers, damping: Numbers) -> Bool[np.ndarray, "*grid"]:
        """True where a wall is proved passive; each is tested anew."""
        grid = wall_grid(stiffness=stiffness, damping=damping)
        walls = grid.reshape(-1, 2)
        inside = (walls[:, 0] >= 0.0) & (self.wall.damper > 0.0)
        # Some angle refutes most walls, and the polygon holds most others, for the set is convex.
        inside[inside] = _most_needed(self.wall, walls[inside]) <= self.wall.damper * (1.0 + 1e-9)
        index = np.flatnonzero(inside)
        for number in index[~self._holds(walls[index])].tolist():
            inside[number] = bool(self.wall.is_passive(*walls[number].tolist()))
        return inside.reshape(grid.shape[:-1])

    def _holds(self, walls: Points) -> Bool[np.ndarray, " points"]:
        """True well within the outline."""
        holds = np.full(len(walls), len(self.outline) > 0)
        for start, end in zip(self.outline, np.roll(self.outline, -1, axis=0), strict=True):
            edge, away = end - start, walls - start
            products = edge * away[:, ::-1] * [1.0, -1.0]
            holds &= np.sum(products, axis=1) > 1e-14 * np.sum(np.abs(products), axis=1)
        return holds


def passive_region_of(wall: Wall, tolerance: float) -> PassiveRegion:
    """The passive region of a wall's filters, delay and damper."""
    if wall.damper == 0.0:
        return PassiveRegion(tolerance, np.zeros((0, 2)), wall)
    # In units of damping, the ends of an edge, and beyond it.
    first = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    units = np.array([1.0 / wall.period, 1.0])
    points = _boundary_points(wall, first, units)
    is_open = np.ones(len(points) - 1, bool)
    while is_open.any():
        chords = np.flatnonzero(is_open)
        start, end = points[chords], points[chords + 1]
        # Over the middle of a chord a convex arc is at least half as high as anywhere.
        between = _boundary_points(wall, 0.5 * (start + end), units)
        chord, away = end - start, between - start
        across = np.abs(chord[:, 0] * away[:, 1] - chord[:, 1] * away[:, 0])
        bulges = across > 0.5 * tolerance * np.hypot(*chord.T)
        is_open[chords] = bulges
        indices = chords[bulges] + 1
        points = np.insert(points, indices, between[bulges], axis=0)
        is_open = np.insert(is_open, indices, True)
    outline = [_pulled_in(wall, corner) for corner in (wall.damper * points * units).tolist()]
    return PassiveRegion(tolerance, np.array(outline), wall)


def _boundary_points(wall: Wall, directions: Points, units: Any) -> Points:
    """The boundary points of the region of a damper of 1 in these directions from the origin."""
    sections = 45  # of the interval of a largest value, by the golden ratio
    close = 0.05  # of the range of needs: how much two next angles may miss of one between them
    angles, walls = wall.angles, (directions * units).T

    def needed(gains: Any, theta: np.ndarray) -> np.ndarray:
        return wall.needed(gains, wall.parts(theta))

    seen = needed(walls[:, :, None], angles)
    beside = np.pad(seen, ((0, 0), (1, 1)), constant_values=-np.inf)
    highest, lowest = np.max(seen, axis=1, keepdims=True), np.min(seen, axis=1, keepdims=True)
    is_high = seen >= highest - close * (highest - lowest)
    owner, at = np.nonzero(is_high & (seen >= beside[:, :-2]) & (seen >= beside[:, 2:]))
    low, high = angles[np.maximum(at - 1, 0)], angles[np.minimum(at + 1, len(angles) - 1)]
    own = walls[:, owner]
    for _ in range(sections):
        share = 0.381966 * (high - low)
        is_left = needed(own, low + share) > needed(own, high - share)
        low, high = np.where(is_left, low, low + share), np.where(is_left, high - share, high)
    need = np.maximum(highest[:, 0], _LEAST)
    np.maximum.at(need, owner, needed(own, 0.5 * (low + high)))
    points: Points = directions / need[:, None]
    return points


def _pulled_in(wall: Wall, corner: list[float]) -> list[float]:
    """A wall that is proved passive, next to one of the boundary, towards no gains."""
    share = 1e-12
    while True:
        stiffness, damping = (gain * (1.0 - min(share, 1.0)) for gain in corner)
        if wall.is_passive(stiffness, damping):
            return [stiffness, damping]
        share *= 16.0


def _most_needed(wall: Wall, walls: Points) -> Float64[np.ndarray, " points"]:
    """The largest damping that walls need at some angles."""
    at_once = 1 << 18  # needs that are held in memory
    parts = wall.parts(wall.angles)
    pieces = np.array_split(walls, 1 + len(walls) * wall.angles.size // at_once)
    return np.concatenate(
        [np.max(wall.needed(piece.T[:, :, None], parts), axis=1) for piece in pieces]
    )
