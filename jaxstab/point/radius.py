"""The spectral radius of the closed loop, with a proved bound of its error.

The value comes from the dominant root, found in one of two ways: for many points of one delay by
elementwise operations alone (``dominance``), otherwise as the largest eigenvalue of the companion
matrix, refined by Newton's method. The bound is a proof that uses nothing of how the value was
found:

- lemma V4: no other root is outside of a circle a little smaller than that through the dominant
  root, and lemma R1 bounds the distance of that root from its approximation; or
- lemma R3: all roots are inside the circle of radius value + error, and not all inside that of
  value - error. Both are verdicts on p(r z), tried for a ladder of errors.

Points without a proof within ``TOLERANCE`` keep their value with the smallest error that is proved,
or with an infinite one (NO_BOUND).
"""

import operator
from collections.abc import Sequence
from decimal import ROUND_CEILING
from functools import reduce
from math import prod
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import (
    Array,
    Numbers,
    are_numbers,
    constant,
    is_any_jax,
    is_any_traced,
    leaves,
    named,
    namespace,
    repeat_while,
    take,
    tree_map,
    with_values,
)
from jaxstab.batches import FEW, compiled, pays
from jaxstab.conventions import RadiusStatus, Verdict
from jaxstab.model import (
    DoubleDouble,
    by_name,
    characteristic_polynomial,
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    polynomial_degree,
)
from jaxstab.model.double_double import leading, size
from jaxstab.model.filters import Filter, Filters, Velocity, as_keywords, given_filters
from jaxstab.model.linear_loop import LinearLoop, loop_polynomial
from jaxstab.model.plant import bounded_delay
from jaxstab.numbers import checked_word, require_together
from jaxstab.point.dominance import (
    LONGEST_DELAY,
    TOLERANCE,
    fast_radius,
    loop_of,
    newton,
    with_distance,
)
from jaxstab.point.poles import Complex, companion_poles, looked_up
from jaxstab.point.schur_cohn import (
    UNDERFLOW,
    Ends,
    Number,
    kept_places,
    loop_coefficients,
    polynomial_codes,
)
from jaxstab.point.verdicts import Points, Values, filtered_loops, is_plant_lost
from jaxstab.rounding import PAIR_UNIT, SAFETY, UNIT
from jaxstab.shown import number_text, text_with_bound

# Any linear loops: the dominant eigenvalue of the companion matrix is corrected by Newton's method
# with a residual in double-double, and proved by a ladder of verdicts (lemmas R3 and V7).


def filtered_radius(points: Points, filters: Filters) -> tuple[Values, Values]:
    """Return the spectral radii of points and bounds of their errors, infinite where none holds."""
    value, error = np.zeros(points.shape), np.full(points.shape, np.inf)
    for form, indices in points.groups(np.full(points.shape, True)):
        walls = points.alpha, points.beta, filtered_loops(points, form, filters)
        value.flat[indices], error.flat[indices] = listed_radii(walls, points.shape, indices)
    return value, error


def listed_radii(
    walls: tuple[Values, Values, LinearLoop], shape: tuple[int, ...], indices: Values
) -> tuple[Values, Values]:
    """Return radii and bounds at flat indices of the grid to which walls broadcast, in pairs."""
    matrices = 1 << 11  # points at once
    value, error = np.zeros(indices.size), np.full(indices.size, np.inf)
    for start in range(0, indices.size, matrices):
        part = slice(start, start + matrices)
        alpha, beta, loops = looked_up(walls, shape, indices[part])
        gains = DoubleDouble.from_value(alpha), DoubleDouble.from_value(beta)
        with np.errstate(all="ignore"):
            coefficients, rounding = loop_coefficients(*gains, loops, PAIR_UNIT)
            value[part] = _dominant_modulus(coefficients)
            error[part] = dense_radius_error(coefficients, rounding, value[part], unit=PAIR_UNIT)
    return value, error


