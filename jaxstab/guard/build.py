"""Building a guard: limits a little below the exact ones, lowered until all of them are proved."""

from collections.abc import Callable
from math import frexp

import numpy as np
from jaxtyping import Int64

from jaxstab.boxes.filter_cells import responses_at
from jaxstab.guard.grid import Grid, interpolated
from jaxstab.guard.guard import Guard, Range
from jaxstab.guard.limits import boundary_of
from jaxstab.guard.proof import are_stable, unproved
from jaxstab.model import LoopParameters
from jaxstab.model.filters import known_filters
from jaxstab.numbers import checked_number
from jaxstab.ranges import HandRange
from jaxstab.ranges.hands import checked_range

CELLS = 4, 8, 16
"""Cells along mass, delay and damping, powers of two."""

_PULL = 0.03  # of each limit
_PULL_ALL = 0.02  # of the largest limit of the same mass and delay
_PULL_TOP = 0.015  # of the largest damping
_LOWER = 0.05  # of a limit whose proof was given up
_ATTEMPTS = 12
_FINER = 4  # parts of a cell, in which largest dampings are looked at
_PLACES = 64  # in each cell, at which walls are tried before the proof
_CODES = 0xFFFF
_LEAST_GAIN = 1e-6  # of a position filter at z = 1
_PARTS = 2, 2, 4  # of a cell, at whose ends a guard of a device is held against the boundary
_ENOUGH = 0.99  # of the stiffness at which a hand becomes unstable


def build_guard(
    loop: LoopParameters,
    hands: HandRange,
    *,
    mass: Range,
    delay: Range,
    cells: tuple[int, int, int] = CELLS,
    progress: Callable[[float], None] | None = None,
) -> Guard:
    """Return the guard of a loop: walls that are proved stable for all hands, masses and delays.

    Args:
        loop: the loop, with its velocity estimator and position filter. The mass of its device,
            its hand and its delay are not used. The vibration modes, the actuators and the grip of
            a device of its own are.
        hands: the range of hands.
        mass: the lowest and the highest mass of the device in kg, over its postures for example.
        delay: the shortest and the longest delay of the loop in s.
        cells: the number of cells along mass, delay and damping, powers of two. More cells grant
            more, but the table is larger and takes longer to prove.
        progress: called with the share of the proof that is done.

    Raises:
        ValueError: a range is empty or out of order, or the number of cells no power of two.
        NotImplementedError: the loop has a device of its own that is not a mass with vibration
            modes, actuators and one hand of mass, spring and damper, behind a grip or not.
        RuntimeError: the limits could not be proved.

    Source: lemmas B3, B6, B10, B15 and, for devices, B20 of docs/proofs.md.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> hands, mass, delay = jaxstab.HandRange(), (0.24, 0.26), (1e-3, 1.1e-3)
        >>> guard = jaxstab.build_guard(loop, hands, mass=mass, delay=delay, cells=(1, 1, 4))
        >>> print(f"{guard.largest_stiffness(10.0, mass=0.25, delay=1e-3):.0f} N/m")
        4846 N/m
    """
    _check(loop, hands, mass, delay, cells)
    nodes = [
        np.linspace(*ends, count + 1)
        for ends, count in ((mass, cells[0]), (_in_samples(loop, delay), cells[1]))
    ]
    boundary = boundary_of(loop, hands, *nodes)
    top, damping_unit = _coded(_tops(loop, hands, nodes) * (1.0 - _PULL_TOP))
    share = np.linspace(0.0, 1.0, cells[2] + 1)
    exact = boundary.largest_stiffness(top[..., None] * share)
    if not (np.all(top > 0.0) and np.all(np.isfinite(exact))):
        raise RuntimeError(
            "no wall is stable for every hand at some mass and delay of the ranges; narrow them."
        )
    largest = exact.max(axis=-1, keepdims=True)
    limit = np.maximum(exact * (1.0 - _PULL) - _PULL_ALL * largest, 0.0)
    unit = _coded(limit)[1]
    grid = Grid(nodes[0], nodes[1], top, np.floor(limit / unit) * unit)
    lowered = _stable_at_places if loop.device is None else _below_curves
    grid = lowered(loop, hands, grid, unit)
    failed: Int64[np.ndarray, "3 cell"] | None = None
    for _ in range(_ATTEMPTS):
        failed = unproved(loop, hands, grid, failed, progress)
        if not failed.shape[1]:
            break
        grid = _lowered(grid, failed, unit)
    else:
        raise RuntimeError(
            "the limits could not be proved for all masses, delays and hands; narrow the ranges."
        )
    if not _is_stable_once(loop, hands, grid):
        raise RuntimeError("no wall of the guard is proved stable; narrow the ranges.")
    return Guard(loop, hands, mass, delay, grid, (unit, damping_unit))


