"""Proof that every wall which a guard lets through is stable (lemmas B3, B6, B10, B15).

Boxes of damping, mass and delay (in cells of the grid), of the hand, and of the angle hold all
walls from no stiffness up to the limit of the grid. They are halved until none has a root on the
unit circle. Then all walls of all cells have the same number of unstable roots, and one certified
verdict says that it is none.
"""

from collections.abc import Callable
from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.boxes.exclusion import Loops, expansion
from jaxstab.boxes.filter_cells import filter_cells
from jaxstab.boxes.wall import responses
from jaxstab.conventions import Verdict
from jaxstab.guard.grid import Grid, Models, Pyramid, interpolated
from jaxstab.model import LoopParameters
from jaxstab.model.filters import Filters, known_filters
from jaxstab.point import verdict
from jaxstab.ranges import HandRange

Boxes = Float64[np.ndarray, "axis box"]
Reals = Float64[np.ndarray, " box"]

_AXES = 7  # mass, delay and damping in cells; mass, stiffness, damping of the hand; theta
_AT_ONCE = 1 << 15
_MOST_OF_CELL = 20_000  # boxes; then the proof of a cell is given up
_MOST_OF_GRID = 10_000_000  # or this, over the cells, where they are few
_MOST = 100_000_000  # boxes of all cells
_ANY_WAY = 0.05  # of how far an axis moves g: halving it may help in another direction
_BEYOND = 1e-9  # of pi: angles go so far beyond it
_ROUNDING = 1e-14  # of a product
_SMALL = 1e-6  # of the largest limit
_POSITIVE_UP_TO = 9.0  # of gamma: the impulse response has no zero within a sample (pi^2)


