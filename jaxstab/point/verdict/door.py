"""Certified verdicts and radius bounds: STABLE and UNSTABLE are proofs, rounding included.

``recursion`` holds the proof. Here its polynomials are formed: p(z) of eq. (9) from plants that are
computed once in double-double and then rounded, and p(r z) for a bound of the spectral radius.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from jaxtyping import Float64, Int8

from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE
from jaxstab.model import (
    DoubleDouble,
    characteristic_polynomial,
    checked_delay,
    checked_delta,
    checked_gain,
    checked_gamma,
    require_x64,
)
from jaxstab.point.verdict.loop import float_plant, is_plant_lost, loop_codes, pair_plant
from jaxstab.point.verdict.outer_root import have_outer_root
from jaxstab.point.verdict.recursion import (
    FLOAT_UNIT,
    PAIR_UNIT,
    UNDERFLOW,
    Chain,
    Ends,
    decide,
    size_sum,
)
from jaxstab.wide_vectors import wide_jit

_UNROLLED = 12  # up to this degree the recursion is compiled without a loop
_TILE = 4096  # points whose recursion stays in the cache
_BATCH = 1 << 16  # points gathered from a grid for one call
_EXACT_BATCHES = (1 << 8, 1 << 12)  # the same in double-double, which takes long to compile

_RADIUS_STEPS = tuple(2.0**power for power in range(-50, -5, 2))  # relative bounds that are tried

Values = np.ndarray[Any, np.dtype[Any]]


class _Delay(NamedTuple):
    """What sets the form of p(z)."""

    whole: int
    is_fractional: bool

    @property
    def degree(self) -> int:
        return self.whole + 3 + self.is_fractional


def verdict(
    alpha: ArrayLike,
    beta: ArrayLike,
    gamma: ArrayLike,
    delta: ArrayLike,
    delay: ArrayLike,
    *,
    resolve: str | None = None,
) -> Int8[Array, "*grid"]:
    """Prove for every point whether all roots of p(z) lie inside the unit circle.

    STABLE and UNSTABLE are proofs: the rounding of plant, coefficients and recursion is bounded.
    Points too close to the boundary are UNDECIDED, and so are points exactly on it, such as
    alpha = -gamma. UNSTABLE means at least one root outside or on the circle.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional, concrete.
        resolve: "exact" repeats the recursion in double-double where float64 leaves a point
            UNDECIDED, and then looks for a root that is certainly outside; all arguments must be
            concrete, as for an array of delays.

    Returns:
        int8 array of the broadcast shape: Verdict.STABLE, UNSTABLE or UNDECIDED. Plants are
        computed once for each (gamma, delta, delay): give grids as arrays that broadcast.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN, or resolve is unknown.
        TypeError: the delay is traced.
        RuntimeError: JAX's x64 mode is off.

    Source: Schur-Cohn criterion (Jury 1964) for eq. (9) of Hulin, Preusche, Hirzinger (2008).
    """
    require_x64()
    if resolve not in (None, "exact"):
        raise ValueError(f'resolve is {resolve!r}; give "exact" or None.')
    delays = checked_delay(delay)
    point = tuple(
        value if isinstance(value, jax.core.Tracer) else np.asarray(value, np.float64)
        for value in (
            checked_gain("alpha", alpha),
            checked_gain("beta", beta),
            checked_gamma(gamma),
            checked_delta(delta),
        )
    )
    shape = np.broadcast_shapes(*(np.shape(value) for value in point), delays.shape)
    wholes = np.asarray(np.floor(delays))
    fractions = np.asarray(delays - wholes)
    if delays.size == 1:
        at = _Delay(int(wholes.item()), bool(fractions.item()))
        codes = _float_verdict(point, fractions, at)
    else:
        codes = _grouped_verdict(point, wholes, fractions, shape)
    codes = jnp.broadcast_to(codes, shape)
    return codes if resolve is None else _resolved(codes, point, wholes, fractions)


def radius_error(
    coefficients: Float64[Array, "*grid coefficient"],
    radius: Float64[Array, "*grid"],
    coefficient_error: float = 2.0 * FLOAT_UNIT,
) -> Float64[Array, "*grid"]:
    """Prove how far a spectral radius can be from the true one.

    All roots are inside the circle of radius + error, and not all inside that of radius - error.
    Bounds from a ladder of ratio 4 are tried by verdicts on p(r z), so the result is up to 4 times
    larger than what could be proved, and never smaller than the truth.

    Args:
        coefficients: monic p(z) of degree >= 3, highest power first, as characteristic_polynomial
            gives them for one delay.
        radius: the estimate, > 0.
        coefficient_error: relative uncertainty of each coefficient.

    Returns:
        The absolute error; inf where 2^-6 radius is not proved either, as where coefficients other
        than the first three and the last four are not zero.

    Raises:
        ValueError: the degree is below 3.
        RuntimeError: JAX's x64 mode is off.

    Source: Schur-Cohn criterion (Jury 1964) for p(r z).
    """
    require_x64()
    degree = coefficients.shape[-1] - 1
    if degree < 3:
        raise ValueError(f"coefficients are of degree {degree}; give polynomials of degree >= 3.")
    columns = [coefficients[..., place] for place in range(degree + 1)]
    tail = columns[: max(2, degree - 4) : -1]
    rest = sum(map(jnp.abs, columns[3 : degree + 1 - len(tail)]), jnp.zeros_like(radius))
    bound = partial(_radius_error, degree=degree, coefficient_error=coefficient_error)
    return over_tiles(bound, (tuple(columns[1:3]), tuple(tail), rest, radius))


def _radius_error(
    head: tuple[Array, ...],
    tail: tuple[Array, ...],
    rest: Array,
    radius: Array,
    *,
    degree: int,
    coefficient_error: float,
) -> Array:
    steps = jnp.asarray(_RADIUS_STEPS)
    sides = jnp.stack([jnp.ones_like(radius), -jnp.ones_like(radius)])
    wanted = jnp.stack([jnp.full_like(radius, STABLE), jnp.full_like(radius, UNSTABLE)])

    def prove(state: tuple[Array, Array]) -> tuple[Array, Array]:
        step, error = state
        scale = radius * (1.0 + sides * steps[step])
        codes = _scaled_codes(head, tail, rest, scale, degree, coefficient_error)
        tried = jnp.abs(scale - radius) * (1.0 + 4.0 * FLOAT_UNIT)
        return step + 1, jnp.where(jnp.isinf(error) & (codes == wanted), tried, error)

    def is_open(state: tuple[Array, Array]) -> Array:
        step, error = state
        return (step < len(_RADIUS_STEPS)) & jnp.any(jnp.isinf(error))

    start = jnp.asarray(0), jnp.full_like(sides, jnp.inf)
    errors: Array = lax.while_loop(is_open, prove, start)[1]
    return jnp.max(errors, axis=0)


def _scaled_codes(
    head: tuple[Array, ...],
    tail: tuple[Array, ...],
    rest: Array,
    scale: Array,
    degree: int,
    coefficient_error: float,
) -> Array:
    """Return the codes of p(scale z) / scale^degree, of which ``rest`` is left out."""
    inverse = 1.0 / scale
    head = tuple(value * inverse**power for power, value in enumerate(head, start=1))
    tail = tuple(value * inverse ** (degree - power) for power, value in enumerate(tail))
    head_error = (coefficient_error + 10.0 * FLOAT_UNIT) * size_sum(head)
    tail_error = (coefficient_error + (2 * degree + 6) * FLOAT_UNIT) * size_sum(tail)
    left_out = rest * jnp.maximum(inverse**3, inverse**degree)
    error = head_error + 2.0 * tail_error + 2.0 * left_out + 2.0 * FLOAT_UNIT + UNDERFLOW
    chain = Chain(1.0 - head[1], head, tail, 2.0 * head_error, error)
    at_one = sum((*head, *tail), jnp.ones_like(scale))
    signs = [(-1.0) ** power for power in range(len(tail))]
    wall = sum(sign * value for sign, value in zip(signs, tail, strict=True))
    at_minus_one = 1.0 - head[0] + head[1] + (-1.0) ** degree * wall
    end_error = error + 8.0 * FLOAT_UNIT * (1.0 + size_sum(head) + size_sum(tail))
    ends = Ends(at_one, end_error, at_minus_one, end_error)
    return decide(chain, ends, FLOAT_UNIT, degree if degree <= _UNROLLED else jnp.asarray(degree))


def _float_verdict(point: tuple[ArrayLike, ...], fractions: Values, at: _Delay) -> Array:
    alpha, beta, gamma, delta = map(jnp.asarray, point)
    plant = float_plant(gamma, delta, jnp.asarray(fractions), is_fractional=at.is_fractional)
    return _float_codes((alpha, beta, gamma, plant), at)


def _float_codes(arguments: tuple[Any, ...], at: _Delay) -> Array:
    """Return the codes of points; one compilation for all long delays."""
    if at.degree <= _UNROLLED:
        return _short_codes(arguments, degree=at.degree)
    return _long_codes(arguments, jnp.asarray(at.degree))


@partial(wide_jit, static_argnames=("degree",))
def _short_codes(arguments: tuple[Any, ...], *, degree: int) -> Array:
    codes = partial(loop_codes, unit=FLOAT_UNIT, degree=degree)
    return codes(*arguments) if degree <= 4 else over_tiles(codes, arguments)


@wide_jit
def _long_codes(arguments: tuple[Any, ...], degree: Array) -> Array:
    codes = partial(loop_codes, unit=FLOAT_UNIT, degree=degree)
    return over_tiles(codes, arguments)


def _grouped_verdict(
    point: tuple[ArrayLike, ...],
    wholes: Values,
    fractions: Values,
    shape: tuple[int, ...],
) -> Array:
    """Run every delay at the degree of its own."""
    alpha, beta, gamma, delta = point
    codes = np.zeros(shape, np.int8)
    for at, places in _groups(wholes, fractions, np.full(shape, True)):
        # Plants on the smallest grid that holds them, then gathered like the points.
        plants = float_plant(
            *map(jnp.asarray, (gamma, delta, fractions)), is_fractional=at.is_fractional
        )
        for some in _batches(places):
            values = _gathered((alpha, beta, gamma, plants), shape, some)
            codes.flat[some] = np.asarray(_float_codes(values, at))
    return jnp.asarray(codes)


def _resolved(
    codes: Array,
    point: tuple[ArrayLike, ...],
    wholes: Values,
    fractions: Values,
) -> Array:
    """Repeat UNDECIDED points in double-double; of what is left, look for a root outside."""
    settled = np.array(codes)
    for at, places in _groups(wholes, fractions, np.asarray(settled == UNDECIDED)):
        for some in _exact_batches(places):
            values = _gathered((*point, fractions), settled.shape, some)
            exact = _pair_codes(
                values,
                jnp.asarray(at.degree),
                is_fractional=at.is_fractional,
                is_cubic=at.degree == 3,
            )
            settled.flat[some] = np.asarray(exact)
    for _, places in _groups(wholes, fractions, np.asarray(settled == UNDECIDED)):
        for some in _exact_batches(places):
            values = _gathered((*point, wholes + fractions), settled.shape, some)
            proved = have_outer_root(np.asarray(characteristic_polynomial(*values)))
            proved &= ~np.asarray(is_plant_lost(*values[2:4]))
            settled.flat[some[proved]] = UNSTABLE
    return jnp.asarray(settled)


@partial(jax.jit, static_argnames=("is_fractional", "is_cubic"))
def _pair_codes(
    point: tuple[Array, ...], degree: Array, *, is_fractional: bool, is_cubic: bool
) -> Array:
    alpha, beta, gamma, delta, fraction = point
    plant = pair_plant(gamma, delta, fraction, is_fractional=is_fractional)
    gains = DoubleDouble.of(alpha), DoubleDouble.of(beta)
    return loop_codes(*gains, gamma, plant, unit=PAIR_UNIT, degree=3 if is_cubic else degree)


def _groups(wholes: Values, fractions: Values, chosen: Values) -> list[tuple[_Delay, Values]]:
    """Return the form of p(z) and the flat indices of each group of chosen points."""
    forms = np.broadcast_to(2 * wholes + (fractions > 0), chosen.shape)
    return [
        (_Delay(int(form) // 2, bool(form % 2)), np.flatnonzero(chosen & (forms == form)))
        for form in np.unique(forms[chosen])
    ]


def _batches(places: Values) -> list[Values]:
    """Split indices; the last part is filled up with repeated ones to a power of two."""
    parts = [places[start : start + _BATCH] for start in range(0, places.size, _BATCH)]
    if parts:
        parts[-1] = np.resize(parts[-1], 1 << max(parts[-1].size - 1, 255).bit_length())
    return parts


def _exact_batches(places: Values) -> list[Values]:
    """Split indices into parts of two sizes, the last one filled up with repeated ones."""
    few, many = _EXACT_BATCHES
    parts = [places[start : start + many] for start in range(0, places.size, many)]
    return [np.resize(part, few if part.size <= few else many) for part in parts]


def _gathered(values: Any, shape: tuple[int, ...], places: Values) -> Any:
    shape = shape or (1,)
    index = np.unravel_index(places, shape)
    return jax.tree.map(lambda value: jnp.asarray(np.broadcast_to(value, shape)[index]), values)


def over_tiles(codes: Callable[..., Array], arguments: tuple[Any, ...], tile: int = _TILE) -> Array:
    """Evaluate an elementwise function tile by tile, so that what it keeps stays in the cache.

    Arrays of one element are not copied for every point. Only for the CPU: an accelerator gets all
    points at once.
    """
    leaves, structure = jax.tree.flatten(arguments)
    shape = jnp.broadcast_shapes(*(jnp.shape(leaf) for leaf in leaves))
    size = int(np.prod(shape))
    if size <= tile or jax.default_backend() != "cpu":
        return codes(*arguments)
    shared = [jnp.reshape(leaf, ()) if leaf.size == 1 else None for leaf in leaves]
    tiles = [
        jnp.resize(jnp.broadcast_to(leaf, shape).ravel(), (-(-size // tile), tile))
        for leaf in leaves
        if leaf.size > 1
    ]

    def tile_codes(columns: list[Array]) -> Array:
        parts = iter(columns)
        mixed = [next(parts) if one is None else one for one in shared]
        return codes(*jax.tree.unflatten(structure, mixed))

    codes_of_tiles: Array = lax.map(tile_codes, tiles)
    return codes_of_tiles.ravel()[:size].reshape(shape)
