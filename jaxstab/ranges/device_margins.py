"""Margins, and robust regions, of loops with any linear device.

As for the device of one mass (``first_crossings``, ``robust_region``), with the functions of
``proofs.linear_circle`` in place of the closed form.
"""

from collections.abc import Sequence
from functools import partial
from math import inf, nan, pi

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Numbers, joined
from jaxstab.conventions import Verdict
from jaxstab.model.device import SampledDevice
from jaxstab.model.device.family import LoopFamily
from jaxstab.model.filters import Filter, Filters, Velocity, known_filters
from jaxstab.model.parameters import wall_grid
from jaxstab.point.verdicts import linear_verdict
from jaxstab.proofs.exclusion import FirstRoots, LineBoxes, Models, search
from jaxstab.proofs.linear_circle import (
    FamilyCells,
    GainLines,
    delay_models,
    family_cells,
    line_models,
    loop_cells,
)
from jaxstab.ranges.box import ParameterBox, Proof
from jaxstab.ranges.margins import (
    Crossings,
    WallMargins,
    along_gains,
    critical_angles,
    crossings_table,
    first_delays,
    in_si_units,
    margins_of,
)
from jaxstab.rounding import RAISED_FEW

# Extra delay of a loop with any linear device: proved.
#
# As for one mass (``first_crossings``), only the angles at which |D| = |N| |H| for some fraction of
# a sample matter; at these the first delay with a root on the circle is searched.

Walls = Float64[np.ndarray, "wall 2"]

_COARSE = np.array([2.0**-7, 2.0**-13])  # half the size of boxes of fractions, angles / pi
_FINE = np.array([2.0**-12, 2.0**-16])  # where the first stretch of delay was free
_MOST_ANGLES = 4000  # such boxes of a wall at once
_MOST_PARTS = 20_000  # of a stretch of delay
_TERMS = 3  # of the polynomials in the fraction, for each part of a piece at first


def _along_delay(device: SampledDevice, walls: Walls, filters: Filters | None) -> Crossings:
    """By how many samples the delay of stable walls (alpha, beta) may at least grow.

    Infinite where no root reaches the circle up to ``MOST_DELAY``, and NaN for a device that is too
    fast for the proof. Source: lemmas B5 and B17 of docs/proofs.md.
    """
    cells = family_cells(LoopFamily.over_delays(device, filters))
    if cells is None:
        return Crossings(*np.full((2, len(walls)), nan))

    def critical(numbers: np.ndarray, is_fine: bool) -> LineBoxes:
        return _critical_angles(cells, walls, numbers, _FINE if is_fine else _COARSE)

    def roots(angles: LineBoxes, begin: np.ndarray, length: np.ndarray) -> FirstRoots:
        start = device.delay + begin
        boxes = _in_pieces(cells, angles, start, length)
        return search(len(walls), boxes, partial(_models, cells, walls, start, length))

    def longest(angles: LineBoxes) -> np.ndarray:
        """The longest stretches that are not cut into more parts than are evaluated together."""
        parts = np.bincount(angles.line, minlength=len(walls)) * len(_fractions(cells))
        return np.maximum(1.0, _MOST_PARTS / np.maximum(parts, 1))

    return first_delays(len(walls), critical, roots, longest)


def _critical_angles(
    cells: FamilyCells,
    walls: Walls,
    numbers: np.ndarray,
    smallest: Float64[np.ndarray, "2"],
) -> LineBoxes:
    def prove(boxes: ParameterBox) -> Proof:
        middle, half = (pi * angle for angle in boxes["angle"])
        over = delay_models(cells, walls[boxes.index].T, boxes["fraction"], (middle, half))
        return Proof(over[1] > 0.0, over[0].bends[1:].T)

    ends = _fractions(cells)
    return critical_angles(numbers, ends, prove, smallest, _MOST_ANGLES * (len(ends) - 1))


