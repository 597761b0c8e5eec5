"""Pictures in the plane of alpha and beta: the paper's figures 4 to 10, one region, and atlases."""

from collections.abc import Callable, Sequence
from math import pi
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxstab.app.pictures.style import panels
from jaxstab.atlas import Atlas
from jaxstab.atlas.picture import draw_verdicts, legend, raster
from jaxstab.drawing import (
    ALPHA_LABEL,
    BETA_LABEL,
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    RED,
    hand_label,
    picture,
    plain,
)
from jaxstab.model import by_name
from jaxstab.paper import linear_alpha_limit, linear_validity, passive_region
from jaxstab.paper.facts import resolved_region
from jaxstab.region.stable_set import printed_extremes
from jaxstab.shown import number_text

# The paper's figures.


def paper_figure(number: int) -> Figure:
    """A matplotlib figure of the paper's Fig. 4 to 10, with its caption's values."""
    drawings: dict[int, Callable[[], Figure]] = {
        4: _haptic_range,
        5: _close_up,
        6: _delayed_range,
        7: _linear_validity,
        8: lambda: _up_to_nyquist([(0.0, 0.0)]),
        9: lambda: _up_to_nyquist([(1.0, 0.0)]),
        10: lambda: _up_to_nyquist([(0.0, 1.0), (1.0, 1.0)]),
    }
    if number not in drawings:
        raise ValueError(f"there is no figure {number}; give a number from 4 to 10.")
    return drawings[number]()


def _draw(panel: Axes, gamma: float, delta: float, delay: float, **look: Any) -> None:
    region = resolved_region(gamma=gamma, delta=delta, delay=delay)
    panel.plot(*region._drawn.T, **{"lw": 1.6, **look})


# Figures 4, 5 and 6.


def _draw_limits(panel: Axes, delay: float) -> None:
    """Draw the regions at the limits of the haptic range (15)."""
    for gamma, delta, look in (
        (0.0, 0.0, {"color": BLUE, "lw": 3.6}),  # wide, for the others hide parts of it
        (1e-3, 0.0, {"color": ORANGE, "ls": "--"}),
        (0.0, 0.015, {"color": GREEN}),
        (1e-3, 0.015, {"color": RED, "ls": "--"}),
    ):
        _draw(panel, gamma, delta, delay, label=hand_label(gamma, delta), **look)
    panel.set_title(f"$d = {delay:g}$")


def _haptic_range() -> Figure:
    figure, ((panel,),) = panels(1, 1, width=1.4, height=1.3)
    _draw_limits(panel, 0.0)
    panel.legend(frameon=False)
    return figure


def _close_up() -> Figure:
    figure = _haptic_range()
    (panel,) = figure.axes
    panel.set(xlim=(-2.5e-3, 6e-3), ylim=(-0.018, 0.012), title="$d = 0$, around the origin")
    panel.ticklabel_format(style="sci", scilimits=(-3, -3), axis="x")
    panel.annotate(
        r"$\alpha = -\gamma$",
        xy=(-1e-3, 0.006),
        xytext=(-2.3e-3, 0.0095),
        arrowprops={"arrowstyle": "->"},
    )
    panel.legend(frameon=False, loc="center right")
    return figure


