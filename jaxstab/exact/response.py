"""E4. What a stable loop does in time: sums of moduli, peaks and settling, with proved bounds.

A transfer function c(z)/p(z) answers an impulse with h_k, the coefficients of 1/z^k: a quotient of
power series in 1/z, formed in balls (Newton's iteration for 1/p). With simple poles z_j (E2) and
the residues r_j = c(z_j)/p'(z_j),

    h_k = sum of r_j z_j^(k-1),    |h_k| <= e_k = sum of |r_j| |z_j|^(k-1),    k > 0,

so that all that is beyond a sample N is at most e_N, which falls with N, and

    |h_N| + |h_(N+1)| + ... <= sum of |r_j| |z_j|^(N-1)/(1 - |z_j|).

The head is summed as it is. That bounds the l1 norm, by which a disturbance that is never larger
than 1 may move the output (an encoder, an amplifier, friction; Vidyasagar 1986), the largest |h_k|,
and the sample from which |h_k| stays below a level. Roots of p at 0 only delay and are left out.
Poles that coincide have no such residues: not proved.
"""

from collections.abc import Callable
from math import inf, nextafter
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from jaxstab.conventions import Status
from jaxstab.exact.balls import decided
from jaxstab.exact.roots import isolated_roots
from jaxstab.model.balls import Factored

if TYPE_CHECKING:
    from flint import arb, arb_poly

_FIRST, _MOST = 64, 1 << 16  # samples of the head
_TAIL = 1e-9  # of the head: a sum is known well enough
_DIGITS = 40  # bits of a sum or a peak
_MOST_BITS = 3072

TransferAt = Callable[[], tuple[Factored, Factored]]
"""Gives c and p in balls of the precision that is set."""

Answer = TypeVar("Answer")


class ResponseStatus(Status):
    """Whether a bound is proved."""

    PROVED = 1, "proved"
    UNSTABLE = 2, "the loop is unstable: there is no bound"
    NOT_PROVED = 3, "not proved: poles coincide, or are too close to the unit circle"


class Bounds(NamedTuple):
    """A number between two others."""

    low: float
    high: float
    status: ResponseStatus


class Settled(NamedTuple):
    """The first sample from which on the response stays within a level; infinite without one."""

    sample: float
    status: ResponseStatus


def l1_norm(transfer: TransferAt) -> Bounds:
    """The sum of all |h_k|."""

    def question(motion: "_Motion") -> Bounds | None:
        least = sum(map(abs, motion.head(_FIRST)), motion.nothing) * _TAIL
        lengths = (n for n in _lengths() if n == _MOST or motion.sum_beyond(n) < least)
        count = next(lengths)
        head = sum(map(abs, motion.head(count)), motion.nothing)
        return _bounds(head, head + motion.sum_beyond(count)) if _is_known(head) else None

    return _asked(transfer, question, lambda status: Bounds(0.0, inf, status))


def peak(transfer: TransferAt) -> Bounds:
    """The largest |h_k|: by how much the response grows before it decays."""

    def question(motion: "_Motion") -> Bounds | None:
        for count in _lengths():
            highest = motion.nothing
            for value in motion.head(count):
                highest = highest.max(abs(value))
            if not _is_known(highest):
                return None
            if motion.beyond(count) < highest or count == _MOST:
                return _bounds(highest, highest.max(motion.beyond(count)))
        return None

    return _asked(transfer, question, lambda status: Bounds(0.0, inf, status))


def settling_sample(transfer: TransferAt, level: float) -> Settled:
    """The first sample k from which on |h_k| is never above a level > 0."""

    def question(motion: "_Motion") -> Settled | None:
        for count in _lengths():
            if motion.beyond(count) < level:
                head = [abs(value) for value in motion.head(count)]
                for k in range(count - 1, -1, -1):
                    if head[k] > level:
                        return Settled(float(k + 1), ResponseStatus.PROVED)
                    if not head[k] <= level:
                        return None
                return Settled(0.0, ResponseStatus.PROVED)
        return Settled(inf, ResponseStatus.NOT_PROVED)

    return _asked(transfer, question, lambda status: Settled(inf, status))


def _is_known(ball: "arb") -> bool:
    """Whether a sum of moduli has digits: quotients of series lose some with every sample."""
    return bool(ball == 0 or ball.rel_accuracy_bits() > _DIGITS)


def _bounds(low: "arb", high: "arb") -> Bounds:
    least, most = float(low.lower()), float(high.upper())
    return Bounds(nextafter(least, 0.0), nextafter(most, inf), ResponseStatus.PROVED)


def _asked(
    transfer: TransferAt,
    question: "Callable[[_Motion], Answer | None]",
    without: Callable[[ResponseStatus], Answer],
) -> Answer:
    """Ask a stable transfer function of which the poles are known."""

    def answer() -> Answer | None:
        motion = _Motion.of(*transfer())
        if motion is None:
            return None
        return without(motion) if isinstance(motion, ResponseStatus) else question(motion)

    return decided(answer, most=_MOST_BITS) or without(ResponseStatus.NOT_PROVED)


def _lengths() -> list[int]:
    lengths = [_FIRST]
    while lengths[-1] < _MOST:
        lengths.append(2 * lengths[-1])
    return lengths


class _Motion(NamedTuple):
    """c/p by its series in 1/z, and by moduli of residues and poles.

    ``early`` is by how many samples the response begins before h_1: deg c - deg p + 1.
    """

    above: "arb_poly"
    below: "arb_poly"
    early: int
    decays: "list[tuple[arb, arb]]"
    nothing: "arb"

    @classmethod
    def of(cls, c: Factored, p: Factored) -> "_Motion | ResponseStatus | None":
        """A transfer function; its status if it is not stable, None where more bits are needed."""
        from flint import acb_poly, arb, arb_poly

        above, below = (part._replace(power=0).polynomial() for part in (c, p))
        roots = isolated_roots(p._replace(power=0))
        if roots is None:
            return None
        if any(abs(root) > 1 for root in roots) or p.is_on_circle:
            return ResponseStatus.UNSTABLE
        if not all(abs(root) < 1 for root in roots):
            return None
        c_at, slope = acb_poly(above), acb_poly(below).derivative()
        decays = [(abs(c_at(root) / slope(root)), abs(root)) for root in roots]
        return cls(
            arb_poly(above.coeffs()[::-1]),
            arb_poly(below.coeffs()[::-1]),
            above.degree() - below.degree() + 1,
            decays,
            arb(0),
        )

    def head(self, count: int) -> "list[arb]":
        """The first samples, from the first that may not be 0 on."""
        from flint import arb_poly

        inverse, length = arb_poly([1 / self.below[0]]), 1
        while length < count:
            length = min(2 * length, count)
            error = (self.below.truncate(length) * inverse).truncate(length) - 1
            inverse = inverse - (inverse * error).truncate(length)
        series = (self.above.truncate(count) * inverse).truncate(count)
        return [series[k] for k in range(count)]

    def beyond(self, count: int) -> "arb":
        """A bound of all samples beyond the head."""
        power = count - self.early
        return sum((size * modulus**power for size, modulus in self.decays), self.nothing)

    def sum_beyond(self, count: int) -> "arb":
        """A bound of the sum of their moduli."""
        power = count - self.early
        return sum(
            (size * modulus**power / (1 - modulus) for size, modulus in self.decays), self.nothing
        )
