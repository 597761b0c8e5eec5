"""Random loops with estimators and filters, each beside its truth, and walls next to the boundary.

Parameters of filters are numbers that the truth can take over exactly; the loops are hostile as
well as ordinary: cut-offs down to a thousandth of the sampling rate, orders to 24, hands without
stiffness or damping, stiff ones, devices with vibration modes, grips and motors, and delays of
whole samples and of fractions next to them. Two kinds are apart: modes that walls hardly move, and
windows of up to 200 samples.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

import jaxstab
from jaxstab.model import Device, Filter, Hand, Mode, Velocity, by_name
from jaxstab.point.radius import linear_spectral_radius
from jaxstab.point.verdicts import linear_verdict
from tests.truth import devices, filtered
from tests.truth.balls import BallLoop
from tests.truth.boundary import Boundary
from tests.truth.filtered import FilteredLoop, Rational

_HIGHEST_ORDER = 24
_PERIOD = 2.0**-10  # of devices, in s: cut-offs in Hz and per sample are the same numbers
_LONG = (42, 201)  # samples of windows

Factor = tuple[Filter, Rational, int]  # and its order


class Filters(NamedTuple):
    """An estimator and a position filter, as jaxstab is asked for them, and their truth."""

    velocity: Velocity
    position: Filter
    truths: tuple[Rational, Rational]

    def __repr__(self) -> str:
        return repr(self[:2])


@dataclass(frozen=True)
class MassLoop:
    """A device and a hand of one mass; gains are alpha and beta."""

    plant: tuple[float, float, float]  # gamma, delta, delay
    filters: Filters

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "MassLoop":
        """Any loop of the model, hostile ones, too."""
        return cls(_hand(rng), _filters(rng))

    @cached_property
    def balls(self) -> BallLoop:
        """The truth."""
        return self.balls_at(self.plant[2])

    def balls_at(self, delay: float) -> BallLoop:
        """The truth with another delay in samples."""
        return FilteredLoop(*self.plant[:2], delay, *self.filters.truths).balls()

    def verdict(self, alpha: np.ndarray, beta: np.ndarray) -> Any:
        return jaxstab.verdict(alpha, beta, **by_name(*self.plant), **self._named)

    def spectral_radius(self, alpha: np.ndarray, beta: np.ndarray) -> Any:
        return jaxstab.spectral_radius(alpha, beta, **by_name(*self.plant), **self._named)

    def region(self) -> jaxstab.results.StableRegion:
        return jaxstab.stable_region(**by_name(*self.plant), **self._named)

    @property
    def loop(self) -> jaxstab.HapticLoop:
        """The loop as jaxstab is asked for it: K is alpha and B is beta."""
        gamma, delta, delay = self.plant
        body = {"device_mass": 1.0, "device_damping": delta, "hand_stiffness": gamma}
        return jaxstab.HapticLoop(**body, sample_time=1.0, delay=delay, **self._named)

    @property
    def _named(self) -> dict[str, Any]:
        return {"velocity": self.filters.velocity, "position": self.filters.position}


@dataclass(frozen=True)
class DeviceLoop:
    """A device with modes, a hand and a motor; gains are in powers of two of SI units."""

    device: devices.Drawn
    filters: Filters

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "DeviceLoop":
        """Devices as haptics knows them, and some that are stiffer, less damped or later."""
        return cls(devices.drawn(rng)._replace(sample_time=_PERIOD), _filters(rng, _PERIOD))

    @classmethod
    def hardly_moved(cls, rng: np.random.Generator) -> "DeviceLoop":
        """Devices with modes that walls hardly move, next to undamped, at small fractional delays.

        Half of the hands are light and behind weak grips, half of the estimators slow smoothings.
        """
        filters = _slow(rng) if rng.random() < 0.5 else _filters(rng, _PERIOD)
        return cls(_hardly_moved(rng), filters)

    @cached_property
    def balls(self) -> BallLoop:
        """The truth."""
        return self.balls_at(self.device.delay)

    def balls_at(self, delay: float) -> BallLoop:
        """The truth of the same gains with another delay in samples."""
        rest = _PERIOD, delay, *self.filters.truths
        balls = devices.DeviceLoop(self.device.mechanism.system(), *rest).balls()
        return balls.in_units(*self.units)

    def verdict(self, alpha: np.ndarray, beta: np.ndarray) -> Any:
        return linear_verdict(alpha, beta, self.loop.linear)

    def spectral_radius(self, alpha: np.ndarray, beta: np.ndarray) -> Any:
        return linear_spectral_radius(alpha, beta, self.loop.linear)

    def region(self) -> jaxstab.results.StableRegion:
        return self.loop.region().region

    @cached_property
    def loop(self) -> jaxstab.HapticLoop:
        """The loop as jaxstab is asked for it, in SI."""
        period = self.device.sample_time
        return jaxstab.HapticLoop(
            device=device_of(self.device), sample_time=period, delay=self.device.delay * period,
            velocity=self.filters.velocity, position=self.filters.position,
        )  # fmt: skip

    @property
    def units(self) -> tuple[float, float]:
        """K in N/m and B in N s/m times these are the gains."""
        return self.loop.alpha(1.0), self.loop.beta(1.0)


def device_of(drawn: devices.Drawn) -> Device:
    """A drawn device as one of jaxstab, its hand from encoder to motor."""
    modes = [Mode(frequency=f, damping_ratio=z, modal_mass=m) for f, z, m in drawn.modes]
    device = Device.modes(modes, mass=drawn.mass, damping=drawn.damping)
    if drawn.hand is not None:
        mass, damping, stiffness, grip = drawn.hand
        hand = Hand.mass_spring_damper(mass, damping=damping, stiffness=stiffness)
        held = hand if grip is None else hand.with_grip(stiffness=grip[1], damping=grip[0])
        device = replace(device, hands=(held,))  # held_by refuses modes of negative mass
    return device if drawn.bandwidth is None else device.with_actuator(drawn.bandwidth)


def long_window(rng: np.random.Generator) -> MassLoop | DeviceLoop:
    """Return a loop of a mass or of a device, a window of 42 to 200 samples, a short delay."""
    samples = int(np.exp(rng.uniform(*np.log(_LONG))))
    truths = filtered.difference(samples), filtered.average(1)
    filters = Filters(Velocity.difference(samples=samples), Filter(), truths)
    delay = float(rng.choice([0.0, 1.0, rng.uniform(0.0, 3.0), 10.0 ** rng.uniform(-9.0, -1.0)]))
    if rng.random() < 0.5:
        gamma, delta, _ = _hand(rng)
        return MassLoop((gamma, delta, delay), filters)
    return DeviceLoop(devices.drawn(rng)._replace(sample_time=_PERIOD, delay=delay), filters)


def _hardly_moved(rng: np.random.Generator) -> devices.Drawn:
    device = devices.drawn(rng)
    fraction = 10.0 ** rng.uniform(-12.0, -3.0)
    modes = []
    for _ in range(rng.integers(1, 4)):
        frequency = 10.0 ** rng.uniform(0.3, 2.7)
        damping_ratio = rng.choice([0.0, 10.0 ** rng.uniform(-17.0, -6.0)])
        heavier = rng.choice([10.0 ** rng.uniform(3.0, 9.0), 1e12], p=[0.8, 0.2])
        sign = rng.choice([1.0, -1.0], p=[0.7, 0.3])
        modes.append((float(frequency), float(damping_ratio), float(sign * heavier * device.mass)))
    hand = device.hand
    if rng.random() < 0.5:
        mass, damping, grip_damping = (10.0 ** rng.uniform(-5.0, -2.0, 3)).tolist()
        stiffness = float(rng.choice([0.0, 10.0 ** rng.uniform(-3.0, 1.0)]))
        grip = float(rng.choice([0.0, grip_damping])), float(10.0 ** rng.uniform(-3.0, 1.0))
        hand = mass, damping, stiffness, grip
    delay = rng.integers(0, 4) + rng.choice([0.0, fraction, 1.0 - fraction])
    own = device.modes[: 3 - len(modes)]
    return device._replace(modes=own + modes, hand=hand, sample_time=_PERIOD, delay=float(delay))


def _slow(rng: np.random.Generator) -> Filters:
    """Return exponential smoothing of the difference over one sample, over up to 1,000 samples."""
    factor = float(10.0 ** rng.uniform(-3.0, -0.5))
    truth = filtered.times(filtered.difference(1), filtered.exponential(factor))
    return Filters(Velocity.exponential(factor), Filter(), (truth, filtered.average(1)))


def _filters(rng: np.random.Generator, period: float = 1.0) -> Filters:
    """Return an estimator and, for four of ten, a position filter."""
    velocity, v, order = _estimator(rng, period)
    position, p = Filter(), filtered.average(1)
    if rng.random() < 0.4:
        factor, f, more = _factor(rng, period)
        if order + more <= _HIGHEST_ORDER:
            position, p = factor, f
    return Filters(velocity, position, (v, p))


def _hand(rng: np.random.Generator) -> tuple[float, float, float]:
    nyquist = (np.pi * rng.integers(1, 3)) ** 2 * (1.0 + 10.0 ** rng.uniform(-4, -1))
    gammas = 0.0, 10.0 ** rng.uniform(-9, 0), 12.0 * rng.uniform(), nyquist
    deltas = 0.0, 10.0 ** rng.uniform(-9, 1), rng.uniform(0.0, 0.6)
    close = 10.0 ** rng.uniform(-9, -1)
    fraction = rng.choice([0.0, rng.uniform(), close, 1.0 - close], p=[0.5, 0.3, 0.1, 0.1])
    whole = int(rng.choice([rng.integers(0, 4), rng.integers(0, 30)]))
    gamma = rng.choice(gammas, p=[0.2, 0.5, 0.2, 0.1])
    delta = rng.choice(deltas, p=[0.2, 0.5, 0.3])
    return float(gamma), float(delta), float(min(whole + fraction, 30.0))


def _estimator(rng: np.random.Generator, period: float) -> tuple[Velocity, Rational, int]:
    samples = int(rng.choice([rng.integers(1, 5), rng.integers(5, 25)]))
    window = Velocity.difference(samples=samples), filtered.difference(samples), samples
    kind = rng.integers(0, 5)
    if kind == 0:
        return window
    if kind == 1:
        return _rational_estimator(rng, period)
    if kind == 2 and samples < 5:  # a chain on a window
        velocity, v, order = window
    else:
        velocity, v, order = Velocity.difference(samples=1), filtered.difference(1), 1
    filter_, f, more = _factor(rng, period)
    return velocity * filter_, filtered.times(v, f), order + more


def _factor(rng: np.random.Generator, period: float) -> Factor:
    """Return a filter, its truth and its order."""
    cutoff = float(10.0 ** rng.uniform(-3.0, -0.35))
    order = int(rng.choice([1, 2, rng.integers(1, 9)]))
    kind = rng.integers(0, 4)
    if kind <= 1:
        given, true = (
            (Filter.low_pass, filtered.low_pass), (Filter.butterworth, filtered.butterworth),
        )[kind]  # fmt: skip
        return given(cutoff / period, order=order), true(cutoff, order=order), order
    if kind == 2:
        samples = int(rng.integers(2, 9))
        return Filter.average(samples=samples), filtered.average(samples), samples
    factor = float(rng.uniform(0.02, 1.0))
    return Filter.exponential(factor), filtered.exponential(factor), 1


def _rational_estimator(rng: np.random.Generator, period: float) -> tuple[Velocity, Rational, int]:
    """Return (z - 1) (z - a) / (z (z - b) (z - c)), all in sixteenths, so that it is exact."""
    a, b, c = (float(one) / 16.0 for one in rng.integers(-14, 15, 3))
    numerator, denominator = (np.poly(roots).tolist() for roots in ([1.0, a], [0.0, b, c]))
    exact = filtered.rational(
        *([filtered.exact(value) for value in one] for one in (numerator, denominator))
    )
    in_seconds = [value / period for value in numerator]  # V(z) is in 1/s
    return Velocity.transfer_function(in_seconds, denominator), exact, 3


def hostile_walls(rng: np.random.Generator, balls: BallLoop, count: int) -> np.ndarray:
    """Return walls (count, 2), half of them within 1e-6 of the boundary, relative to themselves."""
    points = Boundary(balls).points(rng)
    walls = points[rng.integers(0, len(points), count)]
    sides = rng.choice([-1.0, 0.0, 1.0], (count, 2))
    near = 10.0 ** rng.uniform(-14.0, -6.0, (count, 1))
    far = 10.0 ** rng.uniform(-6.0, 0.5, (count, 1))
    is_near = np.arange(count)[:, None] % 2 == 0
    return walls * (1.0 + sides * np.where(is_near, near, far))