def radius_error(
    coefficients: Float64[Array, "*grid coefficient"],
    radius: Float64[Array, "*grid"],
    *,
    is_summed: bool = False,
) -> Float64[Array, "*grid"]:
    """Prove how far spectral radii > 0 can be from the true ones, in float64.

    Bounds from a ladder of ratio 4 are tried, so the result is up to 4 times larger than the
    smallest bound that could be proved, and never smaller than the true error. It is infinite if
    even 2^-6 of the radius cannot be proved.

    ``coefficients`` are of monic polynomials of degree >= 3, highest power first, each within two
    roundings of the true one or, if ``is_summed``, of the sum of the moduli of all.

    Source: Schur-Cohn criterion (Jury 1964) for p(r z).
    """
    xp = namespace(coefficients, radius)
    columns = xp.moveaxis(coefficients, -1, 0)
    # Errors that are relative to each coefficient are counted with those of powers.
    rounding = 2.0 * UNIT * xp.sum(abs(columns), axis=0) if is_summed else xp.zeros_like(radius)
    return dense_radius_error(columns, rounding, radius, unit=UNIT)


def _dominant_modulus(coefficients: DoubleDouble) -> Values:
    dense_newton_steps = 2
    rounded = coefficients.rounded()
    z = companion_poles(np.moveaxis(rounded, 0, -1))[..., 0]
    for _ in range(dense_newton_steps):
        slope = np.polyval(rounded[:-1] * np.arange(len(rounded) - 1, 0, -1)[:, None], z)
        moved = z - _value(coefficients, z) / slope
        z = np.where(np.isfinite(moved), moved, z)
    return np.abs(z)


def _value(coefficients: DoubleDouble, z: Values) -> Values:
    """Return p(z), by division by the real quadratic of z and its conjugate, in pairs."""
    total = DoubleDouble.from_value(2.0 * z.real)
    square = DoubleDouble.from_value(z.real) * z.real + DoubleDouble.from_value(z.imag) * z.imag
    zero = total - total
    before, last = zero, zero
    for power in range(len(coefficients.hi)):
        before, last = last, coefficients[power] + (total * last - square * before)
    # The remainder is ``before`` (z - total) + ``last``, and z - total is minus the conjugate.
    real = last - before * z.real
    return real.rounded() + 1j * (before * z.imag).rounded()


def dense_radius_error(coefficients: Number, error: Array, radius: Array, *, unit: float) -> Array:
    """Prove the same for coefficients on the first axis, in numbers of a unit roundoff.

    All roots are inside the circle of radius + error, and not all inside that of radius - error:
    each side is one verdict on p(r z), tried for a ladder of errors in steps of a ratio of 4 (lemma
    R3 of docs/proofs.md). ``error`` bounds the sum of the errors of the coefficients.
    """
    numbers = leading(coefficients)
    places = list(range(len(numbers)))
    if not is_any_traced(numbers):
        zeros = ~np.any(np.asarray(numbers), axis=tuple(range(1, np.ndim(numbers))))
        places = kept_places(len(numbers) - 1, zeros.__getitem__)
    given = coefficients if len(places) == len(numbers) else take(coefficients, np.array(places))
    return _proved_error(given, error, radius, unit=unit, places=tuple(places))


@compiled(static=["unit", "places"])
def _proved_error(
    coefficients: Number, error: Array, radius: Array, *, unit: float, places: tuple[int, ...]
) -> Array:
    xp = namespace(coefficients, error, radius)
    both = tree_map(lambda values: xp.stack([values, values], axis=1), coefficients)
    steps = xp.asarray([2.0**power for power in range(-50, -5, 2)])  # bounds tried, relative
    sides = xp.stack([xp.ones_like(radius), -xp.ones_like(radius)])
    wanted = xp.where(sides > 0.0, Verdict.STABLE, Verdict.UNSTABLE)

    def prove(state: tuple[Array, Array]) -> tuple[Array, Array]:
        step, found = state
        scale = radius * (1.0 + sides * steps[step])
        tried = radius * (steps[step] + 2.0 * UNIT)  # the scale is rounded to UNIT
        is_proved = xp.isinf(found) & (scaled_codes(both, error, scale, unit, places) == wanted)
        return step + 1, xp.where(is_proved, tried, found)

    def is_open(state: tuple[Array, Array]) -> Array:
        step, found = state
        return (step < len(steps)) & xp.any(xp.isinf(found))

    start = xp.asarray(0), xp.full_like(sides, xp.inf)
    return xp.max(repeat_while(is_open, prove, start)[1], axis=0)


