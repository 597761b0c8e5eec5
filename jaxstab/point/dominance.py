"""The dominant root of p(z), and the proof that it is the dominant one, with a bound of its error.

A root lies within n |p(z) / p'(z)| of any z (lemma R1 of docs/proofs.md). The recursion that
verdicts use, on p(r z), counts the roots outside of a circle whose radius r is a little less than
|z|. If it counts one where z is real, and two where it is not, all others are inside (lemma V4):
the root is dominant, and about |p(z) / p'(z)| away. The work grows with the degree, not with its
square.

Sources: Schur (1917), Cohn (1922); Henrici, Applied and Computational Complex Analysis I, 6.4, for
the distance.
"""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from math import ceil, prod
from operator import add
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int64

from jaxstab.arrays import (
    Array,
    is_any_jax,
    joined,
    leaves,
    namespace,
    reciprocal,
    take,
    tree_map,
    with_values,
)
from jaxstab.batches import compiled, filled_up, in_pieces, is_on_cpu, lists, over_tiles
from jaxstab.model import polynomial_degree
from jaxstab.model.double_double import size_sum
from jaxstab.point.poles import Complex, Value, looked_up
from jaxstab.point.schur_cohn import (
    HIGHEST_COUNTED,
    UNDERFLOW,
    Chain,
    Ends,
    zeros_outside,
)
from jaxstab.point.verdicts import Plant, float_plant, tail_error
from jaxstab.rounding import SAFETY, UNIT

# Only elementwise operations, the same for every point: a compiler keeps all of it in registers.
# Powers of the companion matrix (``traced_radius``) make the guess, for long delays those of a loop
# of fewer, longer samples. On a dense grid, neighbours share it: Newton's method leads from it to
# the roots of a few of them, and the others start from the curve through these. It works on
# t = z - 1, where the terms of
#
#     p(z) = z^(n-2) D(z) + N(z) (alpha z + beta t),    D = t^2 + (1 - d0 + D(1)) t + D(1)
#
# are as small as the gains that make them, so slow loops with roots close to 1 lose no digits.

Column = Any  # an array, or None for zeros

NEIGHBOURS = 16  # points that share a guess, at most the padding of the axes of a large grid
_NODES = (1, 4, 8, 11, 14)  # those of them between which roots are interpolated


class Effort(NamedTuple):
    """The work that is spent on finding the dominant root.

    Each doubling halves the number of points where two roots of nearly one modulus are confused.
    """

    doublings: int  # squarings of a power of z
    corrections: int  # steps of Newton's method
    longest_list: int  # points at once
    steps: int = 0  # into which the delay is divided for the guess; 0: the samples


class PlantPoints(NamedTuple):
    """Points of one degree; all fields broadcast. For a whole delay N(0) = 0 is divided out."""

    alpha: Array
    beta: Array
    gamma: Array
    plant: Plant

    @property
    def numerator(self) -> tuple[Array, ...]:
        """The coefficients of N(1 + t), highest power of t first."""
        stiff = self.plant.stiff
        if len(stiff) == 3:
            return stiff[2], self.plant.sum
        return stiff[3], 2.0 * stiff[3] + stiff[2], self.plant.sum

    @property
    def denominator(self) -> tuple[Array, Array]:
        """The coefficients of t and 1 in D(1 + t)."""
        at_one = self.gamma * self.plant.sum
        return self.plant.gap + at_one, at_one

    def coefficients(self, degree: int) -> list[Column]:
        """The coefficients of p(z) below z^degree, lowest power first."""
        plant = self.plant
        columns: list[Column] = [None] * degree
        columns[-1], columns[-2] = plant.d1, plant.d0
        for power, (stiff, damp) in enumerate(zip(plant.stiff, plant.damp, strict=True)):
            wall = stiff * self.alpha - damp * self.beta
            column = columns[power]
            columns[power] = wall if column is None else column + wall
        return columns

    def polynomials(self, degree: int) -> Array:
        """The coefficients of p(z) on the last axis, highest power of z first."""
        xp = namespace(self)
        columns = [1.0, *reversed(self.coefficients(degree))]
        given = [0.0 if column is None else column for column in columns]
        return xp.stack(xp.broadcast_arrays(*given), axis=-1)


