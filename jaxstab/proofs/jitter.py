"""Loops whose delay moves from sample to sample: stable for every sequence of delays, proved.

Let the delay of each sample lie between L and L + J, in samples, and let the newest sample that has
arrived set the force. The force then differs from that of the loop with the delay L by the last
changes of the computed force: in energy by at most

    kappa^2 = n^2 + (2 n + 1) f,      J = n + f,      n = floor(J),

times that of these changes. The difference comes back through the device, with all aliases
(``model.device.aliases``). With x = 1/z, g the polynomial of the loop of delay L (as in
``linear_circle``), H = alpha P + beta V the wall and Q = A^2 |D|^2 the aliases, the way round is a
contraction if on the whole unit circle

    |g|^2 > kappa^2 Q |(1 - x) H|^2,

and then, if the loop of delay L is stable, so is every sequence (the small-gain theorem; Kao,
Lincoln 2004; lemma J1 of docs/proofs.md). A sample that is lost is one that arrives a sample later.
Both sides are enclosed over boxes of the angle, which are halved until the inequality holds in all
of each: the circle is covered, not sampled.
"""

from functools import lru_cache
from math import inf

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.arrays import PI_REST
from jaxstab.conventions import Verdict
from jaxstab.model.device import SampledDevice
from jaxstab.model.device.aliases import aliases
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filters
from jaxstab.model.sections import ONE, Polynomial
from jaxstab.point.verdicts import linear_verdict
from jaxstab.proofs.enclosures import LinearModel, conjugate
from jaxstab.proofs.filters import (
    ORDERS,
    Cells,
    Circle,
    FilterCells,
    OverCells,
    Series,
    cells_of,
    constant,
    responses,
)
from jaxstab.proofs.linear_circle import Place, loop_parts, spoilt
from jaxstab.rounding import EPS

Walls = Float64[np.ndarray, "wall 2"]
PerWall = Float64[np.ndarray, " wall"]
Numbers = Float64[np.ndarray, " number"]
Numbered = Int64[np.ndarray, " box"]

_FIRST_BOXES = 64  # of half a turn
_HALVINGS = 24
_MOST_BOXES = 4096  # of a wall at once, beyond which it is given up
_AT_ONCE = 1 << 16  # boxes, of all walls
_ANGLES = 4096  # at which the largest factor is looked for
_SHARES = (1e-3, 1e-2, 0.05, 0.2, 0.5)  # by which it is lowered until it is proved
_DIFFERENCE = (DoubleDouble(1.0, 0.0), DoubleDouble(-1.0, 0.0))  # 1 - x


def factor_of(samples: Numbers) -> Numbers:
    """Return kappa^2 of delays that move by J samples, rounded up."""
    whole = np.floor(samples)
    factor: Numbers = whole**2 + (2.0 * whole + 1.0) * (samples - whole)
    return factor * (1.0 + 8.0 * EPS)


def samples_of(factor: Numbers) -> Numbers:
    """Return J of kappa^2, rounded down."""
    factor = factor * (1.0 - 16.0 * EPS)
    whole = np.floor(np.sqrt(factor))
    whole = np.where(whole**2 > factor, whole - 1.0, whole)
    with np.errstate(invalid="ignore"):
        samples = whole + np.minimum((factor - whole**2) / (2.0 * whole + 1.0), 1.0)
    return np.where(np.isinf(factor), factor, samples * (1.0 - 8.0 * EPS))


def is_stable_for_all(
    device: SampledDevice, filters: Filters | None, walls: Walls, factor: PerWall
) -> Bool[np.ndarray, " wall"]:
    """Which walls (alpha, beta) are proved stable for every sequence of delays.

    ``factor`` is kappa^2 of each wall; the delay of the device is the shortest one, L.
    """
    codes = np.asarray(linear_verdict(walls[:, 0], walls[:, 1], device.loop(filters)))
    proved = np.asarray(codes == Verdict.STABLE)
    moving = np.flatnonzero(proved & (factor > 0.0))
    if moving.size:
        cells = moving_cells(device, filters)
        proved[moving] = _is_contraction(cells, walls[moving], factor[moving])
    return proved


def largest_factors(device: SampledDevice, filters: Filters | None, walls: Walls) -> PerWall:
    """A kappa^2 with which walls are proved stable; 0 where none is, infinite where any is.

    It is the largest one, less the first of some shares with which the proof succeeds.
    """
    largest = np.zeros(len(walls))
    least = _least_factors(moving_cells(device, filters), walls)
    still = np.any(walls, axis=1)
    for share in _SHARES:
        chosen = np.flatnonzero((largest == 0.0) & still)
        tried = least[chosen] * (1.0 - share)
        proved = is_stable_for_all(device, filters, walls[chosen], tried)
        largest[chosen[proved]] = tried[proved]
    codes = np.asarray(linear_verdict(walls[:, 0], walls[:, 1], device.loop(filters)))
    return np.where(~still & (codes == Verdict.STABLE), inf, largest)


