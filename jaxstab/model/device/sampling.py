"""A device behind a zero-order hold and a delay: N(z) and D(z) in pairs, with proved bounds.

In time units of the sampling period T position over force is n(s)/d(s), d monic. With its companion
form (A, B, C), exp of [[A, B], [0, 0]] over 1 - f and over f, in balls of python-flint, is how the
state moves and what a held force adds to it, and so

    G(z) = z^-w N(z) / D(z),     D(z) = det(z - exp(A))

(lemma V10 of docs/proofs.md). The precision is raised until all coefficients, in powers of z, of
z - 1 and of z + 1, are known to more digits than pairs of float64 have.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import inf, isfinite, ldexp, nextafter
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxstab.model.device.device import Device
from jaxstab.model.device.parts import Rational, balls_of, exact, working_precision
from jaxstab.model.double_double import DoubleDouble
from jaxstab.model.filters import Filter, Filters, Velocity
from jaxstab.model.linear_loop import Bounded, LinearLoop, SampledPlant, linear_loop
from jaxstab.model.parameters import LONGEST_DELAY
from jaxstab.model.sections import Polynomial, Transfer
from jaxstab.numbers import checked_number
from jaxstab.rounding import RAISED_FEW

if TYPE_CHECKING:
    from flint import acb, acb_poly, arb, arb_poly

Ball = Any  # of python-flint, real or complex
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
        velocity, position = filters or (Velocity(), Filter())
        estimator = velocity.filter.transfer(self.sample_time)
        unit = DoubleDouble.of(
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
    if max(abs(unit), abs(unit - period)) > _MOST_BINARY_DIGITS or not _is_finite(plant):
        raise ValueError(
            f"the device ({device}) moves by about 2^{unit} m per N within a sampling period of "
            f"{sample_time:g} s; give SI units, and no pole so unstable that float64 overflows."
        )
    units = ldexp(1.0, unit), ldexp(1.0, unit - period)
    return SampledDevice(plant, sample_time, *units, device, delay)


def _balls(compliance: Rational, sample_time: float, fraction: float) -> _Balls:
    import flint

    above, below = in_samples(compliance, sample_time)
    part = flint.arb(exact(fraction)) if fraction else None
    numerator, denominator = of_samples(above, below, part)
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
    above, below = (balls_of(part) for part in compliance)
    above, below = _monic(above, below, sample_time)
    if _speed(below) > _FASTEST:
        raise ValueError(
            f"the device has a pole at 2^{_speed(below)} or so per sampling period of "
            f"{sample_time:g} s; give SI units, and leave out what is faster than 2^{_FASTEST}."
        )
    return above, below


def in_samples_over(
    compliance: Rational, sample_time: float, t: "acb"
) -> tuple[list["acb"], list["acb"]] | None:
    """The same for numbers in their spans, for a ball of places; None if a pole may be too fast."""
    import flint

    above, below = (list(map(flint.acb, balls_of(part, t))) for part in compliance)
    if below[-1].contains(0):
        return None
    above, below = _monic(above, below, sample_time)
    return (above, below) if _speed(below) <= _FASTEST else None


def _monic(
    above: list[Ball], below: list[Ball], sample_time: float
) -> tuple[list[Ball], list[Ball]]:
    import flint

    period = flint.arb(exact(sample_time))
    degree, first = len(below) - 1, below[-1]
    below = [value / first * period ** (degree - k) for k, value in enumerate(below)]
    above = [value / first * period ** (degree - k) for k, value in enumerate(above)]
    return above + [flint.arb(0)] * (degree - len(above)), [*below[:-1], flint.arb(1)]


def _speed(below: list[Ball]) -> int:
    """Return the exponent of a power of two next to the largest root, but for a factor of 2."""
    degree = len(below) - 1
    sizes = [(degree - k, one) for k, one in enumerate(below[:-1]) if one != 0]
    return max((_binary_digits(one) // root for root, one in sizes), default=0)


def of_samples(above: list[Ball], below: list[Ball], part: Ball | None) -> tuple[Any, Any]:
    """Return N(z) and D(z), for a fraction of a sample with one sample of delay more (B14)."""
    import flint

    above, below, speed = in_fastest_time(above, below)
    sample = held(below, speed)
    transition = without_force(sample)
    denominator = transition.charpoly()
    has_complex = any(isinstance(one, flint.acb) for one in below)
    polynomial = flint.acb_poly if has_complex else flint.arb_poly

    def moved(column: Matrix) -> Any:
        return polynomial(position_after(above, transition, denominator, column))

    whole = moved(force_of(sample))
    if part is None:
        return whole, denominator
    later = moved(force_of(held(below, (1 - part) * speed)))
    return polynomial([-1, 1]) * later + whole, denominator


def in_fastest_time(above: list[Ball], below: list[Ball]) -> "tuple[list[Ball], list[Ball], arb]":
    """Return a device in a unit of time in which its numbers are of size 1.

    The last number is how many of them a sample has, a power of two.
    """
    import flint

    order, speed = len(below) - 1, _speed(below)
    above, below = (
        [value * flint.arb(2) ** (speed * (power - order)) for power, value in enumerate(one)]
        for one in (above, below)
    )
    return above, below, flint.arb(2) ** speed


def position_after(
    above: list[Ball],
    transition: Matrix,
    denominator: "arb_poly | acb_poly",
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
    """Return how the states move, of what ``held`` returns."""
    return _matrix([row[:-1] for row in matrix.tolist()[:-1]])


def force_of(matrix: Matrix) -> Matrix:
    """Return what a force adds to the states, of what ``held`` returns."""
    return _matrix([row[-1:] for row in matrix.tolist()[:-1]])


def _matrix(rows: list[list[Any]]) -> Any:
    import flint

    has_complex = any(isinstance(one, flint.acb) for row in rows for one in row)
    return (flint.acb_mat if has_complex else flint.arb_mat)(rows)


def _without(polynomial: "arb_poly", zeros: int) -> "arb_poly":
    """Return a polynomial of which that many of the lowest coefficients are known to be 0."""
    import flint

    return flint.arb_poly([flint.arb(0)] * zeros + polynomial.coeffs()[zeros:])


def is_known(polynomial: "arb_poly") -> bool:
    """Whether each coefficient is known to the digits that are wanted, or next to 0."""
    return are_known(polynomial.coeffs(), _WANTED_BITS, _NOTHING)


def are_known(balls: "list[arb]", bits: int, nothing: float) -> bool:
    """Return whether balls are known to some bits, or next to 0 beside the largest of them."""
    least = max((one.abs_lower() for one in balls), key=float, default=0.0) * nothing
    return all(one.rel_accuracy_bits() >= bits or one.abs_upper() <= least for one in balls)


def _binary_digits(ball: Ball) -> int:
    """Return the exponent of a power of two that is at most twice or half as large."""
    mantissa, exponent = abs(ball).mid().man_exp()
    return int(exponent) + int(abs(mantissa)).bit_length() - 1


# -------------------------------------------------------------------------------------- rounding


def _rounded(balls: _Balls, unit: int, lag: int) -> SampledPlant:
    import flint

    scale = flint.arb(2) ** -unit
    straight, one, minus_one = (
        ([bounded(c * scale) for c in _falling(n)], [bounded(c) for c in _falling(d)])
        for n, d in balls
    )
    return SampledPlant(
        numerator=_values(straight[0]),
        denominator=_values(straight[1]),
        lag=lag,
        errors=(_errors(straight[0]), _errors(straight[1])),
        at_one=(one[0][-1], one[1][-1]),
        at_minus_one=(minus_one[0][-1], minus_one[1][-1]),
        shifted=(
            _values(one[0]),
            _values(one[1]),
            _turned(_values(minus_one[0])),
            _turned(_values(minus_one[1])),
        ),
    )


def bounded(ball: "arb") -> Bounded:
    """Return the nearest pair of float64, and a bound of its distance from all of a ball."""
    high = float(ball.mid())
    low = float((ball - high).mid()) if isfinite(high) else 0.0
    total = high + low
    error = float((ball - high - low).abs_upper())
    return Bounded(DoubleDouble(total, low - (total - high)), nextafter(error * RAISED_FEW, inf))


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


def _is_finite(plant: SampledPlant) -> bool:
    numbers = [*plant.numerator, *plant.denominator]
    return all(isfinite(number.hi) for number in numbers) and all(map(isfinite, plant.errors))
