"""Loops that are affine in two gains: p(z) = base + a S + b R, each part in balls.

A wall on a held device is one of them (``balls``). So are PD control inside a simulator, admittance
control, PID with one gain given, and two devices that a spring and a damper couple. Each class here
holds the numbers of one kind, and makes the three parts at the precision that is set.

A simulated joint under a torque that is held and late is a device in z (``device.discrete``), its
velocity the engine's own. PD inside of the engine's step is a torque of the same step, but for what
the rules "implicit-damping" and "implicit" take after the step: the velocity, and by the latter the
position, z times as much. An admittance moves a robot as a mass M on a damper D would move under
the measured force -Ke x, w samples late:

    p = z^w (M (z-1)^2/T + D V + K T X) + Ke T X,

V and X the two sides of its rule of integration: z - 1 and z for the forward rule. PID control
adds an integrator T/(z - 1) to the position. Two devices under forces +-f, f of e = x1 - x2, are
one plant G1 + G2; what both have of rigid motion is a common factor of all parts, since their
common drift does not change e: it is divided out.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, reduce
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from jaxstab.arrays import Array
from jaxstab.model.balls import (
    Factored,
    LoopFactors,
    SampledDevice,
    Triple,
    ball_loop,
    ball_triple,
    in_fractions,
    plant_in_balls,
)
from jaxstab.model.device.device import Device
from jaxstab.model.device.discrete import Simulated, sampled_steps
from jaxstab.model.device.parts import FIRST_BITS, exact, flint, remembered, working_precision
from jaxstab.model.filters import NO_FILTERS, Filter, Velocity, given_filters

if TYPE_CHECKING:
    from flint import arb, fmpq_poly

    from jaxstab.model.loop import LoopParameters

Rationals = tuple["fmpq_poly", "fmpq_poly", "fmpq_poly"]

Exact = int | float | Fraction | np.integer[Any]
Coefficient = Exact | tuple[Exact, Exact]
"""An exact number, or the lowest and the highest of an interval."""


class AffineParts:
    """The source of base, S and R in balls of the precision that is set; it is hashable.

    ``pivot`` is the part of its chart, where that has the degree of p(z).
    """

    pivot: ClassVar[int] = 0

    @property
    def is_one_force(self) -> bool:
        """True if both gains act in one force, computed and held as one."""
        return True

    def triple(self) -> Triple:
        """The parts of p(z), without a common power of z; from exact numbers where it has such."""
        parts = self.rational()
        if parts is None:
            raise NotImplementedError
        return Triple.from_parts(*map(Factored.from_rational, parts))

    def rational(self) -> "Rationals | None":
        """The parts in exact numbers, if they are such, with common powers of z."""
        return None

    def polynomial(self, first: float, second: float) -> "fmpq_poly | None":
        """p(z) in exact numbers, if the parts are such."""
        parts = self.rational()
        if parts is None:
            return None
        base, by_first, by_second = parts
        a, b = exact(first), exact(second)
        return base + a * by_first + b * by_second

    def opened(self, first: float, second: float) -> tuple[Factored, Factored]:
        """D and N of the open loop N/D, opened where no gain moves the leading coefficient."""
        chart, a, b = chart_of(self), flint.arb(first), flint.arb(second)
        triple = affine_triple(chart)
        if not chart.are_gains:
            a, b = chart.of_gains(a, b, _weights(affine_triple(self), chart.by))
        return triple.base, triple.stiffness.scaled(a).plus(triple.damping.scaled(b))

    def is_reciprocal(self, start: tuple[float, float], along: tuple[float, float]) -> bool:
        """True if the roots of p(z) have the product 1 or -1 for all gains start + t along.

        Then some root is on the circle or outside for all t.
        """
        parts, p0 = self.rational(), self.polynomial(*start)
        if parts is None or p0 is None:
            return False
        a, b = map(exact, along)
        q = a * parts[1] + b * parts[2]
        highest = max(p0.degree(), q.degree())
        lowest = next((k for k in range(highest) if p0[k] != 0 or q[k] != 0), highest)
        return lowest < highest and any(
            all(part[lowest] == sign * part[highest] for part in (p0, q)) for sign in (1, -1)
        )


@remembered(512)
def affine_triple(parts: AffineParts) -> Triple:
    """The parts of p(z) in balls of the precision that is set; the last ones are remembered."""
    return parts.triple()


@dataclass(frozen=True)
class Chart(AffineParts):
    """A loop p = base + a S + b R over what moves its leading coefficient, by two other gains.

    Let l = w_0 + a w_1 + b w_2 be that coefficient, in units of that of the part ``by``. The two
    others of 1/l, a/l and b/l are the gains of p/l, in which the stable set is bounded.
    """

    of: AffineParts
    by: int = 0
    weights: tuple[float, float, float] = (1.0, 0.0, 0.0)

    @property
    def are_gains(self) -> bool:
        """True if the gains do not move the leading coefficient: they are those of the chart."""
        return self.weights == (1.0, 0.0, 0.0)

    def triple(self) -> Triple:
        """The parts of p/l."""
        whole = affine_triple(self.of)
        if self.are_gains:
            return whole
        parts = [part.without_windows() for part in whole]
        pivot = parts.pop(self.by)
        leading = pivot.leading
        others = [
            part if part.degree < whole.degree else _lowered(part, pivot, leading) for part in parts
        ]
        return Triple.from_parts(pivot, *others)

    def of_gains(self, first: Array, second: Array, balls: Any = None) -> tuple[Array, Array]:
        """Gains as those of the chart, by its weights or by these in balls."""
        if self.are_gains:
            return first, second
        whole = [1.0, first, second]
        weights = balls or self.weights
        leading = sum(weight * x for weight, x in zip(weights, whole, strict=True))
        del whole[self.by]
        return whole[0] / leading, whole[1] / leading

    @property
    def shares(self) -> tuple[float, float]:
        """Of the gains of the chart in 1: what is left of it is that of the pivot."""
        first, second = (weight for k, weight in enumerate(self.weights) if k != self.by)
        return first, second

    def whole(self, first: Array, second: Array) -> list[Array]:
        """1/l, a/l and b/l at gains of the chart."""
        left = 1.0 - self.shares[0] * first - self.shares[1] * second
        parts = [first, second]
        parts.insert(self.by, np.where(np.abs(left) < 1e-7, 0.0, left))  # digits are lost
        return parts

    def gains(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Gains of the chart as those of the loop."""
        if self.are_gains:
            return first, second
        unit, first, second = self.whole(first, second)
        return first / unit, second / unit


