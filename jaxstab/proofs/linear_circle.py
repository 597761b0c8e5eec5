"""Roots on the unit circle of any linear loop whose gains change along lines.

With x = 1/z the polynomial of a loop, divided by a power of z and by the filters' denominators, is

    g = D(x) + alpha F_K(x) + beta F_B(x),      F_K = x^lag N P,      F_B = x^lag N V,

three functions of the angle alone. Taylor series of each over cells of it, with bounds (lemma B10
of docs/proofs.md), give what lemma B4 needs of g over boxes of gains and angles (lemma B13).
"""

from collections.abc import Sequence
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.arrays import PI_REST
from jaxstab.model.device import SampledDevice
from jaxstab.model.device.family import LoopFamily, LoopPiece, Piece, pieces_of, pieces_of_delay
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filter, Filters, Velocity
from jaxstab.model.transfer import ONE, Polynomial
from jaxstab.proofs.exclusion import Models, Parts
from jaxstab.proofs.filters import (
    ORDERS,
    Cells,
    Circle,
    Factor,
    FilterCells,
    Series,
    cells_of,
    constant,
    factors_of,
    largest_within,
    over_halves,
    responses,
)

_EPS = np.finfo(np.float64).eps

_SUMS = 16 * _EPS  # of the terms of g


class GainLines(NamedTuple):
    """Lines through the plane of (alpha, beta): where they start and how far they go."""

    start: Float64[np.ndarray, "2 line"]
    change: Float64[np.ndarray, "2 line"]


@lru_cache(maxsize=16)
def loop_cells(device: SampledDevice, filters: Filters | None) -> FilterCells:
    """Return D, F_K and F_B over cells of the angle."""
    plant, chains = device.plant, chains_of(device, filters)
    late = plant.lag + len(plant.denominator) - len(plant.numerator)
    shifted = plant.shifted or (None,) * 4

    def functions(middle: Cells, half: Cells, is_wide: bool) -> list[Series]:
        place = Place(middle, half, is_wide)
        free = place.polynomial(plant.denominator, shifted[1], shifted[3], plant.errors[1])
        force = place.polynomial(plant.numerator, shifted[0], shifted[2], plant.errors[0])
        force = force * place.chain([(_delay(late), ONE)])
        return [free, *(force * place.chain(chain) for chain in chains)]

    return cells_of(functions)


def chains_of(device: SampledDevice, filters: Filters | None) -> tuple[list[Factor], list[Factor]]:
    """Return short factors of P and of V, the first one 1 - 1/z, in the units of a device."""
    of_position, of_velocity = factors_of(filters or (Velocity(), Filter()), device.sample_time)
    unit = DoubleDouble.of(device.stiffness_unit / device.damping_unit) / device.sample_time
    return of_position, [((unit,), ONE), *of_velocity]


def _delay(samples: int) -> Polynomial:
    zero = DoubleDouble(0.0, 0.0)
    return (zero,) * samples + ONE


class Place(NamedTuple):
    """Cells, either their middles or all of their points, at which functions are known."""

    middle: Cells
    half: Cells
    is_wide: bool

    def chain(self, chain: list[tuple[Polynomial, Polynomial]]) -> Series:
        """Return a product of factors in 1/z."""
        return over_halves(chain, self.middle, self.half, self.is_wide)

    def polynomial(
        self,
        falling: Polynomial,
        about_one: Polynomial | None,
        about_minus_one: Polynomial | None,
        error: float,
    ) -> Series:
        """Return Q(z)/z^degree, from the coefficients that say most in each cell.

        ``about_one`` are those of Q(z) in powers of z - 1, ``about_minus_one`` those of Q(-z).
        """
        best = self.chain([(falling, ONE)])
        if about_one is None or about_minus_one is None:
            return _spoilt(best, falling, error)
        degree = len(falling) - 1
        near = _in_steps(Circle.of(self.middle, self.half, self.is_wide), about_one)
        mirror = Circle.of((np.pi - self.middle) + PI_REST, self.half, self.is_wide)
        far = _in_steps(mirror, about_minus_one)
        signs = np.where(np.arange(ORDERS) % 2, -1.0, 1.0)[:, None] * (-1.0) ** degree
        far = Series(far.value.conj() * signs, far.error)
        for other in (near, far):
            is_better = other.error[0] < best.error[0]
            best = Series(
                np.where(is_better, other.value, best.value),
                np.where(is_better, other.error, best.error),
            )
        return _spoilt(best, falling, error)


