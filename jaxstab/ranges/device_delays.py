"""How much longer the delay of a loop with any linear device may become: proved.

As for one mass (``first_crossings``), only the angles at which |D| = |N| |H| for some fraction of a
sample matter; at these the search looks for the first delay with a root on the circle.
"""

from functools import partial
from math import inf, nan, pi

import numpy as np
from jaxtyping import Float64

from jaxstab.model.device import SampledDevice
from jaxstab.model.filters import Filters
from jaxstab.proofs.exclusion import Boxes, Models, Parts, Proof, pave_by, search
from jaxstab.proofs.linear_circle import DelayBoxes, DelayedDevice, delayed_device
from jaxstab.proofs.linear_circle import delay_models as models
from jaxstab.ranges.first_crossings import MOST_DELAY, joined_angles

Walls = Float64[np.ndarray, "wall 2"]

_ANGLES = 256  # boxes at first, for half a turn
_COARSE = np.array([0.0, 2.0**-7, 2.0**-13])  # half the size of boxes of fractions, angles / pi
_FINE = np.array([0.0, 2.0**-12, 2.0**-16])  # where the first stretch of delay was free
_MOST_ANGLES = 4000  # such boxes of a wall at once
_MOST_PARTS = 20_000  # of a stretch of delay
_LONGER = 4.0  # each stretch of delay than the one before
_SAFE = 1.0 - 2.0**-48  # a step loses less when it is computed


def extra_delays(
    device: SampledDevice, walls: Walls, filters: Filters | None
) -> Float64[np.ndarray, " wall"]:
    """Return by how many samples the delay of stable walls (alpha, beta) may at least grow.

    It is infinite where no root ever reaches the circle up to ``MOST_DELAY``, and NaN for a device
    that is too fast for what proves it.

    Source: lemmas B5 and B14 of docs/proofs.md.
    """
    delayed = delayed_device(device, filters)
    if delayed is None:
        return np.full(len(walls), nan)
    begin, step = np.zeros(len(walls)), np.full(len(walls), inf)
    angles = _critical_angles(delayed, walls, np.arange(len(walls)), _COARSE)
    # Within one turn of the phase at a critical angle a root meets the circle: about so long.
    highest = np.full(len(walls), -inf)
    np.maximum.at(highest, angles.line, angles.high[1])
    stretch = np.where(highest > 0.0, 2.0 * pi / np.where(highest > 0.0, highest, 1.0), MOST_DELAY)
    is_open = highest > -inf
    while is_open.any():
        length = np.minimum(stretch, MOST_DELAY - begin)
        some = angles.some(is_open[angles.line])
        length = np.minimum(length, _longest(delayed, some, len(walls)))
        start = device.delay + begin
        parts = _in_pieces(delayed, some, start, length)
        line = partial(_models, delayed, walls, start, length)
        found = search(len(walls), parts, line).low
        is_found = np.isfinite(found)
        step = np.where(is_found, begin + length * np.where(is_found, found, 0.0) * _SAFE, step)
        is_open &= ~is_found & (begin + length < MOST_DELAY)
        if not begin.any() and is_open.any():
            angles = _critical_angles(delayed, walls, np.flatnonzero(is_open), _FINE)
            is_open &= np.isin(np.arange(len(walls)), angles.line)
        begin, stretch = begin + length, _LONGER * stretch
    return step


def _critical_angles(
    device: DelayedDevice,
    walls: Walls,
    numbers: np.ndarray,
    smallest: Float64[np.ndarray, "3"],
) -> Parts:
    """Return the angles at which some delay may put a root of some walls on the circle."""

    def prove(boxes: Boxes) -> Proof:
        wall, fraction, angle = boxes.center.T
        _, by_fraction, by_angle = boxes.half.T
        gains = walls[wall.astype(np.int64)].T
        over = DelayBoxes(gains, fraction, pi * angle, by_fraction, pi * by_angle)
        found, apart = models(device, over)
        return Proof(apart > 0.0, np.stack([np.zeros_like(apart), *found.bends], axis=-1))

    angles = (np.arange(_ANGLES) + 0.5) / _ANGLES
    grid = np.meshgrid(numbers, np.arange(len(device.pieces)), angles, indexing="ij")
    wall, number, angle = (part.ravel() for part in grid)
    pieces = np.array([[piece.middle, piece.half] for piece in device.pieces]).T[:, number]
    halves = np.zeros_like(angle), pieces[1], np.full_like(angle, 0.5 / _ANGLES)
    boxes = Boxes(np.stack([wall, pieces[0], angle], axis=-1), np.stack(halves, axis=-1))
    most = _MOST_ANGLES * len(device.pieces)
    return joined_angles(pave_by(boxes, smallest, prove, most, is_numbered=True).boxes)


def _longest(device: DelayedDevice, angles: Parts, walls: int) -> np.ndarray:
    """Return stretches of delay that are not cut into more parts than are looked at together."""
    count = np.bincount(angles.line, minlength=walls) * len(device.pieces)
    return np.maximum(1.0, _MOST_PARTS / np.maximum(count, 1))


def _in_pieces(
    device: DelayedDevice, angles: Parts, start: np.ndarray, length: np.ndarray
) -> Parts:
    """Divide lines along the delay into the pieces of each sample."""
    parts = []
    for wall in np.unique(angles.line):
        first, last = start[wall], start[wall] + length[wall]
        whole = np.arange(np.floor(first), np.floor(last) + 1.0)
        ends = np.unique(whole[:, None] + device.ends)
        ends = ends[(ends > first) & (ends < last)]
        t = np.clip([0.0, *((ends - first) / length[wall]), 1.0], 0.0, 1.0)
        which = np.flatnonzero(angles.line == wall)
        number, piece = (
            one.ravel() for one in np.meshgrid(which, np.arange(len(t) - 1), indexing="ij")
        )
        low = np.stack([t[piece], angles.low[1, number]])
        high = np.stack([t[piece + 1], angles.high[1, number]])
        parts.append(Parts(angles.line[number], low, high))
    line, low, high = zip(*parts, strict=True)
    return Parts(np.concatenate(line), np.concatenate(low, axis=1), np.concatenate(high, axis=1))


def _models(
    device: DelayedDevice, walls: Walls, start: np.ndarray, length: np.ndarray, parts: Parts
) -> Models:
    t, theta = 0.5 * (parts.low + parts.high)
    by_t, by_theta = 0.5 * (parts.high - parts.low) * (1.0 + 2.0**-50)
    long = length[parts.line]
    boxes = DelayBoxes(
        walls[parts.line].T, start[parts.line] + long * t, theta, long * by_t, by_theta
    )
    return models(device, boxes)[0]
