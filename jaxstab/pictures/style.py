"""The style of all pictures: colours, sizes, labels; and how a figure becomes a file."""

import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from html import escape
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from jaxstab.loop import Contact, ContactKind, GainRegion, HapticLoop, Loop, WallRegion
from jaxstab.loop.jitter import MovingLoop
from jaxstab.model.filters import given_filters
from jaxstab.region import StableRegion

# Okabe and Ito's colours, distinguishable with any colour vision.
BLACK, ORANGE, SKY, GREEN, BLUE, RED, PURPLE = (
    "#000000",
    "#e69f00",
    "#56b4e9",
    "#009e73",
    "#0072b2",
    "#d55e00",
    "#cc79a7",
)

OCHRE, PLUM = "#b35c00", "#9c3f76"
"""Orange and purple of texts: dark enough to be read on white and on light fills."""

HALO: list[AbstractPathEffect] = [withStroke(linewidth=2.5, foreground="white")]
"""Around text on a picture."""

ALPHA_LABEL = r"stiffness  $\alpha = K\,T^2/m$"
BETA_LABEL = r"damping  $\beta = B\,T/m$"


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


def hand_label(gamma: float, delta: float) -> str:
    """Return the hand of a slice, in the letters of the paper."""
    return rf"$\gamma = {gamma:g}$, $\delta = {delta:g}$"


def plain(text: str) -> str:
    """Return a text as it is read: no dollar sign begins a formula, and powers are raised."""
    as_it_is = text.replace("$", r"\$").replace("m^2", "m²")
    raised = r"$\\,\\times 10^{\1\2}$"
    return re.sub(r"(?<=\d)e(?:\+|(-))0*(\d+)\b", raised, as_it_is)


def raise_powers(panels: Iterable[Axes]) -> None:
    """Let each axis of panels write large and small numbers with one power of ten."""
    for axis in (axis for panel in panels for axis in (panel.xaxis, panel.yaxis)):
        form = axis.get_major_formatter()
        if isinstance(form, ScalarFormatter):
            form.set_useMathText(True)
            form.set_powerlimits((-3, 6))


def picture(figure: Figure, form: str) -> bytes:
    """A figure as a file of the format "png" or "svg"."""
    dots_per_inch = 150
    image = BytesIO()
    raise_powers(figure.axes)
    figure.savefig(image, format=form, dpi=dots_per_inch, bbox_inches="tight", pad_inches=0.08)
    return image.getvalue()


# Pictures that regions and loops draw of themselves, on axes or in a notebook.

_SIZE = 5.0, 3.6  # inches
STIFFNESS_LABEL, DAMPING_LABEL = "stiffness K (N/m)", "damping B (N s/m)"

Region = StableRegion | WallRegion | GainRegion

Floats = NDArray[np.float64]


def closed_outline(region: Region) -> Floats:
    """Return the outline of a region, with NaN between two loops."""
    plain = region if isinstance(region, StableRegion) else region.region
    jumps = np.flatnonzero(np.asarray(plain.branch) < 0)
    points = region.points if isinstance(region, StableRegion) else region.outline
    broken: Floats = np.insert(np.asarray(points), jumps + 1, np.nan, axis=0)
    return broken


def draw_stable(
    panel: Axes, region: Region, label: str = "stable", fill: str = SKY, edge: str = BLUE
) -> None:
    """Fill the stable set."""
    outline = closed_outline(region).T
    panel.fill(*outline, color=fill, alpha=0.35, lw=0, label=label)
    panel.plot(*outline, color=edge, lw=1.2)


def draw_islands(panel: Axes, islands: Sequence[Region]) -> None:
    """Fill islands: stable sets that are not connected to small gains."""
    for island in islands:
        label = "stable, not connected to zero gains" if island is islands[0] else ""
        draw_stable(panel, island, label, PURPLE, PURPLE)


def plot_region(region: Region, ax: Axes | None = None) -> Axes:
    """Draw a region on axes, or on new ones: ``region.plot``; ValueError if it is empty."""
    if not region.components:
        raise ValueError(
            f"there is nothing to draw: {region!r}; the region must be COMPLETE and not empty."
        )
    panel = new_axes() if ax is None else ax
    if region.main is not None:
        draw_stable(panel, region.main)
        if region.islands:
            _draw_map(panel, region.main, region.islands)
    draw_islands(panel, region.islands)
    labels = ALPHA_LABEL, BETA_LABEL
    if isinstance(region, WallRegion):
        labels = STIFFNESS_LABEL, DAMPING_LABEL
    elif isinstance(region, GainRegion):
        labels = region.names.labels
        _leave_out_negative(panel, region.loop)
    panel.set(xlabel=labels[0], ylabel=labels[1])
    raise_powers([panel])
    return panel


def plot_moving(
    loop: MovingLoop, panel: Axes, stable: Iterable[tuple[float, float]] = ()
) -> NDArray[np.float64]:
    """Draw proved walls of a delay that moves, and unstable ones, which it returns, too.

    The area of the walls that are proved holds those that are known to be stable. ValueError: no
    wall was found that is proved.
    """
    proved, unstable = loop.stiffest_walls(stable)
    if not len(proved):
        raise ValueError(
            "no wall was found that is proved for every sequence of delays; there is nothing to "
            "draw."
        )
    unstable = unstable[np.isfinite(unstable[:, 0])]
    look: Any = {"color": SKY, "alpha": 0.35, "lw": 0}
    label = "stable for every sequence of delays, sampled"
    softest = loop.softest_walls(proved, stable)
    panel.fill_betweenx(proved[:, 1], softest, proved[:, 0], label=label, **look)
    label = "stiffest proved for every sequence, at some dampings"
    panel.plot(*proved.T, "o-", color=BLUE, lw=0.6, ms=4, label=label)
    panel.plot(*unstable.T, "x", color=RED, ms=6, label="unstable for some sequence, proved")
    return np.concatenate([proved, unstable])


