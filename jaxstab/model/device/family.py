"""All loops between two loops: each number that differs runs straight from the one to the other.

A loop at all fractions of a sample of delay is such a family, too.

In powers of z, and over a common power, the loop at t, from 0 to 1, is

    D(z) + z^-lag (alpha P(z) S(z) + beta V(z) R(z)),

P and V the parts of filter and estimator that all loops share. The coefficients of D, S and R are
analytic in t. Pieces of [0, 1] are halved, in balls, until polynomials through their values at
Chebyshev's points are right (lemma B17 of docs/proofs.md).
"""

from dataclasses import dataclass, fields, is_dataclass
from functools import lru_cache, partial, reduce
from math import ceil, cos, floor, inf, nextafter, pi
from operator import mul
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.model.device.device import Device
from jaxstab.model.device.parts import Span, StateSpace, exact, working_precision
from jaxstab.model.device.sampling import (
    OneSample,
    SampledDevice,
    in_samples,
    in_samples_over,
    sampled_device,
)
from jaxstab.model.filters import Filter, Filters, Section, Velocity
from jaxstab.model.loop import LoopParameters
from jaxstab.rounding import RAISED_FEW

# Two values of one kind merged into one, whose numbers run from the one to the other.

_REMEDY = "give two loops that differ in numbers alone: masses, springs, cut-offs, the delay"


def merged(value: Any, other: Any) -> Any:
    """A value in which each number that differs is a span; ValueError if more differs."""
    if type(value) is not type(other) or (_is_whole(value) and value != other):
        raise ValueError(
            f"one loop has {value}, the other {other}: nothing can be proved between them; "
            f"{_REMEDY}."
        )
    if isinstance(value, float) and value != other:
        return Span(value, other)
    if isinstance(value, tuple):
        if len(value) != len(other):
            raise ValueError(
                f"one loop has {len(value)} and the other {len(other)} parts where only numbers "
                f"may differ; {_REMEDY}."
            )
        return tuple(map(merged, value, other))
    if is_dataclass(value) and not isinstance(value, type) and value != other:
        whole = object.__new__(type(value))  # spans are no numbers to be checked
        for field in fields(value):
            pair = getattr(value, field.name), getattr(other, field.name)
            object.__setattr__(whole, field.name, merged(*pair))
        return whole
    if value != other:
        raise ValueError(
            f"one loop has {value!r}, the other {other!r}: nothing can be proved between them; "
            f"{_REMEDY}."
        )
    return value


def _is_whole(value: Any) -> bool:
    """Whether there is no path of loops between this value and another one of its kind."""
    return isinstance(value, StateSpace) or (isinstance(value, Section) and not value.varies)


def value_at(value: Any, share: float) -> Any:
    """Return a value whose spans are numbers, that share of the way from the first to the last."""
    if isinstance(value, Span):
        ends = sorted((value.first, value.last))
        linear = value.first + share * (value.last - value.first)
        return value.last if share == 1.0 else min(max(linear, ends[0]), ends[1])
    if isinstance(value, tuple):
        return tuple(value_at(item, share) for item in value)
    if not has_spans(value):
        return value
    whole = object.__new__(type(value))
    for field in fields(value):
        object.__setattr__(whole, field.name, value_at(getattr(value, field.name), share))
    return whole


def has_spans(value: Any) -> bool:
    """Whether a number of a value is a span."""
    if isinstance(value, Span):
        return True
    if is_dataclass(value) and not isinstance(value, type):
        return any(has_spans(getattr(value, field.name)) for field in fields(value))
    return isinstance(value, tuple) and any(map(has_spans, value))


# A polynomial in z whose coefficients are polynomials in one parameter, over an interval of it.
if TYPE_CHECKING:
    from flint import acb, acb_poly, arb, arb_mat, arb_poly

_MISS_IN_Z = 2.0**-66  # of the size of a polynomial: what its balls may add
_OVERLAP = 1e-6  # of a piece, beyond its ends


@dataclass(frozen=True)
class Piece:
    """Q(z) = sum_jk u^j near_jk (z - 1)^k for |u| <= half, a little beyond, u = t - middle.

    ``near`` are the coefficients in the units of the device, ``far`` those of Q(-z).
    ``remainder`` bounds what either sum misses of Q on the unit circle, but for the rounding of
    each coefficient.
    """

    middle: float
    half: float
    near: Float64[np.ndarray, "power coefficient"]
    far: Float64[np.ndarray, "power coefficient"]
    remainder: float


