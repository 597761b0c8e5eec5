"""Certified verdicts of loops with a velocity estimator and a position filter."""

from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Int8

from jaxstab.arrays import Array, namespace, tree_map
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


def traced_filtered_verdict(
    point: tuple[Array, Array, Array, Array], delay: float, filters: Filters
) -> Int8[Array, "*grid"]:
    """Return the codes of points that a transformation of JAX traces, in float64 alone."""
    alpha, beta, gamma, delta = point
    loop = filtered_loop(gamma, delta, int(delay), delay % 1.0, filters)
    return _float_codes(alpha, beta, rounded_loop(loop), degree=loop.degree)


def filtered_verdict(points: Points, filters: Filters) -> Int8[np.ndarray, "*grid"]:
    """Return the codes of points, each delay at the degree of its own, float64 before pairs."""
    codes = np.zeros(points.shape, np.int8)
    for form, indices in points.groups(np.full(points.shape, True)):
        loop = filtered_loops(points, form, filters)
        degree, loop = loop.degree, without_zeros(loop)
        rounded = (points.alpha, points.beta, rounded_loop(loop))
        if indices.size == codes.size:  # a grid of one delay is not taken apart
            codes[...] = _float_codes(*rounded, degree=degree)
        else:
            chosen = gathered(rounded, points.shape, indices)
            codes.flat[indices] = _float_codes(*chosen, degree=degree)
        still_open = indices[codes.flat[indices] == UNDECIDED]
        for start in range(0, still_open.size, _PAIRS):
            part = still_open[start : start + _PAIRS]
            chosen = gathered((points.alpha, points.beta, loop), points.shape, part)
            codes.flat[part] = _pair_codes(*chosen, degree=degree)
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
