"""A mass with friction under commanded forces, from force to force in closed form, and its log.

Nothing is shared with jaxstab: the velocity under a constant force is an exponential, solved for
the instant at which it is 0. ``python docs/pushed.py log.csv`` writes the log of the page "Measure
mass, friction, delay and estimator".
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, log1p
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Pushed:
    """A device in SI units, its controller, and how strongly it is excited.

    A random force of one size or the other is held for so many samples; a soft spring of the
    software, which sees the encoder, keeps the handle near 0.
    """

    mass: float = 0.25
    damping: float = 0.5
    friction: float = 0.3
    offset: float = 0.05
    delay: float = 1.37e-3
    period: float = 1e-3
    encoder: float = 1e-5
    size: float = 1.0
    held: int = 20
    spring: float = 60.0


@dataclass(frozen=True)
class Log:
    """Times in s, commanded forces in N and measured positions in m."""

    time: np.ndarray
    force: np.ndarray
    position: np.ndarray


def moved(device: Pushed, x: float, v: float, force: float, time: float) -> tuple[float, float]:
    """Return position and velocity after a time under a constant force."""
    m, b = device.mass, device.damping
    others = force - device.offset
    while True:
        sign = float(np.sign(v if v else others))
        if v == 0.0 and abs(others) <= device.friction:
            return x, 0.0
        final = (others - sign * device.friction) / b  # velocity
        stops = -v / final if final else inf
        until = m / b * log1p(stops) if 0.0 < stops < inf else inf
        # The velocity v + (final - v)(1 - e^(-b t/m)) is 0 where e^(b t/m) = 1 - v/final.
        step = min(until, time)
        share = exp(-b / m * step)
        x += final * step + (v - final) * m / b * (1.0 - share)
        v = final + (v - final) * share
        if until >= time:
            return x, v
        v, time = 0.0, time - until


def run(device: Pushed, rows: int, seed: int) -> Log:
    """Simulate a log: exact motion, rounded positions."""
    rng = np.random.default_rng(seed)
    levels = np.repeat(device.size * rng.choice([-1.0, 1.0], -(-rows // device.held)), device.held)
    period, phase = device.period, rng.uniform()
    whole, fraction = divmod(device.delay / period, 1.0)
    x, v, forces, positions = 0.0, 0.0, [0.0] * (int(whole) + 1), []
    for level in levels[:rows]:
        read = device.encoder * round(x / device.encoder + phase)
        positions.append(read)
        forces.append(float(level) - device.spring * read)
        x, v = moved(device, x, v, forces[-2 - int(whole)], fraction * period)
        x, v = moved(device, x, v, forces[-1 - int(whole)], (1.0 - fraction) * period)
    force = np.array(forces[int(whole) + 1 :])
    return Log(period * np.arange(rows), force, np.array(positions))


def as_csv(log: Log, **columns: Sequence[float] | np.ndarray) -> str:
    """Return a log as a table with a header; further columns by their names."""
    table = {"time": log.time, "force": log.force, "position": log.position, **columns}
    rows = zip(*table.values(), strict=True)
    return "\n".join([",".join(table), *(",".join(f"{x:.9g}" for x in row) for row in rows), ""])


def difference(log: Log, samples: int) -> np.ndarray:
    """Return the difference over a window, from rest."""
    padded = np.concatenate([np.full(samples, log.position[0]), log.position])
    return (padded[samples:] - padded[:-samples]) / (samples * (log.time[1] - log.time[0]))


if __name__ == "__main__":
    made = run(Pushed(), 10_000, 0)
    Path(sys.argv[1]).write_text(as_csv(made, velocity=difference(made, 20)), encoding="utf-8")
