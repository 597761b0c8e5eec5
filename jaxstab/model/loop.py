"""A haptic loop in SI units as numbers: device, hand, sampling, delay, estimator and filter."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache, wraps
from itertools import product
from math import inf, ulp
from typing import Any, ClassVar, ParamSpec, Self, TypeVar

import numpy as np

from jaxstab.arrays import (
    Numbers,
    constant,
    is_any_jax,
    is_any_traced,
    is_jax,
    is_traced,
    load_jax,
    namespace,
)
from jaxstab.model.balls import linear_loop
from jaxstab.model.device import Device, Hand
from jaxstab.model.device.device import in_steps
from jaxstab.model.device.parts import MassSpringDamper
from jaxstab.model.device.sampling import gain_units
from jaxstab.model.filters import Average, Filter, Velocity, filter_on, given_filters, known_filters
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.model.plant import LONGEST_DELAY, TracedDelay, by_name
from jaxstab.numbers import (
    checked,
    checked_number,
    in_doubles,
    require_kind,
    require_together,
    require_x64,
)
from jaxstab.shown import call_text

MECHANICS = "device_mass", "device_damping", "hand_mass", "hand_damping", "hand_stiffness"
_NUMBERS = *MECHANICS, "sample_time", "delay"

Values = TypeVar("Values", bound=Numbers)

Arguments = ParamSpec("Arguments")

Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True, repr=False)
class LoopParameters:
    """The checked fields of ``jaxstab.HapticLoop``, and their dimensionless numbers (Table I)."""

    sample_time: Numbers
    device_mass: Numbers = None
    device_damping: Numbers = None
    hand_mass: Numbers = 0.0
    hand_damping: Numbers = 0.0
    hand_stiffness: Numbers = 0.0
    delay: Numbers = 0.0
    velocity: Velocity | None = None
    position: Filter | None = None
    device: Device | None = None

    _whole_delay: ClassVar[int | None] = None  # in samples; no field

    def __post_init__(self) -> None:
        self._refuse_mixed_fields()
        for name in _NUMBERS:
            value, checker = getattr(self, name), checked_number
            if _is_array(value):
                checker = checked
                require_x64(value)
            is_left_out = value is None and name in MECHANICS[:2]  # beside a device
            if not (is_left_out or is_traced(value)):
                is_open = name in ("device_mass", "sample_time")
                number = checker(name, value, 0.0, is_open=is_open)
                value = value if is_jax(value) else number
            object.__setattr__(self, name, in_doubles(value))
        shape = self.shape  # which refuses arrays that do not broadcast
        if not is_any_traced(self.delay, self.sample_time):
            samples = self.delay_samples
            if np.any(samples > LONGEST_DELAY):
                samples, delay = np.broadcast_arrays(samples, self.delay)
                longest = np.argmax(samples)
                raise ValueError(
                    f"the delay is {samples.flat[longest]:g} samples, {delay.flat[longest]:g} s; "
                    f"give {LONGEST_DELAY:g} samples at most, in s; a delay in samples is "
                    "multiplied by sample_time."
                )
            whole = {int(samples)} if np.ndim(samples) == 0 else set(samples.astype(int).flat)
            if len(whole) == 1:
                object.__setattr__(self, "_whole_delay", whole.pop())
        if 0 not in shape:
            self._refuse_odd_units()
        given_filters(self.velocity, self.position)
        is_one = not shape or is_traced(self.sample_time)
        periods = [self.sample_time] if is_one else np.unique(self.sample_time).tolist()
        own = in_steps(self.device) if self.device else None
        if own and is_one and not is_any_traced(self.delay, self.sample_time):
            own.steps(float(self.sample_time), float(self.delay_samples))
        mechanism = self.device.mechanism if self.device else None
        velocity = filter_on(self.velocity, mechanism) if self.velocity else None
        for chain, period in product(filter(None, (velocity, self.position)), periods):
            chain.checked(period)

    def __repr__(self) -> str:
        given = ((field, getattr(self, field.name)) for field in fields(self))
        changed = {
            field.name: value
            for field, value in given
            if is_jax(value) or np.ndim(value) or value != field.default
        }
        return call_text(type(self).__name__, changed)

    def __dir__(self) -> list[str]:
        for_computing = {"body", "filters", "held_device", "in_floats", "linear"}
        for_computing |= {"tree_flatten", "tree_unflatten"}
        return [name for name in super().__dir__() if name not in for_computing]

    def _refuse_mixed_fields(self) -> None:
        if self.device is None:
            missing = [name for name in MECHANICS[:2] if getattr(self, name) is None]
            if missing:
                raise TypeError(f"{missing[0]} is missing; give it, or device=jaxstab.Device....")
            return
        require_kind("device", self.device, Device)
        for name in MECHANICS:
            value = getattr(self, name)
            is_given = name in MECHANICS[:2] and value is not None
            if is_given or is_any_traced(value) or np.any(value):
                raise TypeError(
                    f"{name} is given beside device; a device has its own mass and damping, and is "
                    "held by device.held_by(jaxstab.Hand...): give one or the other."
                )

    def _refuse_odd_units(self) -> None:
        """Refuse one mass whose gains lose digits in float64 when they are made dimensionless."""
        least = 2.0**-900  # that of ``gain_units``
        if is_any_traced(self.device_mass, self.hand_mass, self.sample_time):
            return  # before anything is computed, which each of many loops would leave in a program
        body = self.body
        if body is None or is_any_traced(body.mass):
            return
        (shortest, longest), (lightest, heaviest) = (
            (x, x) if isinstance(x, float) else (float(np.min(x)), float(np.max(x)))
            for x in (self.sample_time, body.mass)
        )
        for period, mass in ((shortest, heaviest), (longest, lightest)):
            sizes = period, period * period
            if min(sizes) / max(mass, 1.0) >= least and max(sizes) / min(mass, 1.0) <= 1.0 / least:
                continue
            raise ValueError(
                f"sample_time is {period:g} s for a mass of {mass:g} kg, which float64 does not "
                "hold without dimensions; give SI units."
            )

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape to which the fields broadcast, () for one loop; ValueError if they do not.

        Example:
            >>> masses, delays = [0.1, 0.2, 0.3], [[0.0], [1e-3]]
            >>> loops = jaxstab.HapticLoop(
            ...     device_mass=masses, device_damping=0.1, sample_time=1e-3, delay=delays
            ... )
            >>> loops.shape, loops.verdict(1000.0, 10.0).shape
            ((2, 3), (2, 3))
        """
        return require_together(**array_fields(self))

    @property
    def body(self) -> MassSpringDamper | None:
        """Device and hand as one mass on a spring and a damper; None for any other device."""
        if self.device is not None:
            return self.device.one_mass()
        damping = self.device_damping + self.hand_damping
        return MassSpringDamper(self.device_mass + self.hand_mass, damping, self.hand_stiffness)

    @property
    def held_device(self) -> Device:
        """The device with its hand, also where both are given as numbers of one mass."""
        if self.device is not None:
            return self.device
        device = Device.mass_spring_damper(self.device_mass, damping=self.device_damping)
        numbers = {"damping": self.hand_damping, "stiffness": self.hand_stiffness}
        if not (self.hand_mass or any(numbers.values())):
            return device
        return device.held_by(Hand.mass_spring_damper(self.hand_mass, **numbers))

    @property
    def _one_body(self) -> MassSpringDamper:
        body = self.body
        if body is None:
            raise TypeError(
                f"the device ({self.device}) is not one mass: it has none of the paper's numbers."
            )
        return body

    @property
    def mass(self) -> Numbers:
        """Effective mass m in kg, eq. (1)."""
        return self._one_body.mass

    @property
    def gamma(self) -> Numbers:
        """Dimensionless physical stiffness k T^2/m, eq. (12)."""
        return self._one_body.stiffness * (self.sample_time**2 / self.mass)

    @property
    def delta(self) -> Numbers:
        """Dimensionless physical damping b T/m, eq. (12)."""
        return self._one_body.damping * (self.sample_time / self.mass)

    @property
    def linear(self) -> LinearLoop:
        """The loop as p(z) = base + alpha stiffness + beta damping; TypeError if JAX traces it."""
        loop = self.in_floats()
        return linear_loop(loop, loop._units)

    def in_floats(self) -> Self:
        """The loop in plain numbers; TypeError if JAX traces it, or fields are arrays."""
        refuse_arrays(self)
        if not is_any_jax(self):
            return self
        if is_any_traced(self):
            raise TypeError(
                "the loop is traced; give one of concrete numbers, made outside of jit, vmap and "
                "grad."
            )
        floats: Self = load_jax().tree.map(float, self)
        return floats

    @property
    def delay_samples(self) -> Numbers:
        """Delay t_d/T in samples; whole if it is so up to the rounding of the division."""
        if is_any_traced(self.delay, self.sample_time):
            delay = self._traced_delay()
            return delay.whole + delay.fraction
        samples = np.float64(self.delay) / np.float64(self.sample_time)
        nearest = np.rint(samples)
        is_whole = abs(samples - nearest) <= 4.0 * np.spacing(samples)
        if np.ndim(samples):
            return np.where(is_whole, nearest, samples)
        return float(nearest if is_whole else samples)

    @property
    def slice(self) -> dict[str, Any]:
        """The numbers gamma, delta and delay of all walls of the loop, by name (Table I).

        The delay is a TracedDelay where JAX traces it or the sampling period.

        Example:
            >>> loop = jaxstab.HapticLoop(
            ...     device_mass=0.1, device_damping=1.5, hand_mass=0.1, sample_time=1e-3, delay=1e-3
            ... )
            >>> loop.mass, loop.delay_samples
            (0.2, 1.0)
            >>> int(jaxstab.verdict(loop.alpha(2000.0), loop.beta(20.0), **loop.slice))
            1
        """
        is_traced_delay = is_any_traced(self.delay, self.sample_time)
        delay = self._traced_delay() if is_traced_delay else self.delay_samples
        return by_name(self.gamma, self.delta, delay)

    def _traced_delay(self) -> TracedDelay:
        whole = self._whole_delay
        if whole is None:
            raise TypeError(
                "the delay in samples is traced, but its whole part sets the degree of p(z): make "
                "the loop outside of jit, vmap and grad and give it to the function as an argument."
            )
        fraction = self.delay / self.sample_time - whole
        # A whole delay stays so up to the rounding of the division, its derivative unchanged.
        is_less, xp = fraction <= 4.0 * ulp(whole), namespace(fraction)
        fraction = fraction - xp.where(is_less, constant(fraction), 0.0)
        return TracedDelay(whole, fraction, longest=whole)

    def tree_flatten(self) -> tuple[tuple[Any, ...], tuple[int | None, Device | None]]:
        """Return the parts that JAX traces, and the others: whole samples of delay, a device.

        Windows in s become whole numbers of samples, which are not traced.
        """
        numbers = (getattr(self, name) for name in _NUMBERS)
        filters = (_counted(chain, self.sample_time) for chain in (self.velocity, self.position))
        return (*numbers, *filters), (self._whole_delay, self.device)

    @classmethod
    def tree_unflatten(
        cls, fixed: tuple[int | None, Device | None], parts: Iterable[Any]
    ) -> "LoopParameters":
        """Return a loop made of such parts, unchecked: JAX may put anything in their place."""
        loop = object.__new__(cls)
        names = (*_NUMBERS, "velocity", "position", "_whole_delay", "device")
        for name, value in zip(names, (*parts, *fixed), strict=True):
            object.__setattr__(loop, name, in_doubles(value))
        return loop

    @property
    def filters(self) -> dict[str, Any]:
        """Estimator and filter in units of one sample, as keywords of five-number functions."""
        chains = {"velocity": self.velocity, "position": self.position}
        return {
            name: chain and chain.per_sample(self.sample_time) for name, chain in chains.items()
        }

    @property
    def _units(self) -> tuple[Numbers, Numbers]:
        """The units of stiffness and damping, as factors: powers of two for general devices."""
        if self.device is None or self.body is not None:
            return self.sample_time**2 / self.mass, self.sample_time / self.mass
        refuse_arrays(self)
        return gain_units(self.device, self.sample_time, self.delay_samples)

    def alpha(self, stiffness: Values) -> Values:
        """Dimensionless stiffness K T^2/m of a wall of stiffness K in N/m (Table I)."""
        return stiffness * self._units[0]

    def beta(self, damping: Values) -> Values:
        """Dimensionless damping B T/m of a wall of damping B in N s/m (Table I)."""
        return damping * self._units[1]

    def stiffness(self, alpha: Values) -> Values:
        """Wall stiffness K in N/m for a dimensionless stiffness alpha (Table I)."""
        return alpha / self._units[0]

    def damping(self, beta: Values) -> Values:
        """Wall damping B in N s/m for a dimensionless damping beta (Table I)."""
        return beta / self._units[1]


