"""50 digits of everything about a loop: plant, polynomial, roots and boundary.

The route is the textbook one, on purpose not the library's: the plant x'' + delta x' + gamma x = u
(T = m = 1) is sampled in state space, from the Taylor series of its step response in t. That needs
no case distinction at gamma = 0, delta = 0 or critical damping. Cancellation is met by working
precision: every quantity is computed with more and more digits until at least DIGITS of its own
are certain, however small it is. Polynomials are solved by python-flint in certified balls.

All inputs are exact: a float means the binary number that it holds.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import NamedTuple

import flint
from mpmath import mp, mpc, mpf

from tests.truth.balls import (
    ExactPlant,
    NotCertain,
    Number,
    as_arb,
    as_mpf,
    isolated_roots,
    split_delay,
)

DIGITS = 50
PRECISIONS = (120, 400, 1600)  # decimal digits; the last one holds sums such as 1 + 1e-300 exactly
SAFE_DIGITS = 60  # certain digits asked of a value, in a computation of PRECISIONS digits

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


plant_in_balls = lru_cache(maxsize=4096)(ExactPlant.of)  # many walls are asked of one plant


# -------------------------------------------------------------------------------- the sampled plant


def motion(gamma: Number, delta: Number, time: Number) -> tuple[mpf, mpf]:
    """Position and velocity at `time` after a unit step of force on the plant at rest."""
    gamma, delta, time = mpf(gamma), mpf(delta), mpf(time)
    rate = float((abs(delta) + mp.sqrt(abs(gamma))) * time)
    with mp.extraprec(64 + int(3 * rate)):  # the terms grow at most to exp(rate)
        negligible = time**2 * mp.eps / 2**32
        before, term = mpf(0), time**2 / 2
        position, moment, k = term, 2 * term, 2
        while k < rate or max(abs(before), abs(term)) * k > negligible:
            following = -(delta * time * term + gamma * time**2 * before / k) / (k + 1)
            before, term, k = term, following, k + 1
            position += term
            moment += k * term
        return position, moment / time


def sampled_plant(gamma: Number, delta: Number, fraction: Number) -> Plant:
    """The coefficients in the working precision; an int 0 is a zero by structure.

    z times C adj(z - Phi) (Gamma0 + Gamma1 / z), where Gamma0 holds the motion after 1 - fraction
    samples of force and Gamma1 the rest of the motion after one whole sample.
    """
    return _sampled_to(mp.prec, gamma, delta, fraction)


@lru_cache(maxsize=4096)  # many walls are asked of one plant
def _sampled_to(_precision: int, gamma: Number, delta: Number, fraction: Number) -> Plant:
    position, velocity = motion(gamma, delta, 1)
    state_12, state_22 = velocity, 1 - delta * velocity - gamma * position
    d0 = mp.exp(-mpf(delta))
    d1 = gamma * position - 1 - state_22
    total = position + velocity**2 - state_22 * position
    if fraction == 0:
        n0 = 0
        n2 = position
        n1 = position if delta == 0 else velocity**2 - state_22 * position
        difference = 0 if delta == 0 else n2 - n1
    else:
        n2, early = motion(gamma, delta, 1 - mpf(fraction))
        late_position, late_velocity = position - n2, velocity - early
        n1 = late_position + state_12 * early - state_22 * n2
        n0 = state_12 * late_velocity - state_22 * late_position
        difference = n2 - n1 + n0
    return Plant(d1, d0, n2, n1, n0, total, difference)


def certain(compute: Callable[[], Iterable[mpf]], scale: Number = 1) -> list[mpf]:
    """`compute` at the lowest precision that leaves SAFE_DIGITS of each of its values certain.

    scale: what the terms that cancel are at most worth. An int 0 is taken as given; any other zero
    is believed at the highest precision only, where sums and products of inputs are exact.
    """
    for digits in PRECISIONS:
        with mp.workdps(digits + 20):
            values = list(compute())
            floor = abs(mpf(scale)) * mpf(10) ** (SAFE_DIGITS - digits)
            exact = digits == PRECISIONS[-1]
            if all(isinstance(v, int) or abs(v) > floor or (exact and v == 0) for v in values):
                return [mpf(v) for v in values]
    raise NotCertain(f"a value of {[mp.nstr(v, 5) for v in values]} is too close to 0")


def plant(gamma: Number, delta: Number, fraction: Number = 0) -> Plant:
    """Each coefficient, the sum and the difference with DIGITS digits of their own."""
    return Plant(*certain(lambda: sampled_plant(gamma, delta, fraction)))


# -------------------------------------------------------------------- the characteristic polynomial


def polynomial(
    alpha: Number, beta: Number, gamma: Number, delta: Number, delay: float
) -> list[mpf]:
    """p(z), monic, highest power first: degree 3 + delay, or 4 + floor(delay) for a fraction."""
    return coefficients_to(SAFE_DIGITS, alpha, beta, gamma, delta, delay)


def coefficients_to(
    digits: int, alpha: Number, beta: Number, gamma: Number, delta: Number, delay: float
) -> list[mpf]:
    """p(z) with at least `digits` digits of each coefficient."""
    whole, fraction = split_delay(delay)

    def expand() -> list[mpf]:
        with mp.extradps(digits):
            p = sampled_plant(gamma, delta, fraction)
            both = mpf(alpha) + mpf(beta)
            force = [p.n2 * both, p.n1 * both - p.n2 * beta, p.n0 * both - p.n1 * beta]
            force += [] if fraction == 0 else [-p.n0 * mpf(beta)]
            coefficients = [mpf(1), p.d1, p.d0] + [mpf(0)] * (whole + len(force) - 2)
            for place, value in enumerate(reversed(force), start=1):
                coefficients[-place] += value
            zeros = range(3, len(coefficients) - len(force))
            return [0 if i in zeros else c for i, c in enumerate(coefficients)]

    return certain(expand, scale=1 + abs(alpha) + abs(beta))


def root_balls(
    alpha: Number, beta: Number, gamma: Number, delta: Number, delay: float
) -> list[flint.acb]:
    """All roots of p as certified disjoint balls (a multiple root is repeated), largest first."""
    if gamma == delta == 0:
        balls = rational_roots(polynomial(alpha, beta, gamma, delta, delay))
    else:
        balls = transcendental_roots(alpha, beta, gamma, delta, delay)
    return sorted(balls, key=lambda ball: [-as_mpf(abs(ball).mid()), -as_mpf(ball.imag.mid())])


def rational_roots(coefficients: Sequence[mpf]) -> list[flint.acb]:
    """At gamma = delta = 0 the coefficients are rational: multiple roots are found exactly."""
    exact = flint.fmpq_poly([as_fmpq(c) for c in reversed(coefficients)])
    with flint.ctx.workdps(4 * DIGITS):
        return [ball for ball, count in exact.complex_roots() for _ in range(count)]


def transcendental_roots(
    alpha: Number, beta: Number, gamma: Number, delta: Number, delay: float
) -> list[flint.acb]:
    """The roots, by more and more digits; without a controller they are known."""
    for digits in PRECISIONS:
        with flint.ctx.workdps(digits + 20):
            if alpha == beta == 0:
                zeros = [flint.acb(0)] * (degree(delay) - 2)
                balls = plant_poles(gamma, delta) + zeros
            else:
                error = flint.arb(0, flint.arb(10) ** -digits)
                coefficients = coefficients_to(digits, alpha, beta, gamma, delta, delay)
                inexact = [as_arb(c) * (1 + error) for c in coefficients]
                balls = isolated_roots(inexact, flint.arb(10) ** -(SAFE_DIGITS + 10))
            if balls and all(b == 0 or b.rel_accuracy_bits() > SAFE_DIGITS * 3.3 for b in balls):
                return [on_real_axis(ball, balls) for ball in balls]
    raise NotCertain(f"roots not told apart at {(alpha, beta, gamma, delta, delay)}")


def plant_poles(gamma: Number, delta: Number) -> list[flint.acb]:
    """The roots exp(-delta/2 +- sqrt(delta^2/4 - gamma)) of D, double at critical damping."""
    half = as_arb(mpf(delta)) / 2
    split = flint.acb(half**2 - as_arb(mpf(gamma))).sqrt()
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
    whole, fraction = split_delay(delay)

    def solve() -> tuple[mpf, mpf]:
        p = sampled_plant(gamma, delta, fraction)
        z = mpf(radius) * mp.expj(mpf(theta))
        denominator, numerator = evaluate((1, p.d1, p.d0), z), evaluate((p.n2, p.n1, p.n0), z)
        w = -(z ** (whole + 1)) * denominator / numerator
        slope = 1 - 1 / z
        beta = w.imag / slope.imag
        return w.real - beta * slope.real, beta

    alpha, beta = certain(solve)
    return alpha, beta


# -------------------------------------------------------------------- numbers and their last places


def ulps(value: float, exact: mpf) -> float:
    """|value - exact| in units of the last place of `exact` rounded to float64."""
    if not math.isfinite(value):
        return math.inf
    with mp.workdps(PRECISIONS[1]):
        error = abs(mpf(float(value)) - exact)
        if exact == 0:
            return 0.0 if error == 0 else math.inf
        return float(error / mpf(math.ulp(float(exact))))


def as_fmpq(value: mpf) -> flint.fmpq:
    """The exact rational of a number."""
    sign, mantissa, exponent, _ = value._mpf_
    return flint.fmpq(int(-mantissa if sign else mantissa)) * flint.fmpq(2) ** exponent
