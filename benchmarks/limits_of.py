"""Limits of many loops by ``limits_of``, beside the same loops one by one.

Loops with a window of 20 samples and a delay of 3, of degree 25, give the speed; random loops with
any estimator, filter, delay of 0 to 30 samples and modes are judged, and loops drawn to be hard, of
light devices in stiff or strongly damped hands: ``error`` is the share of
loops whose largest stiffness or damping is not that of ``HapticLoop.limits`` to 1e-9. ``open`` is
the share that the batch leaves to be answered one by one. Seconds are those of CPU, without
compiling; those of a loop by itself are of a part of the loops, stated as ``points``. ``peak_mib``
is the largest resident memory of the process until then, JAX and its compiler included.
"""

import resource
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from time import process_time
from typing import Any

import numpy as np

from benchmarks.record import Row
from benchmarks.timing import interleaved
from jaxstab import Device, Filter, HapticLoop, Mode, Velocity, limits_of, regions_of
from jaxstab.results import ManyLimits, WallLimits

MEASURE = "share of loops whose limits differ by more than 1e-9"
LOOPS = 3000
_FIELDS = 10_000  # loops
_RIGHT = 1e-9
_ONE_BY_ONE = 200  # loops
_WINDOWS = (1, 2, 3, 5, 8, 10, 15, 20)
_PERIOD = 1e-3


def rows(small: bool, points: int | None = None) -> Iterator[Row]:
    rng = np.random.default_rng(33)
    count = 128 if small else points or LOOPS
    yield from _rows("window of 20 samples, delay of 3", [_window(rng) for _ in range(count)])
    yield from _field_rows(rng, 128 if small else _FIELDS)
    if not small:
        yield from _rows("random loops", [random_loop(rng) for _ in range(count)])
        yield from _rows("hard loops", [hard_loop(rng) for _ in range(count)])


def _rows(section: str, loops: list[HapticLoop]) -> Iterator[Row]:
    limits_of(loops)  # compiles
    start = process_time()
    many = limits_of(loops)
    seconds = process_time() - start
    judged = loops[:_ONE_BY_ONE] if "window" in section else loops
    start = process_time()
    alone = [loop.limits() for loop in judged]
    spent = process_time() - start
    wrong = sum(is_wrong(many, index, one) for index, one in enumerate(alone))
    left = float(np.mean(many.is_single))
    yield _row(section, "limits_of", len(loops), seconds, wrong / len(judged), left)
    yield _row(section, "limits, one by one", len(judged), spent, 0.0, 0.0)


def is_wrong(many: ManyLimits, index: int, one: WallLimits) -> bool:
    """Return whether a loop's limits are not those that it has by itself."""
    pairs = (many.stiffness[index], one.stiffness), (many.damping[index], one.damping)
    same = all(np.isclose(*pair, rtol=_RIGHT, atol=0.0, equal_nan=True) for pair in pairs)
    flags = many.status[index] == one.status and many.is_reachable[index] == one.is_reachable
    return not (same and flags)


def _field_rows(rng: np.random.Generator, count: int) -> Iterator[Row]:
    """The paper's loops by arrays of fields; ``loops_per_second`` are of wall time."""
    loop = HapticLoop(device_mass=0.1, device_damping=0.1, sample_time=_PERIOD, delay=_PERIOD)
    fields = {
        "device_mass": 10 ** rng.uniform(-1.3, 0.3, count),
        "device_damping": 10 ** rng.uniform(-3, 1, count),
        "hand_stiffness": rng.choice([0.0, 1.0], count) * 10 ** rng.uniform(0, 3.5, count),
    }
    calls = {one.__name__: partial(one, loop, **fields) for one in (limits_of, regions_of)}
    rows = zip(*(values.tolist() for values in fields.values()), strict=True)
    judged = islice((dict(zip(fields, row, strict=True)) for row in rows), _ONE_BY_ONE)
    alone = [replace(loop, **row).limits() for row in judged]
    for method, timing in interleaved(calls, budget=5.0).items():
        limits = timing.answer if method == "limits_of" else timing.answer.limits
        wrong = float(np.mean([is_wrong(limits, index, one) for index, one in enumerate(alone)]))
        left, seconds = float(np.mean(limits.is_single)), timing.columns()["cpu_seconds"]
        row = _row("loops of the paper", method, count, seconds, wrong, left)
        yield row | {"delay": 1.0, "loops_per_second": count / timing.median}


