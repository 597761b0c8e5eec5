"""The picture of a fitted log: measured and fitted positions, and the residual over time."""

import numpy as np
from matplotlib.figure import Figure

from jaxstab.pictures.style import BLUE, ORANGE, RED
from jaxstab.scene.identify import HISTORY, Identified
from jaxstab.scene.scene import Units

_SIZE = (7.0, 4.6)  # inches


def identified_figure(device: Identified, units: Units) -> Figure:
    """Return the first two segments, and the residual of the whole log."""
    figure = Figure(figsize=_SIZE, layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=[3, 2])
    milli, micro = f"m{units.length}", f"u{units.length}"
    times = device.sample_time * (HISTORY + np.arange(device.measured.size))
    shown = slice(2 * device.measured.shape[1])
    measured, fitted = np.ravel(device.measured), np.ravel(device.fitted)
    above.plot(times[shown], 1e3 * measured[shown], color=ORANGE, lw=3.5, label="measured")
    above.plot(times[shown], 1e3 * fitted[shown], "--", color=BLUE, lw=1.4, label="fitted")
    for begin in times[: shown.stop : device.measured.shape[1]]:
        above.axvline(begin, color="0.75", lw=0.8, zorder=0)
    above.set(xlabel="time (s)", ylabel=f"position ({milli})")
    above.set_title("first two segments, each with a fitted initial position and velocity")
    above.title.set_fontsize(9)
    above.legend(fontsize=8, loc="upper right", framealpha=0.9)
    below.plot(times, 1e6 * (measured - fitted), ".", color=RED, ms=1.0, rasterized=True)
    if device.resolution:
        for side in (-0.5, 0.5):
            label = "half a step of the encoder" if side > 0.0 else ""
            below.axhline(side * 1e6 * device.resolution, color=BLUE, lw=1.0, label=label)
        below.legend(fontsize=8, loc="upper right", framealpha=0.9)
    top = 1.7 * float(abs(measured - fitted).max()) * 1e6  # room for the legend
    below.set(ylim=(-top / 1.5, top), xlabel="time (s)", ylabel=f"residual ({micro})")
    return figure
