"""The closed loop's poles: eigenvalues of the companion matrix of p(z), by LAPACK, without a proof.

They serve unproved answers (mode shapes, frequencies) and starting values for proved ones.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Complex128, Float64, Int64

from jaxstab.arrays import Array, Numbers, is_any_traced, namespace, reciprocal, tree_map
from jaxstab.batches import MANY_COEFFICIENTS, compiled
from jaxstab.model import (
    by_name,
    characteristic_polynomial,
    companion_matrix,
    polynomial_degree,
)
from jaxstab.model.filters import Filter, Velocity
from jaxstab.model.linear_loop import LinearLoop, loop_polynomial
from jaxstab.numbers import checked_count, real_numbers, require_together
from jaxstab.rounding import SAFETY, UNIT

# Broadcast grids of points in chunks of one shape, each point at the degree of p for its delay.
#
# The grid itself is never formed: a chunk is a list of flat indices, looked up in the arguments as
# they were given. A grid of five axes needs memory for its axes, one chunk and its results;
# ``evaluate_grid`` does without the results.

CHUNK = 2**15

Result = TypeVar("Result")


def evaluate_grid(
    function: Callable[..., Result],
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    chunk: int = CHUNK,
) -> Iterator[tuple[slice, Result]]:
    """Evaluate a function on a grid that is larger than memory, chunk by chunk.

    Args:
        function: called with five arrays of at most ``chunk`` points, by their names:
            spectral_radius, verdict ...
        alpha, beta, gamma, delta, delay: see ``jaxstab.conventions``.
        chunk: points per call.

    Returns:
        An iterator over the range of flat indices (C order) of each part of the broadcast grid, and
        the function's answer for it.

    Raises: ValueError if ``chunk`` is below 1, or the shapes do not broadcast; else as the
    function.

    Source: Table I for the parameters.

    Example:
        >>> alpha = np.linspace(0.0, 0.2, 1000)
        >>> parts = jaxstab.evaluate_grid(
        ...     jaxstab.verdict, alpha, 0.2, gamma=0.0, delta=0.015, delay=1.0, chunk=400
        ... )
        >>> sum(int((codes == jaxstab.Verdict.STABLE).sum()) for _, codes in parts)
        558
    """
    given = by_name(alpha, beta, gamma, delta, delay)
    shape = require_together(**given)
    checked_count("chunk", chunk, 1, 10**12)
    arguments = [real_numbers(name, value).astype(np.float64) for name, value in given.items()]
    total = math.prod(shape)

    def evaluated_part(start: int) -> tuple[slice, Result]:
        end = min(start + chunk, total)
        points = looked_up(arguments, shape, np.arange(start, end))
        return slice(start, end), function(**by_name(*points))

    return map(evaluated_part, range(0, total, chunk))


def looked_up(
    arguments: Sequence[Any], shape: tuple[int, ...], points: Int64[np.ndarray, " point"]
) -> list[Any]:
    """Return arrays, or trees of them, at flat indices of the grid to which they broadcast."""
    # Single numbers stay single, so that they are used once; only the first argument is repeated.
    index = np.unravel_index(points, shape or (1,))

    def repeated(values: Any) -> Any:
        return namespace(values).broadcast_to(values, shape or (1,))[index]

    def kept(values: Any) -> Any:
        return namespace(values).reshape(values, ()) if np.size(values) == 1 else repeated(values)

    return [repeated(arguments[0]), *tree_map(kept, list(arguments[1:]))]


def closed_loop_poles(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    longest_delay: int | float | None = None,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Complex128[Array, "*grid degree"]:
    """Poles of the closed loop, the eigenvalues of the companion matrix of p(z).

    Args and Raises: see ``jaxstab.conventions``.

    Returns:
        Array of shape (*grid, degree), the largest modulus first. For an array of delays, or a
        traced one, a loop of a lower degree has zeros at the end.

    Source: eq. (9); each pole is an exact root of a polynomial within a few ulp of p(z) (backward
    error), so a root of multiplicity k is only good to about ulp^(1/k).

    Example:
        >>> float(abs(jaxstab.closed_loop_poles(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)).max())
        0.98712203...
    """
    point = by_name(alpha, beta, gamma, delta, delay)
    shape = require_together(**point)

    polynomial = partial(
        characteristic_polynomial,
        longest_delay=longest_delay,
        velocity=velocity,
        position=position,
    )
    if is_any_traced(*point.values(), velocity, position):
        return companion_poles(polynomial(**point))

    def poles(**points: Numbers) -> Complex128[np.ndarray, "point degree"]:
        given = np.asarray(polynomial(**points))
        degree = given.shape[1] - 1
        zeros = np.sum(np.cumprod(given[:, :1:-1] == 0.0, axis=1), axis=1)  # so many roots at 0
        found = np.zeros((len(given), degree), complex)
        for count in np.unique(zeros).tolist():
            own, rest = zeros == count, degree - count
            found[own, :rest] = companion_poles(given[own, : rest + 1])
        return found

    rows = [part for _, part in evaluate_grid(poles, **point, chunk=CHUNK)]
    longest = max((row.shape[1] for row in rows), default=polynomial_degree(delay))
    rows = [np.pad(row, [(0, 0), (0, longest - row.shape[1])]) for row in rows]
    every = np.concatenate(rows) if rows else np.zeros((0, longest), complex)
    return namespace(*point.values()).asarray(every.reshape(*shape, longest))


def linear_poles(alpha: Array, beta: Array, loop: LinearLoop) -> Complex128[Array, "*grid degree"]:
    """Poles of walls of one loop of any device and filters: array (*grid, degree), largest first.

    Walls and loop are float64, broadcast and may be traced.
    """
    return companion_poles(loop_polynomial(alpha, beta, loop))


@compiled(many=MANY_COEFFICIENTS)
def companion_poles(
    coefficients: Float64[Array, "*grid coefficient"],
) -> Complex128[Array, "*grid degree"]:
    """Return all roots of monic polynomials, highest power first, the largest root first."""
    xp = namespace(coefficients)
    unit = _unit(coefficients)[..., None]
    matrix = companion_matrix(coefficients / unit ** xp.arange(coefficients.shape[-1]))
    poles = unit * _eigenvalues(matrix)
    order = xp.argsort(-xp.abs(poles), axis=-1, stable=True)  # pairs stay in order
    return xp.take_along_axis(poles, order, axis=-1)


def _eigenvalues(
    matrix: Float64[Array, "*grid degree degree"],
) -> Complex128[Array, "*grid degree"]:
    xp = namespace(matrix)
    if xp is not np:
        return xp.linalg.eigvals(matrix)
    is_finite = np.isfinite(matrix).all(axis=(-2, -1))
    poles = np.full(matrix.shape[:-1], np.nan, complex)
    poles[is_finite] = np.linalg.eigvals(matrix[is_finite])
    return poles


def _unit(coefficients: Float64[Array, "*grid coefficient"]) -> Float64[Array, "*grid"]:
    """The unit of roots: 1, but of huge coefficients about the largest root."""
    huge = 2.0**400
    # Some builds of LAPACK lose the scale of matrices above 1e138.
    xp = namespace(coefficients)
    sizes = xp.abs(coefficients[..., 1:])
    exponents = xp.log2(sizes) / xp.arange(1, coefficients.shape[-1])
    largest = xp.exp2(xp.floor(xp.max(exponents, axis=-1)))
    return xp.where(xp.max(sizes, axis=-1) > huge, largest, 1.0)


# A bound of the distance to the nearest root of p, by the value of p (lemma R1 of docs/proofs.md).

_LEAST = 1e-130  # more than the error of a modulus whose square was flushed to zero


@dataclass(frozen=True)
class Complex:
    """Real and imaginary part: XLA fuses them better than complex numbers."""

    re: Array
    im: Array

    def __add__(self, other: "Complex | Array | float") -> "Complex":
        if isinstance(other, Complex):
            return Complex(self.re + other.re, self.im + other.im)
        return Complex(self.re + other, self.im)

    def __mul__(self, other: "Complex | Array | float") -> "Complex":
        if isinstance(other, Complex):
            real = self.re * other.re - self.im * other.im
            return Complex(real, self.re * other.im + self.im * other.re)
        return Complex(self.re * other, self.im * other)

    def __pow__(self, exponent: int) -> "Complex":
        power, square = None, self
        while exponent:
            if exponent % 2:
                power = square if power is None else power * square
            exponent //= 2
            square = square * square
        assert power is not None
        return power

    def over(self, other: "Complex") -> "Complex":
        """Return the quotient by another number, to eight digits in JAX."""
        conjugate = Complex(other.re, -other.im)
        return self * conjugate * reciprocal(other.squared_modulus())

    def squared_modulus(self) -> Array:
        """Return re^2 + im^2."""
        return self.re * self.re + self.im * self.im


Value = TypeVar("Value", Complex, Array)


def evaluated(columns: list[Array], z: Value) -> tuple[Value, Value]:
    """Return p(z) and its derivative; the coefficients are given with the highest power first."""
    slope = z * 0.0
    value = slope + columns[0]
    for column in columns[1:]:
        slope = slope * z + value
        value = value * z + column
    return value, slope


def distance_to_root(columns: list[Array], error: Array, z: Complex) -> Array:
    """Return n |p/p'|, raised by what rounding may have changed; infinite where nothing is proved.

    ``error`` bounds the sum of the errors of the coefficients.
    """
    xp, degree = namespace(columns, error), len(columns) - 1
    radius = xp.sqrt(z.squared_modulus())
    value, slope = evaluated(columns, z)
    size, slope_size = evaluated([abs(column) for column in columns], radius)
    unit, most = (4.0 * degree + 10.0) * UNIT, error * xp.maximum(radius, 1.0) ** degree
    nearest = xp.sqrt(value.squared_modulus()) + unit * size + most + _LEAST
    steep = xp.sqrt(slope.squared_modulus()) - unit * slope_size - degree * most
    is_bounded = (steep > 0.0) & (steep < xp.inf)  # its square may overflow
    return xp.where(is_bounded, SAFETY * degree * nearest / steep, xp.inf)