def _fractions(cells: FamilyCells) -> Float64[np.ndarray, " end"]:
    """Ends of parts of a sample, more of them where the polynomials have more terms."""
    ends = [
        np.linspace(*piece.ends, 1 + -(-len(piece.stiffness.near) // _TERMS))[:-1]
        for piece in cells.pieces
    ]
    return np.append(np.concatenate(ends), 1.0)


def _in_pieces(
    cells: FamilyCells, angles: LineBoxes, start: np.ndarray, length: np.ndarray
) -> LineBoxes:
    """Divide lines along the delay into the pieces of each sample."""
    boxes = []
    for wall in np.unique(angles.line):
        begin, end = start[wall], start[wall] + length[wall]
        whole = np.arange(np.floor(begin), np.floor(end) + 1.0)
        ends = np.unique(whole[:, None] + _fractions(cells))
        ends = ends[(ends > begin) & (ends < end)]
        t = np.clip([0.0, *((ends - begin) / length[wall]), 1.0], 0.0, 1.0)
        which = np.flatnonzero(angles.line == wall)
        angle, piece = (x.ravel() for x in np.meshgrid(which, np.arange(len(t) - 1), indexing="ij"))
        low = np.stack([t[piece], angles.low[1, angle]])
        high = np.stack([t[piece + 1], angles.high[1, angle]])
        boxes.append(LineBoxes(angles.line[angle], low, high))
    return joined(boxes, -1)


def _models(
    cells: FamilyCells, walls: Walls, start: np.ndarray, length: np.ndarray, boxes: LineBoxes
) -> Models:
    t, theta = 0.5 * (boxes.low + boxes.high)
    by_t, by_theta = 0.5 * (boxes.high - boxes.low) * RAISED_FEW
    delay = start[boxes.line] + length[boxes.line] * t, length[boxes.line] * by_t
    over = delay_models(cells, walls[boxes.line].T, delay, (theta, by_theta))[0]
    return over._replace(moves=over.moves[1:], bends=over.bends[1:])


_AT_ONCE = 32  # walls
_ANGLES, _PER_POLE = 48, 6  # boxes of theta at first
_PIECES = 2  # boxes along a gain at first
_FIRST_STEP = 2.0**-16  # of a gain, in units of the device
_DOUBLINGS = 56


def device_margins(
    device: SampledDevice,
    stiffness: Numbers,
    damping: Numbers,
    *,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> WallMargins:
    """Margins of walls on a sampled device in SI units, one quantity changed at a time.

    For a device with poles far beyond the sampling rate no extra delay is proved (NaN): from about
    a hundred rad per sample on, or some thousand if the poles decay. Source: lemmas B5, B13 and B17
    of docs/proofs.md.
    """
    filters = known_filters(velocity, position)
    units = device.stiffness_unit, device.damping_unit
    point = wall_grid(stiffness=stiffness, damping=damping) * units
    table = device_crossings(device, point.reshape(-1, 2), filters)
    table = table.reshape(*point.shape[:-1], table.shape[-1])
    margins = margins_of(point, table[..., 0], table[..., 1::2])
    return in_si_units(margins, 1.0 / units[0], 1.0 / units[1], device.sample_time)


def is_stable_along(
    devices: Sequence[SampledDevice],
    outline: Float64[np.ndarray, "vertex 2"],
    *,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Bool[np.ndarray, " device"]:
    """For which devices all walls on and inside a closed polygon (K, B) are proved stable.

    The first vertex is not repeated. Source: lemmas B11 and B13 of docs/proofs.md.
    """
    filters = known_filters(velocity, position)
    proved = np.zeros(len(devices), bool)
    for index, device in enumerate(devices):
        start = (outline * [device.stiffness_unit, device.damping_unit]).T
        lines = GainLines(start, np.roll(start, -1, axis=1) - start)
        roots = _first_roots(device, lines, filters)
        code = linear_verdict(start[0, :1], start[1, :1], device.loop(filters))
        proved[index] = np.all(roots.low == inf) and code.item() == Verdict.STABLE
    return proved


def device_crossings(
    device: SampledDevice, walls: Walls, filters: Filters | None
) -> Float64[np.ndarray, "wall column"]:
    """The verdicts on walls (alpha, beta), steps and angles, as ``first_crossings`` has them."""
    loop = device.loop(filters)

    def verdicts(gains: np.ndarray, _: np.ndarray) -> np.ndarray:
        return np.asarray(linear_verdict(gains[0], gains[1], loop))

    def roots(start: np.ndarray, change: np.ndarray) -> FirstRoots:
        return _first_roots(device, GainLines(start, change), filters)

    def ways(stable: Walls) -> list[Crossings]:
        gains = along_gains(stable.T, (_FIRST_STEP, _DOUBLINGS), verdicts, roots)
        return [*gains, _along_delay(device, stable, filters)]

    blocks = np.split(walls, range(_AT_ONCE, len(walls), _AT_ONCE))
    tables = [crossings_table(block, verdicts(block.T, block), ways) for block in blocks]
    return np.concatenate(tables)


def _first_roots(device: SampledDevice, lines: GainLines, filters: Filters | None) -> FirstRoots:
    cells = loop_cells(device, filters)
    count = _ANGLES + _PER_POLE * len(device.loop(filters).base)
    theta = np.pi * (np.arange(count + 2) - 0.5) / count
    t = np.linspace(0.0, 1.0, _PIECES + 1)
    line_count = lines.start.shape[1]
    grid = np.meshgrid(np.arange(line_count), t[:-1], theta[:-1], indexing="ij")
    line, low = grid[0].ravel(), np.stack([column.ravel() for column in grid[1:]])
    boxes = LineBoxes(line, low, low + np.array([[t[1]], [theta[1] - theta[0]]]))
    return search(line_count, boxes, partial(line_models, cells, lines))
