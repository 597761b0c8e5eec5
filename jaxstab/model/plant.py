"""One mass by dimensionless numbers (Table I): their ranges, and what it does within a sample.

The zero-order-hold coefficients are accurate and smooth for every physical stiffness and damping.

With a = delta/2 and q = a^2 - gamma, everything the loop needs of the plant is made of the entire
functions kappa(x) = cosh sqrt(x) and sigma(x) = sinh(sqrt x) / sqrt(x) and of their divided
differences at the nodes a^2 and q, whose distance is gamma:

    D(z)    = z^2 - 2 e^-a kappa(q) z + e^-2a
    n1 + n0 = 2 e^-a kappa[a^2, q]              n1 - n0 = 2 a e^-a sigma[a^2, q]

so there is no 0/0 at critical damping or at gamma = 0, where eq. (9) has one, and no branch. The
functions come from a short Taylor series and the duplication formulas

    sigma(4x) = sigma(x) kappa(x)
    kappa(4x) = 1 + 2 x sigma(x)^2
    4 sigma[4x, 4y] = sigma[x, y] kappa(x) + sigma(y) kappa[x, y]
    2 kappa[4x, 4y] = sigma(y)^2 + x (sigma(x) + sigma(y)) sigma[x, y]

in double-double arithmetic. For x >= 0 the divided differences are sums of positive terms, so they
keep their relative accuracy even at gamma = (2 pi)^2, delta = 0, where N(z) vanishes.
"""

from fractions import Fraction
from functools import cache, partial
from math import factorial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import (
    Array,
    Numbers,
    constant,
    filled,
    float_arrays,
    is_any_traced,
    is_traced,
    namespace,
    remembered,
    repeat,
    take,
    tree_map,
)
from jaxstab.batches import MANY_PLANTS, compiled
from jaxstab.conventions import AXES
from jaxstab.model.double_double import DoubleDouble
from jaxstab.numbers import checked, checked_number, in_doubles, require_together
from jaxstab.numbers import require_x64 as require_x64  # offered here, too
from jaxstab.rounding import DAMPED_PLANT, SOFT_DELTA, SOFT_GAMMA, SOFT_PLANT, STIFF_PLANT

GAMMA_LIMIT = 1e4
DELTA_LIMIT = 1e3
GAIN_LIMIT = 1e150
LONGEST_DELAY = 500.0  # samples; with the longest filters p(z) is of a degree below 1024


