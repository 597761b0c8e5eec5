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

from jaxstab.arrays import PI_REST
from jaxstab.boxes.filter_cells import FilterCells, cells_of
from jaxstab.boxes.first_root import Models
from jaxstab.boxes.linear_circle import Place, chains_of
from jaxstab.boxes.series import Cells, Series
from jaxstab.boxes.wall import largest_within, responses
from jaxstab.model.device import SampledDevice
from jaxstab.model.device.delays import Piece, pieces_of_delay
from jaxstab.model.filters import Filters

Reals = Float64[np.ndarray, " box"]

_EPS = np.finfo(np.float64).eps
_SUMS = 16 * _EPS  # of the terms of g
_BEYOND = 1e-7  # of a piece, beyond which its polynomial may not hold


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


class _Force(NamedTuple):
    """N over boxes: in the middle with its derivatives, and bounds in all of the box."""

    value: np.ndarray
    by_theta: np.ndarray
    by_delay: np.ndarray
    size: Reals
    slope: Reals  # |dN/dtheta|
    bend: Reals  # |d^2 N/dtheta^2|
    change: Reals  # |dN/df|
    curve: Reals  # |d^2 N/df^2|
    twist: Reals  # |d^2 N/(df dtheta)|
    lost: Reals
    slope_lost: Reals


def models(device: DelayedDevice, boxes: DelayBoxes) -> tuple[Models, Reals]:
    """Return g over boxes (the axes: delay, theta), and how far |D| is from |F| in them.

    Each box lies within one piece. The second result is a lower bound: where it is positive, no
    delay that differs by whole samples brings a root onto the circle at these angles.
    """
    gains, delay, theta, by_delay, by_theta = boxes
    whole = np.floor(delay)
    force = _force_over(device, boxes, delay - whole)
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
    moved = behind * force.by_delay * wall
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


def _force_over(device: DelayedDevice, boxes: DelayBoxes, fraction: Reals) -> _Force:
    numbers = np.searchsorted(device.ends, fraction, "right") - 1
    numbers = np.clip(numbers, 0, len(device.pieces) - 1)
    is_far = boxes.theta > 0.5 * np.pi
    columns = np.empty((len(_Force._fields), fraction.size), complex)
    for key in np.unique(2 * numbers + is_far):
        some = np.flatnonzero(2 * numbers + is_far == key)
        piece = device.pieces[key // 2]
        offset, theta = fraction[some] - piece.middle, boxes.theta[some]
        by_delay, by_theta = boxes.by_delay[some], boxes.by_theta[some]
        if key % 2:
            rows = _in_piece(
                piece, piece.far, offset, (np.pi - theta) + PI_REST, by_delay, by_theta
            )
            rows[:3] = rows[:3].conj() * (-1.0) ** (piece.far.shape[1] - 1)
            rows[1] *= -1.0
        else:
            rows = _in_piece(piece, piece.near, offset, theta, by_delay, by_theta)
        columns[:, some] = rows
    return _Force(*columns[:3], *columns[3:].real)


def _in_piece(
    piece: Piece,
    coefficients: Float64[np.ndarray, "power coefficient"],
    offset: Reals,
    theta: Reals,
    by_delay: Reals,
    by_theta: Reals,
) -> np.ndarray:
    """Return the rows of ``_Force`` from the coefficients of powers of z - 1.

    With s = 1 - x and order n they are those of s^k x^(n - k); s and all its derivatives but itself
    are at most 1.
    """
    reach = np.abs(offset) + by_delay
    count, size = coefficients.shape
    here, bounds = (
        [_derivative(value, count, order) @ table for order in range(3)]
        for value, table in ((offset, coefficients), (reach, np.abs(coefficients)))
    )
    back = np.exp(-1j * theta)
    step = 2.0 * np.sin(0.5 * theta) ** 2 + 1j * np.sin(theta)
    k = np.arange(size)
    late = size - 1.0 - k
    steps, turns = step[:, None] ** k, back[:, None] ** late
    waves = steps * turns
    below = np.concatenate([np.zeros_like(steps[:, :1]), steps[:, :-1]], axis=1)
    turned = 1j * (k * below * turns * back[:, None] - late * waves)
    most = _derivative(np.abs(step) + by_theta, size, 0)
    once, twice = _shifted(most, 1), _shifted(most, 2)
    slopes = k * once + late * most
    bends = k * (k - 1.0) * twice + k * (1.0 + 2.0 * late) * once + late**2 * most
    value, by_angle, by_fraction = (
        np.sum(one * other, axis=1)
        for one, other in ((here[0], waves), (here[0], turned), (here[1], waves))
    )
    bend, curve, twist = (
        np.sum(one * other, axis=1)
        for one, other in ((bounds[0], bends), (bounds[2], most), (bounds[1], slopes))
    )
    lost = (size + count + 8) * _EPS
    missed = np.sum((bounds[0] + by_delay[:, None] * bounds[1]) * most, axis=1)
    missed = piece.remainder + lost * missed
    missed = np.where(reach <= piece.half * (1.0 + _BEYOND), missed, np.inf)
    slope = np.abs(by_angle) + by_theta * bend + by_delay * twist
    change = np.abs(by_fraction) + by_theta * twist + by_delay * curve
    reached = np.abs(value) + by_theta * slope + by_delay * change + missed
    slope_missed = lost * np.sum(bounds[0] * slopes, axis=1)
    rows = [value, by_angle, by_fraction, reached, slope + slope_missed, bend, change, curve, twist]
    return np.stack([*rows, missed, slope_missed])


def _derivative(value: Reals, count: int, order: int) -> Float64[np.ndarray, "box power"]:
    """Return a derivative of the powers 0, 1, 2, ... of numbers."""
    powers = np.concatenate([np.ones((value.size, 1)), np.repeat(value[:, None], count - 1, 1)], 1)
    powers = np.cumprod(powers, axis=1)
    for _ in range(order):
        powers = _shifted(powers, 1) * np.arange(count)
    return powers


def _shifted(powers: Float64[np.ndarray, "box power"], by: int) -> Float64[np.ndarray, "box power"]:
    """Return the powers that are so many lower, 0 for those below 0."""
    shifted = np.zeros_like(powers)
    shifted[:, by:] = powers[:, :-by]
    return shifted
