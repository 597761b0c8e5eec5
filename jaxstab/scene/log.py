"""A log of a device: its columns, the step of its encoder, and the estimator of its velocity.

A log is a CSV file with a header and one row for each sample. An encoder reads multiples of a step,
which the smallest difference of two readings tells. The velocity that software logs beside it
follows from the readings, by a window or a low pass: each window is tried, and a low pass is fitted
by a linear regression for its factor. The one with the smaller error is taken.
"""

from dataclasses import dataclass
from math import log, pi

import numpy as np

from jaxstab.model import Velocity
from jaxstab.scene.identified import Rows
from jaxstab.tables import columns_of


@dataclass(frozen=True)
class Log:
    """The columns of a log in SI units, and its sampling period in s."""

    sample_time: float
    force: Rows
    position: Rows
    velocity: Rows | None


def read_log(
    file: str, names: dict[str, str], sample_time: float | None, needs_velocity: bool
) -> Log:
    """Read a log by the names of its columns; ValueError if it is bad or its time steps differ."""
    needed = ["force", "position", *(["time"] if sample_time is None else [])]
    optional = [] if needs_velocity else [names["velocity"]]
    needed += ["velocity"] if needs_velocity else []
    table = columns_of(file, [names[key] for key in needed], optional)
    columns = {key: np.array(table[name]) for key, name in names.items() if name in table}
    unequal = 0.1  # of a sample: the most that a time step may differ from the mean
    if sample_time is None:
        steps = np.diff(columns["time"])
        sample_time = float(np.mean(steps)) if len(steps) else 0.0
        odd = np.flatnonzero(~(abs(steps - sample_time) <= unequal * sample_time))
        if len(odd) or not sample_time > 0.0:
            line = int(odd[0]) + 3 if len(odd) else 3
            raise ValueError(
                f"{file}, line {line}: the time does not grow by the mean step of "
                f"{sample_time:.6g} s; give a log with equal steps, or --sample-time if no row is "
                "missing."
            )
    return Log(sample_time, columns["force"], columns["position"], columns.get("velocity"))


def resolution_of(positions: Rows) -> float | None:
    """Return the step of which positions are multiples, up to a constant offset."""
    places = np.unique(positions)
    if len(places) < 2:
        return None
    step = float(np.diff(places).min())
    most = float(np.rint((places[-1] - places[0]) / step))
    if most > 2.0**31:  # counts of no encoder: such steps are rounding of float64
        return None
    step = float(places[-1] - places[0]) / most
    counts = (places - places[0]) / step
    return step if np.all(abs(counts - np.rint(counts)) < 0.1) else None


def estimator_of(
    positions: Rows, velocity: Rows | None, period: float
) -> tuple[Velocity | None, float]:
    """Return the window or the low pass that fits velocities best, and its relative error."""
    if velocity is None:
        return None, 0.0
    longest_window = 200  # samples
    late = slice(longest_window, None)
    differences = np.diff(positions, prepend=positions[0]) / period
    guesses: list[tuple[float, Velocity]] = []

    def guess(estimator: Velocity, values: Rows) -> None:
        guesses.append((float(np.mean((values - velocity)[late] ** 2)), estimator))

    for samples in range(1, longest_window + 1):
        values = np.zeros_like(positions)
        values[samples:] = (positions[samples:] - positions[:-samples]) / (samples * period)
        guess(Velocity.difference(samples=samples), values)
    # v_k - d_k = q (v_(k-1) - d_k) of a low pass is linear in q.
    before, now = velocity[:-1] - differences[1:], velocity[1:] - differences[1:]
    share = float(before @ now) / max(float(before @ before), np.finfo(float).tiny)
    if 0.0 < share < 1.0:
        values = velocity.copy()
        for row in range(1, len(values)):
            values[row] = share * values[row - 1] + (1.0 - share) * differences[row]
        guess(Velocity.low_pass(-log(share) / (2.0 * pi * period)), values)
    error, best = min(guesses, key=lambda guess: guess[0])
    return best, float(np.sqrt(error / max(np.mean(velocity[late] ** 2), np.finfo(float).tiny)))
