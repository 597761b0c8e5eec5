"""Polynomials in z whose coefficients are polynomials in one more number, over boxes of angles.

They are known by pieces (``jaxstab.model.device.delays.Piece``), over a power of z; what lemma B14
of docs/proofs.md says of one bounds it in boxes of the number and the angle.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.arrays import PI_REST
from jaxstab.model.device.delays import Piece

Reals = Float64[np.ndarray, " box"]

_EPS = np.finfo(np.float64).eps
_BEYOND = 1e-7  # of a piece, beyond which its polynomial may not hold


class PieceBoxes(NamedTuple):
    """Boxes, each within a piece: its number, the middles and the half-widths."""

    piece: Int64[np.ndarray, " box"]
    number: Reals
    theta: Reals
    by_number: Reals
    by_theta: Reals


class PieceSums(NamedTuple):
    """N over boxes: in the middle with its derivatives, and bounds in all of the box."""

    value: np.ndarray
    by_theta: np.ndarray
    by_offset: np.ndarray
    size: Reals
    slope: Reals  # |dN/dtheta|
    bend: Reals  # |d^2 N/dtheta^2|
    change: Reals  # |dN/du|
    curve: Reals  # |d^2 N/du^2|
    twist: Reals  # |d^2 N/(du dtheta)|
    lost: Reals
    slope_lost: Reals


def over_pieces(pieces: Sequence[Piece], boxes: PieceBoxes) -> PieceSums:
    """Return N of pieces over boxes."""
    is_far = boxes.theta > 0.5 * np.pi
    columns = np.empty((len(PieceSums._fields), boxes.theta.size), complex)
    keys = 2 * boxes.piece + is_far
    for key in np.unique(keys):
        some = np.flatnonzero(keys == key)
        piece = pieces[key // 2]
        offset, theta = boxes.number[some] - piece.middle, boxes.theta[some]
        sides = boxes.by_number[some], boxes.by_theta[some]
        if key % 2:
            rows = _in_piece(piece, piece.far, offset, (np.pi - theta) + PI_REST, *sides)
            rows[:3] = rows[:3].conj() * (-1.0) ** (piece.far.shape[1] - 1)
            rows[1] *= -1.0
        else:
            rows = _in_piece(piece, piece.near, offset, theta, *sides)
        columns[:, some] = rows
    return PieceSums(*columns[:3], *columns[3:].real)


def _in_piece(
    piece: Piece,
    coefficients: Float64[np.ndarray, "power coefficient"],
    offset: Reals,
    theta: Reals,
    by_number: Reals,
    by_theta: Reals,
) -> np.ndarray:
    """Return the rows of ``PieceSums`` from the coefficients of powers of z - 1.

    With s = 1 - x and order n they are those of s^k x^(n - k); s and all its derivatives but itself
    are at most 1.
    """
    reach = np.abs(offset) + by_number
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
    value, by_angle, by_offset = (
        np.sum(one * other, axis=1)
        for one, other in ((here[0], waves), (here[0], turned), (here[1], waves))
    )
    bend, curve, twist = (
        np.sum(one * other, axis=1)
        for one, other in ((bounds[0], bends), (bounds[2], most), (bounds[1], slopes))
    )
    lost = (size + count + 8) * _EPS
    missed = np.sum((bounds[0] + by_number[:, None] * bounds[1]) * most, axis=1)
    missed = piece.remainder + lost * missed
    missed = np.where(reach <= piece.half * (1.0 + _BEYOND), missed, np.inf)
    slope = np.abs(by_angle) + by_theta * bend + by_number * twist
    change = np.abs(by_offset) + by_theta * twist + by_number * curve
    reached = np.abs(value) + by_theta * slope + by_number * change + missed
    slope_missed = lost * np.sum(bounds[0] * slopes, axis=1)
    rows = [value, by_angle, by_offset, reached, slope + slope_missed, bend, change, curve, twist]
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
