"""A device behind a zero-order hold and a delay: N(z) and D(z) in pairs, with proved bounds.

In time units of the sampling period T position over force is n(s)/d(s), d monic. With its companion
form (A, B, C), exp of [[A, B], [0, 0]] over 1 - f and over f, in balls of python-flint, is how the
state moves and what a held force adds to it, and so

    G(z) = z^-w N(z) / D(z),     D(z) = det(z - exp(A))

(lemma V10 of docs/proofs.md). The precision is raised until all coefficients, in powers of z, of
z - 1 and of z + 1, are known to more digits than pairs of float64 have.

The last section bounds what forces do that arrive late (``late_cosines``).
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor, inf, isfinite, ldexp, log2, nextafter
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxstab.model.device.device import Device
from jaxstab.model.device.parts import Rational, balls_of, exact, working_precision
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import NO_FILTERS, Filters, Polynomial, Transfer
from jaxstab.model.linear_loop import Bounded, LinearLoop, SampledPlant, linear_loop
from jaxstab.model.parameters import LONGEST_DELAY
from jaxstab.numbers import checked_number
from jaxstab.rounding import RAISED_FEW

if TYPE_CHECKING:
    from flint import arb, arb_poly, fmpq

Ball = Any  # of python-flint
Matrix = Any  # of such balls
_FIRST_BITS, _MOST_BITS = 256, 1 << 12
_WANTED_BITS = 112  # of each coefficient: pairs have 107
_NOTHING = 2.0**-400  # of the size of all: a coefficient that small may be 0
_MOST_BINARY_DIGITS = 900  # of a unit: products of numbers in it are float64 still
_FASTEST = 14  # power of two: poles per sampling period


@dataclass(frozen=True)
class SampledDevice:
    """A device as a sampled controller meets it, for gains in powers of two of SI units.

    Attributes:
        plant: N(z) and D(z), of one number each; N is what alpha multiplies.
        sample_time: T in s.
        stiffness_unit: a power of two in m/N: alpha is K stiffness_unit, without rounding.
        damping_unit: a power of two in m/(N s): beta is B damping_unit, without rounding.
        device: with its hands and actuators.
        delay: in samples.
    """

    plant: SampledPlant
    sample_time: float
    stiffness_unit: float
    damping_unit: float
    device: Device
    delay: float

    def transfers(self, filters: Filters | None = None) -> tuple[Transfer, Transfer]:
        """The arguments of ``linear_loop``: V(z), for beta, less its difference, and P(z).

        Without filters that is the difference over one sample.
        """
        velocity, position = filters or NO_FILTERS
        estimator = velocity.filter.transfer(self.sample_time)
        unit = DoubleDouble.from_value(
            self.stiffness_unit / self.damping_unit
        )  # the power of two next to T
        return estimator.scaled(unit / self.sample_time), position.transfer(self.sample_time)

    def loop(self, filters: Filters | None = None) -> LinearLoop:
        """Return p(z) as base + alpha stiffness + beta damping; see ``transfers``."""
        return linear_loop(self.plant, *self.transfers(filters))


def sampled_device(device: Device, sample_time: float, delay: float) -> SampledDevice:
    """A device, with its hands and actuators, behind a zero-order hold and a delay in samples.

    Raises: see ``jaxstab.conventions``, the range of the delay being [0, 500]; ValueError also if
    the device moves by more or less within a sample than float64 can say.

    Source: the modified z-transform; Van Loan (1978) for the exponential.
    """
    period = checked_number("sample_time", sample_time, 0.0, is_open=True, unit="s")
    return _sampled(
        device, period, checked_number("delay", delay, 0.0, LONGEST_DELAY, unit="samples")
    )


class _Balls(NamedTuple):
    """N(z) and D(z) in balls, and the same in powers of z - 1 and of z + 1."""

    straight: "tuple[arb_poly, arb_poly]"
    about_one: "tuple[arb_poly, arb_poly]"
    about_minus_one: "tuple[arb_poly, arb_poly]"

    @property
    def are_known(self) -> bool:
        """Whether each coefficient is known to the digits that are wanted, or next to 0."""
        return all(is_known(polynomial) for pair in self for polynomial in pair)


@lru_cache(maxsize=512)
def _sampled(device: Device, sample_time: float, delay: float) -> SampledDevice:
    import flint

    whole, fraction = divmod(delay, 1.0)
    bits = _FIRST_BITS
    while True:
        with working_precision(bits):
            balls = _balls(device.compliance(), sample_time, fraction)
            if balls.are_known or bits >= _MOST_BITS:
                unit = _binary_digits(sum(map(abs, balls.straight[0].coeffs()), flint.arb(0)))
                plant = _rounded(balls, unit, lag=int(whole) + (fraction > 0.0))
                break
        bits *= 2
    period = _binary_digits(flint.arb(sample_time))
    numbers = [pair.hi for pair in (*plant.numerator, *plant.denominator)] + [*plant.errors]
    is_finite = all(map(isfinite, numbers))
    if max(abs(unit), abs(unit - period)) > _MOST_BINARY_DIGITS or not is_finite:
        raise ValueError(
            f"the device ({device}) moves by about 2^{unit} m per N within a sampling period of "
            f"{sample_time:g} s; give SI units, and no pole so unstable that float64 overflows."
        )
    units = ldexp(1.0, unit), ldexp(1.0, unit - period)
    return SampledDevice(plant, sample_time, *units, device, delay)


def _balls(compliance: Rational, sample_time: float, fraction: float) -> _Balls:
    import flint

    above, below = in_samples(compliance, sample_time)
    late = flint.arb(exact(fraction)) if fraction else None
    numerator, denominator = OneSample.from_compliance(above, below).of_samples(late)
    zeros = next(power for power in range(len(below)) if below[power] != 0)
    zeros_above = 1 if above[0] == 0 else 0
    plus, minus = flint.arb_poly([1, 1]), flint.arb_poly([-1, 1])
    return _Balls(
        (numerator, denominator),
        (_without(numerator(plus), zeros_above), _without(denominator(plus), zeros)),
        (numerator(minus), denominator(minus)),
    )


def in_samples(compliance: Rational, sample_time: float) -> tuple[list["arb"], list["arb"]]:
    """Numerator and monic denominator, lowest power first, with T as the unit of time.

    A coefficient that is 0 is the exact 0. ValueError: a pole vanishes within a sampling period.
    """
    above, below = (balls_of(polynomial) for polynomial in compliance)
    above, below = _monic(above, below, sample_time)
    if _speed(below) > _FASTEST:
        raise ValueError(
            f"the device has a pole at 2^{_speed(below)} or so per sampling period of "
            f"{sample_time:g} s; give SI units, and leave out what is faster than 2^{_FASTEST}."
        )
    return above, below


def _monic(
    above: list[Ball], below: list[Ball], sample_time: float
) -> tuple[list[Ball], list[Ball]]:
    import flint

    period = flint.arb(exact(sample_time))
    degree, leading = len(below) - 1, below[-1]
    below = [value / leading * period ** (degree - k) for k, value in enumerate(below)]
    above = [value / leading * period ** (degree - k) for k, value in enumerate(above)]
    return above + [flint.arb(0)] * (degree - len(above)), [*below[:-1], flint.arb(1)]


def _speed(below: list[Ball]) -> int:
    """Return the exponent of a power of two next to the largest root, but for a factor of 2."""
    degree = len(below) - 1
    sizes = [(degree - k, c) for k, c in enumerate(below[:-1]) if c != 0]
    return max((_binary_digits(c) // root for root, c in sizes), default=0)


class OneSample(NamedTuple):
    """A device in the time of its fastest pole, and what its states do within a sample.

    ``speed`` is how many such times a sample has, ``whole`` what a force that is held for a whole
    sample does to the position.
    """

    above: list[Ball]
    below: list[Ball]
    speed: "arb"
    transition: Matrix
    denominator: Any
    whole: Any

    @classmethod
    def from_compliance(cls, above: list[Ball], below: list[Ball]) -> "OneSample":
        """A device from its compliance, as ``in_samples`` has it."""
        above, below, speed = in_fastest_time(above, below)
        sample = held(below, speed)
        transition = without_force(sample)
        one = cls(above, below, speed, transition, transition.charpoly(), None)
        return one._replace(whole=one.moved(force_of(sample)))

    def moved(self, column: Matrix) -> Any:
        """What states do to the position, as a polynomial in z."""
        import flint

        return flint.arb_poly(position_after(self.above, self.transition, self.denominator, column))

    def of_samples(self, fraction: Ball | None) -> tuple[Any, Any]:
        """N(z) and D(z), for a fraction of a sample with one sample of delay more (V10)."""
        if fraction is None:
            return self.whole, self.denominator
        import flint

        later = self.moved(force_of(held(self.below, (1 - fraction) * self.speed)))
        return flint.arb_poly([-1, 1]) * later + self.whole, self.denominator


def in_fastest_time(above: list[Ball], below: list[Ball]) -> "tuple[list[Ball], list[Ball], arb]":
    """Return a device in a unit of time in which its numbers are of size 1.

    The last number is how many of them a sample has, a power of two.
    """
    import flint

    order, speed = len(below) - 1, _speed(below)
    above, below = (
        [value * flint.arb(2) ** (speed * (power - order)) for power, value in enumerate(row)]
        for row in (above, below)
    )
    return above, below, flint.arb(2) ** speed


def position_after(
    above: list[Ball],
    transition: Matrix,
    denominator: "arb_poly",
    column: Matrix,
) -> list[Ball]:
    """Return C adj(z - A) v, the lowest power first, by det(z - A): what a state v does to z^k."""
    import flint

    order, row = len(above), _matrix([above])
    responses = []
    for _ in range(order):
        responses.append((row * column)[0, 0])
        column = transition * column
    # It is the part without negative powers of D(z) (h_1/z + h_2/z^2 + ...).
    falling = [
        sum((denominator[order - i] * responses[k - i] for i in range(k + 1)), flint.arb(0))
        for k in range(order)
    ]
    return falling[::-1]


def held(below: list[Ball], time: Ball) -> Matrix:
    """Return exp of [[A, B], [0, 0]] times a time (Van Loan 1978)."""
    return (generator(below) * time).exp()


def generator(below: list[Ball]) -> Matrix:
    """Return [[A, B], [0, 0]], A the companion matrix, B the last unit vector."""
    order = len(below) - 1
    rows: list[list[Any]] = [[0] * (order + 1) for _ in range(order + 1)]
    for row in range(order):
        rows[row][row + 1] = 1  # beyond the states: the force
    rows[order - 1][:order] = [-value for value in below[:order]]
    return _matrix(rows)


def without_force(matrix: Matrix) -> Matrix:
    """The transition of the states, from the result of ``held``."""
    return _matrix([row[:-1] for row in matrix.tolist()[:-1]])


def force_of(matrix: Matrix) -> Matrix:
    """The effect of a force on the states, from the result of ``held``."""
    return _matrix([row[-1:] for row in matrix.tolist()[:-1]])


def _matrix(rows: list[list[Any]]) -> Any:
    import flint

    return flint.arb_mat(rows)


def _without(polynomial: "arb_poly", zeros: int) -> "arb_poly":
    """Return a polynomial of which that many of the lowest coefficients are known to be 0."""
    import flint

    return flint.arb_poly([flint.arb(0)] * zeros + polynomial.coeffs()[zeros:])


def is_known(polynomial: "arb_poly") -> bool:
    """Whether each coefficient is known to the digits that are wanted, or next to 0."""
    return are_known(polynomial.coeffs(), _WANTED_BITS, _NOTHING)


def are_known(balls: "list[arb]", bits: int, nothing: float) -> bool:
    """Whether balls have this many bits, or are next to 0 compared with the largest of them."""
    least = max((ball.abs_lower() for ball in balls), key=float, default=0.0) * nothing
    return all(ball.rel_accuracy_bits() >= bits or ball.abs_upper() <= least for ball in balls)


def _binary_digits(ball: Ball) -> int:
    """Return the exponent of a power of two that is at most twice or half as large."""
    mantissa, exponent = abs(ball).mid().man_exp()
    return int(exponent) + int(abs(mantissa)).bit_length() - 1


# -------------------------------------------------------------------------------------- rounding


def _rounded(balls: _Balls, unit: int, lag: int) -> SampledPlant:
    import flint

    scale = flint.arb(2) ** -unit
    straight, about_one, about_minus_one = (
        ([bounded(c * scale) for c in _falling(n)], [bounded(c) for c in _falling(d)])
        for n, d in balls
    )
    return SampledPlant(
        numerator=_values(straight[0]),
        denominator=_values(straight[1]),
        lag=lag,
        errors=(_errors(straight[0]), _errors(straight[1])),
        at_one=(about_one[0][-1], about_one[1][-1]),
        at_minus_one=(about_minus_one[0][-1], about_minus_one[1][-1]),
        shifted=(
            _values(about_one[0]),
            _values(about_one[1]),
            _turned(_values(about_minus_one[0])),
            _turned(_values(about_minus_one[1])),
        ),
    )


def bounded(ball: "arb") -> Bounded:
    """Return the nearest pair of float64, and a bound of its distance from all of a ball."""
    high = float(ball.mid())
    low = float((ball - high).mid()) if isfinite(high) else 0.0
    total = high + low
    rest = ball - high - low
    error = 0.0 if rest == 0 else nextafter(float(rest.abs_upper()) * RAISED_FEW, inf)
    return Bounded(DoubleDouble(total, low - (total - high)), error)


def _falling(polynomial: "arb_poly") -> list["arb"]:
    return polynomial.coeffs()[::-1]


def _values(coefficients: list[Bounded]) -> Polynomial:
    return tuple(coefficient.value for coefficient in coefficients)


def _errors(coefficients: list[Bounded]) -> float:
    return sum(coefficient.error for coefficient in coefficients) * RAISED_FEW


def _turned(falling: Polynomial) -> Polynomial:
    """Return the coefficients in powers of -z - 1 by those in powers of z + 1."""
    degree = len(falling) - 1
    return tuple(-c if (degree - k) % 2 else c for k, c in enumerate(falling))


# How strongly a force whose changes arrive late moves the samples of a device.
#
# Each change of the computed force should act after the delay L, and acts up to J samples later. So
# the force is wrong by the last changes, at most N(s) of them at the time s after L, T = 1:
#
#     N(s) = n + 1 for s < f,   N(s) = n from there on,      n = floor(J),  f = J - n,   0 <= s < 1.
#
# From sample to sample the states of (A, B, C) move by x -> F x + what the force adds. With b(s)
# what an impulse at the time s after L adds at the next sample, c(z) = C adj(z - F) and D(z) as
# above, errors of this kind move the samples of the position at the angle theta by no more
# than sqrt(Q)/|D| times the changes (lemma J1 of docs/proofs.md),
#
#     Q = c(z) M c(1/z)',     M = J times the integral of N b b',     |z| = 1,
#
# a cosine sum of as many terms as the device has states. The integral over a whole sample is the
# Gramian of one sample; that over s < f covers the time in which an (n + 1)-th change may still be
# missing. Q is finite where D vanishes.


def late_cosines(device: Device, sample_time: float, delay: float, jitter: float) -> list["arb"]:
    """Return q of Q = q_0 + 2 q_1 cos(theta) + 2 q_2 cos(2 theta) + ..., in SI units.

    L is the delay, ``jitter`` is J in samples.
    """
    import flint

    return _late_cosines(device, sample_time, delay, jitter, flint.ctx.prec)


@lru_cache(maxsize=256)
def _late_cosines(
    device: Device, sample_time: float, delay: float, jitter: float, bits: int
) -> list["arb"]:
    import flint

    del bits  # the precision is set: here it only tells balls apart
    given = in_samples(device.compliance(), sample_time)
    above, below, speed = in_fastest_time(*given)
    order = len(below) - 1
    transition, whole = _after(below, speed)
    gramian = whole * floor(jitter)
    for start, end in _windows(delay % 1.0, jitter % 1.0):
        onward, _ = _after(below, (1 - end) * speed)
        _, window = _after(below, (end - start) * speed)
        gramian += onward * window * onward.transpose()
    weights = (gramian * (speed * flint.arb(exact(jitter)))).tolist()
    denominator = transition.charpoly()
    units = [[int(i == j) for i in range(order)] for j in range(order)]
    columns = [flint.arb_mat([unit]).transpose() for unit in units]
    rows = [
        flint.arb_poly(position_after(above, transition, denominator, column)) for column in columns
    ]
    zero = flint.arb_poly([])
    total = zero
    for row, weighted in zip(rows, weights, strict=True):
        other = sum((p * w for p, w in zip(rows, weighted, strict=True)), zero)
        reverse = [other[order - 1 - power] for power in range(order)]
        total += row * flint.arb_poly(reverse)
    return [total[order - 1 + lag] for lag in range(order)]


def _windows(start: float, length: float) -> list[tuple["fmpq", "fmpq"]]:
    """The intervals of a sample that a window covers, which may continue in the next sample."""
    begin, end = exact(start), exact(start) + exact(length)
    pieces = [(begin, min(end, exact(1.0))), (exact(0.0), end - 1)]
    return [piece for piece in pieces if piece[0] < piece[1]]


def _after(below: list[Ball], time: "arb") -> "tuple[Matrix, Matrix]":
    """Return F, and the Gramian, over a time: the integral of exp(A t) B B' exp(A' t) (Van Loan).

    They are formed over a time in which the device's numbers are of size 1, then doubled.
    """
    import flint

    order, doublings = len(below) - 1, max(0, ceil(log2(float(time)))) if time > 0 else 0
    rows = [[flint.arb(0)] * (2 * order) for _ in range(2 * order)]
    for row in range(order - 1):
        rows[row][row + 1], rows[order + row + 1][order + row] = flint.arb(-1), flint.arb(1)
    for column in range(order):
        rows[order - 1][column] = below[column]
        rows[order + column][2 * order - 1] = -below[column]
    rows[order - 1][2 * order - 1] = flint.arb(1)
    blocks = (flint.arb_mat(rows) * (flint.arb(time) / flint.arb(2) ** doublings)).exp().tolist()
    turned = flint.arb_mat([row[order:] for row in blocks[order:]])
    transition = turned.transpose()
    gramian = transition * flint.arb_mat([row[order:] for row in blocks[:order]])
    for _ in range(doublings):
        gramian = gramian + transition * gramian * transition.transpose()
        transition = transition * transition
    return transition, gramian
