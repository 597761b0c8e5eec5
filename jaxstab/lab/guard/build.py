"""Building a guard: limits a little below the exact ones, lowered until they are proved.

A cell that is not proved within a number of boxes grants no wall.
"""

from collections.abc import Callable
from functools import partial
from itertools import product
from math import frexp, prod
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int64

from jaxstab.boxes import HandRange
from jaxstab.boxes.enclosures import HAND
from jaxstab.boxes.plant import Arms, with_parts
from jaxstab.boxes.search import checked_range, paved
from jaxstab.conventions import Range, Verdict
from jaxstab.exact import wall_verdict
from jaxstab.lab.guard.guard import (
    CELL_AXES,
    Grid,
    Guard,
    boundary_of,
    cell_corners,
    grid_boxes,
    interpolated,
)
from jaxstab.loop.jitter import Delays
from jaxstab.model import LoopParameters
from jaxstab.model.balls import ball_triple
from jaxstab.model.device.parts import MassSpringDamper, Modes
from jaxstab.model.filters import NO_FILTERS, known_filters
from jaxstab.model.loop import refuse_arrays
from jaxstab.numbers import checked_count, has_shape, require_kind, two_ends
from jaxstab.region.closed_form import responses_at
from jaxstab.shown import shortened

# Proof that every wall which a guard lets through is stable (lemma B20).
#
# Boxes of damping, mass and delay (in cells of the grid), of the hand, and of the angle hold all
# walls from no stiffness up to the limit of the grid (``boxes.search``). All walls of cells that
# are proved and side by side have the same number of unstable roots, and one certified verdict says
# that it is none.

Cells = Bool[np.ndarray, "mass delay damping"]