def _lowered(part: Factored, pivot: Factored, leading: "arb") -> Factored:
    """A part less so much of another one of its degree that the highest powers cancel."""
    own = part.plus(pivot.scaled(-part.leading / leading))
    return own._replace(rest=flint.arb_poly(own.rest.coeffs()[: part.degree - sum(own.known)]))


@lru_cache(maxsize=128)
def chart_of(parts: AffineParts) -> Chart:
    """The chart of a loop."""
    with working_precision(FIRST_BITS):
        whole = affine_triple(parts)
        if max(whole.stiffness.degree, whole.damping.degree) < whole.degree:
            return Chart(parts)
        highest = [k for k, part in enumerate(whole) if part.degree == whole.degree]
        pivot = parts.pivot if parts.pivot in highest else highest[0]
        first, second, third = (float(weight.mid()) for weight in _weights(whole, pivot))
    return Chart(parts, pivot, (first, second, third))


def _weights(whole: Triple, pivot: int) -> "list[arb]":
    """The weights of base and gains in the leading coefficient of p(z), over that of one part."""
    leading = [part.leading if part.degree == whole.degree else flint.arb(0) for part in whole]
    return [value / leading[pivot] for value in leading]


@dataclass(frozen=True)
class WallParts(AffineParts):
    """The parts of a wall on a held device."""

    loop: "LoopParameters"

    def triple(self) -> Triple:
        """The parts of p(z)."""
        return ball_triple(self.loop)


