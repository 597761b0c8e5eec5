"""Certified verdicts of polynomials without a special form: loops with estimators and filters.

The Schur-Cohn steps act on all coefficients, in O(degree^2) operations; where only the first and
the last ones are not 0, as with windows and long delays, they act on those alone (lemma V9 of
docs/proofs.md). The proof uses the same lemmas as for the loop of the paper, V2 to V6, and V8 for
the error of forming p(z).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic

import numpy as np

from jaxstab.arrays import Array, is_any_traced, kept, namespace, pytree, repeat, tree_map
from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE
from jaxstab.model import DoubleDouble
from jaxstab.model.linear_loop import Affine, LinearLoop
from jaxstab.point.verdict.recursion import SAFETY, UNDERFLOW, Number, drifted, leading, size

_PAYS = 2.5  # degree over the length of an end from which on steps on the ends are less work


@pytree
@dataclass(frozen=True)
class _State(Generic[Number]):
    """Both ends of a polynomial, coefficients first, with what is known of the steps so far.

    The ends are either as long as the polynomial, each of them all of it, or too short to meet.
    """

    falling: Number  # highest power first; beyond the degree there is noise that is not read
    rising: Number  # lowest power first
    error: Array  # l1 norm of all errors of the coefficients
    inside: Array  # every |K| < 1 so far
    regular: Array  # no |K| = 1 so far
    outside: Array  # an exact |K| > 1
    drift: Array  # of each coefficient from exact steps


def dense_codes(
    alpha: Number, beta: Number, loop: LinearLoop, *, unit: float, degree: int
) -> Array:
    """Return the codes of walls, computed in numbers of the given unit roundoff.

    The loop's numbers are float64 where alpha and beta are, or pairs. Its degree is told, for
    coefficients may be left out (``without_zeros``).
    """
    ends = [_affine(end, alpha, beta, unit) for end in (loop.at_one, loop.at_minus_one)]
    return polynomial_codes(*loop_coefficients(alpha, beta, loop, unit), ends, unit, degree)


def without_zeros(loop: LinearLoop) -> LinearLoop:
    """Leave out the coefficients in the middle of p(z) that are 0 whatever the gains are.

    As many stay at the end as at the beginning, less one. Nothing is left out where that would not
    pay off, nor where JAX traces the numbers.
    """
    if is_any_traced(loop):
        return loop
    last = loop.degree
    width = (last + 3) // 2
    while width > 3 and all(
        _is_zero(part[index].hi) for part in loop[:3] for index in (width - 1, last + 2 - width)
    ):
        width -= 1
    if _PAYS * width > last:
        return loop
    base, stiffness, damping = (part[:width] + part[last + 2 - width :] for part in loop[:3])
    return loop._replace(base=base, stiffness=stiffness, damping=damping)


def _is_zero(values: Array) -> bool:
    plain = type(values) in (float, np.float64)  # many times faster than an array of one
    return bool(values == 0.0) if plain else not np.any(values)


def polynomial_codes(
    coefficients: Number,
    error: Array,
    ends: Sequence[tuple[Array, Array]],
    unit: float,
    degree: int,
) -> Array:
    """Return the codes of monic polynomials.

    Args:
        coefficients: on the first axis, highest power first; either all of them, or an odd number,
            the middle one of them the last before a gap of zeros.
        error: bound of the sum of their errors.
        ends: p(1) and (-1)^n p(-1) up to positive factors, each with a bound of its error.
        unit: roundoff of the numbers.
        degree: of the polynomials, at least 3.
    """
    xp = namespace(coefficients, error, ends)
    shape = error.shape
    given = len(leading(coefficients))
    width = given if given > degree else (given + 1) // 2
    state = _State(
        *_ends(coefficients, width),
        error,
        inside=xp.ones(shape, bool),
        regular=xp.ones(shape, bool),
        outside=xp.zeros(shape, bool),
        drift=error + 4.0 * unit,
    )
    # A coefficient of a stable polynomial is at most binomial(n, i). Numbers stay finite so.
    large = _sum(coefficients) - error > 8.0 * 2.0**degree
    if width < given:
        apart = partial(_step, unit=unit, is_apart=True)
        state = _joined(repeat(degree + 1 - width, apart, state), unit)
    state = repeat(width - 3, partial(_step, unit=unit), state)
    gap = leading(part_of(state.falling, 0) - part_of(state.falling, 2))
    is_clear = (abs(gap) > (SAFETY * (degree - 1)) * state.error) & state.regular
    real_outside, no_real = large, is_clear
    for value, bound in ends:
        real_outside = real_outside | (value < -bound)
        no_real = no_real & (value > bound)
    counted = xp.where(state.inside & (gap > 0.0), STABLE, UNSTABLE)
    codes = xp.where(no_real, counted, UNDECIDED)
    return xp.where(real_outside | state.outside, UNSTABLE, codes).astype(np.int8)


def rounded_loop(loop: Any) -> Any:
    """Return a loop, or a part of it, with its pairs rounded to float64."""
    if isinstance(loop, DoubleDouble):
        return loop.rounded()
    if isinstance(loop, tuple):
        parts = map(rounded_loop, loop)
        return type(loop)(*parts) if hasattr(loop, "_fields") else tuple(parts)
    return loop


def loop_coefficients(
    alpha: Number, beta: Number, loop: LinearLoop, unit: float
) -> tuple[Number, Array]:
    """Return the coefficients of p(z), highest power first, and a bound of their errors' sum."""
    xp = namespace(alpha, beta, loop)
    columns = [
        base + (stiff * alpha + damp * beta)
        for base, stiff, damp in zip(loop.base, loop.stiffness, loop.damping, strict=True)
    ]
    grid = xp.broadcast_shapes(*(xp.shape(leading(column)) for column in columns))
    coefficients = tree_map(
        lambda *values: xp.stack([xp.broadcast_to(value, grid) for value in values]), *columns
    )
    stiffness, damping = size(alpha), size(beta)
    sizes = [sum(map(size, part)) for part in loop[:3]]
    # A rounding of each number of the loop, of each product and of each of two sums.
    rounding = 4.0 * unit * (sizes[0] + stiffness * sizes[1] + damping * sizes[2])
    lost = loop.errors[0] + stiffness * loop.errors[1] + damping * loop.errors[2]
    lost = lost + UNDERFLOW * (1.0 + stiffness + damping)
    return coefficients, xp.broadcast_to(rounding + lost, grid)


