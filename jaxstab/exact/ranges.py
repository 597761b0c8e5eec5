"""E6. The verdict on a loop for all values of two numbers in which p(z) is a polynomial.

For p of degree d with the leading coefficient a and the roots z_1, ..., z_d let

    c = a^(d+1) (product of 1 - z_i^2 over i, and of 1 - z_i z_l over i < l).

It is 0 where a root is on the circle, and symmetric in the roots, so a polynomial of degree d + 1
in the coefficients of p. By the k of E1 (``exact.roots``), one a degree j,

    c = a^(d+1) (product of (1 - k^2)^((j+1)//2), and of 1 + k for even j),

positive while all roots are inside and a > 0. It is evaluated at as many nodes as its degree asks
for, and interpolated. Where all coefficients of a polynomial in the basis of Bernstein are
positive, it is positive on the whole rectangle; else the rectangle is halved. A corner where it is
negative, or a node with a root outside, is a loop that is not stable.
"""

from collections.abc import Callable
from itertools import product
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxstab.conventions import Verdict
from jaxstab.exact.roots import sign_of
from jaxstab.model.balls import Factored
from jaxstab.model.device.parts import FIRST_BITS, decided, exact, flint
from jaxstab.model.filters import reflections

if TYPE_CHECKING:
    from flint import arb, arb_mat, arb_poly

_MOST_PIECES = 1000  # of the rectangle
_MOST_WORK = 4_000_000  # products of balls: seconds


class Range(NamedTuple):
    """Values from ``low`` > 0 to ``high``; p(z) is a polynomial in a ``coordinate`` of them."""

    low: float
    high: float
    degree: int = 1
    coordinate: Callable[[Any], Any] = lambda value: value

    def nodes(self, degree: int) -> list[float]:
        """As many values as a polynomial of some degree in each coefficient of p(z) needs."""
        if self.low == self.high:
            return [self.low]
        high = max(self.high, self._apart)
        return np.geomspace(self.low, high, self.degree * degree + 1).tolist()

    @property
    def is_narrow(self) -> bool:
        """True if nodes need a wider range, in which a loop that is not stable says nothing."""
        return self.low < self.high < self._apart

    @property
    def _apart(self) -> float:
        return self.low * (1.0 + 1e-6)

    def to_bernstein(self, nodes: list[float]) -> "arb_mat":
        """From values at nodes to coefficients on the range."""
        first, *_, last = places = [self.coordinate(exact(node)) for node in (*nodes, nodes[-1])]
        spread = last - first or 1
        sides = [flint.arb_poly([(last - t) / spread, (t - first) / spread]) for t in places[:-1]]
        return flint.arb_mat([_coefficients(side, len(nodes)) for side in sides]).inv()


def _coefficients(side: "arb_poly", count: int, power: int | None = None) -> "list[arb]":
    """The values of the basis of Bernstein: those of (1 - t + t y)^n for all powers of y."""
    own = side ** (count - 1 if power is None else power)
    return [own[j] for j in range(count)]


def stable_over(p: Callable[[float, float], Factored], first: Range, second: Range) -> Verdict:
    """The verdict on all pairs of two values; UNDECIDED where it takes too long, too.

    Example:
        >>> from flint import arb_poly
        >>> from jaxstab.exact.ranges import Range, stable_over
        >>> from jaxstab.model.balls import Factored
        >>> def p(a: float, b: float) -> Factored:  # inside of |a| < 1 + b, b < 1
        ...     return Factored(arb_poly([b, a, 1]))
        >>> [stable_over(p, Range(0.5, a), Range(0.25, 0.75)).name for a in (1.24, 1.26)]
        ['STABLE', 'UNSTABLE']
    """

    def judged() -> Verdict | None:
        degree, values = p(first.low, second.low).degree, list[Any]()
        nodes = first.nodes(degree + 1), second.nodes(degree + 1)
        counts = len(nodes[0]), len(nodes[1])
        if sum(n**3 for n in counts) + 4 * prod(counts) * degree**2 > _MOST_WORK:
            return Verdict.UNDECIDED
        for pair in product(*nodes):
            value = _clearance(p(*pair))
            if value is None or isinstance(value, Verdict):
                return value
            values.append(value)
        try:
            left, right = first.to_bernstein(nodes[0]), second.to_bernstein(nodes[1])
        except ZeroDivisionError:  # these bits do not tell the nodes apart
            return None
        return _sign(left * flint.arb_mat(*counts, values) * right.transpose())

    code = decided(judged, most=(FIRST_BITS << 3))
    is_wider = first.is_narrow or second.is_narrow
    if code is None or (is_wider and code == Verdict.UNSTABLE):
        return Verdict.UNDECIDED
    return code


def _clearance(p: Factored) -> "arb | Verdict | None":
    """c, or UNSTABLE if a root is outside; None where the balls do not tell."""
    rising = p.polynomial().coeffs()
    clear = rising[-1] ** len(rising)
    if sign_of(rising[-1]) != 1:
        return None
    for j, k in zip(range(len(rising) - 1, 0, -1), reflections(rising), strict=True):
        if not abs(k) < 1:
            return Verdict.UNSTABLE if abs(k) > 1 else None
        clear *= (1 - k * k) ** ((j + 1) // 2) * (1 if j % 2 else 1 + k)
    return clear


def _sign(coefficients: "arb_mat") -> Verdict | None:
    """The verdict by Bernstein coefficients of c on a rectangle; None where balls do not tell."""
    pieces = [(coefficients, 0)]
    halving = [_halves(n) for n in (coefficients.nrows(), coefficients.ncols())]
    for _ in range(_MOST_PIECES):
        if not pieces:
            return Verdict.STABLE
        piece, axis = pieces.pop()
        if all(c > 0 for c in piece.entries()):
            continue
        rows, columns = piece.nrows() - 1, piece.ncols() - 1
        corners = {sign_of(piece[i, j]) for i in {0, rows} for j in {0, columns}}
        if -1 in corners:
            return Verdict.UNSTABLE
        if 0 in corners:
            return None
        axis = axis if (rows, columns)[axis] else 1 - axis
        halves = [half * piece if axis == 0 else piece * half.transpose() for half in halving[axis]]
        pieces += [(half, 1 - axis) for half in halves]
    return Verdict.UNDECIDED


def _halves(count: int) -> "list[arb_mat]":
    """From the coefficients on an interval to those on its two halves."""
    middle = flint.arb_poly([0.5, 0.5])
    lower = [_coefficients(middle, count, power) for power in range(count)]
    return [flint.arb_mat(lower), flint.arb_mat([row[::-1] for row in lower[::-1]])]