@dataclass(frozen=True)
class GivenParts(AffineParts):
    """Polynomials that are given, the highest power first."""

    base: tuple[Coefficient, ...]
    first: tuple[Coefficient, ...]
    second: tuple[Coefficient, ...]

    def triple(self) -> Triple:
        """The parts of p(z)."""
        return Triple.from_parts(*map(_given, (self.base, self.first, self.second)))

    def rational(self) -> "Rationals | None":
        """The parts in exact numbers; None if some are intervals."""
        sides = self.base, self.first, self.second
        if any(isinstance(c, tuple) for side in sides for c in side):
            return None
        base, first, second = map(_rational, sides)
        return base, first, second


def _given(falling: tuple[Coefficient, ...]) -> Factored:
    rising = falling[::-1]
    if not any(isinstance(c, tuple) for c in rising):
        return Factored.from_rational(_rational(falling))
    balls = [
        reduce(flint.arb.union, map(flint.arb, map(exact, c if isinstance(c, tuple) else (c,))))
        for c in rising
    ]
    power = next(k for k, ball in enumerate(balls) if not ball.is_zero())  # "!= 0": surely not 0
    return Factored(flint.arb_poly(balls[power:]), power)


def _rational(falling: tuple[Coefficient, ...]) -> "fmpq_poly":
    return flint.fmpq_poly(list(map(exact, falling[::-1])))


# ------------------------------------------------------------------------------------- simulators
@dataclass(frozen=True)
class SimulatedParts(AffineParts):
    """PD control of a simulated joint; ``is_outside`` of its engine, or inside of its step."""

    joint: Simulated
    is_outside: bool
    substeps: int
    delay_steps: int

    def rational(self) -> "Rationals":
        """The parts of p(z) in exact numbers, by kp and kd."""
        below, (by_kp, by_kd), lag = sampled_steps(self.joint, self.substeps, self.delay_steps)
        z, rule = flint.fmpq_poly([0, 1]), "" if self.is_outside else self.joint.integrator
        by_kp *= z if rule == "implicit" else 1
        by_kd *= z if rule in ("implicit-damping", "implicit") else 1
        return below * z**lag, by_kp, by_kd


# ------------------------------------------------------------------------------------- admittance
RULES = ("forward", "backward", "explicit", "trapezoid")


@dataclass(frozen=True)
class AdmittanceParts(AffineParts):
    """A virtual mass and damper that a robot follows, against an environment; by M and D.

    ``environment`` is its stiffness, ``robot`` from command to position.
    """

    pivot = 1  # endless masses are the small gains of the chart

    environment: float
    sample_time: float
    delay_samples: int
    rule: str
    stiffness: float
    robot: Filter
    force_filter: Filter

    def rational(self) -> "Rationals":
        """The parts of p(z) in exact numbers, by M and D."""
        (robot, slow), (read, smooth) = (
            in_fractions(each.per_sample(self.sample_time).sections)
            for each in (self.robot, self.force_filter)
        )
        z, period = flint.fmpq_poly([0, 1]), exact(self.sample_time)
        by_damping, position = {
            "forward": (z - 1, z),
            "backward": (z * (z - 1), z),
            "explicit": (z - 1, z**0),
            "trapezoid": ((z * z - 1) / 2, (z + 1) ** 2 / 4),
        }[self.rule]
        below = slow * smooth * z**self.delay_samples
        force = robot * read * exact(self.environment) + below * exact(self.stiffness)
        return force * position * period, below * (z - 1) ** 2 / period, below * by_damping

    def in_units(self) -> tuple["AdmittanceParts", tuple[float, float]]:
        """The same loop with T = 1 and Ke = 1, and what 1 of its M and D is."""
        period, wall = self.sample_time, self.environment
        filters = self.robot.per_sample(period), self.force_filter.per_sample(period)
        spring = self.stiffness / wall
        unit = AdmittanceParts(1.0, 1.0, self.delay_samples, self.rule, spring, *filters)
        return unit, (wall * period**2, wall * period)


