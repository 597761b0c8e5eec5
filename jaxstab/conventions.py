"""Facts that every floor shares: the order of the parameters and the codes of a verdict.

Standard library only, so that a reader of an atlas can use it without JAX.
"""

from enum import IntEnum
from typing import Final

AXES: Final = ("alpha", "beta", "gamma", "delta", "delay")
"""The dimensionless parameters (paper, Table I) in the order of signatures, axes and files."""


class Verdict(IntEnum):
    """What is known about the stability of one point; a small integer, so that arrays store int8.

    A loop is stable when every root of its characteristic polynomial (paper, eq. (9)) lies inside
    the unit circle. Zero means that nothing was computed, so a block of a file that was wiped or
    never written cannot be mistaken for a verdict.

    Example:
        >>> jaxstab.verdict(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)
        <Verdict.STABLE: 1>
    """

    NOT_COMPUTED = 0
    STABLE = 1
    UNSTABLE = 2
    UNDECIDED = 3


class Status(IntEnum):
    """How far an answer can be trusted, as a small integer and in words.

    A member is written ``NAME = number, "words"``.
    """

    words: str

    def __new__(cls, number: int, words: str = "") -> "Status":
        """Make a member of its number; the words go with it."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.words = words
        return member


class RadiusStatus(Status):
    """How far the error of a spectral radius can be trusted.

    Example:
        >>> jaxstab.results.RadiusStatus(1).words
        'the error bound is proved'
    """

    NOT_COMPUTED = 0, "not computed"
    PROVED = 1, "the error bound is proved"
    NO_BOUND = 2, "no error bound could be proved: the error is infinite"
