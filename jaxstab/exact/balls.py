"""Balls of python-flint: precision is raised until a question is decided.

A ball is a midpoint and a radius; every operation returns a ball that holds all results for all
numbers of its arguments (F. Johansson, Arb, 2017). So what is true of balls is true of the numbers,
at any precision, and no rounding errors are estimated by hand. What is not decided is asked again
with twice the bits, 192 at first and 3,072 at most. What is open then is UNDECIDED, with the
reason.

The precision is one number of the process. ``decided`` sets it under one lock and restores it, so
that threads may ask at the same time; they wait for each other.
"""

from collections.abc import Callable
from math import inf, nextafter
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from jaxstab.model.balls import Triple
from jaxstab.model.device.parts import working_precision

if TYPE_CHECKING:
    from flint import arb

FIRST_BITS, MOST_BITS = 192, 192 << 4

TripleAt = Callable[[], Triple]
"""Gives the parts of p(z) in balls of the precision that is set, as ``ball_triple(loop)``."""

Answer = TypeVar("Answer")


def decided(
    question: Callable[[], Answer | None], most: int = MOST_BITS, first: int = FIRST_BITS
) -> Answer | None:
    """Ask with more and more bits until the answer is not None; None where the most do not do."""
    bits = first
    while True:
        with working_precision(bits):
            answer = question()
        if answer is not None or bits >= most:
            return answer
        bits *= 2


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
