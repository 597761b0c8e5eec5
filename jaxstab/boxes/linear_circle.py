"""Roots on the unit circle of any linear loop whose gains change along lines.

With x = 1/z the polynomial of a loop, divided by a power of z and by the filters' denominators, is

    g = D(x) + alpha F_K(x) + beta F_B(x),      F_K = x^lag N P,      F_B = x^lag N V,

three functions of the angle alone. Taylor series of each over cells of it, with bounds (lemma B10
of docs/proofs.md), give what lemma B4 needs of g over boxes of gains and angles (lemma B13).
"""

from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import PI_REST
from jaxstab.boxes.filter_cells import (
    Circle,
    Factor,
    FilterCells,
    cells_of,
    factors_of,
    over_halves,
)
from jaxstab.boxes.first_root import Models, Parts
from jaxstab.boxes.series import ORDERS, Cells, Series, constant
from jaxstab.boxes.wall import largest_within, responses
from jaxstab.model.device import SampledDevice
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filter, Filters, Velocity
from jaxstab.model.transfer import ONE, Polynomial

_EPS = np.finfo(np.float64).eps
_SUMS = 16 * _EPS  # of the terms of g


class GainLines(NamedTuple):
    """Lines through the plane of (alpha, beta): where they start and how far they go."""

    start: Float64[np.ndarray, "2 line"]
    change: Float64[np.ndarray, "2 line"]


@lru_cache(maxsize=16)
def loop_cells(device: SampledDevice, filters: Filters | None) -> FilterCells:
    """Return D, F_K and F_B over cells of the angle."""
    plant, chains = device.plant, chains_of(device, filters)
    late = plant.lag + len(plant.denominator) - len(plant.numerator)
    shifted = plant.shifted or (None,) * 4

    def functions(middle: Cells, half: Cells, is_wide: bool) -> list[Series]:
        place = Place(middle, half, is_wide)
        free = place.polynomial(plant.denominator, shifted[1], shifted[3], plant.errors[1])
        force = place.polynomial(plant.numerator, shifted[0], shifted[2], plant.errors[0])
        force = force * place.chain([(_delay(late), ONE)])
        return [free, *(force * place.chain(chain) for chain in chains)]

    return cells_of(functions)


def chains_of(device: SampledDevice, filters: Filters | None) -> tuple[list[Factor], list[Factor]]:
    """Return short factors of P and of V, the first one 1 - 1/z, in the units of a device."""
    of_position, of_velocity = factors_of(filters or (Velocity(), Filter()), device.sample_time)
    unit = DoubleDouble.of(device.stiffness_unit / device.damping_unit) / device.sample_time
    return of_position, [((unit,), ONE), *of_velocity]


def _delay(samples: int) -> Polynomial:
    zero = DoubleDouble(0.0, 0.0)
    return (zero,) * samples + ONE


class Place(NamedTuple):
    """Cells, either their middles or all of their points, at which functions are known."""

    middle: Cells
    half: Cells
    is_wide: bool

    def chain(self, chain: list[tuple[Polynomial, Polynomial]]) -> Series:
        """Return a product of factors in 1/z."""
        return over_halves(chain, self.middle, self.half, self.is_wide)

    def polynomial(
        self,
        falling: Polynomial,
        about_one: Polynomial | None,
        about_minus_one: Polynomial | None,
        error: float,
    ) -> Series:
        """Return Q(z)/z^degree, from the coefficients that say most in each cell.

        ``about_one`` are those of Q(z) in powers of z - 1, ``about_minus_one`` those of Q(-z).
        """
        best = self.chain([(falling, ONE)])
        if about_one is None or about_minus_one is None:
            return _spoilt(best, falling, error)
        degree = len(falling) - 1
        near = _in_steps(Circle.of(self.middle, self.half, self.is_wide), about_one)
        mirror = Circle.of((np.pi - self.middle) + PI_REST, self.half, self.is_wide)
        far = _in_steps(mirror, about_minus_one)
        signs = np.where(np.arange(ORDERS) % 2, -1.0, 1.0)[:, None] * (-1.0) ** degree
        far = Series(far.value.conj() * signs, far.error)
        for other in (near, far):
            is_better = other.error[0] < best.error[0]
            best = Series(
                np.where(is_better, other.value, best.value),
                np.where(is_better, other.error, best.error),
            )
        return _spoilt(best, falling, error)


def _in_steps(circle: Circle, falling: Polynomial) -> Series:
    """Return Q(z)/z^degree from its coefficients in powers of z - 1 = (1 - 1/z) z."""
    count = len(circle.middle)
    back = constant(1.0, count) + Series(-circle.step.value, circle.step.error)
    total = circle.known(falling[0], falling)
    turn = back
    for coefficient in falling[1:]:
        total = total * circle.step + circle.known(coefficient, falling) * turn
        turn = turn * back
    return total


def _spoilt(series: Series, falling: Polynomial, error: float) -> Series:
    """Return a polynomial whose coefficients have errors that sum up to ``error`` at most."""
    degree = len(falling)
    lost = [float(error) * degree**k / factorial(k) for k in range(ORDERS)]
    return Series(series.value, series.error + np.array(lost)[:, None])


def line_models(cells: FilterCells, lines: GainLines, parts: Parts) -> Models:
    """Return g over boxes of lines and angles."""
    t, theta = 0.5 * (parts.low + parts.high)
    half = 0.5 * (parts.high - parts.low) * (1.0 + 4.0 * _EPS)
    change = lines.change[:, parts.line]
    gains = lines.start[:, parts.line] + change * t
    moved = np.abs(change) * half[0]
    (free, *forces), (free_theta, *forces_theta), lost = responses(cells, theta)
    steep = largest_within(cells.steepness, cells, theta, half[1])
    most = np.abs(gains) + moved
    slopes, bends = steep[:3], steep[3:]
    value = free + gains[0] * forces[0] + gains[1] * forces[1]
    by_t = change[0] * forces[0] + change[1] * forces[1]
    by_theta = free_theta + gains[0] * forces_theta[0] + gains[1] * forces_theta[1]
    bend = 0.5 * half[1] ** 2 * (bends[0] + most[0] * bends[1] + most[1] * bends[2])
    turned_by = half[1] * (moved[0] * slopes[1] + moved[1] * slopes[2])
    terms = np.abs(free) + most[0] * np.abs(forces[0]) + most[1] * np.abs(forces[1])
    rounding = _SUMS * terms
    for weight, k in ((1.0, 0), (most[0], 1), (most[1], 2)):
        rounding = rounding + weight * (lost[k] + half[1] * lost[3 + k])
    moves = np.stack([by_t, by_theta]) * half
    by_axis = np.stack([np.zeros_like(bend), 2.0 * bend]) + np.abs(moves)
    return Models(value, moves, bend + turned_by + rounding, by_axis, rounding)
