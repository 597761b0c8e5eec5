"""Roots on the unit circle of loops with any linear device, for any delay.

With x = 1/z, a delay of n + f samples and the order k of D,

    g = D(z)/z^k + x^(n + 1) F,      F = N_f(z)/z^k (alpha P + beta V),

where N_f is a polynomial in f by pieces (``jaxstab.model.device.delays``). Taylor series of D, P, V
and of its coefficients over cells of the angle give what lemma B4 needs of g over boxes of delays
and angles (lemma B14 of docs/proofs.md).
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.boxes.filter_cells import FilterCells, cells_of
from jaxstab.boxes.first_root import Models
from jaxstab.boxes.in_pieces import PieceBoxes, over_pieces
from jaxstab.boxes.linear_circle import Place, chains_of
from jaxstab.boxes.series import Cells, Series
from jaxstab.boxes.wall import largest_within, responses
from jaxstab.model.device import SampledDevice
from jaxstab.model.device.delays import Piece, pieces_of_delay
from jaxstab.model.filters import Filters

Reals = Float64[np.ndarray, " box"]

_EPS = np.finfo(np.float64).eps
_SUMS = 16 * _EPS  # of the terms of g


class DelayedDevice(NamedTuple):
    """A device and filters on the circle, for all delays.

    Attributes:
        plain: D, P and V over cells of the angle.
        pieces: of the fraction of the delay.
        ends: of the pieces, ascending, from 0 to 1.
    """

    plain: FilterCells
    pieces: tuple[Piece, ...]
    ends: Float64[np.ndarray, " end"]


class DelayBoxes(NamedTuple):
    """Boxes of delays and angles, their middles and half-widths, for walls (alpha, beta)."""

    gains: Float64[np.ndarray, "2 box"]
    delay: Reals
    theta: Reals
    by_delay: Reals
    by_theta: Reals


@lru_cache(maxsize=16)
def delayed_device(device: SampledDevice, filters: Filters | None) -> DelayedDevice | None:
    """Return a device for all delays; None if it is too fast for ``pieces_of_delay``."""
    pieces = pieces_of_delay(device)
    if pieces is None:
        return None
    plant, chains = device.plant, chains_of(device, filters)
    shifted = plant.shifted or (None,) * 4

    def plain(middle: Cells, half: Cells, is_wide: bool) -> list[Series]:
        place = Place(middle, half, is_wide)
        free = place.polynomial(plant.denominator, shifted[1], shifted[3], plant.errors[1])
        return [free, *(place.chain(chain) for chain in chains)]

    ends = [0.0, *(piece.middle + piece.half for piece in pieces)]
    return DelayedDevice(cells_of(plain), pieces, np.array(ends))


def models(device: DelayedDevice, boxes: DelayBoxes) -> tuple[Models, Reals]:
    """Return g over boxes (the axes: delay, theta), and how far |D| is from |F| in them.

    Each box lies within one piece. The second result is a lower bound: where it is positive, no
    delay that differs by whole samples brings a root onto the circle at these angles.
    """
    gains, delay, theta, by_delay, by_theta = boxes
    whole = np.floor(delay)
    numbers = np.searchsorted(device.ends, delay - whole, "right") - 1
    numbers = np.clip(numbers, 0, len(device.pieces) - 1)
    sides = PieceBoxes(numbers, delay - whole, theta, by_delay, by_theta)
    force = over_pieces(device.pieces, sides)
    (free, *walls), (free_theta, *walls_theta), lost = responses(device.plain, theta)
    slopes = largest_within(device.plain.steepness, device.plain, theta, by_theta)
    most = np.abs(gains)
    wall = gains[0] * walls[0] + gains[1] * walls[1]
    wall_theta = gains[0] * walls_theta[0] + gains[1] * walls_theta[1]
    slope = most[0] * slopes[1] + most[1] * slopes[2]
    bend = most[0] * slopes[4] + most[1] * slopes[5]
    size = np.abs(wall) + by_theta * slope
    turns = whole + 1.0
    behind = np.exp(-1j * turns * theta)
    delayed = behind * force.value * wall
    turned = behind * (force.by_theta * wall + force.value * wall_theta)
    moved = behind * force.by_offset * wall
    curved = force.bend * size + 2.0 * force.slope * slope + force.size * bend
    mixed = force.twist * size + force.change * slope
    twice = 0.5 * by_delay**2 * force.curve * size
    rest = 0.5 * by_theta**2 * (slopes[3] + curved) + by_theta * by_delay * mixed + twice
    by_turns = turns * force.size * size + 2.0 * (force.slope * size + force.size * slope)
    by_phase = 0.5 * by_theta**2 * turns * by_turns
    by_phase += by_theta * by_delay * turns * force.change * size
    terms = np.abs(walls[0]) * most[0] + np.abs(walls[1]) * most[1]
    walls_lost = most[0] * (lost[1] + by_theta * lost[4]) + most[1] * (lost[2] + by_theta * lost[5])
    rounding = lost[0] + by_theta * lost[3] + (force.size + by_delay * force.change) * walls_lost
    rounding += (size + terms) * (force.lost + by_theta * force.slope_lost)
    rounding += _SUMS * (1.0 + turns) * (np.abs(free) + force.size * terms)
    rounding += _SUMS * (1.0 + delay) * force.change * terms
    moves = np.stack([moved * by_delay, by_theta * (free_theta + turned - 1j * turns * delayed)])
    rounding += _SUMS * np.sum(np.abs(moves), axis=0)
    apart = np.abs(np.abs(free) - np.abs(delayed)) - rest - rounding
    apart -= by_theta * (np.abs(free_theta) + np.abs(turned)) + by_delay * np.abs(moved)
    by_axis = np.stack([2.0 * twice, by_theta**2 * (slopes[3] + curved) + 2.0 * by_phase])
    bends = by_axis + np.abs(moves)
    return Models(free + delayed, moves, rest + by_phase + rounding, bends, rounding), apart