def _check(
    loop: LoopParameters,
    hands: HandRange,
    mass: Range,
    delay: Range,
    cells: tuple[int, int, int],
) -> None:
    checked_range(hands)
    filters = known_filters(**loop.filters)
    gain = 1.0 if filters is None else float(responses_at(filters, np.ones(1, complex))[0][0].real)
    if not gain >= _LEAST_GAIN:
        raise ValueError(
            f"the position filter has the gain {gain:g} at z = 1; give one with a positive gain."
        )
    for name, ends, least in (("mass", mass, 0.0), ("delay", delay, 0.0)):
        for end in ends:
            checked_number(name, end, least)
        if not ends[0] < ends[1] or (name == "mass" and ends[0] <= 0.0):
            raise ValueError(f"{name} is {ends}; give the lower end first, then a higher one.")
    for count in cells:
        if count < 1 or count & (count - 1):
            raise ValueError(f"cells are {cells}; give powers of two.")


def _in_samples(loop: LoopParameters, delay: Range) -> Range:
    return delay[0] / loop.sample_time, delay[1] / loop.sample_time


def _tops(loop: LoopParameters, hands: HandRange, nodes: list[np.ndarray]) -> np.ndarray:
    """Return largest dampings at nodes, low enough for those between nodes."""
    fine = [
        np.interp(np.arange((axis.size - 1) * _FINER + 1) / _FINER, np.arange(axis.size), axis)
        for axis in nodes
    ]
    exact = np.concatenate(
        [boundary_of(loop, hands, one, fine[1]).largest_damping() for one in fine[0][:, None]]
    )
    top = exact[::_FINER, ::_FINER]
    places = np.indices(exact.shape).reshape(2, -1) / _FINER
    share = np.minimum(exact / interpolated(top, places).reshape(exact.shape), 1.0)
    windows = np.pad(share, _FINER, constant_values=1.0)
    around = np.lib.stride_tricks.sliding_window_view(windows, (2 * _FINER + 1,) * 2)
    lowest: np.ndarray = top * around[::_FINER, ::_FINER].min(axis=(2, 3))
    return lowest


def _coded(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Return values rounded down to multiples of a power of two, and that unit."""
    unit = 2.0 ** frexp(float(np.max(values)) / _CODES)[1]
    return np.floor(values / unit) * unit, unit


def _lowered(grid: Grid, cells: Int64[np.ndarray, "3 cell"], unit: float) -> Grid:
    """Return a grid whose limits at all corners of some cells are lower."""
    corners = np.zeros(grid.limit.shape, bool)
    for corner in np.ndindex(2, 2, 2):
        corners[tuple(cells + np.array(corner)[:, None])] = True
    by = _LOWER * grid.limit + 0.2 * _PULL_ALL * grid.limit.max(axis=-1, keepdims=True)
    lower = np.maximum(grid.limit - by, 0.0)
    return grid._replace(limit=np.where(corners, np.floor(lower / unit) * unit, grid.limit))


def _stable_at_places(loop: LoopParameters, hands: HandRange, grid: Grid, unit: float) -> Grid:
    """Return a grid lowered where walls at random places are not stable."""
    rng = np.random.default_rng(0)
    cells = np.indices(grid.cells).reshape(3, -1)
    for _ in range(_ATTEMPTS):
        places = np.repeat(cells, _PLACES, axis=1)
        stable = are_stable(loop, hands, grid, places + rng.random(places.shape))
        if stable.all():
            break
        cells = np.unique(places[:, ~stable], axis=1)
        grid = _lowered(grid, cells, unit)
    return grid


def _below_curves(loop: LoopParameters, hands: HandRange, grid: Grid, unit: float) -> Grid:
    """Return a grid lowered where it is not below the boundaries between its nodes.

    A certified verdict on a device takes milliseconds, too long for many places.
    """
    counts = tuple(count * part for count, part in zip(grid.cells, _PARTS, strict=True))
    sizes = tuple(count + 1 for count in counts)
    places = np.indices(sizes).reshape(3, -1) / np.array(_PARTS)[:, None]
    mass, delay = (
        np.linspace(nodes[0], nodes[-1], count + 1)
        for nodes, count in zip((grid.mass, grid.delay), counts[:2], strict=True)
    )
    damping = interpolated(grid.top, places[:2]) * places[2] / grid.cells[2]
    damping = damping.reshape(sizes)
    exact = np.concatenate(
        [
            boundary_of(loop, hands, one[None], delay).largest_stiffness(row[None])
            for one, row in zip(mass, damping, strict=True)
        ]
    )
    for _ in range(_ATTEMPTS):
        own = interpolated(grid.limit, places).reshape(exact.shape)
        above = places[:, (own > _ENOUGH * exact).ravel()]
        if not above.shape[1]:
            break
        last = np.array(grid.cells)[:, None] - 1
        grid = _lowered(grid, np.unique(np.clip(above.astype(int), 0, last), axis=1), unit)
    return grid


def _is_stable_once(loop: LoopParameters, hands: HandRange, grid: Grid) -> bool:
    """Return whether the stiffest wall of the grid is proved stable for one hand."""
    best = np.unravel_index(np.argmax(grid.limit), grid.limit.shape)
    return bool(are_stable(loop, hands, grid, np.array(best, float)[:, None])[0])
