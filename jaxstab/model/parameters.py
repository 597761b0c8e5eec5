"""The five dimensionless parameters (Table I) and their ranges."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, Numbers, is_any_traced
from jaxstab.conventions import AXES
from jaxstab.numbers import checked, require_together
from jaxstab.numbers import require_x64 as require_x64  # offered here, too

GAMMA_LIMIT = 1e4
DELTA_LIMIT = 1e3
GAIN_LIMIT = 1e150
LONGEST_DELAY = 500.0  # samples; with the longest filters p(z) is of a degree below 1024


class TracedDelay(NamedTuple):
    """A delay in samples of which the whole part is known, and the fraction traced by JAX."""

    whole: int
    fraction: Array

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of delays."""
        return np.shape(self.fraction)


def by_name(*numbers: Any) -> dict[str, Any]:
    """Return the last of alpha, beta, gamma, delta and delay, given in this order, as keywords."""
    return dict(zip(AXES[-len(numbers) :], numbers, strict=True))


def checked_gain(name: str, value: Numbers) -> Numbers:
    """Return a wall gain alpha or beta; raise ValueError for a concrete one beyond +-1e150."""
    return checked(name, value, -GAIN_LIMIT, GAIN_LIMIT)


def wall_grid(**gains: Numbers) -> Float64[np.ndarray, "*grid 2"]:
    """Both gains of walls, by their names, on the grid to which they broadcast; never traced."""
    require_together(**gains)
    if is_any_traced(*gains.values()):
        names = " or ".join(gains)
        raise TypeError(f"{names} is traced; give concrete gains, outside of jit, vmap and grad.")
    values = (np.asarray(checked_gain(name, gain), np.float64) for name, gain in gains.items())
    return np.stack(np.broadcast_arrays(*values), axis=-1)


def checked_gamma(gamma: Numbers) -> Numbers:
    """Return gamma; raise ValueError for a concrete one outside [0, 1e4]."""
    return checked("gamma", gamma, 0.0, GAMMA_LIMIT)


def checked_delta(delta: Numbers) -> Numbers:
    """Return delta; raise ValueError for a concrete one outside [0, 1e3]."""
    return checked("delta", delta, 0.0, DELTA_LIMIT)


def checked_delay(delay: Numbers) -> Float64[np.ndarray, "*grid"]:
    """The delay in samples as a NumPy array, for it decides the degree of p(z); never traced."""
    if is_any_traced(delay):
        raise TypeError(
            "delay must be a concrete number because it sets the degree of p(z); close over it or "
            "mark it static instead of tracing it."
        )
    return np.asarray(checked("delay", delay, 0.0, LONGEST_DELAY), np.float64)


def whole_and_fraction(delay: Numbers | TracedDelay) -> tuple[Float64[np.ndarray, "*grid"], Array]:
    """The whole part and the fraction of a delay in samples; errors as ``checked_delay``."""
    if isinstance(delay, TracedDelay):
        return np.asarray(delay.whole, np.float64), delay.fraction
    concrete = checked_delay(delay)
    whole = np.asarray(np.floor(concrete))
    return whole, concrete - whole