def proved(
    loop: LoopParameters,
    hands: HandRange,
    grid: Grid,
    cells: Cells,
    most: tuple[int, int],
    progress: Callable[[float], None],
    before: int,
) -> tuple[Cells, int]:
    """The cells for which no wall has a root on the unit circle, and the number of boxes it took.

    A cell, and all cells together, may take at most ``most`` boxes; ``progress`` gets the share of
    cells that are proved, those ``before`` included. Of the loop, the device's mass, the hand and
    the delay are not used.
    """
    at_once = 32  # cells
    narrowest = 2.0**-29  # of a cell: what such boxes have not is next to an instability
    boxes = grid_boxes(loop.held_device, loop, hands, grid)
    arm: dict[str, Any] = dict(zip(HAND, vars(hands).values(), strict=True))
    waiting, is_proved, count = np.flatnonzero(cells), np.zeros(cells.size, bool), 0
    while waiting.size and count < most[1]:
        effort = min(most[0], most[1] - count)
        block = np.arange(min(waiting.size, at_once, (most[1] - count) // effort))
        corners = zip(CELL_AXES, np.unravel_index(waiting[block], cells.shape), strict=True)
        places: dict[str, Any] = {name: (index, index + 1.0) for name, index in corners}
        paving = paved(boxes.judged, block.size, narrowest, effort=effort, **places, **arm)
        is_proved[waiting[block]] = ~np.isin(block, paving.boxes.index)
        waiting, count = waiting[block.size :], count + int(paving.judged.sum())
        progress((before + int(is_proved.sum())) / cells.size)
    return is_proved.reshape(cells.shape), count


def _is_stable(
    loop: LoopParameters, hands: HandRange, grid: Grid, node: tuple[int, int, int]
) -> bool:
    """True if the wall of the largest stiffness at a node is proved stable for a random hand."""
    rng = np.random.default_rng(2008)
    arm = Arms(*(low + (high - low) * rng.random() for low, high in vars(hands).values()))
    mass, delay, _ = node
    least = 1e-6 * float(grid.limit.max())  # without stiffness a free device drifts
    stiffness = max(float(grid.limit[node]), least)
    damping = node[2] / grid.cells[2] * float(grid.top[mass, delay])
    held = LoopParameters(
        sample_time=loop.sample_time,
        device=with_parts(loop.held_device, float(grid.mass[mass]), arm),
        delay=float(grid.delay[delay]) * loop.sample_time,
        velocity=loop.velocity,
        position=loop.position,
    )
    return wall_verdict(partial(ball_triple, held), stiffness, damping).verdict == Verdict.STABLE


CELLS, CONSTANT_CELLS = (4, 1, 16), (4, 8, 16)
"""Cells along mass, delay and damping, powers of two: of delays that move, and of constant ones."""

_LOWER = 0.05  # of a limit whose proof was given up, in the first round
_LEAST_SHARE = 1e-3  # of the largest damping: at none what nothing damps is on the circle


class _Work(NamedTuple):
    """The largest number of boxes, its parts for rounds, and the usual number per cell."""

    most: int
    rounds: int
    usual: int


_OF_MASS = _Work(2_000_000, 8, 500)
_OF_DEVICE = _Work(4_000_000, 32, 20_000)


def build_guard(
    loop: LoopParameters,
    hands: HandRange,
    *,
    mass: Range,
    delay: Range,
    lost: int = 0,
    constant_delay: bool = False,
    cells: tuple[int, int, int] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Guard:
    """The guard of a loop: walls that are proved stable for all hands, masses and delays.

    The delay may change from sample to sample within its range: walls are proved for every sequence
    of delays, and the guard is called without a delay. With ``constant_delay`` they are proved for
    every delay that does not change while the wall is touched, which grants more, and the guard
    takes the delay. Mass, hand and both gains are constant while the wall is touched.

    Where nothing could be proved within 2 million boxes of loops, about 20 s of CPU time (4
    million and 40 s with modes, actuators or a grip), the guard grants no wall.

    Args:
        loop: the loop, with its velocity estimator and position filter, and the vibration modes,
            actuators and grip of its ``device``. The mass of its device, its hand and its delay are
            not used.
        hands: the range of hands.
        mass: the lowest and the highest mass of the device in kg, over its postures for example.
        delay: the shortest and the longest delay of the loop in s. The newest sample that has
            arrived sets the force.
        lost: the number of samples in a row that may never arrive.
        constant_delay: True for a delay that is constant while the wall is touched.
        cells: the number of cells along mass, delay and damping, powers of two: (4, 1, 16), or (4,
            8, 16) for a constant delay; one of delay if it moves. More cells grant more, but the
            table is larger and takes longer to prove.
        progress: called with the share of the proof that is done.

    Raises:
        ValueError: a range is empty or out of order, a number of cells is not a power of two, or
            samples are lost although the delay is constant.
        NotImplementedError: the loop has a ``device`` that is not a mass with vibration modes,
            actuators and one hand of mass, spring and damper, behind a grip or not.
        RuntimeError: no wall at all could be proved.

    Source: lemma B20 of docs/proofs.md; J3 for delays that move.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> hands, mass, delay = jaxstab.HandRange(), (0.24, 0.26), (1e-3, 1.1e-3)
        >>> ranges = {"mass": mass, "delay": delay, "cells": (1, 1, 4)}
        >>> guard = jaxstab.build_guard(loop, hands, **ranges, constant_delay=True)
        >>> print(f"{guard.largest_stiffness(10.0, mass=0.25, delay=1e-3):.0f} N/m")
        4846 N/m
    """
    lost = checked_count("lost", lost, 0)
    cells = cells or (CONSTANT_CELLS if constant_delay else CELLS)
    jitter = _checked_jitter(loop, hands, mass, delay, cells, lost, constant_delay=constant_delay)
    progress = progress or (lambda _: None)
    progress(0.0)
    period = loop.sample_time
    longest = delay[1] if constant_delay else delay[0]
    nodes = [
        np.linspace(*mass, cells[0] + 1),
        np.linspace(delay[0] / period, longest / period, cells[1] + 1),
    ]
    grid, units = _first_grid(loop, hands, nodes, cells, jitter)
    grid = _below_curves(loop, hands, grid, units[0])
    grid, is_proved = _proved(loop, hands, grid, units[0], progress)
    rows = _granted_rows(loop, hands, grid, is_proved)
    if not np.any(rows[..., 0] < rows[..., 1]):
        raise RuntimeError(
            "no wall was proved stable for every hand at any mass and delay of the ranges within "
            f"{_work_of(loop).most:,} boxes of loops, though some may be; narrow the ranges, that "
            "of the mass first, or give the hand more damping."
        )
    return Guard(loop, hands, mass, delay, grid, units, rows, lost)


def plan_guard(loop: LoopParameters, cells: tuple[int, int, int] = CELLS) -> str:
    """The work of ``build_guard``, and the CPU time that it takes on an ordinary computer."""
    boundaries, box = 2.0, 1e-5  # s that they take
    count, work = prod(cells), _work_of(loop)
    usual, most = (
        boundaries + min(boxes, work.most) * box for boxes in (count * work.usual, work.most)
    )
    noun, each = ("cells", "each ") if count > 1 else ("cell", "")
    return (
        f"{count} {noun} of mass, delay and damping, {each}for all hands and frequencies: usually "
        f"{usual:.0f} s of CPU time, at most {most:.0f} s ({work.most:,} boxes of loops)"
    )


def _work_of(loop: LoopParameters) -> _Work:
    return _OF_MASS if loop.device is None else _OF_DEVICE


def _first_grid(
    loop: LoopParameters,
    hands: HandRange,
    nodes: list[np.ndarray],
    cells: tuple[int, int, int],
    jitter: float,
) -> tuple[Grid, tuple[float, float]]:
    """Limits a little below the boundaries at the nodes, and the units of the table."""
    pull = 0.03  # of each limit
    pull_all = 0.02  # of the largest limit of the same mass and delay
    pull_top = 0.015  # of the largest damping
    little = 0.05  # of the largest limit: no less is granted without damping, or at the largest one
    tops = _tops(loop, hands, nodes, jitter) * (1.0 - pull_top)
    is_good = np.isfinite(tops) & (tops > 0.0)
    if not is_good.any():
        raise RuntimeError(
            "no wall is stable for every hand at any mass and delay of the ranges; narrow them."
        )
    # Where no damping is stable any number will do: nothing will be proved there.
    top, damping_unit = _coded(np.where(is_good, tops, np.min(tops[is_good])))
    top = np.maximum(top, damping_unit)
    share = np.maximum(np.linspace(0.0, 1.0, cells[2] + 1), _LEAST_SHARE)
    boundary = boundary_of(loop, hands, nodes[0], nodes[1], jitter)
    exact = boundary.largest_stiffness(top[..., None] * share)
    exact = np.where(np.isfinite(exact) & is_good[..., None], exact, 0.0)
    largest = exact.max(axis=-1, keepdims=True)
    limit = np.maximum(exact * (1.0 - pull) - pull_all * largest, 0.0)
    # A first row that begins without a wall is proved by lemma B20, however little is damped; next
    # to the largest damping little stiffness takes many boxes.
    for end in (0, -1):
        is_little = limit[..., end] < little * largest[..., 0]
        limit[..., end] = np.where(is_little, 0.0, limit[..., end])
    limit, unit = _coded(limit)
    return Grid(nodes[0], nodes[1], top, limit, jitter), (unit, damping_unit)


def _proved(
    loop: LoopParameters,
    hands: HandRange,
    grid: Grid,
    unit: float,
    progress: Callable[[float], None],
) -> tuple[Grid, Cells]:
    """A grid whose limits are lowered until they are proved, and the cells that are."""
    fewest = 2000  # boxes of a cell in the first round, or a part of all boxes
    more = 1.5  # times as many boxes, and as much to take from the limits, in the next round
    # Each round may take more boxes for a cell than the one before, of limits that are lower by
    # more. A cell keeps the limits with which it was proved, even if its neighbours are lowered.
    work, is_proved = _work_of(loop), np.zeros(grid.cells, bool)
    left, each = work.most, float(max(fewest, work.most // (work.rounds * is_proved.size)))
    share = _LOWER
    hopeful, limit = ~is_proved, np.full(grid.limit.shape, np.inf)
    while left > 0 and hopeful.any():
        most, before = (int(each), left), int(is_proved.sum())
        newly, count = proved(loop, hands, grid, hopeful, most, progress, before)
        is_proved, left = is_proved | newly, left - count
        limit = np.where(_are_corners(newly), np.minimum(limit, grid.limit), limit)
        # A cell whose limits are all 0 cannot be lowered further.
        hopeful = ~is_proved & (np.max(cell_corners(grid.limit, 3), axis=0) > 0.0)
        grid = _lowered(grid, hopeful, unit, share)
        each, share = each * more, min(share * more, 1.0)
    progress(1.0)
    return grid._replace(limit=np.where(np.isfinite(limit), limit, grid.limit)), is_proved


def _granted_rows(
    loop: LoopParameters, hands: HandRange, grid: Grid, is_proved: Cells
) -> Int64[np.ndarray, "mass delay 2"]:
    """The first and the last node of the damping between which each cell is proved stable."""
    # Of several such stretches it is the one that grants most. One verdict per cell of mass and
    # delay is enough for all of its walls.
    rows = np.zeros((*grid.cells[:2], 2), np.int64)
    least = np.min(cell_corners(grid.limit, 2), axis=0)
    masses, delays, _ = grid.cells
    for place in product(range(masses), range(delays)):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], is_proved[place], [False]])))
        stretches = edges.reshape(-1, 2)
        grants = [least[place][begin : end + 1].sum() for begin, end in stretches]
        if not grants or not max(grants) > 0.0:
            continue
        begin, end = stretches[int(np.argmax(grants))]
        best = int(begin + np.argmax(least[place][begin : end + 1]))
        if _is_stable(loop, hands, grid, (*place, best)):
            rows[place] = begin, end
    return rows


