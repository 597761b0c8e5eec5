"""Loops of one mass on the unit circle, over boxes of a guard (lemmas B3, B10, B15)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.boxes.exclusion import Loops, expansion
from jaxstab.boxes.filter_cells import filter_cells
from jaxstab.boxes.parted import BEYOND, Boxes, Reals, Seen, parted
from jaxstab.boxes.wall import responses
from jaxstab.guard.grid import Grid, Models, Pyramid, step_of
from jaxstab.model import LoopParameters
from jaxstab.model.filters import Filters, known_filters

_ROUNDING = 1e-14  # of a product
_POSITIVE_UP_TO = 9.0  # of gamma: the impulse response has no zero within a sample (pi^2)


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


class MassBoxes:
    """Loops of one mass over boxes."""

    def __init__(self, loop: LoopParameters, grid: Grid) -> None:
        self._loop, self._grid = loop, grid
        self._filters = known_filters(**loop.filters)
        self._start = _start_of(self._filters)
        self._pyramid = Pyramid(grid)

    def judged(self, center: Boxes, half: Boxes) -> tuple[Bool[np.ndarray, " box"], Boxes]:
        """Say which boxes are free of roots, and what halving along each axis would help."""
        half = np.concatenate([half[:3], half[3:] * (1.0 + BEYOND)])  # whose ends are rounded
        families = self._families(center, half)
        seen = [_seen(family, center, half, self._filters) for family in families]
        free, shares = parted(*seen)
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
        mass = grid.mass[0] + center[0] * step_of(grid.mass) + center[3]
        by_mass = none.copy()
        by_mass[0], by_mass[3] = half[0] * step_of(grid.mass), half[3]
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
        delay = grid.delay[0] + center[1] * step_of(grid.delay)
        by_delay = half[1] * step_of(grid.delay) * (1.0 + BEYOND) + _ROUNDING * delay
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
        return known & (holds * (1.0 - BEYOND) > loses * (1.0 + BEYOND))


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


def _seen(family: _Family, center: Boxes, half: Boxes, filters: Filters | None) -> Seen:
    """Expand g over boxes, of some centers and half-widths of their axes."""
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
    return Seen(g.value, moves, g.rest, slopes, family.bending)


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
