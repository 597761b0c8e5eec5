"""A Schur-Cohn recursion in O(degree) operations whose rounding errors are part of a proof.

**Recursion.** p(z) = z^(m-2) (u0 z^2 + u1 z + u2 + u3/z) + (v0 + v1 z + v2 z^2 + v3 z^3): only the
first and the last few coefficients of p are not zero, whatever the delay. A step of Schur and Cohn,
p -> (p - K z^m p(1/z)) / z with K = v0/u0, lowers the degree m by one and keeps this form:

    u_i -> u_i - K v_i,        v_i -> v_(i+1) - K u_(i+1).

The K that were computed decide, however wrong they are; ``error`` bounds what the polynomial may
differ by from exact steps with the same K, and the winding number of the quadratic at the end, with
the signs of p(1) and p(-1), tells where the roots are: lemmas V2 to V4 of docs/proofs.md.

Near z = 1 u0 and u2 are both close to 1. Their difference, the ``gap``, is carried instead, so
errors are relative to the gap and to the tail, not to the coefficients of p. Far outside, for long
delays, factors of 1 + |K| add up to more than float64 has digits; there the first |K| above 1 is
enough to say UNSTABLE, if it is so beyond the errors up to then.

Sources: Schur (1917), Cohn (1922); Jury (1964), Theory and Application of the z-Transform Method.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from operator import add
from typing import Any, NamedTuple, TypeVar

import numpy as np

from jaxstab.arrays import (
    Array,
    is_any_traced,
    is_jax,
    joined,
    kept,
    namespace,
    pytree,
    repeat,
    rounded_reciprocal,
    tree_map,
)
from jaxstab.conventions import Verdict
from jaxstab.model import DoubleDouble
from jaxstab.model.double_double import leading, size, size_sum
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.rounding import SAFETY

Number = TypeVar("Number", Array, DoubleDouble)

UNDERFLOW = 1e-260  # more than the error of numbers flushed to zero
HIGHEST_COUNTED = 28  # degree up to which XLA compiles the steps of a count without a loop


@pytree
@dataclass(frozen=True)
class Balance:
    """Zeros inside less those outside: of p, ``total`` and ``sign`` times a step's.

    A step with |K| < 1 leaves one zero less inside; one with |K| > 1 exchanges the sides (lemma V2
    of docs/proofs.md). Of all fields but ``total`` the signs alone count.
    """

    total: Array
    sign: Array
    at_one: Array  # of the present polynomial
    at_minus_one: Array  # of the present polynomial times (-1)^degree
    parity: Array | float  # (-1)^degree

    def after(self, ratio: Array, modulus: Array) -> "Balance":
        """Return the balance after a step with a ratio K."""
        sign = self.sign * (1.0 - modulus)
        return Balance(
            self.total + namespace(sign).copysign(1.0, sign),
            sign,
            self.at_one * (1.0 - ratio),
            self.at_minus_one * (1.0 - self.parity * ratio),
            -self.parity,
        )


@pytree
@dataclass(frozen=True)
class Chain:
    """A polynomial in the form of the recursion, with the error bounds of its coefficients."""

    gap: Array  # u0 - u2
    head: tuple[Array, ...]  # u1, u2 and u3 where it is not zero
    tail: tuple[Array, ...]  # v0, v1, ... as far as they are not zero
    head_error: Array  # of u1 and twice that of u2
    error: Array  # l1 norm of all other errors
    inside: Array | bool = True  # every |K| < 1 so far
    regular: Array | bool = True  # no |K| = 1 so far
    outside: Array | bool | None = None  # a first |K| > 1, beyond all errors; None: not followed
    balance: Balance | None = None  # of zeros; None: not followed


class Ends(NamedTuple):
    """p(1) and (-1)^n p(-1) up to positive factors, and bounds of their errors."""

    at_one: Array
    at_one_error: Array | float
    at_minus_one: Array
    at_minus_one_error: Array


def decide(
    chain: Chain, ends: Ends, unit: float, degree: int | Array, highest: int | None = None
) -> Array:
    """Return the codes of monic polynomials of a degree >= 3, computed with a unit roundoff.

    Degrees above 3 may differ from point to point, up to the ``highest``.
    """
    chain, gap, ratio, is_clear = _at_the_end(chain, unit, degree, highest)
    is_inside = chain.inside & (abs(ratio) < 1.0) & (gap > 0.0)
    is_outside = False if chain.outside is None else chain.outside
    return _codes(is_inside, is_outside, is_clear, ends)


def _codes(is_inside: Array, is_outside: Array | bool, is_clear: Array, ends: Ends) -> Array:
    """Return codes by what the steps say of the roots, if they are clear, and by real roots."""
    xp = namespace(is_clear, ends)
    # With no error p(1) = 0 is a root at 1, which is not inside.
    is_real = (ends.at_one <= -ends.at_one_error) | (ends.at_minus_one < -ends.at_minus_one_error)
    no_real = (ends.at_one > ends.at_one_error) & (ends.at_minus_one > ends.at_minus_one_error)
    counted = xp.where(is_inside, Verdict.STABLE, Verdict.UNSTABLE)
    codes = xp.where(no_real & is_clear, counted, Verdict.UNDECIDED)
    return xp.where(is_real | is_outside, Verdict.UNSTABLE, codes).astype(np.int8)


def zeros_outside(chain: Chain, ends: Ends, unit: float, degree: int) -> Array:
    """The number of zeros of polynomials outside the circle, NaN where it is not proved."""
    xp = namespace(chain)
    one, length, parity = xp.ones_like(chain.error), degree, (-1.0) ** degree
    if xp is not np and degree > HIGHEST_COUNTED:
        length, parity = xp.asarray(degree), parity * one
    balance = Balance(0.0 * one, one, ends.at_one, ends.at_minus_one, parity)
    chain, gap, ratio, is_clear = _at_the_end(replace(chain, balance=balance), unit, length)
    assert chain.balance is not None
    last = chain.balance.after(ratio, abs(ratio))
    sign, at_one, at_minus_one = map(xp.sign, (last.sign, last.at_one, last.at_minus_one))
    inside = last.total + sign * xp.sign(gap) * (at_one + at_minus_one)
    is_clear = is_clear & (sign * at_one * at_minus_one != 0.0)  # products may underflow
    is_clear = is_clear & (abs(ends.at_one) > ends.at_one_error)
    is_clear = is_clear & (abs(ends.at_minus_one) > ends.at_minus_one_error)
    return xp.where(is_clear, 0.5 * (degree - inside), xp.nan)


def _at_the_end(
    chain: Chain, unit: float, degree: int | Array, highest: int | None = None
) -> tuple[Chain, Array, Array, Array]:
    """Return the cubic, u0 - u2 of the quadratic and the last K, and whether their signs count."""
    # A degree that is an array sets the length of a loop, one compilation serving all above 3; of
    # several degrees each point takes its own number of the steps.
    is_cubic = isinstance(degree, int) and degree == 3
    if not is_cubic:
        chain = _step(chain, unit, is_monic=True)
    if isinstance(degree, int):
        for _ in range(degree - 4):
            chain = _step(chain, unit)
    else:
        xp, step = namespace(chain), partial(_step, unit=unit, is_rolled=True)
        start = tree_map(lambda value: xp.broadcast_to(value, xp.shape(chain.error)), chain)
        if highest is None:
            chain = repeat(degree - 4, step, start)
        else:

            def chosen(state: tuple[Array, Chain]) -> tuple[Array, Chain]:
                left, before = state
                after = tree_map(partial(xp.where, left > 0), step(before), before)
                return left - 1, after

            is_short = highest <= HIGHEST_COUNTED
            chain = repeat(highest - 4, chosen, (degree - 4, start), is_unrolled=is_short)[1]
    gap, error, ratio = _last_gap(chain, unit, is_monic=is_cubic)
    is_clear = abs(gap) > (SAFETY * (degree - 1)) * error
    return chain, gap, ratio, is_clear & chain.regular & (abs(ratio) != 1.0)


def _last_gap(chain: Chain, unit: float, *, is_monic: bool) -> tuple[Array, Array, Array]:
    """Return u0 - u2 of the quadratic, a bound of all errors there, and the last K."""
    # The step from a cubic b0 z^3 + b1 z^2 + b2 z + b3.
    head, tail = chain.head, chain.tail
    b0 = chain.gap + head[1]
    b1 = head[0] + tail[2] if len(tail) > 2 else head[0]
    b3 = tail[0] + head[2] if len(head) > 2 else tail[0]
    ratio = b3 if is_monic else _quotient(b3, b0, is_alone=chain.balance is None)
    modulus = abs(ratio)
    gap = (chain.gap - tail[1] if len(tail) > 1 else chain.gap) + ratio * (b1 - b3)
    sizes = abs(b0) + abs(b1) + 2.0 * abs(b3) + size_sum(head) + size_sum(tail)
    error = chain.error + modulus * (chain.error + chain.head_error + 4.0 * unit * sizes)
    return gap, error + 2.0 * unit * (abs(chain.gap) + size_sum(tail[1:2])), ratio


def _step(chain: Chain, unit: float, *, is_monic: bool = False, is_rolled: bool = False) -> Chain:
    head, tail = chain.head, chain.tail
    lead = chain.gap + head[1]
    is_alone = chain.balance is None or is_rolled
    ratio = tail[0] if is_monic else _quotient(tail[0], lead, is_alone=is_alone)
    modulus = abs(ratio)
    outside = chain.outside
    if outside is not None:
        errors = chain.error + chain.head_error
        outside = outside | (chain.inside & _is_larger(tail[0], lead, errors, unit))
    lowered = tail[0] - tail[2] if len(tail) > 2 else tail[0]
    pairs = list(zip_longest(head, tail[1:]))
    bounds = _bounds_after(chain, lead, modulus, unit)
    return Chain(
        gap=chain.gap - ratio * lowered,
        head=tuple(minus(u, ratio, v) for u, v in pairs),
        tail=tuple(minus(v, ratio, u) for u, v in pairs),
        inside=chain.inside & (modulus < 1.0),
        regular=chain.regular & (modulus != 1.0),
        outside=outside,
        balance=chain.balance and chain.balance.after(ratio, modulus),
        **bounds,
    )


def _is_larger(last: Number, lead: Number, error: Array, unit: float) -> Array:
    return size(last) * (1.0 - 4.0 * unit) - size(lead) > SAFETY * error


def _quotient(dividend: Number, divisor: Number, *, is_alone: bool) -> Number:
    """Return a quotient, right to three roundings."""
    if isinstance(divisor, DoubleDouble) or not is_jax(divisor):
        return dividend / divisor
    if is_alone:
        return kept(dividend / divisor)
    inverse = rounded_reciprocal(size(divisor))
    return kept(dividend * namespace(divisor).where(divisor < 0.0, -inverse, inverse))


def _bounds_after(chain: Chain, lead: Array, modulus: Array, unit: float) -> dict[str, Array]:
    """Bound the deviation from exact steps with the same K after one more (lemma V3)."""
    head, tail = chain.head, chain.tail
    sizes = abs(lead) + abs(tail[0]) + size_sum(head) + size_sum(tail[2:])
    small = abs(chain.gap) + size_sum(tail[1:])
    carried = chain.error + chain.head_error + 4.0 * unit * sizes
    # Where v_i = 0, u_i stays and is not rounded.
    touched = list(zip(head[:2], tail[1:3], (1.0, 2.0), strict=False))
    rounded = sum(weight * (abs(u) + 2.0 * modulus * abs(v)) for u, v, weight in touched)
    return {
        "head_error": chain.head_error + 2.0 * modulus * chain.error + unit * rounded,
        "error": chain.error + modulus * carried + unit * small,
    }


def minus(a: Number | None, ratio: Number, b: Number | None) -> Any:
    """Return a - ratio b, where None is zero."""
    if b is None:
        return a
    return -(ratio * b) if a is None else a - ratio * b


# Polynomials without a special form, of loops with estimators and filters: steps act on all
# coefficients, in O(degree^2) operations; where only the first and the last ones are not 0, as with
# windows and long delays, on those alone. The same lemmas prove them.


@pytree
@dataclass(frozen=True)
class _State:
    """Both ends of a polynomial, coefficients first, with bounds from the steps so far.

    The ends are either as long as the polynomial, each of them all of it, or too short to meet.
    """

    # A tuple where XLA compiles steps without a loop, else an array, which has noise that is not
    # read in the places beyond the degree.
    falling: Any  # highest power first
    rising: Any  # lowest power first
    error: Array  # l1 norm of all errors of the coefficients
    inside: Array  # every |K| < 1 so far
    regular: Array  # no |K| = 1 so far
    outside: Array  # the first |K| > 1 was so beyond all errors


def dense_codes(
    alpha: Number, beta: Number, loop: LinearLoop, *, unit: float, degree: int
) -> Array:
    """Return the codes of walls, computed in numbers of the given unit roundoff.

    The loop's numbers are float64 where alpha and beta are, or pairs. Its degree is told, for
    coefficients may be left out (``without_zeros``).
    """
    one, minus_one = (_end(x, alpha, beta, loop, unit) for x in (loop.at_one, loop.at_minus_one))
    ends = Ends(*one, *minus_one)
    return polynomial_codes(*loop_coefficients(alpha, beta, loop, unit), ends, unit, degree)


def without_zeros(loop: LinearLoop) -> LinearLoop:
    """Leave out the coefficients in the middle of p(z) that are 0 whatever the gains are."""
    if is_any_traced(loop):
        return loop
    places = kept_places(loop.degree, lambda k: all(_is_zero(row[k].hi) for row in loop[:3]))
    base, stiffness, damping = (tuple(row[k] for k in places) for row in loop[:3])
    return loop._replace(base=base, stiffness=stiffness, damping=damping)


def kept_places(degree: int, is_zero: Callable[[int], bool]) -> list[int]:
    """The places of the coefficients that stay if those in the middle that are 0 are left out.

    As many stay at the end as at the beginning, less one. All stay where steps on the ends would
    not be less work.
    """
    pays = 2.5  # degree over the length of an end from which on they are
    width = (degree + 3) // 2
    while width > 3 and is_zero(width - 1) and is_zero(degree + 2 - width):
        width -= 1
    places = list(range(degree + 1))
    return places if pays * width > degree else places[:width] + places[degree + 2 - width :]


def _is_zero(values: Array) -> bool:
    plain = type(values) in (float, np.float64)  # many times faster than an array of one
    return bool(values == 0.0) if plain else not np.any(values)


def polynomial_codes(
    coefficients: Number, error: Array, ends: Ends, unit: float, degree: int
) -> Array:
    """The codes of monic polynomials of degree >= 3.

    Args:
        coefficients: on the first axis, highest power first; either all of them, or an odd number,
            the middle one of them the last before a gap of zeros.
        error: bound of the sum of their errors.
        ends: the values at 1 and -1.
        unit: roundoff of the numbers.
        degree: of the polynomials.
    """
    highest_unrolled = 32  # degree; unrolled steps of 36 took XLA minutes to compile
    xp = namespace(coefficients, error, ends)
    shape = error.shape
    given = len(leading(coefficients))
    width = given if given > degree else (given + 1) // 2
    is_unrolled = xp is not np and degree <= highest_unrolled
    columns: Any = tuple(coefficients[k] for k in range(given)) if is_unrolled else coefficients
    state = _State(
        *_ends(columns, width),
        error,
        inside=xp.ones(shape, bool),
        regular=xp.ones(shape, bool),
        outside=xp.zeros(shape, bool),
    )
    # A coefficient of a stable polynomial is at most binomial(n, i). Numbers stay finite so.
    large = _sum(columns) - error > 8.0 * 2.0**degree
    repeated = partial(repeat, is_unrolled=is_unrolled)
    if width < given:
        apart = partial(_dense_step, unit=unit, is_apart=True)
        state = _joined(repeated(degree + 1 - width, apart, state), unit)
    state = repeated(width - 3, partial(_dense_step, unit=unit), state)
    gap = leading(state.falling[0] - state.falling[2])
    is_clear = (abs(gap) > (SAFETY * (degree - 1)) * state.error) & state.regular
    return _codes(state.inside & (gap > 0.0), large | state.outside, is_clear, ends)


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
    sizes = [sum(map(size, row)) for row in loop[:3]]
    return coefficients, xp.broadcast_to(_rounding(alpha, beta, loop, sizes, unit), grid)


def _end(
    parts: Sequence[Number], alpha: Number, beta: Number, loop: LinearLoop, unit: float
) -> tuple[Array, Array]:
    base, stiff, damp = parts
    value = base + (stiff * alpha + damp * beta)
    return leading(value), SAFETY * _rounding(alpha, beta, loop, list(map(size, parts)), unit)


def _rounding(
    alpha: Number, beta: Number, loop: LinearLoop, sizes: Sequence[Array], unit: float
) -> Array:
    """Bound the errors of base + alpha stiffness + beta damping, for the sizes of these."""
    # A rounding of each number of the loop, of each product and of each of two sums.
    base, stiff, damp = (
        error + 4.0 * unit * one + UNDERFLOW for error, one in zip(loop.errors, sizes, strict=True)
    )
    return base + size(alpha) * stiff + size(beta) * damp


def _ends(coefficients: Any, width: int) -> tuple[Any, Any]:
    """Return the first coefficients, and the last ones from the last on, then a 0 for arrays."""
    if isinstance(coefficients, tuple):
        return coefficients[:width], coefficients[::-1][: len(coefficients) - width or None]
    xp = namespace(coefficients)

    def rising(values: Array) -> Array:
        end = values[::-1][:width]
        return end if width == len(values) else xp.concatenate([end[:-1], xp.zeros_like(end[:1])])

    return coefficients[:width], tree_map(rising, coefficients)


def _joined(state: _State, unit: float) -> _State:
    """Return the polynomial of a degree so low that its two ends overlap (lemma V2)."""
    falling, rising = state.falling, state.rising
    rounded = unit * _sum(falling, rising)
    if isinstance(falling, tuple):
        both: Any = (falling[0], *map(add, falling[1:], rising[::-1]))
    else:
        both = joined([falling[:1], falling[1:] + rising[-2::-1]])
    return replace(state, falling=both, rising=both[::-1], error=state.error + rounded)


def _sum(*numbers: Number | tuple[Number, ...]) -> Array:
    xp = namespace(numbers)
    return sum(size_sum(n) if isinstance(n, tuple) else xp.sum(size(n), axis=0) for n in numbers)


def _dense_step(state: _State, unit: float, *, is_apart: bool = False) -> _State:
    """Lower the degree by one, and bound what exact steps with the same K could differ by."""
    falling, rising = state.falling, state.rising
    lead, last = falling[0], rising[0]
    ratio = _quotient(last, lead, is_alone=not isinstance(falling, tuple))
    modulus, lowered = size(ratio), _lowered(falling, rising, ratio, is_apart=is_apart)
    total = _sum(falling, rising) if is_apart else _sum(falling)
    return _State(
        *lowered,
        error=state.error * (1.0 + modulus) + unit * total * (1.0 + 2.0 * modulus),
        inside=state.inside & (modulus < 1.0),
        regular=state.regular & (modulus != 1.0),
        outside=state.outside | (state.inside & _is_larger(last, lead, state.error, unit)),
    )


def _lowered(falling: Any, rising: Any, ratio: Number, *, is_apart: bool) -> tuple[Any, Any]:
    if not isinstance(falling, tuple):
        return falling - rising * ratio, tree_map(_shifted, rising - falling * ratio)
    lowered = tuple(minus(a, ratio, b) for a, b in zip_longest(falling, rising))
    turned = tuple(minus(a, ratio, b) for a, b in zip_longest(rising, falling))
    return lowered if is_apart else lowered[:-1], turned[1:]


def _shifted(values: Array) -> Array:
    xp = namespace(values)
    return xp.concatenate([values[1:], xp.zeros_like(values[:1])])
