"""The spectral radius of the closed loop, with a proved bound of its error."""

from collections.abc import Callable
from decimal import ROUND_CEILING
from functools import partial
from math import prod
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import (
    Array,
    Numbers,
    are_numbers,
    constant,
    is_any_traced,
    named,
    namespace,
    tree_map,
)
from jaxstab.batches import compiled
from jaxstab.conventions import RadiusStatus
from jaxstab.model import (
    characteristic_polynomial,
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    polynomial_degree,
    require_x64,
)
from jaxstab.model.filters import Filter, Filters, Velocity, given_filters
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.model.polynomial import loop_polynomial
from jaxstab.numbers import checked_word
from jaxstab.point.grid import looked_up, over_grid
from jaxstab.point.poles import companion_poles
from jaxstab.point.radius.bound import radius_error
from jaxstab.point.radius.dense import filtered_radius, linear_radius, traced_radius_error
from jaxstab.point.radius.dominance import distance_of_dominant, modulus
from jaxstab.point.radius.dominant_root import Complex, Loop, newton
from jaxstab.point.radius.fast_radius import LONGEST_DELAY, TOLERANCE, fast_radius
from jaxstab.point.verdict.loop import float_plant, is_plant_lost
from jaxstab.point.verdict.points import Points
from jaxstab.shown import number_text, text_with_bound

_MANY = 1 << 14  # points of one delay from which on XLA looks for dominant roots
_LIST = 1 << 12  # points whose companion matrices are made at once
_NEWTON_STEPS = 3
# Strongly damped plants have coefficients of N far below its size, which do not have all their
# digits; what is lost beside 1, divided by powers of a small radius, is more than a rounding.
_DAMPED, _SMALL_RADIUS = 10.0, 0.5

_KNOWN = {
    RadiusStatus.NOT_COMPUTED: "not computed",
    RadiusStatus.PROVED: "proved",
    RadiusStatus.NO_BOUND: "no bound proved",
}

Values = np.ndarray[Any, np.dtype[Any]]


class SpectralRadius(NamedTuple):
    """The largest modulus of a root of p(z), a bound of its error, and how the bound is known.

    Attributes:
        value: the largest modulus, per sample.
        error: all roots are inside value + error, and not all of them inside value - error.
        status: a RadiusStatus.

    Example:
        >>> jaxstab.spectral_radius(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)
        0.98712203316983... +/- ... (proved)
    """

    value: Float64[Array, "*grid"]
    error: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]

    def __repr__(self) -> str:
        """Return the radius with its bound, or a summary of many."""
        if not are_numbers(self):
            return f"SpectralRadius{tuple(self)}"
        values, errors, codes = map(np.ravel, self)
        if np.ndim(self.value) == 0:
            shown = text_with_bound(float(values[0]), float(errors[0]))
            return f"{shown} ({_KNOWN[RadiusStatus(int(codes[0]))]})"
        if not len(values):
            return "SpectralRadius of no loop"
        bound = number_text(float(errors.max()), 2, ROUND_CEILING)
        counts = ", ".join(
            f"{count} {words}" for code, words in _KNOWN.items() if (count := np.sum(codes == code))
        )
        ends = f"{values.min():.6g} to {values.max():.6g}"
        return f"SpectralRadius of {len(values)} loops: {ends}, bound {bound} at most ({counts})"


