"""Roots on the unit circle of any linear loop, and of all loops between two.

With x = 1/z the polynomial of a loop, divided by a power of z and by the filters' denominators, is

    g = D(x) + alpha F_K(x) + beta F_B(x),      F_K = x^lag N P,      F_B = x^lag N V,

three functions of the angle alone. Taylor series of each over cells of it, with bounds (lemma B10
of docs/proofs.md), give models of them over boxes, whose sums and products give a model of g
(``jaxstab.proofs.enclosures``, lemma B13). Below follow plants that depend on one more parameter,
the way between two loops (lemma B17).
"""

from collections.abc import Sequence
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.arrays import PI_REST, joined, take
from jaxstab.model.device import SampledDevice
from jaxstab.model.device.family import LoopFamily, LoopPiece, Piece, has_spans, pieces_of
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import NO_FILTERS, ONE, Filters, Polynomial
from jaxstab.model.linear_loop import SampledPlant
from jaxstab.proofs.enclosures import LinearModel, phasor, variable
from jaxstab.proofs.exclusion import Models, expanded
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

_EDGE, _PARAMETER, _THETA = 0, -2, -1

"""The axes: along a line of gains, if any; along t, if any; along the angle."""


def chains_of(device: SampledDevice, filters: Filters | None) -> tuple[list[Factor], list[Factor]]:
    """Return short factors of P and of V, the first one 1 - 1/z, in the units of a device."""
    of_position, of_velocity = factors_of(filters or NO_FILTERS, device.sample_time)
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

    def numerator(self, plant: SampledPlant) -> Series:
        """Return N of a device, over its power of z."""
        return self._polynomial(plant, 0)

    def denominator(self, plant: SampledPlant) -> Series:
        """Return D of a device, over its power of z."""
        return self._polynomial(plant, 1)

    def _polynomial(self, plant: SampledPlant, which: int) -> Series:
        """Return Q(z)/z^degree, from the coefficients that are most accurate in each cell."""
        assert plant.shifted is not None  # those of a device are known in powers of z - 1, too
        falling = (plant.numerator, plant.denominator)[which]
        about_one, about_minus_one = plant.shifted[which::2]
        near = _in_steps(Circle.over(self.middle, self.half, self.is_wide), about_one)
        mirror = Circle.over((np.pi - self.middle) + PI_REST, self.half, self.is_wide)
        far = _in_steps(mirror, about_minus_one).mirrored()
        far = Series(far.value * (-1.0) ** (len(falling) - 1), far.error)
        best = self.chain([(falling, ONE)]).or_better(near).or_better(far)
        return spoilt(best, falling, plant.errors[which])


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


# Polynomials in z whose coefficients are polynomials in one parameter, over boxes of angles.
#
# They are known by pieces (``jaxstab.model.device.family.Piece``), over a power of z; what lemma
# B17 of docs/proofs.md says of one bounds it in boxes of the parameter and the angle.

_BEYOND = 1e-7  # of a piece, beyond which its polynomial may not hold


class PieceBoxes(NamedTuple):
    """Boxes of a parameter and the angle, each within a numbered piece: middles and half-widths."""

    piece: Int64[np.ndarray, " box"]
    parameter: Reals
    theta: Reals
    by_parameter: Reals
    by_theta: Reals