def _row(section: str, method: str, count: int, seconds: float, wrong: float, left: float) -> Row:
    return {
        "section": section,
        "method": method,
        "delay": 3.0,
        "points": count,
        "seconds": seconds,
        "seconds_quartiles": [seconds, seconds],
        "repeats": 1,
        "error": wrong,
        "error_measure": MEASURE,
        "open": left,
        "loops_per_cpu_second": count / seconds,
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def _window(rng: np.random.Generator) -> HapticLoop:
    return HapticLoop(
        device_mass=float(10 ** rng.uniform(-1.3, 0.3)),
        device_damping=float(10 ** rng.uniform(-3, 1)),
        hand_stiffness=float(rng.choice([0.0, 10 ** rng.uniform(0, 3.5)])),
        sample_time=_PERIOD,
        delay=3 * _PERIOD,
        velocity=Velocity.difference(samples=20),
    )


def random_loop(rng: np.random.Generator) -> HapticLoop:
    """Return a loop as it may be in a laboratory, with any estimator and delay."""
    delay = float(rng.choice([float(rng.integers(0, 31)), rng.uniform(0, 30), rng.uniform(0, 4)]))
    mass, damping = float(10 ** rng.uniform(-1.5, 0.5)), float(10 ** rng.uniform(-3, 1))
    shared: dict[str, Any] = {
        "sample_time": _PERIOD,
        "delay": delay * _PERIOD,
        "velocity": _estimator(rng),
        "position": _position(rng),
    }
    if rng.uniform() < 0.25:
        mode = Mode(
            frequency=float(rng.uniform(20, 300)),
            damping_ratio=float(10 ** rng.uniform(-2.5, -0.5)),
            modal_mass=mass * float(10 ** rng.uniform(-0.5, 1.5)),
        )
        return HapticLoop(device=Device.modes([mode], mass=mass, damping=damping), **shared)
    return HapticLoop(
        device_mass=mass,
        device_damping=damping,
        hand_damping=float(rng.choice([0.0, 10 ** rng.uniform(-1, 1.5)])),
        hand_stiffness=float(rng.choice([0.0, 10 ** rng.uniform(0, 3.5)])),
        **shared,
    )


def hard_loop(rng: np.random.Generator) -> HapticLoop:
    """Return a loop whose stable set has many pieces, islands or thin parts more often."""
    delay = float(rng.choice([float(rng.integers(0, 13)), rng.uniform(0, 12)]))
    return HapticLoop(
        device_mass=float(10 ** rng.uniform(-2.0, -0.5)),
        device_damping=float(10 ** rng.uniform(-4, 0)),
        hand_damping=float(rng.choice([0.0, 10 ** rng.uniform(0.5, 2)])),
        hand_stiffness=float(rng.choice([0.0, 10 ** rng.uniform(2, 4.5)])),
        sample_time=_PERIOD,
        delay=delay * _PERIOD,
        velocity=_estimator(rng),
        position=_position(rng),
    )


def _estimator(rng: np.random.Generator) -> Velocity:
    cutoff = float(10 ** rng.uniform(1.2, 2.5))
    kind = rng.integers(4)
    if kind == 0:
        return Velocity.low_pass(cutoff, order=int(rng.integers(1, 3)))
    if kind == 1:
        return Velocity.butterworth(cutoff, order=int(rng.integers(2, 5)))
    return Velocity.difference(samples=int(rng.choice(_WINDOWS)))


def _position(rng: np.random.Generator) -> Filter | None:
    kind = rng.integers(8)
    if kind == 0:
        return Filter.average(samples=int(rng.integers(2, 6)))
    if kind == 1:
        return Filter.low_pass(float(10 ** rng.uniform(1.5, 2.5)), order=1)
    return None
