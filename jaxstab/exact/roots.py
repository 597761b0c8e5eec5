"""E1 and E2. The roots of p(z): how many are outside the unit circle, and where they are.

E1. The number of roots of p(z) outside the unit circle. The criterion of Schur (1917) and Cohn
(1922). Let p = a_n z^n + ... + a_0 be real and p* the same coefficients backwards; on the circle
|p| = |p*|. With k = a_0/a_n the constant term of p - k p* is 0, and p' = (p - k p*)/z has degree
n - 1 and the leading coefficient a_n (1 - k^2).

- |k| < 1: on the circle |k p*| < |p|, so that p and p - k p* have equally many roots inside
  (Rouché): p' has one less inside, and as many outside.
- |k| > 1: likewise p* and p* - p/k = -z p'/k have equally many inside, and those of p* are the
  inverses of those of p: p has as many outside as p' has inside, and one more.

Down to degree 0 all p' are formed; with P_j the product of the first j factors 1 - k^2, that is the
sign of the j-th leading coefficient over that of a_n, the number of roots outside is the number of
negative P_j (Jury 1964). Two steps with |k| > 1 are two changes of sides, and that is what the
product says. A root on the circle is one of p, p* and so of all p', which ends at degree 1 with
|k| = 1: it is never counted wrongly, the balls do not decide.

All |k| < 1 is therefore the same as stable. The recursion loses about one bit a step. Where k is 1
or -1 by accident (the moduli of some roots have the product 1), it ends without an answer at any
precision. Then the roots outside of two circles are counted that are a little larger and a little
smaller: between equal numbers there is no root, and the number is that of the unit circle.

Where the structure says that a root lies at z = 1 or -1 exactly (a free device without a wall),
the loop is not stable: that is no question for balls. A damper without a spring leaves such a root
at 1, the position may stay anywhere; whether all others are inside is asked with ``may_drift``.

E2. The poles of a wall, each in a ball of its own, and their largest modulus. python-flint isolates
the roots of a polynomial without multiple roots: approximations by iteration, around each of them a
disc in which Rouché's theorem finds one root (``acb_poly.roots``), and n disjoint discs hold all n
roots. Roots at 0, 1 and -1 that the structure knows are exact, and not asked for. The largest of
the moduli is the spectral radius, to the last bit of a float64: where the balls are wider, more
bits are asked for.

Poles that coincide, as those of two equal low passes in a row beside a wall that does not use them
(B = 0), are never isolated. Their radius is still known: all roots lie inside the circle of radius
r if and only if those of p(r z) lie inside the unit circle, which E1 decides on both sides of it.
The radius is enclosed by halving, between 0 and Cauchy's bound 1 + max |a_k/a_n|.
"""

from collections.abc import Callable
from functools import partial
from math import inf, nextafter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Complex128

from jaxstab.conventions import Status, Verdict
from jaxstab.model.affine import AffineParts, affine_triple
from jaxstab.model.balls import Factored, Triple
from jaxstab.model.device.parts import FIRST_BITS, decided, flint, tiny, working_precision
from jaxstab.model.filters import has_roots_inside, reflections

if TYPE_CHECKING:
    from flint import acb, arb, arb_poly, fmpq_poly


_MOST_BITS = FIRST_BITS << 3  # bits: balls that still overlap hold multiple roots, in practice

TripleAt = Callable[[], Triple]
"""Gives the parts of p(z) in balls of the precision that is set, as ``ball_triple(loop)``."""


class VerdictStatus(Status):
    """Why a verdict is what it is."""

    PROVED = 1, "proved"
    ON_CIRCLE = 2, "a root lies on the unit circle by structure, as where a free body drifts"
    ALGEBRAIC = 3, "the leading coefficient vanishes: the force depends on itself without delay"
    UNDECIDED = 4, "3,072 bits do not tell on which side of the circle a root is"


class WallVerdict(NamedTuple):
    """The verdict on a wall, and the reason."""

    verdict: Verdict
    status: VerdictStatus


def wall_verdict(
    triple: TripleAt, stiffness: float, damping: float, *, may_drift: bool = False
) -> WallVerdict:
    """The verdict on the wall (K, B): stable with all roots of p(z) inside the unit circle.

    With ``may_drift`` one root that the structure knows at z = 1 does not count.

    Example:
        >>> from jaxstab.exact.roots import wall_verdict
        >>> from jaxstab.model.balls import ball_triple
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> wall_verdict(lambda: ball_triple(loop), 50000.0, 20.0).verdict
        <Verdict.UNSTABLE: 2>
    """

    def judged() -> WallVerdict | None:
        parts = triple()
        p = parts.at(stiffness, damping)
        if p.degree < parts.degree:
            return WallVerdict(Verdict.UNDECIDED, VerdictStatus.ALGEBRAIC)
        if may_drift and p.at_one == 1:
            p = p._replace(at_one=0)
        if p.is_on_circle:
            return WallVerdict(Verdict.UNSTABLE, VerdictStatus.ON_CIRCLE)
        is_stable = are_inside(p)
        if is_stable is None:
            return None
        return WallVerdict(Verdict.STABLE if is_stable else Verdict.UNSTABLE, VerdictStatus.PROVED)

    answer = decided(judged)
    return answer or WallVerdict(Verdict.UNDECIDED, VerdictStatus.UNDECIDED)


