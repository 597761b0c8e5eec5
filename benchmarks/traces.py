"""Traces over delay and stiffness for three estimators, beside the limits of single loops.

An omega-like device renders a wall of some damping at 1 kHz. ``trace_boundary`` traces the
stiffness where a root is on the circle, over all delays up to 4 ms, fractions of a sample included.
At some points of the boundary, the stiffness is compared with ``HapticLoop.stiffness_limits`` of
the loop with that delay, which comes from the closed form of the curve in the plane of stiffness
and damping. The picture of the docs is drawn from the same traces.
"""

from collections.abc import Mapping
from pathlib import Path
from time import process_time

import numpy as np
from matplotlib.figure import Figure

from jaxstab import HapticLoop, Velocity, trace_boundary
from jaxstab.pictures.style import BLACK, BLUE, ORANGE
from jaxstab.region.pieces import Branch
from jaxstab.results import BoundaryTrace, TraceStatus

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "traces.png"
DEVICE = {"device_mass": 0.25, "device_damping": 0.1, "sample_time": 1e-3}
DAMPING = 10.0  # of the wall, in N s/m
WINDOW = (0.0, 4e-3), (0.0, 1e4)  # delay in s, stiffness in N/m
ESTIMATORS = {
    "difference over one sample": (Velocity(), BLACK, "-"),
    "low pass at 100 Hz": (Velocity.low_pass(100.0), BLUE, "--"),
    "window of 20 samples": (Velocity.difference(samples=20), ORANGE, "-."),
}
_RIGHT = 1e-9


def main(small: bool) -> int:
    """Print how the traces compare with the limits, and draw them; the number of wrong points."""
    rng, wrong = np.random.default_rng(33), 0
    traces = {}
    for name, (velocity, *_) in ESTIMATORS.items():
        start = process_time()
        traces[name] = trace = traced(velocity, 1 / 16 if small else 1 / 128)
        seconds = process_time() - start
        apart = differences(trace, velocity, rng, 4 if small else 50)
        wrong += int(np.sum(~(apart < _RIGHT)))
        state = f"{np.mean(trace.status == TraceStatus.CONVERGED):.0%} converged"
        print(
            f"{name}: {len(trace.points)} points, {state}, {seconds:.1f} CPU s; "
            f"largest difference from limits {np.max(apart):.1e}"
        )
    if not small:
        picture(traces)
    return wrong


def traced(velocity: Velocity, resolution: float) -> BoundaryTrace:
    """Return the boundary over delay and stiffness with an estimator."""
    loop = HapticLoop(**DEVICE, velocity=velocity)
    plane = "time_delay", "stiffness"
    trace: BoundaryTrace = trace_boundary(
        plane, WINDOW, loop=loop, damping=DAMPING, resolution=resolution
    )
    return trace


def differences(
    trace: BoundaryTrace, velocity: Velocity, rng: np.random.Generator, count: int
) -> np.ndarray:
    """Return relative differences of the boundary from the limits of loops with its delays."""
    points = trace.points[trace.edge & (trace.branch == Branch.CURVE)]
    apart = []
    for delay, stiffness in rng.permutation(points)[:count].tolist():
        loop = HapticLoop(**DEVICE, delay=max(delay, 0.0), velocity=velocity)
        apart.append(np.min(np.abs(loop.stiffness_limits(DAMPING) / stiffness - 1.0)))
    return np.array(apart)


def picture(traces: Mapping[str, BoundaryTrace], path: Path = PICTURE) -> None:
    """Draw where the boundary bounds the stable walls."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    panel = figure.subplots()
    for name, trace in traces.items():
        _, color, style = ESTIMATORS[name]
        is_drawn = trace.edge & (trace.branch == Branch.CURVE)
        for piece in np.unique(trace.piece[is_drawn]):
            delay, stiffness = np.where(is_drawn[:, None], trace.points * (1e3, 1e-3), np.nan)[
                trace.piece == piece
            ].T
            panel.plot(delay, stiffness, style, color=color, label=name, linewidth=1.8)
            name = "_"  # one entry of the legend for all pieces
    panel.set(xlim=(0.0, 1e3 * WINDOW[0][1]), ylim=(0.0, 1e-3 * WINDOW[1][1]))
    panel.set_xlabel("delay (ms)")
    panel.set_ylabel("largest stable stiffness K (kN/m)")
    panel.set_title("0.25 kg, 0.1 N s/m, 1 kHz, wall damping 10 N s/m", fontsize=10)
    panel.grid(visible=True, color="#dddddd", linewidth=0.6)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(frameon=False)
    figure.savefig(path, dpi=110)
