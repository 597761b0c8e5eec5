"""The largest sample time and the largest delay that allow a wanted stiffness."""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isfinite, nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.conventions import Status
from jaxstab.loop import Gains, HapticLoop
from jaxstab.model.filters import LONGEST_WINDOW
from jaxstab.scene.answers import (
    Answer,
    Basis,
    Damping,
    LargestStiffness,
    LargestTime,
    Number,
    Stiffness,
    basis_of,
)
from jaxstab.scene.check import at_lowest
from jaxstab.scene.loops import loop_of, reachable, wall_region
from jaxstab.scene.scene import Scene

_AGREEMENT = 1e-8  # relative, of a designed sample time or delay
_MOST_SAMPLES = 256.0  # of delay that are tried
_FACTOR = 1024.0  # by which the sample times that are tried are longer or shorter
_NO_DELAY = 1e-3  # samples: less than this is tried as none at first
_AROUND, _POINTS = (0.6, 1.6), 33  # of a picture: shares of its shortest and longest value

Floats = NDArray[np.float64]


class DesignStatus(Status):
    """What is known of a largest sample time or delay."""

    FOUND = 1, "the largest that allows the stiffness"
    NONE = 2, "no value tried reaches this stiffness; shorten the delay or the filter"
    LONGEST_TRIED = 3, "the longest value tried still allows the stiffness"


@dataclass(frozen=True)
class LargestSampleTime(Answer):
    """The largest sample time, the damping that allows most there, and a status."""

    largest_sample_time: LargestTime
    at_damping: Damping | None
    status: DesignStatus


@dataclass(frozen=True)
class LargestDelay(Answer):
    """The largest delay, the damping that allows most there, and a status."""

    largest_delay: LargestTime
    at_damping: Damping | None
    status: DesignStatus


@dataclass(frozen=True)
class Design(Answer):
    """What a desired stiffness requires of the controller."""

    inputs: Basis | None
    stiffness: Stiffness
    safety: Number | None
    now_allowed_stiffness: LargestStiffness
    sample_time: LargestSampleTime
    delay: LargestDelay
    hand: str | None

    @property
    def all_stable(self) -> bool:
        """Whether a sample time and a delay allow the stiffness."""
        return DesignStatus.NONE not in (self.sample_time.status, self.delay.status)


def design_loop(scene: Scene) -> Design:
    """The largest sample time, and the largest delay, that allow the wanted stiffness."""
    # A delay given in samples grows with the sample time. The damping is that of the stiffest wall.
    # The stiffness is taken to fall as the sample time or the delay grows. Where the velocity is
    # taken over a window in s, only sample times that divide it are tried.
    wanted = scene.wanted.stiffness
    if wanted is None:
        raise ValueError("wanted.stiffness is missing; give the stiffness to design for in N/m.")
    loop = loop_of(scene)
    in_samples, safety = scene.controller.delay_samples, scene.wanted.safety or 1.0
    required = wanted / safety
    sampled, delayed = partial(sampled_loop, scene), partial(delayed_loop, scene)
    period, velocity = loop.sample_time, scene.controller.velocity
    window = velocity.window if velocity else None
    shortest = max(period / _FACTOR, loop.delay / _MOST_SAMPLES if in_samples is None else 0.0)
    longest = min(_FACTOR * period, velocity.longest_sample_time if velocity else inf)
    if window is None:
        largest_period = _largest(sampled, required, period, shortest, longest)
    else:
        periods = [window / n for n in range(1, LONGEST_WINDOW + 1)]
        largest_period = _largest_of(sampled, required, [p for p in periods if p >= shortest])
    return Design(
        inputs=basis_of(scene),
        stiffness=wanted,
        safety=scene.wanted.safety,
        now_allowed_stiffness=safety * _stiffest(loop).stiffness,
        sample_time=LargestSampleTime(*largest_period),
        delay=LargestDelay(*_largest(delayed, required, period, 0.0, _MOST_SAMPLES * period)),
        hand=at_lowest(scene),
    )


def stiffness_over_sample_times(scene: Scene, design: Design) -> tuple[Floats, Floats]:
    """Return sample times in s, around those now and designed, and the allowed stiffness."""
    period, velocity = loop_of(scene).sample_time, scene.controller.velocity
    designed = design.sample_time.largest_sample_time
    ends = min(period, designed) if designed > 0.0 else period, max(period, designed)
    low, high = _AROUND[0] * ends[0], _AROUND[1] * ends[1]
    high = min(high, velocity.longest_sample_time) if velocity else high
    values = np.linspace(low, high, _POINTS)
    if velocity and velocity.window:
        values = velocity.window / np.arange(LONGEST_WINDOW, 0, -1)
        values = values[(low <= values) & (values <= high)]
    return values, _stiffnesses(scene, partial(sampled_loop, scene), values)