def rounded_piece(
    middle: float, half: float, terms: list["arb_poly"], missed: "arb", degree: int
) -> Piece | None:
    """The piece of sum_j u^j terms_j, polynomials in z; None where these are not known well enough.

    ``half`` is half its width, at most 1/2; ``missed`` is what the sum misses on the unit circle.
    """
    import flint

    plus, minus = flint.arb_poly([1, 1]), flint.arb_poly([-1, -1])
    forms = [
        [[term(about)[k] for k in range(degree + 1)] for term in terms] for about in (plus, minus)
    ]
    # |z - 1| <= 2
    half_width = flint.arb(half * (1.0 + _OVERLAP))
    weights = [[2**k * half_width**j for k in range(degree + 1)] for j in range(len(terms))]
    worst = max(
        float(
            sum(
                (
                    weight * ball.rad()
                    for pair in zip(weights, form, strict=True)
                    for weight, ball in zip(*pair, strict=True)
                ),
                flint.arb(0),
            ).upper()
        )
        for form in forms
    )
    if not worst <= float(size_on_circle(terms[0])) * _MISS_IN_Z:
        return None
    near, far = (np.array([[float(ball.mid()) for ball in row] for row in form]) for form in forms)
    return Piece(middle, half, near, far, (worst + float(missed.upper())) * RAISED_FEW)


def size_on_circle(polynomial: "arb_poly | acb_poly") -> "arb":
    """Return a bound of |Q(z)| on the unit circle."""
    import flint

    return sum((abs(c).upper() for c in polynomial.coeffs()), flint.arb(0))


_BITS = (256, 1024)
_NODES = 32  # of a piece
_DISC = 6.0  # half-widths: the radius of the disc in which coefficients are bounded
_ARCS = 8  # of half the circle around it
_MISSED_BY = 6e-32  # of their bound there: the interpolation error
_DROPPED, _MOST_MISSED = 2.0**-63, 2.0**-60  # of the size of a polynomial in z
_SMALLEST, _MOST_PIECES = 2.0**-12, 128
_BEYOND = 1e-9, 2.0**-50  # of a half-width, and of t, so that pieces meet


class LoopPiece(NamedTuple):
    """D, S and R for a part of t, each over the power of z that is its degree.

    ``lag`` is that of the plant; S and R are one where no filter changes with t.
    """

    lag: int
    free: Piece
    stiffness: Piece
    damping: Piece

    @property
    def ends(self) -> tuple[float, float]:
        """The ends of the piece, a little beyond it so that pieces meet."""
        middle, half = self.free.middle, self.free.half
        half = half * (1.0 + _BEYOND[0]) + _BEYOND[1]
        return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True)
