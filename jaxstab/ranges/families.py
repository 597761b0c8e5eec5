"""Walls, and polygons of walls, that are stable in all loops between two, proved."""

from functools import partial
from math import inf, pi

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.conventions import Verdict
from jaxstab.model.device.family import LoopFamily
from jaxstab.point.verdicts import linear_verdict
from jaxstab.proofs.exclusion import (
    Boxes,
    FirstRoots,
    Models,
    Parts,
    Proof,
    is_free,
    pave_by,
    search,
)
from jaxstab.proofs.linear_circle import FamilyBoxes, FamilyCells, PieceBoxes, family_cells
from jaxstab.proofs.linear_circle import family_models as models

Walls = Float64[np.ndarray, "wall 2"]
Outline = Float64[np.ndarray, "vertex 2"]

_ANGLES = 64  # boxes at first, for half a turn
_AT_ONCE = 64  # walls
_SMALLEST = np.array([2.0**-12, 2.0**-14, 2.0**-20, 1.0, 1.0])  # edge, t, theta/pi, edge, piece
_MOST = 100_000
_SAFE = 1.0 + 2.0**-50


def first_roots(family: LoopFamily, walls: Walls) -> FirstRoots | None:
    """Return where along t a root of walls (K, B) is first on the unit circle.

    No root is there where ``low`` is infinite. None for loops that need too many pieces.

    Source: lemmas B4 and B17 of docs/proofs.md.
    """
    cells = family_cells(family)
    if cells is None:
        return None
    walls = walls * _units(family)
    parts = [
        _first_roots(cells, walls[first : first + _AT_ONCE])
        for first in range(0, max(len(walls), 1), _AT_ONCE)
    ]
    return FirstRoots(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _first_roots(cells: FamilyCells, walls: Walls) -> FirstRoots:
    pieces = len(cells.pieces)
    # Roots at 0 and pi are within boxes.
    edges = np.pi * (np.arange(_ANGLES + 2) - 0.5) / _ANGLES
    line, angle = (one.ravel() for one in np.indices((len(walls) * pieces, _ANGLES + 1)))
    ends = cells.ends[line % pieces].T
    parts = Parts(line, np.stack([ends[0], edges[angle]]), np.stack([ends[1], edges[angle + 1]]))
    roots = search(len(walls) * pieces, parts, partial(_wall_models, cells, walls))
    low, high, theta = (one.reshape(len(walls), pieces) for one in roots)
    first = np.argmin(low, axis=1)
    rows = np.arange(len(walls))
    return FirstRoots(low[rows, first], high.min(axis=1), theta[rows, first])


def _wall_models(cells: FamilyCells, walls: Walls, parts: Parts) -> Models:
    wall, piece = np.divmod(parts.line, len(cells.pieces))
    middle, half = 0.5 * (parts.low + parts.high), 0.5 * (parts.high - parts.low) * _SAFE
    place = PieceBoxes(piece, *middle, *half)
    gains = walls[wall].T
    found = models(cells, FamilyBoxes(gains, np.zeros_like(gains), place))
    return found._replace(moves=found.moves[1:], bends=found.bends[1:])


def family_verdicts(family: LoopFamily, walls: Walls) -> Int8[np.ndarray, " wall"]:
    """Return codes of ``Verdict`` for walls (K, B) and all loops between two.

    STABLE is proved of all, UNSTABLE of one of them, that it has a root on the circle or outside.

    Source: lemmas B4, B5 and B17 of docs/proofs.md.
    """
    ends = np.stack([_end_verdicts(family, share, walls) for share in (0, 1)])
    codes = np.full(len(walls), Verdict.UNDECIDED, np.int8)
    codes[np.any(ends == Verdict.UNSTABLE, axis=0)] = Verdict.UNSTABLE
    likely = np.flatnonzero(np.any(ends == Verdict.STABLE, axis=0) & (codes != Verdict.UNSTABLE))
    roots = first_roots(family, walls[likely])
    if roots is not None:
        codes[likely[roots.low == inf]] = Verdict.STABLE
        codes[likely[roots.high < inf]] = Verdict.UNSTABLE
    return codes


def _end_verdicts(family: LoopFamily, share: int, walls: Walls) -> Int8[np.ndarray, " wall"]:
    device, filters = family.end(share)
    alpha, beta = (walls * [device.stiffness_unit, device.damping_unit]).T
    return np.asarray(linear_verdict(alpha, beta, device.loop(filters)))


def failures(family: LoopFamily, outline: Outline) -> Float64[np.ndarray, " t"] | None:
    """Return some t at which walls of a closed polygon could not be proved; none is a proof.

    The polygon has vertices (K, B). None for loops that need too many pieces.

    Source: lemmas B11 and B17 of docs/proofs.md.
    """
    cells = family_cells(family)
    if cells is None:
        return None
    vertices, outline = outline, outline * _units(family)
    following = np.roll(outline, -1, axis=0)
    middle, half = 0.5 * (outline + following), 0.5 * (following - outline) * _SAFE

    def prove(boxes: Boxes) -> Proof:
        shift, t, angle, edge, piece = boxes.center.T
        by_shift, by_t, by_angle = boxes.half.T[:3] * _SAFE
        edge = edge.astype(np.int64)
        place = PieceBoxes(piece.astype(np.int64), t, pi * angle, by_t, pi * by_angle)
        along = half[edge].T
        found = models(cells, FamilyBoxes(middle[edge].T + along * shift, along * by_shift, place))
        zero = np.zeros_like(t)
        return Proof(is_free(*found[:3]), np.stack([*found.bends, zero, zero], axis=-1))

    number, piece, angle = (
        one.ravel() for one in np.indices((len(outline), len(cells.pieces), _ANGLES // 4))
    )
    ends = cells.ends[piece].T
    zero = np.zeros(number.size)
    center = [zero, 0.5 * (ends[0] + ends[1]), (angle + 0.5) * 4.0 / _ANGLES, number, piece]
    size = [zero + 1.0, 0.5 * (ends[1] - ends[0]), zero + 2.0 / _ANGLES, zero, zero]
    boxes = Boxes(np.stack(center, axis=-1), np.stack(size, axis=-1))
    left = pave_by(boxes, _SMALLEST, prove, _MOST).boxes
    if not len(left.center) and not np.all(
        _end_verdicts(family, 0, vertices[:1]) == Verdict.STABLE
    ):
        return np.zeros(1)
    return left.center[:, 1]


def _units(family: LoopFamily) -> Float64[np.ndarray, " 2"]:
    return np.array([family.first.stiffness_unit, family.first.damping_unit])
