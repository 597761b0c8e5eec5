"""What suggests, in float64, and proves nothing: values on the unit circle, places of maxima.

Of a polynomial in balls known roots at 0, 1 and -1 and windows are factors of their own, and next
to z = 1 the rest is in powers of z - 1, so that small values, real and imaginary parts each, keep
their digits there.
"""

from collections.abc import Callable, Iterator

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


def highest(
    function: Callable[[float], float], low: float, high: float, steps: int
) -> tuple[float, float]:
    """The largest value that golden sections of an interval meet, and where it is."""
    share = 0.6180339887498949
    x, y = high - share * (high - low), low + share * (high - low)
    at_x, at_y = function(x), function(y)
    best = max((at_x, x), (at_y, y))
    for _ in range(steps):
        if at_x >= at_y:
            high, y, at_y = y, x, at_x
            x = high - share * (high - low)
            at_x = function(x)
            best = max(best, (at_x, x))
        else:
            low, x, at_x = x, y, at_y
            y = low + share * (high - low)
            at_y = function(y)
            best = max(best, (at_y, y))
    return best
