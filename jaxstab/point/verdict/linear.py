"""Certified verdicts of any linear loop: of any device, velocity estimator and position filter."""

from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Int8

from jaxstab.arrays import Array, is_any_traced, namespace, tree_map
from jaxstab.batches import compiled, over_tiles
from jaxstab.conventions import UNDECIDED
from jaxstab.model import DoubleDouble
from jaxstab.model.filters import Filters
from jaxstab.model.linear_loop import LinearLoop, filtered_loop
from jaxstab.point.verdict.dense import dense_codes, rounded_loop, without_zeros
from jaxstab.point.verdict.points import Form, Points, gathered
from jaxstab.point.verdict.recursion import FLOAT_UNIT, PAIR_UNIT

_MANY = 1 << 13  # points from which on XLA answers for NumPy arrays
_TILE = 512  # points whose polynomials stay in the cache
_PAIRS = 1 << 11  # points at once in double-double


def linear_verdict(alpha: Array, beta: Array, loop: LinearLoop) -> Int8[Array, "*grid"]:
    """Return the codes of walls of one loop: float64 before pairs.

    Args:
        alpha: float64, any shape; it broadcasts with beta and with the loop.
        beta: likewise.
        loop: what base + alpha stiffness + beta damping is. Traced walls and loops are answered in
            float64 alone.
    """
    degree, loop = loop.degree, without_zeros(loop)
    if is_any_traced(alpha, beta, loop):
        return _float_codes(alpha, beta, rounded_loop(loop), degree=degree)
    xp = namespace(alpha, beta, loop)
    if xp is not np:
        alpha, beta, loop = tree_map(np.asarray, (alpha, beta, loop))
    codes = np.array(_float_codes(alpha, beta, rounded_loop(loop), degree=degree))
    still_open = np.flatnonzero(codes == UNDECIDED)
    for start in range(0, still_open.size, _PAIRS):
        part = still_open[start : start + _PAIRS]
        chosen = gathered((alpha, beta, loop), codes.shape, part)
        codes.flat[part] = _pair_codes(*chosen, degree=degree)
    return xp.asarray(codes)


def traced_filtered_verdict(
    point: tuple[Array, Array, Array, Array], form: Form, fraction: Array, filters: Filters
) -> Int8[Array, "*grid"]:
    """Return the codes of points that a transformation of JAX traces, in float64 alone."""
    alpha, beta, gamma, delta = point
    part = fraction if form.is_fractional else 0.0
    loop = filtered_loop(gamma, delta, form.whole_delay, part, filters)
    return _float_codes(alpha, beta, rounded_loop(without_zeros(loop)), degree=loop.degree)


def filtered_verdict(points: Points, filters: Filters) -> Int8[np.ndarray, "*grid"]:
    """Return the codes of points of one mass, each delay at the degree of its own."""
    codes = np.zeros(points.shape, np.int8)
    for form, indices in points.groups(np.full(points.shape, True)):
        walls = points.alpha, points.beta, filtered_loops(points, form, filters)
        if indices.size == codes.size:  # a grid of one delay is not taken apart
            codes[...] = linear_verdict(*walls)
        else:
            codes.flat[indices] = linear_verdict(*gathered(walls, points.shape, indices))
    return codes


def filtered_loops(points: Points, form: Form, filters: Filters) -> LinearLoop:
    """Return loops on the smallest grid that holds them."""
    fraction: Any = points.delay % 1.0 if form.is_fractional else 0.0
    if form.is_fractional:  # of delays of the other form some number that is nowhere read
        fraction = np.where(fraction == 0.0, 0.5, fraction)
    return filtered_loop(points.gamma, points.delta, form.whole_delay, fraction, filters)


@compiled(static=["degree"], many=_MANY, wide=True)
def _float_codes(alpha: Array, beta: Array, loop: LinearLoop, *, degree: int) -> Array:
    loop = tree_map(namespace(alpha, beta, loop).asarray, loop)
    codes = partial(dense_codes, unit=FLOAT_UNIT, degree=degree)
    return over_tiles(codes, (alpha, beta, loop), _TILE)


def _pair_codes(
    alpha: Array, beta: Array, loop: LinearLoop, *, degree: int
) -> Int8[np.ndarray, " point"]:
    gains = DoubleDouble.of(alpha), DoubleDouble.of(beta)
    with np.errstate(all="ignore"):
        return dense_codes(*gains, loop, unit=PAIR_UNIT, degree=degree)
