"""E2. The poles of a wall, each in a ball of its own, and their largest modulus.

python-flint isolates the roots of a polynomial without multiple roots: approximations by iteration,
around each of them a disc in which Rouché's theorem finds one root (``acb_poly.roots``), and n
disjoint discs hold all n roots. Roots at 0, 1 and -1 that the structure knows are exact, and not
asked for. The largest of the moduli is the spectral radius, to the last bit of a float64: where the
balls are wider, more bits are asked for.

Poles that coincide, as those of two equal low passes in a row beside a wall that does not use them
(B = 0), are never isolated. Their radius is still known: all roots lie inside the circle of radius
r if and only if those of p(r z) lie inside the unit circle, which E1 decides on both sides of it.
The radius is enclosed by halving, between 0 and Cauchy's bound 1 + max |a_k/a_n|.
"""

from functools import partial
from math import inf, nextafter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Complex128

from jaxstab.exact.verdict import TripleAt, roots_outside
from jaxstab.model.balls import Factored
from jaxstab.model.device.parts import FIRST_BITS, decided, flint, tiny, working_precision

if TYPE_CHECKING:
    from flint import acb, arb, arb_poly

MOST_FOR_ROOTS = 1024  # bits: balls that still overlap then hold multiple roots, in practice


class Number(NamedTuple):
    """A float64, and how far from it the true number may at most be."""

    value: float
    error: float

    @classmethod
    def of(cls, ball: "arb") -> "Number":
        """The float64 next to the middle of a ball."""
        value = float(ball.mid())
        rest = (ball - value).abs_upper()
        return cls(value, nextafter(float(rest), inf) if rest > 0 else 0.0)


def sign_of(ball: "arb") -> int:
    """1 or -1 where all of a ball has that sign, else 0."""
    return (1 if ball > 0 else 0) - (1 if ball < 0 else 0)


def is_sharp(ball: "arb | acb") -> bool:
    """True if a ball is narrower than what a float64 tells of it."""
    return bool(ball.rel_accuracy_bits() >= 60)


class Poles(NamedTuple):
    """The poles of a wall, the largest first, pairs together, and a bound of the error of each.

    Where some coincide, up to 1,024 bits, they are not told apart: the poles are NaN and the error
    is infinite.
    """

    values: Complex128[np.ndarray, " pole"]
    error: float


def spectral_radius(triple: TripleAt, stiffness: float, damping: float) -> Number:
    """The largest modulus of the poles of the wall (K, B); an infinite error: nothing is proved."""
    p = partial(_polynomial, triple, stiffness, damping)
    number = decided(lambda: _largest_modulus(p()), most=MOST_FOR_ROOTS)
    return number or decided(lambda: _radius_between(p())) or Number(np.nan, np.inf)


def rough_radius(triple: TripleAt, stiffness: float, damping: float) -> float:
    """The same in float64, without a bound."""
    with working_precision(FIRST_BITS):
        rising = triple().at(stiffness, damping).polynomial().coeffs()
    return float(np.abs(np.roots([float(c.mid()) for c in rising[::-1]])).max(initial=0.0))


def poles(triple: TripleAt, stiffness: float, damping: float) -> Poles:
    """All poles of the wall (K, B), those at z = 0 included."""
    p = partial(_polynomial, triple, stiffness, damping)
    found = decided(lambda: real_or_not(isolated_roots(p())), most=MOST_FOR_ROOTS)
    if found is None:
        return Poles(np.full(triple().degree, complex(np.nan, np.nan)), np.inf)
    values, error = [], 0.0
    for root, is_real in found:
        if is_real or root.imag > 0:
            real = Number.of(root.real)
            imaginary = Number(0.0, 0.0) if is_real else Number.of(root.imag)
            pole = complex(real.value, imaginary.value)
            values += [pole] if is_real else [pole, pole.conjugate()]
            error = max(error, real.error + imaginary.error)
    values.sort(key=abs, reverse=True)
    return Poles(np.array(values, np.complex128), error * (1.0 + 1e-15))


def _polynomial(triple: TripleAt, stiffness: float, damping: float) -> Factored | None:
    """p(z) of a wall; None where its leading coefficient vanishes: a root is at infinity."""
    parts = triple()
    p = parts.at(stiffness, damping)
    return p if p.degree == parts.degree else None


def isolated_roots(p: Factored | None) -> "list[acb] | None":
    """The roots in balls, those that the structure knows exactly; None where they overlap."""
    if p is None:
        return None
    p = p.without_windows()
    known = [flint.acb(0)] * p.power
    known += [flint.acb(1)] * p.at_one + [flint.acb(-1)] * p.at_minus_one
    if p.rest.degree() < 1:
        return known
    found = _isolated(p.rest)
    return None if found is None else known + found


def _isolated(polynomial: "arb_poly") -> "list[acb] | None":
    try:
        return list(flint.acb_poly(polynomial).roots(tol=tiny(2)))
    except ValueError:
        return None


def real_or_not(roots: "list[acb] | None") -> "list[tuple[acb, bool]] | None":
    """All roots of a real polynomial, each with whether it is real; None where balls do not tell.

    The mirror image of a root is a root, too. Where it can be in the same ball alone it is the root
    itself; a ball that meets the real axis may also hold one of a pair, with the other beside it.
    """
    if roots is None:
        return None
    answers = []
    for root in roots:
        is_real = bool(root.imag.contains(0))
        if is_real and root.imag.rad() > 0:
            mirrored = flint.acb(root.real, -root.imag)
            if sum(mirrored.overlaps(other) for other in roots) > 1:
                return None
        answers.append((root, is_real))
    return answers


def real_roots(polynomial: "arb_poly") -> "list[arb] | None":
    """All real roots, in balls that do not touch; None where they are not told apart."""
    told = real_or_not(_isolated(polynomial))
    return None if told is None else [root.real for root, is_real in told if is_real]


def _largest_modulus(p: Factored | None) -> Number | None:
    """The largest modulus of a root; None where it is not known to a float64."""
    roots, radius = isolated_roots(p), flint.arb(0)
    if roots is None:
        return None
    for root in roots:
        radius = radius.max(abs(root))
    return Number.of(radius) if is_sharp(radius) else None


def _radius_between(p: Factored | None) -> Number | None:
    """The same by halving with E1; None where the balls do not tell on which side the roots are."""
    share = 0.4873  # of an interval, where it is divided: not next to a simple number
    halvings = 160
    if p is None:
        return None
    rest = p.without_windows().rest
    rising = rest.coeffs()
    known = flint.arb(1 if p.is_on_circle else 0)
    low = flint.arb(0)
    high = 1 + sum((abs(c / rising[-1]) for c in rising[:-1]), flint.arb(0)).upper()
    for _ in range(halvings):
        middle = (low + (high - low) * share).mid()
        outside = roots_outside(rest(flint.arb_poly([0, middle])), most=0)
        if outside is None:
            return None
        low, high = (middle, high) if outside else (low, middle)
        radius = low.union(high)
        if is_sharp(radius):
            break
    return Number.of(radius.max(known))