def _checked_jitter(
    loop: LoopParameters,
    hands: HandRange,
    mass: Range,
    delay: Range,
    cells: tuple[int, int, int],
    lost: int,
    *,
    constant_delay: bool,
) -> float:
    """By how many samples the delay may move, rounded up; it refuses what has no guard."""
    least_gain = 1e-6  # of a position filter at z = 1
    require_kind("loop", loop, LoopParameters, "HapticLoop")
    checked_range(hands, device=loop.device)
    refuse_arrays(loop)
    body = loop.held_device.mechanism
    if not isinstance(body, MassSpringDamper | Modes) or body.mass is None:
        raise NotImplementedError(
            "a guard is proved for a mass, with or without vibration modes and actuators; this is "
            f"{loop.held_device}, which has no mass that could vary."
        )
    filters = known_filters(**loop.filters) or NO_FILTERS
    gain = float(responses_at(filters, np.zeros(1))[0][0].real)
    if not gain >= least_gain:
        raise ValueError(
            f"the position filter has the gain {gain:g} at z = 1; give one with a positive gain."
        )
    for name, ends, may_be_one in (("mass", mass, False), ("delay", delay, lost > 0)):
        low, high = two_ends(name, ends, 0.0)
        if not (low < high or (may_be_one and low == high)) or (name == "mass" and low == 0.0):
            raise ValueError(f"{name} is {ends}; give the lower end first, then a higher one.")
    if not has_shape(cells, 3):
        raise TypeError(
            f"cells are {shortened(cells)}; give three numbers: along mass, delay and damping."
        )
    for count in cells:
        if checked_count("cells", count, 1) & (count - 1):
            raise ValueError(f"cells are {cells}; give powers of two.")
    if constant_delay:
        if lost:
            raise ValueError(f"lost is {lost}; with a constant delay no sample is lost.")
        return 0.0
    if cells[1] != 1:
        raise ValueError(f"cells are {cells}; give 1 of delay, or constant_delay.")
    low, high = (end / loop.sample_time for end in delay)
    return Delays.between(low, high, lost).jitter


