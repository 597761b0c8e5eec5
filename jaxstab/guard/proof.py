"""Proof that every wall which a guard lets through is stable (lemmas B3, B6, B10, B15, B20).

Boxes of damping, mass and delay (in cells of the grid), of the hand, and of the angle hold all
walls from no stiffness up to the limit of the grid. They are halved until none has a root on the
unit circle. Then all walls of all cells have the same number of unstable roots, and one certified
verdict says that it is none.
"""

from collections.abc import Callable
from dataclasses import replace
from math import pi

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.boxes.device_boxes import DeviceBoxes
from jaxstab.boxes.held_device import Arms, with_parts
from jaxstab.boxes.parted import BEYOND, Boxes
from jaxstab.conventions import Verdict
from jaxstab.guard.grid import Grid, interpolated, step_of
from jaxstab.guard.grid_boxes import grid_boxes
from jaxstab.guard.mass_boxes import MassBoxes
from jaxstab.model import Device, LoopParameters
from jaxstab.point import verdict
from jaxstab.point.verdict.linear import linear_verdict
from jaxstab.ranges import HandRange

_AT_ONCE = 1 << 15
_MOST_OF_CELL = 20_000  # boxes; then the proof of a cell is given up
_MOST_OF_GRID = 10_000_000  # or this, over the cells, where they are few
_MOST = {MassBoxes: 100_000_000, DeviceBoxes: 10_000_000}  # boxes of all cells: minutes
_SMALL = 1e-6  # of the largest limit


def unproved(
    loop: LoopParameters,
    hands: HandRange,
    grid: Grid,
    cells: Int64[np.ndarray, "3 cell"] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Int64[np.ndarray, "3 unproved"]:
    """Return the cells for which it is not proved that no wall has a root on the unit circle.

    Args:
        loop: the loop; its device's mass, its hand and its delay are not used.
        hands: the range of hands.
        grid: what is to be proved.
        cells: the cells of the grid to prove; None for all.
        progress: called with the share of the cells that are done.
    """
    proof = _Proof(loop, hands, grid)
    low, high = _starts(grid, cells)
    rest = np.array([*vars(hands).values(), (0.0, pi * (1.0 + BEYOND))])[:, :, None]
    low, high = (
        np.concatenate([part, np.broadcast_to(rest[:, end], (4, part.shape[1]))])
        for end, part in enumerate((low, high))
    )
    failed = []
    total = low.shape[1]
    group = max(1, total // 32)
    for first in range(0, total, group):
        some = slice(first, first + group)
        failed.append(proof.failures(0.5 * (low + high)[:, some], 0.5 * (high - low)[:, some]))
        done = min(1.0, (first + group) / total)
        proof.refuse_long(done)
        if progress is not None:
            progress(done)
    return np.unique(np.concatenate(failed, axis=1), axis=1)


def are_stable(
    loop: LoopParameters, hands: HandRange, grid: Grid, places: Float64[np.ndarray, "3 place"]
) -> Bool[np.ndarray, " place"]:
    """Return where the wall of the largest stiffness is proved stable for a random hand."""
    rng = np.random.default_rng(2008)
    share = rng.random((3, places.shape[1]))
    ranges = vars(hands).values()
    hand = [low + (high - low) * part for (low, high), part in zip(ranges, share, strict=True)]
    own_mass = grid.mass[0] + places[0] * step_of(grid.mass)
    delay = grid.delay[0] + places[1] * step_of(grid.delay)
    least = _SMALL * np.max(grid.limit)  # without, a free device drifts
    stiffness = np.maximum(interpolated(grid.limit, places), least)
    damping = places[2] / grid.cells[2] * interpolated(grid.top, places[:2])
    if loop.device is not None:
        columns = np.stack([stiffness, damping, own_mass, delay, *hand]).T.tolist()
        codes = np.array(
            [
                _code_of(loop.device, loop, (k, b), (mass, lag), Arms(*arm))
                for k, b, mass, lag, *arm in columns
            ]
        )
    else:
        period, moved = loop.sample_time, own_mass + hand[0]
        codes = verdict(
            stiffness * period**2 / moved,
            damping * period / moved,
            gamma=hand[1] * period**2 / moved,
            delta=(loop.device_damping + hand[2]) * period / moved,
            delay=delay,
            **loop.filters,
        )
    return np.asarray(codes == Verdict.STABLE)


def _code_of(
    device: Device,
    loop: LoopParameters,
    wall: tuple[float, float],
    place: tuple[float, float],
    arm: Arms,
) -> int:
    """Return the verdict on a wall (K, B) of a device of some mass, at a delay, with some arm."""
    mass, delay = place
    held = replace(loop, device=with_parts(device, mass, arm), delay=delay * loop.sample_time)
    return int(linear_verdict(held.alpha(wall[0]), held.beta(wall[1]), held.linear))


class _Proof:
    """Boxes of a proof and what halves them."""

    def __init__(self, loop: LoopParameters, hands: HandRange, grid: Grid) -> None:
        self._cells = grid.cells
        self._boxes: MassBoxes | DeviceBoxes = (
            MassBoxes(loop, grid)
            if loop.device is None
            else grid_boxes(loop.device, loop, hands, grid)
        )
        self._most, self._count = _MOST[type(self._boxes)], 0

    def refuse_long(self, done: float = 1.0) -> None:
        """Refuse a proof that is too long, or whose done share says that it will be."""
        if self._count > self._most * (done if done >= 1.0 else 2.0 * done):
            raise RuntimeError(
                "the proof would take more than five minutes; narrow the ranges of mass, delay "
                "and hands."
            )

    def failures(self, center: Boxes, half: Boxes) -> Int64[np.ndarray, "3 cell"]:
        """Return the cells in which the proof was given up."""
        cells = self._cells
        tried = np.zeros(cells, int)
        failed = np.zeros(cells, bool)
        while center.shape[1]:
            now = slice(-_AT_ONCE, None)
            at, by = center[:, now], half[:, now]
            center, half = center[:, : -at.shape[1]], half[:, : -at.shape[1]]
            self._count += at.shape[1]
            self.refuse_long()
            free, shares = self._boxes.judged(at, by)
            at, by, shares = at[:, ~free], by[:, ~free], shares[:, ~free]
            cell = tuple(np.floor(at[:3]).astype(int))
            is_small = np.all(by[:3] <= 0.5, axis=0)
            np.add.at(tried, tuple(part[is_small] for part in cell), 1)
            failed |= tried > max(_MOST_OF_CELL, _MOST_OF_GRID // failed.size)
            going = ~(failed[cell] & is_small)
            at, by, axis = at[:, going], by[:, going], np.argmax(shares[:, going], axis=0)
            box = np.arange(axis.size)
            by[axis, box] *= 0.5
            shift = np.zeros_like(at)
            shift[axis, box] = by[axis, box]
            center = np.concatenate([center, at - shift, at + shift], axis=1)
            half = np.concatenate([half, by, by], axis=1)
        return np.stack(np.nonzero(failed))


def _starts(grid: Grid, cells: Int64[np.ndarray, "3 cell"] | None) -> tuple[Boxes, Boxes]:
    """Return the ends of boxes that hold the cells."""
    if cells is not None:
        return cells.astype(float), cells + 1.0
    first, second, third = grid.cells
    places = np.indices((first, second)).reshape(2, -1).astype(float)
    row = np.zeros(places.shape[1])
    return np.vstack([places, row]), np.vstack([places + 1.0, row + third])
