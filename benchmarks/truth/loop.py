"""50 digits of everything about a loop: plant, polynomial, roots and boundary.

The route is the textbook one, on purpose not the library's: the plant x'' + delta x' + gamma x = u
(T = m = 1) is sampled in state space, by the exponential of its matrix in balls of python-flint
(``balls``). That needs no case distinction at gamma = 0, delta = 0 or critical damping.
Cancellation is met by working precision: every quantity is computed with more and more bits until
at least DIGITS of its own are certain, however small it is. Polynomials are solved in certified
balls.

All inputs are exact: a float means the binary number that it holds.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import NamedTuple

import flint
from mpmath import mp, mpc, mpf

from benchmarks.truth.balls import (
    ExactPlant,
    NotCertain,
    Number,
    as_arb,
    as_mpf,
    isolated_roots,
    motion_in_balls,
    split_delay,
)

DIGITS = 50
SAFE_DIGITS = 60  # certain digits asked of a value
BITS = (460, 1400, 5400)  # the last ones hold sums such as 1 + 1e-300 exactly

mp.dps = 60


class Plant(NamedTuple):
    """D(z) = z^2 + d1 z + d0 and the numerator n2 z^2 + n1 z + n0, with its values at z = 1, -1."""

    d1: mpf
    d0: mpf
    n2: mpf
    n1: mpf
    n0: mpf
    sum: mpf
    difference: mpf


def certain(compute: Callable[[int], Iterable[flint.arb]], digits: int) -> list[mpf]:
    """`compute` with the fewest bits that leave so many digits of each of its values certain.

    A zero that is not exact is believed with the most bits only.
    """
    for bits in BITS:
        with flint.ctx.workprec(bits):
            values = list(compute(bits))
            are_zero = [value == 0 or (bits == BITS[-1] and value.contains(0)) for value in values]
            pairs = list(zip(values, are_zero, strict=True))
            if all(zero or value.rel_accuracy_bits() > 3.33 * digits for value, zero in pairs):
                return [mpf(0) if zero else as_mpf(value.mid()) for value, zero in pairs]
    raise NotCertain(f"a value of {values} is too close to 0")


plant_in_balls = lru_cache(maxsize=4096)(ExactPlant.of)  # many walls are asked of one plant


def motion(gamma: Number, delta: Number, time: Number) -> list[mpf]:
    """Position and velocity at `time` after a unit step of force on the plant at rest."""
    return certain(lambda _: motion_in_balls(*map(as_arb, (gamma, delta, time))), SAFE_DIGITS)


def plant(gamma: Number, delta: Number, fraction: Number = 0, digits: int = SAFE_DIGITS) -> Plant:
    """Each coefficient, the sum and the difference with so many digits of their own."""
    has_difference = delta != 0 or fraction != 0

    def sampled(bits: int) -> list[flint.arb]:
        p = plant_in_balls(gamma, delta, fraction, bits)
        difference = p.n2 - p.n1 + p.n0 if has_difference else flint.arb(0)
        return [*p[:5], p.n2 + p.n1 + p.n0, difference]

    return Plant(*certain(sampled, digits))


# -------------------------------------------------------------------- the characteristic polynomial


def polynomial(
    alpha: Number, beta: Number, gamma: Number, delta: Number, delay: float
) -> list[mpf]:
    """p(z), monic, highest power first: degree 3 + delay, or 4 + floor(delay) for a fraction."""

    def expand(bits: int) -> list[flint.arb]:
        return plant_in_balls(gamma, delta, delay, bits).polynomial(alpha, beta, delay)

    return certain(expand, SAFE_DIGITS)


def root_balls(
    alpha: Number, beta: Number, gamma: Number, delta: Number, delay: float
) -> list[flint.acb]:
    """All roots of p as certified disjoint balls (a multiple root is repeated), largest first."""
    if gamma == delta == 0:  # the coefficients are rational: multiple roots are found exactly
        rising = map(as_fmpq, reversed(polynomial(alpha, beta, gamma, delta, delay)))
        with flint.ctx.workdps(4 * DIGITS):
            found = flint.fmpq_poly(list(rising)).complex_roots()
            balls = [ball for ball, count in found for _ in range(count)]
    elif alpha == beta == 0:  # known without a controller
        with flint.ctx.workprec(BITS[0]):
            balls = plant_poles(gamma, delta) + [flint.acb(0)] * (degree(delay) - 2)
    else:
        balls = _isolated(alpha, beta, gamma, delta, delay)
    return sorted(balls, key=lambda ball: [-as_mpf(abs(ball).mid()), -as_mpf(ball.imag.mid())])


def _isolated(
    alpha: Number, beta: Number, gamma: Number, delta: Number, delay: float
) -> list[flint.acb]:
    for bits in BITS:
        with flint.ctx.workprec(bits):
            coefficients = plant_in_balls(gamma, delta, delay, bits).polynomial(alpha, beta, delay)
            balls = isolated_roots(coefficients, flint.arb(10) ** -(SAFE_DIGITS + 10))
            if balls and all(b == 0 or b.rel_accuracy_bits() > SAFE_DIGITS * 3.3 for b in balls):
                return [on_real_axis(ball, balls) for ball in balls]
    raise NotCertain(f"roots not told apart at {(alpha, beta, gamma, delta, delay)}")


def plant_poles(gamma: Number, delta: Number) -> list[flint.acb]:
    """The roots exp(-delta/2 +- sqrt(delta^2/4 - gamma)) of D, double at critical damping."""
    half = as_arb(delta) / 2
    split = flint.acb(half**2 - as_arb(gamma)).sqrt()
    return [(split - half).exp(), (-split - half).exp()]


def on_real_axis(ball: flint.acb, balls: Sequence[flint.acb]) -> flint.acb:
    """The ball without an imaginary part where no other ball can hold the conjugate of its root."""
    alone = not any(b is not ball and b.overlaps(ball.conjugate()) for b in balls)
    return flint.acb(ball.real) if alone and ball.imag.contains(0) else ball


def evaluate(coefficients: Iterable[Number], z: Number | mpc) -> mpc:
    """A polynomial, highest power first, at z."""
    value = mpf(0)
    for coefficient in coefficients:
        value = value * z + coefficient
    return value


def degree(delay: float) -> int:
    """The degree of p."""
    whole, fraction = split_delay(delay)
    return whole + (3 if fraction == 0 else 4)


def roots(alpha: Number, beta: Number, gamma: Number, delta: Number, delay: float) -> list[mpc]:
    """All roots of p with DIGITS certified digits of each modulus, the largest first.

    NotCertain where python-flint cannot tell two roots apart: seen where both roots at z = 1 stay
    within 1e-100 of it (alpha, beta, gamma and delta all that small), never from 1e-80 up.
    """
    balls = root_balls(alpha, beta, gamma, delta, delay)
    return [mpc(as_mpf(ball.real.mid()), as_mpf(ball.imag.mid())) for ball in balls]


def spectral_radius(
    alpha: Number, beta: Number, gamma: Number, delta: Number, delay: float
) -> tuple[mpf, mpf]:
    """Certified lower and upper bound of the largest modulus of a root."""
    with flint.ctx.workdps(3 * DIGITS):
        moduli = [abs(ball) for ball in root_balls(alpha, beta, gamma, delta, delay)]
        return max(as_mpf(m.lower()) for m in moduli), max(as_mpf(m.upper()) for m in moduli)


def unstable_count(
    alpha: Number, beta: Number, gamma: Number, delta: Number, delay: float
) -> int | None:
    """The number of roots outside the closed unit disk; None with a root within 1e-40 of it."""
    moduli = [abs(root) for root in roots(alpha, beta, gamma, delta, delay)]
    if any(abs(modulus - 1) < mpf(10) ** -40 for modulus in moduli):
        return None
    return sum(modulus > 1 for modulus in moduli)


# ------------------------------------------------------------------------------------- the boundary


def boundary_point(
    theta: Number, gamma: Number, delta: Number, delay: float, radius: Number = 1
) -> tuple[mpf, mpf]:
    """(alpha, beta) with roots of p at radius exp(+-i theta), 0 < theta < pi."""

    def solve(bits: int) -> tuple[flint.arb, flint.arb]:
        z = as_arb(radius) * flint.acb(0, as_arb(theta)).exp()
        return plant_in_balls(gamma, delta, delay, bits).loop(delay).wall_with_root(z)

    alpha, beta = certain(solve, SAFE_DIGITS)
    return alpha, beta


# -------------------------------------------------------------------- numbers and their last places


def ulps(value: float, exact: mpf) -> float:
    """|value - exact| in units of the last place of `exact` rounded to float64."""
    if not math.isfinite(value):
        return math.inf
    with mp.workdps(400):
        error = abs(mpf(float(value)) - exact)
        if exact == 0:
            return 0.0 if error == 0 else math.inf
        return float(error / mpf(math.ulp(float(exact))))


def as_fmpq(value: mpf) -> flint.fmpq:
    """The exact rational of a number."""
    sign, mantissa, exponent, _ = value._mpf_
    return flint.fmpq(int(-mantissa if sign else mantissa)) * flint.fmpq(2) ** exponent
