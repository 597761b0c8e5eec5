"""The dominant pole of any linear loop, and how many poles are unstable, at every point of a grid.

One program for all points, on whatever device JAX has: elementwise operations on the coefficients
of p(z) alone, with a loop's filters or without. A high power of the companion matrix guesses the
dominant pole (``traced_radius``), or the matrix's eigenvalues do; a few steps of Newton's method
refine it, and a proof follows that uses nothing of how it was found:

- the steps of Schur and Cohn down to a constant count the poles outside of the unit circle, and of
  any other circle (lemma V4 of docs/proofs.md);
- a root lies within n |p/p'| of the pole (lemma R1). If it, or it and its conjugate, are all of the
  roots outside of a circle that is a little smaller, the spectral radius is its modulus.

Results are in float32: the radius is rounded up, and so is its bound. Where two poles of nearly the
same modulus compete, the dominant one is not known; there the radius is proved by a ladder of
verdicts in pairs (lemma R3), and frequency and damping ratio are NaN.
"""

from collections.abc import Callable
from functools import partial
from math import ceil, prod
from typing import NamedTuple, TypeVar

import numpy as np

from jaxstab.arrays import (
    Array,
    bits,
    floats,
    leaves,
    namespace,
    power_of_two_below_inverse,
    repeat,
    tree_map,
)
from jaxstab.batches import compiled, is_on_cpu, over_tiles
from jaxstab.model.filters import NO_FILTERS, Filters
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.point.poles import Complex, companion_poles, distance_to_root, evaluated
from jaxstab.point.radius import listed_radii, scaled_polynomial
from jaxstab.point.schur_cohn import UNDERFLOW, loop_coefficients, rounded_loop
from jaxstab.point.verdicts import Form, Points, Values, filtered_loops
from jaxstab.rounding import SAFETY, UNIT

UNKNOWN = -1  # poles outside of the circle, where one is too close to it to tell
_MANY = 2**17  # points of which LAPACK finds eigenvalues while XLA compiles
_LONGEST = 9  # degree up to which these doublings and the proof are compiled without loops
_BESIDE = 2.0**-17  # how far inside of the root the circle is, relative
_BLOCK = 2**18  # points of a part of a grid, which bound the memory
Result = TypeVar("Result")


class PoleFields(NamedTuple):
    """The fields of a grid of points, in float32 and int16.

    Attributes:
        radius: an upper bound of the spectral radius; NaN where none is proved.
        error: the spectral radius is at least ``radius - error``; infinite where none is proved.
        frequency: of the dominant pole z = exp(s), |Im s| in rad per sample, from 0 for a positive
            real pole to pi for a negative one; NaN where that pole is not resolved.
        damping_ratio: its -Re s / |s|: 1 for a positive real pole inside of the circle, -1 outside.
        outside: the number of poles outside of the circle; UNKNOWN where one is too close to it.
    """

    radius: Array
    error: Array
    frequency: Array
    damping_ratio: Array
    outside: Array


class _Count(NamedTuple):
    """A count of roots outside: those of p are count + sign times those of the polynomial left."""

    lost: Array  # bound of the sum of the errors of the polynomial's coefficients
    degree: Array  # of the polynomial that is left
    count: Array
    sign: Array