def over_pieces(
    polynomials: Sequence[Sequence[Piece]], boxes: PieceBoxes, axes: int
) -> list[tuple[LinearModel, Reals]]:
    """Polynomials, each in pieces, over boxes, and the rounding in their rests.

    The parameter and the angle are the last two of ``axes`` axes.
    """
    is_far = boxes.theta > 0.5 * np.pi
    columns = np.empty((len(polynomials), 5, boxes.theta.size), complex)
    keys = 2 * boxes.piece + is_far
    for key in np.unique(keys):
        chosen = np.flatnonzero(keys == key)
        theta, sides = boxes.theta[chosen], (boxes.by_parameter[chosen], boxes.by_theta[chosen])
        angle = (np.pi - theta) + PI_REST if key % 2 else theta
        waves: dict[int, tuple[np.ndarray, ...]] = {}
        for rows, pieces in zip(columns, polynomials, strict=True):
            piece = pieces[key // 2]
            table = piece.far if key % 2 else piece.near
            size = table.shape[1]
            if size not in waves:
                waves[size] = _waves(size, angle, sides[1])
            offset = boxes.parameter[chosen] - piece.middle
            of_key = _in_piece(piece, table, offset, *sides, waves[size])
            if key % 2:
                of_key[:3] = of_key[:3].conj() * (-1.0) ** (size - 1)
                of_key[2] *= -1.0
            rows[:, chosen] = of_key
    models = []
    for rows in columns:
        slope = np.zeros((axes, boxes.theta.size), complex)
        slope[_PARAMETER], slope[_THETA] = rows[1:3]
        rest, rounding = rows[3:].real
        models.append((LinearModel(rows[0], slope, rest, np.ones((axes, 1))), rounding))
    return models


def _waves(size: int, theta: Reals, by_theta: Reals) -> tuple[np.ndarray, ...]:
    """Return s^k x^(n - k), k = 0 ... n, and derivatives by theta, as columns, n + 1 = ``size``.

    The first two are their values and derivatives in the middle, the others bounds of the moduli of
    values and of two derivatives in the box, for all derivatives of s but itself are at most 1.
    """
    back = np.exp(-1j * theta)
    step = 2.0 * np.sin(0.5 * theta) ** 2 + 1j * np.sin(theta)
    late = size - 1.0 - np.arange(size)
    steps, turned_steps, _ = _powers(step, size)
    turns = _powers(back, size)[0][:, ::-1]
    waves = steps * turns
    turned = 1j * (turned_steps * turns * back[:, None] - late * waves)
    most, once, twice = _powers(np.abs(step) + by_theta, size)
    bends = twice + (1.0 + 2.0 * late) * once + late**2 * most
    return waves, turned, most, once + late * most, bends


def _in_piece(
    piece: Piece,
    coefficients: Float64[np.ndarray, "power coefficient"],
    offset: Reals,
    by_parameter: Reals,
    by_theta: Reals,
    angle: tuple[np.ndarray, ...],
) -> np.ndarray:
    """Return Q, its moves along the parameter and the angle, the rest and the rounding, as rows.

    With u the parameter less the middle of the piece, x = 1/z, s = 1 - x and order n,

        Q = sum_i sum_k c_ik u^i s^k x^(n - k),

    c the coefficients (lemma B17). ``here`` are sum_i c_ik u^i and its derivatives by u in the
    middle, for each k, ``moduli`` the same of the moduli at the largest |u|, and ``bounds`` of
    their values in the box.
    """
    farthest = np.abs(offset) + by_parameter
    count, size = coefficients.shape
    here = [powers @ coefficients for powers in _powers(offset, count)]
    moduli = [powers @ np.abs(coefficients) for powers in _powers(farthest, count, 3)]
    wide = by_parameter[:, None]
    bounds = [
        np.abs(value) + 2 * count * EPS * size_of + wide * change
        for value, size_of, change in zip(here, moduli[:3], moduli[1:], strict=True)
    ]
    waves, turned, most, slopes, bends = angle
    value, by_angle, by_offset = (
        np.sum(a * b, axis=1) for a, b in ((here[0], waves), (here[0], turned), (here[1], waves))
    )
    bend, curve, twist = (
        np.sum(a * b, axis=1)
        for a, b in ((bounds[0], bends), (bounds[2], most), (bounds[1], slopes))
    )
    rest = 0.5 * (by_theta**2 * bend + by_parameter**2 * curve) + by_parameter * by_theta * twist
    rounding = (moduli[0] + wide * moduli[1]) * most
    rounding = np.sum(rounding + by_theta[:, None] * moduli[0] * slopes, axis=1)
    rounding = piece.remainder + (12 * size + count + 8) * EPS * rounding
    rest = np.where(farthest <= piece.half * (1.0 + _BEYOND), rest + rounding, np.inf)
    return np.stack([value, by_offset * by_parameter, by_angle * by_theta, rest, rounding])


def _powers(value: np.ndarray, count: int, most: int = 2) -> list[np.ndarray]:
    """Return the powers 0, 1, 2, ... of numbers, (box, power), and some derivatives of them."""
    order = np.arange(count)
    repeated = np.where(order == 0, 1.0, value[:, None])
    derivatives = [np.cumprod(repeated, axis=1)]
    for _ in range(most):
        lower = np.zeros_like(derivatives[-1])
        lower[:, 1:] = derivatives[-1][:, :-1]
        derivatives.append(lower * order)
    return derivatives


# Roots on the unit circle of all loops between two, for walls along edges.
#
# With x = 1/z and t from 0 to 1 along the family the polynomial of a loop, over a power of z and
# over the denominators of filters that do not change, is
#
#     g = D + alpha F_K + beta F_B,      F_K = x^lag S P,      F_B = x^lag R V,
#
# three functions of t and the angle: D, S and R in pieces of t (``jaxstab.model.device.family``), P
# and V in cells of the angle. Bounds of their second derivatives give what lemmas B3 and B4 need of
# g over boxes of walls, t and angles (lemma B17 of docs/proofs.md). If t is the fraction of a
# delay, whole samples of delay add to the lag alone.

Walls = Float64[np.ndarray, "2 box"]

_IN_CACHE = 1536  # boxes


class FamilyCells(NamedTuple):
    """What does not change with t over cells of the angle, and what does in pieces.

    P and V that all loops share are in ``shared``, and D if it is the same in all loops.
    """

    shared: FilterCells
    pieces: tuple[LoopPiece, ...]
    lags: Float64[np.ndarray, " piece"]
    ends: Float64[np.ndarray, "piece 2"]


class FamilyBoxes(NamedTuple):
    """Boxes of walls along edges, of t and of angles, each in one piece.

    ``gains`` are (alpha, beta) in the middle of the edge, ``edge`` half of it; ``lag`` is the power
    of x.
    """

    gains: Walls
    edge: Walls
    lag: Reals
    place: PieceBoxes


@lru_cache(maxsize=16)
def family_cells(family: LoopFamily) -> FamilyCells | None:
    """Return a family on the circle; None for one that needs too many pieces."""
    pieces = pieces_of(family)
    if pieces is None:
        return None
    chains = chains_of(family.first, family.shared_filters)
    plants = () if has_spans((family.device, family.filters)) else (family.first.plant,)

    def plain(middle: Cells, half: Cells, is_wide: bool) -> list[Series]:
        place = Place(middle, half, is_wide)
        return [*map(place.chain, chains), *map(place.denominator, plants)]

    lags = np.array([float(piece.lag) for piece in pieces])
    return FamilyCells(cells_of(plain), pieces, lags, np.array([piece.ends for piece in pieces]))


def family_models(cells: FamilyCells, boxes: FamilyBoxes) -> Models:
    """Return g over boxes; the axes are the edge, t and theta."""
    count = boxes.lag.size
    if count <= _IN_CACHE:
        return _behind(boxes, *_parts(cells, boxes))
    order = np.lexsort((boxes.place.theta, boxes.place.piece))  # few pieces at once
    places = np.empty(count, np.int64)
    places[order] = np.arange(count)
    chunks = [
        family_models(cells, take(boxes, (..., order[start : start + _IN_CACHE])))
        for start in range(0, count, _IN_CACHE)
    ]
    return take(joined(chunks, -1), (..., places))


def _parts(cells: FamilyCells, boxes: FamilyBoxes) -> tuple[LinearModel, LinearModel, Reals]:
    """Return D, the force (F_K alpha + F_B beta)/x^lag, and the rounding in both."""
    place = boxes.place
    over = OverCells.from_cells(cells.shared, place.theta, place.by_theta)
    position, velocity, *shared = over.values_along(3)
    names = ["stiffness"] if shared else ["stiffness", "free"]
    if any(piece.damping is not piece.stiffness for piece in cells.pieces):
        names.append("damping")
    polynomials = [[getattr(piece, name) for piece in cells.pieces] for name in names]
    parts = dict(zip(names, over_pieces(polynomials, place, 3), strict=True))
    free, rounding = parts.get("free") or (shared[0], over.error[2])
    both = parts["stiffness"], parts.get("damping", parts["stiffness"])
    forces, gains = [], zip(boxes.gains, boxes.edge, strict=True)
    for (numerator, error), response, gain in zip(both, (position, velocity), gains, strict=True):
        forces.append(variable(_EDGE, 3, *gain) * (numerator * response))
        rounding = rounding + np.abs(gain[0] * response.centre) * error
    return free, forces[0] + forces[1], rounding


def _behind(boxes: FamilyBoxes, free: LinearModel, force: LinearModel, rounding: Reals) -> Models:
    """Return the sum of D and the force behind its lag."""
    place = boxes.place
    behind = phasor(variable(_THETA, 3, place.theta, place.by_theta) * boxes.lag)
    return expanded(free, behind * force, rounding, boxes.lag)
