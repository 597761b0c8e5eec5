"""Panels of the plane of alpha and beta, and texts on pictures.

A text takes the first of its places that is inside of the axes and covers no mark, no other text
and, if possible, no line. Positions are known once a figure is laid out, so texts come last.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from jaxstab.drawing import ALPHA_LABEL, BETA_LABEL, Floats, plain

Spot = tuple[float, float]

HALO: list[AbstractPathEffect] = [withStroke(linewidth=2.5, foreground="white")]
"""Around text on a picture."""


def panels(
    rows: int, columns: int, width: float = 1.0, height: float = 1.0
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with panels of the (alpha, beta) plane, row by row."""
    size = (4.2 * columns * width, (3.5 * rows + 0.4) * height)  # inches
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    for panel in grid[-1]:
        panel.set_xlabel(ALPHA_LABEL)
    for panel in grid[:, 0]:
        panel.set_ylabel(BETA_LABEL)
    for panel in grid.flat:
        panel.tick_params(labelsize=9)
        panel.grid(visible=True, color="#dddddd", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    return figure, [list(row) for row in grid]


# Texts: names beside marks, and values on lines of equal values.


class Level(NamedTuple):
    """A line of equal values: its points (n, 2) in the coordinates of the axes, value, colour."""

    points: Floats
    words: str
    colour: str


class _TextPlace(NamedTuple):
    """Where a text may stand: beside a spot, so many points to the right of it and up."""

    spot: Spot
    offset: Spot
    side: Literal["left", "center", "right"]


def write_names(panel: Axes, spots: Mapping[str, Spot], levels: Sequence[Level] = ()) -> None:
    """Write names beside their spots, and values on their lines, on axes that are laid out."""
    lifts = (0, 11, -11, 22, -22, 34, -34, 46, -46, 60, -60, 80, -80)  # points
    beside, most_places = 12, 60
    taken = _marks(panel)
    for name, spot in spots.items():
        if not panel.bbox.contains(*panel.transData.transform(spot)):
            continue
        places = [
            _TextPlace(spot, (x, y), "left" if x > 0 else "right")
            for y, x in product(lifts, (9, -9))
        ]
        box: Any = {"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75}
        look: Any = {"fontsize": 9, "zorder": 6, "bbox": box}
        best = _write(panel, plain(_short(name)), places, taken, look)
        if abs(best.offset[1]) > beside:
            line: Any = {"arrowstyle": "-", "lw": 0.6, "shrinkA": 0, "shrinkB": 5}
            panel.annotate("", spot, best.offset, textcoords="offset points", arrowprops=line)
    for level in levels:
        pixels = panel.transData.transform(level.points)
        points = level.points[[panel.bbox.contains(x, y) for x, y in pixels]]
        points = _farthest_first(panel, points[:: 1 + len(points) // most_places], taken)
        places = [_TextPlace((x, y), (0, 0), "center") for x, y in points]
        look = {"fontsize": 8, "color": level.colour, "path_effects": HALO, "zorder": 4}
        if places:
            _write(panel, plain(level.words), places, taken, look)


def _short(name: str) -> str:
    most, end = 28, 10  # letters
    return name if len(name) <= most else f"{name[: most - end - 1]}…{name[-end:]}"


def _farthest_first(panel: Axes, points: Floats, taken: Sequence[Bbox]) -> Floats:
    """Points on axes, those far from what is taken first."""
    if not taken:
        return points
    pixels = panel.transData.transform(points)
    centres = np.array([(box.x0 + box.x1, box.y0 + box.y1) for box in taken]) / 2.0
    nearest = np.hypot(*(pixels[:, None] - centres).T).min(axis=0)
    ordered: Floats = points[np.argsort(-nearest, kind="stable")]
    return ordered


def _marks(panel: Axes) -> list[Bbox]:
    """The boxes of the marks on axes."""
    found = []
    for line in panel.get_lines():
        if line.get_marker() not in ("None", "|", "_"):
            size = 1.2 * line.get_markersize() * panel.figure.dpi / 72.0  # pixels
            pixels = panel.transData.transform(np.asarray(line.get_xydata()))
            found += [Bbox.from_bounds(x - size / 2, y - size / 2, size, size) for x, y in pixels]
    return found


def _write(
    panel: Axes,
    words: str,
    places: Sequence[_TextPlace],
    taken: list[Bbox],
    look: Mapping[str, Any],
) -> _TextPlace:
    """Write words at the best of some places, which is returned, and add them to what is taken."""
    text = panel.annotate(
        words, places[0].spot, (0, 0), textcoords="offset points", va="center", **look
    )
    drawn = [line for line in panel.get_lines() if line.get_linestyle() != "None"]
    paths = [panel.transData.transform_path(line.get_path()) for line in drawn]

    def cost(place: _TextPlace) -> tuple[bool, int, int]:
        box = _box(text, place)
        is_cut = not (panel.bbox.contains(*box.min) and panel.bbox.contains(*box.max))
        crossed = sum(path.intersects_bbox(box, filled=False) for path in paths)
        return is_cut, box.count_overlaps(taken), crossed

    best = min(places, key=cost)
    taken.append(_box(text, best))
    return best


def _box(text: Annotation, place: _TextPlace) -> Bbox:
    """Move a text to a place; the pixels that it covers there."""
    text.xy, text.xyann = place.spot, place.offset
    text.set_horizontalalignment(place.side)
    return text.get_window_extent()
