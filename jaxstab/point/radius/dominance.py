"""The proof that an approximate root of p(z) is the dominant one, with a bound of its error.

A root lies within n |p(z) / p'(z)| of any z (lemma R1 of docs/proofs.md). Divided by it, and by its
conjugate where there is one, p leaves Q(z); if all roots of Q are proved to be inside the circle
through z, the root is dominant (lemma R2). So the proof needs only as much precision as the
distance to the second largest root requires.

Sources: Schur (1917), Cohn (1922); Henrici, Applied and Computational Complex Analysis I, 6.4, for
the distance.
"""

from functools import partial, reduce
from operator import add

import numpy as np

from jaxstab.arrays import Array, namespace, repeat
from jaxstab.batches import compiled, over_tiles
from jaxstab.point.radius.dominant_root import TILE, Column, Complex, Loop, evaluated
from jaxstab.point.radius.elementary import power_of_two_below_inverse
from jaxstab.point.verdict.recursion import FLOAT_UNIT

_MANY = 1 << 13
_HIGHEST_UNROLLED = 28  # degree; from 33 on unrolled code was up to 100 times slower
_SHORT_FOR_NUMPY = 8  # degree up to which single columns cost less than whole arrays
_LOST_IN_SQUARES = 1e-150  # moduli below are flushed to zero
_SAFETY = 1.0 + 1e-6  # the bounds themselves are rounded


@compiled(static=["degree"], many=_MANY, wide=True)
def distance_of_dominant(root: Array, loop: Loop, *, degree: int) -> Array:
    """Return a proved bound of | |1 + root| - spectral radius |, inf where there is no proof.

    The bound includes the rounding of ``modulus``.
    """
    distance = partial(_distance, degree=degree)
    if degree <= _HIGHEST_UNROLLED:
        return distance(root, loop)
    return over_tiles(distance, (root, loop), TILE)


@compiled(many=_MANY, wide=True)
def modulus(root: Array) -> Array:
    """Return |1 + root| to 3 ulp."""
    return namespace(root).sqrt(Complex(root.real, root.imag).shifted(1.0).squared_modulus())


def _distance(root: Array, loop: Loop, *, degree: int) -> Array:
    xp = namespace(root, loop)
    t = Complex(root.real, root.imag)
    radius = xp.sqrt(t.shifted(1.0).squared_modulus())
    distance = _distance_to_root(t, radius, loop, degree)
    is_real = t.im == 0.0
    rest, error = _deflated(t, is_real, radius, distance, loop, degree)
    is_unrolled = degree <= (_SHORT_FOR_NUMPY if xp is np else _HIGHEST_UNROLLED)
    all_inside = _all_inside if is_unrolled else _rolled_all_inside
    is_proved = all_inside(rest, error) & (is_real | (t.im > distance))
    return xp.where(is_proved, distance + 4.0 * FLOAT_UNIT * radius, xp.inf)


def _distance_to_root(t: Complex, radius: Array, loop: Loop, degree: int) -> Array:
    """Return n |p/p'|, raised by what rounding may have changed.

    Each product of complex numbers loses at most 3 ulp, z^(n-2) therefore 4 (n - 2), and what it is
    multiplied with and added to less than 30 ulp of the same terms taken without their signs.
    """
    xp = namespace(t, loop)
    value, slope = evaluated(t, loop, degree)
    t_size = xp.sqrt(t.squared_modulus())
    plant_error = loop.plant.error / FLOAT_UNIT
    linear, constant = loop.denominator
    linear = linear + plant_error
    denominator = (t_size + linear) * t_size + constant
    first, *inner, last = (abs(c) + plant_error * loop.plant.size for c in loop.numerator)
    numerator, numerator_slope = first * t_size + last, first
    if inner:
        numerator = (first * t_size + inner[0]) * t_size + last
        numerator_slope = 2.0 * first * t_size + inner[0]
    stiffness, damping = abs(loop.alpha), abs(loop.beta)
    wall = stiffness * radius + damping * t_size
    below = _real_power(radius, degree - 3)
    value_terms = below * radius * denominator + numerator * wall
    slope_terms = (
        below * ((degree - 2.0) * denominator + radius * (2.0 * t_size + linear))
        + numerator * (stiffness + damping)
        + numerator_slope * wall
    )
    unit = (4.0 * (degree - 2) + 30.0) * FLOAT_UNIT
    value_size = xp.sqrt(value.squared_modulus()) + unit * value_terms + _LOST_IN_SQUARES
    slope_size = xp.sqrt(slope.squared_modulus()) - unit * slope_terms
    distance = (_SAFETY * degree) * value_size / slope_size
    return xp.where(slope_size > 0.0, distance, xp.inf)


def _real_power(x: Array, exponent: int) -> Array:
    result = namespace(x).ones_like(x)
    for _ in range(exponent):
        result = result * x
    return result


def _deflated(
    t: Complex, is_real: Array, radius: Array, distance: Array, loop: Loop, degree: int
) -> tuple[list[Array], Array]:
    """Return Q(radius z), highest power first, and a bound of the l1 norm of its error."""
    inverse = 1.0 / radius
    powers = [inverse]
    for _ in range(degree - 1):
        powers.append(powers[-1] * inverse)
    rest = _divided(t, is_real, inverse, powers, loop, degree)
    return rest, _error_of_division(rest, powers, distance, loop, degree)