class TracedDelay(NamedTuple):
    """A delay in samples whose fraction JAX traces, and of up to ``longest`` the whole part, too.

    A whole part that is known is its own ``longest``: p(z) has the degree 4 + longest, and for
    shorter delays it is multiplied by a power of z, which adds roots at 0.
    """

    whole: int | Array
    fraction: Array
    longest: int

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of delays."""
        return np.shape(self.fraction)


def by_name(*numbers: Any) -> dict[str, Any]:
    """Return the last of alpha, beta, gamma, delta and delay, given in this order, as keywords."""
    return dict(zip(AXES[-len(numbers) :], numbers, strict=True))


def checked_gain(name: str, value: Numbers) -> Numbers:
    """Return a wall gain alpha or beta; raise ValueError for a concrete one beyond +-1e150."""
    return checked(name, value, -GAIN_LIMIT, GAIN_LIMIT)


def wall_grid(**gains: Numbers) -> Float64[np.ndarray, "*grid 2"]:
    """Both gains of walls, by their names, on the grid to which they broadcast; never traced."""
    require_together(**gains)
    if is_any_traced(*gains.values()):
        names = " or ".join(gains)
        raise TypeError(f"{names} is traced; give concrete gains, outside of jit, vmap and grad.")
    values = (np.asarray(checked_gain(name, gain), np.float64) for name, gain in gains.items())
    return np.stack(np.broadcast_arrays(*values), axis=-1)


def checked_gamma(gamma: Numbers) -> Numbers:
    """Return gamma; raise ValueError for a concrete one outside [0, 1e4]."""
    return checked("gamma", gamma, 0.0, GAMMA_LIMIT)


def checked_delta(delta: Numbers) -> Numbers:
    """Return delta; raise ValueError for a concrete one outside [0, 1e3]."""
    return checked("delta", delta, 0.0, DELTA_LIMIT)


def checked_delay(delay: Numbers) -> Float64[np.ndarray, "*grid"]:
    """The delay in samples as a NumPy array, for it decides the degree of p(z); never traced."""
    if is_any_traced(delay):
        raise TypeError(
            "delay is traced, but sets the degree of p(z): give longest_delay, where the function "
            "has it, or close over the delay or mark it static."
        )
    return np.asarray(checked("delay", delay, 0.0, LONGEST_DELAY), np.float64)


def bounded_delay(delay: Numbers, longest_delay: int | float | None) -> Numbers | TracedDelay:
    """A delay that JAX traces up to a longest one, in parts; any other one, checked, as it is.

    Beyond the range the fraction is NaN, and with it all that follows. The whole part has no
    derivative: at whole delays the derivative is that to longer ones.
    """
    if longest_delay is None:
        return delay
    longest = float(checked_number("longest_delay", longest_delay, 0.0, LONGEST_DELAY))
    if not is_traced(delay):
        checked("delay", delay, 0.0, longest)
        return delay
    require_x64(delay)
    xp, own = namespace(delay), in_doubles(delay)
    is_within = (own >= 0.0) & (own <= longest)
    whole = constant(xp.where(is_within, xp.floor(own), 0.0))
    return TracedDelay(whole, xp.where(is_within, own - whole, xp.nan), int(longest))


def whole_and_fraction(delay: Numbers | TracedDelay) -> tuple[Float64[Array, "*grid"], Array]:
    """The whole part and the fraction of a delay in samples; errors as ``checked_delay``."""
    if isinstance(delay, TracedDelay):
        return delay.whole if is_traced(delay.whole) else np.asarray(
            delay.whole, float
        ), delay.fraction
    concrete = checked_delay(delay)
    whole = np.asarray(np.floor(concrete))
    return whole, concrete - whole


# The sampled plant.


class PlantCoefficients(NamedTuple):
    """The sampled plant: D(z) = z^2 + d1 z + d0 and N(z) = n2 z^2 + n1 z + n0, times m/T^2.

    For a whole delay N(z) is z times the zero-order-hold numerator, so n0 = 0. The remaining fields
    are N(1), N(-1) and D(1) = gamma N(1), each with its own relative accuracy. Arrays of the grid,
    or pairs of them for sums that may still cancel.

    Example:
        >>> plant = jaxstab.paper.plant_coefficients(gamma=0.0, delta=0.0)
        >>> float(plant.n1), float(plant.n0)
        (0.5, 0.0)
    """

    d1: Array
    d0: Array
    n2: Array
    n1: Array
    n0: Array
    sum: Array
    difference: Array
    den_at_one: Array


@remembered
def plant_pairs(gamma: Numbers, delta: Numbers, fraction: Numbers) -> PlantCoefficients:
    """The plant coefficients as double-double pairs, for sums that may still cancel.

    A concrete ``fraction`` (of the delay, in [0, 1)) that is zero throughout costs a third.
    """
    values = float_arrays(gamma, delta, fraction)
    xp = namespace(values)
    values = xp.broadcast_arrays(*values)
    whole = not is_traced(fraction) and not np.any(fraction)
    if xp is not np or values[0].size != 1:
        return _plant_pairs(*values, whole=whole)
    # Plain numbers are many times faster than arrays of one.
    pairs = _plant_pairs(*(each.item() for each in values), whole=whole)
    return tree_map(lambda number: np.full(values[0].shape, number), pairs)


def pairs_error(gamma: Numbers, delta: Numbers) -> Array:
    """A bound of the error of plant_pairs, in D and relative to the size of N (lemma V7)."""
    xp = namespace(gamma, delta)
    soft_error = xp.where(xp.asarray(gamma) <= SOFT_GAMMA, SOFT_PLANT, STIFF_PLANT)
    return xp.where(xp.asarray(delta) <= SOFT_DELTA, soft_error, DAMPED_PLANT)


def may_cancel(gamma: Numbers, delta: Numbers) -> Array:
    """Return True where N may nearly vanish: its size is the root of its coefficients' sum then."""
    # From the zeros of N at gamma = (2 pi k)^2 on the terms that cancel exceed the result.
    xp = namespace(gamma, delta)
    return (xp.asarray(gamma) > 36.0) & (xp.asarray(delta) <= SOFT_DELTA)


