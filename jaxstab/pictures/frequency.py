"""The open loop of one pair of gains over frequency: its Nyquist and its Bode plot.

L is sampled densely, and more so next to each margin; the margins beside it are proved.
"""

from collections.abc import Callable
from math import isnan
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from jaxstab.conventions import Verdict
from jaxstab.loop import FrequencyMargins
from jaxstab.pictures.style import BLACK, BLUE, GREEN, OCHRE, ORANGE, RED, Floats, new_axes
from jaxstab.shown import number_text

Complex = NDArray[np.complex128]


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
