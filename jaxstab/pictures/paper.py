"""The paper's figures 4 to 10."""

from collections.abc import Callable, Sequence
from math import pi
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxstab.paper import linear_alpha_limit, linear_validity, passive_region
from jaxstab.paper.facts import resolved_region
from jaxstab.pictures.style import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    RED,
    closed_outline,
    hand_label,
    panels,
)
from jaxstab.region.stable_set import printed_extremes
from jaxstab.scene.answers import Quantity


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
    panel.plot(*closed_outline(region).T, **{"lw": 1.6, **look})


# --------------------------------------------------------------------------- figures 4, 5 and 6


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


# -------------------------------------------------------------------------------------- figure 7
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


# --------------------------------------------------------------------------- figures 8, 9 and 10
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
    five_digits = Quantity(digits=5)
    region = resolved_region(gamma=gamma, delta=delta, delay=delay, radius=radius)
    figure, ((panel,),) = panels(1, 1, width=1.35, height=1.25)
    inside = "stable region" if radius == 1.0 else f"all roots within {radius:g}"
    panel.plot(*closed_outline(region).T, color=BLUE, label=inside)
    panel.fill(*closed_outline(region).T, facecolor=BLUE, alpha=0.15)
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
        numbers = ", ".join(map(five_digits.words, point))
        label = rf"largest $\{name}$: ({numbers})"
        panel.plot(*point, mark, color=ORANGE, markersize=8, label=label)
    panel.set(xlim=window[0], ylim=window[1])
    panel.set_title(f"{hand_label(gamma, delta)}, $d = {delay:g}$")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure
