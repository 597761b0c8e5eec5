"""The five dimensionless parameters (Table I): where they come from, what is allowed for them."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from math import ulp
from typing import ParamSpec, TypeVar

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Numbers, is_traced
from jaxstab.numbers import checked, checked_number
from jaxstab.numbers import require_x64 as require_x64  # offered here, too

GAMMA_LIMIT = 1e4
DELTA_LIMIT = 1e3
GAIN_LIMIT = 1e150

Values = TypeVar("Values", bound=Numbers)
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True)
class HapticLoop:
    """A haptic device held by a hand, and the sampled loop that renders a virtual wall on it.

    Source: eqs. (1) and (12), Table I. Every field is a finite number in SI units.

    Args:
        device_mass: effective mass of the device at the handle in kg, > 0.
        device_damping: physical damping of the device in N s/m, >= 0.
        sample_time: sampling period T in s, > 0.
        hand_mass: mass of the hand and arm in kg, >= 0.
        hand_damping: damping of the hand in N s/m, >= 0.
        hand_stiffness: stiffness of the hand in N/m, >= 0.
        delay: time delay t_d of the loop in s, >= 0, beside the half sample of the hold.

    Raises:
        TypeError: a value is not a real number.
        ValueError: a value is NaN, infinite or outside its range.
    """

    device_mass: float
    device_damping: float
    sample_time: float
    hand_mass: float = 0.0
    hand_damping: float = 0.0
    hand_stiffness: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            is_positive = field.name in ("device_mass", "sample_time")
            checked_number(field.name, getattr(self, field.name), 0.0, is_open=is_positive)

    @property
    def mass(self) -> float:
        """Effective mass m in kg, eq. (1)."""
        return self.device_mass + self.hand_mass

    @property
    def gamma(self) -> float:
        """Dimensionless physical stiffness k T^2/m, eq. (12)."""
        return self.hand_stiffness * self.sample_time**2 / self.mass

    @property
    def delta(self) -> float:
        """Dimensionless physical damping b T/m, eq. (12)."""
        return (self.device_damping + self.hand_damping) * self.sample_time / self.mass

    @property
    def delay_samples(self) -> float:
        """Delay t_d/T in samples; whole where it is whole up to the rounding of the division."""
        samples = self.delay / self.sample_time
        nearest = float(round(samples))
        return nearest if abs(samples - nearest) <= 4.0 * ulp(samples) else samples

    def alpha(self, stiffness: Values) -> Values:
        """Dimensionless stiffness K T^2/m of a wall of stiffness K in N/m (Table I)."""
        return stiffness * (self.sample_time**2 / self.mass)

    def beta(self, damping: Values) -> Values:
        """Dimensionless damping B T/m of a wall of damping B in N s/m (Table I)."""
        return damping * (self.sample_time / self.mass)

    def stiffness(self, alpha: Values) -> Values:
        """Wall stiffness K in N/m for a dimensionless stiffness alpha (Table I)."""
        return alpha * (self.mass / self.sample_time**2)

    def damping(self, beta: Values) -> Values:
        """Wall damping B in N s/m for a dimensionless damping beta (Table I)."""
        return beta * (self.mass / self.sample_time)


def refuses_loops(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Let a function of dimensionless numbers say how to call it when a HapticLoop is given."""

    @wraps(function)
    def call(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        if arguments and isinstance(arguments[0], HapticLoop):
            raise TypeError(
                f"{function.__name__} takes dimensionless numbers and no HapticLoop; give "
                "loop.gamma, loop.delta, loop.delay_samples."
            )
        return function(*arguments, **options)

    return call


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
