"""Loops whose delay moves from sample to sample: stable for every sequence of delays, proved.

Let the delay of each sample lie between L and L + J, in samples, and let the newest sample that has
arrived set the force. The force then differs from that of the loop with the delay L by the last
changes of the computed force, and that difference comes back through the device
(``model.device.sampling``). With x = 1/z, g the polynomial of the loop of delay L (as in
``linear_circle``), H = alpha P + beta V the wall and Q the response of the device to changes that
come up to J late, the way round is a contraction if on the whole unit circle

    |g|^2 > Q |(1 - x) H|^2,

and then, if the loop of delay L is stable, so is every sequence (the small-gain theorem; Kao,
Lincoln 2004; lemma J1 of docs/proofs.md). A sample that is lost is one that arrives a sample later.
Both sides are enclosed over boxes of the angle, which are halved until the inequality holds in all
of each: the circle is covered, not sampled.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from math import inf
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.arrays import PI_REST
from jaxstab.conventions import Verdict
from jaxstab.model.device import SampledDevice
from jaxstab.model.device.sampling import late_response
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import NO_FILTERS, ONE, Filters, Polynomial
from jaxstab.point.verdicts import linear_verdict
from jaxstab.proofs.enclosures import LinearModel, clearances, conjugate, phasor, variable
from jaxstab.proofs.filters import (
    Cells,
    Circle,
    FilterCells,
    OverCells,
    Series,
    cells_of,
    constant,
    filter_cells,
    responses,
)
from jaxstab.proofs.linear_circle import Place, spoilt
from jaxstab.rounding import CLEARANCE, EPS, RAISED

Walls = Float64[np.ndarray, "wall 2"]
Numbered = Int64[np.ndarray, " box"]
Excluded = Float64[np.ndarray, "damping angle"]

_FIRST_BOXES = 64  # of half a turn
_HALVINGS = 24
_MOST_BOXES = 4096  # of a wall at once, beyond which it is given up
_AT_ONCE = 1 << 16  # boxes, of all walls
_EVEN = np.pi * (np.arange(4096) + 0.5) / 4096
_THETA = np.concatenate([np.geomspace(1e-6, _EVEN[0], 512), _EVEN])  # angles of a search
_CLOSE, _SMALLEST = 1e-4, 1e-9  # of the jitter, and in samples
_SHARES = (1e-3, 1e-2, 0.05, 0.2, 0.5)  # by which it is lowered until it is proved
_DEVICES = 256  # that are remembered: 81 sampled hands and masses for each wall that is tried
_DIFFERENCE = (DoubleDouble(1.0, 0.0), DoubleDouble(-1.0, 0.0))  # 1 - x


def is_stable_for_all(
    device: SampledDevice, filters: Filters | None, walls: Walls, jitter: float
) -> Bool[np.ndarray, " wall"]:
    """Which walls (alpha, beta) are proved stable for every sequence of delays.

    The delay of the device is the shortest one, L; the longest is ``jitter`` samples more.
    """
    codes = np.asarray(linear_verdict(walls[:, 0], walls[:, 1], device.loop(filters)))
    proved = np.asarray(codes == Verdict.STABLE)
    if jitter > 0.0 and proved.any():
        cells = MovingCells.from_loop(device, filters, jitter)
        chosen = walls[proved]

        def judge(wall: Numbered, box: Numbered, boxes: int) -> tuple[np.ndarray, np.ndarray]:
            more = excess(cells, chosen, (wall, box), boxes)
            return more.low > 0.0, more.high < 0.0

        proved[proved] = _covered(len(chosen), judge)
    return proved


def are_polygons_stable(
    device: SampledDevice,
    filters: Filters | None,
    corners: Float64[np.ndarray, "polygon corner 2"],
    jitter: float,
) -> Bool[np.ndarray, " polygon"]:
    """Which convex polygons of (alpha, beta) are proved stable for every sequence, all walls.

    Over each box of the angle one straight line parts g, less discs of the radius sqrt(Q) |(1 - x)
    H|, of all corners from 0, and so that of all walls between them (lemma J4).
    """
    alpha, beta = corners[:, 0].T
    codes = np.asarray(linear_verdict(alpha, beta, device.loop(filters)))
    proved = np.asarray(codes == Verdict.STABLE)
    cells, chosen = MovingCells.from_loop(device, filters, jitter), corners[proved]

    def judge(polygon: Numbered, box: Numbered, boxes: int) -> tuple[np.ndarray, np.ndarray]:
        return _are_parted(cells, chosen, (polygon, box), boxes), np.zeros(box.shape, bool)

    proved[proved] = _covered(len(chosen), judge)
    return proved


def stiffest_for_all(
    device: SampledDevice,
    filters: Filters | None,
    beta: Float64[np.ndarray, " damping"],
    most: Float64[np.ndarray, " damping"],
    jitter: float,
) -> Float64[np.ndarray, " damping"]:
    """The alpha up to which the inequality holds at the angles of a search, without a proof.

    It is at most ``most``, and 0 if there is none. Where the inequality does not hold at 0, it is
    the end of the first alphas beyond those that an angle excludes there.
    """
    low, high = MovingCells.from_loop(device, filters, jitter).excluded(beta)
    start = np.max(np.where(low < 0.0, high, 0.0), axis=1)
    beyond = np.maximum(np.where(high > start[:, None], low, inf), start[:, None])
    end = np.minimum(np.min(beyond, axis=1), most)
    return np.where(end > start, end, 0.0)


def largest_jitters(
    device: SampledDevice, filters: Filters | None, walls: Walls, most: float
) -> Float64[np.ndarray, " wall"]:
    """Return a jitter in samples with which each wall is proved stable; 0 if none is.

    It is the largest one up to ``most``, found by bisection at some angles, less the first of some
    shares with which the proof succeeds.
    """
    largest = np.where(np.any(walls, axis=1), 0.0, inf)
    stable = is_stable_for_all(device, filters, walls, 0.0)
    squares = MovingCells.from_loop(device, filters, 1.0).squares(walls)
    for wall in np.flatnonzero(stable & (largest == 0.0)):
        low, high = 0.0, most
        while high - low > _CLOSE * high and high > _SMALLEST:
            tried = 0.5 * (low + high) if low > 0.0 else high / 16.0
            response = late_response(device, tried).values_at(_THETA)
            is_more = bool(np.all(squares[wall] > response))
            low, high = (tried, high) if is_more else (low, tried)
        for share in _SHARES:
            tried = low * (1.0 - share)
            if is_stable_for_all(device, filters, walls[wall, None], tried)[0]:
                largest[wall] = tried
                break
    return np.where(stable, largest, 0.0)


class MovingCells(NamedTuple):
    """A loop on the circle: D, N, 1 - x and Q over cells of the angle; P and T V; F = x^lag N.

    per_velocity: what beta is multiplied with for T V; both roundings are counted by models.
    """

    device: FilterCells
    filters: FilterCells
    lag: float
    per_velocity: float

    @classmethod
    def from_loop(
        cls, device: SampledDevice, filters: Filters | None, jitter: float
    ) -> "MovingCells":
        """Return a loop whose delay moves by ``jitter`` samples; its parts are remembered."""
        plant, period = device.plant, device.sample_time
        lag = float(plant.lag + len(plant.denominator) - len(plant.numerator))
        velocity, position = filters or NO_FILTERS
        chains = filter_cells((velocity.per_sample(period), position.per_sample(period)))
        per_velocity = device.stiffness_unit / device.damping_unit / period
        return cls(_device_cells(device, jitter), chains, lag, per_velocity)

    def gains(self, walls: Walls) -> Walls:
        """Return the factors of P and of T V."""
        return walls * [1.0, self.per_velocity]

    def over(self, box: Numbered, boxes: int) -> "OverBoxes":
        """Return the loop over boxes of the angle, each pi / ``boxes`` wide."""
        distinct, index = np.unique(box, return_inverse=True)
        theta = np.pi * (distinct + 0.5) / boxes
        half = np.full(theta.shape, 0.5 * np.pi / boxes) + 8.0 * EPS
        index = np.ravel(index)
        models = [
            LinearModel(model.centre[index], model.slope[:, index], model.rest[index], model.half)
            for cells in (self.device, self.filters)
            for model in OverCells.from_cells(cells, theta, half).values_along(1)
        ]
        late = variable(0, 1, theta[index], half[index]) * self.lag
        free, force, *others = models
        return OverBoxes(free, phasor(late) * force, *others)

    def squares(self, walls: Walls) -> Float64[np.ndarray, "wall angle"]:
        """Return |g|^2 / |(1 - x) H|^2 at the angles of a search, without bounds."""
        free, force, change, _, position, velocity = self._at_angles()
        stiffness, damping = self.gains(walls).T[..., None]
        there = stiffness * position + damping * velocity
        with np.errstate(all="ignore"):
            squares: np.ndarray = np.abs((free + force * there) / (change * there)) ** 2
        return squares

    def excluded(self, beta: Float64[np.ndarray, " damping"]) -> tuple[Excluded, Excluded]:
        """Return the interval of alpha with |g|^2 <= Q |(1 - x) H|^2, at the angles of a search.

        The difference is quadratic in alpha. An interval from inf is empty.
        """
        free, force, change, response, position, velocity = self._at_angles()
        there = velocity * (self.per_velocity * beta[:, None])
        late, g_at_0 = response.real * np.abs(change) ** 2, free + force * there
        square = np.abs(position) ** 2 * (np.abs(force) ** 2 - late) + np.zeros_like(g_at_0.real)
        middle = np.real((np.conj(g_at_0) * force - late * np.conj(there)) * position)
        constant = np.abs(g_at_0) ** 2 - late * np.abs(there) ** 2
        root = middle**2 - square * constant
        with np.errstate(all="ignore"):
            outer = -(middle + np.copysign(np.sqrt(np.maximum(root, 0.0)), middle))
            low, high = np.sort([outer / square, constant / outer], axis=0)
        is_all = (square < 0.0) & (constant <= 0.0)
        is_none = (square >= 0.0) & ~(root > 0.0)
        low = np.select([is_all, is_none, square < 0.0], [-inf, inf, high], low)
        return low, np.where(square < 0.0, inf, high)

    def _at_angles(self) -> list[np.ndarray]:
        """Return D, F, 1 - x, Q, P and T V at the angles of a search."""
        parts = [*responses(self.device, _THETA)[0], *responses(self.filters, _THETA)[0]]
        parts[1] = parts[1] * np.exp(-1j * self.lag * _THETA)
        return parts


class OverBoxes(NamedTuple):
    """The parts of g and of the inequality over boxes of the angle."""

    free: LinearModel
    force: LinearModel
    change: LinearModel
    response: LinearModel
    position: LinearModel
    velocity: LinearModel

    def g(self, gains: Walls) -> tuple[LinearModel, LinearModel]:
        """Return g and H of the wall of each box."""
        wall = self.position * gains[:, 0] + self.velocity * gains[:, 1]
        return self.free + self.force * wall, wall


@lru_cache(maxsize=_DEVICES)
def _device_cells(device: SampledDevice, jitter: float) -> FilterCells:
    plant, late = device.plant, late_response(device, jitter)

    def functions(middle: Cells, half: Cells, is_wide: bool) -> list[Series]:
        place = Place(middle, half, is_wide)
        mirror = (np.pi - middle) + PI_REST
        near = _in_cosines(middle, half, is_wide, late.about_one, late.errors[0])
        far = _in_cosines(mirror, half, is_wide, late.about_minus_one, late.errors[1])
        change = place.chain([(_DIFFERENCE, ONE)])
        response = near.or_better(far.mirrored())
        return [place.denominator(plant), place.numerator(plant), change, response]

    return cells_of(functions)


def _in_cosines(
    middle: Cells, half: Cells, is_wide: bool, rising: Polynomial, error: float
) -> Series:
    """Return a polynomial in 1 - cos(theta); its coefficients err by ``error`` in all."""
    circle = Circle.over(middle, half, is_wide)
    h = Series(circle.step.value.real, circle.step.error)
    total = constant(0.0, len(middle))
    for c in rising[::-1]:
        total = total * h + circle.coefficient(c, rising)
    return spoilt(total, rising, error * 2.0 ** len(rising))  # h^k has terms of 2^k in all


def _covered(
    count: int, judge: Callable[[Numbered, Numbered, int], tuple[np.ndarray, np.ndarray]]
) -> Bool[np.ndarray, " item"]:
    """Which items are proved on the whole circle, over boxes that are halved.

    ``judge`` takes the numbers of items and of boxes, and how many boxes make half a turn; it
    returns in which of them the item is proved, and in which it is refuted.
    """
    is_open = np.ones(count, bool)
    item, box = (
        numbers.ravel()
        for numbers in np.meshgrid(np.arange(count), np.arange(_FIRST_BOXES), indexing="ij")
    )
    for halving in range(_HALVINGS + 1):
        is_unproved = []
        for start in range(0, item.size, _AT_ONCE):
            chunk = item[start : start + _AT_ONCE], box[start : start + _AT_ONCE]
            is_proved, is_refuted = judge(*chunk, _FIRST_BOXES << halving)
            is_open[chunk[0][is_refuted]] = False
            is_unproved.append(~is_proved)
        unsure = np.concatenate(is_unproved) & is_open[item] if is_unproved else np.zeros(0, bool)
        item, box = item[unsure], box[unsure]
        if not item.size:
            return is_open
        is_open &= np.bincount(item, minlength=count) <= _MOST_BOXES
        item, box = np.repeat(item, 2), np.repeat(2 * box, 2)
        box[1::2] += 1
    is_open[item] = False
    return is_open


def excess(
    cells: MovingCells, walls: Walls, chosen: tuple[Numbered, Numbered], boxes: int
) -> LinearModel:
    """Return |g|^2 - Q |(1 - x) H|^2 of chosen walls over boxes, each pi / ``boxes`` wide."""
    index, box = chosen
    over = cells.over(box, boxes)
    g, wall = over.g(cells.gains(walls)[index])
    more: LinearModel = _square(g) - _real(over.response) * _square(over.change * wall)
    return more


def _are_parted(
    cells: MovingCells,
    corners: Float64[np.ndarray, "polygon corner 2"],
    chosen: tuple[Numbered, Numbered],
    boxes: int,
) -> Bool[np.ndarray, " box"]:
    """Where one of some straight lines parts the discs of all corners from 0."""
    polygon, box = chosen
    over = cells.over(box, boxes)
    late = np.sqrt(np.maximum(_real(over.response).high, 0.0))
    discs = []
    for walls in np.moveaxis(corners, 1, 0):
        g, wall = over.g(cells.gains(walls)[polygon])
        discs.append(replace(g, rest=g.rest + late * (over.change * wall).size * RAISED))
    centres = [g.centre for g in discs]
    sides = [1j * (b - a) for a, b in pairwise([*centres, centres[0]])]
    nearest = np.full(box.shape, -inf)
    for normal in (*centres, *sides):
        nearest = np.maximum(nearest, np.min(clearances(normal, discs)[0], axis=0))
    return nearest > CLEARANCE * np.max(np.abs(centres), axis=0)


def _square(model: LinearModel) -> LinearModel:
    return _real(model * conjugate(model))


def _real(model: LinearModel) -> LinearModel:
    return LinearModel(model.centre.real, model.slope.real, model.rest, model.half)
