"""The open loop of one pair of gains over frequency: its Nyquist and its Bode plot.

L is sampled densely, and more so next to each margin; the margins beside it are proved.
"""

from collections.abc import Callable
from math import isfinite

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from jaxstab.conventions import Verdict
from jaxstab.loop import AtFrequency, FrequencyMargins
from jaxstab.pictures.style import BLACK, BLUE, GREEN, ORANGE, RED, new_axes
from jaxstab.shown import number_text

Floats = NDArray[np.float64]
Response = Callable[[Floats], NDArray[np.complex128]]
"""L at angles in (0, pi]."""


def plot_open_loop(
    kind: str, margins: FrequencyMargins, response: Response, period: float, ax: Axes | None
) -> Axes:
    """Draw L as a "nyquist" or a "bode" plot, and the margins on it."""
    panel = new_axes() if ax is None else ax
    found = np.array([float(own.frequency) for own in margins[1:]])
    found, highest = found[found > 0.0], 0.5 / period
    lowest = min(found.min(initial=highest) / 30.0, highest / 100.0)
    near = (found[:, None] * (1.0 + np.linspace(-0.02, 0.02, 41))).ravel()
    frequencies = np.concatenate([np.geomspace(lowest, highest, 800), near, found])
    frequencies = np.unique(np.clip(frequencies, lowest, highest))
    values = response(np.minimum(2.0 * np.pi * period * frequencies, np.pi))
    places = {
        name: response(np.array([2.0 * np.pi * period * float(own.frequency)]))[0]
        for name, own in margins._asdict().items()
        if name != "verdict" and own.frequency > 0.0
    }
    (_nyquist if kind == "nyquist" else _bode)(panel, margins, frequencies, values, places)
    if margins.verdict != Verdict.STABLE:
        panel.set_title("the loop is unstable: it has no margins", fontsize=9)
    panel.grid(visible=True, color="#dddddd", linewidth=0.6)
    panel.set_axisbelow(True)
    return panel


_NAMES = {
    "largest_gain": ("gain margin", "", "o", GREEN),
    "phase": ("phase margin", "degrees", "s", ORANGE),
    "sensitivity": ("peak sensitivity", "", "^", RED),
}


def _label(name: str, own: AtFrequency) -> str:
    title, unit, *_ = _NAMES[name]
    return f"{title} {number_text(float(own.value), 3, unit=unit)} at {float(own.frequency):.3g} Hz"


def _nyquist(
    panel: Axes,
    margins: FrequencyMargins,
    _: Floats,
    values: NDArray[np.complex128],
    places: dict[str, complex],
) -> None:
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
    panel.plot(turn.real, turn.imag, ":", color=BLACK, lw=0.8, label="unit circle")
    panel.plot(values.real, values.imag, color=BLUE, lw=1.4, label="L")
    panel.plot(values.real, -values.imag, "--", color=BLUE, lw=0.7)
    panel.plot(-1.0, 0.0, "+", color=RED, ms=10, mew=2)
    peak = float(margins.sensitivity.value)
    if isfinite(peak):
        around = turn / peak - 1.0
        panel.plot(around.real, around.imag, color=RED, lw=0.8)
    for name, (*_, mark, colour) in _NAMES.items():
        if name in places:
            place, words = places[name], _label(name, getattr(margins, name))
            panel.plot(place.real, place.imag, mark, color=colour, mec=BLACK, label=words)
    panel.set(xlabel="Re L", ylabel="Im L", xlim=(-2.5, 1.5), ylim=(-1.6, 2.4))
    panel.set_aspect("equal")
    panel.legend(fontsize=7, frameon=False, loc="upper right")


def _bode(
    panel: Axes,
    margins: FrequencyMargins,
    frequencies: Floats,
    values: NDArray[np.complex128],
    places: dict[str, complex],
) -> None:
    closed = 1.0 + values
    for size, colour, style, name in (
        (values, BLUE, "-", "|L|"),
        (1.0 / closed, RED, "-", "|S|"),
        (values / closed, GREEN, "--", "|T|"),
    ):
        decibels = 20.0 * np.log10(np.maximum(np.abs(size), 1e-12))
        panel.semilogx(frequencies, decibels, style, color=colour, lw=1.2, label=name)
    panel.axhline(0.0, color=BLACK, lw=0.6)
    panel.set(xlabel="frequency (Hz)", ylabel="magnitude (dB)")
    beside = panel.twinx()
    phase = np.degrees(np.unwrap(np.angle(values)))
    beside.plot(frequencies, phase, ":", color=ORANGE, lw=1.4)
    beside.set_ylabel("phase of L (degrees), dotted", color=ORANGE)
    for name, (*_, mark, colour) in _NAMES.items():
        if name in places:
            own = getattr(margins, name)
            size = 1.0 / (1.0 + places[name]) if name == "sensitivity" else places[name]
            height = 20.0 * np.log10(abs(size))
            panel.plot(
                own.frequency, height, mark, color=colour, mec=BLACK, label=_label(name, own)
            )
    panel.legend(fontsize=7, frameon=False, loc="lower left")
