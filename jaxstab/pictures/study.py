"""Pictures of studies: the largest stiffness, or the share for which a wall is stable.

Without a grid the draws are shown as a distribution. Along one key a line, with a band from 5 to
95 % of the draws; along two a line for each value of the second one, or a map if it has many.
"""

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstab.conventions import Verdict
from jaxstab.pictures.style import BLACK, BLUE, GREEN, ORANGE, plain
from jaxstab.scene.study import SAMPLE, WALL, lists_of, quantiles, shares

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

_SIZE = (6.0, 4.2)  # inches
_FEW = 6  # lines in one panel
_BAND = (0.05, 0.5, 0.95)
_POINTS = 1001  # of a distribution


def study_figure(study: "Dataset") -> Figure:
    """Return the picture of a study; ValueError for one with more than two lists."""
    lists = lists_of(study)
    if len(lists) > 2:
        raise ValueError(
            f"the study has {len(lists)} lists ({', '.join(lists)}), and a picture shows two; "
            "choose by study.isel(...)."
        )
    figure = Figure(figsize=_SIZE, layout="constrained")
    panel = figure.subplots()
    panel.grid(visible=True, lw=0.3)
    if "largest_stiffness" not in study:
        _draw_shares(panel, study, lists)
    elif not lists:
        _draw_distribution(panel, study)
    elif SAMPLE in study.dims:
        _draw_over(panel, study, quantiles(study, at=_BAND).transpose("quantile", *lists))
    else:
        _draw_over(panel, study, study.largest_stiffness.expand_dims("quantile"))
    return figure


def _label(values: "DataArray") -> str:
    long_name, unit = values.attrs["long_name"], values.attrs["units"]
    return plain(long_name if unit == "1" else f"{long_name} in {unit}")


def _is_number(values: "DataArray") -> bool:
    return values.dtype.kind in "fi"


def _draw_distribution(panel: Axes, study: "Dataset") -> None:
    """Draw the share of the draws that allow a stiffness."""
    below = np.linspace(0.0, 1.0, _POINTS)
    panel.plot(quantiles(study, at=below.tolist()), 100.0 * (1.0 - below), color=BLUE, lw=1.5)
    panel.set_xlabel(_label(study.largest_stiffness))
    panel.set_ylabel("% of the draws that allow it, at some damping")
    panel.set_ylim(0.0, 103.0)
    panel.set_title(f"{study.sizes[SAMPLE]:,} draws", fontsize=9)


def _draw_over(panel: Axes, study: "Dataset", bands: "DataArray") -> None:
    """Draw values over one or two lists: (quantile, *lists), with one quantile or three."""
    _, first, *second = map(str, bands.dims)
    label, middle = _label(study.largest_stiffness), bands[len(bands) // 2]
    if len(bands) > 1:
        label = f"{label}\n(half of the draws; band: 5 to 95 %)"
    if second and middle.shape[1] > _FEW:
        _draw_map(panel, study, middle, label.replace("; band: 5 to 95 %", ""))
        return
    places = _places_along(panel, study[first])
    lines = np.asarray(bands).reshape(len(bands), len(places), -1)
    count = lines.shape[2]
    colors = [BLUE] if count == 1 else mpl.colormaps["viridis"](np.linspace(0, 0.85, count))
    for k, color in enumerate(colors):
        words = _value_text(study[second[0]][k]) if second else None
        line = lines[len(bands) // 2, :, k]
        panel.plot(places, line, "o-", ms=3, color=color, label=words)
        if len(bands) > 1:
            panel.fill_between(places, *lines[[0, -1], :, k], color=color, alpha=0.2, lw=0)
    if count > 1:
        panel.legend(title=_label(study[second[0]]), fontsize=8, title_fontsize=8)
    panel.set_ylim(bottom=0.0)
    panel.set_ylabel(label)


def _places_along(panel: Axes, values: "DataArray") -> Any:
    """Label the axis of a list; return where its values are: words are side by side."""
    panel.set_xlabel(_label(values))
    if _is_number(values):
        return values.values
    panel.set_xticks(range(len(values)), [plain(str(word)) for word in values.values])
    return np.arange(len(values))


def _value_text(value: "DataArray") -> str:
    if not _is_number(value):
        return plain(str(value.item()))
    unit = value.attrs["units"]
    return f"{value:g}" if unit == "1" else f"{value:g} {unit}"


def _draw_map(panel: Axes, study: "Dataset", values: "DataArray", label: str) -> None:
    x, y = (study[name] for name in values.dims)
    if not (_is_number(x) and _is_number(y)):
        raise ValueError(f"{x.name} and {y.name} are not both numbers; draw fewer words.")
    mesh = panel.pcolormesh(x, y, values.T, shading="nearest", cmap="viridis")
    if min(values.shape) >= 2 and values.min() < values.max():
        lines = panel.contour(x, y, values.T, levels=3, colors="white", linewidths=0.8)
        panel.clabel(lines, fontsize=7)
    figure: Any = panel.figure
    figure.colorbar(mesh, label=label)
    panel.set_xlabel(_label(x))
    panel.set_ylabel(_label(y))


def _draw_shares(panel: Axes, study: "Dataset", lists: list[str]) -> None:
    """Draw the share of the draws for which each wall is stable, with its confidence interval."""
    if len(lists) != 1 or "verdict" not in study:
        raise ValueError(
            "the study has nothing to draw: give limits among answers, or verdict over one list."
        )
    if SAMPLE in study.dims:
        found = shares(study)
        middle, low, high = found.share, found.low, found.high
    else:
        middle = low = high = study.verdict == Verdict.STABLE
    places = _places_along(panel, study[lists[0]])
    for k, name in enumerate(study[WALL].values):
        color, at = (BLUE, ORANGE, GREEN, BLACK)[k % 4], {WALL: k}
        panel.plot(places, 100.0 * middle[at], "o-", ms=3, color=color, label=plain(str(name)))
        panel.fill_between(places, 100.0 * low[at], 100.0 * high[at], color=color, alpha=0.2, lw=0)
    panel.set_ylabel("% of the draws for which the wall is stable\n(band: 95 % confidence)")
    panel.set_ylim(-2.0, 103.0)
    panel.legend(fontsize=8)