def _in_steps(circle: Circle, falling: Polynomial) -> Series:
    """Return Q(z)/z^degree from its coefficients in powers of z - 1 = (1 - 1/z) z."""
    count = len(circle.middle)
    back = constant(1.0, count) + Series(-circle.step.value, circle.step.error)
    total = circle.known(falling[0], falling)
    turn = back
    for coefficient in falling[1:]:
        total = total * circle.step + circle.known(coefficient, falling) * turn
        turn = turn * back
    return total


def _spoilt(series: Series, falling: Polynomial, error: float) -> Series:
    """Return a polynomial whose coefficients have errors that sum up to ``error`` at most."""
    degree = len(falling)
    lost = [float(error) * degree**k / factorial(k) for k in range(ORDERS)]
    return Series(series.value, series.error + np.array(lost)[:, None])


def line_models(cells: FilterCells, lines: GainLines, parts: Parts) -> Models:
    """Return g over boxes of lines and angles."""
    t, theta = 0.5 * (parts.low + parts.high)
    half = 0.5 * (parts.high - parts.low) * (1.0 + 4.0 * _EPS)
    change = lines.change[:, parts.line]
    gains = lines.start[:, parts.line] + change * t
    moved = np.abs(change) * half[0]
    (free, *forces), (free_theta, *forces_theta), lost = responses(cells, theta)
    steep = largest_within(cells.steepness, cells, theta, half[1])
    most = np.abs(gains) + moved
    slopes, bends = steep[:3], steep[3:]
    value = free + gains[0] * forces[0] + gains[1] * forces[1]
    by_t = change[0] * forces[0] + change[1] * forces[1]
    by_theta = free_theta + gains[0] * forces_theta[0] + gains[1] * forces_theta[1]
    bend = 0.5 * half[1] ** 2 * (bends[0] + most[0] * bends[1] + most[1] * bends[2])
    turned_by = half[1] * (moved[0] * slopes[1] + moved[1] * slopes[2])
    terms = np.abs(free) + most[0] * np.abs(forces[0]) + most[1] * np.abs(forces[1])
    rounding = _SUMS * terms
    for weight, k in ((1.0, 0), (most[0], 1), (most[1], 2)):
        rounding = rounding + weight * (lost[k] + half[1] * lost[3 + k])
    moves = np.stack([by_t, by_theta]) * half
    by_axis = np.stack([np.zeros_like(bend), 2.0 * bend]) + np.abs(moves)
    return Models(value, moves, bend + turned_by + rounding, by_axis, rounding)


# Polynomials in z whose coefficients are polynomials in one more number, over boxes of angles.
#
# They are known by pieces (``jaxstab.model.device.family.Piece``), over a power of z; what lemma
# B14 of docs/proofs.md says of one bounds it in boxes of the number and the angle.

Reals = Float64[np.ndarray, " box"]

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


# Roots on the unit circle of loops with any linear device, for any delay.
#
# With x = 1/z, a delay of n + f samples and the order k of D,
#
#     g = D(z)/z^k + x^(n + 1) F,      F = N_f(z)/z^k (alpha P + beta V),
#
# where N_f is a polynomial in f by pieces (``jaxstab.model.device.family``). Taylor series of D, P,
# V and of its coefficients over cells of the angle give what lemma B4 needs of g over boxes of
# delays and angles (lemma B14 of docs/proofs.md).


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


