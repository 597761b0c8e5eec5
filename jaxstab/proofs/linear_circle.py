"""Roots on the unit circle of any linear loop whose gains change along lines.

With x = 1/z the polynomial of a loop, divided by a power of z and by the filters' denominators, is

    g = D(x) + alpha F_K(x) + beta F_B(x),      F_K = x^lag N P,      F_B = x^lag N V,

three functions of the angle alone. Taylor series of each over cells of it, with bounds (lemma B10
of docs/proofs.md), give models of them over boxes, whose sums and products give a model of g
(``jaxstab.proofs.enclosures``, lemma B13). Below follow plants that depend on one more parameter:
for any delay, and for all loops between two (lemmas B14, B17).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.arrays import PI_REST, joined, take
from jaxstab.model.device import SampledDevice
from jaxstab.model.device.family import LoopFamily, LoopPiece, Piece, pieces_of, pieces_of_delay
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import ONE, Filter, Filters, Polynomial, Velocity
from jaxstab.proofs.enclosures import LinearModel, phasor, variable
from jaxstab.proofs.exclusion import LineBoxes, Models
from jaxstab.proofs.filters import (
    ORDERS,
    Cells,
    Circle,
    Factor,
    FilterCells,
    OverCells,
    Series,
    cells_of,
    constant,
    factors_of,
    over_halves,
)
from jaxstab.rounding import EPS

Reals = Float64[np.ndarray, " box"]

_SUMS = 16 * EPS  # of a delay
_FLOOR = 256 * EPS  # of the terms of g, and of turns: about what the arithmetic of models adds
_EDGE, _PARAMETER, _THETA = 0, -2, -1

"""The axes: along a line of gains, if any; along t or the delay, if any; along the angle."""


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
        force = force * place.chain([((DoubleDouble(0.0, 0.0),) * late + ONE, ONE)])
        return [free, *(force * place.chain(chain) for chain in chains)]

    return cells_of(functions)


def chains_of(device: SampledDevice, filters: Filters | None) -> tuple[list[Factor], list[Factor]]:
    """Return short factors of P and of V, the first one 1 - 1/z, in the units of a device."""
    of_position, of_velocity = factors_of(filters or (Velocity(), Filter()), device.sample_time)
    unit = DoubleDouble.from_value(device.stiffness_unit / device.damping_unit) / device.sample_time
    return of_position, [((unit,), ONE), *of_velocity]


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
        """Return Q(z)/z^degree, from the coefficients that are most accurate in each cell.

        ``about_one`` are those of Q(z) in powers of z - 1, ``about_minus_one`` those of Q(-z).
        """
        best = self.chain([(falling, ONE)])
        if about_one is None or about_minus_one is None:
            return spoilt(best, falling, error)
        degree = len(falling) - 1
        near = _in_steps(Circle.over(self.middle, self.half, self.is_wide), about_one)
        mirror = Circle.over((np.pi - self.middle) + PI_REST, self.half, self.is_wide)
        far = _in_steps(mirror, about_minus_one)
        signs = np.where(np.arange(ORDERS) % 2, -1.0, 1.0)[:, None] * (-1.0) ** degree
        far = Series(far.value.conj() * signs, far.error)
        for other in (near, far):
            is_better = other.error[0] < best.error[0]
            best = Series(
                np.where(is_better, other.value, best.value),
                np.where(is_better, other.error, best.error),
            )
        return spoilt(best, falling, error)


def _in_steps(circle: Circle, falling: Polynomial) -> Series:
    """Return Q(z)/z^degree from its coefficients in powers of z - 1 = (1 - 1/z) z."""
    count = len(circle.middle)
    back = constant(1.0, count) + Series(-circle.step.value, circle.step.error)
    total = circle.coefficient(falling[0], falling)
    turn = back
    for c in falling[1:]:
        total = total * circle.step + circle.coefficient(c, falling) * turn
        turn = turn * back
    return total


def spoilt(series: Series, falling: Polynomial, error: float) -> Series:
    """Return a polynomial whose coefficients have errors that sum up to ``error`` at most."""
    degree = len(falling)
    errors = [float(error) * degree**k / factorial(k) for k in range(ORDERS)]
    return Series(series.value, series.error + np.array(errors)[:, None])


def line_models(cells: FilterCells, lines: GainLines, boxes: LineBoxes) -> Models:
    """Return g over boxes of lines and angles."""
    t, theta = 0.5 * (boxes.low + boxes.high)
    half = 0.5 * (boxes.high - boxes.low) * (1.0 + 4.0 * EPS)
    change = lines.change[:, boxes.line]
    gains = lines.start[:, boxes.line] + change * t
    over = OverCells.from_cells(cells, theta, half[1])
    free, *forces = over.values_along(2)
    alpha, beta = (variable(_EDGE, 2, *ends) for ends in zip(gains, change * half[0], strict=True))
    rounding = over.error[0] + np.sum(np.abs(gains) * over.error[1:3], axis=0)
    return _expanded(free, alpha * forces[0] + beta * forces[1], rounding)


def _expanded(
    free: LinearModel, force: LinearModel, rounding: Reals, turns: Reals | float = 0.0
) -> Models:
    """The sum g = D + F (alpha P + beta V) of two models, the second behind a number of turns.

    The moves of g by each axis, with its part of the rest, say which axis to halve. ``rounding``
    bounds that of values: where the rest is little more, halving is in vain.
    """
    g = free + force
    moves = np.abs(free.slope) + np.abs(force.slope)
    share = moves / np.maximum(moves.sum(axis=0), 1e-300)
    floor = rounding + _FLOOR * (np.abs(free.centre) + (1.0 + turns) * np.abs(force.centre))
    return Models(g.centre, g.slope, g.rest, np.abs(g.slope) + 2.0 * g.rest * share, floor)


# Polynomials in z whose coefficients are polynomials in one parameter, over boxes of angles.
#
# They are known by pieces (``jaxstab.model.device.family.Piece``), over a power of z; what lemma
# B14 of docs/proofs.md says of one bounds it in boxes of the parameter and the angle.

_BEYOND = 1e-7  # of a piece, beyond which its polynomial may not hold


class PieceBoxes(NamedTuple):
    """Boxes of a parameter and the angle, each within a numbered piece: middles and half-widths."""

    piece: Int64[np.ndarray, " box"]
    parameter: Reals
    theta: Reals
    by_parameter: Reals
    by_theta: Reals


def over_pieces(pieces: Sequence[Piece], boxes: PieceBoxes, axes: int) -> tuple[LinearModel, Reals]:
    """N of pieces over boxes, and the rounding in its rest.

    The parameter and the angle are the last two of ``axes`` axes.
    """
    is_far = boxes.theta > 0.5 * np.pi
    columns = np.empty((5, boxes.theta.size), complex)
    keys = 2 * boxes.piece + is_far
    for key in np.unique(keys):
        chosen = np.flatnonzero(keys == key)
        piece = pieces[key // 2]
        offset, theta = boxes.parameter[chosen] - piece.middle, boxes.theta[chosen]
        sides = boxes.by_parameter[chosen], boxes.by_theta[chosen]
        if key % 2:
            rows = _in_piece(piece, piece.far, offset, (np.pi - theta) + PI_REST, *sides)
            rows[:3] = rows[:3].conj() * (-1.0) ** (piece.far.shape[1] - 1)
            rows[2] *= -1.0
        else:
            rows = _in_piece(piece, piece.near, offset, theta, *sides)
        columns[:, chosen] = rows
    slope = np.zeros((axes, boxes.theta.size), complex)
    slope[_PARAMETER], slope[_THETA] = columns[1:3]
    rest, rounding = columns[3:].real
    return LinearModel(columns[0], slope, rest, np.ones((axes, 1))), rounding


def _in_piece(
    piece: Piece,
    coefficients: Float64[np.ndarray, "power coefficient"],
    offset: Reals,
    theta: Reals,
    by_parameter: Reals,
    by_theta: Reals,
) -> np.ndarray:
    """Return N, its moves along the parameter and the angle, the rest and the rounding, as rows.

    With u the parameter less the middle of the piece, x = 1/z, s = 1 - x and order n,

        N = sum_i sum_k c_ik u^i s^k x^(n - k),

    c the coefficients. ``here`` are sum_i c_ik u^i and its derivatives by u in the middle, for
    each k; ``bounds`` are the same of the moduli at the largest |u|. ``waves`` are s^k x^(n - k)
    there and ``turned`` their derivatives by theta; ``most``, ``slopes`` and ``bends`` bound them
    and their first two derivatives in the box, for all derivatives of s but itself are at most 1
    (lemma B14).
    """
    farthest = np.abs(offset) + by_parameter
    count, size = coefficients.shape
    here, bounds = (
        [_derivative(value, count, order) @ table for order in range(3)]
        for value, table in ((offset, coefficients), (farthest, np.abs(coefficients)))
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
        np.sum(a * b, axis=1) for a, b in ((here[0], waves), (here[0], turned), (here[1], waves))
    )
    bend, curve, twist = (
        np.sum(a * b, axis=1)
        for a, b in ((bounds[0], bends), (bounds[2], most), (bounds[1], slopes))
    )
    rest = 0.5 * (by_theta**2 * bend + by_parameter**2 * curve) + by_parameter * by_theta * twist
    rounding = (bounds[0] + by_parameter[:, None] * bounds[1]) * most
    rounding = np.sum(rounding + by_theta[:, None] * bounds[0] * slopes, axis=1)
    rounding = piece.remainder + (size + count + 8) * EPS * rounding
    rest = np.where(farthest <= piece.half * (1.0 + _BEYOND), rest + rounding, np.inf)
    return np.stack([value, by_offset * by_parameter, by_angle * by_theta, rest, rounding])


def _derivative(value: Reals, count: int, order: int) -> Float64[np.ndarray, "box power"]:
    """Return a derivative of the powers 0, 1, 2, ... of numbers."""
    powers = np.concatenate([np.ones((value.size, 1)), np.repeat(value[:, None], count - 1, 1)], 1)
    powers = np.cumprod(powers, axis=1)
    for _ in range(order):
        powers = _shifted(powers, 1) * np.arange(count)
    return powers


def _shifted(powers: Float64[np.ndarray, "box power"], by: int) -> Float64[np.ndarray, "box power"]:
    """Return the powers that are lower by some number, 0 for those below 0."""
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

    ``plain`` are D, P and V over cells of the angle; ``pieces`` of the fraction of the delay have
    the ``ends``, from 0 to 1.
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
    """Models of g over boxes (the axes: delay, theta), and a lower bound of ||D| - |F||.

    Each box lies within one piece. Where the bound is positive, no delay that differs by whole
    samples brings a root onto the circle at these angles.
    """
    gains, delay, theta, by_delay, by_theta = boxes
    whole = np.floor(delay)
    numbers = np.searchsorted(device.ends, delay - whole, "right") - 1
    numbers = np.clip(numbers, 0, len(device.pieces) - 1)
    # The delay of a box is rounded: it may be farther away.
    half_width = by_delay + _SUMS * (1.0 + delay)
    sides = PieceBoxes(numbers, delay - whole, theta, half_width, by_theta)
    over = OverCells.from_cells(device.plain, theta, by_theta)
    free, *filters = over.values_along(2)
    numerator, rounding = over_pieces(device.pieces, sides, 2)
    wall = filters[0] * gains[0] + filters[1] * gains[1]
    force = numerator * wall
    beyond = (half_width - by_delay) / half_width * np.abs(force.slope[_PARAMETER])
    slope = force.slope * np.stack([by_delay / half_width, np.ones_like(half_width)])
    force = replace(force, slope=slope, rest=force.rest + beyond)
    apart = np.abs(np.abs(free.centre) - np.abs(force.centre)) - free.swing - force.swing
    turns = whole + 1.0
    behind = phasor(variable(_THETA, 2, theta, by_theta) * turns)
    rounding = over.error[0] + rounding * np.abs(wall.centre)
    return _expanded(free, behind * force, rounding, turns), apart


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

    ``gains`` are (alpha, beta) in the middle of the edge, ``edge`` half of it.
    """

    gains: Walls
    edge: Walls
    place: PieceBoxes


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


