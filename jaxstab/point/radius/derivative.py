"""The largest modulus of a root with a derivative, for JAX's transformations alone."""

import jax
import jax.numpy as jnp
from jaxtyping import Complex128, Float64

from jaxstab.arrays import Array
from jaxstab.point.poles import companion_poles


@jax.custom_jvp
def largest_modulus(
    coefficients: Float64[Array, "*grid coefficient"],
) -> Float64[Array, "*grid"]:
    """Return the largest modulus of a root of monic polynomials, highest power first."""
    return jnp.abs(companion_poles(coefficients)[..., 0])


@largest_modulus.defjvp
def _largest_modulus_jvp(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[Float64[Array, "*grid"], Float64[Array, "*grid"]]:
    """Differentiate p(z) = 0 at the dominant root: eigvals has no derivative at double roots."""
    (coefficients,), (change,) = primals, tangents
    degree = coefficients.shape[-1] - 1
    root = companion_poles(coefficients)[..., 0]
    slope = _evaluated(coefficients[..., :-1] * jnp.arange(degree, 0, -1), root)
    motion = -_evaluated(change, root) / slope
    modulus = jnp.abs(root)
    return modulus, (root.conj() * motion).real / modulus


def _evaluated(
    coefficients: Float64[Array, "*grid coefficient"], z: Complex128[Array, "*grid"]
) -> Complex128[Array, "*grid"]:
    value = jnp.zeros_like(z)
    for power in range(coefficients.shape[-1]):
        value = value * z + coefficients[..., power]
    return value
