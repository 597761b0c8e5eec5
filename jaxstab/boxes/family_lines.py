"""Roots on the unit circle of all loops between two, for walls along edges.

With x = 1/z and t from 0 to 1 along the family the polynomial of a loop, over a power of z and over
the denominators of filters that do not change, is

    g = D + alpha F_K + beta F_B,      F_K = x^lag S P,      F_B = x^lag R V,

three functions of t and the angle: D, S and R in pieces of t (``jaxstab.model.device.family``), P
and V in cells of the angle. Bounds of their second derivatives give what lemmas B3 and B4 need of g
over boxes of walls, t and angles (lemma B17 of docs/proofs.md).
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.boxes.filter_cells import FilterCells, cells_of
from jaxstab.boxes.first_root import Models
from jaxstab.boxes.in_pieces import PieceBoxes, PieceSums, over_pieces
from jaxstab.boxes.linear_circle import Place, chains_of
from jaxstab.boxes.series import Cells, Series
from jaxstab.boxes.wall import largest_within, responses
from jaxstab.model.device.family import LoopFamily, LoopPiece, pieces_of

Reals = Float64[np.ndarray, " box"]
Walls = Float64[np.ndarray, "2 box"]

_IN_CACHE = 1536  # boxes
_SUMS = 16 * np.finfo(np.float64).eps  # of the terms of g


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


def models(cells: FamilyCells, boxes: FamilyBoxes) -> Models:
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
