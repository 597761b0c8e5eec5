"""Polynomials in balls at angles of the unit circle, in float64: they suggest, and prove nothing.

Known roots at 0, 1 and -1 and windows are factors of their own, and next to z = 1 the rest is in
powers of z - 1, so that small values, real and imaginary parts each, keep their digits there.
"""

from collections.abc import Iterator

import numpy as np
from flint import arb_poly
from jaxtyping import Complex128, Float64

from jaxstab.model.balls import Factored


class FloatValues:
    """A polynomial at angles in float64, next to z = 1 in powers of z - 1."""

    def __init__(self, p: Factored) -> None:
        self.p = p
        sides = p.rest, p.rest(arb_poly([1, 1]))
        self.plain, self.near = (
            np.array([float(c.mid()) for c in side.coeffs()][::-1] or [0.0]) for side in sides
        )

    def __call__(self, theta: Float64[np.ndarray, " angle"]) -> Complex128[np.ndarray, " angle"]:
        """Return the values at angles."""
        p, half, z = self.p, 0.5 * theta, np.exp(1j * theta)
        one, minus = 2j * np.sin(half) * np.exp(1j * half), 2.0 * np.cos(half) * np.exp(1j * half)
        is_near = theta < 0.4
        value = np.empty(theta.shape, complex)
        value[is_near] = np.polyval(self.near, one[is_near])
        value[~is_near] = np.polyval(self.plain, z[~is_near])
        value *= z**p.power * one**p.at_one * minus**p.at_minus_one
        for n in p.windows:
            value *= np.sin(n * half) / np.sin(half) * np.exp(1j * (n - 1) * half)
        return value

    def angles(self) -> Iterator[Float64[np.ndarray, " angle"]]:
        """Angles next to its roots."""
        aside = np.r_[0.0, np.geomspace(0.05, 20.0, 12)]
        roots = np.roots(self.plain)
        for root in roots[(np.abs(roots) > 0.3) & (np.abs(roots) < 3.0)]:
            width = max(abs(np.log(abs(root))), 1e-9)
            yield np.abs(np.abs(np.angle(root)) + width * np.r_[-aside, aside])
