"""Margins of loops with estimators, filters and devices, against balls.

The loops are those of ``benchmarks.truth.random_loops``: windows, low passes, Butterworth filters,
exponential smoothing, transfer functions and chains of them; hands without damping, too; delays of
0 to 30 samples with fractions; devices with modes, grips and motors. Walls lie in all components of
the stable set, islands too, half of them next to the boundary. A margin is wrong where a wall
within it is unstable, and short where the wall is stable farther by a millionth of the way and by
1e-9 of the region's size.
"""

from collections.abc import Iterator, Sequence
from time import process_time
from typing import NamedTuple

import numpy as np

from benchmarks.truth.balls import BallLoop
from benchmarks.truth.filtered import FilteredLoop
from benchmarks.truth.plain import Loop
from benchmarks.truth.random_loops import DeviceLoop, MassLoop
from jaxstab.conventions import Verdict
from jaxstab.loop.margins import WAYS, crossings_of, first_crossings
from jaxstab.model.filters import given_filters
from jaxstab.results import StableRegion

_PARTS = (0.3, 0.9, 1.0 - 1e-9)  # of the way, judged
_DELAY_PARTS = (0.1, 0.37, 0.71, 0.93, 1.0 - 1e-9)
_FARTHER = 1e-6  # of the way
_SHARE = 1e-9  # of the region's size
_FARTHEST_DELAY = 20.0


class Tally(NamedTuple):
    """How many claims were judged, are wrong, and fall short."""

    judged: int = 0
    wrong: int = 0
    short: int = 0

    def __add__(self, other: "Tally") -> "Tally":  # type: ignore[override]
        return Tally(*(a + b for a, b in zip(self, other, strict=True)))


class Campaign(NamedTuple):
    """Totals, and CPU seconds of each question."""

    tally: Tally
    seconds: list[float]


def margins(rng: np.random.Generator, count: int) -> Campaign:
    """Judge the margins of walls of random loops with filters."""
    tally, seconds = Tally(), []
    for loop, region in _loops(rng, MassLoop, count):
        filters = given_filters(*loop.filters[:2])
        wall = _wall(rng, region)
        start = process_time()
        code, *found = first_crossings(np.array([[*wall, *loop.plant]]), filters)[0]
        seconds.append(process_time() - start)
        if code == Verdict.STABLE:
            tally += _judged_steps(loop, wall, steps_to(found[::2], wall), region)
    return Campaign(tally, seconds)


def device_margins(rng: np.random.Generator, count: int) -> Campaign:
    """Judge the margins of walls of random devices with filters."""
    tally, seconds = Tally(), []
    for loop, region in _loops(rng, DeviceLoop, count):
        wall = _wall(rng, region)
        units = np.array([loop.sampled.stiffness_unit, loop.sampled.damping_unit])
        start = process_time()
        code, *found = crossings_of(Loop.of(loop).loop, tuple((wall / units).tolist()))
        seconds.append(process_time() - start)
        if code == Verdict.STABLE:
            ends = np.array(found[::2]) * [*np.repeat(units, 2), 1.0]
            *steps, later = steps_to(ends, wall)
            tally += _judged_delay(loop, wall, float(later))
            size = np.ptp(_finite(region), axis=0)
            for way, step in enumerate(steps):
                tally += _judged_gain(loop.balls, wall, way // 2, float(step), size[way // 2])
    return Campaign(tally, seconds)


def steps_to(ends: Sequence[float], wall: np.ndarray) -> np.ndarray:
    """The signed steps from a wall (alpha, beta) to the ends of its ways."""
    return np.array(ends) - [*np.repeat(wall[:2], 2), 0.0]


def _loops(
    rng: np.random.Generator, kind: type[MassLoop] | type[DeviceLoop], count: int
) -> Iterator[tuple[MassLoop, StableRegion]]:
    """Yield random loops that have filters and a region."""
    given = 0
    while given < count:
        loop = kind.drawn(rng)
        if given_filters(*loop.filters[:2]) is None:
            continue
        region = loop.region()
        if region.status.name == "COMPLETE" and len(_finite(region)) > 2:
            given += 1
            yield loop, region


def _finite(region: StableRegion) -> np.ndarray:
    return region.points[np.isfinite(region.points).all(axis=1)]


def _wall(rng: np.random.Generator, region: StableRegion) -> np.ndarray:
    """Return a wall in or near a component, half of the walls next to the boundary."""
    components = region.components
    points = _finite(components[rng.integers(len(components))])
    one, other = points[rng.integers(len(points), size=2)]
    wall: np.ndarray = one + rng.choice([rng.uniform(), 10 ** rng.uniform(-9, -1)]) * (other - one)
    return wall


def _judged_steps(
    loop: MassLoop, wall: np.ndarray, steps: np.ndarray, region: StableRegion
) -> Tally:
    tally, size = Tally(), np.ptp(_finite(region), axis=0)
    for (axis, _), step in zip(WAYS[:-1], steps, strict=False):
        tally += _judged_gain(loop.balls, wall, axis, float(step), size[axis])
    gamma, delta, delay = loop.plant
    way = min(steps[-1], _FARTHEST_DELAY)
    for part in _PARTS:
        later = FilteredLoop(gamma, delta, float(delay + part * way), *loop.filters.truths)
        is_stable = later.balls().is_stable(*map(float, wall))
        if is_stable is not None:
            tally += Tally(1, int(not is_stable))
    return tally


def _judged_delay(loop: DeviceLoop, wall: np.ndarray, step: float) -> Tally:
    """Judge an extra delay."""

    def is_stable(way: float) -> bool | None:
        balls = loop.balls_at(float(loop.device.delay + way))
        return balls.is_stable(*map(float, wall))

    within = [is_stable(part * min(step, _FARTHEST_DELAY)) for part in _DELAY_PARTS]
    farther = min(step * (1.0 + _FARTHER), _FARTHEST_DELAY) + _SHARE
    is_short = step < _FARTHEST_DELAY and is_stable(farther) is True
    return Tally(
        sum(one is not None for one in within), sum(one is False for one in within), int(is_short)
    )


def _judged_gain(balls: BallLoop, wall: np.ndarray, axis: int, step: float, size: float) -> Tally:
    def is_stable(way: float) -> bool | None:
        moved = wall.copy()
        moved[axis] += way
        return balls.is_stable(*map(float, moved))

    within = [is_stable(part * step) for part in _PARTS]
    farther = step + np.copysign(max(_FARTHER * abs(step), _SHARE * size), step)
    return Tally(
        sum(one is not None for one in within),
        sum(one is False for one in within),
        int(is_stable(farther) is True),
    )
