"""Verdicts of many walls: STABLE and UNSTABLE are proofs, rounding included.

A verdict takes up to three steps, each for the points that the one before leaves UNDECIDED:

1. The Schur-Cohn recursion in float64 with a running bound of its rounding errors
   (``schur_cohn``; lemmas V2 to V4, and V10 for loops with filters and devices). It
   decides all but points next to the boundary.
2. The same recursion in pairs of float64, with 106 bits.
3. On request (``resolve="exact"``), the same recursion in balls (``exact.roots``, lemma E1), one
   point at a time.

The loop of the paper has few coefficients, whatever the delay, so a step costs a constant number of
operations; other loops take steps over all of their coefficients. Plants are computed once for each
(gamma, delta, delay), in double-double (lemma V7), and gathered for the points of the grid, each
at the degree that its delay gives. NumPy and XLA run the same kernels (``batches``).
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int8, Int64

from jaxstab import exact
from jaxstab.arrays import (
    Array,
    Numbers,
    bits,
    is_any_traced,
    is_jax,
    is_traced,
    named,
    namespace,
    remembered,
    tree_map,
)
from jaxstab.batches import MANY, TILE, compiled, lists, over_tiles, pays
from jaxstab.conventions import Verdict
from jaxstab.exact import wall_verdict
from jaxstab.model import (
    DoubleDouble,
    PlantCoefficients,
    TracedDelay,
    checked_delta,
    checked_gain,
    checked_gamma,
    plant_pairs,
)
from jaxstab.model.balls import ball_triple
from jaxstab.model.double_double import size_sum
from jaxstab.model.filters import NO_FILTERS, Filter, Filters, Velocity, as_keywords, given_filters
from jaxstab.model.linear_loop import LinearLoop, filtered_loop
from jaxstab.model.loop import unit_loop
from jaxstab.model.plant import bounded_delay, may_cancel, pairs_error, whole_and_fraction
from jaxstab.numbers import require_together
from jaxstab.point.poles import looked_up
from jaxstab.point.schur_cohn import (
    UNDERFLOW,
    Chain,
    Ends,
    decide,
    dense_codes,
    rounded_loop,
    without_zeros,
)
from jaxstab.rounding import PAIR_UNIT, UNIT

Values = np.ndarray[Any, np.dtype[Any]]


class Form(NamedTuple):
    """The form of p(z); a whole delay that JAX traces is at most ``longest``."""

    whole_delay: int | Array
    is_fractional: bool
    longest: int | None = None

    @classmethod
    def from_delay(cls, delay: Numbers | TracedDelay) -> "Form":
        """Return the form for one delay in samples; a fraction that is traced may be any."""
        if isinstance(delay, TracedDelay):
            return cls(delay.whole, True, delay.longest if is_jax(delay.whole) else None)
        samples = np.asarray(delay, np.float64).item()
        return cls(int(samples), samples % 1.0 > 0.0)

    @property
    def degree(self) -> int | Array:
        """The degree of p(z) without filters and roots at 0."""
        return self.whole_delay + 3 + self.is_fractional


class Points(NamedTuple):
    """The five parameters of a grid, as they were given: they broadcast."""

    alpha: Values
    beta: Values
    gamma: Values
    delta: Values
    delay: Values

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape to which they broadcast."""
        return np.broadcast_shapes(*(values.shape for values in self))

    def groups(
        self, chosen: Bool[np.ndarray, "*grid"]
    ) -> list[tuple[Form, Int64[np.ndarray, " point"]]]:
        """Return the form of p(z) and the flat indices of each group of chosen points."""
        twice = np.broadcast_to(np.floor(self.delay) + np.ceil(self.delay), chosen.shape)
        return [
            (Form.from_delay(doubled / 2.0), np.flatnonzero(chosen & (twice == doubled)))
            for doubled in np.unique(twice[chosen]).tolist()
        ]


# Verdicts of any linear loop: of any device, velocity estimator and position filter.

_TILE = 512  # points whose polynomials stay in the cache