# -------------------------------------------------------------------------------------------- PID
@dataclass(frozen=True)
class PidParts(AffineParts):
    """A held device under kp x + ki I + kd V x, one of the three given; by the two others.

    ``late`` is the loop with the delay of kd.
    """

    loop: "LoopParameters"
    late: "LoopParameters"
    given: str
    value: float
    rule: str

    @property
    def is_one_force(self) -> bool:
        """True if kd has the delay of the others."""
        return self.given == "kd" or self.late == self.loop

    def triple(self) -> Triple:
        """The parts of p(z), by the two other gains in the order kp, ki, kd."""
        base, parts = self.sides()
        if self.value:
            base = base.plus(parts[self.given].scaled(self.value))
        return Triple.from_parts(
            base, *(part for name, part in parts.items() if name != self.given)
        )

    def opened(self, first: float, second: float) -> tuple[Factored, Factored]:
        """D and N of the open loop N/D: all three gains, the given one too, act in one force."""
        base, parts = self.sides()
        others = iter((first, second))
        gains = [self.value if name == self.given else next(others) for name in parts]
        above = [part.scaled(gain) for part, gain in zip(parts.values(), gains, strict=True)]
        return base, above[0].plus(above[1]).plus(above[2])

    def sides(self) -> tuple[Factored, dict[str, Factored]]:
        """The denominator of device and integrator, and the numerators behind the gains."""
        own = ball_loop(self.loop)
        late = own if self.late is self.loop else ball_loop(self.late)
        lag, one = max(own.lag, late.lag), flint.arb_poly([1])
        half, period = flint.fmpq(1, 2), exact(float(self.loop.sample_time))
        summed = {
            "backward": Factored(one * period, power=1),
            "forward": Factored(one * period),
            "trapezoid": Factored(one * (half * period), at_minus_one=1),
        }[self.rule]
        has_sum = self.given != "ki" or self.value != 0.0
        pole = Factored(one, at_one=int(has_sum))
        by_position = _late(own.numerator.times(own.walls[0]), lag - own.lag)
        by_velocity = _late(late.numerator.times(late.walls[1]), lag - late.lag)
        parts = {
            "kp": pole.times(by_position),
            "ki": by_position.times(summed),
            "kd": pole.times(by_velocity),
        }
        return _late(pole.times(own.free), lag - own.lag), parts


# ---------------------------------------------------------------------------------------- coupling
@dataclass(frozen=True)
class CouplingParts(AffineParts):
    """Two held devices, a spring and a damper between them; by stiffness and damping."""

    devices: tuple[Device, Device]
    sample_time: float
    delays_samples: tuple[float, float]
    velocity: Velocity | None

    def triple(self) -> Triple:
        """The parts of p(z) without the common motion, by stiffness and damping."""
        (n1, d1, lag1, v1), (n2, d2, lag2, v2) = (
            plant_in_balls(device, self.sample_time, delay)
            for device, delay in zip(self.devices, self.delays_samples, strict=True)
        )
        shared, drift = min(lag1, lag2), min(d1.at_one, d2.at_one)
        first, second = (d.divided(0, drift, 0) for d in (d1, d2))

        def both(one: Factored, other: Factored) -> Factored:
            one = _late(one, lag2 - shared).times(second)
            return one.plus(_late(other, lag1 - shared).times(first))

        velocity = both(v1, v2) if v1 and v2 else None
        whole = SampledDevice(both(n1, n2), d1.times(second), max(lag1, lag2), velocity)
        filters = given_filters(self.velocity, None) or NO_FILTERS
        return LoopFactors.from_plant(whole, self.sample_time, filters).triple


def _late(part: Factored, samples: int) -> Factored:
    return part._replace(power=part.power + samples) if samples else part
