"""Proof that every wall which a guard lets through is stable (lemmas B10, B15, B20).

Boxes of damping, mass and delay (in cells of the grid), of the hand, and of the angle hold all
walls from no stiffness up to the limit of the grid. They are halved until none has a root on the
unit circle, or the boxes that a cell may take are used up. All walls of cells that are side by side
then have the same number of unstable roots, and one certified verdict says that it is none.
"""

from collections.abc import Callable
from math import pi

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.conventions import Verdict
from jaxstab.guard.grid import Grid, grid_boxes, interpolated, step_of
from jaxstab.model import LoopParameters
from jaxstab.point.verdicts import linear_verdict
from jaxstab.proofs.device_boxes import BEYOND, Arms, device_of, with_parts
from jaxstab.ranges import HandRange

Cells = Bool[np.ndarray, "mass delay damping"]

_AT_ONCE = 1 << 13
_NARROWEST = 2.0**-30  # of a cell: what such boxes have not is next to an instability
_SMALL = 1e-6  # of the largest limit


def proved(
    loop: LoopParameters,
    hands: HandRange,
    grid: Grid,
    cells: Cells,
    most: tuple[int, int],
    tell: Callable[[int], None],
) -> tuple[Cells, int]:
    """Return the cells for which no wall has a root on the unit circle, and how many boxes it took.

    Args:
        loop: the loop; its device's mass, its hand and its delay are not used.
        hands: the range of hands.
        grid: what is to be proved.
        cells: the cells of the grid to prove.
        most: boxes that a cell, and all cells together, may take.
        tell: is told, now and then, how many of the cells are proved.
    """
    boxes = grid_boxes(device_of(loop), loop, hands, grid)
    rest = np.array([*vars(hands).values(), (0.0, pi * (1.0 + BEYOND))])
    waiting = np.argwhere(cells)
    taken, open_boxes = np.zeros(cells.shape, int), np.zeros(cells.shape, int)
    failed = np.zeros(cells.shape, bool)
    center, half = np.zeros((7, 0)), np.zeros((7, 0))
    is_proved = np.zeros(cells.shape, bool)
    count = started = 0
    while (center.shape[1] or started < len(waiting)) and count < most[1]:
        if center.shape[1] < _AT_ONCE and started < len(waiting):
            some = waiting[started : started + _AT_ONCE // 64].T
            started += some.shape[1]
            more = np.repeat(0.5 * np.ptp(rest, axis=1)[:, None], some.shape[1], axis=1)
            at = np.repeat(rest.mean(axis=1)[:, None], some.shape[1], axis=1)
            center = np.concatenate([np.vstack([some + 0.5, at]), center], axis=1)
            half = np.concatenate([np.vstack([0.0 * some + 0.5, more]), half], axis=1)
            open_boxes[tuple(some)] = 1
        at, by = center[:, -_AT_ONCE:], half[:, -_AT_ONCE:]
        center, half = center[:, : -at.shape[1]], half[:, : -at.shape[1]]
        free, shares = boxes.judged(at, by)
        cell = tuple(np.floor(at[:3]).astype(int))
        np.add.at(taken, cell, 1)
        np.add.at(open_boxes, cell, np.where(free, -1, 1))
        failed |= taken > most[0]
        failed[tuple(part[by[:3].min(axis=0) < _NARROWEST] for part in cell)] = True
        count += at.shape[1]
        going = ~free & ~failed[cell]
        at, by, axis = at[:, going], by[:, going], np.argmax(shares[:, going], axis=0)
        box = np.arange(axis.size)
        by[axis, box] *= 0.5
        shift = np.zeros_like(at)
        shift[axis, box] = by[axis, box]
        center = np.concatenate([center, at - shift, at + shift], axis=1)
        half = np.concatenate([half, by, by], axis=1)
        is_proved = (taken > 0) & (open_boxes == 0) & ~failed
        tell(int(is_proved.sum()))
    return is_proved, count


def are_stable(
    loop: LoopParameters, hands: HandRange, grid: Grid, places: Float64[np.ndarray, "3 place"]
) -> Bool[np.ndarray, " place"]:
    """Return where the wall of the largest stiffness is proved stable for a random hand."""
    rng = np.random.default_rng(2008)
    share = rng.random((3, places.shape[1]))
    ranges = vars(hands).values()
    arms = [low + (high - low) * part for (low, high), part in zip(ranges, share, strict=True)]
    masses = grid.mass[0] + places[0] * step_of(grid.mass)
    delays = grid.delay[0] + places[1] * step_of(grid.delay)
    least = _SMALL * np.max(grid.limit)  # without, a free device drifts
    stiffness = np.maximum(interpolated(grid.limit, places), least)
    damping = places[2] / grid.cells[2] * interpolated(grid.top, places[:2])
    rows = np.stack([stiffness, damping, masses, delays, *arms]).T.tolist()
    return np.array(
        [_is_stable(loop, (k, b), (mass, lag), Arms(*arm)) for k, b, mass, lag, *arm in rows], bool
    )


def _is_stable(
    loop: LoopParameters, wall: tuple[float, float], place: tuple[float, float], arm: Arms
) -> bool:
    """Return the verdict on a wall (K, B) of a device of some mass, at a delay, with some arm."""
    mass, delay = place
    held = LoopParameters(
        sample_time=loop.sample_time,
        device=with_parts(device_of(loop), mass, arm),
        delay=delay * loop.sample_time,
        velocity=loop.velocity,
        position=loop.position,
    )
    code = linear_verdict(held.alpha(wall[0]), held.beta(wall[1]), held.linear)
    return int(code) == Verdict.STABLE
