"""Where a straight line parts all loops of a box, and of all stiffnesses up to a limit, from 0."""

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.boxes.models import LinearModel

Boxes = Float64[np.ndarray, "axis box"]

AXES = 7  # mass, delay and damping in cells; mass, stiffness, damping of the hand; theta
_HAND = slice(3, 6)
BEYOND = 1e-9  # of the angles and of a hand: boxes go so far beyond
_ANY_WAY = 0.05  # of how far an axis moves g: halving it may help in another direction


def parted(none: LinearModel, most: LinearModel) -> tuple[Bool[np.ndarray, " box"], Boxes]:
    """Say where a straight line parts all of g from 0, and what each axis takes from the distance.

    Between the loops without stiffness and those at the limit g is on straight lines.
    """
    between = most.centre - none.centre
    hand = none.slope[_HAND]
    largest = np.take_along_axis(hand, np.abs(hand).argmax(axis=0)[None], axis=0)[0]
    # Across a value, or along what moves g most: the stiffness, the damping, the angle, the hand,
    # whose parts move it along the sides of a rectangle
    normals = [none.centre + most.centre, most.centre, none.centre, largest]
    normals += [1j * way for way in (between, most.slope[2], most.slope[6], largest)]
    clear = np.full(between.shape, -np.inf)
    shares = np.zeros(none.slope.shape)
    for normal in normals:
        normal = normal / np.maximum(np.abs(normal), 1e-300)
        far = [np.real(normal.conj() * one.centre) for one in (none, most)]
        side = np.where(far[0] + far[1] < 0.0, -1.0, 1.0)
        moves = [np.abs(np.real(normal.conj() * one.slope)) for one in (none, most)]
        distances = [
            side * one_far - one_moves.sum(axis=0) - one.rest
            for one, one_far, one_moves in zip((none, most), far, moves, strict=True)
        ]
        nearest = np.minimum(*distances)
        better = nearest > clear
        clear = np.where(better, nearest, clear)
        parts = [taken(one, by) for one, by in zip((none, most), moves, strict=True)]
        shares = np.where(better, np.where(distances[0] < distances[1], *parts), shares)
    return clear > 0.0, shares + _ANY_WAY * np.abs(most.slope)


def taken(model: LinearModel, moves: Boxes) -> Boxes:
    """Return what each axis takes: its move along a normal, and its part of the rest.

    The rest counts as that of the axes that move the model in any direction.
    """
    size = np.abs(model.slope)
    rest = np.where(np.isfinite(model.rest), model.rest, 0.0)
    shares: Boxes = moves + rest * size / np.maximum(size.sum(axis=0), 1e-300)
    return shares