def affine_verdict(parts: AffineParts, first: float, second: float) -> Verdict:
    """The verdict on two gains of a loop, in fractions where balls leave it open."""
    answer = wall_verdict(partial(affine_triple, parts), first, second)
    is_open = answer.status == VerdictStatus.UNDECIDED
    exact = parts.polynomial(first, second) if is_open else None
    if exact is None or exact.degree() < max(part.degree() for part in parts.rational() or ()):
        return answer.verdict
    return rational_verdict(exact)


def rational_verdict(p: "fmpq_poly") -> Verdict:
    """The verdict on a polynomial of exact numbers: always decided."""
    return Verdict.STABLE if has_roots_inside(p.coeffs()[::-1]) else Verdict.UNSTABLE


def are_inside(p: Factored) -> bool | None:
    """True if all roots of p are inside the circle; None where the balls do not tell."""
    if p.is_on_circle:
        return False
    outside = roots_outside(p.rest, most=0)
    return None if outside is None else not outside


def roots_outside(p: "arb_poly", most: int | None = None) -> int | None:
    """The number of roots of a polynomial outside the circle; None where the balls do not tell.

    Beyond ``most`` they are not counted on.
    """
    count = _counted(p.coeffs(), most)
    if count is None:
        near = tiny(4)
        stretched = (p(flint.arb_poly([0, 1 + side])) for side in (near, -near))
        counts = {_counted(q.coeffs(), most) for q in stretched}
        count = counts.pop() if len(counts) == 1 else None
    return count


def _counted(rising: "list[arb]", most: int | None) -> int | None:
    count, is_negative = 0, False
    for k in reflections(rising):
        if not abs(k) < 1:
            if not abs(k) > 1:
                return None
            is_negative = not is_negative
        count += is_negative
        if most is not None and count > most:
            return count
    return count


# -------------------------------------------------------------------------------------------- poles


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
    return int(ball.sgn().unique_fmpz() or 0)


def is_sharp(ball: "arb | acb") -> bool:
    """True if a ball is narrower than what a float64 tells of it."""
    return bool(ball.rel_accuracy_bits() >= 60)


class Poles(NamedTuple):
    """The poles of a wall, the largest first, pairs together, and a bound of the error of each.

    Where some coincide, up to 1,536 bits, they are not told apart: the poles are NaN and the error
    is infinite.
    """

    values: Complex128[np.ndarray, " pole"]
    error: float


def spectral_radius(triple: TripleAt, stiffness: float, damping: float) -> Number:
    """The largest modulus of the poles of the wall (K, B); an infinite error: nothing is proved."""
    p = partial(_polynomial, triple, stiffness, damping)
    number = decided(lambda: _largest_modulus(p()), most=_MOST_BITS)
    return number or decided(lambda: _radius_between(p())) or Number(np.nan, np.inf)


def rough_radius(triple: TripleAt, stiffness: float, damping: float) -> float:
    """The same in float64, without a bound."""
    with working_precision(FIRST_BITS):
        rising = triple().at(stiffness, damping).polynomial().coeffs()
    return float(np.abs(np.roots([float(c.mid()) for c in rising[::-1]])).max(initial=0.0))


def poles(triple: TripleAt, stiffness: float, damping: float) -> Poles:
    """All poles of the wall (K, B), those at z = 0 included."""
    p = partial(_polynomial, triple, stiffness, damping)
    found = decided(lambda: _rounded(real_or_not(isolated_roots(p()))), most=_MOST_BITS)
    if found is None:
        with working_precision(FIRST_BITS):
            return Poles(np.full(triple().degree, complex(np.nan, np.nan)), np.inf)
    return found


def _rounded(roots: "list[tuple[acb, bool]] | None") -> Poles | None:
    """Poles in float64, of balls that tell which are real."""
    if roots is None:
        return None
    values, error = [], 0.0
    for root, is_real in roots:
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
    if p is None:
        return None
    rest = p.without_windows().rest
    rising = rest.coeffs()
    known = flint.arb(1 if p.is_on_circle else 0)
    low = flint.arb(0)
    high = 1 + sum((abs(c / rising[-1]) for c in rising[:-1]), flint.arb(0)).upper()
    for _ in range(flint.ctx.prec):
        middle = (low + (high - low) * share).mid()
        is_within = are_inside(Factored(rest(flint.arb_poly([0, middle]))))
        if is_within is None:
            return None
        low, high = (low, middle) if is_within else (middle, high)
        radius = low.union(high)
        if is_sharp(radius):
            break
    return Number.of(radius.max(known))
