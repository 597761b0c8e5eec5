"""The five dimensionless parameters (Table I): what is allowed for them."""

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Numbers, is_traced
from jaxstab.numbers import checked
from jaxstab.numbers import require_x64 as require_x64  # offered here, too

GAMMA_LIMIT = 1e4
DELTA_LIMIT = 1e3
GAIN_LIMIT = 1e150


def checked_gain(name: str, value: Numbers) -> Numbers:
    """Return a wall gain alpha or beta; raise ValueError for a concrete one beyond +-1e150."""
    return checked(name, value, -GAIN_LIMIT, GAIN_LIMIT)


def checked_gamma(gamma: Numbers) -> Numbers:
    """Return gamma; raise ValueError for a concrete one outside [0, 1e4]."""
    return checked("gamma", gamma, 0.0, GAMMA_LIMIT)


def checked_delta(delta: Numbers) -> Numbers:
    """Return delta; raise ValueError for a concrete one outside [0, 1e3]."""
    return checked("delta", delta, 0.0, DELTA_LIMIT)


def checked_delay(delay: Numbers) -> Float64[np.ndarray, "*grid"]:
    """Return the delay in samples as a NumPy array, for it decides the degree of p(z).

    Raises:
        TypeError: the delay is traced by jit, vmap or grad.
        ValueError: a delay is negative, infinite or NaN.
    """
    if is_traced(delay):
        raise TypeError(
            "delay must be a concrete number because it sets the degree of p(z); close over it or "
            "mark it static instead of tracing it."
        )
    return np.asarray(checked("delay", delay, 0.0), np.float64)
