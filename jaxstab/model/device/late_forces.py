"""How strongly a force whose changes arrive late moves the samples of a device.

Each change of the computed force should act after the delay L, and acts up to J samples later. So
the force is wrong by the last changes, at most N(s) of them at the time s after L, T = 1:

    N(s) = n + 1 for s < f,   N(s) = n from there on,      n = floor(J),  f = J - n,   0 <= s < 1.

From sample to sample the states of (A, B, C) move by x -> F x + what the force adds. With b(s) what
an impulse at the time s after L adds at the next sample, c(z) = C adj(z - F) and D(z) as in
``sampling``, errors of this kind move the samples of the position at the angle theta by no more
than sqrt(Q)/|D| times the changes (lemma J1 of docs/proofs.md),

    Q = c(z) M c(1/z)',     M = J times the integral of N b b',     |z| = 1,

a cosine sum of as many terms as the device has states. The integral over a whole sample is the
Gramian of one sample; that over s < f has the part of a sample in which an (n + 1)-th change may
still be missing. Q is finite where D vanishes, and known in powers of 1 - cos(theta) and of
1 + cos(theta), in balls until each coefficient has more digits than pairs of float64.
"""

from functools import lru_cache
from math import ceil, floor, log2
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.model.device.parts import exact, working_precision
from jaxstab.model.device.sampling import (
    Ball,
    Matrix,
    SampledDevice,
    bounded,
    in_fastest_time,
    in_samples,
    is_known,
    position_after,
)
from jaxstab.model.sections import Polynomial
from jaxstab.rounding import RAISED_FEW

if TYPE_CHECKING:
    from flint import arb, arb_poly, fmpq

_FIRST_BITS, _MOST_BITS = 256, 1 << 12


class CosineSum(NamedTuple):
    """Q of a device, in the unit of force of its plant; lowest power first.

    about_one: coefficients in powers of 1 - cos(theta).
    about_minus_one: those in powers of 1 + cos(theta).
    errors: bounds of the sums of the errors of both.
    """

    about_one: Polynomial
    about_minus_one: Polynomial
    errors: tuple[float, float]

    def at(self, theta: Float64[np.ndarray, " angle"]) -> Float64[np.ndarray, " angle"]:
        """Return Q at angles, without a bound."""
        powers = 1.0 - np.cos(theta), 1.0 + np.cos(theta)
        values = [
            np.polynomial.polynomial.polyval(h, [float(c.rounded()) for c in rising])
            for h, rising in zip(powers, (self.about_one, self.about_minus_one), strict=True)
        ]
        return np.where(theta < 0.5 * np.pi, *values)


@lru_cache(maxsize=256)
def late_response(device: SampledDevice, jitter: float) -> CosineSum:
    """Return Q; L is the delay of the device, ``jitter`` is J in samples."""
    import flint

    bits = _FIRST_BITS
    while True:
        with working_precision(bits):
            cosines = _cosine_sum(device, jitter)
            both = [_in_powers(cosines, sign) for sign in (-1, 1)]
            if all(map(is_known, both)) or bits >= _MOST_BITS:
                unit = flint.arb(exact(device.stiffness_unit))
                balls = [each.coeffs() or [flint.arb(0)] for each in both]
                known = [[bounded(c / unit**2) for c in each] for each in balls]
                values = [tuple(one.value for one in each) for each in known]
                errors = [float(sum(one.error for one in each)) * RAISED_FEW for each in known]
                return CosineSum(values[0], values[1], (errors[0], errors[1]))
        bits *= 2


def _cosine_sum(device: SampledDevice, jitter: float) -> list["arb"]:
    """Return q of Q = q_0 + 2 q_1 cos(theta) + 2 q_2 cos(2 theta) + ..., in SI units."""
    import flint

    given = in_samples(device.device.compliance(), device.sample_time)
    above, below, speed = in_fastest_time(*given)
    order = len(below) - 1
    transition, whole = _after(below, speed)
    gramian = whole * floor(jitter)
    for first, last in _windows(device.delay % 1.0, jitter % 1.0):
        rest, _ = _after(below, (1 - last) * speed)
        _, part = _after(below, (last - first) * speed)
        gramian += rest * part * rest.transpose()
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
        other = sum((one * w for one, w in zip(rows, weighted, strict=True)), zero)
        reverse = [other[order - 1 - power] for power in range(order)]
        total += row * flint.arb_poly(reverse)
    return [total[order - 1 + lag] for lag in range(order)]


def _windows(start: float, length: float) -> list[tuple["fmpq", "fmpq"]]:
    """Return the parts of a sample in which a window lies that may go on in the next one."""
    first, last = exact(start), exact(start) + exact(length)
    parts = [(first, min(last, exact(1.0))), (exact(0.0), last - 1)]
    return [part for part in parts if part[0] < part[1]]


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


def _in_powers(cosines: list["arb"], sign: int) -> "arb_poly":
    """Return the sum as a polynomial in h, cos(theta) being 1 - h or, for sign 1, h - 1."""
    import flint

    cosine = flint.arb_poly([-sign, sign])
    last, this = flint.arb_poly([1]), cosine
    total = flint.arb_poly([cosines[0]])
    for value in cosines[1:]:
        total += this * (2 * value)
        last, this = this, 2 * cosine * this - last
    return total
