"""The spectral radius where JAX traces: a guess, Newton's method, derivatives.

A transformation of JAX needs one program for all points, without eigenvalues and without branches:
the powers of the companion matrix guess the dominant root (of degree 3 a closed form does), and
Newton's method refines it. The derivative is that of the root by the implicit function theorem.
"""

from functools import reduce
from operator import add

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Complex128, Float64

from jaxstab.arrays import power_of_two_below_inverse, reciprocal, square_root
from jaxstab.point.poles import companion_poles
from jaxstab.point.schur_cohn import minus

# A first guess of the dominant root of polynomials: powers of the companion matrix.
#
# z^M mod p, by repeated squaring, is the state after M products with the companion matrix. Little
# more than the dominant roots remain in it, and four samples determine them: one real root or a
# pair.
#
# A polynomial is a list of columns, the coefficients of many points, lowest power first; None
# is a column of zeros. Only elementwise operations: a compiler keeps all of it in
# registers.
#
# Source: Henrici, Applied and Computational Complex Analysis I, 7.4, with the powers by squaring.


Column = Array | None


def guessed_root(
    coefficients: list[Column], doublings: int, *, is_unrolled: bool
) -> tuple[Array, Array]:
    """Return real and imaginary part of z - 1, the latter >= 0, of the dominant root z."""
    # The power is degree 2^doublings. Unrolled code is faster as long as a compiler copes with it.
    power = _power if is_unrolled else _rolled_power
    return _fitted(_samples(power(coefficients, doublings), coefficients))


def _power(coefficients: list[Column], doublings: int) -> list[Column]:
    """Return z^(degree 2^doublings) mod p up to a factor, lowest power first."""
    remainder = [None if column is None else -column for column in coefficients]
    for turn in range(doublings):
        remainder = _squared(remainder, coefficients)
        if turn % 2 == 0:  # two squarings neither overflow nor underflow
            size = reduce(add, (jnp.abs(column) for column in remainder if column is not None))
            scale = power_of_two_below_inverse(size)
            remainder = [None if column is None else column * scale for column in remainder]
    return remainder


def _rolled_power(coefficients: list[Column], doublings: int) -> list[Column]:
    """Return the same by loops: slower, but the code does not grow with the degree."""
    # All squarings but the last are in float32, which takes half the time: what that adds of the
    # other roots, 1e-7 of the state, the last one squares.
    degree = len(coefficients)
    shape = jnp.broadcast_shapes(*(jnp.shape(c) for c in coefficients if c is not None))
    dense = jnp.stack([jnp.broadcast_to(0.0 if c is None else c, shape) for c in coefficients])
    low = sum(c is not None for c in coefficients[:-2])  # of p; between them and two are zeros

    def added(square: Array, index: Array, columns: Array) -> Array:
        before = lax.dynamic_slice_in_dim(square, index, len(columns))
        return lax.dynamic_update_slice_in_dim(square, before + columns, index, 0)

    def squared(remainder: Array, divisor: Array) -> Array:
        def multiplied(power: Array, square: Array) -> Array:
            return added(square, power, remainder[power] * remainder)

        def reduced(step: Array, square: Array) -> Array:
            top = 2 * degree - 1 - step
            square = added(square, top - 2, -square[top] * divisor[-2:])
            square = lax.optimization_barrier(square)  # or the next line works on a copy
            return added(square, top - degree, -square[top] * divisor[:low])

        square = jnp.zeros((2 * degree - 1, *shape), divisor.dtype)
        square = lax.fori_loop(0, degree, multiplied, square)
        square = lax.fori_loop(1, degree, reduced, square)[:degree]
        size = jnp.sum(jnp.abs(square), axis=0).astype(jnp.float64)
        return square * power_of_two_below_inverse(size).astype(divisor.dtype)

    short = dense.astype(jnp.float32)
    remainder = lax.fori_loop(0, doublings - 1, lambda _, r: squared(r, short), -short)
    remainder = squared(remainder.astype(jnp.float64), dense)
    return [remainder[power] for power in range(degree)]


def _samples(remainder: list[Column], coefficients: list[Column]) -> list[Array]:
    """Return the recurrence of p after as many turns as the power of z, and the next three."""
    degree = len(coefficients)
    samples: list[Array] = []
    for turn in range(4):
        sample = remainder[degree - 1 - turn] if turn < degree else None
        for before, value in enumerate(samples):
            index = degree - turn + before
            sample = minus(sample, value, coefficients[index]) if index >= 0 else sample
        assert sample is not None
        samples.append(sample)
    return samples


