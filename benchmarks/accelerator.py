"""Dense grids whose arrays stay on the device: an accelerator beside two cores of its machine.

Each side is a process of its own, since JAX chooses the device when it starts: first one with two
cores of the CPU, then one with the device that JAX prefers, which is the CPU again where there is
no other. A call takes arrays of JAX and ends when its result is on the device. ``error`` is the
share of answers that the two sides prove and that contradict each other: verdicts of walls within
1e-16 to 1e-8 of the boundary, radii apart by more than both bounds.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any, NamedTuple
from unittest.mock import patch

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.timing import interleaved

DELAYS = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0)
RADII = (1.0, 2.0, 5.0, 20.0)
MEASURE = "share of proved answers that contradict those of two cores"
PLANT = {"gamma": 1e-3, "delta": 0.015}
_CORES = 2
_HOST_POINTS, _DEVICE_POINTS = 4e6, 1e8
_SHARES = {"spectral_radius": 0.1}  # of the points
_JUDGED = 1 << 15
_WINDOW = 20  # samples

Call = Callable[[], Any]


class Task(NamedTuple):
    """What is timed, on so many points, and what is judged."""

    section: str
    delay: float
    points: int
    timed: Call
    judged: Call


def rows(small: bool) -> Iterator[Row]:
    host, device = (_of_process(small, is_host=is_host) for is_host in (True, False))
    for (one, known), (other, new) in zip(host, device, strict=True):
        ratio = one["seconds_per_point"] / other["seconds_per_point"]
        yield one | {"times_two_cores": 1.0}
        yield other | {"error": _contradictions(known, new), "times_two_cores": ratio}


def _of_process(small: bool, *, is_host: bool) -> list[tuple[Row, np.ndarray]]:
    """Return the rows of one side and the answers that are judged, from a process of its own."""
    points = 4e4 if small else _HOST_POINTS if is_host else _DEVICE_POINTS
    cores = sorted(os.sched_getaffinity(0))[:_CORES] if is_host else []
    flags = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"} | ({"JAX_PLATFORMS": "cpu"} if cores else {})
    with patch.dict(os.environ, flags), ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(_measured, points, cores).result()


def _measured(points: float, cores: list[int]) -> list[tuple[Row, np.ndarray]]:
    if cores:
        os.sched_setaffinity(0, cores)  # before JAX starts its threads
    name = f"{_CORES} cores" if cores else jax.devices()[0].device_kind
    tasks = list(_tasks(points))
    answers = [np.asarray(task.judged()) for task in tasks]
    calls = {f"{task.section} {task.delay:g}": task.timed for task in tasks}
    timings = interleaved(calls, budget=0.5 if points > 1e5 else 0.05, most=20)
    found = [
        timing.row(
            task.section,
            name,
            0.0,
            MEASURE,
            delay=task.delay,
            points=task.points,
            seconds_per_point=timing.median / task.points,
        )
        for task, timing in zip(tasks, timings.values(), strict=True)
    ]
    return list(zip(found, answers, strict=True))


def _contradictions(known: np.ndarray, new: np.ndarray) -> float:
    if known.ndim == 1:  # codes of verdicts
        is_decided = (known != 3) & (new != 3)
        return float(np.mean(is_decided & (known != new)))
    (value, error), (own, bound) = known, new
    return float(np.mean(abs(value - own) > error + bound))


def _tasks(points: float) -> Iterator[Task]:
    def task(
        section: str, delay: float, call: Call, gains: tuple[float, float], velocity: Any = None
    ) -> Task:
        side = int((points * _SHARES.get(section, 1.0)) ** 0.5)
        alpha, beta = (jnp.linspace(0.0, most, side) for most in gains)
        timed = partial(call, alpha, beta[:, None])
        return Task(section, delay, side**2, timed, partial(call, *_near_boundary(delay, velocity)))

    def radius(*gains: Any, delay: float) -> Any:
        answer = jaxstab.spectral_radius(*gains, **PLANT, delay=delay)
        return answer.value, answer.error

    few = 1 if points < 1e5 else None
    for delay in DELAYS[:few]:
        verdict = partial(jaxstab.verdict, **PLANT, delay=delay)
        yield task("verdict", delay, verdict, (2.0 / (1.0 + delay) ** 2, 1.5 / (1.0 + delay)))
    window = jaxstab.Velocity.difference(samples=_WINDOW)
    in_window = jax.jit(partial(jaxstab.verdict, **PLANT, delay=1.0, velocity=window))
    yield task(f"window of {_WINDOW} samples", 1.0, in_window, (0.01, 0.1), window)
    for delay in RADII[:few]:
        gains = 2.0 / (1.0 + delay) ** 2, 1.5 / (1.0 + delay)
        yield task("spectral_radius", delay, partial(radius, delay=delay), gains)


def _near_boundary(delay: float, velocity: Any = None) -> tuple[Any, Any]:
    rng = np.random.default_rng(33)
    loop = jaxstab.HapticLoop(
        device_mass=1.0,
        device_damping=PLANT["delta"],
        hand_stiffness=PLANT["gamma"],
        sample_time=1.0,
        delay=delay,
        velocity=velocity,
    )
    region = loop.region()
    damping = region.most_damped.damping * rng.uniform(0.01, 0.99, _JUDGED // 64)
    limits = np.repeat(region.stiffness_limits(damping)[:, 1], 64)
    aside = rng.choice([-1.0, 1.0], limits.size) * 10.0 ** rng.uniform(-16.0, -8.0, limits.size)
    return jnp.asarray(limits * (1.0 + aside)), jnp.asarray(np.repeat(damping, 64))
