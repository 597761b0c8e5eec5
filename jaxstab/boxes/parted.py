"""Where a straight line parts all loops of a box, and of all stiffnesses up to a limit, from 0."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.boxes.models import LinearModel

Boxes = Float64[np.ndarray, "axis box"]
Reals = Float64[np.ndarray, " box"]

AXES = 7  # mass, delay and damping in cells; mass, stiffness, damping of the hand; theta
_HAND = slice(3, 6)
BEYOND = 1e-9  # of the angles and of a hand: boxes go so far beyond
_ANY_WAY = 0.05  # of how far an axis moves g: halving it may help in another direction


class Seen(NamedTuple):
    """g over boxes: a value, moves along the axes and then those of rests, and a disc."""

    value: Float64[np.ndarray, " box"]
    moves: np.ndarray
    disc: Reals
    slopes: Boxes  # of the disc along the axes
    bending: Float64[np.ndarray, "4 box"]

    @classmethod
    def of(cls, model: LinearModel) -> "Seen":
        """Return a linear model; its rest counts as that of the axes that move it."""
        size = np.abs(model.slope)
        rest = np.where(np.isfinite(model.rest), model.rest, 0.0)
        slopes = rest * size / np.maximum(size.sum(axis=0), 1e-300)
        return cls(model.centre, model.slope, model.rest, slopes, np.ones((4, rest.size)))


def parted(none: Seen, most: Seen) -> tuple[Bool[np.ndarray, " box"], Boxes]:
    """Say where a straight line parts all of g from 0, and what each axis takes from the distance.

    Between the loops without stiffness and those at the limit g is on straight lines.
    """
    seen = none, most
    between = most.value - none.value
    hand = none.moves[_HAND]
    largest = np.take_along_axis(hand, np.abs(hand).argmax(axis=0)[None], axis=0)[0]
    # Across a value, or along what moves g most: the stiffness, the damping, the angle, the hand,
    # whose parts move it along the sides of a rectangle
    normals = [none.value + most.value, most.value, none.value, largest]
    normals += [1j * way for way in (between, most.moves[2], most.moves[6], largest)]
    clear = np.full(between.shape, -np.inf)
    shares = np.zeros(none.slopes.shape)
    lengths = _ANY_WAY * np.abs(most.moves[:AXES])
    for normal in normals:
        normal = normal / np.maximum(np.abs(normal), 1e-300)
        far = [np.real(normal.conj() * one.value) for one in seen]
        side = np.where(far[0] + far[1] < 0.0, -1.0, 1.0)
        projected = [np.abs(np.real(normal.conj() * one.moves)) for one in seen]
        distances = [
            side * one_far - one_projected.sum(axis=0) - one.disc
            for one, one_far, one_projected in zip(seen, far, projected, strict=True)
        ]
        nearest = np.minimum(*distances)
        better = nearest > clear
        clear = np.where(better, nearest, clear)
        is_none = distances[0] < distances[1]
        parts = [
            _by_axis(one_projected, one.bending) + one.slopes
            for one, one_projected in zip(seen, projected, strict=True)
        ]
        shares = np.where(better, np.where(is_none, *parts), shares)
    return clear > 0.0, shares + lengths


def _by_axis(projected: np.ndarray, bending: np.ndarray) -> np.ndarray:
    """Return moves along the axes; what rests move is that of the axes that bend them."""
    axes, rests = projected[:AXES].copy(), projected[AXES:].sum(axis=0)
    axes[:4] += rests * bending / bending.sum(axis=0)
    return axes
