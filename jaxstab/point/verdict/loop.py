"""The loop's p(z) in the form of the certified recursion, and what is lost in forming it.

Plants are computed once, in double-double (lemma V7 of docs/proofs.md). Source: eq. (9).
"""

from dataclasses import dataclass, fields, replace
from typing import Any, Generic

import numpy as np

from jaxstab.arrays import Array, namespace, pytree
from jaxstab.batches import compiled
from jaxstab.conventions import UNSTABLE
from jaxstab.model import DoubleDouble, PlantPairs, plant_pairs
from jaxstab.model.plant import may_cancel, pairs_error
from jaxstab.point.verdict.recursion import (
    UNDERFLOW,
    Chain,
    Ends,
    Number,
    decide,
    leading,
    size,
    size_sum,
)

HIGHEST_UNROLLED = 12  # degree up to which XLA compiles the recursion without a loop
_LOST = 2.0**-25  # of N(1): the error of a stiff plant times its root is an ulp there


@pytree
@dataclass(frozen=True)
class Plant(Generic[Number]):
    """A sampled plant, with N(z) ((alpha + beta) z - beta) = stiff(z) alpha - damp(z) beta."""

    gap: Number  # 1 - d0
    d1: Number
    d0: Number
    stiff: tuple[Number, ...]  # lowest power of z first
    damp: tuple[Number, ...]
    difference: Number  # N(-1)
    at_minus_one: Number  # D(-1)
    error: Array  # of the numbers above, relative to 1, or to the size of N
    size: Array  # of N
    sum: Array  # N(1)


def float_plant(
    gamma: Array, delta: Array, fraction: Array, *, is_fractional: bool
) -> Plant[Array]:
    """Return the plant rounded to float64; without a fraction, ``fraction`` is not read."""
    # Not in one jit: plant_pairs takes long to compile, and others share what was compiled.
    pairs = plant_pairs(gamma, delta, fraction if is_fractional else 0.0)
    plant: Plant[Array] = _rounded_plant(gamma, delta, pairs, is_fractional=is_fractional)
    return plant


@compiled(static=["is_fractional"])
def _rounded_plant(
    gamma: Array, delta: Array, pairs: PlantPairs, *, is_fractional: bool
) -> Plant[Array]:
    plant = _plant_of(gamma, delta, pairs, is_fractional=is_fractional)
    rounded = {field.name: _rounded(getattr(plant, field.name)) for field in fields(plant)}
    return Plant(**rounded)


def _rounded(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_rounded, value))
    return value.rounded() if isinstance(value, DoubleDouble) else value


def pair_plant(
    gamma: Array, delta: Array, fraction: Array, *, is_fractional: bool
) -> Plant[DoubleDouble]:
    """Return the plant in double-double; without a fraction, ``fraction`` is not read."""
    pairs = plant_pairs(gamma, delta, fraction if is_fractional else 0.0)
    return _plant_of(gamma, delta, pairs, is_fractional=is_fractional)


def _plant_of(
    gamma: Array, delta: Array, pairs: PlantPairs, *, is_fractional: bool
) -> Plant[DoubleDouble]:
    xp = namespace(gamma, delta, pairs)
    one = DoubleDouble.of(xp.ones_like(pairs.d0.hi))
    zero = one - one
    stiff = (zero, pairs.n0, pairs.n1, pairs.n2)
    # n2 - n1 vanishes with delta for a whole delay; N(-1) knows it to all of its digits.
    damp = (pairs.n0, pairs.n1 - pairs.n0, pairs.difference - pairs.n0, -pairs.n2)
    sum_n = sum(abs(n.hi) for n in stiff[1:])
    return Plant(
        gap=one - pairs.d0,
        d1=pairs.d1,
        d0=pairs.d0,
        stiff=stiff if is_fractional else stiff[1:],
        damp=damp if is_fractional else damp[1:],
        difference=pairs.difference,
        at_minus_one=one - pairs.d1 + pairs.d0,
        error=pairs_error(gamma, delta),
        size=xp.where(may_cancel(gamma, delta), xp.sqrt(sum_n), sum_n),
        sum=pairs.sum.hi,
    )


def is_plant_lost(gamma: Array, delta: Array) -> Array:
    """Return True where N(z) nearly vanishes, so that an ulp of it cannot be relied on."""
    xp = namespace(gamma, delta)
    rate = xp.sqrt(xp.maximum(gamma - 0.25 * delta**2, 0.0))
    half = xp.expm1(-0.5 * delta)
    gamma_sum = half**2 + 4.0 * (1.0 + half) * xp.sin(0.5 * rate) ** 2  # gamma N(1)
    return may_cancel(gamma, delta) & (gamma_sum < _LOST * gamma)


def loop_codes(
    alpha: Number,
    beta: Number,
    gamma: Array,
    plant: Plant[Number],
    *,
    unit: float,
    degree: int | Array,
) -> Array:
    """Return the code of each point, computed in numbers of the given unit roundoff.

    The drift from exact steps is followed for high degrees, and where the degree is an array.
    """
    chain = _closed_loop(alpha, beta, plant, unit)
    ends = _ends(alpha, beta, gamma, plant, unit, degree)
    # A coefficient of a stable polynomial is at most binomial(n, i). Numbers stay finite so.
    large = size_sum(chain.tail) - chain.error > 8.0 * 2.0**degree
    if not isinstance(degree, int) or degree > HIGHEST_UNROLLED:
        chain = replace(chain, drift=chain.error + chain.head_error + 4.0 * unit)
    codes = decide(chain, ends, unit, degree)
    return namespace(large, codes).where(large, UNSTABLE, codes).astype(np.int8)


def _closed_loop(alpha: Number, beta: Number, plant: Plant[Number], unit: float) -> Chain[Number]:
    """Return p(z) and what is lost in its coefficients."""
    tail = tuple(
        stiff * alpha - damp * beta for stiff, damp in zip(plant.stiff, plant.damp, strict=True)
    )
    # Three roundings: of the plant's coefficient, of the product, of the difference.
    per_alpha = 3.0 * unit * size_sum(plant.stiff) + 4.0 * plant.error * plant.size
    per_beta = 3.0 * unit * size_sum(plant.damp) + 8.0 * plant.error * plant.size
    error = unit * size(plant.gap) + plant.error + UNDERFLOW
    return Chain(
        gap=plant.gap,
        head=(plant.d1, plant.d0),
        tail=tail,
        head_error=unit * (size(plant.d1) + 2.0 * size(plant.d0)) + 4.0 * plant.error,
        error=error + (per_alpha * size(alpha) + per_beta * size(beta)),
    )


def _ends(
    alpha: Number,
    beta: Number,
    gamma: Array,
    plant: Plant[Number],
    unit: float,
    degree: int | Array,
) -> Ends:
    """Return (gamma + alpha) N(1) and D(-1) - (-1)^floor(delay) N(-1) (alpha + 2 beta)."""
    whole_delay = degree - len(plant.stiff)
    sign = 1.0 - 2.0 * (whole_delay % 2)
    gain = (alpha + (beta + beta)) * sign
    wall = plant.difference * gain
    error = unit * (2.0 * size(plant.at_minus_one) + 5.0 * size(wall))
    error = error + plant.error * (8.0 + plant.size * size(gain)) + UNDERFLOW
    at_one = leading(alpha) + gamma  # N(1) > 0, and the sign of a sum of two is exact
    return Ends(at_one, 0.0, leading(plant.at_minus_one - wall), error)
