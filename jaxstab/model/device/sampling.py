"""A device behind a zero-order hold and a delay: N(z) and D(z) in balls of any precision.

In time units of the sampling period T position over force is n(s)/d(s), d monic. With its companion
form (A, B, C), exp of [[A, B], [0, 0]] over 1 - f and over f, in balls of python-flint, is how the
state moves and what a held force adds to it, and so

    G(z) = z^-w N(z) / D(z),     D(z) = det(z - exp(A))

(lemma V10 of docs/proofs.md). The last section bounds what forces do that arrive late
(``late_cosines``).
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor, ldexp, log2
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxstab.model.device.device import Device, in_steps
from jaxstab.model.device.parts import Rational, balls_of, decided, exact, flint, remembered
from jaxstab.model.parameters import LONGEST_DELAY
from jaxstab.numbers import checked_number

if TYPE_CHECKING:
    from flint import arb, arb_poly, fmpq

Ball = Any  # of python-flint
Matrix = Any  # of such balls


@dataclass(frozen=True)
class SampledDevice:
    """A device as a sampled controller meets it, and units for the gains of its walls.

    Attributes:
        device: with its hands and actuators.
        sample_time: T in s.
        delay: in samples.
        stiffness_unit: in m/N: alpha is K stiffness_unit.
        damping_unit: in m/(N s): beta is B damping_unit.
    """

    device: Device
    sample_time: float
    delay: float
    stiffness_unit: float
    damping_unit: float


@lru_cache(maxsize=512)
def sampled_device(device: Device, sample_time: float, delay: float) -> SampledDevice:
    """A device behind a hold and a delay in samples; its units are powers of two.

    alpha and beta are without rounding: their units are next to the sum of the moduli of the
    coefficients of N, and to that over T.

    Raises: see ``jaxstab.conventions``, the range of the delay being [0, 500]; ValueError also if
    the device moves by more or less within a sample than float64 can say.

    Source: the modified z-transform; Van Loan (1978) for the exponential.
    """
    period = checked_number("sample_time", sample_time, 0.0, is_open=True, unit="s")
    delay = checked_number("delay", delay, 0.0, LONGEST_DELAY, unit="samples")

    def size() -> Ball:
        own = in_steps(device)
        whole = own.sampled(period, delay)[1][0] if own else one_sample(device, period).whole
        return sum(map(abs, whole.coeffs()), flint.arb(0))

    unit = _binary_digits(decided(size, is_answered=lambda ball: ball.rel_accuracy_bits() > 1))
    in_time = unit - _binary_digits(flint.arb(period))
    if max(abs(unit), abs(in_time)) > 900:  # products of numbers in such units are float64 still
        raise ValueError(
            f"the device ({device}) moves by about 2^{unit} m per N within a sampling period of "
            f"{sample_time:g} s; give SI units, and no pole so unstable that float64 overflows."
        )
    return SampledDevice(device, period, delay, ldexp(1.0, unit), ldexp(1.0, in_time))


def in_samples(compliance: Rational, sample_time: float) -> tuple[list["arb"], list["arb"]]:
    """Numerator and monic denominator, lowest power first, with T as the unit of time.

    A coefficient that is 0 is the exact 0. ValueError: a pole vanishes within a sampling period.
    """
    fastest = 14  # power of two: poles per sampling period
    period = flint.arb(exact(sample_time))
    above, below = (balls_of(polynomial) for polynomial in compliance)
    degree, leading = len(below) - 1, below[-1]
    below = [value / leading * period ** (degree - k) for k, value in enumerate(below)]
    above = [value / leading * period ** (degree - k) for k, value in enumerate(above)]
    above, below = above + [flint.arb(0)] * (degree - len(above)), [*below[:-1], flint.arb(1)]
    if _speed(below) > fastest:
        raise ValueError(
            f"the device has a pole at 2^{_speed(below)} or so per sampling period of "
            f"{sample_time:g} s; give SI units, and leave out what is faster than 2^{fastest}."
        )
    return above, below


def _speed(below: list[Ball]) -> int:
    """Return the exponent of a power of two next to the largest root, but for a factor of 2."""
    degree = len(below) - 1
    sizes = [(degree - k, c) for k, c in enumerate(below[:-1]) if c != 0]
    return max((_binary_digits(c) // root for root, c in sizes), default=0)


@remembered(64)
def one_sample(device: Device, sample_time: float) -> "OneSample":
    """The motion of a device within a sample, in balls of the precision that is set.

    Raises: as ``in_samples``.
    """
    return OneSample.from_compliance(*in_samples(device.compliance(), sample_time))


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
        """The response of the position to states, as a polynomial in z."""
        return flint.arb_poly(position_after(self.above, self.transition, self.denominator, column))

    def of_samples(self, fraction: Ball | None) -> tuple[Any, Any]:
        """N(z) and D(z), for a fraction of a sample with one sample of delay more (V10)."""
        if fraction is None:
            return self.whole, self.denominator
        later = self.moved(force_of(held(self.below, (1 - fraction) * self.speed)))
        return flint.arb_poly([-1, 1]) * later + self.whole, self.denominator


def in_fastest_time(above: list[Ball], below: list[Ball]) -> "tuple[list[Ball], list[Ball], arb]":
    """Return a device in a unit of time in which its numbers are of size 1.

    The last number is how many of them a sample has, a power of two.
    """
    order, speed = len(below) - 1, _speed(below)
    above, below = (
        [value * flint.arb(2) ** (speed * (power - order)) for power, value in enumerate(row)]
        for row in (above, below)
    )
    return above, below, flint.arb(2) ** speed


def position_after(
    above: list[Ball], transition: Matrix, denominator: "arb_poly", column: Matrix
) -> list[Ball]:
    """Return C adj(z - A) v, the lowest power first, by det(z - A): what a state v does to z^k."""
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
    return flint.arb_mat(rows)


def _binary_digits(ball: Ball) -> int:
    """Return the exponent of a power of two that is at most twice or half as large."""
    mantissa, exponent = abs(ball).mid().man_exp()
    return int(exponent) + int(abs(mantissa)).bit_length() - 1


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


@remembered(256)
def late_cosines(device: Device, sample_time: float, delay: float, jitter: float) -> list["arb"]:
    """Return q of Q = q_0 + 2 q_1 cos(theta) + 2 q_2 cos(2 theta) + ..., in SI units.

    L is the delay, ``jitter`` is J in samples.
    """
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
