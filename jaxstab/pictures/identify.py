"""The picture of a fitted log: measured and fitted positions, and what is left over time."""

import numpy as np
from matplotlib.figure import Figure

from jaxstab.pictures.style import BLUE, ORANGE, RED
from jaxstab.scene.identify import HISTORY, Identified
from jaxstab.scene.scene import Units

_SIZE = (7.0, 4.6)  # inches


def identified_figure(found: Identified, units: Units) -> Figure:
    """Return the first two segments, and the residual of the whole log."""
    figure = Figure(figsize=_SIZE, layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=[3, 2])
    milli, micro = f"m{units.length}", f"u{units.length}"
    times = found.sample_time * (HISTORY + np.arange(found.measured.size))
    shown = slice(2 * found.measured.shape[1])
    measured, fitted = np.ravel(found.measured), np.ravel(found.fitted)
    above.plot(times[shown], 1e3 * measured[shown], color=ORANGE, lw=3.5, label="measured")
    above.plot(times[shown], 1e3 * fitted[shown], "--", color=BLUE, lw=1.4, label="fitted")
    for begin in times[: shown.stop : found.measured.shape[1]]:
        above.axvline(begin, color="#bbbbbb", lw=0.8, zorder=0)
    above.set(xlabel="time in s", ylabel=f"position in {milli}")
    above.set_title("the first two segments; each begins with its own position and velocity")
    above.title.set_fontsize(9)
    above.legend(fontsize=8, loc="upper right", framealpha=0.9)
    below.plot(times, 1e6 * (measured - fitted), ".", color=RED, ms=1.0, rasterized=True)
    if found.resolution:
        for side in (-0.5, 0.5):
            label = "half a step of the encoder" if side > 0.0 else ""
            below.axhline(side * 1e6 * found.resolution, color=BLUE, lw=1.0, label=label)
        below.legend(fontsize=8, loc="upper right", framealpha=0.9)
    top = 1.7 * float(abs(measured - fitted).max()) * 1e6  # room for the legend
    below.set(ylim=(-top / 1.5, top), xlabel="time in s", ylabel=f"residual in {micro}")
    return figure