@lru_cache(maxsize=16)
def moving_cells(device: SampledDevice, filters: Filters | None) -> FilterCells:
    """D, F_K, F_B, then (1 - x) P and (1 - x) V, then Q over cells of the angle."""
    known = aliases(device)

    def functions(middle: Cells, half: Cells, is_wide: bool) -> list[Series]:
        place = Place(middle, half, is_wide)
        free, force, *chains = loop_parts(device, filters, place)
        change = place.chain([(_DIFFERENCE, ONE)])
        near = _in_cosines(middle, half, is_wide, known.about_one, known.errors[0])
        mirror = (np.pi - middle) + PI_REST
        far = _in_cosines(mirror, half, is_wide, known.about_minus_one, known.errors[1])
        signs = np.where(np.arange(ORDERS) % 2, -1.0, 1.0)[:, None]
        is_better = near.error[0] <= far.error[0]
        energy = Series(
            np.where(is_better, near.value, far.value * signs),
            np.where(is_better, near.error, far.error),
        )
        walls = [factor * chain for factor in (force, change) for chain in chains]
        return [free, *walls, energy]

    return cells_of(functions)


def _in_cosines(
    middle: Cells, half: Cells, is_wide: bool, rising: Polynomial, error: float
) -> Series:
    """Return a polynomial in 1 - cos(theta); its coefficients err by ``error`` in all."""
    circle = Circle.of(middle, half, is_wide)
    h = Series(circle.step.value.real, circle.step.error)
    total = constant(0.0, len(middle))
    for coefficient in rising[::-1]:
        total = total * h + circle.known(coefficient, rising)
    return spoilt(total, rising, error * 2.0 ** len(rising))  # h^k has terms of 2^k in all


def _is_contraction(cells: FilterCells, walls: Walls, factor: PerWall) -> Bool[np.ndarray, " wall"]:
    """For which walls |g|^2 is proved to exceed factor Q |(1 - x) H|^2 on the whole circle."""
    is_open = np.ones(len(walls), bool)
    wall, box = (
        part.ravel()
        for part in np.meshgrid(np.arange(len(walls)), np.arange(_FIRST_BOXES), indexing="ij")
    )
    for halving in range(_HALVINGS + 1):
        left = []
        for first in range(0, wall.size, _AT_ONCE):
            some = wall[first : first + _AT_ONCE], box[first : first + _AT_ONCE]
            more = excess(cells, walls, factor, some, _FIRST_BOXES << halving)
            is_open[some[0][more.high < 0.0]] = False
            left.append(~(more.low > 0.0))
        unsure = np.concatenate(left) & is_open[wall] if left else np.zeros(0, bool)
        wall, box = wall[unsure], box[unsure]
        if not wall.size:
            return is_open
        is_open &= np.bincount(wall, minlength=len(walls)) <= _MOST_BOXES
        wall, box = np.repeat(wall, 2), np.repeat(2 * box, 2)
        box[1::2] += 1
    is_open[wall] = False
    return is_open


def excess(
    cells: FilterCells,
    walls: Walls,
    factor: PerWall,
    some: tuple[Numbered, Numbered],
    boxes: int,
) -> LinearModel:
    """Return |g|^2 - factor Q |(1 - x) H|^2 of walls over boxes of so many of half a turn."""
    wall, box = some
    known, index = np.unique(box, return_inverse=True)
    theta = np.pi * (known + 0.5) / boxes
    half = np.full(theta.shape, 0.5 * np.pi / boxes) + 8.0 * EPS
    models = OverCells.of(cells, theta, half).values_along(1)
    index = np.ravel(index)
    free, of_alpha, of_beta, change_alpha, change_beta, energy = (
        LinearModel(one.centre[index], one.slope[:, index], one.rest[index], one.half)
        for one in models
    )
    alpha, beta = walls[wall].T
    g = free + of_alpha * alpha + of_beta * beta
    change = change_alpha * alpha + change_beta * beta
    more: LinearModel = _square(g) - _real(energy) * _square(change) * factor[wall]
    return more


def _square(model: LinearModel) -> LinearModel:
    return _real(model * conjugate(model))


def _real(model: LinearModel) -> LinearModel:
    return LinearModel(model.centre.real, model.slope.real, model.rest, model.half)


def _least_factors(cells: FilterCells, walls: Walls) -> PerWall:
    """Return the least |g|^2 / (Q |(1 - x) H|^2) of walls at some angles, without a bound."""
    theta = np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    values = responses(cells, theta)[0]
    least = np.empty(len(walls))
    for number, (alpha, beta) in enumerate(walls):
        g = values[0] + alpha * values[1] + beta * values[2]
        change = alpha * values[3] + beta * values[4]
        with np.errstate(divide="ignore"):
            least[number] = np.min(np.abs(g) ** 2 / (values[5].real * np.abs(change) ** 2))
    return least
