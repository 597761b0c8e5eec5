"""What questions in balls share: the loop that they ask about, numbers with errors, signs.

What is not decided at one precision is asked again at twice the bits (``decided``), so what is true
of balls is true of the numbers; what is open at the most bits is UNDECIDED, with the reason.
"""

from collections.abc import Callable
from math import inf, nextafter
from typing import TYPE_CHECKING, NamedTuple

from jaxstab.model.balls import Triple

if TYPE_CHECKING:
    from flint import arb

TripleAt = Callable[[], Triple]
"""Gives the parts of p(z) in balls of the precision that is set, as ``ball_triple(loop)``."""


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
