"""How strongly a force of any shape moves the samples of a device: the sum over all aliases.

A force w(t) of finite energy, T = 1, moves the sampled position with the gain A(theta),

    A(theta)^2 = sum over all integers k of |G(i (theta + 2 pi k))|^2,

at the angle theta: its frequencies that differ by whole turns arrive together (Poisson's sum, with
the inequality of Cauchy and Schwarz, which some w attains). From sample to sample the states s of
(A, B, C) move by s -> F s + what w adds, and W, the Gramian of one sample, says how much that can
be. So, with D(z) as in ``sampling``,

    A^2 |D|^2 = Q,     Q = c(z) W c(1/z)',     c(z) = C adj(z - F),     |z| = 1,

a cosine sum of as many terms as the device has states: nothing is truncated (lemma J1 of
docs/proofs.md). It is finite where D vanishes, and known in powers of 1 - cos(theta) and of
1 + cos(theta), in balls until each coefficient has more digits than pairs of float64.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

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
    from flint import arb, arb_poly

_FIRST_BITS, _MOST_BITS = 256, 1 << 12


class Aliases(NamedTuple):
    """Q of a device, in the unit of force of its plant; lowest power first.

    about_one: coefficients in powers of 1 - cos(theta).
    about_minus_one: those in powers of 1 + cos(theta).
    errors: bounds of the sums of the errors of both.
    """

    about_one: Polynomial
    about_minus_one: Polynomial
    errors: tuple[float, float]


@lru_cache(maxsize=64)
def aliases(device: SampledDevice) -> Aliases:
    """Return Q; the delay does not matter."""
    import flint

    bits = _FIRST_BITS
    while True:
        with working_precision(bits):
            cosines = _cosine_sum(device)
            both = [_in_powers(cosines, sign) for sign in (-1, 1)]
            if all(map(is_known, both)) or bits >= _MOST_BITS:
                unit = flint.arb(exact(device.stiffness_unit))
                known = [[bounded(c / unit**2) for c in each.coeffs()] for each in both]
                values = [tuple(one.value for one in each) for each in known]
                errors = [float(sum(one.error for one in each)) * RAISED_FEW for each in known]
                return Aliases(values[0], values[1], (errors[0], errors[1]))
        bits *= 2


def _cosine_sum(device: SampledDevice) -> list["arb"]:
    """Return q of Q = q_0 + 2 q_1 cos(theta) + 2 q_2 cos(2 theta) + ..., in SI units."""
    import flint

    given = in_samples(device.device.compliance(), device.sample_time)
    above, below, speed = in_fastest_time(*given)
    order = len(below) - 1
    transition, gramian = _one_sample(below, speed)
    denominator = transition.charpoly()
    units = [[int(i == j) for i in range(order)] for j in range(order)]
    columns = [flint.arb_mat([unit]).transpose() for unit in units]
    rows = [
        flint.arb_poly(position_after(above, transition, denominator, column)) for column in columns
    ]
    weights, zero = gramian.tolist(), flint.arb_poly([])
    total = zero
    for row, weighted in zip(rows, weights, strict=True):
        other = sum((one * w for one, w in zip(rows, weighted, strict=True)), zero)
        reverse = [other[order - 1 - power] for power in range(order)]
        total += row * flint.arb_poly(reverse)
    return [total[order - 1 + lag] for lag in range(order)]


def _one_sample(below: list[Ball], speed: "arb") -> "tuple[Matrix, Matrix]":
    """Return F, and the Gramian of a sample: the integral of exp(A t) B B' exp(A' t) (Van Loan)."""
    import flint

    order, start = len(below) - 1, min(speed, flint.arb(1), key=float)
    rows = [[flint.arb(0)] * (2 * order) for _ in range(2 * order)]
    for row in range(order - 1):
        rows[row][row + 1], rows[order + row + 1][order + row] = flint.arb(-1), flint.arb(1)
    for column in range(order):
        rows[order - 1][column] = below[column]
        rows[order + column][2 * order - 1] = -below[column]
    rows[order - 1][2 * order - 1] = flint.arb(1)
    blocks = (flint.arb_mat(rows) * start).exp().tolist()
    turned = flint.arb_mat([row[order:] for row in blocks[order:]])
    transition = turned.transpose()
    gramian = transition * flint.arb_mat([row[order:] for row in blocks[:order]])
    time = start
    while float(time) < float(speed):
        gramian = gramian + transition * gramian * transition.transpose()
        transition, time = transition * transition, 2 * time
    return transition, gramian * speed


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
