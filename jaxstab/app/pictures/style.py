"""The style of all pictures, texts on them, and what loops and regions draw of themselves.

A text takes the first of its places that is inside of the axes and covers no mark, no other text
and, if possible, no line. Positions are known once a figure is laid out, so texts come last.

Of the open loop L of one pair of gains there are a Nyquist and a Bode plot: L is sampled densely,
and more so next to each margin; the margins beside it are proved.
"""

import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from io import BytesIO
from itertools import product
from math import isnan
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.text import Annotation
from matplotlib.ticker import ScalarFormatter
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from jaxstab import lab
from jaxstab.conventions import Verdict
from jaxstab.loop import FrequencyMargins, HapticLoop, Region
from jaxstab.loop.answers import Answers
from jaxstab.loop.gains import TwoGains
from jaxstab.loop.jitter import MovingLoop
from jaxstab.model.filters import given_filters
from jaxstab.model.gain import limit_text
from jaxstab.region import StableRegion
from jaxstab.region.stable_set import DIGITS
from jaxstab.shown import number_text

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Spot = tuple[float, float]

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


# Pictures that regions and loops draw of themselves, on axes or in a notebook.

_SIZE = 5.0, 3.6  # inches
STIFFNESS_LABEL, DAMPING_LABEL = "stiffness K (N/m)", "damping B (N s/m)"

AnyRegion = StableRegion | Region


def closed_outline(region: AnyRegion) -> Floats:
    """Return the outline of a region, with NaN between two loops."""
    plain = region if isinstance(region, StableRegion) else region.region
    jumps = np.flatnonzero(np.asarray(plain.branch) < 0)
    points = region.points if isinstance(region, StableRegion) else region.outline
    broken: Floats = np.insert(np.asarray(points), jumps + 1, np.nan, axis=0)
    return broken


def draw_stable(
    panel: Axes, region: AnyRegion, label: str = "stable", fill: str = SKY, edge: str = BLUE
) -> None:
    """Fill the stable set."""
    outline = closed_outline(region).T
    panel.fill(*outline, color=fill, alpha=0.35, lw=0, label=label)
    panel.plot(*outline, color=edge, lw=1.2)


def draw_islands(panel: Axes, islands: Sequence[AnyRegion]) -> None:
    """Fill islands: stable sets that are not connected to small gains."""
    for island in islands:
        label = "stable, not connected to zero gains" if island is islands[0] else ""
        draw_stable(panel, island, label, PURPLE, PURPLE)


def plot_region(region: AnyRegion, ax: Axes | None = None) -> Axes:
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
    if isinstance(region, Region):
        first, second = (f"{gain.name} " * bool(gain.symbol) + gain.label for gain in region.names)
        labels = first, second
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


def _draw_map(panel: Axes, main: AnyRegion, islands: Sequence[AnyRegion]) -> None:
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


def plot_loop(loop: Answers, ax: Axes | None = None) -> Axes:
    """Draw the stable gains of a loop, the stiffest wall, and its linear rule: ``loop.plot``."""
    legend_room = 0.25  # of the height of a loop's picture, above it
    region = loop.region()
    panel = plot_region(region, ax)
    largest = region.reachable._printed[0]
    if np.dot(loop._chart.shares, largest) < 1.0:
        first, second = region.names
        text = limit_text(first, largest[0], second, largest[1], DIGITS)
        words = plain(f"{first.word or first.sense}: {text}")
        panel.plot(*largest, ">", color=ORANGE, mec=BLACK, ms=8, label=words)
    if isinstance(loop, HapticLoop):
        draw_linear_rule(panel, loop)
    if not panel.child_axes:  # a map of islands has made room already
        low, high = panel.get_ylim()
        panel.set_ylim(low, high + legend_room * (high - low))
    panel.locator_params(axis="x", nbins=6)
    panel.legend(fontsize=8, frameon=False, loc="upper right")
    return panel


def _leave_out_negative(panel: Axes, loop: TwoGains) -> None:
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


def plot_contact(contact: "lab.contact.Contact", ax: Axes | None = None) -> Axes:
    """Draw a simulated contact over time; ValueError if it is not one run with its path."""
    path = contact.path
    if path is None or path.position.ndim != 1:
        raise ValueError(
            f"there is no single path to draw: {contact!r}; call jaxstab.contact with one wall."
        )
    panel = new_axes() if ax is None else ax
    panel.axhline(0.0, color=BLACK, lw=0.6)
    panel.plot(path.time, 1000.0 * path.position, color=BLUE, lw=1.0)
    panel.set_xlabel("time (s)")
    if contact.kind == lab.contact.ContactKind.RESTS:  # what follows is a straight line
        panel.set_xlim(0.0, min(path.time[-1], 3.0 * float(contact.time_to_rest)))
    panel.set_ylabel("position (mm), positive inside the wall", color=BLUE)
    beside = panel.twinx()
    beside.plot(path.time, path.force, color=ORANGE, lw=0.6)
    beside.set_ylabel("force of the wall (N)", color=OCHRE)
    panel.set_title(f"simulated: {lab.contact.ContactKind(int(contact.kind)).words}", fontsize=9)
    return panel


