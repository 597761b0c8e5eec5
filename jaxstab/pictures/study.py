"""Pictures of studies: the largest stiffness, or the share for which a wall is stable.

Without a list the draws are shown as a distribution. Over one list there is a line, with a band
from the 5th to the 95th percentile of the draws; over two a line for each value of the second one,
or a map if it has many. Walls are a line each, with the band of 95 % confidence.
"""

from itertools import cycle
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstab.conventions import Verdict
from jaxstab.pictures.style import BLUE, plain
from jaxstab.scene.study import SAMPLE, limit_in, lists_of, quantiles, shares, walls_in

if TYPE_CHECKING:
    from xarray import DataArray, Dataset


def study_figure(study: "Dataset") -> Figure:
    """Return the picture of a study; ValueError for one with more than two lists."""
    lists, is_drawn = lists_of(study), SAMPLE in study.dims
    if len(lists) > 2:
        raise ValueError(
            f"the study has {len(lists)} lists ({', '.join(lists)}), and a picture shows two; "
            "choose by study.isel(...)."
        )
    figure = Figure(figsize=(6.0, 4.2), layout="constrained")
    panel = figure.subplots()
    panel.grid(visible=True, lw=0.3)
    limit: Any = limit_in(study)
    if limit is None:
        if len(lists) != 1 or "verdict" not in study:
            raise ValueError(
                "the study has nothing to draw: give limits among answers, or verdict over one "
                "list."
            )
        found: Any = shares(study) if is_drawn else study.verdict == Verdict.STABLE
        bands = [found.low, found.share, found.high] if is_drawn else [found]
        _draw_lines(panel, study, [100.0 * band.transpose(..., walls_in(study)) for band in bands])
        panel.set_ylabel("% of the draws for which the wall is stable\n(band: 95 % confidence)")
        panel.set_ylim(-4.0, 104.0)
        if not is_drawn:
            panel.set_ylabel("verdict")
            panel.set_yticks([0.0, 100.0], ["not proved\nstable", "stable"])
        return figure
    label = _label(study[limit])
    if not lists:
        below = np.linspace(0.0, 1.0, 1001)
        allowed = below if limit.startswith("least") else 1.0 - below
        panel.plot(quantiles(study, limit, at=below.tolist()), 100.0 * allowed, color=BLUE, lw=1.5)
        panel.set_xlabel(label)
        panel.set_ylabel("% of the draws that allow it")
        panel.set_ylim(0.0, 103.0)
        panel.set_title(f"{study.sizes[SAMPLE]:,} draws", fontsize=9)
        return figure
    bands = [*quantiles(study, limit)] if is_drawn else [study[limit]]
    bands = [band.transpose(*lists) for band in bands]
    if len(lists) == 2 and study.sizes[lists[1]] > 6:  # lines in one panel
        _draw_map(
            panel, bands[len(bands) // 2], f"{label}\n(median of the draws)" if is_drawn else label
        )
        return figure
    _draw_lines(panel, study, bands)
    panel.set_ylim(bottom=0.0)
    panel.set_ylabel(f"{label}\n(median; band: 5th to 95th percentile)" if is_drawn else label)
    return figure


def _label(values: "DataArray") -> str:
    long_name, unit = values.attrs["long_name"].partition(";")[0], values.attrs["units"]
    return plain(long_name if unit in ("", "1") else f"{long_name} ({unit})")


def _is_number(values: "DataArray") -> bool:
    return values.dtype.kind in "fi"


def _draw_lines(panel: Axes, study: "Dataset", bands: "list[DataArray]") -> None:
    """Draw the middle one of bands, over a list and perhaps another one, and what lies between."""
    most_letters = 40  # below the axes, of words side by side
    looks = cycle(zip(("-", "--", "-.", ":"), "os^D", strict=True))
    first, *second = (study[name] for name in bands[0].dims)
    panel.set_xlabel(_label(first))
    places: Any = first.values
    if _is_number(first):
        panel.locator_params(axis="x", nbins=7)  # numbers of many digits stand apart
    else:  # words are side by side
        places = np.arange(len(first))
        words = [plain(str(word)) for word in first.values]
        are_long = sum(map(len, words)) > most_letters
        turned: Any = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if are_long else {}
        panel.set_xticks(places, words, **turned)
    lines = np.reshape(bands, (len(bands), len(places), -1))
    count = lines.shape[2]
    colors = [BLUE] if count == 1 else mpl.colormaps["viridis"](np.linspace(0, 0.85, count))
    for k, (color, (line, mark)) in enumerate(zip(colors, looks, strict=False)):
        value = second[0][k].item() if second else ""
        label = plain(f"{value:g}" if isinstance(value, int | float) else f"{value}")
        look: Any = {"ls": line if _is_number(first) else "", "marker": mark, "color": color}
        size = 4 if _is_number(first) else 7
        panel.plot(places, lines[len(bands) // 2, :, k], ms=size, label=label, **look)
        panel.fill_between(places, *lines[[0, -1], :, k], color=color, alpha=0.2, lw=0)
    if second:
        panel.legend(title=_label(second[0]), fontsize=8, title_fontsize=8)


def _draw_map(panel: Axes, values: "DataArray", label: str) -> None:
    x, y = (values[name] for name in values.dims)
    if not (_is_number(x) and _is_number(y)):
        raise ValueError(f"{x.name} and {y.name} are not both numbers; draw fewer words.")
    panel.grid(visible=False)
    mesh = panel.pcolormesh(x, y, values.T, shading="nearest", cmap="viridis")
    if min(values.shape) >= 2 and values.min() < values.max():
        lines = panel.contour(x, y, values.T, levels=3, colors="white", linewidths=0.8)
        panel.clabel(lines, fontsize=7)
    figure: Any = panel.figure
    figure.colorbar(mesh, label=label)
    panel.set_xlabel(_label(x))
    panel.set_ylabel(_label(y))
