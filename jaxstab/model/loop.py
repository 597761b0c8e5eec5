"""A haptic loop in SI units as numbers: device, hand, sampling, delay, estimator and filter."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from math import ulp
from typing import ParamSpec, TypedDict, TypeVar

from jaxstab.arrays import Numbers
from jaxstab.model.filters import Filter, Velocity, given_filters
from jaxstab.numbers import checked_number

_LEAST = {  # the least allowed value, and whether it is excluded
    "device_mass": (0.0, True),
    "device_damping": (0.0, False),
    "sample_time": (0.0, True),
    "hand_mass": (0.0, False),
    "hand_damping": (0.0, False),
    "hand_stiffness": (0.0, False),
    "delay": (0.0, False),
}

Values = TypeVar("Values", bound=Numbers)
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class Estimators(TypedDict):
    """Estimator and filter in units of one sample, as keywords of five-number functions."""

    velocity: Velocity | None
    position: Filter | None


@dataclass(frozen=True, kw_only=True)
class LoopParameters:
    """The fields of ``jaxstab.HapticLoop``, checked, and what Table I makes of them."""

    device_mass: float
    device_damping: float
    sample_time: float
    hand_mass: float = 0.0
    hand_damping: float = 0.0
    hand_stiffness: float = 0.0
    delay: float = 0.0
    velocity: Velocity | None = None
    position: Filter | None = None

    def __post_init__(self) -> None:
        for name, (least, is_open) in _LEAST.items():
            checked_number(name, getattr(self, name), least, is_open=is_open)
        given_filters(self.velocity, self.position)
        for chain in (self.velocity.filter if self.velocity else None, self.position):
            if chain is not None:
                chain.transfer(self.sample_time)  # refuses what does not go with the period

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

    @property
    def slice(self) -> tuple[float, float, float]:
        """The numbers gamma, delta and delay of all walls of the loop (Table I)."""
        return self.gamma, self.delta, self.delay_samples

    @property
    def filters(self) -> Estimators:
        """Velocity estimator and position filter in units of one sample."""
        velocity, position = self.velocity, self.position
        return {
            "velocity": None if velocity is None else velocity.per_sample(self.sample_time),
            "position": None if position is None else position.per_sample(self.sample_time),
        }

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


def refuses_loops(
    method: str,
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Let a function of dimensionless numbers name the method to call when a loop is given."""

    def decorate(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        @wraps(function)
        def call(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
            if arguments and isinstance(arguments[0], LoopParameters):
                raise TypeError(
                    f"{function.__name__} takes dimensionless numbers and no HapticLoop; call "
                    f"loop.{method}, or give loop.gamma, loop.delta, loop.delay_samples."
                )
            return function(*arguments, **options)

        return call

    return decorate