def stiffness_over_delays(scene: Scene, design: Design) -> tuple[Floats, Floats]:
    """Return delays in s, from 0 to beyond those now and designed, and the allowed stiffness."""
    loop, designed = loop_of(scene), design.delay.largest_delay
    longest = _AROUND[1] * max(loop.delay, loop.sample_time, designed if designed > 0.0 else 0.0)
    values = np.linspace(0.0, longest, _POINTS)
    return values, _stiffnesses(scene, partial(delayed_loop, scene), values)


def _stiffnesses(scene: Scene, loop_at: Callable[[float], HapticLoop], values: Floats) -> Floats:
    safety = scene.wanted.safety or 1.0
    return np.array([safety * _stiffest(loop_at(value)).stiffness for value in values.tolist()])


def sampled_loop(scene: Scene, period: float) -> HapticLoop:
    """Return the loop of a scene with another sample time; a delay in samples goes with it."""
    loop, in_samples = loop_of(scene), scene.controller.delay_samples
    delay = loop.delay if in_samples is None else in_samples[0] * period
    return replace(loop, sample_time=period, delay=delay)


def delayed_loop(scene: Scene, delay: float) -> HapticLoop:
    """Return the loop of a scene with another delay in s."""
    return replace(loop_of(scene), delay=delay)


def _largest(
    loop_at: Callable[[float], HapticLoop],
    wanted: float,
    start: float,
    lowest: float,
    highest: float,
) -> tuple[float, float | None, DesignStatus]:
    """The largest value that allows the wanted stiffness, with the damping and the status."""

    def spare(value: float) -> float:
        return _stiffest(loop_at(value)).stiffness / wanted - 1.0

    low, high = _bracket(spare, start, lowest, highest)
    if not low.spare >= 0.0:
        return nan, None, DesignStatus.NONE
    if high.spare >= 0.0:
        largest, status = high.value, DesignStatus.LONGEST_TRIED
    else:
        largest, status = _last_with_spare(spare, low, high, start), DesignStatus.FOUND
    return largest, _stiffest(loop_at(largest)).damping, status


def _largest_of(
    loop_at: Callable[[float], HapticLoop], wanted: float, values: list[float]
) -> tuple[float, float | None, DesignStatus]:
    """The same for a list of values, the largest first, by bisection."""

    def allows(value: float) -> bool:
        return _stiffest(loop_at(value)).stiffness >= wanted

    index = bisect_left(values, True, key=allows)
    if index == len(values):
        return nan, None, DesignStatus.NONE
    status = DesignStatus.FOUND if index else DesignStatus.LONGEST_TRIED
    return values[index], _stiffest(loop_at(values[index])).damping, status


def _stiffest(loop: HapticLoop) -> Gains:
    return reachable(wall_region(loop)).stiffest


class _Trial(NamedTuple):
    """A value of a quantity, and the relative excess over the wanted stiffness."""

    value: float
    spare: float


def _bracket(
    spare: Callable[[float], float], start: float, lowest: float, highest: float
) -> tuple[_Trial, _Trial]:
    """Two values: the lower one meets the requirement, the upper one does not, if any."""
    low = high = _Trial(start, spare(start))
    while high.spare >= 0.0 and high.value < highest:
        value = min(2.0 * high.value, highest)
        low, high = high, _Trial(value, spare(value))
    while not low.spare >= 0.0 and low.value > lowest:
        value = max(0.5 * low.value, lowest)
        value = lowest if value < _NO_DELAY * start else value
        low, high = _Trial(value, spare(value)), low
    return low, high


def _last_with_spare(
    spare: Callable[[float], float], low: _Trial, high: _Trial, scale: float
) -> float:
    """Return the largest value with something to spare, by false position."""
    # The weight of an end that stays twice is halved (the Illinois rule); if it stays longer, the
    # interval is halved: the largest value may be 0, and the spare noise next to it.
    weight_low, weight_high, moved, stays = low.spare, high.spare, "", 0
    while high.value - low.value > _AGREEMENT * max(high.value, _NO_DELAY * scale):
        share = weight_low / (weight_low - weight_high) if isfinite(weight_high) else 0.5
        share = min(max(share, _AGREEMENT / 4), 1.0 - _AGREEMENT / 4)
        share = 0.5 if stays > 2 else share
        middle = low.value + share * (high.value - low.value)
        trial = _Trial(middle, spare(middle))
        if trial.spare >= 0.0:
            low, weight_low = trial, trial.spare
            stays = stays + 1 if moved == "low" else 0
            weight_high *= 0.5 if moved == "low" else 1.0
            moved = "low"
        else:
            high, weight_high = trial, trial.spare
            stays = stays + 1 if moved == "high" else 0
            weight_low *= 0.5 if moved == "high" else 1.0
            moved = "high"
    return low.value
