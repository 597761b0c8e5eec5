"""The stable set in an (alpha, beta) plane as a value: outline, corners, limits and distances."""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float64, Int

from jaxstab.arrays import Array, Numbers, float_arrays, namespace
from jaxstab.conventions import Status
from jaxstab.drawing import (
    ALPHA_LABEL,
    BETA_LABEL,
    Floats,
    draw_components,
    html_of,
    new_axes,
    raise_powers,
    with_gaps,
)
from jaxstab.model import checked_gain, require_x64
from jaxstab.model.gain import ALPHA_BETA, Gain, limit_text
from jaxstab.numbers import require_together, without_noise
from jaxstab.region import measures
from jaxstab.region.curve import Curve
from jaxstab.region.measures import Outline, loop_ends, polygon_area
from jaxstab.region.pieces import NO_BRANCH
from jaxstab.shown import stable_pair

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Shown = TypeVar("Shown", bound="ShownRegion")

# How a region presents itself: four lines of text, and a picture.

DIGITS = 5


class ShownRegion:
    """A region that shows itself; the class supplies its components and its extreme points."""

    if TYPE_CHECKING:
        names: Any  # tuple[Gain, Gain] of its coordinates
        _printed: Any  # the points of the largest of each, stable as they are printed

        @property
        def _drawn(self) -> Floats:
            """The outline with NaN between two loops."""

        def _write_axes(self, panel: "Axes") -> None:
            """Write what the axes are."""

    @property
    def reachable(self: Shown) -> Shown:
        """The component that contains small gains; the whole region where none does.

        Example:
            >>> len(jaxstab.stable_region(gamma=0.0, delta=0.015, delay=1.0).reachable.components)
            1
        """
        region: Any = self
        main: Shown | None = region.main
        return main or self

    def __repr__(self) -> str:
        """Return status, extremes and islands in four lines; limits are rounded down."""
        region: Any = self
        name = type(self).__name__
        if not region.components:
            return f"{name}: {region.status.words}"
        symbols = ", ".join(gain.symbol or gain.name for gain in self.names)
        return limits_text(
            f"{name} ({symbols}): {region.status.words}",
            self.names,
            (region.main or region.components[0])._printed,
            [island._printed[0] for island in region.islands],
            is_reachable=region.main is not None,
        )

    def _repr_html_(self) -> str:
        return html_of(self, self.plot)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the region: the component that holds small gains in blue, islands in purple.

        The former fill the axes (None: those of a new figure); the islands are in a small map
        beside them. ValueError: the region is empty or unresolved.

        Example:
            >>> axes = jaxstab.stable_region(gamma=0.0, delta=0.015, delay=1.0).plot()
        """
        region: Any = self
        if not region.components:
            raise ValueError(
                f"there is nothing to draw: {self!r}; the region must be COMPLETE and not empty."
            )
        panel = new_axes() if ax is None else ax
        main = None if region.main is None else region.main._drawn
        draw_components(panel, main, [island._drawn for island in region.islands])
        self._write_axes(panel)
        raise_powers([panel])
        return panel


def printed_extremes(region: "StableRegion", digits: int = DIGITS) -> tuple[Any, Any]:
    """The points of the largest alpha and beta of a region, stable as they are printed."""
    (alpha, at_alpha), (beta, largest_beta) = (
        without_noise(gains, float(np.abs(gains).max())).tolist()
        for gains in np.transpose(region.extremes)
    )
    aside = 1e-6 * max(abs(alpha), abs(at_alpha))

    def is_stable(alpha: float, beta: float) -> bool:
        return region.curve.is_stable((alpha or aside, beta))  # an axis may be the edge

    both = digits, digits
    rows, columns = (partial(region._intervals_at, axis=axis) for axis in (1, 0))
    stiffest = stable_pair(alpha, beta, both, is_stable, rows)
    turned = stable_pair(largest_beta, at_alpha, both, lambda b, a: is_stable(a, b), columns)
    return stiffest, turned[::-1]


def limits_text(
    head: str,
    gains: tuple[Gain, Gain],
    points: tuple[Any, Any],
    islands: list[Any],
    *,
    is_reachable: bool,
) -> str:
    """Return four lines: a head, the two extreme points, and the first extreme of each island."""
    most_islands, (first, second), (one, two) = 2, gains, points  # islands that are described
    words = first.word or first.sense, second.word or second.sense
    described = [limit_text(first, own[0], second, own[1], DIGITS) for own in islands]
    if len(islands) > most_islands:
        described[most_islands:] = ["..."]
    found = f", the {words[0]} of each: {'; '.join(described)}" if islands else ""
    rows = [
        (words[0], limit_text(first, one[0], second, one[1], DIGITS)),
        (words[1], limit_text(second, two[1], first, two[0], DIGITS)),
        ("islands", f"{len(islands) or 'none found'}{found}"),
    ]
    width = max(len(word) for word, _ in rows)
    lines = [f"  {word:<{width}}  {text}" for word, text in rows]
    return "\n".join([head + ("" if is_reachable else "; small gains are not stable"), *lines])


# What is known about a stable region.


class RegionStatus(Status):
    """The status of a stable region.

    COMPLETE: the boundary that was found closes to loops; all stable intervals of a row through
    each component are proved to be the region's, and so are those of the line 1e-9 beyond each
    limit of the component with small gains, 1e-9 within which a wall is proved stable. Islands were
    looked for at some hundred angles and on these lines. EMPTY: no stable wall was found, neither
    by a scan (in balls where float64 is not clear) nor on proved lines through the wall without
    gains. UNRESOLVED: the boundary does not close, or a proved line contradicts it. Such a region
    claims nothing: it has no points, its numbers are NaN and ``contains`` is False everywhere,
    which does not mean that the points are unstable.

    Example:
        >>> jaxstab.results.RegionStatus(2).words
        'the boundary was not resolved: nothing is claimed'
    """

    COMPLETE = 0, "the boundary closes to loops"
    EMPTY = 1, "no gains are stable"
    UNRESOLVED = 2, "the boundary was not resolved: nothing is claimed"


# The connected components of a stable set, each bounded by a loop, and by those around its holes.


def components_of(c: Curve, outline: Outline) -> list[Outline]:
    """Return the outlines of the components: first the one with small gains, then by area."""
    parts = [_loop(outline, start, end) for start, end in loop_ends(outline)]
    if len(parts) == 1:
        return parts
    holes = [loop for loop in parts if polygon_area(loop) <= 0.0]
    components = [
        _joined([outer, *(hole for hole in holes if measures.holds(c, outer, hole.vertices[0]))])
        for outer in parts
        if polygon_area(outer) > 0.0
    ]
    return sorted(components, key=lambda x: (not holds_small_gains(c, x), -polygon_area(x)))


def holds_small_gains(c: Curve, outline: Outline) -> bool:
    """True if a set holds positive gains that are small beside its own size."""
    small = 1e-8  # of what a set spans
    ratios = 10.0 ** np.arange(-6.0, 7.0)  # of alpha to beta, in that measure
    extent = np.max(np.abs(outline.vertices[: outline.size]), axis=0)
    alpha = small * extent[0] * np.minimum(ratios, 1.0)
    beta = small * extent[1] * np.minimum(1.0 / ratios, 1.0)
    if np.any(measures.contains(c, outline, alpha, beta)):
        return True
    if not measures.holds(c, outline, (0.0, 0.0)):
        return False
    # Of a set that reaches far, all of these may be beyond the wall without gains that it holds.
    least = 1e-12 * extent  # less is rounding
    return any(c.is_stable(wall) for wall in ((least[0], 0.0), (0.0, least[1]), least))


def _loop(outline: Outline, start: int, end: int) -> Outline:
    vertices = outline.vertices[start : end + 1]
    is_own = np.any(np.all(outline.corners[:, None] == vertices, axis=-1), axis=1)
    return outline._replace(
        vertices=vertices,
        branches=outline.branches[start:end],
        angles=outline.angles[start:end],
        size=end + 1 - start,
        loops=1,
        corners=outline.corners[is_own],
    )


def _joined(loops: list[Outline]) -> Outline:
    """Return loops as one outline, with an edge of no branch between them."""
    gap = np.array([NO_BRANCH]), np.zeros((1, 2))
    branches = [edges for loop in loops for edges in (gap[0], loop.branches)][1:]
    angles = [edges for loop in loops for edges in (gap[1], loop.angles)][1:]
    return loops[0]._replace(
        vertices=np.concatenate([loop.vertices for loop in loops]),
        branches=np.concatenate(branches),
        angles=np.concatenate(angles),
        size=sum(loop.size for loop in loops),
        loops=len(loops),
        corners=np.concatenate([loop.corners for loop in loops]),
    )


@dataclass(frozen=True, repr=False)
class StableRegion(ShownRegion):
    """The gains (alpha, beta) for which all roots of p(z) lie inside a circle about 0.

    ``stable_region`` makes one. Limits, ``contains``, ``distance`` and ``area`` are those of the
    exact boundary, not of the polygon. Gains that are arrays or tracers of JAX give arrays of JAX,
    computed on the host and differentiable once.

    Attributes:
        curve: of the exact boundary.
        outline: the polygon.
        status: a RegionStatus.
        max_alpha: the point (alpha, beta) of the largest alpha, over negative betas as well (the
            limits of a ``HapticLoop`` are of walls with K >= 0 and B >= 0); NaN if there is none.
        max_beta: the same of the largest beta.

    Source: eq. (9) by the D-decomposition, keeping the pieces around the stable set.

    Example:
        >>> region = jaxstab.stable_region(gamma=0.0, delta=0.0, delay=0.0)
        >>> region.is_empty, region.loops, region.corners.round(6).tolist()
        (False, 1, [[0.0, 0.0], [0.0, 2.0]])
        >>> region.rows_are_intervals, region.columns_are_intervals, round(float(region.area), 6)
        (True, True, 0.909645)
        >>> region.extremes[1].round(6).tolist()  # of the largest beta
        [0.0, 2.0]
        >>> len(region.points) - len(region.branch)  # a piece between two points each
        1
        >>> region.alpha_limits([0.5, 3.0]).round(6).tolist()
        [[0.0, 0.6], [nan, nan]]
        >>> region.beta_limits(0.5).round(6).tolist()
        [0.359612, 1.390388]
        >>> region.contains(0.3, [0.1, 0.8]).tolist()
        [False, True]
        >>> region.distance(0.3, [0.1, 0.8]).round(6).tolist()
        [-0.064915, 0.3]
        >>> window = jaxstab.Velocity.difference(samples=20)
        >>> region = jaxstab.stable_region(gamma=0.0, delta=0.0004, delay=1.0, velocity=window)
        >>> [round(float(part.area), 5) for part in region.components]
        [0.00101, 0.00044]
        >>> region.main.max_alpha.round(6).tolist()
        [0.008138, 0.051276]
        >>> [island.max_alpha.round(4).tolist() for island in region.islands]
        [[0.0753, -0.4745]]
    """

    names = ALPHA_BETA

    curve: Curve
    outline: Outline
    status: RegionStatus
    max_alpha: Array
    max_beta: Array

    @property
    def is_empty(self) -> bool:
        """True if no (alpha, beta) is stable."""
        return self.status == RegionStatus.EMPTY

    @property
    def points(self) -> Float64[np.ndarray, "point 2"]:
        """The outline as points (alpha, beta), counter-clockwise, the last one equal to the first.

        Several loops follow one another, each of them closed; the branch between two loops is -1.
        """
        return self.outline.vertices[: self.outline.size] + 0.0  # no -0

    @property
    def branch(self) -> Int[np.ndarray, " piece"]:
        """The Branch of each piece between two points: the root that is on the circle there."""
        return self.outline.branches[: max(self.outline.size - 1, 0)]

    @property
    def _drawn(self) -> Floats:
        """The outline with NaN between two loops."""
        return with_gaps(self.points, self.branch)

    def _write_axes(self, panel: "Axes") -> None:
        panel.set(xlabel=ALPHA_LABEL, ylabel=BETA_LABEL)

    @property
    def corners(self) -> Float64[np.ndarray, "corner 2"]:
        """The points where two branches meet, in the order of the outline, to full precision.

        They are right to a few rounding errors, next to the Nyquist frequency too.
        """
        return self.outline.corners + 0.0

    @cached_property
    def components(self) -> list["StableRegion"]:
        """The connected parts of the region: first the one that holds small gains, then by area.

        Velocity estimators can cut islands off. The list has every component whose boundary the
        search found; ``stable_region`` says what a search may miss.
        """
        if self.outline.size == 0:
            return []
        outlines = components_of(self.curve, self.outline)
        return [region_within(self.curve, outline) for outline in outlines]

    @cached_property
    def main(self) -> "StableRegion | None":
        """The component with small positive gains: the walls that are connected to zero gains.

        None where small positive gains are not stable.
        """
        first = self.components[:1]
        return next((own for own in first if holds_small_gains(own.curve, own.outline)), None)

    @property
    def islands(self) -> list["StableRegion"]:
        """The components that are not connected to zero gains, the largest first."""
        return self.components[self.main is not None :]

    @property
    def loops(self) -> int:
        """The number of closed curves that bound the region."""
        return self.outline.loops

    @property
    def rows_are_intervals(self) -> bool:
        """True if every line of constant beta meets the region in at most one interval of alpha."""
        return self._are_intervals(axis=1)

    @property
    def columns_are_intervals(self) -> bool:
        """True if every line of constant alpha meets the region in one interval of beta at most."""
        return self._are_intervals(axis=0)

    def _are_intervals(self, axis: int) -> bool:
        is_resolved = self.status != RegionStatus.UNRESOLVED
        return is_resolved and self.loops <= 1 and measures.turns(self.points[:, axis]) <= 2

    @property
    def area(self) -> Float64[Array, ""]:
        """The area in the (alpha, beta) plane without its holes; NaN for UNRESOLVED.

        It is right to rounding, except for undamped hands next to the Nyquist frequency, where the
        relative error is up to about 1e-16/e, with e = |sqrt(gamma)/pi - 1|, and next to modes that
        walls hardly move: there it is as right as the polygon, or better.
        """
        return measures.area(self.curve, self.outline)

    @property
    def extremes(self) -> tuple[Array, Array]:
        """The points of the largest alpha and of the largest beta."""
        return self.max_alpha, self.max_beta

    @cached_property
    def _printed(self) -> tuple[Any, Any]:
        return printed_extremes(self)

    def _intervals_at(self, value: float, axis: int) -> np.ndarray:
        ends = measures.interval_ends(self.curve, self.outline, np.array([value]), axis=axis)[0]
        return ends[: ends.size // 2 * 2].reshape(-1, 2)

    def alpha_limits(self, beta: Numbers) -> Float64[Array, "*grid 2"]:
        """Return the smallest and the largest alpha of the region at given betas.

        NaN where no alpha is in the region. Where ``rows_are_intervals`` is False there may be
        unstable alpha between the two. Array (*grid, 2), differentiable. Args and Raises: see
        ``jaxstab.conventions``.
        """
        return self._limits("beta", beta, axis=1)

    def beta_limits(self, alpha: Numbers) -> Float64[Array, "*grid 2"]:
        """Return the smallest and the largest beta of the region at given alphas.

        NaN where no beta is in the region. Where ``columns_are_intervals`` is False there may be
        unstable beta between the two. Else as ``alpha_limits``.
        """
        return self._limits("alpha", alpha, axis=0)

    def _limits(self, name: str, gain: Numbers, axis: int) -> Float64[Array, "*grid 2"]:
        require_x64(gain)
        (values,) = float_arrays(checked_gain(name, gain))
        return measures.limits(self.curve, self.outline, values, axis=axis)

    def contains(self, alpha: Numbers, beta: Numbers) -> Bool[Array, "*grid"]:
        """True where points lie inside the exact boundary; all False for UNRESOLVED.

        Args and Raises: see ``jaxstab.conventions``.
        """
        points = _checked_points(alpha, beta)
        return measures.contains(self.curve, self.outline, *points, is_proved=True)

    def distance(self, alpha: Numbers, beta: Numbers) -> Float64[Array, "*grid"]:
        """Return the Euclidean distance to the boundary, positive inside and negative outside.

        -inf for an empty region, NaN for UNRESOLVED. Args and Raises: see ``jaxstab.conventions``.
        """
        points = _checked_points(alpha, beta)
        return measures.distance(self.curve, self.outline, *points)


def region_within(c: Curve, outline: Outline) -> StableRegion:
    """Return the region of an outline."""
    largest = np.argmax(np.nan_to_num(outline.vertices, nan=-np.inf), axis=0)
    closed = RegionStatus.COMPLETE if outline.size > 0 else RegionStatus.EMPTY
    return StableRegion(
        curve=c,
        outline=outline,
        status=closed if outline.resolved else RegionStatus.UNRESOLVED,
        max_alpha=outline.vertices[largest[0]] + 0.0,  # no -0
        max_beta=outline.vertices[largest[1]] + 0.0,
    )


def _checked_points(alpha: Numbers, beta: Numbers) -> tuple[Array, Array]:
    require_together(alpha=alpha, beta=beta)
    gains = float_arrays(checked_gain("alpha", alpha), checked_gain("beta", beta))
    stiffness, damping = namespace(gains).broadcast_arrays(*gains)
    return stiffness, damping