def delay_models(device: DelayedDevice, boxes: DelayBoxes) -> tuple[Models, Reals]:
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


# Roots on the unit circle of all loops between two, for walls along edges.
#
# With x = 1/z and t from 0 to 1 along the family the polynomial of a loop, over a power of z and
# over the denominators of filters that do not change, is
#
#     g = D + alpha F_K + beta F_B,      F_K = x^lag S P,      F_B = x^lag R V,
#
# three functions of t and the angle: D, S and R in pieces of t (``jaxstab.model.device.family``), P
# and V in cells of the angle. Bounds of their second derivatives give what lemmas B3 and B4 need of
# g over boxes of walls, t and angles (lemma B17 of docs/proofs.md).

Walls = Float64[np.ndarray, "2 box"]

_IN_CACHE = 1536  # boxes


class FamilyCells(NamedTuple):
    """The shared P and V over cells of the angle, and what changes with t in pieces."""

    filters: FilterCells
    pieces: tuple[LoopPiece, ...]
    lags: Int64[np.ndarray, " piece"]
    ends: Float64[np.ndarray, "piece 2"]


class FamilyBoxes(NamedTuple):
    """Boxes of walls along edges, of t and of angles, each in one piece.

    Attributes:
        gains: (alpha, beta) in the middle of the edge.
        edge: half of the edge.
        place: the piece, t and angle, with their half-widths.
    """

    gains: Walls
    edge: Walls
    place: PieceBoxes

    def some(self, which: np.ndarray) -> "FamilyBoxes":
        """Return some of them."""
        place = PieceBoxes(*(part[which] for part in self.place))
        return FamilyBoxes(self.gains[:, which], self.edge[:, which], place)


@lru_cache(maxsize=16)
def family_cells(family: LoopFamily) -> FamilyCells | None:
    """Return a family on the circle; None for one that needs too many pieces."""
    pieces = pieces_of(family)
    if pieces is None:
        return None
    chains = chains_of(family.first, family.shared_filters)

    def plain(middle: Cells, half: Cells, is_wide: bool) -> list[Series]:
        place = Place(middle, half, is_wide)
        return [place.chain(chain) for chain in chains]

    lags = np.array([piece.lag for piece in pieces])
    return FamilyCells(cells_of(plain), pieces, lags, np.array([piece.ends for piece in pieces]))


class _Force(NamedTuple):
    """F_K or F_B over boxes: in the middle with its derivatives, and bounds in all of the box."""

    value: np.ndarray
    by_theta: np.ndarray
    by_t: np.ndarray
    slope: Reals  # |dF/dtheta|
    bend: Reals  # |d^2 F/dtheta^2|
    change: Reals  # |dF/dt|
    curve: Reals  # |d^2 F/dt^2|
    twist: Reals  # |d^2 F/(dt dtheta)|
    rounding: Reals


def family_models(cells: FamilyCells, boxes: FamilyBoxes) -> Models:
    """Return g over boxes; the axes are the edge, t and theta."""
    count = boxes.place.theta.size
    if count <= _IN_CACHE:
        return _models(cells, boxes)
    order = np.lexsort((boxes.place.theta, boxes.place.piece))  # few pieces at once
    places = np.empty(count, np.int64)
    places[order] = np.arange(count)
    some = [
        _models(cells, boxes.some(order[first : first + _IN_CACHE]))
        for first in range(0, count, _IN_CACHE)
    ]
    parts = (np.concatenate(part, axis=-1) for part in zip(*some, strict=True))
    return Models(*(part[..., places] for part in parts))