def _tops(
    loop: LoopParameters, hands: HandRange, nodes: list[np.ndarray], jitter: float
) -> np.ndarray:
    """Largest dampings at nodes, low enough for those between nodes."""
    finer = 4  # parts of a cell, in which largest dampings are computed
    mass, delay = (np.linspace(x[0], x[-1], (x.size - 1) * finer + 1) for x in nodes)
    rows = [boundary_of(loop, hands, own, delay, jitter).largest_damping() for own in mass[:, None]]
    exact = np.concatenate(rows)
    top = exact[::finer, ::finer]
    places = np.indices(exact.shape).reshape(2, -1) / finer
    share = np.minimum(exact / interpolated(top, places).reshape(exact.shape), 1.0)
    windows = np.pad(share, finer, constant_values=1.0)
    around = np.lib.stride_tricks.sliding_window_view(windows, (2 * finer + 1,) * 2)
    lowest: np.ndarray = top * around[::finer, ::finer].min(axis=(2, 3))
    return lowest


def _coded(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Values rounded down to multiples of a power of two, and that unit."""
    codes = 0xFFFF
    unit = 2.0 ** frexp(float(np.max(values)) / codes)[1]
    return np.floor(values / unit) * unit, unit


def _are_corners(cells: Cells) -> Bool[np.ndarray, "_ _ _"]:
    """True for nodes at corners of these cells."""
    return np.any(cell_corners(np.pad(cells, 1), 3), axis=0)


def _lowered(grid: Grid, cells: Cells, unit: float, share: float = _LOWER) -> Grid:
    """A grid whose limits at all corners of these cells are lower."""
    lower_all = 0.08  # of the largest limit of the same mass and delay, added to that limit
    by = share * (grid.limit + lower_all * grid.limit.max(axis=-1, keepdims=True))
    lower = np.floor(np.maximum(grid.limit - by, 0.0) / unit) * unit
    return grid._replace(limit=np.where(_are_corners(cells), lower, grid.limit))


def _below_curves(loop: LoopParameters, hands: HandRange, grid: Grid, unit: float) -> Grid:
    """A grid lowered where it is not below the boundaries between its nodes."""
    parts = np.array([2, 2, 4])  # of a cell, at whose ends a guard is held against the boundary
    enough = 0.99  # of the stiffness at which a hand becomes unstable
    attempts = 12
    sizes = (parts * grid.cells + 1).tolist()
    places = np.indices(sizes).reshape(3, -1) / parts[:, None]
    mass = np.linspace(grid.mass[0], grid.mass[-1], sizes[0])[:, None]
    delay = np.linspace(grid.delay[0], grid.delay[-1], sizes[1])
    share = np.maximum(places[2] / grid.cells[2], _LEAST_SHARE)
    damping = (interpolated(grid.top, places[:2]) * share).reshape(sizes[0], 1, *sizes[1:])
    exact = [
        boundary_of(loop, hands, own, delay, grid.jitter).largest_stiffness(row)
        for own, row in zip(mass, damping, strict=True)
    ]
    for _ in range(attempts):
        above = places[:, interpolated(grid.limit, places) > enough * np.ravel(exact)]
        if not above.shape[1]:
            break
        is_above = np.zeros(grid.cells, bool)
        is_above[tuple(np.minimum(above.astype(int), np.array(grid.cells)[:, None] - 1))] = True
        grid = _lowered(grid, is_above, unit)
    return grid
