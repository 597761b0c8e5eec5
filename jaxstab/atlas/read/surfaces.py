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
    reach = np.where(distance**2 > 4.0 * loss, alone, np.inf)
    farthest = np.sqrt(np.abs(constant) + loss)
    low, high = np.abs(mean) - farthest, np.abs(mean) + farthest
    return np.maximum(radius - reach, low), np.minimum(radius + reach, high)


def _of_clusters(functions: list[Floats], bound: Floats) -> tuple[Floats, Floats]:
    """Bound the largest |mean + w| of three w with |w^3 + slope w + constant| <= bound."""
    mean, slope, constant = functions
    roots = _cubic_roots(slope, constant)
    one, two, three = roots
    products = one * two + one * three + two * three, one * two * three
    size = np.abs(roots).max(axis=0) + 5.0 * np.cbrt(bound)
    lost = np.abs(one + two + three) * size**2 + np.abs(products[0] - slope) * size
    loss = bound + lost + np.abs(products[1] + constant) + _ROUNDING_OF_ROOTS
    farthest = _farthest(np.abs(slope), np.abs(constant) + bound + _ROUNDING_OF_ROOTS)
    lowest, highest = np.abs(mean) - farthest, np.abs(mean) + farthest
    low, high = lowest, np.zeros(mean.size)
    for first, second, third in ((one, two, three), (two, one, three), (three, one, two)):
        near, far = np.sort([np.abs(first - second), np.abs(first - third)], axis=0)
        reach = _component(near, far, loss)
        radius = np.abs(mean + first)
        low, high = np.maximum(low, radius - reach), np.maximum(high, radius + reach)
    return low, np.minimum(high, highest)


def _farthest(slope: Floats, constant: Floats) -> Floats:
    """Bound s with s^3 <= slope s + constant, by Newton's method from above."""
    size = np.maximum(np.sqrt(2.0 * slope), np.cbrt(2.0 * constant))
    for _ in range(3):
        size = (2.0 * size**3 + constant) / (3.0 * size**2 - slope)
    return size * (1.0 + 1e-12)


def _component(near: Floats, far: Floats, loss: Floats) -> Floats:
    """Bound the distance from a root of a cubic within its component of |cubic| <= loss.

    Args:
        near: distance to the nearest of the other two roots.
        far: to the other one.
        loss: more than 0.
    """
    with np.errstate(all="ignore"):
        alone = 1.2 * loss / (near * far)
        is_alone = (alone < near) & (alone * (near - alone) * (far - alone) > loss)
        with_one = 0.5 * near + np.sqrt(0.25 * near**2 + 1.5 * loss / far)
        is_apart = (with_one < far) & (with_one * (with_one - near) * (far - with_one) > loss)
    return np.where(is_alone, alone, np.where(is_apart, with_one, np.inf))


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