def linear_verdict(alpha: Array, beta: Array, loop: LinearLoop) -> Int8[Array, "*grid"]:
    """The codes of walls of one loop: float64 before pairs, or float64 alone if JAX traces them."""
    loop_pairs = 1 << 11  # points at once in double-double
    degree, loop = loop.degree, without_zeros(loop)
    if is_any_traced(alpha, beta, loop):
        return _loop_float_codes(alpha, beta, rounded_loop(loop), degree=degree)
    xp = namespace(alpha, beta, loop)
    if xp is not np:
        alpha, beta, loop = tree_map(np.asarray, (alpha, beta, loop))
    codes = np.array(_loop_float_codes(alpha, beta, rounded_loop(loop), degree=degree))
    still_open = np.flatnonzero(codes == Verdict.UNDECIDED)
    for start in range(0, still_open.size, loop_pairs):
        block = still_open[start : start + loop_pairs]
        *gains, chosen = looked_up((alpha, beta, loop), codes.shape, block)
        pairs = DoubleDouble.from_value(gains[0]), DoubleDouble.from_value(gains[1])
        with np.errstate(all="ignore"):
            codes.flat[block] = dense_codes(*pairs, chosen, unit=PAIR_UNIT, degree=degree)
    drifts = (alpha == 0.0) & loop.is_free  # p(1) is 0 exactly
    codes[np.broadcast_to(drifts, codes.shape)] = Verdict.UNSTABLE
    return xp.asarray(codes)


def _resolved(
    codes: Int8[np.ndarray, "*grid"], points: Points, filters: Filters
) -> Int8[np.ndarray, "*grid"]:
    """Answer UNDECIDED points of one mass, in pairs, too; each delay has its own degree of p."""
    for form, indices in points.groups(np.asarray(codes == Verdict.UNDECIDED)):
        walls = points.alpha, points.beta, filtered_loops(points, form, filters)
        if indices.size == codes.size:  # a grid of one delay is not taken apart
            codes[...] = linear_verdict(*walls)
        else:
            codes.flat[indices] = linear_verdict(*looked_up(walls, points.shape, indices))
    if filters[1] == Filter():  # p(1) is alpha + gamma, times what is positive
        codes[np.broadcast_to(points.alpha == -points.gamma, codes.shape)] = Verdict.UNSTABLE
    return codes


def filtered_loops(points: Points, form: Form, filters: Filters) -> LinearLoop:
    """Return loops on the smallest grid that holds them."""
    fraction: Any = points.delay % 1.0 if form.is_fractional else 0.0
    if form.is_fractional:  # delays of the other form get a number that is never read
        fraction = np.where(fraction == 0.0, 0.5, fraction)
    return filtered_loop(points.gamma, points.delta, form.whole_delay, fraction, filters)


@compiled(static=["degree"], many=MANY, wide=True, pointwise=True)
def _loop_float_codes(alpha: Array, beta: Array, loop: LinearLoop, *, degree: int) -> Array:
    loop = tree_map(namespace(alpha, beta, loop).asarray, loop)
    codes = partial(dense_codes, unit=UNIT, degree=degree)
    return over_tiles(codes, (alpha, beta, loop), _TILE)


# The p(z) of eq. (9) in the form of the recursion, and the rounding errors of forming it.

HIGHEST_SHORT = 12  # degree up to which nothing but the end of the recursion is needed


class Plant(NamedTuple):
    """A sampled plant, with N(z) ((alpha + beta) z - beta) = stiff(z) alpha - damp(z) beta.

    In float64 or, but for the last three, in pairs.
    """

    gap: Array  # 1 - d0
    d1: Array
    d0: Array
    stiff: tuple[Array, ...]  # lowest power of z first
    damp: tuple[Array, ...]
    difference: Array  # N(-1)
    at_minus_one: Array  # D(-1)
    error: Array  # of the numbers above, relative to 1, or to the size of N
    size: Array  # of N
    sum: Array  # N(1)


@remembered
def float_plant(gamma: Array, delta: Array, fraction: Array, *, is_fractional: bool) -> Plant:
    """The plant rounded to float64; without a fraction, ``fraction`` is not read."""
    # Not in one jit: plant_pairs takes long to compile, and others share what was compiled.
    pairs = plant_pairs(gamma, delta, fraction if is_fractional else 0.0)
    return _rounded_plant(gamma, delta, pairs, is_fractional=is_fractional)


@compiled(static=["is_fractional"])
def _rounded_plant(
    gamma: Array, delta: Array, pairs: PlantCoefficients, *, is_fractional: bool
) -> Plant:
    return rounded_loop(_plant_of(gamma, delta, pairs, is_fractional=is_fractional))


