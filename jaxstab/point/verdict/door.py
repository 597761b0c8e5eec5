"""Certified verdicts: STABLE and UNSTABLE are proofs, rounding included.

``recursion`` has the proof, ``loop`` forms p(z) from plants that are computed once. This module
takes the points of a grid to the kernels, each at the degree of its own delay.
"""

from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Int8

from jaxstab.arrays import Array, Numbers, is_any_traced, named, namespace
from jaxstab.batches import compiled, lists, over_tiles
from jaxstab.conventions import UNDECIDED, UNSTABLE, Verdict
from jaxstab.model import (
    DoubleDouble,
    by_name,
    characteristic_polynomial,
    checked_delta,
    checked_gain,
    checked_gamma,
    require_x64,
)
from jaxstab.model.filters import Filter, Velocity, given_filters
from jaxstab.model.parameters import whole_and_fraction
from jaxstab.point.grid import looked_up
from jaxstab.point.verdict.linear import filtered_verdict, traced_filtered_verdict
from jaxstab.point.verdict.loop import (
    HIGHEST_UNROLLED,
    float_plant,
    is_plant_lost,
    loop_codes,
    pair_plant,
)
from jaxstab.point.verdict.outer_root import have_outer_root
from jaxstab.point.verdict.points import Form, Points, gathered
from jaxstab.point.verdict.recursion import FLOAT_UNIT, PAIR_UNIT

_MANY = 1 << 15  # points from which on XLA answers for NumPy arrays
_LIST = 1 << 16  # points of one list that is gathered from a grid
_PAIRS = 1 << 12  # the same in double-double


