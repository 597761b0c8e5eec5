"""The search for the pieces of one slice: finer and finer, until they close to loops."""

import numpy as np

from jaxstab.arrays import tree_map
from jaxstab.region.crossings import crossings
from jaxstab.region.curve import SliceCoefficients
from jaxstab.region.pieces import Pieces, find_pieces
from jaxstab.region.scan import (
    Angles,
    closer_angles,
    nearly_stable,
    slice_angles,
    suspects,
)

# Fineness of the scan, the most angles to look closer at, and how far other roots may be outside of
# the circle there. The last ones take the angles of the best chances only.
_SCANS = ((1, 24, 1e-4), (4, 192, 1e-4), (16, 768, 1e-4), (64, 1536, 1e-7))
_FILTERED_SCANS = 2  # with filters: what these leave open the others do, too, in minutes
_EMPTY_FINENESS = 4
_ROUNDS = 8
_KEPT = 32  # pieces that do not close


def refined_pieces(c: SliceCoefficients, delay: float, *, may_be_empty: bool) -> Pieces:
    """Return pieces that join up to loops, searched until nothing hides at their ends.

    With damping, the loop without a wall is stable, so an empty answer means that the scan was too
    coarse. Where even the finest scan is not enough, the pieces' ``resolved`` is False.
    """
    length = coefficient_count(delay) if c.filtered is None else c.filtered.parts.shape[1] - 2
    first = slice_angles(c, length, 1)
    closer = crossings(c, first, length)
    scans = _SCANS if c.filtered is None else _SCANS[:_FILTERED_SCANS]
    for fineness, most, outside in scans:
        scan = first if fineness == 1 else slice_angles(c, length, fineness)
        pieces, closer, is_settled = _settled_pieces(c, scan, closer, most, outside, length)
        if is_settled:
            return pieces
        if may_be_empty and fineness >= _EMPTY_FINENESS and not pieces.exists[0]:
            return pieces
    some = tree_map(lambda x: x[:_KEPT] if x.ndim else x, pieces)  # there may be 1e5 of them
    nowhere = np.zeros(len(some.exists), int)
    return some._replace(successor=nowhere, resolved=np.bool_(False))


def _settled_pieces(
    c: SliceCoefficients, scan: Angles, closer: Angles, most: int, outside: float, length: int
) -> tuple[Pieces, Angles, bool]:
    """Look closer at more and more angles, until no new one shows; return whether all is resolved.

    Beside the pieces, the angles looked at are returned.
    """
    closer = nearly_stable(c, closer, outside, length=length)
    for _ in range(_ROUNDS):
        pieces = find_pieces(c, closer_angles(c, scan, closer[:most]), length=length)
        if not pieces.exists[0]:
            return pieces, closer, False
        fresh = suspects(c, pieces, closer, outside, length=length)
        closer = np.sort(np.concatenate([closer, fresh]))
        if not fresh.size or len(closer) > most:
            is_all = not fresh.size and len(closer) <= most
            return pieces, closer, is_all and bool(pieces.resolved)
    return pieces, closer, False


def coefficient_count(delay: float) -> int:
    """Return how many coefficients the polynomials of the other roots have."""
    return int(delay) + 3
