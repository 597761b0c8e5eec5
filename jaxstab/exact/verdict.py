"""E1. The verdict on a wall: the number of roots of p(z) outside the unit circle.

The criterion of Schur (1917) and Cohn (1922). Let p = a_n z^n + ... + a_0 be real and p* the same
coefficients backwards; on the circle |p| = |p*|. With k = a_0/a_n the constant term of p - k p* is
0, and p' = (p - k p*)/z has degree n - 1 and the leading coefficient a_n (1 - k^2).

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
"""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from jaxstab.conventions import Status, Verdict
from jaxstab.model.affine import AffineParts, affine_triple
from jaxstab.model.balls import Factored, Triple
from jaxstab.model.device.parts import decided, flint, tiny
from jaxstab.model.filters import has_roots_inside, reflections

if TYPE_CHECKING:
    from flint import arb, arb_poly, fmpq_poly


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
        >>> from jaxstab.exact.verdict import wall_verdict
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
        outside = roots_outside(p.rest, most=0)
        if outside is None:
            return None
        return WallVerdict(Verdict.UNSTABLE if outside else Verdict.STABLE, VerdictStatus.PROVED)

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
