"""Draw docs/traces.png: the largest stable stiffness over delays, for three velocity estimators."""

from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure

from jaxstab import HapticLoop, Velocity, trace_boundary
from jaxstab.drawing import BLACK, BLUE, ORANGE
from jaxstab.region.pieces import Branch

DAMPING = 10.0  # of the wall, in N s/m
WINDOW = (0.0, 4e-3), (0.0, 1e4)  # delay in s, stiffness in N/m
ESTIMATORS = {
    "difference over one sample": (Velocity(), BLACK, "-"),
    "low pass at 100 Hz": (Velocity.low_pass(100.0), BLUE, "--"),
    "window of 20 samples": (Velocity.difference(samples=20), ORANGE, "-."),
}


def picture() -> Figure:
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    panel = figure.subplots()
    for name, (velocity, color, style) in ESTIMATORS.items():
        loop = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3, velocity=velocity)
        trace = trace_boundary(
            ("time_delay", "stiffness"), WINDOW, loop=loop, damping=DAMPING, resolution=1 / 128
        )
        is_drawn = trace.edge & (trace.branch == Branch.CURVE)
        for piece in np.unique(trace.piece[is_drawn]):
            points = np.where(is_drawn[:, None], trace.points * (1e3, 1e-3), np.nan)
            label = name if piece == trace.piece[is_drawn].min() else None
            panel.plot(
                *points[trace.piece == piece].T, style, color=color, label=label, linewidth=1.8
            )
    panel.set(xlim=(0.0, 1e3 * WINDOW[0][1]), ylim=(0.0, 1e-3 * WINDOW[1][1]))
    panel.set_xlabel("delay (ms)")
    panel.set_ylabel("largest stable stiffness K (kN/m)")
    panel.set_title("0.25 kg, 0.1 N s/m, 1 kHz, wall damping 10 N s/m", fontsize=10)
    panel.grid(visible=True, color="#dddddd", linewidth=0.6)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(frameon=False)
    return figure


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    picture().savefig(Path(__file__).with_name("traces.png"), dpi=110)