def scaled_codes(
    coefficients: Number, error: Array, scale: Array, unit: float, places: Sequence[int]
) -> Array:
    """Return the codes of p(scale z) / scale^n; coefficients elsewhere than at places are 0."""
    xp, degree = namespace(coefficients, error, scale), places[-1]
    columns = [take(coefficients, k) for k in range(len(places))]
    scaled, rounding = scaled_polynomial(columns, error, scale, unit, places)
    signed = [-value if at % 2 else value for at, value in zip(places, scaled, strict=True)]
    sizes = sum(map(size, scaled))
    at_one, at_minus_one = (leading(reduce(operator.add, terms)) for terms in (scaled, signed))
    end_error = rounding + degree * unit * sizes
    ends = Ends(at_one, end_error, at_minus_one, end_error)
    stacked = tree_map(lambda *c: xp.stack(c), *scaled)
    return polynomial_codes(stacked, rounding, ends, unit, degree)


def scaled_polynomial(
    columns: list[Number], error: Array, scale: Array, unit: float, places: Sequence[int]
) -> tuple[list[Number], Array]:
    """Return p(scale z) / scale^n of monic p at places, and a bound of the sum of its errors."""
    xp, inverse, powers = namespace(columns, error, scale), columns[0] / scale, columns[:1]
    for _ in range(places[-1]):
        powers.append(powers[-1] * inverse)
    scaled = [column * powers[at] for column, at in zip(columns, places, strict=True)]
    rounding = SAFETY * error * xp.maximum(1.0, size(powers[-1]))
    return scaled, rounding + (2 * places[-1] + 8) * unit * sum(map(size, scaled)) + UNDERFLOW


_LIST = 1 << 12  # points whose companion matrices are made at once
_APART = 1 << 15  # points of one delay from which on they are asked apart from other delays
_MANY = 1 << 21  # points times degree of which LAPACK finds eigenvalues while XLA compiles


