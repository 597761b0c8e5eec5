"""Spectral radius and its error over any points by dominant roots, wherever these can be proved.

Each point is computed on its own, whatever the others are. Where the first try is not proved to
``TOLERANCE``, mostly because two roots have nearly one modulus, the next one squares the power
of z more often. The few points that are still open have multiple dominant roots or several alike.
"""

from collections.abc import Iterator
from math import prod
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxstab.model import polynomial_degree
from jaxstab.point.grid import looked_up
from jaxstab.point.radius.dominant_root import Loop, distance_of_dominant, dominant_root, modulus
from jaxstab.point.verdict.loop import float_plant

LONGEST_DELAY = 64.0  # beyond, polynomials of many points do not stay in the cache
TOLERANCE = 1e-12

_LIST = 2**18  # up to this many points, lists are filled up to a length compiled once for all
_GROWTH = 8  # a list's length is a try's longest / 8^k: a few points do not pay for all
_SHORTEST_LIST = 8  # one number, or one for all points, is rounded otherwise than numbers in a list
_BLOCK = 2**21  # points of a larger grid that are computed at once

Values = np.ndarray[Any, np.dtype[Any]]
Answer = tuple[Values, Values]  # value and error


class _Try(NamedTuple):
    """What is spent on a point: squarings of a power of z, 0 for a closed form; Newton steps."""

    doublings: int
    corrections: int
    longest_list: int


def fast_radius(parameters: list[Values], delay: Values) -> Answer:
    """Return value and error of the spectral radius; the error is inf where nothing is proved.

    Args:
        parameters: alpha, beta, gamma, delta, checked, of shapes that broadcast.
        delay: in samples, checked; beyond LONGEST_DELAY nothing is proved.
    """
    shape = np.broadcast_shapes(delay.shape, *(values.shape for values in parameters))
    if delay.size == 1:
        return _of_delay(parameters, shape, delay.item())
    value, error = np.zeros(shape), np.full(shape, np.inf)
    for one in np.unique(delay).tolist():
        places = np.flatnonzero(np.broadcast_to(delay == one, shape))
        chosen = looked_up(parameters, shape, places)
        value.flat[places], error.flat[places] = _of_delay(chosen, places.shape, one)
    return value, error


def _of_delay(parameters: list[Values], shape: tuple[int, ...], delay: float) -> Answer:
    if delay > LONGEST_DELAY:
        return np.zeros(shape), np.full(shape, np.inf)
    if prod(shape) == 1:  # as in a list of points, to the last bit
        value, error = _of_delay([np.repeat(values, 2) for values in parameters], (2,), delay)
        return value[:1].reshape(shape), error[:1].reshape(shape)
    value, error = np.empty(shape), np.full(shape, np.inf)
    first, *others = _tries(delay)
    if value.size > _LIST:
        for place, block in _blocks(parameters, shape):
            value[place], error[place] = _tried(block, delay, first)
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
    places: Values,
    delay: float,
    effort: _Try,
) -> None:
    """Write the results at flat indices."""
    for start in range(0, places.size, effort.longest_list):
        length = effort.longest_list
        some = places[start : start + length]
        while length // _GROWTH >= max(some.size, _SHORTEST_LIST):
            length //= _GROWTH
        listed = looked_up(parameters, value.shape, np.resize(some, length))
        for result, column in zip((value, error), _tried(listed, delay, effort), strict=True):
            result.flat[some] = column[: some.size]


def _tried(parameters: list[Values], delay: float, effort: _Try) -> Answer:
    alpha, beta, gamma, delta = map(jnp.asarray, parameters)
    fraction = delay % 1.0
    plant = float_plant(gamma, delta, jnp.asarray(fraction), is_fractional=fraction > 0.0)
    loop = Loop(alpha, beta, gamma, plant)
    degree = polynomial_degree(delay)
    root = dominant_root(
        loop, degree=degree, doublings=effort.doublings, corrections=effort.corrections
    )
    return np.asarray(modulus(root)), np.asarray(distance_of_dominant(root, loop, degree=degree))


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
    """Cut a grid across its longest axis; yield the place of each part and its parameters."""
    aligned = [
        values.reshape((1,) * (len(shape) - values.ndim) + values.shape) for values in parameters
    ]
    axis = int(np.argmax(shape))
    rows = max(1, _BLOCK * shape[axis] // prod(shape))
    for start in range(0, shape[axis], rows):
        place = (slice(None),) * axis + (slice(start, start + rows),)
        yield place, [values[place] if values.shape[axis] > 1 else values for values in aligned]
