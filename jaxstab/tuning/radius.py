"""The wall gains with the smallest spectral radius.

The radius has no smooth minimum: at the best gains several roots share the largest modulus, and at
a triple root it grows with the cube root of any change. So the search (``search``) does not run
over gains, but over the dominant pair z = r e^(+-i theta) itself. Where a multiple root is found,
its equations, p = p' = p'' = 0 at a real z or p = p' = 0 at a complex one, are solved to full
precision.
See Blondel, Gurbuzbalaban, Megretski, Overton (2012) for why roots coalesce.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from jaxstab.arrays import Array, Numbers, constant, float_arrays, is_any_traced, namespace
from jaxstab.batches import on_host
from jaxstab.conventions import Verdict
from jaxstab.model import (
    PlantCoefficients,
    by_name,
    checked_delay,
    checked_delta,
    checked_gamma,
    plant_coefficients,
    require_x64,
)
from jaxstab.model.filters import Filter, Filters, Velocity, given_filters
from jaxstab.model.linear_loop import LinearLoop, filtered_loop
from jaxstab.numbers import checked_number
from jaxstab.point.verdicts import verdict
from jaxstab.tuning.component import Component, searched_component
from jaxstab.tuning.multiple_root import Family, Pair, family_of, family_of_loop, newton_step
from jaxstab.tuning.search import Walls, scan_angles, searched
from jaxstab.tuning.status import OptimalGains, TuningStatus

_LIKE = (np.float64,) * 4 + (np.int8,)
_NEAR_CIRCLE = 0.9  # how far out zeros are that bend the curve sharply


def minimize_radius(
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> OptimalGains:
    """Return the gains (alpha, beta) with the smallest spectral radius: the fastest decay.

    In the haptic range the best gains make a triple real pole; with a stiff hand and a delay, a
    double complex pair. Both are solved for to full precision. The best alpha may be negative if
    the hand is stiff. It is not proved that no other gains are better: the search looks for a
    smaller radius at every angle of the dominant pair, to the resolution of its scan.

    With an estimator or a filter the stable set may have several components. The best gains are
    then those of the component that holds small positive gains; if there is none, those of the
    islands, and the status says so.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4], any shape; broadcasts with delta.
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, one number.
        velocity: the velocity estimator in units of one sample; None for the difference over one.
        position: the position filter in units of one sample; None for none.

    Returns:
        OptimalGains of the broadcast shape. ``value`` is the radius at the exact multiple root: at
        a triple root, gains rounded to float64 come within about 1e-5 of it, gains of six digits
        within 1e-2. Differentiable once in gamma and delta where the status is TRIPLE_ROOT or
        DOUBLE_PAIR; elsewhere the derivative is NaN.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN.
        TypeError: the delay is traced or an array, or a filter is traced.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9) for the poles; the theorem of Blondel et al. (2012), IEEE TAC 57(12).

    Example:
        >>> best = jaxstab.minimize_radius(gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(best.value), 9)  # 4^(1/3) - 1
        0.587401052
    """
    require_x64(gamma, delta)
    checked_delay(delay)
    delay = checked_number("delay", delay, 0.0)
    filters = given_filters(velocity, position)
    gamma, delta = float_arrays(checked_gamma(gamma), checked_delta(delta))
    family, fields = (
        _filtered_pairs(gamma, delta, delay, filters) if filters else _pairs(gamma, delta, delay)
    )
    best, kind = Pair(*fields[:4]), fields[4]
    xp = namespace(gamma, delta)
    if xp is not np:
        best = _followed(family, best, kind)
    scene = constant((best.alpha, best.beta, gamma, delta))
    codes = verdict(**by_name(*scene, delay), velocity=velocity, position=position)
    return _as_gains(best, kind, codes)


def smallest_radius(walls: Walls, verdicts: Callable[[Array, Array], Array]) -> OptimalGains:
    """Return the best gains of one loop among its ``walls``."""
    *best, kind = searched([walls], ())
    known = walls.component.status
    kind = np.int8(known) if known != TuningStatus.NOT_COMPUTED else kind
    return _as_gains(Pair(*best), kind, verdicts(best[0], best[1]))


def _as_gains(best: Pair, kind: Array, codes: Array) -> OptimalGains:
    xp = namespace(best)
    value = xp.hypot(best.x, best.y)
    is_stable = xp.asarray(codes == Verdict.STABLE)
    status = xp.where(is_stable, kind, TuningStatus.NO_STABLE_GAINS).astype(np.int8)
    return OptimalGains(best.alpha, best.beta, value, status)


def _pairs(gamma: Array, delta: Array, delay: float) -> tuple[Family, tuple[Array, ...]]:
    plant = plant_coefficients(gamma=gamma, delta=delta, delay=delay)
    fields = on_host(
        lambda *fields: _searched(PlantCoefficients(*fields), int(delay)),
        *plant,
        shape=plant.d0.shape,
        like=_LIKE,
    )
    return family_of(plant, int(delay)), fields


def _searched(plant: PlantCoefficients, whole_delay: int) -> tuple[Array, ...]:
    family = family_of(PlantCoefficients(*(np.ravel(field) for field in plant)), whole_delay)
    zeros = np.stack([np.ravel(field) for field in (plant.n2, plant.n1, plant.n0)], axis=-1)
    every = (
        Walls(Family(*one), scan_angles(whole_delay + 3, np.roots(numerator) + 0j))
        for *one, numerator in zip(*family, zeros, strict=True)
    )
    return searched(every, plant.d0.shape)


def _filtered_pairs(
    gamma: Array, delta: Array, delay: float, filters: Filters
) -> tuple[Family, tuple[Array, ...]]:
    if is_any_traced(filters):
        raise TypeError(
            "the best gains are searched for outside of JAX: give filters of concrete numbers, not "
            "traced."
        )
    xp = namespace(gamma, delta)
    gamma, delta = xp.broadcast_arrays(gamma, delta)
    fields = on_host(
        lambda *plants: _filtered_searched(plants, delay, filters),
        gamma,
        delta,
        shape=gamma.shape,
        like=_LIKE,
    )
    loop = filtered_loop(gamma, delta, int(delay), delay % 1.0, filters)
    return family_of_loop(loop), fields


def _filtered_searched(
    plants: tuple[Array, ...], delay: float, filters: Filters
) -> tuple[Array, ...]:
    gamma, delta = plants
    pairs = zip(gamma.ravel().tolist(), delta.ravel().tolist(), strict=True)
    every = [filtered_walls(*plant, delay, filters) for plant in pairs]
    *pair, kind = searched(every, gamma.shape)
    known = np.array([walls.component.status for walls in every]).reshape(gamma.shape)
    return *pair, np.where(known == TuningStatus.NOT_COMPUTED, kind, known).astype(np.int8)


def filtered_walls(gamma: float, delta: float, delay: float, filters: Filters) -> Walls:
    """Return all walls of a loop with filters in units of one sample."""
    plant = np.float64(gamma), np.float64(delta)
    loop = filtered_loop(*plant, int(delay), delay % 1.0, filters)
    return walls_of(loop, searched_component(gamma, delta, delay, filters))


def walls_of(loop: LinearLoop, component: Component) -> Walls:
    """Return all walls of any linear loop, with the component that the search covers."""
    family = family_of_loop(loop)
    zeros = np.roots(family.stiff)
    near = zeros[np.abs(zeros) > _NEAR_CIRCLE] + 0j
    return Walls(family, scan_angles(family.base.size - 1, near), component)


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
