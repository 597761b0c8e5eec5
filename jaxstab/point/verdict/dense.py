"""Certified verdicts of polynomials without a special form: loops with estimators and filters.

The steps of Schur and Cohn on all coefficients, in O(degree^2) operations. What is proved follows
from the same lemmas as for the loop of the paper: V2 to V6 of docs/proofs.md, with V8 for what is
lost in forming p(z).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic

import numpy as np

from jaxstab.arrays import Array, kept, namespace, pytree, repeat, tree_map
from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE
from jaxstab.model import DoubleDouble
from jaxstab.model.linear_loop import Affine, LinearLoop
from jaxstab.point.verdict.recursion import SAFETY, UNDERFLOW, Number, drifted, leading, size


@pytree
@dataclass(frozen=True)
class _State(Generic[Number]):
    """A polynomial and its reverse, coefficients first, with what is known of the steps so far."""

    falling: Number  # highest power first; beyond the degree there is noise that is not read
    rising: Number
    error: Array  # l1 norm of all errors of the coefficients
    inside: Array  # every |K| < 1 so far
    regular: Array  # no |K| = 1 so far
    outside: Array  # an exact |K| > 1
    drift: Array  # of each coefficient from exact steps


def dense_codes(alpha: Number, beta: Number, loop: LinearLoop, *, unit: float) -> Array:
    """Return the codes of walls, computed in numbers of the given unit roundoff.

    The loop's numbers are float64 where alpha and beta are, or pairs.
    """
    ends = [_affine(end, alpha, beta, unit) for end in (loop.at_one, loop.at_minus_one)]
    return polynomial_codes(*loop_coefficients(alpha, beta, loop, unit), ends, unit)


def polynomial_codes(
    coefficients: Number, error: Array, ends: Sequence[tuple[Array, Array]], unit: float
) -> Array:
    """Return the codes of monic polynomials.

    Args:
        coefficients: on the first axis, highest power first.
        error: bound of the sum of their errors.
        ends: p(1) and (-1)^n p(-1) up to positive factors, each with a bound of its error.
        unit: roundoff of the numbers.
    """
    xp = namespace(coefficients, error, ends)
    degree = len(leading(coefficients)) - 1
    shape = error.shape
    state = _State(
        coefficients,
        tree_map(lambda values: values[::-1], coefficients),
        error,
        inside=xp.ones(shape, bool),
        regular=xp.ones(shape, bool),
        outside=xp.zeros(shape, bool),
        drift=error + 4.0 * unit,
    )
    # A coefficient of a stable polynomial is at most binomial(n, i). Numbers stay finite so.
    large = xp.sum(size(coefficients), axis=0) - error > 8.0 * 2.0**degree
    state = repeat(degree - 2, lambda before: _step(before, unit), state)
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


def _step(state: _State[Number], unit: float) -> _State[Number]:
    """Lower the degree by one, and bound what exact steps with the same K could differ by."""
    xp = namespace(state)
    falling, rising = state.falling, state.rising
    first, last = part_of(falling, 0), part_of(rising, 0)
    ratio = tree_map(kept, last / first)
    modulus = size(ratio)
    total = xp.sum(size(falling), axis=0)
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