class SpectralRadius(NamedTuple):
    """The largest modulus of a root of p(z), a bound of its error, and the status of the bound.

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
        if not are_numbers(self):
            return f"SpectralRadius{tuple(self)}"
        values, errors, codes = map(np.ravel, self)
        if np.ndim(self.value) == 0:
            shown = text_with_bound(float(values[0]), float(errors[0]))
            return f"{shown} ({RadiusStatus(int(codes[0])).words})"
        if not len(values):
            return "SpectralRadius of no loop"
        bound = number_text(float(errors.max()), 2, ROUND_CEILING)
        counts = ", ".join(
            f"{count} {status.words}"
            for status in RadiusStatus
            if (count := np.sum(codes == status))
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
    longest_delay: int | float | None = None,
    method: str = "fast",
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> SpectralRadius:
    """The largest modulus of a closed-loop pole with a proved error bound.

    Args:
        alpha, beta, gamma, delta, delay, longest_delay: see ``jaxstab.conventions``.
        velocity, position: see ``jaxstab.conventions``.
        method: "fast" finds and proves the dominant root, without eigenvalues for many points of
            one delay up to 64, by XLA; "companion" takes the companion matrix and a ladder of
            verdicts for all. Inside jit, vmap and grad, and with filters, it is always the
            companion matrix.

    Returns:
        SpectralRadius of arrays of the broadcast shape, in JAX if an argument is: ``value``;
        ``error``, proved: all roots are inside value + error, not all inside value - error;
        ``status``, a RadiusStatus: NO_BOUND also next to gamma = (2 pi k)^2 with next to no
        damping, where N(z) nearly vanishes, and for radii below 0.5 at delta above 10, where not
        all digits of N(z) are known. The derivative of ``value`` is that of the dominant root by
        the implicit function theorem; it is infinite or NaN where that root is multiple.

    Raises: see ``jaxstab.conventions``.

    Source: eq. (9); sec. V of the paper for its use.

    Example:
        >>> radius = jaxstab.spectral_radius(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)
        >>> round(float(radius.value), 9)
        0.987122033
    """
    checked_word("method", method, ("fast", "companion"))
    arguments = alpha, beta, gamma, delta, delay
    require_together(**by_name(*arguments))
    filters = given_filters(velocity, position)
    if is_any_traced(arguments, filters):
        coefficients = characteristic_polynomial(
            **by_name(*arguments), longest_delay=longest_delay, **as_keywords(filters)
        )
        traced = _traced_radius(coefficients, is_summed=filters is not None)
        return _believed(*traced, gamma, delta)
    gains = checked_gain("alpha", alpha), checked_gain("beta", beta)
    parameters = (*gains, checked_gamma(gamma), checked_delta(delta))
    samples = checked_delay(bounded_delay(delay, longest_delay))
    is_fast, xp = method == "fast" and not filters, namespace(arguments)
    # Many points of one delay stay where JAX has them; other questions are NumPy's.
    shape = np.broadcast_shapes(samples.shape, *map(np.shape, parameters))
    is_kept = is_fast and xp is not np and _is_for_many([xp.asarray(0.0)], shape, samples)
    own = xp if is_kept else np
    points = [*(own.asarray(value, np.float64) for value in parameters), samples]
    if filters:
        both = filtered_radius(Points(*points), filters)
    else:
        both = _concrete_radius(points, is_fast=is_fast)
    answer = _believed(*both, points[2], points[3])
    return answer if xp is own else tree_map(xp.asarray, answer)


def linear_spectral_radius(alpha: Array, beta: Array, loop: LinearLoop) -> SpectralRadius:
    """Spectral radii of walls of one loop, of any device and filters; both may be traced."""
    if is_any_traced(alpha, beta, loop):
        both = _traced_radius(loop_polynomial(alpha, beta, loop), is_summed=True)
    else:
        xp = namespace(alpha, beta, loop)
        walls = tree_map(np.asarray, (alpha, beta, loop))
        shape = np.broadcast_shapes(*map(np.shape, leaves(walls)))
        value, error = listed_radii(walls, shape, np.arange(prod(shape)))
        both = xp.asarray(value.reshape(shape)), xp.asarray(error.reshape(shape))
    return with_status(*both)


def _concrete_radius(points: list[Array], *, is_fast: bool) -> tuple[Array, Array]:
    *parameters, delay = points
    shape = np.broadcast_shapes(*(values.shape for values in points))
    if delay.size == 1:
        return _of_delay(parameters, shape, delay.item(), is_fast=is_fast)
    value, error = np.empty(shape), np.empty(shape)
    for _, indices in Points(*points).groups(np.full(shape, True)):
        (listed,) = looked_up([delay], shape, indices)
        delays, number = np.unique(listed, return_inverse=True)
        parts = [indices]  # of few points for each delay
        if delays.size * _APART <= indices.size:
            parts = [indices[number == k] for k in range(delays.size)]
        for part in parts:
            *listed, own = looked_up(points, shape, part)
            own = own[0].item() if len(parts) == delays.size else own
            found = _of_delay(listed, part.shape, own, is_fast=is_fast)
            value.flat[part], error.flat[part] = found
    return value, error


def _of_delay(
    parameters: list[Array], shape: tuple[int, ...], delay: Values | float, *, is_fast: bool
) -> tuple[Array, Array]:
    """Return the answer at points of one delay, or of delays of the same form of p(z)."""
    if is_fast and _is_for_many(parameters, shape, delay):
        value, error, still_open = fast_radius(parameters, shape, float(delay))
    else:
        value, error = np.zeros(shape), np.full(shape, np.inf)
        still_open = np.arange(value.size)
    for start in range(0, still_open.size, _LIST):
        part = still_open[start : start + _LIST]
        *listed, own = tree_map(np.asarray, looked_up([*parameters, delay], shape, part))
        best = _few(listed, own, is_fast=is_fast)
        closer = ~(best[1] >= np.asarray(error.ravel()[part]))
        value, error = (
            with_values(column, part[closer], new[closer])
            for column, new in zip((value, error), best, strict=True)
        )
    return value, error


def _is_for_many(parameters: list[Array], shape: tuple[int, ...], delay: Values | float) -> bool:
    """True where XLA is not slower than eigenvalues, the time for compiling included."""
    if np.size(delay) > 1 or delay > LONGEST_DELAY:
        return False
    if is_any_jax(parameters):
        return prod(shape) >= FEW
    degree = polynomial_degree(float(delay))
    return pays((fast_radius, degree), prod(shape), _MANY / degree)


def _few(
    parameters: list[Values], delay: Values | float, *, is_fast: bool
) -> tuple[Values, Values]:
    """Return value and error for a list of points: eigenvalues, proved in one of two ways."""
    shape = np.broadcast_shapes(*map(np.shape, parameters))
    value, error = np.zeros(shape), np.full(shape, np.inf)
    if is_fast:
        value, error = _polished(parameters, delay)
    is_open = np.flatnonzero(~(error <= TOLERANCE))
    if is_open.size:
        listed = looked_up([*parameters, delay], shape, is_open)
        coefficients = characteristic_polynomial(**by_name(*listed))
        rough = np.abs(companion_poles(coefficients)[:, 0])
        bound = radius_error(coefficients, rough)
        closer = ~(bound >= error[is_open])
        value[is_open[closer]], error[is_open[closer]] = rough[closer], bound[closer]
    return value, error


def _polished(parameters: list[Values], delay: Values | float) -> tuple[Values, Values]:
    degree, loop = polynomial_degree(float(np.max(delay))), loop_of(parameters, delay)
    root = companion_poles(loop.polynomials(degree))[:, 0]
    t = Complex(root.real - 1.0, np.abs(root.imag))
    with np.errstate(all="ignore"):
        for _ in range(3):
            t = newton(t, loop, degree)
        return with_distance(t, loop, degree)


def _traced_radius(coefficients: Array, *, is_summed: bool) -> tuple[Array, Array]:
    from jaxstab.point.traced_radius import largest_modulus

    value = largest_modulus(coefficients)
    return value, radius_error(*constant((coefficients, value)), is_summed=is_summed)


@compiled()
def _believed(value: Array, error: Array, gamma: Array, delta: Array) -> SpectralRadius:
    """Radii without the bounds where the plant is not known to an ulp."""
    # Strongly damped plants have coefficients of N far below its size, which do not have all their
    # digits; rounding errors beside 1, divided by powers of a small radius, exceed one rounding.
    damped, small_radius = 10.0, 0.5
    xp = namespace(value, error, gamma, delta)
    is_damped, is_lost = delta > damped, is_plant_lost(gamma, delta)
    if xp is not np or np.any(is_damped) or np.any(is_lost):
        error = xp.where(is_lost | (is_damped & (value < small_radius)), xp.inf, error)
    return with_status(value, error)


def with_status(value: Array, error: Array) -> SpectralRadius:
    """Radii with what their bounds say: proved, or none."""
    xp = namespace(value, error)
    status = xp.where(error < xp.inf, np.int8(RadiusStatus.PROVED), np.int8(RadiusStatus.NO_BOUND))
    return SpectralRadius(value, error, named(status, RadiusStatus))
