"""Loops and verdicts in balls of python-flint: quick where many points of one plant are asked."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import flint
import numpy as np
from mpmath import mp, mpf

from jaxstab import Verdict

_UNDAMPED = 1e-5  # how far a root may be from the circle
_NEWTON_STEPS = 12

Number = int | float | mpf
Rational = tuple[flint.fmpq_poly, flint.fmpq_poly]  # numerator and denominator, in powers of z

_DIFFERENCE: Rational = flint.fmpq_poly([-1, 1]), flint.fmpq_poly([0, 1])  # over one sample
_NO_FILTER: Rational = flint.fmpq_poly([1]), flint.fmpq_poly([1])


class NotCertain(ArithmeticError):
    """No precision was enough."""


def as_mpf(ball: flint.arb) -> mpf:
    """The midpoint, exactly."""
    mantissa, exponent = ball.mid().man_exp()
    with mp.workprec(max(int(mantissa).bit_length(), mp.prec)):
        return mp.ldexp(mpf(int(mantissa)), int(exponent))


def as_arb(value: Number) -> flint.arb:
    """The exact ball of a number."""
    number = value if isinstance(value, mpf) else mpf(value)  # which rounds those of mpmath
    sign, mantissa, exponent, _ = number._mpf_
    return flint.arb((-mantissa if sign else mantissa, exponent))


def split_delay(delay: float) -> tuple[int, float]:
    """The whole samples of a delay and the rest; both exact."""
    whole = math.floor(delay)
    return whole, delay - whole


def isolated_roots(
    coefficients: Sequence[flint.arb], tolerance: flint.arb
) -> list[flint.acb] | None:
    """All roots, each in a certified ball of its own, at flint's precision; those at 0 exactly.

    None where some cannot be told apart.
    """
    last = max(n for n, c in enumerate(coefficients) if c != 0)
    try:
        balls = flint.acb_poly(coefficients[last::-1]).roots(tol=tolerance)
    except ValueError:
        return None
    return balls + [flint.acb(0)] * (len(coefficients) - 1 - last)


class ExactPlant(NamedTuple):
    """The truth's plant in balls of so many bits, which serve many points."""

    d1: flint.arb
    d0: flint.arb
    n2: flint.arb
    n1: flint.arb
    n0: flint.arb
    bits: int

    @classmethod
    def of(cls, gamma: Number, delta: Number, delay: Number, bits: int = 1400) -> "ExactPlant":
        """z times C adj(z - Phi) (Gamma0 + Gamma1 / z), where Gamma0 holds the motion after
        1 - fraction samples of force and Gamma1 the rest of that after one whole sample.
        """
        _, fraction = split_delay(delay)
        with flint.ctx.workprec(bits):
            stiffness, damping = as_arb(gamma), as_arb(delta)
            position, velocity = motion_in_balls(stiffness, damping, flint.arb(1))
            state_12, state_22 = velocity, 1 - damping * velocity - stiffness * position
            d1, d0 = stiffness * position - 1 - state_22, (-damping).exp()
            if fraction == 0:
                n1 = velocity**2 - state_22 * position
                return cls(d1, d0, position, n1, flint.arb(0), bits)
            n2, early = motion_in_balls(stiffness, damping, 1 - as_arb(fraction))
            late_position, late_velocity = position - n2, velocity - early
            n1 = late_position + state_12 * early - state_22 * n2
            n0 = state_12 * late_velocity - state_22 * late_position
            return cls(d1, d0, n2, n1, n0, bits)

    def loop(
        self, delay: float, velocity: Rational = _DIFFERENCE, position: Rational = _NO_FILTER
    ) -> "BallLoop":
        """p(z) for all walls, not divided by what cancels: a root at 0 at whole delays."""
        whole, _ = split_delay(delay)
        with flint.ctx.workprec(self.bits):
            numerator = flint.arb_poly([self.n0, self.n1, self.n2])
            denominator = flint.arb_poly([self.d0, self.d1, 1])
        return BallLoop.of(numerator, denominator, whole + 1, velocity, position, self.bits)

    def polynomial(self, alpha: Number, beta: Number, delay: float) -> list[flint.arb]:
        """p(z), highest power first."""
        p = self.loop(delay).polynomial(alpha, beta)
        return p if split_delay(delay)[1] else p[:-1]

    def code(self, alpha: float, beta: float, gamma: float, delay: float) -> int:
        """The verdict, by certified roots; UNSTABLE with one at 1, where alpha + gamma is 0."""
        if alpha == -gamma:
            return Verdict.UNSTABLE
        return true_code(self.polynomial(alpha, beta, delay))


