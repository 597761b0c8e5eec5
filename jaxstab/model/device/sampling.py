"""A device behind a zero-order hold and a delay: N(z) and D(z) in balls of any precision.

In time units of the sampling period T position over force is n(s)/d(s), d monic. With its companion
form (A, B, C), exp of [[A, B], [0, 0]] over 1 - f and over f, in balls of python-flint, is how the
state moves and what a held force adds to it, and so

    G(z) = z^-w N(z) / D(z),     D(z) = det(z - exp(A))

(lemma V10 of docs/proofs.md). The last section bounds what forces do that arrive late
(``late_cosines``).
"""

from functools import lru_cache
from math import ceil, floor, ldexp, log2
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxstab.model.device.device import Device, in_steps
from jaxstab.model.device.parts import Rational, balls_of, decided, exact, flint, remembered

if TYPE_CHECKING:
    from flint import arb, arb_mat, arb_poly, fmpq

Ball = Any  # of python-flint


@lru_cache(maxsize=512)
def gain_units(device: Device, sample_time: float, delay: float) -> tuple[float, float]:
    """Units of gains, powers of two: alpha is K times the first one in m/N, beta B times the other.

    They are next to the sum of the moduli of the coefficients of N, and to that over T; the delay
    is in samples.

    Raises: as ``in_samples``; ValueError also if the device moves by more or less within a sample
    than float64 can say.
    """

    def size() -> Ball:
        own, given = in_steps(device), (sample_time, delay)
        whole = own.sampled(*given)[1][0] if own else one_sample(device, sample_time).whole
        return sum(map(abs, whole.coeffs()), flint.arb(0))

    unit = _binary_digits(decided(size, is_answered=lambda ball: ball.rel_accuracy_bits() > 1))
    in_time = unit - _binary_digits(flint.arb(sample_time))
    if max(abs(unit), abs(in_time)) > 900:  # products of numbers in such units are float64 still
        raise ValueError(
            f"the device ({device}) moves by about 2^{unit} m per N within a sampling period of "
            f"{sample_time:g} s; give SI units, and no pole so unstable that float64 overflows."
        )
    return ldexp(1.0, unit), ldexp(1.0, in_time)


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
    if speed_of(below) > fastest:
        raise ValueError(
            f"the device has a pole at 2^{speed_of(below)} or so per sampling period of "
            f"{sample_time:g} s; give SI units, and leave out what is faster than 2^{fastest}."
        )
    return above, below


