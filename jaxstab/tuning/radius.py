"""The wall gains with the smallest spectral radius.

The radius has no smooth minimum: at the best gains several roots share the largest modulus, and at
a triple root it grows with the cube root of any change. So the search does not run over gains, but
over the dominant pair z = r e^(+-i theta) itself (theta = 0: a double real root). Both gains follow
from p(z) = 0, a linear system, and the remaining roots depend smoothly on (r, theta): wanted is the
smallest r for which none of them is larger. A scan brackets it; then the equations of the multiple
root that is found there, p = p' = p'' = 0 at a real z or p = p' = 0 at a complex one, are solved to
full precision. See Blondel, Gurbuzbalaban, Megretski, Overton (2012) for why roots coalesce.
"""

from enum import IntEnum
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Float64, Int8

from jaxstab.conventions import Verdict
from jaxstab.model import PlantCoefficients, checked_delay, plant_coefficients, require_x64
from jaxstab.point.verdict.door import verdict

_SMALLEST, _LARGEST = 1e-4, 1.3  # radii that are looked at
_GRID, _ZOOMS = 64, 9  # of the scan over the dominant pair
_REAL = 1e-3  # rad: dominant pairs closer to the real axis are taken for real
_NEWTON_STEPS = 24
_AGREEMENT = 1e-6  # relative, between the scan and the solution of the equations


class TuningStatus(IntEnum):
    """How the best gains are known; small integers, so that arrays store int8."""

    NOT_COMPUTED = 0
    TRIPLE_ROOT = 1
    DOUBLE_PAIR = 2
    SCANNED = 3
    NO_STABLE_GAINS = 4

    @property
    def words(self) -> str:
        """The status in words."""
        return {
            TuningStatus.NOT_COMPUTED: "not computed",
            TuningStatus.TRIPLE_ROOT: "a triple real pole, solved for to full precision",
            TuningStatus.DOUBLE_PAIR: "a double pair of poles, solved for to full precision",
            TuningStatus.SCANNED: "the best point of a scan that was refined",
            TuningStatus.NO_STABLE_GAINS: "no gains found that make the loop stable",
        }[self]


class OptimalGains(NamedTuple):
    """The best gains, what they reach (a radius, or samples) and how they are known."""

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    value: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]


def least_radius(gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike) -> OptimalGains:
    """Return the gains (alpha, beta) with the smallest spectral radius: the fastest decay.

    In the haptic range the best gains make a triple real pole; with a stiff hand and a delay, a
    double complex pair. Both are solved for to full precision, after a scan that looks at every
    dominant pair for a smaller radius, to the resolution of its grid. The best alpha may be
    negative where the hand is stiff.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4], any shape; broadcasts with delta.
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, one number.

    Returns:
        OptimalGains of the broadcast shape, ``value`` the radius. Differentiable once in gamma and
        delta where the status is TRIPLE_ROOT or DOUBLE_PAIR; elsewhere the derivative is NaN.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN, or the delay is an array.
        TypeError: the delay is traced.
        RuntimeError: JAX's x64 mode is off.

    Source: eq. (9) for the poles; the theorem of Blondel et al. (2012), IEEE TAC 57(12).
    """
    require_x64()
    delay = one_number("delay", checked_delay(delay))
    plant = plant_coefficients(gamma, delta, delay)
    shape = plant.d0.shape
    flat = PlantCoefficients(*(jnp.ravel(field) for field in plant))
    found = OptimalGains(
        *(field.reshape(shape) for field in _least_radius(flat, whole_delay=int(delay)))
    )
    scene = lax.stop_gradient((found.alpha, found.beta, gamma, delta))
    is_stable = verdict(*scene, delay) == Verdict.STABLE
    status = jnp.where(is_stable, found.status, TuningStatus.NO_STABLE_GAINS)
    return found._replace(status=status.astype(jnp.int8))


def one_number(name: str, value: ArrayLike) -> float:
    """Return a single number as a float, or refuse an array."""
    if np.ndim(value) > 0:
        raise ValueError(f"{name} has the shape {np.shape(value)}; give one number.")
    return float(np.asarray(value))


class _Family(NamedTuple):
    """p(z) = base + alpha stiff + beta damp, each with the highest power first."""

    base: Array
    stiff: Array
    damp: Array

    def polynomial(self, alpha: Array, beta: Array) -> Array:
        """Return the coefficients for arrays of gains, on a new last axis."""
        alpha, beta = alpha[..., None], beta[..., None]
        return self.base + alpha * self.stiff + beta * self.damp


