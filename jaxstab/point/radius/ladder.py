"""The error bound of a spectral radius, from verdicts on p(r z) for a ladder of radii r.

All roots are inside the circle of radius + error, and not all inside that of radius - error; each
side is one verdict (lemma R3 of docs/proofs.md). The steps of the ladder have a ratio of 4.
"""

from collections.abc import Callable

from jaxstab.arrays import Array, namespace, repeat_while
from jaxstab.conventions import STABLE, UNSTABLE
from jaxstab.point.verdict.recursion import FLOAT_UNIT

_STEPS = tuple(2.0**power for power in range(-50, -5, 2))  # relative bounds that are tried


def proved_error(codes: Callable[[Array], Array], radius: Array) -> Array:
    """Return bounds of the errors of radii, infinite where even 2^-6 of the radius is not proved.

    Args:
        codes: gives the verdicts on p(r z) / r^n for radii r of shape (2, *radius.shape).
        radius: the estimates, > 0.
    """
    xp = namespace(radius)
    steps = xp.asarray(_STEPS)
    sides = xp.stack([xp.ones_like(radius), -xp.ones_like(radius)])
    wanted = xp.stack([xp.full_like(radius, STABLE), xp.full_like(radius, UNSTABLE)])

    def prove(state: tuple[Array, Array]) -> tuple[Array, Array]:
        step, error = state
        scale = radius * (1.0 + sides * steps[step])
        tried = abs(scale - radius) * (1.0 + 4.0 * FLOAT_UNIT)
        is_proved = xp.isinf(error) & (codes(scale) == wanted)
        return step + 1, xp.where(is_proved, tried, error)

    def is_open(state: tuple[Array, Array]) -> Array:
        step, error = state
        return (step < len(_STEPS)) & xp.any(xp.isinf(error))

    start = xp.asarray(0), xp.full_like(sides, xp.inf)
    return xp.max(repeat_while(is_open, prove, start)[1], axis=0)