def _divided(
    t: Complex, is_real: Array, inverse: Array, powers: list[Array], loop: Loop, degree: int
) -> list[Array]:
    """Return the quotient of p by the root and its conjugate, on the circle of radius 1 now.

    With s and q their sum and product, b_j = c_j + s b_(j-1) - q b_(j-2).
    """
    xp = namespace(t, loop)
    coefficients = loop.coefficients(degree)[::-1]
    twice = xp.where(is_real, xp.sign(t.re + 1.0), 2.0 * (t.re + 1.0) * inverse)
    product = xp.where(is_real, 0.0, 1.0)
    is_unrolled = xp is np or degree <= _HIGHEST_UNROLLED
    divided = _quotient if is_unrolled else _rolled_quotient
    rest = divided(coefficients[:-1], powers[:-1], twice, product)
    rest[-1] = xp.where(is_real, rest[-1], 0.0)
    return rest


def _error_of_division(
    rest: list[Array], powers: list[Array], distance: Array, loop: Loop, degree: int
) -> Array:
    """Bound the l1 norm of the quotient's error, as after lemma R2."""
    plant = loop.plant
    terms = 1.0 + (1.0 + abs(plant.d1)) * powers[0] + (1.0 + plant.d0) * powers[1]
    for stiff, damp, power in zip(plant.stiff, plant.damp, powers[::-1], strict=False):
        wall = (abs(stiff) + plant.sum) * abs(loop.alpha)
        terms = terms + power * (wall + (abs(damp) + 2.0 * plant.sum) * abs(loop.beta))
    moved = distance * powers[0] + 8.0 * FLOAT_UNIT
    once = (2.0 * degree + 16.0) * FLOAT_UNIT * terms + 4.0 * moved * _size_sum(rest)
    xp = namespace(moved)
    return xp.where(degree * moved < 0.5, degree * (degree + 1.0) * once, xp.inf)


def _quotient(
    coefficients: list[Column], powers: list[Array], twice: Array, product: Array
) -> list[Array]:
    rest = [namespace(twice).ones_like(twice)]
    for coefficient, power in zip(coefficients, powers, strict=True):
        follows = twice * rest[-1]
        if len(rest) > 1:
            follows = follows - product * rest[-2]
        rest.append(follows if coefficient is None else follows + coefficient * power)
    return rest


def _rolled_quotient(
    coefficients: list[Column], powers: list[Array], twice: Array, product: Array
) -> list[Array]:
    """Return the same by a loop: the code does not grow with the degree."""
    import jax.numpy as jnp
    from jax import lax

    zero, one = jnp.zeros_like(twice), jnp.ones_like(twice)
    scaled = [
        zero if coefficient is None else coefficient * power
        for coefficient, power in zip(coefficients, powers, strict=True)
    ]

    def divided(last: tuple[Array, Array], added: Array) -> tuple[tuple[Array, Array], Array]:
        follows = twice * last[0] - product * last[1] + added
        return (follows, last[0]), follows

    _, rest = lax.scan(divided, (one, zero), jnp.stack(scaled))
    return [one, *rest]


def _all_inside(polynomial: list[Array], error: Array) -> Array:
    """Return True where all roots are proved to be in |z| < 1; highest power first, monic."""
    xp = namespace(error)
    below = above = whole = xp.ones_like(error)
    quotients = xp.zeros_like(error)
    is_inside = xp.isfinite(error)
    while len(polynomial) > 1:
        first, last = polynomial[0], polynomial[-1]
        lowest, highest = first - abs(last), first + abs(last)
        is_inside = is_inside & (lowest > 0.0)
        below, above, whole = below * lowest, above * highest, whole * first
        quotients = quotients + highest / lowest
        pairs = zip(polynomial[1:-1], polynomial[-2:0:-1], strict=True)
        lowered = [lowest * highest, *(first * a - last * b for a, b in pairs)]
        scale = power_of_two_below_inverse(lowered[0])
        polynomial = [value * scale for value in lowered]
    return is_inside & (_lost(error, above, whole, quotients) < below)


def _rolled_all_inside(polynomial: list[Array], error: Array) -> Array:
    """Return the same by loops over a -> (a - k a*) / z and its reverse, zeros filling both."""
    xp = namespace(error)
    one, zero = xp.ones_like(error), xp.zeros_like(error)

    def lower(state: tuple[Array, ...]) -> tuple[Array, ...]:
        rows, turned, is_inside, below, above, whole, quotients = state
        first, last = rows[0], turned[0]
        lowest, highest = first - abs(last), first + abs(last)
        scale = power_of_two_below_inverse(lowest * highest)
        large, small = first * scale, last * scale
        return (
            xp.concatenate([(lowest * highest * scale)[None], (large * rows - small * turned)[1:]]),
            xp.concatenate([(large * turned - small * rows)[1:], zero[None]]),
            is_inside & (lowest > 0.0),
            below * lowest,
            above * highest,
            whole * first,
            quotients + highest / lowest,
        )

    rows = xp.stack(polynomial)
    half = len(polynomial) // 2
    start = rows, rows[::-1], xp.isfinite(error), one, one, one, zero
    rows, turned, *rest = repeat(half, lower, start)
    # Half of the coefficients are left.
    halves = rows[:-half], turned[:-half], *rest
    _, _, is_inside, below, above, whole, quotients = repeat(
        len(polynomial) - 1 - half, lower, halves
    )
    return is_inside & (_lost(error, above, whole, quotients) < below)


def _lost(error: Array, above: Array, whole: Array, quotients: Array) -> Array:
    """Bound what the polynomial's own error and the rounding of all steps come to at the end."""
    return _SAFETY * (error * whole + 8.0 * FLOAT_UNIT * above * quotients)


def _size_sum(columns: list[Array]) -> Array:
    return reduce(add, (abs(column) for column in columns))