def _delayed_range() -> Figure:
    figure, (row,) = panels(1, 2)
    for panel, delay in zip(row, (1.0, 2.0), strict=True):
        _draw_limits(panel, delay)
    handles, labels = row[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return figure


# Figure 7.
_LEVELS = ((0.02, "o"), (0.05, "s"))


def _linear_validity() -> Figure:
    figure, grid = panels(2, 2)
    dampings = ((0.0, BLUE), (0.005, GREEN), (0.01, ORANGE), (0.015, RED))
    for row, delay, width in zip(grid, (0.0, 1.0), (0.16, 0.05), strict=True):
        for panel, gamma in zip(row, (0.0, 1e-3), strict=True):
            for delta, colour in dampings:
                _draw_validity(panel, gamma, delta, delay, colour)
            panel.set(xlim=(-0.03 * width, width), ylim=(-0.02, 0.07))
            panel.set_title(rf"$d = {delay:g}$, $\gamma = {gamma:g}$")
    handles = [Line2D([], [], color=c, label=rf"$\delta = {delta:g}$") for delta, c in dampings]
    handles += [
        Line2D([], [], color=BLACK, label="exact"),
        Line2D([], [], color=BLACK, linestyle="--", label="linear"),
        *(
            Line2D([], [], color=BLACK, marker=m, linestyle="", label=f"error {level:.0%}")
            for level, m in _LEVELS
        ),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _draw_validity(panel: Axes, gamma: float, delta: float, delay: float, colour: str) -> None:
    _draw(panel, gamma, delta, delay, color=colour)
    beta = np.array([-0.02, 0.07])
    limit = np.asarray(linear_alpha_limit(beta, delta=delta, delay=delay))
    panel.plot(limit, beta, "--", color=colour)
    for level, mark in _LEVELS:
        point = linear_validity(level, gamma=gamma, delta=delta, delay=delay)
        panel.plot(float(point.alpha), float(point.beta), mark, color=colour, markersize=6)


# Figures 8, 9 and 10.
def _up_to_nyquist(rows: Sequence[tuple[float, float]]) -> Figure:
    """A row for each (delta, delay): gamma up to half Nyquist frequency, and up to all of it."""
    figure, grid = panels(len(rows), 2)
    for row, (delta, delay) in zip(grid, rows, strict=True):
        for panel, share in zip(row, (0.5, 1.0), strict=True):
            _draw_frequencies(panel, share, delta, delay)
            passive = passive_region(delta=delta, delay=delay).outline
            if len(passive):
                look: Any = {"facecolor": GREEN, "alpha": 0.45, "label": "passive"}
                panel.fill(*passive.T, zorder=3, **look)
            panel.plot(0, 0, "+", color=BLACK, markersize=9, zorder=4)
            to = r"(\pi/2)^2" if share < 1 else r"\pi^2"
            to += r" + \delta^2/4" if delta else ""
            panel.set_title(rf"$d = {delay:g}$, $\delta = {delta:g}$, $\gamma = 0 \ldots {to}$")
            beside: Any = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "fontsize": 8}
            panel.legend(title=r"$\gamma$", frameon=False, **beside)
    return figure


def _draw_frequencies(panel: Axes, share: float, delta: float, delay: float) -> None:
    """Draw evenly spaced oscillation frequencies up to a share of Nyquist's, eq. (26)."""
    below_nyquist = 1 - 1e-4  # frequency drawn for Nyquist's where only the limit is stable
    frequencies = np.linspace(0.0, share * pi, 6).tolist()
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(frequencies)))
    for omega, colour in zip(frequencies, colours, strict=True):
        # Without damping a root stays at z = -1 at Nyquist frequency: the limit from below.
        is_limit = delta == 0.0 and omega == pi
        gamma = (omega * below_nyquist) ** 2 if is_limit else omega**2 + delta**2 / 4
        gamma = gamma if omega else 0.0
        words = f"{gamma:.3g}{' (limit stable)' * is_limit}"
        _draw(panel, gamma, delta, delay, color=colour, ls="--" if is_limit else "-", label=words)


# One stable region, annotated with the facts about it.


def region_figure(gamma: float, delta: float, delay: float, radius: float = 1.0) -> Figure:
    """A stable region, of roots below a radius, with its corners, extremes and the paper's rules.

    ValueError: the region is empty or unresolved, or an argument is bad. Source: sec. V to VIII of
    Hulin, Preusche, Hirzinger (2008).
    """
    region = resolved_region(gamma=gamma, delta=delta, delay=delay, radius=radius)
    figure, ((panel,),) = panels(1, 1, width=1.35, height=1.25)
    inside = "stable region" if radius == 1.0 else f"all roots within {radius:g}"
    panel.plot(*region._drawn.T, color=BLUE, label=inside)
    panel.fill(*region._drawn.T, facecolor=BLUE, alpha=0.15)
    window = panel.get_xlim(), panel.get_ylim()
    passive = passive_region(delta=delta, delay=delay).outline
    if len(passive):
        panel.fill(*passive.T, facecolor=GREEN, alpha=0.35, edgecolor=GREEN, label="passive region")
    beta = np.array(window[1])
    limit = np.asarray(linear_alpha_limit(beta, delta=delta, delay=delay))
    panel.plot(limit, beta, "--", color=RED, label="linear condition")
    panel.plot(*region.corners.T, "s", color=BLACK, markersize=5, label="corners")
    for point, name, mark in zip(
        printed_extremes(region), ("alpha", "beta"), (">", "^"), strict=True
    ):
        numbers = ", ".join(number_text(value, 5) for value in point)
        label = rf"largest $\{name}$: ({numbers})"
        panel.plot(*point, mark, color=ORANGE, markersize=8, label=label)
    panel.set(xlim=window[0], ylim=window[1])
    panel.set_title(f"{hand_label(gamma, delta)}, $d = {delay:g}$")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure


# Atlases: verdicts and fields in planes of (alpha, beta).

