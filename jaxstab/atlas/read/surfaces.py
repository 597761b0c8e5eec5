"""Spectral radii from a few functions of a cell, with proved bounds (lemma B19). NumPy alone."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ONE, LARGER, PAIR, CLUSTER = 1, 2, 3, 4
"""What a radius is made of: ``schema.RADIUS_KIND``."""

_ROUNDING = 1e-13  # more than is lost below, of numbers around 1
_ROUNDING_OF_ROOTS = 1e-14


def radius_bounds(kind: NDArray[Any], values: Floats, errors: Floats) -> tuple[Floats, Floats]:
    """Return the lowest and the highest radius of points.

    Args:
        kind: of the cell of each point.
        values: of the functions of the cell, (3, point).
        errors: of the first two functions, (2, point).
    """
    low, high = np.zeros(kind.size), np.full(kind.size, np.inf)
    below, above = values[:2] - errors, values[:2] + errors
    is_larger = kind == LARGER
    for number, known in ((0, (kind == ONE) | is_larger), (1, is_larger)):
        low = np.where(known, np.fmax(low, below[number]), low)
        high = np.where(known, above[number] if number == 0 else np.fmax(high, above[1]), high)
    for of_kind, bounds in ((PAIR, _of_pairs), (CLUSTER, _of_clusters)):
        some = np.flatnonzero(kind == of_kind)
        if some.size:
            of_some = [of_function[some] for of_function in values]
            found = bounds(of_some, errors[0, some])
            low[some], high[some] = found[0] - errors[1, some], found[1] + errors[1, some]
    return np.maximum(low - _ROUNDING, 0.0), high + _ROUNDING


def _of_pairs(functions: list[Floats], bound: Floats) -> tuple[Floats, Floats]:
    """Bound the larger |mean + w| of two w with |w^2 + constant| <= bound."""
    mean, constant, _ = functions
    half = np.sqrt(np.abs(constant))
    radius = np.where(constant > 0.0, np.hypot(mean, half), np.abs(mean) + half)
    distance, loss = 2.0 * half, bound + _ROUNDING_OF_ROOTS
    with np.errstate(invalid="ignore"):
        alone = 2.0 * loss / (distance + np.sqrt(distance**2 - 4.0 * loss))
    reach = np.where(distance**2 > 4.0 * loss, alone, 2.5 * np.sqrt(loss))
    return radius - reach, radius + reach


def _of_clusters(functions: list[Floats], bound: Floats) -> tuple[Floats, Floats]:
    """Bound the largest |mean + w| of three w with |w^3 + slope w + constant| <= bound."""
    mean, slope, constant = functions
    roots = _cubic_roots(slope, constant)
    one, two, three = roots
    products = one * two + one * three + two * three, one * two * three
    size = np.abs(roots).max(axis=0) + 5.0 * np.cbrt(bound)
    lost = np.abs(one + two + three) * size**2 + np.abs(products[0] - slope) * size
    loss = bound + lost + np.abs(products[1] + constant) + _ROUNDING_OF_ROOTS
    low, high = np.zeros(mean.size), np.zeros(mean.size)
    for first, second, third in ((one, two, three), (two, one, three), (three, one, two)):
        apart = np.abs(first - second), np.abs(first - third)
        with np.errstate(all="ignore"):
            near = 1.2 * loss / (apart[0] * apart[1])
            left = (apart[0] - near) * (apart[1] - near)
        is_alone = (near < apart[0]) & (near < apart[1]) & (near * left > loss)
        reach = np.where(is_alone, near, 5.0 * np.cbrt(loss))
        radius = np.abs(mean + first)
        low, high = np.maximum(low, radius - reach), np.maximum(high, radius + reach)
    return low, high


def _cubic_roots(slope: Floats, constant: Floats) -> NDArray[np.complex128]:
    """Return the roots of w^3 + slope w + constant, good to about a rounding of the largest."""
    third, half = slope / 3.0, 0.5 * constant
    inside = half**2 + third**3
    sign = np.where(half > 0.0, -1.0, 1.0)
    first = sign * np.cbrt(np.abs(half) + np.sqrt(np.maximum(inside, 0.0)))
    second = -third / np.where(first == 0.0, 1.0, first)
    real = first + second
    pair = -0.5 * real + 0.5j * np.sqrt(3.0) * (first - second)
    radius = np.sqrt(np.maximum(-third, 0.0))
    cosine = -half / np.where(radius == 0.0, 1.0, radius) ** 3
    angle = np.arccos(np.clip(cosine, -1.0, 1.0)) / 3.0
    turned = [2.0 * radius * np.cos(angle - 2.0 * np.pi * k / 3.0) for k in range(3)]
    is_real = inside < 0.0
    alone = (real, pair, pair.conj())
    return np.stack([np.where(is_real, a, b) for a, b in zip(turned, alone, strict=True)])
