"""How far a wall can be changed before it loses stability: in stiffness, in damping, in delay.

From a wall that is proved stable, one quantity is changed. Boxes of that quantity and of the angle
theta on the unit circle are halved until each is proved free of roots (``circle.exclude``). Up to
the first box that is left, no root can have crossed the circle, so the loop is proved stable that
far; there lies the first crossing, bracketed to a billionth. The delay is changed continuously,
through all fractions of a sample.
"""

from functools import partial
from math import inf, isfinite, nan, pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.boundary.circle import Loops, exclude_any_delay
from jaxstab.boundary.paving import Boxes, Extent, pave
from jaxstab.conventions import AXES, Verdict
from jaxstab.model import HapticLoop, checked_gain, require_x64
from jaxstab.stability import verdict

Point = Float64[np.ndarray, " axis"]

_DELAY = AXES.index("delay")
_ALL_ANGLES = Boxes(np.full((1, 1), 0.5), np.full((1, 1), 0.5))  # in units of pi
_ANGLE_SIZE = 2.0**-16  # of pi, and of a sample: half the size of the smallest boxes of angles
_MOST_ANGLES = 2000  # such boxes at once
_FINEST = 2.0**-32  # of a stretch and of pi: half the size of the smallest boxes
_DOUBLINGS = 48
_LEAST_STEP = 2.0**-10  # of a gain, in units of the dimensionless parameters
MOST_DELAY = 1024.0  # samples: further delay is not looked at


class Margins(NamedTuple):
    """What a wall has left, in SI units; NaN throughout for a wall that is not proved stable.

    ``stiffness`` and ``damping`` are the intervals (least, largest) of K in N/m, at this B, and of
    B in N s/m, at this K, in which the wall stays stable. ``extra_delay`` is the time in s by which
    the delay may grow; infinite where no delay is too much, or none up to 1024 samples
    (MOST_DELAY). All of them are proved, and fall short of the first root on the circle by about
    1e-9 of the way there.
    """

    verdict: Verdict
    stiffness: tuple[float, float]
    damping: tuple[float, float]
    stiffness_gain: float
    damping_gain: float
    extra_delay: float


def margins(loop: HapticLoop, stiffness: float, damping: float) -> Margins:
    """Return how far stiffness, damping and delay of a loop at a wall may change, each alone.

    The boxes of the proof depend on the wall, so this is for one wall at a time, without vmap or
    derivatives. How the edge itself moves follows from ``boundary_curve``, which has both.

    Args:
        loop: device, hand, sample time and delay.
        stiffness: K of the wall in N/m.
        damping: B of the wall in N s/m.

    Returns:
        Margins, with the certified verdict. ``stiffness_gain`` and ``damping_gain`` are the factors
        by which K and B may be multiplied (infinite for a gain that is not above 0).

    Raises:
        ValueError: a gain is infinite or NaN.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle.
    """
    require_x64()
    checked_gain("stiffness", stiffness)
    checked_gain("damping", damping)
    point = np.array(
        [
            loop.alpha(float(stiffness)),
            loop.beta(float(damping)),
            loop.gamma,
            loop.delta,
            loop.delay_samples,
        ]
    )
    code = _verdict(point)
    if code != Verdict.STABLE:
        return Margins(code, (nan, nan), (nan, nan), nan, nan, nan)
    alphas, betas = (_interval(point, axis) for axis in (0, 1))
    stiffnesses = (loop.stiffness(alphas[0]), loop.stiffness(alphas[1]))
    dampings = (loop.damping(betas[0]), loop.damping(betas[1]))
    return Margins(
        code,
        stiffnesses,
        dampings,
        stiffnesses[1] / stiffness if stiffness > 0.0 else inf,
        dampings[1] / damping if damping > 0.0 else inf,
        loop.sample_time * _extra_delay(point),
    )


def _verdict(point: Point) -> Verdict:
    return Verdict(int(verdict(*(float(value) for value in point))))