def verdict(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    resolve: str | None = None,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Int8[Array, "*grid"]:
    """Prove for every point whether all roots of p(z) lie inside the unit circle.

    STABLE and UNSTABLE are proofs: the rounding of plant, coefficients and recursion is bounded.
    Points too close to the boundary are UNDECIDED, and so are points exactly on it, such as
    alpha = -gamma. UNSTABLE means at least one root outside or on the circle.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional, concrete.
        resolve: "exact" repeats the recursion in double-double where float64 leaves a point
            UNDECIDED, and then looks for a root that is certainly outside; all arguments must be
            concrete, as for an array of delays.
        velocity: the velocity estimator in units of one sample; None for the difference over one
            sample, the wall of the paper.
        position: the position filter in units of one sample; None for none. With an estimator or a
            filter double-double is tried wherever float64 leaves a point UNDECIDED.

    Returns:
        int8 array of the broadcast shape: Verdict.STABLE, UNSTABLE or UNDECIDED; in JAX if an
        argument is. The int8 of one point prints its name. Plants are computed once for
        each (gamma, delta, delay): give grids as arrays that broadcast. NumPy grids of 32,768
        points and more go through XLA.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN, or resolve is unknown.
        TypeError: the delay is traced, or an array of delays or ``resolve`` meets traced arguments.
        RuntimeError: JAX arrays are given without x64.

    Source: Schur-Cohn criterion (Jury 1964) for eq. (9) of Hulin, Preusche, Hirzinger (2008).

    Example:
        >>> jaxstab.verdict([0.1, 1.5], 0.2, gamma=0.0, delta=0.015, delay=1.0)
        array([1, 2], dtype=int8)
        >>> window = jaxstab.Velocity.difference(samples=20)
        >>> jaxstab.verdict(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0, velocity=window)
        <Verdict.UNSTABLE: 2>
    """
    if resolve not in (None, "exact"):
        raise ValueError(f'resolve is {resolve!r}; give "exact" or None.')
    require_x64(alpha, beta, gamma, delta, delay)
    filters = given_filters(velocity, position)
    gains = checked_gain("alpha", alpha), checked_gain("beta", beta)
    point = (*gains, checked_gamma(gamma), checked_delta(delta))
    xp = namespace(point, delay)
    whole, fraction = whole_and_fraction(delay)
    if filters and whole.size == 1 and is_any_traced(point, delay, filters):
        return traced_filtered_verdict(point, Form.of(delay), fraction, filters)
    if not filters and resolve is None and whole.size == 1:
        arrays = [xp.asarray(value, xp.float64) for value in point]
        codes = _float_verdict(arrays, xp.asarray(fraction), Form.of(delay))
        shape = np.broadcast_shapes(whole.shape, *(array.shape for array in arrays))
        return named(xp.array(xp.broadcast_to(codes, shape)), Verdict)
    if is_any_traced(point, delay, filters):
        raise TypeError("verdict takes traced arguments with one delay and without resolve only.")
    points = Points(*(np.asarray(value, np.float64) for value in (*point, delay)))
    if filters:
        return named(xp.asarray(filtered_verdict(points, filters)), Verdict)
    codes = _grouped_verdict(points)
    return named(xp.asarray(codes if resolve is None else _resolved(codes, points)), Verdict)


def is_stable(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Bool[Array, "*grid"]:
    """Return True where all poles are proved to lie inside the unit circle.

    False where the loop is unstable, marginal, or closer to the boundary than can be decided. Of
    these ``verdict`` tells those that are proved unstable from all others, which are UNDECIDED.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, concrete.
        velocity: the velocity estimator in units of one sample; None for the difference over one.
        position: the position filter in units of one sample; None for none.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        TypeError: the delay is traced.
        RuntimeError: JAX arrays are given without x64.

    Source: sec. V of the paper.

    Example:
        >>> jaxstab.is_stable([0.1, 1.5], 0.2, gamma=0.0, delta=0.015, delay=1.0).tolist()
        [True, False]
    """
    point = alpha, beta, gamma, delta, delay
    return verdict(**by_name(*point), velocity=velocity, position=position) == Verdict.STABLE


def _float_verdict(point: list[Array], fraction: Array, form: Form) -> Array:
    alpha, beta, gamma, delta = point
    plant = float_plant(gamma, delta, fraction, is_fractional=form.is_fractional)
    return _float_codes((alpha, beta, gamma, plant), form.degree)


def _float_codes(arguments: tuple[Any, ...], degree: int) -> Array:
    """Return the codes of points; XLA compiles once for all long delays."""
    if degree <= HIGHEST_UNROLLED:
        return _short_codes(arguments, degree=degree)
    return _long_codes(arguments, degree)


@compiled(static=["degree"], many=_MANY, wide=True, pointwise=True)
def _short_codes(arguments: tuple[Any, ...], *, degree: int) -> Array:
    codes = partial(loop_codes, unit=FLOAT_UNIT, degree=degree)
    return codes(*arguments) if degree <= 4 else over_tiles(codes, arguments)


@compiled(many=_MANY, wide=True, pointwise=True)
def _long_codes(arguments: tuple[Any, ...], degree: int | Array) -> Array:
    return over_tiles(partial(loop_codes, unit=FLOAT_UNIT, degree=degree), arguments)


def _grouped_verdict(points: Points) -> Int8[np.ndarray, "*grid"]:
    """Run every delay at the degree of its own."""
    codes = np.zeros(points.shape, np.int8)
    for form, indices in points.groups(np.full(points.shape, True)):
        # Plants on the smallest grid that holds them, then gathered like the points.
        plants = float_plant(
            points.gamma, points.delta, points.delay % 1.0, is_fractional=form.is_fractional
        )
        for part, padded in lists(indices, _LIST, fewest=_MANY):
            values = gathered((*points[:3], plants), points.shape, padded)
            codes.flat[part] = _float_codes(values, form.degree)[: part.size]
    return codes


def _resolved(codes: Int8[np.ndarray, "*grid"], points: Points) -> Int8[np.ndarray, "*grid"]:
    """Repeat UNDECIDED points in double-double; of what is left, look for a root outside."""
    for form, indices in points.groups(np.asarray(codes == UNDECIDED)):
        for start in range(0, indices.size, _PAIRS):
            part = indices[start : start + _PAIRS]
            codes.flat[part] = _pair_codes(gathered(points, points.shape, part), form)
    for _, indices in points.groups(np.asarray(codes == UNDECIDED)):
        values = looked_up(list(points), points.shape, indices)
        proved = have_outer_root(characteristic_polynomial(**by_name(*values)))
        proved &= ~is_plant_lost(*values[2:4])
        codes.flat[indices[proved]] = UNSTABLE
    return codes


def _pair_codes(points: Points, form: Form) -> Int8[np.ndarray, " point"]:
    alpha, beta, gamma, delta, delay = points
    plant = pair_plant(gamma, delta, delay % 1.0, is_fractional=form.is_fractional)
    gains = DoubleDouble.of(alpha), DoubleDouble.of(beta)
    with np.errstate(all="ignore"):
        return loop_codes(*gains, gamma, plant, unit=PAIR_UNIT, degree=form.degree)
