"""N(z) of a device for all fractions of the delay: Taylor polynomials in pieces of a sample.

With the companion form (A, B, C) of a device in time units of a sample, Gamma(t) what a force held
for a time t adds to the states, and n[v] = C adj(z - exp A) v,

    N_f(z) = (z - 1) n[Gamma(1 - f)](z) + n[Gamma(1)](z),     Gamma' = exp(A t) B

(lemma B14 of docs/proofs.md). The pieces are halved, in balls, until the polynomials are right.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.model.device.rational import Rational, exact, working_precision
from jaxstab.model.device.sampling import (
    SampledDevice,
    force_of,
    generator,
    held,
    in_fastest_time,
    in_samples,
    position_after,
    without_force,
)

if TYPE_CHECKING:
    from flint import acb_poly, arb, arb_mat, arb_poly

_FIRST_BITS, _MOST_BITS = 512, 1 << 12
_ORDER = 14  # of the polynomials, at most
_LEFT = 2.0**-66  # of the size of N, by which a polynomial may miss it
_OVERLAP = 1e-6  # of a piece, beyond its ends
_MOST_PIECES = 128
_ROUNDED_UP = 1.0 + 2.0**-50


@dataclass(frozen=True)
class Piece:
    """N_f(z) = sum_jk u^j near_jk (z - 1)^k for |u| <= half, a little beyond, u = f - middle.

    Attributes:
        middle: of the piece.
        half: half its width.
        near: the coefficients, in the units of the device.
        far: the same of N_f(-z).
        remainder: a bound of what either sum misses of N on the unit circle, but for the rounding
            of each coefficient to float64.
    """

    middle: float
    half: float
    near: Float64[np.ndarray, "power coefficient"]
    far: Float64[np.ndarray, "power coefficient"]
    remainder: float


@lru_cache(maxsize=16)
def pieces_of_delay(device: SampledDevice) -> tuple[Piece, ...] | None:
    """Return pieces of [0, 1], ascending, for the fraction f of the delay.

    N has the order of D, one more than without a fraction: the plant is z^-(n + 1) N/D for a delay
    of n + f samples. None for a device that is too fast for that many pieces.
    """
    import flint

    bits = _FIRST_BITS
    while True:
        with working_precision(bits):
            family = _Family.of(device.device.compliance(), device.sample_time)
            if family.is_known or bits >= _MOST_BITS:
                return _pieces(family, 1 / flint.arb(device.stiffness_unit))
        bits *= 2


def _pieces(family: "_Family", scale: "arb") -> tuple[Piece, ...] | None:
    done: list[Piece] = []
    waiting = [(0.5, 0.5)]
    while waiting:
        middle, half = waiting.pop()
        piece = family.piece(middle, half, scale)
        if piece is not None:
            done.append(piece)
            continue
        # What decays has the longest piece first, what does not decay has them all alike.
        is_hopeless = not done and half * _MOST_PIECES < 1.0
        if is_hopeless or len(done) + len(waiting) >= _MOST_PIECES:
            return None
        waiting += [(middle + 0.5 * half, 0.5 * half), (middle - 0.5 * half, 0.5 * half)]
    return tuple(done)


class _Family(NamedTuple):
    """A device in the time of its fastest pole: what a state does to the position."""

    above: "list[arb]"
    below: "list[arb]"
    speed: "arb"  # such units of time in a sample
    transition: "arb_mat"
    denominator: "arb_poly"
    whole: "arb_poly"  # n[Gamma(1)]

    @classmethod
    def of(cls, compliance: Rational, sample_time: float) -> "_Family":
        import flint

        above, below, speed = in_fastest_time(*in_samples(compliance, sample_time))
        sample = held(below, speed)
        transition = without_force(sample)
        denominator = transition.charpoly()
        column = force_of(sample)
        whole = position_after(above, transition, denominator, column)
        return cls(above, below, speed, transition, denominator, flint.arb_poly(whole))

    @property
    def is_known(self) -> bool:
        """Whether the precision is more than enough."""
        return float(size_on_circle(self.whole) * _LEFT**2) > float(_lost(self.whole))

    def piece(self, middle: float, half: float, scale: "arb") -> Piece | None:
        """Return a piece, None where no polynomial is good enough."""
        import flint

        rest = held(self.below, (1 - flint.arb(exact(middle))) * self.speed)
        matrix = generator(self.below)
        reach = flint.arb(half) * (1 + _OVERLAP)
        # For all times of the piece: e^(A t) times what it is in the middle.
        around = without_force(held(self.below, flint.arb(0, reach) * self.speed))
        terms = [self._steps(force_of(rest)) + self.whole]
        allowed = size_on_circle(terms[0]) * _LEFT
        moved = without_force(rest) * force_of(matrix)
        for order in range(1, _ORDER + 2):
            weight = (-self.speed) ** order / factorial(order)
            missed = size_on_circle(self._steps(around * moved) * weight * reach**order)
            if missed < allowed:
                scaled, degree = [term * scale for term in terms], len(self.above)
                return rounded_piece(middle, half, scaled, missed * scale, degree)
            terms.append(self._steps(moved) * weight)
            moved = without_force(matrix) * moved
        return None

    def _steps(self, column: "arb_mat") -> "arb_poly":
        """Return (z - 1) n[v]."""
        import flint

        coefficients = position_after(self.above, self.transition, self.denominator, column)
        return flint.arb_poly([-1, 1]) * flint.arb_poly(coefficients)


def rounded_piece(
    middle: float, half: float, terms: list["arb_poly"], missed: "arb", degree: int
) -> Piece | None:
    """Return the piece of sum_j u^j terms_j, None where these are not known well enough.

    Args:
        middle: of the piece.
        half: half its width, at most 1/2.
        terms: polynomials in z of a degree.
        missed: what the sum misses on the unit circle.
        degree: the degree.
    """
    import flint

    plus, minus = flint.arb_poly([1, 1]), flint.arb_poly([-1, -1])
    forms = [
        [[term(about)[k] for k in range(degree + 1)] for term in terms] for about in (plus, minus)
    ]
    # |z - 1| <= 2
    reach = flint.arb(half * (1.0 + _OVERLAP))
    weights = [[2**k * reach**j for k in range(degree + 1)] for j in range(len(terms))]
    worst = max(
        float(
            sum(
                (
                    weight * one.rad()
                    for pair in zip(weights, form, strict=True)
                    for weight, one in zip(*pair, strict=True)
                ),
                flint.arb(0),
            ).upper()
        )
        for form in forms
    )
    if not worst <= float(size_on_circle(terms[0])) * _LEFT:
        return None
    near, far = (np.array([[float(one.mid()) for one in row] for row in form]) for form in forms)
    return Piece(middle, half, near, far, (worst + float(missed.upper())) * _ROUNDED_UP)


def size_on_circle(polynomial: "arb_poly | acb_poly") -> "arb":
    """Return a bound of |Q(z)| on the unit circle."""
    import flint

    return sum((abs(one).upper() for one in polynomial.coeffs()), flint.arb(0))


def _lost(polynomial: "arb_poly") -> "arb":
    """Return the sum of the radii of the coefficients."""
    import flint

    return sum((one.rad() for one in polynomial.coeffs()), flint.arb(0))