def _draw_map(panel: Axes, main: Region, islands: Sequence[Region]) -> None:
    """Let the main component fill the axes, and draw it with its islands in a small map."""
    room = np.array([0.65, 0.35])  # of the main component, beside it for the map and the legend
    map = 0.72, 0.12, 0.26, 0.36  # of the axes: where islands are drawn
    panel.autoscale(False)
    inset = panel.inset_axes(map)
    draw_stable(inset, main)
    draw_islands(inset, islands)
    inset.set_title("with islands", fontsize=7, pad=2)
    inset.tick_params(labelsize=6)
    inset.locator_params(nbins=3)
    low, high = (np.nanquantile(closed_outline(main), end, axis=0) for end in (0.0, 1.0))
    (left, bottom), (right, top) = low - 0.04 * (high - low), high + room * (high - low)
    panel.set(xlim=(left, right), ylim=(bottom, top))


def plot_loop(loop: HapticLoop | Loop, ax: Axes | None = None) -> Axes:
    """Draw the stable gains of a loop, the stiffest wall, and its linear rule: ``loop.plot``."""
    legend_room = 0.25  # of the height of a loop's picture, above it
    region = loop.region()
    panel = plot_region(region, ax)
    if isinstance(region, WallRegion):
        word, largest = "stiffest", region.limits()[:2]
    else:
        word, largest = "largest", region.reachable.extremes[0]
    if isinstance(loop, HapticLoop) or np.dot(loop._chart.shares, largest) < 1.0:
        words = plain(f"{word}: {region.names.at_largest_stiffness(largest)}")
        panel.plot(*largest, ">", color=ORANGE, mec=BLACK, ms=8, label=words)
    if isinstance(loop, HapticLoop):
        draw_linear_rule(panel, loop)
    if not panel.child_axes:  # a map of islands has made room already
        low, high = panel.get_ylim()
        panel.set_ylim(low, high + legend_room * (high - low))
    panel.locator_params(axis="x", nbins=6)
    panel.legend(fontsize=8, frameon=False, loc="upper right")
    return panel


def _leave_out_negative(panel: Axes, loop: Loop) -> None:
    """Cover the coordinates beyond infinite gains, or beyond the one of the chart that is 0."""
    chart, window = loop._chart, (panel.get_xlim(), panel.get_ylim())
    x, y = np.meshgrid(*(np.linspace(*ends, 200) for ends in window))
    used = chart.shares[0] * x + chart.shares[1] * y
    if not np.min(used) < 1.0 < np.max(used):
        return
    over_outlines = 2.2
    panel.contourf(x, y, used, [1.0, np.inf], colors="white", zorder=over_outlines)
    panel.contour(
        x, y, used, [1.0], colors=RED, linestyles="--", linewidths=1.4, zorder=over_outlines
    )
    names = "infinite gains", *(f"{gain.name} = 0" for gain in loop.gains)
    panel.plot([], [], "--", color=RED, lw=1.4, label=names[chart.pivot])


def draw_linear_rule(panel: Axes, loop: HapticLoop) -> None:
    """Draw the linear rule where it applies: without estimator, filter and mode."""
    if loop.body is None or given_filters(**loop.filters):
        return
    window = panel.get_xlim(), panel.get_ylim()
    damping = np.array(window[1])
    linear = (damping + loop.body.damping) / (loop.delay + 0.5 * loop.sample_time)
    panel.plot(linear, damping, "--", color=RED, lw=1.4, label="linear rule")
    panel.set(xlim=window[0], ylim=window[1])


def plot_contact(contact: Contact, ax: Axes | None = None) -> Axes:
    """Draw a simulated contact over time; ValueError if it is not one run with its path."""
    path = contact.path
    if path is None or path.position.ndim != 1:
        raise ValueError(
            f"there is no single path to draw: {contact!r}; call loop.contact with one wall."
        )
    panel = new_axes() if ax is None else ax
    panel.axhline(0.0, color=BLACK, lw=0.6)
    panel.plot(path.time, 1000.0 * path.position, color=BLUE, lw=1.0)
    panel.set_xlabel("time (s)")
    if contact.kind == ContactKind.RESTS:  # what follows is a straight line
        panel.set_xlim(0.0, min(path.time[-1], 3.0 * float(contact.time_to_rest)))
    panel.set_ylabel("position (mm), positive inside the wall", color=BLUE)
    beside = panel.twinx()
    beside.plot(path.time, path.force, color=ORANGE, lw=0.6)
    beside.set_ylabel("force of the wall (N)", color=OCHRE)
    panel.set_title(f"simulated: {ContactKind(int(contact.kind)).words}", fontsize=9)
    return panel


def new_axes() -> Axes:
    """Return axes of a new figure that notebooks and ``pyplot.show`` show."""
    from matplotlib import pyplot

    return pyplot.subplots(figsize=_SIZE, layout="constrained")[1]


def html_of(thing: object, draw: Callable[[Axes], object]) -> str:
    """Return HTML of the text of a thing and, above it, its picture if it can be drawn."""
    words, figure = repr(thing), Figure(figsize=_SIZE, layout="constrained")
    try:
        draw(figure.subplots())
    except ValueError:
        return f"<pre>{escape(words)}</pre>"
    image = b64encode(picture(figure, "png")).decode("ascii")
    alt = escape(words, quote=True).replace("\n", " ")
    return (
        f'<img alt="{alt}" style="max-width: 32em" src="data:image/png;base64,{image}">'
        f"<pre>{escape(words)}</pre>"
    )
