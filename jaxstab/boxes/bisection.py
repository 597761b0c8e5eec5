"""Boxes of loops that may have a root on the unit circle; all others are proved free of one."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.boxes.exclusion import Exclusion, Loops, exclude

Corners = Float64[np.ndarray, "boxes axis"]

_AT_ONCE = 1 << 14  # boxes that are proved at once


class Boxes(NamedTuple):
    """Boxes center +- half, in coordinates chosen by the caller."""

    center: Corners
    half: Corners

    def select(self, chosen: Bool[np.ndarray, " boxes"]) -> "Boxes":
        """Return some of them."""
        return Boxes(self.center[chosen], self.half[chosen])


class Extent(NamedTuple):
    """The loops of each box: its center, a radius that covers it, and the part of each axis."""

    center: Loops
    radius: Loops
    by_axis: Float64[np.ndarray, "axis 6 boxes"]

    @classmethod
    def of(cls, center: Loops, by_axis: Float64[np.ndarray, "axis 6 boxes"]) -> "Extent":
        """Return the extent of boxes whose radius is the sum of the parts."""
        return cls(center, Loops(*by_axis.sum(axis=0)), by_axis)


class Proof(NamedTuple):
    """Which boxes are proved free, and how much each axis contributes where the proof fails."""

    free: Bool[np.ndarray, " boxes"]
    share: Corners


class Paving(NamedTuple):
    """The smallest boxes that could not be excluded, and whether all boxes were tried."""

    boxes: Boxes
    finished: bool


def pave(
    boxes: Boxes,
    smallest: float | Float64[np.ndarray, " axis"],
    extent: Callable[[Boxes], Extent],
    most: int = 60_000,
    prove: Callable[[Loops, Loops], Exclusion] = exclude,
    *,
    is_numbered: bool = False,
) -> Paving:
    """Halve boxes along the axis that matters most, until they are proved free or the smallest.

    Axes of half-width zero are not split. The work is given up, unfinished, when more than ``most``
    boxes are open at once. Where the first axis ``is_numbered``, it says what boxes belong to: each
    number has so many boxes of its own, and what becomes of it does not depend on the others.
    """

    def proof(boxes: Boxes) -> Proof:
        span = extent(boxes)
        exclusion = prove(span.center, span.radius)
        return Proof(exclusion.free, np.sum(exclusion.slopes * span.by_axis, axis=1).T)

    return pave_by(boxes, smallest, proof, most, is_numbered=is_numbered)


def pave_by(
    boxes: Boxes,
    smallest: float | Float64[np.ndarray, " axis"],
    prove: Callable[[Boxes], Proof],
    most: int = 60_000,
    *,
    is_numbered: bool = False,
) -> Paving:
    """Do the same with any proof of boxes."""
    kept = [Boxes(boxes.center[:0], boxes.half[:0])]
    finished = True
    while len(boxes.center):
        if len(boxes.center) > most:
            given_up = _are_too_many(boxes, most, is_numbered)
            kept.append(boxes.select(given_up))
            boxes, finished = boxes.select(~given_up), finished and not given_up.any()
        free, share = _proved_in_parts(prove, boxes)
        divisible = boxes.half > smallest
        kept.append(boxes.select(~free & ~divisible.any(axis=1)))
        going = ~free & divisible.any(axis=1)
        axis = np.argmax(np.where(divisible, share, -1.0), axis=1)[going]
        boxes = _halved(boxes.select(going), axis)
    return Paving(_joined(kept), finished)


def _are_too_many(boxes: Boxes, most: int, is_numbered: bool) -> Bool[np.ndarray, " boxes"]:
    if not is_numbered:
        return np.full(len(boxes.center), True)
    number = boxes.center[:, 0].astype(np.int64)
    too_many: np.ndarray = np.bincount(number)[number] > most
    return too_many


def _proved_in_parts(prove: Callable[[Boxes], Proof], boxes: Boxes) -> Proof:
    """Return the proofs of boxes: a part at once, as each needs about a hundred numbers."""
    starts = range(0, max(len(boxes.center), 1), _AT_ONCE)
    parts = (Boxes(*(part[i : i + _AT_ONCE] for part in boxes)) for i in starts)
    return Proof(*map(np.concatenate, zip(*map(prove, parts), strict=True)))


def _halved(boxes: Boxes, axis: np.ndarray) -> Boxes:
    rows = np.arange(len(axis))
    half = boxes.half.copy()
    half[rows, axis] /= 2
    shift = np.zeros_like(half)
    shift[rows, axis] = half[rows, axis]
    return Boxes(
        np.concatenate([boxes.center - shift, boxes.center + shift]), np.concatenate([half, half])
    )


def _joined(parts: list[Boxes]) -> Boxes:
    return Boxes(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