def _affine(parts: Affine, alpha: Number, beta: Number, unit: float) -> tuple[Array, Array]:
    """Return base + alpha stiffness + beta damping, and a bound of its error."""
    base, stiff, damp = (part.value for part in parts)
    value = base + (stiff * alpha + damp * beta)
    sizes = size(base) + size(stiff) * size(alpha) + size(damp) * size(beta)
    errors = (
        parts.base.error + parts.stiffness.error * size(alpha) + parts.damping.error * size(beta)
    )
    underflow = UNDERFLOW * (1.0 + size(alpha) + size(beta))
    return leading(value), SAFETY * (errors + 4.0 * unit * sizes + underflow)


def _ends(coefficients: Number, width: int) -> tuple[Number, Number]:
    """Return the first coefficients, and the last ones from the last on, then zeros."""
    xp = namespace(coefficients)

    def rising(values: Array) -> Array:
        last = values[::-1][:width]
        return (
            last if width == len(values) else xp.concatenate([last[:-1], xp.zeros_like(last[:1])])
        )

    return tree_map(lambda values: values[:width], coefficients), tree_map(rising, coefficients)


def _joined(state: _State[Number], unit: float) -> _State[Number]:
    """Return the polynomial of a degree so low that its two ends overlap (lemma V9)."""
    xp = namespace(state)
    rest = tree_map(lambda values: values[-2::-1], state.rising)
    sums = tree_map(lambda values: values[1:], state.falling) + rest
    falling = tree_map(
        lambda first, others: xp.concatenate([first[:1], others]), state.falling, sums
    )
    rounded = unit * _sum(state.falling, state.rising)
    return replace(
        state,
        falling=falling,
        rising=tree_map(lambda values: values[::-1], falling),
        error=state.error + rounded,
        drift=2.0 * state.drift + rounded,
    )


def _sum(*numbers: Number) -> Array:
    """Return the sum of the moduli."""
    xp = namespace(numbers)
    return sum(xp.sum(size(number), axis=0) for number in numbers)


def _step(state: _State[Number], unit: float, *, is_apart: bool = False) -> _State[Number]:
    """Lower the degree by one, and bound what exact steps with the same K could differ by."""
    falling, rising = state.falling, state.rising
    first, last = part_of(falling, 0), part_of(rising, 0)
    ratio = tree_map(kept, last / first)
    modulus = size(ratio)
    total = _sum(falling, rising) if is_apart else _sum(falling)
    outside = state.outside | (size(last) - size(first) > 4.0 * state.drift)
    return _State(
        falling=falling - rising * ratio,
        rising=tree_map(_shifted, rising - falling * ratio),
        error=state.error * (1.0 + modulus) + unit * total * (1.0 + 2.0 * modulus),
        inside=state.inside & (modulus < 1.0),
        regular=state.regular & (modulus != 1.0),
        outside=outside,
        drift=drifted(state.drift, modulus, size(first), total, unit),
    )


def part_of(number: Number, index: int) -> Number:
    """Return one index of the first axis."""
    part: Number = tree_map(lambda values: values[index], number)
    return part


def _shifted(values: Array) -> Array:
    xp = namespace(values)
    return xp.concatenate([values[1:], xp.zeros_like(values[:1])])
