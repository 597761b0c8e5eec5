"""Broadcast grids of points in chunks of one shape, each point at the degree of p for its delay.

The grid itself is never formed: a chunk is a list of flat indices, looked up in the arguments as
they were given. A grid of five axes needs memory for its axes, one chunk and its results;
``evaluate_grid`` does without the results.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Int64

from jaxstab.arrays import Array, Numbers, is_any_traced, namespace, tree_map
from jaxstab.batches import MANY, lists
from jaxstab.model import by_name, characteristic_polynomial, checked_delay, require_x64
from jaxstab.model.filters import Filter, Velocity
from jaxstab.numbers import checked_count

CHUNK = 2**15

Result = TypeVar("Result")


def evaluate_grid(
    function: Callable[..., Result],
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    chunk: int = CHUNK,
) -> Iterator[tuple[slice, Result]]:
    """Evaluate a function on a grid that is larger than memory, chunk by chunk.

    Args:
        function: called with five arrays of at most ``chunk`` points, by their names:
            spectral_radius, verdict ...
        alpha, beta, gamma, delta, delay: see ``jaxstab.conventions``.
        chunk: points per call.

    Returns:
        An iterator over the range of flat indices (C order) of each part of the broadcast grid, and
        the function's answer for it.

    Raises:
        ValueError: ``chunk`` is below 1, or the shapes do not broadcast; else as the function.
        RuntimeError: JAX arrays are given without x64.

    Source: Table I for the parameters.

    Example:
        >>> alpha = np.linspace(0.0, 0.2, 1000)
        >>> parts = jaxstab.evaluate_grid(
        ...     jaxstab.verdict, alpha, 0.2, gamma=0.0, delta=0.015, delay=1.0, chunk=400
        ... )
        >>> sum(int((codes == jaxstab.Verdict.STABLE).sum()) for _, codes in parts)
        558
    """
    require_x64(alpha, beta, gamma, delta, delay)
    checked_count("chunk", chunk, 1)
    arguments = [np.asarray(value, np.float64) for value in (alpha, beta, gamma, delta, delay)]
    shape = np.broadcast_shapes(*(argument.shape for argument in arguments))
    total = math.prod(shape)
    ranges = (slice(start, min(start + chunk, total)) for start in range(0, total, chunk))
    return (
        (
            points,
            function(**by_name(*looked_up(arguments, shape, np.arange(points.start, points.stop)))),
        )
        for points in ranges
    )


def over_grid(
    kernel: Callable[[Array], Result],
    *parameters: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Result:
    """Apply a kernel of coefficients (point, degree + 1) to every point of a grid.

    The results have the point as their first axis; if further axes are longer for a higher degree,
    shorter results are padded with zeros. Traced parameters form one padded batch.
    """
    require_x64(*parameters)
    polynomial = partial(characteristic_polynomial, velocity=velocity, position=position)
    if is_any_traced(parameters, velocity, position):
        return kernel(polynomial(**by_name(*parameters)))
    delay = checked_delay(parameters[-1])
    arguments = [np.asarray(value, np.float64) for value in parameters]
    shape = np.broadcast_shapes(*(argument.shape for argument in arguments))
    degrees = np.broadcast_to(np.ceil(delay), shape)
    members = [np.flatnonzero(degrees == degree) for degree in np.unique(degrees)]
    parts, results = [], []
    for part, padded in (pair for some in members for pair in lists(some, CHUNK, fewest=MANY)):
        listed = looked_up(arguments, shape, padded)
        whole = kernel(polynomial(**by_name(*listed)))
        parts.append(part)
        results.append(tree_map(lambda array, count=part.size: array[:count], whole))
    xp = namespace(parameters)
    return tree_map(lambda *arrays: xp.asarray(_scattered(parts, arrays, shape)), *results)


def looked_up(
    arguments: Sequence[Any], shape: tuple[int, ...], points: Int64[np.ndarray, " point"]
) -> list[Any]:
    """Return arrays, or trees of them, at flat indices of the grid to which they broadcast.

    Single numbers stay single, so that they are used once; only the first argument is repeated.
    """
    index = np.unravel_index(points, shape or (1,))

    def repeated(values: Any) -> Any:
        return np.broadcast_to(values, shape or (1,))[index]

    def kept(values: Any) -> Any:
        return values.reshape(()) if values.size == 1 else repeated(values)

    return [repeated(arguments[0]), *tree_map(kept, list(arguments[1:]))]


def _scattered(
    points: list[Int64[np.ndarray, "_"]],
    parts: tuple[Any, ...],
    shape: tuple[int, ...],
) -> np.ndarray:
    longest = max((part.shape[1:] for part in parts), default=())
    result = np.zeros((math.prod(shape), *longest), parts[0].dtype)
    for index, part in zip(points, parts, strict=True):
        missing = [(0, full - length) for full, length in zip(longest, part.shape[1:], strict=True)]
        result[index] = np.pad(part, [(0, 0), *missing])
    return result.reshape((*shape, *longest))
