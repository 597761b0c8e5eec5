"""Proof that a box of loops and angles has no root on the unit circle (lemma B3 of docs/proofs.md).

g of ``jaxstab.boxes.circle`` is expanded at the centre of the box; lemma B2 bounds how far the
plant's second derivatives can bend it. If the enclosed values of g all lie in one open half-plane,
the box is free of roots.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from jaxstab.boxes.circle import QuickPlant, quick_plant
from jaxstab.boxes.plant import BENDS, NUMERATOR_SLOPES
from jaxstab.boxes.wall import Gains, Wall, wall_over
from jaxstab.model.filters import Filters

Reals = Float64[np.ndarray, " boxes"]
Complexes = Complex128[np.ndarray, " boxes"]

_EPS = np.finfo(np.float64).eps
_SUMS = 4 * _EPS  # of each term of g, for each sample that it turns and 8 operations


class Loops(NamedTuple):
    """Loops and an angle each: the five parameters in their order, then theta."""

    alpha: Reals
    beta: Reals
    gamma: Reals
    delta: Reals
    delay: Reals
    theta: Reals


class Exclusion(NamedTuple):
    """Whether a box is proved free of roots on the circle, and how steep g is in each variable."""

    free: Bool[np.ndarray, " boxes"]
    slopes: Float64[np.ndarray, "6 boxes"]


class Expansion(NamedTuple):
    """g over boxes: |g - value - sum_k linear_k (x_k - centre_k)| <= rest.

    ``free`` is the part D/z of the value, ``free_theta`` its derivative by theta; ``rest_slopes``
    says how steep the rest is in each variable, ``rounding`` how much of it is rounding.
    """

    value: Complexes
    linear: Complex128[np.ndarray, "6 boxes"]
    rest: Reals
    free: Complexes
    free_theta: Complexes
    rest_slopes: Float64[np.ndarray, "6 boxes"]
    rounding: Reals


def exclude(center: Loops, radius: Loops, filters: Filters | None = None) -> Exclusion:
    """Prove that no loop of a box center +- radius has a root on the circle at the box's angles.

    Boxes may extend to negative gamma, delta or delay; nothing is proved about those parts.
    """
    g = expansion(center, radius, filters=filters)
    free = is_free(g.value, g.linear * np.stack(radius), g.rest)
    return Exclusion(free, np.abs(g.linear) + g.rest_slopes)


def exclude_any_delay(center: Loops, radius: Loops, filters: Filters | None = None) -> Exclusion:
    """Prove the same as ``exclude`` for these delays and all that are whole samples longer.

    A box is free when nowhere in it |D/z| = |(N/z) H|: then no phase z^-m brings the two to cancel.
    """
    g = expansion(center, radius, filters=filters)
    slope = np.abs(g.linear)
    slope[5] = np.abs(g.free_theta) + np.abs(g.linear[5] - g.free_theta)
    apart = np.abs(np.abs(g.free) - np.abs(g.value - g.free))
    clear = apart - np.sum(slope * np.stack(radius), axis=0) - g.rest
    return Exclusion(clear > 0, slope + g.rest_slopes)


def is_free(
    value: Complexes, moves: Complex128[np.ndarray, "variable boxes"], rest: Reals
) -> Bool[np.ndarray, " boxes"]:
    """Return in which boxes value + sum_k x_k moves_k, |x_k| <= 1, stays off a disc about 0.

    It does where a straight line separates the two. The lines tried are across the value and, best
    for a sum of segments, along each of them.
    """
    size = np.abs(value)
    clear = size * (size - rest) > np.sum(np.abs(_along(value, moves)), axis=0)
    unsure = np.flatnonzero(~clear)
    value, moves, rest = value[unsure], moves[:, unsure], rest[unsure]
    for segment in moves:
        normal = 1j * segment
        seen = np.abs(_along(normal, value)) - np.sum(np.abs(_along(normal, moves)), axis=0)
        clear[unsure] |= seen > rest * np.abs(segment)
    return clear


def expansion(
    center: Loops,
    radius: Loops,
    plant: QuickPlant | None = None,
    filters: Filters | None = None,
) -> Expansion:
    """Expand g over boxes; see lemmas B3 and B10.

    Args:
        center: of the boxes.
        radius: half-widths, >= 0.
        plant: the plant at the centre, if it is known.
        filters: velocity estimator and position filter, in units of one sample.
    """
    if plant is None:
        hand = (np.maximum(value, 0.0) for value in center[2:5])
        plant = quick_plant(*hand)
    turns = np.floor(center.delay) + 1.0
    back = np.exp(-1j * center.theta)  # 1/z
    z = back.conj()
    behind = np.exp(-1j * turns * center.theta)  # z^-m
    lag = 1.0 - back
    gains = Gains(*center[:2], *radius[:2], center.theta, radius.theta)
    wall = wall_over(gains, back, filters)
    ahead, after = behind * plant.n2 * z, behind * plant.n0 * back
    force = ahead + behind * plant.n1 + after  # z^-m N/z
    force_theta = 1j * (ahead - after - turns * force)
    free, free_theta = z + plant.d1 + plant.d0 * back, 1j * (z - plant.d0 * back)
    turned = 1j * center.beta * force * back if filters is None else force * wall.per_theta
    linear = np.stack(
        [
            force * wall.per_alpha,
            force * wall.per_beta,
            plant.impulse + 0j,
            plant.kept - plant.d0 * back,
            behind * lag * -(plant.late + plant.early * z) * wall.value,
            free_theta + force_theta * wall.value + turned,
        ]
    )
    rest, slopes, rounding = _rest(center, radius, plant, (turns, np.abs(lag), wall))
    value = free + force * wall.value
    return Expansion(value, linear, rest + rounding, free, free_theta, slopes, rounding)


def _rest(
    center: Loops, radius: Loops, plant: QuickPlant, parts: tuple[Reals, Reals, Wall]
) -> tuple[Reals, Float64[np.ndarray, "6 boxes"], Reals]:
    """Bound what the expansion leaves, say how steep that is, and bound the rounding."""
    turns, lag_here, wall = parts
    total = np.abs(plant.n2) + np.abs(plant.n1) + np.abs(plant.n0)
    steps = np.floor(center.delay + radius.delay) + 2.0  # the largest m + 1
    lag = np.minimum(lag_here + radius.theta, 2.0)  # the largest |1 - 1/z|
    per_gamma, per_delta, per_delay = NUMERATOR_SLOPES
    force_change = per_gamma * radius.gamma + per_delta * radius.delta
    hand = (
        wall.size * (force_change + lag * radius.delay**2)
        + radius.delay * lag * wall.change
        + BENDS["d1"].rest(radius.gamma, radius.delta)
        + BENDS["d0"].rest(radius.gamma, radius.delta)
    )
    if wall.bend is None:
        turns_of_wall = (2 * steps + 1) * wall.slope
    else:
        turns_of_wall = 2 * steps * wall.slope + wall.bend
    bend = 1.0 + 0.5 * total * (steps**2 * wall.size + turns_of_wall)
    turning = radius.theta * (
        bend * radius.theta
        + radius.delta
        + radius.delay * ((steps * lag + 1) * wall.size + lag * wall.slope)
        + total * (steps * wall.change + wall.turned_change)
    )
    most_force = total + force_change + per_delay * radius.delay
    rounding = _SUMS * (turns + 8) * (4.0 + most_force * wall.terms)
    rounding += plant.d_error + plant.n_error * wall.size + most_force * wall.lost
    slopes = np.zeros((6, len(total)))
    slopes[2], slopes[3] = wall.size * per_gamma, wall.size * per_delta
    slopes[4] = wall.size * lag * radius.delay
    slopes[5] = bend * radius.theta
    return hand + turning, slopes, rounding


def _along(direction: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return the part of complex numbers along a direction, times its length."""
    part: np.ndarray = direction.real * value.real + direction.imag * value.imag
    return part
