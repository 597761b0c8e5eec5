"""How a region presents itself: four lines of text, and a picture."""

from decimal import ROUND_FLOOR
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxstab.arrays import is_jax
from jaxstab.shown import number_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DIGITS = 5
_MOST_ISLANDS = 2  # that are described


class GainNames(NamedTuple):
    """What stiffness and damping of a plane are called, and their units."""

    stiffness: str = "alpha"
    damping: str = "beta"
    stiffness_unit: str = ""
    damping_unit: str = ""

    def at_largest_stiffness(self, point: Any) -> str:
        """Return the text of a point, the stiffness first and rounded down."""
        return f"{self._stiffness(point, floors=True)} at {self._damping(point)}"

    def at_largest_damping(self, point: Any) -> str:
        """Return the text of a point, the damping first and rounded down."""
        return f"{self._damping(point, floors=True)} at {self._stiffness(point)}"

    def _stiffness(self, point: Any, **way: bool) -> str:
        return f"{self.stiffness} = {_text(point[0], self.stiffness_unit, **way)}"

    def _damping(self, point: Any, **way: bool) -> str:
        return f"{self.damping} = {_text(point[1], self.damping_unit, **way)}"


class ShownRegion:
    """A region that shows itself; the class supplies its components and its extreme points."""

    names = GainNames()

    @property
    def extremes(self) -> tuple[Any, Any]:
        """The points of the largest stiffness and of the largest damping."""
        region: Any = self
        return region.max_alpha, region.max_beta

    def __repr__(self) -> str:
        """Return status, extremes and islands in four lines; limits are rounded down."""
        region: Any = self  # a StableRegion or a WallRegion
        name = type(self).__name__
        if is_jax(region.status) or np.ndim(region.status):
            return f"{name} of arrays that JAX maps over; status {region.status}"
        if not region.components:
            return f"{name}: {region.status.words}"
        largest = region.main or region.components[0]
        islands = [island.extremes[0] for island in region.islands]
        head = f"{name} ({self.names.stiffness}, {self.names.damping}): {region.status.words}"
        is_main = region.main is not None
        return limits_text(head, self.names, largest.extremes, islands, is_reachable=is_main)

    def _repr_html_(self) -> str:
        """Return the picture and the words for a notebook."""
        from jaxstab.pictures.style import html_of

        return html_of(self, self.plot)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the region: the component that holds small gains in blue, islands in purple.

        The former fill the axes (None: those of a new figure); the islands are in a small map
        beside them. ValueError: the region is empty or unresolved, or made of arrays of JAX.

        Example:
            >>> axes = jaxstab.stable_region(gamma=0.0, delta=0.015, delay=1.0).plot()
        """
        from jaxstab.pictures.style import plot_region

        region: Any = self
        return plot_region(region, ax)


def limits_text(
    head: str,
    names: GainNames,
    extremes: tuple[Any, Any],
    islands: list[Any],
    *,
    is_reachable: bool,
) -> str:
    """Return four lines: a head, the two extreme points, and the stiffest point of each island."""
    stiffest, most_damped = extremes
    described = [names.at_largest_stiffness(point) for point in islands]
    if len(islands) > _MOST_ISLANDS:
        described[_MOST_ISLANDS:] = ["..."]
    return "\n".join(
        [
            head + ("" if is_reachable else "; small gains are not stable"),
            f"  stiffest     {names.at_largest_stiffness(stiffest)}",
            f"  most damped  {names.at_largest_damping(most_damped)}",
            f"  islands      {len(islands) or 'none found'}"
            + (f", the stiffest of each: {'; '.join(described)}" if islands else ""),
        ]
    )


def _text(value: float, unit: str, *, floors: bool = False) -> str:
    rounding = {"rounding": ROUND_FLOOR} if floors else {}
    return number_text(float(value), _DIGITS, unit=unit, **rounding)