class _Pair(NamedTuple):
    """The gains that put a pair of poles at x +- i y."""

    alpha: Array
    beta: Array
    x: Array
    y: Array


@partial(jax.jit, static_argnames="whole_delay")
def _least_radius(plant: PlantCoefficients, *, whole_delay: int) -> OptimalGains:
    return jax.vmap(lambda one: _solved(_family(one, whole_delay)))(plant)


def _family(plant: PlantCoefficients, whole_delay: int) -> _Family:
    zero, one = jnp.zeros_like(plant.d0), jnp.ones_like(plant.d0)
    padding, delay = [zero] * (whole_delay + 1), [zero] * (whole_delay + 2)
    fall = plant.difference - plant.n0  # n2 - n1, to all of its digits for a whole delay
    return _Family(
        jnp.stack([one, plant.d1, plant.d0, *delay]),
        jnp.stack([*padding, plant.n2, plant.n1, plant.n0, zero]),
        jnp.stack([*padding, plant.n2, -fall, plant.n0 - plant.n1, -plant.n0]),
    )


def _solved(family: _Family) -> OptimalGains:
    start, found = _scan(lax.stop_gradient(family))
    angle = jnp.arctan2(start.y, start.x)
    is_triple = jnp.sin(angle) < _REAL
    start = start._replace(y=jnp.where(is_triple, 0.0, start.y))
    best = _multiple_root(family, start, is_triple)
    radius, scanned = jnp.hypot(best.x, best.y), jnp.hypot(start.x, start.y)
    agrees = jnp.abs(radius - scanned) <= _AGREEMENT * scanned
    exact = agrees & _is_dominant(family, best, radius * (1.0 + _AGREEMENT))
    pair = _chosen(best, start, exact)
    value = jnp.hypot(pair.x, pair.y)
    kind = jnp.where(is_triple, TuningStatus.TRIPLE_ROOT, TuningStatus.DOUBLE_PAIR)
    status = jnp.where(exact, kind, TuningStatus.SCANNED)
    status = jnp.where(found, status, TuningStatus.NO_STABLE_GAINS)
    return OptimalGains(pair.alpha, pair.beta, value, status.astype(jnp.int8))


def _multiple_root(family: _Family, start: _Pair, is_triple: Array) -> _Pair:
    """Solve for the root; the last Newton step carries the implicit derivative, once.

    The derivative of optimistix would raise for a whole batch where one Jacobian is singular.
    """
    import optimistix as optx  # here: it takes as long as all other imports

    best = optx.root_find(
        _equations,
        optx.Newton(rtol=1e-15, atol=1e-15),
        start,
        args=(lax.stop_gradient(family), is_triple),
        max_steps=_NEWTON_STEPS,
        throw=False,
    ).value
    point, unravel = ravel_pytree(lax.stop_gradient(best))
    jacobian = jax.jacfwd(
        lambda at: _equations(unravel(at), (lax.stop_gradient(family), is_triple))
    )(point)
    step = jnp.linalg.solve(jacobian, _equations(unravel(point), (family, is_triple)))
    solution: _Pair = unravel(point - step)
    return solution


def _equations(pair: _Pair, arguments: tuple[_Family, Array]) -> Array:
    """Return what vanishes at a triple real root, or at a double complex pair."""
    family, is_triple = arguments
    coefficients = family.polynomial(pair.alpha, pair.beta)
    z = lax.complex(pair.x, pair.y)
    value, slope, curvature = (_at(c, z) for c in _derivatives(coefficients))
    triple = jnp.stack([value.real, slope.real, curvature.real, pair.y])
    double = jnp.stack([value.real, value.imag, slope.real, slope.imag])
    return jnp.where(is_triple, triple, double)


def _derivatives(coefficients: Array) -> tuple[Array, Array, Array]:
    powers = jnp.arange(coefficients.shape[-1] - 1, 0, -1)
    slope = coefficients[..., :-1] * powers
    return coefficients, slope, slope[..., :-1] * powers[1:]


