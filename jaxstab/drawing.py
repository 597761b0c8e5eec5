"""What answers draw of themselves, on axes or in a notebook, and the colours of all pictures.

Regions, loops and atlases give plain arrays. matplotlib is imported when something is drawn.

Of the open loop L of one pair of gains there are a Nyquist and a Bode plot: L is sampled densely,
and more so next to each margin; the margins beside it are proved.
"""

import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from html import escape
from io import BytesIO
from math import isnan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.conventions import Verdict
from jaxstab.shown import number_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

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

ALPHA_LABEL = r"stiffness  $\alpha = K\,T^2/m$"
BETA_LABEL = r"damping  $\beta = B\,T/m$"
STIFFNESS_LABEL, DAMPING_LABEL = "stiffness K (N/m)", "damping B (N s/m)"

_SIZE = 5.0, 3.6  # inches


def hand_label(gamma: float, delta: float) -> str:
    """Return the hand of a slice, in the letters of the paper."""
    return rf"$\gamma = {gamma:g}$, $\delta = {delta:g}$"


def plain(text: str) -> str:
    """Return a text as it is read: no dollar sign begins a formula, and powers are raised."""
    as_it_is = text.replace("$", r"\$").replace("m^2", "m²")
    raised = r"$\\,\\times 10^{\1\2}$"
    return re.sub(r"(?<=\d)e(?:\+|(-))0*(\d+)\b", raised, as_it_is)


def raise_powers(panels: "Iterable[Axes]") -> None:
    """Let each axis of panels write large and small numbers with one power of ten."""
    for axis in (axis for panel in panels for axis in (panel.xaxis, panel.yaxis)):
        form: Any = axis.get_major_formatter()
        if hasattr(form, "set_powerlimits"):  # it is for numbers, not for words or logarithms
            form.set_useMathText(True)
            form.set_powerlimits((-3, 6))


def picture(figure: "Figure", form: str) -> bytes:
    """A figure as a file of the format "png" or "svg"."""
    dots_per_inch = 150
    image = BytesIO()
    raise_powers(figure.axes)
    figure.savefig(image, format=form, dpi=dots_per_inch, bbox_inches="tight", pad_inches=0.08)
    return image.getvalue()


def new_axes() -> "Axes":
    """Return axes of a new figure that notebooks and ``pyplot.show`` show."""
    from matplotlib import pyplot

    return pyplot.subplots(figsize=_SIZE, layout="constrained")[1]


def html_of(thing: object, draw: "Callable[[Axes], object]") -> str:
    """Return HTML of the text of a thing and, above it, its picture if it can be drawn."""
    from matplotlib.figure import Figure

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


# ------------------------------------------------------------------------------------ stable gains
def with_gaps(points: Floats, branch: NDArray[np.integer[Any]]) -> Floats:
    """Return outlines, loop after loop, with NaN between two loops: there the branch is -1."""
    gaps = np.flatnonzero(np.asarray(branch) < 0)
    broken: Floats = np.insert(np.asarray(points), gaps + 1, np.nan, axis=0)
    return broken


def draw_stable(
    panel: "Axes", outline: Floats, label: str = "stable", fill: str = SKY, edge: str = BLUE
) -> None:
    """Fill the stable set within an outline."""
    panel.fill(*outline.T, color=fill, alpha=0.35, lw=0, label=label)
    panel.plot(*outline.T, color=edge, lw=1.2)


def draw_islands(panel: "Axes", islands: Sequence[Floats]) -> None:
    """Fill islands: stable sets that are not connected to small gains."""
    for island in islands:
        label = "stable, not connected to zero gains" if island is islands[0] else ""
        draw_stable(panel, island, label, PURPLE, PURPLE)


def draw_components(panel: "Axes", main: Floats | None, islands: Sequence[Floats]) -> None:
    """Fill the component that holds small gains, if there is one, and islands."""
    if main is not None:
        draw_stable(panel, main)
        if islands:
            _draw_map(panel, main, islands)
    draw_islands(panel, islands)


def _draw_map(panel: "Axes", main: Floats, islands: Sequence[Floats]) -> None:
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
    low, high = (np.nanquantile(main, end, axis=0) for end in (0.0, 1.0))
    (left, bottom), (right, top) = low - 0.04 * (high - low), high + room * (high - low)
    panel.set(xlim=(left, right), ylim=(bottom, top))


def cover_beyond(panel: "Axes", shares: tuple[float, float], label: str) -> None:
    """Cover the coordinates (x, y) with shares[0] x + shares[1] y > 1, if some are on the axes."""
    window = panel.get_xlim(), panel.get_ylim()
    x, y = np.meshgrid(*(np.linspace(*ends, 200) for ends in window))
    used = shares[0] * x + shares[1] * y
    if not np.min(used) < 1.0 < np.max(used):
        return
    over_outlines = 2.2
    panel.contourf(x, y, used, [1.0, np.inf], colors="white", zorder=over_outlines)
    panel.contour(
        x, y, used, [1.0], colors=RED, linestyles="--", linewidths=1.4, zorder=over_outlines
    )
    panel.plot([], [], "--", color=RED, lw=1.4, label=label)


def draw_largest(panel: "Axes", point: tuple[float, float], words: str) -> None:
    """Mark the largest gain of a loop."""
    panel.plot(*point, ">", color=ORANGE, mec=BLACK, ms=8, label=plain(words))


def draw_linear_rule(panel: "Axes", rule: tuple[float, float] | None) -> None:
    """Draw the linear rule K = (B + b)/t of a damping b in N s/m and a time t in s, if it holds."""
    if rule is None:
        return
    window = panel.get_xlim(), panel.get_ylim()
    damping = np.array(window[1])
    linear = (damping + rule[0]) / rule[1]
    panel.plot(linear, damping, "--", color=RED, lw=1.4, label="linear rule")
    panel.set(xlim=window[0], ylim=window[1])


def write_legend(panel: "Axes") -> None:
    """Write the legend of a loop's picture above what is drawn."""
    room = 0.25  # of the height of the picture
    if not panel.child_axes:  # a map of islands has made room already
        low, high = panel.get_ylim()
        panel.set_ylim(low, high + room * (high - low))
    panel.locator_params(axis="x", nbins=6)
    panel.legend(fontsize=8, frameon=False, loc="upper right")


# --------------------------------------------------------------------------------------- open loops
def plot_open_loop(
    kind: str,
    margins: Any,
    response: Callable[[Floats], Complex],
    period: float,
    ax: "Axes | None",
) -> "Axes":
    """Draw L, which is given at angles in (0, pi], as a "nyquist" or a "bode" plot.

    Margins are ``jaxstab.results.FrequencyMargins``.
    """
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


def _draw_plane(panel: "Axes", _: Floats, values: Complex) -> None:
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
    panel.plot(turn.real, turn.imag, ":", color=BLACK, lw=0.8, label="unit circle")
    panel.plot(values.real, values.imag, color=BLUE, lw=1.4, label="L")
    panel.plot(values.real, -values.imag, "--", color=BLUE, lw=0.7)
    panel.plot(-1.0, 0.0, "+", color=RED, ms=10, mew=2)
    panel.set(xlabel="Re L", ylabel="Im L", xlim=(-2.5, 1.5), ylim=(-1.6, 2.4))
    panel.set_aspect("equal")


def _draw_magnitudes(panel: "Axes", frequencies: Floats, values: Complex) -> None:
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