def _plant_of(
    gamma: Array, delta: Array, pairs: PlantCoefficients, *, is_fractional: bool
) -> Plant:
    xp = namespace(gamma, delta, pairs)
    unit = DoubleDouble.from_value(xp.ones_like(pairs.d0.hi))
    zero = unit - unit
    stiff = (zero, pairs.n0, pairs.n1, pairs.n2)
    # (1 - z) N(z): n2 - n1 vanishes with delta for a whole delay, and N(-1) has all of its digits.
    damp = (pairs.n0, pairs.n1 - pairs.n0, pairs.difference - pairs.n0, -pairs.n2)
    sum_n = sum(abs(n.hi) for n in stiff[1:])
    return Plant(
        gap=unit - pairs.d0,
        d1=pairs.d1,
        d0=pairs.d0,
        stiff=stiff if is_fractional else stiff[1:],
        damp=damp if is_fractional else damp[1:],
        difference=pairs.difference,
        at_minus_one=unit - pairs.d1 + pairs.d0,
        error=pairs_error(gamma, delta),
        size=xp.where(may_cancel(gamma, delta), xp.sqrt(sum_n), sum_n),
        sum=pairs.sum.hi,
    )


def is_plant_lost(gamma: Array, delta: Array) -> Array:
    """Return True where N(z) nearly vanishes, so that an ulp of it cannot be relied on."""
    lost = 2.0**-25  # of N(1): the error of a stiff plant times its root is an ulp there
    xp = namespace(gamma, delta)
    rate = xp.sqrt(xp.maximum(gamma - 0.25 * delta**2, 0.0))
    half = xp.expm1(-0.5 * delta)
    gamma_sum = half**2 + 4.0 * (1.0 + half) * xp.sin(0.5 * rate) ** 2  # gamma N(1)
    return may_cancel(gamma, delta) & (gamma_sum < lost * gamma)


def loop_codes(
    alpha: Array,
    beta: Array,
    gamma: Array,
    plant: Plant,
    *,
    degree: int | Array,
    highest: int | None = None,
) -> Array:
    """The code of each point; see ``decide`` for degrees that differ."""
    chain = _closed_loop(alpha, beta, plant)
    ends = _ends(alpha, beta, gamma, plant, degree)
    # A coefficient of a stable polynomial is at most binomial(n, i). Numbers stay finite so.
    large = size_sum(chain.tail) - chain.error > 8.0 * 2.0**degree
    if not isinstance(degree, int) or degree > HIGHEST_SHORT:
        chain = replace(chain, outside=False)  # a short recursion decides without it
    codes = decide(chain, ends, UNIT, degree, highest)
    return namespace(large, codes).where(large, Verdict.UNSTABLE, codes).astype(np.int8)


def _closed_loop(alpha: Array, beta: Array, plant: Plant) -> Chain:
    tail = tuple(
        stiff * alpha - damp * beta for stiff, damp in zip(plant.stiff, plant.damp, strict=True)
    )
    error = UNIT * abs(plant.gap) + plant.error + UNDERFLOW
    return Chain(
        gap=plant.gap,
        head=(plant.d1, plant.d0),
        tail=tail,
        head_error=UNIT * (abs(plant.d1) + 2.0 * abs(plant.d0)) + 4.0 * plant.error,
        error=error + tail_error(alpha, beta, plant),
    )


def tail_error(alpha: Array, beta: Array, plant: Plant) -> Array:
    """The sum of the rounding errors of the last coefficients of p(z)."""
    # Three roundings: of the plant's coefficient, of the product, of the difference.
    per_alpha = 3.0 * UNIT * size_sum(plant.stiff) + 4.0 * plant.error * plant.size
    per_beta = 3.0 * UNIT * size_sum(plant.damp) + 8.0 * plant.error * plant.size
    return per_alpha * abs(alpha) + per_beta * abs(beta)


