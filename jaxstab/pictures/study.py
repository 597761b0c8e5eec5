"""Pictures of studies: the largest stiffness, or the share for which a wall is stable.

Without a grid the draws are shown as a distribution. Along one key a line, with a band from 5 to
95 % of the draws; along two a line for each value of the second one, or a map if it has many.
"""

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from jaxstab.conventions import Verdict
from jaxstab.pictures.style import BLACK, BLUE, GREEN, ORANGE, plain

if TYPE_CHECKING:
    from jaxstab.scene.study import Study

Floats = NDArray[np.float64]

_SIZE = (6.0, 4.2)  # inches
_FEW = 6  # lines in one panel
_BAND = (0.05, 0.5, 0.95)
_POINTS = 1001  # of a distribution


def study_figure(made: "Study") -> Figure:
    """Return the picture of a study; ValueError for one with more than two lists, or of parts."""
    grid = made.lists
    if len(grid) > 2:
        raise ValueError(
            f"the study has {len(grid)} lists ({', '.join(grid)}), and a picture shows two; open "
            "the file with xarray to choose."
        )
    figure = Figure(figsize=_SIZE, layout="constrained")
    panel = figure.subplots()
    is_drawn = "sample" in made.dimensions
    if "largest_stiffness" not in made.units:
        _draw_shares(panel, made, grid)
    elif not grid:
        _draw_distribution(panel, made)
    elif is_drawn:
        _draw_over(panel, made, grid, made.quantiles(at=_BAND))
    else:
        _draw_over(panel, made, grid, made.values("largest_stiffness")[None])
    return figure


def _label(made: "Study", name: str) -> str:
    long_name, unit = made.long_names[name], made.units[name]
    return plain(long_name if unit == "1" else f"{long_name} in {unit}")


def _draw_distribution(panel: Axes, made: "Study") -> None:
    """Draw the share of the draws that allow a stiffness."""
    below = np.linspace(0.0, 1.0, _POINTS)
    panel.plot(made.quantiles(at=below.tolist()), 100.0 * (1.0 - below), color=BLUE, lw=1.5)
    panel.set_xlabel(_label(made, "largest_stiffness"))
    panel.set_ylabel("% of the draws that allow it, at some damping")
    panel.set_ylim(0.0, 103.0)
    panel.set_title(f"{len(made.dimensions['sample']):,} draws", fontsize=9)
    panel.grid(visible=True, lw=0.3)


def _draw_over(panel: Axes, made: "Study", grid: list[str], values: Floats) -> None:
    """Draw values over one or two lists: (quantile or one, *grid)."""
    middle = values[len(values) // 2]
    label = _label(made, "largest_stiffness")
    if len(values) > 1:
        label = f"{label}\n(half of the draws; band: 5 to 95 %)"
    if len(grid) == 2 and middle.shape[1] > _FEW:
        _draw_map(panel, made, grid, middle, label.replace("; band: 5 to 95 %", ""))
        return
    bands = values.reshape(len(values), middle.shape[0], -1)
    _draw_lines(panel, made, grid, bands)
    panel.set_ylabel(label)


def _draw_lines(panel: Axes, made: "Study", grid: list[str], bands: Floats) -> None:
    """Draw a line for each value of the second list, with its band: (quantile, first, second)."""
    places = _places_along(panel, made, grid[0])
    others = made.dimensions[grid[1]] if len(grid) == 2 else [None]
    colors = (
        [BLUE] if len(others) == 1 else mpl.colormaps["viridis"](np.linspace(0, 0.85, len(others)))
    )
    for k, (value, color) in enumerate(zip(others, colors, strict=True)):
        low, high = bands[0, :, k], bands[-1, :, k]
        words = None if value is None else _value_text(made, grid[1], value)
        panel.plot(places, bands[len(bands) // 2, :, k], "o-", ms=3, color=color, label=words)
        if len(bands) > 1:
            panel.fill_between(places, low, high, color=color, alpha=0.2, lw=0)
    if len(others) > 1:
        panel.legend(title=_label(made, grid[1]), fontsize=8, title_fontsize=8)
    panel.set_ylim(bottom=0.0)


def _places_along(panel: Axes, made: "Study", name: str) -> Any:
    """Label the axis of a list; return where its values are: words are side by side."""
    along = made.dimensions[name]
    panel.set_xlabel(_label(made, name))
    panel.grid(visible=True, lw=0.3)
    if along.dtype.kind in "fi":
        return along
    panel.set_xticks(range(len(along)), [plain(str(word)) for word in along])
    return np.arange(len(along))


def _value_text(made: "Study", name: str, value: Any) -> str:
    if made.dimensions[name].dtype.kind not in "fi":
        return plain(str(value))
    unit = made.units[name]
    return f"{value:g}" if unit == "1" else f"{value:g} {unit}"


def _draw_map(panel: Axes, made: "Study", grid: list[str], values: Floats, label: str) -> None:
    x, y = (made.dimensions[name] for name in grid)
    if x.dtype.kind not in "fi" or y.dtype.kind not in "fi":
        raise ValueError(f"{grid[0]} and {grid[1]} are not both numbers; draw fewer words.")
    mesh = panel.pcolormesh(x, y, values.T, shading="nearest", cmap="viridis")
    if min(values.shape) >= 2 and np.nanmin(values) < np.nanmax(values):
        lines = panel.contour(x, y, values.T, levels=3, colors="white", linewidths=0.8)
        panel.clabel(lines, fontsize=7)
    figure: Any = panel.figure
    figure.colorbar(mesh, label=label)
    panel.set_xlabel(_label(made, grid[0]))
    panel.set_ylabel(_label(made, grid[1]))


def _draw_shares(panel: Axes, made: "Study", grid: list[str]) -> None:
    """Draw the share of the draws for which each wall is stable, with its confidence interval."""
    if len(grid) != 1 or "verdict" not in made.units:
        raise ValueError(
            "the study has nothing to draw: give limits among answers, or verdict over one list."
        )
    if "sample" in made.dimensions:
        shares = made.shares()
        middle, low, high = shares.share, shares.low, shares.high
    else:
        middle = low = high = (made.values("verdict") == Verdict.STABLE).astype(np.float64)
    places = _places_along(panel, made, grid[0])
    for k, name in enumerate(made.dimensions["wall"].tolist()):
        color = (BLUE, ORANGE, GREEN, BLACK)[k % 4]
        panel.plot(places, 100.0 * middle[:, k], "o-", ms=3, color=color, label=plain(name))
        panel.fill_between(
            places, 100.0 * low[:, k], 100.0 * high[:, k], color=color, alpha=0.2, lw=0
        )
    panel.set_ylabel("% of the draws for which the wall is stable\n(band: 95 % confidence)")
    panel.set_ylim(-2.0, 103.0)
    panel.legend(fontsize=8)