def fields_of_grid(
    alpha: Values,
    beta: Values,
    gamma: Values,
    delta: Values,
    delay: float,
    filters: Filters | None,
    *,
    longest: float,
    method: str,
) -> PoleFields:
    """Return the fields at all alpha and beta for each pair (gamma, delta), in NumPy.

    The arrays have the shape (alpha, beta, hand). ``longest`` is the longest delay for which others
    will be computed: low degrees are raised to that of the longest delay, by poles at 0, so that
    one program serves all. ``method`` is "fast" for powers of the companion matrix, "companion" for
    its eigenvalues; grids of few points always take eigenvalues.
    """
    hand = gamma[:, None, None], delta[:, None, None]
    points = Points(alpha[:, None], beta, *hand, np.asarray(delay))
    form = Form.from_delay(delay)
    pairs = filtered_loops(points, form, filters or NO_FILTERS)
    loop, missing = rounded_loop(pairs), ceil(longest) - ceil(delay)
    if loop.degree + missing <= _LONGEST:
        zeros = (0.0 * loop.base[0],) * missing
        base, stiffness, damping = (row + zeros for row in loop[:3])
        loop = loop._replace(base=base, stiffness=stiffness, damping=damping)
    shape = alpha.size, beta.size, gamma.size
    fields = PoleFields(*(np.empty(shape, kind) for kind in (*4 * [np.float32], np.int16)))
    for rows in np.array_split(np.arange(alpha.size), -(-prod(shape) // _BLOCK)):
        stiffness = points.alpha[rows]
        computed = _fields(stiffness, beta, loop, method=method)
        for whole, own in zip(fields, _with_ladder(computed, stiffness, beta, pairs), strict=True):
            whole[rows] = np.moveaxis(own, 0, -1)
    return fields


@compiled(static=["method"], many=_MANY, wide=True, pointwise=True)
def _fields(alpha: Array, beta: Array, loop: LinearLoop, *, method: str) -> PoleFields:
    # Each stage is a loop over tiles of its own: XLA computes what several results share anew. The
    # coefficients, too, are computed in each: that takes less time than to read them from memory.
    xp = namespace(alpha, beta, loop)

    def stage(kernel: Callable[..., Result], *more: Array) -> Result:
        def of_loop(loop: LinearLoop, *more: Array) -> Result:
            def of_points(alpha: Array, beta: Array, *more: Array) -> Result:
                coefficients, error = loop_coefficients(alpha, beta, loop, UNIT)
                return kernel(list(coefficients), error, *more)

            return over_tiles(of_points, (alpha, beta, *more))

        if xp is np or not is_on_cpu():
            return of_loop(loop, *more)
        from jax import lax

        shape = xp.broadcast_shapes((1, 1, 1), *map(xp.shape, leaves(loop)))
        loops = tree_map(lambda leaf: xp.broadcast_to(leaf, shape), loop)
        return lax.map(lambda own: of_loop(*own), (loops, *more))

    pole = stage(partial(_pole, is_guessed=method == "fast" and xp is not np))
    bound, radius = stage(_bound, pole), abs(pole)
    shown = _mode(pole, radius, bound)
    return PoleFields(*_outwards(radius, bound), *shown, stage(poles_outside))


def _pole(columns: list[Array], error: Array, *, is_guessed: bool) -> Array:
    doublings = 16  # of the power of the companion matrix, which is degree 2^16
    xp = namespace(columns, error)
    if is_guessed:
        from jaxstab.point.traced_radius import guessed_root

        is_unrolled = len(columns) - 1 <= _LONGEST
        z = Complex(*guessed_root(columns[:0:-1], doublings, is_unrolled=is_unrolled)) + 1.0
    else:
        root = companion_poles(xp.stack(columns, axis=-1))[..., 0]
        z = Complex(root.real, abs(root.imag))
    value, slope = evaluated(columns, z)  # a step of Newton's method
    z = z + value.over(slope) * -1.0
    return z.re + 1j * z.im


def _bound(columns: list[Array], error: Array, pole: Array) -> Array:
    """Return a proved bound of | |z| - spectral radius | and of the dominant pole's distance."""
    xp = namespace(columns, error)
    z = Complex(pole.real, pole.imag)
    radius, distance = xp.sqrt(z.squared_modulus()), distance_to_root(columns, error, z)
    is_dominant = _is_dominant(columns, error, z, radius, distance)
    return xp.where(is_dominant, distance + 4.0 * UNIT * radius, xp.inf)


def _is_dominant(
    columns: list[Array], error: Array, z: Complex, radius: Array, distance: Array
) -> Array:
    """Return True where all poles but the root at z, and its conjugate, are proved to be smaller.

    Those outside of a circle that is a little smaller, of radius r, are counted, on p(r z) / r^n.
    """
    within, is_real = radius * (1.0 - _BESIDE) - distance, z.im == 0.0
    scaled = scaled_polynomial(columns, error, within, UNIT, range(len(columns)))
    is_alone = poles_outside(*scaled) == namespace(columns, error).where(is_real, 1, 2)
    return is_alone & (within > 0.0) & (is_real | (z.im > distance))


def poles_outside(columns: list[Array], error: Array) -> Array:
    """Count the roots outside of the unit circle, as int16; UNKNOWN where it is not proved.

    ``columns`` are the coefficients, highest power first; ``error`` bounds the sum of their errors.
    Source: Schur (1917), Cohn (1922); lemma V4 of docs/proofs.md.
    """
    xp, degree = namespace(columns, error), len(columns) - 1
    ones, zero = xp.ones_like(error), xp.zeros_like(error)

    def lowered(rows: Array, turned: Array, state: _Count) -> tuple[Array, Array, _Count]:
        size, sizes = abs(rows[0]) + abs(turned[0]), sum(map(abs, rows))
        scale = power_of_two_below_inverse(size)
        lead, last = rows[0] * scale, turned[0] * scale
        is_turned = abs(last) > abs(lead)
        lost = scale * size * (state.lost + 4.0 * UNIT * sizes) + UNDERFLOW
        counted = _Count(
            xp.where(abs(last) == abs(lead), xp.inf, lost),
            state.degree - 1.0,
            xp.where(is_turned, state.count + state.sign * state.degree, state.count),
            xp.where(is_turned, -state.sign, state.sign),
        )
        return lead, last, counted

    def step(state: tuple[Array, Array, _Count]) -> tuple[Array, Array, _Count]:
        rows, turned, counted = state
        lead, last, counted = lowered(rows, turned, counted)
        after = xp.concatenate([(lead * turned - last * rows)[1:], zero[None]])
        return lead * rows - last * turned, after, counted

    counted = _Count(error, degree * ones, zero, ones)
    if degree <= _LONGEST:
        rows = columns
        while len(rows) > 1:
            lead, last, counted = lowered(rows, rows[::-1], counted)
            rows = [lead * a - last * b for a, b in zip(rows[:-1], rows[:0:-1], strict=True)]
    else:
        rows = xp.stack(columns)
        rows, _, counted = repeat(degree, step, (rows, rows[::-1], counted))
    return xp.where(abs(rows[0]) > SAFETY * counted.lost, counted.count, UNKNOWN).astype(np.int16)


def _mode(pole: Array, radius: Array, bound: Array) -> tuple[Array, Array]:
    """Return frequency and damping ratio of poles, NaN where the bound is too large."""
    close = 2.0**-22  # relative distance of a pole that is resolved from its approximation
    quantum = 2.0**-20  # of frequencies and damping ratios: what has fewer digits deflates better
    xp = namespace(pole)
    frequency, decay = xp.arctan2(pole.imag, pole.real), -xp.log(radius)
    size = xp.sqrt(decay * decay + frequency * frequency)
    is_resolved = bound <= close * xp.minimum(radius, size)
    frequency, ratio = (
        xp.where(is_resolved, quantum * xp.round(value / quantum), xp.nan).astype(np.float32)
        for value in (frequency, decay / size)
    )
    return xp.minimum(frequency, np.float32(np.pi)), ratio


def _outwards(radius: Array, bound: Array) -> tuple[Array, Array]:
    """Return radii, rounded up, and their bounds, rounded up to powers of two, in float32."""
    last_of_float32, last_of_power = 1 << 29, 1 << 52  # bits of a float64 that they leave
    tiny = 2.0**-126  # the least float32 of full precision
    xp, bound = namespace(radius, bound), bound + tiny
    is_known = xp.isfinite(bound)
    upper = _rounded_up((radius + bound) * (1.0 + 2.0 * UNIT), last_of_float32)
    error = _rounded_up(3.0 * bound + 2.0**-23 * upper, last_of_power)
    unknown = np.float32(np.nan), np.float32(np.inf)
    return tuple(
        xp.where(is_known, value.astype(np.float32), other)
        for value, other in zip((upper, error), unknown, strict=True)
    )


def _rounded_up(x: Array, last: int) -> Array:
    """Round x >= 0 up to what has no bits below the given last one of float64."""
    return floats((bits(x) + (last - 1)) & -last)


def _with_ladder(fields: PoleFields, alpha: Array, beta: Array, loop: LinearLoop) -> PoleFields:
    """Return fields with the radii of the few points of which the dominant pole is not known."""
    still_open = np.flatnonzero(np.isnan(np.asarray(fields.radius)))
    if not still_open.size:
        return fields
    radius, error = (np.array(column) for column in fields[:2])
    with np.errstate(all="ignore"):
        found = _outwards(*listed_radii((alpha, beta, loop), radius.shape, still_open))
    radius.flat[still_open], error.flat[still_open] = found
    return fields._replace(radius=radius, error=error)