def _squared(remainder: list[Column], coefficients: list[Column]) -> list[Column]:
    """Return the square of a polynomial modulo p, lowest power first."""
    degree = len(coefficients)
    square: list[Column] = [None] * (2 * degree - 1)
    for power in range(2 * degree - 1):
        for low in range(max(0, power - degree + 1), (power + 1) // 2):
            square[power] = _plus_product(square[power], remainder[low], remainder[power - low])
        twice = square[power]
        square[power] = None if twice is None else twice + twice
        if power % 2 == 0:
            middle = remainder[power // 2]
            square[power] = _plus_product(square[power], middle, middle)
    for power in range(2 * degree - 2, degree - 1, -1):
        top = square[power]
        for index, coefficient in enumerate(coefficients, start=power - degree):
            square[index] = square[index] if top is None else minus(square[index], top, coefficient)
    return square[:degree]


def _fitted(samples: list[Array]) -> tuple[Array, Array]:
    """Return t of the larger root of the recurrence of order two, or one, that fits best."""
    one_root = 1e-10  # relative determinant below which one real root is left
    h0, h1, h2, h3 = samples
    determinant = h1 * h1 - h0 * h2
    inverse = reciprocal(jnp.abs(determinant)) * jnp.where(determinant < 0.0, -1.0, 1.0)
    centre = 0.5 * (h1 * h2 - h0 * h3) * inverse
    offset = centre * centre - (h2 * h2 - h1 * h3) * inverse
    width = square_root(jnp.abs(offset))
    is_pair = offset < 0.0
    re = jnp.where(is_pair, centre, centre + jnp.where(centre < 0.0, -width, width))
    size = h0 * h0 + h1 * h1 + h2 * h2
    single = (h0 * h1 + h1 * h2 + h2 * h3) * reciprocal(size)
    is_single = jnp.abs(determinant) < one_root * size
    return jnp.where(is_single, single, re) - 1.0, jnp.where(is_pair & ~is_single, width, 0.0)


def _plus_product(a: Column, b: Column, c: Column) -> Column:
    if b is None or c is None:
        return a
    return b * c if a is None else a + b * c


# The largest modulus of a root with a derivative, for JAX's transformations alone.


@jax.custom_jvp
def largest_modulus(coefficients: Float64[Array, "*grid coefficient"]) -> Float64[Array, "*grid"]:
    """Return the largest modulus of a root of monic polynomials, highest power first."""
    return jnp.abs(_dominant_root(coefficients))


@largest_modulus.defjvp
def _largest_modulus_jvp(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[Float64[Array, "*grid"], Float64[Array, "*grid"]]:
    """Differentiate p(z) = 0 at the dominant root: eigvals has no derivative at double roots."""
    (coefficients,), (change,) = primals, tangents
    root = _dominant_root(coefficients)
    motion = -_evaluated(change, root) / _slope(coefficients, root)
    modulus = jnp.abs(root)
    return modulus, (root.conj() * motion).real / modulus


def _dominant_root(coefficients: Float64[Array, "*grid coefficient"]) -> Complex128[Array, "*grid"]:
    farthest, steps = 1e-6, 3  # from its root: at multiple roots Newton's method may leave
    guess = root = lax.platform_dependent(
        coefficients, cpu=lambda own: companion_poles(own)[..., 0], default=iterated_root
    )
    for _ in range(steps):
        root = root - _evaluated(coefficients, root) / _slope(coefficients, root)
    root = jnp.where(jnp.abs(root - guess) < farthest * jnp.abs(guess), root, guess)
    # Fused with a modulus, eight steps of Horner's rule take XLA's compiler for CPUs minutes.
    return lax.optimization_barrier(root)


def iterated_root(
    coefficients: Float64[Array, "*grid coefficient"],
) -> Complex128[Array, "*grid"]:
    """The largest root by Aberth's iteration for all roots at once.

    Accelerators find eigenvalues of one matrix after the other, and this for all polynomials.
    """
    steps, turn = 48, 2.4  # radians, about the golden angle: no start is symmetric
    rounding = 1e-9  # of the terms of p(z): beyond it z is not yet at a root
    degree = coefficients.shape[-1] - 1
    start = _newton_polygon(coefficients) * jnp.exp(1j * turn * jnp.arange(degree))
    shape = (*coefficients.shape[:-1], degree, degree + 1)
    falling = jnp.broadcast_to(coefficients[..., None, :], shape)

    def step(_: Array, z: Array) -> Array:
        value, slope = _evaluated(falling, z), _slope(falling, z)
        apart = z[..., :, None] - z[..., None, :]
        away = jnp.sum(jnp.where(apart == 0.0, 0.0, 1.0 / apart), axis=-1)
        change = value / (slope - value * away)
        return jnp.where(jnp.isfinite(change), z - change, z)

    roots = lax.fori_loop(0, steps, step, start)
    sizes = jnp.abs(roots)
    is_root = jnp.abs(_evaluated(falling, roots)) <= rounding * jnp.polyval(
        jnp.moveaxis(jnp.abs(falling), -1, 0), sizes
    )
    largest = jnp.argmax(jnp.where(is_root, sizes, -1.0), axis=-1, keepdims=True)
    return jnp.take_along_axis(roots, largest, axis=-1)[..., 0]


def _newton_polygon(
    coefficients: Float64[Array, "*grid coefficient"],
) -> Float64[Array, "*grid root"]:
    """About how large the roots are: slopes of the concave hull of the coefficients' logarithms.

    Of the interval from k - 1 to k it is the least of i < k of the largest of j >= k of
    (log a_j - log a_i)/(j - i) (Bini 1996).
    """
    sizes, order = jnp.log(jnp.abs(coefficients)), jnp.arange(coefficients.shape[-1])
    run = (order - order[:, None]).astype(jnp.float64)
    rise = sizes[..., None, :] - sizes[..., :, None]
    slopes = jnp.where(run > 0.0, rise / run, -jnp.inf)
    highest = lax.cummax(slopes, axis=slopes.ndim - 1, reverse=True)  # [i, k]: of j >= k
    is_one = (run > 0.0) & jnp.isfinite(sizes)[..., :, None]
    return jnp.exp(jnp.min(jnp.where(is_one, highest, jnp.inf), axis=-2)[..., 1:])


def _slope(coefficients: Array, z: Array) -> Complex128[Array, "*grid"]:
    degree = coefficients.shape[-1] - 1
    return _evaluated(coefficients[..., :-1] * jnp.arange(degree, 0, -1), z)


def _evaluated(
    coefficients: Float64[Array, "*grid coefficient"], z: Complex128[Array, "*grid"]
) -> Complex128[Array, "*grid"]:
    return jnp.polyval(jnp.moveaxis(coefficients, -1, 0), z)
