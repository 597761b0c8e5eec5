"""C6. Passive walls of every estimator, filter and delay, whole or not, as one cosine sum.

The force K P(z) + B V(z) = H(z) times the position, H of stable filters with V(1) = 0 and
P(1) > 0, comes n + f samples late, 0 <= f < 1, and is held for a period T. A damper b > 0 is at
the point where it acts. Together they draw no energy from any motion of the hand, whatever it does
between the samples, if and only if K >= 0 and for all angles (lemma C6)

    b >= R + f (1 - f) T^2 |H|^2/(4 b),
    R = T/(2 - 2 cos(theta)) Re((1 - 1/z) z^-n (1 - f + f/z) H),    z = e^(i theta).

The mass, and whatever is passive behind it, plays no part. With H = N/D all is multiplied by
|D|^2. Nothing is divided: in Re((1 - 1/z) z^k)/(2 - 2 cos) is -D_(k-1)/2 for k >= 1 and D_(-k)/2
for k <= 0, D_j = 1 + 2 cos(theta) + ... + 2 cos(j theta), so that the left side less the right one
is a cosine sum, which is positive (``circle``) or not proved to be.

For one angle the condition describes a convex set of (K, B), which grows in proportion to b: the
larger eigenvalue of a Hermitian form is at most b. ``needed`` has that eigenvalue, in float64.
"""

from collections.abc import Callable
from functools import cached_property
from math import floor, pi
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_poly
from jaxtyping import Float64

from jaxstab.exact.circle import is_positive
from jaxstab.exact.floats import FloatValues
from jaxstab.exact.roots import are_inside, sign_of
from jaxstab.model.balls import Factored
from jaxstab.model.device.parts import FIRST_BITS, decided, working_precision

Angles = Float64[np.ndarray, " angle"]


class Filters(NamedTuple):
    """P = Np/Dp and V = Nv/Dv, V in 1/s, in balls."""

    position: tuple[Factored, Factored]
    velocity: tuple[Factored, Factored]

    @property
    def below(self) -> Factored:
        """The denominator of H."""
        return self.position[1].times(self.velocity[1])

    def above(self, stiffness: float, damping: float) -> Factored:
        """The numerator of H."""
        (above_p, below_p), (above_v, below_v) = self.position, self.velocity
        by_stiffness = above_p.times(below_v).scaled(stiffness)
        return by_stiffness.plus(above_v.times(below_p).scaled(damping))

    @property
    def are_covered(self) -> bool | None:
        """True if both are stable, V(1) = 0 and P(1) > 0; None where balls do not tell."""
        if not self.velocity[0].at_one:
            return False
        is_stable = are_inside(self.below)
        sign = sign_of(self.position[0].at_end(1)) * sign_of(self.position[1].at_end(1))
        return None if is_stable is None or not sign else bool(is_stable and sign > 0)


def difference(period: float) -> Filters:
    """The position as it is, and its difference over one sample."""
    one = Factored(arb_poly([1]))
    above, below = Factored(arb_poly([1 / arb(period)]), at_one=1), Factored(arb_poly([1]), power=1)
    return Filters((one, one), (above, below))


class Wall:
    """A wall behind its filters, a delay and a hold, beside a damper.

    Args:
        filters: makes them, in balls of the precision that is set.
        delay: in samples.
        period: T in s.
        damper: b in N s/m, > 0.
    """

    def __init__(
        self, filters: Callable[[], Filters], delay: float, period: float, damper: float
    ) -> None:
        self.filters, self.delay, self.period, self.damper = filters, delay, period, damper

    def is_passive(self, stiffness: float, damping: float) -> bool | None:
        """True if the wall (K, B) is proved passive, False if not; None where it is not told."""
        if stiffness < 0.0:
            return False
        if stiffness == damping == 0.0 or self.damper == 0.0:
            return stiffness == damping == 0.0  # the mean of R is T K P(1)/2, so that some R > 0

        def answer() -> bool | None:
            filters = self.filters()
            sides = self._cosines(filters.above(stiffness, damping), filters.below)
            return is_positive(sides)

        return decided(answer)

    def _cosines(self, above: Factored, below: Factored) -> list[arb]:
        """The damper times |D|^2, less what the damper has to take times |D|^2, as a cosine sum."""
        whole, period = floor(self.delay), arb(self.period)
        late = arb(self.delay) - whole
        n, d = above.polynomial(), below.polynomial()
        late_force = n * arb_poly(d.coeffs()[::-1]) * arb_poly([late, 1 - late])
        shift = whole + 1 + int(d.degree())
        orders = [k - shift for k in range(len(late_force.coeffs()))]
        kernels = [arb(0)] * (max(map(abs, orders)) + 1)  # by the orders of Dirichlet's
        for order, c in zip(orders, late_force.coeffs(), strict=True):
            kernels[max(order - 1, -order)] += -c if order >= 1 else c
        size = max(len(kernels), len(d.coeffs()), len(n.coeffs()))
        total, tail = [arb(0)] * size, arb(0)
        for order in reversed(range(len(kernels))):
            tail += kernels[order]
            total[order] -= tail * period / (1 if order else 2)
        fold = period**2 * late * (1 - late) / (4 * arb(self.damper))
        for weight, side in ((arb(self.damper), d), (-fold, n)):
            for lag, c in enumerate(_squared(side)):
                total[lag] += weight * c
        return total

    # What follows suggests.

    @cached_property
    def _values(self) -> list[FloatValues]:
        with working_precision(FIRST_BITS):
            filters = self.filters()
            return [FloatValues(side) for pair in filters for side in pair]

    @cached_property
    def angles(self) -> Angles:
        """Angles in (0, pi], of which some are next to the poles of the filters."""
        terms = 16 * (floor(self.delay) + 2 + sum(len(side.plain) for side in self._values))
        found = [np.linspace(1e-9, pi, terms), np.geomspace(1e-6, 1e-2, 25)]
        found += [own for side in self._values for own in side.angles()]
        every = np.unique(np.concatenate(found))
        return every[(every > 0.0) & (every <= pi)]

    def parts(self, theta: Angles) -> tuple[Any, ...]:
        """At angles: what K and B add to R, and P and V."""
        whole, half = floor(self.delay), 0.5 * theta
        late, z = self.delay - whole, np.exp(1j * theta)
        shape = np.shape(theta)
        sides = [side(np.ravel(theta)).reshape(shape) for side in self._values]
        p, v = sides[0] / sides[1], sides[2] / sides[3]
        lag = 0.5j * self.period * np.exp(-1j * (half + whole * theta)) / np.sin(half)
        lag = lag * (1.0 - late + late / z)
        return (lag * p).real, (lag * v).real, p, v

    def needed(self, walls: Any, parts: tuple[Any, ...]) -> np.ndarray:
        """The damping that walls (K, B) need at angles, of which ``parts`` are those."""
        late = self.delay - floor(self.delay)
        of_stiffness, of_damping, p, v = parts
        real = walls[0] * of_stiffness + walls[1] * of_damping
        size = self.period * np.abs(walls[0] * p + walls[1] * v)
        need: np.ndarray = 0.5 * (real + np.sqrt(real**2 + late * (1.0 - late) * size**2))
        return need


def _squared(p: arb_poly) -> list[arb]:
    """The coefficients of |p|^2 over cos(k theta)."""
    rising = p.coeffs()
    product = arb_poly(rising) * arb_poly(rising[::-1])
    return [product[len(rising) - 1 + lag] * (2 if lag else 1) for lag in range(len(rising))]
