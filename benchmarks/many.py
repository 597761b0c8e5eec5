"""Limits of many loops of about degree 25 by one program, of each kind, and of loops one by one.

Each round draws new loops, so that nothing of them is remembered; the first, in which the program
is compiled, is not counted. ``error`` is the largest relative difference from what balls prove.
"""

from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Any

import numpy as np

import jaxstab
from benchmarks import record
from benchmarks.record import Row
from jaxstab import Device, HapticLoop

_MANY, _LEAST, _FEW, _ROUNDS = 4096, 400, 10, 6  # of the least a program is made
_T = 1e-3
_MEASURE = "largest relative difference from limits that balls prove"


def rows(small: bool) -> Iterator[Row]:
    rng, count = np.random.default_rng(25), _LEAST if small else _MANY
    kinds = list(KINDS.items())  # each is a program to compile
    for kind, draw in kinds[:2] if small else kinds:
        times, errors = [], []
        for _ in range(2 if small else _ROUNDS):
            delays = rng.integers(18, 22, count).astype(float).tolist()
            loops = list(map(draw, *rng.uniform(0.1, 0.5, (2, count)).tolist(), delays))
            start = perf_counter()
            found = jaxstab.limits_of(loops)
            middle = perf_counter()
            alone = [loop.limits()[0] for loop in loops[:_FEW]]
            times.append(((middle - start) / count, (perf_counter() - middle) / _FEW))
            ratios = found[0][:_FEW] / [getattr(one, "value", one) for one in alone]
            errors.append(float(np.max(np.abs(ratios - 1.0))))
        together, apart = np.transpose(times[1:])
        yield record.row(kind, "limits_of", together, max(errors), _MEASURE, points=count)
        yield record.row(kind, "limits", apart, 0.0, _MEASURE, points=_FEW)


def _held(mass: float, damping: float, delay: float) -> HapticLoop:
    return HapticLoop(device_mass=mass, device_damping=damping, sample_time=_T, delay=delay * _T)


def _coupled(mass: float, damping: float, delay: float, other: Device) -> jaxstab.Loop:
    device = Device.mass_spring_damper(mass, damping=damping)
    return jaxstab.coupling(device, other, sample_time=_T, delays_samples=(delay, delay))


KINDS: dict[str, Callable[[float, float, float], Any]] = {
    "walls": lambda mass, damping, delay: _held(mass, damping, delay + 1.0),
    "simulators": lambda mass, damping, delay: jaxstab.simulated_pd(
        mass, step=0.5 * _T, damping=damping, substeps=2, delay_steps=2 * round(delay)
    ),
    "PID, kp and ki": lambda *own: jaxstab.pid(_held(*own), kd=2.0),
    "PID, kp and kd": lambda *own: jaxstab.pid(_held(*own), ki=10.0),
    "couplings": lambda *own: _coupled(*own, Device.simulated(0.2 * own[0], step=_T)),
    "two devices": lambda *own: _coupled(*own, Device.mass_spring_damper(own[1], damping=own[0])),
}
