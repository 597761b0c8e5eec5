"""The wall gains with the smallest spectral radius.

The radius has no smooth minimum: at the best gains several roots share the largest modulus, and at
a triple root it grows with the cube root of any change. So the search (``search``) does not run
over gains, but over the dominant pair z = r e^(+-i theta) itself. Where a multiple root is found,
its equations, p = p' = p'' = 0 at a real z or p = p' = 0 at a complex one, are solved to full
precision.
See Blondel, Gurbuzbalaban, Megretski, Overton (2012) for why roots coalesce.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, constant, namespace
from jaxstab.batches import on_host
from jaxstab.conventions import Status, Verdict
from jaxstab.model import (
    PlantCoefficients,
    checked_delay,
    checked_delta,
    checked_gamma,
    plant_coefficients,
    require_x64,
)
from jaxstab.numbers import checked_number
from jaxstab.point.verdict.door import verdict
from jaxstab.tuning.multiple_root import Family, Pair, family_of, newton_step
from jaxstab.tuning.search import searched


class TuningStatus(Status):
    """How the best gains are known; small integers, so that arrays store int8.

    That no other gains are better is proved for none of them.
    """

    NOT_COMPUTED = 0, "not computed"
    TRIPLE_ROOT = 1, "the best found: a triple real pole, solved for to full precision"
    DOUBLE_PAIR = 2, "the best found: a double pair of poles, solved for to full precision"
    SCANNED = 3, "the best found: a point of a scan, of which 0.01 % may be missing"
    NO_STABLE_GAINS = 4, "no gains found that make the loop stable"


class OptimalGains(NamedTuple):
    """The best gains, what they reach (a radius, or samples) and how they are known."""

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    value: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]


def minimize_radius(gamma: Numbers, delta: Numbers, delay: Numbers) -> OptimalGains:
    """Return the gains (alpha, beta) with the smallest spectral radius: the fastest decay.

    In the haptic range the best gains make a triple real pole; with a stiff hand and a delay, a
    double complex pair. Both are solved for to full precision. The best alpha may be negative where
    the hand is stiff. That the gains are the best is not proved: the search looks for a smaller
    radius at every angle of the dominant pair, to the resolution of its scan.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4], any shape; broadcasts with delta.
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, one number.

    Returns:
        OptimalGains of the broadcast shape, ``value`` the radius at the exact multiple root: gains
        that are rounded to float64 reach it to about 1e-5 at a triple root, those of six digits to
        1e-2. Differentiable once in gamma and delta where the status is TRIPLE_ROOT or DOUBLE_PAIR;
        elsewhere the derivative is NaN.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN.
        TypeError: the delay is traced or an array.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9) for the poles; the theorem of Blondel et al. (2012), IEEE TAC 57(12).
    """
    require_x64(gamma, delta)
    checked_delay(delay)
    delay = checked_number("delay", delay, 0.0)
    plant = plant_coefficients(checked_gamma(gamma), checked_delta(delta), delay)
    fields = on_host(
        lambda *fields: searched(PlantCoefficients(*fields), int(delay)),
        *plant,
        shape=plant.d0.shape,
        like=(np.float64,) * 4 + (np.int8,),
    )
    best, kind = Pair(*fields[:4]), fields[4]
    xp = namespace(plant)
    if xp is not np:
        best = _followed(family_of(plant, int(delay)), best, kind)
    value = xp.hypot(best.x, best.y)
    scene = constant((best.alpha, best.beta, gamma, delta))
    is_stable = xp.asarray(verdict(*scene, delay) == Verdict.STABLE)
    status = xp.where(is_stable, kind, TuningStatus.NO_STABLE_GAINS).astype(np.int8)
    return OptimalGains(best.alpha, best.beta, value, status)


def _followed(family: Family, best: Pair, kind: Array) -> Pair:
    """Return the pair with its derivatives: those of one more step of Newton's method.

    Where no equations are known that it solves, they are NaN.
    """
    is_triple = kind == TuningStatus.TRIPLE_ROOT
    step = newton_step(family, constant(best), is_triple)
    moved = [a + b for a, b in zip(constant(best), step, strict=True)]
    exact = is_triple | (kind == TuningStatus.DOUBLE_PAIR)
    return Pair(*_chosen()(moved, list(best), exact))


@cache
def _chosen() -> Any:
    import jax
    import jax.numpy as jnp

    @jax.custom_jvp
    def chosen(solution: list[Array], scanned: list[Array], exact: Array) -> list[Array]:
        return [jnp.where(exact, a, b) for a, b in zip(solution, scanned, strict=True)]

    @chosen.defjvp
    def _jvp(primals: Any, tangents: Any) -> Any:
        known = jnp.where(primals[2], 1.0, jnp.nan)
        return chosen(*primals), [tangent * known for tangent in tangents[0]]

    return chosen