def spectral_radius(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    method: str = "fast",
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> SpectralRadius:
    """Return the largest modulus of a closed-loop pole with a proved error bound.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, concrete.
        method: "fast" finds and proves the dominant root, without eigenvalues for many points of
            one delay up to 64, by XLA; "companion" takes the companion matrix and a ladder of
            verdicts for all. Inside jit, vmap and grad, and with filters, it is always the
            companion matrix.
        velocity: the velocity estimator in units of one sample; None for the difference over one.
        position: the position filter in units of one sample; None for none.

    Returns:
        SpectralRadius of arrays of the broadcast shape, in JAX if an argument is: ``value``;
        ``error``, proved: all roots are inside value + error, not all inside value - error;
        ``status``, a RadiusStatus: NO_BOUND also next to gamma = (2 pi k)^2 with next to no
        damping, where N(z) nearly vanishes, and for radii below 0.5 at delta above 10, where not
        all digits of N(z) are known. The derivative of ``value`` is that of the dominant root by
        the implicit function theorem; it is infinite or NaN where that root is multiple.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN, or the method is
            unknown.
        TypeError: the delay is traced.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9); sec. V of the paper for its use.

    Example:
        >>> radius = jaxstab.spectral_radius(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)
        >>> round(float(radius.value), 9)
        0.987122033
    """
    checked_word("method", method, ("fast", "companion"))
    arguments = alpha, beta, gamma, delta, delay
    require_x64(*arguments)
    filters = given_filters(velocity, position)
    if is_any_traced(arguments, filters):
        return _traced_radius(*arguments, filters=filters)
    checked_arguments = (
        checked_gain("alpha", alpha),
        checked_gain("beta", beta),
        checked_gamma(gamma),
        checked_delta(delta),
        checked_delay(delay),
    )
    points = [np.asarray(value, np.float64) for value in checked_arguments]
    if filters:
        value, error = filtered_radius(Points(*points), filters)
    else:
        value, error = _concrete_radius(points, is_fast=method == "fast")
    found, xp = _believed(value, error, points[2], points[3]), namespace(arguments)
    return found if xp is np else tree_map(xp.asarray, found)


def linear_spectral_radius(alpha: Array, beta: Array, loop: LinearLoop) -> SpectralRadius:
    """Return the spectral radii of walls of one loop, with any device, estimator and filter.

    Args:
        alpha: float64, any shape; it broadcasts with beta and with the loop.
        beta: likewise.
        loop: what base + alpha stiffness + beta damping is; walls and loops may be traced.
    """
    if is_any_traced(alpha, beta, loop):
        both = _traced_radius_of(loop_polynomial(alpha, beta, loop), traced_radius_error)
    else:
        xp = namespace(alpha, beta, loop)
        walls = tree_map(np.asarray, (alpha, beta, loop))
        both = tree_map(xp.asarray, linear_radius(*walls))
    return _with_status(*both)


def _concrete_radius(points: list[Values], *, is_fast: bool) -> tuple[Values, Values]:
    *parameters, delay = points
    shape = np.broadcast_shapes(*(values.shape for values in points))
    if delay.size == 1:
        return _of_delay(parameters, shape, delay.item(), is_fast=is_fast)
    value, error = np.zeros(shape), np.full(shape, np.inf)
    for one in np.unique(delay).tolist():
        indices = np.flatnonzero(np.broadcast_to(delay == one, shape))
        listed = looked_up(parameters, shape, indices)
        found = _of_delay(listed, indices.shape, one, is_fast=is_fast)
        value.flat[indices], error.flat[indices] = found
    return value, error


def _of_delay(
    parameters: list[Values], shape: tuple[int, ...], delay: float, *, is_fast: bool
) -> tuple[Values, Values]:
    if is_fast and delay <= LONGEST_DELAY and prod(shape) >= _MANY:
        value, error = fast_radius(parameters, shape, delay)
    else:
        value, error = np.zeros(shape), np.full(shape, np.inf)
    still_open = np.flatnonzero(~(error <= TOLERANCE))
    for start in range(0, still_open.size, _LIST):
        part = still_open[start : start + _LIST]
        best = _few(looked_up(parameters, shape, part), delay, is_fast=is_fast)
        closer = ~(best[1] >= error.flat[part])
        value.flat[part[closer]], error.flat[part[closer]] = (column[closer] for column in best)
    return value, error


def _few(parameters: list[Values], delay: float, *, is_fast: bool) -> tuple[Values, Values]:
    """Return value and error for a list of points: eigenvalues, proved in one of two ways."""
    alpha, beta, gamma, delta = parameters
    coefficients = characteristic_polynomial(alpha, beta, gamma=gamma, delta=delta, delay=delay)
    poles = companion_poles(coefficients)
    value, error = np.abs(poles[:, 0]), np.full(len(poles), np.inf)
    if is_fast:
        value, error = _polished(parameters, delay, poles[:, 0])
    is_open = np.flatnonzero(~(error <= TOLERANCE))
    if is_open.size:
        rough = np.abs(poles[is_open, 0])
        bound = radius_error(coefficients[is_open], rough)
        closer = ~(bound >= error[is_open])
        value[is_open[closer]], error[is_open[closer]] = rough[closer], bound[closer]
    return value, error


def _polished(parameters: list[Values], delay: float, root: Values) -> tuple[Values, Values]:
    alpha, beta, gamma, delta = parameters
    degree, fraction = polynomial_degree(delay), delay % 1.0
    plant = float_plant(gamma, delta, np.float64(fraction), is_fractional=fraction > 0.0)
    loop = Loop(alpha, beta, gamma, plant)
    t = Complex(root.real - 1.0, np.abs(root.imag))
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON_STEPS):
            t = newton(t, loop, degree)
        closer = t.re + 1j * t.im
    return modulus(closer), distance_of_dominant(closer, loop, degree=degree)


def _traced_radius(*arguments: Numbers, filters: Filters | None) -> SpectralRadius:
    velocity, position = filters or (None, None)
    bound = traced_radius_error if filters else radius_error

    radius = partial(_traced_radius_of, bound=bound)
    both = over_grid(radius, *arguments, velocity=velocity, position=position)
    return _believed(*both, *arguments[2:4])


def _traced_radius_of(
    coefficients: Array, bound: Callable[[Array, Array], Array]
) -> tuple[Array, Array]:
    from jaxstab.point.radius.derivative import largest_modulus

    value = largest_modulus(coefficients)
    return value, bound(*constant((coefficients, value)))


@compiled()
def _believed(value: Array, error: Array, gamma: Array, delta: Array) -> SpectralRadius:
    """Take back the bounds where the plant is not known to an ulp, and say how all are known."""
    xp = namespace(value, error, gamma, delta)
    is_damped, is_lost = delta > _DAMPED, is_plant_lost(gamma, delta)
    if xp is not np or np.any(is_damped) or np.any(is_lost):
        error = xp.where(is_lost | (is_damped & (value < _SMALL_RADIUS)), xp.inf, error)
    return _with_status(value, error)


def _with_status(value: Array, error: Array) -> SpectralRadius:
    xp = namespace(value, error)
    known, unknown = np.int8(RadiusStatus.PROVED), np.int8(RadiusStatus.NO_BOUND)
    status = named(xp.where(xp.isfinite(error), known, unknown), RadiusStatus)
    return SpectralRadius(value, error, status)
