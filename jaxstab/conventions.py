"""Facts that every floor shares: common arguments and errors, their order, codes of a verdict.

Standard library only, so that a reader of an atlas can use it without JAX.

Arguments that many functions have. T is the sampling period and m the mass that moves, the hand's
included. Where numbers or arrays are accepted, arrays have any shape and broadcast with each other.

    alpha: wall stiffness K T^2/m.
    beta: wall damping B T/m.
    gamma: physical stiffness k T^2/m, in [0, 1e4].
    delta: physical damping b T/m, in [0, 1e3].
    delay: time delay t_d/T in samples, >= 0, whole or fractional; concrete under JAX unless the
        function takes a ``longest_delay``.
    longest_delay: a concrete number that no delay exceeds, so that JAX may trace the delay: its
        p(z) has the degree of the longest one, with more roots at 0. Beyond it, traced delays give
        NaN and UNDECIDED.
    velocity: velocity estimator in units of one sample; None for the difference over one sample.
    position: position filter in units of one sample; None for none.
    stiffness: wall stiffness K in N/m, or in N m/rad for a loop that turns.
    damping: wall damping B in N s/m, or in N m s/rad for a loop that turns.

Errors that such functions raise: ValueError for a concrete argument that is outside its range,
infinite or NaN; TypeError for one that is not made of numbers, or that JAX traces where it must be
concrete (a delay without ``longest_delay``); RuntimeError for JAX arrays while JAX's x64 mode is
off.
"""

from enum import IntEnum
from typing import Any, Final, Literal, TypeAlias

AXES: Final = ("alpha", "beta", "gamma", "delta", "delay")
"""The dimensionless parameters (paper, Table I) in the order of signatures, axes and files."""

Range: TypeAlias = tuple[float, float]
"""The lowest and the highest value of a quantity that varies."""

Excitation: TypeAlias = Literal["force", "impact"]
"""What a settling time refers to: a constant push, or a velocity at the wall."""

HORIZON: Final = 1 << 18
"""Samples after which a loop that is not proved to have settled is given up."""


class Code(IntEnum):
    """A small integer with a name, so that arrays store int8."""

    @classmethod
    def _missing_(cls, value: Any) -> Any:
        # An array has no hash, by which Python finds a member: the code of one point is its number.
        return cls(value.item()) if getattr(value, "shape", None) == () else None

    def __str__(self) -> str:
        return self.name

    def __format__(self, spec: str) -> str:
        return format(int(self), spec) if spec else str(self)


class Verdict(Code):
    """A verdict on the stability of one point.

    A loop is stable when every root of its characteristic polynomial (paper, eq. (9)) lies inside
    the unit circle. Zero means that nothing was computed, so a block of a file that was wiped or
    never written cannot be mistaken for a verdict.

    STABLE alone is true: ``if verdict:`` asks for a proof. Several points, and arrays of JAX, have
    int8 codes, of which NumPy takes all but 0 for true: compare them, ``codes == Verdict.STABLE``.

    Example:
        >>> found = jaxstab.verdict(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)
        >>> found, bool(found), bool(jaxstab.Verdict.UNDECIDED)
        (<Verdict.STABLE: 1>, True, False)
        >>> codes = jaxstab.verdict([0.1, 1.0], 0.2, gamma=0.0, delta=0.015, delay=1.0)
        >>> (codes == jaxstab.Verdict.STABLE).tolist()
        [True, False]
    """

    NOT_COMPUTED = 0
    STABLE = 1
    UNSTABLE = 2
    UNDECIDED = 3

    def __bool__(self) -> bool:
        return self is Verdict.STABLE


class Status(Code):
    """A status: a small integer with a description.

    A member is written ``NAME = number, "words"``.
    """

    words: str

    def __new__(cls, code: int, words: str = "") -> "Status":
        """Make a member of its number; the words go with it."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.words = words
        return member


class RadiusStatus(Status):
    """The origin of the error of a spectral radius; it is infinite without a bound.

    Example:
        >>> jaxstab.results.RadiusStatus(1).words
        'proved'
    """

    NOT_COMPUTED = 0, "not computed"
    PROVED = 1, "proved"
    NO_BOUND = 2, "no bound proved"