def family_models(cells: FamilyCells, boxes: FamilyBoxes) -> Models:
    """Return g over boxes; the axes are the edge, t and theta."""
    count = boxes.place.theta.size
    if count <= _IN_CACHE:
        return _models(cells, boxes)
    order = np.lexsort((boxes.place.theta, boxes.place.piece))  # few pieces at once
    places = np.empty(count, np.int64)
    places[order] = np.arange(count)
    chunks = [
        _models(cells, take(boxes, (..., order[start : start + _IN_CACHE])))
        for start in range(0, count, _IN_CACHE)
    ]
    return take(joined(chunks, -1), (..., places))


def _models(cells: FamilyCells, boxes: FamilyBoxes) -> Models:
    place = boxes.place
    (free, rounding), stiffness = (
        over_pieces([getattr(piece, name) for piece in cells.pieces], place, 3)
        for name in ("free", "stiffness")
    )
    damping = stiffness
    if any(piece.damping is not piece.stiffness for piece in cells.pieces):
        damping = over_pieces([piece.damping for piece in cells.pieces], place, 3)
    filters = OverCells.from_cells(cells.filters, place.theta, place.by_theta).values_along(3)
    forces, gains = [], zip(boxes.gains, boxes.edge, strict=True)
    for (numerator, error), response, gain in zip(
        (stiffness, damping), filters, gains, strict=True
    ):
        forces.append(variable(_EDGE, 3, *gain) * (numerator * response))
        rounding = rounding + np.abs(gain[0] * response.centre) * error
    lag = cells.lags[place.piece].astype(np.float64)
    behind = phasor(variable(_THETA, 3, place.theta, place.by_theta) * lag)
    return _expanded(free, behind * (forces[0] + forces[1]), rounding, lag)