class LoopFamily:
    """All loops between two: device with hands and actuators, delay (in samples) and filters.

    ``first`` and ``last`` are the devices of the two, sampled; all gains are in the units of the
    first.
    """

    device: Device
    delay: Span
    filters: Filters
    first: SampledDevice
    last: SampledDevice

    @classmethod
    def between(cls, start: LoopParameters, end: LoopParameters) -> "LoopFamily":
        """All loops between two of one sampling period; ValueError if other than numbers differ."""
        period = start.sample_time
        if period != end.sample_time:
            raise ValueError(
                f"sample_time is {period:g} s in one loop and {end.sample_time:g} s in the other; "
                "give two loops of one sampling period."
            )
        loops = start.in_floats(), end.in_floats()
        devices = [loop.held_device for loop in loops]
        delays = [float(loop.delay_samples) for loop in loops]
        filters = [(loop.velocity or Velocity(), loop.position or Filter()) for loop in loops]
        whole: Device = merged(*devices)
        whole.compliance()
        pairs = zip(devices, delays, strict=True)
        ends = [sampled_device(device, period, delay) for device, delay in pairs]
        return cls(whole, Span(delays[0], delays[1]), merged(*filters), ends[0], ends[1])

    def end(self, share: int) -> tuple[SampledDevice, Filters]:
        """Return the first loop (0) or the last one (1)."""
        return (self.first, self.last)[share], value_at(self.filters, float(share))

    @property
    def shared_filters(self) -> Filters:
        """The sections of estimator and position filter that all loops share."""
        velocity, position = self.filters
        return Velocity(_shared(velocity.filter)), _shared(position)

    def is_analytic_within(self, t: "acb") -> bool:
        """Whether the coefficients are proved analytic in a ball of t."""
        period = self.first.sample_time
        if in_samples_over(self.device.compliance(), period, t) is None:
            return False
        velocity, position = self.filters
        polynomials = [*_changing(position, t, period), *_changing(velocity.filter, t, period)]
        return all(c.is_finite() for p in polynomials for c in p.coeffs())

    def polynomials(self, t: "acb", whole: int) -> "list[acb_poly] | None":
        """D, S and R for a ball of t; None where no such loop, or one too fast, may be.

        R is left out where it is S, as no filter changes. ``whole`` are samples of the delay, the
        others are a fraction.
        """
        import flint

        period = self.first.sample_time
        sample = self._sample(t, flint.ctx.prec)
        if sample is None:
            return None
        has_fraction = self.delay.first != self.delay.last or self.delay.first % 1.0 != 0.0
        fraction = _value(self.delay, t) - whole if has_fraction else None
        force, free = map(flint.acb_poly, sample.of_samples(fraction))
        velocity, position = self.filters
        above_k, below_k = _changing(position, t, period)
        above_b, below_b = _changing(velocity.filter, t, period)
        force *= 1 / flint.arb(self.first.stiffness_unit)
        if not has_spans(self.filters):
            return [free, force]
        return [free * below_k * below_b, force * above_k * below_b, force * above_b * below_k]

    def _sample(self, t: "acb", bits: int) -> OneSample | None:
        """What the device does within a sample; None where it may be too fast."""
        period = self.first.sample_time
        if not has_spans(self.device):
            return _constant_sample(self.device, period, bits)
        compliance = in_samples_over(self.device.compliance(), period, t)
        return None if compliance is None else OneSample.from_compliance(*compliance)

    def samples(self) -> list[tuple[float, float, int]]:
        """Intervals of t in which the delay is between two whole samples, and the lower one."""
        # Rounded outwards, so that together they cover all of t.
        low, high = self.delay.first, self.delay.last
        if low == high:
            return [(0.0, 1.0, floor(low))]
        parts = []
        for whole in range(floor(min(low, high)), ceil(max(low, high))):
            ends = sorted((end - low) / (high - low) for end in (whole, whole + 1))
            parts.append(
                (max(0.0, nextafter(ends[0], -inf)), min(1.0, nextafter(ends[1], inf)), whole)
            )
        return parts


@lru_cache(maxsize=16)
def _constant_sample(device: Device, period: float, bits: int) -> OneSample:
    with working_precision(bits):
        return OneSample.from_compliance(*in_samples(device.compliance(), period))


@lru_cache(maxsize=16)
def pieces_of(family: LoopFamily) -> tuple[LoopPiece, ...] | None:
    """Return pieces that cover all of t; None for loops that need too many of them."""
    done: list[LoopPiece] = []
    parts = family.samples()
    waiting = [(0.5 * (low + high), 0.5 * (high - low), whole) for low, high, whole in parts]
    while waiting:
        middle, half, whole = waiting.pop()
        piece = _piece(family, middle, half, whole)
        if piece is not None:
            done.append(piece)
        elif half < _SMALLEST or len(done) + len(waiting) >= _MOST_PIECES:
            return None
        else:
            quarter = 0.5 * half
            waiting += [(middle + quarter, quarter, whole), (middle - quarter, quarter, whole)]
    return tuple(done)