def unproved(
    loop: LoopParameters,
    hands: HandRange,
    grid: Grid,
    cells: Int64[np.ndarray, "3 cell"] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Int64[np.ndarray, "3 cell"]:
    """Return the cells for which it is not proved that no wall has a root on the unit circle.

    Args:
        loop: the loop; its device's mass, its hand and its delay are not used.
        hands: the range of hands.
        grid: what is to be proved.
        cells: the cells of the grid to prove; None for all.
        progress: called with the share of the cells that are done.
    """
    proof = _Proof(loop, hands, grid)
    low, high = _starts(grid, cells)
    rest = np.array([*hands, (0.0, pi * (1.0 + _BEYOND))])[:, :, None]
    low, high = (
        np.concatenate([part, np.broadcast_to(rest[:, end], (4, part.shape[1]))])
        for end, part in enumerate((low, high))
    )
    failed = []
    total = low.shape[1]
    group = max(1, total // 32)
    for first in range(0, total, group):
        some = slice(first, first + group)
        failed.append(proof.failures(0.5 * (low + high)[:, some], 0.5 * (high - low)[:, some]))
        if progress is not None:
            progress(min(1.0, (first + group) / total))
    return np.unique(np.concatenate(failed, axis=1), axis=1)


def are_stable(
    loop: LoopParameters, hands: HandRange, grid: Grid, places: Float64[np.ndarray, "3 place"]
) -> Bool[np.ndarray, " place"]:
    """Return where the wall of the largest stiffness is proved stable for a random hand."""
    rng = np.random.default_rng(2008)
    share = rng.random((3, places.shape[1]))
    mass, stiffness, damping = (
        low + (high - low) * part for (low, high), part in zip(hands, share, strict=True)
    )
    moved = grid.mass[0] + places[0] * _step(grid.mass) + mass
    gain = places[2] / grid.cells[2] * interpolated(grid.top, places[:2])
    period = loop.sample_time
    least = _SMALL * np.max(grid.limit)  # without, a free device drifts
    codes = verdict(
        np.maximum(interpolated(grid.limit, places), least) * period**2 / moved,
        gain * period / moved,
        stiffness * period**2 / moved,
        (loop.device_damping + damping) * period / moved,
        grid.delay[0] + places[1] * _step(grid.delay),
        **loop.filters,
    )
    return np.asarray(codes == Verdict.STABLE)


class _Family(NamedTuple):
    """Loops over boxes, of walls of the largest stiffness or of none.

    Attributes:
        center: of alpha, beta, gamma, delta, delay and theta.
        moves: of alpha, beta, gamma and delta along the axes but theta, (parameter, axis, box).
        rest: how far they may be from these, (parameter, box).
        radius: a bound of both together.
        bending: how much mass, delay, damping and the hand's mass vary in a box, relative.
    """

    center: Loops
    moves: Float64[np.ndarray, "4 6 box"]
    rest: Float64[np.ndarray, "4 box"]
    radius: Loops
    bending: Float64[np.ndarray, "4 box"]


class _Proof:
    """What is the same for all boxes of a proof."""

    def __init__(self, loop: LoopParameters, hands: HandRange, grid: Grid) -> None:
        self._loop, self._hands, self._grid = loop, hands, grid
        self._filters = known_filters(**loop.filters)
        self._start = _start_of(self._filters)
        self._pyramid = Pyramid(grid)

    def failures(self, center: Boxes, half: Boxes) -> Int64[np.ndarray, "3 cell"]:
        """Return the cells in which the proof was given up."""
        cells = self._grid.cells
        tried = np.zeros(cells, int)
        count = 0
        failed = np.zeros(cells, bool)
        while center.shape[1]:
            now = slice(-_AT_ONCE, None)
            at, by = center[:, now], half[:, now]
            center, half = center[:, : -at.shape[1]], half[:, : -at.shape[1]]
            count += at.shape[1]
            if count > _MOST:
                raise RuntimeError(
                    "the proof has no end; narrow the ranges of mass, delay and hands."
                )
            free, shares = self._judged(at, by)
            at, by, shares = at[:, ~free], by[:, ~free], shares[:, ~free]
            cell = tuple(np.floor(at[:3]).astype(int))
            is_small = np.all(by[:3] <= 0.5, axis=0)
            np.add.at(tried, tuple(part[is_small] for part in cell), 1)
            failed |= tried > max(_MOST_OF_CELL, _MOST_OF_GRID // failed.size)
            going = ~(failed[cell] & is_small)
            at, by, axis = at[:, going], by[:, going], np.argmax(shares[:, going], axis=0)
            box = np.arange(axis.size)
            by[axis, box] *= 0.5
            shift = np.zeros_like(at)
            shift[axis, box] = by[axis, box]
            center = np.concatenate([center, at - shift, at + shift], axis=1)
            half = np.concatenate([half, by, by], axis=1)
        return np.stack(np.nonzero(failed))

    def _judged(self, center: Boxes, half: Boxes) -> tuple[Bool[np.ndarray, " box"], Boxes]:
        """Say which boxes are free of roots, and what halving along each axis would help."""
        half = np.concatenate([half[:3], half[3:] * (1.0 + _BEYOND)])  # whose ends are rounded
        families = self._families(center, half)
        seen = [_Seen.of(family, center, half, self._filters) for family in families]
        free, shares = _parted(seen)
        return free | self._is_slow(families[1]), shares

    def _families(self, center: Boxes, half: Boxes) -> tuple[_Family, _Family]:
        """Return the loops of a box without stiffness, and at the limit."""
        grid, period = self._grid, self._loop.sample_time
        low, high = (center - half)[:3], (center + half)[:3]
        limit, top = self._pyramid.limits(low, high), self._pyramid.tops(low[:2], high[:2])
        none = np.zeros((6, half.shape[1]))
        stiffness, damping, spring, friction = none.copy(), none.copy(), none.copy(), none.copy()
        stiffness[:3] = limit.moves
        share, by_share = center[2] / grid.cells[2], half[2] / grid.cells[2]
        damping[:2], damping[2] = share * top.moves, by_share * top.centre
        lost = by_share * np.abs(top.moves).sum(axis=0) + (share + by_share) * top.rest
        spring[4], friction[5] = half[4], half[5]
        mass = grid.mass[0] + center[0] * _step(grid.mass) + center[3]
        by_mass = none.copy()
        by_mass[0], by_mass[3] = half[0] * _step(grid.mass), half[3]
        light = _lightness(mass, by_mass)
        still = np.zeros_like(lost)
        springs = [
            Models(center[4], spring, still),
            Models(center[5] + self._loop.device_damping, friction, still),
        ]
        damper = Models(share * top.centre, damping, lost)
        walls = [
            (Models(still, none, still), damper),
            (Models(limit.centre, stiffness, still), damper),
        ]
        delay = grid.delay[0] + center[1] * _step(grid.delay)
        by_delay = half[1] * _step(grid.delay) * (1.0 + _BEYOND) + _ROUNDING * delay
        bending = np.stack(
            [
                by_mass[0] / mass,
                np.abs(top.moves[1]) / top.centre,
                half[2] / np.maximum(center[2], 0.5),
                by_mass[3] / mass,
            ]
        )
        units = period**2, period, period**2, period
        families = []
        for wall in walls:
            products = [
                _product(model, light, unit)
                for model, unit in zip((*wall, *springs), units, strict=True)
            ]
            moves = np.stack([one.moves for one in products])
            rest = np.stack([one.rest for one in products])
            reach = np.abs(moves).sum(axis=1) + rest
            families.append(
                _Family(
                    Loops._make([*(one.centre for one in products), delay, center[6]]),
                    moves,
                    rest,
                    Loops._make([*reach, by_delay, half[6]]),
                    bending,
                )
            )
        return families[0], families[1]

    def _is_slow(self, family: _Family) -> Bool[np.ndarray, " box"]:
        """Say which boxes lemma B15 frees: all of their angles are next to 0."""
        center, radius = family.center, family.radius
        theta = center.theta + radius.theta
        turns = np.floor(center.delay + radius.delay) + 2.0
        gamma, delta = center.gamma + radius.gamma, center.delta + radius.delta
        beta, friction = center.beta - radius.beta, center.delta - radius.delta
        cosine = 1.0 - 0.5 * (turns * theta) ** 2
        force = np.maximum(1.0 - gamma / 12.0 - delta / 2.0, 0.0)
        slope = self._start.velocity - 0.5 * theta * self._start.velocity_bend
        holds = -np.expm1(-friction) * (1.0 - theta**2 / 6.0) * cosine
        holds += np.maximum(beta, 0.0) * force * cosine**2 * slope
        loses = turns * theta**2 + (center.alpha + radius.alpha) * self._start.position
        known = (cosine > 0.0) & (slope > 0.0) & (gamma <= _POSITIVE_UP_TO)
        return known & (holds * (1.0 - _BEYOND) > loses * (1.0 + _BEYOND))


class _Start(NamedTuple):
    """Filters next to z = 1: bounds of |P'|, of V'(0)/i from below, and of |V"|."""

    position: float
    velocity: float
    velocity_bend: float


def _start_of(filters: Filters | None) -> _Start:
    if filters is None:
        return _Start(0.0, 1.0, 1.0)
    cells = filter_cells(filters)
    _, slopes, lost = responses(cells, np.zeros(1))
    steepest = cells.steepness[0].max(axis=0)
    velocity = float(slopes[1, 0].imag) - float(lost[3, 0])
    return _Start(float(steepest[0]), velocity, float(steepest[3]))


class _Seen(NamedTuple):
    """g over boxes: a value, moves along the axes and then those of rests, and a disc."""

    value: Float64[np.ndarray, " box"]
    moves: np.ndarray
    disc: Reals
    slopes: Boxes  # of the disc along the axes
    bending: Float64[np.ndarray, "4 box"]

    @classmethod
    def of(cls, family: _Family, center: Boxes, half: Boxes, filters: Filters | None) -> "_Seen":
        """Expand g over boxes."""
        g = expansion(family.center, family.radius, filters=filters)
        along = np.einsum("pb,pab->ab", g.linear[:4], family.moves)
        along[1] += g.linear[4] * family.radius.delay
        turned = g.linear[5] * half[6]
        moves = np.concatenate([along, turned[None], g.linear[:4] * family.rest])
        slopes = np.zeros_like(half)
        slopes[1] = g.rest_slopes[4] * family.radius.delay
        slopes[:6] += np.einsum("pb,pab->ab", g.rest_slopes[:4], np.abs(family.moves))
        slopes[6] = g.rest_slopes[5] * half[6]
        slopes[2] += g.rest * half[2] / np.maximum(center[2], 0.5)
        return cls(g.value, moves, g.rest, slopes, family.bending)


def _parted(seen: list[_Seen]) -> tuple[Bool[np.ndarray, " box"], Boxes]:
    """Say where a straight line parts all of g from 0, and what each axis takes from the distance.

    Between the loops without stiffness and those at the limit g is on straight lines.
    """
    none, most = seen
    between = most.value - none.value
    # Across a value, or along what moves g most: the stiffness, the damping, the angle
    normals = [none.value + most.value, most.value, none.value]
    normals += [1j * way for way in (between, most.moves[2], most.moves[6])]
    clear = np.full(between.shape, -np.inf)
    shares = np.zeros(none.slopes.shape)
    lengths = _ANY_WAY * np.abs(most.moves[:_AXES])
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
    axes, rests = projected[:_AXES].copy(), projected[_AXES:].sum(axis=0)
    axes[:4] += rests * bending / bending.sum(axis=0)
    return axes


def _lightness(mass: Reals, by_mass: Boxes) -> Models:
    """Return 1/mass over boxes: its chord, from which it is not far."""
    reach = by_mass.sum(axis=0)
    low, high = mass - reach, mass + reach
    rest = 0.5 * (low**-0.5 - high**-0.5) ** 2  # half of the farthest, below the chord
    slope = -1.0 / (low * high)
    centre = 0.5 * (1.0 / low + 1.0 / high) - rest
    return Models(centre, slope * by_mass, rest * (1.0 + 1e-9) + 1e-15 * centre)


def _product(one: Models, other: Models, unit: float) -> Models:
    """Return the product of two functions over boxes, in other units."""
    moves = one.centre * other.moves + other.centre * one.moves
    swings = [np.abs(model.moves).sum(axis=0) for model in (one, other)]
    rest = swings[0] * swings[1] + one.rest * (other.centre + swings[1] + other.rest)
    rest = rest + (np.abs(one.centre) + swings[0]) * other.rest
    rest = rest + _ROUNDING * (np.abs(one.centre) + swings[0]) * (other.centre + swings[1])
    return Models(unit * one.centre * other.centre, unit * moves, unit * rest)


def _starts(grid: Grid, cells: Int64[np.ndarray, "3 cell"] | None) -> tuple[Boxes, Boxes]:
    """Return the ends of boxes that hold the cells."""
    if cells is not None:
        return cells.astype(float), cells + 1.0
    first, second, third = grid.cells
    places = np.indices((first, second)).reshape(2, -1).astype(float)
    row = np.zeros(places.shape[1])
    return np.vstack([places, row]), np.vstack([places + 1.0, row + third])


def _step(nodes: Float64[np.ndarray, " node"]) -> float:
    return float(nodes[-1] - nodes[0]) / (len(nodes) - 1)
