"""A loop as the triple (base, stiffness, damping) in balls of python-flint, at any precision.

With the plant z^-lag N/D behind hold and delay, a position filter Np/Dp and an estimator Nv/Dv,

    p(z) = base + K stiffness + B damping = z^lag D Dp Dv + K N Np Dv + B N Nv Dp,

K in N/m and B in N s/m, up to powers of z. The fields of a loop are taken as the exact numbers that
they are. The filters are those that software with rounded parameters runs (``filters``), and so
exactly rational; N and D come from one exponential in balls (lemma V10 of docs/proofs.md).

Whether a root lies at z = 1 or z = -1 exactly is no question for balls, but for the structure, and
what the structure says is kept beside the rest (``Factored``):

- D has as many roots at 1 as the device has rigid-body poles at s = 0, V has one;
- a device that is even in s (nothing damps it) has, behind a whole delay, D and N that read the
  same backwards: time may run either way. N has an odd degree, so that it vanishes at -1;
- a maximally flat low pass of order n has n roots at -1; those of all filters are counted in exact
  numbers;
- the mean over n samples is (z^n - 1)/(z - 1), with its n - 1 roots on the circle.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from math import inf, nextafter
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from jaxstab.model.device.device import Device, in_steps
from jaxstab.model.device.parts import (
    Modes,
    decided,
    exact,
    flint,
    remembered,
    roots_of,
    working_precision,
)
from jaxstab.model.device.sampling import one_sample
from jaxstab.model.double_double import DoubleDouble, size_sum
from jaxstab.model.filters import (
    NO_FILTERS,
    Filter,
    Filters,
    Section,
    Velocity,
    behind_measured,
    exact_chain,
    given_filters,
)
from jaxstab.model.linear_loop import LinearLoop, Polynomial
from jaxstab.model.plant import GAIN_LIMIT
from jaxstab.rounding import PAIR_UNIT, RAISED

if TYPE_CHECKING:
    from flint import arb, arb_poly, fmpq_poly


class Sampled(Protocol):
    """What balls need of a loop (``jaxstab.model.LoopParameters``): SI units, the delay too."""

    @property
    def held_device(self) -> Device:
        """The device with its hand."""

    @property
    def sample_time(self) -> Any:
        """In s."""

    @property
    def delay_samples(self) -> Any:
        """In samples."""

    @property
    def velocity(self) -> Velocity | None:
        """The estimator."""

    @property
    def position(self) -> Filter | None:
        """The filter."""

    def in_floats(self) -> Any:
        """The loop in plain numbers."""


class Factored(NamedTuple):
    """z^power (z - 1)^at_one (z + 1)^at_minus_one W_n W_m ... rest(z), W_n = (z^n - 1)/(z - 1).

    The rest has no root at 1 or -1 but by accident. A rest of length 0 is the polynomial 0.
    """

    rest: "arb_poly"
    power: int = 0
    at_one: int = 0
    at_minus_one: int = 0
    windows: tuple[int, ...] = ()

    @classmethod
    def from_rational(cls, polynomial: "fmpq_poly") -> "Factored":
        """A polynomial of exact numbers, its roots at 0, 1 and -1 counted; it is not 0."""
        counts = []
        for place in (0, 1, -1):
            counts.append(0)
            while polynomial(place) == 0:
                polynomial //= flint.fmpq_poly([-place, 1])
                counts[-1] += 1
        zeros, at_one, at_minus_one = counts
        return cls(flint.arb_poly(polynomial), zeros, at_one, at_minus_one)

    @property
    def in_fractions(self) -> "fmpq_poly | None":
        """The rest in exact numbers; None where its balls have a radius."""
        rising = self.rest.coeffs()
        if not all(c.is_exact() for c in rising):
            return None
        parts = (c.man_exp() for c in rising)
        return flint.fmpq_poly([flint.fmpq(man) * flint.fmpq(2) ** int(exp) for man, exp in parts])

    @property
    def is_zero(self) -> bool:
        """True for the polynomial 0."""
        return bool(self.rest.length() == 0)

    @property
    def degree(self) -> int:
        """The degree; -1 for 0."""
        if self.is_zero:
            return -1
        of_windows = sum(self.windows) - len(self.windows)
        return int(self.rest.degree()) + self.power + self.at_one + self.at_minus_one + of_windows

    @property
    def known(self) -> tuple[int, int, int]:
        """The numbers of known roots at 0, 1 and -1, but for those of windows."""
        return self.power, self.at_one, self.at_minus_one

    @property
    def leading(self) -> "arb":
        """The coefficient of the highest power, which no known factor changes."""
        return self.rest[self.rest.degree()]

    @property
    def order_at_minus_one(self) -> int:
        """The number of roots at -1, those of windows of an even length included."""
        return self.at_minus_one + sum(n % 2 == 0 for n in self.windows)

    @property
    def is_on_circle(self) -> bool:
        """True if a root lies on the unit circle by structure."""
        return bool(self.at_one or self.at_minus_one or self.windows)

    def times(self, other: "Factored") -> "Factored":
        """Return the product."""
        return Factored(
            self.rest * other.rest,
            self.power + other.power,
            self.at_one + other.at_one,
            self.at_minus_one + other.at_minus_one,
            self.windows + other.windows,
        )

    def scaled(self, factor: "arb | float | int") -> "Factored":
        """Return a multiple; one by the number 0 is the polynomial 0."""
        if factor == 0:
            return Factored(flint.arb_poly([]))
        return Factored(self.rest * flint.arb(factor), *self[1:])

    def plus(self, other: "Factored") -> "Factored":
        """Return the sum, with the roots that the two are known to share."""
        if self.is_zero or other.is_zero:
            return other if self.is_zero else self
        terms, shared = _over_shared((self, other))
        return Factored(terms[0] + terms[1], *shared)

    def divided(self, power: int, at_one: int, at_minus_one: int) -> "Factored":
        """Return the quotient by known factors."""
        counts = self.power - power, self.at_one - at_one, self.at_minus_one - at_minus_one
        return Factored(self.rest, *counts, self.windows)

    def of_radius(self, radius: float) -> "Factored":
        """The polynomial of radius z."""
        rest, r = self._replace(power=0).polynomial(), flint.arb(radius)
        return Factored(rest(flint.arb_poly([0, r])) * r**self.power, self.power)

    def around(self, place: int) -> "arb_poly":
        """The coefficients in powers of s, z = place (1 + s), place = 1 or -1."""
        plain = self.without_windows()
        order = plain.at_one if place == 1 else plain.at_minus_one
        orders = (order, 0) if place == 1 else (0, order)
        others = plain.divided(0, *orders).polynomial()(flint.arb_poly([place, place]))
        return (others * place**order).left_shift(order)

    def without_windows(self) -> "Factored":
        """The same polynomial with the windows multiplied into the rest."""
        if not self.windows:
            return self
        rest, minus = self.rest, self.at_minus_one
        for n in self.windows:
            if n % 2 == 0:  # W_n = (z + 1) (1 + z^2 + ... + z^(n-2))
                minus += 1
                rest *= flint.arb_poly([(k + 1) % 2 for k in range(n - 1)])
            else:
                rest *= flint.arb_poly([1] * n)
        return Factored(rest, self.power, self.at_one, minus)

    def at_end(self, place: int) -> "arb":
        """The value at 1 or -1, which is the exact 0 where the structure knows a root there."""
        known = (place - 1) ** self.at_one * (place + 1) ** self.at_minus_one * place**self.power
        for n in self.windows:
            known *= n if place == 1 else n % 2
        return self.rest(flint.arb(place)) * known if known else flint.arb(0)

    def polynomial(self) -> "arb_poly":
        """The polynomial multiplied out."""
        plain = self.without_windows()
        product = plain.rest
        for root, count in ((1, plain.at_one), (-1, plain.at_minus_one)):
            if count:
                product *= flint.arb_poly([-root, 1]) ** count
        return product.left_shift(plain.power) if plain.power else product


@dataclass(frozen=True)
class Triple:
    """The parts of p(z) = base + K stiffness + B damping, without a common power of z.

    ``yielding`` is the stiffness, if a float64, that takes from the device all the stiffness which
    holds it: a root lies at 1 then.
    """

    base: Factored
    stiffness: Factored
    damping: Factored
    yielding: float | None = None

    @classmethod
    def from_parts(cls, *parts: Factored, yielding: float | None = None) -> "Triple":
        """The three parts without their common power of z."""
        common = min(part.power for part in parts if not part.is_zero)
        own = (part if part.is_zero else part.divided(common, 0, 0) for part in parts)
        base, stiffness, damping = own
        return cls(base, stiffness, damping, yielding)

    def __iter__(self) -> Iterator[Factored]:
        return iter((self.base, self.stiffness, self.damping))

    def monic(self) -> "Triple":
        """The parts over the leading coefficient of the base, which no gain moves."""
        base, *others = (part.without_windows() for part in self)
        unit = 1 / base.leading
        by_stiffness, by_damping = (part.scaled(unit) for part in others)
        rising = (base.rest * unit).coeffs()[:-1]
        base = Factored(flint.arb_poly([*rising, flint.arb(1)]), *base[1:])
        return Triple(base, by_stiffness, by_damping, self.yielding)

    @cached_property
    def degree(self) -> int:
        """The degree of p(z), the largest of all walls."""
        return max(part.degree for part in self)

    def at(self, stiffness: "arb | float", damping: "arb | float") -> Factored:
        """The polynomial of a wall, K and B in the units of the triple."""
        if stiffness == 0 or damping == 0:  # one part less: more roots may be known
            wall = self.stiffness.scaled(stiffness).plus(self.damping.scaled(damping))
            p = self.base.plus(wall)
        else:
            (base, by_stiffness, by_damping), known = self._over_known
            p = Factored(
                base + by_stiffness * flint.arb(stiffness) + by_damping * flint.arb(damping), *known
            )
        if stiffness == self.yielding:
            p = p._replace(rest=known_out(p.rest, 1, 1), at_one=p.at_one + 1)
        return p

    @cached_property
    def _over_known(self) -> "tuple[list[arb_poly], tuple[int, int, int]]":
        """The parts over the roots at 0, 1 and -1 that they share, and how many these are."""
        return _over_shared(self)


def _over_shared(parts: Iterable[Factored]) -> "tuple[list[arb_poly], tuple[int, int, int]]":
    """Polynomials over the roots at 0, 1 and -1 that all but the 0 are known to have."""
    plain = [part.without_windows() for part in parts]
    counts = zip(*(part.known for part in plain if not part.is_zero), strict=True)
    power, at_one, at_minus_one = map(min, counts)
    shared = power, at_one, at_minus_one
    divided = (part if part.is_zero else part.divided(*shared) for part in plain)
    return [part.polynomial() for part in divided], shared


class SampledDevice(NamedTuple):
    """A device z^-lag N/D behind its hold; ``velocity`` is N of a second output, if it has one."""

    numerator: Factored
    denominator: Factored
    lag: int
    velocity: Factored | None = None


@dataclass(frozen=True, eq=False)
class LoopFactors:
    """A loop by its parts: the plant z^-lag N/D, P = Np/Dp and V = Nv/Dv, V in 1/s.

    N is in m/N; D, Dp and Dv have no roots at 1 or -1 but those that are counted. Where the
    velocity is an output of the device, N is 1, and Np and Nv hold what force does to both outputs.
    ``yielding`` is that of the triple.
    """

    numerator: Factored
    denominator: Factored
    lag: int
    position: tuple[Factored, Factored]
    velocity: tuple[Factored, Factored]
    yielding: float | None = None

    @classmethod
    def from_plant(cls, plant: SampledDevice, period: float, filters: Filters) -> "LoopFactors":
        """A plant behind an estimator and a filter."""
        one, behind = Factored(flint.arb_poly([1])), behind_measured(filters[0])
        chains = filters[1], filters[0].filter if behind is None else behind
        (above_p, below_p), (above, below) = (filter_in_balls(x, period) for x in chains)
        if behind is not None and plant.velocity is not None:
            position, velocity = plant.numerator.times(above_p), plant.velocity.times(above)
            return cls(one, *plant[1:3], (position, below_p), (velocity, below))
        difference = one._replace(at_one=1).scaled(1 / exact(period)).times(above)
        return cls(
            *plant[:3], (above_p, below_p), (difference, below._replace(power=below.power + 1))
        )

    @classmethod
    def from_triple(cls, triple: Triple) -> "LoopFactors":
        """A loop of which only the parts of p(z) are known."""
        one = Factored(flint.arb_poly([1]))
        return cls(one, triple.base, 0, (triple.stiffness, one), (triple.damping, one))

    def scaled(self, units: tuple[float, float], radius: float) -> "LoopFactors":
        """The loop of K and B in these units, around a circle of this radius."""
        stiffness, damping = units

        def around(part: Factored) -> Factored:
            return part if radius == 1.0 else part.of_radius(radius)

        (above_p, below_p), (above_v, below_v) = self.position, self.velocity
        return LoopFactors(
            around(self.numerator),
            around(self.denominator).scaled(flint.arb(radius) ** self.lag),
            self.lag,
            position=(around(above_p.scaled(stiffness)), around(below_p)),
            velocity=(around(above_v.scaled(damping)), around(below_v)),
        )

    @property
    def free(self) -> Factored:
        """z^lag D Dp Dv, what p(z) is without a wall."""
        free = self.denominator.times(self.position[1]).times(self.velocity[1])
        return free._replace(power=free.power + self.lag)

    @property
    def walls(self) -> tuple[Factored, Factored]:
        """Np Dv and Nv Dp: what K and B multiply, beside N."""
        (above_p, below_p), (above_v, below_v) = self.position, self.velocity
        return above_p.times(below_v), above_v.times(below_p)

    def wall(self, stiffness: float, damping: float) -> Factored:
        """H = K Np Dv + B Nv Dp."""
        by_stiffness, by_damping = self.walls
        return by_stiffness.scaled(stiffness).plus(by_damping.scaled(damping))

    @cached_property
    def triple(self) -> Triple:
        """The three parts of p(z)."""
        by_gains = (self.numerator.times(wall) for wall in self.walls)
        return Triple.from_parts(self.free, *by_gains, yielding=self.yielding)


def ball_triple(loop: Sampled) -> Triple:
    """The triple of a loop in balls of the precision that is set; the last ones are remembered.

    Raises: TypeError if JAX traces the loop or its fields are arrays; ValueError for a device that
    is too fast for balls (``in_samples``).
    """
    return ball_loop(loop).triple


def ball_loop(loop: Sampled) -> LoopFactors:
    """The parts of a loop, otherwise as ``ball_triple``."""
    return _ball_loop(loop.in_floats())


@remembered(128)
def _ball_loop(loop: Sampled) -> LoopFactors:
    filters = given_filters(loop.velocity, loop.position) or NO_FILTERS
    device, period = loop.held_device, loop.sample_time
    parts = LoopFactors.from_plant(
        plant_in_balls(device, period, loop.delay_samples), period, filters
    )
    if parts.velocity[0].at_one:  # a velocity that is 0 at rest
        parts = replace(parts, yielding=_yielding(device, filters[1].per_sample(period)))
    return parts


def _yielding(device: Device, position: Filter) -> float | None:
    """The K that makes 1 + K P(1) G(1) exactly 0, G(1) the displacement by a constant force."""
    own = in_steps(device)
    moved, force = own.at_rest() if own else device.compliance().at_rest()
    for section in position.sections:
        if section.length is None:
            above, below = exact_chain((section,))
            moved, force = moved * above(1), force * below(1)
    if not moved or not force:
        return None
    stiffness = -force.leading_coefficient() / moved.leading_coefficient()
    number = Fraction(int(stiffness.p), int(stiffness.q))
    if force + moved * stiffness or abs(number) > GAIN_LIMIT or float(number) != number:
        return None
    return float(number)


def plant_in_balls(device: Device, period: float, delay: float) -> SampledDevice:
    """A device behind its hold and a delay in samples."""
    own = in_steps(device)
    if own:
        rational, outputs, lag = own.sampled(period, delay)
        position, *velocity = map(Factored.from_rational, outputs)
        return SampledDevice(position, Factored.from_rational(rational), lag, *velocity)
    _refuse_between_samples(device, period)
    whole, fraction = divmod(delay, 1.0)
    sample = one_sample(device, period)
    above, below = sample.above, sample.below
    late = flint.arb(exact(fraction)) if fraction else None
    numerator, denominator = sample.of_samples(late)
    rigid = next(power for power in range(len(below)) if below[power] != 0)
    zeros = 1 if above[0] == 0 else 0
    # Without damping N(z) reads the same backwards. Its degree is odd, which makes -1 a root, where
    # G(s) is even and forces come at samples, and where it is odd and they come half way.
    terms = ((j + k, c * d) for j, c in enumerate(above) for k, d in enumerate(below))
    parity, *both = {power % 2 for power, product in terms if not product.is_zero()}
    at_minus_one = int(not both and fraction == 0.5 * parity)
    numerator = known_out(known_out(numerator, 1, zeros), -1, at_minus_one)
    return SampledDevice(
        Factored(numerator, 0, zeros, at_minus_one),
        Factored(known_out(denominator, 1, rigid), 0, rigid),
        int(whole) + (fraction > 0.0),
    )


@lru_cache
def _refuse_between_samples(device: Device, period: float) -> None:
    """Refuse a mode of which samples show less than its motion, and that nothing damps.

    Its two poles are one of z, so that a root of p(z) stays there for all gains.
    """
    body = device.mechanism
    for mode in body.modes if isinstance(body, Modes) else ():
        halves = 2 * exact(mode.frequency) * exact(period)
        if mode.damping_ratio or halves.q != 1:
            continue
        with working_precision(512):
            place = flint.acb(0, 2 * flint.arb.pi() * exact(mode.frequency))
            roots = [root for root, _ in roots_of(device.compliance().denominator)]
        if any(abs(root - place) < 1e-30 * abs(place) for root in roots):
            raise ValueError(
                f"the device ({device}) has a mode of {mode.frequency:g} Hz without damping, a "
                f"multiple of half the sampling rate of {1.0 / period:g} Hz: it swings between "
                "the samples, where no gain damps it; give it damping, or another sample time."
            )


def known_out(polynomial: "arb_poly", root: int, count: int) -> "arb_poly":
    """Divide known roots out of a polynomial; the remainder is 0 and dropped."""
    return polynomial // flint.arb_poly([-root, 1]) ** count if count else polynomial


def filter_in_balls(chain: Filter, period: float) -> tuple[Factored, Factored]:
    """Numerator and denominator of a filter in powers of z."""
    above = below = one = Factored(flint.arb_poly([1]))
    for section in chain.per_sample(period).sections:
        n = section.length
        if n is None:
            numerator, denominator = map(Factored.from_rational, in_fractions((section,)))
        else:
            mean = flint.arb_poly([flint.fmpq(1, n)])
            numerator = Factored(mean, windows=(n,) if n > 1 else ())
            denominator = one._replace(power=n - 1)
        above, below = above.times(numerator), below.times(denominator)
    return above, below


def in_fractions(sections: tuple[Section, ...]) -> "tuple[fmpq_poly, fmpq_poly]":
    """Numerator and denominator of a chain in units of one sample, in powers of z, exactly."""
    sides = exact_chain(sections)
    order = max(side.degree() for side in sides)
    above, below = (flint.fmpq_poly([side[order - k] for k in range(order + 1)]) for side in sides)
    return above, below


# The triple in pairs of float64, for grids of walls of one loop: the middles of its balls, at a
# precision that is raised until their radii are less than the rounding of pairs.


@lru_cache(maxsize=64)
def linear_loop(loop: Sampled, units: tuple[float, float]) -> LinearLoop:
    """A loop in plain numbers, of gains in units: alpha is K times the first one."""
    return rounded_triple(lambda: ball_triple(loop), *units)


def rounded_triple(
    triple: Callable[[], Triple], stiffness_unit: float, damping_unit: float
) -> LinearLoop:
    """The loop of a triple in pairs, of gains in units: alpha is K stiffness_unit."""

    def is_known(loop: LinearLoop) -> bool:
        sizes = map(size_sum, loop[:3])
        return all(error <= PAIR_UNIT * x for error, x in zip(loop.errors, sizes, strict=True))

    return decided(lambda: _rounded(triple(), stiffness_unit, damping_unit), is_answered=is_known)


def _rounded(triple: Triple, stiffness_unit: float, damping_unit: float) -> LinearLoop:
    units = 1.0, stiffness_unit, damping_unit
    parts = [part.scaled(1 / exact(unit)) for part, unit in zip(triple, units, strict=True)]
    degree, least = triple.degree, 2  # the least for which the kernels are written
    more = [flint.arb(0)] * (least - degree)  # so often z
    rows = [[part.polynomial()[degree - k] for k in range(degree + 1)] + more for part in parts]
    pairs = [list(map(_nearest, row)) for row in rows]
    ends = [[_nearest(part.at_end(place) * place**degree) for part in parts] for place in (1, -1)]
    errors = [
        RAISED * max(sum(error for _, error in row), *(end[k][1] for end in ends))
        for k, row in enumerate(pairs)
    ]
    polynomials: list[Polynomial] = [tuple(pair for pair, _ in row) for row in (*pairs, *ends)]
    base, stiffness, damping, at_one, at_minus_one = polynomials
    is_free = triple.base.at_one > 0 and (triple.damping.is_zero or triple.damping.at_one > 0)
    return LinearLoop(
        base, stiffness, damping, at_one, at_minus_one, (errors[0], errors[1], errors[2]), is_free
    )


def _nearest(ball: "arb") -> tuple[DoubleDouble, float]:
    """The pair of float64 next to the middle of a ball, and how far from it the ball reaches."""
    high = float(ball.mid())
    low = float((ball - high).mid())
    rest = ball - high - low
    return DoubleDouble(high, low), 0.0 if rest == 0 else nextafter(float(rest.abs_upper()), inf)