def _piece(family: LoopFamily, middle: float, half: float, whole: int) -> LoopPiece | None:
    import flint

    with working_precision(_BITS[0]):
        missed = _missed(family, middle, half, whole)
        typical = family.polynomials(flint.acb(middle), whole)
        if missed is None or typical is None:
            return None
        sizes = map(size_on_circle, typical)
        if any(miss > size * _MOST_MISSED for miss, size in zip(missed, sizes, strict=True)):
            return None
    for bits in _BITS:
        with working_precision(bits):
            points, inverse = _interpolation(bits)
            values = []
            for point in points:
                place = flint.acb(flint.arb(middle) + half * point)
                values.append(family.polynomials(place, whole) or [])
            if not all(values):
                return None
            columns = [[[c.real for c in p.coeffs()] for p in q] for q in zip(*values, strict=True)]
            candidates = [
                _through(inverse, column, middle, half, bound)
                for column, bound in zip(columns, missed, strict=True)
            ]
            pieces = [piece for piece in candidates if piece is not None]
            if len(pieces) == len(candidates):
                return LoopPiece(whole + 1, pieces[0], pieces[1], pieces[-1])
    return None


def _missed(family: LoopFamily, middle: float, half: float, whole: int) -> "list[arb] | None":
    """Bounds of the interpolation errors of D, S and R; None where they may not be analytic."""
    import flint

    disc = flint.arb(0, _DISC * half)
    if not family.is_analytic_within(flint.acb(middle + disc, disc)):
        return None
    # Real functions take conjugate values in the lower half of the disc.
    most: list[arb] = []
    for k in range(_ARCS):
        place = (
            _DISC * half * flint.acb(0, (k + flint.arb(0.5, 0.5)) * flint.arb.pi() / _ARCS).exp()
        )
        wide = family.polynomials(middle + place, whole)
        if wide is None or not all(c.is_finite() for p in wide for c in p.coeffs()):
            return None
        sizes = [size_on_circle(p) for p in wide]
        most = [max(pair) for pair in zip(sizes, most or sizes, strict=True)]
    return [bound * _MISSED_BY for bound in most]


def _through(
    inverse: "arb_mat", rows: list[list["arb"]], middle: float, half: float, missed: "arb"
) -> Piece | None:
    """Return the piece through values at the nodes; None where it is not good enough."""
    import flint

    size = flint.arb(half)
    powers = (inverse * flint.arb_mat(rows)).tolist()
    terms = [flint.arb_poly([c / size**j for c in row]) for j, row in enumerate(powers)]
    sizes = [sum(map(abs, row), flint.arb(0)).upper() for row in powers]
    while len(terms) > 1 and sizes[-1] < sizes[0] * _DROPPED:
        missed += sizes.pop()
        terms.pop()
    if not missed < sizes[0] * _MOST_MISSED:
        return None
    return rounded_piece(middle, half, terms, missed, len(rows[0]) - 1)


@lru_cache
def _interpolation(bits: int) -> "tuple[list[arb], arb_mat]":
    """Chebyshev's points, rounded, and the matrix from values there to coefficients."""
    import flint

    with working_precision(bits):
        points = [flint.arb(cos(pi * (2 * k + 1) / (2 * _NODES))) for k in range(_NODES)]
        return points, flint.arb_mat([[x**j for j in range(_NODES)] for x in points]).inv()


def _shared(chain: Filter) -> Filter:
    return Filter(tuple(section for section in chain.sections if not has_spans(section)))


# -------------------------------------------------------------------------------- filters in balls
def _changing(chain: Filter, t: "acb", period: float) -> "tuple[acb_poly, acb_poly]":
    """Return numerator and denominator of the sections that change, polynomials of one degree."""
    import flint

    unit = flint.acb_poly([1])
    factors = [_section(section, t, period) for section in chain.sections if has_spans(section)]
    above, below = zip(*factors, strict=True) if factors else ((), ())
    return reduce(mul, above, unit), reduce(mul, below, unit)


def _section(section: Section, t: "acb", period: float) -> "tuple[acb_poly, acb_poly]":
    import flint

    of_t = partial(_value, t=t)
    number = section.ball_number(of_t, flint.arb(exact(period)), flint.arb.pi())
    factors = section.factors(number)
    above = [flint.acb_poly(top) ** power for top, _, power in factors]
    below = [flint.acb_poly(bottom) ** power for _, bottom, power in factors]
    return reduce(mul, above), reduce(mul, below)


def _value(span: float | Span, t: "acb") -> "acb":
    """The value of a number, which may be a span, for a ball of t."""
    import flint

    if not isinstance(span, Span):
        return flint.acb(flint.arb(exact(span)))
    start, end = exact(span.first), exact(span.last)
    return flint.arb(start) + flint.arb(end - start) * t