def motion_in_balls(
    stiffness: flint.arb, damping: flint.arb, time: flint.arb
) -> tuple[flint.arb, flint.arb]:
    """Position and velocity of the plant at rest after a unit of force for a time."""
    still = flint.arb(0)
    generator = [[still, time, still], [-stiffness * time, -damping * time, time], [still] * 3]
    transition = flint.arb_mat(generator).exp()
    return transition[0, 2], transition[1, 2]


def moduli(coefficients: list[flint.arb], bits: int) -> list[flint.arb] | None:
    """The moduli of all roots in balls; None where so many bits do not tell the roots apart."""
    with flint.ctx.workprec(bits):
        roots = isolated_roots(coefficients, flint.arb(2) ** (-bits // 2))
        return None if roots is None else [abs(ball) for ball in roots]


def largest_modulus(coefficients: list[flint.arb], bits: int = 600) -> flint.arb:
    """The largest modulus of a root in a ball."""
    with flint.ctx.workprec(bits):
        roots = isolated_roots(coefficients, flint.arb(2) ** (-bits // 3))
        if roots is None:
            raise NotCertain(f"roots of {coefficients} are not told apart")
        return max(map(abs, roots), key=lambda modulus: modulus.mid())


def true_code(coefficients: list[flint.arb]) -> int:
    """UNDECIDED where a root is on the circle, as far as 360 digits can tell."""
    for bits in (160, 400, 1200):
        balls = moduli(coefficients, bits)
        code = Verdict.UNDECIDED if balls is None else code_of(balls)
        if code != Verdict.UNDECIDED:
            return code
    return Verdict.UNDECIDED


def code_of(moduli: list[flint.arb]) -> int:
    """The verdict that follows from the moduli of all roots."""
    if any(modulus > 1 for modulus in moduli):
        return Verdict.UNSTABLE
    return Verdict.STABLE if all(modulus < 1 for modulus in moduli) else Verdict.UNDECIDED


def are_roots_inside(coefficients: list[flint.arb]) -> bool | None:
    """True if all roots of a real polynomial lie inside the unit circle; None where balls are wide.

    Quicker than its roots: the criterion of Schur and Cohn in ball arithmetic.
    """
    p = coefficients
    while len(p) > 1:
        if p[-1] == 0:  # a root at 0
            p = p[:-1]
            continue
        reflection = p[-1] / p[0]
        if abs(reflection) > 1:
            return False
        if not abs(reflection) < 1:
            return None
        p = [a - reflection * b for a, b in zip(p[:-1], p[:0:-1], strict=True)]
    return True


class BallLoop(NamedTuple):
    """p(z) = base + alpha stiffness + beta damping in balls of so many bits, for many walls.

    The coefficients lie lowest power first, and that of the highest power of base is 1.
    """

    base: flint.arb_poly
    stiffness: flint.arb_poly
    damping: flint.arb_poly
    bits: int

    @classmethod
    def of(
        cls,
        numerator: flint.arb_poly,
        denominator: flint.arb_poly,
        lag: int,
        velocity: Rational,
        position: Rational,
        bits: int,
    ) -> "BallLoop":
        """A plant that is late by whole samples, T times the velocity, and a position filter."""
        with flint.ctx.workprec(bits):
            (nv, dv), (np_, dp) = (
                tuple(map(flint.arb_poly, pair)) for pair in (velocity, position)
            )
            base = flint.arb_poly([0] * lag + [1]) * denominator * dp * dv
            inverse = 1 / base[base.degree()]
            parts = base, numerator * np_ * dv, numerator * nv * dp
            return cls(*(part * inverse for part in parts), bits)

    def polynomial(self, alpha: Number, beta: Number) -> list[flint.arb]:
        """p(z), highest power first."""
        with flint.ctx.workprec(self.bits):
            p = self.base + as_arb(alpha) * self.stiffness + as_arb(beta) * self.damping
            return [p[k] for k in range(self.base.degree(), -1, -1)]

    def in_units(self, stiffness: float, damping: float) -> "BallLoop":
        """The same for gains in these units: alpha is K stiffness, beta is B damping."""
        with flint.ctx.workprec(self.bits):
            units = 1 / flint.arb(stiffness), 1 / flint.arb(damping)
            return BallLoop(
                self.base, self.stiffness * units[0], self.damping * units[1], self.bits
            )

    def modes(self) -> list[flint.arb]:
        """The angles of undamped roots of base, which walls may move by next to nothing."""
        with flint.ctx.workprec(max(self.bits, 1000)):
            base = flint.acb_poly([self.base[k].mid() for k in range(self.base.degree() + 1)])
            slope, angles = base.derivative(), []
            for rough in np.roots(
                [float(self.base[k].mid()) for k in range(len(base) - 1, -1, -1)]
            ):
                if abs(abs(rough) - 1.0) < _UNDAMPED and rough.imag > 0.0:
                    z = flint.acb(rough.real, rough.imag)
                    for _ in range(_NEWTON_STEPS):
                        z = (z - base(z) / slope(z)).mid()
                    angles += [z.arg().mid()] if abs(abs(z) - 1) < _UNDAMPED else []
            return angles

    def wall_with_roots_at(self, theta: float | flint.arb) -> tuple[float, float]:
        """The wall that puts a pair of roots at e^(+-i theta), in float64."""
        with flint.ctx.workprec(max(self.bits, 1000)):
            alpha, beta = self.wall_with_root(flint.acb(0, theta).exp())
            return float(alpha.mid()), float(beta.mid())

    def wall_with_root(self, z: flint.acb) -> tuple[flint.arb, flint.arb]:
        """The wall that puts roots at z and its conjugate, by Cramer's rule."""
        base, stiffness, damping = (flint.acb_poly(part)(z) for part in self[:3])
        below = (stiffness.conjugate() * damping).imag
        alpha = (damping.conjugate() * base).imag / below
        return alpha, -(stiffness.conjugate() * base).imag / below

    def is_stable(self, alpha: float, beta: float, radius: float = 1.0) -> bool | None:
        """True if all roots lie inside the circle of a radius; None where the balls do not tell."""
        p = (self if radius == 1.0 else self.within(radius)).polynomial(alpha, beta)
        with flint.ctx.workprec(self.bits):
            return are_roots_inside(p)

    def within(self, radius: float) -> "BallLoop":
        """The loop whose roots are these over a radius."""
        with flint.ctx.workprec(self.bits):
            degree, inverse = self.base.degree(), 1 / flint.arb(radius)
            powers = [inverse ** (degree - k) for k in range(degree + 1)]
            parts = ([part[k] * power for k, power in enumerate(powers)] for part in self[:3])
            return BallLoop(*map(flint.arb_poly, parts), self.bits)


class InBalls(ABC):
    """A loop whose p(z) is known in balls, and what follows for a wall: its two gains."""

    @abstractmethod
    def balls(self) -> BallLoop:
        """p(z) for all walls, not divided by what cancels."""

    def polynomial(self, stiffness: float, damping: float) -> list[flint.arb]:
        """p(z), highest power first."""
        return self.balls().polynomial(stiffness, damping)

    def code(self, stiffness: float, damping: float) -> int:
        """The verdict, by certified roots."""
        return true_code(self.polynomial(stiffness, damping))

    def radius(self, stiffness: float, damping: float) -> flint.arb:
        """The spectral radius in a ball."""
        return largest_modulus(self.polynomial(stiffness, damping))