def _scan(family: _Family) -> tuple[_Pair, Array]:
    """Zoom in on the smallest r for which no other root is larger than the pair r e^(+-i theta)."""
    steps = jnp.linspace(0.0, 1.0, _GRID)

    def zoom(_: Array, state: tuple[Array, _Pair, Array]) -> tuple[Array, _Pair, Array]:
        (bottom, top, left, right), best, found = state
        height, width = (top - bottom) / (_GRID - 1), (right - left) / (_GRID - 1)
        radius = jnp.exp(bottom + (top - bottom) * steps)[:, None]
        angle = left + (right - left) * steps
        pairs = _pairs(family, radius, angle)
        fits = _is_dominant(family, pairs, jnp.broadcast_to(radius, pairs.x.shape))
        row = jnp.argmax(jnp.any(fits, axis=1))
        columns = fits[row]
        any_fits = columns.any()
        first, last = jnp.argmax(columns), _GRID - 1 - jnp.argmax(columns[::-1])
        middle = jnp.where(columns[0], 0, jnp.where(columns[-1], _GRID - 1, (first + last) // 2))
        candidate = jax.tree.map(lambda field: field[row, middle], pairs)
        best = jax.tree.map(partial(jnp.where, any_fits), candidate, best)
        box = jnp.stack(
            [
                bottom + (row - 3.0) * height,
                bottom + (row + 1.0) * height,
                jnp.maximum(left + (first - 6.0) * width, 0.0),
                jnp.minimum(left + (last + 6.0) * width, jnp.pi),
            ]
        )
        return jnp.where(any_fits, box, state[0]), best, found | any_fits

    box = jnp.array([np.log(_SMALLEST), np.log(_LARGEST), 0.0, np.pi])
    nothing = _Pair(*(jnp.ones(()) for _ in _Pair._fields))
    _, best, found = lax.fori_loop(0, _ZOOMS, zoom, (box, nothing, jnp.asarray(False)))
    return best, found


def _pairs(family: _Family, radius: Array, angle: Array) -> _Pair:
    """Solve p(z) = 0 for the gains; at theta = 0 and pi close enough to the double real root."""
    angle = jnp.clip(angle, 1e-5, np.pi - 1e-5)
    x, y = radius * jnp.cos(angle), radius * jnp.sin(angle)
    base, stiff, damp = (_at(part, lax.complex(x, y)) for part in family)
    determinant = stiff.real * damp.imag - stiff.imag * damp.real
    alpha = (base.imag * damp.real - base.real * damp.imag) / determinant
    beta = (stiff.imag * base.real - stiff.real * base.imag) / determinant
    return _Pair(alpha, beta, x, y)


def _is_dominant(family: _Family, pair: _Pair, radius: Array) -> Array:
    """Return whether all roots but the pair are smaller than the radius (Schur and Cohn)."""
    rest = _quotient(family.polynomial(pair.alpha, pair.beta), pair)
    rest = rest / radius[..., None] ** jnp.arange(rest.shape[-1])
    inside = jnp.full(radius.shape, True)
    for _ in range(rest.shape[-1] - 1):
        reflection = rest[..., -1:] / rest[..., :1]
        inside &= jnp.abs(reflection[..., 0]) < 1.0
        rest = rest[..., :-1] - reflection * rest[..., :0:-1]
    return inside


def _quotient(coefficients: Array, pair: _Pair) -> Array:
    """Divide by z^2 - 2 x z + x^2 + y^2."""
    last, before, parts = jnp.zeros_like(pair.x), jnp.zeros_like(pair.x), []
    for power in range(coefficients.shape[-1] - 2):
        part = coefficients[..., power] + 2.0 * pair.x * last - (pair.x**2 + pair.y**2) * before
        parts.append(part)
        last, before = part, last
    return jnp.stack(parts, axis=-1)


def _at(coefficients: Array, z: Array) -> Array:
    value = jnp.zeros_like(z)
    for power in range(coefficients.shape[-1]):
        value = value * z + coefficients[..., power]
    return value


@jax.custom_jvp
def _chosen(solution: _Pair, scanned: _Pair, exact: Array) -> _Pair:
    return _Pair(*(jnp.where(exact, a, b) for a, b in zip(solution, scanned, strict=True)))


@_chosen.defjvp
def _chosen_jvp(
    primals: tuple[_Pair, _Pair, Array], tangents: tuple[_Pair, _Pair, Array]
) -> tuple[_Pair, _Pair]:
    """Say NaN, not zero, where the equations are not known whose solution could be followed."""
    known = jnp.where(primals[2], 1.0, jnp.nan)
    return _chosen(*primals), jax.tree.map(lambda tangent: tangent * known, tangents[0])