def array_fields(loop: LoopParameters) -> dict[str, Numbers]:
    """Return the fields of a loop that are arrays, by name."""
    given = {name: getattr(loop, name) for name in _NUMBERS}
    return {name: value for name, value in given.items() if _is_array(value)}


def refuse_arrays(loop: LoopParameters) -> None:
    """Raise TypeError if fields of a loop are arrays."""
    if array_fields(loop):
        raise TypeError(
            f"the loop has fields of shape {loop.shape}, but one loop is needed here; "
            "jaxstab.limits_of, regions_of and the methods about given walls accept arrays."
        )


def _is_array(value: Numbers) -> bool:
    return type(value) is not float and (
        isinstance(value, list | tuple) or getattr(value, "ndim", 0) > 0
    )


def as_one(loops: Sequence[LoopParameters]) -> Any:
    """Return loops of one mass, which differ in mechanics and times, as one that has arrays."""
    names = "device_mass", "device_damping", "hand_stiffness", "delay", "sample_time"
    bodies = {x: vars(x._one_body).values() for x in dict.fromkeys(loops)}
    numbers = {x: (*body, x.delay, x.sample_time) for x, body in bodies.items()}
    columns = dict(zip(names, np.array([numbers[loop] for loop in loops]).T, strict=True))
    first = loops[0]
    if len({loop.sample_time for loop in loops}) == 1:
        columns["sample_time"] = first.sample_time
    return type(first)(**columns, velocity=first.velocity, position=first.position)