def speed_of(below: list[Ball]) -> int:
    """The exponent of a power of two next to the largest root, but for a factor of 2."""
    degree = len(below) - 1
    sizes = [(degree - k, c) for k, c in enumerate(below[:-1]) if c != 0]
    return max((_binary_digits(c) // root for root, c in sizes), default=0)


class OneSample(NamedTuple):
    """A device in the time of its fastest pole, and what its states do within a sample.

    above, below: numerator and denominator in that time, of which a sample has 2^``speed``.
    generator: [[A, B], [0, 0]], A the companion matrix, B the last unit vector, over a sample.
    transition, denominator: exp(A) and D(z); ``whole``: N(z) without a delay.
    """

    above: list[Ball]
    below: list[Ball]
    speed: int
    generator: "arb_mat"
    transition: "arb_mat"
    denominator: "arb_poly"
    whole: Any = None

    def held(self, time: Ball) -> "arb_mat":
        """The exponential of [[A, B], [0, 0]] times a time in samples (Van Loan 1978)."""
        return (self.generator * time).exp()

    def moved(self, column: "arb_mat") -> "arb_poly":
        """The response of the position to states, as a polynomial in z."""
        (response,) = seen(flint.arb_mat([self.above]), self.transition, self.denominator, column)
        return response

    def of_samples(self, fraction: Ball | None) -> "tuple[arb_poly, arb_poly]":
        """N(z) and D(z), for a fraction of a sample with one sample of delay more (V10)."""
        if fraction is None:
            return self.whole, self.denominator
        later = self.moved(states_and_force(self.held(1 - fraction))[1])
        return flint.arb_poly([-1, 1]) * later + self.whole, self.denominator


@remembered(64)
def one_sample(device: Device, sample_time: float) -> OneSample:
    """The motion of a device within a sample, in balls of the precision that is set.

    Raises: as ``in_samples``.
    """
    sides = in_samples(device.compliance(), sample_time)
    order, speed = len(sides[0]), speed_of(sides[1])
    above, below = (
        [value * flint.arb(2) ** (speed * (power - order)) for power, value in enumerate(side)]
        for side in sides
    )
    rows: list[list[Any]] = [[int(k == row + 1) for k in range(order + 1)] for row in range(order)]
    rows[-1][:order] = [-value for value in below[:order]]
    generator = flint.arb_mat([*rows, [0] * (order + 1)]) * flint.arb(2) ** speed
    transition, force = states_and_force(generator.exp())
    sample = OneSample(above, below, speed, generator, transition, transition.charpoly())
    return sample._replace(whole=sample.moved(force))


def states_and_force(matrix: "arb_mat") -> "tuple[arb_mat, arb_mat]":
    """The parts of [[A, B], [0, 0]], or of an exponential of it, that act on states."""
    rows = matrix.tolist()[:-1]
    return flint.arb_mat([row[:-1] for row in rows]), flint.arb_mat([row[-1:] for row in rows])


def seen(
    rows: "arb_mat", transition: "arb_mat", denominator: "arb_poly", column: "arb_mat"
) -> "list[arb_poly]":
    """C adj(z - F) v, a polynomial for each row of C: what a state v does to z^k."""
    # It is the part without negative powers of D(z) (h_1/z + h_2/z^2 + ...).
    order, terms = transition.nrows(), []
    for _ in range(order):
        terms.append((rows * column).entries())
        column = transition * column
    return [
        (denominator * flint.arb_poly(list(response))).right_shift(order)
        for response in zip(*terms[::-1], strict=True)
    ]


def _binary_digits(ball: Ball) -> int:
    """The exponent of a power of two that is at most twice or half as large."""
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
    """The q of Q = q_0 + 2 q_1 cos(theta) + 2 q_2 cos(2 theta) + ..., in SI units.

    L is the delay, ``jitter`` is J in samples.
    """
    sample = one_sample(device, sample_time)
    order = len(sample.above)
    gramian = _after(sample, exact(1.0))[1] * floor(jitter)
    for start, end in _windows(delay % 1.0, jitter % 1.0):
        onward, window = _after(sample, 1 - end)[0], _after(sample, end - start)[1]
        gramian += onward * window * onward.transpose()
    weights = (gramian * flint.arb(exact(jitter))).tolist()
    rows = [
        sample.moved(flint.arb_mat([[int(i == j)] for i in range(order)])) for j in range(order)
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


def _after(sample: OneSample, time: "fmpq") -> "tuple[arb_mat, arb_mat]":
    """F, and the Gramian, over a time: the integral of exp(A t) B B' exp(A' t) (Van Loan).

    They are formed over a time in which the device's numbers are of size 1, then doubled.
    """
    doublings = max(0, sample.speed + ceil(log2(float(flint.arb(time))))) if time > 0 else 0
    a, push = states_and_force(sample.generator)
    order = a.nrows()
    pairs = zip((-a).tolist(), (push * push.transpose()).tolist(), strict=True)
    below = [[0] * order + row for row in a.transpose().tolist()]
    short = flint.arb(time) / flint.arb(2) ** doublings
    blocks = (flint.arb_mat([*(x + y for x, y in pairs), *below]) * short).exp().tolist()
    transition = flint.arb_mat([row[order:] for row in blocks[order:]]).transpose()
    gramian = transition * flint.arb_mat([row[order:] for row in blocks[:order]])
    for _ in range(doublings):
        gramian = gramian + transition * gramian * transition.transpose()
        transition = transition * transition
    return transition, gramian
