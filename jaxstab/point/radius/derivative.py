"""The largest modulus of a root with a derivative, for JAX's transformations alone."""

from functools import partial

import jax
import jax.numpy as jnp
import optimistix
from jaxtyping import Complex128, Float64

from jaxstab.arrays import Array
from jaxstab.point.poles import companion_poles

_NEWTON: optimistix.Newton[Array, Array, None] = optimistix.Newton(rtol=1e-15, atol=1e-15)
_STEPS = 3
_FARTHEST = 1e-6  # that an eigenvalue is from its root; at multiple roots Newton's method may leave


@jax.custom_jvp
def largest_modulus(
    coefficients: Float64[Array, "*grid coefficient"],
) -> Float64[Array, "*grid"]:
    """Return the largest modulus of a root of monic polynomials, highest power first."""
    return jnp.abs(_dominant_root(coefficients))


@largest_modulus.defjvp
def _largest_modulus_jvp(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[Float64[Array, "*grid"], Float64[Array, "*grid"]]:
    """Differentiate p(z) = 0 at the dominant root: eigvals has no derivative at double roots."""
    (coefficients,), (change,) = primals, tangents
    degree = coefficients.shape[-1] - 1
    root = _dominant_root(coefficients)
    slope = _evaluated(coefficients[..., :-1] * jnp.arange(degree, 0, -1), root)
    motion = -_evaluated(change, root) / slope
    modulus = jnp.abs(root)
    return modulus, (root.conj() * motion).real / modulus


@partial(jnp.vectorize, signature="(coefficient)->()")
def _dominant_root(
    coefficients: Float64[Array, " coefficient"],
) -> Complex128[Array, ""]:
    """Return the dominant eigenvalue of a companion matrix, corrected by Newton's method."""
    guess = companion_poles(coefficients)[0]
    start = jnp.stack([guess.real, guess.imag])
    solution: optimistix.Solution[Array, None]
    solution = optimistix.root_find(
        _parts, _NEWTON, start, coefficients, max_steps=_STEPS, throw=False
    )
    root = jax.lax.complex(*solution.value)
    return jnp.where(jnp.abs(root - guess) < _FARTHEST * jnp.abs(guess), root, guess)


def _parts(point: Float64[Array, "2"], coefficients: Array) -> Float64[Array, "2"]:
    """Return the real and the imaginary part of a polynomial at a complex number."""
    value = _evaluated(coefficients, jax.lax.complex(point[0], point[1]))
    return jnp.stack([value.real, value.imag])


def _evaluated(
    coefficients: Float64[Array, "*grid coefficient"], z: Complex128[Array, "*grid"]
) -> Complex128[Array, "*grid"]:
    value = jnp.zeros_like(z)
    for power in range(coefficients.shape[-1]):
        value = value * z + coefficients[..., power]
    return value
