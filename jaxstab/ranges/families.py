"""Walls, and polygons of walls, that are stable in all loops between two, proved."""

from functools import partial
from math import inf, pi

import numpy as np
from jaxtyping import Float64, Int8, Int64

from jaxstab.conventions import Verdict
from jaxstab.model.device.family import LoopFamily
from jaxstab.point.verdicts import linear_verdict
from jaxstab.proofs.exclusion import FirstRoots, Models, Parts, is_free, search
from jaxstab.proofs.linear_circle import FamilyBoxes, FamilyCells, PieceBoxes, family_cells
from jaxstab.proofs.linear_circle import family_models as models
from jaxstab.ranges.box import ParameterBox, Proof, verdicts_of_range

Walls = Float64[np.ndarray, "wall 2"]

_ANGLES = 64  # boxes at first, for half a turn
_AT_ONCE = 64  # walls
_SMALLEST = np.array([2.0**-12, 2.0**-14, 2.0**-20])  # along the edge, of t, of theta / pi
_MOST = 100_000
_SAFE = 1.0 + 2.0**-50


def first_roots(family: LoopFamily, walls: Walls) -> FirstRoots | None:
    """Where along t a root of walls (K, B) is first on the unit circle (lemmas B4 and B17).

    No root is there where ``low`` is infinite. None for loops that need too many pieces.
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
    over = models(cells, FamilyBoxes(gains, np.zeros_like(gains), place))
    return over._replace(moves=over.moves[1:], bends=over.bends[1:])


def family_verdicts(family: LoopFamily, walls: Walls) -> Int8[np.ndarray, " wall"]:
    """Codes of ``Verdict`` for walls (K, B) and all loops between two (lemmas B4, B5 and B17).

    STABLE is proved of all loops; UNSTABLE of one: it has a root on the circle or outside.
    """

    def prove(likely: Int64[np.ndarray, " likely"]) -> Int8[np.ndarray, " likely"]:
        codes = np.full(len(likely), Verdict.UNDECIDED, np.int8)
        roots = first_roots(family, walls[likely])
        if roots is not None:
            codes[roots.low == inf] = Verdict.STABLE
            codes[roots.high < inf] = Verdict.UNSTABLE
        return codes

    ends = np.stack([_end_verdicts(family, share, walls) for share in (0, 1)], axis=-1)
    return verdicts_of_range(ends, prove)


def _end_verdicts(family: LoopFamily, share: int, walls: Walls) -> Int8[np.ndarray, " wall"]:
    device, filters = family.end(share)
    alpha, beta = (walls * [device.stiffness_unit, device.damping_unit]).T
    return np.asarray(linear_verdict(alpha, beta, device.loop(filters)))


def failures(family: LoopFamily, outline: Walls) -> Float64[np.ndarray, " t"] | None:
    """Some t at which walls of a closed polygon could not be proved; an empty array is a proof.

    The polygon has vertices (K, B); a single one is one wall. None for loops that need too many
    pieces. Source: lemmas B11 and B17 of docs/proofs.md.
    """
    roots = first_roots(family, outline)
    if roots is None:
        return None
    failed = roots.low[np.isfinite(roots.low)]
    if not failed.size and len(outline) > 1:
        failed = _failures_on_edges(family, outline * _units(family))
    if not failed.size and not np.all(_end_verdicts(family, 0, outline[:1]) == Verdict.STABLE):
        return np.zeros(1)
    return failed


def _failures_on_edges(family: LoopFamily, outline: Walls) -> Float64[np.ndarray, " t"]:
    """Some t at which walls (alpha, beta) of edges could not be proved free of roots."""
    cells = family_cells(family)
    assert cells is not None
    following = np.roll(outline, -1, axis=0)
    middle, half = 0.5 * (outline + following), 0.5 * (following - outline) * _SAFE

    def prove(boxes: ParameterBox) -> Proof:
        shift, t, angle = boxes.center.T
        by_shift, by_t, by_angle = boxes.half.T * _SAFE
        edge, piece = np.divmod(boxes.index, len(cells.pieces))
        place = PieceBoxes(piece, t, pi * angle, by_t, pi * by_angle)
        along = half[edge].T
        over = models(cells, FamilyBoxes(middle[edge].T + along * shift, along * by_shift, place))
        return Proof(is_free(*over[:3]), over.bends.T)

    index, angle = (
        part.ravel() for part in np.indices((len(outline) * len(cells.pieces), _ANGLES // 4))
    )
    ends = cells.ends[index % len(cells.pieces)].T
    boxes = ParameterBox.of(
        index,
        shift=(0.0, 1.0),
        t=(0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])),
        angle=((angle + 0.5) * 4.0 / _ANGLES, 2.0 / _ANGLES),
    )
    return boxes.paved(prove, _SMALLEST, most=_MOST).boxes["t"][0]


def _units(family: LoopFamily) -> Float64[np.ndarray, " 2"]:
    return np.array([family.first.stiffness_unit, family.first.damping_unit])