@compiled(static=["whole"], many=MANY_PLANTS, pointwise=True)
def _plant_pairs(gamma: Array, delta: Array, fraction: Array, *, whole: bool) -> PlantCoefficients:
    xp = namespace(gamma, delta, fraction)
    full = DoubleDouble.from_value(filled(fraction, 1.0))
    if whole:
        step = _hold(gamma, delta, full)
        n2, n0 = step.response(), DoubleDouble.from_value(filled(fraction, 0.0))
    else:
        lengths = full, full - fraction, DoubleDouble.from_value(fraction)
        if type(fraction) is float:
            step, after, before = (_hold(gamma, delta, length) for length in lengths)
        else:  # one batch: three times less to compile
            holds = _hold(gamma, delta, tree_map(lambda *t: xp.stack(t), *lengths))
            step, after, before = (take(holds, k) for k in range(3))
        n2, n0 = after.response(), after.decay * after.decay * before.reversed_response()
    d1 = (step.decay * step.kappa).scaled(-2.0)
    d0 = step.decay * step.decay
    total = (step.decay * step.even).scaled(2.0)
    odd = (step.decay * step.odd).scaled(2.0)
    at_minus_one = (n2 + n0).scaled(2.0) - total
    if is_traced(fraction):  # the sum knows how it changes with the fraction
        odd = constant(odd) + (at_minus_one.hi - constant(at_minus_one.hi))
    difference = tree_map(partial(xp.where, fraction == 0.0), odd, at_minus_one)
    n1 = total - n2 - n0
    return PlantCoefficients(d1, d0, n2, n1, n0, total, difference, total * gamma)


class _Hold(NamedTuple):
    """The plant while a force is held for a time t <= 1; with a t as a and q t^2 as q."""

    length: DoubleDouble
    decay: DoubleDouble  # e^-a
    kappa: DoubleDouble  # kappa(q)
    even: DoubleDouble  # kappa[a^2, q]
    odd: DoubleDouble  # a sigma[a^2, q]

    def response(self) -> DoubleDouble:
        return self.length * self.length * (self.decay * (self.even + self.odd))

    def reversed_response(self) -> DoubleDouble:
        """Return e^-2a times the unit-step response of the plant with reversed time."""
        return self.length * self.length * (self.decay * (self.even - self.odd))


def _hold(gamma: Array, delta: Array, length: DoubleDouble) -> _Hold:
    duplications = 10
    a = length * (0.5 * delta)
    x = a * a
    y = x - length * length * gamma
    x, y = x.scaled(4.0**-duplications), y.scaled(4.0**-duplications)
    nodes = x, y, _series(0, x, y), _series(1, x, y)
    _, _, kappa, sigma = repeat(duplications, _duplicate, nodes)
    decay = DoubleDouble.from_value(filled(x.hi, 1.0)) / (kappa[0] + a * sigma[0])
    return _Hold(length, decay, kappa[1], kappa[2], a * sigma[2])


def _duplicate(nodes: tuple[Any, ...]) -> tuple[Any, ...]:
    """Both nodes, and kappa and sigma at these and between them, for nodes four times as far."""
    x, y, (kappa_x, kappa_y, kappa_xy), (sigma_x, sigma_y, sigma_xy) = nodes
    even = sigma_y * sigma_y + x * ((sigma_x + sigma_y) * sigma_xy)
    odd = sigma_xy * kappa_x + sigma_y * kappa_xy
    kappa = _kappa_of_4(x, sigma_x), _kappa_of_4(y, sigma_y), even.scaled(0.5)
    sigma = sigma_x * kappa_x, sigma_y * kappa_y, odd.scaled(0.25)
    return x.scaled(4.0), y.scaled(4.0), kappa, sigma


def _kappa_of_4(x: DoubleDouble, sigma: DoubleDouble) -> DoubleDouble:
    return (x * (sigma * sigma)).scaled(2.0) + 1.0


@cache
def _taylor(odd: int) -> tuple[DoubleDouble, ...]:
    """Taylor coefficients: 1/(2k)! of kappa, or 1/(2k+1)! of sigma."""
    return tuple(DoubleDouble.from_value(Fraction(1, factorial(2 * k + odd))) for k in range(10))


def _series(odd: int, x: DoubleDouble, y: DoubleDouble) -> tuple[DoubleDouble, ...]:
    """Evaluate kappa or sigma at x and y and its divided difference by Horner's rule."""
    zero = filled(x.hi, 0.0)
    at_x, at_y, between = zero, zero, zero
    pairs = 3  # the terms beyond are below 2^-53 of the sum: float64 is enough for them
    for coefficient in reversed(_taylor(odd)[pairs:]):
        between = at_x + y.hi * between
        at_x, at_y = coefficient.hi + x.hi * at_x, coefficient.hi + y.hi * at_y
    value, other, slope = map(DoubleDouble.from_value, (at_x, at_y, between))
    for pair in reversed(_taylor(odd)[:pairs]):
        value, other, slope = x * value + pair, y * other + pair, y * slope + value
    return value, other, slope