def unit_loop(
    gamma: float, delta: float, delay: float, velocity: Velocity | None, position: Filter | None
) -> LoopParameters:
    """Return the loop of dimensionless numbers: K is alpha, and B is beta."""
    return LoopParameters(
        sample_time=1.0,
        device_mass=1.0,
        device_damping=delta,
        hand_stiffness=gamma,
        delay=delay,
        velocity=velocity,
        position=position,
    )


def unit_loops(
    velocity: Velocity | None, position: Filter | None
) -> Callable[[float, float, float], LoopParameters | None]:
    """A function that makes the loop of gamma, delta and delay, for m = T = 1.

    None where there is none, as where JAX traced the numbers, so that nobody checked them.
    """
    filters = known_filters(velocity, position) or (None, None)

    @lru_cache(maxsize=64)
    def loop_of(gamma: float, delta: float, delay: float) -> LoopParameters | None:
        if not (min(gamma, delta, delay) >= 0.0 and gamma + delta < inf):
            return None
        return unit_loop(gamma, delta, delay, *filters)

    return loop_of


def _counted(chain: Any, sample_time: Numbers) -> Any:
    if isinstance(chain, Velocity):
        return Velocity(_counted(chain.filter, sample_time))
    if not isinstance(chain, Filter):
        return chain
    return Filter(
        tuple(s.per_sample(sample_time) if isinstance(s, Average) else s for s in chain.sections)
    )


def refuses_loops(
    method: str,
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Let a function of dimensionless numbers name the right method if it is given a loop."""

    def decorate(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        @wraps(function)
        def call(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
            if arguments and isinstance(arguments[0], LoopParameters):
                raise TypeError(
                    f"{function.__name__} takes dimensionless numbers and no HapticLoop; call "
                    f"loop.{method}, or give **loop.slice: loop.gamma, loop.delta and the delay."
                )
            return function(*arguments, **options)

        return call

    return decorate
