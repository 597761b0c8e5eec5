"""Spectral radius and its error over many points by dominant roots, wherever these can be proved.

Each point is computed independently of the others. Where the first try is not proved to
``TOLERANCE``, mostly because two roots have nearly the same modulus, the next one squares the power
of z more often. The few points that are then still open have multiple or nearly equal dominant
roots.
"""

from collections.abc import Iterator
from functools import partial
from math import prod
from typing import Any, NamedTuple

import numpy as np

from jaxstab.arrays import Array
from jaxstab.batches import lists, on_few_sizes
from jaxstab.model import polynomial_degree
from jaxstab.point.grid import looked_up
from jaxstab.point.radius.dominance import distance_of_dominant, modulus
from jaxstab.point.radius.dominant_root import Loop, dominant_root
from jaxstab.point.verdict.loop import float_plant

LONGEST_DELAY = 64.0  # beyond, polynomials of many points do not stay in the cache
TOLERANCE = 1e-12

_LIST = 2**18  # up to this many points, lists are filled up to a length compiled once for all
_SHORTEST_LIST = 8
_BLOCK = 2**21  # points of a larger grid that are computed at once

Values = np.ndarray[Any, np.dtype[Any]]
Answer = tuple[Values, Values]  # value and error


class _Try(NamedTuple):
    """What is spent on a point: squarings of a power of z, 0 for a closed form; Newton steps."""

    doublings: int
    corrections: int
    longest_list: int


def fast_radius(parameters: list[Values], shape: tuple[int, ...], delay: float) -> Answer:
    """Return value and error of the spectral radius, by XLA; the error is inf if nothing is proved.

    Args:
        parameters: alpha, beta, gamma, delta, checked, of shapes that broadcast to ``shape``.
        shape: of the grid.
        delay: in samples, at most LONGEST_DELAY.
    """
    value, error = np.empty(shape), np.empty(shape)
    first, *others = _tries(delay)
    if value.size > _LIST:
        for part, block in _blocks(parameters, shape):
            value[part], error[part] = _tried(_loop(block, delay), delay, first)
    else:
        _try_list(value, error, parameters, np.arange(value.size), delay, first)
    for effort in others:
        still_open = np.flatnonzero(~(error <= TOLERANCE))
        _try_list(value, error, parameters, still_open, delay, effort)
    return value, error


def _try_list(
    value: Values,
    error: Values,
    parameters: list[Values],
    indices: Values,
    delay: float,
    effort: _Try,
) -> None:
    """Write the results at flat indices."""
    plants = prod(np.broadcast_shapes(*(hand.shape for hand in parameters[2:])))
    shared = _loop(parameters, delay) if plants <= indices.size else None
    for part, padded in lists(indices, effort.longest_list, _SHORTEST_LIST):
        if shared:
            loop = Loop(*looked_up(shared, value.shape, padded))
        else:
            loop = _loop(looked_up(parameters, value.shape, padded), delay)
        for result, column in zip((value, error), _tried(loop, delay, effort), strict=True):
            result.flat[part] = column[: part.size]


def _loop(parameters: list[Values], delay: float) -> Loop:
    """Return loops with their plants, which are computed on the smallest grid that holds them."""
    alpha, beta, gamma, delta = parameters
    fraction = delay % 1.0
    plant = float_plant(gamma, delta, np.float64(fraction), is_fractional=fraction > 0.0)
    return Loop(alpha, beta, gamma, plant)


def _tried(loop: Loop, delay: float, effort: _Try) -> Answer:
    return on_few_sizes(partial(_radius, degree=polynomial_degree(delay), effort=effort), loop)


def _radius(loop: Loop, *, degree: int, effort: _Try) -> tuple[Array, Array]:
    root = dominant_root(
        loop, degree=degree, doublings=effort.doublings, corrections=effort.corrections
    )
    return modulus(root), distance_of_dominant(root, loop, degree=degree)


def _tries(delay: float) -> tuple[_Try, ...]:
    if delay == 0.0:
        return _Try(0, 1, 2**15), _Try(16, 8, 2**15)
    if delay <= 1.0:
        return _Try(8, 2, 2**15), _Try(16, 8, 2**15)
    if delay <= 5.0:
        return _Try(6, 2, 2**15), _Try(16, 8, 2**15)
    if delay <= 10.0:
        return _Try(6, 2, 2**15), _Try(10, 4, 2**12), _Try(14, 8, 2**10)
    if delay <= 21.0:
        return _Try(4, 4, 2**15), _Try(14, 8, 2**10)
    return _Try(5 if delay <= 50.0 else 7, 4, 2**12), _Try(14, 8, 2**10)


def _blocks(
    parameters: list[Values], shape: tuple[int, ...]
) -> Iterator[tuple[tuple[slice, ...], list[Values]]]:
    """Cut a grid across its longest axis; yield the index of each part and its parameters."""
    aligned = [
        values.reshape((1,) * (len(shape) - values.ndim) + values.shape) for values in parameters
    ]
    axis = int(np.argmax(shape))
    rows = max(1, _BLOCK * shape[axis] // prod(shape))
    for start in range(0, shape[axis], rows):
        part = (slice(None),) * axis + (slice(start, start + rows),)
        yield part, [values[part] if values.shape[axis] > 1 else values for values in aligned]
