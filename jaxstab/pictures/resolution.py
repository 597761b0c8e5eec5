"""A picture of resolutions of one range: what each gives, and what it takes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from jaxstab.atlas import Resolution, ResolutionPlan
from jaxstab.pictures.style import BLACK, BLUE, GREEN, ORANGE

_SIZE = 10.0, 4.2  # inches
_ERRORS = {
    "limit_error": ("limits of alpha, 95 % of them", BLUE, "o"),
    "undecided": ("undecided share", ORANGE, "s"),
    "radius_error": ("spectral radius, half of them", GREEN, "^"),
}
_FEW_TICKS = 1.0, 0.3  # decades: numbers between powers of ten for narrower axes, and all
_MEGABYTES = 1e-6
_NANOSECONDS = 1e9


def resolution_figure(plan: ResolutionPlan) -> Figure:
    """Draw errors, build time and query time of resolutions over the size of their files.

    Bars are two standard errors of a sample either way. The resolution that meets the wish has a
    ring; the one that was given is hollow, and apart from the line of the others.
    """
    figure = Figure(figsize=_SIZE)
    figure.set_layout_engine("constrained")
    figure.suptitle(f"Resolutions of one range; the ring meets {plan.wish}")
    errors, build, query = figure.subplots(1, 3, width_ratios=(2, 1, 1))
    for name, (label, colour, marker) in _ERRORS.items():
        values = {id(row): getattr(row, name) for row in plan.rows}
        known = [row for row in plan.rows if 0.0 < values[id(row)].value < np.inf]
        heights = [values[id(row)].value for row in known]
        bars = [min(2.0 * values[id(row)].spread, 0.9 * values[id(row)].value) for row in known]
        _draw(errors, plan, known, heights, colour, marker, bars, label)
    _draw(build, plan, list(plan.rows), [row.seconds for row in plan.rows], BLACK, "D")
    timed = [row for row in plan.rows if np.isfinite(row.query_seconds)]
    nanoseconds = [row.query_seconds * _NANOSECONDS for row in timed]
    _draw(query, plan, timed, nanoseconds, BLACK, "D")
    build.plot([], [], "D", color=BLACK, markerfacecolor="white", label="as given")
    build.legend(fontsize=8)
    errors.legend(fontsize=8)
    for panel, title, scale in (
        (errors, "proved errors", "log"),
        (build, "build (CPU s)", "log"),
        (query, "a verdict, of many (ns)", "linear"),
    ):
        panel.set(xscale="log", yscale=scale, xlabel="file (MB)", title=title)
        panel.xaxis.set_major_formatter(LogFormatter())
        panel.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=_FEW_TICKS))
        panel.grid(visible=True, color="#dddddd", linewidth=0.6)
        panel.spines[["top", "right"]].set_visible(False)
    build.yaxis.set_major_formatter(LogFormatter())
    build.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=_FEW_TICKS))
    query.set_ylim(0.0, 1.15 * query.get_ylim()[1])
    return figure


def _draw(
    panel: Axes,
    plan: ResolutionPlan,
    rows: list[Resolution],
    heights: list[float],
    colour: str,
    marker: str,
    bars: list[float] | None = None,
    label: str = "",
) -> None:
    """Draw a line through the resolutions but the given one, and a ring around the chosen one."""
    sizes = [row.size * _MEGABYTES for row in rows]
    on_line = [number for number, row in enumerate(rows) if row is not plan.given]
    line = [[values[number] for number in on_line] for values in (sizes, heights)]
    panel.plot(*line, color=colour, linewidth=1.0, marker=marker, label=label or None)
    if bars:
        panel.errorbar(sizes, heights, yerr=bars, fmt="none", ecolor=colour, elinewidth=1.0)
    for number, row in enumerate(rows):
        point = sizes[number], heights[number]
        if row is plan.given:
            panel.plot(*point, marker, color=colour, markerfacecolor="white")
        if row is plan.chosen:
            panel.plot(*point, "o", color=colour, markerfacecolor="none", markersize=13)