def _ends(alpha: Array, beta: Array, gamma: Array, plant: Plant, degree: int | Array) -> Ends:
    """(gamma + alpha) N(1) and D(-1) - (-1)^floor(delay) N(-1) (alpha + 2 beta)."""
    whole_delay = degree - len(plant.stiff)
    gain = (alpha + (beta + beta)) * (1.0 - 2.0 * (whole_delay % 2))
    wall = plant.difference * gain
    error = UNIT * (2.0 * abs(plant.at_minus_one) + 5.0 * abs(wall))
    error = error + plant.error * (8.0 + plant.size * abs(gain)) + UNDERFLOW
    return Ends(alpha + gamma, _sum_error(alpha, gamma), plant.at_minus_one - wall, error)


def _sum_error(alpha: Array, gamma: Array) -> Array | float:
    """0 where the sign of alpha + gamma is that of p(1): N(1) > 0, and of two the sum is exact."""
    xp = namespace(alpha, gamma)
    if xp is np:
        return 0.0
    # XLA takes the tiniest numbers for 0, which their bits tell, and 0 itself is exact.
    most, least = np.iinfo(np.int64).max, bits(np.array(UNDERFLOW)).astype(np.uint64)
    tiny = [((bits(x) & most) - 1).astype(np.uint64) < least for x in (alpha, gamma)]
    return xp.where(tiny[0] | tiny[1], UNDERFLOW, 0.0)


# The verdict of the five numbers: points of a grid go to the kernels by their delays.

_LIST = 1 << 16  # points of one list that is gathered from a grid
_IN_ROWS = 1 << 21  # points of a dense slice from which on rows pay