def plot_open_loop(
    kind: str,
    margins: FrequencyMargins,
    response: Callable[[Floats], Complex],
    period: float,
    ax: Axes | None,
) -> Axes:
    """Draw L, which is given at angles in (0, pi], as a "nyquist" or a "bode" plot."""
    panel, is_plane, highest = new_axes() if ax is None else ax, kind == "nyquist", 0.5 / period
    found = np.array([float(own.frequency) for own in margins[1:] if own.frequency > 0.0])
    lowest = min([*found / 30.0, highest / 100.0])
    near = np.outer(found, 1.0 + np.linspace(-0.02, 0.02, 41)).ravel()
    frequencies = np.unique([*np.geomspace(lowest, highest, 800), *near, *found])
    frequencies = np.clip(frequencies, lowest, highest)

    def at(hertz: Floats) -> Complex:
        return response(np.minimum(2.0 * np.pi * period * hertz, np.pi))

    values = at(frequencies)
    for _ in range(2):  # next to a resonance L moves fast
        is_far = np.abs(np.diff(values)) > 0.03 * (1.0 + np.abs(values[:-1]))
        if not is_far.any():
            break
        shares = np.linspace(0.0, 1.0, 8, endpoint=False)[1:]
        steps = np.diff(frequencies)[is_far, None]
        more = (frequencies[:-1][is_far, None] + shares * steps).ravel()
        frequencies, order = np.unique(np.append(frequencies, more), return_index=True)
        values = np.append(values, at(more))[order]
    (_draw_plane if is_plane else _draw_magnitudes)(panel, frequencies, values)
    peak = float(margins.sensitivity.value)
    if is_plane and not isnan(peak):
        around = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361)) / peak - 1.0
        panel.plot(around.real, around.imag, color=RED, lw=0.8)
    for name, own, unit, mark, colour in (
        ("gain margin", margins.largest_gain, "", "o", GREEN),
        ("phase margin", margins.phase, "degrees", "s", ORANGE),
        ("peak sensitivity", margins.sensitivity, "", "^", RED),
    ):
        if own.frequency > 0.0:
            value = complex(np.interp(own.frequency, frequencies, values))
            size = 1.0 / (1.0 + value) if own is margins.sensitivity else value
            place = (value.real, value.imag) if is_plane else (own.frequency, _decibels(size))
            words = f"{name} {number_text(float(own.value), 3, unit=unit)}"
            words += f" at {float(own.frequency):.3g} Hz"
            panel.plot(*place, mark, color=colour, mec=BLACK, label=words)
    if margins.verdict != Verdict.STABLE:
        panel.set_title("not proved stable: there are no margins", fontsize=9)
    panel.grid(visible=True, color="#dddddd", linewidth=0.6)
    corner: Any = "upper right" if is_plane else "lower left"
    panel.legend(fontsize=7, edgecolor="none", framealpha=0.8, loc=corner)
    return panel


def _decibels(values: complex | Complex) -> Floats:
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(values), 1e-300)))


def _draw_plane(panel: Axes, _: Floats, values: Complex) -> None:
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
    panel.plot(turn.real, turn.imag, ":", color=BLACK, lw=0.8, label="unit circle")
    panel.plot(values.real, values.imag, color=BLUE, lw=1.4, label="L")
    panel.plot(values.real, -values.imag, "--", color=BLUE, lw=0.7)
    panel.plot(-1.0, 0.0, "+", color=RED, ms=10, mew=2)
    panel.set(xlabel="Re L", ylabel="Im L", xlim=(-2.5, 1.5), ylim=(-1.6, 2.4))
    panel.set_aspect("equal")


def _draw_magnitudes(panel: Axes, frequencies: Floats, values: Complex) -> None:
    legend_room, lowest = 0.6, -80.0  # of the height, below; in dB: lines leave the axes there
    lines = (BLUE, "-", "|L|", values), (RED, "-", "|S|", 1 / (1 + values))
    for colour, style, name, size in (*lines, (GREEN, "--", "|T|", values / (1 + values))):
        panel.semilogx(frequencies, _decibels(size), style, color=colour, lw=1.2, label=name)
    panel.axhline(0.0, color=BLACK, lw=0.6)
    panel.set(xlabel="frequency (Hz)", ylabel="magnitude (dB)")
    beside, phase = panel.twinx(), np.degrees(np.unwrap(np.angle(values)))
    beside.plot(frequencies[:-1], phase[:-1], ":", color=ORANGE, lw=1.4)  # L may be 0 at the last
    beside.set_ylabel("phase of L (degrees), dotted", color=OCHRE)
    panel.set_ylim(bottom=max(panel.get_ylim()[0], lowest))
    for axes in (panel, beside):
        low, high = axes.get_ylim()
        axes.set_ylim(low - legend_room * (high - low), high)


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