def _interval(point: Point, axis: int) -> tuple[float, float]:
    """Return the values of one gain around a stable wall between which it stays stable."""
    low, high = (
        float(point[axis]) + way * _to_crossing(point, axis, way * _reach(point, axis, way))
        for way in (-1.0, 1.0)
    )
    return low, high


def _reach(point: Point, axis: int, way: float) -> float:
    """Return how far away a wall is proved unstable."""
    reach = max(_LEAST_STEP, 0.5 * abs(float(point[axis])))
    for _ in range(_DOUBLINGS):
        if _verdict(_moved(point, axis, way * reach)) == Verdict.UNSTABLE:
            return reach
        reach *= 2.0
    return inf


def _extra_delay(point: Point) -> float:
    """Return by how many samples the delay may grow."""
    turns = _critical_angles(point)
    start, stretch = 0.0, 1.0
    while start < MOST_DELAY and len(turns.center):
        away = _to_crossing(_moved(point, _DELAY, start), _DELAY, stretch, turns)
        if isfinite(away):
            return start + away
        start, stretch = start + stretch, 2.0 * stretch
    return inf


def _critical_angles(point: Point) -> Boxes:
    """Return the angles, in units of pi, at which some delay may put a root on the circle."""
    whole = _moved(point, _DELAY, -float(point[_DELAY]))
    left, _ = pave(
        Boxes(np.full((1, 2), 0.5), np.full((1, 2), 0.5)),
        _ANGLE_SIZE,
        partial(_along, whole, _DELAY, 1.0),
        _MOST_ANGLES,
        exclude_any_delay,
    )
    begin, end = left.center[:, 1] - left.half[:, 1], left.center[:, 1] + left.half[:, 1]
    order = np.argsort(begin)
    begin, end = begin[order], np.maximum.accumulate(end[order])
    gaps = begin[1:] > end[:-1]
    begin = begin[np.append(True, gaps)[: len(begin)]]
    end = end[np.append(gaps, True)[: len(end)]]
    return Boxes(0.5 * (begin + end)[:, None], 0.5 * (end - begin)[:, None])


def _to_crossing(point: Point, axis: int, stretch: float, turns: Boxes = _ALL_ANGLES) -> float:
    """Return how far along an axis no root reaches the circle; infinite if none does."""
    if not isfinite(stretch):
        return inf
    middle = np.full_like(turns.center, 0.5)
    whole = Boxes(np.hstack([middle, turns.center]), np.hstack([middle, turns.half]))
    left, is_finished = pave(whole, _FINEST, partial(_along, point, axis, stretch))
    if not is_finished:  # too many boxes at once
        half = 0.5 * stretch
        near = _to_crossing(point, axis, half, turns)
        beyond = _moved(point, axis, half)
        return near if isfinite(near) else abs(half) + _to_crossing(beyond, axis, half, turns)
    if not len(left.center):
        return inf
    return abs(stretch) * float(np.min(left.center[:, 0] - left.half[:, 0]))


def _along(point: Point, axis: int, stretch: float, boxes: Boxes) -> Extent:
    """Return the loops of boxes of (part of the stretch, theta / pi)."""
    middle = np.tile(point[:, None], len(boxes.center))
    middle[axis] += stretch * boxes.center[:, 0]
    still = np.zeros_like(middle)
    along = still.copy()
    along[axis] = abs(stretch) * boxes.half[:, 0]
    flat, turn = np.zeros(len(boxes.half)), pi * boxes.half[:, 1]
    return Extent(
        _loops(middle, pi * boxes.center[:, 1]),
        _loops(along, turn),
        [_loops(along, flat), _loops(still, turn)],
    )


def _loops(
    parameters: Float64[np.ndarray, "5 boxes"], theta: Float64[np.ndarray, " boxes"]
) -> Loops:
    alpha, beta, gamma, delta, delay = parameters
    return Loops(alpha, beta, gamma, delta, delay, theta)


def _moved(point: Point, axis: int, step: float) -> Point:
    moved = point.copy()
    moved[axis] += step
    return moved