# Fields at nodes: the label of their colours, and the map from values to colours.
_FIELDS = {
    "frequency": ("frequency of the dominant pole\n(rad per sample)", PowerNorm(0.5, 0.0, np.pi)),
    "damping_ratio": ("damping ratio of the dominant pole", Normalize(0.0, 1.0)),
}

_RADII = (0.6, 0.7, 0.8, 0.85, 0.9, 0.94, 0.97, 1.0, 1.02, 1.05, 1.1)  # finer towards the boundary


def draw_atlas(
    atlas: Atlas,
    gamma: float | None = None,
    delta: float | None = None,
    delays: Sequence[float] = (),
) -> bytes:
    """A PNG of an atlas in planes of (alpha, beta), one for each of at most 6 delays.

    Verdicts are those of queries. Fields, if there are any, are drawn at the nodes of gamma and
    delta that are nearest, at delays of theirs. Without delays these are those of the fields, or
    whole ones. ValueError: a value is outside of the atlas, or a delay has no fields.
    """
    chosen = _delays(atlas, delays)
    rows = ["verdict", *(("spectral_radius", *_FIELDS) if atlas.has_fields else ())]
    table = atlas.table
    hand = (
        float(table.gamma[0]) if gamma is None else gamma,
        float(table.delta[0]) if delta is None else delta,
    )
    size = 3.3 * len(chosen) + 0.9, 2.9 * len(rows) + 1.0  # inches
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(rows), len(chosen), squeeze=False)
    filled: dict[str, ScalarMappable] = {}
    for column, delay in zip(panels.T, chosen, strict=True):
        alpha, beta = raster(atlas.table, *hand, delay)
        plane = by_name(*hand, delay)
        draw_verdicts(column[0], alpha, beta, atlas.query(alpha, beta[:, None], **plane).verdict)
        for panel, row in zip(column[1:], rows[1:], strict=True):
            i, j, k = (_nearest(atlas, *own) for own in plane.items())
            values = atlas.fields[row][:, :, i, j, k].T.astype(float)
            nodes = atlas.fields["alpha"][:, k], atlas.fields["beta"][:, k], values
            if row in _FIELDS:
                filled[row] = panel.pcolormesh(*nodes, norm=_FIELDS[row][1])
            else:
                look: Any = {"norm": BoundaryNorm(_RADII, 256, extend="both"), "cmap": "viridis"}
                filled[row] = panel.contourf(*nodes, levels=_RADII, extend="both", **look)
                panel.contour(*nodes, levels=[1.0], colors="white", linewidths=1.2)
        for panel in column:
            panel.tick_params(labelsize=8)
            panel.locator_params(axis="x", nbins=5)
        column[0].set_title(f"delay {delay:g} T", fontsize=10)
        column[-1].set_xlabel(ALPHA_LABEL)
    for panel in panels[:, 0]:
        panel.set_ylabel(BETA_LABEL)
    for row, drawn in filled.items():
        is_radius = row == "spectral_radius"
        ticks = _RADII if is_radius else None
        bar = figure.colorbar(drawn, ax=list(panels[rows.index(row)]), pad=0.01, ticks=ticks)
        bar.ax.tick_params(labelsize=8)
        bar.set_label("spectral radius (line: 1)" if is_radius else _FIELDS[row][0])
    figure.legend(handles=legend(), loc="outside lower center", ncols=3, frameon=False)
    title = f"{plain(atlas.filters_in_words)}\n{hand_label(*hand)}"
    if atlas.has_fields:
        places = zip(("gamma", "delta"), hand, strict=True)
        near = [float(atlas.fields[axis][_nearest(atlas, axis, own)]) for axis, own in places]
        title += f"; fields at {hand_label(*near)}" * (near != [*hand])
    figure.suptitle(title, fontsize=10)
    return picture(figure, "png")


def _delays(atlas: Atlas, given: Sequence[float]) -> list[float]:
    """Return the delays of a picture; ValueError for one that has no fields."""
    most_planes = 6
    nodes = (atlas.fields["delay"] if atlas.has_fields else atlas.table.delay).tolist()
    for delay in given:
        if atlas.has_fields and delay not in nodes:
            listed = ", ".join(f"{node:g}" for node in nodes)
            raise ValueError(f"delay {delay:g} has no fields in this atlas; give some of {listed}.")
    whole = [delay for delay in nodes if float(delay).is_integer()]
    return [*(given or (nodes if atlas.has_fields else whole or nodes))][:most_planes]


def _nearest(atlas: Atlas, axis: str, value: float) -> int:
    """Return the number of the node of the fields that is nearest to a value."""
    return int(np.argmin(np.abs(atlas.fields[axis] - value)))
