"""C6. Whether a wall is passive, as the isolation of zeros of one cosine sum.

A wall behind a sampler, a delay n + f and a hold is passive with the damping delta where, in the
notation of ``paper.rules``,

    delta - R - f (1 - f) |H|^2 / (4 delta) > 0

for all angles. R and |H|^2 are cosine sums, so the left side is one, and it is positive if it has
no zero in (0, pi) and is positive at 0 (``circle``).
"""

from math import floor

from jaxstab.exact.circle import is_positive
from jaxstab.model.device.parts import decided


def is_passive(alpha: float, beta: float, delta: float, delay: float) -> bool:
    """Whether a wall is proved passive with a damping > 0; False also where balls do not tell.

    Example:
        >>> from jaxstab.exact.passive import is_passive
        >>> is_passive(1.9, 0.0, delta=1.0, delay=0.0), is_passive(2.1, 0.0, delta=1.0, delay=0.0)
        (True, False)
    """
    from flint import arb

    whole = floor(delay)

    def answer() -> bool | None:
        a, b, damping = arb(alpha), arb(beta), arb(delta)
        fraction = arb(delay) - whole
        needed = [arb(0)] * (whole + 3)  # coefficients of cos(k theta)
        needed[: whole + 2] = [a / 2, *[a] * whole, a * fraction]
        needed[whole + 1] -= b * (1 - fraction)
        needed[whole + 2] -= b * fraction
        fold = fraction * (1 - fraction) / (4 * damping)
        needed[0] += fold * ((a + b) ** 2 + b**2)
        needed[1] -= fold * 2 * b * (a + b)
        return is_positive([damping - needed[0], *(-c for c in needed[1:])])

    return bool(alpha >= 0.0 and decided(answer))