def _models(cells: FamilyCells, boxes: FamilyBoxes) -> Models:
    place = boxes.place
    by_t, by_theta = place.by_number, place.by_theta
    free = over_pieces([piece.free for piece in cells.pieces], place)
    forces = _forces(cells, place)
    gains, most = boxes.gains, np.abs(boxes.gains)
    edges = np.abs(boxes.edge)

    def summed(start: np.ndarray, name: str) -> np.ndarray:
        return start + gains[0] * getattr(forces[0], name) + gains[1] * getattr(forces[1], name)

    def bounded(start: Reals, name: str, weights: Walls) -> Reals:
        return start + weights[0] * getattr(forces[0], name) + weights[1] * getattr(forces[1], name)

    moves = np.stack(
        [
            boxes.edge[0] * forces[0].value + boxes.edge[1] * forces[1].value,
            by_t * summed(free.by_offset, "by_t"),
            by_theta * summed(free.by_theta, "by_theta"),
        ]
    )
    in_t = 0.5 * by_t**2 * bounded(free.curve, "curve", most)
    in_theta = 0.5 * by_theta**2 * bounded(free.bend, "bend", most)
    mixed = by_t * by_theta * bounded(free.twist, "twist", most)
    along_t = by_t * bounded(np.zeros_like(by_t), "change", edges)
    along_theta = by_theta * bounded(np.zeros_like(by_t), "slope", edges)
    terms = np.abs(free.value) + np.sum(np.abs(moves), axis=0)
    rounding = free.lost + by_theta * free.slope_lost + _SUMS * terms
    rounding = rounding + bounded(np.zeros_like(by_t), "rounding", most + edges)
    bends = np.stack(
        [along_t + along_theta, 2.0 * in_t + mixed + along_t, 2.0 * in_theta + mixed + along_theta]
    )
    rest = in_t + in_theta + mixed + along_t + along_theta + rounding
    return Models(summed(free.value, "value"), moves, rest, bends + np.abs(moves), rounding)


def _forces(cells: FamilyCells, place: PieceBoxes) -> list[_Force]:
    by_theta = place.by_theta
    above = [over_pieces([piece.stiffness for piece in cells.pieces], place)]
    if any(piece.damping is not piece.stiffness for piece in cells.pieces):
        above.append(over_pieces([piece.damping for piece in cells.pieces], place))
    waves, turned, lost = responses(cells.filters, place.theta)
    steep = largest_within(cells.filters.steepness, cells.filters, place.theta, by_theta)
    lag = cells.lags[place.piece]
    behind = np.exp(-1j * lag * place.theta)
    forces = []
    for k in range(2):
        filtered = waves[k], turned[k], steep[k], steep[2 + k], lost[k] + by_theta * lost[2 + k]
        forces.append(_filtered(above[min(k, len(above) - 1)], filtered, behind, lag, by_theta))
    return forces


def _filtered(
    above: PieceSums,
    filtered: tuple[np.ndarray, np.ndarray, Reals, Reals, Reals],
    behind: np.ndarray,
    lag: np.ndarray,
    by_theta: Reals,
) -> _Force:
    """Return x^lag times S times P, the latter by value, derivative, bounds and what it lost."""
    value, turned, steep, bent, lost = filtered
    size = np.abs(value) + by_theta * steep
    slope = above.slope * size + above.size * steep
    product = above.value * value
    by_angle = above.by_theta * value + above.value * turned - 1j * lag * product
    missed = 2.0 * size * (above.lost + by_theta * above.slope_lost) + 2.0 * above.size * lost
    return _Force(
        value=behind * product,
        by_theta=behind * by_angle,
        by_t=behind * above.by_offset * value,
        slope=slope + lag * above.size * size,
        bend=above.bend * size
        + 2.0 * above.slope * steep
        + above.size * bent
        + 2.0 * lag * slope
        + lag**2 * above.size * size,
        change=above.change * size,
        curve=above.curve * size,
        twist=above.twist * size + above.change * (steep + lag * size),
        rounding=(1.0 + lag * by_theta) * (missed + _SUMS * (1.0 + lag) * above.size * size),
    )