def verdict(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    longest_delay: int | float | None = None,
    resolve: str | None = None,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Verdict | Int8[Array, "*grid"]:
    """Prove for every point whether all roots of p(z) lie inside the unit circle.

    STABLE and UNSTABLE are proofs: the rounding of plant, coefficients and recursion is bounded.
    Points too close to the boundary are UNDECIDED, also those exactly on it. UNSTABLE means at
    least one root outside or on the circle: a root at z = 1, at alpha = -gamma exactly, is one.

    Args:
        alpha, beta, gamma, delta, delay, longest_delay: see ``jaxstab.conventions``.
        velocity, position: see ``jaxstab.conventions``.
        resolve: "exact" repeats the recursion where float64 leaves a point UNDECIDED, in
            double-double and then in balls of up to 3,072 bits, about a millisecond each; all
            arguments must be concrete, as for an array of delays. With an estimator or a filter
            double-double is always tried.

    Returns:
        int8 array of the broadcast shape: Verdict.STABLE, UNSTABLE or UNDECIDED; in JAX if an
        argument is. The int8 of one point prints its name. Plants are computed once for
        each (gamma, delta, delay): give grids as arrays that broadcast.

    Raises: see ``jaxstab.conventions``; ValueError also for an unknown ``resolve``.

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
    require_together(alpha=alpha, beta=beta, gamma=gamma, delta=delta, delay=delay)
    filters = given_filters(velocity, position)
    gains = checked_gain("alpha", alpha), checked_gain("beta", beta)
    point = (*gains, checked_gamma(gamma), checked_delta(delta))
    xp = namespace(point, delay)
    delay = bounded_delay(delay, longest_delay)
    whole, fraction = whole_and_fraction(delay)
    is_one_program = whole.size == 1 or is_traced(whole)
    if filters and is_one_program and is_any_traced(point, delay, filters):
        form = Form.from_delay(delay)
        late = fraction if form.is_fractional else 0.0
        own = form.whole_delay, late, filters, form.longest
        return linear_verdict(point[0], point[1], filtered_loop(point[2], point[3], *own))
    if not filters and resolve is None and (is_one_program or xp is not np):
        if not is_one_program:
            delay = TracedDelay(xp.asarray(whole), fraction, int(whole.max(initial=0.0)))
        # The plant of what JAX does not have is NumPy's: it takes longest to compile.
        form = Form.from_delay(delay)
        plant = float_plant(*point[2:], fraction, is_fractional=form.is_fractional)

        def codes_of(*gains: Numbers) -> Array:
            return _float_codes((*gains, point[2], plant), form)

        is_dense = xp is np and np.size(point[0]) * np.size(point[1]) >= _IN_ROWS
        codes = exact.row_codes((*point, delay), codes_of) if is_dense else None
        if codes is not None:
            return codes
        codes = codes_of(*point[:2])
        shape = np.broadcast_shapes(whole.shape, *map(np.shape, point))
        return named(xp.array(xp.broadcast_to(codes, shape)), Verdict)
    if is_any_traced(point, delay, filters):
        raise TypeError("verdict takes traced arguments with one delay and without resolve only.")
    points = Points(*(np.asarray(value, np.float64) for value in (*point, delay)))
    codes = np.full(points.shape, Verdict.UNDECIDED, np.int8)
    codes = codes if filters else _grouped_verdict(points)
    if filters or resolve:
        codes = _resolved(codes, points, filters or NO_FILTERS)
    if resolve:
        codes = _decided(codes, points, filters)
    return named(xp.asarray(codes), Verdict)


def _float_codes(arguments: tuple[Any, ...], form: Form) -> Array:
    """Return the codes of points by the kernel of their form."""
    # A loop writes all of its state to memory in each step. Without it a point takes a half to a
    # third of the time at delays of 10 and 20, but each degree compiles for a second or two.
    highest_unrolled = 26  # degree up to which XLA compiles the recursion without a loop
    highest_untiled = 4  # degree up to which a point's numbers stay in registers
    degree = form.degree
    if form.longest is not None:
        return _mixed_codes(arguments, degree, longest=form.longest)
    if degree <= highest_untiled:
        return _untiled_codes(arguments, degree=degree)
    if degree <= highest_unrolled:
        return _short_codes(arguments, degree=degree)
    return _long_codes(arguments, degree)


@compiled(static=["longest"], many=0, wide=True, pointwise=True)
def _mixed_codes(arguments: tuple[Any, ...], degree: Array, *, longest: int) -> Array:
    def codes(degree: Array, *own: Any) -> Array:
        return loop_codes(*own, degree=degree, highest=4 + longest)

    return over_tiles(codes, (degree, *arguments))


@compiled(static=["degree"], many=MANY, wide=True, pointwise=True, parallel=True)
def _untiled_codes(arguments: tuple[Any, ...], *, degree: int) -> Array:
    return loop_codes(*arguments, degree=degree)


@compiled(static=["degree"], many=MANY, wide=True, pointwise=True)
def _short_codes(arguments: tuple[Any, ...], *, degree: int) -> Array:
    codes = partial(loop_codes, degree=degree)
    return over_tiles(codes, arguments, TILE if degree <= HIGHEST_SHORT else _TILE)


@compiled(many=MANY, wide=True, pointwise=True)
def _long_codes(arguments: tuple[Any, ...], degree: int | Array) -> Array:
    return over_tiles(partial(loop_codes, degree=degree), arguments)


def _grouped_verdict(points: Points) -> Int8[np.ndarray, "*grid"]:
    """Return the codes of several delays: form by form in NumPy, or by one program for all."""
    codes, everywhere = np.zeros(points.shape, np.int8), np.full(points.shape, True)
    longest = int(np.max(points.delay, initial=0.0))
    is_mixed = pays((_mixed_codes, longest), codes.size, MANY)
    whole = np.floor(points.delay)
    forms = [(Form(whole, True, longest), np.flatnonzero(everywhere))]
    for form, indices in forms if is_mixed else points.groups(everywhere):
        # Plants on the smallest grid that holds them, then gathered like the points.
        plants = float_plant(
            points.gamma, points.delta, points.delay % 1.0, is_fractional=form.is_fractional
        )
        for block, padded in lists(indices, _LIST):
            own = padded if is_mixed else block
            *values, listed = looked_up((*points[:3], plants, whole), points.shape, own)
            if is_mixed:
                found = _float_codes(tuple(values), form._replace(whole_delay=listed))
            else:
                with np.errstate(all="ignore"):
                    found = loop_codes(*values, degree=form.degree)
            codes.flat[block] = found[: block.size]
    return codes


def _decided(
    codes: Int8[np.ndarray, "*grid"], points: Points, filters: Filters | None
) -> Int8[np.ndarray, "*grid"]:
    indices = np.flatnonzero(codes == Verdict.UNDECIDED)
    rows = np.stack(np.broadcast_arrays(*looked_up(points, points.shape, indices)), axis=-1)
    for index, (alpha, beta, *plant) in zip(indices, rows.tolist(), strict=True):
        loop = unit_loop(*plant, **as_keywords(filters))
        codes.flat[index] = wall_verdict(partial(ball_triple, loop), alpha, beta).verdict
    return codes