@compiled(static=["degree", "effort", "shared"], many=0, wide=True)
def dominant_root(
    loop: PlantPoints, *, degree: int, effort: Effort, shared: int | None = None
) -> Array:
    """Guess t = z - 1 of a root z that is probably dominant, by XLA, as a complex array.

    The imaginary part is >= 0, and 0 for real roots. Of an axis that is ``shared``, the root is
    guessed for one point in NEIGHBOURS.
    """
    tile = 256  # points whose polynomials of a higher degree stay in the cache
    longest_unrolled = 4000  # about as many products; beyond, code was up to 100 times slower
    from jax import lax

    from jaxstab.point.traced_radius import guessed_root

    of_guess = effort.steps + 2 if effort.steps else degree
    is_unrolled = effort.doublings * of_guess * (of_guess + 10) <= longest_unrolled
    guessed = partial(guessed_root, doublings=effort.doublings, is_unrolled=is_unrolled)

    def root(loop: PlantPoints) -> Array:
        if effort.steps:
            t = _in_long_steps(loop, degree, effort.steps, guessed)
        else:
            t = Complex(*guessed(loop.coefficients(degree)))
        return lax.complex(t.re, t.im)  # of two arrays XLA would compute each on its own

    if shared is not None:
        middle = _along(shared, slice(NEIGHBOURS // 2, None, NEIGHBOURS))
        loop = tree_map(lambda leaf: leaf[middle] if _has_axis(leaf, shared) else leaf, loop)
    return root(loop) if is_unrolled else over_tiles(root, (loop,), tile)


def _has_axis(leaf: Array, axis: int) -> bool:
    return leaf.ndim >= -axis and leaf.shape[axis] > 1


def _along(axis: int, entries: slice) -> tuple[Any, ...]:
    """The index of some entries of an axis, which is negative."""
    return (..., entries, *[slice(None)] * (-1 - axis))


def _in_long_steps(
    loop: PlantPoints,
    degree: int,
    steps: int,
    guessed: Callable[[list[Column]], tuple[Array, Array]],
) -> Complex:
    """Guess t from about the same loop in ``steps`` long steps of delay.

    A long step w of h samples is to z as the bilinear map has it, (w - 1)/(w + 1) = h (z - 1)/(z +
    1), so that w is on the unit circle where z is. With z^(n-2) = w^steps, p(z) is a polynomial of
    degree steps + 2. Of N what is linear in t is kept: it has all of N's delay.
    """
    length = (degree - 2.0) / steps
    scale, pole = 2.0 / (length - 1.0), (length + 1.0) / (length - 1.0)  # t = s (w - 1)/(w + pole)
    linear, constant = loop.denominator
    *_, slope, value = loop.numerator
    high = scale * (scale + linear) + constant
    middle = scale * (linear * (pole - 1.0) - 2.0 * scale) + 2.0 * pole * constant
    low = scale * (scale - linear * pole) + pole * pole * constant
    moved = scale * (loop.alpha + loop.beta)
    n1, n0 = value + scale * slope, pole * value - scale * slope
    wall1, wall0 = loop.alpha + moved, pole * loop.alpha - moved
    ends = [n0 * wall0, n0 * wall1 + n1 * wall0, n1 * wall1, low, middle]
    ends = [column * (1.0 / high) for column in ends]
    w = Complex(*guessed([*ends[:3], *[None] * (steps - 3), *ends[3:]]))  # less 1
    return (w * scale).over(w + (1.0 + pole))


def newton(t: Complex, loop: PlantPoints, degree: int) -> Complex:
    """Return t after a step of Newton's method towards a root of p(1 + t)."""
    value, slope = evaluated(t, loop, degree)
    inverse = reciprocal(slope.squared_modulus())  # ``over`` would take XLA minutes to compile
    return t + value * Complex(slope.re, -slope.im) * -inverse


def evaluated(t: Complex, loop: PlantPoints, degree: int) -> tuple[Complex, Complex]:
    """Return p and its derivative at z = 1 + t."""
    gains = loop.alpha, loop.beta
    return _evaluated(t, t + 1.0, gains, loop.numerator, loop.denominator, degree)


def _evaluated(
    t: Value,
    z: Value,
    gains: tuple[Array, Array],
    numerator: tuple[Array, ...],
    denominator: tuple[Array, Array],
    degree: int,
) -> tuple[Value, Value]:
    """Return the same of complex t and z, or its terms' sizes from those of all that is given."""
    (alpha, beta), (linear, constant) = gains, denominator
    own, wall = (t + linear) * t + constant, z * alpha + t * beta
    first, *inner, last = numerator
    n, n_slope = t * first + last, first
    if inner:
        n, n_slope = (t * first + inner[0]) * t + last, t * (2.0 * first) + inner[0]
    delayed, slope = z * own, own * (degree - 2.0) + z * (t * 2.0 + linear)
    if degree > 3:
        below = z ** (degree - 3)
        delayed, slope = below * delayed, below * slope
    return delayed + n * wall, slope + n * (alpha + beta) + wall * n_slope


_SLACK = 1.0 + 1e-6  # the bounds themselves are rounded


@compiled(static=["degree", "corrections", "shared"], many=0, wide=True)
def polished(
    root: Array, loop: PlantPoints, *, degree: int, corrections: int, shared: int | None = None
) -> Array:
    """Correct roots t by Newton's method, by XLA; ``with_distance`` of them in a complex array.

    Neighbours in an axis that is ``shared`` start between the roots ``at_nodes``.
    """
    from jax import lax

    def kernel(root: Array, loop: PlantPoints) -> Array:
        before = t = Complex(root.real, root.imag)
        for _ in range(corrections):
            before, t = t, newton(t, loop, degree)
        return lax.complex(*with_distance(t, loop, degree, before))

    if shared is not None:
        xp = namespace(loop)
        shape = xp.broadcast_shapes(*map(xp.shape, leaves(loop)))
        loop = tree_map(partial(_in_blocks, axis=shared), loop)
        return kernel(lax.complex(*_interpolated(root, shared)), loop).reshape(shape)
    return kernel(root, loop) if degree <= HIGHEST_COUNTED else over_tiles(kernel, (root, loop))


@compiled(static=["degree", "shared"], many=0, wide=True)
def at_nodes(root: Array, loop: PlantPoints, *, degree: int, shared: int) -> Array:
    """Follow the root t of each block of neighbours to its nodes, by Newton's method.

    The nodes of a block take the place of its neighbours in the axis that is ``shared``.
    """
    to_nodes = 2  # steps of Newton's method from the guess
    from jax import lax

    def nodes(leaf: Array) -> Array:
        blocks = _in_blocks(leaf, shared)
        if not _has_axis(blocks, shared):
            return blocks
        return xp.concatenate([blocks[_node(node, shared)] for node in _NODES], shared)

    xp = namespace(root)
    root = xp.expand_dims(root, shared)
    loop, t = tree_map(nodes, loop), Complex(root.real, root.imag)
    for _ in range(to_nodes):
        t = newton(t, loop, degree)
    return lax.complex(t.re, t.im)


def _interpolated(root: Array, axis: int) -> tuple[Array, Array]:
    """Return t of all neighbours on the curve through those at the nodes, by Lagrange's formula."""
    place = np.arange(float(NEIGHBOURS)).reshape(-1, *[1] * (-1 - axis))
    parts = [0.0, 0.0]  # XLA multiplies real numbers with each part, not with both as one
    for index, node in enumerate(_NODES):
        weight = prod((place - other) / (node - other) for other in _NODES if other != node)
        t = root[_node(index, axis)]
        parts = [before + weight * x for before, x in zip(parts, (t.real, t.imag), strict=True)]
    return parts[0], parts[1]


def _node(index: int, axis: int) -> tuple[Any, ...]:
    return _along(axis, slice(index, index + 1))


def _in_blocks(leaf: Array, axis: int) -> Array:
    """Return an array of an axis more: blocks of neighbours, and the neighbours in a block."""
    if leaf.ndim < -axis:
        return leaf
    before, after = leaf.shape[:axis], leaf.shape[leaf.ndim + axis + 1 :]
    return leaf.reshape(*before, -1, min(leaf.shape[axis], NEIGHBOURS), *after)


def with_distance(
    t: Complex, loop: PlantPoints, degree: int, before: Complex | None = None
) -> tuple[Array, Array]:
    """Return |1 + t|, to 3 ulp, and a bound of what it may differ by from the spectral radius.

    The circle of the proof is inside of 1 + ``before``, a point next to 1 + t: a processor counts
    the zeros outside of it while it still computes t.
    """
    of_short, of_long = 2.0**-25, 2.0**-20  # how far inside of the root the circle is, relative
    near = 2.0**-17  # longest last step of Newton's method, relative
    xp = namespace(t, loop)
    own = _moduli(t)
    last = own if before is None else _moduli(before)
    distance, rounding = _distance_to_root(t, own.size, own.radius, loop, degree)
    # The counts of long polynomials have fewer digits.
    beside = of_short if degree <= HIGHEST_COUNTED else of_long
    shortest = xp.minimum(last.size, last.radius)
    within = last.beyond - beside * shortest
    is_real = t.im == 0.0
    is_proved = (
        zeros_outside(*_circle(within, rounding, loop, degree), UNIT, degree) == 2.0 - is_real
    )
    step = (t + last.t * -1.0).squared_modulus()
    # How far the circle is inside of |1 + t| is known to 64 ulp of the root's size.
    apart = xp.minimum(
        own.beyond - within - 64.0 * UNIT * own.size, xp.where(is_real, xp.inf, t.im)
    )
    is_proved = is_proved & (distance < apart) & (step <= (near * shortest) ** 2)
    # All other roots are at least as far from z, so that p'/p has one large term (lemma R1).
    distance = _SLACK * distance / (degree - (degree - 1.0) * (distance / apart))
    return own.radius, xp.where(is_proved, distance + 4.0 * UNIT * own.radius, xp.inf)


class _Moduli(NamedTuple):
    t: Complex
    size: Array  # |t|
    radius: Array  # |1 + t|
    beyond: Array  # |1 + t| - 1


def _moduli(t: Complex) -> _Moduli:
    xp, squared = namespace(t), t.squared_modulus()
    radius = xp.sqrt((t + 1.0).squared_modulus())
    return _Moduli(t, xp.sqrt(squared), radius, (2.0 * t.re + squared) / (radius + 1.0))


def _distance_to_root(
    t: Complex, size: Array, radius: Array, loop: PlantPoints, degree: int
) -> tuple[Array, Array]:
    """Return n |p/p'|, raised by what rounding may have changed; and that of p."""
    lost_in_squares = 1e-150  # moduli below are flushed to zero
    # Each product of complex numbers errs by at most 3 ulp, z^(n-2) therefore by 4 (n - 2), and
    # what it is multiplied with and added to by less than 30 ulp of the same terms taken without
    # their signs.
    xp = namespace(t, loop)
    value, slope = evaluated(t, loop, degree)
    plant_error = loop.plant.error / UNIT
    linear, constant = loop.denominator
    numerator = tuple(abs(c) + plant_error * loop.plant.size for c in loop.numerator)
    gains, denominator = (abs(loop.alpha), abs(loop.beta)), (linear + plant_error, constant)
    terms, slope_terms = _evaluated(size, radius, gains, numerator, denominator, degree)
    unit = (4.0 * (degree - 2) + 30.0) * UNIT
    rounding = unit * terms + lost_in_squares
    value_size = xp.sqrt(value.squared_modulus()) + rounding
    slope_size = xp.sqrt(slope.squared_modulus()) - unit * slope_terms
    distance = (_SLACK * degree) * value_size / slope_size
    is_bounded = (slope_size > 0.0) & (slope_size < xp.inf)  # its square may overflow
    return xp.where(is_bounded, distance, xp.inf), rounding


def _circle(t: Array, rounding: Array, loop: PlantPoints, degree: int) -> tuple[Chain, Ends]:
    """Return p(r z) / r^n with r = 1 + t, real: its coefficients, and its values at 1 and -1.

    ``rounding`` is that of p at a point about as far from 1 as r, and from 0, or farther.
    """
    # r and its inverse are right to 2 ulp, powers of the inverse to 3 ulp for each factor.
    xp, plant, radius = namespace(t, loop), loop.plant, 1.0 + t
    inverse = 1.0 / radius
    squared = inverse * inverse
    powers = [inverse ** (degree + 1 - len(plant.stiff))]
    for _ in plant.stiff[1:]:
        powers.append(powers[-1] * inverse)
    walls = (s * loop.alpha - d * loop.beta for s, d in zip(plant.stiff, plant.damp, strict=True))
    tail = tuple(wall * power for wall, power in zip(walls, powers[::-1], strict=True))
    moved = t * (2.0 + t)
    head = plant.d1 * inverse, plant.d0 * squared
    sizes = size_sum(head), size_sum(tail)
    head_error = 20.0 * UNIT * sizes[0] + 4.0 * plant.error * xp.maximum(inverse, squared)
    gap_error = (12.0 * UNIT * (abs(plant.gap) + abs(moved)) + plant.error) * squared
    wall_error = tail_error(loop.alpha, loop.beta, plant) * xp.maximum(powers[0], powers[-1])
    error = gap_error + wall_error + (3.0 * degree + 8.0) * UNIT * sizes[1] + UNDERFLOW

    linear, constant = loop.denominator
    numerator = reduce(lambda before, coefficient: before * t + coefficient, loop.numerator)
    below = powers[len(powers) - 3]  # r^(2-n)
    wall = numerator * (loop.alpha * radius + loop.beta * t)
    signs = [(-1.0) ** (degree + power) for power in range(len(tail))]
    turned = reduce(add, (sign * value for sign, value in zip(signs, tail, strict=True)))
    return Chain((plant.gap + moved) * squared, head, tail, head_error, error), Ends(
        at_one=(t + linear) * t + constant + wall * below,
        at_one_error=SAFETY * rounding * below,
        at_minus_one=1.0 - head[0] + head[1] + turned,
        at_minus_one_error=error + head_error + 8.0 * UNIT * (1.0 + sum(sizes)),
    )


# Each point is proved independently of the others. Where the first try is not proved to
# ``TOLERANCE``, mostly because two roots have nearly the same modulus, the next one squares the
# power of z more often. The few points that are then still open have multiple or nearly equal
# dominant roots.

LONGEST_DELAY = 64.0  # beyond, polynomials of many points do not stay in the cache
TOLERANCE = 1e-12
_LIST = 2**18  # up to this many points, lists are filled up to a length compiled once for all
_BLOCK = 2**18  # points of a larger grid that a core computes at once
_STEADY = 512  # points of an axis that differ by little from their neighbours

Indices = Int64[np.ndarray, " point"]
Answer = tuple[Array, Array]  # value and error
Columns = Sequence[Any]  # alpha, beta, gamma, and delta or, computed once for all, the plant


def fast_radius(
    parameters: list[Array], shape: tuple[int, ...], delay: float
) -> tuple[Array, Array, Indices]:
    """Value and error of the spectral radius, by XLA, and the flat indices of points still open.

    There the error is more than TOLERANCE, and infinite if nothing is proved. ``parameters`` are
    alpha, beta, gamma, delta, checked; the delay is at most LONGEST_DELAY. JAX arrays stay on their
    device; the host sees only the indices.
    """
    first, *others = _tries(delay)
    given = _shared_loop(parameters, delay) or parameters
    if not is_any_jax(parameters) and prod(shape) <= _LIST:
        value, error, still_open = np.empty(shape), np.empty(shape), np.arange(prod(shape))
        others = [first, *others]
    else:
        if is_any_jax(parameters):
            answer = _tried(loop_of(given, delay), delay, first)
            value, error = (namespace(column).broadcast_to(column, shape) for column in answer)
        else:
            value, error = _on_grid(given, parameters, shape, delay, first)
        still_open = np.flatnonzero(~np.asarray(error <= TOLERANCE))
    for effort in others:
        if not still_open.size:
            break
        tried = _try_list(given, shape, still_open, delay, effort)
        value, error = (
            with_values(old, still_open, new)
            for old, new in zip((value, error), tried, strict=True)
        )
        still_open = still_open[~(np.asarray(tried[1]) <= TOLERANCE)]
    return value, error, still_open


def _shared_loop(parameters: list[Array], delay: float) -> PlantPoints | None:
    plants = prod(np.broadcast_shapes(*(hand.shape for hand in parameters[2:])))
    return loop_of(parameters, delay) if plants <= _LIST else None


def _on_grid(
    given: Columns, parameters: list[Array], shape: tuple[int, ...], delay: float, effort: Effort
) -> Answer:
    longest_shared = 8.0  # delay; beyond, guesses are little of the work
    shared = _steady_axis(parameters, shape) if delay <= longest_shared else None

    def of_piece(*piece: Any) -> Answer:
        return _tried(loop_of(piece, delay), delay, effort, shared)

    return in_pieces(of_piece, tuple(given), ceil(prod(shape) / _BLOCK))


def _try_list(
    given: Columns, shape: tuple[int, ...], indices: Indices, delay: float, effort: Effort
) -> Answer:
    shortest_list = 8
    longest, shortest = effort.longest_list, shortest_list
    if is_any_jax(given):  # an accelerator computes a long list as quickly as a short one
        longest = shortest = longest if is_on_cpu() else _LIST
    columns: list[Answer] = []
    for part, padded in lists(indices, longest, shortest):
        listed = loop_of(looked_up(given, shape, padded), delay)
        columns.append(take(_tried(listed, delay, effort), slice(part.size)))
    return joined(columns)


def loop_of(given: Columns, delay: Array | float) -> PlantPoints:
    """Loops of one form of p(z), of the plants that are given in place of delta, or of theirs."""
    alpha, beta, gamma, delta = given
    if isinstance(delta, Plant):
        return PlantPoints(alpha, beta, gamma, delta)
    fraction = np.asarray(delay) % 1.0
    plant = float_plant(gamma, delta, fraction, is_fractional=bool(np.any(fraction > 0.0)))
    return PlantPoints(alpha, beta, gamma, plant)


def _steady_axis(parameters: list[Array], shape: tuple[int, ...]) -> int | None:
    """Return an axis of a grid, not the last one, along which neighbours differ by little."""
    for axis in range(-len(shape), -1):
        moving = [values.ravel() for values in parameters if _has_axis(values, axis)]
        if shape[axis] >= _STEADY and all(
            values.size == shape[axis] and _is_steady(values) for values in moving
        ):
            return axis
    return None


def _is_steady(values: np.ndarray) -> bool:
    uneven = 1 / 32  # largest change of such a step to the next, relative: roots are interpolated
    steps = np.diff(values)
    longest = np.abs(steps).max()
    is_even = np.abs(np.diff(steps)).max() <= uneven * longest
    return bool(longest < 1.5 / _STEADY * np.ptp(values) and is_even)


def _tried(loop: PlantPoints, delay: float, effort: Effort, shared: int | None = None) -> Answer:
    """Return the answer of one try; where an axis may be ``shared``, with less work if it can."""
    degree = polynomial_degree(delay)

    def radius(loop: PlantPoints) -> Array:
        axis, own = None, effort
        shape = np.broadcast_shapes(*map(np.shape, leaves(loop)))
        if shared is not None and shape[shared] % NEIGHBOURS == 0:
            axis, own = shared, Effort(14, 2, _BLOCK)  # for a root that neighbours share
        root = dominant_root(loop, degree=degree, effort=own, shared=axis)
        if axis is not None:
            root = at_nodes(root, loop, degree=degree, shared=axis)
        return polished(root, loop, degree=degree, corrections=own.corrections, shared=axis)

    is_smooth = shared is not None
    answer = radius(loop) if is_any_jax(loop) else filled_up(radius, loop, is_smooth=is_smooth)
    return answer.real, answer.imag


def _tries(delay: float) -> tuple[Effort, ...]:
    if delay <= 8.0:
        return Effort(10, 1, 2**15), Effort(20, 10, 2**13)
    last = Effort(14, 8, 2**10)
    return Effort(9, 6, 2**15, 4 if delay <= 21.0 else 6), Effort(10, 8, 2**12, 16), last
